"""Which test does not belong: each held against what all others say of the rig, and what in it would explain that."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import chdtrc, ndtri

from tcdyn.campaign.posterior import Posterior, Reduced, places, reduced, solve
from tcdyn.core import Array
from tcdyn.core.estimate import Estimate
from tcdyn.core.result import jsonable
from tcdyn.rig.disk import DISKS

FALSE_ALARM = 0.02  # chance that a sound campaign names a test at all
LEAST_TESTS = 4
CAUSES = (
    "friction",
    "half-width",
    "ambient",
    "parting",
    *(f"lag {d}" for d in DISKS),
)  # and every static line


@dataclass(frozen=True)
class Stranger:
    """A test that does not belong to its campaign.

    ``cause``: one of ``CAUSES`` or a static line, what in this test alone would explain most of it, ``size`` of that (a
    share of friction or half-width, K, s), ``z`` in its standard uncertainties; ``chi2`` on ``freedom`` degrees of the
    whole test against all others, ``left`` of it when the cause is taken away."""

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
        kept = dict(jsonable(self))
        return {"test": kept.pop("name"), **kept, "explained": self.explained}


def strangers(posterior: Posterior) -> tuple[Stranger, ...]:
    """Tests that do not belong, worst first: each is taken out before the next is looked for.

    At most a quarter of the tests. Fewer than four tests do not tell which one is odd.
    """
    found: list[Stranger] = []
    left = list(posterior.tests)
    each = list(posterior.reduced)
    while len(left) >= LEAST_TESTS and len(found) < len(posterior.tests) // 4:
        worst = _worst(solve(left, each), found)
        if worst is None:
            break
        found.append(worst)
        at = next(i for i, t in enumerate(left) if t.name == worst.name)
        del left[at], each[at]
    return tuple(found)


def _worst(posterior: Posterior, before: Sequence[Stranger]) -> Stranger | None:
    tests = [against_the_rest(posterior, i) for i in range(len(posterior.tests))]
    worst = max(tests, key=lambda s: abs(s.z))
    lines = {name for t in posterior.tests for name in t.names if name.startswith("static ")}
    trials = len(tests) * (len(CAUSES) + len(lines))
    return worst if abs(worst.z) > float(-ndtri(0.5 * FALSE_ALARM / trials)) else None


def against_the_rest(posterior: Posterior, i: int) -> Stranger:
    """Test ``i`` against what all others say, by the cause that explains most of what is between them.

    Its rows for the shared quantities, less the others' answer, have the covariance 1 + G C G'; a cause x in this test
    alone has the size x'V^-1 d / x'V^-1 x.
    """
    kept = posterior.tests[i]
    lines = sorted(
        (n for n in kept.names if n.startswith("static ")), key=lambda n: n.split()[::-1]
    )
    causes = [*(c for c in CAUSES if c in kept.names or c.startswith("lag ")), *lines]
    own = reduced(kept, causes)
    count = len(own.shared) - len(causes)
    found, covariance = without(posterior, posterior.reduced[i])
    k = places(own.shared[:count], posterior.shared)
    rows = own.rows[:, :count]
    off = own.right - rows @ found[k]
    v = np.eye(len(off)) + rows @ covariance[np.ix_(k, k)] @ rows.T
    half = np.linalg.cholesky(v)
    d = np.linalg.solve(half, off)
    x = np.linalg.solve(half, own.rows[:, count:])
    told = np.maximum((x**2).sum(axis=0), 1e-12)
    z = (x.T @ d) / np.sqrt(told)
    best = int(np.argmax(np.abs(z)))
    unit = kept.units.get(causes[best], 1.0)
    size = Estimate.normal(z[best] / np.sqrt(told[best]) * unit, unit / np.sqrt(told[best]))
    chi2 = float(d @ d)
    freedom = int(min(len(d), count))
    return Stranger(
        kept.name, causes[best], size, float(z[best]), chi2, chi2 - float(z[best]) ** 2, freedom
    )


def without(posterior: Posterior, one: Reduced) -> tuple[Array, Array]:
    """What all tests but ``one`` say of the shared quantities (S,), and its covariance (S, S)."""
    rows = np.zeros((len(one.rows), len(posterior.shared)))
    rows[:, places(one.shared, posterior.shared)] = one.rows
    information = np.linalg.inv(posterior.shared_covariance)
    covariance = np.asarray(np.linalg.inv(information - rows.T @ rows))
    return covariance @ (information @ posterior.found - rows.T @ one.right), covariance
