"""The measurement chain as the rig has it: oversampled, exact under straight lines, all channels at once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from calibration.disk import Conditioning
from tcdyn.simulate.truth import butterworth_poles

Array = NDArray[np.float64]


def chain_matrices(tau1_s: float, tau2_s: float, conditioning: Conditioning) -> tuple[Array, Array, Array]:
    """State space (A, B, C) of 1 / ((1 + tau1 s)(1 + tau2 s)) times the conditioning filter, unit static gain."""
    poles: list[complex] = [complex(-1 / tau) for tau in (tau1_s, tau2_s) if tau > 0]
    if conditioning.poles and conditioning.shape == "butterworth":
        poles += butterworth_poles(conditioning)
    elif conditioning.poles:
        poles += [complex(-2 * np.pi * conditioning.cutoff_Hz)] * conditioning.poles
    # A chain of first-order pieces keeps the states in kelvin and the matrix well conditioned; complex pairs are
    # taken as one second-order piece.
    blocks: list[Array] = []
    for pole in poles:
        if abs(pole.imag) < 1e-12 * abs(pole):
            blocks.append(np.array([[pole.real]]))
        elif pole.imag > 0:
            w2, damping = abs(pole) ** 2, -2 * pole.real
            w = np.sqrt(w2)
            blocks.append(np.array([[0.0, w], [-w, -damping]]))
    n = sum(len(block) for block in blocks)
    a, b, start, drive = np.zeros((n, n)), np.zeros(n), 0, -1
    for block in blocks:
        m = len(block)
        a[start : start + m, start : start + m] = block
        gain = -block[0, 0] if m == 1 else block[0, 1]
        row = start + m - 1
        if drive < 0:
            b[row] = gain
        else:
            a[row, drive] = gain
        drive = start
        start += m
    c = np.zeros(n)
    c[drive] = 1.0
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
