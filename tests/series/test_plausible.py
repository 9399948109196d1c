"""Readings that a sensor cannot give are found; readings of a fast input through the chain are not
flagged."""

from __future__ import annotations

import numpy as np
import pytest

from tcdyn.series.plausible import dropout_codes, impossible_changes, out_of_range, overload_limit


def first_order(x: np.ndarray, dt_s: float, tau_s: float) -> np.ndarray:
    """Reading of a lag ``tau_s`` whose input ``x`` (N,) is held over each interval."""
    y = np.empty(len(x))
    y[0] = x[0]
    for k in range(1, len(x)):
        y[k] = x[k - 1] + (y[k - 1] - x[k - 1]) * np.exp(-dt_s / tau_s)
    return y


@pytest.mark.parametrize("tau_s", [0.05, 0.7, 2.0, 25.0])
@pytest.mark.parametrize("seed", range(5))
def test_readings_of_physical_inputs_are_not_flagged_as_unreachable(
    tau_s: float, seed: int
) -> None:
    """Inputs jump anywhere between 0 and 2500 degC, the worst that a process can do; noise 0.5
    K."""
    rng = np.random.default_rng(seed)
    x = np.repeat(rng.uniform(0, 2500, 60), rng.integers(1, 30, 60))
    y = first_order(x, 0.1, tau_s) + rng.normal(0, 0.5, len(x))
    assert not impossible_changes(y, 0.1, tau_s).any()


def test_unplugged_sensor_is_found_and_other_readings_are_kept() -> None:
    rng = np.random.default_rng(1)
    y = 850 - 50 * np.exp(-np.arange(1200) / 200) + rng.normal(0, 0.3, 1200)
    y[700:760] = 25 + rng.normal(0, 0.3, 60)  # the cold junction
    assert np.flatnonzero(impossible_changes(y, 1.0, 25.0)).tolist() == list(range(700, 760))


@pytest.mark.parametrize("share", [0.05, 0.2, 0.35])
def test_dense_drop_outs_are_found(share: float) -> None:
    """If nearly half of the samples are drop-outs, the two levels cannot be distinguished."""
    rng = np.random.default_rng(2)
    y = 800 + 40 * np.sin(np.arange(1200) / 100) + rng.normal(0, 0.3, 1200)
    is_dropout = rng.random(1200) < share
    y[is_dropout] = rng.normal(0, 0.3, is_dropout.sum())  # not one exact value
    assert np.array_equal(impossible_changes(y, 1.0, 25.0), is_dropout)


def test_every_second_reading_of_an_open_circuit_is_found() -> None:
    y = 850 + np.random.default_rng(3).normal(0, 0.3, 1200)
    y[700:900:2] = 2300
    assert np.flatnonzero(impossible_changes(y, 1.0, 25.0)).tolist() == list(range(700, 900, 2))


def test_spike_with_a_possible_rise_is_flagged_as_one_sample() -> None:
    """A rise by 30 K in one row can come through the lag, the fall back cannot."""
    y = 180 + np.random.default_rng(14).normal(0, 0.2, 800)
    y[300] += 30
    assert np.flatnonzero(impossible_changes(y, 0.05, 1.0)).tolist() == [300]


def test_chain_with_direct_share_has_no_unreachable_readings() -> None:
    y = np.where(np.arange(200) < 100, 20.0, 500.0)
    assert impossible_changes(y, 1.0, 25.0).any()
    assert not impossible_changes(y, 1.0, 25.0, direct_share=0.5).any()
    assert not impossible_changes(y, 1.0, 0.0).any()


def test_physical_range_is_that_of_thermocouples() -> None:
    assert out_of_range(np.array([-385.0, -273.0, 2315.0, 3001.0, np.inf, np.nan])).tolist() == [
        True,
        False,
        False,
        True,
        True,
        False,
    ]


@pytest.mark.parametrize("code", [9.9e37, 9.91e37, -9e9, 1e38, np.inf])
def test_overload_codes_are_found_in_any_unit(code: float) -> None:
    y = np.random.default_rng(4).normal(850, 20, 500)
    y[77] = code
    assert np.flatnonzero(np.abs(y) > overload_limit(y)).tolist() == [77]
    assert overload_limit(np.zeros(50)) > 1
    assert overload_limit(np.geomspace(1e-3, 1e3, 500)) > 1e3


@pytest.mark.parametrize("code", [0.0, -200.0, 2300.0])
def test_repeated_code_in_a_plunge_is_found(code: float) -> None:
    rng = np.random.default_rng(5)
    t = np.arange(600) * 0.05
    y = np.round(
        21 + 63 * np.where(t > 6, 1 - np.exp(-(t - 6) / 1.5), 0) + rng.normal(0, 0.05, 600), 2
    )
    is_dropout = rng.random(600) < 0.05
    y[is_dropout] = code
    assert np.array_equal(dropout_codes(y), is_dropout)


def test_process_states_are_not_drop_outs() -> None:
    rng = np.random.default_rng(6)
    relay = np.repeat([0.0, 60.0, 0.0, 60.0], 50)
    coarse_step = np.r_[np.full(100, 20.0), np.round(rng.normal(84, 1, 100))]
    ice_water = np.round(20 * np.exp(-np.arange(300) / 30), 2)
    pump = np.where(np.repeat(np.arange(10) % 2, 40) == 0, 0.0, rng.normal(50, 1, 400))
    coarse_wave = np.round(25 + 0.46 * np.sin(np.arange(3000) / 60), 1)
    for y in (relay, coarse_step, ice_water, pump, coarse_wave):
        assert not dropout_codes(y).any()


@pytest.mark.parametrize("code", [85.0, 0.0])
@pytest.mark.parametrize("rows", [4, 6])
def test_a_code_in_longer_runs_is_found_in_a_temperature(code: float, rows: int) -> None:
    """A sensor that starts again writes its code for some rows; the temperature goes on after."""
    rng = np.random.default_rng(6)
    t = np.arange(600.0)
    y = 20 + 40 * (1 - np.exp(-np.maximum(t - 100, 0) / 30)) + rng.normal(0, 0.05, 600)
    is_code = (t % 40 < rows) & (t > 30)
    y = np.round(np.where(is_code, code, y), 2)
    assert np.array_equal(dropout_codes(y, is_temperature=True), is_code)
    assert not dropout_codes(y).any()


def test_a_temperature_with_two_states_has_no_codes() -> None:
    """Between the states it passes through other readings, or stays in the second for long."""
    rng = np.random.default_rng(7)
    t = np.arange(1200.0)
    state = np.where(t % 100 < 50, 85.0, 20.0)
    slow = np.empty(1200)
    slow[0] = 20.0
    for k in range(1, 1200):
        slow[k] = slow[k - 1] + (state[k] - slow[k - 1]) * 0.5
    for y in (slow + rng.normal(0, 0.05, 1200), state + rng.normal(0, 0.05, 1200), slow):
        assert not dropout_codes(np.round(y, 1), is_temperature=True).any()
