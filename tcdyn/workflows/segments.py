"""Compensation of one disk, and of logs that do not fit into memory, by overlapping segments.

Used by :mod:`tcdyn.workflows.compensate`. A segment has margins in which the smoother settles
(``tcdyn.smoothing.intervals.settling_time_s``). Guarded by ``tests/smoothing/test_long_log.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tcdyn.chain import sensors
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import text_with_u
from tcdyn.core.findings import Finding
from tcdyn.io.write import STANDARD_STYLE, OutputStyle, log_writer
from tcdyn.partition.cooling import SingleDiskFit, lag_covariance_with_common_u, refined_chains
from tcdyn.rig.check_clock import sample_interval_s
from tcdyn.rig.log import LogChunks
from tcdyn.rig.record import DiskRecord
from tcdyn.rig.rigfile import Rig
from tcdyn.rig.static_line import shared_u_K
from tcdyn.sensors.table import TableSegment, read_segments
from tcdyn.smoothing.intervals import settling_time_s
from tcdyn.smoothing.inverse import invert
from tcdyn.smoothing.process_noise import Criterion
from tcdyn.smoothing.record import Compensated
from tcdyn.smoothing.smoother import deconvolve, smooth
from tcdyn.smoothing.traces import DiskTraces, disk_traces, summarise_spikes

# Decimals of the output: 0.01 mK, far below the uncertainty of any sample.
DECIMALS = 5
# rows of a segment without its margins: memory; chosen by judgement
SEGMENT_ROWS = 50_000
Method = Literal["smoother", "deconvolve", "inverse", "noise-only"]
METHODS: tuple[Method, ...] = get_args(Method)


@dataclass(frozen=True)
class CompensationMethod:
    """How a log is compensated.

    Attributes
    ----------
    method
        "smoother" (RTS smoother); "deconvolve" with its ``criterion``; "inverse" of ``bandwidth_Hz``;
        or "noise-only": the smoother without the chain, which does not remove the lag.
    criterion, bandwidth_Hz
        Options of "deconvolve" and "inverse".
    """

    method: Method = "smoother"
    criterion: Criterion = "gcv"
    bandwidth_Hz: float = 0.5

    def __post_init__(self) -> None:
        """Check the name of the method; InputError for another one."""
        if self.method not in METHODS:
            raise InputError(f"method {self.method!r}", expected=" or ".join(METHODS))

    @property
    def removes_lag(self) -> bool:
        """Whether the result is the temperature at the junction."""
        return self.method != "noise-only"


def with_common_lag(
    traces: DiskTraces, record: DiskRecord, fit: SingleDiskFit | None
) -> tuple[DiskTraces, str]:
    """Traces with the common lag of a fit, if there is one, and a note about it.

    Parameters
    ----------
    traces
        Traces of the disk, with the chains of the record.
    record
        Its record.
    fit
        Joint fit of the disk, or None.

    Returns
    -------
    traces
        Traces with the chains and the covariance of the lags to use.
    note
        The common lag and where it comes from, for the metadata of the output.
    """
    if fit is not None:
        lag = fit.estimates["lag_s"]
        chains = refined_chains(traces.chains, fit.chain)
        traces = replace(
            traces,
            chains=chains,
            lag_covariance_s2=lag_covariance_with_common_u(traces.lag_covariance_s2, lag.u),
        )
        return traces, f"{text_with_u(lag.value, lag.u)} s, from the unloading, record as prior"
    assert record.chain is not None
    common = record.chain.common_lag_s
    return traces, f"{text_with_u(common.value, common.u)} s, from the record"


def compensate_disk(
    traces: DiskTraces, frame: pd.DataFrame, events: Mapping[float, float], way: CompensationMethod
) -> Compensated:
    """Compensate the traces of one disk.

    Parameters
    ----------
    traces
        The traces.
    frame
        Table of the log, for its times.
    events
        Standard uncertainty [s] by time of each event of the log [s]. Without events the smoother
        looks for them.
    way
        The method.

    Notes
    -----
    The uncertainty of the static lines includes what they have in common. Events are used by the
    smoother only.
    """
    time = frame["time_s"].to_numpy(dtype=float)
    y = traces.measured_degC
    dt = sample_interval_s(time)
    options: dict[str, Any] = {
        "noise_sd": traces.noise_K,
        "lag_covariance": traces.lag_covariance_s2,
        "static_u": np.hypot(traces.static_u(traces.readings_degC), shared_u_K(traces.lines)),
        "names": [c.removesuffix("_degC") for c in traces.columns],
    }
    if way.method != "inverse":
        options["split_u_s"] = traces.split_u_s
    if way.method == "deconvolve":
        return deconvolve(y, dt, traces.chains, criterion=way.criterion, **options)[0]
    if way.method == "inverse":
        return invert(y, dt, traces.chains, way.bandwidth_Hz, **options)
    event_times = {float(t - time[0]): u for t, u in events.items() if time[0] <= t <= time[-1]}
    return smooth(
        y,
        dt,
        traces.chains,
        events_s=[*event_times],
        event_u_s=[*event_times.values()],
        find_events=not events,
        **options,
    )


def output_columns(
    traces: DiskTraces, result: Compensated, way: CompensationMethod, parts: bool
) -> dict[str, NDArray[np.float64]]:
    """Output columns (N,) of one disk by name.

    Parameters
    ----------
    traces, result
        Traces and compensated record of the disk.
    way
        The method; without removal of the lag there are no columns of uncertainty.
    parts
        Whether to add the components of the uncertainty.

    Notes
    -----
    The names must be those that docs/files.md describes. ``_noise_u_K`` is ``sd_noise``;
    ``_common_u_K`` is the common lag and what the static lines have in common.
    """
    columns: dict[str, NDArray[np.float64]] = {}
    common_u = (
        np.hypot(result.common_sd(), shared_u_K(traces.lines))
        if parts and way.removes_lag
        else result.sd
    )
    temperature, sd = result.determined_estimates()
    for i, column in enumerate(traces.columns):
        columns[column] = temperature[:, i]
        if way.removes_lag:
            columns[column.replace("_degC", "_u_K")] = sd[:, i]
        if way.removes_lag and parts:
            columns[column.replace("_degC", "_noise_u_K")] = result.sd_noise[:, i]
            columns[column.replace("_degC", "_common_u_K")] = common_u[:, i]
    return {name: np.round(values, DECIMALS) for name, values in columns.items()}


@dataclass(frozen=True)
class LogSegments:
    """Settings to compensate the remaining rows of a long log, segment by segment.

    Noise and process-noise intensity are estimated in each segment. Lags are those of the unloading
    (``fits``) or of the records.

    Parameters
    ----------
    log
        The log.
    rig, records, method
        The rig, the record of each disk and the method.
    fits
        Joint fits by disk; empty where the lags of the records are used.
    events
        Standard uncertainty [s] by time of each event [s].
    components
        Whether to add columns with the components of the uncertainty.
    canonical_names
        Whether the columns contain the name of the disk.
    columns, header
        Columns of the log, and of the output.
    notes
        Metadata of the output.
    """

    log: LogChunks
    rig: Rig
    records: Mapping[str, DiskRecord]
    method: CompensationMethod
    fits: Mapping[str, SingleDiskFit]
    events: Mapping[float, float]
    components: bool
    canonical_names: bool
    columns: pd.Index[str]
    header: pd.Index[str]
    notes: Mapping[str, str]

    def read_chunks(
        self, columns: Sequence[str]
    ) -> Iterator[tuple[Array, dict[str, Array], tuple[Finding, ...]]]:
        """Yield chunks of the log: times [s], columns by name, and findings."""
        for piece in self.log:
            yield (
                piece.frame["time_s"].to_numpy(),
                {name: piece.frame[name].to_numpy() for name in columns},
                piece.findings,
            )

    def write(
        self,
        out: str | Path,
        progress: Callable[[str], None],
        style: OutputStyle = STANDARD_STYLE,
    ) -> list[Finding]:
        """Write the header and all rows to a file, completely or not at all.

        Parameters
        ----------
        out
            The file.
        progress
            Called after each tenth of the rows.
        style
            How a CSV file is written.

        Returns
        -------
        list of Finding
            Findings of all segments.

        Notes
        -----
        A segment whose margin is too short for the smoother to settle is read again with a longer
        one. ``SEGMENT_ROWS`` may be changed (memory). ``tests/smoothing/test_long_log.py`` compares
        the result with that of the log in one piece.
        """
        rows = 0
        reported_percent = 0
        findings = list[Finding]()
        lags = [
            c.lag_s.value
            for r in self.records.values()
            if r.chain
            for c in r.chain.channels.values()
        ]
        with log_writer(out, [*self.header], self.notes, style=style) as write:
            segments = read_segments(self, [*self.columns], max(lags, default=0.0), SEGMENT_ROWS)
            segment = next(segments, None)
            while segment is not None:
                frame, segment_findings, margin_rows = self._compensate_segment(segment)
                if margin_rows > segment.margin_rows:
                    segment = segments.send(margin_rows)
                    continue
                write(frame)
                rows = rows + len(frame)
                findings = [*findings, *segment_findings]
                if (percent := 10 * (10 * rows // self.log.rows)) > reported_percent:
                    reported_percent = percent
                    progress(f"writing, {percent} % of the rows")
                segment = next(segments, None)
        return findings

    def _compensate_segment(self, segment: TableSegment) -> tuple[pd.DataFrame, list[Finding], int]:
        """Compensate one segment of the log.

        Parameters
        ----------
        segment
            Rows of the segment with its margins.

        Returns
        -------
        frame
            The rows to write, without margins.
        findings
            Findings of the segment.
        margin_rows
            Number of rows on each side that the smoother needs to settle.
        """
        frame = pd.DataFrame(segment.data)
        where = self.log.path.name
        findings = list(segment.findings)
        margin_rows = 0.0
        output = frame
        dt = self.log.dt_s
        for disk, record in self.records.items():
            lag = self.method.removes_lag
            traces = disk_traces(
                frame, disk, self.rig, record, prefixed=self.canonical_names, where=where, lag=lag
            )
            traces = with_common_lag(traces, record, self.fits.get(disk))[0] if lag else traces
            result = compensate_disk(traces, frame, self.events, self.method)
            output = output.assign(**output_columns(traces, result, self.method, self.components))
            if result.intensities:
                margin_rows = max(
                    margin_rows,
                    settling_time_s(sensors(traces.chains), result.noise_sd, dt, result.intensities)
                    / dt,
                )
            findings += [
                f.at(disk) for f in (*result.findings, *traces.extrapolation_findings("the log"))
            ] + list(traces.findings)
        return (
            output[[*self.header]].iloc[segment.keep],
            summarise_spikes(findings),
            int(np.ceil(margin_rows)),
        )
