"""Coverage behind a logger that writes means.

``python -m tests.smoothing.mean_study [RECORDS [SEED]]``

The simulator is the recursion of one lag every 2 ms and a running sum; it shares no code with the
smoother. The temperatures are an Ornstein-Uhlenbeck process, three sines, and exponential
approaches to new levels.
"""

from __future__ import annotations

import sys

import numpy as np
from scipy.signal import lfilter

from tcdyn.chain import Chain
from tcdyn.core import Array
from tcdyn.smoothing import smooth

STEP_S = 0.002
DURATION_S = 200.0
LAG_S = 0.8
ROW_S = 0.5
NOISE_K = 0.02
FIRST_S = 10.0


def rough(rng: np.random.Generator, time_s: Array) -> Array:
    """Ornstein-Uhlenbeck process of 4 s and 3 K."""
    kept = np.exp(-STEP_S / 4.0)
    drive = 3.0 * np.sqrt(1 - kept**2) * rng.standard_normal(len(time_s))
    return 20 + lfilter([1.0], [1.0, -kept], drive)


def sines(rng: np.random.Generator, time_s: Array) -> Array:
    """Three sines of 25, 11 and 6 s."""
    phases = rng.uniform(0, 2 * np.pi, 3)
    waves = zip((5.0, 2.0, 0.5), (0.04, 0.09, 0.16), phases)
    return 20 + sum(a * np.sin(2 * np.pi * f * time_s + p) for a, f, p in waves)


def approaches(rng: np.random.Generator, time_s: Array) -> Array:
    """Six levels, approached with a time constant of 8 s."""
    start_s = np.sort(rng.uniform(0, DURATION_S, 6))
    levels = np.append(20.0, rng.uniform(15, 40, 6))
    target = levels[np.searchsorted(start_s, time_s)]
    kept = np.exp(-STEP_S / 8.0)
    return levels[0] + lfilter([1 - kept], [1, -kept], target - levels[0])


TEMPERATURES = {"rough": rough, "sines": sines, "approaches": approaches}


def rows_of(rng: np.random.Generator, temperature: Array, mean_s: float) -> tuple[Array, Array]:
    """Temperatures at the rows, and the rows."""
    kept = np.exp(-STEP_S / LAG_S)
    lagged = temperature[0] + lfilter([1 - kept], [1, -kept], temperature - temperature[0])
    count = max(round(mean_s / STEP_S), 1)
    total = np.concatenate([[0.0], np.cumsum(lagged)])
    at = np.arange(round(FIRST_S / STEP_S), len(temperature), round(ROW_S / STEP_S))
    rows = (total[at + 1] - total[at + 1 - count]) / count
    return temperature[at], rows + NOISE_K * rng.standard_normal(len(at))


def main(records: int, seed: int) -> None:
    """Print a line for each temperature, mean and chain."""
    print("temperature  mean_s  chain         coverage  worst  rms_K   median_u_K")
    time_s = STEP_S * np.arange(round(DURATION_S / STEP_S))
    for name, temperature_of in TEMPERATURES.items():
        for mean_s in (0.0, 0.25, 0.5, 1.5):
            chains = {"with mean": Chain(LAG_S, mean_s=mean_s)}
            if mean_s:
                chains |= {"delay only": Chain(LAG_S, delay_s=0.5 * mean_s), "none": Chain(LAG_S)}
            found: dict[str, list[list[float]]] = {label: [] for label in chains}
            for record in range(records):
                rng = np.random.default_rng([seed, record])
                truth, rows = rows_of(rng, temperature_of(rng, time_s), mean_s)
                for label, chain in chains.items():
                    result = smooth(rows, ROW_S, chain)
                    error = result.temperature[:, 0] - truth
                    sd = result.sd[:, 0]
                    inside = float(np.mean(np.abs(error) < 1.96 * sd))
                    found[label].append([inside, np.mean(error**2), np.median(sd)])
            for label, values in found.items():
                inside, square, sd = np.mean(values, axis=0)
                worst = min(row[0] for row in values)
                which = f"{name:12s} {mean_s:6.2f}  {label:12s}"
                covered = f"{100 * inside:6.1f} % {100 * worst:5.0f}"
                print(f"{which}  {covered} {np.sqrt(square):7.3f} {sd:9.3f}", flush=True)


if __name__ == "__main__":
    main(*(int(word) for word in (*sys.argv[1:], *("10", "6100")[len(sys.argv) - 1 :])))
