"""Nonlinear least squares by damped Gauss-Newton steps (Levenberg-Marquardt).

It works on the normal equations, with priors, box bounds, fixed combinations of parameters, robust
losses (outlier rejection), and models that cannot be computed everywhere.
``scipy.optimize.least_squares`` has neither fixed combinations nor models that return None. All
fits of the library use it. Guarded by ``tests/estimation/test_fitting.py`` and
``tests/estimation/test_nist.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.linalg import null_space
from scipy.optimize import nnls

from tcdyn.core import Array
from tcdyn.estimation.problem import Optimum, Problem, Status, inverse

# Loss of the residuals: squares, or a robust loss.
Loss = Literal["linear", "huber", "bisquare"]
# tuning constants of the robust losses: 95 % efficiency for normal noise
TUNING = {"huber": 1.345, "bisquare": 4.685}
# dampings tried before a step fails, each ten times the one before; chosen by judgement
DAMPING_TRIALS = 12
# reweightings at most, and the relative change of a parameter at which they end;
# chosen by judgement
REWEIGHTINGS = 25
WEIGHTS_SETTLED = 1e-6
# Part of a step at which the curvature along it is measured, and the largest half bend over the
# step, as Transtrum and Sethna (2012) propose; they change the number of steps only.
PROBE = 0.1
LARGEST_BEND = 0.375


@dataclass(frozen=True)
class _State:
    """One point of a search.

    Parameters
    ----------
    theta
        Parameters, (P,).
    residual, jacobian
        Residual (N,) and Jacobian (N, P) there, without robust weights.
    cost
        Sum of squares with weights and priors.
    gradient
        Half the gradient of the cost, (P,).
    information
        Half the Gauss-Newton Hessian of the cost, (P, P).
    """

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
    """Minimise the sum of squares of ``problem`` from ``start`` (P,) by Levenberg-Marquardt steps.

    The search stops once a full Gauss-Newton step would lower the cost by less than ``tolerance`` +
    ``relative`` x cost (that step is still taken), once two steps in a row have, or after ``limit``
    steps. Steps are damped in the scale of the diagonal of the information (Marquardt), limited by
    the problem's ``max_step``, and clipped to the box such that fixed combinations stay. A
    parameter on its bound that the gradient pushes outwards stays there.

    Parameters
    ----------
    problem
        What is fitted.
    start
        Start values (P,).
    fixed
        Combinations (C, P) that keep their value of the start, besides the problem's own.
    loss
        ``linear``, or a robust loss ``huber`` or ``bisquare``: samples are reweighted by their
        residuals, scaled by the median absolute deviation, until the parameters do not change
        (bisquare starts from Huber's estimate).
    limit
        Largest number of steps.
    tolerance, relative
        Absolute and relative decrease of the cost at which the search stops.
    damping
        Damping of the first step.
    secant
        Estimate from step to step what the second derivatives of the residuals add to the
        information (Dennis, Gay and Welsch 1981). This helps in curved valleys along which the data
        determine little, where the residual without its Jacobian takes as long as with it.

    Returns
    -------
    Optimum
        With Status.NOWHERE and an infinite cost if the model cannot be computed at the start or the
        box does not allow it.

    Notes
    -----
    Where the problem gives its residual without Jacobian, each step follows the curve of the
    residuals to second order (geodesic acceleration: M. K. Transtrum, J. P. Sethna, Improvements to
    the Levenberg-Marquardt algorithm, arXiv:1201.5885, 2012). In curved valleys along which the
    data determine little this needs up to eight times fewer steps.

    The damping falls to an eighth after a step that lowers the cost, and rises tenfold after one
    that does not. These factors, ``limit`` and ``damping`` change the number of steps, not the
    optimum. ``tolerance`` is in the unit of the cost: 1e-6 means a millionth of a standard
    deviation squared where residuals are whitened.

    Examples
    --------
    >>> t = np.linspace(0, 1, 50)
    >>> def decay(theta):
    ...     y = theta[0] * np.exp(-t / theta[1])
    ...     return y - 2 * np.exp(-t / 0.3), np.column_stack([y / theta[0], y * t / theta[1] ** 2])
    >>> fit = minimise(Problem(("size", "tau"), decay), np.array([1.0, 1.0]))
    >>> fit.theta.round(6), fit.status.name
    (array([2. , 0.3]), 'CONVERGED')
    """
    options = limit, tolerance, relative, damping, secant
    optimum = _descend(problem, start, fixed, None, *options)
    if loss == "linear" or not np.isfinite(optimum.cost):
        return optimum
    kinds: tuple[Loss, ...] = ("huber", "bisquare") if loss == "bisquare" else ("huber",)
    for robust_loss in kinds:
        for _ in range(REWEIGHTINGS):
            weights = robust_weights(optimum.residual, robust_loss)
            before = optimum.theta
            optimum = _descend(problem, before, fixed, weights, *options)
            change = np.abs(optimum.theta - before) / (np.abs(before) + WEIGHTS_SETTLED)
            if np.max(change) < WEIGHTS_SETTLED:
                break
    return optimum


def minimise_constrained(
    near: Optimum, toward: str | Array, value: float, **search: float
) -> Optimum:
    """The optimum with a parameter, or a combination ``toward`` @ theta, fixed at ``value``.

    The search starts where all other parameters follow as the information at ``near`` says, or,
    where the model cannot be computed there, from their values. Combinations that ``near`` fixed
    besides its problem's ``fixed`` are free again. The keywords are those of :func:`minimise`.

    Parameters
    ----------
    near
        An optimum of the same problem.
    toward
        Name of a parameter, or a combination, (P,).
    value
        The number at which it is fixed.
    **search
        Keywords of :func:`minimise`.

    Examples
    --------
    >>> from tcdyn.estimation.problem import Problem
    >>> both = Problem(("a", "b"), lambda x: (x - np.array([1.0, 2.0]), np.eye(2)))
    >>> minimise_constrained(minimise(both, np.zeros(2)), "a", 5.0).theta
    array([5., 2.])
    """
    row = near.problem.direction(toward)
    directions = free_directions(near.problem.fixed)
    following = (
        directions @ inverse(directions.T @ near.information @ directions) @ directions.T @ row
    )
    optimum = None
    for step in (following, directions @ (directions.T @ row)):
        if float(row @ step) > 0:
            start = near.theta + step * (value - float(row @ near.theta)) / float(row @ step)
            optimum = minimise(
                near.problem,
                start,
                fixed=row[None],
                **search,  # type: ignore[arg-type]
            )
            if optimum.status is not Status.NOWHERE:
                break
    assert optimum is not None, "the combination is one that the problem holds fixed"
    return optimum


def lowest_cost(optima: Sequence[Optimum]) -> Optimum:
    """The optimum with the lowest cost, for instance of several starts.

    Parameters
    ----------
    optima
        At least one optimum.

    Examples
    --------
    >>> from tcdyn.estimation.problem import Problem
    >>> def gap(x):
    ...     return np.array([x[0] ** 2 - 1, 0.1 * (x[0] - 1)]), np.array([[2 * x[0]], [0.1]])
    >>> two_valleys = Problem(("x",), gap)
    >>> optima = [minimise(two_valleys, np.array([start])) for start in (-2.0, 2.0)]
    >>> lowest_cost(optima).theta.round(3)
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
    """Levenberg-Marquardt descent from one start: damped steps until the cost no longer falls.

    Parameters
    ----------
    problem
        What is fitted.
    start
        Start values, (P,).
    fixed
        Combinations that keep their value, (C, P), besides those of the problem; None for no more.
    weights
        Robust weights of the residuals, (N,); None for all one.
    limit, tolerance, relative, damping, secant
        As in ``minimise``.

    Returns
    -------
    The optimum, also where the search fails; its ``status`` says how it ended.

    Notes
    -----
    A bound stays active while its multiplier is positive; the multipliers come from non-negative
    least squares. The curvature is scaled to a unit diagonal, so that the damping is Marquardt's.
    Every trial goes through ``_project_to_box``.
    """
    rows = problem.fixed if fixed is None else np.vstack([problem.fixed, fixed])
    directions = free_directions(rows)
    current = _evaluated_state(
        problem, _project_to_box(np.asarray(start, dtype=float), problem, rows), weights
    )
    if current is None:
        no_jacobian = np.zeros((0, problem.size))
        information = np.diag(problem.precision)
        return Optimum(
            problem,
            start,
            np.zeros(0),
            no_jacobian,
            np.inf,
            information,
            directions,
            Status.NOWHERE,
            0,
            weights,
        )
    status = Status.STALLED
    steps = 0
    small_steps = 0
    model_failed = False
    second_order = np.zeros((problem.size, problem.size))
    while steps < limit:
        at_lower = current.theta <= problem.lower
        on_bound = np.flatnonzero(at_lower | (current.theta >= problem.upper))
        if len(on_bound):
            # bounds stay active where their multipliers along the free directions are positive
            normals = directions[on_bound].T * np.where(at_lower[on_bound], 1.0, -1.0)
            push = directions.T @ current.gradient
            scale = np.abs(normals.T @ push).max() or 1.0
            on_bound = on_bound[nnls(normals, push / scale)[0] > 0]
        free = directions
        if len(on_bound):
            free = free_directions(np.vstack([rows, np.eye(problem.size)[on_bound]]))
        converged_status = Status.AT_BOUND if len(on_bound) else Status.CONVERGED
        slope = free.T @ current.gradient
        curvature = free.T @ current.information @ free
        scale = 1 / np.sqrt(np.maximum(np.diag(curvature), 1e-300))
        slope = slope * scale
        curvature = curvature * scale[:, None] * scale
        if second_order.any():
            curvature = _with_second_order(
                curvature, free.T @ second_order @ free * scale[:, None] * scale
            )
        unit = np.eye(len(slope))
        small_decrease = tolerance + relative * current.cost
        steps += 1
        if small_steps == 2 and model_failed:
            status = Status.EDGE
            break
        newton_decrease = float(slope @ np.linalg.solve(curvature + 1e-13 * unit, slope))
        if small_steps == 2 or newton_decrease <= small_decrease:
            step = -free @ (scale * np.linalg.solve(curvature + min(damping, 1e-9) * unit, slope))
            final = _evaluated_state(
                problem, _project_to_box(current.theta + step, problem, rows), weights
            )
            if final is not None and final.cost <= current.cost:
                current = final
            status = converged_status
            break
        trial = None
        model_failed = False
        for _ in range(DAMPING_TRIALS):
            damped = curvature + damping * unit
            straight = -np.linalg.solve(damped, slope)
            longest = np.max(np.abs(free @ (scale * straight)) / problem.max_step)
            straight /= max(1.0, float(longest))
            step = free @ (scale * straight)
            pull = _pull_of_curve(problem, current, step, weights)
            if pull is not None:
                bend = -0.5 * np.linalg.solve(damped, scale * (free.T @ pull))
                if np.linalg.norm(bend) > LARGEST_BEND * np.linalg.norm(straight):
                    damping = max(damping * 10.0, 1e-3)
                    continue
                step = step + free @ (scale * bend)
            trial = _evaluated_state(
                problem, _project_to_box(current.theta + step, problem, rows), weights
            )
            model_failed |= trial is None
            if trial is not None and trial.cost <= current.cost:
                break
            trial = None
            damping = max(damping * 10.0, 1e-3)
        if trial is None:
            status = Status.EDGE if model_failed else converged_status
            break
        small_steps = small_steps + 1 if current.cost - trial.cost <= small_decrease else 0
        if secant:
            second_order = _updated_second_order(second_order, current, trial, weights)
        current = trial
        damping = max(damping / 8.0, 1e-12)
    return Optimum(
        problem,
        current.theta,
        current.residual,
        current.jacobian,
        current.cost,
        current.information,
        directions,
        status,
        steps,
        weights,
    )


def _pull_of_curve(
    problem: Problem, current: _State, step: Array, weights: Array | None
) -> Array | None:
    """Half the gradient of the cost (P,) that the curvature of the residuals along a step adds.

    Parameters
    ----------
    problem
        What is fitted.
    current
        The state at the start of the step.
    step
        The step (P,).
    weights
        Robust weights (N,); None for all one.

    Returns
    -------
    array or None
        None where the problem has no residual without Jacobian, or where it cannot be computed.
    """
    ahead = current.theta + PROBE * step
    is_inside = np.all(ahead >= problem.lower) and np.all(ahead <= problem.upper)
    if problem.residual is None or not is_inside:
        return None
    residual = problem.residual(ahead)
    if residual is None:
        return None
    change = (residual - current.residual) / PROBE
    second = 2 / PROBE * (change - current.jacobian @ step)
    return np.asarray(current.jacobian.T @ (second if weights is None else second * weights))


def _with_second_order(information: Array, second_order: Array) -> Array:
    """The curvature with its second-order part, if it stays positive enough.

    Parameters
    ----------
    information
        Gauss-Newton curvature, (F, F).
    second_order
        Estimated second-order part, (F, F).

    Returns
    -------
    The sum, (F, F); ``information`` itself where less than a tenth of it would remain in any
    direction (chosen by judgement).
    """
    curvature = information + second_order
    try:
        np.linalg.cholesky(curvature - 0.1 * information)
    except np.linalg.LinAlgError:
        return information
    return curvature


def _updated_second_order(
    second_order: Array, before: _State, after: _State, weights: Array | None
) -> Array:
    """Update the estimate of sum_i residual_i (its second derivatives) after a step.

    Parameters
    ----------
    second_order
        Estimate before the step, (P, P).
    before, after
        States at the start and the end of the step.
    weights
        Robust weights, (N,); None for all one.

    Returns
    -------
    New estimate, (P, P).

    Notes
    -----
    Sized secant update of least change: Dennis, Gay and Welsch (1981), An adaptive nonlinear
    least-squares algorithm, ACM Trans. Math. Softw. 7, 348-368.
    ``tests/estimation/test_fitting.py`` shows that it saves steps.
    """
    step = after.theta - before.theta
    gradient_change = after.gradient - before.gradient
    along = float(gradient_change @ step)
    if along <= 0:
        return second_order
    weighted = after.residual if weights is None else after.residual * weights
    target = (after.jacobian - before.jacobian).T @ weighted
    predicted = abs(float(step @ second_order @ step))
    if predicted:
        second_order = second_order * min(1.0, abs(float(step @ target)) / predicted)
    missing = target - second_order @ step
    product = np.outer(missing, gradient_change)
    correction = float(missing @ step) / along * np.outer(gradient_change, gradient_change)
    return second_order + (product + product.T - correction) / along


def free_directions(fixed: Array) -> Array:
    """Orthonormal directions that leave every fixed combination unchanged.

    Parameters in no combination keep axes of their own, so that their scales stay separate.

    Parameters
    ----------
    fixed
        Combinations, (C, P).

    Returns
    -------
    Directions, (P, F), one a column.

    Examples
    --------
    >>> free_directions(np.array([[1.0, 1.0, 0.0]])).shape  # of three parameters, one sum is fixed
    (3, 2)
    """
    constrained = np.any(fixed != 0, axis=0)
    axes = np.eye(fixed.shape[1])[:, ~constrained]
    within = np.zeros((len(constrained), 0))
    if constrained.any():
        basis = null_space(fixed[:, constrained])
        within = np.zeros((len(constrained), basis.shape[1]))
        within[constrained] = basis
    return np.hstack([axes, within])


def _project_to_box(theta: Array, problem: Problem, rows: Array) -> Array | None:
    """Clip parameters to the box with fixed combinations unchanged; None if impossible.

    What a bound takes from a combination, its other parameters give back, in equal parts for equal
    weights.

    Parameters
    ----------
    theta
        Parameters, (P,).
    problem
        Has the bounds.
    rows
        Fixed combinations, (C, P).

    Returns
    -------
    Parameters in the box, (P,), with the same ``rows @ theta``.
    """
    value = rows @ theta
    size = np.abs(rows) @ np.abs(theta)
    free = np.any(rows != 0, axis=0)
    for _ in range(problem.size + 1):
        clipped = np.clip(theta, problem.lower, problem.upper)
        missing = value - rows @ clipped
        if np.all(np.abs(missing) <= 1e-12 * size):
            return np.asarray(clipped)
        free &= clipped == theta
        theta = clipped.copy()
        theta[free] += np.linalg.lstsq(rows[:, free], missing, rcond=None)[0]
    return None


def _evaluated_state(problem: Problem, theta: Array | None, weights: Array | None) -> _State | None:
    """Cost, half gradient and information at ``theta``; None where the model cannot be computed.

    Parameters
    ----------
    problem
        What is fitted.
    theta
        Parameters, (P,); None gives None.
    weights
        Robust weights, (N,); None for all one.
    """
    evaluated = None if theta is None else problem.evaluate(theta)
    if theta is None or evaluated is None:
        return None
    residual, jacobian = evaluated
    offset = theta - problem.prior_mean
    weighted = jacobian if weights is None else weights[:, None] * jacobian
    weighted_residual = residual if weights is None else weights * residual
    cost = float(residual @ weighted_residual + problem.precision @ offset**2)
    information = jacobian.T @ weighted + np.diag(problem.precision)
    if not np.isfinite(cost) or not np.isfinite(information).all():
        return None
    gradient = weighted.T @ residual + problem.precision * offset
    return _State(theta, residual, jacobian, cost, gradient, information)


def robust_weights(residual: Array, loss: str) -> Array:
    """Robust weights psi(r)/r, scaled by the median absolute deviation.

    Parameters
    ----------
    residual
        Residuals, (N,).
    loss
        ``huber`` or ``bisquare``.

    Returns
    -------
    Weights, (N,), from 0 to 1.

    Notes
    -----
    Huber: min(1, c/|z|); Tukey's bisquare: (1 - (z/c)^2)^2 inside c, zero outside; c from
    ``TUNING``.
    """
    z = _standardised_residuals(residual, loss)
    if loss == "huber":
        return np.asarray(np.minimum(1.0, 1.0 / np.maximum(z, 1e-300)))
    return np.asarray(np.where(z < 1, (1 - z**2) ** 2, 0.0))


def robust_covariance(residual: Array, jacobian: Array, loss: str) -> Array:
    """Huber's covariance of an M-estimate.

    Parameters
    ----------
    residual
        Residuals at the estimate, (N,).
    jacobian
        Their Jacobian, (N, P).
    loss
        ``huber`` or ``bisquare``.

    Returns
    -------
    Covariance, (P, P).

    Notes
    -----
    [sum psi^2/(n - p)] / mean(psi')^2 (J'J)^-1 (Huber 1981, eq. 7.6.5). psi must be that of
    ``robust_weights``.

    Examples
    --------
    >>> r = np.array([0.5, -0.4, 0.1, -0.2, 9.0])  # the outlier affects the plain covariance only
    >>> bool(robust_covariance(r, np.ones((5, 1)), "huber")[0, 0] < r.var() / 5)
    True
    """
    n, p = jacobian.shape
    z = _standardised_residuals(residual, loss)
    psi = robust_weights(residual, loss) * residual
    inside = z < 1
    slope = inside if loss == "huber" else np.where(inside, (1 - z**2) * (1 - 5 * z**2), 0.0)
    variance = float(psi @ psi) / (n - p) / float(np.mean(slope)) ** 2
    return np.asarray(variance * inverse(jacobian.T @ jacobian))


def _standardised_residuals(residual: Array, loss: str) -> Array:
    """|r| in units of the tuning constant times the scale from the median absolute deviation.

    Parameters
    ----------
    residual
        Residuals, (N,).
    loss
        ``huber`` or ``bisquare``.

    Returns
    -------
    Standardised residuals, (N,); below 1 inside the tuning constant.
    """
    scale = 1.4826 * float(np.median(np.abs(residual - np.median(residual)))) + 1e-300
    return np.asarray(np.abs(residual) / (TUNING[loss] * scale))
