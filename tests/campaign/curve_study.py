"""Drawn campaigns against model curves of correct and of wrong shape: position of the offset, and
warnings.

`python -m tests.campaign.curve_study 2000 0` prints the figures for 2000 campaigns of each kind,
from seed 0 on.

The errors of a drawn campaign are sums of standard normal numbers: a common level error, one to
three systematic errors with a different sensitivity for each test, and an independent error of each
test. The covariance follows from the same sums. Nothing is solved here.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pandas as pd
from scipy import stats

from tcdyn.campaign import solve_campaign
from tcdyn.campaign.posterior import BETA, N_QUANTITIES, Posterior
from tcdyn.campaign.trends import Curve, curve_test
from tcdyn.core import Array
from tests.campaign.toy import toy

COMMON = 0.004
INDEPENDENT = 0.0005
AGAINST = "delta_T_us_K_m_s"
# rms of a wrong shape about its mean over the tests: 20 times the independent error
MIN_DEPARTURE = 0.01
LEVEL = 0.68


@dataclass(frozen=True)
class DrawnCurve:
    """A campaign, a curve, and the true offset of the tests from it (NaN for a wrong shape)."""

    posterior: Posterior
    curve: Curve
    difference: Array  # tests minus curve, (N,)
    offset: float


@cache
def toy_posterior(count: int) -> Posterior:
    """A campaign of ``count`` tests; the caller replaces its beta and their covariance."""
    return solve_campaign(toy(3, count).tests)


def sensitivities(rng: np.random.Generator, z: Array) -> list[Array]:
    """Effect of one standard uncertainty of each common error on beta of each test (N,)."""
    effects = [np.full(len(z), COMMON)]
    for _ in range(rng.integers(1, 4)):
        size = rng.uniform(0.001, 0.006)
        level = rng.uniform(0.3, 1.5)
        slope = rng.uniform(-0.8, 0.8)
        effects.append(size * (level + slope * z + 0.15 * rng.standard_normal(len(z))))
    return effects


def wrong_shape(rng: np.random.Generator, z: Array) -> Array:
    """Departure of the tests from a curve of wrong shape (N,), in addition to an offset."""
    while True:
        size = rng.uniform(0.02, 0.12) * rng.choice([-1.0, 1.0])
        shapes = (z, np.abs(z) - 0.5, np.sin(3.0 * z), np.exp(-2.0 * (z + 1.0)))
        departure = size * shapes[rng.integers(len(shapes))]
        if np.std(departure) >= MIN_DEPARTURE:
            return np.asarray(departure)


def drawn_curve(seed: int, *, wrong: bool) -> DrawnCurve:
    """Draw 2 to 16 tests and a curve of correct or of wrong shape."""
    rng = np.random.default_rng(seed)
    posterior = toy_posterior(int(rng.integers(2, 17)))
    x = np.array([t.conditions[AGAINST] for t in posterior.tests])
    curve_x = np.linspace(150.0, 1000.0, 5)
    curve = Curve(
        "model.csv", AGAINST, curve_x, LEVEL - 3e-5 * (curve_x - 575.0), np.zeros(len(curve_x))
    )
    z = (x - 575.0) / 425.0
    offset = float(rng.uniform(-0.1, 0.1))
    common = sensitivities(rng, z)
    covariance = INDEPENDENT**2 * np.eye(len(x))
    difference = np.full(len(x), offset)
    for effect in common:
        covariance = covariance + np.outer(effect, effect)
        difference = difference + effect * rng.standard_normal()
    difference = difference + INDEPENDENT * rng.standard_normal(len(x))
    if wrong:
        difference = difference + wrong_shape(rng, z)
        offset = float("nan")
    values = posterior.values.copy()
    values[:, BETA] = LEVEL - 3e-5 * (x - 575.0) + difference
    full_covariance = np.eye(N_QUANTITIES * len(x))
    full_covariance[BETA::N_QUANTITIES, BETA::N_QUANTITIES] = covariance
    return DrawnCurve(
        replace(posterior, values=values, covariance=full_covariance), curve, difference, offset
    )


def distance_outside(value: float, points: Array) -> float:
    """Distance of a value from the range of the points; zero inside."""
    return max(float(points.min()) - value, value - float(points.max()), 0.0)


def study_table(count: int, first: int, *, wrong: bool) -> pd.DataFrame:
    """For ``count`` campaigns from seed ``first``: is the shape reported, and where the offset
    lies."""
    rows = []
    for seed in range(first, first + count):
        drawn = drawn_curve(seed, wrong=wrong)
        result = curve_test(drawn.posterior, drawn.curve)
        inverse = np.linalg.inv(drawn.posterior.beta[1])
        rows.append(
            {
                "reported": result.shape_rejected,
                "outside": distance_outside(result.offset.value, drawn.difference),
                "covered": result.offset.contains(drawn.offset),
                "u_ratio": result.offset.u * np.sqrt(inverse.sum()),
            }
        )
    return pd.DataFrame(rows)


def report(count: int, first: int) -> None:
    """Print the figures for ``count`` campaigns of each kind."""
    for wrong in (False, True):
        table = study_table(count, first, wrong=wrong)
        print("wrong shape" if wrong else "correct shape", count, "campaigns")
        print(f"  reported: {table['reported'].sum()}")
        # 1e-12: rounding of a mean
        print(f"  offset outside the range of the tests: {(table['outside'] > 1e-12).sum()}")
        if not wrong:
            low, high = stats.binom.interval(0.95, count, 0.95)
            print(
                f"  95 % interval covers the truth: {table['covered'].sum()} (by chance "
                f"{low:.0f} to {high:.0f})"
            )
            print(f"  u over that of least squares, median: {table['u_ratio'].median():.2f}")


if __name__ == "__main__":
    report(int(sys.argv[1]), int(sys.argv[2]))
