"""TDMS and Parquet logs as tables; TDMS channels may differ in start and rate.

Used by :mod:`tcdyn.io.read`, which imports this module only for such files. Tables are read in
chunks of bounded memory; damaged files give an ``InputError`` and never a wrong number. The limits
below protect against damaged and malicious files. Guarded by ``tests/io/test_file_formats.py`` and
``tests/io/test_read_back.py``.
"""

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
from tcdyn.core.findings import Finding, SampleLocation
from tcdyn.io.cells import TextColumn
from tcdyn.io.metadata import START_TIME_KEY
from tcdyn.io.table import CHUNK_ROWS, Columns, Table, Track, align, in_chunks

log_manager.set_level(logging.ERROR)

# a Parquet file may unpack to this many times its size, beyond the free bytes (against damaged or
# malicious files; chosen by judgement)
UNPACKED_RATIO = 200
FREE_BYTES = 1 << 30
LONGEST_CELL = 1000  # bytes of a text cell; chosen by judgement
TIME_NAMES = ("time_s", "time")  # a channel of such a name is the time

# start times of channels count from here: only their differences matter
_EPOCH = np.datetime64("2000-01-01", "us")


def tdms_table(path: Path, where: str) -> Table:
    """The table of a TDMS file.

    If it has no channel ``time_s`` but the channels have time tracks, ``time_s`` is made from them.

    Parameters
    ----------
    path
        The file.
    where
        The file, for messages.

    Raises
    ------
    InputError
        If the file is damaged or truncated, or holds no channels.
    """
    metadata: dict[str, str] = {}
    with _open_tdms(path, where) as file:
        _check_size(file, path, where)
        channels = _channels_by_name(file)
        names = list(channels)
        has_tracks = any("wf_increment" in c.properties for c in channels.values())
        clocks = [n for n, c in channels.items() if np.issubdtype(c.dtype, np.datetime64)]
        start = _start_time(list(channels.values()))
        for owner in (file, *file.groups()):
            for key, value in owner.properties.items():
                metadata.setdefault(str(key)[:200], str(value)[:2000])
    if not names:
        raise InputError("holds no channels", where=where, expected="a TDMS log")
    make_time = has_tracks and not any(name in names for name in TIME_NAMES)
    if make_time and start:
        metadata.setdefault(START_TIME_KEY, start)
    all_names = ["time_s", *names] if make_time else names
    chunks = partial(_tdms_chunks, path, where, make_time)
    return Table(where, tuple(all_names), metadata, chunks, clock_columns=tuple(clocks))


def _start_time(channels: Sequence[Any]) -> str:
    """Instant at which all channels have begun, in ISO 8601; empty if no time track states it.

    TDMS states instants in UTC.
    """
    starts: list[pd.Timestamp] = []
    for channel in channels:
        offset_s = channel.properties.get("wf_start_offset", 0.0) or 0.0
        try:
            start = pd.Timestamp(channel.properties.get("wf_start_time"))
            start += pd.Timedelta(float(offset_s), "s")
        except (TypeError, ValueError, OverflowError):  # reported when the channel is read
            continue
        if not pd.isna(start):
            starts.append(start)
    return f"{max(starts).isoformat()}+00:00" if starts else ""


def _channels(file: Any) -> list[Any]:
    """All channels of all groups of an open TDMS file."""
    return [channel for group in file.groups() for channel in group.channels()]


def _channels_by_name(file: Any) -> dict[str, Any]:
    """The channels by name; group/name where several groups have a channel of one name."""
    channels = _channels(file)
    names = [str(channel.name).strip() for channel in channels]
    by_name = {}
    for name, channel in zip(names, channels):
        unique = name if names.count(name) == 1 else f"{str(channel.group_name).strip()}/{name}"
        by_name[unique] = channel
    return by_name


def _tdms_chunks(
    path: Path, where: str, make_time: bool, requested: Sequence[str], rows: int = CHUNK_ROWS
) -> Iterator[Columns]:
    """Yield the wanted channels in chunks.

    Memory is bounded if they share one start, rate and length. Channels that differ are read at
    once and put on one time grid; see ``tcdyn.io.table.align``.

    Parameters
    ----------
    path, where
        The file, and its name for messages.
    make_time
        Whether ``time_s`` is made from the time tracks.
    requested
        Names of the channels.
    rows
        Number of rows in a chunk.

    Raises
    ------
    InputError
        For channels of different length beside a time column, without a time track where one is
        needed, or damaged.
    """
    add_time = make_time and "time_s" in requested
    with _open_tdms(path, where) as file:
        by_name = _channels_by_name(file)
        channels = {name: by_name[name] for name in requested if name in by_name}
        lengths = {len(channel) for channel in channels.values()}
        clock = next((name for name in channels if name in TIME_NAMES), None)
        if clock and len(lengths) > 1:
            raise InputError(
                f"channels have {min(lengths)} to {max(lengths)} samples beside one column {clock}",
                where=where,
                expected="channels as long as the time, or a wf_increment on each",
            )
        first_samples = {}
        for name, channel in channels.items():
            if not _is_text(channel):
                first_samples[name] = _read_track(channel, where, 0, 1)
        intervals_s = [track.dt_s for track in first_samples.values()]
        if add_time and not any(intervals_s):
            raise InputError(
                "no channel has a time track (wf_increment)",
                where=where,
                expected="a channel time_s or wf_increment",
            )
        timings = {track.timing for track in first_samples.values()}
        if not clock and (len(lengths) > 1 or len(timings) > 1):
            aligned = _aligned_channels(channels, add_time, where)
            yield from in_chunks(aligned, list(aligned.data), rows)
            return
        dt_s = (intervals_s[0] if intervals_s else None) or 1.0
        for start in range(0, lengths.pop(), rows):
            yield _rows_of_chunk(
                channels, where, slice(start, start + rows), dt_s if add_time else None
            )


def _aligned_channels(channels: dict[str, Any], add_time: bool, where: str) -> Columns:
    """Complete channels on one time grid.

    Parameters
    ----------
    channels
        Channels by name.
    add_time
        Whether to add the column ``time_s``.
    where
        The file, for messages.
    """
    tracks = {name: _read_track(channel, where) for name, channel in channels.items()}
    time_s, data, findings = align(tracks, where)
    if add_time and time_s is not None:
        data = {"time_s": time_s, **data}
    return Columns(data, SampleLocation(where), tuple(findings))


def _rows_of_chunk(
    channels: dict[str, Any], where: str, rows: slice, dt_s: float | None
) -> Columns:
    """The rows of one chunk.

    Parameters
    ----------
    channels
        Channels by name, of one start, rate and length.
    where
        The file, for messages.
    rows
        The rows.
    dt_s
        Sampling interval [s] from which a column ``time_s`` is made; None for no such column.
    """
    data = {}
    stamps = {}
    for name, channel in channels.items():
        if _is_text(channel):
            cells = np.asarray(channel[rows])
            stamps[name] = np.array([str(cell) for cell in cells], dtype=object)
            data[name] = np.full(len(cells), np.nan)
            continue
        data[name] = _read_track(channel, where, rows.start, rows.stop).values
        if np.issubdtype(channel.dtype, np.datetime64):
            stamps[name] = np.asarray(channel[rows]).astype(str).astype(object)
    if dt_s is not None:
        count = len(next(iter(data.values())))
        data["time_s"] = (rows.start + np.arange(count)) * dt_s
    return Columns(data, SampleLocation(where), (), stamps)


def _is_text(channel: Any) -> bool:
    """Whether a channel holds words, such as a comment for each sample."""
    return channel.dtype is not None and np.dtype(channel.dtype).kind in "OSU"


@contextmanager
def _open_tdms(path: Path, where: str) -> Iterator[Any]:
    """Open a TDMS file; InputError if it cannot be read as one."""
    with open(path, "rb") as stream:
        try:
            file = TdmsFile.open(stream)
        except Exception as problem:  # npTDMS raises many kinds on damaged files
            raise _damaged_file_error(problem, where) from None
        yield file


def _damaged_file_error(problem: BaseException, where: str) -> InputError:
    """Error for a TDMS file that npTDMS cannot read, with its reason."""
    text = str(problem).splitlines()[0][:120] if str(problem) else type(problem).__name__
    return InputError(
        f"not readable as TDMS ({text})", where=where, expected="a complete TDMS file"
    )


def _check_size(file: Any, path: Path, where: str) -> None:
    """Check that a TDMS file is complete and does not state more samples than it can hold.

    Parameters
    ----------
    file
        The open file.
    path, where
        Its path, and its name for messages.

    Raises
    ------
    InputError
        If the last segment is cut, or the samples need more than 16 times the bytes of the file
        (chosen by judgement).
    """
    status = getattr(file, "file_status", None)
    if status is not None and status.incomplete_final_segment:
        raise InputError(
            "the last segment is cut: the file is truncated",
            where=where,
            remedy="copy the file again",
        )
    promised = 0
    for channel in _channels(file):
        promised += len(channel) * int(getattr(channel.data_type, "size", None) or 1)
    if promised > 16 * path.stat().st_size + 4096:
        raise InputError(
            f"promises {promised} bytes of samples but has {path.stat().st_size}: it is damaged",
            where=where,
        )


def _read_track(channel: Any, where: str, start: int = 0, stop: int | None = None) -> Track:
    """Read samples of a channel with its start and interval.

    Parameters
    ----------
    channel
        Channel of npTDMS.
    where
        The file, for messages.
    start, stop
        First sample, and one past the last; all samples without ``stop``.

    Returns
    -------
    Track
        Its start is ``wf_start_time`` since 2000 plus ``wf_start_offset`` [s], 0 if that is not
        finite. Its interval is None unless ``wf_increment`` is finite and positive.

    Raises
    ------
    InputError
        For a damaged channel or time track.
    """
    try:
        values = channel[start:stop]
        first = channel[:1]
        properties = channel.properties
    except Exception as problem:  # npTDMS raises many kinds on damaged files
        raise _damaged_file_error(problem, where) from None
    numbers = _as_floats(values, first, str(channel.name), where)
    try:
        offset = float(properties.get("wf_start_offset", 0.0) or 0.0)
        start_time = properties.get("wf_start_time")
        if start_time is not None:
            offset += (np.datetime64(start_time, "us") - _EPOCH) / np.timedelta64(1, "us") * 1e-6
        interval = float(properties.get("wf_increment", 0.0))
    except (TypeError, ValueError) as problem:
        raise InputError(
            f"channel {channel.name}: its time track is damaged ({problem})", where=where
        ) from None
    start_s = offset if np.isfinite(offset) else 0.0
    has_interval = np.isfinite(interval) and interval > 0
    return Track(numbers, start_s, interval if has_interval else None)


def _as_floats(values: Any, first: Any, name: str, where: str) -> Array:
    """Samples as float64; time stamps as seconds since the first.

    Parameters
    ----------
    values
        The samples.
    first
        The first sample of the channel, as an array of one.
    name, where
        Channel and file, for messages.

    Raises
    ------
    InputError
        For a channel that holds no numbers or is empty.
    """
    samples = np.asarray(values)
    if np.issubdtype(samples.dtype, np.datetime64):
        since_first = samples - np.asarray(first)[0]
        return np.asarray(since_first / np.timedelta64(1, "us") * 1e-6, dtype=np.float64)
    if samples.dtype.kind not in "fiub":
        raise InputError(f"channel {name} holds {samples.dtype}, not numbers", where=where)
    if len(samples) == 0:
        raise InputError(f"channel {name} is empty", where=where)
    return np.asarray(samples, dtype=np.float64)


def parquet_table(path: Path, where: str) -> Table:
    """The table of a Parquet file; messages count its rows from 1.

    Parameters
    ----------
    path
        The file.
    where
        The file, for messages.

    Raises
    ------
    InputError
        If the file is damaged, or states more rows than its size makes plausible: more than
        ``FREE_BYTES`` and ``UNPACKED_RATIO`` times its size.
    """
    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            schema = file.schema_arrow
            rows = file.metadata.num_rows
    except (pa.ArrowException, OSError, ValueError) as problem:
        raise InputError(
            f"not readable as Parquet ({str(problem).splitlines()[0][:120]})", where=where
        ) from None
    unpacked = 8 * rows * len(schema.names)
    size = path.stat().st_size
    if unpacked > FREE_BYTES + UNPACKED_RATIO * size:
        raise InputError(
            f"promises {rows} rows of {len(schema.names)} columns, {unpacked / 1e9:.3g} GB, in "
            f"{size} bytes",
            where=where,
            expected=f"at most {UNPACKED_RATIO} times the file's size where it is more than "
            f"{FREE_BYTES / 1e9:.2g} GB",
        )
    if rows == 0:
        raise InputError("no rows", where=where)
    metadata = {}
    for key, value in (schema.metadata or {}).items():
        name = key.decode("utf-8", "replace")
        if name not in ("pandas", "ARROW:schema"):
            metadata[name] = value.decode("utf-8", "replace")
    types = {}
    for column in schema:
        if pa.types.is_timestamp(column.type) or pa.types.is_duration(column.type):
            types[column.name] = column.type
    chunks = partial(_parquet_chunks, path, where)
    clocks = tuple(f.name for f in schema if pa.types.is_timestamp(f.type))
    return Table(where, tuple(schema.names), metadata, chunks, clock_columns=clocks, types=types)


def _parquet_chunks(
    path: Path, where: str, requested: Sequence[str], rows: int = CHUNK_ROWS
) -> Iterator[Columns]:
    """Yield the wanted columns in chunks, in bounded memory.

    Parameters
    ----------
    path, where
        The file, and its name for messages.
    requested
        Names of the columns.
    rows
        Number of rows in a chunk.

    Raises
    ------
    InputError
        For a damaged file or a column that holds no numbers.
    """
    names = list(dict.fromkeys(requested))
    reader = _ParquetReader(where)
    try:
        with pq.ParquetFile(path) as file:
            schema = file.schema_arrow
        for name in names:
            if pa.types.is_nested(schema.field(name).type):
                raise reader.no_numbers(name, schema.field(name).type)
        # dictionaries: repeated texts take no memory
        with pq.ParquetFile(path, read_dictionary=names, page_checksum_verification=True) as file:
            for batch in file.iter_batches(rows, columns=names):
                yield reader.columns(batch, names)
    except InputError:
        raise
    except (pa.ArrowException, OSError, ValueError, MemoryError) as problem:
        raise InputError(
            f"damaged Parquet ({str(problem).splitlines()[0][:120]})", where=where
        ) from None
    findings = reader.findings()
    if findings:
        yield Columns({name: np.empty(0) for name in names}, reader.location, tuple(findings))


class _ParquetReader:
    """Converts batches of a Parquet file; text and time columns keep a state between batches."""

    def __init__(self, where: str) -> None:
        """Start before the first row of the file ``where``."""
        self.where = where
        self.location = SampleLocation(where)
        self.rows_done = 0
        self.text_columns: dict[str, TextColumn] = {}
        self.first_times: dict[str, Any] = {}

    def columns(self, batch: pa.RecordBatch, names: Sequence[str]) -> Columns:
        """The columns of one batch as numbers.

        Booleans become 0 and 1, time stamps seconds since the first one, texts what
        ``tcdyn.io.cells.TextColumn`` makes of them.

        Parameters
        ----------
        batch
            The batch; batches must come in their order.
        names
            Names of the columns.

        Raises
        ------
        InputError
            For a column of another type.
        """
        data: dict[str, Array] = {}
        stamps: dict[str, NDArray[Any]] = {}
        for name in names:
            column = self._without_dictionary(batch.column(name), name)
            kind = column.type
            if pa.types.is_boolean(kind):
                column = column.cast(pa.int8())
                kind = column.type
            if pa.types.is_floating(kind) or pa.types.is_integer(kind):
                numbers = column.cast(pa.float64(), safe=False)
                data[name] = np.array(numbers.to_numpy(zero_copy_only=False), dtype=np.float64)
            elif pa.types.is_timestamp(kind) or pa.types.is_duration(kind):
                times = pd.Series(column.to_pandas())
                stamps[name] = times.astype(str).to_numpy(dtype=object)
                first = self.first_times.setdefault(name, times.iloc[0])
                since_first = pd.to_timedelta(times - first)
                data[name] = np.asarray(since_first.dt.total_seconds(), dtype=np.float64)
            elif pa.types.is_string(kind) or pa.types.is_large_string(kind):
                cells = ["" if v is None else str(v).strip() for v in column.to_pylist()]
                if name not in self.text_columns:
                    self.text_columns[name] = TextColumn(name, ".", self.location)
                text_column = self.text_columns[name]
                data[name] = text_column.numbers(cells, self.rows_done)
                if text_column.clock or text_column.words:
                    stamps[name] = np.array(cells, dtype=object)
            else:
                raise self.no_numbers(name, kind)
        self.rows_done += batch.num_rows
        return Columns(data, self.location, (), stamps)

    def no_numbers(self, name: str, kind: pa.DataType) -> InputError:
        """The error for a column of a type that is neither numbers nor text."""
        return InputError(f"column {name} holds {kind}, not numbers", where=self.where)

    def findings(self) -> list[Finding]:
        """Findings about the text columns; InputError for a column with too few numbers."""
        columns = self.text_columns.values()
        return [finding for column in columns for finding in column.findings(self.rows_done)]

    def _without_dictionary(self, column: pa.Array, name: str) -> pa.Array:
        """The column with plain cells; InputError for a text cell longer than ``LONGEST_CELL``."""
        if not pa.types.is_dictionary(column.type):
            return column
        longest = pc.max(pc.binary_length(column.dictionary)).as_py() or 0
        if longest > LONGEST_CELL and pa.types.is_string(column.type.value_type):
            raise InputError(
                f"column {name} has a cell of {longest} bytes",
                where=self.where,
                expected=f"at most {LONGEST_CELL}",
            )
        return column.dictionary_decode()
