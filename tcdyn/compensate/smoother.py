"""The fixed-interval smoother: the temperature at the junction with a standard deviation for every sample."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calibration.errors import InputError
from tcdyn.chain import Chain
from tcdyn.compensate.grid import Grid
from tcdyn.compensate.intensity import choose
from tcdyn.compensate.model import Stretch, grid_for, problem_for
from tcdyn.compensate.noise import noise_sd as estimate_noise_sd
from tcdyn.compensate.profile import Intensity
from tcdyn.compensate.result import MISSING, Compensated
from tcdyn.compensate.sensor import Sensor, stacked
from tcdyn.compensate.sweep import backward, forward

Array = NDArray[np.float64]


def smooth(
    y: ArrayLike,
    dt_s: float,
    chains: Chain | Sequence[Chain],
    *,
    noise_sd: ArrayLike | None = None,
    intensity: float | Intensity | Sequence[float | Intensity] | None = None,
    events_s: Sequence[float] = (),
    lag_covariance: ArrayLike | None = None,
    static_u: ArrayLike | None = None,
) -> Compensated:
    """What the junctions did, given what their chains wrote: posterior mean and standard deviation, sample by sample.

    y = G x + noise; dx'/dt = white noise of intensity q(t) [K2/s3], x' free to jump at ``events_s``.

    Args:
        y: (N,) or (N, M) logged temperatures after the static line [degC], NaN where missing.
        dt_s: sampling interval [s].
        chains: one for all channels, or one per channel.
        noise_sd: per channel [K]; estimated when left out.
        intensity: q, a number or an ``Intensity`` per channel; by likelihood when left out.
        events_s: times from the first sample [s] at which the slope of x may jump (unloading), between samples too.
        lag_covariance: (M, M) covariance of the channels' lags [s2].
        static_u: standard uncertainty of the static line [K], scalar, (M,) or (N, M).

    Returns:
        ``Compensated`` with arrays (N, M).

    Raises:
        InputError: shapes that do not agree, a channel without samples.
    """
    data = np.asarray(y, dtype=float)
    data = data[:, None] if data.ndim == 1 else data
    stretch, flags = _stretch(data, dt_s, chains, events_s)
    m = data.shape[1]
    if noise_sd is None:
        start = np.array([estimate_noise_sd(data[:, c]) for c in range(m)])
    else:
        start = np.broadcast_to(np.asarray(noise_sd, dtype=float), (m,)).copy()
    if intensity is None:
        chosen, noise_var = choose(stretch, start**2, noise_known=noise_sd is not None)
    else:
        chosen, noise_var = _given(intensity, m), start**2
    proposals = [[q] for q in chosen]
    grid = grid_for(stretch, proposals, noise_var)
    problem = problem_for(stretch, grid, noise_var, proposals)
    mean, cov = backward(problem, forward(problem))
    x, slope, sd, lag = _at_samples(stretch, grid, mean, cov)
    lag_cov = np.zeros((m, m)) if lag_covariance is None else np.asarray(lag_covariance, dtype=float)
    line_u = np.zeros_like(x) if static_u is None else np.broadcast_to(np.asarray(static_u, dtype=float), x.shape)
    total = np.sqrt(sd**2 + lag**2 * np.diag(lag_cov) + line_u**2)
    time = np.arange(len(x)) * dt_s
    level = np.array([float(np.median(q.at(time[:: max(len(time) // 2000, 1)]))) for q in chosen])
    return Compensated(
        x, total, sd, slope, lag, np.asarray(line_u), lag_cov, np.sqrt(noise_var), level, flags, time,
        "fixed-interval smoother",
    )  # fmt: skip


def _stretch(
    data: Array, dt_s: float, chains: Chain | Sequence[Chain], events_s: Sequence[float]
) -> tuple[Stretch, NDArray[np.uint8]]:
    n, m = data.shape
    listed = [chains] * m if isinstance(chains, Chain) else list(chains)
    if len(listed) != m:
        raise InputError(
            f"smooth: {m} channels but {len(listed)} chains", expected="one chain, or one per channel"
        )
    if n < 8 or not dt_s > 0:
        raise InputError(
            f"smooth: {n} samples every {dt_s:g} s", expected="at least 8 samples and a positive interval"
        )
    missing = ~np.isfinite(data)
    if np.any(missing.sum(axis=0) > n - 8):
        c = int(np.argmax(missing.sum(axis=0)))
        raise InputError(f"smooth: channel {c} has fewer than 8 samples", remedy="leave this channel out")
    flags = np.where(missing, MISSING, 0).astype(np.uint8)
    y = np.where(missing, 0.0, data)
    weight = np.where(missing, 0.0, 1.0)
    events = tuple(sorted({float(e) for e in events_s if 0 < e < (n - 1) * dt_s}))
    return Stretch(y, weight, dt_s, tuple(listed), tuple(stacked(listed)), events), flags


def _given(intensity: float | Intensity | Sequence[float | Intensity], m: int) -> list[Intensity]:
    if isinstance(intensity, Intensity):
        listed: list[float | Intensity] = [intensity] * m
    else:
        listed = list(np.broadcast_to(np.asarray(intensity, dtype=object), (m,)))
    return [q if isinstance(q, Intensity) else Intensity.constant(q) for q in listed]


def _at_samples(stretch: Stretch, grid: Grid, mean: Array, cov: Array) -> tuple[Array, Array, Array, Array]:
    """Temperature, slope, sd and lag sensitivity (N, M) at the sample times from the states at the knots."""
    n, m = stretch.y.shape
    t = np.arange(n) * stretch.dt_s
    cell = np.clip(np.searchsorted(grid.knots_s, t + 1e-6 * stretch.dt_s, side="right") - 1, 0, grid.cells - 1)
    along = (t - grid.knots_s[cell])[:, None]
    x, slope = mean[cell, :, 0] + along * mean[cell, :, 1], mean[cell, :, 1]
    var = cov[cell, :, 0, 0] + 2 * along * cov[cell, :, 0, 1] + along**2 * cov[cell, :, 1, 1]
    rows = np.stack([s.lag_row for s in stretch.sensors])
    at_knot = np.einsum("jmn,mn->jm", mean, rows)
    following = np.concatenate([at_knot[1:], at_knot[-1:]])
    part = np.clip(along / np.diff(grid.knots_s)[cell][:, None], 0, 1)
    lag = (1 - part) * at_knot[cell] + part * following[cell]
    return x, slope, np.sqrt(np.maximum(var, 0.0)), lag
