"""Columns of text as numbers: clock times to seconds, on/off words to 1 and 0, the rest to NaN with a note."""

from __future__ import annotations

import numpy as np
import pandas as pd

from calibration.errors import InputError
from calibration.files.dialect import ABSENT, CLOCK, FLAGS, is_number
from calibration.files.table import FloatArray, RowNumbers


class TextColumn:
    """A column of cells of text that comes in one piece or in many; what many give together is what one gives.

    Whether it holds clock times is seen from the first piece with anything in it; ``clock`` says so beforehand.
    Clock times, with or without a date, are seconds since the first one, and midnight may pass.

    >>> TextColumn("time", ".", "x.csv").numbers(["23:59:59.5", "00:00:00,25"], RowNumbers())
    array([0.  , 0.75])
    """

    def __init__(self, name: str, decimal: str, where: str, clock: bool | None = None) -> None:
        self.name, self.decimal, self.where, self.clock = name, decimal, where, clock
        self.bad, self.first_bad = 0, ""
        self.first_s = self.last_s = np.nan
        self.days = 0.0

    def numbers(self, texts: list[str], rows: RowNumbers) -> FloatArray:
        """Numbers (N,) from the cells of one piece, whose rows of the file are ``rows``."""
        full = [t for t in texts if t.lower() not in ABSENT]
        if self.clock is None and full:
            self.clock = sum(CLOCK.fullmatch(t) is not None for t in full) > 0.5 * len(full)
        if self.clock:
            return self._seconds(texts, rows)
        out = np.full(len(texts), np.nan)
        for i, text in enumerate(texts):
            low = text.lower()
            if is_number(text, self.decimal):
                out[i] = float(text.replace(",", "."))
            elif low in FLAGS:
                out[i] = FLAGS[low]
            elif low not in ABSENT:
                self.first_bad = self.first_bad or f"row {rows.of(i)}: {text[:40]!r} is no number"
                self.bad += 1
            elif "inf" in low:
                out[i] = np.inf
        return out

    def judge(self, cells: int) -> list[str]:
        """What was noticed in all ``cells`` of the column.

        Raises InputError when more than one in a hundred (and more than three) is no number.
        """
        if self.clock:
            return [f"column {self.name}: the clock passes midnight; the time runs on"] if self.days else []
        if not self.bad:
            return []
        place = f"column {self.name}, {self.first_bad}"
        if self.bad > max(3, 0.01 * cells):
            raise InputError(
                f"{place} ({self.bad} of {cells} cells)",
                where=self.where,
                expected=f"numbers with decimal {'comma' if self.decimal == ',' else 'point'}",
            )
        return [place + (f" (and {self.bad - 1} more)" if self.bad > 1 else "") + "; taken as missing"]

    def _seconds(self, texts: list[str], rows: RowNumbers) -> FloatArray:
        series = pd.Series(texts, dtype="str").str.replace(",", ".", regex=False)
        parts = series.str.extract(r"(?P<h>\d{1,2}):(?P<m>\d\d):(?P<s>\d\d(?:\.\d+)?)\s*(?P<half>AM|PM)?")
        hour = pd.to_numeric(parts["h"]).to_numpy(dtype=float)
        afternoon = (parts["half"] == "PM").to_numpy(dtype=bool)
        morning = (parts["half"] == "AM").to_numpy(dtype=bool)
        hour = np.where(afternoon | morning, hour % 12, hour) + 12.0 * afternoon
        minute = pd.to_numeric(parts["m"]).to_numpy(dtype=float)
        second = hour * 3600 + minute * 60 + pd.to_numeric(parts["s"]).to_numpy(dtype=float)
        if not len(second):
            return second
        if np.isnan(self.first_s):
            if not np.isfinite(second[0]):
                raise InputError(
                    f"column {self.name}, row {rows.of(0)}: {texts[0]!r} is no clock time", where=self.where
                )
            self.first_s = self.last_s = float(second[0])
        steps = np.diff(second, prepend=self.last_s)
        days = self.days + np.cumsum(np.where(steps < -43200.0, 1.0, 0.0))
        self.last_s, self.days = float(second[-1]), float(days[-1])
        return np.asarray(np.round(second + 86400.0 * days - self.first_s, 9))
