"""A text table that still grows: its new complete lines, as chunks of the same reader as a file.

Used by ``tcdyn.workflows.follow``. The numbers are those that ``tcdyn.io.read.text_chunks`` reads
from the finished file, bit by bit. Which columns hold text is decided when the log is opened, by
the rows that it has then. Guarded by ``tests/smoothing/test_follow.py`` and
``tests/smoothing/test_follow_files.py``.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from tcdyn.core.errors import InputError
from tcdyn.core.findings import SampleLocation
from tcdyn.io.csv_dialect import COMMENT, Dialect
from tcdyn.io.read import (
    MAT_ENDING,
    MAT_FIRST_BYTES,
    PARQUET_ENDINGS,
    ZIP_FIRST_BYTES,
    CsvTable,
    TextReader,
    display_path,
)
from tcdyn.io.rows import CheckedRows
from tcdyn.io.table import CHUNK_ROWS, Columns, Table

# Read at once: some hundred rows, so that a request to stop does not wait long. By judgement.
READ_BYTES = 1 << 16
HASH_BYTES = 1 << 20  # hashed at once
TAIL_BYTES = 256  # last bytes read, compared again at each reading: a few rows
# Rows of the first chunk, at least, unless the table ends before: the unit of time is judged by it.
FIRST_ROWS = 64
# Endings and first bytes of tables that are written at once.
COMPLETE_ENDINGS = (".xlsx", ".xlsm", MAT_ENDING, ".tdms", *PARQUET_ENDINGS)
COMPLETE_FIRST_BYTES = (ZIP_FIRST_BYTES, MAT_FIRST_BYTES, b"TDSm", b"PAR1")
# Additional column of the chunks: position in the file after each row [bytes].
ROW_END = "\x00row end"


@dataclass
class GrowingText:
    """A growing text table and how far it has been read, in complete lines.

    Attributes
    ----------
    path, dialect
        The file and its dialect.
    opened_bytes
        Size of the file when it was opened first [bytes]. The rows up to there decide which columns
        hold text.
    offset
        Number of bytes read.
    rows, bad_lines
        Number of rows read, and of lines with another number of fields.
    hash
        SHA-256 of the bytes read.
    header, first_row
        The bytes above the first row, and those of the first row.
    tail
        The last bytes read.
    file
        Device and inode of the file.
    go_on
        Called after each look for new lines with whether there were any; returns whether to look
        again.
    problem
        Why the file cannot be read on, if it cannot.
    """

    path: Path
    dialect: Dialect
    opened_bytes: int
    offset: int = 0
    rows: int = 0
    bad_lines: int = 0
    hash: Any = field(default_factory=hashlib.sha256)
    header: bytes = b""
    first_row: bytes = b""
    tail: bytes = b""
    file: tuple[int, int] = (0, 0)
    go_on: Callable[[bool], bool] = lambda _: False
    problem: InputError | None = None

    def seek(self, offset: int) -> None:
        """Continue at ``offset`` bytes, hashing those before; InputError if the file is shorter."""
        with open(self.path, "rb") as stream:
            self.file = _device_and_inode(stream)
            is_long_enough, self.hash, self.tail = _read_to(stream, offset)
        if not is_long_enough:
            raise InputError(
                "the log is shorter than the state file remembers", where=display_path(self.path)
            )
        self.offset = offset

    def waiting_rows(self) -> int:
        """Number of rows in the file that were not read yet, about."""
        read_bytes = self.offset - len(self.header)
        if not self.rows or read_bytes <= 0:
            return 0
        try:
            size = self.path.stat().st_size
        except OSError:  # it is being replaced: the next look at its rows tells
            return 0
        more_bytes = max(size - self.offset, 0)
        return int(more_bytes * self.rows / read_bytes)

    def chunks(self, requested: Sequence[str], rows: int = CHUNK_ROWS) -> Iterator[Columns]:
        """Yield the columns of new lines as they come, until ``go_on`` returns False.

        Lines with another number of fields are left out and counted. If the file became shorter,
        was replaced by another one, or was rewritten, the iteration ends with ``problem`` set.

        Parameters
        ----------
        requested
            Names of the columns; ``ROW_END`` among them gives the positions of the row ends.
        rows
            Not used: a chunk has the rows that are there.
        """
        location = SampleLocation(self.dialect.where, self.dialect.skip + 1)
        first_rows = CheckedRows(0, location, end=self.opened_bytes)
        reader = TextReader(self.dialect, [n for n in requested if n != ROW_END], first_rows)
        if self.offset > len(self.header):  # clock stamps count from the first row of the log
            reader.parse(self.first_row)
        lines: list[bytes] = []
        ends: list[int] = []
        least = FIRST_ROWS
        goes_on = True
        while goes_on:
            new_lines, new_ends = self._new_rows()
            lines += new_lines
            ends += new_ends
            goes_on = self.problem is None and self.go_on(len(new_lines) > 0)
            if lines and (len(lines) >= least or not goes_on):
                columns = reader.parse(b"".join(lines))
                data = columns.data
                if ROW_END in requested:
                    data = {**data, ROW_END: np.array(ends, dtype=float)}
                yield replace(columns, data=data)
                lines = []
                ends = []
                least = 1
        findings = tuple(reader.findings(is_complete=False))
        yield Columns({name: np.empty(0) for name in requested}, location, findings)

    def _new_rows(self) -> tuple[list[bytes], list[int]]:
        """New complete lines with all their fields, and the positions of their ends."""
        try:
            new = self._new_bytes()
        except InputError as problem:
            self.problem = problem
            return [], []
        complete = new[: new.rfind(b"\n") + 1]
        separator = self.dialect.separator.encode()
        separators = len(self.dialect.names) - 1
        lines: list[bytes] = []
        ends: list[int] = []
        end = self.offset
        for line in _lines(complete):
            end += len(line)
            count = line.count(separator)
            is_row = count == separators or (count > separators and b'"' in line)
            if is_row and b"\x00" not in line:
                lines.append(line)
                ends.append(end)
            elif line.strip() and not line.startswith(COMMENT.encode()):
                self.bad_lines += 1
        self.offset += len(complete)
        self.hash.update(complete)
        self.tail = (self.tail + complete)[-TAIL_BYTES:]
        self.rows += len(lines)
        return lines, ends

    def _new_bytes(self) -> bytes:
        """Bytes after ``offset``, after a check that the bytes before it are those that were read.

        The check reads the size, the header and the last bytes. If the path leads to another file,
        all of it is compared: a copy that replaced the log, as programs that synchronise folders
        make it, is accepted.
        """
        try:
            with open(self.path, "rb") as stream:
                file = _device_and_inode(stream)
                size = os.fstat(stream.fileno()).st_size
                if size < self.offset:
                    raise self._replaced_log_error(
                        f"it became shorter ({size} bytes, {self.offset} were read)"
                    )
                if file != self.file:
                    _, content_hash, _ = _read_to(stream, self.offset)
                    if content_hash.digest() != self.hash.digest():
                        raise self._replaced_log_error(
                            "another file with other rows is in its place"
                        )
                    self.file = file
                stream.seek(0)
                if stream.read(len(self.header)) != self.header:
                    raise self._replaced_log_error("its header was changed")
                stream.seek(self.offset - len(self.tail))
                if stream.read(len(self.tail)) != self.tail:
                    raise self._replaced_log_error("rows that were read already were changed")
                return stream.read(READ_BYTES)
        except FileNotFoundError:
            raise self._replaced_log_error("there is no such file any more") from None

    def _replaced_log_error(self, reason: str) -> InputError:
        """Return the error for a log that was replaced or rewritten, with the reason."""
        return InputError(
            f"the log was replaced, rotated or rewritten while it was followed: {reason}",
            where=display_path(self.path),
            remedy="follow the new log with another {out} (and another {state})",
            parameters={"out": "FILE", "state": "FILE"},
        )


def check_can_grow(path: Path) -> None:
    """Raise InputError for a file of a format that is written at once, by its ending or content.

    Parameters
    ----------
    path
        The file; it need not exist yet.

    Examples
    --------
    >>> check_can_grow(Path("log.csv"))
    >>> check_can_grow(Path("log.xlsx"))
    Traceback (most recent call last):
    ...
    tcdyn.core.errors.InputError: log.xlsx: a file of this format cannot grow line by line; \
expected a CSV log to follow (UTF-8)
    """
    is_complete = path.suffix.lower() in COMPLETE_ENDINGS
    if not is_complete and path.is_file():
        with open(path, "rb") as stream:
            is_complete = stream.read(TAIL_BYTES).startswith(COMPLETE_FIRST_BYTES)
    if is_complete:
        raise InputError(
            "a file of this format cannot grow line by line",
            where=display_path(path),
            expected="a CSV log to follow (UTF-8)",
        )


def open_growing(table: Table, path: Path) -> tuple[GrowingText, Table] | None:
    """A table that still grows, and its reader.

    Parameters
    ----------
    table
        The table, opened as a file.
    path
        The file.

    Returns
    -------
    tuple or None
        The reader, and the table whose chunks it reads. None until the file has two complete rows
        below its header; an incomplete row could be misread.

    Raises
    ------
    InputError
        If the format is not text.
    """
    if not isinstance(table, CsvTable) or table.dialect.body is not None:
        raise InputError(
            "does not grow line by line",
            where=display_path(path),
            expected="a CSV log to follow (UTF-8)",
        )
    with open(path, "rb") as stream:
        head = [stream.readline() for _ in range(table.dialect.skip)]
        first_rows = [stream.readline(), stream.readline()]
        file = _device_and_inode(stream)
        size = os.fstat(stream.fileno()).st_size
    if not all(line.endswith(b"\n") for line in first_rows):
        return None
    header = b"".join(head)
    growing = GrowingText(
        path, table.dialect, size, header=header, first_row=first_rows[0], file=file
    )
    growing.seek(len(header))
    return growing, replace(table, chunks=growing.chunks)


def _lines(text: bytes) -> list[bytes]:
    """Lines of ``text``, which end at line feeds only."""
    return [line + b"\n" for line in text.split(b"\n")[:-1]]


def _device_and_inode(stream: BinaryIO) -> tuple[int, int]:
    """Device and inode of an open file."""
    status = os.fstat(stream.fileno())
    return status.st_dev, status.st_ino


def _read_to(stream: BinaryIO, offset: int) -> tuple[bool, Any, bytes]:
    """Whether the file has ``offset`` bytes; their SHA-256; the last of them."""
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
