"""How the rows of a table are read: the options that every command and function shares.

Tests: ``tests/cli/test_reading_options.py`` and ``tests/series/test_source.py``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from tcdyn.core.errors import InputError

# Intervals beyond which a number is a mistake: faster than any logger, and 300 years.
SHORTEST_S = 1e-10
LONGEST_S = 1e10


@dataclass(frozen=True)
class ReadingOptions:
    """How the rows of a table are read, where the table does not say it itself.

    Attributes
    ----------
    time
        column of the time, if its name does not say so
    time_unit
        its unit (s, ms, us, ns, min, h, days, HHMM or HHMMSS), if its name does not state it
    dt_s
        sampling interval of the rows [s]; without {time} no column of time is read
    where
        only the rows with this cell, as COLUMN=VALUE: one channel of a table of several
    on_change
        rows are written when a reading has changed by this dead band, in its unit; it is recognised
        from the readings if it is not given
    averages_s
        each row is the mean of the readings over this time before it [s]
    sheet
        sheet of an .xlsx workbook, if it has several with tables
    variable
        variable of a .mat file with the table, such as log or log.data
    """

    time: str | None = None
    time_unit: str | None = None
    dt_s: float | None = None
    where: str | None = None
    on_change: float | None = None
    averages_s: float | None = None
    sheet: str | None = None
    variable: str | None = None

    def __post_init__(self) -> None:
        """Check the numbers, and that a condition has a column and a value.

        Raises
        ------
        InputError
            For an interval, a dead band or an averaging time that is not positive, and for a
            condition without "=".
        """
        for name in ("dt_s", "averages_s"):
            value = getattr(self, name)
            if value is not None and not SHORTEST_S < value < LONGEST_S:
                raise InputError(
                    f"{{{name}}} is {value:g}",
                    expected="a number above zero",
                    parameters={name: None},
                )
        if self.on_change is not None and not 0 <= self.on_change < float("inf"):
            raise InputError(
                f"{{on_change}} is {self.on_change:g}",
                expected="a dead band, or 0 for a reading that is held",
                parameters={"on_change": None},
            )
        if self.where is not None and not self.condition[0]:
            raise InputError(
                f"{{where}} {self.where}",
                expected="COLUMN=VALUE",
                parameters={"where": None},
            )

    @classmethod
    def split(cls, options: Mapping[str, Any]) -> tuple[ReadingOptions, dict[str, Any]]:
        """Options of the reader among keyword arguments, and the other ones.

        >>> ReadingOptions.split({"time": "t", "unit": "K"})[1]
        {'unit': 'K'}
        """
        names = [each.name for each in fields(ReadingOptions)]
        own = {name: options[name] for name in names if name in options}
        others = {name: value for name, value in options.items() if name not in names}
        return ReadingOptions(**own), others

    @property
    def condition(self) -> tuple[str, str]:
        """Column and cell of ``where``; two empty texts without "=".

        >>> ReadingOptions(where="Channel = CH 1").condition
        ('Channel', 'CH 1')
        """
        column, equals, value = (self.where or "").partition("=")
        if not equals:
            return "", ""
        return column.strip(), value.strip()
