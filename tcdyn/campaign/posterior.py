"""One posterior for all tests of a rig: shared quantities once, answers of every test, and all
their correlations.

A test's rows are R_a (a - a0) + R_q (q - q0) = z + noise, q = M s + D e with s the rig's and e its
own, both standard normal. With e integrated out, rows have the covariance 1 + R_q D^2 R_q'; a
triangular factor of what is left gives a as a line in s, and rows for s alone. The sum of G'G over
the tests, and the prior of s, which counts once, is all that has to be inverted: its size does not
grow with the number of tests.
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
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.rig.disk import DISKS

N_QUANTITIES = len(QUANTITIES)
BETA, LN_H_FAST, LN_H_SLOW, LAG_FAST, LAG_SLOW = range(N_QUANTITIES)


@dataclass(frozen=True)
class ReducedTest:
    """A test with its own unmeasured quantities integrated out: its answers by a line in the shared
    ones, and rows.

    a = ``at`` (5,) - ``by`` (5, S) s + ``root`` (5, 5) @ standard normal; ``rows`` (M, S) @ s =
    ``right`` (M,).
    """

    name: str
    shared: tuple[str, ...]
    at: Array
    by: Array
    root: Array
    rows: Array
    right: Array


def reduced(test: SufficientStatistics, departures: Sequence[str] = ()) -> ReducedTest:
    """Integrate out of a test what is its own.

    ``departures``: what may be otherwise in this test than in all others, each with a column of its
    own behind the shared ones: one of ``names``, by its standard uncertainty, or "lag fast" and
    "lag slow", by seconds.
    """
    q = test.names[N_QUANTITIES:]
    loading = [test.loading.get(name, Loading({name: 1.0})) for name in q]
    lag = [f"common lag {d}" for d in DISKS]
    shared = tuple(dict.fromkeys([*(name for each in loading for name in each.shared), *lag]))
    shared_loading = np.zeros((len(q), len(shared)))
    specific = np.array([each.own for each in loading])
    for row, each in zip(shared_loading, loading):
        row[places([*each.shared], shared)] = [*each.shared.values()]
    nuisance_rows = test.rows[:, N_QUANTITIES:]
    scaled = nuisance_rows * specific
    lower = cholesky(np.eye(len(nuisance_rows)) + scaled @ scaled.T, lower=True)
    departure_columns = np.zeros((len(nuisance_rows), len(departures)))
    for k, name in enumerate(departures):
        if name in q:
            departure_columns[:, k] = nuisance_rows[:, q.index(name)]
    augmented = np.column_stack(
        [
            test.rows[:, :N_QUANTITIES],
            nuisance_rows @ shared_loading,
            departure_columns,
            test.right + nuisance_rows @ test.centre[N_QUANTITIES:],
        ]
    )
    augmented = solve_triangular(lower, augmented, lower=True)
    priors = np.zeros((len(DISKS), augmented.shape[1]))
    for k, d in enumerate(
        DISKS
    ):  # the record's lag errs for the rig; the test's own departs from it by little
        u = test.lag_u_s[d]
        column = LAG_FAST + k
        specific_s = min(LAG_TEST_SD_S, u)
        priors[k, column], priors[k, N_QUANTITIES + shared.index(lag[k])] = (
            1 / specific_s,
            -np.sqrt(max(u * u - specific_s**2, 0.0)) / specific_s,
        )
        if f"lag {d}" in departures:
            priors[k, N_QUANTITIES + len(shared) + departures.index(f"lag {d}")] = -1 / specific_s
        priors[k, -1] = (test.lag_prior_s[d] - test.centre[column]) / specific_s
    factor: Array = np.asarray(np.linalg.qr(np.vstack([augmented, priors]), mode="r"))
    leading = factor[:N_QUANTITIES, :N_QUANTITIES]
    if np.abs(np.diag(leading)).min() < 1e-9 * np.abs(leading).max():
        raise InputError(
            "its rows do not tell beta from the heat transfer coefficients", where=test.name
        )
    solution = solve_triangular(
        leading, np.column_stack([factor[:N_QUANTITIES, N_QUANTITIES:], np.eye(N_QUANTITIES)])
    )
    column = N_QUANTITIES + len(shared) + len(departures)
    names = (*shared, *departures)
    return ReducedTest(
        test.name,
        names,
        test.centre[:N_QUANTITIES] + solution[:, column - N_QUANTITIES],
        solution[:, : column - N_QUANTITIES],
        solution[:, -N_QUANTITIES:],
        factor[N_QUANTITIES:, N_QUANTITIES:column],
        factor[N_QUANTITIES:, column],
    )


@dataclass(frozen=True)
class Posterior:
    """What all tests together say.

    ``order``: names of the tests; ``answers`` (N, 5) of ``QUANTITIES``; ``covariance`` (5 N, 5 N)
    of them, test by test; ``shared``: names of what the rig has in common; ``found`` (S,) of it and
    ``shared_covariance`` (S, S), in stated standard uncertainties. ``widened``: factor of that
    covariance within ``covariance``, see :func:`birge_ratio_squared`.
    """

    tests: tuple[SufficientStatistics, ...] = field(repr=False)
    reduced: tuple[ReducedTest, ...] = field(repr=False)
    answers: Array
    covariance: Array = field(repr=False)
    shared: tuple[str, ...] = field(repr=False)
    found: Array = field(repr=False)
    shared_covariance: Array = field(repr=False)
    widened: float = 1.0

    @property
    def order(self) -> tuple[str, ...]:
        """Names of the tests."""
        return tuple(t.name for t in self.tests)

    def of(self, which: int) -> tuple[Array, Array]:
        """One of ``QUANTITIES`` of every test (N,), and its covariance (N, N)."""
        return self.answers[:, which], self.covariance[which::N_QUANTITIES, which::N_QUANTITIES]

    @property
    def beta(self) -> tuple[Array, Array]:
        """beta (N,) and its covariance (N, N)."""
        return self.of(BETA)

    @cached_property
    def estimates(self) -> list[dict[str, Estimate]]:
        """Of each test: beta, beta_within, h_fast, h_slow [W/m2K], lag_fast_s, lag_slow_s."""
        u = np.sqrt(np.diag(self.covariance)).reshape(-1, N_QUANTITIES)
        u_within = within(self.beta[1])
        out = []
        for a, s, w in zip(self.answers, u, u_within):
            h = np.exp(a[[LN_H_FAST, LN_H_SLOW]])
            estimate = {"beta": Estimate.normal(a[BETA], s[BETA])}
            estimate["beta_within"] = Estimate.normal(a[BETA], w)
            for k, d in enumerate(DISKS):
                estimate[f"h_{d}"] = Estimate.normal(h[k], h[k] * s[LN_H_FAST + k])
                estimate[f"lag_{d}_s"] = Estimate.normal(a[LAG_FAST + k], s[LAG_FAST + k])
            out.append(estimate)
        return out


def u_if_known(posterior: Posterior, gradient: Array) -> dict[str, float]:
    """Standard uncertainty that ``gradient`` (5 N,) @ answers would have if one kind of what is
    shared were known.

    Kinds by the first word of their names, of both disks and all channels, what matters most first:
    with C the covariance of the shared, g the gradient and K a kind, var - (C g)_K' C_KK^-1 (C
    g)_K.
    """
    covariance = posterior.widened * posterior.shared_covariance
    shared_gradient = covariance @ (
        gradient @ shared_sensitivity(posterior.reduced, posterior.shared)
    )
    kinds: dict[str, list[int]] = {}
    for k, name in enumerate(posterior.shared):
        kinds.setdefault("lag" if "lag" in name else name.split()[0], []).append(k)
    variance = float(gradient @ posterior.covariance @ gradient)
    u_by_kind = {
        kind: float(
            np.sqrt(
                max(
                    variance
                    - float(
                        shared_gradient[k]
                        @ np.linalg.solve(covariance[np.ix_(k, k)], shared_gradient[k])
                    ),
                    0.0,
                )
            )
        )
        for kind, k in kinds.items()
    }
    return dict(sorted(u_by_kind.items(), key=lambda item: item[1]))


def within(covariance: Array) -> Array:
    """Standard uncertainty (N,) of each of N numbers within their campaign, from their covariance
    (N, N).

    What all have in common does not count: by deviations from the mean, u_i^2 = N/(N-1) (H C H)_ii
    with H = 1 - 1/N, so that the difference of two independent ones has u_i and u_j added in
    squares. One number alone has no difference from anything: its own u.

    >>> within(np.array([[1.01, 1.0], [1.0, 1.01]])).round(3)
    array([0.1, 0.1])
    """
    n = len(covariance)
    if n < 2:
        return np.sqrt(np.diag(covariance))
    centre = np.eye(n) - 1.0 / n
    return np.sqrt(np.clip(np.diag(centre @ covariance @ centre), 0.0, None) * n / (n - 1))


def solve(
    tests: Sequence[SufficientStatistics], reduced_tests: Sequence[ReducedTest] | None = None
) -> Posterior:
    """The posterior of ``tests``, which must be of one rig; ``reduced_tests``: what an earlier call
    has reduced already.

    Raises InputError for no test, or naming the first test of another rig.
    """
    if not tests:
        raise InputError("no tests", expected="at least one kept answer")
    check_same_rig(tests)
    known_reductions = {
        id(t): test_reduction for t, test_reduction in zip(tests, reduced_tests or ())
    }
    reductions = [known_reductions.get(id(t)) or reduced(t) for t in tests]
    shared = tuple(
        dict.fromkeys(name for test_reduction in reductions for name in test_reduction.shared)
    )
    information = np.eye(len(shared))
    rhs = np.zeros(len(shared))
    for test_reduction in reductions:
        k = places(test_reduction.shared, shared)
        information[np.ix_(k, k)] += test_reduction.rows.T @ test_reduction.rows
        rhs[k] += test_reduction.rows.T @ test_reduction.right
    covariance = np.asarray(np.linalg.inv(information))
    shared_mean = covariance @ rhs
    sensitivity = shared_sensitivity(reductions, shared)
    inflation = birge_ratio_squared(shared_mean, covariance)
    full_covariance = inflation * sensitivity @ covariance @ sensitivity.T
    for i, test_reduction in enumerate(reductions):
        full_covariance[
            N_QUANTITIES * i : N_QUANTITIES * (i + 1), N_QUANTITIES * i : N_QUANTITIES * (i + 1)
        ] += test_reduction.root @ test_reduction.root.T
    answers = np.stack([test_reduction.at for test_reduction in reductions]) - (
        sensitivity @ shared_mean
    ).reshape(-1, N_QUANTITIES)
    return Posterior(
        tuple(tests),
        tuple(reductions),
        answers,
        full_covariance,
        shared,
        shared_mean,
        covariance,
        inflation,
    )


def shared_sensitivity(reductions: Sequence[ReducedTest], shared: Sequence[str]) -> Array:
    """By how much the answers (5 N, S) fall with each of the ``shared`` quantities."""
    sensitivity = np.zeros((N_QUANTITIES * len(reductions), len(shared)))
    for i, reduction in enumerate(reductions):
        sensitivity[N_QUANTITIES * i : N_QUANTITIES * (i + 1), places(reduction.shared, shared)] = (
            reduction.by
        )
    return sensitivity


def places(names: Sequence[str], shared: Sequence[str]) -> NDArray[np.int64]:
    """Where each of ``names`` (N,) stands among the ``shared`` ones."""
    place = {name: k for k, name in enumerate(shared)}
    return np.array([place[name] for name in names], dtype=np.int64)


def birge_ratio_squared(shared_mean: Array, covariance: Array) -> float:
    """Square of Birge's ratio (1932) of the shared quantities: how far they were moved over how far
    they should be.

    Sum of found^2 over what the data told of them, S - trace(covariance), is one on average if the
    statements of rig.toml and the model hold; a campaign is sure enough to feel where they do not.
    Never below one.
    """
    dof = len(shared_mean) - float(np.trace(covariance))
    return max(1.0, float(shared_mean @ shared_mean) / max(dof, 1.0))


def check_same_rig(tests: Sequence[SufficientStatistics]) -> None:
    """Raises InputError where a test is of another rig, or other records, than the first; it is
    named.
    """
    first = tests[0]
    for other in tests[1:]:
        if other.rig != first.rig:
            raise InputError(
                f"{other.name} was analysed with another rig.toml or other records than {first.name}",
                expected="tests of one rig",
                remedy="give the tests of each rig a campaign of their own, or analyse the log again",
            )
