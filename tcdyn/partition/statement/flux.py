"""The place of the heat flux across the track, which ``rig.toml`` states and nobody measured."""

from __future__ import annotations

import numpy as np

from calibration import Array
from tcdyn.partition.uneven import Unmeasured
from tcdyn.partition.window import Perturbation, RimMeans

SHIFT_STEP_M = 0.25e-3
SHIFT = Unmeasured("flux shift", "place of the flux")


def by_shift(rim: RimMeans, share: float, h_W_m2K: float) -> Array:
    """What a, c, e show more when the flux lies a metre further along z, by a central difference, (R, 3) [K/m].

    By the places of d and f round b the sign of a shift is each disk's own.
    """
    one, other = (rim.answer(h_W_m2K, Perturbation(shift_m=s)) for s in (SHIFT_STEP_M, -SHIFT_STEP_M))
    return np.asarray((one[0] - other[0] + share * (one[1] - other[1])) / (2 * SHIFT_STEP_M))
