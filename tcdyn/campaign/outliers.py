"""Which test does not belong: each held against what all others say of the rig, and what in it
would explain that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import chdtrc, ndtri

from tcdyn.campaign.posterior import Posterior, ReducedTest, places, reduced, solve
from tcdyn.core import Array
from tcdyn.core.estimate import Estimate
from tcdyn.core.result import jsonable
from tcdyn.rig.disk import DISKS

FALSE_ALARM_PROBABILITY = 0.02  # chance that a sound campaign names a test at all
MIN_TESTS = 4
CAUSES = (
    "friction",
    "half-width",
    "ambient",
    "parting",
    *(f"lag {d}" for d in DISKS),
)  # and every static line


@dataclass(frozen=True)
class OutlyingTest:
    """A test that does not belong to its campaign.

    ``cause``: one of ``CAUSES`` or a static line, what in this test alone would explain most of it,
    ``size`` of that (a share of friction or half-width, K, s), ``z`` in its standard uncertainties;
    ``chi2`` on ``freedom`` degrees of the whole test against all others, ``left`` of it when the
    cause is taken away.
    """

    name: str
    cause: str
    size: Estimate
    z: float
    chi2: float
    left: float
    freedom: int

    @property
    def explained(self) -> bool:
        """Whether the cause alone explains the departure."""
        return float(chdtrc(max(self.freedom - 1, 1), max(self.left, 0.0))) > 1e-3

    def to_dict(self) -> dict[str, Any]:
        """As ``campaign.json`` keeps it."""
        data = dict(jsonable(self))
        return {"test": data.pop("name"), **data, "explained": self.explained}


def outlying_tests(posterior: Posterior) -> tuple[OutlyingTest, ...]:
    """Tests that do not belong, worst first: each is taken out before the next is looked for.

    At most a quarter of the tests. Fewer than four tests do not tell which one is odd.
    """
    outliers: list[OutlyingTest] = []
    remaining = list(posterior.tests)
    reduced_tests = list(posterior.reduced)
    while len(remaining) >= MIN_TESTS and len(outliers) < len(posterior.tests) // 4:
        worst = _worst(solve(remaining, reduced_tests), outliers)
        if worst is None:
            break
        outliers.append(worst)
        at = next(i for i, t in enumerate(remaining) if t.name == worst.name)
        del remaining[at], reduced_tests[at]
    return tuple(outliers)


def _worst(posterior: Posterior, outliers: Sequence[OutlyingTest]) -> OutlyingTest | None:
    tests = [leave_one_out(posterior, i) for i in range(len(posterior.tests))]
    worst = max(tests, key=lambda s: abs(s.z))
    lines = {name for t in posterior.tests for name in t.names if name.startswith("static ")}
    trials = len(tests) * (len(CAUSES) + len(lines))
    return worst if abs(worst.z) > float(-ndtri(0.5 * FALSE_ALARM_PROBABILITY / trials)) else None


def leave_one_out(posterior: Posterior, i: int) -> OutlyingTest:
    """Test ``i`` against what all others say, by the cause that explains most of what is between
    them.

    Its rows for the shared quantities, less the others' answer, have the covariance 1 + G C G'; a
    cause x in this test alone has the size x'V^-1 d / x'V^-1 x.
    """
    test = posterior.tests[i]
    lines = sorted(
        (n for n in test.names if n.startswith("static ")), key=lambda n: n.split()[::-1]
    )
    causes = [*(c for c in CAUSES if c in test.names or c.startswith("lag ")), *lines]
    departing = reduced(test, causes)
    count = len(departing.shared) - len(causes)
    mean, covariance = posterior_without(posterior, posterior.reduced[i])
    shared_indices = places(departing.shared[:count], posterior.shared)
    rows = departing.rows[:, :count]
    residual = departing.right - rows @ mean[shared_indices]
    v = np.eye(len(residual)) + rows @ covariance[np.ix_(shared_indices, shared_indices)] @ rows.T
    half = np.linalg.cholesky(v)
    d = np.linalg.solve(half, residual)
    x = np.linalg.solve(half, departing.rows[:, count:])
    information = np.maximum((x**2).sum(axis=0), 1e-12)
    z = (x.T @ d) / np.sqrt(information)
    best = int(np.argmax(np.abs(z)))
    unit = test.units.get(causes[best], 1.0)
    size = Estimate.normal(
        z[best] / np.sqrt(information[best]) * unit, unit / np.sqrt(information[best])
    )
    chi2 = float(d @ d)
    freedom = int(min(len(d), count))
    return OutlyingTest(
        test.name, causes[best], size, float(z[best]), chi2, chi2 - float(z[best]) ** 2, freedom
    )


def posterior_without(posterior: Posterior, left_out: ReducedTest) -> tuple[Array, Array]:
    """What all tests but ``left_out`` say of the shared quantities (S,), and its covariance (S,
    S).
    """
    rows = np.zeros((len(left_out.rows), len(posterior.shared)))
    rows[:, places(left_out.shared, posterior.shared)] = left_out.rows
    information = np.linalg.inv(posterior.shared_covariance)
    covariance = np.asarray(np.linalg.inv(information - rows.T @ rows))
    return covariance @ (information @ posterior.found - rows.T @ left_out.right), covariance
