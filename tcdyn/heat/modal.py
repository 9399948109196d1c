"""Modal solution of the rim: the weights of the lag basis for every input and every point.

The thesis's difference scheme, (3.30) in r with the outer node (3.31) and in z with the washers
(section 3.4.4.3), is ``dT/dt = -(A_r x I + I x A_z) T + forcing``. Its field is a sum of products
of r-modes and z-modes. Each product is a first-order lag of rate ``lambda_r + lambda_z`` driven by
every input. The lags are interpolated from the fixed rates of the basis (``rim.cardinal``). So a
record is filtered once, and any (h, K, rho c, depth) needs only weights of the filtered record.

Used by ``engine`` and ``nonuniform`` of this package, ``tcdyn.design.plans`` and, through
``nonuniform``, the fits of ``tcdyn.partition``. Guarded by ``tests/heat/test_rim_engine.py`` (same
scheme as ``tcdyn.heat.reference``), ``tests/heat/test_rim_convergence.py`` (closed forms, second
order) and ``tests/heat/test_rim_profiles.py``.
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
from tcdyn.heat.rim import (
    MESH_IV,
    Flux,
    Mesh,
    Point,
    Profile,
    Rim,
    determined_shapes,
    unscaled_cardinal,
)


def inputs_of(k: int, split: bool = False) -> tuple[str, ...]:
    """Names of the inputs of a rim: power, the ``k`` junctions of the inner row, and the air.

    Parameters
    ----------
    k
        Number of junctions of the inner row.
    split
        Whether the air has three temperatures: at the running surface, behind the washer at z = 0,
        and behind the washer at z = w.

    Returns
    -------
    The names, in the order of the rows of ``RimGains.gains``.

    Notes
    -----
    The order is that of the indices in ``sources_of`` and of
    ``tcdyn.heat.engine.RimInputs.inputs``; change all three together.
    ``tests/heat/test_rim_engine.py`` fails otherwise.

    Examples
    --------
    >>> inputs_of(3)
    ('power_W', 'inner 1', 'inner 2', 'inner 3', 'ambient')
    """
    air = ("ambient_rim", "ambient_low_side", "ambient_high_side") if split else ("ambient",)
    return ("power_W", *(f"inner {i + 1}" for i in range(k)), *air)


def sources_of(k: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The separable sources of heat, each a forcing in r times one in z.

    Source 0 is the flux. Sources 1 to k + 2 belong to the profile along R_i, whose shapes depend on
    a junction of the inner row or on the air at a face. Then follow the air at the running surface
    and at the two faces.

    Parameters
    ----------
    k
        Number of junctions of the inner row.

    Returns
    -------
    row
        For each source the row of ``Spectrum.force_r``, (k + 6,).
    input_index
        For each source the index of its input in ``inputs_of(k, True)``, (k + 6,).

    Notes
    -----
    The order of the sources must be that of the rows of ``Spectrum.force_z``, which
    ``_axial_modes`` stacks.
    """
    junctions = np.arange(1, k + 1)
    row = np.concatenate([[0], np.ones(k, dtype=np.int64), [1, 1, 3, 2, 2]])
    input_index = np.concatenate([[0], junctions, k + np.array([2, 3, 1, 2, 3])])
    return row, input_index


@dataclass(frozen=True)
class RimGains:
    """Response of the points: ``T_p = sum_i direct[i,p] u_i + sum_ik gains[i,p,k] bank_i[k]``.

    Parameters
    ----------
    inputs
        Names of the I inputs: power_W [W] into this disk, and temperatures [degC].
    points
        The P points, (depth, z) [m].
    rates
        Rates of the basis of lags, (K,) [1/s].
    gains
        Weights of the lags, (I, P, K) [K/W for the power, else without unit].
    direct
        Weights of the inputs themselves, (I, P): the part of the response that has no lag.
    static
        Sum of ``gains`` over the lags plus ``direct``, (I, P): the steady response, exact for the
        scheme whatever the basis.
    """

    inputs: tuple[str, ...]
    points: tuple[Point, ...]
    rates: Array
    gains: Array
    direct: Array
    static: Array


@dataclass(frozen=True)
class Spectrum:
    """Modes of the rim, and their forcing.

    Parameters
    ----------
    lam_r, lam_z
        Rates in r, (m,), and in z, (n,) [1/s].
    rates
        Rate of every mode, lam_r + lam_z, (m, n).
    shape_r, shape_z
        Nodal values of the modes, (nr-1, m) and (nz, n), of unit norm in the inner product of the
        scheme.
    force_r
        Forcing in r, (4, m): power at R_o, temperature at R_i, everywhere, ambient at R_o.
    force_z
        Forcing in z by source, (S, n): flux, the shapes of ``profile``, one, both faces.
    profile
        Temperature along R_i for a unit of each junction of the inner row and of the air behind
        either washer, (k + 2, nz).
    boundary
        The same for a unit of every input, (I, nz).
    collect
        Which sources belong to which input, (I, S).
    source_r
        Row of ``force_r`` of each source, (S,).
    """

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
    """Heating rate of the outermost of ``n`` nodes by a unit flux [K/s per W/m2].

    Parameters
    ----------
    rim
        Geometry and material.
    n
        Number of nodes in r, R_i and R_o included.

    Notes
    -----
    alpha (R_o + dr/2) 2/(K R_o dr), equation (3.31). ``tcdyn.heat.reference.scheme`` writes the
    same coefficient independently; ``tests/heat/test_rim_convergence.py`` fails for another one.
    """
    ro = rim.outer_radius_m
    dr = rim.thickness_m / (n - 1)
    return rim.diffusivity_m2_s * (ro + dr / 2) * 2 / (rim.conductivity_W_mK * ro * dr)


def surface_weight(rim: Rim, n: int) -> float:
    """Weight of the outermost of ``n`` nodes in the inner product, (R_o - dr/2)/2 [m].

    Parameters
    ----------
    rim
        Geometry.
    n
        Number of nodes in r, R_i and R_o included.

    Notes
    -----
    The weight that makes the scheme in r symmetric, together with ``outer_source``; the inner nodes
    have weight r.
    """
    return (rim.outer_radius_m - rim.thickness_m / (n - 1) / 2) / 2


def _modes(diagonal: Array, coupling: Array, weight: Array) -> tuple[Array, Array, Array]:
    """Modes of a tridiagonal matrix A that ``weight`` makes symmetric.

    Parameters
    ----------
    diagonal
        Diagonal of A, (n,) [1/s].
    coupling
        Weight times minus the off-diagonal entry of A, (n - 1,).
    weight
        Weights D of the inner product in which A is symmetric, (n,).

    Returns
    -------
    rates
        Eigenvalues, ascending, (n,) [1/s].
    vectors
        Unit eigenvectors of D^1/2 A D^-1/2, (n, n), one a column.
    scale
        Square roots of the weights, (n,). ``vectors / scale[:, None]`` are the nodal values of the
        modes.
    """
    off = -coupling / np.sqrt(weight[1:] * weight[:-1])
    lam, vectors = eigh_tridiagonal(diagonal, off, lapack_driver="stemr")
    return lam, vectors, np.sqrt(weight)


def spectrum(
    rim: Rim,
    h: float,
    half_width: float,
    profile: Profile,
    flux: Flux,
    mesh: Mesh,
    split: bool = False,
) -> Spectrum:
    """Modes and forcing of the difference scheme of the rim.

    Parameters
    ----------
    rim
        Geometry, material and inner row of the disk.
    h
        Heat-transfer coefficient of the running surface [W/m2K].
    half_width
        Half-width of the contact [m].
    profile
        Shape of the temperature along r = R_i, see ``profile_basis``.
    flux
        Profile of the heat flux across the track, see ``flux_density``.
    mesh
        Nodes in r and z.
    split
        Whether the air has three temperatures, which are two more inputs.

    Returns
    -------
    The modes and their forcing; the arrays are described at ``Spectrum``.

    Notes
    -----
    Scheme (3.30) in r with the outer node (3.31), times the z-modes of ``_axial_modes``. Only the
    r-modes depend on h. The scheme may be replaced by another one that separates into r and z: then
    also ``tcdyn.heat.nonuniform.rim_gains_nonuniform``, which uses ``outer_source`` and
    ``surface_weight``. The comparison with ``tcdyn.heat.reference.scheme`` in
    ``tests/heat/test_rim_engine.py`` holds for this scheme only;
    ``tests/heat/test_rim_convergence.py`` holds for any scheme of second order.
    """
    n = mesh.nr
    ri = rim.inner_radius_m
    ro = rim.outer_radius_m
    alpha = rim.diffusivity_m2_s
    dr = rim.thickness_m / (n - 1)
    r = ri + dr * np.arange(1, n)  # node 0 has the imposed profile
    half = r - dr / 2
    weight = np.append(r[:-1], surface_weight(rim, n))
    diagonal = np.full(n - 1, 2 * alpha / dr**2)
    outer = outer_source(rim, n)
    diagonal[-1] += outer * h
    lam_r, vectors, scale = _modes(diagonal, np.asarray(alpha / dr**2 * half[1:]), weight)
    first = vectors[0] * scale[0]
    last = vectors[-1] * scale[-1]
    # heating rate of node 1 by a unit temperature of node 0
    inner = alpha * half[0] / (r[0] * dr**2)
    force_r = np.stack(
        [last * outer / (2 * np.pi * ro), first * inner, scale @ vectors, last * outer * h]
    )
    lam_z, shape_z, force_z, profile_shapes = _axial_modes(rim, half_width, profile, flux, mesh)
    k = len(rim.boundary_z_m)
    source_r, input_index = sources_of(k)
    if not split:
        input_index = np.minimum(input_index, k + 1)
    n_inputs = len(inputs_of(k, split))
    collect: Array = np.asarray(np.arange(n_inputs)[:, None] == input_index, dtype=float)
    return Spectrum(
        lam_r=lam_r,
        lam_z=lam_z,
        rates=lam_r[:, None] + lam_z,
        shape_r=vectors / scale[:, None],
        shape_z=shape_z,
        force_r=force_r,
        force_z=force_z,
        profile=profile_shapes,
        boundary=collect[:, 1 : k + 3] @ profile_shapes,
        collect=collect,
        source_r=source_r,
    )


@lru_cache(maxsize=256)
def _axial_modes(
    rim: Rim, half_width: float, profile: Profile, flux: Flux, mesh: Mesh
) -> tuple[Array, Array, Array, Array]:
    """Modes in z and their forcing; these do not depend on h.

    Parameters
    ----------
    rim
        Geometry, material and inner row of the disk.
    half_width
        Half-width of the contact [m].
    profile
        Shape of the temperature along r = R_i.
    flux
        Profile of the heat flux across the track.
    mesh
        Nodes in r and z.

    Returns
    -------
    lam
        Rates of the z-modes, (n,) [1/s].
    shape
        Nodal values of the modes, (nz, n).
    force
        Forcing of each mode by each source, (S, n), in the order of ``sources_of``.
    profile_shapes
        Temperature along r = R_i for a unit of each junction of the inner row and of the air behind
        either washer, (k + 2, nz).

    Notes
    -----
    The steady slab between its washers is the part of the profile that is due to the air. Its
    readings at the junctions are subtracted, because the junctions are inputs of their own. So the
    profile passes through the readings whatever the air is. Guarded by
    ``tests/heat/test_rim_profiles.py``.
    """
    n = mesh.nz
    w = rim.width_m
    alpha = rim.diffusivity_m2_s
    k = rim.conductivity_W_mK
    dz = w / (n - 1)
    is_face = np.zeros(n)
    is_face[[0, -1]] = 1.0
    # heating rate of a face node by the air behind its washer
    face = 2 * alpha * rim.washer_W_m2K / (k * dz)
    diagonal = 2 * alpha / dz**2 + face * is_face
    lam, vectors, scale = _modes(diagonal, np.full(n - 1, alpha / dz**2), 1 - is_face / 2)
    shape = vectors / scale[:, None]
    z = np.linspace(0.0, w, n)
    reading = reading_weights(np.array(rim.boundary_z_m) / dz, n)
    junction_shapes = profile_basis(profile, z, rim.boundary_z_m, w, shape[:, :3], reading)
    biot = rim.washer_W_m2K * w / k
    # steady slab between air at one behind the first washer and at zero behind the second
    slab = (1 + biot) / (2 + biot) - biot / (2 + biot) * (z / w)
    air = np.stack([slab, 1 - slab])
    # minus the profile through the readings of the slab, which the junctions contain already
    air_shapes = air - air @ reading.T @ junction_shapes
    shapes = np.concatenate([junction_shapes, air_shapes])
    eye = np.eye(n)
    sources = np.vstack(
        [flux_density(flux, half_width, w, n), shapes, np.ones(n), face * eye[0], face * eye[-1]]
    )
    return lam, shape, (sources * scale) @ vectors, shapes


def flux_density(flux: Flux, half_width: float, width: float, n: int) -> Array:
    """Mean of the flux density of unit power over the cell of each node [1/m].

    Each cell gets its exact integral, so that no heat is lost to the mesh. The half cells at the
    faces count half.

    Parameters
    ----------
    flux
        Hertz (3.32): 3/(4b) (1 - (z'/b)^2) for |z'| <= b, z' from the centre plane; uniform:
        1/(2b); a profile of the rig file; or any function of z', which is scaled to unit power.
    half_width
        Half-width b of the contact [m]; without effect for a function.
    width
        Width of the running surface [m].
    n
        Number of nodes.

    Returns
    -------
    Density, (n,) [1/m]; its sum, with half weight for the faces, is 1/dz.

    Raises
    ------
    InputError
        Half-width outside 0 to half the width, or a profile that does not lie on the running
        surface.

    Notes
    -----
    The integral of a function over a cell is a Gauss rule of 12 points; a profile with a jump
    inside a cell is less exact. The number of points may be raised freely. Guarded by
    ``tests/heat/test_rim_fields.py`` (no heat is lost) and ``tests/heat/test_rim_flux.py``.
    """
    edges = np.clip((np.arange(n + 1) - 0.5) * (width / (n - 1)), 0.0, width) - width / 2
    cells = np.diff(edges)
    if isinstance(flux, TrackFlux):
        return flux.shares(edges) / cells
    if callable(flux):
        x, w = np.polynomial.legendre.leggauss(12)
        z = edges[:-1, None] + cells[:, None] * (x + 1) / 2
        heat = np.asarray(flux(z), dtype=float) @ w / 2 * cells
        return heat / heat.sum() / cells
    if not 0 < half_width <= width / 2 + 1e-12:
        raise InputError(
            f"the contact's half-width {half_width} m must lie between 0 and half the width "
            f"{width / 2} m"
        )
    s = np.clip(edges / half_width, -1.0, 1.0)
    integral = (s - s**3 / 3) * 0.75 if flux == "hertz" else s * 0.5
    return np.diff(integral) / cells


def profile_basis(
    kind: Profile, z: Array, at: Sequence[float], width: float, lowest: Array, reading: Array
) -> Array:
    """Shapes along r = R_i: one at a junction of the inner row, zero at the others.

    Three positions determine three shapes; with more junctions the shapes are fitted by least
    squares; with fewer positions some of the modal shapes are used.

    Parameters
    ----------
    kind
        "quadratic" (3.34); "quartic" (3.33) with zero slope at both faces; "modal": the three
        lowest eigenfunctions of the slab with its washers.
    z
        Axial positions of the nodes, (nz,) [m].
    at
        Axial positions of the junctions, (k,) [m].
    width
        Width of the rim [m].
    lowest
        The three lowest eigenfunctions, (nz, 3).
    reading
        Weights that read a nodal field at the junctions, (k, nz).

    Returns
    -------
    Shapes, (k, nz).

    Raises
    ------
    InputError
        ``kind`` is unknown.

    Notes
    -----
    Which shapes the positions determine is decided by ``tcdyn.heat.rim.determined_shapes``. With
    fewer than three shapes, "quadratic" and "quartic" also use the modal shapes. A further kind
    must return three columns from ``polynomials``, and its name must be added to
    ``tcdyn.heat.rim.Profile``. Guarded by ``tests/heat/test_rim_profiles.py`` and
    ``tests/partition/test_any_junctions.py``.
    """

    def polynomials(t: Array) -> Array:
        """Three polynomials of the relative position ``t``, (len(t), 3)."""
        if kind == "quadratic":
            return np.asarray(np.vander(t, 3, increasing=True), dtype=float)
        # zero slope at 0 and 1 leaves three of the five coefficients of the quartic
        return np.stack([np.ones_like(t), t**2 * (3 - 2 * t), t**2 * (1 - t) ** 2], axis=1)

    if kind not in ("modal", "quadratic", "quartic"):
        raise InputError(f"profile {kind!r} is unknown", expected="quadratic, quartic or modal")
    determined = list(determined_shapes(tuple(at), width))
    nodal = lowest
    at_junctions = reading @ lowest
    if kind != "modal" and len(determined) == 3:
        nodal = polynomials(z / width)
        at_junctions = polynomials(np.asarray(at) / width)
    nodal = nodal[:, determined]
    at_junctions = at_junctions[:, determined]
    is_square = at_junctions.shape[0] == at_junctions.shape[1]
    inverse = np.linalg.inv(at_junctions) if is_square else np.linalg.pinv(at_junctions)
    return (nodal @ inverse).T


@lru_cache(maxsize=16)
def _cardinal_splines(n: int) -> Any:
    """Quintic splines through ``n`` nodes, each one at its node and zero at the others."""
    return make_interp_spline(np.arange(n), np.eye(n), k=5)


def reading_weights(position: ArrayLike, n: int) -> Array:
    """Weights that interpolate a nodal field at positions between the nodes.

    A quintic spline through all nodes: exact there, and smooth in the position, so that derivatives
    with respect to depth are smooth.

    Parameters
    ----------
    position
        Positions, (P,) [mesh steps from node 0].
    n
        Number of nodes.

    Returns
    -------
    Weights, (P, n).

    Raises
    ------
    InputError
        A position lies outside the nodes.

    Notes
    -----
    The degree of the spline may be changed in ``_cardinal_splines``. A lower degree has a larger
    error of interpolation, and a degree of one has steps in the derivative with respect to depth.
    At least six nodes are needed for degree five; ``tcdyn.heat.rim.MIN_NODES`` is seven.
    """
    steps = np.asarray(position, dtype=float)
    is_outside = (steps < -1e-9) | (steps > n - 1 + 1e-9)
    if is_outside.any():
        raise InputError(
            f"a point lies outside the rim (at {steps[is_outside][0]:.2f} of {n - 1} mesh steps)"
        )
    return _cardinal_splines(n)(steps)


@lru_cache(maxsize=256)
def readings(rim: Rim, points: tuple[Point, ...], mesh: Mesh) -> tuple[Array, Array]:
    """Interpolation weights of points on the nodes of the mesh; cached.

    Parameters
    ----------
    rim
        Geometry.
    points
        (depth, z) of the P points [m].
    mesh
        Nodes in r and z.

    Returns
    -------
    read_r
        Weights on the r nodes, (P, nr); node 0 is r = R_i.
    read_z
        Weights on the z nodes, (P, nz).

    Raises
    ------
    InputError
        A point lies outside the rim.
    """
    depth, z = np.array(points, dtype=float).T
    steps_r = (rim.thickness_m - depth) / (rim.thickness_m / (mesh.nr - 1))
    steps_z = z / rim.width_m * (mesh.nz - 1)
    return reading_weights(steps_r, mesh.nr), reading_weights(steps_z, mesh.nz)


def steady_amplitudes(modes: Spectrum) -> Array:
    """Steady amplitude of every mode for a unit of every input.

    Parameters
    ----------
    modes
        Modes and their forcing.

    Returns
    -------
    Amplitudes, (I, m, n) [K/W for the power, else without unit].

    Notes
    -----
    Forcing divided by rate, summed over the sources that belong to an input. Multiply by
    ``modes.rates`` to have the forcing itself, as
    ``tcdyn.heat.nonuniform.rim_gains_nonuniform`` does.
    """
    sources = modes.force_r[modes.source_r][:, :, None] * modes.force_z[:, None, :]
    return np.tensordot(modes.collect, sources, axes=1) / modes.rates


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
    """Response of the rim at ``points`` to power, inner row and ambient, on the lags of ``rates``.

    Parameters
    ----------
    rim
        Geometry, material and inner row of the disk.
    h_W_m2K
        Heat-transfer coefficient of the running surface, not negative [W/m2K].
    points
        (depth, z) of each of the P points [m].
    half_width_m
        Half-width b of the contact [m].
    rates
        Rates of the basis of lags, (K,) [1/s].
    profile
        Shape of the temperature along r = R_i.
    flux
        Profile of the heat flux across the track.
    mesh
        Nodes in r and z; finer meshes are more exact (second order) and slower.
    split_ambient
        Whether the air at the running surface and behind each washer has its own temperature, which
        are two more inputs.

    Returns
    -------
    Weights of the lags and of the inputs, described at ``RimGains``.

    Raises
    ------
    InputError
        A negative coefficient, a point outside the rim, or a rim slower than the basis.

    Notes
    -----
    Equation (3.28) with (3.31)-(3.34) and washers, in the scheme (3.30) on ``mesh``.

    Modes faster than the basis are not interpolated: their steady response is added to the fastest
    lag, so that ``static`` stays exact. ``tcdyn.heat.nonuniform.rim_gains_nonuniform`` and
    ``tcdyn.heat.engine.fields_at`` make the same approximation; change all alike. Guarded by
    ``tests/heat/test_rim_engine.py`` (steady state and transients against
    ``tcdyn.heat.reference``).

    Examples
    --------
    >>> from tcdyn.rig.rigfile import load_rig
    >>> from tcdyn.heat.rim import basis_rates
    >>> from tcdyn.heat.rim import junction_points
    >>> setup = load_rig().disk_setup("fast")
    >>> points = junction_points(setup, "ace")
    >>> g = rim_gains(Rim.from_setup(setup), 700.0, points, 1.62e-3, basis_rates(1 / 75))
    >>> g.gains.shape, g.static[1:].sum(axis=0).round(9)   # a rim at one temperature stays there
    ((5, 3, 40), array([1., 1., 1.]))
    """
    if not h_W_m2K >= 0:
        raise InputError(f"rim_gains: h_W_m2K must not be negative; got {h_W_m2K}")
    s, in_basis, amplitudes, weights = _modal_amplitudes(
        rim, h_W_m2K, half_width_m, rates.tobytes(), profile, flux, mesh, split_ambient
    )
    read_r, read_z = readings(rim, tuple(points), mesh)
    values_r = read_r[:, 1:] @ s.shape_r
    values_z = read_z @ s.shape_z
    mode_values = (values_r[:, :, None] * values_z[:, None, :]).reshape(len(values_r), -1)
    responses = amplitudes[:, None] * mode_values[:, in_basis]
    gains = np.asarray(np.tensordot(responses, weights, 1), dtype=float)
    # the steady response of modes faster than the basis belongs to its fastest lag
    by_source = (values_r * s.force_r[:, None, :]) @ (1 / s.rates) * values_z
    steady = s.collect @ (by_source[s.source_r] * s.force_z[:, None, :]).sum(axis=2)
    gains[:, :, -1] += steady - gains.sum(axis=2)
    direct = read_r[:, 0] * (s.boundary @ read_z.T)
    inputs = inputs_of(len(rim.boundary_z_m), split_ambient)
    return RimGains(inputs, tuple(points), rates, gains, direct, gains.sum(axis=2) + direct)


@lru_cache(maxsize=16)
def _modal_amplitudes(
    rim: Rim,
    h: float,
    half_width: float,
    rates: bytes,
    profile: Profile,
    flux: Flux,
    mesh: Mesh,
    split: bool,
) -> tuple[Spectrum, Any, Array, Array]:
    """What all points have in common: the modes, and their weights on the basis; cached.

    Parameters
    ----------
    rim
        Geometry, material and inner row of the disk.
    h
        Heat-transfer coefficient of the running surface [W/m2K].
    half_width
        Half-width of the contact [m].
    rates
        Rates of the basis of lags, (K,) floats as bytes, so that the cache can hash them.
    profile
        Shape of the temperature along r = R_i.
    flux
        Profile of the heat flux across the track.
    mesh
        Nodes in r and z.
    split
        Whether the air has three temperatures.

    Returns
    -------
    spectrum
        The modes.
    in_basis
        Which M of the modes, row by row, the basis represents: a mask, or a full slice.
    amplitudes
        Their steady amplitudes for a unit of every input, divided by the sums of their weights, (I,
        M).
    weights
        Their unscaled weights, (M, K), see ``tcdyn.heat.rim.unscaled_cardinal``.

    Raises
    ------
    InputError
        The slowest mode is slower than the basis.
    """
    s = spectrum(rim, h, half_width, profile, flux, mesh, split)
    nodes = np.frombuffer(rates)
    if s.rates.min() < nodes[0]:
        raise InputError(
            f"the rim's slowest mode {s.rates.min():.3g} 1/s is below the basis' lowest "
            f"{nodes[0]:.3g}",
            remedy="give basis_rates a smaller slowest_per_s",
        )
    in_basis: Any = slice(None)
    if not s.rates.max() < nodes[-1]:
        in_basis = (s.rates < nodes[-1]).ravel()
    weights, total = unscaled_cardinal(nodes, np.log(s.rates.ravel()[in_basis]))
    amplitudes = steady_amplitudes(s).reshape(len(s.collect), -1)[:, in_basis] / total
    return s, in_basis, amplitudes, weights
