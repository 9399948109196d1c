"""Text tables: every row's fields counted, numbers parsed exactly, clock times and on/off words understood."""

from __future__ import annotations

import io
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import IO, Any

import numpy as np
import pyarrow as pa
from pyarrow import csv as pacsv

from calibration.checks.rows import RowCheck, check_rows
from calibration.errors import InputError
from calibration.files.dialect import ABSENT, HEAD_BYTES, Dialect, is_number, sniff
from calibration.files.table import Columns, FloatArray, RowNumbers
from calibration.files.textcolumn import TextColumn

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

    def read(self, wanted: Sequence[str]) -> Columns:
        """The wanted columns; see ``Columns``."""
        texts = self._texts(wanted)
        rows = self._rows(self.found.blank)  # counts the fields first
        data = _assemble(self._arrow(wanted), wanted, rows, texts)
        notes = [note for column in texts.values() for note in column.judge(self.found.rows)]
        return Columns(data, (*notes, *self.found.notes), rows)

    def chunks(self, wanted: Sequence[str], rows: int = 50_000) -> Iterator[Columns]:
        """The wanted columns piece by piece, about ``rows`` rows each (2 MB of text at most), in bounded memory.

        From the first cell on that is no number where numbers were, every column is read as text, as ``read`` does.
        """
        line = max(len(self.dialect.first_row) * 4, sum(len(cell) + 1 for cell in self.dialect.first_row))
        texts, done, blank = self._texts(wanted), 0, self.found.blank
        for as_text in (False, True):
            skip = done
            try:
                with self.stream() as stream:
                    for batch in self._stream_reader(stream, wanted, max(rows * line, 1 << 16), as_text):
                        part = batch.slice(min(skip, batch.num_rows))
                        skip -= batch.num_rows - part.num_rows
                        if part.num_rows:
                            at = self._rows(blank, done)
                            yield Columns(_assemble(pa.Table.from_batches([part]), wanted, at, texts), (), at)
                            done += part.num_rows
                break
            except pa.ArrowInvalid as problem:
                if as_text:
                    raise _arrow_error(problem, self.where) from None
                for name in wanted:
                    if done and not self._is_text(name):
                        texts[name].clock = False  # numbers so far
        notes = [note for column in texts.values() for note in column.judge(done)]
        if notes or self.found.notes:
            at = self._rows(blank, done)
            yield Columns({name: np.empty(0) for name in wanted}, (*notes, *self.found.notes), at)

    def _texts(self, wanted: Sequence[str]) -> dict[str, TextColumn]:
        return {name: TextColumn(name, self.dialect.decimal, self.where) for name in wanted}

    def _rows(self, blank: tuple[int, ...], done: int = 0) -> RowNumbers:
        first = self.dialect.skip + 1
        passed = RowNumbers(first, blank).of(done) - first - done if done else 0
        return RowNumbers(first + done + passed, blank[passed:])

    def _stream_reader(self, stream: IO[bytes], wanted: Sequence[str], block_bytes: int, as_text: bool) -> Any:
        read, parse, convert = self._options(wanted, as_text)
        # small blocks, none read ahead: the allocators keep some twenty times a block for themselves
        read.block_size, read.use_threads = min(block_bytes, BLOCK_BYTES), False
        return pacsv.open_csv(stream, read_options=read, parse_options=parse, convert_options=convert)

    def _options(self, wanted: Sequence[str], as_text: bool) -> tuple[Any, Any, Any]:
        d = self.dialect
        keys = {f"c{self.names.index(name)}": name for name in wanted}
        types = {k: pa.string() if as_text or self._is_text(n) else pa.float64() for k, n in keys.items()}
        read = pacsv.ReadOptions(skip_rows=d.skip, column_names=[f"c{i}" for i in range(d.fields)], block_size=1 << 22)
        parse = pacsv.ParseOptions(delimiter=d.separator)
        convert = pacsv.ConvertOptions(
            include_columns=list(keys),
            column_types=types,
            decimal_point=d.decimal,
            null_values=_NULLS,
            check_utf8=False,
        )
        return read, parse, convert

    def _is_text(self, name: str) -> bool:
        at = self.names.index(name)
        cell = self.dialect.first_row[at] if at < len(self.dialect.first_row) else ""
        return not is_number(cell, self.dialect.decimal) and cell.lower() not in ABSENT

    def _arrow(self, wanted: Sequence[str]) -> pa.Table:
        for as_text in (False, True):
            read, parse, convert = self._options(wanted, as_text)
            try:
                with self.stream() as stream:
                    return pacsv.read_csv(stream, read_options=read, parse_options=parse, convert_options=convert)
            except pa.ArrowInvalid as problem:
                if as_text:
                    raise _arrow_error(problem, self.where) from None
        raise AssertionError("unreachable")


def _assemble(
    arrow: pa.Table, wanted: Sequence[str], rows: RowNumbers, texts: Mapping[str, TextColumn]
) -> dict[str, FloatArray]:
    data: dict[str, FloatArray] = {}
    for name, key in zip(wanted, arrow.column_names):
        column = arrow.column(key)
        if pa.types.is_floating(column.type):
            data[name] = np.array(column.to_numpy(), dtype=np.float64)
        else:
            data[name] = texts[name].numbers([_decoded(v) for v in column.cast(pa.binary()).to_pylist()], rows)
    return data


def _decoded(value: bytes | None) -> str:
    return "" if value is None else value.decode("utf-8", errors="replace").strip().strip('"').strip()


def _arrow_error(problem: Exception, where: str) -> InputError:
    text = str(problem).splitlines()[0][:160]
    return InputError(f"the table cannot be read ({text})", where=where)


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
