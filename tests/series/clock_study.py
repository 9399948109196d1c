"""How well the clock of a log is found: rate, misplaced rows, uncertainty.

``python -m tests.series.clock_study RECORDS SEED`` prints one row for each case. The stamps are
made here, without any function of the package.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tcdyn.series import fit_clock

N_ROWS = 6000
# The clock of the logger against the nominal rate.
CLOCK_ERROR = 2.3e-5


@dataclass(frozen=True)
class Case:
    """Stamps of one kind.

    Attributes
    ----------
    rate_Hz
        Nominal rate.
    jitter
        Standard deviation of the stamps, in intervals.
    lost
        Share of the rows that are lost.
    gap
        Rows of one gap in the middle.
    tick_s
        Step to which the stamps are cut [s]; 0: none.
    wander
        Amplitude of a slow wave of the clock with three periods, in intervals.
    """

    rate_Hz: float = 100.0
    jitter: float = 0.0
    lost: float = 0.0
    gap: int = 0
    tick_s: float = 0.0
    wander: float = 0.0


CASES = {
    "even": Case(),
    "jitter 5 %": Case(jitter=0.05),
    "jitter 10 %": Case(jitter=0.10),
    "jitter 17 %": Case(jitter=0.17),
    "jitter 25 %": Case(jitter=0.25),
    "1 % lost": Case(lost=0.01),
    "jitter 5 %, 1 % lost": Case(jitter=0.05, lost=0.01),
    "jitter 10 %, 1 % lost": Case(jitter=0.10, lost=0.01),
    "jitter 17 %, 1 % lost": Case(jitter=0.17, lost=0.01),
    "jitter 25 %, 1 % lost": Case(jitter=0.25, lost=0.01),
    "jitter 10 %, gap of 80": Case(jitter=0.10, gap=80),
    "jitter 25 %, gap of 80": Case(jitter=0.25, gap=80),
    "75 Hz in ms": Case(rate_Hz=75.0, tick_s=1e-3),
    "75 Hz in ms, 1 % lost": Case(rate_Hz=75.0, tick_s=1e-3, lost=0.01),
    "10 Hz in s": Case(rate_Hz=10.0, tick_s=1.0),
    "10 Hz in s, gap of 80": Case(rate_Hz=10.0, tick_s=1.0, gap=80),
    "9.7 Hz in s": Case(rate_Hz=9.7, tick_s=1.0),
    "9.7 Hz in s, 1 % lost": Case(rate_Hz=9.7, tick_s=1.0, lost=0.01),
    "10 Hz in s, jitter 25 %": Case(rate_Hz=10.0, tick_s=1.0, jitter=0.25),
    "75 Hz in 0.1 s, 1 % lost": Case(rate_Hz=75.0, tick_s=0.1, lost=0.01),
    "one row in 1.5 s, in s": Case(rate_Hz=1 / 1.5, tick_s=1.0),
    "one row in 1.5 s, in s, 5 % lost": Case(rate_Hz=1 / 1.5, tick_s=1.0, lost=0.05),
    "30 % lost, jitter 5 %": Case(lost=0.3, jitter=0.05),
    "60 % lost": Case(lost=0.6),
    "wander by 1 interval": Case(wander=1.0, jitter=0.1),
    # a limit, see the page on limits
    "10 Hz in s, 1 % lost": Case(rate_Hz=10.0, tick_s=1.0, lost=0.01),
}


def make_stamps(
    case: Case, rng: np.random.Generator, n_rows: int = N_ROWS
) -> tuple[NDArray[np.float64], NDArray[np.intp], float]:
    """Stamps [s] of a case, the true sample of each row, and the true interval [s]."""
    samples = np.arange(n_rows)
    if case.lost:
        samples = samples[rng.random(n_rows) > case.lost]
    if case.gap:
        is_left = samples < n_rows // 2
        is_right = samples >= n_rows // 2 + case.gap
        samples = samples[is_left | is_right]
    interval_s = (1 + CLOCK_ERROR) / case.rate_Hz
    stamps_s = 3.1 + interval_s * samples
    stamps_s = stamps_s + case.jitter / case.rate_Hz * rng.normal(size=len(samples))
    wave = np.sin(6 * np.pi * samples / n_rows)
    # a logger writes its rows one after the other
    stamps_s = np.sort(stamps_s + case.wander / case.rate_Hz * wave)
    if case.tick_s:
        stamps_s = np.floor(stamps_s / case.tick_s) * case.tick_s
    return stamps_s, samples - samples[0], interval_s


def n_misplaced(found: NDArray[np.intp], true: NDArray[np.intp]) -> tuple[int, int]:
    """Rows whose sample is wrong, whatever the first sample is, and the largest error."""
    error = found - true
    error = error - int(np.median(error))
    return int(np.count_nonzero(error)), int(np.abs(error).max())


def main(n_records: int, seed: int) -> None:
    """Print one row for each case.

    Parameters
    ----------
    n_records
        Records of each case.
    seed
        Seed of the random numbers.
    """
    print("case: largest error of the rate, rows misplaced (largest share), by how many samples,")
    print("error of the interval over its standard uncertainty (rms)")
    for k, (name, case) in enumerate(CASES.items()):
        rate_errors, shares, sizes, pulls = [], [], [], []
        for record in range(n_records):
            rng = np.random.default_rng([seed, k, record])
            stamps_s, samples, interval_s = make_stamps(case, rng)
            clock = fit_clock(stamps_s)
            count, size = n_misplaced(clock.index, samples)
            rate_errors.append(abs(clock.interval_s / interval_s - 1))
            shares.append(count / len(samples))
            sizes.append(size)
            if clock.u_interval_s > 0:
                pulls.append((clock.interval_s - interval_s) / clock.u_interval_s)
        pull = float(np.sqrt(np.mean(np.square(pulls)))) if pulls else 0.0
        print(
            f"{name:34s} {max(rate_errors):8.1e} {100 * max(shares):8.3f} % "
            f"{max(sizes):4d} {pull:8.2f}"
        )


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
