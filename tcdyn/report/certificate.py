"""The certificate of a calibrated disk."""

from __future__ import annotations

from pathlib import Path

from tcdyn.pipeline.calibrate import CalibrationRun
from tcdyn.plots.certificate import certificate_assumptions, certificate_sections, certificate_verdict
from tcdyn.plots.plunges import plunge_sections
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
