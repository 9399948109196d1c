"""Tables of any kind as rows with a time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tcdyn.core.errors import InputError
from tcdyn.identification import from_frame
from tcdyn.sensors.measure import read_readings
from tcdyn.series import ReadingOptions, open_source
from tcdyn.series.options import TableOptions
from tcdyn.series.read import read_all

T = np.arange(40.0)


def both_kinds(frame: pd.DataFrame, folder: Path) -> list[Any]:
    """A table as a frame and as a file."""
    path = folder / "log.csv"
    frame.to_csv(path, index=False)
    return [frame, path]


def test_one_channel_of_a_table_of_several_is_selected_by_its_cell(tmp_path: Path) -> None:
    frame = pd.DataFrame({"time_s": np.repeat(T, 2), "T": np.arange(80.0)})
    frame["channel"] = np.where(np.arange(80) % 2, "CH 1", "CH 2")
    for data in both_kinds(frame, tmp_path):
        for cell, first in (("CH 1", 1.0), ("CH 2", 0.0)):
            source = open_source(data, options=ReadingOptions(where=f"channel={cell}"))
            time_s, columns, _ = read_all(source, ["T"])
            assert time_s == pytest.approx(T)
            assert columns["T"] == pytest.approx(first + 2 * T)
        source = open_source(data, options=ReadingOptions(where="channel=3"))
        with pytest.raises(InputError, match=r"no row has '3'.*'CH 1'"):
            read_all(source, ["T"])


def test_rows_without_a_time_have_the_interval_that_is_given(tmp_path: Path) -> None:
    frame = pd.DataFrame({"T1_degC": 20 + 5 * np.sin(T / 9), "power_W": T})
    for data in both_kinds(frame, tmp_path):
        with pytest.raises(InputError, match="dt_s"):
            open_source(data)
        read = read_readings(data, ["T1_degC"], options=TableOptions(dt_s=0.5))
        assert read.time_s == pytest.approx(0.5 * T)
        assert read.report.interval_s == pytest.approx(0.5)


@pytest.mark.parametrize(
    "change",
    [
        lambda f: f.astype({"T1_degC": "Float64"}),
        lambda f: f.astype(str),
        lambda f: f.set_index(pd.Index(T, name="time_s")).drop(columns="time_s"),
        lambda f: f.assign(time_s=pd.Timestamp("2026-03-01") + pd.to_timedelta(T, "s")),
        lambda f: f.assign(time_s=pd.to_timedelta(T, "s")),
    ],
)
def test_a_frame_is_read_whatever_its_types(change: Any) -> None:
    frame = pd.DataFrame({"time_s": T, "T1_degC": np.round(20 + 5 * np.sin(T / 9), 3)})
    read = read_readings(change(frame), ["T1_degC"])
    assert read.time_s == pytest.approx(T)
    assert read.values[0] == pytest.approx(frame["T1_degC"].to_numpy())


def test_tables_without_rows_runs_or_one_interval_are_refused() -> None:
    frame = pd.DataFrame({"time_s": T, "u": T % 5, "y": T, "run": np.nan})
    with pytest.raises(InputError, match="no rows"):
        from_frame(frame.iloc[:0], input="u", output="y")
    with pytest.raises(InputError, match="names no run"):
        from_frame(frame, input="u", output="y", run="run")
    twice = pd.concat([frame.assign(run="a"), frame.assign(run="b", time_s=2 * T)])
    with pytest.raises(InputError, match="sampling intervals of 1 to 2 s"):
        from_frame(twice, input="u", output="y", run="run")
