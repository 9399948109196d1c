"""Tables of frequency responses in the units of people: the same model, or a request for the unit.

The response is 2.5 exp(-0.4 s)/((3 s + 1)(0.5 s + 1)), lag 3.9 s, with errors of 1 %.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tcdyn.core.errors import InputError
from tcdyn.identification import Response, fit_response

F = np.geomspace(1e-3, 2.0, 40)
W = 2 * np.pi * F


def plant() -> np.ndarray:
    """The response with errors of 1 % of each part."""
    s = 1j * W
    rng = np.random.default_rng(52)
    error = rng.normal(size=len(F)) + 1j * rng.normal(size=len(F))
    return 2.5 * np.exp(-0.4 * s) / ((3 * s + 1) * (0.5 * s + 1)) * (1 + 0.01 * error)


H = plant()
DECIBEL = 20 * np.log10(np.abs(H))
DEGREES = np.degrees(np.angle(H))
Columns = dict[str, np.ndarray]


def write(folder: Path, columns: Columns, unit_row: str = "") -> Path:
    """Write a table; its first column is the frequency."""
    path = folder / "bode.csv"
    text = pd.DataFrame(columns).to_csv(index=False, float_format="%.8g")
    header, rows = text.split("\n", 1)
    below = f"{unit_row}\n" if unit_row else ""
    path.write_text(f"{header}\n{below}{rows}", encoding="utf-8")
    return path


def read(folder: Path, columns: Columns, unit_row: str = "", **options: Any) -> Response:
    """Write and read a table."""
    frequency, first, second, *_ = columns
    path = write(folder, columns, unit_row)
    return Response.read(path, frequency, (first, second), **options)


TABLES: dict[str, tuple[Columns, str, dict[str, str]]] = {
    "names with underscores": ({"w_rad_s": W, "mag": abs(H), "phase_rad": np.angle(H)}, "", {}),
    "brackets": ({"f [mHz]": 1e3 * F, "Magnitude (dB)": DECIBEL, "Phase [deg]": DEGREES}, "", {}),
    "kilohertz": ({"f/kHz": F / 1e3, "Gain": abs(H), "Phase/°": DEGREES}, "", {}),
    "omega in 1/s": ({"omega [1/s]": W, "dB": DECIBEL, "phi_mrad": 1e3 * np.angle(H)}, "", {}),
    "omega without unit": ({"omega": W, "mag_db": DECIBEL, "phase_deg": DEGREES}, "", {}),
    "real and imaginary": ({"f": F, "Re(G)": H.real, "Im(G)": H.imag}, "", {}),
    "percent": ({"f_Hz": F, "ratio [%]": 100 * abs(H), "phase (rad)": np.angle(H)}, "", {}),
    "row of units": (
        {"Frequency": W, "Magnitude": DECIBEL, "Phase": np.angle(H)},
        "rad/s,dB,rad",
        {},
    ),
    "row in brackets": ({"Frequency": 1e3 * F, "M": DECIBEL, "P": DEGREES}, "(mHz),(dB),(deg)", {}),
    "arguments": (
        {"x": 1e3 * F, "a": DECIBEL, "b": np.angle(H)},
        "",
        {"frequency_unit": "mHz", "form": "dB", "phase_unit": "rad"},
    ),
    "arguments that agree": (
        {"w [rad/s]": W, "a [dB]": DECIBEL, "b_rad": np.angle(H)},
        "",
        {"frequency_unit": "rad/s", "form": "dB", "phase_unit": "rad"},
    ),
    "unit of two meanings with an argument": (
        {"f_mhz": 1e3 * F, "gain [K/W]": abs(H), "b_deg": DEGREES},
        "",
        {"frequency_unit": "mHz"},
    ),
}


@pytest.mark.parametrize("name", TABLES)
def test_the_same_response_is_read_in_any_unit(tmp_path: Path, name: str) -> None:
    columns, unit_row, options = TABLES[name]
    response = read(tmp_path, columns, unit_row, **options)
    assert response.frequency_Hz == pytest.approx(F, rel=1e-6)
    assert np.max(np.abs(response.response / H - 1)) < 1e-6  # eight digits in the file
    lag = fit_response(response, "P2D").lag_s
    assert lag.contains(3.9)
    assert lag.u < 0.05


@pytest.mark.parametrize(
    ("columns", "options", "named"),
    [
        ({"f [mHz]": F, "m": abs(H), "p_deg": DEGREES}, {"frequency_unit": "Hz"}, ("mHz", "=Hz")),
        ({"w_rad_s": W, "m": abs(H), "p_deg": DEGREES}, {"frequency_unit": "Hz"}, ("rad_s", "=Hz")),
        ({"f": F, "M (dB)": 30 + DECIBEL, "p_deg": DEGREES}, {"form": "magnitude"}, ("dB", "=mag")),
        ({"f": F, "M [K/W]": abs(H), "p_deg": DEGREES}, {"form": "dB"}, ("magnitude", "=dB")),
        ({"f": F, "M (dB)": DECIBEL, "p_deg": DEGREES}, {"form": "complex"}, ("dB", "=complex")),
        ({"f": F, "M": abs(H), "p_deg": DEGREES}, {"form": "complex"}, ("magnitude", "=complex")),
        ({"f": F, "re": H.real, "im": H.imag}, {"form": "dB"}, ("complex", "=dB")),
        ({"f": F, "M": abs(H), "p_rad": np.angle(H)}, {"phase_unit": "deg"}, ("rad", "=deg")),
    ],
)
def test_a_unit_of_the_header_that_contradicts_an_argument_is_refused_with_both(
    tmp_path: Path, columns: Columns, options: dict[str, str], named: tuple[str, str]
) -> None:
    with pytest.raises(InputError) as refusal:
        read(tmp_path, columns, **options)
    assert all(text in str(refusal.value) for text in named)


@pytest.mark.parametrize(
    ("columns", "asked"),
    [
        ({"f_mhz": F, "m": abs(H), "p_deg": DEGREES}, "frequency_unit"),
        ({"f [1/s]": F, "m": abs(H), "p_deg": DEGREES}, "frequency_unit"),
        ({"omega [Hz]": F, "m": abs(H), "p_deg": DEGREES}, "frequency_unit"),
        ({"f [ticks]": F, "m": abs(H), "p_deg": DEGREES}, "frequency_unit"),
        ({"period_s": 1 / F, "m": abs(H), "p_deg": DEGREES}, "frequency_unit"),
        ({"f": F, "m": abs(H), "phase": np.angle(H)}, "phase_unit"),
        ({"f": F, "m": abs(H), "phase [bits]": DEGREES}, "phase_unit"),
        ({"f": F, "log|G|": abs(H), "p_deg": DEGREES}, "form"),
        ({"f": F, "p_deg": DEGREES, "m": abs(H)}, "magnitude first"),
        ({"f": F, "m_Hz": abs(H), "p_deg": DEGREES}, "magnitude first"),
        ({"p_deg": F, "m": abs(H), "p_rad": DEGREES}, "column of the frequency"),
        ({"log10(f)": np.log10(F) + 4, "m": abs(H), "p_deg": DEGREES}, "the frequency itself"),
        ({"f": F, "m [dBm]": abs(H), "p_deg": DEGREES}, "magnitude first"),
    ],
)
def test_a_unit_that_cannot_be_told_is_asked_for(
    tmp_path: Path, columns: Columns, asked: str
) -> None:
    with pytest.raises(InputError, match=asked):
        read(tmp_path, columns)


def test_units_that_are_assumed_are_named_and_kept_in_the_result(tmp_path: Path) -> None:
    response = read(tmp_path, {"f": F, "m": abs(H), "phase": DEGREES})
    assert [f.code for f in response.findings] == ["response.unit_assumed"]
    assert all(name in response.findings[0].subject for name in ("f in", "m in", "phase in"))
    assert response.findings[0] in fit_response(response, "P2D").findings
    stated = read(tmp_path, {"f_Hz": F, "m (dB)": DECIBEL, "phase_deg": DEGREES})
    assert not stated.findings


def test_uncertainty_and_coherence_have_the_unit_of_the_magnitude(tmp_path: Path) -> None:
    columns = {"f_Hz": F, "m [%]": 100 * abs(H), "phase_deg": DEGREES, "u": 0.0 * F + 2.0}
    assert read(tmp_path, columns, u="u").u == pytest.approx(0.02)
    with_level = {"f_Hz": F, "m": abs(H), "phase_deg": DEGREES, "u_dB": 0.0 * F + 0.1}
    with pytest.raises(InputError, match="u_dB"):
        read(tmp_path, with_level, u="u_dB")
    coherent = {"f_Hz": F, "m": abs(H), "phase_deg": DEGREES, "coh [%]": 0.0 * F + 90.0}
    response = read(tmp_path, coherent, coherence="coh [%]", averages=10)
    # sqrt((1 - 0.9)/(2 10 0.9)), Bendat and Piersol (2010), 9.2
    assert response.relative_u == pytest.approx(np.sqrt(0.1 / 18))


def test_a_table_without_a_complete_row_is_an_input_error(tmp_path: Path) -> None:
    path = tmp_path / "bode.csv"
    path.write_text("f_Hz,m,phase_deg\n1,,3\n2,1,\n")
    with pytest.raises(InputError, match="no row"):
        Response.read(path, "f_Hz", ("m", "phase_deg"))
