"""Result of every reader: named columns of numbers in chunks, on one time grid.

Used by all readers of this package, by ``tcdyn.rig.log`` and ``tcdyn.sensors``. ``align`` puts
channels of different starts and rates on one grid; guarded by ``tests/io/test_file_formats.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from tcdyn.core import Array
from tcdyn.core.errors import InputError, utf8
from tcdyn.core.findings import Finding, SampleLocation, warning
from tcdyn.io.times import is_time_name, split_unit

CHUNK_ROWS = 50_000  # rows of a chunk: memory; chosen by judgement
# samples: starts of channels closer than this are equal (time stamps have microseconds)
SAME_START = 1e-3
LEVEL_SAMPLES = 100_000  # samples that decide whether a channel has two levels only (time)


@dataclass(frozen=True)
class Columns:
    """Columns of a log, or of a chunk of it.

    Attributes
    ----------
    data
        Columns (N,) by name, NaN where the file has no number.
    location
        Location of the samples of the complete file.
    findings
        What was corrected while reading.
    stamps
        Cells (N,) of columns with clock stamps or other text as in the file. The ``data`` of stamps
        are seconds since the first one, those of other text are NaN.
    """

    data: dict[str, Array]
    location: SampleLocation
    findings: tuple[Finding, ...] = ()
    stamps: dict[str, NDArray[Any]] = field(default_factory=dict)


@dataclass(frozen=True)
class SourceFile:
    """One of the files of a log.

    Attributes
    ----------
    path
        The file.
    sha256
        SHA-256 of its bytes.
    first_row
        Row of the log that is its first, from 1 below the header; 0 where the log has not all rows
        of its files.
    rows
        Number of its rows.
    """

    path: Path
    sha256: str
    first_row: int
    rows: int

    @property
    def file(self) -> str:
        """Its name, without the folder."""
        return utf8(self.path.name)

    def to_dict(self) -> dict[str, Any]:
        """Name, checksum, first row and number of rows as plain data."""
        return {
            "file": self.file,
            "sha256": self.sha256,
            "first_row": self.first_row,
            "rows": self.rows,
        }


@dataclass(frozen=True)
class Table:
    """An open log.

    Attributes
    ----------
    where
        The file, for messages.
    names
        Names of the columns as in the file.
    metadata
        Keys and values that the file states about itself.
    chunks
        Function of names of columns and a number of rows; yields these columns in chunks of about
        so many rows. It can be called several times. Of several clocks the first one of the names
        is the time; others that cannot be read are text.
    units
        Units by column, from a row below the header.
    clock_columns
        Columns whose first cell is a clock time, those with a date first.
    types
        Types of the columns of instants and durations of a Parquet file, by column.
    date_columns
        Columns whose first cell is a date without a time.
    cells
        Cells (N,) of the columns of text of a table in memory, as they are.
    sources
        The files, where the log has several.
    """

    where: str
    names: tuple[str, ...]
    metadata: dict[str, str]
    chunks: Callable[[Sequence[str], int], Iterator[Columns]]
    units: Mapping[str, str] = field(default_factory=dict, kw_only=True)
    clock_columns: tuple[str, ...] = field(default=(), kw_only=True)
    types: Mapping[str, pa.DataType] = field(default_factory=dict, kw_only=True)
    date_columns: tuple[str, ...] = field(default=(), kw_only=True)
    cells: Mapping[str, NDArray[Any]] = field(default_factory=dict, kw_only=True)
    sources: tuple[SourceFile, ...] = field(default=(), kw_only=True)

    def place(self, row: int) -> tuple[str, int]:
        """File and row in it of a row of the log, from 1; no name where the log is one file."""
        for source in reversed(self.sources):
            if 0 < source.first_row <= row:
                return source.file, row - source.first_row + 1
        return "", row

    def row_text(self, row: int) -> str:
        """A row below the header, from 1, as messages name it.

        >>> Table("log.csv", ("t",), {}, lambda *_: iter(())).row_text(3)
        'row 3 below the header'
        """
        file, row_in_file = self.place(row)
        return f"row {row_in_file} below the header" + (f" of {file}" if file else "")

    def at_files(self, findings: Iterable[Finding]) -> list[Finding]:
        """The findings; one about a row below the header of several files names its file."""
        placed = []
        for finding in findings:
            row = finding.numbers.get("row")
            # readers of files state their rows themselves
            is_of_log = finding.code.startswith("series.") and not finding.where
            file, row_in_file = self.place(row) if is_of_log and isinstance(row, int) else ("", 0)
            if file:
                numbers = {**finding.numbers, "row": row_in_file}
                finding = replace(finding, where=file, numbers=numbers)
            placed.append(finding)
        return placed

    def is_time(self, name: str) -> bool:
        """Whether a column holds dates, clock times or a time by its name (not "T" alone)."""
        is_clock = name in self.clock_columns or name in self.date_columns or name in self.types
        name_without_unit = split_unit(name)[0]
        return is_clock or (len(name_without_unit) > 1 and is_time_name(name))


def in_chunks(
    columns: Columns, requested: Sequence[str], rows: int = CHUNK_ROWS
) -> Iterator[Columns]:
    """Yield columns that are read already in chunks; findings come with the first.

    Parameters
    ----------
    columns
        The columns.
    requested
        Names of the columns.
    rows
        Number of rows in a chunk.
    """
    count = len(next(iter(columns.data.values())))
    for start in range(0, count, rows):
        chunk = slice(start, start + rows)
        data = {name: columns.data[name][chunk] for name in requested}
        stamps = {name: cells[chunk] for name, cells in columns.stamps.items() if name in requested}
        findings = columns.findings if start == 0 else ()
        yield Columns(data, columns.location, findings, stamps)


def read_all_rows(table: Table, requested: Sequence[str]) -> Columns:
    """Columns of the complete file.

    Parameters
    ----------
    table
        The open log.
    requested
        Names of the columns.
    """
    chunks = list(table.chunks(requested, CHUNK_ROWS))
    location = chunks[0].location if chunks else SampleLocation(table.where)
    return concatenate_columns(chunks, requested, location)


def concatenate_columns(
    chunks: Sequence[Columns], requested: Sequence[str], location: SampleLocation
) -> Columns:
    """Columns of all chunks, one after another, with their findings.

    Parameters
    ----------
    chunks
        The chunks in their order.
    requested
        Names of the columns.
    location
        Location of the samples of the result.
    """
    data = {}
    for name in requested:
        data[name] = np.concatenate([np.empty(0), *(chunk.data[name] for chunk in chunks)])
    clock_names = {name for chunk in chunks for name in chunk.stamps}
    stamps = {}
    for name in clock_names:
        stamps[name] = np.concatenate(
            [chunk.stamps[name] for chunk in chunks if name in chunk.stamps]
        )
    findings = tuple(finding for chunk in chunks for finding in chunk.findings)
    return Columns(data, location, findings, stamps)


@dataclass(frozen=True)
class Track:
    """One channel: values (N,), start [s] and sampling interval [s], None if it is not known."""

    values: Array
    start_s: float = 0.0
    dt_s: float | None = None

    @property
    def timing(self) -> tuple[int, float, float | None]:
        """Length, start and interval; channels that share them need no interpolation."""
        return len(self.values), round(self.start_s, 6), self.dt_s

    @property
    def end_s(self) -> float:
        """Time of the last sample [s]."""
        return self.start_s + (len(self.values) - 1) * (self.dt_s or 0.0)


def align(
    tracks: Mapping[str, Track], where: str
) -> tuple[Array | None, dict[str, Array], list[Finding]]:
    """Put channels on one time grid.

    Parameters
    ----------
    tracks
        Channels by name.
    where
        The file, for messages.

    Returns
    -------
    time_s
        Time (N,) [s] from the common start; None if no channel has a time.
    data
        Channels (N,) by name.
    findings
        Warnings about what was assumed or interpolated.

    Raises
    ------
    InputError
        For a channel without a known time, or channels whose times do not overlap.

    Notes
    -----
    Channels with equal times are returned as they are. Others are cut to their common span and put
    on the grid of the fastest: linear interpolation, but zero-order hold for two-level channels. A
    channel without interval gets the times of a channel with the same number of samples. The rule
    of the grid is that of ``_resample_on_fastest_grid``; keep this text equal to it.
    """
    timed = {name: track for name, track in tracks.items() if track.dt_s}
    if not timed:
        lengths = {len(track.values) for track in tracks.values()}
        if len(lengths) > 1:
            raise InputError(
                f"channels have {min(lengths)} to {max(lengths)} samples and no time track",
                where=where,
                expected="one length, or wf_increment on each channel",
            )
        return None, {name: track.values for name, track in tracks.items()}, []
    full, findings = _with_assumed_times(tracks, timed, where)
    if len({track.timing for track in full.values()}) == 1:
        track = next(iter(full.values()))
        time_s = np.asarray(np.arange(len(track.values)) * float(track.dt_s or 1.0))
        return time_s, {name: track.values for name, track in full.items()}, findings
    time_s, data = _resample_on_fastest_grid(full, where)
    last = max(full, key=lambda name: full[name].start_s)
    spread_s = full[last].start_s - min(track.start_s for track in full.values())
    rates_Hz = sorted({round(1 / track.dt_s, 6) for track in full.values() if track.dt_s})
    findings.append(warning("tracks.aligned", subject=last, spread_s=spread_s, rates_Hz=rates_Hz))
    return time_s, data, findings


def _with_assumed_times(
    tracks: Mapping[str, Track], timed: Mapping[str, Track], where: str
) -> tuple[dict[str, Track], list[Finding]]:
    """The channels with a time for each, and findings about those whose time is assumed.

    Parameters
    ----------
    tracks
        Channels by name.
    timed
        Those of them that have an interval; one of equal length gives its times to a channel
        without.
    where
        The file, for messages.

    Returns
    -------
    tracks
        All channels by name, each with its interval.
    findings
        A warning for each channel whose time is assumed.

    Raises
    ------
    InputError
        For a channel without interval whose length no other channel has.
    """
    full = dict(tracks)
    findings = []
    for name, track in tracks.items():
        if track.dt_s:
            continue
        count = len(track.values)
        equal = [other for other, timed_track in timed.items() if len(timed_track.values) == count]
        if not equal:
            raise InputError(
                f"channel {name} has no time track (no wf_increment)",
                where=where,
                expected=f"as many samples as another channel; it has {count}",
            )
        other = equal[0]
        full[name] = Track(track.values, timed[other].start_s, timed[other].dt_s)
        findings.append(warning("tracks.assumed", subject=name, of=other))
    return full, findings


def _resample_on_fastest_grid(
    tracks: Mapping[str, Track], where: str
) -> tuple[Array, dict[str, Array]]:
    """Channels on the grid of the fastest channel, within the common span.

    Parameters
    ----------
    tracks
        Channels by name, each with its interval.
    where
        The file, for messages.

    Returns
    -------
    time_s
        Time (N,) [s] from the first sample.
    data
        Channels (N,) by name.

    Raises
    ------
    InputError
        If fewer than two samples of the fastest channel lie in the common span.

    Notes
    -----
    A channel with at most two levels among its first ``LEVEL_SAMPLES`` finite samples is a switch:
    its last sample at or before each time is taken. Other channels are interpolated linearly.
    Positions closer than ``SAME_START`` samples to a sample are that sample. NaN is not
    interpolated: between two samples of which one is NaN the result is NaN; in a switch a NaN lasts
    until the next sample.

    Keep the text of :func:`align` equal to the rule. Guarded by
    ``test_tdms_channels_that_start_later_are_put_where_they_belong`` and
    ``test_a_slow_tdms_channel_is_interpolated_onto_the_fast_ones`` in
    ``tests/io/test_file_formats.py``.
    """
    begin_s = max(track.start_s for track in tracks.values())
    end_s = min(track.end_s for track in tracks.values())
    fastest = min(tracks.values(), key=lambda track: track.dt_s or np.inf)
    step_s = float(fastest.dt_s or 1.0)
    first = int(np.ceil((begin_s - fastest.start_s) / step_s - SAME_START))
    last = int(np.floor((end_s - fastest.start_s) / step_s + SAME_START))
    if last <= first:
        raise InputError(
            "the channels share no time", where=where, expected="overlapping time tracks"
        )
    time_s = fastest.start_s + np.arange(first, last + 1) * step_s
    data: dict[str, Array] = {}
    for name, track in tracks.items():
        values = track.values
        position = (time_s - track.start_s) / float(track.dt_s or 1.0)
        position = np.clip(position, 0, len(values) - 1)
        nearest = np.rint(position)
        position = np.where(np.abs(position - nearest) < SAME_START, nearest, position)
        levels = np.unique(values[np.isfinite(values)][:LEVEL_SAMPLES])
        if len(levels) <= 2:
            data[name] = values[position.astype(int)]
        else:
            data[name] = np.interp(position, np.arange(len(values)), values)
    return time_s - time_s[0], data
