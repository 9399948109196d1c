"""Closed forms that the scheme is held against (sections 3.4.1, 3.6, and the case that is missing there)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq
from scipy.special import erf, j0, j1, y0, y1

from calibration.errors import InputError

Array = NDArray[np.float64]
ERF_ONE = 3.6  # the thesis's argument beyond which erf counts as one


def semi_infinite(depth_m: ArrayLike, time_s: ArrayLike, start: float, surface: float, alpha_m2_s: float) -> Array:
    """Half space whose surface jumps: T = T_o + (T_i - T_o) erf(x / (2 sqrt(alpha t))) (3.26), t > 0.

    >>> float(semi_infinite(3e-3, 1.0, 20.0, 160.0, 1.1e-5).round(2))
    93.14
    """
    x, t = np.asarray(depth_m, dtype=float), np.asarray(time_s, dtype=float)
    return np.asarray(surface + (start - surface) * erf(x / (2 * np.sqrt(alpha_m2_s * t))))


def penetration_depth_m(time_s: ArrayLike, alpha_m2_s: float) -> Array:
    """How deep a surface jump has come after ``time_s``: x = 7.2 sqrt(alpha t) (3.27)."""
    return np.asarray(2 * ERF_ONE * np.sqrt(alpha_m2_s * np.asarray(time_s, dtype=float)))


def surface_steady_degC(
    inner_m: float,
    outer_m: float,
    conductivity: float,
    h: float,
    flux: float,
    inner_degC: float,
    ambient_degC: float,
) -> float:
    """Running surface of the steady ring, T_out = (R h T_A + K/ln(R/r) T_in + R q)/(h R + K/ln(R/r)) (3.37)."""
    c = conductivity / np.log(outer_m / inner_m)
    return float((outer_m * h * ambient_degC + c * inner_degC + outer_m * flux) / (h * outer_m + c))


def ring_steady_degC(
    radius_m: ArrayLike,
    inner_m: float,
    outer_m: float,
    conductivity: float,
    h: float,
    flux: float,
    inner_degC: float,
    ambient_degC: float,
) -> Array:
    """Steady ring, T = T_in + (q - h (T_out - T_A)) R ln(r/r_in) / K: (3.36), T_in not divided by K."""
    out = surface_steady_degC(inner_m, outer_m, conductivity, h, flux, inner_degC, ambient_degC)
    net = flux - h * (out - ambient_degC)
    return np.asarray(inner_degC + net * outer_m / conductivity * np.log(np.asarray(radius_m) / inner_m))


def _ring_mode(mu: ArrayLike, r: ArrayLike, inner_m: float) -> Array:
    """Phi(r) = J0(mu r) Y0(mu R_i) - Y0(mu r) J0(mu R_i): zero at the inner radius."""
    mu, r = np.asarray(mu), np.asarray(r)
    return np.asarray(j0(mu * r) * y0(mu * inner_m) - y0(mu * r) * j0(mu * inner_m))


def _ring_mode_slope(mu: ArrayLike, r: ArrayLike, inner_m: float) -> Array:
    """dPhi/dr."""
    mu, r = np.asarray(mu), np.asarray(r)
    return np.asarray(-mu * (j1(mu * r) * y0(mu * inner_m) - y1(mu * r) * j0(mu * inner_m)))


def ring_roots(inner_m: float, outer_m: float, biot_per_m: float, count: int) -> Array:
    """The first ``count`` roots mu of K Phi'(R_o) + h Phi(R_o) = 0, with ``biot_per_m`` = h/K [1/m]; ascending.

    The roots interlace with (n - 1/2) pi/(R_o - R_i) and n pi/(R_o - R_i), moved a little by the curvature.
    """

    def robin(mu: float) -> float:
        return float(_ring_mode_slope(mu, outer_m, inner_m) + biot_per_m * _ring_mode(mu, outer_m, inner_m))

    step = np.pi / (outer_m - inner_m)
    grid = np.linspace(1e-6 * step, (count + 1.5) * step, 40 * (count + 2))
    values = np.array([robin(g) for g in grid])
    at = np.flatnonzero(values[:-1] * values[1:] < 0)[:count]
    if len(at) < count:
        raise InputError(f"ring_roots: found {len(at)} of {count} roots")
    return np.array([brentq(robin, grid[i], grid[i + 1], xtol=1e-13 * step) for i in at])


def ring_transient_degC(
    radius_m: ArrayLike,
    time_s: ArrayLike,
    inner_m: float,
    outer_m: float,
    conductivity: float,
    alpha_m2_s: float,
    h: float,
    flux: float,
    inner_degC: float,
    ambient_degC: float,
    start_degC: float,
    modes: int = 60,
) -> Array:
    """Hollow cylinder, T_in fixed inside, flux and film outside, from one temperature: (times, radii) [degC].

    T = T_steady(r) + sum_n c_n Phi_n(r) exp(-alpha mu_n^2 t), c_n by projection with weight r; Phi_n and mu_n of
    ``ring_roots``; Carslaw and Jaeger, chapters 7 and 13. The integrals are taken by Gauss-Legendre quadrature.
    """
    r = np.atleast_1d(np.asarray(radius_m, dtype=float))
    t = np.atleast_1d(np.asarray(time_s, dtype=float))
    mu = ring_roots(inner_m, outer_m, h / conductivity, modes)
    x, w = np.polynomial.legendre.leggauss(8 * modes)
    at = inner_m + (outer_m - inner_m) * (x + 1) / 2
    phi = _ring_mode(mu[:, None], at, inner_m)
    steady = (inner_m, outer_m, conductivity, h, flux, inner_degC, ambient_degC)
    gap = start_degC - ring_steady_degC(at, *steady)
    weight = w * at
    c = (phi * gap) @ weight / ((phi * phi) @ weight)
    decay = np.exp(-alpha_m2_s * np.outer(t, mu**2))
    return np.asarray(ring_steady_degC(r, *steady) + (decay * c) @ _ring_mode(mu[:, None], r, inner_m))


def slab_root(biot: float) -> float:
    """Lowest root nu of nu tan(nu) = biot: the even mode of a slab cooled equally at both faces."""
    if not biot > 0:
        raise InputError(f"slab_root: the Biot number must be positive; got {biot}")
    return float(brentq(lambda v: v * np.sin(v) - biot * np.cos(v), 1e-12, np.pi / 2))


def product_decay_K(
    radius_m: ArrayLike,
    z_m: ArrayLike,
    time_s: float,
    inner_m: float,
    outer_m: float,
    width_m: float,
    conductivity: float,
    alpha_m2_s: float,
    h: float,
    washer: float,
) -> Array:
    """A field that varies in z and is exact: Phi_1(r) cos(2 nu (z/w - 1/2)) exp(-alpha (mu^2 + (2 nu/w)^2) t).

    (radii, z) [K] above an ambient at zero, with R_i held at zero, film h at R_o and washers at both faces; scaled
    so that Phi_1(R_o) = 1. It is the case that section 3.6.3 says it could not test.
    """
    mu = ring_roots(inner_m, outer_m, h / conductivity, 1)[0]
    nu = slab_root(washer * width_m / (2 * conductivity))
    phi = _ring_mode(mu, radius_m, inner_m) / _ring_mode(mu, outer_m, inner_m)
    shape = np.cos(2 * nu * (np.asarray(z_m) / width_m - 0.5))
    return np.asarray(np.outer(phi, shape) * np.exp(-alpha_m2_s * (mu**2 + (2 * nu / width_m) ** 2) * time_s))
