"""Noise that reaches the fit through what drives the model: inner row, friction and ambient of one test.

The fits weigh readings of the outer row by their own noise. What inner row, friction and ambient scatter moves the
prediction of all of them, slowly and together; it hardly counts against depths and steel, but between the tests of a
campaign nothing else is left.
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

HIGHEST_Hz = 12.0  # the rim lets nothing faster through
PADDING_S = 20.0
SUMS = 25  # parts of a residual whose sums tell of slow waves


def input_noise(test: EhlTest, side: Side) -> Array:
    """Standard deviation of a sample's white noise of power as logged [W], inner row [K] and ambient [K], (k + 2,)."""
    loaded = between(test.time_s, steady_start_s(test), test.events.unload_s - 0.5)
    ambient = float(white_noise_sd(test.ambient_of(side.disk)[loaded], NOISE_ORDER))
    power = test.friction_noise_N * test.sliding_speed_m_s
    disk = test.disks[side.disk]
    return np.array([power, *disk.noise_K[disk.setup.places(disk.setup.inner)], ambient])


def unsmoothed(test: EhlTest, toward: Array, time_s: Array) -> Array:
    """Adjoint of the running straight line that smoothed the friction: combinations (N, D) of what came of it at
    ``time_s``, as combinations of what was logged.

    Well before the parting the line is a running mean; its last half is one straight line through the last samples.
    """
    last = int(np.searchsorted(time_s, test.events.unload_s - test.events.parting_s - SETTLE_S))
    n = min(line_length(test.friction_noise_N, test.friction_N, test.dt_s, last), last)
    half = n // 2
    if half < 2:
        return toward
    inner = np.zeros_like(toward)
    inner[: last - half] = toward[: last - half]
    out = ndimage.uniform_filter1d(inner, 2 * half + 1, axis=0, mode="constant")
    x = np.arange(2 * half + 1) - float(half)
    at = np.arange(half + 1, 2 * half + 1 + len(toward) - last) - float(
        half
    )  # and on to the very end
    ends = toward[last - half :].copy()
    fit = np.column_stack([np.ones_like(x) / len(x), x / (x @ x)])
    held = np.minimum(at, half)[: len(ends)]
    out[last - 2 * half - 1 : last] += fit @ np.stack([ends.sum(axis=0), held @ ends])
    out[last:] = 0.0
    return out


def zero_u(test: EhlTest) -> float:
    """Standard uncertainty [N] of the friction's zero, by its noise: medians before loading and after unloading."""
    before = max(test.events.load_on_s - test.time_s[0] - SETTLE_S, test.dt_s)
    after = max(min(test.time_s[-1] - test.events.unload_s - SETTLE_S, 60.0), test.dt_s)
    return 1.25 * test.friction_noise_N / float(np.sqrt(max(before, after) / test.dt_s))


def driven_noise(test: EhlTest, side: Side, theta: Array, toward: Array) -> Array:
    """Covariance (D, D) of D combinations ``toward`` (m, D) of a side's whitened data by the noise of its inputs.

    A combination is w @ prediction, the prediction H u for inputs u of white noise sigma: the variance is sigma^2
    |H' w|^2, by frequencies. ``theta`` (4,): where the side's fit stands.
    """
    window = side.window
    dt = test.dt_s
    share = float(theta[SHARE])
    h = float(np.exp(theta[LOG_H]))
    gains = window.rim.gains(h)
    sd = input_noise(test, side)
    sd[0] *= share
    each = toward.reshape(*window.y.shape, -1) * window.weight[:, :, None]
    length = fft.next_fast_len(len(window.time_s) + int(PADDING_S / dt), real=True)
    f = fft.rfftfreq(length, dt)
    kept = f < HIGHEST_Hz
    rates = gains.rates / (gains.rates + 2j * np.pi * f[kept, None])
    weights = np.where(f[kept] == 0, 1.0, 2.0) / length
    seen = np.zeros((each.shape[1], len(rates), each.shape[2]), dtype=complex)
    for p, used in enumerate(np.atleast_2d(each.any(axis=0))):
        seen[p][:, used] = fft.rfft(window.blocks.T @ each[:, p, used], n=length, axis=0)[kept]
    out = np.zeros((toward.shape[1],) * 2)
    for i, sigma in enumerate(sd):
        through = sum(
            np.conj(gains.direct[i, p] + rates @ gains.gains[i, p])[:, None] * seen[p]
            for p in range(each.shape[1])
        )
        if i == 0:
            whole = np.zeros((len(f), toward.shape[1]), dtype=complex)
            whole[kept] = through
            logged = sigma * unsmoothed(
                test, fft.irfft(whole, n=length, axis=0)[: len(window.time_s)], window.time_s
            )
            out += logged.T @ logged
            continue
        rows = np.sqrt(weights)[:, None] * np.asarray(through)
        out += sigma**2 * (rows.real.T @ rows.real + rows.imag.T @ rows.imag)
    return out


def whole_noise(
    test: EhlTest, sides: Sequence[Side], theta: Array, toward: Array, residual: Array
) -> Array:
    """Covariance (D, D) of combinations ``toward`` (m, D), orthonormal, of both sides' data: own noise and inputs', all
    widened by the slow waves of the ``residual`` (m,) beyond it.

    Power and ambient are taken as each side's own.
    """
    ends = np.cumsum([len(s.y) for s in sides])[:-1]
    parts = [*zip(sides, theta.reshape(-1, 4), np.split(toward, ends), np.split(residual, ends))]
    waves = [
        slow_waves(test, side, own_theta, own_residual)
        for side, own_theta, _, own_residual in parts
    ]
    driven = [
        driven_noise(test, side, own_theta, own_toward) for side, own_theta, own_toward, _ in parts
    ]
    return max(waves) * (np.eye(toward.shape[1]) + sum(driven))


def slow_waves(test: EhlTest, side: Side, theta: Array, residual: Array) -> float:
    """Slow waves in a side's residual (m,) over what its own noise and its inputs' make of it; never below one."""
    rows = residual.reshape(side.window.y.shape)
    m = max(len(rows) // SUMS, 1)
    used = np.flatnonzero(rows.any(axis=0))
    starts = np.arange(0, len(rows) - m + 1, m)[:-1]
    if not len(used):
        return 1.0
    toward = np.zeros((*rows.shape, len(starts) * len(used)))
    for k, (start, column) in enumerate((s, c) for s in starts for c in used):
        toward[start : start + m, column, k] = 1 / np.sqrt(m)
    expected = 1 + float(
        np.mean(np.diag(driven_noise(test, side, theta, toward.reshape(rows.size, -1))))
    )
    return max(1.0, wave_factor(rows, SUMS) / expected)
