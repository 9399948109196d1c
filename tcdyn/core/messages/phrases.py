"""Parts of messages: a location in a log, a count with its noun, a rounded number.

Used by the other modules of ``tcdyn.core.messages``, and ``text_rounded_to_u`` by
``tcdyn.workflows``. Guarded by the doctests.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

# A template, or a function of the fields of a finding that gives its text.
Message = str | Callable[..., str]


def location_text(
    subject: str = "",
    row: int | None = None,
    time_s: float | None = None,
    file: str = "",
    **_: Any,
) -> str:
    """Location in a log: column, row and time, as far as given.

    Parameters
    ----------
    subject
        Column; empty if there is none.
    row
        Row of the file.
    time_s
        Time of the sample [s].
    file
        Name of the file, where the log has several.
    **_
        Other numbers of a finding, which are not used.

    Examples
    --------
    >>> location_text("a_degC", 9, 0.04), location_text("a_degC", 9), location_text(row=9)
    ('column a_degC, row 9 (0.04 s)', 'column a_degC, row 9', 'row 9')
    """
    parts = []
    if subject:
        parts.append(f"column {subject}")
    if row is not None:
        parts.append(f"row {row} of {file}" if file else f"row {row}")
    text = ", ".join(parts)
    return text if time_s is None else f"{text} ({time_s:.6g} s)"


def count_with_noun(count: int, noun: str) -> str:
    """A count with its noun, in the plural where needed.

    Parameters
    ----------
    count
        The count.
    noun
        The noun in the singular; its plural is with -s.

    Examples
    --------
    >>> count_with_noun(1, "spike"), count_with_noun(3, "spike")
    ('1 spike', '3 spikes')
    """
    return f"{count} {noun}" + ("" if count == 1 else "s")


def text_rounded_to_u(x: float | None, u: float) -> str:
    """Text of a number with as many decimals as two digits of its standard uncertainty have.

    Parameters
    ----------
    x
        The number; None, an open end of an interval, is "open".
    u
        Standard uncertainty, above zero.

    Examples
    --------
    >>> text_rounded_to_u(0.70151, 0.0042), text_rounded_to_u(None, 1.0)
    ('0.7015', 'open')
    """
    if x is None:
        return "open"
    decimals = max(0, 1 - math.floor(math.log10(u)))
    return f"{x:.{decimals}f}"
