"""Time columns: units are read or requested and never guessed, dates count, repeated stamps give
the true rate."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tcdyn.core.errors import InputError
from tcdyn.io.read import open_table, read_all_rows
from tcdyn.io.stamps import Stamps
from tcdyn.io.times import (
    TIME_UNITS,
    find_time_column,
    split_unit,
)


@pytest.mark.parametrize(
    ("header", "seconds"),
    [
        ("Time (minutes)", 60.0),
        ("Time [hr]", 3600.0),
        ("Time (msec)", 1e-3),
        ("t/ms", 1e-3),
        ("Time_milliseconds", 1e-3),
        ("Time (days)", 86400.0),
        ("Time in hours", 3600.0),
        ("time, s", 1.0),
        ("Time [µs]", 1e-6),
        ("time_s", 1.0),
        ("elapsed_time", 1.0),
    ],
)
def test_the_unit_in_a_header_is_read_whatever_its_spelling(header: str, seconds: float) -> None:
    clock = find_time_column([header, "T1"], "log.csv")
    assert clock.name == header
    assert clock.in_seconds(np.array([2.0]), False) == pytest.approx([2.0 * seconds])


def test_an_unknown_unit_is_requested_and_not_taken_as_seconds() -> None:
    clock = find_time_column(["Time (ticks)", "T1"], "log.csv")
    with pytest.raises(InputError, match=r"unit 'ticks' is not known.*time_unit=UNIT"):
        clock.in_seconds(np.array([0.0, 1.0]), False)
    assert clock.in_seconds(np.array([0.0, 1.0]), True).tolist() == [
        0.0,
        1.0,
    ]  # clock stamps need no unit


def test_a_unit_that_the_caller_states_overrides_the_header() -> None:
    assert find_time_column(["Time (ticks)"], "log.csv", unit="ms").seconds == 1e-3
    with pytest.raises(InputError, match="time unit 'fortnights'"):
        find_time_column(["Time"], "log.csv", unit="fortnights")


@pytest.mark.parametrize(
    ("step", "start"),
    [
        (100.0, 0.0),  # milliseconds at 10 Hz
        (1000.0, 0.0),
        (1.0, 1.7e12),  # milliseconds since 1970
        (1 / 86400, 44526.4),  # Excel's days
        (1 / 1440, 44526.4),
        (10 / 86400, 738000.0),  # MATLAB's
        (10 / 86400, 0.0),
        (1 / 60, 0.0),  # minutes at 1 Hz
        (10 / 3600, 0.0),  # hours
        (60.0, 0.0),
    ],
)
def test_a_header_without_unit_and_a_step_that_may_be_any_unit_asks_for_it(
    step: float, start: float
) -> None:
    clock = find_time_column(["Time", "T1"], "log.csv")
    times_s = start + step * np.arange(50)
    with pytest.raises(InputError, match="no unit is stated"):
        clock.check_step(times_s, False)
    clock.check_step(times_s, True)
    find_time_column(["Time [s]", "T1"], "log.csv").check_step(times_s, False)
    find_time_column(["Time", "T1"], "log.csv", unit="s").check_step(times_s, False)


@pytest.mark.parametrize("step", [1 / 75, 0.1, 1.0])
def test_a_header_without_unit_is_in_seconds_at_the_rates_of_thermocouples(step: float) -> None:
    find_time_column(["Time", "T1"], "log.csv").check_step(step * np.arange(50), False)


def test_every_unit_that_messages_name_is_understood() -> None:
    for unit in TIME_UNITS:
        assert find_time_column([f"Time [{unit}]"], "log.csv").seconds is not None
        assert split_unit(f"Time ({unit})") == ("Time", unit)


@pytest.mark.parametrize(
    ("stamps", "seconds"),
    [
        (["2021-11-26 23:59:59", "2021-11-27 00:00:00.5"], 1.5),
        (["2021-11-26 10:00:00", "2021-11-28 10:30:00"], 2 * 86400 + 1800),
        (
            ["2021-11-26 10:00:00", "2021-11-27 06:00:00"],
            72000.0,
        ),  # earlier in the day, on the next one
        (["26.11.2021 10:00:00", "01.12.2021 10:00:00"], 5 * 86400),
        (["28.02.2020 00:00:00", "01.03.2020 00:00:00"], 2 * 86400),  # a leap year
        (["2021-11-26T10:00:00Z", "2021-11-27T10:00:00Z"], 86400.0),
        (["11/26/2021 11:59:59 PM", "11/27/2021 12:00:01 AM"], 2.0),
        (
            ["03/12/2021 10:00:00", "04/12/2021 10:00:00"],
            86400.0,
        ),  # rises by a day as day/month only
        (["12/03/2021 10:00:00", "12/04/2021 10:00:00"], 86400.0),  # as month/day only
        (["20210312 16:00:00", "20210315 16:00:00"], 3 * 86400),
        (["31.12.21 23:00:00", "01.01.22 01:00:00"], 7200.0),
        (["23:59:59.5", "00:00:00,25"], 0.75),  # no date: midnight
    ],
)
def test_a_stamp_is_a_date_and_a_time(stamps: list[str], seconds: float) -> None:
    assert Stamps("Time", "log.csv").seconds(stamps).tolist() == [0.0, seconds]
    in_chunks = Stamps("Time", "log.csv")
    assert [in_chunks.seconds([s])[0] for s in stamps] == [0.0, seconds]


def test_dates_that_can_be_read_in_two_ways_are_refused() -> None:
    with pytest.raises(InputError, match="day/month or month/day"):
        Stamps("Time", "log.csv").seconds(["01/02/2021 10:00:00", "05/06/2021 10:00:00"])


def test_a_row_of_units_below_the_header_is_kept(tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    log.write_text(
        "Time,T1\n[min],(degF)\n" + "".join(f"{k},{70 + k}\n" for k in range(20)), encoding="utf-8"
    )
    assert open_table(log).units == {"Time": "min", "T1": "degF"}


def test_a_second_row_of_names_is_no_row_of_units(tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    log.write_text(
        "Time,T1\nChannel A,Furnace\n" + "".join(f"{k},{70 + k}\n" for k in range(20)),
        encoding="utf-8",
    )
    assert open_table(log).units == {}


def test_the_cells_of_a_clock_are_kept_as_they_are_in_the_file(tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    stamps = [f"2021-11-26 10:00:{k:02}" for k in range(20)]
    log.write_text(
        "Time,T1\n" + "".join(f"{s},{k}\n" for k, s in enumerate(stamps)), encoding="utf-8"
    )
    columns = read_all_rows(open_table(log), ["Time", "T1"])
    assert columns.stamps["Time"].tolist() == stamps
    assert columns.data["Time"].tolist() == list(range(20))


def test_a_date_column_beside_a_time_of_day_belongs_to_it(tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    rows = [f"26.11.2021,10:00:{k:02},{k}\n" for k in range(20)] + [
        f"28.11.2021,10:00:{k:02},{k}\n" for k in range(5)
    ]
    log.write_text("Date,Time,T1\n" + "".join(rows), encoding="utf-8")
    columns = read_all_rows(open_table(log), ["Time"])
    assert columns.data["Time"][20] == 2 * 86400


def test_a_blank_stamp_at_midnight_does_not_lose_the_day() -> None:
    seconds = Stamps("Time", "log.csv").seconds(["23:59:59", "", "00:00:01"])
    assert seconds[2] == 2.0
