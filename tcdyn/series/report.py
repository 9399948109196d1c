"""What was understood of a table: clock, gaps, readings, and why the other values are none.

Every result that is made from a table carries this report as ``reading``; ``tcdyn inspect`` prints
it. Tests: ``tests/series/test_survey.py`` and ``tests/series/test_one_answer.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from tcdyn.core import Array
from tcdyn.core.findings import Finding
from tcdyn.series.clock import Clock
from tcdyn.series.descriptions import MAX_DECIMALS
from tcdyn.series.reading import EMPTY, READING, REASON_NAMES, Reasons
from tcdyn.series.real_share import RealShare

LISTED_GAPS = 100  # longest gaps that a report lists
# Findings of the readers about cells that hold words; the reason is then "word".
WORD_CODES = ("text.error_word", "text.no_number")


@dataclass(frozen=True)
class LeftOut:
    """Values of a column that are no readings, for one reason.

    Attributes
    ----------
    reason
        "word" (text), "code" (overload or drop-out code of the logger), "range" (beyond a
        thermocouple) or "repeat" (the last value again, until there is a new one).
    count
        Number of values.
    first_row
        Row of the first of them below the header, from 1.
    example
        This value, or word.
    """

    reason: str
    count: int
    first_row: int
    example: float | str


@dataclass(frozen=True)
class ColumnReport:
    """What was understood of a column.

    Attributes
    ----------
    name, unit, kind
        Name, unit and what it holds.
    readings
        Number of readings.
    empty
        Rows with an empty cell.
    left_out
        Values that are no readings.
    interval_s
        Mean interval of its readings [s]; NaN with fewer than two.
    dead_band
        Change from which a row was written, where rows were written on change; None: at any time.
    """

    name: str
    unit: str
    kind: str
    readings: int
    empty: int
    left_out: tuple[LeftOut, ...]
    interval_s: float
    dead_band: float | None = None


@dataclass(frozen=True)
class Gap:
    """Samples in a row that have no row in the table.

    Attributes
    ----------
    after_row
        Row before the gap, below the header, from 1.
    start_s
        Its time [s].
    rows
        Missing samples.
    """

    after_row: int
    start_s: float
    rows: int


@dataclass(frozen=True)
class SeriesReport:
    """What was understood of the rows of a table.

    Attributes
    ----------
    rows, samples
        Rows, and samples of the even grid from the first to the last.
    interval_s, u_interval_s
        Sampling interval and its standard uncertainty [s].
    start_s, duration_s
        Time of the first sample, and from it to the last [s].
    rows_lost, repeated_rows
        Samples that have no row, and rows with the time of the row before.
    gaps
        The longest places without rows, in the order of time; ``places`` counts all.
    places
        Number of such places.
    stray_s
        Standard deviation of the stamps about the grid [s].
    real_share, u_real_share
        How much of it are real shifts of the sampling instants, according to the readings, and its
        standard uncertainty; 0 where the stamps do not stray.
    resolution_s
        Step of the clock [s], 0 where there is none.
    averages_s
        Time over which each row is a mean [s], as stated; None.
    columns
        The columns.
    time, start_time
        Name of the time column; date and time of the first row, where the table states them.
    """

    rows: int
    samples: int
    interval_s: float
    u_interval_s: float
    start_s: float
    duration_s: float
    rows_lost: int
    repeated_rows: int
    gaps: tuple[Gap, ...]
    places: int
    stray_s: float
    real_share: float
    u_real_share: float
    resolution_s: float
    averages_s: float | None
    columns: tuple[ColumnReport, ...]
    time: str = ""
    start_time: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Return all of it as plain data."""
        columns = {}
        for column in self.columns:
            left_out = {
                each.reason: {
                    "count": each.count,
                    "first_row": each.first_row,
                    "example": each.example,
                }
                for each in column.left_out
            }
            columns[column.name] = {
                "unit": column.unit,
                "kind": column.kind,
                "readings": column.readings,
                "empty": column.empty,
                "left_out": left_out,
                "interval_s": column.interval_s,
                "dead_band": column.dead_band,
            }
        gaps = [
            {"after_row": gap.after_row, "start_s": gap.start_s, "rows": gap.rows}
            for gap in self.gaps
        ]
        return {
            "rows": self.rows,
            "samples": self.samples,
            "interval_s": self.interval_s,
            "u_interval_s": self.u_interval_s,
            "start_s": self.start_s,
            "duration_s": self.duration_s,
            "start_time": self.start_time,
            "time": self.time,
            "rows_lost": self.rows_lost,
            "repeated_rows": self.repeated_rows,
            "places": self.places,
            "gaps": gaps,
            "stray_s": self.stray_s,
            "real_share": self.real_share,
            "u_real_share": self.u_real_share,
            "resolution_s": self.resolution_s,
            "averages_s": self.averages_s,
            "columns": columns,
        }


@dataclass
class ColumnCount:
    """Readings of a column, counted part by part.

    Attributes
    ----------
    name, unit, kind
        As in ``ColumnReport``.
    readings, no_number
        Readings, and rows without a number.
    left_out
        By reason.
    dead_band
        As in ``ColumnReport``.
    """

    name: str
    unit: str
    kind: str
    readings: int = 0
    no_number: int = 0
    left_out: dict[str, LeftOut] = field(default_factory=dict)
    dead_band: float | None = None

    def add(self, values: Array, reasons: Reasons, first_row: int) -> None:
        """Count the values of some rows.

        Parameters
        ----------
        values
            Values (N,).
        reasons
            Why each is no reading (N,), see :mod:`tcdyn.series.reading`.
        first_row
            Row of the first of them below the header, from 1.
        """
        self.readings += int(np.count_nonzero(reasons == READING))
        self.no_number += int(np.count_nonzero(reasons == EMPTY))
        for number, name in REASON_NAMES.items():
            if number == EMPTY:
                continue
            is_left_out = reasons == number
            count = int(np.count_nonzero(is_left_out))
            if not count:
                continue
            if name in self.left_out:
                earlier = self.left_out[name]
                self.left_out[name] = replace(earlier, count=earlier.count + count)
                continue
            first = int(np.argmax(is_left_out))
            self.left_out[name] = LeftOut(name, count, first_row + first, float(values[first]))

    def report(self, findings: Sequence[Finding], duration_s: float) -> ColumnReport:
        """Return the report, with the words that the reader found.

        Parameters
        ----------
        findings
            Findings of the reader.
        duration_s
            Time from the first row to the last [s].
        """
        left_out = dict(self.left_out)
        n_words = 0
        for finding in findings:
            if finding.code in WORD_CODES and finding.subject == self.name:
                numbers = finding.numbers
                n_words += int(numbers["count"])
                example = str(numbers.get("text", ""))
                left_out["word"] = LeftOut("word", n_words, int(numbers["table_row"]), example)
        interval_s = duration_s / (self.readings - 1) if self.readings > 1 else np.nan
        return ColumnReport(
            self.name,
            self.unit,
            self.kind,
            self.readings,
            self.no_number - n_words,
            tuple(left_out[reason] for reason in sorted(left_out)),
            interval_s,
            self.dead_band,
        )


def find_gaps(clock: Clock, first_row: int = 1) -> tuple[tuple[Gap, ...], int]:
    """Return the longest places without rows, and the number of all.

    Parameters
    ----------
    clock
        The clock of the rows.
    first_row
        Row of its first row below the header, from 1.
    """
    missing = clock.missing
    places = np.flatnonzero(missing > 0)
    longest = np.sort(places[np.argsort(-missing[places], kind="stable")[:LISTED_GAPS]])
    stamps_s = clock.even_s
    gaps = tuple(
        Gap(first_row + int(k), float(stamps_s[k]), int(missing[k])) for k in longest.tolist()
    )
    return gaps, len(places)


def clock_report(
    clock: Clock,
    share: RealShare | None,
    columns: Sequence[ColumnReport],
    *,
    time: str,
    averages_s: float | None,
    start_time: str = "",
    first_row: int = 1,
    are_rows_changes: bool = False,
) -> SeriesReport:
    """Return the report of some rows.

    Parameters
    ----------
    clock
        Their clock.
    share
        How much of the deviations of the stamps is real; None where they do not stray.
    columns
        The columns.
    time, averages_s, start_time
        As in ``SeriesReport``.
    first_row
        First row below the header, from 1.
    are_rows_changes
        Whether rows were written on change, so that no row is missing.
    """
    gaps, places = ((), 0) if are_rows_changes else find_gaps(clock, first_row)
    return SeriesReport(
        rows=len(clock.index),
        samples=clock.size,
        interval_s=clock.interval_s,
        u_interval_s=clock.u_interval_s,
        start_s=round(clock.start_s, MAX_DECIMALS),
        duration_s=clock.interval_s * (clock.size - 1),
        rows_lost=0 if are_rows_changes else clock.n_lost,
        repeated_rows=clock.n_repeated,
        gaps=gaps,
        places=places,
        stray_s=float(np.std(clock.jitter_s)) if share is not None else 0.0,
        real_share=share.value if share is not None else 0.0,
        u_real_share=share.u if share is not None else 0.0,
        resolution_s=clock.resolution_s,
        averages_s=averages_s,
        columns=tuple(columns),
        time=time,
        start_time=start_time,
    )


def merged_reports(parts: Sequence[SeriesReport]) -> SeriesReport:
    """Return the report of the parts of a table that was read part by part.

    Parameters
    ----------
    parts
        Reports of parts that follow each other, at least one. Rows that are lost between two of
        them are counted with the interval of the second.
    """
    if len(parts) == 1:
        return parts[0]
    rows = sum(part.rows for part in parts)
    samples = 0
    lost = 0
    gaps: list[Gap] = []
    places = sum(part.places for part in parts)
    end_s = -np.inf
    row = 0
    for part in parts:
        between = 0
        if row:
            between = max(round((part.start_s - end_s) / part.interval_s) - 1, 0)
        if between:
            gaps.append(Gap(row, end_s, between))
            places += 1
        gaps += part.gaps
        samples += part.samples + between
        lost += part.rows_lost + between
        row += part.rows
        end_s = part.start_s + part.duration_s
    longest = sorted(sorted(gaps, key=lambda gap: -gap.rows)[:LISTED_GAPS], key=_row_of_gap)
    weights = np.array([part.rows for part in parts]) / rows
    mean_s = float(weights @ [part.interval_s for part in parts])
    u_s = float(np.sqrt(np.sum((weights * [part.u_interval_s for part in parts]) ** 2)))
    return replace(
        parts[0],
        rows=rows,
        samples=samples,
        interval_s=mean_s,
        u_interval_s=u_s,
        duration_s=end_s - parts[0].start_s,
        rows_lost=lost,
        repeated_rows=sum(part.repeated_rows for part in parts),
        gaps=tuple(longest),
        places=places,
        stray_s=float(np.sqrt(weights @ [part.stray_s**2 for part in parts])),
        real_share=float(weights @ [part.real_share for part in parts]),
        u_real_share=max(part.u_real_share for part in parts),
        resolution_s=max(part.resolution_s for part in parts),
        columns=parts[0].columns,
    )


def _row_of_gap(gap: Gap) -> int:
    """Row before a gap."""
    return gap.after_row
