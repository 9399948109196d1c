"""Implausible readings: out of range, overload and drop-out codes, changes too fast for a chain.

Used by :mod:`tcdyn.series.reading` for any table, by
:mod:`tcdyn.smoothing.record` and by live compensation. Tests: ``tests/series/test_plausible.py``.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tcdyn.core import Array, Flags

# Range of a thermocouple [degC]: absolute zero, and above type C, the highest standardised one,
# which ends at 2315 degC (ASTM E230); 3000 allows other sensors.
LOWEST_DEGC = -273.15
HIGHEST_DEGC = 3000.0
# A reading of any quantity is an overload code beyond this multiple of the usual size of its
# column: 9.9E37 and 9.91E37 (SCPI), 9E9, 1E38. Decades of real signals differ by less.
OVERLOAD_RATIO = 1e6
# Standard deviations of the noise that a change between two samples may contain. By judgement.
NOISE_ALLOWANCE = 10.0
# Share of the smallest impossible change from which a change separates segments: the first half of
# a spike may be smaller than its return. Chosen by judgement.
BORDER_SHARE = 0.3
# Coarsest step of a temperature logger [K]. Chosen by judgement.
COARSEST_K = 5.0
# Quantile of the steps that determines the noise: four of five steps may be faulty or fast.
QUIET_SHARE = 0.2
# That quantile of |difference of two samples| of white noise over its standard deviation.
QUIET_QUANTILE = 0.3583
# A drop-out code differs from all other readings by more than this share of their range, and by
# more than this number of steps of the logger. Chosen by judgement.
CODE_DISTANCE = 0.1
CODE_STEPS = 5.0
# It occurs in runs of at most this median length, unless its distance exceeds the range of the
# other readings; a code, rather than a state of the process, occurs in at least this number of
# runs.
CODE_RUN = 3
CODE_RUNS = 3
# A temperature goes on after a run of a code as before it: it has changed by less than this share
# of the jump to the code. A process that jumps to another state and back has other readings there.
BRIDGE_SHARE = 0.25
# Longest run of a value far beyond the others that is a code: a longer one is a state, such as a
# pump that is off. Of another quantity than a temperature it occurs in ``CODE_RUNS`` runs at least.
# By judgement; a warning names what is left out.
LONGEST_FAR_RUN = 50
LARGEST_CODE_SHARE = 0.5  # of the readings: more are the state, and the others the exception
# Fewest different readings of the rest of the column: a switch or a relay has no drop-out codes.
MIN_DIFFERENT_READINGS = 10
# Most different codes in one column. Chosen by judgement.
MAX_CODES = 4


def out_of_range(values_degC: Array) -> Flags:
    """Whether readings lie outside the physical range of a thermocouple; False for NaN.

    Parameters
    ----------
    values_degC : array of shape (N,)
        Readings [degC].

    Returns
    -------
    flags
        (N,).

    Examples
    --------
    >>> out_of_range(np.array([-385.0, 20.0, np.nan, 9.9e37]))
    array([ True, False, False,  True])
    """
    return (values_degC < LOWEST_DEGC) | (values_degC > HIGHEST_DEGC)


def overload_limit(values: Array) -> float:
    """Magnitude above which values of a column in any unit are overload codes.

    Parameters
    ----------
    values : array of shape (N,)
        Readings in any unit, NaN where missing.

    Returns
    -------
    float
        A million times the usual size of the values.

    Notes
    -----
    The usual size is the median, or a thousandth of the 90 % quantile, and at least 1, so
    that a code is above 1e6 in any unit. A smaller ``OVERLOAD_RATIO`` would flag signals over many
    decades. Test: ``tests/series/test_plausible.py``.
    """
    size = np.abs(values)
    finite = size[np.isfinite(size)]
    if len(finite) == 0:
        return np.inf
    usual = max(float(np.median(finite)), 1e-3 * float(np.quantile(finite, 0.9)))
    return OVERLOAD_RATIO * max(usual, 1.0)


def dropout_codes(values: Array, is_temperature: bool = False) -> Flags:
    """Whether readings are drop-out codes: one isolated value that recurs (0, 2300, -200, 9999).

    A code is the smallest or the largest value of the column, is isolated from the other readings,
    occurs in short runs with other readings on both sides, and is repeated exactly.

    Parameters
    ----------
    values : array of shape (N,)
        Readings in any unit, NaN where missing.
    is_temperature
        Whether they are temperatures: a thermocouple does not jump and come back, so that longer
        runs are codes where the readings go on after them as before.

    Returns
    -------
    flags
        (N,).

    Notes
    -----
    Test: ``tests/series/test_plausible.py``: states of a process are no codes, repeated codes in a
    plunge are found. Check both when a ``CODE_`` constant changes.

    Examples
    --------
    >>> y = 800 + np.sin(np.arange(100.0))
    >>> y[[10, 30, 31, 60]] = 0.0
    >>> np.flatnonzero(dropout_codes(y))
    array([10, 30, 31, 60])
    """
    codes = np.zeros(len(values), dtype=bool)
    for _ in range(MAX_CODES):
        remaining = np.where(codes, np.nan, values)
        finite = remaining[np.isfinite(remaining)]
        if len(finite) < MIN_DIFFERENT_READINGS:
            break
        is_code = _dropout_mask(remaining, float(finite.min()), is_temperature)
        if not is_code.any():
            is_code = _dropout_mask(remaining, float(finite.max()), is_temperature)
        if not is_code.any():
            break
        codes |= is_code
    return codes


def _dropout_mask(values: Array, candidate: float, is_temperature: bool) -> Flags:
    """Where ``candidate``, an extreme of the column, is a drop-out code.

    Parameters
    ----------
    values
        Readings (N,), NaN where missing.
    candidate
        Smallest or largest value of the column.
    is_temperature
        As for ``dropout_codes``.

    Returns
    -------
    flags
        (N,), all False if it is no code.
    """
    none = np.zeros(len(values), dtype=bool)
    equal = values == candidate
    others = values[np.isfinite(values) & ~equal]
    if len(others) < MIN_DIFFERENT_READINGS:
        return none
    spread = float(np.ptp(others))
    distance = float(np.min(np.abs(others - candidate)))
    if distance <= min(CODE_DISTANCE, 1.0) * spread:
        return none
    different = np.unique(others)
    if len(different) < MIN_DIFFERENT_READINGS:
        return none
    if distance < CODE_STEPS * float(np.min(np.diff(different))):
        return none
    present = equal[np.isfinite(values)]
    edges = np.flatnonzero(np.diff(np.concatenate([[0], present.astype(np.int8), [0]])))
    starts = edges[::2]
    ends = edges[1::2]
    lengths = ends - starts
    inside = (starts > 0) & (ends < len(present))
    if not inside.any():
        return none
    is_short = int(lengths.max()) <= LONGEST_FAR_RUN
    far_beyond = (
        distance > spread and is_short and len(lengths) >= (1 if is_temperature else CODE_RUNS)
    )
    short_runs = (
        np.median(lengths) <= CODE_RUN
        and len(lengths) >= CODE_RUNS
        and distance > CODE_DISTANCE * spread
    )
    if is_temperature and int(inside.sum()) >= CODE_RUNS:
        readings = values[np.isfinite(values)]
        before = readings[starts[inside] - 1]
        after = readings[ends[inside]]
        goes_on = np.abs(after - before) < BRIDGE_SHARE * np.abs(before - candidate)
        is_rare = np.count_nonzero(present) < LARGEST_CODE_SHARE * len(present)
        short_runs |= bool(is_rare and distance > CODE_DISTANCE * spread and goes_on.all())
    is_code = short_runs or (far_beyond and len(lengths) == inside.sum())
    return equal if is_code else none


def impossible_changes(
    values_degC: Array, dt_s: float, lag_s: float, direct_share: float = 0.0
) -> Flags:
    """Samples that no physical input could have produced through a chain, given the others.

    Through a lag tau the reading approaches its input: y(t + d) = y(t) + (1 - exp(-d/tau)) (x -
    y(t)), x a mean of the input over d. With x between ``LOWEST_DEGC`` and ``HIGHEST_DEGC`` this
    bounds every change. Where a change is larger, one of its sides is not a reading of the sensor.
    The record is divided there and at other large changes; of all subsets of the segments in which
    every segment can follow the one before, the one with most samples is used.

    Parameters
    ----------
    values_degC : array of shape (N,)
        Readings at even times [degC], NaN where missing.
    dt_s : float
        Sampling interval [s].
    lag_s : float
        The largest lag of the chain [s]. Lags commute, so it may be taken as the last one.
    direct_share : float
        Share of a change of the input that the chain passes at once (a zero: zero/lag).

    Returns
    -------
    array of shape (N,)
        True where a reading is rejected.

    Notes
    -----
    A larger ``direct_share`` or a shorter lag allows larger changes. Test:
    ``tests/series/test_plausible.py``: no reading of a physical input is rejected.
    """
    out = np.zeros(len(values_degC), dtype=bool)
    index = np.flatnonzero(np.isfinite(values_degC))
    if len(index) < 3 or not lag_s > 0 or direct_share >= 1:
        return out
    y = values_degC[index]
    allowance = _noise_allowance(y)

    def possible(first: Array, second: Array, interval_s: Array) -> Flags:
        """Whether ``second`` can follow ``first`` after ``interval_s`` [s]; shapes broadcast."""
        share = direct_share + (1 - direct_share) * -np.expm1(-interval_s / lag_s)
        low = first + share * (LOWEST_DEGC - first) - allowance
        high = first + share * (HIGHEST_DEGC - first) + allowance
        return (second >= low) & (second <= high)

    is_impossible = ~possible(y[:-1], y[1:], np.diff(index) * dt_s)
    if not is_impossible.any():
        return out
    # a fault may begin with a change that is just possible, and end with one that is not, so that
    # large changes separate segments, too
    change = np.abs(np.diff(y))
    smallest = max(BORDER_SHARE * float(change[is_impossible].min()), allowance)
    breaks = np.flatnonzero(is_impossible | (change > smallest)) + 1
    starts = np.concatenate([[0], breaks])
    ends = np.concatenate([breaks, [len(y)]]) - 1
    # beyond this time any reading of the record can follow any other
    share_needed = max(np.ptp(y) / (y.max() - LOWEST_DEGC), np.ptp(y) / (HIGHEST_DEGC - y.min()))
    memory_s = -lag_s * np.log(max(1 - share_needed, 1e-6))
    is_accepted = _largest_subset(
        index[starts] * dt_s,
        index[ends] * dt_s,
        y[starts],
        y[ends],
        ends - starts + 1,
        memory_s,
        possible,
    )
    for segment in np.flatnonzero(~is_accepted):
        out[index[starts[segment] : ends[segment] + 1]] = True
    return out


def _noise_allowance(y: Array) -> float:
    """Change between two readings that noise and rounding may cause [K].

    The noise is from the quantile ``QUIET_SHARE`` of the changes; ``QUIET_QUANTILE`` belongs to it.

    ``NOISE_ALLOWANCE`` standard deviations of the noise, and two steps of the logger.

    Parameters
    ----------
    y
        Readings (N,) [degC].

    Notes
    -----
    ``QUIET_QUANTILE`` must be changed together with ``QUIET_SHARE``: the absolute value of a
    normal variable of variance 2 is below 0.3583 with the probability 0.2.
    """
    steps = np.abs(np.diff(y))
    noise_sd = float(np.quantile(steps, QUIET_SHARE)) / QUIET_QUANTILE
    moving = steps[steps > 0]
    resolution = min(float(moving.min()), COARSEST_K) if len(moving) else 0.0
    return NOISE_ALLOWANCE * noise_sd + 2 * resolution


def _largest_subset(
    start_s: Array,
    end_s: Array,
    first: Array,
    last: Array,
    size: NDArray[np.int_],
    memory_s: float,
    possible: Callable[[Array, Array, Array], Flags],
) -> Flags:
    """The sequence of segments with most samples in which each can follow the one before.

    Dynamic programming over the segments in time. A segment can follow every segment that ends
    earlier than ``memory_s`` before it.

    Parameters
    ----------
    start_s, end_s
        Times of the first and the last sample of each segment (M,) [s].
    first, last
        Readings there (M,).
    size
        Samples in each segment (M,).
    memory_s
        Time after which any reading can follow any other [s].
    possible
        Whether a reading can follow another after a time.

    Returns
    -------
    flags
        Whether each segment is accepted (M,).

    Notes
    -----
    Segments beyond the memory need no comparison, so the effort grows with the number of segments
    within the memory, not with its square over the record.
    """
    count = len(size)
    best = size.astype(float)
    previous = np.full(count, -1)
    # segments before this one are beyond the memory
    oldest = np.searchsorted(end_s, start_s - memory_s)
    best_old = 0.0
    best_old_segment = -1
    old_done = 0
    for segment in range(1, count):
        while old_done < oldest[segment]:
            if best[old_done] > best_old:
                best_old = float(best[old_done])
                best_old_segment = old_done
            old_done += 1
        near = np.arange(oldest[segment], segment)
        score = best_old
        source = best_old_segment
        if len(near):
            follows = possible(last[near], first[segment], start_s[segment] - end_s[near])
            scores = np.where(follows, best[near], -1.0)
            top = int(np.argmax(scores))
            if scores[top] > score:
                score = float(scores[top])
                source = int(near[top])
        best[segment] += score
        previous[segment] = source
    is_accepted = np.zeros(count, dtype=bool)
    segment = int(np.argmax(best))
    while segment >= 0:
        is_accepted[segment] = True
        segment = int(previous[segment])
    return is_accepted
