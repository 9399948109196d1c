"""Are all twelve junctions where rig.toml says, wired as their columns say, and alive? Section 6.4, before any beta."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import combinations, product
from typing import Any

import numpy as np
import pandas as pd

from calibration.disk import CHANNELS, DISKS, OUTER_ROW, DiskSetup
from calibration.estimate import Estimate
from calibration.finding import Finding, look, note, refuse
from tcdyn.partition.prepare import EhlTest
from tcdyn.partition.sensors.faults import (
    MISPLACED_M,
    DepthTest,
    Fault,
    Verdict,
    angle_groups,
    depth_test,
    hypotheses,
    judge,
)
from tcdyn.partition.sensors.features import DiskFeatures, disk_features
from tcdyn.partition.window import between
from tcdyn.traces import DiskTraces

NAMED_LOG_ODDS = 8.0  # a fault is named when it is e^8 = 3000 times as likely as a sound disk, against 28 faults
RIVAL_LOG_ODDS = 4.0  # rivals within e^4 = 55 times are named with it
BLIND_LOG_ODDS = 4.0
UNSOUND_P = 1e-4
DEAD_REL = 0.25  # of the median rise of the disk's channels
LEAST_RISE_K = 3.0
LEAST_DEPTH_M = 0.3e-3
SETTLED_M = 0.03e-3
SAME_PLACE_M = 0.15e-3
SURE_Z = 2.0
ASYMMETRY_Z = 3.0
LAG_U_S = 0.05


@dataclass(frozen=True)
class Suspect:
    """A fault of one disk: ``kind`` "dead", "swapped", "misplaced", "offset", "side" or "unknown".

    A swap between the disks has ``disk`` "both" and channels such as "fast_a". ``columns``: names as in the log;
    ``size``: how much deeper the junction lies than stated [m], or how much it or the side reads too high [K];
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
        return tuple(f"{c}_degC" if self.disk == "both" else f"{self.disk}_{c}_degC" for c in self.channels)

    @property
    def finding(self) -> Finding:
        """The fault to be told; a dead or swapped channel is not to be used."""
        odds = {} if self.kind in ("dead", "unknown") else {"log_odds": self.log_odds}
        size = {} if self.size is None else {"size": self.size.value, "size_u": self.size.u}
        told = {"kind": self.kind, "channels": self.channels, "columns": self.columns, **odds, **size, **self.numbers}
        if self.kind in ("dead", "swapped"):
            return refuse("sensors.suspect", subject=self.disk, **told)
        return look("sensors.suspect", subject=self.disk, **told)


@dataclass(frozen=True)
class SensorCheck:
    """``table``: a row for each pair of junctions of each disk; ``verdicts``: what is found of each disk.

    ``bulk_degC``: mean of the six junctions when steady (6.4.1); ``blind``: swaps that this test could not tell;
    ``depths``: where the test places the junctions of each disk that shows no fault.
    """

    table: pd.DataFrame
    verdicts: dict[str, tuple[Finding, ...]]
    suspects: tuple[Suspect, ...]
    bulk_degC: dict[str, float]
    blind: dict[str, tuple[tuple[str, str], ...]]
    depths: dict[str, DepthTest]
    disks: Mapping[str, DiskTraces]

    @property
    def sound(self) -> bool:
        """Whether no channel is suspected."""
        return not self.suspects

    @property
    def said(self) -> dict[str, str]:
        """What is found of each disk, in words."""
        return {d: " ".join(f"{f.sentence}." for f in found) for d, found in self.verdicts.items()}

    def matrix(self, disk: str, column: str = "steady") -> pd.DataFrame:
        """The pairs of one disk as the thesis prints them (table 6.2); ``column``: "steady" or "unloading"."""
        return pair_matrix(self.table, self.disks[disk], column)


@dataclass(frozen=True)
class _DiskCheck:
    suspects: tuple[Suspect, ...]
    blind: tuple[tuple[str, str], ...]
    depths: DepthTest | None
    log_likelihood: float


def check_sensors(test: EhlTest) -> SensorCheck:
    """Look for dead, swapped, misplaced or offset channels in the steady pattern and in both transients of a test.

    The outer row is predicted from the inner row by the
    rim model, steady, after unloading and after loading, with share and h free; a fault is named when it explains all
    three far better than a sound disk does. Two channels whose junctions read nearly alike (d and f) cannot be told
    apart: ``blind`` lists such pairs.
    """
    features = {d: disk_features(test, test.disks[d]) for d in DISKS}
    checks = {d: _check(test, test.disks[d], features[d]) for d in DISKS}
    crossed = _crossed(test, features, checks)
    if crossed is not None:
        checks = {d: replace(checks[d], suspects=(crossed,)) for d in DISKS}
    pairs = pd.concat([pair_table(test, test.disks[d], features[d]) for d in DISKS], ignore_index=True)
    suspects = (crossed,) if crossed is not None else tuple(s for d in DISKS for s in checks[d].suspects)
    return SensorCheck(
        table=pairs,
        verdicts={d: _verdict(d, checks[d], pairs) for d in DISKS},
        suspects=suspects,
        bulk_degC={d: float(f.levels[f.event == "steady"][0].mean()) for d, f in features.items()},
        blind={d: checks[d].blind for d in DISKS},
        depths={d: t for d in DISKS if (t := checks[d].depths) is not None},
        disks=test.disks,
    )


def _check(test: EhlTest, disk: DiskTraces, f: DiskFeatures) -> _DiskCheck:
    dead = _dead(test, disk, f)
    if dead:
        return _DiskCheck(tuple(dead), (), None, np.inf)
    (sound, *found), *swapped = (judge(f, disk, faults) for faults in hypotheses(angle_groups(disk.setup)))
    found += [v for verdicts in swapped for v in verdicts]
    odds = {v.fault: v.log_likelihood - sound.log_likelihood for v in found}
    best = max(odds.values())
    if best > NAMED_LOG_ODDS:
        found = [_settled(f, disk, v) for v in found]
        odds = {v.fault: v.log_likelihood - sound.log_likelihood for v in found}
        ranked = sorted(found, key=lambda v: -v.log_likelihood)
        best = odds[ranked[0].fault]
        rivals = [v for v in ranked[1:] if odds[v.fault] > best - RIVAL_LOG_ODDS]
        fault, size = ranked[0].fault, ranked[0].size
        also = {"rivals": [f"{r.fault.kind} {'-'.join(r.fault.channels)}" for r in rivals[:3]]}
        named = Suspect(disk.name, fault.kind, fault.channels, size, best, also)
        return _DiskCheck((named,), (), None, ranked[0].log_likelihood)
    if sound.p_value < UNSOUND_P:
        unknown = Suspect(disk.name, "unknown", (), None, best, {"chi2": sound.chi2, "dof": sound.dof})
        return _DiskCheck((unknown,), (), None, sound.log_likelihood)
    blind = [v.fault.channels for v in found if v.fault.kind == "swapped" and odds[v.fault] > -BLIND_LOG_ODDS]
    return _DiskCheck((), tuple((c[0], c[1]) for c in blind), depth_test(f, disk, sound), sound.log_likelihood)


def _crossed(test: EhlTest, features: Mapping[str, DiskFeatures], checks: Mapping[str, _DiskCheck]) -> Suspect | None:
    """A channel of one disk exchanged with one of the other, where that explains both disks' faults better."""
    if any(not checks[d].suspects or checks[d].suspects[0].kind == "dead" for d in DISKS):
        return None
    fast, slow = (features[d] for d in DISKS)
    found = []
    for i, j in product(range(len(CHANNELS)), repeat=2):
        total = 0.0
        for f, other, place, column in ((fast, slow, i, j), (slow, fast, j, i)):
            mixed = f.with_column_of(other, place, column)
            total += judge(mixed, test.disks[f.disk], [Fault("foreign", (CHANNELS[place],))])[0].log_likelihood
        found.append((total, i, j))
    best, i, j = max(found)
    odds = best - sum(checks[d].log_likelihood for d in DISKS)
    if odds < RIVAL_LOG_ODDS:
        return None
    names = (f"fast_{CHANNELS[i]}", f"slow_{CHANNELS[j]}")
    return Suspect("both", "swapped", names, None, odds)


def _settled(f: DiskFeatures, disk: DiskTraces, v: Verdict) -> Verdict:
    """A misplaced junction of the outer row, linearised again where the last look put it, until it stays."""
    channel = v.fault.channels[0]
    if v.fault.kind != "misplaced" or channel not in OUTER_ROW or v.size is None:
        return v
    setup = f.setup
    stated = setup.junctions[channel]
    deepest = setup.junctions["b"].depth_m - LEAST_DEPTH_M
    size, again = v.size, v
    for _ in range(4):
        depth = float(np.clip(stated.depth_m + size.value, LEAST_DEPTH_M, deepest))
        there = {**setup.junctions, channel: replace(stated, depth_m=depth)}
        (again,) = judge(replace(f, setup=replace(setup, junctions=there)), disk, [v.fault])
        if again.size is None:
            break
        size = Estimate.normal(depth - stated.depth_m + again.size.value, again.size.u)
        if abs(again.size.value) < SETTLED_M:
            break
    return replace(again, size=size, log_likelihood=again.log_likelihood - 0.5 * (size.value / MISPLACED_M) ** 2)


def _dead(test: EhlTest, disk: DiskTraces, f: DiskFeatures) -> list[Suspect]:
    """Channels that do not follow: neither the rise under load nor the fall after unloading is like the others'."""
    before = test.time_s < test.events.load_on_s - 0.5
    level = f.levels[f.event == "steady"][0]
    falls = -f.levels[f.event == "unloading"][-1]
    rise = level - disk.readings_degC[before].mean(axis=0) if before.sum() >= 10 else falls
    out = []
    for i, c in enumerate(CHANNELS):
        usual, fall = float(np.median(rise)), float(np.median(falls))
        if usual > LEAST_RISE_K and rise[i] < DEAD_REL * usual and falls[i] < DEAD_REL * fall:
            moved = {"rise_K": rise[i], "fall_K": falls[i], "usual_rise_K": usual, "usual_fall_K": fall}
            out.append(Suspect(disk.name, "dead", (c,), None, np.inf, {k: float(v) for k, v in moved.items()}))
    return out


def _verdict(disk: str, check: _DiskCheck, pairs: pd.DataFrame) -> tuple[Finding, ...]:
    if check.suspects:
        return tuple(s.finding for s in check.suspects)
    own = pairs[pairs["disk"] == disk]
    wrong = int((own["steady"] == "illogical").sum())
    blind = ["-".join(pair) for pair in check.blind]
    return (note("sensors.sound", subject=disk, illogical=wrong, pairs=len(own), blind=blind),)


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
    """A row for each pair: steady difference and that of the fall after unloading, what each says, and the groups.

    A steady level is known as its static line is, and its depth in the mean gradient; a fall as noise and lag are.
    """
    s = disk.setup
    last = between(test.time_s, test.events.unload_s - 20.0, test.events.unload_s - 1.0)
    power = float(test.power_W[last].mean())
    gradient = 0.5 * power / (2 * np.pi * s.outer_radius_m * s.width_m * s.conductivity_W_mK)  # of half the heat
    after = np.flatnonzero(f.event == "unloading")
    k = int(after[min(1, len(after) - 1)])  # one to two seconds after it
    noise = f.noise[k] * np.maximum(disk.noise_K, 1e-3)
    levels = {
        "steady": (
            f.levels[f.event == "steady"][0],
            np.hypot(disk.static_u_K, gradient * disk.uncertainty.depth_mm * 1e-3),
        ),
        "unloading": (-f.levels[k], np.hypot(noise, LAG_U_S * np.abs(f.slope[k]))),
    }
    groups = angle_groups(disk.setup)
    rows = []
    for one, other in combinations(CHANNELS, 2):
        i, j = CHANNELS.index(one), CHANNELS.index(other)
        wanted = demand(disk.setup, one, other)
        row: dict[str, object] = {
            "disk": disk.name, "one": one, "other": other,
            "same_group": any(one in g and other in g for g in groups),
        }  # fmt: skip
        for name, (level, u) in levels.items():
            gap, spread = float(level[i] - level[j]), float(np.hypot(u[i], u[j]))
            row |= {f"{name}_difference_K": gap, f"{name}_u_K": spread, name: said_of(wanted, gap, spread)}
        rows.append(row)
    return pd.DataFrame(rows)


def pair_matrix(table: pd.DataFrame, disk: DiskTraces, column: str = "steady") -> pd.DataFrame:
    """The upper triangle as the thesis prints it (tables 6.2 to 6.4), channels in their groups."""
    order = [c for g in angle_groups(disk.setup) for c in g]
    said = {frozenset((r["one"], r["other"])): r[column] for _, r in table[table["disk"] == disk.name].iterrows()}
    body = [[said[frozenset((r, c))] if k > i else "" for k, c in enumerate(order)] for i, r in enumerate(order)]
    return pd.DataFrame(body, index=order, columns=order)
