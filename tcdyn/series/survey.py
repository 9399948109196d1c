"""A first look at all rows of a table, in bounded memory: what is understood, and the codes in it.

Flows that work part by part look at the complete table first, so that a decision does not depend on
the part. Tests: ``tests/series/test_survey.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, unique_by_subject
from tcdyn.series.reading import Codes, find_codes
from tcdyn.series.report import ColumnCount, SeriesReport, merged_reports
from tcdyn.series.series import ColumnRows, Context, Policy, Series, make_series
from tcdyn.series.source import ChunkSource

# Rows of a part whose clock and readings are decided together: memory (1 MB a column). A table
# below twice as many rows is one part.
PART_ROWS = 1 << 17
# A survey says what is there; what is too little or too far apart is decided by the flow.
EVERYTHING = Policy(min_rows=2, needs_grid=False)

# Columns from the raw columns of some rows.
ColumnsOf = Callable[[Mapping[str, Any]], Sequence[ColumnRows]]


@dataclass
class Survey:
    """What is understood of the rows so far.

    Attributes
    ----------
    columns_of
        Function that makes columns of raw ones.
    context
        Where the rows come from.
    codes
        Codes of the logger by column.
    keep
        List that gets the series of each part; None: they are not kept.
    """

    columns_of: ColumnsOf
    context: Context
    codes: dict[str, Codes] = field(default_factory=dict)
    keep: list[Series] | None = None
    _times: list[Array] = field(default_factory=list)
    _raw: list[Mapping[str, Any]] = field(default_factory=list)
    _rows: int = 0
    _done: int = 0
    _parts: list[SeriesReport] = field(default_factory=list)
    _counts: dict[str, ColumnCount] = field(default_factory=dict)
    _findings: list[Finding] = field(default_factory=list)
    _of_reader: list[Finding] = field(default_factory=list)

    def add(self, time_s: Array, raw: Mapping[str, Any], findings: Sequence[Finding] = ()) -> None:
        """Add rows.

        Parameters
        ----------
        time_s
            Their times (N,) [s].
        raw
            Columns (N,) as in the table.
        findings
            Findings of the reader.
        """
        self._of_reader += findings
        if not len(time_s):
            return
        self._times.append(time_s)
        self._raw.append(raw)
        self._rows += len(time_s)
        while self._rows >= 2 * PART_ROWS:
            self._look(PART_ROWS)

    def _look(self, rows: int) -> None:
        """Decide about the first rows that are waiting."""
        time_s = np.concatenate(self._times)
        names = [*self._raw[0]]
        raw = {name: np.concatenate([part[name] for part in self._raw]) for name in names}
        self._times = [time_s[rows:]]
        self._raw = [{name: values[rows:] for name, values in raw.items()}]
        self._rows -= rows
        first_row = self._done + 1
        self._done += rows
        columns = self.columns_of({name: values[:rows] for name, values in raw.items()})
        for column in columns:
            found = find_codes(column.judged, column.kind)
            self.codes[column.name] = found.joined(self.codes.get(column.name, Codes()))
        context = replace(
            self.context, first_row=first_row, codes=self.codes, policy=EVERYTHING, findings=()
        )
        if rows < EVERYTHING.min_rows:
            return
        series = make_series(time_s[:rows], columns, context)
        self._findings += series.findings
        self._parts.append(series.report)
        if self.keep is not None:
            self.keep.append(series)
        for column in columns:
            count = self._counts.setdefault(
                column.name, ColumnCount(column.name, column.unit, column.kind.value)
            )
            count.add(column.raw, series.reasons[column.name], first_row)
            if column.name in series.bands:
                count.dead_band = series.bands[column.name].value

    def report(self) -> SeriesReport | None:
        """What was understood of all rows; None of fewer than two.

        Raises
        ------
        InputError
            For times that run backward, and for readings in another unit.
        """
        if self._rows:
            self._look(self._rows)
        if not self._parts:
            return None
        merged = merged_reports(self._parts)
        columns = [
            count.report(self._of_reader, merged.duration_s) for count in self._counts.values()
        ]
        return replace(merged, columns=tuple(columns))

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Findings about the rows, the first of each code about each column."""
        return unique_by_subject(self._findings)


def survey(
    source: ChunkSource, names: Sequence[str], columns_of: ColumnsOf, context: Context
) -> Survey:
    """Look at all rows of a table.

    Parameters
    ----------
    source
        The table.
    names
        Raw columns that ``columns_of`` needs.
    columns_of, context
        As for ``Survey``.

    Raises
    ------
    InputError
        As ``Survey.report`` does.
    """
    result = Survey(columns_of, context)
    for time_s, raw, findings in source.read_chunks(names):
        result.add(time_s, {name: raw[name] for name in names}, findings)
    return result


@dataclass
class SurveyedSource:
    """A source whose rows are surveyed as they are read.

    Attributes
    ----------
    source
        The source.
    names
        Raw columns that the survey needs.
    survey
        What is understood so far.
    """

    source: ChunkSource
    names: Sequence[str]
    survey: Survey

    def read_chunks(
        self, columns: Sequence[str]
    ) -> Iterator[tuple[Array, dict[str, Array], tuple[Finding, ...]]]:
        """Time (N,) [s] and columns (N,) of each chunk, and findings."""
        for time_s, raw, findings in self.source.read_chunks(columns):
            self.survey.add(time_s, {name: raw[name] for name in self.names}, findings)
            yield time_s, raw, findings

    def report(self) -> SeriesReport | None:
        """What was understood; None where the rows cannot be put on a clock."""
        with suppress(InputError):
            return self.survey.report()
        return None
