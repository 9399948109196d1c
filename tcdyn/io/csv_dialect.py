"""Dialect of a text log (encoding, separator, decimal mark, header); meaning of its cells.

Used by :mod:`tcdyn.io.read`, :mod:`tcdyn.io.growing`, :mod:`tcdyn.io.lvm` and
:mod:`tcdyn.io.binary`. Each combination of separator and decimal mark is tried on the first rows,
and the one that reads most rows is taken. The shares below were chosen by judgement; the damaged
and the sound files of ``tests/io/test_damaged_files.py`` and the dialects of
``tests/io/test_file_formats.py`` decide whether they hold.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, SampleLocation, info, warning
from tcdyn.io.times import SECONDS_PER_UNIT, Stamps

NUMBER = {  # by decimal mark
    ".": re.compile(r"\s*[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?\s*"),
    ",": re.compile(r"\s*[-+]?(\d+,?\d*|,\d+)([eE][-+]?\d+)?\s*"),
}
# a clock time, with or without a date; ``tcdyn.io.times._STAMP`` reads its fields
CLOCK_PATTERN = re.compile(
    r"\s*(\d{4}-\d\d-\d\d[T ]|\d{1,2}[./]\d{1,2}[./]\d{2,4} )?"
    r"\d{1,2}:\d\d:\d\d([.,]\d+)?\s*(AM|PM|Z)?\s*"
)
# lower-case cells without a value
NOT_A_NUMBER = ("nan", "+nan", "-nan", "1.#qnan", "-1.#ind")
INFINITE = ("inf", "-inf", "+inf")
ABSENT = frozenset(("", "null", "na", "n/a", "#n/a", "none", *NOT_A_NUMBER, *INFINITE))
LINE_END = re.compile(r"\r\n|\n|\r")  # str.splitlines would also split at form feeds and the like
HEAD_BYTES = 1 << 17  # read to detect the dialect: header and some rows must fit
DATA_ROWS = 150  # rows of data that suffice to detect the dialect; chosen by judgement
# a row is data if at least this share of its filled cells can be read; chosen by judgement
DATA_SHARE = 0.6
# a row below the header with more than this share of numbers is data, damaged or not; chosen by
# judgement
NUMERIC_SHARE = 0.25
# a text column may have this share of cells that are no numbers, or this number of them if it is
# short; more are an error. Chosen by judgement
BAD_SHARE = 0.01
BAD_CELLS = 3
FLAGS = {  # lower-case words for a switch
    "true": 1.0,
    "on": 1.0,
    "yes": 1.0,
    "high": 1.0,
    "false": 0.0,
    "off": 0.0,
    "no": 0.0,
    "low": 0.0,
}
# units as the cells of a row of units may write them, in lower case and without degree signs
TEMPERATURE_UNITS = frozenset(
    ("c", "celsius", "k", "kelvin", "f", "fahrenheit", "mv", "millivolt", "millivolts")
)


@dataclass(frozen=True)
class Dialect:
    """How to read a text log.

    Attributes
    ----------
    where
        The file, for messages.
    encoding, separator, decimal
        Encoding of the text, separator of the columns, decimal mark.
    names
        A name for each column.
    skip
        Number of lines above the first row of data.
    first_row
        Cells of the first row of data.
    metadata
        Values of the lines "# key: value" above the header.
    path
        The file.
    body
        The text as UTF-8, where it had to be rewritten (UTF-16, columns separated by spaces).
    units
        Units by column, from a row below the header.
    """

    where: str
    encoding: str
    separator: str
    decimal: str
    names: tuple[str, ...]
    skip: int
    first_row: tuple[str, ...]
    metadata: dict[str, str] = field(default_factory=dict)
    path: Path = Path()
    body: bytes | None = None
    units: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class _Layout:
    """Header and data of a text with one separator and decimal mark, and how well the text fits."""

    score: float
    separator: str
    decimal: str
    header: tuple[str, ...]
    skip: int
    first_row: tuple[str, ...]
    fields: int
    units: tuple[str, ...]


def detect_dialect(path: Path, where: str, known: Collection[str] = ()) -> Dialect:
    """Detect the dialect of a text log from its first bytes.

    Parameters
    ----------
    path
        The file.
    where
        The file, for messages.
    known
        Names that a header may contain. Among several lines of text above the first numbers
        (titles, header blocks, units) the one with most of them is the header.

    Raises
    ------
    InputError
        If the bytes are no text, or there is no header with rows of numbers below it.

    Notes
    -----
    Encoding, then separator and decimal mark by ``_best_layout``, then names and units. UTF-16 and
    columns separated by spaces are rewritten in memory, because pyarrow reads neither; such a file
    cannot be followed while it grows (``tcdyn.io.growing.open_growing``). ``HEAD_BYTES`` must hold
    a header and some rows: a longer header is not found.
    """
    with open(path, "rb") as stream:
        head = stream.read(HEAD_BYTES)
    if not head.strip(b"\x00 \r\n\t"):
        raise InputError(
            "the file is empty", where=where, expected="a header row and rows of numbers"
        )
    encoding = _encoding(head, where)
    text = head.decode(encoding, errors="replace")
    lines = LINE_END.split(text)
    if len(head) >= HEAD_BYTES and len(lines) > 1:
        lines = lines[:-1]  # the last one may be incomplete
    layout = _best_layout(tuple(lines), frozenset(name.lower() for name in known))
    if layout is None:
        text_lines = (line for line in lines if line.strip() and not line.startswith("#"))
        raise InputError(
            f"no table found (the text begins {next(text_lines, '')[:80]!r})",
            where=where,
            expected="a header row, then rows of numbers separated by comma, semicolon, tab or "
            "spaces",
        )
    names = _column_names(layout, where)
    first_row = (*layout.first_row, *[""] * layout.fields)[: layout.fields]
    body = None
    if encoding.startswith("utf-16"):
        body = _utf16_as_utf8(path, encoding, where)
    separator = layout.separator
    if separator == " ":
        separator = "\t"
        body = _tabs_for_spaces(body or path.read_bytes())
    units = {name: unit for name, unit in zip(names, layout.units) if unit}
    return Dialect(
        where,
        encoding,
        separator,
        layout.decimal,
        names,
        layout.skip,
        first_row,
        _metadata(lines),
        path,
        body,
        units,
    )


def _column_names(layout: _Layout, where: str) -> tuple[str, ...]:
    """A name for each column, empty for a column without one.

    Parameters
    ----------
    layout
        Header and data.
    where
        The file, for messages.

    Raises
    ------
    InputError
        If there is no header, or it has another number of names than the rows have fields. One name
        less is accepted: the last column then has no name.
    """
    row = layout.skip + 1
    fields = layout.fields
    if not layout.header:
        raise InputError(
            f"row {row} is numbers and no header row stands above it",
            where=where,
            expected="a header row with the column names",
            remedy="write the names into the first row",
        )
    names = list(layout.header)
    while len(names) > fields and not names[-1]:
        names.pop()
    if len(names) > fields or fields > len(names) + 1:
        remedy = ""
        if layout.separator == ",":
            remedy = "decimal commas need semicolons or tabs between columns"
        raise InputError(
            f"the header has {len(names)} names but row {row} has {fields} fields",
            where=where,
            expected="one name for each column",
            remedy=remedy,
        )
    return (*names, *[""] * (fields - len(names)))


def _utf16_as_utf8(path: Path, encoding: str, where: str) -> bytes:
    """The text of a UTF-16 file as UTF-8; InputError if it is broken."""
    try:
        return path.read_bytes().decode(encoding).encode("utf-8")
    except UnicodeDecodeError as problem:
        raise InputError(f"broken UTF-16 text ({problem.reason})", where=where) from None


def _tabs_for_spaces(text: bytes) -> bytes:
    """The text with one tab for each run of spaces, none at the ends of lines."""
    text = re.sub(rb"(?m)^[ \t]+|[ \t]+(?=\r?$)", b"", text)
    return re.sub(rb"[ \t]+", b"\t", text)


@lru_cache(maxsize=4)
def _best_layout(lines: tuple[str, ...], known: frozenset[str]) -> _Layout | None:
    """The layout with the best score; the first of equal ones, in the order tab, semicolon, comma.

    Parameters
    ----------
    lines
        First lines of the text.
    known
        Column names in lower case that a header may contain.

    Notes
    -----
    Cached, because a log may be opened several times. A comma that separates columns is never also
    the decimal mark. Spaces separate columns only if nothing else does.
    """
    layouts: list[_Layout] = []
    for separator, decimals in (("\t", ".,"), (";", ".,"), (",", ".")):
        layouts += _layouts(lines, separator, decimals, known)
    if not layouts:  # spaces separate columns only if nothing else does
        layouts = _layouts(lines, " ", ".,", known)
    return max(layouts, key=lambda layout: layout.score, default=None)


def _layouts(
    lines: Sequence[str], separator: str, decimals: str, known: Collection[str]
) -> list[_Layout]:
    """The layouts with data for one separator and each of the decimal marks."""
    candidates = [_layout(lines, separator, decimal, known) for decimal in decimals]
    return [layout for layout in candidates if layout is not None]


def is_number(text: str, decimal: str = ".") -> bool:
    """Whether ``text`` is one number with this decimal mark."""
    return NUMBER[decimal].fullmatch(text) is not None


def _encoding(head: bytes, where: str) -> str:
    """Encoding of the text by its first bytes.

    Byte order marks decide; then zero bytes in every other place (UTF-16); then whether it is valid
    UTF-8. Everything else is read as cp1252.

    Parameters
    ----------
    head
        First bytes of the file.
    where
        The file, for messages.

    Raises
    ------
    InputError
        For a zero byte in other text.
    """
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    if head.startswith(codecs.BOM_UTF8):
        return "utf-8-sig"
    zeros = head.count(0)
    if zeros:
        if zeros > 0.3 * len(head) and head[1:200:2].count(0) > 80:
            return "utf-16-le"
        line = head[: head.index(0)].count(b"\n") + 1
        raise InputError(
            f"a zero byte in row {line}: this is not text, or the file is damaged",
            where=where,
            expected="a text table (or the ending .tdms, .lvm or .parquet)",
        )
    try:
        codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8"


def _metadata(lines: list[str]) -> dict[str, str]:
    """Values of the lines "# key: value" above the table."""
    metadata: dict[str, str] = {}
    for line in lines:
        text = line.lstrip("\ufeff").strip()
        if text.startswith("#"):
            key, colon, value = text.lstrip("#").partition(":")
            if colon and key.strip():
                metadata[key.strip()] = value.strip()
        elif text:
            break
    return metadata


def is_temperature_unit(text: str) -> bool:
    """Whether a cell is a unit of a temperature or of the voltage of a thermocouple.

    >>> is_temperature_unit("Deg. F"), is_temperature_unit("%")
    (True, False)
    """
    return re.sub(r"[\s.°º]|deg(rees?)?", "", text.lower()) in TEMPERATURE_UNITS


def split(line: str, separator: str) -> list[str]:
    """Fields of a line without quotes and spaces around them; spaces separate in any number."""
    fields = line.split() if separator == " " else line.split(separator)
    return [text.strip().strip('"').strip() for text in fields]


def _is_cell(text: str, decimal: str) -> bool:
    """Whether a cell is a number, a clock time, a word for a switch, or has no value."""
    if is_number(text, decimal):
        return True
    lower = text.lower()
    return lower in ABSENT or lower in FLAGS or CLOCK_PATTERN.fullmatch(text) is not None


def _is_data(cells: list[str], decimal: str) -> bool:
    """Whether a row is data: most filled cells can be read, and one of them is a number."""
    filled = [cell for cell in cells if cell.lower() not in ABSENT]
    readable = sum(_is_cell(cell, decimal) for cell in filled)
    if readable < max(1.0, DATA_SHARE * len(filled)):
        return False
    return any(is_number(cell, decimal) for cell in filled)


def _layout(
    lines: Sequence[str], separator: str, decimal: str, known: Collection[str]
) -> _Layout | None:
    """Where header and data are with this separator and decimal mark; None without data.

    Parameters
    ----------
    lines
        First lines of the text.
    separator, decimal
        Separator of the columns and decimal mark.
    known
        Column names in lower case that a header may contain.

    Notes
    -----
    The number of fields is the most frequent one of the rows of data, and data starts at the first
    such row. A row below the header with more numbers than ``NUMERIC_SHARE`` is data too, so that a
    damaged first row is reported and not skipped.
    """
    rows, data = _rows_and_data(lines, separator, decimal)
    if not data:
        return None
    widths = [len(rows[k][1]) for k in data]
    fields = max(set(widths), key=widths.count)
    first = next(k for k in data if len(rows[k][1]) == fields)
    header = _header(rows[:first], fields, decimal, known)
    names: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    if header is not None:
        names = tuple(rows[header][1])
        # only units may stand between the header and the data
        for k in range(header + 1, first):
            if _numeric_share(rows[k][1], decimal) > NUMERIC_SHARE:
                first = k
                break
        units = _unit_row([cells for _, cells in rows[header + 1 : first]], fields)
    line, cells = rows[first]
    score = _score([rows[k][1] for k in data], fields, decimal)
    return _Layout(score, separator, decimal, names, line, tuple(cells), fields, units)


def _rows_and_data(
    lines: Sequence[str], separator: str, decimal: str
) -> tuple[list[tuple[int, list[str]]], list[int]]:
    """Rows below the comments, and which of them are data.

    Parameters
    ----------
    lines
        First lines of the text.
    separator, decimal
        Separator of the columns and decimal mark.

    Returns
    -------
    rows
        Line number and cells of each row.
    data
        Indices in ``rows`` of the rows of data, at most ``DATA_ROWS``.
    """
    top = 0
    while top < len(lines) and (not lines[top].strip() or lines[top].startswith("#")):
        top += 1
    rows: list[tuple[int, list[str]]] = []
    data: list[int] = []
    for number, line in enumerate(lines[top:], top):
        if not line.strip():
            continue
        cells = split(line, separator)
        rows.append((number, cells))
        if len(cells) > 1 and _is_data(cells, decimal):
            data.append(len(rows) - 1)
        if len(data) == DATA_ROWS:
            break
    return rows, data


def _score(data: list[list[str]], fields: int, decimal: str) -> float:
    """Share of rows that can be read completely; columns and a decimal mark in use add a little.

    Parameters
    ----------
    data
        Cells of the rows of data.
    fields
        Number of fields of a complete row.
    decimal
        Decimal mark.

    Notes
    -----
    The weights 0.01 for a column and 0.001 for a decimal mark decide between dialects that read the
    same share of rows; they were chosen by judgement.
    """
    exact = 0
    for cells in data:
        exact += len(cells) == fields and all(_is_cell(cell, decimal) for cell in cells)
    has_decimal_mark = any(decimal in cell for cells in data[:50] for cell in cells)
    return exact / len(data) + 0.01 * fields + (0.001 if has_decimal_mark else 0.0)


def _unit_row(rows: Sequence[Sequence[str]], fields: int) -> tuple[str, ...]:
    """Cells of the row of units below the header, without brackets; empty if there is none."""
    for row in rows:
        cells = [re.sub(r"^[\[(]\s*(.*?)\s*[\])]$", r"\1", cell.strip()) for cell in row]
        if len(cells) == fields and any(_is_unit(cell) for cell in cells):
            return tuple(cell if re.search(r"[^\W\d_]|°", cell) else "" for cell in cells)
    return ()


def _is_unit(cell: str) -> bool:
    """Whether a cell is a unit of time, of temperature or of the voltage of a thermocouple."""
    return cell.rstrip(".").lower() in SECONDS_PER_UNIT or is_temperature_unit(cell)


def _header(
    rows: list[tuple[int, list[str]]], fields: int, decimal: str, known: Collection[str]
) -> int | None:
    """Index of the header in ``rows``; None if there is none.

    Of the rows of text with the number of fields of the data, or one more or less, it is the one
    with most known names, and the first of equal ones. Without such a row, a last row of text is
    taken, so that the message about its number of names is about the right row.

    Parameters
    ----------
    rows
        Line number and cells of the rows above the data.
    fields
        Number of fields of the data.
    decimal
        Decimal mark.
    known
        Column names in lower case.
    """
    texts = [
        k for k, (_, cells) in enumerate(rows) if len(cells) > 1 and not _is_data(cells, decimal)
    ]
    candidates = [k for k in texts if abs(len(rows[k][1]) - fields) <= 1]
    if candidates:
        return max(candidates, key=lambda k: sum(cell.lower() in known for cell in rows[k][1]))
    last = len(rows) - 1
    return last if last in texts else None


def _numeric_share(cells: list[str], decimal: str) -> float:
    """Share of the filled cells that are numbers."""
    filled = [cell for cell in cells if cell]
    return sum(is_number(cell, decimal) for cell in filled) / max(len(filled), 1)


class TextColumn:
    """A column of cells of text, in one chunk or in many, with the same result.

    Parameters
    ----------
    name, decimal
        Name of the column and decimal mark.
    location
        Location of the samples, for messages.
    clock
        Whether the column holds clock times; None: decided by the first chunk that is not empty.

    Notes
    -----
    Clock times are seconds since the first one; see ``Stamps`` for dates and midnight.

    Examples
    --------
    >>> TextColumn("time", ".", SampleLocation("x.csv")).numbers(["23:59:59.5", "00:00:00,25"], 0)
    array([0.  , 0.75])
    """

    def __init__(
        self, name: str, decimal: str, location: SampleLocation, clock: bool | None = None
    ) -> None:
        """Start before the first cell; the parameters are those of the class."""
        self.name = name
        self.decimal = decimal
        self.location = location
        self.clock = clock
        self.bad_cells = 0
        self.first_bad_cell: dict[str, Any] = {}
        self.stamps = Stamps(name, location.where)

    def numbers(self, texts: list[str], first_index: int) -> Array:
        """Numbers (N,) from the cells of a chunk.

        Parameters
        ----------
        texts
            The cells; chunks must come in their order.
        first_index
            Index in the file of the first of them.
        """
        if self.clock is None:
            filled = [text for text in texts if text.lower() not in ABSENT]
            if filled:
                clock_cells = sum(CLOCK_PATTERN.fullmatch(text) is not None for text in filled)
                self.clock = clock_cells > 0.5 * len(filled)
        if self.clock:
            return self.stamps.seconds(texts)
        values = np.full(len(texts), np.nan)
        for i, text in enumerate(texts):
            values[i] = self._number(text, first_index + i)
        return values

    def _number(self, text: str, index: int) -> float:
        """Number in a cell; NaN, and counted as bad, if it holds something else.

        Parameters
        ----------
        text
            The cell.
        index
            Index of the cell in the file.
        """
        lower = text.lower()
        if is_number(text, self.decimal):
            return float(text.replace(",", "."))
        if lower in FLAGS:
            return FLAGS[lower]
        if lower in ABSENT:
            return np.inf if "inf" in lower else np.nan
        if not self.bad_cells:
            self.first_bad_cell = {"row": self.location.row(index), "text": text[:40]}
        self.bad_cells += 1
        return np.nan

    def findings(self, cells: int) -> list[Finding]:
        """Findings about the column, which has ``cells`` cells.

        Raises
        ------
        InputError
            If more than one cell in a hundred (and more than three) is no number.
        """
        if self.clock:
            return [info("text.midnight", subject=self.name)] if self.stamps.midnights else []
        if not self.bad_cells:
            return []
        first = self.first_bad_cell
        if self.bad_cells > max(BAD_CELLS, BAD_SHARE * cells):
            mark = "comma" if self.decimal == "," else "point"
            raise InputError(
                f"column {self.name}, row {first['row']}: {first['text']!r} is no number "
                f"({self.bad_cells} of {cells} cells)",
                where=self.location.where,
                expected=f"numbers with decimal {mark}",
            )
        return [warning("text.no_number", subject=self.name, count=self.bad_cells, **first)]
