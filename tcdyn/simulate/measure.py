"""From true junction temperatures to what the logger writes: chain, static errors, noise, spikes, 16 bits."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.linalg import block_diag, expm
from scipy.signal import buttap

from calibration.arrays import Array
from calibration.disk import Conditioning
from tcdyn.simulate.truth import DiskTruth, Imperfections


def chain_matrices(tau1_s: float, tau2_s: float, conditioning: Conditioning) -> tuple[Array, Array, Array]:
    """State space (A, B, C) of 1 / ((1 + tau1 s)(1 + tau2 s)) times the conditioning filter, unit static gain.

    A chain of first-order pieces keeps the states in kelvin and the matrix well conditioned; complex pairs are taken
    as one second-order piece each.
    """
    poles: list[complex] = [complex(-1 / tau) for tau in (tau1_s, tau2_s) if tau > 0]
    cut = 2 * np.pi * conditioning.cutoff_Hz
    if conditioning.shape == "butterworth":
        poles += list(cut * buttap(conditioning.poles)[1])
    else:
        poles += [complex(-cut)] * conditioning.poles
    if not poles:
        return np.zeros((0, 0)), np.zeros(0), np.zeros(0)
    blocks: list[Array] = []
    for pole in poles:
        if abs(pole.imag) < 1e-12 * abs(pole):
            blocks.append(np.array([[pole.real]]))
        elif pole.imag > 0:
            w = abs(pole)
            blocks.append(np.array([[0.0, w], [-w, 2 * pole.real]]))
    a, starts = block_diag(*blocks), np.cumsum([0, *map(len, blocks)])
    b, c = np.zeros(len(a)), np.zeros(len(a))
    c[starts[-2]] = 1.0
    for k, block in enumerate(blocks):  # each is driven by the one before, the first by the input
        row, gain = starts[k + 1] - 1, abs(block[0, -1])
        if k:
            a[row, starts[k - 1]] = gain
        else:
            b[row] = gain
    return a, b, c


def through_chains(fine: Array, dt_s: float, every: int, chains: Sequence[tuple[float, float, Conditioning]]) -> Array:
    """What the chains make of ``fine`` (M, channels), sampled every ``dt_s``; each ``every``-th sample comes back.

    The input is a straight line between fine samples and the answer is exact for that; each chain starts at rest
    with its first sample. ``chains`` holds (tau1, tau2, conditioning) per channel, all with as many poles.
    """
    steps = (len(fine) - 1) // every
    count = fine.shape[1]
    systems = [chain_matrices(*chain) for chain in chains]
    n = len(systems[0][1])
    if n == 0:
        return np.asarray(fine[::every][: steps + 1])
    powers = np.empty((count, n, n))
    kernels = np.zeros((count, every + 1, n))
    outs, rest = np.empty((count, n)), np.empty((count, n))
    for ch, (a, b, c) in enumerate(systems):
        # [x, u, du] under x' = A x + B u, u' = du/dt: one exponential gives the exact straight-line step.
        big = np.zeros((n + 2, n + 2))
        big[:n, :n], big[:n, n], big[n, n + 1] = a * dt_s, b * dt_s, 1.0
        e = expm(big)
        one, b1 = e[:n, :n], e[:n, n + 1]
        b0 = e[:n, n] - b1
        power = np.eye(n)
        for j in range(every - 1, -1, -1):
            kernels[ch, j] += power @ b0
            kernels[ch, j + 1] += power @ b1
            power = one @ power
        powers[ch] = power
        outs[ch], rest[ch] = c, np.linalg.solve(a, -b)
    windows = np.stack([fine[j : j + steps * every : every][:steps] for j in range(every)], axis=1)
    ends = fine[every : steps * every + 1 : every]
    force = np.einsum("tjc,cjn->tcn", windows, kernels[:, :every]) + ends[:, :, None] * kernels[:, every]
    states = _scan(powers, force, fine[0][:, None] * rest)
    return np.asarray(np.einsum("tcn,cn->tc", states, outs))


def _scan(a: Array, force: Array, start: Array) -> Array:
    """x[k+1] = A x[k] + f[k] for every channel, (N+1, C, n), in blocks that advance side by side."""
    steps, count, n = force.shape
    length = max(int(np.sqrt(steps)), 1)
    blocks = -(-steps // length)
    padded = np.zeros((blocks * length, count, n))
    padded[:steps] = force
    padded = padded.reshape(blocks, length, count, n)
    transposed = a.transpose(0, 2, 1)
    inner = np.zeros((blocks, length + 1, count, n))
    powers = np.empty((length + 1, count, n, n))
    powers[0] = np.eye(n)
    for j in range(length):
        inner[:, j + 1] = (inner[:, j, :, None, :] @ transposed)[:, :, 0, :] + padded[:, j]
        powers[j + 1] = a @ powers[j]
    heads = np.empty((blocks, count, n))
    x = start
    for block in range(blocks):
        heads[block] = x
        x = (powers[length] @ x[:, :, None])[:, :, 0] + inner[block, length]
    full = inner + np.einsum("jcmn,bcn->bjcm", powers, heads)
    flat = full[:, 1:].reshape(blocks * length, count, n)[:steps]
    return np.concatenate([start[None], flat])


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
