"""Margins with exact dead time: closed forms, published values, and python-control."""

from __future__ import annotations

import control
import numpy as np
import pytest

from tcdyn.chain import Chain
from tcdyn.chain.rational import Rational
from tcdyn.tuning import Controller
from tcdyn.tuning.margins import loop_margins
from tests.tuning.tuning_cases import plant

GRID = 1e-3  # error of margins by the grid of frequencies, 1 % apart, and its interpolation


def test_published_margins_of_simc() -> None:
    """Skogestad (2003), table 3: first order with Ti = tau1, and integrating."""
    lag = loop_margins([plant(1, [8], 1)], Controller.from_ideal(4, 8))
    found = (lag.gain_margin[0], lag.phase_margin_deg[0], lag.ms[0], lag.mt[0])
    assert found == pytest.approx((3.14, 61.4, 1.59, 1.00), abs=0.05 * 0.1 + 0.05)
    integrating = loop_margins([plant(1, [], 1, integrators=1)], Controller.from_ideal(0.5, 8))
    found = (integrating.gain_margin[0], integrating.phase_margin_deg[0], integrating.ms[0])
    assert found == pytest.approx((2.96, 46.9, 1.70), abs=0.05)
    assert integrating.mt[0] == pytest.approx(1.30, abs=0.005)


@pytest.mark.parametrize("gain", [0.2, 0.7, 1.5])
def test_margins_of_a_lag_that_is_cancelled_have_a_closed_form(gain: float) -> None:
    """L = gain exp(-s)/s: GM = pi/(2 gain), PM = 90 deg - gain rad."""
    found = loop_margins([plant(1, [8], 1)], Controller.from_ideal(8 * gain, 8))
    assert found.gain_margin[0] == pytest.approx(np.pi / 2 / gain, rel=GRID)
    assert found.phase_margin_deg[0] == pytest.approx(90 - np.degrees(gain), rel=GRID)
    assert found.is_stable[0]


def test_the_limit_of_stability_is_that_of_the_closed_form() -> None:
    gains = np.pi / 2 * np.array([0.99, 1.01])
    found = [loop_margins([plant(1, [8], 1)], Controller.from_ideal(8 * g, 8)) for g in gains]
    assert [bool(each.is_stable[0]) for each in found] == [True, False]
    assert found[1].gain_margin[0] == pytest.approx(1 / 1.01, rel=GRID)
    assert found[1].phase_margin_deg[0] < 0
    assert found[1].ms[0] == np.inf


CASES = {
    "two lags": (plant(2, [20, 4], 1.5), Controller.from_series(2.0, 12.0, 4.0, 0.4)),
    "integrator and lag": (
        plant(0.1, [3], 1, integrators=1),
        Controller.from_series(2.0, 16.0, 3.0, 0.3),
    ),
    "pair": (plant(1, [2], 0.5, pair=(1.0, 0.3)), Controller.from_ideal(0.3, 2.0)),
    "zero": (plant(-1, [5, 1], 0.5, zeros=[3]), Controller.from_ideal(-1.0, 4.0)),
    "too large a gain": (plant(1, [5, 1], 0.5), Controller.from_ideal(30.0, 4.0)),
    "wrong sign": (plant(-1, [5, 1], 0.5), Controller.from_ideal(1.0, 4.0)),
    "short integral time": (plant(0.1, [3], 1, integrators=1), Controller.from_ideal(1.0, 2.0)),
}


def with_pade(g: Rational, controller: Controller) -> control.TransferFunction:
    """The loop with a Pade approximation of high order."""
    s = control.tf("s")
    law = controller.kp + controller.ki / s
    if controller.kd:
        law = law + controller.kd * s / (1 + controller.filter_s * s)
    return g.transfer_function(pade_order=8) * law


@pytest.mark.parametrize("name", CASES)
def test_margins_and_stability_are_those_of_control(name: str) -> None:
    g, controller = CASES[name]
    found = loop_margins([g], controller)
    loop = with_pade(g, controller)
    poles = control.poles(control.feedback(loop))
    assert bool(found.is_stable[0]) == bool(np.all(poles.real < 1e-9))
    if not found.is_stable[0]:
        assert found.phase_margin_deg[0] < 0
        return
    gain_margin, phase_margin_deg, *_ = control.margin(loop)
    assert found.gain_margin[0] == pytest.approx(gain_margin, rel=5 * GRID)
    assert found.phase_margin_deg[0] == pytest.approx(phase_margin_deg, rel=5 * GRID)
    omega = np.geomspace(1e-3, 1e2, 20000)
    response = loop(1j * omega)
    assert found.ms[0] == pytest.approx(np.max(1 / np.abs(1 + response)), rel=5 * GRID)
    assert found.mt[0] == pytest.approx(np.max(np.abs(response / (1 + response))), rel=5 * GRID)


def test_sampling_costs_half_a_sample_of_dead_time() -> None:
    """To first order in the interval: the hold of the output, integral by backward rectangles."""
    g, controller = plant(1, [8], 1), Controller.from_ideal(4, 8)
    sampled = loop_margins([g], controller.sampled(0.1))
    delayed = loop_margins([plant(1, [8], 1.05)], controller)
    assert sampled.ms[0] == pytest.approx(delayed.ms[0], rel=0.01)
    assert sampled.phase_margin_deg[0] == pytest.approx(delayed.phase_margin_deg[0], rel=0.01)
    assert sampled.is_stable[0]


def test_a_slowly_sampled_loop_is_unstable_where_its_poles_say() -> None:
    """Integrator k/s under a sampled integral and proportional part: poles of z^2 - (2 - a - b) z
    + 1 - a, with a = k Kp h and b = k Ki h^2; stable for 2 a + b < 4."""
    g = plant(1, integrators=1)
    for gain, is_stable in ((1.5, True), (2.3, False)):
        found = loop_margins([g], Controller(gain, 0.01).sampled(1.0))
        assert bool(found.is_stable[0]) == is_stable


def test_gain_margin_of_a_slowly_sampled_loop_is_that_at_the_nyquist_frequency() -> None:
    """A plant that settles within a sample: y = K u of the sample before, with integral control."""
    controller = Controller(0.0, 0.5).sampled(1.0)
    margins = loop_margins([Chain([0.1]).rational], controller)
    # z = 1 - 0.5 g is stable up to g = 4; the lag of a tenth of a sample changes it by exp(-10)
    assert margins.gain_margin[0] == pytest.approx(4.0, rel=1e-3)
