"""Sensors made by recursions of their own: lags as fine first-order steps, sheaths as shells of heat."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.float64]
FINE = 20  # steps of the simulation in a sample


def lagged(x: Array, taus_s: tuple[float, ...], dt_s: float) -> Array:
    """What lags one after the other make of ``x`` (N,), which is sampled every ``dt_s``; they begin in balance."""
    y = x
    for tau in taus_s:
        keep = np.exp(-dt_s / tau)
        half = (1 - keep) / 2
        y = lfilter([half, half], [1, -keep], y, zi=[(1 - half) * y[0]])[0]
    return y


def fluid(t: Array) -> Array:
    """A temperature [degC] that swings, and bends at a third of the time."""
    third = t[0] + (t[-1] - t[0]) / 3
    return 200 + 20 * np.sin(t / 7) + 30 * (1 - np.exp(-np.clip(t - third, 0, None) / 3.0))


def logged(taus_s: tuple[float, ...], dt_s: float, n: int, noise_K: float, seed: int) -> tuple[Array, Array, Array]:
    """Time (N,) [s], fluid and reading (N,) [degC]."""
    fine = np.arange(n * FINE) * (dt_s / FINE)
    x = fluid(fine)
    y = lagged(x, taus_s, dt_s / FINE)[::FINE] + noise_K * np.random.default_rng(seed).standard_normal(n)
    return fine[::FINE], x[::FINE], y


def write(path: Path, **columns: Array) -> Path:
    """A CSV of these columns."""
    pd.DataFrame(columns).to_csv(path, index=False)
    return path


def written(path: Path) -> pd.DataFrame:
    """A table that was written."""
    return pd.read_csv(path, comment="#")
