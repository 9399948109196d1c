"""Where the uncertainty of beta comes from, whether the ways to it agree, and what of the stated the data contradict.

Monte Carlo by source over both ways and both disks (GUM Supplement 1): its draws hold every quantity with its
correlations, by which the ways are compared.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
from scipy.linalg import block_diag
from scipy.special import ndtr

from tcdyn.core import Array
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Finding, info, warning
from tcdyn.partition.cooling import CoolingFit, CoolingSensitivity
from tcdyn.partition.events import EhlTest
from tcdyn.partition.joint import MIN_LAG_U_S, BothFit, DiskFit
from tcdyn.partition.model_forms import Alternatives
from tcdyn.partition.sensor_check import SensorCheck
from tcdyn.partition.sensor_faults import DepthTest
from tcdyn.partition.steady import DiskLine, FitSensitivity, speed_law_beta
from tcdyn.rig.disk import DISKS

DEPTH_THRESHOLD = 0.03  # with the pairs of ways beyond three and the other values, alarms stay below 7 % of sound tests
OTHER_THRESHOLD = 0.01
MIN_PROBABILITY = 1e-12
SUSPECT_Z = 3.0
REPORT_PROBABILITY = 0.5
N_SAMPLES = 4000
N_PULL_SAMPLES = 20_000
MIN_COUNT = 20
MODEL_FORM_REL = (
    0.002  # of the share: inner profile and mesh; 0.03 % was seen against the whole disk
)


@dataclass(frozen=True)
class BudgetRow:
    """One source of uncertainty and its standard uncertainty of beta by the speed law and by the cooling fit."""

    source: str
    u_beta_steady: float
    u_beta_transient: float


@dataclass(frozen=True)
class Budget:
    """``rows`` by source; ``draws`` of every quantity, all sources together, each (draws,)."""

    rows: tuple[BudgetRow, ...]
    draws: dict[str, Array]

    @property
    def together(self) -> tuple[float, float]:
        """Standard uncertainty of beta by the speed law, and by the cooling fit of the worse disk, of all sources."""
        cooling = [float(np.std(self.draws[f"cooling {d}"])) for d in DISKS]
        return float(np.std(self.draws["speed law"])), max(cooling)


def monte_carlo(
    test: EhlTest,
    lines: Mapping[str, DiskLine],
    cooling: Mapping[str, CoolingFit],
    cooling_shifts: Mapping[str, CoolingSensitivity],
    joint: Mapping[str, DiskFit],
    seed: int = 0,
) -> Budget:
    """Draw all sources, push them through lines, speed law and transient fits, and read off each source's part.

    What both disks share moves both together. The exponent n is drawn evenly from its range; everything else is normal.
    """
    whose = {
        d: [("both" if q.shared else d, q.name) for q in joint[d].sensitivity.parameters]
        for d in DISKS
    }
    own = [(d, name) for d in DISKS for name in ("common lag", "lag shape", "model form")]
    rng = np.random.default_rng(seed)
    names = [*sorted({key for keys in whose.values() for key in keys} - {*own}), *own]
    normal = {key: rng.standard_normal(N_SAMPLES) for key in names}
    n, half = test.speed_exponent, test.exponent_half_range
    uniform = rng.uniform(n - half, n + half, N_SAMPLES)
    noise = {d: rng.standard_normal((N_SAMPLES, 7)) for d in DISKS}
    shifts = {
        d: stacked_sensitivity(lines[d].sensitivity, cooling_shifts[d], joint[d].sensitivity)
        for d in DISKS
    }
    drawn = {d: np.column_stack([normal[key] for key in whose[d]]) for d in DISKS}

    def run(active: str | None) -> dict[str, Array]:
        moved = {
            "exponent": uniform if active in (None, "speed exponent") else np.full(N_SAMPLES, n)
        }
        for d in DISKS:
            per_sd, root = shifts[d]
            on = np.array([active in (None, q.source) for q in joint[d].sensitivity.parameters])
            off = (drawn[d][:, on] @ per_sd[on] + (active in (None, "noise")) * noise[d] @ root.T).T
            grow = 1 + MODEL_FORM_REL * normal[d, "model form"] * (
                active in (None, "rim model form")
            )
            moved[f"{d} intercept"] = (lines[d].line.intercept + off[0]) * grow
            moved[f"{d} slope"] = (lines[d].line.slope + off[1]) * grow
            for way, at, share_off, h_off in (
                ("cooling", cooling[d], *off[2:4]),
                ("joint", joint[d], *off[4:6]),
            ):
                share = at.share * grow + share_off
                moved[f"{way} {d}"] = share if d == "fast" else 1 - share
                moved[f"h {way} {d}"] = at.h_W_m2K + h_off
            moved[f"lag {d}"] = off[6]
        a, b, c, slope = (moved[f"{d} {key}"] for d in DISKS for key in ("intercept", "slope"))
        chi = test.speed_ratio ** moved["exponent"]
        beta = moved["speed law"] = speed_law_beta(a, b, c, slope, chi)
        return moved | {"h_fast": (beta - a) / b, "h_slow": (1 - beta - c) / slope}

    rows = []
    sources = {q.source for d in DISKS for q in joint[d].sensitivity.parameters}
    for source in sorted(sources | {"speed exponent", "noise", "rim model form"}):
        one = run(source)
        transient = max(float(np.std(one[f"cooling {d}"])) for d in DISKS)
        rows.append(BudgetRow(source, float(np.std(one["speed law"])), transient))
    rows.sort(key=lambda r: -max(r.u_beta_steady, r.u_beta_transient))
    return Budget(tuple(rows), run(None))


def stacked_sensitivity(
    line: FitSensitivity, cooling: CoolingSensitivity, joint: FitSensitivity
) -> tuple[Array, Array]:
    """Errors of line, cooling and joint fit of a disk, (Q, 7) by a standard uncertainty of what the joint fit knows,
    and a root (7, 7) of their noise; the compensated lag, which is the joint fit's, moves the cooling fit."""
    per_sd = np.zeros((len(joint.parameters), 7))
    per_sd[: len(line.parameters), :2], per_sd[: len(cooling.parameters), 2:4], per_sd[:, 4:] = (
        line.per_sd,
        cooling.per_sd,
        joint.per_sd,
    )
    late = np.eye(7)
    late[2:4, 6] = cooling.by_lag
    return per_sd @ late.T, late @ block_diag(
        *(covariance_root(fit.noise) for fit in (line, cooling, joint))
    )


@dataclass(frozen=True)
class Tension:
    """A ``stated`` value that the data pull by ``z`` standard deviations.

    ``chance``: how often a sound test shows as much somewhere among the values of this kind; ``alarm``: the chance
    below which it is a contradiction.
    """

    nominal: Finding
    z: float
    chance: float
    threshold: float

    @property
    def contradicts(self) -> bool:
        """Whether chance would bring so large a tension too rarely to believe it."""
        return self.chance < self.threshold

    def to_dict(self) -> dict[str, Any]:
        """As ``beta.json`` keeps it."""
        return {"what": self.nominal.sentence, "z": self.z, "chance": self.chance}


@dataclass(frozen=True)
class CrossCheck:
    """``z`` is the largest disagreement of any two ways to beta in standard deviations of their difference.

    ``suspects`` are stated values that the data contradict (a depth, a lag, the exponent), worst first; ``strained`` is
    the one that they pull most, where half of all sound tests show less, though it is no contradiction. ``finding``
    says it: "ways.agree", "ways.apart" or "ways.contradicted".
    """

    z: float
    finding: Finding
    p_value: float
    pairs: tuple[tuple[str, str, float, float], ...]
    suspects: tuple[Tension, ...]
    largest_tension: Tension | None

    @property
    def agree(self) -> bool:
        """Whether the ways lie together and nothing contradicts what was stated."""
        return self.finding.code == "ways.agree"

    @property
    def sentence(self) -> str:
        """The verdict in words."""
        return self.finding.sentence

    def to_dict(self) -> dict[str, Any]:
        """As ``beta.json`` keeps it."""
        return {
            "z": self.z,
            "agree": self.agree,
            "sentence": self.sentence,
            "p_value": self.p_value,
            "suspects": [t.to_dict() for t in self.suspects],
            "strained": None if self.largest_tension is None else self.largest_tension.to_dict(),
            "pairs": [
                {"one": a, "other": b, "difference": gap, "z": z} for a, b, gap, z in self.pairs
            ],
        }


def cross_check(
    ways: Mapping[str, Estimate],
    draws: Mapping[str, Array],
    tensions: Sequence[Tension] = (),
    both: Alternatives | None = None,
) -> CrossCheck:
    """Compare the ways to beta, given Monte Carlo ``draws`` of each that share their common errors.

    ``ways``: the speed law's first; ``draws`` have their keys. The difference of two ways is judged against the spread
    of the difference of their draws, so an error that moves both alike does not count. With several pairs the largest
    z is judged by the chance that any of so many would be as large (``p_value`` from the draws themselves).
    ``tensions`` that contradict become named suspects. The ways agree when there is none and no pair is beyond
    ``SUSPECT_Z``. ``both``: whether the fit of both disks holds where they do not.
    """
    values = {way: e.value for way, e in ways.items()}
    pairs = []
    zs = []
    for one, other in combinations(ways, 2):
        gap = values[one] - values[other]
        centred = draws[one] - draws[other]
        spread = max(float(np.std(centred)), 1e-12)
        pairs.append((one, other, gap, abs(gap) / spread))
        zs.append(np.abs(centred - centred.mean()) / spread)
    worst = max(pairs, key=lambda row: row[3])
    largest = np.max(np.stack(zs), axis=0)
    p = float(np.mean(largest >= worst[3]))
    if (
        worst[3] > largest.max()
    ):  # beyond what the draws can tell: the normal tail, for so many pairs
        p = min(1.0, 2 * len(pairs) * float(ndtr(-worst[3])))
    suspects = tuple(sorted((t for t in tensions if t.contradicts), key=lambda t: -abs(t.z)))
    most = min(tensions, key=lambda t: t.chance, default=None)
    strained = most if most is not None and most.chance < REPORT_PROBABILITY else None
    steady = next(iter(ways.values()))
    numbers: dict[str, Any] = {
        "one": worst[0],
        "other": worst[1],
        "apart": abs(worst[2]),
        "z": worst[3],
        "low": min(values.values()),
        "high": max(values.values()),
        "steady": steady.value,
        "steady_u": steady.u,
        "suspects": [t.nominal.sentence for t in suspects[:3]],
        "suspects_z": [abs(t.z) for t in suspects[:3]],
        "holds": False,
    }
    if both is not None:
        numbers |= {
            "holds": both.estimate_holds,
            "both": both.assumed.beta.value,
            "both_u": both.assumed.beta.u,
        }
        numbers |= {"low95": both.low95, "high95": both.high95}
    if worst[3] >= SUSPECT_Z:
        finding = warning("ways.apart", **numbers)
    elif suspects:
        finding = warning("ways.contradicted", **numbers)
    else:
        if strained is not None:
            numbers |= {
                "strained": strained.nominal.sentence,
                "strained_z": abs(strained.z),
                "chance": strained.chance,
            }
        finding = info("ways.agree", **numbers)
    return CrossCheck(worst[3], finding, p, tuple(pairs), suspects, strained)


def tensions(
    test: EhlTest, joint: Mapping[str, DiskFit], both: BothFit, sensors: SensorCheck | None = None
) -> tuple[Tension, ...]:
    """Every stated value with the number of standard deviations by which the data would move it.

    Depths come from the sensor map, or where that was left out from the joint fit; other nuisances as pulls of the fit
    of both disks. The lag's prior and posterior differ with variance u_prior^2 - u_posterior^2; an exponent within the
    stated range about the one in use is no tension, outside it counts from the nearer end. What the sensor map suspects
    comes with the normal deviate of its odds.
    """
    depths = {} if sensors is None else sensors.depths
    pulled = [
        (
            info(
                "stated.depth",
                subject=d,
                channel=c,
                deeper_mm=1e3 * deeper.value,
                u_mm=1e3 * deeper.u,
            ),
            float(z),
        )
        for d, t in depths.items()
        for (c, deeper), z in zip(t.deeper_m.items(), t.pull)
    ]
    others = [
        (info("stated.value", subject=disk, name=what.name, source=what.source), z)
        for what, disk, z in both.pulls
        if not (what.source == "junction depth" and disk in depths)
        and not (disk and what.name.rpartition(" ")[2] in test.disks[disk].left_out)
    ]
    for name, fit in joint.items():
        disk = test.disks[name]
        lag = fit.estimates["lag_s"]
        prior_u = max(disk.common_lag_u_s, MIN_LAG_U_S)
        told = np.sqrt(max(prior_u**2 - lag.u**2, (0.3 * prior_u) ** 2))
        stated = info("stated.lag", subject=name, record_s=disk.common_lag_s, unloading_s=lag.value)
        others.append((stated, float((lag.value - disk.common_lag_s) / told)))
    n = both.estimates["exponent"]
    assumed = test.speed_exponent
    half = test.exponent_half_range
    outside = n.value - float(np.clip(n.value, assumed - half, assumed + half))
    others.append((info("stated.exponent", assumed=assumed, implied=n.value, u=n.u), outside / n.u))
    largest = sample_largest_pulls([*depths.values()])
    out = [
        Tension(f, z, probability_of_pull(z, largest, len(pulled)), DEPTH_THRESHOLD)
        for f, z in pulled
    ]
    for (
        finding,
        z,
    ) in others:  # how often the largest of so many independent normal deviates is at least |z|
        one = min(2 * float(ndtr(-abs(z))), 1 - 1e-9)
        out.append(
            Tension(finding, z, float(-np.expm1(len(others) * np.log1p(-one))), OTHER_THRESHOLD)
        )
    for s in () if sensors is None else sensors.suspects:
        fault = info("stated.sensors", subject=s.disk, kind=s.kind, columns=s.columns)
        out.append(
            Tension(
                fault, float(np.sqrt(2.0 * max(s.log_odds, 0.0))), MIN_PROBABILITY, OTHER_THRESHOLD
            )
        )
    return tuple(replace(t, chance=max(t.chance, MIN_PROBABILITY)) for t in out)


def covariance_root(covariance: Array) -> Array:
    """A square root of a covariance that may be singular."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.clip(values, 0.0, None)))


def sample_largest_pulls(tests: Sequence[DepthTest], seed: int = 0) -> Array:
    """Draws of the largest pull of all ``tests`` on sound disks, (PULL_DRAWS,)."""
    rng = np.random.default_rng(seed)
    pulls = [
        rng.standard_normal((N_PULL_SAMPLES, len(t.pull))) @ covariance_root(t.correlation).T
        for t in tests
    ]
    return np.abs(np.hstack([np.zeros((N_PULL_SAMPLES, 1)), *pulls])).max(axis=1)


def probability_of_pull(pull: float, largest: Array, count: int) -> float:
    """How often the ``largest`` of ``count`` pulls is at least ``pull``; beyond the draws by the normal tail."""
    seen = float(np.mean(largest >= abs(pull)))
    return (
        seen
        if seen * len(largest) >= MIN_COUNT
        else min(1.0, 2.0 * count * float(ndtr(-abs(pull))))
    )
