"""Simulators of the study of ``compare(data)`` against closed forms, and a short run of the
study."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.special import erfcx

from tests.identify.bare_cases import (
    CASES,
    DEAD_A_S,
    DEN_A,
    DT_S,
    HALF_ORDER,
    HALF_ORDER_S,
    NUM_A,
    SLAB,
    SLAB_S,
    diffusion_response,
    pi_loop,
    response,
    slow_noise,
)
from tests.identify.bare_study import SEVERITIES, study

STEP_ROW = 20
# Unit step at ``STEP_ROW``, and the time since
STEP = np.repeat([0.0, 1.0], [STEP_ROW, 780])
SINCE_S = DT_S * (np.arange(800) - STEP_ROW)


def damped(t: np.ndarray) -> np.ndarray:
    """Step response of 1 / (s^2 + 0.4 s + 1)."""
    frequency = np.sqrt(1 - 0.2**2)
    return 1 - np.exp(-0.2 * t) * (np.cos(frequency * t) + 0.2 / frequency * np.sin(frequency * t))


SYSTEMS = {
    "case A": (
        (NUM_A, DEN_A, DEAD_A_S),
        lambda t: 1 - (2 * np.exp(-t / 2) - 0.5 * np.exp(-t / 0.5)) / 1.5,
    ),
    "feedthrough": (([0.6, 1.0], [2.0, 1.0], 0.0), lambda t: 1 - 0.7 * np.exp(-t / 2)),
    "non-minimum phase": (
        ([-0.6, 1.0], DEN_A, DEAD_A_S),
        lambda t: 1 - (2.6 * np.exp(-t / 2) - 1.1 * np.exp(-t / 0.5)) / 1.5,
    ),
    "damping 0.2": ((NUM_A, [1.0, 0.4, 1.0], DEAD_A_S), damped),
    "integrator": (
        ([0.5], [0.5, 1.0, 0.0], DEAD_A_S),
        lambda t: 0.5 * (t - 0.5 * (1 - np.exp(-t / 0.5))),
    ),
}


@pytest.mark.parametrize("name", SYSTEMS)
def test_step_responses_are_those_of_the_closed_form(name: str) -> None:
    system, closed_form = SYSTEMS[name]
    since_s = np.round(SINCE_S - system[2], 9)
    expected = np.where(since_s >= 0, closed_form(np.clip(since_s, 0, None)), 0.0)
    # exact for a held input: only rounding is left
    assert response(STEP, *system) == pytest.approx(expected, abs=1e-8)


def test_a_coarse_sampling_interval_gives_the_same_system() -> None:
    fine = response(np.repeat([0.0, 1.0], [40, 760]))
    coarse = response(np.repeat([0.0, 1.0], [1, 19]), dt_s=2.0)
    assert coarse == pytest.approx(fine[::40], abs=1e-9)


@pytest.mark.parametrize("name", ["non-minimum phase", "damping 0.2", "feedthrough"])
def test_the_true_lag_is_the_first_moment(name: str) -> None:
    system, _ = SYSTEMS[name]
    dt_s = 0.005
    u = np.ones(12_000)
    moment_s = np.trapezoid(1 - response(u, *system, dt_s=dt_s, start=0.0), dx=dt_s)
    # the trapezium rule errs by at most half a step at the jump of the response
    assert moment_s == pytest.approx(CASES[name].lag_s, abs=dt_s / 2)


def test_first_moment_of_the_slab_is_half_its_diffusion_time() -> None:
    back = diffusion_response(STEP, SLAB)[STEP_ROW:, 1]
    moment_s = np.trapezoid(1 - back, dx=DT_S)
    # finite volumes of 1/80 of the thickness: second order
    assert moment_s == pytest.approx(SLAB_S / 2, rel=1e-3)


def test_half_order_step_response_is_that_of_the_half_space() -> None:
    surface = diffusion_response(STEP, HALF_ORDER)[STEP_ROW:, 0]
    expected = 1 - erfcx(np.sqrt(np.clip(SINCE_S[STEP_ROW:], 0, None) / HALF_ORDER_S))
    # at the step the film and half of the first volume divide the temperature: 0.0014
    assert surface == pytest.approx(expected, abs=2e-3)


def test_half_order_gain_is_one() -> None:
    gain = HALF_ORDER.D - HALF_ORDER.C @ np.linalg.solve(HALF_ORDER.A, HALF_ORDER.B)
    assert gain == pytest.approx(1.0, abs=1e-9)


def test_the_controlled_output_is_the_response_to_the_recorded_input() -> None:
    rng = np.random.default_rng(0)
    disturbance = slow_noise(rng, 0.99)
    u, y = pi_loop(disturbance)
    assert y - disturbance == pytest.approx(response(u, start=50.0), abs=1e-8)


def test_slow_noise_has_unit_sd_and_its_correlation() -> None:
    noise = slow_noise(np.random.default_rng(0), 0.9, 100_000)
    # standard errors of sd and correlation are 0.007 and 0.0014
    assert np.std(noise) == pytest.approx(1.0, abs=0.03)
    assert np.corrcoef(noise[1:], noise[:-1])[0, 1] == pytest.approx(0.9, abs=0.006)


@pytest.mark.parametrize("name", CASES)
def test_a_seed_gives_the_same_record_and_another_seed_another(name: str) -> None:
    first, again, other = (CASES[name].record(seed).runs[0].y for seed in (1, 1, 2))
    assert np.array_equal(first, again, equal_nan=True)
    assert not np.array_equal(first, other, equal_nan=True)


def test_severities_of_a_case_sum_to_one() -> None:
    row = study("constant input", range(2))
    assert sum(row[severity] for severity in SEVERITIES) == pytest.approx(1.0)
    assert row["info"] == 0


@pytest.mark.study
@pytest.mark.parametrize(
    "name", ["white", "P1", "P2", pytest.param("feedthrough", marks=pytest.mark.long)]
)
def test_bare_call_covers_gain_and_lag(name: str, draws: Callable[[int], int]) -> None:
    row = study(name, range(1000, 1000 + draws(20)))
    # loose limits: five to twenty draws
    assert row["gain"] >= 0.7
    assert row["lag_s"] >= 0.7
    assert row["silent"] <= 0.3


@pytest.mark.study
@pytest.mark.parametrize("name", ["closed loop", "constant input"])
def test_bare_call_recommends_no_model_for_an_unusable_record(
    name: str, draws: Callable[[int], int]
) -> None:
    assert study(name, range(1000, 1000 + draws(20)))["info"] <= 0.2
