"""Clocks that are written as one number, and numbers that are none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tcdyn.core.errors import InputError
from tcdyn.identification import from_csv
from tcdyn.io.clock_numbers import Midnights, clock_unit, seconds_of_day
from tests.sensors.sensor_world import Array
from tests.series.reading import read_columns
from tests.series.reading import source_of as open_source


def as_number(time_s: Array, unit: str) -> Array:
    """Times of the day [s] as HHMMSS or HHMM."""
    of_day = time_s % 86400
    number = 10_000 * (of_day // 3600) + 100 * (of_day // 60 % 60) + of_day % 60
    return np.asarray(number // 100 if unit == "HHMM" else number)


def write_table(path: Path, name: str, numbers: Array) -> Path:
    """A table with this time column, an input and an output."""
    rows = [f"{x:.10g},{20 + k % 7},{k % 2}" for k, x in enumerate(numbers)]
    path.write_text("\n".join([f"{name},T1_degC,u", *rows, ""]), encoding="utf-8")
    return path


@pytest.mark.parametrize("interval_s", [1, 2, 5, 10, 20, 30, 60, 600])
@pytest.mark.parametrize("name", ["Time", "Time_HHMMSS", "Time (hhmmss)"])
def test_hours_minutes_and_seconds_as_one_number_are_a_clock(
    tmp_path: Path, interval_s: int, name: str
) -> None:
    time_s = 10 * 3600 + 55 * 60 + interval_s * np.arange(400.0)
    path = write_table(tmp_path / "log.csv", name, as_number(time_s, "HHMMSS"))
    read_s, _, _ = read_columns(open_source(path), ["T1_degC"])
    assert read_s == pytest.approx(time_s)  # across midnight at 600 s
    data = from_csv(path, input="u", output="T1_degC")
    assert (data.dt_s, len(data.runs[0].y)) == (pytest.approx(interval_s), 400)


@pytest.mark.parametrize("interval_s", [60, 300, 900, 1800])
def test_hours_and_minutes_need_their_unit(tmp_path: Path, interval_s: int) -> None:
    """1059 and 1100 may also be minutes and seconds."""
    time_s = 3600.0 + interval_s * np.arange(75.0)
    numbers = as_number(time_s, "HHMM")
    path = write_table(tmp_path / "log.csv", "Time", numbers)
    for unit in (None, "min", "s"):
        with pytest.raises(InputError) as caught:
            read_columns(open_source(path, time_unit=unit), ["T1_degC"])
        assert caught.value.parameters["time_unit"] == "HHMM"
    for named, unit in ((path, "HHMM"), (write_table(tmp_path / "2.csv", "HHMM", numbers), None)):
        read_s, _, _ = read_columns(open_source(named, time_unit=unit), ["T1_degC"])
        assert read_s == pytest.approx(time_s)
        data = from_csv(named, input="u", output="T1_degC", time_unit=unit)
        assert data.dt_s == pytest.approx(interval_s)


@pytest.mark.parametrize(
    "numbers",
    [
        np.arange(500.0),
        100.0 * np.arange(500),
        50.0 * np.arange(500),
        np.delete(np.arange(500.0), np.r_[100:141, 300:320]),
        100_000 + np.delete(np.arange(59.0), [20, 21]),
        np.r_[np.arange(51.0), np.arange(100.0, 140.0)],
        0.1 * np.arange(5000),
    ],
)
def test_counters_with_and_without_gaps_are_no_clock(numbers: Array) -> None:
    assert clock_unit(numbers) == ""


def test_rows_that_are_lost_do_not_hide_a_clock() -> None:
    time_s = 36_000 + np.delete(np.arange(1000.0), np.r_[100:110, 400, 500:503])
    assert clock_unit(as_number(time_s, "HHMMSS")) == "HHMMSS"


def test_days_go_on_from_chunk_to_chunk() -> None:
    time_s = 80_000 + 60 * np.arange(3000.0)
    midnights = Midnights()
    of_day = seconds_of_day(as_number(time_s, "HHMMSS"), "HHMMSS")
    parts = [midnights.continued(part) for part in np.array_split(of_day, 7)]
    assert np.concatenate(parts) == pytest.approx(np.floor(time_s))
