"""The rim as a small linear filter: weights of the lag bank for every input and point.

The thesis's difference scheme, (3.30) in r with the outer node (3.31) and in z with the washers (section 3.4.4.3), is
``dT/dt = -(A_r x I + I x A_z) T + forcing``: its field is a sum of products of r-modes and z-modes, each a
first-order lag of rate ``lambda_r + lambda_z`` driven by every input. The lags are written on the bank's fixed
rates (``rim.cardinal``), so a record is filtered once and any (h, K, rho c, depth) is a handful of weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import make_interp_spline
from scipy.linalg import eigh_tridiagonal

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.heat.flux import TrackFlux
from tcdyn.heat.rim import MESH_IV, Flux, Mesh, Point, Profile, Rim, told_by, unscaled_cardinal


def inputs_of(k: int, split: bool = False) -> tuple[str, ...]:
    """Names of what drives a rim with ``k`` junctions in its inner row: power, these, and the air.

    >>> inputs_of(3)
    ('power_W', 'inner 1', 'inner 2', 'inner 3', 'ambient')
    """
    air = ("ambient_rim", "ambient_low_side", "ambient_high_side") if split else ("ambient",)
    return ("power_W", *(f"inner {i + 1}" for i in range(k)), *air)


def sources_of(k: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Every separable source of heat is a forcing in r times one in z: rows of ``Spectrum.force_r``, and whose input of
    ``inputs_of(k, True)`` each is. Sources 1 to k + 2 are the profile's: each shape along R_i leans on a junction of
    the inner row or on a face's air."""
    own = np.arange(1, k + 1)
    return np.concatenate([[0], 0 * own + 1, [1, 1, 3, 2, 2]]), np.concatenate(
        [[0], own, k + np.array([2, 3, 1, 2, 3])]
    )


@dataclass(frozen=True)
class RimGains:
    """How the points answer the inputs: ``T_p = sum_i direct[i,p] u_i + sum_ik gains[i,p,k] bank_i[k]``.

    gains (I, P, K), direct (I, P); static (I, P) their sum, the steady answer, exact for the scheme whatever the bank;
    power_W in W into this disk, temperatures in degC; rates (K,) [1/s].
    """

    inputs: tuple[str, ...]
    points: tuple[Point, ...]
    rates: Array
    gains: Array
    direct: Array
    static: Array


@dataclass(frozen=True)
class Spectrum:
    """The rim's modes: rates lam_r (m,), lam_z (n,) [1/s], their nodal values, and what drives them.

    shape_r (nr-1, m) and shape_z (nz, n) are nodal values of modes of unit norm in the scheme's inner product. rates
    (m, n) of every mode, lam_r + lam_z. force_r (4, m): power at R_o, temperature at R_i, everywhere, ambient at R_o.
    force_z (S, n), by source: flux, the shapes of ``profile``, one, both faces. profile (k + 2, nz): temperature along
    R_i for a unit of each of the inner row and of the air behind either washer; boundary (I, nz): the same for a unit
    of every input. collect (I, S): which sources belong to which input; source_r (S,): rows of force_r."""

    lam_r: Array
    lam_z: Array
    rates: Array
    shape_r: Array
    shape_z: Array
    force_r: Array
    force_z: Array
    profile: Array
    boundary: Array
    collect: Array
    source_r: NDArray[np.int64]


def outer_source(rim: Rim, n: int) -> float:
    """Heating rate of the outermost of ``n`` nodes by a unit flux, alpha (R_o + dr/2) 2/(K R_o dr) [K/s per W/m2]."""
    ro = rim.outer_radius_m
    dr = rim.thickness_m / (n - 1)
    return rim.diffusivity_m2_s * (ro + dr / 2) * 2 / (rim.conductivity_W_mK * ro * dr)


def surface_weight(rim: Rim, n: int) -> float:
    """Weight of the outermost of ``n`` nodes in the scheme's inner product, (R_o - dr/2)/2 [m]."""
    return (rim.outer_radius_m - rim.thickness_m / (n - 1) / 2) / 2


def _modes(diagonal: Array, coupling: Array, weight: Array) -> tuple[Array, Array, Array]:
    """Rates ascending, unit vectors (columns) and root weights of A, made symmetric: D^1/2 A D^-1/2, D = weight."""
    off = -coupling / np.sqrt(weight[1:] * weight[:-1])
    lam, v = eigh_tridiagonal(diagonal, off, lapack_driver="stemr")
    return lam, v, np.sqrt(weight)


def spectrum(
    rim: Rim,
    h: float,
    half_width: float,
    profile: Profile,
    flux: Flux,
    mesh: Mesh,
    split: bool = False,
) -> Spectrum:
    """Modes and projections of the scheme at the surface's ``h`` [W/m2K], with the contact's ``half_width`` [m].

    Two inputs more where the air has three temperatures (``split``).
    """
    n = mesh.nr
    ri = rim.inner_radius_m
    ro = rim.outer_radius_m
    alpha = rim.diffusivity_m2_s
    dr = rim.thickness_m / (n - 1)
    r = ri + dr * np.arange(1, n)  # node 0 carries the imposed profile
    half = r - dr / 2
    weight = np.append(r[:-1], surface_weight(rim, n))
    diagonal = np.full(n - 1, 2 * alpha / dr**2)
    outer = outer_source(rim, n)
    diagonal[-1] += outer * h
    lam_r, v, scale = _modes(diagonal, np.asarray(alpha / dr**2 * half[1:]), weight)
    first = v[0] * scale[0]
    last = v[-1] * scale[-1]
    inner = (
        alpha * half[0] / (r[0] * dr**2)
    )  # heating rate of node 1 by a unit temperature of node 0
    force_r = np.stack(
        [last * outer / (2 * np.pi * ro), first * inner, scale @ v, last * outer * h]
    )
    lam_z, shape_z, force_z, basis = _axial(rim, half_width, profile, flux, mesh)
    k = len(rim.boundary_z_m)
    source_r, whose = sources_of(k)
    whose = whose if split else np.minimum(whose, k + 1)
    collect: Array = np.asarray(np.arange(len(inputs_of(k, split)))[:, None] == whose, dtype=float)
    return Spectrum(
        lam_r,
        lam_z,
        lam_r[:, None] + lam_z,
        v / scale[:, None],
        shape_z,
        force_r,
        force_z,
        basis,
        collect[:, 1 : k + 3] @ basis,
        collect,
        source_r,
    )


@lru_cache(maxsize=256)
def _axial(
    rim: Rim, half_width: float, profile: Profile, flux: Flux, mesh: Mesh
) -> tuple[Array, Array, Array, Array]:
    """z-modes, nodal shapes (nz, n), forcings (S, n) and the boundary's shapes (k + 2, nz): nothing here knows h."""
    n = mesh.nz
    w = rim.width_m
    alpha = rim.diffusivity_m2_s
    k = rim.conductivity_W_mK
    dz = w / (n - 1)
    ends = np.zeros(n)
    ends[[0, -1]] = 1.0
    face = (
        2 * alpha * rim.washer_W_m2K / (k * dz)
    )  # heating rate of a face node by the air behind its washer
    lam, v, scale = _modes(
        2 * alpha / dz**2 + face * ends, np.full(n - 1, alpha / dz**2), 1 - ends / 2
    )
    shape = v / scale[:, None]
    z = np.linspace(0.0, w, n)
    reading = reading_weights(np.array(rim.boundary_z_m) / dz, n)
    basis = profile_basis(profile, z, rim.boundary_z_m, w, shape[:, :3], reading)
    biot = rim.washer_W_m2K * w / k
    # the steady slab between air at one behind one washer and at zero behind the other
    d_side = (1 + biot) / (2 + biot) - biot / (2 + biot) * (z / w)
    air = np.stack([d_side, 1 - d_side])
    basis = np.concatenate(
        [basis, air - air @ reading.T @ basis]
    )  # less the profile through its own readings
    eye = np.eye(n)
    sources = np.vstack(
        [flux_density(flux, half_width, w, n), basis, np.ones(n), face * eye[0], face * eye[-1]]
    )
    return lam, shape, (sources * scale) @ v, basis


def flux_density(flux: Flux, half_width: float, width: float, n: int) -> Array:
    """Mean over each node's cell of the unit-power flux density across the track (n,) [1/m]; it sums to 1/dz.

    Hertz (3.32): 3/(4b) (1 - (z'/b)^2) for |z'| <= b, z' from the centre plane; uniform: 1/(2b); a stated profile; or
    the user's own shape of z', scaled to unit power. Each cell gets its exact integral, so no heat is lost to
    the mesh. The half cells at the faces count half.
    """
    edges = np.clip((np.arange(n + 1) - 0.5) * (width / (n - 1)), 0.0, width) - width / 2
    cells = np.diff(edges)
    if isinstance(flux, TrackFlux):
        return flux.shares(edges) / cells
    if callable(flux):
        x, w = np.polynomial.legendre.leggauss(12)
        at = edges[:-1, None] + cells[:, None] * (x + 1) / 2
        heat = np.asarray(flux(at), dtype=float) @ w / 2 * cells
        return np.asarray(heat / heat.sum() / cells)
    if not 0 < half_width <= width / 2 + 1e-12:
        raise InputError(
            f"the contact's half-width {half_width} m must lie between 0 and half the width {width / 2} m"
        )
    s = np.clip(edges / half_width, -1.0, 1.0)
    total = (s - s**3 / 3) * 0.75 if flux == "hertz" else s * 0.5
    return np.asarray(np.diff(total) / cells)


def profile_basis(
    kind: Profile, z: Array, at: Sequence[float], width: float, lowest: Array, reading: Array
) -> Array:
    """Shapes (k, nz) along r = R_i of a unit at each junction ``at`` z of the inner row, none at the others [m].

    Three places tell three shapes, of more they are fitted by least squares; fewer tell as many of the modal ones.
    "quadratic" (3.34); "quartic" (3.33) with zero slope at both faces; "modal": the three lowest eigenfunctions
    of the slab with its washers, ``lowest`` (nz, 3), read at the junctions through ``reading`` (k, nz).
    """

    def shapes(t: Array) -> Array:
        if kind == "quadratic":
            return np.asarray(np.vander(t, 3, increasing=True), dtype=float)
        # zero slope at 0 and 1 leaves three of the quartic's five
        return np.stack([np.ones_like(t), t**2 * (3 - 2 * t), t**2 * (1 - t) ** 2], axis=1)

    if kind not in ("modal", "quadratic", "quartic"):
        raise InputError(f"profile {kind!r} is unknown", expected="quadratic, quartic or modal")
    free = lowest
    seen = reading @ lowest
    told = list(told_by(tuple(at), width))
    if kind != "modal" and len(told) == 3:
        free = shapes(z / width)
        seen = shapes(np.asarray(at) / width)
    free = free[:, told]
    seen = seen[:, told]
    square = seen.shape[0] == seen.shape[1]
    return np.asarray((free @ (np.linalg.inv(seen) if square else np.linalg.pinv(seen))).T)


@lru_cache(maxsize=16)
def _cardinal_splines(n: int) -> Any:
    """Quintic splines (n,) through ``n`` nodes, one at their own node and zero at the others."""
    return make_interp_spline(np.arange(n), np.eye(n), k=5)


def reading_weights(position: ArrayLike, n: int) -> Array:
    """Weights (P, n) that read a nodal field at ``position`` (P,), counted in mesh steps from node 0.

    A quintic spline through all nodes: exact there, and smooth in the position, so depths have clean derivatives.
    """
    at = np.asarray(position, dtype=float)
    outside = (at < -1e-9) | (at > n - 1 + 1e-9)
    if outside.any():
        raise InputError(
            f"a point lies outside the rim (at {at[outside][0]:.2f} of {n - 1} mesh steps)"
        )
    return np.asarray(_cardinal_splines(n)(at))


@lru_cache(maxsize=256)
def readings(rim: Rim, points: tuple[Point, ...], mesh: Mesh) -> tuple[Array, Array]:
    """Weights of the points on the r nodes (P, nr) and z nodes (P, nz)."""
    depth, z = np.array(points, dtype=float).T
    in_r = (rim.thickness_m - depth) / (rim.thickness_m / (mesh.nr - 1))
    in_z = z / rim.width_m * (mesh.nz - 1)
    return reading_weights(in_r, mesh.nr), reading_weights(in_z, mesh.nz)


def forcing(s: Spectrum) -> Array:
    """Steady amplitude (I, m, n) of every mode for a unit of every input."""
    sources = s.force_r[s.source_r][:, :, None] * s.force_z[:, None, :]
    return np.asarray(np.tensordot(s.collect, sources, axes=1) / s.rates)


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
    """The rim's answer at ``points`` (depth, z) [m] to power, inner row and ambient, on the lags of ``rates``.

    Equation: (3.28) with (3.31)-(3.34) and washers, in the scheme (3.30) on ``mesh``. h_W_m2K >= 0 is the film
    coefficient of the running surface, half_width_m the contact's half-width b, profile the shape along r = R_i.
    ``split_ambient`` gives two inputs more, with the air at the running surface and behind each washer apart.
    Raises InputError for points outside the rim or a rim slower than the bank.

    >>> from tcdyn.rig.rigfile import load_rig
    >>> from tcdyn.heat.rim import node_rates
    >>> from tcdyn.heat.rim import points_of
    >>> setup = load_rig().disk_setup("fast")
    >>> g = rim_gains(Rim.from_setup(setup), 700.0, points_of(setup, "ace"), 1.62e-3, node_rates(1 / 75))
    >>> g.gains.shape, g.static[1:].sum(axis=0).round(9)   # a rim at one temperature stays there
    ((5, 3, 40), array([1., 1., 1.]))
    """
    if not h_W_m2K >= 0:
        raise InputError(f"rim_gains: h_W_m2K must not be negative; got {h_W_m2K}")
    s, within, driven, weights = _driven(
        rim, h_W_m2K, half_width_m, rates.tobytes(), profile, flux, mesh, split_ambient
    )
    read_r, read_z = readings(rim, tuple(points), mesh)
    at_r = read_r[:, 1:] @ s.shape_r
    at_z = read_z @ s.shape_z
    seen = (at_r[:, :, None] * at_z[:, None, :]).reshape(len(at_r), -1)[:, within]
    gains = np.asarray(np.tensordot(driven[:, None] * seen, weights, 1), dtype=float)
    # what the modes beyond the bank add to the steady answer belongs to its fastest lag
    whole = (at_r * s.force_r[:, None, :]) @ (1 / s.rates) * at_z
    gains[:, :, -1] += s.collect @ (whole[s.source_r] * s.force_z[:, None, :]).sum(
        axis=2
    ) - gains.sum(axis=2)
    direct = read_r[:, 0] * (s.boundary @ read_z.T)
    inputs = inputs_of(len(rim.boundary_z_m), split_ambient)
    return RimGains(inputs, tuple(points), rates, gains, direct, gains.sum(axis=2) + direct)


@lru_cache(maxsize=16)
def _driven(
    rim: Rim,
    h: float,
    half_width: float,
    rates: bytes,
    profile: Profile,
    flux: Flux,
    mesh: Mesh,
    split: bool,
) -> tuple[Spectrum, Any, Array, Array]:
    """What all points have in common: the modes, which M of them the bank holds, their steady amplitudes (I, M) for a
    unit of every input, and their ``cardinal`` weights (M, K), the amplitudes divided by these weights' sums."""
    s = spectrum(rim, h, half_width, profile, flux, mesh, split)
    nodes = np.frombuffer(rates)
    if s.rates.min() < nodes[0]:
        raise InputError(
            f"the rim's slowest mode {s.rates.min():.3g} 1/s is below the bank's lowest {nodes[0]:.3g}",
            remedy="give node_rates a smaller slowest_per_s",
        )
    within = slice(None) if s.rates.max() < nodes[-1] else (s.rates < nodes[-1]).ravel()
    weights, total = unscaled_cardinal(nodes, np.log(s.rates.ravel()[within]))
    return s, within, forcing(s).reshape(len(s.collect), -1)[:, within] / total, weights
