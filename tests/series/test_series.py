"""Rows of a table on an even grid: what one column says must not move the others."""

from __future__ import annotations

import numpy as np
import pytest

from tcdyn.core.errors import InputError
from tcdyn.series import Context, make_series
from tcdyn.series.reading import Kind
from tcdyn.series.series import ONE_PIECE, ColumnRows, Series

N = 1500


def switched(time_s: np.ndarray) -> np.ndarray:
    """A heater of 0 or 50 % that is written when it is switched; blank in other rows."""
    level = 50.0 * (np.arange(len(time_s)) // 100 % 2)
    is_new = np.append(True, np.diff(level) != 0)
    return np.where(is_new, level, np.nan)


def series_of(time_s: np.ndarray, context: Context | None = None) -> Series:
    """A temperature in each row, beside the heater."""
    rng = np.random.default_rng(3)
    temperature = 40 + 5 * np.sin(time_s / 60) + rng.normal(0, 0.1, len(time_s))
    columns = [
        ColumnRows("u", "", Kind.INPUT, switched(time_s)),
        ColumnRows("T", "degC", Kind.TEMPERATURE, temperature),
    ]
    return make_series(time_s, columns, context or Context("log.csv"))


def test_an_input_that_is_held_does_not_change_the_clock_of_the_table() -> None:
    stray = np.random.default_rng(4).normal(0, 0.06, N)
    series = series_of(np.round(np.arange(float(N)) + stray, 1))
    assert series.interval_s == pytest.approx(1.0, rel=1e-3)
    assert series.clock.size == N
    assert np.isfinite(series.on_grid("u")).all()
    assert np.isfinite(series.on_grid("T")).all()


def test_an_input_is_not_held_through_a_gap_of_the_table() -> None:
    time_s = np.arange(float(N))
    time_s[700:] += 500
    series = series_of(time_s)
    assert "series.lost" in {finding.code for finding in series.findings}
    assert np.count_nonzero(np.isnan(series.on_grid("u"))) == 500
    time_s[700:] += 5000
    with pytest.raises(InputError, match="are missing after row 700"):
        series_of(time_s, Context("log.csv", policy=ONE_PIECE))


def reported_on_change(stray_s: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows of a walk that is polled each second, written from a change of 0.5 on."""
    rng = np.random.default_rng(seed)
    walk = np.cumsum(rng.normal(0, 0.15, 4000))
    rows = [0]
    for k in range(4000):
        if abs(walk[k] - walk[rows[-1]]) >= 0.5:
            rows.append(k)
    stamps = np.round(np.array(rows) + rng.normal(0, stray_s, len(rows)), 4)
    return stamps, 40 + walk[rows]


@pytest.mark.parametrize("stray_s", [0.0, 0.002, 0.05])
@pytest.mark.parametrize("seed", [11, 12, 13])
def test_rows_on_change_are_on_the_grid_of_the_polls(stray_s: float, seed: int) -> None:
    stamps, values = reported_on_change(stray_s, seed)
    rows = ColumnRows("T", "degC", Kind.TEMPERATURE, values)
    series = make_series(stamps, [rows], Context("log.csv"))
    assert series.report.columns[0].dead_band == pytest.approx(0.5, rel=0.1)
    assert np.abs(series.clock.even_s - stamps).max() < 0.5
    if stray_s < 0.01:
        assert series.interval_s == pytest.approx(1.0, rel=3e-4)


def test_values_that_rest_at_a_limit_are_not_repeated_ones() -> None:
    """A flow that is off between bursts, and a controller at its limits."""
    rng = np.random.default_rng(5)
    t = np.arange(4000.0)
    flow = np.where(t % 400 < 90, 5 + rng.normal(0, 0.5, 4000), 0.0)
    clipped = np.clip(50 + 120 * np.sin(t / 40) + rng.normal(0, 5, 4000), 0, 100)
    for values in (flow, clipped):
        rows = ColumnRows("q", "", Kind.QUANTITY, values)
        series = make_series(t, [rows], Context("log.csv"))
        assert series.report.columns[0].readings == 4000


def temperature_rows(values: np.ndarray) -> list[ColumnRows]:
    """One column of temperatures."""
    return [ColumnRows("T", "degC", Kind.TEMPERATURE, values)]


def test_rows_for_events_do_not_change_the_clock() -> None:
    """A logger that writes a row each 10 minutes, and one for each event."""
    rows_s = 600.0 * np.arange(20)
    values = 20 + 10 * np.exp(-rows_s / 3000)
    events_s = 11400.0 + np.array([274.0, 283.0, 293.0]) - 1200
    time_s = np.append(rows_s, events_s)
    order = np.argsort(time_s)
    both = np.append(values, np.full(3, np.nan))[order]
    alone = make_series(rows_s, temperature_rows(values), Context("log.csv"))
    series = make_series(time_s[order], temperature_rows(both), Context("log.csv"))
    assert series.interval_s == alone.interval_s == pytest.approx(600)
    assert len(series.clock.index) == 23
    assert series.report.rows_lost == 0
    np.testing.assert_array_equal(series.on_grid("T"), alone.on_grid("T"))


def test_rows_without_a_reading_at_their_times_are_rows_of_the_logger() -> None:
    time_s = np.arange(400.0)
    values = 20 + np.sin(time_s / 20)
    values[100:120] = np.nan
    values[:3] = np.nan
    series = make_series(time_s, temperature_rows(values), Context("log.csv"))
    assert series.clock.size == 400
    assert series.report.rows_lost == 0


def test_two_sensors_that_write_in_turn_keep_the_clock_of_all_rows() -> None:
    time_s = np.arange(400.0)
    values = np.where(np.arange(400) % 2 == 0, 20 + np.sin(time_s / 20), np.nan)
    series = make_series(time_s, temperature_rows(values), Context("log.csv"))
    assert series.interval_s == pytest.approx(1.0)


def test_a_loop_that_waits_misses_no_sample() -> None:
    """Steps of 30 to 38 s, in whole seconds, which leave any grid."""
    steps_s = np.random.default_rng(6).integers(30, 39, 500)
    time_s = np.append(0.0, np.cumsum(steps_s)).astype(float)
    values = 20 + np.sin(time_s / 900)
    series = make_series(time_s, temperature_rows(values), Context("log.csv"))
    assert series.clock.is_wandering
    assert np.any(np.diff(series.clock.index) != 1)
    assert series.report.rows_lost == 0
    assert series.report.gaps == ()
    assert "series.lost" not in {finding.code for finding in series.findings}
    lost = np.delete(np.arange(501), [200, 201])
    series = make_series(time_s[lost], temperature_rows(values[lost]), Context("log.csv"))
    assert series.report.rows_lost == 2


def test_rows_at_equal_steps_of_a_temperature_are_exact() -> None:
    """A row for each kelvin of a heating that is not steady."""
    row = np.arange(40)
    time_s = np.round(6 * row + 8 * np.sin(row / 5.0), 3)
    series = make_series(time_s, temperature_rows(37.0 + row), Context("log.csv"))
    counted = make_series(time_s, temperature_rows(37.5 + row), Context("log.csv"))
    assert counted.report.columns[0].dead_band == pytest.approx(1.0)
    assert counted.report.rows_lost == 0
    assert counted.report.u_interval_s == 0.0
    assert np.abs(counted.clock.even_s - time_s).max() < 0.5
    # whole numbers that rise by one are the numbers of rows
    assert series.report.columns[0].dead_band is None


def test_a_row_counter_beside_lost_rows_is_no_reading_on_change() -> None:
    time_s = np.delete(np.arange(300.0), np.arange(5, 290, 7))
    number = np.arange(1.0, len(time_s) + 1)
    columns = [
        ColumnRows("Sample", "", Kind.QUANTITY, number),
        *temperature_rows(20 + np.sin(time_s / 20)),
    ]
    series = make_series(time_s, columns, Context("log.csv"))
    assert series.bands == {}


def test_rows_of_events_with_a_row_counter_do_not_change_the_clock() -> None:
    """As HOBO loggers write them: the counter has a number in each row, the reading has none."""
    samples_s = 600.0 * np.arange(20)
    events_s = np.array([3643.0, 3653.0, 9010.0])
    time_s = np.concatenate([samples_s, events_s])
    order = np.argsort(time_s)
    reading = np.append(20 + 0.3 * np.sin(np.arange(20)), [np.nan] * 3)[order]
    counter = np.arange(1.0, 24.0)
    columns = [
        ColumnRows("#", "", Kind.QUANTITY, counter),
        ColumnRows("T1", "degC", Kind.TEMPERATURE, reading),
    ]
    series = make_series(time_s[order], columns, Context("log.csv"))
    assert series.report.interval_s == pytest.approx(600.0, rel=1e-6)
    assert series.report.rows_lost == 0
