"""TDMS and Parquet logs: columns of numbers, channels that may differ in start and rate, metadata from the file."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
from nptdms import TdmsFile
from nptdms.log import log_manager
from numpy.typing import NDArray
from pyarrow import parquet as pq

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import SampleLocation
from tcdyn.io.csv_dialect import TextColumn
from tcdyn.io.table import PIECE_ROWS, Columns, Table, Track, align, in_pieces

log_manager.set_level(logging.ERROR)

# of a Parquet file unpacked: times its size, beyond 1 GB
MOST_TIMES = 200
FREE_BYTES = 1 << 30
LONGEST_CELL = 1000

_EPOCH = np.datetime64("2000-01-01", "us")


def tdms_table(path: Path, where: str) -> Table:
    """The table of a TDMS file; where it has no channel ``time_s``, one made from the channels' own tracks is there."""
    metadata: dict[str, str] = {}
    with _opened(path, where) as file:
        _check_size(file, path, where)
        channels = [c for group in file.groups() for c in group.channels()]
        names = [str(c.name).strip() for c in channels]
        made = not {"time_s", "time"} & set(names) and any(
            "wf_increment" in c.properties for c in channels
        )
        for owner in (file, *file.groups()):
            for key, value in owner.properties.items():
                metadata.setdefault(str(key)[:200], str(value)[:2000])
    if not names:
        raise InputError("holds no channels", where=where, expected="a TDMS log")
    return Table(
        where,
        tuple(["time_s", *names] if made else names),
        metadata,
        partial(_tdms_pieces, path, where, made),
    )


def _tdms_pieces(
    path: Path, where: str, made_time: bool, wanted: Sequence[str], rows: int = PIECE_ROWS
) -> Iterator[Columns]:
    """The wanted channels piece by piece, in bounded memory where they share one start, rate and length.

    Channels that differ are read at once and put on one time grid; see ``align``.
    """
    made = made_time and "time_s" in wanted
    with _opened(path, where) as file:
        channels = {str(c.name).strip(): c for group in file.groups() for c in group.channels()}
        channels = {n: channels[n] for n in wanted if n in channels}
        lengths = {len(c) for c in channels.values()}
        clock = next((n for n in channels if n in ("time_s", "time")), None)
        if clock and len(lengths) > 1:
            raise InputError(
                f"channels have {min(lengths)} to {max(lengths)} samples beside one column {clock}",
                where=where,
                expected="channels as long as the time, or a wf_increment on each",
            )
        tracks = {n: _track(c, where, 0, 1) for n, c in channels.items()}
        dt_s = next((t.dt_s for t in tracks.values()), None) or 1.0
        if made and not any(t.dt_s for t in tracks.values()):
            raise InputError(
                "no channel has a time track (wf_increment)",
                where=where,
                expected="a channel time_s or wf_increment",
            )
        if not clock and len(lengths) + len({t.same_as for t in tracks.values()}) > 2:
            time, data, found = align({n: _track(c, where) for n, c in channels.items()}, where)
            if made and time is not None:
                data = {"time_s": time, **data}
            yield from in_pieces(
                Columns(data, SampleLocation(where), tuple(found)), list(data), rows
            )
            return
        for start in range(0, lengths.pop(), rows):
            part = {n: _track(c, where, start, start + rows).values for n, c in channels.items()}
            if made:
                count = len(next(iter(part.values())))
                part["time_s"] = np.asarray((start + np.arange(count)) * dt_s, dtype=np.float64)
            clocks = {n: c for n, c in channels.items() if np.issubdtype(c.dtype, np.datetime64)}
            stamps = {
                n: np.asarray(c[start : start + rows]).astype(str).astype(object)
                for n, c in clocks.items()
            }
            yield Columns(part, SampleLocation(where), (), stamps)


@contextmanager
def _opened(path: Path, where: str) -> Iterator[Any]:
    with open(path, "rb") as stream:
        try:
            file = TdmsFile.open(stream)
        except Exception as problem:  # npTDMS raises many kinds on damaged files
            raise _damaged(problem, where) from None
        yield file


def _damaged(problem: BaseException, where: str) -> InputError:
    text = str(problem).splitlines()[0][:120] if str(problem) else type(problem).__name__
    return InputError(f"not readable as TDMS ({text})", where=where, expected="a whole TDMS file")


def _check_size(file: Any, path: Path, where: str) -> None:
    status = getattr(file, "file_status", None)
    if status is not None and status.incomplete_final_segment:
        raise InputError(
            "the last segment is cut: the file is truncated",
            where=where,
            remedy="copy the file again",
        )
    channels = [c for group in file.groups() for c in group.channels()]
    promised = sum(len(c) * int(getattr(c.data_type, "size", None) or 1) for c in channels)
    if promised > 16 * path.stat().st_size + 4096:
        raise InputError(
            f"promises {promised} bytes of samples but has {path.stat().st_size}: it is damaged",
            where=where,
        )


def _track(channel: Any, where: str, start: int = 0, stop: int | None = None) -> Track:
    try:
        values = channel[start:stop]
        first = channel[:1]
        props = channel.properties
    except Exception as problem:  # npTDMS raises many kinds on damaged files
        raise _damaged(problem, where) from None
    numbers = _floats(values, first, str(channel.name), where)
    try:
        offset = float(props.get("wf_start_offset", 0.0) or 0.0)
        begun = props.get("wf_start_time")
        if begun is not None:
            offset += (np.datetime64(begun, "us") - _EPOCH) / np.timedelta64(1, "us") * 1e-6
        step = float(props.get("wf_increment", 0.0))
    except (TypeError, ValueError) as problem:
        raise InputError(
            f"channel {channel.name}: its time track is damaged ({problem})", where=where
        ) from None
    good = np.isfinite(step) and step > 0
    return Track(numbers, offset if np.isfinite(offset) else 0.0, step if good else None)


def _floats(values: Any, first: Any, name: str, where: str) -> Array:
    array = np.asarray(values)
    if np.issubdtype(array.dtype, np.datetime64):
        return np.asarray(
            (array - np.asarray(first)[0]) / np.timedelta64(1, "us") * 1e-6, dtype=np.float64
        )
    if array.dtype.kind not in "fiub":
        raise InputError(f"channel {name} holds {array.dtype}, not numbers", where=where)
    if len(array) == 0:
        raise InputError(f"channel {name} is empty", where=where)
    return np.asarray(array, dtype=np.float64)


def parquet_table(path: Path, where: str) -> Table:
    """The table of a Parquet file; samples are numbered from 1 in errors."""
    try:
        with pq.ParquetFile(path) as file:
            schema = file.schema_arrow
            rows = file.metadata.num_rows
    except (pa.ArrowException, OSError, ValueError) as problem:
        raise InputError(
            f"not readable as Parquet ({str(problem).splitlines()[0][:120]})", where=where
        ) from None
    unpacked = 8 * rows * len(schema.names)
    size = path.stat().st_size
    if unpacked > FREE_BYTES + MOST_TIMES * size:
        raise InputError(
            f"promises {rows} rows of {len(schema.names)} columns, {unpacked / 1e9:.3g} GB, in {size} bytes",
            where=where,
            expected=f"at most {MOST_TIMES} times the file's size where it is more than {FREE_BYTES / 1e9:.2g} GB",
        )
    said = {
        k.decode("utf-8", "replace"): v.decode("utf-8", "replace")
        for k, v in (schema.metadata or {}).items()
    }
    metadata = {k: v for k, v in said.items() if k not in ("pandas", "ARROW:schema")}
    return Table(where, tuple(schema.names), metadata, partial(_parquet_pieces, path, where))


def _parquet_pieces(
    path: Path, where: str, wanted: Sequence[str], rows: int = PIECE_ROWS
) -> Iterator[Columns]:
    """The wanted columns piece by piece, in bounded memory."""
    done = 0
    texts = dict[str, TextColumn]()
    begun = dict[str, Any]()
    names = list(dict.fromkeys(wanted))
    place = SampleLocation(where)
    try:
        with pq.ParquetFile(
            path, read_dictionary=names
        ) as file:  # text by its different cells: repeats take no room
            for batch in file.iter_batches(rows, columns=names):
                data: dict[str, Array] = {}
                stamps: dict[str, NDArray[Any]] = {}
                for n in names:
                    column = batch.column(n)
                    if pa.types.is_dictionary(column.type):
                        longest = pc.max(pc.binary_length(column.dictionary)).as_py() or 0
                        if longest > LONGEST_CELL and pa.types.is_string(column.type.value_type):
                            expected = f"at most {LONGEST_CELL}"
                            raise InputError(
                                f"column {n} has a cell of {longest} bytes",
                                where=where,
                                expected=expected,
                            )
                        column = column.dictionary_decode()
                    kind = column.type
                    if pa.types.is_boolean(kind):
                        column = column.cast(pa.int8())
                    if (
                        pa.types.is_floating(kind)
                        or pa.types.is_integer(kind)
                        or pa.types.is_boolean(kind)
                    ):
                        numbers = column.cast(pa.float64(), safe=False).to_numpy(
                            zero_copy_only=False
                        )
                        data[n] = np.array(numbers, dtype=np.float64)
                    elif pa.types.is_timestamp(kind) or pa.types.is_duration(kind):
                        stamp = pd.Series(column.to_pandas())
                        stamps[n] = stamp.astype(str).to_numpy(dtype=object)
                        since = pd.to_timedelta(stamp - begun.setdefault(n, stamp.iloc[0]))
                        data[n] = np.asarray(since.dt.total_seconds(), dtype=np.float64)
                    elif pa.types.is_string(kind) or pa.types.is_large_string(kind):
                        cells = ["" if v is None else str(v).strip() for v in column.to_pylist()]
                        data[n] = texts.setdefault(n, TextColumn(n, ".", place)).numbers(
                            cells, done
                        )
                        if texts[n].clock:
                            stamps[n] = np.array(cells, dtype=object)
                    else:
                        raise InputError(f"column {n} holds {kind}, not numbers", where=where)
                yield Columns(data, place, (), stamps)
                done += batch.num_rows
    except InputError:
        raise
    except (pa.ArrowException, OSError, ValueError, MemoryError) as problem:
        raise InputError(
            f"damaged Parquet ({str(problem).splitlines()[0][:120]})", where=where
        ) from None
    if found := [f for column in texts.values() for f in column.judge(done)]:
        yield Columns({n: np.empty(0) for n in names}, place, tuple(found))
