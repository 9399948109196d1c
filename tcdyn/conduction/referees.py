"""What the modal engine is held against: closed forms, and the thesis's Crank-Nicolson scheme, factorised once.

Closed forms of sections 3.4.1 and 3.6, and the case that is missing there. The scheme of section 3.4.3 is written
from the thesis's coefficients (3.30)-(3.31) in their own form on the engine's nodes, not from the engine's operators,
so that the engine has something independent to agree with.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.sparse.linalg import SuperLU, splu
from scipy.special import erf, j0, j1, y0, y1

from calibration.arrays import Array
from calibration.errors import InputError
from tcdyn.conduction.rim import MESH_IV, Mesh, Rim

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


@dataclass(frozen=True)
class Scheme:
    """dT/dt = -A T + G_in T_inner + g_q q + g_a T_A + g_faces: unknowns (nr-1) x nz in rows of r, node 0 imposed.

    matrix A (n, n) [1/s]; inner (n, nz) from the imposed profile; outer (n, nz) from the flux q_i [K/s per W/m2];
    film (n,), face_d (n,), face_f (n,) from the air at the surface and behind each washer [1/s].
    """

    mesh: Mesh
    matrix: sp.csc_matrix
    inner: sp.csr_matrix
    outer: sp.csr_matrix
    film: Array
    face_d: Array
    face_f: Array


def scheme(rim: Rim, h_W_m2K: float | Array, mesh: Mesh = MESH_IV) -> Scheme:
    """The semi-discrete rim; ``h_W_m2K`` is one number, or one for each z node (nz,)."""
    m, n = mesh.nr - 1, mesh.nz
    dr, dz = rim.thickness_m / m, rim.width_m / (n - 1)
    alpha, k = rim.diffusivity_m2_s, rim.conductivity_W_mK
    s, gamma = rim.inner_radius_m / dr, (dr / dz) ** 2
    j = np.arange(1, m + 1)
    up, down = (s + j + 0.5) / (s + j), (s + j - 0.5) / (s + j)  # (3.30): A and B times 2 (phi + gamma + 1)
    down_in = down.copy()
    down[-1] = up[-1] + down[-1]  # (3.31): the node outside the surface is eliminated
    rim_h = np.broadcast_to(np.asarray(h_W_m2K, dtype=float), (n,))
    film = up[-1] * 2 * dr / k * rim_h  # what the film adds to the diagonal
    face = gamma * 2 * dz * rim.washer_W_m2K / k
    side = np.full(n - 1, gamma)
    left, right = side.copy(), side.copy()
    right[0] = left[-1] = 2 * gamma  # washers: the nodes outside the faces are eliminated
    in_r = sp.diags([-down[1:], np.full(m, 2.0), -up[:-1]], [-1, 0, 1])
    in_z = sp.diags([-left, np.full(n, 2 * gamma), -right], [-1, 0, 1]).tolil()
    in_z[0, 0] += face
    in_z[n - 1, n - 1] += face
    last = sp.csr_matrix(([1.0], ([m - 1], [m - 1])), shape=(m, m))
    a = sp.kron(in_r, sp.eye(n)) + sp.kron(sp.eye(m), in_z) + sp.kron(last, sp.diags(film))
    scale = alpha / dr**2
    first_r, last_r, ones_r = np.zeros(m), np.zeros(m), np.ones(m)
    first_r[0], last_r[-1] = down_in[0], up[-1] * 2 * dr / k
    e_d, e_f = np.eye(n)[0] * face, np.eye(n)[-1] * face
    return Scheme(
        mesh=mesh,
        matrix=sp.csc_matrix(a * scale),
        inner=sp.csr_matrix(sp.kron(first_r[:, None], sp.eye(n)) * scale),
        outer=sp.csr_matrix(sp.kron(last_r[:, None], sp.eye(n)) * scale),
        film=np.asarray(np.kron(np.eye(m)[-1], film) * scale),
        face_d=np.kron(ones_r, e_d) * scale,
        face_f=np.kron(ones_r, e_f) * scale,
    )


@dataclass(frozen=True)
class CrankNicolson:
    """(I + dt/2 A) T+ = (I - dt/2 A) T + dt/2 (g + g+), with its matrix factorised once.

    ``damped``: the step is replaced by two implicit Euler steps of half its length, which share the factor
    (Rannacher 1984); wanted for the two steps after a jump, because Crank-Nicolson does not damp what is stiff.
    """

    scheme: Scheme
    dt_s: float
    factor: SuperLU
    forward: sp.csr_matrix

    @classmethod
    def prepare(cls, s: Scheme, dt_s: float) -> CrankNicolson:
        """Factorise (SuperLU, minimum degree on A + A', symmetric mode)."""
        eye = sp.eye(s.matrix.shape[0], format="csc")
        half = (dt_s / 2) * s.matrix
        factor = splu((eye + half).tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
        return cls(s, dt_s, factor, sp.csr_matrix(eye - half))

    def step(self, field: Array, g_now: Array, g_next: Array, damped: bool = False) -> Array:
        """One step of fields (n,) or (n, columns); g are the forcings [K/s] at its two ends."""
        half = self.dt_s / 2
        if damped:
            middle = self.factor.solve(field + half * (g_now + g_next) / 2)
            return np.asarray(self.factor.solve(middle + half * g_next))
        return np.asarray(self.factor.solve(self.forward @ field + half * (g_now + g_next)))


def steady_field(s: Scheme, forcing: Array) -> Array:
    """The field (n,) that no longer changes: A T = g."""
    return np.asarray(splu(s.matrix.tocsc(), permc_spec="MMD_AT_PLUS_A").solve(forcing))


def explicit_limit_s(rim: Rim, mesh: Mesh) -> float:
    """Largest stable step of the explicit scheme, dt <= dr^2 dz^2 / (2 alpha (dr^2 + dz^2)) [s] (section 3.4.2).

    The thesis quotes the one-dimensional form alpha dt / dx^2 <= 1/2; in two dimensions the sum over both counts.

    >>> from calibration.rig import load_rig
    >>> round(explicit_limit_s(Rim.from_setup(load_rig().disk_setup("fast")), Mesh()) * 1e3, 3)   # mesh IV: [ms]
    0.193
    """
    dr, dz = rim.thickness_m / (mesh.nr - 1), rim.width_m / (mesh.nz - 1)
    return 0.5 / (rim.diffusivity_m2_s * (dr**-2 + dz**-2))


def explicit_growth(rim: Rim, mesh: Mesh, dt_s: float, steps: int = 200) -> float:
    """Largest |T| after ``steps`` explicit steps from a +-1 checkerboard, unforced: below one when stable."""
    if not dt_s > 0:
        raise InputError(f"explicit_growth: dt_s must be positive; got {dt_s}")
    s = scheme(rim, 0.0, mesh)
    i, j = np.indices((mesh.nr - 1, mesh.nz))
    t = (1.0 - 2.0 * ((i + j) % 2)).ravel()
    for _ in range(steps):
        t = t - dt_s * (s.matrix @ t)
    return float(np.abs(t).max())
