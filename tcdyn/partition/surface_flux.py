"""Air temperature at the running surface: by a measured surface flux, or by own channels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tcdyn.core import Array
from tcdyn.partition.angular_harmonic import NuisanceParameter
from tcdyn.partition.events import EhlTest
from tcdyn.partition.window import RimMeans
from tcdyn.rig.surface_flux import SurfaceFlux
from tcdyn.smoothing.traces import DiskTraces

SURFACE_AIR = NuisanceParameter("surface air", "measured surface flux")
SURFACE_SLOPE = NuisanceParameter("surface slope", "measured surface flux")
MIN_H_U_REL = 1e-4  # least relative standard uncertainty of a measured h; chosen by judgement


def with_surface_air(test: EhlTest) -> EhlTest:
    """The test with the air offset of disks whose surface has another air than their faces.

    That is T_a where the surface loss was measured, else what the disk's own channels show.
    """
    offsets = {}
    for name, disk in test.disks.items():
        offset = constant_speed_air_offset(test, disk)
        if disk.setup.surface.is_measured or offset.any():
            offsets[name] = offset
    if not offsets:
        return test
    return replace(test, surface_air_offset_K={**test.surface_air_offset_K, **offsets})


def constant_speed_air_offset(test: EhlTest, disk: DiskTraces) -> Array:
    """Columns (N, 2) of the air offset at constant speed: T_a less ambient, and zero [K]."""
    surface = disk.setup.surface
    ambient = test.ambient_of(disk.name)
    if surface.is_measured:
        offset = surface.air_degC - ambient
    elif disk.name in test.air:
        offset = test.air[disk.name].surface - ambient
    else:
        offset = np.zeros_like(ambient)
    return np.column_stack([offset, np.zeros_like(offset)])


def surface_air_effect(rim: RimMeans, h_W_m2K: float, u_K: float) -> Array:
    """Change of the outer row if T_a is permanently higher by ``u_K``, (R, P) [K]."""
    static = rim.gains(h_W_m2K).static[rim.surface_air_inputs[0]]
    return np.asarray(u_K * static * np.ones((len(rim.inputs), 1)))


def log_h_prior(surface: SurfaceFlux) -> tuple[float, float]:
    """Prior mean and standard deviation of log h [W/m2K]; infinite unless measured."""
    if not surface.is_measured:
        return 0.0, np.inf
    h = surface.heat_transfer_W_m2K
    return float(np.log(h)), max(surface.heat_transfer_u_W_m2K / h, MIN_H_U_REL)
