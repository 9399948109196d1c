"""A user's fluid: a CSV table of properties against temperature."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from calibration.errors import InputError
from immersion.fluids import ZERO_C, Curve, Fluid

Array = NDArray[np.float64]
COLUMNS = ("T_degC", "rho_kg_m3", "c_J_kgK", "k_W_mK", "nu_m2_s")
_BOUNDS = {
    "T_degC": (-100.0, 500.0),
    "rho_kg_m3": (0.1, 20000.0),
    "c_J_kgK": (100.0, 20000.0),
    "k_W_mK": (0.005, 100.0),
    "nu_m2_s": (1e-8, 1e-1),
}
_DEFAULT_U = {"u_rho_rel": 0.005, "u_c_rel": 0.05, "u_k_rel": 0.05, "u_nu_rel": 0.05, "u_beta_rel": 0.12}


def read_fluid(path: str | Path) -> Fluid:
    """Read a fluid table (columns T_degC, rho_kg_m3, c_J_kgK, k_W_mK, nu_m2_s; two rows or more).

    Optional columns u_rho_rel, u_c_rel, u_k_rel, u_nu_rel, u_beta_rel give relative standard uncertainties (their
    mean over the rows is used); without them those of a lubricating oil are assumed. Between rows density, specific
    heat and conductivity follow a cubic spline (a line through two rows), viscosity a spline of log log(nu + 0.7 mm2/s)
    against log T, which is ASTM D341 when there are two rows. Raises InputError for a table that cannot be used.
    """
    where = str(path)
    try:
        table = pd.read_csv(path, comment="#", skipinitialspace=True)
    except FileNotFoundError:
        raise InputError("no such file", where=where, remedy="name a built-in fluid or a CSV table") from None
    except (OSError, UnicodeDecodeError, pd.errors.ParserError, pd.errors.EmptyDataError) as problem:
        raise InputError(f"not readable as a CSV table ({problem})", where=where) from None
    missing = [c for c in COLUMNS if c not in table.columns]
    if missing:
        raise InputError(f"column {missing[0]} is missing", where=where, expected=", ".join(COLUMNS))
    return fluid_from_table(table, Path(path).stem, where)


def fluid_from_table(table: pd.DataFrame, name: str, where: str = "fluid table") -> Fluid:
    """The fluid of a table that is already in memory; see ``read_fluid``."""
    columns = {c: _numbers(table, c, where) for c in COLUMNS}
    order = np.argsort(columns["T_degC"])
    T = columns["T_degC"][order]
    if len(T) < 2 or np.any(np.diff(T) <= 0):
        raise InputError("two rows or more at different T_degC are needed", where=where)
    rho, c, k, nu = (columns[name_][order] for name_ in COLUMNS[1:])
    if np.any(np.diff(rho) >= 0):
        raise InputError("rho_kg_m3 must fall with T_degC", where=where, remedy="natural convection needs expansion")
    u = {key: _column_mean(table, key, default, where) for key, default in _DEFAULT_U.items()}
    return Fluid(
        name=name,
        rho=_spline(T, rho),
        c=_spline(T, c),
        k=_spline(T, k),
        nu=_viscosity_spline(T, nu),
        range_degC=(float(T[0]), float(T[-1])),
        u_rho=u["u_rho_rel"],
        u_c=u["u_c_rel"],
        u_k=u["u_k_rel"],
        u_nu=u["u_nu_rel"],
        u_beta=u["u_beta_rel"],
        source=where,
    )


def _numbers(table: pd.DataFrame, column: str, where: str) -> Array:
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


def _column_mean(table: pd.DataFrame, column: str, default: float, where: str) -> float:
    if column not in table.columns:
        return default
    values = pd.to_numeric(table[column], errors="coerce").to_numpy(dtype=float)
    if not np.all((values >= 0) & (values < 1)):
        raise InputError(f"column {column} must hold relative uncertainties", where=where, expected="0 to 1")
    return float(np.mean(values))


def _spline(x: Array, y: Array) -> Curve:
    if len(x) == 2:
        slope = (y[1] - y[0]) / (x[1] - x[0])
        return lambda T: np.asarray(y[0] + slope * (T - x[0]))
    curve = CubicSpline(x, y, bc_type="natural" if len(x) == 3 else "not-a-knot")
    return lambda T: np.asarray(curve(T))


def _viscosity_spline(T: Array, nu: Array) -> Curve:
    if np.min(nu) * 1e6 <= 0.5:  # thinner than D341 covers (water, gases): a spline of ln nu
        log_curve = _spline(T, np.log(nu))
        return lambda t: np.asarray(np.exp(log_curve(t)))
    curve = _spline(np.log10(T + ZERO_C), np.log10(np.log10(nu * 1e6 + 0.7)))
    return lambda t: np.asarray((10 ** (10 ** curve(np.log10(t + ZERO_C))) - 0.7) * 1e-6)
