"""The report of a compensation: what the compensator does, and pictures of raw against compensated traces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from tcdyn.core.findings import Finding
from tcdyn.plots.compensate import draw_before_use, draw_compensated
from tcdyn.plots.style import (
    DARK,
    GREY,
    SLOW,
    every_nth,
    figure,
    line_with_band,
    pictured,
    style_axes,
)
from tcdyn.report.page import Section, write_page
from tcdyn.report.sources import log_row, record_rows, table
from tcdyn.rig.record import DiskRecord
from tcdyn.smoothing.inverse import (
    before_use,
    proper_inverse,
    smoother_bandwidth_Hz,
    widest_bandwidth_Hz,
)
from tcdyn.smoothing.record import Compensated
from tcdyn.smoothing.traces import record_chains
from tcdyn.workflows.compensate import CompensatedLog
from tcdyn.workflows.live import Causal

GAIN = 10.0  # noise of the causal inverse over the trace's that its widest bandwidth is stated for
BY = {"smoother": "the smoother", "deconvolve": "deconvolution", "inverse": "the causal inverse"}
BOTH_WAYS = (
    "{} looks both ways and leaves no shift. The causal inverse was not used; it is stated for comparison, at the "
    f"widest bandwidth at which its noise is at most {GAIN:g} times the trace's."
)
CAUSAL = (
    "The causal inverse used here is late by its remaining shift; its band holds what that costs."
)
AROUND_S = (2.0, 6.0)  # seconds before and after the last event that the close picture shows


def write_compensation_report(
    path: str | Path,
    done: CompensatedLog,
    records: Mapping[str, DiskRecord],
    files: Sequence[Path] = (),
) -> Path:
    """The page of a whole log: numbers before use, traces of each disk's junction nearest the surface, notes."""
    sections: list[Section] = []
    for disk, result in done.disks.items():
        sections += [_traces(done, disk, result), _numbers(done, disk, result, records[disk])]
    notes = pd.DataFrame(done.metadata.items(), columns=["key", "value"])
    sections.append(Section("The output's own notes", table=notes, folded=True))
    return write_page(
        path,
        f"Compensated traces: {done.raw.path.name}",
        sections,
        verdict="\n\n".join(_verdict(done, disk, result) for disk, result in done.disks.items()),
        findings=done.findings,
        assumptions=assumed(records, done.way.method),
        sources=table([log_row(done.raw), *record_rows(records, files)]),
    )


def assumed(records: Mapping[str, DiskRecord], method: str) -> list[str]:
    """What the compensation takes for granted."""
    filters = {
        f"signal conditioning: {b.poles} pole(s) at {b.cutoff_Hz:g} Hz ({b.shape}), from its data sheet"
        for b in (r.conditioning for r in records.values())
    }
    return [
        "the chain of each channel is that of the record: linear, and the same in this log as when it was calibrated",
        *sorted(filters),
        *(
            [
                "between events the slope of each temperature wanders smoothly; at an event it may jump"
            ]
            if method == "smoother"
            else []
        ),
    ]


def _verdict(done: CompensatedLog, disk: str, result: Compensated) -> str:
    """What was removed, and how well the result is known."""
    name = done.traces[disk].setup.shallowest
    channel = done.traces[disk].setup.channels.index(name)
    lag = done.metadata[f"{disk}_common_lag_s"]
    sd = result.sd[:, channel]
    return (
        f"{disk} disk: {BY[done.way.method]} removed a common lag of {lag}; channel {name} is then known to "
        f"+- {float(np.median(sd)):.2g} K (typical sample), +- {float(sd.max()):.2g} K at worst."
    )


def write_follow_report(
    path: str | Path,
    plan: Causal,
    log: Path,
    out: Path,
    findings: Sequence[Finding],
    records: Mapping[str, DiskRecord],
    files: Sequence[Path] = (),
) -> Path:
    """The page of a followed log: one channel of a disk before and after, and what could be told before use."""
    report = plan.before_use()
    behind = plan.settings.behind_s
    picture = pictured(partial(draw_before_use, report), height_in=3.6)
    followed, rows = _followed(plan, log, out)
    step = "Noisiest channel: a step at the junction through the chain alone, and as it comes out of the live smoother."
    notes = pd.DataFrame(plan.notes().items(), columns=["key", "value"])
    return write_page(
        path,
        f"Followed: {log.name}",
        [
            followed,
            Section("What a step becomes", figure=picture, caption=step),
            Section("How it was followed", table=notes, folded=True),
        ],
        verdict=f"Compensated while it grew, {behind:g} s behind. Noisiest channel: {'; '.join(report.lines())}.",
        findings=(*report.findings, *findings),
        assumptions=assumed(records, "smoother")[:-1],
        sources=table(
            [("log", log.name, f"{rows} rows followed", ""), *record_rows(records, files)]
        ),
    )


def _traces(done: CompensatedLog, disk: str, result: Compensated) -> Section:
    traces = done.traces[disk]
    channel = traces.setup.channels.index(traces.setup.shallowest)
    logged = np.zeros_like(result.temperature)
    logged[:, channel] = done.raw.frame[traces.columns[channel]].to_numpy(dtype=float)
    event = done.events_s[-1] if done.events_s else float(result.time_s[len(result.time_s) // 2])
    picture, (whole, close) = figure(1, 2, width_in=10.0)
    draw_compensated(result, logged, whole, channel)
    draw_compensated(result, logged, close, channel, (event - AROUND_S[0], event + AROUND_S[1]))
    where = "about the last event (dashed)" if done.events_s else "some seconds in the middle"
    for ax in (whole, close) if done.events_s else ():
        ax.axvline(event, linestyle="--", linewidth=0.8, color=DARK)
    return Section(
        f"{disk} disk, channel {traces.setup.shallowest}",
        figure=picture,
        caption="Points: as logged, before the static line. Line: at the junction, with its 95 % band. Left: the whole "
        f"log. Right: {where}.",
    )


def _numbers(done: CompensatedLog, disk: str, result: Compensated, record: DiskRecord) -> Section:
    dt = float(np.median(np.diff(result.time_s)))
    rows = []
    worst = None
    causal = done.way.method == "inverse"
    setup = record.disk_setup()
    for name, chain in zip(setup.channels, record_chains(record, setup)):
        i = setup.channels.index(name)
        noise = float(result.noise_sd[i])
        band = (
            done.way.bandwidth_Hz if causal else widest_bandwidth_Hz(chain, dt, noise, GAIN * noise)
        )
        report = before_use(proper_inverse(chain, dt, band), noise, GAIN * noise)
        over = np.nan if causal else smoother_bandwidth_Hz(chain, dt, noise, result.intensity[i])
        rows.append(
            {
                "channel": name,
                "lag, record [s]": f"{chain.lag_s:.3f}",
                "noise [K]": f"{noise:.3f}",
                "typical sd [K]": f"{float(np.median(result.sd[:, i])):.3f}",
                "follows up to [Hz]": None if causal else f"{over:.2f}",
                "causal inverse: bandwidth [Hz]": f"{report.bandwidth_Hz:.2f}",
                "its noise gain": f"{report.noise_gain:.2f}",
                "its remaining shift [s]": f"{report.remaining_shift_s:.3f}",
                "flagged samples": int(np.count_nonzero(result.flags[:, i])),
            }
        )
        worst = report if name == setup.shallowest else worst
    assert worst is not None
    return Section(
        f"{disk} disk: before use",
        f"{CAUSAL if causal else BOTH_WAYS.format(BY[done.way.method].capitalize())}\n\n"
        f"{result.method[:1].upper()}{result.method[1:]}. Typical sd: standard deviation of a compensated sample."
        + (
            ""
            if causal
            else " Follows up to: above this frequency only what an event may bring is followed."
        ),
        table=pd.DataFrame(rows).dropna(axis="columns"),
        figure=pictured(partial(draw_before_use, worst), height_in=3.4),
        caption=f"Channel {setup.shallowest}: a step at the junction through the chain alone, and through chain and "
        f"causal inverse{'' if causal else ', which was not used here'}.",
    )


def _followed(plan: Causal, log: Path, out: Path) -> tuple[Section, int]:
    name = next((n for n in plan.junctions if n.endswith("e_degC")), plan.junctions[0])
    done = pd.read_csv(out, comment="#", usecols=["time_s", name, name.replace("_degC", "_u_K")])
    time, x, u = (
        done[c].to_numpy(dtype=float) for c in ("time_s", name, name.replace("_degC", "_u_K"))
    )
    shown = every_nth(len(time))
    picture, (ax,) = figure(height_in=4.0)
    raw = _logged(plan, log, name)
    if raw is not None:
        ax.plot(raw[0][shown], raw[1][shown], ".", markersize=2, color=GREY, label="logged")
    line_with_band(
        ax, time[shown], x[shown], u[shown], SLOW, "95 %", linewidth=1.0, label="compensated"
    )
    seen = x[np.isfinite(x)]
    if len(seen):
        margin = 0.1 * float(np.ptp(seen)) + 1.0  # a spike of the log must not flatten the picture
        ax.set_ylim(float(seen.min()) - margin, float(seen.max()) + margin)
    style_axes(ax, "time [s]", "temperature [°C]", loc="best")
    told = (
        "Points: as logged, before the static line; spikes may lie outside. Line: at the junction, "
        "with its 95 % band."
    )
    return Section(f"{name}, as it was followed", figure=picture, caption=told), len(time)


def _logged(plan: Causal, log: Path, name: str) -> tuple[np.ndarray, np.ndarray] | None:
    """Time and readings as logged, read again; None where the columns have other names than the canonical ones."""
    try:
        raw = pd.read_csv(log, comment="#", usecols=["time_s", name], on_bad_lines="skip")
    except ValueError:
        return None
    return tuple(pd.to_numeric(raw[c], errors="coerce").to_numpy() for c in ("time_s", name))  # type: ignore[return-value]
