"""A text table that is still growing: its new complete lines as rows of numbers.

Used by the live compensation through :mod:`tcdyn.workflows.log_source`. Before each reading it is
checked that the bytes read before are still there: a log that is replaced or rewritten stops the
run. Guarded by ``tests/smoothing/test_follow_files.py`` and ``tests/smoothing/test_follow.py``.
"""

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
from tcdyn.io.cells import FLAGS, is_number, to_number
from tcdyn.io.csv_dialect import split
from tcdyn.io.read import CsvTable, display_path, open_table

READ_BYTES = 1 << 19  # read at once: half a megabyte, a few thousand rows
HASH_BYTES = 1 << 20  # hashed at once
TAIL_BYTES = 256  # last bytes read, compared again at each reading: a few rows


@dataclass
class GrowingTable:
    """A growing table and how far it has been read, in complete lines.

    Attributes
    ----------
    path, table
        The file, and the table with its header.
    first_byte
        Position of the first row.
    offset
        Number of bytes read.
    rows, bad_lines
        Number of rows read, and of lines with another number of fields.
    hash
        SHA-256 of the bytes read.
    header
        The bytes above the first row.
    tail
        The last bytes read.
    file
        Device and inode of the file.
    """

    path: Path
    table: CsvTable
    first_byte: int
    offset: int = 0
    rows: int = 0
    bad_lines: int = 0
    hash: Any = field(default_factory=hashlib.sha256)
    header: bytes = b""
    tail: bytes = b""
    file: tuple[int, int] = (0, 0)

    def seek(self, offset: int) -> None:
        """Continue at ``offset`` bytes, hashing those before.

        Raises
        ------
        InputError
            If the file is shorter.
        """
        with open(self.path, "rb") as stream:
            self.file = _identity(stream)
            is_long_enough, self.hash, self.tail = _read_to(stream, offset)
        if not is_long_enough:
            raise InputError(
                "the log is shorter than the state file remembers", where=display_path(self.path)
            )
        self.offset = offset

    def first_numbers(self, column: int, most: int = 100) -> Array:
        """Numbers of one column in the first rows, NaN where there is none.

        Parameters
        ----------
        column
            Index of the column.
        most
            Largest number of lines that are read.
        """
        dialect = self.table.dialect
        with open(self.path, "rb") as stream:
            stream.seek(self.first_byte)
            lines = [line for line in islice(stream, most) if line.endswith(b"\n")]
        rows = [split(line.decode("latin-1"), dialect.separator) for line in lines]
        complete = [row for row in rows if len(row) == len(dialect.names)]
        return np.array([_number(row[column], dialect.decimal) for row in complete])

    def new_rows(self, columns: Sequence[int]) -> list[list[float]] | None:
        """Read the new lines.

        Parameters
        ----------
        columns
            Indices of the columns.

        Returns
        -------
        list of rows or None
            Numbers of these columns, NaN where there is none; None if there is no complete line.
            Lines with another number of fields are counted in ``bad_lines``.

        Raises
        ------
        InputError
            If the file became shorter, was replaced by another one, or was rewritten.
        """
        new = self._new_bytes()
        complete = new[: new.rfind(b"\n") + 1]
        if not complete:
            return None
        self.offset += len(complete)
        self.hash.update(complete)
        self.tail = (self.tail + complete)[-TAIL_BYTES:]
        dialect = self.table.dialect
        lines = [line.removesuffix(b"\r").decode("latin-1") for line in complete.split(b"\n")]
        rows = [split(line, dialect.separator) for line in lines if line.strip()]
        good = [row for row in rows if len(row) == len(dialect.names)]
        self.rows += len(good)
        self.bad_lines += len(rows) - len(good)
        return [[_number(row[k], dialect.decimal) for k in columns] for row in good]

    def _new_bytes(self) -> bytes:
        """Bytes after ``offset``, after a check that the bytes before it are those that were read.

        The check reads the size, the header and the last bytes. If the path leads to another file,
        all of it is compared: a copy that replaced the log, as programs that synchronise folders
        make it, is accepted.

        Raises
        ------
        InputError
            If the log was replaced, rotated, rewritten or deleted.
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
                    _, content_hash, _ = _read_to(stream, self.offset)
                    if content_hash.digest() != self.hash.digest():
                        raise self._not_the_log("another file with other rows is in its place")
                    self.file = file
                stream.seek(0)
                if stream.read(len(self.header)) != self.header:
                    raise self._not_the_log("its header was changed")
                stream.seek(self.offset - len(self.tail))
                if stream.read(len(self.tail)) != self.tail:
                    raise self._not_the_log("rows that were read already were changed")
                return stream.read(READ_BYTES)
        except FileNotFoundError:
            raise self._not_the_log("there is no such file any more") from None

    def _not_the_log(self, reason: str) -> InputError:
        """Error for a log that is not the one that was read, with the reason."""
        return InputError(
            f"the log was replaced, rotated or rewritten while it was followed: {reason}",
            where=display_path(self.path),
            remedy="follow the new log with another {out} (and another {state})",
            parameters={"out": "FILE", "state": "FILE"},
        )


def open_growing(path: Path, known: Sequence[str]) -> GrowingTable | None:
    """Open a log that may still be empty.

    Parameters
    ----------
    path
        The log.
    known
        Column names that the header may contain.

    Returns
    -------
    GrowingTable or None
        None until the file has its header and two complete rows; an incomplete row could be
        misread.

    Raises
    ------
    InputError
        If the format is not text.
    """
    if not path.exists() or path.stat().st_size == 0:
        return None
    table = open_table(path, known)
    if not isinstance(table, CsvTable) or table.dialect.body is not None:
        raise InputError(
            "does not grow line by line",
            where=display_path(path),
            expected="a CSV log to follow (UTF-8)",
        )
    with open(path, "rb") as stream:
        head = [stream.readline() for _ in range(table.dialect.skip)]
        first_rows = [stream.readline(), stream.readline()]
        file = _identity(stream)
    if not all(line.endswith(b"\n") for line in first_rows):
        return None
    header = b"".join(head)
    return GrowingTable(path, table, len(header), header=header, file=file)


def _identity(stream: BinaryIO) -> tuple[int, int]:
    """Device and inode of an open file."""
    status = os.fstat(stream.fileno())
    return status.st_dev, status.st_ino


def _read_to(stream: BinaryIO, offset: int) -> tuple[bool, Any, bytes]:
    """Read the first bytes of a file.

    Parameters
    ----------
    stream
        The open file.
    offset
        Number of bytes.

    Returns
    -------
    is_long_enough
        Whether the file has so many bytes.
    content_hash
        Their SHA-256, to be continued.
    tail
        The last ``TAIL_BYTES`` of them.
    """
    content_hash = hashlib.sha256()
    tail = b""
    remaining = offset
    stream.seek(0)
    while remaining > 0:
        block = stream.read(min(remaining, HASH_BYTES))
        if not block:
            break
        content_hash.update(block)
        tail = (tail + block)[-TAIL_BYTES:]
        remaining -= len(block)
    return remaining <= 0, content_hash, tail


def _number(text: str, decimal: str) -> float:
    """Number in a cell, a switch word as 0 or 1; NaN for anything else."""
    if is_number(text, decimal):
        return to_number(text, decimal)
    try:
        return float(text)  # nan and infinity
    except ValueError:
        return FLAGS.get(text.lower(), np.nan)
