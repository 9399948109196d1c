"""Compensation of a full log: static lines and chains removed, junction temperatures with u.

The command ``tcdyn compensate`` for logs of the rig; tables of other sensors are
:mod:`tcdyn.workflows.compensate_table`. The stages of a run are
:mod:`tcdyn.workflows.compensate_stages`. The estimator is that of :mod:`tcdyn.smoothing`. Guarded
by ``tests/cli/test_compensate_command.py``, ``tests/smoothing/test_long_log.py`` and
``tests/smoothing/test_traces.py``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tcdyn.campaign.stages import MAX_ROWS, read_stage
from tcdyn.core import Array
from tcdyn.core.arguments import with_named_arguments
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, labelled_messages, unique_by_subject
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
from tcdyn.rig.log import Log, LogChunks, open_log_for_records
from tcdyn.rig.opened_log import check_any_given, rig_from_records
from tcdyn.rig.record import DiskRecord
from tcdyn.rig.rigfile import Rig
from tcdyn.sensors.compensation import (
    CompensationMethod,
    compensated_segments,
    output_header,
    write_segments,
)
from tcdyn.sensors.decimals import rounded_for_file
from tcdyn.series.clock import mean_interval_s
from tcdyn.smoothing.inverse import FilterReport, proper_inverse, report_inverse
from tcdyn.smoothing.record import Compensated
from tcdyn.smoothing.traces import DiskTraces, summarise_spikes
from tcdyn.smoothing.windows import window_means
from tcdyn.workflows.compensate_stages import (
    CompensatedDisks,
    EventsAndLags,
    OpenedLog,
    compensate_disks,
    events_since_start,
    find_events_and_lags,
    make_traces,
)
from tcdyn.workflows.compensate_table import compensate_table
from tcdyn.workflows.rig_channels import DiskColumns

# Least rows of a segment of a long log; with its margins it has about as many rows as a log that is
# compensated in one piece.
SEGMENT_ROWS = 100_000


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
    method = _method_of(way, parts=parts, rate=rate, delay_s=delay_s)
    progress("reading the log")
    chunks, missing = open_log_for_records(log, rig, records)
    opened = OpenedLog(chunks, log_around_unloading(chunks), rig, records, missing)
    if delay_s is not None:
        return _compensate_with_delay(log, opened, method, delay_s, progress)
    refines_lags = refine and method.removes_lag
    lags = find_events_and_lags(opened, refine=refines_lags, progress=progress)
    traces, notes = make_traces(opened, lags, method)
    progress(f"junctions, {' and '.join(records)}")
    disks = compensate_disks(opened, traces, method, lags.events_at_s)
    return _result(opened, method, lags, traces, notes, disks)


def _method_of(
    way: CompensationMethod | None, *, parts: bool, rate: bool, delay_s: float | None
) -> CompensationMethod:
    """The method with the columns that are requested; the parameters are those of the caller.

    Raises
    ------
    InputError
        For a method or components of the uncertainty with a delay.
    """
    if delay_s is not None and (way is not None or parts):
        raise InputError(
            "{way} or {parts} with {delay_s}",
            remedy="leave one of them out",
            parameters=dict.fromkeys(("way", "parts", "delay_s")),
        )
    method = way or CompensationMethod()
    return replace(method, components=method.components or parts, rate=method.rate or rate)


def _compensate_with_delay(
    log: str | Path | Sequence[str | Path],
    opened: OpenedLog,
    method: CompensationMethod,
    delay_s: float,
    progress: Progress,
) -> CompensatedLog:
    """Compensate each row with the rows that are there ``delay_s`` after it.

    Parameters
    ----------
    log
        The file or files of the log, which are read again.
    opened
        The log.
    method
        States whether the rate of change is written.
    delay_s
        The delay [s].
    progress
        Called with the name of each stage.
    """
    rows: list[pd.DataFrame] = []
    done = compensate_table(
        log,
        opened.records,
        rows.append,
        rig=opened.rig,
        delay_s=delay_s,
        rate=method.rate,
        progress=progress,
    )
    return CompensatedLog(
        frame=pd.concat(rows, ignore_index=True),
        metadata=done.metadata,
        findings=done.findings,
        disks={},
        traces={},
        events_s=(),
        raw_log=opened.table,
        method=method,
        decimals=done.decimals,
        numbers=done.numbers,
        sources=opened.chunks.sources,
    )


def _result(
    opened: OpenedLog,
    method: CompensationMethod,
    lags: EventsAndLags,
    traces: Mapping[str, DiskTraces],
    notes_of_traces: Mapping[str, str],
    disks: CompensatedDisks,
) -> CompensatedLog:
    """The table of a compensated log, with its metadata and findings.

    Parameters
    ----------
    opened
        The log.
    method
        The method.
    lags
        Events and fits of the common lags.
    traces
        Traces by disk.
    notes_of_traces
        Metadata about them.
    disks
        The compensated channels.
    """
    names = [*opened.table.frame.columns]
    header = output_header(names, disks.units, method, opened.name)
    notes = {**opened.notes(method), **notes_of_traces}
    spikes = summarise_spikes(opened.table.findings)
    segments = None
    if not opened.is_in_memory:
        channels = DiskColumns(
            opened.rig, opened.records, lags.fits, opened.is_ehl, method.removes_lag, opened.name
        )
        segments = LogSegments(
            opened.chunks, channels, method, lags.events_at_s, names, header, notes
        )
    return CompensatedLog(
        frame=disks.to_frame(opened, header),
        metadata=notes,
        findings=(*spikes, *lags.findings, *disks.findings),
        disks=disks.results,
        traces=traces,
        events_s=events_since_start(opened, lags, disks),
        raw_log=opened.table,
        method=method,
        decimals=disks.decimals,
        segments=segments,
        sources=opened.chunks.sources,
    )


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
