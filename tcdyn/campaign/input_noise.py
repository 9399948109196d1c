"""Noise that reaches the fit through what drives the model: inner row, friction and ambient of one
test.

The fits weigh readings of the outer row by their own noise. What inner row, friction and ambient
scatter moves the prediction of all of them, slowly and together; it hardly counts against depths
and steel, but between the tests of a campaign nothing else is left.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import fft, ndimage

from tcdyn.core import Array
from tcdyn.estimation import wave_factor
from tcdyn.estimation.trace_noise import white_noise_sd
from tcdyn.partition.events import EhlTest
from tcdyn.partition.joint import LOG_H, SHARE, Side
from tcdyn.partition.window import between, steady_start_s
from tcdyn.rig.contact import SETTLE_S, line_length
from tcdyn.smoothing.traces import NOISE_ORDER

MAX_FREQUENCY_Hz = 12.0  # the rim lets nothing faster through
PADDING_S = 20.0
N_CHUNKS = 25  # parts of a residual whose sums tell of slow waves


def input_noise(test: EhlTest, block: Side) -> Array:
    """Standard deviation of a sample's white noise of power as logged [W], inner row [K] and
    ambient [K], (k + 2,).
    """
    loaded = between(test.time_s, steady_start_s(test), test.events.unload_s - 0.5)
    ambient = float(white_noise_sd(test.ambient_of(block.disk)[loaded], NOISE_ORDER))
    power = test.friction_noise_N * test.sliding_speed_m_s
    disk = test.disks[block.disk]
    return np.array([power, *disk.noise_K[disk.setup.places(disk.setup.inner)], ambient])


def smoothing_adjoint(test: EhlTest, combinations: Array, time_s: Array) -> Array:
    """Adjoint of the running straight line that smoothed the friction: combinations (N, D) of what
    came of it at ``time_s``, as combinations of what was logged.

    Well before the parting the line is a running mean; its last half is one straight line through
    the last samples.
    """
    last = int(np.searchsorted(time_s, test.events.unload_s - test.events.parting_s - SETTLE_S))
    n = min(line_length(test.friction_noise_N, test.friction_N, test.dt_s, last), last)
    half = n // 2
    if half < 2:
        return combinations
    inner = np.zeros_like(combinations)
    inner[: last - half] = combinations[: last - half]
    out = ndimage.uniform_filter1d(inner, 2 * half + 1, axis=0, mode="constant")
    x = np.arange(2 * half + 1) - float(half)
    position = np.arange(half + 1, 2 * half + 1 + len(combinations) - last) - float(
        half
    )  # and on to the very end
    ends = combinations[last - half :].copy()
    fit = np.column_stack([np.ones_like(x) / len(x), x / (x @ x)])
    clipped = np.minimum(position, half)[: len(ends)]
    out[last - 2 * half - 1 : last] += fit @ np.stack([ends.sum(axis=0), clipped @ ends])
    out[last:] = 0.0
    return out


def friction_zero_u_N(test: EhlTest) -> float:
    """Standard uncertainty [N] of the friction's zero, by its noise: medians before loading and
    after unloading.
    """
    before = max(test.events.load_on_s - test.time_s[0] - SETTLE_S, test.dt_s)
    after = max(min(test.time_s[-1] - test.events.unload_s - SETTLE_S, 60.0), test.dt_s)
    return 1.25 * test.friction_noise_N / float(np.sqrt(max(before, after) / test.dt_s))


def input_noise_covariance(test: EhlTest, block: Side, theta: Array, combinations: Array) -> Array:
    """Covariance (D, D) of D combinations ``combinations`` (m, D) of a side's whitened data by the
    noise of its inputs.

    A combination is w @ prediction, the prediction H u for inputs u of white noise sigma: the
    variance is sigma^2 |H' w|^2, by frequencies. ``theta`` (4,): where the side's fit stands.
    """
    window = block.window
    dt = test.dt_s
    share = float(theta[SHARE])
    h = float(np.exp(theta[LOG_H]))
    gains = window.rim.gains(h)
    sd = input_noise(test, block)
    sd[0] *= share
    weighted = combinations.reshape(*window.y.shape, -1) * window.weight[:, :, None]
    length = fft.next_fast_len(len(window.time_s) + int(PADDING_S / dt), real=True)
    f = fft.rfftfreq(length, dt)
    below_cutoff = f < MAX_FREQUENCY_Hz
    rates = gains.rates / (gains.rates + 2j * np.pi * f[below_cutoff, None])
    weights = np.where(f[below_cutoff] == 0, 1.0, 2.0) / length
    spectra = np.zeros((weighted.shape[1], len(rates), weighted.shape[2]), dtype=complex)
    for p, used in enumerate(np.atleast_2d(weighted.any(axis=0))):
        spectra[p][:, used] = fft.rfft(window.blocks.T @ weighted[:, p, used], n=length, axis=0)[
            below_cutoff
        ]
    out = np.zeros((combinations.shape[1],) * 2)
    for i, sigma in enumerate(sd):
        through = sum(
            np.conj(gains.direct[i, p] + rates @ gains.gains[i, p])[:, None] * spectra[p]
            for p in range(weighted.shape[1])
        )
        if i == 0:
            spectrum = np.zeros((len(f), combinations.shape[1]), dtype=complex)
            spectrum[below_cutoff] = through
            power_combinations = sigma * smoothing_adjoint(
                test, fft.irfft(spectrum, n=length, axis=0)[: len(window.time_s)], window.time_s
            )
            out += power_combinations.T @ power_combinations
            continue
        rows = np.sqrt(weights)[:, None] * np.asarray(through)
        out += sigma**2 * (rows.real.T @ rows.real + rows.imag.T @ rows.imag)
    return out


def noise_covariance(
    test: EhlTest, blocks: Sequence[Side], theta: Array, combinations: Array, residual: Array
) -> Array:
    """Covariance (D, D) of combinations ``combinations`` (m, D), orthonormal, of both sides' data:
    own noise and inputs', all widened by the slow waves of the ``residual`` (m,) beyond it.

    Power and ambient are taken as each side's own.
    """
    ends = np.cumsum([len(s.y) for s in blocks])[:-1]
    parts = [
        *zip(blocks, theta.reshape(-1, 4), np.split(combinations, ends), np.split(residual, ends))
    ]
    inflations = [
        residual_inflation(test, side, own_theta, own_residual)
        for side, own_theta, _, own_residual in parts
    ]
    input_covariances = [
        input_noise_covariance(test, side, own_theta, own_toward)
        for side, own_theta, own_toward, _ in parts
    ]
    return max(inflations) * (np.eye(combinations.shape[1]) + sum(input_covariances))


def residual_inflation(test: EhlTest, block: Side, theta: Array, residual: Array) -> float:
    """Slow waves in a side's residual (m,) over what its own noise and its inputs' make of it;
    never below one.
    """
    rows = residual.reshape(block.window.y.shape)
    m = max(len(rows) // N_CHUNKS, 1)
    used = np.flatnonzero(rows.any(axis=0))
    starts = np.arange(0, len(rows) - m + 1, m)[:-1]
    if not len(used):
        return 1.0
    combinations = np.zeros((*rows.shape, len(starts) * len(used)))
    for k, (start, column) in enumerate((s, c) for s in starts for c in used):
        combinations[start : start + m, column, k] = 1 / np.sqrt(m)
    expected = 1 + float(
        np.mean(
            np.diag(input_noise_covariance(test, block, theta, combinations.reshape(rows.size, -1)))
        )
    )
    return max(1.0, wave_factor(rows, N_CHUNKS) / expected)
