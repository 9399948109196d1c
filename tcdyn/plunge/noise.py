"""How noisy the plunge's residuals really are: coloured, common to the channels, or white as assumed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Inflation:
    """Variance factors of the residuals' mean over channels and of their deviations from it; 1 for white noise."""

    common: float = 1.0
    differential: float = 1.0


def block_sd(noise_sd_K: Array, count: Array) -> Array:
    """Standard deviation of block means (B, C) for white noise; infinite where a block holds no sample."""
    return np.where(count > 0, noise_sd_K / np.sqrt(np.maximum(count, 1)), np.inf)


def correlation_length(z: Array, longest: int = 40) -> float:
    """1 + 2 sum of the autocorrelations of ``z`` (N,) up to the first that is not significant; 1 for white noise."""
    z = z - np.mean(z)
    n = len(z)
    power = float(z @ z)
    if power == 0 or n < 8:
        return 1.0
    total = 1.0
    for k in range(1, min(longest, n // 4)):
        rho = float(z[k:] @ z[:-k]) / power
        if rho < 2 / np.sqrt(n):
            break
        total += 2 * rho
    return total


def inflation(standardised: Array, parameters_common: int, parameters_differential: int) -> Inflation:
    """Variance factors from standardised residuals (B, C) of one run; never below one quarter.

    The mean over channels and the deviations from it are judged apart, because an error of the bath or of h moves
    all channels together and noise does not. Each factor is a mean square times a correlation length.
    """
    b, c = standardised.shape
    mean = np.mean(standardised, axis=1)
    rest = standardised - mean[:, None]
    common = c * float(np.sum(mean**2)) / max(b - parameters_common, 1) * correlation_length(mean)
    if c == 1:
        return Inflation(max(common, 0.25), 1.0)
    freedom = max((b * (c - 1)) - parameters_differential, 1)
    lengths = float(np.mean([correlation_length(column) for column in rest.T]))
    return Inflation(max(common, 0.25), max(float(np.sum(rest**2)) / freedom * lengths, 0.25))


def channel_sd(residual: Array, count: Array, freedom_share: float = 1.0) -> Array:
    """Noise of one sample per channel [K] from block residuals (B, C): robust, then scaled to a mean square."""
    scaled = residual * np.sqrt(count)
    sd = 1.4826 * np.median(np.abs(scaled), axis=0)
    inside = np.abs(scaled) < 4 * np.maximum(sd, 1e-12)
    square = np.sum(np.where(inside, scaled**2, 0.0), axis=0) / np.maximum(inside.sum(axis=0), 1)
    return np.asarray(np.sqrt(np.maximum(square, 1e-12) / freedom_share))
