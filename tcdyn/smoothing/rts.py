"""The two sweeps of the smoother over cells: exact where anything changes, of constant gain where nothing does.

Between events and gaps the covariance settles within some correlation times; from there on the filter and its way
back are linear recursions of one matrix, for all channels and cells at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tcdyn.core import Array

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

    S = (I + P L)^-1, P+ = S P, e = s - L m, m+ = m + P+ e, next m = A m+ = F m + A P+ s with F = A S; back,
    q = S' e + F' q of the next cell and W = L S + F' W F of the next, its variance: m + P+ (e + A' q) and
    P+ - P+ A' W A P+, of the next, are those given all samples.
    """
    past, shrink, base = _filtered(cells)
    info = cells.information[:, :, 0]
    score = cells.score[:, :, 0]
    across = cells.transition[:, :, 0]
    own, of = np.unique(base, return_inverse=True)  # what has one gain has one of each of these
    step, gain = (across[cells.kind[own]] @ x[own] for x in (shrink, past))
    mean = _means(cells.mean0[:, 0], across[cells.kind], step, gain, info, score, of)
    surprise = score - _times(info, mean)
    pull, weight, held = _back(
        step, _times(shrink.swapaxes(-1, -2), surprise), info[own] @ shrink[own], of
    )
    mean += _times(past, surprise + _times(across[cells.kind].swapaxes(-1, -2), pull[1:]))
    alike = np.flatnonzero(
        np.diff(of, prepend=-1) | np.diff(held[1:], prepend=-1)
    )  # the first of some of one cov
    left = gain[of[alike]].swapaxes(-1, -2)
    cov = past[alike] - left @ weight[1:][alike] @ left.swapaxes(-1, -2)
    cov = np.repeat(cov, np.diff(alike, append=len(of)), axis=0)
    return Swept(mean, cov, past, pull[:-1, :, :2], weight[:-1, :, :2, :2])


def _filtered(cells: Cells) -> tuple[Array, Array, NDArray[np.intp]]:
    """P+ and S (J, M, n, n) after each cell's samples, and the first cell (J,) that has its gain."""
    count = len(cells.kind)
    (batch, _, n) = cells.mean0.shape
    past, shrink = np.empty((2, count, batch, n, n))
    base = np.arange(count)
    ends = _ends(cells)
    cov = cells.cov0[:, 0].copy()
    eye = np.eye(n)
    back = cells.transition[:, :, 0].swapaxes(-1, -2)
    j = 0
    while j < count:
        kind = cells.kind[j]
        cov[:, 0, 0] += cells.jump_var[j, :, 0, 0]
        cov[:, 1, 1] += cells.jump_var[j, :, 0, 1]
        shrink[j] = np.linalg.inv(cov @ cells.information[j, :, 0] + eye)
        past[j] = shrink[j] @ cov
        last = int(ends[j])
        if j and last - j >= LEAST and ends[j - 1] == last and _close(past[j], past[j - 1]):
            rows = slice(j, last + 1)
            past[rows], shrink[rows], base[rows] = past[j], shrink[j], j
            j = last
        cov = cells.transition[kind, :, 0] @ past[j] @ back[kind]
        j += 1
    return past, shrink, base


def _means(
    start: Array,
    across: Array,
    step: Array,
    gain: Array,
    info: Array,
    score: Array,
    of: NDArray[np.intp],
) -> Array:
    """m (J, M, n) before each cell's samples: the next is A m + gain (s - L m), or step m + gain s within one gain.

    Not so elsewhere: where little is known yet, that is a difference of large numbers. ``of`` (J,): which of the gains
    and steps a cell has.
    """
    mean = np.empty_like(score)
    j = 0
    mean[0] = start
    for last in [
        *np.flatnonzero(np.diff(of)).tolist(),
        len(of) - 1,
    ]:  # of the cells from j on that have one gain
        k = of[last]
        if last > j:
            mean[j : last + 1] = recursion(
                step[k], np.concatenate([mean[j][None], _times(gain[k], score[j:last])])
            )
        if (j := last + 1) < len(mean):
            surprise = score[last] - _times(info[last], mean[last])
            mean[j] = _times(across[last], mean[last]) + _times(gain[k], surprise)
    return mean


def _back(
    step: Array, driven: Array, added: Array, of: NDArray[np.intp]
) -> tuple[Array, Array, NDArray[np.intp]]:
    """q (J + 1, M, n) and W (J + 1, M, n, n), zero behind the last cell: step' q + driven, step' W step + added.

    Last, the cell (J + 1,) whose W each has. ``of`` (J,): which of the steps and of what is added a cell has.
    """
    count = len(of)
    (batch, n) = driven.shape[1:]
    pull = np.zeros((count + 1, batch, n))
    weight = np.zeros((count + 1, batch, n, n))
    back = step.swapaxes(-1, -2)
    held = np.arange(count + 1)
    j = count - 1
    begins = np.searchsorted(of, np.arange(len(step)))
    while j >= 0:
        k = of[j]
        weight[j], a = back[k] @ weight[j + 1] @ step[k] + added[k], int(begins[k])
        if (
            j - a >= LEAST and j < count - 1 and _close(weight[j], weight[j + 1])
        ):  # one gain down to cell a
            weight[a:j] = weight[j]
            held[a:j] = j
            pull[a : j + 1] = recursion(
                back[k], np.concatenate([pull[j + 1][None], driven[a : j + 1][::-1]])
            )[:0:-1]
            j = a
        else:
            pull[j] = _times(back[k], pull[j + 1]) + driven[j]
        j -= 1
    return pull, weight, held


def _ends(cells: Cells) -> NDArray[np.intp]:
    """The last cell (J,) of the run of cells alike that each one is in."""
    count = len(cells.kind)
    told = np.concatenate(
        [cells.information[:, :, 0].reshape(count, -1), cells.jump_var[:, :, 0].reshape(count, -1)],
        axis=1,
    )
    size = np.maximum(np.abs(told), 1e-300)
    changes = np.ones(count, dtype=bool)
    changes[1:] = (cells.kind[1:] != cells.kind[:-1]) | (
        np.abs(np.diff(told, axis=0)) > ALIKE * size[1:]
    ).any(axis=1)
    ends = np.arange(count)
    for a, b in pairwise([*np.flatnonzero(changes).tolist(), count]):
        while b - a > 1:  # what drifts slowly: no further than from the first of the run
            away = (np.abs(told[a:b] - told[a]) > ALIKE * size[a]).any(axis=1)
            stop = a + int(np.argmax(away)) if away.any() else b
            ends[a:stop] = stop - 1
            a = stop
    return ends


def recursion(phi: Array, driven: Array) -> Array:
    """x_j = phi x_{j-1} + driven_j (L, M, n) for phi (M, n, n), x_{-1} = 0: by doubling, as long as phi^k is there.

    >>> recursion(np.array([[[0.5]]]), np.ones((4, 1, 1))).ravel().tolist()
    [1.0, 1.5, 1.75, 1.875]
    """
    x = np.ascontiguousarray(driven.swapaxes(0, 1))
    step = 1
    while step < x.shape[1] and np.abs(phi).max() > 1e-18:
        x[:, step:] += x[:, :-step] @ phi.swapaxes(-1, -2)
        phi = phi @ phi
        step = 2 * step
    return np.asarray(x.swapaxes(0, 1))


def _times(matrix: Array, vectors: Array) -> Array:
    """Matrices (..., M, n, n) times vectors (..., M, n)."""
    return np.asarray((matrix @ vectors[..., None])[..., 0])


def _close(a: Array, b: Array) -> bool:
    """Whether two covariances (M, n, n) differ by a small part of their own deviations only."""
    size = np.sqrt(np.abs(np.diagonal(a, axis1=-2, axis2=-1)))
    return bool(np.all(np.abs(a - b) <= SETTLED * size[..., :, None] * size[..., None, :]))
