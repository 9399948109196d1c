"""Study: coverage of the rate of change of a compensated record by its standard uncertainty.

Signals of known derivative pass a first-order lag in closed form, none of it by the code under
test; white noise is added. ``python -m tests.smoothing.rate_study`` prints, for each kind of signal
and 20 records of it, the mean share of the samples within the 95 % band, the median standard
uncertainty and the rms error of the rate.

The figures are on the manual's validation page. Most bands are wider than needed, as are those of
the temperature.

A signal that is a random walk has no rate at an instant. There the truth is the mean rate over one
sampling interval around each sample, from the path itself.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tcdyn.chain import Chain
from tcdyn.core import Array
from tcdyn.smoothing import smooth

LAG_S = 1.5
DT_S = 0.1
ROWS = 600
NOISE_K = 0.1
RECORDS = 20
# steps of a random walk in one sampling interval: enough that its chain and its mean rate are exact
# to a hundredth of the noise
FINE = 20


@dataclass(frozen=True)
class World:
    """One record: readings (N,) [K] and the true rate of change (N,) [K/s]."""

    readings: Array
    rate_K_s: Array


def of_sines(amplitude_K: Array, w_rad_s: Array, phase: Array, lag_s: float) -> tuple[Array, Array]:
    """Readings without noise, and rate, of a sum of sines in the steady state of a lag."""
    time_s = np.arange(ROWS) * DT_S
    angle = w_rad_s[:, None] * time_s + phase[:, None]
    response = amplitude_K / (1.0 + 1j * w_rad_s * lag_s)
    readings = 100.0 + np.sum((response[:, None] * np.exp(1j * angle)).imag, axis=0)
    rate = np.sum((amplitude_K * w_rad_s)[:, None] * np.cos(angle), axis=0)
    return readings, rate


def few_sines(rng: np.random.Generator, lag_s: float) -> tuple[Array, Array]:
    """Three sines of periods from 4 s to 40 s."""
    w = 2 * np.pi / rng.uniform(4.0, 40.0, 3)
    return of_sines(rng.uniform(2.0, 20.0, 3), w, rng.uniform(0.0, 2 * np.pi, 3), lag_s)


def smooth_noise(rng: np.random.Generator, lag_s: float) -> tuple[Array, Array]:
    """Normal noise of 5 K whose spectrum is normal, with the standard deviation 0.7 rad/s."""
    w = np.linspace(0.01, 3.0, 300)
    density = np.exp(-0.5 * (w / 0.7) ** 2)
    sd_K = 5.0 * np.sqrt(density / density.sum())
    amplitude = rng.rayleigh(1.0, len(w)) * sd_K
    return of_sines(amplitude, w, rng.uniform(0.0, 2 * np.pi, len(w)), lag_s)


def ramps(rng: np.random.Generator, lag_s: float) -> tuple[Array, Array]:
    """A slope that changes at three times, in closed form behind the lag."""
    time_s = np.arange(ROWS) * DT_S
    readings, rate = np.zeros((2, ROWS))
    for start_s in rng.uniform(5.0, 55.0, 3):
        slope = rng.normal(0.0, 2.0)
        since_s = np.maximum(time_s - start_s, 0.0)
        readings += slope * (since_s - lag_s * (1.0 - np.exp(-since_s / lag_s)))
        rate += slope * (time_s > start_s)
    return readings, rate


def random_walk(rng: np.random.Generator, lag_s: float) -> tuple[Array, Array]:
    """A random walk of 1 K in a second; its mean rate over one sampling interval."""
    step_s = DT_S / FINE
    count = (ROWS + 200) * FINE
    walk = np.cumsum(rng.normal(0.0, np.sqrt(step_s), count))
    keep = np.exp(-step_s / lag_s)
    behind = np.empty(count)
    state = 0.0
    for k, x in enumerate(walk):
        state = keep * state + (1.0 - keep) * x
        behind[k] = state
    at = np.arange(100, 100 + ROWS) * FINE
    rate = (walk[at + FINE // 2] - walk[at - FINE // 2]) / DT_S
    return behind[at], rate


KINDS: dict[str, Callable[[np.random.Generator, float], tuple[Array, Array]]] = {
    "few sines": few_sines,
    "smooth noise": smooth_noise,
    "ramps": ramps,
    "random walk": random_walk,
}


def world(kind: str, seed: int, lag_u_s: float = 0.0) -> World:
    """One record of a kind, whose lag differs from ``LAG_S`` by its standard uncertainty."""
    rng = np.random.default_rng(seed)
    lag_s = LAG_S + lag_u_s * rng.normal()
    readings, rate = KINDS[kind](rng, lag_s)
    return World(readings + rng.normal(0.0, NOISE_K, ROWS), rate)


def figures(kind: str, seeds: range, lag_u_s: float = 0.0) -> tuple[float, float, float]:
    """Mean coverage of the 95 % band, median u and rms error [K/s] of the rates of some records."""
    shares = []
    all_u = []
    squares = []
    for seed in seeds:
        made = world(kind, seed, lag_u_s)
        result = smooth(made.readings, DT_S, Chain(LAG_S), lag_covariance=[[lag_u_s**2]])
        error = result.slope[:, 0] - made.rate_K_s
        u = result.slope_sd[:, 0]
        shares.append(np.mean(np.abs(error) < 1.96 * u))
        all_u.append(np.median(u))
        squares.append(np.mean(error**2))
    return float(np.mean(shares)), float(np.median(all_u)), float(np.sqrt(np.mean(squares)))


def main(first_seed: int = 0) -> None:
    """Print the table of records with seeds from ``first_seed`` on."""
    seeds = range(first_seed, first_seed + RECORDS)
    print(f"{'signal':14s} {'u of lag':>9s} {'coverage':>9s} {'median u':>9s} {'rms error':>9s}")
    for kind in KINDS:
        for lag_u_s in (0.0, 0.1):
            share, u, rms = figures(kind, seeds, lag_u_s)
            print(f"{kind:14s} {lag_u_s:7.2f} s {share:9.3f} {u:9.3f} {rms:9.3f}", flush=True)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
