"""Closed forms at constant h, the references of ``radial``: eigenfunction series, and one
exponential at small Biot number."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq
from scipy.special import j0, j1, y0, y1

from immersion.cylinder import Cylinder

Array = NDArray[np.float64]


def series_plunge(
    cylinder: Cylinder,
    r_m: ArrayLike,
    time_s: ArrayLike,
    h_W_m2K: float,
    initial_degC: float,
    fluid_degC: float,
    terms: int = 200,
) -> Array:
    """Temperature (N, P) at times (N,) and radii (P,) [m] of a hollow disk plunged with constant h.

    theta = sum_k A_k R_k(r) exp(-(alpha lambda_k^2 + leak) t),
    R = J0(lambda r) Y1(lambda R_i) - Y0(lambda r) J1(lambda R_i),
    K R'(R_o) + h R(R_o) = 0; A_k by orthogonality over r dr. theta = (T - T_fluid)/(T_0 - T_fluid).
    Needs a bore. Source: Carslaw and Jaeger (1959), section 7.10, with one boundary insulated.
    """
    ri = cylinder.inner_radius_m
    ro = cylinder.outer_radius_m
    k = cylinder.conductivity_W_mK

    def value_and_slope(x: float, r: Array | float) -> tuple[Array, Array]:
        a = y1(x * ri)
        b = j1(x * ri)
        return np.asarray(j0(x * r) * a - y0(x * r) * b), np.asarray(
            -x * (j1(x * r) * a - y1(x * r) * b)
        )

    def condition(x: float) -> float:
        value, slope = value_and_slope(x, ro)
        return float(k * slope + h_W_m2K * value)

    step = np.pi / (ro - ri) / 12
    roots: list[float] = []
    x = step * 1e-4
    while len(roots) < terms:
        if condition(x) * condition(x + step) < 0:
            roots.append(brentq(condition, x, x + step, xtol=1e-12))
        x += step
    r = np.asarray(r_m, dtype=float)
    t = np.asarray(time_s, dtype=float)
    theta = np.zeros((len(t), len(r)))
    for lam in roots:
        edge, slope = value_and_slope(lam, ro)
        inner, _ = value_and_slope(lam, ri)
        norm = (ro**2 * (edge**2 + (slope / lam) ** 2) - ri**2 * inner**2) / 2
        mean = -ro * slope / lam**2  # integral of R r dr
        rate = cylinder.diffusivity_m2_s * lam**2 + cylinder.leak_1_s
        theta += float(mean / norm) * value_and_slope(lam, r)[0] * np.exp(-rate * t)[:, None]
    return np.asarray(fluid_degC + (initial_degC - fluid_degC) * theta)


def lumped_plunge(
    cylinder: Cylinder, time_s: ArrayLike, h_W_m2K: float, initial_degC: float, fluid_degC: float
) -> Array:
    """Temperature (N,) of the disk as one body, the limit of small Biot number: T_f + (T_0 - T_f)
    exp(-t/tau).

    1/tau = 2 R_o h / (rho c (R_o^2 - R_i^2)) + leak.
    """
    rate = cylinder.mean_rate_K_m2_J * h_W_m2K + cylinder.leak_1_s
    t = np.asarray(time_s, dtype=float)
    return np.asarray(fluid_degC + (initial_degC - fluid_degC) * np.exp(-rate * t))
