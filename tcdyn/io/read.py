"""Any file of a logger to named columns: ``open_table`` chooses the reader by ending and first bytes.

Text is read here: every row's fields counted, numbers parsed exactly, clock times and on/off words understood.
"""

from __future__ import annotations

import hashlib
import io
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import IO, Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import csv as pacsv

from tcdyn.core import Array
from tcdyn.core.errors import InputError, printable
from tcdyn.core.findings import Finding, SampleLocation, warning
from tcdyn.io.csv_dialect import ABSENT, Dialect, TextColumn, is_number, sniff
from tcdyn.io.lvm import MARK, lvm_table
from tcdyn.io.table import PIECE_ROWS, Columns, Table, read_whole
from tcdyn.io.times import is_date, is_time_of_day

__all__ = [
    "CsvTable",
    "Table",
    "open_table",
    "read_numbers",
    "read_whole",
    "sha256",
    "shown",
    "text_of",
]

PARQUET = (".parquet", ".pq")
NO_LOGS = {".json": "a record or result", ".toml": "a rig file", ".html": "a report"}
MOST_COLUMNS = 5000
BLOCK_BYTES = 1 << 21  # of text in one piece, at most
COUNTED_BYTES = 1 << 17  # of text whose rows are counted at once
_NULLS = sorted(
    {w for a in ABSENT if "inf" not in a for w in (a, a.upper(), a.title(), "NaN", "-NaN")}
)


@dataclass(frozen=True)
class CsvTable(Table):
    """A table of text, and the dialect it is written in."""

    dialect: Dialect


def open_table(path: str | Path, known: Collection[str] = ()) -> Table:
    """Open a log by its ending: .tdms, .lvm, .parquet; every other ending is text.

    ``known`` are names that the header may hold (they tell the header from titles and units).
    Raises InputError for a file that cannot be read, is empty, is not what its ending says, or has too many columns.
    """
    table = _opened(Path(path), known)
    if len(table.names) > MOST_COLUMNS:
        raise InputError(
            f"has {len(table.names)} columns", where=table.where, expected=f"at most {MOST_COLUMNS}"
        )
    return table


def _opened(file: Path, known: Collection[str]) -> Table:
    where = shown(file)
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
    ending = file.suffix.lower()
    if (
        (tdms := head.startswith(b"TDSm") or ending == ".tdms")
        or head.startswith(b"PAR1")
        or ending in PARQUET
    ):
        from tcdyn.io.binary import parquet_table, tdms_table  # whose libraries few logs need

        return tdms_table(file, where) if tdms else parquet_table(file, where)
    if head.removeprefix(b"\xef\xbb\xbf").startswith(MARK):
        return lvm_table(file, where, text_pieces)
    if head.startswith((b"PK\x03\x04", b"\xd0\xcf\x11\xe0")):
        raise InputError(
            "this is a spreadsheet or archive", where=where, expected="CSV", remedy="save it as CSV"
        )
    if ending in NO_LOGS:
        expected = "a log (CSV, LVM, TDMS or Parquet)"
        raise InputError(f"is {NO_LOGS[ending]} by its ending", where=where, expected=expected)
    dialect = sniff(file, where, known)
    pieces = partial(text_pieces, dialect)
    return CsvTable(where, dialect.names, dialect.metadata, pieces, dialect, units=dialect.units)


def read_numbers(
    path: str | Path, names: Sequence[str], optional: Collection[str] = ()
) -> dict[str, Array]:
    """The named columns (N,) of a table in which every cell of them is a number; of the ``optional``, those there are.

    Raises InputError for a file that cannot be read, a missing column, or a cell without a number.
    """
    table = open_table(path, (*names, *optional))
    where = shown(Path(path))
    for name in names:
        if name not in table.names:
            raise InputError(f"column {name} is missing", where=where, expected=", ".join(names))
    columns = read_whole(table, [*names, *(n for n in optional if n in table.names)])
    for name, values in columns.data.items():
        if not np.isfinite(values).all():
            row = columns.place.row(int(np.argmin(np.isfinite(values))))
            raise InputError(f"column {name}, row {row}: no number", where=where)
    return columns.data


def shown(path: Path) -> str:
    """The path as errors show it: printable, on one line.

    >>> shown(Path("a\\nb.csv"))
    'a\\\\nb.csv'
    """
    return printable(str(path))


def sha256(path: str | Path) -> str:
    """SHA-256 of the file's bytes as 64 hexadecimal digits, read in bounded memory."""
    try:
        with open(path, "rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as problem:
        raise InputError(f"not readable ({problem.strerror})", where=str(path)) from None


def text_of(dialect: Dialect) -> IO[bytes]:
    """The text from its first byte."""
    return open(dialect.path, "rb") if dialect.body is None else io.BytesIO(dialect.body)


def text_pieces(
    dialect: Dialect, wanted: Sequence[str], rows: int = PIECE_ROWS
) -> Iterator[Columns]:
    """The wanted columns piece by piece, about ``rows`` rows each (2 MB of text at most), in bounded memory.

    From the first cell on that is no number where numbers were, every column is read as text.
    Raises InputError for a damaged row before the first piece.
    """
    d = dialect
    with text_of(d) as stream:
        count, place, found = check_rows(stream, d)
    if count == 0:
        raise InputError("no rows below the header", where=d.where)
    first_cells = dict(zip(reversed(d.names), reversed(d.first_row)))
    dates = [name for name in d.names if is_date(first_cells[name], name)]
    # a time of day beside one column of dates: the date belongs to it
    dated = {name for name in wanted if len(dates) == 1 and is_time_of_day(first_cells[name])}
    read_names = list(dict.fromkeys([*wanted, *(dates if dated else ())]))
    keys = {
        name: f"c{d.names.index(name)}" for name in read_names
    }  # names in files may repeat; these do not
    cells = {name: first_cells[name] for name in read_names}
    words = {
        n
        for n, cell in cells.items()
        if not is_number(cell, d.decimal) and cell.lower() not in ABSENT
    }
    words.update(dates)
    texts: dict[str, TextColumn] = {}
    line = max(len(d.first_row) * 4, sum(len(cell) + 1 for cell in d.first_row))
    # small blocks, none read ahead: the allocators keep some twenty times a block for themselves
    read = pacsv.ReadOptions(
        skip_rows=d.skip,
        column_names=[f"c{i}" for i in range(len(d.names))],
        block_size=min(max(rows * line, 1 << 16), BLOCK_BYTES),
        use_threads=False,
    )
    parse = pacsv.ParseOptions(delimiter=d.separator)
    done = 0
    for as_text in (False, True):
        convert = pacsv.ConvertOptions(
            include_columns=list(keys.values()),
            column_types={
                k: pa.string() if as_text or n in words else pa.float64() for n, k in keys.items()
            },
            decimal_point=d.decimal,
            null_values=_NULLS,
            check_utf8=False,
        )
        skip = done
        try:
            with text_of(d) as stream:
                for batch in pacsv.open_csv(stream, read, parse, convert):
                    part = batch.slice(min(skip, batch.num_rows))
                    skip -= batch.num_rows - part.num_rows
                    if part.num_rows:
                        numbers: dict[str, Array] = {}
                        stamps: dict[str, NDArray[Any]] = {}
                        for name in wanted:
                            column = part.column(keys[name])
                            if name in dates:
                                numbers[name] = np.full(part.num_rows, np.nan)
                                stamps[name] = np.array(_cells(column), dtype=object)
                                continue
                            day = _cells(part.column(keys[dates[0]])) if name in dated else None
                            numbers[name] = _numbers(column, name, d, done, place, texts, day)
                            if name in texts and texts[name].clock:
                                stamps[name] = np.array(_cells(column), dtype=object)
                        yield Columns(numbers, place, (), stamps)
                        done += part.num_rows
            break
        except pa.ArrowInvalid as problem:
            if as_text:
                text = str(problem).splitlines()[0][:160]
                raise InputError(f"the table cannot be read ({text})", where=d.where) from None
            if done:  # numbers so far: no clock
                texts |= {
                    name: TextColumn(name, d.decimal, place, clock=False)
                    for name in keys
                    if name not in words
                }
    found += [f for column in texts.values() for f in column.judge(done)]
    if found:
        yield Columns({name: np.empty(0) for name in wanted}, place, tuple(found))


def _numbers(
    column: pa.Array,
    name: str,
    dialect: Dialect,
    at: int,
    place: SampleLocation,
    texts: dict[str, TextColumn],
    days: list[str] | None = None,
) -> Array:
    """Numbers of one piece, whose first is number ``at`` of the file's; ``texts`` keeps the columns of text. ``days``:
    dates of the rows, for a column of times of the day."""
    if pa.types.is_floating(column.type):
        return np.array(column.to_numpy(zero_copy_only=False), dtype=np.float64)
    if name not in texts:
        texts[name] = TextColumn(name, dialect.decimal, place)
    cells = _cells(column)
    if days is not None:
        cells = [f"{day} {cell}" if cell else "" for day, cell in zip(days, cells)]
    return texts[name].numbers(cells, at)


def _cells(column: pa.Array) -> list[str]:
    """The cells of a column of text, quotes and spaces around them taken away."""
    cells = (b"" if cell is None else cell for cell in column.cast(pa.binary()).to_pylist())
    return [c.decode("utf-8", errors="replace").strip().strip('"').strip() for c in cells]


def check_rows(stream: IO[bytes], dialect: Dialect) -> tuple[int, SampleLocation, list[Finding]]:
    """How many rows of data there are, where they stand, and what was noticed: the fields of every row are counted.

    A short or long row is refused by its number, a last short one as truncated; a last row without line end may have
    lost digits: that is noted.
    """
    separator = dialect.separator.encode()
    where = dialect.where
    fields = len(dialect.names)
    blank: list[int] = []
    rows = 0
    seen = dialect.skip
    line = b"\n"
    short: tuple[int, int] | None = None
    for _ in range(dialect.skip):
        line = stream.readline() or line
    while block := stream.read(COUNTED_BYTES) + stream.readline():
        if (
            short is None
            and len(block) < 2 * COUNTED_BYTES
            and block.endswith(b"\n")
            and b"\x00" not in block
        ):
            cells = np.frombuffer(block, np.uint8)
            ends = np.flatnonzero(cells == ord("\n"))
            before = np.searchsorted(np.flatnonzero(cells == ord(separator)), ends)
            if np.array_equal(
                before, np.arange(1, len(ends) + 1) * (fields - 1)
            ):  # as nearly always
                rows = rows + len(ends)
                seen = seen + len(ends)
                line = block[-1:]
                continue
        for number, line in enumerate(io.BytesIO(block), seen + 1):
            if short is not None and line.strip():
                raise _row_error(short, fields, where)
            count = line.count(separator)
            if count == fields - 1:
                rows += 1
            elif not line.strip():
                blank.append(number)
            elif count < fields - 1:
                short = (number, count + 1)
            elif b'"' not in line:
                raise _row_error((number, count + 1), fields, where)
            if b"\x00" in line:
                raise InputError(f"row {number} holds zero bytes: the file is damaged", where=where)
        seen = number
    if short is not None:
        raise InputError(
            f"row {short[0]}, the last, has {short[1]} of {fields} fields: the file is truncated",
            where=where,
            expected="a whole last row",
            remedy="copy the file again, or delete the last row",
        )
    whole = line.endswith((b"\n", b"\r"))
    found = [] if whole else [warning("text.no_line_end", row=dialect.skip + rows + len(blank))]
    return rows, SampleLocation(where, dialect.skip + 1, tuple(blank)), found


def _row_error(row: tuple[int, int], fields: int, where: str) -> InputError:
    return InputError(
        f"row {row[0]} has {row[1]} fields",
        where=where,
        expected=f"{fields} as in the first row",
        remedy="repair or delete that row",
    )
