"""The columns of a table of a frequency response, in Hz, plain magnitude and degrees.

What a column holds follows from its header, the row of units below it, and the caller, who must not
contradict the file. ``tcdyn.identification.frequency.Response.read`` uses it. Guarded by
``tests/identify/test_response_table.py``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

import numpy as np

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, info
from tcdyn.io.response_units import (
    FREQUENCY_UNITS,
    PHASE_UNITS,
    Kind,
    ResponseUnit,
    bracketed_text,
    is_angular,
    is_logarithm,
    is_real_and_imaginary,
    response_unit,
    unit_of_column,
)
from tcdyn.io.times import split_unit
from tcdyn.io.unit_names import SECONDS_PER_UNIT

Form = Literal["magnitude", "dB", "complex"]

# Phases without a unit that all lie within one turn in radians may be in radians or in degrees.
LARGEST_RADIANS = 2 * np.pi
SAME_UNIT = 1e-9  # relative difference of two factors of one unit, which is rounding
# What the columns of a form must not be in, and how the message calls it.
KIND_NAMES = {
    "frequency": "a frequency",
    "rate": "a frequency",
    "angle": "an angle",
    "level": "a level",
    "percent": "a share",
    "unclear": "a unit of two meanings",
}


@dataclass(frozen=True)
class ResponseColumns:
    """The columns of a frequency response, and what the file and the caller say about them.

    Parameters
    ----------
    where
        The file, for messages.
    frequency
        Column of the frequency.
    pair
        Columns of magnitude and phase, or of the real and the imaginary part.
    u, coherence
        Columns of the uncertainty and of the coherence.
    form, frequency_unit, phase_unit
        As the caller states them; None to take them from the file.
    unit_row
        Units from a row below the header, by column.
    """

    where: str
    frequency: str
    pair: tuple[str, str]
    u: str | None = None
    coherence: str | None = None
    form: str | None = None
    frequency_unit: str | None = None
    phase_unit: str | None = None
    unit_row: Mapping[str, str] = field(default_factory=dict)

    def converted(self, table: Mapping[str, Array]) -> tuple[dict[str, Array], list[Finding]]:
        """Return the columns in Hz, plain magnitude and degrees, and what was assumed.

        Parameters
        ----------
        table
            Values (F,) by the name of the column, as in the file.

        Returns
        -------
        arrays
            The arguments ``frequency_Hz``, ``magnitude``, ``phase_deg``, ``u`` and ``coherence`` of
            ``Response.of``; the last two only where there are such columns.
        findings
            An info that names the columns whose unit the file does not state.

        Raises
        ------
        InputError
            For a unit that is not known, may be two things, or contradicts the caller.
        """
        first, second = self.pair
        form, form_assumed = self._form()
        hz_per_unit, frequency_assumed = self._frequency_factor()
        arrays: dict[str, Any] = {"frequency_Hz": hz_per_unit * table[self.frequency]}
        assumed = dict(frequency_assumed)
        scale = 1.0
        if form == "complex":
            h = table[first] + 1j * table[second]
            arrays["magnitude"] = np.abs(h)
            arrays["phase_deg"] = np.angle(h, deg=True)
        else:
            assumed |= form_assumed
            unit = self._unit(first, "level")
            magnitude = table[first]
            if form == "dB":
                dB_per_unit = unit.factor if unit is not None else 1.0
                arrays["magnitude"] = 10 ** (dB_per_unit * magnitude / 20)
            else:
                scale = unit.factor if unit is not None and unit.kind == "percent" else 1.0
                arrays["magnitude"] = scale * magnitude
            degrees_per_unit, phase_assumed = self._phase_factor(table[second])
            assumed |= phase_assumed
            arrays["phase_deg"] = degrees_per_unit * table[second]
        if self.u is not None:
            arrays["u"] = self._plain_factor(self.u, scale) * table[self.u]
        if self.coherence is not None:
            arrays["coherence"] = self._plain_factor(self.coherence, 1.0) * table[self.coherence]
        findings = []
        if assumed:
            columns = [f"{name} in {unit}" for name, unit in assumed.items()]
            findings.append(info("response.unit_assumed", subject=", ".join(columns)))
        return arrays, findings

    def _unit(self, column: str, preferred: Kind) -> ResponseUnit | None:
        """Return the unit of a column from its name, or from the row below; None if unknown."""
        return unit_of_column(column, preferred) or response_unit(
            self.unit_row.get(column, ""), preferred
        )

    def _unit_text(self, column: str) -> str:
        """Return what stands in the place of a unit, in brackets or below the header."""
        return bracketed_text(column) or self.unit_row.get(column, "")

    def _form(self) -> tuple[Form, dict[str, str]]:
        """Return the form of the pair of columns, and the columns whose form is assumed.

        Raises
        ------
        InputError
            Where the header contradicts the form, or names a logarithm without its unit.
        """
        first, second = self.pair
        unit = self._unit(first, "level")
        kind = unit.kind if unit is not None else ""
        if self.form is not None and self.form not in get_args(Form):
            raise InputError(
                f"form {self.form!r}", where=self.where, expected=" or ".join(get_args(Form))
            )
        if unit is not None and kind not in ("level", "percent"):
            raise InputError(
                f"column {first!r} is in {unit.text}, {KIND_NAMES[kind]}",
                where=self.where,
                expected="the magnitude first, plain or in dB, then the phase",
            )
        header_form: Form | None = None
        if is_real_and_imaginary(first, second):
            header_form = "complex"
        elif kind == "level":
            header_form = "dB"
        elif kind or self._unit_text(first):
            header_form = "magnitude"
        angle = self._unit(second, "angle")
        if header_form is None and self.form == "complex" and angle is not None:
            header_form = "magnitude"
        # any unit of the plant may stand behind a real part
        is_plain_complex = self.form == "complex" and header_form == "magnitude" and angle is None
        if self.form is None:
            if header_form is None and is_logarithm(first):
                raise self._request(first, "a logarithm of unknown unit", "form", "dB")
            if header_form is None:
                return "magnitude", {first: "plain numbers (not dB)"}
            return header_form, {}
        if header_form not in (None, self.form) and not is_plain_complex:
            raise self._contradiction(f"{first} and {second}", header_form, "form", self.form)
        return self.form, {}  # type: ignore[return-value]

    def _frequency_factor(self) -> tuple[float, dict[str, str]]:
        """Return the Hz in one unit of the frequency, and the unit that is assumed, by column.

        Raises
        ------
        InputError
            Where the unit is not known, may be two things, or contradicts the caller.
        """
        name = self.frequency
        if is_logarithm(name):
            raise InputError(
                f"column {name!r} is a logarithm", where=self.where, expected="the frequency itself"
            )
        unit = self._unit(name, "frequency")
        stated = None
        if self.frequency_unit is not None:
            stated = response_unit(self.frequency_unit)
            if stated is None or stated.kind != "frequency":
                raise InputError(
                    f"frequency unit {self.frequency_unit!r}",
                    where=self.where,
                    expected=" or ".join(FREQUENCY_UNITS),
                )
        if unit is not None and unit.kind not in ("frequency", "rate", "unclear"):
            raise InputError(
                f"column {name!r} is in {unit.text}, {KIND_NAMES[unit.kind]}",
                where=self.where,
                expected="the column of the frequency",
            )
        if stated is not None:
            differs = False
            if unit is not None and unit.kind == "frequency":
                differs = abs(unit.factor / stated.factor - 1) > SAME_UNIT
            if unit is not None and differs:
                request = str(self.frequency_unit)
                raise self._contradiction(name, unit.text, "frequency_unit", request)
            return stated.factor, {}
        if unit is None:
            return self._unstated_frequency()
        has_two_meanings = unit.kind == "unclear" or (unit.kind == "rate" and not is_angular(name))
        if has_two_meanings:
            meaning = "mHz or MHz" if unit.kind == "unclear" else "turns or radians"
            raise self._request(name, f"its unit {unit.text!r} may mean {meaning}")
        if unit.kind == "rate":
            return unit.factor / (2 * np.pi), {}
        is_radian = "rad" in unit.text.lower()
        if is_angular(name) and not is_radian:
            raise self._request(name, f"an angular frequency in {unit.text}")
        return unit.factor, {}

    def _unstated_frequency(self) -> tuple[float, dict[str, str]]:
        """Return factor and assumed unit of a frequency whose header has no known unit."""
        name = self.frequency
        text = self._unit_text(name)
        if not text and split_unit(name)[1].lower() in SECONDS_PER_UNIT:
            text = split_unit(name)[1]
        if text:
            raise self._request(name, f"its unit {text!r} is not one of a frequency")
        if is_angular(name):
            return 1 / (2 * np.pi), {name: "rad/s"}
        return 1.0, {name: "Hz"}

    def _phase_factor(self, values: Array) -> tuple[float, dict[str, str]]:
        """Return the degrees in one unit of the phase, and the unit that is assumed, by column.

        Parameters
        ----------
        values
            Phases (F,) as in the file.

        Raises
        ------
        InputError
            Where the unit is not known, cannot be told, or contradicts the caller.
        """
        name = self.pair[1]
        unit = self._unit(name, "angle")
        stated = None
        if self.phase_unit is not None:
            stated = response_unit(self.phase_unit, "angle")
            if stated is None or stated.kind != "angle":
                raise InputError(
                    f"phase unit {self.phase_unit!r}",
                    where=self.where,
                    expected=" or ".join(PHASE_UNITS),
                )
        if unit is not None and unit.kind != "angle":
            raise InputError(
                f"column {name!r} is in {unit.text}, {KIND_NAMES[unit.kind]}",
                where=self.where,
                expected="the phase",
            )
        if stated is not None:
            differs = unit is not None and abs(unit.factor / stated.factor - 1) > SAME_UNIT
            if unit is not None and differs:
                raise self._contradiction(name, unit.text, "phase_unit", str(self.phase_unit))
            return stated.factor, {}
        if unit is not None:
            return unit.factor, {}
        text = self._unit_text(name)
        if text:
            raise self._request(name, f"its unit {text!r} is not one of an angle", "phase_unit")
        largest = float(np.max(np.abs(values), initial=0.0))
        if 0 < largest <= LARGEST_RADIANS:
            problem = f"no unit is stated, and a phase of {largest:.3g} may be degrees or radians"
            raise self._request(name, problem, "phase_unit")
        return 1.0, {name: "degrees"}

    def _plain_factor(self, column: str, scale: float) -> float:
        """Return the factor of an uncertainty or a coherence, which may be in percent.

        Parameters
        ----------
        column
            The column.
        scale
            Factor of the magnitude, in whose unit the column is.

        Raises
        ------
        InputError
            For decibels and other units that are not those of a complex number.
        """
        unit = self._unit(column, "level")
        if unit is None:
            return scale
        is_percent = unit.kind == "percent"
        if not is_percent or (column == self.u and scale == 1.0):
            raise InputError(
                f"column {column!r} is in {unit.text}",
                where=self.where,
                expected="the unit of the magnitude, for the real and the imaginary part",
            )
        return unit.factor

    def _request(
        self, column: str, problem: str, parameter: str = "frequency_unit", value: str = "UNIT"
    ) -> InputError:
        """Return an error that asks for a unit, with the problem."""
        units = {"frequency_unit": FREQUENCY_UNITS, "phase_unit": PHASE_UNITS}
        return InputError(
            f"column {column!r}: {problem}",
            where=self.where,
            expected=" or ".join(units.get(parameter, get_args(Form))),
            remedy=f"name it, {{{parameter}}}",
            parameters={parameter: value},
        )

    def _contradiction(
        self, column: str, unit: str | None, parameter: str, value: str
    ) -> InputError:
        """Return an error that names the unit of the header and that of the caller."""
        return InputError(
            f"the header of {column} says {unit}, but {{{parameter}}}",
            where=self.where,
            expected="the unit of the header",
            remedy="leave the option out, or correct the header",
            parameters={parameter: value},
        )
