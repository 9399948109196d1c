"""What dialect a text log is written in: encoding, separator, decimal mark, header; and what a cell of text means."""

from __future__ import annotations

import codecs
import re
from collections.abc import Collection
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from calibration import Array
from calibration.errors import InputError
from calibration.files.table import RowNumbers
from calibration.finding import Finding, look, note

NUMBER = {
    ".": re.compile(r"\s*[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?\s*"),
    ",": re.compile(r"\s*[-+]?(\d+,?\d*|,\d+)([eE][-+]?\d+)?\s*"),
}
CLOCK = re.compile(
    r"\s*(\d{4}-\d\d-\d\d[T ]|\d{1,2}[./]\d{1,2}[./]\d{2,4} )?\d{1,2}:\d\d:\d\d([.,]\d+)?\s*(AM|PM|Z)?\s*"
)
ABSENT = frozenset(
    {"", "nan", "+nan", "-nan", "null", "na", "n/a", "#n/a", "none", "inf", "-inf", "+inf", "1.#qnan", "-1.#ind"}
)
LINE_END = re.compile(r"\r\n|\n|\r")  # not str.splitlines: form feeds and the like end no row
HEAD_BYTES = 1 << 17
FLAGS = {"true": 1.0, "on": 1.0, "yes": 1.0, "high": 1.0, "false": 0.0, "off": 0.0, "no": 0.0, "low": 0.0}


@dataclass(frozen=True)
class Dialect:
    """How to read a text log; ``skip`` lines stand before the first row of data."""

    encoding: str
    separator: str
    decimal: str
    names: tuple[str, ...]
    skip: int
    fields: int
    first_row: tuple[str, ...]
    metadata: dict[str, str] = field(default_factory=dict)

    def columns(self, where: str) -> tuple[str, ...]:
        """A name for each column, empty where the header has none. Raises InputError where they do not fit the rows."""
        names = list(self.names)
        while len(names) > self.fields and not names[-1]:
            names.pop()
        if len(names) > self.fields or self.fields > len(names) + 1:
            raise InputError(
                f"the header has {len(names)} names but row {self.skip + 1} has {self.fields} fields",
                where=where,
                expected="one name for each column",
                remedy="decimal commas need semicolons or tabs between columns" if self.separator == "," else "",
            )
        return tuple(names + [""] * (self.fields - len(names)))


def sniff(head: bytes, where: str, known: Collection[str] = ()) -> Dialect:
    """The dialect of a text log from its first bytes.

    ``known`` are the names that a header may hold: among several lines of text above the first numbers (titles,
    header blocks, units) the one that holds most of them is the header. Lines that start with ``#`` and hold a
    colon are metadata.

    Raises InputError when the bytes are no text, or no header with rows of numbers below can be found.
    """
    if not head.strip(b"\x00 \r\n\t"):
        raise InputError("the file is empty", where=where, expected="a header row and rows of numbers")
    encoding = _encoding(head, where)
    text = head.decode(encoding, errors="replace")
    lines = LINE_END.split(text)
    if len(head) >= HEAD_BYTES and len(lines) > 1:
        lines = lines[:-1]  # the last one may be cut
    metadata = _metadata(lines)
    best: tuple[float, Dialect] | None = None
    for separator in ("\t", ";", ",", " "):
        if separator == " " and best is not None:
            break  # spaces part columns only where nothing else does
        for decimal in (".", ",") if separator != "," else (".",):
            found = _try(lines, separator, decimal, encoding, metadata, {k.lower() for k in known})
            if found is not None and (best is None or found[0] > best[0]):
                best = found
    if best is None:
        shown = next((line for line in lines if line.strip() and not line.startswith("#")), "")[:80]
        raise InputError(
            f"no table found (the text begins {shown!r})",
            where=where,
            expected="a header row, then rows of numbers separated by comma, semicolon, tab or spaces",
        )
    dialect = best[1]
    if not dialect.names:
        raise InputError(
            f"row {dialect.skip + 1} is numbers and no header row stands above it",
            where=where,
            expected="a header row with the column names",
            remedy="write the names into the first row",
        )
    return dialect


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


def split(line: str, separator: str) -> list[str]:
    """The fields of one line, outer quotes and spaces taken away; spaces part them in any number."""
    parts = line.split() if separator == " " else line.split(separator)
    return [part.strip().strip('"').strip() for part in parts]


def _is_cell(text: str, decimal: str) -> bool:
    low = text.lower()
    return is_number(text, decimal) or low in ABSENT or low in FLAGS or CLOCK.fullmatch(text) is not None


def _is_data(parts: list[str], decimal: str) -> bool:
    full = [p for p in parts if p.lower() not in ABSENT]
    if not full:
        return False
    good = sum(is_number(p, decimal) or CLOCK.fullmatch(p) is not None or p.lower() in FLAGS for p in full)
    return good >= max(1.0, 0.6 * len(full)) and any(is_number(p, decimal) for p in full)


def _try(
    lines: list[str], separator: str, decimal: str, encoding: str, metadata: dict[str, str], known: set[str]
) -> tuple[float, Dialect] | None:
    top = next((i for i, line in enumerate(lines) if line.strip() and not line.startswith("#")), len(lines))
    rows = [(i, split(line, separator)) for i, line in enumerate(lines) if i >= top and line.strip()]
    data = [k for k, (_, parts) in enumerate(rows) if len(parts) > 1 and _is_data(parts, decimal)]
    if not data:
        return None
    counts = [len(rows[k][1]) for k in data]
    fields = max(set(counts), key=counts.count)
    first = next(k for k in data if len(rows[k][1]) == fields)
    exact = sum(len(rows[k][1]) == fields and all(_is_cell(p, decimal) for p in rows[k][1]) for k in data)
    marks = sum(decimal in p for k in data[:50] for p in rows[k][1])
    score = exact / len(data) + 0.01 * fields + (0.001 if marks else 0.0)
    header = _header(rows[:first], fields, decimal, known)
    if header is None:
        names: tuple[str, ...] = ()
    else:
        names = tuple(rows[header][1])
        # below the header only units may stand: a row that holds numbers is data, damaged or not
        first = next((k for k in range(header + 1, first) if _numeric_share(rows[k][1], decimal) > 0.25), first)
    return score, Dialect(encoding, separator, decimal, names, rows[first][0], fields, tuple(rows[first][1]), metadata)


def _header(rows: list[tuple[int, list[str]]], fields: int, decimal: str, known: set[str]) -> int | None:
    fits = [k for k, (_, parts) in enumerate(rows) if len(parts) > 1 and abs(len(parts) - fields) <= 1]
    fits = [k for k in fits if not _is_data(rows[k][1], decimal)]
    if fits:
        return max(fits, key=lambda k: sum(n.lower() in known for n in rows[k][1]))
    return len(rows) - 1 if rows and len(rows[-1][1]) > 1 and not _is_data(rows[-1][1], decimal) else None


def _numeric_share(parts: list[str], decimal: str) -> float:
    full = [p for p in parts if p]
    return sum(is_number(p, decimal) for p in full) / max(len(full), 1)


class TextColumn:
    """A column of cells of text that comes in one piece or in many; what many give together is what one gives.

    Whether it holds clock times is seen from the first piece with anything in it; ``clock`` says so beforehand.
    Clock times, with or without a date, are seconds since the first one, and midnight may pass.

    >>> TextColumn("time", ".", "x.csv").numbers(["23:59:59.5", "00:00:00,25"], RowNumbers())
    array([0.  , 0.75])
    """

    def __init__(self, name: str, decimal: str, where: str, clock: bool | None = None) -> None:
        self.name, self.decimal, self.where, self.clock = name, decimal, where, clock
        self.bad, self.first_bad = 0, dict[str, Any]()
        self.first_s = self.last_s = np.nan
        self.days = 0.0

    def numbers(self, texts: list[str], rows: RowNumbers) -> Array:
        """Numbers (N,) from the cells of one piece, whose rows of the file are ``rows``."""
        full = [t for t in texts if t.lower() not in ABSENT]
        if self.clock is None and full:
            self.clock = sum(CLOCK.fullmatch(t) is not None for t in full) > 0.5 * len(full)
        if self.clock:
            return self._seconds(texts, rows)
        out = np.full(len(texts), np.nan)
        for i, text in enumerate(texts):
            low = text.lower()
            if is_number(text, self.decimal):
                out[i] = float(text.replace(",", "."))
            elif low in FLAGS:
                out[i] = FLAGS[low]
            elif low not in ABSENT:
                self.first_bad = self.first_bad or {"row": rows.of(i), "text": text[:40]}
                self.bad += 1
            elif "inf" in low:
                out[i] = np.inf
        return out

    def judge(self, cells: int) -> list[Finding]:
        """What was noticed in all ``cells`` of the column.

        Raises InputError when more than one in a hundred (and more than three) is no number.
        """
        if self.clock:
            return [note("text.midnight", subject=self.name)] if self.days else []
        if not self.bad:
            return []
        if self.bad > max(3, 0.01 * cells):
            raise InputError(
                f"column {self.name}, row {self.first_bad['row']}: {self.first_bad['text']!r} is no number "
                f"({self.bad} of {cells} cells)",
                where=self.where,
                expected=f"numbers with decimal {'comma' if self.decimal == ',' else 'point'}",
            )
        return [look("text.no_number", subject=self.name, count=self.bad, **self.first_bad)]

    def _seconds(self, texts: list[str], rows: RowNumbers) -> Array:
        series = pd.Series(texts, dtype="str").str.replace(",", ".", regex=False)
        parts = series.str.extract(r"(?P<h>\d{1,2}):(?P<m>\d\d):(?P<s>\d\d(?:\.\d+)?)\s*(?P<half>AM|PM)?")
        hour = pd.to_numeric(parts["h"]).to_numpy(dtype=float)
        afternoon = (parts["half"] == "PM").to_numpy(dtype=bool)
        morning = (parts["half"] == "AM").to_numpy(dtype=bool)
        hour = np.where(afternoon | morning, hour % 12, hour) + 12.0 * afternoon
        minute = pd.to_numeric(parts["m"]).to_numpy(dtype=float)
        second = hour * 3600 + minute * 60 + pd.to_numeric(parts["s"]).to_numpy(dtype=float)
        if not len(second):
            return second
        if np.isnan(self.first_s):
            if not np.isfinite(second[0]):
                raise InputError(
                    f"column {self.name}, row {rows.of(0)}: {texts[0]!r} is no clock time", where=self.where
                )
            self.first_s = self.last_s = float(second[0])
        steps = np.diff(second, prepend=self.last_s)
        days = self.days + np.cumsum(np.where(steps < -43200.0, 1.0, 0.0))
        self.last_s, self.days = float(second[-1]), float(days[-1])
        return np.asarray(np.round(second + 86400.0 * days - self.first_s, 9))
