"""The page of a campaign: verdict, the table, and the thesis's figures of many tests."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from tcdyn.pipeline.campaign import CampaignRun
from tcdyn.pipeline.campaign_table import trend_table
from tcdyn.plots import campaign as draw
from tcdyn.plots.style import figure
from tcdyn.report.beta import ASSUMED
from tcdyn.report.page import Section, write_page


def write_campaign_report(path: str | Path, run: CampaignRun) -> Path:
    """Write the page of ``run``; a campaign in which every log failed has its table of errors only."""
    table = run.table
    good = table[table["error"] == ""]
    sections = [Section("Heat partition of each test", table=partition_table(good))] if len(good) else []
    if run.failed:
        lost = pd.DataFrame([{"log": o.log.name, "why": o.error} for o in run.failed])
        sections.insert(0, Section("Logs that could not be analysed", table=lost))
    if len(good):
        sections += campaign_sections(table)
    return write_page(
        path, f"Campaign of {len(table)} tests", sections, verdict=run.summary(), warnings=run.warnings,
        assumptions=ASSUMED,
    )  # fmt: skip


def campaign_sections(table: pd.DataFrame) -> list[Section]:
    """Figures 6.17, 6.33, 6.34, 7.18 and 7.20 of this campaign, conditions and trend lines."""
    beta, (ax,) = figure(height_in=4.4)
    draw.draw_beta(table, ax)
    traction, axes = figure(1, 2, height_in=4.0)
    draw.draw_traction(table, axes[0])
    draw.draw_friction_coefficient(table, axes[1])
    return [
        Section("β over ΔT u_s", figure=beta, caption="Compare figure 7.18. Bars are 95 %; the line is least squares."),
        Section(
            "Hottest running surface",
            figure=draw.temperature_figure(table, "surface_max_degC", "hottest surface"),
            caption="Compare figure 7.20: calculated at the end of loading, at the centre of the track.",
        ),
        Section(
            "Bulk temperature",
            figure=draw.temperature_figure(table, "bulk_degC", "mean of six junctions"),
            caption="Compare figure 6.17: mean of a to f over the steady stretch.",
        ),
        Section("Traction", figure=traction, caption="Compare figures 6.33 (left) and 6.34 (right, highest load)."),
        Section("Conditions and temperatures", table=condition_table(table[table["error"] == ""])),
        Section("Trend lines", table=trend_table(table)),
    ]


def partition_table(good: pd.DataFrame) -> pd.DataFrame:
    """beta by every way, h by the speed law, lags and cross-check, as tables 7.1 and 7.3."""

    def both(name: str, digits: int) -> list[str]:
        return [f"{v:.{digits}f} ± {u:.{digits}f}" for v, u in zip(good[name], good[f"u_{name}"])]

    return pd.DataFrame(
        {
            "test": good["test"],
            "β speed law": both("beta", 3),
            "β cooling fast": both("beta_cooling_fast", 3),
            "β cooling slow": both("beta_cooling_slow", 3),
            "β joint fast": both("beta_joint_fast", 3),
            "β joint slow": both("beta_joint_slow", 3),
            "h fast [W/m²K]": both("h_fast_W_m2K", 0),
            "h slow [W/m²K]": both("h_slow_W_m2K", 0),
            "lag fast [s]": both("lag_joint_fast_s", 3),
            "lag slow [s]": both("lag_joint_slow_s", 3),
            "n implied": both("exponent", 2),
            "largest z": [f"{z:.1f}" for z in good["crosscheck_z"]],
            "agree": good["agree"],
        }
    )


def condition_table(good: pd.DataFrame) -> pd.DataFrame:
    """Load, speeds, friction and temperatures, as table 7.2."""
    shown = {
        "load_N": ("load [N]", 0), "sliding_speed_m_s": ("sliding [m/s]", 2),
        "entraining_speed_m_s": ("entraining [m/s]", 2), "friction_N": ("friction [N]", 2),
        "friction_coefficient": ("μ [1]", 4), "fast_a_degC": ("fast a [°C]", 1), "slow_a_degC": ("slow a [°C]", 1),
        "fast_bulk_degC": ("fast bulk [°C]", 1), "slow_bulk_degC": ("slow bulk [°C]", 1),
        "fast_surface_max_degC": ("fast surface [°C]", 1), "slow_surface_max_degC": ("slow surface [°C]", 1),
        "delta_T_us_K_m_s": ("ΔT u_s [K m/s]", 1), "warnings": ("warnings", 0),
    }  # fmt: skip
    columns = {title: [f"{v:.{digits}f}" for v in good[name]] for name, (title, digits) in shown.items()}
    return pd.DataFrame({"test": good["test"].to_list(), **columns})
