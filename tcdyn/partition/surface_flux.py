"""The running surface's loss as a measured relation of flux and temperature, in place of h and the ambient there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tcdyn.core import Array
from tcdyn.partition.angular_harmonic import Unmeasured
from tcdyn.partition.events import EhlTest
from tcdyn.partition.window import RimMeans
from tcdyn.rig.surface_flux import SurfaceFlux
from tcdyn.smoothing.traces import DiskTraces

SURFACE_AIR = Unmeasured("surface air", "measured surface flux")
SURFACE_SLOPE = Unmeasured("surface slope", "measured surface flux")
MIN_H_U_REL = 1e-4


def with_surfaces(test: EhlTest) -> EhlTest:
    """The test with ``film`` set for disks whose surface loses heat to another air than that behind the faces: to T_a
    where its loss was measured, else to what channels of its own tell."""
    found = {d: constant_speed_air_offset(test, disk) for d, disk in test.disks.items()}
    film = {d: f for d, f in found.items() if test.disks[d].setup.surface.measured or f.any()}
    return replace(test, film={**test.film, **film}) if film else test


def constant_speed_air_offset(test: EhlTest, disk: DiskTraces) -> Array:
    """Columns (N, 2) of ``EhlTest.film`` while the speeds stay: how much warmer than the ambient T_a is, and zero."""
    surface = disk.setup.surface
    ambient = test.ambient_of(disk.name)
    own = test.air[disk.name].surface if disk.name in test.air else ambient
    warmer = (surface.air_degC if surface.measured else own) - ambient
    return np.column_stack([warmer, np.zeros_like(warmer)])


def surface_air_effect(rim: RimMeans, h_W_m2K: float, u_K: float) -> Array:
    """What the outer row shows more if T_a lies ``u_K`` higher, for ever, (R, P) [K]."""
    static = rim.gains(h_W_m2K).static[rim.films[0]]
    return np.asarray(u_K * static * np.ones((len(rim.inputs), 1)))


def log_h_prior(surface: SurfaceFlux) -> tuple[float, float]:
    """Mean and standard deviation of log h [W/m2K] that the relation tells; without one, nothing."""
    if not surface.measured:
        return 0.0, np.inf
    h = surface.heat_transfer_W_m2K
    return float(np.log(h)), max(surface.heat_transfer_u_W_m2K / h, MIN_H_U_REL)
