"""Sensor check of a test (section 6.4): dead, swapped, misplaced, offset or late channels.

The outer row is predicted from the inner row, when steady and after both events; a fault is
reported when it explains the readings far better than a sound disk does. Faults that show before
the load come first (:mod:`tcdyn.partition.at_rest`). The result also has the table of pairs of
section 6.4 and the depths of the junctions. Used by :mod:`tcdyn.partition.analyse`,
:mod:`tcdyn.partition.single_disk`, :mod:`tcdyn.partition.crosscheck` and the report. Thresholds are
chosen by judgement. Guarded by ``tests/partition/test_sensors.py`` and
``tests/partition/test_left_out.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import chdtrc

from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Finding, error, info, warning
from tcdyn.partition.at_rest import MISFIT_P, faults_at_rest
from tcdyn.partition.disk_features import DiskFeatures, disk_features
from tcdyn.partition.events import EhlTest
from tcdyn.partition.sensor_faults import (
    DepthTest,
    Fault,
    FaultFit,
    depth_test,
    evaluate_faults,
    hypotheses,
    refine_fault,
)
from tcdyn.partition.window import rows_between
from tcdyn.rig.disk import DISKS, LEFT_OUT_TEXT, DiskSetup
from tcdyn.smoothing.traces import DiskTraces

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
LAST_S = (20.0, 1.0)  # before the unloading, window of the mean power [s]

Candidate = tuple[str, ...]  # channels of a swap


@dataclass(frozen=True)
class Suspect:
    """A suspected fault.

    Parameters
    ----------
    disk
        The disk; "both" for a swap between the disks, with channels such as "fast_a".
    kind
        "dead", "swapped", "misplaced", "offset", "late" or "unknown".
    channels
        The channels concerned.
    size
        How much deeper the junction lies than its nominal depth [m], how much it reads too high
        [K], or how late it is [s]; None for other kinds.
    log_odds
        Logarithm of the odds against a sound disk.
    numbers
        Further numbers of the message.
    """

    disk: str
    kind: str
    channels: tuple[str, ...]
    size: Estimate | None
    log_odds: float
    numbers: Mapping[str, Any] = field(default_factory=dict)

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns of the suspected channels in the log."""
        prefix = "" if self.disk == "both" else f"{self.disk}_"
        return tuple(f"{prefix}{c}_degC" for c in self.channels)

    @property
    def finding(self) -> Finding:
        """The fault as an error for a dead or swapped channel, else as a warning."""
        numbers: dict[str, Any] = {
            "kind": self.kind,
            "channels": self.channels,
            "columns": self.columns,
        }
        if self.kind not in ("dead", "unknown"):
            numbers["log_odds"] = self.log_odds
        if self.size is not None:
            numbers["size"] = self.size.value
            numbers["size_u"] = self.size.u
        numbers |= self.numbers
        severity = error if self.kind in ("dead", "swapped") else warning
        return severity("sensors.suspect", subject=self.disk, **numbers)


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
        classes = {
            frozenset(pair): value for *pair, value in zip(rows["one"], rows["other"], rows[column])
        }
        body = [
            [classes[frozenset((r, c))] if k > i else "" for k, c in enumerate(order)]
            for i, r in enumerate(order)
        ]
        return pd.DataFrame(body, index=order, columns=order)


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
    features = {d: disk_features(test, disk) for d, disk in test.disks.items()}
    checks = {d: _check_disk(test, disk, features[d]) for d, disk in test.disks.items()}
    at_rest = faults_at_rest(test)
    suspects = {}
    for d, check in checks.items():
        suspects[d] = check.suspects
        if check.log_likelihood is not None and at_rest[d]:
            suspects[d] = tuple(
                Suspect(d, fault.kind, fault.channels, size, odds)
                for fault, size, odds in at_rest[d]
            )
    depths = {}
    indistinguishable: dict[str, tuple[Candidate, ...]] = dict.fromkeys(test.disks, ())
    for d, check in checks.items():
        if check.depths is not None and not suspects[d]:
            depths[d] = check.depths
            indistinguishable[d] = check.indistinguishable
    likelihoods = [c.log_likelihood for c in checks.values() if c.log_likelihood is not None]
    swap = None
    if all(suspects.values()) and len(likelihoods) == len(DISKS):
        swap = _swap_between_disks(test, features, sum(likelihoods))
    if swap is not None:
        suspects = dict.fromkeys(DISKS, (swap,))
    groups = {d: angle_groups(disk.setup) for d, disk in test.disks.items()}
    table = pd.concat(
        [pair_table(test, test.disks[d], features[d], groups[d]) for d in features],
        ignore_index=True,
    )
    findings = {
        d: tuple(s.finding for s in suspects[d]) or (_sound(d, table, indistinguishable[d]),)
        for d in features
    }
    all_suspects = tuple(s for d in features for s in suspects[d]) if swap is None else (swap,)
    return SensorCheck(
        table=table,
        findings=findings,
        suspects=all_suspects,
        bulk_degC={d: float(f.levels[f.event == "steady"][0].mean()) for d, f in features.items()},
        indistinguishable=indistinguishable,
        depths=depths,
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


def _check_disk(test: EhlTest, disk: DiskTraces, f: DiskFeatures) -> _DiskCheck:
    """Dead channels, else the likeliest fault, else depths and indistinguishable swaps.

    Parameters
    ----------
    test, disk
        The test, and the traces of the disk.
    f
        Features of the disk.

    Notes
    -----
    Where no fault is likely but chi-squared is improbable (``MISFIT_P``), the suspect is "unknown".
    """
    dead = _dead_channels(test, disk, f)
    if dead:
        return _DiskCheck(dead)
    sound, fits = _fault_fits(f, disk)
    best = max(fits, key=lambda fit: fit.log_likelihood)
    log_odds = best.log_likelihood - sound.log_likelihood
    if log_odds > FAULT_LOG_ODDS:
        return _most_likely_fault(test, f, disk, sound, fits)
    if chdtrc(sound.dof, sound.chi2) < MISFIT_P:
        numbers = {"chi2": sound.chi2, "dof": sound.dof}
        unknown = Suspect(disk.name, "unknown", (), None, log_odds, numbers)
        return _DiskCheck((unknown,), sound.log_likelihood)
    near = sound.log_likelihood - INDISTINGUISHABLE_LOG_ODDS
    swaps = tuple(
        fit.fault.channels
        for fit in fits
        if fit.fault.kind == "swapped" and fit.log_likelihood > near
    )
    return _DiskCheck((), sound.log_likelihood, depth_test(f, disk, sound), swaps)


def _fault_fits(f: DiskFeatures, disk: DiskTraces) -> tuple[FaultFit, list[FaultFit]]:
    """The fit of a sound disk, and those of all faults.

    Parameters
    ----------
    f, disk
        Features and traces of the disk.

    Returns
    -------
    sound, faults
        The fits.
    """
    fits = []
    for faults in hypotheses(f.setup.channels, disk.excluded):
        fits += evaluate_faults(f, disk, faults)
    return fits[0], fits[1:]


def _most_likely_fault(
    test: EhlTest, f: DiskFeatures, disk: DiskTraces, sound: FaultFit, fits: Sequence[FaultFit]
) -> _DiskCheck:
    """The most likely fault after refinement, with its rivals.

    A swap that does not explain the data is reported as unknown: it must not stop a run.

    Parameters
    ----------
    test
        The test.
    f, disk
        Features and traces of the disk.
    sound
        The fit of a sound disk.
    fits
        The linear fits of all faults.
    """
    refined = [
        refine_fault(test, f, disk, fit) if fit.log_likelihood > sound.log_likelihood else fit
        for fit in fits
    ]
    best, *others = sorted(refined, key=lambda fit: -fit.log_likelihood)
    near = best.log_likelihood - RIVAL_LOG_ODDS
    rivals = [fit.fault for fit in others if fit.log_likelihood > near]
    numbers: dict[str, Any] = {"rivals": [f"{r.kind} {'-'.join(r.channels)}" for r in rivals[:3]]}
    log_odds = best.log_likelihood - sound.log_likelihood
    if best.fault.kind == "swapped" and chdtrc(best.dof, best.chi2) < MISFIT_P:
        numbers |= {"chi2": sound.chi2, "dof": sound.dof}
        unknown = Suspect(disk.name, "unknown", (), None, log_odds, numbers)
        return _DiskCheck((unknown,), sound.log_likelihood)
    fault = best.fault
    suspect = Suspect(disk.name, fault.kind, fault.channels, best.size, log_odds, numbers)
    return _DiskCheck((suspect,), best.log_likelihood)


def _swap_between_disks(
    test: EhlTest, features: Mapping[str, DiskFeatures], log_likelihood: float
) -> Suspect | None:
    """A channel of one disk exchanged with one of the other.

    None unless it is likelier than the best hypotheses of both disks together, by
    ``RIVAL_LOG_ODDS``.

    Parameters
    ----------
    test
        The test.
    features
        Features of both disks.
    log_likelihood
        Sum of the log likelihoods of the best hypotheses of the two disks: that of the most likely
        fault after ``tcdyn.partition.sensor_faults.refine_fault``, or that of a sound disk where
        no fault explains the readings.

    Returns
    -------
    Suspect or None
        For the disk "both", with channels such as "fast_a" and "slow_c".

    Notes
    -----
    The swap is compared as it is, without refinement. ``RIVAL_LOG_ODDS`` may change, which also
    changes the rivals that ``_most_likely_fault`` names: a smaller value reports a swap where two
    faults explain the readings nearly as well. Guarded by
    ``test_channels_swapped_between_disks_are_identified`` and
    ``test_channels_swapped_between_disks_are_identified_when_their_lines_differ`` in
    ``tests/partition/test_sensors.py``, all marked study.
    """
    fast, slow = (features[d] for d in DISKS)
    fast_used, slow_used = (np.flatnonzero(~test.disks[d].excluded_mask) for d in DISKS)
    candidates = []
    for i, j in product(fast_used, slow_used):
        total = _foreign_log_likelihood(test, fast, slow, i, j)
        total += _foreign_log_likelihood(test, slow, fast, j, i)
        candidates.append((total, i, j))
    best, i, j = max(candidates)
    if best - log_likelihood < RIVAL_LOG_ODDS:
        return None
    channels = (f"fast_{fast.setup.channels[i]}", f"slow_{slow.setup.channels[j]}")
    return Suspect("both", "swapped", channels, None, best - log_likelihood)


def _foreign_log_likelihood(
    test: EhlTest, f: DiskFeatures, other: DiskFeatures, index: int, other_index: int
) -> float:
    """Log likelihood of a disk one of whose channels is the other disk's.

    Parameters
    ----------
    test
        The test.
    f, other
        Features of the disk, and of the other disk.
    index, other_index
        Indices of the channel, and of the other disk's channel in its place.

    Notes
    -----
    The other disk's readings are taken as they are, through its own static line and chain;
    "foreign" widens the uncertainties of line and lag.
    """
    mixed = replace(
        f,
        inputs=f.inputs.copy(),
        banks=f.banks.copy(),
        slope=f.slope.copy(),
        trend_u_K=f.trend_u_K.copy(),
    )
    mixed.inputs[:, 1 + index] = other.inputs[:, 1 + other_index]
    mixed.banks[1 + index] = other.banks[1 + other_index]
    mixed.slope[:, index] = other.slope[:, other_index]
    mixed.trend_u_K[:, index] = other.trend_u_K[:, other_index]
    foreign = Fault("foreign", (f.setup.channels[index],))
    (fit,) = evaluate_faults(mixed, test.disks[f.disk], [foreign])
    return fit.log_likelihood


def _dead_channels(test: EhlTest, disk: DiskTraces, f: DiskFeatures) -> tuple[Suspect, ...]:
    """Channels whose rise under load and whose fall after unloading are unlike the others'.

    Parameters
    ----------
    test, disk
        The test, and the traces of the disk.
    f
        Features of the disk.

    Notes
    -----
    Where the log begins too late for a rise, the fall decides. Both must be below ``DEAD_REL`` of
    the median, so a junction that is only slow is not dead.
    """
    before = test.time_s < test.events.load_on_s - 0.5
    falls = -f.levels[f.event == "unloading"][-1]
    rises = falls
    if before.sum() >= MIN_REST_SAMPLES:
        steady = f.levels[f.event == "steady"][0]
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
            (f.setup.channels[i],),
            None,
            np.inf,
            {
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
    angles = {c: setup.junctions[c].angle_deg % 360.0 for c in setup.channels}
    order = sorted(angles, key=lambda c: angles[c])
    n = len(order)
    gaps = [(angles[order[(k + 1) % n]] - angles[c]) % 360.0 for k, c in enumerate(order)]
    cuts = [k for k, gap in enumerate(gaps) if gap > SAME_GROUP_DEG]
    if len(cuts) < 2:
        return (setup.channels,)
    groups = []
    for start, end in zip(cuts, [*cuts[1:], cuts[0] + n]):
        groups.append(tuple(sorted(order[k % n] for k in range(start + 1, end + 1))))
    return tuple(sorted(groups))


def hotter_junction(setup: DiskSetup, one: str, other: str) -> int | None:
    """Which of two junctions must be hotter under contact.

    Parameters
    ----------
    setup
        The disk.
    one, other
        The channels.

    Returns
    -------
    int or None
        1 when ``one`` must be hotter, -1 when ``other`` must, 0 by symmetry, None when it depends.

    Notes
    -----
    Under contact heat flows in at the centre of the track and away from it: nearer the surface and
    nearer the centre is hotter (section 6.4.2). Junctions within ``SAME_POSITION_M`` count as
    equal.
    """
    i = setup.junctions[one]
    j = setup.junctions[other]
    middle = 0.5 * setup.width_m
    depth_difference = j.depth_m - i.depth_m
    z_difference = abs(j.z_m - middle) - abs(i.z_m - middle)
    signs = {
        int(np.sign(difference))
        for difference in (depth_difference, z_difference)
        if abs(difference) >= SAME_POSITION_M
    }
    if not signs:
        return 0
    return signs.pop() if len(signs) == 1 else None


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


def pair_table(
    test: EhlTest, disk: DiskTraces, f: DiskFeatures, groups: tuple[tuple[str, ...], ...]
) -> pd.DataFrame:
    """A row for each pair of junctions: differences when steady and of the fall, classes, groups.

    Parameters
    ----------
    test, disk
        The test, and the traces of the disk.
    f
        Features of the disk.
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
    setup = disk.setup
    unload_s = test.events.unload_s
    last = rows_between(test.time_s, unload_s - LAST_S[0], unload_s - LAST_S[1])
    power = float(test.power_W[last].mean())
    area = 2 * np.pi * setup.outer_radius_m * setup.width_m
    gradient = 0.5 * power / (area * setup.conductivity_W_mK)  # of half the heat
    depth_u_K = gradient * disk.uncertainty.depth_mm * 1e-3
    after = np.flatnonzero(f.event == "unloading")
    k = int(after[min(1, len(after) - 1)])  # one to two seconds after it
    noise = f.noise[k] * np.maximum(disk.noise_K, 1e-3)
    levels = {
        "steady": (f.levels[f.event == "steady"][0], np.hypot(disk.static_u_K, depth_u_K)),
        "unloading": (-f.levels[k], np.hypot(noise, LAG_U_S * np.abs(f.slope[k]))),
    }
    i, j = np.triu_indices(len(setup.channels), 1)
    pairs = [(setup.channels[first], setup.channels[second]) for first, second in zip(i, j)]
    signs = [hotter_junction(setup, *pair) for pair in pairs]
    excluded = np.array([not {*pair}.isdisjoint(disk.excluded) for pair in pairs])
    table = pd.DataFrame(pairs, columns=["one", "other"])
    table.insert(0, "disk", disk.name)
    table["same_group"] = [any({*pair} <= {*group} for group in groups) for pair in pairs]
    for name, (level, u) in levels.items():
        difference = np.where(excluded, np.nan, level[i] - level[j])
        difference_u = np.hypot(u[i], u[j])
        classes = [classify_pair(*row) for row in zip(signs, difference, difference_u)]
        table[f"{name}_difference_K"] = difference
        table[f"{name}_u_K"] = difference_u
        table[name] = np.where(excluded, LEFT_OUT_TEXT, classes)
    return table
