"""Parquet logs: columns of numbers, metadata from the file's key-value pairs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from pyarrow import parquet as pq

from calibration.arrays import Array
from calibration.errors import InputError
from calibration.files.csvtable import TextColumn
from calibration.files.table import PIECE_ROWS, Columns, RowNumbers


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

    def pieces(self, wanted: Sequence[str], rows: int = PIECE_ROWS) -> Iterator[Columns]:
        """The wanted columns piece by piece, in bounded memory."""
        done, seen = 0, dict[str, Any]()
        names = list(dict.fromkeys(wanted))
        try:
            with pq.ParquetFile(self.path) as file:
                for batch in file.iter_batches(rows, columns=names):
                    at = RowNumbers().after(done)
                    yield Columns({n: self._floats(batch.column(n), n, at, seen) for n in names}, (), at)
                    done += batch.num_rows
        except (pa.ArrowException, OSError, ValueError, MemoryError) as problem:
            if isinstance(problem, InputError):
                raise
            raise InputError(f"damaged Parquet ({str(problem).splitlines()[0][:120]})", where=self.where) from None
        findings = tuple(f for column in seen.values() if isinstance(column, TextColumn) for f in column.judge(done))
        if findings:
            yield Columns({n: np.empty(0) for n in names}, findings, RowNumbers().after(done))

    def _floats(self, column: pa.Array, name: str, rows: RowNumbers, seen: dict[str, Any]) -> Array:
        """Numbers of one piece; ``seen`` keeps a column's first time stamp, or its ``TextColumn``, for the next."""
        kind = column.type
        if pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_boolean(kind):
            if pa.types.is_boolean(kind):
                column = column.cast(pa.int8())
            return np.array(column.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False), dtype=np.float64)
        if pa.types.is_timestamp(kind) or pa.types.is_duration(kind):
            stamp = pd.Series(column.to_pandas())
            since = pd.to_timedelta(stamp - seen.setdefault(name, stamp.iloc[0]))
            return np.asarray(since.dt.total_seconds(), dtype=np.float64)
        if pa.types.is_string(kind) or pa.types.is_large_string(kind):
            texts = ["" if v is None else str(v).strip() for v in column.to_pylist()]
            text: TextColumn = seen.setdefault(name, TextColumn(name, ".", self.where))
            return text.numbers(texts, rows)
        raise InputError(f"column {name} holds {kind}, not numbers", where=self.where)
