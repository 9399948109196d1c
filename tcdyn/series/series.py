"""Rows of a table as samples of an even grid: the only form in which a flow gets data.

:func:`make_series` decides about times, gaps and readings, once for every command: the clock of the
rows (:mod:`tcdyn.series.clock`), which values are readings (:mod:`tcdyn.series.reading`), whether
rows were taken at their stamps (:mod:`tcdyn.series.real_share`), and which values are only repeated
(:mod:`tcdyn.series.updates`). A :class:`Policy` says what a flow tolerates.

Tests: ``tests/series/test_series.py`` and ``tests/series/test_one_answer.py``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tcdyn.core import Array, Flags
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, info, warning
from tcdyn.estimation.trace_noise import SPIKES, find_spikes, white_noise_sd
from tcdyn.io.table import Table
from tcdyn.series.clock import Clock, fit_clock
from tcdyn.series.descriptions import find_resolution_s
from tcdyn.series.on_change import (
    DeadBand,
    FilledValues,
    find_dead_band,
    is_counter,
    poll_clock,
    samples_at_rest,
    stated_dead_band,
    unchanged_values,
)
from tcdyn.series.options import ReadingOptions
from tcdyn.series.reading import CODE, RANGE, READING, REPEAT, Codes, Kind, Reasons, reasons_of
from tcdyn.series.real_share import RealShare, at_grid_times, real_share
from tcdyn.series.report import ColumnCount, SeriesReport, clock_report
from tcdyn.series.scaled_readings import RangeCheck
from tcdyn.series.source import check_numbers, with_single_times
from tcdyn.series.units import Unit, kind_of
from tcdyn.series.updates import find_updates

# Least rows of a record that has an interval. Ten give it to a tenth of a row at jitter of a third.
MIN_ROWS = 10
SHORTEST_STEP_S = 1e-10  # faster than any logger; below it the unit of the time is wrong
LONGEST_TABLE_S = 1e11  # 3000 years; beyond it the unit of the time is wrong
# Rows of the even times of a record up to which any share may be missing, and rows of even times
# for each row of the table above it: bounds the memory (8 MB and 400 bytes a row).
MAX_GRID_ROWS = 1_000_000
MAX_GRID_SHARE = 50
# Relative standard uncertainty of a rate from which a warning is given: lags are wrong by as much,
# and 1 % is the uncertainty of a good measurement of a lag (docs/validation.md).
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
# Share of rows with the stamp of the row before, above which rows do not stand twice: as
# ``tcdyn.series.clock.BATCH_SHARE``, a batch of two has a half, and 0.3 leaves a tenth for lost
# rows.
MOSTLY_REPEATED = 0.3
# Scatter of the first rows of the stamps of a coarse clock, in intervals, above which the rows are
# not even: within one interval it is at most 0.5, and 0.3 for an even spread.
UNEVEN_COARSE = 1.0
# A column with fewer distinct values than this share of its new ones was set in levels, not
# measured: a measured one of n new values has nearly n. By judgement, between both kinds of
# ``tests/identify/test_identify_repeats.py``.
MIN_DISTINCT_SHARE = 0.2
# Samples of a gap that the search for repeated values keeps: memory. No column has its new values
# so far apart that the search would see it (``tcdyn.series.updates.MIN_REGULAR_CHANGES``).
LONGEST_EMPTY = 1000
# Least share of the samples without a row from which rows may have been written on change. By
# judgement: such a logger leaves out most rows, and an ordinary one is not searched in vain.
LEAST_LOST_SHARE = 0.05
# Distance of a row without a number from the next sample, in intervals, from which it is an event
# between two samples: as ``tcdyn.series.fine_clock.MAX_STEP_SCATTER``.
EVENT_STRAY = 0.25
# Relative difference of two changes that are one step: rounding errors of the values.
SAME_STEP = 1e-6
# Scatter of even stamps, in intervals, by the rounding of doubles: a time of 1e9 s with 100 Hz has
# 1e-5 of it.
ROUNDING = 1e-5
# Standard uncertainty of the real share, above which the readings tell less than what is assumed
# without them (0.5): 0.5 / sqrt(2).
NOT_TOLD = 0.35
# Names of columns whose rows are means: T_Avg of Campbell loggers, and similar
MEAN_NAME = re.compile(r"(?:^|[_\s(.-])(?:avg|average|mean)\)?(?:$|[_\s(\[])", re.IGNORECASE)
TINY_NOISE = 1e-9  # of a trace without noise: the spike rule needs a positive one


@dataclass(frozen=True)
class Policy:
    """What a flow tolerates in the rows of a table.

    Attributes
    ----------
    min_rows
        Least number of rows.
    longest_gap_s
        A longer gap between two rows is refused [s]; three intervals are always allowed.
    gap_rows
        A gap of more intervals than the record has rows, and than this, is refused; None: none is.
    longest_interval_s
        A longer interval is refused [s].
    max_uneven_share
        Largest share of the steps between rows that are not one interval.
    needs_grid
        Whether the samples of the complete grid are needed, so that nearly all may not be missing.
    few_rows
        A table of fewer rows, as read by eye, has no interval: its samples are at multiples of the
        step of its stamps.
    max_stray
        Largest scatter of stamps that may be real [intervals]; a larger one is refused, and not
        only a warning.
    """

    min_rows: int = MIN_ROWS
    longest_gap_s: float = np.inf
    gap_rows: int | None = None
    longest_interval_s: float = np.inf
    max_uneven_share: float = 1.0
    needs_grid: bool = True
    few_rows: int = 0
    max_stray: float = np.inf


# Scatter up to which readings can be shifted to even times, see ``UNEVEN``.
SHIFTED_ONLY = UNEVEN
ANY_GAP = Policy()
# Longest gap, in rows, of a record that is fitted in one piece, however short it is: a minute at
# 1 Hz. By judgement; a refusal only asks the user to cut the table.
ONE_PIECE = Policy(gap_rows=60)
# The same of a dip, which may be a table that was written by hand: a logger writes more rows
DIP = Policy(gap_rows=60, few_rows=30)
# Least step of the stamps of such a table over its length: bounds its samples to 5000
LEAST_STAMP_STEP = 1 / 5000


@dataclass(frozen=True)
class ColumnRows:
    """Values of a column at the rows of a table.

    Attributes
    ----------
    name, unit
        Name and unit.
    kind
        What it holds.
    raw
        Values (R,) as in the table, NaN where there is no number.
    base
        The same in the unit in which they are judged, degrees Celsius for temperatures; None:
        ``raw``.
    keeps_unit
        Whether the flow wants the values in the unit of the table.
    """

    name: str
    unit: str
    kind: Kind
    raw: Array
    base: Array | None = None
    keeps_unit: bool = False

    @property
    def judged(self) -> Array:
        """Values (R,) in the unit in which they are judged."""
        return self.raw if self.base is None else self.base

    @property
    def values(self) -> Array:
        """Values (R,) in the unit that the flow wants."""
        return self.raw if self.keeps_unit else self.judged


def reading_rows(
    units: Mapping[str, Unit], raw: Mapping[str, NDArray[Any]], where: str
) -> list[ColumnRows]:
    """Columns of readings with a unit; the flow wants temperatures in degrees Celsius.

    Parameters
    ----------
    units
        Units by column.
    raw
        Raw columns (R,), with those of reference junctions.
    where
        The table, for messages.

    Raises
    ------
    InputError
        For a column of text.
    """
    columns = []
    for name, unit in units.items():
        check_numbers(name, raw[name], where)
        reference = unit.reference_junction
        if isinstance(reference, str):
            check_numbers(reference, raw[reference], where)
        base = unit.to_base(raw[name], unit.cold_degC(raw))
        kind = kind_of(name, unit)
        is_unknown = unit.is_assumed and kind is Kind.QUANTITY
        written = "" if is_unknown else unit.name
        columns.append(ColumnRows(name, written, kind, raw[name], base))
    return columns


@dataclass(frozen=True)
class Series:
    """Rows of a table on an even grid, with what is known of each.

    Attributes
    ----------
    clock
        The clock of the rows.
    readings
        By column: readings (R,) at the times of the grid, NaN where the value is none.
    reasons
        By column: why each value (R,) is no reading, see :mod:`tcdyn.series.reading`.
    u_time_s
        Standard uncertainty of the time of each row (R,) [s].
    report
        What was understood.
    findings
        Findings about times and values.
    bands
        By column whose rows were written on change: its dead band.
    late_s
        How much later than its time on the grid each row was read (R,) [s]; None: not at all, or
        the readings do not tell.
    unshifted
        By column that was shifted to the grid: its values (R,) as they were read.
    """

    clock: Clock
    readings: Mapping[str, Array]
    reasons: Mapping[str, Reasons]
    u_time_s: Array
    report: SeriesReport
    findings: tuple[Finding, ...] = ()
    bands: Mapping[str, DeadBand] = field(default_factory=dict)
    late_s: Array | None = None
    unshifted: Mapping[str, Array] = field(default_factory=dict)

    @property
    def time_s(self) -> Array:
        """Times of the samples (N,) [s]."""
        return np.asarray(
            self.clock.start_s + self.clock.interval_s * np.arange(self.clock.size), dtype=float
        )

    @property
    def interval_s(self) -> float:
        """Sampling interval [s]."""
        return self.clock.interval_s

    @property
    def are_rows_changes(self) -> bool:
        """Whether rows were written on change, so that a missing row says "unchanged"."""
        return any(not band.is_held for band in self.bands.values())

    def on_grid(self, name: str) -> Array:
        """Readings of a column at the samples.

        Returns
        -------
        array
            Readings (N,); NaN where there is none, the mean where several rows are one sample. Of a
            column whose rows were written on change also values before a jump, and of an input
            that is held its level at all samples.
        """
        if name in self.bands:
            samples = samples_at_rest(self.readings[name], self.clock, self.bands[name])
            if self.are_rows_changes:
                return samples
            has_row = np.zeros(self.clock.size, dtype=bool)
            has_row[self.clock.index] = True
            return np.where(has_row, samples, np.nan)
        return on_grid(self.readings[name], self.clock)

    def late_on_grid(self) -> Array | None:
        """How much later than each sample (N,) its rows were read [s]; None as of ``late_s``."""
        if self.late_s is None:
            return None
        return np.nan_to_num(on_grid(self.late_s, self.clock))

    def at_own_times(self, name: str) -> Array:
        """Readings (N,) of a column at the times of ``late_on_grid``, if that is not None."""
        if self.late_s is None or name not in self.unshifted:
            return self.on_grid(name)
        own = np.where(np.isfinite(self.readings[name]), self.unshifted[name], np.nan)
        return on_grid(own, self.clock)

    def unchanged(self, name: str) -> FilledValues:
        """Values of a column whose rows were written on change at all samples, with their u."""
        return unchanged_values(self.readings[name], self.clock, self.bands[name])


def on_grid(values: Array, clock: Clock) -> Array:
    """Return values at their samples.

    Parameters
    ----------
    values
        Values of the rows (R,).
    clock
        The clock of the rows.

    Returns
    -------
    array
        Values of the samples (N,); NaN where there is none, the mean where there are several.

    Examples
    --------
    >>> clock = fit_clock(np.array([0.0, 1.0, 2.0, 4.0, 5.0]), 1.0)
    >>> on_grid(np.array([20.0, 21.0, 22.0, 24.0, 25.0]), clock)
    array([20., 21., 22., nan, 24., 25.])
    """
    finite = np.isfinite(values)
    index = clock.index[finite]
    total = np.bincount(index, values[finite], minlength=clock.size)
    count = np.bincount(index, minlength=clock.size)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


@dataclass(frozen=True)
class Context:
    """Where rows come from, and what is known of their table already.

    Attributes
    ----------
    where
        Name of the table, for messages.
    time
        Name of its time column.
    options
        How its rows are read.
    policy
        What the flow tolerates.
    start_time
        Date and time of the first row; empty where the table states none.
    findings
        Findings of the reader.
    codes
        Codes of the logger by column, where the complete table was looked at before.
    first_row
        Row of the first of these rows below the header, from 1.
    table
        The open table, for a message with a line that converts a column; None: in memory.
    is_surveyed
        Whether the units of the complete table were checked before.
    other_times
        Other columns that may be the time, for messages.
    """

    where: str
    time: str = "time_s"
    options: ReadingOptions = field(default=ReadingOptions())
    policy: Policy = ANY_GAP
    start_time: str = ""
    findings: tuple[Finding, ...] = ()
    codes: Mapping[str, Codes] = field(default_factory=dict)
    first_row: int = 1
    table: Table | None = None
    is_surveyed: bool = False
    other_times: Sequence[str] = ()

    def row_text(self, row: int) -> str:
        """A row below the header, from 1, as messages name it."""
        return f"row {row} below the header" if self.table is None else self.table.row_text(row)


def make_series(time_s: Array, columns: Sequence[ColumnRows], context: Context) -> Series:
    """Put the rows of a table on an even grid, and decide which values are readings.

    Parameters
    ----------
    time_s
        Time of each row (R,) [s].
    columns
        Columns at these rows.
    context
        Where the rows come from.

    Returns
    -------
    Series
        The samples, with a report of what was understood.

    Raises
    ------
    InputError
        For time that is missing or runs backward, and for what the policy does not tolerate.

    Notes
    -----
    The order: times; clock; overload, drop-out and impossible values, which must not decide about
    the rest; the real share of the deviations of the stamps, and readings at even times; repeated
    values, which are seen on even rows only.

    Examples
    --------
    >>> rows = ColumnRows("T1", "degC", Kind.TEMPERATURE, np.array([20.0, 20.5, 9e9] + [21.0] * 9))
    >>> series = make_series(np.arange(12.0), [rows], Context("log.csv"))
    >>> series.report.columns[0].readings, series.report.columns[0].left_out[0].reason
    (11, 'code')
    """
    is_row = np.zeros(len(time_s), dtype=bool)
    for column in columns:
        is_number = np.isfinite(column.raw)
        if not is_counter(column.raw[is_number]):  # a counter also counts rows of events
            is_row |= is_number
    time_s, clock, findings = clock_of(time_s, context, is_row)
    reasons: dict[str, Reasons] = {}
    readings: dict[str, Array] = {}
    for column in columns:
        if column.kind is Kind.TEMPERATURE and not context.is_surveyed:
            in_range = RangeCheck(column.name, column.unit)
            in_range.add(column.raw, column.judged)
            in_range.check(context.where, context.table)
        of_column = reasons_of(column.judged, column.kind, context.codes.get(column.name))
        findings += value_findings(column, of_column)
        reasons[column.name] = of_column
        readings[column.name] = np.where(of_column == READING, column.values, np.nan)
    bands = _dead_bands(columns, readings, clock, context.options.on_change)
    findings += [_on_change(name, band, columns) for name, band in bands.items()]
    are_rows_changes = any(not band.is_held for band in bands.values())
    if are_rows_changes:
        clock = poll_clock(clock)
        findings = [each for each in findings if each.code != "series.lost"]
    else:
        if len(time_s) >= context.policy.few_rows:
            check_gaps(time_s, clock, context)
    share = None
    late_s = None
    unshifted: dict[str, Array] = {}
    u_time_s = np.zeros(len(time_s))
    if clock.strays and not are_rows_changes:
        measured = {c.name: readings[c.name] for c in columns if c.kind is not Kind.INPUT}
        share, shifted, stray_findings = _at_even_times(measured, clock, context)
        findings += stray_findings
        if share.value > 0:
            late_s = share.value * clock.jitter_s
            unshifted = {name: readings[name] for name in shifted}
        readings |= shifted
        u_time_s = share.u * np.abs(clock.jitter_s)
    elif clock.is_coarse:
        u_time_s += clock.interval_s / np.sqrt(12)
    else:
        u_time_s += clock.resolution_s / np.sqrt(12)
    counts = []
    for column in columns:
        name = column.name
        count = ColumnCount(name, column.unit, column.kind.value)
        if name in bands:
            count.dead_band = bands[name].value
        elif column.kind is not Kind.INPUT:
            is_repeat, repeat_findings = _repeats(readings[name], name, clock)
            findings += repeat_findings
            readings[name] = np.where(is_repeat, np.nan, readings[name])
            reasons[name][is_repeat] = REPEAT
        count.add(column.raw, reasons[name], context.first_row)
        counts.append(count)
    averages_s = context.options.averages_s
    if averages_s is not None:
        findings.append(info("series.averages", averages_s=averages_s))
    else:
        findings += [
            info("series.named_mean", subject=column.name, interval_s=clock.interval_s)
            for column in columns
            if column.kind is not Kind.INPUT and MEAN_NAME.search(column.name)
        ]
    duration_s = clock.interval_s * (clock.size - 1)
    report = clock_report(
        clock,
        share,
        [count.report(context.findings, duration_s) for count in counts],
        time=context.time,
        averages_s=averages_s,
        start_time=context.start_time,
        first_row=context.first_row,
        are_rows_changes=are_rows_changes,
    )
    if context.table is not None:
        findings = context.table.at_files(findings)
    all_findings = (*context.findings, *findings)
    return Series(
        clock, readings, reasons, u_time_s, report, all_findings, bands, late_s, unshifted
    )


def _dead_bands(
    columns: Sequence[ColumnRows],
    readings: Mapping[str, Array],
    clock: Clock,
    stated: float | None,
) -> dict[str, DeadBand]:
    """Dead bands of the columns whose rows were written on change.

    Parameters
    ----------
    columns
        The columns.
    readings
        Their readings (R,).
    clock
        The clock of the rows.
    stated
        Dead band that the user states, for readings; None: it is looked for.
    """
    bands = {}
    for column in columns:
        y = readings[column.name]
        is_input = column.kind is Kind.INPUT
        is_complete = clock.n_lost < LEAST_LOST_SHARE * clock.size and np.isfinite(y).all()
        if is_complete and not (
            clock.is_wandering and _has_equal_changes(y)
        ):  # no row is missing, whatever it would mean
            continue
        if stated is not None and not is_input:
            bands[column.name] = stated_dead_band(y, clock, stated)
            continue
        found = find_dead_band(y, clock)
        if found is not None and found.is_held == is_input:
            bands[column.name] = found
    return bands


def _has_equal_changes(y: Array) -> bool:
    """Whether readings (R,) change by one and the same step in each row, up or down."""
    change = np.abs(np.diff(y))
    return float(np.ptp(change)) <= SAME_STEP * float(change.max())


def _on_change(name: str, band: DeadBand, columns: Sequence[ColumnRows]) -> Finding:
    """An info about a column whose rows were written on change."""
    unit = next(column.unit for column in columns if column.name == name)
    numbers: dict[str, Any] = {"dead_band": band.value, "unit": unit, "count": band.n_readings}
    if band.is_held:
        return info("series.held", subject=name, **numbers)
    return warning("series.on_change", subject=name, **numbers)


def clock_without_events(
    time_s: Array, clock: Clock, is_row: Flags, interval_s: float | None = None
) -> Clock:
    """The clock of the rows of a logger that also writes rows for events.

    Parameters
    ----------
    time_s
        Times of the rows (R,) [s].
    clock
        The clock of all rows.
    is_row
        Whether each row has a number (R,).
    interval_s
        Sampling interval where it is known [s].

    Returns
    -------
    Clock
        ``clock``, or that of the rows without events.

    Notes
    -----
    A row without any number is no sample of its own if the rows with numbers put it between two
    samples (``EVENT_STRAY``) or beside one that has a row. It is then put on the nearest sample,
    as a row that stands twice. The clock without such rows is used if it is the better one: it has
    less than half the scatter and lost samples. That of a table in which two sensors write in turn
    is not.
    """
    if is_row.all() or clock.is_coarse or time_s[is_row][-1] <= time_s[is_row][0]:
        return clock
    if _disorder(clock) <= ROUNDING:  # all rows are even: a column is blank between its values
        return clock
    of_rows = fit_clock(time_s[is_row], interval_s)
    if of_rows.is_coarse:
        return clock
    places = _places_between(time_s, is_row, of_rows)
    nearest = np.rint(places)
    is_own = np.append(True, np.diff(nearest) > 0) & np.append(np.diff(nearest) > 0, True)
    is_event = ~is_row & ((np.abs(places - nearest) > EVENT_STRAY) | ~is_own)
    if not is_event.any():
        return clock
    is_sample = ~is_event
    best = fit_clock(time_s[is_sample], interval_s)
    if best.is_coarse or _disorder(best) >= 0.5 * _disorder(clock):
        return clock
    index = np.rint(_places_between(time_s, is_sample, best)).astype(np.intp)
    start_s = best.start_s + best.interval_s * float(index[0])
    index -= index[0]
    deviation_s = time_s - (start_s + best.interval_s * index)
    # an event is no stamp that strays
    deviation_s[is_event] = 0.0
    return replace(best, index=index, start_s=start_s, deviation_s=deviation_s)


def _places_between(time_s: Array, is_row: Flags, clock: Clock) -> Array:
    """Samples of rows (R,) as fractions, from the clock of those with ``is_row`` (R,)."""
    known_s, first = np.unique(time_s[is_row], return_index=True)
    known = clock.index[first].astype(float)
    places = np.interp(time_s, known_s, known)
    before = time_s < known_s[0]
    after = time_s > known_s[-1]
    places[before] = (time_s[before] - known_s[0]) / clock.interval_s
    places[after] = known[-1] + (time_s[after] - known_s[-1]) / clock.interval_s
    places[is_row] = clock.index
    return places


def _disorder(clock: Clock) -> float:
    """Scatter of the stamps in intervals, and share of the samples that are missing."""
    return float(np.std(clock.deviation_s)) / clock.interval_s + clock.n_lost / clock.size


def clock_of(
    time_s: Array, context: Context, is_row: Flags | None = None
) -> tuple[Array, Clock, list[Finding]]:
    """The clock of the rows of a table.

    Parameters
    ----------
    time_s
        Times of the rows (R,) [s]; single ones may be missing.
    context
        Where the rows come from.
    is_row
        Whether each row has a number (R,); others may be events between the rows of the logger.
        None: all have.

    Returns
    -------
    time_s
        Times (R,) [s] with those that were missing.
    clock
        The clock.
    findings
        Findings about the times.

    Raises
    ------
    InputError
        For times that are missing or run backward, and for what the policy does not tolerate.
    """
    time_s, findings = _with_missing_times(time_s, context)
    check_times(time_s, context)
    dt_s = context.options.dt_s
    is_by_hand = len(time_s) < context.policy.few_rows
    if is_by_hand:
        least_s = LEAST_STAMP_STEP * float(time_s[-1] - time_s[0])
        step_s = max(find_resolution_s(time_s), least_s)
        return time_s, fit_clock(time_s, dt_s or step_s), findings
    clock = fit_clock(time_s, dt_s)
    if is_row is not None and np.count_nonzero(is_row) >= context.policy.min_rows:
        clock = clock_without_events(time_s, clock, is_row, dt_s)
    findings += _check_clock(time_s, clock, context)
    if clock.n_lost:
        first = int(np.argmax(clock.missing > 0))
        lost = info(
            "series.lost",
            subject=context.time,
            count=clock.n_lost,
            places=int(np.count_nonzero(clock.missing)),
            first_s=float(time_s[first]),
        )
        findings.append(lost)
    return time_s, clock, findings


def _with_missing_times(time_s: Array, context: Context) -> tuple[Array, list[Finding]]:
    """Interpolate single missing times between two rows; others stay missing."""
    filled, rows = with_single_times(time_s)
    if not len(rows):
        return time_s, []
    row = int(rows[0]) + context.first_row
    finding = info("series.filled_time", subject=context.time, count=len(rows), row=row)
    return filled, [finding]


def check_times(time_s: Array, context: Context) -> None:
    """Check that there are enough rows, all with a time that never falls and rises in total.

    Parameters
    ----------
    time_s
        Times of the rows (R,) [s].
    context
        Where they come from.

    Raises
    ------
    InputError
        Otherwise, with the row.
    """
    where = context.where
    n = len(time_s)
    least = context.policy.min_rows
    if n < least:
        raise InputError(
            f"only {n} rows", where=where, expected=f"at least {least} samples in time"
        )
    finite = np.isfinite(time_s)
    if not finite.all():
        row = int(np.argmin(finite)) + context.first_row
        raise InputError(
            f"column {context.time}: no time in {context.row_text(row)}",
            where=where,
            expected="a time in each row",
        )
    backward = np.diff(time_s) < 0
    if backward.any():
        k = int(np.argmax(backward))
        raise InputError(
            f"column {context.time}: time runs backward at "
            f"{context.row_text(k + 1 + context.first_row)} ({time_s[k]:.9g} s, then "
            f"{time_s[k + 1]:.9g} s)",
            where=where,
            expected="time that rises",
            remedy="sort the rows, or cut the table; where a clock without dates goes on after a "
            "night without rows, log the date too",
        )
    if time_s[-1] <= time_s[0]:
        raise InputError(
            f"column {context.time}: all rows have one time",
            where=where,
            expected="time that rises",
        )
    if time_s[-1] - time_s[0] < n * SHORTEST_STEP_S:
        raise InputError(
            f"column {context.time}: {n} rows in {time_s[-1] - time_s[0]:.3g} s",
            where=where,
            expected=f"more than {SHORTEST_STEP_S:g} s a row",
            remedy="check the unit of the time",
        )
    if time_s[-1] - time_s[0] > LONGEST_TABLE_S:
        raise InputError(
            f"column {context.time}: the times span {time_s[-1] - time_s[0]:.3g} s",
            where=where,
            expected=f"at most {LONGEST_TABLE_S:.3g} s",
            remedy="check the unit of the time",
        )


def _check_clock(time_s: Array, clock: Clock, context: Context) -> list[Finding]:
    """Findings about the clock of the rows; InputError for what the policy does not tolerate."""
    where = context.where
    policy = context.policy
    dt_s = clock.interval_s
    n = len(time_s)
    span_s = float(time_s[-1] - time_s[0])
    if policy.needs_grid and clock.size > max(MAX_GRID_ROWS, MAX_GRID_SHARE * n):
        raise InputError(
            f"{n} rows at an interval of {dt_s:.3g} s in {span_s:.3g} s: most rows are missing",
            where=where,
            expected=f"one row in {MAX_GRID_SHARE:g} at least",
            remedy="check the unit of the time, or cut the table at its gaps",
        )
    _check_repeated(clock, context)
    if dt_s > policy.longest_interval_s:
        is_milliseconds = dt_s * 1e-3 < 0.2 * policy.longest_interval_s
        hint = "; this looks like milliseconds" if is_milliseconds else ""
        raise InputError(
            f"column {context.time}: the sample interval is {dt_s:.4g} s{hint}",
            where=where,
            expected=f"an interval of at most {policy.longest_interval_s:g} s",
        )
    uneven = np.diff(clock.index) != 1
    if float(np.mean(uneven)) > policy.max_uneven_share:
        row = int(np.argmax(uneven)) + 1 + context.first_row
        raise InputError(
            f"column {context.time}, {context.row_text(row)}: sampling is uneven "
            f"({np.diff(time_s).min():.4g} to {np.diff(time_s).max():.4g} s)",
            where=where,
            expected="one sampling rate",
            remedy="log at one rate, or resample first",
        )
    deviation_s = float(np.median(np.abs(clock.deviation_s)))
    if not clock.strays and deviation_s > COARSE_ROUNDING * dt_s:
        severity = warning if clock.u_interval_s > UNSURE_RATE * dt_s else info
        percent = 100 * clock.u_interval_s / dt_s
        return [
            severity("series.few_decimals", subject=context.time, rate_Hz=1 / dt_s, percent=percent)
        ]
    if clock.n_repeated:
        row = int(np.argmax(np.diff(time_s) == 0)) + 1 + context.first_row
        return [info("series.repeated_time", subject=context.time, count=clock.n_repeated, row=row)]
    return []


def check_gaps(time_s: Array, clock: Clock, context: Context) -> None:
    """Raise InputError for a gap between two rows that the policy does not tolerate.

    Parameters
    ----------
    time_s
        Times of the rows (R,) [s].
    clock
        Their clock.
    context
        Where they come from.
    """
    policy = context.policy
    dt_s = clock.interval_s
    n = len(time_s)
    # rows on a clock that is coarser than them share a stamp, so that the grid tells
    steps = np.diff(clock.index)
    longest = int(np.argmax(steps))
    gap_s = float(steps[longest]) * dt_s
    limit_s = max(policy.longest_gap_s, 3 * dt_s)
    if policy.gap_rows is not None:
        limit_s = min(limit_s, max(n, policy.gap_rows) * dt_s)
    if gap_s > limit_s:
        raise InputError(
            f"{gap_s:.6g} s are missing after {context.row_text(longest + context.first_row)}, at "
            f"{time_s[longest]:.6g} s",
            where=context.where,
            expected=f"gaps of at most {limit_s:.3g} s",
            remedy="cut the table there and give one part; if the logger writes rows only when a "
            "reading has changed, state its dead band, {on_change}",
            parameters={"on_change": "DEADBAND"},
        )


def _check_repeated(clock: Clock, context: Context) -> None:
    """Raise InputError where most stamps repeat and the rows between them are not even."""
    is_uneven = clock.n_repeated > MOSTLY_REPEATED * len(clock.index)
    if clock.is_coarse:
        first_rows = np.flatnonzero(np.diff(clock.even_s + clock.deviation_s) > 0) + 1
        scatter = float(np.std(clock.deviation_s[first_rows])) / clock.interval_s
        is_uneven = scatter > UNEVEN_COARSE
    if is_uneven:
        remedy = "log finer stamps, or cut the table where rows are missing"
        others = context.other_times
        if others:
            remedy = f"try another column of time ({', '.join(others)}), {{time}}; or {remedy}"
        raise InputError(
            "most time stamps are repeated, and the rows between them are not even",
            where=context.where,
            expected="stamps as fine as the sampling interval",
            remedy=remedy,
            parameters={"time": others[0]} if others else {},
        )


def value_findings(column: ColumnRows, reasons: Reasons) -> list[Finding]:
    """Warnings about values that are codes or beyond the range of a thermocouple."""
    findings = []
    for number, code in ((RANGE, "series.range"), (CODE, "series.codes")):
        is_left_out = reasons == number
        count = int(np.count_nonzero(is_left_out))
        if not count:
            continue
        value = float(column.raw[int(np.argmax(is_left_out))])
        findings.append(
            warning(code, subject=column.name, count=count, value=value, unit=column.unit)
        )
    return findings


def _at_even_times(
    columns: Mapping[str, Array], clock: Clock, context: Context
) -> tuple[RealShare, dict[str, Array], list[Finding]]:
    """Readings at the even times, where they were taken at other ones.

    Parameters
    ----------
    columns
        Readings of the rows (R,), by column.
    clock
        The clock of the rows.
    context
        Where the rows come from, and how much scatter is tolerated.

    Returns
    -------
    share
        How much of the deviations the readings confirm.
    columns
        The readings, shifted by as much; values that only repeat the last one, and spikes, are left
        as they are.
    findings
        One with the share, and a warning where readings were taken too unevenly.

    Notes
    -----
    Whether the samples or only the stamps stray is decided by the readings.
    ``tests/sensors/test_uneven_stamps.py`` has both.
    """
    interval_s = clock.interval_s
    stray_s = float(np.std(clock.jitter_s))
    clean = {}
    for name, values in columns.items():
        if find_updates(values).repeats_values:
            continue
        noise = max(float(white_noise_sd(values[:, None])[0]), TINY_NOISE)
        is_spike = find_spikes(values, SPIKES["plunge"], noise)
        clean[name] = np.where(is_spike, np.nan, values)
    share = real_share(clock, list(clean.values()))
    late_s = share.value * clock.jitter_s
    out = dict(columns)
    for name, values in clean.items():
        shifted = at_grid_times(values, clock.even_s, late_s)
        out[name] = np.where(np.isfinite(shifted), shifted, columns[name])
    findings = [
        info(
            "series.strays",
            subject=context.time,
            stray_s=stray_s,
            percent=100 * share.value,
            rate_Hz=1 / interval_s,
            is_told=share.u < NOT_TOLD,
        )
    ]
    time = context.time
    may_be_real = share.value > UNSURE_SHARE or share.u > UNSURE_SHARE
    if may_be_real and stray_s > context.policy.max_stray * interval_s:
        raise InputError(
            f"column {time} is not evenly spaced: rows are {stray_s:.3g} s (1 sd) off a grid of "
            f"{interval_s:.6g} s",
            where=context.where,
            expected="one sampling interval",
            remedy="resample it ({resample_s})",
            parameters={"resample_s": f"{interval_s:.3g}"},
        )
    if may_be_real and stray_s > UNEVEN * interval_s:
        findings.append(
            warning("series.uneven", subject=time, rate_Hz=1 / interval_s, stray_s=stray_s)
        )
    return share, out, findings


def _repeats(values: Array, column: str, clock: Clock) -> tuple[Flags, list[Finding]]:
    """Values that a logger repeats until its sensor has a new one.

    Parameters
    ----------
    values
        Readings of the rows (R,).
    column
        Name of the column.
    clock
        The clock of the rows.

    Returns
    -------
    is_repeat
        Whether each row is a repetition (R,).
    findings
        Empty, or an info with the interval of the new values.
    """
    none = np.zeros(len(values), dtype=bool)
    near = clock.without_long_gaps(LONGEST_EMPTY)
    samples = on_grid(values, near)
    updates = find_updates(samples)
    if not updates.repeats_values:
        return none, []
    new = samples[updates.new]
    if len(np.unique(new)) < MIN_DISTINCT_SHARE * len(new):
        return none, []
    share = updates.share
    finding = info(
        "series.repeats", subject=column, percent=100 * share, interval_s=clock.interval_s / share
    )
    return np.isfinite(values) & ~updates.new[near.index], [finding]
