"""Columns of a compensated table: their names, order and decimals; the rate of change."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import tcdyn
from tcdyn.core.errors import InputError
from tcdyn.sensors import specified_sensor
from tcdyn.sensors.compensation import CompensationMethod
from tcdyn.sensors.decimals import decimals_for, rounded_for_file
from tcdyn.series.units import Unit
from tcdyn.workflows.compensate_table import compensate_table
from tcdyn.workflows.follow import follow
from tests.sensors.sensor_world import logged, write, written

LAG_S = 1.5
DT_S = 0.1
PROBE = specified_sensor("probe", ["T"], [(LAG_S, 0.05)])


def log_of(folder: Path, rows: int = 600, name: str = "T_degC") -> Path:
    """A log with one column of temperature."""
    t, _, y = logged((LAG_S,), DT_S, rows, 0.1, 3)
    return write(folder / "log.csv", time_s=np.round(t, 3), **{name: y.round(3)}, power_kW=t * 0)


@pytest.mark.parametrize(
    ("unit", "column", "names"),
    [
        (Unit(), "T_degC", ["T_logged_degC", "T_degC", "T_u_K", "T_rate_K_s", "T_rate_u_K_s"]),
        (Unit("mV", "K"), "T1_mV", ["T1_logged_mV", "T1_degC", "T1_u_K", "T1_rate_K_s"]),
        (Unit("mV", "none"), "U_mV", ["U_logged_mV", "U_mV", "U_u_mV", "U_rate_mV_s"]),
        (Unit(), "T1 [°C]", ["T1_logged [°C]", "T1 [°C]", "T1_u_K", "T1_rate_K_s"]),
        (Unit("degF"), "a (°F)", ["a_logged (°F)", "a (°F)", "a_u_degF", "a_rate_degF_s"]),
        (Unit("ppm"), "x_ppm", ["x_logged_ppm", "x_ppm", "x_u_ppm", "x_rate_ppm_s"]),
        (Unit(), "gas", ["gas_logged", "gas", "gas_u_K", "gas_rate_K_s", "gas_rate_u_K_s"]),
        (Unit(), "T1/°C", ["T1_logged/°C", "T1/°C", "T1_u_K", "T1_rate_K_s"]),
    ],
)
def test_the_columns_of_a_sensor_have_names_of_one_pattern(unit, column, names):
    assert CompensationMethod(rate=True).output_names(unit, column)[: len(names)] == names
    assert CompensationMethod(method="noise-only").output_names(unit, column) == names[:2]


def test_the_columns_of_a_sensor_stand_together_and_the_logged_one_is_unchanged(tmp_path):
    log = log_of(tmp_path)
    done = compensate_table(log, [PROBE], tmp_path / "out.csv", rate=True)
    made = written(done.path)
    results = ["T_degC", "T_u_K", "T_rate_K_s", "T_rate_u_K_s"]
    assert list(made) == ["time_s", "T_logged_degC", *results, "power_kW"]
    raw = pd.read_csv(log)
    assert np.array_equal(made["T_logged_degC"], raw["T_degC"])
    assert json.loads(Path(f"{done.path}.meta.json").read_text())["schema"] == "tcdyn.table/2"
    frame = tcdyn.compensate_frame(raw, PROBE, rate=True)
    assert list(frame) == list(made)
    assert np.array_equal(rounded_for_file(frame, done.decimals, "a.csv")[results], made[results])


@pytest.mark.parametrize("taken", ["T_u_K", "T_rate_u_K_s"])
def test_a_name_that_the_log_has_already_is_an_error(tmp_path, taken):
    raw = pd.read_csv(log_of(tmp_path)).assign(**{taken: 1.0})
    with pytest.raises(InputError, match=f"'{taken}'"):
        tcdyn.compensate_frame(raw, PROBE, rate=True)


def test_a_rate_where_the_lag_remains_is_an_error():
    with pytest.raises(InputError, match="rate"):
        CompensationMethod(method="noise-only", rate=True)


@pytest.mark.parametrize(
    ("u", "decimals"),
    [(0.5, 2), (0.1, 2), (0.099, 3), (1.0, 1), (10.0, 0), (500.0, 0), (3e-6, 7), (1e-15, 12)],
)
def test_the_last_decimal_is_at_most_a_tenth_of_u(u, decimals):
    assert decimals_for(np.array([20.0, 300.0]), np.array([2 * u, u, np.nan])) == decimals


def test_numbers_of_a_small_unit_keep_their_digits():
    ampere = np.array([3.21e-13, np.nan])
    count = decimals_for(ampere, np.array([2e-16, np.nan]))
    assert count is not None
    assert np.round(ampere, count)[0] == pytest.approx(3.21e-13, rel=1e-9)


def test_the_decimals_of_a_file_follow_from_the_smallest_uncertainty(tmp_path):
    done = compensate_table(log_of(tmp_path), [PROBE], tmp_path / "out.csv", rate=True)
    made = written(done.path)
    for value, u in (("T_degC", "T_u_K"), ("T_rate_K_s", "T_rate_u_K_s")):
        count = done.decimals[value]
        assert count == done.decimals[u] == decimals_for(made[value].to_numpy(), made[u].to_numpy())
        for name in (value, u):
            assert np.array_equal(made[name], made[name].round(count))
            assert not np.array_equal(made[name], made[name].round(count - 1))
    exact = compensate_table(tmp_path / "log.csv", [PROBE], tmp_path / "out.parquet", rate=True)
    whole = pd.read_parquet(exact.path)
    assert not np.array_equal(whole["T_degC"], made["T_degC"])
    assert np.array_equal(
        rounded_for_file(whole, exact.decimals, "a.csv")["T_degC"], made["T_degC"]
    )


@pytest.mark.e2e
def test_a_followed_log_has_the_rates_and_decimals_of_the_finished_one(tmp_path):
    log = log_of(tmp_path, 900)
    live = tmp_path / "live.csv"
    lines = log.read_bytes().splitlines(keepends=True)
    growing = tmp_path / "growing.csv"
    options = {"delay_s": 4.0, "rate": True, "idle_s": 0.0, "sleep": lambda _: None}
    for rows in (120, 500, len(lines)):  # stopped and continued
        growing.write_bytes(b"".join(lines[:rows]))
        follow(growing, [PROBE], live, state=tmp_path / "state.json", **options)
    assert len(json.loads((tmp_path / "state.json").read_text())["decimals"]) == 4
    done = compensate_table(log, [PROBE], tmp_path / "out.csv", delay_s=4.0, rate=True)
    assert live.read_bytes() == done.path.read_bytes()
    with pytest.raises(InputError, match="another rate"):
        follow(growing, [PROBE], live, state=tmp_path / "state.json", **options | {"rate": False})
