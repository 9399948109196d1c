"""Parts of messages: a location in a log, a count with its noun, a number rounded to its uncertainty."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

Message = str | Callable[..., str]


def location_text(
    subject: str = "", row: int | None = None, time_s: float | None = None, **_: Any
) -> str:
    """Location in a log: column, row and time, as far as given.

    >>> location_text("a_degC", 9, 0.04), location_text("a_degC", 9), location_text(row=9)
    ('column a_degC, row 9 (0.04 s)', 'column a_degC, row 9', 'row 9')
    """
    parts = [
        *([f"column {subject}"] if subject else []),
        *([f"row {row}"] if row is not None else []),
    ]
    return ", ".join(parts) + (f" ({time_s:.6g} s)" if time_s is not None else "")


def count_with_noun(count: int, noun: str) -> str:
    """A count with its noun, in the plural where needed.

    >>> count_with_noun(1, "spike"), count_with_noun(3, "spike")
    ('1 spike', '3 spikes')
    """
    return f"{count} {noun}" + ("" if count == 1 else "s")


def rounded_to_u(x: float | None, u: float) -> str:
    """``x`` with the decimals that two digits of the standard uncertainty ``u`` have; None is "open".

    >>> rounded_to_u(0.70151, 0.0042), rounded_to_u(None, 1.0)
    ('0.7015', 'open')
    """
    return "open" if x is None else f"{x:.{max(0, 1 - math.floor(math.log10(u)))}f}"
