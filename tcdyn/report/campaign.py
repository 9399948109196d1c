"""The page of a campaign: verdict, the answers, and the thesis's figures of many tests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from tcdyn.core.estimate import rounded, with_u
from tcdyn.plots import campaign as draw
from tcdyn.plots.style import pictured
from tcdyn.report.beta import ASSUMED
from tcdyn.report.campaign_joint import joined_answer, joined_sections
from tcdyn.report.page import Section, pm, write_page
from tcdyn.report.sources import table as sources
from tcdyn.rig.disk import LEFT_OUT
from tcdyn.workflows.campaign import CampaignRun
from tcdyn.workflows.campaign_table import trend_table

WORDS = {
    "fast_bulk_degC": "bulk temperature, fast disk [°C]",
    "slow_bulk_degC": "bulk temperature, slow disk [°C]",
    "fast_surface_max_degC": "hottest surface, fast disk [°C]",
    "slow_surface_max_degC": "hottest surface, slow disk [°C]",
    "friction_N": "traction force [N]",
}
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


def write_campaign_report(
    path: str | Path, run: CampaignRun, records: Sequence[tuple[str, str, str, str]] = ()
) -> Path:
    """Write the page of ``run``; a campaign in which every log failed has its table of errors only.

    Where all tests make one measurement, what each tells alone is folded. ``records``: their rows among the sources.
    """
    table = run.table
    good = table[table["error"] == ""]
    sections = []
    each = []
    together = (
        run.joined if run.joined is not None and len(run.joined.posterior.tests) > 1 else None
    )
    if run.failed:
        lost = pd.DataFrame([{"log": o.log.name, "why": o.error} for o in run.failed])
        sections.append(Section("Logs that could not be analysed", table=lost))
    if together is not None:
        sections += joined_sections(together)
    if len(good):
        each += [
            Section("β of each test, by every way", WAYS, partition_table(good)),
            Section(
                "Heat transfer, lags and exponent of each test", table=heat_transfer_table(good)
            ),
        ]
    if len(good) > 1:
        each += campaign_pictures(table)
    if len(good):
        each += [
            Section("Conditions", DELTA_T_US if len(good) == 1 else "", condition_table(good)),
            Section(
                "Temperatures",
                "a and bulk (mean of all junctions): steady stretch.",
                temperature_table(good),
            ),
        ]
    lines = trend_words(table) if len(good) else pd.DataFrame()
    if len(lines):
        told = "Least squares; the slope's uncertainty is that of the scatter about the line."
        each.append(Section("Trend lines, where three set points or more make one", told, lines))
    elif len(good) > 1:
        each.append(
            Section("Trend lines", "None: no sliding speed has tests at three loads or more.")
        )
    if made := [
        ("log", o.log.name, "", o.data["source"]["sha256"]) for o in run.outcomes if o.data
    ]:
        each.append(Section("What it was made of", table=sources([*made, *records]), folded=True))
    return write_page(
        path,
        f"Campaign of {len(table)} test{'s' if len(table) > 1 else ''}",
        [*sections, *(replace(s, folded=s.folded or together is not None) for s in each)],
        verdict=campaign_verdict(run),
        findings=run.findings,
        assumptions=ASSUMED,
        answers=() if together is None else (joined_answer(together),),
    )


def campaign_pictures(table: pd.DataFrame) -> list[Section]:
    """Figures 6.17, 6.33, 6.34, 7.18 and 7.20 of this campaign, of two tests or more."""
    traction = partial(draw.draw_traction, table), partial(draw.draw_friction_coefficient, table)
    lines = "Lines are least squares, drawn where three loads or more were run."
    return [
        Section(
            "β of each test alone over ΔT u_s",
            DELTA_T_US,
            figure=pictured(partial(draw.draw_beta, table), height_in=4.4),
            caption="Each test analysed alone; bars are 95 %.",
        ),
        Section(
            "Hottest running surface",
            figure=draw.temperature_figure(table, "surface_max_degC", "hottest surface"),
            caption=f"Compare figure 7.20: at the centre of the track, end of loading; bars are 95 %. {lines}",
        ),
        Section(
            "Bulk temperature",
            figure=draw.temperature_figure(table, "bulk_degC", "mean of all junctions"),
            caption=f"Compare figure 6.17: over the steady stretch. {lines}",
        ),
        Section(
            "Traction and friction",
            figure=pictured(*traction, height_in=3.8),
            caption="Compare figures 6.33 (left) and 6.34 (right). Lines: three loads, or speeds, or more.",
        ),
    ]


def campaign_verdict(run: CampaignRun) -> str:
    """Range of beta, whether the ways to it agree and where not, and what was lost."""
    table = run.table
    good = table[table["error"] == ""]
    if not len(good):
        return f"None of {len(table)} logs could be analysed: the reasons are below."
    ranked = good.sort_values("beta").to_dict("records")
    low = ranked[0]
    high = ranked[-1]
    said = [f"{row['test']}: β = {with_u(row['beta'], row['u_beta'])}" for row in (low, high)]
    shown = said[0] if len(good) == 1 else f"least in {said[0]}; largest in {said[1]}"
    apart = [str(t) for t in good["test"][good["agree"] != "yes"]]
    agree = f"in {len(good) - len(apart)} of {len(good)} tests" + (
        f", not in {', '.join(apart)}" if apart else ""
    )
    lost = f" {len(run.failed)} of {len(table)} logs could not be analysed." if run.failed else ""
    return (
        f"β, the share of the frictional heat that enters the fast disk, by the speed law: {shown}. "
        f"The ways to β agree {agree}.{lost}"
    )


def partition_table(good: pd.DataFrame) -> pd.DataFrame:
    """beta by every way with the verdict of the cross-check, as tables 7.1 and 7.3."""
    ways = {
        "beta": "speed law",
        "beta_cooling_fast": "cooling fit, fast disk",
        "beta_cooling_slow": "cooling fit, slow disk",
        "beta_joint_fast": "joint fit, fast disk",
        "beta_joint_slow": "joint fit, slow disk",
        "beta_both": "joint fit, both disks",
    }
    columns = {title: _pm(good, name) for name, title in ways.items()}
    agree = [f"{a}, {z:.1f}" for a, z in zip(good["agree"], good["crosscheck_z"])]
    return pd.DataFrame({"test": good["test"].to_list(), **columns, "agree, largest z": agree})


def heat_transfer_table(good: pd.DataFrame) -> pd.DataFrame:
    """h by the speed law, lags by the unloading, and the exponent that the joint fit implies."""
    shown = {
        "h_fast_W_m2K": "h fast [W/m²K]",
        "h_slow_W_m2K": "h slow [W/m²K]",
        "lag_joint_fast_s": "common lag fast [s]",
        "lag_joint_slow_s": "common lag slow [s]",
        "exponent": "implied exponent n [1]",
    }
    return pd.DataFrame(
        {
            "test": good["test"].to_list(),
            **{title: _pm(good, name) for name, title in shown.items()},
        }
    )


def condition_table(good: pd.DataFrame) -> pd.DataFrame:
    """Load, speeds and friction, as table 7.2."""
    shown = {
        "load_N": ("load [N]", 0),
        "sliding_speed_m_s": ("sliding speed [m/s]", 2),
        "entraining_speed_m_s": ("entraining speed [m/s]", 2),
        "friction_N": ("friction [N]", 2),
        "friction_coefficient": ("μ [1]", 4),
    }
    columns = {
        title: [f"{v:.{digits}f}" for v in good[name]] for name, (title, digits) in shown.items()
    }
    columns["ΔT u_s [K m/s]"] = _pm(good, "delta_T_us_K_m_s")
    columns["warnings and notes"] = [f"{v:.0f}" for v in good["warnings"]]
    return pd.DataFrame({"test": good["test"].to_list(), **columns})


def temperature_table(good: pd.DataFrame) -> pd.DataFrame:
    """Steady temperatures of a and of the bulk, and the hottest running surface, of both disks."""
    columns: dict[str, list[str]] = {}
    for disk in ("fast", "slow"):
        for name, title in ((f"{disk}_a_degC", "a"), (f"{disk}_bulk_degC", "bulk")):
            columns[f"{disk} disk, {title} [°C]"] = [
                LEFT_OUT if np.isnan(v) else f"{v:.1f}" for v in good[name]
            ]
        columns[f"{disk} disk, hottest surface [°C]"] = _pm(good, f"{disk}_surface_max_degC")
    return pd.DataFrame({"test": good["test"].to_list(), **columns})


def trend_words(table: pd.DataFrame) -> pd.DataFrame:
    """The trend lines with names and units that people read; empty where no group has three different set points."""
    lines = trend_table(table)
    rows = [
        {
            "quantity": WORDS[r["quantity"]],
            "over": "load [N]",
            "tests": f"{r['number']} at {r['tests']}",
            "slope": pm([r["slope"]], [r["u_slope"]])[0],
            "95 % interval of the slope": " to ".join(
                rounded(r[end], r["u_slope"])[0] for end in ("low95_slope", "high95_slope")
            ),
            "value at zero": f"{r['intercept']:.4g}",
            "scatter (rms)": f"{r['rms']:.2g}",
        }
        for r in lines.to_dict("records")
    ]
    return pd.DataFrame(rows)


def _pm(good: pd.DataFrame, name: str) -> list[str]:
    return pm(good[name], good[f"u_{name}"])
