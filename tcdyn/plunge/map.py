"""Maximum a posteriori estimate of the plunge parameters: damped Gauss-Newton with explicit priors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from calibration.disk import DiskSetup
from immersion.correlations import Correlation
from tcdyn.plunge.layout import Layout
from tcdyn.plunge.model import RunModel, Surface, build_run_model, predict_run
from tcdyn.plunge.noise import Inflation, block_sd, channel_sd, inflation
from tcdyn.plunge.run import Blocks, PlungeRun

Array = NDArray[np.float64]
LEAST_LAG_S = 2e-3


@dataclass(frozen=True)
class Problem:
    """Models of all runs, prior, and noise: everything the posterior of the parameters depends on."""

    models: tuple[RunModel, ...]
    layout: Layout
    mean: Array
    sd: Array
    noise_sd_K: tuple[Array, ...]  # (C,) per run
    inflation: tuple[Inflation, ...]
    weight: tuple[Array, ...]  # (B, C) per run, 1 or less for outlying blocks


@dataclass(frozen=True)
class Optimum:
    """The most probable parameters, the Hessian of half the cost there, and the residuals (K) of each run."""

    theta: Array
    hessian: Array
    cost: float
    residuals_K: tuple[Array, ...]
    predictions_degC: tuple[Array, ...]
    surfaces: tuple[Surface, ...]
    iterations: int
    converged: bool
    problem: Problem = field(repr=False)

    @property
    def covariance(self) -> Array:
        """Inverse Hessian: the posterior's covariance in its normal approximation."""
        return inverse(self.hessian)


def inverse(hessian: Array) -> Array:
    """Inverse of a positive definite matrix of very unequal scales."""
    scale = 1 / np.sqrt(np.diag(hessian))
    scaled = hessian * scale[:, None] * scale
    return np.asarray(np.linalg.inv(scaled) * scale[:, None] * scale)


def precision(problem: Problem) -> Array:
    """Prior precision of each parameter; zero where flat."""
    return np.where(np.isfinite(problem.sd), 1 / problem.sd**2, 0.0)


def whitened(array: Array, problem: Problem, r: int) -> tuple[Array, Array]:
    """Mean over channels and deviations from it, each divided by its noise: what least squares sums.

    ``array`` has shape (B, C) or (B, C, P); comes back as (B, ...) and (B, C, ...).
    """
    blocks = problem.models[r].blocks
    w = np.sqrt(problem.weight[r]) / block_sd(problem.noise_sd_K[r], blocks.count)
    scaled = array * (w if array.ndim == 2 else w[:, :, None])
    mean = scaled.mean(axis=1)
    c = array.shape[1]
    return (
        mean * np.sqrt(c / problem.inflation[r].common),
        (scaled - mean[:, None]) / np.sqrt(problem.inflation[r].differential),
    )


def normal_equations(
    problem: Problem, theta: Array, starts: Sequence[Array | None]
) -> tuple[float, Array, Array, list[Array], list[Array], list[Surface]]:
    """Half-gradient and Gauss-Newton Hessian of the cost at ``theta``, with residuals and predictions."""
    gap = theta - problem.mean
    weights = precision(problem)
    cost = float(np.sum(weights * np.where(weights > 0, gap, 0.0) ** 2))
    gradient = weights * gap
    hessian = np.diag(weights)
    residuals, predictions, surfaces = [], [], []
    for r, model in enumerate(problem.models):
        y, jac, surface = predict_run(model, theta, r, starts[r])
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
    problem: Problem, theta: Array, *, limit: int = 30, tolerance: float = 2e-2, directions: Array | None = None
) -> Optimum:
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
            new[lay.lag] = np.maximum(new[lay.lag], LEAST_LAG_S)
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
    return Optimum(
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


def _limited(step: Array, lay: Layout) -> Array:
    """The step, shortened so that no h, burst or split changes by more than e-fold and no lag by more than 0.5 s."""
    largest = np.full(lay.size, np.inf)
    for r in range(lay.runs):
        largest[lay.run(r)][:5] = 1.0
    largest[lay.lag] = 0.5
    largest[lay.split] = largest[lay.common_split] = 1.5
    return step / max(1.0, float(np.max(np.abs(step) / largest)))


def fit_map(
    runs: Sequence[PlungeRun],
    blocks: Sequence[Blocks],
    setup: DiskSetup,
    layout: Layout,
    correlation: Correlation,
    mean: Array,
    sd: Array,
    *,
    start: Array | None = None,
    face_W_m2K: float = 0.0,
    passes: int = 2,
) -> Optimum:
    """Fit, judge the noise by the residuals, relinearise the conduction about the answer, and fit again.

    ``passes`` counts the refits. Blocks further off than 4 standard deviations lose weight (Huber) in refits.
    """
    theta = np.array(mean if start is None else start, dtype=float)
    if start is None:
        theta[layout.lag] = 0.5
    models = _models(runs, blocks, setup, layout, correlation, theta, face_W_m2K)
    problem = Problem(
        models,
        layout,
        mean,
        sd,
        tuple(b.noise_sd_K for b in blocks),
        tuple(Inflation() for _ in blocks),
        tuple(np.ones(b.readings_degC.shape) for b in blocks),
    )
    if start is None:
        theta = _staged(problem, theta)
    best = minimise(problem, theta)
    for _ in range(passes):
        theta = best.theta
        moved = (
            abs(theta[layout.ln_k] - models[0].ln_k) > 2e-3
            or np.max(np.abs(theta[layout.depth] - models[0].depth_shift_m)) > 2e-5
        )
        if moved:
            models = _models(runs, blocks, setup, layout, correlation, theta, face_W_m2K)
        problem = judged(replace(problem, models=models), best)
        best = minimise(problem, theta)
    return best


def _staged(problem: Problem, theta: Array) -> Array:
    """A start near the valley: h and initial temperature first, then lags and static offsets too."""
    names = problem.layout.names()
    stages = (("ln_h_", "initial_"), ("ln_h_", "initial_", "lag_", "offset_"))
    for starts in stages:
        free = np.eye(problem.layout.size)[:, [n.startswith(starts) for n in names]]
        theta = minimise(problem, theta, limit=6, directions=free).theta
    return theta


def judged(problem: Problem, best: Optimum) -> Problem:
    """The problem with noise, inflation and block weights taken from the residuals at ``best``."""
    c = len(problem.layout.channels)
    noise, factors, weights = [], [], []
    for residual, model in zip(best.residuals_K, problem.models):
        count = model.blocks.count
        share = max(1 - (8 + 3 * c) / residual.size, 0.5)
        sd = channel_sd(residual, count, share)
        z = residual / block_sd(sd, count)
        size = np.maximum(np.abs(z), 1e-12)
        weight = np.minimum(1.0, 4.0 / size)
        noise.append(sd)
        weights.append(weight)
        factors.append(inflation(z * np.sqrt(weight), 8, 3 * c))
    return replace(problem, noise_sd_K=tuple(noise), inflation=tuple(factors), weight=tuple(weights))


def _models(
    runs: Sequence[PlungeRun],
    blocks: Sequence[Blocks],
    setup: DiskSetup,
    layout: Layout,
    correlation: Correlation,
    theta: Array,
    face_W_m2K: float,
) -> tuple[RunModel, ...]:
    ln_k, shift = float(theta[layout.ln_k]), theta[layout.depth]
    return tuple(
        build_run_model(run, b, setup, layout, correlation, ln_k, shift, face_W_m2K) for run, b in zip(runs, blocks)
    )
