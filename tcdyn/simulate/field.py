"""Temperature field of the synthetic disks over r, z and angle at the unloading.

``tcdyn rig circumference`` and ``docs/gallery/test/uneven.py`` compare it with the estimate from
the readings; ``tests/partition/test_around.py`` does so with tolerances. It is read from the state
of ``tcdyn.simulate.ehl.disk_run`` and adds no model of its own.
"""

from __future__ import annotations

import numpy as np

from tcdyn.core import Array
from tcdyn.rig.circumferential import ANGLES_DEG, CircumferentialTemperature
from tcdyn.rig.disk import DISKS
from tcdyn.simulate.ehl import EhlOptions, disk_run, draw_test, heat_share_and_h
from tcdyn.simulate.harmonics import harmonic_shapes
from tcdyn.simulate.mesh import DiskSystem, grid_of
from tcdyn.simulate.programme import ehl_test
from tcdyn.simulate.truth import DiskTruth, RigTruth


def disk_fields(
    test: str, seed: int, truth: RigTruth, options: EhlOptions | None = None
) -> dict[str, CircumferentialTemperature]:
    """Return the temperature around both disks of a test at the start of the unloading.

    Parameters
    ----------
    test
        Name of the test (A1 to D4).
    seed
        Seed of the test.
    truth
        True values of the rig.
    options
        Times and fixed values of the test.

    Returns
    -------
    dict
        By disk, the temperature from bore to surface and around the disk, without uncertainty.
    """
    o = options or EhlOptions()
    test_truth = draw_test(truth, ehl_test(test), seed, o)
    unloading_start_s = test_truth.breaks_s[2]
    out = {}
    for name in DISKS:
        disk = truth.disk(name)
        share, h = heat_share_and_h(test_truth, name)
        system, solution = disk_run(disk, test_truth, share, h, o, unloading_start_s)
        out[name] = _temperature_around(disk, system, solution.state, o)
    return out


def _temperature_around(
    disk: DiskTruth, system: DiskSystem, state: Array, options: EhlOptions
) -> CircumferentialTemperature:
    """Return the temperature around a disk from the state of its system.

    Parameters
    ----------
    disk
        True values of the disk.
    system
        Its equations.
    state
        State of all unknowns (n,).
    options
        Options of the run; its mesh must be that of ``system``.

    Returns
    -------
    CircumferentialTemperature
        Temperature over depth and angle in the middle plane, and at the surface as the mean over
        the width.
    """
    grid = grid_of(disk, options.mesh)
    angle = np.deg2rad(ANGLES_DEG - disk.uneven.angle_deg)
    shapes = [np.ones(len(angle)), *(wave(n * angle) for n, wave in harmonic_shapes(disk))]
    field = np.zeros((grid.cells.size, len(angle)))
    for rows, shape in zip(system.steel.cells, shapes):
        field += np.outer(state[rows], shape)
    field = field.reshape(*grid.cells.shape, len(angle))
    readings = (system.sample @ state)[: len(system.channels)]
    return CircumferentialTemperature(
        disk=disk.setup.name,
        setup=disk.setup,
        depth_m=(disk.setup.outer_radius_m - grid.r)[::-1],
        angle_deg=ANGLES_DEG,
        middle_degC=_middle_plane(field, grid.z)[::-1],
        surface_degC=field[-1].mean(axis=0),
        surface_u_K=np.zeros(len(angle)),
        reading_degC=dict(zip(system.channels, readings.tolist())),
    )


def _middle_plane(field: Array, z_m: Array) -> Array:
    """Return a field in the middle plane of the disk, by linear interpolation in z.

    Parameters
    ----------
    field
        Field (nr, nz, A).
    z_m
        Centres of the cells along the width (nz,) [m].

    Returns
    -------
    array
        Field (nr, A).
    """
    middle = 0.5 * (z_m[0] + z_m[-1])
    k = int(np.clip(np.searchsorted(z_m, middle), 1, len(z_m) - 1))
    weight = (middle - z_m[k - 1]) / (z_m[k] - z_m[k - 1])
    return (1 - weight) * field[:, k - 1] + weight * field[:, k]
