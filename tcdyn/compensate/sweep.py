"""Forward filter and backward smoother over a grid of cells, all channels (or candidates) at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Problem:
    """A linear Gaussian model on J cells for M channels times Q proposals, with n states.

    ``mean0 (M, Q, n)``, ``cov0 (M, Q, n, n)``: prior at the first knot. ``transition (K, M, 1, n, n)`` and
    ``kind (J,)``: how the state crosses cell j. ``information (J, M, 1, n, n)``, ``score (J, M, 1, n)``: sum over the
    samples of cell j of w o o' and w o y, o the row that reads the sample from the state at the knot.
    ``slope_var (J, M, Q)``: variance added to the slope at knot j [K2/s2].
    """

    mean0: Array
    cov0: Array
    transition: Array
    kind: NDArray[np.intp]
    information: Array
    score: Array
    slope_var: Array


@dataclass(frozen=True)
class Filtered:
    """Per cell: state at its knot given all samples up to the end of the cell, and what the smoother needs."""

    mean: Array
    cov: Array
    shrink: Array
    surprise: Array


@dataclass(frozen=True)
class Smoothed:
    """States at the knots given the whole record, mean (J, M, n) and covariance (J, M, n, n).

    ``jump_z (J, M)``: score test for a slope jump at each knot, standard normal when there is none.
    """

    mean: Array
    cov: Array
    jump_z: Array


def log_likelihood_terms(problem: Problem) -> tuple[Array, Array]:
    """Sum of log det(I + P L), and minus the squares explained, each (M, Q).

    -2 log likelihood is their sum, plus n log 2 pi, the log noise variances and the sum of w y2.
    """
    mean, cov = problem.mean0[..., None].copy(), problem.cov0.copy()
    quad = np.zeros(mean.shape[:2])
    dets = np.empty((len(problem.kind), *mean.shape[:2]))
    eye = np.eye(mean.shape[-2])
    for j, kind in enumerate(problem.kind):
        cov[..., 1, 1] += problem.slope_var[j]
        info, score = problem.information[j], problem.score[j][..., None]
        gain = cov @ info + eye
        dets[j] = np.linalg.det(gain)
        surprise = score - info @ mean
        cov = np.linalg.inv(gain) @ cov
        step = cov @ surprise
        quad -= ((score + surprise) * mean + surprise * step).sum(axis=(-2, -1))
        across = problem.transition[kind]
        mean = across @ (mean + step)
        cov = across @ cov @ across.swapaxes(-1, -2)
    return np.log(np.maximum(dets, 1e-300)).sum(axis=0), quad


def forward(problem: Problem) -> Filtered:
    """The information-form Kalman filter of the first proposal: P+ = (I + P L)^-1 P, m+ = m + P+ (s - L m)."""
    mean, cov = problem.mean0[:, 0, :, None].copy(), problem.cov0[:, 0].copy()
    cells, (batch, n) = len(problem.kind), mean.shape[:2]
    means, covs, shrinks = np.empty((cells, batch, n)), np.empty((cells, batch, n, n)), np.empty((cells, batch, n, n))
    surprises = np.empty((cells, batch, n))
    eye = np.eye(n)
    for j, kind in enumerate(problem.kind):
        cov[:, 1, 1] += problem.slope_var[j, :, 0]
        info = problem.information[j, :, 0]
        shrink = np.linalg.inv(cov @ info + eye)
        surprise = problem.score[j, :, 0, :, None] - info @ mean
        cov = shrink @ cov
        mean = mean + cov @ surprise
        means[j], covs[j], shrinks[j], surprises[j] = mean[..., 0], cov, shrink, surprise[..., 0]
        across = problem.transition[kind, :, 0]
        mean = across @ mean
        cov = across @ cov @ across.transpose(0, 2, 1)
    return Filtered(means, covs, shrinks, surprises)


def backward(problem: Problem, done: Filtered) -> Smoothed:
    """The smoother in Bryson-Frazier form: no inverse, and the test for slope jumps comes with it."""
    cells, batch, n = done.mean.shape
    pull, weight = np.zeros((batch, n, 1)), np.zeros((batch, n, n))
    mean, cov, z = np.empty_like(done.mean), np.empty_like(done.cov), np.zeros((cells, batch))
    for j in range(cells - 1, -1, -1):
        if j < cells - 1:
            across = problem.transition[problem.kind[j], :, 0]
            back = across.transpose(0, 2, 1)
            pull, weight = back @ pull, back @ weight @ across
        p = done.cov[j]
        mean[j] = done.mean[j] + (p @ pull)[..., 0]
        cov[j] = p - p @ weight @ p
        shrink = done.shrink[j]
        back = shrink.transpose(0, 2, 1)
        pull = back @ (done.surprise[j][..., None] + pull)
        weight = back @ weight @ shrink + problem.information[j, :, 0] @ shrink
        z[j] = pull[:, 1, 0] / np.sqrt(np.maximum(weight[:, 1, 1], 1e-300))
    return Smoothed(mean, cov, z)
