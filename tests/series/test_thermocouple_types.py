"""Thermocouples on ITS-90 in both directions; logs in millivolts of type J."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tcdyn.core.errors import InputError
from tcdyn.rig.columns import is_junction_column
from tcdyn.rig.log import read_log, write_log
from tcdyn.rig.rigfile import parse_rig, rig_toml
from tcdyn.series.thermocouple_types import emf_mV, temperature_degC
from tests.rig.log_cases import ehl_frame, immersion_frame, oven_frame


def test_emf_agrees_with_the_published_table():
    table = {25: 1.27729, 50: 2.58532, 85: 4.45619, 100: 5.26892, 200: 10.77875, 760: 42.91864}
    emf = emf_mV(np.array(list(table), dtype=float))
    assert emf == pytest.approx(list(table.values()), abs=5e-6)  # last digit of the table
    assert emf_mV([-210.0, 1200.0]) == pytest.approx([-8.095, 69.553], abs=5e-4)


# emf [mV] of the published tables (NIST Monograph 175, reference junction at 0 degC), to their last
# digit
TABLES = {
    "E": {-200: -8.825, -100: -5.237, 100: 6.319, 500: 37.005, 1000: 76.373},
    "J": {-210: -8.095, -100: -4.633, 100: 5.269, 500: 27.393, 1200: 69.553},
    "K": {
        -200: -5.891,
        -100: -3.554,
        25: 1.000,
        100: 4.096,
        500: 20.644,
        1000: 41.276,
        1372: 54.886,
    },
    "N": {-200: -3.990, -100: -2.407, 100: 2.774, 500: 16.748, 1000: 36.256, 1300: 47.513},
    "T": {-200: -5.603, -100: -3.379, 25: 0.992, 100: 4.279, 300: 14.862, 400: 20.872},
}


@pytest.mark.parametrize("thermocouple", TABLES)
def test_every_type_agrees_with_its_table_and_the_inverse_recovers_the_temperature(thermocouple):
    table = TABLES[thermocouple]
    assert emf_mV(np.array(list(table), dtype=float), thermocouple) == pytest.approx(
        list(table.values()), abs=5.1e-4
    )
    t = np.linspace(min(table), max(table), 5000)
    # tolerance: last step of Newton's method
    recovered = temperature_degC(emf_mV(t, thermocouple), thermocouple_type=thermocouple)
    assert recovered == pytest.approx(t, abs=1e-8)
    assert np.all(np.diff(emf_mV(t, thermocouple)) > 0)
    # the two ranges join at 0 degC
    below = emf_mV(-1e-9, thermocouple)
    above = emf_mV(1e-9, thermocouple)
    assert float(above - below) == pytest.approx(0.0, abs=1e-6)


def test_unknown_type_raises():
    with pytest.raises(InputError, match="E or J or K or N or T"):
        emf_mV(20.0, "X")


@given(st.floats(-210, 1200))
def test_inverse_function_recovers_the_temperature(t):
    # last step of Newton's method
    assert float(temperature_degC(emf_mV(t))) == pytest.approx(t, abs=1e-9)


@given(st.floats(-20, 60), st.floats(-100, 700))
def test_cold_junction_adds_its_own_emf(cold, hot):
    assert float(temperature_degC(emf_mV(hot) - emf_mV(cold), cold)) == pytest.approx(hot, abs=1e-8)


def test_two_ranges_join_at_760_degc():
    # the resolution of the table is 1 uV
    assert float(emf_mV(760.0 + 1e-9) - emf_mV(760.0)) == pytest.approx(0.0, abs=1e-6)


def test_values_outside_the_range_raise_or_become_infinite_and_nan_remains():
    with pytest.raises(InputError, match="5000 degC at index 1"):
        emf_mV([20.0, 5000.0])
    with pytest.raises(InputError, match="mV"):
        temperature_degC(100.0)
    assert temperature_degC([100.0, np.nan, -9.0], outside="inf") == pytest.approx(
        [np.inf, np.nan, -np.inf], nan_ok=True
    )


def test_arrays_of_any_shape_are_converted():
    t = np.random.default_rng(0).uniform(0, 200, (75, 12))
    assert temperature_degC(emf_mV(t)) == pytest.approx(t, abs=1e-9)


def millivolts(frame, cold_degC):
    """The frame with junction columns in millivolts."""
    emfs = {n: emf_mV(frame[n]) - emf_mV(cold_degC) for n in frame if is_junction_column(n)}
    return frame.assign(**emfs)


@pytest.mark.parametrize("kind", ["ehl", "immersion", "oven"])
def test_log_in_millivolts_is_read_like_the_log_in_degrees(tmp_path, kind):
    frame = {"ehl": ehl_frame, "immersion": immersion_frame, "oven": oven_frame}[kind]()
    rig = parse_rig({"logger": {"millivolts": True, "cold_junction_degC": 24.0}}, "rig.toml")
    in_degrees = read_log(write_log(frame, tmp_path / "C.csv"), kind)
    in_millivolts = read_log(write_log(millivolts(frame, 24.0), tmp_path / "mV.csv"), kind, rig)
    assert in_millivolts.frame.to_numpy() == pytest.approx(in_degrees.frame.to_numpy(), abs=1e-8)
    assert in_millivolts.warnings == ()


def test_impossible_millivolts_become_missing_and_degrees_instead_of_millivolts_raise(tmp_path):
    rig = parse_rig(
        tomllib.loads(rig_toml(parse_rig({"logger": {"millivolts": True}}, "rig.toml"))), "rig.toml"
    )
    frame = millivolts(ehl_frame(), 0.0)
    frame.loc[1000, "fast_e_degC"] = 500.0
    log = read_log(write_log(frame, tmp_path / "spike.csv"), "ehl", rig)
    assert [f.code for f in log.findings] == ["series.codes"]
    assert log.frame["fast_e_degC"].isna().sum() == 1
    with pytest.raises(InputError, match="no junction has"):
        read_log(write_log(ehl_frame(), tmp_path / "C.csv"), "ehl", rig)
