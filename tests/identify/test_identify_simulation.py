"""The simulation used by every fit: exact between samples, with exact sensitivities."""

from __future__ import annotations

import numpy as np
import pytest

from tcdyn.chain.rational import Factor, Rational, realise, simulate, simulate_rows

U = np.random.default_rng(1).normal(size=200).cumsum()


def model(c: np.ndarray, integrators: int = 0) -> Rational:
    """(c0 + c1 s) e^(-c5 s) / ((1 + c2 s)(1 + c3 s + c4 s^2)(1 + 0.04 s)), the last factor
    known."""
    factors = (Factor((1.0, c[2])), Factor((1.0, c[3], c[4])), Factor((1.0, 0.04), free=False))
    return Rational(c[:2], factors, c[5], integrators)


@pytest.mark.parametrize("hold", ["foh", "zoh"])
def test_fractional_dead_time_is_exact_for_either_hold(hold):
    # the same input on a grid 20 times finer, where the dead time is an integer (148 samples),
    # gives the same
    c = np.array([1.0, 0.3, 2.0, 0.2, 0.09, 0.37])
    coarse = simulate(model(c), U, 0.05, hold)
    if hold == "foh":
        fine_u = np.interp(np.arange(199 * 20 + 1) / 20, np.arange(200), U)
    else:
        fine_u = np.repeat(U, 20)[: 199 * 20 + 1]
    fine = simulate(model(c), fine_u, 0.0025, hold)[::20]
    assert np.max(np.abs(fine - coarse)) < 1e-10 * np.max(np.abs(coarse))  # rounding only


@pytest.mark.parametrize("integrators", [0, 1])
@pytest.mark.parametrize("start", ["zero", "equilibrium"])
@pytest.mark.parametrize("hold", ["foh", "zoh"])
def test_sensitivities_equal_central_differences(hold, start, integrators):
    c = np.array([1.0, 0.3, 2.0, 0.2, 0.09, 0.37])
    rows = simulate_rows(realise(model(c, integrators)), U, 0.05, c[5], hold, start)
    for i, e in enumerate(np.eye(6)):
        h = 1e-6
        up = simulate(model(c + h * e, integrators), U, 0.05, hold, start)
        down = simulate(model(c - h * e, integrators), U, 0.05, hold, start)
        difference = (up - down) / (2 * h)
        # truncation h^2 and rounding 1e-16/h of a central difference at h = 1e-6
        assert np.max(np.abs(rows[1 + i] - difference)) < 1e-6 * np.max(np.abs(difference))


def test_equal_lags_lose_no_precision():
    # two equal lags have the step response 1 - (1 + t/T) e^(-t/T); a partial-fraction form would
    # divide by zero
    t = np.arange(400) * 0.02
    g = Rational(np.array([1.0]), (Factor((1.0, 0.7)), Factor((1.0, 0.7))))
    y = simulate(g, np.ones(400), 0.02, "zoh", "zero")
    assert np.allclose(y, 1 - (1 + t / 0.7) * np.exp(-t / 0.7), atol=1e-12)


def test_ramp_through_an_integrator_and_a_lag_matches_the_closed_form():
    t = np.arange(300) * 0.1
    g = Rational(np.array([1.0]), (Factor((1.0, 0.5)),), 0.0, 1)
    y = simulate(g, t, 0.1, "foh", "zero")
    exact = t**2 / 2 - 0.5 * t + 0.25 * (1 - np.exp(-t / 0.5))
    assert np.allclose(y, exact, atol=1e-10 * exact.max())
