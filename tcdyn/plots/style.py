"""One look for all pictures: tone, line and marker tell, colour only helps; units on every axis."""

from __future__ import annotations

from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

FAST, SLOW, TRUTH, GREY = "#d1662a", "#1f4e79", "#000000", "#8a8a8a"  # fast prints light grey, slow dark
DISK_COLOUR = {"fast": FAST, "slow": SLOW}
DISK_MARKER = {"fast": "o", "slow": "s"}
DISK_LINE = {"fast": "-", "slow": "--"}
CHANNEL_STYLE = {"e": "-", "a": "--", "b": ":", "c": "-.", "d": (0, (1, 1)), "f": (0, (5, 1))}
DARK, PALE = "#444444", "#e6e6e6"  # of what stands beside the data: marks, bands
SERIES_COLOURS = (TRUTH, FAST, SLOW, GREY)  # groups of tests
SERIES_MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
SERIES_LINES = ("-", "--", "-.", ":")
BAND = 0.25  # opacity of a 95 % band under its line


def figure(rows: int = 1, columns: int = 1, width_in: float = 8.5, height_in: float = 4.2) -> tuple[Figure, list[Axes]]:
    """A figure that belongs to no window, and its axes in reading order."""
    fig = Figure(figsize=(width_in, height_in), layout="constrained")
    axes = fig.subplots(rows, columns, squeeze=False)
    return fig, [finish(ax) for ax in axes.ravel()]


def finish(ax: Axes) -> Axes:
    """Quiet grid, no frame lines that carry nothing."""
    ax.grid(True, color="#dddddd", linewidth=0.6)
    ax.set_axisbelow(True)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
    return ax


def dressed(ax: Axes, x: str, y: str, *, legend: bool = False, **options: Any) -> Axes:
    """``ax`` with its labels, units in them, and a legend where asked for or where ``options`` place one."""
    ax.set(xlabel=x, ylabel=y)
    if legend or options:
        ax.legend(**{"frameon": False, "fontsize": "small", **options})
    return finish(ax)
