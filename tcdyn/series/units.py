"""Units of table columns: from name, row of units or declaration; conversion to degrees Celsius.

The readers of tables and ``tcdyn sensor`` use it; every command asks for units in the same way.
``tests/sensors/test_sensor_silent.py`` and ``test_sensor_file.py`` in that folder guard it.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, info, warning
from tcdyn.io.table import missing_column_error
from tcdyn.io.unit_names import UNITS, unit_in, without_unit, written_unit
from tcdyn.series.reading import Kind
from tcdyn.series.scaled_readings import names_temperature
from tcdyn.series.thermocouple_types import to_degC

# Median reading below which a column in kelvin gives a warning: no usual thermocouple is that cold;
# by judgement.
COLDEST_K = 100.0


@dataclass(frozen=True)
class Unit:
    """Unit of a column, and its conversion to degrees Celsius.

    Attributes
    ----------
    name
        degC, K, degF or mV.
    thermocouple_type
        Type of the thermocouple, for mV.
    reference_junction
        For mV: temperature of the reference junction [degC], or the name of the column that holds
        it.
    is_assumed
        Whether nobody stated the unit.

    Examples
    --------
    >>> Unit("degF").in_degC(np.array([212.0]))
    array([100.])
    >>> Unit("mV", "K").in_degC(np.array([4.096])).round(1)
    array([100.])
    """

    name: str = "degC"
    thermocouple_type: str = ""
    reference_junction: float | str = 0.0
    is_assumed: bool = False

    def __post_init__(self) -> None:
        """Check the unit, and that millivolts have a type.

        Raises
        ------
        InputError
            For an unknown unit, or millivolts without a type.
        """
        if self.name not in UNITS:
            raise InputError(f"unit {self.name!r}", expected=" or ".join(UNITS))
        if self.name == "mV" and not self.thermocouple_type:
            raise InputError(
                "millivolts of which thermocouple?",
                expected="its type: E, J, K, N or T",
                remedy="say {couple}",
                parameters={"couple": "K"},
            )

    @property
    def per_K(self) -> float:
        """Units of the output per kelvin."""
        return 1.8 if self.name == "degF" else 1.0

    def in_degC(self, values: Array, cold_degC: Array | float = 0.0) -> Array:
        """Return values in degrees Celsius.

        Parameters
        ----------
        values
            Values (N,) in this unit.
        cold_degC
            For mV: temperature of the reference junction, a number or (N,) [degC].

        Returns
        -------
        array
            Temperatures (N,) [degC]; infinite where the thermocouple has no such emf.
        """
        if self.name == "degC":
            return values
        return to_degC(self.name, self.thermocouple_type, cold_degC)(values)

    def from_degC(self, degC: Array) -> Array:
        """Return temperatures in the unit of the output, which is degrees Celsius for mV.

        Parameters
        ----------
        degC
            Temperatures (N,) [degC].

        Returns
        -------
        array
            Values (N,).
        """
        if self.name == "K":
            return degC + 273.15
        if self.name == "degF":
            return 1.8 * degC + 32
        return degC

    def names(self, column: str) -> tuple[str, str]:
        """Return the names of the result and of its standard uncertainty in the output."""
        result = f"{without_unit(column)}_degC" if self.name == "mV" else column
        return result, uncertainty_column(column, self.name)


def units_of(
    columns: Sequence[str],
    declared: Mapping[str, str] | str = "",
    couple: str = "",
    cold: float | str = 0.0,
    unit_row: Mapping[str, str] | None = None,
) -> tuple[dict[str, Unit], list[Finding]]:
    """Return the unit of each column.

    The declared unit has precedence, then the one in the column's name, then that in the row of
    units below the header, else degrees Celsius, with an info.

    Parameters
    ----------
    columns
        Names of the columns.
    declared
        Unit of all columns, or by column (its name with or without unit).
    couple, cold
        For mV: type of the thermocouple, and reference junction.
    unit_row
        Row of units below the header, by column.

    Returns
    -------
    units, findings
        Unit by column; a warning where the declaration contradicts the file.

    Raises
    ------
    InputError
        For a unit in the row below the header that is not known, and for a type of thermocouple or
        a reference junction without a column in mV.

    Examples
    --------
    >>> units_of(["Zone 1"], "F")[0]["Zone 1"].name
    'degF'
    >>> [f.code for f in units_of(["T1_degF"], "degC")[1]]
    ['sensor.unit_contradicted']
    """
    units = {}
    assumed = []
    findings = list[Finding]()
    for name in columns:
        if isinstance(declared, str):
            requested = declared
        else:
            requested = declared.get(name, declared.get(without_unit(name), ""))
        below_header = (unit_row or {}).get(name, "")
        in_file = unit_in(name) or written_unit(below_header)
        unit = written_unit(requested) or requested or in_file
        if below_header and not unit:
            raise InputError(
                f"column {name!r}: its unit {below_header!r} in the row below the header is "
                "not known",
                expected=" or ".join(UNITS),
                remedy="name the unit, {unit}",
                parameters={"unit": "UNIT"},
            )
        if in_file and in_file != unit:
            findings.append(warning("sensor.unit_contradicted", subject=name, unit=unit))
        is_assumed = not unit
        if is_assumed:
            assumed.append(name)
            unit = "degC"
        units[name] = Unit(unit, couple if unit == "mV" else "", cold, is_assumed)
    if (couple or cold) and not any(unit.name == "mV" for unit in units.values()):
        raise InputError(
            "a thermocouple type or a reference junction is given, but no column is in mV",
            expected="{unit}",
            remedy="or leave {couple} and {cold_junction} out",
            parameters={"unit": "mV", "couple": None, "cold_junction": None},
        )
    if assumed:
        subject = ", ".join(assumed)
        findings.append(info("sensor.unit_assumed", subject=subject, count=len(assumed)))
    return units, findings


def kind_of(column: str, unit: Unit) -> Kind:
    """Return what a column of readings holds, by its unit and name.

    A column whose unit is only assumed is a temperature if its name says so: limits of a
    thermocouple would judge other readings wrongly.

    >>> kind_of("T1", Unit()), kind_of("level", Unit(is_assumed=True))
    (<Kind.TEMPERATURE: 'temperature'>, <Kind.QUANTITY: 'quantity'>)
    """
    if unit.is_assumed and not names_temperature(column):
        return Kind.QUANTITY
    return Kind.TEMPERATURE


def unit_findings(column: str, unit: Unit, values: Array) -> list[Finding]:
    """Return a warning where a unit is implausible: kelvin below ``COLDEST_K``.

    Parameters
    ----------
    column
        Name of the column.
    unit
        Its unit.
    values
        Values (N,) in that unit.

    Returns
    -------
    list of Finding
        Empty, or one warning.
    """
    middle = float(np.nanmedian(values)) if np.isfinite(values).any() else np.nan
    if unit.name == "K" and middle < COLDEST_K:
        return [warning("sensor.unit_doubt", subject=column, unit="K", value=middle)]
    return []


def is_match(pattern: str, name: str) -> bool:
    """Whether a sensor's column means a column of a table, with or without its unit.

    >>> is_match("TC*", "TC1 (°C)"), is_match("TC1", "TC1_degC"), is_match("TC1", "TC10")
    (True, True, False)
    """
    plain = without_unit(name)
    is_pattern = fnmatchcase(name, pattern) or fnmatchcase(plain, pattern)
    return is_pattern or plain == without_unit(pattern)


def match_columns(pattern: str, names: Collection[str], where: str) -> list[str]:
    """Return the columns that match a sensor's column by name.

    Parameters
    ----------
    pattern
        Name with or without unit; ``*`` is any text.
    names
        Columns of the table.
    where
        Table that the error names.

    Returns
    -------
    list of str
        The columns; one with exactly that name excludes all others.

    Raises
    ------
    InputError
        Where no column matches.
    """
    if pattern in names:
        return [pattern]
    matches = [name for name in names if is_match(pattern, name)]
    if not matches:
        raise missing_column_error("column", pattern, names, where)
    return list(dict.fromkeys(matches))


def cold_column(cold: float | str, names: Collection[str], where: str) -> float | str:
    """Return the temperature of the reference junction, or the column that holds it.

    >>> cold_column("CJ", ["T1_mV", "CJ_degC"], "log.csv"), cold_column(0.0, [], "log.csv")
    ('CJ_degC', 0.0)

    Parameters
    ----------
    cold
        Temperature [degC], or the name of a column.
    names
        Columns of the table.
    where
        Table that the error names.

    Returns
    -------
    float or str
        Temperature [degC], or the one column that matches the name.

    Raises
    ------
    InputError
        Where no column or several match.
    """
    if not isinstance(cold, str):
        return cold
    matches = match_columns(cold, names, where)
    if len(matches) > 1:
        raise InputError(
            f"{cold!r} means {' and '.join(map(repr, matches))}", where=where, expected="one column"
        )
    return matches[0]


def uncertainty_column(column: str, unit: str = "") -> str:
    """Return the name of the column with the standard uncertainty of a temperature.

    >>> names = ("fast_a_degC", "T1 [K]", "gas_degF", "T2")
    >>> tuple(uncertainty_column(name) for name in names)
    ('fast_a_u_K', 'T1_u_K', 'gas_u_degF', 'T2_u_K')

    Parameters
    ----------
    column
        Column of the temperature.
    unit
        Unit of the column; empty to take that in its name.

    Returns
    -------
    str
        The name; the unit is K, or degF for a column in degF.
    """
    suffix = "degF" if (unit or unit_in(column)) == "degF" else "K"
    return f"{without_unit(column)}_u_{suffix}"
