"""Compensation segment by segment: one engine for tables, rig logs and logs that still grow.

``compensated_segments`` reads a source of rows in overlapping segments
(``tcdyn.sensors.segments.read_segments``), smooths the channels of each, and yields the rows of the
output. Where the readings and the chains come from is the matter of ``tcdyn.sensors.channels`` and
``tcdyn.workflows.rig_channels``.
Used by ``compensate_table``, ``compensate_log`` (logs that are too long for the memory) and
``follow``. Guarded by ``tests/smoothing/test_long_log.py``, ``tests/sensors/test_sensor_file.py``
and ``tests/smoothing/test_fixed_delay.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, Protocol, get_args

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, unique_by_subject, warning
from tcdyn.core.options import Options, option
from tcdyn.io.metadata import START_TIME_KEY
from tcdyn.io.start_time import start_time
from tcdyn.io.write import STANDARD_STYLE, OutputStyle, log_writer
from tcdyn.sensors.decimals import decimals_for, rounded_for_file
from tcdyn.sensors.delayed import DelayedSmoother
from tcdyn.sensors.readings import ChannelReadings
from tcdyn.sensors.segments import SegmentPosition, TableSegment, read_segments
from tcdyn.series.source import ChunkSource
from tcdyn.series.units import Unit
from tcdyn.smoothing.inverse import invert
from tcdyn.smoothing.process_noise import Criterion
from tcdyn.smoothing.record import GOOD, IMPLAUSIBLE, MISSING, Compensated
from tcdyn.smoothing.smoother import deconvolve, smooth
from tcdyn.smoothing.time_means import MeanTimes

Method = Literal["smoother", "deconvolve", "inverse", "noise-only"]
METHODS: tuple[Method, ...] = get_args(Method)
# Bandwidth of the causal filter [Hz], chosen by judgement: its report states the noise and the
# delay that it causes, so that the user can choose another.
DEFAULT_BANDWIDTH_HZ = 0.5


@dataclass(frozen=True)
class CompensationMethod(Options):
    """How a log is compensated.

    Attributes
    ----------
    method
        smoother (RTS smoother); deconvolve (regularised deconvolution, without a model of the
        input, as a check); inverse (a causal filter); noise-only (the smoother without the chain:
        removes only noise and static errors, not the lag)
    criterion
        with the method deconvolve: gcv (default), discrepancy or l-curve, which chooses its weight
    bandwidth_Hz
        with the method inverse: bandwidth [Hz] (default 0.5)
    components
        also write the components of each _u_K: _noise_u_K (differs from row to row), _record_u_K
        (one error of the column in the whole log) and _common_u_K (one error of all columns)
    rate
        also write the rate of change of each result and its standard uncertainty
    """

    method: Method = option("smoother", "Two-disk rig", choices=METHODS, takes=str)
    criterion: Criterion | None = option(
        None, "Two-disk rig", choices=get_args(Criterion), takes=str
    )
    bandwidth_Hz: float | None = option(None, "Two-disk rig", low=0, high=1e4)
    components: bool = option(False, "Output")
    rate: bool = option(False, "Output")

    def __post_init__(self) -> None:
        """Check the settings of one method each.

        Raises
        ------
        InputError
            For a setting of another method.
        """
        super().__post_init__()
        for name, needed in (("criterion", "deconvolve"), ("bandwidth_Hz", "inverse")):
            if getattr(self, name) is not None and self.method != needed:
                raise InputError(
                    f"{{{name}}} with {{method}} {self.method}",
                    remedy=f"give {{method}} {needed}, or leave it out",
                    parameters={name: None, "method": None},
                )
        if self.rate and not self.removes_lag:
            raise InputError(
                "{rate} with the method noise-only",
                expected="a method that removes the lag: with it, the rate of change lags behind",
                parameters={"rate": True},
            )

    @property
    def weight_criterion(self) -> Criterion:
        """Criterion that chooses the weight of the method deconvolve."""
        return self.criterion or "gcv"

    @property
    def filter_bandwidth_Hz(self) -> float:
        """Bandwidth of the method inverse [Hz]."""
        return self.bandwidth_Hz or DEFAULT_BANDWIDTH_HZ

    @property
    def removes_lag(self) -> bool:
        """Whether the result is the temperature at the junction."""
        return self.method != "noise-only"

    def output_names(self, unit: Unit, column: str) -> list[str]:
        """Names of the columns of one sensor in the output, in their order."""
        names = unit.names(column)
        listed = [names.logged, names.result]
        if not self.removes_lag:
            return listed
        listed.append(names.u)
        if self.components:
            listed += [names.noise_u, names.record_u, names.common_u]
        if self.rate:
            listed += [names.rate, names.rate_u]
        return listed


def output_header(
    columns: Sequence[str], units: Mapping[str, Unit], method: CompensationMethod, where: str
) -> list[str]:
    """Columns of the output: those of a sensor stand together, in place of the logged column.

    Parameters
    ----------
    columns
        Columns of the log.
    units
        Unit of each column that is compensated.
    method
        Decides which columns a sensor has.
    where
        The log, in messages.

    Raises
    ------
    InputError
        If two columns would have one name.
    """
    header = list[str]()
    for column in columns:
        header += method.output_names(units[column], column) if column in units else [column]
    duplicates = [name for name in header if header.count(name) > 1]
    if duplicates:
        raise InputError(
            f"the output would hold column {duplicates[0]!r} twice",
            where=where,
            expected="names that the columns of results do not have",
            remedy="rename it",
        )
    return header


# Smooths channels together: the readings, from the sample on at which the result begins, and it.
Smoother = Callable[[ChannelReadings], tuple[ChannelReadings, Compensated]]


class Channels(Protocol):
    """Channels of a source: which columns are theirs, and how they are read."""

    @property
    def units(self) -> Mapping[str, Unit]:
        """Columns that are replaced by results, in their order, and their units."""

    @property
    def lag_s(self) -> float:
        """Largest lag, for the margins of a segment [s]."""

    def readings(self, segment: TableSegment) -> tuple[list[ChannelReadings], list[Finding]]:
        """Readings that are smoothed together, and findings."""


@dataclass(frozen=True)
class CompensatedSegment:
    """Rows of the output.

    Attributes
    ----------
    segment
        What was read.
    columns
        Columns (R,) of the output: those of the source, and the results.
    numbers
        By column: noise, typical and largest standard deviation [K, or the unit of the column if it
        is no temperature], and shortest time whose means are determined [s], NaN where it is not
        known (4,).
    flags
        By column: flags of the samples of all rows, see ``Compensated``.
    decimals
        By column of a result: number of decimals that its uncertainty here asks for.
    findings
        Findings.
    delayed
        With a delay: what it passes on to the next one.
    rows
        Rows of the segment in the middle of means; None: all rows.
    means_s
        Length of these means [s]; None: there are none.
    """

    segment: TableSegment
    columns: dict[str, NDArray[Any]]
    numbers: dict[str, Array]
    flags: dict[str, NDArray[np.uint8]]
    decimals: dict[str, int]
    findings: list[Finding]
    delayed: DelayedSmoother | None = None
    rows: NDArray[np.intp] | None = None
    means_s: float | None = None

    @property
    def time_s(self) -> Array:
        """Times of the rows of the segment [s]."""
        return self.segment.time_s[self.segment.keep]

    @property
    def output_time_s(self) -> Array:
        """Times of the rows of the output (R,) [s]."""
        return self.time_s if self.rows is None else self.time_s[self.rows]

    def frame(self, header: Sequence[str], first_row: int = 0) -> pd.DataFrame:
        """The columns ``header``; the index is the number of the row, from ``first_row`` on."""
        rows = np.arange(len(self.time_s)) if self.rows is None else self.rows
        index = first_row + rows
        return pd.DataFrame({name: self.columns[name] for name in header}, index)


def compensate_readings(
    readings: ChannelReadings,
    method: CompensationMethod,
    events: Mapping[float, float] | None = None,
    means: MeanTimes | None = None,
) -> Compensated:
    """Compensate channels together.

    Parameters
    ----------
    readings
        The channels.
    method
        The method.
    events
        Time [s] of each listed event on the clock of the source, and its standard uncertainty [s].
        With an empty mapping, or None, events are detected.
    means
        Means that are wanted, by the smoother; None: none.
    """
    y = readings.base
    dt = readings.dt_s
    options: dict[str, Any] = {
        "noise_sd": readings.noise_K,
        "lag_covariance": readings.lag_covariance_s2,
        "static_u": readings.static_u_K,
        "names": readings.names,
        "units": [unit.base for unit in readings.units],
    }
    if readings.flow is not None and method.method in ("inverse", "deconvolve"):
        raise InputError(
            "a lag that follows a flow", expected="the smoother, the method without an option"
        )
    if method.method == "inverse":
        return invert(y, dt, readings.chains, method.filter_bandwidth_Hz, **options)
    options["split_u_s"] = readings.split_u_s
    if method.method == "deconvolve":
        return deconvolve(y, dt, readings.chains, criterion=method.weight_criterion, **options)[0]
    end_s = readings.start_s + (len(y) - 1) * dt
    inside = {
        float(t - readings.start_s): u
        for t, u in (events or {}).items()
        if readings.start_s <= t <= end_s
    }
    return smooth(
        y,
        dt,
        readings.chains,
        events_s=[*inside],
        event_u_s=[*inside.values()],
        late_s=readings.late_s,
        switched=readings.others,
        laws=None if readings.flow is None else readings.laws,
        flow=readings.flow,
        flow_u=0.0 if readings.flow_u is None else readings.flow_u,
        means=means,
        **options,
    )


def result_columns(
    readings: ChannelReadings, result: Compensated
) -> tuple[Array, Array, Array, Array, Array]:
    """Values of some channels, their standard uncertainty and its components.

    Parameters
    ----------
    readings
        Readings of the channels.
    result
        Their smoothed temperatures, or means of them.

    Returns
    -------
    value, u, noise_u, record_u, common_u
        Of the samples (N, M), or of the means (W, M): u is the root of the sum of the squares of
        the last three. The first of them differs from row to row, the second is one error of a
        channel in the whole log, the third one error of all channels.
    """
    value, u = result.determined_estimates()
    noise_u = result.noise_sd_of_rows()
    common_u = np.hypot(result.common_sd(), readings.shared_u_K)
    means = result.means
    if means is not None:
        value, u, noise_u = means.mean, means.sd, means.sd_noise
        common_u = np.hypot(means.common_sd(result.lag_covariance), readings.shared_u_K)
    record_u = np.sqrt(np.maximum(u**2 - noise_u**2 - common_u**2, 0.0))
    is_withheld = np.isnan(u)
    noise_u = np.where(is_withheld, np.nan, noise_u)
    common_u = np.where(is_withheld, np.nan, common_u)
    return value, u, noise_u, record_u, common_u


def output_columns(
    readings: ChannelReadings,
    result: Compensated,
    method: CompensationMethod,
    rows: slice | None = None,
) -> tuple[dict[str, Array], dict[str, int]]:
    """Results for the output for some rows of a segment.

    Parameters
    ----------
    readings
        Readings of the channels.
    result
        Their smoothed temperatures.
    method
        Decides the columns, see its ``output_names``.
    rows
        Rows of the segment (R,); all by default. Of means all are returned.

    Returns
    -------
    columns
        Arrays (R,): values, u with its components, and rates, in the unit of the output.
    decimals
        Number of decimals of each, from its uncertainty; of those without an uncertainty none.
    """
    samples = readings.sample_of_row[rows or slice(None)]
    if result.means is not None:
        samples = np.arange(len(result.means.sample), dtype=np.intp)
    of_results = result_columns(readings, result)
    temperature, sd, noise_u, record_u, common_u = of_results
    rate, rate_sd = result.determined_rates()
    rate_u = np.hypot(rate_sd, readings.gain_u_rel * rate)
    columns: dict[str, Array] = {}
    decimals: dict[str, int] = {}
    for i, (column, unit) in enumerate(zip(readings.columns, readings.units)):
        names = unit.names(column)
        values = {
            names.result: unit.from_base(temperature[samples, i]),
            names.u: unit.per_base * sd[samples, i],
            names.noise_u: unit.per_base * noise_u[samples, i],
            names.record_u: unit.per_base * record_u[samples, i],
            names.common_u: unit.per_base * common_u[samples, i],
        }
        if result.means is None:
            values[names.rate] = unit.per_base * rate[samples, i]
            values[names.rate_u] = unit.per_base * rate_u[samples, i]
        uncertainty_of = {names.result: names.u, names.rate: names.rate_u}
        for name in method.output_names(unit, column)[1:]:
            columns[name] = values[name]
            count = decimals_for(values[name], values[uncertainty_of.get(name, name)])
            if count is not None:
                decimals[name] = count
    return columns, decimals


def compensate_segment(
    segment: TableSegment,
    channels: Channels,
    method: CompensationMethod,
    smoother: Smoother,
) -> CompensatedSegment:
    """Compensate one segment; channels without a result are NaN.

    Parameters
    ----------
    segment
        The segment.
    channels, method
        As for ``compensated_segments``.
    smoother
        Smooths channels together.
    """
    columns_read: dict[str, NDArray[Any]] = {n: v[segment.keep] for n, v in segment.data.items()}
    columns = dict(columns_read)
    no_result = np.full(len(segment.time_s[segment.keep]), np.nan)
    decimals: dict[str, int] = {}
    for column, unit in channels.units.items():
        logged, *results = method.output_names(unit, column)
        columns |= dict.fromkeys(results, no_result)
        columns[logged] = columns_read[column]
    prepared, findings = channels.readings(segment)
    findings = [*segment.findings, *findings]
    numbers: dict[str, Array] = {}
    flags: dict[str, NDArray[np.uint8]] = {}
    rows: NDArray[np.intp] | None = None
    means_s: float | None = None
    for group in prepared:
        for readings, result in _smooth_together_or_singly(group, smoother, findings):
            of_group, decimals_of_group = output_columns(readings, result, method, segment.keep)
            decimals |= decimals_of_group
            samples = readings.sample_of_row[segment.keep]
            if result.means is None:
                sd = result.determined_estimates()[1][samples]
            else:
                sd = result.means.sd
                means_s = result.means.length_s
                if rows is None:
                    rows = np.searchsorted(samples, result.means.row)
                    columns = {name: values[rows] for name, values in columns.items()}
            columns |= of_group
            for i, column in enumerate(readings.columns):
                flags[column] = result.flags[samples, i]
                if readings.is_left_out is not None:
                    is_left_out = readings.is_left_out[segment.keep, i]
                    flags[column] = np.where(is_left_out, IMPLAUSIBLE, flags[column])
                numbers[column] = np.full(4, np.nan)
                if np.isfinite(sd[:, i]).any():
                    typical = np.nanmedian(sd[:, i])
                    largest = np.nanmax(sd[:, i])
                    numbers[column][:3] = [result.noise_sd[i], typical, largest]
                if result.resolution_s is not None:
                    numbers[column][3] = result.resolution_s[i]
    return CompensatedSegment(
        segment, columns, numbers, flags, decimals, findings, rows=rows, means_s=means_s
    )


def _smooth_together_or_singly(
    readings: ChannelReadings,
    smoother: Smoother,
    findings: list[Finding],
) -> Iterator[tuple[ChannelReadings, Compensated]]:
    """Smooth channels together; where that fails one by one, with a warning for each that fails.

    Parameters
    ----------
    readings
        Readings of the channels. If they are not separable, the first error is raised.
    smoother
        Smooths channels together.
    findings
        The findings are appended to it.

    Yields
    ------
    tuple
        Readings and result of the channels that could be smoothed.
    """
    try:
        of_result, result = smoother(readings)
    except InputError as problem:
        if not readings.is_separable:
            raise
        if len(readings.columns) == 1:
            subject = readings.columns[0]
            findings.append(warning("sensor.left", subject=subject, problem=problem.what))
            return
        for i in range(len(readings.columns)):
            yield from _smooth_together_or_singly(readings.single(i), smoother, findings)
        return
    if readings.disk:
        findings += [finding.at(readings.disk) for finding in result.findings]
    else:
        findings += result.findings
    yield of_result, result


def compensated_segments(
    source: ChunkSource,
    columns: Sequence[str],
    channels: Channels,
    method: CompensationMethod | None = None,
    events: Mapping[float, float] | None = None,
    *,
    min_rows: int | None = None,
    delay_s: float | None = None,
    position: SegmentPosition | None = None,
    delayed: DelayedSmoother | None = None,
    means_s: float | None = None,
) -> Iterator[CompensatedSegment]:
    """Compensate a source of rows segment by segment, in bounded memory.

    Parameters
    ----------
    source
        Rows in chunks.
    columns
        Columns to read: those of the output, and others that ``channels`` needs.
    channels
        How the readings are made, and with which chains they are compensated.
    method
        The method; the smoother by default.
    events
        Listed events, see ``compensate_readings``.
    min_rows, delay_s, position
        Of the segments, see ``tcdyn.sensors.segments.read_segments``.
    delayed
        With a delay: what earlier blocks passed on; None: nothing.
    means_s
        Length of the times whose means are wanted instead of the rows [s]; without a delay.

    Notes
    -----
    The rows do not depend on how the source is divided into chunks.
    """
    method = method or CompensationMethod()
    delayed = delayed or DelayedSmoother()

    start_s: float | None = None
    keep = slice(None)

    def at_once(readings: ChannelReadings) -> tuple[ChannelReadings, Compensated]:
        """Smooth channels from the readings of one segment alone."""
        means = None
        if means_s is not None and start_s is not None:
            rows = readings.sample_of_row[keep]
            means = MeanTimes(means_s, start_s - readings.start_s, rows)
        return readings, compensate_readings(readings, method, events, means)

    # a mean next to the end of a segment needs its rows on both sides
    settling_s = max(channels.lag_s, means_s or 0.0)
    for segment in read_segments(
        source, columns, settling_s, min_rows, delay_s=delay_s, position=position
    ):
        keep = segment.keep
        if start_s is None:
            start_s = float(segment.time_s[keep][0])
        if delay_s is None:
            yield compensate_segment(segment, channels, method, at_once)
        else:
            needed = delayed.begin(segment)
            result = compensate_segment(needed, channels, method, delayed.smooth)
            yield replace(result, segment=segment, delayed=delayed.passed_on())


@dataclass
class Totals:
    """What was written so far.

    Attributes
    ----------
    rows, first_s, last_s
        Rows that were written, and the times of the first and the last row that was read [s].
    rows_read
        Rows that were read.
    numbers
        By column: the ``numbers`` of each segment.
    not_used
        By column: readings that were treated as missing, and the time of the first [s].
    decimals
        Number of decimals by column, each from the first segment with a result.
    findings
        Findings, the first of each code about each subject.
    metadata
        Metadata of the output.
    means_s
        Length of the means that were written [s]; None: rows.
    """

    rows: int = 0
    rows_read: int = 0
    first_s: float = np.inf
    last_s: float = -np.inf
    numbers: dict[str, list[Array]] = field(default_factory=dict)
    not_used: dict[str, tuple[int, float]] = field(default_factory=dict)
    decimals: dict[str, int] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    metadata: dict[str, str] = field(default_factory=dict)
    means_s: float | None = None

    def add(self, result: CompensatedSegment) -> None:
        """Add one segment."""
        time_s = result.time_s
        self.decimals = {**result.decimals, **self.decimals}
        self.rows += len(result.output_time_s)
        self.rows_read += len(time_s)
        self.first_s = min(self.first_s, *time_s.tolist()[:1])
        self.last_s = max(self.last_s, *time_s.tolist()[-1:])
        for column, numbers in result.numbers.items():
            self.numbers.setdefault(column, []).append(numbers)
        for column, flags in result.flags.items():
            bad = (flags != GOOD) & (flags != MISSING)
            if bad.any():
                count, first_s = self.not_used.get(column, (0, float(time_s[np.argmax(bad)])))
                self.not_used[column] = (count + int(np.count_nonzero(bad)), first_s)
        self.findings = unique_by_subject([*self.findings, *result.findings])

    def table(self, units: Mapping[str, Unit]) -> pd.DataFrame:
        """Noise, typical and largest standard deviation, and resolution of each column, or NaN.

        The resolution is left out where it is not known, as with a delay. The others are in
        kelvins; if a column is no temperature, the names of the columns do not say so,
        and ``unit`` is the unit of each.
        """
        rows = []
        are_temperatures = all(unit.is_temperature for unit in units.values())
        suffix = "_K" if are_temperatures else ""
        for column, unit in units.items():
            each = np.array(self.numbers.get(column) or [np.full(4, np.nan)])
            determined = np.isfinite(each[:, 1])
            if determined.any():
                each = each[determined]
            row = {
                "column": column,
                f"noise_sd{suffix}": np.median(each[:, 0]),
                f"sd_typical{suffix}": np.median(each[:, 1]),
                f"sd_max{suffix}": np.max(each[:, 2]),
                "resolution_s": np.max(each[:, 3]),
            }
            if not are_temperatures:
                row["unit"] = unit.base_difference
            rows.append(row)
        table = pd.DataFrame(rows)
        is_known = table["resolution_s"].notna().any()
        return table if is_known else table.drop(columns="resolution_s")


def write_segments(
    out: str | Path | Callable[[pd.DataFrame], None],
    header: Sequence[str],
    notes: Mapping[str, str],
    segments: Iterator[CompensatedSegment],
    progress: Callable[[int], None] = lambda _: None,
    *,
    style: OutputStyle = STANDARD_STYLE,
    time: str = "",
) -> Totals:
    """Write compensated segments to a file, which appears when all of them are there.

    Parameters
    ----------
    out
        Output, .csv or .parquet; or a function that is called with the rows, part by part.
    header, notes
        Columns and metadata.
    segments
        The segments; their first decides which columns are text.
    progress
        Called with the number of rows that were written, before each segment and at the end.
    style
        How a file is written.
    time
        Column with the time as in the source. If it holds stamps with a date, the metadata state
        the date and time of the first row.
    """
    totals = Totals(metadata=dict(notes))
    progress(0)
    result = next(segments, None)
    text = [] if result is None else text_columns(result, header)
    if result is not None and time:
        start = start_time(result.segment.data, time, result.segment.time_s)
        if start:
            totals.metadata[START_TIME_KEY] = start
    if result is not None and result.means_s is not None:
        totals.means_s = result.means_s
        totals.metadata["means_s"] = f"{result.means_s:.6g}"
    writer: AbstractContextManager[Callable[[pd.DataFrame], None]]
    if callable(out):
        writer = nullcontext(out)
    else:
        writer = log_writer(out, header, totals.metadata, text, style=style)
    with writer as write:
        while result is not None:
            frame = result.frame(header, totals.rows_read)
            totals.add(result)
            write(frame if callable(out) else rounded_for_file(frame, totals.decimals, out))
            progress(totals.rows_read)
            result = next(segments, None)
    return totals


def text_columns(result: CompensatedSegment, header: Sequence[str]) -> list[str]:
    """The columns of ``header`` that are text, such as clock stamps."""
    return [name for name in header if result.columns[name].dtype == object]
