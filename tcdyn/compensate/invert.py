"""The proper inverse behind the same interface as the smoother: a record in, temperature with its band out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tcdyn.chain import Chain
from tcdyn.compensate.inverse import lag_sensitivity, proper_inverse
from tcdyn.compensate.noise import channel_noise_sd
from tcdyn.compensate.result import Compensated
from tcdyn.compensate.smoother import stretch_of

Array = NDArray[np.float64]


def invert(
    y: ArrayLike,
    dt_s: float,
    chains: Chain | Sequence[Chain],
    bandwidth_Hz: float,
    *,
    noise_sd: ArrayLike | None = None,
    lag_covariance: ArrayLike | None = None,
    static_u: ArrayLike | None = None,
) -> Compensated:
    """Causal compensation of a whole record with a stated bandwidth; arguments and result as for ``smooth``.

    ``sd_noise`` is hypot(noise gain times noise, remaining shift times |slope|): the answer is late by the remaining
    shift and says so in its band instead of being moved. Bad samples are bridged by straight lines before filtering.
    """
    data = np.asarray(y, dtype=float)
    data = data[:, None] if data.ndim == 1 else data
    m = data.shape[1]
    sd = channel_noise_sd(data, noise_sd)
    stretch, flags, warnings = stretch_of(data, dt_s, chains, (), sd)
    x, lag, slope, own = (np.empty(data.shape) for _ in range(4))
    for c, chain in enumerate(stretch.chains):
        f = proper_inverse(chain, dt_s, bandwidth_Hz)
        x[:, c] = f(stretch.y[:, c])
        lag[:, c] = lag_sensitivity(f, stretch.y[:, c])
        slope[:, c] = np.gradient(x[:, c], dt_s)
        width = max(int(f.remaining_shift_s / dt_s), 1)
        calm = np.convolve(
            np.pad(slope[:, c], width, mode="edge"), np.ones(2 * width + 1) / (2 * width + 1), mode="valid"
        )
        own[:, c] = np.hypot(f.noise_gain * sd[c], f.remaining_shift_s * calm)
    lag_cov: Array = np.zeros((m, m)) if lag_covariance is None else np.asarray(lag_covariance, dtype=np.float64)
    line_u: Array = (
        np.zeros_like(x) if static_u is None else np.broadcast_to(np.asarray(static_u, dtype=float), x.shape)
    )
    total = np.asarray(np.sqrt(own**2 + lag**2 * np.diag(lag_cov) + line_u**2), dtype=np.float64)
    time = np.asarray(np.arange(len(x)) * dt_s, dtype=np.float64)
    return Compensated(
        x, total, own, slope, lag, line_u, lag_cov, sd, np.full(m, np.nan), flags, time,
        f"proper inverse, {bandwidth_Hz:g} Hz", warnings,
    )  # fmt: skip
