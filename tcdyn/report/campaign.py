"""The page of a campaign: verdict, the answers, and the thesis's figures of many tests."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from tcdyn.pipeline.campaign import CampaignRun
from tcdyn.plots import campaign as draw
from tcdyn.plots.style import figure
from tcdyn.report import campaign_tables as words
from tcdyn.report.beta import ASSUMED
from tcdyn.report.page import Section, write_page

DELTA_T_US = (
    "ΔT u_s is the difference between the hottest points of the two running surfaces (fast less slow, at the end of "
    "loading) times the sliding speed. Clarke (2006) found the clearest trend of β over it, and figure 7.18 of "
    "the thesis is drawn so."
)
WAYS = (
    "Speed law: where the steady lines of both disks meet h ~ u^n. Cooling fit: h of one disk from its compensated "
    "traces after the parting. Joint fit: β, h and lag together from the traces as logged. They agree where the "
    "largest difference between two ways, z in its standard uncertainties, is no more than chance allows."
)


def write_campaign_report(path: str | Path, run: CampaignRun) -> Path:
    """Write the page of ``run``; a campaign in which every log failed has its table of errors only."""
    table = run.table
    good = table[table["error"] == ""]
    sections = []
    if run.failed:
        lost = pd.DataFrame([{"log": o.log.name, "why": o.error} for o in run.failed])
        sections.append(Section("Logs that could not be analysed", table=lost))
    if len(good):
        sections += [
            Section("β of each test, by every way", WAYS, words.partition_table(good)),
            Section("Heat transfer, lags and exponent of each test", table=words.heat_transfer_table(good)),
        ]
    if len(good) > 1:
        sections += campaign_pictures(table)
    if len(good):
        sections += [
            Section("Conditions", DELTA_T_US if len(good) == 1 else "", words.condition_table(good)),
            Section("Temperatures", "a and bulk (mean of a to f): steady stretch.", words.temperature_table(good)),
        ]
    lines = words.trend_words(table) if len(good) else pd.DataFrame()
    if len(lines):
        told = "Least squares; the slope's uncertainty is that of the scatter about the line."
        sections.append(Section("Trend lines, where three set points or more make one", told, lines))
    elif len(good) > 1:
        sections.append(Section("Trend lines", "None: no sliding speed has tests at three loads or more."))
    return write_page(
        path, f"Campaign of {len(table)} test{'s' if len(table) > 1 else ''}", sections,
        verdict=words.campaign_verdict(run), findings=words.gathered(run.findings), assumptions=ASSUMED,
    )  # fmt: skip


def campaign_pictures(table: pd.DataFrame) -> list[Section]:
    """Figures 6.17, 6.33, 6.34, 7.18 and 7.20 of this campaign, of two tests or more."""
    beta, (ax,) = figure(height_in=4.4)
    draw.draw_beta(table, ax)
    traction, axes = figure(1, 2, height_in=3.8)
    draw.draw_traction(table, axes[0])
    draw.draw_friction_coefficient(table, axes[1])
    lines = "Lines are least squares, drawn where three loads or more were run."
    return [
        Section(
            "Does β depend on ΔT u_s?",
            f"{DELTA_T_US}\n\n{words.beta_trend_words(table)}",
            figure=beta,
            caption="Compare figure 7.18. Bars are 95 %.",
        ),
        Section(
            "Hottest running surface",
            figure=draw.temperature_figure(table, "surface_max_degC", "hottest surface"),
            caption=f"Compare figure 7.20: at the centre of the track, end of loading; bars are 95 %. {lines}",
        ),
        Section(
            "Bulk temperature",
            figure=draw.temperature_figure(table, "bulk_degC", "mean of a to f"),
            caption=f"Compare figure 6.17: over the steady stretch. {lines}",
        ),
        Section(
            "Traction and friction",
            figure=traction,
            caption="Compare figures 6.33 (left) and 6.34 (right). Lines: three loads, or speeds, or more.",
        ),
    ]
