"""Compensation of a full log: static lines and chains removed, junction temperatures with u.

The command ``tcdyn compensate`` for logs of the rig; tables of other sensors are
:mod:`tcdyn.workflows.compensate_table`. The estimator is that of :mod:`tcdyn.smoothing`. Guarded by
``tests/cli/test_compensate_command.py``, ``tests/smoothing/test_long_log.py`` and
``tests/smoothing/test_traces.py``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tcdyn.campaign.stages import MAX_ROWS, all_events, read_stage
from tcdyn.core import Array
from tcdyn.core.arguments import with_named_arguments
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, info, labelled_messages, unique_by_subject, warning
from tcdyn.core.progress import Progress, no_progress
from tcdyn.core.result import Result
from tcdyn.core.threads import one_blas_thread
from tcdyn.io.endings import check_size
from tcdyn.io.read import Table, open_table
from tcdyn.io.table import SourceFile
from tcdyn.io.write import (
    STANDARD_STYLE,
    DialectName,
    OutputStyle,
    check_not_input,
    dialect_findings,
    output_style,
    write_log,
)
from tcdyn.partition.analyse import refine_lags
from tcdyn.partition.joint import DiskFit
from tcdyn.partition.prepare import prepare_test
from tcdyn.partition.steady import with_inner_row_at_one_radius
from tcdyn.rig.contact import Events
from tcdyn.rig.disk import DISKS
from tcdyn.rig.log import COMPENSATED, Log, LogChunks, open_log_for_records
from tcdyn.rig.opened_log import check_any_given, rig_from_records
from tcdyn.rig.record import DiskRecord
from tcdyn.rig.rigfile import Rig
from tcdyn.sensors.compensation import (
    CompensationMethod,
    compensate_readings,
    compensated_segments,
    output_columns,
    output_header,
    write_segments,
)
from tcdyn.sensors.decimals import rounded_for_file
from tcdyn.series.clock import mean_interval_s
from tcdyn.series.units import Unit
from tcdyn.smoothing.inverse import FilterReport, proper_inverse, report_inverse
from tcdyn.smoothing.record import Compensated
from tcdyn.smoothing.traces import DiskTraces, disk_traces, summarise_spikes
from tcdyn.smoothing.windows import window_means
from tcdyn.workflows.compensate_table import compensate_table
from tcdyn.workflows.raw_log import source_notes
from tcdyn.workflows.rig_channels import DiskColumns, disk_readings, with_common_lag

# Least rows of a segment of a long log; with its margins it has about as many rows as a log that is
# compensated in one piece.
SEGMENT_ROWS = 100_000
# Note in the metadata where the lag is not removed.
NOISE_ONLY = "noise removed (smoother), static lines applied, lag left in"


@dataclass(frozen=True)
class LogSegments:
    """How all rows of a long log are compensated, segment by segment.

    Attributes
    ----------
    log, channels
        The log, and how its channels are read.
    method, events
        The method, and the listed events, see ``tcdyn.sensors.compensation.compensate_readings``.
    columns, header
        Columns of the log and of the output.
    notes
        Metadata of the output.
    """

    log: LogChunks
    channels: DiskColumns
    method: CompensationMethod
    events: Mapping[float, float]
    columns: Sequence[str]
    header: Sequence[str]
    notes: Mapping[str, str]

    def read_chunks(
        self, columns: Sequence[str]
    ) -> Iterator[tuple[Array, dict[str, Array], tuple[Finding, ...]]]:
        """Time (N,) [s] and columns (N,) of each chunk, and findings."""
        for chunk in self.log:
            yield (
                chunk.frame["time_s"].to_numpy(),
                {name: chunk.frame[name].to_numpy() for name in columns},
                chunk.findings,
            )

    def write(
        self,
        out: str | Path,
        progress: Progress,
        style: OutputStyle = STANDARD_STYLE,
    ) -> list[Finding]:
        """Write all rows to ``out`` in this style, atomically; return the findings."""
        reported_percent = 0

        def report(rows: int) -> None:
            """Report the rows that are done, every ten percent."""
            nonlocal reported_percent
            percent = 10 * (10 * rows // self.log.rows)
            if percent > reported_percent:
                reported_percent = percent
                progress(f"writing, {percent} % of the rows")

        segments = compensated_segments(
            self, self.columns, self.channels, self.method, self.events, min_rows=SEGMENT_ROWS
        )
        totals = write_segments(out, self.header, self.notes, segments, report, style=style)
        return summarise_spikes(totals.findings)


@dataclass(frozen=True, repr=False)
class CompensatedLog(Result):
    """The log with junction temperatures beside the readings, and ``<channel>_u_K`` for each.

    ``<channel>_logged_degC`` is the reading as logged, ``<channel>_degC`` the junction temperature.
    With ``parts``, ``<channel>_noise_u_K`` is the uncertainty that differs from sample to sample,
    and ``<channel>_common_u_K`` the one common to all channels of a disk: common lag and oven
    reference. With ``rate``, ``<channel>_rate_K_s`` is the rate of change of the junction
    temperature, and ``<channel>_rate_u_K_s`` its standard uncertainty. Where only noise was removed
    there is no uncertainty.

    Attributes
    ----------
    frame, metadata, findings
        Table, notes and findings. The numbers are not rounded. Of a log of more than 120,000 rows
        ``frame`` holds the rows around the unloading; ``write`` compensates all rows, segment by
        segment.
    disks, traces
        Compensated channels, and what the compensator used, by disk.
    events_s
        Times at which slopes may jump [s after the first sample]; the last is the unloading.
    raw_log, method
        The log as it was recorded, and the method.
    segments
        How to compensate the remaining rows of a long log; None for a short one.
    decimals
        Number of decimals in a CSV file, of each column with results.
    numbers
        Noise and standard deviation of each column with a fixed delay, where ``disks`` and
        ``traces`` are empty; otherwise None.
    sources
        The files of the log, where it has several.
    """

    frame: pd.DataFrame
    metadata: dict[str, str]
    findings: tuple[Finding, ...]
    disks: Mapping[str, Compensated]
    traces: Mapping[str, DiskTraces]
    events_s: tuple[float, ...]
    raw_log: Log
    method: CompensationMethod
    decimals: Mapping[str, int]
    segments: LogSegments | None = None
    numbers: pd.DataFrame | None = None
    sources: tuple[SourceFile, ...] = ()

    def headline(self) -> str:
        """Name and length of the log."""
        return f"{self.raw_log.path.name}, {len(self.frame)} rows"

    def to_frame(self) -> pd.DataFrame:
        """The table over the time [s]."""
        return self.frame.set_index("time_s")

    def summary(self) -> str:
        """The lag removed and the uncertainty that remains, a few lines a disk."""
        lines = []
        for disk, done in self.disks.items():
            lines += (
                [f"{disk}: common lag {self.metadata[f'{disk}_common_lag_s']}"]
                if self.method.removes_lag
                else []
            )
            lines += done.lines(self.traces[disk].setup.channels)
        return "\n".join([*lines, *labelled_messages(self.findings)])

    def to_dict(self) -> dict[str, Any]:
        """Metadata, warnings and figures of each channel; the samples are in ``frame``."""
        disks = {disk: done.to_dict() for disk, done in self.disks.items()}
        return {"metadata": dict(self.metadata), "disks": disks, "warnings": list(self.warnings)}

    @one_blas_thread
    def write(
        self,
        path: str | Path,
        progress: Progress = no_progress,
        *,
        dialect: DialectName = "standard",
        comments: bool = False,
    ) -> tuple[Path, tuple[Finding, ...]]:
        """Write every row of the log to a file, completely or not at all.

        Parameters
        ----------
        path
            The file.
        progress
            Called with the name of each stage.
        dialect
            Of a CSV file: "standard" (UTF-8, commas, decimal points), or "input", as in the log.
        comments
            Whether the metadata are lines "# key: value" above the header of a CSV file, and not in
            a file ``<name>.csv.meta.json`` beside it.

        Returns
        -------
        path
            The file.
        findings
            Findings of the log and of all its segments.

        Raises
        ------
        InputError
            For a file that cannot be written, and for more rows than .xlsx or .nc can hold.
        """
        progress("writing")
        for file in [source.path for source in self.sources] or [self.raw_log.path]:
            check_not_input(path, file)
        rows = len(self.frame) if self.segments is None else self.segments.log.rows
        check_size(path, rows, len(self.frame.columns))
        style = STANDARD_STYLE
        if comments or dialect != "standard":
            table = None if dialect == "standard" else self._table_of_log()
            style = output_style(dialect, comments, table, path)
        findings = (*self.findings, *dialect_findings(self._table_of_log(), path, style))
        if self.segments is not None:
            segment_findings = self.segments.write(path, progress, style)
            return Path(path), unique_by_subject([*findings, *segment_findings])
        frame = rounded_for_file(self.frame, self.decimals, path)
        return write_log(frame, path, self.metadata, style=style), findings

    def _table_of_log(self) -> Table | None:
        """The file of the log, for its dialect; None if it is not there any more."""
        try:
            return open_table(self.raw_log.path)
        except (InputError, OSError):
            return None

    def as_log(self) -> Log:
        """The compensated log with the columns of the log: results only, as they were logged."""
        frame = self.frame[[name for name in self.raw_log.frame.columns if name in self.frame]]
        return replace(
            self.raw_log, frame=frame, metadata=dict(self.metadata), findings=self.findings
        )

    def card(self) -> pd.DataFrame:
        """Noise and standard deviation of every channel."""
        if self.numbers is not None:
            return self.numbers
        return pd.concat(
            [d.card().assign(disk=disk) for disk, d in self.disks.items()], ignore_index=True
        )

    def channels(self, disk: str) -> list[str]:
        """Names of the channels of ``disk`` in the log, without their unit."""
        return [name.removesuffix("_degC") for name in self.traces[disk].columns]

    def filter_report(self, disk: str) -> FilterReport:
        """The report on the proper inverse for the noisiest channel of ``disk``."""
        noise = self.disks[disk].noise_sd
        dt = self._dt_s
        inverses = [
            proper_inverse(chain, dt, self.method.filter_bandwidth_Hz)
            for chain in self.traces[disk].chains
        ]
        noisiest = int(np.argmax([f.noise_gain * sd for f, sd in zip(inverses, noise)]))
        return report_inverse(inverses[noisiest], float(noise[noisiest]))

    def covariance(self, length_s: float, start_s: float | None = None) -> dict[str, Any]:
        """Covariance between samples, and between the means of channels, over a window.

        Parameters
        ----------
        length_s
            Length of the window [s].
        start_s
            Its start on the clock of the log [s]; the last event when left out.

        Returns
        -------
        dict
            As ``tcdyn.smoothing.windows.window_means``.

        Raises
        ------
        InputError
            With a fixed delay, and as ``window_means`` does.
        """
        if not self.disks:
            raise InputError(
                "a result with a fixed delay has no covariance", remedy="leave out the delay"
            )
        time_s = self.frame["time_s"].to_numpy(dtype=float)
        return window_means(
            self.raw_log.path.name,
            time_s,
            self.events_s,
            self.traces,
            self.disks,
            length_s,
            start_s,
        )

    @property
    def _dt_s(self) -> float:
        """Sampling interval [s] of ``frame``."""
        return mean_interval_s(self.frame["time_s"].to_numpy(dtype=float))


@with_named_arguments
@one_blas_thread
def compensate_log(
    log: str | Path | Sequence[str | Path],
    records: Mapping[str, DiskRecord],
    rig: Rig | None = None,
    *,
    refine: bool = True,
    way: CompensationMethod | None = None,
    parts: bool = False,
    rate: bool = False,
    delay_s: float | None = None,
    progress: Progress = no_progress,
) -> CompensatedLog:
    """Compensate all channels of an EHL or immersion log that a record covers.

    Parameters
    ----------
    log, records, rig
        The log, one file or several in any order (:func:`tcdyn.series.joined.open_files`); records
        by disk; the rig (None: the one that the records were made with). How the
        rows are read, if the log does not say it itself, is stated by ``rig.with_reading``, with
        :class:`tcdyn.series.ReadingOptions`.
    refine
        Where the log has an unloading and records of all its disks are given: estimate the common
        lag of a disk from the unloading, with the record as prior. A plunge determines it loosely.
    way
        The method; the smoother by default.
    parts
        Whether to add columns with the components of the uncertainty.
    rate
        Whether to add columns with the rate of change of each result and its standard uncertainty.
    delay_s
        None: each row is compensated with all rows near it. A number [s]: with the rows that are
        there this long after it, and the lags of the records; the result is that of
        ``tcdyn.workflows.compensate_table.compensate_table`` and ``tcdyn.workflows.follow.follow``.
    progress
        Called with the name of each stage.

    Raises
    ------
    InputError
        For a log that is compensated already, or one that no record covers; for a method or
        components of the uncertainty with a delay.

    Notes
    -----
    The metadata of the log is carried over.

    Examples
    --------
    >>> from tcdyn import load_rig, read_record  # doctest: +SKIP
    >>> rig = load_rig("rig.toml")  # doctest: +SKIP
    >>> fast = read_record("fast.disk.json")  # doctest: +SKIP
    >>> slow = read_record("slow.disk.json")  # doctest: +SKIP
    >>> records = {"fast": fast, "slow": slow}  # doctest: +SKIP

    >>> done = compensate_log("EHL_B3.csv", records, rig)  # doctest: +SKIP
    >>> "fast_a_u_K" in done.to_frame()  # doctest: +SKIP
    True
    """
    check_any_given(records)
    rig = rig or rig_from_records(records)
    if delay_s is not None and (way is not None or parts):
        raise InputError(
            "{way} or {parts} with {delay_s}",
            remedy="leave one of them out",
            parameters=dict.fromkeys(("way", "parts", "delay_s")),
        )
    way = way or CompensationMethod()
    way = replace(way, components=way.components or parts, rate=way.rate or rate)
    progress("reading the log")
    pieces, unused = open_log_for_records(log, rig, records)
    kind = pieces.kind
    table = log_around_unloading(pieces)
    if delay_s is not None:
        rows: list[pd.DataFrame] = []
        done = compensate_table(
            log, records, rows.append, rig=rig, delay_s=delay_s, rate=rate, progress=progress
        )
        frame = pd.concat(rows, ignore_index=True)
        return CompensatedLog(
            frame,
            done.metadata,
            done.findings,
            {},
            {},
            (),
            table,
            way,
            done.decimals,
            numbers=done.numbers,
            sources=pieces.sources,
        )
    disks_in_log = {d for d in DISKS if any(n.startswith(f"{d}_") for n in table.channels)}
    notes = {
        **table.metadata,
        "tcdyn": COMPENSATED,
        "source": table.path.name,
        "source_sha256": table.sha256,
    }
    if pieces.sources:
        notes |= source_notes(pieces.sources)
    notes |= {} if way.removes_lag else {"method": NOISE_ONLY}
    findings = [*summarise_spikes(table.findings)]
    events_at_s = dict[float, float]()
    if refine and unused and way.removes_lag:
        refine = False
        findings.append(
            warning("compensate.unrefined", problem=f"the log holds no {', '.join(unused)}")
        )
    if kind == "ehl":
        try:
            each_test = all_events(pieces, table)
            for events in each_test:
                events_at_s |= {events.load_on_s: 0.0} | dict.fromkeys(
                    events.slope_changes_s, events.unload_u_s
                )
        except InputError as problem:  # slopes that jump are found by the smoother
            findings += (
                [warning("compensate.unrefined", problem=str(problem))]
                if way.removes_lag and refine
                else []
            )
            refine = False
        other = next(iter(records))
        findings += [
            info("compensate.one_disk", subject=d, other=other)
            for d in DISKS
            if d in disks_in_log and d not in records
        ]
    traces: dict[str, DiskTraces] = {}
    fits: Mapping[str, DiskFit] = {}
    if refine and way.removes_lag and kind == "ehl" and disks_in_log <= set(records):
        progress("common lags from the unloading")
        one_test = each_test[0] if len(each_test) == 1 and len(table.frame) == pieces.rows else None
        traces, fits, refine_findings = _refine_lags(table, rig, records, one_test)
        findings += refine_findings
    frame = table.frame
    for disk, record in records.items():
        disk_traces_used = traces.get(disk) or disk_traces(
            frame,
            disk,
            rig,
            record,
            prefixed=kind == "ehl",
            where=table.path.name,
            lag=way.removes_lag,
        )
        if way.removes_lag:
            disk_traces_used, notes[f"{disk}_common_lag_s"] = with_common_lag(
                disk_traces_used, record, fits.get(disk)
            )
        for name, sd in disk_traces_used.noise.to_dict().items():
            notes[f"{disk}_noise_{name}"] = f"{sd:.3g}"
        traces[disk] = disk_traces_used
    progress(f"junctions, {' and '.join(records)}")
    time_s = frame["time_s"].to_numpy(dtype=float)
    results: dict[str, Compensated] = {}
    units: dict[str, Unit] = {}
    columns: dict[str, Array] = {}
    decimals: dict[str, int] = {}
    for disk in records:
        disk_traces_used = traces[disk]
        readings = disk_readings(disk_traces_used, time_s)
        results[disk] = compensate_readings(readings, way, events_at_s)
        columns_of_disk, decimals_of_disk = output_columns(readings, results[disk], way)
        columns |= columns_of_disk
        decimals |= decimals_of_disk
        units |= dict(zip(readings.columns, readings.units))
        findings += [
            f.at(disk)
            for f in (*results[disk].findings, *disk_traces_used.extrapolation_findings("the log"))
        ]
        findings += disk_traces_used.findings
    header = output_header([*frame.columns], units, way, table.path.name)
    columns |= {unit.names(name).logged: frame[name].to_numpy() for name, unit in units.items()}
    frame = pd.DataFrame({name: columns.get(name, frame.get(name)) for name in header}, frame.index)
    t_start_s, t_end_s = (float(frame["time_s"].iloc[k]) for k in (0, -1))
    events_s = sorted(t - t_start_s for t in events_at_s if t_start_s < t <= t_end_s) or [
        t for t, _ in next(iter(results.values())).events_s
    ]
    segments = None
    if len(table.frame) == pieces.rows:
        frame = _with_time_stamps(frame, pieces)
    else:
        channels = DiskColumns(rig, records, fits, kind == "ehl", way.removes_lag, table.path.name)
        segments = LogSegments(
            pieces, channels, way, events_at_s, [*table.frame.columns], header, notes
        )
    return CompensatedLog(
        frame,
        notes,
        tuple(findings),
        results,
        traces,
        tuple(events_s),
        table,
        way,
        decimals,
        segments,
        sources=pieces.sources,
    )


def _with_time_stamps(frame: pd.DataFrame, log: LogChunks) -> pd.DataFrame:
    """The table with the clock stamps of the log, if it has some, after its first column.

    The name is that in the file, or "time_stamp" if another column of the table has it.
    """
    stamps = log.time_stamps()
    if stamps is None:
        return frame
    name, cells = stamps
    result = frame.copy(deep=False)
    result.insert(1, "time_stamp" if name in frame else name, cells)
    return result


def log_around_unloading(pieces: LogChunks) -> Log:
    """The log; of a long one the rows around the unloading, or the first rows without one.

    Long is more than ``tcdyn.campaign.stages.MAX_ROWS`` rows.
    """
    if pieces.rows <= MAX_ROWS:
        return pieces.to_log()
    try:
        return read_stage(pieces, None)[0]
    except InputError:
        return pieces.to_log(np.arange(MAX_ROWS))


def _refine_lags(
    table: Log, rig: Rig, records: Mapping[str, DiskRecord], events: Events | None
) -> tuple[dict[str, DiskTraces], Mapping[str, DiskFit], list[Finding]]:
    """Traces and joint fits for the common lags of the disks, from the unloading.

    Parameters
    ----------
    table
        The log, or its rows around the unloading.
    rig, records
        The rig, and the record of each disk.
    events
        Loading and unloading, if they are known already.

    Returns
    -------
    traces
        Traces by disk; empty if the test could not be prepared.
    fits
        Joint fit of each disk; empty if a fit failed.
    findings
        A warning if it failed: the lags of the records are used then.
    """
    traces: dict[str, DiskTraces] = {}
    try:
        test = prepare_test(table, rig, records, events=events)
        traces = dict(test.disks)
        return traces, refine_lags(with_inner_row_at_one_radius(test)), []
    except InputError as problem:
        return traces, {}, [warning("compensate.unrefined", problem=str(problem))]
