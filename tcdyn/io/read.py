"""Open any file of a logger as named columns; the reader is chosen by file ending and first bytes.

Text files are read here with pyarrow: the fields of every row are counted, numbers are parsed
exactly, clock times and words such as "on" are understood. Used by ``tcdyn.rig.opened_log``,
``tcdyn.series.source`` and others. Guarded by ``tests/io``:
``test_damaged_files.py``, ``test_file_formats.py`` and ``test_read_back.py``.
"""

from __future__ import annotations

import hashlib
import io
import re
import sqlite3
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import IO, Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import csv as pacsv

from tcdyn.core import Array
from tcdyn.core.errors import InputError, printable
from tcdyn.core.findings import Finding
from tcdyn.io.cells import ABSENT, TextColumn, is_number, is_text, kind_of_cell
from tcdyn.io.column_names import missing_column_error
from tcdyn.io.csv_dialect import Dialect, detect_dialect
from tcdyn.io.lvm import FIRST_BYTES, lvm_table
from tcdyn.io.metadata import METADATA_SHEET, read_metadata
from tcdyn.io.rows import CheckedRows, check_rows
from tcdyn.io.sea_bird import FIRST_BYTES as SEA_BIRD_FIRST_BYTES
from tcdyn.io.sea_bird import cnv_table
from tcdyn.io.stamps import has_fraction, is_date, is_stamp, is_time_of_day
from tcdyn.io.table import CHUNK_ROWS, Columns, Table, read_all_rows
from tcdyn.io.times import is_time_name
from tcdyn.io.unit_names import unit_in, written_unit

__all__ = [
    "CsvTable",
    "Part",
    "Table",
    "TextTable",
    "display_path",
    "open_table",
    "open_text",
    "read_all_rows",
    "read_labels",
    "read_numbers",
    "sha256_of_file",
]

# endings of a file name that decide its format; others are read as text
PARQUET_ENDINGS = (".parquet", ".pq")
# endings of files of this program that are no logs
OTHER_ENDINGS = {".json": "a record or result", ".toml": "a rig file", ".html": "a report"}
GZIP_FIRST_BYTES = b"\x1f\x8b"
ZIP_FIRST_BYTES = b"PK\x03\x04"  # an .xlsx workbook is a ZIP archive
EMPTY_ZIP_FIRST_BYTES = b"PK\x05\x06"
OLD_OFFICE_FIRST_BYTES = b"\xd0\xcf\x11\xe0"  # .xls, and workbooks with a password
SQLITE_FIRST_BYTES = b"SQLite format 3\x00"
MAT_FIRST_BYTES = b"MATLAB 5.0 MAT-file"  # of versions 5 to 7
MAT_7_3_FIRST_BYTES = b"MATLAB 7.3 MAT-file"
MAT_ENDING = ".mat"
LOG_FORMATS = "a log (CSV, LVM, TDMS, Parquet, .xlsx or .mat)"
LISTED_TABLES = 8  # of a database, in a message
# other kinds of files by their first bytes, with a remedy
OTHER_FIRST_BYTES = {
    b"\x89HDF\r\n\x1a\n": ("an HDF5 file", "save its table as CSV or Parquet"),
    b"# Created by Octave": ("a text file of Octave", "save it with save -v7, as .mat"),
    b"Octave-1-": ("a binary file of Octave", "save it with save -v7, as .mat"),
    EMPTY_ZIP_FIRST_BYTES: ("an empty archive", "copy the file again"),
    b"\x80\x04\x95": ("a pickle of Python", "save its table with to_csv or to_parquet"),
    b"\x80\x05\x95": ("a pickle of Python", "save its table with to_csv or to_parquet"),
    b"\x93NUMPY": ("an array of NumPy", "save it as CSV with a header row"),
    b"CDF\x01": ("a NetCDF file", "save its table as CSV or Parquet"),
    b"CDF\x02": ("a NetCDF file", "save its table as CSV or Parquet"),
    b"CDF\x05": ("a NetCDF file", "save its table as CSV or Parquet"),
    b"ARROW1": ("an Arrow or Feather file", "save its table as Parquet"),
    b"%PDF": ("a PDF document", "save its table as CSV"),
    b"BZh": ("a compressed file", "decompress it first"),
    b"\xfd7zXZ": ("a compressed file", "decompress it first"),
    b"\x28\xb5\x2f\xfd": ("a compressed file", "decompress it first"),
    b"7z\xbc\xaf\x27\x1c": ("an archive", "extract its files first"),
}
# names of a column with the unit of each row
UNIT_COLUMNS = ("unit", "units", "einheit", "unité", "unidad", "unità", "eenheid")
MAX_COLUMNS = 5000  # of a log; chosen by judgement
# bytes of text in one chunk: pyarrow's allocators keep about twenty times this size
LEAST_BLOCK_BYTES = 1 << 16
BLOCK_BYTES = 1 << 21
# what the names of the channels of one logger differ by: "TC1 (°C)", "TC2", "TC3_degC"
_DIGITS_AND_UNIT = re.compile(r"\d+|\s*[\[(][^\])]*[\])]\s*$|_(?:deg)?[CFK]$|_mV$")
MILLISECONDS = 1000  # of a second
# names of a column with the milliseconds of the stamps in another column
MILLISECOND_COLUMNS = ("ms", "msec", "millis", "millisecond", "milliseconds", "millisekunden")
# spellings of a missing value that pyarrow reads as NaN; infinite ones it reads as numbers
NULL_VALUES = sorted(
    {
        text
        for absent in ABSENT
        if "inf" not in absent
        for text in (absent, absent.upper(), absent.title(), "NaN", "-NaN")
    }
)


@dataclass(frozen=True)
class TextTable(Table):
    """A table whose cells are text, in a file or a sheet of a workbook, and its dialect."""

    dialect: Dialect


@dataclass(frozen=True)
class CsvTable(TextTable):
    """A table in a text file."""


@dataclass(frozen=True)
class Part:
    """Which table of a file with several is read.

    Attributes
    ----------
    sheet
        Sheet of a workbook; None: the only one with a table.
    variable
        Variable of a MATLAB file; None: the only one with a table.
    """

    sheet: str | None = None
    variable: str | None = None


def open_table(
    path: str | Path, known_names: Collection[str] = (), part: Part | None = None
) -> Table:
    """Open a log: by its first bytes, or its ending, and otherwise as text.

    Parameters
    ----------
    path
        The file.
    known_names
        Column names that the header may contain; they distinguish it from titles and units.
    part
        Which table of the file; None: the only one.

    Raises
    ------
    InputError
        If the file cannot be read, is empty, does not have the format of its ending, holds several
        tables of which none is chosen, or has too many columns.
    """
    table = _open_by_format(Path(path), known_names, part or Part())
    if len(table.names) > MAX_COLUMNS:
        raise InputError(
            f"has {len(table.names)} columns", where=table.where, expected=f"at most {MAX_COLUMNS}"
        )
    return table


def _open_by_format(file: Path, known_names: Collection[str], part: Part) -> Table:
    """The table of a file, by its first bytes, its ending, or as text.

    Parameters
    ----------
    file
        The file.
    known_names
        Column names that the header may contain.
    part
        Which table of the file.

    Returns
    -------
    Table
        The table of the reader; a ``CsvTable`` for text other than LVM.

    Raises
    ------
    InputError
        For a file of another kind, by its first bytes or its ending, and for a part that its format
        does not have; and as the readers do.

    Notes
    -----
    The order is: TDMS, then Parquet, each by its first bytes or its ending; LVM, CNV, workbooks and
    MATLAB files by their first bytes; refusal of other kinds by their first bytes; MATLAB files of
    version 4 by their ending; refusal of ``OTHER_ENDINGS``; text. Keep it: first bytes of one
    format and the ending of another must not change their reader, and any file could be text. A new
    format goes before the refusals. Guarded by ``tests/io/test_file_formats.py`` (each format),
    ``tests/io/test_other_kinds.py`` (the refusals) and ``tests/cli/test_options.py`` (another
    ending).
    """
    where = display_path(file)
    head = _first_bytes(file, where)
    ending = file.suffix.lower()
    is_workbook = head.startswith(ZIP_FIRST_BYTES)
    is_binary_mat = head.startswith(MAT_FIRST_BYTES)
    if part.sheet is not None and not is_workbook:
        raise _needless_part_error("sheet", "an .xlsx workbook", where)
    if part.variable is not None and not is_binary_mat and ending != MAT_ENDING:
        raise _needless_part_error("variable", "a .mat file", where)
    is_tdms = head.startswith(b"TDSm") or ending == ".tdms"
    is_parquet = head.startswith(b"PAR1") or ending in PARQUET_ENDINGS
    if is_tdms or is_parquet:
        # imported here: most logs need none of the libraries for these formats
        from tcdyn.io.binary import parquet_table, tdms_table

        return tdms_table(file, where) if is_tdms else parquet_table(file, where)
    if head.removeprefix(b"\xef\xbb\xbf").startswith(FIRST_BYTES):
        return lvm_table(file, where, text_chunks)
    if head.startswith(SEA_BIRD_FIRST_BYTES):
        return cnv_table(file, where, text_chunks)
    if is_workbook:
        return _sheet_table(file, where, known_names, part.sheet)
    if is_binary_mat:
        return _mat_table(file, where, part.variable)
    _check_no_other_kind(file, where, head)
    if ending == MAT_ENDING:
        return _mat_table(file, where, part.variable)
    if ending in OTHER_ENDINGS:
        raise InputError(
            f"is {OTHER_ENDINGS[ending]} by its ending", where=where, expected=LOG_FORMATS
        )
    dialect = _with_unit_column(detect_dialect(file, where, known_names))
    table = _table_of_text(file, dialect)
    return CsvTable(**vars(table))


def _table_of_text(file: Path, dialect: Dialect) -> TextTable:
    """The table of a text, with the metadata in a file beside it.

    Parameters
    ----------
    file
        The file.
    dialect
        Dialect of its text.
    """
    in_file_beside, findings = read_metadata(file, dialect.names)
    metadata = {**in_file_beside, **dialect.metadata}
    chunks = partial(text_chunks, dialect)
    if findings:
        chunks = partial(_chunks_with_findings, chunks, findings)
    first_cells = list(zip(dialect.names, dialect.first_row))
    clocks = [name for name, cell in first_cells if is_stamp(cell)]
    without_date = {name for name, cell in first_cells if is_time_of_day(cell)}
    clocks.sort(key=lambda name: name in without_date)
    dates = tuple(name for name, cell in first_cells if is_date(cell, name))
    return TextTable(
        dialect.where,
        dialect.names,
        metadata,
        chunks,
        dialect,
        units=dialect.units,
        clock_columns=tuple(clocks),
        date_columns=dates,
    )


def _mat_table(file: Path, where: str, variable: str | None) -> Table:
    """The table of a MATLAB file; see ``tcdyn.io.matlab.mat_table``."""
    from tcdyn.io.matlab import mat_table

    return mat_table(file, where, variable)


def _sheet_table(
    file: Path, where: str, known_names: Collection[str], sheet: str | None
) -> TextTable:
    """The table of a workbook.

    Parameters
    ----------
    file
        The file.
    where
        The file, for messages.
    known_names
        Column names that the header may contain.
    sheet
        The sheet; None: the only one with a table, or the only one of them with a time.

    Raises
    ------
    InputError
        Without such a sheet, with several of them, and as ``tcdyn.io.workbook`` does.
    """
    from tcdyn.io.workbook import open_workbook

    workbook = open_workbook(file, where)
    all_names = (*workbook.visible, *workbook.hidden)
    if sheet is not None and sheet not in all_names:
        raise missing_column_error("sheet", sheet, all_names, where)
    names = workbook.visible if sheet is None else (sheet,)
    metadata = workbook.metadata() if METADATA_SHEET in all_names else {}
    tables: dict[str, TextTable] = {}
    problems: list[InputError] = []
    for name in names:
        where_in_file = where if len(all_names) == 1 else f"{where}, sheet {printable(name)!r}"
        try:
            text = workbook.sheet_text(name)
            dialect = _with_unit_column(detect_dialect(file, where_in_file, known_names, text))
        except InputError as problem:
            problems.append(problem)
            continue
        table = _table_of_text(file, dialect)
        tables[name] = replace(table, metadata={**metadata, **table.metadata})
    if not tables and problems:
        raise problems[0]
    if not tables:
        raise InputError(
            "has no sheet that is not hidden",
            where=where,
            remedy="name its sheet, {sheet}",
            parameters={"sheet": next(iter(all_names), "NAME")},
        )
    # columns that are needed decide, where only one sheet has some of them
    needed = {name for name in known_names if not is_time_name(name)}
    with_needed = [name for name, table in tables.items() if needed.intersection(table.names)]
    with_time = [name for name, table in tables.items() if any(map(table.is_time, table.names))]
    candidates = with_needed if len(with_needed) == 1 else with_time or [*tables]
    if len(candidates) > 1:
        kind = "tables with a time" if with_time else "tables"
        raise InputError(
            f"has {len(candidates)} sheets with {kind}",
            where=where,
            expected=f"one of {', '.join(repr(printable(name)) for name in candidates)}",
            remedy="name the sheet, {sheet}",
            parameters={"sheet": printable(candidates[0])},
        )
    return tables[candidates[0]]


def _needless_part_error(option: str, kind: str, where: str) -> InputError:
    """The error for an option that names a part of a file that has none."""
    return InputError(
        f"{{{option}}} is given, but this is not {kind}",
        where=where,
        remedy=f"leave out {{{option}}}",
        parameters={option: None},
    )


def _check_no_other_kind(file: Path, where: str, head: bytes) -> None:
    """Raise InputError for a kind of file that is no log, by its first bytes.

    Parameters
    ----------
    file, where
        The file, and its name for messages.
    head
        Its first bytes.
    """
    if head.startswith(GZIP_FIRST_BYTES):
        raise InputError("this is a compressed file", where=where, remedy="decompress it first")
    if head.startswith(OLD_OFFICE_FIRST_BYTES):
        from tcdyn.io.workbook import refuse_old_excel

        refuse_old_excel(file, where)
    if head.startswith(MAT_7_3_FIRST_BYTES):
        from tcdyn.io.matlab import version_7_3_error

        raise version_7_3_error(file, where)
    if head.startswith(SQLITE_FIRST_BYTES):
        raise _database_error(file, where)
    for first_bytes, (kind, remedy) in OTHER_FIRST_BYTES.items():
        if head.startswith(first_bytes):
            raise InputError(f"this is {kind}", where=where, expected=LOG_FORMATS, remedy=remedy)


def _database_error(file: Path, where: str) -> InputError:
    """The error for an SQLite database, with the tables that it holds, if it can be opened."""
    address = f"{file.resolve().as_uri()}?mode=ro&immutable=1"
    query = "SELECT name FROM sqlite_master WHERE type IN ('table', 'view') ORDER BY name"
    names: list[str] = []
    try:
        with closing(sqlite3.connect(address, uri=True)) as database:
            names = [printable(str(name)) for (name,) in database.execute(query)]
    except (sqlite3.Error, UnicodeDecodeError):
        pass  # its kind is the message
    tables = ""
    if names:
        more = len(names) - LISTED_TABLES
        listed = ", ".join(map(repr, names[:LISTED_TABLES])) + (
            f" and {more} more" if more > 0 else ""
        )
        tables = f" with the tables {listed}" if len(names) > 1 else f" with the table {listed}"
    return InputError(
        f"this is an SQLite database{tables}",
        where=where,
        expected=LOG_FORMATS,
        remedy="export its table to CSV",
    )


def _with_unit_column(dialect: Dialect) -> Dialect:
    """The dialect with the unit of its only column of values, where a column of units states it.

    Such a column has one and the same unit in all rows.
    """
    first_cells = list(zip(dialect.names, dialect.first_row))
    units = [
        (name, cell)
        for name, cell in first_cells
        if name.strip().lower() in UNIT_COLUMNS and written_unit(cell)
    ]
    values = [
        name
        for name, cell in first_cells
        if is_number(cell, dialect.decimal) and not is_time_name(name) and not is_date(cell, name)
    ]
    if len(units) != 1 or len(values) != 1 or values[0] in dialect.units or unit_in(values[0]):
        return dialect
    name, cell = units[0]
    try:
        _, labels = read_labels(dialect, [name])[name]
    except InputError:  # the error comes again when the columns are read
        return dialect
    if len(labels) != 1:
        return dialect
    return replace(dialect, units={**dialect.units, values[0]: cell})


def _chunks_with_findings(
    chunks: Callable[[Sequence[str], int], Iterator[Columns]],
    findings: Sequence[Finding],
    requested: Sequence[str],
    rows: int = CHUNK_ROWS,
) -> Iterator[Columns]:
    """Yield chunks, the first of them with further findings; parameters as in ``Table``."""
    remaining = tuple(findings)
    for chunk in chunks(requested, rows):
        yield replace(chunk, findings=(*remaining, *chunk.findings))
        remaining = ()


def _first_bytes(file: Path, where: str) -> bytes:
    """The first bytes of a file.

    Parameters
    ----------
    file, where
        The file, and its name for messages.

    Raises
    ------
    InputError
        For a file that is missing, a folder, a pipe or device, cannot be read, or is empty.
    """
    check_no_device(file)
    try:
        with open(file, "rb") as stream:
            head = stream.read(64)
    except FileNotFoundError:
        raise InputError("no such file", where=where) from None
    except IsADirectoryError:
        raise InputError(
            "is a folder",
            where=where,
            expected="a log file",
            remedy=f"name its files, such as {where}/*.csv",
        ) from None
    except (OSError, ValueError) as problem:
        raise InputError(f"not readable ({problem})", where=where) from None
    if not head:
        raise InputError("the file is empty", where=where, expected="a log")
    return head


def check_no_device(path: str | Path) -> None:
    """Check that an input is no pipe and no device, from which reading may never end.

    Parameters
    ----------
    path
        The file; it need not exist.

    Raises
    ------
    InputError
        For a pipe, a socket or a device.

    Examples
    --------
    >>> check_no_device("no such file")
    """
    file = Path(path)
    try:
        is_special = file.exists() and not file.is_file() and not file.is_dir()
    except (OSError, ValueError):  # the reader has the message
        return
    if is_special:
        raise InputError(
            "is a pipe or a device",
            where=display_path(file),
            expected="a file, which can be read more than once",
            remedy="save its content to a file",
        )


def read_numbers(
    path: str | Path, names: Sequence[str], optional: Collection[str] = ()
) -> dict[str, Array]:
    """Columns (N,) of a table in which every cell is a number.

    Parameters
    ----------
    path
        The file.
    names
        Columns that the table must have.
    optional
        Columns that are read if the table has them.

    Returns
    -------
    dict
        Columns (N,) by name, without NaN.

    Raises
    ------
    InputError
        If the file cannot be read, a column is missing, or a cell holds no number.
    """
    table = open_table(path, (*names, *optional))
    where = display_path(Path(path))
    for name in names:
        if name not in table.names:
            raise InputError(f"column {name} is missing", where=where, expected=", ".join(names))
    available = [name for name in optional if name in table.names]
    columns = read_all_rows(table, [*names, *available])
    for name, values in columns.data.items():
        is_finite = np.isfinite(values)
        if not is_finite.all():
            row = columns.location.row(int(np.argmin(is_finite)))
            raise InputError(f"column {name}, row {row}: no number", where=where)
    return columns.data


def display_path(path: Path) -> str:
    """The path for messages: printable, on one line.

    >>> display_path(Path("a\\nb.csv"))
    'a\\\\nb.csv'
    """
    return printable(str(path))


def sha256_of_file(path: str | Path) -> str:
    """SHA-256 of the bytes of a file as 64 hexadecimal digits, read in bounded memory.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    check_no_device(path)
    try:
        with open(path, "rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as problem:
        raise InputError(f"not readable ({problem.strerror})", where=str(path)) from None


def open_text(dialect: Dialect) -> IO[bytes]:
    """Stream of the text of a log from its first byte."""
    if dialect.body is None:
        return open(dialect.path, "rb")
    return io.BytesIO(dialect.body)


def text_chunks(
    dialect: Dialect, requested: Sequence[str], rows: int = CHUNK_ROWS
) -> Iterator[Columns]:
    """Yield columns of a text log in chunks, in bounded memory.

    Parameters
    ----------
    dialect
        Dialect of the file.
    requested
        Names of the columns.
    rows
        Approximate number of rows in a chunk, which has at most 2 MB of text.

    Raises
    ------
    InputError
        For a damaged row, before the first chunk.

    Notes
    -----
    Columns of numbers are parsed by pyarrow. From the first cell on that is no number where numbers
    are expected, every column is read as text.
    """
    with open_text(dialect) as stream:
        checked = check_rows(stream, dialect)
    if checked.rows == 0:
        raise InputError("no rows below the header", where=dialect.where)
    if checked.comment_lines:
        dialect = replace(dialect, body=_without_lines(dialect, checked.comment_lines))
    reader = TextReader(dialect, requested, checked)
    try:
        yield from reader.chunks(rows, as_text=False)
    except pa.ArrowInvalid:
        reader.expect_text()
        try:
            yield from reader.chunks(rows, as_text=True)
        except pa.ArrowInvalid as problem:
            reason = str(problem).splitlines()[0][:160]
            raise InputError(f"the table cannot be read ({reason})", where=dialect.where) from None
    findings = [*checked.findings, *reader.findings()]
    if findings:
        yield Columns({name: np.empty(0) for name in requested}, checked.location, tuple(findings))


def read_labels(
    dialect: Dialect, names: Sequence[str], rows: int | None = None
) -> dict[str, tuple[NDArray[np.intp], tuple[str, ...]]]:
    """Cells of columns of a text log as labels, whatever they hold.

    Parameters
    ----------
    dialect
        Dialect of the file.
    names
        Names of the columns.
    rows
        Approximate number of rows; None: all.

    Returns
    -------
    dict
        By column: index of the label of each row (N,), -1 for an empty cell; and the labels.

    Raises
    ------
    InputError
        For a damaged row.

    Notes
    -----
    The rows are those of ``text_chunks``. pyarrow finds the different cells, so that a million rows
    need a tenth of a second.
    """
    with open_text(dialect) as stream:
        checked = check_rows(stream, dialect)
    if checked.comment_lines:
        dialect = replace(dialect, body=_without_lines(dialect, checked.comment_lines))
    reader = TextReader(dialect, [], checked)
    keys = {name: f"c{dialect.names.index(name)}" for name in dict.fromkeys(names)}
    parts: dict[str, list[pa.Array]] = {name: [] for name in keys}
    done = 0
    try:
        for batch in reader.batches(rows or CHUNK_ROWS, dict.fromkeys(keys.values(), pa.string())):
            for name, key in keys.items():
                parts[name].append(batch.column(key))
            done += batch.num_rows
            if rows is not None and done >= rows:
                break
    except pa.ArrowInvalid:
        raise InputError("a row cannot be read", where=dialect.where) from None
    labels_of = {}
    for name, cells in parts.items():
        encoded = pa.chunked_array(cells, pa.string()).combine_chunks().dictionary_encode()
        texts = _cells(encoded.dictionary, reader.encoding)
        labels = list(dict.fromkeys(text for text in texts if text.lower() not in ABSENT))
        index = {text: k for k, text in enumerate(labels)}
        code_of_cell = np.array([index.get(text, -1) for text in texts], dtype=np.intp)
        cell_of_row = np.asarray(encoded.indices.to_numpy(zero_copy_only=False), dtype=np.intp)
        codes = code_of_cell[cell_of_row] if len(texts) else cell_of_row
        labels_of[name] = (codes, tuple(labels))
    return labels_of


def _without_lines(dialect: Dialect, numbers: Sequence[int]) -> bytes:
    """The text with some of its lines blank; it is read into memory."""
    with open_text(dialect) as stream:
        lines = stream.readlines()
    for number in numbers:
        lines[number - 1] = b"\n"
    return b"".join(lines)


class TextReader:
    """Columns of one text log, with the state that its text columns keep from chunk to chunk."""

    def __init__(self, dialect: Dialect, requested: Sequence[str], checked: CheckedRows) -> None:
        """Decide which columns are dates, times of day and texts.

        Parameters
        ----------
        dialect
            Dialect of the file.
        requested
            Names of the columns.
        checked
            The rows of data; of a log that grows those that are there when it is opened.

        Notes
        -----
        A column whose first cell is no number holds text or numbers by all its cells in the rows of
        ``checked``. Rows that come later do not change it.
        """
        self.dialect = dialect
        self.encoding = "cp1252" if dialect.encoding == "cp1252" else "utf-8"
        self.wanted = requested
        self.checked = checked
        self.location = checked.location
        self.rows_done = 0
        self.last_day = ""
        self.reads_text = False
        self.text_columns: dict[str, TextColumn] = {}
        first_cells = dict(zip(reversed(dialect.names), reversed(dialect.first_row)))
        # a caller asks for the time first, and other clocks need not be readable
        self.first_clock = next((name for name in requested if is_stamp(first_cells[name])), "")
        self.date_columns = [name for name in dialect.names if is_date(first_cells[name], name)]
        # a time of day belongs to the date in the same row if there is one column of dates
        self.dated_columns: set[str] = set()
        if len(self.date_columns) == 1:
            self.dated_columns = {name for name in requested if is_time_of_day(first_cells[name])}
        names = list(requested)
        if self.dated_columns:
            names += self.date_columns
        self.millisecond_column = _millisecond_column(first_cells)
        if self.millisecond_column and self._is_counter(self.millisecond_column):
            self.millisecond_column = ""
        if self.millisecond_column:
            names.append(self.millisecond_column)
        # names may repeat in a file, so pyarrow gets numbered ones
        self.keys = {name: f"c{dialect.names.index(name)}" for name in dict.fromkeys(names)}
        self.word_columns = {*self.date_columns, self.millisecond_column}
        undecided = []
        for name in self.keys:
            cell = first_cells[name]
            kind = kind_of_cell(cell, dialect.decimal)
            if kind not in ("number", "absent") or is_stamp(cell):
                self.word_columns.add(name)
            is_plain_number = is_number(cell, dialect.decimal)
            if not is_plain_number and kind != "stamp" and name not in self.date_columns:
                undecided.append(name)
        self.columns_of_words = self._columns_of_words(undecided)
        self.word_columns |= self.columns_of_words

    def _columns_of_words(self, names: Sequence[str]) -> set[str]:
        """Those of the columns that hold text, by all their cells; their first one is no number."""
        if not names:
            return set()
        counts: dict[str, Counter[str]] = {name: Counter() for name in names}
        types = {self.keys[name]: pa.string() for name in names}
        try:
            for batch in self.batches(CHUNK_ROWS, types):
                for name in names:
                    counts[name].update(_cells(batch.column(self.keys[name]), self.encoding))
        except pa.ArrowInvalid:
            pass  # the error comes again, with its row, when the columns are read
        texts = {name for name in names if is_text(counts[name], self.dialect.decimal)}
        return {name for name in texts if not self._is_dead_channel(name, counts[name])}

    def _is_dead_channel(self, name: str, counts: Counter[str]) -> bool:
        """Whether a column of one word is a channel without readings, such as TC2 beside TC1.

        Its name then differs from that of a column of numbers by its digits and its unit only.
        """
        words = [text for text in counts if text.lower() not in ABSENT]
        stem = _DIGITS_AND_UNIT.sub("", name)
        if len(words) != 1 or not re.search(r"\d", name):
            return False
        others = zip(self.dialect.names, self.dialect.first_row)
        return any(
            _DIGITS_AND_UNIT.sub("", other) == stem and is_number(cell, self.dialect.decimal)
            for other, cell in others
        )

    def _is_counter(self, name: str) -> bool:
        """Whether milliseconds go on beyond 999 in the first rows: no part of a second."""
        key = f"c{self.dialect.names.index(name)}"
        try:
            first_rows = next(self.batches(CHUNK_ROWS, {key: pa.string()}))
        except (pa.ArrowInvalid, StopIteration):
            return False  # the error comes again, with its row, when the columns are read
        cells = _cells(first_rows.column(key), self.encoding)
        return any(cell.isdecimal() and int(cell) >= MILLISECONDS for cell in cells)

    def batches(self, rows: int, types: dict[str, Any]) -> Iterator[pa.RecordBatch]:
        """Yield columns of these types by key, in batches of about so many rows."""
        with open_text(self.dialect) as stream:
            for _ in range(self.dialect.skip):
                stream.readline()
            for lines in self._blocks(stream, rows):
                yield self._parse_lines(lines, types)

    def _blocks(self, stream: IO[bytes], rows: int) -> Iterator[bytes]:
        """Yield complete rows from the position of the stream on, in small blocks.

        A block holds about ``rows`` rows as long as the first one, between ``LEAST_BLOCK_BYTES``
        and ``BLOCK_BYTES``.
        """
        first_row = self.dialect.first_row
        line_bytes = max(len(first_row) * 4, sum(len(cell) + 1 for cell in first_row))
        block_bytes = min(max(rows * line_bytes, LEAST_BLOCK_BYTES), BLOCK_BYTES)
        position = stream.tell()
        end = self.checked.end
        while lines := stream.read(block_bytes) + stream.readline():
            while self.checked.has_line_breaks and lines.count(b'"') % 2:  # inside a quoted cell
                more = stream.readline()
                lines += more
                if not more:
                    break
            if end is not None:
                lines = lines[: end - position]
            position += len(lines)
            if lines.strip():
                yield lines
            if position == end:
                return

    def chunks(self, rows: int, as_text: bool) -> Iterator[Columns]:
        """Yield the chunks after the rows that are done.

        Parameters
        ----------
        rows
            Approximate number of rows in a chunk.
        as_text
            Read every column as text.
        """
        skip = self.rows_done
        for batch in self.batches(rows, self._types(as_text)):
            new_rows = batch.slice(min(skip, batch.num_rows))
            skip -= batch.num_rows - new_rows.num_rows
            if new_rows.num_rows:
                yield self._columns(new_rows)
                self.rows_done += new_rows.num_rows

    def parse(self, lines: bytes) -> Columns:
        """The columns of complete lines that follow the rows that are done.

        Raises
        ------
        InputError
            For lines that cannot be parsed.
        """
        try:
            batch = self._parse_lines(lines, self._types(self.reads_text))
        except pa.ArrowInvalid:
            if not self.reads_text:
                self.expect_text()
                self.reads_text = True
                return self.parse(lines)
            raise InputError("a row cannot be read", where=self.dialect.where) from None
        columns = self._columns(batch)
        self.rows_done += batch.num_rows
        return columns

    def _parse_lines(self, lines: bytes, types: dict[str, Any]) -> pa.RecordBatch:
        """Parse complete rows to a batch with columns of these types by key."""
        # a copy that pyarrow owns: at the end of the program, a thread of pyarrow that still has to
        # release an object of Python would abort it
        native = pa.BufferOutputStream()
        native.write(lines)
        table = pacsv.read_csv(
            pa.BufferReader(native.getvalue()),
            pacsv.ReadOptions(
                column_names=[f"c{i}" for i in range(len(self.dialect.names))],
                block_size=len(lines) + 1,
                use_threads=False,
            ),
            pacsv.ParseOptions(
                delimiter=self.dialect.separator,
                newlines_in_values=self.checked.has_line_breaks,
            ),
            pacsv.ConvertOptions(
                include_columns=list(types),
                column_types=types,
                decimal_point=self.dialect.decimal,
                null_values=NULL_VALUES,
                check_utf8=False,
            ),
        )
        return table.combine_chunks().to_batches()[0]

    def _types(self, as_text: bool) -> dict[str, Any]:
        """Types of the columns by key; with ``as_text`` all are text."""
        types = {}
        for name, key in self.keys.items():
            is_string = as_text or name in self.word_columns
            types[key] = pa.string() if is_string else pa.float64()
        return types

    def expect_text(self) -> None:
        """Read columns of numbers as text from here on; they hold no clock times."""
        if not self.rows_done:
            return
        for name in self.keys:
            if name not in self.word_columns:
                column = TextColumn(name, self.dialect.decimal, self.location, clock=False)
                self.text_columns[name] = column

    def findings(self, is_complete: bool = True) -> list[Finding]:
        """Findings about the text columns.

        Parameters
        ----------
        is_complete
            Whether a column with too few numbers is an error; in a log that grows its rows are
            used already, and it is a warning.

        Raises
        ------
        InputError
            For a column with too few numbers.
        """
        columns = self.text_columns.values()
        rows = self.rows_done
        return [finding for column in columns for finding in column.findings(rows, is_complete)]

    def _columns(self, batch: pa.RecordBatch) -> Columns:
        """The wanted columns of one batch as numbers, and the cells of its dates and clock times.

        Columns of text are parsed cell by cell. Warnings about them name the row in the file, which
        is counted from ``rows_done``.
        """
        data: dict[str, Array] = {}
        stamps: dict[str, NDArray[Any]] = {}
        for name in self.wanted:
            column = batch.column(self.keys[name])
            if pa.types.is_floating(column.type):
                data[name] = np.array(column.to_numpy(zero_copy_only=False), dtype=np.float64)
                continue
            cells = _cells(column, self.encoding)
            if name in self.date_columns or name in self.columns_of_words:
                data[name] = np.full(batch.num_rows, np.nan)
                stamps[name] = np.array(cells, dtype=object)
                continue
            text_column = self.text_columns.get(name)
            if text_column is None:
                is_time = name == self.first_clock
                text_column = TextColumn(
                    name, self.dialect.decimal, self.location, words=False, is_time=is_time
                )
                self.text_columns[name] = text_column
            texts = self._with_dates(batch, cells) if name in self.dated_columns else cells
            data[name] = text_column.numbers(texts, self.rows_done)
            if text_column.clock:
                stamps[name] = np.array(cells, dtype=object)
                if self.millisecond_column and not has_fraction(cells[0]):
                    data[name] = data[name] + self._milliseconds(batch)
        return Columns(data, self.location, (), stamps)

    def _with_dates(self, batch: pa.RecordBatch, cells: list[str]) -> list[str]:
        """Times of day with the date of their row, or the last one above it."""
        texts = []
        days = _cells(batch.column(self.keys[self.date_columns[0]]), self.encoding)
        for day, cell in zip(days, cells):
            self.last_day = day or self.last_day
            texts.append(f"{self.last_day} {cell}" if cell else "")
        return texts

    def _milliseconds(self, batch: pa.RecordBatch) -> Array:
        """Milliseconds (N,) in a column of their own [s]; NaN where there are none."""
        texts = _cells(batch.column(self.keys[self.millisecond_column]), self.encoding)
        return np.array([1e-3 * float(t) if is_number(t) else np.nan for t in texts])


def _millisecond_column(first_cells: dict[str, str]) -> str:
    """The one column with the milliseconds of stamps in whole seconds; empty if there is none."""
    columns = []
    for name, cell in first_cells.items():
        plain_name = name.strip().lower()
        if plain_name in MILLISECOND_COLUMNS and cell.isdecimal() and int(cell) < MILLISECONDS:
            columns.append(name)
    return columns[0] if len(columns) == 1 else ""


def _cells(column: pa.Array, encoding: str) -> list[str]:
    """Cells of a text column, without quotes and spaces around them."""
    cells = []
    for cell in column.cast(pa.binary()).to_pylist():
        text = "" if cell is None else cell.decode(encoding, errors="replace")
        cells.append(text.strip().strip('"').strip())
    return cells
