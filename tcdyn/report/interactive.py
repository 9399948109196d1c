"""Interactive charts from matplotlib figures, so that every figure is drawn once.

:mod:`tcdyn.report.page` embeds both: the picture for print and for browsers without scripts, and
the charts, which Plotly draws in the browser. Each axes of a figure is one chart; its labels,
limits, legend and artists are read by their public methods. ``plotly.tools.mpl_to_plotly`` is not
used: it has neither bands nor error bars, contours or legends, and one fixed size. Test:
``tests/report/test_interactive.py``.
"""

from __future__ import annotations

import html
import re
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_hex, to_rgba
from matplotlib.contour import ContourSet
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.path import Path
from matplotlib.text import Annotation, Text
from matplotlib.ticker import FixedLocator
from numpy.typing import ArrayLike

from tcdyn.core import Array
from tcdyn.plots.style import PANEL_LETTER

PX_PER_INCH = 100.0  # a figure of 8.5 to 10 inches fills the width of a page
MIN_HEIGHT_PX = 250.0  # of a chart, so that axes and legend have room; chosen by judgement
DIGITS = 7  # significant digits of a coordinate: a hundredth of a second in a day
DASHES = {"-": "solid", "--": "dash", ":": "dot", "-.": "dashdot"}
STEPS = {"steps-post": "hv", "steps-mid": "hvh", "steps-pre": "vh", "steps": "vh"}
MARKERS = {
    "o": "circle",
    ".": "circle",
    "s": "square",
    "^": "triangle-up",
    "v": "triangle-down",
    "<": "triangle-left",
    ">": "triangle-right",
    "D": "diamond",
    "P": "cross",
    "X": "x",
    "x": "x-thin",
    "*": "star",
    "|": "line-ns",
    "_": "line-ew",
}
UNIT = re.compile(r"\[([^\]]*)\]")

Trace = dict[str, Any]


class NotConvertible(TypeError):
    """A figure holds an artist that has no counterpart in a chart."""


def convert_figure(figure: Figure) -> dict[str, Any]:
    """Return a figure as charts of Plotly, one for each axes, in reading order.

    Parameters
    ----------
    figure
        The figure.

    Returns
    -------
    charts
        ``columns``, their number side by side, and ``charts``, each with ``row``, ``column``,
        ``letter``, ``title``, ``height`` [px], ``field`` (whether colours are a scale), ``data``
        and ``layout``.

    Raises
    ------
    NotConvertible
        For an artist of another kind than those of ``tcdyn.plots``.

    Examples
    --------
    >>> from tcdyn.plots.style import figure
    >>> fig, (ax,) = figure()
    >>> line = ax.plot([0.0, 1.0], [20.0, 21.5], label="a")
    >>> text = ax.set(xlabel="time [s]", ylabel="temperature [°C]")
    >>> (chart,) = convert_figure(fig)["charts"]
    >>> chart["data"][0]["name"], chart["data"][0]["y"]
    ('a', [20.0, 21.5])
    """
    scales = {id(ax) for main in figure.axes for ax in _scale_axes(main)}
    panels: dict[Any, list[Axes]] = {}
    rows = columns = 1
    for ax in figure.axes:
        if id(ax) in scales:
            continue
        spec = ax.get_subplotspec()
        panels.setdefault(spec or id(ax), []).append(ax)
        if spec is not None:
            grid = spec.get_gridspec()
            rows, columns = grid.nrows, grid.ncols
    height = max(PX_PER_INCH * figure.get_figheight() / rows, MIN_HEIGHT_PX)
    charts = [_chart(axes, height) for axes in panels.values() if _has_content(axes[0])]
    return {"columns": columns, "charts": charts}


def _has_content(ax: Axes) -> bool:
    """Return whether ``ax`` shows more than a legend."""
    return bool(ax.axison or ax.lines or ax.patches or ax.collections)


def _scale_axes(ax: Axes) -> list[Axes]:
    """Return the axes of the colour scales of ``ax``."""
    colorbars = [getattr(child, "colorbar", None) for child in ax.get_children()]
    return [colorbar.ax for colorbar in colorbars if colorbar is not None]


def _chart(axes: Sequence[Axes], height: float) -> dict[str, Any]:
    """Return the chart of one axes, and of the one that shares its place with a right axis."""
    main = axes[0]
    layout: dict[str, Any] = {"xaxis": _axis(main, "x"), "shapes": [], "annotations": []}
    data: list[Trace] = []
    for ax, suffix in zip(axes, ("", "2")):
        layout[f"yaxis{suffix}"] = _axis(ax, "y")
        traces = _Converter(ax, f"y{suffix}", layout).traces()
        data += traces
    if len(axes) > 1:
        layout["yaxis2"] |= {"overlaying": "y", "side": "right", "showgrid": False}
    if main.get_aspect() == 1.0:
        layout["yaxis"] |= {"scaleanchor": "x"}
    legend = main.get_legend()
    if legend is not None:
        layout["legend"] = {"title": {"text": _plotly_text(legend.get_title().get_text())}}
    spec = main.get_subplotspec()
    letters = [text.get_text() for text in main.texts if text.get_gid() == PANEL_LETTER]
    return {
        "row": spec.rowspan.start + 1 if spec else 1,
        "column": spec.colspan.start + 1 if spec else 1,
        "letter": "".join(letters),
        "title": " ".join(filter(None, (main.get_title(loc) for loc in ("left", "center")))),
        "height": round(height),
        "field": bool(_scale_axes(main)),
        "data": data,
        "layout": layout,
    }


def _axis(ax: Axes, name: str) -> dict[str, Any]:
    """Return the layout of the axis "x" or "y" of ``ax``."""
    axis = ax.xaxis if name == "x" else ax.yaxis
    limits = np.asarray(axis.get_view_interval(), dtype=float)
    result: dict[str, Any] = {
        "title": {"text": _plotly_text(axis.get_label_text())},
        "visible": bool(ax.axison),
        "showgrid": any(line.get_visible() for line in axis.get_gridlines()),
    }
    if axis.get_scale() == "log":
        result["type"] = "log"
        limits = np.log10(limits)
    if ax.xaxis_inverted() if name == "x" else ax.yaxis_inverted():
        limits = np.sort(limits)[::-1]
    result["range"] = _json_numbers(limits)
    if isinstance(axis.get_major_locator(), FixedLocator):
        result["tickvals"] = _json_numbers(axis.get_ticklocs())
        result["ticktext"] = [_plotly_text(label.get_text()) for label in axis.get_ticklabels()]
    return result


class _Converter:
    """Traces, shapes and annotations of one axes.

    Parameters
    ----------
    ax
        The axes.
    y_name
        "y", or "y2" for a right axis.
    layout
        Layout of the chart, to which shapes and annotations are added.
    """

    def __init__(self, ax: Axes, y_name: str, layout: dict[str, Any]) -> None:
        self.ax = ax
        self.y_name = y_name
        self.layout = layout
        self.named: set[str] = set()
        # Error bars and bars belong to the label of their container; the first has the entry.
        self.label_of: dict[int, str] = {}
        self.group_of: dict[int, str] = {}
        for container in ax.containers:
            label = _legend_entry(container)
            members = container.get_children()
            self.group_of |= {id(member): label for member in members}
            self.label_of[id(container[0] or members[0])] = label
        # An artist without a label belongs to the labelled one of the same style.
        self.label_of_style: dict[tuple[str, ...], str] = {}
        for line in ax.lines:
            if _legend_entry(line):
                self.label_of_style.setdefault(_style(line), _legend_entry(line))

    def traces(self) -> list[Trace]:
        """Return the traces in the order in which they are drawn."""
        artists = [*self.ax.patches, *self.ax.collections, *self.ax.lines, *self.ax.images]
        artists.sort(key=lambda artist: artist.get_zorder())
        traces = [trace for artist in artists for trace in self._traces_of(artist)]
        for text in self.ax.texts:
            if text.get_gid() != PANEL_LETTER and text.get_text():
                self.layout["annotations"].append(self._annotation(text))
        return traces

    def _traces_of(self, artist: Any) -> Iterable[Trace]:
        """Return the traces of an artist; of one across the axes none, but a shape."""
        across = artist.get_transform().contains_branch_seperately(self.ax.transData)
        if isinstance(artist, Line2D):
            if not all(across):
                self._add_shape("line", artist, across, artist.get_xydata(), _line(artist))
                return ()
            return (self._line_trace(artist),)
        if isinstance(artist, Rectangle) and not all(across):
            corners = artist.get_patch_transform().transform([(0, 0), (1, 1)])
            fill = {"fillcolor": _rgba(artist.get_facecolor()), "line": {"width": 0}}
            self._add_shape("rect", artist, across, corners, fill)
            return ()
        if isinstance(artist, Patch):
            path = artist.get_patch_transform().transform_path(artist.get_path())
            return (self._area(artist, [path], artist.get_facecolor(), artist.get_edgecolor()),)
        if isinstance(artist, ContourSet):
            return self._levels(artist)
        if isinstance(artist, PolyCollection):
            return (self._area(artist, artist.get_paths(), artist.get_facecolor()[0]),)
        if isinstance(artist, LineCollection):
            colour = artist.get_color()[0]
            width = float(np.ravel(artist.get_linewidth())[0])
            return (self._outline(artist, artist.get_paths(), colour, width),)
        raise NotConvertible(type(artist).__name__)

    def _trace(self, artist: Any, x: ArrayLike, y: ArrayLike, **options: Any) -> Trace:
        """Return a trace with name, group and hover text.

        Parameters
        ----------
        artist
            Artist of matplotlib; its label is the name and the group.
        x, y
            Coordinates; a category of the axis is shown by its name.
        options
            Further keys of the trace. With ``hoverinfo`` there is no hover text.
        """
        trace: Trace = {"type": "scatter", "yaxis": self.y_name, **options}
        self._name(artist, trace)
        hover = []
        for name, values in (("x", x), ("y", y)):
            trace[name] = _json_numbers(values)
            axis = self._layout_of(name)
            names = _tick_names(axis, np.asarray(values, dtype=float))
            if names:
                trace["text"] = names
                hover.append("%{text}")
            else:
                hover.append(f"%{{{name}:.5~g}} {_unit_of_label(axis['title']['text'])}".rstrip())
        if "hoverinfo" not in trace:
            name = trace.get("legendgroup", "")
            trace["hovertemplate"] = f"{'<br>'.join(hover)}<extra>{name}</extra>"
        return trace

    def _name(self, artist: Any, item: dict[str, Any]) -> None:
        """Give a trace or shape its group, and one of each group its entry in the legend."""
        label = self.label_of.get(id(artist), "") or _legend_entry(artist)
        group = _plotly_text(artist.get_gid()) or label or self.group_of.get(id(artist), "")
        if not group and isinstance(artist, Line2D):
            group = self.label_of_style.get(_style(artist), "")
        # A band with a label of its own belongs to its line, which has the entry.
        item["showlegend"] = bool(label) and label == group and group not in self.named
        if group:
            item |= {"legendgroup": group, "name": group}
            if item["showlegend"]:
                self.named.add(group)

    def _line_trace(self, line: Line2D) -> Trace:
        """Return a line, markers, or both."""
        x, y = np.asarray(line.get_xydata(), dtype=float).T
        modes = []
        options = _line(line)
        if line.get_linestyle() in DASHES and line.get_linewidth():
            modes.append("lines")
            options["line"]["shape"] = STEPS.get(line.get_drawstyle(), "linear")
        marker = _marker(line)
        if marker:
            modes.append("markers")
            options["marker"] = marker
        if not len(x):  # only an entry of the legend
            x = y = np.array([np.nan])
        return self._trace(line, x, y, mode="+".join(modes) or "none", **options)

    def _levels(self, contours: Any) -> list[Trace]:
        """Return one trace for each level of a contour plot, named by its values."""
        unit = ""
        scale = contours.colorbar
        if scale is not None:
            label = _plotly_text(scale.ax.get_ylabel())
            unit = _unit_of_label(label)
        levels = [float(level) for level in contours.levels]
        traces = []
        for k, path in enumerate(contours.get_paths()):
            if not len(path.vertices):
                continue
            if contours.filled:
                colour = contours.get_facecolor()[k]
                trace = self._area(contours, [path], colour)
                name = f"{levels[k]:.4g} to {levels[k + 1]:.4g} {unit}"
                trace |= {"name": name.rstrip(), "hoveron": "fills", "hoverinfo": "name"}
            else:
                colours = contours.get_edgecolor()
                colour = colours[k % len(colours)]
                trace = self._outline(contours, [path], colour, 0.8)
                trace["name"] = f"{levels[k]:.4g} {unit}"
            traces.append(trace)
        if scale is not None:
            shades = contours.to_rgba(np.linspace(levels[0], levels[-1], 21))
            traces.append(_colour_scale(shades, levels[0], levels[-1], label))
        return traces

    def _area(self, artist: Any, paths: Sequence[Path], colour: Any, edge: Any = None) -> Trace:
        """Return closed outlines that are filled; only those with an edge have hover text."""
        x, y = _outlines_with_gaps(polygon for path in paths for polygon in path.to_polygons())
        line = {"width": 0.5 if to_rgba(colour)[3] == 1.0 else 0, "color": to_hex(edge or colour)}
        style: Trace = {"mode": "lines", "line": line, "fill": "toself", "fillcolor": _rgba(colour)}
        if edge is None:
            style["hoverinfo"] = "skip"
        return self._trace(artist, x, y, **style)

    def _outline(self, artist: Any, paths: Sequence[Path], colour: Any, width: float) -> Trace:
        """Return lines that are not connected with each other."""
        x, y = _outlines_with_gaps(p for path in paths for p in path.to_polygons(closed_only=False))
        line = {"color": to_hex(colour), "width": 1.3 * width}
        return self._trace(artist, x, y, mode="lines", line=line)

    def _add_shape(
        self, kind: str, artist: Any, across: Sequence[bool], ends: Any, style: dict[str, Any]
    ) -> None:
        """Add a line or band across the axes to the layout.

        Parameters
        ----------
        kind
            "line" or "rect".
        artist
            Artist of matplotlib, for the name.
        across
            Whether ``ends`` are data in x and in y; otherwise shares of the axes.
        ends
            Two opposite corners, (2, 2) or more.
        style
            Further keys of the shape.
        """
        (x0, y0), (x1, y1) = np.asarray(ends, dtype=float)[[0, -1]]
        shape = {"type": kind, "x0": x0, "x1": x1, "y0": y0, "y1": y1, **style}
        shape["xref"] = "x" if across[0] else "x domain"
        shape["yref"] = self.y_name if across[1] else f"{self.y_name} domain"
        shape["layer"] = "below" if kind == "rect" else "above"
        self._name(artist, shape)
        self.layout["shapes"].append(shape)

    def _annotation(self, text: Text) -> dict[str, Any]:
        """Return a text at its position."""
        shift = (0.0, 0.0)
        if isinstance(text, Annotation):
            position: Sequence[Any] = text.xy
            coordinates: Any = text.xycoords
            pair = (coordinates, coordinates) if isinstance(coordinates, str) else coordinates
            in_data = [name == "data" for name in pair]
            if text.get_anncoords() == "offset points":
                shift = text.xyann
        else:
            position = text.get_position()
            in_data = list(text.get_transform().contains_branch_seperately(self.ax.transData))
        values = [float(value) for value in position]
        for k, name in enumerate("xy"):
            if in_data[k] and self._layout_of(name).get("type") == "log":
                values[k] = float(np.log10(values[k]))
        box = text.get_bbox_patch()
        anchors = {"center": "middle", "center_baseline": "middle", "baseline": "bottom"}
        vertical = text.get_verticalalignment()
        return {
            "text": _plotly_text(text.get_text()).replace("\n", "<br>"),
            "x": values[0],
            "y": values[1],
            "xref": "x" if in_data[0] else "x domain",
            "yref": self.y_name if in_data[1] else f"{self.y_name} domain",
            "xshift": shift[0] * PX_PER_INCH / 72,
            "yshift": shift[1] * PX_PER_INCH / 72,
            "xanchor": text.get_horizontalalignment(),
            "yanchor": anchors.get(vertical, vertical),
            "textangle": -text.get_rotation(),
            "showarrow": False,
            "font": {"size": 11, "color": to_hex(text.get_color())},
            "bgcolor": "rgba(0,0,0,0)" if box is None else _rgba(box.get_facecolor()),
        }

    def _layout_of(self, name: str) -> dict[str, Any]:
        """Return the layout of the axis "x" or "y"."""
        return self.layout["xaxis" if name == "x" else f"yaxis{self.y_name[1:]}"]


def _legend_entry(artist: Any) -> str:
    """Return the entry of an artist in the legend; empty without one."""
    label = _plotly_text(artist.get_label())
    return "" if label.startswith("_") else label


def _plotly_text(text: Any) -> str:
    """Return text that Plotly, which knows some HTML, shows as it is."""
    return html.escape(str(text or ""), quote=False)


def _style(line: Line2D) -> tuple[str, ...]:
    """Return what distinguishes the lines of one axes."""
    return to_hex(line.get_color()), str(line.get_linestyle()), str(line.get_marker())


def _line(line: Any) -> dict[str, Any]:
    """Return colour, width and dashes of a line."""
    style = {
        "color": to_hex(line.get_color()),
        "width": 1.3 * line.get_linewidth(),
        "dash": DASHES.get(line.get_linestyle(), "solid"),
    }
    return {"line": style, "opacity": line.get_alpha() or 1.0}


def _marker(line: Line2D) -> dict[str, Any]:
    """Return the marker of a line; empty without one."""
    name = line.get_marker()
    if name in ("None", "none", "", " ", None):
        return {}
    if name not in MARKERS:
        raise NotConvertible(f"marker {name!r}")
    face = line.get_markerfacecolor()
    is_open = isinstance(face, str) and face == "none"
    edge = to_hex(line.get_markeredgecolor())
    size = line.get_markersize() * (1.0 if name == "." else 1.3)
    return {
        "symbol": MARKERS[name] + ("-open" if is_open else ""),
        "color": edge if is_open else to_hex(face),
        "size": size,
        "line": {"color": edge, "width": line.get_markeredgewidth() if name != "." else 0},
    }


def _rgba(colour: Any) -> str:
    """Return a colour with its opacity."""
    red, green, blue, alpha = to_rgba(colour)
    return f"rgba({255 * red:.0f},{255 * green:.0f},{255 * blue:.0f},{alpha:.3g})"


def _json_numbers(values: ArrayLike) -> list[float | None]:
    """Return numbers for JSON; None where one is not finite."""
    array = np.atleast_1d(np.asarray(values, dtype=float))
    return [float(f"{x:.{DIGITS}g}") if np.isfinite(x) else None for x in array.tolist()]


def _outlines_with_gaps(polygons: Iterable[Any]) -> tuple[list[float], list[float]]:
    """Return the coordinates of several outlines, NaN after each: Plotly breaks the line there."""
    x: list[float] = []
    y: list[float] = []
    for polygon in polygons:
        points = np.asarray(polygon, dtype=float)
        x += [*points[:, 0], np.nan]
        y += [*points[:, 1], np.nan]
    return x, y


def _unit_of_label(label: str) -> str:
    """Return the unit of a label."""
    match = UNIT.search(label)
    return match[1] if match and match[1] != "1" else ""


def _tick_names(axis: dict[str, Any], values: Array) -> list[str]:
    """Return the labels of the ticks nearest to ``values``; empty for an axis of numbers."""
    ticks = axis.get("ticktext", [])
    if not ticks or re.match(r"[-−\d.]", ticks[0]):
        return []
    nearest = np.abs(np.subtract.outer(values, axis["tickvals"])).argmin(axis=1)
    return [ticks[k] for k in nearest]


def _colour_scale(shades: Any, low: float, high: float, label: str) -> Trace:
    """Return a trace without points that shows a colour scale.

    Parameters
    ----------
    shades
        Colours at uniform steps from ``low`` to ``high``.
    low, high
        Values at the ends of the scale.
    label
        Title of the scale, with its unit.
    """
    stops = np.linspace(0.0, 1.0, len(shades))
    return {
        "type": "scatter",
        "x": [None],
        "y": [None],
        "mode": "markers",
        "showlegend": False,
        "hoverinfo": "skip",
        "marker": {
            "color": [low],
            "cmin": low,
            "cmax": high,
            "colorscale": [[float(stop), to_hex(shade)] for stop, shade in zip(stops, shades)],
            "showscale": True,
            "colorbar": {"title": {"text": label, "side": "right"}, "thickness": 14},
        },
    }
