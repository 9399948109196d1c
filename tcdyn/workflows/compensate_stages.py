"""Stages of the compensation of a log of the rig: events and lags, traces, disks, table.

:mod:`tcdyn.workflows.compensate` calls them in this order. Guarded by
``tests/cli/test_compensate_command.py`` and ``tests/smoothing/test_traces.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import pandas as pd

from tcdyn.campaign.stages import all_events
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, info, warning
from tcdyn.core.progress import Progress
from tcdyn.partition.analyse import refine_lags
from tcdyn.partition.joint import DiskFit
from tcdyn.partition.prepare import prepare_test
from tcdyn.partition.steady import with_inner_row_at_one_radius
from tcdyn.rig.contact import Events
from tcdyn.rig.disk import DISKS
from tcdyn.rig.log import COMPENSATED, Log, LogChunks
from tcdyn.rig.record import DiskRecord
from tcdyn.rig.rigfile import Rig
from tcdyn.sensors.compensation import (
    CompensationMethod,
    compensate_readings,
    output_columns,
)
from tcdyn.series.units import Unit
from tcdyn.smoothing.record import Compensated
from tcdyn.smoothing.traces import DiskTraces, disk_traces
from tcdyn.workflows.raw_log import source_notes
from tcdyn.workflows.rig_channels import disk_readings, with_common_lag

# Note in the metadata where the lag is not removed.
NOISE_ONLY = "noise removed (smoother), static lines applied, lag left in"


@dataclass(frozen=True)
class OpenedLog:
    """A log of the rig and the records that compensate it.

    Attributes
    ----------
    chunks
        The log.
    table
        Its rows in memory: all of them, or those around the unloading.
    rig, records
        The rig, and the record of each disk.
    missing
        Columns of the fit of the unloading that the log does not hold.
    """

    chunks: LogChunks
    table: Log
    rig: Rig
    records: Mapping[str, DiskRecord]
    missing: Sequence[str]

    @property
    def name(self) -> str:
        """Name of the file, for messages."""
        return self.table.path.name

    @property
    def is_ehl(self) -> bool:
        """Whether it is the log of an EHL test, in which the columns contain the disk's name."""
        return self.chunks.kind == "ehl"

    @property
    def is_in_memory(self) -> bool:
        """Whether all rows are in memory."""
        return len(self.table.frame) == self.chunks.rows

    @property
    def disks(self) -> set[str]:
        """Disks of which an EHL log holds channels."""
        channels = self.table.channels
        return {disk for disk in DISKS if any(name.startswith(f"{disk}_") for name in channels)}

    def notes(self, method: CompensationMethod) -> dict[str, str]:
        """Metadata of the log, its source and the method."""
        notes = {
            **self.table.metadata,
            "tcdyn": COMPENSATED,
            "source": self.name,
            "source_sha256": self.table.sha256,
        }
        if self.chunks.sources:
            notes |= source_notes(self.chunks.sources)
        if not method.removes_lag:
            notes["method"] = NOISE_ONLY
        return notes


@dataclass(frozen=True)
class EventsAndLags:
    """Events of a log, and the common lags that were estimated from its unloading.

    Attributes
    ----------
    events_at_s
        Standard uncertainty of the time of each event [s], by its time on the clock of the log [s].
    traces
        Traces by disk; empty where no lags were to be estimated.
    fits
        Joint fit by disk; empty: the lags are those of the records.
    findings
        Why no lags were estimated, and disks without a record.
    """

    events_at_s: Mapping[float, float]
    traces: Mapping[str, DiskTraces]
    fits: Mapping[str, DiskFit]
    findings: Sequence[Finding]


def find_events_and_lags(log: OpenedLog, *, refine: bool, progress: Progress) -> EventsAndLags:
    """Find the events of a log, and estimate the common lags of its disks from the unloading.

    Parameters
    ----------
    log
        The log.
    refine
        Whether lags are to be estimated. It takes an unloading, and records of all disks.
    progress
        Called with the name of the stage.
    """
    tests, problem = _events_of_tests(log)
    if log.missing:
        problem = f"the log holds no {', '.join(log.missing)}"
    findings: list[Finding] = []
    if refine and problem:
        findings.append(warning("compensate.unrefined", problem=problem))
    findings += _disks_without_record(log)
    traces: Mapping[str, DiskTraces] = {}
    fits: Mapping[str, DiskFit] = {}
    has_all_records = log.disks <= set(log.records)
    if refine and not problem and log.is_ehl and has_all_records:
        progress("common lags from the unloading")
        known_events = tests[0] if len(tests) == 1 and log.is_in_memory else None
        traces, fits, findings_of_fit = _refine_lags(log, known_events)
        findings += findings_of_fit
    return EventsAndLags(_times_of_events(tests), traces, fits, findings)


def _events_of_tests(log: OpenedLog) -> tuple[list[Events], str]:
    """Loading and unloading of each test in a log, and why there are none; a plunge has none."""
    if not log.is_ehl:
        return [], ""
    try:
        return all_events(log.chunks, log.table), ""
    except InputError as problem:  # slopes that jump are found by the smoother
        return [], str(problem)


def _times_of_events(tests: Sequence[Events]) -> dict[float, float]:
    """Time of each event on the clock of the log [s], with its standard uncertainty [s]."""
    u_s: dict[float, float] = {}
    for events in tests:
        u_s[events.load_on_s] = 0.0
        for time_s in events.slope_changes_s:
            u_s[time_s] = events.unload_u_s
    return u_s


def _disks_without_record(log: OpenedLog) -> list[Finding]:
    """Findings about disks of an EHL log that stay as logged."""
    if not log.is_ehl:
        return []
    other = next(iter(log.records))
    return [
        info("compensate.one_disk", subject=disk, other=other)
        for disk in DISKS
        if disk in log.disks and disk not in log.records
    ]


def _refine_lags(
    log: OpenedLog, events: Events | None
) -> tuple[Mapping[str, DiskTraces], Mapping[str, DiskFit], list[Finding]]:
    """Traces and joint fits for the common lags of the disks, from the unloading.

    Parameters
    ----------
    log
        The log, with the rows around the unloading in memory.
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
    traces: Mapping[str, DiskTraces] = {}
    try:
        test = prepare_test(log.table, log.rig, log.records, events=events)
        traces = test.disks
        return traces, refine_lags(with_inner_row_at_one_radius(test)), []
    except InputError as problem:
        return traces, {}, [warning("compensate.unrefined", problem=str(problem))]


def make_traces(
    log: OpenedLog, lags: EventsAndLags, method: CompensationMethod
) -> tuple[dict[str, DiskTraces], dict[str, str]]:
    """Traces of each disk that has a record, with the chains that are to be removed.

    Parameters
    ----------
    log
        The log.
    lags
        Traces that are there already, and fits of the common lags.
    method
        Decides whether the lag is removed.

    Returns
    -------
    traces
        Traces by disk.
    notes
        Metadata: common lag of each disk, and noise of its channels.
    """
    traces = dict(lags.traces)
    notes: dict[str, str] = {}
    for disk, record in log.records.items():
        if disk not in traces:
            traces[disk] = disk_traces(
                log.table.frame,
                disk,
                log.rig,
                record,
                prefixed=log.is_ehl,
                where=log.name,
                lag=method.removes_lag,
            )
        if method.removes_lag:
            fit = lags.fits.get(disk)
            traces[disk], common_lag = with_common_lag(traces[disk], record, fit)
            notes[f"{disk}_common_lag_s"] = common_lag
        for name, sd in traces[disk].noise.to_dict().items():
            notes[f"{disk}_noise_{name}"] = f"{sd:.3g}"
    return traces, notes


@dataclass(frozen=True)
class CompensatedDisks:
    """Compensated channels of the disks of a log.

    Attributes
    ----------
    results
        Compensated channels by disk.
    units
        Unit of each compensated column.
    columns
        Columns (N,) of the output, as logged and results.
    decimals
        Number of decimals in a CSV file, of each column with results.
    findings
        Findings about the channels.
    """

    results: Mapping[str, Compensated]
    units: Mapping[str, Unit]
    columns: Mapping[str, Array]
    decimals: Mapping[str, int]
    findings: Sequence[Finding]

    def to_frame(self, log: OpenedLog, header: Sequence[str]) -> pd.DataFrame:
        """The table of the output, with the other columns of the log.

        Parameters
        ----------
        log
            The log.
        header
            Columns of the output.
        """
        frame = log.table.frame
        columns = {name: self.columns.get(name, frame.get(name)) for name in header}
        table = pd.DataFrame(columns, frame.index)
        return _with_time_stamps(table, log.chunks) if log.is_in_memory else table


def compensate_disks(
    log: OpenedLog,
    traces: Mapping[str, DiskTraces],
    method: CompensationMethod,
    events_at_s: Mapping[float, float],
) -> CompensatedDisks:
    """Compensate the channels of each disk together.

    Parameters
    ----------
    log
        The log.
    traces
        Traces by disk.
    method
        The method.
    events_at_s
        Listed events, see ``tcdyn.sensors.compensation.compensate_readings``.
    """
    frame = log.table.frame
    time_s = frame["time_s"].to_numpy(dtype=float)
    results: dict[str, Compensated] = {}
    units: dict[str, Unit] = {}
    columns: dict[str, Array] = {}
    decimals: dict[str, int] = {}
    findings: list[Finding] = []
    for disk in log.records:
        readings = disk_readings(traces[disk], time_s)
        result = compensate_readings(readings, method, events_at_s)
        columns_of_disk, decimals_of_disk = output_columns(readings, result, method)
        results[disk] = result
        units |= dict(zip(readings.columns, readings.units))
        columns |= columns_of_disk
        decimals |= decimals_of_disk
        extrapolation = traces[disk].extrapolation_findings("the log")
        findings += [finding.at(disk) for finding in (*result.findings, *extrapolation)]
        findings += traces[disk].findings
    for name, unit in units.items():
        columns[unit.names(name).logged] = frame[name].to_numpy()
    return CompensatedDisks(results, units, columns, decimals, findings)


def events_since_start(
    log: OpenedLog, lags: EventsAndLags, disks: CompensatedDisks
) -> tuple[float, ...]:
    """Events of the rows in memory [s after the first sample]; without any, those of the smoother.

    Parameters
    ----------
    log, lags
        The log, and its listed events.
    disks
        The compensated channels.
    """
    time_s = log.table.frame["time_s"]
    start_s = float(time_s.iloc[0])
    end_s = float(time_s.iloc[-1])
    listed_s = sorted(t - start_s for t in lags.events_at_s if start_s < t <= end_s)
    if listed_s:
        return tuple(listed_s)
    first_disk = next(iter(disks.results.values()))
    return tuple(t for t, _ in first_disk.events_s)


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
