"""The certificate of a calibrated disk."""

from __future__ import annotations

from pathlib import Path

from tcdyn.pipeline.calibrate import CalibrationRun
from tcdyn.plots.certificate import certificate_assumptions, certificate_sections, certificate_verdict
from tcdyn.report.page import Section, write_page


def write_certificate(path: str | Path, run: CalibrationRun) -> Path:
    """One page: verdict on each thermocouple, static lines, lags with intervals, what was assumed."""
    record = run.record
    sections = [
        Section(
            "What the plunges can tell",
            f"{run.fit.sentence}",
            table=run.fit_table(),
        )
    ]
    return write_page(
        path,
        f"Calibration of the {record.disk} disk",
        [*certificate_sections(record, run.oven), *sections],
        verdict=certificate_verdict(record),
        warnings=record.warnings,
        assumptions=certificate_assumptions(record),
        footer="Inputs: " + "; ".join(f"{i.file} (sha256 {i.sha256[:12]})" for i in record.inputs),
    )
