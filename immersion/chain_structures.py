"""Which chain structure the plunges speak for, and what the choice does to the lags."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from immersion.plunge_data import RunNoise
from immersion.plunge_parameters import BURST_KINDS, PlungePriors, lag_u_s
from immersion.plunge_posterior import LagScan, PlungeOptimum, settled_scan
from tcdyn.chain import STRUCTURES, Structure
from tcdyn.core import Array
from tcdyn.core.estimate import Estimate, with_u
from tcdyn.core.findings import Finding, info, warning
from tcdyn.core.messages.plunge import percent
from tcdyn.core.result import jsonable

WORSE = 12.0  # of chi-square: a second lag that is not there gains less, with its split free in six channels
POSSIBLE = (
    0.05  # a structure less probable than this may be called contradicted, one above it is possible
)
# beyond the first a second start is made, at the other
LONG_S = 0.8
SHORT_S = 0.5
UNLIKELY = 5.0  # log evidence below the likeliest: Laplace is good enough, and the scan of the lag is spared


@dataclass(frozen=True)
class StructureRow:
    """One structure: the common lag it gives, and how well it accounts for the plunges.

    ``chi_square`` (with the priors' part) and ``held_out`` count from the best structure, smaller is better;
    ``held_out`` is -2 log of the probability given to each plunge by the others, None for one plunge alone.
    ``second_lag_s``: of a second solution under the same structure, where it is possible too.
    """

    structure: str
    common_lag_s: Estimate
    chi_square: float
    probability: float
    held_out: float | None
    second_lag_s: Estimate | None = None


@dataclass(frozen=True)
class StructureComparison:
    """Every structure on the same plunges and noise; ``chosen`` is the one whose lags are reported.

    ``probability`` of the rows is by the evidence (Laplace, integrated over the common lag), structures equally
    likely beforehand; one lag, a special case of the others, counts by its likelihood and not for its simplicity.
    ``covariance`` (C, C) [s2] is the mean square of what the lags would be off by, were another structure true.
    """

    chosen: str
    rows: tuple[StructureRow, ...]
    covariance: Array
    u_before_s: float

    @property
    def own(self) -> StructureRow:
        """The row of the chosen structure."""
        return next(r for r in self.rows if r.structure == self.chosen)

    @property
    def best(self) -> StructureRow:
        """The most probable structure's row."""
        return max(self.rows, key=lambda r: r.probability)

    @property
    def u_structure_s(self) -> float:
        """Standard uncertainty that the choice of structure adds to the common lag [s]."""
        return lag_u_s(self.covariance)[0]

    @property
    def u_after_s(self) -> float:
        """Standard uncertainty of the common lag, the choice of structure included [s]."""
        return float(np.hypot(self.u_before_s, self.u_structure_s))

    @property
    def contradicted(self) -> bool:
        """Whether the plunges speak against the chosen structure: improbable, and a clearly worse fit."""
        return (
            self.own.probability < POSSIBLE and self.own.chi_square - self.best.chi_square > WORSE
        )

    @property
    def verdict(self) -> Finding:
        """What the plunges say about the structure: of the chosen one first, then the best or all possible ones."""
        others = [r for r in self.rows if r.structure != self.chosen and r.probability >= POSSIBLE]
        told = [
            self.own,
            *([self.best] if self.contradicted else sorted(others, key=lambda r: -r.probability)),
        ]
        second = self.own.second_lag_s
        numbers: dict[str, Any] = {
            "structures": [r.structure for r in told],
            "meanings": [Structure.of(r.structure).meaning for r in told],
            "probability": [r.probability for r in told],
            "chi_square": [r.chi_square for r in told],
            "lag_s": [r.common_lag_s.value for r in told],
            "u_s": [r.common_lag_s.u for r in told],
            "second_s": None if second is None else (second.value, second.u),
            "candidates": len(self.rows),
            "contradicted": self.contradicted,
            "u_before_s": self.u_before_s,
            "u_after_s": self.u_after_s,
        }
        if self.contradicted or self.u_structure_s > self.u_before_s:
            return warning("plunge.structure", **numbers)
        return info("plunge.structure", **numbers)

    @property
    def sentence(self) -> str:
        """What the plunges say about the structure, in one sentence with figures."""
        return self.verdict.sentence

    @property
    def findings(self) -> tuple[Finding, ...]:
        """The verdict, when the structure is contradicted, or adds more to the lag's u than all else together."""
        verdict = self.verdict
        return (verdict,) if verdict.severity == "warning" else ()

    def table(self) -> pd.DataFrame:
        """One row a structure, for people."""
        rows = pd.DataFrame(
            {
                "chain": f"{r.structure} ({Structure.of(r.structure).meaning})"
                + (", used here" if r.structure == self.chosen else ""),
                "probability": percent(r.probability),
                "chi-square above the best": f"{r.chi_square:.1f}",
                "held-out plunge, above the best": ""
                if r.held_out is None
                else f"{r.held_out:.1f}",
                "common lag [s]": with_u(r.common_lag_s.value, r.common_lag_s.u),
            }
            for r in self.rows
        )
        alone = all(r.held_out is None for r in self.rows)
        return rows.drop(columns="held-out plunge, above the best") if alone else rows

    def to_dict(self) -> dict[str, object]:
        """As the record's ``fit.structures`` keeps it."""
        return {
            "chosen": self.chosen,
            "sentence": self.sentence,
            "contradicted": self.contradicted,
            "u_common_lag_before_s": self.u_before_s,
            "u_common_lag_after_s": self.u_after_s,
            "candidates": jsonable(self.rows),
        }


@dataclass(frozen=True)
class _Mode:
    """One solution under one structure; ``reported``: the one whose lags the fit reports."""

    structure: str
    at: PlungeOptimum
    lag_s: Estimate
    cost: float
    log_evidence: float
    reported: bool = False


def compare_structures(
    final: PlungeOptimum,
    scan: LagScan,
    priors: PlungePriors,
    own_lag_s: float,
    extra_u_s: float = 0.0,
    structures: Sequence[str] = STRUCTURES,
) -> StructureComparison:
    """Each of ``structures`` on the plunges of ``final``, all with the noise that the best of them leaves.

    ``scan``: that of the chosen structure; ``own_lag_s``: the conditioning filter's lag; ``extra_u_s``: what else is
    uncertain in the common lag (choice of correlation).
    """
    chosen = final.problem.layout.structure
    fits = {s: _optima(final, s, priors) for s in structures}
    best = max(fits, key=lambda s: fits[s][0].laplace)
    kept = best == chosen and fits[best][0].is_near(final)
    if not kept:
        noise = fits[best][0].judged()
        fits = {s: [_refit(f, s, priors, noise) for f in fits[s]] for s in structures}
    likeliest = max(f.laplace for s in structures for f in fits[s])
    reported = scan.estimate(own_lag_s, extra_u_s)
    modes: list[_Mode] = []
    solutions = [(name, k, fit) for name in structures for k, fit in enumerate(fits[name])]
    far = [s != chosen and fit.laplace < likeliest - UNLIKELY for s, _, fit in solutions]
    near = [
        i
        for i, (s, k, _) in enumerate(solutions)
        if not far[i] and not (kept and s == chosen and k == 0)
    ]
    paths = {i: settled_scan(solutions[i][2], step=1.8, drop=7.0) for i in near}
    for i, (s, k, fit) in enumerate(solutions):
        if kept and s == chosen and k == 0:
            cost = min(float(scan.cost.min()), final.cost)
            modes.append(_Mode(s, final, reported, cost, log_evidence(scan, final), True))
        elif far[i]:
            row = fit.problem.layout.common_lag
            roughly = Estimate.normal(fit.found.value(row) + own_lag_s, fit.found.u(row))
            modes.append(_Mode(s, fit, roughly, fit.cost, fit.laplace))
        else:
            path, at, start = paths[i]
            if any(m.structure == s and m.at.is_near(at) for m in modes):
                continue
            own = s == chosen and at.is_near(final)
            lag_s = reported if own else path.estimate(own_lag_s, extra_u_s)
            cost = min(float(path.cost.min()), start.cost)
            modes.append(_Mode(s, at, lag_s, cost, log_evidence(path, at), own))
    shares = _shares(modes)
    away = np.array([0 * final.lag_s if m.reported else m.at.lag_s - final.lag_s for m in modes])
    covariance = np.asarray(np.einsum("s,si,sj->ij", shares, away, away))
    return StructureComparison(chosen, _rows(modes, shares, structures), covariance, reported.u)


def _shares(modes: Sequence[_Mode]) -> Array:
    """Probability of each solution: by evidence; P1, a special case of the others, by its likelihood against theirs.

    Occam's factor would reward one lag for having fewer parameters; that a second lag is not needed for a good fit
    does not make the narrower interval of the first one true.
    """
    evidence = np.array([m.log_evidence for m in modes])
    cost = np.array([m.cost for m in modes])
    rich = np.array([m.structure != "P1" for m in modes])
    if rich.any():
        for k in np.flatnonzero(~rich):
            evidence[k] = np.max(evidence[rich] - 0.5 * np.maximum(cost[k] - cost[rich], 0.0))
    weights = np.exp(evidence - evidence.max())
    return np.asarray(weights / weights.sum())


def _rows(
    modes: Sequence[_Mode], shares: Array, structures: Sequence[str]
) -> tuple[StructureRow, ...]:
    """One row a structure: its reported or most probable solution, and the next one where that is possible too."""
    ranked = sorted(zip(modes, shares), key=lambda pair: (not pair[0].reported, -pair[1]))
    mine = [[(m, p) for m, p in ranked if m.structure == s] for s in structures]
    cost = [min(m.cost for m, _ in own) for own in mine]
    held = [held_out(own[0][0].at) for own in mine]
    least = min((h for h in held if h is not None), default=0.0)
    return tuple(
        StructureRow(
            s,
            own[0][0].lag_s,
            c - min(cost),
            float(sum(p for _, p in own)),
            None if h is None else h - least,
            next((m.lag_s for m, p in own[1:] if p > POSSIBLE), None),
        )
        for s, own, c, h in zip(structures, mine, cost, held)
    )


def _optima(near: PlungeOptimum, structure: str, priors: PlungePriors) -> list[PlungeOptimum]:
    """The solutions of a structure, the more probable first: from ``near``, and where that is long, from a short lag.

    A long lag behind a fierce entry burst and a short one behind a mild burst can both be optima.
    """
    layout = near.problem.layout
    found = [_refit(near, structure, priors, near.problem.noise)]
    if float(near.lag_s.mean()) > LONG_S:
        outset = layout.mask(*BURST_KINDS, "entry")
        theta = np.where(outset, near.problem.mean, near.theta)
        theta[layout.at("lag")] += SHORT_S - near.lag_s.mean()
        other = _refit(
            replace(near, found=replace(near.found, theta=theta)),
            structure,
            priors,
            near.problem.noise,
        )
        if not other.is_near(found[0]) and other.cost < found[0].cost + 30.0:
            found.append(other)
    return sorted(found, key=lambda o: o.laplace, reverse=True)


def log_evidence(scan: LagScan, at: PlungeOptimum) -> float:
    """Log evidence with the common lag integrated along its scan, but for a constant that all structures share."""
    log_marginal = -0.5 * scan.cost - scan.log_volume
    k = int(np.argmax(log_marginal))
    density = float(np.interp(scan.lag_s[k], scan.grid_s, scan.density))
    return float(log_marginal[k]) - float(np.log(density)) + at.problem.log_prior


def held_out(at: PlungeOptimum, folds: int = 3) -> float | None:
    """-2 log of the probability of each plunge (or third of them) given the others; None for one plunge alone."""
    runs = at.problem.layout.runs
    if runs < 2:
        return None
    folds = min(runs, folds)
    rest = [_without(at, [r for r in range(runs) if r % folds != k]).laplace for k in range(folds)]
    return -2 * float(np.sum(at.laplace - np.array(rest)))


def _without(at: PlungeOptimum, keep: Sequence[int]) -> PlungeOptimum:
    """The optimum of some of the runs alone."""
    problem = at.problem
    layout = at.problem.layout
    index = np.arange(layout.size)
    index = np.concatenate(
        [*(index[layout.run(r)] for r in keep), index[layout.run(layout.runs - 1).stop :]]
    )
    part = replace(
        problem,
        models=tuple(problem.models[r] for r in keep),
        noise=tuple(problem.noise[r] for r in keep),
        layout=replace(layout, runs=len(keep)),
        mean=problem.mean[index],
        sd=problem.sd[index],
    )
    return part.minimised(at.theta[index], limit=12)


def _refit(
    near: PlungeOptimum, structure: str, priors: PlungePriors, noise: tuple[RunNoise, ...]
) -> PlungeOptimum:
    """The optimum under another structure, started from ``near``, with another ``noise``."""
    layout = replace(near.problem.layout, structure=structure)
    mean = near.problem.mean.copy()
    sd = near.problem.sd.copy()
    theta = near.theta
    for kind, known in layout.split_prior(priors).items():
        mean[layout.at(kind)], sd[layout.at(kind)] = known
    if structure != near.problem.layout.structure:
        theta = np.where(layout.mask("split", "common_split"), mean, theta)
    return replace(near.problem, layout=layout, mean=mean, sd=sd, noise=noise).minimised(theta)
