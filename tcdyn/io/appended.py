"""Output file of a followed log: rows are appended while others may read, rename or delete it.

Used by :mod:`tcdyn.workflows.follow`. Guarded by ``tests/smoothing/test_follow_files.py``.
"""

from __future__ import annotations

import hashlib
import io
import os
from pathlib import Path
from types import TracebackType
from typing import Any

from tcdyn.core.errors import InputError


class AppendedFile:
    """The output of a followed log, open for appending; it is checked before and after each write.

    Attributes
    ----------
    path
        The file.
    size
        Its size [bytes].
    rows
        Number of rows that were written to it.
    hash
        SHA-256 of its content, to be continued.
    stream
        The open file.
    """

    def __init__(self, path: Path, size: int, rows: int) -> None:
        """Open a file and cut it back to what is known to be complete.

        Parameters
        ----------
        path
            The file.
        size
            Number of bytes that are complete; the rest is cut off.
        rows
            Number of rows in them.

        Raises
        ------
        InputError
            If it cannot be read or written.
        """
        self.path = path
        self.size = size
        self.rows = rows
        self.hash = digest(path, size)
        try:
            self.stream = io.FileIO(path, "r+")
            self.stream.truncate(size)
            self.stream.seek(size)
        except OSError as problem:
            raise InputError(f"cannot be written ({problem.strerror})", where=str(path)) from None

    def __enter__(self) -> AppendedFile:
        """The file itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the file."""
        self.stream.close()

    def append(self, data: bytes, rows: int) -> None:
        """Write some rows completely or not at all.

        Parameters
        ----------
        data
            Lines of the file.
        rows
            Number of rows in them.

        Raises
        ------
        InputError
            Where it cannot be written, and where the file is no longer what was written.
        """
        self.check(rows)
        try:
            remaining = memoryview(data)
            while remaining:
                remaining = remaining[self.stream.write(remaining) :]
        except OSError as problem:
            self.stream.truncate(self.size)
            raise InputError(
                f"cannot be written ({problem.strerror})", where=str(self.path)
            ) from None
        self.size += len(data)
        self.hash.update(data)
        self.rows += rows
        self.check(0)

    def check(self, next_rows: int) -> None:
        """Check that the file at the path is the one that is open, and has the size that it should.

        Parameters
        ----------
        next_rows
            Number of rows that are to be written next, for the message.

        Raises
        ------
        InputError
            If it was renamed, deleted, replaced or changed.
        """
        before = f"rows 1 to {self.rows}" if self.rows else "no rows"
        after = ""
        if next_rows:
            after = f", and rows {self.rows + 1} to {self.rows + next_rows} were not written"
        there = f"{before} are in the file that was there{after}"
        try:
            file = os.stat(self.path)
        except OSError:
            raise self._changed_output_error(
                f"renamed or deleted while it was written: {there}"
            ) from None
        if not os.path.samestat(os.fstat(self.stream.fileno()), file):
            raise self._changed_output_error(
                f"replaced by another file while it was written: {there}"
            )
        if file.st_size != self.size:
            changed = f"changed by another program: it has {file.st_size} bytes after {before}"
            raise self._changed_output_error(f"{changed}{after}", expected=f"{self.size} bytes")

    def _changed_output_error(self, what: str, expected: str = "") -> InputError:
        """The error for an output that is no longer what was written."""
        return InputError(
            f"the output was {what}",
            where=str(self.path),
            expected=expected,
            remedy="follow the log with another {out}",
            parameters={"out": "FILE"},
        )


def digest(path: Path, size: int) -> Any:
    """SHA-256 of the first bytes of a file, to be continued.

    Parameters
    ----------
    path
        The file.
    size
        Number of bytes; fewer if the file is shorter.

    Raises
    ------
    InputError
        If it cannot be read.
    """
    hasher = hashlib.sha256()
    remaining = size
    try:
        with open(path, "rb") as stream:
            while remaining > 0:
                chunk = stream.read(min(remaining, 1 << 20))
                if not chunk:
                    break
                hasher.update(chunk)
                remaining -= len(chunk)
    except OSError as problem:
        raise InputError(f"cannot be read ({problem.strerror})", where=str(path)) from None
    return hasher
