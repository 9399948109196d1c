"""Dialect of a text log: encoding, separator, decimal mark, header, units.

Used by :mod:`tcdyn.io.read`, :mod:`tcdyn.io.growing` and :mod:`tcdyn.io.lvm`. Each combination of
separator and decimal mark is tried on the first rows, and the one that reads most rows is taken.
The shares below were chosen by judgement; the damaged and the sound files of
``tests/io/test_damaged_files.py``, the dialects of ``tests/io/test_file_formats.py`` and the
loggers of ``tests/io/test_logger_families.py`` decide whether they hold.
"""

from __future__ import annotations

import codecs
import csv
import io
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

from tcdyn.core.errors import InputError
from tcdyn.io.cells import ABSENT, is_number, is_unit, kind_of_cell, number_and_unit, to_number
from tcdyn.io.stamps import is_date, is_stamp
from tcdyn.io.times import EARLIEST_EPOCH_S, LATEST_EPOCH_S, is_time_name

LINE_END = re.compile(r"\r\n|\n|\r")  # str.splitlines would also split at form feeds and the like
HEAD_BYTES = 1 << 17  # read to detect the dialect: header and some rows must fit
LONG_HEAD_BYTES = 1 << 23  # the same where they do not
DATA_ROWS = 150  # rows of data that suffice to detect the dialect; chosen by judgement
# a row is data if at least this share of its filled cells can be read; chosen by judgement
DATA_SHARE = 0.6
# a row below the header with more than this share of numbers is data, damaged or not; chosen by
# judgement
NUMERIC_SHARE = 0.25
UNREADABLE = ("word", "other")  # kinds of cells that are no data
COMMENT = "#"  # begins a line of comment
# physical lines that a quoted cell of the header may span; chosen by judgement
LONGEST_CELL_LINES = 8
# rows with a time and the same words are data: a sensor that gives no reading; by judgement
ROWS_OF_ONE_WORD = 3
ROW_NUMBERS = 5  # rows that must be numbered from 1 to take the first column for row names


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
        The text as UTF-8, where it is no text of the file (a sheet of a workbook) or had to be
        rewritten (UTF-16, columns separated by spaces).
    units
        Units by column, from a row below the header or behind the numbers of the first row.
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
    has_row_names: bool = False
    ambiguous_cell: str = ""
    unix_unit: str = ""
    most_fields: int = 0


def detect_dialect(
    path: Path, where: str, known_names: Collection[str] = (), text: bytes | None = None
) -> Dialect:
    """Detect the dialect of a text log from its first bytes.

    Parameters
    ----------
    path
        The file.
    where
        The file, for messages.
    known_names
        Names that a header may contain. Among several lines of text above the first numbers
        (titles, header blocks, units) the one with most of them is the header.
    text
        The text as UTF-8, if it is not that of the file but of a sheet in it.

    Raises
    ------
    InputError
        If the bytes are no text, or there is no header with rows of numbers below it.

    Notes
    -----
    Encoding, then separator and decimal mark by ``_find_best_layout``, then names and units. UTF-16
    and columns separated by spaces are rewritten in memory, because pyarrow reads neither; such a
    file cannot be followed while it grows (``tcdyn.io.growing.open_growing``). The first
    ``LONG_HEAD_BYTES`` must hold a header and some rows: a longer header is not found.
    """
    for size in (HEAD_BYTES, LONG_HEAD_BYTES):
        with open(path, "rb") if text is None else io.BytesIO(text) as stream:
            head = stream.read(size)
        encoding, lines, layout = _layout_of_head(head, size, where, known_names)
        if layout is not None or len(head) < size:
            break
    if layout is None:
        text_lines = (line for line in lines if line.strip() and not line.startswith("#"))
        raise InputError(
            f"no table found (the text begins {next(text_lines, '')[:80]!r})",
            where=where,
            expected="a header row, then rows of numbers separated by comma, semicolon, tab or "
            "spaces",
        )
    if layout.ambiguous_cell:
        raise InputError(
            f"{layout.ambiguous_cell!r} may have a decimal comma or a comma between thousands",
            where=where,
            expected="semicolons or tabs between columns with decimal commas",
        )
    names = _column_names(layout, where)
    first_row = (*layout.first_row, *[""] * layout.fields)[: layout.fields]
    body = text
    if encoding.startswith("utf-16"):
        body = _utf16_as_utf8(path, encoding, where)
    separator = layout.separator
    if separator == " ":
        separator = "\t"
        body = tabs_for_spaces(body or path.read_bytes())
    units = {name: unit for name, unit in zip(names, layout.units) if unit}
    return Dialect(
        where,
        encoding,
        separator,
        layout.decimal,
        names,
        layout.skip,
        first_row,
        _comment_metadata(lines),
        path,
        body,
        units,
    )


def _column_names(layout: _Layout, where: str) -> tuple[str, ...]:
    """A name for each column; one without a name is called by its number.

    A first column without a name that holds times since 1970 is called by this.

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
        less is accepted: the last column then has no name, or the first one if it numbers the rows.
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
    names = [" ".join(name.split()) for name in layout.header]
    if not names[0] and len(names) == fields and layout.unix_unit:
        names[0] = f"unix_time_{layout.unix_unit}"
    while len(names) > fields and not names[-1]:
        names.pop()
    if len(names) == layout.most_fields > fields:
        raise InputError(
            f"row {row} has {fields} fields, but the header and other rows have {len(names)}: "
            "cells at the end of rows are left out",
            where=where,
            expected="all cells in each row",
            remedy="write a separator for each cell that is left out",
        )
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
    if len(names) < fields:
        names = ["", *names] if layout.has_row_names else [*names, ""]
    return tuple(name or f"column {k}" for k, name in enumerate(names, 1))


def _utf16_as_utf8(path: Path, encoding: str, where: str) -> bytes:
    """The text of a UTF-16 file as UTF-8; InputError if it is broken."""
    try:
        return path.read_bytes().decode(encoding).encode("utf-8")
    except UnicodeDecodeError as problem:
        raise InputError(f"broken UTF-16 text ({problem.reason})", where=where) from None


def tabs_for_spaces(text: bytes) -> bytes:
    """The text with one tab for each run of spaces, none at the ends of lines."""
    text = re.sub(rb"(?m)^[ \t]+|[ \t]+(?=\r?$)", b"", text)
    return re.sub(rb"[ \t]+", b"\t", text)


def _layout_of_head(
    head: bytes, size: int, where: str, known_names: Collection[str]
) -> tuple[str, list[str], _Layout | None]:
    """Encoding, lines and layout of the first bytes of a file.

    Parameters
    ----------
    head
        The first ``size`` bytes, or all of a shorter file.
    size
        Number of bytes that were asked for.
    where
        The file, for messages.
    known_names
        Names that a header may contain.

    Raises
    ------
    InputError
        For an empty file, and for bytes that are no text.
    """
    if not head.strip(b"\x00 \r\n\t"):
        raise InputError(
            "the file is empty", where=where, expected="a header row and rows of numbers"
        )
    encoding = _detect_encoding(head, where)
    lines = LINE_END.split(head.decode(encoding, errors="replace"))
    if len(head) >= size and len(lines) > 1:
        lines = lines[:-1]  # the last one may be incomplete
    layout = _find_best_layout(tuple(lines), frozenset(name.lower() for name in known_names))
    return encoding, lines, layout


@lru_cache(maxsize=4)
def _find_best_layout(lines: tuple[str, ...], known_names: frozenset[str]) -> _Layout | None:
    """The layout with the best score; the first of equal ones: tab, semicolon, comma, bar.

    Parameters
    ----------
    lines
        First lines of the text.
    known_names
        Column names in lower case that a header may contain.

    Notes
    -----
    Cached, because a log may be opened several times. A comma that separates columns is the decimal
    mark only inside quotes. Spaces separate columns only if nothing else does.
    """
    has_quotes = any('"' in line for line in lines)
    layouts: list[_Layout] = []
    for separator, decimals in (
        ("\t", ".,"),
        (";", ".,"),
        (",", ".," if has_quotes else "."),
        ("|", ".,"),
    ):
        layouts += _layouts(lines, separator, decimals, known_names)
    if not layouts:  # spaces separate columns only if nothing else does
        layouts = _layouts(lines, " ", ".,", known_names)
    return max(layouts, key=lambda layout: layout.score, default=None)


def _layouts(
    lines: Sequence[str], separator: str, decimals: str, known_names: Collection[str]
) -> list[_Layout]:
    """The layouts with data for one separator and each of the decimal marks."""
    candidates = [_find_layout(lines, separator, decimal, known_names) for decimal in decimals]
    return [layout for layout in candidates if layout is not None]


def _detect_encoding(head: bytes, where: str) -> str:
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
        if zeros > 0.3 * len(head):
            for start, name in ((1, "utf-16-le"), (0, "utf-16-be")):
                if head[start:200:2].count(0) > 80:
                    return name
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


def _comment_metadata(lines: list[str]) -> dict[str, str]:
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


def split(line: str, separator: str) -> list[str]:
    """Fields of a line without quotes and spaces around them; spaces separate in any number.

    >>> split('"Temp, °C";1', ";"), split('"Temp, °C", 1', ",")
    (['Temp, °C', '1'], ['Temp, °C', '1'])
    """
    if '"' in line:
        line = line.replace("\r", " ").replace("\n", " ")
        fields = next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
        if separator == " ":
            fields = [text for text in fields if text]
    else:
        fields = line.split() if separator == " " else line.split(separator)
    return [text.strip().strip('"').strip() for text in fields]


def has_open_quote(text: str, separator: str) -> bool:
    """Whether a field that begins with a quotation mark goes on in the next line.

    >>> has_open_quote('1;"two', ";"), has_open_quote('1;6" pipe', ";")
    (True, False)
    """
    if text.count('"') % 2 == 0:
        return False
    begin = rf"(?:^|{re.escape(separator)})\s*"
    return re.search(begin + r'"(?:[^"]|"")*$', text) is not None


def _kind(text: str, decimal: str) -> str:
    """Kind of a cell; a date counts as a stamp."""
    kind = kind_of_cell(text, decimal)
    return "stamp" if kind in UNREADABLE and is_date(text) else kind


def _is_plain_word(text: str) -> bool:
    """Whether a cell is a word, and not a number or several cells of another dialect."""
    has_letter = re.search(r"[^\W\d_]", text) is not None
    has_separator = re.search(r"[;\t|]", text) is not None
    return has_letter and not has_separator and not any(is_number(text, mark) for mark in ".,")


def _is_data(cells: list[str], decimal: str) -> bool:
    """Whether a row is data: it has a number, and most filled cells can be read.

    If the first filled cell is a number or a stamp, two such cells are enough: the others may be
    text. A row with the name of a time column is none.
    """
    filled = [cell for cell in cells if cell.lower() not in ABSENT]
    kinds = [_kind(cell, decimal) for cell in filled]
    if "number" not in kinds:
        return False
    if any(kind == "word" and is_time_name(cell) for cell, kind in zip(filled, kinds)):
        return False
    readable = sum(kind not in UNREADABLE for kind in kinds)
    if readable >= DATA_SHARE * len(filled):
        return True
    return kinds[0] in ("number", "stamp") and sum(k in ("number", "stamp") for k in kinds) > 1


def _words_of_row(cells: list[str], decimal: str) -> tuple[str, ...]:
    """The words of a row that begins with a number or a stamp; none for any other row."""
    if len(cells) < 2 or _kind(cells[0], decimal) not in ("number", "stamp"):
        return ()
    words = tuple(cell for cell in cells[1:] if kind_of_cell(cell, decimal) == "word")
    is_other = any(kind_of_cell(cell, decimal) == "other" for cell in cells[1:])
    return () if is_other else words


def _find_layout(
    lines: Sequence[str], separator: str, decimal: str, known_names: Collection[str]
) -> _Layout | None:
    """Find header and data with one separator and decimal mark; None without data.

    Parameters
    ----------
    lines
        First lines of the text.
    separator, decimal
        Separator of the columns and decimal mark.
    known_names
        Column names in lower case that a header may contain.

    Notes
    -----
    The number of fields is the most frequent one of the rows of data, and data starts at the first
    such row. A row below the header with more numbers than ``NUMERIC_SHARE`` is data too, so that a
    damaged first row is reported and not skipped.
    """
    comments, rows, data = _rows_and_data(lines, separator, decimal)
    if not data:
        return None
    widths = [len(rows[k][1]) for k in data]
    fields = max(set(widths), key=widths.count)
    complete = [k for k in data if len(rows[k][1]) == fields]
    first = _first_row(rows, complete, decimal)
    first = _with_rows_of_words(rows, first, decimal)
    header = _header_index(rows[:first], fields, decimal, known_names)
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
    elif comments and len(comments[-1]) == fields:
        names = tuple(comments[-1])
    else:  # the header may be that of the longest rows, see ``_column_names``
        header = _header_index(rows[:first], max(widths), decimal, known_names)
        names = tuple(rows[header][1]) if header is not None else ()
    line, cells = rows[first]
    cells = _with_midnight(cells, [rows[k][1] for k in complete])
    if not units:
        units = tuple(number_and_unit(cell, decimal)[1] for cell in cells)
    score = _readable_share([rows[k][1] for k in data], len(rows) - complete[0], fields, decimal)
    numbers = [rows[k][1][0] for k in complete[:ROW_NUMBERS]]
    has_row_names = numbers == [str(k) for k in range(1, ROW_NUMBERS + 1)]
    ambiguous = ""
    if separator == decimal:
        ambiguous = _ambiguous_cell([rows[k][1] for k in complete])
    return _Layout(
        score,
        separator,
        decimal,
        names,
        line,
        tuple(cells),
        fields,
        units,
        has_row_names,
        ambiguous,
        _unix_unit([rows[k][1][0] for k in complete], decimal),
        max(widths),
    )


def _unix_unit(cells: Sequence[str], decimal: str) -> str:
    """Unit of cells that are times since 1970 and rise, "s" or "ms"; empty for any others.

    Parameters
    ----------
    cells
        Cells of the first column in the first rows.
    decimal
        Decimal mark.
    """
    if len(cells) < 2 or not all(is_number(cell, decimal) for cell in cells):
        return ""
    times = [to_number(cell, decimal) for cell in cells]
    if any(later <= earlier for earlier, later in pairwise(times)):
        return ""
    for unit, seconds in (("s", 1.0), ("ms", 1e-3)):
        is_late = seconds * times[0] >= EARLIEST_EPOCH_S
        if is_late and seconds * times[-1] <= LATEST_EPOCH_S:
            return unit
    return ""


def _with_midnight(cells: list[str], data: list[list[str]]) -> list[str]:
    """The first row of data, with a clock of 0 h behind a date in a column of dates and clocks."""
    out = list(cells)
    for k, cell in enumerate(cells):
        if is_date(cell) and any(is_stamp(row[k]) for row in data):
            out[k] = f"{cell} 00:00:00"
    return out


def _ambiguous_cell(data: list[list[str]]) -> str:
    """A cell such as "1,234" if all cells with a comma are like it; else empty."""
    with_comma = [cell for cells in data for cell in cells if is_number(cell, ",") and "," in cell]
    if all(re.fullmatch(r"[-+]?[1-9]\d{0,2}(,\d{3})+", cell) for cell in with_comma):
        return next(iter(with_comma), "")
    return ""


def _first_row(rows: list[tuple[int, list[str]]], complete: list[int], decimal: str) -> int:
    """Index of the first row of data: the first cell is of the kind that most rows have there.

    Above it, rows of numbers can be names: "Ch; 1; 2".

    Parameters
    ----------
    rows
        Line number and cells of each row.
    complete
        Indices of the rows of data with all fields.
    decimal
        Decimal mark.
    """
    kinds = [_kind(rows[k][1][0], decimal) for k in complete]
    usual = max(set(kinds), key=kinds.count)
    return next(k for k, kind in zip(complete, kinds) if kind in (usual, "absent"))


def _with_rows_of_words(rows: list[tuple[int, list[str]]], first: int, decimal: str) -> int:
    """Index of the first row of data, with the rows directly above that hold no reading.

    They begin with a stamp as the first row does, or with a number and hold words for a reading.

    Parameters
    ----------
    rows
        Line number and cells of each row.
    first
        Index of the first row of data.
    decimal
        Decimal mark.
    """
    cells = rows[first][1]
    kind = _kind(cells[0], decimal)
    while first > 0 and kind in ("number", "stamp"):
        above = rows[first - 1][1]
        if len(above) != len(cells) or _kind(above[0], decimal) != kind:
            break
        # a row with a time stamp is one of the logger, also if no cell of it is a reading ("---")
        if kind != "stamp" and not _words_of_row(above, decimal):
            break
        first -= 1
    return first


def _rows_and_data(
    lines: Sequence[str], separator: str, decimal: str
) -> tuple[list[list[str]], list[tuple[int, list[str]]], list[int]]:
    """Comments above the table, rows below them, and which of the rows are data.

    Parameters
    ----------
    lines
        First lines of the text.
    separator, decimal
        Separator of the columns and decimal mark.

    Returns
    -------
    comments
        Cells of each comment above the table, without the mark of a comment.
    rows
        Line number and cells of each row.
    data
        Indices in ``rows`` of the rows of data: about ``DATA_ROWS``, with those in which the same
        words stand for readings in at least ``ROWS_OF_ONE_WORD`` rows.
    """
    top = 0
    comments: list[list[str]] = []
    while top < len(lines) and (not lines[top].strip() or lines[top].startswith(COMMENT)):
        if lines[top].strip():
            comments.append(split(lines[top].lstrip(COMMENT), separator))
        top += 1
    rows: list[tuple[int, list[str]]] = []
    data: list[int] = []
    with_words: dict[tuple[str, ...], list[int]] = {}
    number = top
    n_repeated = 0
    while number < len(lines) and max(len(data), n_repeated) < DATA_ROWS:
        line, count = _join_quoted_lines(lines, number, separator)
        if line.strip() and not line.startswith(COMMENT):
            cells = split(line, separator)
            rows.append((number, cells))
            if len(cells) > 1 and _is_data(cells, decimal):
                data.append(len(rows) - 1)
            elif words := _words_of_row(cells, decimal):
                alike = with_words.setdefault((str(len(cells)), *words), [])
                alike.append(len(rows) - 1)
                n_repeated = max(n_repeated, len(alike))
        number += count
    for alike in with_words.values():
        if len(alike) >= ROWS_OF_ONE_WORD:
            data += alike
    return comments, rows, sorted(data)


def _join_quoted_lines(lines: Sequence[str], number: int, separator: str) -> tuple[str, int]:
    """Join a line and those that continue its quoted cell.

    Parameters
    ----------
    lines
        Lines of the file.
    number
        Index of the line.
    separator
        Separator of the cells.

    Returns
    -------
    line, count
        The joined line, and of how many it consists. A quote that is not closed within
        ``LONGEST_CELL_LINES`` is a character: the line alone.
    """
    line = lines[number]
    count = 1
    while has_open_quote(line, separator):
        if count == LONGEST_CELL_LINES or number + count == len(lines):
            return lines[number], 1
        line += "\n" + lines[number + count]
        count += 1
    return line, count


def _readable_share(data: list[list[str]], count: int, fields: int, decimal: str) -> float:
    """Share of rows that can be read completely; columns and a decimal mark in use add a little.

    Parameters
    ----------
    data
        Cells of the rows of data.
    count
        Number of rows from the first of them on, with those that are no data.
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
        is_read = [_kind(cell, decimal) not in UNREADABLE or _is_plain_word(cell) for cell in cells]
        exact += len(cells) == fields and all(is_read)
    has_decimal_mark = any(decimal in cell for cells in data[:50] for cell in cells)
    return exact / count + 0.01 * fields + (0.001 if has_decimal_mark else 0.0)


def _unit_row(rows: Sequence[Sequence[str]], fields: int) -> tuple[str, ...]:
    """Cells of the row of units below the header, without brackets; empty if there is none."""
    for row in rows:
        cells = [re.sub(r"^[\[(]\s*(.*?)\s*[\])]$", r"\1", cell.strip()) for cell in row]
        if len(cells) == fields and any(is_unit(cell) for cell in cells):
            return tuple(cell if re.search(r"[^\W\d_]|°", cell) else "" for cell in cells)
    return ()


def _header_index(
    rows: list[tuple[int, list[str]]], fields: int, decimal: str, known_names: Collection[str]
) -> int | None:
    """Index of the header in ``rows``; None if there is none.

    Of the rows of text with the number of fields of the data, or one more or less, it is the one
    with most known names and names of time columns. Of equal ones it is that with fewest units,
    then with most filled cells, then the last of them. Without such a row, a last row of text is
    taken, so that the message about its number of names is about the right row.

    Parameters
    ----------
    rows
        Line number and cells of the rows above the data.
    fields
        Number of fields of the data.
    decimal
        Decimal mark.
    known_names
        Column names in lower case.
    """
    texts = [
        k
        for k, (_, cells) in enumerate(rows)
        if len(cells) > 1 and not _is_data(cells, decimal) and not _is_prose(cells)
    ]
    candidates = [k for k in texts if abs(len(rows[k][1]) - fields) <= 1]
    if candidates:
        return max(candidates, key=lambda k: (*_header_likeness(rows[k][1], known_names), k))
    last = len(rows) - 1
    return last if last in texts else None


def _is_prose(cells: Sequence[str]) -> bool:
    """Whether a row is no header: a line of asterisks or one with a sign or a key among its cells.

    >>> _is_prose(["*", "Sea-Bird", "SBE", "39"]), _is_prose(["start", "=", "10"])
    (True, True)
    >>> _is_prose(["Time", "T1", "#"]), _is_prose(["t", "T (°C)"])
    (False, False)
    """
    return cells[0].startswith("*") or any(cell in ("=", ":", "*") for cell in cells)


def _header_likeness(cells: list[str], known_names: Collection[str]) -> tuple[int, int, int]:
    """How much a row is like a header: known names, few units, filled cells."""
    names = sum(cell.lower() in known_names or is_time_name(cell) for cell in cells)
    units = sum(is_unit(cell) for cell in cells)
    return names, -units, sum(bool(cell) for cell in cells)


def _numeric_share(cells: list[str], decimal: str) -> float:
    """Share of the filled cells that are numbers."""
    filled = [cell for cell in cells if cell]
    return sum(is_number(cell, decimal) for cell in filled) / max(len(filled), 1)
