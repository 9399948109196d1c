"""Pictures of an identification: fit, step response and Bode diagram with their bands, residual tests."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.special import chdtri

from tcdyn.identify.identified import Identified
from tcdyn.identify.iodata import IOData
from tcdyn.identify.responses import Band, bode_band, percent_times, roots_of, step_band
from tcdyn.identify.search import Fit
from tcdyn.identify.validate import ResidualTest, Validation
from tcdyn.plots.style import BAND, DARK, FAST, GREY, PALE, SLOW, TRUTH, dressed, figure, pictured

LEAST_P = 1e-12  # less is not told apart
INPUTS = (FAST, TRUTH, DARK, GREY)
OUTPUTS = (SLOW, GREY, DARK, TRUTH)


def label(name: str, unit: str) -> str:
    """Axis label with its unit."""
    return f"{name} [{unit}]" if unit else name


def draw_fit(fit: Fit, ax: Axes, segment: int = 0) -> Axes:
    """Measured input and output with the simulated output of one stretch of data."""
    s = fit.problem.segments[segment]
    model = fit.identified
    t = s.start_s + np.arange(len(s.u)) * fit.problem.dt_s
    ax.plot(t, s.y, ".", markersize=2.5, color=GREY, label=f"{model.output_name} measured")
    ax.plot(
        t,
        fit.simulated()[segment],
        color=TRUTH,
        linewidth=1.3,
        label=f"{model.model.name} simulated",
    )
    style = _dashed(fit.problem.hold)
    twin = ax.twinx()
    for u, width in zip(s.inputs.T, (0.8, 1.4, 0.5, 2.0) * s.inputs.shape[1]):
        twin.plot(t, u, color=FAST, **{**style, "linewidth": width})
    ax.plot([], [], color=FAST, label=f"{model.input_name}, right axis", **style)
    twin.set_ylabel(f"{label(model.input_name, model.input_unit)} (dashed)", color=FAST)
    head = f"fit {model.statistics['fit_percent']:.2f} %"
    ax.set_title(
        head, loc="left", fontsize="medium"
    )  # over the power of ten of an axis of any unit
    return dressed(ax, "time [s]", label(model.output_name, model.output_unit), loc="best")


def _dashed(hold: str) -> dict[str, Any]:
    """How an input is drawn behind the output, with steps where it is held."""
    style = "steps-post" if hold == "zoh" else "default"
    return {"linewidth": 0.8, "linestyle": (0, (4, 1)), "drawstyle": style, "zorder": 0}


def draw_data(data: IOData, ax: Axes, run: int = 0) -> Axes:
    """The outputs of one run as points, its inputs dashed over the right axis."""
    t = data.times_s(run)
    one = data.runs[run]
    style = _dashed(data.hold)
    twin = ax.twinx()
    for k, (name, u) in enumerate(zip(data.input_names, one.u.T)):
        colour = INPUTS[k % len(INPUTS)]
        twin.plot(t, u, color=colour, **style)
        ax.plot([], [], color=colour, label=f"{name}, right axis", **style)
    for k, (name, y) in enumerate(zip(data.output_names, one.y.T)):
        ax.plot(t, y, ".", markersize=2.5, color=OUTPUTS[k % len(OUTPUTS)], label=name)
    twin.set_ylabel(", ".join(label(*both) for both in zip(data.input_names, data.input_units)))
    names = ", ".join(label(*both) for both in zip(data.output_names, data.output_units))
    return dressed(ax, "time [s]", names, loc="best")


def draw_poles(model: Identified, ax: Axes) -> Axes:
    """Poles (crosses) and zeros (rings) of what was identified, with their 95 % regions."""
    turn = np.linspace(0, 2 * np.pi, 60)
    for k, (name, part) in enumerate(model.parts.items()):
        colour = INPUTS[k % len(INPUTS)]
        for r in roots_of(part) if part.gain else ():
            mark = (
                {"marker": "x"} if r.kind == "pole" else {"marker": "o", "markerfacecolor": "none"}
            )
            ax.plot([r.value.real], [r.value.imag], color=colour, linestyle="none", **mark)  # type: ignore[arg-type]
            size, axes = np.linalg.eigh(r.covariance)
            free = (
                np.sum(size > 1e-9 * size[-1]) if size[-1] > 0 else 1
            )  # a real root moves along its axis alone
            reach = np.sqrt(np.maximum(size, 0) * chdtri(free, 0.05))
            round_ = axes @ (reach[:, None] * [np.cos(turn), np.sin(turn)])
            ax.plot(r.value.real + round_[0], r.value.imag + round_[1], color=colour, linewidth=0.9)
        ax.plot([], [], "x", color=colour, label=name)
    ax.axhline(0.0, color=DARK, linewidth=0.6)
    ax.axvline(0.0, color=DARK, linewidth=0.6)
    return dressed(ax, "real part [1/s]", "imaginary part [1/s]", legend=len(model.parts) > 1)


def draw_band(band: Band, ax: Axes) -> Axes:
    """A curve and its 95 % band."""
    ax.plot(band.x, band.value, color=SLOW, linewidth=1.3)
    ax.fill_between(band.x, band.low95, band.high95, color=SLOW, alpha=BAND, linewidth=0)
    return ax


def draw_step(model: Identified, ax: Axes) -> Axes:
    """Unit step response with its 95 % band and the percent times."""
    draw_band(step_band(model), ax)
    if not model.model.integrators:
        for (name, time), share in zip(percent_times(model).items(), (0.5, 1 - np.exp(-1), 0.9)):
            ax.plot([time.value], [share * model.gain], "o", color=FAST, markersize=4)
            ax.annotate(
                f" {name} = {time.text('s').replace('+-', '±')}",
                (time.value, share * model.gain),
                fontsize=8,
                va="top",
                xytext=(4, -2),
                textcoords="offset points",
            )
    return dressed(ax, "time after a unit step [s]", label(model.output_name, model.output_unit))


def draw_bode(model: Identified, magnitude: Axes, phase: Axes) -> tuple[Axes, Axes]:
    """Magnitude and phase with their 95 % bands."""
    bode = bode_band(model)
    draw_band(bode.magnitude_dB, magnitude)
    draw_band(bode.phase_deg, phase)
    for ax, y in ((magnitude, "magnitude [dB]"), (phase, "phase [deg]")):
        dressed(ax, "frequency [Hz]", y).set_xscale("log")
        ax.grid(True, which="both", alpha=0.25)
    return magnitude, phase


def draw_correlation(c: ResidualTest, ax: Axes, title: str) -> Axes:
    """Correlations as stems over the 95 % bound of each."""
    order = np.argsort(c.lags_s)
    ax.fill_between(
        c.lags_s[order], -c.bound95[order], c.bound95[order], color=PALE, label="95 % of each lag"
    )
    ax.vlines(c.lags_s, 0.0, c.value, color=SLOW)
    ax.plot(c.lags_s, c.value, "o", color=SLOW, markersize=3)
    ax.axhline(0.0, color=DARK, linewidth=0.8)
    head = f"{title}: p {f'= {c.p:.2g}' if c.p > LEAST_P else f'below {LEAST_P:g}'}"
    return dressed(ax, "lag [s]", "", head=head)


def draw_residuals(fit: Fit, ax: Axes) -> Axes:
    """Residuals in the order of the record."""
    ax.plot(fit.residual, ".", markersize=2.5, color=DARK)
    ax.axhline(0.0, color=SLOW, linewidth=0.8)
    return dressed(ax, "measured sample", label("residual", fit.identified.output_unit))


def fit_figure(fit: Fit) -> Figure:
    """Every stretch of data (at most four) under its simulation."""
    count = min(4, len(fit.problem.segments))
    return pictured(
        *(partial(draw_fit, fit, segment=k) for k in range(count)),
        rows=count,
        height_in=3.0 * count,
    )


def dynamics_figure(model: Identified) -> Figure:
    """Step response, Bode diagram, poles and zeros, two rows for each input that matters."""
    parts = {name: part for name, part in model.parts.items() if part.gain}
    fig, axes = figure(2 * len(parts), 2, 9.0, 6.0 * len(parts))
    for row, (name, part) in enumerate(parts.items()):
        draw_step(part, axes[4 * row])
        draw_bode(part, axes[4 * row + 1], axes[4 * row + 2])
        draw_poles(part, axes[4 * row + 3])
        if len(model.parts) > 1:
            axes[4 * row].set_title(f"from {name}: {part.model.name}")
    return fig


def residual_figure(fit: Fit, v: Validation) -> Figure:
    """Residuals, their autocorrelation and their correlation with the input."""
    draws = (
        partial(draw_residuals, fit),
        partial(draw_correlation, v.whiteness, title="residual autocorrelation"),
        partial(draw_correlation, v.input, title="residual and input"),
    )
    return pictured(*draws, width_in=10.0, height_in=3.2)
