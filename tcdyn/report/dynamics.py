"""Pages on dynamics: what a planned test would tell of the lags, and what was identified between two columns."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from tcdyn.design import compare
from tcdyn.design.compare import Design
from tcdyn.identify import Comparison, Fit, IOData
from tcdyn.identify.recommendation import COLUMNS, order_table
from tcdyn.io.read import sha256
from tcdyn.plots.identify import dynamics_figure, fit_figure, residual_figure
from tcdyn.plots.plunge import draw_design
from tcdyn.plots.style import pictured
from tcdyn.report.page import Section, write_page
from tcdyn.report.sources import table as sources
from tcdyn.rig.disk import Conditioning

MEANS = (
    "The common lag is the mean over the channels of a disk: an error in it shifts every compensated trace alike, and "
    "with them h and β by the cooling fit. The differences are what is left of each channel: an error in them bends "
    "the gradient between junctions."
)


def write_design_report(path: str | Path, design: Design, assumptions: Sequence[str]) -> Path:
    """Write the page of ``design``; ``assumptions`` are the plan's own numbers."""
    return write_page(
        path,
        "Test design: what to do before the campaign",
        [
            Section(
                "What each test would tell",
                f"{MEANS}\n\n{compare.MEANING}",
                design.graded(),
                pictured(partial(draw_design, design), height_in=3.8),
                "Expected standard uncertainties. Bars of the common lag: from the 10 to the 90 % point over entry "
                "bursts and scales of h, which nobody can plan.",
            )
        ],
        verdict=compare.headline(design.predictions, design.lag_s),
        assumptions=assumptions,
    )


def intervals_said(best: Fit) -> str:
    """Where the intervals of the parameters come from (:func:`tcdyn.identify.fit`)."""
    if best.loss != "linear":
        return f"Intervals are quadratic, from the covariance of the robust loss ({best.loss})."
    if best.noise.averaged:
        return "Intervals are quadratic and hold what is not known of the noise: all first-order disturbances averaged."
    return "Where the quadratic intervals are poor these are of the profile likelihood."


def noise_said(best: Fit, record: IOData) -> str:
    """What the fit took for the noise of each input."""
    each = zip(record.input_names, record.input_units, best.problem.input_sds)
    noisy = [f"{name} of sd {sd:.2g} {unit}".rstrip() for name, unit, sd in each if sd]
    return f"is measured with noise ({', '.join(noisy)})" if noisy else "is known without error"


def write_identify_report(
    path: Path,
    record: IOData,
    comparison: Comparison,
    filter_: Conditioning,
    level: str = "",
    file: Path | None = None,
) -> None:
    """The HTML page: order table, fit, parameters, step and Bode with bands, residual tests.

    ``level`` says whether the lag depends on the level, where that was asked; ``file``: the table it was read from.
    """
    best = comparison.best
    model = best.identified
    removal = comparison.removal(filter_)
    sections = [
        Section("Which model", COLUMNS, order_table(comparison.table, model.output_unit)),
        Section(
            f"{model.model.name}: parameters",
            f"{intervals_said(best)} {removal}",
            model.card(),
        ),
        Section(
            f"{model.model.name}: fit",
            f"{len(record.runs)} run{'s' if len(record.runs) > 1 else ''}, {record.n_samples} samples at "
            f"{record.dt_s:g} s.",
            None,
            fit_figure(best),
            "Points: measured. Line: simulated from the input alone (dashed, right axis), never from past outputs.",
        ),
        Section(
            f"{model.model.name}: dynamics",
            "",
            None,
            dynamics_figure(model),
            "Step response, Bode diagram, poles (crosses) and zeros (rings) of the identified model with 95 % bands.",
        ),
        Section(
            f"{model.model.name}: residuals",
            model.sentence,
            None,
            residual_figure(best, comparison.validation),
            "Left: measured less simulated, disturbances in it. Middle and right: what is left when the noise model "
            "has taken the disturbances out; by chance one lag in twenty lies outside the grey band.",
        ),
    ]
    if level:
        sections.append(Section("Does the lag depend on the level?", level))
    remarks = comparison.table.loc[comparison.table["remark"] != "", ["model", "remark"]]
    if len(remarks):
        sections.append(Section("Remarks on the models", table=remarks))
    missed = [f for f in comparison.validation.findings if f.code == "residuals.follow_input"]
    write_page(
        path,
        f"{model.input_name} to {model.output_name}: {model.model.name}",
        sections,
        verdict=comparison.advice,
        findings=[*missed, *model.findings],
        assumptions=[
            f"the input runs {'straight' if model.hold == 'foh' else 'unchanged'} between its samples ({model.hold}), "
            f"{noise_said(best, record)}, and the system is linear and does not change in time",
            *(
                [f"{filter_.poles} pole(s) at {filter_.cutoff_Hz:g} Hz are known"]
                if filter_.poles
                else []
            ),
            *(f"{name} = {value:g}, held" for name, value in model.model.fixed.items()),
        ],
        sources=None
        if file is None
        else sources([("table", file.name, f"{record.n_samples} samples", sha256(file))]),
    )
