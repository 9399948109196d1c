"""Figures of plunge tests (figure 5.14 of the thesis), lags and planned tests.

Used by the certificate (:mod:`tcdyn.report.certificate`), by :func:`tcdyn.plots.pick.draw` and by
the gallery of the manual. Test: ``tests/immersion/test_plunge_pictures.py``.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from immersion.hole import HoleComparison
from immersion.plunge_result import PlungeFit
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
    ax.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
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
    z = fit.standardised_residuals(run)[after_entry]
    t = blocks.time_s[after_entry]
    ax.plot(
        np.repeat(t, z.shape[1]), z.ravel(), ".", label="each channel", color=GREY, markersize=2
    )
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
    return _figure_with_panels(fit, draw_plunge, 3.2)


def residual_figure(fit: PlungeFit) -> Figure:
    """Return the standardised residuals of every plunge, two in a row."""
    fig = _figure_with_panels(fit, draw_plunge_residuals, 2.6)
    fig.axes[0].legend(fontsize="small", frameon=False, loc="lower right", ncols=2)
    return fig


def _figure_with_panels(
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
