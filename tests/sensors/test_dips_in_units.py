"""Several dips of one sensor whose tables have different units."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tcdyn import sensor_from_dip
from tcdyn.core.errors import InputError
from tcdyn.sensors import read_sensor
from tcdyn.series.thermocouple_types import emf_mV

LAG_S = 4.0


def dip(seed: int) -> pd.DataFrame:
    """A dip from 21 to 67 degC at 5 s, two rows a second."""
    rng = np.random.default_rng(seed)
    t = 0.5 * np.arange(100)
    rise = np.where(t > 5, 1 - np.exp(-(t - 5) / LAG_S), 0.0)
    reading = 21 + 46 * rise + rng.normal(0, 0.1, len(t))
    return pd.DataFrame({"Time (s)": t, "degC": reading})


def write(folder: Path, seed: int, column: str, unit: str) -> Path:
    """A dip in a unit, in a column of this name."""
    table = dip(seed)
    reading = table.pop("degC").to_numpy()
    in_units = {
        "degC": reading,
        "degF": 1.8 * reading + 32,
        "K": reading + 273.15,
        "mV": emf_mV(reading, "K"),
    }
    path = folder / f"dip{seed}.csv"
    table.assign(**{column: in_units[unit]}).to_csv(path, index=False)
    return path


@pytest.mark.long
@pytest.mark.e2e
@pytest.mark.parametrize(
    ("column", "unit"),
    [("T1 (F)", "degF"), ("T1 [K]", "K"), ("T1 [mV]", "mV"), ("T1_degF", "degF")],
)
def test_dips_in_other_units_give_what_they_give_in_one(tmp_path, column, unit):
    couple = {"couple": "K"} if unit == "mV" else {}
    first = write(tmp_path, 0, "T1 (C)", "degC")
    in_other_unit = sensor_from_dip([first, write(tmp_path, 1, column, unit)], "T1", **couple)
    in_one_unit = sensor_from_dip([first, write(tmp_path, 1, "T1 (C)", "degC")], "T1")
    lag = in_other_unit.chain.channels["T1 (C)"].lag_s
    expected = in_one_unit.chain.channels["T1 (C)"].lag_s
    assert lag.value == pytest.approx(expected.value, rel=1e-4)
    assert lag.u == pytest.approx(expected.u, rel=1e-3)
    assert abs(lag.value - LAG_S) < 2 * lag.u
    in_other_unit.write(tmp_path / "probe.sensor.json")
    assert read_sensor(tmp_path / "probe.sensor.json").columns == ["T1 (C)"]


@pytest.mark.e2e
def test_other_sensors_and_other_quantities_are_refused(tmp_path):
    first = write(tmp_path, 0, "T1 (C)", "degC")
    other = write(tmp_path, 1, "T2 (C)", "degC")
    with pytest.raises(InputError, match=r"T1 \(C\), T2 \(C\)"):
        sensor_from_dip([first, other])
    level = write(tmp_path, 1, "T1 [kPa]", "degC")
    with pytest.raises(InputError, match="T1"):
        sensor_from_dip([first, level], "T1")


def test_a_couple_without_millivolts_in_any_dip_is_refused(tmp_path):
    dips = [write(tmp_path, 0, "T1 (C)", "degC"), write(tmp_path, 1, "T1 (F)", "degF")]
    with pytest.raises(InputError, match="no column is in mV"):
        sensor_from_dip(dips, "T1", couple="K")
