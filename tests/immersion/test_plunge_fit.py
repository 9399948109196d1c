"""The grey-box plunge fit on an independent simulation: recovery, honesty, speed, and what it says."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import control
import numpy as np
import pytest
from plunge_simulator import draw_pairs, same_pairs, simulate
from plunge_study import OWN_LAG_S, describe, make_runs, study

from immersion.correlations import correlation
from immersion.cylinder import apply_conditioning, lag_on_grid
from immersion.plunge_data import PlungeRun, make_blocks
from immersion.plunge_fit import identify_plunges
from immersion.plunge_model import build_run_models, chain_on_grid, predict
from immersion.plunge_parameters import PlungeParameters, PlungePriors, stages
from immersion.plunge_result import PlungeFit
from immersion.radial import GridInterpolation
from tcdyn.chain import STRUCTURES, Chain
from tcdyn.chain.logger_noise import WhitenedConditioning
from tcdyn.chain.rational import Factor, Rational
from tcdyn.chain.rational import simulate as simulate_rational
from tcdyn.core.errors import InputError
from tcdyn.estimation.trace_noise import white_noise_sd
from tcdyn.rig.disk import CHANNELS, Conditioning
from tcdyn.rig.rigfile import load_rig

SETUP = load_rig().disk_setup("fast")


@cache
def pair() -> tuple[list[PlungeRun], np.ndarray]:
    """One pair of plunges, 60 s, channels' lags spread by 0.04 s; true lags (6,)."""
    rng = np.random.default_rng(4)
    d = same_pairs(1)
    shift = np.array([0.03, -0.05, 0.01, 0.04, -0.02, -0.01])
    d.tau1 = d.tau1 + shift
    times, readings = simulate(d, 60.0, rng)
    return make_runs(d, times, readings, rng), (d.tau1 + d.tau2)[0] + OWN_LAG_S


@cache
def fitted() -> PlungeFit:
    return identify_plunges(pair()[0], SETUP)


@pytest.mark.study
def test_lags_are_recovered_within_their_stated_uncertainty() -> None:
    fit = fitted()
    true = pair()[1]
    assert abs(fit.common_lag_s.value - true.mean()) < 3 * fit.common_lag_s.u
    error = np.array([fit.differential_lag_s[c].value for c in CHANNELS]) - (true - true.mean())
    u = np.array([fit.differential_lag_s[c].u for c in CHANNELS])
    assert np.all(np.abs(error) < 3.5 * u)
    assert np.sqrt(np.mean(error**2)) < 0.03  # 0.01 expected; three times that


def test_the_covariance_is_mostly_common() -> None:
    fit = fitted()
    c = fit.lag_covariance
    assert fit.common_lag_s.u == pytest.approx(
        np.sqrt(c.mean()), rel=0.15
    )  # slope along the profile is nearly one
    assert max(e.u for e in fit.differential_lag_s.values()) < fit.common_lag_s.u
    assert np.all(np.linalg.eigvalsh(c) > 0)


def test_chains_and_estimates_agree() -> None:
    fit = fitted()
    for c in CHANNELS:
        assert fit.chains[c].lag_s == pytest.approx(fit.lag_s[c].value, abs=1e-9)
        assert fit.lag_s[c].value == pytest.approx(
            fit.common_lag_s.value + fit.differential_lag_s[c].value, abs=2e-3
        )  # the common lag is the posterior mean, held on a grid of refits
    assert fit.converged


def test_the_correlations_agree_once_their_scale_is_free() -> None:
    form = fitted().model_form
    assert set(form.common_lag_s) == {"churchill-chu-laminar", "mcadams", "similarity"}
    assert form.u_common_s < 0.05  # they share the quarter power; only its additive 0.68 differs
    assert np.ptp(list(form.common_lag_s.values())) < 0.1


def test_the_summary_says_what_limits_the_common_lag() -> None:
    fit = fitted()
    text = fit.summary()
    assert "common lag" in text
    assert "burst" in fit.sentence
    shares = {s.source: s for s in fit.budget}
    assert shares["noise alone"].u_common_s < 0.2 * shares["all of the fit"].u_common_s


@pytest.mark.study
def test_a_plunge_that_cannot_separate_lag_from_burst_says_so() -> None:
    runs = [replace(r, entry=replace(r.entry, u_s=1.0)) for r in pair()[0][:1]]
    wide = PlungePriors(burst_log=2.0, burst_shape_log=1.0, burst_time_log=1.0)
    fit = identify_plunges(runs, SETUP, priors=wide, alternatives=())
    assert "cannot separate the lag from the burst" in fit.sentence
    assert fit.common_lag_s.u > 2 * fitted().common_lag_s.u


def test_derivatives_are_those_of_the_model() -> None:
    run = pair()[0][0]
    layout = PlungeParameters(1, CHANNELS, "P2")
    mean, sd = layout.prior(PlungePriors(), [0.05], [26.0])
    theta = mean.copy()
    theta[layout.at("lag")] = 0.6
    models = build_run_models([run], [make_blocks(run)], SETUP, layout, correlation("5.4"), theta)
    theta[layout.at("ln_conductivity")], theta[layout.at("depth")] = (
        0.01,
        5e-5,
    )  # away from where it was built
    _, (jac,), _ = predict(models, layout, theta)
    for i, name in enumerate(layout.names()):
        step = 1e-4 * (sd[i] if np.isfinite(sd[i]) else 1.0)
        up = theta.copy()
        down = theta.copy()
        up[i] += step
        down[i] -= step
        numeric = (predict(models, layout, up)[0][0] - predict(models, layout, down)[0][0]) / (
            2 * step
        )
        # the differences' error is of second order in a ten-thousandth of sd
        assert np.max(np.abs(numeric - jac[:, :, i])) < 1e-5 * np.max(np.abs(numeric)) + 1e-7, name


def test_lags_on_the_graded_grid_are_those_of_the_chain() -> None:
    t = np.concatenate([np.arange(0, 3, 0.01), np.arange(3, 30, 0.1)])
    u = (1 - np.exp(-t / 2.0))[:, None]
    chain = Chain((0.5, 0.12), conditioning=Conditioning(4.0, 2))
    fine = np.arange(0, 30, 0.001)
    exact = np.interp(t, fine, chain.response(1 - np.exp(-fine / 2.0), 0.001))
    y = apply_conditioning(
        lag_on_grid(lag_on_grid(u, np.diff(t), 2.0), np.diff(t), 1 / 0.12),
        np.diff(t),
        chain.conditioning,
    )
    np.testing.assert_allclose(y[:, 0], exact, atol=2e-4)  # curvature 0.25/s2 times dt^2/8
    butter = replace(chain, conditioning=Conditioning(4.0, 3, "butterworth"))
    exact = np.interp(t, fine, butter.response(1 - np.exp(-fine / 2.0), 0.001))
    y = apply_conditioning(
        lag_on_grid(lag_on_grid(u, np.diff(t), 2.0), np.diff(t), 1 / 0.12),
        np.diff(t),
        butter.conditioning,
    )
    np.testing.assert_allclose(y[:, 0], exact, atol=2e-4)


@pytest.mark.parametrize("taus", [(0.05, 0.01), (0.04, 0.04), (0.04, 0.04 * (1 + 1e-9))])
def test_a_section_of_two_real_poles_is_two_lags_also_where_they_are_one(
    taus: tuple[float, float],
) -> None:
    t = np.concatenate([np.arange(0, 3, 0.01), np.arange(3, 30, 0.1)])
    u = (1 - np.exp(-t / 2.0))[:, None] * [1.0, -3.0]
    section = Conditioning()
    vars(section)["factors"] = (
        (1.0, sum(taus), taus[0] * taus[1]),
    )  # one quadratic section, given as two lags [s]
    expected = lag_on_grid(lag_on_grid(u, np.diff(t), 1 / taus[0]), np.diff(t), 1 / taus[1])
    # in the other order the straight lines between the knots bend elsewhere: curvature 0.25/s2 times dt^2/8, times 3
    np.testing.assert_allclose(apply_conditioning(u, np.diff(t), section), expected, atol=4e-4)


def test_the_zero_of_a_whitened_filter_is_on_the_graded_grid_too() -> None:
    t = np.concatenate([np.arange(0, 3, 0.01), np.arange(3, 30, 0.1)])
    white = WhitenedConditioning(4.0, 2, "cascade", ((1.0, 0.3), (1.0, 0.05)), (1.0, 0.02))
    fine = np.arange(0, 30, 0.001)
    one = Rational(np.array(white.numerator), tuple(Factor(f) for f in white.factors))
    exact = np.interp(t, fine, simulate_rational(one, 1 - np.exp(-fine / 2.0), 0.001))
    made = apply_conditioning((1 - np.exp(-t / 2.0))[:, None], np.diff(t), white)[:, 0]
    np.testing.assert_allclose(made, exact, atol=4e-4)
    without = apply_conditioning(
        (1 - np.exp(-t / 2.0))[:, None], np.diff(t), replace(white, numerator=(1.0,))
    )[:, 0]
    assert np.abs(without - exact).max() > 4e-3


def test_reading_the_grid_gives_nothing_before_entry() -> None:
    grid = np.array([0.0, 1.0, 3.0])
    r = GridInterpolation.at(grid, np.array([-1.0, 0.5, 2.0]))
    np.testing.assert_allclose(r.value(np.array([0.0, 2.0, 4.0])), [0.0, 1.0, 3.0])
    np.testing.assert_allclose(r.slope(np.array([0.0, 2.0, 4.0])), [0.0, 2.0, 1.0])


@pytest.mark.parametrize("logit", [-3.0, 0.0, 3.0])
def test_stages_keep_the_lag(logit: float) -> None:
    for structure in STRUCTURES:
        taus, delay, zero = stages(structure, 0.7, logit)
        assert sum(taus) + delay - zero == pytest.approx(0.7)
        assert min(*taus, delay, zero) >= 0


@pytest.mark.parametrize("structure", STRUCTURES)
def test_a_chain_on_the_grid_is_that_of_the_transfer_function(structure: str) -> None:
    """Against python-control on a fine even grid; derivatives against differences."""
    t = np.arange(0, 6, 0.005)
    u = np.clip(t - 1, 0, 2)
    lag = 0.7
    logit = 0.3
    taus, delay, zero = stages(structure, lag, logit)
    poles = np.array([1.0])
    for tau in taus:
        poles = np.polymul(poles, [tau, 1.0])
    exact = control.forced_response(control.TransferFunction([zero, 1.0], poles), t, u).outputs
    one = np.ones(1)  # channel
    (y, by_lag, by_logit), late = chain_on_grid(
        u[None, None], np.diff(t), lag * one, logit * one, structure
    )
    assert late[0] == pytest.approx(delay)
    np.testing.assert_allclose(
        y[0], exact, atol=2e-4
    )  # straight lines between samples in both: rounding only
    along_lag = ((lag + 1e-4, logit), (lag - 1e-4, logit))
    along_logit = ((lag, logit + 1e-3), (lag, logit - 1e-3))
    for by, (a, b) in ((by_lag, along_lag), (by_logit, along_logit)):
        ends = [np.array(at)[:, None] for at in (a, b)]
        up, down = (
            chain_on_grid(u[None, None], np.diff(t), *at, structure)[0][0, 0] for at in ends
        )
        step = a[0] - b[0] + a[1] - b[1]
        np.testing.assert_allclose(
            by[0], (up - down) / step, atol=1e-6
        )  # second order of the differences


def test_spikes_are_left_out_and_noise_is_seen_through_a_ramp() -> None:
    run = pair()[0][0]
    dirty = run.readings_degC.copy()
    dirty[::500, 2] += 30.0
    blocks = make_blocks(replace(run, readings_degC=dirty))
    clean = make_blocks(run)
    assert blocks.spikes >= 5
    assert (
        np.max(np.abs(blocks.readings_degC - clean.readings_degC)) < 0.4
    )  # one sample of two lost: noise alone
    np.testing.assert_allclose(
        white_noise_sd(run.readings_degC), 0.12, rtol=0.12
    )  # a median of 5000 correlated terms: 3 %


def test_runs_that_cannot_be_fitted_together_are_refused() -> None:
    runs = pair()[0]
    with pytest.raises(InputError, match="different channels"):
        identify_plunges([runs[0], replace(runs[1], channels=("a", "b"))], SETUP)
    with pytest.raises(InputError, match="no plunge"):
        identify_plunges([], SETUP)
    short = replace(runs[0], entry=replace(runs[0].entry, time_s=runs[0].time_s[-1] - 3))
    with pytest.raises(InputError, match="10 s after"):
        identify_plunges([short], SETUP)


@pytest.mark.study
def test_intervals_cover_over_a_hundred_pairs_drawn_from_the_priors(
    draws: Callable[[int], int],
) -> None:
    from tcdyn.design.plans import PlungePlan, predict_plunges

    rng = np.random.default_rng(11)
    pairs = draws(100)
    result = study(draw_pairs(rng, pairs), 60.0, rng)
    print(describe(result))
    zc = np.abs(result["common"] / result["u_common"])
    zd = np.abs(result["differential"] / result["u_differential"])
    assert np.mean(zc < 1.96) >= 0.95 - 0.5 / np.sqrt(pairs)
    assert np.sqrt(np.mean(zc**2)) > 0.5
    assert 0.90 <= np.mean(zd < 1.96) <= 0.99
    assert np.sqrt(np.mean(result["differential"] ** 2)) < 0.02
    plans = [
        PlungePlan(bath_degC=T, initial_degC=26.0, duration_s=60.0, before_s=8.0)
        for T in (110.0, 138.0)
    ]
    foreseen = predict_plunges(plans, SETUP, draws=60)
    print(
        f"foreseen: common {foreseen.u_common_s:.3f} s, differential {foreseen.u_differential_s:.4f} s"
    )
    assert foreseen.u_differential_s == pytest.approx(
        np.sqrt(np.mean(result["differential"] ** 2)), rel=0.25
    )
    assert foreseen.u_common_s == pytest.approx(
        np.sqrt(np.mean(result["common"] ** 2)), rel=2.5 / np.sqrt(pairs)
    )
