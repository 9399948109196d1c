"""Equation error: disturbances that come in before the poles, against recursions of another make."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from tcdyn.core.errors import InputError
from tcdyn.identify import IOData, compare, fit, several, transfer
from tcdyn.identify.heldout import block_held_out_rms
from tcdyn.identify.models import as_model
from tcdyn.identify.search import make_problem
from tcdyn.identify.shared_poles import arx_regression, common_pole_fits

DT, POLES = 0.5, np.array([0.9, 0.6])  # of the recursion y_t = sum b u_(t-k) - sum a y_(t-k) + e_t
A = np.poly(POLES)


def stirred(seed: int, n: int = 600, noise: float = 0.3) -> IOData:
    """Two held inputs, and white noise that goes through the same two poles as they do."""
    rng = np.random.default_rng(seed)
    heat, fan = (np.repeat(rng.choice([0.0, 1.0], -(-n // k)), k)[:n] for k in (9, 5))
    into = (
        lfilter([0.0, 0.1, 0.05], [1.0], heat)
        - lfilter([0.0, 0.2], [1.0], fan)
        + 0.2 * noise * rng.normal(size=n)
    )
    u = np.stack([heat, fan], 1)
    u[:8] = into[:8] = 0.0
    return IOData.from_arrays(
        u, 3.0 + lfilter([1.0], A, into), DT, hold="zoh", input_names=["heat", "fan"]
    )


def pair(order: int = 2) -> object:
    """Both inputs behind the same poles, which colour the noise."""
    return several([transfer(order, order, arx=True)] * 2, ["heat", "fan"], common=True)


def test_slopes_of_the_equation_error_are_its_own():
    data = stirred(1, 80)
    gap = data.runs[0].y.copy()
    gap[30:34] = np.nan
    posed = replace(
        make_problem(replace(data, runs=(replace(data.runs[0], y=gap),)), pair(), "estimated"),
        time_scale_s=2.0,
    )
    x = np.linspace(0.4, 1.3, posed.size)
    core = posed.least_squares_problem()
    value, slopes = core.evaluate(x)
    for k in range(posed.size):
        step = np.eye(posed.size)[k] * 1e-5
        difference = (core.evaluate(x + step)[0] - core.evaluate(x - step)[0]) / 2e-5
        assert np.allclose(difference, slopes[:, k], atol=1e-4 * max(1.0, np.abs(difference).max()))
    assert (
        np.count_nonzero(value == 0) == 2
    )  # where a stretch lacks the two samples before, its state not free


def test_a_state_that_is_free_is_told_by_the_first_samples():
    """It was told by none, for A(q) takes free responses away: the fit of such a simulation was -1e15 %."""
    data = stirred(0)
    gone = data.runs[0].u.copy()
    gone[200:220] = np.nan
    gap = replace(data, runs=(replace(data.runs[0], u=gone),))
    plain = fit(data, pair(), check=False)
    for each, initial in ((data, "estimated"), (gap, "equilibrium"), (gap, "estimated")):
        found = fit(each, pair(), initial=initial, check=False)
        assert found.identified.statistics["fit_percent"] == pytest.approx(
            plain.identified.statistics["fit_percent"], abs=1
        )
        assert found.estimates["a1"].value == pytest.approx(
            plain.estimates["a1"].value, abs=plain.estimates["a1"].u
        )
        assert not found.findings


@pytest.mark.study
def test_poles_and_gains_are_covered_where_noise_comes_in_before_the_poles():
    held = []
    spread = []
    truth = {"a1": -np.sum(DT / np.log(POLES)), "b0.fan": -0.2 / A.sum(), "b0.heat": 0.15 / A.sum()}
    begun = {"start": {"a1": 5.0, "a2": 4.0}, "intervals": "quadratic", "check": False}
    for seed in range(40):
        found = fit(stirred(seed), pair(), **begun)
        plain = fit(
            stirred(seed), several([transfer(2, 2)] * 2, ["heat", "fan"], common=True), **begun
        )
        held.append([found.estimates[n].contains(v) for n, v in truth.items()])
        spread.append([f.estimates["b0.fan"].value - truth["b0.fan"] for f in (found, plain)])
        assert found.identified.statistics["p_white"] > 1e-4
    assert np.mean(held) > 0.88  # of 120, nominal 0.95; standard error 0.02
    own, output_error = np.std(spread, axis=0)
    assert own < 0.9 * output_error  # what the noise tells of the poles is worth something


def test_a_regression_finds_the_poles_and_a_stride_does_not_move_them():
    posed = make_problem(stirred(0, 4000, 0.0), pair(), "equilibrium")
    for stride in (1, 3):
        below, _ = arx_regression(posed, 2, 0, stride)
        assert below[1] == pytest.approx(
            -np.sum(DT / np.log(POLES)), rel=1e-3 if stride == 1 else 0.1
        )


def test_the_criterion_of_a_record_given_twice_is_twice_that_of_one_but_for_the_parameters():
    once = stirred(4)
    one, two = (
        arx_regression(make_problem(replace(once, runs=once.runs * k), pair(), "equilibrium"), 2)[1]
        for k in (1, 2)
    )
    assert 2 * one - two == pytest.approx(
        2 * (2 + 2 * 3 + 1)
    )  # two poles, three samples of each input, a level


def test_a_block_that_is_left_out_is_foreseen_as_a_fit_without_it_foresees_it():
    data = stirred(2)
    model = several([transfer(1, 1)] * 2, ["heat", "fan"], common=True)
    found = fit(data, model, intervals="quadratic", check=False)
    errors = []
    for block in np.array_split(np.arange(600), 6)[1:]:
        y = data.runs[0].y.copy()
        y[block] = np.nan
        less = fit(
            replace(data, runs=(replace(data.runs[0], y=y),)),
            model,
            start=found.identified.theta,
            check=False,
        )
        simulated = less.identified.simulate(data.runs[0].u)
        errors.append((simulated - data.runs[0].y[:, 0])[block])
    assert block_held_out_rms(found) == pytest.approx(
        float(np.sqrt(np.mean(np.concatenate(errors) ** 2))), rel=0.03
    )


@pytest.mark.study
def test_the_bare_comparison_takes_equation_error_where_the_noise_asks_for_it():
    found = compare(stirred(3, 400, 1.0))
    assert found.best.identified.statistics["p_input"] > 0.01
    assert (
        "ARX" in found.recommended or found.best.noise.order != (0, 0) or found.best.noise.averaged
    )


def test_names_are_read_and_what_cannot_be_is_refused():
    assert as_model("ARX(2,2)").arx
    assert as_model("ARX(2,2)").name == "ARX(2,2)"
    with pytest.raises(InputError, match=r"noise of its own poles.*leave noise"):
        fit(stirred(0, 100).select("heat"), "ARX(1,1)", noise=(1, 0), check=False)
    with pytest.raises(InputError, match=r"poles that colour the noise differ.*common=True"):
        several(["ARX(1,1)", "ARX(1,1)"], ["heat", "fan"])


def test_a_candidate_with_dead_time_has_one_zero_less_and_finds_it() -> None:
    rng = np.random.default_rng(12)
    dt_s = 0.1
    u = np.repeat(rng.choice([0.0, 1.0], 80), 15)
    u[:30] = 0.0
    late = np.concatenate([np.zeros(7), u])[: len(u)]
    keep = np.exp(-dt_s / 0.8)
    y = lfilter([0, 2 * (1 - keep)], [1, -keep], late) + 0.02 * rng.standard_normal(len(u))
    data = IOData.from_arrays(u, y, dt_s, hold="zoh")
    found = list(common_pole_fits(data, 1, False, {}, fit(data, "P1").problem.model))
    late_ones = [f for f in found if "Td" in f.estimates]
    assert 0 < len(late_ones) < len(found)
    for f in late_ones:
        assert set(f.estimates) == {"b0", "a1", "Td"}
        for name, true in (("b0", 2.0), ("a1", 0.8), ("Td", 0.7)):
            assert abs(f.estimates[name].value - true) < 4 * f.estimates[name].u
