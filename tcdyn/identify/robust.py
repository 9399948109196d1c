"""Robust losses against spikes: Huber's and Tukey's, by reweighted least squares."""

from __future__ import annotations

from typing import Literal

import numpy as np

from calibration.arrays import Array
from tcdyn.identify.noise import inverse
from tcdyn.identify.optimise import Optimum
from tcdyn.identify.problem import Problem
from tcdyn.identify.search import search

Loss = Literal["linear", "huber", "bisquare"]
TUNING = {"huber": 1.345, "bisquare": 4.685}  # 95 % efficiency for normal noise


def weights_of(residual: Array, loss: Loss) -> Array:
    """psi(r)/r with the scale from the median absolute deviation."""
    if loss == "linear":
        return np.ones_like(residual)
    z = _standardised(residual, loss)
    if loss == "huber":
        return np.asarray(np.minimum(1.0, 1.0 / np.maximum(z, 1e-300)))
    return np.asarray(np.where(z < 1, (1 - z**2) ** 2, 0.0))


def _standardised(residual: Array, loss: Loss) -> Array:
    """|r| in units of the tuning constant times the scale from the median absolute deviation."""
    scale = 1.4826 * float(np.median(np.abs(residual - np.median(residual)))) + 1e-300
    return np.asarray(np.abs(residual) / (TUNING[loss] * scale))


def robust_covariance(residual: Array, jacobian: Array, loss: Loss) -> Array:
    """Huber's covariance of an M-estimate: [sum psi^2/(n - p)] / mean(psi')^2 (J'J)^-1 (Huber 1981, eq. 7.6.5)."""
    n, p = jacobian.shape
    z = _standardised(residual, loss)
    psi = weights_of(residual, loss) * residual
    inside = z < 1
    slope = inside if loss == "huber" else np.where(inside, (1 - z**2) * (1 - 5 * z**2), 0.0)
    return np.asarray(float(psi @ psi) / (n - p) / float(np.mean(slope)) ** 2 * inverse(jacobian)[0])


def reweight(problem: Problem, optimum: Optimum, loss: Loss) -> tuple[Optimum, Array]:
    """The robust optimum and its final weights (N,); bisquare starts from Huber's answer."""
    weights = np.ones(problem.n_seen)
    for kind in ("huber", "bisquare") if loss == "bisquare" else ("huber",):
        for _ in range(25):
            found = problem.evaluate(optimum.x)
            assert found is not None
            weights = weights_of(found[0], kind)
            root = np.sqrt(weights)

            def evaluate(x: Array, root: Array = root) -> tuple[Array, Array] | None:
                answer = problem.evaluate(x)
                return None if answer is None else (answer[0] * root, answer[1] * root[:, None])

            before = optimum.x
            optimum = search(problem, evaluate, start=before)
            if np.max(np.abs(optimum.x - before) / (np.abs(before) + 1e-6)) < 1e-6:
                break
    return optimum, weights
