"""Definitions of the benchmark cases of the identification tests."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import lfilter, max_len_seq

from tcdyn.identification import IOData, process, simulate, transfer

# Options of a fit without selection: white noise, no baseline, a start in equilibrium.
PLAIN = {"noise": "white", "baseline": "none", "initial": "equilibrium"}
CASE_A = {"Kp": 1.0, "Tp1": 2.0, "Tp2": 0.5, "Td": 0.37}
RAO_GARNIER = {
    "b0": 1.0,
    "b1": -4.0,
    "a1": 416 / 1600,
    "a2": 408 / 1600,
    "a3": 5 / 1600,
    "a4": 1 / 1600,
}


def data_dir() -> Path | None:
    """The folder of reference data, or None."""
    root = Path(
        os.environ.get("TCDYN_DATA", Path(__file__).resolve().parents[2].parent / "shared" / "data")
    )
    return root if root.is_dir() else None


def case_a_input(kind: str, rng: np.random.Generator, n: int = 800) -> tuple[np.ndarray, str]:
    """Input and hold: a smooth plunge (FOH), or levels of 25 or 75 degC held for 20 samples
    (ZOH)."""
    t = np.arange(n) * 0.05
    if kind == "plunge":
        return 25 + 155 * (1 - np.exp(-np.clip(t - 2, 0, None) / 3)), "foh"
    return np.repeat(np.where(rng.random(n // 20) < 0.5, 25.0, 75.0), 20), "zoh"


def case_a(kind: str, seed: int, noise: float = 0.5, colour: float = 0.0) -> IOData:
    """Lags of 2.0 and 0.5 s and a dead time of 0.37 s (7.4 samples), 800 samples at 0.05 s."""
    rng = np.random.default_rng(seed)
    u, hold = case_a_input(kind, rng)
    y = simulate(process("P2D").rational(CASE_A), u, 0.05, hold)
    e = rng.normal(size=len(u))
    if colour:
        e = lfilter([np.sqrt(1 - colour**2)], [1.0, -colour], e)
    return IOData.from_arrays(u, y + noise * e, 0.05, hold=hold, name=f"case A, {kind}")


def rao_garnier(seed: int, snr_dB: float = 10.0) -> IOData:
    """(-6400 s + 1600)/(s^4 + 5 s^3 + 408 s^2 + 416 s + 1600) driven by a PRBS of 10 stages held
    for 7 samples of 10 ms."""
    u = np.repeat(max_len_seq(10)[0] * 2.0 - 1.0, 7)
    y = simulate(transfer(1, 4).rational(RAO_GARNIER), u, 0.01, "zoh", "zero")
    sd = np.std(y) * 10 ** (-snr_dB / 20)
    return IOData.from_arrays(
        u, y + sd * np.random.default_rng(seed).normal(size=len(u)), 0.01, hold="zoh"
    )


def static_gain(parameters: Mapping[str, float], data: IOData) -> list[Any]:
    """A model without dynamics, for ``fit_function``."""
    return [parameters["gain"] * run.u[:, 0] for run in data.runs]
