"""Clocks without leading zeros, midnights without a clock, clocks of 12 hours without AM and PM."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from tcdyn.core.errors import InputError
from tcdyn.identification import from_csv
from tcdyn.io.read import open_table
from tcdyn.io.stamps import Stamps, is_stamp
from tests.series.reading import read_columns
from tests.series.reading import source_of as open_source

DATES = ("", "4/13/2022 ", "13.04.2022 ", "2022-4-13 ", "2022/04/13 ", "13-Apr-2022 ", "2022-4-13T")


def seconds_of(texts: Sequence[str]) -> list[float]:
    """Seconds since the first of these stamps."""
    return [float(x) for x in Stamps("time", "log.csv").seconds(texts)]


def clock(of_day_s: int, form: str) -> str:
    """A time of the day in which minutes, seconds or all fields lose their leading zero."""
    h, m, s = of_day_s // 3600, of_day_s // 60 % 60, of_day_s % 60
    forms = {
        "minutes": f"{h:02}:{m}:{s:02}",
        "seconds": f"{h:02}:{m:02}:{s}",
        "all": f"{h}:{m}:{s}",
    }
    return forms[form]


@pytest.mark.parametrize("date", DATES)
@pytest.mark.parametrize("form", ["minutes", "seconds", "all"])
@pytest.mark.parametrize("end", ["", ".5", ",25", " PM"])
def test_fields_of_a_clock_may_lose_their_leading_zero(date: str, form: str, end: str) -> None:
    of_day_s = 8 * 3600 + 58 + np.arange(0, 7200, 7)
    assert seconds_of([date + clock(int(x), form) + end for x in of_day_s]) == pytest.approx(
        of_day_s - of_day_s[0]
    )


@pytest.mark.parametrize("date", DATES[1:])
def test_hours_and_minutes_behind_a_date_may_lose_their_zero(date: str) -> None:
    assert seconds_of([f"{date}{m // 60}:{m % 60}" for m in range(480, 620)]) == [
        60.0 * k for k in range(140)
    ]


def test_two_numbers_with_a_colon_are_no_stamp_without_a_date() -> None:
    assert not is_stamp("1:5")
    assert is_stamp("1:05")


def test_a_day_count_keeps_its_meaning() -> None:
    assert seconds_of(["1:02:03:04", "1:02:03:05"]) == [0.0, 1.0]
    assert seconds_of(["1.23:59:59", "2.00:00:00"]) == [0.0, 1.0]


MIDNIGHTS = {
    "iso": ("2021-03-03 {}", "2021-03-04", "2021-03-04 {}", ":"),
    "German": ("30.03.2021 {}", "31.03.2021", "31.03.2021 {}", "."),
    "German with colons": ("30.03.2021 {}", "31.03.2021", "31.03.2021 {}", ":"),
    "American": ("3/13/2021 {}", "3/14/2021", "3/14/2021 {}", ":"),
}


def table_across_midnight(form: str, first_row_is_midnight: bool) -> str:
    """A table with a row every 10 s, in which midnight is a date without a clock."""
    before, midnight, after, mark = MIDNIGHTS[form]
    rows = []
    for k in range(0 if first_row_is_midnight else -20, 40):
        of_day_s = 10 * k % 86400
        text = f"{of_day_s // 3600:02}{mark}{of_day_s // 60 % 60:02}{mark}{of_day_s % 60:02}"
        stamp = (before if k < 0 else after).format(text)
        rows.append(f"{midnight if k == 0 else stamp};{k + 20},5;{k}")
    return "\n".join(["Zeitpunkt;Temp_degC;u", *rows, ""])


@pytest.mark.parametrize("first_row_is_midnight", [False, True])
@pytest.mark.parametrize("form", MIDNIGHTS)
def test_a_date_without_a_clock_is_its_midnight(
    tmp_path: Path, form: str, first_row_is_midnight: bool
) -> None:
    path = tmp_path / "log.csv"
    path.write_text(table_across_midnight(form, first_row_is_midnight), encoding="utf-8")
    assert open_table(path).names == ("Zeitpunkt", "Temp_degC", "u")
    time_s, columns, _ = read_columns(open_source(path), ["Temp_degC"])
    assert np.diff(time_s) == pytest.approx(10.0)
    assert np.isfinite(columns["Temp_degC"]).all()
    data = from_csv(path, input="u", output="Temp_degC")
    assert data.dt_s == pytest.approx(10.0)
    assert len(data.runs[0].y) == len(time_s)


@pytest.mark.parametrize("date", ["", "2026-03-02 ", "3/14/2026 "])
@pytest.mark.parametrize("interval_s", [1, 60, 600])
def test_a_clock_of_12_hours_without_am_and_pm_is_the_cause_that_is_named(
    date: str, interval_s: int
) -> None:
    of_day_s = 12 * 3600 + np.arange(0, 7200, interval_s)
    hours = (of_day_s // 3600 - 1) % 12 + 1
    texts = [f"{date}{h:02}:{s // 60 % 60:02}:{s % 60:02}" for h, s in zip(hours, of_day_s)]
    stamps = Stamps("time", "log.csv")
    stamps.seconds(texts[:3])
    with pytest.raises(InputError, match="12 h"):
        stamps.seconds(texts[3:])
    in_halves = [f"{text} PM" for text in texts]
    assert seconds_of(in_halves) == pytest.approx(of_day_s - of_day_s[0])
