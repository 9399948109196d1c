"""The least-squares problem and its optimum with covariance.

A problem has names of parameters, residuals with Jacobian, normal priors, a box, and fixed
combinations. Covariances are for residuals of unit variance; the caller scales them otherwise.
Guarded by ``tests/estimation/test_fitting.py`` and ``tests/estimation/test_noise_models.py``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property

import numpy as np

from tcdyn.core import Array

# Residual (N,) and Jacobian (N, P) at theta (P,); None where the model cannot be computed.
Evaluate = Callable[[Array], tuple[Array, Array] | None]
# share of the prior variance that the data remove, at least, in a pull; below it the pull means
# nothing; chosen by judgement
MIN_INFORMATION_SHARE = 0.02
# share of the largest eigenvalue, with unit diagonal, below which a direction is undetermined;
# some fifty times the rounding error of doubles
EIGENVALUE_CUT = 1e-14
# factor on the cut, below which an eigenvalue counts as undetermined: those near the cut are mostly
# rounding error
RANK_MARGIN = 10


class Status(StrEnum):
    """How a search ended.

    Examples
    --------
    >>> Status.AT_BOUND.value
    'converged with a parameter on its bound: the data do not ask for it'
    """

    CONVERGED = "converged: no step lowers the cost any more"
    AT_BOUND = "converged with a parameter on its bound: the data do not ask for it"
    EDGE = "stopped where the model cannot be computed any further"
    STALLED = "stopped after the allowed iterations; look at the intervals before using it"
    NOWHERE = "the model cannot be computed at the start"


@dataclass(frozen=True)
class Problem:
    """Sum of squares over theta (P,): |residual|^2 + sum ((theta - prior_mean)/prior_sd)^2.

    Parameters
    ----------
    names
        Names of the parameters (P).
    evaluate
        ``evaluate(theta)`` gives the residual model - measured (N,), whitened or in standard
        deviations of its noise where that is known, and its Jacobian (N, P); None where the model
        cannot be computed (unstable, outside a table).
    prior_mean, prior_sd
        Normal priors (P,); infinite sd where there is none.
    lower, upper
        The box (P,).
    max_step
        Largest change of a parameter in one step of a search (P,).
    fixed
        Combinations ``fixed @ theta`` (C, P) that every search leaves at their start values.
    residual
        The residual alone (N,), where that takes much less time than with its Jacobian; None for
        none. Searches then follow curved valleys in fewer steps.
    size
        P.
    precision
        1/prior_sd^2 (P,).

    Notes
    -----
    None for a field means no prior, no bound, no limit or no fixed combination; the field then
    holds the corresponding array.
    """

    names: tuple[str, ...]
    evaluate: Evaluate
    prior_mean: Array = None  # type: ignore[assignment]
    prior_sd: Array = None  # type: ignore[assignment]
    lower: Array = None  # type: ignore[assignment]
    upper: Array = None  # type: ignore[assignment]
    max_step: Array = None  # type: ignore[assignment]
    fixed: Array = None  # type: ignore[assignment]
    residual: Callable[[Array], Array | None] | None = None
    size: int = field(init=False, repr=False)
    precision: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Replace each None by the array that means no prior, bound, limit or combination."""
        p = len(self.names)
        object.__setattr__(self, "size", p)
        defaults = {
            "prior_mean": 0.0,
            "prior_sd": np.inf,
            "lower": -np.inf,
            "upper": np.inf,
            "max_step": np.inf,
        }
        for name, default in defaults.items():
            given = getattr(self, name)
            value = np.full(p, default) if given is None else np.asarray(given, dtype=float)
            object.__setattr__(self, name, value)
        fixed = np.zeros((0, p)) if self.fixed is None else np.atleast_2d(self.fixed)
        object.__setattr__(self, "fixed", fixed)
        object.__setattr__(self, "precision", self.prior_sd**-2.0)

    def direction(self, name: str | Array) -> Array:
        """The unit vector of a parameter; a vector of weights is returned as it is.

        Parameters
        ----------
        name
            Name of a parameter, or weights, (P,).

        Returns
        -------
        Weights, (P,).
        """
        if isinstance(name, str):
            return np.asarray(np.eye(self.size)[self.names.index(name)])
        return np.asarray(name, dtype=float)


@dataclass(frozen=True)
class Optimum:
    """Result of a search.

    Parameters
    ----------
    problem
        The problem.
    theta
        Parameters (P,).
    residual, jacobian
        Residual (N,) and Jacobian (N, P) there, without the robust ``weights``.
    cost
        Sum of squares with priors.
    information
        Half the Hessian of the cost (P, P), J'WJ + prior precision.
    directions
        Directions (P, F) in which theta was free.
    status
        How the search ended.
    steps
        Number of steps.
    weights
        Robust weights (N,); None for the linear loss.
    """

    problem: Problem = field(repr=False)
    theta: Array
    residual: Array = field(repr=False)
    jacobian: Array = field(repr=False)
    cost: float
    information: Array = field(repr=False)
    directions: Array = field(repr=False)
    status: Status
    steps: int
    weights: Array | None = field(default=None, repr=False)

    @property
    def converged(self) -> bool:
        """Whether a minimum was reached."""
        return self.status in (Status.CONVERGED, Status.AT_BOUND)

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the parameters for residuals of unit variance.

        Returns
        -------
        Covariance, (P, P): the inverse of the information along the free directions.
        """
        d = self.directions
        return np.asarray(d @ inverse(d.T @ self.information @ d) @ d.T)

    @property
    def log_volume(self) -> float:
        """Half the log determinant of the information along the directions.

        For Laplace's approximation of the marginal likelihood.
        """
        information = self.directions.T @ self.information @ self.directions
        return 0.5 * float(np.linalg.slogdet(information)[1])

    def value(self, name: str | Array) -> float:
        """A parameter, or a combination of parameters, at the optimum."""
        return float(self.problem.direction(name) @ self.theta)

    def u(self, name: str | Array) -> float:
        """Standard uncertainty of a parameter or combination for residuals of unit variance."""
        toward = self.problem.direction(name)
        return float(np.sqrt(max(float(toward @ self.covariance @ toward), 0.0)))

    @property
    def pulls(self) -> dict[str, float]:
        """Pull of each parameter with a prior, by name.

        (theta - prior_mean)/sqrt(prior variance - posterior variance). It is normal with unit
        variance if the prior is right: how far the data moved the parameter, in units of what noise
        would have moved it by. The data without the prior would give prior_mean + (theta -
        prior_mean)/s, with s the share of the prior variance that they removed.

        Notes
        -----
        s is at least ``MIN_INFORMATION_SHARE``, so that a parameter that the data do not determine
        has a small pull.
        """
        precision = self.problem.precision
        shift = self.theta - self.problem.prior_mean
        variance_share = 1 - np.diag(self.covariance) * precision
        pull = shift * np.sqrt(precision / np.maximum(variance_share, MIN_INFORMATION_SHARE))
        return {n: float(z) for n, z, w in zip(self.problem.names, pull, precision) if w > 0}


def inverse(information: Array) -> Array:
    """Inverse of a positive semidefinite matrix of very unequal scales.

    Parameters
    ----------
    information
        Positive semidefinite matrix, (P, P).

    Returns
    -------
    Inverse, (P, P), without undetermined directions (pseudo-inverse).

    Notes
    -----
    The diagonal is scaled to one; eigenvalues below ``EIGENVALUE_CUT`` of the largest are cut off.
    A direction that is cut off has variance zero: check with ``is_full_rank`` where that matters.

    Examples
    --------
    >>> inverse(np.diag([1e-20, 4.0])).diagonal()
    array([1.0e+20, 2.5e-01])
    """
    return _inverse_and_rank(information)[0]


def is_full_rank(information: Array) -> bool:
    """Whether the information determines every direction of the parameter space.

    Parameters
    ----------
    information
        Positive semidefinite matrix, (P, P).

    Returns
    -------
    is_full
        True also for no parameters, P = 0.

    Notes
    -----
    The limit is ``RANK_MARGIN`` times that of ``inverse``, so that a matrix near the cut counts as
    undetermined.

    Examples
    --------
    >>> is_full_rank(np.array([[1.0, 1.0], [1.0, 1.0]]))
    False
    """
    return _inverse_and_rank(information)[1]


def _inverse_and_rank(information: Array) -> tuple[Array, bool]:
    """The inverse, and whether every direction is determined.

    Parameters
    ----------
    information
        Positive semidefinite matrix, (P, P).

    Returns
    -------
    inverse, full_rank
        Inverse, (P, P), and whether the rank is full.
    """
    if not information.size:
        return np.zeros((0, 0)), True
    diagonal_root = np.sqrt(np.diag(information))
    present = diagonal_root > 0
    scale = np.where(present, diagonal_root, 1.0)
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    keep = values > EIGENVALUE_CUT * values[-1]
    half = vectors[:, keep] / np.sqrt(values[keep]) / scale[:, None]
    full_rank = values[0] > RANK_MARGIN * EIGENVALUE_CUT * values[-1] and present.all()
    return np.asarray(half @ half.T), bool(full_rank)


def covariance_from_rows(rows: Array) -> tuple[Array, float]:
    """(rows' rows)^-1 without squaring the condition number.

    Parameters
    ----------
    rows
        Jacobian in standard deviations, with prior rows, (N, P).

    Returns
    -------
    covariance
        (P, P); infinite where a column is exactly a combination of the others.
    smallest
        Smallest part of a column, relative to its length, that the columns before it do not
        explain. It is near zero where two columns are equal; the covariance then means nothing.

    Notes
    -----
    By the triangular factor of ``rows``.

    Examples
    --------
    >>> covariance_from_rows(np.array([[2.0, 0.0], [0.0, 1.0]]))[0].tolist()
    [[0.25, 0.0], [0.0, 1.0]]
    """
    length = np.linalg.norm(rows, axis=0)
    scale = np.where(length > 0, length, 1.0)
    factor = np.linalg.qr(rows / scale, mode="r")
    smallest = float(np.abs(np.diag(factor)).min())
    if smallest == 0:
        return np.full((rows.shape[1], rows.shape[1]), np.inf), 0.0
    half = np.linalg.solve(factor, np.eye(len(factor))) / scale[:, None]
    return np.asarray(half @ half.T), smallest


def orthonormal_basis(table: Array, tolerance: float = 1e-10) -> Array:
    """Orthonormal basis of the columns of a tall table.

    Parameters
    ----------
    table
        Columns, (N, P).
    tolerance
        Squared singular values below this share of the largest are left out.

    Returns
    -------
    Basis, (N, rank).

    Notes
    -----
    By the eigenvectors of the Gram matrix, twice, which for tall tables is much faster than a full
    factorisation. The second pass makes the basis orthonormal to rounding error.

    Examples
    --------
    >>> parallel_columns = np.array([[1.0, 2.0], [1.0, 2.0], [0.0, 0.0]])
    >>> orthonormal_basis(parallel_columns).shape
    (3, 1)
    """
    scale = np.linalg.norm(table, axis=0)
    q = table[:, scale > 0] / scale[scale > 0]
    for limit in (tolerance, 1e-3):
        if q.shape[1] == 0:
            return q
        w, v = np.linalg.eigh(q.T @ q)
        keep = w > limit * w[-1]
        q = q @ (v[:, keep] / np.sqrt(w[keep]))
    return np.asarray(q)


def slow_variance_factor(z: Array, n_chunks: int = 25) -> float:
    """Covariance factor for correlated residuals: variance of chunk sums over that of white noise.

    Parameters
    ----------
    z
        Standardised residuals, (N, C). Columns of zeros (a channel left out) do not count.
    n_chunks
        Number of chunks of the record; the default is chosen by judgement.

    Returns
    -------
    float
        Factor for the covariance, at least one.

    Notes
    -----
    The factor is the mean square of the sums of z over chunks of m = N/``n_chunks`` samples,
    divided by sqrt(m). A slow misfit raises it; white noise of unit variance does not. Fewer
    chunks respond to slower misfit only, and scatter more. The last chunk is left out.
    Guarded by ``tests/estimation/test_noise_models.py``.

    Examples
    --------
    >>> slow = np.sin(np.arange(1000) / 100)[:, None]
    >>> white = np.random.default_rng(0).standard_normal((1000, 1))
    >>> round(slow_variance_factor(slow)), round(slow_variance_factor(white), 1)
    (19, 1.0)
    """
    m = max(len(z) // n_chunks, 1)
    z = z[:, z.any(axis=0)]
    sums = np.add.reduceat(z, np.arange(0, len(z) - m + 1, m), axis=0)[:-1] / np.sqrt(m)
    return max(1.0, float(np.mean(sums**2)))
