"""Any file of a logger to named columns: ``open_table`` chooses the reader by ending and first bytes."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from calibration import Array
from calibration.errors import InputError
from calibration.files.binary import parquet_table, tdms_table
from calibration.files.csvtable import CsvTable, text_pieces
from calibration.files.dialect import sniff
from calibration.files.lvm import MARK, lvm_table
from calibration.files.table import Table, read_whole

__all__ = ["Table", "open_table", "read_numbers", "read_whole", "sha256", "shown"]

NO_LOGS = {".json": "a record or result", ".toml": "a rig file", ".html": "a report"}


def open_table(path: str | Path, known: Collection[str] = ()) -> Table:
    """Open a log by its ending: .tdms, .lvm, .parquet; every other ending is text.

    ``known`` are names that the header may hold (they tell the header from titles and units).
    Raises InputError for a file that cannot be read, is empty, or is not what its ending says.
    """
    file = Path(path)
    where = shown(file)
    try:
        with open(file, "rb") as stream:
            head = stream.read(64)
    except FileNotFoundError:
        raise InputError("no such file", where=where) from None
    except IsADirectoryError:
        raise InputError(
            "is a folder", where=where, expected="a log file", remedy=f"name its files, such as {where}/*.csv"
        ) from None
    except (OSError, ValueError) as problem:
        raise InputError(f"not readable ({problem})", where=where) from None
    if not head:
        raise InputError("the file is empty", where=where, expected="a log")
    ending = file.suffix.lower()
    if head.startswith(b"TDSm") or ending == ".tdms":
        return tdms_table(file, where)
    if head.startswith(b"PAR1") or ending in (".parquet", ".pq"):
        return parquet_table(file, where)
    if head.removeprefix(b"\xef\xbb\xbf").startswith(MARK):
        return lvm_table(file, where)
    if head.startswith((b"PK\x03\x04", b"\xd0\xcf\x11\xe0")):
        raise InputError("this is a spreadsheet or archive", where=where, expected="CSV", remedy="save it as CSV")
    if ending in NO_LOGS:
        expected = "a log (CSV, LVM, TDMS or Parquet)"
        raise InputError(f"is {NO_LOGS[ending]} by its ending", where=where, expected=expected)
    dialect = sniff(file, where, known)
    return CsvTable(where, dialect.names, dialect.metadata, partial(text_pieces, dialect), dialect)


def read_numbers(path: str | Path, names: Sequence[str], optional: Collection[str] = ()) -> dict[str, Array]:
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
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in str(path))


def sha256(path: str | Path) -> str:
    """SHA-256 of the file's bytes as 64 hexadecimal digits, read in bounded memory."""
    try:
        with open(path, "rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as problem:
        raise InputError(f"not readable ({problem.strerror})", where=str(path)) from None
