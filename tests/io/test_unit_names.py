"""Units of any quantity in the names of columns and in cells."""

from __future__ import annotations

import pytest

from tcdyn.io.cells import is_unit, number_and_unit
from tcdyn.io.unit_names import unit_in, without_unit, written_unit


@pytest.mark.parametrize(
    ("name", "stem", "unit"),
    [
        # temperatures, as they were
        ("T1 [K]", "T1", "K"),
        ("kiln_3_degC", "kiln_3", "degC"),
        ("T1 (°F)", "T1", "degF"),
        ("T1/°C", "T1", "degC"),
        ("T in °C", "T", "degC"),
        ("T1°C", "T1", "degC"),
        ("T [degrees_C]", "T", "degC"),
        ("U_mV", "U", "mV"),
        ("1. Temperature [oC]", "1. Temperature", "degC"),
        ("#1:oC", "#1", "degC"),
        ("Air oF", "Air", "degF"),
        ("Temp. Deg C", "Temp.", "degC"),
        ("raw_temp_c", "raw_temp", "degC"),
        # other quantities
        ("DryCal smL/min", "DryCal", "smL/min"),
        ("#HK-Bat:V", "#HK-Bat", "V"),
        ("Pressure mBar", "Pressure", "mbar"),
        ("CO2_ppm", "CO2", "ppm"),
        ("CO2 [ppm]", "CO2", "ppm"),
        ("CO2 (ppm)", "CO2", "ppm"),
        ("CO2, ppm", "CO2", "ppm"),
        ("room_%RH", "room", "%RH"),
        ("Luftfeuchte [% r.F.]", "Luftfeuchte", "%RH"),
        ("relative Feuchte (%)", "relative Feuchte", "%"),
        ("humidity_percent", "humidity", "%"),
        ("line_Pa", "line", "Pa"),
        ("Druck in hPa", "Druck", "hPa"),
        ("p/bar", "p", "bar"),
        ("p_kPa", "p", "kPa"),
        ("Spannung [V]", "Spannung", "V"),
        ("U/V", "U", "V"),
        ("probe_uV", "probe", "uV"),
        ("v_m_s", "v", "m_s"),
        ("Durchfluss [l/min]", "Durchfluss", "l/min"),
        ("dust [µg/m³]", "dust", "µg/m³"),
        ("q (W/m2K)", "q", "W/m2K"),
        ("dose [a.u.]", "dose", "a.u."),
        ("I_A", "I", "A"),
        ("slow_load_N", "slow_load", "N"),
        ("heater_W", "heater", "W"),
        ("level [Füllstand]", "level", "Füllstand"),
    ],
)
def test_a_unit_is_read_from_the_name_and_left_out_of_it(name: str, stem: str, unit: str) -> None:
    assert (without_unit(name), unit_in(name)) == (stem, unit)


@pytest.mark.parametrize(
    "name",
    [
        *("T1", "gas", "zone_A", "T_N", "kiln_W", "T_min", "T_in", "T_max", "fast_a", "T_s"),
        *("T1 (left)", "T1 (J)", "TC 3 (N)", "Run 1/A", "group/T1", "Dev1/ai0", "T[1]", "T1 (2)"),
        *("temp_f", "FotoC", "Dev1:ai0", "Time, GMT+02:00", "T_C_left"),
    ],
)
def test_labels_and_remarks_are_no_units(name: str) -> None:
    assert (without_unit(name), unit_in(name)) == (name, "")


@pytest.mark.parametrize(
    ("cell", "unit"),
    [
        *(("ppm", "ppm"), ("%RH", "%RH"), ("% rF", "%RH"), ("Pa", "Pa"), ("Volts", "V")),
        *(("mg/m3", "mg/m3"), ("Deg C", "degC"), ("l/min", "l/min"), ("OK", ""), ("Rankine", "")),
    ],
)
def test_a_cell_of_a_row_of_units_is_a_unit(cell: str, unit: str) -> None:
    assert written_unit(cell) == unit


def test_cells_hold_numbers_with_units_of_any_quantity() -> None:
    assert number_and_unit("412.5 ppm", ".") == ("412.5", "ppm")
    assert number_and_unit("101325 Pa", ".") == ("101325", "Pa")
    assert number_and_unit("7 OK", ".") == ("", "")
    cells = ("ppm", "V", "A", "B", "T1")
    assert [is_unit(cell) for cell in cells] == [True, True, False, False, False]
