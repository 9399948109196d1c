"""Rows at uneven times: each is compensated at its own time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tcdyn.chain import Chain
from tcdyn.sensors import specified_sensor
from tcdyn.smoothing import Intensity, smooth
from tcdyn.smoothing.record import record_of
from tcdyn.smoothing.state_space import points_of, reads_before, smooth_record
from tcdyn.workflows.frames import compensate_frame
from tests.smoothing import own_times_study

Array = NDArray[np.float64]
DT_S, LAG_S, NOISE_K = 0.05, 0.5, 0.02
W = 2.0


def reading(t: Array) -> Array:
    """A sine of 5 K behind the lag, in its steady state."""
    return 60 + 5 * np.sin(W * t - np.arctan(W * LAG_S)) / np.hypot(1.0, W * LAG_S)


def uneven(seed: int, count: int = 400) -> tuple[Array, Array, Array]:
    """Times at which rows were due, how late they were taken, and their readings."""
    rng = np.random.default_rng(seed)
    due_s = DT_S * np.arange(count)
    late_s = np.clip(rng.normal(0, 0.25, count), -0.45, 0.45) * DT_S
    return due_s, late_s, reading(due_s + late_s) + rng.normal(0, NOISE_K, count)


@pytest.mark.e2e
def test_temperatures_are_those_at_the_times_of_the_readings() -> None:
    inside = slice(20, -20)
    squares, ignored_squares = [], []
    for seed in range(4):
        due_s, late_s, y = uneven(seed)
        result = smooth(y, DT_S, Chain(LAG_S), late_s=late_s)
        error = result.temperature[:, 0] - (60 + 5 * np.sin(W * (due_s + late_s)))
        assert np.mean(np.abs(error) < 1.96 * result.sd[:, 0]) > 0.9
        square = np.mean(error[inside] ** 2)
        assert np.sqrt(square) < 1.3 * np.median(result.sd[inside, 0])
        assert result.noise_sd[0] == pytest.approx(NOISE_K, rel=0.15)
        ignored = smooth(y, DT_S, Chain(LAG_S))
        worse = ignored.temperature[:, 0] - (60 + 5 * np.sin(W * due_s))
        squares.append(square)
        ignored_squares.append(np.mean(worse[inside] ** 2))
    assert np.sqrt(np.mean(ignored_squares)) > 1.5 * np.sqrt(np.mean(squares))


def test_a_reading_later_by_a_whole_sample_is_that_of_the_next_sample() -> None:
    """With one intensity and noise, a shift of the clock changes nothing."""
    _, _, y = uneven(1, 200)
    late_s = np.full(200, DT_S)
    intensity = Intensity.constant(50.0)
    noise_var = np.array([NOISE_K**2])
    even = smooth_record(record_of(y, DT_S, LAG_S, (), NOISE_K), noise_var, [intensity])
    late = smooth_record(
        record_of(y, DT_S, LAG_S, (), NOISE_K, late_s=late_s), noise_var, [intensity]
    )
    mine, theirs = late.at_samples(), even.at_samples()
    # before the first reading the late record has one more sample
    assert np.allclose(mine.temperature[5:], theirs.temperature[5:], atol=1e-6)
    assert np.allclose(mine.sd[5:], theirs.sd[5:], rtol=1e-6)


def test_points_are_in_the_order_of_time_where_readings_change_places() -> None:
    late_s = np.array([0.0, 0.8, -0.8, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]) * DT_S
    record = record_of(np.linspace(0, 1, 12), DT_S, LAG_S, (), NOISE_K, late_s=late_s)
    points = points_of(record, ())
    assert np.all(np.diff(points.time_s) > 0)
    expected_s = DT_S * np.arange(12) + late_s
    assert np.allclose(points.time_s[points.reading], expected_s, atol=DT_S / 128)
    assert np.allclose(points.time_s[points.sample], DT_S * np.arange(12))
    assert reads_before(record, record.sensors[0]).tolist() == [False] * 12
    late = replace(record.sensors[0], delay_s=0.5 * DT_S)
    assert reads_before(record, late).tolist() == [True, False] + [False] * 10


@pytest.mark.filterwarnings("ignore:T_degC. in a part of its spectrum")  # it is a sine
@pytest.mark.parametrize("signal", [own_times_study.sines, own_times_study.walk])
def test_a_table_with_uneven_rows_is_compensated_at_its_stamps(
    signal: own_times_study.Signal,
) -> None:
    """The truth is integrated in small steps; rows stray by a quarter of an interval (1 sd)."""
    sensor = specified_sensor("probe", ["T"], [(LAG_S, 0.005)], is_bare=True)
    frame, truth = own_times_study.record(signal, 0.25, 11)
    result = compensate_frame(frame, [sensor])
    error = result["T_degC"].to_numpy() - truth
    u = result["T_u_K"].to_numpy()
    assert np.mean(np.abs(error) < 1.96 * u) > 0.9
    codes = {finding.code for finding in result.attrs.get("findings", ())}
    assert "series.uneven" not in codes
