"""Figures of the temperature around a disk: its middle plane, its surface, and its press fit.

Used by the pages of a test (:mod:`tcdyn.report.circumferential`) and by the commands
``tcdyn rig circumference simulate`` and ``tcdyn rig circumference fit``
(``tcdyn.cli.circumference``). Constants are for the eye only. Test:
``tests/partition/test_around.py``.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tcdyn.plots.style import DISK_COLOUR, TRUTH, axes_of, figure, line_with_band, style_axes
from tcdyn.rig.circumferential import CircumferentialTemperature
from tcdyn.rig.contact import press_fit_conductance
from tcdyn.rig.disk import DiskSetup
from tcdyn.rig.press_fit import harmonics, mean_shares

MIDDLE_PLANE_M = 1e-4  # junctions nearer than this to the middle plane count as in it; judgement
N_LEVELS = 12  # colour levels of the middle plane
STEP_DEG = 0.25  # resolution of the conductance curve [deg]
LABEL_ON_LEFT = "df"  # junctions labelled on the left, so that labels of neighbours stay apart
CLIPPED = 0.05  # contour labels this near to the top or bottom (share of the depth) would be cut


def draw_middle_plane(around: CircumferentialTemperature, ax: Axes | None = None) -> Axes:
    """Plot the middle plane of a disk over angle and depth, with the junctions and their readings.

    Junctions in the middle plane are filled. Junctions beside it read less than the colour at
    their position.

    Parameters
    ----------
    around
        Circumferential temperature of a disk.
    ax
        Axes to plot into; None: those of a new figure.

    Returns
    -------
    ax
        The same axes.
    """
    ax = axes_of(ax)
    depth = 1e3 * around.depth_m
    filled = ax.contourf(
        around.angle_deg, depth, around.middle_degC, levels=N_LEVELS, cmap="cividis"
    )
    every_second = np.array(filled.levels)[::2]
    lines = ax.contour(
        around.angle_deg, depth, around.middle_degC, levels=every_second, colors="k", linewidths=0.4
    )
    for text in ax.clabel(lines, fmt="%.4g", fontsize=7):
        if not CLIPPED < text.get_position()[1] / depth.max() < 1 - CLIPPED:
            text.remove()
    ax.figure.colorbar(filled, ax=ax, label="middle plane [°C]")
    for name, reading in around.reading_degC.items():
        _draw_junction(around.setup, name, reading, ax)
    ax.set_ylim(1.02 * depth.max(), 0.0)
    y = "depth below the running surface [mm]"
    _style_angle_axes(ax, y, f"{around.disk} disk").grid(False)
    return ax


def _draw_junction(setup: DiskSetup, name: str, reading_degC: float, ax: Axes) -> None:
    """Plot a junction over angle and depth, with its name and its reading.

    Parameters
    ----------
    setup
        The disk.
    name
        Name of the junction.
    reading_degC
        Its reading.
    ax
        Axes to plot into.
    """
    junction = setup.junctions[name]
    position = junction.angle_deg % 360.0, 1e3 * junction.depth_m
    in_middle_plane = abs(junction.z_m - 0.5 * setup.width_m) < MIDDLE_PLANE_M
    ax.plot(
        *position,
        "o",
        color="white",
        markerfacecolor=TRUTH if in_middle_plane else "white",
        markeredgecolor=TRUTH,
        markersize=6,
        zorder=4,
        clip_on=False,
    )
    on_left = name in LABEL_ON_LEFT
    ax.annotate(
        f"{name} {reading_degC:.1f}",
        position,
        xytext=(-6 if on_left else 6, 4),
        textcoords="offset points",
        fontsize=7.5,
        zorder=5,
        ha="right" if on_left else "left",
        bbox={
            "boxstyle": "round,pad=0.15",
            "facecolor": "white",
            "edgecolor": "none",
            "alpha": 0.8,
        },
    )


def draw_running_surface(around: CircumferentialTemperature, ax: Axes | None = None) -> Axes:
    """Plot the mean temperature across the running surface against the angle.

    With its 95 % band.

    Parameters
    ----------
    around
        Circumferential temperature of a disk.
    ax
        Axes to plot into; None: those of a new figure.

    Returns
    -------
    ax
        The same axes.
    """
    ax = axes_of(ax)
    t = around.surface_degC
    colour = DISK_COLOUR[around.disk]
    line_with_band(ax, around.angle_deg, t, around.surface_u_K, colour, linewidth=1.6)
    range_K = float(np.ptp(t))
    title = f"{around.disk} disk: range {range_K:.2g} K over the angle"
    return _style_angle_axes(ax, "running surface [°C]", title)


def circumferential_figure(disks: Sequence[CircumferentialTemperature]) -> Figure:
    """Return the middle plane of each disk, and its running surface below.

    Parameters
    ----------
    disks
        Circumferential temperature of each disk, at most two.
    """
    n = len(disks)
    fig, axes = figure(2, n, width_in=5.0 * n, height_in=6.4)
    for around, upper, lower in zip(disks, axes[:n], axes[n:]):
        draw_middle_plane(around, upper)
        draw_running_surface(around, lower)
    return fig


def draw_press_fit(setup: DiskSetup, ax: Axes) -> Axes:
    """Plot the conductance of the press fit of ``rig.toml`` against the angle.

    The dashed line is the sum of its harmonics 0 to 2. The letters are the junctions.

    Parameters
    ----------
    setup
        A disk with a press fit.
    ax
        Axes to plot into.

    Returns
    -------
    ax
        The same axes.

    Notes
    -----
    Share of the contact (:func:`tcdyn.rig.press_fit.mean_shares`) times the conductance of
    :func:`tcdyn.rig.contact.press_fit_conductance`.
    """
    edges = np.arange(0.0, 360.0 + STEP_DEG, STEP_DEG, dtype=np.float64)
    angle = 0.5 * (edges[1:] + edges[:-1])
    sectors = setup.press_fit.sectors(1e3 * setup.bore_radius_m)
    bearing = 1e-3 * press_fit_conductance(setup)[1]
    conductance = bearing * mean_shares(sectors, edges)
    c = bearing * harmonics(sectors, 2)
    smooth = c[0].real + 2 * sum((c[n] * np.exp(1j * n * np.deg2rad(angle))).real for n in (1, 2))
    colour = DISK_COLOUR[setup.name]
    ax.plot(angle, conductance, color=colour, linewidth=1.6, label="as in rig.toml")
    label = "mean, first and second harmonic"
    ax.plot(angle, smooth, color=TRUTH, linewidth=1.0, linestyle="--", label=label)
    ax.axhline(0.0, color="k", linewidth=0.4)
    transform = ax.get_xaxis_transform()
    for name, j in setup.junctions.items():
        position = (j.angle_deg % 360.0, 0.01)
        ax.annotate(name, position, xycoords=transform, ha="center", fontsize=8)
    ax.set_ylim(min(-0.1 * bearing, ax.get_ylim()[0]), None)
    y = "conductance of the fit [kW/m²K]"
    return _style_angle_axes(ax, y, f"{setup.name} disk", legend=True)


def _style_angle_axes(ax: Axes, y: str, title: str, legend: bool = False) -> Axes:
    """Set the x axis of ``ax`` to one turn around the shaft, and its labels and style.

    Parameters
    ----------
    ax
        Axes to plot into.
    y
        Label of the y axis.
    title
        Title of the axes.
    legend
        Whether to add a legend.

    Returns
    -------
    ax
        The same axes.
    """
    ax.set_xlim(0.0, 360.0)
    ax.set_xticks(np.arange(0, 361, 60))
    return style_axes(ax, "angle around the shaft [deg]", y, title=title, legend=legend)
