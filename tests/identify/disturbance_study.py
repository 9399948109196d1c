"""Coverage of gain and lag, and false alarms, where the noise is not white or the input is measured with noise.

Run by hand: ``python -m disturbance_study [RUNS]`` in this folder. The noisy records are simulated on a grid ten times
finer by first-order recursions, with nothing that the fit uses.
"""

from __future__ import annotations

import sys
from collections import Counter

import numpy as np
from identify_cases import CASE_A, case_a_input
from scipy.signal import lfilter

from tcdyn.identify import IOData, fit

DT_S, FINER = 0.05, 10
OUTPUT = ("white", "ar0.9", "ar0.99", "walk", "drift")
AUTO = {"noise": "auto", "baseline": "auto"}


def fine(kind: str, rng: np.random.Generator, n: int = 800) -> tuple[np.ndarray, np.ndarray]:
    """Input and case A's output (n,), neither with noise."""
    t, h = np.arange(n * FINER) * DT_S / FINER, DT_S / FINER
    if kind == "plunge":
        u = 25 + 155 * (1 - np.exp(-np.clip(t - 2, 0, None) / 3))
    else:
        u = np.repeat(case_a_input("PRBS", rng, n)[0], FINER)
    late = round(CASE_A["Td"] / h)
    y = np.concatenate([np.full(late, u[0]), u[:-late]])
    for k, tau in enumerate((CASE_A["Tp1"], CASE_A["Tp2"])):
        held = np.concatenate([y[:1], y[:-1] if kind == "PRBS" and k == 0 else 0.5 * (y[1:] + y[:-1])])
        a = np.exp(-h / tau)
        y = lfilter([1 - a], [1.0, -a], held, zi=[a * held[0]])[0]
    return u[::FINER], y[::FINER]


def disturbance(name: str, rng: np.random.Generator, n: int = 800) -> np.ndarray:
    """Noise of the output (n,)."""
    white = rng.normal(size=n)
    if name.startswith("ar"):
        a = float(name[2:])
        return 0.5 * lfilter([np.sqrt(1 - a**2)], [1.0, -a], rng.normal(size=n + 3000))[3000:]
    if name == "walk":
        return 0.3 * white + np.cumsum(0.05 * rng.normal(size=n))
    return 0.5 * white + (3.0 * np.linspace(0, 1, n) if name == "drift" else 0.0)


def record(kind: str, seed: int, name: str = "white", input_sd: float = 0.0) -> IOData:
    """One test: ``kind`` of input, noise of the output, sd of the input's noise."""
    rng = np.random.default_rng(seed)
    u, y = fine(kind, rng)
    u = u + input_sd * rng.normal(size=len(u))
    hold = "foh" if kind == "plunge" else "zoh"
    return IOData.from_arrays(u, y + disturbance(name, rng), DT_S, hold=hold)


def study(kind: str, seeds: range, name: str = "white", input_sd: float = 0.0, **options: object) -> dict[str, object]:
    """Share of runs whose 95 % interval holds gain and lag, share of alarms (1 % level), and the noise models found."""
    rows, kinds = [], Counter()
    for seed in seeds:
        found = fit(
            record(kind, seed, name, input_sd), "P2D", start=CASE_A, check=False, intervals="quadratic", **options
        )
        s, lag = found.identified.statistics, found.identified.lag_s
        rows.append(
            (found.estimates["Kp"].covers(1.0), lag.covers(2.87), s["p_white"] < 0.01, s["p_input"] < 0.01, lag.value)
        )
        kinds[(*found.noise.order, found.disturbance["baseline"])] += 1
    table = np.array(rows, dtype=float)
    share = dict(zip(("Kp", "lag", "white", "input"), table[:, :4].mean(axis=0).round(3).tolist()))
    return {**share, "bias_s": float(table[:, 4].mean() - 2.87), "sd_s": float(table[:, 4].std()), "noise": dict(kinds)}


if __name__ == "__main__":
    runs = range(int(sys.argv[1]) if len(sys.argv) > 1 else 200)
    for kind in ("plunge", "PRBS"):
        for sd in (0.5,):
            print(kind, "noisy input", study(kind, runs, input_sd=sd), flush=True)
        for name in OUTPUT:
            print(kind, name, study(kind, runs, name, **AUTO), flush=True)
