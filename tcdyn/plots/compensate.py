"""Figures of compensation: traces with bands, filter design report.

Used by the page of ``tcdyn compensate`` (:mod:`tcdyn.report.compensate`) and by
:func:`tcdyn.plots.pick.draw`. Tests: ``tests/report/test_pictures.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from tcdyn.io.unit_names import TEMPERATURES, without_unit
from tcdyn.plots.style import (
    DARK,
    FAST,
    GREY,
    MAX_POINTS,
    SLOW,
    axes_of,
    channel_style,
    line_with_band,
    screen_rows,
    style_axes,
)
from tcdyn.smoothing.inverse import FilterReport
from tcdyn.smoothing.record import Compensated
from tcdyn.workflows.traces import Trace

WITHOUT_SPIKES = (0.001, 0.999)  # quantiles of a logged trace that its axis shows; judgement


def draw_compensated(
    result: Compensated,
    logged: ArrayLike | None = None,
    ax: Axes | None = None,
    channel: int = 0,
    window_s: tuple[float, float] | None = None,
) -> Axes:
    """Plot a compensated channel with its 95 % band over the logged samples.

    Events are dashed lines, flagged samples are crosses.

    Parameters
    ----------
    result
        Compensated traces.
    logged
        Logged samples (N,) or (N, channels) [degC]; None: they are not plotted.
    ax
        Axes to plot into; None: those of a new figure.
    channel
        Index of the channel.
    window_s
        First and last time of the figure [s]; by default the full record.

    Returns
    -------
    ax
        The same axes.
    """
    ax = axes_of(ax)
    low, high = window_s or (float(result.time_s[0]), float(result.time_s[-1]))
    in_window = np.flatnonzero((result.time_s >= low) & (result.time_s <= high))
    if logged is None:
        y = np.full(len(result.time_s), np.nan)
    else:
        y = np.asarray(logged, dtype=float)
        y = y[:, channel] if y.ndim == 2 else y
        plotted = in_window[screen_rows(y[in_window])]
        ax.plot(
            result.time_s[plotted], y[plotted], ".", markersize=2, color=GREY, label="as logged"
        )
    plotted = in_window[screen_rows(result.temperature[in_window, channel])]
    t = result.time_s[plotted]
    x = result.temperature[plotted, channel]
    sd = result.sd[plotted, channel]
    line_with_band(ax, t, x, sd, SLOW, "95 %", linewidth=1.3, label="compensated")
    is_flagged = (result.flags[in_window, channel] > 0) & np.isfinite(y[in_window])
    flagged = in_window[is_flagged]
    if len(flagged):
        time_s = result.time_s[flagged]
        ax.plot(time_s, y[flagged], "x", color=FAST, markersize=4, label="flagged")
    for event, _ in result.events_s:
        if low <= event <= high:
            ax.axvline(event, linestyle="--", linewidth=0.8, color=DARK)
    y_label = "temperature [°C]"
    unit = result.units[channel] if result.units else "degC"
    if unit not in TEMPERATURES:
        y_label = f"reading [{unit}]"
    return style_axes(ax, "time [s]", y_label, loc="best")


def axis_label(trace: Trace) -> str:
    """Label of an axis for traces in one unit: a temperature or another quantity, and its unit.

    Parameters
    ----------
    trace
        One of the traces.
    """
    if trace.unit in TEMPERATURES:
        return f"temperature [{trace.unit}]".replace("degC", "°C")
    return f"{without_unit(trace.name)} [{trace.unit}]"


def draw_traces(traces: Sequence[Trace], y: str, ax: Axes, limit: int = MAX_POINTS) -> Axes:
    """Plot traces as logged (pale), and compensated with their 95 % bands.

    Parameters
    ----------
    traces
        The traces.
    y
        Label of the y axis.
    ax
        Axes to plot into.
    limit
        Points of each line.

    Returns
    -------
    ax
        The same axes. Spikes of the log do not set its limits.
    """
    low = np.inf
    high = -np.inf
    for k, trace in enumerate(traces):
        colour, dashes = channel_style(k)
        rows = screen_rows(trace.logged, limit)
        name = without_unit(trace.name)
        style: dict[str, Any] = {"color": colour, "linewidth": 1.0, "label": name}
        is_compensated = len(trace.compensated) > 0
        if is_compensated:
            style |= {"alpha": 0.5, "linewidth": 0.7, "label": f"{name} as logged"}
        ax.plot(trace.time_s[rows], trace.logged[rows], **style)
        values = trace.logged[np.isfinite(trace.logged)]
        if len(values):
            values = np.quantile(values, WITHOUT_SPIKES)
        if is_compensated:
            rows = screen_rows(trace.compensated, limit)
            lines = (trace.compensated_s[rows], trace.compensated[rows], trace.u[rows])
            label = f"{name} compensated"
            line_with_band(ax, *lines, colour, linestyle=dashes, linewidth=1.2, label=label)
            values = trace.compensated[np.isfinite(trace.compensated)]
        low = min([low, *values])
        high = max([high, *values])
    if low <= high:
        margin = 0.1 * (high - low) or 1.0
        ax.set_ylim(low - margin, high + margin)
    return style_axes(ax, "time [s]", y, loc="best", ncols=2)


def draw_filter_report(report: FilterReport, ax: Axes | None = None) -> Axes:
    """Plot the step response of the chain, and that of the chain with its compensation filter.

    The title states the remaining delay and the noise gain of the filter.

    Parameters
    ----------
    report
        Report about a compensation filter.
    ax
        Axes to plot into; None: those of a new figure.

    Returns
    -------
    ax
        The same axes.
    """
    ax = axes_of(ax)
    t = report.step_time_s
    label = f"chain alone, 10-90 % in {report.raw_rise_s:.2g} s"
    ax.plot(t, report.raw_step, "--", color=FAST, label=label)
    ax.plot(t, report.step, color=SLOW, label=f"compensated, {report.rise_s:.2g} s")
    ax.axhline(1.0, linewidth=0.6, color=GREY)
    slower_rise_s = max(report.raw_rise_s, report.rise_s)
    ax.set_xlim(0.0, min(float(t[-1]), 8.0 * slower_rise_s))
    shift = f"remaining shift {report.remaining_shift_s:.3g} s"
    noise = f"noise {report.noise_gain:.3g} times the trace's"
    return style_axes(
        ax,
        "time after a step at the junction [s]",
        "share of the step [1]",
        title=f"{shift}, {noise}",
        loc="lower right",
    )
