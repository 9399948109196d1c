"""Figures of the transient fits: window study, profile likelihoods, model forms, depths.

Used by the pages of one test (:mod:`tcdyn.report.beta`), by the gallery of the manual and, for
depth errors, by :mod:`tcdyn.plots.campaign`. Tests: ``tests/partition/test_windows.py`` and
``tests/partition/test_structures.py``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from tcdyn.core.estimate import Z95, Estimate
from tcdyn.core.messages.partition import model_form_text
from tcdyn.core.messages.plunge import probability_text
from tcdyn.partition.model_forms import ModelForms
from tcdyn.partition.profile import DEVIANCE_95, intervals
from tcdyn.partition.sensor_faults import DepthTest
from tcdyn.plots.style import (
    DISK_COLOUR,
    DISK_MARKER,
    GREY,
    PALE,
    TRUTH,
    axes_of,
    log_axis,
    style_axes,
)
from tcdyn.rig.disk import DISKS
from tcdyn.workflows.beta_tables import COLUMN_HEADINGS

MAX_DEVIANCE = 9.0  # top of the profiles: three standard uncertainties
# Titles of the fits.
TITLES = {"fast": "fast disk alone", "slow": "slow disk alone", "both": "both disks"}
# Parameters of the panels of a fit.
PANELS = {
    "fast": ("beta", "h", "lag_s"),
    "slow": ("beta", "h", "lag_s"),
    "both": ("beta", "h_fast", "h_slow", "exponent"),
}


def draw_profile(profile: pd.DataFrame, ax: Axes) -> Axes:
    """Plot a profile likelihood and the parabola of the standard uncertainty.

    The thick bar is the 95 % interval of the profile, at a deviance of 3.84. An end of it that the
    profile does not reach has an arrow.

    Parameters
    ----------
    profile
        Rows of one fit and one parameter of the table of ``joint_profiles``.
    ax
        Axes to plot into.

    Returns
    -------
    ax
        The same axes.

    Notes
    -----
    The 95 % interval is that of a deviance below ``tcdyn.partition.profile.DEVIANCE_95``.
    """
    fit = str(profile["fit"].iloc[0])
    parameter = str(profile["parameter"].iloc[0])
    colour = DISK_COLOUR.get(fit, TRUTH)
    estimate = profile["estimate"].iloc[0]
    u = profile["u"].iloc[0]
    x = np.linspace(profile["value"].min(), profile["value"].max(), 200)
    style: dict[str, Any] = {"color": colour, "markersize": 4, "linewidth": 1.4}
    label = "profile: all else refitted"
    ax.plot(profile["value"], profile["deviance"], ".-", label=label, **style)
    style = {"color": GREY, "linewidth": 1.2, "label": "standard uncertainty's parabola"}
    ax.plot(x, ((x - estimate) / u) ** 2, "--", **style)
    ax.axhline(DEVIANCE_95, color=TRUTH, linestyle=":", linewidth=0.9, label="3.84: 95 %")
    (interval,) = intervals(profile)
    low = interval.profile_low if interval.low95 is None else interval.low95
    high = interval.profile_high if interval.high95 is None else interval.high95
    ends = [DEVIANCE_95, DEVIANCE_95]
    ax.plot(
        [low, high],
        ends,
        color=colour,
        label="interval of the profile",
        linewidth=3,
        solid_capstyle="butt",
        alpha=0.6,
    )
    for end, marker, limit in ((low, "<", interval.low95), (high, ">", interval.high95)):
        if limit is None:
            ax.plot(end, DEVIANCE_95, marker, color=colour, markersize=8)
    ax.set_ylim(0, MAX_DEVIANCE)
    ax.locator_params(axis="x", nbins=4)
    return style_axes(ax, COLUMN_HEADINGS[parameter], "", title=TITLES[fit])


def draw_likelihood_profiles(table: pd.DataFrame, axes: Sequence[Axes]) -> Sequence[Axes]:
    """Plot all likelihood profiles of a test, with a legend in the corner.

    Parameters
    ----------
    table
        Table of ``tcdyn.partition.profile.joint_profiles``.
    axes
        A row of four axes for each fit of the table, in reading order.

    Returns
    -------
    axes
        The same axes.

    Notes
    -----
    ``PANELS`` names the parameters of each row; axes that are left over stay empty.
    """
    for row, fit in enumerate(fit for fit in PANELS if (table["fit"] == fit).any()):
        axes_of_fit = axes[4 * row : 4 * row + 4]
        for parameter, ax in zip(PANELS[fit], axes_of_fit):
            draw_profile(table[(table["fit"] == fit) & (table["parameter"] == parameter)], ax)
        for ax in axes_of_fit[len(PANELS[fit]) :]:
            ax.set_axis_off()
            ax.texts[0].remove()  # letter of a panel that has no axes
        axes_of_fit[0].set_ylabel("deviance [1]")
    handles, labels = axes[0].get_legend_handles_labels()
    axes[3].legend(handles, labels, frameon=False, fontsize=8, loc="center left")
    return axes


def draw_window_study(table: pd.DataFrame, ax: Axes | None = None) -> Axes:
    """Plot beta by the cooling fit over the length of its window, with 95 % bars.

    Markers are open where the window is shorter than the lag.

    Parameters
    ----------
    table
        Table of ``cooling_by_window``.
    ax
        Axes to plot into; None: those of a new figure.

    Returns
    -------
    ax
        The same axes.
    """
    ax = axes_of(ax)
    for k, disk in enumerate(DISKS):
        rows = table[(table["disk"] == disk) & table["beta"].notna()]
        window_s = rows["window_s"] * (1.0 + 0.03 * k)  # the bars of the disks stay apart
        values = rows["beta"]
        half_width = Z95 * rows["u_beta"]
        colour = DISK_COLOUR[disk]
        ax.errorbar(
            window_s, values, yerr=half_width, fmt="none", ecolor=colour, capsize=2, linewidth=0.8
        )
        within_lag = rows["within_lag"].to_numpy(dtype=bool)
        for selected, fill, remark in (
            (within_lag, "white", ", window shorter than the lag"),
            (~within_lag, colour, ""),
        ):
            if selected.any():
                ax.plot(
                    window_s[selected],
                    values[selected],
                    DISK_MARKER[disk],
                    color=colour,
                    markerfacecolor=fill,
                    label=f"{disk} disk{remark}",
                )
    log_axis(ax, "x")
    ticks = sorted(set(table["window_s"]))
    ax.set_xticks(ticks, [f"{t:g}" for t in ticks])
    ax.minorticks_off()
    return style_axes(ax, "window after the unloading [s]", "heat partition β [1]", legend=True)


def draw_inverse_check(table: pd.DataFrame, ax: Axes | None = None) -> Axes:
    """Plot the cooling fit minus the joint fit for beta and h of each disk.

    The difference between compensated and commuted form is in units of its standard uncertainty;
    the band is two of them.

    Parameters
    ----------
    table
        Table of ``reference_table``: columns disk, quantity, z.
    ax
        Axes to plot into; None: those of a new figure.

    Returns
    -------
    ax
        The same axes.
    """
    ax = axes_of(ax)
    symbols = table["quantity"].map(lambda quantity: "β" if quantity == "beta" else "h")
    names = table["disk"] + " " + symbols
    ax.axvspan(-2, 2, color=PALE, zorder=0)
    y = range(len(names) - 1, -1, -1)
    for row, disk, z in zip(y, table["disk"], table["z"]):
        ax.plot(z, row, DISK_MARKER[disk], color=DISK_COLOUR[disk])
    ax.axvline(0, color=TRUTH, linewidth=0.8)
    ax.set_yticks(y, names)
    limit = max(3.0, 1.2 * float(table["z"].abs().max()))
    ax.set_xlim(-limit, limit)
    ax.set_ylim(-0.6, len(names) - 0.4)
    x = "compensated minus commuted,\nin standard uncertainties of the difference [1]"
    return style_axes(ax, x, "")


def draw_model_forms(alternatives: ModelForms, ax: Axes) -> Axes:
    """Plot beta of both disks for every model-form alternative, the most probable on top.

    Bars are 95 % intervals; a probable alternative is black, an improbable one grey. The band is
    the 95 % range over all of them.

    Parameters
    ----------
    alternatives
        Fits of all model-form alternatives with their probabilities.
    ax
        Axes to plot into.

    Returns
    -------
    ax
        The same axes.
    """
    fits = alternatives.forms
    low = alternatives.low95
    high = alternatives.high95
    ax.axvspan(low, high, color=PALE, zorder=0, label="95 % over all of them")
    y = range(len(fits) - 1, -1, -1)
    style: dict[str, Any] = {"fmt": "D", "capsize": 2, "markersize": 4}
    names = []
    for row, fit, probability in zip(y, fits, alternatives.probability):
        tone = str(round(0.65 * (1 - probability**0.25), 3))
        ax.errorbar(
            fit.beta.value, row, xerr=np.transpose([fit.beta.half_widths95]), color=tone, **style
        )
        names.append(f"{model_form_text(fit.name)} ({probability_text(probability)})")
    ax.axvline(alternatives.assumed.beta.value, color=TRUTH, linewidth=0.8)
    ax.set_yticks(list(y), names, fontsize=8)
    ax.set_ylim(-0.7, len(fits) - 0.3)
    x = "heat partition β by the joint fit of both disks [1]"
    return style_axes(ax, x, "", loc="lower left", bbox_to_anchor=(0, 1))


def draw_junctions(tests: Mapping[str, DepthTest], ax: Axes | None = None) -> Axes:
    """Plot the depth errors of the junctions that one test estimates, with 95 % bars.

    The grey band is the 95 % interval of the nominal depths of rig.toml.

    Parameters
    ----------
    tests
        Depth test of each disk.
    ax
        Axes to plot into; None: those of a new figure.

    Returns
    -------
    ax
        The same axes.
    """
    ax = axes_of(ax)
    nominal_u_mm = max(test.nominal_u_m for test in tests.values()) * 1e3
    half_width = Z95 * nominal_u_mm
    ax.axhspan(-half_width, half_width, color=PALE, zorder=0, label="nominal, 95 %")
    deeper_mm = {
        disk: {channel: deeper_m.scaled(1e3) for channel, deeper_m in test.deeper_m.items()}
        for disk, test in tests.items()
    }
    excluded = [channel for test in tests.values() for channel in test.excluded]
    draw_depth_errors(deeper_mm, ax, "{} disk, by this test alone, 95 %", excluded)
    return style_axes(
        ax,
        "junction",
        "deeper than nominal [mm]",
        ncols=3,
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
    )


def draw_depth_errors(
    deeper_mm: Mapping[str, Mapping[str, Estimate]],
    ax: Axes,
    label: str,
    excluded: Iterable[str] = (),
) -> None:
    """Plot how much deeper than in rig.toml the junctions of each disk lie, with 95 % bars.

    Parameters
    ----------
    deeper_mm
        Estimates by disk and channel [mm].
    ax
        Axes to plot into.
    label
        Legend entry, with ``{}`` for the disk.
    excluded
        Channels without an estimate that still get a place on the axis.
    """
    channels = {*excluded}
    for estimates in deeper_mm.values():
        channels.update(estimates)
    names = sorted(channels)
    for k, (disk, estimates) in enumerate(deeper_mm.items()):
        ax.errorbar(
            [names.index(channel) + 0.24 * (k - 0.5) for channel in estimates],
            [estimate.value for estimate in estimates.values()],
            yerr=np.transpose([estimate.half_widths95 for estimate in estimates.values()]),
            fmt=DISK_MARKER[disk],
            color=DISK_COLOUR[disk],
            capsize=2,
            linewidth=0.9,
            label=label.format(disk),
        )
    ax.set_xticks(range(len(names)), names)
    ax.axhline(0, color=TRUTH, linewidth=0.8)
