"""Responses in time: closed forms, another solver, and sampled against continuous."""

from __future__ import annotations

import numpy as np
import pytest

from tcdyn.tuning import Controller
from tcdyn.tuning.margins import crossover_rad_s
from tcdyn.tuning.reduction import reduce_model
from tcdyn.tuning.responses import simulate_loops
from tcdyn.tuning.rules import simc
from tests.tuning.tuning_cases import plant


def responses_of(g, controller: Controller):
    return simulate_loops([g], controller, crossover_rad_s(g, controller))


def test_response_of_a_cancelled_lag_is_that_of_its_delay_equation() -> None:
    """L = exp(-s)/(2 s): y' = (1 - y(t - 1))/2 from t = 1, in steps of polynomials."""
    found = responses_of(plant(1, [8], 1), Controller.from_ideal(4, 8))
    t = found.time_s
    first = np.clip((t - 1) / 2, 0, None)
    second = -(np.clip(t - 2, 0, None) ** 2) / 8
    third = np.clip(t - 3, 0, None) ** 3 / 48
    part = t < 4
    # the error is of second order in the step, about 1 % of the time constant
    np.testing.assert_allclose(found.setpoint[0, part], (first + second + third)[part], atol=2e-3)


@pytest.mark.parametrize(
    "g",
    [
        plant(1, [8], 1),
        plant(-2, [20, 4], 1.5),
        plant(0.5, [2], 1, integrators=1),
        plant(1, [3], 0.5, pair=(1.0, 0.4)),
        plant(1, [1], 10),
    ],
)
@pytest.mark.parametrize("sample_s", [0.0, 0.3])
def test_integral_of_the_deviation_after_a_load_is_one_over_ki(g, sample_s: float) -> None:
    """Exact for a loop that settles; the sum of a rectangle is half a step of its peak off."""
    tau_c_s = reduce_model(g, 1, sample_s / 2).dead_time_s if not g.factors[1:] else 3.0
    controller = simc(reduce_model(g, 1, sample_s / 2), tau_c_s, 10.0).sampled(sample_s)
    found = responses_of(g, controller)
    step_s = found.time_s[1]
    integral = float(found.load[0].sum() * step_s)
    assert integral == pytest.approx(1 / controller.ki, rel=0.02)
    assert found.setpoint[0, -1] == pytest.approx(1, abs=0.01)
    assert np.isfinite(found.settling_s[0])


def test_a_sampled_loop_is_the_continuous_one_for_a_short_interval() -> None:
    g = plant(2, [20, 4], 1.5)
    controller = simc(reduce_model(g, 2), 3.0, 10.0)
    continuous = responses_of(g, controller)
    errors = []
    for sample_s in (0.2, 0.1):
        sampled = responses_of(g, controller.sampled(sample_s))
        at = np.interp(continuous.time_s, sampled.time_s, sampled.setpoint[0])
        errors.append(float(np.max(np.abs(at - continuous.setpoint[0]))))
    assert errors[1] < 0.02
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.3)


def test_a_very_short_interval_is_a_dead_time() -> None:
    """More than MAX_STEPS samples: the result joins that of fewer."""
    g = plant(1, [8], 1)
    controller = Controller.from_ideal(4, 8)
    peaks = [responses_of(g, controller.sampled(h)).load_peak[0] for h in (0.03, 0.01)]
    assert peaks[0] == pytest.approx(peaks[1], rel=0.01)
    assert len(responses_of(g, controller.sampled(0.001)).time_s) < 7000


def test_numbers_of_a_response() -> None:
    found = responses_of(plant(1, [8], 1), Controller.from_ideal(4, 8))
    y = found.setpoint[0]
    t = found.time_s
    assert found.overshoot_percent[0] == pytest.approx(100 * (y.max() - 1))
    inside = np.abs(y - 1) <= 0.02
    assert inside[t >= found.settling_s[0]].all()
    assert not inside[t < found.settling_s[0]][-1]
    # (t - 1)/2 = 0.1 at 1.2 s; (t - 1)/2 - (t - 2)^2/8 + (t - 3)^3/48 = 0.9 at 3.105 s
    assert found.rise_s[0] == pytest.approx(1.905, abs=0.05)  # one step


@pytest.mark.parametrize("sample_s", [0.0, 0.2])
def test_a_weight_of_the_set_point_reduces_the_overshoot_and_nothing_else(sample_s: float) -> None:
    g = plant(1, [], 1, integrators=1)
    full = Controller.from_ideal(0.5, 8).sampled(sample_s)
    half = full.weighted(0.5)
    first, second = responses_of(g, full), responses_of(g, half)
    assert second.overshoot_percent[0] < 0.5 * first.overshoot_percent[0]
    assert second.setpoint[0, -1] == pytest.approx(1, abs=0.01)
    np.testing.assert_array_equal(first.load, second.load)
    assert "0.5 (0.5 setpoint - reading)" in half.difference_equation()[-1]


def test_an_unstable_loop_is_cut_off() -> None:
    found = responses_of(plant(1, [8], 1), Controller.from_ideal(100, 8))
    assert np.isfinite(found.setpoint).all()
    assert found.settling_s[0] == np.inf
