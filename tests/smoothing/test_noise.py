"""Noise that the conditioning filter coloured, autoregressions, hum and bursts, made by recursions
of their own."""

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.signal import butter, lfilter, sosfilt, welch

from tcdyn.chain import Chain
from tcdyn.chain.bursts import estimate_and_whiten_noise
from tcdyn.chain.logger_noise import LoggerNoise, estimate_logger_noise, noise_power_ratio
from tcdyn.core import Array
from tcdyn.estimation.trace_noise import SPIKES, white_noise_sd
from tcdyn.rig.disk import Conditioning
from tcdyn.smoothing.record import record_of
from tcdyn.smoothing.smoother import deconvolve, smooth
from tests.partition.noise_study import before_the_filter, bursts, filtered
from tests.smoothing.test_noise_parts import find_bursts

DT_S, B = 1 / 75, Conditioning(4.0, 2, "cascade")
CHAIN = Chain((0.55, 0.12), conditioning=B)
EVENT_S = 10.0037


def junction(t: Array, kink: bool) -> Array:
    """Case C: a kink of 12 K at 1 s, or a slow swing."""
    if kink:
        return np.where(
            t < EVENT_S, 120.0, 120 - 12 * (1 - np.exp(-np.maximum(t - EVENT_S, 0.0) / 1.0))
        )
    return 60 + 0.02 * t + np.sin(2 * np.pi * t / 60)


def logged(kink: bool, duration_s: float) -> tuple[Array, Array, Array]:
    """Times, truth and clean reading behind the chain, by first-order recursions on a grid sixteen
    times finer."""
    fine = np.arange(int(duration_s * 75) * 16 + 1) * DT_S / 16
    truth = junction(fine, kink)
    y = truth
    for tau in (0.55, 0.12, 1 / (8 * np.pi), 1 / (8 * np.pi)):
        keep = np.exp(-DT_S / 16 / tau)
        share = tau / (DT_S / 16) * (1 - keep)
        y = lfilter([1 - share, share - keep], [1, -keep], y - y[0]) + y[0]
    return fine[::16], truth[::16], y[::16]


def autoregressive(rng: np.random.Generator, n: int, by: float) -> Array:
    """AR(1) of standard deviation 0.15 K."""
    return (
        0.15 * np.sqrt(1 - by**2) * lfilter([1.0], [1.0, -by], rng.standard_normal(n + 500))[500:]
    )


def hum(rng: np.random.Generator, n: int) -> Array:
    """Mains of 0.3 K at 50 Hz, its third harmonic of 0.15 K near the second multiple of the rate,
    white 0.15 K."""
    t = np.arange(n) * DT_S
    waves = 0.3 * np.sin(100 * np.pi * t + rng.uniform(0, 6)) + 0.15 * np.sin(
        2 * np.pi * 150.06 * t + rng.uniform(0, 6)
    )
    return waves + 0.15 * rng.standard_normal(n)


def disturbance(world: str, rng: np.random.Generator, n: int) -> Array:
    """One of the worlds (n,) [K]."""
    if world == "hum":
        return hum(rng, n)
    return (
        before_the_filter(rng, n, 0.15, 1.0)
        if world == "before"
        else autoregressive(rng, n, float(world[2:]))
    )


def test_noise_before_and_after_the_filter_is_told_apart_and_made_white() -> None:
    rng = np.random.default_rng(3)
    y = 80 + np.stack([before_the_filter(rng, 15_000) for _ in range(4)], axis=1)
    noise = estimate_logger_noise([y], DT_S, B, np.full(4, 0.01))
    assert noise.is_coloured
    assert noise.shaping == B
    assert np.median(noise.before_filter_K) == pytest.approx(0.12 * 0.97, rel=0.05)
    assert np.median(noise.after_filter_K) == pytest.approx(0.12 * np.sqrt(1 - 0.97**2), rel=0.05)
    f, power = welch(noise.whiten(y, DT_S), 75, nperseg=256, axis=0)
    level = np.sqrt(power * 37.5).mean(axis=1)
    assert np.all(np.abs(level[(f > 0.5) & (f < 12)] / np.median(noise.level_K) - 1) < 0.15)


@pytest.mark.parametrize(("stated_Hz", "taken"), [(2.0, True), (2.2, True), (6.0, False)])
def test_the_stated_filter_is_taken_unless_another_lag_is_clearly_better(
    stated_Hz: float, taken: bool
) -> None:
    rng = np.random.default_rng(8)
    decay = np.exp(-2 * np.pi * 2.0 * DT_S)
    y = lfilter([1 - decay], [1, -decay], rng.standard_normal((9_000, 4)), axis=0)
    stated = Conditioning(stated_Hz, 1)
    assert (
        estimate_logger_noise([80 + y], DT_S, stated, np.full(4, 0.1)).shaping == stated
    ) is taken


@pytest.mark.parametrize(
    ("rate_Hz", "seen_Hz", "rests"),
    [
        (75.0, 25.0, True),
        (75.0, 15.0, True),
        (80.0, 30.0, False),
        (25.3, 0.6, False),
        (100.0, 50.0, True),
        (75.0, 10.0, False),
    ],
)
def test_only_harmonics_that_come_to_rest_are_taken_for_temperature(
    rate_Hz: float, seen_Hz: float, rests: bool
) -> None:
    """75 Hz: the third of 50 Hz and the fifth of 60 Hz; 80 Hz: 100, 150, 200 and 250 Hz are seen at
    20, 10, 40, 10."""
    sd = np.full(2, 0.1)
    noise = LoggerNoise(
        0 * sd, sd, sd, B, hum_lines=((seen_Hz, np.array([0.3, 0.0])),), rate_Hz=rate_Hz
    )
    assert (noise.aliasing_u_K > 0).tolist() == [rests, False]


def test_white_noise_stays_as_it_is() -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        y = 80 + np.linspace(0, 3, 6000)[:, None] + 0.12 * rng.standard_normal((6000, 6))
        noise = estimate_logger_noise([y], DT_S, B, np.full(6, 0.12))
        assert not noise.is_coloured, seed
        assert not noise.hum_lines, seed
        assert np.all(noise.level_K == 0.12)


@pytest.mark.e2e
@pytest.mark.parametrize(
    ("world", "worst_K"), [("before", 0.186), ("ar0.4", 0.124), ("ar0.8", 0.158), ("hum", 0.165)]
)
def test_a_kink_is_compensated_as_well_as_by_a_filter_tuned_with_the_truth_in_hand(
    world: str, worst_K: float
) -> None:
    """Case C: limits are those of a Savitzky-Golay inverse tuned with the truth (measured beside
    these worlds)."""
    t, truth, clean = logged(True, 40.0)
    near = (t > EVENT_S - 1) & (t < EVENT_S + 5)
    squares, covered = [], []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        done = smooth(
            np.round((clean + disturbance(world, rng, len(t))) / 0.005) * 0.005,
            DT_S,
            CHAIN,
            events_s=(EVENT_S,),
        )
        off = done.temperature[near, 0] - truth[near]
        squares.append(np.mean(off**2))
        covered.append(np.mean(np.abs(off) < 1.96 * done.sd[near, 0]))
        if world == "hum":
            found, folded = [f for f in done.findings if f.code in ("noise.hum", "noise.folded")]
            assert found.numbers["f_Hz"] == pytest.approx(25.0, abs=0.1)
            assert folded.numbers["folded_K"] > 0.05
            assert found.numbers["amplitude_K"] == pytest.approx(0.3, rel=0.3)
    assert np.sqrt(np.mean(squares)) < worst_K
    assert np.mean(covered) > 0.9


@pytest.mark.parametrize("rate_Hz", [8.0, 12.0, 16.0, 30.0])
def test_strong_hum_is_no_temperature(rate_Hz: float) -> None:
    """Eight times the noise; inverted as a temperature it is 5 K to 20 K."""
    t = np.arange(0, 120, 1 / rate_Hz)
    truth = 300 + 40 * (1 - np.exp(-np.clip(t - 30, 0, None) / 4))
    wave = 0.8 * np.sin(2 * np.pi * 50.01 * t + 1)
    y = Chain(0.8).response(truth, 1 / rate_Hz) + wave
    y += np.random.default_rng(0).normal(0, 0.1, len(t))
    done = smooth(y, 1 / rate_Hz, Chain(0.8))
    error = done.temperature[:, 0] - truth
    assert "noise.hum" in {f.code for f in done.findings}
    assert np.sqrt(np.mean(error**2)) < 0.8
    assert np.mean(np.abs(error) < 1.96 * done.sd[:, 0]) > 0.9


@pytest.mark.parametrize(("f_Hz", "is_reported"), [(2.92, True), (0.05, False)])
def test_a_fast_wave_that_is_no_mains_hum_is_reported(f_Hz: float, is_reported: bool) -> None:
    """It may be interference; as a temperature it is sqrt(1 + (2 pi f T)^2) times larger."""
    t = np.arange(0, 600, 0.1)
    y = 300 + 0.8 * np.sin(2 * np.pi * f_Hz * t) + np.random.default_rng(0).normal(0, 0.1, len(t))
    waves = [f for f in smooth(y, 0.1, Chain(0.8)).findings if f.code == "noise.wave"]
    assert bool(waves) == is_reported
    if waves:
        ratio = waves[0].numbers["temperature_K"] / waves[0].numbers["amplitude_K"]
        assert ratio == pytest.approx(np.hypot(1, 2 * np.pi * f_Hz * 0.8), rel=0.02)


@pytest.mark.e2e
@pytest.mark.parametrize(
    ("world", "duration_s", "seeds"),
    [
        ("before", 60, range(6)),
        ("ar0.6", 60, range(6)),
        pytest.param("ar0.6", 200, (104, 108, 116), marks=pytest.mark.long),
    ],
)
def test_a_slow_swing_under_coloured_noise_is_not_made_worse(
    world: str, duration_s: float, seeds: Sequence[int]
) -> None:
    """0.1.0 was 6 K off here, with 20 % of the samples in its band; the tuned filter is 0.035 K
    off.

    In 200 s the swing is in waves that a spectrum leaves out: these seeds were taken for far too
    calm.
    """
    t, truth, clean = logged(False, duration_s)
    inside = (t > 1) & (t < duration_s - 1)
    squares, covered = [], []
    for seed in seeds:
        done = smooth(clean + disturbance(world, np.random.default_rng(seed), len(t)), DT_S, CHAIN)
        off = done.temperature[inside, 0] - truth[inside]
        squares.append(np.mean(off**2))
        covered.append(np.mean(np.abs(off) < 1.96 * done.sd[inside, 0]))
    assert np.sqrt(np.mean(squares)) < 0.035
    assert np.mean(covered) > 0.85


def test_bursts_are_found_by_their_shape_and_a_bend_is_none() -> None:
    t, _, kink = logged(True, 60.0)
    for seed in range(6):
        rng = np.random.default_rng(seed)
        quiet = kink + 0.12 * rng.standard_normal(len(t))
        assert not find_bursts(quiet, DT_S, 0.12, B, 0.67).any()
        added = bursts(rng, len(t), 15.0)
        found = find_bursts(quiet + added, DT_S, 0.12, B, 0.67)
        assert np.abs(added[~found]).max(initial=0.0) < 0.6, (
            seed
        )  # pulses are of 1.5 K and more before the filter
        assert np.count_nonzero(found & (np.abs(added) < 0.01)) < 0.01 * len(t)


@pytest.mark.parametrize("gap_s", [0.1, 0.3, 0.5])
def test_two_bursts_close_together_are_two_and_not_one_between_them(gap_s: float) -> None:
    t, _, kink = logged(True, 40.0)
    rng = np.random.default_rng(2)
    rings = np.zeros(len(t) * 8)
    for start_s in (24.0, 24.25 + gap_s):
        rings[int(start_s * 600) : int((start_s + 0.25) * 600)] = -5.4
    added = filtered(rings)
    found = find_bursts(kink + 0.12 * rng.standard_normal(len(t)) + added, DT_S, 0.12, B, 0.67)
    assert np.abs(added[~found]).max() < 0.4
    assert np.count_nonzero(found & (np.abs(added) < 0.01)) < 25  # the gap at most


@pytest.mark.e2e
@pytest.mark.parametrize("length", [3, 8, 15, 30])
def test_a_burst_beside_the_unloading_leaves_the_answer_alone(length: int) -> None:
    t, truth, clean = logged(True, 40.0)
    rng = np.random.default_rng(length)
    pulse = np.zeros(len(t) * 8)
    pulse[int((EVENT_S + 0.6) * 600) :][: length * 8] = 3.0
    done = smooth(
        clean + filtered(pulse) + 0.15 * rng.standard_normal(len(t)),
        DT_S,
        CHAIN,
        events_s=(EVENT_S,),
    )
    near = (t > EVENT_S - 1) & (t < EVENT_S + 5)
    off = done.temperature[near, 0] - truth[near]
    assert np.abs(off).max() < max(5 * done.sd[near, 0].max(), 0.3)
    assert np.mean(np.abs(off) < 1.96 * done.sd[near, 0]) > 0.8


def test_noise_from_before_the_filter_is_planned_with_as_strong_as_it_is_at_low_frequency() -> None:
    rng = np.random.default_rng(5)
    slow = [
        np.var(filtered(rng.standard_normal(8 * 40_000)).reshape(-1, 400).mean(axis=1))
        for _ in range(8)
    ]
    all_of_it = np.var(filtered(rng.standard_normal(8 * 40_000)))
    assert all_of_it / (400 * np.mean(slow)) == pytest.approx(noise_power_ratio(B, DT_S), rel=0.1)


def band_limited(rng: np.random.Generator, n: int) -> Array:
    """A wind that blows between 4 and 6 Hz, 0.15 K of it upon white noise of 0.05 K (n,)."""
    wind = sosfilt(
        butter(4, (4.0, 6.0), "bandpass", fs=75.0, output="sos"), rng.standard_normal(n + 500)
    )[500:]
    return 0.15 * wind / np.std(wind) + 0.05 * rng.standard_normal(n)


@pytest.mark.parametrize("world", ["white", "wind", "blue"])
def test_noise_that_no_part_of_the_model_explains_is_said(world: str) -> None:
    rng = np.random.default_rng(11)
    y = 60 + np.stack([band_limited(rng, 15_000) for _ in range(3)], axis=1)
    if world == "white":
        y = 60 + 0.12 * rng.standard_normal((15_000, 3))
    elif world == "blue":  # each sample takes back most of what the one before it brought
        white = rng.standard_normal((15_001, 3))
        y = 60 + 0.1 * (white[1:] - 0.8 * white[:-1])
    told = estimate_logger_noise([y], DT_S, B, white_noise_sd(y))
    assert [f.code for f in told.findings("fast")].count("noise.unexplained") == (world != "white")


@pytest.mark.study
def test_bursts_in_every_segment_are_not_taken_for_coloured_noise() -> None:
    """One in six seconds in every channel: they are found, the noise is white, and nothing passes
    for an event."""
    t, truth, clean = logged(False, 60.0)
    for seed in (0, 1):
        rng = np.random.default_rng(seed)
        added = [0.12 * rng.standard_normal(len(t)) + bursts(rng, len(t), 6.0) for _ in range(4)]
        done = smooth(clean[:, None] + np.stack(added, axis=1), DT_S, CHAIN)
        off = np.abs(done.temperature - truth[:, None])
        assert "noise.coloured" not in {f.code for f in done.findings}
        assert done.events_s == ()
        assert off.max() < 0.5  # tens of kelvin where a burst passes for an event
        assert np.mean(off < 1.96 * done.sd) > 0.9


@pytest.mark.e2e
@pytest.mark.parametrize("length_s", [0.13, 0.19, 0.27])
def test_a_weak_burst_is_found_where_the_other_channels_show_nothing(length_s: float) -> None:
    """In noise from before the filter; alone, a channel cannot tell it from a jump and its end. A
    kink in all stays."""
    t, _, clean = logged(True, 60.0)
    pulse = np.zeros(len(t) * 8)
    pulse[30 * 600 :][: int(length_s * 600)] = 1.4
    within = (t > 29.9) & (t < 30.2 + length_s)
    found, alone = [], []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        y = clean[:, None] + np.stack(
            [before_the_filter(rng, len(t), 0.12, 0.97) for _ in range(4)], axis=1
        )
        y[:, 2] += filtered(pulse)
        for some, moved in ((y, found), (y[:, 2:3], alone)):
            white_K, chains = white_noise_sd(some), [CHAIN] * some.shape[1]
            moved.append(
                estimate_and_whiten_noise(
                    [some], [DT_S], B, white_K, chains, SPIKES["compensator"]
                )[1][0][1]
            )
    assert min(np.count_nonzero(m[within, 2]) for m in found) > 0.8 * length_s / DT_S
    assert max(np.mean(m[~within]) for m in found) < 2e-3
    assert not any(m[np.abs(t - EVENT_S) < 1].any() for m in found)
    assert sum(not m[within].any() for m in alone) > 1


@pytest.mark.parametrize("others", ["quiet", "missing"])
def test_what_one_junction_alone_does_is_not_cut_out_as_a_burst(others: str) -> None:
    """A splash of 6 K for half a second, where the others show nothing or cannot."""
    t, _, clean = logged(False, 40.0)
    splash = np.zeros(len(t) * 8)
    splash[20 * 600 : int(20.5 * 600)] = 6.0
    for tau_s in (0.55, 0.12):
        keep = np.exp(-DT_S / 8 / tau_s)
        splash = lfilter([0, 1 - keep], [1, -keep], splash)
    for seed in range(3):
        y = clean[:, None] + 0.12 * np.random.default_rng(seed).standard_normal((len(t), 4))
        y[:, 0] += filtered(splash)
        if others == "missing":
            y[(t > 16) & (t < 24), 1:] = np.nan
        _, [(_, moved)] = estimate_and_whiten_noise(
            [y], [DT_S], B, np.full(4, 0.12), [CHAIN] * 4, SPIKES["compensator"]
        )
        assert np.count_nonzero(moved[:, 0]) < 4


@pytest.mark.study
def test_a_channel_that_mostly_rests_or_is_missing_tells_nothing_of_the_noise() -> None:
    """Steps of 0.5 K on 0.01 K of noise; six samples of ten lost: the levels stay those of
    differences and steps."""
    t, _, clean = logged(False, 40.0)
    rng = np.random.default_rng(1)
    coarse = np.round((clean + 0.01 * rng.standard_normal(len(t))) * 2) / 2
    done = smooth(coarse, DT_S, CHAIN)
    assert done.noise_sd[0] == pytest.approx(0.5 / 12**0.5, rel=0.3)
    holed = clean + 0.12 * rng.standard_normal(len(t))
    holed[rng.uniform(size=len(t)) < 0.6] = np.nan
    for y in (holed, np.stack([clean + 0.12 * rng.standard_normal(len(t)), holed], axis=1)):
        done = smooth(y, DT_S, CHAIN)
        assert done.noise_sd == pytest.approx(0.12, rel=0.25)
        assert np.isfinite(done.sd).all()


def test_the_noise_of_six_channels_is_told_though_a_seventh_stands_still() -> None:
    rng = np.random.default_rng(3)
    y = 60 + np.stack(
        [before_the_filter(rng, 6000, 0.12, 0.97) for _ in range(6)] + [np.zeros(6000)], axis=1
    )
    noise = estimate_logger_noise([y], DT_S, B, np.maximum(white_noise_sd(y), 1e-6))
    assert noise.is_coloured
    assert noise.before_filter_K[:6] == pytest.approx(0.97 * 0.12, rel=0.25)
    assert noise.level_K[6] == 1e-6


def test_deconvolution_leaves_bursts_out_and_tells_of_the_noise() -> None:
    t, truth, clean = logged(False, 40.0)
    rng = np.random.default_rng(4)
    pulse = np.zeros(len(t) * 8)
    pulse[20 * 600 : int(20.2 * 600)] = 5.0
    done, _ = deconvolve(clean + 0.12 * rng.standard_normal(len(t)) + filtered(pulse), DT_S, CHAIN)
    off = np.abs(done.temperature[75:-75, 0] - truth[75:-75])
    assert np.count_nonzero(done.flags) > 10
    assert np.max(off / done.sd[75:-75, 0]) < 4.5
    done, _ = deconvolve(clean + before_the_filter(rng, len(t), 0.12, 0.97), DT_S, CHAIN)
    assert "noise.coloured" in {f.code for f in done.findings}


def test_plunges_sampled_at_two_rates_are_each_made_white_at_their_own() -> None:
    rng = np.random.default_rng(5)
    quick, chains = (
        80 + np.stack([before_the_filter(rng, 6000, 0.12, 0.97) for _ in range(3)], axis=1),
        [CHAIN] * 3,
    )
    step = np.where(np.arange(6000) < 3000, 0.0, -40.0)[:, None]
    traces, dts = [quick, (quick + step)[::2]], [DT_S, 2 * DT_S]
    noise, (_, (slow, moved)) = estimate_and_whiten_noise(
        traces, dts, B, white_noise_sd(quick), chains, SPIKES["plunge"]
    )
    assert moved.mean() < 0.05
    own, other = (noise.whiten(traces[1], dt) for dt in reversed(dts))
    assert np.allclose(slow[~moved], own[~moved])
    assert np.abs(other - own).max() > 1.0


@pytest.mark.study
@pytest.mark.parametrize("rate_Hz", [10.0, 50.0, 100.0])
def test_a_temperature_that_swings_is_not_called_hum(rate_Hz: float) -> None:
    """A wave that the chain lets through, in a record of few segments, is the temperature's own."""
    dt = 1 / rate_Hz
    for seed in range(12):
        rng = np.random.default_rng(seed)
        tau = dt * rng.uniform(5, 60)
        t = np.arange(int(rng.choice([300, 600, 1500]))) * dt
        x = 20 * np.sin(2 * np.pi * t / (tau * rng.uniform(10, 40)))
        keep = np.exp(-dt / tau)
        y = lfilter([1 - keep], [1, -keep], x) + rng.uniform(0.05, 0.3) * rng.standard_normal(
            len(t)
        )
        assert not [f for f in record_of(y, dt, Chain([tau])).findings if f.code == "noise.hum"], (
            seed
        )
