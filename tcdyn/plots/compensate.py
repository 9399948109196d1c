"""Pictures of compensation: the trace with its band, and what a compensator will do before it is used."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from tcdyn.plots.style import DARK, FAST, GREY, SLOW, dressed, line_with_band, thinned
from tcdyn.smoothing.inverse import BeforeUse
from tcdyn.smoothing.process_noise import Tradeoff
from tcdyn.smoothing.record import Compensated


def draw_compensated(
    result: Compensated,
    logged: ArrayLike | None,
    ax: Axes,
    channel: int = 0,
    window_s: tuple[float, float] | None = None,
) -> Axes:
    """Logged trace (None: without it) as points, compensated one with its 95 % band, events dashed, bad samples
    crossed."""
    low, high = window_s or (float(result.time_s[0]), float(result.time_s[-1]))
    inside = np.flatnonzero((result.time_s >= low) & (result.time_s <= high))
    shown = inside[thinned(len(inside))]
    t = result.time_s[shown]
    x = result.temperature[shown, channel]
    sd = result.sd[shown, channel]
    y = np.full(len(result.time_s), np.nan) if logged is None else np.asarray(logged, dtype=float)
    y = y[:, channel] if y.ndim == 2 else y
    if logged is not None:
        ax.plot(t, y[shown], ".", markersize=2, color=GREY, label="as logged")
    line_with_band(ax, t, x, sd, SLOW, "95 %", linewidth=1.3, label="compensated")
    bad = inside[(result.flags[inside, channel] > 0) & np.isfinite(y[inside])]
    if len(bad):
        ax.plot(result.time_s[bad], y[bad], "x", color=FAST, markersize=4, label="flagged")
    for event, _ in result.events_s:
        if low <= event <= high:
            ax.axvline(event, linestyle="--", linewidth=0.8, color=DARK)
    return dressed(ax, "time [s]", "temperature [°C]", loc="best")


def draw_before_use(report: BeforeUse, ax: Axes) -> Axes:
    """Step response of the chain alone and of chain times compensator, with the remaining shift and noise stated."""
    alone = f"chain alone, 10-90 % in {report.raw_rise_s:.2g} s"
    ax.plot(report.step_time_s, report.raw_step, "--", color=FAST, label=alone)
    ax.plot(
        report.step_time_s, report.step, color=SLOW, label=f"compensated, {report.rise_s:.2g} s"
    )
    ax.axhline(1.0, linewidth=0.6, color=GREY)
    ax.set_xlim(
        0.0, min(float(report.step_time_s[-1]), 8.0 * max(report.raw_rise_s, report.rise_s))
    )
    head = f"remaining shift {report.remaining_shift_s:.3g} s, noise {report.noise_gain:.3g} times the trace's"
    x = "time after a step at the junction [s]"
    y = "share of the step [1]"
    return dressed(ax, x, y, head=head, loc="lower right")


def draw_tradeoff(tradeoff: Tradeoff, ax: Axes, channel: int = 0) -> Axes:
    """The L-curve of a regularised deconvolution and the weight that was chosen on it."""
    misfit = tradeoff.misfit[:, channel]
    roughness = tradeoff.roughness[:, channel]
    ax.loglog(misfit, roughness, "o-", markersize=3)
    logs = np.log(tradeoff.intensity[:, channel])
    chosen = np.log(tradeoff.chosen[channel])
    ax.loglog(
        np.exp(np.interp(chosen, logs, np.log(misfit))),
        np.exp(np.interp(chosen, logs, np.log(roughness))),
        "s",
        label=f"chosen by {tradeoff.criterion}",
    )
    return dressed(ax, "mean square residual [K²]", "roughness [K²/s³]", legend=True)
