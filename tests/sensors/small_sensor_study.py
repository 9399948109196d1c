"""Small sensors in a sharp step: `python -m tests.sensors.small_sensor_study [COUNT] [SEED]`.

The sensor has two lags, and the medium has one fixed lag, which is not drawn from the prior of the
fit. Nobody knows the instant of entry. The reading is the closed form of three lags in series;
nothing is shared with the fit. COUNT records for each pair of lags and each lag of the medium.
"""

from __future__ import annotations

import sys

import numpy as np
from numpy.typing import NDArray

from tcdyn.core.estimate import Estimate
from tcdyn.sensors.plunge import plunge_sensor

Array = NDArray[np.float64]
# Lags of the sensors [s], and those of the medium.
SENSORS = ((0.1, 0.03), (0.24, 0.02), (0.24, 0.038), (0.5, 0.04), (1.0, 0.04), (1.0, 0.10))
MEDIA_S = (0.0, 0.005, 0.02)
# Rows in the longer lag, so that the shorter one is resolved, and noise [K]: limits of the draws.
ROWS_IN_LAG = (40.0, 150.0)
NOISE_K = (0.02, 0.2)
STEP_K = 60.0
# The record before and after the entry, in longer lags.
LAGS_BEFORE, LAGS_AFTER = 3.0, 12.0
# Difference at which two lags are one, over the lag: the closed form of different lags is then
# within 1e-8 of that of equal ones.
LEAST_DIFFERENCE = 1e-4


def lags_in_series(since_s: Array, lags_s: tuple[float, ...]) -> Array:
    """Response (N,) to a unit step, by partial fractions; lags of zero have no effect."""
    lags = sorted(lag for lag in lags_s if lag > 0)
    for k in range(1, len(lags)):
        lags[k] = max(lags[k], lags[k - 1] * (1 + LEAST_DIFFERENCE))
    since_s = np.maximum(since_s, 0.0)
    response = np.ones_like(since_s)
    for k, lag in enumerate(lags):
        others = np.array(lags[:k] + lags[k + 1 :])
        response -= np.prod(lag / (lag - others)) * np.exp(-since_s / lag)
    return response


def small_sensor_record(
    sensor_s: tuple[float, float], medium_s: float, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Times and readings of one plunge."""
    longer_s = max(sensor_s)
    dt_s = longer_s / np.exp(rng.uniform(*np.log(ROWS_IN_LAG)))
    noise_K = np.exp(rng.uniform(*np.log(NOISE_K)))
    entry_s = LAGS_BEFORE * longer_s + rng.uniform(0, dt_s)
    time_s = dt_s * np.arange(int((LAGS_BEFORE + LAGS_AFTER) * longer_s / dt_s))
    response = lags_in_series(time_s - entry_s, (*sensor_s, medium_s))
    return time_s, 20 + STEP_K * response + noise_K * rng.standard_normal(len(time_s))


def cell_lags(
    sensor_s: tuple[float, float], medium_s: float, count: int, seed: int
) -> list[Estimate]:
    """The estimated lag of each record of a cell; record k has a seed of its own."""
    lags = []
    for k in range(count):
        cell = SENSORS.index(sensor_s), MEDIA_S.index(medium_s)
        rng = np.random.default_rng([seed, *cell, k])
        made = plunge_sensor(*small_sensor_record(sensor_s, medium_s, rng), "T")
        lags.append(made.chain.channels["T"].lag_s)
    return lags


def line(name: str, lags: list[Estimate], truths: list[float]) -> str:
    """A line of the table; errors and uncertainties over the truth, in percent."""
    truth = np.array(truths)
    error = 100 * (np.array([lag.value for lag in lags]) / truth - 1)
    u = 100 * np.array([lag.u for lag in lags]) / truth
    held = 100 * np.mean([lag.contains(value) for lag, value in zip(lags, truths)])
    mean, median_u = np.mean(error), np.median(u)
    return (
        f"{name:22s} {len(lags):4d} {mean:8.2f} {np.sqrt(np.mean(error**2)):8.2f} "
        f"{median_u:8.2f} {abs(mean) / median_u:14.2f} {held:8.1f}"
    )


def main(count: int, seed: int) -> None:
    """Print a line for each cell, and one for all records."""
    print(f"{'lags, medium [s]':22s} {'n':>4s} {'mean [%]':>8s} {'rms [%]':>8s}", end=" ")
    print(f"{'u [%]':>8s} {'mean/median u':>14s} {'held [%]':>8s}")
    all_lags: list[Estimate] = []
    all_truths: list[float] = []
    for sensor_s in SENSORS:
        for medium_s in MEDIA_S:
            lags = cell_lags(sensor_s, medium_s, count, seed)
            truths = [sum(sensor_s)] * count
            print(line(f"{sensor_s[0]:g}, {sensor_s[1]:g}; {medium_s:g}", lags, truths))
            all_lags += lags
            all_truths += truths
    print(line("all", all_lags, all_truths))


if __name__ == "__main__":
    main(
        int(sys.argv[1]) if len(sys.argv) > 1 else 20,
        int(sys.argv[2]) if len(sys.argv) > 2 else 1,
    )
