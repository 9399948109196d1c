"""Small tables for the behaviour suite, from closed forms and first-order recursions of their
own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd


def first_order(x: np.ndarray, tau_s: float, dt_s: float) -> np.ndarray:
    """Response (N,) of one lag to an input (N,) that is held over each interval; it begins in
    equilibrium."""
    keep = np.exp(-dt_s / tau_s)
    y = np.empty(len(x))
    y[0] = x[0]
    for k in range(1, len(x)):
        y[k] = keep * y[k - 1] + (1 - keep) * x[k - 1]
    return y


def noise(count: int, sd: float, seed: int) -> np.ndarray:
    """White noise (count,) of standard deviation ``sd``."""
    return sd * np.random.default_rng(seed).standard_normal(count)


def binary_input(seed: int) -> pd.DataFrame:
    """A heater that switches at random and a temperature behind lags of 2.0 and 0.5 s and a dead
    time of 0.35 s."""
    dt_s = 0.05
    fine_s = 0.01
    levels = np.random.default_rng(seed).integers(0, 2, 60) * 50.0 + 25.0
    u = np.repeat(levels, 20)
    fine = np.repeat(u, 5)
    delayed = np.concatenate([np.full(35, fine[0]), fine[:-35]])
    y = first_order(first_order(delayed, 2.0, fine_s), 0.5, fine_s)[::5]
    return pd.DataFrame(
        {"time_s": np.round(dt_s * np.arange(len(u)), 3), "u": u, "y": y + noise(len(u), 0.5, seed)}
    )


def dip(seed: int) -> pd.DataFrame:
    """A sensor of lags 1.4 and 0.2 s that enters hot water at 6.02 s."""
    t = 0.05 * np.arange(600)
    late = np.clip(t - 6.02, 0, None)
    rise = 1 - (1.4 * np.exp(-late / 1.4) - 0.2 * np.exp(-late / 0.2)) / 1.2
    return pd.DataFrame(
        {"time_s": np.round(t, 3), "T1_degC": np.round(21 + 63 * rise + noise(600, 0.05, seed), 3)}
    )


def gas(seed: int) -> pd.DataFrame:
    """Two thermocouples of 0.2 and 0.8 s in one gas that fluctuates."""
    dt_s = 0.01
    fine_s = dt_s / 10
    rng = np.random.default_rng(seed)
    x = 500 + first_order(40 * rng.standard_normal(30_000), 0.3, fine_s) * 5
    columns = {"time_s": np.round(dt_s * np.arange(3000), 3)}
    for name, tau_s in (("T1_degC", 0.2), ("T2_degC", 0.8)):
        columns[name] = np.round(
            first_order(x, tau_s, fine_s)[::10] + noise(3000, 0.1, seed + len(columns)), 3
        )
    return pd.DataFrame(columns)


def steady(seed: int) -> pd.DataFrame:
    """A sensor of 0.5 s in a process with white fluctuations, at constant conditions."""
    rng = np.random.default_rng(seed)
    y = first_order(10 * rng.standard_normal(40_000), 0.5, 0.005)[::10]
    return pd.DataFrame(
        {
            "time_s": np.round(0.05 * np.arange(4000), 3),
            "T1_degC": 200 + y + noise(4000, 0.01, seed),
        }
    )


def loop_current(seed: int) -> pd.DataFrame:
    """A sensor heated by a current from 5 s on: two modes of 0.7 and 0.15 s."""
    t = 0.05 * np.arange(600)
    late = np.clip(t - 5.0, 0, None)
    rise = 1 - 0.85 * np.exp(-late / 0.7) - 0.15 * np.exp(-late / 0.15)
    y = 20 + 6 * rise + noise(600, 0.01, seed)
    return pd.DataFrame(
        {"time_s": np.round(t, 3), "T1_degC": y, "I_mA": np.where(t > 5.0, 40.0, 0.0)}
    )


def furnace(seed: int) -> pd.DataFrame:
    """A furnace whose door opens at 300 s, behind a lag of 25 s."""
    t = np.arange(900.0)
    late = np.clip(t - 300, 0, None)
    air = 850 - 120 * (1 - np.exp(-late / 15)) * np.exp(-late / 200)
    y = first_order(air, 25.0, 1.0) + noise(900, 0.3, seed)
    return pd.DataFrame({"time_s": t, "TC1_degC": np.round(y, 2)})


def bode() -> pd.DataFrame:
    """Magnitude and phase of one lag of 0.8 s."""
    f = np.geomspace(0.01, 2.0, 15)
    g = 1 / (1 + 2j * np.pi * f * 0.8)
    return pd.DataFrame({"frequency_Hz": f, "gain": np.abs(g), "phase": np.degrees(np.angle(g))})


def write_tables(folder: Path) -> dict[str, Path]:
    """Write all tables as CSV; paths by name."""
    frames = {
        "binary": binary_input(11),
        "dip": dip(12),
        "gas": gas(13),
        "steady": steady(14),
        "current": loop_current(15),
        "furnace": furnace(16),
        "bode": bode(),
    }
    paths = {}
    for name, frame in frames.items():
        paths[name] = folder / f"{name}.csv"
        frame.to_csv(paths[name], index=False)
    return paths
