"""Clocks and counters written as one number: 100559 for 10:05:59, 20211126100559 with its date.

Read as numbers of seconds, such a column has minutes of 100 s and a gap after each 59. A counter
of few bits starts again at zero, and a fraction may have lost its zeros (1.5 for 1.005). Used by
``tcdyn.io.times``; guarded by ``tests/io/test_clock_numbers.py``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tcdyn.core import Array

# Seconds per unit of the last two digits, by the unit as a header or a user states it
CLOCK_UNITS = {"hhmm": 60.0, "hhmmss": 1.0}
# The same of clocks with a date, whose digits tell them: 202111261005, 20211126100559
DATED_UNITS = {"yyyymmddhhmm": 60.0, "yyyymmddhhmmss": 1.0}
FIRST_YEAR, LAST_YEAR = 1970, 2099
# Numbers at which a counter of 16 or 32 bits starts again, also where it is divided to seconds.
# Runs of 65.5 s are common, so 2^16 ms in seconds is not among them.
COUNTER_ENDS = {
    "2^16": 2.0**16,
    "2^32": 2.0**32,
    "2^32/1000": 2.0**32 / 1e3,
    "2^32/1e6": 2.0**32 / 1e6,
}
# A step over the end of a counter is at most so many usual ones, as rows may be lost. By judgement.
LONGEST_STEP_OVER_END = 3.0
# Share of the whole seconds in which the time must fall, where fractions have lost their zeros.
SECONDS_WITH_FALL = 0.5
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

    Numbers with a date are "YYYYMMDDHHMM" or "YYYYMMDDHHMMSS".

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
    >>> clock_unit(np.array([20211126100558.0, 20211126100559, 20211126100600]))
    'YYYYMMDDHHMMSS'
    """
    numbers = values[np.isfinite(values)]
    if len(numbers) >= 3 and numbers.min() >= FIRST_YEAR * 1e8:
        return _dated_unit(numbers)
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


def _dated_unit(numbers: Array) -> str:
    """Unit of numbers that all are a date and a clock; empty for other numbers."""
    for unit in DATED_UNITS:
        if np.isfinite(seconds_of_stamp(numbers, unit)).all():
            return unit.upper()
    return ""


def seconds_of_stamp(values: Array, unit: str) -> Array:
    """Times (N,) [s] since 1970 of numbers such as 20211126100559; NaN where they are no stamp.

    >>> seconds_of_stamp(np.array([19700102000001.0, 19701302000001.0]), "YYYYMMDDHHMMSS")
    array([86401.,    nan])
    """
    has_seconds = DATED_UNITS[unit.lower()] == 1.0
    with_seconds = values if has_seconds else 100 * values
    whole = np.floor(with_seconds / 1e6)
    of_day = with_seconds - 1e6 * whole
    year = np.floor(whole / 1e4)
    month = np.floor(whole / 100) % 100
    day = whole % 100
    is_date = (year >= FIRST_YEAR) & (year <= LAST_YEAR)
    is_date &= (month >= 1) & (month <= 12) & (day >= 1) & (day <= 31)
    is_stamp = is_date & (of_day < LATEST_HHMMSS)
    n_months = np.where(is_date, 12 * (year - FIRST_YEAR) + month - 1, 0).astype(np.int64)
    first_days = n_months.astype("datetime64[M]").astype("datetime64[D]").astype(float)
    times_s = SECONDS_PER_DAY * (first_days + day - 1) + seconds_of_day(of_day, "HHMMSS")
    return np.where(is_stamp, times_s, np.nan)


def cause_of_fall(values: Array) -> tuple[str, str]:
    """Cause and remedy where numbers of a time column fall; two empty texts if none is clear.

    Parameters
    ----------
    values
        Times (N,) as in the file.

    Examples
    --------
    >>> cause_of_fall(np.array([64000.0, 65000, 464, 1464]))[0]
    'its numbers start again after 65000 with 464: a counter that ends at 2^16'
    >>> cause_of_fall(np.array([0, 0.5, 0.1, 0.15, 1.0, 1.5, 1.1, 1.15, 2.0]))[0]
    'its numbers fall within each second (0.5, then 0.1): fractions without their leading zeros'
    """
    numbers = values[np.isfinite(values)]
    steps = np.diff(numbers)
    falls = np.flatnonzero(steps < 0)
    if not len(falls) or not (steps > 0).any():
        return "", ""
    before = float(numbers[falls[0]])
    after = float(numbers[falls[0] + 1])
    usual = float(np.median(steps[steps > 0]))
    for name, end in COUNTER_ENDS.items():
        over_end = steps[falls] + end
        is_over = (over_end > 0) & (over_end <= LONGEST_STEP_OVER_END * usual)
        if is_over.all() and numbers.max() < end:
            cause = (
                f"its numbers start again after {before:.10g} with {after:.10g}: a counter that "
                f"ends at {name}"
            )
            return cause, f"add {end:.10g} to the times from there on"
    if lost_zeros(numbers):
        cause = (
            f"its numbers fall within each second ({before:.10g}, then {after:.10g}): fractions "
            "without their leading zeros"
        )
        return cause, "write fractions of a second with all digits, 1.005 and not 1.5"
    return "", ""


def lost_zeros(times: Array) -> bool:
    """Whether times (N,) fall within most whole seconds, and never from one to another."""
    falls = np.flatnonzero(np.diff(times) < 0)
    whole = np.floor(times)
    if len(falls) < 2 or (whole[falls] != whole[falls + 1]).any():
        return False
    n_seconds = len(np.unique(whole))
    return len(np.unique(whole[falls])) >= max(2.0, SECONDS_WITH_FALL * n_seconds)


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
