"""Files of Sea-Bird instruments, and text above a table that is no header."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tcdyn.core.errors import InputError
from tcdyn.io.read import open_table, read_all_rows
from tests.series.reading import read_columns
from tests.series.reading import source_of as open_source

HEAD = ["* Sea-Bird SBE 39 Data File:", "* FileName = a.hex", "# nquan = 2"]
INTERVAL = "# interval = seconds: 0.25"
WITH_TIME = [
    "# name 0 = timeS: Time, Elapsed [seconds]",
    "# name 1 = tv290C: Temperature [ITS-90, deg C]",
]
WITHOUT_TIME = ["# name 0 = tv290C: Temperature [ITS-90, deg C]", "# name 1 = c0S/m: Cond. [S/m]"]


def cnv(folder: Path, names: list[str], *more: str, first: str = "0.5", end: str = "*END*") -> Path:
    path = folder / "cast.cnv"
    rows = [f"{float(first) * k:11.3f}{20 + 0.1 * k:11.4f}" for k in range(12)]
    path.write_text("\r\n".join([*HEAD, *names, *more, end, *rows, ""]), encoding="cp1252")
    return path


def test_the_header_names_the_columns_and_their_units(tmp_path: Path) -> None:
    path = cnv(tmp_path, WITH_TIME, INTERVAL)
    assert open_table(path).names == ("timeS [seconds]", "tv290C [deg C]")
    time_s, columns, _ = read_columns(open_source(path), ["tv290C [deg C]"])
    assert time_s == pytest.approx(0.5 * np.arange(12))
    assert columns["tv290C [deg C]"] == pytest.approx(20 + 0.1 * np.arange(12))


def test_without_a_column_of_time_the_interval_of_the_header_is_used(tmp_path: Path) -> None:
    path = cnv(tmp_path, WITHOUT_TIME, INTERVAL, "# start_time = Apr 02 2008 18:52:30")
    table = open_table(path)
    assert table.names == ("time_s", "tv290C [deg C]", "c0S/m [S/m]")
    assert table.metadata["start_time"] == "2008-04-02T18:52:30"
    data = read_all_rows(table, list(table.names)).data
    assert data["time_s"] == pytest.approx(0.25 * np.arange(12))


def test_an_interval_of_pressure_is_no_time(tmp_path: Path) -> None:
    path = cnv(tmp_path, WITHOUT_TIME, "# interval = decibars: 1")
    with pytest.raises(InputError, match="no time column"):
        open_source(path)


def test_the_bad_flag_is_no_value(tmp_path: Path) -> None:
    path = cnv(tmp_path, WITH_TIME, "# bad_flag = 20.5")
    values = read_all_rows(open_table(path), ["tv290C [deg C]"]).data["tv290C [deg C]"]
    assert np.flatnonzero(np.isnan(values)).tolist() == [5]


@pytest.mark.parametrize(
    ("names", "more", "end", "cause"),
    [
        ([], [], "*END*", "does not name its columns"),
        (WITH_TIME, ["# file_type = binary"], "*END*", "binary rows"),
        (WITH_TIME[:1], [], "*END*", "names 1 columns"),
        (WITH_TIME, [], "* no end", "never ends"),
    ],
)
def test_other_files_of_sea_bird_are_refused_by_name(
    tmp_path: Path, names: list[str], more: list[str], end: str, cause: str
) -> None:
    with pytest.raises(InputError, match=f"Sea-Bird.*{cause}"):
        open_table(cnv(tmp_path, names, *more, end=end))


@pytest.mark.parametrize("line", ["* Sonde XY", "file = A1", "*** 12.3.2020 ***", "Start : now"])
def test_prose_above_numbers_is_no_header(tmp_path: Path, line: str) -> None:
    path = tmp_path / "log.txt"
    columns = len(line.split())
    rows = [" ".join(str(k + c) for c in range(columns)) for k in range(10)]
    path.write_text("\n".join([line, *rows, ""]), encoding="utf-8")
    with pytest.raises(InputError, match="no header row"):
        open_table(path)


def test_a_first_column_without_name_may_be_unix_time(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    rows = [f'"{1660577158 + 10 * k}","{20 + k}.5"' for k in range(12)]
    path.write_text("\n".join(['"","Inside Last (C)"', *rows, ""]), encoding="utf-8")
    source = open_source(path)
    assert source.time == "unix_time_s"
    time_s, _, _ = read_columns(source, ["Inside Last (C)"])
    assert np.diff(time_s) == pytest.approx(10.0)


def test_other_numbers_without_name_are_no_time(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    rows = [f"{1660577158 - 10 * k},{20 + k}.5" for k in range(12)]
    path.write_text("\n".join([",T1 (C)", *rows, ""]), encoding="utf-8")
    assert open_table(path).names == ("column 1", "T1 (C)")


def test_cells_that_are_left_out_are_the_cause_that_is_named(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    rows = [f"{k},10:00:{k:02},20.{k}" + (",3.6,1.5" if k % 5 == 1 else "") for k in range(1, 30)]
    path.write_text("\n".join(["No,Time,T1,bat,p", *rows, ""]), encoding="utf-8")
    with pytest.raises(InputError, match=r"row 3 has 3 fields.* have 5: cells .* are left out"):
        open_table(path)


def test_a_line_of_text_between_the_rows_is_the_cause_that_is_named(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    rows = [f"{k},10:00:{k:02},20.{k}" for k in range(1, 30)]
    text = "\n".join(["No,Time,T1", rows[0], "<TIME: 05.09.2018 16:00:00>", *rows[1:], ""])
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match="row 3 has 1 field"):
        read_columns(open_source(path), ["T1"])
