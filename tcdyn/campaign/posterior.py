"""One posterior for all tests of a rig: shared quantities once, answers of every test, and all their correlations.

A test's rows are R_a (a - a0) + R_q (q - q0) = z + noise, q = M s + D e with s the rig's and e its own, both standard
normal. With e integrated out, rows have the covariance 1 + R_q D^2 R_q'; a triangular factor of what is left gives a as
a line in s, and rows for s alone. The sum of G'G over the tests, and the prior of s, which counts once, is all that has
to be inverted: its size does not grow with the number of tests.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular

from tcdyn.campaign.compress import LAG_OWN_S
from tcdyn.campaign.sufficient_statistics import ANSWERS, KeptTest, Loading
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.rig.disk import DISKS

A = len(ANSWERS)
BETA, LN_H_FAST, LN_H_SLOW, LAG_FAST, LAG_SLOW = range(A)


@dataclass(frozen=True)
class Reduced:
    """A test with its own unmeasured quantities integrated out: its answers by a line in the shared ones, and rows.

    a = ``at`` (5,) - ``by`` (5, S) s + ``root`` (5, 5) @ standard normal; ``rows`` (M, S) @ s = ``right`` (M,).
    """

    name: str
    shared: tuple[str, ...]
    at: Array
    by: Array
    root: Array
    rows: Array
    right: Array


def reduced(kept: KeptTest, departures: Sequence[str] = ()) -> Reduced:
    """Integrate out of a test what is its own.

    ``departures``: what may be otherwise in this test than in all others, each with a column of its own behind the
    shared ones: one of ``names``, by its standard uncertainty, or "lag fast" and "lag slow", by seconds.
    """
    q = kept.names[A:]
    loading = [kept.loading.get(name, Loading({name: 1.0})) for name in q]
    lag = [f"common lag {d}" for d in DISKS]
    shared = tuple(dict.fromkeys([*(name for each in loading for name in each.shared), *lag]))
    mixed = np.zeros((len(q), len(shared)))
    own = np.array([each.own for each in loading])
    for row, each in zip(mixed, loading):
        row[places([*each.shared], shared)] = [*each.shared.values()]
    of_q = kept.rows[:, A:]
    scaled = of_q * own
    lower = cholesky(np.eye(len(of_q)) + scaled @ scaled.T, lower=True)
    apart = np.zeros((len(of_q), len(departures)))
    for k, name in enumerate(departures):
        if name in q:
            apart[:, k] = of_q[:, q.index(name)]
    table = np.column_stack(
        [kept.rows[:, :A], of_q @ mixed, apart, kept.right + of_q @ kept.centre[A:]]
    )
    table = solve_triangular(lower, table, lower=True)
    priors = np.zeros((len(DISKS), table.shape[1]))
    for k, d in enumerate(
        DISKS
    ):  # the record's lag errs for the rig; the test's own departs from it by little
        u = kept.lag_u_s[d]
        at = LAG_FAST + k
        own_s = min(LAG_OWN_S, u)
        priors[k, at], priors[k, A + shared.index(lag[k])] = (
            1 / own_s,
            -np.sqrt(max(u * u - own_s**2, 0.0)) / own_s,
        )
        if f"lag {d}" in departures:
            priors[k, A + len(shared) + departures.index(f"lag {d}")] = -1 / own_s
        priors[k, -1] = (kept.lag_prior_s[d] - kept.centre[at]) / own_s
    factor: Array = np.asarray(np.linalg.qr(np.vstack([table, priors]), mode="r"))
    top = factor[:A, :A]
    if np.abs(np.diag(top)).min() < 1e-9 * np.abs(top).max():
        raise InputError(
            "its rows do not tell beta from the heat transfer coefficients", where=kept.name
        )
    line = solve_triangular(top, np.column_stack([factor[:A, A:], np.eye(A)]))
    at = A + len(shared) + len(departures)
    names = (*shared, *departures)
    return Reduced(
        kept.name,
        names,
        kept.centre[:A] + line[:, at - A],
        line[:, : at - A],
        line[:, -A:],
        factor[A:, A:at],
        factor[A:, at],
    )


@dataclass(frozen=True)
class Posterior:
    """What all tests together say.

    ``order``: names of the tests; ``answers`` (N, 5) of ``ANSWERS``; ``covariance`` (5 N, 5 N) of them, test by test;
    ``shared``: names of what the rig has in common; ``found`` (S,) of it and ``shared_covariance`` (S, S), in stated
    standard uncertainties. ``widened``: factor of that covariance within ``covariance``, see :func:`birge`.
    """

    tests: tuple[KeptTest, ...] = field(repr=False)
    reduced: tuple[Reduced, ...] = field(repr=False)
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
        """One of ``ANSWERS`` of every test (N,), and its covariance (N, N)."""
        return self.answers[:, which], self.covariance[which::A, which::A]

    @property
    def beta(self) -> tuple[Array, Array]:
        """beta (N,) and its covariance (N, N)."""
        return self.of(BETA)

    @cached_property
    def estimates(self) -> list[dict[str, Estimate]]:
        """Of each test: beta, beta_within, h_fast, h_slow [W/m2K], lag_fast_s, lag_slow_s."""
        u = np.sqrt(np.diag(self.covariance)).reshape(-1, A)
        inside = within(self.beta[1])
        out = []
        for a, s, w in zip(self.answers, u, inside):
            h = np.exp(a[[LN_H_FAST, LN_H_SLOW]])
            one = {"beta": Estimate.normal(a[BETA], s[BETA])}
            one["beta_within"] = Estimate.normal(a[BETA], w)
            for k, d in enumerate(DISKS):
                one[f"h_{d}"] = Estimate.normal(h[k], h[k] * s[LN_H_FAST + k])
                one[f"lag_{d}_s"] = Estimate.normal(a[LAG_FAST + k], s[LAG_FAST + k])
            out.append(one)
        return out


def u_if_known(posterior: Posterior, toward: Array) -> dict[str, float]:
    """Standard uncertainty that ``toward`` (5 N,) @ answers would have if one kind of what is shared were known.

    Kinds by the first word of their names, of both disks and all channels, what matters most first: with C the
    covariance of the shared, g the gradient and K a kind, var - (C g)_K' C_KK^-1 (C g)_K.
    """
    covariance = posterior.widened * posterior.shared_covariance
    moved = covariance @ (toward @ by_shared(posterior.reduced, posterior.shared))
    kinds: dict[str, list[int]] = {}
    for k, name in enumerate(posterior.shared):
        kinds.setdefault("lag" if "lag" in name else name.split()[0], []).append(k)
    variance = float(toward @ posterior.covariance @ toward)
    left = {
        kind: float(
            np.sqrt(
                max(
                    variance
                    - float(moved[k] @ np.linalg.solve(covariance[np.ix_(k, k)], moved[k])),
                    0.0,
                )
            )
        )
        for kind, k in kinds.items()
    }
    return dict(sorted(left.items(), key=lambda one: one[1]))


def within(covariance: Array) -> Array:
    """Standard uncertainty (N,) of each of N numbers within their campaign, from their covariance (N, N).

    What all have in common does not count: by deviations from the mean, u_i^2 = N/(N-1) (H C H)_ii with H = 1 - 1/N, so
    that the difference of two independent ones has u_i and u_j added in squares. One number alone has no difference
    from anything: its own u.

    >>> within(np.array([[1.01, 1.0], [1.0, 1.01]])).round(3)
    array([0.1, 0.1])
    """
    n = len(covariance)
    if n < 2:
        return np.sqrt(np.diag(covariance))
    centre = np.eye(n) - 1.0 / n
    return np.sqrt(np.clip(np.diag(centre @ covariance @ centre), 0.0, None) * n / (n - 1))


def solve(tests: Sequence[KeptTest], done: Sequence[Reduced] | None = None) -> Posterior:
    """The posterior of ``tests``, which must be of one rig; ``done``: what an earlier call has reduced already.

    Raises InputError for no test, or naming the first test of another rig.
    """
    if not tests:
        raise InputError("no tests", expected="at least one kept answer")
    refuse_mixed(tests)
    before = {id(t): r for t, r in zip(tests, done or ())}
    each = [before.get(id(t)) or reduced(t) for t in tests]
    shared = tuple(dict.fromkeys(name for r in each for name in r.shared))
    information = np.eye(len(shared))
    right = np.zeros(len(shared))
    for r in each:
        k = places(r.shared, shared)
        information[np.ix_(k, k)] += r.rows.T @ r.rows
        right[k] += r.rows.T @ r.right
    covariance = np.asarray(np.linalg.inv(information))
    found = covariance @ right
    by = by_shared(each, shared)
    widened = birge(found, covariance)
    whole = widened * by @ covariance @ by.T
    for i, r in enumerate(each):
        whole[A * i : A * (i + 1), A * i : A * (i + 1)] += r.root @ r.root.T
    answers = np.stack([r.at for r in each]) - (by @ found).reshape(-1, A)
    return Posterior(tuple(tests), tuple(each), answers, whole, shared, found, covariance, widened)


def by_shared(each: Sequence[Reduced], shared: Sequence[str]) -> Array:
    """By how much the answers (5 N, S) fall with each of the ``shared`` quantities."""
    by = np.zeros((A * len(each), len(shared)))
    for i, r in enumerate(each):
        by[A * i : A * (i + 1), places(r.shared, shared)] = r.by
    return by


def places(names: Sequence[str], shared: Sequence[str]) -> NDArray[np.int64]:
    """Where each of ``names`` (N,) stands among the ``shared`` ones."""
    place = {name: k for k, name in enumerate(shared)}
    return np.array([place[name] for name in names], dtype=np.int64)


def birge(found: Array, covariance: Array) -> float:
    """Square of Birge's ratio (1932) of the shared quantities: how far they were moved over how far they should be.

    Sum of found^2 over what the data told of them, S - trace(covariance), is one on average if the statements of
    rig.toml and the model hold; a campaign is sure enough to feel where they do not. Never below one.
    """
    told = len(found) - float(np.trace(covariance))
    return max(1.0, float(found @ found) / max(told, 1.0))


def refuse_mixed(tests: Sequence[KeptTest]) -> None:
    """Raises InputError where a test is of another rig, or other records, than the first; it is named."""
    first = tests[0]
    for other in tests[1:]:
        if other.rig != first.rig:
            raise InputError(
                f"{other.name} was analysed with another rig.toml or other records than {first.name}",
                expected="tests of one rig",
                remedy="give the tests of each rig a campaign of their own, or analyse the log again",
            )
