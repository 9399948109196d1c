"""Posterior of the plunge parameters: whitened residuals with their Jacobian, explicit priors, noise judged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from calibration.arrays import Array
from calibration.disk import DiskSetup
from immersion.correlations import Bath, Correlation
from tcdyn.plunge.model import RunModel, RunSurface, build_run_model, predict_run
from tcdyn.plunge.parameters import PlungeParameters, PlungePriors
from tcdyn.plunge.run import PlungeBlocks, PlungeRun

LEAST_LAG_S = 2e-3


@dataclass(frozen=True)
class RunNoise:
    """Noise of one plunge: of a sample (C,) [K], weights (B, C), 1 or less for outlying blocks, and variance factors.

    ``common`` and ``differential`` widen the variance of the residuals' mean over channels and of their deviations
    from it, for residuals that are coloured; 1 for white noise.
    """

    sd_K: Array
    weight: Array
    common: float = 1.0
    differential: float = 1.0

    @classmethod
    def white(cls, blocks: PlungeBlocks) -> RunNoise:
        """As the samples scatter about their neighbours."""
        return cls(blocks.noise_sd_K, np.ones(blocks.readings_degC.shape))


def block_sd(noise_sd_K: Array, count: Array) -> Array:
    """Standard deviation of block means (B, C) for white noise; infinite where a block holds no sample."""
    return np.where(count > 0, noise_sd_K / np.sqrt(np.maximum(count, 1)), np.inf)


def correlation_length(z: Array, longest: int = 40) -> float:
    """1 + 2 sum of the autocorrelations of ``z`` (N,) up to the first that is not significant; 1 for white noise."""
    z = z - np.mean(z)
    n = len(z)
    power = float(z @ z)
    if power == 0 or n < 8:
        return 1.0
    total = 1.0
    for k in range(1, min(longest, n // 4)):
        rho = float(z[k:] @ z[:-k]) / power
        if rho < 2 / np.sqrt(n):
            break
        total += 2 * rho
    return total


def inflation(standardised: Array, parameters_common: int, parameters_differential: int) -> tuple[float, float]:
    """Variance factors, common and differential, of standardised residuals (B, C) of one run; at least one quarter.

    The mean over channels and the deviations from it are judged apart, because an error of the bath or of h moves
    all channels together and noise does not. Each factor is a mean square times a correlation length.
    """
    b, c = standardised.shape
    mean = np.mean(standardised, axis=1)
    rest = standardised - mean[:, None]
    common = c * float(np.sum(mean**2)) / max(b - parameters_common, 1) * correlation_length(mean)
    if c == 1:
        return max(common, 0.25), 1.0
    freedom = max((b * (c - 1)) - parameters_differential, 1)
    lengths = float(np.mean([correlation_length(column) for column in rest.T]))
    return max(common, 0.25), max(float(np.sum(rest**2)) / freedom * lengths, 0.25)


def channel_sd(residual: Array, count: Array, freedom_share: float = 1.0) -> Array:
    """Noise of one sample per channel [K] from block residuals (B, C): robust, then scaled to a mean square."""
    scaled = residual * np.sqrt(count)
    sd = 1.4826 * np.median(np.abs(scaled), axis=0)
    inside = np.abs(scaled) < 4 * np.maximum(sd, 1e-12)
    square = np.sum(np.where(inside, scaled**2, 0.0), axis=0) / np.maximum(inside.sum(axis=0), 1)
    return np.asarray(np.sqrt(np.maximum(square, 1e-12) / freedom_share))


@dataclass(frozen=True)
class PlungeProblem:
    """Models of all runs, prior, and noise: everything the posterior of the parameters depends on."""

    models: tuple[RunModel, ...]
    layout: PlungeParameters
    mean: Array
    sd: Array
    noise: tuple[RunNoise, ...]


@dataclass(frozen=True)
class PlungeOptimum:
    """The most probable parameters, the Hessian of half the cost there, and the residuals (K) of each run."""

    theta: Array
    hessian: Array
    cost: float
    residuals_K: tuple[Array, ...]
    predictions_degC: tuple[Array, ...]
    surfaces: tuple[RunSurface, ...]
    iterations: int
    converged: bool
    problem: PlungeProblem = field(repr=False)

    @property
    def lag_s(self) -> Array:
        """The chains' own lags (C,) [s], the conditioning filter's left out."""
        return self.theta[self.problem.layout.at("lag")]

    @property
    def covariance(self) -> Array:
        """Inverse Hessian: the posterior's covariance in its normal approximation."""
        return inverse(self.hessian)


def inverse(hessian: Array) -> Array:
    """Inverse of a positive definite matrix of very unequal scales."""
    scale = 1 / np.sqrt(np.diag(hessian))
    scaled = hessian * scale[:, None] * scale
    return np.asarray(np.linalg.inv(scaled) * scale[:, None] * scale)


def precision(problem: PlungeProblem) -> Array:
    """Prior precision of each parameter; zero where flat."""
    return np.where(np.isfinite(problem.sd), 1 / problem.sd**2, 0.0)


def whitened(array: Array, problem: PlungeProblem, r: int) -> tuple[Array, Array]:
    """Mean over channels and deviations from it, each divided by its noise: what least squares sums.

    ``array`` has shape (B, C) or (B, C, P); comes back as (B, ...) and (B, C, ...).
    """
    noise = problem.noise[r]
    w = np.sqrt(noise.weight) / block_sd(noise.sd_K, problem.models[r].blocks.count)
    scaled = array * (w if array.ndim == 2 else w[:, :, None])
    mean = scaled.mean(axis=1)
    c = array.shape[1]
    return (
        mean * np.sqrt(c / noise.common),
        (scaled - mean[:, None]) / np.sqrt(noise.differential),
    )


def normal_equations(
    problem: PlungeProblem, theta: Array, starts: Sequence[Array | None]
) -> tuple[float, Array, Array, list[Array], list[Array], list[RunSurface]]:
    """Half-gradient and Gauss-Newton Hessian of the cost at ``theta``, with residuals and predictions."""
    gap = theta - problem.mean
    weights = precision(problem)
    cost = float(np.sum(weights * np.where(weights > 0, gap, 0.0) ** 2))
    gradient = weights * gap
    hessian = np.diag(weights)
    residuals, predictions, surfaces = [], [], []
    for r, model in enumerate(problem.models):
        y, jac, surface = predict_run(model, problem.layout, theta, r, starts[r])
        residual = np.where(model.blocks.count > 0, model.blocks.readings_degC - y, 0.0)
        e0, e1 = whitened(residual, problem, r)
        j0, j1 = whitened(jac, problem, r)
        j1 = j1.reshape(-1, j1.shape[-1])
        e = np.concatenate([e0, e1.ravel()])
        j = np.concatenate([j0, j1])
        cost += float(e @ e)
        gradient = gradient - j.T @ e
        hessian = hessian + j.T @ j
        residuals.append(residual)
        predictions.append(y)
        surfaces.append(surface)
    return cost, gradient, hessian, residuals, predictions, surfaces


def minimise(
    problem: PlungeProblem, theta: Array, *, limit: int = 30, tolerance: float = 2e-2, directions: Array | None = None
) -> PlungeOptimum:
    """Levenberg-Marquardt from ``theta`` until a full step would lower the cost by less than ``tolerance``,
    or until two steps in a row have.

    The cost is in units of chi-square. ``directions`` (P, F), orthonormal, are those the parameters may move along;
    None frees all of them.
    """
    lay = problem.layout
    free = np.eye(lay.size) if directions is None else directions
    starts: list[Array | None] = [None] * lay.runs
    state = normal_equations(problem, theta, starts)
    damping, converged, steps, idle = 1e-4, False, 0, 0
    guard = np.sum(free**2 * precision(problem)[:, None], axis=0)
    for steps in range(1, limit + 1):  # noqa: B007
        cost, gradient, hessian = state[:3]
        slope, curvature = free.T @ gradient, free.T @ hessian @ free
        if float(slope @ _solve(curvature, slope)) < tolerance:
            converged = True
            break
        starts = [s.temperature_degC for s in state[5]]
        accepted = False
        for _ in range(8):
            step = -free @ _solve(
                curvature + damping * np.diag(np.diag(curvature)) + 1e4 * damping * np.diag(guard), slope
            )
            new = theta + _limited(step, lay)
            new[lay.at("lag")] = np.maximum(new[lay.at("lag")], LEAST_LAG_S)
            trial = normal_equations(problem, new, starts)
            if np.isfinite(trial[0]) and trial[0] <= cost + 1e-9:
                accepted = True
                break
            damping = max(damping * 10, 1e-3)
        if not accepted:
            converged = True  # no step lowers the cost: at the optimum to rounding
            break
        idle = idle + 1 if cost - trial[0] < tolerance else 0
        theta, state = new, trial
        damping = max(damping / 10, 1e-9)
        if idle >= 2:
            converged = True
            break
    return PlungeOptimum(
        theta,
        state[2],
        state[0],
        tuple(state[3]),
        tuple(state[4]),
        tuple(state[5]),
        steps,
        converged,
        problem,
    )


def _solve(matrix: Array, rhs: Array) -> Array:
    scale = 1 / np.sqrt(np.diag(matrix))
    return np.asarray(scale * np.linalg.solve(matrix * scale[:, None] * scale, rhs * scale))


def _limited(step: Array, lay: PlungeParameters) -> Array:
    """The step, shortened so that no h, burst or split changes by more than e-fold and no lag by more than 0.5 s."""
    largest = np.full(lay.size, np.inf)
    largest[lay.mask("ln_h", "h_exponent", "ln_burst", "ln_burst_time", "ln_burst_shape")] = 1.0
    largest[lay.at("lag")] = 0.5
    largest[lay.mask("split", "common_split")] = 1.5
    return step / max(1.0, float(np.max(np.abs(step) / largest)))


def fit_map(
    runs: Sequence[PlungeRun],
    blocks: Sequence[PlungeBlocks],
    setup: DiskSetup,
    layout: PlungeParameters,
    correlation: Correlation,
    mean: Array,
    sd: Array,
    *,
    start: Array | None = None,
    face_W_m2K: float = 0.0,
    passes: int = 2,
) -> PlungeOptimum:
    """Fit, judge the noise by the residuals, relinearise the conduction about the answer, and fit again.

    ``passes`` counts the refits. PlungeBlocks further off than 4 standard deviations lose weight (Huber) in refits.
    """
    theta = np.array(mean if start is None else start, dtype=float)
    if start is None:
        theta[layout.at("lag")] = 0.5

    def built(about: Array) -> tuple[RunModel, ...]:
        return tuple(
            build_run_model(run, b, setup, layout, correlation, about, face_W_m2K) for run, b in zip(runs, blocks)
        )

    about, models = theta, built(theta)
    problem = PlungeProblem(models, layout, mean, sd, tuple(RunNoise.white(b) for b in blocks))
    if start is None:
        theta = _staged(problem, theta)
    best = minimise(problem, theta)
    for _ in range(passes):
        theta = best.theta
        moved = np.abs(theta - about)
        if np.any(moved[layout.at("ln_conductivity")] > 2e-3) or np.any(moved[layout.at("depth")] > 2e-5):
            about, models = theta, built(theta)
        problem = replace(judged(best), models=models)
        best = minimise(problem, theta)
    return best


def _staged(problem: PlungeProblem, theta: Array) -> Array:
    """A start near the valley: h and initial temperature first, then lags and static offsets too."""
    first = ("ln_h", "initial")
    for kinds in (first, (*first, "lag", "offset")):
        free = np.eye(problem.layout.size)[:, problem.layout.mask(*kinds)]
        theta = minimise(problem, theta, limit=6, directions=free).theta
    return theta


def judged(best: PlungeOptimum) -> PlungeProblem:
    """The problem of ``best`` with noise, variance factors and block weights taken from the residuals there."""
    c, noise = len(best.problem.layout.channels), []
    for residual, model in zip(best.residuals_K, best.problem.models):
        count = model.blocks.count
        share = max(1 - (8 + 3 * c) / residual.size, 0.5)
        sd = channel_sd(residual, count, share)
        z = residual / block_sd(sd, count)
        weight = np.minimum(1.0, 4.0 / np.maximum(np.abs(z), 1e-12))
        noise.append(RunNoise(sd, weight, *inflation(z * np.sqrt(weight), 8, 3 * c)))
    return replace(best.problem, noise=tuple(noise))


def full_prior(
    layout: PlungeParameters,
    priors: PlungePriors,
    runs: Sequence[PlungeRun],
    initial_degC: Sequence[float],
    bath_degC: Sequence[float],
    correlation: Correlation,
    setup: DiskSetup,
) -> tuple[Array, Array]:
    """Mean and standard deviation of all parameters before the data; each h scale widened by its fluid's properties.

    ``initial_degC`` and ``bath_degC`` (runs,) are the temperatures between which those properties are taken.
    """
    baths = [Bath(run.fluid, correlation, setup.width_m, 2 * setup.outer_radius_m) for run in runs]
    h_u_rel = [b.property_u_rel(*span)["total"] for b, *span in zip(baths, initial_degC, bath_degC)]
    return layout.prior(priors, [run.entry.u_s for run in runs], initial_degC, h_u_rel)
