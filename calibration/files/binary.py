"""TDMS and Parquet logs: columns of numbers, channels that may differ in start and rate, metadata from the file."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from nptdms import TdmsFile
from nptdms.log import log_manager
from pyarrow import parquet as pq

from calibration import Array
from calibration.errors import InputError
from calibration.files.dialect import TextColumn
from calibration.files.table import PIECE_ROWS, Columns, RowNumbers, Track, align

log_manager.set_level(logging.ERROR)

_EPOCH = np.datetime64("2000-01-01", "us")


@dataclass
class TdmsTable:
    """A TDMS file; where it has no channel ``time_s``, one made from the channels' own tracks stands in."""

    path: Path
    where: str
    names: tuple[str, ...] = ()
    metadata: dict[str, str] = field(default_factory=dict)
    made_time: bool = False

    def __post_init__(self) -> None:
        with self._open() as file:
            self._check_size(file)
            channels = [c for group in file.groups() for c in group.channels()]
            names = [str(c.name).strip() for c in channels]
            timed = any("wf_increment" in c.properties for c in channels)
            for owner in (file, *file.groups()):
                for key, value in owner.properties.items():
                    self.metadata.setdefault(str(key)[:200], str(value)[:2000])
        if not names:
            raise InputError("holds no channels", where=self.where, expected="a TDMS log")
        own = "time_s" in names or "time" in names
        self.made_time = timed and not own
        self.names = tuple(["time_s", *names] if self.made_time else names)

    def pieces(self, wanted: Sequence[str], rows: int = PIECE_ROWS) -> Iterator[Columns]:
        """The wanted channels piece by piece, in bounded memory where they share one start, rate and length.

        Channels that differ are read at once and put on one time grid; see ``align``.
        """
        made = self.made_time and "time_s" in wanted
        with self._open() as file:
            channels = {str(c.name).strip(): c for group in file.groups() for c in group.channels()}
            channels = {n: channels[n] for n in wanted if n in channels}
            lengths = {len(c) for c in channels.values()}
            clock = next((n for n in channels if n in ("time_s", "time")), None)
            if clock and len(lengths) > 1:
                raise InputError(
                    f"channels have {min(lengths)} to {max(lengths)} samples beside one column {clock}",
                    where=self.where,
                    expected="channels as long as the time, or a wf_increment on each",
                )
            tracks = {n: self._track(c, 0, 1) for n, c in channels.items()}
            dt_s = next((t.dt_s for t in tracks.values()), None) or 1.0
            if made and not any(t.dt_s for t in tracks.values()):
                raise InputError(
                    "no channel has a time track (wf_increment)",
                    where=self.where,
                    expected="a channel time_s or wf_increment",
                )
            if not clock and len(lengths) + len({t.same_as for t in tracks.values()}) > 2:
                time, data, found = align({n: self._track(c) for n, c in channels.items()}, self.where)
                if made and time is not None:
                    data = {"time_s": time, **data}
                yield from Columns(data, tuple(found)).in_pieces(rows)
                return
            for start in range(0, lengths.pop(), rows):
                part = {n: self._track(c, start, start + rows).values for n, c in channels.items()}
                if made:
                    count = len(next(iter(part.values())))
                    part["time_s"] = np.asarray((start + np.arange(count)) * dt_s, dtype=np.float64)
                yield Columns(part, (), RowNumbers().after(start))

    @contextmanager
    def _open(self) -> Iterator[Any]:
        with open(self.path, "rb") as stream:
            try:
                file = TdmsFile.open(stream)
            except Exception as problem:  # npTDMS raises many kinds on damaged files
                raise self._damaged(problem) from None
            yield file

    def _damaged(self, problem: BaseException) -> InputError:
        text = str(problem).splitlines()[0][:120] if str(problem) else type(problem).__name__
        return InputError(f"not readable as TDMS ({text})", where=self.where, expected="a whole TDMS file")

    def _check_size(self, file: Any) -> None:
        status = getattr(file, "file_status", None)
        if status is not None and status.incomplete_final_segment:
            raise InputError(
                "the last segment is cut: the file is truncated", where=self.where, remedy="copy the file again"
            )
        promised = 0
        for group in file.groups():
            for channel in group.channels():
                size = getattr(channel.data_type, "size", None) or 1
                promised += len(channel) * int(size)
        if promised > 16 * self.path.stat().st_size + 4096:
            raise InputError(
                f"promises {promised} bytes of samples but has {self.path.stat().st_size}: it is damaged",
                where=self.where,
            )

    def _track(self, channel: Any, start: int = 0, stop: int | None = None) -> Track:
        try:
            values, first = channel[start:stop], channel[:1]
            props = channel.properties
        except Exception as problem:  # npTDMS raises many kinds on damaged files
            raise self._damaged(problem) from None
        numbers = _floats(values, first, str(channel.name), self.where)
        try:
            offset = float(props.get("wf_start_offset", 0.0) or 0.0)
            begun = props.get("wf_start_time")
            if begun is not None:
                offset += (np.datetime64(begun, "us") - _EPOCH) / np.timedelta64(1, "us") * 1e-6
            step = float(props.get("wf_increment", 0.0))
        except (TypeError, ValueError) as problem:
            raise InputError(
                f"channel {channel.name}: its time track is damaged ({problem})", where=self.where
            ) from None
        good = np.isfinite(step) and step > 0
        return Track(numbers, offset if np.isfinite(offset) else 0.0, step if good else None)


def _floats(values: Any, first: Any, name: str, where: str) -> Array:
    array = np.asarray(values)
    if np.issubdtype(array.dtype, np.datetime64):
        return np.asarray((array - np.asarray(first)[0]) / np.timedelta64(1, "us") * 1e-6, dtype=np.float64)
    if array.dtype.kind not in "fiub":
        raise InputError(f"channel {name} holds {array.dtype}, not numbers", where=where)
    if len(array) == 0:
        raise InputError(f"channel {name} is empty", where=where)
    return np.asarray(array, dtype=np.float64)


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
