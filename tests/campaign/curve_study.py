"""Drawn campaigns against model curves of correct and of wrong shape: where the offset lies, and what is reported.

`python -m tests.campaign.curve_study 2000` prints the figures for so many campaigns of each kind.

The errors of a drawn campaign are sums of standard normal numbers, one for all tests (an error of the level, and one to
three systematic errors to which each test is sensitive by a different amount) and one for each test. The covariance
follows from the same sums. Nothing is solved here.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy import stats

from tcdyn.campaign import solve_campaign
from tcdyn.campaign.posterior import BETA, N_QUANTITIES, Posterior
from tcdyn.campaign.trends import Curve, curve_test
from tcdyn.core import Array
from tests.campaign.toy import toy

COMMON = 0.004
INDEPENDENT = 0.0005
AGAINST = "delta_T_us_K_m_s"
LEAST_DEPARTURE = (
    0.01  # rms of a wrong shape about its mean over the tests: 20 times the independent error
)
LEVEL = 0.68


@dataclass(frozen=True)
class DrawnCurve:
    """A campaign, a curve, and the true offset of the tests from it (no number where the shape is wrong)."""

    posterior: Posterior
    curve: Curve
    difference: Array  # tests minus curve, (N,)
    offset: float


@cache
def toy_posterior(count: int) -> Posterior:
    """A campaign of ``count`` tests; its beta and their covariance are replaced by drawn ones."""
    return solve_campaign(toy(3, count).kept)


def sensitivities(rng: np.random.Generator, z: Array) -> list[Array]:
    """What one standard uncertainty of each common error does to beta of each test (N,)."""
    out = [np.full(len(z), COMMON)]
    for _ in range(rng.integers(1, 4)):
        size = rng.uniform(0.001, 0.006)
        level = rng.uniform(0.3, 1.5)
        slope = rng.uniform(-0.8, 0.8)
        out.append(size * (level + slope * z + 0.15 * rng.standard_normal(len(z))))
    return out


def wrong_shape(rng: np.random.Generator, z: Array) -> Array:
    """By how much the tests depart from a curve of wrong shape (N,), beside an offset."""
    while True:
        size = rng.uniform(0.02, 0.12) * rng.choice([-1.0, 1.0])
        shapes = (z, np.abs(z) - 0.5, np.sin(3.0 * z), np.exp(-2.0 * (z + 1.0)))
        departure = size * shapes[rng.integers(len(shapes))]
        if np.std(departure) >= LEAST_DEPARTURE:
            return np.asarray(departure)


def drawn_curve(seed: int, *, wrong: bool) -> DrawnCurve:
    """Draw 2 to 16 tests and a curve of the correct shape, or of a wrong one."""
    rng = np.random.default_rng(seed)
    posterior = toy_posterior(int(rng.integers(2, 17)))
    x = np.array([t.conditions[AGAINST] for t in posterior.tests])
    at = np.linspace(150.0, 1000.0, 5)
    curve = Curve("model.csv", AGAINST, at, LEVEL - 3e-5 * (at - 575.0), np.zeros(len(at)))
    z = (x - 575.0) / 425.0
    offset = float(rng.uniform(-0.1, 0.1))
    common = sensitivities(rng, z)
    covariance = INDEPENDENT**2 * np.eye(len(x))
    difference = np.full(len(x), offset)
    for each in common:
        covariance = covariance + np.outer(each, each)
        difference = difference + each * rng.standard_normal()
    difference = difference + INDEPENDENT * rng.standard_normal(len(x))
    if wrong:
        difference = difference + wrong_shape(rng, z)
        offset = float("nan")
    answers = posterior.values.copy()
    answers[:, BETA] = LEVEL - 3e-5 * (x - 575.0) + difference
    whole = np.eye(N_QUANTITIES * len(x))
    whole[BETA::N_QUANTITIES, BETA::N_QUANTITIES] = covariance
    return DrawnCurve(
        replace(posterior, values=answers, covariance=whole), curve, difference, offset
    )


def outside(value: float, points: Array) -> float:
    """How far a value lies outside the range of points; zero inside."""
    return max(float(points.min()) - value, value - float(points.max()), 0.0)


def report(count: int) -> None:
    """Print the figures for ``count`` campaigns of each kind."""
    for wrong in (False, True):
        made = [drawn_curve(seed, wrong=wrong) for seed in range(count)]
        tests = [curve_test(one.posterior, one.curve) for one in made]
        rejected = np.array([t.shape_rejected for t in tests])
        out = np.array([outside(t.offset.value, one.difference) for t, one in zip(tests, made)])
        u = np.array([t.offset.u for t in tests])
        covered = np.array([t.offset.contains(one.offset) for t, one in zip(tests, made)])
        print("wrong shape" if wrong else "correct shape", count, "campaigns")
        beside = out > 1e-12  # rounding of a mean
        print(f"  reported: {rejected.sum()} ({100 * rejected.mean():.1f} %)")
        print(
            f"  offset outside the range of the tests: {beside.sum()}, where reported {beside[rejected].sum()}"
        )
        print(f"  by more than u: {(out > u).sum()}; farthest {np.max(out / u):.2f} u")
        if not wrong:
            low, high = stats.binom.interval(0.95, count, 0.95)
            print(
                f"  95 % interval covers the truth: {covered.sum()} (by chance {low:.0f} to {high:.0f})"
            )


if __name__ == "__main__":
    report(int(sys.argv[1]) if len(sys.argv) > 1 else 200)
