"""The common lag, all else refitted: its profile, its marginal posterior, and what the correlation does to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import PchipInterpolator

from calibration.arrays import Array
from calibration.estimate import Z95, Estimate
from immersion.correlations import Correlation
from tcdyn.plunge.parameters import PlungeParameters
from tcdyn.plunge.posterior import LEAST_LAG_S, PlungeOptimum, inverse, minimise


@dataclass(frozen=True)
class LagScan:
    """The cost along the common lag, all else refitted, and the marginal posterior made of it.

    ``lag_s`` (K,) is the chains' own common lag (without the conditioning filter), ``cost`` (K,) the least chi-square
    plus prior there, ``log_volume`` (K,) half the log determinant of the Hessian of everything else.
    """

    lag_s: Array
    cost: Array
    log_volume: Array
    grid_s: Array
    density: Array
    mean_s: float
    sd_s: float
    low95_s: float
    high95_s: float
    lag_slope: Array  # (C,): change of each channel's lag with the common one along the profile
    differential_covariance: Array  # (C, C): of the lags with the common lag held

    def estimate(self, shift_s: float = 0.0, extra_u_s: float = 0.0) -> Estimate:
        """The common lag: posterior mean, sd and 95 % interval, moved by ``shift_s``, widened by ``extra_u_s``."""
        return self.skewed(self.mean_s + shift_s, 1.0, extra_u_s**2)

    def skewed(self, value_s: float, slope: float, rest_variance_s2: float) -> Estimate:
        """Of ``value_s`` = slope x common lag + an independent normal rest: u, and a 95 % interval as skew as it is.

        Each side of the interval is the root of the squares of both parts' sides.
        """
        rest = float(np.sqrt(max(rest_variance_s2, 0.0)))
        below, above = slope * (self.mean_s - self.low95_s), slope * (self.high95_s - self.mean_s)
        return Estimate(
            value=value_s,
            u=float(np.hypot(slope * self.sd_s, rest)),
            low95=value_s - float(np.hypot(below, Z95 * rest)),
            high95=value_s + float(np.hypot(above, Z95 * rest)),
        )


def held_directions(layout: PlungeParameters) -> Array:
    """Orthonormal directions (P, P-1) that leave the mean of the lags alone."""
    c = len(layout.channels)
    full, _ = np.linalg.qr(np.column_stack([np.ones(c), np.eye(c)[:, : c - 1]]))
    eye = np.eye(layout.size)
    others = np.delete(eye, np.flatnonzero(layout.mask("lag")), axis=1)
    within = np.zeros((layout.size, c - 1))
    within[layout.at("lag")] = full[:, 1:]
    return np.column_stack([others, within])


def scan_common_lag(
    best: PlungeOptimum, *, step: float = 0.8, drop: float = 9.0, limit: int = 24
) -> tuple[LagScan, PlungeOptimum]:
    """Walk the common lag both ways from ``best`` in steps of ``step`` standard deviations; refit the rest at each.

    The walk ends where the marginal posterior has fallen by exp(-drop/2), or where the common lag reaches zero. The
    marginal is Laplace's: exp(-cost/2) / sqrt(det of the Hessian of all other parameters). Also gives the optimum with
    the common lag held at its posterior mean.
    """
    layout = best.problem.layout
    free = held_directions(layout)
    centre = float(np.mean(best.theta[layout.at("lag")]))
    u = float(np.sqrt(best.covariance[layout.at("lag"), layout.at("lag")].mean()))
    u = float(np.clip(u, 1e-4, 0.3))
    points = {0.0: _at(best, centre, free)}
    for sign in (1.0, -1.0):
        last, width, offset = points[0.0], u, 0.0
        for _ in range(limit):
            offset += sign * step * width
            if centre + offset < 2 * LEAST_LAG_S:
                break
            last = _at(last, centre + offset, free)
            points[offset] = last
            top = max(log_marginal(p, free) for p in points.values())
            fallen = 2 * (top - log_marginal(last, free))
            if fallen > drop:
                break
            if abs(offset) > 3 * u and fallen < 2.0:
                width *= 1.5
    order = sorted(points)
    lag = np.array([centre + o for o in order])
    cost = np.array([points[o].cost for o in order])
    volume = np.array([_log_volume(points[o], free) for o in order])
    return _finish(lag, cost, volume, points[order[int(np.argmin(cost + 2 * volume))]], free)


def settled_scan(
    best: PlungeOptimum, *, step: float = 0.8, drop: float = 9.0
) -> tuple[LagScan, PlungeOptimum, PlungeOptimum]:
    """:func:`scan_common_lag`, started again where the walk found a clearly better optimum than ``best``.

    In the curved valley of lag against burst a fit can stop early. Also gives the optimum that the walk started from.
    """
    scan, final = scan_common_lag(best, step=step, drop=drop)
    if float(scan.cost.min()) > best.cost - 2.0:
        return scan, final, best
    k = int(np.argmin(scan.cost))
    again = minimise(final.problem, _at(final, float(scan.lag_s[k]), held_directions(final.problem.layout)).theta)
    if again.cost > best.cost:
        return scan, final, best
    return *scan_common_lag(again, step=step, drop=drop), again


def _at(near: PlungeOptimum, lag_s: float, free: Array) -> PlungeOptimum:
    layout = near.problem.layout
    theta = near.theta.copy()
    theta[layout.at("lag")] += lag_s - float(np.mean(theta[layout.at("lag")]))
    theta[layout.at("lag")] = np.maximum(theta[layout.at("lag")], LEAST_LAG_S)
    return minimise(near.problem, theta, directions=free, limit=12)


def _log_volume(at: PlungeOptimum, free: Array) -> float:
    return 0.5 * float(np.linalg.slogdet(free.T @ at.hessian @ free)[1])


def log_marginal(at: PlungeOptimum, free: Array) -> float:
    """Laplace's log marginal posterior of what ``free`` holds still, but for a constant."""
    return -0.5 * at.cost - _log_volume(at, free)


def _finish(lag: Array, cost: Array, volume: Array, near: PlungeOptimum, free: Array) -> tuple[LagScan, PlungeOptimum]:
    logp = -0.5 * cost - volume
    curve = PchipInterpolator(lag, logp - logp.max()) if len(lag) > 2 else None
    grid = np.linspace(lag[0], lag[-1], 801)
    density = np.exp(curve(grid)) if curve is not None else np.ones_like(grid)
    density /= np.trapezoid(density, grid)
    mean = float(np.trapezoid(grid * density, grid))
    sd = float(np.sqrt(max(np.trapezoid((grid - mean) ** 2 * density, grid), 1e-12)))
    cumulative = np.concatenate([[0.0], np.cumsum((density[1:] + density[:-1]) / 2 * np.diff(grid))])
    low, high = np.interp([0.025, 0.975], cumulative / cumulative[-1], grid)
    layout = near.problem.layout
    final = _at(near, mean, free)
    aside = _at(final, mean + 0.5 * sd, free)
    slope = (aside.theta[layout.at("lag")] - final.theta[layout.at("lag")]) / (0.5 * sd)
    held = free @ inverse(free.T @ final.hessian @ free) @ free.T
    scan = LagScan(
        lag,
        cost,
        volume,
        grid,
        density,
        mean,
        sd,
        float(low),
        float(high),
        slope,
        held[layout.at("lag"), layout.at("lag")],
    )
    return scan, replace(final, converged=final.converged)


def lag_covariance(scan: LagScan) -> Array:
    """Covariance (C, C) of the lags: the common lag's marginal variance along the profile, and the rest across it."""
    return np.asarray(scan.differential_covariance + scan.sd_s**2 * np.outer(scan.lag_slope, scan.lag_slope))


@dataclass(frozen=True)
class ModelForm:
    """The same data under other correlations: common lag and cost of each, and the covariance their spread adds."""

    common_lag_s: dict[str, float]
    cost: dict[str, float]
    covariance: Array  # (C, C) of the lags [s2]
    u_common_s: float


def model_form(
    final: PlungeOptimum, scan: LagScan, chosen: Correlation, others: Sequence[Correlation], own_lag_s: float
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


def _vector(at: PlungeOptimum) -> Array:
    return np.asarray(at.theta[at.problem.layout.at("lag")])


def _under(final: PlungeOptimum, other: Correlation) -> PlungeOptimum:
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


def _top(at: PlungeOptimum, width: float) -> float:
    """Shift [s] of the top of the parabola through the log marginal at -width, 0, +width about ``at``."""
    free = held_directions(at.problem.layout)
    values = [log_marginal(at, free)]
    for sign in (-1.0, 1.0):
        theta = at.theta.copy()
        theta[at.problem.layout.at("lag")] = np.maximum(theta[at.problem.layout.at("lag")] + sign * width, 2e-3)
        values.append(log_marginal(minimise(at.problem, theta, directions=free, limit=10), free))
    middle, low, high = values
    curvature = high - 2 * middle + low
    if curvature >= 0:
        return 0.0
    return float(-width * (high - low) / (2 * curvature))
