"""How often a settled step test with coloured noise is recommended only provisionally, or not at
all.

Run by hand: ``python -m step_study [RUNS] [MODELS]`` in this folder. The held-out part is the last,
where the output is at rest and any model is as bad as the mean of its noise. Lags, dead time and
noise are sampled anew for each run; the record is simulated on a grid ten times finer by
first-order recursions.
"""

from __future__ import annotations

import sys
from collections import Counter

import numpy as np
from scipy.signal import lfilter

from tcdyn.identification import IOData, compare

DT_S = 0.1
FINER = 10
MODELS = ("P1", "P1D", "P2", "P2D")


def step_test(seed: int, n: int = 600) -> IOData:
    """One step after a tenth of the record, two lags and a dead time, settled at half of it; AR(1)
    noise."""
    rng = np.random.default_rng(seed)
    h = DT_S / FINER
    u = np.where(np.arange(n * FINER) < 0.1 * n * FINER, 20.0, 80.0)
    delay_samples = round(rng.uniform(0.0, 0.5) / h)
    y = np.concatenate([np.full(delay_samples, u[0]), u[: len(u) - delay_samples]])
    for tau in (rng.uniform(1.0, 3.0), rng.uniform(0.2, 0.8)):
        a = np.exp(-h / tau)
        y = lfilter([0.0, 1 - a], [1.0, -a], y, zi=[y[0]])[0]
    a = rng.uniform(0.6, 0.97)
    noise_sd = rng.uniform(0.1, 1.0)
    noise = lfilter([noise_sd * np.sqrt(1 - a**2)], [1.0, -a], rng.normal(size=n + 2000))[2000:]
    return IOData.from_arrays(u[::FINER], y[::FINER] + noise, DT_S, hold="zoh")


def study(seeds: range, models: tuple[str, ...] = MODELS) -> Counter[str]:
    """Counts of the conclusions."""
    return Counter(compare(step_test(seed), models).conclusion.code for seed in seeds)


if __name__ == "__main__":
    models = tuple(sys.argv[2].split(",")) if len(sys.argv) > 2 else MODELS
    print(dict(study(range(int(sys.argv[1]) if len(sys.argv) > 1 else 100), models)))
