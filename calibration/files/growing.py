"""A text table that is still growing: its whole new lines as rows of numbers, from wherever reading was stopped."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from calibration import Array
from calibration.errors import InputError
from calibration.files import CsvTable, open_table, shown
from calibration.files.dialect import ABSENT, FLAGS, split

MOST_BYTES = 1 << 19  # read at once: half a megabyte, a few thousand rows


@dataclass
class GrowingTable:
    """A table whose header is known, and how far it has been read: whole lines up to ``offset`` bytes.

    ``first_byte``: where the rows begin; ``hash`` of what was read; ``rows`` and ``bad`` lines counted.
    """

    path: Path
    table: CsvTable
    first_byte: int
    offset: int = 0
    rows: int = 0
    bad: int = 0
    hash: Any = field(default_factory=hashlib.sha256)

    def seek(self, offset: int) -> None:
        """Go to ``offset`` bytes, taking what lies before it into the hash. InputError for a file that is shorter."""
        self.hash, left = hashlib.sha256(), offset
        with open(self.path, "rb") as stream:
            while left and (part := stream.read(min(left, 1 << 20))):
                self.hash.update(part)
                left -= len(part)
        if left:
            raise InputError("the log is shorter than the state file remembers", where=shown(self.path))
        self.offset = offset

    def first_numbers(self, place: int, most: int = 100) -> Array:
        """The field at ``place`` of the first rows, at most ``most`` of them, NaN for what is no number."""
        dialect = self.table.dialect
        with open(self.path, "rb") as stream:
            stream.seek(self.first_byte)
            lines = [line.decode("latin-1") for line in islice(stream, most) if line.endswith(b"\n")]
        rows = [split(line, dialect.separator) for line in lines]
        return np.array([_number(row[place], dialect.decimal) for row in rows if len(row) == len(dialect.names)])

    def new_rows(self, places: Sequence[int]) -> list[list[float]] | None:
        """The fields at ``places`` of the lines that are new, NaN for what is no number; None without a whole line.

        Lines of another number of fields are counted as bad. Raises InputError for a file that became shorter.
        """
        if (self.path.stat().st_size if self.path.exists() else 0) < self.offset:
            raise InputError("the log became shorter while it was followed", where=shown(self.path))
        with open(self.path, "rb") as stream:
            stream.seek(self.offset)
            new = stream.read(MOST_BYTES)
        whole = new[: new.rfind(b"\n") + 1]
        if not whole:
            return None
        self.offset += len(whole)
        self.hash.update(whole)
        dialect = self.table.dialect
        lines = [split(line, dialect.separator) for line in whole.decode("latin-1").splitlines() if line.strip()]
        good = [parts for parts in lines if len(parts) == len(dialect.names)]
        self.rows, self.bad = self.rows + len(good), self.bad + len(lines) - len(good)
        return [[_number(parts[at], dialect.decimal) for at in places] for parts in good]


def open_growing(path: Path, known: Sequence[str]) -> GrowingTable | None:
    """The table once its header and two whole rows stand in it (a half-written one would mislead); None before.

    ``known``: column names that tell a header. Raises InputError for another format than text.
    """
    if not path.exists() or path.stat().st_size == 0:
        return None
    table = open_table(path, known)
    if not isinstance(table, CsvTable) or table.dialect.body is not None:
        raise InputError("does not grow line by line", where=shown(path), expected="a CSV log to follow (UTF-8)")
    with open(path, "rb") as stream:
        head = [stream.readline() for _ in range(table.dialect.skip)]
        below = [stream.readline(), stream.readline()]
    whole = all(line.endswith(b"\n") for line in below)
    return GrowingTable(path, table, sum(len(line) for line in head)) if whole else None


def _number(text: str, decimal: str) -> float:
    try:
        return float(text if decimal == "." else text.replace(",", "."))
    except ValueError:
        low = text.lower()
        return FLAGS.get(low, np.nan) if low not in ABSENT else np.nan
