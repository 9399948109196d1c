"""Lags on a grid of unequal steps, and reading the grid at the blocks' times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dtbtrs, ztbtrs

from calibration.disk import Conditioning
from immersion.cylinder import lag_step

Array = NDArray[np.float64]


def lag_on_grid(u: Array, dt_s: Array, rate: float | complex) -> NDArray[np.float64] | NDArray[np.complex128]:
    """Unit-gain lag of ``rate`` [1/s] of deviations ``u`` (n, M) from equilibrium, linear between knots.

    Exact for that input; y[0] = 0, as before the first knot nothing had changed.
    """
    decay, old, new = lag_step(dt_s, rate)
    drive = np.zeros(u.shape, dtype=np.result_type(u, decay), order="F")
    drive[1:] = old[:, None] * u[:-1] + new[:, None] * u[1:]
    bands = np.zeros((2, len(u)), dtype=decay.dtype)
    bands[1, :-1] = -decay
    solve = ztbtrs if np.iscomplexobj(bands) else dtbtrs  # unit diagonal; thrice as quick as solve_banded's checks
    return np.asarray(solve(bands, drive, uplo="L", diag="U", overwrite_b=True)[0])


def conditioned(u: Array, dt_s: Array, filter_: Conditioning) -> Array:
    """The conditioning filter B applied to deviations ``u`` (n, M) on the grid."""
    for f in filter_.factors():
        if len(f) == 2:
            u = np.asarray(lag_on_grid(u, dt_s, 1 / f[1]))
        else:  # two complex lags side by side: p1 p2/((s - p1)(s - p2)) = 2 Re of its first partial fraction
            p = complex(np.roots(f[::-1])[0])
            u = np.asarray(np.real(p.conjugate() / (1j * p.imag) * -lag_on_grid(u, dt_s, -p)))
    return u


@dataclass(frozen=True)
class Reading:
    """Where block times fall on the grid: interval, share of the way through it, and whether after the entry."""

    interval: NDArray[np.intp]
    share: Array
    width_s: Array
    after: NDArray[np.bool_]

    @classmethod
    def at(cls, grid_s: Array, times_s: Array) -> Reading:
        """For times after entry ``times_s`` (B,); earlier ones read the initial state."""
        interval = np.clip(np.searchsorted(grid_s, times_s, side="right") - 1, 0, len(grid_s) - 2)
        width = np.diff(grid_s)[interval]
        after = times_s > 0
        share = np.where(after, (times_s - grid_s[interval]) / width, 0.0)
        return cls(interval, share, width, after)

    def value(self, y: Array) -> Array:
        """Deviation ``y`` (n, ...) at the blocks: straight lines between knots, zero before entry."""
        w = (self.share * self.after).reshape(-1, *(1,) * (y.ndim - 1))
        keep = self.after.reshape(w.shape)
        return np.asarray(keep * y[self.interval] + w * (y[self.interval + 1] - y[self.interval]))

    def slope(self, y: Array) -> Array:
        """Time derivative at the blocks [1/s]."""
        keep = (self.after / self.width_s).reshape(-1, *(1,) * (y.ndim - 1))
        return np.asarray(keep * (y[self.interval + 1] - y[self.interval]))
