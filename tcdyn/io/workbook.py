"""Sheets of an Excel workbook (.xlsx, .xlsm) as text, as Excel would save them as CSV.

Used by :mod:`tcdyn.io.read`, which imports this module only for such files. A sheet becomes text
in memory with one line for each of its rows, so that titles, units, words, decimal commas and clock
stamps mean what they mean in a text file, and messages count the rows of the sheet. Guarded by
``tests/io/test_workbooks.py``.

Notes
-----
Read by python-calamine (MIT, 1 MB to download, 2.3 MB installed, no dependencies). A sheet of
100,000 rows and 6 columns takes it 0.6 s and 42 MB; openpyxl (MIT), read-only, takes 4.0 s and
9 MB.

What a sheet may hold besides numbers:

- dates, times and durations become ISO 8601 and hours:minutes:seconds, in both date systems, with
  the milliseconds that Excel shows; a time beyond 24 h in a column of times goes on counting;
- TRUE and FALSE become words of a switch, errors such as #N/A empty cells;
- a merged cell has its value in each of its rows, in its first column;
- hidden sheets are read only if they are named, hidden rows and columns always;
- empty columns are left out, and so are images, charts and comments;
- formulas count with the value that Excel stored; without one the file is refused.
"""

from __future__ import annotations

import io
import re
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date, datetime, time, timedelta
from pathlib import Path, PurePosixPath
from typing import Any
from xml.etree import ElementTree

from python_calamine import (
    CalamineError,
    CalamineSheet,
    CalamineWorkbook,
    SheetTypeEnum,
    SheetVisibleEnum,
)

from tcdyn.core.errors import InputError
from tcdyn.io.cells import is_number
from tcdyn.io.metadata import METADATA_HEADER, METADATA_SHEET

# Bytes that the parts of a workbook may unpack to, against damaged and malicious files. A full
# sheet of 1,048,576 rows with 20 columns of 15 digits has 0.9 GB.
MAX_UNPACKED_BYTES = 1 << 30
# Cells of the rectangle of a sheet, which is allocated as a whole (24 bytes each, so 0.6 GB): a
# full sheet of 24 columns. One forgotten cell in the last corner of a sheet would need 400 GB.
MAX_CELLS = 24 << 20
# Parts that hold no cells
_OTHER_PARTS = ("xl/drawings/", "xl/charts/", "xl/media/", "xl/theme/", "docProps/", "customXml/")
_OLD_EXCEL = "save it as .xlsx, or as CSV"
_DAY_ZERO = {False: datetime(1899, 12, 31), True: datetime(1904, 1, 1)}  # by "is_1904"
_DAYS_OF_A_YEAR = 366
_HOURS_OF_A_STAMP = 1000  # more are written with days, see ``tcdyn.io.stamps``
# names of elements may have a prefix: <x:row>
_ROW = re.compile(rb"<(?:\w+:)?row\b[^>]*?>")
_ROW_NUMBER = re.compile(rb"<(?:\w+:)?row\b[^>]*?\br=\"(\d+)\"")
_CELL = re.compile(rb"<(?:\w+:)?c[\s>/]")
_CELL_BEGINNINGS = (b"<c ", b"<c>", b"<c/", b":c ", b":c>", b":c/")
_COLUMN = re.compile(rb"\br=\"([A-Z]{1,3})\d")
_LETTERS = 26  # columns of one letter
_FAR_COLUMN = re.compile(rb" r=\"[A-Z]{2}")  # more than one letter
_FORMULA_BEGINNINGS = (b"<f ", b"<f>", b"<f/", b":f ", b":f>", b":f/")
_FORMULA_WITHOUT_VALUE = re.compile(
    rb"<(?:\w+:)?c\s([^>]*)><(?:\w+:)?f\b(?:[^>]*/>|[^>]*>[^<]*</(?:\w+:)?f>)"
    rb"(?:<(?:\w+:)?v\s*/>|<(?:\w+:)?v>(0?)</(?:\w+:)?v>)?\s*</(?:\w+:)?c>"
)
# text that would end a cell or a line
_BREAKS = re.compile(r"[\t\r\n\v\f\x1c-\x1e\x85\u2028\u2029]+")


@dataclass(frozen=True)
class Workbook:
    """An open workbook.

    Attributes
    ----------
    where
        The file, for messages.
    book
        The workbook of calamine, without the parts that hold no cells.
    parts
        The XML of each sheet by its name.
    is_1904
        Whether days count from 1904.
    is_uncomputed
        Whether the program that wrote the file left the formulas to Excel.
    visible, hidden
        Names of the sheets with cells.
    """

    where: str
    book: CalamineWorkbook
    parts: dict[str, bytes]
    is_1904: bool
    is_uncomputed: bool
    visible: tuple[str, ...]
    hidden: tuple[str, ...]

    def sheet_text(self, name: str) -> bytes:
        """A sheet as text.

        Parameters
        ----------
        name
            Name of the sheet.

        Returns
        -------
        bytes
            Its rows as UTF-8, one line each, with tabs between the columns.

        Raises
        ------
        InputError
            For a sheet that is damaged, too large, or has formulas without values.
        """
        where = f"{self.where}, sheet {name!r}"
        xml = self.parts.get(name, b"")
        _check_cells(xml, where)
        self._check_formulas(xml, where)
        try:
            sheet = self.book.get_sheet_by_name(name)
            rows = sheet.to_python(skip_empty_area=True)
        except (CalamineError, OSError, ValueError, ArithmeticError) as problem:
            raise _damaged_error(problem, where) from None
        if sheet.start is None:
            return b""
        _fill_merged(rows, sheet)
        return _text_of_rows(rows, sheet.start[0], self.is_1904)

    def metadata(self) -> dict[str, str]:
        """Keys and values of the sheet of metadata that this program wrote; empty for another.

        Raises
        ------
        InputError
            For a sheet that is damaged.
        """
        try:
            rows = self.book.get_sheet_by_name(METADATA_SHEET).to_python(skip_empty_area=True)
        except (CalamineError, OSError, ValueError, ArithmeticError) as problem:
            raise _damaged_error(problem, f"{self.where}, sheet {METADATA_SHEET!r}") from None
        if not rows or tuple(rows[0][:2]) != METADATA_HEADER:
            return {}
        return {str(row[0]): str(row[1]) for row in rows[1:] if len(row) > 1}

    def _check_formulas(self, xml: bytes, where: str) -> None:
        """Raise InputError for a formula without a value, which would be read as an empty cell."""
        if not any(begin in xml for begin in _FORMULA_BEGINNINGS):
            return
        for match in _FORMULA_WITHOUT_VALUE.finditer(xml):
            attributes, value = match.groups()
            # an empty text is a value; 0 is none where the file says that nothing was computed
            if b't="str"' in attributes or (value == b"0" and not self.is_uncomputed):
                continue
            cell = re.search(rb"\br=\"([A-Z]+\d+)\"", attributes)
            name = cell[1].decode() if cell else "of the sheet"
            raise InputError(
                f"the formula in cell {name} has no value",
                where=where,
                expected="a workbook that Excel or LibreOffice has computed",
                remedy="open the file there and save it",
            )


def open_workbook(path: Path, where: str) -> Workbook:
    """Open a workbook.

    Parameters
    ----------
    path
        A file that begins as a ZIP archive.
    where
        The file, for messages.

    Raises
    ------
    InputError
        For another archive, a damaged file, and one that unpacks to more than
        ``MAX_UNPACKED_BYTES``.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            _check_kind(archive, where)
            parts = _unpacked_parts(archive, where)
        copy = io.BytesIO()
        with zipfile.ZipFile(copy, "w") as stored:  # its sizes are known to be true
            for name, content in parts.items():
                stored.writestr(name, content)
        copy.seek(0)
        book = CalamineWorkbook.from_filelike(copy)
        workbook = parts.get("xl/workbook.xml", b"")
        targets = _targets(parts)
    except (
        zipfile.BadZipFile,
        zlib.error,
        EOFError,
        RuntimeError,
        OSError,
        ValueError,
        LookupError,
        CalamineError,
        ElementTree.ParseError,
    ) as problem:
        if isinstance(problem, InputError):
            raise
        raise _damaged_error(problem, where) from None
    sheets = [each for each in book.sheets_metadata if each.typ == SheetTypeEnum.WorkSheet]
    visible = [each.name for each in sheets if each.visible == SheetVisibleEnum.Visible]
    hidden = [each.name for each in sheets if each.visible != SheetVisibleEnum.Visible]
    return Workbook(
        where,
        book,
        {name: parts.get(target, b"") for name, target in targets.items()},
        re.search(rb"\bdate1904=\"(?:1|true)\"", workbook) is not None,
        re.search(rb"\bfullCalcOnLoad=\"(?:1|true)\"", workbook) is not None,
        tuple(visible),
        tuple(hidden),
    )


def refuse_old_excel(path: Path, where: str) -> None:
    """Raise the InputError for a file in the container format of old Office programs.

    Parameters
    ----------
    path
        The file: an old .xls workbook, or a workbook that is protected by a password.
    where
        The file, for messages.
    """
    with open(path, "rb") as stream:
        content = stream.read(MAX_UNPACKED_BYTES)
    if "EncryptedPackage".encode("utf-16-le") in content:
        raise InputError(
            "this workbook is protected by a password",
            where=where,
            remedy="save it without the password, or as CSV",
        )
    kind = "a document of an old Office program"
    if any(name.encode("utf-16-le") in content for name in ("Workbook", "Book")):
        kind = "an old Excel workbook (.xls)"
    raise InputError(f"this is {kind}", where=where, remedy=_OLD_EXCEL)


def _check_kind(archive: zipfile.ZipFile, where: str) -> None:
    """Raise InputError for an archive that is no .xlsx workbook."""
    names = archive.namelist()
    if "xl/workbook.xml" in names:
        return
    kind, remedy = "an archive", "extract its files first"
    if "xl/workbook.bin" in names:
        kind, remedy = "a binary Excel workbook (.xlsb)", _OLD_EXCEL
    elif "mimetype" in names and "content.xml" in names:
        kind, remedy = "an OpenDocument file (.ods)", _OLD_EXCEL
    elif "[Content_Types].xml" in names:
        kind, remedy = "an Office document without sheets", "save its table as CSV"
    elif any(name.endswith(".npy") for name in names):
        kind, remedy = "an archive of NumPy arrays (.npz)", "save them as CSV with a header row"
    raise InputError(
        f"this is {kind}",
        where=where,
        expected="a log (CSV, LVM, TDMS, Parquet, .xlsx or .mat)",
        remedy=remedy,
    )


def _unpacked_parts(archive: zipfile.ZipFile, where: str) -> dict[str, bytes]:
    """The parts of a workbook that may hold cells, by name.

    Raises
    ------
    InputError
        If they unpack to more than ``MAX_UNPACKED_BYTES``.
    """
    parts: dict[str, bytes] = {}
    remaining = MAX_UNPACKED_BYTES
    for entry in archive.infolist():
        is_needed = entry.filename.endswith((".xml", ".rels"))
        if not is_needed or entry.filename.startswith(_OTHER_PARTS):
            continue
        if entry.file_size <= remaining:
            with archive.open(entry) as stream:
                parts[entry.filename] = stream.read(remaining + 1)
            remaining -= len(parts[entry.filename])
        if entry.file_size > remaining + len(parts.get(entry.filename, b"")):
            raise InputError(
                f"unpacks to more than {MAX_UNPACKED_BYTES / 1e9:.2g} GB",
                where=where,
                remedy="save the sheet as CSV",
            )
    return parts


def _targets(parts: dict[str, bytes]) -> dict[str, str]:
    """Name of the part of each sheet, by name of the sheet."""
    relations = ElementTree.fromstring(parts["xl/_rels/workbook.xml.rels"])
    target_of = {each.get("Id", ""): each.get("Target", "") for each in relations}
    targets: dict[str, str] = {}
    for element in ElementTree.fromstring(parts["xl/workbook.xml"]).iter():
        if element.tag.rpartition("}")[2] != "sheet":
            continue
        for key, value in element.attrib.items():
            if key.rpartition("}")[2] == "id" and value in target_of:
                target = PurePosixPath("/xl") / target_of[value]
                targets[element.get("name", "")] = str(target).lstrip("/")
    return targets


def _check_cells(xml: bytes, where: str) -> None:
    """Raise InputError if the rectangle of a sheet has more than ``MAX_CELLS`` cells.

    Parameters
    ----------
    xml
        XML of the sheet. Rows and cells may state their place or follow each other.
    where
        The sheet, for messages.
    """
    numbers = [int(number) for number in _ROW_NUMBER.findall(xml)]
    n_rows = max([len(_ROW.findall(xml)), *numbers])
    n_columns = _LETTERS
    n_cells = sum(xml.count(begin) for begin in _CELL_BEGINNINGS)
    has_places = n_cells <= xml.count(b' r="') - len(numbers)
    if not has_places or _FAR_COLUMN.search(xml) is not None:
        columns = [_column_number(letters) for letters in set(_COLUMN.findall(xml))]
        cells_of_rows = [len(_CELL.findall(part)) for part in _ROW.split(xml)]
        n_columns = max([*columns, *cells_of_rows])
    if n_rows * n_columns > MAX_CELLS:
        raise InputError(
            f"the sheet has {n_rows} rows and {n_columns} columns, counted to its last cell",
            where=where,
            expected=f"at most {MAX_CELLS} cells",
            remedy="delete the rows and columns beyond the table, or save the sheet as CSV",
        )


def _column_number(letters: bytes) -> int:
    """Number of a column from 1 on.

    >>> _column_number(b"A"), _column_number(b"XFD")
    (1, 16384)
    """
    number = 0
    for letter in letters:
        number = 26 * number + letter - ord("A") + 1
    return number


def _fill_merged(rows: list[list[Any]], sheet: CalamineSheet) -> None:
    """Put the value of each merged cell into all its rows, in its first column."""
    top, left = sheet.start or (0, 0)
    for (first_row, column), (last_row, _) in sheet.merged_cell_ranges or ():
        rows_of_cell = rows[max(first_row - top, 0) : last_row - top + 1]
        k = column - left
        if first_row < top or not rows_of_cell or not 0 <= k < len(rows_of_cell[0]):
            continue
        for row in rows_of_cell[1:]:
            row[k] = rows_of_cell[0][k]


def _text_of_rows(rows: Sequence[list[Any]], empty_rows: int, is_1904: bool) -> bytes:
    """The text of a sheet: one line a row, tabs between columns.

    Parameters
    ----------
    rows
        Its cells from the first row on that is not empty.
    empty_rows
        Number of empty rows above.
    is_1904
        Whether days count from 1904.

    Notes
    -----
    Numbers have the decimal mark of the numbers that were typed as text, if there are some, because
    a text has one decimal mark.
    """
    texts = [cell for row in rows for cell in row if type(cell) is str and cell]
    n_comma = sum(is_number(text, ",") and not is_number(text, ".") for text in texts)
    n_point = sum(is_number(text, ".") and "." in text for text in texts)
    mark = "," if n_comma > n_point else "."
    columns = [_column_text(cells, mark, is_1904) for cells in zip(*rows)]
    filled = [cells for cells in columns if any(cells)]
    lines = ["\t".join(cells) if any(cells) else "" for cells in zip(*filled)]
    return "\n".join([*[""] * empty_rows, *lines, ""]).encode("utf-8", "replace")


def _column_text(cells: Sequence[Any], mark: str, is_1904: bool) -> list[str]:
    """Cells of one column as text.

    Parameters
    ----------
    cells
        The cells.
    mark
        Decimal mark.
    is_1904
        Whether days count from 1904.
    """
    kinds = {type(cell) for cell in cells}
    if kinds == {float}:  # as nearly always
        return [_number_text(cell, mark) for cell in cells]
    # a date and time at midnight comes as a date
    has_clock = datetime in kinds
    zero = _DAY_ZERO[is_1904] if time in kinds else None
    return [_cell_text(cell, mark, has_clock, zero) for cell in cells]


def _cell_text(cell: Any, mark: str, has_clock: bool, zero: datetime | None) -> str:
    """A cell as text.

    Parameters
    ----------
    cell
        The cell.
    mark
        Decimal mark.
    has_clock
        Whether the dates of its column have a time.
    zero
        Day before the first one, in a column of times of the day, in which times beyond 24 h come
        as dates soon after; None in other columns.

    Examples
    --------
    >>> _cell_text(20.0, ",", False, None), _cell_text(0.1, ",", False, None)
    ('20', '0,1')
    >>> _cell_text(date(2024, 3, 12), ".", True, None)
    '2024-03-12T00:00:00'
    >>> _cell_text(datetime(1900, 1, 1, 0, 30), ".", True, datetime(1899, 12, 31))
    '24:30:00'
    """
    kind = type(cell)
    if kind is float or kind is int:
        return _number_text(cell, mark)
    if kind is str:
        return _escaped(cell)
    if kind is bool:
        return "true" if cell else "false"
    if kind is time:
        return str(cell.isoformat())
    if kind is timedelta:
        return _duration_text(cell)
    if isinstance(cell, date):
        instant = cell if isinstance(cell, datetime) else datetime.combine(cell, time())
        if zero is not None and instant - zero < timedelta(days=_DAYS_OF_A_YEAR):
            return _duration_text(instant - zero)
        if has_clock or instant is cell:
            return instant.isoformat()
        return str(cell.isoformat())
    return _escaped(str(cell))


def _number_text(number: float, mark: str) -> str:
    """The shortest text of a number.

    >>> _number_text(20.0, "."), _number_text(0.1, ",")
    ('20', '0,1')
    """
    text = repr(number).removesuffix(".0")
    return text if mark == "." else text.replace(".", mark)


def _duration_text(duration: timedelta) -> str:
    """A duration as hours, minutes and seconds; of more hours than a stamp has, with days.

    >>> _duration_text(timedelta(hours=25, seconds=1.5)), _duration_text(timedelta(days=50))
    ('25:00:01.500000', '50 d 00:00:00')
    """
    sign = "-" if duration < timedelta(0) else ""
    duration = abs(duration)
    minutes, second = divmod(duration.seconds, 60)
    hour, minute = divmod(minutes, 60)
    hours = 24 * duration.days + hour
    fraction = f".{duration.microseconds:06d}" if duration.microseconds else ""
    clock = f"{minute:02d}:{second:02d}{fraction}"
    if hours < _HOURS_OF_A_STAMP:
        return f"{sign}{hours:02d}:{clock}"
    return f"{sign}{duration.days} d {hour:02d}:{clock}"


def _escaped(text: str) -> str:
    """The text of a cell on one line, in quotes if it has some.

    >>> _escaped("Temp.\\n[°C]"), _escaped('6" pipe')
    ('Temp. [°C]', '"6"" pipe"')
    """
    text = _BREAKS.sub(" ", text).replace("\x00", " ").strip()
    if '"' in text:
        return '"' + text.replace('"', '""') + '"'
    return text


def _damaged_error(problem: BaseException, where: str) -> InputError:
    """The error for a workbook that cannot be read, with its reason."""
    text = str(problem).splitlines()[0][:120] if str(problem) else type(problem).__name__
    return InputError(
        f"not readable as an Excel workbook ({text})",
        where=where,
        expected="a complete .xlsx file",
        remedy="copy the file again, or save it as CSV",
    )
