"""What ``rig.toml`` may state beyond the thesis's own model (section 8.3): flux and film along the track, steel that
follows temperature, a running surface whose loss was measured; and what an inner row of few junctions leaves open."""

from __future__ import annotations

import numpy as np

from tcdyn.core import Array
from tcdyn.partition.angular_harmonic import Unmeasured
from tcdyn.partition.steel import (
    CONDUCTIVITY_SLOPE,
    SPECIFIC_HEAT_SLOPE,
    by_conductivity_slope,
    by_specific_heat_slope,
)
from tcdyn.partition.surface_flux import SURFACE_AIR, by_air
from tcdyn.partition.track import EDGE, SHIFT, by_edge, by_film, by_shift
from tcdyn.partition.window import DiskWindow
from tcdyn.smoothing.traces import STAND_IN_K, DiskTraces

__all__ = ["statement_effects"]


def statement_effects(
    disk: DiskTraces, window: DiskWindow, share: float, h_W_m2K: float
) -> tuple[tuple[Unmeasured, ...], Array]:
    """What readings of the outer row show more than predicted by one standard uncertainty of each statement, (Q, R, P)
    [K].

    Only of those that have an uncertainty.
    """
    u = disk.uncertainty
    found = dict[Unmeasured, Array]()
    if (open_edge := by_edge(window.rim, h_W_m2K)) is not None:
        found[EDGE] = STAND_IN_K * open_edge * np.ones((len(window.y), 1))
    if u.film_along_rel:
        found |= {x: u.film_along_rel * k for x, k in by_film(window.rim, share, h_W_m2K).items()}
    if u.flux_shift_mm:
        found[SHIFT] = 1e-3 * u.flux_shift_mm * by_shift(window.rim, share, h_W_m2K)
    if disk.setup.surface.measured and disk.setup.surface.air_u_K:
        found[SURFACE_AIR] = by_air(window.rim, h_W_m2K, disk.setup.surface.air_u_K)
    if slope := u.conductivity_slope_per_K:
        found[CONDUCTIVITY_SLOPE] = by_conductivity_slope(window, share, h_W_m2K, slope)
    if slope := u.specific_heat_slope_per_K:
        found[SPECIFIC_HEAT_SLOPE] = by_specific_heat_slope(window.rim, share, h_W_m2K, slope)
    return tuple(found), np.reshape([*found.values()], (len(found), *window.y.shape))
