"""Coverage of the bands of the smoother for signals that its prior does not describe.

`python -m tests.smoothing.band_study [RECORDS] [SEED] [WORDS]` prints one line a row of the table
on the page "Validation": coverage of the 95 % band (mean over the records), largest error in
standard deviations, rms error, rms error of a Tikhonov deconvolution whose order and weight are
tuned with the true temperature, share of records with a warning, and CPU time a record. Rows are
those whose name contains one of WORDS.

The readings come from recursions that are exact for an input that is linear between the points of a
grid 16 times finer than the samples. The records cycle through four sensors: one lag; two lags in
two channels; a lag of 25 s at one sample a second, with all times of the signal scaled by 50; and
three channels.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solveh_banded
from scipy.signal import lfilter

from tcdyn.chain import NO_CONDITIONING, Chain
from tcdyn.core import Array
from tcdyn.smoothing.smoother import smooth

NOISE_K = 0.05
FINE = 16
BASE_DEGC = 80.0
# seconds of signal in a record of the quick sensors; exact and spectral likelihood in turn
DURATIONS_S = (40.0, 60.0)
Signal = Callable[[Array, np.random.Generator], tuple[Array, list[float]]]


@dataclass(frozen=True)
class Setup:
    """Lags [s] of the stages of each channel, sampling interval [s], and the factor of all
    times."""

    lags_s: tuple[tuple[float, ...], ...]
    dt_s: float
    time_scale: float


SETUPS = (
    Setup(((0.5,),), 1 / 75, 1.0),
    Setup(((0.4, 0.1), (0.5, 0.05)), 1 / 75, 1.0),
    Setup(((25.0,),), 1.0, 50.0),
    Setup(((0.5,), (0.45,), (0.4, 0.1)), 1 / 75, 1.0),
)
# share of the signal that each channel has
SHARES = (1.0, 0.8, 0.6)


@dataclass(frozen=True)
class Row:
    """A row of the table: the signal, whether its events are given, step of the logger [K]."""

    name: str
    signal: Signal
    given: bool = False
    step_K: float = 0.0


def pulse(t: Array, rng: np.random.Generator) -> tuple[Array, list[float]]:
    """20 K for 0.2 s."""
    start = rng.uniform(12.0, 25.0)
    return 20.0 * ((t >= start) & (t < start + 0.2)), [start, start + 0.2]


def slope_change(t: Array, rng: np.random.Generator) -> tuple[Array, list[float]]:
    """A rise by 3 K in 0.05 s: the slope changes at both edges."""
    start = rng.uniform(12.0, 25.0)
    return 3.0 * np.clip((t - start) / 0.05, 0.0, 1.0), [start, start + 0.05]


def square_wave(t: Array, rng: np.random.Generator) -> tuple[Array, list[float]]:
    """Between two levels 10 K apart, every 0.5 s."""
    start = rng.uniform(0.0, 0.5)
    edges = np.arange(start, t[-1], 0.5)
    return 10.0 * (np.searchsorted(edges, t, side="right") % 2), edges.tolist()


def sine(t: Array, rng: np.random.Generator) -> tuple[Array, list[float]]:
    """5 K at 2 Hz."""
    return 5.0 * np.sin(4 * np.pi * t + rng.uniform(0, 6)), []


def sweep(t: Array, rng: np.random.Generator) -> tuple[Array, list[float]]:
    """5 K, frequency from 0.01 to 5 Hz, linear in time."""
    phase = 2 * np.pi * (0.01 * t + 0.5 * (5.0 - 0.01) * t**2 / t[-1])
    return 5.0 * np.sin(phase + rng.uniform(0, 6)), []


def brownian(t: Array, rng: np.random.Generator) -> tuple[Array, list[float]]:
    """Random walk by 1 K in 1 s."""
    return np.cumsum(rng.standard_normal(len(t))) * np.sqrt(t[1] - t[0]), []


def ornstein_uhlenbeck(t: Array, rng: np.random.Generator) -> tuple[Array, list[float]]:
    """Stationary, standard deviation 2 K, correlation time 2 s."""
    keep = np.exp(-(t[1] - t[0]) / 2.0)
    white = rng.standard_normal(len(t)) * np.sqrt(1 - keep**2)
    white[0] = rng.standard_normal()
    return 2.0 * lfilter([1.0], [1.0, -keep], white), []


def pink(t: Array, rng: np.random.Generator) -> tuple[Array, list[float]]:
    """Spectrum 1/f up to half the sampling rate; standard deviation 1 K."""
    n = 2 * len(t)
    f = np.fft.rfftfreq(n, t[1] - t[0])
    amplitude = np.zeros(len(f))
    band = (f > 0) & (f <= 0.5 * f[-1] / (0.5 * FINE))
    amplitude[band] = f[band] ** -0.5
    spectrum = amplitude * (rng.standard_normal(len(f)) + 1j * rng.standard_normal(len(f)))
    x = np.fft.irfft(spectrum, n)[: len(t)]
    return x / np.std(x), []


def drift(t: Array, rng: np.random.Generator) -> tuple[Array, list[float]]:
    """Random walk by 0.03 K in the record, below the noise."""
    walk = np.cumsum(rng.standard_normal(len(t))) * np.sqrt(1 / len(t))
    return 0.03 * walk, []


def swing(t: Array, rng: np.random.Generator) -> tuple[Array, list[float]]:
    """3 K with a period of 20 s."""
    return 3.0 * np.sin(2 * np.pi * t / 20 + rng.uniform(0, 6)), []


def heating(t: Array, rng: np.random.Generator) -> tuple[Array, list[float]]:
    """Towards a level by 15 K with a time constant of 5 s, from a random time on."""
    start = rng.uniform(8.0, 15.0)
    return -15.0 * np.expm1(-np.maximum(t - start, 0.0) / 5.0), []


def small_step(t: Array, rng: np.random.Generator) -> tuple[Array, list[float]]:
    """0.1 K at a random time."""
    start = rng.uniform(12.0, 25.0)
    return 0.1 * (t >= start), [start]


ROWS = (
    Row("pulse, given", pulse, given=True),
    Row("pulse", pulse),
    Row("slope change, given", slope_change, given=True),
    Row("slope change", slope_change),
    Row("square wave, given", square_wave, given=True),
    Row("square wave", square_wave),
    Row("sine", sine),
    Row("sweep", sweep),
    Row("Brownian", brownian),
    Row("Ornstein-Uhlenbeck", ornstein_uhlenbeck),
    Row("pink", pink),
    Row("drift", drift),
    Row("steps of 0.5 K, swing", swing, step_K=0.5),
    Row("steps of 0.5 K, heating", heating, step_K=0.5),
    Row("small step", small_step),
    Row("small step, given", small_step, given=True),
)


def stage_polynomials(lag_s: float, step_s: float) -> tuple[Array, Array]:
    """Numerator and denominator, in the shift operator, of a first-order lag and linear input."""
    keep = np.exp(-step_s / lag_s)
    share = lag_s / step_s * (1 - keep)
    return np.array([1 - share, share - keep]), np.array([1.0, -keep])


def simulate(row: Row, index: int, seed: int) -> tuple[Setup, Array, Array, list[float]]:
    """Setup, true temperatures (N, M), readings (N, M), and the times of the events [s]."""
    rng = np.random.default_rng([seed, index])
    setup = SETUPS[index % len(SETUPS)]
    seconds = DURATIONS_S[index // len(SETUPS) % len(DURATIONS_S)]
    step_s = setup.dt_s / FINE
    count = int(seconds * setup.time_scale / setup.dt_s) * FINE + 1
    t = np.arange(count) * step_s / setup.time_scale
    x, events = row.signal(t, rng)
    truth = []
    readings = []
    for lags_s, share in zip(setup.lags_s, SHARES):
        temperature = BASE_DEGC + share * x
        y = temperature
        for lag_s in lags_s:
            b, a = stage_polynomials(lag_s, step_s)
            y = lfilter(b, a, y - y[0]) + y[0]
        y = y[::FINE] + NOISE_K * rng.standard_normal(len(y[::FINE]))
        if row.step_K:
            y = np.round(y / row.step_K) * row.step_K
        truth.append(temperature[::FINE])
        readings.append(y)
    return (
        setup,
        np.stack(truth, axis=1),
        np.stack(readings, axis=1),
        [e * setup.time_scale for e in events],
    )


def tikhonov(
    y: Array, lags_s: tuple[float, ...], dt_s: float, events_s: list[float], order: int
) -> Callable[[float], Array]:
    """Minimise |y - G x|^2 + weight |D^order x|^2 without the differences across ``events_s``.

    With x = A w and G x = B w, where A and B are polynomials in the shift operator, the normal
    equations in w are banded.
    """
    b = np.ones(1)
    a = np.ones(1)
    for lag_s in lags_s:
        stage_b, stage_a = stage_polynomials(lag_s, dt_s)
        b = np.convolve(b, stage_b)
        a = np.convolve(a, stage_a)
    difference = a
    for _ in range(order):
        difference = np.convolve(difference, [1.0, -1.0])
    n = len(y)
    before = len(a) - 1
    size = n + before
    kept = np.ones(n - order)
    for event in events_s:
        first = int(np.ceil(event / dt_s))
        kept[max(first - order, 0) : max(first, 0)] = 0.0

    def banded(rows: Array, weights: Array) -> Array:
        """Upper bands of sum over rows r of weight * shifted(rows) shifted(rows)'."""
        width = len(rows)
        bands = np.zeros((before + order + 2, size))
        for i in range(width):
            for j in range(i, width):
                columns = np.arange(len(weights)) + (size - len(weights) - (width - 1)) + j
                offset = j - i
                np.add.at(
                    bands[len(bands) - 1 - offset],
                    columns,
                    weights * rows[::-1][i] * rows[::-1][j],
                )
        return bands

    data = banded(b, np.ones(n))
    smooth_bands = banded(difference, kept)
    right = np.zeros(size)
    level = float(np.mean(y))
    for j, value in enumerate(b[::-1]):
        right[j : j + n] += value * (y - level)

    def solve(weight: float) -> Array:
        bands = data + weight * smooth_bands
        bands[-1] += 1e-14 * bands[-1].max()
        w = solveh_banded(bands, right)
        return level + np.convolve(w, a, mode="valid")

    return solve


def tuned_rms(setup: Setup, truth: Array, y: Array, events_s: list[float]) -> float:
    """Mean square error [K2] of Tikhonov deconvolution, order and weight chosen with the truth."""
    squares = []
    for c, lags_s in enumerate(setup.lags_s):
        errors = []
        for order in (1, 2):
            solve = tikhonov(y[:, c], lags_s, setup.dt_s, events_s, order)
            for weight in np.geomspace(1e-4, 1e9, 40):
                errors.append(np.mean((solve(weight) - truth[:, c]) ** 2))
        squares.append(min(errors))
    return float(np.mean(squares))


def judge(row: Row, index: int, seed: int) -> tuple[float, ...]:
    """Coverage, largest error [sd], mean square error [K2], that of the reference, warnings, CPU
    [s]."""
    setup, truth, y, events = simulate(row, index, seed)
    chains = [Chain(lags_s, conditioning=NO_CONDITIONING) for lags_s in setup.lags_s]
    given = events if row.given else []
    start = time.process_time()
    result = smooth(y, setup.dt_s, chains, events_s=given)
    spent = time.process_time() - start
    error = np.abs(result.temperature - truth)
    return (
        float(np.mean(error < 1.96 * result.sd)),
        float(np.max(error / result.sd)),
        float(np.mean(error**2)),
        tuned_rms(setup, truth, y, given),
        float(len(result.warnings) > 0),
        spent,
        float(np.sqrt(np.mean(result.sd**2))),
    )


def report(records: int, seed: int, words: list[str], workers: int, verbose: bool) -> None:
    """Print the table."""
    print(
        f"{'row':26s} cover %  worst rec  max |e|/sd   rms K  typ. sd  tuned K  ratio  warned "
        "%  CPU s"
    )
    for row in ROWS:
        if words and not any(word == row.name for word in words):
            continue
        with ProcessPoolExecutor(workers) as pool:
            results = list(pool.map(judge, [row] * records, range(records), [seed] * records))
        if verbose:
            for index, r in enumerate(results):
                print(
                    f"   {index:3d} {100 * r[0]:6.1f} {r[1]:8.1f} rms {r[2] ** 0.5:7.4f} sd "
                    f"{r[6]:7.4f} tuned {r[3] ** 0.5:7.4f} warned {r[4]:.0f} {r[5]:6.2f} s"
                )
        cover, worst, square, tuned, warned, spent, sd = np.array(results).T
        rms = float(np.sqrt(square.mean()))
        reference = float(np.sqrt(tuned.mean()))
        print(
            f"{row.name:26s} {100 * cover.mean():7.1f} {100 * cover.min():10.1f} "
            f"{worst.max():11.1f} {rms:7.3f} {np.sqrt(np.mean(sd**2)):8.3f} {reference:8.3f} "
            f"{rms / reference:6.2f} {100 * warned.mean():9.0f} {spent.mean():6.2f}",
            flush=True,
        )


if __name__ == "__main__":
    numbers = [int(a) for a in sys.argv[1:] if a.isdigit()]
    listed = [a for a in sys.argv[1:] if not a.isdigit() and not a.startswith("-")]
    records_, seed_ = [*numbers, *(50, 0)[len(numbers) :]]
    report(records_, seed_, listed, 2, "-v" in sys.argv)
