"""Dates and clock times in the forms that loggers write, as seconds since the first one."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from datetime import date, datetime, timedelta, timezone
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tcdyn.core import Array, Flags
from tcdyn.core.errors import InputError
from tcdyn.io.clock_numbers import lost_zeros

SECONDS_PER_DAY = 86400.0
SECONDS_PER_HOUR = 3600.0
HOURS_OF_HALF_DAY = 12
ORDERS = ("dmy", "mdy", "ymd")  # of day, month and year
# The same in messages.
ORDER_NAMES = {"dmy": "day.month.year", "mdy": "month.day.year", "ymd": "year.month.day"}
# Local hour at which clocks change to or from daylight saving time, between 1 and 3 everywhere
CHANGE_HOURS = (1, 2, 3)
# A step that is an hour too long or too short is a change of the clock if the rest is at most this
# multiple of the step before it; chosen by judgement.
LONGEST_REST = 1.5
# Hours east of Greenwich of the abbreviations that loggers write. Only changes of the offset
# matter, so an abbreviation that other countries use for another zone does no harm.
_ZONES = {
    "Z": 0,
    "UTC": 0,
    "GMT": 0,
    "WET": 0,
    "WEST": 1,
    "BST": 1,
    "CET": 1,
    "MEZ": 1,
    "CEST": 2,
    "MESZ": 2,
    "EET": 2,
    "EEST": 3,
    "JST": 9,
    "EST": -5,
    "EDT": -4,
    "CST": -6,
    "CDT": -5,
    "MST": -7,
    "MDT": -6,
    "PST": -8,
    "PDT": -7,
}
# First letters of the months in English, German, French, Spanish, Italian and Dutch
_MONTHS: tuple[tuple[str, ...], ...] = (
    ("jan", "ene", "gen"),
    ("feb", "fev", "fév"),
    ("mar", "mär", "mrz", "maa", "mrt"),
    ("apr", "avr", "abr"),
    ("may", "mai", "mag", "mei"),
    ("jun", "jui", "giu"),
    ("jul", "juil", "lug"),
    ("aug", "aou", "aoû", "ago"),
    ("sep", "set"),
    ("oct", "okt", "ott"),
    ("nov",),
    ("dec", "déc", "dez", "dic"),
)
_MONTH_BEGINNINGS = "|".join(beginning for names in _MONTHS for beginning in names)
# AM and PM in English, Czech, Polish and Hungarian, as the locales of Windows write them. A file
# read in another encoding has another letter for the "ł".
_AM = r"(?:[Aa]\.?\s?[Mm]\.?|dop\.|przed po\S\.?|de\.)"
_PM = r"(?:[Pp]\.?\s?[Mm]\.?|odp\.|po po\S\.?|du\.)"
DATE_COLUMN_NAMES = (
    "date",
    "datum",
    "fecha",
    "data",
    "jour",
    "dia",
    "giorno",
    "day",
    "tag",
    "dato",
)

_MONTH_NAME = rf"(?i:(?:{_MONTH_BEGINNINGS})[^\W\d_]{{0,8}}\.?)"
_DATE = (
    r"(?:\d{4}[-/.]\d{1,2}[-/.]\d{1,2}"  # 2021-11-26
    r"|\d{1,2}[-/.]\d{1,2}[-/.](?:\d{4}|\d{2})"  # 26.11.2021, 11/26/21
    rf"|\d{{1,2}}[-/ .]{{1,2}}{_MONTH_NAME}[-/ ,]{{1,2}}(?:\d{{4}}|\d{{2}})"  # 26-Nov-2021
    rf"|{_MONTH_NAME}[- ]\d{{1,2}},?[- ]\d{{4}}"  # Nov 26, 2021
    r"|(?:19|20)\d{6})"  # 20211126
)
_WEEKDAY = r"(?:[^\W\d_]{2,10}\.?,?\s+)?"
_ZONE = rf"(?:{'|'.join(_ZONES)}|(?:UTC|GMT)?[+\-−]\d{{1,2}}(?::?\d\d)?)"
# Hours, minutes and seconds, of which each may lose its leading zero: 8:1:0. Of a clock with two
# fields the second has two digits, since 8:1 may be a ratio; see ``_SHORT_CLOCK``.
_CLOCK = (
    r"(?:(?P<days>\d{1,4})(?:[:.]|\s?d(?:ays?)?,?\s?))??"
    r"(?P<hour>\d{1,3}):(?P<minute>\d\d(?=\D|$)|\d(?=:|[.,]\d))(?::(?P<second>\d{1,2}(?!\d)))?"
    r"(?P<fraction>[.,]\d+|:\d{3})?"
    rf"\s?(?P<half>{_AM}|{_PM})?\s?(?P<zone>{_ZONE})?"
)
_STAMP = re.compile(
    rf"\s*'?(?:{_WEEKDAY}(?P<date>{_DATE})(?:[T_:]|,?\s*-?\s+|,))?{_CLOCK}\s*", re.ASCII
)
_STAMP_UNICODE = re.compile(_STAMP.pattern)
# 20211126T095950.5Z and 20211126095950, which is no number of seconds; 202111260959
_COMPACT_STAMP = re.compile(
    r"\s*((?:19|20)\d\d(?:0[1-9]|1[0-2])(?:0[1-9]|[12]\d|3[01]))[T_ ]?"
    r"([01]\d|2[0-3])([0-5]\d)(?:([0-5]\d)([.,]\d+)?)?"
    rf"\s?({_ZONE})?\s*"
)
# 2023-03-07-22-00-00 and 2023-03-07_22-00, as names of files have it
_DASHED_STAMP = re.compile(
    r"\s*((?:19|20)\d\d-\d\d-\d\d)[-_T ]([01]\d|2[0-3])-([0-5]\d)(?:-([0-5]\d)([.,]\d+)?)?"
    rf"\s?({_ZONE})?\s*"
)
# Clocks that are read as such only behind a date: 8:1 is 8:01, 23.59.00 is 23:59:00
_SHORT_CLOCK = re.compile(
    rf"(\s*'?{_WEEKDAY}{_DATE}(?:[T_:]|,?\s*-?\s+|,))"
    r"(\d{1,2})(?::(\d)|\.(\d{1,2})\.(\d{1,2}))((?:[.,]\d+)?(?:\s?[AaPp]\.?[Mm]\.?)?\s*)"
)
_OPEN_ORDER = re.compile(r"\d{1,2}[-/.]\d{1,2}[-/.]")  # the day or the month may be first
_DATE_ONLY = re.compile(rf"\s*'?{_WEEKDAY}({_DATE})\s*")


_Fields = tuple[int, int, int]  # of a date, in the order of the text


class _DateChange(NamedTuple):
    """Two dates of consecutive rows, and the difference of their times of the day [s]."""

    before: _Fields
    after: _Fields
    of_day_s: float


class _Stamp(NamedTuple):
    """Fields of one stamp: the date as text, seconds of the day, seconds east of Greenwich.

    ``first_field`` is the first of two fields without seconds, which are hours and minutes or
    minutes and seconds; -1 for other stamps. ``has_half`` tells of AM or PM.
    """

    date: str
    of_day_s: float
    zone_s: float | None
    first_field: int = -1
    has_half: bool = False


_NO_STAMP = _Stamp("", np.nan, None)


def is_stamp(text: str) -> bool:
    """Whether a cell is a clock time, with or without a date.

    >>> is_stamp("26-Nov-2021 10:00:00.5"), is_stamp("20211126T100000Z"), is_stamp("12.5")
    (True, True, False)
    """
    return _parse_stamp(text) is not _NO_STAMP


def is_date(text: str, column: str = "") -> bool:
    """Whether a cell is a date without a time; eight digits are one in a column named "date".

    >>> is_date("26.11.2021"), is_date("2021-11-26 10:00:00"), is_date("20211126", "Date")
    (True, False, True)
    """
    match = _DATE_ONLY.fullmatch(text)
    if match is None:
        return False
    return not match[1].isdecimal() or column.strip().lower() in DATE_COLUMN_NAMES


def is_time_of_day(text: str) -> bool:
    """Whether a cell is a time of the day without a date.

    >>> is_time_of_day("10:00:00.5"), is_time_of_day("2021-11-26 10:00:00")
    (True, False)
    """
    stamp = _parse_stamp(text)
    return stamp is not _NO_STAMP and not stamp.date


def instants(texts: Sequence[str], column: str, where: str) -> tuple[date, Array, Flags]:
    """Instants of stamps with a date, such as the first and the last of several files.

    Parameters
    ----------
    texts
        The stamps (N,), in about the order of their times.
    column, where
        Column and files, for messages.

    Returns
    -------
    day
        Date of the first stamp.
    instants_s
        Seconds (N,) since the midnight of this day, in UTC where the stamp has a zone. From there,
        and not from a fixed date: microseconds are kept.
    have_zone
        Whether each stamp (N,) has a zone.

    Raises
    ------
    InputError
        For a stamp without a date, and dates such as 03/04/2021 that can be read in two ways.

    Examples
    --------
    >>> instants(["28/02/2026 23:00:00", "01/03/2026 01:00:00"], "time", "log")[:2]
    (datetime.date(2026, 2, 28), array([82800., 90000.]))
    """
    stamps = [_parse_stamp_or_midnight(text) for text in texts]
    for stamp, text in zip(stamps, texts):
        if not stamp.date:
            raise InputError(f"column {column}: {text!r} has no date", where=where)
    dates = [stamp.date for stamp in stamps]
    fields = [_date_fields(text) for text in dates]
    order = "dmy"  # into which _date_fields has put what is clear
    if any(_OPEN_ORDER.match(text) for text in dates):
        different = list(dict.fromkeys(fields))
        has_dots = any("." in text for text in dates)
        order = _date_order(different, has_dots)
        if not order and len(different) > 1 and not has_dots:
            raise _two_ways_error(different[1], column, where)
        order = order or "dmy"
    days = np.array([_day_number(f, order, column, where) for f in fields], dtype=float)
    of_day_s = np.array([stamp.of_day_s for stamp in stamps])
    zones_s = np.array([stamp.zone_s or 0.0 for stamp in stamps])
    have_zone = np.array([stamp.zone_s is not None for stamp in stamps])
    instants_s = SECONDS_PER_DAY * (days - days[0]) + of_day_s - zones_s
    return date.fromordinal(int(days[0])), instants_s, have_zone


def has_fraction(text: str) -> bool:
    """Whether a stamp has a fraction of a second.

    >>> has_fraction("26.11.2021 10:00:00"), has_fraction("10:00:00.5 AM")
    (False, True)
    """
    return re.search(r":\d{1,2}(?:[.,]\d|:\d{3})", text) is not None


def _parse_stamp(text: str) -> _Stamp:
    """Parse a date, a clock time or both; ``_NO_STAMP`` for any other text.

    A clock time with one colon is hours:minutes, but minutes:seconds if it has a fraction. The
    result notes the first field where this is not clear.
    """
    pattern = _STAMP if text.isascii() else _STAMP_UNICODE
    match = pattern.fullmatch(text)
    if match is None:
        short = _SHORT_CLOCK.fullmatch(text)
        if short is None:
            return _parse_compact(text)
        match = pattern.fullmatch(_with_colons(short))
        if match is None:
            return _NO_STAMP
    day, days, hour, minute, second, fraction, half, zone = match.groups()
    part = float("0." + fraction[1:]) if fraction else 0.0
    hours = float(hour)
    if half:
        hours = hours % 12 + (12.0 if re.fullmatch(_PM, half) else 0.0)
    first_field = -1
    if second is not None:
        of_day_s = SECONDS_PER_HOUR * hours + 60 * float(minute) + float(second) + part
    elif fraction:  # minutes:seconds.fraction
        of_day_s = 60 * hours + float(minute) + part
    else:
        of_day_s = SECONDS_PER_HOUR * hours + 60 * float(minute)
        if not day and not half:
            first_field = int(hour)
    if days:
        of_day_s += SECONDS_PER_DAY * float(days)
    return _Stamp(day or "", of_day_s, _zone_s(zone), first_field, bool(half))


def _with_colons(match: re.Match[str]) -> str:
    """The date and clock of a match of ``_SHORT_CLOCK`` with colons and two digits a field."""
    date_text, hour, minute, dotted_minute, second, rest = match.groups()
    if minute is not None:
        return f"{date_text}{hour}:{minute:0>2}{rest}"
    return f"{date_text}{hour}:{dotted_minute:0>2}:{second:0>2}{rest}"


def _parse_compact(text: str) -> _Stamp:
    """The fields of a stamp without marks, or with dashes between all fields."""
    match = _COMPACT_STAMP.fullmatch(text) or _DASHED_STAMP.fullmatch(text)
    if match is None:
        return _NO_STAMP
    day, hour, minute, second, fraction, zone = match.groups()
    part = float("0." + fraction[1:]) if fraction else 0.0
    of_day_s = SECONDS_PER_HOUR * float(hour) + 60 * float(minute) + float(second or 0) + part
    return _Stamp(day, of_day_s, _zone_s(zone))


def _parse_stamp_or_midnight(text: str) -> _Stamp:
    """The fields of a stamp; in a column of stamps a date alone is its midnight.

    R, Excel and others leave out a clock of 00:00:00.
    """
    stamp = _parse_stamp(text)
    if stamp is not _NO_STAMP:
        return stamp
    match = _DATE_ONLY.fullmatch(text)
    return _NO_STAMP if match is None else _Stamp(match[1], 0.0, None)


def _zone_s(zone: str | None) -> float | None:
    """Offset of a zone such as +01:00 or CET from UTC [s]; None without a zone."""
    if not zone:
        return None
    if zone in _ZONES:
        return SECONDS_PER_HOUR * _ZONES[zone]
    digits = re.sub(r"\D", "", zone)
    hours = float(digits[:2] if len(digits) in (2, 4) else digits[:1])
    minutes = float(digits[-2:]) if len(digits) > 2 else 0.0
    sign = -1.0 if "-" in zone or "−" in zone else 1.0
    return sign * (SECONDS_PER_HOUR * hours + 60 * minutes)


def _month(name: str) -> int:
    """Number of a month by its name; the longest beginning that fits decides."""
    fits = []
    for month, beginnings in enumerate(_MONTHS, 1):
        for beginning in beginnings:
            if name.lower().startswith(beginning):
                fits.append((len(beginning), month))
    return max(fits)[1]


@dataclass
class Stamps:
    """Converts stamps to seconds since the first one, in one chunk or in many.

    Attributes
    ----------
    column, where
        Column and file, for messages.
    first_s
        Seconds of the first stamp.
    midnights
        Days counted in a column without dates, where the clock passes midnight.
    clock_changes
        Dates at which a local clock changed to or from daylight saving time.
    assumed
        Order of day, month and year, and a date, where the dates do not decide between several;
        empty otherwise.

    Notes
    -----
    Stamps with a date count days by the calendar. In a column without dates the clock passes
    midnight where it goes back by more than half a day. An offset from UTC is subtracted. In a
    column of local times without an offset, a step that is one hour too short or too long on a
    Sunday night is a change of the clock, and the time continues without it.
    """

    column: str
    where: str
    first_s: float = np.nan
    last_s: float = np.nan
    midnights: float = 0.0
    clock_changes: list[str] = field(default_factory=list)
    assumed: tuple[str, str] = ("", "")
    _dates: list[_Fields] = field(default_factory=list)
    _order: str = ""
    _date_changes: list[_DateChange] = field(default_factory=list)
    _last_date: tuple[_Fields, float] | None = None
    _usual_step_s: float = np.nan
    _is_minutes: bool | None = None
    _last_wall_s: float = np.nan
    _last_step_s: float = np.nan
    _shift_s: float = 0.0
    _last_time_s: float = np.nan

    def seconds(self, texts: Sequence[str]) -> Array:
        """Seconds (N,) since the first stamp of the column; NaN where a cell is no stamp.

        Raises
        ------
        InputError
            If the first stamp cannot be read, dates such as 03/04/2021 can be read in two ways, or
            times such as 10:05 may be minutes and seconds.
        """
        stamps = [_parse_stamp_or_midnight(text) for text in texts]
        of_day = np.array([stamp.of_day_s for stamp in stamps], dtype=float)
        if len(of_day) == 0:
            return of_day
        of_day = self._with_two_fields(of_day, stamps)
        zones = [stamp.zone_s for stamp in stamps]
        has_zone = zones[0] is not None
        zone_s = np.array([zone or 0.0 for zone in zones])
        if np.isnan(self.first_s):
            if not np.isfinite(of_day[0]):
                raise InputError(
                    f"column {self.column}: {texts[0]!r} is no clock time", where=self.where
                )
            self.first_s = float(of_day[0] - zone_s[0])
            self.last_s = float(of_day[0])
        if any(stamp.date for stamp in stamps):
            dates = pd.Series([stamp.date or None for stamp in stamps], dtype="str")
            days, is_sunday = self._days(dates, of_day)
            wall_s = of_day + SECONDS_PER_DAY * days
            if not has_zone:
                wall_s = self._without_clock_changes(wall_s, dates, is_sunday)
        else:
            wall_s = of_day + SECONDS_PER_DAY * self._days_by_midnights(of_day)
        self._check_half_days(wall_s, stamps, texts)
        self._check_fractions(wall_s, texts)
        return np.asarray(np.round(wall_s - zone_s - self.first_s, 9))

    def _check_half_days(
        self, wall_s: Array, stamps: Sequence[_Stamp], texts: Sequence[str]
    ) -> None:
        """Raise InputError where a clock of 12 hours without AM and PM shows itself.

        Parameters
        ----------
        wall_s
            Times of the clock (N,) [s].
        stamps, texts
            Fields and text of each cell.

        Notes
        -----
        From 12:59 to 1:00 the step is half a day less than the usual one; with a date, from 11:59
        in the evening to 12:00 it is a day more. The last time of the chunk before is kept.
        """
        before = np.concatenate([[self._last_time_s], wall_s[:-1]])
        finite = wall_s[np.isfinite(wall_s)]
        if len(finite):
            self._last_time_s = float(finite[-1])
        corrected = wall_s - before + SECONDS_PER_DAY / 2
        is_one_o_clock = np.floor(wall_s % SECONDS_PER_DAY / SECONDS_PER_HOUR) == 1
        was_noon = np.floor(before % SECONDS_PER_DAY / SECONDS_PER_HOUR) == HOURS_OF_HALF_DAY
        is_jump = is_one_o_clock & was_noon & (corrected > 0) & (corrected <= SECONDS_PER_HOUR)
        # with a date, 11:59 in the evening is followed by 12:00 of the next day
        rest = wall_s - before - SECONDS_PER_DAY
        steps = np.diff(finite)
        usual_s = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
        was_eleven = np.floor(before % SECONDS_PER_DAY / SECONDS_PER_HOUR) == HOURS_OF_HALF_DAY - 1
        is_noon = np.floor(wall_s % SECONDS_PER_DAY / SECONDS_PER_HOUR) == HOURS_OF_HALF_DAY
        is_day_ahead = was_eleven & is_noon & (rest > 0) & (rest <= LONGEST_REST * usual_s)
        for k in np.flatnonzero(is_jump | is_day_ahead):
            if stamps[k].has_half:
                continue
            jump = "back by nearly 12 h" if is_jump[k] else "from 11:59 to 12:00 of the next day"
            raise InputError(
                f"column {self.column}: the clock goes {jump}, to {texts[k]!r}: it is a clock of "
                "12 hours without AM and PM",
                where=self.where,
                expected="a clock of 24 hours, or AM and PM",
                remedy="log AM and PM, or write 0 h for the 12 h of midnight and add 12 h to 1:00 "
                "to 11:59 of the afternoon",
            )

    def _check_fractions(self, wall_s: Array, texts: Sequence[str]) -> None:
        """Raise InputError where fractions of a second have lost their leading zeros."""
        finite = np.flatnonzero(np.isfinite(wall_s))
        if not lost_zeros(wall_s[finite]):
            return
        k = int(finite[np.flatnonzero(np.diff(wall_s[finite]) < 0)[0] + 1])
        raise InputError(
            f"column {self.column}: the clock falls within each second, as to {texts[k]!r}: "
            "fractions without their leading zeros",
            where=self.where,
            expected="time that rises",
            remedy="write fractions of a second with all digits, 1.005 and not 1.5",
        )

    def _with_two_fields(self, of_day: Array, stamps: Sequence[_Stamp]) -> Array:
        """Seconds of the day (N,), those of two fields as hours and minutes or minutes and seconds.

        More than 23 in the first field are minutes. Otherwise both are possible.
        """
        first = np.array([stamp.first_field for stamp in stamps])
        if not np.any(first >= 0):
            return of_day
        if self._is_minutes is None:
            if first.max() <= 23:
                raise InputError(
                    f"column {self.column}: times such as {first[first >= 0][0]:02}:.. may be "
                    "hours and minutes or minutes and seconds",
                    where=self.where,
                    expected="hours:minutes:seconds, or a date in the same row",
                    remedy="if another column is the time, name it, {time}",
                    parameters={"time": "COLUMN"},
                )
            self._is_minutes = True
        return np.where(first >= 0, of_day / 60, of_day)

    def _days_by_midnights(self, of_day: Array) -> Array:
        """Days (N,) since the first stamp, from the times of day [s]."""
        filled = pd.Series(of_day).ffill().fillna(self.last_s).to_numpy()
        steps = np.diff(filled, prepend=self.last_s)
        days = self.midnights + np.cumsum(np.where(steps < -SECONDS_PER_DAY / 2, 1.0, 0.0))
        self.last_s = float(filled[-1])
        self.midnights = float(days[-1])
        return days

    def _days(self, dates: pd.Series, of_day: Array) -> tuple[Array, Flags]:
        """Days (N,) since the first date of the column, NaN without a date; whether it is a Sunday.

        A date that can be read in two ways is a Sunday if it is one in either.

        Parameters
        ----------
        dates
            The dates (N,) as text.
        of_day
            Times of the day (N,) [s].
        """
        codes, texts = pd.factorize(dates)
        fields = [_date_fields(text) for text in texts]
        if not any(_OPEN_ORDER.match(text) for text in texts):
            self._order = self._order or "dmy"  # _date_fields has put them into this order
        self._dates += [f for f in fields if f not in self._dates]
        if not self._order:
            self._note_date_changes(codes, fields, of_day)
        order = self._order_of_dates(next(iter(texts), ""))
        numbers = [_day_number(f, order, self.column, self.where) for f in fields]
        first = _day_number(self._dates[0], order, self.column, self.where)
        orders = (self._order,) if self._order else ORDERS
        sundays = [any(_is_sunday(_by_order(f, order)) for order in orders) for f in fields]
        # code -1, no date, takes the last
        days = np.array([*numbers, np.nan], dtype=float)[codes] - first
        return days, np.array([*sundays, False])[codes]

    def _note_date_changes(
        self, codes: NDArray[np.intp], fields: Sequence[_Fields], of_day: Array
    ) -> None:
        """Note the step of the clock at each change of the date, and the usual step between.

        Parameters
        ----------
        codes
            Index of the date of each row (N,); -1 without a date.
        fields
            The dates.
        of_day
            Times of the day (N,) [s].
        """
        rows = np.flatnonzero((codes >= 0) & np.isfinite(of_day))
        within_s = []
        for row in rows:
            now = fields[codes[row]]
            now_s = float(of_day[row])
            before, before_s = self._last_date or (now, now_s)
            if before != now:
                self._date_changes.append(_DateChange(before, now, now_s - before_s))
            elif now_s > before_s:
                within_s.append(now_s - before_s)
            self._last_date = now, now_s
        if within_s:
            self._usual_step_s = float(np.median(within_s))

    def _order_of_dates(self, example: str) -> str:
        """Order of day, month and year; day first while the dates do not decide.

        Dates with dots have the day first where nothing else decides; ``example`` is one of them.
        """
        if not self._order:
            has_dots = "." in example
            self._order = _date_order(self._dates, has_dots)
            if not self._order:
                self._order = _order_by_steps(self._dates, self._date_changes, self._usual_step_s)
        n_pairs = len({(first, second) for first, second, _ in self._dates})
        if not self._order and n_pairs > 1:
            if not has_dots:
                raise _two_ways_error(self._dates[1], self.column, self.where)
            self._order = "dmy"
            self.assumed = "dmy", example
        return self._order or "dmy"

    def _without_clock_changes(self, wall_s: Array, dates: pd.Series, is_sunday: Flags) -> Array:
        """Times (N,) [s] that continue where the local clock jumps by an hour on a Sunday night.

        Parameters
        ----------
        wall_s
            Times of the local clock (N,) [s].
        dates
            Dates of the stamps, for the warning.
        is_sunday
            Whether each date is a Sunday (N,).

        Notes
        -----
        A jump counts if the step without the hour is nearer to the usual step, at most
        ``LONGEST_REST`` usual steps long, and at one of ``CHANGE_HOURS``. The state of the clock is
        kept for the next chunk.
        """
        steps = np.diff(wall_s, prepend=self._last_wall_s)
        shift_s = np.full(len(wall_s), self._shift_s)
        is_jump = ((steps < 0) & (steps > -SECONDS_PER_HOUR)) | (steps > SECONDS_PER_HOUR)
        for k in np.flatnonzero(is_jump & is_sunday):
            rising = steps[:k][steps[:k] > 0]
            usual_s = float(rising[-1]) if len(rising) else self._last_step_s
            correction_s = SECONDS_PER_HOUR if steps[k] < 0 else -SECONDS_PER_HOUR
            rest_s = steps[k] + correction_s
            hour = np.ceil((wall_s[k] - steps[k]) / SECONDS_PER_HOUR + 1e-9) % 24
            is_better = abs(rest_s - usual_s) < abs(steps[k] - usual_s)
            if 0 < rest_s <= LONGEST_REST * usual_s and is_better and hour in CHANGE_HOURS:
                shift_s[k:] += correction_s
                self.clock_changes.append(str(dates.iloc[k]))
        finite = wall_s[np.isfinite(wall_s)]
        rising = steps[steps > 0]
        if len(finite):
            self._last_wall_s = float(finite[-1])
        if len(rising):
            self._last_step_s = float(rising[-1])
        self._shift_s = float(shift_s[-1])
        return np.asarray(wall_s + shift_s)


def instant_of(text: str, order: str) -> datetime | None:
    """The instant of a stamp with a date, with its zone if it has one; None where it has none.

    Parameters
    ----------
    text
        The stamp.
    order
        Order of day, month and year where the text does not tell it: one of ``ORDERS``.

    Examples
    --------
    >>> instant_of("23.03.07 22:00:00", "ymd"), instant_of("23.03.07 22:00:00", "dmy")
    (datetime.datetime(2023, 3, 7, 22, 0), datetime.datetime(2007, 3, 23, 22, 0))
    """
    stamp = _parse_stamp_or_midnight(text)
    if not stamp.date:
        return None
    is_open = _OPEN_ORDER.match(stamp.date) is not None
    parts = _by_order(_date_fields(stamp.date), order if is_open else "dmy")
    if not _is_date(parts):
        return None
    zone = None if stamp.zone_s is None else timezone(timedelta(seconds=stamp.zone_s))
    return datetime(*parts, tzinfo=zone) + timedelta(seconds=stamp.of_day_s)


def _date_fields(text: str) -> _Fields:
    """The three fields of a date in the order of the text.

    Parameters
    ----------
    text
        The date, with separators, with the name of a month, or of eight digits (year first).

    Returns
    -------
    first, second, third
        If their order is known: day, month and year, which is above 31. Otherwise ``_date_order``
        finds it, and a third field of two digits is negative.
    """
    if text.isdecimal():
        return int(text[6:]), int(text[4:6]), int(text[:4])
    name = re.search(r"[^\W\d_]+", text)
    numbers = [int(x) for x in re.findall(r"\d+", text)]
    if name is not None:
        day, year = numbers
        return day, _month(name[0]), year if year > 99 else year + 2000
    if numbers[0] > 99:
        year, month, day = numbers
        return day, month, year
    first, second, third = numbers
    return first, second, -third if third < 100 else third


def _by_order(fields: _Fields, order: str) -> _Fields:
    """(year, month, day) of three fields; a negative third field is a year of two digits."""
    first, second, third = fields
    if order == "ymd":
        return first + 2000, second, -third
    year = third if third > 0 else 2000 - third
    return (year, second, first) if order == "dmy" else (year, first, second)


def _possible_orders(dates: Iterable[_Fields]) -> list[str]:
    """Orders in which each of the dates is one."""
    listed = list(dates)
    return [order for order in ORDERS if all(_is_date(_by_order(f, order)) for f in listed)]


def _date_order(dates: Sequence[_Fields], has_dots: bool) -> str:
    """Order of the fields: "dmy", "mdy" or "ymd"; empty where several are possible.

    An order in which a field is no day or month is excluded. Otherwise the order in which the dates
    are consecutive days decides. Dates with dots and four digits of the year are seldom those of
    another order than day.month.year, so that this does not decide there: a row on the first of
    each month is as frequent.

    Parameters
    ----------
    dates
        The dates, in the order of the rows.
    has_dots
        Whether there are dots between their fields.
    """
    possible = _possible_orders(dates)
    if not possible:
        return "dmy"  # the error names the date
    if len(possible) == 1:
        return possible[0]
    if len(dates) < 2 or (has_dots and dates[0][2] > 0):
        return ""
    consecutive = []
    for order in possible:
        numbers = [date(*_by_order(f, order)).toordinal() for f in dates]
        if all(later - earlier == 1 for earlier, later in pairwise(numbers)):
            consecutive.append(order)
    return consecutive[0] if len(consecutive) == 1 else ""


def _order_by_steps(
    dates: Sequence[_Fields], changes: Sequence[_DateChange], usual_step_s: float
) -> str:
    """Order in which most steps over a change of the date are usual steps; empty without one.

    Parameters
    ----------
    dates
        The dates.
    changes
        Changes of the date.
    usual_step_s
        Usual step of the clock within a day [s]; NaN where no day has two rows.
    """
    counts = dict.fromkeys(_possible_orders(dates), 0)
    for order in counts:
        for change in changes:
            before, after = (
                date(*_by_order(f, order)).toordinal() for f in (change.before, change.after)
            )
            step_s = SECONDS_PER_DAY * (after - before) + change.of_day_s
            counts[order] += 0 < step_s <= LONGEST_REST * usual_step_s
    most = max(counts.values(), default=0)
    best = [order for order, count in counts.items() if count == most]
    return best[0] if most and len(best) == 1 else ""


def _two_ways_error(fields: _Fields, column: str, where: str) -> InputError:
    """Error for a date that can be read in two ways."""
    first, second, third = fields
    return InputError(
        f"column {column}: a date such as {first:02}/{second:02}/{abs(third):02} may be day/month "
        "or month/day",
        where=where,
        expected="dates as year-month-day",
        remedy="write the dates in this form in the file",
    )


def _is_sunday(fields: _Fields) -> bool:
    """Whether (year, month, day) is a date and a Sunday."""
    return _is_date(fields) and date(*fields).isoweekday() == 7


def _is_date(fields: _Fields) -> bool:
    """Whether (year, month, day) is a date."""
    try:
        date(*fields)
    except ValueError:
        return False
    return True


def _day_number(fields: _Fields, order: str, column: str, where: str) -> int:
    """Days since the year 1 of a date given as three fields in this order."""
    parts = _by_order(fields, order)
    if not _is_date(parts):
        first, second, third = fields
        raise InputError(
            f"column {column}: {first:02}/{second:02}/{abs(third):02} is no date in the order of "
            "the others",
            where=where,
            expected="one form of date in the column",
        )
    return date(*parts).toordinal()
