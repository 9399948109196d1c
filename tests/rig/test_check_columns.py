"""Check of the columns of a record, counted in chunks: limits of missing and implausible samples,
and the findings."""

from __future__ import annotations

import numpy as np
import pytest

from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, SampleLocation
from tcdyn.estimation.trace_noise import MAX_MISSING_FRACTION
from tcdyn.rig.check_columns import ColumnCheck, RunStatistics
from tcdyn.rig.oven_log import oven_frame

NOISY_COLUMN = 60 + np.random.default_rng(0).normal(0, 0.1, 400)  # no two are the same


def column_findings(
    values: np.ndarray,
    cleaned: np.ndarray | None = None,
    name: str = "e_degC",
    dt_s: float | None = 0.125,
) -> list[Finding]:
    """Findings on a column whose first row is line 2 of its file and begins at 10 s."""
    time_s = None if dt_s is None else 10.0 + dt_s * np.arange(len(values))
    check = ColumnCheck(name, SampleLocation("log.csv", 2, time_s=time_s, dt_s=dt_s))
    check.add(values, values if cleaned is None else cleaned)
    return check.judge()


def with_missing(*rows: int, of: np.ndarray = NOISY_COLUMN) -> np.ndarray:
    """The column with these rows missing."""
    values = of.copy()
    values[list(rows)] = np.nan
    return values


@pytest.mark.parametrize("first_cut", range(1, 9))
@pytest.mark.parametrize("second_cut", range(1, 9))
def test_longest_run_is_found_for_any_chunk_boundaries(first_cut: int, second_cut: int) -> None:
    mask = np.array([0, 1, 1, 0, 1, 1, 1, 0, 1], dtype=bool)
    values = 10.0 * np.arange(9)
    runs = RunStatistics()
    for start, end in (
        (0, min(first_cut, second_cut)),
        (min(first_cut, second_cut), max(first_cut, second_cut)),
        (max(first_cut, second_cut), 9),
    ):
        runs.add(mask[start:end], values[start:end], start)
    assert (runs.count, runs.first, runs.value) == (6, 1, 10.0)
    assert (runs.start, runs.length, runs.start_value) == (4, 3, 40.0)


def test_first_of_two_equally_long_runs_is_reported() -> None:
    runs = RunStatistics()
    for offset in (0, 3):
        runs.add(np.array([True, True, False]), np.array([1.0, 2.0, 3.0]) + offset, offset)
    assert (runs.count, runs.start, runs.length, runs.start_value) == (4, 0, 2, 1.0)


def test_gap_of_half_a_second_is_reported_and_a_longer_one_raises() -> None:
    (finding,) = column_findings(with_missing(100, 101, 102, 103, 200))
    assert (finding.code, finding.severity.value, finding.numbers["count"]) == (
        "values.absent",
        "info",
        5,
    )
    assert (finding.numbers["longest"], finding.numbers["longest_s"]) == (4, 0.5)
    assert (finding.numbers["row"], finding.numbers["time_s"]) == (102, 22.5)
    with pytest.raises(
        InputError,
        match=r"row 102 \(22.5 s\): 5 values in a row .* \(0.625 s\), 1.2 % of the channel",
    ):
        column_findings(with_missing(*range(100, 105)))
    # in a slow log three rows
    assert column_findings(with_missing(100, 101, 102), dt_s=0.25)[0].numbers["longest_s"] == 0.75
    with pytest.raises(
        InputError, match=r"4 values in a row .*runs of at most 0\.5 s and 5 % in all"
    ):
        column_findings(with_missing(*range(100, 104)), dt_s=0.25)


def test_severity_of_missing_values_depends_on_their_share() -> None:
    assert MAX_MISSING_FRACTION == 0.05
    for count, severity in ((8, "info"), (9, "warning"), (20, "warning")):  # a fiftieth of 400 is 8
        rows = range(5, 5 + 10 * count, 10)
        (junction,) = column_findings(with_missing(*rows))
        (force,) = column_findings(with_missing(*rows), name="load_N")
        assert (junction.severity.value, force.severity.value) == (severity, severity)
        assert junction.numbers["count"] == force.numbers["count"] == count
        assert (force.code, force.numbers["row"]) == ("values.missing", 7)
    rows = range(5, 5 + 10 * 21, 10)
    with pytest.raises(InputError, match=r"column load_N, row 7 .*: nan; 5 % of the column"):
        column_findings(with_missing(*rows), name="load_N")
    with pytest.raises(InputError, match=r"1 values in a row .*, 5.2 % of the channel"):
        column_findings(with_missing(*rows))


def test_spikes_are_the_values_removed_from_possible_readings() -> None:
    rows = range(5, 5 + 10 * 20, 10)
    (finding,) = column_findings(NOISY_COLUMN, with_missing(*rows))
    assert (finding.code, finding.severity.value, finding.numbers["count"]) == (
        "spikes.removed",
        "info",
        20,
    )
    with pytest.raises(InputError, match=r"row 7 .*: 5 % of the samples are spikes"):
        column_findings(NOISY_COLUMN, with_missing(*rows, 399))
    # rows of an oven log are not a time series
    assert column_findings(NOISY_COLUMN, with_missing(*rows, 399), dt_s=None) == []


def partly_constant(steps: int) -> np.ndarray:
    """600 rows with a constant value over ``steps`` time steps."""
    values = 60 + np.random.default_rng(1).normal(0, 0.1, 600)
    values[100 : 101 + steps] = 61.5
    return values


def test_channel_constant_for_more_than_ten_seconds_is_dead_but_ambient_may_be_constant() -> None:
    assert column_findings(partly_constant(80)) == []
    with pytest.raises(
        InputError, match=r"row 102 \(22.5 s\): stays at 61.5 for 10.1 s: a dead channel"
    ):
        column_findings(partly_constant(81))
    (finding,) = column_findings(partly_constant(81), name="ambient_degC")
    assert (finding.code, finding.numbers["value"], finding.numbers["span_s"]) == (
        "column.frozen",
        61.5,
        10.125,
    )
    with pytest.raises(InputError, match=r"is 61\.5 in every row: a dead channel"):
        column_findings(np.full(400, 61.5))


def test_coarse_steps_of_a_logger_are_not_mistaken_for_a_dead_channel() -> None:
    """Besides the constant segment of 199 steps there are 400. If half of them, 200, are also
    constant, the logger is coarse."""
    values = partly_constant(199)
    values[:100] = np.repeat(values[:50], 2)  # 50 constant steps
    values[300:] = np.repeat(values[300:450], 2)  # 150 constant steps
    assert column_findings(values) == []
    values[-1] += 0.01
    with pytest.raises(InputError, match="stays at"):
        column_findings(values)


def test_an_oven_log_without_repeats_counts_the_visits_of_each_set_point() -> None:
    """Two rows at each of 20, 40, 20, 60, 40 degC."""
    level = np.repeat([20.0, 40.0, 20.0, 60.0, 40.0], 2)
    columns = {"setpoint_degC": level, "prt_degC": level + 0.1}
    columns |= {f"{letter}_degC": level + 0.3 for letter in "abcdef"}
    frame, findings = oven_frame(columns, SampleLocation("oven.csv", 2))
    assert frame["repeat"].tolist() == [1, 1, 1, 1, 2, 2, 1, 1, 2, 2]
    assert "oven.no_repeat" in {finding.code for finding in findings}
