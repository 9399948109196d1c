"""Campaign posterior: shared quantities of the rig and the quantities of every test, jointly.

A test has the rows R_a (a - a0) + R_q (q - q0) = z + noise with its nuisance parameters q = M s + D
e. s is common to the rig, e is specific to the test, both are standard normal. With e integrated
out, the rows have the covariance 1 + R_q D^2 R_q'. A QR factorisation then gives a as a linear
function of s, and rows for s alone. Only the sum of their G'G over the tests plus the prior of s,
which counts once, is inverted. Its size does not grow with the number of tests.

All modules of ``tcdyn.campaign`` that evaluate results use ``Posterior``. Guarded by
``tests/campaign/test_posterior.py``, which compares with a solution for all unknowns at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular

from tcdyn.campaign.compress import LAG_TEST_SD_S
from tcdyn.campaign.sufficient_statistics import QUANTITIES, Loading, SufficientStatistics
from tcdyn.core import Array
from tcdyn.core.arguments import with_named_arguments
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.rig.disk import DISKS

# Number of the quantities of a test, and the index of each in ``QUANTITIES``.
N_QUANTITIES = len(QUANTITIES)
BETA, LN_H_FAST, LN_H_SLOW, LAG_FAST, LAG_SLOW = range(N_QUANTITIES)


@dataclass(frozen=True)
class ReducedTest:
    """A test after its specific nuisance parameters have been integrated out.

    a = ``offset`` (5,) - ``sensitivity`` (5, S) s + ``root`` (5, 5) @ standard normal, with the
    shared quantities s; and ``rows`` (M, S) @ s = ``rhs`` (M,) with errors of unit variance.

    Parameters
    ----------
    name
        Name of the test.
    shared
        Names of the S shared quantities s.
    offset, sensitivity, root
        a = offset (5,) - sensitivity (5, S) s + root (5, 5) @ standard normal.
    rows, rhs
        rows (M, S) @ s = rhs (M,), with errors of unit variance.
    """

    name: str
    shared: tuple[str, ...]
    offset: Array
    sensitivity: Array
    root: Array
    rows: Array
    rhs: Array


def reduce_test(test: SufficientStatistics, departures: Sequence[str] = ()) -> ReducedTest:
    """Integrate out the quantities that are specific to one test.

    Parameters
    ----------
    test
        Sufficient statistics of the test.
    departures
        Quantities that may differ in this test from all others. Each gets a column behind the
        shared ones: a name of ``test.names`` (in standard uncertainties), "lag fast" or "lag slow"
        (in s).

    Returns
    -------
    The test, with ``departures`` after its shared quantities.

    Raises
    ------
    InputError
        If the rows do not separate beta from the heat transfer coefficients.

    Notes
    -----
    The error of a record's lag is common to the rig except for ``LAG_TEST_SD_S``; a larger value
    makes the lags of the tests less common. ``tests/campaign/test_posterior.py`` compares with the
    elimination of all unknowns at once.
    """
    q = test.names[N_QUANTITIES:]
    loading = [test.loading.get(name, Loading({name: 1.0})) for name in q]
    lag_names = [f"common lag {d}" for d in DISKS]
    shared_names = [name for each in loading for name in each.shared]
    shared = tuple(dict.fromkeys([*shared_names, *lag_names]))
    shared_loading = np.zeros((len(q), len(shared)))
    for row, each in zip(shared_loading, loading):
        row[indices_of([*each.shared], shared)] = [*each.shared.values()]
    specific = np.array([each.specific for each in loading])
    nuisance_rows = test.rows[:, N_QUANTITIES:]
    scaled = nuisance_rows * specific
    lower = cholesky(np.eye(len(scaled)) + scaled @ scaled.T, lower=True)
    departure_columns = np.zeros((len(nuisance_rows), len(departures)))
    for k, name in enumerate(departures):
        if name in q:
            departure_columns[:, k] = nuisance_rows[:, q.index(name)]
    augmented = np.column_stack(
        [
            test.rows[:, :N_QUANTITIES],
            nuisance_rows @ shared_loading,
            departure_columns,
            test.rhs + nuisance_rows @ test.centre[N_QUANTITIES:],
        ]
    )
    augmented = solve_triangular(lower, augmented, lower=True)
    # The error of the record's lag is common to the rig; a single test departs from it by little.
    priors = np.zeros((len(DISKS), augmented.shape[1]))
    for k, d in enumerate(DISKS):
        u = test.lag_u_s[d]
        column = LAG_FAST + k
        specific_s = min(LAG_TEST_SD_S, u)
        common_s = np.sqrt(max(u * u - specific_s**2, 0.0))
        priors[k, column] = 1 / specific_s
        priors[k, N_QUANTITIES + shared.index(lag_names[k])] = -common_s / specific_s
        if f"lag {d}" in departures:
            departure = N_QUANTITIES + len(shared) + departures.index(f"lag {d}")
            priors[k, departure] = -1 / specific_s
        priors[k, -1] = (test.lag_prior_s[d] - test.centre[column]) / specific_s
    factor: Array = np.asarray(np.linalg.qr(np.vstack([augmented, priors]), mode="r"))
    leading = factor[:N_QUANTITIES, :N_QUANTITIES]
    if np.abs(np.diag(leading)).min() < 1e-9 * np.abs(leading).max():
        raise InputError(
            "its rows do not tell beta from the heat transfer coefficients", where=test.name
        )
    upper = np.column_stack([factor[:N_QUANTITIES, N_QUANTITIES:], np.eye(N_QUANTITIES)])
    solution = solve_triangular(leading, upper)
    n_columns = len(shared) + len(departures)
    end = N_QUANTITIES + n_columns
    return ReducedTest(
        name=test.name,
        shared=(*shared, *departures),
        offset=test.centre[:N_QUANTITIES] + solution[:, n_columns],
        sensitivity=solution[:, :n_columns],
        root=solution[:, -N_QUANTITIES:],
        rows=factor[N_QUANTITIES:, N_QUANTITIES:end],
        rhs=factor[N_QUANTITIES:, end],
    )


@dataclass(frozen=True)
class Posterior:
    """Joint posterior of all tests of one rig.

    Attributes
    ----------
    tests, reduced_tests
        Sufficient statistics of the tests, and the same reduced to the shared quantities.
    values
        ``QUANTITIES`` of the N tests, shape (N, 5).
    covariance
        Their covariance, test by test, shape (5 N, 5 N).
    shared
        Names of the S shared quantities.
    shared_mean, shared_covariance
        Mean (S,) and covariance (S, S) of the shared quantities, in prior standard uncertainties.
    inflation
        Factor of ``shared_covariance`` within ``covariance``: :func:`birge_ratio_squared`.
    """

    tests: tuple[SufficientStatistics, ...] = field(repr=False)
    reduced_tests: tuple[ReducedTest, ...] = field(repr=False)
    values: Array
    covariance: Array = field(repr=False)
    shared: tuple[str, ...] = field(repr=False)
    shared_mean: Array = field(repr=False)
    shared_covariance: Array = field(repr=False)
    inflation: float = 1.0

    @property
    def test_names(self) -> tuple[str, ...]:
        """Names of the tests, in order."""
        return tuple(t.name for t in self.tests)

    def quantity(self, which: int) -> tuple[Array, Array]:
        """One of ``QUANTITIES`` of every test.

        Parameters
        ----------
        which
            Index of the quantity.

        Returns
        -------
        values, covariance
            (N,) and (N, N).
        """
        covariance = self.covariance[which::N_QUANTITIES, which::N_QUANTITIES]
        return self.values[:, which], covariance

    @property
    def beta(self) -> tuple[Array, Array]:
        """beta of every test.

        Returns
        -------
        values, covariance
            (N,) and (N, N).
        """
        return self.quantity(BETA)

    @cached_property
    def estimates(self) -> list[dict[str, Estimate]]:
        """Estimates of each test, by name.

        The names are beta, beta_within, h_fast, h_slow [W/m2K], lag_fast_s and lag_slow_s;
        ``beta_within`` is beta with its uncertainty against the other tests.
        """
        u = np.sqrt(np.diag(self.covariance)).reshape(-1, N_QUANTITIES)
        u_within = within_campaign_u(self.beta[1])
        out = []
        for a, s, w in zip(self.values, u, u_within):
            h = np.exp(a[[LN_H_FAST, LN_H_SLOW]])
            estimate = {"beta": Estimate.normal(a[BETA], s[BETA])}
            estimate["beta_within"] = Estimate.normal(a[BETA], w)
            for k, d in enumerate(DISKS):
                estimate[f"h_{d}"] = Estimate.normal(h[k], h[k] * s[LN_H_FAST + k])
                estimate[f"lag_{d}_s"] = Estimate.normal(a[LAG_FAST + k], s[LAG_FAST + k])
            out.append(estimate)
        return out


def u_if_known(posterior: Posterior, gradient: Array) -> dict[str, float]:
    """Standard uncertainty of a combination if one kind of shared quantity were known.

    Parameters
    ----------
    posterior
        Posterior of the campaign.
    gradient
        The combination: ``gradient`` (5 N,) @ quantities of all tests.

    Returns
    -------
    dict
        Standard uncertainty by kind, smallest first. A kind is the first word of the names, of both
        disks and all channels.

    Notes
    -----
    With C the covariance of the shared quantities, g the gradient and K a kind: var - (C g)_K'
    C_KK^-1 (C g)_K.
    """
    covariance = posterior.inflation * posterior.shared_covariance
    sensitivity = shared_sensitivity(posterior.reduced_tests, posterior.shared)
    shared_gradient = covariance @ (gradient @ sensitivity)
    kinds: dict[str, list[int]] = {}
    for k, name in enumerate(posterior.shared):
        kind = "lag" if "lag" in name else name.split()[0]
        kinds.setdefault(kind, []).append(k)
    variance = float(gradient @ posterior.covariance @ gradient)
    u_by_kind = {}
    for kind, indices in kinds.items():
        part = shared_gradient[indices]
        explained = float(part @ np.linalg.solve(covariance[np.ix_(indices, indices)], part))
        u_by_kind[kind] = float(np.sqrt(max(variance - explained, 0.0)))
    return dict(sorted(u_by_kind.items(), key=lambda item: item[1]))


def within_campaign_u(covariance: Array) -> Array:
    """Standard uncertainty of each of several numbers within their campaign.

    Parameters
    ----------
    covariance
        Covariance of the N numbers, (N, N).

    Returns
    -------
    Standard uncertainties, (N,).

    Notes
    -----
    Errors common to all numbers cancel: by deviations from the mean, u_i^2 = N/(N-1) (H C H)_ii
    with H_ij = delta_ij - 1/N. The difference of two independent numbers then has u_i and u_j added
    in squares. A single number has its own u.

    Examples
    --------
    >>> within_campaign_u(np.array([[1.01, 1.0], [1.0, 1.01]])).round(3)
    array([0.1, 0.1])
    """
    n = len(covariance)
    if n < 2:
        return np.sqrt(np.diag(covariance))
    centre = np.eye(n) - 1.0 / n
    variance = np.clip(np.diag(centre @ covariance @ centre), 0.0, None)
    return np.sqrt(variance * n / (n - 1))


@with_named_arguments
def solve_campaign(
    tests: Sequence[SufficientStatistics], reduced_tests: Sequence[ReducedTest] | None = None
) -> Posterior:
    """Joint posterior of tests of one rig.

    Parameters
    ----------
    tests
        Sufficient statistics of the tests.
    reduced_tests
        The same tests as an earlier call has reduced them, to save time.

    Raises
    ------
    InputError
        For no test, or for a test of another rig than the first; it is named.
    """
    if not tests:
        raise InputError("no tests", expected="at least one kept answer")
    check_same_rig(tests)
    known_reductions = {id(t): r for t, r in zip(tests, reduced_tests or ())}
    reductions = [known_reductions.get(id(t)) or reduce_test(t) for t in tests]
    shared = tuple(dict.fromkeys(name for r in reductions for name in r.shared))
    information = np.eye(len(shared))
    rhs = np.zeros(len(shared))
    for r in reductions:
        k = indices_of(r.shared, shared)
        information[np.ix_(k, k)] += r.rows.T @ r.rows
        rhs[k] += r.rows.T @ r.rhs
    shared_covariance = np.asarray(np.linalg.inv(information))
    shared_mean = shared_covariance @ rhs
    sensitivity = shared_sensitivity(reductions, shared)
    inflation = birge_ratio_squared(shared_mean, shared_covariance)
    covariance = inflation * sensitivity @ shared_covariance @ sensitivity.T
    for i, r in enumerate(reductions):
        block = slice(N_QUANTITIES * i, N_QUANTITIES * (i + 1))
        covariance[block, block] += r.root @ r.root.T
    shift = (sensitivity @ shared_mean).reshape(-1, N_QUANTITIES)
    return Posterior(
        tests=tuple(tests),
        reduced_tests=tuple(reductions),
        values=np.stack([r.offset for r in reductions]) - shift,
        covariance=covariance,
        shared=shared,
        shared_mean=shared_mean,
        shared_covariance=shared_covariance,
        inflation=inflation,
    )


def shared_sensitivity(reductions: Sequence[ReducedTest], shared: Sequence[str]) -> Array:
    """Minus the derivative of the quantities of all tests with respect to the shared quantities.

    Parameters
    ----------
    reductions
        The N tests, reduced.
    shared
        Names of the S shared quantities.

    Returns
    -------
    Sensitivity, (5 N, S).
    """
    sensitivity = np.zeros((N_QUANTITIES * len(reductions), len(shared)))
    for i, r in enumerate(reductions):
        block = slice(N_QUANTITIES * i, N_QUANTITIES * (i + 1))
        sensitivity[block, indices_of(r.shared, shared)] = r.sensitivity
    return sensitivity


def indices_of(names: Sequence[str], shared: Sequence[str]) -> NDArray[np.int64]:
    """Index of each of ``names`` in ``shared``.

    Parameters
    ----------
    names
        Names to find.
    shared
        Names of the shared quantities.

    Returns
    -------
    Indices, one for each name.
    """
    index = {name: k for k, name in enumerate(shared)}
    return np.array([index[name] for name in names], dtype=np.int64)


def birge_ratio_squared(shared_mean: Array, covariance: Array) -> float:
    """Square of Birge's ratio of the shared quantities, at least one.

    Parameters
    ----------
    shared_mean, covariance
        Posterior mean (S,) and covariance (S, S), in prior standard uncertainties.

    Notes
    -----
    The sum of squares of the mean over S - trace(covariance), the degrees of freedom that the data
    determine, is one on average if the statements of rig.toml and the model hold (Birge 1932). A
    campaign determines enough of them to show where they do not hold.
    """
    return max(1.0, float(shared_mean @ shared_mean) / determined_dof(covariance))


def determined_dof(covariance: Array) -> float:
    """Degrees of freedom of the shared quantities that the data determine, at least one.

    Parameters
    ----------
    covariance
        Posterior covariance (S, S), in prior standard uncertainties.

    Returns
    -------
    S - trace(covariance).
    """
    return max(len(covariance) - float(np.trace(covariance)), 1.0)


def check_same_rig(tests: Sequence[SufficientStatistics]) -> None:
    """Check that all tests have the rig and the records of the first.

    Parameters
    ----------
    tests
        Sufficient statistics of the tests.

    Raises
    ------
    InputError
        Another rig; the message names the test.
    """
    first = tests[0]
    for other in tests[1:]:
        if other.rig != first.rig:
            raise InputError(
                f"{other.name} was analysed with another rig.toml or other records than "
                f"{first.name}",
                expected="tests of one rig",
                remedy="give the tests of each rig a campaign of their own, or analyse the log "
                "again",
            )
