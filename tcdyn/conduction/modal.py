"""The rim as a small linear filter: weights of the lag bank for every input and point.

The scheme's operator is ``A_r x I + I x A_z``, so its field is a sum of products of r-modes and z-modes, each a
first-order lag of rate ``lambda_r + lambda_z`` driven by every input. The lags are written on the bank's fixed
rates (``bank.cardinal``), so a record is filtered once and any (h, K, rho c, depth) is a handful of weights.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calibration.errors import InputError
from tcdyn.conduction import operators as op
from tcdyn.conduction.dual import eigen_tridiagonal, einsum, matmul, node_weights, plain, stack
from tcdyn.conduction.rim import MESH_IV, Flux, Mesh, Point, Profile, Rim

Array = NDArray[np.float64]
INPUTS = ("power_W", "d", "b", "f", "ambient")
SPLIT_INPUTS = ("power_W", "d", "b", "f", "ambient_rim", "ambient_d_side", "ambient_f_side")


@dataclass(frozen=True)
class RimGains:
    """How the points answer the inputs: ``T_p = sum_i direct[i,p] u_i + sum_ik gains[i,p,k] bank_i[k]``.

    gains (I, P, K), direct (I, P); power_W in W into this disk, temperatures in degC; rates (K,) [1/s].
    """

    inputs: tuple[str, ...]
    points: tuple[Point, ...]
    rates: Array
    gains: Array
    direct: Array

    @property
    def static(self) -> Array:
        """Steady answer of each point to each input (I, P): exact for the scheme, whatever the bank."""
        return np.asarray(self.gains.sum(axis=2) + self.direct)

    def respond(self, banks: Sequence[Array], inputs: ArrayLike) -> Array:
        """Temperatures (N, P) from the banks (N, K) of all inputs and the inputs themselves (N, I)."""
        out = np.asarray(inputs, dtype=float) @ self.direct
        for bank, gain in zip(banks, self.gains, strict=True):
            out += bank @ gain.T
        return np.asarray(out)


@dataclass(frozen=True)
class Spectrum:
    """The rim's modes: rates lam_r (m,), lam_z (n,), vectors (nodes x modes) with scales, forcing and readings."""

    lam_r: Any
    lam_z: Any
    shape_r: Any  # (nr-1, m): nodal values of unit-norm r-modes
    shape_z: Any  # (nz, n)
    force_r: Any  # (4, m): power at R_o, temperature at R_i, everywhere, ambient at R_o
    force_z: Any  # (10, n): see ``spectrum``
    profile: Any  # (5, nz): shapes of d, b, f and of the air behind either washer
    h: Any


def terms(split: bool) -> list[tuple[int, int, int]]:
    """(input, r forcing, z forcing) of every separable source; see ``spectrum`` for the forcings' order."""
    a = (4, 5, 6) if split else (4, 4, 4)
    boundary = [(1, 1, 1), (2, 1, 2), (3, 1, 3)]
    if split:  # the boundary profile leans on the faces' ambients, each at its own half
        return [(0, 0, 0), *boundary, (a[0], 3, 5), (5, 1, 8), (6, 1, 9), (a[1], 2, 6), (a[2], 2, 7)]
    return [(0, 0, 0), *boundary, (4, 1, 4), (4, 3, 5), (4, 2, 6), (4, 2, 7)]


def spectrum(
    rim: Rim,
    h: Any,
    half_width: Any,
    profile: Profile,
    flux: Flux,
    mesh: Mesh,
    parameters: dict[str, Any] | None = None,
) -> Spectrum:
    """Modes and projections of the scheme at the surface's ``h`` [W/m2K].

    Forcings in r: power at R_o, temperature at R_i, everywhere, ambient at R_o. Forcings in z: flux, the shapes of
    d, b and f, what they leave to the air, one, face d, face f, and what they leave to the air on either side.
    ``parameters`` replaces conductivity, heat_capacity, washer or inner_radius, with derivatives.
    """
    given = parameters or {}
    if parameters is None:
        axial = _axial_cached(rim, half_width, profile, flux, mesh)
    else:
        axial = _axial(rim, half_width, profile, flux, mesh, given)
    lam_z, shape_z, force_z, basis = axial
    k = given.get("conductivity", rim.conductivity_W_mK)
    alpha = k / given.get("heat_capacity", rim.density_kg_m3 * rim.specific_heat_J_kgK)
    ri, ro = given.get("inner_radius", rim.inner_radius_m), rim.outer_radius_m
    radial = op.radial_operator(ri, ro, mesh.nr, alpha, k, h)
    lam_r, v = eigen_tridiagonal(radial.diagonal, radial.off)
    ends = v[[0, -1]] * radial.scale[[0, -1]][:, None]
    outer = op.outer_source(ri, ro, mesh.nr, alpha, k)
    force_r = stack(
        [
            ends[1] * outer / (2 * np.pi * ro),
            ends[0] * op.inner_source(ri, ro, mesh.nr, alpha),
            einsum("jm,j->m", v, radial.scale),
            ends[1] * outer * h,
        ]
    )
    return Spectrum(lam_r, lam_z, v / radial.scale[:, None], shape_z, force_r, force_z, basis, h)


def _axial(rim: Rim, half_width: Any, profile: Profile, flux: Flux, mesh: Mesh, given: dict[str, Any]) -> Any:
    """z-modes, nodal shapes, forcings (10, n) and the boundary's shapes (5, nz)."""
    n, w = mesh.nz, rim.width_m
    k = given.get("conductivity", rim.conductivity_W_mK)
    alpha = k / given.get("heat_capacity", rim.density_kg_m3 * rim.specific_heat_J_kgK)
    washer = given.get("washer", rim.washer_W_m2K)
    axial = op.axial_operator(w, n, alpha, k, washer)
    lam, u = eigen_tridiagonal(axial.diagonal, axial.off)
    shape = u / axial.scale[:, None]
    z = np.linspace(0.0, w, n)
    reading = np.stack([op.reading_weights(p / w * (n - 1), n) for p in rim.boundary_z_m])
    basis = op.profile_basis(profile, z, rim.boundary_z_m, w, shape[:, :3], reading)
    biot = washer * w / k
    # the steady slab between air at one behind the washer of face d and at zero behind that of face f
    d_side = (1 + biot) / (2 + biot) - biot / (2 + biot) * (z / w)
    rest_d, rest_f = _beyond(basis, d_side, reading), _beyond(basis, 1 - d_side, reading)
    face = op.face_source(w, n, alpha, k, washer) * np.ones(n)
    first, last = np.eye(n)[0], np.eye(n)[-1]
    sources = [
        op.flux_density(flux, half_width, w, n),
        basis[0],
        basis[1],
        basis[2],
        rest_d + rest_f,
        np.ones(n),
        face * first,
        face * last,
        rest_d,
        rest_f,
    ]
    force = einsum("zn,sz->sn", u, stack(sources) * axial.scale)
    return lam, shape, force, stack([basis[0], basis[1], basis[2], rest_d, rest_f])


def _beyond(basis: Any, shape: Any, reading: Array) -> Any:
    """What is left of ``shape`` (nz,) when the profile through its values at the junctions is taken off."""
    at = einsum("pz,z->p", reading, shape)
    return shape - (basis[0] * at[0] + basis[1] * at[1] + basis[2] * at[2])


@lru_cache(maxsize=256)
def _axial_cached(rim: Rim, half_width: float, profile: Profile, flux: Flux, mesh: Mesh) -> Any:
    return _axial(rim, half_width, profile, flux, mesh, {})


def forcing(s: Spectrum, split: bool = False) -> Any:
    """Steady amplitude (I, m, n) of every mode for a unit of every input."""
    rate = s.lam_r[:, None] + s.lam_z[None, :]
    return _by_input(split, lambda r, z: s.force_r[r][:, None] * s.force_z[z][None, :]) / rate


def _by_input(split: bool, part: Callable[[int, int], Any]) -> Any:
    """The parts of all separable sources, summed input by input and stacked."""
    rows: list[Any] = [None] * (7 if split else 5)
    for i, r, z in terms(split):
        rows[i] = part(r, z) if rows[i] is None else rows[i] + part(r, z)
    return stack(rows)


def readings(rim: Rim, points: Sequence[Point], mesh: Mesh, inner_radius: Any, shift: Any = 0.0) -> tuple[Any, Array]:
    """Weights of the points on the r nodes (P, nr) and z nodes (P, nz); ``shift`` deepens all points."""
    dr = (rim.outer_radius_m - inner_radius) / (mesh.nr - 1)
    in_r = [
        op.reading_weights((rim.outer_radius_m - depth - shift - inner_radius) / dr, mesh.nr) for depth, _ in points
    ]
    in_z = [op.reading_weights(z / rim.width_m * (mesh.nz - 1), mesh.nz) for _, z in points]
    return stack(in_r), np.stack(in_z)


def assemble(s: Spectrum, read_r: Any, read_z: Array, rates: Array, split: bool = False) -> tuple[Any, Any]:
    """(gains (I, P, K), direct (I, P)) of a spectrum read at points; duals in, duals out."""
    lam = s.lam_r[:, None] + s.lam_z[None, :]
    if plain(lam).min() < rates[0]:
        raise InputError(
            f"the rim's slowest mode {plain(lam).min():.3g} 1/s is below the bank's lowest {rates[0]:.3g}",
            remedy="give node_rates a smaller slowest_per_s",
        )
    at_r, at_z = matmul(read_r[:, 1:], s.shape_r), matmul(read_z, s.shape_z)
    m, n = np.nonzero(plain(lam) < rates[-1])
    force_r, force_z, rate = s.force_r[:, m], s.force_z[:, n], lam[m, n]
    slow = _by_input(split, lambda r, z: force_r[r] * force_z[z])
    slow = slow[:, None, :] * (at_r[:, m] * at_z[:, n] / rate)[None]
    gains = matmul(slow, node_weights(rates, rate))
    # what the modes beyond the bank add to the steady answer belongs to its fastest lag
    steady = matmul(at_r[None] * s.force_r[:, None, :], 1 / lam) * at_z[None]
    whole = _by_input(split, lambda r, z: matmul(steady[r], s.force_z[z]))
    gains = gains + (whole - einsum("ipx->ip", slow))[:, :, None] * np.eye(len(rates))[-1]
    shapes = boundary_shapes(s, split, read_z)
    return gains, read_r[:, 0] * shapes


def boundary_shapes(s: Spectrum, split: bool, read_z: Array) -> Any:
    """Boundary temperature (I, P) at the points' z for a unit of every input."""
    at = einsum("sz,pz->sp", s.profile, read_z)
    zero = 0 * at[0]
    tail = [zero, at[3], at[4]] if split else [at[3] + at[4]]
    return stack([zero, at[0], at[1], at[2], *tail])


def rim_gains(
    rim: Rim,
    h_W_m2K: float,
    points: Sequence[Point],
    half_width_m: float,
    rates: Array,
    profile: Profile = "modal",
    flux: Flux = "hertz",
    mesh: Mesh = MESH_IV,
    split_ambient: bool = False,
) -> RimGains:
    """The rim's answer at ``points`` (depth, z) [m] to power, d, b, f and ambient, on the lags of ``rates``.

    Equation: (3.28) with (3.31)-(3.34) and washers, in the scheme (3.30) on ``mesh``. h_W_m2K >= 0 is the film
    coefficient of the running surface, half_width_m the contact's half-width b, profile the shape along r = R_i.
    ``split_ambient`` gives seven inputs, with the air at the running surface and behind each washer apart.
    Raises InputError for points outside the rim or a rim slower than the bank.

    >>> from calibration.rig import load_rig
    >>> from tcdyn.conduction.bank import node_rates
    >>> from tcdyn.conduction.rim import points_of
    >>> setup = load_rig().disk_setup("fast")
    >>> g = rim_gains(Rim.from_setup(setup), 700.0, points_of(setup, "ace"), 1.62e-3, node_rates(1 / 75))
    >>> g.gains.shape, g.static[1:].sum(axis=0).round(9)   # a rim at one temperature stays there
    ((5, 3, 40), array([1., 1., 1.]))
    """
    if not h_W_m2K >= 0:
        raise InputError(f"rim_gains: h_W_m2K must not be negative; got {h_W_m2K}")
    s = spectrum(rim, h_W_m2K, half_width_m, profile, flux, mesh)
    read_r, read_z = _readings_cached(rim, tuple(points), mesh)
    gains, direct = assemble(s, read_r, read_z, rates, split_ambient)
    return RimGains(SPLIT_INPUTS if split_ambient else INPUTS, tuple(points), rates, gains, direct)


@lru_cache(maxsize=256)
def _readings_cached(rim: Rim, points: tuple[Point, ...], mesh: Mesh) -> tuple[Array, Array]:
    return readings(rim, points, mesh, rim.inner_radius_m)


def rim_gains_batch(rim: Rim, h_W_m2K: ArrayLike, *args: Any, **options: Any) -> list[RimGains]:
    """``rim_gains`` for several h; what does not depend on h is computed once."""
    return [rim_gains(rim, float(h), *args, **options) for h in np.atleast_1d(np.asarray(h_W_m2K, dtype=float))]
