"""Posterior of the plunge parameters, and the common lag walked along with all else refitted."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import PchipInterpolator

from immersion.plunge_data import RunNoise, block_sd
from immersion.plunge_model import RunModel, RunSurface, predict
from immersion.plunge_parameters import BURST_KINDS, H_KINDS, PlungeParameters, lag_u_s
from tcdyn.core import Array
from tcdyn.core.estimate import Z95, Estimate
from tcdyn.estimation import Optimum, Problem, held, inverse, minimise, profile

LEAST_LAG_S = 2e-3
ENOUGH = 1e-3  # of chi-square: a search ends with the step that gains less; log evidence then holds to 0.05
SEARCH: dict[str, Any] = {"limit": 12, "tolerance": ENOUGH, "damping": 1e-6, "secant": True}


@dataclass(frozen=True)
class PlungeProblem:
    """Models of all runs, prior, and noise: everything the posterior of the parameters depends on."""

    models: tuple[RunModel, ...]
    layout: PlungeParameters
    mean: Array
    sd: Array
    noise: tuple[RunNoise, ...]

    @property
    def start(self) -> Array:
        """Where a search may begin: the prior's mean, and lags of half a second."""
        return np.where(self.layout.mask("lag"), 0.5, self.mean)

    @cached_property
    def core(self) -> Problem:
        """The same as the fitting core takes it: no step changes h, a burst or a split e-fold, or a lag by 0.5 s."""
        lay = self.layout
        largest = np.full(lay.size, np.inf)
        largest[lay.mask(*H_KINDS, *BURST_KINDS)] = 1.0
        largest[lay.mask("split", "common_split")] = 1.5
        largest[lay.mask("lag")] = 0.5
        least = np.where(lay.mask("lag"), LEAST_LAG_S, -np.inf)
        return Problem(
            tuple(lay.names()), self.evaluate, self.mean, self.sd, lower=least, largest=largest
        )

    @property
    def log_prior(self) -> float:
        """Log density of the prior at its mean, but for a constant that all structures share."""
        return 0.5 * float(np.sum(np.log(self.core.precision[self.core.precision > 0])))

    def evaluate(self, theta: Array) -> tuple[Array, Array]:
        """Model less readings over their noise (N,), and the Jacobian (N, P).

        For each run the mean over channels, then the deviations from it, each with its variance factor.
        """
        tables = []
        for model, noise, y, jacobian in zip(
            self.models, self.noise, *predict(self.models, self.layout, theta)[:2]
        ):
            weight = np.sqrt(noise.weight) / block_sd(noise.sd_K, model.blocks.count)
            off = np.where(model.blocks.count > 0, y - model.blocks.readings_degC, 0.0)
            scaled = np.concatenate([off.T[None], jacobian.T]) * weight.T
            mean = scaled.mean(axis=1, keepdims=True)
            scaled -= mean
            scaled /= np.sqrt(noise.differential)
            tables += [
                (mean * np.sqrt(y.shape[1] / noise.common))[:, 0],
                scaled.reshape(len(scaled), -1),
            ]
        table = np.concatenate(tables, axis=1)
        return table[0], table[1:].T

    def minimised(self, theta: Array, fixed: Array | None = None, limit: int = 30) -> PlungeOptimum:
        """The most probable parameters, searched for from ``theta``; combinations ``fixed`` (F, P) stay."""
        return PlungeOptimum(
            self, minimise(self.core, theta, fixed=fixed, **SEARCH | {"limit": limit})
        )


@dataclass(frozen=True)
class PlungeOptimum:
    """The most probable parameters of a problem, or some with a combination held, and what the model makes of them."""

    problem: PlungeProblem = field(repr=False)
    found: Optimum

    @property
    def theta(self) -> Array:
        """The parameters (P,)."""
        return self.found.theta

    @property
    def cost(self) -> float:
        """Chi-square with the priors' part."""
        return self.found.cost

    @property
    def lag_s(self) -> Array:
        """The chains' own lags (C,) [s], the conditioning filter's left out."""
        return self.theta[self.problem.layout.at("lag")]

    @cached_property
    def covariance(self) -> Array:
        """Inverse of the information: the posterior's covariance in its normal approximation, nothing held."""
        return inverse(self.found.information)

    @property
    def laplace(self) -> float:
        """Log evidence by Laplace's approximation, but for a constant that all structures share."""
        return (
            -0.5 * self.cost
            - 0.5 * float(np.linalg.slogdet(self.found.information)[1])
            + self.problem.log_prior
        )

    def is_near(self, other: PlungeOptimum) -> bool:
        """Whether two optima are one solution: their common lags agree within 0.15 s."""
        return abs(float(self.lag_s.mean() - other.lag_s.mean())) < 0.15

    @cached_property
    def _answers(self) -> tuple[list[Array], list[Array], list[RunSurface]]:
        return predict(self.problem.models, self.problem.layout, self.theta)

    @property
    def predictions_degC(self) -> tuple[Array, ...]:
        """Block readings (B, C) of each run by the model."""
        return tuple(self._answers[0])

    @property
    def surfaces(self) -> tuple[RunSurface, ...]:
        """The running surface in each run."""
        return tuple(self._answers[2])

    def judged(self) -> tuple[RunNoise, ...]:
        """The noise of each run by what the model leaves of it."""
        out = []
        for model, y in zip(self.problem.models, self.predictions_degC):
            count = model.blocks.count
            out.append(
                RunNoise.judged(np.where(count > 0, model.blocks.readings_degC - y, 0.0), count)
            )
        return tuple(out)


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

    @property
    def covariance(self) -> Array:
        """Of the lags (C, C): the common lag's marginal variance along the profile, and the rest across it."""
        return np.asarray(
            self.differential_covariance + self.sd_s**2 * np.outer(self.lag_slope, self.lag_slope)
        )

    def estimate(self, shift_s: float = 0.0, extra_u_s: float = 0.0) -> Estimate:
        """The common lag: posterior mean, sd and 95 % interval, moved by ``shift_s``, widened by ``extra_u_s``."""
        return self.skewed(self.mean_s + shift_s, 1.0, extra_u_s**2)

    def skewed(self, value_s: float, slope: float, rest_variance_s2: float) -> Estimate:
        """Of ``value_s`` = slope x common lag + an independent normal rest: u, and a 95 % interval as skew as it is.

        Each side of the interval is the root of the squares of both parts' sides.
        """
        rest = float(np.sqrt(max(rest_variance_s2, 0.0)))
        below = slope * (self.mean_s - self.low95_s)
        above = slope * (self.high95_s - self.mean_s)
        return Estimate(
            value=value_s,
            u=float(np.hypot(slope * self.sd_s, rest)),
            low95=value_s - float(np.hypot(below, Z95 * rest)),
            high95=value_s + float(np.hypot(above, Z95 * rest)),
        )


def settled_scan(
    best: PlungeOptimum, *, step: float = 0.8, drop: float = 9.0
) -> tuple[LagScan, PlungeOptimum, PlungeOptimum]:
    """Walk the common lag both ways from ``best`` in steps of ``step`` standard deviations; refit the rest at each.

    The walk ends where the marginal posterior has fallen by exp(-drop/2), or where the common lag reaches zero. The
    marginal is Laplace's: exp(-cost/2) / sqrt(det of the information on all else). In the curved valley of lag against
    burst a fit can stop early: where the walk finds a clearly better optimum, it begins again there. Gives the scan,
    the optimum with the common lag held at its posterior mean, and the optimum that the walk started from.
    """
    layout = best.problem.layout
    row = layout.common_lag
    own = layout.at("lag")
    for again in (False, True):
        u = float(np.clip(np.sqrt(row @ best.covariance @ row), 1e-4, 0.3))
        start = held(best.found, row, float(best.lag_s.mean()), **SEARCH)
        ends = (2 * LEAST_LAG_S, np.inf)
        walk = profile(
            start, row, u=u, step=step, drop=drop, reach=20.0, within=ends, cost=marginal, **SEARCH
        )
        lowest = min(walk.optima, key=lambda o: o.cost)
        if again or lowest.cost > best.cost - 2.0:
            break
        better = best.problem.minimised(lowest.theta)
        if better.cost > best.cost:
            break
        best = better
    lag = walk.value
    logp = -0.5 * walk.deviance
    grid = np.linspace(lag[0], lag[-1], 801)
    density = (
        np.exp(PchipInterpolator(lag, logp - logp.max())(grid))
        if len(lag) > 2
        else np.ones_like(grid)
    )
    cumulative = cumulative_trapezoid(density, grid, initial=0.0)
    density /= cumulative[-1]
    mean = float(np.trapezoid(grid * density, grid))
    sd = float(np.sqrt(max(np.trapezoid((grid - mean) ** 2 * density, grid), 1e-12)))
    low, high = np.interp([0.025, 0.975], cumulative / cumulative[-1], grid)
    final = held(walk.optima[int(np.argmax(logp))], row, mean, **SEARCH)
    aside = held(final, row, mean + 0.5 * sd, **SEARCH)
    cost, volume = np.array([[o.cost, o.log_volume] for o in walk.optima]).T
    slope = (aside.theta[own] - final.theta[own]) / (0.5 * sd)
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
        final.covariance[own, own],
    )
    return scan, PlungeOptimum(best.problem, final), best


def marginal(at: Optimum) -> float:
    """-2 log of Laplace's marginal posterior of what ``at`` holds, but for a constant."""
    return at.cost + 2 * at.log_volume


@dataclass(frozen=True)
class ModelForm:
    """The same data under other correlations: common lag and cost of each, and the covariance their spread adds."""

    common_lag_s: dict[str, float]
    cost: dict[str, float]
    covariance: Array  # (C, C) of the lags [s2]

    @property
    def u_common_s(self) -> float:
        """Standard uncertainty that the choice of correlation adds to the common lag."""
        return lag_u_s(self.covariance)[0]
