"""How noisy each channel is, from its fastest wiggles, whatever the spikes."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calibration.noise import white_noise_sd

Array = NDArray[np.float64]


def channel_noise_sd(data: Array, given: ArrayLike | None) -> Array:
    """Noise (M,) of the channels of ``data (N, M)``: as ``given``, one number for all allowed, or estimated."""
    m = data.shape[1]
    if given is None:
        return np.array([noise_sd(data[:, c]) for c in range(m)])
    return np.broadcast_to(np.asarray(given, dtype=np.float64), (m,)).copy()


def noise_sd(y: Array, fallback: float = 1e-6) -> float:
    """Standard deviation [same unit] of white noise on a smooth trace ``y (N,)``, NaN for missing.

    sd = 1.4826 median |fourth difference| / sqrt(70); a signal slower than a tenth of the sampling rate leaves less
    than 2 % of its amplitude. A trace that rests on one step of its logger gets a quarter of that step.
    """
    if np.count_nonzero(np.isfinite(np.diff(y, n=4))) < 8:
        return fallback
    sd = float(white_noise_sd(y, 4, centred=False))
    if sd > 0:
        return sd
    steps = np.abs(np.diff(y[np.isfinite(y)]))
    steps = steps[steps > 0]
    return float(np.min(steps)) / 4 if len(steps) else fallback
