"""Bursts: a slip ring that loses contact for a while, told by its shape from all that a temperature does.

Before the filter a burst is a pulse; behind it, a rounded one. Over a second a temperature that went through its chain
is a cubic, a bend or a step that the chain has rounded; what none of these explains and a pulse does, is a burst.
What a temperature does, most channels show; where the others show nothing, less is enough.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import compress

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.ndimage import maximum_filter1d, uniform_filter1d
from scipy.signal import find_peaks, oaconvolve

from tcdyn.chain.chain import NO_CONDITIONING, Chain
from tcdyn.chain.logger_noise import LoggerNoise, noise_of
from tcdyn.chain.rational import Factor, Rational, simulate
from tcdyn.core import Array, Flags
from tcdyn.estimation.trace_noise import SpikeRule, bridged, find_spikes
from tcdyn.rig.disk import Conditioning

# samples of a pulse; one between two of these is found by either
LENGTHS = (
    2,
    3,
    4,
    5,
    7,
    9,
    11,
    13,
    15,
    17,
    19,
    22,
    25,
    28,
    31,
    *(round(31 * 1.12**k) for k in range(1, 32)),
)
LONGEST_S = 0.45  # of a pulse
# of the trace on either side that tells what the temperature does; samples at least
BESIDE_S = 0.4
BESIDE = 8
SLOW = 10.0  # sampling intervals: a chain of that lag rounds whatever a temperature does
SURE = 7.0  # standard deviations of a pulse's height
# deviance by which it must beat bends and steps; a weak one that is alone
BETTER = 25.0
BETTER_ALONE = 6.0
WEAK = 250.0  # deviance of all that is in a window of a weak one: a temperature's own jump of ten kelvin has thousands
# other channels that must be able to show something; with more missing they cannot
WITNESSES = 2
BRIDGED = 0.25
SHOWN = 4.5  # standard deviations of a pulse's height by which two other channels show that it was the temperature
# deviance a sample that noise may leave; by what multiple of the rest it must beat them, too
NOISY = 1.5
CLEARLY = 4.0
LEFT = 0.5  # standard deviations of noise that a pulse's tail may leave in a sample which is kept
MOST = 1500  # samples of a window: traces of some kilohertz are not searched
SAME_RATE = 0.01  # sampling intervals that differ by less are one
# share of samples in bursts above which segments of this length tell the noise
DENSE = 0.012
SHORT_S = 1.0
PASSED = 0.1  # part of a temperature's wave that a chain lets through: of less, what stands out is called hum
ROUNDS = 6  # pulses that hide each other come out one after the other


def noise_and_white(
    traces: Sequence[Array],
    dts_s: Sequence[float],
    filter_: Conditioning,
    white_K: Array,
    chains: Sequence[Chain],
    rule: SpikeRule,
) -> tuple[LoggerNoise, list[tuple[Array, Flags]]]:
    """The noise of one logger's channels, and all of ``traces`` as ``made_white`` gives them.

    ``traces``: each (N, M) [K], NaN where missing, with its sampling interval in ``dts_s``; those sampled as the first
    tell the noise. Where bursts are so dense that most segments of a spectrum have one, and pass for noise, it is told
    once more: from short segments, without the bursts found.
    """
    alike = [abs(dt / dts_s[0] - 1) < SAME_RATE for dt in dts_s]

    def white(noise: LoggerNoise) -> list[tuple[Array, Flags]]:
        return [
            made_white(noise, y, np.isfinite(y), dt, chains, rule) for y, dt in zip(traces, dts_s)
        ]

    noise = noise_of([*compress(traces, alike)], dts_s[0], filter_, white_K)
    done = white(noise)
    if noise.coloured and np.mean([moved.mean() for _, moved in done]) > DENSE:
        left = [np.where(moved, np.nan, y) for y, (_, moved) in zip(traces, done)]
        again = noise_of([*compress(left, alike)], dts_s[0], filter_, white_K, SHORT_S)
        noise = replace(again, lines=noise.lines)  # short segments cannot tell one
        done = white(noise)
    plain = [
        replace(c, conditioning=NO_CONDITIONING) for c in chains if c.lag_s > c.conditioning.lag_s
    ]
    hum = [
        line
        for line in noise.lines
        if all(abs(c.frequency_response(line[0])) < PASSED for c in plain)
    ]
    return replace(noise, lines=tuple(hum)), done  # the others may be the temperature's own waves


def made_white(
    noise: LoggerNoise,
    y: Array,
    good: Flags,
    dt_s: float,
    chains: Sequence[Chain],
    rule: SpikeRule,
    pulses: bool = True,
) -> tuple[Array, Flags]:
    """Traces ``y`` (N, M) with their noise made white, and which ``good`` samples a spike or a burst has moved (N, M).

    Samples that are not good, or were moved, are bridged by straight lines. Spikes go by ``rule``; bursts are sought
    where ``pulses`` and where the chain is slow enough to round whatever a temperature does.
    """
    white = noise.whitened(np.where(good, y, np.nan), dt_s)
    moved = np.zeros(y.shape, dtype=bool)
    for i, sd in enumerate(noise.level_K):
        x = bridged(white[:, i], good[:, i])
        moved[:, i] = find_spikes(np.where(good[:, i], x, np.nan), rule, float(sd))
        white[:, i] = bridged(x, ~moved[:, i])
    lags_s = [c.lag_s - c.conditioning.lag_s for c in chains]
    filters = [c.conditioning if c.conditioning.poles else noise.shaping for c in chains]
    behind = [noise.behind(Chain((), conditioning=f)).conditioning for f in filters]
    slow = [i for i, lag_s in enumerate(lags_s) if pulses and lag_s > SLOW * dt_s]
    missing = ~good | moved
    searches = [_Search.of(white[:, i], dt_s, float(noise.level_K[i]), behind[i]) for i in slow]
    shown = [_shown(search, missing[:, i]) for search, i in zip(searches, slow)]
    heights = np.array(shown).reshape(-1, len(y))
    tells = np.isfinite(heights)
    shows = heights >= SHOWN
    # channels
    able = tells.sum(axis=0)
    said = shows.sum(axis=0)
    for k, i in enumerate(slow):
        alone = (able - tells[k] >= WITNESSES) & (said - shows[k] < WITNESSES)
        moved[:, i] |= _found(searches[k], dt_s, lags_s[i], alone)
        white[:, i] = bridged(white[:, i], ~moved[:, i])
    return white, moved & good


def _shown(search: _Search | None, missing: Flags) -> Array:
    """Largest height of any pulse near each sample (N,) [standard deviations]; NaN where it cannot tell."""
    if search is None:
        return np.full(len(missing), np.nan)
    near = 2 * search.widest + 1
    height = maximum_filter1d(search.first, near)[search.widest : -search.widest]
    return np.where(
        (height > 0) & (uniform_filter1d(missing.astype(float), near) < BRIDGED), height, np.nan
    )


@dataclass(frozen=True)
class _Search:
    """A trace in standard deviations of its noise, ``padded`` by ``widest`` on both sides, and the pulses sought; as
    ``shapes`` (K, odd) of norm one, without the cubic that is nearest."""

    padded: Array
    pulses: tuple[Array, ...]
    shapes: Array
    beside: int
    widest: int

    @classmethod
    def of(cls, y: Array, dt_s: float, noise_sd: float, filter_: Conditioning) -> _Search | None:
        """None where nothing can be sought."""
        pulses, shapes, beside = _sought(dt_s, filter_)
        widest = max(map(len, pulses)) + 2 * beside
        if len(y) < 2 * widest or widest > MOST or not noise_sd > 0:
            return None
        return cls(
            np.pad(y, widest, mode="reflect", reflect_type="odd") / noise_sd,
            pulses,
            shapes,
            beside,
            widest,
        )

    def score(self, padded: Array) -> Array:
        """Largest height of any pulse over its standard deviation, by the middle of its window; zeros at the ends."""
        length = self.shapes.shape[1]
        largest = np.zeros(len(padded) - length + 1)
        for shape in self.shapes:
            correlation = oaconvolve(padded, shape[::-1], mode="valid")
            np.maximum(largest, np.abs(correlation), out=largest)
        return np.pad(largest, length // 2)

    @cached_property
    def first(self) -> Array:
        """The score of the trace as it is."""
        return self.score(self.padded)


def find_bursts(
    y: Array,
    dt_s: float,
    noise_sd: float,
    filter_: Conditioning,
    lag_s: float,
    alone: Flags | None = None,
) -> Flags:
    """Samples (N,) of ``y`` [K], finite, every ``dt_s`` (above 0.8 ms), that a burst before ``filter_`` has moved.

    ``noise_sd`` [K] of its white noise; ``lag_s`` of the chain, which rounds what a temperature does; ``alone`` (N,):
    where other channels show nothing.
    """
    nobody = np.zeros(len(y), dtype=bool) if alone is None else alone
    return _found(_Search.of(y, dt_s, noise_sd, filter_), dt_s, lag_s, nobody)


def _found(search: _Search | None, dt_s: float, lag_s: float, alone: Flags) -> Flags:
    """The samples (N,) that bursts have moved."""
    if search is None or not (search.first > SURE).any():
        return np.zeros(len(alone), dtype=bool)
    padded = search.padded
    widest = search.widest
    score = search.first
    parts = _parts(search.pulses, widest, search.beside, dt_s, lag_s)
    moved = np.zeros(len(padded), dtype=bool)
    other = np.pad(alone, widest)
    for _ in range(ROUNDS):
        before = np.count_nonzero(moved)
        centres, _ = find_peaks(score, height=SURE, distance=widest)
        highest_first = np.argsort(-score[centres], kind="stable")
        for centre in centres[highest_first]:
            for share in (0.5, 0.25, 0.75):  # a second pulse may lie on either side
                first = int(np.clip(centre - share * widest, 0, len(padded) - widest))
                if (
                    inside := parts.pulses_in(padded[first : first + widest], bool(other[centre]))
                ).any():
                    moved[first : first + widest] |= inside
                    break
        if np.count_nonzero(moved) == before:
            break
        padded = bridged(padded, ~moved)
        score = search.score(padded)
    return moved[widest:-widest]


@lru_cache(maxsize=8)
def _sought(dt_s: float, filter_: Conditioning) -> tuple[tuple[Array, ...], Array, int]:
    """Pulses, their shapes, and how many samples beside each are looked at; remembered for the other channels."""
    beside = max(round(BESIDE_S / dt_s), BESIDE)
    pulses = tuple(_pulses(dt_s, filter_))
    odd = max(map(len, pulses)) // 2 * 2 + 2 * beside + 1
    shapes = np.zeros((len(pulses), odd))
    for shape, pulse in zip(shapes, pulses):
        whole = np.pad(pulse, beside)
        cubic, _ = np.linalg.qr(legvander(np.linspace(-1, 1, len(whole)), 3))
        rest = whole - cubic @ (cubic.T @ whole)
        first = odd // 2 - len(rest) // 2
        shape[first : first + len(rest)] = rest / np.linalg.norm(rest)
    return pulses, shapes, beside


def _pulses(dt_s: float, filter_: Conditioning) -> Iterator[Array]:
    """Pulses of every length through the filter, until they have died away; of height one before it."""
    behind = Rational(np.array(filter_.numerator), tuple(Factor(f) for f in filter_.factors))
    tail = int(np.ceil(8 * max((f[1] for f in filter_.factors), default=0.0) / dt_s))
    for length in LENGTHS:
        if length == LENGTHS[0] or length * dt_s <= LONGEST_S:
            pulse = np.zeros(length + tail + 1)
            pulse[1 : length + 1] = 1.0
            if filter_.factors:
                pulse = simulate(behind, pulse, dt_s, "zoh")
            yield pulse[1:]


@dataclass(frozen=True)
class _Parts:
    """What a window (n,) may be made of but for a cubic: pulses and rounded steps and bends, anywhere in it.

    ``shapes`` (n, K): pulses as they are, zeros for the others; ``units`` (n, K): all of them without their cubic, of
    norm one; ``alike`` (K, K): how alike two of them are; ``norms`` (K,); ``cubic`` (n, 4).
    """

    shapes: Array
    units: Array
    alike: Array
    norms: Array
    cubic: Array
    pulses: int

    def pulses_in(self, window: Array, alone: bool) -> Flags:
        """Samples (n,) that pulses have moved: those of the two parts that explain it best, if no two others do.

        ``alone``: other channels show nothing; then a weak pulse needs to be less clearly better.
        """
        told = self.units.T @ window
        nothing = np.zeros(len(window), dtype=bool)
        square = told**2
        whole = float(window @ window - np.sum((self.cubic.T @ window) ** 2))
        better = BETTER_ALONE if alone and whole < WEAK + len(window) else BETTER
        least = self._best(told, square, slice(self.pulses, len(told)), self.pulses)[0] + better
        if whole < max(least, SURE**2):  # no two parts explain more than there is
            return nothing
        few = max(2**16 // len(told), 1)  # rows that stay in the processor's cache
        found = [
            self._best(told, square, slice(a, min(a + few, self.pulses)))
            for a in range(0, self.pulses, few)
        ]
        explained, i, k = max(found, key=lambda f: f[0])
        wrong = max(whole - explained - NOISY * len(window), 0.0)  # the parts are not quite these
        if explained < max(least + CLEARLY * wrong, SURE**2):
            return nothing
        one = float(square[: self.pulses].max())
        if explained < one + BETTER and one >= least:
            i = k = int(np.argmax(square[: self.pulses]))  # one of them does as well alone
        chosen = list({i, k})
        heights = np.linalg.lstsq(self.units[:, chosen], window)[0] / self.norms[chosen]
        return np.asarray((np.abs(self.shapes[:, chosen] * heights) > LEFT).any(axis=1))

    def _best(
        self, told: Array, square: Array, rows: slice, first: int = 0
    ) -> tuple[float, int, int]:
        """The most that one of ``rows`` and one of the parts from ``first`` on explain together, and which these are.

        (a^2 + b^2 - 2 r a b) / (1 - r^2), a and b what each is told, r how alike they are; a^2 for one part alone.
        """
        share, cross = self.weights
        both = np.multiply(cross[rows, first:], told[first:])
        both *= told[rows, None]
        each = np.add(square[rows, None], square[first:])
        each *= share[rows, first:]
        both += each
        i, k = divmod(int(np.argmax(both)), both.shape[1])
        return float(both[i, k]), rows.start + i, first + k

    @cached_property
    def weights(self) -> tuple[Array, Array]:
        """1 / (1 - r^2) and -2 r / (1 - r^2), (K, K) each, such that a part with itself explains what it does alone."""
        share: Array = 1 / (1 - self.alike**2)
        cross = -2 * self.alike * share
        np.fill_diagonal(share, 0.5)
        np.fill_diagonal(cross, 0.0)
        return share, cross


def _parts(pulses: Sequence[Array], size: int, beside: int, dt_s: float, lag_s: float) -> _Parts:
    """All that a window of ``size`` samples may be made of; a pulse leaves some samples beside it."""
    places = [
        (pulse, start)
        for pulse in pulses
        for start in range(beside // 4, size - len(pulse) - beside // 4 + 1, max(size // 120, 1))
    ]
    shapes = np.zeros((size, len(places)))
    for column, (pulse, start) in zip(shapes.T, places):
        column[start : start + len(pulse)] = pulse
    age = np.maximum(np.arange(size)[:, None] - np.arange(0, size, max(size // 60, 2)), 0) * dt_s
    step = 1 - np.exp(-age / lag_s)
    whole = np.column_stack([shapes, step, age - lag_s * step])
    cubic, _ = np.linalg.qr(legvander(np.linspace(-1, 1, size), 3))
    rest = whole - cubic @ (cubic.T @ whole)
    norms = np.linalg.norm(rest, axis=0)
    kept = norms > 1e-6 * norms.max()
    units = rest[:, kept] / norms[kept]
    alike = np.clip(units.T @ units, -1 + 1e-3, 1 - 1e-3)
    named = np.column_stack([shapes, np.zeros((size, whole.shape[1] - len(places)))])
    return _Parts(
        named[:, kept], units, alike, norms[kept], cubic, int(np.count_nonzero(kept[: len(places)]))
    )
