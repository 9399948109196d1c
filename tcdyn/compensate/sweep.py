"""The states of a stretch on its cells: filtered, smoothed, and the likelihood, all channels together."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration import Array
from tcdyn.compensate.cells import FINE, Cells, Intensity, cells_for
from tcdyn.compensate.stretch import Stretch


def filtered(cells: Cells) -> Iterator[tuple[Array, ...]]:
    """The information-form Kalman filter, cell by cell: P+ = (I + P L)^-1 P, m+ = m + P+ (s - L m).

    Yields, for all channels and proposals (M, Q): mean before the cell's samples, its step, covariance after them,
    I + P L and its inverse, and the surprise s - L m.
    """
    mean, cov = cells.mean0[..., None].copy(), cells.cov0.copy()
    eye = np.eye(mean.shape[-2])
    for j, kind in enumerate(cells.kind):
        cov[..., 1, 1] += cells.slope_var[j]
        info = cells.information[j]
        gain = cov @ info + eye
        surprise = cells.score[j][..., None] - info @ mean
        shrink = np.linalg.inv(gain)
        cov = shrink @ cov
        step = cov @ surprise
        yield mean, step, cov, gain, shrink, surprise
        across = cells.transition[kind]
        mean, cov = across @ (mean + step), across @ cov @ across.swapaxes(-1, -2)


def likelihood(
    stretch: Stretch, noise_var: Array, proposals: Sequence[Sequence[Intensity]], fine: float = FINE
) -> tuple[Array, Array]:
    """Log likelihood (M, Q) at the given noise, and the ratio (M, Q) by which each would scale the noise variance."""
    cells = cells_for(stretch, noise_var, proposals, fine)
    log_det, quad = np.zeros(cells.mean0.shape[:2]), np.zeros(cells.mean0.shape[:2])
    for (mean, step, _, gain, _, surprise), score in zip(filtered(cells), cells.score):
        log_det += np.log(np.maximum(np.linalg.det(gain), 1e-300))
        quad -= ((score[..., None] + surprise) * mean + surprise * step).sum(axis=(-2, -1))
    used = (stretch.weight > 0).sum(axis=0)
    total = quad + ((stretch.weight * stretch.y**2).sum(axis=0) / noise_var)[:, None]
    value = -0.5 * (log_det + total + (used * np.log(noise_var))[:, None])
    return value, total / np.maximum(used - 2 - len(stretch.events_s), 1)[:, None]


@dataclass(frozen=True)
class Smoothed:
    """A stretch, its noise variance (M,), intensities, and states at the knots of its ``cells`` given all of it.

    ``mean (J, M, n)`` and ``cov (J, M, n, n)`` of these states; ``past (J, M, n, n)``: covariance given the samples
    up to the end of each cell only; ``jump_z (J, M)``: score test for a slope jump at each knot, standard normal when
    there is none. At the samples: ``cell (N,)`` of each, one on a knot belonging to the cell after it; (N, M):
    ``temperature`` [degC], its ``slope`` [K/s], ``sd`` [K] and ``lag_sensitivity`` [K/s]; ``read``, ``read_var``:
    what the logger would have written without noise [degC], and its variance [K2].
    """

    stretch: Stretch
    noise_var: Array
    chosen: tuple[Intensity, ...]
    cells: Cells
    mean: Array
    cov: Array
    past: Array
    jump_z: Array
    cell: NDArray[np.intp]
    temperature: Array
    slope: Array
    sd: Array
    lag_sensitivity: Array
    read: Array
    read_var: Array


def smoothed(stretch: Stretch, noise_var: Array, chosen: Sequence[Intensity]) -> Smoothed:
    """States given the whole stretch, its noise variance (M,) and one intensity a channel.

    Bryson-Frazier form: no inverse, and the test for slope jumps comes with it.
    """
    cells = cells_for(stretch, noise_var, [[q] for q in chosen])
    steps = [
        ((mean + step)[:, 0, :, 0], cov[:, 0], shrink[:, 0], surprise[:, 0])
        for mean, step, cov, _, shrink, surprise in filtered(cells)
    ]
    mean, past, shrinks, surprises = (np.stack(kept) for kept in zip(*steps))
    count, batch, n = mean.shape
    pull, weight = np.zeros((batch, n, 1)), np.zeros((batch, n, n))
    cov, z = np.empty_like(past), np.zeros((count, batch))
    for j in range(count - 1, -1, -1):
        if j < count - 1:
            across = cells.transition[cells.kind[j], :, 0]
            back = across.transpose(0, 2, 1)
            pull, weight = back @ pull, back @ weight @ across
        p, shrink = past[j], shrinks[j]
        mean[j] += (p @ pull)[..., 0]
        cov[j] = p - p @ weight @ p
        back = shrink.transpose(0, 2, 1)
        pull = back @ (surprises[j] + pull)
        weight = back @ weight @ shrink + cells.information[j, :, 0] @ shrink
        z[j] = pull[:, 1, 0] / np.sqrt(np.maximum(weight[:, 1, 1], 1e-300))
    read, read_var = np.zeros((2, len(stretch.y) + 1, batch))
    for c, kinds in enumerate(cells.rows):
        for where, rows, sample in kinds:
            read[sample, c] = mean[where, c] @ rows.T
            read_var[sample, c] = np.einsum("ri,jik,rk->jr", rows, cov[where, c], rows, optimize=True)
    t, knots = np.arange(len(stretch.y)) * stretch.dt_s, cells.knots_s
    cell = np.clip(np.searchsorted(knots, t + 1e-6 * stretch.dt_s, side="right") - 1, 0, count - 1)
    along = (t - knots[cell])[:, None]
    slope = mean[cell, :, 1]
    var = cov[cell, :, 0, 0] + 2 * along * cov[cell, :, 0, 1] + along**2 * cov[cell, :, 1, 1]
    at_knot = np.einsum("jmn,mn->jm", mean, np.stack([s.lag_row for s in stretch.sensors]))
    following = np.concatenate([at_knot[1:], at_knot[-1:]])
    part = np.clip(along / np.diff(knots)[cell][:, None], 0, 1)
    return Smoothed(
        stretch, noise_var, tuple(chosen), cells, mean, cov, past, z, cell, mean[cell, :, 0] + along * slope, slope,
        np.sqrt(np.maximum(var, 0.0)), (1 - part) * at_knot[cell] + part * following[cell], read[:-1], read_var[:-1],
    )  # fmt: skip
