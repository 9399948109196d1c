"""Columns of text as numbers: clock times to seconds, on/off words to 1 and 0, the rest to NaN with a note."""

from __future__ import annotations

import numpy as np
import pandas as pd

from calibration.dialect import ABSENT, CLOCK, FLAGS, is_number
from calibration.errors import InputError
from calibration.table import FloatArray, RowNumbers


def text_column(
    texts: list[str], decimal: str, name: str, where: str, rows: RowNumbers, notes: list[str]
) -> FloatArray:
    """Numbers from cells of text: clock times to seconds, on/off words to 1 and 0, the rest to NaN with a note.

    Raises InputError when more than one cell in a hundred (and more than three) is no number.
    """
    full = [t for t in texts if t.lower() not in ABSENT]
    if full and sum(CLOCK.fullmatch(t) is not None for t in full) > 0.5 * len(full):
        return clock_seconds(texts, name, where, rows, notes)
    out = np.full(len(texts), np.nan)
    bad: list[int] = []
    for i, text in enumerate(texts):
        low = text.lower()
        if is_number(text, decimal):
            out[i] = float(text.replace(",", "."))
        elif low in FLAGS:
            out[i] = FLAGS[low]
        elif low not in ABSENT:
            bad.append(i)
        elif "inf" in low:
            out[i] = np.inf
    if bad:
        place = f"column {name}, row {rows.of(bad[0])}: {texts[bad[0]][:40]!r} is no number"
        if len(bad) > max(3, 0.01 * len(texts)):
            raise InputError(
                f"{place} ({len(bad)} of {len(texts)} cells)",
                where=where,
                expected=f"numbers with decimal {'comma' if decimal == ',' else 'point'}",
            )
        notes.append(f"{place}" + (f" (and {len(bad) - 1} more)" if len(bad) > 1 else "") + "; taken as missing")
    return out


def clock_seconds(texts: list[str], name: str, where: str, rows: RowNumbers, notes: list[str]) -> FloatArray:
    """Clock times (with or without a date) as seconds since the first one; midnight may pass.

    >>> clock_seconds(["23:59:59.5", "00:00:00,25"], "time", "x.csv", RowNumbers(), [])
    array([0.  , 0.75])
    """
    series = pd.Series(texts, dtype="str").str.replace(",", ".", regex=False)
    parts = series.str.extract(r"(?P<h>\d{1,2}):(?P<m>\d\d):(?P<s>\d\d(?:\.\d+)?)\s*(?P<half>AM|PM)?")
    hour = pd.to_numeric(parts["h"]).to_numpy(dtype=float)
    afternoon = (parts["half"] == "PM").to_numpy(dtype=bool)
    morning = (parts["half"] == "AM").to_numpy(dtype=bool)
    hour = np.where(afternoon | morning, hour % 12, hour) + 12.0 * afternoon
    minute = pd.to_numeric(parts["m"]).to_numpy(dtype=float)
    second = hour * 3600 + minute * 60 + pd.to_numeric(parts["s"]).to_numpy(dtype=float)
    if not np.isfinite(second[0]):
        raise InputError(f"column {name}, row {rows.of(0)}: {texts[0]!r} is no clock time", where=where)
    steps = np.diff(second, prepend=second[0])
    wraps = np.cumsum(np.where(steps < -43200.0, 1.0, 0.0))
    if wraps[-1]:
        notes.append(f"column {name}: the clock passes midnight; the time runs on")
    return np.asarray(np.round(second + 86400.0 * wraps - second[0], 9))
