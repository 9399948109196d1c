"""The evidence of plunges for each chain structure: refits with one noise, integrals over the lag, plunges held out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.estimate import Estimate
from tcdyn.plunge.layout import COMPARED, Structure
from tcdyn.plunge.map import Optimum, Problem, judged, minimise, precision
from tcdyn.plunge.prior import PlungePriors
from tcdyn.plunge.scan import LagScan, settled_scan
from tcdyn.plunge.structures import POSSIBLE, StructureComparison, StructureRow

Array = NDArray[np.float64]
LONG_S, SHORT_S = 0.8, 0.5  # beyond the first a second start is made, at the other
UNLIKELY = 5.0  # log evidence below the likeliest: Laplace is good enough, and the scan of the lag is spared


def compare_structures(
    final: Optimum,
    scan: LagScan,
    priors: PlungePriors,
    entry_u_s: Sequence[float],
    own_lag_s: float,
    extra_u_s: float = 0.0,
    structures: Sequence[Structure] = COMPARED,
) -> StructureComparison:
    """Each of ``structures`` on the plunges of ``final``, all with the noise that the best of them leaves.

    ``scan``: that of the chosen structure; ``entry_u_s`` (runs,): of the entry events; ``own_lag_s``: the
    conditioning filter's lag; ``extra_u_s``: what else is uncertain in the common lag (choice of correlation).
    """
    chosen = final.problem.layout.structure
    fits = {s: _optima(final, s, priors, entry_u_s) for s in structures}
    best = max(fits, key=lambda s: laplace(fits[s][0]))
    kept = best == chosen and _close(fits[best][0], final)
    if not kept:
        noise = judged(fits[best][0].problem, fits[best][0])
        fits = {s: [_refit(f, s, priors, entry_u_s, noise) for f in fits[s]] for s in structures}
    likeliest = max(laplace(f) for s in structures for f in fits[s])
    modes: list[_Mode] = []
    for s in structures:
        for k, fit in enumerate(fits[s]):
            if kept and s == chosen and k == 0:
                cost = float(min(scan.cost.min(), final.cost))
                modes.append(_Mode(s, final, scan.estimate(own_lag_s, extra_u_s), cost, log_evidence(scan, final)))
                continue
            if s != chosen and laplace(fit) < likeliest - UNLIKELY:
                modes.append(_Mode(s, fit, _roughly(fit, own_lag_s), fit.cost, laplace(fit), False))
                continue
            walked, at, start = settled_scan(fit, step=1.8, drop=7.0)
            if any(m.structure == s and _close(m.at, at) for m in modes):
                continue
            own = s == chosen and _close(at, final)
            shown = (scan if own else walked).estimate(own_lag_s, extra_u_s)
            cost = float(min(walked.cost.min(), start.cost))
            modes.append(_Mode(s, at, shown, cost, log_evidence(walked, at), own))
    shares = _shares(modes)
    reference = final.theta[final.problem.layout.lag]
    away = np.array([0 * reference if m.reported else m.at.theta[m.at.problem.layout.lag] - reference for m in modes])
    covariance = np.asarray(np.einsum("s,si,sj->ij", shares, away, away))
    rows = _rows(modes, shares, structures)
    return StructureComparison(chosen, rows, covariance, scan.estimate(own_lag_s, extra_u_s).u)


@dataclass(frozen=True)
class _Mode:
    """One solution under one structure; ``reported``: the one whose lags the fit reports."""

    structure: str
    at: Optimum
    lag_s: Estimate
    cost: float
    log_evidence: float
    reported: bool = True


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


def _rows(modes: Sequence[_Mode], shares: Array, structures: Sequence[str]) -> tuple[StructureRow, ...]:
    """One row a structure: its reported or most probable solution, and the next one where that is possible too."""
    firsts, seconds = [], []
    for s in structures:
        mine = sorted(
            (k for k, m in enumerate(modes) if m.structure == s), key=lambda k: (-modes[k].reported, -shares[k])
        )
        firsts.append(mine[0])
        seconds.append(next((modes[k].lag_s for k in mine[1:] if shares[k] > POSSIBLE), None))
    cost = above_least([min(m.cost for m in modes if m.structure == s) for s in structures])
    held = above_least([held_out(modes[k].at) for k in firsts])
    total = [float(sum(p for p, m in zip(shares, modes) if m.structure == s)) for s in structures]
    return tuple(
        StructureRow(s, modes[firsts[k]].lag_s, cost[k] or 0.0, total[k], held[k], seconds[k])
        for k, s in enumerate(structures)
    )


def _roughly(at: Optimum, own_lag_s: float) -> Estimate:
    """The common lag of an optimum in its normal approximation."""
    lag = at.problem.layout.lag
    return Estimate.normal(
        float(np.mean(at.theta[lag])) + own_lag_s, float(np.sqrt(max(at.covariance[lag, lag].mean(), 0.0)))
    )


def _close(one: Optimum, other: Optimum) -> bool:
    """Whether two optima are one solution: their common lags agree within 0.15 s."""
    lags = [float(np.mean(o.theta[o.problem.layout.lag])) for o in (one, other)]
    return abs(lags[0] - lags[1]) < 0.15


def _optima(near: Optimum, structure: Structure, priors: PlungePriors, entry_u_s: Sequence[float]) -> list[Optimum]:
    """The solutions of a structure, the more probable first: from ``near``, and where that is long, from a short lag.

    A long lag behind a fierce entry burst and a short one behind a mild burst can both be optima.
    """
    layout = near.problem.layout
    found = [_refit(near, structure, priors, entry_u_s, near.problem)]
    if float(np.mean(near.theta[layout.lag])) > LONG_S:
        theta = near.theta.copy()
        theta[layout.lag] += SHORT_S - float(np.mean(theta[layout.lag]))
        for r in range(layout.runs):
            theta[layout.run(r)][2:6] = near.problem.mean[layout.run(r)][2:6]  # the burst and the entry
        other = _refit(replace(near, theta=theta), structure, priors, entry_u_s, near.problem)
        if not _close(other, found[0]) and other.cost < found[0].cost + 30.0:
            found.append(other)
    return sorted(found, key=laplace, reverse=True)


def above_least(values: Sequence[float | None]) -> list[float | None]:
    """Each value less the least of them; None stays."""
    least = min((v for v in values if v is not None), default=0.0)
    return [None if v is None else v - least for v in values]


def laplace(at: Optimum) -> float:
    """Log evidence by Laplace's approximation, but for a constant that all structures share."""
    return -0.5 * at.cost - 0.5 * float(np.linalg.slogdet(at.hessian)[1]) + _log_prior(at.problem)


def log_evidence(scan: LagScan, at: Optimum) -> float:
    """Log evidence with the common lag integrated along its scan, but for a constant that all structures share."""
    log_marginal = -0.5 * scan.cost - scan.log_volume
    k = int(np.argmax(log_marginal))
    density = float(np.interp(scan.lag_s[k], scan.grid_s, scan.density))
    return float(log_marginal[k]) - float(np.log(density)) + _log_prior(at.problem)


def _log_prior(problem: Problem) -> float:
    known = precision(problem)
    return 0.5 * float(np.sum(np.log(known[known > 0])))


def held_out(at: Optimum, folds: int = 3) -> float | None:
    """-2 log of the probability of each plunge (or third of them) given the others; None for one plunge alone."""
    runs = at.problem.layout.runs
    if runs < 2:
        return None
    whole, total = laplace(at), 0.0
    for k in range(min(runs, folds)):
        rest = [r for r in range(runs) if r % min(runs, folds) != k]
        total += whole - laplace(_without(at, rest))
    return -2 * total


def _without(at: Optimum, keep: Sequence[int]) -> Optimum:
    """The optimum of some of the runs alone."""
    problem, layout = at.problem, replace(at.problem.layout, runs=len(keep))
    own = np.concatenate([np.arange(s.start, s.stop) for s in (problem.layout.run(r) for r in keep)])
    index = np.concatenate([own, np.arange(problem.layout.run(problem.layout.runs - 1).stop, problem.layout.size)])
    part = replace(
        problem,
        models=tuple(replace(problem.models[r], layout=layout) for r in keep),
        layout=layout,
        mean=problem.mean[index],
        sd=problem.sd[index],
        noise_sd_K=tuple(problem.noise_sd_K[r] for r in keep),
        inflation=tuple(problem.inflation[r] for r in keep),
        weight=tuple(problem.weight[r] for r in keep),
    )
    return minimise(part, at.theta[index], limit=12)


def _refit(
    near: Optimum, structure: Structure, priors: PlungePriors, entry_u_s: Sequence[float], noise: Problem
) -> Optimum:
    """The optimum under another structure, started from ``near``, with the noise of the problem ``noise``."""
    old = near.problem
    layout = replace(old.layout, structure=structure)
    initial = [float(old.mean[layout.run(r)][6]) for r in range(layout.runs)]
    mean, sd = layout.prior(priors, list(entry_u_s), initial)
    for r in range(layout.runs):
        sd[layout.run(r).start] = old.sd[layout.run(r).start]  # h scale: widened by the fluid's properties
    problem = replace(
        old,
        models=tuple(replace(m, layout=layout) for m in old.models),
        layout=layout,
        mean=mean,
        sd=sd,
        noise_sd_K=noise.noise_sd_K,
        inflation=noise.inflation,
        weight=noise.weight,
    )
    theta = near.theta.copy()
    if structure != old.layout.structure:
        theta[layout.split], theta[layout.common_split] = mean[layout.split], mean[layout.common_split]
    return minimise(problem, theta)
