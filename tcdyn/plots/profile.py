"""Pictures of the joint fits' profiles beside the parabolas of their standard uncertainties."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from calibration.estimate import Estimate
from tcdyn.partition.profile_interval import LEVEL, intervals
from tcdyn.plots.style import DISK_COLOUR, GREY

TOP = 9.0
LABELS = {
    "beta": "β [1]",
    "h": "h [W/m²K]",
    "lag_s": "common lag [s]",
    "h_fast": "h of the fast disk [W/m²K]",
    "h_slow": "h of the slow disk [W/m²K]",
    "exponent": "exponent n [1]",
}
TITLES = {"fast": "fast disk alone", "slow": "slow disk alone", "both": "both disks"}
ORDER = (
    ("fast", "beta"), ("fast", "h"), ("fast", "lag_s"), None,
    ("slow", "beta"), ("slow", "h"), ("slow", "lag_s"), None,
    ("both", "beta"), ("both", "h_fast"), ("both", "h_slow"), ("both", "exponent"),
)  # fmt: skip


def draw_profile(own: pd.DataFrame, ax: Axes) -> Axes:
    """One profile (rows of one fit and one parameter) against the parabola; its 95 % interval as a bar at 3.84."""
    fit, parameter = str(own["fit"].iloc[0]), str(own["parameter"].iloc[0])
    colour = DISK_COLOUR.get(fit, "black")
    estimate = Estimate.normal(own["estimate"].iloc[0], own["u"].iloc[0])
    x = np.linspace(own["value"].min(), own["value"].max(), 200)
    ax.plot(x, ((x - estimate.value) / estimate.u) ** 2, color=GREY, linestyle="--", linewidth=1.2)
    ax.plot(own["value"], own["deviance"], ".-", color=colour, markersize=4, linewidth=1.4)
    ax.axhline(LEVEL, color="black", linestyle=":", linewidth=0.9)
    (found,) = intervals(own)
    ends = [found.low_seen if found.low95 is None else found.low95]
    ends += [found.high_seen if found.high95 is None else found.high95]
    ax.plot(ends, [LEVEL, LEVEL], color=colour, linewidth=3, solid_capstyle="butt", alpha=0.6)
    for end, mark, open_end in zip(ends, "<>", (found.low95 is None, found.high95 is None)):
        if open_end:
            ax.plot(end, LEVEL, mark, color=colour, markersize=8)
    ax.set_ylim(0, TOP)
    ax.locator_params(axis="x", nbins=4)
    ax.set_xlabel(LABELS[parameter])
    ax.set_title(TITLES[fit], loc="left", fontsize=9)
    return ax


def draw_profiles(table: pd.DataFrame, axes: Sequence[Axes]) -> Sequence[Axes]:
    """All profiles of ``tcdyn.partition.profile.joint_profiles`` on three rows of four axes, a legend in the corner."""
    for k, (which, ax) in enumerate(zip(ORDER, axes, strict=True)):
        if which is None:
            ax.set_axis_off()
            continue
        draw_profile(table[(table["fit"] == which[0]) & (table["parameter"] == which[1])], ax)
        if k % 4 == 0:
            ax.set_ylabel("deviance [1]")
    corner = axes[3]
    corner.plot([], [], ".-", color="black", label="profile: all else refitted")
    corner.plot([], [], "--", color=GREY, label="standard uncertainty's parabola")
    corner.plot([], [], ":", color="black", label="3.84: 95 %")
    corner.plot([], [], color="black", linewidth=3, alpha=0.6, label="interval of the profile")
    corner.plot([], [], ">", color="black", markersize=8, label="left open by the data")
    corner.legend(frameon=False, fontsize=8, loc="center left")
    return axes
