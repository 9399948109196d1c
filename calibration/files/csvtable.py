"""Text tables: every row's fields counted, numbers parsed exactly, clock times and on/off words understood."""

from __future__ import annotations

import io
import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import IO, Any

import numpy as np
import pyarrow as pa
from pyarrow import csv as pacsv

from calibration import Array
from calibration.errors import InputError
from calibration.files.dialect import ABSENT, HEAD_BYTES, Dialect, TextColumn, is_number, sniff
from calibration.files.table import PIECE_ROWS, Columns, RowNumbers
from calibration.finding import Finding, look

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
        return cls(path, where, dialect, dialect.columns(where), dialect.metadata, body)

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
        texts: dict[str, TextColumn] = {}
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
                            yield Columns(self._numbers(part, wanted, at, texts), (), at)
                            done += part.num_rows
                break
            except pa.ArrowInvalid as problem:
                if as_text:
                    text = str(problem).splitlines()[0][:160]
                    raise InputError(f"the table cannot be read ({text})", where=self.where) from None
                for name in wanted:
                    if done and not self._is_text(name):  # numbers so far: no clock
                        texts[name] = TextColumn(name, self.dialect.decimal, self.where, clock=False)
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
        self, batch: pa.RecordBatch, wanted: Sequence[str], rows: RowNumbers, texts: dict[str, TextColumn]
    ) -> dict[str, Array]:
        data: dict[str, Array] = {}
        for name, column in zip(wanted, batch.columns):
            if pa.types.is_floating(column.type):
                data[name] = np.array(column.to_numpy(zero_copy_only=False), dtype=np.float64)
                continue
            if name not in texts:
                texts[name] = TextColumn(name, self.dialect.decimal, self.where)
            data[name] = texts[name].numbers([_decoded(v) for v in column.cast(pa.binary()).to_pylist()], rows)
        return data


def _decoded(value: bytes | None) -> str:
    return "" if value is None else value.decode("utf-8", errors="replace").strip().strip('"').strip()


@dataclass(frozen=True)
class RowCheck:
    """How many rows of data there are, which lines are blank, what was noticed."""

    rows: int
    blank: tuple[int, ...]
    findings: tuple[Finding, ...]


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
    whole = line.endswith((b"\n", b"\r"))
    last = dialect.skip + rows + len(blank)
    return RowCheck(rows, tuple(blank), () if whole else (look("text.no_line_end", row=last),))


def _row_error(row: tuple[int, int], fields: int, where: str) -> InputError:
    return InputError(
        f"row {row[0]} has {row[1]} fields",
        where=where,
        expected=f"{fields} as in the first row",
        remedy="repair or delete that row",
    )
