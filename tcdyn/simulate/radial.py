"""One-dimensional radial heating of an immersed disk, insulated at the bore and the faces."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from calibration.disk import DiskSetup
from tcdyn.simulate.mesh import cubic_weights, graded_edges

Array = NDArray[np.float64]
Coefficient = Callable[[float, float], float]  # (time since entry [s], wall [degC]) -> h [W/m2K]


@dataclass(frozen=True)
class Heating:
    """True temperatures after entry: ``at(time since entry (M,))`` -> (M, depths); before it the initial value."""

    dense: Callable[[Array], Array]
    weights: Array
    initial_degC: float
    end_s: float

    def at(self, since_entry_s: Array) -> Array:
        """Temperatures at the depths that were asked for [degC]."""
        out = np.full((len(since_entry_s), len(self.weights)), self.initial_degC)
        after = since_entry_s > 0
        if after.any():
            out[after] = (self.weights @ self.dense(np.minimum(since_entry_s[after], self.end_s))).T
        return out


def heat_radially(
    setup: DiskSetup,
    depths_m: Array,
    initial_degC: float,
    bath_degC: Callable[[float], float],
    h_W_m2K: Coefficient,
    duration_s: float,
    cells: int = 80,
    rtol: float = 1e-8,
) -> Heating:
    """Solve rho c T_t = (K r T_r)_r / r from the bore (no flux) to R_o, where K T_r = h (T_bath - T_wall).

    Finite volumes, finer towards the surface; backward differentiation of variable order with a banded Jacobian.
    The wall temperature is found from half a surface cell of steel in series with h of the last wall guess.
    """
    r_edges = graded_edges(setup.outer_radius_m, setup.bore_radius_m, 0.05e-3, cells)[::-1]
    r = 0.5 * (r_edges[1:] + r_edges[:-1])
    k = setup.conductivity_W_mK
    capacity = setup.density_kg_m3 * setup.specific_heat_J_kgK * np.pi * np.diff(r_edges**2)
    link = 2 * np.pi * k / np.log(r[1:] / r[:-1])
    skin = 2 * np.pi * k / np.log(setup.outer_radius_m / r[-1])
    rim = 2 * np.pi * setup.outer_radius_m

    def rate(t: float, temperature: Array) -> Array:
        bath, wall = bath_degC(t), float(temperature[-1])
        for _ in range(3):
            film = h_W_m2K(t, wall) * rim
            wall = (skin * temperature[-1] + film * bath) / (skin + film)
        flow = link * np.diff(temperature)
        out = np.zeros_like(temperature)
        out[:-1] += flow
        out[1:] -= flow
        out[-1] += skin * (wall - temperature[-1])
        return out / capacity

    solution = solve_ivp(
        rate,
        (0.0, duration_s),
        np.full(cells, initial_degC),
        method="LSODA",
        dense_output=True,
        rtol=rtol,
        atol=1e-7,
        lband=1,
        uband=1,
    )
    weights = np.zeros((len(depths_m), cells))
    for row, depth in enumerate(depths_m):
        index, weight = cubic_weights(r, setup.outer_radius_m - float(depth))
        weights[row, index] = weight
    return Heating(solution.sol, weights, initial_degC, duration_s)
