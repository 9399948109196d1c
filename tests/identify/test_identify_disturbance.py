"""Coloured noise, a drifting baseline and a measured input: intervals that cover the true
values."""

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
from tcdyn.identification import IOData, compare, fit
from tcdyn.identification.disturbance import linearise
from tcdyn.identification.models import process
from tcdyn.identification.search import make_problem
from tcdyn.identification.segments import input_noise_sd


def coverage_limit(runs: int, coverage: float) -> float:
    """Quantile of the observed coverage over ``runs`` records: below it once in 200 if the
    coverage is ``least``."""
    return float(stats.binom.ppf(0.005, runs, coverage)) / runs


@pytest.mark.study
@pytest.mark.long
@pytest.mark.parametrize("component", ["plunge", "PRBS"])
def test_noisy_first_sample_of_a_measured_input_does_not_reduce_coverage(component):
    """If the first sample were taken for the whole past, gain and lag would be covered by 35 and
    53 % for the plunges and 60 and 68 % for the steps."""
    result = study(component, range(100), input_sd=0.5)
    assert min(result["Kp"], result["lag"]) >= coverage_limit(100, 0.93), result
    assert abs(result["bias_s"]) < 3 * result["sd_s"] / 10  # three standard errors of 100 runs
    # alarms of 1 %: more than 5 of 100 occur once in 500
    assert max(result["white"], result["input"]) <= 0.05, result


def test_past_input_is_an_uncertain_reading_and_a_known_input_has_no_noise():
    data = record("plunge", 3, input_sd=0.5)
    assert make_problem(data, process("P2D"), "equilibrium", "auto").input_sd == pytest.approx(
        0.5, rel=0.1
    )
    assert not any(make_problem(data, process("P2D"), "equilibrium", 0.0).prior_precision)
    stepwise_input = record("PRBS", 3)  # levels held for 20 samples: set by a computer
    assert (
        input_noise_sd(make_problem(stepwise_input, process("P1"), "equilibrium").segments) == 0.0
    )


def test_sensitivities_with_past_input_and_drift_equal_central_differences():
    from dataclasses import replace

    data = record("plunge", 1, input_sd=0.5)
    problem = replace(make_problem(data, process("P2DZ"), "equilibrium", 0.5), trend=True)
    x = problem.vector({"Kp": 1.1, "Tp1": 2.0, "Tp2": 0.5, "Tz": 0.3, "Td": 0.37})
    x[-2:] = 0.7, -0.4
    jacobian = problem.evaluate(x)[1]
    for i, step in enumerate(1e-6 * np.eye(len(x))):
        difference = (problem.evaluate(x + step)[0] - problem.evaluate(x - step)[0]) / 2e-6
        # rounding 1e-16/1e-6
        tolerance = 1e-5 * np.abs(difference).max()
        assert np.allclose(jacobian[:, i], difference, atol=tolerance), i


@pytest.mark.study
@pytest.mark.parametrize(
    "name", ["walk", *(pytest.param(name, marks=pytest.mark.long) for name in ("ar0.9", "drift"))]
)
def test_selected_noise_model_covers_the_lag(name):
    """With white noise assumed, the sandwich covers 47 % under a random walk and 5 % under a
    drift."""
    result = study("PRBS", range(16), name, **AUTO)
    assert result["lag"] >= coverage_limit(16, 0.90), result
    # by chance the residuals of one or two look white or follow the input
    assert result["noise"]["slow"] >= 14


def dense(noise: NoiseModel, n: int) -> np.ndarray:
    """Covariance (n, n) of ARMA noise with innovations of unit variance, from its impulse
    response."""
    h = lfilter([1.0, *noise.ma], [1.0, *noise.ar], np.concatenate([[1.0], np.zeros(20_000)]))
    return toeplitz([h[k:] @ h[: len(h) - k] for k in range(n)])


@pytest.mark.parametrize(
    "noise",
    [NoiseModel((-0.99,), (-0.8,)), NoiseModel((-1.2, 0.5), (0.3,)), NoiseModel((), (0.5,))],
)
def test_whitening_gives_unit_noise_from_the_first_sample(noise):
    v = dense(noise, 30)
    segments = [slice(0, 30)]
    w = noise.whiten(np.eye(30), segments)
    assert np.allclose(w @ v @ w.T, np.eye(30))
    assert noise.log_determinant(segments) == pytest.approx(np.linalg.slogdet(v)[1])


def test_marginal_likelihood_equals_generalised_least_squares():
    """Step, covariance and restricted likelihood against the textbook, with the dense covariance
    of the noise."""
    problem = make_problem(record("plunge", 2, "ar0.9"), process("P2D"), "equilibrium", 0.0)
    x = problem.vector(CASE_A)
    x[-1] = 0.2
    r, j = problem.evaluate(x)
    # with respect to the lags, not to their logarithms
    j = j / np.array([1.0, CASE_A["Tp1"], CASE_A["Tp2"], 1.0, 1.0])
    likelihoods = []
    for noise in (first_order_noise(np.log(9.0), 2.0), first_order_noise(np.log(300.0), -1.0)):
        (node,) = linearise(problem, x, 1.0).marginal_likelihoods(noise)
        white = np.linalg.inv(dense(noise, len(r)))
        information = j.T @ white @ j
        expected_step = -np.linalg.solve(information, j.T @ white @ r)
        weighted_sse = (r + j @ expected_step) @ white @ (r + j @ expected_step)
        dof = len(r) - len(x)
        assert np.allclose(node.step, expected_step, rtol=1e-6, atol=1e-9)
        expected = weighted_sse / dof * np.linalg.inv(information)
        assert np.allclose(node.covariance, expected, rtol=1e-5)
        log_det = np.linalg.slogdet(information)[1] + np.linalg.slogdet(dense(noise, len(r)))[1]
        likelihoods.append((node.log_likelihood, -0.5 * (dof * np.log(weighted_sse) + log_det)))
    # equal except for a constant
    assert likelihoods[0][0] - likelihoods[1][0] == pytest.approx(
        likelihoods[0][1] - likelihoods[1][1], abs=1e-4
    )


def test_mixture_moments_equal_the_moments_of_its_samples():
    rng = np.random.default_rng(0)
    means = rng.normal(size=(3, 2))
    covariances = np.array([np.diag(rng.uniform(0.1, 1, 2)) for _ in range(3)])
    weight = np.array([0.2, 0.5, 0.3])
    component = rng.choice(3, 100_000, p=weight)
    samples = means[component] + rng.normal(size=(100_000, 2)) * np.sqrt(
        covariances[component].diagonal(axis1=1, axis2=2)
    )
    mean, covariance = mixture_moments(np.log(weight) - 700.0, means, covariances)
    # five standard errors of 100,000 samples
    assert np.allclose(mean, samples.mean(axis=0), atol=0.02)
    assert np.allclose(covariance, np.cov(samples.T), atol=0.03)


def test_random_walk_restarts_after_a_gap():
    u, y = fine("PRBS", np.random.default_rng(2))
    y = y + disturbance("walk", np.random.default_rng(3))
    y[300:340] = np.nan
    y[340:] += 50.0  # an arbitrary new level after the gap
    data = IOData.from_arrays(u, y, DT_S, hold="zoh")
    result = fit(data, "P2D", noise=(0, 1), baseline="walk", check=False, initial="equilibrium")
    assert result.identified.lag_s.value == pytest.approx(2.87, abs=4 * result.identified.lag_s.u)
    assert result.identified.lag_s.u < 0.1


def test_whitening_from_rest_inverts_the_noise_model():
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
def test_compare_models_the_disturbance_and_reports_it():
    data = record("PRBS", 5, "walk")
    comparison = compare(data, ["P2", "P2D"])
    assert "averaged over what may disturb the output" in comparison.advice
    assert comparison.best.noise.averaged
    assert comparison.best.identified.statistics["p_walk"] > 0.2
    refit = fit(data, "P2D", initial=comparison.best.problem.initial, check=False)
    assert refit.identified.lag_s.value == pytest.approx(
        comparison.best.identified.lag_s.value, rel=1e-3
    )
    default = compare(data, ["P2", "P2D"], noise="white", baseline="none")
    assert default.best.noise.white
    assert "modelled" not in default.advice


@pytest.mark.long
@pytest.mark.study
def test_plateau_of_coloured_noise_gives_no_provisional_advice():
    """The held-out part is a plateau, where every model is as bad as the mean; only the noise can
    judge it."""
    rng = np.random.default_rng(0)
    provisional = 0
    for seed in range(10):
        u, y = fine("plunge", rng)
        data = IOData.from_arrays(u, y + disturbance("ar0.9", np.random.default_rng(seed)), DT_S)
        provisional += compare(data, ["P2D"]).conclusion.code == "models.provisional"
    assert provisional == 0


def test_negative_input_noise_raises():
    with pytest.raises(InputError, match="noise"):
        fit(record("plunge", 0), "P1D", input_noise=-1.0)


@pytest.mark.e2e
def test_identify_command_accepts_noise_baseline_and_input_noise(tmp_path):
    data = record("plunge", 5, input_sd=0.5)
    table = tmp_path / "plunge.csv"
    columns = {
        "time_s": data.times_s().round(3),
        "u": data.runs[0].u[:, 0],
        "y": data.runs[0].y[:, 0],
    }
    pd.DataFrame(columns).to_csv(table, index=False)
    command = ["identify", str(table), "--input", "u", "--output", "y", "--model", "P2D"]

    def identified(*options: str) -> dict:
        assert CliRunner().invoke(app, [*command, *options, "-q"]).exit_code in (0, 1)
        return json.loads(table.with_suffix(".identified.json").read_text())

    default = identified()
    held = ("--noise", "white", "--initial", "equilibrium")
    exact_input = identified("--input-noise", "0", *held)
    requested = identified("--input-noise", "0.5", "--noise", "ar", "--baseline", "trend")
    # with the input taken as exact the noise of the first sample is ignored
    assert default["estimates"]["Kp"]["u"] > 2 * exact_input["estimates"]["Kp"]["u"]
    # a coefficient and a slope
    white = identified("--input-noise", "0.5", "--noise", "white", "--baseline", "none")
    assert requested["statistics"]["parameters"] >= white["statistics"]["parameters"] + 2
    for wrong in (("--noise", "pink"), ("--baseline", "hill"), ("--input-noise", "much")):
        assert CliRunner().invoke(app, [*command, *wrong]).exit_code != 0
