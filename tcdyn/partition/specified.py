"""Nuisance parameters of what ``rig.toml`` may specify beyond the thesis's own model (section 8.3).

These are flux and heat transfer coefficient along the track, steel that depends on temperature, and
a running surface whose loss was measured; further the rim edge that an inner row of few junctions
does not determine."""

from __future__ import annotations

import numpy as np

from tcdyn.core import Array
from tcdyn.partition.angular_harmonic import NuisanceParameter
from tcdyn.partition.steel import (
    CONDUCTIVITY_SLOPE,
    SPECIFIC_HEAT_SLOPE,
    conductivity_slope_effect,
    specific_heat_slope_effect,
)
from tcdyn.partition.surface_flux import SURFACE_AIR, surface_air_effect
from tcdyn.partition.track import (
    FLUX_SHIFT,
    UNRESOLVED_EDGE,
    flux_shift_effect,
    h_profile_effects,
    unresolved_edge_effect,
)
from tcdyn.partition.window import DiskWindow
from tcdyn.smoothing.traces import SURROGATE_U_K, DiskTraces


def specified_effects(
    disk: DiskTraces, window: DiskWindow, share: float, h_W_m2K: float
) -> tuple[tuple[NuisanceParameter, ...], Array]:
    """Nuisance parameters of what is specified with an uncertainty, and their effects.

    Returns the Q parameters and their effects on the outer row, (Q, R, P) [K].
    """
    u = disk.uncertainty
    rim = window.rim
    surface = disk.setup.surface
    effects: dict[NuisanceParameter, Array] = {}
    edge = unresolved_edge_effect(rim, h_W_m2K)
    if edge is not None:
        effects[UNRESOLVED_EDGE] = SURROGATE_U_K * edge * np.ones((len(window.y), 1))
    if u.film_along_rel:
        for parameter, change in h_profile_effects(rim, share, h_W_m2K).items():
            effects[parameter] = u.film_along_rel * change
    if u.flux_shift_mm:
        effects[FLUX_SHIFT] = 1e-3 * u.flux_shift_mm * flux_shift_effect(rim, share, h_W_m2K)
    if surface.is_measured and surface.air_u_K:
        effects[SURFACE_AIR] = surface_air_effect(rim, h_W_m2K, surface.air_u_K)
    if u.conductivity_slope_per_K:
        effects[CONDUCTIVITY_SLOPE] = conductivity_slope_effect(
            window, share, h_W_m2K, u.conductivity_slope_per_K
        )
    if u.specific_heat_slope_per_K:
        effects[SPECIFIC_HEAT_SLOPE] = specific_heat_slope_effect(
            rim, share, h_W_m2K, u.specific_heat_slope_per_K
        )
    return tuple(effects), np.reshape([*effects.values()], (len(effects), *window.y.shape))
