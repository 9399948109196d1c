"""Coverage of gain and lag in records whose drift is too small for a test of whiteness.

``python -m tests.identify.small_drift_study [RUNS]`` prints a row for each kind of drift: records
whose intervals contain the true gain and lag, largest error in standard uncertainties, and median
standard uncertainties. The records are sums of step responses in closed form; they share no code
with the package.
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
DRIFT_SHARE = 0.01  # drift over the swing of the output
NOISE = 1.0

# Drifts over the record, from 0 to 1, by the random numbers of the record and the time from 0 to 1.
DRIFTS: dict[str, Callable[[np.random.Generator, Array], Array]] = {
    "none": lambda rng, t: np.zeros(len(t)),
    "line": lambda rng, t: t * rng.choice([-1, 1]),
    "warming up": lambda rng, t: (1 - np.exp(-t / rng.uniform(0.2, 1))) * rng.choice([-1, 1]),
    "random walk": lambda rng, t: np.cumsum(rng.normal(size=len(t))),
    "sine": lambda rng, t: np.sin(2 * np.pi * (t * rng.uniform(0.5, 2) + rng.uniform())),
}


def step_response(t_s: Array) -> Array:
    """Unit step response of two lags and a dead time, in closed form."""
    s = np.clip(t_s - DEAD_TIME_S, 0, None)
    slow, fast = LAGS_S
    return 1 - (slow * np.exp(-s / slow) - fast * np.exp(-s / fast)) / (slow - fast)


def record(seed: int, drift: str) -> IOData:
    """A heater of random levels, with a drift of ``DRIFT_SHARE`` of the swing."""
    rng = np.random.default_rng(10_000 + seed)
    u = np.repeat(rng.choice([10.0, 80.0], size=N // HOLD + 1), HOLD)[:N]
    u[: HOLD // 2] = 10.0
    u[HOLD // 2 : HOLD] = 80.0
    t_s = np.arange(N) * DT_S
    y = np.full(N, 25.0 + GAIN * u[0])
    for k in np.flatnonzero(np.diff(u)) + 1:
        y += GAIN * (u[k] - u[k - 1]) * step_response(t_s - t_s[k])
    swing = float(np.ptp(y))
    shape = DRIFTS[drift](rng, np.linspace(0, 1, N))
    y += DRIFT_SHARE * swing * shape / (np.ptp(shape) or 1.0)
    return IOData.from_arrays(u, y + NOISE * rng.normal(size=N), DT_S, hold="zoh")


def study(drift: str, seeds: range, **options: Any) -> dict[str, float]:
    """Coverage, largest errors and median uncertainties of gain and lag."""
    rows = []
    for seed in seeds:
        model = fit(record(seed, drift), "P2D", check=False, **options).identified
        row = []
        for estimate, truth in (
            (model.static_gain, GAIN),
            (model.lag_s, sum(LAGS_S) + DEAD_TIME_S),
        ):
            error = abs(estimate.value - truth) / estimate.u
            row += [float(estimate.contains(truth)), error, estimate.u]
        rows.append(row)
    table = np.array(rows)
    return {
        "gain": table[:, 0].sum(),
        "lag_s": table[:, 3].sum(),
        "z": table[:, [1, 4]].max(),
        "u_gain": float(np.median(table[:, 2])),
        "u_lag_s": float(np.median(table[:, 5])),
    }


if __name__ == "__main__":
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 16
    for kind in DRIFTS:
        for noise in ("white", "auto"):
            row = study(kind, range(runs), noise=noise)
            texts = ", ".join(f"{name} {value:.4g}" for name, value in row.items())
            print(f"{kind}, noise={noise}: of {runs} {texts}", flush=True)
