"""Pictures of a plunge fit: readings with the modelled ones, and what is left."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tcdyn.identify.plunge_result import PlungeFit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def draw_plunge(fit: PlungeFit, run: int, ax: Axes) -> Axes:
    """Block means of every channel (dots) and the fitted model with its chain (lines), time after the entry."""
    blocks = fit.optimum.problem.models[run].blocks
    for j, channel in enumerate(fit.channels):
        dots = ax.plot(blocks.time_s, blocks.readings_degC[:, j], ".", markersize=3, label=channel)[0]
        ax.plot(blocks.time_s, fit.optimum.predictions_degC[run][:, j], color=dots.get_color(), linewidth=0.9)
    ax.set_xlabel("time after the entry [s]")
    ax.set_ylabel("temperature [degC]")
    ax.set_title(fit.runs[run].name)
    ax.legend(ncol=3, fontsize="small")
    return ax


def draw_plunge_residuals(fit: PlungeFit, run: int, ax: Axes) -> Axes:
    """Readings minus model [K] of every channel, time after the entry."""
    blocks = fit.optimum.problem.models[run].blocks
    rest = blocks.readings_degC - fit.optimum.predictions_degC[run]
    for j, channel in enumerate(fit.channels):
        ax.plot(blocks.time_s, rest[:, j], linewidth=0.8, label=channel)
    ax.axhline(0.0, color="0.3", linewidth=0.8)
    ax.set_xlabel("time after the entry [s]")
    ax.set_ylabel("reading minus model [K]")
    return ax


def plunge_figure(fit: PlungeFit) -> Figure:
    """Every plunge of the fit, one column each: traces above, residuals below."""
    from matplotlib.figure import Figure

    count = len(fit.runs)
    figure = Figure(figsize=(4.5 * max(count, 2), 5.5), layout="constrained")
    axes = figure.subplots(2, count, squeeze=False, height_ratios=[2, 1])
    for run in range(count):
        draw_plunge(fit, run, axes[0, run])
        draw_plunge_residuals(fit, run, axes[1, run])
    return figure
