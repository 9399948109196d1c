"""Properties of bath fluids with uncertainties: density, specific heat, conductivity, viscosity.

Two fluids are built in. A CSV table of properties against temperature defines any other.

Used by :mod:`immersion.correlations` and :mod:`immersion.plunge_data`, by the design of plunges and
by ``tcdyn verify``. Water follows published equations (Kell; Patek et al.); the oil follows its
data sheet. Bounds are chosen by judgement. Tests: ``tests/immersion/test_immersion_fluids.py``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, warning

Curve = Callable[[Array], Array]
# 0 degC in kelvin.
ZERO_C = 273.15
WALTHER_OFFSET_MM2_S = 0.7  # of log log(nu + 0.7): ASTM D341
WALTHER_MIN_MM2_S = (
    0.5  # least viscosity [mm2/s] for which the Walther equation is used; chosen by judgement
)
# Optional columns of a fluid table: relative standard uncertainties.
UNCERTAINTIES = {"u_rho_rel", "u_c_rel", "u_k_rel", "u_nu_rel", "u_beta_rel"}
# Required columns of a fluid table.
COLUMNS = ("T_degC", "rho_kg_m3", "c_J_kgK", "k_W_mK", "nu_m2_s")
# Possible values in SI units; chosen by judgement, so that another unit is recognised.
_BOUNDS = {
    "T_degC": (-100.0, 500.0),
    "rho_kg_m3": (0.1, 20000.0),
    "c_J_kgK": (100.0, 20000.0),
    "k_W_mK": (0.005, 100.0),
    "nu_m2_s": (1e-8, 1e-1),
}


@dataclass(frozen=True)
class FluidProperties:
    """Properties at given temperatures (arrays of one shape), SI units.

    Attributes
    ----------
    rho_kg_m3, c_J_kgK, k_W_mK
        Density, specific heat and thermal conductivity.
    nu_m2_s
        Kinematic viscosity.
    beta_1_K
        Volumetric expansion coefficient.
    """

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
    """A fluid: four curves of temperature [degC], relative standard uncertainties, and range.

    Attributes
    ----------
    name
        Name of the fluid.
    rho, c, k, nu
        Density, specific heat, conductivity and kinematic viscosity as functions of temperature
        [degC], in SI units.
    range_degC
        Range of the data.
    source
        Reference, for reports.
    u_rho, u_c, u_k, u_nu, u_beta
        Relative standard uncertainties.

    Notes
    -----
    The expansion coefficient beta = -(d rho/dT)/rho is the derivative of the density curve. It has
    an uncertainty of its own, since published expansion coefficients of one oil differ far more
    than its densities. The default uncertainties are those of a lubricating oil.

    Examples
    --------
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
    source: str
    u_rho: float = 0.005
    u_c: float = 0.05
    u_k: float = 0.05
    u_nu: float = 0.05
    u_beta: float = 0.12

    def at(self, T_degC: ArrayLike) -> FluidProperties:
        """Properties at ``T_degC``; beta by a central difference of the density over +-0.5 K.

        Parameters
        ----------
        T_degC
            Temperatures of any shape [degC].
        """
        T = np.asarray(T_degC, dtype=float)
        rho = self.rho(T)
        beta = (self.rho(T - 0.5) - self.rho(T + 0.5)) / rho
        return FluidProperties(rho, self.c(T), self.k(T), self.nu(T), beta)

    def check_range(self, low_degC: float, high_degC: float) -> tuple[Finding, ...]:
        """A warning where the temperatures leave the range of the data, else nothing.

        Parameters
        ----------
        low_degC, high_degC
            Lowest and highest temperature that is used [degC].
        """
        low, high = self.range_degC
        if low_degC >= low and high_degC <= high:
            return ()
        extrapolated = warning(
            "fluid.extrapolated",
            subject=self.name,
            used_degC=(low_degC, high_degC),
            known_degC=self.range_degC,
        )
        return (extrapolated,)


# Specific heat of water [J/kgK] at 0, 10 .. 100 degC; no reference is stated.
_WATER_C = np.array(
    [4219.9, 4195.5, 4184.4, 4180.1, 4179.6, 4181.5, 4185.1, 4190.2, 4196.9, 4205.3, 4215.7]
)


def _water_density(T: Array) -> Array:
    """Density of water by Kell (1975), 0 to 150 degC at one atmosphere [kg/m3]."""
    top = np.polyval(
        [-280.54253e-12, 105.56302e-9, -46.170461e-6, -7.9870401e-3, 16.945176, 999.83952],
        T,
    )
    return top / (1 + 16.879850e-3 * T)


def _water_viscosity(T: Array) -> Array:
    """Kinematic viscosity of water [m2/s].

    Patek et al. (2009) for liquid water at 0.1 MPa, divided by Kell's density.
    """
    x = (T + ZERO_C) / 300.0
    mu = 280.68 * x**-1.9 + 511.45 * x**-7.7 + 61.131 * x**-19.6 + 0.45903 * x**-40.0
    return mu * 1e-6 / _water_density(T)


def _water_conductivity(T: Array) -> Array:
    """Conductivity of water by Patek et al. (2009), liquid at 0.1 MPa [W/mK]."""
    x = (T + ZERO_C) / 300.0
    return 1.6630 * x**-1.15 - 1.7781 * x**-3.4 + 1.1567 * x**-6.0 - 0.432115 * x**-7.6


def fluid(name: str) -> Fluid:
    """A built-in fluid by name, or the fluid of a table where the name ends in .csv or .txt.

    Parameters
    ----------
    name
        Name in ``FLUIDS`` (case and separators do not matter), or path of a table.

    Raises
    ------
    InputError
        For an unknown name.

    Examples
    --------
    >>> fluid("water").name
    'water'
    """
    if name.lower().endswith((".csv", ".txt")):
        return read_fluid(name)
    key = name.lower().replace("_", "-").replace(" ", "-")
    aliases = {
        "mobil-jet-oil-ii": "mobil-jet-ii",
        "mjo-ii": "mobil-jet-ii",
        "jet-ii": "mobil-jet-ii",
    }
    key = aliases.get(key, key)
    if key not in FLUIDS:
        raise InputError(
            f"unknown fluid {name!r}",
            expected=f"one of {', '.join(sorted(FLUIDS))}, or a CSV table",
            remedy="a table has the columns T_degC, rho_kg_m3, c_J_kgK, k_W_mK, nu_m2_s",
        )
    return FLUIDS[key]


def read_fluid(path: str | Path) -> Fluid:
    """Read a fluid table.

    Parameters
    ----------
    path
        CSV table with the columns T_degC, rho_kg_m3, c_J_kgK, k_W_mK, nu_m2_s and two rows or more.
        The optional columns u_rho_rel, u_c_rel, u_k_rel, u_nu_rel, u_beta_rel hold relative
        standard uncertainties; their mean over the rows is used. Without them the uncertainties of
        a lubricating oil are assumed.

    Raises
    ------
    InputError
        For a table that cannot be used.

    Notes
    -----
    Between rows, density, specific heat and conductivity follow a cubic spline (a line with two
    rows). Viscosity follows a spline of log log(nu + 0.7 mm2/s) against log T, which is ASTM D341
    with two rows.
    """
    where = str(path)
    try:
        table = pd.read_csv(path, comment="#", skipinitialspace=True)
    except FileNotFoundError:
        raise InputError(
            "no such file", where=where, remedy="name a built-in fluid or a CSV table"
        ) from None
    except (
        OSError,
        UnicodeDecodeError,
        pd.errors.ParserError,
        pd.errors.EmptyDataError,
    ) as problem:
        raise InputError(f"not readable as a CSV table ({problem})", where=where) from None
    missing = [c for c in COLUMNS if c not in table.columns]
    if missing:
        raise InputError(
            f"column {missing[0]} is missing", where=where, expected=", ".join(COLUMNS)
        )
    return fluid_from_table(table, Path(path).stem, where)


def fluid_from_table(table: pd.DataFrame, name: str, where: str = "fluid table") -> Fluid:
    """The fluid of a table in memory; see ``read_fluid``.

    Parameters
    ----------
    table
        Table with the columns of :func:`read_fluid`; rows in any order.
    name
        Name of the fluid.
    where
        File, for messages.

    Raises
    ------
    InputError
        Fewer than two temperatures, an impossible value, a density that does not fall with
        temperature, or an uncertainty outside 0 to 1.
    """
    columns = {c: _column_of_numbers(table, c, where) for c in COLUMNS}
    order = np.argsort(columns["T_degC"])
    T = columns["T_degC"][order]
    if len(T) < 2 or np.any(np.diff(T) <= 0):
        raise InputError("two rows or more at different T_degC are needed", where=where)
    rho, c, k, nu = (columns[column][order] for column in COLUMNS[1:])
    if np.any(np.diff(rho) >= 0):
        raise InputError(
            "rho_kg_m3 must fall with T_degC",
            where=where,
            remedy="natural convection needs expansion",
        )
    u: dict[str, Any] = {}
    for column in UNCERTAINTIES & set(table.columns):
        values = pd.to_numeric(table[column], errors="coerce").to_numpy(dtype=float)
        if not np.all((values >= 0) & (values < 1)):
            raise InputError(
                f"column {column} must hold relative uncertainties", where=where, expected="0 to 1"
            )
        u[column.removesuffix("_rel")] = float(np.mean(values))
    return Fluid(
        name,
        rho=_spline(T, rho),
        c=_spline(T, c),
        k=_spline(T, k),
        nu=_viscosity_spline(T, nu),
        range_degC=(float(T[0]), float(T[-1])),
        source=where,
        **u,
    )


def _column_of_numbers(table: pd.DataFrame, column: str, where: str) -> Array:
    """A column as numbers. Raises InputError for a value that is not possible.

    Parameters
    ----------
    table, column
        Table and name of the column.
    where
        File, for messages.

    Returns
    -------
    values
        One for each row.
    """
    values = pd.to_numeric(table[column], errors="coerce").to_numpy(dtype=float)
    low, high = _BOUNDS[column]
    bad = np.flatnonzero(~((values >= low) & (values <= high)))
    if bad.size:
        row = int(bad[0])
        raise InputError(
            f"column {column}, row {row + 1}: {table[column].iloc[row]!r} is not a possible value",
            where=where,
            expected=f"{low:g} to {high:g} (SI units)",
            remedy="viscosity is in m2/s, not mm2/s" if column == "nu_m2_s" else "check the unit",
        )
    return values


def _spline(x: Array, y: Array) -> Curve:
    """Cubic spline through the points; a straight line through two.

    Parameters
    ----------
    x, y
        Points (N,), x rising.

    Notes
    -----
    Three points use the natural end condition, since the not-a-knot condition needs four.
    """
    if len(x) == 2:
        slope = (y[1] - y[0]) / (x[1] - x[0])
        return partial(_straight_line, slope, y[0] - slope * x[0])
    curve: Curve = CubicSpline(x, y, bc_type="natural" if len(x) == 3 else "not-a-knot")
    return curve


def _viscosity_spline(T: Array, nu: Array) -> Curve:
    """Spline of the Walther equation (ASTM D341), or of ln nu for thinner fluids (water, gases).

    Parameters
    ----------
    T, nu
        Temperatures [degC] and kinematic viscosities [m2/s] (N,).

    Notes
    -----
    The Walther equation needs nu + 0.7 mm2/s above one, hence the limit ``WALTHER_MIN_MM2_S``.
    """
    nu_mm2_s = nu * 1e6
    if np.min(nu_mm2_s) <= WALTHER_MIN_MM2_S:
        return partial(_viscosity_m2_s, _spline(T, np.log(nu)))
    log_log_nu = np.log10(np.log10(nu_mm2_s + WALTHER_OFFSET_MM2_S))
    return partial(_walther_viscosity_m2_s, _spline(np.log10(T + ZERO_C), log_log_nu))


# Functions of the module, not closures: a fluid can then be pickled for worker processes.
def _straight_line(slope: float, intercept: float, T: Array) -> Array:
    """Straight line in temperature."""
    return intercept + slope * T


def _viscosity_m2_s(log_nu: Curve, T: Array) -> Array:
    """Viscosity [m2/s] from the curve of its logarithm."""
    return np.exp(log_nu(T))


def _walther_viscosity_m2_s(log_log_nu: Curve, T: Array) -> Array:
    """Viscosity [m2/s] from the curve of log log(nu + 0.7 mm2/s) over log T."""
    nu_mm2_s = 10 ** (10 ** log_log_nu(np.log10(T + ZERO_C))) - WALTHER_OFFSET_MM2_S
    return nu_mm2_s * 1e-6


# Temperatures [degC] at which the data sheet gives the viscosity of the oil.
_JET_DEGC = np.array([40.0, 100.0])
JET_OIL = Fluid(
    "mobil-jet-ii",
    rho=_spline(_JET_DEGC, 1003.5 - 0.70 * (_JET_DEGC - 15.0)),
    c=_spline(_JET_DEGC, np.full(2, 2000.0)),
    k=_spline(_JET_DEGC, 0.14868 - 2.2275e-4 * (_JET_DEGC + ZERO_C - 366.67)),
    nu=_viscosity_spline(_JET_DEGC, np.array([27.6e-6, 5.1e-6])),
    range_degC=(15.0, 200.0),
    source="product data sheet (density 15 degC, viscosity 40 and 100 degC, ASTM D341 "
    "between); c, k and the slope of density of MIL-L-23699 oils (bearing codes)",
)
WATER = Fluid(
    "water",
    rho=_water_density,
    c=_spline(np.linspace(0.0, 100.0, 11), _WATER_C),
    k=_water_conductivity,
    nu=_water_viscosity,
    range_degC=(0.0, 100.0),
    source="Kell (1975) density; Patek, Hruby, Klomfar, Souckova and Harvey (2009) viscosity "
    "and conductivity",
    u_rho=1e-4,
    u_c=0.002,
    u_k=0.01,
    u_nu=0.01,
    u_beta=0.01,
)
# Built-in fluids by name.
FLUIDS: dict[str, Fluid] = {f.name: f for f in (JET_OIL, WATER)}
