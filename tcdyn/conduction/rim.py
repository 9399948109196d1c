"""What the rim model is made of: geometry and steel (``Rim``), nodes (``Mesh``), and what is imposed on its rims:
the flux across the track and the temperature profile along R_i."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from calibration.arrays import Array
from calibration.disk import DiskSetup
from calibration.errors import InputError

Point = tuple[float, float]  # (depth below the running surface, z from one face), both in m
Profile = Literal["quadratic", "quartic", "modal"]
Flux = Literal["hertz", "uniform"] | Callable[[Array], Array]
MAX_LENGTH_M = 10.0


@dataclass(frozen=True)
class Mesh:
    """Nodes in r (R_i to running surface, both counted) and z (face to face); default: mesh IV of table 3.1."""

    nr: int = 65
    nz: int = 105

    def __post_init__(self) -> None:
        if self.nr < 7 or self.nz < 7:
            raise InputError(f"Mesh: at least 7 nodes each way are needed; got {self.nr} x {self.nz}")


MESH_IV = Mesh()
MESHES = {"I": Mesh(9, 13), "II": Mesh(17, 27), "III": Mesh(33, 53), "IV": MESH_IV}  # the thesis's four


@dataclass(frozen=True)
class Rim:
    """The rim ``R_i <= r <= R_o``, ``0 <= z <= w``, its steel, and where along z junctions d, b and f sit.

    ``washer_W_m2K`` is K_c / w_c, the washers' conductance (section 3.4.4.3).

    >>> from calibration.rig import load_rig
    >>> Rim.from_setup(load_rig().disk_setup("fast")).inner_radius_m
    0.0321
    """

    inner_radius_m: float
    outer_radius_m: float
    width_m: float
    conductivity_W_mK: float
    density_kg_m3: float
    specific_heat_J_kgK: float
    washer_W_m2K: float
    boundary_z_m: tuple[float, float, float]

    def __post_init__(self) -> None:
        if not 0 <= self.inner_radius_m < self.outer_radius_m <= MAX_LENGTH_M:
            raise InputError(
                f"Rim: the inner radius {self.inner_radius_m} m must be below the outer {self.outer_radius_m} m"
            )
        zd, zb, zf = self.boundary_z_m
        if not 0 <= zd < zb < zf <= self.width_m:
            raise InputError(
                f"Rim: d, b, f must lie in this order across the width {self.width_m} m; got {self.boundary_z_m}",
                remedy="z_mm counts from the face next to d",
            )
        for name in ("conductivity_W_mK", "density_kg_m3", "specific_heat_J_kgK"):
            if not getattr(self, name) > 0:
                raise InputError(f"Rim: {name} must be positive; got {getattr(self, name)}")
        if self.washer_W_m2K < 0:
            raise InputError(f"Rim: washer_W_m2K must not be negative; got {self.washer_W_m2K}")

    @classmethod
    def from_setup(cls, setup: DiskSetup, **changes: Any) -> Rim:
        """The rim of a disk: everything outside junction b; ``changes`` override any field."""
        junctions = setup.junctions
        fields: dict[str, Any] = {
            "inner_radius_m": round(setup.outer_radius_m - junctions["b"].depth_m, 12),
            "outer_radius_m": setup.outer_radius_m,
            "width_m": setup.width_m,
            "conductivity_W_mK": setup.conductivity_W_mK,
            "density_kg_m3": setup.density_kg_m3,
            "specific_heat_J_kgK": setup.specific_heat_J_kgK,
            "washer_W_m2K": setup.washer_W_m2K,
            "boundary_z_m": tuple(junctions[name].z_m for name in ("d", "b", "f")),
        }
        return cls(**{**fields, **changes})

    @property
    def diffusivity_m2_s(self) -> float:
        """alpha = K / (rho c) [m2/s]."""
        return self.conductivity_W_mK / (self.density_kg_m3 * self.specific_heat_J_kgK)

    @property
    def thickness_m(self) -> float:
        """R_o - R_i [m]."""
        return self.outer_radius_m - self.inner_radius_m


def points_of(setup: DiskSetup, names: str = "ace") -> tuple[Point, ...]:
    """(depth, z) of the named junctions, e.g. ``points_of(setup, "ace")`` [m]."""
    return tuple((setup.junctions[n].depth_m, setup.junctions[n].z_m) for n in names)


def correction_factor(half_width_m: float, nz: int, width_m: float) -> float:
    """Factor by which point values of the parabola (3.32) must be raised to carry the whole heat (table 3.4).

    N = 2 round(b/dz) intervals lie across the track; the trapezoidal rule then loses 1/N^2 of the parabola, so the
    factor is N^2/(N^2 - 1). The engine needs none: it gives every cell its exact integral.

    >>> [round(correction_factor(1.50e-3, nz, 9.53e-3), 4) for nz in (13, 27, 53, 105)]
    [1.0667, 1.0159, 1.0039, 1.001]
    """
    n = 2 * round(half_width_m / (width_m / (nz - 1)))
    return n**2 / (n**2 - 1)


def flux_density(flux: Flux, half_width: float, width: float, n: int) -> Array:
    """Mean over each node's cell of the unit-power flux density across the track (n,) [1/m]; it sums to 1/dz.

    Hertz (3.32): 3/(4b) (1 - (z'/b)^2) for |z'| <= b, z' from the centre plane; uniform: 1/(2b); or the user's own
    shape of z', scaled to unit power. Each cell gets its exact integral, so no heat is lost to the mesh. The half
    cells at the faces count half.
    """
    edges = np.clip((np.arange(n + 1) - 0.5) * (width / (n - 1)), 0.0, width) - width / 2
    cells = np.diff(edges)
    if callable(flux):
        x, w = np.polynomial.legendre.leggauss(12)
        at = edges[:-1, None] + cells[:, None] * (x + 1) / 2
        heat = np.asarray(flux(at), dtype=float) @ w / 2 * cells
        return np.asarray(heat / heat.sum() / cells)
    if not 0 < half_width <= width / 2 + 1e-12:
        raise InputError(f"the contact's half-width {half_width} m must lie between 0 and half the width {width / 2} m")
    s = np.clip(edges / half_width, -1.0, 1.0)
    total = (s - s**3 / 3) * 0.75 if flux == "hertz" else s * 0.5
    return np.asarray(np.diff(total) / cells)


def profile_basis(
    kind: Profile, z: Array, at: tuple[float, float, float], width: float, lowest: Array, reading: Array
) -> Array:
    """Shapes (3, nz) along r = R_i that are one at d, b or f and zero at the other two; ``width`` in m.

    "quadratic" (3.34); "quartic" (3.33) with zero slope at both faces; "modal": the three lowest eigenfunctions
    of the slab with its washers, ``lowest`` (nz, 3), read at the junctions through ``reading`` (3, nz).
    """

    def shapes(t: Array) -> Array:
        if kind == "quadratic":
            return np.asarray(np.vander(t, 3, increasing=True), dtype=float)
        # zero slope at 0 and 1 leaves three of the quartic's five
        return np.stack([np.ones_like(t), t**2 * (3 - 2 * t), t**2 * (1 - t) ** 2], axis=1)

    if kind not in ("modal", "quadratic", "quartic"):
        raise InputError(f"profile {kind!r} is unknown", expected="quadratic, quartic or modal")
    if kind == "modal":
        free, seen = lowest, reading @ lowest
    else:
        free, seen = shapes(z / width), shapes(np.asarray(at) / width)
    return np.asarray((free @ np.linalg.inv(seen)).T)
