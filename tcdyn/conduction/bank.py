"""The lag bank: a record filtered once by lags of fixed rates; every rim's output is a weighted sum of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.signal import lfilter

from calibration.arrays import Array
from calibration.errors import InputError

SLOWEST_PER_S = 0.3  # below the slowest mode of a 6 mm rim of steel (0.7 1/s)
NODES = 40


@dataclass(frozen=True)
class Switch:
    """A held input that jumps in ``[t_index, t_index+1)``: ``before`` for ``fraction`` of it, then ``after``."""

    index: int
    fraction: float
    before: float
    after: float


def node_rates(dt_s: float, count: int = NODES, slowest_per_s: float = SLOWEST_PER_S) -> Array:
    """Chebyshev nodes (second kind) in log(rate) from ``slowest_per_s`` to 40/dt, ascending, (K,) [1/s].

    >>> node_rates(1 / 75)[[0, -1]].round(6)
    array([3.e-01, 3.e+03])
    """
    if not dt_s > 0:
        raise InputError(f"node_rates: dt_s must be positive; got {dt_s}")
    x = -np.cos(np.pi * np.arange(count) / (count - 1))
    low, high = np.log(slowest_per_s), np.log(40.0 / dt_s)
    return np.asarray(np.exp(low + (high - low) * (x + 1) / 2))


@lru_cache(maxsize=16)
def _barycentric(count: int) -> tuple[Array, Array, Array]:
    """Nodes on [-1, 1], barycentric weights and the differentiation matrix D (l_k' = sum_j l_j D_jk)."""
    x = -np.cos(np.pi * np.arange(count) / (count - 1))
    w: Array = np.where(np.arange(count) % 2, -1.0, 1.0)
    w[[0, -1]] /= 2
    gap = x[:, None] - x[None, :] + np.eye(count)
    d = (w[None, :] / w[:, None]) / gap
    np.fill_diagonal(d, 0.0)
    np.fill_diagonal(d, -d.sum(axis=1))
    return x, w, np.asarray(d)


def cardinal(rates_per_s: Array, log_lambda: Array) -> Array:
    """Weights (M, K) of the bank's lags that make up lags of log-rates ``log_lambda`` (M,); rows sum to one.

    Barycentric interpolation in log(rate): exp(-e^x t) is entire in x, so 40 nodes over four decades leave 1e-6.
    """
    x, w, _ = _barycentric(len(rates_per_s))
    low, high = np.log(rates_per_s[0]), np.log(rates_per_s[-1])
    scaled = (2 * log_lambda - low - high) / (high - low)
    weights = scaled[:, None] - x
    with np.errstate(divide="ignore", invalid="ignore"):
        np.divide(w, weights, out=weights)
        total = weights.sum(axis=1)
        weights /= total[:, None]
    for row in np.flatnonzero(~np.isfinite(total)):  # exactly on a node
        weights[row] = np.arange(len(x)) == np.argmin(np.abs(scaled[row] - x))
    return np.asarray(weights)


def cardinal_slope(rates_per_s: Array, weights: Array) -> Array:
    """d(weights)/d(log lambda) for the ``weights`` (M, K) that ``cardinal`` returned."""
    d = _barycentric(len(rates_per_s))[2]
    return np.asarray(weights @ d * (2 / np.log(rates_per_s[-1] / rates_per_s[0])))


def lag_bank(
    u: ArrayLike,
    dt_s: float,
    rates: Array,
    hold: Literal["foh", "zoh"] = "foh",
    switches: Sequence[Switch] = (),
    initial: Array | None = None,
) -> Array:
    """Exact response (N, K) of the lags 1/(1 + s/rate_k) to ``u`` (N,) sampled every ``dt_s``.

    Between samples ``u`` is a straight line ("foh") or held at its earlier sample ("zoh"), where ``switches`` say
    when inside a sample a held input jumps. ``initial``: the K states at the first sample, by default in
    equilibrium with it. The state at sample k knows nothing of what a held input does from then on.

    >>> lag_bank([0.0, 0.0, 1.0, 1.0], 1.0, np.array([2.0]), "zoh").round(4).ravel()
    array([0.    , 0.    , 0.    , 0.8647])
    """
    u = np.asarray(u, dtype=float)
    if u.ndim != 1 or not len(u) or not np.isfinite(u).all():
        raise InputError(f"lag_bank: u must be a row of finite numbers; got shape {u.shape}")
    start = np.full(len(rates), u[0]) if initial is None else np.asarray(initial, dtype=float)
    out = np.empty((len(rates), len(u)))
    out[:, 0] = start
    extra = np.array([_switch_extra(s, u, dt_s, rates) for s in switches]).reshape(len(switches), len(rates))
    for k, rate in enumerate(rates):
        x = rate * dt_s
        decay, rise = np.exp(-x), -np.expm1(-x)
        if hold == "foh":
            ramp = 1 - rise / x if x > 1e-4 else x / 2 - x * x / 6
            drive = ramp * u[1:] + (rise - ramp) * u[:-1]
        else:
            drive = rise * u[:-1]
            for s, add in zip(switches, extra[:, k], strict=True):
                drive[s.index] += add
        out[k, 1:] = lfilter([1.0], [1.0, -decay], drive, zi=[decay * start[k]])[0]
    return out.T


def _switch_extra(s: Switch, u: Array, dt_s: float, rates: Array) -> Array:
    """What a jump inside sample ``s.index`` adds to the plain hold of ``u[s.index]``, (K,)."""
    if not (0 <= s.index < len(u) - 1 and 0 <= s.fraction <= 1):
        raise InputError(f"lag_bank: {s} lies outside a record of {len(u)} samples")
    late = -np.expm1(-rates * dt_s * (1 - s.fraction))
    whole = -np.expm1(-rates * dt_s)
    return np.asarray(s.before * (whole - late) + s.after * late - u[s.index] * whole)
