"""Heat-transfer coefficient that varies across the running surface (the trial of figure 6.26).

``cached_rim_gains`` is what the fits of ``tcdyn.partition`` call for every rim, uniform or not. The
other functions are also used by ``tcdyn.verify.steady_rows``. The idea: expand the solution in the
modes of the mean coefficient, and couple them through the running surface. Guarded by
``tests/heat/test_rim_nonuniform.py``, which compares with ``tcdyn.heat.reference`` and with more
coupled modes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.heat.modal import (
    RimGains,
    inputs_of,
    outer_source,
    readings,
    rim_gains,
    spectrum,
    steady_amplitudes,
    surface_weight,
)
from tcdyn.heat.rim import MESH_IV, Flux, Mesh, Point, Profile, Rim, lag_weights

# Number of modes of the uniform coefficient that are coupled: enough for smooth, small variations
# (``tests/heat/test_rim_nonuniform.py`` compares with more) ...
SMALL_VARIATION_MODES = 150
# ... and in general: for a 6 mm rim all modes slower than about 1 ms. Chosen by judgement.
COUPLED_MODES = 600


def h_in_steps(
    width_m: float, edges_m: Sequence[float], values_W_m2K: Sequence[float], nz: int
) -> Array:
    """Heat-transfer coefficient of each z node: steps at ``edges_m``, averaged by cell.

    Parameters
    ----------
    width_m
        Width of the running surface [m].
    edges_m
        Positions of the steps from the face z = 0, ascending, (s,) [m].
    values_W_m2K
        Coefficient in each of the s + 1 intervals [W/m2K].
    nz
        Number of z nodes.

    Returns
    -------
    Coefficients, (nz,) [W/m2K].

    Raises
    ------
    InputError
        Edges that do not ascend or lie outside the width, another number of values, or a negative
        value.

    Examples
    --------
    >>> h_in_steps(8.0, [4.0], [200.0, 400.0], 9)
    array([200., 200., 200., 200., 300., 400., 400., 400., 400.])
    """
    if len(values_W_m2K) != len(edges_m) + 1 or list(edges_m) != sorted(edges_m):
        raise InputError("h_in_steps: ascending edges and one more value than edges are needed")
    if min(values_W_m2K) < 0 or (len(edges_m) and not 0 < edges_m[0] <= edges_m[-1] < width_m):
        raise InputError(
            "h_in_steps: values must not be negative and edges must lie inside the width"
        )
    dz = width_m / (nz - 1)
    cells = np.clip((np.arange(nz + 1) - 0.5) * dz, 0.0, width_m)
    knots = np.concatenate([[0.0], np.asarray(edges_m, dtype=float), [width_m]])
    steps = np.diff(knots) * np.asarray(values_W_m2K, dtype=float)
    integral = np.concatenate([[0.0], np.cumsum(steps)])
    return np.diff(np.interp(cells, knots, integral)) / np.diff(cells)


def h_along(mean_W_m2K: float, along: tuple[float, float], nz: int) -> Array:
    """Heat-transfer coefficient of each z node: h (1 + a x + c (1 - 3 x^2)), x from -1 to 1.

    Parameters
    ----------
    mean_W_m2K
        Mean h; both shapes have a mean of zero over the width [W/m2K].
    along
        (a, c): relative rise from the middle to the last face, and relative rise at the track.
    nz
        Number of nodes.

    Returns
    -------
    Coefficients, (nz,) [W/m2K].

    Notes
    -----
    Large values of ``along`` make the coefficient negative somewhere, which
    ``rim_gains_nonuniform`` refuses. The shapes may be changed; keep their mean at zero, so that h
    stays the mean coefficient. A shape with more waves across the width needs more modes than
    ``SMALL_VARIATION_MODES``: ``tests/heat/test_rim_nonuniform.py`` checks the present shapes.

    Examples
    --------
    >>> h_along(300.0, (0.5, 0.0), 5)
    array([150., 225., 300., 375., 450.])
    """
    x = np.linspace(-1.0, 1.0, nz)
    return mean_W_m2K * (1 + along[0] * x + along[1] * (1 - 3 * x**2))


def rim_gains_nonuniform(
    rim: Rim,
    film_W_m2K: Array,
    points: Sequence[Point],
    half_width_m: float,
    rates: Array,
    profile: Profile = "modal",
    flux: Flux = "hertz",
    mesh: Mesh = MESH_IV,
    basis: int = COUPLED_MODES,
) -> RimGains:
    """``rim_gains`` for a heat-transfer coefficient that varies along z.

    Parameters
    ----------
    rim
        Geometry, material and inner row of the disk.
    film_W_m2K
        Coefficient of each z node, (nz,) [W/m2K], none negative, see ``h_in_steps``.
    points
        (depth, z) of each of the P points [m].
    half_width_m
        Half-width of the contact [m].
    rates
        Rates of the basis of lags, (K,) [1/s].
    profile
        Shape of the temperature along r = R_i.
    flux
        Profile of the heat flux across the track.
    mesh
        Nodes in r and z.
    basis
        Number of the slowest modes that are coupled for the dynamics.

    Returns
    -------
    Weights of the lags and of the inputs, described at ``tcdyn.heat.modal.RimGains``.

    Raises
    ------
    InputError
        ``film_W_m2K`` has another shape than (nz,), or a negative value.

    Notes
    -----
    The expansion uses the modes of the mean coefficient. The steady response is exact: the
    variation couples z-modes only through the surface, a system of nz unknowns. For the dynamics
    the slowest ``basis`` modes are coupled and diagonalised again; the remaining steady response
    follows within a millisecond and belongs to the fastest lag.

    More modes in ``basis`` are more exact and slower (an eigenvalue problem of that size). The
    coupling uses ``tcdyn.heat.modal.outer_source`` and ``tcdyn.heat.modal.surface_weight``; it must
    stay consistent with ``tcdyn.heat.modal.spectrum``. ``tests/heat/test_rim_nonuniform.py`` fails
    otherwise.
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
    variation = outer_source(rim, mesh.nr) * (film - mean)
    coupling = unit.T @ (variation[:, None] * unit)  # between z-modes (n, n) [1/s]
    forces = steady_amplitudes(s) * lam  # (I, m, n) [1/s]
    forces[-1] += np.outer(s.shape_r[-1] * last, (variation * np.sqrt(weight)) @ unit)
    surface = s.shape_r[-1] * np.sqrt(last)  # last entry v of each unit-norm r-mode
    # steady: (lam + v v' x C) x = forces, so c = (I + S C)^-1 c0 at the surface, S = sum v^2/lam
    uncoupled = forces / lam
    compliance = (surface[:, None] ** 2 / lam).sum(axis=0)
    at_surface = np.einsum("m,imn->in", surface, uncoupled)
    system = np.eye(len(coupling)) + compliance[:, None] * coupling
    solved = np.linalg.solve(system, at_surface.T).T
    steady = uncoupled - (surface[:, None] / lam)[None] * (solved @ coupling)[:, None, :]
    read_r, read_z = readings(rim, tuple(points), mesh)
    mode_values = (read_r[:, 1:] @ s.shape_r)[:, :, None] * (read_z @ s.shape_z)[:, None, :]
    is_coupled = lam <= np.sort(lam, axis=None)[min(basis, lam.size) - 1]
    m, n = np.nonzero(is_coupled)
    matrix = np.diag(lam[is_coupled])
    matrix += np.outer(surface[m], surface[m]) * coupling[np.ix_(n, n)]
    rate, vectors = np.linalg.eigh(matrix)
    amplitudes = (forces[:, is_coupled] @ vectors) / rate
    responses = amplitudes[:, None, :] * (mode_values[:, is_coupled] @ vectors)[None]
    gains = responses @ lag_weights(rates, np.log(np.minimum(rate, rates[-1])))
    gains[:, :, -1] += np.einsum("imn,pmn->ip", steady, mode_values) - responses.sum(axis=2)
    direct = read_r[:, 0] * (s.boundary @ read_z.T)
    inputs = inputs_of(len(rim.boundary_z_m))
    return RimGains(inputs, tuple(points), rates, gains, direct, gains.sum(axis=2) + direct)


@lru_cache(maxsize=2048)
def cached_rim_gains(
    rim: Rim,
    h_W_m2K: float,
    points: tuple[Point, ...],
    half_width_m: float,
    rates: tuple[float, ...],
    profile: Profile,
    flux: Flux,
    mesh: Mesh,
    split_surface_air: bool = False,
    h_variation: tuple[float, float] = (0.0, 0.0),
) -> RimGains:
    """``rim_gains`` with a cache, for a coefficient that may vary along z.

    Fits return to the same h, and repeated fits share most arguments, so results are stored for
    2048 calls.

    Parameters
    ----------
    rim
        Geometry, material and inner row of the disk.
    h_W_m2K
        Heat-transfer coefficient of the running surface [W/m2K]; the mean where it varies.
    points
        (depth, z) of each of the P points [m].
    half_width_m
        Half-width of the contact [m].
    rates
        Rates of the basis of lags, K numbers [1/s]; a tuple, so that the cache can hash it.
    profile
        Shape of the temperature along r = R_i.
    flux
        Profile of the heat flux across the track.
    mesh
        Nodes in r and z.
    split_surface_air
        Whether to add two inputs, "film" and "film by n", both the air at the running surface only.
        They do not depend on ``h_variation``.
    h_variation
        Variation of h along z, (a, c) of ``h_along``; (0, 0) is a uniform coefficient.

    Returns
    -------
    Weights of the lags and of the inputs. With ``split_surface_air`` the inputs end with "ambient",
    "film" and "film by n"; "ambient" is all air, and the rows of the other two are equal.

    Notes
    -----
    The result is shared by all callers: do not write into its arrays. The size of the cache may be
    changed freely; a value that is too small makes fits slower. The names "film" and "film by n"
    are read in ``tcdyn.partition``.
    """
    if any(h_variation):
        h_z = h_along(h_W_m2K, h_variation, mesh.nz)
        varied = rim_gains_nonuniform(
            rim,
            h_z,
            points,
            half_width_m,
            np.array(rates),
            profile,
            flux,
            mesh,
            basis=SMALL_VARIATION_MODES,
        )
        if not split_surface_air:
            return varied
        uniform = cached_rim_gains(
            rim, h_W_m2K, points, half_width_m, rates, profile, flux, mesh, split_surface_air
        )
        n_varied = len(varied.inputs)
        return replace(
            uniform,
            gains=np.concatenate([varied.gains, uniform.gains[n_varied:]]),
            direct=np.concatenate([varied.direct, uniform.direct[n_varied:]]),
            static=np.concatenate([varied.static, uniform.static[n_varied:]]),
        )
    gains = rim_gains(
        rim, h_W_m2K, points, half_width_m, np.array(rates), profile, flux, mesh, split_surface_air
    )
    if not split_surface_air:
        return gains
    first_air = len(rim.boundary_z_m) + 1
    return RimGains(
        (*gains.inputs[:first_air], "ambient", "film", "film by n"),
        points,
        gains.rates,
        _with_film_inputs(gains.gains, first_air),
        _with_film_inputs(gains.direct, first_air),
        _with_film_inputs(gains.static, first_air),
    )


def _with_film_inputs(x: Array, first_air: int) -> Array:
    """Replace the rows of split air by one of all air and two of the air at the surface.

    Parameters
    ----------
    x
        Rows by input, (I, ...): those before the air, then surface, low side and high side.
    first_air
        Index of the row of the air at the running surface.

    Returns
    -------
    Rows, (first_air + 3, ...): all air is the sum of the three.
    """
    all_air = x[first_air:].sum(axis=0, keepdims=True)
    return np.concatenate([x[:first_air], all_air, x[[first_air, first_air]]])
