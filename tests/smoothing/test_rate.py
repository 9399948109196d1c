"""The rate of change of a smoothed record; ``tests.smoothing.rate_study`` has more records."""

from __future__ import annotations

import numpy as np
import pytest

from tcdyn.chain import Chain
from tcdyn.smoothing import smooth
from tcdyn.smoothing.inverse import invert
from tcdyn.smoothing.noise_levels import Intensity
from tests.smoothing.rate_study import DT_S, LAG_S, NOISE_K, figures, world

STEP_S = 0.2


@pytest.mark.parametrize(("kind", "lag_u_s"), [("few sines", 0.1), ("random walk", 0.0)])
def test_the_band_of_the_rate_holds_and_is_no_wider_than_needed(kind, lag_u_s):
    share, u, rms = figures(kind, range(3), lag_u_s)
    assert share > 0.9
    assert 0.3 < rms / u < 1.5


def test_rates_are_those_of_dense_least_squares():
    """A random walk of slope and level, read directly: all states as one normal vector.

    A grid of half sampling intervals, so that the mean over the interval around a sample is exact.
    """
    n, p, q, noise = 40, 0.3, 0.2, 0.1
    rng = np.random.default_rng(4)
    slope = np.cumsum(rng.normal(0.0, np.sqrt(q * STEP_S), n))
    level = np.cumsum(slope * STEP_S + rng.normal(0.0, np.sqrt(p * STEP_S), n))
    y = level + rng.normal(0.0, noise, n)
    result = smooth(
        y, STEP_S, Chain(()), noise_sd=noise, intensity=Intensity((0.0,), (q,), (), (p,))
    )
    half_s = 0.5 * STEP_S
    step = np.array([[1.0, half_s], [0.0, 1.0]])
    driving = q * np.array([[half_s**3 / 3, half_s**2 / 2], [half_s**2 / 2, half_s]])
    driving[0, 0] += p * half_s
    count = 2 * n - 1
    state = np.zeros((2, 2 * count))
    state[:, :2] = 1e4 * np.eye(2)
    levels = []
    for k in range(count):
        levels.append(state[0].copy())
        state = step @ state
        state[:, 2 * (k + 1) : 2 * (k + 2)] = np.linalg.cholesky(driving)[:, : state.shape[1]]
        if k + 2 == count:
            levels.append(state[0].copy())
            break
    rows = np.array(levels)[::2] / noise
    information = rows.T @ rows + np.eye(2 * count)
    covariance = np.linalg.inv(information)
    estimate = covariance @ rows.T @ (y / noise)
    for k in range(10, 30):
        row = (levels[2 * k + 1] - levels[2 * k - 1]) / STEP_S
        assert result.slope[k, 0] == pytest.approx(row @ estimate, abs=0.02 * result.slope_sd[k, 0])
        assert result.slope_sd[k, 0] == pytest.approx(np.sqrt(row @ covariance @ row), rel=0.01)


def test_the_causal_inverse_has_a_rate_with_its_uncertainty():
    made = world("few sines", 1)
    result = invert(made.readings, DT_S, Chain(LAG_S), 0.5, noise_sd=NOISE_K)
    error = (result.slope[:, 0] - made.rate_K_s)[100:]
    assert np.mean(np.abs(error) < 1.96 * result.slope_sd[100:, 0]) > 0.85
