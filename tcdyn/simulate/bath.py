"""Simulation of a disk in a bath: fluids, natural convection, radial heating.

``tcdyn.simulate.plunge`` uses it. The fluid properties, the correlation and the solver are
independent of ``immersion``, which fits plunges; do not replace one by the other.
``tests/simulate/test_plunge.py`` compares it with closed forms (lumped body, half space) and with
published viscosities.
"""

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

GRAVITY_m_s2 = 9.80665  # standard gravity [m/s2]
N_CELLS = 80  # from bore to running surface; chosen by judgement
FluidName = Literal["mobil-jet-ii", "water"]  # fluids whose properties are known
# Names of the fluids; the first one is the default of ``tcdyn simulate``.
FLUIDS: tuple[FluidName, ...] = ("mobil-jet-ii", "water")


@dataclass(frozen=True)
class FluidState:
    """Properties of a fluid at one temperature.

    Parameters
    ----------
    viscosity_m2_s
        Kinematic viscosity [m2/s].
    conductivity_W_mK
        Thermal conductivity [W/mK].
    diffusivity_m2_s
        Thermal diffusivity [m2/s].
    expansion_1_K
        Thermal expansion coefficient [1/K]; negative for water near 0 degC.
    """

    viscosity_m2_s: float
    conductivity_W_mK: float
    diffusivity_m2_s: float
    expansion_1_K: float


def fluid_state(fluid: FluidName, temperature_degC: float) -> FluidState:
    """Return the properties of a bath fluid at its film temperature.

    Parameters
    ----------
    fluid
        "mobil-jet-ii" or "water".
    temperature_degC
        Film temperature [degC]: 15 to 200 degC for oil, 5 to 95 degC for water. Water is clipped to
        0 to 100 degC, the range of its table; oil is extrapolated.

    Returns
    -------
    FluidState
        Properties at that temperature.

    Notes
    -----
    Oil: viscosity through 27.6 mm2/s at 40 and 5.1 mm2/s at 100 degC (Walther), 1003.5 kg/m3 at
    15 degC, heat capacity 2000 J/kgK.

    Another fluid needs its name in ``FLUIDS`` and a branch here. The numbers may be changed without
    touching ``immersion``, which has its own: then fitted h scales differ from the true ones.
    ``tests/simulate/test_plunge.py`` checks the viscosity of the oil.

    Examples
    --------
    >>> round(fluid_state("mobil-jet-ii", 40.0).viscosity_m2_s * 1e6, 1)
    27.6
    """
    if fluid == "water":
        properties = _WATER(np.clip(temperature_degC, 0.0, 100.0)).tolist()
        viscosity, k, density, heat_capacity, expansion = properties
    else:
        kelvin = temperature_degC + 273.15
        relative_volume = 1 + _OIL_EXPANSION * (temperature_degC - 15.0)
        viscosity = float(10**10 ** (9.31259 - 3.66650 * np.log10(kelvin)) - 0.7) * 1e-6
        k = 0.14868 - 2.2275e-4 * (kelvin - 366.67)
        density = 1003.5 / relative_volume
        heat_capacity = 2000.0
        expansion = _OIL_EXPANSION / relative_volume
    return FluidState(viscosity, k, k / (density * heat_capacity), expansion)


_OIL_EXPANSION = 7.8e-4  # Thermal expansion coefficient of the oil at 15 degC [1/K].
# Water at 0, 20, .. 100 degC: kinematic viscosity [m2/s], conductivity [W/mK], density [kg/m3],
# specific heat [J/kgK], expansion [1/K].
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
    """Return the mean Nusselt number of a vertical plate; valid for Ra < 1e9.

    Parameters
    ----------
    rayleigh
        Rayleigh number with the height of the plate.
    prandtl
        Prandtl number.

    Returns
    -------
    float
        Mean Nusselt number.

    Notes
    -----
    ``Nu = 0.68 + 0.670 Ra^(1/4) / [1 + (0.492/Pr)^(9/16)]^(4/9)`` (Churchill and Chu 1975, laminar;
    equation 5.4).

    Examples
    --------
    >>> round(mean_nusselt(1e6, 60.0), 2)
    21.26
    """
    return float(0.68 + 0.670 * rayleigh**0.25 / (1 + (0.492 / prandtl) ** (9 / 16)) ** (4 / 9))


def natural_h_W_m2K(fluid: FluidName, wall_degC: float, bulk_degC: float, height_m: float) -> float:
    """Return the mean heat transfer coefficient of a short vertical wall [W/m2K].

    Parameters
    ----------
    fluid
        Fluid of the bath.
    wall_degC, bulk_degC
        Temperatures of the wall and of the bath [degC].
    height_m
        Height of the wall [m].

    Returns
    -------
    float
        Mean heat transfer coefficient [W/m2K]; 0.68 k/L where wall and bath are equal.

    Notes
    -----
    ``h = Nu k / L`` with ``Ra = g beta |dT| L^3 / (nu alpha)`` and ``Pr = nu / alpha``. Properties
    are those at the film temperature, the mean of wall and bulk.
    """
    s = fluid_state(fluid, 0.5 * (wall_degC + bulk_degC))
    buoyancy = GRAVITY_m_s2 * abs(s.expansion_1_K * (bulk_degC - wall_degC))
    rayleigh = buoyancy * height_m**3 / (s.viscosity_m2_s * s.diffusivity_m2_s)
    prandtl = s.viscosity_m2_s / s.diffusivity_m2_s
    return mean_nusselt(rayleigh, prandtl) * s.conductivity_W_mK / height_m


Coefficient = Callable[[float, float], float]  # (time since entry [s], wall [degC]) -> h [W/m2K]


@dataclass(frozen=True)
class Heating:
    """True temperatures after the entry; before it they are the initial value.

    Parameters
    ----------
    dense
        Solution of the finite volumes (cells, M) [degC] over the time since the entry (M,) [s].
    weights
        Interpolation weights (depths, cells).
    initial_degC
        Temperature before the entry [degC].
    end_s
        End of the solution after the entry [s]; later times give its last value.
    """

    dense: Callable[[Array], Array]
    weights: Array
    initial_degC: float
    end_s: float

    def at(self, since_entry_s: Array) -> Array:
        """Return the temperatures (M, depths) [degC] at the times (M,) since the entry.

        Parameters
        ----------
        since_entry_s
            Times since the entry (M,) [s]; zero and before give the initial temperature.

        Returns
        -------
        array
            Temperatures (M, depths) [degC].
        """
        out = np.full((len(since_entry_s), len(self.weights)), self.initial_degC)
        after = since_entry_s > 0
        if after.any():
            field = self.dense(np.minimum(since_entry_s[after], self.end_s))
            out[after] = (self.weights @ field).T
        return out


def heat_radially(
    setup: DiskSetup,
    depths_m: Array,
    initial_degC: float,
    bath_degC: Callable[[float], float],
    h_W_m2K: Coefficient,
    duration_s: float,
) -> Heating:
    """Solve the radial heating of a disk in a bath.

    Parameters
    ----------
    setup
        Geometry and steel of the disk.
    depths_m
        Depths below the running surface at which temperatures are needed (depths,) [m].
    initial_degC
        Uniform temperature at the entry [degC].
    bath_degC
        Bath temperature [degC] as a function of the time since the entry [s].
    h_W_m2K
        Heat transfer coefficient [W/m2K] as a function of the time since the entry [s] and the wall
        temperature [degC].
    duration_s
        Time after the entry that is solved [s].

    Returns
    -------
    Heating
        Temperatures at the depths over time.

    Notes
    -----
    rho c T_t = (K r T_r)_r / r from the bore (no flux) to R_o, where K T_r = h (T_bath - T_wall).
    Finite volumes, finer towards the surface; backward differentiation of variable order with a
    banded Jacobian. The wall temperature follows from half a surface cell of steel in series with h
    at the previous wall temperature, in three iterations.

    Faces and bore are adiabatic, and the steel does not depend on temperature. The first cell (0.05
    mm), ``N_CELLS`` and the tolerances (1e-8 relative, 1e-7 K) may be refined; they set the time of
    a run. ``tests/simulate/test_plunge.py`` fails where they are too coarse for the half space.
    """
    inwards = graded_edges(setup.outer_radius_m, setup.bore_radius_m, 0.05e-3, N_CELLS)
    r_edges = inwards[::-1]
    r = 0.5 * (r_edges[1:] + r_edges[:-1])
    k = setup.conductivity_W_mK
    capacity = setup.density_kg_m3 * setup.specific_heat_J_kgK * np.pi * np.diff(r_edges**2)
    conductance = 2 * np.pi * k / np.log(r[1:] / r[:-1])
    skin_conductance = 2 * np.pi * k / np.log(setup.outer_radius_m / r[-1])
    circumference = 2 * np.pi * setup.outer_radius_m

    def rate(t: float, temperature: Array) -> Array:
        """Return dT/dt (cells,) [K/s] at time ``t`` [s] since the entry."""
        bath = bath_degC(t)
        wall = float(temperature[-1])
        for _ in range(3):
            surface_conductance = h_W_m2K(t, wall) * circumference
            from_steel = skin_conductance * temperature[-1]
            from_bath = surface_conductance * bath
            wall = (from_steel + from_bath) / (skin_conductance + surface_conductance)
        flow = conductance * np.diff(temperature)
        heat = np.zeros_like(temperature)
        heat[:-1] += flow
        heat[1:] -= flow
        heat[-1] += skin_conductance * (wall - temperature[-1])
        return heat / capacity

    solution = solve_ivp(
        rate,
        (0.0, duration_s),
        np.full(N_CELLS, initial_degC),
        method="LSODA",
        dense_output=True,
        rtol=1e-8,
        atol=1e-7,
        lband=1,
        uband=1,
    )
    weights = np.zeros((len(depths_m), N_CELLS))
    for row, depth in enumerate(depths_m):
        index, weight = cubic_weights(r, setup.outer_radius_m - float(depth))
        weights[row, index] = weight
    return Heating(solution.sol, weights, initial_degC, duration_s)
