"""Report of a compensation: filter design report, logged and compensated traces.

Written by ``tcdyn compensate --report`` and ``tcdyn follow --report``. The filter of the report is
the causal inverse, also where another method made the traces. Tests:
``tests/report/test_dynamics_page.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from tcdyn.core.errors import InputError
from tcdyn.plots.compensate import axis_label, draw_compensated, draw_filter_report, draw_traces
from tcdyn.plots.style import DARK, figure, panel_figure
from tcdyn.report.page import Section, write_page
from tcdyn.report.sources import log_row, record_rows, to_table
from tcdyn.rig.record import DiskRecord
from tcdyn.rig.rigfile import Rig
from tcdyn.smoothing.inverse import (
    proper_inverse,
    report_inverse,
    smoother_bandwidth_Hz,
    widest_bandwidth_Hz,
)
from tcdyn.smoothing.record import Compensated
from tcdyn.smoothing.traces import record_chains
from tcdyn.workflows.compensate import CompensatedLog
from tcdyn.workflows.follow import FollowRun
from tcdyn.workflows.options import LogOptions
from tcdyn.workflows.raw_log import Calibrations, RawLog, open_log_table, raw_log
from tcdyn.workflows.traces import compensated_traces

MAX_NOISE_GAIN = 10.0  # of the causal inverse at its widest bandwidth; chosen by judgement
# Words for the methods.
METHODS = {
    "smoother": "the smoother",
    "deconvolve": "deconvolution",
    "inverse": "the causal inverse",
}
# Texts about the causal inverse.
NOT_CAUSAL_TEXT = (
    "{} uses past and future samples and leaves no shift. The causal inverse was not used; it "
    "is stated for comparison, at the widest bandwidth at which its noise is at most "
    f"{MAX_NOISE_GAIN:g} times the trace's."
)
CAUSAL_TEXT = (
    "The causal inverse used here is late by its remaining shift; its band includes the resulting "
    "error."
)
BEFORE_EVENT_S = 2.0  # of the close figure, before and after the last event
AFTER_EVENT_S = 6.0


def write_compensation_report(
    path: str | Path,
    compensated: CompensatedLog,
    records: Mapping[str, DiskRecord],
    files: Sequence[Path] = (),
) -> Path:
    """Write the page of a compensated log and return its path.

    It has the filter properties, the traces of the junction nearest the surface of each disk, and
    the metadata of the output.

    Parameters
    ----------
    path
        File to write.
    compensated
        The compensated log.
    records
        Records by disk.
    files
        Files of the records, in their order.

    Returns
    -------
    path
        The same path.
    """
    sections: list[Section] = []
    verdicts = []
    for disk, result in compensated.disks.items():
        sections.append(_trace_section(compensated, disk, result))
        sections.append(_filter_section(compensated, disk, result, records[disk]))
        verdicts.append(_verdict_text(compensated, disk, result))
    metadata = pd.DataFrame(compensated.metadata.items(), columns=["key", "value"])
    sections.append(Section("Metadata of the output", table=metadata, folded=True))
    return write_page(
        path,
        f"Compensated traces: {compensated.raw_log.path.name}",
        sections,
        verdict="\n\n".join(verdicts),
        findings=compensated.findings,
        assumptions=compensation_assumptions(records, compensated.method.method),
        sources=to_table([log_row(compensated.raw_log), *record_rows(records, files)]),
    )


def compensation_assumptions(records: Mapping[str, DiskRecord], method: str) -> list[str]:
    """Return the assumptions of the compensation by ``method``.

    Parameters
    ----------
    records
        Records by disk.
    method
        "smoother", "deconvolve" or "inverse".

    Returns
    -------
    assumptions
        Those of the smoother end with the one on its model of the slope.
    """
    filters = set()
    for record in records.values():
        b = record.conditioning
        conditioning = f"{b.poles} pole(s) at {b.cutoff_Hz:g} Hz ({b.shape})"
        filters.add(f"signal conditioning: {conditioning}, from its data sheet")
    assumptions = [
        "the chain of each channel is that of the record: linear, and the same in this log as "
        "when it was calibrated",
        *sorted(filters),
    ]
    if method == "smoother":
        assumptions.append(
            "between events the slope of each temperature wanders smoothly; at an event it may jump"
        )
    return assumptions


def _verdict_text(compensated: CompensatedLog, disk: str, result: Compensated) -> str:
    """Return the removed lag and the uncertainty of the junction nearest the surface.

    Parameters
    ----------
    compensated
        The compensated log.
    disk
        Name of the disk.
    result
        Its compensated traces.
    """
    setup = compensated.traces[disk].setup
    name = setup.shallowest
    sd = result.sd[:, setup.channels.index(name)]
    lag = compensated.metadata[f"{disk}_common_lag_s"]
    typical = f"{float(np.median(sd)):.2g}"
    return (
        f"{disk} disk: {METHODS[compensated.method.method]} removed a common lag of {lag}; channel "
        f"{name} is then known to +- {typical} K (typical sample), +- {float(sd.max()):.2g} K at "
        "worst."
    )


def write_follow_report(
    path: str | Path,
    run: FollowRun,
    out: Path,
    records: Calibrations,
    files: Sequence[Path] = (),
    rig: Rig | None = None,
    options: LogOptions | None = None,
) -> Path:
    """Write the page of a log that was compensated live, and return its path.

    It has one channel before and after, and the noise and uncertainty of all. ``out``: the output
    of the run; ``files``: those of the records, in their order; ``rig`` and ``options``: those of
    the run.
    """
    assert run.log is not None  # a run that never saw the header of its log has no page
    log_path = run.log.source.path
    name = log_path.name
    options = options or LogOptions()
    table = open_log_table(log_path, records, rig, options)
    log = raw_log(log_path, table, records, rig, options)
    notes = {**log.notes, "delay_s": f"{run.delay_s:g}"}
    assumptions: list[str] = []
    sources = [("log", name, f"{run.rows_written} rows followed", "")]
    if isinstance(records, Mapping):
        assumptions = compensation_assumptions(records, "smoother")
        sources += record_rows(records, files)
    sections = [
        _followed_channel_section(log, out),
        Section("Noise and uncertainty of each channel", table=run.numbers.round(4)),
        Section(
            "Metadata of the output",
            table=pd.DataFrame(notes.items(), columns=["key", "value"]),
            folded=True,
        ),
    ]
    return write_page(
        path,
        f"Followed: {name}",
        sections,
        verdict=f"Compensated while it grew, with a delay of {run.delay_s:g} s.",
        findings=run.findings,
        assumptions=assumptions,
        sources=to_table(sources),
    )


def _trace_section(compensated: CompensatedLog, disk: str, result: Compensated) -> Section:
    """Return the section with the trace of the junction nearest the surface.

    Parameters
    ----------
    compensated
        The compensated log.
    disk
        Name of the disk.
    result
        Its compensated traces.
    """
    traces = compensated.traces[disk]
    name = traces.setup.shallowest
    channel = traces.setup.channels.index(name)
    logged = np.zeros_like(result.temperature)
    logged[:, channel] = compensated.raw_log.frame[traces.columns[channel]].to_numpy(dtype=float)
    fig, (full, close) = figure(1, 2, width_in=10.0)
    if compensated.events_s:
        centre_s = compensated.events_s[-1]
        detail = "around the last event (dashed)"
    else:
        centre_s = float(result.time_s[len(result.time_s) // 2])
        detail = "some seconds in the middle"
    window_s = (centre_s - BEFORE_EVENT_S, centre_s + AFTER_EVENT_S)
    draw_compensated(result, logged, full, channel)
    draw_compensated(result, logged, close, channel, window_s)
    if compensated.events_s:
        full.axvline(centre_s, linestyle="--", linewidth=0.8, color=DARK)
        close.axvline(centre_s, linestyle="--", linewidth=0.8, color=DARK)
    return Section(
        f"{disk} disk, channel {name}",
        figure=fig,
        caption="Points: as logged, before the static line. Line: at the junction, with its 95 % "
        f"band. a: the whole log. b: {detail}.",
    )


def _filter_section(
    compensated: CompensatedLog, disk: str, result: Compensated, record: DiskRecord
) -> Section:
    """Return the section with the properties of the compensation filter of each channel.

    Parameters
    ----------
    compensated
        The compensated log.
    disk
        Name of the disk.
    result
        Its compensated traces.
    record
        Record of the disk.

    Notes
    -----
    ``MAX_NOISE_GAIN`` sets the bandwidth that is stated where the causal inverse was not used. It
    changes no trace.
    """
    dt = float(np.median(np.diff(result.time_s)))
    is_causal = compensated.method.method == "inverse"
    setup = record.disk_setup()
    rows = []
    reports = {}
    for i, (name, chain) in enumerate(zip(setup.channels, record_chains(record, setup))):
        noise = float(result.noise_sd[i])
        max_noise = MAX_NOISE_GAIN * noise
        smoother_Hz = None
        if is_causal:
            bandwidth_Hz = compensated.method.filter_bandwidth_Hz
        else:
            bandwidth_Hz = widest_bandwidth_Hz(chain, dt, noise, max_noise)
            smoother_Hz = smoother_bandwidth_Hz(chain, dt, noise, result.intensity[i])
        report = report_inverse(proper_inverse(chain, dt, bandwidth_Hz), noise, max_noise)
        reports[name] = report
        rows.append(
            {
                "channel": name,
                "lag, record [s]": f"{chain.lag_s:.3f}",
                "noise [K]": f"{noise:.3f}",
                "typical sd [K]": f"{float(np.median(result.sd[:, i])):.3f}",
                "follows up to [Hz]": None if smoother_Hz is None else f"{smoother_Hz:.2f}",
                "causal inverse: bandwidth [Hz]": f"{report.bandwidth_Hz:.2f}",
                "its noise gain": f"{report.noise_gain:.2f}",
                "its remaining shift [s]": f"{report.remaining_shift_s:.3f}",
                "flagged samples": int(np.count_nonzero(result.flags[:, i])),
            }
        )
    method = f"{result.method[:1].upper()}{result.method[1:]}"
    typical = "Typical sd: standard deviation of a compensated sample."
    step = "a step at the junction through the chain alone, and through chain and causal inverse"
    if is_causal:
        text = f"{CAUSAL_TEXT}\n\n{method}. {typical}"
        remark = ""
    else:
        introduction = NOT_CAUSAL_TEXT.format(METHODS[compensated.method.method].capitalize())
        limit = "Follows up to: above this frequency only changes at events are followed."
        text = f"{introduction}\n\n{method}. {typical} {limit}"
        remark = ", which was not used here"
    return Section(
        f"{disk} disk: filter design report",
        text,
        table=pd.DataFrame(rows).dropna(axis="columns"),
        figure=panel_figure(partial(draw_filter_report, reports[setup.shallowest]), height_in=3.4),
        caption=f"Channel {setup.shallowest}: {step}{remark}.",
    )


def _followed_channel_section(log: RawLog, out: Path) -> Section:
    """Return the section of one channel before and after live compensation."""
    names = list(log.channels.units)
    name = next((n for n in names if n.endswith("e_degC")), names[0])
    try:
        traces = compensated_traces(log, out, [name])
    except InputError as problem:  # the log was changed, or its last row is not complete
        return Section(name, f"No figure: the log cannot be read again ({problem}).")
    y = axis_label(traces[0])
    fig = panel_figure(partial(draw_traces, traces, y), height_in=4.0)
    caption = (
        "Pale: as logged, before the static line; spikes may lie outside. Line: at the junction, "
        "with its 95 % band."
    )
    return Section(f"{traces[0].name}, as it was followed", figure=fig, caption=caption)
