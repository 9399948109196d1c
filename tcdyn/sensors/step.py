"""The step in a record of a sensor: where it begins, its size, and the rows to fit.

``tcdyn.sensors.plunge`` uses it; ``tests/sensors/test_sensor_plunge.py`` checks it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter
from scipy.stats import median_abs_deviation

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.sensors.step_fits import white_noise_K

MIN_STEP_NOISES = 20.0  # least step over the white noise; chosen by judgement
# Least number of readings: lag, entry, both levels and the noise, and as many to see a misfit
MIN_SAMPLES = 10
MIN_RISES_AFTER = 2.5  # least record after the step, in times to 63.2 %; chosen by judgement
MIN_ROWS_AROUND = (20, 30)  # least rows before the entry, and after it, to fit; by judgement
# Rows from which a level is taken: a 50th of the record and at least so many; by judgement.
LEVEL_PARTS = 50
MIN_LEVEL_ROWS = 3
# First half-width of the means whose slope is searched, a 400th of the record; by judgement.
SLOPE_PARTS = 400
TIME_CONSTANT_SHARE = 0.632  # share of the step that one lag reaches after its time constant
# Part of the record in which no other event is searched, in times to 63.2 % after the entry, the
# part before the entry as a share of it, and the longest part that is fitted; by judgement.
RISES_AFTER = 12.0
BEFORE_SHARE = 0.5
MOST_RISES_AFTER = 60
# A later change of this share of the step is another event and ends the record; by judgement.
NEXT_EVENT_SHARE = 0.15
# Changes below it are not another event, in standard deviations of the white noise: 8 between two
# rows occur once in 1e8 pairs.
NEXT_EVENT_NOISES = 8.0
RETURN_WINDOW = 5  # rows of the running median in which a return is searched; by judgement
MIN_RETURN_PEAK = 30.0  # least change, in standard deviations of that median, that can be reversed
# A change that goes back, and is smaller than this share of the largest later one, is not the step
# but an earlier event, such as a splash; by judgement.
MAIN_STEP_SHARE = 0.5
# Of several changes the first one that has this share of the steepest slope is the step, so that a
# sensor that is taken out as fast as it was put in gives the entry; by judgement.
STEEP_SHARE = 0.5
# Share of the change, and standard deviations of the white noise, by which a row may differ from a
# level that it belongs to; by judgement.
LEVEL_SHARE = 0.02
LEVEL_NOISES = 5.0
MAX_ROWS_IN_RISE = 300  # rows in the time to 63.2 %; more are averaged in blocks; by judgement


@dataclass(frozen=True)
class Step:
    """The step in a record.

    Attributes
    ----------
    first, last
        Rows to fit.
    entry_s
        First guess of the entry, from the first row of the record [s].
    size_K
        First guess of the step.
    rise_s
        First guess of the time to 63.2 %.
    before_degC
        Reading before the step.
    has_next_event
        Whether the reading changes again at ``last``.
    earlier_K
        Change of the reading in an event before ``first``, such as a splash; 0 without one.
    """

    first: int
    last: int
    entry_s: float
    size_K: float
    rise_s: float
    before_degC: float
    has_next_event: bool = False
    earlier_K: float = 0.0


def find_step(y: Array, dt_s: float, entry_s: float | None = None, unit: str = "K") -> Step:
    """Find where the first steep change of ``y`` (N,) begins, and where the next event ends it.

    Parameters
    ----------
    y
        Readings [degC], NaN where missing.
    dt_s
        Interval [s].
    entry_s
        Entry from the first row [s]; None: found.
    unit
        Unit of differences of ``y``, for the message.

    Returns
    -------
    Step
        The step and the rows to fit.

    Raises
    ------
    InputError
        Where there is no step, or where it is cut off.

    Notes
    -----
    The fitted part ends before the next event.
    ``tests/sensors/test_sensor_plunge.py`` checks the start and the errors.
    """
    finite = np.isfinite(y)
    if finite.sum() < MIN_SAMPLES:
        raise InputError(f"only {int(finite.sum())} samples", expected=f"at least {MIN_SAMPLES}")
    filled = np.interp(np.arange(len(y)), np.flatnonzero(finite), y[finite])
    noise = white_noise_K(y)
    edge = max(len(y) // LEVEL_PARTS, MIN_LEVEL_ROWS)
    begin = 0
    earlier_K = 0.0
    while True:
        if entry_s is None:
            start = begin + _step_start(filled[begin:], noise, edge)
        else:
            start = int(np.clip(round(entry_s / dt_s), 0, len(y) - 2))
        before_rows = slice(max(start - 5 * edge, begin), max(start, begin + 1))
        before = float(np.median(filled[before_rows]))
        change = filled[start:] - before
        rows_to_return = _rows_to_return(change, _noise_of_median(filled[before_rows], noise))
        end = start + rows_to_return
        largest = float(np.abs(change[:rows_to_return]).max())
        later = float(np.abs(change[rows_to_return:]).max(initial=0.0))
        if entry_s is not None or largest >= MAIN_STEP_SHARE * later:
            break
        begin = end
        earlier_K = largest
    level_rows = slice(max(end - 3 * edge, start + 1), end)
    after = float(np.median(filled[level_rows]))
    size = after - before
    if abs(size) < MIN_STEP_NOISES * noise:
        raise InputError(
            f"no step: the reading changes by {abs(size):.3g} {unit}, "
            f"its noise is {noise:.2g} {unit}",
            expected=f"at least {MIN_STEP_NOISES:g} times the noise",
        )
    share = (filled[start:end] - before) / size
    rise = max(int(np.argmax(share >= TIME_CONSTANT_SHARE)), 2)
    rows_after = end - start
    if rows_after < MIN_RISES_AFTER * rise:
        what = "record ends" if end == len(y) else "reading changes again"
        raise InputError(
            f"the {what} {rows_after * dt_s:.3g} s after the step, which is not over",
            expected="five time constants after the step",
        )
    rows_before = max(int(BEFORE_SHARE * RISES_AFTER * rise), MIN_ROWS_AROUND[0])
    first = max(start - rows_before, begin)
    rows, has_event = _rows_to_fit(filled[start:end], rise, abs(size))
    has_event |= start + rows == end < len(y)
    return Step(first, start + rows, start * dt_s, size, rise * dt_s, before, has_event, earlier_K)


def _rows_to_return(change: Array, noise: float) -> int:
    """Return the number of rows until the reading goes back, as that of a sensor taken out again.

    Parameters
    ----------
    change
        Readings from the entry on less the level before (N,) [K].
    noise
        Noise of the median of ``RETURN_WINDOW`` rows [K].

    Returns
    -------
    int
        The rows before the return begins; all where the reading does not go back.
    """
    smooth = median_filter(change, RETURN_WINDOW)
    size = np.abs(smooth)
    sign = np.sign(smooth[np.argmax(size >= 0.5 * size.max())])
    peak = np.maximum.accumulate(sign * smooth)
    fall = peak - sign * smooth
    limit = np.maximum(NEXT_EVENT_SHARE * peak, NEXT_EVENT_NOISES * noise)
    returns = (fall > limit) & (peak >= MIN_RETURN_PEAK * noise)
    if not returns.any():
        return len(change)
    first = int(np.argmax(returns))
    at_level = fall[:first] <= LEVEL_SHARE * peak[:first] + LEVEL_NOISES * noise
    return int(np.flatnonzero(at_level)[-1]) + 1 if at_level.any() else first


def _noise_of_median(level: Array, noise: float) -> float:
    """Return the noise of the median of ``RETURN_WINDOW`` rows [K].

    Parameters
    ----------
    level
        Readings before the step (N,) [degC]; they have hum and other noise that is not white.
    noise
        White noise [K].
    """
    white = noise * float(np.sqrt(0.5 * np.pi / RETURN_WINDOW))
    if len(level) < 2 * RETURN_WINDOW:
        return white
    medians = median_filter(level, RETURN_WINDOW)
    return max(white, float(median_abs_deviation(medians, scale="normal")))


def _rows_to_fit(after: Array, rise: int, size: float) -> tuple[int, bool]:
    """Return the number of rows after the entry that are fitted, and whether an event ends them.

    Parameters
    ----------
    after
        Readings from the entry on (N,) without gaps [degC].
    rise
        Rows to 63.2 %.
    size
        Size of the step [K].

    Returns
    -------
    int, bool
        The rows until the next event, at most those of ``MOST_RISES_AFTER``; whether there is one.
    """
    count = max(int(RISES_AFTER * rise), MIN_ROWS_AROUND[1])
    after = after[: MOST_RISES_AFTER * rise + count]
    if count >= len(after):
        return len(after), False
    level = float(np.median(after[count // 2 : count]))
    departs = np.abs(median_filter(after[count:], 3) - level) > NEXT_EVENT_SHARE * size
    if not departs.any():
        return len(after), False
    return count + int(np.argmax(departs)), True


def _step_start(filled: Array, noise: float, edge: int) -> int:
    """Return the last row before the first steep change that is within the noise of the level.

    Parameters
    ----------
    filled
        Readings (N,) without gaps.
    noise
        White noise [K].
    edge
        Rows at the ends from which the levels are taken.

    Returns
    -------
    int
        The row; 0 where all rows before the change are outside the noise.

    Notes
    -----
    The slope is that of means over as many rows as it needs to exceed its noise.
    Within the noise: below ``LEVEL_NOISES`` standard deviations of a mean, or ``LEVEL_SHARE`` of
    the change if that is more.
    """
    half = max(len(filled) // SLOPE_PARTS, 1)
    while True:
        window = 2 * half + 1
        mean = np.convolve(filled, np.ones(window) / window, mode="valid")
        slope = np.abs(mean[2 * half :] - mean[: -2 * half])
        is_steep = slope >= NEXT_EVENT_NOISES * noise / np.sqrt(window)
        if is_steep.any() or 2 * half > edge:
            break
        half *= 2
    is_steep &= slope >= STEEP_SHARE * slope.max()
    first = int(np.argmax(is_steep))
    after_first = np.flatnonzero(~is_steep[first:])
    last = first + int(after_first[0]) if is_steep.any() and len(after_first) else len(slope)
    steep = first + int(np.argmax(slope[first:last])) + 2 * half
    sign = np.sign(filled[min(steep + half, len(filled) - 1)] - filled[max(steep - half, 0)])
    level = float(np.median(filled[: max(steep - 2 * half, edge)]))
    rise = sign * (filled[: steep + 1] - level)
    change = float(np.max(np.abs(median_filter(filled[steep:], window) - level)))
    limit = max(LEVEL_NOISES * noise / np.sqrt(window), LEVEL_SHARE * change)
    below = np.flatnonzero(rise < limit)
    return int(below[-1]) if len(below) else 0


def block_means(y: Array, block: int) -> Array:
    """Return the means of blocks of rows, NaN where a block has no reading.

    Parameters
    ----------
    y
        Readings (N,), NaN where missing.
    block
        Rows in a block.

    Returns
    -------
    array
        Means (N // block,).
    """
    blocks = y[: len(y) // block * block].reshape(-1, block)
    counts = np.isfinite(blocks).sum(axis=1)
    sums = np.nansum(blocks, axis=1)
    return np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)
