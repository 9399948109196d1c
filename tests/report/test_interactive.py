"""Charts hold the numbers, names and colours of the figures that they are made from."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import plotly.graph_objects as go
import pytest

from tcdyn.plots.style import figure, line_with_band, log_axis, screen_rows, style_axes
from tcdyn.report.interactive import NotConvertible, convert_figure


def chart_of(draw: Any) -> dict[str, Any]:
    """The chart of one axes into which ``draw`` plots; Plotly accepts its content."""
    fig, (ax,) = figure()
    draw(ax)
    (chart,) = convert_figure(fig)["charts"]
    go.Figure(data=chart["data"], layout=chart["layout"])  # raises for an unknown property
    json.dumps(chart, allow_nan=False)
    return chart


def test_line_has_its_points_style_name_and_the_units_of_the_axes() -> None:
    def draw(ax: Any) -> None:
        ax.plot([0.0, 1.0, 2.0], [20.0, np.nan, 22.5], "--", color="#d1662a", label="e")
        style_axes(ax, "time [s]", "temperature [°C]", legend=True)

    chart = chart_of(draw)
    (line,) = chart["data"]
    assert (line["x"], line["y"]) == ([0.0, 1.0, 2.0], [20.0, None, 22.5])
    assert line["line"]["color"] == "#d1662a"
    assert line["line"]["dash"] == "dash"
    assert line["showlegend"]
    assert line["name"] == "e"
    assert line["hovertemplate"] == "%{x:.5~g} s<br>%{y:.5~g} °C<extra>e</extra>"
    assert chart["layout"]["xaxis"]["title"]["text"] == "time [s]"


def test_band_is_switched_together_with_its_line_and_has_no_entry_of_its_own() -> None:
    x = np.linspace(0.0, 1.0, 5)
    chart = chart_of(
        lambda ax: line_with_band(ax, x, x, 0 * x + 0.5, "#1f4e79", "95 %", label="fit")
    )
    band, line = chart["data"]
    assert band["legendgroup"] == line["legendgroup"] == "fit"
    assert (band["showlegend"], line["showlegend"]) == (False, True)
    y = np.array([v for v in band["y"] if v is not None])
    assert (y.min(), y.max()) == pytest.approx((-0.98, 1.98), abs=1e-3)
    assert band["fillcolor"] == "rgba(31,78,121,0.25)"


def test_unlabelled_line_belongs_to_the_entry_of_its_style() -> None:
    def draw(ax: Any) -> None:
        ax.plot([0, 1], [0, 1], color="k")
        ax.plot([0, 1], [0, 1], color="r")
        ax.plot([], [], color="k", label="logged")

    first, second, entry = chart_of(draw)["data"]
    assert first["legendgroup"] == entry["legendgroup"] == "logged"
    assert "legendgroup" not in second


def test_error_bars_have_their_ends_and_are_switched_with_their_markers() -> None:
    def draw(ax: Any) -> None:
        ax.errorbar([0.7], [1.0], xerr=[[0.01], [0.02]], fmt="D", capsize=3, label="95 %")
        ax.set_yticks([0.0, 1.0], ["speed law", "joint fit"])
        style_axes(ax, "beta [1]", "")

    traces = chart_of(draw)["data"]
    assert {trace["legendgroup"] for trace in traces} == {"95 %"}
    (entry,) = [trace for trace in traces if trace["showlegend"]]
    assert entry["marker"]["symbol"] == "diamond"
    points = {(x, y) for trace in traces for x, y in zip(trace["x"], trace["y"]) if x is not None}
    assert points == {(0.7, 1.0), (0.69, 1.0), (0.72, 1.0)}
    for trace in traces:
        assert trace["text"][0] == "joint fit"
        assert trace["hovertemplate"] == "%{x:.5~g}<br>%{text}<extra>95 %</extra>"


def test_bars_are_rectangles_at_their_positions_with_their_lengths() -> None:
    chart = chart_of(lambda ax: ax.barh([0.0, 1.0], [3.0, 5.0], height=0.5, label="u"))
    first, second = chart["data"]
    assert {(x, y) for x, y in zip(second["x"], second["y"]) if x is not None} == {
        (0.0, 0.75),
        (0.0, 1.25),
        (5.0, 0.75),
        (5.0, 1.25),
    }
    assert [trace["showlegend"] for trace in (first, second)] == [True, False]
    assert first["legendgroup"] == second["legendgroup"] == "u"


def test_lines_and_bands_across_the_axes_are_shapes_with_an_entry() -> None:
    def draw(ax: Any) -> None:
        ax.plot([0, 4], [0, 1])
        ax.axvline(2.0, label="unloading")
        ax.axhspan(0.2, 0.4)

    vertical, band = sorted(chart_of(draw)["layout"]["shapes"], key=lambda s: s["type"])
    assert (vertical["x0"], vertical["x1"], vertical["yref"]) == (2.0, 2.0, "y domain")
    assert vertical["showlegend"]
    assert vertical["name"] == "unloading"
    assert (band["y0"], band["y1"], band["xref"]) == (0.2, 0.4, "x domain")


def test_levels_of_a_contour_plot_are_named_with_their_unit() -> None:
    def draw(ax: Any) -> None:
        filled = ax.contourf(np.add.outer(np.arange(5.0), np.arange(5.0)), levels=[0, 2, 4, 8])
        ax.figure.colorbar(filled, ax=ax, label="temperature [°C]")

    chart = chart_of(draw)
    names = [trace["name"] for trace in chart["data"] if "name" in trace]
    assert names == ["0 to 2 °C", "2 to 4 °C", "4 to 8 °C"]
    assert chart["field"]
    assert chart["data"][-1]["marker"]["colorbar"]["title"]["text"] == "temperature [°C]"


def test_logarithmic_and_inverted_axes_and_names_of_ticks_are_kept() -> None:
    def draw(ax: Any) -> None:
        ax.plot([0.01, 100.0], [0.0, 1.0])
        log_axis(ax, "x")
        ax.set_xlim(0.01, 100.0)
        ax.set_ylim(2.0, -1.0)
        ax.set_yticks([0.0, 1.0], ["a", "b"])
        ax.annotate("here", (10.0, 0.5), (4, -2), textcoords="offset points")

    layout = chart_of(draw)["layout"]
    assert (layout["xaxis"]["type"], layout["xaxis"]["range"]) == ("log", [-2.0, 2.0])
    assert layout["yaxis"]["range"] == [2.0, -1.0]
    assert layout["yaxis"]["ticktext"] == ["a", "b"]
    (text,) = layout["annotations"]
    assert (text["x"], text["y"]) == (1.0, 0.5)  # the logarithm
    assert text["xshift"] > 0 > text["yshift"]


def test_right_axis_is_in_the_chart_of_its_left_axis_and_panels_have_letters() -> None:
    fig, axes = figure(1, 2)
    axes[0].plot([0, 1], [0, 1])
    axes[0].twinx().plot([0, 1], [5, 6])
    axes[1].plot([0, 1], [0, 1])
    content = convert_figure(fig)
    first, second = content["charts"]
    assert content["columns"] == 2
    assert [chart["letter"] for chart in (first, second)] == ["a", "b"]
    assert [trace["yaxis"] for trace in first["data"]] == ["y", "y2"]
    assert first["layout"]["yaxis2"]["overlaying"] == "y"


def test_names_of_columns_are_shown_as_they_are() -> None:
    """Plotly would take ``<i>`` for italics, and drop an unknown tag."""
    chart = chart_of(lambda ax: line_with_band(ax, *np.ones((3, 2)), "k", label="T<i>1 & 2"))
    assert {trace["name"] for trace in chart["data"]} == {"T&lt;i&gt;1 &amp; 2"}


def test_artist_without_a_counterpart_is_named() -> None:
    with pytest.raises(NotConvertible, match="AxesImage"):
        chart_of(lambda ax: ax.imshow(np.eye(3)))


def test_decimated_trace_keeps_extremes_and_gaps() -> None:
    """Not every n-th row: a spike of one row among 10^5, and a gap, are still there."""
    y = np.sin(np.arange(100_000) / 5000)
    y[12_345] = 9.0
    y[60_000:70_000] = np.nan
    y[::101] = np.nan  # single rows without a value
    rows = screen_rows(y, 1000)
    assert len(rows) == 1000
    assert np.all(np.diff(rows) > 0)
    assert 12_345 in rows
    in_gap = (rows >= 60_000) & (rows < 70_000)
    assert in_gap.any()
    assert np.isfinite(y[rows[~in_gap]]).mean() > 0.99
    assert screen_rows(y[:7]).tolist() == list(range(7))
