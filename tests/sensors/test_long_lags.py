"""Lags of a quarter of an hour and more, of a room or a building: every way to a sensor file, and
back from it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tcdyn.chain import Chain
from tcdyn.core.errors import InputError
from tcdyn.rig.record import MAX_LAG_S
from tcdyn.sensors import read_sensor
from tcdyn.sensors.file import sensor_file
from tcdyn.sensors.plunge import plunge_sensor
from tcdyn.workflows.compensate_table import compensate_table
from tests.cli.test_main_job import tcdyn as run_cli
from tests.sensors.sensor_world import (
    Array,
    Sheath,
    fluctuating,
    lagged,
    two_in_a_gas,
    write,
    written,
)

LONG_S = (900.0, 1800.0)


def room(lag_s: float, dt_s: float = 5.0) -> tuple[Array, Array, Array]:
    """Time [s], a temperature that drifts and steps once, and the reading of it behind one lag,
    with noise [degC]."""
    count = int(6 * lag_s / dt_s)
    fine = np.arange(count * 4) * (dt_s / 4)
    truth = np.where(fine < lag_s, 20.0, 60.0) + 5 * np.sin(fine / (2 * lag_s))
    y = lagged(truth, (lag_s,), dt_s / 4)[::4] + 0.05 * np.random.default_rng(1).standard_normal(
        count
    )
    return fine[::4], truth[::4], y


def check_file(path: Path, column: str, lag_s: float) -> None:
    """The file can be read and holds the lag within 4 u, and u is less than a tenth of it."""
    sensor = read_sensor(path)
    lag = sensor.chain.channels[column].lag_s
    assert abs(lag.value - lag_s) < 4 * lag.u
    assert 0 < lag.u < 0.1 * lag_s
    assert run_cli("sensor", "show", path) == 0


@pytest.mark.e2e
@pytest.mark.parametrize("lag_s", LONG_S)
def test_a_plunge_is_written_read_and_compensated(lag_s: float, tmp_path: Path) -> None:
    t, _, _ = room(lag_s)
    step = np.where(t < lag_s, 20.0, 60.0)
    y = lagged(np.repeat(step, 4), (lag_s,), 1.25)[::4] + 0.05 * np.random.default_rng(
        2
    ).standard_normal(len(t))
    log = write(tmp_path / "dip.csv", time_s=t, T_degC=y)
    out = tmp_path / "s.sensor.json"
    assert run_cli("sensor", "plunge", log, "--column", "T", "--out", out) == 0
    check_file(out, "T_degC", lag_s)
    assert run_cli("compensate", log, "--sensor", out, "--out", tmp_path / "o.csv") == 0


@pytest.mark.long
@pytest.mark.e2e
def test_a_specified_lag_compensates_and_follows_a_room(tmp_path: Path) -> None:
    lag_s = 900.0
    t, truth, y = room(lag_s)
    log = write(tmp_path / "room.csv", time_s=t, T_degC=y)
    out = tmp_path / "s.sensor.json"
    assert (
        run_cli("sensor", "new", "--tau-s", f"{lag_s:g}+-5", "--column", "T_degC", "--out", out)
        == 0
    )
    settled = (t > 2 * lag_s) & (t < 5 * lag_s)
    assert run_cli("compensate", log, "--sensor", out, "--out", tmp_path / "o.csv") == 0
    done = written(tmp_path / "o.csv")
    pulls = ((done["T_degC"] - truth) / done["T_u_K"])[settled]
    assert np.mean(np.abs(pulls) < 3) > 0.9
    assert np.sqrt(np.mean((done["T_degC"] - truth)[settled] ** 2)) < 0.1 * np.sqrt(
        np.mean((y - truth)[settled] ** 2)
    )
    live = tmp_path / "live.csv"
    options = ("--delay-s", f"{lag_s / 2:g}", "--idle-s", "0")
    assert (
        run_cli("follow", log, "--sensor", out, "--out", live, *options) == 0
    )  # no gap where rows are 5 s apart
    followed = written(live)
    error = np.interp(t, followed["time_s"], followed["T_degC"]) - truth
    assert np.sqrt(np.mean(error[settled] ** 2)) < 0.3 * np.sqrt(np.mean((y - truth)[settled] ** 2))


@pytest.mark.long
@pytest.mark.e2e
@pytest.mark.parametrize("lag_s", LONG_S)
def test_a_model_of_identify_is_a_sensor(lag_s: float, tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    dt_s, count = 60.0, 600
    heater = np.repeat(rng.integers(0, 2, count // 30) * 40.0, 30) + 20.0
    y = Chain(lag_s).response(heater, dt_s, "zoh") + 0.05 * rng.standard_normal(count)
    log = write(tmp_path / "heat.csv", time_s=dt_s * np.arange(count), heater=heater, T_degC=y)
    out = tmp_path / "i.json"
    assert (
        run_cli("identify", log, "-u", "heater", "-y", "T_degC", "--model", "P1", "--out", out) == 0
    )
    check_file(out, "T_degC", lag_s)
    assert run_cli("compensate", log, "--sensor", out, "--out", tmp_path / "o.csv") == 0


@pytest.mark.long
@pytest.mark.e2e
def test_a_pair_a_current_and_process_noise_give_long_lags(tmp_path: Path) -> None:
    out = tmp_path / "s.sensor.json"
    t, a, b, _ = two_in_a_gas(6, (0.15, 0.5), 0.02, 1500, (0.3, 0.3))
    log = write(
        tmp_path / "gas.csv", time_s=np.round(6000 * t, 3), A_degC=a, B_degC=b
    )  # 900 and 3000 s
    columns = ("--column", "A", "--column", "B")
    assert run_cli("sensor", "pair", log, *columns, "--bare", "--out", out) == 0
    check_file(out, "A_degC", 900.0)
    check_file(out, "B_degC", 3000.0)
    rng = np.random.default_rng(7)
    probe = Sheath.drawn(rng)
    t, y, power = probe.heated(rng, 0.005)
    log = write(
        tmp_path / "lcsr.csv", time_s=900 / probe.lag_s * t, R_degC=20 + y, I_mA=40 * np.sqrt(power)
    )
    assert (
        run_cli(
            *("sensor", "current", log, "--column", "R", "--current", "I_mA"),
            *("--out", out, "--overwrite"),
        )
        == 0
    )
    check_file(out, "R_degC", 900.0)
    t, y = fluctuating(8, (1.0,), 0.1, 8000, 0.05)
    log = write(tmp_path / "noise.csv", time_s=np.round(1800 * t, 3), T_degC=y)
    assert run_cli("sensor", "noise", log, "--column", "T", "--out", out, "--overwrite") == 0
    check_file(out, "T_degC", 1800.0)


def test_a_dead_time_of_minutes_is_written_and_read(tmp_path: Path) -> None:
    out = tmp_path / "s.sensor.json"
    command = (
        "sensor",
        "new",
        "--tau-s",
        "900+-10",
        "--dead-time-s",
        "240+-5",
        "--column",
        "T",
        "--out",
        out,
    )
    assert run_cli(*command) == 0
    assert read_sensor(out).chains[0].delay_s == pytest.approx(240.0)


def test_a_lag_beyond_the_limit_is_an_error_that_names_it(tmp_path: Path) -> None:
    out = tmp_path / "s.sensor.json"
    assert run_cli("sensor", "new", "--tau-s", "2e7", "--column", "T", "--out", out) == 2
    assert not out.exists()
    with pytest.raises(InputError, match=r"T: a time of 2e\+07 s .*below 1e\+07 s"):
        sensor_file("s", {"T": Chain(2 * MAX_LAG_S)}, "plunge", np.eye(1), [0.0])
    with pytest.raises(InputError, match="delay_s"):
        compensate_table(tmp_path / "log.csv", [], tmp_path / "o.csv", delay_s=2 * MAX_LAG_S)
    data = json.loads(_stored(tmp_path).read_text())
    data["chain"]["channels"]["T"]["taus_s"] = [2 * MAX_LAG_S]
    (tmp_path / "long.json").write_text(json.dumps(data))
    with pytest.raises(InputError, match=r"taus_s.*less than"):
        read_sensor(tmp_path / "long.json")


def _stored(folder: Path) -> Path:
    """A sensor file."""
    out = folder / "stored.sensor.json"
    assert run_cli("sensor", "new", "--tau-s", "900+-10", "--column", "T", "--out", out) == 0
    return out


@pytest.mark.parametrize("variance", [0.0, np.nan, np.inf])
@pytest.mark.parametrize("method", ["plunge", "pair", "current", "noise"])
def test_a_measured_lag_without_an_uncertainty_is_an_error(method, variance: float) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(InputError, match="does not determine the lag of T"):
        sensor_file("s", {"T": Chain(1.5)}, method, np.array([[variance]]), [0.0])


@pytest.mark.parametrize("dt_s", [1e-300, 1e-9])
def test_rows_of_less_than_a_tenth_of_a_microsecond_are_an_error(dt_s: float) -> None:
    t = dt_s * np.arange(400)
    y = 20 + 60 * (1 - np.exp(-np.clip(np.arange(400) - 60, 0, None) / 30))
    with pytest.raises(InputError, match="rows every"):
        plunge_sensor(t, y, "T", medium_s=(0.0, 0.0))
