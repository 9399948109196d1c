"""Do the ways to beta agree, their correlations counted, and what that was stated do the data of a test contradict?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from calibration.disk import DISKS
from calibration.estimate import Estimate
from tcdyn.partition.joint import BothFit, DiskFit
from tcdyn.partition.posterior import LEAST_LAG_U_S
from tcdyn.partition.prepare import EhlTest
from tcdyn.partition.sensors.check import SensorCheck, Suspect
from tcdyn.partition.sensors.faults import chance_of, largest_pulls

WORDS = {"parting": "the instant of parting, or the chain's shape (a dead time, a third lag)"}
DEPTH_ALARM = 0.03  # with the pairs of ways beyond three and the other values, alarms stay below 7 % of sound tests
OTHER_ALARM = 0.01
LEAST_CHANCE = 1e-12
SUSPECT_Z = 3.0
NOTED_CHANCE = 0.5


@dataclass(frozen=True)
class Tension:
    """A stated value that the data pull: what it is in words, and by how many standard deviations.

    ``chance``: how often a sound test shows as much somewhere among the values of this kind; ``alarm``: the chance
    below which it is a contradiction.
    """

    what: str
    z: float
    chance: float
    alarm: float

    @property
    def contradicts(self) -> bool:
        """Whether chance would bring so large a tension too rarely to believe it."""
        return self.chance < self.alarm


@dataclass(frozen=True)
class CrossCheck:
    """``z`` is the largest disagreement of any two ways to beta in standard deviations of their difference.

    ``suspects`` are stated values that the data contradict (a depth, a lag, the exponent), worst first; ``strained`` is
    the one that they pull most, where half of all sound tests show less, though it is no contradiction.
    """

    z: float
    agree: bool
    sentence: str
    pair: tuple[str, str]
    p_value: float
    pairs: tuple[tuple[str, str, float, float], ...]
    suspects: tuple[Tension, ...]
    strained: Tension | None


def cross_check(
    values: dict[str, float],
    draws: dict[str, NDArray[np.float64]],
    steady: Estimate,
    tensions: Sequence[Tension] = (),
) -> CrossCheck:
    """Compare the ways to beta, given Monte Carlo ``draws`` of each that share their common errors.

    ``values`` and ``draws`` have the same keys. The difference of two ways is judged against the spread of the
    difference of their draws, so an error that moves both alike does not count. With several pairs the largest z is
    judged by the chance that any of so many would be as large (``p_value`` from the draws themselves). ``tensions``
    that contradict become named suspects. The ways agree when there is none and no pair is beyond ``SUSPECT_Z``.
    """
    names = list(values)
    pairs, zs = [], []
    for i, one in enumerate(names):
        for other in names[i + 1 :]:
            gap = values[one] - values[other]
            centred = draws[one] - draws[other]
            spread = max(float(np.std(centred)), 1e-12)
            pairs.append((one, other, float(gap), float(abs(gap) / spread)))
            zs.append(np.abs(centred - centred.mean()) / spread)
    worst = max(pairs, key=lambda row: row[3])
    largest = np.max(np.stack(zs), axis=0)
    p = float(np.mean(largest >= worst[3]))
    if worst[3] > largest.max():  # beyond what the draws can tell: the normal tail, for so many pairs
        p = min(1.0, 2 * len(pairs) * float(stats.norm.sf(worst[3])))
    suspects = tuple(sorted((t for t in tensions if t.contradicts), key=lambda t: -abs(t.z)))
    agree = worst[3] < SUSPECT_Z and not suspects
    most = min(tensions, key=lambda t: t.chance, default=None)
    strained = most if most is not None and most.chance < NOTED_CHANCE else None
    sentence = _sentence(worst, values, steady, suspects, strained)
    return CrossCheck(worst[3], agree, sentence, (worst[0], worst[1]), p, tuple(pairs), suspects, strained)


def _sentence(
    worst: tuple[str, str, float, float],
    values: dict[str, float],
    steady: Estimate,
    suspects: Sequence[Tension],
    strained: Tension | None,
) -> str:
    one, other, gap, z = worst
    spread = f"{min(values.values()):.3f} to {max(values.values()):.3f}"
    blame = "; ".join(f"{t.what} ({abs(t.z):.1f} standard deviations)" for t in suspects[:3])
    if z >= SUSPECT_Z:
        return (
            f"The ways to beta do NOT agree: {one} and {other} differ by {abs(gap):.3f}, {z:.1f} standard deviations "
            f"of their difference; suspect {blame or _suspect(one, other)}."
        )
    if suspects:
        return (
            f"The ways to beta lie together ({spread}), but the data contradict what was stated: suspect {blame}. "
            "Do NOT trust beta before that is cleared up."
        )
    return (
        f"The ways to beta agree: {spread}, speed law {steady}; the largest "
        f"difference, {one} against {other}, is {abs(gap):.3f} or {z:.1f} standard deviations"
        + (
            f". The stated value that the data pull most is {strained.what}: {abs(strained.z):.1f} standard "
            f"deviations, no contradiction (one sound test in {1 / strained.chance:.0f} shows as much)."
            if strained
            else "."
        )
    )


def _suspect(one: str, other: str) -> str:
    words = {one, other}
    if words == {"joint fast", "joint slow"}:
        return "a junction depth, a static line or the friction scale: the two disks' shares do not add to one"
    if any(w.startswith("cooling") for w in words) and any(w.startswith("joint") for w in words):
        return "the chain's lag or the instant of parting: compensated and commuted forms should give the same"
    if any(w.startswith("cooling") for w in words):
        return "the lag that was compensated, or the speed exponent"
    return "the speed exponent, or a junction depth"


def tensions(
    test: EhlTest,
    joint: Mapping[str, DiskFit],
    both: BothFit,
    sensors: SensorCheck | None = None,
) -> tuple[Tension, ...]:
    """Every stated value with the number of standard deviations by which the data would move it.

    Depths come from the sensor map, or where that was left out from the joint fit; other nuisances as pulls of the fit
    of both disks. The lag's prior and posterior differ with variance u_prior^2 - u_posterior^2; an exponent within the
    stated range about the one in use is no tension, outside it counts from the nearer end. What the sensor map suspects
    comes with the normal deviate of its odds.
    """
    depths = _depths(sensors)
    judged = {d for d in DISKS if sensors is not None and d in sensors.depths}
    others = [
        (WORDS.get(p.what.name, f"{p.what.name} of the {p.disk} disk" if p.disk else p.what.name), p.z)
        for p in both.pulls
        if not (p.what.source == "junction depth" and p.disk in judged)
    ]
    for name, fit in joint.items():
        disk = test.disks[name]
        lag = fit.estimates["lag_s"]
        prior_u = max(disk.common_lag_u_s, LEAST_LAG_U_S)
        told = np.sqrt(max(prior_u**2 - lag.u**2, (0.3 * prior_u) ** 2))
        words = f"the lag of the {name} disk: record {disk.common_lag_s:.3f} s, unloading {lag.value:.3f} s"
        others.append((words, float((lag.value - disk.common_lag_s) / told)))
    n = both.estimates["exponent"]
    outside = n.value - float(np.clip(n.value, *test.exponent_range))
    words = f"the speed exponent: {test.speed_exponent:.3f} assumed, {n} implied by the two disks"
    others.append((words, outside / n.u))
    out = [Tension(what, z, _chance(z, len(others)), OTHER_ALARM) for what, z in others]
    named = [] if sensors is None else [_named(s) for s in sensors.suspects]
    return (*depths, *out, *named)


def _chance(z: float, count: int) -> float:
    """How often the largest of ``count`` independent normal deviates is at least |z|."""
    return float(max(-np.expm1(count * np.log1p(-min(2 * stats.norm.sf(abs(z)), 1 - 1e-9))), LEAST_CHANCE))


def _depths(sensors: SensorCheck | None) -> list[Tension]:
    """Stated depths against where the test places the junctions."""
    if sensors is None:
        return []
    tests = list(sensors.depths.values())
    largest, count = largest_pulls(tests), sum(len(t.pull) for t in tests)
    out = []
    for t in tests:
        for (channel, deeper), z in zip(t.deeper_m.items(), t.pull):
            mm = Estimate.normal(1e3 * deeper.value, 1e3 * deeper.u)
            way = "deeper" if mm.value > 0 else "nearer the surface"
            size = Estimate.normal(abs(mm.value), mm.u)
            words = f"the depth of junction {channel} of the {t.disk} disk (by this test {size} mm {way} than stated)"
            chance = max(chance_of(float(z), largest, count), LEAST_CHANCE)
            out.append(Tension(words, float(z), chance, DEPTH_ALARM))
    return out


def _named(suspect: Suspect) -> Tension:
    what = f"{' and '.join(suspect.columns) or 'the junctions of the ' + suspect.disk + ' disk'} ({suspect.kind})"
    z = float(np.sqrt(2.0 * max(suspect.log_odds, 0.0)))
    return Tension(what, z, LEAST_CHANCE, OTHER_ALARM)
