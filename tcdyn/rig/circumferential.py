"""Circumferential temperature of a disk: the result of a measured test, or of the synthetic rig.

Made by :mod:`tcdyn.partition.circumferential` and :mod:`tcdyn.simulate.field`, drawn by
:mod:`tcdyn.plots.circumferential`. It stands here so that the simulator and the workflow can both
import it. Test: ``tests/partition/test_around.py``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tcdyn.core import Array
from tcdyn.rig.disk import DiskSetup

# Angles of the result [deg].
ANGLES_DEG: Array = np.arange(0.0, 361.0, 3.0, dtype=np.float64)


@dataclass(frozen=True)
class CircumferentialTemperature:
    """Circumferential temperature of a disk.

    Parameters
    ----------
    disk, setup
        The disk.
    depth_m
        Depths below the running surface, (D,).
    angle_deg
        Angles in the frame of the junctions' ``angle_deg``, (A,).
    middle_degC
        Temperature in the middle plane, (D, A).
    surface_degC, surface_u_K
        Mean over the width of the running surface and its standard uncertainty, (A,).
    reading_degC
        Reading of each junction at the same time.
    """

    disk: str
    setup: DiskSetup
    depth_m: Array
    angle_deg: Array
    middle_degC: Array
    surface_degC: Array
    surface_u_K: Array
    reading_degC: dict[str, float]
