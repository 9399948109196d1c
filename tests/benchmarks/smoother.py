"""CPU time of the smoother for a million samples: ``python -m tests.benchmarks.smoother``.

One channel with the lags of a thermocouple in a sheath, 0.75 and 0.12 s, and a filter of two poles
at 4 Hz, at 75 samples a second.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

import numpy as np

from tcdyn.chain import Chain
from tcdyn.estimation.kalman import log_likelihood, smooth_points
from tcdyn.rig.disk import Conditioning
from tcdyn.smoothing import Intensity, smooth
from tcdyn.smoothing.record import record_of
from tcdyn.smoothing.state_space import channel_ranges, point_models

CHAIN = Chain((0.75, 0.12), conditioning=Conditioning(cutoff_Hz=4.0, poles=2))
DT_S = 1 / 75
NOISE_K = 0.05


def report(name: str, samples: int, function: Callable[[], object]) -> None:
    """Print the CPU time of a call, for a million samples."""
    start_s = time.process_time()
    function()
    spent_s = time.process_time() - start_s
    print(f"{name:44s} {1e6 * spent_s / samples:7.2f} s", flush=True)


def main(samples: int) -> None:
    """Print the table."""
    t = DT_S * np.arange(samples)
    truth = 80 + 5 * np.sin(t / 3) + 2 * np.sin(t)
    y = CHAIN.response(truth, DT_S) + np.random.default_rng(0).normal(0.0, NOISE_K, samples)
    start_s = time.perf_counter()
    smooth(y[:3000], DT_S, CHAIN)
    print(f"{'first call, time of the clock':44s} {time.perf_counter() - start_s:7.2f} s")
    record = record_of(y, DT_S, CHAIN, (), NOISE_K)
    span_K = float(channel_ranges(record)[0])
    _, (model,) = point_models(record, 0, NOISE_K**2, [Intensity.constant(10.0)], span_K)
    report("log likelihood", samples, lambda: log_likelihood(model))
    report("smoother", samples, lambda: smooth_points(model))
    count = min(samples, 100_000)
    short = record_of(y[:count], DT_S, CHAIN, (), NOISE_K)
    _, (part,) = point_models(short, 0, NOISE_K**2, [Intensity.constant(10.0)], span_K)
    report(
        "smoother, covariances at each sample", count, lambda: smooth_points(part, tolerance=0.0)
    )
    report("smooth, all estimated", samples, lambda: smooth(y, DT_S, CHAIN))


if __name__ == "__main__":
    main(int(float(sys.argv[1])) if len(sys.argv) > 1 else 1_000_000)
