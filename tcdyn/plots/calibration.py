"""Figures of the calibration input: logs, oven errors and residuals, transducers, chains, lags.

Used by the certificate (:mod:`tcdyn.report.certificate`), by :func:`tcdyn.plots.pick.draw` and by
the gallery of the manual. Tests: ``tests/report/test_pictures.py`` and
``tests/calibration/test_transducers.py``.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike

from calibration.static_lines import OvenFit
from calibration.transducers import BearingFriction
from immersion.plunge_result import LagShare
from tcdyn.chain import Chain
from tcdyn.core import Array
from tcdyn.plots.style import (
    DARK,
    GREY,
    PALE,
    SERIES_MARKERS,
    SLOW,
    TRUTH,
    axes_of,
    channel_style,
    figure,
    screen_rows,
    style_axes,
)
from tcdyn.rig.log import COMPENSATED, Log
from tcdyn.rig.record import ChainRecord
from tcdyn.rig.static_line import static_u
from tcdyn.sensors.touch import TouchLog

MAX_BINS = 25  # bins of a histogram, at most; their width is 1, 2 or 5 times a power of ten
CHANNEL_SHIFT = 0.006  # sideways shift between channels, as a share of the temperature range


def draw_error_histogram(errors_K: ArrayLike, ax: Axes | None = None) -> Axes:
    """Plot the histogram of the errors (thermocouple minus PRT), figure 2.16.

    95 % of the errors lie between the dashed lines.

    Parameters
    ----------
    errors_K
        Errors of any shape [K], NaN left out.
    ax
        Axes to plot into; None: those of a new figure.

    Returns
    -------
    ax
        The same axes.
    """
    ax = axes_of(ax)
    errors = np.asarray(errors_K, dtype=float)
    errors = errors[np.isfinite(errors)]
    edges = MaxNLocator(MAX_BINS, steps=[1, 2, 5, 10]).tick_values(errors.min(), errors.max())
    ax.hist(errors, edges, color=SLOW, edgecolor="white")
    ax.axvline(0.0, color=TRUTH, linewidth=0.8)
    for limit in np.quantile(errors, [0.025, 0.975]):
        ax.axvline(limit, color=TRUTH, linewidth=0.9, linestyle="--")
    ax.yaxis.set_major_locator(MaxNLocator(integer=True))
    width_K = edges[1] - edges[0]
    return style_axes(ax, "thermocouple minus PRT [K]", f"errors per {width_K:.2g} K")


def draw_residuals(oven: OvenFit, ax: Axes | None = None) -> Axes:
    """Plot the residuals of every channel against the PRT, with the 95 % band of one line.

    The channels are shifted sideways so that their points do not cover each other.

    Parameters
    ----------
    oven
        Static lines of a disk.
    ax
        Axes to plot into; None: those of a new figure.

    Returns
    -------
    ax
        The same axes.

    Notes
    -----
    ``CHANNEL_SHIFT`` is for the eye only. The band is that of the first line.
    """
    ax = axes_of(ax)
    table = oven.residuals
    prt = table["prt_degC"].to_numpy(dtype=float)
    shift = CHANNEL_SHIFT * (prt.max() - prt.min())
    middle = (len(oven.lines) - 1) / 2
    for k, channel in enumerate(oven.lines):
        ax.plot(
            prt + shift * (k - middle),
            table[f"{channel}_degC"],
            SERIES_MARKERS[k % 6],
            markersize=4,
            color=str(0.6 * k / max(len(oven.lines) - 1, 1)),
            mfc="none",
            label=channel,
        )
    line = next(iter(oven.lines.values()))
    t = np.linspace(*line.range_degC, 100)
    band = 1.96 * static_u(line, t)
    ax.fill_between(
        t, -band, band, color=PALE, zorder=0, label="95 % of the line, not of the points"
    )
    ax.axhline(0.0, color=TRUTH, linewidth=0.8)
    return style_axes(
        ax,
        "PRT [°C]",
        "PRT minus line [K]",
        ncols=7,
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        columnspacing=1.0,
    )


def draw_bearing(bearing: BearingFriction, ax: Axes | None = None) -> Axes:
    """Plot bearing friction of both shafts against load, one line for each speed (figure 2.25).

    Parameters
    ----------
    bearing
        Lines of the pure-rolling test.
    ax
        Axes to plot into; None: those of a new figure.

    Returns
    -------
    ax
        The same axes.
    """
    ax = axes_of(ax)
    for speed, line in zip(bearing.speeds_rpm, bearing.lines):
        dots = ax.plot(line.x, line.y, "o", markersize=4, label=f"{speed:.0f} rpm")[0]
        ends = np.array([line.x.min(), line.x.max()])
        ax.plot(ends, line.slope * ends + line.intercept, color=dots.get_color(), linewidth=1)
    y = "bearing friction, both shafts [N]"
    return style_axes(ax, "load [N]", y, legend_title="slow shaft")


def draw_lags(chain: ChainRecord, ax: Axes | None = None) -> Axes:
    """Plot the lag of each channel with two 95 % intervals.

    The thin bar is the interval of the lag, the thick bar that of its difference from the common
    lag.

    Parameters
    ----------
    chain
        Chains of a record.
    ax
        Axes to plot into; None: those of a new figure.

    Returns
    -------
    ax
        The same axes.
    """
    ax = axes_of(ax)
    names = sorted(chain.channels)
    common = chain.common_lag_s
    ax.axhspan(common.low95, common.high95, color=PALE, zorder=0, label="common lag, 95 %")
    ax.axhline(common.value, color=TRUTH, linewidth=0.8)
    for i, name in enumerate(names):
        lag = chain.channels[name].lag_s
        difference = chain.differential_lag_s[name]
        thin = [lag.low95, lag.high95]
        thick = [common.value + difference.low95, common.value + difference.high95]
        ax.plot([i, i], thin, color=GREY, linewidth=1.2, label="lag, 95 %" if i == 0 else None)
        label = "its difference from the common lag, 95 %" if i == 0 else None
        ax.plot([i, i], thick, color=SLOW, linewidth=5, solid_capstyle="butt", label=label)
        ax.plot(i, lag.value, "o", color="white", markeredgecolor=TRUTH, markersize=5)
    ax.set_xticks(range(len(names)), names)
    ax.set_xlim(-0.6, len(names) - 0.4)
    return style_axes(
        ax, "channel", "lag [s]", ncols=3, loc="lower left", bbox_to_anchor=(0.0, 1.0)
    )


def draw_lag_budget(shares: Sequence[LagShare], ax: Axes) -> Axes:
    """Plot what each source adds to the uncertainty of the common lag and of the differences [s].

    The largest source is on top.

    Parameters
    ----------
    shares
        Rows of an uncertainty budget.
    ax
        Axes to plot into.

    Returns
    -------
    ax
        The same axes.
    """
    ordered = sorted(shares, key=lambda s: s.u_common_s)
    y = np.arange(len(ordered))
    common = [s.u_common_s for s in ordered]
    differential = [s.u_differential_s for s in ordered]
    ax.barh(y + 0.19, common, 0.36, color=SLOW, label="common lag")
    ax.barh(
        y - 0.19,
        differential,
        0.36,
        label="differences of channels",
        color="white",
        edgecolor=TRUTH,
        hatch="////",
    )
    largest = max([*common, *differential, 1e-6])
    for values, offset in ((common, 0.19), (differential, -0.19)):
        for k, value in enumerate(values):
            x = value + 0.01 * largest
            ax.text(x, k + offset, f"{value:.3f}", va="center", fontsize=7)
    ax.set_yticks(y, [s.source for s in ordered])
    ax.set_xlim(0, 1.1 * largest)
    style_axes(ax, "standard uncertainty [s]", "", loc="lower right").grid(False, axis="y")
    return ax


def error_figure(oven: OvenFit) -> Figure:
    """Return the histograms of the errors of all channels, as logged and with the static lines.

    Parameters
    ----------
    oven
        Static lines of a disk.
    """
    fig, axes = figure(1, 2, height_in=3.0)
    errors_by_title = {
        "as logged": oven.raw_errors_K,
        "with the static lines": oven.calibrated_errors_K,
    }
    for ax, (title, errors) in zip(axes, errors_by_title.items()):
        largest = float(np.nanmax(np.abs(errors)))
        draw_error_histogram(errors, ax)
        ax.set_title(f"{title}: at most {largest:.2g} K", fontsize="medium")
    return fig


def draw_log(log: Log, ax: Axes | None = None) -> Axes:
    """Plot every thermocouple against time, or for an oven log its error against the PRT.

    Parameters
    ----------
    log
        A log of any kind.
    ax
        Axes to plot into; None: those of a new figure.

    Returns
    -------
    ax
        The same axes.
    """
    ax = axes_of(ax)
    is_oven = log.kind == "oven"
    x = log.frame["prt_degC" if is_oven else "time_s"].to_numpy(dtype=float)
    for k, name in enumerate(log.channels):
        y = log.frame[name].to_numpy(dtype=float)
        rows = screen_rows(y)
        colour, style = channel_style(k)
        if is_oven:
            y = y - x
            style = "o"
        label = name.removesuffix("_degC").replace("_", " ")
        ax.plot(x[rows], y[rows], style, color=colour, linewidth=0.9, markersize=3, label=label)
    if is_oven:
        return style_axes(ax, "PRT [°C]", "logged minus PRT [K]", ncols=2)
    source = "compensated" if log.metadata.get("tcdyn") == COMPENSATED else "logged"
    return style_axes(ax, "time [s]", f"{source} temperature [°C]", ncols=2)


def draw_chain(chain: Chain, ax: Axes | None = None) -> Axes:
    """Plot the unit step response of a chain and mark its first moment (the lag).

    Parameters
    ----------
    chain
        The chain of one channel.
    ax
        Axes to plot into; None: those of a new figure.

    Returns
    -------
    ax
        The same axes.

    Notes
    -----
    The response runs to six lags and starts a twentieth of that before the step; chosen by
    judgement.
    """
    ax = axes_of(ax)
    n_after = 600
    n_before = n_after // 20
    dt = 6 * max(chain.lag_s, 1e-3) / n_after
    step = np.ones(n_after + n_before)
    step[:n_before] = 0.0
    t = (np.arange(n_after + n_before) - n_before) * dt
    ax.plot(t, step, drawstyle="steps-post", color=GREY, linewidth=0.9, label="at the junction")
    ax.plot(t, chain.response(step, dt, hold="zoh"), label="in the log file")
    label = f"lag {chain.lag_s:.3g} s"
    ax.axvline(chain.lag_s, linestyle="--", linewidth=0.8, color=DARK, label=label)
    return style_axes(ax, "time after the step [s]", "share of the step [1]", loc="lower right")


def draw_touches(
    touch_log: TouchLog,
    time_s: Array,
    readings_degC: Array,
    columns: Sequence[str],
    ax: Axes | None = None,
) -> Axes:
    """Plot the rise of each column, with the column that responded to each touch (figure 6.18).

    Parameters
    ----------
    touch_log
        The touches.
    time_s, readings_degC
        Times (N,) [s] and readings (N, M) [degC].
    columns
        Names of the columns (M).
    ax
        Axes to plot into; None: those of a new figure.

    Returns
    -------
    ax
        The same axes.
    """
    ax = axes_of(ax)
    rise_K = readings_degC - np.nanmedian(readings_degC, axis=0)
    for k, column in enumerate(columns):
        colour, style = channel_style(k)
        rows = screen_rows(rise_K[:, k])
        ax.plot(time_s[rows], rise_K[rows, k], style, color=colour, linewidth=0.9, label=column)
    for number, touch in enumerate(touch_log.touches, 1):
        is_as_stated = touch.expected in ("", touch.column)
        text = f"{number}: {touch.column}"
        if not is_as_stated:
            text += f", not {touch.expected}"
        ax.axvline(touch.time_s, color=GREY, linewidth=0.7)
        ax.text(
            touch.time_s,
            1.0,
            text,
            rotation=90,
            ha="right",
            va="top",
            fontsize=7,
            fontweight="normal" if is_as_stated else "bold",
            transform=ax.get_xaxis_transform(),
        )
    return style_axes(
        ax,
        "time [s]",
        "reading minus its median [K]",
        ncols=3,
        loc="upper center",
        bbox_to_anchor=(0.5, -0.16),
    )
