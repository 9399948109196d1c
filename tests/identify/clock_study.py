"""Clocks of two loggers: rate, detection and false alarms of ``record.clock_drift``.

`python -m tests.identify.clock_study [RECORDS] [SEED] [KIND]` prints for each kind of record, or
for one (white, ar, drift, lag), the number of warnings, and the error of the rate over its standard
uncertainty. The outputs are sums of exponentials at exact times, without any code of the package.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tcdyn.estimation.clock_rate import clock_drift
from tcdyn.identification import Fit, IOData, fit, validate
from tcdyn.identification.clock_drift import clock_column, parameter_columns

Array = NDArray[np.floating[Any]]

LAG_S = 20.0
GAIN = 0.6


def switching_times(n: int, dt_s: float, seed: int) -> tuple[Array, Array]:
    """Times of the changes of the input, on rows, and its levels; the first one is before all."""
    rng = np.random.default_rng(seed)
    rows = np.cumsum(rng.integers(15, 80, n // 15))
    rows = rows[rows < n]
    return dt_s * rows, rng.uniform(0.0, 100.0, len(rows) + 1)


def held(times_s: Array, switches_s: Array, levels: Array) -> Array:
    """The input at any times: constant between the switches."""
    return levels[np.searchsorted(switches_s, times_s, side="right")]


def response(times_s: Array, switches_s: Array, levels: Array, lag_s: float) -> Array:
    """The output of one lag of gain ``GAIN``: a sum of exponentials since each switch."""
    steps = np.diff(levels)
    since_s = times_s[:, None] - switches_s
    parts = np.where(since_s > 0, -np.expm1(-np.maximum(since_s, 0.0) / lag_s), 0.0)
    return GAIN * (levels[0] + parts @ steps)


def two_loggers(
    rate: float, n: int, dt_s: float, noise: Array, seed: int, dead_s: float = 5.0
) -> IOData:
    """A record whose output is stamped by a clock that is faster by ``rate``."""
    switches_s, levels = switching_times(n, dt_s, seed)
    stamps_s = dt_s * np.arange(n)
    true_s = stamps_s / (1 + rate)  # when the clock of the output shows the stamp
    y = response(true_s - dead_s, switches_s, levels, LAG_S) + noise
    return IOData.from_arrays(held(stamps_s, switches_s, levels), y, dt_s, hold="zoh")


def changing_lag(n: int, dt_s: float, noise: Array, seed: int, change: float) -> IOData:
    """A record of one clock whose lag rises by the share ``change`` from start to end.

    The state is advanced exactly over each row, with the lag of its middle.
    """
    switches_s, levels = switching_times(n, dt_s, seed)
    u = held(dt_s * np.arange(n), switches_s, levels)
    lags_s = LAG_S * (1 + change * (np.arange(n) / n - 0.5))
    y = np.empty(n)
    y[0] = GAIN * u[0]
    for k in range(1, n):
        y[k] = GAIN * u[k - 1] + (y[k - 1] - GAIN * u[k - 1]) * np.exp(-dt_s / lags_s[k])
    return IOData.from_arrays(u, y + noise, dt_s, hold="zoh")


def noise_of(kind: str, n: int, sd: float, seed: int) -> Array:
    """Noise of a kind: "white", "ar" (AR(0.9)), or "drift" (white, with 2 % of the swing)."""
    rng = np.random.default_rng(10_000 + seed)
    white = rng.normal(0.0, sd, n)
    if kind == "ar":
        noise = np.zeros(n)
        for k in range(1, n):
            noise[k] = 0.9 * noise[k - 1] + white[k]
        return noise
    if kind == "drift":
        return white + 0.02 * GAIN * 100.0 * np.arange(n) / n
    return white


def has_warning(result: Fit) -> bool:
    """Whether the sentence of the fit has the warning."""
    return any(f.code == "record.clock_drift" for f in validate(result).findings)


def rate_over_u(result: Fit) -> tuple[float, float, float, float]:
    """Rate, its standard uncertainty, p of the other departures, and share."""
    columns = np.column_stack([clock_column(result), parameter_columns(result)])
    white = result.noise.whiten(columns, result.problem.residual_slices)
    found = clock_drift(result.innovation, result.jacobian, white[:, 0], white[:, 1:])
    assert found is not None
    return found.rate, found.u, found.other_p, found.share


def print_row(name: str, rate: float, count: int, make: Callable[[int], IOData]) -> None:
    """Fit the records of one kind, and print the share of warnings and the scatter of z."""
    warned = 0
    z = []
    shares = []
    for seed in range(count):
        result = fit(make(seed), "P1D")
        warned += has_warning(result)
        found, u, _, share = rate_over_u(result)
        z.append((found - rate) / u)
        shares.append(share)
    low, high = np.quantile(shares, [0.05, 0.95])
    print(
        f"{name:28s} {warned:4d} of {count}; (rate - truth)/u: mean {np.mean(z):+.2f}, "
        f"sd {np.std(z):.2f}, largest {np.max(np.abs(z)):.1f}; share {low:.2f} to {high:.2f}",
        flush=True,
    )


def record(kind: str, n: int, first_seed: int, rate: float, change: float, k: int) -> IOData:
    """The record of number ``k``: with a lag that changes, or of two loggers."""
    seed = first_seed + k
    noise = noise_of(kind, n, 0.2, seed)
    if change:
        return changing_lag(n, 1.0, noise, seed, change)
    return two_loggers(rate, n, 1.0, noise, seed)


def main(count: int = 60, seed: int = 0, only: str = "") -> None:
    """Print a row for each kind of record."""
    n = 2000
    for kind in ("white", "ar", "drift"):
        for rate in (0.0, 1e-4, 3e-4) if only in ("", kind) else ():
            make = partial(record, kind, n, seed, rate, 0.0)
            print_row(f"{kind}, {1e6 * rate:.0f} ppm", rate, count, make)
    for change in (0.02, 0.1, 0.3) if only in ("", "lag") else ():
        make = partial(record, "white", n, seed, 0.0, change)
        print_row(f"lag changes by {100 * change:.0f} %", 0.0, count, make)


if __name__ == "__main__":
    given = sys.argv[1:]
    count, seed, only = [*given, *["60", "0", ""][len(given) :]]
    main(int(count), int(seed), only)
