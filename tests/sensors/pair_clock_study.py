"""Clocks of two loggers of a pair of sensors: rate, detection and false alarms.

`python -m tests.sensors.pair_clock_study [RECORDS] [SEED] [KIND]` prints for each kind of record,
or for one (steady, lags), the number of warnings ``sensor.pair_clock``. The readings are sums of
sines behind one lag each, at exact times, without any code of the package.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tcdyn.sensors.file import SensorFile
from tcdyn.sensors.pair import pair_sensor

Array = NDArray[np.float64]

LAGS_S = (0.2, 0.8)


def sines(seed: int, count: int = 40) -> tuple[Array, Array, Array]:
    """Angular frequencies [rad/s], amplitudes [K] and phases of a turbulent gas."""
    rng = np.random.default_rng(seed)
    frequencies = 2 * np.pi * np.geomspace(0.02, 5.0, count) * rng.uniform(0.95, 1.05, count)
    amplitudes = 12.0 * (1 + frequencies) ** -0.5
    return frequencies, amplitudes, rng.uniform(0.0, 2 * np.pi, count)


def reading(times_s: Array, gas: tuple[Array, Array, Array], lag_s: float) -> Array:
    """The steady response of one lag to the sines [degC]."""
    frequencies, amplitudes, phases = gas
    size = amplitudes / np.hypot(1.0, frequencies * lag_s)
    angle = np.outer(times_s, frequencies) + phases - np.arctan(frequencies * lag_s)
    return 400.0 + np.cos(angle) @ size


def pair_of(
    seed: int,
    rate: float = 0.0,
    change: float = 0.0,
    noise: str = "white",
    n: int = 3000,
    dt_s: float = 0.02,
) -> SensorFile:
    """Lags of a record whose second column is stamped by a clock that is faster by ``rate``.

    Both lags rise by the share ``change`` from start to end: so slowly that the response is that of
    the lag of the moment. ``noise``: "white", "ar" (AR(0.9)), or "drift" (white; the second reading
    drifts by 2 % of its range).
    """
    rng = np.random.default_rng(10_000 + seed)
    gas = sines(seed)
    stamps_s = np.asarray(dt_s * np.arange(n), dtype=np.float64)
    shares = 1 + change * (np.arange(n) / n - 0.5)
    columns: list[Array] = []
    for lag_s, faster in zip(LAGS_S, (0.0, rate)):
        true_s = np.asarray(stamps_s / (1 + faster), dtype=np.float64)
        if change:
            blocks = np.array_split(np.arange(n), n // 10)
            y = np.concatenate(
                [reading(true_s[rows], gas, lag_s * shares[rows].mean()) for rows in blocks]
            )
        else:
            y = reading(true_s, gas, lag_s)
        white = rng.normal(0.0, 0.1, n)
        if noise == "ar":
            coloured = np.zeros(n)
            for k in range(1, n):
                coloured[k] = 0.9 * coloured[k - 1] + 0.3 * white[k]
            white = coloured
        elif noise == "drift" and columns:
            white = white + 0.02 * np.ptp(y) * np.arange(n) / n
        columns.append(y + white)
    first, second = columns
    return pair_sensor(stamps_s, first, second, ("fine", "coarse"), bare=True)


def rate_of(sensor: SensorFile) -> tuple[float, float] | None:
    """Rate and standard uncertainty of the warning [ppm]; None without one."""
    for finding in sensor.findings:
        if finding.code == "sensor.pair_clock":
            return finding.numbers["rate_ppm"], finding.numbers["u_ppm"]
    return None


def print_row(name: str, count: int, seed: int, rate: float = 0.0, **options: Any) -> None:
    """Print the warnings of one kind of record, and the errors of their rates."""
    found = [rate_of(pair_of(seed + k, rate, **options)) for k in range(count)]
    warned = [each for each in found if each is not None]
    text = ""
    if warned and rate:
        z = [(each - 1e6 * rate) / u for each, u in warned]
        text = f"; (rate - truth)/u: mean {np.mean(z):+.2f}, sd {np.std(z):.2f}"
    print(f"{name:28s} {len(warned):4d} of {count}{text}", flush=True)


def main(count: int = 60, seed: int = 0, only: str = "") -> None:
    """Print a row for each kind of record."""
    if only in ("", "steady"):
        for noise in ("white", "ar", "drift"):
            for rate in (0.0, 1e-4, 3e-4):
                print_row(f"{noise}, {1e6 * rate:.0f} ppm", count, seed, rate, noise=noise)
    if only in ("", "lags"):
        for change in (0.02, 0.1, 0.3):
            print_row(f"lags change by {100 * change:.0f} %", count, seed, change=change)


if __name__ == "__main__":
    given = sys.argv[1:]
    count, seed, only = [*given, *["60", "0", ""][len(given) :]]
    main(int(count), int(seed), only)
