"""Fluids of a plunge bath: density, specific heat, conductivity and viscosity, each with its uncertainty."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

from calibration.errors import InputError

Array = NDArray[np.float64]
Curve = Callable[[Array], Array]
ZERO_C = 273.15


@dataclass(frozen=True)
class FluidProperties:
    """Properties at given temperatures (arrays of one shape), SI units."""

    rho_kg_m3: Array
    c_J_kgK: Array
    k_W_mK: Array
    nu_m2_s: Array
    beta_1_K: Array

    @property
    def prandtl(self) -> Array:
        """Pr = rho c nu / k [1]."""
        return self.rho_kg_m3 * self.c_J_kgK * self.nu_m2_s / self.k_W_mK


@dataclass(frozen=True)
class Fluid:
    """A fluid: four curves of temperature [degC], their relative standard uncertainties, and their range.

    ``beta = -(d rho/dT)/rho`` is the derivative of the density curve; its uncertainty is stated separately because
    published expansion coefficients of one oil differ far more than its densities.

    >>> oil = fluid("mobil-jet-ii")
    >>> round(float(oil.at(100.0).prandtl))
    65
    """

    name: str
    rho: Curve
    c: Curve
    k: Curve
    nu: Curve
    range_degC: tuple[float, float]
    u_rho: float
    u_c: float
    u_k: float
    u_nu: float
    u_beta: float
    source: str

    def at(self, T_degC: ArrayLike) -> FluidProperties:
        """The properties at ``T_degC`` (any shape); beta by a central difference of 0.5 K in density."""
        T = np.asarray(T_degC, dtype=float)
        rho = self.rho(T)
        beta = (self.rho(T - 0.5) - self.rho(T + 0.5)) / rho
        return FluidProperties(rho, self.c(T), self.k(T), self.nu(T), beta)

    def outside(self, low_degC: float, high_degC: float) -> str | None:
        """A sentence when the temperatures used leave the range the data were given for; else None."""
        low, high = self.range_degC
        if low_degC >= low and high_degC <= high:
            return None
        return (
            f"{self.name}: film temperatures of {low_degC:.0f} to {high_degC:.0f} degC were used, but its "
            f"properties are known from {low:.0f} to {high:.0f} degC: h is an extrapolation"
        )


def walther_viscosity_m2_s(T_degC: ArrayLike, low: tuple[float, float], high: tuple[float, float]) -> Array:
    """Kinematic viscosity by ASTM D341 through two points (T [degC], nu [mm2/s]).

    log10 log10(nu + 0.7) = A - B log10 T_K, valid for nu above 2 mm2/s.

    >>> round(float(walther_viscosity_m2_s(100.0, (40.0, 27.6), (100.0, 5.1))) * 1e6, 6)
    5.1
    """
    (t1, n1), (t2, n2) = low, high
    w1, w2 = (np.log10(np.log10(n + 0.7)) for n in (n1, n2))
    x1, x2 = np.log10(t1 + ZERO_C), np.log10(t2 + ZERO_C)
    slope = (w1 - w2) / (x2 - x1)
    w = w1 - slope * (np.log10(np.asarray(T_degC, dtype=float) + ZERO_C) - x1)
    return np.asarray((10 ** (10**w) - 0.7) * 1e-6)


def _jet_oil() -> Fluid:
    """Mobil Jet Oil II: product density and viscosity; c and k of the MIL-L-23699 class (bearing codes)."""
    return Fluid(
        name="mobil-jet-ii",
        rho=lambda T: 1003.5 - 0.70 * (T - 15.0),
        c=lambda T: np.full_like(T, 2000.0),
        k=lambda T: 0.14868 - 2.2275e-4 * (T + ZERO_C - 366.67),
        nu=lambda T: walther_viscosity_m2_s(T, (40.0, 27.6), (100.0, 5.1)),
        range_degC=(15.0, 200.0),
        u_rho=0.005,
        u_c=0.05,
        u_k=0.05,
        u_nu=0.05,
        u_beta=0.12,
        source="product data sheet (density 15 degC, viscosity 40 and 100 degC, ASTM D341 between); c, k and the slope "
        "of density of MIL-L-23699 oils",
    )


_WATER_C = np.array([4219.9, 4195.5, 4184.4, 4180.1, 4179.6, 4181.5, 4185.1, 4190.2, 4196.9, 4205.3, 4215.7])
_WATER_C_CURVE = CubicSpline(np.arange(0.0, 101.0, 10.0), _WATER_C)


def _water_density(T: Array) -> Array:
    """Kell (1975), 0 to 150 degC at one atmosphere [kg/m3]."""
    top = np.polyval([-280.54253e-12, 105.56302e-9, -46.170461e-6, -7.9870401e-3, 16.945176, 999.83952], np.asarray(T))
    return np.asarray(top / (1 + 16.879850e-3 * T))


def _water_viscosity(T: Array) -> Array:
    """Patek et al. (2009) for liquid water at 0.1 MPa, divided by Kell's density [m2/s]."""
    x = (T + ZERO_C) / 300.0
    mu = 280.68 * x**-1.9 + 511.45 * x**-7.7 + 61.131 * x**-19.6 + 0.45903 * x**-40.0
    return np.asarray(mu * 1e-6 / _water_density(T))


def _water_conductivity(T: Array) -> Array:
    """Patek et al. (2009) for liquid water at 0.1 MPa [W/mK]."""
    x = (T + ZERO_C) / 300.0
    return np.asarray(1.6630 * x**-1.15 - 1.7781 * x**-3.4 + 1.1567 * x**-6.0 - 0.432115 * x**-7.6)


def _water() -> Fluid:
    return Fluid(
        name="water",
        rho=_water_density,
        c=lambda T: np.asarray(_WATER_C_CURVE(T)),
        k=_water_conductivity,
        nu=_water_viscosity,
        range_degC=(0.0, 100.0),
        u_rho=1e-4,
        u_c=0.002,
        u_k=0.01,
        u_nu=0.01,
        u_beta=0.01,
        source="Kell (1975) density; Patek, Hruby, Klomfar, Souckova and Harvey (2009) viscosity and conductivity",
    )


FLUIDS: dict[str, Callable[[], Fluid]] = {"mobil-jet-ii": _jet_oil, "water": _water}


def fluid(name: str) -> Fluid:
    """A built-in fluid by name; a path ending in .csv is read as the user's own table.

    Raises InputError for an unknown name.

    >>> fluid("water").name
    'water'
    """
    if name.lower().endswith((".csv", ".txt")):
        from immersion.fluid_table import read_fluid

        return read_fluid(name)
    key = name.lower().replace("_", "-").replace(" ", "-")
    aliases = {"mobil-jet-oil-ii": "mobil-jet-ii", "mjo-ii": "mobil-jet-ii", "jet-ii": "mobil-jet-ii"}
    key = aliases.get(key, key)
    if key not in FLUIDS:
        raise InputError(
            f"unknown fluid {name!r}",
            expected=f"one of {', '.join(sorted(FLUIDS))}, or a CSV table",
            remedy="a table has the columns T_degC, rho_kg_m3, c_J_kgK, k_W_mK, nu_m2_s",
        )
    return FLUIDS[key]()
