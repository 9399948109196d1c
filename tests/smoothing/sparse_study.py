"""Coverage of the bands of the smoother for records whose readings are sparse in one part.

`python -m tests.smoothing.sparse_study [RECORDS] [SEED]` prints for each layout, each temperature
and all records: coverage of the 95 % band (mean over the samples of each record, then over the
records; its standard deviation from record to record; lowest record), share of samples without a
result, the smallest u in medians of the u of samples with readings, the records in which it is
below a tenth, the largest error in u, and the CPU time a record. With `-v` it prints each record.

Loggers write such records where they save memory: a reading every minute, one a second while
something happens; or rows without a new value. The temperature and the reading are closed forms of
steps, approaches, ramps and sines behind one or two lags, which share no code with the package.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tcdyn.chain import NO_CONDITIONING, Chain
from tcdyn.core import Array
from tcdyn.smoothing.smoother import smooth

BASE_DEGC = 60.0
# fewest and most gaps before and after the dense part
LAYOUTS = {
    "sparse, dense": ((4, 10), (0, 0)),
    "dense, sparse": ((0, 0), (4, 10)),
    "sparse, dense, sparse": ((4, 10), (4, 10)),
    "first reading alone": ((1, 1), (0, 0)),
    "last reading alone": ((0, 0), (1, 1)),
}
SIGNALS = ("constant", "step while dense", "step in a gap", "approach", "ramp", "swing")
# gaps between sparse readings, in lags
SHORTEST_GAP_LAGS = 0.5
LONGEST_GAP_LAGS = 6.0
Input = Callable[[Array], tuple[Array, Callable[[float], Array]]]


@dataclass(frozen=True)
class SparseRecord:
    """A record on even times, NaN where the logger has no reading.

    Parameters
    ----------
    layout, signal
        Elements of ``LAYOUTS`` and ``SIGNALS``.
    lags_s
        Lags of the chain [s].
    dt_s
        Interval of the samples [s].
    truth, reading
        Temperature and reading (N,) [degC].
    """

    layout: str
    signal: str
    lags_s: tuple[float, ...]
    dt_s: float
    truth: Array
    reading: Array


@dataclass(frozen=True)
class Verdict:
    """How a band did: coverage and share of samples without a result, smallest u in medians of the
    u of samples with readings, largest error in u, CPU time [s]."""

    coverage: float
    empty: float
    least_u: float
    worst: float
    cpu_s: float


def through_lags(single: Callable[[float], Array], lags_s: tuple[float, ...]) -> Array:
    """Response of one or two lags [s], from that of one lag by partial fractions."""
    if len(lags_s) == 1:
        return single(lags_s[0])
    slow_s, fast_s = lags_s
    return (slow_s * single(slow_s) - fast_s * single(fast_s)) / (slow_s - fast_s)


def step(t: Array, at_s: float, height_K: float) -> tuple[Array, Callable[[float], Array]]:
    """A step, and its response behind a lag."""
    since = np.maximum(t - at_s, 0.0)

    def response(lag_s: float) -> Array:
        return -height_K * np.expm1(-since / lag_s)

    return height_K * (t >= at_s), response


def approach(
    t: Array, at_s: float, height_K: float, tau_s: float
) -> tuple[Array, Callable[[float], Array]]:
    """An exponential approach to a level, and its response behind a lag other than ``tau_s``."""
    since = np.maximum(t - at_s, 0.0)

    def response(lag_s: float) -> Array:
        slow = tau_s * np.exp(-since / tau_s) - lag_s * np.exp(-since / lag_s)
        return height_K * (1.0 - slow / (tau_s - lag_s))

    return -height_K * np.expm1(-since / tau_s), response


def ramp(t: Array, at_s: float, slope_K_s: float) -> tuple[Array, Callable[[float], Array]]:
    """A ramp from a time on, and its response behind a lag."""
    since = np.maximum(t - at_s, 0.0)

    def response(lag_s: float) -> Array:
        return slope_K_s * (since + lag_s * np.expm1(-since / lag_s))

    return slope_K_s * since, response


def sine(
    t: Array, amplitude_K: float, period_s: float, phase: float
) -> tuple[Array, Callable[[float], Array]]:
    """A sine that has always been there, and its response behind a lag."""
    w = 2 * np.pi / period_s

    def response(lag_s: float) -> Array:
        gain = amplitude_K / np.hypot(1.0, w * lag_s)
        return gain * np.sin(w * t + phase - np.arctan(w * lag_s))

    return amplitude_K * np.sin(w * t + phase), response


def sparse_rows(rng: np.random.Generator, count: int, lag_rows: float, start: int) -> list[int]:
    """``count`` rows from a gap after ``start`` on, with gaps of one or of random length."""
    low, high = SHORTEST_GAP_LAGS * lag_rows, LONGEST_GAP_LAGS * lag_rows
    gaps = rng.uniform(low, high, count)
    if rng.random() < 0.5:
        gaps[:] = gaps[:1]
    return (start + np.cumsum(np.maximum(np.round(gaps), 2)).astype(int)).tolist()


def simulate(index: int, seed: int) -> SparseRecord:
    """Record ``index`` of a seed: layout and signal follow the index, all else is random."""
    rng = np.random.default_rng([seed, index])
    layout = list(LAYOUTS)[index % len(LAYOUTS)]
    signal = SIGNALS[index // len(LAYOUTS) % len(SIGNALS)]
    lag_s = float(np.exp(rng.uniform(np.log(3.0), np.log(60.0))))
    lags_s = (lag_s,) if rng.random() < 0.6 else (lag_s, lag_s * rng.uniform(0.05, 0.4))
    lag_rows = rng.uniform(8.0, 30.0)
    dt_s = lag_s / lag_rows
    dense = int(rng.integers(150, 301))
    before, after = (int(rng.integers(low, high + 1)) for low, high in LAYOUTS[layout])
    sparse = sparse_rows(rng, before, lag_rows, 0)
    first = sparse[-1] if sparse else 0
    sparse += sparse_rows(rng, after, lag_rows, first + dense - 1)
    rows = sorted({0, *sparse, *range(first, first + dense)})
    present = np.zeros(rows[-1] + 1, dtype=bool)
    present[rows] = True
    t = np.arange(len(present)) * dt_s
    longest = int(np.argmax(np.diff(rows)))
    gap_s = (rows[longest] * dt_s, rows[longest + 1] * dt_s)
    dense_s = (first * dt_s, (first + dense - 1) * dt_s)
    height_K = float(rng.choice([-1.0, 1.0]) * np.exp(rng.uniform(np.log(3.0), np.log(80.0))))
    if signal == "constant":
        temperature, response = step(t, 0.0, 0.0)
    elif signal == "step while dense":
        temperature, response = step(t, rng.uniform(*dense_s), height_K)
    elif signal == "step in a gap":
        temperature, response = step(t, rng.uniform(*gap_s), height_K)
    elif signal == "approach":
        tau_s = lag_s * rng.uniform(4.0, 15.0)
        temperature, response = approach(t, rng.uniform(*dense_s), height_K, tau_s)
    elif signal == "ramp":
        start_s = rng.uniform(*dense_s)
        temperature, response = ramp(t, start_s, height_K / (t[-1] - start_s + lag_s))
    else:
        period_s = lag_s * rng.uniform(15.0, 60.0)
        temperature, response = sine(t, height_K, period_s, rng.uniform(0.0, 6.3))
    noise_K = float(np.exp(rng.uniform(np.log(0.01), np.log(0.1))))
    reading = BASE_DEGC + through_lags(response, lags_s) + rng.normal(0.0, noise_K, len(t))
    reading[~present] = np.nan
    return SparseRecord(layout, signal, lags_s, dt_s, BASE_DEGC + temperature, reading)


def judge(record: SparseRecord) -> Verdict:
    """Smooth a record as `tcdyn compensate` does, and compare it with the truth."""
    chain = Chain(record.lags_s, conditioning=NO_CONDITIONING)
    start = time.process_time()
    result = smooth(record.reading, record.dt_s, chain)
    spent = time.process_time() - start
    temperature, u = (column[:, 0] for column in result.determined_estimates())
    given = np.isfinite(temperature)
    z = np.abs(temperature - record.truth)[given] / np.maximum(u[given], 1e-12)
    typical = np.median(u[given & np.isfinite(record.reading)])
    return Verdict(
        float(np.mean(z < 1.96)),
        1.0 - float(np.mean(given)),
        float(np.min(u[given]) / typical),
        float(np.max(z)),
        spent,
    )


def report(records: int, seed: int, verbose: bool) -> None:
    """Print the table."""
    print(f"{'records':24s} cover %      sd  lowest  empty %  least u  below 0.1  max |e|/u  CPU s")
    groups: dict[str, list[Verdict]] = {name: [] for name in (*LAYOUTS, *SIGNALS, "all")}
    for index in range(records):
        record = simulate(index, seed)
        verdict = judge(record)
        for name in (record.layout, record.signal, "all"):
            groups[name].append(verdict)
        if verbose:
            print(f"  {index:3d} {record.layout:22s} {record.signal:17s} {_line([verdict])}")
    for name, verdicts in groups.items():
        if verdicts:
            print(f"{name:24s} {_line(verdicts)}")


def _line(verdicts: list[Verdict]) -> str:
    """Figures of some records."""
    coverage = 100 * np.array([v.coverage for v in verdicts])
    empty = 100 * np.mean([v.empty for v in verdicts])
    least_u = np.array([v.least_u for v in verdicts])
    worst = max(v.worst for v in verdicts)
    cpu = np.mean([v.cpu_s for v in verdicts])
    return (
        f"{coverage.mean():7.1f} {coverage.std():7.1f} {coverage.min():7.1f} {empty:8.1f} "
        f"{least_u.min():8.3f} {np.count_nonzero(least_u < 0.1):10d} {worst:10.1f} {cpu:6.2f}"
    )


if __name__ == "__main__":
    numbers = [int(a) for a in sys.argv[1:] if a.isdigit()]
    records_, seed_ = [*numbers, *(90, 0)[len(numbers) :]]
    report(records_, seed_, "-v" in sys.argv)
