"""Noise of a trace that its logger rounds: never below the rounding, unchanged for fine steps; and
spike detection."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from numpy.lib.stride_tricks import sliding_window_view

from tcdyn.estimation.trace_noise import (
    SPIKES,
    SpikeRule,
    SpikeUse,
    fast_nanmedian,
    find_spikes,
    rounding_sd,
    white_noise_sd,
)

STEP_12_BIT_K = 860 / 2**12
RAMP = 100 + 3 * np.sin(np.arange(20000) / 2250)


def rounded_trace(sd_K: float, step_K: float) -> np.ndarray:
    """A slow signal with white noise, rounded to steps and scaled by a static line."""
    y = RAMP + sd_K * np.random.default_rng(0).standard_normal(len(RAMP))
    # the static line is applied after the rounding
    return np.asarray(np.round(y / step_K) * step_K * 1.003 + 0.2)


@pytest.mark.parametrize("order", [1, 2, 3, 4])
@pytest.mark.parametrize("sd_K", [0.0, 0.02, 0.05])
def test_noise_of_a_coarsely_rounded_trace_includes_the_rounding(order: int, sd_K: float) -> None:
    estimate = float(white_noise_sd(rounded_trace(sd_K, STEP_12_BIT_K), order))
    # the true scatter about the smooth signal lies between the rounding alone and both together
    assert STEP_12_BIT_K / 12**0.5 <= estimate <= 1.01 * np.hypot(sd_K, STEP_12_BIT_K / 12**0.5)


def test_fine_steps_and_unrounded_traces_have_zero_rounding_noise() -> None:
    assert rounding_sd(rounded_trace(0.12, 860 / 2**16)) == 0.0
    assert rounding_sd(RAMP) == 0.0
    assert rounding_sd(np.full(100, 20.0)) == 0.0


def test_noise_is_estimated_separately_for_each_column() -> None:
    columns = np.column_stack(
        [rounded_trace(0.02, STEP_12_BIT_K), rounded_trace(0.12, 860 / 2**16)]
    )
    columns[500:510, 0] = np.nan
    coarse, fine = white_noise_sd(columns, 3)
    assert coarse == pytest.approx(1.003 * STEP_12_BIT_K / 12**0.5, rel=1e-6)
    assert fine == pytest.approx(1.003 * 0.12, rel=0.05)  # a median of 20000 samples


def test_spikes_of_fifteen_standard_deviations_are_found_without_false_alarms() -> None:
    y = RAMP + 0.12 * np.random.default_rng(1).standard_normal(len(RAMP))
    spike_rows = np.arange(50, len(y), 400)
    # the median of seven varies by half a sd, the sample by one: 15 sd are never less than 8 from
    # the median
    rule = SPIKES["reading"]
    noise = float(white_noise_sd(y, 1))
    assert noise == pytest.approx(0.12, rel=0.05)
    assert find_spikes(y, rule, noise).sum() == 0
    with_spikes = y.copy()
    with_spikes[spike_rows] += 15 * 0.12 * np.where(spike_rows % 800 < 400, 1, -1)
    assert (
        find_spikes(with_spikes, rule, float(white_noise_sd(with_spikes, 1))).nonzero()[0].tolist()
        == spike_rows.tolist()
    )
    # in a noise-free trace the limit is half a kelvin
    noise_free = RAMP.copy()
    noise_free[[500, 900]] += [0.45, 0.55]
    assert find_spikes(noise_free, rule, float(white_noise_sd(noise_free, 1))).nonzero()[
        0
    ].tolist() == [900]


@pytest.mark.parametrize("use", ["reading", "traces", "plunge", "force", "compensator"])
def test_every_rule_finds_spikes_up_to_its_longest_length(use: SpikeUse) -> None:
    """A spike of the longest length and three times the limit on a slow trace is found. One sample
    longer counts as signal."""
    rule = SPIKES[use]
    y = RAMP + 0.12 * np.random.default_rng(2).standard_normal(len(RAMP))
    assert not find_spikes(y, rule, 0.12).any()
    for length, expected in ((rule.longest, True), (rule.width + 1, False)):
        with_spike = y.copy()
        spike_rows = slice(5000, 5000 + length)
        with_spike[spike_rows] += 3 * max(rule.sigmas * 0.12, rule.floor)
        assert find_spikes(with_spike, rule, 0.12)[5000 + length // 2] == expected


def test_rule_without_noise_uses_the_median_absolute_deviation() -> None:
    y = 0.12 * np.random.default_rng(3).standard_normal(2000)
    y[700] += 3.0
    assert find_spikes(y, SpikeRule(6.0, 151)).nonzero()[0].tolist() == [700]


@pytest.mark.parametrize("use", ["reading", "traces", "plunge", "compensator"])
def test_fast_spike_search_equals_the_rule_evaluated_at_every_sample(use: SpikeUse) -> None:
    """Random traces: short, rounded, with gaps, half of it spikes. The rule is evaluated
    literally, sample by sample."""
    rng = np.random.default_rng(6)
    n_found = 0
    for _ in range(300):
        rule = SPIKES[use].for_lag(rng.uniform(0, 40)) if rng.random() < 0.5 else SPIKES[use]
        n = int(rng.choice([1, 2, 5, 12, 40, 300]))
        y = rng.normal(size=n) + rng.normal(size=n).cumsum()
        is_spike = rng.random(n) < rng.choice([0, 0.02, 0.2, 0.5])
        y[is_spike] += rng.choice([-30, 8, 1e4])
        y[rng.random(n) < rng.choice([0, 0.1])] = np.nan
        sd = rng.choice([0.3, 1.0])
        finite_rows = np.flatnonzero(np.isfinite(y))
        x = y[finite_rows]
        if not len(x):
            continue
        deviations = [
            np.abs(
                x
                - np.median(
                    sliding_window_view(np.pad(x, rule.longest, mode="edge"), rule.width), axis=1
                )
            )
        ]
        if rule.local:
            windows = sliding_window_view(
                np.pad(deviations[0], rule.local // 2, mode="edge"), rule.local
            )
            deviations.append(1.482602218505602 * np.median(windows, axis=1))
        spikes = (deviations[0] > max(rule.sigmas * sd, rule.floor)) & (
            deviations[0] > rule.sigmas * deviations[-1] * bool(rule.local)
        )
        kinks = kink_samples(x, spikes, 0.7 * max(rule.sigmas * sd, rule.floor))
        expected = finite_rows[spikes & ~kinks]
        assert find_spikes(y, rule, sd).nonzero()[0].tolist() == expected.tolist()
        n_found += int(spikes.sum()) * bool(is_spike.any())
    assert n_found > 100


def kink_samples(x: np.ndarray, spikes: np.ndarray, tolerance: float) -> np.ndarray:
    """Spikes on the line through the three nearest samples of one side that are no spikes."""
    out = np.zeros(len(x), dtype=bool)
    good = np.flatnonzero(~spikes)
    for i in np.flatnonzero(spikes):
        for side in (good[good < i][-3:], good[good > i][:3]):
            if len(side) == 3:
                mean = x[side].mean()
                slope = (x[side[2]] - x[side[0]]) / (side[2] - side[0])
                out[i] |= abs(x[i] - mean - slope * (i - side.mean())) < tolerance
    return out


def test_the_tip_of_a_lagged_reading_is_no_spike_and_spikes_on_it_are() -> None:
    """A reading that rises and falls by 8 noise sds a sample: its tips lie far from the median."""
    rule = SPIKES["compensator"]
    noise = 0.05 * np.random.default_rng(4).standard_normal(2000)
    triangle = 0.4 * np.abs((np.arange(2000) + 0.3) % 50 - 25)
    assert (
        find_spikes(triangle + noise, rule, 0.05).sum() <= 15
    )  # more than 200 lie beyond the limit
    rows = np.array([37, 512, 513, 1061])
    with_spikes = triangle + noise
    with_spikes[rows] += [2.0, 2.0, 1.5, -2.0]
    assert find_spikes(with_spikes, rule, 0.05)[rows].all()


def test_fast_nanmedian_equals_numpy() -> None:
    rng = np.random.default_rng(5)
    for _ in range(200):
        x = rng.normal(size=(*rng.integers(1, 4, rng.integers(0, 3)), rng.integers(1, 30))).round(
            int(rng.integers(0, 3))
        )
        x[rng.random(x.shape) < rng.choice([0.0, 0.3, 0.9])] = np.nan
        x[rng.random(x.shape) < 0.05] = np.inf
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # of nothing but NaN
            assert np.array_equal(fast_nanmedian(x), np.nanmedian(x, axis=-1), equal_nan=True)
    assert fast_nanmedian(np.zeros((2, 0))).tolist() == pytest.approx([np.nan, np.nan], nan_ok=True)


@pytest.mark.parametrize("shape", [(2,), (2, 3), (1,)])
def test_too_few_samples_give_nan_noise(shape: tuple[int, ...]) -> None:
    estimate = white_noise_sd(np.ones(shape), 2)
    assert estimate.shape == shape[1:]
    assert np.isnan(estimate).all()
