"""One quantity has one interval: in the file, the table, the summary, and the further results."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from tcdyn.chain import Chain
from tcdyn.core.estimate import Z95, Estimate
from tcdyn.core.result import estimates_frame
from tcdyn.plots.pick import draw_table
from tcdyn.rig.disk import Conditioning
from tcdyn.sensors import SensorFile, read_sensor, sensor_file
from tcdyn.sensors.current import current_sensor
from tcdyn.sensors.dips import pool_dips
from tcdyn.sensors.file import SHARES
from tcdyn.sensors.noise import noise_sensor
from tcdyn.sensors.plunge import plunge_sensor
from tcdyn.sensors.surface_h import BoundaryLayer
from tests.sensors.layered_world import drawn
from tests.sensors.sensor_world import fluctuating
from tests.sensors.small_sensor_study import small_sensor_record

NO_FILTER = Conditioning(cutoff_Hz=4.0, poles=0)


def dip(
    lag_s: float,
    relative_u: float,
    time_u: tuple[float, float, float] = (0.02, 0.02, 0.02),
    conditioning: Conditioning = NO_FILTER,
) -> SensorFile:
    """The file of one dip of a single lag; ``time_u`` are relative."""
    passed_s = lag_s * np.array([np.log(2), 1.0, np.log(10)])
    times = {key: Estimate.normal(t, t * u) for key, t, u in zip(SHARES, passed_s, time_u)}
    return sensor_file(
        "s",
        {"T": Chain([lag_s], conditioning=conditioning)},
        "plunge",
        np.array([[(relative_u * lag_s) ** 2]]),
        [0.0],
        times={"T": times},
        fit={"lag_s": Estimate.normal(lag_s, relative_u * lag_s).model_dump(), "step_K": 50.0},
    )


def ends(lag: Estimate) -> tuple[float, float, float, float]:
    """Value, standard uncertainty and interval."""
    return (lag.value, lag.u, lag.low95, lag.high95)


def intervals(made: SensorFile, folder: Path) -> list[tuple[float, float, float, float]]:
    """The lag of the further results, the file, the file as it is read back, and the table."""
    row = made.to_frame().loc["T"]
    read = read_sensor(made.write(folder / "s.sensor.json"))
    return [
        ends(Estimate(**made.fit["lag_s"])),
        ends(made.chain.channels["T"].lag_s),
        ends(read.chain.channels["T"].lag_s),
        tuple(row[["lag_s", "lag_u_s", "lag_low95_s", "lag_high95_s"]].tolist()),
    ]


def test_the_interval_of_unequal_dips_is_the_same_everywhere(tmp_path: Path) -> None:
    pooled = pool_dips([dip(lag_s, 0.02) for lag_s in (2.0, 4.0, 9.0)])
    first, *others = intervals(pooled, tmp_path)
    assert all(other == pytest.approx(first) for other in others)
    value, _, low, high = first
    assert 0 < low < 2.0
    assert high - value > 2 * (value - low)
    interval = pooled.chain.channels["T"].lag_s.interval_text
    assert interval in pooled.summary()
    assert interval in str(pooled.card()["lag [s]"][0])


def test_a_filter_shifts_the_interval_of_the_chain(tmp_path: Path) -> None:
    conditioning = Conditioning(cutoff_Hz=4.0, poles=2)
    pooled = pool_dips([dip(lag_s, 0.02, conditioning=conditioning) for lag_s in (2.0, 4.0, 9.0)])
    sensor, *others = intervals(pooled, tmp_path)
    shift = np.array([1, 0, 1, 1]) * conditioning.lag_s
    assert all(other == pytest.approx(sensor + shift) for other in others)


def a_plunge() -> SensorFile:
    """A plunge whose structures differ."""
    record = small_sensor_record((0.24, 0.038), 0.0, np.random.default_rng(1))
    return plunge_sensor(*record, "T")


def a_noise() -> SensorFile:
    """Fluctuations around a sensor of two lags."""
    return noise_sensor(*fluctuating(3, (1.0, 0.2), 0.1, 10_000, 0.05), "T")


def a_current() -> SensorFile:
    """A sheathed sensor that is heated."""
    rng = np.random.default_rng(11)
    sensor = drawn(rng, "water")
    power = np.where((np.arange(600) > 60) & (np.arange(600) < 320), 1.0, 0.0)
    dt_s = sensor.lag_s / 40
    y = 20 + 10 * sensor.heat(power, dt_s) + 0.1 * rng.standard_normal(len(power))
    return current_sensor(dt_s * np.arange(len(y)), y, np.sqrt(power), "T")


@pytest.mark.e2e
@pytest.mark.parametrize("method", [a_plunge, a_noise, a_current])
def test_the_interval_of_each_method_is_the_same_everywhere(method, tmp_path: Path) -> None:
    first, *others = intervals(method(), tmp_path)
    assert all(other == pytest.approx(first) for other in others)


@pytest.mark.parametrize("lags_s", [(3.0, 5.0, 8.0), (2.0, 2.2, 6.0)])
def test_the_spread_between_dips_is_in_the_times_as_in_the_lag(
    lags_s: tuple[float, float, float],
) -> None:
    """The times of the dip that differs most are hardly known."""
    dips = [dip(lag_s, 0.02) for lag_s in lags_s[:2]]
    dips.append(dip(lags_s[2], 0.02, (0.02, 0.6, 0.6)))
    pooled = pool_dips(dips)
    lag = pooled.chain.channels["T"].lag_s
    for key, factor in zip(SHARES, (np.log(2), 1.0, np.log(10))):
        time = pooled.times["T"][key]
        assert time.u / time.value > 0.9 * lag.u / lag.value
        assert all(time.contains(factor * lag_s) for lag_s in lags_s)


def test_the_lag_in_another_stream_keeps_the_asymmetry() -> None:
    skewed = Estimate(value=4.0, u=3.0, low95=1.5, high95=13.0)
    found = Estimate(**BoundaryLayer("water", 3e-3).to_fit(skewed)["lag_air_s"])
    symmetric = Estimate(
        **BoundaryLayer("water", 3e-3).to_fit(Estimate.normal(4.0, 3.0))["lag_air_s"]
    )
    assert found.value == pytest.approx(symmetric.value)
    assert found.u == pytest.approx(symmetric.u)
    assert found.high95 - found.value > Z95 * found.u > found.value - found.low95


def test_a_picture_of_estimates_has_their_intervals() -> None:
    lag = Estimate(value=4.0, u=3.0, low95=1.5, high95=13.0)
    table: pd.DataFrame = estimates_frame({"lag": lag}, "s")
    ax = draw_table(table, Figure().add_subplot())
    (bar,) = ax.containers[0].lines[2]
    assert bar.get_segments()[0][:, 0] == pytest.approx([100 * (1.5 / 4 - 1), 100 * (13 / 4 - 1)])
