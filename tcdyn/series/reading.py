"""Which values of a column are readings, and why the others are none.

This is the only place that decides about values before the chain of a sensor is known: every
command asks :func:`reasons_of`. What a chain cannot produce is decided later
(``tcdyn.series.plausible.impossible_changes``). Tests: ``tests/series/test_reading.py``.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from tcdyn.core import Array
from tcdyn.series.plausible import MAX_CODES, dropout_codes, out_of_range, overload_limit

Reasons = NDArray[np.uint8]

# Values of ``Reasons``.
READING = 0
EMPTY = 1
RANGE = 2
CODE = 3
REPEAT = 4
# Largest and smallest number of 16 bits in loggers that count in units, tenths and hundredths: a
# channel without a sensor, or beyond its range.
OVERFLOWS = np.array([32767.0, 32768.0, 3276.7, 3276.8, 327.67, 327.68])
SAME_OVERFLOW = 1e-6  # rounding of the conversion of units
REASON_NAMES = {EMPTY: "empty", RANGE: "range", CODE: "code", REPEAT: "repeat"}


class Kind(StrEnum):
    """What a column holds, which decides how its values may be judged."""

    TEMPERATURE = "temperature"  # of a thermocouple or the like [degC]
    QUANTITY = "quantity"  # any other reading
    INPUT = "input"  # set by somebody: short states are no drop-outs


@dataclass(frozen=True)
class Codes:
    """Values of a column that are codes of the logger.

    Attributes
    ----------
    values
        Drop-out codes.
    beyond
        Magnitude above which any value is an overload code; negative where nothing is known.
    """

    values: tuple[float, ...] = ()
    beyond: float = -np.inf

    def joined(self, other: Codes) -> Codes:
        """The codes of two parts of a column; the larger part decides what is an overload."""
        values = tuple(sorted({*self.values, *other.values}))
        return Codes(values, max(self.beyond, other.beyond))


def find_codes(values: Array, kind: Kind) -> Codes:
    """Find the codes of a column.

    Parameters
    ----------
    values
        Values (N,), NaN where there is no number; temperatures in degC.
    kind
        What the column holds.

    Notes
    -----
    The limits of a register of 16 bits (``OVERFLOWS``) are codes where all readings are such, also
    if a temperature may have these values. A drop-out code is isolated and recurs
    (``tcdyn.series.plausible.dropout_codes``); so are values beyond the range of a thermocouple
    where they are at most ``MAX_CODES`` different ones.

    Examples
    --------
    >>> y = 40 + np.sin(np.arange(100.0))
    >>> y[[10, 40, 70]] = 85.0
    >>> find_codes(y, Kind.TEMPERATURE).values
    (85.0,)
    """
    finite = np.where(np.isfinite(values), values, np.nan)
    beyond = np.inf
    outside = np.empty(0)
    if kind is Kind.TEMPERATURE:
        is_outside = out_of_range(finite)
        outside = np.unique(finite[is_outside])
        if len(outside) > MAX_CODES:  # so many different values are no codes
            outside = np.empty(0)
        possible = np.where(is_outside, np.nan, finite)
    else:
        beyond = overload_limit(finite)
        possible = np.where(np.abs(finite) > beyond, np.nan, finite)
    if kind is Kind.INPUT:
        return Codes((), beyond)
    overflow = _overflow_codes(finite, kind)
    if overflow:
        return Codes(overflow, beyond)
    is_code = dropout_codes(possible, kind is Kind.TEMPERATURE)
    codes = np.concatenate([outside, np.unique(possible[is_code])])
    return Codes(tuple(np.sort(codes).tolist()), beyond)


def _overflow_codes(finite: Array, kind: Kind) -> tuple[float, ...]:
    """The values of a column that holds nothing but the limits of a register of 16 bits.

    Parameters
    ----------
    finite
        Values (N,), NaN where there is no number; temperatures in degC.
    kind
        What the column holds: of temperatures, the logger may have written degF.

    Examples
    --------
    >>> _overflow_codes(np.array([327.67, np.nan, 327.67]), Kind.QUANTITY)
    (327.67,)
    >>> _overflow_codes(np.array([327.67, 20.0]), Kind.QUANTITY)
    ()
    """
    values = np.unique(finite[np.isfinite(finite)])
    if not 0 < len(values) <= MAX_CODES:
        return ()
    limits = np.concatenate([OVERFLOWS, -OVERFLOWS])
    if kind is Kind.TEMPERATURE:
        limits = np.concatenate([limits, (limits - 32) / 1.8])
    distances = np.abs(values[:, np.newaxis] - limits)
    return tuple(values.tolist()) if (distances.min(axis=1) < SAME_OVERFLOW).all() else ()


def reasons_of(values: Array, kind: Kind, codes: Codes | None = None) -> Reasons:
    """Why each value of a column is no reading.

    Parameters
    ----------
    values
        Values (N,), NaN where there is no number; temperatures in degC.
    kind
        What the column holds.
    codes
        Its codes; None: those in these values.

    Returns
    -------
    array
        ``READING``, ``EMPTY``, ``RANGE`` or ``CODE`` for each value (N,).

    Examples
    --------
    >>> reasons_of(np.array([20.0, np.nan, 1e5, np.inf]), Kind.TEMPERATURE).tolist()
    [0, 1, 3, 3]
    """
    known = find_codes(values, kind) if codes is None else codes
    reasons = np.full(len(values), READING, dtype=np.uint8)
    with np.errstate(invalid="ignore"):
        is_code = np.isinf(values)
        if known.beyond > 0:
            is_code |= np.abs(values) > known.beyond
    for code in known.values:
        is_code |= values == code
    if kind is Kind.TEMPERATURE:
        reasons[out_of_range(values)] = RANGE
    reasons[is_code] = CODE
    reasons[np.isnan(values)] = EMPTY
    return reasons
