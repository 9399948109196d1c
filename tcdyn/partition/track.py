"""Nuisance parameters along the track: position of the flux, profile of h, unresolved rim edge."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tcdyn.core import Array
from tcdyn.heat.nonuniform import cached_rim_gains
from tcdyn.heat.rim import Rim, junction_points
from tcdyn.partition.angular_harmonic import NuisanceParameter
from tcdyn.partition.window import FIT_MESH, Perturbation, RimMeans

SHIFT_STEP_M = 0.25e-3  # of the difference quotient by the position of the flux [m]
FLUX_SHIFT = NuisanceParameter("flux shift", "place of the flux")
UNRESOLVED_EDGE = NuisanceParameter("edge", "inner row of few junctions")
H_PROFILE_STEP = 0.1  # of the difference quotient by the shape of h, relative to h
# For each shape of h along the track, the two perturbations of the difference quotient.
H_PROFILE_STEPS = {
    NuisanceParameter(f"film along {name}", "film along the track"): [
        Perturbation(h_profile=(step * tilt, step * crown))
        for step in (H_PROFILE_STEP, -H_PROFILE_STEP)
    ]
    for name, tilt, crown in (("the width", 1.0, 0.0), ("the middle", 0.0, 1.0))
}


def flux_shift_effect(rim: RimMeans, share: float, h_W_m2K: float) -> Array:
    """Change of the outer row by the position of the flux, a central difference, (R, P) [K/m].

    Because of the positions of d and f about b, the sign of a shift is each disk's own.
    """
    boundary, power = rim.response(h_W_m2K, Perturbation(shift_m=SHIFT_STEP_M))
    other_boundary, other_power = rim.response(h_W_m2K, Perturbation(shift_m=-SHIFT_STEP_M))
    change = boundary - other_boundary + share * (power - other_power)
    return np.asarray(change / (2 * SHIFT_STEP_M))


def h_profile_effects(
    rim: RimMeans, share: float, h_W_m2K: float
) -> dict[NuisanceParameter, Array]:
    """Change of the outer row when h departs from its mean by all of itself, (R, P) [K] each.

    The shapes are the tilt and the crown of ``h_along``.
    """
    effects = {}
    for parameter, (up, down) in H_PROFILE_STEPS.items():
        boundary_up, power_up = rim.response(h_W_m2K, up)
        boundary_down, power_down = rim.response(h_W_m2K, down)
        change = (boundary_up + share * power_up) - (boundary_down + share * power_down)
        effects[parameter] = np.asarray(change) / (2 * H_PROFILE_STEP)
    return effects


def unresolved_edge_effect(rim: RimMeans, h_W_m2K: float) -> Array | None:
    """Change of the outer row by a constant kelvin at a rim edge that is not resolved.

    Returns (P,) [K], or None where the inner row determines the profile along z.
    """
    disk = Rim.from_setup(rim.setup)
    z = disk.undetermined_z_m
    if z is None:
        return None
    wider = replace(disk, boundary_z_m=(*disk.boundary_z_m, z))
    gains = cached_rim_gains(
        wider,
        h_W_m2K,
        junction_points(rim.setup, rim.setup.outer),
        rim.half_width_m,
        tuple(rim.rates_1_s),
        rim.profile,
        "hertz",
        FIT_MESH,
    )
    return gains.static[rim.ambient_index]
