"""Tables as .xlsx, read back with openpyxl and pandas: dates, numbers, texts, metadata, limits."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from datetime import datetime, time
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import openpyxl
import pandas as pd
import pytest

from tcdyn.core.errors import InputError
from tcdyn.io.endings import MAX_SHEET_CELLS, MAX_SHEET_COLUMNS, MAX_SHEET_ROWS, check_size
from tcdyn.io.read import sha256_of_file
from tcdyn.io.write import contains_checksum_of, log_writer, write_log, write_text
from tcdyn.io.xlsx import CLOCK_FORMAT, DATE_FORMAT, INSTANT_FORMAT, MAX_CELL_TEXT

SHORT = ["2026-03-01 23:59:59.125", "2026-03-02 00:00:00.250"]
FIRST = datetime(2026, 3, 1, 23, 59, 59, 125_000)
SECOND = datetime(2026, 3, 2, 0, 0, 0, 250_000)


def read(path: Path) -> pd.DataFrame:
    return pd.read_excel(path, sheet_name="table", engine="openpyxl")


def metadata_of(path: Path) -> dict[str, str]:
    sheet = pd.read_excel(path, sheet_name="metadata", engine="openpyxl", dtype=str)
    assert list(sheet) == ["key", "value"]
    return dict(zip(sheet["key"], sheet["value"]))


def write_parts(path: Path, parts: Iterable[pd.DataFrame]) -> None:
    """Write a table of the column "a" part by part."""
    with log_writer(path, ["a"], {}) as write:
        for part in parts:
            write(part)


def cells_of(path: Path, column: int = 1) -> list[Any]:
    """Cells of a column below the header."""
    sheet = openpyxl.load_workbook(path)["table"]
    return [row[0] for row in sheet.iter_rows(min_row=2, min_col=column, max_col=column)]


@pytest.mark.parametrize(
    "stamps",
    [
        SHORT,
        ["01.03.2026 23:59:59,125", "02.03.2026 00:00:00,250"],
        ["03/01/2026 11:59:59.125 PM", "03/02/2026 12:00:00.250 AM"],
        ["1-Mar-2026 23:59:59.125", "2-Mar-2026 00:00:00.250"],
        ["2026-03-01T23:59:59.125+01:00", "2026-03-01T23:00:00.250Z"],
        ["20260301T235959.125", "20260302T000000.250"],
    ],
)
def test_clock_stamps_of_any_form_are_dates_with_milliseconds(tmp_path, stamps):
    frame = pd.DataFrame({"time": stamps, "T1_degC": [20.0, 20.5]})
    cells = cells_of(write_log(frame, tmp_path / "a.xlsx"))
    assert [cell.value for cell in cells] == [FIRST, SECOND]
    assert all(cell.is_date and cell.number_format == INSTANT_FORMAT for cell in cells)


def test_a_date_and_a_time_of_day_in_two_columns_stay_two_columns(tmp_path):
    frame = pd.DataFrame(
        {
            "Datum": ["01.03.2026", "02.03.2026"],
            "Zeit": ["23:59:59.125", "00:00:00.250"],
            "T1_degC": [20.0, 20.5],
        }
    )
    path = write_log(frame, tmp_path / "a.xlsx")
    dates, times = cells_of(path, 1), cells_of(path, 2)
    assert [cell.value for cell in dates] == [datetime(2026, 3, 1), datetime(2026, 3, 2)]
    assert {cell.number_format for cell in dates} == {DATE_FORMAT}
    assert [cell.value for cell in times] == [time(23, 59, 59, 125_000), time(0, 0, 0, 250_000)]
    assert {cell.number_format for cell in times} == {CLOCK_FORMAT}


def test_the_time_zone_is_in_the_metadata_and_a_change_of_the_clock_no_jump(tmp_path):
    summer = ["2026-03-29T01:59:59+01:00", "2026-03-29T03:00:00+02:00"]
    path = write_log(pd.DataFrame({"t": summer}), tmp_path / "a.xlsx")
    first, second = (cell.value for cell in cells_of(path))
    assert (second - first).total_seconds() == 1.0
    assert metadata_of(path)["dates of t"] == "clock of UTC+01:00"
    local = [f"2026-03-29 01:59:{s}" for s in range(56, 60)] + ["2026-03-29 03:00:00"]
    path = write_log(pd.DataFrame({"t": local}), tmp_path / "b.xlsx")
    values = [cell.value for cell in cells_of(path)]
    assert {(b - a).total_seconds() for a, b in pairwise(values)} == {1.0}
    assert "change by one hour on 2026-03-29" in metadata_of(path)["dates of t"]


@pytest.mark.parametrize(
    "texts",
    [
        ["03/04/2026 10:00:00", "03/04/2026 10:00:01"],  # April or March
        ["10:05", "10:06"],  # hours or minutes
        ["10:00:00+01:00", "10:00:01+01:00"],
        ["25:00:00", "26:00:00"],
        ["1899-12-31 10:00:00", "1899-12-31 10:00:01"],  # before the dates of spreadsheets
        ["heating", "holding"],
    ],
)
def test_text_that_is_no_clear_date_stays_text(tmp_path, texts):
    path = write_log(pd.DataFrame({"time": texts}), tmp_path / "a.xlsx")
    assert [(c.value, c.data_type) for c in cells_of(path)] == [(text, "s") for text in texts]


def test_a_cell_that_is_no_stamp_among_stamps_stays_text_and_an_empty_one_empty(tmp_path):
    texts = [SHORT[0], "no clock", "", SHORT[1]]
    path = write_log(pd.DataFrame({"time": texts}), tmp_path / "a.xlsx")
    values = [cell.value for cell in cells_of(path)]
    assert values == [FIRST, "no clock", None, SECOND]


def test_instants_and_durations_of_pandas_are_dates(tmp_path):
    frame = pd.DataFrame(
        {"when": pd.to_datetime(SHORT), "for": pd.to_timedelta([90_000.125, np.nan], "s")}
    )
    path = write_log(frame, tmp_path / "a.xlsx")
    assert [cell.value for cell in cells_of(path)] == [FIRST, SECOND]
    first, second = cells_of(path, 2)
    assert first.value.total_seconds() == 90_000.125
    assert second.value is None


def test_numbers_keep_their_digits_and_text_is_never_a_formula(tmp_path):
    numbers = [0.1, -1e300, 5e-324, np.nan, np.inf, 12345678901.5]
    texts = ["=1+1", "+1", "@a", "{=A1}", "http://x.org", "ä\n\x07"]
    frame = pd.DataFrame({"=A1": numbers, "text": texts, "n": range(6)})
    path = write_log(frame, tmp_path / "a.xlsx", {"note": "=1+1"})
    cells = cells_of(path)
    assert [cell.value for cell in cells if cell.data_type == "n"] == [
        x if np.isfinite(x) else None for x in numbers if x != np.inf
    ]
    assert cells[3].value is None
    assert cells[4].value == "inf"
    assert [(c.value, c.data_type) for c in cells_of(path, 2)][:5] == [(t, "s") for t in texts[:5]]
    assert read(path)["n"].tolist() == list(range(6))
    sheet = openpyxl.load_workbook(path)["table"]
    assert (sheet["A1"].value, sheet["A1"].data_type) == ("=A1", "s")
    assert sheet.freeze_panes == "A2"
    assert sheet.column_dimensions["A"].width >= 8
    assert not any(c.hyperlink for row in sheet.iter_rows() for c in row)
    assert metadata_of(path)["note"] == "=1+1"


def test_parts_and_the_whole_give_the_same_bytes(tmp_path):
    days = pd.Timestamp("2026-03-01 23:59:00") + pd.to_timedelta(np.arange(200) / 2, "s")
    stamps = days.strftime("%d.%m.%Y %H:%M:%S,%f").astype(object)
    frame = pd.DataFrame({"Zeit": stamps, "T1": np.arange(200) / 3})
    whole = write_log(frame, tmp_path / "a.xlsx", {"k": "v"})
    parts = tmp_path / "b.xlsx"
    with log_writer(parts, list(frame), {"k": "v"}, ["Zeit"]) as write:
        for start in range(0, 200, 7):
            write(frame.iloc[start : start + 7])
    assert parts.read_bytes() == whole.read_bytes()
    assert read(parts)["Zeit"].tolist() == list(days)


def test_a_table_without_rows_has_its_header_and_metadata(tmp_path):
    path = tmp_path / "a.xlsx"
    with log_writer(path, ["time", "T1"], {"k": "v"}, ["time"]):
        pass
    assert list(read(path)) == ["time", "T1"]
    assert metadata_of(path) == {"k": "v"}


def test_the_limits_are_those_of_a_sheet(tmp_path):
    check_size("a.xlsx", MAX_SHEET_ROWS - 1, 30)
    check_size("a.parquet", 10 * MAX_SHEET_ROWS, 10 * MAX_SHEET_COLUMNS)
    too_large = [
        (MAX_SHEET_ROWS, 1),
        (1, MAX_SHEET_COLUMNS + 1),
        (MAX_SHEET_ROWS - 1, MAX_SHEET_CELLS // MAX_SHEET_ROWS + 1),
    ]
    for rows, columns in too_large:
        with pytest.raises(InputError, match=r"write \.csv or \.parquet"):
            check_size("a.xlsx", rows, columns)
    target = tmp_path / "a.xlsx"
    with pytest.raises(InputError, match="too many"):
        write_log(pd.DataFrame(np.zeros((1, MAX_SHEET_COLUMNS + 1))), target)
    long_text = pd.DataFrame({"text": ["x" * (MAX_CELL_TEXT + 1)]})
    with pytest.raises(InputError, match="longer than a cell"):
        write_log(long_text, target)
    with pytest.raises(InputError, match="longer than a cell"):
        write_log(pd.DataFrame({"a": [1.0]}), target, {"note": "x" * (MAX_CELL_TEXT + 1)})
    assert list(tmp_path.iterdir()) == []


def test_a_row_too_many_leaves_the_previous_file_and_no_litter(tmp_path, monkeypatch):
    monkeypatch.setattr("tcdyn.io.endings.MAX_SHEET_ROWS", 101)
    target = write_text(tmp_path / "a.xlsx", "old")
    frame = pd.DataFrame({"a": np.arange(60.0)})
    with pytest.raises(InputError, match="120 rows"):
        write_parts(target, [frame, frame])
    assert target.read_text(encoding="utf-8") == "old"
    assert list(tmp_path.iterdir()) == [target]
    write_log(frame, target)
    assert len(read(target)) == 60


def test_an_interrupted_block_leaves_nothing(tmp_path):
    def interrupted() -> Iterator[pd.DataFrame]:
        yield pd.DataFrame({"a": [1.0]})
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_parts(tmp_path / "a.xlsx", interrupted())
    assert list(tmp_path.iterdir()) == []


def test_the_checksum_of_the_input_is_found_in_the_metadata(tmp_path):
    log = write_text(tmp_path / "log.csv", "t,T")
    made = write_log(
        pd.DataFrame({"a": [1.0]}), tmp_path / "a.xlsx", {"source_sha256": sha256_of_file(log)}
    )
    other = write_log(pd.DataFrame({"a": [1.0]}), tmp_path / "b.xlsx")
    saved = tmp_path / "c.xlsx"
    openpyxl.load_workbook(made).save(saved)  # texts move to another part of the file
    damaged = write_text(tmp_path / "d.xlsx", "PK")
    found = [contains_checksum_of(path, [log]) for path in (made, other, saved, damaged)]
    assert found == [True, False, True, False]
