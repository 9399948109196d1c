"""What dialect a text log is written in: encoding, separator, decimal mark, header; and what a cell of text means."""

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

NUMBER = {
    ".": re.compile(r"\s*[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?\s*"),
    ",": re.compile(r"\s*[-+]?(\d+,?\d*|,\d+)([eE][-+]?\d+)?\s*"),
}
CLOCK = re.compile(
    r"\s*(\d{4}-\d\d-\d\d[T ]|\d{1,2}[./]\d{1,2}[./]\d{2,4} )?\d{1,2}:\d\d:\d\d([.,]\d+)?\s*(AM|PM|Z)?\s*"
)
ABSENT = frozenset(
    {
        "",
        "nan",
        "+nan",
        "-nan",
        "null",
        "na",
        "n/a",
        "#n/a",
        "none",
        "inf",
        "-inf",
        "+inf",
        "1.#qnan",
        "-1.#ind",
    }
)
LINE_END = re.compile(r"\r\n|\n|\r")  # not str.splitlines: form feeds and the like end no row
HEAD_BYTES = 1 << 17
ENOUGH = 150  # rows of data that tell a dialect
# separator, decimal mark, header, skip, first row, number of fields, unit row
_Found = tuple[str, str, tuple[str, ...], int, tuple[str, ...], int, tuple[str, ...]]
FLAGS = {
    "true": 1.0,
    "on": 1.0,
    "yes": 1.0,
    "high": 1.0,
    "false": 0.0,
    "off": 0.0,
    "no": 0.0,
    "low": 0.0,
}


@dataclass(frozen=True)
class Dialect:
    """How to read a text log, a name for each of its columns; ``skip`` lines stand before the first row of data.

    ``body`` stands for the file where its text had to be rewritten (UTF-16, columns parted by spaces). ``units``: by
    column, from a row of units below the header.
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


def sniff(path: Path, where: str, known: Collection[str] = ()) -> Dialect:
    """The dialect of a text log from its first bytes.

    ``known`` are the names that a header may hold: among several lines of text above the first numbers (titles,
    header blocks, units) the one that holds most of them is the header. Lines that start with ``#`` and hold a
    colon are metadata.

    Raises InputError when the bytes are no text, or no header with rows of numbers below can be found.
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
        lines = lines[:-1]  # the last one may be cut
    found = _likeliest(tuple(lines), frozenset(k.lower() for k in known))
    if found is None:
        shown = next((line for line in lines if line.strip() and not line.startswith("#")), "")[:80]
        raise InputError(
            f"no table found (the text begins {shown!r})",
            where=where,
            expected="a header row, then rows of numbers separated by comma, semicolon, tab or spaces",
        )
    separator, decimal, header, skip, first_row, fields, unit_row = found
    if not header:
        raise InputError(
            f"row {skip + 1} is numbers and no header row stands above it",
            where=where,
            expected="a header row with the column names",
            remedy="write the names into the first row",
        )
    names = list(header)
    while len(names) > fields and not names[-1]:
        names.pop()
    if len(names) > fields or fields > len(names) + 1:
        raise InputError(
            f"the header has {len(names)} names but row {skip + 1} has {fields} fields",
            where=where,
            expected="one name for each column",
            remedy="decimal commas need semicolons or tabs between columns"
            if separator == ","
            else "",
        )
    names += [""] * (fields - len(names))
    first_row = (*first_row, *[""] * fields)[:fields]
    body = None
    if encoding.startswith("utf-16"):
        try:
            body = path.read_bytes().decode(encoding).encode("utf-8")
        except UnicodeDecodeError as problem:
            raise InputError(f"broken UTF-16 text ({problem.reason})", where=where) from None
    if separator == " ":
        separator = "\t"
        body = re.sub(rb"(?m)^[ \t]+|[ \t]+(?=\r?$)", b"", body or path.read_bytes())
        body = re.sub(rb"[ \t]+", b"\t", body)
    metadata = _metadata(lines)
    units = {name: unit for name, unit in zip(names, unit_row) if unit}
    return Dialect(
        where,
        encoding,
        separator,
        decimal,
        tuple(names),
        skip,
        first_row,
        metadata,
        path,
        body,
        units,
    )


@lru_cache(maxsize=4)
def _likeliest(lines: tuple[str, ...], known: frozenset[str]) -> _Found | None:
    """The layout that makes most of the ``lines``, remembered: who opens a log asks for its names several times."""
    tried: list[tuple[float, _Found]] = []
    for separator, decimals in (("\t", ".,"), (";", ".,"), (",", "."), (" ", ".,")):
        if separator == " " and tried:
            break  # spaces part columns only where nothing else does
        found = (_try(lines, separator, decimal, known) for decimal in decimals)
        tried += [layout for layout in found if layout is not None]
    return max(tried, key=lambda t: t[0])[1] if tried else None


def is_number(text: str, decimal: str = ".") -> bool:
    """Whether ``text`` is one number with this decimal mark."""
    return NUMBER[decimal].fullmatch(text) is not None


def _encoding(head: bytes, where: str) -> str:
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
    found: dict[str, str] = {}
    for line in lines:
        text = line.lstrip("\ufeff").strip()
        if text.startswith("#"):
            key, colon, value = text.lstrip("#").partition(":")
            if colon and key.strip():
                found[key.strip()] = value.strip()
        elif text:
            break
    return found


def is_temperature_unit(text: str) -> bool:
    """Whether a cell is a unit of a temperature or of a thermocouple's voltage.

    >>> is_temperature_unit("Deg. F"), is_temperature_unit("%")
    (True, False)
    """
    plain = re.sub(r"[\s.°º]|deg(rees?)?", "", text.lower())
    return plain in (
        "c",
        "celsius",
        "k",
        "kelvin",
        "f",
        "fahrenheit",
        "mv",
        "millivolt",
        "millivolts",
    )


def split(line: str, separator: str) -> list[str]:
    """The fields of one line, outer quotes and spaces taken away; spaces part them in any number."""
    parts = line.split() if separator == " " else line.split(separator)
    return [part.strip().strip('"').strip() for part in parts]


def _is_cell(text: str, decimal: str) -> bool:
    low = text.lower()
    return (
        is_number(text, decimal)
        or low in ABSENT
        or low in FLAGS
        or CLOCK.fullmatch(text) is not None
    )


def _is_data(parts: list[str], decimal: str) -> bool:
    full = [p for p in parts if p.lower() not in ABSENT]
    good = sum(_is_cell(p, decimal) for p in full)
    return good >= max(1.0, 0.6 * len(full)) and any(is_number(p, decimal) for p in full)


def _try(
    lines: Sequence[str], separator: str, decimal: str, known: Collection[str]
) -> tuple[float, _Found] | None:
    """How well the lines fit this separator and decimal mark, and where header and data then are; None: not at all."""
    top = next(
        (i for i, line in enumerate(lines) if line.strip() and not line.startswith("#")), len(lines)
    )
    rows = list[tuple[int, list[str]]]()
    data = list[int]()
    for i, line in enumerate(lines[top:], top):
        if line.strip():
            rows.append((i, parts := split(line, separator)))
            if len(parts) > 1 and _is_data(parts, decimal):
                data.append(len(rows) - 1)
        if len(data) == ENOUGH:
            break
    if not data:
        return None
    counts = [len(rows[k][1]) for k in data]
    fields = max(set(counts), key=counts.count)
    first = next(k for k in data if len(rows[k][1]) == fields)
    exact = sum(
        len(rows[k][1]) == fields and all(_is_cell(p, decimal) for p in rows[k][1]) for k in data
    )
    marks = sum(decimal in p for k in data[:50] for p in rows[k][1])
    score = exact / len(data) + 0.01 * fields + (0.001 if marks else 0.0)
    header = _header(rows[:first], fields, decimal, known)
    if header is not None:
        # below the header only units may stand: a row that holds numbers is data, damaged or not
        first = next(
            (k for k in range(header + 1, first) if _numeric_share(rows[k][1], decimal) > 0.25),
            first,
        )
    names = () if header is None else tuple(rows[header][1])
    units = (
        ()
        if header is None
        else _unit_row([parts for _, parts in rows[header + 1 : first]], fields)
    )
    return score, (separator, decimal, names, rows[first][0], tuple(rows[first][1]), fields, units)


def _unit_row(rows: Sequence[Sequence[str]], fields: int) -> tuple[str, ...]:
    """The cells of the row of units below the header, brackets taken away; empty where there is none."""
    for parts in rows:
        cells = tuple(re.sub(r"^[\[(]\s*(.*?)\s*[\])]$", r"\1", part.strip()) for part in parts)
        known = any(
            cell.rstrip(".").lower() in SECONDS_PER_UNIT or is_temperature_unit(cell)
            for cell in cells
        )
        if len(cells) == fields and known:
            return tuple(cell if re.search(r"[^\W\d_]|°", cell) else "" for cell in cells)
    return ()


def _header(
    rows: list[tuple[int, list[str]]], fields: int, decimal: str, known: Collection[str]
) -> int | None:
    fits = [
        k for k, (_, parts) in enumerate(rows) if len(parts) > 1 and abs(len(parts) - fields) <= 1
    ]
    fits = [k for k in fits if not _is_data(rows[k][1], decimal)]
    if fits:
        return max(fits, key=lambda k: sum(n.lower() in known for n in rows[k][1]))
    return (
        len(rows) - 1
        if rows and len(rows[-1][1]) > 1 and not _is_data(rows[-1][1], decimal)
        else None
    )


def _numeric_share(parts: list[str], decimal: str) -> float:
    full = [p for p in parts if p]
    return sum(is_number(p, decimal) for p in full) / max(len(full), 1)


class TextColumn:
    """A column of cells of text that comes in one piece or in many; what many give together is what one gives.

    Whether it holds clock times is seen from the first piece with anything in it; ``clock`` says so beforehand.
    Clock times are seconds since the first one; see ``Stamps`` for dates and midnight.

    >>> TextColumn("time", ".", SampleLocation("x.csv")).numbers(["23:59:59.5", "00:00:00,25"], 0)
    array([0.  , 0.75])
    """

    def __init__(
        self, name: str, decimal: str, place: SampleLocation, clock: bool | None = None
    ) -> None:
        self.name = name
        self.decimal = decimal
        self.place = place
        self.clock = clock
        self.bad, self.first_bad = 0, dict[str, Any]()
        self.stamps = Stamps(name, place.where)

    def numbers(self, texts: list[str], at: int) -> Array:
        """Numbers (N,) from the cells of one piece, whose first is number ``at`` of the file's."""
        full = [t for t in texts if t.lower() not in ABSENT]
        if self.clock is None and full:
            self.clock = sum(CLOCK.fullmatch(t) is not None for t in full) > 0.5 * len(full)
        if self.clock:
            return self.stamps.seconds(texts)
        out = np.full(len(texts), np.nan)
        for i, text in enumerate(texts):
            low = text.lower()
            if is_number(text, self.decimal):
                out[i] = float(text.replace(",", "."))
            elif low in FLAGS:
                out[i] = FLAGS[low]
            elif low not in ABSENT:
                self.first_bad = self.first_bad or {
                    "row": self.place.row(at + i),
                    "text": text[:40],
                }
                self.bad += 1
            elif "inf" in low:
                out[i] = np.inf
        return out

    def judge(self, cells: int) -> list[Finding]:
        """What was noticed in all ``cells`` of the column.

        Raises InputError when more than one in a hundred (and more than three) is no number.
        """
        if self.clock:
            return [info("text.midnight", subject=self.name)] if self.stamps.midnights else []
        if not self.bad:
            return []
        if self.bad > max(3, 0.01 * cells):
            raise InputError(
                f"column {self.name}, row {self.first_bad['row']}: {self.first_bad['text']!r} is no number "
                f"({self.bad} of {cells} cells)",
                where=self.place.where,
                expected=f"numbers with decimal {'comma' if self.decimal == ',' else 'point'}",
            )
        return [warning("text.no_number", subject=self.name, count=self.bad, **self.first_bad)]
