"""Check the time stamps of a log, and resample temperatures where the stamps jitter.

The checks cover repeated, missing and rounded stamps, gaps, lost samples, and stamps that scatter
about an even grid (timing jitter).

:func:`check_time` is used by :mod:`tcdyn.rig.log`; :func:`sample_interval_s` by most users of a
log. Thresholds are chosen by judgement where no other reason is given. Tests:
``tests/rig/test_check_clock.py``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, SampleLocation, info, info_or_warning, warning
from tcdyn.estimation.trace_noise import MAD_TO_SD

# Longest gap [s] that is bridged; the content of a longer one is unknown. Chosen by judgement.
MAX_GAP_S = 0.5
# Longest sample interval [s]: slower traces hold no information about lags. Chosen by judgement.
MAX_INTERVAL_S = 1.0
# Slowest sampling [s] that gives no warning (20 Hz). Chosen by judgement.
SLOW_INTERVAL_S = 0.05
# Standard deviation of the steps, in sample intervals, above which stamps count as jittered; less
# is rounding, and leaves the readings as they are. Chosen by judgement.
MIN_JITTER = 0.15
# Share of steps that are not one grid interval long: above the first another rate is tried, above
# the second there is no common rate. Chosen by judgement.
MAX_LOST_SHARE = 0.2
MAX_UNEVEN_SHARE = 0.35
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
MIN_ROWS = 10  # of a log; chosen by judgement
# Steps over the sample interval within which sampling is even: half an interval would be the next
# position on the grid. Chosen by judgement.
MIN_EVEN_STEP = 0.55
MAX_EVEN_STEP = 1.45
# Relative difference between median and mean step, above which stamps are rounded. By judgement.
MIN_ROUNDING = 1e-3
# Rounding moves a stamp by at most half of the smallest step; with a margin. The multiples of that
# step must be integers within the second number. Chosen by judgement.
MAX_OFFSET_STEPS = 0.6
MULTIPLE_TOLERANCE = 0.01
# Rates that are tried, over the mean rate of the stamps; lost samples make the latter too low.
RATE_RANGE = (0.99, 1.06)
# Rows in which the rate is searched first, and most rows of a sum. More cost time only.
FIRST_GRID_ROWS = 4096
MAX_GRID_ROWS = 20_000
# Rows on each side of a window for the slope in the estimate of the real share of the jitter.
SHARE_HALF_WINDOW = 8


@dataclass(frozen=True)
class Sampling:
    """Times of a log and their even grid.

    Parameters
    ----------
    time_s
        Time of each row, (N,) [s].
    dt_s
        Sample interval [s].
    grid
        Index of each row on the even grid, (N,). Rows may share an index where stamps jitter.
    findings
        Findings about the time column.
    jitter_s
        Jitter: how much later than its grid time each sample was taken, (N,) [s]; None where the
        stamps do not jitter.
    """

    time_s: Array
    dt_s: float
    grid: NDArray[np.int32]
    findings: tuple[Finding, ...]
    jitter_s: Array | None = None


def check_time(time: Array, location: SampleLocation) -> Sampling:
    """Check the time column of a log and find its sampling.

    Single missing values are interpolated. Rounded stamps (0.013, 0.027, 0.040 at 75 Hz) are
    recognised as even and replaced by even times. Jittered stamps are replaced by even times, too,
    and the jitter of each sample is returned.

    Parameters
    ----------
    time
        Time as logged, (N,) [s].
    location
        Position of the rows in the file, for messages.

    Returns
    -------
    sampling
        Times, sample interval, grid and findings.

    Raises
    ------
    InputError
        Time repeats or runs backward (row, time), a gap above 0.5 s, uneven sampling, milliseconds,
        or too few rows.

    Notes
    -----
    Even stamps are kept as they are where rounding explains their scatter (``MIN_JITTER``). The
    order matters: the rate is checked before the grid is fitted, because a gap would spoil the fit.
    Test: ``tests/rig/test_check_clock.py``.
    """
    where = location.where
    if len(time) < MIN_ROWS:
        raise InputError(
            f"only {len(time)} rows", where=where, expected=f"at least {MIN_ROWS} samples in time"
        )
    time, findings = _fill_missing(time, location)
    step = np.diff(time)
    _check_rising(time, step, location)
    median_step = float(np.median(step))
    dt = _interval_s(time, _grid_indices(step, median_step))
    _check_rate_and_gaps(time, step, dt, location)
    grid = _grid_indices(step, dt)
    intervals = np.diff(grid)
    is_jittered = _is_jittered(step, intervals, dt)
    if is_jittered:
        dt, grid = _fit_grid(time, len(step) / float(time[-1] - time[0]))
        intervals = np.diff(grid)
    is_uneven = (step > MAX_EVEN_STEP * dt) | (step < MIN_EVEN_STEP * dt)
    if (intervals != 1).mean() > MAX_UNEVEN_SHARE:
        raise InputError(
            f"column time_s, row {location.row(int(np.argmax(is_uneven)) + 1)}: sampling is uneven "
            f"({step.min():.4g} to {step.max():.4g} s)",
            where=where,
            expected="one sampling rate",
            remedy="log at one rate, or resample first",
        )
    jitter = is_uneven & (intervals == 1)
    if jitter.any() and not is_jittered:
        row = location.row(int(np.argmax(jitter)) + 1)
        findings.append(info("time.jitter", subject="time_s", row=row, count=int(jitter.sum())))
    even, max_offset_s = _even_times(time, grid, dt)
    jitter_s = None
    if is_jittered:
        if _has_few_decimals(step, max_offset_s):
            findings.append(info("time.few_decimals", subject="time_s", rate_Hz=1 / dt))
        else:
            jitter_s = time - even
    findings += _lost_samples(time, intervals, location)
    if dt > SLOW_INTERVAL_S:
        findings.append(warning("time.slow", subject="time_s", rate_Hz=1 / dt, lost_s=2 * dt))
    # steps of 13 and 14 ms, neither of which is the interval of 75 Hz: the clock has too few
    # decimals
    is_rounded = abs(median_step - dt) >= MIN_ROUNDING * dt and max_offset_s < dt
    if is_jittered or is_rounded:
        time = even
    return Sampling(time, dt, grid, tuple(findings), jitter_s)


def _check_rising(time: Array, step: Array, location: SampleLocation) -> None:
    """Raise InputError where time repeats or runs backward.

    Parameters
    ----------
    time, step
        Times (N,) [s] and their steps (N - 1,) [s].
    location
        Position of the rows in the file, for messages.
    """
    is_wrong = ~(step > 0)
    if not is_wrong.any():
        return
    i = int(np.argmax(step <= 0))
    repeats = step[i] == 0
    count = int((step <= 0).sum())
    verb = "repeats" if repeats else "runs backward"
    what = (
        f"column time_s, row {location.row(i + 1)}: time {verb} "
        f"({time[i]:.6g} s, then {time[i + 1]:.6g} s)"
    )
    if count > 1:
        what += f", and in {count - 1} more rows"
    remedy = "sort the rows, or give the clock more decimals" if repeats else "repair the rows"
    raise InputError(
        what, where=location.where, expected="time that rises from row to row", remedy=remedy
    )


def _check_rate_and_gaps(time: Array, step: Array, dt: float, location: SampleLocation) -> None:
    """Raise InputError for sampling slower than 1 Hz and for gaps.

    Parameters
    ----------
    time, step
        Times (N,) [s] and their steps (N - 1,) [s].
    dt
        Sample interval [s].
    location
        Position of the rows in the file, for messages.

    Notes
    -----
    Change ``MAX_GAP_S`` together with ``tcdyn.rig.check_columns.MAX_MISSING_RUN_S``, the longest
    run of missing values. A step of three intervals is always allowed.
    """
    if dt > MAX_INTERVAL_S:
        is_milliseconds = dt * 1e-3 < 0.2
        hint = "; this looks like milliseconds" if is_milliseconds else ""
        raise InputError(
            f"column time_s: the sample interval is {dt:.4g} s{hint}",
            where=location.where,
            expected="seconds, sampled faster than 1 Hz (75 Hz on the rig)",
        )
    gap = int(np.argmax(step))
    if step[gap] > max(MAX_GAP_S, 3 * dt):
        raise InputError(
            f"column time_s, row {location.row(gap + 1)}: {step[gap]:.4g} s are missing at "
            f"{time[gap]:.6g} s",
            where=location.where,
            expected=f"gaps of at most {MAX_GAP_S} s",
            remedy="cut the log there and use one part",
        )


def _is_jittered(step: Array, intervals: NDArray[np.int32], dt: float) -> bool:
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
    deviation = dt * intervals
    deviation -= step  # in place: one array of the length of a long log less
    scatters = float(deviation @ deviation) > len(deviation) * (MIN_JITTER * dt) ** 2
    return bool(scatters or (intervals != 1).mean() > MAX_LOST_SHARE)


def _has_few_decimals(step: Array, max_offset_s: float) -> bool:
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


def _lost_samples(
    time: Array, intervals: NDArray[np.int32], location: SampleLocation
) -> list[Finding]:
    """A finding about samples missing from the grid, or none.

    Parameters
    ----------
    time
        Times (N,) [s].
    intervals
        Steps on the grid (N - 1,).
    location
        Position of the rows in the file, for messages.
    """
    is_gap = intervals > 1
    lost = int((intervals[is_gap] - 1).sum())
    if not lost:
        return []
    first = int(np.argmax(is_gap))
    finding = info_or_warning(
        lost / len(time),
        "time.lost",
        subject="time_s",
        row=location.row(first + 1),
        count=lost,
        places=int(is_gap.sum()),
        first_s=float(time[first]),
    )
    return [finding]


def _fit_grid(time: Array, mean_rate_Hz: float) -> tuple[float, NDArray[np.int32]]:
    """Interval [s] and grid indices of stamps that jitter.

    The rate f maximises |sum exp(2 pi i f t)|, first over the start of the log, then over more and
    more of it. Where no maximum is significant, ``mean_rate_Hz`` (the mean rate of the stamps, a
    little less than f where samples are lost) is as good.

    Parameters
    ----------
    time
        Times as logged (N,) [s].
    mean_rate_Hz
        Mean rate of the stamps.

    Returns
    -------
    dt_s
        Sample interval.
    grid
        Index of each row (N,), 0 for the first.

    Notes
    -----
    Rates within ``RATE_RANGE`` of the mean rate are tried, since lost samples make the mean rate
    too low. The steps of the rate are a quarter of the width of the maximum. ``MIN_PHASE_SUM``
    decides whether the maximum is significant.
    """
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
    if not abs(phase_sum) > MIN_PHASE_SUM * len(subset) ** 0.5:
        rate_Hz = mean_rate_Hz
        phase_sum = _phase_sum(mean_rate_Hz, subset)
    grid = np.rint(t * rate_Hz - np.angle(phase_sum) / (2 * np.pi)).astype(np.int32)
    # of two rows with one index the second takes the next index, or the first the previous one, if
    # free
    grid[1:-1] += (np.diff(grid[:-1]) == 0) & (np.diff(grid[1:]) > 1)
    grid[1:-1] -= (np.diff(grid[:-1]) > 1) & (np.diff(grid[1:]) == 0)
    return _interval_s(time, grid), grid - grid[0]


def _phase_sum(rate_Hz: float, t: Array) -> complex:
    """Sum of exp(2 pi i f t); its size is the number of stamps if all lie on a grid of 1/f."""
    return complex(np.exp(2j * np.pi * rate_Hz * t).sum())


def resample_to_grid(name: str, values: Array, sampling: Sampling, rows: slice) -> Array:
    """Temperatures at the even times; other columns, and logs without jitter, come back unchanged.

    Each sample is shifted along the slope of a straight line through its neighbours, missing ones
    left out. This keeps white noise white and increases it by 1 %.

    Parameters
    ----------
    name
        Name of the column.
    values
        Samples of the column at ``rows``, (N,).
    sampling
        Sampling of the log, with the jitter.
    rows
        Rows of the file that ``values`` hold.

    Returns
    -------
    values
        (N,), at the even times.

    Notes
    -----
    ``SLOPE_NEIGHBOURS`` trades noise against the curvature of the trace. Test:
    ``tests/rig/test_check_clock.py`` (compensation loses little).
    """
    if sampling.jitter_s is None or not name.endswith("_degC"):
        return values
    jitter_s = sampling.jitter_s[rows]
    time_s = sampling.time_s[rows]
    width = 2 * SLOPE_NEIGHBOURS + 1
    t = sliding_window_view(np.pad(time_s + jitter_s, SLOPE_NEIGHBOURS, mode="edge"), width)
    y = sliding_window_view(np.pad(values, SLOPE_NEIGHBOURS, constant_values=np.nan), width)
    used = np.isfinite(y)
    count = np.maximum(used.sum(axis=1), 1)
    t = _subtract_means(np.where(used, t - time_s[:, None], 0.0), used, count)
    y = _subtract_means(np.where(used, y, 0.0), used, count)
    slope_numerator = (t * y).sum(axis=1)
    slope_denominator = np.maximum((t * t).sum(axis=1), 1e-300)
    return values - jitter_s * slope_numerator / slope_denominator


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


def scale_jitter(sampling: Sampling, sample: pd.DataFrame) -> Sampling:
    """Keep that share of the jitter that the temperatures confirm, and report it.

    The remaining share belongs to the stamps only, not to the samples.

    Parameters
    ----------
    sampling
        Sampling of the log.
    sample
        Cleaned columns; the index holds the rows of the file.
    """
    if sampling.jitter_s is None:
        return sampling
    names = [name for name in sample if str(name).endswith("_degC")]
    rows = sample.index.to_numpy()
    share = _real_jitter_share(sample[names].to_numpy(), rows, sampling, sampling.jitter_s)
    finding = info(
        "time.strays",
        subject="time_s",
        stray_s=float(np.std(sampling.jitter_s)),
        percent=100 * share,
        rate_Hz=1 / sampling.dt_s,
    )
    return replace(
        sampling,
        jitter_s=share * sampling.jitter_s,
        findings=(*sampling.findings, finding),
    )


def _real_jitter_share(
    columns: Array, rows: NDArray[np.int64], sampling: Sampling, jitter_s: Array
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
    sampling
        Sampling of the log.
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
    grid = sampling.grid[rows]
    is_contiguous = (grid[2 * half :] - grid[: -2 * half] == 2 * half) & (
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
        predicted = slope[used] / sampling.dt_s * jitter_difference[used]
        variance = max(sd, 1e-9) ** 2
        numerator += float(np.sum(predicted * difference[used])) / variance
        denominator += float(np.sum(predicted**2)) / variance
    return min(max(numerator / denominator, 0.0), 1.0)


def _grid_indices(step: Array, dt_s: float) -> NDArray[np.int32]:
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


def _interval_s(time: Array, grid: NDArray[np.int32]) -> float:
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


def sample_interval_s(time_s: Array) -> float:
    """Sampling interval [s] of even times (N,).

    The mean step is used: stamps may be rounded, and then the median of the steps is rounded, too.

    >>> round(75 * sample_interval_s(np.round(np.arange(10.0) / 75, 3)), 9)
    1.0
    """
    return float(time_s[-1] - time_s[0]) / (len(time_s) - 1)


def _even_times(time: Array, grid: NDArray[np.int32], dt_s: float) -> tuple[Array, float]:
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


def _fill_missing(time: Array, location: SampleLocation) -> tuple[Array, list[Finding]]:
    """Interpolate up to three single missing stamps; InputError for more, or for two in a row.

    Parameters
    ----------
    time
        Times as logged (N,) [s].
    location
        Position of the rows in the file, for messages.

    Returns
    -------
    time
        (N,) without missing values.
    findings
        An info if a stamp was interpolated.
    """
    missing = ~np.isfinite(time)
    if not missing.any():
        return time, []
    first = int(np.argmax(missing))
    count = int(missing.sum())
    at_an_end = missing[0] or missing[-1]
    if count > 3 or at_an_end or (missing[1:] & missing[:-1]).any():
        raise InputError(
            f"{location.at('time_s', first)}: {count} times are missing",
            where=location.where,
            expected="a time in each row",
        )
    index = np.arange(len(time))
    time = np.interp(index, index[~missing], time[~missing])
    return time, [info("time.filled", subject="time_s", row=location.row(first), count=count)]
