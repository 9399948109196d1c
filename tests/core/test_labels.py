"""Times of an index of pandas, and names of its columns."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from tcdyn.core.errors import InputError
from tcdyn.core.labels import common_index, even_interval_s, labels_of, seconds_of_index


def test_interval_is_that_of_clock_times_durations_and_numbers() -> None:
    stamps = pd.date_range("2026-03-29 01:59:58", periods=5, freq="250ms", tz="Europe/Berlin")
    for index in (stamps, stamps - stamps[0], pd.Index(0.25 * np.arange(5))):
        assert even_interval_s(index, "table") == pytest.approx(0.25)
        assert seconds_of_index(index) == pytest.approx(0.25 * np.arange(5))


def test_row_numbers_and_text_are_no_times() -> None:
    for index in (pd.RangeIndex(4), pd.Index(["a", "b"]), pd.Index([3, 1, 2])):
        assert even_interval_s(index, "table") is None
    assert even_interval_s(pd.Index([0, 2, 4], name="time_s"), "table") == pytest.approx(2.0)


@pytest.mark.parametrize("times", [[0.0, 1.0, 3.0], [0.0, 0.0, 0.0], [2.0, 1.0, 0.0]])
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
