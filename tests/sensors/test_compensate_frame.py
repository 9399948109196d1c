"""A table in memory gives the numbers of a file, with its own index."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import tcdyn
from tcdyn.chain import Chain
from tcdyn.core.errors import InputError
from tcdyn.sensors import sensor_file
from tcdyn.sensors.file import write_sensor
from tcdyn.workflows.compensate_table import compensate_table
from tests.sensors.sensor_world import fluid, logged, write, written

DT_S = 0.5
N = 300
START = pd.Timestamp("2026-03-29 01:58:00")
PROBE = sensor_file("probe", {"T1_degC": Chain(4.0)}, "stated", np.array([[0.01]]), [0.0])


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    time_s, _, reading = logged((4.0,), DT_S, N, 0.05, 11, rise_K=0.0)
    columns = {"time_s": time_s, "power_kW": 30.0, "T1_degC": reading, "step": np.arange(N)}
    return pd.DataFrame(columns)


@pytest.fixture(scope="module")
def from_file(table: pd.DataFrame, tmp_path_factory: pytest.TempPathFactory) -> pd.DataFrame:
    folder = tmp_path_factory.mktemp("frame")
    log = write(folder / "log.csv", **table)
    done = compensate_table(log, [PROBE], folder / "out.csv")
    made = written(done.path)
    made.attrs["decimals"] = done.decimals["T1_degC"]
    return made


INDICES = {
    "float seconds": lambda t: pd.Index(t),
    "milliseconds in the name": lambda t: pd.Index(np.rint(1e3 * t).astype(int), name="Time [ms]"),
    "dates": lambda t: START + pd.to_timedelta(t, "s"),
    "dates with zone, over a change of the clock": lambda t: (
        START.tz_localize("Europe/Berlin") + pd.to_timedelta(t, "s")
    ),
    "durations": lambda t: pd.to_timedelta(t, "s"),
    "durations that start late": lambda t: pd.to_timedelta(t + 3600, "s"),
}


@pytest.mark.parametrize("name", INDICES)
def test_any_index_of_time_gives_the_numbers_of_the_file_and_stays(table, from_file, name):
    index = INDICES[name](table["time_s"].to_numpy())
    frame = table.drop(columns="time_s").set_index(index)
    done = tcdyn.compensate_frame(frame, PROBE)
    assert done.index.identical(frame.index)
    assert list(done) == ["power_kW", "T1_logged_degC", "T1_degC", "T1_u_K", "step"]
    pd.testing.assert_series_equal(done["T1_logged_degC"], frame["T1_degC"], check_names=False)
    # the file has the decimals that u asks for, the frame all
    smallest_u = done["T1_u_K"].min()
    for column in ("T1_degC", "T1_u_K"):
        apart = np.abs(done[column].to_numpy() - from_file[column].to_numpy())
        assert 0.005 * smallest_u < apart.max() < 0.06 * smallest_u
    assert done["step"].dtype == frame["step"].dtype


def test_the_result_is_the_temperature_of_the_fluid(table):
    truth = fluid(table["time_s"].to_numpy(), rise_K=0.0)
    done = tcdyn.compensate_frame(table, PROBE)
    error = done["T1_degC"] - truth
    before = table["T1_degC"] - truth
    # the lag of 4 s leaves 10 K; noise of 0.05 K is amplified to a few tenths of a kelvin
    assert np.sqrt(np.mean(error**2)) < 0.05 * np.sqrt(np.mean(before**2))
    assert np.mean(np.abs(error) < 1.96 * done["T1_u_K"]) > 0.9


def test_a_column_of_time_is_found_or_named(table, from_file):
    expected = from_file["T1_degC"].to_numpy()
    results = ["T1_logged_degC", "T1_degC", "T1_u_K"]
    by_name = table.rename(columns={"time_s": "x"})
    dated = table.assign(time_s=START + pd.to_timedelta(table["time_s"], "s"))
    kept_rows = table[table["power_kW"] > 0]  # an index of integers numbers the rows
    for frame, time in ((table, None), (by_name, "x"), (dated, None), (kept_rows, None)):
        done = tcdyn.compensate_frame(frame, PROBE, time=time)
        assert np.array_equal(done["T1_degC"].round(from_file.attrs["decimals"]), expected)
        pd.testing.assert_frame_equal(done.drop(columns=results), frame.drop(columns="T1_degC"))


def test_a_series_is_compensated_whatever_its_name(table, from_file, tmp_path):
    path = write_sensor(PROBE, tmp_path / "probe.sensor.json")
    time = pd.to_timedelta(table["time_s"], "s")
    for name, expected in (("T1_degC", "T1_degC"), ("gas", "gas"), (None, "T1_degC")):
        series = pd.Series(table["T1_degC"].to_numpy(), time, name=name)
        done = tcdyn.compensate_frame(series, path)
        u_name = "gas_u_K" if name == "gas" else "T1_u_K"
        logged_name = "gas_logged" if name == "gas" else "T1_logged_degC"
        assert list(done) == [logged_name, expected, u_name]
        rounded = done[expected].round(from_file.attrs["decimals"])
        assert np.array_equal(rounded.to_numpy(), from_file["T1_degC"].to_numpy())


def test_other_columns_may_hold_anything(table):
    frame = table.assign(operator="A", phase=pd.Categorical(["heat"] * N), when=START)
    frame.index = pd.to_timedelta(table["time_s"], "s")
    done = tcdyn.compensate_frame(frame.drop(columns="time_s"), PROBE)
    for column in ("operator", "phase", "when"):
        pd.testing.assert_series_equal(done[column], frame[column])


def test_units_are_those_of_names_or_arguments(table, from_file):
    time = pd.Index(table["time_s"])
    kelvin = pd.Series(table["T1_degC"].to_numpy() + 273.15, time, name="gas")
    done = tcdyn.compensate_frame(kelvin, PROBE, unit="K")
    # the file is rounded
    rounding = 0.6 * 10.0 ** -from_file.attrs["decimals"]
    assert np.allclose(done["gas"] - 273.15, from_file["T1_degC"], rtol=0, atol=rounding)
    volts = pd.Series(0.04 * table["T1_degC"].to_numpy(), time, name="T1_mV")
    made = tcdyn.compensate_frame(volts, PROBE, couple="K")
    assert list(made) == ["T1_logged_mV", "T1_degC", "T1_u_K"]


def test_attributes_hold_the_metadata(table):
    frame = table.set_index(START.tz_localize("UTC") + pd.to_timedelta(table["time_s"], "s"))
    frame.attrs = {"operator": "someone", "runs": 3}
    done = tcdyn.compensate_frame(frame, PROBE)
    assert done.attrs["operator"] == "someone"
    assert done.attrs["runs"] == 3
    assert done.attrs["tcdyn"] == "compensated"
    assert done.attrs["start_time"] == "2026-03-29T01:58:00+00:00"
    assert "sensor probe" in done.attrs["lag_s of T1_degC"]
    assert done.attrs["warnings"] == []
    with pytest.raises(InputError, match="compensated already: its metadata"):
        tcdyn.compensate_frame(done, PROBE)
    done.attrs = {}
    with pytest.raises(InputError, match=r"compensated already: it has columns 'T1_degC'"):
        tcdyn.compensate_frame(done, PROBE)


def test_a_doubtful_result_warns(table):
    frame = table.copy()
    frame.loc[100:140, "T1_degC"] = 4000.0
    with pytest.warns(UserWarning, match="T1_degC"):
        done = tcdyn.compensate_frame(frame, PROBE)
    assert done.attrs["warnings"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda f: f.drop(columns="time_s"), "no time column"),
        (lambda f: f.iloc[:0], "no rows"),
        (lambda f: f.drop(columns="T1_degC"), "'T1_degC' is missing"),
        (lambda f: f.iloc[::-1], "backward"),
        (lambda f: pd.concat([f, f[["T1_degC"]]], axis=1), "stands twice"),
    ],
)
def test_what_is_not_clear_is_an_error(table, change, message):
    with pytest.raises(InputError, match=message):
        tcdyn.compensate_frame(change(table), PROBE)


def test_numbers_and_clocks_as_text_are_read_as_in_a_file(table, from_file):
    clock = (START + pd.to_timedelta(table["time_s"], "s")).dt.strftime("%Y-%m-%d %H:%M:%S.%f")
    frame = table.astype(str).assign(Uhrzeit=clock).drop(columns="time_s")
    done = tcdyn.compensate_frame(frame, PROBE)
    rounded = done["T1_degC"].round(from_file.attrs["decimals"])
    assert np.array_equal(rounded.to_numpy(), from_file["T1_degC"].to_numpy())
    with pytest.raises(InputError, match="holds text"):
        tcdyn.compensate_frame(table.assign(T1_degC="warm"), PROBE)


def test_datasets_and_arrays_of_xarray_keep_their_coordinates(table, from_file):
    xr = pytest.importorskip("xarray")
    time = START + pd.to_timedelta(table["time_s"].to_numpy(), "s")
    array = xr.DataArray(
        table["T1_degC"].to_numpy() + 273.15,
        coords={"time": time, "station": "kiln"},
        dims="time",
        name="gas",
        attrs={"units": "K", "long_name": "gas"},
    )
    dataset = array.to_dataset(name="T1_degC").assign(power=("time", np.ones(N)))
    for data, name in ((array, "gas"), (dataset, "T1_degC")):
        done = tcdyn.compensate_dataset(data, PROBE)
        assert done[name].attrs["long_name"] == "gas"
        assert done.attrs["start_time"] == START.isoformat()
        assert set(done.coords) == {"time", "station"}
        xr.testing.assert_identical(done["time"], data["time"])
        rounding = 0.6 * 10.0 ** -from_file.attrs["decimals"]
        assert np.allclose(done[name] - 273.15, from_file["T1_degC"], rtol=0, atol=rounding)
        logged = done["gas_logged" if name == "gas" else "T1_logged_degC"]
        assert logged.attrs.items() >= array.attrs.items()
        assert np.array_equal(logged, array)
    assert np.array_equal(done["power"], np.ones(N))
    with pytest.raises(InputError, match="dimensions"):
        tcdyn.compensate_dataset(array.expand_dims("x"), PROBE)
    with pytest.raises(InputError, match="no time column"):
        tcdyn.compensate_dataset(array.drop_vars("time"), PROBE)
