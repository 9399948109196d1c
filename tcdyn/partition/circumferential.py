"""Circumferential temperature of a disk: mean by the rim model plus first angular harmonic.

Used by :mod:`tcdyn.report.circumferential`. The harmonic is that of
:mod:`tcdyn.partition.angular_harmonic`. Guarded by ``tests/partition/test_around.py``.
"""

from __future__ import annotations

import numpy as np

from tcdyn.partition.analyse import Partition
from tcdyn.partition.angular_harmonic import harmonic_K, radial_shape
from tcdyn.partition.joint import LOG_H, SHARE
from tcdyn.partition.steady import END_GAP_S, SURFACE_DEPTH_M, SURFACE_MEAN_S
from tcdyn.rig.circumferential import ANGLES_DEG, CircumferentialTemperature

# Points of the profile over the depth, and points across the running surface for its mean.
N_DEPTHS = 25
N_ACROSS = 15


def circumferential_temperature(partition: Partition, disk: str) -> CircumferentialTemperature:
    """Temperature of a disk over depth and angle, mean of the last seconds under load.

    Parameters
    ----------
    partition
        Result of the partition; the combined fit is used.
    disk
        "fast" or "slow".

    Notes
    -----
    T = T_0(r, z) + T_1(r) cos(angle - hottest), from the inner row to the running surface. Nothing
    is measured deeper than the junctions. The uncertainty has two parts: that of the harmonic, and
    that of the mean surface temperature due to the joint uncertainty of share and h.
    """
    test = partition.test
    unload_s = test.events.unload_s
    window = partition.windows[disk]
    harmonic = partition.combined.harmonics[disk]
    setup = test.disks[disk].setup
    theta = partition.combined.theta[4 * partition.disks.index(disk) :]
    share = float(theta[SHARE])
    h = float(np.exp(theta[LOG_H]))
    depth = np.linspace(0.0, setup.edge_m, N_DEPTHS)
    middle = tuple((float(d), 0.5 * setup.width_m) for d in depth)
    across = tuple((SURFACE_DEPTH_M, (k + 0.5) / N_ACROSS * setup.width_m) for k in range(N_ACROSS))
    since_unloading_s = window.block_time_s - unload_s
    last = (since_unloading_s >= -SURFACE_MEAN_S) & (since_unloading_s < -END_GAP_S)
    n_outer = len(setup.outer)
    at_rest, by_power = window.rim.response(h, extra=(*middle, *across))
    even = at_rest[last].mean(axis=0)[n_outer:] + share * by_power[last].mean(axis=0)[n_outer:]
    # Back from the Kirchhoff transform, to first order.
    even -= setup.steel.kirchhoff_temperature(even) - even
    angles = np.deg2rad(ANGLES_DEG)
    directions = np.stack([np.cos(angles), np.sin(angles)])
    hottest = np.deg2rad(harmonic.hottest_angle_deg.value)
    level = harmonic.amplitude_K.value * np.array([np.cos(hottest), np.sin(hottest)])
    shape = radial_shape(setup, h, depth)
    variance = np.einsum("ia,ij,ja->a", directions, harmonic.level_covariance_K2, directions)
    even_u = partition.estimates[f"surface {disk}"].u
    time_s = test.time_s[partition.rows]
    averaged = (time_s >= unload_s - SURFACE_MEAN_S) & (time_s < unload_s - END_GAP_S)
    readings = test.disks[disk].readings_degC[partition.rows][averaged].mean(axis=0)
    # The fits use readings without the harmonic: add it again.
    readings += harmonic_K(test.harmonics[disk], setup, np.array([-0.5 * SURFACE_MEAN_S]))[0]
    used = [c for c in setup.channels if c not in test.disks[disk].excluded]
    return CircumferentialTemperature(
        disk=disk,
        setup=setup,
        depth_m=depth,
        angle_deg=ANGLES_DEG,
        middle_degC=even[:N_DEPTHS, None] + np.outer(shape, level @ directions),
        surface_degC=even[N_DEPTHS:].mean() + shape[0] * (level @ directions),
        surface_u_K=np.asarray(np.hypot(shape[0] * np.sqrt(variance), even_u), dtype=float),
        reading_degC={c: float(readings[setup.channels.index(c)]) for c in used},
    )
