"""Pictures of one test's heat partition: traces at unloading, lines and points, ways to beta, budget, error map."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from tcdyn.core import Array
from tcdyn.core.estimate import Z95, Estimate
from tcdyn.partition.analyse import Partition
from tcdyn.partition.angular_harmonic import radial_shape
from tcdyn.partition.single_disk import WAYS, OneDisk
from tcdyn.partition.steady import SteadyLine, exponent_sensitivity
from tcdyn.plots.style import (
    DARK,
    DISK_COLOUR,
    DISK_LINE,
    DISK_MARKER,
    GREY,
    PALE,
    TRUTH,
    dressed,
    line_with_band,
    thinned,
)
from tcdyn.rig.disk import DISKS, DiskSetup
from tcdyn.workflows.joint_tables import both_budget, met

STYLES = ("-", "--", ":")
CLEAR: dict[str, Any] = {
    "frameon": True,
    "framealpha": 0.9,
    "edgecolor": "none",
}  # a legend over lines
LITERATURE = 0.571, 0.8  # exponents of the speed law
COURSE_S = 0.5  # of the running mean of residuals
LEAST_SHOWN = 5e-5  # a source of less is in the table only
LEAST_SCALE_K = 0.5  # of the colours round a disk: an even one stays of one tone


def shown(setup: DiskSetup, left_out: Collection[str]) -> dict[str, str]:
    """Line styles of the channels to look at: nearest the surface, and nearest the centre of either row.

    >>> from tcdyn.rig.rigfile import load_rig
    >>> shown(load_rig().disk_setup("fast"), "a")
    {'e': '-', 'b': ':'}
    """
    others = [c for c in setup.outer if c != setup.shallowest] or setup.outer
    central = setup.shallowest, min(others, key=setup.off_centre_m), setup.edge
    return {c: style for c, style in zip(central, STYLES) if c not in left_out}


def draw_unloading(
    p: Partition | OneDisk, disk: str, ax: Axes, before_s: float = 1.5, after_s: float = 5.0
) -> Axes:
    """Readings (grey) and compensated traces with 95 % bands about the parting; time from the parting [s]."""
    t = p.test.time_s[p.rows] - p.test.events.unload_s
    near = (t >= -before_s) & (t <= after_s)
    done = p.compensated[disk]
    setup = p.test.disks[disk].setup
    for ch, style in shown(setup, p.test.disks[disk].left_out).items():
        i = setup.channels.index(ch)
        ax.plot(
            t[near], p.test.disks[disk].readings_degC[p.rows][near, i], color=GREY, linewidth=0.7
        )
        said = f"{ch}, {setup.junctions[ch].depth_m * 1e3:g} mm deep, compensated"
        x = done.temperature[near, i]
        u = done.sd[near, i]
        colour = DISK_COLOUR[disk]
        line_with_band(ax, t[near], x, u, colour, linestyle=style, linewidth=1.6, label=said)
    ax.plot([], [], color=GREY, label="as logged (static line applied)")
    ax.axvline(0.0, color=TRUTH, linewidth=0.8)
    return dressed(ax, "time from parting [s]", "temperature [°C]", head=f"{disk} disk", **CLEAR)


def draw_fit(
    p: Partition | OneDisk, disk: str, whole: Axes, rest: Axes, around_s: float = 10.0
) -> None:
    """Block means of the readings and the joint fit's model about the parting, and below them the residuals [K]."""
    m = met(p, disk)
    near = np.abs(m.at_s) <= around_s
    t = m.at_s[near]
    band = 2 * np.nanmedian(m.sd[near], axis=1)
    rest.fill_between(t, -band, band, color=PALE, step="mid", linewidth=0)
    for k, (c, marker) in enumerate(zip(m.channels, ("o", "s", "^", "D", "v", "P"))):
        if c in p.test.disks[disk].left_out:
            continue
        style: dict[str, Any] = {
            "color": DISK_COLOUR[disk],
            "marker": marker,
            "markersize": 2.0,
            "linestyle": "",
        }
        line: dict[str, Any] = {
            "color": TRUTH,
            "linewidth": 1.1,
            "linestyle": STYLES[k % len(STYLES)],
        }
        whole.plot(t, m.measured[near, k], alpha=0.5, markeredgewidth=0, **style)
        whole.plot(t, m.model[near, k], label=c, **line)
        off = (m.measured - m.model)[near, k]
        rest.plot(t, off, alpha=0.35, markeredgewidth=0, **style)
        close = np.abs(t[:, None] - t) <= COURSE_S / 2
        rest.plot(t, close @ off / close.sum(axis=1), label=c, **line)
    dressed(
        whole, "time from parting [s]", "temperature [°C]", head=f"{disk} disk", loc="lower left"
    )
    dressed(rest, "time from parting [s]", "reading less model [K]", ncols=3, loc="upper left")


def draw_lines(p: Partition, ax: Axes, truth: float | None = None) -> Axes:
    """Both steady lines as beta over h, the speed law's point on each, the cooling fits' and the joint fits' points."""
    top = 1.25 * max([p.speed.h_fast, *(f.h_W_m2K for f in p.cooling.values())])
    h = np.array([0.0, top])
    for disk in DISKS:
        _steady_line(ax, p.lines[disk].line, disk, h, f"{disk} steady line")
        _point(ax, p.answers[f"h_{disk}"], p.answers["speed law"], 0, disk, f"speed law, {disk}")
        for at, way in ((1, "cooling"), (2, "joint")):
            _point(
                ax,
                p.answers[f"h {way} {disk}"],
                p.answers[f"{way} {disk}"],
                at,
                disk,
                f"{way} fit, {disk}",
            )
    if truth is not None:
        ax.axhline(
            truth, color=TRUTH, linestyle=":", linewidth=1.2, label="truth of the simulation"
        )
    ax.set_xlim(0, top)
    x = "heat transfer coefficient of the disk [W/m²K]"
    y = "heat partition β (share of the fast disk) [1]"
    return dressed(ax, x, y, ncols=2, markerscale=0.7)


def draw_line(p: OneDisk, ax: Axes) -> Axes:
    """The steady line of the only disk as beta over h, and the points that its two ways pick on it."""
    h = np.array([0.0, 1.25 * max(p.answers[f"h {way}"].value for way in WAYS)])
    _steady_line(ax, p.line.line, p.disk, h, "steady line")
    for at, way in ((1, "cooling"), (2, "joint")):
        if way not in p.withheld:
            _point(ax, p.answers[f"h {way}"], p.answers[way], at, p.disk, f"{way} fit")
    ax.set_xlim(0, h[-1])
    return dressed(ax, f"h of the {p.disk} disk [W/m²K]", "heat partition β [1]", legend=True)


def _steady_line(ax: Axes, line: SteadyLine, disk: str, h: Array, label: str) -> None:
    """beta of the fast disk over h (N,) [W/m2K] along the steady line of a disk."""
    share = line.intercept + line.slope * h
    beta, word = (share, "β = A + B h") if disk == "fast" else (1 - share, "β = 1 - (C + D h)")
    ax.plot(h, beta, color=DISK_COLOUR[disk], linestyle=DISK_LINE[disk], label=f"{label}, {word}")


def _point(ax: Axes, h: Estimate, beta: Estimate, way: int, disk: str, label: str) -> None:
    """A point with 95 % bars from the budget's draws; the ways' markers nest, so that equal answers stay visible."""
    (marker, size) = (("o", 14), ("s", 9), ("^", 5))[way]
    colour = DISK_COLOUR[disk]
    ax.errorbar(
        h.value,
        beta.value,
        xerr=Z95 * h.u,
        yerr=Z95 * beta.u,
        fmt=marker,
        color=colour,
        markerfacecolor=colour if way == 2 else "white",
        markersize=size,
        capsize=3 + 2 * (2 - way),
        linewidth=0.9,
        zorder=3 + way,
        label=label,
    )


def draw_ways(p: Partition | OneDisk, ax: Axes, truth: float | None = None) -> Axes:
    """beta by every way with its 95 % interval; a simulation's truth as a line."""
    if isinstance(p, OneDisk):
        rows = [(f"{way} {p.disk}", p.answers[way]) for way in WAYS if way not in p.withheld]
    else:
        rows = (
            [("joint, both disks", p.both.estimates["beta"])]
            if "both beta" not in p.withheld
            else []
        )
        rows += [(way, beta) for way, beta in p.ways.items() if way not in p.withheld]
    for k, (name, beta) in enumerate(reversed(rows)):
        disk = name.split()[-1]
        marker = DISK_MARKER.get(disk, "D")
        colour = DISK_COLOUR.get(disk, TRUTH)
        ax.errorbar(beta.value, k, xerr=Z95 * beta.u, fmt=marker, color=colour, capsize=3)
    ax.set_yticks(range(len(rows)), [_way_words(name) for name, _ in reversed(rows)])
    if truth is not None:
        ax.axvline(truth, color=TRUTH, linestyle="--", linewidth=1, label="truth of the simulation")
    ax.set_ylim(-0.6, len(rows) - 0.4)
    return dressed(ax, "heat partition β [1], 95 % intervals", "", legend=truth is not None)


def _way_words(name: str) -> str:
    """A way's name as the tables write it."""
    kind, _, disk = name.partition(" ")
    return f"{kind} fit, {disk} disk" if disk in DISKS else name.replace("joint,", "joint fit,")


def draw_budget(p: Partition | OneDisk, ax: Axes) -> Axes:
    """Standard uncertainty of the headline's beta by source, largest on top; all together at the foot."""
    lone = isinstance(p, OneDisk)
    parts = (
        {source: joint for source, (joint, _) in p.budget.items()}
        if isinstance(p, OneDisk)
        else both_budget(p)
    )
    parts = {source: u for source, u in parts.items() if u >= LEAST_SHOWN}
    together = sum(u**2 for u in parts.values()) ** 0.5
    names = ["all together", *reversed(parts)]
    y = np.arange(len(names)) + np.where(np.arange(len(names)) > 0, 0.5, 0.0)
    ax.barh(y, [together, *reversed(parts.values())], height=0.6, color=DARK)
    ax.axhline(0.75, color=TRUTH, linewidth=0.8)
    ax.set_yticks(y, names)
    return dressed(
        ax, f"standard uncertainty of β by the joint fit{'' if lone else ' of both disks'} [1]", ""
    )


def draw_map(p: Partition, disk: str, ax: Axes) -> Axes:
    """Mean absolute misfit of the steady stretch over (h, share) with the line of least misfit (figure 4.11)."""
    m = p.lines[disk].map
    contours = ax.contour(
        m.h_W_m2K,
        m.share,
        m.mean_abs_K.T,
        levels=[1, 2, 4, 8, 16, 32],
        colors=DISK_COLOUR[disk],
        linewidths=0.8,
    )
    ax.clabel(contours, fmt="%g K", fontsize=7)
    inside = (m.best_share > m.share[0]) & (m.best_share < m.share[-1])
    ax.plot(
        m.h_W_m2K[inside], m.best_share[inside], "k.", markersize=4, label="least misfit at each h"
    )
    ax.plot(
        m.h_W_m2K,
        m.line.intercept + m.line.slope * m.h_W_m2K,
        "k-",
        linewidth=1,
        label="steady line",
    )
    ax.set_ylim(m.share[0], m.share[-1])
    y = "β [1]" if disk == "fast" else "1 - β [1]"
    head = f"{disk} disk: mean |measured - model| [K]"
    return dressed(ax, f"h of the {disk} disk [W/m²K]", y, head=head, loc="upper left", **CLEAR)


def draw_exponent(p: Partition, ax: Axes) -> Axes:
    """beta by the speed law against its exponent (figure 4.17), and the exponent that the two disks imply."""
    low, high = LITERATURE
    n = np.linspace(low - 0.05, high + 0.05, 60)
    beta = exponent_sensitivity(p.lines["fast"].line, p.lines["slow"].line, p.test.speed_ratio, n)
    ax.axvspan(low, high, color=PALE, label="range of the literature")
    ax.plot(n, beta, color=TRUTH, label="speed law")
    implied = p.both.estimates["exponent"]
    both = p.both.estimates["beta"]
    ax.errorbar(
        implied.value,
        both.value,
        xerr=Z95 * implied.u,
        yerr=Z95 * both.u,
        fmt="^",
        color=TRUTH,
        markerfacecolor="white",
        capsize=3,
        label="joint fit of both disks, no speed law",
    )
    ax.plot(p.test.speed_exponent, p.speed.beta, "ko", label="exponent of rig.toml")
    return dressed(ax, "exponent n of h ~ u^n [1]", "heat partition β [1]", legend=True)


def draw_temperatures(p: Partition | OneDisk, ax: Axes) -> Axes:
    """Central thermocouples of the disks over the whole test (figure 6.1)."""
    some = thinned(len(p.test.time_s), 6000)
    t = p.test.time_s[some]
    for disk, one in sorted(p.test.disks.items()):
        for ch, style in shown(one.setup, one.left_out).items():
            y = one.readings_degC[some, one.setup.channels.index(ch)]
            ax.plot(
                t,
                y,
                color=DISK_COLOUR[disk],
                linestyle=style,
                linewidth=1.8 if disk == "fast" else 1,
                label=f"{disk} {ch}",
            )
    for at in (p.test.events.load_on_s, p.test.events.unload_s):
        ax.axvline(at, color=TRUTH, linewidth=0.7)
    return dressed(ax, "time [s]", "temperature [°C]", ncols=2)


def draw_uneven(p: Partition | OneDisk, disk: str, ax: Axes) -> Axes:
    """A disk seen along its shaft: temperature less its mean round it, junctions, and an arrow to the hottest side."""
    known = p.uneven if isinstance(p, OneDisk) else p.both.uneven[disk]
    setup = p.test.disks[disk].setup
    size = known.amplitude_K
    at = known.angle_deg
    inner = setup.bore_radius_m * 1e3
    outer = setup.outer_radius_m * 1e3
    r = np.linspace(inner, outer, 40)
    angle = np.linspace(0.0, 2 * np.pi, 181)
    hot = size.value * np.outer(
        radial_shape(setup, known.h_W_m2K, 1e-3 * (outer - r)), np.cos(angle - np.deg2rad(at.value))
    )
    scale = max(float(np.abs(hot).max()), LEAST_SCALE_K)
    x = np.outer(r, np.cos(angle))
    y = np.outer(r, np.sin(angle))
    tones = ax.pcolormesh(
        x, y, hot, cmap="cividis", vmin=-scale, vmax=scale, shading="gouraud", rasterized=True
    )
    ax.figure.colorbar(tones, ax=ax, shrink=0.75, label="above the mean round the disk [K]")
    for radius in (inner, outer):
        ax.plot(radius * np.cos(angle), radius * np.sin(angle), color=TRUTH, linewidth=0.9)
    for c, j in setup.junctions.items():
        cos = np.cos(np.deg2rad(j.angle_deg))
        sin = np.sin(np.deg2rad(j.angle_deg))
        place = outer - 1e3 * j.depth_m
        ax.plot(
            [place * cos, 1.04 * outer * cos],
            [place * sin, 1.04 * outer * sin],
            color=TRUTH,
            linewidth=0.5,
        )
        ax.plot(
            place * cos,
            place * sin,
            "o",
            color="white",
            markeredgecolor=TRUTH,
            markersize=5,
            zorder=4,
        )
        ax.text(1.1 * outer * cos, 1.1 * outer * sin, c, ha="center", va="center", fontsize=9)
    if known.finding(disk) is not None:
        cos = inner * np.cos(np.deg2rad(at.value))
        sin = inner * np.sin(np.deg2rad(at.value))
        ax.arrow(
            -0.5 * cos,
            -0.5 * sin,
            1.3 * cos,
            1.3 * sin,
            width=0.2,
            head_width=2.0,
            length_includes_head=True,
            color=TRUTH,
        )
        for out in (0.84 * outer / inner, -0.84 * outer / inner):
            ax.text(
                out * cos,
                out * sin,
                f"{np.sign(out) * size.value:+.2g} K",
                ha="center",
                va="center",
                fontsize=8,
                bbox={
                    "boxstyle": "round,pad=0.2",
                    "facecolor": "white",
                    "edgecolor": "none",
                    "alpha": 0.85,
                },
            )
        said = f"{size.text('K').replace('+-', '±')} at {at.value:.0f} ± {at.u:.0f}°"
    else:
        said = f"even within {size.high95:.2g} K"
    ax.set_aspect("equal")
    dressed(ax, "", "", head=f"{disk} disk: {said}").set_axis_off()
    return ax
