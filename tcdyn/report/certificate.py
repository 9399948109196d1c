"""The certificate of a calibrated disk: a verdict on each thermocouple first, then what it rests on."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from calibration.record import DiskRecord
from calibration.recorddiff import check_record
from calibration.static import OvenFit, static_u
from tcdyn.identify.plunge_result import PlungeFit
from tcdyn.pipeline.calibrate import CalibrationRun
from tcdyn.plots.calibration import lag_figure, oven_figure
from tcdyn.plots.plunges import plunge_figure
from tcdyn.report.page import Section, write_page


def write_certificate(path: str | Path, run: CalibrationRun) -> Path:
    """One page: verdict on each thermocouple, static lines, lags with intervals, what was assumed."""
    record = run.record
    told = Section("What the plunges can tell", run.fit.sentence, table=run.fit_table())
    return write_page(
        path,
        f"Calibration of the {record.disk} disk",
        certificate_sections(record, run.oven, [*plunge_sections(run.fit), told]),
        verdict=certificate_verdict(record),
        warnings=record.warnings,
        assumptions=certificate_assumptions(record),
    )


def channel_verdicts(record: DiskRecord) -> dict[str, str]:
    """One sentence on each thermocouple: fit to use, or what is wrong with it."""
    doubts = check_record(record)
    verdicts: dict[str, str] = {}
    for name, line in sorted(record.static.items()):
        said = [d for d in doubts if f"channel {name}:" in d or f"static.{name}" in d or f"chain.{name}" in d]
        u = float(static_u(line, 0.5 * sum(line.range_degC)))
        verdicts[name] = "; ".join(said) if said else f"fit to use, {u:.2f} degC standard uncertainty at rest"
    return verdicts


def summary_table(record: DiskRecord) -> pd.DataFrame:
    """One row a channel: line, uncertainty at both ends of the range, lag with interval, verdict."""
    verdicts = channel_verdicts(record)
    rows = []
    for name, line in sorted(record.static.items()):
        u = static_u(line, np.array(line.range_degC))
        row = {
            "channel": name,
            "gain": f"{line.gain:.5f}",
            "offset [degC]": f"{line.offset:+.3f}",
            "u [K] at range ends": f"{u[0]:.3f} / {u[1]:.3f}",
        }
        if record.chain is not None and name in record.chain.channels:
            lag, apart = record.chain.channels[name].lag_s, record.chain.differential_lag_s[name]
            row["lag [s] (95 %)"] = f"{lag.value:.3f} ({lag.low95:.3f} to {lag.high95:.3f})"
            row["minus common [s]"] = f"{apart.value:+.4f} +- {apart.u:.4f}"
        rows.append({**row, "verdict": verdicts[name]})
    return pd.DataFrame(rows)


def certificate_verdict(record: DiskRecord) -> str:
    """The whole disk in one sentence."""
    good = sum(v.startswith("fit to use") for v in channel_verdicts(record).values())
    text = f"Disk {record.disk}: {good} of {len(record.static)} thermocouples fit to use"
    if record.chain is not None:
        common = record.chain.common_lag_s
        text += f"; common lag {common.value:.3f} s (95 %: {common.low95:.3f} to {common.high95:.3f})"
    return text + "."


def certificate_sections(
    record: DiskRecord, oven: OvenFit | None = None, traces: Sequence[Section] = ()
) -> list[Section]:
    """The sections of the certificate; ``traces`` (plunges, their residuals) come before the inputs."""
    made = f"Made {record.created}" + (f" by {record.created_by}" if record.created_by else "") + "."
    sections = [Section("Summary", text=f"{certificate_verdict(record)}\n\n{made}", table=summary_table(record))]
    if oven is not None:
        table = oven.statistics.rename_axis("error against the PRT [K]").reset_index()
        sections.append(
            Section(
                "Oven",
                table=table,
                figure=oven_figure(oven),
                caption="Errors before and after the static lines, and what the lines leave.",
            )
        )
    if record.chain is not None:
        caption = "Dots: lags; thin: their 95 % intervals; thick: those of the differences from the common lag."
        sections.append(Section("Lags", figure=lag_figure(record.chain), caption=caption))
    sections += list(traces)
    inputs = pd.DataFrame([{"file": i.file, "sha256": i.sha256} for i in record.inputs])
    sections.append(Section("Made from", table=inputs if len(inputs) else None))
    return sections


def certificate_assumptions(record: DiskRecord) -> list[str]:
    """What was assumed and not measured."""
    disk, b = record.setup.disk, record.conditioning
    return [
        "PRT errors are uniform within 0.1 degC, one for each hold of the oven.",
        f"Signal conditioning: {b.poles} pole(s) at {b.cutoff_Hz:g} Hz ({b.shape}), from its data sheet.",
        f"Steel: K = {disk.conductivity_W_mK:g} W/mK, density {disk.density_kg_m3:g} kg/m3, "
        f"specific heat {disk.specific_heat_J_kgK:g} J/kgK; bore radius {disk.bore_radius_mm:g} mm.",
        "Junction depths: "
        + ", ".join(f"{c} {j.depth_mm:g} mm" for c, j in sorted(record.setup.thermocouples.items()))
        + f", each to {record.setup.uncertainty.depth_mm:g} mm.",
    ]


def plunge_sections(fit: PlungeFit) -> list[Section]:
    """The certificate's section on the plunges: traces, residuals, and their size for each channel."""
    rows = []
    for run, model, predicted in zip(fit.runs, fit.optimum.problem.models, fit.optimum.predictions_degC):
        rest = model.blocks.readings_degC - predicted
        sizes = np.sqrt(np.nanmean(rest**2, axis=0))
        rows.append({"plunge": run.name, **{f"{c} [K]": f"{s:.3f}" for c, s in zip(fit.channels, sizes)}})
    return [
        Section(
            "Plunges",
            text="Residuals (rms over blocks) of each channel:",
            table=pd.DataFrame(rows),
            figure=plunge_figure(fit),
            caption="Dots: block means of the readings; lines: immersion model and chain. Below: what is left.",
        )
    ]
