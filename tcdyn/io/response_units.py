"""Units of the columns of a frequency response: ``w_rad_s``, ``f [mHz]``, ``Magnitude (dB)``.

``tcdyn.identification.response_table`` decides with them what a column holds. Guarded by
``tests/io/test_response_units.py``.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from tcdyn.io.column_names import column_named
from tcdyn.io.unit_names import SECONDS_PER_UNIT, split_unit_text

Kind = Literal["frequency", "rate", "angle", "level", "percent", "unclear"]

# Units as messages name them.
FREQUENCY_UNITS = ("Hz", "mHz", "kHz", "rad/s", "rad/min", "rpm")
PHASE_UNITS = ("deg", "rad", "mrad")

_PREFIXES = {"": 1.0, "n": 1e-9, "u": 1e-6, "m": 1e-3, "k": 1e3, "M": 1e6, "G": 1e9}
# Only the case of the first letter distinguishes mHz and MHz.
_HERTZ = re.compile(r"(?P<prefix>[nukKG]?)(?:Hz|hz|HZ|[Hh]ertz)|(?P<case>[mM])(?:Hz|[Hh]ertz)")
_PER = r"(?:/|_?per_?|_|)"
_RADIANS_PER = re.compile(
    rf"(?P<prefix>[mk]?)rad(?:ian)?s?{_PER}(?P<time>[a-z]+)(?:\^?-1)?", re.IGNORECASE
)
_TURNS_PER = re.compile(rf"(?:cycles?|cyc|rev|turns?){_PER}(?P<time>[a-z]+)", re.IGNORECASE)
_RATE = re.compile(r"1/(?P<slash>[a-z]+)|(?:per_)?(?P<power>[a-z]+)\^?-1", re.IGNORECASE)
_SHORT = {"rpm": 60.0, "cpm": 60.0, "cps": 1.0, "cph": 3600.0, "cpd": 86400.0}
# Degrees per unit.
_ANGLES = {
    "deg": 1.0,
    "degs": 1.0,
    "degree": 1.0,
    "degrees": 1.0,
    "grad": 1.0,  # German for degree
    "rad": 180 / np.pi,
    "rads": 180 / np.pi,
    "radian": 180 / np.pi,
    "radians": 180 / np.pi,
    "radiant": 180 / np.pi,
    "mrad": 0.18 / np.pi,
    "turn": 360.0,
    "turns": 360.0,
    "cycle": 360.0,
    "cycles": 360.0,
    "rev": 360.0,
    "gon": 0.9,
}
# Decibels per unit.
_LEVELS = {"db": 1.0, "dbr": 1.0, "decibel": 1.0, "decibels": 1.0, "np": 20 / np.log(10)}
# Units that may be two things, or whose reference is no input of a plant: "mhz", "dBm".
_UNCLEAR = re.compile(r"mhz|MHZ|mHZ|Mhz|dB[A-Za-z]+")
_BRACKETS = re.compile(r"[\[(]\s*([^\[\]()]*(?:\([^()]*\))?[^\[\]()]*?)\s*[\])]")
# Where a unit may begin: after a mark, or at a capital after a small letter (``freqHz``).
_BEGINNING = re.compile(r"(?<=[\s_/,.:|\-])(?=[^\s_,.:|\-])|(?<=[a-z])(?=[A-Zµμ]|dB)|(?<=\w)(?=°)")
_PER_PERCENT = re.compile(r"(?:/|_?per_?)\s*%", re.IGNORECASE)  # the end of a unit such as K/%
_ANGULAR_NAMES = {"w", "ω", "om", "omega", "angular", "circular", "kreisfrequenz", "pulsation"}
_REAL_NAMES = {"re", "real", "realteil", "reell", "réel"}
_IMAGINARY_NAMES = {"im", "imag", "imaginary", "imaginär", "imaginärteil", "imaginaire"}
_LOGARITHM = re.compile(r"(?<![a-z])(?:log(?:10)?|lg|ln)(?![a-z])", re.IGNORECASE)


@dataclass(frozen=True)
class ResponseUnit:
    """What a unit in a header measures.

    Attributes
    ----------
    kind
        "frequency", "rate" (1/s: of turns or of radians), "angle", "level" (dB), "percent", or
        "unclear": it looks like a unit of a frequency response but may be two of them.
    factor
        Hz, 1/s, degrees, dB or one in one unit.
    text
        The unit as the header writes it.
    """

    kind: Kind
    factor: float
    text: str


def response_unit(text: str, preferred: Kind = "frequency") -> ResponseUnit | None:
    """Return the unit that a text is; None where it is none of a frequency response.

    Parameters
    ----------
    text
        Text such as "rad/s".
    preferred
        Kind of "rads", which is rad/s of a frequency and radians of an angle.

    Examples
    --------
    >>> response_unit("mHz").factor, response_unit("dB").kind, response_unit("K")
    (0.001, 'level', None)
    """
    plain = _plain(text)
    angle = _ANGLES.get(plain.lower())
    if preferred == "angle" and angle is not None:
        return ResponseUnit("angle", angle, text)
    frequency = _frequency(plain)
    if frequency is not None:
        return ResponseUnit("frequency", frequency, text)
    rate = _RATE.fullmatch(plain)
    if rate:
        seconds = SECONDS_PER_UNIT.get((rate["slash"] or rate["power"]).lower())
        if seconds:
            return ResponseUnit("rate", 1 / seconds, text)
    if angle is not None:
        return ResponseUnit("angle", angle, text)
    level = _LEVELS.get(plain.lower())
    if level is not None:
        return ResponseUnit("level", float(level), text)
    if plain == "%":
        return ResponseUnit("percent", 0.01, text)
    if _UNCLEAR.fullmatch(plain):
        return ResponseUnit("unclear", np.nan, text)
    return None


def unit_of_column(name: str, preferred: Kind = "frequency") -> ResponseUnit | None:
    """Return the unit in the name of a column; None where it has none that is known.

    Parameters
    ----------
    name
        Name of the column.
    preferred
        As in :func:`response_unit`.

    Examples
    --------
    >>> unit_of_column("w_rad_s").text, unit_of_column("Magnitude (dB)").kind
    ('rad_s', 'level')
    >>> unit_of_column("phase/°", "angle").factor, unit_of_column("gain")
    (1.0, None)
    """
    for text in _unit_texts(name):
        unit = response_unit(text, preferred)
        is_part = unit is not None and unit.kind == "percent" and _PER_PERCENT.search(name)
        if unit is not None and not is_part:
            return unit
    return None


def response_column_named(name: str, columns: Collection[str], where: str) -> str:
    """The column of a frequency response that a name with or without its unit means.

    >>> names = ["f (mHz)", "gain_dB", "phase/°"]
    >>> [response_column_named(name, names, "bode.csv") for name in ("f", "gain", "phase")]
    ['f (mHz)', 'gain_dB', 'phase/°']

    Parameters
    ----------
    name, columns, where
        As for :func:`tcdyn.io.column_names.column_named`, which has the errors.
    """
    return column_named(name, columns, where, stem=_without_response_unit)


def _without_response_unit(column: str) -> str:
    """Name of a column of a frequency response without its unit."""
    return split_unit_text(column, lambda text, mark: response_unit(text) is not None)[0]


def bracketed_text(name: str) -> str:
    """Return the last text in brackets of a name; empty where there is none."""
    texts = _BRACKETS.findall(name)
    return texts[-1] if texts else ""


def is_response_unit(cell: str) -> bool:
    """Whether a cell of a row of units is a unit of a frequency response.

    >>> is_response_unit("kHz"), is_response_unit("rad"), is_response_unit("OK")
    (True, True, False)
    """
    unit = response_unit(cell)
    return unit is not None and unit.kind in ("frequency", "rate", "angle", "level")


def is_angular(name: str) -> bool:
    """Whether a name is that of an angular frequency.

    >>> is_angular("omega"), is_angular("w_rad_s"), is_angular("f")
    (True, True, False)
    """
    return bool(_words(name) & _ANGULAR_NAMES)


def is_real_and_imaginary(first: str, second: str) -> bool:
    """Whether two names are those of a real and an imaginary part.

    >>> is_real_and_imaginary("Re(G)", "Im(G)"), is_real_and_imaginary("mag", "phase")
    (True, False)
    """
    return bool(_words(first) & _REAL_NAMES) and bool(_words(second) & _IMAGINARY_NAMES)


def is_logarithm(name: str) -> bool:
    """Whether a name speaks of a logarithm.

    >>> is_logarithm("log10(f)"), is_logarithm("log_w"), is_logarithm("catalog")
    (True, True, False)
    """
    return _LOGARITHM.search(name.replace("_", " ")) is not None


def _words(name: str) -> set[str]:
    """Return the words of a name in lower case."""
    return set(re.split(r"[\W_\d]+", name.lower()))


def _plain(text: str) -> str:
    """Return a unit without blanks, with one spelling of signs and powers."""
    plain = text.strip().strip("[]").strip().rstrip(".")
    for old, new in (("⁻¹", "-1"), ("−", "-"), ("**", "^"), ("µ", "u"), ("μ", "u"), ("º", "°")):
        plain = plain.replace(old, new)
    plain = plain.replace("˚", "°").replace("°", "deg")
    plain = re.sub(r"[\s·⋅*]+", "_", plain)
    return plain.replace("_/_", "/").replace("^-1", "-1")


def _frequency(plain: str) -> float | None:
    """Return the Hz in one unit of a frequency; None where the text is none."""
    hertz = _HERTZ.fullmatch(plain)
    if hertz:
        prefix = hertz["case"] or hertz["prefix"].replace("K", "k")
        return _PREFIXES[prefix]
    if plain.lower() in _SHORT:
        return 1 / _SHORT[plain.lower()]
    for pattern, per_turn in ((_RADIANS_PER, 2 * np.pi), (_TURNS_PER, 1.0)):
        match = pattern.fullmatch(plain)
        if match and match["time"].lower() in SECONDS_PER_UNIT:
            prefix = match.groupdict().get("prefix") or ""
            scale = _PREFIXES[prefix.lower()]
            return float(scale / per_turn / SECONDS_PER_UNIT[match["time"].lower()])
    return None


def _unit_texts(name: str) -> Iterator[str]:
    """Yield the texts of a name that may be its unit: brackets, then ends, the longest first."""
    yield from reversed(_BRACKETS.findall(name))
    without_brackets = _BRACKETS.sub(" ", name).strip()
    for text in dict.fromkeys((name.strip(), without_brackets)):
        yield text
        for beginning in _BEGINNING.finditer(text):
            end = text[beginning.start() :]
            yield end.removeprefix("in ")
