"""Certificate of a calibrated disk: a verdict on each thermocouple, then the evidence for it.

Written by ``tcdyn rig calibrate --report``. The verdicts come from
:func:`calibration.decisions.channel_verdicts`; the formal part is :mod:`tcdyn.report.formal`.
Tests: ``tests/rig/test_record.py``, ``tests/cli/test_calibrate_command.py`` and
``tests/calibration/test_budget.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from calibration.decisions import FIT_TO_USE, channel_verdicts, has_oven_lines
from calibration.static_lines import OvenFit
from immersion.plunge_fit import static_line_corrections
from immersion.plunge_result import INTERVAL_NOTE, PlungeFit
from tcdyn.core.estimate import text_with_u
from tcdyn.plots.calibration import draw_lag_budget, draw_lags, draw_residuals, error_figure
from tcdyn.plots.plunge import plunge_figure, residual_figure
from tcdyn.plots.style import panel_figure
from tcdyn.report.formal import formal_sections, title_marks
from tcdyn.report.page import Section, write_page
from tcdyn.rig.record import ChainRecord, DiskRecord
from tcdyn.rig.static_line import reading_u
from tcdyn.version import __version__
from tcdyn.workflows.calibrate import CalibrationRun

# No-break space.
NO_BREAK = "\u00a0"
# Ratio of u(common lag) to the median u(difference) below which the title does not state it: it
# would be rounded to one or two, and the two are known about equally well. Chosen by judgement.
SIMILAR_UNCERTAINTY = 1.5


def write_certificate(
    path: str | Path, run: CalibrationRun, earlier: Sequence[DiskRecord] = ()
) -> Path:
    """Write the certificate and return its path.

    The page has verdict, warnings and assumptions, the formal part, then, folded, the evidence for
    lags and lines.

    Parameters
    ----------
    path
        File to write.
    run
        Result of the calibration.
    earlier
        Records of the same disk, for its drift.

    Returns
    -------
    path
        The same path.
    """
    record = run.record
    evidence = certificate_sections(record, run.oven, fit_sections(run.fit))
    folded = [replace(section, folded=True) for section in evidence]
    return write_page(
        path,
        f"Calibration of the {record.disk} disk",
        [*formal_sections(record, earlier), *folded],
        verdict=certificate_verdict(record),
        findings=record.findings,
        assumptions=certificate_assumptions(record),
        marks=title_marks(record),
        footer=f"Made {record.created} with tcdyn {__version__}; not signed.",
    )


def summary_table(record: DiskRecord) -> pd.DataFrame:
    """Return a row for each channel: verdict, line, uncertainty at rest, lag, difference of lag."""
    verdicts = channel_verdicts(record)
    rows = []
    for name, line in sorted(record.static.items()):
        low, high = line.range_degC
        u = reading_u(line, np.linspace(low, high, 50))
        verdict = verdicts[name]
        if verdict == FIT_TO_USE:
            verdict = verdict.replace(" ", NO_BREAK)
        rows.append(
            {
                "channel": name,
                "verdict": verdict,
                "gain": line.gain_estimate.text_without_interval(),
                "offset [degC]": line.offset_estimate.text_without_interval(),
                "u at rest [K]": f"{u.min():.2g} to {u.max():.2g}",
            }
        )
    table = pd.DataFrame(rows)
    if record.chain is None:
        return table
    return table.merge(record.chain.table(), "left", "channel").fillna("")


def certificate_verdict(record: DiskRecord) -> str:
    """Return the verdict on the disk in one sentence."""
    faulty = [name for name, verdict in channel_verdicts(record).items() if verdict != FIT_TO_USE]
    count = len(record.static)
    text = f"Disk {record.disk}: {count - len(faulty)} of {count} thermocouples fit to use"
    if faulty:
        text += f", not {', '.join(faulty)}"
    if record.chain is not None:
        common = record.chain.common_lag_s
        largest_u = max(difference.u for difference in record.chain.differential_lag_s.values())
        text += f"; common lag {common.text_without_interval('s')} (95 %: {common.interval_text} s)"
        text += f", each channel's difference from it to {largest_u:.2g} s"
        structures = record.fit.get("structures") or {}
        if structures.get("contradicted"):
            text += f"; the plunges contradict its chain structure {record.chain.structure}"
    return text + "."


def certificate_sections(
    record: DiskRecord, oven: OvenFit | None = None, traces: Sequence[Section] = ()
) -> list[Section]:
    """Return the sections with the evidence of a certificate.

    Parameters
    ----------
    record
        The record.
    oven
        Static lines; None: no oven log.
    traces
        Sections on the plunges, which follow the lags.
    """
    low, high = next(iter(record.static.values())).range_degC
    about = (
        f"At rest, from {low:.0f} to {high:.0f} degC: temperature = gain x logged + offset, "
        "uncertain by u."
    )
    sections = [Section("Thermocouples", text=about, table=summary_table(record))]
    if record.chain is not None:
        sections.append(_lag_section(record.chain))
    sections += list(traces)
    if oven is not None:
        sections += oven_sections(oven)
    return sections


def _lag_section(chain: ChainRecord) -> Section:
    """Return the section of the lags; its title says how well their differences are known.

    Parameters
    ----------
    chain
        Dynamic part of the record.

    Returns
    -------
    Section
        The figure of the lags. The title states the ratio of the standard uncertainty of the common
        lag to the median of those of the differences, if it is at least ``SIMILAR_UNCERTAINTY``.

    Notes
    -----
    The ratio only changes the title. Test: ``tests/report/test_certificate.py``.
    """
    u_differences = [difference.u for difference in chain.differential_lag_s.values()]
    u_difference_s = float(np.median(u_differences))
    # the lag of a single channel is the common lag: no difference, and no ratio
    ratio = chain.common_lag_s.u / u_difference_s if u_difference_s else 0.0
    title = "Lags"
    if ratio >= SIMILAR_UNCERTAINTY:
        title = f"Lags: their differences are known {ratio:.0f} times better than their mean"
    note = INTERVAL_NOTE.strip("()")
    return Section(
        title,
        f"{note[:1].upper()}{note[1:]}.",
        figure=panel_figure(partial(draw_lags, chain), height_in=3.4),
        caption="Circles: lags. Thin bars hold each lag, thick ones its difference from the "
        "common lag (band).",
    )


def oven_sections(oven: OvenFit) -> list[Section]:
    """Return the errors before and after the static lines, and the residuals of the lines."""
    statistics = oven.statistics.map(lambda value: f"{value:.2g}")
    table = statistics.rename_axis("error against the PRT [K]").reset_index()
    residual_sd = float(np.nanstd(oven.calibrated_errors_K))
    return [
        Section(
            f"Oven: residuals of the static lines of {residual_sd:.2g} K",
            table=table,
            figure=error_figure(oven),
            caption="Errors of all channels, one for each hold; between the dashed lines lie 95 % "
            "of them.",
        ),
        Section(
            "Oven: residuals of the lines against temperature",
            figure=panel_figure(partial(draw_residuals, oven), height_in=3.2),
            caption="A column of markers that moves as one is an error of the PRT in that hold; a "
            "curve that repeats would be one of the lines.",
        ),
    ]


def certificate_assumptions(record: DiskRecord) -> list[str]:
    """Return what was assumed and not measured."""
    disk = record.setup.disk
    b = record.conditioning
    reference = "Readings at rest are as logged, uncertain as stated."
    if has_oven_lines(record):
        reference = (
            f"The reference's error: {record.setup.traceability.reference_u_K:.2g} K (1 sd), "
            "common to all readings; one for each hold of the oven, uniform within 0.1 degC."
        )
    junctions = sorted(record.setup.thermocouples.items())
    depths = ", ".join(f"{channel} {junction.depth_mm:g} mm" for channel, junction in junctions)
    return [
        reference,
        f"Signal conditioning: {b.poles} pole(s) at {b.cutoff_Hz:g} Hz ({b.shape}), from its data "
        "sheet.",
        f"Steel: K = {disk.conductivity_W_mK:g} W/mK, density {disk.density_kg_m3:g} kg/m3, "
        f"specific heat {disk.specific_heat_J_kgK:g} J/kgK; bore radius {disk.bore_radius_mm:g} "
        "mm.",
        f"Junction depths: {depths}, each to {record.setup.uncertainty.depth_mm:g} mm.",
        *plunge_assumptions(record),
    ]


def plunge_assumptions(record: DiskRecord) -> list[str]:
    """Return the assumptions of the plunge fit; empty for a record without one."""
    correlation = record.fit.get("correlation")
    if not correlation:
        return []
    law = f"natural convection by {correlation}, its scale fitted"
    return [
        f"Plunges: heat enters by the running surface only; {law}; an entry burst of h that fades."
    ]


def fit_sections(fit: PlungeFit) -> list[Section]:
    """Return sections on chain structures, limits of the lags, plunges, static lines and priors."""
    limits = Section(
        "What limits the lags",
        fit.sentence,
        figure=panel_figure(partial(draw_lag_budget, fit.budget)),
        caption="Reduction of the variance if a source were known, as a standard uncertainty. "
        "Sources are correlated, so they do not add up to all of the fit.",
    )
    priors = Section(
        "Priors of the plunge fit",
        "Each quantity is fitted within its prior (sd: standard deviation); a run is one plunge.",
        table=pd.DataFrame(fit.priors.describe(), columns=["quantity", "prior"]),
    )
    return [
        *structure_sections(fit),
        limits,
        *plunge_sections(fit),
        _static_line_section(fit),
        priors,
    ]


def _static_line_section(fit: PlungeFit) -> Section:
    """Return the section that compares the static lines before and after the plunges."""
    lines = static_line_corrections(fit)
    offset = [text_with_u(x, u) for x, u in zip(lines["off_K"], lines["u_off_K"])]
    slope = [text_with_u(x, u) for x, u in zip(lines["slope_off"], lines["u_slope"])]
    table = pd.DataFrame(
        {
            "channel": lines["channel"],
            "at [degC]": lines["at_degC"].round(0),
            "oven [K]": [text_with_u(0.0, u) for u in lines["u_off_before_K"]],
            "with plunges [K]": offset,
            "slope, oven": [text_with_u(0.0, u) for u in lines["u_slope_before"]],
            "slope, with plunges": slope,
        }
    )
    return Section(
        "The static lines with the plunges",
        "A disk in a bath has all its junctions near one temperature, so a plunge determines how "
        "the lines differ from each other. The lines of the record stay the oven's; the lags are "
        "those with the lines as estimated here.",
        table=table,
    )


def structure_sections(fit: PlungeFit) -> list[Section]:
    """Return section of all chain structures on the same plunges; empty if only one was fitted."""
    if fit.structures is None:
        return []
    text = (
        "Probability: by the evidence of each structure, all equally likely beforehand; one lag, a "
        "special case of the others, gets no credit for being simple. Chi-square: misfit and "
        "priors together. Held out: -2 log of the probability of each plunge as the others predict "
        "it. Of both, less is better."
    )
    if not fit.structures.findings:
        sentence = fit.structures.sentence
        text = f"{sentence[:1].upper()}{sentence[1:]}.\n\n{text}"
    return [Section("Which chain structure", text, table=fit.structures.table())]


def plunge_sections(fit: PlungeFit) -> list[Section]:
    """Return sections of the first seconds of the plunges, and of the residuals of each channel."""
    rows = []
    for k, run in enumerate(fit.runs):
        rms = np.sqrt(np.nanmean(fit.standardised_residuals(k) ** 2, axis=0))
        residual_K = fit.optimum.problem.noise[k].sd_K * rms
        cells = {f"{c} [K]": f"{x:.2f}" for c, x in zip(fit.channels, residual_K)}
        rows.append({"plunge": run.name, **cells})
    return [
        Section(
            "Plunges: the first seconds",
            figure=plunge_figure(fit),
            caption="Dots: means of the readings over blocks; lines: immersion model and chain. "
            "The channel nearest to the surface and the farthest one; the others lie between.",
        ),
        Section(
            "Plunges: residuals of the model",
            "Residual of a single sample of each channel (root mean square):",
            table=pd.DataFrame(rows),
            figure=residual_figure(fit),
            caption="Readings minus model over their expected noise. Were it all noise, 95 % "
            "would lie between the dashed lines and the mean would vary about zero.",
        ),
    ]
