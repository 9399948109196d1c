"""Sensor faults that show before the load: a disk at rest at ambient has one temperature.

Under load an offset of the inner row, or two of its channels exchanged, are nearly the same as
another h and an uneven press fit. At rest no model is needed. Used by
:mod:`tcdyn.partition.sensor_check` and, for exchanged cables and for disks that differ, by
:mod:`tcdyn.partition.analyse`.
Guarded by ``tests/partition/test_sensors.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from tcdyn.core import Array
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Finding, warning
from tcdyn.partition.events import EhlTest
from tcdyn.partition.sensor_faults import Suspect
from tcdyn.partition.window import rows_between
from tcdyn.rig.disk import DISKS
from tcdyn.rig.static_line import shared_u_K
from tcdyn.smoothing.traces import DiskTraces

# A disk at rest. Chosen by judgement.
REST_S = 10.0  # length of the window before the loading [s]
REST_GAP_S = 0.5  # its end before the loading [s]
MIN_REST_FRACTION = 0.3  # least part of the window that the log must hold
AT_REST_K = 5.0  # largest mean excess over ambient [K]
REST_U_K = 0.07  # standard deviation of the junctions' temperatures at rest [K]
WARM_REL = 0.1  # the same by the disk's excess over ambient, relative to that
MEAN_NOISE = 0.2  # noise of the mean over the window, relative to that of a sample, maybe coloured
# Disks at rest whose medians differ by more than this [K, standard uncertainties] are reported: an
# error of 4 % of the temperature between the disks at 60 degC. Sound disks whose running surfaces
# are cooled to 8 K below ambient differ by 2 K (tests/partition/test_statement.py).
MIN_DISKS_DIFFER_K = 2.5
MIN_DISKS_DIFFER_Z = 5.0
# An offset is larger than these [K, standard uncertainties]; the drift at rest is smaller.
# Chosen by judgement.
MIN_OFFSET_K = 0.75
MIN_OFFSET_Z = 5.0
# The disk does not fit one temperature below this probability of chi-squared; with two channels
# exchanged it does above the other one. Chosen by judgement.
MISFIT_P = 1e-4
LIKELY_P = 0.01
SURE_LOG_ODDS = 6.0  # log-odds from which an exchange at rest is reported
# The disks' cables are exchanged if that leaves less than this part of the misfit.
MAX_MISFIT_RATIO = 0.3


@dataclass(frozen=True)
class DiskAtRest:
    """Readings of a disk at rest.

    Parameters
    ----------
    disk
        The traces of the disk.
    mean, u
        Mean readings [degC] and their standard uncertainties [K], (C,).
    used
        Indices of the channels used.
    """

    disk: DiskTraces
    mean: Array
    u: Array
    used: NDArray[np.int64]

    def deviation(self, reads: Array) -> Array:
        """Deviation of ``reads`` (C,) from the median of the channels used [K]."""
        return np.asarray(reads - np.median(reads[self.used]))

    def misfit(self, reads: Array, excluded: int = -1) -> float:
        """Chi-squared of readings against one temperature, their median.

        Parameters
        ----------
        reads
            The readings, (C,) [degC].
        excluded
            Index of a channel that does not count; none if negative.
        """
        channels = self.used[self.used != excluded]
        return float(((self.deviation(reads) / self.u)[channels] ** 2).sum())

    def read_through(self, other: DiskAtRest, order: Sequence[int]) -> Array:
        """Channels of another disk through this disk's static lines, (C,) [degC].

        Parameters
        ----------
        other
            The other disk, or the same.
        order
            For each static line, the channel of ``other`` that is read through it.
        """
        lines = self.disk.lines
        other_lines = other.disk.lines
        raw = [(other.mean[k] - other_lines[k].offset) / other_lines[k].gain for k in order]
        return np.array([line.offset + line.gain * x for line, x in zip(lines, raw)])


def disk_at_rest(test: EhlTest, disk: DiskTraces) -> DiskAtRest | None:
    """The disk before the load; None where the log begins late, or the disk is warm or warms up.

    Parameters
    ----------
    test, disk
        The test, and the traces of the disk.

    Notes
    -----
    The drift is the change of the median channel from the first to the last third of the window.
    ``AT_REST_K`` may be raised: a warmer disk has a larger scatter by ``WARM_REL``, so faults are
    then found less often. ``tests/partition/test_sensors.py`` tests a warm disk.
    """
    load_on_s = test.events.load_on_s
    rows = rows_between(test.time_s, load_on_s - REST_S, load_on_s - REST_GAP_S)
    used = np.flatnonzero(~disk.excluded_mask)
    y = disk.readings_degC[rows]
    if len(y) < MIN_REST_FRACTION * REST_S / test.dt_s:
        return None
    third = len(y) // 3
    mean = y.mean(axis=0)
    change = y[-third:].mean(axis=0) - y[:third].mean(axis=0)
    drift_K = abs(float(np.median(change[used])))
    ambient = float(test.ambient_of(disk.name)[rows].mean())
    excess_K = float(np.median(mean[used])) - ambient
    if drift_K > MIN_OFFSET_K or abs(excess_K) > AT_REST_K:
        return None
    scatter = np.hypot(REST_U_K, WARM_REL * excess_K)
    u = np.hypot(disk.static_u(mean), np.hypot(MEAN_NOISE * disk.noise_K, scatter))
    return DiskAtRest(disk, mean, u, used)


def cables_exchanged(test: EhlTest) -> bool:
    """Whether the disks' readings at rest agree far better through each other's static lines.

    Parameters
    ----------
    test
        The test; False unless both disks are at rest and have as many channels.

    Notes
    -----
    Two conditions: log-odds above ``SURE_LOG_ODDS``, and a misfit below ``MAX_MISFIT_RATIO`` of
    that as wired, so that one channel that is wrong through any line is no exchange.
    ``tests/partition/test_sensors.py`` tests both.
    """
    fast, slow = (disk_at_rest(test, test.disks[d]) if d in test.disks else None for d in DISKS)
    if fast is None or slow is None or len(fast.mean) != len(slow.mean):
        return False
    order = range(len(fast.mean))
    exchanged = fast.misfit(fast.read_through(slow, order))
    exchanged += slow.misfit(slow.read_through(fast, order))
    as_wired = fast.misfit(fast.mean) + slow.misfit(slow.mean)
    surely = as_wired - exchanged > 2 * SURE_LOG_ODDS
    return surely and exchanged < MAX_MISFIT_RATIO * as_wired


def disks_differ(test: EhlTest) -> list[Finding]:
    """A warning if both disks are at rest and do not read one temperature.

    An error of the sensitivity that all channels of a disk have in common changes beta, and the
    fits do not show it.

    Parameters
    ----------
    test
        The test.

    Notes
    -----
    ``tests/partition/test_sensors.py`` has disks with other sensitivities.
    """
    rests = [disk_at_rest(test, disk) for disk in test.disks.values()]
    if len(rests) < 2 or cables_exchanged(test):
        return []
    medians = []
    variances = []
    for rest in rests:
        if rest is None:
            return []
        medians.append(float(np.median(rest.mean[rest.used])))
        own_var = np.mean(rest.u[rest.used] ** 2) / len(rest.used)
        reference_u_K = shared_u_K(rest.disk.lines)[rest.used].mean()
        variances.append(float(own_var + reference_u_K**2))
    names = list(test.disks)
    higher, lower = (names[0], names[1]) if medians[0] > medians[1] else (names[1], names[0])
    difference_K = abs(medians[0] - medians[1])
    u_K = float(np.sqrt(sum(variances)))
    if difference_K < max(MIN_DISKS_DIFFER_K, MIN_DISKS_DIFFER_Z * u_K):
        return []
    return [
        warning(
            "rest.disks_differ",
            higher=higher,
            lower=lower,
            difference_K=difference_K,
            u_K=u_K,
        )
    ]


def faults_at_rest(test: EhlTest) -> dict[str, tuple[Suspect, ...]]:
    """Faults of each disk that show before the load.

    No faults where the disks' cables look exchanged as a whole; the fits show that.

    Parameters
    ----------
    test
        The test.

    Returns
    -------
    dict
        By disk, the suspects.
    """
    faults: dict[str, tuple[Suspect, ...]] = dict.fromkeys(test.disks, ())
    if not cables_exchanged(test):
        for name, disk in test.disks.items():
            at_rest = disk_at_rest(test, disk)
            faults[name] = () if at_rest is None else faults_of_disk(at_rest)
    return faults


def faults_of_disk(at_rest: DiskAtRest) -> tuple[Suspect, ...]:
    """Two channels exchanged, or channels with an offset, of a disk at rest.

    Two channels are exchanged if each reads like the rest of the disk through the other's static
    line, and no single channel with an offset would explain the readings as well. Otherwise the
    result is the channels, two at most, that have an offset.

    Parameters
    ----------
    at_rest
        The disk.

    Returns
    -------
    tuple
        The suspects.
    """
    return _exchanged_channels(at_rest) or _offsets(at_rest)


def _exchanged_channels(at_rest: DiskAtRest) -> tuple[Suspect, ...]:
    """The exchange of two channels that explains the readings; one suspect or none.

    It must explain them far better than the next exchange, and than one channel with an offset.
    """
    as_wired = at_rest.misfit(at_rest.mean)
    dof = len(at_rest.used) - 1
    one_offset = min(at_rest.misfit(at_rest.mean, k) for k in at_rest.used)
    candidates = []
    for i, j in combinations(at_rest.used, 2):
        order = [*range(len(at_rest.mean))]
        order[i] = j
        order[j] = i
        candidates.append((at_rest.misfit(at_rest.read_through(at_rest, order)), i, j))
    (misfit, i, j), second = sorted(candidates)[:2]
    explains = chdtrc(dof, as_wired) < MISFIT_P and chdtrc(dof, misfit) > LIKELY_P
    if not explains or min(second[0], one_offset) - misfit <= 2 * SURE_LOG_ODDS:
        return ()
    channels = at_rest.disk.setup.channels
    pair = (channels[i], channels[j])
    return (Suspect(at_rest.disk.name, "swapped", pair, log_odds=0.5 * (as_wired - misfit)),)


def _offsets(at_rest: DiskAtRest) -> tuple[Suspect, ...]:
    """The one or two channels with an offset, if all others agree; else none."""
    deviation = at_rest.deviation(at_rest.mean)
    limit = np.maximum(MIN_OFFSET_Z * at_rest.u, MIN_OFFSET_K)
    outliers = [k for k in at_rest.used if abs(deviation[k]) > limit[k]]
    others = [deviation[k] for k in at_rest.used if k not in outliers]
    if not 1 <= len(outliers) <= 2 or np.ptp(others) > MIN_OFFSET_K:
        return ()
    suspects = []
    for k in outliers:
        size = Estimate.normal(float(deviation[k]), float(at_rest.u[k]))
        odds = 0.5 * (size.value / size.u) ** 2
        channel = at_rest.disk.setup.channels[k]
        suspects.append(Suspect(at_rest.disk.name, "offset", (channel,), size, odds))
    return tuple(suspects)
