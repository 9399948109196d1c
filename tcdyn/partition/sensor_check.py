"""Sensor check of a test (section 6.4): dead, swapped, misplaced, offset or late channels.

The outer row is predicted from the inner row, when steady and after both events; a fault is
reported when it explains the readings far better than a sound disk does. Faults that show before
the load come first (:mod:`tcdyn.partition.at_rest`). The result also has the table of pairs of
section 6.4 and the depths of the junctions. Used by :mod:`tcdyn.partition.analyse`,
:mod:`tcdyn.partition.crosscheck` and the report. Thresholds are chosen by judgement. Guarded
by ``tests/partition/test_sensors.py`` and ``tests/partition/test_left_out.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, combinations, product
from typing import Any

import numpy as np
import pandas as pd
from scipy.sparse.csgraph import connected_components
from scipy.special import chdtrc

from tcdyn.core.findings import Finding, info
from tcdyn.partition.at_rest import MISFIT_P, faults_at_rest
from tcdyn.partition.events import EhlTest
from tcdyn.partition.sensor_faults import (
    DepthTest,
    Suspect,
    depth_test,
    fit_fault,
    fit_faults,
    refine_fault,
)
from tcdyn.partition.sensor_window import SensorWindow, sensor_window
from tcdyn.rig.disk import DISKS, LEFT_OUT_TEXT, DiskSetup

# A fault is named when it is e^8 = 3000 times as likely as a sound disk, against 28 faults.
FAULT_LOG_ODDS = 8.0
# Rivals within e^4 = 55 times are named with it. A swap between the disks must be as much likelier
# than the best hypotheses of both disks together.
RIVAL_LOG_ODDS = 4.0
# Swaps within e^4 of a sound disk cannot be distinguished from it.
INDISTINGUISHABLE_LOG_ODDS = 4.0
# A dead channel rises and falls by less than this part of the median of the disk's channels.
DEAD_REL = 0.25
MIN_RISE_K = 3.0  # least median rise at which a dead channel can be detected [K]
MIN_REST_SAMPLES = 10  # least number of samples before the load that give a rise
SAME_POSITION_M = 0.15e-3  # junctions nearer than this are at the same position [m]
SURE_Z = 2.0  # a difference is sure beyond this many standard uncertainties
ASYMMETRY_Z = 3.0  # the same for junctions that should read alike
LAG_U_S = 0.05  # standard uncertainty of a lag, for the fall after unloading [s]
SAME_GROUP_DEG = 60.0  # neighbours within this angle belong to one group [deg]

Candidate = tuple[str, ...]  # channels of a swap


@dataclass(frozen=True)
class SensorCheck:
    """Result of the sensor check.

    Parameters
    ----------
    table
        A row for each pair of junctions of each disk.
    findings
        The findings of each disk.
    suspects
        All suspected faults.
    bulk_degC
        Mean of the junctions of each disk in steady state (6.4.1).
    indistinguishable
        Swaps of each disk that this test cannot distinguish from a sound disk.
    depths
        Depths of the junctions by the test, for each disk that shows no fault.
    groups
        Channels of each disk by angle.
    """

    table: pd.DataFrame
    findings: dict[str, tuple[Finding, ...]]
    suspects: tuple[Suspect, ...]
    bulk_degC: dict[str, float]
    indistinguishable: dict[str, tuple[tuple[str, ...], ...]]
    depths: dict[str, DepthTest]
    groups: Mapping[str, tuple[tuple[str, ...], ...]]

    @property
    def texts(self) -> dict[str, str]:
        """The findings of each disk as text."""
        return {
            d: " ".join(f"{finding.sentence}." for finding in findings)
            for d, findings in self.findings.items()
        }

    @property
    def sound(self) -> bool:
        """Whether no channel is suspected."""
        return not self.suspects

    def matrix(self, disk: str, column: str = "steady") -> pd.DataFrame:
        """The pairs of one disk as in tables 6.2 to 6.4: upper triangle, channels in groups.

        Parameters
        ----------
        disk
            Name of the disk.
        column
            "steady" or "unloading".
        """
        order = [c for group in self.groups[disk] for c in group]
        rows = self.table[self.table["disk"] == disk]
        classes = rows.pivot(index="one", columns="other", values=column)
        classes = classes.reindex(index=order, columns=order)
        is_upper = np.triu(np.ones(classes.shape, dtype=bool), 1)
        classes = classes.fillna(classes.T).where(is_upper, "")
        return classes.rename_axis(index=None, columns=None)


@dataclass(frozen=True)
class _DiskCheck:
    """Result of the check of one disk.

    Parameters
    ----------
    suspects
        Suspected faults.
    log_likelihood
        Of the best hypothesis; None where a channel is dead.
    depths
        The depth test; None where a fault is suspected.
    indistinguishable
        Swaps that the test cannot distinguish from a sound disk.
    """

    suspects: tuple[Suspect, ...]
    log_likelihood: float | None = None
    depths: DepthTest | None = None
    indistinguishable: tuple[Candidate, ...] = ()


def check_sensors(test: EhlTest) -> SensorCheck:
    """Look for faulty channels in the steady pattern and in both transients of a test.

    Parameters
    ----------
    test
        The prepared test, with one or both disks.

    Notes
    -----
    The outer row is predicted from the inner row by the rim model, steady, after unloading and
    after loading, with share and h free. A fault is reported when it explains all three far better
    than a sound disk does. Two channels whose junctions read nearly alike (d and f) cannot be
    distinguished: ``indistinguishable`` lists such pairs.

    Faults at rest replace those under load, except for dead channels, because at rest no model is
    needed. A swap between the disks is tried only if both disks are suspected.
    ``tests/partition/test_sensors.py`` (mostly study) tests each kind of fault, and sound rigs.
    """
    windows = {d: sensor_window(test, disk) for d, disk in test.disks.items()}
    checks = {d: _check_disk(test, f) for d, f in windows.items()}
    at_rest = faults_at_rest(test)
    suspects = {d: check.suspects for d, check in checks.items()}
    for d, check in checks.items():
        if check.log_likelihood is not None:
            suspects[d] = at_rest[d] or suspects[d]
    sound = {d: check for d, check in checks.items() if not suspects[d]}
    likelihoods = [c.log_likelihood for c in checks.values() if c.log_likelihood is not None]
    swap: tuple[Suspect, ...] = ()
    if all(suspects.values()) and len(likelihoods) == len(DISKS):
        swap = _swap_between_disks(windows, sum(likelihoods))
    if swap:
        suspects = dict.fromkeys(DISKS, swap)
    groups = {d: angle_groups(disk.setup) for d, disk in test.disks.items()}
    table = pd.concat(
        [pair_table(f, groups[d]) for d, f in windows.items()],
        ignore_index=True,
    )
    findings = {
        d: tuple(s.finding for s in suspects[d]) or (_sound(d, table, check.indistinguishable),)
        for d, check in checks.items()
    }
    return SensorCheck(
        table=table,
        findings=findings,
        suspects=swap or tuple(chain(*suspects.values())),
        bulk_degC={d: float(f.levels[0].mean()) for d, f in windows.items()},
        indistinguishable={d: c.indistinguishable if d in sound else () for d, c in checks.items()},
        depths={d: check.depths for d, check in sound.items() if check.depths is not None},
        groups=groups,
    )


def _sound(disk: str, table: pd.DataFrame, indistinguishable: Sequence[Candidate]) -> Finding:
    """The finding of a disk without faults.

    Parameters
    ----------
    disk
        Name of the disk.
    table
        The pairs of all disks.
    indistinguishable
        Swaps that the test cannot distinguish from a sound disk.
    """
    rows = table[(table["disk"] == disk) & (table["steady"] != LEFT_OUT_TEXT)]
    return info(
        "sensors.sound",
        subject=disk,
        illogical=int((rows["steady"] == "illogical").sum()),
        pairs=len(rows),
        blind=["-".join(pair) for pair in indistinguishable],
    )


def _check_disk(test: EhlTest, window: SensorWindow) -> _DiskCheck:
    """Dead channels, else the likeliest fault, else depths and indistinguishable swaps.

    Parameters
    ----------
    test
        The test.
    window
        Window of the disk.

    Notes
    -----
    Where no fault is likely but chi-squared is improbable (``MISFIT_P``), the suspect is "unknown".
    So is a swap that does not explain the data: it must not stop a run.
    """
    disk = window.disk
    dead = _dead_channels(test, window)
    if dead:
        return _DiskCheck(dead)
    sound, *fits = fit_faults(window)
    fits.sort(key=lambda fit: -fit.log_likelihood)
    numbers: dict[str, Any] = {}
    is_faulty = fits[0].log_likelihood - sound.log_likelihood > FAULT_LOG_ODDS
    if is_faulty:
        refined = [
            refine_fault(test, disk, fit) if fit.log_likelihood > sound.log_likelihood else fit
            for fit in fits
        ]
        fits = sorted(refined, key=lambda fit: -fit.log_likelihood)
        near = fits[0].log_likelihood - RIVAL_LOG_ODDS
        rivals = [fit for fit in fits[1:] if fit.log_likelihood > near]
        numbers["rivals"] = [f"{r.kind} {'-'.join(r.channels)}" for r in rivals[:3]]
    elif chdtrc(sound.dof, sound.chi2) >= MISFIT_P:
        near = sound.log_likelihood - INDISTINGUISHABLE_LOG_ODDS
        blind = [fit for fit in fits if fit.kind == "swapped" and fit.log_likelihood > near]
        swaps = tuple(sorted(fit.channels for fit in blind))
        return _DiskCheck((), sound.log_likelihood, depth_test(window, sound), swaps)
    best = fits[0]
    log_odds = best.log_likelihood - sound.log_likelihood
    explains = best.kind != "swapped" or chdtrc(best.dof, best.chi2) >= MISFIT_P
    if is_faulty and explains:
        suspect = Suspect(disk.name, best.kind, best.channels, best.size, log_odds, numbers)
        return _DiskCheck((suspect,), best.log_likelihood)
    numbers |= {"chi2": sound.chi2, "dof": sound.dof}
    unknown = Suspect(disk.name, "unknown", log_odds=log_odds, numbers=numbers)
    return _DiskCheck((unknown,), sound.log_likelihood)


def _swap_between_disks(
    windows: Mapping[str, SensorWindow], log_likelihood: float
) -> tuple[Suspect, ...]:
    """A channel of one disk exchanged with one of the other.

    Empty unless it is likelier than the best hypotheses of both disks together, by
    ``RIVAL_LOG_ODDS``.

    Parameters
    ----------
    windows
        Windows of both disks.
    log_likelihood
        Sum of the log likelihoods of the best hypotheses of the two disks: that of the most likely
        fault after ``tcdyn.partition.sensor_faults.refine_fault``, or that of a sound disk where
        no fault explains the readings.

    Returns
    -------
    tuple
        One suspect of the disk "both", with channels such as "fast_a" and "slow_c", or none.

    Notes
    -----
    The swap is compared as it is, without refinement. ``RIVAL_LOG_ODDS`` may change, which also
    changes the rivals that ``_check_disk`` names: a smaller value reports a swap where two
    faults explain the readings nearly as well. Guarded by
    ``test_channels_swapped_between_disks_are_identified`` and
    ``test_channels_swapped_between_disks_are_identified_when_their_lines_differ`` in
    ``tests/partition/test_sensors.py``, all marked study.
    """
    fast, slow = (windows[d] for d in DISKS)
    candidates = []
    for c, other in product(fast.used_channels, slow.used_channels):
        # the readings are taken as they are, through the static line and chain of their own disk
        fits = (
            fit_fault(fast, "foreign", (c,), {c: (slow, other)}),
            fit_fault(slow, "foreign", (other,), {other: (fast, c)}),
        )
        candidates.append((sum(fit.log_likelihood for fit in fits), c, other))
    best, c, other = max(candidates)
    if best - log_likelihood < RIVAL_LOG_ODDS:
        return ()
    channels = (f"fast_{c}", f"slow_{other}")
    return (Suspect("both", "swapped", channels, log_odds=best - log_likelihood),)


def _dead_channels(test: EhlTest, window: SensorWindow) -> tuple[Suspect, ...]:
    """Channels whose rise under load and whose fall after unloading are unlike the others'.

    Parameters
    ----------
    test
        The test.
    window
        Window of the disk.

    Notes
    -----
    Where the log begins too late for a rise, the fall decides. Both must be below ``DEAD_REL`` of
    the median, so a junction that is only slow is not dead.
    """
    disk = window.disk
    levels = window.by_channel(window.levels)
    before = test.time_s < test.events.load_on_s - 0.5
    falls = -levels[window.event == "unloading"][-1]
    rises = falls
    if before.sum() >= MIN_REST_SAMPLES:
        steady = levels[0]
        rises = steady - disk.readings_degC[before].mean(axis=0)
    usual_rise = float(np.median(rises))
    usual_fall = float(np.median(falls))
    if usual_rise <= MIN_RISE_K:
        return ()
    dead = (rises < DEAD_REL * usual_rise) & (falls < DEAD_REL * usual_fall) & ~disk.excluded_mask
    return tuple(
        Suspect(
            disk.name,
            "dead",
            (disk.setup.channels[i],),
            numbers={
                "rise_K": float(rises[i]),
                "fall_K": float(falls[i]),
                "usual_rise_K": usual_rise,
                "usual_fall_K": usual_fall,
            },
        )
        for i in np.flatnonzero(dead)
    )


def angle_groups(setup: DiskSetup) -> tuple[tuple[str, ...], ...]:
    """Channels by angle: neighbours within 60 degrees belong to one group.

    Parameters
    ----------
    setup
        The disk.

    Returns
    -------
    tuple
        The groups, each sorted, in alphabetic order; one group of all if the angles do not
        separate.

    Examples
    --------
    >>> from tcdyn.rig.rigfile import load_rig
    >>> angle_groups(load_rig().disk_setup("slow"))
    (('a', 'e', 'f'), ('b', 'c', 'd'))
    """
    angle = np.array([setup.junctions[c].angle_deg for c in setup.channels])
    between = np.abs((angle[:, None] - angle + 180.0) % 360.0 - 180.0)
    n_groups, group = connected_components(between <= SAME_GROUP_DEG)
    members = [[c for c, g in zip(setup.channels, group) if g == k] for k in range(n_groups)]
    return tuple(sorted(tuple(sorted(channels)) for channels in members))


def hotter_junction(setup: DiskSetup, first: str, other: str) -> int | None:
    """Which of two junctions must be hotter under contact.

    Parameters
    ----------
    setup
        The disk.
    first, other
        The channels.

    Returns
    -------
    int or None
        1 if ``first`` must be hotter, -1 if ``other`` must, 0 by symmetry, None if it depends.

    Notes
    -----
    Under contact heat flows in at the centre of the track and away from it: nearer the surface and
    nearer the centre is hotter (section 6.4.2). Junctions within ``SAME_POSITION_M`` count as
    equal.
    """
    i = setup.junctions[first]
    j = setup.junctions[other]
    middle = 0.5 * setup.width_m
    depth_difference = j.depth_m - i.depth_m
    z_difference = abs(j.z_m - middle) - abs(i.z_m - middle)
    signs = {
        int(np.sign(difference))
        for difference in (depth_difference, z_difference)
        if abs(difference) >= SAME_POSITION_M
    }
    return None if len(signs) == 2 else sum(signs)


def classify_pair(sign: int | None, difference_K: float, u_K: float) -> str:
    """Class of a pair: "logical", "weak", "illogical" or "N.A.".

    Parameters
    ----------
    sign
        Sign that the difference must have, by :func:`hotter_junction`.
    difference_K, u_K
        The difference, and its standard uncertainty.

    Examples
    --------
    >>> classify_pair(1, 3.0, 0.3), classify_pair(1, 0.2, 0.3)
    ('logical', 'weak')
    >>> classify_pair(1, -3.0, 0.3), classify_pair(None, 3.0, 0.3)
    ('illogical', 'N.A.')
    """
    if sign is None:
        return "N.A."
    if sign == 0:
        return "logical" if abs(difference_K) <= ASYMMETRY_Z * u_K else "weak"
    z = sign * difference_K / u_K
    if z > SURE_Z:
        return "logical"
    return "illogical" if z < -SURE_Z else "weak"


def pair_table(window: SensorWindow, groups: tuple[tuple[str, ...], ...]) -> pd.DataFrame:
    """A row for each pair of junctions: differences when steady and of the fall, classes, groups.

    Parameters
    ----------
    window
        Window of the disk.
    groups
        Channels by angle.

    Returns
    -------
    table
        Columns disk, one, other, same_group; for "steady" and "unloading" the difference [K], its
        standard uncertainty [K], and the class.

    Notes
    -----
    The uncertainty of a steady level is that of its static line and of its depth in the mean
    gradient; that of a fall by noise and lag. The gradient assumes that half of the frictional heat
    enters the disk.
    """
    disk = window.disk
    setup = disk.setup
    area = 2 * np.pi * setup.outer_radius_m * setup.width_m
    power_W = window.rim.inputs[0, 0]
    gradient = 0.5 * power_W / (area * setup.conductivity_W_mK)  # of half the heat
    depth_u_K = gradient * disk.uncertainty.depth_mm * 1e-3
    k = int(np.flatnonzero(window.event == "unloading")[:2][-1])  # one to two seconds after it
    noise = np.sqrt(window.noise_var[k]) * disk.noise_K
    steady, fall, rate = window.by_channel(
        np.array([window.levels[0], -window.levels[k], window.slopes[k]])
    )
    levels = {
        "steady": (steady, np.hypot(disk.static_u_K, depth_u_K)),
        "unloading": (fall, np.hypot(noise, LAG_U_S * np.abs(rate))),
    }
    i, j = np.triu_indices(len(setup.channels), 1)
    pairs = [*combinations(setup.channels, 2)]
    signs = [hotter_junction(setup, *pair) for pair in pairs]
    excluded = disk.excluded_mask[i] | disk.excluded_mask[j]
    one, other = zip(*pairs)
    same_group = [any({*pair} <= {*group} for group in groups) for pair in pairs]
    table = pd.DataFrame({"disk": disk.name, "one": one, "other": other, "same_group": same_group})
    for name, (level, u) in levels.items():
        difference = np.where(excluded, np.nan, level[i] - level[j])
        difference_u = np.hypot(u[i], u[j])
        classes = [classify_pair(*row) for row in zip(signs, difference, difference_u)]
        table[f"{name}_difference_K"] = difference
        table[f"{name}_u_K"] = difference_u
        table[name] = np.where(excluded, LEFT_OUT_TEXT, classes)
    return table
