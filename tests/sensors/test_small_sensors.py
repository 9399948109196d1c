"""Small sensors whose short lag may be the medium's, and steps within one row."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from tcdyn.chain import Chain
from tcdyn.sensors.dips import pool_dips
from tcdyn.sensors.file import SHARES, step_passes
from tcdyn.sensors.plunge import plunge_sensor
from tests.sensors.small_sensor_study import (
    MEDIA_S,
    SENSORS,
    Array,
    cell_lags,
    lags_in_series,
    small_sensor_record,
)


def off_in_u(sensor_s: tuple[float, float], medium_s: float, count: int) -> float:
    """Mean error over the median standard uncertainty of a cell of the study."""
    lags = cell_lags(sensor_s, medium_s, count, 1)
    error_s = np.mean([lag.value for lag in lags]) - sum(sensor_s)
    return float(abs(error_s) / np.median([lag.u for lag in lags]))


@pytest.mark.e2e
def test_a_short_lag_may_be_the_sensor_s_where_the_step_is_sharp() -> None:
    assert off_in_u((0.24, 0.038), 0.0, 3) < 2


QUICK = (SENSORS[0], SENSORS[2])


@pytest.mark.long
@pytest.mark.study
@pytest.mark.parametrize(
    "sensor_s", [pytest.param(s, marks=() if s in QUICK else pytest.mark.long) for s in SENSORS]
)
@pytest.mark.parametrize("medium_s", MEDIA_S)
def test_the_mean_error_of_small_sensors_is_below_two_u(
    sensor_s: tuple[float, float], medium_s: float, draws: Callable[[int], int]
) -> None:
    """A medium that is fixed, and not drawn from the prior of the fit."""
    assert off_in_u(sensor_s, medium_s, draws(20)) < 2


@pytest.mark.e2e
def test_a_quiet_record_does_not_tell_whose_lag_it_is() -> None:
    """The interval contains the lag without the short one, and with it, at any noise."""
    for noise_K in (0.05, 0.002):
        t = 0.003 * np.arange(1200)
        response = lags_in_series(t - 0.5012, (0.24, 0.038))
        y = 20 + 60 * response + noise_K * np.random.default_rng(1).standard_normal(len(t))
        lag = plunge_sensor(t, y, "T").chain.channels["T"].lag_s
        assert lag.low95 < 0.24 + 0.002
        assert lag.high95 > 0.278


@pytest.mark.e2e
def test_a_medium_without_a_lag_leaves_the_short_lag_to_the_sensor() -> None:
    t, y = small_sensor_record((0.24, 0.038), 0.0, np.random.default_rng(1))
    lag = plunge_sensor(t, y, "T", medium_s=(0.0, 0.0)).chain.channels["T"].lag_s
    assert abs(lag.value - 0.278) < 2 * lag.u < 0.03


@pytest.mark.e2e
def test_more_dips_do_not_tell_whose_lag_it_is() -> None:
    """The mean of three dips is as uncertain as one by this cause, which is named."""
    rng = np.random.default_rng(1)
    dips = [plunge_sensor(*small_sensor_record((0.24, 0.038), 0.0, rng), "T") for _ in range(3)]
    one_u_s = np.median([dip.chain.channels["T"].lag_s.u for dip in dips])
    pooled = pool_dips(dips)
    assert pooled.fit["mean_lag_s"]["u"] > 0.8 * one_u_s
    assert "--medium-s" in pooled.fit["limited_by"]


def two_paths(share: float, quick_s: float, slow_s: float, seed: int) -> tuple[Array, Array]:
    """Times and readings every 2 ms of an exposed junction with a conducting stem."""
    t = 0.002 * np.arange(740)
    since = np.clip(t - 0.0416, 0, None)
    response = 1 - (1 - share) * np.exp(-since / quick_s) - share * np.exp(-since / slow_s)
    return t, 20 + 60 * response + 0.03 * np.random.default_rng(seed).standard_normal(len(t))


@pytest.mark.e2e
@pytest.mark.parametrize(
    ("share", "quick_s", "slow_s"), [(0.23, 0.048, 0.33), (0.37, 0.051, 0.21), (0.38, 0.056, 0.14)]
)
def test_a_lag_as_short_as_the_medium_s_with_a_slow_path_is_a_result(
    share: float, quick_s: float, slow_s: float
) -> None:
    """One of the structures gives nearly all of the response to the medium.

    A film that settles gives nearly the same response, and a longer lag.
    """
    lag = plunge_sensor(*two_paths(share, quick_s, slow_s, 0), "T").chain.channels["T"].lag_s
    true_s = (1 - share) * quick_s + share * slow_s
    assert lag.value == pytest.approx(true_s, rel=0.25)
    assert abs(lag.value - true_s) < 2 * lag.u


@pytest.mark.parametrize(
    ("chain", "times_s"),
    [
        (Chain([]), (0.0, 0.0, 0.0)),
        (Chain([0.0]), (0.0, 0.0, 0.0)),
        (Chain([1.0], zero_s=1.0), (0.0, 0.0, 0.0)),
        (Chain([1.0], zero_s=0.6), (0.0, np.log(0.4 / np.exp(-1)), np.log(4))),
        (Chain([], delay_s=0.5), (0.5, 0.5, 0.5)),
        (Chain([2.0]), (2 * np.log(2), 2.0, 2 * np.log(10))),
    ],
)
def test_the_times_of_a_step_that_passes_at_once_are_zero(
    chain: Chain, times_s: tuple[float, float, float]
) -> None:
    assert step_passes(chain) == pytest.approx(times_s, abs=1e-3)


@pytest.mark.parametrize("zero_s", [1.05, 1.09, 1.0999, 1.1, 1.5])
def test_the_times_of_a_step_exist_where_a_zero_cancels_the_lag(zero_s: float) -> None:
    chain = Chain([1.0, 0.1], zero_s=zero_s)
    t = 1e-4 * np.arange(100_000)
    response = 1 - ((1 - zero_s) * np.exp(-t) - (0.1 - zero_s) * np.exp(-t / 0.1)) / 0.9
    expected = [float(t[np.argmax(response >= share)]) for share in SHARES.values()]
    assert step_passes(chain) == pytest.approx(expected, abs=2e-3)
