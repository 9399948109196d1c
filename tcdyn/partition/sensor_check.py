"""Are all junctions where rig.toml says, wired as their columns say, and alive? Section 6.4, before any beta."""

from __future__ import annotations

from collections.abc import Mapping
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
    depth_test,
    evaluate_faults,
    hypotheses,
    refine_fault,
)
from tcdyn.partition.window import between
from tcdyn.rig.disk import DISKS, LEFT_OUT, DiskSetup
from tcdyn.smoothing.traces import DiskTraces

FAULT_LOG_ODDS = (
    8.0  # a fault is named when it is e^8 = 3000 times as likely as a sound disk, against 28 faults
)
RIVAL_LOG_ODDS = 4.0  # rivals within e^4 = 55 times are named with it
INDISTINGUISHABLE_LOG_ODDS = 4.0
DEAD_REL = 0.25  # of the median rise of the disk's channels
MIN_RISE_K = 3.0
SAME_POSITION_M = 0.15e-3
SURE_Z = 2.0
ASYMMETRY_Z = 3.0
LAG_U_S = 0.05
SAME_GROUP_DEG = 60.0


@dataclass(frozen=True)
class Suspect:
    """A fault of one disk: ``kind`` "dead", "swapped", "misplaced", "offset", "late" or "unknown".

    A swap between the disks has ``disk`` "both" and channels such as "fast_a". ``columns``: names as in the log;
    ``size``: how much deeper the junction lies than stated [m], how much it reads too high [K] or is late [s];
    ``log_odds`` against a sound disk; ``numbers``: what else its words tell.
    """

    disk: str
    kind: str
    channels: tuple[str, ...]
    size: Estimate | None
    log_odds: float
    numbers: Mapping[str, Any] = field(default_factory=dict)

    @property
    def columns(self) -> tuple[str, ...]:
        """The suspected channels as the log names them."""
        return tuple(
            f"{c}_degC" if self.disk == "both" else f"{self.disk}_{c}_degC" for c in self.channels
        )

    @property
    def finding(self) -> Finding:
        """The fault to be told; a dead or swapped channel is not to be used."""
        odds = {} if self.kind in ("dead", "unknown") else {"log_odds": self.log_odds}
        size = {} if self.size is None else {"size": self.size.value, "size_u": self.size.u}
        told = {
            "kind": self.kind,
            "channels": self.channels,
            "columns": self.columns,
            **odds,
            **size,
            **self.numbers,
        }
        if self.kind in ("dead", "swapped"):
            return error("sensors.suspect", subject=self.disk, **told)
        return warning("sensors.suspect", subject=self.disk, **told)


@dataclass(frozen=True)
class SensorCheck:
    """``table``: a row for each pair of junctions of each disk; ``verdicts``: what is found of each disk.

    ``bulk_degC``: mean of the junctions when steady (6.4.1); ``blind``: swaps that this test could not tell;
    ``depths``: where the test places the junctions of each disk that shows no fault; ``groups``: channels of each disk
    by angle.
    """

    table: pd.DataFrame
    findings: dict[str, tuple[Finding, ...]]
    suspects: tuple[Suspect, ...]
    bulk_degC: dict[str, float]
    indistinguishable: dict[str, tuple[tuple[str, ...], ...]]
    depths: dict[str, DepthTest]
    groups: Mapping[str, tuple[tuple[str, ...], ...]]

    @property
    def said(self) -> dict[str, str]:
        """What is found of each disk, in words."""
        return {d: " ".join(f"{f.sentence}." for f in found) for d, found in self.findings.items()}

    @property
    def sound(self) -> bool:
        """Whether no channel is suspected."""
        return not self.suspects

    def matrix(self, disk: str, column: str = "steady") -> pd.DataFrame:
        """The pairs of one disk as the thesis prints them (tables 6.2 to 6.4): upper triangle, channels in groups.

        ``column``: "steady" or "unloading".
        """
        order = [c for g in self.groups[disk] for c in g]
        own = self.table[self.table["disk"] == disk]
        said = {frozenset((r["one"], r["other"])): r[column] for _, r in own.iterrows()}
        body = [
            [said[frozenset((r, c))] if k > i else "" for k, c in enumerate(order)]
            for i, r in enumerate(order)
        ]
        return pd.DataFrame(body, index=order, columns=order)


def check_sensors(test: EhlTest) -> SensorCheck:
    """Look for dead, swapped, misplaced, offset or late channels in the steady pattern and both transients of a test.

    The outer row is predicted from the inner row by the rim model, steady, after unloading and after loading, with
    share and h free; a fault is named when it explains all three far better than a sound disk does. Two channels whose
    junctions read nearly alike (d and f) cannot be told apart: ``blind`` lists such pairs.
    """
    looked_at = {d: _looked_at(test, disk) for d, disk in test.disks.items()}
    features = {d: f for d, (f, _, _) in looked_at.items()}
    groups = {d: angle_groups(disk.setup) for d, disk in test.disks.items()}
    blind: dict[str, tuple[tuple[str, ...], ...]] = dict.fromkeys(test.disks, ())
    likely = {}
    depths = {}
    before_load = faults_at_rest(test)
    found = {d: dead for d, (_, dead, _) in looked_at.items()}
    for d, (_, _, judged) in looked_at.items():
        if judged is not None:
            depth, best, suspect, pairs = judged
            resting = (
                Suspect(d, fault.kind, fault.channels, size, odds)
                for fault, size, odds in before_load[d]
            )
            found[d] = tuple(resting) or suspect
            likely[d] = best
            if depth is not None and not found[d]:
                blind[d] = pairs
                depths[d] = depth
    crossed = (
        _crossed(test, features, sum(likely.values()))
        if all(found.values()) and len(likely) == 2
        else None
    )
    if crossed is not None:
        found = dict.fromkeys(DISKS, (crossed,))
    table = pd.concat(
        [pair_table(test, test.disks[d], features[d], groups[d]) for d in features],
        ignore_index=True,
    )
    verdicts = {}
    for d in features:
        own = table[(table["disk"] == d) & (table["steady"] != LEFT_OUT)]
        wrong = int((own["steady"] == "illogical").sum())
        alike = ["-".join(pair) for pair in blind[d]]
        sound_disk = info("sensors.sound", subject=d, illogical=wrong, pairs=len(own), blind=alike)
        verdicts[d] = tuple(s.finding for s in found[d]) or (sound_disk,)
    return SensorCheck(
        table=table,
        findings=verdicts,
        suspects=found[DISKS[0]]
        if crossed is not None
        else tuple(s for d in features for s in found[d]),
        bulk_degC={d: float(f.levels[f.event == "steady"][0].mean()) for d, f in features.items()},
        indistinguishable=blind,
        depths=depths,
        groups=groups,
    )


Judged = tuple[DepthTest | None, float, tuple[Suspect, ...], tuple[tuple[str, ...], ...]]


def _looked_at(
    test: EhlTest, disk: DiskTraces
) -> tuple[DiskFeatures, tuple[Suspect, ...], Judged | None]:
    """A disk's features, the dead of its channels, and what is judged of it where there are none."""
    f = disk_features(test, disk)
    dead = _dead(test, disk, f)
    return f, dead, None if dead else _judged(test, f, disk)


def _judged(test: EhlTest, f: DiskFeatures, disk: DiskTraces) -> Judged:
    """Where the test places the junctions of a sound disk, the log likelihood of what is believed, the suspect if there
    is one, and the blind swaps."""
    (sound, *found), *swapped = (
        evaluate_faults(f, disk, faults) for faults in hypotheses(f.setup.channels, disk.left_out)
    )
    found += [v for verdicts in swapped for v in verdicts]
    ranked = sorted(found, key=lambda v: -v.log_likelihood)
    odds = ranked[0].log_likelihood - sound.log_likelihood
    if odds > FAULT_LOG_ODDS:
        first, *others = sorted(
            (refine_fault(test, f, disk, v) for v in found), key=lambda v: -v.log_likelihood
        )
        rivals = [
            v.fault for v in others if v.log_likelihood > first.log_likelihood - RIVAL_LOG_ODDS
        ]
        also = {"rivals": [f"{r.kind} {'-'.join(r.channels)}" for r in rivals[:3]]}
        odds = first.log_likelihood - sound.log_likelihood
        if first.fault.kind == "swapped" and chdtrc(first.dof, first.chi2) < MISFIT_P:
            told = {
                **also,
                "chi2": sound.chi2,
                "dof": sound.dof,
            }  # no swap stops a run that it does not explain
            return (
                None,
                sound.log_likelihood,
                (Suspect(disk.name, "unknown", (), None, odds, told),),
                (),
            )
        named = Suspect(disk.name, first.fault.kind, first.fault.channels, first.size, odds, also)
        return None, first.log_likelihood, (named,), ()
    if chdtrc(sound.dof, sound.chi2) < MISFIT_P:
        unknown = Suspect(
            disk.name, "unknown", (), None, odds, {"chi2": sound.chi2, "dof": sound.dof}
        )
        return None, sound.log_likelihood, (unknown,), ()
    near = sound.log_likelihood - INDISTINGUISHABLE_LOG_ODDS
    blind = tuple(
        v.fault.channels for v in found if v.fault.kind == "swapped" and v.log_likelihood > near
    )
    return depth_test(f, disk, sound), sound.log_likelihood, (), blind


def _crossed(test: EhlTest, features: Mapping[str, DiskFeatures], apart: float) -> Suspect | None:
    """A channel of one disk exchanged with one of the other, where likelier than both disks' faults ``apart``."""
    fast, slow = (features[d] for d in DISKS)
    found = []
    for i, j in product(*(np.flatnonzero(~test.disks[d].out) for d in DISKS)):
        total = 0.0
        for f, other, place, column in ((fast, slow, i, j), (slow, fast, j, i)):
            mixed = replace(
                f, **{x: getattr(f, x).copy() for x in ("inputs", "banks", "slope", "bend")}
            )
            mixed.inputs[:, 1 + place], mixed.banks[1 + place] = (
                other.inputs[:, 1 + column],
                other.banks[1 + column],
            )
            mixed.slope[:, place], mixed.trend_u_K[:, place] = (
                other.slope[:, column],
                other.trend_u_K[:, column],
            )
            (foreign,) = evaluate_faults(
                mixed, test.disks[f.disk], [Fault("foreign", (f.setup.channels[place],))]
            )
            total += foreign.log_likelihood
        found.append((total, i, j))
    best, i, j = max(found)
    names = (f"fast_{fast.setup.channels[i]}", f"slow_{slow.setup.channels[j]}")
    return (
        Suspect("both", "swapped", names, None, best - apart)
        if best - apart >= RIVAL_LOG_ODDS
        else None
    )


def _dead(test: EhlTest, disk: DiskTraces, f: DiskFeatures) -> tuple[Suspect, ...]:
    """Channels that do not follow: neither the rise under load nor the fall after unloading is like the others'."""
    before = test.time_s < test.events.load_on_s - 0.5
    falls = -f.levels[f.event == "unloading"][-1]
    steady = f.levels[f.event == "steady"][0]
    rise = steady - disk.readings_degC[before].mean(axis=0) if before.sum() >= 10 else falls
    usual = float(np.median(rise))
    fall = float(np.median(falls))
    dead = (rise < DEAD_REL * usual) & (falls < DEAD_REL * fall) & (usual > MIN_RISE_K) & ~disk.out
    out = []
    for i in np.flatnonzero(dead):
        moved = {"rise_K": rise[i], "fall_K": falls[i], "usual_rise_K": usual, "usual_fall_K": fall}
        out.append(
            Suspect(
                disk.name,
                "dead",
                (f.setup.channels[i],),
                None,
                np.inf,
                {k: float(v) for k, v in moved.items()},
            )
        )
    return tuple(out)


def angle_groups(setup: DiskSetup) -> tuple[tuple[str, ...], ...]:
    """Channels by where they sit round the disk: neighbours within 60 degrees belong together, largest angle gap first.

    >>> from tcdyn.rig.rigfile import load_rig
    >>> angle_groups(load_rig().disk_setup("slow"))
    (('a', 'e', 'f'), ('b', 'c', 'd'))
    """
    angles = {c: setup.junctions[c].angle_deg % 360.0 for c in setup.channels}
    order = sorted(angles, key=lambda c: angles[c])
    gaps = [(angles[order[(k + 1) % len(order)]] - angles[c]) % 360.0 for k, c in enumerate(order)]
    cuts = [k for k, gap in enumerate(gaps) if gap > SAME_GROUP_DEG]
    if len(cuts) < 2:
        return (setup.channels,)
    groups = []
    for one, other in zip(cuts, [*cuts[1:], cuts[0] + len(order)]):
        groups.append(tuple(sorted(order[k % len(order)] for k in range(one + 1, other + 1))))
    return tuple(sorted(groups))


def hotter_junction(setup: DiskSetup, one: str, other: str) -> int | None:
    """1 when ``one`` must be the hotter, -1 when ``other`` must, 0 when neither by symmetry, None when it depends.

    Under contact heat flows in at the centre of the track and away from it: nearer the surface and nearer the centre
    is hotter (section 6.4.2).
    """
    i = setup.junctions[one]
    j = setup.junctions[other]
    middle = 0.5 * setup.width_m
    steps = (j.depth_m - i.depth_m, abs(j.z_m - middle) - abs(i.z_m - middle))
    signs = {0 if abs(s) < SAME_POSITION_M else int(np.sign(s)) for s in steps}
    if signs == {0}:
        return 0
    signs.discard(0)
    return signs.pop() if len(signs) == 1 else None


def classify_pair(wanted: int | None, difference_K: float, u_K: float) -> str:
    """ "logical", "weak", "illogical" or "N.A." for a pair that reads ``difference_K`` apart.

    >>> classify_pair(1, 3.0, 0.3), classify_pair(1, 0.2, 0.3), classify_pair(1, -3.0, 0.3), classify_pair(None, 3.0, 0.3)
    ('logical', 'weak', 'illogical', 'N.A.')
    """
    if wanted is None:
        return "N.A."
    if wanted == 0:
        return "logical" if abs(difference_K) <= ASYMMETRY_Z * u_K else "weak"
    z = wanted * difference_K / u_K
    return "logical" if z > SURE_Z else "illogical" if z < -SURE_Z else "weak"


def pair_table(
    test: EhlTest, disk: DiskTraces, f: DiskFeatures, groups: tuple[tuple[str, ...], ...]
) -> pd.DataFrame:
    """A row for each pair: steady difference and that of the fall after unloading, what each says, and the groups.

    A steady level is known as its static line is, and its depth in the mean gradient; a fall as noise and lag are.
    """
    s = disk.setup
    last = between(test.time_s, test.events.unload_s - 20.0, test.events.unload_s - 1.0)
    power = float(test.power_W[last].mean())
    gradient = (
        0.5 * power / (2 * np.pi * s.outer_radius_m * s.width_m * s.conductivity_W_mK)
    )  # of half the heat
    after = np.flatnonzero(f.event == "unloading")
    k = int(after[min(1, len(after) - 1)])  # one to two seconds after it
    noise = f.noise[k] * np.maximum(disk.noise_K, 1e-3)
    depth_u_K = gradient * disk.uncertainty.depth_mm * 1e-3
    levels = {
        "steady": (f.levels[f.event == "steady"][0], np.hypot(disk.static_u_K, depth_u_K)),
        "unloading": (-f.levels[k], np.hypot(noise, LAG_U_S * np.abs(f.slope[k]))),
    }
    i, j = np.triu_indices(len(s.channels), 1)
    pairs = [(s.channels[one], s.channels[other]) for one, other in zip(i, j)]
    wanted = [hotter_junction(s, *pair) for pair in pairs]
    out = np.array([not {*pair}.isdisjoint(disk.left_out) for pair in pairs])
    table = pd.DataFrame(pairs, columns=["one", "other"])
    table.insert(0, "disk", disk.name)
    table["same_group"] = [any({*pair} <= {*group} for group in groups) for pair in pairs]
    for name, (level, u) in levels.items():
        gap = np.where(out, np.nan, level[i] - level[j])
        spread = np.hypot(u[i], u[j])
        table[f"{name}_difference_K"] = gap
        table[f"{name}_u_K"] = spread
        table[name] = np.where(
            out, LEFT_OUT, [classify_pair(w, x, u_x) for w, x, u_x in zip(wanted, gap, spread)]
        )
    return table
