"""Tables with a time column, read in chunks: columns in degrees Celsius, even times, segments.

``tcdyn sensor``, ``tcdyn compensate`` and the workflows read with it.
``tests/sensors/test_sensor_table.py`` checks times and gaps, ``tests/sensors/test_sensor_file.py``
that segments give the same as the full table, ``tests/sensors/test_sensor_silent.py`` that unusable
values are reported.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from immersion.plunge_data import without_spikes
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, info, warning
from tcdyn.io.clock_numbers import Midnights
from tcdyn.io.metadata import check_not_compensated
from tcdyn.io.read import Table, display_path, open_table
from tcdyn.io.table import CHUNK_ROWS, Columns, missing_column_error
from tcdyn.io.times import (
    TIME_COLUMN_NAMES,
    TimeColumn,
    find_time_column,
    is_time_name,
)
from tcdyn.series import Clock, at_grid_times, fit_clock, real_share
from tcdyn.series.long_tables import check_one_channel
from tcdyn.series.plausible import dropout_codes, out_of_range, overload_codes
from tcdyn.series.scaled_readings import RangeCheck
from tcdyn.series.units import Unit, is_match, unit_findings
from tcdyn.series.updates import find_updates
from tcdyn.smoothing.intervals import SETTLING
from tcdyn.smoothing.process_noise import FLOOR

# Margin of a segment: rows on either side that are only used to settle the smoother. So many lags
# and rows, chosen by judgement, beyond the time in which the smoothest temperature settles.
MARGIN_LAGS = 10.0
MARGIN_ROWS = 400
SEGMENT_ROWS = 20_000  # least rows of a segment; chosen by judgement
# A segment has at least so many times the rows of its margin. The rows of the margins are smoothed
# twice: a larger number costs memory, a smaller one time. Chosen by judgement.
MARGINS_PER_SEGMENT = 3
# Rows for which the first block with a fixed delay waits: they give the interval, and a first
# estimate of the noise (its relative standard uncertainty is 9 % from 64 rows). By judgement.
START_ROWS = 64
MAX_MARGIN_ROWS = 1 << 16  # largest margin, even if the smoother settles more slowly
# Gap beyond which the record is split, since values before it do not determine those after it; by
# judgement.
LONGEST_GAP_LAGS = 10.0
MIN_GAP_INTERVALS = 60  # a shorter gap never splits; chosen by judgement
# Longest gap in rows of a record that is fitted in one piece, whatever its length; chosen by
# judgement.
LONGEST_GAP_ROWS = 60
MIN_ROWS = 10  # of a record with an interval; chosen by judgement
LONGEST_TABLE_S = 1e11  # 3000 years; beyond it the unit of the time is wrong
# Rows of the even times of a record up to which any share may be missing, and rows of even times
# for each row of the table above it: bounds the memory. By judgement.
MAX_GRID_ROWS = 1_000_000
MAX_GRID_SHARE = 50
# Relative standard uncertainty of a rate from which a warning is given: lags are wrong by as much;
# by judgement.
UNSURE_RATE = 0.01
# Typical deviation of rounded stamps, in intervals, from which a finding says that the clock has
# few decimals. No result depends on it.
COARSE_ROUNDING = 0.1
# Scatter of stamps, in intervals, from which a warning is given: readings taken so unevenly are not
# shifted to even times well enough. Lags of pairs are within their uncertainty at 0.25, and twice
# as far off at 0.3 (``tests/sensors/test_uneven_stamps.py``, 12 pairs each); half of 8 dips at 0.23
# were outside their intervals, none at 0.15, since the entry is no smooth signal.
UNEVEN = 0.2
# Real share of the jitter, and its standard uncertainty, below which only the stamps stray.
UNSURE_SHARE = 0.25
# Share of rows with the stamp of the row before, above which rows do not stand twice. By judgement.
MOSTLY_REPEATED = 0.3
# Scatter of the first rows of the stamps of a coarse clock, in intervals, above which the rows are
# not even: within one interval it is at most 0.5, and 0.3 for an even spread.
UNEVEN_COARSE = 1.0


@dataclass(frozen=True)
class Source:
    """An opened table and its time column.

    Attributes
    ----------
    path
        The file.
    table
        The opened table.
    clock
        Its time column.
    """

    path: Path
    table: Table
    clock: TimeColumn

    @property
    def time(self) -> str:
        """Name of the time column."""
        return self.clock.name

    def check_columns(self, columns: Sequence[str]) -> None:
        """Raise InputError for a column that the table does not have."""
        for name in columns:
            if name not in self.table.names:
                raise missing_column_error("column", name, self.table.names, self.table.where)

    def read_chunks(
        self, columns: Sequence[str], rows: int = CHUNK_ROWS
    ) -> Iterator[tuple[Array, dict[str, Array], tuple[Finding, ...]]]:
        """Yield the table in chunks.

        A time column of clock stamps is among the columns as it is in the file.

        Parameters
        ----------
        columns
            Columns to read.
        rows
            Rows of a chunk.

        Returns
        -------
        time_s
            Times (N,) [s].
        columns
            Columns (N,) as in the file, without conversion; clock stamps are among them.
        findings
            Findings of the reader.

        Raises
        ------
        InputError
            Where the unit of time is not clear.
        """
        names = list(dict.fromkeys([self.time, *columns]))
        checked = False
        clock = self.clock
        midnights = Midnights()
        guess = tuple(self.clock.findings())
        chunks = self.table.chunks(names, rows)
        try:
            for chunk in chunks:
                values = chunk.data[self.time]
                # a chunk without rows, which carries findings, has no stamps
                is_clock = self.time in chunk.stamps or len(values) == 0
                if len(values) > 1 and not is_clock:
                    recognised = clock.recognised(values, is_clock)
                    if checked and recognised is not clock:
                        raise self._late_clock_error(recognised)
                    clock = recognised
                times_s = clock.in_seconds(values, is_clock)
                if clock.clock_unit and not is_clock:
                    times_s = midnights.continued(times_s)
                if not checked and len(times_s) > 1:
                    clock.check_step(times_s, is_clock)
                    clock.check_bursts(times_s)
                    checked = True
                yield times_s, {**chunk.data, **chunk.stamps}, (*guess, *chunk.findings)
                guess = ()
        finally:
            if isinstance(chunks, Generator):
                chunks.close()  # an error leaves no reader of the file behind

    def _late_clock_error(self, clock: TimeColumn) -> InputError:
        """Error for a clock written as numbers that the first rows do not show."""
        return InputError(
            f"column {clock.name!r} holds clock times as numbers, which its first rows do not show",
            where=clock.where,
            remedy="name the unit, {time_unit}",
            parameters={"time_unit": clock.clock_unit},
        )


class ChunkSource(Protocol):
    """Source of columns in chunks: an opened table, or a log."""

    def read_chunks(
        self, columns: Sequence[str]
    ) -> Iterator[tuple[Array, dict[str, Array], tuple[Finding, ...]]]:
        """Yield time (N,) [s], columns (N,) and findings of each chunk."""


def open_source(
    path: str | Path,
    time: str | None = None,
    known: Sequence[str] = (),
    time_unit: str | None = None,
) -> Source:
    """Open a table.

    Parameters
    ----------
    path
        The table.
    time
        Name of its time column; None: found.
    known
        Names or patterns of the columns that the caller needs; they help to find the header. Other
        columns may have one name; it gets a number.
    time_unit
        Unit of time; None: from the name or the row of units.

    Raises
    ------
    InputError
        Without a time column, for a needed column that stands twice (any column, if none is
        named), and for a table that is compensated already.
    """
    table = open_table(path, (*TIME_COLUMN_NAMES, *known))
    return source_of_table(Path(path), table, time, time_unit, known)


def source_of_table(
    path: Path,
    table: Table,
    time: str | None = None,
    time_unit: str | None = None,
    known: Sequence[str] = (),
) -> Source:
    """Find the time column of an open table; ``path`` is its file.

    The other parameters, and the errors, are those of ``open_source``.
    """
    check_not_compensated(table.names, table.metadata, table.where)
    table = _with_unique_names(table, [*known, *([time] if time else [])])
    clock = find_time_column(
        table.names,
        table.where,
        requested=time,
        unit=time_unit,
        unit_row=table.units,
        clock_columns=table.clock_columns,
    )
    return Source(path, table, clock)


def _with_unique_names(table: Table, needed: Sequence[str]) -> Table:
    """The table with a number behind each name that stands twice.

    Parameters
    ----------
    table
        The table.
    needed
        Names or patterns of the columns that are needed; none: all.

    Raises
    ------
    InputError
        If a needed column or one of time stands twice.
    """
    duplicates = [name for name in dict.fromkeys(table.names) if table.names.count(name) > 1]
    for name in duplicates:
        is_needed = not needed or is_time_name(name)
        if is_needed or any(is_match(pattern, name) for pattern in needed):
            raise InputError(
                f"column {name!r} stands twice", where=table.where, remedy="rename one of them"
            )
    if not duplicates:
        return table
    names = []
    for k, name in enumerate(table.names):
        count = table.names[: k + 1].count(name)
        names.append(f"{name} ({count})" if count > 1 else name)

    def chunks(requested: Sequence[str], rows: int = CHUNK_ROWS) -> Iterator[Columns]:
        yield from table.chunks([name for name in requested if name in table.names], rows)

    return replace(table, names=tuple(names), chunks=chunks)


def read_columns(
    table: str | Path | Source,
    columns: Sequence[str],
    units: Mapping[str, Unit] | None = None,
    time: str | None = None,
    time_unit: str | None = None,
) -> tuple[Array, dict[str, Array], list[Finding]]:
    """Read columns of a table on even times.

    Parameters
    ----------
    table
        The table, or its opened source.
    columns
        Columns to read.
    units
        Units of the columns that are converted to degrees Celsius.
    time, time_unit
        Time column of the table and its unit; None: found.

    Returns
    -------
    time_s, columns, findings
        Even times (N,) [s], columns on them (N,) with NaN where missing, and findings.

    Raises
    ------
    InputError
        For a missing column, time that does not rise, or fewer than ten rows.
    """
    source = table if isinstance(table, Source) else open_source(table, time, columns, time_unit)
    where = display_path(source.path)
    source.check_columns(columns)
    units = units or {}
    references = [
        unit.reference_junction
        for unit in units.values()
        if isinstance(unit.reference_junction, str)
    ]
    names = [*columns, *references]
    temperatures = [name for name in columns if name in units]
    check_one_channel(source.table, source.time, temperatures, names)
    chunks = list(source.read_chunks(names))
    t = np.concatenate([times_s for times_s, _, _ in chunks])
    raw = {name: np.concatenate([data[name] for _, data, _ in chunks]) for name in names}
    for name, values in raw.items():
        check_numbers(name, values, source.table.where)
    findings = [finding for _, _, noted in chunks for finding in noted]
    clock, clock_findings = even_times(t, where)
    check_gaps(t, clock.interval_s, where)
    rows = {}
    for name in columns:
        values = raw[name]
        if name in units:
            unit = units[name]
            reference = (
                raw[unit.reference_junction]
                if isinstance(unit.reference_junction, str)
                else unit.reference_junction
            )
            findings += unit_findings(name, unit, values)
            base = unit.to_base(values, reference)
            if unit.is_temperature:
                in_range = RangeCheck(name, unit.name)
                in_range.add(values, base)
                in_range.check(source.table.where, source.table)
            values, codes = _without_codes(name, base, unit)
            findings += codes
        rows[name] = values
    if clock.strays:
        readings_degC = {name: rows[name] for name in columns if name in units}
        shifted, jitter_findings = at_even_times(readings_degC, clock, source.time)
        rows |= shifted
        clock_findings += jitter_findings
    out = {name: on_grid(rows[name], clock) for name in columns}
    time_s = np.asarray(clock.start_s + clock.interval_s * np.arange(clock.size), dtype=float)
    return time_s, out, [*findings, *clock_findings]


def check_numbers(column: str, values: NDArray[Any], where: str) -> None:
    """Check that a column holds numbers.

    Parameters
    ----------
    column
        Its name.
    values
        Its values (N,), from the first row of the table on.
    where
        The table, in the message.

    Raises
    ------
    InputError
        For a column of text, with its first cell.

    Examples
    --------
    >>> check_numbers("T1", np.array([20.0, 20.1]), "log.csv")
    """
    if values.dtype != object:
        return
    row = next((k for k, cell in enumerate(values) if cell), 0)
    raise InputError(
        f"column {column!r} holds text, such as {values[row]!r} in row {row + 1} below the header",
        where=where,
        expected="numbers",
    )


def _without_codes(column: str, values: Array, unit: Unit) -> tuple[Array, list[Finding]]:
    """Replace impossible temperatures, overload codes and dropout codes by NaN.

    Parameters
    ----------
    column
        Name of the column.
    values
        Temperatures (N,) [degC], or values in another unit.
    unit
        Its unit.

    Returns
    -------
    values
        Values (N,).
    findings
        Empty, or one warning with their number.
    """
    wrong = out_of_range(values) if unit.is_temperature else overload_codes(values)
    wrong |= dropout_codes(np.where(wrong, np.nan, values))
    if not wrong.any():
        return values, []
    codes = warning(
        "sensor.codes",
        subject=column,
        count=int(wrong.sum()),
        value=float(values[int(np.argmax(wrong))]),
    )
    return np.where(wrong, np.nan, values), [codes.in_unit(unit.base)]


def without_repeats(values: Array, column: str, dt_s: float) -> tuple[Array, list[Finding]]:
    """Replace the values that a logger repeats, until its sensor has a new one, by NaN.

    Parameters
    ----------
    values
        Readings (N,) on even times.
    column
        Name of the column.
    dt_s
        Interval of the rows [s].

    Returns
    -------
    values
        Readings (N,).
    findings
        Empty, or an info with the interval of the new values.
    """
    updates = find_updates(values)
    if not updates.repeats_values:
        return values, []
    share = updates.share
    repeats = info("sensor.repeats", subject=column, percent=100 * share, interval_s=dt_s / share)
    return np.where(updates.new, values, np.nan), [repeats]


def check_gaps(time_s: Array, dt_s: float, where: str) -> None:
    """Raise InputError if a record has a gap longer than everything it holds.

    Parameters
    ----------
    time_s
        Times of the rows (N,) [s].
    dt_s
        Interval [s].
    where
        Table that the error names.

    Raises
    ------
    InputError
        With the row.
    """
    steps = np.diff(time_s)
    row = int(np.argmax(steps))
    gap_s = float(steps[row])
    if gap_s > max(len(time_s) * dt_s, LONGEST_GAP_ROWS * dt_s):
        raise InputError(
            f"{gap_s:.6g} s are missing after row {row + 1} below the header",
            where=where,
            expected="one record without a long gap",
            remedy="cut the table there and give one part",
        )


def even_times(time_s: Array, where: str, dt_s: float | None = None) -> tuple[Clock, list[Finding]]:
    """Return the clock of the rows.

    Parameters
    ----------
    time_s
        Time stamps (N,) [s].
    where
        Name of the table, for messages.
    dt_s
        Interval, if an earlier segment has determined it [s].

    Returns
    -------
    clock, findings
        The clock; findings about the stamps.

    Raises
    ------
    InputError
        For time that is missing, runs backward, fewer than ten rows, or nearly all rows missing.

    Notes
    -----
    ``tcdyn.series.fit_clock`` finds the clock; this function says what a table may not have.
    """
    _check_rising(time_s, where)
    clock = fit_clock(time_s, dt_s)
    dt = clock.interval_s
    if clock.size > max(MAX_GRID_ROWS, MAX_GRID_SHARE * len(time_s)):
        raise InputError(
            f"{len(time_s)} rows at an interval of {dt:.3g} s in {time_s[-1] - time_s[0]:.3g} "
            "s: most rows are missing",
            where=where,
            expected=f"one row in {MAX_GRID_SHARE:g} at least",
            remedy="check the unit of the time, or cut the table at its gaps",
        )
    _check_repeated(clock, where)
    deviation_s = float(np.median(np.abs(clock.deviation_s)))
    if not clock.strays and deviation_s > COARSE_ROUNDING * dt:
        severity = warning if clock.u_interval_s > UNSURE_RATE * dt else info
        percent = 100 * clock.u_interval_s / dt
        return clock, [severity("sensor.few_decimals", rate_Hz=1 / dt, percent=percent)]
    if clock.n_repeated:
        row = int(np.argmax(np.diff(time_s) == 0))
        return clock, [info("sensor.repeated", count=clock.n_repeated, row=row + 2)]
    return clock, []


def _check_repeated(clock: Clock, where: str) -> None:
    """Raise InputError where most stamps repeat and the rows between them are not even."""
    is_uneven = clock.n_repeated > MOSTLY_REPEATED * len(clock.index)
    if clock.is_coarse:
        first_rows = np.flatnonzero(np.diff(clock.even_s + clock.deviation_s) > 0) + 1
        scatter = float(np.std(clock.deviation_s[first_rows])) / clock.interval_s
        is_uneven = scatter > UNEVEN_COARSE
    if is_uneven:
        raise InputError(
            "most time stamps are repeated, and the rows between them are not even",
            where=where,
            expected="stamps as fine as the sampling interval",
            remedy="log finer stamps, or cut the table where rows are missing",
        )


def at_even_times(
    columns: Mapping[str, Array], clock: Clock, time: str
) -> tuple[dict[str, Array], list[Finding]]:
    """Readings at the even times, where they were taken at other ones.

    Parameters
    ----------
    columns
        Temperatures of the rows (N,), by column.
    clock
        The clock of the rows.
    time
        Name of the time column, for the finding.

    Returns
    -------
    columns
        The temperatures, shifted by that share of the jitter that they confirm; values that only
        repeat the last one, and spikes, are left as they are.
    findings
        One with the share, and a warning where readings were taken too unevenly.

    Notes
    -----
    Whether the samples or only the stamps stray is decided by the readings.
    ``tests/sensors/test_uneven_stamps.py`` has both.
    """
    names = [name for name, values in columns.items() if not find_updates(values).repeats_values]
    rate_Hz = 1 / clock.interval_s
    stray_s = float(np.std(clock.jitter_s))
    readings = []
    if names:
        readings = list(without_spikes(np.column_stack([columns[name] for name in names]))[0].T)
    share = real_share(clock, readings)
    late_s = share.value * clock.jitter_s
    out = dict(columns)
    for name, values in zip(names, readings):
        shifted = at_grid_times(values, clock.even_s, late_s)
        out[name] = np.where(np.isfinite(shifted), shifted, columns[name])
    percent = 100 * share.value
    jitter_finding = info(
        "time.strays", subject=time, stray_s=stray_s, percent=percent, rate_Hz=rate_Hz
    )
    if (share.value > UNSURE_SHARE or share.u > UNSURE_SHARE) and stray_s > UNEVEN / rate_Hz:
        return out, [jitter_finding, warning("sensor.uneven", rate_Hz=rate_Hz, stray_s=stray_s)]
    return out, [jitter_finding]


def _check_rising(time_s: Array, where: str) -> None:
    """Check that there are ``MIN_ROWS`` rows, all with a time that never falls and rises in total.

    The times may span ``LONGEST_TABLE_S`` at most.

    Raises
    ------
    InputError
        Otherwise, with the row.
    """
    n = len(time_s)
    if n < MIN_ROWS:
        expected = f"at least {MIN_ROWS} samples in time"
        raise InputError(f"only {n} rows", where=where, expected=expected)
    finite = np.isfinite(time_s)
    if not finite.all():
        row = int(np.argmin(finite))
        raise InputError(
            f"no time in row {row + 1} below the header", where=where, expected="a time in each row"
        )
    backward = np.diff(time_s) < 0
    if backward.any():
        row = int(np.argmax(backward))
        raise InputError(
            f"time runs backward at row {row + 2} below the header "
            f"({time_s[row]:.9g} s, then {time_s[row + 1]:.9g} s)",
            where=where,
            expected="time that rises",
            remedy="sort the rows, or cut the table; where a clock without dates goes on after a "
            "night without rows, log the date too",
        )
    if time_s[-1] <= time_s[0]:
        raise InputError("all rows have one time", where=where, expected="time that rises")
    if time_s[-1] - time_s[0] > LONGEST_TABLE_S:
        raise InputError(
            f"the times span {time_s[-1] - time_s[0]:.3g} s",
            where=where,
            expected=f"at most {LONGEST_TABLE_S:.3g} s",
            remedy="check the unit of the time",
        )


@dataclass(frozen=True)
class SegmentPosition:
    """Where a reading with a fixed delay stands between two segments, to continue there.

    Attributes
    ----------
    interval_s
        Typical interval of the rows [s], from the first rows of the table.
    done_rows
        Rows since the last long gap that belong to earlier segments.
    history_rows
        The last of these rows, which are read again.
    """

    interval_s: float
    done_rows: int
    history_rows: int


@dataclass(frozen=True)
class TableSegment:
    """A segment of the table with margins that are only used to settle the smoother.

    Attributes
    ----------
    time_s, data
        Times (N,) [s] and columns (N,), margins included.
    keep
        Rows of the segment without its margins.
    findings
        Findings of the reader.
    position
        Where the reading stands after this segment.
    is_last
        Whether the segment was cut short because the table ended: with a fixed delay a table that
        has grown would be divided otherwise there.
    """

    time_s: Array
    data: dict[str, Array]
    keep: slice
    findings: tuple[Finding, ...]
    position: SegmentPosition = SegmentPosition(0.0, 0, 0)
    is_last: bool = False


@dataclass(frozen=True)
class _Lengths:
    """Rows of a segment and of its margins; rows in which a gap is seen, that stay in the buffer,
    and that must be read before the segment can be made.
    """

    size: int
    before: int
    after: int
    window: int
    stored: int
    needed: int


def read_segments(
    source: ChunkSource,
    columns: Sequence[str],
    lag_s: float,
    min_rows: int | None = None,
    *,
    delay_s: float | None = None,
    position: SegmentPosition | None = None,
) -> Iterator[TableSegment]:
    """Read a table in overlapping segments; a long gap ends a segment.

    Parameters
    ----------
    source
        The table.
    columns
        Columns to read.
    lag_s
        Largest lag, for the margin [s].
    min_rows
        Least rows of a segment; None: ``SEGMENT_ROWS``.
    delay_s
        None: long segments, with margins on both sides in which the smoother settles. A number
        [s]: blocks with a fixed delay. A block is complete when the rows of this time after its
        first row are there; half of them belong to the block, and half are its margin after.
    position
        With a delay: where an earlier reading stood; ``source`` begins with the history of the next
        block.

    Yields
    ------
    TableSegment
        The segments in the order of the rows; their kept rows are each row once.

    Notes
    -----
    Where segments end depends on the rows only, not on how the file is read. The margin is that of
    the least process-noise intensity that a fit can give, ``FLOOR`` noise variances per second
    cubed: sqrt(2) (interval / ``FLOOR``)^(1/4) is the memory of the smoother there
    (``tcdyn.smoothing.intervals.memory_s``), and ``SETTLING`` memories are enough. It has at most
    ``MAX_MARGIN_ROWS``.

    With a delay of n rows, a block has n - ceil(n / 2) + 1 rows and a margin of ceil(n / 2) rows
    after it, so its first row waits for exactly n rows. The margin before is ten lags, and at least
    ``MARGIN_ROWS``. It is shorter than that of other segments: the rows of a block are estimated
    from fewer rows, and their uncertainty includes that. The first block after a start or a long
    gap waits for ``START_ROWS`` rows. ``tests/smoothing/test_fixed_delay.py`` guards that the
    division depends on the rows only.
    """
    longest_gap_s = LONGEST_GAP_LAGS * lag_s
    chunks = source.read_chunks(columns)
    at_end = False
    time = np.empty(0)
    data: dict[str, Array] = {}
    findings = list[Finding]()
    done = 0  # rows of the buffer that belong to earlier segments
    stretch_rows = 0  # rows since the last long gap that belong to earlier segments
    interval_s = 0.0
    margin = 0
    if position is not None:
        interval_s = position.interval_s
        stretch_rows = position.done_rows
        done = position.history_rows
    while done < len(time) or not at_end:
        if delay_s is None:
            lengths = _settled_lengths(margin, min_rows or SEGMENT_ROWS)
        else:
            lengths = _delayed_lengths(delay_s, lag_s, interval_s, stretch_rows)
        if not at_end and len(time) < done + lengths.needed:
            chunk = next(chunks, None)
            if chunk is None:
                at_end = True
                continue
            new_time, new_data, new_findings = chunk
            if len(new_time):
                data = {
                    n: np.concatenate([data[n], new_data[n]]) if n in data else new_data[n]
                    for n in columns
                }
                time = np.concatenate([time, new_time])
            findings += new_findings
            continue
        if not interval_s:
            interval_s = _typical_interval_s(time if delay_s is None else time[:START_ROWS])
            memory_s = np.sqrt(2) * (interval_s / FLOOR) ** 0.25
            settling_s = SETTLING * memory_s + MARGIN_LAGS * lag_s
            margin = _rounded_margin(settling_s / interval_s + MARGIN_ROWS)
            continue
        split_s = max(longest_gap_s, MIN_GAP_INTERVALS * interval_s)
        if done and done < len(time) and time[done] - time[done - 1] > split_s:
            # without rows after a block, the gap after it shows here
            time = time[done:]
            data = {n: values[done:] for n, values in data.items()}
            done = 0
            stretch_rows = 0
            continue
        ahead = time[done : done + lengths.window]
        gaps = np.flatnonzero(np.diff(ahead) > split_s)
        has_gap = len(gaps) > 0
        cut_short = at_end and len(time) < done + lengths.needed and not has_gap
        to_end = has_gap or cut_short
        end = done + (int(gaps[0]) + 1 if has_gap else len(ahead))
        stop = end if to_end else done + lengths.size  # of the segment without its margin
        first = max(done - lengths.before, 0)
        last = end if to_end else stop + lengths.after
        next_rows = 0 if has_gap else stretch_rows + stop - done
        yield TableSegment(
            time[first:last],
            {n: values[first:last] for n, values in data.items()},
            slice(done - first, stop - first),
            tuple(findings),
            SegmentPosition(interval_s, next_rows, min(next_rows, lengths.stored)),
            cut_short,
        )
        findings = []
        drop = stop if has_gap else max(stop - lengths.stored, 0)
        time = time[drop:]
        data = {n: values[drop:] for n, values in data.items()}
        done = stop - drop
        stretch_rows = next_rows


def _settled_lengths(margin: int, min_rows: int) -> _Lengths:
    """Lengths of a segment with ``margin`` rows on either side; a gap in the margin is seen."""
    size = max(MARGINS_PER_SEGMENT * margin, min_rows)
    window = size + 2 * margin
    return _Lengths(size, margin, margin, window, margin, window + 1)


def _delayed_lengths(
    delay_s: float, lag_s: float, interval_s: float, stretch_rows: int
) -> _Lengths:
    """Lengths [rows] of a block with a fixed delay; see the notes of ``read_segments``.

    Parameters
    ----------
    delay_s
        The delay [s].
    lag_s
        Largest lag, for the margin before the block [s].
    interval_s
        Interval of the rows [s]; 0: not known yet, so that ``START_ROWS`` are read first.
    stretch_rows
        Rows since the start or the last long gap that belong to earlier blocks.
    """
    if not interval_s:
        return _Lengths(0, 0, 0, 0, 0, START_ROWS)
    rows = int(delay_s / interval_s + 1e-6)
    after = (rows + 1) // 2
    size = rows - after + 1
    after = max(after, START_ROWS - stretch_rows - size)
    before = max(int(np.ceil(MARGIN_LAGS * lag_s / interval_s)), MARGIN_ROWS)
    return _Lengths(size, before, after, size + after, before, size + after)


@dataclass
class RisingRows:
    """A source without the rows whose time is missing, or before that of an earlier row.

    A log that is followed may have such rows where the clock of the logger is set; a table that is
    complete may not (``even_times``).

    Attributes
    ----------
    source
        The source.
    rows, left_out
        Rows read so far, and those of them that were left out.
    """

    source: ChunkSource
    rows: int = 0
    left_out: int = 0

    def read_chunks(
        self, columns: Sequence[str]
    ) -> Iterator[tuple[Array, dict[str, Array], tuple[Finding, ...]]]:
        """Time (N,) [s] and columns (N,) of each chunk, and findings."""
        latest_s = -np.inf
        for time_s, data, findings in self.source.read_chunks(columns):
            before = np.fmax.accumulate(np.concatenate([[latest_s], time_s]))
            used = np.isfinite(time_s) & (time_s >= before[:-1])
            latest_s = float(before[-1])
            self.rows += len(time_s)
            self.left_out += int(np.count_nonzero(~used))
            yield time_s[used], {name: data[name][used] for name in columns}, findings


def _typical_interval_s(time: Array) -> float:
    """Return the typical interval of the first rows [s], above zero."""
    step = np.diff(time[: SEGMENT_ROWS + 1])
    step = step[np.isfinite(step)]
    if not len(step):
        return 1.0
    typical = float(np.median(step)) or float(step.mean())
    return typical if typical > 0 else 1.0  # time that runs backward is refused later


def _rounded_margin(rows: float) -> int:
    """Round a number of rows up to a power of two, beyond 1024 to a multiple of 1024.

    The smoother starts its intervals at the first row of a segment. With this margin they begin at
    the same rows of the table in every segment. At most ``MAX_MARGIN_ROWS``.
    """
    step = 1 << min(int(np.ceil(np.log2(max(rows, 1)))), 10)
    return int(min(step * np.ceil(rows / step), MAX_MARGIN_ROWS))


def on_grid(values: Array, clock: Clock) -> Array:
    """Return values at their samples.

    Parameters
    ----------
    values
        Values of the rows (N,).
    clock
        The clock of the rows.

    Returns
    -------
    array
        Values of the samples; NaN where there is no row, the mean where there are several.
    """
    finite = np.isfinite(values)
    index = clock.index[finite]
    total = np.bincount(index, values[finite], minlength=clock.size)
    count = np.bincount(index, minlength=clock.size)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def unique_by_subject(findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """Return the first finding of each code about each subject.

    The segments of one table repeat them.
    """
    first: dict[tuple[str, str], Finding] = {}
    for finding in findings:
        first.setdefault((finding.code, finding.subject), finding)
    return tuple(first.values())
