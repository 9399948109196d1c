"""Any table on even times: what its rows' stamps tell, and where rows stand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, SampleLocation
from tcdyn.io.table import Columns, Table
from tcdyn.io.times import find_time_column
from tcdyn.sensors.segments import read_segments
from tcdyn.series import Clock, Context, ReadingOptions, Series, Source, make_series, open_source
from tcdyn.series.reading import Kind
from tcdyn.series.series import ColumnRows, clock_of, on_grid
from tcdyn.smoothing.process_noise import FLOOR
from tests.cli.test_main_job import tcdyn
from tests.sensors.sensor_world import Array
from tests.series.reading import read_columns

T = np.arange(60) / 8  # eighths of a second are exact


def even_times(stamps: Array, where: str, dt_s: float | None = None) -> tuple[Clock, list[Finding]]:
    """The clock of stamps, and findings about it."""
    context = Context(where, options=ReadingOptions(dt_s=dt_s))
    _, clock, findings = clock_of(stamps, context)
    return clock, findings


def series_of(stamps: Array, values: Array, dt_s: float | None = None) -> Series:
    """One column of temperatures on even times."""
    rows = ColumnRows("T1", "degC", Kind.TEMPERATURE, values)
    return make_series(stamps, [rows], Context("log.csv", options=ReadingOptions(dt_s=dt_s)))


def rows_of(text: str) -> str:
    """A table of twelve rows below this header, one a second."""
    columns = text.count(",")
    return text + "\n" + "\n".join(f"{k}" + f",{20 + k}" * columns for k in range(12)) + "\n"


def test_a_column_that_stands_twice_is_refused(tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    log.write_text(rows_of("t,T1,T2"), encoding="utf-8")
    assert open_source(log).table.names == ("t", "T1", "T2")
    log.write_text(rows_of("t,T1,T1"), encoding="utf-8")
    with pytest.raises(InputError, match="'T1' stands twice"):
        open_source(log)


def test_rows_lost_leave_their_places_empty(tmp_path: Path) -> None:
    kept = np.r_[0:20, 23:60]
    grid, (found,) = even_times(T[kept], "log.csv")
    assert (grid.interval_s, found.code) == (pytest.approx(0.125), "series.lost")
    assert found.numbers == {"count": 3, "places": 1, "first_s": T[19]}
    assert grid.index.tolist() == kept.tolist()
    values = on_grid(10.0 * kept, grid)
    assert np.flatnonzero(np.isnan(values)).tolist() == [20, 21, 22]
    assert values[kept] == pytest.approx(10.0 * kept)
    log = tmp_path / "log.csv"
    log.write_text("t,T1\n" + "".join(f"{T[k]},{k}\n" for k in kept), encoding="utf-8")
    t, columns, _ = read_columns(log, ["T1"])
    assert t == pytest.approx(T)
    assert np.array_equal(np.isnan(columns["T1"]), np.isnan(values))


def test_rows_of_one_place_are_averaged() -> None:
    stamps = np.insert(T, 30, T[29] + 0.01)  # a row that came twice
    grid, found = even_times(stamps, "log.csv", 0.125)
    assert [f.code for f in found] == []
    assert grid.index.tolist() == np.insert(np.arange(60), 30, 29).tolist()
    values = on_grid(np.where(np.arange(61) == 30, 7.0, 5.0), grid)
    assert values[29] == 6.0
    assert np.delete(values, 29) == pytest.approx(5.0)


@pytest.mark.parametrize(("stray", "told"), [(0.0413, False), (0.5913, True)])
def test_readings_taken_far_off_even_times_are_told_with_how_far(stray: float, told: bool) -> None:
    """Every other row late by this part of an interval: their sd is half of it."""
    late = stray * 0.125 * (np.arange(400) % 2)
    stamps = 100 + np.arange(400) / 8 + late
    series = series_of(stamps, 20 + 5 * np.sin(stamps / 2), 0.125)
    assert series.clock.index.tolist() == list(range(400))
    assert ("series.uneven" in [f.code for f in series.findings]) == told
    for f in series.findings:
        assert f.numbers["rate_Hz"] == pytest.approx(8.0)
        assert f.numbers["stray_s"] == pytest.approx(stray * 0.125 / 2, rel=0.02)
    even_degC = 20 + 5 * np.sin(series.clock.even_s / 2)
    inside = slice(5, -5)  # the ends have neighbours on one side only
    assert series.readings["T1"][inside] == pytest.approx(even_degC[inside], abs=3e-3)


def test_a_clock_of_few_decimals_counts_its_rows() -> None:
    grid, (found,) = even_times(100 + np.floor(T), "log.csv")
    assert grid.index.tolist() == list(range(60))
    assert grid.interval_s == pytest.approx(
        0.125
    )  # the rows' own interval, not the span of the stamps over their number
    assert (found.code, found.numbers["rate_Hz"]) == ("series.few_decimals", pytest.approx(8.0))


def test_a_clock_of_whole_seconds_gives_an_interval_of_one_and_a_half() -> None:
    """Steps of one and two seconds in turn are no rows of one second, every third of them lost."""
    grid, (found,) = even_times(100 + np.floor(12 * T), "log.csv")
    assert grid.index.tolist() == list(range(60))
    assert grid.interval_s == pytest.approx(1.5, rel=1e-3)
    assert found.code == "series.few_decimals"


def test_a_stamp_that_stands_twice_leaves_rate_and_rows_as_they_are() -> None:
    """The row has the stamp of the one before; nothing is lost, so it is the sample after it."""
    once = T.copy()
    once[5] = once[4]
    clock, found = even_times(100 + once, "log.csv")
    assert (clock.interval_s, found) == (pytest.approx(0.125), [])
    assert clock.index.tolist() == list(range(60))


@pytest.mark.parametrize(
    ("stamps", "words"),
    [
        (T[:9], "only 9 rows"),
        (np.where((T == 0.5) | (T == 0.625), np.nan, T), "no time in row 5 below the header"),
        (
            np.where(np.arange(60) == 7, 0.25, T),
            r"backward at row 8 below the header \(0.75 s, then 0.25 s\)",
        ),
        (np.zeros(60), "one time"),
        (1e12 * T, "the times span 7.38e"),
    ],
)
def test_time_that_tells_no_rate_is_refused_with_its_row(stamps: Array, words: str) -> None:
    with pytest.raises(InputError, match=words):
        even_times(stamps, "log.csv")


def test_ten_rows_are_enough() -> None:
    assert even_times(T[:10], "log.csv")[0].index.tolist() == list(range(10))


class Rows:
    """Chunks of a table of one column whose values are their row's number."""

    def __init__(self, time_s: Array, size: int) -> None:
        self.time_s, self.size = time_s, size

    def read_chunks(self, columns):  # type: ignore[no-untyped-def]
        number = np.arange(float(len(self.time_s)))
        for a in range(0, len(number), self.size):
            b = a + self.size
            yield self.time_s[a:b], dict.fromkeys(columns, number[a:b]), ()


@pytest.mark.parametrize("size", [250, 700, 10_000])
@pytest.mark.parametrize(("silence_s", "parted"), [(19.0, False), (21.0, True)])
def test_stretches_answer_every_row_once_and_part_at_a_silence_of_ten_lags(
    size: int, silence_s: float, parted: bool
) -> None:
    """A lag of two seconds, 8 rows a second; row 30000 comes after the silence."""
    time_s = np.arange(60000) / 8
    time_s[30000:] += silence_s
    made = list(read_segments(Rows(time_s, size), ["T1"], 2.0, min_rows=1000))
    assert len(made) > 5
    # ten memories of the smoothest temperature, whose slowest root is (q / (R dt))^(1/4) / sqrt(2)
    margin = 8 * 10 * np.sqrt(2) * (1 / 8 / FLOOR) ** 0.25
    answered = [p.data["T1"][p.keep] for p in made]
    assert np.concatenate(answered).tolist() == list(range(60000))
    assert (29999.0 in [rows[-1] for rows in answered]) == parted
    ends = [(0, 30000), (29999, 59999)] if parted else [(0,), (59999,)]
    for p in made:
        rows = p.data["T1"]
        assert np.array_equal(p.time_s, time_s[rows.astype(int)])
        assert not parted or (rows[0] < 30000) == (rows[-1] < 30000)  # none over the silence
        assert p.keep.start >= margin or rows[0] in ends[0]
        assert len(rows) - p.keep.stop >= margin or rows[-1] in ends[1]


def test_an_error_leaves_no_open_reader_behind() -> None:
    """The traceback keeps the frames alive; a reader in them would abort the interpreter at its
    end."""
    closed = []

    def chunks(wanted, rows):  # type: ignore[no-untyped-def]
        try:
            for start in (0.0, 20.0):
                time = 60.0 * (start + np.arange(20.0))
                yield Columns(dict.fromkeys(wanted, time), SampleLocation("log.csv"))
        finally:
            closed.append(True)

    table = Table("log.csv", ("Time", "T1"), {}, chunks)
    source = Source(Path("log.csv"), table, find_time_column(table.names, "log.csv"))
    with pytest.raises(InputError, match="no unit is stated") as caught:
        list(source.read_chunks(["T1"]))
    assert closed == [True]
    assert caught.tb is not None


def test_a_table_in_which_nothing_can_be_compensated_has_no_result(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its rows are a million times slower than the sensor, as with a wrong unit of the time."""
    reading = 20 + 50 * (np.arange(200) > 100) + np.random.default_rng(0).normal(0, 0.05, 200)
    frame = pd.DataFrame({"time_s": 1e6 * np.arange(200), "T_degC": reading})
    frame.to_csv(tmp_path / "log.csv", index=False)
    sensor = ("sensor", "new", "--tau-s", "1+-0.1", "--column", "T*", "--out", tmp_path / "s.json")
    assert tcdyn(*sensor) == 0
    words = ("compensate", tmp_path / "log.csv", "--sensor", tmp_path / "s.json")
    assert tcdyn(*words, "--out", tmp_path / "out.csv") == 1
    assert "nothing could be compensated in T_degC" in capsys.readouterr().err
    assert pd.read_csv(tmp_path / "out.csv")["T_degC"].isna().all()
