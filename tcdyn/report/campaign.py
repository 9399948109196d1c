"""Report of a campaign: conclusion, beta of all tests, and the thesis's figures of many tests.

Written by ``tcdyn rig campaign``. The sections on the joint posterior are in
:mod:`tcdyn.report.campaign_joint`. Tests: ``tests/report/test_campaign_page.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tcdyn.campaign import MapComparison
from tcdyn.campaign.summary_table import QUANTITIES, comparison_table, trend_table
from tcdyn.core.estimate import rounded_texts, text_with_u
from tcdyn.plots import campaign as draw
from tcdyn.plots.style import figure, panel_figure
from tcdyn.report.beta import ASSUMPTIONS
from tcdyn.report.campaign_joint import joined_result, joined_sections
from tcdyn.report.page import SIMULATED, Section, cells_with_u, write_page
from tcdyn.report.sources import to_table as sources
from tcdyn.rig.disk import DISKS, LEFT_OUT_TEXT
from tcdyn.rig.rigfile import Rig
from tcdyn.workflows.campaign import CampaignRun

# Texts of the page.
DELTA_T_US = (
    "ΔT u_s is the difference between the hottest points of the two running surfaces (fast minus "
    "slow, at the end of loading) times the sliding speed. Clarke (2006) found the clearest trend "
    "of β over it, and figure 7.18 of the thesis uses it."
)
ESTIMATORS = (
    "Speed law: where the steady lines of both disks meet h ~ u^n. Cooling fit: h of one disk from "
    "its compensated traces after the unloading. Joint fit: β, h and lag together from the traces "
    "as logged. They agree where the largest difference between two estimates, z in its standard "
    "uncertainties, is no more than chance allows."
)


# Columns of the tables: title, and digits; None: as the uncertainty has them.
ESTIMATES: dict[str, tuple[str, int | None]] = {
    "beta": ("speed law", None),
    "beta_cooling_fast": ("cooling fit, fast disk", None),
    "beta_cooling_slow": ("cooling fit, slow disk", None),
    "beta_joint_fast": ("joint fit, fast disk", None),
    "beta_joint_slow": ("joint fit, slow disk", None),
    "beta_both": ("joint fit, both disks", None),
}
HEAT_TRANSFER: dict[str, tuple[str, int | None]] = {
    "h_fast_W_m2K": ("h fast [W/m²K]", None),
    "h_slow_W_m2K": ("h slow [W/m²K]", None),
    "lag_joint_fast_s": ("common lag fast [s]", None),
    "lag_joint_slow_s": ("common lag slow [s]", None),
    "exponent": ("implied exponent n [1]", None),
}
CONDITIONS: dict[str, tuple[str, int | None]] = {
    "load_N": ("load [N]", 0),
    "sliding_speed_m_s": ("sliding speed [m/s]", 2),
    "entraining_speed_m_s": ("entraining speed [m/s]", 2),
    "friction_N": ("friction [N]", 2),
    "friction_coefficient": ("μ [1]", 4),
    "delta_T_us_K_m_s": ("ΔT u_s [K m/s]", None),
    "warnings": ("warnings and notes", 0),
}
TEMPERATURES: dict[str, tuple[str, int | None]] = {
    "fast_a_degC": ("fast disk, a [°C]", 1),
    "fast_bulk_degC": ("fast disk, bulk [°C]", 1),
    "fast_surface_max_degC": ("fast disk, hottest surface [°C]", None),
    "slow_a_degC": ("slow disk, a [°C]", 1),
    "slow_bulk_degC": ("slow disk, bulk [°C]", 1),
    "slow_surface_max_degC": ("slow disk, hottest surface [°C]", None),
}


def write_campaign_report(
    path: str | Path, run: CampaignRun, records: Sequence[tuple[str, str, str, str]] = ()
) -> Path:
    """Write the page of a campaign and return its path.

    If every log failed, it has the table of errors only. If all tests have a joint posterior, the
    sections of the single tests are folded.

    Parameters
    ----------
    path
        File to write.
    run
        Result of the campaign.
    records
        Rows of the records in the table of source files.

    Returns
    -------
    path
        The same path.
    """
    table = run.table
    joined = run.joined
    if joined is not None and len(joined.posterior.tests) < 2:
        joined = None
    sections = []
    if run.failed:
        errors = pd.DataFrame([{"log": o.log_name, "why": o.error} for o in run.failed])
        sections.append(Section("Logs that could not be analysed", table=errors))
    if run.interchange is not None:
        sections.append(_interchange_section(run.interchange, run.rig))
    if joined is not None:
        sections += joined_sections(joined)
    for section in [*_test_sections(table, run.compared), *_source_sections(run, records)]:
        folded = section.folded or joined is not None
        sections.append(replace(section, folded=folded))
    plural = "s" if len(table) > 1 else ""
    return write_page(
        path,
        f"Campaign of {len(table)} test{plural}",
        sections,
        verdict=campaign_verdict(run),
        findings=run.findings,
        assumptions=ASSUMPTIONS,
        main_results=() if joined is None else (joined_result(joined),),
        marks=[SIMULATED] if run.simulated else [],
    )


def _test_sections(table: pd.DataFrame, compared: pd.DataFrame | None) -> list[Section]:
    """Return the sections of the tests analysed one by one.

    Parameters
    ----------
    table
        Table of the campaign.
    compared
        Other tests to compare with.
    """
    good = table[table["error"] == ""]
    if not len(good):
        return []
    sections = [
        Section("β of each test, all estimates", ESTIMATORS, partition_table(good)),
        Section(
            "Heat transfer, lags and exponent of each test", table=_tests_table(good, HEAT_TRANSFER)
        ),
    ]
    if len(good) > 1:
        sections += campaign_pictures(table, compared)
    if compared is not None:
        sections.append(comparison_section(table, compared))
    about_conditions = DELTA_T_US if len(good) == 1 else ""
    about_temperatures = "a and bulk (mean of all junctions): steady segment."
    sections.append(Section("Conditions", about_conditions, _tests_table(good, CONDITIONS)))
    sections.append(Section("Temperatures", about_temperatures, _tests_table(good, TEMPERATURES)))
    lines = trend_lines(table)
    if len(lines):
        text = "Least squares; the slope's uncertainty is that of the scatter about the line."
        title = "Trend lines of three set points or more"
        sections.append(Section(title, text, lines))
    elif len(good) > 1:
        text = "None: no sliding speed has tests at three loads or more."
        sections.append(Section("Trend lines", text))
    return sections


def _source_sections(
    run: CampaignRun, records: Sequence[tuple[str, str, str, str]]
) -> list[Section]:
    """Return the section of the source files, if any log was analysed.

    Parameters
    ----------
    run
        Result of the campaign.
    records
        Rows of the records.
    """
    logs = [("log", o.log_name, "", o.data["source"]["sha256"]) for o in run.outcomes if o.data]
    if not logs:
        return []
    return [Section("Source files", table=sources([*logs, *records]), folded=True)]


def campaign_pictures(table: pd.DataFrame, compared: pd.DataFrame | None = None) -> list[Section]:
    """Return the figures 6.17, 6.33 to 6.35, 7.18 and 7.20 of a campaign of two tests or more.

    Parameters
    ----------
    table
        Table of the campaign.
    compared
        Other tests to compare with.
    """
    draw_one = partial(draw.draw_quantity, table, compared=compared)
    coefficient = partial(draw_one, "friction_coefficient")
    lines = "Lines are least squares, drawn where three loads or more were run."
    return [
        Section(
            "β of each test alone over ΔT u_s",
            DELTA_T_US,
            figure=panel_figure(partial(draw.draw_beta, table), height_in=4.4),
            caption="Each test analysed alone; bars are 95 %.",
        ),
        Section(
            "Hottest running surface",
            figure=_figure_of_disks(draw_one, "surface_max_degC"),
            caption="Compare figure 7.20: at the centre of the track, end of loading; bars are "
            f"95 %. {lines}",
        ),
        Section(
            "Bulk temperature",
            figure=_figure_of_disks(draw_one, "bulk_degC"),
            caption="Compare figure 6.17: mean of all junctions over the steady segment. " + lines,
        ),
        Section(
            "Traction force",
            figure=panel_figure(partial(draw_one, "friction_N"), height_in=3.8),
            caption=f"Compare figures 6.33 and 6.35. {lines}",
        ),
        Section(
            "Coefficient of friction",
            figure=panel_figure(
                coefficient, partial(coefficient, against="sliding_speed_m_s"), height_in=3.8
            ),
            caption="Over load, and over sliding speed as figure 6.34. Lines: three loads, or "
            "speeds, or more.",
        ),
    ]


def _figure_of_disks(draw_one: Callable[[str, Axes], Axes], quantity: str) -> Figure:
    """Return a quantity over the load, a panel of the same scale for each disk.

    Parameters
    ----------
    draw_one
        Function of the column and the axes.
    quantity
        End of the column name, after the name of the disk.
    """
    fig, axes = figure(1, 2, height_in=3.8)
    axes[1].sharey(axes[0])
    for disk, ax in zip(DISKS, axes):
        draw_one(f"{disk}_{quantity}", ax)
    return fig


def comparison_section(table: pd.DataFrame, compared: pd.DataFrame) -> Section:
    """Return the differences between other tests and those of the campaign.

    Parameters
    ----------
    table
        Table of the campaign.
    compared
        The other tests.
    """
    name = compared["test"].iloc[0]
    rows = []
    for row in comparison_table(table, compared).to_dict("records"):
        difference = row["difference"]
        low, _ = rounded_texts(difference.low95, difference.u)
        high, _ = rounded_texts(difference.high95, difference.u)
        rows.append(
            {
                "quantity": QUANTITIES[row["quantity"]],
                "sliding speed [m/s]": f"{row['sliding_speed_m_s']:.1f}",
                "tests": f"{row['n_tests']} and {row['n_compared']}",
                "mean of this campaign": f"{row['mean']:.4g}",
                "difference": cells_with_u([difference.value], [difference.u])[0],
                "95 % interval": f"{low} to {high}",
            }
        )
    text = (
        f"Difference: tests of {name} minus those of this campaign at the same load, by two "
        "parallel lines over the load. The uncertainty is that of the scatter about the lines; "
        "errors that all tests of a rig share, such as the gain of the force transducer, come on "
        "top."
    )
    if not rows:
        text = f"{name} has no sliding speed in common with this campaign at three loads or more."
    return Section(f"Comparison with {name}", text, table=pd.DataFrame(rows) if rows else None)


def _interchange_section(comparison: MapComparison, rig: Rig | None) -> Section:
    """Return the maps of two tests before and after an interchange of channels.

    Parameters
    ----------
    comparison
        The comparison.
    rig
        The rig, for the places of the junctions; None: no figure.
    """
    first, second = comparison.interchanged
    rows = []
    for name, before in comparison.before_degC.items():
        after = comparison.after_degC[name]
        rows.append(
            {
                "junction": name,
                f"{comparison.tests[0]}, before [°C]": f"{before:.2f}",
                f"{comparison.tests[1]}, after [°C]": f"{after:.2f}",
                "after minus expected [K]": f"{after - comparison.expected_degC[name]:+.2f}",
            }
        )
    text = (
        f"{comparison.summary()}.\n\nExpected: linear in the temperature before, by the junctions "
        "that were not interchanged. The uncertainty is that of their scatter."
    )
    picture = None
    if rig is not None:
        setup = rig.disk_setup(first.partition("_")[0])
        own = [
            level
            for levels in (comparison.before_degC, comparison.after_degC)
            for name, level in levels.items()
            if name.startswith(f"{setup.name}_")
        ]
        limits = (min(own), max(own))
        panels = [
            partial(draw.draw_junction_map, levels, setup, title=name, limits_degC=limits)
            for name, levels in zip(
                comparison.tests, (comparison.before_degC, comparison.after_degC)
            )
        ]
        picture = panel_figure(*panels, height_in=3.4)
    return Section(
        f"Channels of {first} and {second} interchanged",
        text,
        table=pd.DataFrame(rows),
        figure=picture,
        caption="Compare figure 6.21: temperature of each junction [°C], before (a) and after (b).",
    )


def campaign_verdict(run: CampaignRun) -> str:
    """Return the range of beta, in which tests its estimates agree, and how many logs failed."""
    table = run.table
    good = table[table["error"] == ""]
    if not len(good):
        return f"None of {len(table)} logs could be analysed: the reasons are below."
    ranked = good.dropna(subset=["beta"]).sort_values("beta").to_dict("records")
    texts = [f"{row['test']}: β = {text_with_u(row['beta'], row['u_beta'])}" for row in ranked]
    result = "reported for none of the tests"
    if len(texts) == 1:
        result = texts[0]
    elif texts:
        result = f"least in {texts[0]}; largest in {texts[-1]}"
    disagreeing = [str(test) for test in good["test"][good["agree"] != "yes"]]
    agree = f"in {len(good) - len(disagreeing)} of {len(good)} tests"
    if disagreeing:
        agree += f", not in {', '.join(disagreeing)}"
    text = (
        "β, the share of the frictional heat that enters the fast disk, by the speed law: "
        f"{result}. The estimates of β agree {agree}."
    )
    if run.failed:
        text += f" {len(run.failed)} of {len(table)} logs could not be analysed."
    return text


def partition_table(good: pd.DataFrame) -> pd.DataFrame:
    """Return all estimates of beta with the result of the cross-check, as tables 7.1 and 7.3."""
    table = _tests_table(good, ESTIMATES)
    table["agree, largest z"] = [
        a if np.isnan(z) else f"{a}, {z:.1f}"
        for a, z in zip(good["agree"], good["crosscheck_z"].astype(float))
    ]
    return table


def _tests_table(good: pd.DataFrame, columns: Mapping[str, tuple[str, int | None]]) -> pd.DataFrame:
    """Return columns of the table of a campaign, with one row for each test.

    Parameters
    ----------
    good
        Table of the analysed tests.
    columns
        Title and digits of each column; without digits its uncertainty, the column ``u_<name>``,
        decides them.
    """
    cells = {"test": good["test"].to_list()}
    for name, (title, digits) in columns.items():
        if digits is None:
            cells[title] = cells_with_u(good[name], good[f"u_{name}"])
        else:
            cells[title] = [
                LEFT_OUT_TEXT if np.isnan(value) else f"{value:.{digits}f}" for value in good[name]
            ]
    return pd.DataFrame(cells)


def trend_lines(table: pd.DataFrame) -> pd.DataFrame:
    """Return the trend lines with full names and units; empty if no group has three set points."""
    rows = []
    for line in trend_table(table).to_dict("records"):
        u_slope = line["u_slope"]
        low, _ = rounded_texts(line["low95_slope"], u_slope)
        high, _ = rounded_texts(line["high95_slope"], u_slope)
        rows.append(
            {
                "quantity": QUANTITIES[line["quantity"]],
                "over": "load [N]",
                "tests": f"{line['number']} at {line['tests']}",
                "slope": cells_with_u([line["slope"]], [u_slope])[0],
                "95 % interval of the slope": f"{low} to {high}",
                "value at zero": f"{line['intercept']:.4g}",
                "scatter (rms)": f"{line['rms']:.2g}",
            }
        )
    return pd.DataFrame(rows)
