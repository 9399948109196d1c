"""A disk in a bath as the rig has it: fluids, natural convection times a scale nobody is told, radial heating."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from tcdyn.core import Array
from tcdyn.rig.disk import DiskSetup
from tcdyn.simulate.mesh import cubic_weights, graded_edges

GRAVITY_m_s2 = 9.80665
CELLS = 80  # from bore to running surface
FluidName = Literal["mobil-jet-ii", "water"]
FLUIDS: tuple[FluidName, ...] = ("mobil-jet-ii", "water")


@dataclass(frozen=True)
class FluidState:
    """Kinematic viscosity [m2/s], conductivity [W/mK], diffusivity [m2/s], expansion [1/K]."""

    viscosity_m2_s: float
    conductivity_W_mK: float
    diffusivity_m2_s: float
    expansion_1_K: float


def fluid_state(fluid: FluidName, temperature_degC: float) -> FluidState:
    """Properties of the bath at a film temperature; oil 15 to 200 degC, water 5 to 95 degC.

    Oil: viscosity through 27.6 mm2/s at 40 and 5.1 mm2/s at 100 degC (Walther), 1003.5 kg/m3 at 15 degC, heat
    capacity 2000 J/kgK.

    >>> round(fluid_state("mobil-jet-ii", 40.0).viscosity_m2_s * 1e6, 1)
    27.6
    """
    if fluid == "water":
        viscosity, k, density, heat, expansion = map(
            float, _WATER(np.clip(temperature_degC, 0.0, 100.0))
        )
    else:
        kelvin = temperature_degC + 273.15
        larger = 1 + _OIL_EXPANSION * (temperature_degC - 15.0)
        viscosity = float(10**10 ** (9.31259 - 3.66650 * np.log10(kelvin)) - 0.7) * 1e-6
        k = 0.14868 - 2.2275e-4 * (kelvin - 366.67)
        density = 1003.5 / larger
        heat = 2000.0
        expansion = _OIL_EXPANSION / larger
    return FluidState(viscosity, k, k / (density * heat), expansion)


_OIL_EXPANSION = 7.8e-4
_WATER = CubicSpline(
    np.arange(0.0, 101.0, 20.0),
    np.array(
        [
            [1.792e-6, 0.561, 999.8, 4217.0, -0.068e-3],
            [1.004e-6, 0.598, 998.2, 4184.0, 0.207e-3],
            [0.658e-6, 0.631, 992.2, 4179.0, 0.385e-3],
            [0.474e-6, 0.654, 983.2, 4185.0, 0.523e-3],
            [0.365e-6, 0.670, 971.8, 4197.0, 0.641e-3],
            [0.294e-6, 0.679, 958.4, 4216.0, 0.750e-3],
        ]
    ),
)


def mean_nusselt(rayleigh: float, prandtl: float) -> float:
    """Mean Nusselt number of a vertical plate (Churchill and Chu 1975, laminar; 5.4); valid for Ra < 1e9.

    ``Nu = 0.68 + 0.670 Ra^(1/4) / [1 + (0.492/Pr)^(9/16)]^(4/9)``

    >>> round(mean_nusselt(1e6, 60.0), 2)
    21.26
    """
    return float(0.68 + 0.670 * rayleigh**0.25 / (1 + (0.492 / prandtl) ** (9 / 16)) ** (4 / 9))


def natural_h_W_m2K(fluid: FluidName, wall_degC: float, bulk_degC: float, height_m: float) -> float:
    """Mean coefficient of a short vertical wall, properties at the film temperature [W/m2K].

    ``h = Nu k / L`` with ``Ra = g beta |dT| L^3 / (nu alpha)`` and ``Pr = nu / alpha``.
    """
    s = fluid_state(fluid, 0.5 * (wall_degC + bulk_degC))
    buoyancy = GRAVITY_m_s2 * abs(s.expansion_1_K * (bulk_degC - wall_degC))
    rayleigh = buoyancy * height_m**3 / (s.viscosity_m2_s * s.diffusivity_m2_s)
    return (
        mean_nusselt(rayleigh, s.viscosity_m2_s / s.diffusivity_m2_s)
        * s.conductivity_W_mK
        / height_m
    )


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
) -> Heating:
    """Solve rho c T_t = (K r T_r)_r / r from the bore (no flux) to R_o, where K T_r = h (T_bath - T_wall).

    Finite volumes, finer towards the surface; backward differentiation of variable order with a banded Jacobian.
    The wall temperature is found from half a surface cell of steel in series with h of the last wall guess.
    """
    r_edges = graded_edges(setup.outer_radius_m, setup.bore_radius_m, 0.05e-3, CELLS)[::-1]
    r = 0.5 * (r_edges[1:] + r_edges[:-1])
    k = setup.conductivity_W_mK
    capacity = setup.density_kg_m3 * setup.specific_heat_J_kgK * np.pi * np.diff(r_edges**2)
    link = 2 * np.pi * k / np.log(r[1:] / r[:-1])
    skin = 2 * np.pi * k / np.log(setup.outer_radius_m / r[-1])
    rim = 2 * np.pi * setup.outer_radius_m

    def rate(t: float, temperature: Array) -> Array:
        bath = bath_degC(t)
        wall = float(temperature[-1])
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
        np.full(CELLS, initial_degC),
        method="LSODA",
        dense_output=True,
        rtol=1e-8,
        atol=1e-7,
        lband=1,
        uband=1,
    )
    weights = np.zeros((len(depths_m), CELLS))
    for row, depth in enumerate(depths_m):
        index, weight = cubic_weights(r, setup.outer_radius_m - float(depth))
        weights[row, index] = weight
    return Heating(solution.sol, weights, initial_degC, duration_s)
