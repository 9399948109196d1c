"""Sensors as a caller gives them: lags, chains, paths and files, alone or by column."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import tcdyn
from tcdyn.chain import Chain
from tcdyn.core.errors import InputError
from tcdyn.sensors import specified_sensor, write_sensor
from tcdyn.sensors.given import sensor_files
from tcdyn.workflows.compensate_table import compensate_table
from tcdyn.workflows.follow import follow

LAG_S = 8.0
TABLE = pd.DataFrame(
    {
        "time_s": np.arange(120.0),
        "T1 [°C]": 20 + 80 * (1 - np.exp(-np.arange(120) / LAG_S)),
        "state": "heating",
    }
)
EXACT = "without an uncertainty"


def by_file(u_s: float = 0.5) -> pd.DataFrame:
    """The result with a sensor file."""
    return tcdyn.compensate_frame(TABLE, specified_sensor("s", ["T1"], [(LAG_S, u_s)]))


def compensated(sensors: Any, **options: Any) -> pd.DataFrame:
    """The result with sensors of any form."""
    return tcdyn.compensate_frame(TABLE, sensors, **options)


@pytest.mark.parametrize(
    "sensors",
    [
        (LAG_S, 0.5),
        "8+-0.5",
        "8 ± 0.5 s",
        [(LAG_S, 0.5)],
        {"T1": (LAG_S, 0.5)},
        {"T1 [°C]": "8.0+-0.5"},
        {"T1": specified_sensor("s", ["other"], [(LAG_S, 0.5)])},
        {"T1": specified_sensor("s", ["T9", "T1"], [(LAG_S, 0.5)])},
    ],
)
def test_every_form_gives_the_result_of_the_sensor_file(sensors: Any) -> None:
    pd.testing.assert_frame_equal(compensated(sensors), by_file())


def test_a_path_alone_or_by_column(tmp_path: Path) -> None:
    path = write_sensor(specified_sensor("s", ["T1"], [(LAG_S, 0.5)]), tmp_path / "s.sensor.json")
    for sensors in (path, str(path), [path], {"T1": path}, {"T1": str(path)}):
        pd.testing.assert_frame_equal(compensated(sensors), by_file())


def test_a_lag_without_uncertainty_and_a_chain_are_exact_with_a_warning() -> None:
    results = []
    for sensors in (LAG_S, np.float64(LAG_S), 8, Chain(LAG_S)):
        with pytest.warns(UserWarning, match=EXACT):
            results.append(compensated(sensors))
    for result in results[1:3]:
        pd.testing.assert_frame_equal(result, results[0])
    known = results[3]
    u_known, u_stated, with_u = known["T1_u_K"], results[0]["T1_u_K"], by_file()["T1_u_K"]
    assert (u_known <= u_stated).all()
    assert (u_stated <= with_u).all()
    assert u_known.max() < 0.5 * with_u.max()
    away_K = np.abs(known["T1 [°C]"] - results[0]["T1 [°C]"])
    assert (away_K < 3 * u_stated + 1e-6).all()


def test_a_lag_of_several_columns_needs_their_names() -> None:
    two = TABLE.assign(**{"T2 [°C]": TABLE["T1 [°C]"]})
    with pytest.raises(InputError, match=r"'T1 \[°C\]', 'T2 \[°C\]'.*expected columns="):
        tcdyn.compensate_frame(two, (LAG_S, 0.5))
    done = tcdyn.compensate_frame(two, (LAG_S, 0.5), columns=["T1", "T2"])
    np.testing.assert_array_equal(done["T1 [°C]"], done["T2 [°C]"])
    one = tcdyn.compensate_frame(two, (LAG_S, 0.5), columns="T2")
    assert "T1_u_K" not in one
    assert "T2_u_K" in one
    other = tcdyn.compensate_frame(two, {"T1": (LAG_S, 0.5), "T2": (2 * LAG_S, 0.5)})
    assert np.abs(other["T1 [°C]"] - other["T2 [°C]"]).max() > 1


def test_a_series_is_compensated_with_a_lag() -> None:
    series = TABLE.set_index("time_s")["T1 [°C]"]
    done = tcdyn.compensate_frame(series, (LAG_S, 0.5))
    np.testing.assert_array_equal(done["T1 [°C]"], by_file()["T1 [°C]"])


def test_files_are_compensated_followed_and_viewed_with_a_lag(tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    TABLE.to_csv(log, index=False)
    parts: list[pd.DataFrame] = []
    compensate_table(log, (LAG_S, 0.5), parts.append)
    expected = by_file()["T1 [°C]"].to_numpy()
    np.testing.assert_allclose(pd.concat(parts)["T1 [°C]"], expected, atol=1e-3)
    state = tmp_path / "state.json"
    out = tmp_path / "followed.csv"
    for _ in range(2):  # a second run continues: the time of the call is no part of its state
        run = follow(log, (LAG_S, 0.5), out, state=state, idle_s=0.0, poll_s=0.0)
        assert run.log is not None
        assert list(run.log.channels.units) == ["T1 [°C]"]
    page, _ = tcdyn.view(log, {"T1": (LAG_S, 0.5)}, open_browser=False)
    assert "compensated" in page.read_text(encoding="utf-8")


def test_variables_of_xarray_are_compensated_with_a_lag() -> None:
    xr = pytest.importorskip("xarray")
    time = {"time_s": TABLE["time_s"].to_numpy()}
    array = xr.DataArray(TABLE["T1 [°C]"].to_numpy(), dims="time_s", coords=time, name="T1 [°C]")
    done = tcdyn.compensate_dataset(array, (LAG_S, 0.5))
    np.testing.assert_array_equal(done["T1 [°C]"], by_file()["T1 [°C]"])


@pytest.mark.parametrize(
    ("sensors", "message"),
    [
        (None, "sensors is None; expected a sensor file"),
        (True, "sensors is True"),
        (TABLE, "sensors is a DataFrame"),
        ({1, 2}, "sensors is a set"),
        ([None], "a sensor is None"),
        ([LAG_S, LAG_S], "without its column; expected a dict"),
        ({1: LAG_S}, "sensors has the key 1"),
        ({"T1": None}, "a sensor is None"),
        ({"T1": TABLE}, "a sensor is a DataFrame"),
        (-3.0, "a lag of -3"),
        (float("nan"), "a lag of nan"),
        ("8+--1", "a lag of 8 .* -1 s"),
        ("nothing.sensor.json", "nothing.sensor.json"),
        ({"T9": LAG_S}, "column 'T9' is missing"),
    ],
)
def test_what_is_no_sensor_is_refused_in_one_line(sensors: Any, message: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(InputError, match=message) as caught:
            compensated(sensors)
    assert "\n" not in str(caught.value)


def test_the_lag_of_a_sensor_is_read_by_name() -> None:
    sensor = specified_sensor("s", ["TE5 (°C)", "TE6*"], [(1.5, 0.1)])
    assert sensor["TE5"].lag_s.value == sensor["TE6 [K]"].lag_s.value == 1.5
    with pytest.raises(InputError, match=r"2 columns.*sensor\['TE5"):
        sensor.lag_s  # noqa: B018
    with pytest.raises(InputError, match="'TE7' is missing"):
        sensor["TE7"]
    (stated,) = sensor_files((2.5, 0.25))
    assert (stated.lag_s.value, stated.lag_s.u) == (2.5, 0.25)
