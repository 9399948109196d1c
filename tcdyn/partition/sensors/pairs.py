"""Does each pair of junctions read as conduction demands? The tables of section 6.4.3, with uncertainties."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from calibration.disk import CHANNELS, DiskSetup
from tcdyn.partition.prepare import EhlTest
from tcdyn.partition.sensors.features import DiskFeatures
from tcdyn.traces import DiskTraces

SAME_PLACE_M = 0.15e-3
SURE_Z = 2.0
ASYMMETRY_Z = 3.0
SAME_GROUP_DEG = 60.0
LAG_U_S = 0.05


@dataclass(frozen=True)
class _Level:
    """Six numbers with their standard uncertainties [K]."""

    value: NDArray[np.float64]
    u: NDArray[np.float64]


def angle_groups(setup: DiskSetup) -> tuple[tuple[str, ...], ...]:
    """Channels by where they sit round the disk: neighbours within 60 degrees belong together, largest angle gap first.

    >>> from calibration.rig import load_rig
    >>> angle_groups(load_rig().disk_setup("slow"))
    (('a', 'c', 'd'), ('b', 'e', 'f'))
    """
    angles = {c: setup.junctions[c].angle_deg % 360.0 for c in CHANNELS}
    order = sorted(CHANNELS, key=lambda c: angles[c])
    gaps = [(angles[order[(k + 1) % 6]] - angles[c]) % 360.0 for k, c in enumerate(order)]
    cuts = [k for k, gap in enumerate(gaps) if gap > SAME_GROUP_DEG]
    if len(cuts) < 2:
        return (CHANNELS,)
    groups = []
    for one, other in zip(cuts, [*cuts[1:], cuts[0] + len(order)]):
        groups.append(tuple(sorted(order[k % 6] for k in range(one + 1, other + 1))))
    return tuple(sorted(groups))


def demand(setup: DiskSetup, one: str, other: str) -> int | None:
    """1 when ``one`` must be the hotter, -1 when ``other`` must, 0 when neither by symmetry, None when it depends.

    Under contact heat flows in at the centre of the track and away from it: nearer the surface and nearer the centre
    is hotter (section 6.4.2).
    """
    i, j = setup.junctions[one], setup.junctions[other]
    middle = 0.5 * setup.width_m
    steps = (j.depth_m - i.depth_m, abs(j.z_m - middle) - abs(i.z_m - middle))
    signs = {0 if abs(s) < SAME_PLACE_M else int(np.sign(s)) for s in steps}
    if signs == {0}:
        return 0
    signs.discard(0)
    return signs.pop() if len(signs) == 1 else None


def said_of(wanted: int | None, difference_K: float, u_K: float) -> str:
    """ "logical", "weak", "illogical" or "N.A." for a pair that reads ``difference_K`` apart.

    >>> said_of(1, 3.0, 0.3), said_of(1, 0.2, 0.3), said_of(1, -3.0, 0.3), said_of(None, 3.0, 0.3)
    ('logical', 'weak', 'illogical', 'N.A.')
    """
    if wanted is None:
        return "N.A."
    if wanted == 0:
        return "logical" if abs(difference_K) <= ASYMMETRY_Z * u_K else "weak"
    z = wanted * difference_K / u_K
    return "logical" if z > SURE_Z else "illogical" if z < -SURE_Z else "weak"


def pair_table(test: EhlTest, disk: DiskTraces, f: DiskFeatures) -> pd.DataFrame:
    """A row for each pair: steady difference and that of the fall after unloading, what each says, and the groups."""
    steady, fall = _steady(test, disk, f), _fall(disk, f)
    groups = angle_groups(disk.setup)
    rows = []
    for one, other in combinations(CHANNELS, 2):
        i, j = CHANNELS.index(one), CHANNELS.index(other)
        wanted = demand(disk.setup, one, other)
        row: dict[str, object] = {
            "disk": disk.name, "one": one, "other": other,
            "same_group": any(one in g and other in g for g in groups),
        }  # fmt: skip
        for name, level in (("steady", steady), ("unloading", fall)):
            gap = float(level.value[i] - level.value[j])
            spread = float(np.hypot(level.u[i], level.u[j]))
            row |= {f"{name}_difference_K": gap, f"{name}_u_K": spread, name: said_of(wanted, gap, spread)}
        rows.append(row)
    return pd.DataFrame(rows)


def pair_matrix(table: pd.DataFrame, disk: DiskTraces, column: str = "steady") -> pd.DataFrame:
    """The upper triangle as the thesis prints it (tables 6.2 to 6.4), channels in their groups."""
    order = [c for g in angle_groups(disk.setup) for c in g]
    said = {frozenset((r["one"], r["other"])): r[column] for _, r in table[table["disk"] == disk.name].iterrows()}
    body = [[said[frozenset((r, c))] if k > i else "" for k, c in enumerate(order)] for i, r in enumerate(order)]
    return pd.DataFrame(body, index=order, columns=order)


def _steady(test: EhlTest, disk: DiskTraces, f: DiskFeatures) -> _Level:
    """Steady level; its uncertainty from the static lines, and from the depth in the mean gradient of half the heat."""
    s = disk.setup
    power = float(test.power_W[test.rows(test.events.unload_s - 20.0, test.events.unload_s - 1.0)].mean())
    gradient = 0.5 * power / (2 * np.pi * s.outer_radius_m * s.width_m * s.conductivity_W_mK)
    level = f.levels[f.of("steady")][0]
    return _Level(level, np.hypot(disk.static_u_K, gradient * disk.uncertainty.depth_mm * 1e-3))


def _fall(disk: DiskTraces, f: DiskFeatures) -> _Level:
    """How far each reading fell one to two seconds after unloading; uncertainty from noise and differential lags."""
    after = [k for k, w in enumerate(f.windows) if w.event == "unloading"]
    k = after[min(1, len(after) - 1)]
    noise = f.noise[k] * np.maximum(disk.noise_K, 1e-3)
    return _Level(-f.levels[k], np.hypot(noise, LAG_U_S * np.abs(f.slope[k])))
