"""Means over the shortest time that is determined: their band, and whether they are determined.

`python -m tests.smoothing.time_means_study COUNT SEED` smooths COUNT records of each kind with
``means="auto"`` and prints one line: the time, coverage of the 95 % interval of the means (mean and
lowest record), median u over rms error (median of the records), the share of the changes between
neighbouring means that is explained, that of single rows, and coverage of means over four times as
long. The lag is one exponential, applied to a temperature on a grid that is ten times finer than
the rows.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np
from scipy.signal import lfilter

from tcdyn import Chain
from tcdyn.chain import NO_CONDITIONING
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.smoothing import smooth
from tcdyn.smoothing.time_means import TimeMeans

FINER = 10
ROWS = 1500
DT_S = 0.1


def correlated(rng: np.random.Generator, time_s: Array, scale_s: float) -> Array:
    """An Ornstein-Uhlenbeck process of variance one."""
    keep = np.exp(-(time_s[1] - time_s[0]) / scale_s)
    return np.asarray(lfilter([np.sqrt(1 - keep**2)], [1, -keep], rng.normal(size=len(time_s))))


def with_spectrum(rng: np.random.Generator, time_s: Array, exponent: float) -> Array:
    """A random temperature of variance one with a spectrum f^-exponent."""
    frequency = np.fft.rfftfreq(len(time_s), time_s[1] - time_s[0])
    size = np.zeros(len(frequency))
    size[1:] = frequency[1:] ** (-exponent / 2)
    phases = rng.normal(size=(2, len(frequency)))
    x = np.fft.irfft(size * (phases[0] + 1j * phases[1]), len(time_s))
    return np.asarray((x - x.mean()) / x.std())


def staircase(rng: np.random.Generator, time_s: Array) -> Array:
    """Constant temperatures between sudden changes."""
    level = np.zeros(len(time_s))
    for at_s in rng.uniform(5, time_s[-1] - 5, 6):
        level += rng.normal() * (time_s > at_s)
    return level


Kind = Callable[[np.random.Generator, Array], Array]
KINDS: dict[str, Kind] = {
    "OU, 5 s": lambda rng, t: correlated(rng, t, 5.0),
    "OU, 0.5 s": lambda rng, t: correlated(rng, t, 0.5),
    "spectrum f^-2.5": lambda rng, t: with_spectrum(rng, t, 2.5),
    "turbulence, f^-5/3": lambda rng, t: with_spectrum(rng, t, 5 / 3),
    "sines of 20 and 7 s": lambda rng, t: np.sin(t / 20 * 2 * np.pi) + 0.4 * np.sin(t * 0.9 + 1),
    "heating and OU": lambda rng, t: 0.05 * t + 0.3 * correlated(rng, t, 2.0),
    "sudden changes": staircase,
}


def lagged(x: Array, lag_s: float, dt_s: float) -> Array:
    """Response of one lag to an input that is linear between samples."""
    keep = np.exp(-dt_s / lag_s)
    share = (1 - keep) * lag_s / dt_s
    return np.asarray(lfilter([1 - share, share - keep], [1, -keep], x - x[0])) + x[0]


def true_means(true: Array, means: TimeMeans) -> Array:
    """Means of the fine temperature over the times of the means."""
    half = round(0.5 * means.length_s / DT_S) * FINER
    middles = means.sample * FINER
    return np.array([true[m - half : m + half + 1].mean() for m in middles])


def explained(estimate: Array, true: Array) -> float:
    """Share of the changes between neighbouring means that is explained."""
    of_error = np.diff(estimate - true, 2)
    of_truth = np.diff(true, 2)[np.isfinite(of_error)]
    of_error = of_error[np.isfinite(of_error)]
    return 1 - float(np.sum(of_error**2) / np.sum(of_truth**2))


def figures(rng: np.random.Generator, kind: Kind, lag_s: float) -> list[float] | None:
    """What one record gives; None where no mean is determined."""
    fine_s = DT_S / FINER * np.arange(ROWS * FINER)
    true = 20 + 5 * kind(rng, fine_s)
    reading = lagged(true, lag_s, DT_S / FINER)[::FINER] + rng.normal(0, 0.05, ROWS)
    chain = Chain((lag_s,), conditioning=NO_CONDITIONING)
    try:
        result = smooth(reading, DT_S, chain, means="auto")
    except InputError:
        return None
    means = result.means
    if means is None:
        return None
    row = [means.length_s]
    error = means.mean[:, 0] - true_means(true, means)
    reported = np.isfinite(error)
    row.append(float(np.mean(np.abs(error) < 1.96 * means.sd[:, 0], where=reported)))
    row.append(float(np.sqrt(np.mean(error**2, where=reported))))
    row.append(float(np.median(means.sd[reported, 0])))
    row.append(explained(means.mean[:, 0], true_means(true, means)))
    row.append(explained(result.temperature[:, 0], true[::FINER]))
    longer = smooth(reading, DT_S, chain, means=4 * means.length_s).means
    if longer is None:
        return None
    error = longer.mean[:, 0] - true_means(true, longer)
    row.append(float(np.mean(np.abs(error) < 1.96 * longer.sd[:, 0])))
    return row


def report(count: int, seed: int) -> None:
    """Print the table."""
    for lag_s in (2.0, 20.0):
        for number, (name, kind) in enumerate(KINDS.items()):
            rng = np.random.default_rng([seed, number, int(lag_s)])
            rows = [figures(rng, kind, lag_s) for _ in range(count)]
            table = np.array([row for row in rows if row is not None])
            length_s, held, error, u, share, of_rows, held_longer = table.T
            ratio = np.median(u / error)
            print(
                f"lag {lag_s:4.0f} s  {name:20s} {np.median(length_s):5.2f} s  "
                f"covered {100 * held.mean():5.1f} % (lowest {100 * held.min():3.0f})  "
                f"median u / rms error {ratio:.2f}  explained {np.median(share):.2f}, "
                f"of rows {np.median(of_rows):.2f}  four times: {100 * held_longer.mean():5.1f} %  "
                f"({len(table)} records)"
            )


if __name__ == "__main__":
    report(int(sys.argv[1]), int(sys.argv[2]))
