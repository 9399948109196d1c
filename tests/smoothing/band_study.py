"""Coverage of the bands of the smoother for signals that its prior does not describe.

`python -m tests.smoothing.band_study [RECORDS] [SEED] [WORDS]` prints one line a row of the table
on the page "Validation": coverage of the 95 % band (mean over the records, their standard deviation
and the worst one), largest error in standard deviations, rms error, rms of the standard
uncertainties, mean score of the 95 % interval (its width, and 40 times the distance of what it
misses; T. Gneiting and A. E. Raftery, J. Am. Stat. Assoc. 102, 359, 2007), rms error of a Tikhonov
deconvolution whose order and weight are tuned with the true temperature, share of records with a
warning, and CPU time a record. Rows are those that WORDS name. With `--stated` the sensors have
other lags, of which only the sum is stated.

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
    """Lags [s] of the stages of each channel, sampling interval [s], the factor of all times, and
    the dead time [s] of all channels."""

    lags_s: tuple[tuple[float, ...], ...]
    dt_s: float
    time_scale: float
    delay_s: float = 0.0


SETUPS = (
    Setup(((0.5,),), 1 / 75, 1.0),
    Setup(((0.4, 0.1), (0.5, 0.05)), 1 / 75, 1.0),
    Setup(((25.0,),), 1.0, 50.0),
    Setup(((0.5,), (0.45,), (0.4, 0.1)), 1 / 75, 1.0),
)
# sensors whose lag alone is stated: 0.5 s, or 25 s. One lag; a fifth or a third of it a second lag;
# an eighth of it a dead time
STATED_SETUPS = (
    Setup(((0.4, 0.1),), 1 / 75, 1.0),
    Setup(((0.5,), (1 / 3, 1 / 6)), 1 / 75, 1.0),
    Setup(((20.0, 5.0),), 1.0, 50.0),
    Setup(((0.4375,),), 1 / 75, 1.0, 0.0625),
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


def quick_ornstein_uhlenbeck(t: Array, rng: np.random.Generator) -> tuple[Array, list[float]]:
    """Stationary, standard deviation 4 K, correlation time 0.2 s."""
    keep = np.exp(-(t[1] - t[0]) / 0.2)
    white = rng.standard_normal(len(t)) * np.sqrt(1 - keep**2)
    white[0] = rng.standard_normal()
    return 4.0 * lfilter([1.0], [1.0, -keep], white), []


def kaimal(t: Array, rng: np.random.Generator) -> tuple[Array, list[float]]:
    """Turbulence: spectrum 1 / (1 + 10.2 f L)^(5/3), L 1.5 s; standard deviation 2 K.

    Shape: J. C. Kaimal et al., Q. J. R. Meteorol. Soc. 98, 563 (1972).
    """
    n = 2 * len(t)
    f = np.fft.rfftfreq(n, t[1] - t[0])
    amplitude = (1 + 10.2 * 1.5 * f) ** (-5 / 6)
    amplitude[0] = 0.0
    spectrum = amplitude * (rng.standard_normal(len(f)) + 1j * rng.standard_normal(len(f)))
    x = np.fft.irfft(spectrum, n)[: len(t)]
    return 2.0 * x / np.std(x), []


def sawtooth(t: Array, rng: np.random.Generator) -> tuple[Array, list[float]]:
    """Rises by 6 K in 4 s and falls at once."""
    phase = t / 4.0 + rng.uniform()
    return 6.0 * (phase % 1.0), []


def thermostat(t: Array, rng: np.random.Generator) -> tuple[Array, list[float]]:
    """Two-point control of a body of 8 s between 40 % and 60 % of 20 K."""
    step_s = t[1] - t[0]
    x = np.empty(len(t))
    level, is_on = rng.uniform(8.0, 12.0), rng.random() < 0.5
    keep = np.exp(-step_s / 8.0)
    for k in range(len(t)):
        target = 20.0 if is_on else 0.0
        level = target + (level - target) * keep
        if level > 12.0:
            is_on = False
        elif level < 8.0:
            is_on = True
        x[k] = level
    return x, []


def periodic_pulses(t: Array, rng: np.random.Generator) -> tuple[Array, list[float]]:
    """8 K for 0.4 s, every 3 s."""
    return 8.0 * ((t + rng.uniform(0, 3)) % 3.0 < 0.4), []


def modulated_sine(t: Array, rng: np.random.Generator) -> tuple[Array, list[float]]:
    """1 Hz, amplitude between 0 and 4 K with a period of 15 s."""
    envelope = 2.0 * (1 + np.sin(2 * np.pi * t / 15 + rng.uniform(0, 6)))
    return envelope * np.sin(2 * np.pi * t + rng.uniform(0, 6)), []


def staircase(t: Array, rng: np.random.Generator) -> tuple[Array, list[float]]:
    """Up by 3 K every 5 s, then down."""
    level = np.floor((t + rng.uniform(0, 5)) / 5.0)
    return 3.0 * np.minimum(level, level[-1] - level), []


def chirped_steps(t: Array, rng: np.random.Generator) -> tuple[Array, list[float]]:
    """Between two levels 6 K apart; half periods fall from 8 s to 0.5 s."""
    share = (t - t[0]) / (t[-1] - t[0])
    phase = rng.uniform(0, 2) + t[-1] * (share / 8 + 0.5 * (2 - 1 / 8) * share**2)
    return 6.0 * (np.floor(phase) % 2), []


def two_exponentials(t: Array, rng: np.random.Generator) -> tuple[Array, list[float]]:
    """A fall by 10 K with 1 s and by 10 K with 15 s, from a random time on."""
    since = np.maximum(t - rng.uniform(6.0, 15.0), 0.0)
    return 10.0 * np.expm1(-since / 1.0) + 10.0 * np.expm1(-since / 15.0), []


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
    Row("OU of 0.2 s", quick_ornstein_uhlenbeck),
    Row("Kaimal", kaimal),
    Row("sawtooth", sawtooth),
    Row("thermostat", thermostat),
    Row("periodic pulses", periodic_pulses),
    Row("modulated sine", modulated_sine),
    Row("staircase", staircase),
    Row("chirped steps", chirped_steps),
    Row("two exponentials", two_exponentials),
)


def stage_polynomials(lag_s: float, step_s: float) -> tuple[Array, Array]:
    """Numerator and denominator, in the shift operator, of a first-order lag and linear input."""
    keep = np.exp(-step_s / lag_s)
    share = lag_s / step_s * (1 - keep)
    return np.array([1 - share, share - keep]), np.array([1.0, -keep])


def simulate(
    row: Row, index: int, seed: int, setups: tuple[Setup, ...] = SETUPS
) -> tuple[Setup, Array, Array, list[float]]:
    """Setup, true temperatures (N, M), readings (N, M), and the times of the events [s]."""
    rng = np.random.default_rng([seed, index])
    setup = setups[index % len(setups)]
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
        late = round(setup.delay_s / step_s)
        y = np.concatenate([np.full(late, y[0]), y[: len(y) - late]])
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


def judge(row: Row, index: int, seed: int, is_stated: bool = False) -> tuple[float, ...]:
    """Coverage, largest error [sd], mean square error [K2], that of the reference, warnings, CPU
    [s], rms of u [K], mean interval score [K]."""
    setup, truth, y, events = simulate(row, index, seed, STATED_SETUPS if is_stated else SETUPS)
    chains: float | list[Chain]
    if is_stated:
        chains = sum(setup.lags_s[0]) + setup.delay_s
    else:
        chains = [Chain(lags_s, conditioning=NO_CONDITIONING) for lags_s in setup.lags_s]
    given = events if row.given else []
    start = time.process_time()
    result = smooth(y, setup.dt_s, chains, events_s=given)
    spent = time.process_time() - start
    error = np.abs(result.temperature - truth)
    half_width = 1.96 * result.sd
    score = 2 * half_width + 40 * np.maximum(error - half_width, 0.0)
    return (
        float(np.mean(error < 1.96 * result.sd)),
        float(np.max(error / result.sd)),
        float(np.mean(error**2)),
        tuned_rms(setup, truth, y, given),
        float(len(result.warnings) > 0),
        spent,
        float(np.sqrt(np.mean(result.sd**2))),
        float(np.mean(score)),
    )


def report(
    records: int,
    seed: int,
    words: list[str],
    workers: int,
    *,
    verbose: bool,
    is_stated: bool,
) -> None:
    """Print the table."""
    print(
        f"{'row':26s} cover %  +-  worst rec  max |e|/sd   rms K   rms u   score  tuned K  ratio"
        "  warned %  CPU s"
    )
    for row in ROWS:
        if words and not any(word == row.name for word in words):
            continue
        with ProcessPoolExecutor(workers) as pool:
            results = list(
                pool.map(
                    judge,
                    [row] * records,
                    range(records),
                    [seed] * records,
                    [is_stated] * records,
                )
            )
        if verbose:
            for index, r in enumerate(results):
                print(
                    f"   {index:3d} {100 * r[0]:6.1f} {r[1]:8.1f} rms {r[2] ** 0.5:7.4f} sd "
                    f"{r[6]:7.4f} tuned {r[3] ** 0.5:7.4f} warned {r[4]:.0f} {r[5]:6.2f} s"
                )
        cover, worst, square, tuned, warned, spent, sd, score = np.array(results).T
        rms = float(np.sqrt(square.mean()))
        reference = float(np.sqrt(tuned.mean()))
        print(
            f"{row.name:26s} {100 * cover.mean():7.1f} {100 * cover.std():3.1f} "
            f"{100 * cover.min():10.1f} {worst.max():11.1f} {rms:7.3f} "
            f"{np.sqrt(np.mean(sd**2)):7.3f} {score.mean():7.3f} {reference:8.3f} "
            f"{rms / reference:6.2f} {100 * warned.mean():9.0f} {spent.mean():6.2f}",
            flush=True,
        )


if __name__ == "__main__":
    numbers = [int(a) for a in sys.argv[1:] if a.isdigit()]
    listed = [a for a in sys.argv[1:] if not a.isdigit() and not a.startswith("-")]
    records_, seed_ = [*numbers, *(50, 0)[len(numbers) :]]
    report(
        records_,
        seed_,
        listed,
        2,
        verbose="-v" in sys.argv,
        is_stated="--stated" in sys.argv,
    )
