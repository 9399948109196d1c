"""The synthetic disks in (r, z, angle) at the instant at which the heat begins to go."""

from __future__ import annotations

import numpy as np

from tcdyn.core import Array
from tcdyn.rig.circumferential import ANGLES_DEG, Around
from tcdyn.rig.disk import DISKS
from tcdyn.simulate.ehl import EhlOptions, disk_run, draw_test
from tcdyn.simulate.mesh import DiskSystem, grid_of
from tcdyn.simulate.programme import ehl_test
from tcdyn.simulate.round import waves_of
from tcdyn.simulate.truth import DiskTruth, RigTruth


def around_disks(
    test: str, seed: int, truth: RigTruth, options: EhlOptions | None = None
) -> dict[str, Around]:
    """Both disks of a test of the programme round their bores, from bore to running surface, before the parting."""
    o = options or EhlOptions()
    drawn = draw_test(truth, ehl_test(test), seed, o)
    of = {"fast": (drawn.beta, drawn.h_fast_W_m2K), "slow": (1 - drawn.beta, drawn.h_slow_W_m2K)}
    until_s = drawn.breaks_s[2]
    out = {}
    for d in DISKS:
        system, solution = disk_run(truth.disk(d), drawn, *of[d], o, until_s)
        out[d] = _around(truth.disk(d), system, solution.state, o)
    return out


def _around(disk: DiskTruth, system: DiskSystem, state: Array, o: EhlOptions) -> Around:
    g = grid_of(disk, o.mesh)
    parts = [state[rows] for rows in system.steel.cells]
    angle = np.deg2rad(ANGLES_DEG - disk.uneven.angle_deg)
    waves = [np.ones(len(angle)), *(wave(n * angle) for n, wave in waves_of(disk))]
    field = sum(part[:, None] * wave for wave, part in zip(waves, parts)).reshape(
        *g.cells.shape, len(angle)
    )
    reads = (system.sample @ state)[: len(system.channels)]
    return Around(
        disk=disk.setup.name,
        setup=disk.setup,
        depth_m=(disk.setup.outer_radius_m - g.r)[::-1],
        angle_deg=ANGLES_DEG,
        middle_degC=_middle(field, g.z)[::-1],
        surface_degC=field[-1].mean(axis=0),
        surface_u_K=np.zeros(len(angle)),
        seen_degC=dict(zip(system.channels, map(float, reads))),
    )


def _middle(field: Array, z_m: Array) -> Array:
    """Of a field (nr, nz, A) what stands in the middle plane, (nr, A)."""
    middle = 0.5 * (z_m[0] + z_m[-1])
    k = int(np.clip(np.searchsorted(z_m, middle), 1, len(z_m) - 1))
    part = (middle - z_m[k - 1]) / (z_m[k] - z_m[k - 1])
    return (1 - part) * field[:, k - 1] + part * field[:, k]
