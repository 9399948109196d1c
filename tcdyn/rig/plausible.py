"""Readings that no thermocouple can have given, and changes that no input could have produced through a chain."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tcdyn.core import Array, Flags

LOWEST_DEGC = -273.15
# Type C, the highest standardised thermocouple, ends at 2315 degC (ASTM E230); 3000 leaves room for other sensors.
HIGHEST_DEGC = 3000.0
# A reading of any quantity is an overload code beyond so many times the usual size of its column: 9.9E37 and 9.91E37
# (SCPI), 9E9, 1E38. Decades of real signals differ by less.
OVERLOAD_RATIO = 1e6
NOISE_ALLOWANCE = 10.0  # standard deviations of the noise that a change between two samples may add
BORDER_SHARE = 0.3  # of the smallest impossible change: the first half of a spike may be smaller than its return
COARSEST_K = 5.0  # no logger of temperatures has coarser steps
QUIET_SHARE = (
    0.2  # quantile of the steps that tells the noise: four of five steps may be faulty or fast
)
QUIET_QUANTILE = 0.3583  # that quantile of |difference of two samples| of white noise, over its standard deviation
# A drop-out value stands apart from all other readings by more than this share of their range ...
CODE_DISTANCE = 0.1
CODE_STEPS = 5.0  # ... and by more than so many steps of the logger.
# It occurs in runs of at most so many samples (median), unless it lies beyond the range by more than the range.
CODE_RUN = 3
CODE_RUNS = 3  # separate runs that a repeated value must have to be a code rather than a state of the process
DISTINCT = 10  # different readings that the rest of the column must have: a switch or a relay has no drop-outs
MOST_CODES = 4  # different codes in one column


def impossible(values_degC: Array) -> Flags:
    """Whether readings lie outside the physical range of a thermocouple; False for NaN.

    Parameters
    ----------
    values_degC : array of shape (N,)
        Readings [degC].

    Examples
    --------
    >>> impossible(np.array([-385.0, 20.0, np.nan, 9.9e37]))
    array([ True, False, False,  True])
    """
    return (values_degC < LOWEST_DEGC) | (values_degC > HIGHEST_DEGC)


def overload_codes(values: Array) -> Flags:
    """Whether values of a column in any unit are codes for overload: a million times beyond its usual size.

    Parameters
    ----------
    values : array of shape (N,)
        Readings in any unit, NaN where missing.
    """
    size = np.abs(values)
    finite = size[np.isfinite(size)]
    if len(finite) == 0:
        return np.zeros(len(values), dtype=bool)
    usual = max(float(np.median(finite)), 1e-3 * float(np.quantile(finite, 0.9)), 1e-30)
    return np.isinf(size) | (size > OVERLOAD_RATIO * max(usual, 1.0))


def dropout_codes(values: Array) -> Flags:
    """Whether readings are drop-out codes: one value apart from all others that comes and goes (0, 2300, -200, 9999).

    A code is the least or the largest value of the column, lies apart from the other readings, comes in short runs
    with other readings on both sides, and is repeated exactly.

    Parameters
    ----------
    values : array of shape (N,)
        Readings in any unit, NaN where missing.

    Examples
    --------
    >>> y = 800 + np.sin(np.arange(100.0))
    >>> y[[10, 30, 31, 60]] = 0.0
    >>> np.flatnonzero(dropout_codes(y))
    array([10, 30, 31, 60])
    """
    codes = np.zeros(len(values), dtype=bool)
    for _ in range(MOST_CODES):
        remaining = np.where(codes, np.nan, values)
        finite = remaining[np.isfinite(remaining)]
        if len(finite) < DISTINCT:
            break
        candidates = (float(finite.min()), float(finite.max()))
        added = next(
            (mask for mask in (_code(remaining, c) for c in candidates) if mask.any()), None
        )
        if added is None:
            break
        codes |= added
    return codes


def _code(values: Array, candidate: float) -> Flags:
    """Where ``candidate``, an extreme of the column, stands as a drop-out code; nowhere if it is none."""
    none = np.zeros(len(values), dtype=bool)
    equal = values == candidate
    others = values[np.isfinite(values) & ~equal]
    if len(others) < DISTINCT or len(np.unique(others)) < DISTINCT:
        return none
    spread = float(np.ptp(others))
    distance = float(np.min(np.abs(others - candidate)))
    if distance < CODE_STEPS * float(np.min(np.diff(np.unique(others)))):
        return none
    present = equal[np.isfinite(values)]
    edges = np.flatnonzero(np.diff(np.concatenate([[0], present.astype(np.int8), [0]])))
    starts = edges[::2]
    ends = edges[1::2]
    lengths = ends - starts
    inside = (starts > 0) & (ends < len(present))
    if not inside.any():
        return none
    far_beyond = distance > spread
    short_runs = (
        np.median(lengths) <= CODE_RUN
        and len(lengths) >= CODE_RUNS
        and distance > CODE_DISTANCE * spread
    )
    return equal if short_runs or (far_beyond and len(lengths) == inside.sum()) else none


def unreachable(
    values_degC: Array, dt_s: float, lag_s: float, passed_directly: float = 0.0
) -> Flags:
    """Samples that no physical input could have produced through a chain, given the others.

    Through a lag tau the reading moves towards its input: y(t + d) = y(t) + (1 - exp(-d/tau)) (x - y(t)), x a mean of
    the input over d. With x between ``LOWEST_DEGC`` and ``HIGHEST_DEGC`` this bounds every change. Where a change is
    larger, one of its sides is not the sensor's: the record is cut there and at other large changes, and of all
    subsets of the parts in which every part can follow the one before, the one with most samples is kept.

    Parameters
    ----------
    values_degC : array of shape (N,)
        Readings at even times [degC], NaN where missing.
    dt_s : float
        Sampling interval [s].
    lag_s : float
        The largest lag of the chain [s]. Lags commute, so it may be taken as the last one.
    passed_directly : float
        Share of a change of the input that the chain passes at once (a zero: zero/lag).

    Returns
    -------
    array of shape (N,)
        True where a reading is not kept.
    """
    out = np.zeros(len(values_degC), dtype=bool)
    at = np.flatnonzero(np.isfinite(values_degC))
    if len(at) < 3 or not lag_s > 0 or passed_directly >= 1:
        return out
    y = values_degC[at]
    allowance = _noise_allowance(y)

    def possible(first: Array, second: Array, apart_s: Array) -> Flags:
        share = passed_directly + (1 - passed_directly) * -np.expm1(-apart_s / lag_s)
        low = first + share * (LOWEST_DEGC - first) - allowance
        high = first + share * (HIGHEST_DEGC - first) + allowance
        return (second >= low) & (second <= high)

    is_impossible = ~possible(y[:-1], y[1:], np.diff(at) * dt_s)
    if not is_impossible.any():
        return out
    # a fault may begin by a change that is just possible, and end by one that is not: large changes are borders, too
    change = np.abs(np.diff(y))
    is_border = is_impossible | (
        change > max(BORDER_SHARE * float(change[is_impossible].min()), allowance)
    )
    breaks = np.flatnonzero(is_border) + 1
    starts = np.concatenate([[0], breaks])
    ends = np.concatenate([breaks, [len(y)]]) - 1
    # beyond this time any reading of the record can follow any other
    share_needed = max(np.ptp(y) / (y.max() - LOWEST_DEGC), np.ptp(y) / (HIGHEST_DEGC - y.min()))
    memory_s = -lag_s * np.log(max(1 - share_needed, 1e-6))
    kept = _largest_subset(
        at[starts] * dt_s,
        at[ends] * dt_s,
        y[starts],
        y[ends],
        ends - starts + 1,
        memory_s,
        possible,
    )
    for part in np.flatnonzero(~kept):
        out[at[starts[part] : ends[part] + 1]] = True
    return out


def _noise_allowance(y: Array) -> float:
    """What noise and rounding may add to a change between two readings [K]."""
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
    """Which parts are kept: the chain of parts with most samples in which each can follow the one before.

    Dynamic programming over the parts in time; those that end earlier than ``memory_s`` before a part can all be
    followed by it.
    """
    count = len(size)
    best = size.astype(float)
    previous = np.full(count, -1)
    oldest = np.searchsorted(
        end_s, start_s - memory_s
    )  # parts before this one are beyond the memory
    best_old = 0.0
    best_old_part = -1
    old_done = 0
    for part in range(1, count):
        while old_done < oldest[part]:
            if best[old_done] > best_old:
                best_old = float(best[old_done])
                best_old_part = old_done
            old_done += 1
        near = np.arange(oldest[part], part)
        score = best_old
        source = best_old_part
        if len(near):
            follows = possible(last[near], first[part], start_s[part] - end_s[near])
            scores = np.where(follows, best[near], -1.0)
            top = int(np.argmax(scores))
            if scores[top] > score:
                score = float(scores[top])
                source = int(near[top])
        best[part] += score
        previous[part] = source
    kept = np.zeros(count, dtype=bool)
    part = int(np.argmax(best))
    while part >= 0:
        kept[part] = True
        part = int(previous[part])
    return kept
