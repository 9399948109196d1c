"""Pictures of what goes in: a log as read, errors and residuals of an oven, transducers, chains and lags."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike

from calibration.static_lines import OvenFit, error_histogram
from calibration.transducers import BearingFriction, TransducerLine
from immersion.plunge_result import LagShare
from tcdyn.chain import Chain
from tcdyn.plots.style import (
    DARK,
    GREY,
    PALE,
    SERIES_LINES,
    SERIES_MARKERS,
    SLOW,
    TRUTH,
    dressed,
    figure,
    thinned,
)
from tcdyn.rig.log import COMPENSATED, Log
from tcdyn.rig.record import ChainRecord
from tcdyn.rig.static_line import static_u

LEAST_BINS = 12


def bin_width(errors_K: ArrayLike) -> float:
    """The widest of 0.5, 0.2, 0.1, 0.05 .. K that divides the errors' range into ``LEAST_BINS`` bins or more.

    >>> bin_width([-0.1, 0.0, 0.1]), bin_width([-1.0, 1.5])
    (0.01, 0.2)
    """
    e = np.asarray(errors_K, dtype=float)
    span = float(np.nanmax(e) - np.nanmin(e)) if e.size else 0.0
    if not span > 0.0:
        return 0.1
    power = 10.0 ** np.floor(np.log10(span / LEAST_BINS))
    return float(
        round(power * max(k for k in (1, 2, 5) if k * power <= span / LEAST_BINS * (1 + 1e-9)), 12)
    )


def draw_error_histogram(
    errors_K: ArrayLike, ax: Axes, *, label: str = "", width_K: float | None = None
) -> Axes:
    """Figure 2.16: how often each error (thermocouple minus PRT) came, bins of ``width_K``, or of a width that suits.

    The dashed lines hold 95 % of the errors between them.
    """
    e = np.asarray(errors_K, dtype=float)
    width = bin_width(e) if width_K is None else width_K
    counts, edges = error_histogram(e, width)
    ax.bar(
        edges[:-1],
        counts,
        width=np.diff(edges),
        align="edge",
        color=SLOW,
        edgecolor="white",
        label=label or None,
    )
    ax.axvline(0.0, color=TRUTH, linewidth=0.8)
    for end in np.nanquantile(e, [0.025, 0.975]):
        ax.axvline(end, color=TRUTH, linewidth=0.9, linestyle="--")
    ax.yaxis.set_major_locator(MaxNLocator(integer=True))
    return dressed(ax, "thermocouple minus PRT [K]", f"errors per {width:g} K")


def draw_residuals(oven: OvenFit, ax: Axes) -> Axes:
    """Residuals of every channel against the PRT, channels side by side, with the 95 % band of one line."""
    table = oven.residuals
    prt = table["prt_degC"].to_numpy(dtype=float)
    apart = 0.006 * (prt.max() - prt.min())
    middle = (len(oven.lines) - 1) / 2
    for k, channel in enumerate(oven.lines):
        tone = str(0.6 * k / max(len(oven.lines) - 1, 1))
        where = prt + apart * (k - middle)
        ax.plot(
            where,
            table[f"{channel}_degC"],
            SERIES_MARKERS[k % 6],
            markersize=4,
            color=tone,
            mfc="none",
            label=channel,
        )
    line = next(iter(oven.lines.values()))
    t = np.linspace(*line.range_degC, 100)
    band = 1.96 * static_u(line, t)
    ax.fill_between(t, -band, band, color=PALE, zorder=0, label="95 % of a line")
    ax.axhline(0.0, color=TRUTH, linewidth=0.8)
    return dressed(
        ax,
        "PRT [°C]",
        "PRT minus line [K]",
        ncols=7,
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        columnspacing=1.0,
    )


def draw_transducer(
    line: TransducerLine, volts: ArrayLike, force_N: ArrayLike, session: ArrayLike, ax: Axes
) -> Axes:
    """Figure 2.21: force against volts, one line a session, one slope for all."""
    v = np.asarray(volts, dtype=float)
    f = np.asarray(force_N, dtype=float)
    s = np.asarray(session).astype(str)
    for name, intercept in line.intercept_N.items():
        here = s == name
        dots = ax.plot(v[here], f[here], "o", markersize=4, label=name)[0]
        ends = np.array([v[here].min(), v[here].max()])
        ax.plot(
            ends, line.slope_N_V.value * ends + intercept.value, color=dots.get_color(), linewidth=1
        )
    return dressed(ax, "transducer [V]", "force [N]", title="session")


def draw_bearing(bearing: BearingFriction, ax: Axes) -> Axes:
    """Figure 2.25: measured bearing friction of both shafts against load, one line a speed."""
    for speed, line in zip(bearing.speeds_rpm, bearing.lines):
        dots = ax.plot(line.x, line.y, "o", markersize=4, label=f"{speed:.0f} rpm")[0]
        ends = np.array([line.x.min(), line.x.max()])
        ax.plot(ends, line.slope * ends + line.intercept, color=dots.get_color(), linewidth=1)
    return dressed(ax, "load [N]", "bearing friction, both shafts [N]", title="slow shaft")


def draw_lags(chain: ChainRecord, ax: Axes) -> Axes:
    """Each channel's lag with its 95 % interval (thin) and with that of its difference from the common lag (thick)."""
    names = sorted(chain.channels)
    common = chain.common_lag_s
    ax.axhspan(common.low95, common.high95, color=PALE, zorder=0, label="common lag, 95 %")
    ax.axhline(common.value, color=TRUTH, linewidth=0.8)
    for i, name in enumerate(names):
        lag = chain.channels[name].lag_s
        apart = chain.differential_lag_s[name]
        ax.plot(
            [i, i],
            [lag.low95, lag.high95],
            color=GREY,
            linewidth=1.2,
            label="lag, 95 %" if i == 0 else None,
        )
        told = "its difference from the common lag, 95 %" if i == 0 else None
        ends = [common.value + apart.low95, common.value + apart.high95]
        ax.plot([i, i], ends, color=SLOW, linewidth=5, solid_capstyle="butt", label=told)
        ax.plot(i, lag.value, "o", color="white", markeredgecolor=TRUTH, markersize=5)
    ax.set_xticks(range(len(names)), names)
    ax.set_xlim(-0.6, len(names) - 0.4)
    return dressed(ax, "channel", "lag [s]", ncols=3, loc="lower left", bbox_to_anchor=(0.0, 1.0))


def draw_lag_budget(shares: Sequence[LagShare], ax: Axes) -> Axes:
    """What each source adds to the uncertainty of the common lag and of the differences, the largest on top [s]."""
    ordered = sorted(shares, key=lambda s: s.u_common_s)
    y = np.arange(len(ordered))
    common = [s.u_common_s for s in ordered]
    rest = [s.u_differential_s for s in ordered]
    ax.barh(y + 0.19, common, 0.36, color=SLOW, label="common lag")
    ax.barh(
        y - 0.19,
        rest,
        0.36,
        color="white",
        edgecolor=TRUTH,
        hatch="////",
        label="differences of channels",
    )
    right = max([*common, *rest, 1e-6])
    for k, pair in enumerate(zip(common, rest)):
        for value, up in zip(pair, (0.19, -0.19)):
            ax.text(value + 0.01 * right, k + up, f"{value:.3f}", va="center", fontsize=7)
    ax.set_yticks(y, [s.source for s in ordered])
    ax.set_xlim(0, 1.1 * right)
    dressed(ax, "standard uncertainty [s]", "", loc="lower right").grid(False, axis="y")
    return ax


def error_figure(oven: OvenFit) -> Figure:
    """Errors of all channels, raw and with the static lines."""
    picture, axes = figure(1, 2, height_in=3.0)
    for ax, errors, when in zip(
        axes, (oven.raw_errors_K, oven.calibrated_errors_K), ("as logged", "with the static lines")
    ):
        largest = float(np.nanmax(np.abs(errors)))
        draw_error_histogram(errors, ax).set_title(
            f"{when}: at most {largest:.2g} K", fontsize="medium"
        )
    return picture


def draw_log(log: Log, ax: Axes) -> Axes:
    """Every thermocouple of a log against time, or against the PRT for an oven log."""
    shown = log.frame.iloc[thinned(len(log.frame))]
    oven = log.kind == "oven"
    x = shown["prt_degC" if oven else "time_s"]
    for k, name in enumerate(log.channels):
        y, line = (
            (shown[name] - x, "o")
            if oven
            else (shown[name], SERIES_LINES[(k // 6) % len(SERIES_LINES)])
        )
        words = name.removesuffix("_degC").replace("_", " ")
        ax.plot(x, y, line, color=f"C{k % 6}", linewidth=0.9, markersize=3, label=words)
    traced = "compensated" if log.metadata.get("tcdyn") == COMPENSATED else "logged"
    labels = (
        ("PRT [°C]", "logged minus PRT [K]") if oven else ("time [s]", f"{traced} temperature [°C]")
    )
    return dressed(ax, *labels, ncols=2)


def draw_chain(chain: Chain, ax: Axes) -> Axes:
    """Unit step response of a chain, its first moment marked."""
    end = 6 * max(chain.lag_s, 1e-3)
    n = 600
    dt = end / n
    before = n // 20
    step = np.ones(n + before)
    step[:before] = 0.0
    t = (np.arange(n + before) - before) * dt
    ax.plot(t, step, drawstyle="steps-post", color=GREY, linewidth=0.9, label="at the junction")
    ax.plot(t, chain.response(step, dt, hold="zoh"), label="in the log file")
    ax.axvline(
        chain.lag_s, linestyle="--", linewidth=0.8, color=DARK, label=f"lag {chain.lag_s:.3g} s"
    )
    return dressed(ax, "time after the step [s]", "share of the step [1]", loc="lower right")
