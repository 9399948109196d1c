"""Units of temperature in the names of columns and in cells: ``T1 [K]``, ``gas_degC``, ``Deg. F``.

``tcdyn.series.units`` decides with them in which unit a column is; ``Compensated.to_frame`` names
its columns with them. Guarded by ``tests/sensors/test_sensor_silent.py`` and
``tests/smoothing/test_smoother.py``.
"""

from __future__ import annotations

import re
from collections.abc import Collection

from tcdyn.io.cells import plain_unit

UNITS = ("degC", "K", "degF", "mV")  # Units of a temperature that are known.
# By the spelling in lower case, without degree signs.
_UNIT_NAMES = {
    "c": "degC",
    "celsius": "degC",
    "k": "K",
    "kelvin": "K",
    "f": "degF",
    "fahrenheit": "degF",
    "mv": "mV",
    "millivolt": "mV",
    "millivolts": "mV",
}
# A unit at the end of a column's name: ``_degC``, ``[K]``, ``(°F)``, ``/°C`` or ``in °C``.
_SUFFIX = re.compile(
    r"(?:_(degC|K|degF|mV)|\s*[\[(]\s*([^\])]+?)\s*[\])]"
    r"|(?:\s*[/,]|\s+in|)\s*((?:[°ºﾟ˚]\s?|deg\s?)[CFK]|[℃℉])|\s*/\s*(K|mV))$"
)
# A unit in front of a remark: ``Temp, °F (serial number)``.
_BEFORE_REMARK = re.compile(r",\s*((?:[°ºﾟ˚]\s?|deg\s?)[CFK]|K|mV)\s*[(\[]")


def without_unit(column: str) -> str:
    """Return a column's name without its unit.

    >>> without_unit("T1 [K]"), without_unit("kiln_3_degC"), without_unit("gas")
    ('T1', 'kiln_3', 'gas')
    """
    suffix = _SUFFIX.search(column)
    if suffix and suffix.start() and _unit_of(suffix):
        return column[: suffix.start()]
    return column


def written_unit(text: str) -> str:
    """Return the unit of a cell such as "Deg. F" or "°C"; empty where it is none.

    >>> written_unit("Deg. F"), written_unit("mV"), written_unit("%")
    ('degF', 'mV', '')
    """
    return _UNIT_NAMES.get(plain_unit(text), "")


def column_named(name: str, columns: Collection[str]) -> str:
    """The column that a name without its unit means; the name itself where none or several do.

    Parameters
    ----------
    name
        Name with or without a unit.
    columns
        Names of the columns.

    Examples
    --------
    >>> column_named("T1", ["time_s", "T1_degC"]), column_named("T1", ["T1_degC", "T1_K"])
    ('T1_degC', 'T1')
    """
    if name in columns:
        return name
    same = [column for column in columns if without_unit(column) == without_unit(name)]
    return same[0] if len(same) == 1 else name


def unit_in(column: str) -> str:
    """Return the unit in a column's name; empty where there is none.

    >>> unit_in("T1 (°F)"), unit_in("T1_K"), unit_in("T1")
    ('degF', 'K', '')
    >>> unit_in("T1/°C"), unit_in("Temp, °F (serial number 7)")
    ('degC', 'degF')
    """
    suffix = _SUFFIX.search(column)
    unit = _unit_of(suffix) if suffix else ""
    if unit:
        return unit
    remark = _BEFORE_REMARK.search(column)
    return written_unit(remark[1]) if remark else ""


def _unit_of(suffix: re.Match[str]) -> str:
    """Return the unit of an end of a name; empty where it is none."""
    return written_unit(next((text for text in suffix.groups() if text), ""))
