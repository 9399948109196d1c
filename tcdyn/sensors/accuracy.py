"""Accuracy of an instrument as its maker states it: limits of one error of a whole log.

Used by :mod:`tcdyn.sensors.channels`. Guarded by ``tests/sensors/test_accuracy.py``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.io.unit_names import written_unit
from tcdyn.series.units import Unit, match_columns

# Limits without more knowledge: a rectangular distribution (GUM 4.3.7)
LIMITS = np.sqrt(3.0)
NUMBER = r"([0-9]*\.?[0-9]+(?:[eE][+-]?[0-9]+)?)\s*"
TERM = re.compile(rf"^(?:\+-|±)?\s*{NUMBER}(%|[^\s0-9+.%][^\s+%]*)?$")
# Units of differences of temperatures, per kelvin
PER_KELVIN = {"K": 1.0, "degC": 1.0, "mK": 1e3, "degF": 1.8}
# What a caller may give for the accuracies of a table
Stated = float | str | Sequence[str] | Mapping[str, float | str]
LARGEST_SHARE = 1.0  # of a reading: more is a mistake


@dataclass(frozen=True)
class Accuracy:
    """Limits of the error of an instrument.

    Attributes
    ----------
    limit
        Limit in the base unit of the column: K for temperatures.
    share
        Limit as a share of the reading: of temperatures in degC, whatever the unit of the column,
        as makers mean it.
    """

    limit: float
    share: float

    @classmethod
    def of(cls, text: str, unit: Unit) -> Accuracy:
        """From a text such as "0.5 K", "1.5 %" or "0.5 K + 0.1 %".

        Parameters
        ----------
        text
            The text; a number without a unit is in the unit of the column.
        unit
            Unit of the column.

        Raises
        ------
        InputError
            For another text, or another unit than that of the column.

        Examples
        --------
        >>> Accuracy.of("0.5 K + 0.1 %", Unit("degC"))
        Accuracy(limit=0.5, share=0.001)
        """
        limit = 0.0
        share = 0.0
        with_points = text.strip().replace(",", ".")
        terms = re.split(r"\s*\+(?!-)\s*", with_points.removeprefix("+ "))
        for term in terms:
            match = TERM.match(term.strip())
            if match is None or (match[2] == "%" and float(match[1]) > 100 * LARGEST_SHARE):
                raise InputError(
                    f"an accuracy of {text!r}",
                    expected='"0.5 K", "1.5 %", or the sum of both: "0.5 K + 0.1 %"',
                    parameters={"accuracy": None},
                )
            number = float(match[1])
            if match[2] == "%":
                share += number / 100
            else:
                limit += number / _per_base(match[2] or "", unit)
        return cls(limit, share)

    def u(self, base: Array) -> Array:
        """Standard uncertainty of readings of any shape, in the base unit.

        Parameters
        ----------
        base
            The readings in the base unit.
        """
        return np.asarray((self.limit + self.share * np.abs(base)) / LIMITS)

    @property
    def gain_u_rel(self) -> float:
        """Relative standard uncertainty of a difference of readings."""
        return self.share / float(LIMITS)


def _per_base(name: str, unit: Unit) -> float:
    """Units of a limit per base unit of a column."""
    if not name:
        return unit.per_base
    written = written_unit(name) or name
    if unit.is_temperature and written in PER_KELVIN:
        return PER_KELVIN[written]
    if not unit.is_temperature and written == (written_unit(unit.name) or unit.name):
        return 1.0
    raise InputError(
        f"an accuracy in {name}",
        expected=f"{unit.difference} or %",
        parameters={"accuracy": None},
    )


def accuracy_by_column(stated: Stated, units: dict[str, Unit], where: str) -> dict[str, Accuracy]:
    """Accuracy of each column: of all, or of one by its name.

    Parameters
    ----------
    stated
        A text or a number for all columns; several texts, of which COLUMN=ACCURACY is that of one
        and another one that of the rest; or a dict by column.
    units
        Units by column.
    where
        The table, in messages.

    Raises
    ------
    InputError
        For a column without a sensor, and for a text that is no accuracy.

    Examples
    --------
    >>> accuracy_by_column(["1 K", "b=2 K"], {"a": Unit(), "b": Unit()}, "log")["b"].limit
    2.0
    """
    listed = _pairs(stated)
    of_all = [text for column, text in listed if not column]
    named: dict[str, str] = {}
    for pattern, text in listed:
        for column in match_columns(pattern, list(units), where) if pattern else []:
            if column in named:
                raise InputError(
                    f"two accuracies of column {column}",
                    where=where,
                    expected="one",
                    parameters={"accuracy": None},
                )
            named[column] = text
    if len(of_all) > 1:
        raise InputError(
            f"accuracies of {' and '.join(of_all)} for all columns",
            where=where,
            expected="one, and others as COLUMN=ACCURACY",
            parameters={"accuracy": None},
        )
    by_column = {}
    for column, unit in units.items():
        own = [named[column]] if column in named else of_all
        if not own:
            continue
        try:
            by_column[column] = Accuracy.of(own[0], unit)
        except InputError as problem:
            raise problem.at(f"{where}: column {column}") from None
    return by_column


def _pairs(stated: Stated) -> list[tuple[str, str]]:
    """Pairs of column and accuracy; the column is empty for all columns."""
    if isinstance(stated, Mapping):
        return [(str(column), str(text)) for column, text in stated.items()]
    listed = stated if isinstance(stated, list | tuple) else [stated]
    pairs = []
    for text in listed:
        column, _, accuracy = str(text).rpartition("=")
        pairs.append((column.strip(), accuracy))
    return pairs
