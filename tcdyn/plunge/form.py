"""Model-form uncertainty: the same plunges under other correlations of natural convection."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from immersion.correlations import Correlation
from tcdyn.plunge.map import Optimum, minimise
from tcdyn.plunge.scan import LagScan, held_directions, log_marginal

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ModelForm:
    """The same data under other correlations: common lag and cost of each, and the covariance their spread adds."""

    common_lag_s: dict[str, float]
    cost: dict[str, float]
    covariance: Array  # (C, C) of the lags [s2]
    u_common_s: float


def model_form(
    final: Optimum, scan: LagScan, chosen: Correlation, others: Sequence[Correlation], own_lag_s: float
) -> ModelForm:
    """Refit under each of ``others`` at three common lags about the answer; take the shift of the posterior's top.

    The base correlation is judged at the same three lags, so that skewness cancels. The spread of the lag vectors
    (sample covariance) is what the choice of correlation adds.
    """
    layout = final.problem.layout
    width = scan.sd_s
    base = _vector(final)
    base_top = _top(final, width)
    lags, cost = [base], {chosen.name: final.cost}
    for other in others:
        if other.name == chosen.name:
            continue
        at = _under(final, other)
        shift = float(np.clip(_top(at, width) - base_top, -2 * width, 2 * width))
        rest = _vector(at) - _vector(at).mean()
        lags.append(rest + base.mean() + shift)
        cost[other.name] = at.cost
    stack = np.array(lags)
    c = len(layout.channels)
    spread = np.cov(stack.T, ddof=1) if len(stack) > 1 else np.zeros((c, c))
    covariance = np.asarray(spread, dtype=float).reshape(c, c)
    common = {name: float(row.mean() + own_lag_s) for name, row in zip(cost, stack)}
    return ModelForm(common, cost, covariance, float(np.sqrt(max(covariance.mean(), 0.0))))


def _vector(at: Optimum) -> Array:
    return np.asarray(at.theta[at.problem.layout.lag])


def _under(final: Optimum, other: Correlation) -> Optimum:
    """The optimum with the same common lag under another correlation; h scales are moved first."""
    models = tuple(replace(m, bath=replace(m.bath, correlation=other)) for m in final.problem.models)
    problem = replace(final.problem, models=models)
    theta = final.theta.copy()
    for r, (old, new, surface) in enumerate(zip(final.problem.models, models, final.surfaces)):
        T, bath = surface.temperature_degC, old.bath_degC
        early = np.abs(bath - T) > 0.3 * old.step_K
        ratio = old.bath.h_W_m2K(T[early], bath[early]) / new.bath.h_W_m2K(T[early], bath[early])
        theta[problem.layout.run(r).start] += float(np.log(np.mean(ratio)))
    return minimise(problem, theta, directions=held_directions(problem.layout), limit=12)


def _top(at: Optimum, width: float) -> float:
    """Shift [s] of the top of the parabola through the log marginal at -width, 0, +width about ``at``."""
    free = held_directions(at.problem.layout)
    values = [log_marginal(at, free)]
    for sign in (-1.0, 1.0):
        theta = at.theta.copy()
        theta[at.problem.layout.lag] = np.maximum(theta[at.problem.layout.lag] + sign * width, 2e-3)
        values.append(log_marginal(minimise(at.problem, theta, directions=free, limit=10), free))
    middle, low, high = values
    curvature = high - 2 * middle + low
    if curvature >= 0:
        return 0.0
    return float(-width * (high - low) / (2 * curvature))
