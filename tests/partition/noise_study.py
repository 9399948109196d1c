"""Tests whose noise breaks what fits assume: most of it from before the conditioning filter, and slip rings that burst.

`python -m tests.partition.noise_study before 100` prints coverage, refusals and alarms; worlds: before, bursts, both.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd
from joblib import Parallel, delayed
from scipy.signal import lfilter

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.rig.disk import CHANNELS, DISKS
from tcdyn.rig.rigfile import load_rig
from tcdyn.simulate.truth import draw_truth
from tests.partition.coverage_study import report, told_of
from tests.partition.study_rigs import study_rig

RATE_HZ, FINE, CUTOFF_HZ = 75.0, 8, 4.0


def filtered(u: Array) -> Array:
    """``u`` (n FINE,) before two lags of 4 Hz, sampled behind them (n,)."""
    keep = np.exp(-2 * np.pi * CUTOFF_HZ / (RATE_HZ * FINE))
    once = lfilter([1 - keep], [1, -keep], u)
    return np.asarray(lfilter([1 - keep], [1, -keep], once)[FINE - 1 :: FINE])


def before_the_filter(
    rng: np.random.Generator, n: int, sd: float = 0.12, share: float = 0.97
) -> Array:
    """Noise (n,) [K] of ``sd``, ``share`` of its amplitude coloured by the filter."""
    coloured = filtered(rng.standard_normal((n + 75) * FINE))[75:]
    return sd * (
        share * coloured / np.std(coloured) + np.sqrt(1 - share**2) * rng.standard_normal(n)
    )


def bursts(rng: np.random.Generator, n: int, every_s: float = 60.0) -> Array:
    """Contact losses of 20 to 300 ms, either sign, once in ``every_s``, rounded by the filter (n,) [K]."""
    rings = np.zeros((n + 75) * FINE)
    for start in rng.integers(0, n * FINE, rng.poisson(n / RATE_HZ / every_s)):
        length = int(rng.uniform(0.02, 0.3) * RATE_HZ * FINE)
        rings[start : start + length] = rng.choice([-1.0, 1.0]) * (1.5 + rng.exponential(4.0))
    return filtered(rings)[:n]


WORLDS: dict[str, Callable[[np.random.Generator, int], Array]] = {
    "white": lambda rng, n: 0.12 * rng.standard_normal(n),
    "before": before_the_filter,
    "bursts": lambda rng, n: 0.12 * rng.standard_normal(n) + bursts(rng, n),
    "both": lambda rng, n: before_the_filter(rng, n) + bursts(rng, n),
}


def one(seed: int, world: str) -> dict[str, float]:
    """Errors in standard uncertainties, and the alarms, of one drawn rig in one world."""
    warnings.simplefilter("ignore")
    rng = np.random.default_rng([seed, 15])
    true = draw_truth(seed, load_rig(), uncertain=True)
    quiet = true.with_imperfections(
        replace(true.imperfections, noise=False, spikes=False, quantise=False)
    )

    def noisy(frame: pd.DataFrame) -> pd.DataFrame:
        names = [f"{d}_{c}_degC" for d in DISKS for c in CHANNELS]
        added = {name: frame[name] + WORLDS[world](rng, len(frame)) for name in names}
        return frame.assign(**{name: np.round(x / 0.013) * 0.013 for name, x in added.items()})

    try:
        made = study_rig(seed, truth=quiet, disturbed=noisy)
        return told_of(made, made.analyse())
    except InputError as problem:
        print(seed, problem)
        return {"failed": 1.0}


def study(world: str, count: int, first: int = 3000, n_jobs: int = 2) -> pd.DataFrame:
    """One row per drawn rig."""
    return pd.DataFrame(
        Parallel(n_jobs=n_jobs)(delayed(one)(s, world) for s in range(first, first + count))
    )


if __name__ == "__main__":
    table = study(sys.argv[1], int(sys.argv[2]), *map(int, sys.argv[3:4]))
    print(report(table).to_string())
    print("failed", table["failed"].sum(), "alarms", table["alarm"].sum())
    print(table["sentence"].to_string() if len(table) <= 8 else "")
