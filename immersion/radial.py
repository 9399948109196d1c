"""Temperatures of a plunged disk: grid, Newton solver of the surface heat balance, model.

:func:`solve_surface` and :func:`plunge_grid` are used by :mod:`immersion.plunge_model`;
:func:`simulate_plunge_model` by ``tcdyn verify`` and the tests. The surface obeys a Volterra
equation with the influence matrices of :mod:`immersion.cylinder`. Tests:
``tests/immersion/test_immersion_radial.py`` (exact series, second order, energy).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import solve_triangular

from immersion.cylinder import Cylinder, influence
from tcdyn.core import Array, Flags
from tcdyn.core.errors import InputError

# Surface temperatures (..., n) on the grid [degC] -> flux into the disk [W/m2].
FluxLaw = Callable[[Array], Array]
SURFACE_STEP_K = 0.01  # step of the derivative of the flux law [K]; chosen by judgement


def plunge_grid(
    duration_s: float, first_s: float = 0.02, growth: float = 0.025, longest_s: float = 2.0
) -> Array:
    """Times after the entry [s], fine at first and then growing.

    Parameters
    ----------
    duration_s
        End of the grid [s].
    first_s
        Step in the first second [s]; the first steps are shorter.
    growth
        Growth of the step over the time since the first second [1].
    longest_s
        Longest step [s].

    Returns
    -------
    times
        (n,), from 0 to ``duration_s`` or beyond.

    Notes
    -----
    The steps are chosen by judgement. The error is of second order in them:
    ``tests/immersion/test_immersion_radial.py``. Grids of one set of steps share their leading
    knots, which :class:`immersion.plunge_model.RunModel` uses.

    Examples
    --------
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
class GridInterpolation:
    """Linear interpolation from the grid to block times.

    Attributes
    ----------
    interval
        Index of the knot before each time.
    share
        Position within the interval, 0 to 1; 0 before the entry.
    width_s
        Length of the interval [s].
    after
        Whether the time is after the entry.
    """

    interval: NDArray[np.intp]
    share: Array
    width_s: Array
    after: Flags

    @classmethod
    def at(cls, grid_s: Array, times_s: Array) -> GridInterpolation:
        """The interpolation to given times; times before the entry read the initial state.

        Parameters
        ----------
        grid_s
            Grid (n,) [s].
        times_s
            Times after the entry (B,) or (C, B) [s].
        """
        interval = np.clip(np.searchsorted(grid_s, times_s, side="right") - 1, 0, len(grid_s) - 2)
        width = np.diff(grid_s)[interval]
        after = times_s > 0
        share = np.where(after, (times_s - grid_s[interval]) / width, 0.0)
        return cls(interval, share, width, after)

    def value(self, y: Array) -> Array:
        """Deviations ``y`` (..., n) at the block times: linear between knots, zero before entry.

        Parameters
        ----------
        y
            Deviations from the initial state on the grid (..., n), or (..., C, n) for times (C, B).

        Returns
        -------
        value
            (..., B).
        """
        low, high = self._interval_ends(y)
        return self.after * low + self.share * (high - low)

    def slope(self, y: Array) -> Array:
        """Time derivative at the block times [1/s].

        Parameters
        ----------
        y
            As in :meth:`value`.

        Returns
        -------
        slope
            (..., B), constant between knots, zero before the entry.
        """
        low, high = self._interval_ends(y)
        return self.after / self.width_s * (high - low)

    def _interval_ends(self, y: Array) -> tuple[Array, Array]:
        """Values of ``y`` at both ends of each interval.

        Times (C, B) read the rows of ``y`` (..., C, n), each channel its own.
        """
        if self.interval.ndim == 1:
            return y[..., self.interval], y[..., self.interval + 1]
        index = self.interval + y.shape[-1] * np.arange(len(self.interval))[:, None]
        flat = y.reshape(*y.shape[:-2], -1)
        return np.take(flat, index, axis=-1), np.take(flat, index + 1, axis=-1)


def identity_minus_product(slope: Array, matrix: Array) -> Array:
    """I - diag(slope) matrix.

    Parameters
    ----------
    slope
        (n,).
    matrix
        (n, n).

    Returns
    -------
    matrix
        (n, n).
    """
    out = -slope[:, None] * matrix
    out.flat[:: len(matrix) + 1] += 1.0
    return out


def solve_surface(
    matrix: Array,
    offset: Array,
    law: FluxLaw,
    *,
    start: Array | None = None,
    tolerance_K: float = 1e-5,
    limit: int = 40,
) -> tuple[Array, Array, Array]:
    """Solve the Volterra equation T_s = offset + matrix @ law(T_s) on the grid by Newton's method.

    Parameters
    ----------
    matrix
        Influence of the flux on the surface (n, n), lower triangular.
    offset
        Surface temperature without flux (n,) [degC].
    law
        Flux as a function of the surface temperature.
    start
        First guess of T_s (n,); None: ``offset``.
    tolerance_K
        The iteration ends with a step smaller than this; the remaining error is of the order of its
        square.
    limit
        Largest number of steps.

    Returns
    -------
    temperature_degC, flux_W_m2, slope
        T_s, q and dq/dT_s, each (n,).

    Raises
    ------
    InputError
        When it does not converge (a law that does not cool).

    Notes
    -----
    The derivative of the law is a central difference of 0.01 K. Each Newton step is one triangular
    solve.

    ``tolerance_K`` may be changed; the derivatives of :func:`immersion.plunge_model.solve_run`
    assume a converged surface. Test: ``tests/immersion/test_immersion_radial.py``.
    """
    surface = np.array(offset if start is None else start, dtype=float)
    for _ in range(limit):
        up, down = law(np.stack([surface + SURFACE_STEP_K, surface - SURFACE_STEP_K]))
        slope = (up - down) / (2 * SURFACE_STEP_K)
        # the law, linearised about surface: q = middle + slope (offset + matrix q - surface)
        middle = (up + down) / 2
        q = solve_triangular(
            identity_minus_product(slope, matrix),
            middle + slope * (offset - surface),
            lower=True,
            check_finite=False,
        )
        new = offset + matrix @ q
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
    """A simulated plunge: times (n,), surface, flux, h, and temperature at P depths (n, P).

    Attributes
    ----------
    t_s
        Times after the entry (n,).
    surface_degC, flux_W_m2, h_W_m2K
        Running surface (n,).
    junction_degC
        Temperatures at the depths (n, P).
    depth_m
        Depths (P,).
    """

    t_s: Array
    surface_degC: Array
    flux_W_m2: Array
    h_W_m2K: Array
    junction_degC: Array
    depth_m: Array

    def at(self, time_s: ArrayLike, entry_s: float) -> Array:
        """Junction temperatures at the times of a record.

        Parameters
        ----------
        time_s
            Times of the record (N,) [s].
        entry_s
            Entry in the time of the record [s].

        Returns
        -------
        temperatures
            (N, P) [degC].
        """
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
    """Temperatures of a disk that is plunged into a bath at t = 0.

    Parameters
    ----------
    cylinder
        The disk.
    depth_m
        Depths of the junctions below the running surface (P,) [m].
    h_W_m2K
        Heat transfer coefficient as a function of (T_s, T_f, t), on arrays (n,).
    initial_degC
        Temperature of the disk before the entry.
    fluid_degC
        Bath temperature: a number, or a function of the time after the entry (drift of the bath).
    duration_s
        End of the simulation.
    grid_s
        Times after the entry; None: ``plunge_grid``, fine at the entry and coarse later.
    modes
        Number of modes that are stepped exactly.

    Returns
    -------
    response
        Temperatures on the grid.

    Notes
    -----
    K dT/dr = h(T_s, T_f, t) (T_f - T_s) at R_o, dT/dr = 0 at the bore. Conduction is exact.
    """
    t = plunge_grid(duration_s) if grid_s is None else np.asarray(grid_s, dtype=float)
    depths = np.asarray(depth_m, dtype=float)
    radii = cylinder.outer_radius_m - np.concatenate([[0.0], depths])
    matrix, leak = influence(cylinder, radii, t, modes)
    if callable(fluid_degC):
        fluid = fluid_degC(t)
    else:
        fluid = np.full(len(t), float(fluid_degC))
    offset = initial_degC + leak @ (fluid - initial_degC)

    def law(surfaces: Array) -> Array:
        """Flux for each row of surface temperatures."""
        return np.array([h_W_m2K(T, fluid, t) * (fluid - T) for T in surfaces])

    surface, q, _ = solve_surface(matrix[0], offset, law)
    junctions = offset[:, None] + np.einsum("pij,j->ip", matrix[1:], q)
    return PlungeResponse(t, surface, q, h_W_m2K(surface, fluid, t), junctions, depths)
