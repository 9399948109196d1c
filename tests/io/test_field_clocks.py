"""Further members of the classes of clocks, counters and other files that were met in the field."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tcdyn.core.errors import InputError
from tcdyn.io.clock_numbers import cause_of_fall, clock_unit, seconds_of_stamp
from tcdyn.io.read import open_table
from tests.series.reading import read_columns
from tests.series.reading import source_of as open_source

ROWS = 240
K = np.arange(ROWS)


def table(folder: Path, header: str, *columns: Sequence[object], separator: str = ",") -> Path:
    path = folder / "log.csv"
    rows = [separator.join(map(str, row)) for row in zip(*columns, 20 + 0.1 * (K % 7))]
    path.write_text("\n".join([f"{header}{separator}T1", *rows]) + "\n", encoding="utf-8")
    return path


def moments(start: str, step_s: float = 1.0) -> pd.DatetimeIndex:
    return pd.Timestamp(start) + pd.to_timedelta(step_s * K, unit="s")


def stamps(start: str, form: str, step_s: float = 1.0) -> list[str]:
    return [when.strftime(form) for when in moments(start, step_s)]


def since_first(path: Path, **options: str) -> np.ndarray:
    time_s, _, _ = read_columns(path, ["T1"], **options)
    return np.asarray(time_s - time_s[0])


# 38: midnight as a date alone


@pytest.mark.parametrize("form", ["%d.%m.%Y %H.%M.%S", "%b %d, %Y %H:%M:%S", "%m/%d/%y %H:%M:%S"])
@pytest.mark.parametrize("start", ["2021-03-30 23:59:00", "2021-03-31 00:00:00"])
def test_a_date_alone_is_midnight_in_further_forms(tmp_path: Path, form: str, start: str) -> None:
    cells = stamps(start, form)
    for k, when in enumerate(moments(start)):
        if when == when.normalize():
            cells[k] = cells[k][:-9]
    assert since_first(table(tmp_path, "Zeit", cells, separator=";")) == pytest.approx(K)


# 39: fractions of varying length, offsets of two digits


@pytest.mark.parametrize("offset", ["", "Z", "+05", "-0330"])
def test_fractions_may_have_any_length(tmp_path: Path, offset: str) -> None:
    cells = [
        when.isoformat().rstrip("0") if when.microsecond else when.isoformat()
        for when in moments("2018-12-21 13:07:31", 0.125)
    ]
    path = table(tmp_path, "timestamp", [cell + offset for cell in cells])
    assert since_first(path) == pytest.approx(0.125 * K, abs=1e-6)


# 40: clocks of 12 hours without AM and PM


@pytest.mark.parametrize(
    ("start", "form", "step_s"),
    [
        ("2026-03-02 23:58:00", "%Y-%m-%d %I:%M:%S", 1.0),  # midnight, with a date
        ("2026-03-22 21:00:00", "%m/%d/%Y %I:%M", 60.0),
        ("2026-03-02 12:58:00", "%I:%M:%S", 1.0),  # from noon to one, without
        ("2026-03-02 00:58:00", "%d.%m.%Y %I:%M:%S", 1.0),
    ],
)
def test_a_clock_of_12_hours_is_named_as_the_cause(
    tmp_path: Path, start: str, form: str, step_s: float
) -> None:
    path = table(tmp_path, "Time", stamps(start, form, step_s))
    with pytest.raises(InputError, match=r"clock of 12 hours without AM and PM.*0 h.*add 12 h"):
        since_first(path)


def test_a_clock_of_12_hours_in_a_column_beside_its_date(tmp_path: Path) -> None:
    start = "2026-03-02 23:58:00"
    path = table(tmp_path, "Date,Time", stamps(start, "%Y-%m-%d"), stamps(start, "%I:%M:%S"))
    with pytest.raises(InputError, match="clock of 12 hours without AM and PM"):
        since_first(path)


@pytest.mark.parametrize("form", ["%Y-%m-%d %H:%M:%S", "%Y-%m-%d %I:%M:%S %p"])
def test_a_clock_that_can_be_told_passes_noon_and_midnight(tmp_path: Path, form: str) -> None:
    path = table(tmp_path, "Time", stamps("2026-03-02 11:00:00", form, 600.0))
    assert since_first(path) == pytest.approx(600.0 * K)


# 46, 67: epochs and counters


@pytest.mark.parametrize(
    ("name", "per_second"), [("epoch_s", 1), ("unix_time", 1), ("millis", 1000), ("micros", 10**6)]
)
def test_columns_of_epochs_and_counters_are_times(
    tmp_path: Path, name: str, per_second: int
) -> None:
    path = table(tmp_path, name, 1_700_000_000 + per_second * K)
    assert since_first(path) == pytest.approx(K)


def test_a_part_of_a_clock_is_no_time(tmp_path: Path) -> None:
    path = table(tmp_path, "minute", K % 60)
    with pytest.raises(InputError, match="no time column"):
        since_first(path)


@pytest.mark.parametrize(
    ("name", "start", "step", "end"),
    [
        ("t_ms", 5000, 1000, "2^16"),
        ("micros", 4_294_000_000, 500_000, "2^32"),
        ("millis", 4_294_900_000, 1000, "2^32"),
    ],
)
def test_a_counter_that_starts_again_is_named(
    tmp_path: Path, name: str, start: int, step: int, end: str
) -> None:
    size = {"2^16": 2**16, "2^32": 2**32}[end]
    counter = (start + step * K.astype(np.int64)) % size
    path = table(tmp_path, name, counter)
    with pytest.raises(InputError, match=rf"ends at {end.replace('^', '.')}.*add {size}"):
        since_first(path)
    repaired = counter + size * np.cumsum(np.diff(counter, prepend=counter[0]) < 0)
    seconds = step / (1e6 if name == "micros" else 1e3)
    assert since_first(table(tmp_path, name, repaired)) == pytest.approx(seconds * K)


def test_rows_in_no_order_have_no_clear_cause() -> None:
    rng = np.random.default_rng(1)
    for _ in range(200):
        times = np.cumsum(rng.exponential(1.0, 300))
        swapped = times[np.argsort(np.arange(300) + rng.normal(0, 2, 300))]
        assert cause_of_fall(swapped) == ("", "")
        runs = np.concatenate([times[: rng.integers(50, 300)], times])
        assert cause_of_fall(runs) == ("", "")


# 57: clocks as numbers, with their date


@pytest.mark.parametrize("name", ["Timestamp", "Time", "DateTime"])
@pytest.mark.parametrize(
    ("form", "step_s"), [("%Y%m%d%H%M%S", 1.0), ("%Y%m%d%H%M", 60.0), ("%Y%m%d%H%M%S.00", 2.0)]
)
def test_a_date_and_a_clock_as_one_number(
    tmp_path: Path, name: str, form: str, step_s: float
) -> None:
    path = table(tmp_path, name, stamps("2022-04-13 23:58:00", form, step_s))
    assert since_first(path) == pytest.approx(step_s * K)


@pytest.mark.parametrize("form", ["%Y%m%d", "%y%m%d", "%Y-%m-%d", "%d.%m.%Y"])
@pytest.mark.parametrize("is_padded", [True, False])
def test_a_date_beside_a_clock_as_a_number(tmp_path: Path, form: str, is_padded: bool) -> None:
    start = "2022-04-13 23:58:00"
    clock = [c if is_padded else str(int(c)) for c in stamps(start, "%H%M%S")]
    path = table(tmp_path, "Date,Time", stamps(start, form), clock)
    assert since_first(path) == pytest.approx(K)


def test_numbers_with_a_date_in_a_parquet_file(tmp_path: Path) -> None:
    path = tmp_path / "log.parquet"
    numbers = [int(text) for text in stamps("2022-12-31 23:58:00", "%Y%m%d%H%M%S")]
    pd.DataFrame({"Time": numbers, "T1": 20 + 0.1 * (K % 7)}).to_parquet(path)
    assert since_first(path) == pytest.approx(K)


def test_a_stated_unit_that_contradicts_the_digits_is_refused_with_a_remedy_that_works(
    tmp_path: Path,
) -> None:
    path = tmp_path / "log.parquet"
    numbers = [int(text) for text in stamps("2022-12-31 23:58:00", "%Y%m%d%H%M%S")]
    pd.DataFrame({"Time [s]": numbers, "T1": 20 + 0.1 * (K % 7)}).to_parquet(path)
    with pytest.raises(InputError, match="time_unit=YYYYMMDDHHMMSS"):
        since_first(path)
    assert since_first(path, time_unit="YYYYMMDDHHMMSS") == pytest.approx(K)


@pytest.mark.parametrize("start", [1.7e9, 1.7e12, 1.7e15, 2.5e11, 44000.0])
def test_other_numbers_are_no_dates(start: float) -> None:
    assert clock_unit(start + np.arange(300.0)) == ""


def test_seconds_of_stamps_are_those_of_the_calendar() -> None:
    when = pd.date_range("1999-12-31 23:00:00", periods=2000, freq="7919min")
    numbers = np.array([float(t.strftime("%Y%m%d%H%M%S")) for t in when])
    expected = when.astype("datetime64[s]").astype(np.int64).to_numpy(dtype=float)
    assert seconds_of_stamp(numbers, "YYYYMMDDHHMMSS") == pytest.approx(expected, abs=0)


# 59: a finer column of time beside stamps that repeat


@pytest.mark.e2e
@pytest.mark.parametrize("name", ["device_ms", "elapsed", "millis"])
def test_a_finer_column_of_time_is_named(tmp_path: Path, name: str) -> None:
    rng = np.random.default_rng(1)
    rows = np.sort(rng.choice(4 * ROWS, ROWS, replace=False))
    coarse = [
        (
            pd.Timestamp("2024-05-01 10:00:00") + pd.Timedelta(seconds=int(0.1 * k) // 2 * 2)
        ).strftime("%Y-%m-%d %H:%M:%S")
        for k in rows
    ]
    fine = (0.1 * rows).round(1) if name == "elapsed" else 100 * rows
    path = table(tmp_path, f"timestamp,{name}", coarse, fine)
    with pytest.raises(InputError, match=rf"another column of time \({name}\), time={name}"):
        since_first(path)
    time_s = since_first(path, time=name)
    assert time_s[1] == pytest.approx(0.1)


def test_a_counter_of_milliseconds_is_no_fraction_of_a_stamp(tmp_path: Path) -> None:
    clock = stamps("2024-05-01 10:00:00", "%Y-%m-%d %H:%M:%S")
    path = table(tmp_path, "timestamp,millis", clock, 500 + 1000 * K)
    assert since_first(path) == pytest.approx(K)
    seconds = stamps("2024-05-01 10:00:00", "%Y-%m-%d %H:%M:%S", 0.25)
    path = table(tmp_path, "timestamp,millis", seconds, 250 * (K % 4))
    assert since_first(path) == pytest.approx(0.25 * K)


# 68: fractions of a second without their leading zeros


@pytest.mark.parametrize("step_ms", [5, 20, 50])
def test_fractions_without_zeros_are_named(tmp_path: Path, step_ms: int) -> None:
    ms = step_ms * np.arange(4000 // step_ms)
    ms = (
        np.resize(ms, ROWS)
        if len(ms) > ROWS
        else np.concatenate([ms, step_ms * np.arange(len(ms), ROWS)])
    )
    clock = [f"12:00:{m // 1000:02}.{m % 1000}" for m in ms]
    with pytest.raises(InputError, match=r"leading zeros.*with all digits"):
        since_first(table(tmp_path, "Time", clock))
    numbers = [f"{m // 1000}.{m % 1000}" for m in ms]
    with pytest.raises(InputError, match=r"leading zeros.*with all digits"):
        since_first(table(tmp_path, "time_s", numbers))


# 64: files of other kinds


@pytest.mark.parametrize(
    ("first_bytes", "kind"),
    [
        (b"SQLite format 3\x00\x10\x00", "SQLite"),
        (b"\x89HDF\r\n\x1a\n\x00\x00", "HDF5"),
        (b"MATLAB 5.0 MAT-file, Platform: GLNXA64\x00", "MATLAB"),
        (b"\x80\x04\x95\x1e\x00\x00", "pickle"),
        (b"\x93NUMPY\x01\x00v\x00", "NumPy"),
        (b"%PDF-1.7\n%", "PDF"),
        (b"\xfd7zXZ\x00\x00", "compressed"),
    ],
)
@pytest.mark.parametrize("ending", ["csv", "dat"])
def test_a_file_of_another_kind_is_named(
    tmp_path: Path, first_bytes: bytes, kind: str, ending: str
) -> None:
    path = tmp_path / f"log.{ending}"
    path.write_bytes(first_bytes + bytes(4000))
    with pytest.raises(InputError, match=kind) as caught:
        open_table(path)
    assert str(caught.value).isascii()
    assert "\n" not in str(caught.value)


# 79: clocks without leading zeros


@pytest.mark.parametrize("day", ["13.4.2022 ", "2022-4-13 ", "4/13/22 ", ""])
@pytest.mark.parametrize("has_seconds_of_two_digits", [True, False])
def test_clocks_may_lack_their_zeros(
    tmp_path: Path, day: str, has_seconds_of_two_digits: bool
) -> None:
    cells = []
    for when in moments("2022-04-13 08:58:00"):
        second = f"{when.second:02}" if has_seconds_of_two_digits else when.second
        cells.append(f"{day}{when.hour}:{when.minute}:{second}")
    assert since_first(table(tmp_path, "Timestamp", cells)) == pytest.approx(K)


def test_sources_name_their_other_columns_of_time(tmp_path: Path) -> None:
    path = table(tmp_path, "Time [s],heater,t_ms", K, K % 2, 1000 * K)
    assert open_source(path, None, ["T1"]).clock.others == ("t_ms",)
