"""The two sweeps of the smoother over cells: exact where anything changes, of constant gain where nothing does.

Between events and gaps the covariance settles within some correlation times; from there on the filter and its way
back are linear recursions of one matrix, for all channels and cells at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration import Array

SETTLED = 1e-10  # change of a covariance from one cell to the next, of its own, below which it is taken as constant
ALIKE = 1e-6  # relative difference of information or intensity that changes no temperature by a millionth of its sd
LEAST = 16  # cells alike: fewer are not worth a recursion


@dataclass(frozen=True)
class Cells:
    """A linear Gaussian model on J cells of time for M channels times Q proposed intensities, with n states.

    Cell j lies between ``knots_s[j]`` and the next; ``kind (J,)``: which of K kinds it is, by its length and by where
    samples lie in it. ``mean0 (M, Q, n)``, ``cov0 (M, Q, n, n)``: prior at the first knot. ``transition (K, M, 1, n,
    n)``: how the state crosses a cell. ``information (J, M, 1, n, n)``, ``score (J, M, 1, n)``: sum over the samples
    of cell j of w o o' and w o y, o the row that reads the sample from the state at the knot. ``jump_var (J, M, Q,
    2)``: variance added to level [K2] and slope [K2/s2] at knot j. ``rows``: for each channel and kind that reads
    samples, its cells (c,), those rows (count, n), and which samples they are (c, count), N where the record has none.
    """

    knots_s: Array
    kind: NDArray[np.intp]
    mean0: Array
    cov0: Array
    transition: Array
    information: Array
    score: Array
    jump_var: Array
    rows: tuple[tuple[tuple[NDArray[np.intp], Array, NDArray[np.intp]], ...], ...]


@dataclass(frozen=True)
class Swept:
    """At the J cells, for M channels of n states: ``mean (J, M, n)`` and ``cov (J, M, n, n)`` given all samples,

    ``past (J, M, n, n)`` given those up to the end of the cell; ``pull (J, M, 2)``, ``weight (J, M, 2, 2)``: score of
    level and slope at the knot, and its variance.
    """

    mean: Array
    cov: Array
    past: Array
    pull: Array
    weight: Array


def swept(cells: Cells) -> Swept:
    """Filter forward, then back by Bryson and Frazier; the first proposal of each channel.

    S = (I + P L)^-1, P+ = S P, e = s - L m, m+ = m + P+ e; back, r = A' q of the next cell, q = S' (e + r),
    m+ + P+ r and P+ - P+ A' W A P+ are those given all samples, W = S' A' W A S + L S the variance of q.
    """
    mean, past, shrink, surprise, base = _forward(cells)
    count, batch, n = mean.shape
    pull, weight = np.zeros((batch, n)), np.zeros((batch, n, n))
    cov, pulls, weights = np.empty_like(past), np.zeros((count, batch, 2)), np.zeros((count, batch, 2, 2))
    before = np.full((batch, n, n), np.inf)
    j = count - 1
    while j >= 0:
        across, p, gone = cells.transition[cells.kind[j], :, 0], past[j], shrink[j].swapaxes(-1, -2)
        back, a = across.swapaxes(-1, -2), int(base[j])
        if j < count - 1:
            pull, weight = _times(back, pull), back @ weight @ across
        if j - a >= LEAST and _close(weight, before):  # cells a to j have one gain, and so has the way back
            phi = back @ gone
            driven = np.concatenate([pull[None], _times(phi, surprise[a + 1 : j + 1])[::-1]])
            r = recursion(phi, driven)[::-1]
            rows = slice(a, j + 1)
        else:
            r, rows = pull[None], slice(j, j + 1)
        mean[rows] += _times(p, r)
        cov[rows] = p - p @ weight @ p
        q = _times(gone, surprise[rows] + r)
        before, weight = weight, gone @ weight @ shrink[j] + cells.information[j, :, 0] @ shrink[j]
        pulls[rows], weights[rows] = q[..., :2], weight[:, :2, :2]
        pull, j = q[0], rows.start - 1
    return Swept(mean, cov, past, pulls, weights)


def _forward(cells: Cells) -> tuple[Array, Array, Array, Array, NDArray[np.intp]]:
    """Mean (J, M, n) and covariance after each cell's samples, S, e, and the first cell (J,) that has its gain."""
    count, (batch, _, n) = len(cells.kind), cells.mean0.shape
    mean, surprise = np.empty((2, count, batch, n))
    past, shrink = np.empty((2, count, batch, n, n))
    base, ends = np.arange(count), _ends(cells)
    m, cov, eye = cells.mean0[:, 0].copy(), cells.cov0[:, 0].copy(), np.eye(n)
    j = 0
    while j < count:
        info, across = cells.information[j, :, 0], cells.transition[cells.kind[j], :, 0]
        cov[..., 0, 0] += cells.jump_var[j, :, 0, 0]
        cov[..., 1, 1] += cells.jump_var[j, :, 0, 1]
        shrink[j] = np.linalg.inv(cov @ info + eye)
        past[j] = shrink[j] @ cov
        last = int(ends[j])
        if j and last - j >= LEAST and ends[j - 1] == last and _close(past[j], past[j - 1]):
            rows = slice(j, last + 1)
            past[rows], shrink[rows], base[rows] = past[j], shrink[j], j
            driven = _times(across @ past[j], cells.score[j:last, :, 0])
            v = recursion(across @ shrink[j], np.concatenate([m[None], driven]))
        else:
            v, rows = m[None], slice(j, j + 1)
        surprise[rows] = cells.score[rows, :, 0] - _times(info, v)
        mean[rows] = v + _times(past[j], surprise[rows])
        j = rows.stop
        m, cov = _times(across, mean[j - 1]), across @ past[j - 1] @ across.swapaxes(-1, -2)
    return mean, past, shrink, surprise, base


def _ends(cells: Cells) -> NDArray[np.intp]:
    """The last cell (J,) of the run of cells alike that each one is in."""
    count = len(cells.kind)
    told = np.concatenate(
        [cells.information[:, :, 0].reshape(count, -1), cells.jump_var[:, :, 0].reshape(count, -1)], axis=1
    )
    size = np.maximum(np.abs(told), 1e-300)
    changes = np.ones(count, dtype=bool)
    changes[1:] = (cells.kind[1:] != cells.kind[:-1]) | (np.abs(np.diff(told, axis=0)) > ALIKE * size[1:]).any(axis=1)
    starts = [0]
    while starts[-1] < count:  # what drifts slowly: no further than from the first of the run
        a = starts[-1]
        b = int(np.argmax(np.r_[changes[a + 1 :], True])) + a + 1
        away = (np.abs(told[a:b] - told[a]) > ALIKE * size[a]).any(axis=1)
        starts.append(a + int(np.argmax(away)) if away.any() else b)
    return np.repeat(np.array(starts[1:]) - 1, np.diff(starts))


def recursion(phi: Array, driven: Array) -> Array:
    """x_j = phi x_{j-1} + driven_j (L, M, n) for phi (M, n, n), x_{-1} = 0: by doubling, as long as phi^k is there.

    >>> recursion(np.array([[[0.5]]]), np.ones((4, 1, 1))).ravel().tolist()
    [1.0, 1.5, 1.75, 1.875]
    """
    x, step = np.ascontiguousarray(driven.swapaxes(0, 1)), 1
    while step < x.shape[1] and np.abs(phi).max() > 1e-18:
        x[:, step:] += x[:, :-step] @ phi.swapaxes(-1, -2)
        phi, step = phi @ phi, 2 * step
    return np.asarray(x.swapaxes(0, 1))


def _times(matrix: Array, vectors: Array) -> Array:
    """matrix (M, n, n) times each of vectors (..., M, n)."""
    return np.asarray(np.einsum("mij,...mj->...mi", matrix, vectors))


def _close(a: Array, b: Array) -> bool:
    """Whether two covariances (M, n, n) differ by a small part of their own deviations only."""
    size = np.sqrt(np.abs(np.diagonal(a, axis1=-2, axis2=-1)))
    return bool(np.all(np.abs(a - b) <= SETTLED * size[..., :, None] * size[..., None, :]))
