"""Circumferential temperature of a disk: mean by the rim model plus first angular harmonic."""

from __future__ import annotations

import numpy as np

from tcdyn.partition.analyse import Partition
from tcdyn.partition.angular_harmonic import harmonic_K, radial_shape
from tcdyn.partition.joint import LOG_H, SHARE
from tcdyn.partition.steady import END_GAP_S, LAST_S, SURFACE_DEPTH_M
from tcdyn.rig.circumferential import ANGLES_DEG, Around

N_DEPTHS = 25
N_ACROSS = 15


def around_disk(p: Partition, disk: str) -> Around:
    """A disk from its inner row to its running surface, by the fit of both disks, mean of the last
    seconds under load.

    T = T_0(r, z) + T_1(r) cos(angle - hottest); deeper than the junctions nothing is measured. The
    uncertainty is that of the harmonic, and of the even part what moves the running surface with
    the share's and h's joint uncertainty.
    """
    window = p.windows[disk]
    harmonic = p.both.uneven[disk]
    setup = p.test.disks[disk].setup
    theta = p.both.theta[4 * (disk == "slow") :]
    share = float(theta[SHARE])
    h = float(np.exp(theta[LOG_H]))
    since_unloading_s = window.at_s - p.test.events.unload_s
    last = (since_unloading_s >= -LAST_S) & (since_unloading_s < -END_GAP_S)
    depth = np.linspace(0.0, setup.edge_m, N_DEPTHS)
    middle = tuple((float(d), 0.5 * setup.width_m) for d in depth)
    across = tuple((SURFACE_DEPTH_M, (k + 0.5) / N_ACROSS * setup.width_m) for k in range(N_ACROSS))
    rest, power = (
        x[last].mean(axis=0)[len(setup.outer) :]
        for x in window.rim.answer(h, extra=(*middle, *across))
    )
    even = rest + share * power
    even -= setup.steel.straight(even) - even  # back from Kirchhoff's temperature, to first order
    at = np.deg2rad(ANGLES_DEG)
    directions = np.stack([np.cos(at), np.sin(at)])
    amplitude = harmonic.amplitude_K.value
    angle = np.deg2rad(harmonic.angle_deg.value)
    level = amplitude * np.array([np.cos(angle), np.sin(angle)])
    shape = radial_shape(setup, h, depth)
    level_variance = np.einsum("ia,ij,ja->a", directions, harmonic.level_covariance_K2, directions)
    even_u = p.answers[f"surface {disk}"].u
    rows = p.test.time_s[p.rows]
    reads = p.test.disks[disk].readings_degC[p.rows]
    readings = reads[
        (rows >= p.test.events.unload_s - LAST_S) & (rows < p.test.events.unload_s - END_GAP_S)
    ].mean(axis=0)
    readings += harmonic_K(p.test.uneven[disk], setup, np.array([-0.5 * LAST_S]))[
        0
    ]  # what the fits look at is without
    used = [c for c in setup.channels if c not in p.test.disks[disk].left_out]
    return Around(
        disk=disk,
        setup=setup,
        depth_m=depth,
        angle_deg=ANGLES_DEG,
        middle_degC=even[:N_DEPTHS, None] + np.outer(shape, level @ directions),
        surface_degC=even[N_DEPTHS:].mean() + shape[0] * (level @ directions),
        surface_u_K=np.asarray(np.hypot(shape[0] * np.sqrt(level_variance), even_u), dtype=float),
        seen_degC={c: float(readings[setup.channels.index(c)]) for c in used},
    )
