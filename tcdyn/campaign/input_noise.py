"""Covariance of a test's data due to noise of the model's inputs: inner row and ambient.

The fits weigh the readings of the outer row by their own noise. Noise of inner row and ambient
shifts the prediction of all of them, slowly and together. It is small against the uncertainty of
depths and conductivity, but between the tests of one campaign it dominates. The noise of the
friction is in the nuisance parameters (``tcdyn.partition.nuisance.friction_noise_effects``).

``tcdyn.campaign.compress`` calls ``noise_covariance``. Guarded by
``tests/campaign/test_campaign_noise.py``, which compares with the noise of single samples.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import fft

from tcdyn.core import Array
from tcdyn.estimation import slow_variance_factor
from tcdyn.estimation.trace_noise import white_noise_sd
from tcdyn.partition.events import EhlTest
from tcdyn.partition.joint import LOG_H, DiskBlock
from tcdyn.partition.window import rows_between, steady_start_s
from tcdyn.rig.contact import SWITCHING_MARGIN_S
from tcdyn.smoothing.traces import DIFFERENCE_ORDER

# Inputs above this frequency do not reach the junctions: the rim is a low-pass filter.
MAX_FREQUENCY_Hz = 12.0
# Zeros behind the window, so that the circular convolution does not wrap around. By judgement.
PADDING_S = 20.0
# The residual is summed in so many chunks to measure its slow components. By judgement.
N_CHUNKS = 25
# Longest time after unloading from which the zero of the friction is taken; chosen by
# judgement.
MAX_ZERO_S = 60.0
# Standard deviation of a median over that of a mean, for normal noise: sqrt(pi / 2).
MEDIAN_FACTOR = 1.25


def input_noise(test: EhlTest, side: DiskBlock) -> Array:
    """Standard deviations of the white noise of the inputs of one disk.

    Parameters
    ----------
    test
        The test.
    side
        Block of the disk in the joint fit.

    Returns
    -------
    The k junctions of the inner row and ambient, (k + 1,) [K].

    Notes
    -----
    The order is that of ``tcdyn.heat.modal.inputs_of`` after the power; ``input_noise_covariance``
    relies on it.
    """
    loaded = rows_between(test.time_s, steady_start_s(test), test.events.unload_s - 0.5)
    ambient = float(white_noise_sd(test.ambient_of(side.disk)[loaded], DIFFERENCE_ORDER))
    disk = test.disks[side.disk]
    inner = disk.noise_K[disk.setup.channel_indices(disk.setup.inner)]
    return np.array([*inner, ambient])


def friction_zero_u_N(test: EhlTest) -> float:
    """Standard uncertainty of the friction's zero due to noise [N].

    The zero is the median before loading and after unloading; the longer of the two counts.

    Parameters
    ----------
    test
        The test.
    """
    before = max(test.events.load_on_s - test.time_s[0] - SWITCHING_MARGIN_S, test.dt_s)
    after = max(
        min(test.time_s[-1] - test.events.unload_s - SWITCHING_MARGIN_S, MAX_ZERO_S), test.dt_s
    )
    n_samples = max(before, after) / test.dt_s
    return MEDIAN_FACTOR * test.friction_noise_N / float(np.sqrt(n_samples))


def input_noise_covariance(
    test: EhlTest, side: DiskBlock, theta: Array, combinations: Array
) -> Array:
    """Covariance of combinations of one disk's data due to noise of its inputs.

    Parameters
    ----------
    test
        The test.
    side
        Block of the disk in the joint fit.
    theta
        Optimum of the block, shape (4,).
    combinations
        D combinations of the m whitened data, shape (m, D).

    Returns
    -------
    Covariance, (D, D).

    Notes
    -----
    A combination is w @ prediction. The prediction is H u for inputs u with white noise of standard
    deviation sigma, so the variance is sigma^2 |H' w|^2. It is summed over frequencies.
    """
    window = side.window
    dt = test.dt_s
    gains = window.rim.gains(float(np.exp(theta[LOG_H])))
    sd = input_noise(test, side)
    n_rows = len(window.time_s)
    n_combinations = combinations.shape[1]
    weighted = combinations.reshape(*window.y.shape, -1) * window.weight[:, :, None]
    n_channels = weighted.shape[1]
    length = fft.next_fast_len(n_rows + int(PADDING_S / dt), real=True)
    f = fft.rfftfreq(length, dt)
    below_cutoff = f < MAX_FREQUENCY_Hz
    rates = gains.rates / (gains.rates + 2j * np.pi * f[below_cutoff, None])
    weights = np.where(f[below_cutoff] == 0, 1.0, 2.0) / length
    spectra = np.zeros((n_channels, len(rates), weighted.shape[2]), dtype=complex)
    for p, used in enumerate(np.atleast_2d(weighted.any(axis=0))):
        blocks = window.blocks.T @ weighted[:, p, used]
        spectra[p][:, used] = fft.rfft(blocks, n=length, axis=0)[below_cutoff]
    out = np.zeros((n_combinations, n_combinations))
    for i, sigma in enumerate(sd, start=1):  # after the power
        through = np.zeros_like(spectra[0])
        for p in range(n_channels):
            response = gains.direct[i, p] + rates @ gains.gains[i, p]
            through = through + np.conj(response)[:, None] * spectra[p]
        rows = np.sqrt(weights)[:, None] * through
        out += sigma**2 * (rows.real.T @ rows.real + rows.imag.T @ rows.imag)
    return out


def noise_covariance(
    test: EhlTest, sides: Sequence[DiskBlock], theta: Array, combinations: Array, residual: Array
) -> Array:
    """Covariance of combinations of both disks' data: noise of the readings and of the inputs.

    Parameters
    ----------
    test, sides
        The test, and the block of each disk.
    theta
        Optimum of all blocks, 4 parameters each.
    combinations
        D orthonormal combinations of the data, shape (m, D).
    residual
        Residuals of the data, shape (m,).

    Returns
    -------
    Covariance, (D, D).

    Notes
    -----
    The covariance is multiplied by the larger of both disks' :func:`residual_inflation`. Noise of
    the ambient is taken as independent between the disks.
    """
    ends = np.cumsum([len(s.y) for s in sides])[:-1]
    thetas = theta.reshape(-1, 4)
    residuals = np.split(residual, ends)
    by_disk = np.split(combinations, ends)
    inflation = max(residual_inflation(test, *block) for block in zip(sides, thetas, residuals))
    input_covariances = [
        input_noise_covariance(test, *block) for block in zip(sides, thetas, by_disk)
    ]
    return inflation * (np.eye(combinations.shape[1]) + sum(input_covariances))


def residual_inflation(test: EhlTest, side: DiskBlock, theta: Array, residual: Array) -> float:
    """Variance of slow components of a disk's residual over the expected one; at least one.

    The expected variance is that of the readings' noise and the input noise.

    Parameters
    ----------
    test
        The test.
    side
        Block of the disk in the joint fit.
    theta
        Optimum of the block, (4,).
    residual
        Residual of the block, (m,).

    Notes
    -----
    The number of chunks must be the same in the expected and in the observed variance
    (``tcdyn.estimation.slow_variance_factor``).
    """
    rows = residual.reshape(side.window.y.shape)
    m = max(len(rows) // N_CHUNKS, 1)
    used = np.flatnonzero(rows.any(axis=0))
    starts = np.arange(0, len(rows) - m + 1, m)[:-1]
    if not len(used):
        return 1.0
    sums = np.zeros((*rows.shape, len(starts) * len(used)))
    chunks = [(start, column) for start in starts for column in used]
    for k, (start, column) in enumerate(chunks):
        sums[start : start + m, column, k] = 1 / np.sqrt(m)
    of_inputs = input_noise_covariance(test, side, theta, sums.reshape(rows.size, -1))
    expected = 1 + float(np.mean(np.diag(of_inputs)))
    return max(1.0, slow_variance_factor(rows, N_CHUNKS) / expected)
