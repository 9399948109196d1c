"""The samples of rows whose time stamps all differ.

:func:`tcdyn.series.clock.fit_clock` uses it and describes the method.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import isotonic_regression

from tcdyn.core import Array
from tcdyn.series.descriptions import (
    PIECE_ROWS,
    SAME_INTERVAL,
    SEARCH_QUANTILES,
    SEARCH_ROWS,
    SEARCH_SPANS,
    line,
    piece_edges,
    smallest_scatter_s,
    step_code_length,
)

# Prior probability that a row is lost. It decides about the first and the last rows of a log only,
# where nothing beyond them tells a lost row from a stamp that strays.
LOST_PROBABILITY = 1e-3
# Samples for each row beyond which an interval is not refined: the search would take too long.
SPARSEST_ROWS = 20
# Passes of the mean step over the samples that it gives: the first value is forgotten after two.
STEP_PASSES = 3
# Scatter of the steps, in intervals, up to which each tells its number of samples: half an interval
# is then two standard deviations.
MAX_STEP_SCATTER = 0.25


@dataclass(frozen=True)
class FineClock:
    """Samples of rows whose stamps all differ.

    Attributes
    ----------
    samples
        Sample of each row (N,), 0 for the first.
    length
        Length of the description [natural units of information].
    is_wandering
        Whether the steps from row to row scatter, not the stamps about a grid.
    """

    samples: NDArray[np.intp]
    length: float
    is_wandering: bool


def fit_fine(t: Array, interval_s: float | None, resolution_s: float) -> FineClock:
    """Samples of rows whose stamps all differ.

    Parameters
    ----------
    t
        Stamps (N,) [s], which rise.
    interval_s
        Interval where it is known [s].
    resolution_s
        Step of the clock [s].

    Returns
    -------
    FineClock
        The shorter description: deviations from a grid, or steps from row to row that scatter.
    """
    grid_s = interval_s or _grid_interval_s(t, resolution_s)
    samples = _place(t, grid_s)
    length = _fine_code_length(t, samples, grid_s, resolution_s)
    if length <= step_code_length(samples):
        return FineClock(samples, length, False)  # rounding explains all deviations
    best = FineClock(samples, length, False)
    step_s = interval_s or _step_interval_s(t, resolution_s)
    for counted in (_place_by_steps(t, step_s), np.arange(len(t))):
        wandering_length = _wandering_code_length(t, counted, resolution_s)
        if wandering_length < best.length:
            best = FineClock(counted, wandering_length, True)
    return best


def _grid_interval_s(t: Array, resolution_s: float) -> float:
    """Interval of the grid about which the stamps (N,) scatter [s]."""
    first = t[:SEARCH_ROWS]
    lengths = {}
    candidates = _first_intervals_s(first)
    usual_s = float(np.median(np.diff(first))) if len(first) > 1 else resolution_s
    if resolution_s > usual_s / SPARSEST_ROWS:
        candidates.append(resolution_s)
    for candidate_s in candidates:
        dt = _most_coherent_interval_s(first, candidate_s)
        dt, _ = line(_place(first, dt), first)
        lengths[dt] = _fine_code_length(first, _place(first, dt), dt, resolution_s)
    interval_s = min(lengths, key=lambda dt: lengths[dt])
    size = SEARCH_ROWS
    while size < len(t):
        # an interval from n rows places 4 n rows to a fraction of an interval
        size = min(4 * size, len(t))
        interval_s, _ = line(_place(t[:size], interval_s), t[:size])
    return interval_s


def _step_interval_s(t: Array, resolution_s: float) -> float:
    """Interval of stamps (N,) whose steps scatter: their sum over the number of samples [s]."""
    lengths = {}
    for candidate_s in _first_intervals_s(t[:SEARCH_ROWS]):
        dt = candidate_s
        for _ in range(STEP_PASSES):
            dt = float(t[-1] - t[0]) / float(_place_by_steps(t, dt)[-1])
        lengths[dt] = _wandering_code_length(t, _place_by_steps(t, dt), resolution_s)
    return min(lengths, key=lambda dt: lengths[dt])


def _place_by_steps(t: Array, interval_s: float) -> NDArray[np.intp]:
    """Sample of each row of stamps (N,), each as many after the one before as its step tells."""
    steps = np.maximum(np.rint(np.diff(t) / interval_s), 1)
    return np.concatenate([[0], np.cumsum(steps)]).astype(np.intp)


def _wandering_code_length(t: Array, samples: NDArray[np.intp], resolution_s: float) -> float:
    """Length of a description of stamps whose steps scatter [natural units of information].

    As :func:`_fine_code_length`, with the scatter of the steps about whole numbers of intervals:
    deviations then add up from row to row, as for a loop that waits and then reads. Infinite where
    rows are lost and the steps scatter too much to tell their number of samples.
    """
    if len(t) < 2:
        return np.inf
    counts = np.diff(samples)
    interval_s = float(t[-1] - t[0]) / float(samples[-1])
    error_s = np.diff(t) - interval_s * counts
    scatter_s = float(np.sqrt(np.mean(error_s**2)))
    if np.any(counts > 1) and scatter_s > MAX_STEP_SCATTER * interval_s:
        return np.inf
    relative = scatter_s / smallest_scatter_s(resolution_s)
    return len(t) * float(np.log(max(relative, 1.0))) + step_code_length(samples)


def _fine_code_length(
    t: Array, samples: NDArray[np.intp], interval_s: float, resolution_s: float
) -> float:
    """Length of a description of stamps that all differ [natural units of information].

    Parameters
    ----------
    t
        Stamps (N,) [s].
    samples
        Sample of each row (N,).
    interval_s
        Interval [s].
    resolution_s
        Step of the clock [s].

    Notes
    -----
    N ln(s / s0) for Gaussian deviations of rms s about the slow phase, which is at least the
    standard deviation s0 of rounding, and the code of the steps. Half the interval would code a
    lost sample in each row; twice the interval cannot place the rows.
    """
    if len(t) < 2:
        return 0.0
    residual = (t - t[0]) / interval_s - samples
    deviation = residual - _slow_phase(residual)
    deviation -= np.rint(np.median(deviation))  # the phase is known up to a whole number
    scatter_s = interval_s * float(np.sqrt(np.mean(deviation**2)))
    relative = scatter_s / smallest_scatter_s(resolution_s)
    return len(t) * float(np.log(max(relative, 1.0))) + step_code_length(samples)


def _first_intervals_s(t: Array) -> list[float]:
    """First values of the interval [s] of stamps (N,), rising, each once.

    Quantiles of the lengths of spans of rows over their number of rows.
    """
    values = []
    for rows in SEARCH_SPANS:
        if rows == 1 or 2 * rows < len(t):
            spans_s = t[rows:] - t[:-rows]
            values += [float(np.quantile(spans_s, q)) / rows for q in SEARCH_QUANTILES]
    first = list[float]()
    for value in sorted(values):
        if not first or value > (1 + SAME_INTERVAL) * first[-1]:
            first.append(value)
    return first


def _most_coherent_interval_s(t: Array, interval_s: float) -> float:
    """The interval near ``interval_s`` for which pieces of the stamps (N,) are most coherent [s].

    Notes
    -----
    Maximises the sum over pieces of \\|sum exp(2 pi i t / dt)\\|^2. The width of the maximum is one
    interval over the length of a piece, so that longer pieces give a finer value; the search steps
    by a fifth of the width. An interval of which nearly all rows are lost is not refined.
    """
    rate_Hz = 1 / interval_s
    relative_range = 3 * SAME_INTERVAL
    size = PIECE_ROWS
    while True:
        size = min(size, len(t))
        piece_s = float(np.median(t[size - 1 :] - t[: len(t) - size + 1]))
        if piece_s > SPARSEST_ROWS * size * interval_s:
            return 1 / rate_Hz
        step = 0.2 / (rate_Hz * piece_s)
        n_steps = int(relative_range / step)
        rates_Hz = rate_Hz * (1 + step * np.arange(-n_steps, n_steps + 1))
        used = t[: len(t) // size * size] - t[0]
        starts = np.arange(0, len(used), size)
        power = [_coherence(used, starts, rate) for rate in rates_Hz]
        rate_Hz = float(rates_Hz[int(np.argmax(power))])
        if size == len(t):
            return 1 / rate_Hz
        relative_range = 1.5 * step
        size *= 4


def _coherence(t: Array, starts: NDArray[np.intp], rate_Hz: float) -> float:
    """Sum over pieces of \\|sum exp(2 pi i f t)\\|^2; ``starts``: first rows of the pieces."""
    sums = np.add.reduceat(np.exp(2j * np.pi * rate_Hz * t), starts)
    return float(np.sum(np.abs(sums) ** 2))


def _slow_phase(residual: Array) -> Array:
    """The slow part of a residual (N,) in intervals, up to a whole number.

    The angle of the mean of exp(2 pi i r) of each piece of rows, unwrapped and joined by straight
    lines. It does not see whole intervals, so that lost rows do not change it.
    """
    edges = piece_edges(len(residual))
    sums = np.add.reduceat(np.exp(2j * np.pi * residual), edges[:-1])
    phase = np.unwrap(np.angle(sums) / (2 * np.pi), period=1.0)
    if len(phase) == 1:
        return np.full(len(residual), phase[0])
    middle = 0.5 * (edges[:-1] + edges[1:] - 1)
    before = 2 * middle[0] - middle[1]
    after = 2 * middle[-1] - middle[-2]
    rows = np.concatenate([[before], middle, [after]])
    phases = np.concatenate([[2 * phase[0] - phase[1]], phase, [2 * phase[-1] - phase[-2]]])
    return np.interp(np.arange(len(residual)), rows, phases)


def _place(t: Array, interval_s: float) -> NDArray[np.intp]:
    """Sample of each row of stamps (N,) that rise, 0 for the first, for a known interval [s]."""
    rows = np.arange(len(t))
    residual = (t - t[0]) / interval_s - rows
    lost = _lost_so_far(residual - _slow_phase(residual))
    samples = rows + lost
    return samples - samples[0]


def _lost_so_far(residual: Array) -> NDArray[np.intp]:
    """The integers that never fall and are nearest to a residual (N,), in the sum of squares.

    Notes
    -----
    A first or last row that strays by more than half an interval looks like one beyond a lost row.
    A further observation before the first and after the last row, with the weight 2 s^2 ln(1/p) for
    deviations of variance s^2 and the prior probability p of a lost row, makes the result the most
    probable one there, too.
    """
    lost = np.rint(isotonic_regression(residual).x)
    deviation = np.clip(residual - lost, -0.5, 0.5)
    weight = 2 * float(np.mean(deviation**2)) * np.log(1 / LOST_PROBABILITY)
    if weight > np.finfo(float).eps:
        near = min(PIECE_ROWS // 2, len(residual))
        first = np.rint(np.median(residual[:near]))
        last = np.rint(np.median(residual[-near:]))
        weights = np.concatenate([[weight], np.ones(len(residual)), [weight]])
        values = np.concatenate([[first], residual, [last]])
        lost = np.rint(isotonic_regression(values, weights=weights).x)[1:-1]
    return lost.astype(np.intp)
