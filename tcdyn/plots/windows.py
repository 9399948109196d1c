"""Pictures of the transient fits: the answer over the window's length, and the two forms against each other."""

from __future__ import annotations

import pandas as pd
from matplotlib.axes import Axes

from calibration.disk import DISKS
from calibration.estimate import Z95
from tcdyn.plots.style import DISK_COLOUR, DISK_MARKER


def draw_window_study(table: pd.DataFrame, ax: Axes, quantity: str = "beta", truth: float | None = None) -> Axes:
    """``quantity`` ("beta" or "h_W_m2K") of the cooling fit over window length with 95 % bars; open: within the lag.

    ``table`` is that of ``cooling_by_window``.
    """
    for k, disk in enumerate(DISKS):
        own = table[(table["disk"] == disk) & table[quantity].notna()]
        x = own["window_s"] * (1.0 + 0.03 * k)  # side by side
        ax.errorbar(
            x, own[quantity], yerr=Z95 * own[f"u_{quantity}"], fmt="none", ecolor=DISK_COLOUR[disk], capsize=2,
            linewidth=0.8,
        )  # fmt: skip
        for early in (True, False):
            part = (own["within_lag"] == early).to_numpy()
            if part.any():
                ax.plot(
                    x[part], own[quantity][part], DISK_MARKER[disk], color=DISK_COLOUR[disk],
                    markerfacecolor="white" if early else DISK_COLOUR[disk],
                    label=f"{disk} disk" + (", window shorter than the lag" if early else ""),
                )  # fmt: skip
    if truth is not None:
        ax.axhline(truth, color="black", linestyle="--", linewidth=1, label="truth of the simulation")
    ax.set_xscale("log")
    ticks = sorted(set(table["window_s"]))
    ax.set_xticks(ticks, [f"{t:g}" for t in ticks])
    ax.minorticks_off()
    ax.set_xlabel("window after the parting [s]")
    ax.set_ylabel("heat partition β [1]" if quantity == "beta" else "heat transfer coefficient h [W/m²K]")
    ax.legend(frameon=False, fontsize=8)
    return ax


def draw_referee(table: pd.DataFrame, ax: Axes) -> Axes:
    """Compensated less commuted, in standard uncertainties of the difference, for beta and h of each disk."""
    names = [f"{r['disk']} {'β' if r['quantity'] == 'beta' else 'h'}" for _, r in table.iterrows()]
    y = list(range(len(names)))[::-1]
    ax.axvspan(-2, 2, color="#eeeeee", zorder=0)
    for at, (_, r) in zip(y, table.iterrows()):
        ax.plot(r["z"], at, DISK_MARKER[r["disk"]], color=DISK_COLOUR[r["disk"]])
    ax.axvline(0, color="black", linewidth=0.8)
    ax.set_yticks(y, names)
    reach = max(3.0, 1.2 * float(table["z"].abs().max()))
    ax.set_xlim(-reach, reach)
    ax.set_ylim(-0.6, len(names) - 0.4)
    ax.set_xlabel("compensated less commuted,\nin standard uncertainties of the difference [1]")
    return ax
