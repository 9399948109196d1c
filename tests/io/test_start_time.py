"""The start of a table is the instant of its first row, or not stated."""

from __future__ import annotations

import numpy as np
import pytest

from tcdyn.io.read import open_table, read_all_rows
from tcdyn.io.start_time import start_time


def start_of(tmp_path, header: str, rows: list[str], time: str) -> str:
    path = tmp_path / "log.csv"
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    table = open_table(path, [time])
    columns = read_all_rows(table, list(table.names))
    return start_time({**columns.data, **columns.stamps}, time, columns.data[time])


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        (["2026-03-04 10:00:00.5,1", "2026-03-04 10:00:01.5,2"], "2026-03-04T10:00:00.500000"),
        (["2026-03-04T10:00:00Z,1", "2026-03-04T10:00:01Z,2"], "2026-03-04T10:00:00+00:00"),
        (["04.03.2026 10:00:00,1", "04.03.2026 10:00:01,2"], "2026-03-04T10:00:00"),
        (["04.03.26 10:00:00,1", "04.03.26 10:00:01,2"], "2026-03-04T10:00:00"),
        (["03/14/2026 02:00:00 PM,1", "03/14/2026 02:00:01 PM,2"], "2026-03-14T14:00:00"),
        (["14/03/2026 02:00:00,1", "14/03/2026 02:00:01,2"], "2026-03-14T02:00:00"),
        # the days are consecutive in one order only
        (["03/04/2026 23:59:59,1", "04/04/2026 00:00:00,2"], "2026-04-03T23:59:59"),
        (["03/04/2026 23:59:59,1", "03/05/2026 00:00:00,2"], "2026-03-04T23:59:59"),
        (["03/03/2026 10:00:00,1", "03/03/2026 10:00:01,2"], "2026-03-03T10:00:00"),
        # one date that can be read in two ways, times without a date, numbers
        (["03/04/2026 10:00:00,1", "03/04/2026 10:00:01,2"], ""),
        (["10:00:00,1", "10:00:01,2"], ""),
        (["0.0,1", "1.0,2"], ""),
        (["1767225600,1", "1767225601,2"], ""),
    ],
)
def test_the_first_stamp_in_iso_8601_or_nothing(tmp_path, rows, expected):
    assert start_of(tmp_path, "time,T", rows, "time") == expected


def test_the_date_of_a_time_of_day_is_in_its_own_column(tmp_path):
    rows = ["26.11.2025;23:59:59;1", "27.11.2025;00:00:00;2"]
    assert start_of(tmp_path, "Datum;Zeit;T", rows, "Zeit") == "2025-11-26T23:59:59"


def test_a_column_of_numbers_has_no_start():
    assert start_time({"t": np.array([0.0, 1.0])}, "t", np.array([0.0, 1.0])) == ""
    assert start_time({}, "t", np.array([0.0, 1.0])) == ""


@pytest.mark.parametrize(
    ("date", "expected"),
    [("2026/03/04", "2026-03-04T10:00:00.250000"), ("04.03.26", None), ("", None)],
)
def test_the_header_of_labview_states_the_start(tmp_path, date, expected):
    head = ["LabVIEW Measurement", "Separator\tTab", "Decimal_Separator\t,", "X_Columns\tOne"]
    head += [f"Date\t{date}", "Time\t10:00:00,25", "***End_of_Header***", "", "Channels\t1"]
    head += ["***End_of_Header***", "X_Value\tT1\tComment", "0,0\t20,5", "0,5\t20,6"]
    path = tmp_path / "log.lvm"
    path.write_text("\n".join(head) + "\n", encoding="utf-8")
    assert open_table(path).metadata.get("start_time") == expected
