"""Pictures of what goes in: a log as it was read, and a chain."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from calibration.log import COMPENSATED, Log
from tcdyn.chain import Chain

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST_POINTS = 4000  # more than a page can show
STYLES = ("-", "--", ":")  # told apart in grey, too


def draw_log(log: Log, ax: Axes) -> Axes:
    """Every thermocouple of a log against time, or against the PRT for an oven log."""
    step = max(len(log.frame) // MOST_POINTS, 1)
    shown = log.frame.iloc[::step]
    if log.kind == "oven":
        x, label = shown["prt_degC"], "PRT, °C"
    else:
        x, label = shown["time_s"], "time, s"
    for k, name in enumerate(log.channels):
        y, words = shown[name], name.removesuffix("_degC").replace("_", " ")
        if log.kind == "oven":
            y, line = y - x, "o"
        else:
            line = STYLES[(k // 6) % len(STYLES)]
        ax.plot(x, y, line, color=f"C{k % 6}", linewidth=0.9, markersize=3, label=words)
    ax.set_xlabel(label)
    traced = "compensated" if log.metadata.get("tcdyn") == COMPENSATED else "logged"
    ax.set_ylabel("logged minus PRT, K" if log.kind == "oven" else f"{traced} temperature, °C")
    ax.legend(fontsize="small", ncols=2)
    return ax


def draw_chain(chain: Chain, ax: Axes) -> Axes:
    """Unit step response of a chain, its first moment marked."""
    end = 6 * max(chain.lag_s, 1e-3)
    n = 600
    dt = end / n
    before = n // 20
    step = np.ones(n + before)
    step[:before] = 0.0
    t = (np.arange(n + before) - before) * dt
    ax.plot(t, step, drawstyle="steps-post", color="0.5", linewidth=0.9, label="at the junction")
    ax.plot(t, chain.response(step, dt, hold="zoh"), label="in the log file")
    ax.axvline(chain.lag_s, linestyle="--", linewidth=0.8, color="0.3", label=f"lag {chain.lag_s:.3g} s")
    ax.set_xlabel("time after the step, s")
    ax.set_ylabel("share of the step")
    ax.legend(loc="lower right", fontsize="small")
    return ax
