"""Regularised deconvolution with zero phase, its weight by discrepancy, GCV or the corner of the L-curve."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from calibration.arrays import Array
from tcdyn.chain import Chain
from tcdyn.compensate.grid import Intensity, read_variance, readings
from tcdyn.compensate.result import Compensated, channel_noise_sd, columns_of
from tcdyn.compensate.smoother import smooth
from tcdyn.compensate.sweep import Stretch, stretch_of, swept

Criterion = Literal["gcv", "discrepancy", "l-curve"]
CRITERIA = get_args(Criterion)


@dataclass(frozen=True)
class Tradeoff:
    """The choice of weight as data, one row a trial: ``intensity (L, M)`` = noise variance / weight [K2/s3],

    ``misfit (L, M)`` mean square residual [K2], ``roughness (L, M)`` integral of x''2 [K2/s3], ``freedom (L, M)``
    trace of the influence matrix, ``chosen (M,)`` [K2/s3].
    """

    intensity: Array
    misfit: Array
    roughness: Array
    freedom: Array
    chosen: Array
    criterion: str


def deconvolve(
    y: ArrayLike,
    dt_s: float,
    chains: Chain | Sequence[Chain],
    *,
    criterion: Criterion = "gcv",
    noise_sd: ArrayLike | None = None,
    lag_covariance: ArrayLike | None = None,
    static_u: ArrayLike | None = None,
    names: Sequence[str] | None = None,
    trials: int = 25,
) -> tuple[Compensated, Tradeoff]:
    """Minimise sum (y - G x)^2 + weight integral x''^2 dt, a filter without phase, edges exact.

    ``discrepancy``: mean square residual equal to the noise variance; ``gcv``: least generalised cross-validation
    score, which need not know the noise; ``l-curve``: largest curvature of log misfit against log roughness. The
    standard deviation is the Bayesian one of the same penalty (Wahba 1983), which holds noise and average bias.

    Args:
        y: (N,) or (N, M) logged temperatures after the static line [degC], NaN where missing.
        dt_s: sampling interval [s].
        chains: one for all channels or one per channel.
        noise_sd: per channel [K]; estimated when left out.
        lag_covariance, static_u, names: as in ``smooth``.
        trials: number of weights tried, evenly in their logarithm.
    """
    data = columns_of(y)
    m = data.shape[1]
    sd = channel_noise_sd(data, noise_sd)
    stretch, _, _ = stretch_of(data, dt_s, chains, (), sd, names)
    levels = np.geomspace(1e-4, 1e7, trials)
    rows = [_trial(stretch, sd**2, level * sd**2) for level in levels]
    misfit, roughness, freedom = (np.array([row[k] for row in rows]) for k in range(3))
    used = (stretch.weight > 0).sum(axis=0)
    chosen = np.array(
        [_pick(criterion, levels, misfit[:, c], roughness[:, c], freedom[:, c], used[c], sd[c] ** 2) for c in range(m)]
    )
    result = smooth(
        data,
        dt_s,
        chains,
        noise_sd=sd,
        intensity=list(chosen * sd**2),
        lag_covariance=lag_covariance,
        static_u=static_u,
        names=names,
    )
    named = replace(result, method=f"regularised deconvolution, weight by {criterion}")
    return named, Tradeoff(levels[:, None] * sd**2, misfit, roughness, freedom, chosen * sd**2, criterion)


def _trial(stretch: Stretch, noise_var: Array, level: Array) -> tuple[Array, Array, Array]:
    """Misfit, roughness and freedom (M,) at one intensity per channel."""
    grid, states = swept(stretch, noise_var, [Intensity.constant(q) for q in level])
    n = len(stretch.y)
    misfit, roughness, freedom = [], [], []
    lengths = np.diff(grid.knots_s)
    for c, s in enumerate(stretch.sensors):
        w = stretch.weight[:, c]
        residual = stretch.y[:, c] - readings(grid, s, states.mean[:, c], n, stretch.dt_s)
        misfit.append(float(np.sum(w * residual**2) / np.sum(w)))
        roughness.append(float(np.sum(np.diff(states.mean[:, c, 1]) ** 2 / lengths[1:])))
        variance = read_variance(grid, s, states.cov[:, c], n, stretch.dt_s)
        freedom.append(float(np.sum(w * variance) / noise_var[c]))
    return np.array(misfit), np.array(roughness), np.array(freedom)


def _pick(
    criterion: Criterion, levels: Array, misfit: Array, roughness: Array, freedom: Array, used: int, noise_var: float
) -> float:
    """Intensity over noise variance that meets the criterion, between the trials by a parabola or a straight line."""
    logs = np.log(levels)
    if criterion == "discrepancy":
        above = np.flatnonzero(misfit > noise_var)
        if len(above) == 0:
            return float(levels[0])
        k = int(min(above[-1], len(levels) - 2))
        part = (np.log(misfit[k]) - np.log(noise_var)) / (np.log(misfit[k]) - np.log(misfit[k + 1]))
        return float(np.exp(logs[k] + np.clip(part, 0, 1) * (logs[k + 1] - logs[k])))
    if criterion == "gcv":
        score = np.log(misfit / (1 - freedom / used) ** 2)
    else:
        a, b = np.log(misfit), np.log(np.maximum(roughness, 1e-300))
        da, db = np.gradient(a, logs), np.gradient(b, logs)
        bend = (da * np.gradient(db, logs) - db * np.gradient(da, logs)) / (da**2 + db**2) ** 1.5
        score = -np.abs(bend)
        score[:2] = score[-2:] = np.inf
    k = int(np.argmin(score))
    if criterion == "l-curve" or k in (0, len(levels) - 1):
        return float(levels[k])
    c2, c1, _ = np.polyfit(logs[k - 1 : k + 2] - logs[k], score[k - 1 : k + 2], 2)
    return float(levels[k] * np.exp(np.clip(-c1 / (2 * c2), -1, 1)))
