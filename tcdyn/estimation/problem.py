"""What is fitted: named parameters, whitened residuals with Jacobian, normal priors, a box; and where that ended."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property

import numpy as np

from tcdyn.core import Array

Evaluate = Callable[[Array], tuple[Array, Array] | None]
LEAST_TOLD = 0.02  # below this the data say nothing of a parameter, and its pull means nothing
CUT = 1e-14  # of the largest eigenvalue, in a scale of unit diagonal: below it a direction was not seen


class Status(StrEnum):
    """How a search ended.

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

    ``evaluate(theta)`` gives the residual model - measured (N,), in standard deviations of its noise where that is
    known, and its Jacobian (N, P); None where the model cannot be computed (unstable, outside a table).
    ``prior_mean``, ``prior_sd`` (P,): inf where nothing was known. ``lower``, ``upper`` (P,): the box. ``largest``
    (P,): the most that one step of a search may change a parameter by. ``fixed`` (C, P): combinations
    ``fixed @ theta`` that every search leaves as they are at its start. What is None is not asked for, and then holds
    what says so. ``size`` is P, ``precision`` (P,) is 1/prior_sd^2.
    """

    names: tuple[str, ...]
    evaluate: Evaluate
    prior_mean: Array = None  # type: ignore[assignment]
    prior_sd: Array = None  # type: ignore[assignment]
    lower: Array = None  # type: ignore[assignment]
    upper: Array = None  # type: ignore[assignment]
    largest: Array = None  # type: ignore[assignment]
    fixed: Array = None  # type: ignore[assignment]
    size: int = field(init=False, repr=False)
    precision: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        p = len(self.names)
        object.__setattr__(self, "size", p)
        plain = {
            "prior_mean": 0.0,
            "prior_sd": np.inf,
            "lower": -np.inf,
            "upper": np.inf,
            "largest": np.inf,
        }
        for name, nothing in plain.items():
            given = getattr(self, name)
            object.__setattr__(
                self, name, np.full(p, nothing) if given is None else np.asarray(given, dtype=float)
            )
        object.__setattr__(
            self, "fixed", np.zeros((0, p)) if self.fixed is None else np.atleast_2d(self.fixed)
        )
        object.__setattr__(self, "precision", self.prior_sd**-2.0)

    def toward(self, name: str | Array) -> Array:
        """The unit vector (P,) of a parameter; a vector of weights is itself."""
        return (
            np.eye(self.size)[self.names.index(name)]
            if isinstance(name, str)
            else np.asarray(name, dtype=float)
        )


@dataclass(frozen=True)
class Optimum:
    """Where a search ended.

    ``cost`` is the sum of squares with priors; ``residual`` (N,) and ``jacobian`` (N, P) are the problem's own there,
    without robust ``weights`` (N,), None where the loss was linear; ``information`` (P, P) is half the Hessian of the
    cost, J'WJ + prior precision; ``directions`` (P, F) are those that theta was free to move along.
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
        """Covariance (P, P) for residuals of unit variance: the inverse of the information along the directions."""
        d = self.directions
        return np.asarray(d @ inverse(d.T @ self.information @ d) @ d.T)

    @property
    def log_volume(self) -> float:
        """Half the log determinant of the information along the directions: what Laplace's marginal asks for."""
        return 0.5 * float(
            np.linalg.slogdet(self.directions.T @ self.information @ self.directions)[1]
        )

    def value(self, name: str | Array) -> float:
        """A parameter, or a combination of parameters, at the optimum."""
        return float(self.problem.toward(name) @ self.theta)

    def u(self, name: str | Array) -> float:
        """Standard uncertainty of a parameter, or of a combination, for residuals of unit variance."""
        toward = self.problem.toward(name)
        return float(np.sqrt(max(float(toward @ self.covariance @ toward), 0.0)))

    @property
    def pulls(self) -> dict[str, float]:
        """By parameter with a prior: how far the data moved it, in units of what noise alone would have moved it by.

        (theta - prior_mean)/sqrt(prior variance - posterior variance): normal with unit variance if all is well. The
        data alone would ask for prior_mean + (theta - prior_mean)/told, told being the share of the prior variance
        that they removed.
        """
        precision = self.problem.precision
        shift = self.theta - self.problem.prior_mean
        told = 1 - np.diag(self.covariance) * precision
        pull = shift * np.sqrt(precision / np.maximum(told, LEAST_TOLD))
        return {n: float(z) for n, z, w in zip(self.problem.names, pull, precision) if w > 0}


def inverse(information: Array) -> Array:
    """Inverse (P, P) of a positive semidefinite matrix of very unequal scales; unseen directions are left out.

    In the scale that makes the diagonal one, by eigenvalues, those below 1e-14 of the largest cut off.

    >>> inverse(np.diag([1e-20, 4.0])).diagonal()
    array([1.0e+20, 2.5e-01])
    """
    return _inverse(information)[0]


def determined(information: Array) -> bool:
    """Whether every direction of parameter space was seen.

    >>> determined(np.array([[1.0, 1.0], [1.0, 1.0]]))
    False
    """
    return _inverse(information)[1]


def _inverse(information: Array) -> tuple[Array, bool]:
    size = np.sqrt(np.diag(information))
    seen = size > 0
    scale = np.where(seen, size, 1.0)
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    keep = values > CUT * values[-1]
    half = vectors[:, keep] / np.sqrt(values[keep]) / scale[:, None]
    return np.asarray(half @ half.T), bool(values[0] > 10 * CUT * values[-1] and seen.all())


def from_rows(rows: Array) -> tuple[Array, float]:
    """(rows' rows)^-1 by the triangular factor of ``rows`` (N, P), so that the condition number is never squared.

    Also gives the least part of a column, of its length, that the others leave: near zero where two columns are one,
    and then the covariance means nothing.

    >>> from_rows(np.array([[2.0, 0.0], [0.0, 1.0]]))[0].tolist()
    [[0.25, 0.0], [0.0, 1.0]]
    """
    size = np.linalg.norm(rows, axis=0)
    scale = np.where(size > 0, size, 1.0)
    factor = np.linalg.qr(rows / scale, mode="r")
    left = float(np.abs(np.diag(factor)).min())
    if left == 0:
        return np.full((rows.shape[1], rows.shape[1]), np.inf), 0.0
    half = np.linalg.solve(factor, np.eye(len(factor))) / scale[:, None]
    return np.asarray(half @ half.T), left


def orthonormal(table: Array, tolerance: float = 1e-10) -> Array:
    """Orthonormal basis (N, rank) of the columns of ``table`` (N, P); ``tolerance`` on squared singular values.

    By the eigenvectors of the Gram matrix, twice, which for tall tables is far quicker than a full factorisation.

    >>> orthonormal(np.array([[1.0, 2.0], [1.0, 2.0], [0.0, 0.0]])).shape  # two columns that are one
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


def wave_factor(z: Array, sums: int = 25) -> float:
    """Variance of slow waves in standardised residuals ``z`` (N, C) over that of white noise: never below one.

    The mean square of sums over an N/``sums``-th of the record each, which any slow misfit fills and white noise
    of unit variance does not. Columns that hold nothing, of a channel left out, do not count.

    >>> slow = np.sin(np.arange(1000) / 100)[:, None]
    >>> round(wave_factor(slow)), round(wave_factor(np.random.default_rng(0).standard_normal((1000, 1))), 1)
    (19, 1.0)
    """
    m = max(len(z) // sums, 1)
    z = z[:, z.any(axis=0)]
    waves = np.add.reduceat(z, np.arange(0, len(z) - m + 1, m), axis=0)[:-1] / np.sqrt(m)
    return max(1.0, float(np.mean(waves**2)))
