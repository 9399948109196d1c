"""Columns of labels that name channels, and those that do not."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from tcdyn.core import Array
from tcdyn.series.value_channels import LabelColumn, ValueChannels, find_channels
from tests.series.value_channel_study import detections, false_alarms


def column(labels: object) -> LabelColumn:
    """A column of labels."""
    codes, values = pd.factorize(np.asarray(labels, dtype=object))
    return LabelColumn("label", codes, tuple(map(str, values)))


def channels(labels: object, time_s: Array, y: Array) -> ValueChannels | None:
    """The channels that are found."""
    return find_channels(column(labels), time_s, {"value": y})


def step(time_s: Array, lag_s: float, noise_K: float = 0.05) -> Array:
    """A step by 60 K after 60 s behind a lag, with noise."""
    since = np.maximum(time_s - 60, 0)
    noise = np.random.default_rng(3).normal(0, noise_K, len(time_s))
    return np.asarray(20 + 60 * -np.expm1(-since / lag_s) + noise)


ROW = np.arange(400)


def test_rows_of_each_channel_are_counted() -> None:
    time_s = (ROW // 2).astype(float)
    y = np.where(ROW % 2, step(time_s, 3), step(time_s, 12))
    found = channels(np.where(ROW % 2, "CH2", "CH1"), time_s, y)
    assert found is not None
    assert found.rows == {"CH1": 200, "CH2": 200}
    assert not found.restarts


def test_equal_readings_at_equal_stamps_are_channels_by_the_stamps() -> None:
    time_s = (ROW // 4).astype(float)
    assert channels([f"CH{k % 4}" for k in ROW], time_s, np.full(400, 20.0))


def test_time_that_starts_again_at_each_label_may_be_runs() -> None:
    time_s = np.tile(np.arange(200.0), 2)
    found = channels(np.where(ROW < 200, "a", "b"), time_s, step(time_s, 12))
    assert found is not None
    assert found.restarts


def test_a_clock_that_is_set_back_once_makes_no_channels_of_two_modes() -> None:
    time_s = ROW - 30.0 * (ROW >= 200)
    assert not channels(np.where(ROW < 200, "heating", "idle"), time_s, step(time_s, 12))


def test_numbers_that_count_the_rows_of_a_second_are_no_channels() -> None:
    time_s = np.floor(ROW / 4)
    assert not channels(ROW % 4 * 250, time_s, step(ROW / 4, 12))


def test_rows_without_a_time_are_channels_by_their_order_and_values() -> None:
    y = np.where(ROW % 2, 20.0, 80.0) + np.random.default_rng(1).normal(0, 0.1, 400)
    assert find_channels(column(np.where(ROW % 2, "T1", "T2")), None, {"value": y})
    assert not find_channels(column(np.where(ROW < 200, "T1", "T2")), None, {"value": y})


def test_days_of_a_clock_without_date_are_no_channels_and_blocks_are() -> None:
    clock = ROW % 200  # a time of day, which the reader continues at midnight
    labels = np.where(ROW < 200, "a", "b")
    rising = np.where(ROW < 200, ROW, ROW + 86_400.0 - 200)
    assert find_channels(column(labels), rising, {"v": step(rising, 9)}, clock)
    days = ROW * 432.0  # two days of 200 rows each
    assert not find_channels(column(labels), days, {"v": step(days, 9)}, clock)


def test_day_names_are_part_of_the_clock() -> None:
    days = ["Mon", "Tue", "Wed", "Thu", "Fri", "Sat", "Sun"]
    y = 20 + 500.0 * (ROW % 7 < 5) + np.random.default_rng(1).normal(0, 1, 400)
    assert not channels([days[k % 7] for k in ROW], ROW * 86_400.0, y)


@pytest.mark.parametrize("seed", [11])
def test_columns_of_modes_states_and_notes_are_no_channels(seed: int) -> None:
    # 210 tables; `python -m tests.series.value_channel_study 840 2`: none of 840
    found = false_alarms(210, seed)
    assert sum(tables for tables, _ in found.values()) >= 200
    assert all(refused == 0 for _, refused in found.values())


@pytest.mark.parametrize("seed", [12])
def test_two_to_eight_channels_are_found_in_any_order(seed: int) -> None:
    # 105 tables; `python -m tests.series.value_channel_study 840 2`: all of 840
    found = detections(105, seed)
    assert all(refused == tables for tables, refused in found.values())


def test_two_columns_together_name_channels() -> None:
    time_s = (ROW // 4).astype(float)
    devices = column([f"d{k // 2 % 2}" for k in ROW])
    quantities = column(["T", "H"] * 200)
    y = np.where(ROW % 2, 50.0, step(time_s, 5))
    found = find_channels(devices.with_column(quantities), time_s, {"value": y})
    assert found is not None
    assert len(found.rows) == 4
    assert found.first == ("d0", "T")
