"""Meaning of the cells of a text table: numbers, words for a switch, clock times.

Used by :mod:`tcdyn.io.csv_dialect` to detect the dialect, and by :mod:`tcdyn.io.read` and
:mod:`tcdyn.io.binary` to read columns of text. Guarded by ``tests/io/test_logger_families.py``.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, SampleLocation, info, warning
from tcdyn.io.no_reading import OtherCells, are_mostly_numbers
from tcdyn.io.response_units import is_response_unit
from tcdyn.io.stamps import ORDER_NAMES, Stamps, is_stamp
from tcdyn.io.unit_names import SECONDS_PER_UNIT, is_clear_unit, is_temperature_unit

# groups of three digits: 1,234.5 or 1.234,5 (both marks are needed), 1 234.5 and 1'234.5
_SPACES = " '’\u00a0\u202f"
_DIGITS = {
    ".": rf"\d+\.?\d*|\.\d+|\d{{1,3}}(?:,\d{{3}})+\.\d*|\d{{1,3}}(?:[{_SPACES}]\d{{3}})+(?:\.\d*)?",
    ",": rf"\d+,?\d*|,\d+|\d{{1,3}}(?:\.\d{{3}})+,\d*|\d{{1,3}}(?:[{_SPACES}]\d{{3}})+(?:,\d*)?",
}
NUMBER = {  # by decimal mark; U+2212 is the minus sign of some spreadsheets
    decimal: re.compile(rf"\s*[-+\u2212]?(?:{digits})(?:[eE][-+]?\d+)?\s*")
    for decimal, digits in _DIGITS.items()
}
_WITHOUT_GROUPS = {
    ".": str.maketrans({**dict.fromkeys("," + _SPACES, ""), "\u2212": "-"}),
    ",": str.maketrans({**dict.fromkeys("." + _SPACES, ""), "\u2212": "-", ",": "."}),
}
# a number with its unit in one cell: "21.5 °C", "3 sec", "40 %"
_WITH_UNIT = re.compile(
    r"\s*(?P<number>.*?\d[.,]?)\s?(?P<unit>(?:[°ºﾟ]|[Dd]eg(?:rees?)?\.?)\s?[CFK]|[℃℉%]|[^\W\d_]{1,12}\.?)\s*"
)
# lower-case cells without a value
NOT_A_NUMBER = ("nan", "+nan", "-nan", "1.#qnan", "-1.#ind")
INFINITE = ("inf", "-inf", "+inf")
ABSENT = frozenset(
    ("", "null", "na", "n/a", "#n/a", "#nv", "#null!", "none", *NOT_A_NUMBER, *INFINITE)
)
FLAGS = {  # lower-case words for a switch
    "true": 1.0,
    "on": 1.0,
    "yes": 1.0,
    "high": 1.0,
    "false": 0.0,
    "off": 0.0,
    "no": 0.0,
    "low": 0.0,
}
DECISION_CELLS = 1000  # filled cells that decide what a column holds; chosen by judgement


def is_number(text: str, decimal: str = ".") -> bool:
    """Whether ``text`` is one number with this decimal mark.

    >>> is_number("1,234.5"), is_number("1.234,5", ","), is_number("1,234")
    (True, True, False)
    """
    return NUMBER[decimal].fullmatch(text) is not None


def to_number(text: str, decimal: str = ".") -> float:
    """The number in a cell for which :func:`is_number` is true.

    >>> to_number("1'234.5"), to_number("-1.234,5", ",")
    (1234.5, -1234.5)
    """
    return float(text.strip().translate(_WITHOUT_GROUPS[decimal]))


def is_unit(cell: str) -> bool:
    """Whether a cell is a unit, and no label such as A: of time or any quantity."""
    is_time_unit = cell.rstrip(".").lower() in SECONDS_PER_UNIT
    is_other = is_temperature_unit(cell) or is_response_unit(cell) or is_clear_unit(cell)
    return is_time_unit or is_other


def number_and_unit(text: str, decimal: str) -> tuple[str, str]:
    """Number and unit of a cell with both; two empty texts for any other cell.

    >>> number_and_unit("12.5 °C", "."), number_and_unit("3 sec", "."), number_and_unit("7 OK", ".")
    (('12.5', '°C'), ('3', 'sec'), ('', ''))
    """
    match = _WITH_UNIT.fullmatch(text)
    if match is None or not is_number(match["number"], decimal):
        return "", ""
    unit = match["unit"]
    return (match["number"], unit) if is_unit(unit) else ("", "")


@lru_cache(maxsize=20_000)
def kind_of_cell(text: str, decimal: str) -> str:
    """Kind of a cell: "number", "stamp", "flag", "absent", "filler", "word", or else "other".

    A filler has neither letters nor digits.

    >>> [kind_of_cell(text, ".") for text in ("1.5", "10:00:00", "on", "")]
    ['number', 'stamp', 'flag', 'absent']
    >>> [kind_of_cell(text, ".") for text in ("--.--", "OK", "1,5")]
    ['filler', 'word', 'other']
    """
    lower = text.lower()
    if is_number(text, decimal):
        return "number"
    if lower in ABSENT:
        return "absent"
    if is_stamp(text):
        return "stamp"
    if lower in FLAGS:
        return "flag"
    if not re.search(r"[^\W_]", text):
        return "filler"
    if number_and_unit(text, decimal)[1]:
        return "number"
    return "word" if re.search(r"[^\W\d_]", text) else "other"


def is_text(cells: Mapping[str, int], decimal: str) -> bool:
    """Whether a column holds text, by the number of its cells of each text.

    >>> is_text({"OK": 290, "12": 10}, "."), is_text({"OPEN": 9, "20.1": 1, "20.2": 1}, ".")
    (True, True)
    >>> is_text({"OPEN": 90, **{str(k): 1 for k in range(30)}}, ".")
    False
    """
    counts: Counter[str] = Counter()
    different: Counter[str] = Counter()
    for text, count in cells.items():
        kind = kind_of_cell(text, decimal)
        counts["words" if kind == "word" else kind] += count
        different["words" if kind == "word" else kind] += 1
    others = sum(counts[kind] for kind in ("number", "flag", "stamp", "other"))
    numbers = different["number"]
    return not are_mostly_numbers(
        counts["words"], others, {"words": different["words"], "numbers": numbers}
    )


class TextColumn:
    """A column of cells of text, in one chunk or in many, with the same result.

    Parameters
    ----------
    name, decimal
        Name of the column and decimal mark.
    location
        Location of the samples, for messages.
    clock
        Whether the column holds clock times; None: decided by the first chunk that is not empty.
    words
        Whether it holds text, which is no error and has no numbers; None: decided in the same way.
    is_time
        Whether clock times that cannot be read are an error; those of a column that is not the time
        are text.

    Notes
    -----
    Clock times are seconds since the first one; see ``Stamps`` for dates and midnight. A word for a
    switch counts as 0 or 1 only in a column without other numbers.

    Examples
    --------
    >>> TextColumn("time", ".", SampleLocation("x.csv")).numbers(["23:59:59.5", "00:00:00,25"], 0)
    array([0.  , 0.75])
    """

    def __init__(
        self,
        name: str,
        decimal: str,
        location: SampleLocation,
        clock: bool | None = None,
        words: bool | None = None,
        is_time: bool = True,
    ) -> None:
        """Start before the first cell; the parameters are those of the class."""
        self.name = name
        self.decimal = decimal
        self.location = location
        self.clock = clock
        self.words = words
        self.is_time = is_time
        self.is_switch: bool | None = None
        self.unit = ""
        self.others = OtherCells(name, decimal, location)
        self.stamps = Stamps(name, location.where)

    def numbers(self, texts: list[str], first_index: int) -> Array:
        """Numbers (N,) from the cells of a chunk.

        Parameters
        ----------
        texts
            The cells; chunks must come in their order.
        first_index
            Index in the file of the first of them.
        """
        if self.is_switch is None:
            self._decide_kind([text for text in texts if text.lower() not in ABSENT])
        if self.words:
            return np.full(len(texts), np.nan)
        if self.clock:
            return self._seconds(texts)
        values = np.full(len(texts), np.nan)
        for i, text in enumerate(texts):
            values[i] = self._number(text, first_index + i)
        self.others.add_numbers(values)
        return values

    def _seconds(self, texts: list[str]) -> Array:
        """Seconds (N,) of clock times; NaN from where those of another column cannot be read on."""
        try:
            return self.stamps.seconds(texts)
        except InputError:
            if self.is_time:
                raise
        self.words = True
        return np.full(len(texts), np.nan)

    def _decide_kind(self, filled: list[str]) -> None:
        """Decide what the column holds, by the filled cells of a chunk; not if there is none."""
        cells = filled[:DECISION_CELLS]
        if not cells:
            return
        if self.clock is None:
            n_stamps = sum(is_stamp(text) for text in cells)  # 20211126100559 is a number, too
            self.clock = n_stamps > 0.5 * len(cells)
        if self.words is None:
            self.words = not self.clock and is_text(Counter(cells), self.decimal)
            if self.words and len(filled) > len(cells):  # its first readings may be missing
                self.words = is_text(Counter(filled), self.decimal)
        plain = [text for text in cells if is_number(text, self.decimal)]
        self.is_switch = all(to_number(text, self.decimal) in (0.0, 1.0) for text in plain)
        if not plain:
            self.unit = number_and_unit(cells[0], self.decimal)[1]

    def _number(self, text: str, index: int) -> float:
        """Number in a cell; NaN, and counted, if it holds something else.

        Parameters
        ----------
        text
            The cell.
        index
            Index of the cell in the file.
        """
        if is_number(text, self.decimal):
            return to_number(text, self.decimal)
        lower = text.lower()
        if lower in ABSENT:
            self.others.absent += 1
            return np.inf if "inf" in lower else np.nan
        if self.is_switch and lower in FLAGS:
            return FLAGS[lower]
        if self.unit:
            number, unit = number_and_unit(text, self.decimal)
            if unit == self.unit:
                return to_number(number, self.decimal)
        self.others.add(text, index)
        return np.nan

    def findings(self, cells: int, is_complete: bool = True) -> list[Finding]:
        """Findings about the column.

        Parameters
        ----------
        cells
            Number of its cells.
        is_complete
            Whether too few numbers are an error and not a warning.

        Raises
        ------
        InputError
            For numbers in another notation, and for a column of text (``OtherCells``).
        """
        if self.clock:
            return self._clock_findings()
        return self.others.findings(cells, is_complete)

    def _clock_findings(self) -> list[Finding]:
        """Findings about a column of clock times."""
        findings = []
        if self.stamps.midnights:
            findings.append(info("text.midnight", subject=self.name))
        if self.stamps.clock_changes:
            dates = ", ".join(self.stamps.clock_changes)
            findings.append(warning("text.clock_change", subject=self.name, dates=dates))
        order, date = self.stamps.assumed
        if order:
            taken = ORDER_NAMES[order]
            findings.append(warning("text.date_order", subject=self.name, date=date, order=taken))
        return findings
