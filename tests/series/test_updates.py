"""A sensor that is logged more slowly than the rows: its values are repeated or blank between new
ones."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tcdyn import compensate_frame
from tcdyn.chain import Chain
from tcdyn.core.errors import InputError
from tcdyn.sensors import SensorFile, sensor_file
from tcdyn.sensors.measure import sensor_from_pair
from tcdyn.sensors.sparse_rows import find_intervals, interval_residuals
from tcdyn.series.updates import find_updates
from tests.cli.test_main_job import tcdyn as run_cli
from tests.sensors.sensor_world import Array, two_in_a_gas, write

TAUS_S = (0.15, 0.5)


def pair(t: Array, a: Array, b: Array, names: tuple[str, str], **options: Any) -> SensorFile:
    """The lags of a pair as a user gets them: repeated values are found on the way."""
    return sensor_from_pair((t, a, b), names, **options)


def rows_of_updates(count: int, period: float, first: int = 0) -> Array:
    """The row (count,) whose value each row shows, if there is a new one every ``period`` rows."""
    update = np.floor((np.arange(count) - first) / period)
    return np.clip(np.ceil(update * period + first - 1e-9).astype(int), 0, count - 1)


def held(y: Array, period: float, first: int = 0) -> Array:
    """The trace with each value repeated until the next update."""
    return y[rows_of_updates(len(y), period, first)]


def blank(y: Array, period: int, first: int = 0) -> Array:
    """The trace with NaN between the updates."""
    out = np.full(len(y), np.nan)
    out[first::period] = y[first::period]
    return out


def recorded(seed: int, count: int = 2000) -> tuple[Array, Array, Array]:
    """Time [s] and two readings of one gas [degC], to two decimals."""
    t, first, second, _ = two_in_a_gas(seed, TAUS_S, 0.02, count, (0.5, 0.5))
    return t, first.round(2), second.round(2)


@pytest.mark.e2e
@pytest.mark.parametrize(
    "make",
    [
        lambda a, b: (a, held(b, 5)),
        lambda a, b: (a, held(b, 5, 3)),
        lambda a, b: (a, held(b, 4.3)),
        lambda a, b: (a, held(b, 20)),
        lambda a, b: (a, blank(b, 5)),
        lambda a, b: (held(a, 5), b),
        lambda a, b: (held(a, 2), held(b, 2)),
        lambda a, b: (held(a, 2), held(b, 6)),
    ],
    ids=[
        "slow 5",
        "slow 5, phase 3",
        "slow 4.3",
        "slow 20",
        "blank",
        "quick 5",
        "both 2",
        "2 and 6",
    ],
)
def test_a_slower_channel_leaves_the_lags_right(make) -> None:  # type: ignore[no-untyped-def]
    """Within 4 u and u within 15 %: in a study of 16 records a case the errors over u have an rms
    of 0.6 to 1.3."""
    t, a, b = recorded(1)
    first, second = make(a, b)
    made = pair(t, first, second, ("A", "B"), bare=True)
    for name, tau in zip("AB", TAUS_S, strict=True):
        lag = made.chain.channels[name].lag_s
        assert abs(lag.value - tau) < 4 * lag.u
        assert 0 < lag.u < 0.15 * tau
    is_repeated = bool(np.isfinite(first).all() and np.isfinite(second).all())
    assert ("series.repeats" in {f.code for f in made.findings}) == is_repeated


@pytest.mark.e2e
@pytest.mark.parametrize("gaps", [held, blank])
def test_a_column_logged_more_slowly_is_compensated_from_its_new_values(gaps) -> None:  # type: ignore[no-untyped-def]
    """With the repeats taken as readings the rms error is 290 K; without an estimate of the noise,
    as no five readings follow each other between blanks, it is 15 K."""
    t = np.arange(1200.0)
    cooling = 1 - np.exp(-np.clip(t - 900, 0, None) / 8)
    truth = 600 + np.clip(0.8 * (t - 300), 0, 160) - 100 * cooling
    chain = Chain([20.0, 5.0])
    logged = chain.response(truth, 1.0) + np.random.default_rng(3).normal(0, 0.15, len(t))
    y = gaps(logged.round(1), 5 if gaps is held else 2)
    probe = sensor_file("probe", {"T": chain}, "stated", np.array([[0.25]]), [0.0])
    done = compensate_frame(pd.Series(y, t, name="T"), probe)
    error = done["T"] - truth
    assert np.sqrt(np.mean(error**2)) < 2.0
    assert np.mean(np.abs(error) < 1.96 * done["T_u_K"]) > 0.9


@pytest.mark.e2e
@pytest.mark.parametrize("gaps", [held, blank])
def test_a_slow_column_is_as_good_as_a_table_of_its_new_values(gaps) -> None:  # type: ignore[no-untyped-def]
    """Its valid samples were taken for spikes, by a window in rows and not in samples."""
    rng = np.random.default_rng(2)
    t = np.arange(4000) * 0.1
    window = np.exp(-np.arange(300) / 30)
    fluid = 50 + np.convolve(np.cumsum(rng.normal(0, 1, 4000)), window / window.sum())[:4000]
    y = np.full(4000, fluid[0])
    keep = np.exp(-0.1 / 3)
    for k in range(1, 4000):
        y[k] = keep * y[k - 1] + (1 - keep) * 0.5 * (fluid[k] + fluid[k - 1])
    y += rng.normal(0, 0.05, 4000)
    probe = sensor_file("probe", {"T": Chain((3.0,))}, "stated", np.array([[0.05**2]]), [0.05])
    rms = []
    for time_s, readings, truth in ((t, gaps(y, 10), fluid), (t[::10], y[::10], fluid[::10])):
        done = compensate_frame(pd.Series(readings.round(3), time_s, name="T"), probe)
        assert not done.attrs["warnings"]
        rms.append(float(np.sqrt(np.nanmean((done["T"].to_numpy() - truth) ** 2))))
    assert rms[0] < 1.1 * rms[1]


def test_repeats_and_blanks_at_the_same_rows_give_the_same_lags() -> None:
    t, a, b = recorded(2)
    lags = [pair(t, a, y, ("A", "B"), bare=True).chain.channels for y in (held(b, 5), blank(b, 5))]
    for name in "AB":
        assert lags[0][name].lag_s.value == pytest.approx(lags[1][name].lag_s.value, rel=1e-9)


@pytest.mark.parametrize("gaps", [held, blank])
def test_new_values_that_alternate_as_a_scanner_s_are_an_error_with_the_remedy(gaps) -> None:  # type: ignore[no-untyped-def]
    t, a, b = recorded(3)
    with pytest.raises(
        InputError, match=r"A has a new value in 50 % .* B has a new value in 50 % .*at one rate"
    ):
        pair(t, gaps(a, 2), gaps(b, 2, 1), ("A", "B"))


def test_new_values_that_are_too_rare_for_the_shorter_lag_are_an_error() -> None:
    t, a, b = recorded(4)
    with pytest.raises(InputError, match=r"new value every 0\.1 s only .*faster"):
        pair(t, held(a, 5), held(b, 5), ("A", "B"))
    with pytest.raises(InputError, match="19 numbers; expected at least 60"):
        pair(t, a, held(b, 100), ("A", "B"))


def test_missing_values_in_all_steps_of_one_channel_are_an_error_not_an_uncertainty_of_zero() -> (
    None
):
    """Every other row of one channel, at random rows of the other: no interval of which one channel
    is complete."""
    t, a, b = recorded(5)
    rng = np.random.default_rng(5)
    a = np.where(rng.random(len(a)) < 0.1, a, np.nan)
    b = np.where(rng.random(len(b)) < 0.1, b, np.nan)
    with pytest.raises(InputError, match="rows can be used"):
        pair(t, a, b, ("A", "B"))


@pytest.mark.parametrize("step_K", [0.02, 0.25, 0.5, 1.5])
@pytest.mark.parametrize("slow_s", [(0.1, 1.0), (20.0, 60.0)])
def test_a_quantised_signal_is_not_taken_for_a_held_one(
    step_K: float, slow_s: tuple[float, ...]
) -> None:
    """Steps of 0.04 to 3 times the noise, in a quick and in a slow gas."""
    for seed in range(5):
        _, *traces, _ = two_in_a_gas(seed, TAUS_S, 0.02, 1500, (0.5, 0.5), slow_s=slow_s)
        for y in traces:
            updates = find_updates(np.round(y / step_K) * step_K)
            assert not updates.repeats_values
            assert updates.period == 1
            assert updates.new.all()


@pytest.mark.parametrize("period", [2, 5, 10, 50])
def test_rows_of_new_values_are_known_where_they_are_even(period: int) -> None:
    y = recorded(6, 3000)[2]
    for trace, is_held in ((held(y, period, 1), True), (blank(y, period, 1), False)):
        updates = find_updates(trace)
        assert (updates.repeats_values, updates.period, updates.first) == (
            is_held,
            period,
            1 % period,
        )
        assert np.flatnonzero(updates.new).tolist() == list(range(1, 3000, period))


def test_eliminated_values_give_the_residuals_of_the_full_least_squares() -> None:
    """The sum of squares equals that of all steps with the missing values as free parameters, to
    rounding."""
    rng = np.random.default_rng(7)
    count, period = 40, 4
    lags = np.array([[1.7], [5.2]]) * np.ones((2, count - 1))
    before, after = 0.5 - lags, 0.5 + lags
    y = rng.standard_normal((2, count))
    noise_K = (0.3, 0.8)
    new = (np.ones(count, dtype=bool), np.arange(count) % period == 0)
    intervals = find_intervals(new, np.zeros(count, dtype=np.intp))
    residuals = interval_residuals(before, after, y, noise_K, intervals)
    last = int(intervals.stop[-1])
    steps = np.zeros((2, last, last + 1))
    for k in range(2):
        for row in range(last):
            steps[k, row, row] = before[k, row]
            steps[k, row, row + 1] = after[k, row]
    known = new[1][: last + 1]
    rest = steps[0] @ y[0, : last + 1] - steps[1][:, known] @ y[1, : last + 1][known]
    covariance = (
        noise_K[0] ** 2 * steps[0] @ steps[0].T
        + noise_K[1] ** 2 * steps[1][:, known] @ steps[1][:, known].T
    )
    free = steps[1][:, ~known]
    weight = np.linalg.inv(covariance)
    fitted = free @ np.linalg.solve(free.T @ weight @ free, free.T @ weight @ rest)
    expected = (rest - fitted) @ weight @ (rest - fitted)
    assert residuals @ residuals == pytest.approx(expected, rel=1e-9)


def test_an_exponent_without_an_uncertainty_is_an_error_of_the_command(
    tmp_path: Path, capsys
) -> None:  # type: ignore[no-untyped-def]
    t, a, b = recorded(8, 300)
    log = write(tmp_path / "gas.csv", time_s=t.round(3), A_degC=a, B_degC=b, v=1 + t)
    words = ("--column", "A", "--column", "B", "--speed", "v", "--exponent", "0.5")
    assert run_cli("sensor", "pair", log, *words) == 2
    assert "0.5+-0.1" in capsys.readouterr().err
