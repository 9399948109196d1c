"""Clocks written as one number: 100559 for 10:05:59, 1059 for 10:59.

Read as numbers of seconds, such a column has minutes of 100 s and a gap after each 59. Used by
``tcdyn.io.times``; guarded by ``tests/io/test_clock_numbers.py``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tcdyn.core import Array

# Seconds per unit of the last two digits, by the unit as a header or a user states it
CLOCK_UNITS = {"hhmm": 60.0, "hhmmss": 1.0}
SECONDS_PER_DAY = 86400.0
LAST_MINUTE = 59  # of an hour, and second of a minute
LATEST_HHMMSS = 240_000
SMALLEST_HHMMSS = 10_000  # numbers below may be hours and minutes, or minutes and seconds
# A minute or an hour that ends makes a step longer by 40 or 4040. Other jumps are rows that are
# lost; at least this share must be explained by the clock. By judgement: a counter of seconds whose
# every gap ends so does not occur by chance.
MIN_EXPLAINED_JUMPS = 0.9
LEAST_JUMP = 30  # of a number over the usual step; below 40, above the steps of rows that are lost
USUAL_STEP_QUANTILE = 0.25  # rows every 30 min have jumps in every second step


def clock_unit(values: Array) -> str:
    """Unit of numbers that must be a clock: "HHMMSS", "HHMM or HHMMSS", or empty for other numbers.

    Parameters
    ----------
    values
        Numbers (N,), NaN where missing.

    Notes
    -----
    Minutes and seconds never exceed 59, and the number jumps by 40 or 4040 more than usual exactly
    where a minute or an hour ends, so that the times of the clock are even. Without such a jump
    nothing can be told.

    Examples
    --------
    >>> clock_unit(np.array([100557.0, 100558, 100559, 100600, 100601]))
    'HHMMSS'
    >>> clock_unit(np.array([1057.0, 1058, 1059, 1100, 1101]))
    'HHMM or HHMMSS'
    >>> clock_unit(np.array([1057.0, 1058, 1059, 1060, 1061]))
    ''
    """
    numbers = values[np.isfinite(values)]
    if len(numbers) < 3 or numbers.min() < 0 or numbers.max() >= LATEST_HHMMSS:
        return ""
    whole = np.floor(numbers)
    if max((whole % 100).max(), (whole // 100 % 100).max()) > LAST_MINUTE:
        return ""
    step = np.diff(numbers)
    rising = step[step > 0]
    if not len(rising):
        return ""
    usual = float(np.quantile(rising, USUAL_STEP_QUANTILE))
    clock_step = np.diff(seconds_of_day(numbers, "HHMMSS"))
    usual_clock_step = float(np.quantile(clock_step[step > 0], USUAL_STEP_QUANTILE))
    is_jump = step > usual + LEAST_JUMP
    if not is_jump.any():
        return ""
    tolerance = max(1.0, usual_clock_step / 2)
    is_explained = np.abs(clock_step - usual_clock_step) <= tolerance
    if np.mean(is_explained[is_jump]) < MIN_EXPLAINED_JUMPS:
        return ""
    return "HHMMSS" if numbers.max() >= SMALLEST_HHMMSS else "HHMM or HHMMSS"


def seconds_of_day(values: Array, unit: str) -> Array:
    """Times of the day (N,) [s] of numbers such as 1005 (HHMM) or 100500.5 (HHMMSS).

    Numbers with more than 59 minutes or seconds are no clock: NaN.

    >>> seconds_of_day(np.array([1005.0, 1060.0]), "HHMM")
    array([36300.,    nan])
    """
    last_s = CLOCK_UNITS[unit.lower()]
    whole = np.floor(values)
    last = values - 100 * (whole // 100)
    middle = whole // 100 % 100
    first = whole // 10_000
    if last_s > 1:
        middle = whole // 100
        first = np.zeros_like(middle)
    is_clock = (np.floor(last) <= LAST_MINUTE) & ((middle <= LAST_MINUTE) | (last_s > 1))
    times_s = last_s * (last + 60 * middle + 3600 * first)
    return np.where(is_clock, times_s, np.nan)


@dataclass
class Midnights:
    """Days that a clock without dates has passed, from chunk to chunk.

    Attributes
    ----------
    days
        Days so far.
    last_s
        Last time of the day [s].
    """

    days: float = 0.0
    last_s: float = np.nan

    def continued(self, of_day_s: Array) -> Array:
        """Times (N,) [s] that go on after midnight, where the clock falls by over half a day."""
        finite = np.isfinite(of_day_s)
        known_s = of_day_s[finite]
        if not len(known_s):
            return of_day_s
        falls = np.diff(known_s, prepend=self.last_s) < -SECONDS_PER_DAY / 2
        days = self.days + np.cumsum(falls)
        out = np.array(of_day_s, dtype=float)
        out[finite] += SECONDS_PER_DAY * days
        self.days = float(days[-1])
        self.last_s = float(known_s[-1])
        return out
