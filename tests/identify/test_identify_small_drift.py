"""Drifts that are too small for a test of whiteness: gain and lag stay within their intervals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from scipy.signal import lfilter

from tcdyn.identification import IOData, compare, confirm, fit
from tests.identify.small_drift_study import LAGS_S, N, record, study

FIELD_FILES = Path(__file__).resolve().parents[2].parent / "shared/cases/files2"
RUNS = 16
# fewer of 16 are covered once in 200 studies, at a coverage of 95 %
LEAST = int(stats.binom.ppf(0.005, RUNS, 0.95))


@pytest.mark.e2e
@pytest.mark.parametrize("drift", ["line 1 %", "warming up 1 %", "wave of 0.7 periods, 6 %"])
def test_drifts_and_slow_waves_are_in_the_intervals(drift: str) -> None:
    """With a test of whiteness that decides on a disturbance, 8 of 16 were covered."""
    result = study(drift, range(RUNS))
    assert min(result["gain"], result["lag_s"], result["dead_s"]) >= LEAST, result
    assert result["z"] < 4  # normal errors: once in 300 studies


@pytest.mark.study
def test_without_a_drift_the_uncertainty_is_little_larger() -> None:
    """White noise given: u = 1. A slope that is fitted in any case costs 1.4 to 1.6 here."""
    averaged = study("none", range(RUNS))
    white = study("none", range(RUNS), noise="white", baseline="none")
    assert min(averaged["gain"], averaged["lag_s"]) >= LEAST, averaged
    for name in ("u_gain", "u_lag_s"):
        assert white[name] <= averaged[name] < 1.25 * white[name], name


def test_every_likely_model_of_a_comparison_is_averaged_over_noise() -> None:
    """Gain and lag averaged over the models would else have the bias of the others."""
    comparison = compare(record(5, "line 1 %"), "P2D", "P2DU", "P3D", check=False)
    assert all(comparison.fits[name].noise.averaged for name in ("P2D", "P2DU"))
    lag = comparison.averaged["u"]["lag_s"]
    assert lag.contains(sum(LAGS_S) + 0.4)
    assert lag.u >= 0.9 * comparison.best.identified.lag_s.u


def test_intervals_of_averaged_noise_are_profiled_where_they_are_poor() -> None:
    """The lag of a short step record in noise: its interval is longer above than below."""
    rng = np.random.default_rng(0)
    u = np.repeat([0.0, 1.0], [20, 60])
    t_s = np.clip(0.5 * (np.arange(80) - 20), 0.0, None)
    y = 1 - np.exp(-t_s / 8.0) + 0.15 * rng.normal(size=80)
    data = IOData.from_arrays(u, y, 0.5, hold="zoh")
    options = {"noise": "slow", "baseline": "none", "initial": "equilibrium", "check": False}
    lag = fit(data, "P1", **options).estimates["Tp1"]
    assert lag.high95 - lag.value > 1.1 * (lag.value - lag.low95)
    quadratic = fit(data, "P1", intervals="quadratic", **options).estimates["Tp1"]
    assert quadratic.high95 - quadratic.value == pytest.approx(quadratic.value - quadratic.low95)


@pytest.mark.e2e
def test_a_coarse_logger_widens_the_intervals_of_averaged_noise() -> None:
    """Readings in steps of 4 K, 40 times the noise: equal readings share their rounding error."""
    data = record(0, "none")
    rng = np.random.default_rng(0)
    y = data.outputs[:, 0] + 0.1 * rng.normal(size=N)
    u = {}
    for step in (1e-6, 20.0):
        readings = data.with_outputs(step * np.round(y[:, None] / step))
        result = fit(readings, "P2D", noise="slow", check=False, initial="equilibrium")
        u[step] = result.identified.static_gain.u / result.residual.std()
    assert u[20.0] > 1.2 * u[1e-6]


@pytest.mark.e2e
def test_a_drift_of_two_percent_of_the_swing_is_in_the_interval_of_the_gain() -> None:
    path = FIELD_FILES / "82.csv"
    if not path.exists():
        pytest.skip("the field cases are not there")
    table = pd.read_csv(path)
    dt_s = float(np.median(np.diff(table["time_s"])))
    data = IOData.from_arrays(table["u"].to_numpy(), table["y"].to_numpy(), dt_s, hold="zoh")
    comparison = compare(data)
    for gain in (comparison.best.identified.static_gain, comparison.averaged["u"]["gain"]):
        assert gain.contains(1.328)
        assert gain.u < 0.03


def test_a_fit_of_averaged_noise_is_confirmed_on_data_of_another_interval() -> None:
    """The noise model holds for one interval only; the parameters hold for all."""
    data = record(5, "line 1 %")
    result = fit(data, "P2D", check=False)
    assert result.noise.averaged
    every_other = IOData.from_arrays(
        data.runs[0].u[::2, 0], data.outputs[::2, 0], 2 * data.dt_s, hold="zoh"
    )
    assert confirm(result, every_other).whiteness.p >= 0


def test_a_wave_as_large_as_the_response_makes_the_result_provisional() -> None:
    """The input is a slow sine, and the output drifts by twice the response."""
    t_s = np.arange(600.0)
    u = np.sin(2 * np.pi * t_s / 500.0)
    response = lfilter([1 - np.exp(-1 / 40.0)], [1.0, -np.exp(-1 / 40.0)], u)
    noise = np.random.default_rng(1).normal(0.0, 0.02, len(u))
    y = response + 4.0 * np.cos(np.pi * t_s / 600.0) + noise
    data = IOData.from_arrays(u, y, 1.0, hold="zoh")
    conclusion = compare(data, "P1", check=False).conclusion
    assert conclusion.code != "models.recommended"
    assert "model.wave" in conclusion.numbers["troubles"]
