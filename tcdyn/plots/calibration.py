"""Pictures of a calibration: error histograms, residuals against temperature, transducer sessions, lags."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from calibration.bearing import BearingFriction
from calibration.oven import error_histogram
from calibration.record import ChainRecord
from calibration.static import OvenFit, static_u
from calibration.transducers import TransducerLine

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def draw_error_histogram(errors_K: ArrayLike, ax: Axes, *, label: str = "", width_K: float = 0.1) -> Axes:
    """Figure 2.16: how often each error (thermocouple minus PRT) came, bins of ``width_K``."""
    counts, edges = error_histogram(errors_K, width_K)
    ax.bar(edges[:-1], counts, width=np.diff(edges), align="edge", edgecolor="white", label=label or None)
    ax.axvline(0.0, color="0.3", linewidth=0.8)
    ax.set_xlabel("thermocouple minus PRT [K]")
    ax.set_ylabel("count")
    return ax


def draw_residuals(oven: OvenFit, ax: Axes) -> Axes:
    """Residuals of every channel against the PRT, with the 95 % band of the line for the first channel."""
    table = oven.residuals
    for channel in oven.lines:
        ax.plot(table["prt_degC"], table[f"{channel}_degC"], "o", markersize=3, label=channel)
    line = next(iter(oven.lines.values()))
    t = np.linspace(*line.range_degC, 100)
    band = 1.96 * static_u(line, t)
    ax.fill_between(t, -band, band, color="0.85", zorder=0, label="95 % of a line")
    ax.axhline(0.0, color="0.3", linewidth=0.8)
    ax.set_xlabel("PRT [degC]")
    ax.set_ylabel("PRT minus line [K]")
    ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize="small")
    return ax


def draw_transducer(line: TransducerLine, volts: ArrayLike, force_N: ArrayLike, session: ArrayLike, ax: Axes) -> Axes:
    """Figure 2.21: force against volts, one line a session, one slope for all."""
    v, f, s = np.asarray(volts, dtype=float), np.asarray(force_N, dtype=float), np.asarray(session).astype(str)
    for name, intercept in line.intercept_N.items():
        here = s == name
        dots = ax.plot(v[here], f[here], "o", markersize=4, label=name)[0]
        ends = np.array([v[here].min(), v[here].max()])
        ax.plot(ends, line.slope_N_V.value * ends + intercept.value, color=dots.get_color(), linewidth=1)
    ax.set_xlabel("transducer [V]")
    ax.set_ylabel("force [N]")
    ax.legend(title="session", fontsize="small")
    return ax


def draw_bearing(bearing: BearingFriction, ax: Axes) -> Axes:
    """Figure 2.25: measured bearing friction of both shafts against load, one line a speed."""
    for speed, line in zip(bearing.speeds_rpm, bearing.lines):
        dots = ax.plot(line.x, line.y, "o", markersize=4, label=f"{speed:.0f} rpm")[0]
        ends = np.array([line.x.min(), line.x.max()])
        ax.plot(ends, line.slope * ends + line.intercept, color=dots.get_color(), linewidth=1)
    ax.set_xlabel("load [N]")
    ax.set_ylabel("bearing friction, both shafts [N]")
    ax.legend(title="slow shaft", fontsize="small")
    return ax


def draw_lags(chain: ChainRecord, ax: Axes) -> Axes:
    """Each channel's lag with its 95 % interval (thin) and with that of its difference from the common lag (thick)."""
    names = sorted(chain.channels)
    for i, name in enumerate(names):
        lag, apart = chain.channels[name].lag_s, chain.differential_lag_s[name]
        common = chain.common_lag_s.value
        ax.plot([i, i], [lag.low95, lag.high95], color="0.6", linewidth=1)
        ax.plot([i, i], [common + apart.low95, common + apart.high95], color="C0", linewidth=4)
        ax.plot(i, lag.value, "o", color="C3", markersize=4)
    ax.axhline(chain.common_lag_s.value, color="0.3", linewidth=0.8)
    ax.set_xticks(range(len(names)), names)
    ax.set_xlabel("channel")
    ax.set_ylabel("lag [s]")
    return ax


def oven_figure(oven: OvenFit) -> Figure:
    """Raw and calibrated histograms above, residuals below."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 6.0), layout="constrained")
    grid = figure.subplot_mosaic([["raw", "after"], ["rest", "rest"]])
    draw_error_histogram(oven.raw_errors_K, grid["raw"]).set_title("raw")
    draw_error_histogram(oven.calibrated_errors_K, grid["after"], width_K=0.05).set_title("with the static lines")
    draw_residuals(oven, grid["rest"])
    return figure


def lag_figure(chain: ChainRecord) -> Figure:
    """The lags of one disk."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.0, 3.5), layout="constrained")
    draw_lags(chain, figure.subplots())
    return figure
