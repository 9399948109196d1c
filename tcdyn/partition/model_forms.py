"""Other structures of a test than the fits assume: does the fit of both disks move under them, and which do the data
ask for? And which numbers cannot be true.

With columns X of the whitened data by a standard deviation of a structure and the fit's own Jacobian J and posterior
covariance C, what J leaves of X, K = X'X - X'J C J'X, gives the structure's size, its evidence (Bayes factor against
what was assumed) and the refitted answer in one step, so that no log is filtered again.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import special

from tcdyn.core import Array
from tcdyn.core.estimate import Estimate, mixture_range
from tcdyn.core.findings import Finding, info, warning
from tcdyn.estimation import minimise
from tcdyn.partition.departures import LAG_SD_S, LinearisedFit, Refit, model_form_columns
from tcdyn.partition.events import EhlTest
from tcdyn.partition.joint import LOG_H, COARSE_TOLERANCE, SHARE, BothFit, DiskFit, joint_problem
from tcdyn.partition.nuisance import Unmeasured
from tcdyn.rig.disk import DISKS

H_KEYS = {  # the heat transfer coefficients that a way finds beside beta
    "speed law": ("h_fast", "h_slow"),
    **{f"{kind} {d}": (f"h {kind} {d}",) for kind in ("cooling", "joint") for d in DISKS},
}
ESTIMATORS = tuple(H_KEYS)
MAX_EXPONENT_U = 5.0  # an exponent known worse than this is not known
# of the frictional power against the heat that both disks show, to be told
POWER_SCALE_TOLERANCE = 0.1
POWER_SCALE_Z = 5.0
MAX_POWER_SCALE = 2.0  # times it or a part of it: shares of it that add to one tell nothing
UNIT_FACTORS = {  # by how much the true power is above the logged one when numbers stand in other units, and which
    "friction in pounds-force": 4.448,
    "friction in kilograms-force": 9.807,
    "speeds in rad/s": 9.549,
    "speeds in revolutions per second": 60.0,
    "friction in kilonewtons": 1000.0,
}
UNIT_TOLERANCE = 0.08
MAX_REFITS = 3
REFIT_LOG_ODDS = 3.0
N_REFIT_ITERATIONS = 3
ASSUMED_PROBABILITY = 0.5  # prior probability that the structure is as assumed; the others share the rest
NAMED_LOG_ODDS = 8.0
SPEED_LAW_Z = 3.0
# the headline holds within these
MAX_SHIFT_U = 2.0
MAX_HALF_RANGE = 0.02


@dataclass(frozen=True)
class ModelForm:
    """The fit of both disks under another structure.

    ``size`` of each of its parameters, in prior standard deviations; ``log_odds``: logarithm of its Bayes factor
    against the assumed structure; ``delta_chi2``: by how much chi-squared falls; ``referee_z``: how far the exponent
    that it implies lies from the speed law's range, in standard deviations.
    """

    name: str
    beta: Estimate
    exponent: Estimate
    size: tuple[Estimate, ...]
    log_odds: float
    delta_chi2: float
    referee_z: float


@dataclass(frozen=True)
class Alternatives:
    """All structures, best supported first, the assumed one ("as assumed") among them; ``probability`` of each.

    ``low95`` to ``high95``: 95 % range of beta over all of them, each weighed by its probability.
    """

    tried: tuple[ModelForm, ...]
    probability: tuple[float, ...]
    low95: float
    high95: float
    assumed: ModelForm

    @property
    def named(self) -> ModelForm | None:
        """The structure that the data ask for, if one is far likelier than what was assumed and agrees with the speed
        law."""
        best = max(self.tried, key=lambda a: a.log_odds)
        return best if best.log_odds > NAMED_LOG_ODDS and abs(best.referee_z) < SPEED_LAW_Z else None

    @property
    def holds(self) -> bool:
        """Whether the headline stays where it is under every structure that the data leave open."""
        beta = self.assumed.beta
        best = self.tried[0]
        near = abs(best.beta.value - beta.value) <= MAX_SHIFT_U * max(beta.u, best.beta.u)
        return near and 0.5 * (self.high95 - self.low95) <= MAX_HALF_RANGE

    @property
    def findings(self) -> tuple[Finding, ...]:
        """The structure that the data ask for; a note where the headline holds all the same."""
        if (best := self.named) is None:
            return ()
        numbers: dict[str, Any] = {
            "name": best.name,
            "log_odds": best.log_odds,
            "beta": best.beta.value,
            "u": best.beta.u,
        }
        finding = warning("structures.other", **numbers)
        if self.holds:
            finding = info("structures.other", **numbers)
        return (finding,)

    def to_list(self) -> list[dict[str, Any]]:
        """As ``beta.json`` keeps them."""
        return [
            {
                "name": a.name,
                "beta": a.beta.model_dump(),
                "delta_chi2": a.delta_chi2,
                "log_odds": a.log_odds,
                "probability": p,
                "exponent": a.exponent.model_dump(),
            }
            for a, p in zip(self.tried, self.probability)
        ]


def compare_model_forms(test: EhlTest, joint: Mapping[str, DiskFit], both: BothFit) -> Alternatives:
    """The fit of both disks under every structure, and the range of beta over all of them.

    Slow waves of the residuals count as in the fits' own uncertainties: evidence is weighed with those that are left
    when all structures are free at once, an answer's uncertainty with those that its own structure leaves. What the
    data seem to ask for is fitted again where it leads, since a large departure is not linear.
    """
    ends = np.cumsum([len(joint[d].side.y) for d in DISKS])
    columns = model_form_columns(test, joint, both.theta)
    none = np.zeros((ends[-1], 0))
    points = tuple(joint[d].side.window.y.shape[1] for d in DISKS)
    solve = LinearisedFit.at(both.optimum, ends, points)
    waves = solve(np.hstack([*columns.values()]), solve.waves(both.optimum.residual)).waves
    log_ratio = float(np.log(test.speed_ratio))
    toward = np.zeros((2, len(both.optimum.theta)))
    toward[0, SHARE] = 1.0
    toward[1, [LOG_H, 4 + LOG_H]] = [1 / log_ratio, -1 / log_ratio]
    law_u = test.exponent_half_range / np.sqrt(3)
    nothing = solve(none, waves)
    stated = solve(none, both.inflation)
    usual = stated.covariance(both.inflation)
    first = {name: solve(x, waves) for name, x in {"as assumed": none, **columns}.items()}
    likeliest = sorted(first, key=lambda name: -first[name].log_odds)[:MAX_REFITS]
    tried = []
    for name, found in first.items():
        if name in likeliest and found.log_odds > REFIT_LOG_ODDS:
            found = _settled(test, joint, both, name, found, solve, waves)
        wide = found.covariance(max(found.waves, waves)) if found.sizes else usual
        beta, n = (
            Estimate.normal(
                e.value + float(t @ (found.step - nothing.step)), e.u * float(np.sqrt(v / w))
            )
            for e, t in zip((both.estimates["beta"], both.estimates["exponent"]), toward)
            for v, w in [(t @ wide @ t, t @ usual @ t)]
        )
        z = (n.value - test.speed_exponent) / float(np.hypot(n.u, law_u))
        tried.append(ModelForm(name, beta, n, found.sizes, found.log_odds, found.delta_chi2, z))
    prior = [np.log(ASSUMED_PROBABILITY), *[np.log((1 - ASSUMED_PROBABILITY) / (len(tried) - 1))] * (len(tried) - 1)]
    referee = [-0.5 * a.referee_z**2 - np.log(np.hypot(a.exponent.u, law_u)) for a in tried]
    weights = special.softmax([a.log_odds + p + r for a, p, r in zip(tried, prior, referee)])
    order = np.argsort(-weights)
    low, high = mixture_range([a.beta for a in tried], [float(w) for w in weights])
    ranked = tuple(tried[k] for k in order)
    return Alternatives(ranked, tuple(float(weights[k]) for k in order), low, high, tried[0])


def _settled(
    test: EhlTest,
    joint: Mapping[str, DiskFit],
    both: BothFit,
    name: str,
    found: Refit,
    about: LinearisedFit,
    waves: float,
) -> Refit:
    """The fit of both disks with the structure ``name`` among its unknowns, by the model itself, columns taken anew."""
    ends = about.ends
    theta = both.theta + found.step[:8]
    best = both.optimum
    sides = [joint[d].side for d in DISKS]
    for _ in range(N_REFIT_ITERATIONS):
        late_s = LAG_SD_S * found.sizes[0].value if name.startswith("lag of ") else 0.0
        parts = np.split(model_form_columns(test, joint, theta, name, late_s)[name], ends[:-1])
        extra = tuple(Unmeasured(f"{name} {k}", name, True) for k in range(parts[0].shape[1]))
        wider = [
            replace(s, of=(*s.of, *extra), effect=np.hstack([s.effect, x]))
            for s, x in zip(sides, parts)
        ]
        problem = joint_problem(wider)
        start = np.zeros(len(problem.names))
        start[:8] = theta
        again = minimise(problem, start, tolerance=COARSE_TOLERANCE)
        theta = again.theta[:8]
        own = [problem.names.index(what.name) for what in extra]
        order = np.array([problem.names.index(x) for x in best.problem.names])
        solve = LinearisedFit.at(again, ends, about.points, order)
        there = solve(again.jacobian[: ends[-1], own], waves)
        sizes = tuple(Estimate.normal(float(again.theta[k]), e.u) for k, e in zip(own, there.sizes))
        found = replace(
            there,
            step=again.theta[order] - best.theta,
            sizes=sizes,
            waves=solve.waves(again.residual),
        )
    fall = (best.cost - again.cost) / waves
    return replace(found, log_odds=0.5 * fall - found.volume, delta_chi2=fall)


def is_impossible(beta: Estimate, *h: Estimate) -> bool:
    """Whether no disk can do this: beta outside 0 to 1, or an h that is not above zero."""
    return not 0 <= beta.value <= 1 or any(each.value <= 0 for each in h)


def impossible_keys(answers: Mapping[str, Estimate], both: Mapping[str, Estimate]) -> frozenset[str]:
    """Keys of what no disk can do: beta outside 0 to 1, h not above zero, an exponent that nothing tells, shares of a
    frictional power that is off by far; with a number goes the whole way that it stands in.

    >>> some = {way: Estimate.normal(0.7, 0.01) for way in WAYS}
    >>> some |= {h: Estimate.normal(700.0, 9.0) for hs in H_OF.values() for h in hs}
    >>> sorted(impossible_keys(some | {"joint slow": Estimate.normal(1.4, 0.1)}, {}))
    ['h joint slow', 'joint slow']
    """
    out: set[str] = set()
    for way, hs in H_KEYS.items():
        if is_impossible(answers[way], *(answers[h] for h in hs)):
            out |= {way, *hs}
    if both:
        fast = answers["joint fast"]
        slow = answers["joint slow"]
        scale = power_scale(fast.value, slow.value)
        u = float(np.hypot(fast.u, slow.u))
        far = not 1 / MAX_POWER_SCALE < scale < MAX_POWER_SCALE and abs(scale - 1) > POWER_SCALE_Z * u
        if far or is_impossible(both["beta"], both["h_fast"], both["h_slow"]):
            out |= {f"both {name}" for name in both}
        if both["exponent"].u > MAX_EXPONENT_U:
            out.add("both exponent")
    return frozenset(out)


def power_scale(fast: float, slow: float) -> float:
    """Heat that both disks show over the logged frictional power, by beta of either disk's joint fit."""
    return 1 + fast - slow


def impossibility_findings(
    answers: Mapping[str, Estimate], both: Mapping[str, Estimate], draws: Mapping[str, Array]
) -> list[Finding]:
    """Ways that are withheld, and a frictional power that is not the heat that both disks show, with likely units.

    The shares that the joint fits of either disk find by themselves add to true power over logged power.
    """
    found = list[Finding]()
    gone = impossible_keys(answers, both)
    scale = power_scale(answers["joint fast"].value, answers["joint slow"].value)
    u = float(np.std(draws["joint fast"] - draws["joint slow"]))
    if abs(scale - 1) > max(POWER_SCALE_TOLERANCE, POWER_SCALE_Z * u):
        near = {
            name: abs(np.log(abs(scale) / factor)) for name, factor in UNIT_FACTORS.items() if scale > 0
        }
        units = [
            name
            for name in sorted(near, key=near.__getitem__)
            if near[name] < max(UNIT_TOLERANCE, 2 * u / abs(scale))
        ]
        found.append(warning("power.scale", scale=scale, u=u, units=units[:2]))
    ways = [way for way in ESTIMATORS if way in gone] + ["joint, both disks"] * ("both beta" in gone)
    if ways:
        found.append(warning("answers.impossible", ways=ways))
    return found
