"""Units of table columns, from name, row of units or declaration; conversion of temperatures.

Temperatures are converted to degrees Celsius; any other quantity (ppm, %RH, Pa, V) stays as it is.

The readers of tables and ``tcdyn sensor`` use it; every command asks for units in the same way.
``tests/sensors/test_sensor_silent.py`` and ``test_sensor_file.py`` in that folder guard it.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, info, warning
from tcdyn.io.column_names import column_named, missing_column_error
from tcdyn.io.metadata import LOGGED
from tcdyn.io.unit_names import (
    TEMPERATURES,
    UNITS,
    is_same_name,
    names_temperature,
    unit_in,
    without_unit,
    written_unit,
)
from tcdyn.series.reading import Kind
from tcdyn.series.thermocouple_types import to_degC

# Median reading below which a column in kelvin gives a warning: no usual thermocouple is that cold;
# by judgement.
COLDEST_K = 100.0
NO_COUPLE = "none"  # "type" of millivolts that are not those of a thermocouple
# What a declared unit may be, in messages.
ANY_UNIT = "degC, K, degF, mV, or that of another quantity, such as ppm, %RH, Pa, V"


@dataclass(frozen=True)
class OutputNames:
    """Names of the columns of one sensor in the output.

    Attributes
    ----------
    logged
        The readings as logged.
    result, u
        The compensated readings, and their standard uncertainty.
    noise_u, record_u, common_u
        Components of that: what differs from row to row, what is one error of this column in the
        whole log, and what is one error of all columns together.
    rate, rate_u
        Rate of change of the result, and its standard uncertainty.
    """

    logged: str
    result: str
    u: str
    noise_u: str
    record_u: str
    common_u: str
    rate: str
    rate_u: str


@dataclass(frozen=True)
class Unit:
    """Unit of a column of any quantity, and the conversion of temperatures to degrees Celsius.

    Temperatures are computed in degrees Celsius, and their differences in kelvins; any other
    quantity in its own unit.

    Attributes
    ----------
    name
        degC, K, degF or mV; or that of any other quantity, such as ppm, %RH, Pa or V.
    thermocouple_type
        Type of the thermocouple, for mV; "none" for a voltage that is not that of a thermocouple.
    reference_junction
        For mV: temperature of the reference junction [degC], or the name of the column that holds
        it.
    is_assumed
        Whether nobody stated the unit.
    reference_unit
        Unit of that column: degC, K or degF.

    Examples
    --------
    >>> Unit("degF").to_base(np.array([212.0])), Unit("ppm").to_base(np.array([412.0]))
    (array([100.]), array([412.]))
    >>> Unit("mV", "K").to_base(np.array([4.096])).round(1)
    array([100.])
    >>> names = Unit("ppm").names("CO2_ppm")
    >>> names.logged, names.result, names.u
    ('CO2_logged_ppm', 'CO2_ppm', 'CO2_u_ppm')
    """

    name: str = "degC"
    thermocouple_type: str = ""
    reference_junction: float | str = 0.0
    is_assumed: bool = False
    reference_unit: str = "degC"

    def __post_init__(self) -> None:
        """Check that there is a unit, and that millivolts have a type.

        Raises
        ------
        InputError
            For an empty unit, or millivolts without a type.
        """
        if not self.name:
            raise InputError("no unit", expected=ANY_UNIT)
        if self.name == "mV" and not self.thermocouple_type:
            raise InputError(
                "millivolts of which thermocouple?",
                expected=f"its type: E, J, K, N or T; or {NO_COUPLE!r} for another voltage",
                remedy="say {couple}",
                parameters={"couple": "K"},
            )

    @property
    def is_temperature(self) -> bool:
        """Whether it is a temperature, or the voltage of a thermocouple."""
        is_thermocouple = self.name == "mV" and self.thermocouple_type != NO_COUPLE
        return self.name in TEMPERATURES or is_thermocouple

    @property
    def output(self) -> str:
        """Unit of the output: degC for the voltage of a thermocouple."""
        return "degC" if self.is_temperature and self.name == "mV" else self.name

    @property
    def base(self) -> str:
        """Unit in which it is computed: degC for all temperatures."""
        return "degC" if self.is_temperature else self.name

    @property
    def difference(self) -> str:
        """Unit of uncertainties in the output: K for degC."""
        if self.name == "degF":
            return "degF"
        return "K" if self.is_temperature else self.name

    @property
    def base_difference(self) -> str:
        """Unit of uncertainties in the base unit: K for all temperatures."""
        return "K" if self.is_temperature else self.name

    @property
    def per_base(self) -> float:
        """Units of the output per base unit."""
        return 1.8 if self.name == "degF" else 1.0

    def cold_degC(self, columns: Mapping[str, Array]) -> Array | float:
        """Temperature of the reference junction [degC].

        Parameters
        ----------
        columns
            Columns (N,) as they are in the table.

        >>> Unit("mV", "K", "CJ", reference_unit="degF").cold_degC({"CJ": np.array([41.0])})
        array([5.])
        """
        if not isinstance(self.reference_junction, str):
            return self.reference_junction
        column = columns[self.reference_junction]
        return convert_temperature(self.reference_unit, "degC", column)

    def to_base(self, values: Array, cold_degC: Array | float = 0.0) -> Array:
        """Return temperatures in degrees Celsius, and values of other quantities unchanged.

        Parameters
        ----------
        values
            Values (N,) in this unit.
        cold_degC
            For mV: temperature of the reference junction, a number or (N,) [degC].

        Returns
        -------
        array
            Values (N,); infinite where the thermocouple has no such emf.
        """
        if self.name == "degC" or not self.is_temperature:
            return values
        return to_degC(self.name, self.thermocouple_type, cold_degC)(values)

    def from_base(self, base: Array) -> Array:
        """Return values in the unit of the output, which is degrees Celsius for thermocouples.

        Parameters
        ----------
        base
            Values (N,): temperatures in degC, others in their unit.

        Returns
        -------
        array
            Values (N,).
        """
        if self.name == "K":
            return base + 273.15
        if self.name == "degF":
            return 1.8 * base + 32
        return base

    def names(self, column: str) -> OutputNames:
        """Return the names of all columns that the output has for a column.

        The logged column gets another name, because its own is that of the result. Of the voltage
        of a thermocouple, the result is a temperature.

        Parameters
        ----------
        column
            Name of the column in the log.

        Examples
        --------
        >>> vars(Unit("mV", "K").names("T1_mV"))  # doctest: +NORMALIZE_WHITESPACE
        {'logged': 'T1_logged_mV', 'result': 'T1_degC', 'u': 'T1_u_K', 'noise_u': 'T1_noise_u_K',
         'record_u': 'T1_record_u_K', 'common_u': 'T1_common_u_K', 'rate': 'T1_rate_K_s',
         'rate_u': 'T1_rate_u_K_s'}
        >>> names = Unit().names("T1 [°C]")
        >>> names.logged, names.result, names.rate
        ('T1_logged [°C]', 'T1 [°C]', 'T1_rate_K_s')
        """
        stem = without_unit(column)
        is_thermocouple = self.name == "mV" and self.is_temperature
        return OutputNames(
            logged=f"{stem}{LOGGED}{column.removeprefix(stem)}",
            result=f"{stem}_degC" if is_thermocouple else column,
            u=f"{stem}_u_{self.difference}",
            noise_u=f"{stem}_noise_u_{self.difference}",
            record_u=f"{stem}_record_u_{self.difference}",
            common_u=f"{stem}_common_u_{self.difference}",
            rate=f"{stem}_rate_{self.difference}_s",
            rate_u=f"{stem}_rate_u_{self.difference}_s",
        )


def units_of(
    columns: Sequence[str],
    declared: Mapping[str, str] | str = "",
    couple: str = "",
    cold: float | str = 0.0,
    unit_row: Mapping[str, str] | None = None,
    *,
    needs_millivolts: bool = True,
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
    needs_millivolts
        Whether a couple or a reference junction without a column in mV is an error; of several
        files only some may be in mV.

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
    reference_unit = "degC"
    if isinstance(cold, str):
        reference_unit = _reference_unit(cold, declared, unit_row or {})
    for name in columns:
        requested = declared if isinstance(declared, str) else _declared_for(name, declared)
        below_header = (unit_row or {}).get(name, "")
        in_file = unit_in(name) or written_unit(below_header)
        unit = _declared_unit(requested) or in_file
        if below_header and not unit:
            raise InputError(
                f"column {name!r}: its unit {below_header!r} in the row below the header is "
                "not known",
                expected=ANY_UNIT,
                remedy="name the unit, {unit}",
                parameters={"unit": "UNIT"},
            )
        if in_file and in_file != unit:
            findings.append(warning("sensor.unit_contradicted", subject=name, unit=unit))
        elif unit and unit not in UNITS and not written_unit(unit):
            findings.append(info("sensor.unit_unknown", subject=name, unit=unit))
        is_assumed = not unit
        if is_assumed:
            assumed.append(name)
            unit = "degC"
        of_couple = couple if unit == "mV" else ""
        units[name] = Unit(unit, of_couple, cold, is_assumed, reference_unit)
    if needs_millivolts and (couple or cold):
        check_millivolts(units.values())
    if assumed:
        subject = ", ".join(assumed)
        findings.append(info("sensor.unit_assumed", subject=subject, count=len(assumed)))
    return units, findings


def _declared_for(name: str, declared: Mapping[str, str]) -> str:
    """The unit that is declared for a column, by its name with or without unit; empty: none."""
    return declared.get(name, declared.get(without_unit(name), ""))


def _reference_unit(
    column: str, declared: Mapping[str, str] | str, unit_row: Mapping[str, str]
) -> str:
    """Unit of the column of the reference junction; degC if nobody states one.

    Raises
    ------
    InputError
        For a unit that is none of a temperature.
    """
    requested = "" if isinstance(declared, str) else _declared_for(column, declared)
    stated = _declared_unit(requested) or unit_in(column) or written_unit(unit_row.get(column, ""))
    if stated and stated not in TEMPERATURES:
        raise InputError(
            f"{{cold_junction}} {column!r} is in {stated}",
            expected="a column of temperatures: degC, K or degF",
            parameters={"cold_junction": None},
        )
    return stated or "degC"


def check_declared(declared: Mapping[str, str] | str, names: Collection[str], where: str) -> None:
    """Check that each column whose unit is declared is in the table.

    Parameters
    ----------
    declared
        Unit of all columns, or by column.
    names
        Columns of the table.
    where
        The table, for messages.

    Raises
    ------
    InputError
        For a column that the table does not have, with the most similar name.
    """
    if isinstance(declared, str):
        return
    known = {*names, *map(without_unit, names)}
    for name in declared:
        if name not in known:
            raise missing_column_error("column of a unit", name, names, where)


def convert_temperature(unit: str, target: str, values: Array) -> Array:
    """Temperatures (N,) in another unit: degC, K or degF.

    >>> convert_temperature("degF", "K", np.array([32.0]))
    array([273.15])
    """
    return Unit(target).from_base(Unit(unit).to_base(values))


def check_millivolts(units: Iterable[Unit]) -> None:
    """Raise InputError where a thermocouple or a reference junction is given without need."""
    if any(unit.name == "mV" for unit in units):
        return
    raise InputError(
        "a thermocouple type or a reference junction is given, but no column is in mV",
        expected="{unit}",
        remedy="or leave {couple} and {cold_junction} out",
        parameters={"unit": "mV", "couple": None, "cold_junction": None},
    )


def kind_of(column: str, unit: Unit) -> Kind:
    """Return what a column of readings holds, by its unit and name.

    A column whose unit is only assumed is a temperature if its name says so: limits of a
    thermocouple would judge other readings wrongly.

    >>> kind_of("T1", Unit()), kind_of("level", Unit(is_assumed=True))
    (<Kind.TEMPERATURE: 'temperature'>, <Kind.QUANTITY: 'quantity'>)
    """
    if not unit.is_temperature or (unit.is_assumed and not names_temperature(column)):
        return Kind.QUANTITY
    return Kind.TEMPERATURE


def _declared_unit(text: str) -> str:
    """Return a declared unit by its usual name; any text is a unit in square brackets.

    >>> _declared_unit("F"), _declared_unit("Volt"), _declared_unit("[a.u.]"), _declared_unit("")
    ('degF', 'V', 'a.u.', '')

    Raises
    ------
    InputError
        For a text that is no known unit.
    """
    if text.startswith("[") and text.endswith("]"):
        text = text[1:-1].strip()
        return written_unit(text) or text
    if text and not written_unit(text):
        raise InputError(f"unit {text!r}", expected=f"{ANY_UNIT}; any other in brackets, [{text}]")
    return written_unit(text)


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
    return _fits_pattern(pattern, name) or is_same_name(name, pattern)


def _fits_pattern(pattern: str, name: str) -> bool:
    """Whether a pattern of ``*`` and ``?`` fits a column's name, with or without its unit."""
    return fnmatchcase(name, pattern) or fnmatchcase(without_unit(name), pattern)


def match_columns(pattern: str, names: Collection[str], where: str) -> list[str]:
    """Return the columns that match a sensor's column by name.

    Parameters
    ----------
    pattern
        Name with or without unit; ``*`` is any text, ``?`` any letter.
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
        Where no column matches, and where several have a name without unit.

    Examples
    --------
    >>> match_columns("T?", ["T1_degC", "T2_degC", "gas"], "log.csv")
    ['T1_degC', 'T2_degC']
    """
    if isinstance(pattern, str) and pattern not in names and any(c in pattern for c in "*?["):
        matches = [name for name in names if _fits_pattern(pattern, name)]
        if matches:
            return list(dict.fromkeys(matches))
    return [column_named(pattern, names, where)]


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
    """Return the name of the column with the standard uncertainty of a column.

    >>> names = ("fast_a_degC", "T1 [K]", "gas_degF", "T2", "CO2_ppm")
    >>> tuple(uncertainty_column(name) for name in names)
    ('fast_a_u_K', 'T1_u_K', 'gas_u_degF', 'T2_u_K', 'CO2_u_ppm')

    Parameters
    ----------
    column
        Column of the values.
    unit
        Unit of the column; empty to take that in its name.

    Returns
    -------
    str
        The name; the unit is K for degC and for millivolts, which are those of a thermocouple.
    """
    name = unit or unit_in(column) or "degC"
    return Unit(name, "K" if name == "mV" else "").names(column).u
