"""Recovery of known parameters within the stated uncertainty, for every structure and without
start values."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from identify_cases import CASE_A, PLAIN, RAO_GARNIER, case_a, case_a_input, rao_garnier
from scipy.signal import cont2discrete, lfilter

from tcdyn.estimation import NoiseModel, Optimum, Status
from tcdyn.identification import (
    Identified,
    IOData,
    chain_model,
    compare,
    fit,
    process,
    profile,
    simulate,
    transfer,
    validate,
)
from tcdyn.identification.fitting import final_offset, parameter_findings
from tcdyn.identification.models import as_model
from tcdyn.identification.search import make_problem
from tcdyn.rig.disk import Conditioning

TRUE_PARAMETERS = {
    "P1": {"Kp": 2.0, "Tp1": 0.8},
    "P1D": {"Kp": 2.0, "Tp1": 0.8, "Td": 1.23},
    "P2": {"Kp": 1.0, "Tp1": 1.0, "Tp2": 0.3},
    "P2Z": {"Kp": 1.0, "Tp1": 2.0, "Tp2": 0.4, "Tz": -0.5},
    "P2DZ": {"Kp": 1.0, "Tp1": 2.0, "Tp2": 0.4, "Tz": 1.0, "Td": 0.3},
    "P2U": {"Kp": 1.0, "Tw": 0.6, "Zeta": 0.3},
    "P2UD": {"Kp": -1.0, "Tw": 0.6, "Zeta": 0.5, "Td": 0.52},
    "P3": {"Kp": 1.0, "Tp1": 2.0, "Tp2": 0.6, "Tp3": 0.2},
    "P1I": {"Kp": 0.4, "Tp1": 0.8},
    "P1H": {"Kp": 1.0, "Tp1": 1.0, "Tc": 0.9},
    "P1HD": {"Kp": 1.0, "Tp1": 1.0, "Tc": 0.9, "Td": 0.27},
    "P0D": {"Kp": 1.5, "Td": 0.77},
    "TF(1,2)D": {"b0": 1.0, "b1": 0.5, "a1": 1.2, "a2": 0.5, "Td": 0.4},
}


@pytest.mark.parametrize("name", TRUE_PARAMETERS)
def test_every_structure_recovers_the_true_parameters_without_start_values(name):
    model = as_model(name)
    true_theta = TRUE_PARAMETERS[name]
    rng = np.random.default_rng(5)
    u, hold = case_a_input("PRBS", rng)
    u = u - 25.0 if name == "P1I" else u
    hold = "foh" if name == "P0D" else hold
    y = simulate(model.rational(true_theta), u, 0.05, hold) + 0.3 * rng.normal(size=len(u)) + 4.0
    result = fit(IOData.from_arrays(u, y, 0.05, hold=hold), model, **PLAIN)
    for key, value in true_theta.items():
        # 4 standard uncertainties: 1 in 16 000 for each of the 40 parameters
        assert result.estimates[key].value == pytest.approx(
            value, abs=4 * result.estimates[key].u + 1e-9
        ), key
    assert result.identified.offset == pytest.approx(4.0, abs=1.0)


@pytest.mark.study
@pytest.mark.parametrize("kind", ["plunge", "PRBS"])
def test_case_a_errors_match_their_stated_uncertainty_over_30_seeds(kind):
    # 30 seeds; the 200-seed study is test_identify_studies.py
    fits = [fit(case_a(kind, seed), "P2D", **PLAIN) for seed in range(100, 130)]
    for name, true_value in CASE_A.items():
        z = np.array([(f.estimates[name].value - true_value) / f.estimates[name].u for f in fits])
        assert abs(z.mean()) < 3 / np.sqrt(30), name  # three standard errors
        assert 0.6 < z.std() < 1.45, name  # chi-square 99.9 % limits for 29 degrees of freedom


def test_wrong_hold_shifts_the_dead_time_by_half_a_sample():
    data = case_a("PRBS", 3)
    wrong = IOData.from_arrays(data.runs[0].u, data.runs[0].y, 0.05, hold="foh")
    shift = (
        fit(wrong, "P2D", **PLAIN).identified.theta["Td"]
        - fit(data, "P2D", **PLAIN).identified.theta["Td"]
    )
    assert shift == pytest.approx(0.025, abs=0.004)  # half of 0.05 s; the same noise in both fits


def test_known_conditioning_filter_is_part_of_the_chain_and_not_estimated():
    conditioning = Conditioning(0.8, 2)
    model = chain_model("P1D", conditioning)
    u, hold = case_a_input("plunge", np.random.default_rng(0))
    y = simulate(model.rational({"Tp1": 0.6, "Td": 0.11}), u, 0.05, hold)
    y = y + 0.1 * np.random.default_rng(1).normal(size=len(u))
    result = fit(IOData.from_arrays(u, y, 0.05), model, **PLAIN)
    assert result.estimates["Tp1"].value == pytest.approx(0.6, abs=4 * result.estimates["Tp1"].u)
    chain = result.identified.chain(conditioning)
    assert chain.lag_s == pytest.approx(result.identified.lag_s.value, rel=1e-12)
    assert np.allclose(chain.response(u, 0.05), result.simulate_segments()[0], atol=1e-9)


def from_rest(seed: int, n: int = 400) -> IOData:
    """Two lags and a dead time at rest with the heater off; the record begins when it is switched.

    The gain is 2, the lags are 3 and 1 s, the dead time is 1.5 s: three samples.
    """
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.permutation([1.0, 0.0] * (n // 40)), 20)
    u[:20] = 1.0
    b, a, _ = cont2discrete(([2.0], [3.0, 4.0, 1.0]), 0.5, "zoh")
    y = lfilter(b.ravel(), a, np.append(np.zeros(3), u[:-3]))
    return IOData.from_arrays(u, 20 + y + 0.05 * rng.normal(size=n), 0.5, hold="zoh")


@pytest.mark.e2e
def test_a_record_that_begins_when_the_heater_is_switched_has_its_dead_time():
    covered = []
    for seed in range(20):
        result = fit(from_rest(seed), "P2D", noise="white", baseline="none")
        assert result.problem.initial == "level"
        true_values = {"Kp": 2.0, "Tp1": 3.0, "Tp2": 1.0, "Td": 1.5}
        estimates = result.estimates
        covered += [estimates[n].low95 < v < estimates[n].high95 for n, v in true_values.items()]
    assert np.mean(covered) > 0.88  # 80 intervals: 0.95 less three standard deviations
    comparison = compare(from_rest(0))
    assert comparison.recommended == "P2D"
    assert "another level of the input than its first" in comparison.advice


def test_estimated_initial_state_removes_the_bias_of_a_record_that_begins_in_a_transient():
    rng = np.random.default_rng(0)
    u, hold = case_a_input("PRBS", rng, 1200)
    y = simulate(process("P2D").rational(CASE_A), u, 0.05, hold) + 0.3 * rng.normal(size=1200)
    cut = IOData.from_arrays(u[407:], y[407:], 0.05, hold=hold)  # begins amid a transient
    result = fit(cut, "P2D", initial="estimated", noise="white", baseline="none")
    for name, true_value in CASE_A.items():
        # a dead time of 7 samples hides part of the past: the state is only as good as the record's
        # start
        assert result.estimates[name].value == pytest.approx(
            true_value, abs=5 * result.estimates[name].u
        ), name
    assert (
        result.identified.statistics["rms"] < fit(cut, "P2D", **PLAIN).identified.statistics["rms"]
    )


def test_robust_losses_recover_the_parameters_despite_spikes():
    data = case_a("PRBS", 4)
    y = data.runs[0].y[:, 0].copy()
    y[50::40] += 40.0
    spiked = IOData.from_arrays(data.runs[0].u, y, 0.05, hold="zoh")
    plain, huber, tukey = (
        fit(spiked, "P2D", loss=loss, **PLAIN) for loss in ("linear", "huber", "bisquare")
    )
    assert "spikes" in plain.identified.sentence
    for robust in (huber, tukey):
        for name, true_value in CASE_A.items():
            assert robust.estimates[name].value == pytest.approx(
                true_value, abs=4.5 * robust.estimates[name].u
            ), name
        assert robust.estimates["Td"].u < 0.25 * plain.estimates["Td"].u


def test_sandwich_covariance_widens_under_coloured_noise_and_a_noise_model_narrows_it():
    data = case_a("PRBS", 0, colour=0.9)
    classical = fit(data, "P2D", covariance="classical", **PLAIN)
    sandwich = fit(data, "P2D", **PLAIN)
    modelled = fit(data, "P2D", noise=(1, 0), baseline="none", initial="equilibrium")
    assert sandwich.identified.statistics["robust_covariance"] == 1.0
    assert sandwich.estimates["Tp1"].u > 1.5 * classical.estimates["Tp1"].u
    assert modelled.estimates["Td"].u < sandwich.estimates["Td"].u
    assert modelled.noise.ar[0] == pytest.approx(-0.9, abs=4 * np.sqrt((1 - 0.81) / 800))
    assert validate(modelled).whiteness.p > 0.001


def test_rao_garnier_benchmark_is_recovered_without_start_values():
    result = fit(rao_garnier(0), transfer(1, 4), initial="zero", noise="white", baseline="none")
    for name, true_value in RAO_GARNIER.items():
        assert result.estimates[name].value == pytest.approx(
            true_value, abs=4 * result.estimates[name].u
        ), name


def test_profile_and_quadratic_intervals_agree_for_a_quadratic_cost():
    result = fit(case_a("PRBS", 1), "P2D", intervals="quadratic", **PLAIN)
    for name in ("Tp1", "Td"):
        interval, is_closed = profile(result, name)
        assert is_closed
        assert (interval.low95, interval.high95) == pytest.approx(
            (result.estimates[name].low95, result.estimates[name].high95),
            abs=0.1 * result.estimates[name].u,
        )


def test_superfluous_lag_gets_an_open_interval_and_a_warning():
    result = fit(case_a("PRBS", 3), "P3D", **PLAIN)
    assert any("Tp3" in w for w in result.warnings)
    assert result.estimates["Tp3"].high95 < 0.3


def test_json_and_python_control_preserve_the_model():
    model = fit(case_a("PRBS", 0), "P2D", **PLAIN).identified
    restored = Identified.from_json(model.to_json())
    assert restored.to_json() == model.to_json()
    assert np.array_equal(restored.simulate(np.arange(50.0)), model.simulate(np.arange(50.0)))
    g = model.transfer_function(pade_order=4)
    f = np.array([0.01, 0.1, 0.3])
    exact = model.rational.frequency_response(f)
    assert np.allclose(g(2j * np.pi * f), exact, atol=2e-3)  # Pade of order 4 at Td w < 0.7


def test_repeated_fit_gives_the_identical_result():
    data = case_a("plunge", 7)
    assert (
        fit(data, "P2D", **PLAIN).identified.to_json()
        == fit(data, "P2D", **PLAIN).identified.to_json()
    )


def test_nearly_equal_lags_keep_the_uncertainty_of_their_sum():
    """One lag with a dead time under coloured noise, fitted by two lags that coincide. The
    uncertainty of their sum must not vanish."""
    t = np.arange(1200.0)
    for seed in (4, 8, 10):
        noise = lfilter([1.0], [1.0, -0.98], np.random.default_rng(seed).normal(0, 0.02, len(t)))
        y = 10 * (1 - np.exp(-np.clip(t - 260, 0, None) / 100)) + noise
        data = IOData.from_arrays((t >= 200) * 1.0, y, 1.0, hold="zoh")
        model = fit(data, "P2", intervals="quadratic", **PLAIN).identified
        assert model.theta["Tp1"] == pytest.approx(model.theta["Tp2"], rel=1e-3)
        assert 4 < model.lag_s.u < 10  # eight such records gave 5 to 8 s
        # coinciding lags differ by nothing: semidefinite to rounding
        eigenvalues = np.linalg.eigvalsh(model.covariance)
        assert eigenvalues.min() > -1e-14 * eigenvalues.max()


def test_integrator_with_estimated_state_has_no_separate_offset():
    """The free state of the integrator holds the level, so an offset could not be separated from
    it."""
    rng = np.random.default_rng(9)
    u = np.repeat(rng.choice([-1.0, 1.0], 30), 20)
    y = 7 + simulate(process("P1I").rational({"Kp": 0.05, "Tp1": 2.0}), u, 0.5, "zoh", "zero")
    data = IOData.from_arrays(u, y + 0.01 * rng.normal(size=len(u)), 0.5, hold="zoh")
    result = fit(data, "P1I", initial="estimated", noise="white", baseline="none")
    assert not result.warnings
    for name, true_value in (("Kp", 0.05), ("Tp1", 2.0)):
        assert result.estimates[name].value == pytest.approx(
            true_value, abs=4 * result.estimates[name].u
        )


def findings_of(**changed: float) -> tuple[dict[str, str], list[str]]:
    """Findings for two lags and a zero. All parameters are well determined, u = 1 %, except those
    ``changed``."""
    problem = make_problem(case_a("PRBS", 1), process("P2DZ"), "equilibrium")
    theta = {"Kp": 1.0, "Tp1": 2.0, "Tp2": 0.5, "Tz": 0.3, "Td": 0.37, **changed}
    x = problem.vector(theta)
    size = problem.size
    no_rows = np.zeros((0, size))
    optimum = Optimum(
        problem.least_squares_problem(),
        x,
        np.zeros(0),
        no_rows,
        0.0,
        np.eye(size),
        np.eye(size),
        Status.CONVERGED,
        1,
    )
    u = np.array([changed.get(f"u_{n}", 0.01 * abs(theta[n])) for n in problem.model.free])
    findings = parameter_findings(optimum, Identified.of(problem.model, theta, np.diag(u**2)))
    return {f.subject: f.code for f in findings}, [str(f.numbers.get("end", "")) for f in findings]


@pytest.mark.parametrize(
    ("changed", "code", "end"),
    [
        ({}, {}, []),
        ({"Td": 0.0}, {"Td": "fit.bound"}, ["lower"]),
        ({"Td": 20.0}, {"Td": "fit.bound"}, ["upper"]),  # half of 800 samples of 0.05 s
        ({"Tp2": 0.5e-3}, {"Tp2": "fit.bound"}, ["lower"]),  # a hundredth of a sample
        ({"Tp1": 4000.0}, {"Tp1": "fit.bound"}, ["upper"]),  # a hundred records
        ({"Tp2": 1.985}, {"Tp1": "fit.twin", "Tp2": "fit.twin"}, ["", ""]),
        ({"Tp2": 1.97}, {}, []),
        ({"u_Tp2": 0.26}, {"Tp2": "fit.undetermined"}, [""]),
        ({"u_Tp2": 0.24, "u_Kp": 0.49, "u_Tz": 1.2}, {}, []),  # a zero is measured by both lags
        ({"u_Tz": 1.3}, {"Tz": "fit.undetermined"}, [""]),
    ],
)
def test_parameter_findings_name_the_parameter_and_the_bound(changed, code, end):
    assert findings_of(**changed) == (code, end)


def test_final_offset_continues_drift_and_random_walk():
    """Offsets of two runs, a drift of each over its length, and a random walk that ends half a
    unit above the model."""
    data = case_a("PRBS", 1)
    run = data.runs[0]
    two_runs = replace(data, runs=(run, replace(run, u=run.u[:400], y=run.y[:400])))
    problem = replace(
        make_problem(two_runs, process("P1", offset="per run"), "equilibrium"), trend=True
    )
    x = np.zeros(problem.size)
    x[2:4] = (3.0, 5.0)
    x[-2:] = (0.8, 0.4)  # the drift per length of the longest run
    residual = np.r_[np.zeros(1180), np.full(20, 0.5)]
    assert final_offset(problem, x, residual, NoiseModel()) == pytest.approx(
        4.0 + (0.8 * 1.0 + 0.4 * 0.5) / 2
    )
    with_walk = final_offset(
        replace(problem, trend=False), x[:-2], residual, NoiseModel((-1.0,), starts_at_rest=True)
    )
    assert with_walk == pytest.approx(4.0 + 0.5)


def test_bic_and_aicc_of_white_residuals_match_the_textbook():
    """N ln(S/N) + k ln N, and Hurvich and Tsai's AICc. The noise has N - p degrees of freedom; k
    is p + 1."""
    result = fit(
        case_a("PRBS", 2), "P2D", intervals="quadratic", check=False, start=CASE_A, **PLAIN
    )
    n = 800
    p = 5  # with the offset
    sse = float(result.residual @ result.residual)
    statistics = result.identified.statistics
    assert statistics["parameters"] == p
    assert statistics["bic"] == pytest.approx(n * np.log(sse / n) + (p + 1) * np.log(n))
    assert statistics["aicc"] == pytest.approx(n * np.log(sse / n) + 2 * (p + 1) * n / (n - p - 2))
    assert result.identified.noise_sd == pytest.approx(np.sqrt(sse / (n - p)))
