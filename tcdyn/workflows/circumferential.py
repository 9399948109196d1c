"""The temperature round a disk of an analysed test: the rim model's even part and the first harmonic that was found."""

from __future__ import annotations

import numpy as np

from tcdyn.partition.analyse import Partition
from tcdyn.partition.angular_harmonic import harmonic_K, radial_shape
from tcdyn.partition.joint import LOG_H, SHARE
from tcdyn.partition.steady import END_GAP_S, LAST_S, SURFACE_DEPTH_M
from tcdyn.rig.circumferential import ANGLES_DEG, Around

DEPTHS = 25
ACROSS = 15


def around_disk(p: Partition, disk: str) -> Around:
    """A disk from its inner row to its running surface, by the fit of both disks, mean of the last seconds under load.

    T = T_0(r, z) + T_1(r) cos(angle - hottest); deeper than the junctions nothing is measured. The uncertainty is that
    of the harmonic, and of the even part what moves the running surface with the share's and h's joint uncertainty.
    """
    window = p.windows[disk]
    known = p.both.uneven[disk]
    setup = p.test.disks[disk].setup
    theta = p.both.theta[4 * (disk == "slow") :]
    share = float(theta[SHARE])
    h = float(np.exp(theta[LOG_H]))
    to_parting = window.at_s - p.test.events.unload_s
    last = (to_parting >= -LAST_S) & (to_parting < -END_GAP_S)
    depth = np.linspace(0.0, setup.edge_m, DEPTHS)
    middle = tuple((float(d), 0.5 * setup.width_m) for d in depth)
    across = tuple((SURFACE_DEPTH_M, (k + 0.5) / ACROSS * setup.width_m) for k in range(ACROSS))
    rest, power = (
        x[last].mean(axis=0)[len(setup.outer) :]
        for x in window.rim.answer(h, extra=(*middle, *across))
    )
    even = rest + share * power
    even -= setup.steel.straight(even) - even  # back from Kirchhoff's temperature, to first order
    at = np.deg2rad(ANGLES_DEG)
    sides = np.stack([np.cos(at), np.sin(at)])
    size = known.amplitude_K.value
    toward = np.deg2rad(known.angle_deg.value)
    level = size * np.array([np.cos(toward), np.sin(toward)])
    shape = radial_shape(setup, h, depth)
    spread = np.einsum("ia,ij,ja->a", sides, known.level_covariance_K2, sides)
    of_even = p.answers[f"surface {disk}"].u
    rows = p.test.time_s[p.rows]
    reads = p.test.disks[disk].readings_degC[p.rows]
    seen = reads[
        (rows >= p.test.events.unload_s - LAST_S) & (rows < p.test.events.unload_s - END_GAP_S)
    ].mean(axis=0)
    seen += harmonic_K(p.test.uneven[disk], setup, np.array([-0.5 * LAST_S]))[
        0
    ]  # what the fits look at is without
    used = [c for c in setup.channels if c not in p.test.disks[disk].left_out]
    return Around(
        disk=disk,
        setup=setup,
        depth_m=depth,
        angle_deg=ANGLES_DEG,
        middle_degC=even[:DEPTHS, None] + np.outer(shape, level @ sides),
        surface_degC=even[DEPTHS:].mean() + shape[0] * (level @ sides),
        surface_u_K=np.asarray(np.hypot(shape[0] * np.sqrt(spread), of_even), dtype=float),
        seen_degC={c: float(seen[setup.channels.index(c)]) for c in used},
    )
