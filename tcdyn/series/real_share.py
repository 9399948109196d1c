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

from tcdyn.core import Array
from tcdyn.estimation.trace_noise import MAD_TO_SD
from tcdyn.series.clock import Clock

# Information of the prior that the stamps are right, as 1 / variance of the share: readings
# outweigh it when they determine the share to better than 0.5 (1 sd).
STAMP_PRIOR = 4.0
# Slope over its standard uncertainty, above which a reading tells the share: the error of a slope
# known to a quarter biases the share by less than its uncertainty (1/16).
MIN_SLOPE_U = 4.0
# Rows on each side of a window whose slope the estimate uses.
SHARE_HALF_WINDOW = 8
# Neighbours on each side whose parabola shifts a reading to its grid time: more average the noise,
# less follow the signal. White noise grows by 1 % (``tests/series/test_real_share.py``).
SLOPE_NEIGHBOURS = 3
# Sum of the squares of the coefficients 1, -4, 6, -4, 1 of a fourth difference.
FOURTH_DIFFERENCE = 70.0


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
    slope is that of a straight line through 17 rows, where it is significant; the noise is known
    from the median of the absolute fourth differences.

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
    numerator = STAMP_PRIOR
    information = STAMP_PRIOR
    if n > 4 * half:
        index = clock.index[selected]
        n_samples = index[2 * half :] - index[: -2 * half]
        # a clock that wanders puts a row on the next sample now and then
        has_all_samples = np.abs(n_samples - 2 * half) <= int(clock.is_wandering)
        has_all_rows = selected[2 * half :] - selected[: -2 * half] == 2 * half
        is_contiguous = has_all_samples & has_all_rows
        inside = slice(half - 2, n - half - 2)
        # rows one after the other: even times have no fourth difference
        stamps_s = (clock.even_s + clock.deviation_s)[selected]
        deviation = np.diff(stamps_s / clock.interval_s, 4)[inside]
        weights = np.arange(half, -half - 1, -1.0)
        lever = float(np.sum(weights**2))
        for y in columns:
            slope = np.convolve(y, weights, "valid") / lever
            difference = np.diff(y, 4)[inside]
            finite = np.abs(difference[np.isfinite(difference)])
            if not len(finite):
                continue
            sd = MAD_TO_SD * float(np.median(finite))
            with np.errstate(invalid="ignore"):
                is_significant = np.abs(slope) > MIN_SLOPE_U * sd / np.sqrt(
                    FOURTH_DIFFERENCE * lever
                )
            used = is_contiguous & is_significant & np.isfinite(difference)
            predicted = slope[used] * deviation[used]
            variance = max(sd, float(np.finfo(float).tiny) ** 0.25) ** 2
            numerator += float(predicted @ difference[used]) / variance
            information += float(predicted @ predicted) / variance
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
