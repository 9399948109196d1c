"""How well the real share of the deviations of stamps is told: coverage and false certainty.

``python -m tests.series.real_share_study RECORDS SEED`` prints one row for each kind of columns and
each true share. The readings are made here, without any function of the package.
"""

from __future__ import annotations

import sys

import numpy as np
from numpy.typing import NDArray

from tcdyn.series import RealShare, fit_clock, real_share

Values = NDArray[np.float64]

JITTER = 0.1  # of the stamps, in intervals
TRUE_SHARES = (0.0, 0.5, 1.0)
KINDS = (
    "ramp",
    "ramp and counter",
    "ramp and valve",
    "counter",
    "switch",
    "valve with decimals",
    "mostly at rest",
    "quantised ramp",
    "quantised ramp, one step a row",
    "quantised wave",
    "wave of 60 rows",
    "noisy wave",
)
# A wrong share is certain if it is off by more than this, with a standard uncertainty below it.
CERTAIN = 0.1


def columns_of(kind: str, taken: Values, rng: np.random.Generator) -> list[Values]:
    """Columns that are read at the times ``taken`` (N,), in intervals."""
    n = len(taken)
    row = np.arange(float(n))
    ramp = 20 + 0.5 * taken + rng.normal(0, 0.01, n)
    switch = np.where(row // 37 % 2 == 0, 0.0, 1.0)
    valve = np.where(switch > 0, 100 - 0.01 * rng.integers(0, 3, n), 0.0)
    heated = 20 + 60 * np.clip((taken - n / 2) / 40, 0, 1) + rng.normal(0, 0.05, n)
    wave = 20 + 5 * np.sin(2 * np.pi * taken / 60)
    made: dict[str, list[Values]] = {
        "ramp": [ramp],
        "ramp and counter": [ramp, row],
        "ramp and valve": [ramp, valve],
        "counter": [row],
        "switch": [switch],
        "valve with decimals": [valve],
        "mostly at rest": [np.round(heated / 0.5) * 0.5],
        "quantised ramp": [np.round((20 + 0.13 * taken) / 0.1) * 0.1],
        "quantised ramp, one step a row": [np.round(20 + 0.1 * taken, 1)],
        "quantised wave": [np.round(wave, 1)],
        "wave of 60 rows": [wave + rng.normal(0, 0.02, n)],
        "noisy wave": [wave + rng.normal(0, 0.3, n)],
    }
    return made[kind]


def found_share(kind: str, true_share: float, n_rows: int, seed: list[int]) -> RealShare:
    """The share that is found in one record."""
    rng = np.random.default_rng(seed)
    row = np.arange(float(n_rows))
    late = rng.normal(0, JITTER, n_rows)
    columns = columns_of(kind, row + true_share * late, rng)
    return real_share(fit_clock(row + late), columns)


def main(n_records: int, seed: int) -> None:
    """Print one row for each kind of columns and each true share.

    Parameters
    ----------
    n_records
        Records of each.
    seed
        Seed of the random numbers.
    """
    print("columns, true share: mean, median of u, share of 95 % intervals that hold, wrong and")
    print("certain (of all records); where nothing is told, the prior is left: 1 +- 0.5")
    for kind in KINDS:
        for true_share in TRUE_SHARES:
            found = [found_share(kind, true_share, 400, [seed, k]) for k in range(n_records)]
            values = np.array([each.value for each in found])
            u = np.array([each.u for each in found])
            error = np.abs(values - true_share)
            coverage = float(np.mean(error <= 2.0 * u))
            n_certain = int(np.count_nonzero((error > CERTAIN) & (u < CERTAIN / 2)))
            print(
                f"{kind:32s} {true_share:4.1f} {values.mean():6.3f} {np.median(u):6.3f} "
                f"{100 * coverage:6.1f} % {n_certain:4d}"
            )


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
