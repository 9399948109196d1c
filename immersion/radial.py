"""The plunged disk: surface temperature and heat flux in time, and the temperature at each junction."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import solve_triangular

from immersion.cylinder import Cylinder, influence
from tcdyn.core import Array
from tcdyn.core.errors import InputError

FluxLaw = Callable[
    [Array], Array
]  # surface temperatures (..., n) on the grid [degC] -> flux into the disk [W/m2]


def plunge_grid(
    duration_s: float, first_s: float = 0.02, growth: float = 0.025, longest_s: float = 2.0
) -> Array:
    """Times after entry [s]: ``first_s`` apart in the first second, then ever wider up to ``longest_s``.

    >>> grid = plunge_grid(300.0)
    >>> bool(grid[0] == 0.0 and grid[-1] >= 300.0 and len(grid) < 400)
    True
    """
    times = [0.0, first_s / 8, first_s / 4, first_s / 2]
    t = first_s
    while t < duration_s:
        times.append(t)
        t += min(first_s + growth * max(t - 1.0, 0.0), longest_s)
    times.append(max(t, duration_s))
    return np.array(times)


@dataclass(frozen=True)
class Reading:
    """Where block times fall on the grid: interval, share of the way through it, and whether after the entry."""

    interval: NDArray[np.intp]
    share: Array
    width_s: Array
    after: NDArray[np.bool_]

    @classmethod
    def at(cls, grid_s: Array, times_s: Array) -> Reading:
        """For times after entry ``times_s`` (..., B); earlier ones read the initial state."""
        interval = np.clip(np.searchsorted(grid_s, times_s, side="right") - 1, 0, len(grid_s) - 2)
        width = np.diff(grid_s)[interval]
        after = times_s > 0
        share = np.where(after, (times_s - grid_s[interval]) / width, 0.0)
        return cls(interval, share, width, after)

    def value(self, y: Array) -> Array:
        """Deviations ``y`` (..., n) at the blocks (..., B): straight lines between knots, zero before entry."""
        low, high = self._ends(y)
        return np.asarray(self.after * low + self.share * (high - low))

    def slope(self, y: Array) -> Array:
        """Time derivative at the blocks [1/s]."""
        low, high = self._ends(y)
        return np.asarray(self.after / self.width_s * (high - low))

    def _ends(self, y: Array) -> tuple[Array, Array]:
        """Of the intervals; times of several rows (C, B) are those of the rows (..., C, n) of y."""
        if self.interval.ndim == 1:
            return y[..., self.interval], y[..., self.interval + 1]
        at = self.interval + y.shape[-1] * np.arange(len(self.interval))[:, None]
        flat = y.reshape(*y.shape[:-2], -1)
        return np.take(flat, at, axis=-1), np.take(flat, at + 1, axis=-1)


def unit_less(slope: Array, own: Array) -> Array:
    """The unit matrix less ``slope`` (n,) times the rows of ``own`` (n, n)."""
    out = -slope[:, None] * own
    out.flat[:: len(own) + 1] += 1.0
    return np.asarray(out)


def solve_surface(
    own: Array,
    offset: Array,
    law: FluxLaw,
    *,
    start: Array | None = None,
    tolerance_K: float = 1e-5,
    limit: int = 40,
) -> tuple[Array, Array, Array]:
    """Solve T_s = offset + own @ q, q = law(T_s) on the grid (a Volterra equation) by Newton.

    ``own`` (n, n) is the surface's influence matrix, lower triangular. Returns T_s [degC], q [W/m2] and dq/dT_s, each
    (n,). ``start`` is a first guess of T_s. The law's derivative is a central difference of 0.01 K; each Newton step
    is a triangular solve, and the last one moved nothing by ``tolerance_K``: what is left is its square.
    Raises InputError when it does not converge (a law that is not a cooling law).
    """
    surface = np.array(offset if start is None else start, dtype=float)
    q = np.zeros_like(surface)
    slope = q
    for _ in range(limit):
        up, down = law(np.stack([surface + 0.01, surface - 0.01]))
        slope = (up - down) / 0.02
        # law is linearised about surface: q = middle + slope (offset + own q - surface)
        middle = (up + down) / 2
        q = solve_triangular(
            unit_less(slope, own),
            middle + slope * (offset - surface),
            lower=True,
            check_finite=False,
        )
        new = offset + own @ q
        change = float(np.max(np.abs(new - surface)))
        surface = new
        if not np.isfinite(change):
            break
        if change < tolerance_K:
            return surface, q, slope
    raise InputError(
        "the surface heat balance of the plunge did not converge",
        remedy="check fluid, h and geometry",
    )


@dataclass(frozen=True)
class PlungeResponse:
    """A simulated plunge: time after entry (n,), surface temperature, flux, h, and temperature at P depths (n, P)."""

    t_s: Array
    surface_degC: Array
    flux_W_m2: Array
    h_W_m2K: Array
    junction_degC: Array
    depth_m: Array

    def at(self, time_s: ArrayLike, entry_s: float) -> Array:
        """Junction temperatures (N, P) at ``time_s`` of a record whose entry was at ``entry_s``; initial before."""
        t = np.asarray(time_s, dtype=float) - entry_s
        return np.column_stack([np.interp(t, self.t_s, column) for column in self.junction_degC.T])


def simulate_plunge_model(
    cylinder: Cylinder,
    depth_m: ArrayLike,
    h_W_m2K: Callable[[Array, Array, Array], Array],
    initial_degC: float,
    fluid_degC: float | Callable[[Array], Array],
    duration_s: float,
    *,
    grid_s: Array | None = None,
    modes: int = 24,
) -> PlungeResponse:
    """Temperatures of a disk plunged at t = 0 into a bath, conduction exact, h following the surface temperature.

    K dT/dr = h(T_s, T_f, t) (T_f - T_s) at R_o, dT/dr = 0 at the bore. ``h_W_m2K(T_s, T_f, t)`` works on arrays (n,);
    ``fluid_degC`` is a number or a function of time after entry (bath drift). Junctions lie ``depth_m`` (P,) below the
    surface. Time is graded: fine at entry, seconds later on (``plunge_grid``).
    """
    t = plunge_grid(duration_s) if grid_s is None else np.asarray(grid_s, dtype=float)
    depths = np.asarray(depth_m, dtype=float)
    radii = cylinder.outer_radius_m - np.concatenate([[0.0], depths])
    matrix, leak = influence(cylinder, radii, t, modes)
    fluid = np.asarray(
        fluid_degC(t) if callable(fluid_degC) else np.full(len(t), float(fluid_degC))
    )
    offset = initial_degC + leak @ (fluid - initial_degC)
    surface, q, _ = solve_surface(
        matrix[0], offset, lambda T: np.array([h_W_m2K(x, fluid, t) * (fluid - x) for x in T])
    )
    junctions = offset[:, None] + np.einsum("pij,j->ip", matrix[1:], q)
    return PlungeResponse(t, surface, q, h_W_m2K(surface, fluid, t), junctions, depths)
