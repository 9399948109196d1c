"""Pictures of plunges (after the thesis's figures 5.14 and 5.24 to 5.27), of the lags found, and of planned tests."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from immersion.hole import HoleComparison
from immersion.plunge_data import PlungeRun, block_sd
from immersion.plunge_result import PlungeFit
from tcdyn.core.estimate import Z95
from tcdyn.design.compare import COMMON, DIFFERENCES, Design
from tcdyn.plots.style import CHANNEL_STYLE, FAST, GREY, SLOW, TRUTH, dressed, pictured, thinned

HOLES_S = 10.0  # after the entry, in which holes differ
_LINES = tuple(CHANNEL_STYLE.values())


def draw_holes(result: HoleComparison, ax: Axes) -> Axes:
    """Figure 5.14: all thermocouples of the two-part disk (dots) with the fitted lags (lines), first seconds."""
    for k, name in enumerate(result.names):
        colour = SLOW if name.startswith("ideal") else str(0.65 * k / len(result.names))
        ax.plot(result.block_time_s, result.readings_degC[:, k], ".", color=colour, markersize=2)
        ax.plot(
            result.block_time_s,
            result.fitted_degC[:, k],
            color=colour,
            ls=_LINES[k % 6],
            lw=1.1,
            label=name,
        )
    end = min(HOLES_S, float(result.block_time_s[-1]))
    near = result.block_time_s <= end
    ax.set_xlim(-1, end)
    ax.set_ylim(
        np.nanmin(result.readings_degC[near]) - 1, np.nanmax(result.readings_degC[near]) + 1
    )
    return dressed(ax, "time after the entry [s]", "temperature [°C]", legend=True)


def draw_record(run: PlungeRun, ax: Axes, until_s: float | None = None) -> Axes:
    """Figures 5.24 (whole record) and 5.25 (``until_s`` after entry): every channel, the bath, the instant of entry."""
    t = run.time_s - run.entry.time_s
    shown = t <= (t[-1] if until_s is None else until_s)
    at = np.flatnonzero(shown)[thinned(int(shown.sum()))]
    for j, c in enumerate(run.channels):
        ax.plot(t[at], run.readings_degC[at, j], ls=CHANNEL_STYLE.get(c, "-"), lw=0.9, label=c)
    ax.plot(t[at], run.fluid_degC[at], color=GREY, lw=0.8, label="bath")
    ax.axvline(0.0, color=TRUTH, lw=0.8, ls=":")
    return dressed(ax, "time after the entry [s]", "temperature [°C]", ncol=4)


def draw_entry(
    run: PlungeRun,
    models: Mapping[str, pd.DataFrame],
    ax: Axes,
    channel: str = "a",
    until_s: float = 15.0,
) -> Axes:
    """Figures 5.26 and 5.27: one channel's reading, modelled junctions, and both witnesses of the entry.

    ``models`` by name: ``published_degC(run, setup)``, ``{"fitted": fit.junction_degC(0)}``.
    """
    t = run.time_s - run.entry.time_s
    j = run.channels.index(channel)
    shown = (t > -3) & (t < until_s)
    ax.plot(t[shown], run.readings_degC[shown, j], color=GREY, lw=0.7, label=f"measured, {channel}")
    for k, (name, table) in enumerate(models.items()):
        column = table[channel][table.index < until_s]
        ax.plot(
            column.index,
            column,
            color=(FAST, SLOW, TRUTH, FAST)[k % 4],
            ls=_LINES[k % 6],
            label=name,
        )
    for label, instant, line in (
        ("switch", run.entry.switch_s, "--"),
        ("free probe", run.entry.probe_s, ":"),
    ):
        if instant is not None:
            ax.axvline(instant - run.entry.time_s, color=TRUTH, lw=0.8, ls=line, label=label)
    ax.axvspan(-run.entry.u_s, run.entry.u_s, color=GREY, alpha=0.25, lw=0)
    return dressed(ax, "time after the entry [s]", "temperature [°C]", legend=True)


def draw_heat_transfer(fit: PlungeFit, run: int, ax: Axes) -> Axes:
    """Fitted h in time, entry burst and all, against the correlation as published at the same temperatures."""
    model = fit.optimum.problem.models[run]
    surface = fit.optimum.surfaces[run]
    plain = model.bath.h_W_m2K(surface.temperature_degC, model.bath_degC)
    late = model.grid_s > 0.01
    ax.semilogx(model.grid_s[late], surface.h_W_m2K[late], color=FAST, label="fitted")
    ax.semilogx(model.grid_s[late], plain[late], color=SLOW, ls="--", label=fit.correlation)
    return dressed(ax, "time after the entry [s]", "h [W/m²K]", legend=True)


def draw_common_lag(fit: PlungeFit, ax: Axes) -> Axes:
    """Marginal posterior of the common lag, the points of its profile likelihood, and its 95 % interval."""
    scan = fit.scan
    own = fit.common_lag_s.value - scan.mean_s
    ax.plot(scan.grid_s + own, scan.density / scan.density.max(), color=FAST, label="posterior")
    ax.plot(
        scan.lag_s + own,
        np.exp(-0.5 * (scan.cost - scan.cost.min())),
        "o",
        color=SLOW,
        ms=4,
        label="profile",
    )
    ax.axvspan(
        fit.common_lag_s.low95, fit.common_lag_s.high95, color=GREY, alpha=0.25, lw=0, label="95 %"
    )
    for k, value in enumerate(fit.model_form.common_lag_s.values()):
        ax.axvline(
            value, lw=0.7, ls=":", color=TRUTH, label=None if k else "with other correlations"
        )
    return dressed(ax, "common lag [s]", "relative likelihood [1]", legend=True)


def draw_differential_lags(fit: PlungeFit, ax: Axes) -> Axes:
    """Each channel's lag against the disk's mean, with 95 % intervals."""
    x = np.arange(len(fit.channels))
    values = [fit.differential_lag_s[c] for c in fit.channels]
    ax.errorbar(
        x, [v.value for v in values], [Z95 * v.u for v in values], fmt="o", color=FAST, capsize=3
    )
    ax.axhline(0.0, color=GREY, lw=0.8)
    ax.set_xticks(x, fit.channels)
    return dressed(ax, "channel", "lag minus common lag [s]")


def draw_design(design: Design, ax: Axes) -> Axes:
    """What each planned test would tell: standard uncertainty of the common lag and of differences, logarithmic."""
    table = design.table()
    y = np.arange(len(table))[::-1]
    columns = ("u_common_s", "u_common_10_s", "u_common_90_s", "u_differential_s")
    common, low, high, rest = (table[name].to_numpy(dtype=float) for name in columns)
    spread = np.abs(np.array([common - np.minimum(low, common), np.maximum(high, common) - common]))
    ax.errorbar(common, y + 0.12, xerr=spread, fmt="o", color=FAST, capsize=3, label="common lag")
    ax.plot(rest, y - 0.12, "s", color=SLOW, label="differences between channels")
    ax.set_xscale("log")
    for share, line, what in (
        (COMMON[0], "--", "common lag"),
        (DIFFERENCES[0], ":", "differences"),
    ):
        text = f"{100 * share:.0f} % of the lag: {what} told well"
        ax.axvline(share * design.lag_s, color=GREY, lw=1.0, ls=line, label=text)
    ticks = [
        t
        for t in np.outer(10.0 ** np.arange(-3, 1), (1, 2, 5)).flat
        if min(rest) / 2 < t < 2 * max(high)
    ]
    ax.set_xticks(ticks, [f"{t:g}" for t in ticks])
    ax.minorticks_off()
    ax.set_yticks(y, table["test"].str.replace("degC", "°C"), fontsize="small")
    return dressed(ax, "expected standard uncertainty [s]", "", legend=True)


def draw_plunge(fit: PlungeFit, run: int, ax: Axes, until_s: float = 15.0) -> Axes:
    """Block means (dots) and the fitted model with its chain (lines) of the first ``until_s`` seconds after the entry.

    Only the channels nearest to the surface and farthest from it are drawn: the others lie between them.
    """
    blocks = fit.optimum.problem.models[run].blocks
    shown = (blocks.time_s > -2.0) & (blocks.time_s < until_s)
    depth = [fit.setup.junctions[c].depth_m for c in fit.channels]
    ends = (int(np.argmin(depth)), int(np.argmax(depth))) if len(depth) > 1 else (0,)
    for j, tone in zip(ends, (SLOW, GREY)):
        channel = fit.channels[j]
        ax.plot(
            blocks.time_s[shown],
            blocks.readings_degC[shown, j],
            ".",
            markersize=4,
            color=tone,
            alpha=0.6,
        )
        ax.plot(
            blocks.time_s[shown],
            fit.optimum.predictions_degC[run][shown, j],
            color=TRUTH,
            linewidth=1.0,
            ls=CHANNEL_STYLE.get(channel, "-"),
            label=f"{channel}, {1e3 * depth[j]:g} mm deep",
        )
    ax.axvline(0.0, color=TRUTH, lw=0.7, ls=":")
    return dressed(
        ax,
        "time after the entry [s]",
        "temperature [°C]",
        head=fit.runs[run].name,
        loc="upper left",
    )


def standardised(fit: PlungeFit, run: int) -> NDArray[np.float64]:
    """What the fit leaves of each block (B, C), over its expected standard deviation; nan where a block is empty."""
    problem = fit.optimum.problem
    blocks = problem.models[run].blocks
    rest = blocks.readings_degC - fit.optimum.predictions_degC[run]
    return np.asarray(
        np.where(blocks.count > 0, rest / block_sd(problem.noise[run].sd_K, blocks.count), np.nan)
    )


def draw_plunge_residuals(fit: PlungeFit, run: int, ax: Axes) -> Axes:
    """Readings minus model over their expected noise, all channels (dots) and their mean (line), log of time."""
    blocks = fit.optimum.problem.models[run].blocks
    after = blocks.time_s > 0.02
    z = standardised(fit, run)[after]
    t = blocks.time_s[after]
    ax.plot(
        np.repeat(t, z.shape[1]), z.ravel(), ".", color=GREY, markersize=2, label="each channel"
    )
    ax.plot(t, np.nanmean(z, axis=1), color=SLOW, linewidth=1.0, label="mean of the channels")
    for level in (-1.96, 1.96):
        ax.axhline(level, color=TRUTH, linewidth=0.8, ls="--")
    ax.set_xscale("log")
    ax.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    ax.set_ylim(-5, 5)
    inside = 100 * float(np.mean(np.abs(z[np.isfinite(z)]) < 1.96))
    head = f"{fit.runs[run].name}: {inside:.0f} % within the dashed lines"
    return dressed(ax, "time after the entry [s]", "left over, in noise sd [1]", head=head)


def plunge_figure(fit: PlungeFit) -> Figure:
    """The first seconds of every plunge of the fit, two in a row."""
    return _panels(fit, draw_plunge, 3.2)


def residual_figure(fit: PlungeFit) -> Figure:
    """What the fit leaves of every plunge, two in a row."""
    picture = _panels(fit, draw_plunge_residuals, 2.6)
    picture.axes[0].legend(fontsize="small", frameon=False, loc="lower right", ncols=2)
    return picture


def _panels(
    fit: PlungeFit, draw: Callable[[PlungeFit, int, Axes], Axes], height_in: float
) -> Figure:
    rows = (len(fit.runs) + 1) // 2
    return pictured(
        *(partial(draw, fit, run) for run in range(len(fit.runs))),
        rows=rows,
        height_in=height_in * rows,
    )
