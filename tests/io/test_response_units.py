"""Units of the columns of a frequency response, as instruments and programs write them."""

from __future__ import annotations

import numpy as np
import pytest

from tcdyn.io.response_units import (
    is_angular,
    is_logarithm,
    is_real_and_imaginary,
    unit_of_column,
)

RADIAN_HZ = 1 / (2 * np.pi)


@pytest.mark.parametrize(
    ("name", "hz"),
    [
        ("Frequency (Hz)", 1.0),
        ("f/Hz", 1.0),
        ("freqHz", 1.0),
        ("f_mHz", 1e-3),
        ("f [µHz]", 1e-6),
        ("freq_kHz", 1e3),
        ("KHZ", 1e3),
        ("f (MHz)", 1e6),
        ("w_rad_s", RADIAN_HZ),
        ("w_rads", RADIAN_HZ),
        ("Frequency (rad/sec)", RADIAN_HZ),
        ("omega, rad/s", RADIAN_HZ),
        ("omega in rad/s", RADIAN_HZ),
        ("omega/(rad/s)", RADIAN_HZ),
        ("angular frequency [rad s⁻¹]", RADIAN_HZ),
        ("w (rad s^-1)", RADIAN_HZ),
        ("omega_rad_per_s", RADIAN_HZ),
        ("w_mrad_s", 1e-3 * RADIAN_HZ),
        ("w [rad/min]", RADIAN_HZ / 60),
        ("speed (rpm)", 1 / 60),
        ("f (cycles/day)", 1 / 86400),
    ],
)
def test_a_unit_of_a_frequency_is_read_from_the_name(name: str, hz: float) -> None:
    unit = unit_of_column(name)
    assert unit is not None
    assert unit.kind == "frequency"
    assert unit.factor == pytest.approx(hz, rel=1e-12)


@pytest.mark.parametrize(
    ("name", "degrees"),
    [
        ("Phase (deg)", 1.0),
        ("phase_°", 1.0),
        ("Phase[degrees] CH1", 1.0),
        ("Phase, deg (CH2)", 1.0),
        ("PhaseRad", 180 / np.pi),
        ("phase_rads", 180 / np.pi),
        ("phi [mrad]", 0.18 / np.pi),
        ("Phase (turns)", 360.0),
    ],
)
def test_a_unit_of_an_angle_is_read_from_the_name(name: str, degrees: float) -> None:
    unit = unit_of_column(name, "angle")
    assert unit is not None
    assert unit.kind == "angle"
    assert unit.factor == pytest.approx(degrees, rel=1e-12)


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("Magnitude (dB)", "level"),
        ("MAG_DB", "level"),
        ("gaindB", "level"),
        ("|H| [dB]", "level"),
        ("dB(V/V)", "level"),
        ("Amplitude ratio [%]", "percent"),
        ("f_mhz", "unclear"),
        ("level_dBm", "unclear"),
        ("omega [1/s]", "rate"),
        ("gain [K/%]", ""),
        ("gain [K/W]", ""),
        ("H1/H2", ""),
        ("mag", ""),
        ("frequency", ""),
        ("phase", ""),
        ("gradient", ""),
        ("radius", ""),
    ],
)
def test_levels_shares_and_units_of_two_meanings_are_distinguished(name: str, kind: str) -> None:
    unit = unit_of_column(name, "level")
    assert (unit.kind if unit is not None else "") == kind


def test_names_tell_angular_frequencies_logarithms_and_parts_of_a_complex_number() -> None:
    assert all(map(is_angular, ("omega", "w", "ω [rad/s]", "Angular Frequency")))
    assert not any(map(is_angular, ("f", "window", "frequency_Hz")))
    assert is_logarithm("log10(f)")
    assert not is_logarithm("logger_gain")
    assert is_real_and_imaginary("Re{G}", "Im{G}")
    assert is_real_and_imaginary("H_real", "H_imag")
    assert not is_real_and_imaginary("mag", "imag")
