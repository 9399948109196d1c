"""Levenberg-Marquardt on the normal equations: priors, a box, held combinations, robust losses, models that end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.linalg import null_space
from scipy.optimize import nnls

from tcdyn.core import Array
from tcdyn.estimation.problem import Optimum, Problem, Status, inverse

Loss = Literal["linear", "huber", "bisquare"]
TUNING = {"huber": 1.345, "bisquare": 4.685}  # 95 % efficiency for normal noise
TRIALS = 12  # dampings tried before a step is given up
REWEIGHTINGS = 25
SETTLED = 1e-6


@dataclass(frozen=True)
class _State:
    theta: Array
    residual: Array
    jacobian: Array
    cost: float
    gradient: Array
    information: Array


def minimise(
    problem: Problem,
    start: Array,
    *,
    fixed: Array | None = None,
    loss: Loss = "linear",
    limit: int = 60,
    tolerance: float = 1e-6,
    relative: float = 1e-12,
    damping: float = 1e-3,
    secant: bool = False,
) -> Optimum:
    """The least sum of squares from ``start`` (P,).

    Stops once a full Gauss-Newton step would lower the cost by less than ``tolerance`` + ``relative`` x cost (that
    step is still taken), once two steps in a row have, or after ``limit`` steps. Steps are damped in the scale of the
    information's diagonal (Marquardt), the first by ``damping``, no larger than the problem's ``largest``, and put into
    the box, held combinations and all; a parameter on its bound that the gradient pushes outwards stays. ``fixed``
    (C, P): combinations that stay as they are at the start, besides the problem's own. ``secant`` learns from step to
    step what the residuals' own curvature adds to the information (Dennis, Gay and Welsch 1981): of use in curved
    valleys along which the data tell little, where steps by the information alone fall short or go too far. ``loss``
    "huber" or "bisquare" weighs samples anew by their residuals, scaled by the median absolute deviation, until nothing
    moves (bisquare begins at Huber's answer). A start where the model cannot be computed, or that the box does not
    allow, gives Status.NOWHERE and an infinite cost.

    >>> t = np.linspace(0, 1, 50)
    >>> def decay(theta):
    ...     y = theta[0] * np.exp(-t / theta[1])
    ...     return y - 2 * np.exp(-t / 0.3), np.column_stack([y / theta[0], y * t / theta[1] ** 2])
    >>> found = minimise(Problem(("size", "tau"), decay), np.array([1.0, 1.0]))
    >>> found.theta.round(6), found.status.name
    (array([2. , 0.3]), 'CONVERGED')
    """
    search = limit, tolerance, relative, damping, secant
    found = _descend(problem, start, fixed, None, *search)
    if loss == "linear" or not np.isfinite(found.cost):
        return found
    for kind in ("huber", "bisquare") if loss == "bisquare" else ("huber",):
        for _ in range(REWEIGHTINGS):
            weights = weights_of(found.residual, kind)
            before = found.theta
            found = _descend(problem, before, fixed, weights, *search)
            if np.max(np.abs(found.theta - before) / (np.abs(before) + SETTLED)) < SETTLED:
                break
    return found


def held(near: Optimum, toward: str | Array, value: float, **search: float) -> Optimum:
    """The optimum with a parameter, or a combination ``toward`` @ theta, held at ``value``, begun at ``near``.

    What ``near`` held besides its problem's ``fixed`` is free again; keywords as those of :func:`minimise`. The search
    begins where all else has followed as the information at ``near`` says, or, where the model cannot be computed
    there, has stayed.

    >>> from tcdyn.estimation.problem import Problem
    >>> both = Problem(("a", "b"), lambda x: (x - np.array([1.0, 2.0]), np.eye(2)))
    >>> held(minimise(both, np.zeros(2)), "a", 5.0).theta
    array([5., 2.])
    """
    row = near.problem.toward(toward)
    directions = free_directions(near.problem.fixed)
    follow = directions @ inverse(directions.T @ near.information @ directions) @ directions.T @ row
    found = None
    for along in (follow, directions @ (directions.T @ row)):
        if float(row @ along) > 0:
            start = near.theta + along * (value - float(row @ near.theta)) / float(row @ along)
            found = minimise(near.problem, start, fixed=row[None], **search)  # type: ignore[arg-type]
            if found.status is not Status.NOWHERE:
                break
    assert found is not None, "the combination is one that the problem holds fixed"
    return found


def least(optima: Sequence[Optimum]) -> Optimum:
    """The one with the least cost, for instance of several starts.

    >>> from tcdyn.estimation.problem import Problem
    >>> def gap(x): return np.array([x[0] ** 2 - 1, 0.1 * (x[0] - 1)]), np.array([[2 * x[0]], [0.1]])
    >>> two_valleys = Problem(("x",), gap)
    >>> least([minimise(two_valleys, np.array([start])) for start in (-2.0, 2.0)]).theta.round(3)
    array([1.])
    """
    return min(optima, key=lambda o: o.cost)


def _descend(
    problem: Problem,
    start: Array,
    fixed: Array | None,
    weights: Array | None,
    limit: int,
    tolerance: float,
    relative: float,
    damping: float,
    secant: bool,
) -> Optimum:
    rows = problem.fixed if fixed is None else np.vstack([problem.fixed, fixed])
    directions = free_directions(rows)
    now = _state(problem, _inside(np.asarray(start, dtype=float), problem, rows), weights)
    if now is None:
        nothing = np.zeros((0, problem.size))
        full = np.diag(problem.precision)
        return Optimum(
            problem,
            start,
            np.zeros(0),
            nothing,
            np.inf,
            full,
            directions,
            Status.NOWHERE,
            0,
            weights,
        )
    status = Status.STALLED
    steps = 0
    idle = 0
    left = False
    second = np.zeros((problem.size, problem.size))
    while steps < limit:
        low = now.theta <= problem.lower
        at_end = np.flatnonzero(low | (now.theta >= problem.upper))
        if len(
            at_end
        ):  # what must stay: bounds whose multipliers the gradient along the free directions asks for
            normals = directions[at_end].T * np.where(low[at_end], 1.0, -1.0)
            push = directions.T @ now.gradient
            at_end = at_end[nnls(normals, push / (np.abs(normals.T @ push).max() or 1.0))[0] > 0]
        free = (
            free_directions(np.vstack([rows, np.eye(problem.size)[at_end]]))
            if len(at_end)
            else directions
        )
        done = Status.AT_BOUND if len(at_end) else Status.CONVERGED
        slope = free.T @ now.gradient
        curvature = free.T @ now.information @ free
        scale = 1 / np.sqrt(np.maximum(np.diag(curvature), 1e-300))
        slope = slope * scale
        curvature = curvature * scale[:, None] * scale
        if second.any():
            curvature = _curved(curvature, free.T @ second @ free * scale[:, None] * scale)
        unit = np.eye(len(slope))
        enough = tolerance + relative * now.cost
        steps += 1
        if idle == 2 and left:
            status = Status.EDGE
            break
        if idle == 2 or float(slope @ np.linalg.solve(curvature + 1e-13 * unit, slope)) <= enough:
            step = -free @ (scale * np.linalg.solve(curvature + min(damping, 1e-9) * unit, slope))
            last = _state(problem, _inside(now.theta + step, problem, rows), weights)
            now = last if last is not None and last.cost <= now.cost else now
            status = done
            break
        trial = None
        left = False
        for _ in range(TRIALS):
            step = -free @ (scale * np.linalg.solve(curvature + damping * unit, slope))
            step = step / max(1.0, float(np.max(np.abs(step) / problem.largest)))
            trial = _state(problem, _inside(now.theta + step, problem, rows), weights)
            left |= trial is None
            if trial is not None and trial.cost <= now.cost:
                break
            trial = None
            damping = max(damping * 10.0, 1e-3)
        if trial is None:
            status = Status.EDGE if left else done
            break
        idle = idle + 1 if now.cost - trial.cost <= enough else 0
        second = _learnt(second, now, trial, weights) if secant else second
        now = trial
        damping = max(damping / 8.0, 1e-12)
    return Optimum(
        problem,
        now.theta,
        now.residual,
        now.jacobian,
        now.cost,
        now.information,
        directions,
        status,
        steps,
        weights,
    )


def _curved(information: Array, second: Array) -> Array:
    """The curvature with its ``second`` part, unless that leaves less than a tenth of the information anywhere."""
    whole = information + second
    try:
        np.linalg.cholesky(whole - 0.1 * information)
    except np.linalg.LinAlgError:
        return information
    return whole


def _learnt(second: Array, before: _State, after: _State, weights: Array | None) -> Array:
    """What a step tells of sum_i residual_i (its second derivatives), (P, P): sized secant update of least change.

    Dennis, Gay and Welsch (1981), An adaptive nonlinear least-squares algorithm, ACM Trans. Math. Softw. 7, 348-368.
    """
    step = after.theta - before.theta
    turned = after.gradient - before.gradient
    along = float(turned @ step)
    if along <= 0:
        return second
    wanted = (after.jacobian - before.jacobian).T @ (
        after.residual * (1.0 if weights is None else weights)
    )
    known = abs(float(step @ second @ step))
    second = second * (min(1.0, abs(float(step @ wanted)) / known) if known else 1.0)
    gap = wanted - second @ step
    both = np.outer(gap, turned)
    return second + (both + both.T - float(gap @ step) / along * np.outer(turned, turned)) / along


def free_directions(fixed: Array) -> Array:
    """Orthonormal directions (P, F) that leave every combination ``fixed`` (C, P) as it is.

    Parameters that no combination holds keep axes of their own, so that their scales stay apart.

    >>> free_directions(np.array([[1.0, 1.0, 0.0]])).shape  # of three parameters, the sum of two is held
    (3, 2)
    """
    moving = np.any(fixed != 0, axis=0)
    own = np.eye(fixed.shape[1])[:, ~moving]
    within = np.zeros((len(moving), 0))
    if moving.any():
        basis = null_space(fixed[:, moving])
        within = np.zeros((len(moving), basis.shape[1]))
        within[moving] = basis
    return np.hstack([own, within])


def _inside(theta: Array, problem: Problem, rows: Array) -> Array | None:
    """``theta`` (P,) put into the box with the combinations ``rows`` @ theta (C,) as they are; None if that cannot be.

    Whatever a bound takes from a combination its other parameters give back, in equal parts for equal weights.
    """
    value = rows @ theta
    size = np.abs(rows) @ np.abs(theta)
    free = np.any(rows != 0, axis=0)
    for _ in range(problem.size + 1):
        put = np.clip(theta, problem.lower, problem.upper)
        gap = value - rows @ put
        if np.all(np.abs(gap) <= 1e-12 * size):
            return np.asarray(put)
        free &= put == theta
        theta = put.copy()
        theta[free] += np.linalg.lstsq(rows[:, free], gap, rcond=None)[0]
    return None


def _state(problem: Problem, theta: Array | None, weights: Array | None) -> _State | None:
    """Cost, half-gradient and information at ``theta``; None where there is none."""
    answer = None if theta is None else problem.evaluate(theta)
    if theta is None or answer is None:
        return None
    residual, jacobian = answer
    gap = theta - problem.prior_mean
    heavy = jacobian if weights is None else weights[:, None] * jacobian
    cost = float(
        residual @ (residual if weights is None else weights * residual)
        + problem.precision @ gap**2
    )
    information = jacobian.T @ heavy + np.diag(problem.precision)
    if not np.isfinite(cost) or not np.isfinite(information).all():
        return None
    return _State(
        theta, residual, jacobian, cost, heavy.T @ residual + problem.precision * gap, information
    )


def weights_of(residual: Array, loss: str) -> Array:
    """psi(r)/r (N,) of "huber" or "bisquare", with the scale from the median absolute deviation."""
    z = _standardised(residual, loss)
    if loss == "huber":
        return np.asarray(np.minimum(1.0, 1.0 / np.maximum(z, 1e-300)))
    return np.asarray(np.where(z < 1, (1 - z**2) ** 2, 0.0))


def robust_covariance(residual: Array, jacobian: Array, loss: str) -> Array:
    """Huber's covariance of an M-estimate: [sum psi^2/(n - p)] / mean(psi')^2 (J'J)^-1 (Huber 1981, eq. 7.6.5).

    >>> r = np.array([0.5, -0.4, 0.1, -0.2, 9.0])  # the last one spoils the plain covariance only
    >>> bool(robust_covariance(r, np.ones((5, 1)), "huber")[0, 0] < r.var() / 5)
    True
    """
    n, p = jacobian.shape
    z = _standardised(residual, loss)
    psi = weights_of(residual, loss) * residual
    inside = z < 1
    slope = inside if loss == "huber" else np.where(inside, (1 - z**2) * (1 - 5 * z**2), 0.0)
    variance = float(psi @ psi) / (n - p) / float(np.mean(slope)) ** 2
    return np.asarray(variance * inverse(jacobian.T @ jacobian))


def _standardised(residual: Array, loss: str) -> Array:
    """|r| in units of the tuning constant times the scale from the median absolute deviation."""
    scale = 1.4826 * float(np.median(np.abs(residual - np.median(residual)))) + 1e-300
    return np.asarray(np.abs(residual) / (TUNING[loss] * scale))
