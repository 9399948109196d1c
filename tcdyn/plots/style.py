"""Style of all figures: colours, markers, line styles, axes with units.

Used by every module of ``tcdyn/plots`` and by ``tcdyn/report``. Colours, markers and line styles
may be changed here and nowhere else. Disks differ in colour, marker and line style, so that figures
can be read in black and white.
"""

from __future__ import annotations

from collections.abc import Callable
from string import ascii_lowercase
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter
from numpy.typing import NDArray
from tsdownsample import MinMaxLTTBDownsampler

from tcdyn.core import Array
from tcdyn.core.estimate import Z95

# The fast disk prints light grey, the slow disk dark.
FAST = "#d1662a"
SLOW = "#1f4e79"
TRUTH = "#000000"
GREY = "#8a8a8a"
DISK_COLOUR = {"fast": FAST, "slow": SLOW}
DISK_MARKER = {"fast": "o", "slow": "s"}
DISK_LINE = {"fast": "-", "slow": "--"}
# Line styles of the default channels.
CHANNEL_STYLE = {"e": "-", "a": "--", "b": ":", "c": "-.", "d": (0, (1, 1)), "f": (0, (5, 1))}

# Marks (dark) and bands (pale) that are not data.
DARK = "#444444"
PALE = "#e6e6e6"

# Channels of a log: six colours that colour-blind readers can tell apart (Okabe and Ito 2008), then
# the same ones with other line styles.
CHANNEL_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")

# Groups of tests.
SERIES_COLOURS = (TRUTH, FAST, SLOW, GREY)
SERIES_MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
SERIES_LINES = ("-", "--", "-.", ":")

BAND_ALPHA = 0.25  # opacity of a 95 % band; chosen by judgement
MAX_POINTS = 4000  # points of one curve: more than a page can show; chosen by judgement
PANEL_LETTER = "panel letter"  # group id of the letter of a panel


def figure(
    rows: int = 1, columns: int = 1, width_in: float = 8.5, height_in: float = 4.2
) -> tuple[Figure, list[Axes]]:
    """Return a figure without a window, and its axes in reading order.

    Parameters
    ----------
    rows, columns
        Numbers of rows and columns of axes.
    width_in, height_in
        Size of the figure [in].

    Returns
    -------
    figure
        The figure.
    axes
        Its axes in reading order, with the frame of the style; several have letters.
    """
    fig = Figure(figsize=(width_in, height_in), layout="constrained")
    axes = list(fig.subplots(rows, columns, squeeze=False).ravel())
    for ax in axes:
        _style_frame(ax)
    if len(axes) > 1:
        for letter, ax in zip(ascii_lowercase, axes):
            ax.annotate(
                letter,
                (0, 1),
                xycoords="axes fraction",
                weight="bold",
                gid=PANEL_LETTER,
                xytext=(-30, 6),
                textcoords="offset points",
            )
    return fig, axes


def axes_of(ax: Axes | None) -> Axes:
    """The axes that are given, or those of a new figure."""
    return figure()[1][0] if ax is None else ax


def panel_figure(*draw: Callable[[Axes], Any], rows: int = 1, **size: float) -> Figure:
    """Return a figure with one panel for each function of axes.

    Parameters
    ----------
    *draw
        Functions that plot into the axes that they get; their return values are ignored.
    rows
        Number of rows of panels.
    **size
        ``width_in`` and ``height_in`` as of :func:`figure`.
    """
    columns = -(-len(draw) // rows)
    fig, axes = figure(rows, columns, **size)
    for draw_panel, ax in zip(draw, axes):
        draw_panel(ax)
    for ax in axes[len(draw) :]:
        ax.remove()
    return fig


def _style_frame(ax: Axes) -> Axes:
    """Give ``ax`` a pale grid behind the data and no frame at the top and on the right.

    Parameters
    ----------
    ax
        Axes to plot into.
    """
    ax.grid(True, color="#dddddd", linewidth=0.6)
    ax.set_axisbelow(True)
    ax.spines["top"].set_visible(False)
    ax.spines["right"].set_visible(False)
    return ax


def style_axes(
    ax: Axes, x: str, y: str, *, title: str = "", legend: bool = False, **legend_options: Any
) -> Axes:
    """Set labels, title, legend and style of ``ax``, and return it.

    Parameters
    ----------
    ax
        Axes to style.
    x, y
        Axis labels with their units.
    title
        Title above the axes, on the left.
    legend
        Whether to add a legend; any ``legend_options`` add one, too.
    **legend_options
        Keyword arguments of ``Axes.legend``; ``legend_title`` is the title of the legend.

    Returns
    -------
    ax
        The same axes.
    """
    ax.set(xlabel=x, ylabel=y)
    if title:
        ax.set_title(title, loc="left", fontsize="medium")
    if "legend_title" in legend_options:
        legend_options["title"] = legend_options.pop("legend_title")
    if legend or legend_options:
        ax.legend(**{"frameon": False, "fontsize": "small", **legend_options})
    return _style_frame(ax)


def channel_style(k: int) -> tuple[str, str]:
    """Return colour and line style of the ``k``-th channel of a log.

    >>> channel_style(0), channel_style(7)
    (('#0072b2', '-'), ('#d55e00', '--'))
    """
    n = len(CHANNEL_COLOURS)
    return CHANNEL_COLOURS[k % n], SERIES_LINES[k // n % len(SERIES_LINES)]


def log_axis(ax: Axes, name: Literal["x", "y"]) -> None:
    """Make the axis "x" or "y" logarithmic, with plain numbers at the powers of ten.

    Parameters
    ----------
    ax
        Axes to change.
    name
        "x" or "y".
    """
    ax.set(**{f"{name}scale": "log"})
    axis = ax.xaxis if name == "x" else ax.yaxis
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())


def screen_rows(values: Array, limit: int = MAX_POINTS) -> NDArray[np.intp]:
    """Return the rows of a trace that show its shape on a screen.

    Parameters
    ----------
    values
        Values (N,).
    limit
        Number of rows that is wanted.

    Returns
    -------
    rows
        Rising indices; all of a trace of at most ``limit`` rows.

    Notes
    -----
    MinMaxLTTB (Van Der Donckt et al., arXiv:2305.00332): extremes such as spikes stay. A row
    without a value is chosen only in a gap; the variant of the library for NaN would choose one
    from every bin that has one.

    Examples
    --------
    >>> spike = np.zeros(100_000)
    >>> spike[77_777] = 1.0
    >>> rows = screen_rows(spike)
    >>> len(rows), 77_777 in rows
    (4000, True)
    """
    if len(values) <= limit:
        return np.arange(len(values))
    trace = np.ascontiguousarray(values, dtype=float)
    return MinMaxLTTBDownsampler().downsample(trace, n_out=limit).astype(np.intp)


def line_with_band(
    ax: Axes, x: Array, y: Array, u: Array, colour: str, band: str | None = None, **line: Any
) -> None:
    """Plot a line and the 95 % band of its standard uncertainty ``u``.

    Parameters
    ----------
    ax
        Axes to plot into.
    x, y, u
        Abscissa, value and standard uncertainty (N,).
    colour
        Colour of line and band.
    band
        Label of the band in the legend.
    **line
        Keyword arguments of ``Axes.plot`` for the line.
    """
    half_width = Z95 * u
    group = line.get("label")  # a chart shows and hides both together
    ax.fill_between(
        x,
        y - half_width,
        y + half_width,
        gid=group,
        color=colour,
        alpha=BAND_ALPHA,
        linewidth=0,
        label=band,
    )
    ax.plot(x, y, color=colour, gid=group, **line)
