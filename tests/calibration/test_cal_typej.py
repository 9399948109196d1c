"""Type J on ITS-90, both ways."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.errors import InputError
from calibration.lines.typej import emf_mV, sensitivity_mV_K, temperature_degC


def test_emf_agrees_with_the_published_table():
    table = {25: 1.27729, 50: 2.58532, 85: 4.45619, 100: 5.26892, 200: 10.77875, 760: 42.91864}
    own = emf_mV(np.array(list(table), dtype=float))
    assert own == pytest.approx(list(table.values()), abs=5e-6)  # the table's last digit
    assert emf_mV([-210.0, 1200.0]) == pytest.approx([-8.095, 69.553], abs=5e-4)


@given(st.floats(-210, 1200))
def test_both_ways_agree(t):
    assert float(temperature_degC(emf_mV(t))) == pytest.approx(t, abs=1e-9)  # Newton's last step


@given(st.floats(-20, 60), st.floats(-100, 700))
def test_the_cold_junction_adds_its_own_emf(cold, hot):
    assert float(temperature_degC(emf_mV(hot) - emf_mV(cold), cold)) == pytest.approx(hot, abs=1e-8)


def test_the_two_ranges_join_at_760_degC_and_the_sensitivity_is_the_slope():
    assert float(emf_mV(760.0 + 1e-9) - emf_mV(760.0)) == pytest.approx(0.0, abs=1e-6)  # table's resolution is 1 uV
    t = np.linspace(-200, 1190, 500)
    assert sensitivity_mV_K(t) == pytest.approx((emf_mV(t + 1e-3) - emf_mV(t - 1e-3)) / 2e-3, rel=1e-6)


def test_values_outside_are_refused_or_made_nan_and_nan_stays():
    with pytest.raises(InputError, match="5000 degC at index 1"):
        emf_mV([20.0, 5000.0])
    with pytest.raises(InputError, match="mV"):
        temperature_degC(100.0)
    assert np.isnan(temperature_degC([100.0, np.nan], outside="nan")).all()


def test_any_shape_and_a_trace_at_a_time():
    t = np.random.default_rng(0).uniform(0, 200, (75, 12))
    assert temperature_degC(emf_mV(t)) == pytest.approx(t, abs=1e-9)
