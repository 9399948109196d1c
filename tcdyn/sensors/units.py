"""What a column of any table holds: its unit by its name or as declared, and its numbers in degrees Celsius."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, info, warning
from tcdyn.io.table import missing
from tcdyn.rig.thermocouple_types import to_degC

UNITS = ("degC", "K", "degF", "mV")
_WRITTEN = {
    "degc": "degC",
    "°c": "degC",
    "c": "degC",
    "celsius": "degC",
    "deg c": "degC",
    "k": "K",
    "kelvin": "K",
    "degf": "degF",
    "°f": "degF",
    "f": "degF",
    "fahrenheit": "degF",
    "deg f": "degF",
    "mv": "mV",
    "millivolt": "mV",
}
_SUFFIX = re.compile(r"(?:_(degC|K|degF|mV)|\s*[\[(]\s*([^\])]+?)\s*[\])])$")
COLDEST_K = 100.0  # no usual thermocouple reads colder, however its unit is called


@dataclass(frozen=True)
class Unit:
    """How the numbers of a column become degrees Celsius: the unit's ``name``; of mV also ``couple`` and ``cold``.

    ``cold``: the reference junction's temperature [degC], or the name of the column that holds it.

    >>> Unit("degF").in_degC(np.array([212.0])), Unit("mV", couple="K").in_degC(np.array([4.096])).round(1)
    (array([100.]), array([100.]))
    """

    name: str = "degC"
    couple: str = ""
    cold: float | str = 0.0

    def __post_init__(self) -> None:
        if self.name not in UNITS:
            raise InputError(f"unit {self.name!r}", expected=" or ".join(UNITS))
        if self.name == "mV" and not self.couple:
            raise InputError(
                "millivolts of which thermocouple?",
                expected="its type: E, J, K, N or T",
                remedy="say {couple}",
                parameters={"couple": "K"},
            )

    @property
    def per_K(self) -> float:
        """How many of the output's units one kelvin is."""
        return 1.8 if self.name == "degF" else 1.0

    def in_degC(self, values: Array, cold_degC: Array | float = 0.0) -> Array:
        """The numbers (N,) in degrees Celsius; infinite where a couple has no such emf."""
        return values if self.name == "degC" else to_degC(self.name, self.couple, cold_degC)(values)

    def back(self, degC: Array) -> Array:
        """Degrees Celsius (N,) in the unit of the output, which is the column's own, but degrees Celsius for mV."""
        return {"K": degC + 273.15, "degF": 1.8 * degC + 32}.get(self.name, degC)

    def names(self, column: str) -> tuple[str, str]:
        """What the answer and its standard uncertainty are called in the output."""
        out = f"{bare(column)}_degC" if self.name == "mV" else column
        return out, u_name(column, self.name)


def bare(column: str) -> str:
    """A column's name without its unit.

    >>> bare("T1 [K]"), bare("kiln_3_degC"), bare("gas")
    ('T1', 'kiln_3', 'gas')
    """
    found = _SUFFIX.search(column)
    known = found and (found[1] or found[2].lower() in _WRITTEN)
    return column[: found.start()] if found and known else column


def written_unit(text: str) -> str:
    """The unit that a cell such as "Deg. F" or "°C" means; empty where it means none.

    >>> written_unit("Deg. F"), written_unit("mV"), written_unit("%")
    ('degF', 'mV', '')
    """
    plain = re.sub(r"[\s.°º]|deg(rees?)?", "", text.lower())
    return _WRITTEN.get(plain, "mV" if plain == "millivolts" else "")


def unit_in(column: str) -> str:
    """The unit that a column's name states; empty where it states none.

    >>> unit_in("T1 (°F)"), unit_in("T1_K"), unit_in("T1")
    ('degF', 'K', '')
    """
    found = _SUFFIX.search(column)
    return "" if not found else found[1] or _WRITTEN.get(found[2].lower(), "")


def units_of(
    columns: Sequence[str],
    declared: Mapping[str, str] | str = "",
    couple: str = "",
    cold: float | str = 0.0,
    unit_row: Mapping[str, str] | None = None,
) -> tuple[dict[str, Unit], list[Finding]]:
    """The unit of each column: as declared (for all, or by column), else by its name, else by the row of units below
    the header, else degrees Celsius, told.

    >>> units_of(["Zone 1"], "F")[0]["Zone 1"].name, [f.code for f in units_of(["T1_degF"], "degC")[1]]
    ('degF', ['sensor.unit_contradicted'])
    """
    out = {}
    plain = []
    told = list[Finding]()
    for name in columns:
        own = (
            declared
            if isinstance(declared, str)
            else declared.get(name, declared.get(bare(name), ""))
        )
        below_header = (unit_row or {}).get(name, "")
        stated = unit_in(name) or written_unit(below_header)
        unit = _WRITTEN.get(own.lower(), own) or stated
        if below_header and not unit:
            raise InputError(
                f"column {name!r}: its unit {below_header!r} in the row below the header is not known",
                expected=" or ".join(UNITS),
                remedy="name the unit, {unit}",
                parameters={"unit": "UNIT"},
            )
        if stated and stated != unit:
            told.append(warning("sensor.unit_contradicted", subject=name, said=unit))
        if not unit:
            plain.append(name)
        out[name] = Unit(unit or "degC", couple if (unit or "degC") == "mV" else "", cold)
    return out, [
        *told,
        *(
            [info("sensor.unit_assumed", subject=", ".join(plain), count=len(plain))]
            if plain
            else []
        ),
    ]


def doubtful(column: str, unit: Unit, values: Array) -> list[Finding]:
    """What speaks against a unit: kelvin that would be colder than 100 K, degrees Celsius that look like kelvin."""
    middle = float(np.nanmedian(values)) if np.isfinite(values).any() else np.nan
    if unit.name == "K" and middle < COLDEST_K:
        return [warning("sensor.unit_doubt", subject=column, unit="K", value=middle)]
    return []


def matching(pattern: str, names: Collection[str], where: str) -> list[str]:
    """The columns that a sensor's column means: by name, by name without unit, ``*`` for any text."""
    hits = [n for n in names if n == pattern] or [
        n
        for n in names
        if fnmatchcase(n, pattern) or fnmatchcase(bare(n), pattern) or bare(n) == bare(pattern)
    ]
    if not hits:
        raise missing("column", pattern, names, where)
    return list(dict.fromkeys(hits))


def cold_column(cold: float | str, names: Collection[str], where: str) -> float | str:
    """The reference junction's temperature [degC], or the one column that its name means.

    >>> cold_column("CJ", ["T1_mV", "CJ_degC"], "log.csv"), cold_column(0.0, [], "log.csv")
    ('CJ_degC', 0.0)
    """
    if not isinstance(cold, str):
        return cold
    found = matching(cold, names, where)
    if len(found) > 1:
        raise InputError(
            f"{cold!r} means {' and '.join(map(repr, found))}", where=where, expected="one column"
        )
    return found[0]


def u_name(column: str, unit: str = "") -> str:
    """What the standard uncertainty of a column of temperature is called, in ``unit`` or that of its name.

    >>> u_name("fast_a_degC"), u_name("T1 [K]"), u_name("gas_degF"), u_name("T2")
    ('fast_a_u_K', 'T1_u_K', 'gas_u_degF', 'T2_u_K')
    """
    return f"{bare(column)}_u_{'degF' if (unit or unit_in(column)) == 'degF' else 'K'}"
