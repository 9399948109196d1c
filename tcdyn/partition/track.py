"""Along the track: the place of the heat flux and the shape of the film, as ``rig.toml`` states them, unmeasured, and
what an inner row of few junctions leaves open."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tcdyn.core import Array
from tcdyn.heat.nonuniform import cached_gains
from tcdyn.heat.rim import Rim, points_of
from tcdyn.partition.angular_harmonic import Unmeasured
from tcdyn.partition.window import FIT_MESH, Perturbation, RimMeans

SHIFT_STEP_M = 0.25e-3
FLUX_SHIFT = Unmeasured("flux shift", "place of the flux")
UNRESOLVED_EDGE = Unmeasured("edge", "inner row of few junctions")
H_PROFILE_STEP = 0.1
H_PROFILE_STEPS = {
    Unmeasured(f"film along {name}", "film along the track"): [
        Perturbation(film=(s * tilt, s * crown)) for s in (H_PROFILE_STEP, -H_PROFILE_STEP)
    ]
    for name, tilt, crown in (("the width", 1.0, 0.0), ("the middle", 0.0, 1.0))
}


def flux_shift_effect(rim: RimMeans, share: float, h_W_m2K: float) -> Array:
    """What the outer row shows more when the flux lies a metre further along z, by a central difference, (R, P) [K/m].

    By the places of d and f round b the sign of a shift is each disk's own.
    """
    one, other = (
        rim.answer(h_W_m2K, Perturbation(shift_m=s)) for s in (SHIFT_STEP_M, -SHIFT_STEP_M)
    )
    return np.asarray((one[0] - other[0] + share * (one[1] - other[1])) / (2 * SHIFT_STEP_M))


def h_profile_effects(rim: RimMeans, share: float, h_W_m2K: float) -> dict[Unmeasured, Array]:
    """What the outer row shows more when h departs from its mean by all of itself along each of ``film_along``'s two
    shapes, (R, P) [K] each."""
    out = {}
    for what, pair in H_PROFILE_STEPS.items():
        one, other = (rest + share * heat for rest, heat in (rim.answer(h_W_m2K, p) for p in pair))
        out[what] = np.asarray(one - other) / (2 * H_PROFILE_STEP)
    return out


def unresolved_edge_effect(rim: RimMeans, h_W_m2K: float) -> Array | None:
    """What the outer row shows more by a lasting kelvin where the inner row leaves the rim's edge open, (P,) [K]; None
    where it tells the profile along z."""
    disk = Rim.from_setup(rim.setup)
    if (z := disk.unseen_z_m) is None:
        return None
    wider = replace(disk, boundary_z_m=(*disk.boundary_z_m, z))
    points = points_of(rim.setup, rim.setup.outer)
    at = rim.half_width_m, tuple(rim.rates_1_s), rim.profile, "hertz", FIT_MESH
    return cached_gains(wider, h_W_m2K, points, *at).static[rim.ambient]
