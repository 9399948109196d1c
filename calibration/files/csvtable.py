"""Text tables: every row's fields counted, numbers parsed exactly, clock times and on/off words understood."""

from __future__ import annotations

import io
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import IO, Any

import numpy as np
import pandas as pd
import pyarrow as pa
from pyarrow import csv as pacsv

from calibration.arrays import Array
from calibration.errors import InputError
from calibration.files.dialect import ABSENT, CLOCK, FLAGS, HEAD_BYTES, Dialect, RowCheck, check_rows, is_number, sniff
from calibration.files.table import PIECE_ROWS, Columns, RowNumbers
from calibration.finding import Finding, look, note

BLOCK_BYTES = 1 << 21  # of text in one piece, at most
_NULLS = sorted({w for a in ABSENT if "inf" not in a for w in (a, a.upper(), a.title(), "NaN", "-NaN")})


@dataclass(frozen=True)
class CsvTable:
    """A text table whose dialect is known; ``body`` replaces the file where the text had to be rewritten."""

    path: Path
    where: str
    dialect: Dialect
    names: tuple[str, ...]
    metadata: dict[str, str]
    body: bytes | None = None

    @classmethod
    def open(cls, path: Path, where: str, known: Collection[str] = ()) -> CsvTable:
        """Find out the dialect from the head of the file."""
        with open(path, "rb") as stream:
            head = stream.read(HEAD_BYTES)
        dialect = sniff(head, where, known)
        body = None
        if dialect.encoding.startswith("utf-16"):
            try:
                body = path.read_bytes().decode(dialect.encoding).encode("utf-8")
            except UnicodeDecodeError as problem:
                raise InputError(f"broken UTF-16 text ({problem.reason})", where=where) from None
        if dialect.separator == " ":
            dialect = replace(dialect, separator="\t")
            body = re.sub(rb"(?m)^[ \t]+|[ \t]+(?=\r?$)", b"", body or path.read_bytes())
            body = re.sub(rb"[ \t]+", b"\t", body)
        return cls(path, where, dialect, _named(dialect, where), dialect.metadata, body)

    def stream(self) -> IO[bytes]:
        """The text from its first byte."""
        return open(self.path, "rb") if self.body is None else io.BytesIO(self.body)

    @cached_property
    def found(self) -> RowCheck:
        """Rows and blank lines, every row's fields counted; raises InputError for a damaged row."""
        with self.stream() as stream:
            found = check_rows(stream, self.dialect, self.where)
        if found.rows == 0:
            raise InputError("no rows below the header", where=self.where)
        return found

    def pieces(self, wanted: Sequence[str], rows: int = PIECE_ROWS) -> Iterator[Columns]:
        """The wanted columns piece by piece, about ``rows`` rows each (2 MB of text at most), in bounded memory.

        From the first cell on that is no number where numbers were, every column is read as text.
        """
        number = RowNumbers(self.dialect.skip + 1, self.found.blank)
        texts = {name: TextColumn(name, self.dialect.decimal, self.where) for name in wanted}
        line = max(len(self.dialect.first_row) * 4, sum(len(cell) + 1 for cell in self.dialect.first_row))
        block_bytes = min(max(rows * line, 1 << 16), BLOCK_BYTES)
        done = 0
        for as_text in (False, True):
            skip = done
            try:
                with self.stream() as stream:
                    for batch in self._batches(stream, wanted, block_bytes, as_text):
                        part = batch.slice(min(skip, batch.num_rows))
                        skip -= batch.num_rows - part.num_rows
                        if part.num_rows:
                            at = number.after(done)
                            yield Columns(_numbers(part, wanted, at, texts), (), at)
                            done += part.num_rows
                break
            except pa.ArrowInvalid as problem:
                if as_text:
                    text = str(problem).splitlines()[0][:160]
                    raise InputError(f"the table cannot be read ({text})", where=self.where) from None
                for name in wanted:
                    if done and not self._is_text(name):
                        texts[name].clock = False  # numbers so far
        findings = (*(f for column in texts.values() for f in column.judge(done)), *self.found.findings)
        if findings:
            yield Columns({name: np.empty(0) for name in wanted}, findings, number.after(done))

    def _batches(self, stream: IO[bytes], wanted: Sequence[str], block_bytes: int, as_text: bool) -> Any:
        d = self.dialect
        keys = {name: f"c{self.names.index(name)}" for name in wanted}  # names in files may repeat; these do not
        # small blocks, none read ahead: the allocators keep some twenty times a block for themselves
        read = pacsv.ReadOptions(
            skip_rows=d.skip,
            column_names=[f"c{i}" for i in range(d.fields)],
            block_size=block_bytes,
            use_threads=False,
        )
        convert = pacsv.ConvertOptions(
            include_columns=list(keys.values()),
            column_types={k: pa.string() if as_text or self._is_text(n) else pa.float64() for n, k in keys.items()},
            decimal_point=d.decimal,
            null_values=_NULLS,
            check_utf8=False,
        )
        parse = pacsv.ParseOptions(delimiter=d.separator)
        return pacsv.open_csv(stream, read_options=read, parse_options=parse, convert_options=convert)

    def _is_text(self, name: str) -> bool:
        at = self.names.index(name)
        cell = self.dialect.first_row[at] if at < len(self.dialect.first_row) else ""
        return not is_number(cell, self.dialect.decimal) and cell.lower() not in ABSENT


def _numbers(
    batch: pa.RecordBatch, wanted: Sequence[str], rows: RowNumbers, texts: Mapping[str, TextColumn]
) -> dict[str, Array]:
    data: dict[str, Array] = {}
    for name, column in zip(wanted, batch.columns):
        if pa.types.is_floating(column.type):
            data[name] = np.array(column.to_numpy(zero_copy_only=False), dtype=np.float64)
        else:
            data[name] = texts[name].numbers([_decoded(v) for v in column.cast(pa.binary()).to_pylist()], rows)
    return data


def _decoded(value: bytes | None) -> str:
    return "" if value is None else value.decode("utf-8", errors="replace").strip().strip('"').strip()


def _named(dialect: Dialect, where: str) -> tuple[str, ...]:
    names = list(dialect.names)
    while len(names) > dialect.fields and not names[-1]:
        names.pop()
    if len(names) > dialect.fields or dialect.fields > len(names) + 1:
        raise InputError(
            f"the header has {len(names)} names but row {dialect.skip + 1} has {dialect.fields} fields",
            where=where,
            expected="one name for each column",
            remedy="decimal commas need semicolons or tabs between columns" if dialect.separator == "," else "",
        )
    return tuple(names + [""] * (dialect.fields - len(names)))


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
