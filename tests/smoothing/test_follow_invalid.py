"""Invalid readings of a followed log: outside the physical range, faster than the lag allows,
stuck, missing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tcdyn.sensors import specified_sensor
from tcdyn.workflows.follow import FollowRun, follow
from tests.cli.test_main_job import tcdyn
from tests.sensors.sensor_world import Array, lagged, write, written

TAU_S = 25.0
DT_S = 1.0
N = 320
FAULT = slice(200, 240)


def kiln() -> tuple[Array, Array, Array]:
    """Time [s], gas and readings [degC] of a kiln whose door opens at 100 s; the sensor has one lag
    of 25 s."""
    t = np.arange(N) * DT_S
    open_s = np.clip(t - 100.0, 0.0, None)
    gas = 850.0 - 80.0 * (1.0 - np.exp(-open_s / 60.0))
    noise = 0.3 * np.random.default_rng(3).standard_normal(N)
    return t, gas, np.round(lagged(gas, (TAU_S,), DT_S) + noise, 2)


def followed(folder: Path, y: Array, name: str = "TC1_degC") -> tuple[FollowRun, pd.DataFrame]:
    """The run with a sensor of 25 s and a delay of 100 s, and what it wrote."""
    log = write(folder / "log.csv", **{"time_s": kiln()[0], name: y})
    sensors = [specified_sensor("s", [name], [(TAU_S, 1.0)])]
    run = follow(log, sensors, folder / "out.csv", delay_s=100.0, idle_s=0.0, poll_s=0.0)
    return run, written(folder / "out.csv")


def alternating(bad: float, part: slice) -> Array:
    y = kiln()[2]
    y[part][::2] = bad
    return y


def constant(bad: float, part: slice) -> Array:
    y = kiln()[2]
    y[part] = bad
    return y


def at_random(bad: float, share: float) -> Array:
    y = kiln()[2]
    y[np.random.default_rng(5).random(N) < share] = bad
    return y


FAULTS = {
    "every second reading 2300": alternating(2300.0, FAULT),
    "open circuit at 2300": constant(2300.0, FAULT),
    "unplugged: reads the cold junction": constant(24.0, FAULT),
    "20 % zeros": at_random(0.0, 0.2),
    "the first readings 0": constant(0.0, slice(0, 5)),
    "2 % overload 9.9E37": at_random(9.9e37, 0.02),
    "overload -9E9 in between": alternating(-9e9, FAULT),
    "infinite": at_random(np.inf, 0.02),
    "stuck at one value": constant(820.0, FAULT),
}


@pytest.mark.e2e
@pytest.mark.parametrize("kind", FAULTS)
def test_invalid_readings_count_as_missing_and_are_told(tmp_path: Path, kind: str) -> None:
    y = FAULTS[kind]
    _, gas, clean = kiln()
    run, out = followed(tmp_path, y)
    bad = y != clean
    told = [f for f in run.findings if f.code == "rows.not_used"]
    assert [f.subject for f in told] == ["TC1_degC"]
    assert told[0].numbers["count"] >= 0.9 * np.count_nonzero(bad)
    assert told[0].numbers["first_s"] <= np.flatnonzero(bad)[0] * DT_S + 2
    x = out["TC1_degC"].to_numpy()
    u = out["TC1_u_K"].to_numpy()
    determined = np.isfinite(x)
    assert determined.mean() > 0.9
    # the result stays near the true range of the gas, and within its band as often as stated
    assert np.min(x[determined]) > np.min(gas) - 40.0
    assert np.max(x[determined]) < np.max(gas) + 40.0
    assert np.mean((np.abs(x - gas) < 1.96 * u)[determined]) > 0.85


@pytest.mark.e2e
def test_valid_readings_are_left_alone(tmp_path: Path) -> None:
    run, out = followed(tmp_path, kiln()[2])
    assert not run.findings
    z = (out["TC1_degC"] - kiln()[1]) / out["TC1_u_K"]
    assert np.mean(np.abs(z) < 1.96) > 0.85


@pytest.mark.e2e
def test_the_range_is_that_of_the_temperature_in_any_unit(tmp_path: Path) -> None:
    """-40 in kelvin is colder than absolute zero."""
    y = kiln()[2] + 273.15
    y[200] = -40.0
    run, out = followed(tmp_path, y, "TC1_K")
    assert [f.numbers["count"] for f in run.findings if f.code == "rows.not_used"] == [1]
    assert out["TC1_K"].min() > 900.0


@pytest.mark.e2e
def test_the_command_names_the_readings(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = write(tmp_path / "log.csv", time_s=kiln()[0], TC1=constant(24.0, FAULT))
    sensor = tmp_path / "s.json"
    assert tcdyn("sensor", "new", "--tau-s", "25+-1", "--column", "TC*", "--out", sensor, "-q") == 0
    words = ["follow", log, "--sensor", sensor, "--out", tmp_path / "out.csv", "--delay-s", "100"]
    assert tcdyn(*words, "--idle-s", "0", "--strict") == 1
    error = capsys.readouterr().err
    assert "of 320 readings of TC1" in error
    assert "the first at 200 s" in error
