"""Options of the history of a lag, for the command and the functions.

See :mod:`tcdyn.core.options`. Tests: ``tests/sensors/test_history.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

from tcdyn.core.errors import InputError
from tcdyn.core.options import Options, option
from tcdyn.rig.record import parse_time


@dataclass(frozen=True)
class HistoryOptions(Options):
    """Which column, and when it was measured.

    Attributes
    ----------
    column
        column of the sensor (default: the only one)
    dates
        date of a measurement, as 2025-03-01 or 2025-03-01T14:00; repeat it for each, in their order
        (default: date of the first row of each log)
    """

    column: str | None = option(None, "Input")
    dates: Sequence[str] = option((), "Input", takes=list[str])

    @property
    def given_dates(self) -> list[datetime]:
        """The dates; without a zone they are taken as UTC.

        Raises
        ------
        InputError
            For a text that is no date.
        """
        dates = []
        for text in self.dates:
            try:
                dates.append(parse_time(text))
            except (TypeError, ValueError):
                raise InputError(
                    f"{{dates}} is {text!r}",
                    expected="a date such as 2025-03-01 or 2025-03-01T14:00",
                    parameters={"dates": None},
                ) from None
        return dates
