"""How much of the deviations of time stamps is real, and readings at the times of the grid.

A stamp that strays from the grid is either wrong, or its row was really taken at another time. Only
readings that change tell: a row that was taken late reads what the temperature is then.

Tests: ``tests/series/test_real_share.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.signal import savgol_coeffs

from tcdyn.core import Array, Flags
from tcdyn.series.clock import Clock

# Information of the prior that the stamps are right, as 1 / variance of the share: readings
# outweigh it when they determine the share to better than 0.5 (1 sd).
STAMP_PRIOR = 4.0
# Slope over its standard uncertainty, both of a straight line through the rows of a window, above
# which a reading tells the share. A single step in the window has 6.6 at most (17 rows), and its
# line says nothing about its readings; the error of a slope known to a tenth biases the share by a
# hundredth.
MIN_SLOPE_U = 10.0
# Rows on each side of a window whose slope the estimate uses.
SHARE_HALF_WINDOW = 8
# Neighbours on each side whose parabola shifts a reading to its grid time: more average the noise,
# less follow the signal. White noise grows by 1 % (``tests/series/test_real_share.py``).
SLOPE_NEIGHBOURS = 3
# Sum of the squares of the coefficients 1, -4, 6, -4, 1 of a fourth difference.
FOURTH_DIFFERENCE = 70.0
# Variance of a slope between fourth differences of two white sequences, over that of independent
# ones: sum of the squares of their autocorrelation, 1 + 2 (56^2 + 28^2 + 8^2 + 1) / 70^2.
OVERLAP = 2.626
# Share of the used fourth differences below half a step of the column, from which it rests, or
# rises by the same step from row to row as a counter does. By chance a quantised ramp with more
# than three steps in a window has less than a third.
AT_REST = 0.5
# Passes of share and noise, each from the other: the error falls by the share of the noise.
NOISE_PASSES = 5
# A difference from this share of the largest value counts: smaller ones are rounding errors, for
# example of a conversion of units.
ROUNDING_SHARE = 1e-9


@dataclass(frozen=True)
class RealShare:
    """Share of the deviations of the stamps that is real.

    Attributes
    ----------
    value
        0 (errors of the stamps) to 1 (rows taken at their own stamps).
    u
        Its standard uncertainty; 0.5 where no reading tells.
    """

    value: float
    u: float


def real_share(
    clock: Clock, columns: Sequence[Array], rows: NDArray[np.integer] | None = None
) -> RealShare:
    """Estimate the share of the deviations of the stamps that is real.

    Parameters
    ----------
    clock
        The clock of the rows.
    columns
        Readings, (M,) each in any unit, NaN where there is none.
    rows
        Rows of the clock that the readings belong to (M,), rising; None: all.

    Returns
    -------
    RealShare
        The share, and its standard uncertainty.

    Notes
    -----
    Least squares with the prior 1 +- 0.5: the fourth difference of readings is that of slope times
    deviation, times the share, plus noise. It removes the signal up to its third derivative. The
    slope is that of a straight line through 17 rows, where a straight line describes them. The
    variance of the noise is the mean square of what the share leaves of the fourth differences, at
    least that of the rounding of the column; neighbours overlap (``OVERLAP``). A column that rests,
    or that counts rows, tells nothing. ``python -m tests.series.real_share_study`` has the coverage
    of the intervals.

    Examples
    --------
    >>> from tcdyn.series.clock import fit_clock
    >>> rng = np.random.default_rng(1)
    >>> time_s = np.arange(400) + rng.normal(0, 0.1, 400)
    >>> clock = fit_clock(time_s)
    >>> at_stamps = 0.5 * time_s + rng.normal(0, 0.01, 400)
    >>> at_grid = 0.5 * np.arange(400) + rng.normal(0, 0.01, 400)
    >>> round(real_share(clock, [at_stamps]).value, 1), round(real_share(clock, [at_grid]).value, 1)
    (1.0, 0.0)
    """
    half = SHARE_HALF_WINDOW
    selected = np.arange(len(clock.index)) if rows is None else rows
    n = len(selected)
    if n <= 4 * half:
        return RealShare(1.0, float(1 / np.sqrt(STAMP_PRIOR)))
    index = clock.index[selected]
    n_samples = index[2 * half :] - index[: -2 * half]
    # a clock that wanders puts a row on the next sample now and then
    has_all_samples = np.abs(n_samples - 2 * half) <= int(clock.is_wandering)
    has_all_rows = selected[2 * half :] - selected[: -2 * half] == 2 * half
    is_contiguous = has_all_samples & has_all_rows
    # rows one after the other: even times have no fourth difference
    stamps_s = (clock.even_s + clock.deviation_s)[selected] / clock.interval_s
    witnesses = [_witness_of(y, stamps_s, is_contiguous) for y in columns]
    return _share_of([each for each in witnesses if each is not None])


@dataclass(frozen=True)
class _Witness:
    """A column that tells the share.

    Attributes
    ----------
    predicted
        Fourth differences for a share of one (M,), in the unit of the column.
    difference
        Fourth differences of the readings (M,).
    least_variance
        Variance of the fourth difference of its rounding.
    """

    predicted: Array
    difference: Array
    least_variance: float


def _witness_of(y: Array, stamps: Array, is_contiguous: Flags) -> _Witness | None:
    """What a column (N,) tells about the share; None where it tells nothing.

    Parameters
    ----------
    y
        Readings (N,), NaN where there is none.
    stamps
        Stamps (N,), in intervals.
    is_contiguous
        Whether no row is missing in the window about each row that has one.
    """
    half = SHARE_HALF_WINDOW
    inside = slice(half - 2, len(y) - half - 2)
    weights = np.arange(-half, half + 1.0)
    lever = float(weights @ weights)
    window = sliding_window_view(y, 2 * half + 1)
    slope = window @ weights / lever
    square = np.var(window, axis=1) * len(weights) - slope**2 * lever
    u_slope = np.sqrt(np.maximum(square, 0.0) / (len(weights) - 2) / lever)
    difference = np.diff(y, 4)[inside]
    with np.errstate(invalid="ignore"):
        used = is_contiguous & (np.abs(slope) > MIN_SLOPE_U * u_slope)
    step = _smallest_step(y)
    is_same = np.abs(difference[used]) < 0.5 * step
    if not used.any() or float(np.mean(is_same)) > AT_REST:
        return None
    cubic = window[used] @ savgol_coeffs(2 * half + 1, 3, deriv=1, use="dot")
    predicted = cubic * np.diff(stamps, 4)[inside][used]
    return _Witness(predicted, difference[used], FOURTH_DIFFERENCE * step**2 / 12)


def _smallest_step(y: Array) -> float:
    """Step of which all changes from row to row (N,) are multiples, in their unit.

    The smallest distance between two different changes: that of readings with many decimals is far
    below their noise.
    """
    finite = y[np.isfinite(y)]
    change = np.unique(np.append(0.0, np.abs(np.diff(finite))))
    rounding = ROUNDING_SHARE * float(np.max(np.abs(finite), initial=0.0))
    distance = np.diff(change)
    distance = distance[distance > rounding]
    return float(np.min(distance)) if len(distance) else rounding


def _share_of(witnesses: Sequence[_Witness]) -> RealShare:
    """The share that columns tell together, with the prior."""
    value = 1.0
    information = STAMP_PRIOR
    for _ in range(NOISE_PASSES):
        numerator = STAMP_PRIOR
        information = STAMP_PRIOR
        for each in witnesses:
            rest = each.difference - value * each.predicted
            variance = max(float(rest @ rest) / len(rest), each.least_variance) * OVERLAP
            numerator += float(each.predicted @ each.difference) / variance
            information += float(each.predicted @ each.predicted) / variance
        value = min(max(numerator / information, 0.0), 1.0)
    return RealShare(value, float(1 / np.sqrt(information)))


def at_grid_times(values: Array, grid_times_s: Array, late_s: Array) -> Array:
    """Shift readings from their own times to the times of the grid.

    Parameters
    ----------
    values
        Readings of the rows (N,), NaN where there is none.
    grid_times_s
        Time of each row on the grid (N,) [s].
    late_s
        How much later each reading was taken (N,) [s]: the real share of the jitter of the clock.

    Returns
    -------
    values
        (N,), at the times of the grid.

    Notes
    -----
    Each reading is shifted along the parabola through its neighbours on both sides, missing ones
    left out. A straight line would leave half the mean square of the deviations times the second
    derivative. Where fewer than three neighbours have readings, the reading is not shifted.
    """
    width = 2 * SLOPE_NEIGHBOURS + 1
    times_s = grid_times_s + late_s
    unit_s = float(np.median(np.diff(times_s))) if len(times_s) > 1 else 1.0
    t = sliding_window_view(np.pad(times_s, SLOPE_NEIGHBOURS, mode="edge"), width)
    y = sliding_window_view(np.pad(values, SLOPE_NEIGHBOURS, constant_values=np.nan), width)
    used = np.isfinite(y) & np.isfinite(values)[:, None]
    since = np.where(used, (t - times_s[:, None]) / unit_s, 0.0)
    change = np.where(used, y - values[:, None], 0.0)
    powers = np.stack([used.astype(float), since, since**2], axis=2)
    normal = np.einsum("nwi,nwj->nij", powers, powers)
    right = np.einsum("nwi,nw->ni", powers, change)
    is_determined = used.sum(axis=1) > 3
    normal[~is_determined] = np.eye(3)
    right[~is_determined] = 0.0
    parabola = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
    shift = -late_s / unit_s
    return np.asarray(values + parabola[:, 1] * shift + parabola[:, 2] * shift**2)
