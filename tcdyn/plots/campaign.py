"""Pictures of a campaign: temperatures and traction over load, friction over speed, beta over dT u_s; and of all its
tests as one measurement: beta with both uncertainties, the exponent, the junctions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tcdyn.campaign import JoinedCampaign
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
    dressed,
    figure,
)
from tcdyn.plots.transient import draw_deeper
from tcdyn.rig.disk import DISKS
from tcdyn.workflows.campaign_table import done_rows, speed_groups, trend

OVER = {
    "delta_T_us_K_m_s": "temperature difference of the surfaces times sliding speed, ΔT u_s [K m/s]",
    "load_N": "load [N]",
    "sliding_speed_m_s": "sliding speed [m/s]",
    "entraining_speed_m_s": "entraining speed [m/s]",
}


def temperature_figure(table: pd.DataFrame, quantity: str, label: str) -> Figure:
    """``<disk>_<quantity>`` over load, a panel for each disk on one scale (figures 6.17 and 7.20)."""
    fig, axes = figure(1, 2, height_in=3.8)
    axes[1].sharey(axes[0])
    for disk, ax in zip(DISKS, axes):
        draw_temperature(table, disk, quantity, label, ax)
    return fig


def draw_temperature(table: pd.DataFrame, disk: str, quantity: str, label: str, ax: Axes) -> Axes:
    """``<disk>_<quantity>`` [degC] over load, a marker and a least-squares line for each sliding speed."""
    return _by_speed(table, f"{disk}_{quantity}", ax, f"{label} [°C]", f"{disk} disk")


def draw_traction(table: pd.DataFrame, ax: Axes) -> Axes:
    """Traction force over load, a marker and a least-squares line for each sliding speed (figure 6.33)."""
    return _by_speed(table, "friction_N", ax, "traction force [N]")


def draw_friction_coefficient(table: pd.DataFrame, ax: Axes) -> Axes:
    """Friction coefficient over sliding speed, a marker and a least-squares line for each load (figure 6.34)."""
    good = done_rows(table)
    good["group"] = speed_groups(good["load_N"].to_numpy(dtype=float))
    for k, (_, part) in enumerate(good.groupby("group")):
        _series(
            ax,
            part,
            "sliding_speed_m_s",
            "friction_coefficient",
            k,
            f"{part['load_N'].mean():.0f} N",
        )
    return dressed(
        ax, "sliding speed [m/s]", "coefficient of friction [1]", title="load", title_fontsize=8
    )


def draw_beta(table: pd.DataFrame, ax: Axes) -> Axes:
    """beta by the speed law, and by both disks' joint fit, over dT u_s with 95 % bars and a line (figure 7.18)."""
    good = done_rows(table)
    x = good["delta_T_us_K_m_s"].to_numpy(dtype=float)
    aside = 0.008 * max(
        float(np.ptp(x)), 0.05 * float(np.abs(x).max())
    )  # so that the bars of one test stand apart
    for column, marker, colour, fill, shift, label in (
        ("beta", "o", TRUTH, TRUTH, 0.0, "speed law"),
        ("beta_both", "^", GREY, "white", aside, "joint fit, both disks"),
    ):
        y = good[column].to_numpy(dtype=float)
        u = good[f"u_{column}"].to_numpy(dtype=float)
        ax.errorbar(
            x + shift,
            y,
            yerr=Z95 * u,
            fmt=marker,
            color=colour,
            markerfacecolor=fill,
            capsize=2,
            linewidth=0.9,
            label=label,
        )
    line = trend(x, good["beta"].to_numpy(dtype=float))
    if line is not None:
        ends = np.array([x.min(), x.max()])
        ax.plot(
            ends,
            line.intercept + line.slope * ends,
            ":",
            color=TRUTH,
            linewidth=1,
            label="line, least squares",
        )
    name_points(ax, x, [str(name) for name in good["test"]])
    return dressed(ax, OVER["delta_T_us_K_m_s"], "heat partition β [1]", legend=True)


def name_points(ax: Axes, x: Sequence[float] | np.ndarray, names: Sequence[str]) -> None:
    """Names above the axes over their ``x``, in as many rows as keep them apart, with a hair line down to each."""
    low = float(np.min(x))
    high = float(np.max(x))
    margin = 0.06 * (high - low) or 0.1 * abs(high) or 1.0
    ax.set_xlim(low - margin, high + margin)
    share = (
        0.013 * max(len(n) for n in names) + 0.006
    )  # of the axes' width: seven-point letters and a gap
    rows: list[float] = []  # where the last name of each row ends
    for at, name in sorted(zip(x, names)):
        place = (at - low + margin) / (high - low + 2 * margin)
        row = next((k for k, end in enumerate(rows) if place - share / 2 > end), len(rows))
        rows[row : row + 1] = [place + share / 2]
        ax.axvline(at, color=PALE, linewidth=0.6, zorder=0)
        ax.annotate(
            name,
            (at, 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(0, 3 + 10 * row),
            textcoords="offset points",
            fontsize=7,
            ha="center",
            va="bottom",
            color=DARK,
        )


def _by_speed(table: pd.DataFrame, column: str, ax: Axes, label: str, head: str = "") -> Axes:
    for k, (_, part) in enumerate(done_rows(table).groupby("group")):
        _series(ax, part, "load_N", column, k, f"{part['sliding_speed_m_s'].mean():.1f} m/s")
    return dressed(ax, "load [N]", label, head=head, title="sliding speed", title_fontsize=8)


def _series(ax: Axes, part: pd.DataFrame, over: str, column: str, k: int, label: str) -> None:
    """One group of tests: points, with 95 % bars where the table has u, and their line where three or more make one."""
    x, y = (part[name].to_numpy(dtype=float) for name in (over, column))
    colour = SERIES_COLOURS[k % len(SERIES_COLOURS)]
    marker = SERIES_MARKERS[k % len(SERIES_MARKERS)]
    line = trend(x, y)
    style = SERIES_LINES[k % len(SERIES_LINES)] if line is not None else "none"
    if f"u_{column}" in part:
        ax.errorbar(
            x,
            y,
            yerr=Z95 * part[f"u_{column}"].to_numpy(dtype=float),
            fmt="none",
            ecolor=colour,
            capsize=2,
        )
    ax.plot(x, y, marker, color=colour, linestyle="none")
    ax.plot([], [], marker=marker, color=colour, linestyle=style, label=label)
    if line is not None:
        ends = np.array([x.min(), x.max()])
        ax.plot(ends, line.intercept + line.slope * ends, style, color=colour, linewidth=1)


def draw_joined_beta(joined: JoinedCampaign, ax: Axes, against: str = "delta_T_us_K_m_s") -> Axes:
    """beta of every test, 95 % bars within the campaign (thick) and absolute (thin); trend with band; models."""
    p = joined.posterior
    x = np.array([t.conditions[against] for t in p.tests])
    y = p.beta[0]
    inside, whole = (np.array([e[k].u for e in p.estimates]) for k in ("beta_within", "beta"))
    ax.errorbar(
        x,
        y,
        yerr=Z95 * whole,
        fmt="none",
        ecolor=GREY,
        elinewidth=0.8,
        capsize=2,
        label="95 %, absolute",
    )
    ax.errorbar(
        x,
        y,
        yerr=Z95 * inside,
        fmt="o",
        color=TRUTH,
        markersize=3,
        elinewidth=2.2,
        label="95 %, within the campaign",
    )
    trend = next((t for t in joined.trends if t.against == (against,)), None)
    if trend is not None:
        at = np.linspace(x.min(), x.max(), 50)
        line, u = trend.at(at)
        ax.fill_between(at, line - Z95 * u, line + Z95 * u, color=PALE, zorder=0)
        ax.plot(at, line, ":", color=TRUTH, linewidth=1, label="line, generalised least squares")
    for k, test in enumerate(c for c in joined.curves if c.curve.against == against):
        style = SERIES_LINES[k % len(SERIES_LINES)]
        ax.plot(
            test.curve.x,
            test.curve.beta,
            style,
            color=DISK_COLOUR["fast"],
            linewidth=1.2,
            label=test.curve.file,
        )
    name_points(ax, x, [name.removeprefix("EHL_") for name in p.order])
    return dressed(ax, OVER[against], "heat partition β [1]", legend=True)


def draw_exponent(joined: JoinedCampaign, ax: Axes) -> Axes:
    """n of every test over the entraining speed, 95 % bars against each other, and n of all with its 95 % band."""
    law = joined.law
    x = np.array([t.conditions["entraining_speed_m_s"] for t in joined.posterior.tests])
    n = law.exponent
    ax.axhspan(n.low95, n.high95, color=PALE, zorder=0, label="all tests, 95 %")
    ax.axhline(n.value, color=TRUTH, linestyle="--", linewidth=1)
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
    return dressed(ax, "entraining speed [m/s]", "exponent n of h ~ u^n [1]", loc="lower left")


def draw_junctions(joined: JoinedCampaign, ax: Axes) -> Axes:
    """How much deeper than stated all tests together place each junction, 95 % bars."""
    draw_deeper(joined.deeper_mm, ax, "{} disk")
    return dressed(ax, "junction", "deeper than stated [mm]", legend=True)
