"""Clock stamps of a column as numbers of days, as spreadsheets store them.

The forms are those of :mod:`tcdyn.io.stamps`, and the first instant that of
:mod:`tcdyn.io.start_time`. Used by :mod:`tcdyn.io.xlsx`. Guarded by ``tests/io/test_xlsx.py``.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.io.stamps import SECONDS_PER_DAY, Stamps, is_date, is_stamp, is_time_of_day
from tcdyn.io.start_time import start_time

# A time of the day with hours, minutes and seconds and without a zone
_PLAIN_CLOCK = re.compile(
    r"\s*'?(?:[01]?\d|2[0-3]):\d\d:\d\d(?:[.,]\d+|:\d{3})?\s*(?:[AaPp]\.?\s?[Mm]\.?)?\s*"
)


@dataclass
class ClockCells:
    """Converts the clock stamps of a column, chunk by chunk.

    Attributes
    ----------
    stamps
        The state of the conversion.
    first
        Date and time of the first stamp, with the zone that it states; None for a column of times
        of the day.
    has_clock
        Whether the first stamp has a time of the day, and is no date alone.
    """

    stamps: Stamps
    first: pd.Timestamp | None
    has_clock: bool

    @classmethod
    def of(cls, name: str, cells: NDArray[Any]) -> ClockCells | None:
        """The converter of a column, from its first cells; None if they are no clock stamps.

        Parameters
        ----------
        name
            The column.
        cells
            Its first cells (N,) as text.

        Notes
        -----
        None also for dates that can be read in two ways, and for times of the day with a zone or
        without seconds.

        Examples
        --------
        >>> cells = np.array(["01.03.2026 10:00:00,5", "01.03.2026 10:00:02"], dtype=object)
        >>> clock = ClockCells.of("Zeit", cells)
        >>> clock.first, clock.seconds(cells)
        (Timestamp('2026-03-01 10:00:00.500000'), array([0. , 1.5]))
        """
        if not len(cells):
            return None
        first_text = str(cells[0])
        has_clock = is_stamp(first_text)
        if not has_clock and not is_date(first_text, name):
            return None
        probe = cls(Stamps(name, ""), None, has_clock)
        if is_time_of_day(first_text):
            is_plain = _PLAIN_CLOCK.fullmatch(first_text) is not None
            return probe if is_plain else None
        start = start_time({name: cells}, name, probe.seconds(cells))
        if not start:
            return None
        return cls(Stamps(name, ""), pd.Timestamp(start), has_clock)

    def seconds(self, cells: NDArray[Any]) -> Array:
        """Time (N,) since the first stamp [s]; NaN where a cell is no clock stamp."""
        texts = [str(cell) for cell in cells]
        try:
            return self.stamps.seconds(texts)
        except InputError:  # dates of two forms: the caller keeps the text
            return np.full(len(texts), np.nan)

    def days_from(self, epoch: pd.Timestamp, cells: NDArray[Any]) -> Array:
        """Time of the clock (N,) since an epoch [days]; times of the day count from midnight.

        Parameters
        ----------
        epoch
            The epoch, without a zone.
        cells
            Cells (N,) of the next rows.

        Returns
        -------
        days
            NaN where a cell is no clock stamp. All are of the clock and the zone of the first
            stamp, which is continued without changes to or from daylight saving time.
        """
        seconds = self.seconds(cells)
        if self.first is not None:
            clock_s = (self.first.tz_localize(None) - epoch).total_seconds()
            return np.asarray((clock_s + seconds) / SECONDS_PER_DAY)
        is_plain = [_PLAIN_CLOCK.fullmatch(str(cell)) is not None for cell in cells]
        of_day_s = (self.stamps.first_s + seconds) % SECONDS_PER_DAY
        return np.where(is_plain, of_day_s / SECONDS_PER_DAY, np.nan)

    def zone_text(self) -> str:
        """Zone of the clock and the changes of it, for people.

        >>> clock = ClockCells.of("t", np.array(["2026-03-01T10:00:00+01:00"], dtype=object))
        >>> clock.zone_text()
        'clock of UTC+01:00'
        """
        zone = "clock of the file, which states no time zone"
        if self.first is not None and self.first.tzinfo is not None:
            zone = f"clock of {self.first.tzname()}"
        if self.stamps.clock_changes:
            days = ", ".join(self.stamps.clock_changes)
            zone += f", continued without its change by one hour on {days}"
        return zone
