"""Residuals of two sensors, one with few new values: its missing values are eliminated exactly.

``tcdyn.sensors.pair`` uses it where one channel has a new value in some rows only. Elimination
replaces a free parameter for each missing value by one equation for each interval.
``tests/series/test_updates.py`` compares it with the full least squares.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky_banded, solve_banded

from tcdyn.core import Array, Flags

# Weight of a row in the residual of an interval, relative to that of its last row, below which it
# is left out.
NEGLIGIBLE = 1e-12


@dataclass(frozen=True)
class Intervals:
    """Intervals between rows at which both channels have a new value.

    Attributes
    ----------
    start, stop
        First and last row of each (K,).
    missing
        0 or 1 (K,): the channel whose values between ``start`` and ``stop`` are eliminated.
    """

    start: NDArray[np.intp]
    stop: NDArray[np.intp]
    missing: NDArray[np.intp]


def find_intervals(new: tuple[Flags, Flags], segment: NDArray[np.intp]) -> Intervals:
    """Find the intervals of which one channel is complete.

    Parameters
    ----------
    new
        Rows (N,) with a new value, of each channel.
    segment
        Number of the segment of constant flow (N,); an interval lies within one.

    Returns
    -------
    Intervals
        Those between rows with new values of both channels, in one segment, in which at least one
        channel has a new value in each row.
    """
    both = np.flatnonzero(new[0] & new[1])
    start = both[:-1]
    stop = both[1:]
    complete = [
        np.add.accumulate(flags)[stop] - np.add.accumulate(flags)[start] == stop - start
        for flags in new
    ]
    keep = (complete[0] | complete[1]) & (segment[start] == segment[stop])
    missing = np.where(complete[0], 1, 0)
    return Intervals(start[keep], stop[keep], missing[keep])


def interval_residuals(
    before: Array, after: Array, y: Array, noise_K: tuple[float, float], intervals: Intervals
) -> Array:
    """Return residuals of unit variance, one for each interval.

    Parameters
    ----------
    before, after
        Weights (2, N - 1) of rows j and j + 1 of each channel in its equation over the step from j
        to j + 1.
    y
        Readings (2, N) [degC]; those that are missing are not used.
    noise_K
        Standard deviation of the white noise of each channel [K].
    intervals
        The intervals (K).

    Returns
    -------
    array
        Whitened residuals (K,).

    Notes
    -----
    The equation of a step is r_j = before_1 y1_j + after_1 y1_j+1 - before_2 y2_j - after_2 y2_j+1
    = noise. The sum of c_j r_j over an interval, with c = 1 in its last step and c_j after_j =
    -c_j+1 before_j+1 of the missing channel, holds that channel at the interval's ends only.
    Generalised least squares of these sums equals that of all equations with the missing values as
    free parameters.

    ``before`` and ``after`` are those of ``tcdyn.sensors.pair.whitened_residuals``; a change of the
    equation there needs none here, as long as it is linear in neighbouring rows.
    """
    count = len(intervals.start)
    index = np.arange(count)
    values = np.nan_to_num(y)
    residual = np.zeros(count)
    variance = np.zeros((2, count))  # over the square of the noise, of each channel
    weight = np.ones(count)
    later = np.zeros((2, count))  # what the step after adds to the coefficient of the row between
    first = np.zeros((2, count))
    for back in range(int(np.max(intervals.stop - intervals.start, initial=0))):
        active = (intervals.stop - back > intervals.start) & (np.abs(weight) > NEGLIGIBLE)
        if not np.any(active):
            break
        row = np.where(active, intervals.stop - 1 - back, intervals.start)
        if back > 0:
            ratio = (
                -before[intervals.missing, np.minimum(row + 1, before.shape[1] - 1)]
                / after[intervals.missing, row]
            )
            weight = weight * ratio
        weight = np.where(active, weight, 0.0)
        for k, sign in enumerate((1.0, -1.0)):
            upper = weight * after[k, row] + later[k]
            residual += np.where(active, sign * upper * values[k, row + 1], 0.0)
            variance[k] += np.where(active, upper**2, 0.0)
            later[k] = np.where(active, weight * before[k, row], later[k])
        at_start = active & (row == intervals.start)
        for k, sign in enumerate((1.0, -1.0)):
            residual += np.where(at_start, sign * later[k] * values[k, row], 0.0)
            variance[k] += np.where(at_start, later[k] ** 2, 0.0)
            first[k] = np.where(at_start, later[k], first[k])
    squares = np.square(noise_K)
    last = after[:, intervals.stop - 1]
    shared = intervals.stop[:-1] == intervals.start[1:]
    band = np.zeros((2, count))
    band[0] = squares @ variance
    band[1, :-1] = np.where(shared, squares @ (last[:, :-1] * first[:, 1:]), 0.0)
    factor = cholesky_banded(band, lower=True)
    return solve_banded((1, 0), factor, residual[index])
