"""The noise of a trace that its logger rounds: never below the rounding, untouched where steps are fine; its spikes."""

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


def rounded(sd_K: float, step_K: float) -> np.ndarray:
    y = RAMP + sd_K * np.random.default_rng(0).standard_normal(len(RAMP))
    return np.asarray(
        np.round(y / step_K) * step_K * 1.003 + 0.2
    )  # a static line comes after the rounding


@pytest.mark.parametrize("order", [1, 2, 3, 4])
@pytest.mark.parametrize("sd_K", [0.0, 0.02, 0.05])
def test_a_trace_of_coarse_steps_is_as_noisy_as_its_rounding(order: int, sd_K: float) -> None:
    found = float(white_noise_sd(rounded(sd_K, STEP_12_BIT_K), order))
    # the true scatter about the smooth curve lies between the rounding alone and both together
    assert STEP_12_BIT_K / 12**0.5 <= found <= 1.01 * np.hypot(sd_K, STEP_12_BIT_K / 12**0.5)


def test_fine_steps_and_unrounded_traces_have_no_rounding_to_speak_of() -> None:
    assert rounding_sd(rounded(0.12, 860 / 2**16)) == 0.0
    assert rounding_sd(RAMP) == 0.0
    assert rounding_sd(np.full(100, 20.0)) == 0.0


def test_columns_are_judged_each_by_itself() -> None:
    both = np.column_stack([rounded(0.02, STEP_12_BIT_K), rounded(0.12, 860 / 2**16)])
    both[500:510, 0] = np.nan
    coarse, fine = white_noise_sd(both, 3)
    assert coarse == pytest.approx(1.003 * STEP_12_BIT_K / 12**0.5, rel=1e-6)
    assert fine == pytest.approx(1.003 * 0.12, rel=0.05)  # 20000 samples, a median of them


def test_a_spike_of_fifteen_standard_deviations_is_found_and_clean_noise_loses_nothing() -> None:
    y = RAMP + 0.12 * np.random.default_rng(1).standard_normal(len(RAMP))
    at = np.arange(50, len(y), 400)
    # the median of seven strays by half a sd, the sample itself by one: 15 sd are never less than 8 from the median
    rule = SPIKES["reading"]
    noise = float(white_noise_sd(y, 1))
    assert noise == pytest.approx(0.12, rel=0.05)
    assert find_spikes(y, rule, noise).sum() == 0
    hit = y.copy()
    hit[at] += 15 * 0.12 * np.where(at % 800 < 400, 1, -1)
    assert (
        find_spikes(hit, rule, float(white_noise_sd(hit, 1))).nonzero()[0].tolist() == at.tolist()
    )
    # of a quiet trace, half a kelvin
    quiet = RAMP.copy()
    quiet[[500, 900]] += [0.45, 0.55]
    assert find_spikes(quiet, rule, float(white_noise_sd(quiet, 1))).nonzero()[0].tolist() == [900]


@pytest.mark.parametrize("use", ["reading", "traces", "plunge", "force", "compensator"])
def test_every_rule_finds_what_is_as_long_as_it_says_and_no_noise(use: SpikeUse) -> None:
    """The longest spike, three times the limit high, on a slow trace; one sample longer is a course, and is left."""
    rule = SPIKES[use]
    y = RAMP + 0.12 * np.random.default_rng(2).standard_normal(len(RAMP))
    assert not find_spikes(y, rule, 0.12).any()
    for length, wanted in ((rule.longest, True), (rule.width + 1, False)):
        hit = y.copy()
        at = slice(5000, 5000 + length)
        hit[at] += 3 * max(rule.sigmas * 0.12, rule.floor)
        assert find_spikes(hit, rule, 0.12)[5000 + length // 2] == wanted


def test_without_a_stated_noise_the_usual_distance_from_the_median_stands_for_it() -> None:
    y = 0.12 * np.random.default_rng(3).standard_normal(2000)
    y[700] += 3.0
    assert find_spikes(y, SpikeRule(6.0, 151)).nonzero()[0].tolist() == [700]


@pytest.mark.parametrize("use", ["reading", "traces", "plunge", "compensator", "answer"])
def test_spikes_are_those_of_a_median_of_every_sample(use: SpikeUse) -> None:
    """Whatever the trace: short, rounded, with gaps, half of it spikes; the rule as it is written, sample by sample."""
    rng = np.random.default_rng(6)
    found = 0
    for _ in range(300):
        rule = SPIKES[use].for_lag(rng.uniform(0, 40)) if rng.random() < 0.5 else SPIKES[use]
        y = (
            rng.normal(size=(n := int(rng.choice([1, 2, 5, 12, 40, 300]))))
            + rng.normal(size=n).cumsum()
        )
        y[hit := rng.random(n) < rng.choice([0, 0.02, 0.2, 0.5])] += rng.choice([-30, 8, 1e4])
        y[rng.random(n) < rng.choice([0, 0.1])] = np.nan
        sd = rng.choice([0.3, 1.0])
        there = np.flatnonzero(np.isfinite(y))
        x = y[there]
        if not len(x):
            continue
        off = [
            np.abs(
                x
                - np.median(
                    sliding_window_view(np.pad(x, rule.longest, mode="edge"), rule.width), axis=1
                )
            )
        ]
        if rule.local:
            near = sliding_window_view(np.pad(off[0], rule.local // 2, mode="edge"), rule.local)
            off.append(1.482602218505602 * np.median(near, axis=1))
        spikes = (off[0] > max(rule.sigmas * sd, rule.floor)) & (
            off[0] > rule.sigmas * off[-1] * bool(rule.local)
        )
        assert find_spikes(y, rule, sd).nonzero()[0].tolist() == there[spikes].tolist()
        found += int(spikes.sum()) * bool(hit.any())
    assert found > 100


def test_the_middle_is_numpys_median_of_what_is_there() -> None:
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
def test_too_few_samples_tell_no_noise(shape: tuple[int, ...]) -> None:
    found = white_noise_sd(np.ones(shape), 2)
    assert found.shape == shape[1:]
    assert np.isnan(found).all()
