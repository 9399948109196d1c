"""The fixed-interval smoother against dense Gaussian algebra, against simulated truth, and at its
limits."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from tcdyn.chain import NO_CONDITIONING, Chain
from tcdyn.core.errors import InputError
from tcdyn.rig.disk import Conditioning
from tcdyn.rig.static_line import StaticLine
from tcdyn.smoothing import Intensity, invert, smooth, window_covariance
from tcdyn.smoothing.record import SATURATED, SPIKE, STUCK
from tcdyn.smoothing.windows import window_means

B = Conditioning(cutoff_Hz=4.0, poles=2)

DT = 0.05
RISE_S = 5.0


def exponential_rise(n=800, dt=DT, fine=20):
    """Case B of the anchors: truth (n,), and what a lag of 1 s makes of it."""
    t = np.arange(n * fine) * dt / fine
    x = 25 + 155 * (1 - np.exp(-np.maximum(t - RISE_S, 0) / 3))
    return x[::fine], Chain((1.0,), conditioning=NO_CONDITIONING).response(x, dt / fine)[::fine]


def dense_operators(n, dt, chain, noise_sd, q, parts=10):
    """Truth and reading (n, k) of slopes that may jump ``parts`` times in each sampling interval,
    and the posterior covariance of the jumps."""
    run_in = 400
    k = np.arange(0.5, (n - 1) * parts)
    x_of = np.column_stack(
        [
            np.ones(n),
            np.arange(n) * dt,
            np.maximum(np.arange(n)[:, None] * parts - k, 0) * dt / parts,
        ]
    )
    t = np.arange((n + run_in) * parts) - run_in * parts
    long = np.column_stack(
        [np.ones(len(t)), t * dt / parts, np.maximum(t[:, None] - k, 0) * dt / parts]
    )
    y_of = chain.response(long, dt / parts)[run_in * parts :: parts]
    y_of[:, 1] = np.arange(n) * dt - chain.lag_s  # a ramp followed for ever comes late by lag_s
    precision = np.diag(np.r_[0.0, 0.0, np.full(len(k), parts / (q * dt))])
    return x_of, y_of, np.linalg.inv(y_of.T @ y_of / noise_sd**2 + precision)


def dense_covariance(n, dt, chain, noise_sd, q):
    x_of, _, cov = dense_operators(n, dt, chain, noise_sd, q)
    return x_of @ cov @ x_of.T


def dense_smoother(y, dt, chain, noise_sd, q):
    """Generalised least squares with N x N matrices, the chain by its own simulation."""
    x_of, y_of, cov = dense_operators(len(y), dt, chain, noise_sd, q)
    return x_of @ (cov @ (y_of.T @ y) / noise_sd**2), np.sqrt(np.diag(x_of @ cov @ x_of.T))


@pytest.mark.e2e
@pytest.mark.parametrize(
    "chain",
    [
        Chain((1.0,), conditioning=NO_CONDITIONING),
        Chain((0.6, 0.1), zero_s=0.05, conditioning=Conditioning(4.0, 2, "butterworth")),
        Chain((0.5,), delay_s=0.0, conditioning=Conditioning(4.0, 2)),
        Chain((0.3,), pair=(0.3, 0.6), conditioning=NO_CONDITIONING),
        Chain((0.3,), cement_s=0.8, conditioning=NO_CONDITIONING),
    ],
)
def test_smoother_equals_dense_least_squares_inside_the_record(chain):
    """Away from the start, where the priors on the chain's past differ; tolerance: slopes of the
    dense model jump ten times in a sampling interval."""
    rng = np.random.default_rng(1)
    y = np.cumsum(rng.standard_normal(160)) * 0.3 + 0.1 * rng.standard_normal(160)
    q = 1e6
    mean, sd = dense_smoother(y, DT, chain, 0.1, q)
    ours = smooth(y, DT, chain, noise_sd=0.1, intensity=q)
    inside = slice(100, 160)
    assert np.allclose(ours.temperature[inside, 0], mean[inside], atol=3e-3 * np.max(sd))
    assert np.allclose(ours.sd[inside, 0], sd[inside], rtol=5e-3)


def test_delay_shifts_the_record_exactly():
    """A dead time of a whole number of samples is a shift of the time axis, nothing else."""
    _, y = exponential_rise()
    y = y + 0.2 * np.random.default_rng(0).standard_normal(len(y))
    plain = smooth(y, DT, Chain((1.0,), conditioning=NO_CONDITIONING), noise_sd=0.2, intensity=30.0)
    late = smooth(
        y,
        DT,
        Chain((1.0,), delay_s=0.2, conditioning=NO_CONDITIONING),
        noise_sd=0.2,
        intensity=30.0,
    )
    assert np.allclose(late.temperature[200:-40], plain.temperature[204:-36], atol=1e-3)
    assert late.sd[-1, 0] > 1.5 * plain.sd[-1, 0]  # its last 0.2 s are extrapolated


def test_known_event_makes_the_transient_sharp():
    x, y = exponential_rise()
    y = y[:, None] + 0.2 * np.random.default_rng(0).standard_normal((len(y), 4))
    chain = Chain((1.0,), conditioning=NO_CONDITIONING)
    ours = smooth(y, DT, chain, events_s=(RISE_S,))
    error = ours.temperature - x[:, None]
    assert (
        np.sqrt(np.mean(error[60:740] ** 2)) < 0.15
    )  # half of what is possible without the event, 0.25
    assert np.mean(np.abs(error) < 1.96 * ours.sd) > 0.93


def test_a_kink_stated_to_a_tenth_of_a_second_has_an_interval_that_holds_about_it():
    """A slope that jumps by 10 K/s at an instant known to +- 0.1 s only, 40 draws of it: without
    the statement two thirds of the samples within a second lie outside; with it nine of ten lie
    inside (+- 3 %, and between the true and the stated instant the truth is bent, which one number
    of spread cannot
    follow)."""
    dt, at, u = 1 / 75, 4.0, 0.1
    t = np.arange(4 * 600) * dt / 4
    chain = Chain((0.6, 0.1), conditioning=B)
    fine = 100 - 10 * np.maximum(t - at, 0)
    x, clean = fine[::4], chain.response(fine, dt / 4)[::4]
    near = np.abs(t[::4] - at) < 1.0
    rng = np.random.default_rng(0)
    told, untold = [], []
    for _ in range(40):
        y = clean + 0.1 * rng.standard_normal(len(clean))
        drawn = at + u * rng.standard_normal()
        ours = smooth(y, dt, chain, noise_sd=0.1, intensity=0.01, events_s=(drawn,), event_u_s=u)
        error = np.abs(ours.temperature[:, 0] - x)[near]
        told.append(error < 1.96 * ours.sd[near, 0])
        ours = smooth(y, dt, chain, noise_sd=0.1, intensity=0.01, events_s=(drawn,))
        untold.append(error < 1.96 * ours.sd[near, 0])
    assert 0.82 < np.mean(told) < 0.97
    assert np.mean(untold) < 0.4


@pytest.mark.e2e
def test_means_just_after_an_uncertain_event_err_together_and_their_difference_does_not():
    """Two channels see one kink, stated to a tenth of a second; means over the third of a second
    after it."""
    rng, dt, at, u = np.random.default_rng(4), 1 / 75, 8.02, 0.1
    t, chain = np.arange(0.0, 12.0, dt), Chain((0.5, 0.1), conditioning=NO_CONDITIONING)
    since = np.maximum(t - at, 0.0)
    x = 120 - 10 * since
    clean, z, apart, untold = chain.response(x, dt), [], [], []
    line = StaticLine(gain=1.0, offset=0.0, covariance=((0, 0), (0, 0)), range_degC=(20, 160))
    for _ in range(40):
        y = clean[:, None] + 0.1 * rng.standard_normal((len(t), 2))
        drawn = at + u * rng.standard_normal()
        ours = smooth(y, dt, chain, noise_sd=0.1, intensity=0.01, events_s=(drawn,), event_u_s=u)
        traces = SimpleNamespace(
            columns=["a_degC", "b_degC"], lines=[line] * 2, measured_degC=y, chains=[chain] * 2
        )
        found = window_means("log", t, (at,), {"fast": traces}, {"fast": ours}, 0.3)
        c, first = (
            np.array(found["mean_covariance_K2"]),
            int(np.searchsorted(t, found["time_s"][0])),
        )
        off = np.array(found["mean_degC"]) - x[first : first + len(found["time_s"])].mean()
        z.append(off[0] / np.sqrt(c[0, 0]))
        apart.append((off[0] - off[1]) / found["difference_u_K"][0][1])
        instant = ours.shift_K[0][first : first + len(found["time_s"]), 0].mean()
        untold.append(off[0] / np.sqrt(c[0, 0] - instant**2))
    assert (
        np.mean(np.abs(z) < 1.96) > 0.8
    )  # between the true and the stated instant the truth is bent
    assert np.mean(np.abs(apart) < 1.96) > 0.85
    assert (
        0.6 < np.sqrt(np.mean(np.square(apart))) < 1.4
    )  # of 40: three sigma of a standard deviation are a third
    assert np.mean(np.abs(untold) < 1.96) < 0.6


def test_the_uncertainty_of_an_events_time_stays_with_its_event():
    """Whatever order events are given in, and whichever lie outside the record: one at its start or
    beyond its end is no event, and takes nobody's uncertainty with it."""
    _, y = exponential_rise()
    y = y + 0.2 * np.random.default_rng(0).standard_normal(len(y))
    times, u = (12.0, 5.0, 0.0, 99.0), (0.0, 0.3, 0.7, 0.9)
    ours = smooth(
        y,
        DT,
        Chain((1.0,), conditioning=NO_CONDITIONING),
        intensity=5.0,
        events_s=times,
        event_u_s=u,
    )
    assert ours.events_s == ((5.0, 0.3), (12.0, 0.0))


@pytest.mark.study
def test_the_split_of_a_lag_is_counted_and_the_band_holds():
    """One lag of 0.67 s divided as its record does not know to 0.08 s: 24 records, 5 % of which may
    miss."""
    rng, dt = np.random.default_rng(3), 1 / 30
    t = np.arange(0, 14, dt)
    x = 100 + 12 * np.sin(2 * np.pi * t / 7)
    held, held_without = [], []
    for _ in range(24):
        tau2 = np.clip(0.15 + 0.08 * rng.standard_normal(), 0.002, 0.335)
        y = Chain((0.67 - tau2, tau2), conditioning=B).response(x, dt) + 0.05 * rng.standard_normal(
            len(t)
        )
        for u, share in ((0.08, held), (0.0, held_without)):
            ours = smooth(
                y,
                dt,
                Chain((0.52, 0.15), conditioning=B),
                noise_sd=0.05,
                find_events=False,
                split_u_s=u,
            )
            share.append(np.mean(np.abs(ours.temperature[:, 0] - x) < 1.96 * ours.sd[:, 0]))
    assert np.mean(held) > 0.88 > np.mean(held_without) + 0.1
    c = window_covariance(
        y,
        dt,
        Chain((0.52, 0.15), conditioning=B),
        smooth(y, dt, Chain((0.52, 0.15), conditioning=B), split_u_s=0.08),
        0,
        200,
        240,
    )
    assert np.min(np.linalg.eigvalsh(c)) > -1e-9 * np.max(c)


@pytest.mark.parametrize("taus", [(0.52, 0.15), (0.15, 0.52, 0.05), (0.4, 0.4), (0.6,)])
def test_what_a_split_moves_is_the_difference_of_two_answers(taus: tuple[float, ...]):
    """The same record through the chain and through that whose lag is divided otherwise; away from
    the ends."""
    chain, u, t = Chain(taus, conditioning=B), 0.04, np.arange(0, 30, DT)
    y = chain.response(100 + 12 * np.sin(2 * np.pi * t / 7), DT)
    known = {"noise_sd": 0.01, "intensity": 50.0, "find_events": False}
    one, other = (
        smooth(y, DT, c, split_u_s=u, **known) for c in (chain, chain.with_split_shift(u))
    )
    inside = slice(int(5 / DT), int(25 / DT))
    moved, said = (other.temperature - one.temperature)[inside], one.lag_split_K[inside]
    assert np.abs(moved - said).max() < 0.1 * np.abs(moved).max()


def test_missing_samples_stay_local_and_widen_the_band():
    _, y = exponential_rise()
    y = y + 0.2 * np.random.default_rng(0).standard_normal(len(y))
    chain = Chain((1.0,), conditioning=NO_CONDITIONING)
    whole = smooth(y, DT, chain, noise_sd=0.2, intensity=Intensity.constant(5.0))
    gap = y.copy()
    gap[400:440] = np.nan
    holed = smooth(gap, DT, chain, noise_sd=0.2, intensity=Intensity.constant(5.0))
    far = np.r_[0:300, 540:800]
    assert np.allclose(
        holed.temperature[far], whole.temperature[far], atol=0.01
    )  # 1/10 of the standard deviation
    assert holed.sd[420, 0] > 2 * whole.sd[420, 0]
    assert np.all(np.isfinite(holed.temperature))


def test_shapes_that_do_not_agree_are_refused():
    with pytest.raises(InputError, match="2 channels but 1 chains"):
        smooth(np.zeros((50, 2)), DT, [Chain((1.0,), conditioning=B)])


def test_window_covariance_agrees_with_the_band_and_with_dense_algebra():
    _, y = exponential_rise()
    y = y + 0.2 * np.random.default_rng(0).standard_normal(len(y))
    chain = Chain((1.0,), conditioning=NO_CONDITIONING)
    ours = smooth(y, DT, chain, events_s=(RISE_S,), event_u_s=0.0, lag_covariance=[[0.0025]])
    c = window_covariance(y, DT, chain, ours, 0, 110, 160)
    assert np.allclose(
        np.sqrt(np.diag(c)),
        np.hypot(ours.sd_noise, 0.05 * ours.lag_sensitivity)[110:160, 0],
        rtol=0.02,
    )
    assert np.min(np.linalg.eigvalsh(c)) > -1e-9 * np.max(c)
    rng = np.random.default_rng(1)
    short = np.cumsum(rng.standard_normal(160)) * 0.3 + 0.1 * rng.standard_normal(160)
    fit = smooth(short, DT, chain, noise_sd=0.1, intensity=1e4)
    c = window_covariance(short, DT, chain, fit, 0, 100, 130)
    dense = dense_covariance(160, DT, chain, 0.1, 1e4)[100:130, 100:130]
    assert np.allclose(c, dense, atol=2e-3 * np.max(dense))


@pytest.mark.parametrize("pair", [None, (0.1, 0.6)])
def test_covariance_of_a_chain_with_stages_far_quicker_than_the_samples(pair):
    """Cement of 50 ms: its last lags are 0.4 ms, so these states hang on the slow ones: a singular
    covariance."""
    x, _ = exponential_rise()
    chain = Chain((1.0,), cement_s=0.05, pair=pair, conditioning=NO_CONDITIONING)
    y = chain.response(x, DT) + 0.2 * np.random.default_rng(0).standard_normal(len(x))
    ours = smooth(y, DT, chain, events_s=(RISE_S,), event_u_s=0.0)
    c = window_covariance(y, DT, chain, ours, 0, 110, 160)
    assert np.allclose(np.sqrt(np.diag(c)), ours.sd_noise[110:160, 0], rtol=0.02)
    assert np.min(np.linalg.eigvalsh(c)) > -1e-9 * np.max(c)


def test_constant_trace_gets_the_band_of_a_straight_line():
    """Nothing moves: the intensity goes to its floor and sd to that of a fitted line, 2 sigma /
    sqrt(N) at the ends, and somewhat more for level noise that cannot be excluded."""
    y = 80 + 0.15 * np.random.default_rng(0).standard_normal((1000, 6))
    fit = smooth(y, 1 / 75, Chain((0.6,), conditioning=B))
    middle = np.median(fit.sd[450:550])
    assert 0.15 / np.sqrt(1000) < middle < 0.15 / np.sqrt(1000) * 3.5
    assert np.mean(np.abs(fit.temperature - 80) < 1.96 * fit.sd) > 0.8


def test_spikes_and_stuck_samples_are_flagged_and_not_smeared():
    x, y = exponential_rise()
    rng = np.random.default_rng(3)
    y = y + 0.2 * rng.standard_normal(len(y))
    chain = Chain((1.0,), conditioning=NO_CONDITIONING)
    clean = smooth(y, DT, chain, events_s=(RISE_S,))
    hit = y.copy()
    hit[[300, 500, 501]] += [30.0, -20.0, -25.0]
    hit[600:650] = hit[600]
    ours = smooth(hit, DT, chain, events_s=(RISE_S,))
    assert np.all(ours.flags[[300, 500, 501], 0] & SPIKE)
    assert np.all(ours.flags[601:649, 0] & (STUCK | SATURATED))
    assert np.count_nonzero(ours.flags) < 56
    assert any("stuck" in w for w in ours.warnings)
    assert (
        np.max(np.abs(ours.temperature - clean.temperature)) < 0.5
    )  # a smeared 30 degC spike leaves several degC
    assert np.mean(np.abs(ours.temperature[:, 0] - x) < 3 * ours.sd[:, 0]) > 0.97


@pytest.mark.e2e
def test_samples_missing_about_a_known_event_widen_the_band_and_the_band_holds():
    """0.45 s of nothing at the unloading, and 1 % lost elsewhere."""
    dt, event, lost = 1 / 75, 10.0, slice(733, 767)
    t = np.arange(4 * 1500) * dt / 4
    fine = 120 - 12 * (1 - np.exp(-np.maximum(t - event, 0) / 1.0))
    chain = Chain((0.55, 0.12), conditioning=Conditioning(4.0, 2))
    clean, x = chain.response(fine, dt / 4)[::4], fine[::4]
    held = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        y = clean + 0.15 * rng.standard_normal(len(clean))
        y[rng.random(len(y)) < 0.01] = np.nan
        likeliest = smooth(y, dt, chain, noise_sd=0.15, events_s=(event,)).intensities
        given = {"noise_sd": 0.15, "events_s": (event,), "intensity": likeliest}
        whole = smooth(y, dt, chain, **given)
        y[lost] = np.nan
        ours = smooth(y, dt, chain, **given)
        assert ours.sd[lost].max() > whole.sd[lost].max()
        held.append(np.abs(ours.temperature - x[:, None])[lost] < 1.96 * ours.sd[lost])
    assert (
        np.mean(held) > 0.85
    )  # samples of a gap move together: ten records of about three each, 95 +- 4 %


def test_dead_channel_is_refused():
    with pytest.raises(InputError, match="repeat one value"):
        smooth(
            np.column_stack(
                [np.full(500, 80.0), 80 + np.random.default_rng(0).standard_normal(500)]
            ),
            DT,
            Chain((1.0,), conditioning=B),
        )


def test_sentences_call_a_channel_by_its_name_and_count_from_one_without():
    y = 80 + np.random.default_rng(0).standard_normal((500, 2))
    y[100:180, 1] = 80.0
    done = smooth(y, DT, Chain((1.0,), conditioning=B), intensity=10.0, names=["fast_d", "fast_e"])
    assert done.warnings[0].startswith("fast_e: stuck")
    done = smooth(y, DT, Chain((1.0,), conditioning=B), intensity=10.0)
    assert done.warnings[0].startswith("channel 2: stuck")
    assert "channel 2: noise" in done.summary()
    y[7:, 1] = np.nan
    with pytest.raises(InputError, match="fast_e has fewer"):
        smooth(y, DT, Chain((1.0,), conditioning=B), noise_sd=1.0, names=["fast_d", "fast_e"])
    with pytest.raises(InputError, match="2 channels but 1 names"):
        smooth(y, DT, Chain((1.0,), conditioning=B), names=["fast_d"])


def test_a_quiet_soak_in_coarse_steps_is_not_stuck():
    """A ramp and a soak of 150 rows at 0.1 K, with 0.01 K of noise: the soak is one value."""
    t = 5.0 * np.arange(600)
    truth = np.interp(t, [0, 300, 2250, 3000], [4.2, 4.2, 72.3, 72.3])
    chain = Chain((8.0,), conditioning=NO_CONDITIONING)
    noise = 0.01 * np.random.default_rng(0).standard_normal(len(t))
    y = np.round(chain.response(truth, 5.0) + noise, 1)
    assert np.ptp(y[-140:]) == 0.0
    done = smooth(y, 5.0, chain)
    error = done.temperature[:, 0] - truth
    assert not done.flags.any()
    assert np.sqrt(np.mean(error**2)) < 0.1
    assert np.mean(np.abs(error) < 1.96 * done.sd[:, 0]) > 0.93


@pytest.mark.parametrize("lost", [slice(0, 100), slice(500, 600), slice(250, 350)])
def test_nothing_is_reported_farther_than_a_lag_from_any_reading(lost):
    """A ramp whose start, end or middle is missing for 20 lags."""
    t = 5.0 * np.arange(600)
    truth = np.interp(t, [0, 300, 1500, 3000], [80.0, 80.0, 600.0, 560.0])
    chain = Chain((25.0,), conditioning=NO_CONDITIONING)
    y = chain.response(truth, 5.0) + 0.2 * np.random.default_rng(0).standard_normal(len(t))
    y[lost] = np.nan
    temperature, sd = smooth(y, 5.0, chain).determined_estimates()
    reported = np.isfinite(temperature[:, 0])
    is_lost = np.isin(np.arange(len(t)), np.arange(len(t))[lost])
    assert reported[~is_lost].all()
    assert 5 <= reported[is_lost].sum() <= 12
    error = np.abs(temperature[:, 0] - truth)[reported]
    assert np.mean(error < 1.96 * sd[reported, 0]) > 0.93


@pytest.mark.e2e
def test_a_trace_that_rests_on_the_steps_of_its_logger_is_not_stuck():
    """12 bits over 860 degC and 0.02 K of noise on a slow cooling: most samples repeat, and nothing
    is broken."""
    t = np.arange(0, 60, DT)
    x = 80 - 4 * (1 - np.exp(-t / 30.0))
    step = 860 / 2**12
    y = np.round((x + 0.02 * np.random.default_rng(3).standard_normal(len(x))) / step) * step
    ours = smooth(y, DT, Chain((0.02,), conditioning=NO_CONDITIONING))
    assert not np.any(ours.flags & (STUCK | SATURATED))
    off = np.abs(ours.temperature[:, 0] - x)
    assert np.sqrt(np.mean(off**2)) < 0.5 * step  # the rounding itself is 0.29 of a step
    assert (
        np.mean(off < 1.96 * ours.sd[:, 0]) > 0.9
    )  # no noise shakes it loose: it stays for seconds


def test_lag_uncertainty_moves_the_answer_as_the_sensitivity_says():
    """Lag longer by 10 ms: the answers differ by lag_sensitivity * 10 ms, to second order and
    regularisation."""
    _, y = exponential_rise()
    chain = Chain((1.0,), conditioning=NO_CONDITIONING)
    y = y + 0.05 * np.random.default_rng(0).standard_normal(len(y))
    a = smooth(y, DT, chain, noise_sd=0.05, intensity=100.0, events_s=(RISE_S,))
    b = smooth(
        y, DT, chain.with_lag_shift(0.01), noise_sd=0.05, intensity=100.0, events_s=(RISE_S,)
    )
    moved = (b.temperature - a.temperature)[:, 0]
    assert np.allclose(
        moved[110:300], 0.01 * a.lag_sensitivity[110:300, 0], atol=0.02 * np.max(np.abs(moved))
    )


@pytest.mark.e2e
def test_heavy_tailed_noise_costs_less_when_it_is_told():
    """Student's t with two degrees of freedom: reweighting must beat least squares on the same
    records."""
    x, y = exponential_rise()
    noisy = y[:, None] + 0.2 * np.random.default_rng(5).standard_t(2.0, (len(y), 8))
    chain = Chain((1.0,), conditioning=NO_CONDITIONING)
    answers = [
        smooth(noisy, DT, chain, events_s=(RISE_S,), heavy_tails=flag) for flag in (False, True)
    ]
    plain, told = (answer.temperature - x[:, None] for answer in answers)
    assert np.sqrt(np.mean(told**2)) < np.sqrt(np.mean(plain**2))


def test_inverse_has_the_interface_of_the_smoother_and_a_band_that_holds_its_shift():
    x, y = exponential_rise()
    y = y[:, None] + 0.2 * np.random.default_rng(0).standard_normal((len(y), 5))
    y[300, 0] = np.nan
    ours = invert(y, DT, Chain((1.0,), conditioning=NO_CONDITIONING), 1.0)
    assert ours.flags[300, 0] == 1
    assert np.mean(np.abs(ours.temperature - x[:, None])[20:] < 1.96 * ours.sd[20:]) > 0.93


@pytest.mark.study
def test_case_b_coverage_over_draws_of_noise_and_lag(draws):
    """Case B with nothing announced; chain used is 1.0 +- 0.05 s drawn. 40 records: +- 4 % in the
    transient.

    The band is too wide here: 98.8 % of the samples of 40 draws lie in a band of 95 %. Its median u
    is half the rms error, which the first and last samples make. Above 99.5 % this test fails.
    """
    x, y = exponential_rise()
    rng = np.random.default_rng(0)
    t = np.arange(len(x)) * DT
    transient, edges = (t >= 4.75) & (t <= 10), np.r_[0:60, 740:800]
    inside, errors = [], []
    for _ in range(n := draws(40)):
        record = y + 0.2 * rng.standard_normal(len(y))
        exact = smooth(record, DT, Chain((1.0,), conditioning=NO_CONDITIONING))
        errors.append(exact.temperature[60:740, 0] - x[60:740])
        lag = 1.0 + 0.05 * rng.standard_normal()
        ours = smooth(
            record, DT, Chain((lag,), conditioning=NO_CONDITIONING), lag_covariance=[[0.05**2]]
        )
        inside.append(np.abs(ours.temperature[:, 0] - x) < 1.96 * ours.sd[:, 0])
    covered = np.array(inside)
    assert np.sqrt(np.mean(np.array(errors) ** 2)) < 0.25
    assert 0.93 < covered.mean() < 0.995
    least = 0.95 - 0.4 / np.sqrt(n)
    assert covered[:, transient].mean() > least
    assert covered[:, edges].mean() > least


@pytest.mark.parametrize(
    ("name", "column"),
    [
        ("Probe 1 [°C]", "Probe 1"),
        ("T (degC)", "T"),
        ("T/°C", "T"),
        ("T_degC", "T"),
        ("T", "T"),
        ("T [K]", "T [K]"),  # not said to be degrees Celsius under its own name
    ],
)
def test_a_unit_of_degrees_celsius_stands_once_in_the_columns_of_the_table(
    name: str, column: str
) -> None:
    y = pd.Series(np.linspace(20.0, 30.0, 100), name=name)
    table = smooth(y, DT, 1.0, noise_sd=0.1, intensity=1.0).to_frame()
    assert list(table.columns) == [f"{column}_degC", f"{column}_u_K"]
