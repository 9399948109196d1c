"""Coverage of gain, lag and dead time in records whose drift no test of whiteness shows.

``python -m tests.identify.small_drift_study [RUNS] [SEED]`` prints a row for each kind of drift:
records whose intervals contain the true gain, lag and dead time, largest error in standard
uncertainties, rms errors and median standard uncertainties. The records are sums of step responses
in closed form; they share no code with the package.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import numpy as np

from tcdyn.core import Array
from tcdyn.identification import IOData, fit

GAIN = 1.3
LAGS_S = (1.8, 1.0)
DEAD_TIME_S = 0.4
N = 800
DT_S = 0.04
HOLD = 100  # samples of a level
NOISE = 1.0

# Drifts over the record by the random numbers of the record and the time from 0 to 1, and their
# range over the swing of the output.
SHAPES: dict[str, Callable[[np.random.Generator, Array], Array]] = {
    "none": lambda rng, t: np.zeros(len(t)),
    "line": lambda rng, t: t * rng.choice([-1, 1]),
    "warming up": lambda rng, t: (1 - np.exp(-t / rng.uniform(0.2, 1))) * rng.choice([-1, 1]),
    "random walk": lambda rng, t: np.cumsum(rng.normal(size=len(t))),
    "sine": lambda rng, t: np.sin(2 * np.pi * (t * rng.uniform(0.5, 2) + rng.uniform())),
    "wave": lambda rng, t: np.sin(2 * np.pi * (0.7 * t + rng.uniform())),
}
DRIFTS = {
    "none": ("none", 0.0),
    "line 1 %": ("line", 0.01),
    "line 2 %": ("line", 0.02),
    "warming up 1 %": ("warming up", 0.01),
    "random walk 1 %": ("random walk", 0.01),
    "sine 1 %": ("sine", 0.01),
    "wave of 0.7 periods, 6 %": ("wave", 0.06),
}


def step_response(t_s: Array) -> Array:
    """Unit step response of two lags and a dead time, in closed form."""
    s = np.clip(t_s - DEAD_TIME_S, 0, None)
    slow, fast = LAGS_S
    return 1 - (slow * np.exp(-s / slow) - fast * np.exp(-s / fast)) / (slow - fast)


def record(seed: int, drift: str) -> IOData:
    """A heater of random levels, with a drift of ``DRIFTS``."""
    shape, share = DRIFTS[drift]
    rng = np.random.default_rng(10_000 + seed)
    u = np.repeat(rng.choice([10.0, 80.0], size=N // HOLD + 1), HOLD)[:N]
    u[: HOLD // 2] = 10.0
    u[HOLD // 2 : HOLD] = 80.0
    t_s = np.arange(N) * DT_S
    y = np.full(N, 25.0 + GAIN * u[0])
    for k in np.flatnonzero(np.diff(u)) + 1:
        y += GAIN * (u[k] - u[k - 1]) * step_response(t_s - t_s[k])
    swing = float(np.ptp(y))
    moved = SHAPES[shape](rng, np.linspace(0, 1, N))
    y += share * swing * moved / (np.ptp(moved) or 1.0)
    return IOData.from_arrays(u, y + NOISE * rng.normal(size=N), DT_S, hold="zoh")


def study(drift: str, seeds: range, **options: Any) -> dict[str, float]:
    """Coverage, largest errors, rms errors and median uncertainties of the three quantities."""
    truths = {"gain": GAIN, "lag_s": sum(LAGS_S) + DEAD_TIME_S, "dead_s": DEAD_TIME_S}
    rows = []
    for seed in seeds:
        model = fit(record(seed, drift), "P2D", check=False, **options).identified
        found = {"gain": model.static_gain, "lag_s": model.lag_s, "dead_s": model.estimates["Td"]}
        rows.append([(e.contains(truths[n]), e.value - truths[n], e.u) for n, e in found.items()])
    table = np.array(rows, dtype=float)
    covered, errors, us = np.moveaxis(table, 2, 0)
    result = {name: float(n) for name, n in zip(truths, covered.sum(axis=0))}
    result["z"] = float(np.max(np.abs(errors / us)))
    for k, name in enumerate(truths):
        result[f"rms_{name}"] = float(np.sqrt(np.mean(errors[:, k] ** 2)))
        result[f"u_{name}"] = float(np.median(us[:, k]))
    return result


if __name__ == "__main__":
    runs, first = [*map(int, sys.argv[1:]), *(16, 0)[len(sys.argv) - 1 :]]
    for kind in DRIFTS:
        for noise in ("white", "auto"):
            row = study(kind, range(first, first + runs), noise=noise)
            texts = ", ".join(f"{name} {value:.4g}" for name, value in row.items())
            print(f"{kind}, noise={noise}: of {runs} {texts}", flush=True)
