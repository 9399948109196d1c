"""Figures of plunge tests (5.14 and 5.24 to 5.27 of the thesis), lags and planned tests.

Used by the certificate (:mod:`tcdyn.report.certificate`), by :func:`tcdyn.plots.pick.draw` and by
the gallery of the manual. Test: ``tests/immersion/test_plunge_pictures.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from immersion.hole import HoleComparison
from immersion.plunge_data import PlungeRun, block_sd
from immersion.plunge_result import PlungeFit
from tcdyn.core.estimate import Z95
from tcdyn.design.compare import COMMON_LAG_LIMITS, DIFFERENCE_LIMITS, Design
from tcdyn.plots.style import (
    CHANNEL_STYLE,
    FAST,
    GREY,
    SLOW,
    TRUTH,
    axes_of,
    log_axis,
    panel_figure,
    screen_rows,
    style_axes,
)

HOLES_END_S = 10.0  # end of the figure of holes: later their readings agree; chosen by judgement
FIRST_S = 0.02  # start of the residuals after the entry; chosen by judgement


# Label and line styles that several figures share.
X_ENTRY = "time after the entry [s]"
_LINE_STYLES = tuple(CHANNEL_STYLE.values())


def draw_holes(result: HoleComparison, ax: Axes | None = None) -> Axes:
    """Plot the thermocouples of the two-part disk (dots) and fitted lags (lines), figure 5.14.

    Parameters
    ----------
    result
        Comparison of holes.
    ax
        Axes to plot into; None: those of a new figure.

    Returns
    -------
    ax
        The same axes.
    """
    ax = axes_of(ax)
    t = result.block_time_s
    for k, name in enumerate(result.names):
        colour = SLOW if name.startswith("ideal") else str(0.65 * k / len(result.names))
        ax.plot(t, result.readings_degC[:, k], ".", color=colour, markersize=2)
        style = _LINE_STYLES[k % 6]
        ax.plot(t, result.fitted_degC[:, k], color=colour, ls=style, lw=1.1, label=name)
    end = min(HOLES_END_S, float(t[-1]))
    readings = result.readings_degC[t <= end]
    ax.set_xlim(-1, end)
    ax.set_ylim(np.nanmin(readings) - 1, np.nanmax(readings) + 1)
    return style_axes(ax, X_ENTRY, "temperature [°C]", legend=True)


def draw_record(run: PlungeRun, ax: Axes | None = None, until_s: float | None = None) -> Axes:
    """Plot every channel, the bath and the instant of entry of a plunge (figures 5.24 and 5.25).

    Parameters
    ----------
    run
        A plunge.
    ax
        Axes to plot into; None: those of a new figure.
    until_s
        End of the figure after the entry [s]; None: the full record.

    Returns
    -------
    ax
        The same axes.
    """
    ax = axes_of(ax)
    t = run.time_s - run.entry.time_s
    in_window = np.flatnonzero(t <= (t[-1] if until_s is None else until_s))
    for j, c in enumerate(run.channels):
        style = CHANNEL_STYLE.get(c, "-")
        rows = in_window[screen_rows(run.readings_degC[in_window, j])]
        ax.plot(t[rows], run.readings_degC[rows, j], ls=style, lw=0.9, label=c)
    rows = in_window[screen_rows(run.fluid_degC[in_window])]
    ax.plot(t[rows], run.fluid_degC[rows], color=GREY, lw=0.8, label="bath")
    ax.axvline(0.0, color=TRUTH, lw=0.8, ls=":")
    return style_axes(ax, X_ENTRY, "temperature [°C]", ncol=4)


def draw_entry(
    run: PlungeRun,
    models: Mapping[str, pd.DataFrame],
    ax: Axes | None = None,
    channel: str = "a",
    until_s: float = 15.0,
) -> Axes:
    """Plot the reading of one channel with modelled junctions (figures 5.26 and 5.27).

    The vertical lines are the entry by the switch and by the free probe, the band is the standard
    uncertainty of the entry.

    Parameters
    ----------
    run
        A plunge.
    models
        Junction temperatures by name of the model, such as ``published_degC(run, setup)`` or
        ``{"fitted": fit.junction_degC(0)}``.
    ax
        Axes to plot into; None: those of a new figure.
    channel
        Name of the channel.
    until_s
        End of the figure after the entry [s].

    Returns
    -------
    ax
        The same axes.
    """
    ax = axes_of(ax)
    t = run.time_s - run.entry.time_s
    readings = run.readings_degC[:, run.channels.index(channel)]
    in_window = (t > -3) & (t < until_s)
    label = f"measured, {channel}"
    ax.plot(t[in_window], readings[in_window], color=GREY, lw=0.7, label=label)
    colours = (FAST, SLOW, TRUTH, FAST)
    for k, (name, table) in enumerate(models.items()):
        model = table[channel][table.index < until_s]
        style: dict[str, Any] = {"color": colours[k % 4], "ls": _LINE_STYLES[k % 6]}
        ax.plot(model.index, model, label=name, **style)
    instants = (("switch", run.entry.switch_s, "--"), ("free probe", run.entry.probe_s, ":"))
    for name, instant, line in instants:
        if instant is not None:
            ax.axvline(instant - run.entry.time_s, color=TRUTH, lw=0.8, ls=line, label=name)
    ax.axvspan(-run.entry.u_s, run.entry.u_s, color=GREY, alpha=0.25, lw=0)
    return style_axes(ax, X_ENTRY, "temperature [°C]", legend=True)


def draw_heat_transfer(fit: PlungeFit, run: int, ax: Axes | None = None) -> Axes:
    """Plot the fitted h over time, and the published correlation at the same temperatures.

    Parameters
    ----------
    fit
        A plunge fit.
    run
        Index of the plunge.
    ax
        Axes to plot into; None: those of a new figure.

    Returns
    -------
    ax
        The same axes.

    Notes
    -----
    The first 0.01 s are left out because the time axis is logarithmic.
    """
    ax = axes_of(ax)
    model = fit.optimum.problem.models[run]
    surface = fit.optimum.surfaces[run]
    published = model.bath.h_W_m2K(surface.temperature_degC, model.bath_degC)
    after_entry = model.grid_s > 0.01
    t = model.grid_s[after_entry]
    ax.plot(t, surface.h_W_m2K[after_entry], color=FAST, label="fitted")
    ax.plot(t, published[after_entry], color=SLOW, ls="--", label=fit.correlation)
    log_axis(ax, "x")
    return style_axes(ax, X_ENTRY, "h [W/m²K]", legend=True)


def draw_common_lag(fit: PlungeFit, ax: Axes | None = None) -> Axes:
    """Plot the marginal posterior of the common lag, its profile and its 95 % interval.

    Parameters
    ----------
    fit
        A plunge fit.
    ax
        Axes to plot into; None: those of a new figure.

    Returns
    -------
    ax
        The same axes.
    """
    ax = axes_of(ax)
    scan = fit.scan
    lag = fit.common_lag_s
    shift = lag.value - scan.mean_s
    ax.plot(scan.grid_s + shift, scan.density / scan.density.max(), color=FAST, label="posterior")
    profile = np.exp(-0.5 * (scan.cost - scan.cost.min()))
    ax.plot(scan.lag_s + shift, profile, "o", color=SLOW, ms=4, label="profile")
    ax.axvspan(lag.low95, lag.high95, color=GREY, alpha=0.25, lw=0, label="95 %")
    for k, value in enumerate(fit.model_form.common_lag_s.values()):
        label = "with other correlations" if k == 0 else None
        ax.axvline(value, lw=0.7, ls=":", color=TRUTH, label=label)
    return style_axes(ax, "common lag [s]", "relative likelihood [1]", legend=True)


def draw_differential_lags(fit: PlungeFit, ax: Axes | None = None) -> Axes:
    """Plot the lag of each channel minus the mean of the disk, with 95 % intervals.

    Parameters
    ----------
    fit
        A plunge fit.
    ax
        Axes to plot into; None: those of a new figure.

    Returns
    -------
    ax
        The same axes.
    """
    ax = axes_of(ax)
    x = np.arange(len(fit.channels))
    lags = [fit.differential_lag_s[c] for c in fit.channels]
    values = [lag.value for lag in lags]
    half_widths = [Z95 * lag.u for lag in lags]
    ax.errorbar(x, values, half_widths, fmt="o", color=FAST, capsize=3)
    ax.axhline(0.0, color=GREY, lw=0.8)
    ax.set_xticks(x, fit.channels)
    return style_axes(ax, "channel", "lag minus common lag [s]")


def draw_design(design: Design, ax: Axes | None = None) -> Axes:
    """Plot the expected standard uncertainties of the lags for each planned test.

    Bars span the 10 % and 90 % quantiles of the draws; the vertical lines are the limits below
    which a test determines a lag well.

    Parameters
    ----------
    design
        Comparison of planned tests.
    ax
        Axes to plot into; None: those of a new figure.

    Returns
    -------
    ax
        The same axes.
    """
    ax = axes_of(ax)
    table = design.table()
    y = np.arange(len(table))[::-1]
    common = table["u_common_s"].to_numpy(dtype=float)
    low = table["u_common_10_s"].to_numpy(dtype=float)
    high = table["u_common_90_s"].to_numpy(dtype=float)
    differential = table["u_differential_s"].to_numpy(dtype=float)
    spread = np.array([common - np.minimum(low, common), np.maximum(high, common) - common])
    ax.errorbar(
        common, y + 0.12, xerr=np.abs(spread), fmt="o", color=FAST, capsize=3, label="common lag"
    )
    ax.plot(differential, y - 0.12, "s", color=SLOW, label="differences between channels")
    log_axis(ax, "x")
    for share, line, name in (
        (COMMON_LAG_LIMITS[0], "--", "common lag"),
        (DIFFERENCE_LIMITS[0], ":", "differences"),
    ):
        label = f"{100 * share:.0f} % of the lag: {name} determined well"
        ax.axvline(share * design.lag_s, color=GREY, lw=1.0, ls=line, label=label)
    lowest = min(differential) / 2
    highest = 2 * max(high)
    candidates = np.outer(10.0 ** np.arange(-3, 1), (1, 2, 5)).ravel()
    ticks = [t for t in candidates if lowest < t < highest]
    ax.set_xticks(ticks, [f"{t:g}" for t in ticks])
    ax.minorticks_off()
    ax.set_yticks(y, table["test"].str.replace("degC", "°C"), fontsize="small")
    return style_axes(ax, "expected standard uncertainty [s]", "", legend=True)


def draw_plunge(fit: PlungeFit, run: int, ax: Axes | None = None, until_s: float = 15.0) -> Axes:
    """Plot block means (dots) and the fitted model with its chain (lines) of one plunge.

    Only the channels nearest to the surface and farthest from it are plotted: the others lie
    between them.

    Parameters
    ----------
    fit
        A plunge fit.
    run
        Index of the plunge.
    ax
        Axes to plot into; None: those of a new figure.
    until_s
        End of the figure after the entry [s].

    Returns
    -------
    ax
        The same axes.
    """
    ax = axes_of(ax)
    blocks = fit.optimum.problem.models[run].blocks
    in_window = (blocks.time_s > -2.0) & (blocks.time_s < until_s)
    t = blocks.time_s[in_window]
    depth_m = [fit.setup.junctions[c].depth_m for c in fit.channels]
    plotted = [int(np.argmin(depth_m)), int(np.argmax(depth_m))]
    if len(depth_m) == 1:
        plotted = [0]
    for j, tone in zip(plotted, (SLOW, GREY)):
        readings = blocks.readings_degC[in_window, j]
        model = fit.optimum.predictions_degC[run][in_window, j]
        channel = fit.channels[j]
        style = CHANNEL_STYLE.get(channel, "-")
        label = f"{channel}, {1e3 * depth_m[j]:g} mm deep"
        ax.plot(t, readings, ".", markersize=4, color=tone, alpha=0.6)
        ax.plot(t, model, color=TRUTH, linewidth=1.0, ls=style, label=label)
    ax.axvline(0.0, color=TRUTH, lw=0.7, ls=":")
    title = fit.runs[run].name
    return style_axes(ax, X_ENTRY, "temperature [°C]", title=title, loc="upper left")


def standardised(fit: PlungeFit, run: int) -> NDArray[np.float64]:
    """Return the standardised residuals of the blocks of one plunge.

    Parameters
    ----------
    fit
        A plunge fit.
    run
        Index of the plunge.

    Returns
    -------
    z
        (B, C), residual over its standard deviation for white noise; NaN for an empty block.
    """
    problem = fit.optimum.problem
    blocks = problem.models[run].blocks
    residual = blocks.readings_degC - fit.optimum.predictions_degC[run]
    z = residual / block_sd(problem.noise[run].sd_K, blocks.count)
    return np.where(blocks.count > 0, z, np.nan)


def draw_plunge_residuals(fit: PlungeFit, run: int, ax: Axes | None = None) -> Axes:
    """Plot the standardised residuals of all channels and their mean over the logarithm of time.

    Parameters
    ----------
    fit
        A plunge fit.
    run
        Index of the plunge.
    ax
        Axes to plot into; None: those of a new figure.

    Returns
    -------
    ax
        The same axes.
    """
    ax = axes_of(ax)
    blocks = fit.optimum.problem.models[run].blocks
    after_entry = blocks.time_s > FIRST_S
    z = standardised(fit, run)[after_entry]
    t = blocks.time_s[after_entry]
    dots: dict[str, Any] = {"color": GREY, "markersize": 2}
    ax.plot(np.repeat(t, z.shape[1]), z.ravel(), ".", label="each channel", **dots)
    ax.plot(t, np.nanmean(z, axis=1), color=SLOW, linewidth=1.0, label="mean of the channels")
    for limit in (-1.96, 1.96):
        ax.axhline(limit, color=TRUTH, linewidth=0.8, ls="--")
    log_axis(ax, "x")
    ax.set_ylim(-5, 5)
    inside = 100 * float(np.mean(np.abs(z[np.isfinite(z)]) < 1.96))
    title = f"{fit.runs[run].name}: {inside:.0f} % within the dashed lines"
    return style_axes(ax, X_ENTRY, "residual, in noise sd [1]", title=title)


def plunge_figure(fit: PlungeFit) -> Figure:
    """Return the first seconds of every plunge of the fit, two in a row."""
    return _panels(fit, draw_plunge, 3.2)


def residual_figure(fit: PlungeFit) -> Figure:
    """Return the standardised residuals of every plunge, two in a row."""
    fig = _panels(fit, draw_plunge_residuals, 2.6)
    fig.axes[0].legend(fontsize="small", frameon=False, loc="lower right", ncols=2)
    return fig


def _panels(
    fit: PlungeFit, draw: Callable[[PlungeFit, int, Axes], Axes], height_in: float
) -> Figure:
    """Return a figure with a panel for each plunge, two in a row.

    Parameters
    ----------
    fit
        A plunge fit.
    draw
        Plots one plunge into axes.
    height_in
        Height of one row.
    """
    n_rows = (len(fit.runs) + 1) // 2
    panels = [partial(draw, fit, run) for run in range(len(fit.runs))]
    return panel_figure(*panels, rows=n_rows, height_in=height_in * n_rows)
