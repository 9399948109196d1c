"""Workbooks of Excel read as tables; the expected values come from openpyxl and pandas."""

from __future__ import annotations

import io
import random
import zipfile
from collections.abc import Sequence
from datetime import date, datetime, time, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import openpyxl
import pandas as pd
import pytest
import xlsxwriter
from openpyxl.utils.datetime import CALENDAR_MAC_1904
from openpyxl.worksheet.worksheet import Worksheet

from tcdyn.core.errors import InputError
from tcdyn.io import workbook
from tcdyn.io.read import Part, open_table, read_all_rows
from tcdyn.io.table import Columns, Table
from tcdyn.series import ReadingOptions
from tcdyn.series.source import open_source

TIME_s = np.arange(40) * 0.25
T_degC = np.round(20 + 5 * np.sin(TIME_s), 3)


def log_rows() -> list[list[Any]]:
    """A header and rows of numbers."""
    rows: list[list[Any]] = [["time_s", "T_degC"]]
    rows += [[float(t), float(x)] for t, x in zip(TIME_s, T_degC)]
    return rows


def save(path: Path, rows: Sequence[Sequence[Any]], name: str = "Log") -> Path:
    """Write one sheet with openpyxl."""
    book = openpyxl.Workbook()
    fill(book.worksheets[0], rows)
    book.worksheets[0].title = name
    book.save(path)
    return path


def fill(sheet: Worksheet, rows: Sequence[Sequence[Any]]) -> None:
    """Add rows to a sheet."""
    for row in rows:
        sheet.append(list(row))


def read(path: Path, part: Part | None = None) -> tuple[Table, Columns]:
    """The table of a file and all its columns."""
    table = open_table(path, part=part)
    return table, read_all_rows(table, table.names)


def read_or_message(path: Path) -> tuple[Columns | None, str]:
    """The columns of a file, or the message with which it is refused."""
    try:
        return read(path)[1], ""
    except InputError as problem:
        return None, str(problem)


def times_of(path: Path, **options: Any) -> np.ndarray:
    """The times [s] of all rows of a table."""
    source = open_source(path, options=ReadingOptions(**options))
    return np.concatenate([times for times, _ in source.timed_chunks([])])


def test_numbers_are_those_that_pandas_reads(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    frame = pd.DataFrame(
        {"time_s": np.arange(500) * 0.01, "T1": rng.normal(20, 1, 500), "n": np.arange(500)}
    )
    frame.loc[[3, 70], "T1"] = np.nan
    path = tmp_path / "log.xlsx"
    frame.to_excel(path, index=False, engine="xlsxwriter")
    expected = pd.read_excel(path, engine="openpyxl")
    table, columns = read(path)
    assert table.names == ("time_s", "T1", "n")
    for name in table.names:
        np.testing.assert_array_equal(columns.data[name], expected[name].to_numpy(float))
    assert columns.location.row(0) == 2


def test_titles_units_and_empty_rows_and_columns_are_those_of_a_csv_file(tmp_path: Path) -> None:
    rows: list[list[Any]] = [
        [],
        ["", "Kiln 3, run 7"],
        [],
        ["", "Zeit", "", "Ofen", "Bad", "Zustand"],
        ["", "min", "", "°C", "°C", ""],
        *[["", k / 60, "", 20.0 + k, 30.0, "heizt"] for k in range(20)],
        [],
    ]
    path = save(tmp_path / "log.xlsx", [[cell or None for cell in row] for row in rows])
    table, columns = read(path)
    assert table.names == ("Zeit", "Ofen", "Bad", "Zustand")
    assert table.units == {"Zeit": "min", "Ofen": "°C", "Bad": "°C"}
    # the first time is an empty cell, because 0 is falsy above
    np.testing.assert_array_equal(columns.data["Ofen"], 20.0 + np.arange(20))
    assert columns.location.row(0) == 6  # as Excel counts
    assert set(columns.stamps["Zustand"]) == {"heizt"}


def test_decimal_commas_that_were_typed_as_text_are_numbers(tmp_path: Path) -> None:
    rows: list[list[Any]] = [["Zeit [s]", "Ofen [°C]", "Bad [°C]"]]
    rows += [[0.5 * k, f"{20 + 0.25 * k:.2f}".replace(".", ","), 21.5] for k in range(12)]
    _, columns = read(save(tmp_path / "log.xlsx", rows))
    np.testing.assert_array_equal(columns.data["Ofen [°C]"], 20 + 0.25 * np.arange(12))
    np.testing.assert_array_equal(columns.data["Zeit [s]"], 0.5 * np.arange(12))
    assert set(columns.data["Bad [°C]"]) == {21.5}


@pytest.mark.parametrize("is_1904", [False, True])
def test_dates_and_times_are_those_that_openpyxl_reads(tmp_path: Path, is_1904: bool) -> None:
    start = datetime(2024, 3, 11, 23, 59, 58)
    book = openpyxl.Workbook()
    if is_1904:
        book.epoch = CALENDAR_MAC_1904
    sheet = book.worksheets[0]
    sheet.append(["Time", "T_degC"])
    for k in range(30):
        sheet.append([start + timedelta(seconds=0.5 * k), 20.0 + k])
        sheet.cell(k + 2, 1).number_format = "yyyy-mm-dd hh:mm:ss.000"
    path = tmp_path / "log.xlsx"
    book.save(path)
    reader = openpyxl.load_workbook(path, data_only=True)
    instants = [row[0] for row in reader.worksheets[0].iter_rows(min_row=2, values_only=True)]
    expected = [(instant - instants[0]).total_seconds() for instant in instants]
    table, columns = read(path)
    assert table.clock_columns == ("Time",)
    np.testing.assert_allclose(times_of(path), expected, atol=1e-3)  # Excel keeps milliseconds
    assert columns.stamps["Time"][4] == "2024-03-12T00:00:00"  # calamine gives a date alone
    first = pd.Timestamp(columns.stamps["Time"][0])
    assert first == pd.Timestamp(instants[0]).round("ms")


@pytest.mark.parametrize("is_1904", [False, True])
def test_times_of_the_day_count_beyond_24_hours(tmp_path: Path, is_1904: bool) -> None:
    path = tmp_path / "log.xlsx"
    book = xlsxwriter.Workbook(str(path), {"date_1904": is_1904})
    sheet = book.add_worksheet()
    sheet.write_row(0, 0, ["Uhrzeit", "T_degC"])
    clock = book.add_format({"num_format": "hh:mm:ss"})
    step_h = 0.25
    for k in range(200):  # 50 h
        sheet.write_number(k + 1, 0, (22 + step_h * k) / 24, clock)
        sheet.write_number(k + 1, 1, 20.0 + k)
    book.close()
    np.testing.assert_allclose(times_of(path), 3600 * step_h * np.arange(200), atol=1e-3)


def test_durations_are_times(tmp_path: Path) -> None:
    path = tmp_path / "log.xlsx"
    book = xlsxwriter.Workbook(str(path))
    sheet = book.add_worksheet()
    sheet.write_row(0, 0, ["Elapsed time", "T_degC"])
    form = book.add_format({"num_format": "[h]:mm:ss.000"})
    for k in range(60):
        sheet.write_number(k + 1, 0, (23.9 * 3600 + 12.5 * k) / 86400, form)
        sheet.write_number(k + 1, 1, 20.0 + k)
    book.close()
    np.testing.assert_allclose(np.diff(times_of(path)), 12.5, atol=2e-3)


def test_a_date_and_a_clock_in_two_columns_belong_together(tmp_path: Path) -> None:
    rows: list[list[Any]] = [["Datum", "Uhrzeit", "T_degC"]]
    for k in range(40):
        instant = datetime(2024, 3, 11, 23, 55) + timedelta(seconds=20 * k)
        rows.append([instant.date(), instant.time(), 20.0 + k])
    np.testing.assert_allclose(times_of(save(tmp_path / "log.xlsx", rows)), 20.0 * np.arange(40))


def test_booleans_errors_and_texts_with_breaks(tmp_path: Path) -> None:
    rows: list[list[Any]] = [["time_s", 'Temp.\n"oven"\t[°C]', "Heater", "Note"]]
    rows += [[float(k), 20.0 + k, k > 5, 'a "b"\tc' if k % 2 else "x;y"] for k in range(20)]
    rows[4][1] = "#N/A"
    rows[7][1] = "#DIV/0!"
    table, columns = read(save(tmp_path / "log.xlsx", rows))
    assert table.names[1:3] == ('Temp. "oven" [°C]', "Heater")
    expected = 20.0 + np.arange(20)
    expected[[3, 6]] = np.nan
    np.testing.assert_array_equal(columns.data[table.names[1]], expected)
    np.testing.assert_array_equal(columns.data["Heater"], np.arange(20) > 5)
    assert list(columns.stamps["Note"][:2]) == ["x;y", 'a "b" c']


def test_a_merged_cell_has_its_value_in_each_row(tmp_path: Path) -> None:
    book = openpyxl.Workbook()
    sheet = book.worksheets[0]
    fill(sheet, [["time_s", "Temperature", None, "phase"], [None, "T1_degC", "T2_degC", None]])
    fill(sheet, [[float(k), 20.0 + k, 30.0 + k, "heat" if k == 0 else None] for k in range(12)])
    for cells in ("A1:A2", "B1:C1", "D1:D2", "D3:D14"):
        sheet.merge_cells(cells)
    book.save(tmp_path / "log.xlsx")
    table, columns = read(tmp_path / "log.xlsx")
    assert table.names == ("time_s", "T1_degC", "T2_degC", "phase")
    assert list(columns.stamps["phase"]) == ["heat"] * 12


def two_sheets(path: Path, state: str = "hidden") -> Path:
    """A workbook with notes, two logs of which one may be hidden, and a chart."""
    book = openpyxl.Workbook()
    fill(book.worksheets[0], [["Operator", "AB"], ["Place", "kiln 3"]])
    book.worksheets[0].title = "Notes"
    fill(book.create_sheet("Run 1"), log_rows())
    hidden = book.create_sheet("Old run")
    fill(hidden, [["time_s", "T_degC"], *[[float(k), 50.0] for k in range(9)]])
    hidden.sheet_state = state
    book.create_chartsheet("Chart")
    book.save(path)
    return path


def test_the_only_sheet_with_a_table_is_taken(tmp_path: Path) -> None:
    path = two_sheets(tmp_path / "log.xlsx")
    table, columns = read(path)
    np.testing.assert_array_equal(columns.data["T_degC"], T_degC)
    assert "Run 1" in table.where
    _, columns = read(path, Part(sheet="Old run"))
    assert set(columns.data["T_degC"]) == {50.0}


def test_one_of_several_sheets_must_be_named(tmp_path: Path) -> None:
    path = two_sheets(tmp_path / "log.xlsx", "visible")
    with pytest.raises(InputError, match=r"'Run 1', 'Old run'.*sheet='Run 1'"):
        open_table(path)
    with pytest.raises(InputError, match=r"'run 1' is missing.*did you mean 'Run 1'"):
        open_table(path, part=Part(sheet="run 1"))
    source = open_source(path, options=ReadingOptions(sheet="Run 1"))
    assert source.table.names == ("time_s", "T_degC")


def test_the_columns_that_are_needed_choose_the_sheet(tmp_path: Path) -> None:
    book = openpyxl.Workbook()
    fill(book.worksheets[0], log_rows())
    fill(book.create_sheet("Points"), [["volts", "force_N"], *[[k, 2.0 * k] for k in range(9)]])
    book.save(tmp_path / "log.xlsx")
    assert open_table(tmp_path / "log.xlsx").names == ("time_s", "T_degC")
    assert open_table(tmp_path / "log.xlsx", ("volts",)).names == ("volts", "force_N")


def test_the_message_names_the_row_of_the_sheet(tmp_path: Path) -> None:
    rows = log_rows()
    rows[20][1] = "12;5"
    path = save(tmp_path / "log.xlsx", [["Title"], [], *rows])
    findings = read(path)[1].findings
    assert any("23" in str(finding) for finding in findings)


@pytest.mark.parametrize("writer", ["openpyxl", "xlsxwriter"])
def test_formulas_without_values_are_refused(tmp_path: Path, writer: str) -> None:
    path = tmp_path / "log.xlsx"
    rows = log_rows()
    if writer == "openpyxl":
        rows[3][1] = "=A4+1"
        save(path, rows)
    else:
        book = xlsxwriter.Workbook(str(path))
        sheet = book.add_worksheet()
        for k, row in enumerate(rows):
            sheet.write_row(k, 0, row)
        sheet.write_formula(3, 1, "=A4+1")
        book.close()
    with pytest.raises(InputError, match="formula in cell B4 has no value"):
        open_table(path)


def test_the_stored_values_of_formulas_are_read(tmp_path: Path) -> None:
    path = tmp_path / "log.xlsx"
    book = xlsxwriter.Workbook(str(path))
    sheet = book.add_worksheet()
    for k, row in enumerate(log_rows()):
        sheet.write_row(k, 0, row)
    for k, value in enumerate(T_degC, 1):
        sheet.write_formula(k, 1, f"=A{k + 1}+1", value=value)
    book.close()
    np.testing.assert_array_equal(read(path)[1].data["T_degC"], T_degC)


def test_a_workbook_with_other_names_of_elements_is_read(tmp_path: Path) -> None:
    """Some programs give each element a prefix, and cells no place."""
    source = save(tmp_path / "source.xlsx", log_rows())
    parts = parts_of(source)
    sheet = parts["xl/worksheets/sheet1.xml"].decode()
    sheet = sheet.replace("<", "<x:").replace("<x:/", "</x:").replace("xmlns=", "xmlns:x=")
    parts["xl/worksheets/sheet1.xml"] = sheet.encode()
    path = write_parts(tmp_path / "log.xlsx", parts)
    np.testing.assert_array_equal(read(path)[1].data["T_degC"], T_degC)


def parts_of(path: Path) -> dict[str, bytes]:
    """The parts of a workbook."""
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def write_parts(path: Path, parts: dict[str, bytes]) -> Path:
    """Write the parts of a workbook."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in parts.items():
            archive.writestr(name, content)
    return path


def test_a_cell_in_the_last_corner_of_the_sheet_is_refused(tmp_path: Path) -> None:
    book = openpyxl.Workbook()
    fill(book.worksheets[0], log_rows())
    book.worksheets[0]["XFD1048576"] = "x"
    book.save(tmp_path / "log.xlsx")
    with pytest.raises(InputError, match="1048576 rows and 16384 columns"):
        open_table(tmp_path / "log.xlsx")


def test_cells_without_a_place_are_counted(tmp_path: Path) -> None:
    parts = parts_of(save(tmp_path / "source.xlsx", log_rows()))
    rows = b"<row>" + b"<c><v>1</v></c>" * 9000 + b"</row>" + b"<row/>" * 9000
    name = "xl/worksheets/sheet1.xml"
    begin = parts[name].partition(b"<sheetData>")[0]
    parts[name] = begin + b"<sheetData>" + rows + b"</sheetData></worksheet>"
    with pytest.raises(InputError, match="9001 rows and 9000 columns"):
        open_table(write_parts(tmp_path / "log.xlsx", parts))


def test_a_zip_bomb_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    parts = parts_of(save(tmp_path / "source.xlsx", log_rows()))
    parts["xl/sharedStrings.xml"] = b" " * (3 << 20)
    path = write_parts(tmp_path / "log.xlsx", parts)
    monkeypatch.setattr(workbook, "MAX_UNPACKED_BYTES", 2 << 20)
    assert path.stat().st_size < 1 << 16
    with pytest.raises(InputError, match="unpacks to more than"):
        open_table(path)


def other_archives(folder: Path) -> dict[str, Path]:
    """Archives that are no .xlsx workbook, and the word by which each is refused."""
    files = {
        ".ods": {"mimetype": b"application/vnd.oasis.opendocument.spreadsheet", "content.xml": b""},
        ".xlsb": {"[Content_Types].xml": b"", "xl/workbook.bin": b""},
        "Office": {"[Content_Types].xml": b"", "word/document.xml": b""},
        ".npz": {"T.npy": b""},
        "an archive": {"log.csv": b"time_s,T\n0,1\n"},
    }
    return {word: write_parts(folder / f"{k}.xlsx", p) for k, (word, p) in enumerate(files.items())}


def test_other_archives_are_refused_by_name(tmp_path: Path) -> None:
    for word, path in other_archives(tmp_path).items():
        with pytest.raises(InputError, match=word.replace(".", r"\.")):
            open_table(path)


@pytest.mark.parametrize(
    ("stream", "words"),
    [
        ("Workbook", r"old Excel workbook \(\.xls\).*save it as \.xlsx"),
        ("EncryptedPackage", "password"),
    ],
)
def test_old_and_protected_workbooks_are_refused_by_name(
    tmp_path: Path, stream: str, words: str
) -> None:
    content = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(2000) + stream.encode("utf-16-le")
    path = tmp_path / "log.xls"
    path.write_bytes(content)
    with pytest.raises(InputError, match=words):
        open_table(path)


def test_damaged_workbooks_are_refused_and_never_misread(tmp_path: Path) -> None:
    path = save(tmp_path / "log.xlsx", log_rows())
    sound = path.read_bytes()
    rng = random.Random(3)
    refused = 0
    for variant in range(200):
        content = bytearray(sound)
        if variant % 4 == 0:
            del content[rng.randrange(1, len(content)) :]
        else:
            for _ in range(rng.randrange(1, 4)):
                content[rng.randrange(4, len(content))] = rng.randrange(256)
        path.write_bytes(content)
        columns, message = read_or_message(path)
        assert message.isprintable()
        if columns is None:
            refused += 1
        else:
            np.testing.assert_array_equal(columns.data["T_degC"], T_degC)
    assert refused > 100


def test_damaged_xml_inside_a_sound_archive_gives_no_traceback(tmp_path: Path) -> None:
    source = parts_of(save(tmp_path / "source.xlsx", log_rows()))
    rng = random.Random(4)
    names = ["xl/worksheets/sheet1.xml", "xl/workbook.xml", "xl/styles.xml", "[Content_Types].xml"]
    names.append("xl/_rels/workbook.xml.rels")
    for variant in range(200):
        parts = dict(source)
        content = bytearray(parts[names[variant % len(names)]])
        for _ in range(rng.randrange(1, 4)):
            content[rng.randrange(len(content))] = rng.randrange(256)
        parts[names[variant % len(names)]] = bytes(content)
        _, message = read_or_message(write_parts(tmp_path / "log.xlsx", parts))
        assert message.isprintable()


def test_a_part_is_only_of_a_file_that_has_parts(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time_s,T_degC\n0,20\n1,21\n")
    with pytest.raises(InputError, match="sheet is given, but this is not an"):
        open_source(path, options=ReadingOptions(sheet="Run 1"))
    with pytest.raises(InputError, match="variable is given, but this is not a"):
        open_source(save(tmp_path / "a.xlsx", log_rows()), options=ReadingOptions(variable="log"))


def test_text_that_was_opened_in_one_column_is_still_a_table(tmp_path: Path) -> None:
    """Excel puts a file with semicolons into one column where the separator is a comma."""
    rows = [["time_s;T_degC"], *[[f"{k};{20 + k},5"] for k in range(10)]]
    np.testing.assert_array_equal(
        read(save(tmp_path / "log.xlsx", rows))[1].data["T_degC"], 20.5 + np.arange(10)
    )


def test_the_sheet_of_a_stream_that_states_a_false_size_is_refused(tmp_path: Path) -> None:
    """An archive may state that a part is smaller than it is."""
    path = save(tmp_path / "log.xlsx", log_rows())
    content = path.read_bytes()
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        size = archive.getinfo("xl/worksheets/sheet1.xml").file_size
    path.write_bytes(content.replace(size.to_bytes(4, "little"), (99).to_bytes(4, "little")))
    with pytest.raises(InputError, match="not readable as an Excel workbook"):
        open_table(path)


def test_a_date_without_a_clock_stays_a_date(tmp_path: Path) -> None:
    rows: list[list[Any]] = [["Datum", "T_degC"]]
    rows += [[date(2024, 3, 1) + timedelta(days=k), 20.0 + k] for k in range(20)]
    table, columns = read(save(tmp_path / "log.xlsx", rows))
    assert table.date_columns == ("Datum",)
    assert columns.stamps["Datum"][0] == "2024-03-01"


def test_a_column_of_clocks_alone_starts_at_its_first_row(tmp_path: Path) -> None:
    rows: list[list[Any]] = [["Uhrzeit", "T_degC"]]
    rows += [[time(10, 0, k), 20.0 + k] for k in range(20)]
    np.testing.assert_array_equal(times_of(save(tmp_path / "log.xlsx", rows)), np.arange(20))
