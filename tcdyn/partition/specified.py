"""What ``rig.toml`` may state beyond the thesis's own model (section 8.3): flux and film along the track, steel that
follows temperature, a running surface whose loss was measured; and what an inner row of few junctions leaves open."""

from __future__ import annotations

import numpy as np

from tcdyn.core import Array
from tcdyn.partition.angular_harmonic import Unmeasured
from tcdyn.partition.steel import (
    CONDUCTIVITY_SLOPE,
    SPECIFIC_HEAT_SLOPE,
    conductivity_slope_effect,
    specific_heat_slope_effect,
)
from tcdyn.partition.surface_flux import SURFACE_AIR, surface_air_effect
from tcdyn.partition.track import UNRESOLVED_EDGE, FLUX_SHIFT, unresolved_edge_effect, h_profile_effects, flux_shift_effect
from tcdyn.partition.window import DiskWindow
from tcdyn.smoothing.traces import STAND_IN_K, DiskTraces

__all__ = ["statement_effects"]


def specified_effects(
    disk: DiskTraces, window: DiskWindow, share: float, h_W_m2K: float
) -> tuple[tuple[Unmeasured, ...], Array]:
    """What readings of the outer row show more than predicted by one standard uncertainty of each statement, (Q, R, P)
    [K].

    Only of those that have an uncertainty.
    """
    u = disk.uncertainty
    found = dict[Unmeasured, Array]()
    if (open_edge := unresolved_edge_effect(window.rim, h_W_m2K)) is not None:
        found[UNRESOLVED_EDGE] = STAND_IN_K * open_edge * np.ones((len(window.y), 1))
    if u.film_along_rel:
        found |= {x: u.film_along_rel * k for x, k in h_profile_effects(window.rim, share, h_W_m2K).items()}
    if u.flux_shift_mm:
        found[FLUX_SHIFT] = 1e-3 * u.flux_shift_mm * flux_shift_effect(window.rim, share, h_W_m2K)
    if disk.setup.surface.measured and disk.setup.surface.air_u_K:
        found[SURFACE_AIR] = surface_air_effect(window.rim, h_W_m2K, disk.setup.surface.air_u_K)
    if slope := u.conductivity_slope_per_K:
        found[CONDUCTIVITY_SLOPE] = conductivity_slope_effect(window, share, h_W_m2K, slope)
    if slope := u.specific_heat_slope_per_K:
        found[SPECIFIC_HEAT_SLOPE] = specific_heat_slope_effect(window.rim, share, h_W_m2K, slope)
    return tuple(found), np.reshape([*found.values()], (len(found), *window.y.shape))
