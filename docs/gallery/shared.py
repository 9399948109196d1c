"""What several scripts of the gallery share: a lag, a plot, and fits of a synthetic rig."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from scipy.signal import lfilter

from tcdyn import run_demo
from tcdyn.rig.disk import DISKS

if TYPE_CHECKING:
    from calibration.static_lines import OvenFit
    from immersion.plunge_result import PlungeFit
    from tcdyn.partition.analyse import Partition

ROOT = Path(__file__).parent.parent.parent


def lagged(x: np.ndarray, dt_s: float, *taus_s: float) -> np.ndarray:
    """First-order lags of an input that is linear between samples, by another solver."""
    for tau_s in taus_s:
        half = (1 - np.exp(-dt_s / tau_s)) / 2
        x = lfilter([half, half], [1, 2 * half - 1], x, zi=[(1 - half) * x[0]])[0]
    return np.asarray(x)


def plot_traces(logged: pd.DataFrame, done: pd.DataFrame, column: str, true: Any) -> Axes:
    """Logged, compensated with its 95 % interval, and true; the index is the time."""
    time_s, value = logged.index, done[column]
    half_width = 1.96 * done[f"{column.rsplit('_', 1)[0]}_u_K"]
    _, ax = plt.subplots(figsize=(8.5, 3.6), layout="constrained")
    ax.plot(time_s, logged[column], color="0.6", linewidth=0.8, label="logged")
    ax.fill_between(time_s, value - half_width, value + half_width, alpha=0.3, linewidth=0)
    ax.plot(time_s, value, linewidth=1.0, label="compensated, 95 %")
    ax.plot(time_s, true, "k:", linewidth=0.8, label="true")
    ax.set(xlabel="time [s]", ylabel=f"temperature [{'K' if column.endswith('_K') else '°C'}]")
    ax.grid(color="#dddddd", linewidth=0.6)
    ax.spines[["top", "right"]].set_visible(False)
    ax.legend(frameon=False, fontsize="small")
    return ax


@cache
def lab() -> Path:
    """The folder of `tcdyn demo`: that in the repository's root, else a new one (a minute)."""
    for folder in (ROOT / "demo", ROOT / "docs" / "_lab"):
        needed = [folder / "EHL_B3.csv", *(folder / f"{disk}.disk.json" for disk in DISKS)]
        if all(path.exists() for path in needed):
            return folder
    run_demo(ROOT / "docs" / "_lab")
    return ROOT / "docs" / "_lab"


@cache
def analysed() -> Partition:
    """Test B3 of that folder."""
    from tcdyn.rig.record import read_record
    from tcdyn.rig.rigfile import load_rig
    from tcdyn.workflows import estimate_beta

    records = {d: read_record(lab() / f"{d}.disk.json") for d in DISKS}
    return estimate_beta(lab() / "EHL_B3.csv", load_rig(lab() / "rig.toml"), records).partition


@cache
def oven() -> OvenFit:
    """The static lines of its fast disk."""
    from calibration.static_lines import fit_static_lines
    from tcdyn.rig.log import read_log

    return fit_static_lines(read_log(lab() / "oven_fast.csv", "oven").frame)


@cache
def plunged() -> PlungeFit:
    """The chain of its fast disk by one plunge."""
    from immersion.fluids import fluid
    from immersion.plunge_data import run_from_log, with_filled_bath
    from immersion.plunge_fit import identify_plunges
    from tcdyn.rig.log import read_log
    from tcdyn.rig.rigfile import load_rig

    rig = load_rig(lab() / "rig.toml")
    log = with_filled_bath(read_log(lab() / "plunge_fast_1.csv", "immersion", rig, "fast"))
    plunge = run_from_log(log, fluid("mobil-jet-ii"), oven().lines, name="plunge 1")
    return identify_plunges([plunge], rig.disk_setup("fast"), alternatives=("mcadams",))
