"""Readings that no thermocouple has because they are in another unit: integers of 0.001 degC, mV.

Loggers and buses write temperatures as integers in thousandths, hundredths or tenths of a degree. A
record of such numbers is not one of drop-outs, which are few and have one value or some
(:mod:`tcdyn.series.plausible`). Tests: ``tests/series/test_scaled_readings.py``.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.io.pandas_lines import pandas_line
from tcdyn.io.table import Table
from tcdyn.io.unit_names import (
    UNITS,
    names_other_quantity,
)
from tcdyn.series.plausible import HIGHEST_DEGC, LOWEST_DEGC, MAX_CODES, out_of_range

# Share of the readings beyond the range of a thermocouple from which they are no drop-outs, if they
# are many different ones that follow each other without jumps. By judgement.
LARGE_SHARE = 0.1
# Such readings follow each other: the median change from one to the next is below this share of
# the range of the column. Random numbers of an open input: 1 - 1/sqrt(2) = 0.29 of it.
SMOOTH_SHARE = 0.1
# Share of readings beyond the range from which no sound part is left: the changes do not matter.
NEARLY_ALL = 0.95
# Readings kept for this median, of a part and of all: memory.
KEPT_OF_PART = 5_000
KEPT = 200_000
# Quantiles of the readings that are their limits: codes of the logger lie outside. By judgement.
LIMITS = (0.02, 0.98)
# Scales of integers by how often they are met: divided by the number, degC or K.
SCALES = ((1000, "degC"), (100, "degC"), (10, "K"), (100, "K"), (10, "degC"), (1000, "K"))
SCALES_DEGF = ((100, "degF"), (10, "degF"), (1000, "degF"))
ZERO_DEGC_K = 273.15
# Most probable first reading [degC]: of the scales that give temperatures, the one that comes
# nearest to it is the example of the message. By judgement.
ROOM_DEGC = 20.0
# Temperatures that a scale of the message gives: liquid nitrogen, and the end of type K, 1372 degC
# (IEC 60584-1).
USUAL_LOWEST_DEGC = -200.0
USUAL_HIGHEST_DEGC = 1400.0
LISTED = 3  # scales that a message names


@dataclass
class RangeCheck:
    """Readings of a column beyond the range of a thermocouple, counted in parts of its rows.

    Attributes
    ----------
    column
        Its name.
    unit
        Its unit: degC, K, degF, or mV of a thermocouple. Columns in other units are not checked.
    count, beyond
        Readings, and those of them beyond the range.
    first
        First reading, in the unit of the column.
    different
        Readings beyond the range, up to one more than ``MAX_CODES``.
    kept
        Readings of some rows.
    jumps
        Changes from one reading beyond the range to the next, in these rows.
    """

    column: str
    unit: str = "degC"
    count: int = 0
    beyond: int = 0
    first: float = np.nan
    different: set[float] = field(default_factory=set)
    kept: list[Array] = field(default_factory=list)
    jumps: list[Array] = field(default_factory=list)

    def add(self, values: Array, degC: Array) -> None:
        """Add rows.

        Parameters
        ----------
        values
            Readings (N,) in the unit of the column, NaN where missing.
        degC
            The same in degrees Celsius; infinite where a thermocouple has no such voltage.
        """
        finite = np.isfinite(values)
        if not finite.any() or self.unit not in UNITS:
            return
        y = values[finite]
        # a missing reference junction gives no temperature, which is no fault of the unit
        is_beyond = out_of_range(degC[finite]) | np.isinf(degC[finite])
        if not self.count:
            self.first = float(np.median(y[:10]))
        self.count += len(y)
        self.beyond += int(is_beyond.sum())
        if len(self.different) <= MAX_CODES:
            self.different |= set(np.unique(y[is_beyond])[: MAX_CODES + 1].tolist())
        if sum(map(len, self.kept)) >= KEPT:
            return
        start = int(np.argmax(is_beyond))
        part = slice(start, start + KEPT_OF_PART)
        self.kept += [y[:start][-KEPT_OF_PART:], y[part]]
        self.jumps.append(np.abs(np.diff(y[part]))[is_beyond[part][1:] & is_beyond[part][:-1]])

    @property
    def limits(self) -> Array:
        """Smallest and largest reading (2,) in the column's unit, without codes of a logger."""
        return np.asarray(np.quantile(np.concatenate(self.kept), LIMITS), dtype=float)

    @property
    def is_other_unit(self) -> bool:
        """Whether so many readings beyond the range make a record of their own."""
        is_other = names_other_quantity(self.column) or self.unit not in UNITS
        if is_other or self.beyond < LARGE_SHARE * self.count:
            return False
        if len(self.different) <= MAX_CODES:
            return False
        if self.beyond >= NEARLY_ALL * self.count:
            return True
        jumps = np.concatenate(self.jumps)
        low, high = self.limits
        return len(jumps) > 0 and float(np.median(jumps)) < SMOOTH_SHARE * (high - low)

    def check(self, where: str, table: Table | None) -> None:
        """Raise InputError for a column in another unit.

        Parameters
        ----------
        where
            The table, for the message.
        table
            The open table; None for one in memory.

        Raises
        ------
        InputError
            With the scales that make it a temperature, and a line of Python that converts it.
        """
        if not self.is_other_unit:
            return
        percent = 100 * self.beyond / self.count
        low, high = self.limits
        least, most = _range_of(self.unit)
        problem = (
            f"{percent:.3g} % of the readings of column {self.column!r}, which run from {low:.6g} "
            f"to {high:.6g}, are beyond {least:.4g} to {most:.4g} {self.unit}: they are no "
            "drop-outs, but in another unit"
        )
        scales = [(1000, "mV")] if self.unit == "mV" else self.likely_scales()
        text = " or ".join(self._scale_text(*scale) for scale in scales)
        if not scales:
            raise InputError(
                problem,
                where=where,
                expected="a temperature",
                remedy="convert the column, or state the unit of another quantity, {unit}",
                parameters={"unit": "ppm"},
            )
        divisor, unit = scales[0]
        converted = f"d[{self.column!r}] / {divisor}"
        if self.unit == "degC" and unit == "K":
            converted += f" - {ZERO_DEGC_K}"
        elif self.unit == "K" and unit == "degC":
            converted += f" + {ZERO_DEGC_K}"
        expression = f"d.assign(**{{{self.column!r}: {converted}}})"
        line = pandas_line(table, expression, ending=self.unit, as_text=False)
        raise InputError(
            problem,
            where=where,
            expected=f"a temperature; they may be in units of {text}",
            remedy=f"convert them, for the first of these with: {line}; or state the unit of "
            "another quantity, {unit}",
            parameters={"unit": "ppm"},
        )

    def likely_scales(self) -> list[tuple[int, str]]:
        """Scales that make all readings usual temperatures, the likeliest first."""
        possible = []
        scales = SCALES_DEGF if self.unit == "degF" else SCALES
        for divisor, unit in scales:
            low, high = in_degC(self.limits / divisor, unit)
            if low >= USUAL_LOWEST_DEGC and high <= USUAL_HIGHEST_DEGC:
                first = in_degC(np.array([self.first / divisor]), unit)
                possible.append((float(abs(first[0] - ROOM_DEGC)), divisor, unit))
        return [(divisor, unit) for _, divisor, unit in sorted(possible)[:LISTED]]

    def _scale_text(self, divisor: int, unit: str) -> str:
        """A scale, with the temperatures that it gives."""
        if unit == "mV":
            return f"{1 / divisor:g} mV"
        low, high = in_degC(self.limits / divisor, unit)
        return f"{1 / divisor:g} {unit} ({low:.1f} to {high:.1f} degC)"


def in_degC(values: Array, unit: str) -> Array:
    """Temperatures in degC, K or degF as degrees Celsius."""
    if unit == "K":
        return values - ZERO_DEGC_K
    return (values - 32) / 1.8 if unit == "degF" else values


def _range_of(unit: str) -> tuple[float, float]:
    """Range of a thermocouple in a unit; of a voltage: type E, the most sensitive one [mV]."""
    if unit == "K":
        return 0.0, HIGHEST_DEGC + ZERO_DEGC_K
    if unit == "degF":
        return 1.8 * LOWEST_DEGC + 32, 1.8 * HIGHEST_DEGC + 32
    if unit == "mV":
        return -10.0, 77.0
    return LOWEST_DEGC, HIGHEST_DEGC
