"""Figures of an identified model: fit, step response, Bode diagram, residual tests.

Used by the page of ``tcdyn identify`` (:mod:`tcdyn.report.dynamics`) and by
:func:`tcdyn.plots.pick.draw`. Tests: ``tests/report/test_dynamics_page.py`` and
``tests/identify/test_identify_several.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.special import chdtri

from tcdyn.identification.identified import Identified
from tcdyn.identification.iodata import IOData
from tcdyn.identification.responses import (
    PERCENT_TIMES,
    Band,
    BodeBand,
    Root,
    bode_band,
    percent_times,
    roots_of,
    step_band,
)
from tcdyn.identification.search import Fit
from tcdyn.identification.validation import ResidualTest, Validation
from tcdyn.plots.style import (
    BAND_ALPHA,
    DARK,
    FAST,
    GREY,
    PALE,
    SLOW,
    TRUTH,
    axes_of,
    figure,
    log_axis,
    panel_figure,
    style_axes,
)

MIN_P = 1e-12  # p-values below this are printed as "below 1e-12"; chosen by judgement
MAX_SEGMENTS = 4  # segments that the figure of the fit shows; chosen by judgement
COVERAGE_TAIL = 0.05  # probability outside the 95 % region of a pole or zero
# Colours of the inputs and of the outputs, in the order of the data.
INPUT_COLOURS = (FAST, TRUTH, DARK, GREY)
OUTPUT_COLOURS = (SLOW, GREY, DARK, TRUTH)


def label(name: str, unit: str) -> str:
    """Return the axis label of a quantity with its unit.

    Parameters
    ----------
    name
        Name of the quantity.
    unit
        Its unit; empty: none.
    """
    return f"{name} [{unit}]" if unit else name


def _joined_label(names: Sequence[str], units: Sequence[str]) -> str:
    """Return the axis label of several quantities with their units.

    Parameters
    ----------
    names, units
        Names and units of the quantities (M each).
    """
    return ", ".join(label(name, unit) for name, unit in zip(names, units))


def draw_fit(fit: Fit, ax: Axes | None = None, segment: int = 0) -> Axes:
    """Plot the measured input and output and the simulated output of one segment of the data.

    Parameters
    ----------
    fit
        Fit of one model.
    ax
        Axes to plot into; None: those of a new figure.
    segment
        Index of the segment.

    Returns
    -------
    ax
        The same axes.
    """
    ax = axes_of(ax)
    data = fit.problem.segments[segment]
    model = fit.identified
    t = data.start_s + np.arange(len(data.u)) * fit.problem.dt_s
    measured = f"{model.output_name} measured"
    ax.plot(t, data.y, ".", markersize=2.5, color=GREY, label=measured)
    simulated = f"{model.model.name} simulated"
    ax.plot(t, fit.simulate_segments()[segment], color=TRUTH, linewidth=1.3, label=simulated)

    input_axis = ax.twinx()
    widths = (0.8, 1.4, 0.5, 2.0)
    for k, u in enumerate(data.inputs.T):
        style = _input_style(fit.problem.holds[k])
        input_axis.plot(t, u, color=FAST, **style, linewidth=widths[k % len(widths)])
    legend_label = f"{model.input_name}, right axis"
    ax.plot([], [], color=FAST, label=legend_label, **style, linewidth=widths[0])
    input_label = label(model.input_name, model.input_unit)
    input_axis.set_ylabel(f"{input_label} (dashed)", color=FAST)

    title = f"fit {model.statistics['fit_percent']:.2f} %"
    y = label(model.output_name, model.output_unit)
    return style_axes(ax, "time [s]", y, title=title, loc="best")


def _input_style(hold: str) -> dict[str, Any]:
    """Return the line style of an input: dashed, and in steps for a zero-order hold.

    Parameters
    ----------
    hold
        "zoh" or another assumption about the input between samples.
    """
    drawstyle = "steps-post" if hold == "zoh" else "default"
    return {"linestyle": (0, (4, 1)), "drawstyle": drawstyle, "zorder": 0}


def draw_data(data: IOData, ax: Axes | None = None, run: int = 0) -> Axes:
    """Plot the outputs of one run as points, and its inputs dashed over the right axis.

    Parameters
    ----------
    data
        Records of inputs and outputs.
    ax
        Axes to plot into; None: those of a new figure.
    run
        Index of the record.

    Returns
    -------
    ax
        The same axes.
    """
    ax = axes_of(ax)
    t = data.times_s(run)
    record = data.runs[run]
    input_axis = ax.twinx()
    for k, (name, u) in enumerate(zip(data.input_names, record.u.T)):
        colour = INPUT_COLOURS[k % len(INPUT_COLOURS)]
        style = _input_style(data.holds[k])
        input_axis.plot(t, u, color=colour, **style, linewidth=0.8)
        ax.plot([], [], color=colour, label=f"{name}, right axis", **style, linewidth=0.8)
    for k, (name, y) in enumerate(zip(data.output_names, record.y.T)):
        colour = OUTPUT_COLOURS[k % len(OUTPUT_COLOURS)]
        ax.plot(t, y, ".", markersize=2.5, color=colour, label=name)
    input_axis.set_ylabel(_joined_label(data.input_names, data.input_units))
    output_label = _joined_label(data.output_names, data.output_units)
    return style_axes(ax, "time [s]", output_label, loc="best")


def draw_poles(model: Identified, ax: Axes | None = None) -> Axes:
    """Plot poles (crosses) and zeros (rings) of a model with their 95 % regions.

    Parameters
    ----------
    model
        An identified model.
    ax
        Axes to plot into; None: those of a new figure.

    Returns
    -------
    ax
        The same axes.
    """
    ax = axes_of(ax)
    for k, (name, part) in enumerate(model.by_input.items()):
        colour = INPUT_COLOURS[k % len(INPUT_COLOURS)]
        roots = roots_of(part) if part.gain else ()
        for root in roots:
            _draw_root(root, colour, ax)
        ax.plot([], [], "x", color=colour, label=name)
    ax.axhline(0.0, color=DARK, linewidth=0.6)
    ax.axvline(0.0, color=DARK, linewidth=0.6)
    return style_axes(ax, "real part [1/s]", "imaginary part [1/s]", legend=len(model.by_input) > 1)


def _draw_root(root: Root, colour: str, ax: Axes) -> None:
    """Plot one pole or zero with the ellipse of its 95 % region.

    A real root has a covariance of rank one; its region is a line with one degree of freedom.

    Parameters
    ----------
    root
        The pole or zero with its covariance.
    colour
        Colour of marker and ellipse.
    ax
        Axes to plot into.

    Notes
    -----
    The region is the ellipse z' C^-1 z = chi-square quantile of two degrees of freedom, one for a
    covariance of rank one. Rank one: the smaller eigenvalue is below 1e-9 of the larger.
    """
    marker: dict[str, Any] = {"marker": "x"}
    if root.kind != "pole":
        marker = {"marker": "o", "markerfacecolor": "none"}
    re = root.value.real
    im = root.value.imag
    ax.plot([re], [im], color=colour, linestyle="none", **marker)
    variance, axes = np.linalg.eigh(root.covariance)
    dof = 1
    if variance[-1] > 0:
        dof = int(np.sum(variance > 1e-9 * variance[-1]))
    semi_axes = np.sqrt(np.maximum(variance, 0) * chdtri(dof, COVERAGE_TAIL))
    angle = np.linspace(0, 2 * np.pi, 60)
    ellipse = axes @ (semi_axes[:, None] * [np.cos(angle), np.sin(angle)])
    ax.plot(re + ellipse[0], im + ellipse[1], color=colour, linewidth=0.9)


def draw_band(band: Band, ax: Axes | None = None) -> Axes:
    """Plot a curve and its 95 % band.

    Parameters
    ----------
    band
        The curve.
    ax
        Axes to plot into; None: those of a new figure.

    Returns
    -------
    ax
        The same axes.
    """
    ax = axes_of(ax)
    ax.plot(band.x, band.value, color=SLOW, linewidth=1.3)
    ax.fill_between(band.x, band.low95, band.high95, color=SLOW, alpha=BAND_ALPHA, linewidth=0)
    return ax


def draw_step(model: Identified, ax: Axes | None = None) -> Axes:
    """Plot the unit step response with its 95 % band and the times to 50, 63 and 90 %.

    Parameters
    ----------
    model
        An identified model with one input.
    ax
        Axes to plot into; None: those of a new figure.

    Returns
    -------
    ax
        The same axes.
    """
    ax = axes_of(ax)
    draw_band(step_band(model), ax)
    if not model.model.integrators:
        offset: dict[str, Any] = {"xytext": (4, -2), "textcoords": "offset points"}
        for name, time in percent_times(model).items():
            position = (time.value, PERCENT_TIMES[name] * model.gain)
            ax.plot(*position, "o", color=FAST, markersize=4)
            text = f" {name} = {time.text('s').replace('+-', '±')}"
            ax.annotate(text, position, fontsize=8, va="top", **offset)
    y = label(model.output_name, model.output_unit)
    return style_axes(ax, "time after a unit step [s]", y)


def draw_bode(
    model: Identified | BodeBand, magnitude: Axes | None = None, phase: Axes | None = None
) -> tuple[Axes, Axes]:
    """Plot magnitude and phase with their 95 % bands.

    Parameters
    ----------
    model
        An identified model with one input, or its :func:`~tcdyn.identification.bode_band`.
    magnitude, phase
        Axes to plot into; None: those of a new figure.

    Returns
    -------
    magnitude, phase
        The same axes.
    """
    if magnitude is None or phase is None:
        magnitude, phase = figure(2)[1]
    bode = model if isinstance(model, BodeBand) else bode_band(model)
    draw_band(bode.magnitude_dB, magnitude)
    draw_band(bode.phase_deg, phase)
    for ax, y in ((magnitude, "magnitude [dB]"), (phase, "phase [deg]")):
        log_axis(style_axes(ax, "frequency [Hz]", y), "x")
    return magnitude, phase


def draw_correlation(test: ResidualTest, ax: Axes | None = None, title: str = "") -> Axes:
    """Plot the correlations of a residual test over lag, with their 95 % bounds.

    Parameters
    ----------
    test
        Correlations with their bounds.
    ax
        Axes to plot into; None: those of a new figure.
    title
        Title, in front of the p-value.

    Returns
    -------
    ax
        The same axes.
    """
    ax = axes_of(ax)
    order = np.argsort(test.lags_s)
    bound = test.bound95[order]
    ax.fill_between(test.lags_s[order], -bound, bound, color=PALE, label="95 % of each lag")
    ax.vlines(test.lags_s, 0.0, test.value, color=SLOW)
    ax.plot(test.lags_s, test.value, "o", color=SLOW, markersize=3)
    ax.axhline(0.0, color=DARK, linewidth=0.8)
    p = f"= {test.p:.2g}" if test.p > MIN_P else f"below {MIN_P:g}"
    return style_axes(ax, "lag [s]", "", title=f"{title}: p {p}" if title else f"p {p}")


def draw_residuals(fit: Fit, ax: Axes | None = None) -> Axes:
    """Plot the residuals in the order of the record.

    Parameters
    ----------
    fit
        Fit of one model.
    ax
        Axes to plot into; None: those of a new figure.

    Returns
    -------
    ax
        The same axes.
    """
    ax = axes_of(ax)
    ax.plot(fit.residual, ".", markersize=2.5, color=DARK)
    ax.axhline(0.0, color=SLOW, linewidth=0.8)
    return style_axes(ax, "measured sample", label("residual", fit.identified.output_unit))


def fit_figure(fit: Fit) -> Figure:
    """Return the figure of the fit: one panel for each segment, the first ``MAX_SEGMENTS``.

    Parameters
    ----------
    fit
        Fit of one model.
    """
    n_segments = min(MAX_SEGMENTS, len(fit.problem.segments))
    panels = [partial(draw_fit, fit, segment=k) for k in range(n_segments)]
    return panel_figure(*panels, rows=n_segments, height_in=3.0 * n_segments)


def dynamics_figure(model: Identified) -> Figure:
    """Return step response, Bode diagram, poles and zeros: two rows for each input with a gain."""
    parts = {name: part for name, part in model.by_input.items() if part.gain}
    fig, axes = figure(2 * len(parts), 2, 9.0, 6.0 * len(parts))
    for k, (name, part) in enumerate(parts.items()):
        step, magnitude, phase, roots = axes[4 * k : 4 * k + 4]
        draw_step(part, step)
        draw_bode(part, magnitude, phase)
        draw_poles(part, roots)
        if len(model.by_input) > 1:
            step.set_title(f"from {name}: {part.model.name}")
    return fig


def residual_figure(fit: Fit, validation: Validation) -> Figure:
    """Return the residuals, their autocorrelation, and their correlation with the input.

    Parameters
    ----------
    fit
        Fit of one model.
    validation
        Residual tests of that fit.
    """
    panels = (
        partial(draw_residuals, fit),
        partial(draw_correlation, validation.whiteness, title="residual autocorrelation"),
        partial(draw_correlation, validation.input, title="residual and input"),
    )
    return panel_figure(*panels, width_in=10.0, height_in=3.2)
