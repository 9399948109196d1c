"""Every row of a text table must have as many fields as the first: counted before anything is parsed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import IO

from calibration.errors import InputError
from calibration.files.dialect import Dialect


@dataclass(frozen=True)
class RowCheck:
    """How many rows of data there are, which lines are blank, what was noticed."""

    rows: int
    blank: tuple[int, ...]
    notes: tuple[str, ...]


def check_rows(stream: IO[bytes], dialect: Dialect, where: str) -> RowCheck:
    """Count the fields of every row: a short or long row is refused by its number, a last short one as truncated.

    A last row without line end may have lost digits: that is noted.
    """
    separator = dialect.separator.encode()
    want = dialect.fields - 1
    blank: list[int] = []
    rows, line = 0, b"\n"
    short: tuple[int, int] | None = None
    for number, line in enumerate(stream, 1):
        if number <= dialect.skip:
            continue
        if short is not None and line.strip():
            raise _row_error(short, dialect.fields, where)
        count = line.count(separator)
        if count == want:
            rows += 1
        elif not line.strip():
            blank.append(number)
        elif count < want:
            short = (number, count + 1)
        elif b'"' not in line:
            raise _row_error((number, count + 1), dialect.fields, where)
        if b"\x00" in line:
            raise InputError(f"row {number} holds zero bytes: the file is damaged", where=where)
    if short is not None:
        raise InputError(
            f"row {short[0]}, the last, has {short[1]} of {dialect.fields} fields: the file is truncated",
            where=where,
            expected="a whole last row",
            remedy="copy the file again, or delete the last row",
        )
    note = ""
    if not line.endswith((b"\n", b"\r")):
        note = f"row {dialect.skip + rows + len(blank)}, the last, has no line end: its last value may be cut short"
    return RowCheck(rows, tuple(blank), (note,) if note else ())


def _row_error(row: tuple[int, int], fields: int, where: str) -> InputError:
    return InputError(
        f"row {row[0]} has {row[1]} fields",
        where=where,
        expected=f"{fields} as in the first row",
        remedy="repair or delete that row",
    )
