"""A log file as columns of numbers, whatever its ending: names first, the wanted columns on demand."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from calibration.errors import InputError

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Columns:
    """The wanted columns, float64 of shape (N,), NaN where the file has no number; notes say what was done."""

    data: dict[str, FloatArray]
    notes: tuple[str, ...] = ()
    rows: RowNumbers = field(default_factory=lambda: RowNumbers())


@dataclass(frozen=True)
class RowNumbers:
    """What people see in an editor: sample ``i`` stands in line ``first + i`` plus the blank lines before it."""

    first: int = 1
    blank: tuple[int, ...] = ()

    def of(self, index: int) -> int:
        """Line number of sample ``index``."""
        line = self.first + int(index)
        for gap in self.blank:
            line += gap <= line
        return line


class Table(Protocol):
    """What every reader offers."""

    @property
    def names(self) -> tuple[str, ...]:
        """The columns' names as the file has them."""
        ...

    @property
    def metadata(self) -> dict[str, str]:
        """What the file says about itself."""
        ...

    def read(self, wanted: Sequence[str]) -> Columns:
        """The wanted columns by their names in the file."""
        ...

    def chunks(self, wanted: Sequence[str], rows: int = 50_000) -> Iterator[Columns]:
        """The same piece by piece."""
        ...


def open_table(path: str | Path, known: Collection[str] = ()) -> Table:
    """Open a log by its ending: .tdms, .lvm, .parquet; every other ending is text.

    ``known`` are names that the header may hold (they tell the header from titles and units).
    Raises InputError for a file that cannot be read, is empty, or is not what its ending says.
    """
    from calibration.files.csvtable import CsvTable
    from calibration.files.lvm import read_lvm
    from calibration.files.parquet import ParquetTable
    from calibration.files.tdms import TdmsTable

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
        return TdmsTable(file, where)
    if head.startswith(b"PAR1") or ending in (".parquet", ".pq"):
        return ParquetTable(file, where)
    if ending == ".lvm" or head.lstrip(b"\xef\xbb\xbf").startswith(b"LabVIEW Measurement"):
        return read_lvm(file, where, known)
    if head.startswith((b"PK\x03\x04", b"\xd0\xcf\x11\xe0")):
        raise InputError("this is a spreadsheet or archive", where=where, expected="CSV", remedy="save it as CSV")
    if ending in (".json", ".toml", ".html"):
        kind = {".json": "a record or result", ".toml": "a rig file", ".html": "a report"}[ending]
        raise InputError(f"is {kind} by its ending", where=where, expected="a log (CSV, LVM, TDMS or Parquet)")
    return CsvTable.open(file, where, known)


def shown(path: Path) -> str:
    """The path as errors show it: printable, on one line.

    >>> shown(Path("a\\nb.csv"))
    'a\\\\nb.csv'
    """
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in str(path))
