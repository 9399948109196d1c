"""Study: what is lost by intensities that come from parts of a long record.

``python -m tests.smoothing.long_record_study [RECORDS] [SEED]`` prints, for each signal, rms error,
median standard uncertainty, coverage of the 95 % band and CPU time, with intensities from parts of
the record and from all of it. The coverage of the "rough stretch" is that of the stretch alone: it
lies between two parts, which do not show it.

The readings come from a recursion that is exact for an input that is linear between the points of a
grid four times finer than the samples.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from unittest import mock

import numpy as np
from scipy.signal import lfilter

from tcdyn.chain import NO_CONDITIONING, Chain
from tcdyn.core import Array
from tcdyn.smoothing import roughness, smooth
from tests.smoothing.band_study import stage_polynomials

LAG_S = 0.5
DT_S = 1 / 75
NOISE_K = 0.05
ROWS = 400_000
FINE = 4
Signal = Callable[[Array, np.random.Generator], Array]
# samples of the stretch: in the middle between two of the 16 parts
STRETCH = slice(147_000, 153_000)


def sines(t: Array, rng: np.random.Generator) -> Array:
    """5 K with a period of 19 s and 2 K with one of 6 s."""
    first, second = rng.uniform(0, 6, 2)
    return 5 * np.sin(t / 3 + first) + 2 * np.sin(t + second)


def random_walk(t: Array, rng: np.random.Generator) -> Array:
    """By 1 K in 1 s."""
    return np.cumsum(rng.standard_normal(len(t))) * np.sqrt(t[1] - t[0])


def rough_stretch(t: Array, rng: np.random.Generator) -> Array:
    """Sines, and in 80 s noise of 2 K with a correlation time of 2 s."""
    keep = np.exp(-(t[1] - t[0]) / 2.0)
    count = (STRETCH.stop - STRETCH.start) * FINE
    rough = lfilter([1.0], [1.0, -keep], rng.standard_normal(count) * np.sqrt(1 - keep**2))
    x = sines(t, rng)
    x[STRETCH.start * FINE : STRETCH.stop * FINE] += 2 * rough * np.hanning(count) ** 0.25
    return x


SIGNALS: dict[str, Signal] = {
    "sines": sines,
    "random walk": random_walk,
    "rough stretch": rough_stretch,
}


def figures(name: str, seed: int, from_all: bool) -> tuple[float, float, float, float]:
    """Mean square error [K2], median u [K], coverage and CPU time [s] of one record."""
    rng = np.random.default_rng(seed)
    t = np.arange(ROWS * FINE) * DT_S / FINE
    x = 80 + SIGNALS[name](t, rng)
    b, a = stage_polynomials(LAG_S, DT_S / FINE)
    y = lfilter(b, a, x - x[0])[::FINE] + x[0] + NOISE_K * rng.standard_normal(ROWS)
    samples_of_part = ROWS if from_all else roughness.PART_SAMPLES
    start_s = time.process_time()
    with mock.patch.object(roughness, "PART_SAMPLES", samples_of_part):
        result = smooth(y, DT_S, Chain(LAG_S, conditioning=NO_CONDITIONING))
    spent_s = time.process_time() - start_s
    judged = STRETCH if name == "rough stretch" else slice(None)
    error = (result.temperature[:, 0] - x[::FINE])[judged]
    sd = result.sd[judged, 0]
    covered = float(np.mean(np.abs(error) < 1.96 * sd))
    return float(np.mean(error**2)), float(np.median(sd)), covered, spent_s


def main(records: int, first_seed: int) -> None:
    """Print the table."""
    print(f"{'signal':14s} {'from':>6s} {'rms K':>8s} {'u K':>8s} {'coverage':>9s} {'CPU s':>7s}")
    for name in SIGNALS:
        for from_all in (False, True):
            seeds = range(first_seed, first_seed + records)
            square, u, covered, spent = np.mean([figures(name, s, from_all) for s in seeds], axis=0)
            kind = "all" if from_all else "parts"
            rms = np.sqrt(square)
            print(
                f"{name:14s} {kind:>6s} {rms:8.4f} {u:8.4f} {covered:9.3f} {spent:7.1f}", flush=True
            )


if __name__ == "__main__":
    given = [int(argument) for argument in sys.argv[1:]]
    main(*[*given, *(3, 0)[len(given) :]])
