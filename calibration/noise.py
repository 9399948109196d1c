"""How noisy a trace is, whatever it does slowly and however many spikes stand in it, and which samples are spikes."""

from __future__ import annotations

from math import comb

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import median_filter

from calibration import Array, Flags

SPIKE_SIGMAS = 8.0  # of white noise, from the median of the neighbours: one clean sample in 1e15 lies so far away
SPIKE_FLOOR_K = 0.5
SPIKE_WIDTH = 7  # samples whose median stands for the trace: a spike is at most three samples wide
MAD_TO_SD = 1.482602218505602  # standard deviation of a normal distribution over its median absolute deviation
MOSTLY_MOVING = 0.7  # share of samples that differ from the one before, where the noise is about one step of the logger


def white_noise_sd(values: ArrayLike, order: int = 2, *, centred: bool = True) -> Array:
    """Standard deviation of the white noise of a trace, from its differences and their median.

    sd = 1.4826 median |d - median d| / sqrt(C(2k, k)), d the differences of order k, whose variance is C(2k, k) times
    that of white noise; not less than the rounding of a logger whose step is coarser than the noise. A higher order
    forgives a quicker signal and a logger's drift; a lower one wastes fewer neighbours of a missing sample.

    Args:
        values: (N,) or (N, M), any unit, NaN where missing.
        order: of the differences, k >= 1.
        centred: False where the differences are known to be zero on the average, and ``median d`` is left out.

    Returns one number, or one for each of M columns, in the unit of ``values``.

    >>> noise = np.random.default_rng(0).normal(0.0, 0.2, 4000)
    >>> ramp = 0.01 * np.arange(4000)
    >>> [round(float(white_noise_sd(ramp + noise, k)), 2) for k in (1, 2, 3, 4)]
    [0.2, 0.2, 0.2, 0.2]
    """
    x = np.asarray(values, dtype=float)
    d = np.diff(x, n=order, axis=0)
    away = np.abs(d - np.nanmedian(d, axis=0)) if centred else np.abs(d)
    sd = MAD_TO_SD * np.nanmedian(away, axis=0) / np.sqrt(comb(2 * order, order))
    columns = [rounding_sd(column) for column in x.reshape(len(x), -1).T]
    return np.asarray(np.maximum(sd, np.reshape(columns, x.shape[1:])))


def rounding_sd(x: Array) -> float:
    """Rounding error of a trace (N,) whose neighbours are often equal: its logger's step over sqrt(12); else zero.

    Differences that take few values have a median that says nothing, and is zero where most of them are zero.

    >>> round(float(rounding_sd(np.array([20.0, 20.0, 20.5, 20.5, 20.5, 20.0, 20.0]))), 3)  # steps of 0.5
    0.144
    """
    step = np.abs(np.diff(x))
    step = step[np.isfinite(step)]
    moved = step[step > 1e-9 * max(float(np.max(step, initial=0.0)), 1e-300)]
    if not len(moved) or len(moved) > MOSTLY_MOVING * len(step):
        return 0.0
    return float(np.median(moved) / np.sqrt(12))


def spike_limit(values: Array) -> float:
    """How far [K] a sample of ``values (N,)`` may lie from its neighbours: 8 standard deviations of noise, or 0.5 K.

    Infinite where fewer than 15 samples tell the noise.
    """
    x = values[np.isfinite(values)]
    return max(SPIKE_SIGMAS * float(white_noise_sd(x, 1)), SPIKE_FLOOR_K) if len(x) >= 15 else np.inf


def find_spikes(values: Array, limit_K: float | Array, width: int = SPIKE_WIDTH) -> Flags:
    """Samples of ``values (N,)`` further than ``limit_K`` from the median of the ``width`` around them.

    A ramp or a clean step is no spike: the median follows both. NaN is never one. ``limit_K`` (one, or one a sample):
    raw readings are given 8 standard deviations or half a kelvin; calibrated traces, whose noise is known, 6.

    >>> find_spikes(np.array([20.0, 20.1, 20.2, 25.0, 20.4, 20.5, 20.6]), 1.0).nonzero()[0]
    array([3])
    """
    index = np.flatnonzero(np.isfinite(values))
    out = np.zeros(len(values), dtype=bool)
    x, limit = values[index], np.broadcast_to(limit_K, len(values))[index]
    nearest = (width // 2 + 1) // 2  # of the majority that stands far away, one is at most so many samples off
    if (np.abs(np.diff(x)) > np.min(limit, initial=np.inf) / nearest).any():  # otherwise there is no such majority
        out[index] = np.abs(x - median_filter(x, width, mode="nearest")) > limit
    return out
