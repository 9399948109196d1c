"""Readings in another unit than the temperature that they are read as, and drop-outs."""

from __future__ import annotations

import numpy as np
import pytest

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.series.scaled_readings import RangeCheck
from tcdyn.series.thermocouple_types import emf_mV, to_degC

TIME = np.arange(300.0)
DEGC = 21 + 63 * -np.expm1(-np.maximum(TIME - 60, 0) / 12)
DEGC += np.random.default_rng(2).normal(0, 0.05, 300)


def range_check(values: Array, unit: str = "degC", column: str = "temp") -> RangeCheck:
    """The check of a complete column."""
    check = RangeCheck(column, unit)
    check.add(values, to_degC(unit, "K", 0.0)(values) if unit != "degC" else values)
    return check


@pytest.mark.parametrize(
    ("values", "unit", "scale"),
    [
        (1000 * DEGC, "degC", (1000, "degC")),
        (100 * DEGC, "degC", (100, "degC")),
        (10 * (DEGC + 273.15), "degC", (10, "K")),
        (100 * (DEGC + 273.15), "degC", (100, "K")),
        (100 * (DEGC + 273.15), "K", (100, "K")),
        (1000 * DEGC, "K", (1000, "degC")),
        (100 * (1.8 * DEGC + 32), "degF", (100, "degF")),
    ],
)
def test_scaled_integers_are_asked_for_their_unit(
    values: Array, unit: str, scale: tuple[int, str]
) -> None:
    check = range_check(np.rint(values), unit)
    assert check.is_other_unit
    assert check.likely_scales()[0] == scale


def test_microvolts_in_a_column_of_millivolts_are_another_unit() -> None:
    microvolts = np.rint(1000 * emf_mV(DEGC, "K"))
    check = range_check(microvolts, "mV")
    assert check.is_other_unit
    with pytest.raises(InputError):
        check.check("log.csv", None)


@pytest.mark.parametrize("code", [3276.7, 9999.0, 1e30, -9999.0, 6553.5])
@pytest.mark.parametrize("share", [0.01, 0.2, 0.8])
def test_drop_outs_have_few_values_however_many_there_are(code: float, share: float) -> None:
    is_code = np.random.default_rng(1).random(300) < share
    assert not range_check(np.where(is_code, code, DEGC)).is_other_unit


def test_random_readings_of_an_open_input_are_drop_outs() -> None:
    rng = np.random.default_rng(4)
    y = np.where(TIME > 150, rng.uniform(-2000, 8000, 300), DEGC)
    assert not range_check(y).is_other_unit


def test_a_code_among_scaled_integers_changes_nothing() -> None:
    values = np.rint(10 * (DEGC + 273.15))
    values[[70, 110, 200]] = 32767
    check = range_check(values)
    assert check.is_other_unit
    assert check.likely_scales()[0] == (10, "K")


@pytest.mark.parametrize("column", ["CO2_ppm", "p [Pa]", "U (V)", "heater /W"])
def test_other_quantities_with_their_unit_are_not_asked(column: str) -> None:
    assert not range_check(1000 * DEGC, column=column).is_other_unit


def test_parts_of_a_column_give_the_same_as_all_of_it() -> None:
    values = np.rint(100 * DEGC)
    parts = RangeCheck("temp")
    for start in range(0, 300, 37):
        part = values[start : start + 37]
        parts.add(part, part)
    assert parts.is_other_unit
    assert parts.likely_scales() == range_check(values).likely_scales()


def test_hot_furnaces_and_cold_baths_are_temperatures() -> None:
    for level in (-196.0, 0.0, 1700.0, 2300.0):
        assert not range_check(level + DEGC - 21).is_other_unit
