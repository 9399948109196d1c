"""Radial conduction in a disk heated at its running surface: modes, exact first-order lags.

Used by :mod:`immersion.radial` (the solver of the surface), :mod:`immersion.plunge_model`,
:mod:`immersion.hole`, the design of plunges and ``tcdyn verify``. The temperature depends on the
radius only. Each mode is a first-order lag, which is stepped
exactly for a flux that is linear between the knots of the grid. Tests:
``tests/immersion/test_immersion_radial.py`` (exact series, energy, order of convergence) and
``tests/immersion/test_plunge_fit.py`` (lags and filters on the grid).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dtbtrs, ztbtrs
from scipy.optimize import brentq
from scipy.special import j0, j1, y0, y1

from tcdyn.core import Array
from tcdyn.rig.disk import Conditioning, DiskSetup

# Ratio of imaginary part to modulus below which a pair of poles is taken as two equal real poles;
# chosen by judgement: the partial fractions of nearly equal poles cancel.
MIN_IMAGINARY_RATIO = 1e-5


@dataclass(frozen=True)
class Cylinder:
    """Hollow disk of one steel, bore (no flux) to running surface, with loss through its faces.

    Attributes
    ----------
    inner_radius_m, outer_radius_m
        Radii of bore and running surface [m]; 0 for a solid disk.
    conductivity_W_mK
        Thermal conductivity K.
    heat_capacity_J_m3K
        Volumetric heat capacity rho c.
    leak_1_s
        Rate of heat loss through the faces [1/s].

    Notes
    -----
    dT/dt = alpha (T_rr + T_r / r) - leak (T - T_fluid),  leak [1/s] = 2 U / (rho c w)

    with U [W/m2K] the heat transfer coefficient of each side face; zero for perfectly insulated
    faces (section 5.7).
    """

    inner_radius_m: float
    outer_radius_m: float
    conductivity_W_mK: float
    heat_capacity_J_m3K: float
    leak_1_s: float = 0.0

    @classmethod
    def from_setup(cls, setup: DiskSetup, face_W_m2K: float = 0.0) -> Cylinder:
        """The cylinder of a disk of ``rig.toml``.

        Parameters
        ----------
        setup
            Geometry and steel of the disk.
        face_W_m2K
            Heat transfer coefficient of each side face; 0: insulated.
        """
        rho_c = setup.density_kg_m3 * setup.specific_heat_J_kgK
        leak = 2 * face_W_m2K / (rho_c * setup.width_m)
        return cls(setup.bore_radius_m, setup.outer_radius_m, setup.conductivity_W_mK, rho_c, leak)

    @property
    def diffusivity_m2_s(self) -> float:
        """alpha = K / (rho c) [m2/s]."""
        return self.conductivity_W_mK / self.heat_capacity_J_m3K

    @property
    def mean_rate_K_m2_J(self) -> float:
        """Rise of the mean temperature per heat, 2 R_o / (rho c (R_o^2 - R_i^2)) [K m2/J]."""
        ro = self.outer_radius_m
        ri = self.inner_radius_m
        return 2 * ro / (self.heat_capacity_J_m3K * (ro**2 - ri**2))

    def static_profile(self, r_m: Array) -> Array:
        """Quasi-steady profile at radii ``r_m`` per unit surface flux, with mean zero [K m2/W].

        Parameters
        ----------
        r_m
            Radii (P,) [m].

        Returns
        -------
        profile
            (P,) [K m2/W].

        Notes
        -----
        S(r) = R_o / (K (R_o^2 - R_i^2)) (r^2/2 - R_i^2 ln r - C): slope 1/K at R_o and zero at R_i.

        ``modes`` must add up to this profile: ``tests/immersion/test_immersion_radial.py``.
        """
        ro = self.outer_radius_m
        ri = self.inner_radius_m
        area = ro**2 - ri**2
        shape = r_m**2 / 2
        log_mean = -0.5
        if ri > 0:
            shape = shape - ri**2 * np.log(r_m / ro)
            log_mean = (-(ri**2) * np.log(ri / ro)) / area - 0.5
        mean = (ro**2 + ri**2) / 4 - ri**2 * log_mean
        return ro / (self.conductivity_W_mK * area) * (shape - mean)

    def modes(self, r_m: Array, count: int) -> tuple[Array, Array]:
        """Radial modes, without the mean temperature.

        Parameters
        ----------
        r_m
            Radii (P,) [m].
        count
            Number of modes.

        Returns
        -------
        rates
            (count,) [1/s].
        gains
            At the radii ``r_m`` (P, count) [K m2/W].

        Notes
        -----
        T(r, t) = T_0 + mean + sum_k g_k(r) L_k q, with L_k the unit-gain lag of rate alpha
        lambda_k^2 + leak; sum_k g_k(r) = S(r) without heat loss.
        """
        ro = self.outer_radius_m
        ri = self.inner_radius_m
        lam = np.array(_eigenvalues(ri / ro, count)) / ro
        r = np.asarray(r_m, dtype=float)[:, None]

        def phi(x: Array | float) -> Array:
            """Eigenfunction of each mode (count,) at radii of a shape that broadcasts."""
            if ri == 0:
                return j0(lam * x)
            return j0(lam * x) * y1(lam * ro) - y0(lam * x) * j1(lam * ro)

        inner = ri**2 * phi(ri) ** 2 if ri > 0 else 0.0
        norm = (ro**2 * phi(ro) ** 2 - inner) / 2
        rates = self.diffusivity_m2_s * lam**2 + self.leak_1_s
        gains = ro * phi(ro) * phi(r) / (self.heat_capacity_J_m3K * norm * rates)
        return rates, gains


@lru_cache(maxsize=64)
def _eigenvalues(ratio: float, count: int) -> tuple[float, ...]:
    """Eigenvalues of the radial modes, x = lambda R_o.

    Roots of J1(x ratio) Y1(x) - J1(x) Y1(x ratio) = 0; for a solid disk of J1(x) = 0.

    Parameters
    ----------
    ratio
        R_i / R_o.
    count
        Number of eigenvalues.

    Returns
    -------
    x
        The first ``count`` positive roots [1].

    Notes
    -----
    The search step is an eighth of pi / (1 - ratio), the distance of the roots for large x. A much
    longer step can miss a root. Test: ``tests/immersion/test_immersion_radial.py``.
    """

    def characteristic_function(x: float) -> float:
        """Characteristic function whose positive roots are the eigenvalues."""
        if ratio == 0:
            return float(j1(x))
        return float(j1(x * ratio) * y1(x) - j1(x) * y1(x * ratio))

    step = np.pi / (1 - ratio) / 8
    roots: list[float] = []
    x = step / 2
    while len(roots) < count:
        if characteristic_function(x) * characteristic_function(x + step) < 0:
            roots.append(brentq(characteristic_function, x, x + step, xtol=1e-12))
        x += step
    return tuple(roots)


def lag_step(dt_s: Array, rate: float | complex) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Exact step of a unit-gain first-order lag under a linear input.

    Parameters
    ----------
    dt_s
        Steps [s].
    rate
        1/tau [1/s]; complex for one pole of a Butterworth filter, which gives complex weights.

    Returns
    -------
    decay, old, new
        Each of the shape of ``dt_s``, with y+ = decay y + old u + new u+.

    Notes
    -----
    Below abs(rate dt) = 1e-4 a series replaces the quotient, which would lose digits by
    cancellation.
    """
    x = rate * np.asarray(dt_s, dtype=float)
    decay = np.exp(-x)
    small = np.abs(x) < 1e-4
    safe = np.where(small, 1.0, x)
    mean = np.where(small, 1 - x / 2 + x**2 / 6, (1 - np.exp(-safe)) / safe)
    return decay, mean - decay, 1 - mean


def lag_on_grid(u: Array, dt_s: Array, rate: float | complex) -> NDArray[Any]:
    """Apply a unit-gain first-order lag to inputs on a grid.

    Exact for an input that is linear between knots; y[0] = 0, since nothing changes before the
    first knot.

    Parameters
    ----------
    u
        Deviations from equilibrium (n, M).
    dt_s
        Steps of the grid (n - 1,) [s].
    rate
        1/tau [1/s]; complex for a pole of a filter.

    Returns
    -------
    y
        (n, M).
    """
    return apply_lag_step(u.T, lag_step(dt_s, rate)).T


def apply_lag_step(u: Array, step: tuple[NDArray[Any], NDArray[Any], NDArray[Any]]) -> NDArray[Any]:
    """Apply lags with the weights of :func:`lag_step`.

    Parameters
    ----------
    u
        Inputs (Q, ..., n).
    step
        Weights decay, old and new, each (..., n - 1).

    Returns
    -------
    y
        Outputs of the shape of ``u``; y[..., 0] = 0.
    """
    decay, old, new = step
    drive = np.zeros(u.shape, dtype=np.result_type(u, decay))
    drive[..., 1:] = old * u[..., :-1] + new * u[..., 1:]
    return first_order_recursion(drive, decay)


def first_order_recursion(drive: NDArray[Any], decay: NDArray[Any]) -> NDArray[Any]:
    """First-order recursion along the last axis; overwrites ``drive``.

    Parameters
    ----------
    drive
        (Q, ..., n).
    decay
        (..., n - 1).

    Returns
    -------
    y
        Of the shape of ``drive``.

    Notes
    -----
    y[k] = decay[k - 1] y[k - 1] + drive[k]. Any solver of a unit bidiagonal system may replace the
    LAPACK call; the tests of ``tests/immersion/test_plunge_fit.py`` compare with the chain.
    """
    bands = np.zeros((2, *drive.shape[1:]), dtype=decay.dtype)
    bands[1, ..., :-1] = -decay
    # Triangular band solver with unit diagonal: three times faster than solve_banded with its
    # checks.
    solve = ztbtrs if np.iscomplexobj(bands) else dtbtrs
    rows = drive.reshape(len(drive), -1).T
    solution = solve(bands.reshape(2, -1), rows, uplo="L", diag="U", overwrite_b=True)[0]
    return solution.T.reshape(drive.shape)


def apply_conditioning(u: Array, dt_s: Array, filter_: Conditioning) -> Array:
    """Apply the conditioning filter to deviations ``u`` (n, M) on the grid.

    Parameters
    ----------
    u
        Deviations from equilibrium (n, M).
    dt_s
        Steps of the grid (n - 1,) [s].
    filter_
        Conditioning filter, as in ``rig.toml`` or whitened.

    Returns
    -------
    y
        (n, M).

    Notes
    -----
    Real poles act one after the other. A complex pair acts as twice the real part of the first
    partial fraction of p1 p2/((s - p1)(s - p2)). A zero of the filter is combined with the last
    pole, which is then real.

    It must be the same filter as in ``tcdyn.chain.Chain``; ``tests/immersion/test_plunge_fit.py``
    compares sections of two real poles, equal poles and a zero. ``MIN_IMAGINARY_RATIO`` decides
    where a pair of poles is treated as two real ones.
    """
    before = u
    for factor in filter_.factors:
        before = u
        for p in np.roots(factor[::-1]).astype(complex):
            if abs(p.imag) < MIN_IMAGINARY_RATIO * abs(p):
                u = lag_on_grid(u, dt_s, -p.real)
            elif p.imag > 0:
                fraction = p.conjugate() / (1j * p.imag)
                u = np.real(fraction * -lag_on_grid(u, dt_s, -p))
    if len(filter_.numerator) > 1:
        u = u + filter_.numerator[1] / filter_.factors[-1][1] * (before - u)
    return u


def lag_matrix(t_s: Array, rate: float) -> Array:
    """Unit-gain lag of ``rate`` [1/s] on a grid as a lower triangular matrix L (n, n): y = L u.

    u is zero before t_s[0] (a step of u[0] there), and y(t_s[0]) = 0. Exact for a piecewise linear
    u.

    Parameters
    ----------
    t_s
        Grid (n,) [s].
    rate
        1/tau [1/s].

    Returns
    -------
    matrix
        (n, n), lower triangular.

    Notes
    -----
    Equal to :func:`lag_on_grid` as a matrix, for a u that is zero before t_s[0].
    """
    _, old, new = lag_step(np.diff(t_s), rate)
    decay = np.exp(-rate * np.clip(t_s[:, None] - t_s[None, 1:], 0.0, None))
    decay *= t_s[:, None] >= t_s[None, 1:] - 1e-12
    out = np.zeros((len(t_s), len(t_s)))
    out[:, :-1] += decay * old
    out[:, 1:] += decay * new
    return out


def integral_matrix(t_s: Array) -> Array:
    """Running trapezoidal integral on a grid, lower triangular (n, n) [s].

    Parameters
    ----------
    t_s
        Grid (n,) [s].

    Returns
    -------
    matrix
        (n, n) [s]; it is the limit of ``lag_matrix(t_s, rate) / rate`` for a small rate.
    """
    dt = np.diff(t_s)
    lower = (t_s[:, None] >= t_s[None, 1:] - 1e-12).astype(float)
    out = np.zeros((len(t_s), len(t_s)))
    out[:, :-1] += lower * dt / 2
    out[:, 1:] += lower * dt / 2
    return out


def influence(cylinder: Cylinder, r_m: Array, t_s: Array, modes: int = 24) -> tuple[Array, Array]:
    """Influence of a surface flux on the temperatures of a cylinder.

    Parameters
    ----------
    cylinder
        The disk.
    r_m
        Radii (P,) [m].
    t_s
        Grid (n,) [s]; t_s[0] is the entry.
    modes
        Number of modes that are stepped exactly. The remaining modes follow the flux at once, with
        the exact static gain.

    Returns
    -------
    matrix
        (P, n, n) [K m2/W].
    leak
        (n, n), zero without heat loss.

    Notes
    -----
    T[p] = T_0 + matrix[p] @ q + leak @ (T_bath - T_0), with q the flux on the grid.

    ``modes`` may be raised freely; the static gain is exact for any number, and fewer modes make
    the first instants less exact. Test: ``tests/immersion/test_immersion_radial.py``.
    """
    rates, gains = cylinder.modes(r_m, modes)
    n = len(t_s)
    gains_without_leak = gains * rates / (rates - cylinder.leak_1_s)
    direct = cylinder.static_profile(r_m) - gains_without_leak.sum(axis=1)
    stack = np.empty((modes + 2, n * n))
    for k, rate in enumerate(rates):
        stack[k] = lag_matrix(t_s, rate).ravel()
    leak_1_s = cylinder.leak_1_s
    if leak_1_s > 0:
        leak = lag_matrix(t_s, leak_1_s)
        stack[modes] = (leak / leak_1_s).ravel()
    else:
        leak = np.zeros((n, n))
        stack[modes] = integral_matrix(t_s).ravel()
    stack[modes + 1] = np.eye(n).ravel()
    weights = np.column_stack([gains, np.full(len(r_m), cylinder.mean_rate_K_m2_J), direct])
    return (weights @ stack).reshape(len(r_m), n, n), leak
