"""The thesis's difference scheme, split into its r part and its z part, each a symmetrizable tridiagonal.

In the r direction (3.30) with the outer node (3.31), in the z direction with the washers (section 3.4.4.3):
``dT/dt = -(A_r x I + I x A_z) T + forcing``. Every argument may carry derivatives (``dual.Dual``).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_interp_spline

from calibration.errors import InputError
from tcdyn.conduction.dual import Dual, einsum, inverse, plain, sqrt
from tcdyn.conduction.rim import Flux

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Tridiagonal:
    """D^1/2 A D^-1/2, symmetric: its diagonal (n,), off-diagonal (n-1,) [1/s] and D^1/2 as ``scale`` (n,)."""

    diagonal: Any
    off: Any
    scale: Any


def radial_operator(ri: Any, ro: float, n: int, alpha: Any, conductivity: Any, h: Any) -> Tridiagonal:
    """A_r [1/s] on the nodes j = 1..n-1 (node 0 carries the imposed profile); SI units throughout."""
    dr = (ro - ri) / (n - 1)
    j = np.arange(1.0, n)
    r = ri + dr * j
    half = r - dr / 2  # r_{j-1/2}
    c = alpha / (dr * dr)
    rw = sqrt(r)
    tail = sqrt(half[n - 2] / 2)
    inside = np.arange(n - 2)
    off = -c * half[1:] / (rw[1:] * rw[:-1])
    last = -c * sqrt(2 * half[n - 2] / r[n - 3])
    keep = np.ones(n - 2)
    keep[-1] = 0
    scale_keep = np.append(np.ones(n - 2), 0.0)
    surface = outer_source(ri, ro, n, alpha, conductivity) * h
    return Tridiagonal(
        diagonal=2 * c * np.ones(n - 1) + surface * (1 - scale_keep),
        off=off * keep + last * (inside == n - 3),
        scale=rw * scale_keep + tail * (1 - scale_keep),
    )


def outer_source(ri: Any, ro: float, n: int, alpha: Any, conductivity: Any) -> Any:
    """Heating rate of the outermost node by a unit flux, alpha (R_o + dr/2) 2/(K R_o dr) [K/s per W/m2]."""
    dr = (ro - ri) / (n - 1)
    return alpha * (ro + dr / 2) * 2 / (conductivity * ro * dr)


def inner_source(ri: Any, ro: float, n: int, alpha: Any) -> Any:
    """Heating rate of node 1 by a unit temperature of node 0, alpha r_1/2 / (r_1 dr^2) [1/s]."""
    dr = (ro - ri) / (n - 1)
    return alpha * (ri + dr / 2) / ((ri + dr) * dr * dr)


def axial_operator(width: float, n: int, alpha: Any, conductivity: Any, washer: Any) -> Tridiagonal:
    """A_z [1/s] on all nodes i = 0..n-1; SI units throughout."""
    dz = width / (n - 1)
    c = alpha / dz**2
    ends = np.zeros(n)
    ends[[0, -1]] = 1
    face = face_source(width, n, alpha, conductivity, washer)
    off = np.ones(n - 1)
    off[[0, -1]] = np.sqrt(2)
    return Tridiagonal(
        diagonal=2 * c * np.ones(n) + face * ends,
        off=-c * off,
        scale=np.where(ends > 0, np.sqrt(0.5), 1.0),
    )


def face_source(width: float, n: int, alpha: Any, conductivity: Any, washer: Any) -> Any:
    """Heating rate of a face node by a unit temperature behind its washer, 2 alpha h_w/(K dz) [1/s]."""
    return 2 * alpha * washer / (conductivity * (width / (n - 1)))


@lru_cache(maxsize=16)
def _cardinal_splines(n: int) -> tuple[BSpline, BSpline]:
    """Quintic splines (n,) that are one at their own node and zero at the others, and their slopes."""
    spline = make_interp_spline(np.arange(n), np.eye(n), k=5)
    return spline, spline.derivative()


def reading_weights(position: Any, n: int) -> Any:
    """Weights (n,) that read a nodal field at ``position``, counted in mesh steps from node 0.

    A quintic spline through all nodes: exact there, and smooth in the position, so depths have clean derivatives.
    """
    at = float(plain(position))
    if not -1e-9 <= at <= n - 1 + 1e-9:
        raise InputError(f"a point lies outside the rim (at {at:.2f} of {n - 1} mesh steps)")
    spline, slope = _cardinal_splines(n)
    weights = np.asarray(spline(at), dtype=np.float64)
    if not isinstance(position, Dual):
        return weights
    return Dual(weights, position.slope[:, None] * slope(at))


def flux_density(flux: Flux, half_width: Any, width: float, n: int) -> Any:
    """Mean over each node's cell of the unit-power flux density across the track (n,) [1/m]; it sums to 1/dz.

    Hertz (3.32): 3/(4b) (1 - (z'/b)^2) for |z'| <= b, z' from the centre plane; uniform: 1/(2b); or the user's own
    shape of z', scaled to unit power. Each cell gets its exact integral, so no heat is lost to the mesh. The half
    cells at the faces count half.
    """
    dz = width / (n - 1)
    edges = np.clip((np.arange(n + 1) - 0.5) * dz, 0.0, width) - width / 2
    cells = np.diff(edges)
    if callable(flux):
        x, w = np.polynomial.legendre.leggauss(12)
        at = edges[:-1, None] + cells[:, None] * (x + 1) / 2
        heat = np.asarray(flux(at), dtype=float) @ w / 2 * cells
        return heat / heat.sum() / cells
    b = plain(half_width)
    if not 0 < b <= width / 2 + 1e-12:
        raise InputError(f"the contact's half-width {b} m must lie between 0 and half the width {width / 2} m")
    inside = np.abs(edges) < b
    s = (edges * inside) / half_width + np.sign(edges) * ~inside
    total = (s - s * s * s / 3) * 0.75 if flux == "hertz" else s * 0.5
    return (total[1:] - total[:-1]) / cells


def profile_basis(kind: str, z: Array, at: tuple[float, float, float], width: float, lowest: Any, reading: Any) -> Any:
    """Shapes (3, nz) along r = R_i that are one at d, b or f and zero at the other two; ``width`` in m.

    "quadratic" (3.34); "quartic" (3.33) with zero slope at both faces; "modal": the three lowest eigenfunctions
    of the slab with its washers, ``lowest`` (nz, 3), read at the junctions through ``reading`` (3, nz).
    """
    if kind == "modal":
        return einsum("zm,mp->pz", lowest, inverse(einsum("pz,zm->pm", reading, lowest)))
    x, p = z / width, np.asarray(at) / width
    if kind == "quadratic":
        powers = np.vander(p, 3, increasing=True)
        return (np.vander(x, 3, increasing=True) @ np.linalg.inv(powers)).T
    if kind == "quartic":
        # zero slope at 0 and 1 leaves three of the five: 1, t^2 (3 - 2t), t^2 (1 - t)^2
        def shapes(t: Array) -> Array:
            return np.stack([np.ones_like(t), t**2 * (3 - 2 * t), t**2 * (1 - t) ** 2], axis=1)

        return (shapes(x) @ np.linalg.inv(shapes(p))).T
    raise InputError(f"profile {kind!r} is unknown", expected="quadratic, quartic or modal")
