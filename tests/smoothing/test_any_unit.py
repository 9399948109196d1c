"""Answers do not hang on the unit of temperature or on its zero; levels of intensity are those that
made the trace."""

from __future__ import annotations

import numpy as np
import pytest

from tcdyn.chain import NO_CONDITIONING, Chain
from tcdyn.rig.disk import Conditioning
from tcdyn.smoothing import Change, Intensity, deconvolve, invert, smooth
from tcdyn.smoothing.noise_levels import jumps_at
from tcdyn.smoothing.process_noise import (
    _best_ratio,
    channel_spans,
    exact_levels,
    segment,
    segment_levels,
    smearing_time_s,
    spectral_level,
)
from tcdyn.smoothing.record import record_of

CHAIN, DT = Chain((0.4,), conditioning=Conditioning(4.0, 2)), 0.05


def trace(n: int = 500, jump: float = 8.0, seed: int = 0) -> np.ndarray:
    """Two channels that swing slowly, jump in the middle, one with a spike; noise of 0.05 K."""
    rng, t = np.random.default_rng(seed), np.arange(n) * DT
    x = 60 + 4 * np.sin(t / 4) + np.where(t > n * DT / 2, jump, 0.0)
    y = np.stack(
        [CHAIN.response(x, DT), CHAIN.response(0.5 * x, DT)], axis=1
    ) + 0.05 * rng.standard_normal((n, 2))
    y[n // 5, 0] += 3.0
    return y


@pytest.mark.e2e
def test_a_smoothed_trace_with_a_hidden_jump_is_the_same_in_any_unit() -> None:
    """An event that nobody announced is found, weighed and averaged over: times and odds stay,
    temperatures scale."""
    y, size, zero = trace(160)[:, :1], 9.0, 500.0
    plain = smooth(y, DT, CHAIN, noise_sd=0.05)
    other = smooth(size * y + zero, DT, CHAIN, noise_sd=size * 0.05)
    assert len(plain.events_s) >= 1
    near = {"rel": 1e-4, "abs": 1e-4 * size}  # searches end where the likelihood no longer moves
    assert np.ravel(other.events_s) == pytest.approx(np.ravel(plain.events_s), abs=1e-4)
    assert other.temperature == pytest.approx(size * plain.temperature + zero, **near)
    assert other.sd == pytest.approx(size * plain.sd, **near)
    assert other.slope == pytest.approx(size * plain.slope, rel=1e-3, abs=1e-3 * size)
    assert other.intensity == pytest.approx(size**2 * plain.intensity, rel=1e-4)
    assert np.array_equal(other.flags, plain.flags)


@pytest.mark.e2e
def test_a_known_event_deconvolution_and_the_inverse_are_the_same_in_any_unit() -> None:
    y, lags = trace(200), 4e-4 * np.ones((2, 2))
    for made in (
        lambda k: smooth(
            k * y, DT, CHAIN, events_s=[5.0], event_u_s=0.05, split_u_s=0.03, lag_covariance=lags
        ),
        lambda k: deconvolve(k * y, DT, CHAIN, trials=9)[0],
        lambda k: invert(k * y, DT, CHAIN, 1.0),
    ):
        plain, other = made(1.0), made(9.0)
        assert other.temperature == pytest.approx(9 * plain.temperature, rel=1e-5)
        assert other.sd == pytest.approx(9 * plain.sd, rel=1e-4)
        assert other.noise_sd == pytest.approx(9 * plain.noise_sd, rel=1e-4)
        assert other.lag_sensitivity == pytest.approx(9 * plain.lag_sensitivity, rel=1e-4, abs=1e-3)


def wander(q: float, n: int, sd: float, seed: int, chain: Chain) -> np.ndarray:
    """A temperature whose slope wanders with the intensity ``q``, read through ``chain`` with white
    noise."""
    rng = np.random.default_rng(seed)
    slope = np.sqrt(q * DT) * rng.standard_normal(n).cumsum()
    x = DT * np.r_[0.0, slope[:-1].cumsum()]
    return chain.response(x, DT) + sd * rng.standard_normal(n)


@pytest.mark.parametrize("q", [0.01, 1.0])
def test_the_level_of_a_wandering_slope_is_recovered_by_spectrum_and_by_likelihood(
    q: float,
) -> None:
    """Some w_c T/pi waves above the noise tell it: of 8192 samples above a hundred, so to a factor
    1.5 (four sd)."""
    chain = Chain((0.4,), conditioning=NO_CONDITIONING)
    found = [spectral_level(wander(q, 8192, 0.05, s, chain), DT, chain, 0.05**2) for s in range(4)]
    assert np.exp(np.mean(np.log(found))) == pytest.approx(q, rel=0.35)
    assert max(found) < 2 * q < 4 * min(found)
    short = record_of(wander(q, 1200, 0.05, 9, chain), DT, chain, noise_sd=0.05)
    level, var = exact_levels(short, short.noise_sd**2, True)
    assert 0.4 * q < level[0] < 2.5 * q
    assert var == pytest.approx(short.noise_sd**2)
    free, told = exact_levels(short, 4 * short.noise_sd**2, False)  # the noise is found, too
    assert told[0] == pytest.approx(0.05**2, rel=0.15)  # 1200 samples: 4 % a standard deviation
    assert free[0] == pytest.approx(level[0], rel=0.5)


def test_segments_have_levels_of_their_own_and_a_short_one_the_largest_of_the_others() -> None:
    chain = Chain((0.4,), conditioning=NO_CONDITIONING)
    y = np.r_[wander(0.01, 1000, 0.05, 1, chain), np.zeros(1640)]
    late = wander(3.0, 1600, 0.05, 2, chain)
    y[1000:1040], y[1040:] = (
        y[999] + 0.05 * np.random.default_rng(3).standard_normal(40),
        y[999] + late,
    )
    events = (1000 * DT, 1040 * DT)
    short = record_of(y, DT, chain, events, noise_sd=0.05)
    (found,), _ = segment_levels(short, short.noise_sd**2, True)
    assert found.starts_s == (0.0, *events)
    quiet, between, wild = found.levels
    assert 0.3 * 0.01 < quiet < 3.5 * 0.01
    assert 0.3 * 3.0 < wild < 3.5 * 3.0
    assert between == max(quiet, wild)


def test_a_window_has_a_clock_of_its_own_and_what_an_instant_smears_is_a_lag_and_four_samples() -> (
    None
):
    whole = record_of(trace(), DT, CHAIN, (5.0, 12.5), noise_sd=0.05)
    part = segment(whole, 80, 200, whole.events_s)
    assert part.events_s == pytest.approx((1.0,))
    assert np.array_equal(part.y, whole.y[80:200])
    assert smearing_time_s(whole) == pytest.approx(CHAIN.lag_s + 4 * DT)
    assert channel_spans(whole, np.array([0.0025, 100.0])) == pytest.approx(
        [np.ptp(whole.y[:, 0]), 100.0]
    )


def test_of_a_trade_off_the_least_or_the_level_of_the_noise_is_taken_between_the_trials() -> None:
    levels = np.geomspace(1e-2, 1e4, 13)
    logs = np.log(levels)
    freedom = np.linspace(2, 50, 13)
    score = 0.01 * (logs - 3.3) ** 2  # cross-validation's, by its logarithm
    misfit = np.exp(score) * (1 - freedom / 200) ** 2
    assert _best_ratio("gcv", levels, misfit, misfit, freedom, 200, 1.0) == pytest.approx(
        np.exp(3.3), rel=1e-9
    )
    falls = np.exp(-0.5 * logs)
    assert _best_ratio(
        "discrepancy", levels, falls, falls, freedom, 200, np.exp(-1.1)
    ) == pytest.approx(np.exp(2.2))
    bend = np.where(logs < logs[6], 0.9, 0.1) * (logs[6] - logs)  # misfit falls fast, then slowly
    rough = np.where(logs < logs[6], 0.1, 0.9) * (logs - logs[6])
    corner = _best_ratio("l-curve", levels, np.exp(bend), np.exp(rough), freedom, 200, 1.0)
    assert corner == pytest.approx(levels[6])
    assert _best_ratio("gcv", levels, np.exp(logs), falls, np.zeros(13), 200, 1.0) == levels[0]


def test_an_intensity_moves_with_its_event_and_its_jumps_stand_at_its_start() -> None:
    q = Intensity((0.0, 7.0), (1.0, 4.0), (Change(7.0, level_sd=0.5, slope_sd=3.0),))
    moved = q.shifted(7.0, 8.5, shift_s=2.0)
    assert moved.starts_s == (-2.0, 6.5)
    assert moved.changes[0].start_s == 6.5
    whole = Intensity((0.0, 1.0), (1, 2))  # levels without a decimal point
    assert whole.at(1.0) == 2.0
    assert jumps_at([q], np.array([6.0, 7.0]))[:, 0].tolist() == [[0.0] * 4, [0.25, 9.0, 0.0, 0.0]]


def test_a_jump_of_unknown_instant_is_spread_evenly_over_its_width() -> None:
    """Of a jump spread over 2 s around 5 s, each knot gets the share of its half intervals."""
    change = Change(5.0, level_sd=0.5, slope_sd=3.0, width_s=2.0)
    knots = np.array([3.0, 4.5, 5.0, 5.25, 7.0])  # ends of the shares: 3.75, 4.75, 5.125, 6.125
    level, slope, *_ = jumps_at([Intensity((0.0,), (1.0,), (change,))], knots)[:, 0].T
    assert level == pytest.approx(0.25 * np.array([0.0, 0.375, 0.1875, 0.4375, 0.0]))
    assert slope.tolist() == [0.0, 0.0, 9.0, 0.0, 0.0]


def test_what_rests_and_what_is_missing_is_told_with_its_share() -> None:
    y = trace(400, jump=0.0)
    y[300:340, 0] = y[300, 0]  # of 400: stands still for two seconds
    y[100:112, 1] = np.nan  # nothing was read there, and nothing is left out
    y[[200, 220, 240, 260, 280], 1] += 60.0
    told = {f.code: f for f in record_of(y, DT, CHAIN, (), 0.05, ["a", "b"]).findings}
    still, gone = told["trace.stuck"], told["trace.bad"]
    assert (still.subject, still.numbers["first_sample"]) == ("a", pytest.approx(300, abs=1))
    assert still.numbers["percent"] == pytest.approx(100 * 40 / 400, abs=0.3)
    assert (gone.subject, gone.numbers["percent"]) == ("b", pytest.approx(100 * 5 / 388, abs=0.1))


@pytest.mark.parametrize("lag_s", [0.3, 10.0])
@pytest.mark.parametrize("dt_s", [0.5, 1.0])
@pytest.mark.parametrize("kind", ["ramp", "teeth", "step"])
def test_readings_without_noise_are_smoothed(lag_s: float, dt_s: float, kind: str) -> None:
    """Their noise is that of rounding, where the covariances of the filter were singular."""
    n = np.arange(60)
    teeth = np.concatenate([20 + 0.1 * n[:10], 20.1 + 0.01 * n[:50]])
    y = {"ramp": 20 + 0.01 * n, "teeth": teeth, "step": np.where(n > 30, 30.0, 20.0)}[kind]
    smoothed = smooth(y, dt_s, Chain(lag_s))
    assert np.isfinite(smoothed.temperature).all()
    if kind == "ramp":  # the temperature is ahead of the reading by slope times lag
        middle = smoothed.temperature[30, 0]
        ahead = middle - y[30] - 0.01 / dt_s * lag_s
        assert abs(ahead) < 4 * smoothed.sd[30, 0]
