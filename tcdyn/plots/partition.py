"""Figures of the heat partition of one test: unloading, fits, estimates of beta, budget.

Used by the pages of one test (``tcdyn/report/beta.py``), by :func:`tcdyn.plots.pick.draw` and by
the gallery of the manual. Constants are for the eye only, except
``LITERATURE_EXPONENTS``, which is data. Tests:
``tests/report/test_pictures.py`` and ``tests/report/test_beta_page.py``.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from tcdyn.core import Array
from tcdyn.core.estimate import Estimate
from tcdyn.partition.analyse import Partition
from tcdyn.partition.angular_harmonic import AngularHarmonic, radial_shape
from tcdyn.partition.joint_results import compare_joint_fit, joint_budget
from tcdyn.partition.steady import SteadyLine, exponent_sensitivity
from tcdyn.plots.style import (
    DARK,
    DISK_COLOUR,
    DISK_LINE,
    DISK_MARKER,
    GREY,
    PALE,
    TRUTH,
    axes_of,
    line_with_band,
    screen_rows,
    style_axes,
)
from tcdyn.rig.disk import DISKS, DiskSetup

# Line styles of channels, in the order in which they are plotted.
STYLES = ("-", "--", ":")
# End of the axis of h where no estimate is possible [W/m2K].
DEFAULT_H_MAX_W_M2K = 1000.0
# Labels and legend style that several figures share.
X_UNLOADING = "time from unloading [s]"
Y_TEMPERATURE = "temperature [°C]"
TRUTH_LABEL = "truth of the simulation"
LEGEND_OVER_LINES: dict[str, Any] = {"frameon": True, "framealpha": 0.9, "edgecolor": "none"}
# Range of the exponent n of h ~ u^n in the literature, by section 7.4 of the thesis (0.57 and 0.8).
# Data; equal to the defaults of ``speed_exponent_low`` and ``speed_exponent_high`` in
# ``tcdyn.rig.tables.UncertaintyTable``.
LITERATURE_EXPONENTS = (0.571, 0.8)
FIT_SHOWN_S = 10.0  # before and after the unloading, in the figure of the joint fit [s]
RUNNING_MEAN_S = 0.5  # window of the running mean of the residuals [s]; chosen by judgement
MIN_PLOTTED_U = 5e-5  # sources with a smaller u(beta) [1] are in the table only; judgement
N_LEVELS = 20  # of the field of the first harmonic; chosen by judgement
MIN_SCALE_K = 0.5  # half of the colour range, so that an even disk has one tone; judgement
ESTIMATOR_MARKERS = (("o", 14), ("s", 9), ("^", 5))  # speed law, cooling fit, joint fit: they nest


def plotted_channels(setup: DiskSetup, excluded: Collection[str]) -> dict[str, str]:
    """Return line styles of three channels: nearest the surface, and most central of each row.

    Parameters
    ----------
    setup
        The disk.
    excluded
        Channels that are not plotted.

    Returns
    -------
    styles
        Line style by channel; at most three.

    Examples
    --------
    >>> from tcdyn.rig.rigfile import load_rig
    >>> plotted_channels(load_rig().disk_setup("fast"), "a")
    {'e': '-', 'b': ':'}
    """
    outer_row = [c for c in setup.outer if c != setup.shallowest] or setup.outer
    central_outer = min(outer_row, key=setup.distance_from_centre_m)
    channels = (setup.shallowest, central_outer, setup.edge)
    return {c: style for c, style in zip(channels, STYLES) if c not in excluded}


def draw_unloading(
    partition: Partition,
    disk: str,
    ax: Axes | None = None,
    before_s: float = 1.5,
    after_s: float = 5.0,
) -> Axes:
    """Plot readings (grey) and compensated traces with their 95 % bands around the unloading.

    Parameters
    ----------
    partition
        Result of one test.
    disk
        Name of the disk.
    ax
        Axes to plot into; None: those of a new figure.
    before_s, after_s
        Time before and after the unloading [s].

    Returns
    -------
    ax
        The same axes.
    """
    ax = axes_of(ax)
    t = partition.test.time_s[partition.rows] - partition.test.events.unload_s
    near = (t >= -before_s) & (t <= after_s)
    compensated = partition.compensated[disk]
    record = partition.test.disks[disk]
    setup = record.setup
    colour = DISK_COLOUR[disk]
    for channel, style in plotted_channels(setup, record.excluded).items():
        i = setup.channels.index(channel)
        ax.plot(t[near], record.readings_degC[partition.rows][near, i], color=GREY, linewidth=0.7)
        label = f"{channel}, {setup.junctions[channel].depth_m * 1e3:g} mm deep, compensated"
        x = compensated.temperature[near, i]
        u = compensated.sd[near, i]
        line_with_band(ax, t[near], x, u, colour, linestyle=style, linewidth=1.6, label=label)
    ax.plot([], [], color=GREY, label="as logged (static line applied)")
    ax.axvline(0.0, color=TRUTH, linewidth=0.8)
    return style_axes(ax, X_UNLOADING, Y_TEMPERATURE, title=f"{disk} disk", **LEGEND_OVER_LINES)


def draw_joint_fit(partition: Partition, disk: str, upper: Axes, lower: Axes) -> None:
    """Plot block means of the readings with the model of the joint fit, and the residuals below.

    Parameters
    ----------
    partition
        Result of one test.
    disk
        Name of the disk.
    upper, lower
        Axes of the temperatures and of the residuals.

    Notes
    -----
    The band is two standard deviations of the block means. The running mean over ``RUNNING_MEAN_S``
    is for the eye; no result uses it.
    """
    blocks = compare_joint_fit(partition, disk)
    near = np.abs(blocks.time_since_unloading_s) <= FIT_SHOWN_S
    t = blocks.time_since_unloading_s[near]
    band = 2 * np.nanmedian(blocks.sd_K[near], axis=1)
    lower.fill_between(t, -band, band, color=PALE, step="mid", linewidth=0)
    in_window = np.abs(t[:, None] - t) <= RUNNING_MEAN_S / 2
    points: dict[str, Any] = {
        "color": DISK_COLOUR[disk],
        "markersize": 2.0,
        "linestyle": "",
        "markeredgewidth": 0,
    }
    for k, (channel, marker) in enumerate(zip(blocks.channels, ("o", "s", "^", "D", "v", "P"))):
        if channel in partition.test.disks[disk].excluded:
            continue
        line: dict[str, Any] = {
            "color": TRUTH,
            "linewidth": 1.1,
            "linestyle": STYLES[k % len(STYLES)],
            "label": channel,
        }
        measured = blocks.readings_degC[near, k]
        model = blocks.model_degC[near, k]
        points["gid"] = channel
        upper.plot(t, measured, alpha=0.5, marker=marker, **points)
        upper.plot(t, model, **line)
        residual = measured - model
        lower.plot(t, residual, alpha=0.35, marker=marker, **points)
        lower.plot(t, in_window @ residual / in_window.sum(axis=1), **line)
    style_axes(upper, X_UNLOADING, Y_TEMPERATURE, title=f"{disk} disk", loc="lower left")
    style_axes(lower, X_UNLOADING, "reading minus model [K]", ncols=3, loc="upper left")


def draw_lines(partition: Partition, ax: Axes | None = None, truth: float | None = None) -> Axes:
    """Plot both steady lines as beta over h, with the estimates of all estimators.

    Parameters
    ----------
    partition
        Result of one test.
    ax
        Axes to plot into; None: those of a new figure.
    truth
        Beta of a simulation; None: not plotted.

    Returns
    -------
    ax
        The same axes.
    """
    ax = axes_of(ax)
    points = [
        (disk, k, partition.estimates[key], partition.estimates[h_key], f"{name}, {disk}")
        for disk in partition.disks
        for k, (key, h_key, name) in enumerate(
            (
                ("speed law", f"h_{disk}", "speed law"),
                (f"cooling {disk}", f"h cooling {disk}", "cooling fit"),
                (f"joint {disk}", f"h joint {disk}", "joint fit"),
            )
        )
        if key in partition.estimates and key not in partition.impossible
    ]
    h_max = 1.25 * max((h.value for _, _, _, h, _ in points), default=DEFAULT_H_MAX_W_M2K)
    h = np.array([0.0, h_max])
    for disk in partition.disks:
        _steady_line(ax, partition.lines[disk].line, disk, h, f"{disk} steady line")
    for disk, k, beta, h_estimate, label in points:
        _plot_estimate(ax, h_estimate, beta, k, disk, label)
    if truth is not None:
        ax.axhline(truth, color=TRUTH, linestyle=":", linewidth=1.2, label=TRUTH_LABEL)
    ax.set_xlim(0, h_max)
    x = "heat transfer coefficient of the disk [W/m²K]"
    y = "heat partition β (share of the fast disk) [1]"
    return style_axes(
        ax, x, y, markerscale=0.7, ncols=2, loc="upper center", bbox_to_anchor=(0.5, -0.14)
    )


def _steady_line(ax: Axes, line: SteadyLine, disk: str, h: Array, label: str) -> None:
    """Plot beta (share of the fast disk) over h (N,) [W/m2K] along the steady line of a disk.

    Parameters
    ----------
    ax
        Axes to plot into.
    line
        Steady line: share of the disk over h.
    disk
        Name of the disk; the share of the slow disk is one minus beta.
    h
        Heat transfer coefficients (N,) [W/m2K].
    label
        Entry of the legend, in front of the equation.
    """
    beta = line.intercept + line.slope * h
    equation = "β = A + B h"
    if disk == "slow":
        beta = 1 - beta
        equation = "β = 1 - (C + D h)"
    ax.plot(
        h, beta, label=f"{label}, {equation}", color=DISK_COLOUR[disk], linestyle=DISK_LINE[disk]
    )


def _plot_estimate(
    ax: Axes, h: Estimate, beta: Estimate, estimator: int, disk: str, label: str
) -> None:
    """Plot an estimate of h and beta with 95 % bars.

    Markers and caps differ in size between estimators, so that equal estimates stay visible.

    Parameters
    ----------
    ax
        Axes to plot into.
    h, beta
        The two estimates.
    estimator
        Index in ``ESTIMATOR_MARKERS``.
    disk
        Name of the disk, for the colour.
    label
        Entry of the legend.
    """
    marker, size = ESTIMATOR_MARKERS[estimator]
    colour = DISK_COLOUR[disk]
    last = len(ESTIMATOR_MARKERS) - 1
    ax.errorbar(
        h.value,
        beta.value,
        xerr=np.transpose([h.half_widths95]),
        yerr=np.transpose([beta.half_widths95]),
        fmt=marker,
        color=colour,
        markerfacecolor=colour if estimator == last else "white",
        markersize=size,
        capsize=3 + 2 * (last - estimator),
        linewidth=0.9,
        zorder=3 + estimator,
        label=label,
    )


def draw_beta_estimates(
    partition: Partition, ax: Axes | None = None, truth: float | None = None
) -> Axes:
    """Plot every estimate of beta with its 95 % interval.

    Parameters
    ----------
    partition
        Result of one test.
    ax
        Axes to plot into; None: those of a new figure.
    truth
        Beta of a simulation; None: not plotted.

    Returns
    -------
    ax
        The same axes.
    """
    ax = axes_of(ax)
    estimates = _given_estimates(partition)
    for k, (name, beta) in enumerate(reversed(estimates)):
        disk = name.split()[-1]
        marker = DISK_MARKER.get(disk, "D")
        colour = DISK_COLOUR.get(disk, TRUTH)
        half_widths = np.transpose([beta.half_widths95])
        ax.errorbar(beta.value, k, xerr=half_widths, fmt=marker, color=colour, capsize=3)
    labels = [_estimator_label(name) for name, _ in reversed(estimates)]
    ax.set_yticks(range(len(estimates)), labels)
    if truth is not None:
        ax.axvline(truth, color=TRUTH, linestyle="--", linewidth=1, label=TRUTH_LABEL)
    ax.set_ylim(-0.6, len(estimates) - 0.4)
    x = "heat partition β [1], 95 % intervals"
    return style_axes(ax, x, "", legend=truth is not None)


def _given_estimates(partition: Partition) -> list[tuple[str, Estimate]]:
    """Return the estimators of beta with their estimates, without those that are withheld.

    Parameters
    ----------
    partition
        Result of one test.

    Returns
    -------
    estimates
        (name, estimate), the most important first.
    """
    estimates = [
        (name, beta)
        for name, beta in partition.beta_by_estimator.items()
        if name not in partition.impossible
    ]
    if partition.single_disk:
        return estimates[::-1]
    if "both beta" in partition.impossible:
        return estimates
    return [("joint, both disks", partition.combined.estimates["beta"]), *estimates]


def _estimator_label(name: str) -> str:
    """Return the name of an estimator as the tables write it."""
    kind, _, disk = name.partition(" ")
    if disk in DISKS:
        return f"{kind} fit, {disk} disk"
    return name.replace("joint,", "joint fit,")


def draw_budget(partition: Partition, ax: Axes | None = None) -> Axes:
    """Plot the standard uncertainty of beta by source.

    The largest source is on top, the combined uncertainty at the bottom.

    Parameters
    ----------
    partition
        Result of one test.
    ax
        Axes to plot into; None: those of a new figure.

    Returns
    -------
    ax
        The same axes.

    Notes
    -----
    ``MIN_PLOTTED_U`` leaves small sources out of the figure and of its sum.
    """
    ax = axes_of(ax)
    u_by_source = joint_budget(partition)
    estimator = "the joint fit" if partition.single_disk else "the joint fit of both disks"
    components = {source: u for source, u in u_by_source.items() if u >= MIN_PLOTTED_U}
    combined = sum(u**2 for u in components.values()) ** 0.5
    names = ["all together", *reversed(components)]
    y = np.arange(len(names)) + 0.5
    y[0] = 0.0
    ax.barh(y, [combined, *reversed(components.values())], height=0.6, color=DARK)
    ax.axhline(0.75, color=TRUTH, linewidth=0.8)
    ax.set_yticks(y, names)
    return style_axes(ax, f"standard uncertainty of β by {estimator} [1]", "")


def draw_map(partition: Partition, disk: str, ax: Axes | None = None) -> Axes:
    """Plot the mean absolute misfit of the steady segment over h and share (figure 4.11).

    The dots are the least misfit at each h, the line is the steady line.

    Parameters
    ----------
    partition
        Result of one test.
    disk
        Name of the disk.
    ax
        Axes to plot into; None: those of a new figure.

    Returns
    -------
    ax
        The same axes.
    """
    ax = axes_of(ax)
    error_map = partition.lines[disk].map
    h = error_map.h_W_m2K
    share = error_map.share
    colour = DISK_COLOUR[disk]
    contours = ax.contour(
        h,
        share,
        error_map.mean_abs_K.T,
        levels=[1, 2, 4, 8, 16, 32],
        colors=colour,
        linewidths=0.8,
    )
    ax.clabel(contours, fmt="%g K", fontsize=7)
    best = error_map.best_share
    inside = (best > share[0]) & (best < share[-1])
    ax.plot(h[inside], best[inside], "k.", markersize=4, label="least misfit at each h")
    line = error_map.line.intercept + error_map.line.slope * h
    ax.plot(h, line, "k-", linewidth=1, label="steady line")
    ax.set_ylim(share[0], share[-1])
    return style_axes(
        ax,
        f"h of the {disk} disk [W/m²K]",
        "β [1]" if disk == "fast" else "1 - β [1]",
        title=f"{disk} disk: mean |measured - model| [K]",
        loc="upper left",
        **LEGEND_OVER_LINES,
    )


def draw_beta_by_exponent(partition: Partition, ax: Axes | None = None) -> Axes:
    """Plot beta by the speed law against its exponent (figure 4.17).

    The triangle is the exponent that the joint fit of both disks implies, without the speed law;
    its bars are the 95 % intervals of exponent and beta, each by itself. The shaded band is
    ``LITERATURE_EXPONENTS``. The black dot is beta by the speed law at the exponent of rig.toml.

    Parameters
    ----------
    partition
        Result of one test.
    ax
        Axes to plot into; None: those of a new figure.

    Returns
    -------
    ax
        The same axes.

    Notes
    -----
    Style and range of n may change. The band is not that of rig.toml: ``speed_exponent_low`` and
    ``speed_exponent_high`` may differ from it. :func:`tcdyn.plots.campaign.draw_exponent` plots the
    exponent itself, of many tests. No test asserts on this figure; the tests of the page draw it
    (``tests/report/test_beta_page.py``).
    """
    ax = axes_of(ax)
    low, high = LITERATURE_EXPONENTS
    n = np.linspace(low - 0.05, high + 0.05, 60)
    beta = exponent_sensitivity(
        partition.lines["fast"].line, partition.lines["slow"].line, partition.test.speed_ratio, n
    )
    ax.axvspan(low, high, color=PALE, label="range of the literature")
    ax.plot(n, beta, color=TRUTH, label="speed law")
    implied = partition.combined.estimates["exponent"]
    joint_beta = partition.combined.estimates["beta"]
    ax.errorbar(
        implied.value,
        joint_beta.value,
        xerr=np.transpose([implied.half_widths95]),
        yerr=np.transpose([joint_beta.half_widths95]),
        fmt="^",
        color=TRUTH,
        markerfacecolor="white",
        capsize=3,
        label="joint fit of both disks, no speed law",
    )
    ax.plot(partition.test.speed_exponent, partition.speed.beta, "ko", label="exponent of rig.toml")
    return style_axes(ax, "exponent n of h ~ u^n [1]", "heat partition β [1]", legend=True)


def draw_temperatures(partition: Partition, ax: Axes | None = None) -> Axes:
    """Plot the central thermocouples of the disks over the full test (figure 6.1).

    Parameters
    ----------
    partition
        Result of one test.
    ax
        Axes to plot into; None: those of a new figure.

    Returns
    -------
    ax
        The same axes.
    """
    ax = axes_of(ax)
    for disk, record in sorted(partition.test.disks.items()):
        width = 1.8 if disk == "fast" else 1
        for channel, style in plotted_channels(record.setup, record.excluded).items():
            y = record.readings_degC[:, record.setup.channels.index(channel)]
            rows = screen_rows(y)
            time_s = partition.test.time_s[rows]
            ax.plot(
                time_s,
                y[rows],
                linewidth=width,
                label=f"{disk} {channel}",
                color=DISK_COLOUR[disk],
                linestyle=style,
            )
    for event_s in (partition.test.events.load_on_s, partition.test.events.unload_s):
        ax.axvline(event_s, color=TRUTH, linewidth=0.7)
    return style_axes(ax, "time [s]", Y_TEMPERATURE, ncols=2)


def draw_angular_harmonic(partition: Partition, disk: str, ax: Axes) -> Axes:
    """Plot the first circumferential harmonic of a disk, seen along its shaft.

    The colour is the temperature above the mean around the disk. Where the harmonic is
    significant, an arrow points to the hottest side and the title states its amplitude and angle.

    Parameters
    ----------
    partition
        Result of one test.
    disk
        Name of the disk.
    ax
        Axes to plot into.

    Returns
    -------
    ax
        The same axes.
    """
    harmonic = partition.combined.harmonics[disk]
    setup = partition.test.disks[disk].setup
    amplitude = harmonic.amplitude_K
    angle = harmonic.hottest_angle_deg
    _draw_field_of_harmonic(setup, harmonic, ax)
    outer_mm = setup.outer_radius_m * 1e3
    for name, junction in setup.junctions.items():
        direction = _unit_vector(junction.angle_deg)
        radius_mm = outer_mm - 1e3 * junction.depth_m
        ax.plot(*np.outer(direction, [radius_mm, 1.04 * outer_mm]), color=TRUTH, linewidth=0.5)
        ax.plot(
            *(radius_mm * direction),
            "o",
            color="white",
            markeredgecolor=TRUTH,
            markersize=5,
            zorder=4,
        )
        x, y = 1.1 * outer_mm * direction
        ax.text(x, y, name, ha="center", va="center", fontsize=9)
    if harmonic.finding(disk) is None:
        result = f"even within {amplitude.high95:.2g} K"
    else:
        _draw_hottest_side(setup, amplitude.value, angle.value, ax)
        size = amplitude.text("K").replace("+-", "±")
        result = f"{size} at {angle.value:.0f} ± {angle.u:.0f}°"
    ax.set_aspect("equal")
    style_axes(ax, "", "", title=f"{disk} disk: {result}").set_axis_off()
    return ax


def _unit_vector(angle_deg: float) -> Array:
    """Return the unit vector (2,) at an angle.

    Parameters
    ----------
    angle_deg
        Angle from the x axis [deg].

    Returns
    -------
    direction
        (2,).
    """
    angle_rad = np.deg2rad(angle_deg)
    return np.array([np.cos(angle_rad), np.sin(angle_rad)])


def _draw_field_of_harmonic(setup: DiskSetup, harmonic: AngularHarmonic, ax: Axes) -> None:
    """Plot the first harmonic of the temperature between bore and running surface.

    Parameters
    ----------
    setup
        The disk.
    harmonic
        Amplitude, angle and h.
    ax
        Axes to plot into.
    """
    inner_mm = setup.bore_radius_m * 1e3
    outer_mm = setup.outer_radius_m * 1e3
    r = np.linspace(inner_mm, outer_mm, 40)
    angle = np.linspace(0.0, 2 * np.pi, 181)
    shape = radial_shape(setup, harmonic.h_W_m2K, 1e-3 * (outer_mm - r))
    hottest_rad = np.deg2rad(harmonic.hottest_angle_deg.value)
    field = harmonic.amplitude_K.value * np.outer(shape, np.cos(angle - hottest_rad))
    scale = max(float(np.abs(field).max()), MIN_SCALE_K)
    filled = ax.contourf(
        np.outer(r, np.cos(angle)),
        np.outer(r, np.sin(angle)),
        field,
        levels=np.linspace(-scale, scale, N_LEVELS + 1),
        cmap="cividis",
    )
    ticks = np.linspace(-scale, scale, 5)
    label = "above the mean around the disk [K]"
    ax.figure.colorbar(filled, ax=ax, shrink=0.75, ticks=ticks, format="%.2g", label=label)
    for radius in (inner_mm, outer_mm):
        ax.plot(radius * np.cos(angle), radius * np.sin(angle), color=TRUTH, linewidth=0.9)


def _draw_hottest_side(setup: DiskSetup, amplitude_K: float, angle_deg: float, ax: Axes) -> None:
    """Plot an arrow to the hottest side, and the amplitude on both sides.

    Parameters
    ----------
    setup
        The disk.
    amplitude_K, angle_deg
        Amplitude, and angle of the hottest side.
    ax
        Axes to plot into.
    """
    direction = _unit_vector(angle_deg)
    inner_mm = setup.bore_radius_m * 1e3
    outer_mm = setup.outer_radius_m * 1e3
    ax.arrow(
        *(-0.5 * inner_mm * direction),
        *(1.3 * inner_mm * direction),
        width=0.2,
        head_width=2.0,
        length_includes_head=True,
        color=TRUTH,
    )
    for sign in (1, -1):
        x, y = sign * 0.84 * outer_mm * direction
        ax.text(
            x,
            y,
            f"{sign * amplitude_K:+.2g} K",
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
