"""Equation error: disturbances that enter before the poles, against independent recursions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from identify_cases import PLAIN
from scipy.signal import lfilter

from tcdyn.core.errors import InputError
from tcdyn.core.findings import Severity
from tcdyn.identification import IOData, compare, fit, several, transfer
from tcdyn.identification.heldout import block_held_out_rms
from tcdyn.identification.models import as_model
from tcdyn.identification.search import make_problem
from tcdyn.identification.shared_poles import arx_regression, common_pole_fits

DT = 0.5
POLES = np.array([0.9, 0.6])  # of the recursion y_t = sum b u_(t-k) - sum a y_(t-k) + e_t
A = np.poly(POLES)


def two_input_record(seed: int, n: int = 600, noise: float = 0.3) -> IOData:
    """Two held inputs, and white noise that passes through the same two poles as the inputs."""
    rng = np.random.default_rng(seed)
    heat, fan = (np.repeat(rng.choice([0.0, 1.0], -(-n // k)), k)[:n] for k in (9, 5))
    equation_input = (
        lfilter([0.0, 0.1, 0.05], [1.0], heat)
        - lfilter([0.0, 0.2], [1.0], fan)
        + 0.2 * noise * rng.normal(size=n)
    )
    u = np.stack([heat, fan], 1)
    u[:8] = equation_input[:8] = 0.0
    return IOData.from_arrays(
        u, 3.0 + lfilter([1.0], A, equation_input), DT, hold="zoh", input_names=["heat", "fan"]
    )


def common_pole_model(order: int = 2) -> object:
    """A model in which both inputs share the poles that also colour the noise."""
    return several([transfer(order, order, arx=True)] * 2, ["heat", "fan"], common=True)


def test_sensitivities_of_the_equation_error_equal_central_differences():
    data = two_input_record(1, 80)
    gap = data.runs[0].y.copy()
    gap[30:34] = np.nan
    problem = replace(
        make_problem(
            replace(data, runs=(replace(data.runs[0], y=gap),)), common_pole_model(), "estimated"
        ),
        time_scale_s=2.0,
    )
    x = np.linspace(0.4, 1.3, problem.size)
    core = problem.least_squares_problem()
    value, slopes = core.evaluate(x)
    for k in range(problem.size):
        step = np.eye(problem.size)[k] * 1e-5
        difference = (core.evaluate(x + step)[0] - core.evaluate(x - step)[0]) / 2e-5
        assert np.allclose(difference, slopes[:, k], atol=1e-4 * max(1.0, np.abs(difference).max()))
    # the two samples after the gap lack their predecessors, and the state there is not free
    assert np.count_nonzero(value == 0) == 2


@pytest.mark.e2e
def test_free_initial_state_is_determined_by_the_first_samples():
    """A(q) removes free responses, so the equation error alone leaves the state undetermined."""
    data = two_input_record(0)
    input_with_gap = data.runs[0].u.copy()
    input_with_gap[200:220] = np.nan
    gap = replace(data, runs=(replace(data.runs[0], u=input_with_gap),))
    plain = fit(data, common_pole_model(), check=False, **PLAIN)
    for record, initial in ((data, "estimated"), (gap, "equilibrium"), (gap, "estimated")):
        result = fit(
            record,
            common_pole_model(),
            initial=initial,
            check=False,
            noise="white",
            baseline="none",
        )
        assert result.identified.statistics["fit_percent"] == pytest.approx(
            plain.identified.statistics["fit_percent"], abs=1
        )
        assert result.estimates["a1"].value == pytest.approx(
            plain.estimates["a1"].value, abs=plain.estimates["a1"].u
        )
        assert not result.findings


@pytest.mark.study
def test_intervals_of_poles_and_gains_cover_when_noise_enters_before_the_poles():
    covered = []
    errors = []
    true_theta = {
        "a1": -np.sum(DT / np.log(POLES)),
        "b0.fan": -0.2 / A.sum(),
        "b0.heat": 0.15 / A.sum(),
    }
    options = {
        "start": {"a1": 5.0, "a2": 4.0},
        "intervals": "quadratic",
        "check": False,
        **PLAIN,
    }
    for seed in range(40):
        result = fit(two_input_record(seed), common_pole_model(), **options)
        plain = fit(
            two_input_record(seed),
            several([transfer(2, 2)] * 2, ["heat", "fan"], common=True),
            **options,
        )
        covered.append([result.estimates[n].contains(v) for n, v in true_theta.items()])
        errors.append([f.estimates["b0.fan"].value - true_theta["b0.fan"] for f in (result, plain)])
        assert result.identified.statistics["p_white"] > 1e-4
    assert np.mean(covered) > 0.88  # of 120, nominal 0.95; standard error 0.02
    equation_error, output_error = np.std(errors, axis=0)
    assert equation_error < 0.9 * output_error  # the noise carries information about the poles


def test_arx_regression_recovers_the_poles_for_any_stride():
    problem = make_problem(two_input_record(0, 4000, 0.0), common_pole_model(), "equilibrium")
    for stride in (1, 3):
        coefficients, _ = arx_regression(problem, 2, 0, stride)
        assert coefficients[1] == pytest.approx(
            -np.sum(DT / np.log(POLES)), rel=1e-3 if stride == 1 else 0.1
        )


def test_criterion_of_a_duplicated_record_doubles_except_for_the_parameter_count():
    record = two_input_record(4)
    single, double = (
        arx_regression(
            make_problem(replace(record, runs=record.runs * k), common_pole_model(), "equilibrium"),
            2,
        )[1]
        for k in (1, 2)
    )
    # two poles, three samples of each input, a level
    assert 2 * single - double == pytest.approx(2 * (2 + 2 * 3 + 1))


def test_block_held_out_rms_equals_refits_without_each_block():
    data = two_input_record(2)
    model = several([transfer(1, 1)] * 2, ["heat", "fan"], common=True)
    result = fit(data, model, intervals="quadratic", check=False, **PLAIN)
    errors = []
    for block in np.array_split(np.arange(600), 6)[1:]:
        y = data.runs[0].y.copy()
        y[block] = np.nan
        refit = fit(
            replace(data, runs=(replace(data.runs[0], y=y),)),
            model,
            start=result.identified.theta,
            check=False,
            **PLAIN,
        )
        simulated = refit.identified.simulate(data.runs[0].u)
        errors.append((simulated - data.runs[0].y[:, 0])[block])
    assert block_held_out_rms(result) == pytest.approx(
        float(np.sqrt(np.mean(np.concatenate(errors) ** 2))), rel=0.03
    )


@pytest.mark.study
def test_disturbances_before_the_poles_give_common_poles_with_a_warning():
    """Their noise is smoother than any that is averaged over, and the intervals are robust."""
    comparison = compare(two_input_record(3, 400, 1.0))
    assert "common poles" in comparison.recommended
    assert comparison.conclusion.severity is Severity.WARNING
    statistics = comparison.best.identified.statistics
    assert statistics["p_input"] > 0.01
    assert statistics["robust_covariance"] == 1.0
    gain = comparison.averaged["heat"]["gain"]
    # the numerator of the equation over the sum of its denominator
    assert abs(gain.value - 0.15 / A.sum()) < 4 * gain.u


def test_arx_names_are_parsed_and_invalid_combinations_raise():
    assert as_model("ARX(2,2)").arx
    assert as_model("ARX(2,2)").name == "ARX(2,2)"
    with pytest.raises(InputError, match=r"noise of its own poles.*leave noise"):
        fit(two_input_record(0, 100).select("heat"), "ARX(1,1)", noise=(1, 0), check=False)
    with pytest.raises(InputError, match=r"poles that colour the noise differ.*common=True"):
        several(["ARX(1,1)", "ARX(1,1)"], ["heat", "fan"])


@pytest.mark.e2e
def test_arx_candidates_with_dead_time_have_one_zero_less_and_recover_the_parameters() -> None:
    rng = np.random.default_rng(12)
    dt_s = 0.1
    u = np.repeat(rng.choice([0.0, 1.0], 80), 15)
    u[:30] = 0.0
    delayed = np.concatenate([np.zeros(7), u])[: len(u)]
    decay = np.exp(-dt_s / 0.8)
    y = lfilter([0, 2 * (1 - decay)], [1, -decay], delayed) + 0.02 * rng.standard_normal(len(u))
    data = IOData.from_arrays(u, y, dt_s, hold="zoh")
    results = list(common_pole_fits(data, 1, False, {}, fit(data, "P1", **PLAIN).problem.model))
    with_dead_time = [f for f in results if "Td" in f.estimates]
    assert 0 < len(with_dead_time) < len(results)
    for f in with_dead_time:
        assert set(f.estimates) == {"b0", "a1", "Td"}
        for name, true_value in (("b0", 2.0), ("a1", 0.8), ("Td", 0.7)):
            assert abs(f.estimates[name].value - true_value) < 4 * f.estimates[name].u
