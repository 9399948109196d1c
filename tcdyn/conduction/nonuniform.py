"""A film coefficient that varies across the running surface, as in the thesis's trial of figure 6.26."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from calibration import Array
from calibration.errors import InputError
from tcdyn.conduction.modal import (
    RimGains,
    Spectrum,
    forcing,
    inputs_of,
    outer_source,
    readings,
    rim_gains,
    spectrum,
    surface_weight,
)
from tcdyn.conduction.rim import MESH_IV, Flux, Mesh, Point, Profile, Rim, cardinal, cardinal_slope

FILM_BASIS = 150  # enough for effects of a film that varies little
H_STEP = 1e-5  # of h
SAME_RATE = 1e-6  # of a rate: nearer ones are taken to be one
BASIS = 600  # uniform-film modes kept: for a 6 mm rim all those slower than about 1 ms


def film_in_steps(width_m: float, edges_m: Sequence[float], values_W_m2K: Sequence[float], nz: int) -> Array:
    """Film coefficient of each z node (nz,): steps of ``values`` between ``edges``, averaged over its cell.

    >>> film_in_steps(8.0, [4.0], [200.0, 400.0], 9)
    array([200., 200., 200., 200., 300., 400., 400., 400., 400.])
    """
    if len(values_W_m2K) != len(edges_m) + 1 or list(edges_m) != sorted(edges_m):
        raise InputError("film_in_steps: ascending edges and one more value than edges are needed")
    if min(values_W_m2K) < 0 or (len(edges_m) and not 0 < edges_m[0] <= edges_m[-1] < width_m):
        raise InputError("film_in_steps: values must not be negative and edges must lie inside the width")
    dz = width_m / (nz - 1)
    cells = np.clip((np.arange(nz + 1) - 0.5) * dz, 0.0, width_m)
    knots = np.concatenate([[0.0], np.asarray(edges_m, dtype=float), [width_m]])
    total = np.concatenate([[0.0], np.cumsum(np.diff(knots) * np.asarray(values_W_m2K, dtype=float))])
    return np.asarray(np.diff(np.interp(cells, knots, total)) / np.diff(cells))


def film_along(mean_W_m2K: float, along: tuple[float, float], nz: int) -> Array:
    """Film coefficient of each z node (nz,) that departs from its mean by two shapes: h (1 + a x + c (1 - 3 x^2)).

    ``along``: a, relative rise from the middle to the last face, and c, that at the track; x from -1 to 1
    across the width. The mean of both shapes is zero.

    >>> film_along(300.0, (0.5, 0.0), 5)
    array([150., 225., 300., 375., 450.])
    """
    x = np.linspace(-1.0, 1.0, nz)
    return np.asarray(mean_W_m2K * (1 + along[0] * x + along[1] * (1 - 3 * x**2)))


def rim_gains_nonuniform(
    rim: Rim,
    film_W_m2K: Array,
    points: Sequence[Point],
    half_width_m: float,
    rates: Array,
    profile: Profile = "modal",
    flux: Flux = "hertz",
    mesh: Mesh = MESH_IV,
    basis: int = BASIS,
) -> RimGains:
    """``rim_gains`` for a film that varies along z, one value per z node (``film_in_steps``).

    Modes of the mean film are the basis. The steady answer is exact: the film's variation couples z-modes only
    through the surface, a system of nz unknowns. The slowest ``basis`` modes are coupled and diagonalised anew for
    the dynamics; what remains of the steady answer follows within a millisecond and goes to the fastest lag.
    """
    film = np.asarray(film_W_m2K, dtype=float)
    if film.shape != (mesh.nz,) or film.min() < 0:
        raise InputError(f"film_W_m2K has shape {film.shape}", expected=f"({mesh.nz},) values, none negative")
    mean = float(film.mean())
    s = spectrum(rim, mean, half_width_m, profile, flux, mesh)
    lam, rows = s.rates, forcing(s) * s.rates  # (m, n) and (I, m, n) [1/s]
    coupling, more, surface = _varied(rim, s, film - mean, mesh)
    rows[-1] += more
    # steady: (lam + v v' x C) x = rows, so c = (I + S C)^-1 c0 at the surface, S = sum v^2/lam
    free = rows / lam
    compliance = (surface[:, None] ** 2 / lam).sum(axis=0)
    at_surface = np.einsum("m,imn->in", surface, free)
    solved = np.linalg.solve(np.eye(len(coupling)) + compliance[:, None] * coupling, at_surface.T).T
    exact = free - (surface[:, None] / lam)[None] * (solved @ coupling)[:, None, :]
    read_r, read_z = readings(rim, tuple(points), mesh)
    seen = (read_r[:, 1:] @ s.shape_r)[:, :, None] * (read_z @ s.shape_z)[:, None, :]
    keep = lam <= np.sort(lam, axis=None)[min(basis, lam.size) - 1]
    m, n = np.nonzero(keep)
    reduced = np.diag(lam[keep]) + np.outer(surface[m], surface[m]) * coupling[np.ix_(n, n)]
    rate, turn = np.linalg.eigh(reduced)
    answer = ((rows[:, keep] @ turn) / rate)[:, None, :] * (seen[:, keep] @ turn)[None]
    gains = answer @ cardinal(rates, np.log(np.minimum(rate, rates[-1])))
    gains[:, :, -1] += np.einsum("imn,pmn->ip", exact, seen) - answer.sum(axis=2)
    direct = read_r[:, 0] * (s.boundary @ read_z.T)
    return RimGains(inputs_of(len(rim.boundary_z_m)), tuple(points), rates, gains, direct, gains.sum(axis=2) + direct)


def _varied(rim: Rim, s: Spectrum, film_W_m2K: Array, mesh: Mesh) -> tuple[Array, Array, Array]:
    """What a film that departs by ``film_W_m2K`` (nz,) from the modes' own does: coupling (n, n) [1/s] between z-modes
    at the surface, forcing (m, n) [1/s] by a kelvin of air, and the last entries (m,) of the r-modes, of unit norm."""
    weight, last = np.ones(mesh.nz), surface_weight(rim, mesh.nr)
    weight[[0, -1]] = 0.5
    unit, varying = s.shape_z * np.sqrt(weight)[:, None], outer_source(rim, mesh.nr) * film_W_m2K
    more = np.outer(s.shape_r[-1] * last, (varying * np.sqrt(weight)) @ unit)
    return unit.T @ (varying[:, None] * unit), more, s.shape_r[-1] * np.sqrt(last)


def film_slope(
    rim: Rim,
    h_W_m2K: float,
    along: tuple[float, float],
    points: Sequence[Point],
    half_width_m: float,
    rates: Array,
    profile: Profile = "modal",
    flux: Flux = "hertz",
    mesh: Mesh = MESH_IV,
) -> Array:
    """By how much the gains (I, P, K) of ``rim_gains`` change as its film departs ``along`` the track, see
    ``film_along``, to first order.

    The gains are a function f of the modes' matrix, that of a uniform film diagonal; by a coupling B it changes by
    B_ij (f(lam_i) - f(lam_j))/(lam_i - lam_j) (Daleckii & Krein 1951), by B_ij f' where both are one. The steady answer
    is exact, the dynamics are those of the slowest ``FILM_BASIS`` modes; what all nodes have in common is a step of h.
    """
    film = film_along(h_W_m2K, along, mesh.nz)
    step, all_z = H_STEP * h_W_m2K, (points, half_width_m, rates, profile, flux, mesh)
    higher, here = (rim_gains(rim, h, *all_z).gains for h in (h_W_m2K + step, h_W_m2K))
    s = spectrum(rim, h_W_m2K, half_width_m, profile, flux, mesh)
    lam, rows = s.rates, forcing(s) * s.rates
    coupling, more, surface = _varied(rim, s, film - film.mean(), mesh)
    at_surface = np.einsum("m,imn->in", surface, rows / lam)
    exact = -(surface[:, None] / lam)[None] * (at_surface @ coupling)[:, None, :]
    exact[-1] += more / lam
    read_r, read_z = readings(rim, tuple(points), mesh)
    seen = (read_r[:, 1:] @ s.shape_r)[:, :, None] * (read_z @ s.shape_z)[:, None, :]
    keep = lam <= np.sort(lam, axis=None)[min(FILM_BASIS, lam.size) - 1]
    (m, n), rate, driven, shown = np.nonzero(keep), lam[keep], rows[:, keep], seen[:, keep]
    between = np.outer(surface[m], surface[m]) * coupling[np.ix_(n, n)]
    gap = rate[:, None] - rate
    one = np.abs(gap) < SAME_RATE * rate
    apart, same = np.where(one, 0.0, between / np.where(one, 1.0, gap)), np.where(one, between, 0.0)
    weights = cardinal(rates, np.log(np.minimum(rate, rates[-1])))
    by_rate = (cardinal_slope(rates, weights) - weights) / rate[:, None] ** 2
    weights /= rate[:, None]
    gains = (driven[:, None] * (shown @ apart.T) - (driven @ apart)[:, None] * shown) @ weights
    gains += (driven[:, None] * (shown @ same.T)) @ by_rate
    gains[-1] += (more[keep] * shown) @ weights
    gains[:, :, -1] += np.einsum("imn,pmn->ip", exact, seen) - gains.sum(axis=2)
    return np.asarray(gains + (higher - here) * (film.mean() - h_W_m2K) / step)


@lru_cache(maxsize=2048)
def cached_gains(
    rim: Rim,
    h_W_m2K: float,
    points: tuple[Point, ...],
    half_width_m: float,
    rates: tuple[float, ...],
    profile: Profile,
    flux: Flux,
    mesh: Mesh,
    film: bool = False,
    along: tuple[float, float] = (0.0, 0.0),
) -> RimGains:
    """``rim_gains``, worked out once: fits come back to the same h, and faults share all but one junction. By ``film``
    two more inputs, both air at the running surface alone; these know nothing of an h that varies ``along`` it, which
    the others do to first order."""
    if any(along):
        same = points, half_width_m, np.array(rates), profile, flux, mesh
        slope = film_slope(rim, h_W_m2K, along, *same)
        whole = cached_gains(rim, h_W_m2K, points, half_width_m, rates, profile, flux, mesh, film)
        more = np.concatenate([slope, np.zeros((len(whole.gains) - len(slope), *slope.shape[1:]))])
        return replace(whole, gains=whole.gains + more, static=whole.static + more.sum(axis=2))
    split = rim_gains(rim, h_W_m2K, points, half_width_m, np.array(rates), profile, flux, mesh, film)
    if not film:
        return split
    air = len(rim.boundary_z_m) + 1
    gains, direct, static = (
        np.concatenate([x[:air], x[air:].sum(axis=0, keepdims=True), x[[air, air]]])
        for x in (split.gains, split.direct, split.static)
    )
    return RimGains(
        (*split.inputs[:air], "ambient", "film", "film by n"), tuple(points), split.rates, gains, direct, static
    )
