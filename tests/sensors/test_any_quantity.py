"""Gas sensors, humidity probes, pressure lines and voltages: each column by its own unit."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import tcdyn
from tcdyn.chain import Chain
from tcdyn.core.errors import InputError
from tcdyn.rig.static_line import StaticLine
from tcdyn.sensors import (
    SensorFile,
    read_sensor,
    sensor_file,
    sensor_from_current,
    sensor_from_dip,
    sensor_from_noise,
    sensor_from_pair,
)
from tcdyn.series.thermocouple_types import emf_mV
from tcdyn.smoothing import smooth
from tcdyn.workflows.compensate_table import compensate_table
from tcdyn.workflows.follow import follow
from tests.cli.test_main_job import tcdyn as run_cli
from tests.report.test_view import charts_of
from tests.sensors.sensor_world import (
    Array,
    fluctuating,
    lagged,
    logged,
    two_in_a_gas,
    write,
    written,
)

DT_S = 0.5
LAG_S = 4.0
# Level and size of a swing of 20 in ``sensor_world.fluid``, by unit.
QUANTITIES = {
    "ppm": (400.0, 20.0),
    "%RH": (40.0, 0.5),
    "Pa": (101_325.0, 300.0),
    "V": (2.5, 0.02),
    "mbar": (-3_000.0, 20.0),
}


def readings_in(unit: str, seed: int = 1, n: int = 600) -> tuple[Array, Array, Array]:
    """Time [s], quantity and reading (N,) of a sensor of ``LAG_S`` in a unit."""
    level, size = QUANTITIES[unit]
    t, x, y = logged((LAG_S,), DT_S, n, 0.1, seed)
    return t, level + size * (x - 200), level + size * (y - 200)


def probe(column: str, lag_s: float = LAG_S) -> SensorFile:
    """A sensor file with a lag that is known to 1 %."""
    variance = np.array([[(0.01 * lag_s) ** 2]])
    return sensor_file("probe", {column: Chain(lag_s)}, "stated", variance, [0.0])


def dip(unit: str, seed: int = 3) -> tuple[Array, Array]:
    """Time [s] and readings (N,) of a step of 40 units of ``QUANTITIES`` at 10 s."""
    level, size = QUANTITIES[unit]
    t = 0.05 * np.arange(1200)
    y = lagged(np.where(t > 10, 1.0, 0.0), (1.5,), 0.05)
    return t, level + size * (40 * y + np.random.default_rng(seed).normal(0, 0.05, len(t)))


def coverage(done: pd.DataFrame, column: str, u: str, truth: Array) -> float:
    """Share of the rows whose 95 % band holds the truth."""
    return float(np.mean(np.abs(done[column] - truth) < 1.96 * done[u]))


@pytest.mark.e2e
@pytest.mark.parametrize("unit", QUANTITIES)
def test_a_quantity_is_compensated_in_its_unit_and_the_band_holds_the_truth(
    tmp_path: Path, unit: str
) -> None:
    t, truth, y = readings_in(unit)
    log = write(tmp_path / "log.csv", time_s=t, **{f"slow_{unit}": y})
    made = compensate_table(log, [probe(f"slow_{unit}")], tmp_path / "out.csv")
    done = written(made.path)
    assert list(done) == ["time_s", f"slow_logged_{unit}", f"slow_{unit}", f"slow_u_{unit}"]
    assert coverage(done, f"slow_{unit}", f"slow_u_{unit}", truth) > 0.9
    before = np.sqrt(np.mean((y - truth) ** 2))
    after = np.sqrt(np.mean((done[f"slow_{unit}"] - truth) ** 2))
    assert after < 0.1 * before
    assert made.warnings == ()
    said = f"{made.summary()} {' '.join(f.sentence for f in made.findings)}"
    assert f" {unit} typical" in said
    assert " K" not in said
    assert "degC" not in said
    assert made.to_dict()["columns"][0]["unit"] == unit
    assert "_K" not in json.dumps(made.to_dict()["columns"])


def test_columns_of_one_file_are_compensated_each_in_its_unit(tmp_path: Path) -> None:
    t, gas, read_gas = readings_in("ppm", 5)
    _, temperature, read_temperature = logged((LAG_S,), DT_S, len(t), 0.1, 6)
    columns = {"T1 [°C]": read_temperature, "CO2 [ppm]": read_gas}
    log = write(tmp_path / "log.csv", time_s=t, **columns)
    sensors = [probe("T1"), probe("CO2")]
    made = compensate_table(log, sensors, tmp_path / "out.csv")
    done = written(made.path)
    of_temperature = ["T1_logged [°C]", "T1 [°C]", "T1_u_K"]
    assert list(done) == ["time_s", *of_temperature, "CO2_logged [ppm]", "CO2 [ppm]", "CO2_u_ppm"]
    assert coverage(done, "T1 [°C]", "T1_u_K", temperature) > 0.9
    assert coverage(done, "CO2 [ppm]", "CO2_u_ppm", gas) > 0.9
    assert [row["unit"] for row in made.to_dict()["columns"]] == ["K", "ppm"]
    # a code of an open thermocouple is one, the same number of ppm is a reading
    read_temperature[100] = 4000.0
    log = write(tmp_path / "log.csv", time_s=t, **columns)
    made = compensate_table(log, sensors, tmp_path / "out.csv")
    assert {f.subject for f in made.findings if f.code == "series.codes"} == {"T1 [°C]"}


@pytest.mark.e2e
@pytest.mark.parametrize(
    ("names", "units"),
    [("CO2,RH", "s,ppm,%RH"), ("Druck,Spannung", "s,Pa,V"), ("p,U", "s,hPa,Volt")],
)
def test_a_row_of_units_states_any_unit(tmp_path: Path, names: str, units: str) -> None:
    t, _, y = readings_in("Pa")
    rows = "\n".join(f"{time},{value},{value}" for time, value in zip(t, y))
    log = tmp_path / "log.csv"
    log.write_text(f"time,{names}\n{units}\n{rows}\n", encoding="utf-8")
    columns = names.split(",")
    made = compensate_table(log, [probe(n) for n in columns], tmp_path / "out.csv")
    stated = [unit.replace("Volt", "V") for unit in units.split(",")[1:]]
    assert [column.unit.name for column in made.columns] == stated
    assert "sensor.unit_assumed" not in {f.code for f in made.findings}


@pytest.mark.e2e
def test_the_result_does_not_depend_on_the_prefix_of_the_unit() -> None:
    """Of volts and microvolts, and of pascals and bars, compensated and of a dip."""
    t, _, y = readings_in("V")
    frame = pd.DataFrame({"time_s": t, "U_V": y, "U_uV": 1e6 * y, "U_kV": 1e-3 * y})
    done = tcdyn.compensate_frame(frame, [probe(name) for name in ("U_V", "U_uV", "U_kV")])
    for name, factor in (("U_uV", 1e6), ("U_kV", 1e-3)):
        np.testing.assert_allclose(done[name], factor * done["U_V"], rtol=1e-6)
        u = done[f"U_u_{name[2:]}"] / (factor * done["U_u_V"])
        # the maximum of the likelihood is found to this tolerance
        np.testing.assert_allclose(u, 1.0, rtol=1e-2)
    time_s, reading = dip("V")
    lags = [
        sensor_from_dip((time_s, factor * reading), unit=unit).fit["lag_s"]["value"]
        for factor, unit in ((1.0, "V"), (1e6, "uV"), (1e-3, "kV"))
    ]
    np.testing.assert_allclose(lags, lags[0], rtol=1e-4)


def test_the_lags_of_a_pair_do_not_depend_on_the_prefix_of_the_unit() -> None:
    t, first, second, _ = two_in_a_gas(2, (0.1, 0.3), 0.02, 2000, (0.1, 0.1))
    pairs = [
        sensor_from_pair((t, factor * first, factor * second), bare=True, unit=unit)
        for factor, unit in ((1e-6, "V"), (1.0, "uV"), (1e3, "nV"))
    ]
    lags = [[pair.chain.channels[name].lag_s.value for name in pair.columns] for pair in pairs]
    np.testing.assert_allclose(lags, [lags[0]] * 3, rtol=1e-4)


@pytest.mark.e2e
@pytest.mark.parametrize("unit", QUANTITIES)
def test_the_lag_of_a_sensor_of_any_quantity_is_measured_by_a_dip(
    tmp_path: Path, unit: str
) -> None:
    time_s, reading = dip(unit)
    sensor = sensor_from_dip((time_s, reading), unit=unit)
    lag = sensor.chain.channels["reading"].lag_s
    assert abs(lag.value - 1.5) < 3 * lag.u + 0.02
    size = 40 * QUANTITIES[unit][1]
    assert sensor.fit["unit"] == unit
    assert sensor.fit["step"] == pytest.approx(size, rel=0.01)
    assert not [key for key in sensor.fit if key.endswith("_K")]
    assert f"{unit}" in sensor.summary()
    assert " K" not in sensor.summary()
    assert read_sensor(sensor.write(tmp_path / "probe.sensor.json")).fit == sensor.fit


@pytest.mark.e2e
def test_several_dips_pairs_and_noise_of_another_quantity() -> None:
    dips = [
        pd.Series(y, pd.Index(t, name="time_s"), name="CO2_ppm")
        for t, y in (dip("ppm", 3), dip("ppm", 4))
    ]
    pooled = sensor_from_dip(dips)
    assert [one["direction"] for one in pooled.fit["dips"]] == ["rising", "rising"]
    t, first, second, _ = two_in_a_gas(2, (0.1, 0.3), 0.02, 2000, (0.1, 0.1))
    pair = sensor_from_pair((t, 50 * first + 1e5, 50 * second + 1e5), bare=True, unit="Pa")
    lags = [pair.chain.channels[name].lag_s for name in pair.columns]
    for lag, truth in zip(lags, (0.1, 0.3)):
        assert abs(lag.value - truth) < 3 * lag.u
    assert pair.fit["unit"] == "Pa"
    time_s, reading = fluctuating(3, (1.0,), 0.1, 4000, 0.01)
    noise = sensor_from_noise((time_s, reading), unit="%RH")
    assert noise.fit["unit"] == "%RH"
    assert {"fluctuation", "logger"} <= set(noise.fit)


@pytest.mark.parametrize(
    "options", [{"medium": "water", "diameter_mm": 3.0}, {"junction": "grounded"}]
)
def test_heat_transfer_is_refused_for_another_quantity(options: dict[str, object]) -> None:
    with pytest.raises(InputError, match="in ppm"):
        sensor_from_dip(dip("ppm"), unit="ppm", **options)


def test_what_only_a_temperature_has_is_refused_for_another_quantity() -> None:
    t, y = dip("V")
    with pytest.raises(InputError, match="in V"):
        sensor_from_current((t, y, np.ones(len(t))), unit="V")
    line = StaticLine(
        gain=1.02, offset=-3.0, covariance=((1e-8, 0.0), (0.0, 1e-4)), range_degC=(-50.0, 900.0)
    )
    calibrated = probe("U_V").model_copy(update={"static": {"U_V": line}})
    with pytest.raises(InputError, match="static line is in degC"):
        tcdyn.compensate_frame(pd.DataFrame({"time_s": t, "U_V": y}), calibrated)


@pytest.mark.e2e
def test_a_hot_dip_gives_a_warning_about_radiation_only_in_degrees() -> None:
    t, y = dip("ppm")
    hot = 20 + (y - 400)
    assert "sensor.radiation" in {f.code for f in sensor_from_dip((t, hot), unit="degC").findings}
    codes = {f.code for f in sensor_from_dip((t, hot), unit="ppm").findings}
    assert "sensor.radiation" not in codes


def test_readings_far_beyond_a_thermocouple_are_no_codes_and_overloads_are(tmp_path: Path) -> None:
    t, _, y = readings_in("Pa")
    y[[50, 51, 200]] = 9.9e37
    log = write(tmp_path / "log.csv", time_s=t, p_Pa=y)
    made = compensate_table(log, [probe("p_Pa")], tmp_path / "out.csv")
    assert [(f.code, f.numbers["count"]) for f in made.findings if f.code == "series.codes"] == [
        ("series.codes", 3)
    ]
    assert np.isfinite(written(made.path)["p_Pa"]).all()


def test_drop_out_codes_of_another_quantity_are_missing(tmp_path: Path) -> None:
    t, truth, y = readings_in("Pa")
    lost = [*range(100, 125), *range(300, 320), *range(450, 470)]
    y[lost] = 0.0
    log = write(tmp_path / "log.csv", time_s=t, p_Pa=y)
    made = compensate_table(log, [probe("p_Pa")], tmp_path / "out.csv")
    (codes,) = [f for f in made.findings if f.code == "series.codes"]
    assert codes.numbers["count"] == len(lost)
    assert "0 Pa" in codes.sentence
    assert coverage(written(made.path), "p_Pa", "p_u_Pa", truth) > 0.9


@pytest.mark.e2e
def test_millivolts_that_are_no_thermocouple_pass_as_a_voltage() -> None:
    t, truth, y = readings_in("Pa")
    frame = pd.DataFrame({"time_s": t, "U_mV": y})
    with pytest.raises(InputError, match="'none' for another voltage"):
        tcdyn.compensate_frame(frame, probe("U_mV"))
    done = tcdyn.compensate_frame(frame, probe("U_mV"), couple="none")
    assert list(done) == ["time_s", "U_logged_mV", "U_mV", "U_u_mV"]
    assert coverage(done, "U_mV", "U_u_mV", truth) > 0.9
    assert done.attrs["warnings"] == []
    time_s, reading = dip("V")
    sensor = sensor_from_dip((time_s, 1e3 * reading), unit="mV", couple="none")
    assert sensor.fit["unit"] == "mV"


def test_a_unit_is_stated_in_python_and_xarray() -> None:
    t, truth, y = readings_in("ppm")
    series = pd.Series(y, pd.Index(t, name="time_s"), name="gas")
    done = tcdyn.compensate_frame(series, probe("gas"), unit="ppm")
    assert list(done) == ["gas_logged", "gas", "gas_u_ppm"]
    assert coverage(done, "gas", "gas_u_ppm", truth) > 0.9
    with pytest.raises(InputError, match=r"unit 'sausages'.*\[sausages\]"):
        tcdyn.compensate_frame(series, probe("gas"), unit="sausages")
    in_other_unit = tcdyn.compensate_frame(series, probe("gas"), unit="[a.u.]")
    assert list(in_other_unit) == ["gas_logged", "gas", "gas_u_a.u."]


def test_a_sensor_of_a_temperature_is_not_used_for_another_quantity_of_its_name() -> None:
    t, _, y = logged((LAG_S,), DT_S, 300, 0.1, 8)
    frame = pd.DataFrame({"time_s": t, "gas_kW": 5 + t / 100, "gas_degC": y})
    with pytest.raises(InputError, match="'gas' may be 'gas_kW' or 'gas_degC'"):
        tcdyn.compensate_frame(frame, probe("gas"))
    done = list(tcdyn.compensate_frame(frame, probe("gas_degC")))
    assert done == ["time_s", "gas_kW", "gas_logged_degC", "gas_degC", "gas_u_K"]
    power = list(tcdyn.compensate_frame(frame, probe("gas_MW")))
    assert power == ["time_s", "gas_logged_kW", "gas_kW", "gas_u_kW", "gas_degC"]


def test_a_unit_in_the_attributes_of_xarray_is_used() -> None:
    t, _, y = readings_in("%RH")
    xr = pytest.importorskip("xarray")
    time = {"time": ("time", t, {"units": "s"})}
    array = xr.DataArray(y, dims="time", coords=time, name="gas", attrs={"units": "%"})
    dataset = tcdyn.compensate_dataset(array, probe("gas"))
    assert list(dataset.data_vars) == ["gas_logged", "gas", "gas_u_%"]
    assert dataset["gas"].attrs["units"] == "%"


def test_smooth_takes_the_unit_from_the_name_or_as_given() -> None:
    t, _, y = readings_in("Pa")
    named = smooth(pd.Series(y, pd.Index(t, name="time_s"), name="p_Pa"), None, Chain(LAG_S))
    assert list(named.to_frame()) == ["p_Pa", "p_u_Pa"]
    stated = smooth(y, DT_S, Chain(LAG_S), units=["Pa"])
    np.testing.assert_array_equal(named.temperature, stated.temperature)
    assert not named.flags.any()
    assert " Pa typical" in stated.summary()
    assert "noise_sd" in stated.card()


@pytest.mark.e2e
def test_commands_take_any_unit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    time_s, reading = dip("ppm")
    step = write(tmp_path / "dip.csv", time_s=time_s, gas=reading)
    sensor = tmp_path / "gas.sensor.json"
    plunge = ("sensor", "plunge", step, "--column", "gas", "--unit", "ppm")
    assert run_cli(*plunge, "--out", sensor) == 0
    said = capsys.readouterr().out
    assert "step: 800" in said
    assert "ppm" in said
    assert " K" not in said
    assert run_cli(*plunge, "--medium", "water", "--diameter-mm", "3") == 2
    assert "--medium" in capsys.readouterr().err
    t, truth, y = readings_in("ppm")
    log = write(tmp_path / "log.csv", time_s=t, gas=y)
    given = (log, "--sensor", sensor, "--unit", "ppm")
    assert run_cli("compensate", *given, "--out", tmp_path / "out.csv", "--json") == 0
    record = json.loads(capsys.readouterr().out)
    assert record["columns"][0]["unit"] == "ppm"
    assert list(written(tmp_path / "out.csv")) == ["time_s", "gas_logged", "gas", "gas_u_ppm"]
    assert run_cli("view", *given, "--out", tmp_path / "page.html", "--no-open") == 0
    drawn = json.dumps(charts_of(tmp_path / "page.html"))
    assert "gas [ppm]" in drawn
    assert "temperature [" not in drawn
    assert truth.shape == y.shape


def test_a_growing_log_is_followed_in_its_unit(tmp_path: Path) -> None:
    t, _, y = readings_in("%RH")
    log = write(tmp_path / "log.csv", **{"time_s": t, "room_%RH": y})
    follow(log, [probe("room_%RH")], tmp_path / "out.csv", delay_s=10.0, idle_s=0.0)
    assert list(written(tmp_path / "out.csv")) == [
        "time_s",
        "room_logged_%RH",
        "room_%RH",
        "room_u_%RH",
    ]


def test_the_column_of_the_reference_junction_has_a_unit() -> None:
    t = np.arange(300.0)
    truth = 60 + 5 * np.sin(t / 30)
    emf = emf_mV(truth, "K") - emf_mV(np.array([5.0]), "K")
    results = []
    for name, value in (("CJ [°C]", 5.0), ("CJ [°F]", 41.0), ("CJ [K]", 278.15)):
        frame = pd.DataFrame({"time_s": t, "T1 [mV]": emf, name: value})
        options = {"columns": ["T1"], "couple": "K", "cold_junction": "CJ"}
        results.append(tcdyn.compensate_frame(frame, (2.0, 0.1), **options)["T1_degC"].to_numpy())
    for other in results[1:]:
        assert other == pytest.approx(results[0], abs=1e-6)
    expected = truth + 2.0 * np.gradient(truth, t)  # the reading lags the truth by 2 s
    assert results[0][30:-30] == pytest.approx(expected[30:-30], abs=0.05)
    with pytest.raises(InputError, match=r"'CJ \[V\]' is in V; expected a column of temperatures"):
        tcdyn.compensate_frame(frame.rename(columns={"CJ [K]": "CJ [V]"}), (2.0, 0.1), **options)


def test_a_unit_of_a_column_that_is_missing_is_refused() -> None:
    frame = pd.DataFrame({"time_s": np.arange(60.0), "T1": 20.0 + np.arange(60) % 7})
    with pytest.raises(InputError, match=r"column of a unit 'T9' is missing.*'T1'"):
        tcdyn.compensate_frame(frame, (2.0, 0.1), unit={"T9": "K"})


@pytest.mark.e2e
def test_a_dip_in_kelvins_has_no_doubt_about_its_unit() -> None:
    t, y = dip("ppm")
    reading = 295.0 + 58 * (y - y[0]) / (y[-1] - y[0])
    sensor = tcdyn.sensor_from_dip(pd.Series(reading, pd.Index(t, name="time_s"), name="T1 [K]"))
    assert "sensor.unit_doubt" not in [finding.code for finding in sensor.findings]
