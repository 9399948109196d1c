"""What the rim model is made of: geometry and steel (``Rim``), and the nodes of its scheme (``Mesh``)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from calibration.disk import DiskSetup
from calibration.errors import InputError

Array = NDArray[np.float64]
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
