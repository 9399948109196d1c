"""The held-out score is that of a free simulation: nothing is fitted to the scored samples."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from tcdyn.estimation import NoiseModel
from tcdyn.identification import IOData, fit, held_out_score
from tcdyn.identification.heldout import drift_since_end, forecast

DT_S = 0.1
N = 600
FROM_S = 0.5 * N * DT_S
PLAIN: dict[str, Any] = {"check": False, "intervals": "quadratic"}


def heated(seed: int, drift: float = 0.0) -> IOData:
    """One lag of 1.5 s (simulated by its recursion), a drift over the record, noise of 0.1 K."""
    rng = np.random.default_rng(seed)
    u = np.repeat([0.0, 10.0, 0.0, 0.0, 10.0] * 3, 40)
    a = np.exp(-DT_S / 1.5)
    y = u[0] + lfilter([0.0, 1 - a], [1.0, -a], u - u[0]) + drift * np.linspace(0.0, 1.0, N)
    return IOData.from_arrays(u, y + 0.1 * rng.normal(size=N), DT_S, hold="zoh")


def with_ramp(data: IOData, size: float, from_s: float) -> tuple[IOData, np.ndarray]:
    """The record with a ramp of the output after ``from_s``, and the ramp (n,) there."""
    times_s = data.times_s()
    ramp = size * np.clip(times_s - from_s, 0.0, None) / times_s[-1]
    return data.with_outputs(data.outputs + ramp[:, None]), ramp[times_s >= from_s]


@pytest.mark.parametrize(
    "options",
    [
        {"noise": "white", "baseline": "trend"},
        {"noise": "white", "baseline": "none", "initial": "estimated"},
        {"noise": (0, 1), "baseline": "walk"},
        {"noise": "slow"},
    ],
)
def test_an_error_of_the_scored_outputs_is_scored_in_full(options: dict[str, Any]) -> None:
    """A ramp r of the scored outputs changes the mean square error e^2 to that of e + r: the mean
    of the two signs of r, less that without, is the mean square of r."""
    data = heated(1, drift=1.0)
    result = fit(data.between(None, FROM_S - 0.5 * DT_S), "P1", **PLAIN, **options)
    square = {}
    for size in (-2.0, 0.0, 2.0):
        changed, ramp = with_ramp(data, size, FROM_S - 0.5 * DT_S)
        square[size] = held_out_score(result, changed, FROM_S - 0.5 * DT_S)[0] ** 2
    added = 0.5 * (square[-2.0] + square[2.0]) - square[0.0]
    assert added == pytest.approx(float(np.mean(ramp**2)), rel=1e-6)


def test_the_state_of_another_record_is_fitted_to_samples_that_are_not_scored() -> None:
    """The ramp begins after the samples of the state."""
    result = fit(heated(1), "P1", initial="estimated", noise="white", baseline="none", **PLAIN)
    other = heated(2)
    start_s = 0.2 * N * DT_S
    square = {}
    for size in (-2.0, 0.0, 2.0):
        changed, ramp = with_ramp(other, size, start_s)
        square[size] = held_out_score(result, changed)[0] ** 2
    added = 0.5 * (square[-2.0] + square[2.0]) - square[0.0]
    assert added == pytest.approx(float(np.mean(ramp**2)), rel=0.01)
    assert np.sqrt(square[0.0]) == pytest.approx(0.1, rel=0.1)


def test_a_drift_continues_with_its_slope() -> None:
    """The error is the noise of 0.1 K, and that of the slope from half of the record."""
    data = heated(3, drift=4.0)
    train = data.between(None, FROM_S - 0.5 * DT_S)
    options: dict[str, Any] = {"noise": "white", "initial": "equilibrium", **PLAIN}
    drifting = fit(train, "P1", baseline="trend", **options)
    rms, percent = held_out_score(drifting, data, FROM_S - 0.5 * DT_S)
    assert rms == pytest.approx(0.1, rel=0.2)
    assert percent > 95
    constant = fit(train, "P1", baseline="none", **options)
    assert held_out_score(constant, data, FROM_S - 0.5 * DT_S)[0] > 0.5
    assert not drift_since_end(constant, data.times_s()).any()
    slope = drift_since_end(drifting, np.array([FROM_S, FROM_S + 1.0]))
    assert np.diff(slope)[0] == pytest.approx(4.0 / (N * DT_S), rel=0.1)


def test_the_forecast_of_noise_is_its_conditional_mean() -> None:
    """AR(1): a^k of the last value. A random walk with white noise: the level of exponential
    smoothing of gain 1 - c."""
    rng = np.random.default_rng(0)
    residual = np.cumsum(rng.normal(size=300))
    is_later = np.arange(300) >= 200
    steps = np.arange(1, 101)
    autoregression = forecast(NoiseModel((-0.9,)), residual, is_later)
    np.testing.assert_allclose(autoregression[is_later], 0.9**steps * residual[199])
    np.testing.assert_allclose(autoregression[~is_later], residual[~is_later])
    level = 0.0
    for value in residual[:200]:
        level += 0.3 * (value - level)
    walk = forecast(NoiseModel((-1.0,), (-0.7,), starts_at_rest=True), residual, is_later)
    np.testing.assert_allclose(walk[is_later], level)
    assert not forecast(NoiseModel(), residual, is_later)[is_later].any()
