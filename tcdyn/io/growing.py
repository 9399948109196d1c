"""A text table that is still growing: its whole new lines as rows of numbers, from wherever reading was stopped."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.io.csv_dialect import ABSENT, FLAGS, split
from tcdyn.io.read import CsvTable, open_table, shown

MOST_BYTES = 1 << 19  # read at once: half a megabyte, a few thousand rows
TAIL_BYTES = 256  # before the place of reading: compared at each reading, a few rows


@dataclass
class GrowingTable:
    """A table whose header is known, and how far it has been read: whole lines up to ``offset`` bytes.

    ``first_byte``: where the rows begin; ``hash`` of what was read; ``rows`` and ``bad`` lines counted. ``header``: the
    bytes before the rows; ``tail``: the last bytes that were read; ``file``: device and inode of the file.
    """

    path: Path
    table: CsvTable
    first_byte: int
    offset: int = 0
    rows: int = 0
    bad: int = 0
    hash: Any = field(default_factory=hashlib.sha256)
    header: bytes = b""
    tail: bytes = b""
    file: tuple[int, int] = (0, 0)

    def seek(self, offset: int) -> None:
        """Go to ``offset`` bytes, taking what lies before it into the hash. InputError for a file that is shorter."""
        with open(self.path, "rb") as stream:
            self.file = _identity(stream)
            whole, self.hash, self.tail = _read_to(stream, offset)
        if not whole:
            raise InputError(
                "the log is shorter than the state file remembers", where=shown(self.path)
            )
        self.offset = offset

    def first_numbers(self, place: int, most: int = 100) -> Array:
        """The field at ``place`` of the first rows, at most ``most`` of them, NaN for what is no number."""
        dialect = self.table.dialect
        with open(self.path, "rb") as stream:
            stream.seek(self.first_byte)
            lines = [
                line.decode("latin-1") for line in islice(stream, most) if line.endswith(b"\n")
            ]
        rows = [split(line, dialect.separator) for line in lines]
        return np.array(
            [_number(row[place], dialect.decimal) for row in rows if len(row) == len(dialect.names)]
        )

    def new_rows(self, places: Sequence[int]) -> list[list[float]] | None:
        """The fields at ``places`` of the lines that are new, NaN for what is no number; None without a whole line.

        Lines of another number of fields are counted as bad. Raises InputError for a file that became shorter, was
        replaced by another one, or was written anew.
        """
        new = self._new_bytes()
        whole = new[: new.rfind(b"\n") + 1]
        if not whole:
            return None
        self.offset += len(whole)
        self.hash.update(whole)
        self.tail = (self.tail + whole)[-TAIL_BYTES:]
        dialect = self.table.dialect
        texts = [line.removesuffix(b"\r").decode("latin-1") for line in whole.split(b"\n")]
        lines = [split(line, dialect.separator) for line in texts if line.strip()]
        good = [parts for parts in lines if len(parts) == len(dialect.names)]
        self.rows, self.bad = self.rows + len(good), self.bad + len(lines) - len(good)
        return [[_number(parts[at], dialect.decimal) for at in places] for parts in good]

    def _new_bytes(self) -> bytes:
        """What stands behind ``offset``, once it is certain that what stands before it is what was read.

        A cheap check each time: size, header, the last bytes. Where the path leads to another file, the whole of it: a
        copy of the log that replaced it, as programs that synchronise folders make it, is accepted.
        """
        try:
            with open(self.path, "rb") as stream:
                file = _identity(stream)
                size = os.fstat(stream.fileno()).st_size
                if size < self.offset:
                    raise self._not_the_log(
                        f"it became shorter ({size} bytes, {self.offset} were read)"
                    )
                if file != self.file:
                    if _read_to(stream, self.offset)[1].digest() != self.hash.digest():
                        raise self._not_the_log("another file with other rows is in its place")
                    self.file = file
                stream.seek(0)
                if stream.read(len(self.header)) != self.header:
                    raise self._not_the_log("its header was changed")
                stream.seek(self.offset - len(self.tail))
                if stream.read(len(self.tail)) != self.tail:
                    raise self._not_the_log("rows that were read already were changed")
                return stream.read(MOST_BYTES)
        except FileNotFoundError:
            raise self._not_the_log("there is no such file any more") from None

    def _not_the_log(self, reason: str) -> InputError:
        return InputError(
            f"the log was replaced, rotated or rewritten while it was followed: {reason}",
            where=shown(self.path),
            remedy="follow the new log with another {out} (and another {state})",
            parameters={"out": "FILE", "state": "FILE"},
        )


def open_growing(path: Path, known: Sequence[str]) -> GrowingTable | None:
    """The table once its header and two whole rows stand in it (a half-written one would mislead); None before.

    ``known``: column names that tell a header. Raises InputError for another format than text.
    """
    if not path.exists() or path.stat().st_size == 0:
        return None
    table = open_table(path, known)
    if not isinstance(table, CsvTable) or table.dialect.body is not None:
        raise InputError(
            "does not grow line by line", where=shown(path), expected="a CSV log to follow (UTF-8)"
        )
    with open(path, "rb") as stream:
        head = [stream.readline() for _ in range(table.dialect.skip)]
        below = [stream.readline(), stream.readline()]
        file = _identity(stream)
    if not all(line.endswith(b"\n") for line in below):
        return None
    header = b"".join(head)
    return GrowingTable(path, table, len(header), header=header, file=file)


def _identity(stream: BinaryIO) -> tuple[int, int]:
    """Device and inode of an open file."""
    status = os.fstat(stream.fileno())
    return status.st_dev, status.st_ino


def _read_to(stream: BinaryIO, offset: int) -> tuple[bool, Any, bytes]:
    """Whether the file has ``offset`` bytes, SHA-256 of them, and the last of them."""
    found = hashlib.sha256()
    tail = b""
    left = offset
    stream.seek(0)
    while left > 0:
        part = stream.read(min(left, 1 << 20))
        if not part:
            break
        found.update(part)
        tail = (tail + part)[-TAIL_BYTES:]
        left -= len(part)
    return left <= 0, found, tail


def _number(text: str, decimal: str) -> float:
    try:
        return float(text if decimal == "." else text.replace(",", "."))
    except ValueError:
        low = text.lower()
        return FLAGS.get(low, np.nan) if low not in ABSENT else np.nan
