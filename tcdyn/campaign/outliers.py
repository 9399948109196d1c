"""Outlying tests of a campaign: leave-one-out comparison of each test with all others.

``tcdyn.campaign.result`` leaves the outlying tests out. Guarded by
``tests/campaign/test_posterior.py``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import chdtrc, ndtri

from tcdyn.campaign.posterior import Posterior, ReducedTest, indices_of, reduce_test, solve_campaign
from tcdyn.core import Array
from tcdyn.core.estimate import Estimate
from tcdyn.core.result import jsonable
from tcdyn.rig.disk import DISKS

# Probability that a campaign without errors reports an outlying test at all. Chosen by judgement.
FALSE_ALARM_PROBABILITY = 0.02
# Fewer tests do not show which of them is the outlier; chosen by judgement.
MIN_TESTS = 4
# Possible causes of a departure, in addition to the static line of every channel.
CAUSES = ("friction", "half-width", "ambient", "parting", *(f"lag {d}" for d in DISKS))
# The cause explains the departure if the remaining chi-squared has at least this p-value.
# Chosen by judgement.
EXPLAINED_P = 1e-3


@dataclass(frozen=True)
class OutlyingTest:
    """A test that does not agree with the other tests of its campaign.

    Attributes
    ----------
    name
        Name of the test.
    cause
        One of ``CAUSES`` or a static line: the change in this test that explains most.
    size
        Size of that change (relative for friction and half-width, else K or s).
    z
        The change in its standard uncertainties.
    chi2, freedom
        Chi-squared of the test against all others, and its degrees of freedom.
    left
        Chi-squared that remains when the cause is removed.
    """

    name: str
    cause: str
    size: Estimate
    z: float
    chi2: float
    left: float
    freedom: int

    @property
    def is_explained(self) -> bool:
        """Whether the cause alone explains the departure."""
        dof = max(self.freedom - 1, 1)
        return float(chdtrc(dof, max(self.left, 0.0))) > EXPLAINED_P

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of ``campaign.json``."""
        data = dict(jsonable(self))
        return {"test": data.pop("name"), **data, "explained": self.is_explained}


def outlying_tests(posterior: Posterior) -> tuple[OutlyingTest, ...]:
    """Outlying tests of a campaign, the worst first.

    Each outlier is removed before the next is searched. At most a quarter of the tests can be
    outliers, and none with fewer than ``MIN_TESTS`` tests.

    Parameters
    ----------
    posterior
        Posterior of all tests.

    Returns
    -------
    The outlying tests; empty if all agree.

    Notes
    -----
    The quarter was chosen by judgement: with more outliers it is not clear which tests are right.
    """
    outliers: list[OutlyingTest] = []
    remaining = list(posterior.tests)
    reduced_tests = list(posterior.reduced_tests)
    most = len(posterior.tests) // 4
    while len(remaining) >= MIN_TESTS and len(outliers) < most:
        worst = _worst_test(solve_campaign(remaining, reduced_tests))
        if worst is None:
            break
        outliers.append(worst)
        index = next(i for i, t in enumerate(remaining) if t.name == worst.name)
        del remaining[index]
        del reduced_tests[index]
    return tuple(outliers)


def _worst_test(posterior: Posterior) -> OutlyingTest | None:
    """The test with the largest departure if it is significant (Bonferroni); else None.

    Notes
    -----
    The number of trials is that of tests times causes, static lines included. A larger
    ``FALSE_ALARM_PROBABILITY`` names more tests.
    """
    tests = [leave_one_out(posterior, i) for i in range(len(posterior.tests))]
    worst = max(tests, key=lambda s: abs(s.z))
    lines = {name for t in posterior.tests for name in t.names if name.startswith("static ")}
    trials = len(tests) * (len(CAUSES) + len(lines))
    limit = float(-ndtri(0.5 * FALSE_ALARM_PROBABILITY / trials))
    return worst if abs(worst.z) > limit else None


def leave_one_out(posterior: Posterior, i: int) -> OutlyingTest:
    """Compare one test with the prediction of all others, by the cause that explains most.

    Parameters
    ----------
    posterior
        Posterior of all tests.
    i
        Index of the test.

    Notes
    -----
    The rows G of the test for the shared quantities, minus the prediction of the others, are the
    residual d with covariance V = 1 + G C G'. A cause with the column x, present in this test only,
    has the size x'V^-1 d / x'V^-1 x.
    """
    test = posterior.tests[i]
    lines = [n for n in test.names if n.startswith("static ")]
    lines.sort(key=lambda n: n.split()[::-1])
    causes = [c for c in CAUSES if c in test.names or c.startswith("lag ")]
    causes += lines
    departing = reduce_test(test, causes)
    n_shared = len(departing.shared) - len(causes)
    mean, covariance = posterior_without(posterior, posterior.reduced_tests[i])
    shared = indices_of(departing.shared[:n_shared], posterior.shared)
    rows = departing.rows[:, :n_shared]
    residual = departing.rhs - rows @ mean[shared]
    v = np.eye(len(residual)) + rows @ covariance[np.ix_(shared, shared)] @ rows.T
    lower = np.linalg.cholesky(v)
    d = np.linalg.solve(lower, residual)
    x = np.linalg.solve(lower, departing.rows[:, n_shared:])
    information = np.maximum((x**2).sum(axis=0), 1e-12)
    z = (x.T @ d) / np.sqrt(information)
    best = int(np.argmax(np.abs(z)))
    unit = test.units.get(causes[best], 1.0)
    u = unit / np.sqrt(information[best])
    chi2 = float(d @ d)
    return OutlyingTest(
        name=test.name,
        cause=causes[best],
        size=Estimate.normal(z[best] / np.sqrt(information[best]) * unit, u),
        z=float(z[best]),
        chi2=chi2,
        left=chi2 - float(z[best]) ** 2,
        freedom=int(min(len(d), n_shared)),
    )


def posterior_without(posterior: Posterior, left_out: ReducedTest) -> tuple[Array, Array]:
    """Mean and covariance of the shared quantities without one test.

    Parameters
    ----------
    posterior
        Posterior of all tests.
    left_out
        The test, reduced.

    Returns
    -------
    mean, covariance
        (S,) and (S, S), in prior standard uncertainties.

    Notes
    -----
    The rows of the test are subtracted from the information. Birge's factor is not applied.
    """
    rows = np.zeros((len(left_out.rows), len(posterior.shared)))
    rows[:, indices_of(left_out.shared, posterior.shared)] = left_out.rows
    information = np.linalg.inv(posterior.shared_covariance)
    covariance = np.asarray(np.linalg.inv(information - rows.T @ rows))
    rhs = information @ posterior.shared_mean - rows.T @ left_out.rhs
    return covariance @ rhs, covariance
