"""A trace's columns, counted in pieces and judged: how many samples are too many, and what is said of them."""

from __future__ import annotations

import numpy as np
import pytest

from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, SampleLocation
from tcdyn.estimation.trace_noise import MAX_MISSING_FRACTION
from tcdyn.rig.check_columns import ColumnCheck, RunStatistics

LIVELY = 60 + np.random.default_rng(0).normal(0, 0.1, 400)  # no two are the same


def judged(
    values: np.ndarray,
    cleaned: np.ndarray | None = None,
    name: str = "e_degC",
    dt_s: float | None = 0.125,
) -> list[Finding]:
    """What is said of a column whose first row is line 2 of its file, and begins at 10 s."""
    time_s = None if dt_s is None else 10.0 + dt_s * np.arange(len(values))
    check = ColumnCheck(name, SampleLocation("log.csv", 2, time_s=time_s, dt_s=dt_s))
    check.add(values, values if cleaned is None else cleaned)
    return check.judge()


def missing(*rows: int, of: np.ndarray = LIVELY) -> np.ndarray:
    values = of.copy()
    values[list(rows)] = np.nan
    return values


@pytest.mark.parametrize("cut", range(1, 9))
@pytest.mark.parametrize("again", range(1, 9))
def test_the_longest_run_is_found_however_the_column_is_cut(cut: int, again: int) -> None:
    mask = np.array([0, 1, 1, 0, 1, 1, 1, 0, 1], dtype=bool)
    values = 10.0 * np.arange(9)
    runs = RunStatistics()
    for begin, end in (
        (0, min(cut, again)),
        (min(cut, again), max(cut, again)),
        (max(cut, again), 9),
    ):
        runs.add(mask[begin:end], values[begin:end], begin)
    assert (runs.count, runs.first, runs.value) == (6, 1, 10.0)
    assert (runs.start, runs.length, runs.start_value) == (4, 3, 40.0)


def test_of_two_runs_of_one_length_the_first_is_told() -> None:
    runs = RunStatistics()
    for at in (0, 3):
        runs.add(np.array([True, True, False]), np.array([1.0, 2.0, 3.0]) + at, at)
    assert (runs.count, runs.start, runs.length, runs.start_value) == (4, 0, 2, 1.0)


def test_a_gap_of_half_a_second_is_told_and_a_longer_one_is_refused() -> None:
    (found,) = judged(missing(100, 101, 102, 103, 200))
    assert (found.code, found.severity.value, found.numbers["count"]) == (
        "values.absent",
        "info",
        5,
    )
    assert (found.numbers["longest"], found.numbers["longest_s"]) == (4, 0.5)
    assert (found.numbers["row"], found.numbers["time_s"]) == (102, 22.5)
    with pytest.raises(
        InputError,
        match=r"row 102 \(22.5 s\): 5 values in a row .* \(0.625 s\), 1.2 % of the channel",
    ):
        judged(missing(*range(100, 105)))
    # of a slow log three rows
    assert judged(missing(100, 101, 102), dt_s=0.25)[0].numbers["longest_s"] == 0.75
    with pytest.raises(
        InputError, match=r"4 values in a row .*runs of at most 0\.5 s and 5 % in all"
    ):
        judged(missing(*range(100, 104)), dt_s=0.25)


def test_the_grade_of_what_is_missing_hangs_on_its_share() -> None:
    assert MAX_MISSING_FRACTION == 0.05
    for count, grade in ((8, "info"), (9, "warning"), (20, "warning")):  # a fiftieth of 400 is 8
        apart = range(5, 5 + 10 * count, 10)
        (absent,) = judged(missing(*apart))
        (other,) = judged(missing(*apart), name="load_N")
        assert (absent.severity.value, other.severity.value) == (grade, grade)
        assert absent.numbers["count"] == other.numbers["count"] == count
        assert (other.code, other.numbers["row"]) == ("values.missing", 7)
        wild = LIVELY.copy()
        wild[apart] = 5e3
        said = judged(wild, missing(*apart))
        assert [(f.code, f.severity.value, f.numbers["count"]) for f in said] == [
            ("values.impossible", grade, count)
        ]
        assert (said[0].numbers["value"], said[0].numbers["row"]) == (5e3, 7)
    apart = range(5, 5 + 10 * 21, 10)
    with pytest.raises(InputError, match=r"column load_N, row 7 .*: nan; 5 % of the column"):
        judged(missing(*apart), name="load_N")
    with pytest.raises(InputError, match=r"1 values in a row .*, 5.2 % of the channel"):
        judged(missing(*apart))


def test_spikes_are_what_was_taken_out_of_possible_readings() -> None:
    apart = range(5, 5 + 10 * 20, 10)
    (found,) = judged(LIVELY, missing(*apart))
    assert (found.code, found.severity.value, found.numbers["count"]) == (
        "spikes.removed",
        "info",
        20,
    )
    with pytest.raises(InputError, match=r"row 7 .*: 5 % of the samples are spikes"):
        judged(LIVELY, missing(*apart, 399))
    assert judged(LIVELY, missing(*apart, 399), dt_s=None) == []  # an oven's rows are no trace


def stuck(steps: int) -> np.ndarray:
    """600 rows that stay where they are for ``steps`` of their steps."""
    values = 60 + np.random.default_rng(1).normal(0, 0.1, 600)
    values[100 : 101 + steps] = 61.5
    return values


def test_a_channel_that_stays_for_more_than_ten_seconds_is_dead_and_a_room_may() -> None:
    assert judged(stuck(80)) == []
    with pytest.raises(
        InputError, match=r"row 102 \(22.5 s\): stays at 61.5 for 10.1 s: a dead channel"
    ):
        judged(stuck(81))
    (found,) = judged(stuck(81), name="ambient_degC")
    assert (found.code, found.numbers["value"], found.numbers["span_s"]) == (
        "column.frozen",
        61.5,
        10.125,
    )
    with pytest.raises(InputError, match=r"is 61\.5 in every row: a dead channel"):
        judged(np.full(400, 61.5))


def test_a_logger_whose_steps_are_coarse_is_not_taken_for_a_dead_channel() -> None:
    """Beside the stretch of 199 steps there are 400: half of them, 200, that stay as well are its way."""
    values = stuck(199)
    values[:100] = np.repeat(values[:50], 2)  # 50 steps stay
    values[300:] = np.repeat(values[300:450], 2)  # 150 steps stay
    assert judged(values) == []
    values[-1] += 0.01
    with pytest.raises(InputError, match="stays at"):
        judged(values)
