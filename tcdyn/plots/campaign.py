"""Pictures of a campaign: temperatures and traction over load, friction over speed, beta over dT u_s."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calibration.disk import DISKS
from tcdyn.pipeline.campaign_table import done_rows, trend
from tcdyn.plots.style import DISK_COLOUR, figure

MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
DISK_MARKER = {"fast": "o", "slow": "s"}
SHADES = ("#000000", "#4d4d4d", "#7a7a7a", "#a0a0a0")


def temperature_figure(table: pd.DataFrame, quantity: str, label: str) -> Figure:
    """Both disks' ``<disk>_<quantity>`` over load, one panel for each sliding speed (figures 6.17 and 7.20)."""
    good = done_rows(table)
    parts = [part for _, part in good.groupby("group")]
    columns = 2 if len(parts) > 1 else 1
    rows = -(-len(parts) // columns)
    fig, axes = figure(rows, columns, height_in=3.2 * rows)
    for ax, part in zip(axes, parts):
        draw_temperature(part, quantity, label, ax)
    for ax in axes[len(parts) :]:
        ax.set_visible(False)
    return fig


def draw_temperature(part: pd.DataFrame, quantity: str, label: str, ax: Axes) -> Axes:
    """``<disk>_<quantity>`` [degC] of tests of one sliding speed over load, with least-squares lines."""
    load = part["load_N"].to_numpy(dtype=float)
    for disk in DISKS:
        y = part[f"{disk}_{quantity}"].to_numpy(dtype=float)
        ax.plot(load, y, DISK_MARKER[disk], color=DISK_COLOUR[disk], label=f"{disk} disk")
        _trend(ax, load, y, DISK_COLOUR[disk])
    ax.set_xlabel("load [N]")
    ax.set_ylabel(f"{label} [°C]")
    ax.set_title(f"sliding at {part['sliding_speed_m_s'].mean():.1f} m/s", loc="left", fontsize=9)
    ax.legend(frameon=False, fontsize=8)
    return ax


def draw_traction(table: pd.DataFrame, ax: Axes) -> Axes:
    """Traction force over load, a marker and a line for each sliding speed (figure 6.33)."""
    for k, (_, part) in enumerate(done_rows(table).groupby("group")):
        load, y = part["load_N"].to_numpy(dtype=float), part["friction_N"].to_numpy(dtype=float)
        colour = SHADES[k % len(SHADES)]
        label = f"{part['sliding_speed_m_s'].mean():.1f} m/s"
        ax.plot(load, y, MARKERS[k % len(MARKERS)], color=colour, label=label)
        _trend(ax, load, y, colour)
    ax.set_xlabel("load [N]")
    ax.set_ylabel("traction force [N]")
    ax.legend(frameon=False, fontsize=8, title="sliding speed")
    return ax


def draw_friction_coefficient(table: pd.DataFrame, ax: Axes) -> Axes:
    """Friction coefficient over sliding speed at the highest load of the campaign (figure 6.34)."""
    good = done_rows(table)
    top = good["load_N"].max()
    part = good[good["load_N"] > 0.95 * top]
    speed = part["sliding_speed_m_s"].to_numpy(dtype=float)
    y = part["friction_coefficient"].to_numpy(dtype=float)
    ax.plot(speed, y, "ko", label=f"load {top:.0f} N")
    _trend(ax, speed, y, "black")
    ax.set_xlabel("sliding speed [m/s]")
    ax.set_ylabel("coefficient of friction [1]")
    ax.legend(frameon=False, fontsize=8)
    return ax


def draw_beta(table: pd.DataFrame, ax: Axes) -> Axes:
    """beta by the speed law, and by both disks' joint fit, over dT u_s with 95 % bars and a line (figure 7.18)."""
    good = done_rows(table)
    x = good["delta_T_us_K_m_s"].to_numpy(dtype=float)
    for column, marker, colour, label in (
        ("beta", "o", "black", "speed law"),
        ("beta_both", "^", "#7a7a7a", "joint fit, both disks"),
    ):
        y, u = good[column].to_numpy(dtype=float), good[f"u_{column}"].to_numpy(dtype=float)
        ax.errorbar(x, y, yerr=1.96 * u, fmt=marker, color=colour, capsize=2, linewidth=0.8, label=label)
    _trend(ax, x, good["beta"].to_numpy(dtype=float), "black")
    for at, name in zip(x, good["test"]):
        ax.annotate(
            str(name), (at, ax.get_ylim()[0]), fontsize=7, rotation=90, ha="center", va="bottom", color="#666666"
        )
    ax.set_xlabel("temperature difference of the surfaces times sliding speed, ΔT u_s [K m/s]")
    ax.set_ylabel("heat partition β [1]")
    ax.legend(frameon=False, fontsize=8)
    return ax


def _trend(ax: Axes, x: np.ndarray, y: np.ndarray, colour: str) -> None:
    line = trend(x, y)
    if line is not None:
        ends = np.array([x.min(), x.max()])
        ax.plot(ends, line[0] + line[1] * ends, "-", color=colour, linewidth=1)
