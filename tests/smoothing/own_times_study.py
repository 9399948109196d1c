"""Rows at uneven times: ``python -m tests.smoothing.own_times_study RECORDS SEED``.

The truth is integrated in steps of 1/40 of the mean interval, and read at the time of each row.
Printed is, for each signal and scatter of the rows (standard deviation in intervals), the mean
coverage of the 95 % band over records, its spread, the worst record, the rms error and the median
standard uncertainty, and the share of rows that were not used.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tcdyn.sensors import specified_sensor
from tcdyn.workflows.frames import compensate_frame

Array = NDArray[np.float64]
DT_S, LAG_S, NOISE_K, ROWS, FINE = 0.05, 0.5, 0.02, 800, 40
Signal = Callable[[Array, np.random.Generator], Array]


def sines(t: Array, rng: np.random.Generator) -> Array:
    """Two sines of 10 s and 2 s."""
    phase = rng.uniform(0, 2 * np.pi, 2)
    return 60 + 8 * np.sin(2 * np.pi * t / 10 + phase[0]) + 2 * np.sin(2 * np.pi * t / 2 + phase[1])


def step(t: Array, rng: np.random.Generator) -> Array:
    """A step that settles in 2 s."""
    since = np.maximum(t - t[-1] * rng.uniform(0.3, 0.7), 0.0)
    return 60 + 20 * (1 - np.exp(-since / 2.0))


def walk(t: Array, rng: np.random.Generator) -> Array:
    """A random walk of the temperature."""
    return 60 + np.cumsum(rng.normal(0, 1.0 * np.sqrt(t[1] - t[0]), len(t)))


def record(signal: Signal, scatter: float, seed: int) -> tuple[pd.DataFrame, Array]:
    """Rows at their own times, and the truth there."""
    rng = np.random.default_rng(seed)
    fine_s = DT_S / FINE
    t = np.arange((ROWS + 4) * FINE) * fine_s
    x = signal(t, rng)
    y = np.empty_like(x)
    y[0] = x[0]
    decay = np.exp(-fine_s / LAG_S)
    for k in range(1, len(x)):
        y[k] = decay * y[k - 1] + (1 - decay) * x[k - 1]
    due_s = (np.arange(ROWS) + 2) * DT_S
    limit = 0.49 * DT_S
    row_s = due_s + np.clip(rng.normal(0, scatter * DT_S, ROWS), -limit, limit)
    reading = np.interp(row_s, t, y) + rng.normal(0, NOISE_K, ROWS)
    frame = pd.DataFrame({"time_s": np.round(row_s, 5), "T_degC": np.round(reading, 4)})
    return frame, np.interp(row_s, t, x)


def main(records: int, seed: int) -> None:
    """Print the table."""
    sensor = specified_sensor("probe", ["T"], [(LAG_S, 1e-4)], is_bare=True)
    for signal in (sines, step, walk):
        for scatter in (0.0, 0.1, 0.25):
            coverage, square, u = [], [], []
            for k in range(records):
                frame, truth = record(signal, scatter, seed * 1000 + k)
                result = compensate_frame(frame, [sensor])
                error = result["T_degC"].to_numpy() - truth
                sd = result["T_u_K"].to_numpy()
                coverage.append(float(np.mean(np.abs(error) < 1.96 * sd)))
                square.append(float(np.mean(error**2)))
                u.append(float(np.median(sd)))
            print(
                f"{signal.__name__:6s} {scatter:4.2f}: {100 * np.mean(coverage):5.1f} +- "
                f"{100 * np.std(coverage):4.1f} %, worst {100 * min(coverage):5.1f} %; rms "
                f"{np.sqrt(np.mean(square)):.4f} K, u {np.median(u):.4f} K",
                flush=True,
            )


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
