"""One look for all pictures: tone, line and marker tell, colour only helps; units on every axis."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tcdyn.core import Array
from tcdyn.core.estimate import Z95

# fast prints light grey, slow dark
FAST = "#d1662a"
SLOW = "#1f4e79"
TRUTH = "#000000"
GREY = "#8a8a8a"
DISK_COLOUR = {"fast": FAST, "slow": SLOW}
DISK_MARKER = {"fast": "o", "slow": "s"}
DISK_LINE = {"fast": "-", "slow": "--"}
CHANNEL_STYLE = {"e": "-", "a": "--", "b": ":", "c": "-.", "d": (0, (1, 1)), "f": (0, (5, 1))}
# of what stands beside the data: marks, bands
DARK = "#444444"
PALE = "#e6e6e6"
SERIES_COLOURS = (TRUTH, FAST, SLOW, GREY)  # groups of tests
SERIES_MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
SERIES_LINES = ("-", "--", "-.", ":")
BAND = 0.25  # opacity of a 95 % band under its line
MOST_POINTS = 4000  # more than a page can show


def figure(
    rows: int = 1, columns: int = 1, width_in: float = 8.5, height_in: float = 4.2
) -> tuple[Figure, list[Axes]]:
    """A figure that belongs to no window, and its axes in reading order."""
    fig = Figure(figsize=(width_in, height_in), layout="constrained")
    axes = fig.subplots(rows, columns, squeeze=False)
    return fig, [finish(ax) for ax in axes.ravel()]


def pictured(*draw: Callable[[Axes], Any], rows: int = 1, **size: float) -> Figure:
    """A figure of one panel or several, each drawn by a function of its axes; ``size`` as of :func:`figure`."""
    picture, axes = figure(rows, -(-len(draw) // rows), **size)
    for one, ax in zip(draw, axes):
        one(ax)
    for ax in axes[len(draw) :]:
        ax.remove()
    return picture


def finish(ax: Axes) -> Axes:
    """Quiet grid, no frame lines that carry nothing."""
    ax.grid(True, color="#dddddd", linewidth=0.6)
    ax.set_axisbelow(True)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
    return ax


def dressed(
    ax: Axes, x: str, y: str, *, head: str = "", legend: bool = False, **options: Any
) -> Axes:
    """``ax`` with its labels, units in them, a heading, and a legend where asked for or where ``options`` place one."""
    ax.set(xlabel=x, ylabel=y)
    if head:
        ax.set_title(head, loc="left", fontsize="medium", y=1.0)  # no place to be looked for
    if legend or options:
        ax.legend(**{"frameon": False, "fontsize": "small", **options})
    return finish(ax)


def thinned(count: int, most: int = MOST_POINTS) -> slice:
    """Every k-th of so many points, as many as a page can show."""
    return slice(None, None, max(count // most, 1))


def line_with_band(
    ax: Axes, x: Array, y: Array, u: Array, colour: str, band: str | None = None, **line: Any
) -> None:
    """A line and under it the 95 % band of its standard uncertainty; ``band``: what a legend calls the latter."""
    ax.fill_between(x, y - Z95 * u, y + Z95 * u, color=colour, alpha=BAND, linewidth=0, label=band)
    ax.plot(x, y, color=colour, **line)
