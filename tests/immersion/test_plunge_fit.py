"""The plunge fit on an independent simulation: recovery of known lags, coverage, derivatives, and
messages."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import control
import numpy as np
import pytest
from forms_study import mcadams, water
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
def plunge_pair() -> tuple[list[PlungeRun], np.ndarray]:
    """One pair of plunges of 60 s with lags of the channels spread by 0.04 s; and the true lags
    (6,)."""
    rng = np.random.default_rng(4)
    d = same_pairs(1)
    shift = np.array([0.03, -0.05, 0.01, 0.04, -0.02, -0.01])
    d.tau1 = d.tau1 + shift
    times, readings = simulate(d, 60.0, rng)
    return make_runs(d, times, readings, rng), (d.tau1 + d.tau2)[0] + OWN_LAG_S


@cache
def fitted() -> PlungeFit:
    """The fit of this pair."""
    return identify_plunges(plunge_pair()[0], SETUP)


@pytest.mark.study
def test_lags_are_recovered_within_their_stated_uncertainty() -> None:
    fit = fitted()
    true_lags = plunge_pair()[1]
    assert abs(fit.common_lag_s.value - true_lags.mean()) < 3 * fit.common_lag_s.u
    error = np.array([fit.differential_lag_s[c].value for c in CHANNELS]) - (
        true_lags - true_lags.mean()
    )
    u = np.array([fit.differential_lag_s[c].u for c in CHANNELS])
    assert np.all(np.abs(error) < 3.5 * u)
    assert np.sqrt(np.mean(error**2)) < 0.03  # three times the expected 0.01


@pytest.mark.study
def test_lag_covariance_is_mostly_common() -> None:
    fit = fitted()
    c = fit.lag_covariance
    # the slope along the profile is nearly one
    assert fit.common_lag_s.u == pytest.approx(np.sqrt(c.mean()), rel=0.15)
    assert max(e.u for e in fit.differential_lag_s.values()) < fit.common_lag_s.u
    assert np.all(np.linalg.eigvalsh(c) > 0)


@pytest.mark.e2e
def test_chains_agree_with_the_lag_estimates() -> None:
    fit = fitted()
    for c in CHANNELS:
        assert fit.chains[c].lag_s == pytest.approx(fit.lag_s[c].value, abs=1e-9)
        # tolerance: the common lag is the posterior mean over a grid of refits
        sum_of_lags = fit.common_lag_s.value + fit.differential_lag_s[c].value
        assert fit.lag_s[c].value == pytest.approx(sum_of_lags, abs=2e-3)
    assert fit.converged


@pytest.mark.e2e
def test_correlations_give_equal_common_lags_if_their_scale_is_free() -> None:
    form = fitted().model_form
    assert set(form.common_lag_s) == {"churchill-chu-laminar", "mcadams", "similarity"}
    assert form.u_common_s < 0.05  # all have the quarter power; only the additive 0.68 differs
    assert np.ptp(list(form.common_lag_s.values())) < 0.1


def test_summary_names_the_largest_component_of_the_common_lag() -> None:
    fit = fitted()
    text = fit.summary()
    assert "common lag" in text
    assert "burst" in fit.sentence
    components = {s.source: s for s in fit.budget}
    assert components["noise alone"].u_common_s < 0.2 * components["all of the fit"].u_common_s


@pytest.mark.study
def test_plunge_that_cannot_separate_lag_and_burst_is_reported() -> None:
    runs = [replace(r, entry=replace(r.entry, u_s=1.0)) for r in plunge_pair()[0][:1]]
    wide = PlungePriors(burst_log=2.0, burst_shape_log=1.0, burst_time_log=1.0)
    fit = identify_plunges(runs, SETUP, priors=wide, alternatives=())
    assert "cannot separate the lag from the burst" in fit.sentence
    assert fit.common_lag_s.u > 2 * fitted().common_lag_s.u


@pytest.mark.study
def test_weak_entry_bursts_are_not_taken_for_a_long_lag() -> None:
    """A search from strong bursts alone ends at a second solution, with a longer lag."""
    rng = np.random.default_rng(1)
    true_lag_s = 0.67
    d = same_pairs(1, true_lag_s, baths=(15.0, 30.0))
    d.initial = d.initial + 59.0
    d.burst = np.array([0.43, 0.25])
    d.burst_time = np.array([1.4, 1.8])
    d.burst_shape = np.array([0.6, 1.0])
    times, readings = simulate(d, 60.0, rng, h_of=lambda wall, bulk: mcadams(water, wall, bulk))
    runs = make_runs(d, times, readings, rng, fluid_name="water")
    fit = identify_plunges(runs, SETUP, alternatives=())
    assert fit.common_lag_s.contains(true_lag_s + OWN_LAG_S)
    assert "plunge.rival" not in [f.code for f in fit.findings]


def test_derivatives_equal_central_differences_of_the_model() -> None:
    run = plunge_pair()[0][0]
    layout = PlungeParameters(1, CHANNELS, "P2")
    mean, sd = layout.prior(PlungePriors(), [0.05], [26.0])
    theta = mean.copy()
    theta[layout.at("lag")] = 0.6
    models = build_run_models([run], [make_blocks(run)], SETUP, layout, correlation("5.4"), theta)
    # away from the linearisation point
    theta[layout.at("ln_conductivity")] = 0.01
    theta[layout.at("depth")] = 5e-5
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
        # the error of the differences is of second order in a ten-thousandth of sd
        assert np.max(np.abs(numeric - jac[:, :, i])) < 1e-5 * np.max(np.abs(numeric)) + 1e-7, name


def test_lags_on_the_graded_grid_equal_the_chain_response() -> None:
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
def test_quadratic_section_with_real_poles_equals_two_lags_even_if_they_coincide(
    taus: tuple[float, float],
) -> None:
    t = np.concatenate([np.arange(0, 3, 0.01), np.arange(3, 30, 0.1)])
    u = (1 - np.exp(-t / 2.0))[:, None] * [1.0, -3.0]
    section = Conditioning()
    # one quadratic section, given as two lags [s]
    vars(section)["factors"] = ((1.0, sum(taus), taus[0] * taus[1]),)
    expected = lag_on_grid(lag_on_grid(u, np.diff(t), 1 / taus[0]), np.diff(t), 1 / taus[1])
    # in the other order the linear pieces between the knots differ: curvature 0.25/s2 times dt^2/8,
    # times 3
    np.testing.assert_allclose(apply_conditioning(u, np.diff(t), section), expected, atol=4e-4)


def test_zero_of_a_whitened_filter_is_exact_on_the_graded_grid() -> None:
    t = np.concatenate([np.arange(0, 3, 0.01), np.arange(3, 30, 0.1)])
    white = WhitenedConditioning(4.0, 2, "cascade", ((1.0, 0.3), (1.0, 0.05)), (1.0, 0.02))
    fine = np.arange(0, 30, 0.001)
    rational = Rational(np.array(white.numerator), tuple(Factor(f) for f in white.factors))
    exact = np.interp(t, fine, simulate_rational(rational, 1 - np.exp(-fine / 2.0), 0.001))
    response = apply_conditioning((1 - np.exp(-t / 2.0))[:, None], np.diff(t), white)[:, 0]
    np.testing.assert_allclose(response, exact, atol=4e-4)
    without_zero = apply_conditioning(
        (1 - np.exp(-t / 2.0))[:, None], np.diff(t), replace(white, numerator=(1.0,))
    )[:, 0]
    assert np.abs(without_zero - exact).max() > 4e-3


def test_grid_interpolation_is_zero_before_entry() -> None:
    grid = np.array([0.0, 1.0, 3.0])
    r = GridInterpolation.at(grid, np.array([-1.0, 0.5, 2.0]))
    np.testing.assert_allclose(r.value(np.array([0.0, 2.0, 4.0])), [0.0, 1.0, 3.0])
    np.testing.assert_allclose(r.slope(np.array([0.0, 2.0, 4.0])), [0.0, 2.0, 1.0])


@pytest.mark.parametrize("logit", [-3.0, 0.0, 3.0])
def test_stages_of_every_structure_preserve_the_lag(logit: float) -> None:
    for structure in STRUCTURES:
        taus, delay, zero = stages(structure, 0.7, logit)
        assert sum(taus) + delay - zero == pytest.approx(0.7)
        assert min(*taus, delay, zero) >= 0


@pytest.mark.parametrize("structure", STRUCTURES)
def test_chain_on_the_grid_equals_the_transfer_function(structure: str) -> None:
    """Against python-control on a fine uniform grid; derivatives against differences."""
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
    (y, by_lag, by_logit), delay_s = chain_on_grid(
        u[None, None], np.diff(t), lag * one, logit * one, structure
    )
    assert delay_s[0] == pytest.approx(delay)
    # linear between samples in both: rounding only
    np.testing.assert_allclose(y[0], exact, atol=2e-4)
    along_lag = ((lag + 1e-4, logit), (lag - 1e-4, logit))
    along_logit = ((lag, logit + 1e-3), (lag, logit - 1e-3))
    for derivative, (a, b) in ((by_lag, along_lag), (by_logit, along_logit)):
        points = [np.array(point)[:, None] for point in (a, b)]
        up, down = (
            chain_on_grid(u[None, None], np.diff(t), *point, structure)[0][0, 0] for point in points
        )
        step = a[0] - b[0] + a[1] - b[1]
        # second-order error of the differences
        np.testing.assert_allclose(derivative[0], (up - down) / step, atol=1e-6)


def test_spikes_are_left_out_and_noise_is_estimated_despite_a_ramp() -> None:
    run = plunge_pair()[0][0]
    with_spikes = run.readings_degC.copy()
    with_spikes[::500, 2] += 30.0
    blocks = make_blocks(replace(run, readings_degC=with_spikes))
    clean = make_blocks(run)
    assert blocks.spikes >= 5
    # one sample of two is lost: the difference is noise
    assert np.max(np.abs(blocks.readings_degC - clean.readings_degC)) < 0.4
    # tolerance: a median of 5000 correlated terms is known to 3 %
    np.testing.assert_allclose(white_noise_sd(run.readings_degC), 0.12, rtol=0.12)


def test_runs_that_cannot_be_fitted_together_raise() -> None:
    runs = plunge_pair()[0]
    with pytest.raises(InputError, match="different channels"):
        identify_plunges([runs[0], replace(runs[1], channels=("a", "b"))], SETUP)
    with pytest.raises(InputError, match="no plunge"):
        identify_plunges([], SETUP)
    short = replace(runs[0], entry=replace(runs[0].entry, time_s=runs[0].time_s[-1] - 3))
    with pytest.raises(InputError, match="10 s after"):
        identify_plunges([short], SETUP)


@pytest.mark.long
@pytest.mark.study
def test_intervals_cover_over_a_hundred_pairs_sampled_from_the_priors(
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
    predicted = predict_plunges(plans, SETUP, draws=60)
    print(
        f"predicted: common {predicted.u_common_s:.3f} s, differential "
        f"{predicted.u_differential_s:.4f} s"
    )
    assert predicted.u_differential_s == pytest.approx(
        np.sqrt(np.mean(result["differential"] ** 2)), rel=0.25
    )
    assert predicted.u_common_s == pytest.approx(
        np.sqrt(np.mean(result["common"] ** 2)), rel=2.5 / np.sqrt(pairs)
    )
