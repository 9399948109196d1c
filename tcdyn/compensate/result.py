"""What every compensator returns: temperature and a standard deviation made of named parts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tcdyn.compensate.profile import Intensity

Array = NDArray[np.float64]
GOOD, MISSING, SPIKE, STUCK, SATURATED = 0, 1, 2, 4, 8  # bits of ``flags``


@dataclass(frozen=True)
class Compensated:
    """A compensated record; all arrays (N, M), one column a channel.

    ``temperature`` [degC] at the junction at ``time_s``; ``sd`` [K] its standard deviation, from ``sd_noise`` (noise
    and regularisation), ``lag_sensitivity`` [K/s] times the uncertainty of each lag, and ``static_u`` [K].
    ``slope`` [K/s]; ``noise_sd (M,)`` [K]; ``intensity (M,)`` [K2/s3], the median over the record; ``flags``: bits
    MISSING, SPIKE, STUCK, SATURATED; ``method`` in words; ``events_s``: pairs of time and its standard uncertainty [s];
    ``intensities``: as functions of time, one a channel (smoother only).
    """

    temperature: Array
    sd: Array
    sd_noise: Array
    slope: Array
    lag_sensitivity: Array
    static_u: Array
    lag_covariance: Array
    noise_sd: Array
    intensity: Array
    flags: NDArray[np.uint8]
    time_s: Array
    method: str
    warnings: tuple[str, ...] = ()
    events_s: tuple[tuple[float, float], ...] = ()
    intensities: tuple[Intensity, ...] = ()

    def common_sd(self) -> Array:
        """Part of ``sd`` (N, M) that comes from the lag common to all channels, hence moves them together [K]."""
        m = len(self.lag_covariance)
        mean_u = float(np.sqrt(max(np.sum(self.lag_covariance), 0.0))) / m
        return np.abs(self.lag_sensitivity) * mean_u

    def lag_crosscovariance(self, i: int, j: int) -> Array:
        """Covariance (N,) [K2] of channels i and j at equal times through their lags."""
        return np.asarray(self.lag_sensitivity[:, i] * self.lag_sensitivity[:, j] * self.lag_covariance[i, j])

    def summary(self) -> str:
        """A few lines for people."""
        lines = [f"{self.method}: {self.temperature.shape[0]} samples, {self.temperature.shape[1]} channels"]
        for c in range(self.temperature.shape[1]):
            flagged = int(np.count_nonzero(self.flags[:, c]))
            lines.append(
                f"  channel {c}: noise {self.noise_sd[c]:.3g} K, standard deviation {np.median(self.sd[:, c]):.3g} K "
                f"typical, {np.max(self.sd[:, c]):.3g} K at most, {flagged} samples flagged"
            )
        lines += [f"  slope free to jump at {t:.4f} s (+- {u:.2g} s)" for t, u in self.events_s]
        return "\n".join([*lines, *self.warnings])
