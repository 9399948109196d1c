"""Tests whose noise violates the assumptions of the fits: noise before the conditioning filter, and
slip-ring bursts.

`python -m tests.partition.noise_study before 100` prints coverage, refusals and alarms; worlds:
before, bursts, both.
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
from tests.partition.coverage_study import report, study_errors
from tests.partition.study_rigs import study_rig

RATE_HZ = 75.0
FINE = 8
CUTOFF_HZ = 4.0


def filtered(u: Array) -> Array:
    """``u`` (n FINE,) after two first-order lags of 4 Hz, sampled at 75 Hz (n,)."""
    decay = np.exp(-2 * np.pi * CUTOFF_HZ / (RATE_HZ * FINE))
    once = lfilter([1 - decay], [1, -decay], u)
    return np.asarray(lfilter([1 - decay], [1, -decay], once)[FINE - 1 :: FINE])


def before_the_filter(
    rng: np.random.Generator, n: int, sd: float = 0.12, share: float = 0.97
) -> Array:
    """Noise (n,) [K] of ``sd``, of which the amplitude share ``share`` is coloured by the
    filter."""
    coloured = filtered(rng.standard_normal((n + 75) * FINE))[75:]
    return sd * (
        share * coloured / np.std(coloured) + np.sqrt(1 - share**2) * rng.standard_normal(n)
    )


def bursts(rng: np.random.Generator, n: int, every_s: float = 60.0) -> Array:
    """Contact losses of 20 to 300 ms of either sign, one per ``every_s`` on average, filtered (n,)
    [K]."""
    signal = np.zeros((n + 75) * FINE)
    for start in rng.integers(0, n * FINE, rng.poisson(n / RATE_HZ / every_s)):
        length = int(rng.uniform(0.02, 0.3) * RATE_HZ * FINE)
        signal[start : start + length] = rng.choice([-1.0, 1.0]) * (1.5 + rng.exponential(4.0))
    return filtered(signal)[:n]


WORLDS: dict[str, Callable[[np.random.Generator, int], Array]] = {
    "white": lambda rng, n: 0.12 * rng.standard_normal(n),
    "before": before_the_filter,
    "bursts": lambda rng, n: 0.12 * rng.standard_normal(n) + bursts(rng, n),
    "both": lambda rng, n: before_the_filter(rng, n) + bursts(rng, n),
}


def run_case(seed: int, world: str) -> dict[str, float]:
    """Errors in standard uncertainties and alarms of one drawn rig in one world."""
    warnings.simplefilter("ignore")
    rng = np.random.default_rng([seed, 15])
    truth = draw_truth(seed, load_rig(), uncertain=True)
    noiseless = truth.with_imperfections(
        replace(truth.imperfections, noise=False, spikes=False, quantise=False)
    )

    def with_noise(frame: pd.DataFrame) -> pd.DataFrame:
        names = [f"{d}_{c}_degC" for d in DISKS for c in CHANNELS]
        noisy_columns = {name: frame[name] + WORLDS[world](rng, len(frame)) for name in names}
        return frame.assign(
            **{name: np.round(x / 0.013) * 0.013 for name, x in noisy_columns.items()}
        )

    try:
        study = study_rig(seed, truth=noiseless, log_change=with_noise)
        return study_errors(study, study.analyse())
    except InputError as problem:
        print(seed, problem)
        return {"failed": 1.0}


def run_study(world: str, count: int, first: int = 3000, n_jobs: int = 2) -> pd.DataFrame:
    """One row per drawn rig."""
    return pd.DataFrame(
        Parallel(n_jobs=n_jobs)(delayed(run_case)(s, world) for s in range(first, first + count))
    )


if __name__ == "__main__":
    table = run_study(sys.argv[1], int(sys.argv[2]), *map(int, sys.argv[3:4]))
    print(report(table).to_string())
    print("failed", table["failed"].sum(), "alarms", table["alarm"].sum())
    print(table["sentence"].to_string() if len(table) <= 8 else "")
