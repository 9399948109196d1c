"""Figure of the history of a lag: measurements against date, and the steady change.

Used by ``tcdyn sensor history --picture`` and by :func:`tcdyn.plots.pick.draw`. Test:
``tests/sensors/test_history.py``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter, date2num

from tcdyn.core.estimate import Z95
from tcdyn.plots.style import BAND_ALPHA, SERIES_MARKERS, axes_of, channel_style, style_axes
from tcdyn.sensors.history import DAY_S, GroupHistory, SensorHistory

POINTS = 60  # of a line; chosen by judgement


def draw_history(history: SensorHistory, ax: Axes | None = None) -> Axes:
    """Plot lags with 95 % bars against date, and the fitted change of each group with its band.

    Bars and bands leave out what all measurements of a group share. A step is drawn where it is
    more probable than a steady change, and significant.

    Parameters
    ----------
    history
        The history.
    ax
        Axes to plot into; None: those of a new figure.

    Returns
    -------
    ax
        The same axes.
    """
    ax = axes_of(ax)
    for k, group in enumerate(history.groups):
        _draw_group(ax, group, k)
    locator = AutoDateLocator(minticks=3, maxticks=7)
    ax.xaxis.set_major_locator(locator)
    ax.xaxis.set_major_formatter(ConciseDateFormatter(locator))
    ax.tick_params(labelsize="large")
    ax.margins(x=0.03, y=0.15)
    legend: dict[str, Any] = {
        "loc": "lower left",
        "bbox_to_anchor": (0.0, 1.0),
        "fontsize": "large",
    }
    style_axes(ax, "date", f"lag of {history.column} [s]", **legend)
    ax.xaxis.label.set_fontsize("large")
    ax.yaxis.label.set_fontsize("large")
    return ax


def _draw_group(ax: Axes, group: GroupHistory, k: int) -> None:
    """Plot the measurements and the fitted change of one group.

    Parameters
    ----------
    ax
        Axes to plot into.
    group
        The group.
    k
        Its number, for the colour.
    """
    colour, line = channel_style(k)
    measured = group.measurements
    change = group.change
    label = group.name
    if change is not None:
        low, high = 100 * change.total.low95, 100 * change.total.high95
        verdict = "" if group.is_significant else ", not significant"
        label += f": change {low:+.2g} to {high:+.2g} % (95 %){verdict}"
    ax.errorbar(
        date2num([each.date for each in measured]),
        [each.lag_s.value for each in measured],
        yerr=[Z95 * each.own_u_s for each in measured],
        fmt=SERIES_MARKERS[k % len(SERIES_MARKERS)],
        color=colour,
        markersize=6,
        elinewidth=1.2,
        capsize=3,
        label=label,
    )
    if change is None:
        return
    days = np.linspace(0, (measured[-1].date - group.first).total_seconds() / DAY_S, POINTS)
    levels = [change.level(float(day)) for day in days]
    dates = float(date2num(group.first)) + days
    ax.fill_between(
        dates,
        [each.low95 for each in levels],
        [each.high95 for each in levels],
        color=colour,
        alpha=BAND_ALPHA,
        linewidth=0,
    )
    ax.plot(dates, [each.value for each in levels], color=colour, linestyle=line, linewidth=2)
    if group.is_significant and change.step_probability > 0.5:
        low_date, high_date = date2num([group.date_at(day) for day in change.step_days])
        ax.axvspan(low_date, high_date, color=colour, alpha=BAND_ALPHA, label="likeliest step")
