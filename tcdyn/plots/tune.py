"""Figure of settings of a controller: output and controller output after a set point and a load.

Used by ``tcdyn tune --picture`` and by :func:`tcdyn.plots.pick.draw`. Test:
``tests/tuning/test_tune_command.py``.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tcdyn.core import Array
from tcdyn.plots.style import (
    BAND_ALPHA,
    DARK,
    FAST,
    SLOW,
    axes_of,
    panel_figure,
    style_axes,
)
from tcdyn.tuning import Tuning

# Range of the axis over that of the model's response: bands of unstable draws are cut off. Chosen
# by judgement.
AXIS_RATIO = 3.0
SHOWN_RATIO = 2.0  # of the settling time, which is shown; chosen by judgement
LOW, HIGH = 0.025, 0.975  # quantiles of the 95 % band


def draw_tuning(tuning: Tuning, ax: Axes | None = None, quantity: str = "output") -> Axes:
    """Plot the output, or the controller output, after a unit step of set point and of load.

    Parameters
    ----------
    tuning
        The settings.
    ax
        Axes to plot into; None: those of a new figure.
    quantity
        "output", or "input": the controller output.

    Returns
    -------
    ax
        The same axes.

    Notes
    -----
    The response to the load is in output units per unit of the input, scaled to the largest
    deviation of one, so that both are seen. The legend has the factor.
    """
    ax = axes_of(ax)
    responses = tuning.responses
    plant = tuning.plant
    time_s = responses.time_s
    if quantity == "output":
        ax.axhline(1.0, color=DARK, linewidth=0.8)
        peak = float(np.max(np.abs(responses.load[0]))) or 1.0
        unit = plant.unit_of_output
        curves = [
            (responses.setpoint, SLOW, f"set point +1 {unit}"),
            (
                responses.load / peak,
                FAST,
                f"load +1 {plant.unit_of_input}, divided by {peak:.3g} {unit}",
            ),
        ]
        y = f"change of {plant.output_name} [{unit}]"
    else:
        curves = [
            (responses.setpoint_input, SLOW, f"set point +1 {plant.unit_of_output}"),
            (responses.load_input, FAST, f"load +1 {plant.unit_of_input}"),
        ]
        y = f"change of {plant.input_name} [{plant.unit_of_input}]"
    ends = []
    for values, colour, text in curves:
        _draw_curve(ax, time_s, values, colour, text)
        ends += [float(values[0].min()), float(values[0].max())]
    low, high = min(ends), max(ends)
    middle, half = (low + high) / 2, AXIS_RATIO * (high - low) / 2
    bottom, top = ax.get_ylim()
    ax.set_ylim(max(bottom, middle - half), min(top, middle + half))
    settled_s = tuning.times["settling_s"].value
    if np.isfinite(settled_s):
        ax.set_xlim(0.0, min(float(time_s[-1]), SHOWN_RATIO * settled_s))
    legend: dict[str, Any] = {"loc": "best"}
    if plant.draws:
        legend["legend_title"] = "bands: 95 % of the draws"
    return style_axes(ax, "time after the step [s]", y, **legend)


def _draw_curve(ax: Axes, time_s: Array, values: Array, colour: str, text: str) -> None:
    """Plot a response with the model, and the 95 % band of the draws.

    Parameters
    ----------
    ax
        Axes to plot into.
    time_s
        Times (N,) [s].
    values
        Responses (1 + D, N), that of the model first.
    colour, text
        Colour, and text of the legend.
    """
    if len(values) > 1:
        low, high = np.quantile(values[1:], (LOW, HIGH), axis=0)
        ax.fill_between(time_s, low, high, color=colour, alpha=BAND_ALPHA, linewidth=0)
    ax.plot(time_s, values[0], color=colour, linewidth=1.4, label=text)


def tuning_figure(tuning: Tuning) -> Figure:
    """Output and controller output, one above the other.

    Parameters
    ----------
    tuning
        The settings.
    """
    panels = [partial(draw_tuning, tuning, quantity=name) for name in ("output", "input")]
    figure = panel_figure(*panels, rows=2, width_in=8.0, height_in=6.0)
    figure.axes[0].set_title(tuning.headline(), loc="left", fontsize="medium")
    return figure
