"""Rows of a text log: their number and fields, what is damaged, and where the table ends.

Used by :mod:`tcdyn.io.read` before it reads the values. Guarded by ``tests/io``:
``test_damaged_files.py``, ``test_fault_classes.py`` and ``test_logger_families.py``.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import IO

import numpy as np

from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, SampleLocation, info, warning
from tcdyn.io.cells import kind_of_cell
from tcdyn.io.csv_dialect import COMMENT, Dialect, has_open_quote, split
from tcdyn.io.stamps import is_date

COUNT_BYTES = 1 << 17  # text whose rows are counted at once
LONGEST_ROW_LINES = 20  # lines of a row with line breaks inside quotes; chosen by judgement


@dataclass(frozen=True)
class CheckedRows:
    """Rows of data of a text log.

    Attributes
    ----------
    rows
        Number of rows.
    location
        Their location in the file.
    findings
        Findings about them.
    end
        Bytes from the beginning of the text to the end of the last row; None for all of it.
    has_line_breaks
        Whether there are line breaks inside quotes.
    comment_lines
        Numbers of the comments between the rows.
    """

    rows: int
    location: SampleLocation
    findings: tuple[Finding, ...] = ()
    end: int | None = None
    has_line_breaks: bool = False
    comment_lines: tuple[int, ...] = ()


def check_rows(stream: IO[bytes], dialect: Dialect) -> CheckedRows:
    """Count the rows of data and the fields of every row.

    Parameters
    ----------
    stream
        The text from its first byte.
    dialect
        Its dialect.

    Returns
    -------
    CheckedRows
        Rows, their location and end, and findings: a last row without a line end, which may have
        lost digits, gives a warning; a section of text below the rows an info.

    Raises
    ------
    InputError
        For a row with too few or too many fields; a last short one means a truncated file. For zero
        bytes.

    Notes
    -----
    Blocks in which every row is complete are counted at once (``_complete_rows``); the rest row by
    row by ``_RowCheck``.
    """
    check = _RowCheck(dialect)
    separator = dialect.separator.encode()
    fields = len(dialect.names)
    for _ in range(dialect.skip):
        line = stream.readline()
        check.last_line = line or check.last_line
        check.position += len(line)
    check.end = check.position
    while block := stream.read(COUNT_BYTES) + stream.readline():
        last_line = block.rstrip(b"\r\n").rpartition(b"\n")[2]
        complete_rows = 0
        if check.is_regular and not _is_blank(last_line, separator):
            complete_rows = _complete_rows(block, separator, fields)
        if complete_rows:
            check.add_complete_rows(complete_rows, block)
        else:
            for line in io.BytesIO(block):
                check.add_line(line)
    return check.result()


class _RowCheck:
    """Counts the rows of a text log, and finds what is wrong with them.

    Attributes
    ----------
    rows, blank_rows
        Rows of data, and rows of separators only below the last of them.
    position, end
        Bytes that were read, and bytes up to the end of the last row.
    last_line
        The last line that was read, or its last byte.
    section
        Row, number of fields and first cell of a section of text below the rows.
    pending
        Lines of a row whose quoted cell goes on.
    """

    def __init__(self, dialect: Dialect) -> None:
        """Start below the header."""
        self.dialect = dialect
        self.fields = len(dialect.names)
        self.rows = 0
        self.line = dialect.skip
        self.position = 0
        self.end = 0
        self.last_line = b"\n"
        self.lines_without_row: list[int] = []
        self.comment_lines: list[int] = []
        self.short_row: tuple[int, int] | None = None
        self.section: tuple[int, int, str] | None = None
        self.blank_rows = 0
        self.pending: list[bytes] = []
        self.has_line_breaks = False
        first_kinds = [kind_of_cell(cell, dialect.decimal) for cell in dialect.first_row]
        self.begins_with_word = first_kinds[0] == "word" and not is_date(dialect.first_row[0])

    @property
    def is_regular(self) -> bool:
        """Whether all rows so far are complete and end with their line."""
        return self.short_row is None and self.section is None and not self.pending

    def add_complete_rows(self, count: int, block: bytes) -> None:
        """Add a block of lines that are complete rows."""
        self.rows += count + self.blank_rows
        self.blank_rows = 0
        self.line += count
        self.position += len(block)
        self.end = self.position
        self.last_line = block[-1:]

    def add_line(self, line: bytes) -> None:
        """Count a line as row, comment, blank line or part of a section below the rows.

        Parameters
        ----------
        line
            Bytes of the line with its line end. A line that ends within quotes waits for the next
            ones, at most ``LONGEST_ROW_LINES``.

        Raises
        ------
        InputError
            For zero bytes, and for a row after a row of another length or after a section.
        """
        self.line += 1
        self.position += len(line)
        self.last_line = line
        separator = self.dialect.separator.encode()
        if b"\x00" in line:
            raise InputError(
                f"row {self.line} holds zero bytes: the file is damaged", where=self.dialect.where
            )
        if self.pending:
            line = b"".join([*self.pending, line])
        count = self._count(line)
        is_open = has_open_quote(line.decode("latin-1").rstrip("\r\n"), self.dialect.separator)
        if is_open and len(self.pending) < LONGEST_ROW_LINES:
            self.pending.append(self.last_line)
            self.has_line_breaks = True
            return
        if self.pending:
            self.lines_without_row += range(self.line - len(self.pending) + 1, self.line + 1)
        first_line = self.line - len(self.pending)
        self.pending = []
        is_complete = count == self.fields
        if _is_blank(line, separator):
            if is_complete and self.section is None:
                self.blank_rows += 1
            else:
                self.lines_without_row.append(self.line)
            return
        if line.startswith(COMMENT.encode()) and not is_complete:
            self.lines_without_row.append(self.line)
            self.comment_lines.append(self.line)
            self.position += len(b"\n") - len(line)  # see _without_lines
            return
        if self.short_row is not None:
            raise self._row_error(self.short_row)
        if is_complete and self.section is None:
            self.rows += 1 + self.blank_rows
            self.blank_rows = 0
            self.end = self.position
        elif self.section is None:
            self._add_irregular(line, first_line, count)
        elif is_complete and self._is_row(line):
            raise self._row_error(self.section[:2])

    def _count(self, line: bytes) -> int:
        """Number of fields of a line; separators inside quotes do not count."""
        if b'"' in line:
            return len(split(line.decode("latin-1").rstrip("\r\n"), self.dialect.separator))
        return line.count(self.dialect.separator.encode()) + 1

    def _cells(self, line: bytes) -> list[str]:
        """Decode a line and split it at the separator; bytes that are no text are replaced."""
        encoding = "cp1252" if self.dialect.encoding == "cp1252" else "utf-8"
        return split(line.decode(encoding, errors="replace").strip("\r\n"), self.dialect.separator)

    def _is_row(self, line: bytes) -> bool:
        """Whether a line begins as a row of data does."""
        kind = kind_of_cell(self._cells(line)[0], self.dialect.decimal)
        return kind in ("number", "stamp") or self.begins_with_word

    def _add_irregular(self, line: bytes, number: int, count: int) -> None:
        """Add a row with a wrong number of fields, or begin a section of text below the rows."""
        if not self._is_row(line) and self.rows:
            self.section = (number, count, self._cells(line)[0][:40])
        elif count < self.fields:
            self.short_row = (number, count)
        else:
            raise self._row_error((number, count))

    def result(self) -> CheckedRows:
        """The rows; InputError for a truncated last one."""
        if self.pending:
            raise self._row_error((self.line, len(self.pending)))
        if self.short_row is not None:
            number, count = self.short_row
            raise InputError(
                f"row {number}, the last, has {count} of {self.fields} fields: the file is "
                "truncated",
                where=self.dialect.where,
                expected="a complete last row",
                remedy="copy the file again, or delete the last row",
            )
        findings = []
        if self.section is None and not self.last_line.endswith((b"\n", b"\r")):
            last_row = self.dialect.skip + self.rows + len(self.lines_without_row)
            findings.append(warning("text.no_line_end", row=last_row))
        if self.section is not None:
            row, _, text = self.section
            findings.append(info("text.section_below", row=row, text=text))
        location = SampleLocation(
            self.dialect.where, self.dialect.skip + 1, tuple(self.lines_without_row)
        )
        ends_early = self.section is not None or self.blank_rows > 0
        end = self.end if ends_early else None
        return CheckedRows(
            self.rows,
            location,
            tuple(findings),
            end,
            self.has_line_breaks,
            tuple(self.comment_lines),
        )

    def _row_error(self, row: tuple[int, int]) -> InputError:
        """Error for a row, by its number in the file and its number of fields."""
        return InputError(
            f"row {row[0]} has {row[1]} fields",
            where=self.dialect.where,
            expected=f"{self.fields} as in the first row",
            remedy="repair or delete that row",
        )


def _is_blank(line: bytes, separator: bytes) -> bool:
    """Whether a line has no text besides separators."""
    return not line.replace(separator, b"").strip()


def _complete_rows(block: bytes, separator: bytes, fields: int) -> int:
    """Number of rows of a block in which every row has all fields, as nearly always; else 0.

    Parameters
    ----------
    block
        Some complete lines of text.
    separator
        Separator of the columns, one byte.
    fields
        Number of fields of a row.
    """
    is_regular = len(block) < 2 * COUNT_BYTES and block.endswith(b"\n") and b"\x00" not in block
    if not is_regular:
        return 0
    characters = np.frombuffer(block, np.uint8)
    line_ends = np.flatnonzero(characters == ord("\n"))
    separators = np.flatnonzero(characters == ord(separator))
    separators_before = np.searchsorted(separators, line_ends)
    expected = np.arange(1, len(line_ends) + 1) * (fields - 1)
    return len(line_ends) if np.array_equal(separators_before, expected) else 0
