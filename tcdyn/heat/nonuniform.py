"""A film coefficient that varies across the running surface, as in the thesis's trial of figure 6.26."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.heat.modal import (
    RimGains,
    forcing,
    inputs_of,
    outer_source,
    readings,
    rim_gains,
    spectrum,
    surface_weight,
)
from tcdyn.heat.rim import MESH_IV, Flux, Mesh, Point, Profile, Rim, cardinal

FILM_BASIS = 150  # enough for effects of a film that varies little
BASIS = 600  # uniform-film modes kept: for a 6 mm rim all those slower than about 1 ms


def film_in_steps(
    width_m: float, edges_m: Sequence[float], values_W_m2K: Sequence[float], nz: int
) -> Array:
    """Film coefficient of each z node (nz,): steps of ``values`` between ``edges``, averaged over its cell.

    >>> film_in_steps(8.0, [4.0], [200.0, 400.0], 9)
    array([200., 200., 200., 200., 300., 400., 400., 400., 400.])
    """
    if len(values_W_m2K) != len(edges_m) + 1 or list(edges_m) != sorted(edges_m):
        raise InputError("film_in_steps: ascending edges and one more value than edges are needed")
    if min(values_W_m2K) < 0 or (len(edges_m) and not 0 < edges_m[0] <= edges_m[-1] < width_m):
        raise InputError(
            "film_in_steps: values must not be negative and edges must lie inside the width"
        )
    dz = width_m / (nz - 1)
    cells = np.clip((np.arange(nz + 1) - 0.5) * dz, 0.0, width_m)
    knots = np.concatenate([[0.0], np.asarray(edges_m, dtype=float), [width_m]])
    total = np.concatenate(
        [[0.0], np.cumsum(np.diff(knots) * np.asarray(values_W_m2K, dtype=float))]
    )
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
        raise InputError(
            f"film_W_m2K has shape {film.shape}", expected=f"({mesh.nz},) values, none negative"
        )
    mean = float(film.mean())
    s = spectrum(rim, mean, half_width_m, profile, flux, mesh)
    lam = s.rates
    last = surface_weight(rim, mesh.nr)
    weight = np.ones(mesh.nz)
    weight[[0, -1]] = 0.5
    unit = s.shape_z * np.sqrt(weight)[:, None]
    varying = outer_source(rim, mesh.nr) * (film - mean)
    coupling = unit.T @ (varying[:, None] * unit)  # between z-modes (n, n) [1/s]
    rows = forcing(s) * lam  # (I, m, n) [1/s]
    rows[-1] += np.outer(s.shape_r[-1] * last, (varying * np.sqrt(weight)) @ unit)
    surface = s.shape_r[-1] * np.sqrt(last)  # last entry v of each unit-norm r-mode
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
    return RimGains(
        inputs_of(len(rim.boundary_z_m)),
        tuple(points),
        rates,
        gains,
        direct,
        gains.sum(axis=2) + direct,
    )


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
    two more inputs, both air at the running surface alone; these know nothing of an h that varies ``along`` it."""
    if any(along):
        h_z = film_along(h_W_m2K, along, mesh.nz)
        same = (points, half_width_m, np.array(rates), profile, flux, mesh)
        varied = rim_gains_nonuniform(rim, h_z, *same, basis=FILM_BASIS)
        if not film:
            return varied
        whole = cached_gains(rim, h_W_m2K, points, half_width_m, rates, profile, flux, mesh, film)
        parts = ("gains", "direct", "static")
        rows = (
            np.concatenate([getattr(varied, x), getattr(whole, x)[len(varied.inputs) :]])
            for x in parts
        )
        return RimGains(whole.inputs, tuple(points), whole.rates, *rows)
    split = rim_gains(
        rim, h_W_m2K, points, half_width_m, np.array(rates), profile, flux, mesh, film
    )
    if not film:
        return split
    air = len(rim.boundary_z_m) + 1
    gains, direct, static = (
        np.concatenate([x[:air], x[air:].sum(axis=0, keepdims=True), x[[air, air]]])
        for x in (split.gains, split.direct, split.static)
    )
    return RimGains(
        (*split.inputs[:air], "ambient", "film", "film by n"),
        tuple(points),
        split.rates,
        gains,
        direct,
        static,
    )
