"""Four sensors outside the rig, each with its table, command and picture: `python docs/gallery.py OUT`.

A furnace with a stated lag, a pair in an exhaust, a pipe sensor heated by a current, a kiln with eight channels. The
tables are made here by recursions of their own; the truth is dotted in the pictures.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.signal import lfilter

from tcdyn.cli.app import app, run
from tcdyn.plots.style import figure

RNG = np.random.default_rng(2015)


def tcdyn(*words: object) -> None:
    """Run a command; what it says stays on the terminal. Exit 1, something to be looked at, is no failure."""
    print("tcdyn", *words)
    try:
        run(lambda: app([str(w) for w in words], standalone_mode=True))
    except SystemExit as left:
        if left.code not in (None, 0, 1):
            raise


def behind(x: np.ndarray, tau_s: float, dt_s: float) -> np.ndarray:
    """One lag, straight between samples."""
    half = (1 - np.exp(-dt_s / tau_s)) / 2
    return np.asarray(lfilter([half, half], [1, 2 * half - 1], x, zi=[(1 - half) * x[0]])[0])


def picture(out: Path, name: str, table: Path, done: Path, column: str, truth: np.ndarray, zero: float = 0.0) -> None:
    """Logged, compensated with its band, and true."""
    raw, ours = pd.read_csv(table), pd.read_csv(done, comment="#")
    t, u = raw.iloc[:, 0].to_numpy(), ours[f"{column.rsplit('_', 1)[0]}_u_K"].to_numpy()
    picture, (ax,) = figure(height_in=3.6)
    ax.plot(t, raw[column] - zero, color="0.6", linewidth=0.8, label="logged")
    ax.fill_between(t, ours[column] - zero - 1.96 * u, ours[column] - zero + 1.96 * u, alpha=0.3, linewidth=0)
    ax.plot(t, ours[column] - zero, linewidth=1.0, label="compensated, 95 %")
    ax.plot(t, truth, "k:", linewidth=0.8, label="true")
    ax.set(xlabel="time [s]", ylabel="temperature [°C]", title=name)
    ax.legend(fontsize="small")
    picture.savefig(out / f"{name.replace(' ', '_')}.png", dpi=110)


def furnace(out: Path) -> None:
    """A thermocouple in kelvin, its lag from a data sheet; the door opens at 300 s."""
    t = np.arange(0, 900, 1.0)
    x = 850 - 120 * (1 - np.exp(-np.clip(t - 300, 0, None) / 15)) * np.exp(-np.clip(t - 300, 0, None) / 200)
    table, sensor, done = out / "furnace.csv", out / "furnace.sensor.json", out / "furnace.compensated.csv"
    y = behind(x, 25.0, 1.0) + 0.3 * RNG.standard_normal(len(t)) + 273.15
    pd.DataFrame({"time_s": t, "TC1_K": y, "power_kW": 30.0}).to_csv(table, index=False)
    tcdyn("sensor", "new", "--tau-s", "25+-1", "--column", "TC1", "--out", sensor)
    tcdyn("compensate", table, "--sensor", sensor, "--out", done)
    picture(out, "furnace", table, done, "TC1_K", x, 273.15)


def exhaust(out: Path) -> None:
    """Two wires of different size in an exhaust, no reference: the pair tells both lags, then undoes them."""
    dt = 0.002
    t = np.arange(0, 8, dt)
    x = 500 + 60 * np.sin(2 * np.pi * 3 * t) + 25 * np.sin(2 * np.pi * 0.7 * t + 1)
    table, sensor, done = out / "exhaust.csv", out / "exhaust.sensor.json", out / "exhaust.compensated.csv"
    fine, coarse = (behind(x, tau, dt) + 0.8 * RNG.standard_normal(len(t)) for tau in (0.05, 0.18))
    pd.DataFrame({"time_s": np.round(t, 4), "fine_degC": fine, "coarse_degC": coarse}).to_csv(table, index=False)
    tcdyn("sensor", "pair", table, "--columns", "fine,coarse", "--out", sensor)
    tcdyn("compensate", table, "--sensor", sensor, "--out", done)
    picture(out, "exhaust pair", table, done, "coarse_degC", x)


def pipe(out: Path) -> None:
    """A sensor in a pipe, heated by a current for 60 s: the lag in place, then the pipe's own transient."""
    dt = 0.1
    t = np.arange(0, 180, dt)
    power = np.where((t > 20) & (t < 80), 1.0, 0.0)
    warm = 4 * behind(power, 6.0, dt) + 1.5 * behind(power, 0.7, dt)
    heated, sensor = out / "lcsr.csv", out / "pipe.sensor.json"
    r = 290 + warm + 0.02 * RNG.standard_normal(len(t))
    pd.DataFrame({"time_s": np.round(t, 2), "R1_degC": r, "I_mA": 60 * power}).to_csv(heated, index=False)
    tcdyn("sensor", "current", heated, "--column", "R1", "--current", "I_mA", "--out", sensor)
    x = 290 + 12 * (1 - np.exp(-np.clip(t - 60, 0, None) / 4))
    table, done = out / "pipe.csv", out / "pipe.compensated.csv"
    y = behind(behind(behind(x, 6.0, dt), 0.7, dt), 0.5, dt) + 0.02 * RNG.standard_normal(len(t))
    pd.DataFrame({"time_s": np.round(t, 2), "R1_degC": y}).to_csv(table, index=False)
    tcdyn("compensate", table, "--sensor", sensor, "--out", done)
    picture(out, "pipe LCSR", table, done, "R1_degC", x)


def kiln(out: Path) -> None:
    """Eight thermocouples of one kind in one kiln: one file, one error of the lag for all."""
    t = np.arange(0, 3600, 5.0)
    x = {f"T{k}": 600 + 0.05 * t + 40 * np.sin(t / 250 + k / 3) for k in range(1, 9)}
    table, sensor, done = out / "kiln.csv", out / "kiln.sensor.json", out / "kiln.compensated.csv"
    read = {f"{k}_degC": behind(v, 60.0, 5.0) + 0.5 * RNG.standard_normal(len(t)) for k, v in x.items()}
    pd.DataFrame({"time_s": t, **read, "gas_m3_h": 12.0}).to_csv(table, index=False)
    tcdyn("sensor", "new", "--tau-s", "60+-3", "--column", "T*", "--out", sensor)
    tcdyn("compensate", table, "--sensor", sensor, "--out", done)
    picture(out, "kiln", table, done, "T3_degC", x["T3"])


def main(out: Path) -> None:
    """All four."""
    out.mkdir(parents=True, exist_ok=True)
    for one in (furnace, exhaust, pipe, kiln):
        one(out)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
