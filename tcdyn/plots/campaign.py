"""Figures of a campaign: quantities over load or speed, beta, and the joint posterior.

Used by the pages of a campaign (``tcdyn/report/campaign.py``, ``campaign_joint.py``). The lines of
the tables are least squares (:func:`tcdyn.campaign.trends.trend`), those of the joint posterior
generalised least squares. Tests: ``tests/report/test_campaign_page.py`` and
``tests/report/test_pictures.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib import colormaps
from matplotlib.axes import Axes

from tcdyn.campaign import JoinedCampaign
from tcdyn.campaign.scatter_trend import least_squares_trend
from tcdyn.campaign.summary_table import QUANTITIES, analysed_rows
from tcdyn.core.estimate import Z95
from tcdyn.plots.style import (
    DARK,
    DISK_COLOUR,
    GREY,
    PALE,
    SERIES_COLOURS,
    SERIES_LINES,
    SERIES_MARKERS,
    TRUTH,
    axes_of,
    style_axes,
)
from tcdyn.plots.transient import draw_depth_errors
from tcdyn.rig.disk import DiskSetup

# Labels of the conditions that can be on the x axis.
X_LABELS = {
    "delta_T_us_K_m_s": (
        "temperature difference of the surfaces times sliding speed, ΔT u_s [K m/s]"
    ),
    "load_N": "load [N]",
    "sliding_speed_m_s": "sliding speed [m/s]",
    "entraining_speed_m_s": "entraining speed [m/s]",
}
# Groups of the figures over load and over sliding speed: column, title, unit and decimals.
GROUPS = {
    "load_N": ("sliding_speed_m_s", "sliding speed", "m/s", 1),
    "sliding_speed_m_s": ("load_N", "load", "N", 0),
}

LETTER_WIDTH = 0.013  # of a seven-point letter, as a share of the axes' width; measured by eye
NAME_GAP = 0.006  # between two names, as a share of the axes' width; chosen by judgement


def draw_quantity(
    table: pd.DataFrame,
    quantity: str,
    ax: Axes | None = None,
    against: str = "load_N",
    compared: pd.DataFrame | None = None,
) -> Axes:
    """Plot a quantity of all tests over load or sliding speed, with least-squares lines.

    Figures 6.17, 6.33, 6.35 and 7.20 of the thesis are over the load, with a line for each sliding
    speed; figure 6.34 is over the sliding speed, with a line for each load.

    Parameters
    ----------
    table
        Table of the tests of a campaign.
    quantity
        Column of the table, such as those of ``tcdyn.campaign.summary_table.QUANTITIES``. Points
        have 95 % bars where the table has a column ``u_<quantity>``.
    ax
        Axes to plot into; None: those of a new figure.
    against
        "load_N" or "sliding_speed_m_s".
    compared
        Other tests (``tcdyn.campaign.summary_table.read_compared``), as open markers.

    Returns
    -------
    ax
        The same axes.
    """
    ax = axes_of(ax)
    by, title, unit, digits = GROUPS[against]
    if compared is not None and quantity not in compared:
        compared = None
    rows = analysed_rows(table, compared, by)
    for k, (_, group) in enumerate(rows.groupby("group")):
        is_compared = group["compared"].to_numpy(dtype=bool)
        own = group[~is_compared]
        level = group[by].mean() if own.empty else own[by].mean()
        _draw_series(ax, own, against, quantity, k, f"{level:.{digits}f} {unit}")
        if is_compared.any():
            _draw_series(ax, group[is_compared], against, quantity, k, "", is_compared=True)
    if compared is not None:
        name = compared["test"].iloc[0]
        ax.plot([], [], "o", label=name, color=TRUTH, markerfacecolor="white")
    y = QUANTITIES.get(quantity, quantity)
    return style_axes(ax, X_LABELS[against], y, legend_title=title, title_fontsize=8)


def draw_beta(table: pd.DataFrame, ax: Axes | None = None) -> Axes:
    """Plot beta over dT u_s with 95 % bars and a least-squares line (figure 7.18).

    Dots are the estimates by the speed law, triangles those by the joint fit of both disks, shifted
    sideways so that the bars of one test stay apart.

    Parameters
    ----------
    table
        Table of the tests of a campaign.
    ax
        Axes to plot into; None: those of a new figure.

    Returns
    -------
    ax
        The same axes.
    """
    ax = axes_of(ax)
    good = analysed_rows(table)
    x = good["delta_T_us_K_m_s"].to_numpy(dtype=float)
    shift = 0.008 * max(float(np.ptp(x)), 0.05 * float(np.abs(x).max()))
    for column, marker, colour, fill, offset, label in (
        ("beta", "o", TRUTH, TRUTH, 0.0, "speed law"),
        ("beta_both", "^", GREY, "white", shift, "joint fit, both disks"),
    ):
        ax.errorbar(
            x + offset,
            good[column].to_numpy(dtype=float),
            yerr=Z95 * good[f"u_{column}"].to_numpy(dtype=float),
            fmt=marker,
            color=colour,
            markerfacecolor=fill,
            capsize=2,
            linewidth=0.9,
            label=label,
        )
    line = least_squares_trend(x, good["beta"].to_numpy(dtype=float))
    if line is not None:
        ends = np.array([x.min(), x.max()])
        values = line.intercept + line.slope * ends
        ax.plot(ends, values, ":", color=TRUTH, linewidth=1, label="line, least squares")
    name_points(ax, x, [str(name) for name in good["test"]])
    return style_axes(ax, X_LABELS["delta_T_us_K_m_s"], "heat partition β [1]", legend=True)


def name_points(ax: Axes, x: Sequence[float] | np.ndarray, names: Sequence[str]) -> None:
    """Write names above the axes at ``x``, with a thin line down to each.

    They take as many rows as are needed to keep them apart.

    Parameters
    ----------
    ax
        Axes to plot into.
    x
        Position of each name on the x axis (N,).
    names
        The names (N).

    Notes
    -----
    ``LETTER_WIDTH`` and ``NAME_GAP`` decide how many rows are needed; too small a value lets names
    overlap. Test: ``tests/report/test_pictures.py``.
    """
    low = float(np.min(x))
    high = float(np.max(x))
    margin = 0.06 * (high - low) or 0.1 * abs(high) or 1.0
    ax.set_xlim(low - margin, high + margin)
    width = LETTER_WIDTH * max(len(name) for name in names) + NAME_GAP
    row_ends: list[float] = []  # end of the last name of each row, as a share of the axes' width
    for position, name in sorted(zip(x, names)):
        centre = (position - low + margin) / (high - low + 2 * margin)
        start = centre - width / 2
        free_rows = [row for row, end in enumerate(row_ends) if start > end]
        if free_rows:
            row = free_rows[0]
            row_ends[row] = centre + width / 2
        else:
            row = len(row_ends)
            row_ends.append(centre + width / 2)
        ax.axvline(position, color=PALE, linewidth=0.6, zorder=0)
        ax.annotate(
            name,
            (position, 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(0, 3 + 10 * row),
            textcoords="offset points",
            fontsize=7,
            ha="center",
            va="bottom",
            color=DARK,
        )


def _draw_series(
    ax: Axes,
    group: pd.DataFrame,
    x_column: str,
    y_column: str,
    k: int,
    label: str,
    *,
    is_compared: bool = False,
) -> None:
    """Plot one group of tests, with its least-squares line if there are enough tests.

    Parameters
    ----------
    ax
        Axes to plot into.
    group
        Rows of the group.
    x_column, y_column
        Columns of the two axes.
    k
        Number of the group, which chooses colour, marker and line.
    label
        Entry of the legend; none if it is empty.
    is_compared
        Whether these are tests to compare with: open markers and a thin line.
    """
    x = group[x_column].to_numpy(dtype=float)
    y = group[y_column].to_numpy(dtype=float)
    colour = SERIES_COLOURS[k % len(SERIES_COLOURS)]
    marker = SERIES_MARKERS[k % len(SERIES_MARKERS)]
    style = "none"
    u_column = f"u_{y_column}"
    if u_column in group:
        half_width = Z95 * group[u_column].to_numpy(dtype=float)
        ax.errorbar(x, y, yerr=half_width, fmt="none", ecolor=colour, capsize=2)
    face = "white" if is_compared else colour
    ax.plot(x, y, marker, color=colour, markerfacecolor=face, linestyle="none")
    line = least_squares_trend(x, y) if len(x) else None
    if line is not None:
        style = SERIES_LINES[k % len(SERIES_LINES)]
        width = 0.6 if is_compared else 1.0
        ends = np.array([x.min(), x.max()])
        ax.plot(ends, line.intercept + line.slope * ends, style, color=colour, linewidth=width)
    if label:
        ax.plot([], [], marker=marker, color=colour, linestyle=style, label=label)


def draw_junction_map(
    temperature_degC: Mapping[str, float],
    setup: DiskSetup,
    ax: Axes | None = None,
    title: str = "",
    limits_degC: tuple[float, float] | None = None,
) -> Axes:
    """Plot the temperature of each junction of a disk over width and depth (figures 6.1 and 6.21).

    Parameters
    ----------
    temperature_degC
        Temperature by junction, such as "slow_a"; others than those of the disk are left out.
    setup
        The disk.
    ax
        Axes to plot into; None: those of a new figure.
    title
        Title of the axes.
    limits_degC
        Range of the colours; by default that of the temperatures.

    Returns
    -------
    ax
        The same axes.

    Examples
    --------
    >>> from tcdyn.plots.style import figure
    >>> from tcdyn.rig.rigfile import load_rig
    >>> setup = load_rig().disk_setup("slow")
    >>> ax = draw_junction_map({"slow_a": 121.0, "slow_e": 126.0}, setup, figure()[1][0])
    >>> [text.get_text() for text in ax.texts]
    ['a 121.0', 'e 126.0']
    """
    ax = axes_of(ax)
    names = [c for c in setup.channels if f"{setup.name}_{c}" in temperature_degC]
    z_mm = [1e3 * setup.junctions[c].z_m for c in names]
    depth_mm = [1e3 * setup.junctions[c].depth_m for c in names]
    levels = [temperature_degC[f"{setup.name}_{c}"] for c in names]
    low, high = limits_degC or (min(levels), max(levels))
    for name, x, y, level in zip(names, z_mm, depth_mm, levels):
        shade = colormaps["cividis"]((level - low) / (high - low or 1.0))
        ax.plot(x, y, "o", color=shade, markeredgecolor=TRUTH, markersize=12)
        label = f"{name} {level:.1f}"
        ax.annotate(label, (x, y), (0, -13), textcoords="offset points", ha="center", va="top")
    ax.set_xlim(0, 1e3 * setup.width_m)
    ax.set_ylim(1.35 * max(depth_mm), 0)
    return style_axes(
        ax, "axial position [mm]", "depth below the running surface [mm]", title=title
    )


def draw_joined_beta(joined: JoinedCampaign, ax: Axes) -> Axes:
    """Plot beta of every test of the joint posterior, with the trend and the compared models.

    The thick bars are the 95 % intervals within the campaign, the thin bars the absolute ones.

    Parameters
    ----------
    joined
        Joint posterior of a campaign, with its trends and curves.
    ax
        Axes to plot into.

    Returns
    -------
    ax
        The same axes.
    """
    posterior = joined.posterior
    against = "delta_T_us_K_m_s"
    x = np.array([test.conditions[against] for test in posterior.tests])
    beta = posterior.beta[0]
    within = [estimates["beta_within"].half_widths95 for estimates in posterior.estimates]
    absolute = [estimates["beta"].half_widths95 for estimates in posterior.estimates]
    ax.errorbar(
        x,
        beta,
        yerr=np.transpose(absolute),
        fmt="none",
        ecolor=GREY,
        elinewidth=0.8,
        capsize=2,
        label="95 %, absolute",
    )
    ax.errorbar(
        x,
        beta,
        yerr=np.transpose(within),
        fmt="o",
        color=TRUTH,
        markersize=3,
        elinewidth=2.2,
        label="95 %, within the campaign",
    )
    for trend_line in joined.trends:
        if trend_line.against == (against,):
            grid = np.linspace(x.min(), x.max(), 50)
            line, u = trend_line.evaluate(grid)
            label = "line, generalised least squares"
            ax.fill_between(grid, line - Z95 * u, line + Z95 * u, color=PALE, zorder=0)
            ax.plot(grid, line, ":", color=TRUTH, linewidth=1, label=label)
            break
    curves = [test.curve for test in joined.curves if test.curve.against == against]
    for k, curve in enumerate(curves):
        style = SERIES_LINES[k % len(SERIES_LINES)]
        colour = DISK_COLOUR["fast"]
        ax.plot(curve.x, curve.beta, style, color=colour, linewidth=1.2, label=curve.file)
    name_points(ax, x, [name.removeprefix("EHL_") for name in posterior.test_names])
    return style_axes(ax, X_LABELS[against], "heat partition β [1]", legend=True)


def draw_exponent(joined: JoinedCampaign, ax: Axes) -> Axes:
    """Plot the exponent n of h ~ u^n of every test over the entraining speed, and that of all.

    Bars are the 95 % intervals within the campaign, the band that of the common exponent.

    Parameters
    ----------
    joined
        Joint posterior of a campaign.
    ax
        Axes to plot into.

    Returns
    -------
    ax
        The same axes.
    """
    law = joined.speed_law
    x = np.array([test.conditions["entraining_speed_m_s"] for test in joined.posterior.tests])
    common = law.exponent
    ax.axhspan(common.low95, common.high95, color=PALE, zorder=0, label="all tests, 95 %")
    ax.axhline(common.value, color=TRUTH, linestyle="--", linewidth=1)
    ax.errorbar(
        x,
        law.each,
        yerr=Z95 * law.u_within,
        fmt="o",
        color=TRUTH,
        markersize=3,
        capsize=2,
        linewidth=0.9,
        label="each test, against the others",
    )
    return style_axes(ax, "entraining speed [m/s]", "exponent n of h ~ u^n [1]", loc="lower left")


def draw_junctions(joined: JoinedCampaign, ax: Axes) -> Axes:
    """Plot the depth errors of the junctions that all tests together estimate, with 95 % bars.

    Parameters
    ----------
    joined
        Joint posterior of a campaign.
    ax
        Axes to plot into.

    Returns
    -------
    ax
        The same axes.
    """
    draw_depth_errors(joined.deeper_mm, ax, "{} disk")
    return style_axes(ax, "junction", "deeper than nominal [mm]", legend=True)
