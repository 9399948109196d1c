"""Noise that is not white, a baseline that moves, an input that is measured: intervals that hold the truth."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest
from disturbance_study import AUTO, DT_S, disturbance, fine, record, study
from identify_cases import CASE_A
from scipy import stats
from scipy.linalg import toeplitz
from scipy.signal import lfilter
from typer.testing import CliRunner

from tcdyn.cli.app import app
from tcdyn.core.errors import InputError
from tcdyn.estimation import NoiseModel
from tcdyn.estimation.arma import coefficients_from_partial, partial_correlations
from tcdyn.estimation.noise_average import first_order_noise, mixture_moments
from tcdyn.identify import IOData, compare, fit
from tcdyn.identify.disturbance import linearise
from tcdyn.identify.models import process
from tcdyn.identify.search import make_problem
from tcdyn.identify.segments import input_noise_sd


def held(runs: int, least: float) -> float:
    """Share of so many runs below which a true coverage of ``least`` falls once in 200."""
    return float(stats.binom.ppf(0.005, runs, least)) / runs


@pytest.mark.study
@pytest.mark.parametrize("kind", ["plunge", "PRBS"])
def test_a_measured_input_whose_first_sample_is_noisy_still_covers_gain_and_lag(kind):
    """The first sample taken for the whole past, 35 and 53 % of the plunges and 60 and 68 % of the steps did."""
    found = study(kind, range(100), input_sd=0.5)
    assert min(found["Kp"], found["lag"]) >= held(100, 0.93), found
    assert abs(found["bias_s"]) < 3 * found["sd_s"] / 10  # three standard errors of 100 runs
    assert max(found["white"], found["input"]) <= 0.05, (
        found
    )  # 1 % alarms: more than 5 of 100 once in 500


def test_the_past_is_a_reading_among_others_and_a_known_input_has_none():
    data = record("plunge", 3, input_sd=0.5)
    assert make_problem(data, process("P2D"), "equilibrium", "auto").input_sd == pytest.approx(
        0.5, rel=0.1
    )
    assert not any(make_problem(data, process("P2D"), "equilibrium", 0.0).prior_precision)
    held_input = record("PRBS", 3)  # levels held for 20 samples: set by a computer
    assert input_noise_sd(make_problem(held_input, process("P1"), "equilibrium").segments) == 0.0


def test_slopes_by_past_and_drift_equal_differences():
    from dataclasses import replace

    data = record("plunge", 1, input_sd=0.5)
    posed = replace(make_problem(data, process("P2DZ"), "equilibrium", 0.5), trend=True)
    x = posed.vector({"Kp": 1.1, "Tp1": 2.0, "Tp2": 0.5, "Tz": 0.3, "Td": 0.37})
    x[-2:] = 0.7, -0.4
    jacobian = posed.evaluate(x)[1]
    for i, step in enumerate(1e-6 * np.eye(len(x))):
        difference = (posed.evaluate(x + step)[0] - posed.evaluate(x - step)[0]) / 2e-6
        assert np.allclose(jacobian[:, i], difference, atol=1e-5 * np.abs(difference).max()), (
            i
        )  # rounding 1e-16/1e-6


@pytest.mark.study
@pytest.mark.parametrize("name", ["ar0.9", "walk", pytest.param("drift", marks=pytest.mark.study)])
def test_the_noise_that_the_data_ask_for_covers_the_lag(name):
    """White noise assumed, the sandwich covered 47 % under a random walk and 5 % under a drift."""
    found = study("PRBS", range(16), name, **AUTO)
    assert found["lag"] >= held(16, 0.90), found
    assert (
        found["noise"]["slow"] >= 14
    )  # by chance the residuals of one or two look white or follow the input


def dense(noise: NoiseModel, n: int) -> np.ndarray:
    """Covariance (n, n) of ARMA noise for innovations of unit variance, by its impulse response."""
    h = lfilter([1.0, *noise.ma], [1.0, *noise.ar], np.concatenate([[1.0], np.zeros(20_000)]))
    return toeplitz([h[k:] @ h[: len(h) - k] for k in range(n)])


@pytest.mark.parametrize(
    "noise",
    [NoiseModel((-0.99,), (-0.8,)), NoiseModel((-1.2, 0.5), (0.3,)), NoiseModel((), (0.5,))],
)
def test_whitening_leaves_unit_noise_from_the_first_sample_on(noise):
    v = dense(noise, 30)
    parts = [slice(0, 30)]
    w = noise.whiten(np.eye(30), parts)
    assert np.allclose(w @ v @ w.T, np.eye(30))
    assert noise.log_determinant(parts) == pytest.approx(np.linalg.slogdet(v)[1])


def test_what_a_noise_makes_likely_is_generalised_least_squares():
    """Step, covariance and restricted likelihood against the textbook's with the dense covariance of the noise."""
    posed = make_problem(record("plunge", 2, "ar0.9"), process("P2D"), "equilibrium", 0.0)
    x = posed.vector(CASE_A)
    x[-1] = 0.2
    r, j = posed.evaluate(x)
    j = j / np.array(
        [1.0, CASE_A["Tp1"], CASE_A["Tp2"], 1.0, 1.0]
    )  # by the lags, not by their logarithms
    told = []
    for noise in (first_order_noise(np.log(9.0), 2.0), first_order_noise(np.log(300.0), -1.0)):
        likelihood, step, covariance = linearise(posed, x, 1.0).marginal(noise)
        white = np.linalg.inv(dense(noise, len(r)))
        information = j.T @ white @ j
        best = -np.linalg.solve(information, j.T @ white @ r)
        rest = (r + j @ best) @ white @ (r + j @ best)
        freedom = len(r) - len(x)
        assert np.allclose(step, best, rtol=1e-6, atol=1e-9)
        assert np.allclose(covariance, rest / freedom * np.linalg.inv(information), rtol=1e-5)
        volume = np.linalg.slogdet(information)[1] + np.linalg.slogdet(dense(noise, len(r)))[1]
        told.append((likelihood, -0.5 * (freedom * np.log(rest) + volume)))
    assert told[0][0] - told[1][0] == pytest.approx(
        told[0][1] - told[1][1], abs=1e-4
    )  # but for a constant


def test_a_mixture_has_the_moments_of_its_draws():
    rng = np.random.default_rng(0)
    means = rng.normal(size=(3, 2))
    covariances = np.array([np.diag(rng.uniform(0.1, 1, 2)) for _ in range(3)])
    weight = np.array([0.2, 0.5, 0.3])
    kind = rng.choice(3, 100_000, p=weight)
    draws = means[kind] + rng.normal(size=(100_000, 2)) * np.sqrt(
        covariances[kind].diagonal(axis1=1, axis2=2)
    )
    mean, covariance = mixture_moments(np.log(weight) - 700.0, means, covariances)
    assert np.allclose(mean, draws.mean(axis=0), atol=0.02)  # five standard errors of 100,000 draws
    assert np.allclose(covariance, np.cov(draws.T), atol=0.03)


def test_a_random_walk_takes_up_anew_after_a_gap():
    u, y = fine("PRBS", np.random.default_rng(2))
    y = y + disturbance("walk", np.random.default_rng(3))
    y[300:340] = np.nan
    y[340:] += 50.0  # whatever level there is after it
    data = IOData.from_arrays(u, y, DT_S, hold="zoh")
    found = fit(data, "P2D", noise=(0, 1), baseline="walk", check=False)
    assert found.identified.lag_s.value == pytest.approx(2.87, abs=4 * found.identified.lag_s.u)
    assert found.identified.lag_s.u < 0.1


def test_whitening_from_rest_undoes_the_noise_it_describes():
    e = np.random.default_rng(0).normal(size=50)
    noise = NoiseModel((-1.0,), (-0.6,), starts_at_rest=True)
    walk = np.cumsum(e) - 0.6 * np.concatenate([[0.0], np.cumsum(e)[:-1]])
    assert np.allclose(noise.whiten(walk, [slice(0, 50)]), e)


def test_partial_correlations_and_coefficients_are_inverses():
    d = np.array([-1.2, 0.5, -0.1])
    assert np.allclose(coefficients_from_partial(partial_correlations(d)), d)
    assert np.all(
        np.abs(np.roots([1.0, *coefficients_from_partial(np.array([0.9, -0.9, 0.9]))])) < 1
    )


@pytest.mark.study
def test_compare_models_the_disturbance_and_says_so():
    data = record("PRBS", 5, "walk")
    found = compare(data, ["P2", "P2D"])
    assert "averaged over what may disturb the output" in found.advice
    assert found.best.noise.averaged
    assert found.best.identified.statistics["p_walk"] > 0.2
    again = fit(data, "P2D", **found.best.disturbance, check=False)
    assert again.identified.lag_s.value == pytest.approx(
        found.best.identified.lag_s.value, rel=1e-3
    )
    plain = compare(data, ["P2", "P2D"], noise="white", baseline="none")
    assert plain.best.noise.white
    assert "modelled" not in plain.advice


@pytest.mark.study
def test_a_plateau_of_coloured_noise_is_no_reproach():
    """Held out lies a plateau, where any model is as bad as the mean; only its noise can judge it."""
    rng = np.random.default_rng(0)
    provisional = 0
    for seed in range(10):
        u, y = fine("plunge", rng)
        data = IOData.from_arrays(u, y + disturbance("ar0.9", np.random.default_rng(seed)), DT_S)
        provisional += compare(data, ["P2D"]).conclusion.code == "models.provisional"
    assert provisional == 0


def test_noise_of_the_input_below_zero_is_refused():
    with pytest.raises(InputError, match="noise"):
        fit(record("plunge", 0), "P1D", input_noise=-1.0)


@pytest.mark.e2e
def test_the_command_takes_noise_baseline_and_noise_of_the_input(tmp_path):
    data = record("plunge", 5, input_sd=0.5)
    table = tmp_path / "plunge.csv"
    columns = {
        "time_s": data.times_s().round(3),
        "u": data.runs[0].u[:, 0],
        "y": data.runs[0].y[:, 0],
    }
    pd.DataFrame(columns).to_csv(table, index=False)
    words = ["identify", str(table), "--input", "u", "--output", "y", "--models", "P2D"]

    def told(*more: str) -> dict:
        assert CliRunner().invoke(app, [*words, *more, "-q"]).exit_code in (0, 1)
        return json.loads(table.with_suffix(".identified.json").read_text())

    plain = told()
    blind = told("--input-noise", "0")
    asked = told("--input-noise", "0.5", "--noise", "ar", "--baseline", "trend")
    assert (
        plain["estimates"]["Kp"]["u"] > 2 * blind["estimates"]["Kp"]["u"]
    )  # what the first sample hides
    assert (
        asked["statistics"]["parameters"] >= plain["statistics"]["parameters"] + 2
    )  # a coefficient and a slope
    for wrong in (("--noise", "pink"), ("--baseline", "hill"), ("--input-noise", "much")):
        assert CliRunner().invoke(app, [*words, *wrong]).exit_code != 0
