"""What is understood of a table: rows, clock, gaps, and the readings of each column.

Nothing is estimated here: the answers are those of :mod:`tcdyn.series`, on which every other
command works. Tests: ``tests/cli/test_inspect_command.py``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tcdyn.core import Array
from tcdyn.core.arguments import as_names, with_named_arguments
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, info, messages, unique_by_subject
from tcdyn.core.options import options_of
from tcdyn.core.result import Result
from tcdyn.io.read import display_path
from tcdyn.io.start_time import start_time
from tcdyn.io.table import SourceFile
from tcdyn.io.unit_names import unit_in, without_unit, written_unit
from tcdyn.series import (
    Context,
    Series,
    SeriesReport,
    Source,
    TableOptions,
    open_source,
)
from tcdyn.series.long_tables import check_one_channel
from tcdyn.series.read import read_all
from tcdyn.series.reading import Kind, Reasons
from tcdyn.series.report import ColumnReport, LeftOut
from tcdyn.series.series import ColumnRows, reading_rows
from tcdyn.series.source import check_numbers
from tcdyn.series.survey import Survey
from tcdyn.series.units import (
    Unit,
    check_declared,
    cold_column,
    kind_of,
    match_columns,
    unit_findings,
    units_of,
)

LISTED_GAPS = 5  # gaps that the summary lists; by judgement
LONGEST_EXAMPLE = 40  # characters of a cell that the summary shows; by judgement

_IN_BRACKETS = re.compile(r"[\[(]([^\])]+)[\])]\s*$")  # a unit at the end of a name


@dataclass(frozen=True)
class OtherColumn:
    """A column that holds no readings.

    Attributes
    ----------
    name
        Its name.
    content
        "time" (dates, clock times, or a time by its name) or "text".
    example
        Its first cell that is not empty.
    """

    name: str
    content: str
    example: str


@dataclass(frozen=True)
class InspectedColumn:
    """The values of a column, for a picture.

    Attributes
    ----------
    name, unit
        Name and unit.
    values
        Values (R,) as in the table, NaN where there is no number.
    reasons
        Why each is no reading (R,), see :mod:`tcdyn.series.reading`.
    """

    name: str
    unit: str
    values: Array
    reasons: Reasons


@dataclass(frozen=True, repr=False)
class Inspection(Result):
    """What is understood of a table.

    Attributes
    ----------
    where
        The table.
    reading
        Rows, clock, gaps, and the readings of each column.
    other_columns
        Columns that hold no readings.
    assumed
        Columns of temperature whose unit nobody states: they are taken as degrees Celsius.
    findings
        Findings.
    time_s
        Time of each row (R,) [s].
    columns
        Values of the columns, for a picture.
    sources
        The files of the table, in the order of their rows; none for data in memory.
    """

    where: str
    reading: SeriesReport
    other_columns: tuple[OtherColumn, ...]
    assumed: tuple[str, ...]
    findings: tuple[Finding, ...]
    time_s: Array = field(repr=False)
    columns: tuple[InspectedColumn, ...] = field(repr=False)
    sources: tuple[SourceFile, ...] = ()

    @property
    def rate_Hz(self) -> float:
        """Rows per second, where none is missing."""
        return 1 / self.reading.interval_s

    @property
    def u_rate_Hz(self) -> float:
        """Standard uncertainty of the rate [Hz]."""
        return self.reading.u_interval_s / self.reading.interval_s**2

    def summary(self) -> str:
        """Rows and clock, gaps, then one line a column, the other columns, and the findings."""
        lines = [
            self._headline(),
            *self._file_lines(),
            *self._clock_lines(),
            *self._gap_lines(),
            "",
        ]
        lines += _aligned(self.card())
        left_out = [
            f"  {column.name}: {_left_out_text(each)}"
            for column in self.reading.columns
            for each in column.left_out
        ]
        if left_out:
            lines += ["", "left out:", *left_out]
        if self.other_columns:
            others = [f"{each.name} ({each.content})" for each in self.other_columns]
            lines += ["", f"other columns: {', '.join(others)}"]
        lines += [f"{finding.severity.value}: {finding.message()}" for finding in self.findings]
        return "\n".join(lines)

    def _headline(self) -> str:
        """Number of rows, interval and duration in one line."""
        report = self.reading
        return (
            f"{self.where}: {report.rows} rows in {report.duration_s:.6g} s, one every "
            f"{report.interval_s:.6g} s ({self.rate_Hz:.6g} Hz)"
        )

    def _file_lines(self) -> list[str]:
        """Lines about the files, where there are several; rows are counted over all of them."""
        if len(self.sources) < 2:
            return []
        return [
            f"  {source.file}: {source.rows} rows"
            + (f", from row {source.first_row}" if source.first_row else "")
            for source in self.sources
        ]

    def _clock_lines(self) -> list[str]:
        """Lines about the time."""
        report = self.reading
        start = f", {report.start_time}" if report.start_time else ""
        lines = [
            f"time: column {report.time}, from {report.start_s:.9g} s{start}",
            f"interval: {report.interval_s:.6g} +- {report.u_interval_s:.2g} s, rate "
            f"{self.rate_Hz:.6g} +- {self.u_rate_Hz:.2g} Hz",
        ]
        if report.resolution_s:
            lines.append(f"resolution of the stamps: {report.resolution_s:.3g} s")
        if report.repeated_rows:
            lines.append(f"repeated: {report.repeated_rows} row(s) have the time of the row before")
        if report.stray_s:
            lines.append(
                f"stamps: {report.stray_s:.2g} s (1 sd) off even times, of which "
                f"{100 * report.real_share:.0f} +- {100 * report.u_real_share:.0f} % are real "
                "shifts of the sampling instants"
            )
        if report.averages_s is not None:
            lines.append(f"each row is a mean over {report.averages_s:g} s, as stated")
        return lines

    def _gap_lines(self) -> list[str]:
        """Lines about the rows that are missing."""
        report = self.reading
        if not report.places:
            return ["gaps: none"]
        lines = [f"gaps: {report.rows_lost} sample(s) have no row, at {report.places} place(s)"]
        longest = sorted(report.gaps, key=lambda gap: -gap.rows)[:LISTED_GAPS]
        for gap in sorted(longest, key=lambda gap: gap.after_row):
            lines.append(
                f"  after row {gap.after_row} ({gap.start_s:.6g} s): {gap.rows} sample(s), "
                f"{gap.rows * report.interval_s:.4g} s"
            )
        if report.places > len(longest):
            lines.append(f"  and {report.places - len(longest)} shorter one(s)")
        return lines

    def to_dict(self) -> dict[str, Any]:
        """All of it as plain data, without the rows."""
        others = {
            each.name: {"content": each.content, "example": each.example}
            for each in self.other_columns
        }
        return {
            "file": self.where,
            "sources": [source.to_dict() for source in self.sources],
            "rate_Hz": self.rate_Hz,
            "u_rate_Hz": self.u_rate_Hz,
            "reading": self.reading.to_dict(),
            "unit_assumed": list(self.assumed),
            "other_columns": others,
            "warnings": list(messages(self.findings)),
            "findings": [finding.to_dict() for finding in self.findings],
        }

    def to_frame(self) -> pd.DataFrame:
        """One row for each column: unit, kind, and numbers of readings and of what was left out."""
        rows = [
            {
                "unit": column.unit,
                "kind": column.kind,
                "readings": column.readings,
                "interval_s": column.interval_s,
                "empty": column.empty,
                **{
                    reason: _count(column, reason) for reason in ("word", "code", "range", "repeat")
                },
                "dead_band": np.nan if column.dead_band is None else column.dead_band,
            }
            for column in self.reading.columns
        ]
        index = pd.Index([column.name for column in self.reading.columns], name="column")
        return pd.DataFrame(rows, index)

    def card(self) -> pd.DataFrame:
        """The table of the summary, without columns in which no number is above zero."""
        frame = self.to_frame()
        counts = ["empty", "word", "code", "range", "repeat"]
        unused = [name for name in counts if not frame[name].any()]
        if frame["dead_band"].isna().all():
            unused.append("dead_band")
        frame = frame.drop(columns=unused)
        frame["unit"] = [
            f"{unit} (assumed)" if name in self.assumed else unit or "-"
            for name, unit in frame["unit"].items()
        ]
        frame["interval_s"] = [f"{value:.5g}" for value in frame["interval_s"]]
        return frame.reset_index()


def _aligned(table: pd.DataFrame) -> list[str]:
    """A table as lines: text aligned on the left, numbers on the right."""
    cells = []
    for name in table.columns:
        column = [str(name), *map(str, table[name])]
        width = max(map(len, column))
        is_text = name in ("column", "unit", "kind")
        cells.append([each.ljust(width) if is_text else each.rjust(width) for each in column])
    return ["  ".join(row).rstrip() for row in zip(*cells)]


def _count(column: ColumnReport, reason: str) -> int:
    """Number of values of a column that were left out for a reason."""
    return sum(each.count for each in column.left_out if each.reason == reason)


REASON_TEXTS = {
    "word": "words",
    "code": "overload or drop-out codes",
    "range": "beyond the range of a thermocouple",
    "repeat": "that repeat the last value",
}


def _left_out_text(left_out: LeftOut) -> str:
    """What was left out of a column for one reason."""
    example = left_out.example
    shown = f"{example:.6g}" if isinstance(example, float) else repr(example[:LONGEST_EXAMPLE])
    return (
        f"{left_out.count} {REASON_TEXTS[left_out.reason]}, first in row "
        f"{left_out.first_row}: {shown}"
    )


@with_named_arguments
def inspect(
    data: str | Path | Sequence[str | Path] | pd.DataFrame | pd.Series,
    columns: Sequence[str] | str = (),
    **options: Any,
) -> Inspection:
    """Return what is understood of a table, before anything is fitted.

    Parameters
    ----------
    data
        A file, several files of one log, a DataFrame, or a Series over time.
    columns
        Columns to look at, or patterns; none: all columns of numbers that are no times.
    **options
        How the table is read: the fields of :class:`tcdyn.series.TableOptions`.

    Returns
    -------
    Inspection
        Rows, clock and gaps, and what was left out of each column.

    Raises
    ------
    InputError
        For a table that the other functions refuse: without a time column, with several channels in
        one column, with readings in another unit, or with time that runs backward.

    Examples
    --------
    >>> t = np.arange(60.0)
    >>> readings = np.where(t == 7, 9.9e37, 20 + 0.1 * t)
    >>> table = pd.Series(readings, pd.Index(t, name="time_s"), name="T1_degC")
    >>> found = inspect(table[(t < 12) | (t > 14)])
    >>> found.reading.rows_lost, found.reading.columns[0].left_out[0].reason
    (3, 'code')
    """
    settings = options_of(TableOptions, options, "inspect")
    columns = as_names("columns", columns)
    source = open_source(data, columns, settings.rows)
    names = _selected(source, columns)
    where = source.table.where if source.table.sources else display_path(source.path)
    cold = cold_column(settings.cold, source.table.names, source.table.where)
    if source.value_columns:
        check_one_channel(source.table, source.time, names if columns else None)
    references = [cold] if isinstance(cold, str) else []
    time_s, raw, findings = read_all(source, list(dict.fromkeys([*names, *references])))
    numbers, others = _by_content(source, names, raw, bool(columns))
    units, unit_infos = _units(source, numbers, settings.units, settings.couple, cold)
    written = {name: _written(source, name) for name in numbers}

    def columns_of(rows: Mapping[str, Any]) -> list[ColumnRows]:
        """The columns of some rows."""
        judged = reading_rows(units, rows, source.table.where)
        by_name = {each.name: _with_plain_unit(each, written[each.name]) for each in judged}
        return [
            by_name[name]
            if name in by_name
            else ColumnRows(name, written[name], Kind.QUANTITY, rows[name])
            for name in numbers
        ]

    context = Context(
        where,
        time=source.time,
        options=source.options,
        start_time=start_time(raw, source.time, time_s) if len(time_s) else "",
        table=source.table,
    )
    parts: list[Series] = []
    look = Survey(columns_of, context, keep=parts)
    look.add(time_s, {name: raw[name] for name in [*numbers, *references]}, findings)
    report = look.report()
    if report is None:
        raise InputError(f"only {len(time_s)} rows", where=where, expected="at least 2 rows")
    doubts = [each for name, of in units.items() for each in unit_findings(name, of, raw[name])]
    all_findings = unique_by_subject([*findings, *unit_infos, *doubts, *look.findings])
    inspected = _inspected_columns(report, raw, parts)
    assumed = _assumed_temperatures(report, units)
    files = source.files(len(time_s))
    return Inspection(where, report, others, assumed, all_findings, time_s, inspected, files)


def _inspected_columns(
    report: SeriesReport, raw: Mapping[str, NDArray[Any]], parts: Sequence[Series]
) -> tuple[InspectedColumn, ...]:
    """The values of each column, for a picture.

    Parameters
    ----------
    report
        Report on the columns.
    raw
        Values (R,) of each column.
    parts
        The rows with the reasons why a value is no reading, in pieces.
    """
    return tuple(
        InspectedColumn(
            each.name,
            each.unit,
            np.asarray(raw[each.name], dtype=float),
            np.concatenate([part.reasons[each.name] for part in parts]),
        )
        for each in report.columns
    )


def _assumed_temperatures(report: SeriesReport, units: Mapping[str, Unit]) -> tuple[str, ...]:
    """Columns of temperature whose unit nobody states."""
    return tuple(
        each.name
        for each in report.columns
        if each.kind == Kind.TEMPERATURE.value and units[each.name].is_assumed
    )


def _selected(source: Source, columns: Sequence[str]) -> list[str]:
    """The columns that are meant; all but the time without a choice."""
    candidates = source.value_columns
    if not columns:
        return candidates
    matches = [match_columns(each, candidates, source.table.where) for each in columns]
    return list(dict.fromkeys(name for names in matches for name in names))


def _by_content(
    source: Source, names: Sequence[str], raw: Mapping[str, NDArray[Any]], is_chosen: bool
) -> tuple[list[str], tuple[OtherColumn, ...]]:
    """Columns of numbers, and the others; InputError for a column of text that was chosen."""
    numbers = []
    others = []
    for name in names:
        values = raw[name]
        if is_chosen:
            check_numbers(name, values, source.table.where)
        is_time = not is_chosen and source.table.is_time(name)
        if values.dtype != object and not is_time:
            numbers.append(name)
            continue
        cells = (str(cell).strip() for cell in values if not pd.isna(cell))
        example = next((cell for cell in cells if cell), "")
        others.append(OtherColumn(name, "time" if is_time else "text", example))
    return numbers, tuple(others)


def _written(source: Source, name: str) -> str:
    """The unit of a column as the table writes it; empty where it does not."""
    in_brackets = _IN_BRACKETS.search(name)
    of_name = in_brackets[1].strip() if in_brackets else ""
    return unit_in(name) or source.table.units.get(name, "") or of_name


def _with_plain_unit(column: ColumnRows, written: str) -> ColumnRows:
    """A column whose readings are no temperature has the unit that the table writes."""
    if column.kind is Kind.TEMPERATURE:
        return column
    return replace(column, unit=written)


def _units(
    source: Source,
    names: Sequence[str],
    declared: Mapping[str, str] | str,
    couple: str,
    cold: float | str,
) -> tuple[dict[str, Unit], list[Finding]]:
    """Units of the columns that may hold temperatures, and the findings about them.

    A column in another unit, and one in millivolts where no thermocouple is stated, is none.
    """
    candidates = []
    for name in names:
        by_column = "" if isinstance(declared, str) else declared.get(without_unit(name), "")
        is_declared = bool(by_column or (isinstance(declared, str) and declared))
        is_declared |= not isinstance(declared, str) and name in declared
        below_header = source.table.units.get(name, "")
        unit = unit_in(name) or written_unit(below_header)
        is_millivolts = unit == "mV"
        is_other = bool(below_header) and not unit
        if is_declared or not (is_other or (is_millivolts and not couple)):
            candidates.append(name)
    check_declared(declared, source.table.names, source.table.where)
    units, findings = units_of(candidates, declared, couple, cold, source.table.units)
    findings = [each for each in findings if each.code != "sensor.unit_assumed"]
    assumed = [
        name
        for name, of_column in units.items()
        if of_column.is_assumed and kind_of(name, of_column) is Kind.TEMPERATURE
    ]
    if assumed:
        subject = ", ".join(assumed)
        findings.append(info("sensor.unit_assumed", subject=subject, count=len(assumed)))
    return units, findings
