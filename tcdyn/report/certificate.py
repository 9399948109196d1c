"""The certificate of a calibrated disk: a verdict on each thermocouple first, then what it rests on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from calibration.compare import check_record
from calibration.static_lines import OvenFit
from immersion.plunge_fit import moved_lines
from immersion.plunge_result import INTERVAL_NOTE, PlungeFit
from tcdyn.core.estimate import with_u
from tcdyn.core.findings import messages
from tcdyn.plots.calibration import draw_lag_budget, draw_lags, draw_residuals, error_figure
from tcdyn.plots.plunge import plunge_figure, residual_figure, standardised
from tcdyn.plots.style import pictured
from tcdyn.report.page import Section, write_page
from tcdyn.report.signed import in_oven, signed_sections
from tcdyn.rig.record import DiskRecord
from tcdyn.rig.static_line import whole_u
from tcdyn.workflows.calibrate import CalibrationRun

OF_A_CHANNEL = ("line", "record", "plunge", "noise", "junctions", "said")  # kinds of finding
BEYOND = "line.extrapolated"
FIT = "fit to use"
NO_BREAK = "\u00a0"


def write_certificate(
    path: str | Path, run: CalibrationRun, earlier: Sequence[DiskRecord] = ()
) -> Path:
    """One page: verdict, warnings and assumptions, what is signed, then, folded, what the lags and the lines rest on.

    ``earlier``: records of the same disk, for its drift.
    """
    record = run.record
    behind = certificate_sections(record, run.oven, fit_sections(run.fit))
    return write_page(
        path,
        f"Calibration of the {record.disk} disk",
        [*signed_sections(record, earlier), *(replace(section, folded=True) for section in behind)],
        verdict=certificate_verdict(record),
        findings=record.findings,
        assumptions=certificate_assumptions(record),
        footer=f"Made {record.made}.",
    )


def channel_verdicts(record: DiskRecord) -> dict[str, str]:
    """One sentence on each thermocouple: fit to use, or what is wrong with it.

    A gap or an impossible value in a log, or a plunge beyond the oven's range, is no fault of a thermocouple.
    """
    doubts = [
        f
        for f in check_record(record)
        if f.code.partition(".")[0] in OF_A_CHANNEL and f.code != BEYOND
    ]
    verdicts: dict[str, str] = {}
    for name in sorted(record.static):
        verdicts[name] = "; ".join(messages(f for f in doubts if name in f.channels)) or FIT
    return verdicts


def summary_table(record: DiskRecord) -> pd.DataFrame:
    """One row a channel: line, uncertainty at rest, lag with interval, difference from the common lag, verdict."""
    verdicts = channel_verdicts(record)
    rows = []
    for name, line in sorted(record.static.items()):
        low, high = line.range_degC
        u = whole_u(line, np.linspace(low, high, 50))
        rows.append(
            {
                "channel": name,
                "verdict": verdicts[name].replace(" ", NO_BREAK)
                if verdicts[name] == FIT
                else verdicts[name],
                "gain": line.gain_estimate.plain(),
                "offset [degC]": line.offset_estimate.plain(),
                "u at rest [K]": f"{u.min():.2g} to {u.max():.2g}",
            }
        )
    table = pd.DataFrame(rows)
    return (
        table
        if record.chain is None
        else table.merge(record.chain.table(), "left", "channel").fillna("")
    )


def certificate_verdict(record: DiskRecord) -> str:
    """The whole disk in one sentence."""
    doubtful = [name for name, said in channel_verdicts(record).items() if said != FIT]
    count = len(record.static)
    text = f"Disk {record.disk}: {count - len(doubtful)} of {count} thermocouples fit to use"
    text += f", not {', '.join(doubtful)}" if doubtful else ""
    if record.chain is not None:
        common = record.chain.common_lag_s
        apart = max(d.u for d in record.chain.differential_lag_s.values())
        text += f"; common lag {common.plain('s')} (95 %: {common.interval} s)"
        text += f", each channel's difference from it to {apart:.2g} s"
        found = record.fit.get("structures") or {}
        if found.get("contradicted"):
            text += f"; the plunges contradict its chain structure {record.chain.structure}"
    return text + "."


def certificate_sections(
    record: DiskRecord, oven: OvenFit | None = None, traces: Sequence[Section] = ()
) -> list[Section]:
    """The sections of the certificate; ``traces`` (structures, plunges, their residuals) follow the lags."""
    low, high = next(iter(record.static.values())).range_degC
    rest = f"At rest, from {low:.0f} to {high:.0f} degC: temperature = gain x logged + offset, uncertain by u."
    sections = [Section("Thermocouples", text=rest, table=summary_table(record))]
    if record.chain is not None:
        ratio = record.chain.common_lag_s.u / float(
            np.median([d.u for d in record.chain.differential_lag_s.values()]) or 1.0
        )
        title = (
            "Lags"
            if ratio < 1.5
            else f"Lags: their differences are known {ratio:.0f} times better than their mean"
        )
        caption = "Circles: lags. Thin bars hold each lag, thick ones its difference from the common lag (band)."
        note = INTERVAL_NOTE.strip("()")
        shown = pictured(partial(draw_lags, record.chain), height_in=3.4)
        sections.append(
            Section(title, f"{note[:1].upper()}{note[1:]}.", figure=shown, caption=caption)
        )
    sections += list(traces)
    if oven is not None:
        sections += oven_sections(oven)
    return sections


def oven_sections(oven: OvenFit) -> list[Section]:
    """Errors before and after the static lines, and what the lines leave."""
    table = (
        oven.statistics.map(lambda v: f"{v:.2g}")
        .rename_axis("error against the PRT [K]")
        .reset_index()
    )
    left = float(np.nanstd(oven.calibrated_errors_K))
    return [
        Section(
            f"Oven: the static lines leave {left:.2g} K",
            table=table,
            figure=error_figure(oven),
            caption="Errors of all channels, one for each hold; between the dashed lines lie 95 % of them.",
        ),
        Section(
            "Oven: what the lines leave, against temperature",
            figure=pictured(partial(draw_residuals, oven), height_in=3.2),
            caption="A column of markers that moves as one is an error of the PRT in that hold; a curve that repeats "
            "would be one of the lines.",
        ),
    ]


def certificate_assumptions(record: DiskRecord) -> list[str]:
    """What was assumed and not measured."""
    disk = record.setup.disk
    b = record.conditioning
    return [
        "Readings at rest are as logged, uncertain as stated."
        if not in_oven(record)
        else f"The reference's error: {record.setup.traceability.reference_u_K:.2g} K (1 sd), common to all readings; "
        "one for each hold of the oven, uniform within 0.1 degC.",
        f"Signal conditioning: {b.poles} pole(s) at {b.cutoff_Hz:g} Hz ({b.shape}), from its data sheet.",
        f"Steel: K = {disk.conductivity_W_mK:g} W/mK, density {disk.density_kg_m3:g} kg/m3, "
        f"specific heat {disk.specific_heat_J_kgK:g} J/kgK; bore radius {disk.bore_radius_mm:g} mm.",
        "Junction depths: "
        + ", ".join(f"{c} {j.depth_mm:g} mm" for c, j in sorted(record.setup.thermocouples.items()))
        + f", each to {record.setup.uncertainty.depth_mm:g} mm.",
        *plunge_assumptions(record),
    ]


def plunge_assumptions(record: DiskRecord) -> list[str]:
    """What the plunge fit took for granted; empty for a record without one."""
    correlation = record.fit.get("correlation")
    if not correlation:
        return []
    law = f"natural convection by {correlation}, its scale fitted"
    return [
        f"Plunges: heat enters by the running surface only; {law}; an entry burst of h that fades."
    ]


def fit_sections(fit: PlungeFit) -> list[Section]:
    """Structures, plunges, and what limits the lags."""
    told = Section(
        "What limits the lags",
        fit.sentence,
        figure=pictured(partial(draw_lag_budget, fit.budget)),
        caption="Variance that goes when a source is known, as a standard uncertainty. Sources stand in for each "
        "other, so they do not add up to all of the fit.",
    )
    priors = Section(
        "What the plunge fit takes as known beforehand",
        "Each quantity is fitted within its prior (sd: standard deviation); a run is one plunge.",
        table=pd.DataFrame(fit.priors.describe(), columns=["quantity", "prior"]),
    )
    moved = moved_lines(fit)
    statics = Section(
        "What the plunges say of the static lines",
        "A disk in a bath has all its junctions near one temperature, so a plunge tells how the lines differ from each "
        "other. The lines of the record stay the oven's; the lags are those with the lines as found here.",
        table=pd.DataFrame(
            {
                "channel": moved["channel"],
                "at [degC]": moved["at_degC"].round(0),
                "oven [K]": [with_u(0.0, u) for u in moved["u_off_before_K"]],
                "with plunges [K]": [
                    with_u(x, u) for x, u in zip(moved["off_K"], moved["u_off_K"])
                ],
                "slope, oven": [with_u(0.0, u) for u in moved["u_slope_before"]],
                "slope, with plunges": [
                    with_u(x, u) for x, u in zip(moved["slope_off"], moved["u_slope"])
                ],
            }
        ),
    )
    return [*structure_sections(fit), told, *plunge_sections(fit), statics, priors]


def structure_sections(fit: PlungeFit) -> list[Section]:
    """Every chain structure on the same plunges; empty where others were not tried."""
    if fit.structures is None:
        return []
    words = fit.structures.sentence
    how = (
        "Probability: by the evidence of each structure, all equally likely beforehand; one lag, a special case of the "
        "others, gets no credit for being simple. Chi-square: misfit and priors together. Held out: -2 log of the "
        "probability of each plunge as the others foresee it. Of both, less is better."
    )
    text = how if fit.structures.findings else f"{words[:1].upper()}{words[1:]}.\n\n{how}"
    return [Section("Which chain structure", text, table=fit.structures.table())]


def plunge_sections(fit: PlungeFit) -> list[Section]:
    """The certificate's sections on the plunges: the first seconds, and what is left in each channel."""
    rows = []
    for k, run in enumerate(fit.runs):
        sizes = np.sqrt(np.nanmean(standardised(fit, k) ** 2, axis=0))
        noise = fit.optimum.problem.noise[k].sd_K
        rows.append(
            {
                "plunge": run.name,
                **{f"{c} [K]": f"{n * s:.2f}" for c, n, s in zip(fit.channels, noise, sizes)},
            }
        )
    return [
        Section(
            "Plunges: the first seconds",
            figure=plunge_figure(fit),
            caption="Dots: means of the readings over blocks; lines: immersion model and chain. The channel nearest "
            "to the surface and the farthest one; the others lie between.",
        ),
        Section(
            "Plunges: what the model leaves",
            "Left over in a single sample of each channel (root mean square):",
            table=pd.DataFrame(rows),
            figure=residual_figure(fit),
            caption="Readings minus model over their expected noise. Were it all noise, 95 % would lie between the "
            "dashed lines and the mean would wander about zero.",
        ),
    ]
