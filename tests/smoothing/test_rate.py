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
    """A random walk of slope and level, read directly: all samples and jumps as one normal vector.

    The process noise acts at the samples, as in the smoother at this sampling interval.
    """
    n, p, q, noise = 40, 0.3, 0.2, 0.1
    rng = np.random.default_rng(4)
    slope = np.cumsum(rng.normal(0.0, np.sqrt(q * STEP_S), n))
    level = np.cumsum(slope * STEP_S + rng.normal(0.0, np.sqrt(p * STEP_S), n))
    y = level + rng.normal(0.0, noise, n)
    result = smooth(
        y, STEP_S, Chain(()), noise_sd=noise, intensity=Intensity((0.0,), (q,), (), (p,))
    )
    # unknowns: level and slope at first, jumps of level and of slope at each later sample
    jump = np.tri(n, n, -1)[:, : n - 1]
    weight = np.arange(n)[:, None] - np.arange(1, n)
    slope_rows = np.hstack([np.zeros((n, 1)), np.ones((n, 1)), np.zeros((n, n - 1)), jump])
    ramp = np.arange(n)[:, None] * STEP_S
    level_rows = np.hstack([np.ones((n, 1)), ramp, jump, np.maximum(weight, 0) * STEP_S])
    prior = [1e-8, 1e-8, *[1 / (p * STEP_S)] * (n - 1), *[1 / (q * STEP_S)] * (n - 1)]
    covariance = np.linalg.inv(level_rows.T @ level_rows / noise**2 + np.diag(prior))
    estimate = covariance @ level_rows.T @ y / noise**2
    for k in range(10, 30):  # the mean of both slopes beside a sample, and the jump there
        row = 0.5 * (slope_rows[k] + slope_rows[k - 1])
        row[2 + k - 1] += 1 / STEP_S
        assert result.slope[k, 0] == pytest.approx(row @ estimate, abs=0.02 * result.slope_sd[k, 0])
        # the smoother takes the mean of the variances of both slopes for that of their mean
        assert 0.999 < result.slope_sd[k, 0] / np.sqrt(row @ covariance @ row) < 1.05


def test_the_causal_inverse_has_a_rate_with_its_uncertainty():
    made = world("few sines", 1)
    result = invert(made.readings, DT_S, Chain(LAG_S), 0.5, noise_sd=NOISE_K)
    error = (result.slope[:, 0] - made.rate_K_s)[100:]
    assert np.mean(np.abs(error) < 1.96 * result.slope_sd[100:, 0]) > 0.85
