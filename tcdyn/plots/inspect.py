"""Figures of ``tcdyn inspect``: the traces of a table, with gaps and what is no reading.

Tests: ``tests/cli/test_inspect_command.py`` and ``tests/core/test_results.py``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tcdyn.core import Array
from tcdyn.io.unit_names import without_unit
from tcdyn.plots.style import (
    CHANNEL_COLOURS,
    DARK,
    FAST,
    GREY,
    MAX_POINTS,
    PALE,
    PANEL_LETTER,
    SLOW,
    axes_of,
    figure,
    screen_rows,
    style_axes,
)
from tcdyn.series.reading import CODE, EMPTY, RANGE, READING, REPEAT
from tcdyn.workflows.inspect import InspectedColumn, Inspection

MAX_PANELS = 24  # panels of a figure; more are not legible on a page. By judgement.
WIDTH_IN = 6.0  # of the figure: its text is legible at a width of 400 pixels
PANEL_IN = 1.15  # height of one of several panels
LONE_PANEL_IN = 3.0  # height of the only panel
FRAME_IN = 1.0  # height of legend and axis
# Label, marker and colour of what is no reading, by reason. Repeated values lie on the trace, the
# others at the edge of the panel if they are far from the readings.
MARKS = {
    CODE: ("code of the logger", "x", FAST),
    RANGE: ("no temperature", "^", CHANNEL_COLOURS[3]),
    REPEAT: ("repeated", ".", GREY),
    EMPTY: ("no number", "|", DARK),
}
MARGIN = 0.08  # of a panel, above and below the readings
MARK_POINTS = 500  # marks of a reason in a panel, at most


def draw_inspected(inspection: Inspection, ax: Axes | None = None, column: int = 0) -> Axes:
    """Plot the readings of a column, what was left out, and the gaps.

    Parameters
    ----------
    inspection
        What is understood of a table.
    ax
        Axes to plot into; None: those of a new figure.
    column
        Index of the column.

    Returns
    -------
    ax
        The same axes.

    Examples
    --------
    >>> import pandas as pd, tcdyn
    >>> log = pd.DataFrame({"time_s": range(30), "T1_degC": [20.0, 21.0, 22.0] * 10})
    >>> draw_inspected(tcdyn.inspect(log)).get_xlabel()
    'time [s]'
    """
    ax = axes_of(ax)
    if not inspection.columns:
        return style_axes(ax, "time [s]", "no column of numbers")
    inspected = inspection.columns[column]
    _draw_panel(inspection, inspected, ax)
    style_axes(ax, "time [s]", _name_with_unit(inspected))
    ax.legend(frameon=False, fontsize="small")
    return ax


def inspection_figure(inspection: Inspection) -> Figure:
    """Return a figure with one panel a column, on one axis of time.

    Parameters
    ----------
    inspection
        What is understood of a table.
    """
    columns = inspection.columns[:MAX_PANELS]
    if len(columns) < 2:
        fig, axes = figure(width_in=WIDTH_IN, height_in=LONE_PANEL_IN + FRAME_IN)
        draw_inspected(inspection, axes[0])
        _move_legend(fig, axes)
        return fig
    height_in = PANEL_IN * len(columns) + FRAME_IN
    fig, axes = figure(rows=len(columns), width_in=WIDTH_IN, height_in=height_in)
    for ax, inspected in zip(axes, columns):
        for text in [each for each in ax.texts if each.get_gid() == PANEL_LETTER]:
            text.remove()
        _draw_panel(inspection, inspected, ax)
        style_axes(ax, "", "", title=_name_with_unit(inspected))
        ax.sharex(axes[0])
        ax.tick_params(labelbottom=ax is axes[-1])
        ax.locator_params(axis="y", nbins=4)
    axes[-1].set_xlabel("time [s]")
    n_more = len(inspection.columns) - len(columns)
    if n_more:
        axes[-1].set_xlabel(f"time [s]; {n_more} more column(s) are not shown")
    _move_legend(fig, axes)
    return fig


def _move_legend(fig: Figure, axes: list[Axes]) -> None:
    """One legend above all panels, with each entry once."""
    entries: dict[str, Any] = {}
    for ax in axes:
        legend = ax.get_legend()
        if legend is not None:
            legend.remove()
        handles, labels = ax.get_legend_handles_labels()
        entries |= dict(zip(labels, handles))
    fig.legend(
        handles=list(entries.values()),
        labels=list(entries),
        loc="outside upper center",
        ncols=min(len(entries), 3),
        frameon=False,
        fontsize="small",
    )


def _draw_panel(inspection: Inspection, inspected: InspectedColumn, ax: Axes) -> None:
    """Plot one column: readings, marks of what is none, and gaps."""
    time_s = inspection.time_s
    is_reading = inspected.reasons == READING
    readings = np.where(is_reading, inspected.values, np.nan)
    used = np.flatnonzero(is_reading)
    rows = used[screen_rows(readings[used], MAX_POINTS)]
    low, high = _limits(readings)
    shown_s, shown = _with_breaks(inspection, time_s[rows], readings[rows])
    ax.plot(shown_s, shown, color=SLOW, linewidth=1.0, marker=".", markersize=2, label="readings")
    for reason, (label, marker, colour) in MARKS.items():
        marked = np.flatnonzero(inspected.reasons == reason)
        if not len(marked):
            continue
        marked = marked[:: -(-len(marked) // MARK_POINTS)]
        values = np.clip(inspected.values[marked], low, high)
        values[~np.isfinite(values)] = low
        is_repeat = reason == REPEAT  # many, on the line of the readings
        ax.plot(
            time_s[marked],
            values,
            marker,
            color=colour,
            markersize=3 if is_repeat else 6,
            label=label,
            clip_on=False,
            zorder=1 if is_repeat else 3,
        )
    for gap in inspection.reading.gaps:
        end_s = gap.start_s + (gap.rows + 1) * inspection.reading.interval_s
        label = "no rows" if gap is inspection.reading.gaps[0] else "_"
        ax.axvspan(gap.start_s, end_s, color=PALE, linewidth=1.0, label=label)
    ax.set_ylim(low, high)


def _limits(readings: Array) -> tuple[float, float]:
    """Limits of a panel: those of the readings, with a margin."""
    finite = readings[np.isfinite(readings)]
    if not len(finite):
        return 0.0, 1.0
    low = float(finite.min())
    high = float(finite.max())
    margin = MARGIN * (high - low) or max(0.01 * abs(high), 0.5)
    return low - margin, high + margin


def _with_breaks(inspection: Inspection, time_s: Array, values: Array) -> tuple[Array, Array]:
    """The points of a line that is broken in each gap."""
    starts_s = np.array([gap.start_s for gap in inspection.reading.gaps])
    half_s = 0.5 * inspection.reading.interval_s
    at = np.searchsorted(time_s, starts_s + half_s)
    return np.insert(time_s, at, starts_s + half_s), np.insert(values, at, np.nan)


def _name_with_unit(inspected: InspectedColumn) -> str:
    """Name and unit of a column as a figure writes them."""
    name = without_unit(inspected.name)
    unit = inspected.unit.replace("degC", "°C").replace("degF", "°F")
    return name if not unit or unit in name else f"{name} [{unit}]"
