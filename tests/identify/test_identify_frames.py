"""Arrays, tuples, Series, DataFrames and files are data of a fit; results have the same index."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter

import tcdyn
from tcdyn.core.errors import InputError
from tcdyn.identification import IOData, fit, predict

DT_S = 0.1
LAG_S = 0.8
N = 200
OPTIONS: dict[str, Any] = {"noise": "white", "baseline": "none"}
CLOCK = pd.date_range("2026-03-01 10:00", periods=N, freq="100ms", name="time", unit="us")


def arrays() -> tuple[np.ndarray, np.ndarray]:
    """A held input, and the output of a first-order lag with noise."""
    u = np.repeat([0.0, 1.0, 0.0, 1.0], N // 4)
    pole = np.exp(-DT_S / LAG_S)
    y = lfilter([0.0, 1 - pole], [1.0, -pole], u)
    return u, y + np.random.default_rng(0).normal(0.0, 0.01, N)


def frame() -> pd.DataFrame:
    u, y = arrays()
    return pd.DataFrame({"heater": u, "T_degC": y}, CLOCK)


def test_tuple_of_arrays_or_series_gives_the_fit_of_the_data() -> None:
    u, y = arrays()
    expected = fit(IOData.from_arrays(u, y, DT_S), "P1", **OPTIONS).identified.theta
    assert fit((u, y, DT_S), "P1", **OPTIONS).identified.theta == expected
    table = frame()
    of_series = fit((table["heater"], table["T_degC"]), "P1", **OPTIONS)
    assert of_series.identified.theta == pytest.approx(expected)
    assert of_series.identified.input_name == "heater"


@pytest.mark.parametrize(
    ("data", "hint"),
    [
        (np.zeros(10), r"IOData.from_arrays\(u, y, dt_s\)"),
        (frame(), r"from_frame\(frame, input=.., output=..\)"),
        ("log.csv", r"from_csv\(path, input=.., output=..\)"),
        ((np.zeros(10), np.zeros(10)), "sampling interval is not given"),
    ],
)
def test_other_data_are_refused_with_a_hint(data: Any, hint: str) -> None:
    for function in (fit, tcdyn.compare):
        with pytest.raises(InputError, match=hint):
            function(data)


@pytest.mark.e2e
def test_identify_gives_the_same_model_from_frame_file_arrays_and_data(tmp_path: Path) -> None:
    table = frame()
    u, y = arrays()
    seconds = pd.Index(DT_S * np.arange(N), name="time_s")
    table.set_axis(seconds).to_csv(tmp_path / "log.csv")
    columns = {"input": "heater", "output": "T_degC"}
    results = [
        tcdyn.identify(table, "P1", **columns, **OPTIONS),
        tcdyn.identify(tmp_path / "log.csv", "P1", **columns, **OPTIONS),
        tcdyn.identify((u, y, DT_S), "P1", **OPTIONS),
        tcdyn.identify(IOData.from_arrays(u, y, DT_S, hold="zoh"), "P1", **OPTIONS),
    ]
    lags_s = [result.best.estimates["Tp1"] for result in results]
    assert lags_s[0].contains(LAG_S)
    assert [lag.value for lag in lags_s] == pytest.approx([lags_s[0].value] * 4, rel=1e-6)


def test_clock_times_come_back_also_of_a_part_of_the_record() -> None:
    table = frame()
    data = IOData.from_arrays(table["heater"], table["T_degC"], hold="zoh")
    pd.testing.assert_frame_equal(data.to_frame(), table, check_freq=False)
    part = data[2.0:5.0].to_frame()
    pd.testing.assert_frame_equal(part, table.iloc[20:51], check_freq=False)
    from_table = tcdyn.identification.from_frame(table, input="heater", output="T_degC")
    assert from_table.to_frame().index.equals(CLOCK)
    fitted = fit(data, "P1", **OPTIONS)
    predicted = predict(fitted, data, None).to_frame()
    assert predicted.index.equals(CLOCK)
    assert predicted["T_degC_predicted"].to_numpy() == pytest.approx(arrays()[1], abs=0.05)
    simulated = fitted.identified.simulate(table["heater"])
    assert simulated.index.equals(CLOCK)
    assert simulated.name == "T_degC"
