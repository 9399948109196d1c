"""The temperature of a disk round its shaft, as a value: worked out from a measured test, or by the synthetic rig."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tcdyn.core import Array
from tcdyn.rig.disk import DiskSetup

ANGLES_DEG: Array = np.arange(0.0, 361.0, 3.0, dtype=np.float64)


@dataclass(frozen=True)
class Around:
    """``middle_degC`` (D, A): in the middle plane at ``depth_m`` (D,) below the running surface and ``angle_deg`` (A,).

    ``surface_degC`` (A,): mean over the width of the running surface, with its standard uncertainty ``surface_u_K``
    (A,); ``seen_degC``: reading of each junction at the same time; angles in the frame of the junctions' ``angle_deg``.
    """

    disk: str
    setup: DiskSetup
    depth_m: Array
    angle_deg: Array
    middle_degC: Array
    surface_degC: Array
    surface_u_K: Array
    seen_degC: dict[str, float]
