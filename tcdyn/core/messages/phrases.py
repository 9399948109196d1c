"""How a finding's words are made: a place in a log, a count with its noun."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

Words = str | Callable[..., str]


def place(subject: str = "", row: int | None = None, time_s: float | None = None, **_: Any) -> str:
    """Where in a log: column, row and, in a trace, time.

    >>> place("a_degC", 9, 0.04), place("a_degC", 9), place(row=9)
    ('column a_degC, row 9 (0.04 s)', 'column a_degC, row 9', 'row 9')
    """
    parts = [
        *([f"column {subject}"] if subject else []),
        *([f"row {row}"] if row is not None else []),
    ]
    return ", ".join(parts) + (f" ({time_s:.6g} s)" if time_s is not None else "")


def some(count: int, noun: str) -> str:
    """A count with its noun.

    >>> some(1, "spike"), some(3, "spike")
    ('1 spike', '3 spikes')
    """
    return f"{count} {noun}" + ("" if count == 1 else "s")


def as_known(x: float | None, u: float) -> str:
    """``x`` with the decimals that two digits of the standard uncertainty ``u`` have; None is "open".

    >>> as_known(0.70151, 0.0042), as_known(None, 1.0)
    ('0.7015', 'open')
    """
    return "open" if x is None else f"{x:.{max(0, 1 - math.floor(math.log10(u)))}f}"
