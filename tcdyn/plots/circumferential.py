"""Pictures of the temperature round a disk: the middle plane unrolled, and the running surface against the angle."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tcdyn.plots.style import DISK_COLOUR, TRUTH, dressed, figure, line_with_band
from tcdyn.rig.circumferential import Around
from tcdyn.rig.contact import press_fit
from tcdyn.rig.disk import DiskSetup
from tcdyn.rig.press_fit import harmonics, mean_shares

CENTRE_M = 1e-4  # junctions nearer than this to the middle plane are in it
TONES = 12
STEP_DEG = 0.25  # of a drawn conductance
LEFT = "df"  # junctions whose letter stands on the left, clear of a neighbour's


def draw_round(around: Around, ax: Axes) -> Axes:
    """Middle plane of a disk, angle along and depth down, with the junctions: filled those that lie in it.

    A junction's letter stands with what it reads; those beside the middle plane are colder than the colour there.
    """
    depth = 1e3 * around.depth_m
    tones = ax.contourf(around.angle_deg, depth, around.middle_degC, levels=TONES, cmap="cividis")
    lines = ax.contour(
        around.angle_deg,
        depth,
        around.middle_degC,
        levels=np.array(tones.levels)[::2],
        colors="k",
        linewidths=0.4,
    )
    for number in ax.clabel(lines, fmt="%.4g", fontsize=7):
        if not 0.05 < number.get_position()[1] / depth.max() < 0.95:
            number.remove()  # it would be cut by the frame
    ax.figure.colorbar(tones, ax=ax, label="middle plane [°C]")
    for c, seen in around.seen_degC.items():
        j = around.setup.junctions[c]
        at = j.angle_deg % 360.0
        mm = 1e3 * j.depth_m
        inside = abs(j.z_m - 0.5 * around.setup.width_m) < CENTRE_M
        ax.plot(
            at,
            mm,
            "o",
            color="white",
            markerfacecolor=TRUTH if inside else "white",
            markeredgecolor=TRUTH,
            markersize=6,
            zorder=4,
            clip_on=False,
        )
        side = -1 if c in LEFT else 1
        ax.annotate(
            f"{c} {seen:.1f}",
            (at, mm),
            xytext=(6 * side, 4),
            textcoords="offset points",
            fontsize=7.5,
            zorder=5,
            ha="left" if side > 0 else "right",
            bbox={
                "boxstyle": "round,pad=0.15",
                "facecolor": "white",
                "edgecolor": "none",
                "alpha": 0.8,
            },
        )
    ax.set_ylim(1.02 * depth.max(), 0.0)
    _all_round(ax, "depth below the running surface [mm]", f"{around.disk} disk").grid(False)
    return ax


def draw_round_surface(around: Around, ax: Axes) -> Axes:
    """Mean temperature across the running surface against the angle, with its 95 % band where it has one."""
    t = around.surface_degC
    line_with_band(
        ax, around.angle_deg, t, around.surface_u_K, DISK_COLOUR[around.disk], linewidth=1.6
    )
    head = f"{around.disk} disk: {float(np.ptp(t)):.2g} K between the hottest and the coldest side"
    return _all_round(ax, "running surface [°C]", head)


def round_figure(disks: Sequence[Around]) -> Figure:
    """The middle planes of both disks, and below them their running surfaces."""
    picture, axes = figure(2, 2, width_in=10.0, height_in=6.4)
    for around, whole, surface in zip(disks, axes[:2], axes[2:]):
        draw_round(around, whole)
        draw_round_surface(around, surface)
    return picture


def draw_fit(setup: DiskSetup, ax: Axes) -> Axes:
    """Conductance of a stated press fit against the angle, its harmonics 0 to 2, and where the junctions are."""
    edges = np.arange(0.0, 360.0 + STEP_DEG, STEP_DEG, dtype=np.float64)
    angle = 0.5 * (edges[1:] + edges[:-1])
    colour = DISK_COLOUR[setup.name]
    sectors = setup.fit.sectors(1e3 * setup.bore_radius_m)
    bearing = 1e-3 * press_fit(setup)[1]
    c = bearing * harmonics(sectors, 2)
    smooth = c[0].real + 2 * sum((c[n] * np.exp(1j * n * np.deg2rad(angle))).real for n in (1, 2))
    ax.plot(
        angle, bearing * mean_shares(sectors, edges), color=colour, linewidth=1.6, label="as stated"
    )
    ax.plot(
        angle,
        smooth,
        color=TRUTH,
        linewidth=1.0,
        linestyle="--",
        label="mean, first and second harmonic",
    )
    ax.axhline(0.0, color="k", linewidth=0.4)
    for name, j in setup.junctions.items():
        ax.annotate(
            name,
            (j.angle_deg % 360.0, 0.01),
            xycoords=ax.get_xaxis_transform(),
            ha="center",
            fontsize=8,
        )
    ax.set_ylim(min(-0.1 * bearing, ax.get_ylim()[0]), None)
    return _all_round(ax, "conductance of the fit [kW/m²K]", f"{setup.name} disk", legend=True)


def _all_round(ax: Axes, y: str, head: str, legend: bool = False) -> Axes:
    """``ax`` over a whole turn round the shaft."""
    ax.set_xlim(0.0, 360.0)
    ax.set_xticks(np.arange(0, 361, 60))
    return dressed(ax, "angle round the shaft [deg]", y, head=head, legend=legend)
