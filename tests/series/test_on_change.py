"""Columns that are reported on change: which they are, and the values that were not written."""

import numpy as np
import pytest

from tcdyn.core import Array
from tcdyn.series import fit_clock
from tcdyn.series.on_change import (
    DeadBand,
    find_dead_band,
    poll_clock,
    stated_dead_band,
    unchanged_values,
)
from tests.series.on_change_study import FILLED, filled_errors, held, on_change, ordinary
from tests.series.on_change_study import written_rows as rows_on_change


def times(n: int) -> Array:
    """Whole seconds."""
    return np.arange(n, dtype=np.float64)


def dip(n: int = 1200, entry: float = 300.4, lag: float = 120.0) -> Array:
    """A reading in two decimals that rises by 60 K."""
    i = np.arange(n)
    return np.round(20 + np.where(i > entry, 60 * (1 - np.exp(-(i - entry) / lag)), 0.0), 2)


def test_the_dead_band_of_a_dip_is_found() -> None:
    y = dip()
    rows = rows_on_change(y, 0.5, 0)
    found = find_dead_band(y[rows], fit_clock(rows.astype(np.float64)))
    assert found is not None
    assert not found.is_held
    assert found.value == pytest.approx(0.5, abs=0.011)  # of the resolution
    assert (found.n_readings, found.n_changes, found.n_heartbeats) == (len(rows), len(rows) - 1, 0)


def test_heartbeats_are_counted_apart() -> None:
    y = dip(3000)
    rows = rows_on_change(y, 0.5, 200)
    found = find_dead_band(y[rows], fit_clock(rows.astype(np.float64)))
    assert found is not None
    assert found.value == pytest.approx(0.5, abs=0.011)
    is_heartbeat = np.abs(np.diff(y[rows])) < 0.5 - 1e-9
    assert found.n_heartbeats == np.count_nonzero(is_heartbeat)


def test_a_column_with_blanks_in_a_shared_table_is_found() -> None:
    y = dip()
    values = np.full(len(y), np.nan)
    rows = rows_on_change(y, 0.5, 0)
    values[rows] = y[rows]
    found = find_dead_band(values, fit_clock(times(len(y))))
    assert found is not None
    assert found.value == pytest.approx(0.5, abs=0.011)


def test_a_dip_that_was_sampled_evenly_has_no_dead_band() -> None:
    rng = np.random.default_rng(1)
    y = dip()
    clock = fit_clock(times(len(y)))
    assert find_dead_band(y, clock) is None
    rows = np.flatnonzero(rng.random(len(y)) > 0.5)
    assert find_dead_band(y[rows], fit_clock(rows.astype(np.float64))) is None
    slow = np.where(np.arange(len(y)) % 10 == 0, y, np.nan)
    assert find_dead_band(slow, clock) is None


def test_quantised_ramps_have_no_dead_band() -> None:
    i = np.arange(800)
    y = 20 + 0.5 * np.round(0.3 * i)
    assert find_dead_band(y, fit_clock(i.astype(np.float64))) is None


def test_too_few_readings_have_no_dead_band() -> None:
    clock = fit_clock(times(4))
    nan = np.nan
    assert find_dead_band(np.full(4, nan), clock) is None
    assert find_dead_band(np.array([nan, 20.0, nan, nan]), clock) is None
    assert find_dead_band(np.array([20.0, 20.0, nan, nan]), clock) is None
    assert find_dead_band(np.array([20.0, 21.0, 25.0, 31.0]), clock) is None


def test_a_switch_with_blanks_is_held() -> None:
    values = np.full(100, np.nan)
    values[[0, 20, 50]] = [0.0, 1.0, 0.0]
    clock = fit_clock(times(100))
    found = find_dead_band(values, clock)
    assert found == DeadBand(0.0, True, 3, 2, 0)
    filled = unchanged_values(values, clock, found)
    expected = np.where((np.arange(100) >= 20) & (np.arange(100) < 50), 1.0, 0.0)
    np.testing.assert_array_equal(filled.values, expected)
    assert not filled.u.any()


def test_a_switch_that_is_written_in_every_row_is_no_report_on_change() -> None:
    values = (np.arange(100) // 20 % 2).astype(float)
    assert find_dead_band(values, fit_clock(times(100))) is None


@pytest.mark.e2e
def test_ordinary_logs_are_not_taken_for_it_and_logs_on_change_are_recognised() -> None:
    """A small part of the study, with seeds of its own: 0.1 % and 93 % there."""
    alarms = [ordinary(np.random.default_rng([50, 0, k]))[1] for k in range(20)]
    assert sum(found is not None for found in alarms) == 0
    recognised = [on_change(np.random.default_rng([50, 1, k])) for k in range(20)]
    is_right = [
        found is not None and abs(found.value / dead_band - 1) < 0.1
        for _, dead_band, _, found in recognised
    ]
    assert np.mean(is_right) > 0.8
    inputs = [held(np.random.default_rng([50, 2, k])) for k in range(20)]
    assert not any(found is not None for is_on_change, found in inputs if not is_on_change)


def test_a_steady_ramp_is_filled_by_its_line() -> None:
    y = np.asarray(20 + 0.013 * times(2000), dtype=np.float64)
    rows = rows_on_change(y, 0.5, 0)
    filled = unchanged_values(y[rows], fit_clock(rows.astype(np.float64), 1.0), DeadBand(0.5))
    end = rows[-1] + 1
    error = filled.values - y[:end]
    assert np.abs(error).max() < 0.1 * 0.5  # a tenth is the share of noise about a level
    assert np.all(filled.u[filled.is_filled] > 0)
    assert not filled.u[~filled.is_filled].any()
    np.testing.assert_array_equal(filled.values[rows], y[rows])


def test_a_sudden_entry_after_a_rest_is_no_line() -> None:
    y = dip()
    rows = rows_on_change(y, 0.5, 0)
    clock = fit_clock(rows.astype(np.float64))
    filled = unchanged_values(y[rows], clock, DeadBand(0.5))
    before = filled.values[1:300] - 20.0
    assert np.abs(before).max() < 0.1 * 0.5


def test_values_after_the_last_reading_are_held_and_those_before_the_first_are_unknown() -> None:
    values = np.full(20, np.nan)
    values[[5, 10]] = [20.0, 20.6]
    filled = unchanged_values(values, fit_clock(times(20)), DeadBand(0.5))
    assert np.isnan(filled.values[:5]).all()
    assert np.isnan(filled.u[:5]).all()
    np.testing.assert_allclose(filled.values[10:], 20.6)
    np.testing.assert_allclose(filled.u[11:], 0.5 / np.sqrt(3))
    assert filled.is_filled.tolist() == [False] * 6 + [True] * 4 + [False] + [True] * 9


def test_estimates_stay_within_the_dead_band() -> None:
    rng = np.random.default_rng(3)
    y = np.cumsum(rng.normal(0, 0.2, 2000))
    rows = rows_on_change(y, 1.0, 0)
    filled = unchanged_values(y[rows], fit_clock(rows.astype(np.float64), 1.0), DeadBand(1.0))
    last = np.repeat(y[rows][:-1], np.diff(rows))
    assert np.abs(filled.values[:-1] - last).max() <= 1.0 + 1e-9


@pytest.mark.parametrize("kind", FILLED)
def test_the_uncertainty_is_honest(kind: str) -> None:
    """The study gives mean squares of 0.5 to 1.4 by signal, and 0.9 together."""
    number = FILLED.index(kind)
    z = np.concatenate(
        [filled_errors(np.random.default_rng([51, number, k]), kind)[0] for k in range(12)]
    )
    assert 0.25 < np.mean(z**2) < 2.2  # 12 logs: a factor of 1.6 more
    assert np.mean(np.abs(z) < 1.96) > 0.85


def test_the_pooled_intervals_cover() -> None:
    z = np.concatenate(
        [
            filled_errors(np.random.default_rng([52, number, k]), kind)[0]
            for number, kind in enumerate(FILLED)
            for k in range(12)
        ]
    )
    assert 0.7 < np.mean(z**2) < 1.3
    assert 0.93 < np.mean(np.abs(z) < 1.96) < 0.98


def test_a_stated_dead_band_is_counted_and_not_searched() -> None:
    values = np.array([20.0, 20.6, 20.7, np.nan, 21.4])
    stated = stated_dead_band(values, fit_clock(times(5)), 0.5)
    assert stated == DeadBand(0.5, False, 4, 2, 1)
    assert stated_dead_band(values, fit_clock(times(5)), 0.0).is_held


def test_the_polls_of_a_slow_signal_are_found() -> None:
    rng = np.random.default_rng(4)
    y = np.cumsum(rng.normal(0, 0.05, 20000))
    rows = rows_on_change(y, 0.5, 0)
    clock = poll_clock(fit_clock(np.asarray(2.0 * rows, dtype=np.float64)))
    assert clock.interval_s == pytest.approx(2.0)
    np.testing.assert_array_equal(clock.index, rows)


def test_an_ordinary_clock_is_the_poll_clock() -> None:
    clock = fit_clock(np.array([0.0, 1.0, 2.0, 3.0, 5.0, 6.0]))
    assert poll_clock(clock) is clock


def test_of_a_long_column_the_first_readings_decide() -> None:
    rng = np.random.default_rng(5)
    steps = rng.normal(0, 0.1, 160_000).astype(np.float64)
    y = np.asarray(np.round(np.cumsum(steps), 3), dtype=np.float64)
    rows = rows_on_change(y, 0.2, 0)
    assert len(rows) > 20_000
    found = find_dead_band(y[rows], fit_clock(rows.astype(np.float64)))
    assert found is not None
    assert found.value == pytest.approx(0.2, abs=0.002)
    assert found.n_readings == len(rows)
