"""Pictures of a plunge fit: the seconds in which the lag shows, and what the model leaves of the readings."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tcdyn.plots.style import CHANNEL_STYLE, GREY, SLOW, TRUTH, figure, finish
from tcdyn.plunge.fit import PlungeFit
from tcdyn.plunge.posterior import block_sd

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


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
        ax.plot(blocks.time_s[shown], blocks.readings_degC[shown, j], ".", markersize=4, color=tone, alpha=0.6)
        ax.plot(
            blocks.time_s[shown], fit.optimum.predictions_degC[run][shown, j], color=TRUTH, linewidth=1.0,
            ls=CHANNEL_STYLE.get(channel, "-"), label=f"{channel}, {1e3 * depth[j]:g} mm deep",
        )  # fmt: skip
    ax.axvline(0.0, color=TRUTH, lw=0.7, ls=":")
    ax.set_xlabel("time after the entry [s]")
    ax.set_ylabel("temperature [°C]")
    ax.set_title(fit.runs[run].name, fontsize="medium")
    ax.legend(fontsize="small", frameon=False, loc="upper left")
    return finish(ax)


def standardised(fit: PlungeFit, run: int) -> NDArray[np.float64]:
    """What the fit leaves of each block (B, C), over its expected standard deviation; nan where a block is empty."""
    problem = fit.optimum.problem
    blocks = problem.models[run].blocks
    rest = blocks.readings_degC - fit.optimum.predictions_degC[run]
    return np.asarray(np.where(blocks.count > 0, rest / block_sd(problem.noise[run].sd_K, blocks.count), np.nan))


def draw_plunge_residuals(fit: PlungeFit, run: int, ax: Axes) -> Axes:
    """Readings minus model over their expected noise, all channels (dots) and their mean (line), log of time."""
    blocks = fit.optimum.problem.models[run].blocks
    after = blocks.time_s > 0.02
    z = standardised(fit, run)[after]
    t = blocks.time_s[after]
    ax.plot(np.repeat(t, z.shape[1]), z.ravel(), ".", color=GREY, markersize=2, label="each channel")
    ax.plot(t, np.nanmean(z, axis=1), color=SLOW, linewidth=1.0, label="mean of the channels")
    for level in (-1.96, 1.96):
        ax.axhline(level, color=TRUTH, linewidth=0.8, ls="--")
    ax.set_xscale("log")
    ax.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    ax.set_ylim(-5, 5)
    ax.set_xlabel("time after the entry [s]")
    ax.set_ylabel("left over, in noise sd [1]")
    inside = 100 * float(np.mean(np.abs(z[np.isfinite(z)]) < 1.96))
    ax.set_title(f"{fit.runs[run].name}: {inside:.0f} % within the dashed lines", fontsize="medium")
    return finish(ax)


def plunge_figure(fit: PlungeFit) -> Figure:
    """The first seconds of every plunge of the fit, two in a row."""
    return _panels(fit, draw_plunge, 3.2)


def residual_figure(fit: PlungeFit) -> Figure:
    """What the fit leaves of every plunge, two in a row."""
    picture = _panels(fit, draw_plunge_residuals, 2.6)
    picture.axes[0].legend(fontsize="small", frameon=False, loc="lower right", ncols=2)
    return picture


def _panels(fit: PlungeFit, draw: Callable[[PlungeFit, int, Axes], Axes], height_in: float) -> Figure:
    count = len(fit.runs)
    rows = (count + 1) // 2
    picture, axes = figure(rows, min(count, 2), height_in=height_in * rows)
    for ax in axes[count:]:
        ax.remove()
    for run, ax in enumerate(axes[:count]):
        draw(fit, run, ax)
    return picture
