"""Bursts: a slip ring that loses contact for a while, told by its shape from all that a temperature does.

Before the filter a burst is a pulse; behind it, a rounded one. Over a second a temperature that went through its chain
is a cubic, a bend or a step that the chain has rounded; what none of these explains and a pulse does, is a burst.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.signal import find_peaks, oaconvolve

from calibration import Array, Flags
from calibration.disk import Conditioning
from calibration.noise import SpikeRule, bridged, find_spikes
from tcdyn.chain.chain import Chain
from tcdyn.chain.noise import LoggerNoise
from tcdyn.chain.rational import Factor, Rational, simulate

LENGTHS = (2, 3, 5, 8, 12, 17, 23, 30)  # samples of a pulse; one between two of them is found by either
LONGEST_S = 0.45  # of a pulse
BESIDE_S, BESIDE = 0.4, 8  # of the trace on either side that tells what the temperature does; samples at least
SLOW = 10.0  # sampling intervals: a chain of that lag rounds whatever a temperature does
SURE = 7.0  # standard deviations of a pulse's height
BETTER = 25.0  # deviance by which it must beat a bend or a step
LEFT = 0.5  # standard deviations of noise that a pulse's tail may leave in a sample which is kept
ROUNDS = 6  # pulses that hide each other come out one after the other


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
    for i, chain in enumerate(chains):
        x, sd = bridged(white[:, i], good[:, i]), float(noise.level_K[i])
        moved[:, i] = find_spikes(np.where(good[:, i], x, np.nan), rule, sd)
        x = bridged(x, ~moved[:, i])
        lag_s = chain.lag_s - chain.conditioning.lag_s
        if pulses and lag_s > SLOW * dt_s:
            filter_ = chain.conditioning if chain.conditioning.poles else noise.shaping
            moved[:, i] |= find_bursts(x, dt_s, sd, noise.behind(Chain((), conditioning=filter_)).conditioning, lag_s)
        white[:, i] = bridged(x, ~moved[:, i])
    return white, moved & good


def find_bursts(y: Array, dt_s: float, noise_sd: float, filter_: Conditioning, lag_s: float) -> Flags:
    """Samples (N,) of ``y`` [K], finite, every ``dt_s``, that a burst before ``filter_`` has moved.

    ``noise_sd`` [K] of its white noise; ``lag_s`` of the chain, which rounds what a temperature does.
    """
    beside = max(round(BESIDE_S / dt_s), BESIDE)
    pulses = list(_pulses(dt_s, filter_))
    widest = max(len(p) for p in pulses) + 2 * beside
    if len(y) < 2 * widest or not noise_sd > 0:
        return np.zeros(len(y), dtype=bool)
    padded = np.pad(y, widest, mode="reflect", reflect_type="odd") / noise_sd
    moved = np.zeros(len(padded), dtype=bool)
    for _ in range(ROUNDS):
        z = np.stack([_heights(padded, p, beside) for p in pulses])
        score, which = np.abs(z).max(axis=0), np.abs(z).argmax(axis=0)
        before = np.count_nonzero(moved)
        for at in find_peaks(score, height=SURE, distance=widest)[0]:
            pulse = pulses[which[at]]
            window = padded[at : at + len(pulse) + 2 * beside]
            height = z[which[at], at] / np.linalg.norm(_rest(pulse, beside))
            if _is_pulse(window, pulse, beside, dt_s, lag_s):
                moved[at + beside + np.flatnonzero(np.abs(height * pulse) > LEFT)] = True
        if np.count_nonzero(moved) == before:
            break
        padded = bridged(padded, ~moved)
    return moved[widest:-widest]


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
    """Height of the pulse over its standard deviation, for every window's first sample; zeros at the end (N,)."""
    rest = _rest(pulse, beside)
    z = oaconvolve(y, rest[::-1] / np.linalg.norm(rest), mode="valid")
    return np.concatenate([z, np.zeros(len(y) - len(z))])


def _is_pulse(window: Array, pulse: Array, beside: int, dt_s: float, lag_s: float) -> bool:
    """Whether a pulse explains the window (n,), in units of its noise, better than a rounded bend or step anywhere."""
    cubic, _ = np.linalg.qr(legvander(np.linspace(-1, 1, len(window)), 3))
    rest = window - cubic @ (cubic.T @ window)
    age = np.maximum(np.arange(len(window))[:, None] - np.arange(0, len(window), 2), 0) * dt_s
    step = 1 - np.exp(-age / lag_s)
    others = np.concatenate([step, age - lag_s * step], axis=1)
    others = others - cubic @ (cubic.T @ others)
    norms = np.linalg.norm(others, axis=0)
    told = (others[:, norms > 1e-9].T @ rest) ** 2 / norms[norms > 1e-9] ** 2
    own = _rest(pulse, beside)
    return bool((own @ rest) ** 2 / (own @ own) > np.max(told, initial=0.0) + BETTER)
