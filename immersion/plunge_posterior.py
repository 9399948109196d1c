"""Posterior of the plunge parameters: MAP, Laplace approximation, scan of the common lag.

Used by :mod:`immersion.plunge_fit`, :mod:`immersion.chain_structures` and the design of plunges.
The search is ``tcdyn.estimation.minimise``; the marginal posterior of the common lag is Laplace's
along a profile (Tierney and Kadane 1986 give the approximation). Limits of steps are chosen by
judgement. Tests: ``tests/immersion/test_plunge_fit.py`` and
``tests/immersion/test_plunge_structures.py``.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import PchipInterpolator

from immersion.plunge_data import RunNoise, block_sd
from immersion.plunge_model import RunModel, RunSurface, predict
from immersion.plunge_parameters import (
    BURST_KINDS,
    H_KINDS,
    PlungeParameters,
    common_and_differential_u_s,
)
from tcdyn.core import Array
from tcdyn.core.estimate import Estimate
from tcdyn.estimation import Optimum, Problem, inverse, minimise, minimise_constrained, profile

MIN_LAG_S = 2e-3  # lower bound of a lag [s]; chosen by judgement
START_LAG_S = 0.5  # start of the search [s]; chosen by judgement
# Gain of chi-square below which a search ends. The log evidence is then accurate to 0.05.
CHI_SQUARE_TOLERANCE = 1e-3
# Settings of each search of the optimum; ``damping`` is chosen by judgement.
SEARCH: dict[str, Any] = {
    "limit": 12,
    "tolerance": CHI_SQUARE_TOLERANCE,
    "damping": 1e-6,
    "secant": True,
}
# The same for a start far from the optimum, where long first steps end in a wrong valley. With
# these, 5 of 6 searches converged instead of 3 (disks 10, 11, 24 of ``forms_study`` 200 46101).
FAR_SEARCH: dict[str, Any] = SEARCH | {"limit": 30, "damping": 1e-2, "secant": False}
SAME_SOLUTION_S = 0.15  # difference of common lags below which optima are the same; by judgement
# Reduction of chi-square for which a scan starts again from a better optimum; chosen by judgement.
RESTART_CHI_SQUARE = 2.0
GRID_POINTS = 801  # of the marginal density of the common lag


@dataclass(frozen=True)
class PlungeProblem:
    """Models of all runs, prior (P,) each, and noise: everything on which the posterior depends.

    Attributes
    ----------
    models
        Model of each run.
    layout
        Layout of the parameter vector.
    mean, sd
        Prior of each parameter (P,); an infinite standard deviation is a flat prior.
    noise
        Noise of each run.
    """

    models: tuple[RunModel, ...]
    layout: PlungeParameters
    mean: Array
    sd: Array
    noise: tuple[RunNoise, ...]

    @property
    def start(self) -> Array:
        """Start of a search: the prior mean, and lags of half a second."""
        return np.where(self.layout.mask("lag"), START_LAG_S, self.mean)

    @cached_property
    def core(self) -> Problem:
        """The least-squares problem of the posterior.

        No step changes a parameter of h, of the burst or of the split by more than about a factor
        e, or a lag by more than 0.5 s.

        Notes
        -----
        The largest steps (1 for a logarithm, 1.5 for a logit, 0.5 s for a lag) affect the path of
        the search, not its result.
        """
        layout = self.layout
        largest = np.full(layout.size, np.inf)
        largest[layout.mask(*H_KINDS, *BURST_KINDS)] = 1.0
        largest[layout.mask("split", "common_split")] = 1.5
        largest[layout.mask("lag")] = 0.5
        lower = np.where(layout.mask("lag"), MIN_LAG_S, -np.inf)
        return Problem(
            tuple(layout.names()), self.evaluate, self.mean, self.sd, lower=lower, max_step=largest
        )

    @property
    def log_prior(self) -> float:
        """Log density of the prior at its mean, up to a constant of all structures."""
        precision = self.core.precision
        return 0.5 * float(np.sum(np.log(precision[precision > 0])))

    def evaluate(self, theta: Array) -> tuple[Array, Array]:
        """Standardised residuals (N,), model minus readings, and their Jacobian (N, P).

        For each run first the mean over channels, then the deviations from it, each with its
        variance factor.

        Parameters
        ----------
        theta
            Parameters (P,).

        Returns
        -------
        residual
            (N,): for each run the mean over channels of each block, then the deviations from it.
        jacobian
            (N, P).

        Notes
        -----
        The two components have separate variance factors (:class:`immersion.plunge_data.RunNoise`).
        The order must be the same in residual and Jacobian, and is free otherwise.
        """
        tables = []
        readings, jacobians, _ = predict(self.models, self.layout, theta)
        for model, noise, y, jacobian in zip(self.models, self.noise, readings, jacobians):
            blocks = model.blocks
            weight = np.sqrt(noise.weight) / block_sd(noise.sd_K, blocks.count)
            residual = np.where(blocks.count > 0, y - blocks.readings_degC, 0.0)
            scaled = np.concatenate([residual.T[None], jacobian.T]) * weight.T
            mean = scaled.mean(axis=1, keepdims=True)
            common = (mean * np.sqrt(y.shape[1] / noise.common))[:, 0]
            differential = (scaled - mean) / np.sqrt(noise.differential)
            tables += [common, differential.reshape(len(scaled), -1)]
        table = np.concatenate(tables, axis=1)
        return table[0], table[1:].T

    def optimise(self, theta: Array, **search: Any) -> PlungeOptimum:
        """The most probable parameters, searched from ``theta``.

        Parameters
        ----------
        theta
            Start (P,).
        **search
            Keywords of :func:`tcdyn.estimation.minimise`, instead of ``SEARCH`` with 30 steps.
        """
        return PlungeOptimum(self, minimise(self.core, theta, **SEARCH | {"limit": 30} | search))


@dataclass(frozen=True)
class PlungeOptimum:
    """The most probable parameters, possibly with a constraint, and the predictions there.

    Attributes
    ----------
    problem
        The problem that was solved.
    solution
        Parameters, cost and information at the optimum.
    """

    problem: PlungeProblem = field(repr=False)
    solution: Optimum

    @property
    def theta(self) -> Array:
        """The parameters (P,)."""
        return self.solution.theta

    @property
    def cost(self) -> float:
        """Chi-square, with the contribution of the priors."""
        return self.solution.cost

    @property
    def lag_s(self) -> Array:
        """Lags of the chains without the conditioning filter (C,) [s]."""
        return self.theta[self.problem.layout.at("lag")]

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the posterior (P, P) in its normal approximation.

        The inverse of the information.
        """
        return inverse(self.solution.information)

    @property
    def laplace(self) -> float:
        """Log evidence by Laplace's approximation, up to a constant common to all structures."""
        log_determinant = float(np.linalg.slogdet(self.solution.information)[1])
        return -0.5 * self.cost - 0.5 * log_determinant + self.problem.log_prior

    def is_near(self, other: PlungeOptimum) -> bool:
        """Whether two optima are the same solution: their common lags agree within 0.15 s.

        Parameters
        ----------
        other
            Another optimum of the same channels.
        """
        return abs(float(self.lag_s.mean() - other.lag_s.mean())) < SAME_SOLUTION_S

    @cached_property
    def _predictions(self) -> tuple[list[Array], list[Array], list[RunSurface]]:
        """Readings, Jacobians and surfaces of all runs at the optimum."""
        return predict(self.problem.models, self.problem.layout, self.theta)

    @property
    def predictions_degC(self) -> tuple[Array, ...]:
        """Predicted block readings (B, C) of each run."""
        return tuple(self._predictions[0])

    @property
    def surfaces(self) -> tuple[RunSurface, ...]:
        """The running surface in each run."""
        return tuple(self._predictions[2])

    def residual_noise(self) -> tuple[RunNoise, ...]:
        """Noise of each run, estimated from the residuals."""
        noise = []
        for model, y in zip(self.problem.models, self.predictions_degC):
            count = model.blocks.count
            residual = np.where(count > 0, model.blocks.readings_degC - y, 0.0)
            noise.append(RunNoise.from_residuals(residual, count))
        return tuple(noise)


@dataclass(frozen=True)
class LagScan:
    """Profile of the cost along the common lag, and the marginal posterior computed from it.

    Attributes
    ----------
    lag_s
        Common lag of the chains without the conditioning filter (K,) [s].
    cost
        Least chi-square plus prior there (K,).
    log_volume
        Half the log determinant of the Hessian of all other parameters (K,).
    grid_s, density
        Marginal posterior density of the common lag on a fine grid.
    mean_s, sd_s, low95_s, high95_s
        Posterior mean, standard deviation and 95 % interval [s].
    lag_slope
        Derivative of each channel's lag with respect to the common lag along the profile (C,).
    differential_covariance
        Covariance of the lags at fixed common lag (C, C) [s2].
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
    lag_slope: Array
    differential_covariance: Array

    @property
    def covariance(self) -> Array:
        """Covariance of the lags (C, C): along the profile and at fixed common lag [s2]."""
        along = self.sd_s**2 * np.outer(self.lag_slope, self.lag_slope)
        return self.differential_covariance + along

    def estimate(self, shift_s: float = 0.0, extra_u_s: float = 0.0) -> Estimate:
        """Common lag plus a shift, with its uncertainty widened.

        Parameters
        ----------
        shift_s
            Added to the value [s]; for instance the lag of the conditioning filter.
        extra_u_s
            Further standard uncertainty, independent of the fit [s].
        """
        return self.skewed_estimate(self.mean_s + shift_s, 1.0, extra_u_s**2)

    def skewed_estimate(self, value_s: float, slope: float, normal_variance_s2: float) -> Estimate:
        """Estimate of ``slope`` times the common lag plus an independent normal part.

        Parameters
        ----------
        value_s
            Value of the estimate [s].
        slope
            Factor of the common lag.
        normal_variance_s2
            Variance of the normal part [s2]; a negative one counts as zero.

        Notes
        -----
        Each half-width of the 95 % interval is the root sum of squares of those of both parts.
        """
        normal_u = float(np.sqrt(max(normal_variance_s2, 0.0)))
        lag_s = Estimate(
            value=self.mean_s, u=self.sd_s, low95=self.low95_s, high95=self.high95_s
        ).scaled(abs(slope))
        return lag_s.shifted(value_s - lag_s.value).with_error(normal_u)


def scan_common_lag(
    best: PlungeOptimum, *, step: float = 0.8, drop: float = 9.0
) -> tuple[LagScan, PlungeOptimum, PlungeOptimum]:
    """Profile scan of the common lag: fix it at values about ``best`` and refit the others.

    Parameters
    ----------
    best
        Optimum from which the scan starts.
    step
        Step, in standard deviations of the common lag.
    drop
        The scan ends where the marginal posterior is lower by exp(-drop/2), or where the common lag
        reaches zero.

    Returns
    -------
    scan
        The scan and the marginal posterior.
    final
        Optimum with the common lag fixed at its posterior mean.
    start
        Optimum from which the (last) scan started.

    Notes
    -----
    The marginal posterior is Laplace's: exp(-cost/2) / sqrt(det of the information of all other
    parameters). In the curved valley of lag against burst a fit can stop early. Where the scan
    finds a clearly better optimum, it starts again from there.

    ``step``, ``drop`` and ``GRID_POINTS`` are numerical: a smaller step and a larger drop cost
    time. The scan starts again at most once. Test: ``tests/immersion/test_plunge_structures.py``.
    """
    layout = best.problem.layout
    weights = layout.common_lag
    for repeated in (False, True):
        u = float(np.clip(np.sqrt(weights @ best.covariance @ weights), 1e-4, 0.3))
        centre = minimise_constrained(best.solution, weights, float(best.lag_s.mean()), **SEARCH)
        path = profile(
            centre,
            weights,
            u=u,
            step=step,
            max_deviance=drop,
            max_distance=20.0,
            bounds=(2 * MIN_LAG_S, np.inf),
            cost=marginal_deviance,
            **SEARCH,
        )
        lowest = min(path.optima, key=lambda o: o.cost)
        if repeated or lowest.cost > best.cost - RESTART_CHI_SQUARE:
            break
        better = best.problem.optimise(lowest.theta)
        if better.cost > best.cost:
            break
        best = better
    lag = path.value
    log_marginal = -0.5 * path.deviance
    grid = np.linspace(lag[0], lag[-1], GRID_POINTS)
    density = np.ones_like(grid)
    if len(lag) > 2:
        density = np.exp(PchipInterpolator(lag, log_marginal - log_marginal.max())(grid))
    cumulative = cumulative_trapezoid(density, grid, initial=0.0)
    density /= cumulative[-1]
    mean = float(np.trapezoid(grid * density, grid))
    sd = float(np.sqrt(max(np.trapezoid((grid - mean) ** 2 * density, grid), 1e-12)))
    low, high = np.interp([0.025, 0.975], cumulative / cumulative[-1], grid)
    top = path.optima[int(np.argmax(log_marginal))]
    final = minimise_constrained(top, weights, mean, **SEARCH)
    shifted = minimise_constrained(final, weights, mean + 0.5 * sd, **SEARCH)
    lags = layout.at("lag")
    scan = LagScan(
        lag_s=lag,
        cost=np.array([o.cost for o in path.optima]),
        log_volume=np.array([o.log_volume for o in path.optima]),
        grid_s=grid,
        density=density,
        mean_s=mean,
        sd_s=sd,
        low95_s=float(low),
        high95_s=float(high),
        lag_slope=(shifted.theta[lags] - final.theta[lags]) / (0.5 * sd),
        differential_covariance=final.covariance[lags, lags],
    )
    return scan, PlungeOptimum(best.problem, final), best


def marginal_deviance(at: Optimum) -> float:
    """-2 log of Laplace's marginal posterior of the constrained quantity, up to a constant.

    Parameters
    ----------
    at
        Optimum with the quantity fixed.

    Returns
    -------
    deviance
        Up to a constant.
    """
    return at.cost + 2 * at.log_volume


@dataclass(frozen=True)
class PlungeModelForm:
    """Refits with other correlations: common lags, covariance of the lags (C, C) [s2].

    Attributes
    ----------
    common_lag_s
        Common lag by name of the correlation, with the conditioning filter [s].
    covariance
        Sample covariance of the lag vectors (C, C) [s2].
    """

    common_lag_s: dict[str, float]
    covariance: Array

    @property
    def u_common_s(self) -> float:
        """Standard uncertainty of the common lag from the choice of correlation [s]."""
        return common_and_differential_u_s(self.covariance)[0]
