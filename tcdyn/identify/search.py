"""The prediction-error search: a few short descents from the best starts, the winner taken to convergence."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calibration.arrays import Array
from calibration.errors import InputError
from tcdyn.identify.optimise import Evaluate, Optimum, least_squares
from tcdyn.identify.problem import Problem
from tcdyn.identify.start import starts


def search(problem: Problem, evaluate: Evaluate | None = None, start: Array | None = None) -> Optimum:
    """The least-squares optimum of ``problem``; ``evaluate`` replaces its residuals (filtered or weighted
    ones)."""
    evaluate = evaluate or problem.evaluate
    lower, upper = problem.bounds()
    candidates = [start] if start is not None else diverse(problem, starts(problem))
    best: Optimum | None = None
    short = 6 if len(candidates) > 1 else 60
    for x0 in candidates:
        found = least_squares(evaluate, x0, lower, upper, max_iterations=short, tolerance=1e-4)
        if found is not None and np.isfinite(found.cost) and (best is None or found.cost < best.cost):
            best = found
    if best is None:
        raise InputError(
            f"no stable {problem.model.name} was found from any start",
            expected="data in which the output follows the input",
            remedy="plot the record, check that input and output are not exchanged, or give start= from Python",
        )
    final = least_squares(evaluate, best.x, lower, upper, max_iterations=80)
    assert final is not None
    return ordered(problem, kicked(problem, evaluate, final))


def diverse(problem: Problem, ranked: list[Array], count: int = 4) -> list[Array]:
    """The best starts that are not near copies of a better one: 30 % apart in some lag or dead time."""
    chosen: list[Array] = []
    for x in ranked:
        theta = problem.theta(x)
        times = np.array([v for n, v in theta.items() if n.startswith("T")] or [0.0])
        size = np.abs(times).sum() + problem.dt_s
        if all(np.max(np.abs(times - old)) > 0.15 * size for old in (spans(problem, c) for c in chosen)):
            chosen.append(x)
        if len(chosen) == count:
            break
    return chosen or ranked[:1]


def spans(problem: Problem, x: Array) -> Array:
    """The times among the parameters [s]."""
    return np.array([v for n, v in problem.theta(x).items() if n.startswith("T")] or [0.0])


def kicked(problem: Problem, evaluate: Evaluate, optimum: Optimum) -> Optimum:
    """The better of ``optimum`` and descents from either side of Tz = 0, where zero and dead time act alike."""
    free = list(problem.model.free)
    if "Tz" not in free or "Td" not in free:
        return optimum
    z, d = free.index("Tz"), free.index("Td")
    lag = max(sum(v for n, v in problem.theta(optimum.x).items() if n.startswith("Tp")), problem.dt_s)
    if abs(optimum.x[z]) > 0.02 * lag:
        return optimum
    lower, upper = problem.bounds()
    best = optimum
    for size in (0.15 * lag, -0.15 * lag):
        x0 = optimum.x.copy()
        x0[z] += size
        x0[d] += size
        found = least_squares(evaluate, x0, lower, upper, max_iterations=40)
        if found is not None and found.cost < best.cost:
            best = found
    return best


def ordered(problem: Problem, optimum: Optimum) -> Optimum:
    """The same optimum with Tp1 >= Tp2 >= Tp3."""
    free = list(problem.model.free)
    lags = [free.index(n) for n in ("Tp1", "Tp2", "Tp3") if n in free]
    if "Tw" in free or len(lags) < 2:
        return optimum
    order = [lags[i] for i in np.argsort(-optimum.x[lags], kind="stable")]
    index = np.arange(len(optimum.x))
    index[lags] = order
    return replace(optimum, x=optimum.x[index], jacobian=optimum.jacobian[:, index])
