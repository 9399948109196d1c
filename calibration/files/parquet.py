"""Parquet logs: columns of numbers, metadata from the file's key-value pairs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from pyarrow import parquet as pq

from calibration.errors import InputError
from calibration.files.table import Columns, FloatArray, RowNumbers
from calibration.files.textcolumn import TextColumn


@dataclass
class ParquetTable:
    """A Parquet file; samples are numbered from 1 in errors."""

    path: Path
    where: str
    names: tuple[str, ...] = ()
    metadata: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        try:
            schema = pq.read_schema(self.path)
        except (pa.ArrowException, OSError, ValueError) as problem:
            raise InputError(
                f"not readable as Parquet ({str(problem).splitlines()[0][:120]})", where=self.where
            ) from None
        self.names = tuple(schema.names)
        for key, value in (schema.metadata or {}).items():
            name = key.decode("utf-8", "replace")
            if name not in ("pandas", "ARROW:schema"):
                self.metadata[name] = value.decode("utf-8", "replace")

    def read(self, wanted: Sequence[str]) -> Columns:
        """The wanted columns; see ``Columns``."""
        try:
            table = pq.read_table(self.path, columns=list(dict.fromkeys(wanted)))
        except (pa.ArrowException, OSError, ValueError, MemoryError) as problem:
            raise InputError(f"damaged Parquet ({str(problem).splitlines()[0][:120]})", where=self.where) from None
        if table.num_rows == 0:
            raise InputError("no rows", where=self.where)
        seen: dict[str, Any] = {}
        data = {n: self._floats(table.column(n), n, RowNumbers(), seen) for n in wanted}
        return Columns(data, tuple(_text_notes(seen, table.num_rows)))

    def chunks(self, wanted: Sequence[str], rows: int = 50_000) -> Iterator[Columns]:
        """The wanted columns piece by piece, in bounded memory."""
        first, seen = 1, dict[str, Any]()
        try:
            with pq.ParquetFile(self.path) as file:
                for batch in file.iter_batches(rows, columns=list(dict.fromkeys(wanted))):
                    table, at = pa.Table.from_batches([batch]), RowNumbers(first)
                    yield Columns({n: self._floats(table.column(n), n, at, seen) for n in wanted}, (), at)
                    first += batch.num_rows
        except (pa.ArrowException, OSError) as problem:
            raise InputError(f"damaged Parquet ({str(problem).splitlines()[0][:120]})", where=self.where) from None
        notes = _text_notes(seen, first - 1)
        if notes:
            yield Columns({n: np.empty(0) for n in wanted}, tuple(notes), RowNumbers(first))

    def _floats(self, column: pa.ChunkedArray, name: str, rows: RowNumbers, seen: dict[str, Any]) -> FloatArray:
        """Numbers of one piece; ``seen`` keeps a column's first time stamp, or its ``TextColumn``, for the next."""
        kind = column.type
        if pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_boolean(kind):
            if pa.types.is_boolean(kind):
                column = column.cast(pa.int8())
            return np.array(column.cast(pa.float64(), safe=False).to_numpy(), dtype=np.float64)
        if pa.types.is_timestamp(kind) or pa.types.is_duration(kind):
            stamp = pd.Series(column.to_pandas())
            since = pd.to_timedelta(stamp - seen.setdefault(name, stamp.iloc[0]))
            return np.asarray(since.dt.total_seconds(), dtype=np.float64)
        if pa.types.is_string(kind) or pa.types.is_large_string(kind):
            texts = ["" if v is None else str(v).strip() for v in column.to_pylist()]
            text: TextColumn = seen.setdefault(name, TextColumn(name, ".", self.where))
            return text.numbers(texts, rows)
        raise InputError(f"column {name} holds {kind}, not numbers", where=self.where)


def _text_notes(seen: Mapping[str, Any], rows: int) -> list[str]:
    return [note for column in seen.values() if isinstance(column, TextColumn) for note in column.judge(rows)]
