"""Times of an index of pandas, and names of its columns."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from tcdyn.chain import Chain
from tcdyn.core.errors import InputError
from tcdyn.core.labels import common_index, labels_of, seconds_of_index
from tcdyn.series.index import even_interval_s
from tcdyn.smoothing import deconvolve, invert, smooth


def test_interval_is_that_of_clock_times_durations_and_numbers() -> None:
    stamps = pd.date_range("2026-03-29 01:59:58", periods=5, freq="250ms", tz="Europe/Berlin")
    for index in (stamps, stamps - stamps[0], pd.Index(0.25 * np.arange(5))):
        assert even_interval_s(index, "table") == pytest.approx(0.25)
        assert seconds_of_index(index) == pytest.approx(0.25 * np.arange(5))


def test_row_numbers_and_text_are_no_times() -> None:
    for index in (pd.RangeIndex(4), pd.Index(["a", "b"]), pd.Index([3, 1, 2])):
        assert even_interval_s(index, "table") is None
    assert even_interval_s(pd.Index([0, 2, 4], name="time_s"), "table") == pytest.approx(2.0)


@pytest.mark.parametrize(
    "times", [[0.0, 1.0, 2.0, 3.0, 5.0, 6.0, 7.0, 8.0], [0.0, 0.0, 0.0], [2.0, 1.0, 0.0]]
)
def test_uneven_times_are_refused_with_a_remedy(times: list[float]) -> None:
    with pytest.raises(InputError, match=r"not even.*resample"):
        even_interval_s(pd.Index(times), "table")


def test_series_with_different_indices_are_refused() -> None:
    a = pd.Series([1.0, 2.0])
    assert common_index([a, np.zeros(2), a], "table").equals(a.index)
    assert common_index([np.zeros(2)], "table") is None
    with pytest.raises(InputError, match="indices of the Series differ"):
        common_index([a, a.set_axis([1, 2])], "table")


def test_labels_are_those_of_columns_and_series() -> None:
    assert labels_of(pd.DataFrame({"a": [1], 2: [3]})) == ("a", "2")
    assert labels_of(pd.Series([1.0], name="T")) == ("T",)
    assert labels_of(pd.Series([1.0])) == labels_of([1.0]) == ()


def test_responses_and_compensated_traces_have_the_index_of_the_readings() -> None:
    index = pd.date_range("2026-03-01", periods=60, freq="100ms")
    table = pd.DataFrame(
        {"a": np.linspace(20.0, 30.0, 60), "b": np.linspace(30.0, 20.0, 60)}, index
    )
    readings = Chain(0.5).response(table, 0.1)
    pd.testing.assert_index_equal(readings.columns, table.columns)
    assert Chain(0.5).response(table["a"], 0.1).equals(readings["a"])
    readings += np.random.default_rng(0).normal(0.0, 0.05, readings.shape)
    for result in (
        smooth(readings, None, 0.5, find_events=False),
        deconvolve(readings, 0.1, 0.5)[0],
        invert(readings, 0.1, 0.5, 1.0),
    ):
        frame = result.to_frame()
        assert frame.index.equals(index)
        assert list(frame) == ["a_degC", "a_u_K", "b_degC", "b_u_K"]
