"""Bounded Levenberg-Marquardt on the normal equations: few parameters, many samples, exact sensitivities."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from calibration.arrays import Array


class Status(StrEnum):
    """How a search ended."""

    CONVERGED = "converged: no step lowers the cost any more"
    AT_BOUND = "converged with a parameter on its bound: the data do not ask for it"
    STALLED = "stopped after the allowed iterations; look at the intervals before using it"


@dataclass(frozen=True)
class Optimum:
    """Where a search ended: parameters, residuals (N,), their Jacobian (N, P), cost = sum of squares."""

    x: Array
    residual: Array
    jacobian: Array
    cost: float
    status: Status
    iterations: int


Evaluate = Callable[[Array], tuple[Array, Array] | None]


def least_squares(
    evaluate: Evaluate,
    x0: Array,
    lower: Array,
    upper: Array,
    *,
    max_iterations: int = 60,
    tolerance: float = 1e-9,
) -> Optimum | None:
    """Minimise the sum of squares of ``evaluate(x)[0]``; ``evaluate(x)[1]`` is its Jacobian, None means "not
    here".

    Steps are damped in the scale of the Jacobian's columns and clipped to the box; a parameter on its bound that
    the gradient pushes outwards is left there. Returns None when the start itself cannot be evaluated.
    """
    x = np.clip(np.asarray(x0, dtype=float), lower, upper)
    current = evaluate(x)
    if current is None:
        return None
    r, j = current
    cost, damping, status = float(r @ r), 1e-3, Status.STALLED
    used = 0
    while used < max_iterations:
        used += 1
        gradient = j.T @ r
        held = ((x <= lower) & (gradient > 0)) | ((x >= upper) & (gradient < 0))
        open_ = np.flatnonzero(~held)
        if len(open_) == 0:
            status = Status.AT_BOUND
            break
        normal = j[:, open_].T @ j[:, open_]
        scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
        normal = normal / np.outer(scale, scale)
        g = gradient[open_] / scale
        better = False
        for _ in range(12):
            step = np.zeros_like(x)
            step[open_] = -np.linalg.solve(normal + damping * np.eye(len(open_)), g) / scale
            trial = np.clip(x + step, lower, upper)
            candidate = evaluate(trial)
            if candidate is not None and (new := float(candidate[0] @ candidate[0])) <= cost:
                better = True
                break
            damping = max(damping * 4.0, 1e-6)
        if not better:
            status = Status.AT_BOUND if held.any() else Status.CONVERGED
            break
        assert candidate is not None
        gain, moved = cost - new, float(np.max(np.abs((trial - x)[open_]) * scale)) / np.sqrt(cost + 1e-300)
        x, (r, j), cost = trial, candidate, new
        damping = max(damping / 8.0, 1e-12)
        if gain <= tolerance * (cost + 1e-300) and moved < 1e-4:
            status = Status.AT_BOUND if held.any() else Status.CONVERGED
            break
    return Optimum(x, r, j, cost, status, used)
