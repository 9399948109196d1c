"""Junctions d and f that lie at another depth than b, brought to the one radius that the rim model begins at."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calibration.disk import DISKS
from tcdyn.chain import equalised
from tcdyn.partition.nuisance import boundary_gradient
from tcdyn.partition.prepare import EhlTest
from tcdyn.partition.refine import joint_start, lagged_window, steady_lines
from tcdyn.partition.window import deeper_than_b_m, stretch_of
from tcdyn.traces import DiskTraces

LONGEST_S = 20.0  # of cooling that any fit looks at
ROUNDS = 2  # what moves share and h in the second is a hundredth of what moved them in the first


def at_one_radius(test: EhlTest) -> EhlTest:
    """The test with ``inner_K`` of both disks set: radial gradient times how much deeper than b a junction lies.

    The rim begins at the depth of b, and d and f are taken to read the temperature there (eq. 3.34). Where rig.toml
    states another depth, the gradient of the model itself, at the speed law's share and h, tells what they would read.
    First order in the difference: good for some tenths of a millimetre. Disks whose inner row is level stay untouched.
    """
    off = {d: deeper_than_b_m(test.disks[d].setup) for d in DISKS}
    if not any(np.any(o) for o in off.values()):
        return test
    rows = stretch_of(test, min(LONGEST_S, float(test.time_s[-1] - test.events.unload_s)))
    for _ in range(ROUNDS):
        _, speed = steady_lines(test, rows)
        at = joint_start(speed)
        moved = {d: _levelled(test, test.disks[d], rows, off[d], *at[d]) for d in DISKS if np.any(off[d])}
        test = replace(test, disks={**test.disks, **moved})
    return test


def _levelled(
    test: EhlTest, disk: DiskTraces, rows: slice, deeper_m: NDArray[np.float64], share: float, h_W_m2K: float
) -> DiskTraces:
    readings = equalised(disk.readings_degC[rows], test.dt_s, disk.chains, disk.mean_chain)
    window = lagged_window(test, disk, rows, readings, "modal")
    gradient = boundary_gradient(window, share, h_W_m2K)
    whole = np.zeros_like(disk.inner_K)
    whole[rows] = gradient * deeper_m
    whole[rows.stop :] = whole[rows.stop - 1]
    return replace(disk, inner_K=whole)
