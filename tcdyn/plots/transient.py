"""Pictures of the transient fits: answer over the window, both forms, profiles, other structures, junctions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from tcdyn.core.estimate import Z95, Estimate
from tcdyn.core.messages.partition import structure
from tcdyn.core.messages.plunge import percent
from tcdyn.partition.model_forms import Alternatives
from tcdyn.partition.profile import LEVEL, intervals
from tcdyn.partition.sensor_faults import DepthTest
from tcdyn.plots.style import DISK_COLOUR, DISK_MARKER, GREY, PALE, TRUTH, dressed
from tcdyn.rig.disk import DISKS
from tcdyn.workflows.beta_tables import HEADINGS

TOP = 9.0
TITLES = {"fast": "fast disk alone", "slow": "slow disk alone", "both": "both disks"}
ORDER = (
    ("fast", "beta"),
    ("fast", "h"),
    ("fast", "lag_s"),
    None,
    ("slow", "beta"),
    ("slow", "h"),
    ("slow", "lag_s"),
    None,
    ("both", "beta"),
    ("both", "h_fast"),
    ("both", "h_slow"),
    ("both", "exponent"),
)


def draw_profile(own: pd.DataFrame, ax: Axes) -> Axes:
    """One profile (rows of one fit and one parameter) against the parabola; its 95 % interval as a bar at 3.84."""
    fit = str(own["fit"].iloc[0])
    parameter = str(own["parameter"].iloc[0])
    colour = DISK_COLOUR.get(fit, TRUTH)
    estimate = Estimate.normal(own["estimate"].iloc[0], own["u"].iloc[0])
    x = np.linspace(own["value"].min(), own["value"].max(), 200)
    ax.plot(x, ((x - estimate.value) / estimate.u) ** 2, color=GREY, linestyle="--", linewidth=1.2)
    ax.plot(own["value"], own["deviance"], ".-", color=colour, markersize=4, linewidth=1.4)
    ax.axhline(LEVEL, color=TRUTH, linestyle=":", linewidth=0.9)
    (found,) = intervals(own)
    ends = [found.low_seen if found.low95 is None else found.low95]
    ends += [found.high_seen if found.high95 is None else found.high95]
    ax.plot(ends, [LEVEL, LEVEL], color=colour, linewidth=3, solid_capstyle="butt", alpha=0.6)
    for end, mark, open_end in zip(ends, "<>", (found.low95 is None, found.high95 is None)):
        if open_end:
            ax.plot(end, LEVEL, mark, color=colour, markersize=8)
    ax.set_ylim(0, TOP)
    ax.locator_params(axis="x", nbins=4)
    return dressed(ax, HEADINGS[parameter], "", head=TITLES[fit])


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
    corner.plot([], [], ".-", color=TRUTH, label="profile: all else refitted")
    corner.plot([], [], "--", color=GREY, label="standard uncertainty's parabola")
    corner.plot([], [], ":", color=TRUTH, label="3.84: 95 %")
    corner.plot([], [], color=TRUTH, linewidth=3, alpha=0.6, label="interval of the profile")
    corner.plot([], [], ">", color=TRUTH, markersize=8, label="left open by the data")
    corner.legend(frameon=False, fontsize=8, loc="center left")
    return axes


def draw_window_study(
    table: pd.DataFrame, ax: Axes, quantity: str = "beta", truth: float | None = None
) -> Axes:
    """``quantity`` ("beta" or "h_W_m2K") of the cooling fit over window length with 95 % bars; open: within the lag.

    ``table`` is that of ``cooling_by_window``.
    """
    for k, disk in enumerate(DISKS):
        own = table[(table["disk"] == disk) & table[quantity].notna()]
        x = own["window_s"] * (1.0 + 0.03 * k)  # side by side
        ax.errorbar(
            x,
            own[quantity],
            yerr=Z95 * own[f"u_{quantity}"],
            fmt="none",
            ecolor=DISK_COLOUR[disk],
            capsize=2,
            linewidth=0.8,
        )
        for early in (True, False):
            part = (own["within_lag"] == early).to_numpy()
            if part.any():
                ax.plot(
                    x[part],
                    own[quantity][part],
                    DISK_MARKER[disk],
                    color=DISK_COLOUR[disk],
                    markerfacecolor="white" if early else DISK_COLOUR[disk],
                    label=f"{disk} disk" + (", window shorter than the lag" if early else ""),
                )
    if truth is not None:
        ax.axhline(truth, color=TRUTH, linestyle="--", linewidth=1, label="truth of the simulation")
    ax.set_xscale("log")
    ticks = sorted(set(table["window_s"]))
    ax.set_xticks(ticks, [f"{t:g}" for t in ticks])
    ax.minorticks_off()
    y = "heat partition β [1]" if quantity == "beta" else "heat transfer coefficient h [W/m²K]"
    return dressed(ax, "window after the parting [s]", y, legend=True)


def draw_referee(table: pd.DataFrame, ax: Axes) -> Axes:
    """Compensated less commuted, in standard uncertainties of the difference, for beta and h of each disk."""
    names = [
        f"{disk} {'β' if what == 'beta' else 'h'}"
        for disk, what in zip(table["disk"], table["quantity"])
    ]
    ax.axvspan(-2, 2, color=PALE, zorder=0)
    y = range(len(names) - 1, -1, -1)
    for at, disk, z in zip(y, table["disk"], table["z"]):
        ax.plot(z, at, DISK_MARKER[disk], color=DISK_COLOUR[disk])
    ax.axvline(0, color=TRUTH, linewidth=0.8)
    ax.set_yticks(y, names)
    reach = max(3.0, 1.2 * float(table["z"].abs().max()))
    ax.set_xlim(-reach, reach)
    ax.set_ylim(-0.6, len(names) - 0.4)
    return dressed(
        ax, "compensated less commuted,\nin standard uncertainties of the difference [1]", ""
    )


def draw_structures(found: Alternatives, ax: Axes) -> Axes:
    """beta of both disks under every structure, likeliest on top, with 95 % bars and the range over all of them."""
    ax.axvspan(found.low95, found.high95, color=PALE, zorder=0, label="95 % over all of them")
    y = range(len(found.tried) - 1, -1, -1)
    for at, a, likely in zip(y, found.tried, found.probability):
        tone = str(round(0.65 * (1 - likely**0.25), 3))  # a likely one is black, a lost one grey
        ax.errorbar(
            a.beta.value, at, xerr=Z95 * a.beta.u, fmt="D", color=tone, capsize=2, markersize=4
        )
    ax.axvline(found.assumed.beta.value, color=TRUTH, linewidth=0.8)
    names = [f"{structure(a.name)} ({percent(p)})" for a, p in zip(found.tried, found.probability)]
    ax.set_yticks(list(y), names, fontsize=8)
    ax.set_ylim(-0.7, len(found.tried) - 0.3)
    x = "heat partition β by the joint fit of both disks [1]"
    return dressed(ax, x, "", loc="lower left", bbox_to_anchor=(0, 1))


def draw_junctions(tests: Mapping[str, DepthTest], ax: Axes) -> Axes:
    """How much deeper than stated the test alone places each junction, with 95 % bars; grey: the stated 95 %."""
    stated_mm = max(t.stated_u_m for t in tests.values()) * 1e3
    ax.axhspan(-Z95 * stated_mm, Z95 * stated_mm, color=PALE, zorder=0, label="as stated, 95 %")
    deeper = {d: {c: e.times(1e3) for c, e in t.deeper_m.items()} for d, t in tests.items()}
    left_out = [c for t in tests.values() for c in t.left_out]
    draw_deeper(deeper, ax, "{} disk, by this test alone, 95 %", left_out)
    return dressed(
        ax,
        "junction",
        "deeper than stated [mm]",
        ncols=3,
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
    )


def draw_deeper(
    deeper_mm: Mapping[str, Mapping[str, Estimate]],
    ax: Axes,
    label: str,
    left_out: Iterable[str] = (),
) -> None:
    """How much deeper than stated the junctions of each disk lie [mm], 95 % bars, the disks side by side."""
    names = sorted({*left_out, *(c for own in deeper_mm.values() for c in own)})
    for k, (disk, own) in enumerate(deeper_mm.items()):
        ax.errorbar(
            [names.index(c) + 0.24 * (k - 0.5) for c in own],
            [e.value for e in own.values()],
            yerr=[Z95 * e.u for e in own.values()],
            fmt=DISK_MARKER[disk],
            color=DISK_COLOUR[disk],
            capsize=2,
            linewidth=0.9,
            label=label.format(disk),
        )
    ax.set_xticks(range(len(names)), names)
    ax.axhline(0, color=TRUTH, linewidth=0.8)
