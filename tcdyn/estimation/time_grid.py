"""Even grid of time stamps: sampling interval, rows on the grid, and how far samples stray from it.

One mechanism for logs of the rig (``tcdyn.rig.check_clock``), tables with sensors
(``tcdyn.sensors.table``) and input-output data (``tcdyn.identification.tables``). Thresholds are
chosen by judgement where no other reason is given. Guarded by ``tests/rig/test_check_clock.py``,
``tests/sensors/test_uneven_stamps.py`` and ``tests/identify/test_identify_data.py``.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.estimation.trace_noise import MAD_TO_SD

FIRST_TIMES = 8  # from which the sampling interval is refined (chosen by judgement)
# Standard deviation of the steps, in sample intervals, above which stamps count as jittered; less
# is rounding, and leaves the readings as they are. Chosen by judgement.
MIN_JITTER = 0.15
# Share of steps that are not one grid interval long above which another rate is tried.
MAX_LOST_SHARE = 0.2
# Significance limit of the phase sum of n stamps, in sqrt(n): chance exceeds it once in some
# thousand trials.
MIN_PHASE_SUM = 4.0
# Neighbours on each side whose slope shifts a jittered sample to its grid time. Chosen by
# judgement.
SLOPE_NEIGHBOURS = 3
# Information of the prior that the stamps are right: readings outweigh it when they determine the
# real share of the jitter to better than 0.5 (1 sd).
STAMP_PRIOR = 4.0
# Slope over its standard uncertainty, above which a trace tells the real share of the jitter.
# Chosen by judgement.
MIN_SLOPE_U = 4
# Rounding moves a stamp by at most half of the smallest step; with a margin. The multiples of that
# step must be integers within the second number. Chosen by judgement.
MAX_OFFSET_STEPS = 0.6
MULTIPLE_TOLERANCE = 0.01
# Standard deviations of a sum of random signs within which steps are too long and too short alike
MAX_EXCESS_U = 3.0
# Rates that are tried, over the mean one. That of the rounded steps is too low by 10 % where stamps
# stray by 0.3 of an interval and a fifth of the rows are lost, and by 18 % where 30 % are lost
# (tests/sensors/test_uneven_stamps.py).
RATE_RANGE = (0.9, 1.25)
# Rows in which the rate is searched first, and most rows of a sum. More cost time only.
FIRST_GRID_ROWS = 4096
MAX_GRID_ROWS = 20_000
# Rows on each side of a window for the slope in the estimate of the real share of the jitter.
SHARE_HALF_WINDOW = 8


def sampling_interval_s(times: Sequence[Array], where: str) -> float:
    """Return the sampling interval [s] of several runs, the mean of all steps.

    The mean is not biased by rounded or irregular time stamps. A step over missing rows counts as
    several.

    Parameters
    ----------
    times
        Times of each run [s].
    where
        Table that errors name.

    Returns
    -------
    float
        Sampling interval [s].

    Raises
    ------
    InputError
        For fewer than two samples.
    """
    steps = np.concatenate([np.diff(t) for t in times])
    steps = steps[np.isfinite(steps) & (steps > 0)]
    if len(steps) == 0:
        raise InputError("has fewer than two samples", where=where, expected="a record")
    median = float(np.median(steps))
    rising = [t[np.isfinite(t)] for t in times]
    rising = [t[np.append(True, np.diff(np.maximum.accumulate(t)) > 0)] for t in rising if len(t)]
    n_intervals = sum(_count_intervals(t, median) for t in rising)
    return float(steps.sum() / n_intervals) if n_intervals > 0 else median


def _count_intervals(t: Array, dt_s: float) -> int:
    """Number of sampling intervals from the first to the last of the times ``t`` (N,) [s].

    ``dt_s`` is about the interval. A first part of the times, doubled until it is all of them,
    gives a better one each time, so that errors of single times do not add up.
    """
    end = FIRST_TIMES
    while True:
        part = t[:end]
        position = np.round((part - t[0]) / dt_s)
        if end >= len(t):
            return int(position[-1])
        if position[-1] > 0:
            centred = position - position.mean()
            dt_s = float(centred @ part / (centred @ centred))
        end *= 2


def grid_indices(step: Array, dt_s: float) -> NDArray[np.int32]:
    """Index of each sample on the grid of ``dt_s``, from the steps between samples.

    Parameters
    ----------
    step
        Steps of the stamps (N - 1,) [s].
    dt_s
        Grid interval [s].

    Returns
    -------
    grid
        (N,), 0 for the first; each step is at least one.
    """
    intervals = step / dt_s
    np.maximum(np.rint(intervals, out=intervals), 1.0, out=intervals)
    grid = np.zeros(len(step) + 1, dtype=np.int32)
    grid[1:] = np.cumsum(intervals, out=intervals)
    return grid


def interval_of_grid(time: Array, grid: NDArray[np.int32]) -> float:
    """Slope of the straight line through the stamps, by least squares.

    Parameters
    ----------
    time
        Times (N,) [s].
    grid
        Index of each time on the grid (N,).

    Returns
    -------
    dt_s
        [s].
    """
    centred = grid - grid.mean()
    return float(centred @ (time - time.mean()) / (centred @ centred))


def is_jittered(step: Array, intervals: NDArray[np.int32], dt: float) -> bool:
    """Whether the steps scatter about multiples of ``dt`` by more than rounding explains.

    Parameters
    ----------
    step
        Steps of the stamps (N - 1,) [s].
    intervals
        Steps on the grid (N - 1,).
    dt
        Sample interval [s].
    """
    scatters = step_scatter(step, intervals, dt) > MIN_JITTER
    return bool(scatters or (intervals != 1).mean() > MAX_LOST_SHARE)


def step_scatter(step: Array, intervals: NDArray[np.int32], dt: float) -> float:
    """Rms distance of the steps from multiples of ``dt``, in intervals; parameters as above."""
    deviation = dt * intervals
    deviation -= step  # in place: one array of the length of a long log less
    return float(np.sqrt(deviation @ deviation / len(deviation)) / dt)


def has_few_decimals(step: Array, max_offset_s: float) -> bool:
    """Whether all steps are multiples of the smallest one: the clock has too few decimals.

    Parameters
    ----------
    step
        Steps of the stamps (N - 1,) [s].
    max_offset_s
        Largest distance of a stamp from its even time [s].
    """
    resolution_s = float(step.min())
    multiples = step / resolution_s
    is_multiple = np.allclose(multiples, np.rint(multiples), atol=MULTIPLE_TOLERANCE)
    return is_multiple and max_offset_s < MAX_OFFSET_STEPS * resolution_s


def fit_grid(
    time: Array, mean_rate_Hz: float | None = None
) -> tuple[float, NDArray[np.int32], bool]:
    """Interval [s] and grid indices of stamps that jitter.

    The rate f maximises |sum exp(2 pi i f t)|, first over the start of the log, then over more and
    more of it. Where no maximum is significant, ``mean_rate_Hz`` is as good.

    Parameters
    ----------
    time
        Times as logged (N,) [s], which do not go back.
    mean_rate_Hz
        About the rate; None: that of the rounded steps, which allows for lost rows.

    Returns
    -------
    dt_s
        Sample interval.
    grid
        Index of each row (N,), 0 for the first.
    is_significant
        Whether the stamps lie about an even grid. Otherwise the position of a row is not known.

    Notes
    -----
    Rates within ``RATE_RANGE`` of ``mean_rate_Hz`` are tried. The steps of the rate are a quarter
    of the width of the maximum. ``MIN_PHASE_SUM`` decides whether the maximum is significant.
    """
    if mean_rate_Hz is None:
        mean_rate_Hz = rate_of_steps(np.diff(time))
    t = time - time[0]
    size = min(FIRST_GRID_ROWS, len(time))
    candidates = mean_rate_Hz * np.arange(*RATE_RANGE, 0.25 / size)
    while True:
        subset = t[:size][:: size // MAX_GRID_ROWS + 1]
        sums = [abs(_phase_sum(f, subset)) for f in candidates]
        best = float(candidates[np.argmax(sums)])
        if size == len(t):
            break
        candidates = best + np.linspace(-0.5, 0.5, 17) / t[size - 1]
        size = min(4 * size, len(t))
    rate_Hz = best
    phase_sum = _phase_sum(best, subset)
    is_significant = bool(abs(phase_sum) > MIN_PHASE_SUM * len(subset) ** 0.5)
    if not is_significant:
        rate_Hz = mean_rate_Hz
        phase_sum = _phase_sum(mean_rate_Hz, subset)
    grid = np.rint(t * rate_Hz - np.angle(phase_sum) / (2 * np.pi)).astype(np.int32)
    # of two rows with one index the second takes the next index, or the first the previous one, if
    # free
    grid[1:-1] += (np.diff(grid[:-1]) == 0) & (np.diff(grid[1:]) > 1)
    grid[1:-1] -= (np.diff(grid[:-1]) > 1) & (np.diff(grid[1:]) == 0)
    return interval_of_grid(time, grid), grid - grid[0], is_significant


def rate_of_steps(step: Array) -> float:
    """Rate [Hz] of steps (N - 1,) [s] that scatter and of which some span lost rows.

    Errors of the rounding to whole intervals cancel, since as many steps are too long as too short.
    The median is the first interval; lost rows make it too long, and the second pass corrects it.
    Where the steps that are not one interval long are as many too long as too short, no rows are
    lost, and the rate is the mean one.
    """
    interval_s = float(np.median(step[step > 0]))
    for _ in range(2):
        intervals = np.rint(step / interval_s)
        if intervals.sum() > 0:
            interval_s = float(step.sum() / intervals.sum())
    excess = np.rint(step / interval_s) - 1
    if abs(excess.sum()) <= MAX_EXCESS_U * np.sqrt(np.count_nonzero(excess)):
        return len(step) / float(step.sum())
    return 1 / interval_s


def _phase_sum(rate_Hz: float, t: Array) -> complex:
    """Sum of exp(2 pi i f t); its size is the number of stamps if all lie on a grid of 1/f."""
    return complex(np.exp(2j * np.pi * rate_Hz * t).sum())


def times_of_grid(time: Array, grid: NDArray[np.int32], dt_s: float) -> tuple[Array, float]:
    """Even times of the stamps [s], and the largest distance of a logged stamp from its own [s].

    Parameters
    ----------
    time
        Times as logged (N,) [s].
    grid
        Index of each time on the grid (N,).
    dt_s
        Grid interval [s].

    Returns
    -------
    even
        (N,) [s], with the mean of ``time``.
    max_offset_s
        [s].
    """
    even = np.asarray(grid - grid.mean())
    even *= dt_s
    even += time.mean()
    offset = time - even
    return even, float(max(offset.max(), -offset.min()))


def shift_to_grid(values: Array, grid_times_s: Array, jitter_s: Array) -> Array:
    """Samples at their grid times, along the slope of a straight line through their neighbours.

    Parameters
    ----------
    values
        Samples (N,), NaN where missing.
    grid_times_s
        Grid time of each sample (N,) [s].
    jitter_s
        How much later than its grid time each sample was taken (N,) [s].

    Returns
    -------
    values
        (N,), at the grid times.

    Notes
    -----
    This keeps white noise white and increases it by 1 %. ``SLOPE_NEIGHBOURS`` trades noise against
    the curvature of the trace.
    """
    width = 2 * SLOPE_NEIGHBOURS + 1
    sampled_s = np.pad(grid_times_s + jitter_s, SLOPE_NEIGHBOURS, mode="edge")
    t = sliding_window_view(sampled_s, width)
    y = sliding_window_view(np.pad(values, SLOPE_NEIGHBOURS, constant_values=np.nan), width)
    used = np.isfinite(y)
    count = np.maximum(used.sum(axis=1), 1)
    t = _subtract_means(np.where(used, t - grid_times_s[:, None], 0.0), used, count)
    y = _subtract_means(np.where(used, y, 0.0), used, count)
    slope_numerator = (t * y).sum(axis=1)
    slope_denominator = np.maximum((t * t).sum(axis=1), 1e-300)
    return np.asarray(values - jitter_s * slope_numerator / slope_denominator)


def _subtract_means(windows: Array, used: NDArray[np.bool_], count: NDArray[np.int_]) -> Array:
    """Windows minus the mean of their used values; zero where a value is not used.

    Parameters
    ----------
    windows
        Values (N, W), zero where not used.
    used
        Whether a value is used (N, W).
    count
        Number of used values (N,).
    """
    return np.where(used, windows - (windows.sum(axis=1) / count)[:, None], 0.0)


def real_jitter_share(
    columns: Array, rows: NDArray[np.int64], grid: NDArray[np.integer], dt_s: float, jitter_s: Array
) -> float:
    """Share of the jitter that is real; 1 where the readings hold no information about it.

    Least squares with the prior 1: fourth differences of readings are those of slope times jitter,
    plus noise. Both are known where the slope is significant.

    Parameters
    ----------
    columns
        Temperatures at ``rows`` of the file, (N, M) [degC], NaN where missing.
    rows
        Rows of the file (N,).
    grid
        Index of all rows of the file on the grid.
    dt_s
        Grid interval [s].
    jitter_s
        Jitter of all rows of the file [s].

    Returns
    -------
    share
        0 to 1.

    Notes
    -----
    The factor 70 is the sum of squares of the coefficients of the fourth difference.
    ``STAMP_PRIOR`` weighs the prior that the stamps are right; a larger value needs steeper traces
    to contradict them. Test: ``tests/rig/test_check_clock.py``.
    """
    half = SHARE_HALF_WINDOW
    n = len(rows)
    if n < 4 * half:
        return 1.0
    index = grid[rows]
    is_contiguous = (index[2 * half :] - index[: -2 * half] == 2 * half) & (
        rows[2 * half :] - rows[: -2 * half] == 2 * half
    )
    inside = slice(half - 2, n - half - 2)
    jitter_difference = np.diff(jitter_s[rows], 4)[inside]
    weights = np.arange(half, -half - 1, -1.0)
    weight_square = np.sum(weights**2)
    numerator = STAMP_PRIOR
    denominator = STAMP_PRIOR
    for y in columns.T:
        slope = np.convolve(y, weights, "valid") / weight_square
        difference = np.diff(y, 4)[inside]
        sd = MAD_TO_SD * float(np.nanmedian(np.abs(difference)))
        with np.errstate(invalid="ignore"):
            is_significant = np.abs(slope) > MIN_SLOPE_U * sd / np.sqrt(70 * weight_square)
        used = is_contiguous & is_significant
        predicted = slope[used] / dt_s * jitter_difference[used]
        variance = max(sd, 1e-9) ** 2
        numerator += float(np.sum(predicted * difference[used])) / variance
        denominator += float(np.sum(predicted**2)) / variance
    return min(max(numerator / denominator, 0.0), 1.0)
