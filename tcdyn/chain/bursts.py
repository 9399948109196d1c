"""Bursts: a slip ring that loses contact for a while, told by its shape from all that a temperature does.

Before the filter a burst is a pulse; behind it, a rounded one. Over a second a temperature that went through its chain
is a cubic, a bend or a step that the chain has rounded; what none of these explains and a pulse does, is a burst.
What a temperature does, most channels show; where the others show nothing, less is enough.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.ndimage import maximum_filter1d
from scipy.signal import find_peaks, oaconvolve

from calibration import Array, Flags
from calibration.disk import Conditioning
from calibration.noise import SpikeRule, bridged, find_spikes
from tcdyn.chain.chain import Chain
from tcdyn.chain.noise import LoggerNoise, noise_of
from tcdyn.chain.rational import Factor, Rational, simulate

# samples of a pulse; one between two of these is found by either
LENGTHS = (2, 3, 4, 5, 7, 9, 11, 13, 15, 17, 19, 22, 25, 28, 31)
LONGEST_S = 0.45  # of a pulse
BESIDE_S, BESIDE = 0.4, 8  # of the trace on either side that tells what the temperature does; samples at least
SLOW = 10.0  # sampling intervals: a chain of that lag rounds whatever a temperature does
SURE, SURE_ALONE = 7.0, 5.5  # standard deviations of a pulse's height; where the other channels show nothing
BETTER, BETTER_ALONE = 25.0, 6.0  # deviance by which it must beat bends and steps; where the others show nothing
SHOWN = 3.5  # standard deviations of a pulse's height that half of the other channels must have to show something
NOISY, CLEARLY = 1.5, 4.0  # deviance a sample that noise may leave; by what multiple of the rest it must beat them, too
LEFT = 0.5  # standard deviations of noise that a pulse's tail may leave in a sample which is kept
MOST = 1500  # samples of a window: traces of some kilohertz are not searched
DENSE, SHORT_S = 0.012, 1.0  # share of samples in bursts above which segments of this length tell the noise
ROUNDS = 6  # pulses that hide each other come out one after the other


def noise_and_white(
    traces: Sequence[Array],
    dt_s: float,
    filter_: Conditioning,
    white_K: Array,
    chains: Sequence[Chain],
    rule: SpikeRule,
) -> tuple[LoggerNoise, list[tuple[Array, Flags]]]:
    """The noise of one logger's channels, from all of ``traces``, each (N, M) [K], NaN where missing; and each as

    ``made_white`` gives it. Where bursts are so dense that most segments of a spectrum have one, and pass for noise,
    the noise is told once more: from short segments, without the bursts found.
    """
    noise = noise_of(traces, dt_s, filter_, white_K)
    white = [made_white(noise, y, np.isfinite(y), dt_s, chains, rule) for y in traces]
    if noise.coloured and np.mean([moved.mean() for _, moved in white]) > DENSE:
        left = [np.where(moved, np.nan, y) for y, (_, moved) in zip(traces, white)]
        noise = noise_of(left, dt_s, filter_, white_K, SHORT_S)
        white = [made_white(noise, y, np.isfinite(y), dt_s, chains, rule) for y in traces]
    return noise, white


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
    slow = [i for i, lag_s in enumerate(lags_s) if pulses and lag_s > SLOW * dt_s]
    filters = [c.conditioning if c.conditioning.poles else noise.shaping for c in chains]
    behind = [noise.behind(Chain((), conditioning=f)).conditioning for f in filters]
    shown = {i: pulse_heights(white[:, i], dt_s, float(noise.level_K[i]), behind[i]) for i in slow}
    for i in slow:
        others = np.median([shown[j] for j in slow if j != i], axis=0) < SHOWN if len(slow) > 1 else None
        moved[:, i] |= find_bursts(white[:, i], dt_s, float(noise.level_K[i]), behind[i], lags_s[i], others)
        white[:, i] = bridged(white[:, i], ~moved[:, i])
    return white, moved & good


def pulse_heights(y: Array, dt_s: float, noise_sd: float, filter_: Conditioning) -> Array:
    """Largest height, in standard deviations, of any pulse within 0.4 s of each sample of ``y`` (N,)."""
    beside, pulses = _beside(dt_s), list(_pulses(dt_s, filter_))
    widest = max(map(len, pulses)) + 2 * beside
    if len(y) < 2 * widest or not noise_sd > 0:
        return np.zeros(len(y))
    score = np.max([np.abs(_heights(y / noise_sd, p, beside)) for p in pulses], axis=0)
    return np.asarray(maximum_filter1d(score, 2 * beside + 1))


def find_bursts(
    y: Array, dt_s: float, noise_sd: float, filter_: Conditioning, lag_s: float, alone: Flags | None = None
) -> Flags:
    """Samples (N,) of ``y`` [K], finite, every ``dt_s`` (above 0.8 ms), that a burst before ``filter_`` has moved.

    ``noise_sd`` [K] of its white noise; ``lag_s`` of the chain, which rounds what a temperature does; ``alone`` (N,):
    where other channels show nothing.
    """
    beside, pulses = _beside(dt_s), list(_pulses(dt_s, filter_))
    widest = max(map(len, pulses)) + 2 * beside
    if len(y) < 2 * widest or widest > MOST or not noise_sd > 0:
        return np.zeros(len(y), dtype=bool)
    parts = _parts(pulses, widest, beside, dt_s, lag_s)
    padded = np.pad(y, widest, mode="reflect", reflect_type="odd") / noise_sd
    moved = np.zeros(len(padded), dtype=bool)
    other = np.pad(np.zeros(len(y), dtype=bool) if alone is None else alone, widest)
    for _ in range(ROUNDS):
        score = np.max([np.abs(_heights(padded, p, beside)) for p in pulses], axis=0)
        before = np.count_nonzero(moved)
        for centre in find_peaks(score, height=np.where(other, SURE_ALONE, SURE), distance=widest)[0]:
            better = BETTER_ALONE if other[centre] else BETTER
            for share in (0.5, 0.25, 0.75):  # a second pulse may lie on either side
                first = int(np.clip(centre - share * widest, 0, len(padded) - widest))
                if (inside := parts.pulses_in(padded[first : first + widest], better)).any():
                    moved[first : first + widest] |= inside
                    break
        if np.count_nonzero(moved) == before:
            break
        padded = bridged(padded, ~moved)
    return moved[widest:-widest]


def _beside(dt_s: float) -> int:
    """Samples on either side of a pulse that tell what the temperature does."""
    return max(round(BESIDE_S / dt_s), BESIDE)


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


def _rest(shape: Array, beside: int) -> Array:
    """``shape`` with zeros ``beside`` it, less the cubic that is nearest."""
    whole = np.pad(shape, beside)
    cubic, _ = np.linalg.qr(legvander(np.linspace(-1, 1, len(whole)), 3))
    return np.asarray(whole - cubic @ (cubic.T @ whole))


def _heights(y: Array, pulse: Array, beside: int) -> Array:
    """Height of the pulse over its standard deviation, by the middle of its window; zeros at the ends (N,)."""
    rest = _rest(pulse, beside)
    z = oaconvolve(y, rest[::-1] / np.linalg.norm(rest), mode="valid")
    before = len(rest) // 2
    return np.pad(z, (before, len(y) - len(z) - before))


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

    def pulses_in(self, window: Array, better: float) -> Flags:
        """Samples (n,) that pulses have moved: those of the two parts that explain it best, ``better`` than others."""
        told = self.units.T @ window
        square = told**2
        both = (square[:, None] + square - 2 * self.alike * np.outer(told, told)) / (1 - self.alike**2)
        np.fill_diagonal(both, square)
        whole = float(window @ window - np.sum((self.cubic.T @ window) ** 2))
        of_others = float(both[self.pulses :, self.pulses :].max())
        with_pulse = both[: self.pulses]
        i, k = divmod(int(np.argmax(with_pulse)), len(told))
        wrong = max(whole - float(with_pulse[i, k]) - NOISY * len(window), 0.0)  # the parts are not quite these
        if with_pulse[i, k] < of_others + better + CLEARLY * wrong:
            return np.zeros(len(window), dtype=bool)
        if with_pulse[i, k] < square[: self.pulses].max() + BETTER:  # one of them does as well alone
            i = k = int(np.argmax(square[: self.pulses]))
        chosen = list({i, k})
        heights = np.linalg.lstsq(self.units[:, chosen], window)[0] / self.norms[chosen]
        return np.asarray((np.abs(self.shapes[:, chosen] * heights) > LEFT).any(axis=1))


def _parts(pulses: Sequence[Array], size: int, beside: int, dt_s: float, lag_s: float) -> _Parts:
    """All that a window of ``size`` samples may be made of; a pulse leaves some samples beside it."""
    shapes = []
    for pulse in pulses:
        for start in range(beside // 4, size - len(pulse) - beside // 4 + 1, max(size // 120, 1)):
            shapes.append(np.pad(pulse, (start, size - len(pulse) - start)))
    age = np.maximum(np.arange(size)[:, None] - np.arange(0, size, max(size // 60, 2)), 0) * dt_s
    step = 1 - np.exp(-age / lag_s)
    whole = np.column_stack([*shapes, step, age - lag_s * step])
    cubic, _ = np.linalg.qr(legvander(np.linspace(-1, 1, size), 3))
    rest = whole - cubic @ (cubic.T @ whole)
    norms = np.linalg.norm(rest, axis=0)
    kept = norms > 1e-6 * norms.max()
    units = rest[:, kept] / norms[kept]
    alike = np.clip(units.T @ units, -1 + 1e-3, 1 - 1e-3)
    named = np.column_stack([*shapes, np.zeros((size, whole.shape[1] - len(shapes)))])
    return _Parts(named[:, kept], units, alike, norms[kept], cubic, int(np.count_nonzero(kept[: len(shapes)])))
