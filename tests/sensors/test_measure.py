"""The lag of a sensor from a file, a DataFrame, a Series or arrays: the same numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import signal

import tcdyn
from tcdyn.core.errors import InputError
from tcdyn.sensors import read_sensor

LAG_S = 1.5
ENTRY_S = 5.0
T_S = 0.05 * np.arange(400)
CLOCK = pd.date_range("2026-03-01 10:00", periods=len(T_S), freq="50ms")


def reading() -> np.ndarray:
    """Reading of a bare wire that is dipped from 20 to 80 degC at ``ENTRY_S`` [degC]."""
    rise = np.where(T_S > ENTRY_S, 1 - np.exp(-(T_S - ENTRY_S) / LAG_S), 0.0)
    return 20 + 60 * rise + np.random.default_rng(0).normal(0.0, 0.05, len(T_S))


def dips(folder: Path) -> dict[str, Any]:
    """The same dip in every form."""
    series = pd.Series(reading(), pd.Index(T_S, name="time_s"), name="T1_degC")
    series.to_csv(folder / "dip.csv")
    return {
        "file": folder / "dip.csv",
        "frame": series.reset_index(),
        "series": series,
        "clock": series.set_axis(CLOCK),
        "arrays": (T_S, reading()),
    }


@pytest.mark.e2e
def test_every_form_of_a_dip_gives_the_same_lag_which_is_the_true_one(tmp_path: Path) -> None:
    options = {"entry_s": (ENTRY_S, 0.01), "unit": "degC"}
    sensors = {
        form: tcdyn.sensor_from_dip(dip, name="probe", **options)
        for form, dip in dips(tmp_path).items()
    }
    lags = {form: s.to_frame()["lag_s"].iloc[0] for form, s in sensors.items()}
    first = sensors["file"].chain.channels["T1_degC"].lag_s
    assert first.contains(LAG_S)
    assert list(lags.values()) == pytest.approx([first.value] * len(lags), rel=1e-3)
    assert sensors["file"].inputs[0].file == "dip.csv"
    assert sensors["arrays"].inputs == []
    path = sensors["series"].write(tmp_path / "probe.sensor.json")
    assert read_sensor(path).to_dict() == sensors["series"].to_dict()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: tcdyn.sensor_from_dip(reading()), "ndarray.*tuple of times and arrays"),
        (lambda: tcdyn.sensor_from_dip((T_S, reading()[1:])), "arrays of the shapes"),
        (lambda: tcdyn.sensor_from_dip((T_S, reading()), medium="water"), "go together"),
        (lambda: tcdyn.sensor_from_dip((T_S, reading()), speed_m_s=1.0), "without medium"),
        (
            lambda: tcdyn.sensor_from_dip((T_S, reading()), junction="axis"),
            "insulated or grounded or exposed",
        ),
        (
            lambda: tcdyn.sensor_from_dip([(T_S, reading())] * 2, entry_s=5.0),
            "entry_s is given 1 times for 2 dips",
        ),
        (
            lambda: tcdyn.sensor_from_dip(pd.DataFrame({"time_s": T_S, "a": 1.0, "b": 2.0})),
            "2 columns; expected the name of one; give column=a",
        ),
        (
            lambda: tcdyn.sensor_from_pair((T_S, reading(), reading()), exponent=0.5),
            "without speed",
        ),
        (
            lambda: tcdyn.sensor_from_pair((T_S, reading(), reading()), ["a"]),
            "expected two columns",
        ),
    ],
)
def test_unusable_data_are_refused_with_a_hint(call: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        call()


def repeated(values: np.ndarray, period: int) -> np.ndarray:
    """A column with a new value every ``period`` rows."""
    return values[np.arange(len(values)) // period * period]


@pytest.mark.e2e
@pytest.mark.parametrize("entry_s", [None, (ENTRY_S, 0.02)])
def test_a_dip_of_a_column_with_repeated_values_has_the_true_lag(
    entry_s: tuple[float, float] | None,
) -> None:
    """With the repeats and a known entry the lag was 0.5 s too long at 20 rows."""
    t = 0.05 * np.arange(1200)
    rise = np.where(t > ENTRY_S, 1 - np.exp(-(t - ENTRY_S) / LAG_S), 0.0)
    y = 20 + 60 * rise + np.random.default_rng(1).normal(0.0, 0.05, len(t))
    sensor = tcdyn.sensor_from_dip((t, repeated(y, 20)), "T1", entry_s=entry_s)
    lag = sensor.chain.channels["T1"].lag_s
    assert abs(lag.value - LAG_S) < 3 * lag.u
    assert lag.u < 0.06
    assert "series.repeats" in {f.code for f in sensor.findings}


@pytest.mark.e2e
def test_the_noise_of_a_column_with_repeated_values_is_that_of_its_new_values() -> None:
    rng = np.random.default_rng(3)
    keep = np.exp(-0.01)
    y = signal.lfilter([1 - keep], [1, -keep], rng.normal(0, 8, 60_000))[::5] + 50
    y += rng.normal(0, 0.005, len(y))
    t = 0.05 * np.arange(len(y))
    rare = tcdyn.sensor_from_noise((t[::5], y[::5]), "T1").fit["lag_s"]
    assert tcdyn.sensor_from_noise((t, repeated(y, 5)), "T1").fit["lag_s"] == rare
    is_new = rng.random(len(y)) < 0.2
    rows = np.maximum.accumulate(np.where(is_new, np.arange(len(y)), 0))
    with pytest.raises(InputError, match="missing or repeated"):
        tcdyn.sensor_from_noise((t, y[rows]), "T1")
