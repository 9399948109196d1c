"""Which values of a column are readings."""

from __future__ import annotations

import numpy as np
import pytest

from tcdyn.series.reading import CODE, EMPTY, RANGE, READING, Codes, Kind, find_codes, reasons_of

N = 1500


def quiet(level: float, seed: int = 1) -> np.ndarray:
    """Readings about a level, to two decimals."""
    return np.round(level + np.random.default_rng(seed).normal(0, 0.05, N), 2)


def test_values_beyond_a_thermocouple_are_codes_where_they_are_few_different_ones() -> None:
    y = quiet(40.0)
    y[[10, 500, 900]] = 9999.0
    assert set(reasons_of(y, Kind.TEMPERATURE)) == {READING, CODE}
    y[100:110] = 4000.0 + np.arange(10.0)
    reasons = reasons_of(y, Kind.TEMPERATURE)
    assert (reasons[100:110] == RANGE).all()
    assert (reasons_of(y, Kind.QUANTITY)[100:110] == READING).all()


@pytest.mark.parametrize("kind", [Kind.TEMPERATURE, Kind.QUANTITY])
@pytest.mark.parametrize("value", [327.67, -327.68, 3276.7, -3276.8, 32767.0])
def test_the_limits_of_16_bits_are_codes_where_there_is_nothing_else(
    kind: Kind, value: float
) -> None:
    y = np.full(N, value)
    y[:3] = np.nan
    assert set(reasons_of(y, kind)) == {EMPTY, CODE}
    assert set(reasons_of(y, Kind.INPUT)) == {EMPTY, READING}


def test_the_limits_of_16_bits_in_degF_are_codes_and_a_reading_of_this_size_is_none() -> None:
    y = np.full(N, 327.67)
    assert set(reasons_of((y - 32) / 1.8, Kind.TEMPERATURE)) == {CODE}
    y[::2] = 327.6
    assert set(reasons_of(y, Kind.TEMPERATURE)) == {READING}


def test_an_empty_cell_is_no_code() -> None:
    y = quiet(40.0)
    y[3] = np.nan
    y[4] = np.inf
    assert reasons_of(y, Kind.TEMPERATURE)[3:5].tolist() == [EMPTY, CODE]


def test_states_that_last_are_no_codes() -> None:
    """A pump that is off, humid air at 100 %, a boiling bath: one state far from the others."""
    flow = quiet(5.0)
    flow[1000:1800] = 0.0
    humidity = quiet(60.0)
    humidity[400:1000] = 100.0
    bath = quiet(20.0)
    bath[200:1200] = 100.0
    assert find_codes(flow, Kind.QUANTITY).values == ()
    assert find_codes(humidity, Kind.QUANTITY).values == ()
    assert find_codes(bath, Kind.TEMPERATURE).values == ()


@pytest.mark.parametrize("kind", [Kind.QUANTITY, Kind.INPUT])
def test_the_part_with_the_largest_values_decides_what_is_an_overload(kind: Kind) -> None:
    low = find_codes(np.full(100, 0.5), kind)
    high = find_codes(np.full(100, 2e7), kind)
    y = np.array([0.5, 2e7, 9.9e37])
    for both in (low.joined(high), high.joined(low)):
        assert reasons_of(y, kind, both).tolist() == [READING, READING, CODE]


def test_nothing_is_an_overload_where_nothing_is_known() -> None:
    assert reasons_of(np.array([0.0, 1e30]), Kind.QUANTITY, Codes()).tolist() == [READING, READING]
