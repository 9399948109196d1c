"""Faults that show before the load: a disk that rests at ambient has one temperature.

Under load an offset of the inner row, or two of its channels exchanged, are nearly another h and a disk that sits
unevenly.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from tcdyn.core import Array
from tcdyn.core.estimate import Estimate
from tcdyn.partition.events import EhlTest
from tcdyn.partition.sensor_faults import Fault
from tcdyn.partition.window import between
from tcdyn.rig.disk import DISKS
from tcdyn.smoothing.traces import DiskTraces

# before the load: how long, how near ambient, what is an offset
REST_S = 10.0
AT_REST_K = 5.0
MIN_OFFSET_K = 0.75
MIN_OFFSET_Z = 5.0
# how alike a disk at rest is; a swap that explains it, surely
REST_U_K = 0.07
LIKELY_P = 0.01
SURE_LOG_ODDS = 6.0
WARM_REL = 0.1  # of a disk's excess over ambient, by which its junctions may differ
MAX_MISFIT_RATIO = 0.3  # of the misfit at rest, when the disks' cables were exchanged
MISFIT_P = 1e-4
MEAN_NOISE = 0.2  # of the noise of a sample, coloured as it may be, in the mean of that time


@dataclass(frozen=True)
class DiskAtRest:
    """Mean readings (C,) of a disk at rest [degC], their standard uncertainties (C,) [K], and the channels used."""

    disk: DiskTraces
    mean: Array
    u: Array
    used: NDArray[np.int64]

    def deviation(self, reads: Array) -> Array:
        """Departures of ``reads`` (C,) from the middle of the channels used [K]."""
        return np.asarray(reads - np.median(reads[self.used]))

    def misfit(self, reads: Array, but: int = -1) -> float:
        """Chi-squared of ``reads`` (C,) against one temperature, one channel left out if told."""
        return float(((self.deviation(reads) / self.u)[self.used[self.used != but]] ** 2).sum())

    def read_through(self, other: DiskAtRest, order: Sequence[int]) -> Array:
        """What the disk's lines make of another's channels ``order`` (C,), whose own lines are undone [degC]."""
        mine = self.disk.lines
        theirs = other.disk.lines
        raw = [(other.mean[k] - theirs[k].offset) / theirs[k].gain for k in order]
        return np.array([line.offset + line.gain * x for line, x in zip(mine, raw)])


def disk_at_rest(test: EhlTest, disk: DiskTraces) -> DiskAtRest | None:
    """The disk before the load; None where the log begins late, or the disk is warm or warms up."""
    rest = between(test.time_s, test.events.load_on_s - REST_S, test.events.load_on_s - 0.5)
    used = np.flatnonzero(~disk.out)
    y = disk.readings_degC[rest]
    if len(y) < 0.3 * REST_S / test.dt_s:
        return None
    third = len(y) // 3
    mean = y.mean(axis=0)
    drift = abs(float(np.median((y[-third:].mean(axis=0) - y[:third].mean(axis=0))[used])))
    warm_K = float(np.median(mean[used])) - float(test.ambient_of(disk.name)[rest].mean())
    if drift > MIN_OFFSET_K or abs(warm_K) > AT_REST_K:
        return None
    alike = np.hypot(REST_U_K, WARM_REL * warm_K)
    return DiskAtRest(
        disk, mean, np.hypot(disk.static_u(mean), np.hypot(MEAN_NOISE * disk.noise_K, alike)), used
    )


def cables_exchanged(test: EhlTest) -> bool:
    """Whether the disks' readings at rest agree far better through each other's static lines."""
    fast, slow = (disk_at_rest(test, test.disks[d]) if d in test.disks else None for d in DISKS)
    if fast is None or slow is None or len(fast.mean) != len(slow.mean):
        return False
    as_wired = range(len(fast.mean))
    crossed = fast.misfit(fast.read_through(slow, as_wired)) + slow.misfit(
        slow.read_through(fast, as_wired)
    )
    usual = fast.misfit(fast.mean) + slow.misfit(slow.mean)
    return usual - crossed > 2 * SURE_LOG_ODDS and crossed < MAX_MISFIT_RATIO * usual


def faults_at_rest(test: EhlTest) -> Mapping[str, list[tuple[Fault, Estimate | None, float]]]:
    """Faults of each disk that show before the load, with size [K] and log-odds; none where the disks' cables look
    exchanged as a whole, which the fits tell."""
    if cables_exchanged(test):
        return {d: [] for d in test.disks}
    found = {d: disk_at_rest(test, disk) for d, disk in test.disks.items()}
    return {d: [] if rest is None else faults_of_disk(rest) for d, rest in found.items()}


def faults_of_disk(rest: DiskAtRest) -> list[tuple[Fault, Estimate | None, float]]:
    """Two channels exchanged, where each through the other's static line reads like the rest of the disk, and no single
    channel that is off would do as well; else those, two at most, that are off."""
    usual = rest.misfit(rest.mean)
    exchanged = []
    freedom = len(rest.used) - 1
    one_off = min(rest.misfit(rest.mean, k) for k in rest.used)
    for i, j in combinations(rest.used, 2):
        order = [*range(len(rest.mean))]
        order[i] = j
        order[j] = i
        exchanged.append((rest.misfit(rest.read_through(rest, order)), i, j))
    best, second = sorted(exchanged)[:2]
    explains = chdtrc(freedom, usual) < MISFIT_P and chdtrc(freedom, best[0]) > LIKELY_P
    if explains and min(second[0], one_off) - best[0] > 2 * SURE_LOG_ODDS:
        channels = rest.disk.setup.channels
        pair = channels[best[1]], channels[best[2]]
        return [(Fault("swapped", pair), None, 0.5 * (usual - best[0]))]
    away = rest.deviation(rest.mean)
    off = [k for k in rest.used if abs(away[k]) > max(MIN_OFFSET_Z * rest.u[k], MIN_OFFSET_K)]
    others = [away[k] for k in rest.used if k not in off]
    if not 1 <= len(off) <= 2 or np.ptp(others) > MIN_OFFSET_K:
        return []
    sizes = {k: Estimate.normal(float(away[k]), float(rest.u[k])) for k in off}
    return [
        (Fault("offset", (rest.disk.setup.channels[k],)), size, 0.5 * (size.value / size.u) ** 2)
        for k, size in sizes.items()
    ]
