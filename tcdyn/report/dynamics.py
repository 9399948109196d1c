"""Reports on planned tests (expected uncertainties), and on an identified model.

Written by ``tcdyn rig design --out plan.html`` and ``tcdyn identify``. Tests:
``tests/report/test_dynamics_page.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from tcdyn.design import compare
from tcdyn.design.compare import Design
from tcdyn.identification import Comparison, Fit, IOData
from tcdyn.identification.recommendation import TABLE_LEGEND, comparison_table
from tcdyn.io.read import sha256_of_file
from tcdyn.plots.identify import dynamics_figure, fit_figure, residual_figure
from tcdyn.plots.plunge import draw_design
from tcdyn.plots.style import panel_figure
from tcdyn.report.page import Section, write_page
from tcdyn.report.sources import to_table as sources
from tcdyn.rig.disk import Conditioning

# Text about common and differential lags.
ABOUT_LAGS = (
    "The common lag is the mean over the channels of a disk: an error in it shifts every "
    "compensated trace alike, and with them h and β by the cooling fit. The differences are the "
    "lags of the channels minus it: an error in them changes the gradient between junctions."
)


def write_design_report(path: str | Path, design: Design, assumptions: Sequence[str]) -> Path:
    """Write the page of planned tests and return its path.

    Parameters
    ----------
    path
        File to write.
    design
        Comparison of the planned tests.
    assumptions
        Numbers of the plan, one sentence each.

    Returns
    -------
    path
        The same path.
    """
    return write_page(
        path,
        "Test design: what to do before the campaign",
        [
            Section(
                "Expected uncertainties of each test",
                f"{ABOUT_LAGS}\n\n{compare.GRADE_DEFINITIONS}",
                design.grade_table(),
                panel_figure(partial(draw_design, design), height_in=3.8),
                "Expected standard uncertainties. Bars of the common lag: from the 10 to the 90 % "
                "point over entry bursts and scales of h, which cannot be planned.",
            )
        ],
        verdict=compare.recommendation(design.predictions, design.lag_s),
        assumptions=assumptions,
    )


def interval_text(best: Fit) -> str:
    """Return how the intervals were computed (:func:`tcdyn.identification.fit`)."""
    if best.loss != "linear":
        return f"Intervals are quadratic, from the covariance of the robust loss ({best.loss})."
    if best.noise.averaged:
        return (
            "Intervals include the uncertainty of the noise model: a linear drift and all "
            "first-order disturbances averaged. Where the quadratic intervals are poor these are "
            "of the profile likelihood, widened accordingly."
        )
    return "Where the quadratic intervals are poor these are of the profile likelihood."


def input_noise_text(best: Fit, record: IOData) -> str:
    """Return the assumption of the fit on the noise of each input.

    Parameters
    ----------
    best
        The recommended fit.
    record
        The data, for names and units.
    """
    noisy = []
    for name, unit, sd in zip(record.input_names, record.input_units, best.problem.input_sds):
        if sd:
            noisy.append(f"{name} of sd {sd:.2g} {unit}".rstrip())
    return f"is measured with noise ({', '.join(noisy)})" if noisy else "is known without error"


def write_identify_report(
    path: Path,
    record: IOData,
    comparison: Comparison,
    filter_: Conditioning,
    level: str = "",
    file: Path | None = None,
) -> None:
    """Write the page of an identification.

    It has the order table, the parameters, the fit, step and Bode with bands, and residual tests.

    Parameters
    ----------
    path
        File to write.
    record
        The data.
    comparison
        Comparison of the models.
    filter_
        Conditioning filter that was removed from the chain.
    level
        Text on the dependence of the lag on the level, if that was tested.
    file
        Table that the data were read from.
    """
    best = comparison.best
    model = best.identified
    name = model.model.name
    parts = model.by_input.values()
    plural = "s" if len(record.runs) > 1 else ""
    sections = [
        Section("Which model", TABLE_LEGEND, comparison_table(comparison.table, model.output_unit)),
        Section(
            f"{name}: parameters",
            f"{interval_text(best)} {comparison.lag_removal_advice(filter_)}",
            model.card(),
        ),
        Section(
            f"{name}: fit",
            f"{len(record.runs)} run{plural}, {record.n_samples} samples at {record.dt_s:g} s.",
            figure=fit_figure(best),
            caption="Points: measured. Line: simulated from the input alone (dashed, right axis), "
            "never from past outputs.",
        ),
        Section(
            f"{name}: dynamics",
            figure=dynamics_figure(model) if any(part.gain for part in parts) else None,
            caption="Step response, Bode diagram, poles (crosses) and zeros (rings) of the "
            "identified model with 95 % bands.",
        ),
        Section(
            f"{name}: residuals",
            model.sentence,
            figure=residual_figure(best, comparison.validation),
            caption="a: measured minus simulated, with disturbances. b and c: "
            "residuals after the noise model has removed the disturbances; by chance one lag in "
            "twenty lies outside the grey band.",
        ),
    ]
    if level:
        sections.append(Section("Does the lag depend on the level?", level))
    remarks = comparison.table.loc[comparison.table["remark"] != "", ["model", "remark"]]
    if len(remarks):
        sections.append(Section("Remarks on the models", table=remarks))
    validation_findings = [
        finding
        for finding in comparison.validation.findings
        if finding.code == "residuals.follow_input"
    ]
    holds = []
    for name, part in model.by_input.items():
        course = "straight" if part.hold == "foh" else "unchanged"
        holds.append(f"{name} runs {course} between its samples ({part.hold})")
    assumptions = [
        f"{', '.join(holds)}, {input_noise_text(best, record)}, and the system is linear and "
        "does not change in time"
    ]
    if filter_.poles:
        assumptions.append(f"{filter_.poles} pole(s) at {filter_.cutoff_Hz:g} Hz are known")
    for parameter, value in model.model.fixed.items():
        assumptions.append(f"{parameter} = {value:g}, fixed")
    source_table = None
    if file is not None:
        rows = [("table", file.name, f"{record.n_samples} samples", sha256_of_file(file))]
        source_table = sources(rows)
    write_page(
        path,
        f"{model.input_name} to {model.output_name}: {name}",
        sections,
        verdict=comparison.advice,
        findings=[*validation_findings, *model.findings],
        assumptions=assumptions,
        sources=source_table,
    )
