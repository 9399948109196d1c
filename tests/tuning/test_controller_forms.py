"""Forms of a controller are one transfer function, and convert back and forth."""

from __future__ import annotations

import numpy as np
import pytest

from tcdyn.tuning import Controller

OMEGA = np.geomspace(1e-3, 1e3, 50)


@pytest.mark.parametrize(
    ("gain", "integral_s", "derivative_s", "filter_s"),
    [(2.0, 8.0, 2.0, 0.2), (-0.7, 10.0, 10.0, 1.0), (5.0, 3.0, 0.0, 0.0)],
)
def test_series_form_is_its_transfer_function_and_comes_back(
    gain: float, integral_s: float, derivative_s: float, filter_s: float
) -> None:
    controller = Controller.from_series(gain, integral_s, derivative_s, filter_s)
    s = 1j * OMEGA
    expected = gain * (1 + 1 / (integral_s * s)) * (1 + derivative_s * s) / (1 + filter_s * s)
    np.testing.assert_allclose(controller.frequency_response(OMEGA), expected, rtol=1e-12)
    series = controller.series
    assert series is not None
    # a double zero has half of the digits
    assert series.gain == pytest.approx(gain, rel=1e-7)
    assert series.integral_s == pytest.approx(integral_s, rel=1e-7)
    assert series.derivative_s == pytest.approx(derivative_s, rel=1e-7)


def test_ideal_form_is_its_transfer_function_and_comes_back() -> None:
    controller = Controller.from_ideal(2.0, 8.0, 1.5, 0.1)
    s = 1j * OMEGA
    expected = 2.0 * (1 + 1 / (8.0 * s) + 1.5 * s / (1 + 0.1 * s))
    np.testing.assert_allclose(controller.frequency_response(OMEGA), expected, rtol=1e-12)
    ideal = controller.ideal
    assert (ideal.gain, ideal.integral_s, ideal.derivative_s) == pytest.approx((2.0, 8.0, 1.5))
    series = controller.series
    assert series is not None
    again = Controller.from_series(series.gain, series.integral_s, series.derivative_s, 0.1)
    assert (again.kp, again.ki, again.kd) == pytest.approx(
        (controller.kp, controller.ki, controller.kd)
    )


def test_complex_zeros_have_no_series_form() -> None:
    assert Controller.from_ideal(2.0, 2.0, 1.5, 0.1).series is None


def test_sampled_controller_approaches_the_continuous_one() -> None:
    """Of first order: the difference halves with the interval."""
    controller = Controller.from_series(2.0, 8.0, 2.0, 0.2)
    omega = np.geomspace(0.01, 2.0, 30)
    exact = controller.frequency_response(omega)
    errors = []
    for sample_s in (0.002, 0.001):
        sampled = controller.sampled(sample_s).frequency_response(omega)
        errors.append(float(np.max(np.abs(sampled / exact - 1))))
    assert errors[1] < 0.005
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.05)


def test_difference_equation_has_the_response_of_the_sampled_controller() -> None:
    """The printed equation, run for a complex exponential in the reading."""
    controller = Controller.from_series(2.0, 8.0, 2.0, 0.2).sampled(0.5)
    assert controller.difference_equation()[1:] == [
        "I = I + 0.125 e",
        "D = 0.28571 D - 5.0143 (reading - last reading)",
        "output = 2.45 e + I + D",
    ]
    omega = 0.9
    reading = -np.exp(1j * omega * 0.5 * np.arange(4000))
    integral = derivative = 0j
    last = 0j
    for k, value in enumerate(reading):
        e = 0 - value
        integral = integral + controller.ki * 0.5 * e
        change = controller.derivative_factor * (value - last)
        derivative = controller.derivative_memory * derivative - change
        output = controller.kp * e + integral + derivative
        last = value
        if k == 0:
            first = integral
    delay = np.exp(-0.5j * omega)
    expected = controller.frequency_response(np.array([omega]))[0]
    # the integral of a wave that begins has a constant besides
    constant = first - controller.ki * 0.5 / (1 - delay)
    assert output / e == pytest.approx(expected + constant / e, rel=1e-6)
