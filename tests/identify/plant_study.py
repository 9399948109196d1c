"""Coverage of plants that are identified behind a sensor of known lag.

``python -m tests.identify.plant_study COUNT SEED`` draws plants with one to three lags and a dead
time behind sensors with one or two lags, and identifies each record without options but the lag of
the sensor, as it was measured. The simulation is an ordinary differential equation in fine steps
and shares nothing with the library.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray

from tcdyn.chain import Chain
from tcdyn.identification import IOData, compare
from tcdyn.identification.plant import KnownSensor

Array = NDArray[np.float64]

DT_S = 1.0
N_ROWS = 700
SUBSTEPS = 25


@dataclass(frozen=True)
class Setup:
    """A plant behind a sensor.

    Parameters
    ----------
    gain
        Static gain of the plant [K/%].
    lags_s
        Lags of the plant [s].
    dead_s
        Its dead time [s], a multiple of the step of the simulation.
    sensor_lags_s
        Lags of the sensor [s].
    stated_lag_s, stated_u_s
        Measured lag of the sensor and its standard uncertainty [s].
    """

    gain: float
    lags_s: tuple[float, ...]
    dead_s: float
    sensor_lags_s: tuple[float, ...]
    stated_lag_s: float
    stated_u_s: float

    @property
    def lag_s(self) -> float:
        """Lag of the plant, its dead time included [s]."""
        return sum(self.lags_s) + self.dead_s


def drawn(rng: np.random.Generator) -> Setup:
    """A plant behind a sensor, from wide distributions."""
    n_lags = int(rng.integers(1, 4))
    longest_s = float(rng.uniform(12.0, 40.0))
    shares = np.concatenate([[1.0], rng.uniform(0.1, 0.5, n_lags - 1)])
    dead_s = round(float(rng.uniform(0.0, 6.0)) * SUBSTEPS) / SUBSTEPS
    sensor_s = float(rng.uniform(2.0, 12.0))
    second = float(rng.choice([0.0, 0.15]))
    sensor = (sensor_s * (1 - second), sensor_s * second) if second else (sensor_s,)
    u_s = 0.05 * sensor_s
    return Setup(
        float(rng.uniform(0.3, 3.0)),
        tuple((longest_s * shares).tolist()),
        dead_s,
        sensor,
        sensor_s + u_s * float(rng.normal()),
        u_s,
    )


def lagged(values: Array, lag_s: float) -> Array:
    """Response of a lag to values that are held for each step, from rest."""
    step_s = DT_S / SUBSTEPS
    keep = float(np.exp(-step_s / lag_s))
    out = np.zeros(len(values))
    state = 0.0
    for k in range(len(values) - 1):
        state = keep * state + (1 - keep) * values[k]
        out[k + 1] = state
    return out


def record(setup: Setup, rng: np.random.Generator) -> IOData:
    """The heater in levels, and the reading with white noise of 0.5 % of the swing."""
    levels = np.repeat(rng.choice([20.0, 40.0, 60.0], N_ROWS // 50 + 1), 50)[:N_ROWS]
    levels[:30] = 20.0
    levels[30:80] = 60.0
    fine = np.repeat(levels - levels[0], SUBSTEPS)
    n_dead = round(setup.dead_s * SUBSTEPS / DT_S)
    values = setup.gain * np.concatenate([np.zeros(n_dead), fine])[: len(fine)]
    for lag_s in (*setup.lags_s, *setup.sensor_lags_s):
        values = lagged(values, lag_s)
    clean = 25.0 + values[::SUBSTEPS]
    noise = rng.normal(0.0, 0.005 * np.ptp(clean), N_ROWS)
    return IOData.from_arrays(levels, clean + noise, DT_S, hold="zoh")


def outcome(seed: int) -> tuple[list[float], str, float]:
    """Errors over u of gain, lag and dead time, the model, and the processor time [s]."""
    rng = np.random.default_rng(seed)
    setup = drawn(rng)
    data = record(setup, rng)
    chain = Chain(setup.stated_lag_s, is_stated=True)
    start_s = time.process_time()
    comparison = compare(data, sensor=KnownSensor(chain, setup.stated_u_s))
    cpu_s = time.process_time() - start_s
    averaged = next(iter(comparison.averaged.values()), {})
    truth = {"gain": setup.gain, "lag_s": setup.lag_s, "dead_time_s": setup.dead_s}
    row = []
    for name, value in truth.items():
        estimate = averaged.get(name)
        if estimate is None:
            row += [np.nan, np.nan, np.nan]
            continue
        row += [float(estimate.contains(value)), (estimate.value - value) / estimate.u, estimate.u]
    severity = comparison.conclusion.severity.value
    return row, f"{comparison.recommended} {severity}", cpu_s


def study(seeds: range, n_jobs: int = 1) -> None:
    """Identify a plant for each seed and print the counts."""
    results = Parallel(n_jobs=n_jobs)(delayed(outcome)(seed) for seed in seeds)
    table = np.array([row for row, _, _ in results])
    for k, name in enumerate(("gain", "lag", "dead time")):
        covered, z, _ = table[:, 3 * k : 3 * k + 3].T
        known = np.isfinite(z)
        print(
            f"{name}: covered {int(np.nansum(covered))} of {known.sum()}, rms error over u "
            f"{np.sqrt(np.mean(z[known] ** 2)):.2f}, largest {np.max(np.abs(z[known])):.1f}"
        )
    for (row, model, cpu_s), seed in zip(results, seeds):
        print(seed, model, np.round(row, 2).tolist(), f"{cpu_s:.1f} s")


if __name__ == "__main__":
    count, first = (int(word) for word in sys.argv[1:3])
    study(range(first, first + count))
