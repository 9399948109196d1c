"""From true junction temperatures to what the logger writes: chain, static errors, noise, spikes, 16 bits."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tcdyn.simulate.chainsim import through_chains
from tcdyn.simulate.truth import DiskTruth, Imperfections

Array = NDArray[np.float64]
RATE_Hz = 75.0
OVERSAMPLING = 4
RANGE_degC = (-100.0, 760.0)  # of a type-J module (assumed)
BITS = 16


def sample_times(duration_s: float) -> Array:
    """Times of a 75 Hz record of ``duration_s`` [s], from 0."""
    return np.arange(int(np.floor(duration_s * RATE_Hz + 1e-6)) + 1) / RATE_Hz


def log_disk(
    truth_at: Callable[[Array], Array],
    duration_s: float,
    disk: DiskTruth,
    rng: np.random.Generator,
    how: Imperfections,
    spikes: bool,
) -> tuple[Array, Array]:
    """Log all channels of a disk for ``duration_s`` at 75 Hz.

    ``truth_at`` maps times (M,) to the true temperatures (M, channels). Returns what is logged and
    what was true, both (N, channels).
    ``spikes``: whether the signals pass slip rings (EHL tests).
    """
    names = sorted(disk.channels)
    times = sample_times(duration_s)
    fine_t = np.arange((len(times) - 1) * OVERSAMPLING + 1) / (RATE_Hz * OVERSAMPLING)
    fine = truth_at(fine_t)
    true = fine[::OVERSAMPLING]
    read = true
    if how.chain:
        chains = [(disk.channels[c].tau1_s, disk.channels[c].tau2_s, disk.setup.conditioning) for c in names]
        read = through_chains(fine, 1 / (RATE_Hz * OVERSAMPLING), OVERSAMPLING, chains)
    return logged(read, disk, rng, how, spikes), true


def logged(
    read: Array, disk: DiskTruth, rng: np.random.Generator, how: Imperfections, spikes: bool, averaged: int = 1
) -> Array:
    """Static errors, noise, spikes and quantisation upon chain outputs (N, channels) of one disk.

    ``averaged``: how many readings went into one row (oven rows are means); noise falls with its root.
    """
    out = read.copy()
    for k, name in enumerate(sorted(disk.channels)):
        channel = disk.channels[name]
        noise = rng.standard_normal(len(out)) * channel.noise_K / np.sqrt(averaged)
        bursts = spike_train(rng, len(out), channel.spikes_per_s) if spikes else 0.0
        if how.static:
            out[:, k] = (out[:, k] - channel.offset_degC) / channel.gain
        if how.noise:
            out[:, k] += noise
        if how.spikes:
            out[:, k] += bursts
    return quantised(out) if how.quantise and averaged == 1 else out


def spike_train(rng: np.random.Generator, count: int, per_s: float) -> Array:
    """Slip-ring spikes [K]: Poisson in time, one to three samples long, 1.5 K and more, of either sign."""
    out = np.zeros(count)
    number = rng.poisson(per_s * count / RATE_Hz)
    starts = rng.integers(0, max(count, 1), number)
    lengths = rng.integers(1, 4, number)
    heights = rng.choice([-1.0, 1.0], number) * (1.5 + rng.exponential(4.0, number))
    for start, length, height in zip(starts, lengths, heights):
        out[start : start + length] += height
    return out


def quantised(values: Array, low: float = RANGE_degC[0], high: float = RANGE_degC[1]) -> Array:
    """Round to the nearest of 2^16 levels between ``low`` and ``high`` and clip to them."""
    step = (high - low) / (2**BITS - 1)
    return np.asarray(low + step * np.round((np.clip(values, low, high) - low) / step))
