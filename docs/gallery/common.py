"""Functions for the scripts of the gallery: output folder, commands, and one analysed folder of the synthetic rig."""

from __future__ import annotations

import sys
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy.signal import lfilter

from tcdyn import run_demo
from tcdyn.cli.app import app, run
from tcdyn.plots.style import figure
from tcdyn.rig.disk import DISKS

if TYPE_CHECKING:
    from calibration.static_lines import OvenFit
    from immersion.plunge_result import PlungeFit
    from tcdyn.partition.analyse import Partition

ROOT = Path(__file__).parent.parent.parent
OUT = ROOT / "docs" / "_pictures"


def save(picture: Figure, script: str) -> None:
    """Write the figure of a script into the output folder."""
    OUT.mkdir(exist_ok=True)
    picture.savefig(OUT / f"{Path(script).stem}.png", dpi=110)


def tcdyn(*words: object) -> None:
    """Run a command; its output stays on the terminal. Exit code 1 (a warning) is no failure."""
    print("tcdyn", *words, file=sys.stderr)
    code = run(lambda: app([str(w) for w in words]))
    if code not in (0, 1):
        raise SystemExit(code)


def behind(x: np.ndarray, tau_s: float, dt_s: float) -> np.ndarray:
    """First-order lag of an input that is linear between samples, independent of the library's solver."""
    half = (1 - np.exp(-dt_s / tau_s)) / 2
    return np.asarray(lfilter([half, half], [1, 2 * half - 1], x, zi=[(1 - half) * x[0]])[0])


def made(script: str, name: str) -> Path:
    """Path of an intermediate file of a script."""
    (OUT / "files").mkdir(parents=True, exist_ok=True)
    return OUT / "files" / f"{Path(script).stem}.{name}"


def traces(table: Path, done: Path, column: str, truth: np.ndarray, zero: float = 0.0) -> Figure:
    """Logged, compensated with its 95 % interval, and true."""
    raw, ours = pd.read_csv(table), pd.read_csv(done)
    t, u = raw.iloc[:, 0].to_numpy(), ours[f"{column.rsplit('_', 1)[0]}_u_K"].to_numpy()
    picture, (ax,) = figure(height_in=3.6)
    ax.plot(t, raw[column] - zero, color="0.6", linewidth=0.8, label="logged")
    ax.fill_between(
        t, ours[column] - zero - 1.96 * u, ours[column] - zero + 1.96 * u, alpha=0.3, linewidth=0
    )
    ax.plot(t, ours[column] - zero, linewidth=1.0, label="compensated, 95 %")
    ax.plot(t, truth, "k:", linewidth=0.8, label="true")
    ax.set(xlabel="time [s]", ylabel="temperature [°C]")
    ax.legend(fontsize="small")
    return picture


@cache
def lab() -> Path:
    """The folder of `tcdyn demo`: the one in the repository's root if there is one, else a new one (minutes)."""
    for folder in (ROOT / "demo", OUT / "demo"):
        if (
            all((folder / f"{d}.disk.json").exists() for d in DISKS)
            and (folder / "EHL_B3.csv").exists()
        ):
            return folder
    run_demo(OUT / "demo")
    return OUT / "demo"


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
