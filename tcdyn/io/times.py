"""Columns of time: their names and units, and clocks whose stamps are whole units.

Used by :mod:`tcdyn.io.csv_dialect`, ``tcdyn.series.source`` and ``tcdyn.series.frame``.
The stamps themselves are read by :mod:`tcdyn.io.stamps`. A unit is never guessed silently: where
the header states none, only steps that are plausible in seconds are accepted. Guarded by
``tests/io/test_times.py``.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, info
from tcdyn.io.clock_numbers import (
    CLOCK_UNITS,
    DATED_UNITS,
    cause_of_fall,
    clock_unit,
    seconds_of_day,
    seconds_of_stamp,
)
from tcdyn.io.column_names import column_named
from tcdyn.io.unit_names import SECONDS_PER_UNIT, TIME_UNITS, split_unit_text, unit_in

# spellings that name a column of time by themselves: "millis"; "minute" may be a part of a clock
UNIT_NAMES = frozenset(
    spelling
    for spelling, seconds in SECONDS_PER_UNIT.items()
    if seconds <= 1 and len(spelling) > 3 and spelling not in ("second", "seconde")
)
# names of a time column without their unit
TIME_NAMES = re.compile(
    r"t|time[smhjyknq]|hhmm(ss)?|epoch|unix[_ ]?(time([_ ]?stamp)?|epoch)?"
    r"|_?time|times|(time|tm)[_ ]?stamps?|time[_ ]?string|time[_ ]?code|row[_ ]?times"
    r"|x_value"
    r"|date[_ /&-]*(and )?time|datetimes?|time[_ ]?elapsed|elapsed([_ ]?time)?|clock|utc"
    r"|(sample|sampling|scan|log|local|measurement|recording)[_ ]?time|created[_ ]?at"
    r"|zeit|uhrzeit|zeitstempel|zeitpunkt|messzeit|laufzeit|datum[_ /-]*(und )?(uhr)?zeit"
    r"|temps|heure|horodatage|horodate|date[_ /-]*(et )?heure"
    r"|tiempo|hora|fecha[_ /-]*(y )?hora|tempo|ora|data[_ /-]*(e )?(ora|hora)"
    r"|tijd|tijdstip|datum[_ /-]*(en )?tijd|tid|tidspunkt|klokkeslett|aika|czas|čas|idő"
    r"|время|дата[_ /-]*(и )?время|時刻|時間|日時|日付[ /]?(時間|時刻)|时间|日期时间",
    re.IGNORECASE,
)
TEMPERATURE_NAME = "T"  # as a formula writes it; the time is t
_SUFFIX_OF_T = re.compile(r"T[_ ]\w+")  # T_min is a temperature, T [min] a time
# names that distinguish a header from a title, see ``tcdyn.io.csv_dialect.detect_dialect``
TIME_COLUMN_NAMES = ("time_s", "time", "t", "Time", "time_ms", "Time [s]", "Time (s)", "timestamp")
# Without a unit in the header, times are read as seconds only if the time step lies between these
# two. Below, the rate would be above 20 kHz: Excel days at 1 Hz and hours at 75 Hz lie there. Above
# lie milliseconds at 500 Hz and less.
SHORTEST_PLAUSIBLE_STEP_S = 5e-5
LONGEST_PLAUSIBLE_STEP_S = 1.5
# Numbers of days as Excel (from 1900), MATLAB (from year 0) and astronomers (Julian) count them,
# for the years 1968 to 2064. With such a start, a step below 0.1 may be minutes.
DAY_NUMBERS = ((25_000.0, 60_000.0), (718_700.0, 754_000.0), (2_439_800.0, 2_475_000.0))
DAY_STEP = 0.1
EARLIEST_EPOCH_S = 6e8  # seconds since 1970: the year 1989
LATEST_EPOCH_S = 4e9  # seconds since 1970: the year 2096; larger numbers are milliseconds
# Steps that are a round number of seconds in minutes, hours or days, and seldom a round number in
# seconds
ROUND_SECONDS = {
    60.0: (1, 2, 5, 10),
    3600.0: (1, 2, 5, 10, 15, 30),
    86400.0: (1, 2, 5, 10, 15, 30, 60, 300, 600, 900),
}
# Rows in bursts: at least so many bursts; nearly all of one length, after pauses of one length,
# within this share, with steps inside that are shorter than this share of the mean step. An even
# record has no step below half of the mean one. By judgement.
MIN_BURSTS = 4
BURST_SHARE = 0.8
BURST_SPREAD = 0.25
LONGEST_BURST_STEP = 0.2
SAME_STEP = 2e-3  # relative difference of two steps that count as equal: files round their times


@dataclass(frozen=True)
class TimeColumn:
    """The time column of a table and its unit.

    Attributes
    ----------
    name : str
        Name of the column in the file.
    seconds : float or None
        Seconds per unit; None where the header states a unit that is not known.
    is_unit_stated : bool
        Whether the caller, the header or the unit row states the unit. Otherwise seconds are
        assumed, and ``check_step`` tests the assumption.
    unit_text : str
        The unit as the file writes it.
    where : str
        The file, for messages.
    is_guess : bool
        Whether the column was chosen although its name alone does not say that it is the time: one
        letter, a column of clock times with another name, or one of several.
    others : tuple of str
        Other columns that may be the time, such as a counter of milliseconds.
    """

    name: str
    seconds: float | None
    is_unit_stated: bool
    unit_text: str
    where: str
    is_guess: bool = False
    others: tuple[str, ...] = ()

    @property
    def clock_unit(self) -> str:
        """Form of a clock written as one number, such as HHMMSS; empty for any other column."""
        unit = self.unit_text.upper()
        return unit if unit.lower() in (*CLOCK_UNITS, *DATED_UNITS) else ""

    def recognised(self, values: Array, is_clock: bool) -> TimeColumn:
        """The column with its unit, where its first values (N,) show a clock written as numbers.

        Raises
        ------
        InputError
            Where they may be hours and minutes or minutes and seconds, or another unit is stated.
        """
        if is_clock or self.clock_unit:
            return self
        clock_form = clock_unit(values)
        if not clock_form:
            return self
        is_clear = clock_form == "HHMMSS" or clock_form.lower() in DATED_UNITS
        if is_clear and not self.is_unit_stated:
            return replace(self, seconds=1.0, is_unit_stated=True, unit_text=clock_form)
        reason = "its numbers jump where a minute or an hour ends"
        if clock_form.lower() in DATED_UNITS:
            reason = "each of its numbers is a date and a clock"
        stated = f", and not in {self.unit_text!r}" if self.is_unit_stated else ""
        raise InputError(
            f"column {self.name!r}: {reason}: they are clock times ({clock_form}){stated}",
            where=self.where,
            expected="this form as the unit of time",
            remedy="name the unit, {time_unit}",
            parameters={"time_unit": clock_form.partition(" ")[0]},
        )

    def check_bursts(self, times_s: Array) -> None:
        """Raise InputError where rows come in bursts, so that their stamps are times of arrival.

        Parameters
        ----------
        times_s
            The first times of the column (N,) [s].

        Notes
        -----
        Bursts have one number of rows, and pauses of one length between them that are much longer
        than the steps inside. Stamps that are equal inside a burst are those of a coarse clock
        (``tcdyn.series``).
        """
        steps = np.diff(times_s[np.isfinite(times_s)])
        if len(steps) < MIN_BURSTS or steps.min() < 0:
            return
        is_pause = steps > steps.mean()
        rows = np.diff(np.flatnonzero(is_pause))
        inside = steps[~is_pause]
        if len(rows) < MIN_BURSTS or np.median(rows) < 2 or np.median(inside) <= 0:
            return
        pauses = steps[is_pause]
        is_usual = np.abs(rows - np.median(rows)) <= BURST_SPREAD * np.median(rows)
        is_even = np.abs(pauses - np.median(pauses)) <= BURST_SPREAD * np.median(pauses)
        is_short = inside < LONGEST_BURST_STEP * steps.mean()
        if min(is_usual.mean(), is_even.mean(), is_short.mean()) < BURST_SHARE:
            return
        raise InputError(
            f"column {self.name!r}: rows come in bursts of {np.median(rows):.0f}, "
            f"{np.median(inside):.2g} s apart, with pauses of {np.median(pauses):.3g} s: the "
            "stamps are arrival times",
            where=self.where,
            expected="the time at which each row was sampled",
            remedy="log the sampling time, or give the row numbers as the time where the sampling "
            "interval is known; of readings that were taken in bursts, average each burst",
        )

    def findings(self) -> list[Finding]:
        """An info that names the column, if it was guessed."""
        if not self.is_guess:
            return []
        return [info("time.taken", subject=self.name)]

    def in_seconds(self, values: Array, is_clock: bool) -> Array:
        """Times (N,) in seconds; clock stamps, already converted, are returned unchanged.

        Parameters
        ----------
        values
            Times (N,) in the unit of the column.
        is_clock
            Whether the column holds clock stamps.

        Raises
        ------
        InputError
            If the column holds numbers and its unit is not known, or a counter that starts again.
        """
        if is_clock:
            return values
        if self.clock_unit.lower() in DATED_UNITS:
            return seconds_of_stamp(values, self.clock_unit)
        if self.clock_unit:
            return seconds_of_day(values, self.clock_unit)
        if self.seconds is None:
            raise self._unit_request(f"its unit {self.unit_text!r} is not known")
        cause, remedy = cause_of_fall(values)
        if cause:
            raise InputError(
                f"column {self.name!r}: {cause}",
                where=self.where,
                expected="time that rises",
                remedy=remedy,
            )
        return values * self.seconds

    def check_step(self, times_s: Array, is_clock: bool) -> None:
        """Check that the time step is plausible in seconds where no unit is stated.

        Parameters
        ----------
        times_s : array of shape (N,)
            The first times of the column [s].
        is_clock : bool
            Whether the column holds clock stamps, whose unit is known.

        Raises
        ------
        InputError
            If the step may be in another unit, see ``_may_be_seconds``.
        """
        if is_clock or self.is_unit_stated:
            return
        finite = times_s[np.isfinite(times_s)]
        steps = np.diff(finite)
        steps = steps[steps > 0]
        if len(steps) == 0:
            return
        step = float(np.median(steps))
        if not _may_be_seconds(float(finite[0]), step):
            raise self._unit_request(
                f"no unit is stated, and a time step of {step:.4g} may be in any unit",
                _unit_of_epoch(float(finite[0])),
            )

    def _unit_request(self, problem: str, likely: str = "") -> InputError:
        """Error that asks the user for the unit, with the problem and the most likely unit."""
        return InputError(
            f"column {self.name!r}: {problem}",
            where=self.where,
            expected=f"one of {', '.join(TIME_UNITS)}",
            remedy="name the unit, {time_unit}",
            parameters={"time_unit": likely or "UNIT"},
        )


def _unit_of_epoch(start: float) -> str:
    """Unit of a number that counts from 1970, or in days from 1900, year 0 or the Julian epoch."""
    for unit in ("s", "ms", "us", "ns"):
        if EARLIEST_EPOCH_S <= start * SECONDS_PER_UNIT[unit] <= LATEST_EPOCH_S:
            return unit
    return "days" if any(low <= start <= high for low, high in DAY_NUMBERS) else ""


def _may_be_seconds(start: float, step: float) -> bool:
    """Whether a start and a step without a unit are plausible in seconds, and in no other unit.

    Parameters
    ----------
    start
        First time.
    step
        Typical step between times.

    Notes
    -----
    A step that is a round number of seconds in minutes, hours or days (``ROUND_SECONDS``) is
    refused, as is one that comes with a number of days. A wrong acceptance scales all lags; a wrong
    refusal only asks the user for the unit. ``tests/io/test_times.py`` lists steps of both kinds.
    """
    if step < DAY_STEP and any(low <= start <= high for low, high in DAY_NUMBERS):
        return False
    for seconds_per_unit, choices in ROUND_SECONDS.items():
        for seconds in choices:
            if abs(step * seconds_per_unit / seconds - 1) < SAME_STEP:
                return False
    is_plausible_step = SHORTEST_PLAUSIBLE_STEP_S <= step <= LONGEST_PLAUSIBLE_STEP_S
    return is_plausible_step and start < LATEST_EPOCH_S


def is_time_name(name: str) -> bool:
    """Whether the name of a column is one of a time column, with or without its unit.

    A ``T`` is a temperature, unless a unit of time follows in brackets or after "/"; ``t`` is a
    time.

    >>> is_time_name("Uhrzeit"), is_time_name("Time [ms]"), is_time_name("T1")
    (True, True, False)
    >>> is_time_name("t"), is_time_name("T"), is_time_name("T_min"), is_time_name("T [s]")
    (True, False, False, True)
    """
    stem, unit = split_unit(name)
    if stem == TEMPERATURE_NAME:
        is_suffix = _SUFFIX_OF_T.fullmatch(name.strip()) is not None
        return unit.lower() in SECONDS_PER_UNIT and not is_suffix
    return TIME_NAMES.fullmatch(stem) is not None


def has_time_name(name: str, units: Mapping[str, str]) -> bool:
    """Whether a column has the name of a time column; a ``T`` may have its unit in a row of units.

    >>> has_time_name("T", {"T": "s"}), has_time_name("T", {"T": "degC"})
    (True, False)
    """
    is_time_in_row = units.get(name, "").lower() in SECONDS_PER_UNIT
    return is_time_name(name) or (name.strip() == TEMPERATURE_NAME and is_time_in_row)


def time_named(name: str, columns: Collection[str], where: str) -> str:
    """The column of the time that a name with or without its unit means.

    >>> time_named("Zeit", ["Zeit [ms]", "T1"], "log.csv")
    'Zeit [ms]'

    Parameters
    ----------
    name, columns, where
        As for :func:`tcdyn.io.column_names.column_named`, which has the errors.
    """
    return column_named(name, columns, where, role="time column", stem=without_time_unit)


def without_time_unit(column: str) -> str:
    """Name of a column of time without its unit."""
    return split_unit(column)[0]


def find_time_column(
    names: Sequence[str],
    where: str,
    *,
    requested: str | None = None,
    unit: str | None = None,
    unit_row: Mapping[str, str] | None = None,
    clock_columns: Sequence[str] = (),
) -> TimeColumn:
    """Find the time column of a table and its unit.

    Parameters
    ----------
    names : sequence of str
        The columns of the table.
    where : str
        The file, for messages.
    requested : str, optional
        The time column, if its name is not one of a time column.
    unit : str, optional
        The unit as the caller states it; it overrides the header.
    unit_row : mapping, optional
        Units from a row below the header, by column.
    clock_columns : sequence of str, optional
        Columns whose first cell is a clock time, those with a date first.

    Raises
    ------
    InputError
        If no column is found, the requested one is missing, or ``unit`` is not a unit of time.

    Notes
    -----
    The first column with the name of a time column and a known unit or a clock is taken, of several
    clocks with such a name one with a date; then the first column with a clock; then the first one
    with the name of a time column.

    Examples
    --------
    >>> find_time_column(["Time [ms]", "T1"], "log.csv").seconds
    0.001
    >>> find_time_column(["t", "T1"], "log.csv", unit_row={"t": "min"}).seconds
    60.0
    >>> find_time_column(["T", "Moment"], "log.csv", clock_columns=["Moment"]).name
    'Moment'
    """
    if unit is not None and not is_time_unit(unit):
        units_of_time = (*TIME_UNITS, *map(str.upper, CLOCK_UNITS))
        raise InputError(f"time unit {unit!r}", where=where, expected=" or ".join(units_of_time))
    if requested is not None:
        requested = time_named(requested, names, where)
    units = unit_row or {}
    name = requested
    is_guess = False
    if name is None:
        name = _time_column_name(names, units, clock_columns)
        candidates = {n for n in names if has_time_name(n, units) or n in clock_columns}
        is_clear = name is not None and has_time_name(name, units)
        is_guess = len(candidates) > 1 or not is_clear or len(split_unit(name or "")[0]) == 1
    others = tuple(
        other for other in names if other != name and _may_be_time(other, units, clock_columns)
    )
    if name is None:
        raise InputError(
            "no time column found",
            where=where,
            expected=f"one of {', '.join(map(repr, names))}",
            remedy="name it ({time}), or give the sampling interval ({dt_s})",
            parameters={"time": "COLUMN", "dt_s": "SECONDS"},
        )
    written = unit or split_unit(name)[1] or units.get(name, "")
    plain_name = name.strip().lower()
    if not written and (plain_name in CLOCK_UNITS or plain_name in UNIT_NAMES):
        written = name.strip()
    if not written:
        return TimeColumn(name, 1.0, False, "", where, is_guess, others)
    seconds = SECONDS_PER_UNIT.get(written.lower())
    if written.lower() in (*CLOCK_UNITS, *DATED_UNITS):
        seconds = 1.0
    return TimeColumn(name, seconds, True, written, where, is_guess, others)


def _may_be_time(name: str, units: Mapping[str, str], clock_columns: Collection[str]) -> bool:
    """Whether a column may be the time, by its name, its unit or its first cell."""
    has_unit = is_time_unit(split_unit(name)[1]) or name.strip().lower() in UNIT_NAMES
    return has_unit or name in clock_columns or has_time_name(name, units)


def _time_column_name(
    names: Sequence[str], units: Mapping[str, str], clock_columns: Sequence[str]
) -> str | None:
    """The most probable time column; None if no name and no clock tells of one."""
    named = [name for name in names if has_time_name(name, units)]
    for name in named:
        unit = split_unit(name)[1] or units.get(name, "")
        if name in clock_columns:
            return next(clock for clock in clock_columns if clock in named)
        if is_time_unit(unit):
            return name
    clocks = list(clock_columns)
    by_unit = [name for name in names if name.strip().lower() in UNIT_NAMES]
    return next(iter([*clocks, *named, *by_unit]), None)


def is_time_unit(text: str) -> bool:
    """Whether a text is a unit of time, or a form such as HHMM of a clock written as one number.

    >>> is_time_unit("ms"), is_time_unit("HHMM"), is_time_unit("degC")
    (True, True, False)
    """
    return text.lower() in (*SECONDS_PER_UNIT, *CLOCK_UNITS, *DATED_UNITS)


def split_unit(name: str) -> tuple[str, str]:
    """Name of a time column without its unit, and the unit (empty if there is none).

    Text in brackets always is a unit; what follows "/", a comma or "in", or a suffix such as
    ``_ms``, only if it is a known one (a key of ``SECONDS_PER_UNIT``). The unit is as written,
    without a dot at its end. The unit of a quotient, such as l/min, is none of a time.

    >>> split_unit("Time (minutes)"), split_unit("t/ms")
    (('Time', 'minutes'), ('t', 'ms'))
    >>> split_unit("elapsed_time"), split_unit("Time_h")
    (('elapsed_time', ''), ('Time', 'h'))
    >>> split_unit("Time (min.)"), split_unit("time in ticks"), split_unit("flow l/min")
    (('Time', 'min'), ('time in ticks', ''), ('flow l/min', ''))
    """
    stem, unit = split_unit_text(name.strip(), _is_unit_after)
    if unit and unit_in(name).endswith(f"/{unit}"):
        return name.strip(), ""
    return stem, unit.rstrip(".")


def _is_unit_after(text: str, mark: str) -> bool:
    """Whether a text after a mark is the unit of a time; see ``split_unit``."""
    if mark in ("[", "("):
        return True
    if mark in ("_", " "):
        return is_time_unit(text)
    return is_time_unit(text.rstrip("."))
