"""Reference solutions for the modal engine: closed forms, and the thesis's Crank-Nicolson scheme.

Closed forms of sections 3.4.1 and 3.6, and the case that is missing there. The scheme of section
3.4.3 is written from the thesis's coefficients (3.30)-(3.31) on the nodes of the engine, but not
from its operators, so that the two are independent.

Used by ``tcdyn.verify`` (the published numbers) and by the tests in ``tests/heat``; no fit uses it.
Keep it independent of ``tcdyn.heat.modal``, otherwise an error in both would not be seen. The
closed forms are guarded by ``tests/heat/test_rim_closed_forms.py``, the time steps of the scheme by
``tests/heat/test_rim_reference.py``, its steady field by
``test_static_gain_matches_the_steady_state_of_the_scheme`` in ``tests/heat/test_rim_engine.py``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.sparse.linalg import SuperLU, splu
from scipy.special import erf, j0, j1, y0, y1

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.heat.rim import MESH_IV, Mesh, Rim

# Argument beyond which the thesis takes erf as one, in (3.27) 2 * 3.6 = 7.2.
ERF_ONE = 3.6


def semi_infinite(
    depth_m: ArrayLike, time_s: ArrayLike, start: float, surface: float, alpha_m2_s: float
) -> Array:
    """Temperature of a half space after a jump of its surface temperature, t > 0 (3.26).

    Parameters
    ----------
    depth_m
        Depths x below the surface [m].
    time_s
        Times after the jump, above zero [s]; must broadcast with ``depth_m``.
    start
        Temperature before the jump, T_i [degC].
    surface
        Temperature of the surface after it, T_o [degC].
    alpha_m2_s
        Thermal diffusivity [m2/s].

    Returns
    -------
    Temperatures in the broadcast shape [degC].

    Notes
    -----
    T = T_o + (T_i - T_o) erf(x / (2 sqrt(alpha t)))

    Examples
    --------
    >>> float(semi_infinite(3e-3, 1.0, 20.0, 160.0, 1.1e-5).round(2))
    93.14
    """
    x = np.asarray(depth_m, dtype=float)
    t = np.asarray(time_s, dtype=float)
    return np.asarray(surface + (start - surface) * erf(x / (2 * np.sqrt(alpha_m2_s * t))))


def penetration_depth_m(time_s: ArrayLike, alpha_m2_s: float) -> Array:
    """Penetration depth [m] of a surface jump after ``time_s``: x = 7.2 sqrt(alpha t) (3.27).

    Parameters
    ----------
    time_s
        Times after the jump [s].
    alpha_m2_s
        Thermal diffusivity [m2/s].

    Returns
    -------
    Depths [m], in the shape of ``time_s``.

    Notes
    -----
    Beyond this depth the argument of erf in (3.26) exceeds ``ERF_ONE``.
    """
    return np.asarray(2 * ERF_ONE * np.sqrt(alpha_m2_s * np.asarray(time_s, dtype=float)))


def surface_steady_degC(
    rim: Rim, h: float, flux: float, inner_degC: float, ambient_degC: float
) -> float:
    """Temperature of the running surface of the steady ring (3.37) [degC].

    Parameters
    ----------
    rim
        Radii and conductivity.
    h
        Heat-transfer coefficient of the running surface [W/m2K].
    flux
        Heat flux into the running surface [W/m2].
    inner_degC
        Temperature at the inner radius [degC].
    ambient_degC
        Temperature of the air [degC].

    Notes
    -----
    T_out = (R h T_A + K/ln(R/r) T_in + R q)/(h R + K/ln(R/r))
    """
    r = rim.outer_radius_m
    c = rim.conductivity_W_mK / np.log(rim.outer_radius_m / rim.inner_radius_m)
    return float((r * h * ambient_degC + c * inner_degC + r * flux) / (h * r + c))


def ring_steady_degC(
    rim: Rim, radius_m: ArrayLike, h: float, flux: float, inner_degC: float, ambient_degC: float
) -> Array:
    """Temperature of the steady ring [degC]: (3.36), in which T_in must not be divided by K.

    Parameters
    ----------
    rim
        Radii and conductivity.
    radius_m
        Radii r [m].
    h
        Heat-transfer coefficient of the running surface [W/m2K].
    flux
        Heat flux into the running surface [W/m2].
    inner_degC
        Temperature at the inner radius [degC].
    ambient_degC
        Temperature of the air [degC].

    Returns
    -------
    Temperatures in the shape of ``radius_m`` [degC].

    Notes
    -----
    T = T_in + (q - h (T_out - T_A)) R ln(r/r_in) / K
    """
    net = flux - h * (surface_steady_degC(rim, h, flux, inner_degC, ambient_degC) - ambient_degC)
    shape = np.log(np.asarray(radius_m) / rim.inner_radius_m)
    return np.asarray(inner_degC + net * rim.outer_radius_m / rim.conductivity_W_mK * shape)


def _ring_mode(mu: ArrayLike, r: ArrayLike, inner_m: float) -> Array:
    """Phi(r) = J0(mu r) Y0(mu R_i) - Y0(mu r) J0(mu R_i): zero at the inner radius.

    Parameters
    ----------
    mu
        Eigenvalues [1/m].
    r
        Radii [m]; must broadcast with ``mu``.
    inner_m
        Inner radius R_i [m].

    Returns
    -------
    Values of the mode in the broadcast shape.
    """
    mu = np.asarray(mu)
    r = np.asarray(r)
    return np.asarray(j0(mu * r) * y0(mu * inner_m) - y0(mu * r) * j0(mu * inner_m))


def ring_eigenvalues(
    inner_m: float, outer_m: float, h_over_conductivity_1_m: float, count: int
) -> Array:
    """The first ``count`` eigenvalues mu [1/m] of a ring, ascending.

    They solve K Phi'(R_o) + h Phi(R_o) = 0 for the mode Phi with Phi(R_i) = 0. Eigenvalue n lies
    between (n - 1/2) pi/(R_o - R_i) and n pi/(R_o - R_i), apart from a small shift by the
    curvature; the search grid has 40 points for each pi/(R_o - R_i).

    They solve K Phi'(R_o) + h Phi(R_o) = 0 for the mode Phi with Phi(R_i) = 0.

    Parameters
    ----------
    inner_m, outer_m
        Radii R_i > 0 and R_o [m].
    h_over_conductivity_1_m
        Heat transfer coefficient over conductivity [1/m].
    count
        Number of eigenvalues.

    Returns
    -------
    Eigenvalues, (count,) [1/m].

    Raises
    ------
    InputError
        If fewer roots are found.

    Notes
    -----
    Eigenvalue n lies between (n - 1/2) pi/(R_o - R_i) and n pi/(R_o - R_i), apart from a small
    shift by the curvature. The search grid has about 40 points for each pi/(R_o - R_i). A finer
    grid changes nothing; a much coarser one may miss roots. ``tests/heat/test_rim_closed_forms.py``
    compares with the roots of a slab.
    """

    def robin(mu: Array) -> Array:
        """Value of the condition at R_o, zero at an eigenvalue; divided by K [1/m]."""
        slope = -mu * (j1(mu * outer_m) * y0(mu * inner_m) - y1(mu * outer_m) * j0(mu * inner_m))
        return np.asarray(slope + h_over_conductivity_1_m * _ring_mode(mu, outer_m, inner_m))

    step = np.pi / (outer_m - inner_m)
    grid = np.linspace(1e-6 * step, (count + 1.5) * step, 40 * (count + 2))
    values = robin(grid)
    brackets = np.flatnonzero(values[:-1] * values[1:] < 0)[:count]
    if len(brackets) < count:
        raise InputError(f"ring_eigenvalues: found {len(brackets)} of {count} roots")
    return np.array([brentq(robin, grid[i], grid[i + 1], xtol=1e-13 * step) for i in brackets])


def ring_transient_degC(
    rim: Rim,
    radius_m: ArrayLike,
    time_s: ArrayLike,
    h: float,
    flux: float,
    inner_degC: float,
    ambient_degC: float,
    start_degC: float,
    modes: int = 60,
) -> Array:
    """Hollow cylinder from a uniform temperature, (times, radii) [degC].

    T_in is fixed inside; flux and heat-transfer coefficient act outside.

    Parameters
    ----------
    rim
        Radii and material.
    radius_m
        Radii of the result, (n,) [m].
    time_s
        Times after the start, (T,) [s].
    h
        Heat-transfer coefficient of the outer surface [W/m2K].
    flux
        Heat flux into the outer surface [W/m2].
    inner_degC
        Temperature at the inner radius after the start [degC].
    ambient_degC
        Temperature of the air [degC].
    start_degC
        Uniform temperature at the start [degC].
    modes
        Number of terms of the series. Short times need more: the first neglected term decays with
        exp(-alpha mu^2 t).

    Returns
    -------
    Temperatures, (T, n) [degC].

    Notes
    -----
    T = T_steady(r) + sum_n c_n Phi_n(r) exp(-alpha mu_n^2 t), with c_n by projection with weight r;
    Phi_n and mu_n of ``ring_eigenvalues`` (Carslaw and Jaeger, chapters 7 and 13). The integrals
    use Gauss-Legendre quadrature.
    """
    inner_m = rim.inner_radius_m
    mu = ring_eigenvalues(inner_m, rim.outer_radius_m, h / rim.conductivity_W_mK, modes)
    x, weights = np.polynomial.legendre.leggauss(8 * modes)
    r = inner_m + rim.thickness_m * (x + 1) / 2
    phi = _ring_mode(mu[:, None], r, inner_m)
    difference = start_degC - ring_steady_degC(rim, r, h, flux, inner_degC, ambient_degC)
    c = (phi * difference) @ (weights * r) / ((phi * phi) @ (weights * r))
    decay = np.exp(-rim.diffusivity_m2_s * np.outer(np.asarray(time_s, dtype=float), mu**2))
    steady = ring_steady_degC(rim, radius_m, h, flux, inner_degC, ambient_degC)
    return np.asarray(steady + (decay * c) @ _ring_mode(mu[:, None], radius_m, inner_m))


def slab_root(biot: float) -> float:
    """Lowest root nu of nu tan(nu) = biot: even mode of a slab cooled equally at both faces.

    Parameters
    ----------
    biot
        Biot number of half the thickness, above zero.

    Returns
    -------
    float
        The root, dimensionless.

    Raises
    ------
    InputError
        ``biot`` is not positive.

    Notes
    -----
    The root lies between 0 and pi/2. Carslaw and Jaeger (1959), section 3.11; their appendix IV has
    a table, with which ``tests/heat/test_rim_closed_forms.py`` compares.
    """
    if not biot > 0:
        raise InputError(f"slab_root: the Biot number must be positive; got {biot}")
    return float(brentq(lambda v: v * np.sin(v) - biot * np.cos(v), 1e-12, np.pi / 2))


def product_decay_K(
    rim: Rim, radius_m: ArrayLike, z_m: ArrayLike, time_s: float, h: float
) -> Array:
    """An exact decaying field that varies in z, (radii, z) [K] above an ambient at zero.

    R_i is at zero, the heat-transfer coefficient ``h`` [W/m2K] acts at R_o and the washers of the
    rim at both faces; scaled to Phi_1(R_o) = 1. Section 3.6.3 could not test this case.

    Parameters
    ----------
    rim
        Geometry, material and washers.
    radius_m
        Radii, (n,) [m].
    z_m
        Positions from one face, (p,) [m].
    time_s
        Time of the decay [s].
    h
        Heat-transfer coefficient at R_o [W/m2K].

    Returns
    -------
    Field, (n, p) [K].

    Notes
    -----
    Phi_1(r) cos(2 nu (z/w - 1/2)) exp(-alpha (mu^2 + (2 nu/w)^2) t)

    mu is the first root of ``ring_eigenvalues``, nu that of ``slab_root``. It is the exact solution
    for ``tcdyn.heat.engine.free_decay``, see ``tests/heat/test_rim_convergence.py``.
    """
    inner = rim.inner_radius_m
    outer = rim.outer_radius_m
    w = rim.width_m
    k = rim.conductivity_W_mK
    mu = ring_eigenvalues(inner, outer, h / k, 1)[0]
    nu = slab_root(rim.washer_W_m2K * w / (2 * k))
    shape_r = _ring_mode(mu, radius_m, inner) / _ring_mode(mu, outer, inner)
    shape_z = np.cos(2 * nu * (np.asarray(z_m) / w - 0.5))
    rate = rim.diffusivity_m2_s * (mu**2 + (2 * nu / w) ** 2)
    return np.asarray(np.outer(shape_r, shape_z) * np.exp(-rate * time_s))


@dataclass(frozen=True)
class Scheme:
    """The semi-discrete rim: dT/dt = -A T + G_in T_inner + g_q q + g_a T_A + g_faces.

    The unknowns are (nr-1) x nz nodes in rows of r; node 0 has the imposed profile.

    Parameters
    ----------
    mesh
        The mesh.
    matrix
        A, (n, n) [1/s].
    inner
        G_in, from the imposed profile, (n, nz).
    outer
        g_q, from the flux at each z node, (n, nz) [K/s per W/m2].
    film, face_d, face_f
        From the air at the running surface and behind each washer, (n,) [1/s].
    """

    mesh: Mesh
    matrix: sp.csc_matrix
    inner: sp.csr_matrix
    outer: sp.csr_matrix
    film: Array
    face_d: Array
    face_f: Array


def scheme(rim: Rim, h_W_m2K: float | Array, mesh: Mesh = MESH_IV) -> Scheme:
    """The semi-discrete rim from the coefficients of the thesis.

    Parameters
    ----------
    rim
        Geometry, material and washers.
    h_W_m2K
        Heat-transfer coefficient of the running surface [W/m2K]: one number, or one for each z
        node, (nz,).
    mesh
        Nodes in r and z.

    Returns
    -------
    The matrices of the scheme, described at ``Scheme``.

    Notes
    -----
    Equation (3.30) in r, (3.31) at the running surface, and the washers of section 3.4.4.3 at the
    faces. It must not call ``tcdyn.heat.modal``: ``tests/heat/test_rim_engine.py`` compares the
    two.
    """
    m = mesh.nr - 1
    n = mesh.nz
    dr = rim.thickness_m / m
    dz = rim.width_m / (n - 1)
    s = rim.inner_radius_m / dr
    gamma = (dr / dz) ** 2
    k = rim.conductivity_W_mK
    scale = rim.diffusivity_m2_s / dr**2
    j = np.arange(1, m + 1)
    eye_r = np.eye(m)
    eye_z = np.eye(n)
    # (3.30): A and B times 2 (phi + gamma + 1)
    up = (s + j + 0.5) / (s + j)
    down = (s + j - 0.5) / (s + j)
    first = eye_r[0] * down[0] * scale
    last = eye_r[-1] * up[-1] * 2 * dr / k * scale
    down[-1] += up[-1]  # (3.31): the node outside the surface is eliminated
    in_r = 2 * eye_r - np.diag(down[1:], -1) - np.diag(up[:-1], 1)
    in_z = gamma * (2 * eye_z - np.eye(n, k=1) - np.eye(n, k=-1))
    # washers: the nodes outside the faces are eliminated
    in_z[0, 1] = -2 * gamma
    in_z[-1, -2] = -2 * gamma
    face = gamma * 2 * dz * rim.washer_W_m2K / k * scale
    face_d = np.tile(eye_z[0] * face, m)
    face_f = np.tile(eye_z[-1] * face, m)
    # contribution of the surface's heat-transfer coefficient to the diagonal
    film = np.kron(last, np.broadcast_to(np.asarray(h_W_m2K, dtype=float), n))
    conduction = (sp.kron(in_r, sp.eye(n)) + sp.kron(sp.eye(m), in_z)) * scale
    return Scheme(
        mesh=mesh,
        matrix=sp.csc_matrix(conduction + sp.diags(film + face_d + face_f)),
        inner=sp.csr_matrix(sp.kron(first[:, None], sp.eye(n))),
        outer=sp.csr_matrix(sp.kron(last[:, None], sp.eye(n))),
        film=np.asarray(film),
        face_d=face_d,
        face_f=face_f,
    )


@dataclass(frozen=True)
class CrankNicolson:
    """Crank-Nicolson steps with a matrix that is factorised once.

    (I + dt/2 A) T+ = (I - dt/2 A) T + dt/2 (g + g+)

    A ``damped`` step consists of two implicit Euler steps of half its length, which use the same
    factor (Rannacher 1984). Use it for the two steps after a jump: Crank-Nicolson does not damp
    stiff modes.

    Parameters
    ----------
    scheme
        The semi-discrete rim.
    dt_s
        Time step dt [s].
    factor
        LU factors of I + dt/2 A.
    forward
        I - dt/2 A, (n, n).

    Notes
    -----
    (I + dt/2 A) T+ = (I - dt/2 A) T + dt/2 (g + g+)

    A ``damped`` step consists of two implicit Euler steps of half its length, which use the same
    factor (Rannacher 1984). Use it for the two steps after a jump: Crank-Nicolson does not damp
    stiff modes. ``tests/heat/test_rim_reference.py`` shows the difference.
    """

    scheme: Scheme
    dt_s: float
    factor: SuperLU
    forward: sp.csr_matrix

    @classmethod
    def prepare(cls, equations: Scheme, dt_s: float) -> CrankNicolson:
        """Factorise (SuperLU, minimum degree on A + A', symmetric mode).

        Parameters
        ----------
        equations
            The semi-discrete rim.
        dt_s
            Time step [s].
        """
        eye = sp.eye(equations.matrix.shape[0], format="csc")
        half = (dt_s / 2) * equations.matrix
        factor = splu(
            (eye + half).tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}
        )
        return cls(equations, dt_s, factor, sp.csr_matrix(eye - half))

    def step(self, field: Array, g_now: Array, g_next: Array, damped: bool = False) -> Array:
        """One time step.

        Parameters
        ----------
        field
            Field at the start of the step, (n,) or (n, columns) [degC].
        g_now, g_next
            Forcing at the start and the end of the step, in the shape of ``field`` [K/s].
        damped
            Whether to take two implicit Euler steps of half the length instead.

        Returns
        -------
        Field at the end of the step, in the shape of ``field`` [degC].
        """
        half = self.dt_s / 2
        if damped:
            middle = self.factor.solve(field + half * (g_now + g_next) / 2)
            return np.asarray(self.factor.solve(middle + half * g_next))
        return np.asarray(self.factor.solve(self.forward @ field + half * (g_now + g_next)))


def steady_field(equations: Scheme, forcing: Array) -> Array:
    """The steady field: the solution of A T = g.

    Parameters
    ----------
    equations
        The semi-discrete rim.
    forcing
        Constant forcing, (n,) [K/s]: g = G_in T_inner + g_q q plus the terms of the air of
        :class:`Scheme`.

    Returns
    -------
    Field, (n,) [degC]; n = (nr-1) nz: the row r = R_i, which is imposed, is left out.

    Notes
    -----
    The order of elimination may change. Guarded by
    ``test_static_gain_matches_the_steady_state_of_the_scheme`` in
    ``tests/heat/test_rim_engine.py``. The runs of ``tests/heat/reference_run.py`` and of
    ``tcdyn.verify.studies`` start from it; ``tcdyn.verify.studies`` also compares meshes by it.
    """
    return np.asarray(splu(equations.matrix.tocsc(), permc_spec="MMD_AT_PLUS_A").solve(forcing))


def explicit_limit_s(rim: Rim, mesh: Mesh) -> float:
    """Largest stable step of the explicit scheme [s] (section 3.4.2).

    dt <= dr^2 dz^2 / (2 alpha (dr^2 + dz^2)). The thesis quotes the one-dimensional form alpha dt /
    dx^2 <= 1/2; in two dimensions the sum over both directions counts.

    Parameters
    ----------
    rim
        Geometry and material.
    mesh
        Nodes in r and z.

    Notes
    -----
    dt <= dr^2 dz^2 / (2 alpha (dr^2 + dz^2)). The thesis quotes the one-dimensional form alpha dt /
    dx^2 <= 1/2; in two dimensions the sum over both directions counts.

    Examples
    --------
    >>> from tcdyn.rig.rigfile import load_rig
    >>> rim = Rim.from_setup(load_rig().disk_setup("fast"))
    >>> round(explicit_limit_s(rim, MESH_IV) * 1e3, 3)  # [ms]
    0.193
    """
    dr = rim.thickness_m / (mesh.nr - 1)
    dz = rim.width_m / (mesh.nz - 1)
    return 0.5 / (rim.diffusivity_m2_s * (dr**-2 + dz**-2))


def explicit_growth(rim: Rim, mesh: Mesh, dt_s: float, steps: int = 200) -> float:
    """Largest |T| after unforced explicit steps from a +-1 checkerboard; below one if stable.

    Parameters
    ----------
    rim
        Geometry, material and washers.
    mesh
        Nodes in r and z.
    dt_s
        Time step [s].
    steps
        Number of steps.

    Raises
    ------
    InputError
        ``dt_s`` is not positive.

    Notes
    -----
    The heat-transfer coefficient of the running surface is zero. The checkerboard is close to the
    fastest mode, which grows first. ``tests/heat/test_rim_reference.py`` uses it on both sides of
    ``explicit_limit_s``.
    """
    if not dt_s > 0:
        raise InputError(f"explicit_growth: dt_s must be positive; got {dt_s}")
    s = scheme(rim, 0.0, mesh)
    i, j = np.indices((mesh.nr - 1, mesh.nz))
    t = (1.0 - 2.0 * ((i + j) % 2)).ravel()
    for _ in range(steps):
        t = t - dt_s * (s.matrix @ t)
    return float(np.abs(t).max())
