"""A table that is read part by part gives the same as one that is read at once."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tcdyn import compensate_frame
from tcdyn.sensors import specified_sensor
from tcdyn.series import Context, SeriesReport, make_series, open_source
from tcdyn.series import survey as survey_module
from tcdyn.series.reading import Kind
from tcdyn.series.series import ColumnRows
from tcdyn.series.source import FilledTimes
from tcdyn.series.survey import survey

N = 5000


def columns_of(raw: Mapping[str, Any]) -> list[ColumnRows]:
    """The column T."""
    return [ColumnRows("T", "degC", Kind.TEMPERATURE, np.asarray(raw["T"], dtype=float))]


def log() -> pd.DataFrame:
    """Rows every second with a gap, a code and a repeated row."""
    time_s = np.arange(float(N))
    time_s[3000:] += 40
    time_s[1500] = time_s[1499]
    values = 40 + np.cumsum(np.random.default_rng(2).normal(0, 0.05, N))
    values[[200, 1900, 4100]] = -127.0
    return pd.DataFrame({"time_s": time_s, "T": values})


def surveyed(frame: pd.DataFrame) -> SeriesReport:
    """The report of a survey of a frame."""
    source = open_source(frame)
    filled = FilledTimes(source, "time_s")
    report = survey(filled, ["T"], columns_of, Context("log.csv")).report()
    assert report is not None
    return report


def test_parts_give_the_counts_of_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    frame = log()
    whole = make_series(
        frame["time_s"].to_numpy(), columns_of({"T": frame["T"]}), Context("log.csv")
    ).report
    monkeypatch.setattr(survey_module, "PART_ROWS", 700)
    parts = surveyed(frame)
    assert parts.interval_s == pytest.approx(whole.interval_s, rel=1e-3)
    names = ("rows", "samples", "rows_lost", "repeated_rows", "places")
    assert [getattr(parts, n) for n in names] == [getattr(whole, n) for n in names]
    assert [(g.after_row, g.rows) for g in parts.gaps] == [
        (g.after_row, g.rows) for g in whole.gaps
    ]
    assert parts.columns[0].readings == whole.columns[0].readings


@pytest.mark.e2e
@pytest.mark.parametrize("row", [699, 700, 2100])
def test_a_missing_time_at_the_edge_of_a_part_is_interpolated(
    monkeypatch: pytest.MonkeyPatch, row: int
) -> None:
    frame = log()
    frame.loc[row, "time_s"] = np.nan
    monkeypatch.setattr(survey_module, "PART_ROWS", 700)
    assert surveyed(frame).rows == N


@pytest.mark.e2e
def test_a_missing_time_at_the_edge_of_a_segment_is_interpolated() -> None:
    time_s = np.arange(60_000.0)
    frame = pd.DataFrame({"time_s": time_s, "T_degC": 40 + 5 * np.sin(time_s / 600)})
    frame.loc[[18_976, 21_023], "time_s"] = np.nan
    probe = specified_sensor("probe", ["T_degC"], [(5.0, 0.1)])
    done = compensate_frame(frame, probe)
    assert done["T_degC"].notna().all()
