"""Forward filter and backward smoother over a grid of cells, all channels (or candidates) at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Problem:
    """A linear Gaussian model on J cells for B independent problems with n states.

    ``mean0 (B, n)``, ``cov0 (B, n, n)``: prior at the first knot. ``transition (K, B, n, n)``, ``kind (J,)``: how the
    state crosses cell j. ``information (J, B, n, n)``, ``score (J, B, n)``: sum over the samples of cell j of
    w o o' and w o y, o the row that reads the sample from the state at the knot. ``slope_var (J, B)``: variance
    added to the slope at knot j [K2/s2].
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
    log_det: Array
    quad: Array


def forward(problem: Problem, keep: bool = True) -> Filtered:
    """The information-form Kalman filter; ``keep=False`` keeps only the likelihood terms (B,).

    P+ = (I + P L)^-1 P, m+ = (I + P L)^-1 (m + P s); minus twice the log likelihood is log_det + quad, apart from
    terms of the data alone (n log 2 pi, sum of log noise variance and sum of w y2).
    """
    cells, batch, n = problem.score.shape
    mean, cov = problem.mean0[..., None].copy(), problem.cov0.copy()
    log_det, quad = np.zeros(batch), np.zeros(batch)
    store = cells if keep else 0
    means, covs, shrinks = (
        np.empty((store, batch, n)),
        np.empty((store, batch, n, n)),
        np.empty((store, batch, n, n)),
    )
    surprises = np.empty((store, batch, n))
    eye = np.eye(n)
    dets = np.empty((cells, batch)) if not keep else np.empty((0, batch))
    for j in range(cells):
        cov[:, 1, 1] += problem.slope_var[j]
        info, score = problem.information[j], problem.score[j][..., None]
        gain = cov @ info
        gain += eye
        shrink = np.linalg.inv(gain)
        surprise = score - info @ mean
        cov = shrink @ cov
        step = cov @ surprise
        if keep:
            mean = mean + step
            means[j], covs[j], shrinks[j], surprises[j] = mean[..., 0], cov, shrink, surprise[..., 0]
        else:
            quad -= ((score + surprise) * mean + surprise * step).sum(axis=(1, 2))
            dets[j] = np.linalg.det(gain)
            mean = mean + step
        across = problem.transition[problem.kind[j]]
        mean = across @ mean
        cov = across @ cov @ across.transpose(0, 2, 1)
    if not keep:
        log_det = np.log(np.maximum(dets, 1e-300)).sum(axis=0)
    return Filtered(means, covs, shrinks, surprises, log_det, quad)


def backward(problem: Problem, done: Filtered) -> tuple[Array, Array]:
    """Smoothed mean (J, B, n) and covariance (J, B, n, n) at the knots (Bryson-Frazier form, no inverse)."""
    cells, batch, n = done.mean.shape
    pull, weight = np.zeros((batch, n, 1)), np.zeros((batch, n, n))
    mean, cov = np.empty_like(done.mean), np.empty_like(done.cov)
    for j in range(cells - 1, -1, -1):
        if j < cells - 1:
            across = problem.transition[problem.kind[j]]
            back = across.transpose(0, 2, 1)
            pull, weight = back @ pull, back @ weight @ across
        p = done.cov[j]
        mean[j] = done.mean[j] + (p @ pull)[..., 0]
        cov[j] = p - p @ weight @ p
        shrink = done.shrink[j]
        back = shrink.transpose(0, 2, 1)
        pull = back @ (done.surprise[j][..., None] + pull)
        weight = back @ weight @ shrink + problem.information[j] @ shrink
    return mean, cov
