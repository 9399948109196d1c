"""Units in the names of columns and in cells: ``T1 [K]``, ``gas_degC``, ``CO2_ppm``, ``Deg. F``.

One mechanism for every quantity. ``split_unit_text`` finds where a unit stands in a name, and the
lists here say which texts are units. :mod:`tcdyn.io.times` uses both for units of time,
:mod:`tcdyn.io.response_units` for those of frequency responses, and :mod:`tcdyn.series.units` for
the columns of tables. Guarded by ``tests/io/test_unit_names.py``, ``tests/io/test_times.py`` and
``tests/sensors/test_sensor_silent.py``.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import lru_cache

# Temperatures, and the voltage of thermocouples.
TEMPERATURES = ("degC", "K", "degF")
UNITS = (*TEMPERATURES, "mV")
# Canonical names of units by their spelling in lower case, without degree signs.
_TEMPERATURE_SPELLINGS = {
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
# Seconds per unit of time by spelling; messages use the first spelling of each unit.
_TIME_SPELLINGS: dict[float, tuple[str, ...]] = {
    1.0: (
        *("s", "sec", "secs", "second", "seconds", "sek", "sekunde", "sekunden", "seconde"),
        *("secondes", "segundo", "segundos", "secondo", "secondi", "seconden"),
    ),
    1e-3: (
        *("ms", "msec", "msecs", "millis", "millisecond", "milliseconds", "milli"),
        *("millisekunde", "millisekunden", "millisecondes", "milisegundos", "millisecondi"),
    ),
    1e-6: ("us", "µs", "μs", "usec", "usecs", "micros", "microsecond", "microseconds"),
    1e-9: ("ns", "nsec", "nanosecond", "nanoseconds"),
    60.0: ("min", "mins", "minute", "minutes", "minuten", "minuto", "minutos", "minuti"),
    3600.0: (
        *("h", "hr", "hrs", "hour", "hours", "std", "stunde", "stunden", "heure", "heures"),
        *("hora", "horas", "ora", "ore", "uur"),
    ),
    86400.0: (
        *("days", "d", "day", "tag", "tage", "jour", "jours", "día", "días", "dia", "dias"),
        *("giorno", "giorni"),
    ),
}
SECONDS_PER_UNIT = {
    spelling: seconds for seconds, spellings in _TIME_SPELLINGS.items() for spelling in spellings
}
# Units of time as messages name them.
TIME_UNITS = tuple(spellings[0] for spellings in _TIME_SPELLINGS.values())
# Canonical names of other units by their spellings in lower case, without blanks and dots.
_OTHER_SPELLINGS = {
    "%": ("%", "percent", "pct", "prozent", "procent", "pourcent", "vh"),
    "%RH": ("%rh", "rh%", "%r.h", "%rf", "rf%", "%rel", "%relf", "%hr", "percentrh"),
    "ppm": ("ppm", "ppmv", "partspermillion"),
    "ppb": ("ppb", "ppbv"),
    "Pa": ("pa", "pascal"),
    "hPa": ("hpa", "hektopascal", "hectopascal"),
    "kPa": ("kpa", "kilopascal"),
    "bar": ("bar", "bars"),
    "mbar": ("mbar", "millibar"),
    "psi": ("psi", "psia", "psig"),
    "V": ("v", "volt", "volts"),
    "A": ("a", "amp", "amps", "ampere", "amperes"),
    "W": ("w", "watt", "watts"),
    "rpm": ("rpm", "u/min", "1/min", "tr/min"),
    "Hz": ("hz", "hertz"),
    "counts": ("count", "counts", "cts"),
    "lx": ("lux", "lx"),
    "Ohm": ("ohm", "ohms"),
}
_CANONICAL = {
    spelling: unit for unit, spellings in _OTHER_SPELLINGS.items() for spelling in spellings
}
# Units that are no product of symbols with a prefix, in lower case.
_SINGLE_UNITS = frozenset(
    (
        *("atm", "torr", "mmhg", "inhg", "mmh2o", "inh2o", "sccm", "slm", "slpm", "lpm", "cfm"),
        *("gpm", "ntu", "ph", "dba", "db", "vol%", "%vol", "vol-%", "wt%", "mol%", "mph", "ppt"),
    )
)
# Symbols that may have a prefix, and powers of them: mPa, m2, m³, s⁻¹.
_SYMBOLS = (
    r"Pa|bar|Hz|mol|Ohm|ohm|Ω|Wh|VA|eV|rad|lx|lm|cd|min|deg|°|degC|degF|°C|°F|[VAWNJSKmgslLhd]"
)
# Volumes of gas at standard conditions, as of flows in smL/min.
_STANDARD_VOLUME = r"s(?:m?[lL]|cc)"
_FACTOR = (
    rf"(?:{_STANDARD_VOLUME}|[pnuµμmcdhkMG]?(?:{_SYMBOLS})|%|ppm|ppb|counts?)"
    r"(?:\^?[-−]?\d|[⁻]?[¹²³⁴])?"
)
_PRODUCT = re.compile(rf"1?(?:(?:[/·⋅*. ]|_per_| per |^|(?<=[\d²³])){_FACTOR})+")
_LETTER_AND_NUMBER = re.compile(r"[A-Z]\d?")  # a label rather than a unit: V1, A
LONGEST_SYMBOL = 2  # letters of the symbol of a quantity in front of "/": U/V, I1/A
# After an underscore, a comma or a blank a letter is more often a label (zone_A, T_N, T_min), so
# that only these units are recognised there.
_AFTER_UNDERSCORE = frozenset(
    (
        *("Pa", "pa", "hPa", "hpa", "kPa", "kpa", "MPa", "mPa", "bar", "mbar", "mBar", "psi"),
        *("torr",),
        *("atm", "mmHg", "ppm", "PPM", "ppb", "PPB", "V", "uV", "µV", "μV", "kV", "Volt", "volt"),
        *("volts", "mA", "uA", "µA", "μA", "kA", "mW", "kW", "MW", "Hz", "hz", "kHz", "MHz", "GHz"),
        *("mHz", "rpm", "kN", "kJ", "MJ", "kWh", "nm", "um", "µm", "μm", "mm", "cm", "km", "mg"),
        *("ug", "µg", "μg", "kg", "mL", "ml", "mol", "lux", "lx", "counts", "ohm", "Ohm", "kOhm"),
        *("sccm", "slpm", "slm", "%", "%RH", "percent", "pct", "prozent"),
    )
)
# A quotient after an underscore: m_s, l_min, W_m2, mg_m3.
_QUOTIENT = re.compile(
    r"(?:m|mm|cm|km|l|L|ml|mL|m3|g|mg|ug|kg|mol|W|kW|J|kJ|N|V|mV|K|degC|rad|1)"
    r"_(?:s|min|h|m|m2|m3|cm2|mm2|l|L|kg|m2K|mK)"
)
_SQUARE = re.compile(r"(?P<stem>.*?)\s*\[\s*(?P<unit>[^\[\]]*?)\s*\]\s*")
_ROUND = re.compile(r"(?P<stem>.*?)\s*\(\s*(?P<unit>(?:[^()]|\([^()]*\))*?)\s*\)\s*")
# What stands between a name and its unit.
_MARK = re.compile(r"\s*[/,:]\s*|\s+in\s+|_|\s+")
# A unit with its own sign, which needs no mark: ``T1°C``, ``RH%``.
_ATTACHED = re.compile(
    r"(?P<unit>(?:[°ºﾟ˚]\s?|[Dd]eg(?:rees?)?[\s.]{0,2})[CFK]|(?<![^\W\d_])o[CF]|[℃℉]|%)$"
)
# Celsius behind the word of its quantity: raw_temp_c. Of temp_f and temp_k the letter is as often
# a label, and would change the readings.
_CELSIUS_AFTER_TEMPERATURE = re.compile(r"(?P<stem>(?:.*_)?temp(?:erature)?)_c", re.IGNORECASE)
# A unit in front of a remark: ``Temp, °F (serial number)``.
_BEFORE_REMARK = re.compile(r",\s*(?P<unit>[^,(\[]+?)\s*[(\[]")
# A letter after an underscore is a unit behind a word or symbol of its quantity: I_A, load_N.
_LETTER_AFTER_QUANTITY = re.compile(
    r"(?P<stem>(?:.*_)?(?:"
    r"(?:i|current|strom)\d*(?=_A$)|(?:p|power|leistung|heater)\d*(?=_W$)"
    r"|(?:f|force|load|friction|kraft)\d*(?=_N$)|(?:e|q|energy|energie)\d*(?=_J$)))_(?P<unit>[AWNJ])",
    re.IGNORECASE,
)
# What a temperature is called where no unit says it.
_TEMPERATURE_NAME = re.compile(
    r"(t|temp|temperature|temperatur|tc|thermocouple)([ _-]?\d+)?", re.IGNORECASE
)


def plain_unit(text: str) -> str:
    """A unit in lower case without degree signs, blanks and the word "degree".

    An "o" in front of C or F is a degree sign.

    >>> plain_unit("Deg. F"), plain_unit("°C"), plain_unit("℃"), plain_unit("oC")
    ('f', 'c', 'c', 'c')
    """
    plain = re.sub(r"^o(?=[CF]$)", "", text.strip()).lower().replace("℃", "c").replace("℉", "f")
    return re.sub(r"[\s._°ºﾟ˚]|deg(rees?)?|grad", "", plain)


@lru_cache(maxsize=20_000)
def written_unit(text: str) -> str:
    """Return the unit of a cell such as "Deg. F" or "ppm"; empty where it is none that is known.

    >>> written_unit("Deg. F"), written_unit("mV"), written_unit("% r.F."), written_unit("OK")
    ('degF', 'mV', '%RH', '')
    >>> written_unit("mg/m3"), written_unit("Volts"), written_unit("hPa"), written_unit("left")
    ('mg/m3', 'V', 'hPa', '')
    """
    text = text.strip()
    temperature = _TEMPERATURE_SPELLINGS.get(plain_unit(text))
    if temperature:
        return temperature
    without_blanks = re.sub(r"[\s.]", "", text.lower())
    if without_blanks in _CANONICAL:
        return _CANONICAL[without_blanks]
    is_known = without_blanks in _SINGLE_UNITS or without_blanks in SECONDS_PER_UNIT
    if is_known or _PRODUCT.fullmatch(text.replace("(", "").replace(")", "")):
        return text
    return ""


def is_temperature_unit(text: str) -> bool:
    """Whether a cell is a unit of a temperature or of the voltage of a thermocouple.

    >>> is_temperature_unit("Deg. F"), is_temperature_unit("%")
    (True, False)
    """
    return written_unit(text) in UNITS


def is_clear_unit(text: str) -> bool:
    """Whether a text is a unit and no label: ``ppm`` and ``V``, but not ``A`` or ``min``.

    >>> [is_clear_unit(text) for text in ("ppm", "V", "mg/m3", "m_s", "A", "min", "OK")]
    [True, True, True, True, False, False, False]
    """
    if text in _AFTER_UNDERSCORE or _QUOTIENT.fullmatch(text):
        return True
    is_whole = len(text) > 2 and re.fullmatch(r"[A-Za-z]+", text) is None
    return is_whole and bool(written_unit(text)) and not is_temperature_unit(text)


def split_unit_text(
    name: str,
    is_unit: Callable[[str, str], bool],
) -> tuple[str, str]:
    """Name without its unit, and the text of the unit; the name and "" where it has none.

    Parameters
    ----------
    name
        Name of a column.
    is_unit
        Whether a text is a unit after a mark, one of ``[``, ``(``, ``/``, ``,``, ``:``, ``in``,
        ``_`` and a blank.

    Notes
    -----
    Brackets at the end are tried first, then the longest end of the name that is a unit.

    Examples
    --------
    >>> split_unit_text("p_in [hPa]", lambda text, mark: mark == "[")
    ('p_in', 'hPa')
    >>> split_unit_text("v/m/s", lambda text, mark: text in ("m/s", "s"))
    ('v', 'm/s')
    """
    for mark, pattern in (("[", _SQUARE), ("(", _ROUND)):
        match = pattern.fullmatch(name)
        if match and is_unit(match["unit"], mark):
            return match["stem"], match["unit"]
    for match in _MARK.finditer(name):
        mark = match[0].strip() or " "
        text = name[match.end() :].strip()
        if match.start() and text and is_unit(text, mark):
            return name[: match.start()].strip(), text
    return name.strip(), ""


def unit_in(column: str) -> str:
    """Return the unit in a column's name; empty where there is none.

    Any text in square brackets is a unit, but no number; in round brackets a known one, as they
    may hold a remark; after "/", "in", a comma, a colon, an underscore or a blank a known one.

    >>> unit_in("T1 (°F)"), unit_in("T1_K"), unit_in("T1")
    ('degF', 'K', '')
    >>> unit_in("T1/°C"), unit_in("Temp, °F (serial number 7)")
    ('degC', 'degF')
    >>> unit_in("#1:oC"), unit_in("Temp. Deg C"), unit_in("raw_temp_c"), unit_in("Flow smL/min")
    ('degC', 'degC', 'degC', 'smL/min')
    >>> unit_in("CO2_ppm"), unit_in("Luftfeuchte [% r.F.]"), unit_in("Druck in hPa")
    ('ppm', '%RH', 'hPa')
    >>> unit_in("dose [a.u.]"), unit_in("T1 (left)"), unit_in("zone_A"), unit_in("T[1]")
    ('a.u.', '', '', '')
    """
    unit = _split(column)[1]
    if unit:
        return unit
    remark = _BEFORE_REMARK.search(column)
    if remark and _is_unit_after(remark["unit"], ","):
        return written_unit(remark["unit"])
    return ""


def without_unit(column: str) -> str:
    """Return a column's name without its unit.

    >>> without_unit("T1 [K]"), without_unit("kiln_3_degC"), without_unit("gas")
    ('T1', 'kiln_3', 'gas')
    >>> without_unit("CO2 (ppm)"), without_unit("v_m_s")
    ('CO2', 'v')
    """
    return _split(column)[0]


def is_same_name(first: str, second: str) -> bool:
    """Whether two names are one without their units, and may be of one quantity.

    >>> is_same_name("T1", "T1_degC"), is_same_name("T1_K", "T1 (°C)"), is_same_name("p_Pa", "p")
    (True, True, True)
    >>> is_same_name("gas_kW", "gas_degC"), is_same_name("p_Pa", "p_kPa")
    (False, True)
    """
    units = [unit_in(name) for name in (first, second)]
    is_one_kind = "" in units or (units[0] in UNITS) == (units[1] in UNITS)
    return is_one_kind and without_unit(first) == without_unit(second)


def names_other_quantity(column: str) -> bool:
    """Whether the name of a column has the unit of another quantity than a temperature.

    >>> [names_other_quantity(name) for name in ("CO2_ppm", "p [Pa]", "T1_mV", "T1_degC", "temp")]
    [True, True, False, False, False]
    """
    unit = unit_in(column)
    return bool(unit) and unit not in UNITS


def names_temperature(column: str, unit_row: str = "") -> bool:
    """Whether a column is a temperature by its unit, or by its name alone.

    >>> [names_temperature(name) for name in ("gas_degC", "T1", "temp", "U_mV", "level", "T_ppm")]
    [True, True, True, False, False, False]
    """
    if unit_in(column) or unit_row:
        return (unit_in(column) or written_unit(unit_row)) in TEMPERATURES
    return _TEMPERATURE_NAME.fullmatch(column) is not None


@lru_cache(maxsize=20_000)
def _split(column: str) -> tuple[str, str]:
    """Name without its unit, and the unit; the name as it is, and "", where it has none."""
    stem, text = split_unit_text(column, _is_unit_after)
    if text and stem and not _is_label(stem, text, column):
        return stem, written_unit(text) or text
    letter = _LETTER_AFTER_QUANTITY.fullmatch(column)
    if letter:
        return letter["stem"], letter["unit"]
    celsius = _CELSIUS_AFTER_TEMPERATURE.fullmatch(column)
    if celsius:
        return celsius["stem"], "degC"
    attached = _ATTACHED.search(column)
    if attached and attached.start():
        return column[: attached.start()].rstrip(" /,"), written_unit(attached["unit"])
    return column, ""


def _is_unit_after(text: str, mark: str) -> bool:
    """Whether a text after a mark is a unit; see ``unit_in``."""
    if mark == "[":
        return re.search(r"[^\W\d]|[%°]", text) is not None
    if mark in ("(", "/", "in"):
        return bool(written_unit(text))
    if text.startswith("1/"):  # "Run 1/A"
        return False
    is_temperature = text in UNITS or _ATTACHED.fullmatch(text) is not None
    if is_temperature:
        return mark != " " or text not in ("K", "mV")
    return is_clear_unit(text) and not (mark == " " and text == "V")


def _is_label(stem: str, text: str, column: str) -> bool:
    """Whether a letter that may be a unit is a label: ``T1 (J)`` of type J, ``Run 1/V2``.

    >>> _is_label("T1", "J", "T1 (J)"), _is_label("Q", "J", "Q (J)"), _is_label("U", "V", "U/V")
    (True, False, False)
    >>> _is_label("Run 1", "A", "Run 1/A")
    True
    """
    if text in ("C", "K", "F") or not _LETTER_AND_NUMBER.fullmatch(text):
        return False
    if column.endswith(")"):
        return _TEMPERATURE_NAME.fullmatch(stem) is not None
    is_first_letter = text == "A" and len(stem) > LONGEST_SYMBOL
    return column.endswith("/" + text) and (len(text) > 1 or is_first_letter)
