"""Date and time of the first row of a table, for its metadata.

Columns of time are read as seconds since the first row (``tcdyn.io.times``); this is when that row
was. Used by ``tcdyn.workflows.compensate_table`` and ``tcdyn.rig.log``. Guarded by
``tests/io/test_start_time.py``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tcdyn.core import Array
from tcdyn.io.stamps import ORDERS, instant_of, is_date, is_time_of_day

# dates with dots have the day first where nothing else tells the order
_WITH_DOTS = re.compile(r"\s*'?\d{1,2}\.\d{1,2}\.")
# largest difference [s] of two intervals that are equal, for stamps of whole seconds
SAME_INTERVAL_S = 1.0


def start_time(cells: Mapping[str, NDArray[Any]], time: str, times_s: Array) -> str:
    """Date and time of the first row in ISO 8601, with the zone if the table states one.

    Parameters
    ----------
    cells
        Columns (N,) of text as in the file, or of anything else, by name.
    time
        Name of the column of time.
    times_s
        Times (N,) [s] that were read from it.

    Returns
    -------
    str
        Empty if the column of time holds numbers or times without a date, or if the date can be
        read in two ways.

    Notes
    -----
    The order of day and month is the one in which the first and the last stamp are as far apart as
    ``times_s``; dates with dots have the day first where this leaves several. The date of a time of
    day may be in another column.

    Examples
    --------
    >>> stamps = np.array(["28/02/2026 23:59:59", "01/03/2026 00:00:00"], dtype=object)
    >>> start_time({"when": stamps}, "when", np.array([0.0, 1.0]))
    '2026-02-28T23:59:59'
    """
    texts = cells.get(time)
    if texts is None or texts.dtype != object or not len(texts):
        return ""
    first = str(texts[0])
    last = str(texts[-1])
    if is_time_of_day(first):
        date = _date_column(cells, time)
        if date is None:
            return ""
        first = f"{date[0]} {first}"
        last = f"{date[-1]} {last}"
    starts = {order: instant_of(first, order) for order in ORDERS}
    parsed = {order: start for order, start in starts.items() if start is not None}
    if len(set(parsed.values())) > 1:
        interval_s = float(times_s[-1] - times_s[0])
        parsed = {
            order: start
            for order, start in parsed.items()
            if _is_later_by(interval_s, start, instant_of(last, order))
        }
    if _WITH_DOTS.match(first) and "dmy" in parsed:
        return parsed["dmy"].isoformat()
    distinct = set(parsed.values())
    return distinct.pop().isoformat() if len(distinct) == 1 else ""


def _date_column(cells: Mapping[str, NDArray[Any]], time: str) -> NDArray[Any] | None:
    """The column of dates; None if there is none, or several."""
    columns = [
        texts
        for name, texts in cells.items()
        if name != time and texts.dtype == object and len(texts) and is_date(str(texts[0]), name)
    ]
    return columns[0] if len(columns) == 1 else None


def _is_later_by(interval_s: float, first: datetime, last: datetime | None) -> bool:
    """Whether the second instant is so much later than the first."""
    if last is None or (first.tzinfo is None) != (last.tzinfo is None):
        return False
    return bool(np.isclose((last - first).total_seconds(), interval_s, atol=SAME_INTERVAL_S))
