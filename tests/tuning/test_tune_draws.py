"""Draws of models: positive where they must be, of the right mean and spread, always the same."""

from __future__ import annotations

import numpy as np
import pytest

from tcdyn.core.errors import InputError
from tcdyn.estimation.noise_average import MixturePart
from tcdyn.identification import Identified, process, transfer
from tcdyn.identification.draws import N_DRAWS, draw_models
from tests.tuning.tuning_cases import HEATER, model

FIVE = 5 / np.sqrt(N_DRAWS)  # five standard errors of a mean, in standard deviations


def test_draws_have_the_mean_and_spread_of_the_covariance() -> None:
    draws, redrawn = draw_models(model("P1D", HEATER))
    assert len(draws) == N_DRAWS
    assert redrawn == 0
    for values, name in (
        ([d.num[0] for d in draws], "Kp"),
        ([d.factors[0].coefs[1] for d in draws], "Tp1"),
        ([d.delay_s for d in draws], "Td"),
    ):
        u = 0.02 * HEATER[name]
        assert np.mean(values) == pytest.approx(HEATER[name], abs=FIVE * u + 1e-3 * HEATER[name])
        assert np.std(values) == pytest.approx(u, rel=0.15)


def test_draws_are_the_same_each_time() -> None:
    first, second = (draw_models(model("P1D", HEATER))[0] for _ in range(2))
    assert [d.delay_s for d in first] == [d.delay_s for d in second]


def test_lags_and_dead_times_stay_positive_however_uncertain() -> None:
    draws, redrawn = draw_models(model("P2D", {**HEATER, "Tp2": 5.0}, relative_u=2.0))
    assert all(f.coefs[1] > 0 for d in draws for f in d.factors)
    assert min(d.delay_s for d in draws) >= 0
    # three of them, each positive in Phi(0.5) of the draws
    assert 1 - redrawn == pytest.approx(0.6915**3, abs=0.05)


def test_a_sum_of_lags_that_is_determined_stays_so() -> None:
    """Each of two lags and the dead time may be anything; their sum is known to 1 %."""
    structure = process("P2D")
    theta = {"Kp": 1.0, "Tp1": 50.0, "Tp2": 10.0, "Td": 8.0}
    direction = np.array([0.0, 5.0, -12.0, 7.0])
    covariance = np.outer(direction, direction) + np.diag([1e-6, 0.1, 0.1, 0.1])
    draws, _ = draw_models(Identified.of(structure, theta, covariance))
    assert np.std([d.factors[1].coefs[1] for d in draws]) > 4
    assert np.std([d.lag_s for d in draws]) < 0.7


def test_damping_of_a_pair_stays_positive() -> None:
    draws, _ = draw_models(model("P2U", {"Kp": 1.0, "Tw": 2.0, "Zeta": 0.3}, relative_u=1.0))
    assert all(d.is_stable for d in draws)


def test_the_time_of_the_output_is_uncertainty_of_the_dead_time() -> None:
    exact = Identified.of(process("P1D"), HEATER, np.zeros((3, 3)))
    assert draw_models(exact) == ((), 0.0)
    draws, _ = draw_models(exact.with_timing(0.5))
    assert np.std([d.delay_s for d in draws]) == pytest.approx(0.5, rel=0.15)


def test_parts_of_a_mixture_are_drawn_by_their_weights() -> None:
    near, far = (
        MixturePart(w, np.array([shift]), np.array([[1e-6]])) for w, shift in ((0.8, 0), (0.2, 0.5))
    )
    theta = {"Kp": 1.0, "Tp1": 2.0}
    structure = process("P1", fixed={"Tp1": 2.0})
    mixed = Identified.of(structure, theta, np.array([[0.04]]), parts=(near, far))
    gains = np.array([d.num[0] for d in draw_models(mixed)[0]])
    assert np.mean(gains > 1.25) == pytest.approx(0.2, abs=5 * 0.4 / np.sqrt(N_DRAWS))
    assert np.std(gains[gains < 1.25]) < 0.002


def test_unstable_draws_are_drawn_again() -> None:
    """a2 of a transfer function may change its sign."""
    structure = transfer(0, 2)
    theta = {"b0": 1.0, "a1": 5.0, "a2": 1.0}
    uncertain = Identified.of(structure, theta, np.diag([1e-4, 1e-4, 1.0]))
    draws, redrawn = draw_models(uncertain)
    assert all(d.is_stable for d in draws)
    assert redrawn == pytest.approx(0.16, abs=0.08)  # Phi(-1)
    hopeless = Identified.of(structure, theta, np.diag([1e-4, 1e-4, 1e12]))
    assert draw_models(hopeless)[1] == pytest.approx(0.5, abs=0.1)


def test_a_covariance_that_is_not_finite_is_refused() -> None:
    structure = process("P1D")
    broken = Identified(structure, HEATER, np.full((3, 3), np.nan), {})
    with pytest.raises(InputError, match="not finite"):
        draw_models(broken)
