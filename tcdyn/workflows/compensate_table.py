"""Compensation of any table with sensor files, segment by segment, in bounded memory.

With a fixed delay also of a log of the rig with records: each row is then compensated with the rows
that ``tcdyn follow`` has when it writes it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tcdyn.core.arguments import described, with_named_arguments
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, error, info, unique_by_subject, warning
from tcdyn.core.options import options_of
from tcdyn.core.progress import Progress, no_progress
from tcdyn.core.result import Result, jsonable
from tcdyn.core.threads import one_blas_thread
from tcdyn.io.endings import LONG_TABLE, check_ending, check_size
from tcdyn.io.read import open_table, sha256_of_file
from tcdyn.io.table import SourceFile
from tcdyn.io.write import OutputStyle, check_not_input, dialect_findings, output_style
from tcdyn.rig.rigfile import Rig
from tcdyn.sensors.channels import Channel
from tcdyn.sensors.compensation import (
    CompensatedSegment,
    CompensationMethod,
    Totals,
    compensated_segments,
    write_segments,
)
from tcdyn.series import Source
from tcdyn.series.joined import files_of_log
from tcdyn.series.report import SeriesReport
from tcdyn.series.source import ChunkSource, FilledTimes, RisingRows
from tcdyn.series.survey import SurveyedSource
from tcdyn.smoothing.time_means import AUTO, MeanTimes, check_length, length_of_rows
from tcdyn.workflows.options import CompensateOptions
from tcdyn.workflows.raw_log import (
    Calibrations,
    Given,
    RawLog,
    calibrations_of,
    checked_before_following,
    open_log_table,
    raw_log,
    raw_table,
    survey_of,
    surveyed,
)

# What the components of an uncertainty have in common, in the metadata of the output
COMPONENTS_NOTE = (
    "u^2 = noise_u^2 + record_u^2 + common_u^2; noise_u: an error that differs from row to row, "
    "alike in rows closer than the resolution; record_u: one error of the column in the whole log; "
    "common_u: one error of all columns of a sensor file or disk in the whole log"
)
# Progress is reported after so many rows, then each time the count has doubled.
PROGRESS_ROWS = 200_000
# Share of readings that were not used from which they are a warning: slip rings have some spikes.
# Chosen by judgement.
MANY_NOT_USED = 0.01


@dataclass(frozen=True, repr=False)
class CompensatedTable(Result):
    """Result of the compensation of a table: what was written, and how uncertain it is.

    Attributes
    ----------
    path
        File that was written; the current folder where the rows went to a function.
    rows
        Number of rows written.
    columns
        Compensated columns, each with its chain.
    carried
        Names of the other columns, which are passed through unchanged.
    numbers
        One row a compensated column: its name, noise, and typical and largest standard deviation
        of the compensated readings [K], and the shortest time whose means are determined [s]. If a
        column is no temperature, the names do not state K, and ``unit`` is the unit of each.
    decimals
        Number of decimals in a CSV file, of each column with results.
    metadata
        Metadata of the file that was written.
    findings
        Findings about the log and the compensation, without repetitions.
    reading
        What was understood of the rows; None where there are fewer than two.
    sources
        The files of the log, in the order of their rows; none for data in memory.
    means_s
        Length of the means that were written instead of rows [s]; None: rows.
    """

    path: Path
    rows: int
    columns: tuple[Channel, ...]
    carried: tuple[str, ...]
    numbers: pd.DataFrame
    decimals: dict[str, int]
    metadata: dict[str, str]
    findings: tuple[Finding, ...]
    reading: SeriesReport | None = None
    sources: tuple[SourceFile, ...] = ()
    means_s: float | None = None

    def summary(self) -> str:
        """Number of rows and output, then one line a column.

        A line has the lag, the noise, the typical and the largest standard deviation of the
        compensated readings, and the shortest time whose means are determined.
        """
        s = "s" if len(self.columns) > 1 else ""
        what = "rows" if self.means_s is None else f"means over {self.means_s:.3g} s"
        lines = [f"{self.rows} {what}, {len(self.columns)} column{s} compensated: {self.path}"]
        resolutions_s = self.numbers.get("resolution_s", [np.nan] * len(self.columns))
        for column, (_, noise, typical, largest, *_), resolution_s in zip(
            self.columns, self.numbers.itertuples(index=False), resolutions_s
        ):
            unit = column.unit.base_difference
            text = (
                f"  {column.column}: lag {column.lag_s.text('s')}; noise {noise:.3g} {unit}, "
                f"standard deviation {typical:.3g} {unit} typical, {largest:.3g} {unit} at most"
            )
            if np.isfinite(resolution_s):
                text += f"; resolves {resolution_s:.3g} s"
            lines.append(text)
        return "\n".join(lines)

    def to_frame(self) -> pd.DataFrame:
        """Noise and standard deviation of each column."""
        return self.numbers.set_index("column")

    def to_dict(self) -> dict[str, Any]:
        """All of it as plain data."""
        return {
            "out": str(self.path),
            "rows": self.rows,
            "columns": jsonable(self.numbers),
            "means_s": self.means_s,
            "carried": list(self.carried),
            "metadata": self.metadata,
            "sources": [source.to_dict() for source in self.sources],
            "reading": None if self.reading is None else self.reading.to_dict(),
            "warnings": list(self.warnings),
            "findings": [f.to_dict() for f in self.findings],
        }


@with_named_arguments
@one_blas_thread
def compensate_table(
    log: str | Path | Sequence[str | Path] | Source,
    calibrations: Given,
    out: str | Path | Callable[[pd.DataFrame], None],
    *,
    rig: Rig | None = None,
    progress: Progress = no_progress,
    **options: Any,
) -> CompensatedTable:
    """Compensate the columns of any table that sensors cover, and write the table to ``out``.

    Each column with a sensor becomes what the sensor measures, a temperature that of the junction,
    in its own unit (mV of a thermocouple: degrees Celsius). Before it stands the column as logged,
    ``<name>_logged_degC``; behind it its standard uncertainty, ``<name>_u_K`` (``_u_degF``,
    ``_u_ppm``): noise, smoothing, lag and static line. Other columns pass through as numbers and
    are named in a finding.

    Parameters
    ----------
    log
        CSV, LVM, TDMS, Parquet, .xlsx or .mat with a column of time, rows at any rate; several
        files of one log in any order, see :func:`tcdyn.series.joined.open_files`; or an opened
        table.
    calibrations
        Sensors: sensor files or their paths, each column belongs to one; a lag [s] that is stated,
        25 or (25, 1) with its standard uncertainty; a ``Chain`` that is known; or a dict of these
        by column. A lag and a chain are those of ``columns``, or of the only column of numbers.
        With ``delay_s`` also the records of a rig by disk, for the file of a log of the rig.
    out
        Output, .csv, .parquet, .xlsx or .nc; or a function that is called with the rows, part by
        part.
    rig
        The rig of the records; None: the one in them.
    progress
        Called with the row that was reached.
    **options
        How the table is read, compensated and written: the fields of
        :class:`tcdyn.workflows.options.CompensateOptions`. With ``delay_s`` each row is compensated
        with the rows that are there this long after it, as ``tcdyn.workflows.follow.follow`` does;
        otherwise with all rows near it. With ``means`` a row stands for the time around it: the
        results are means, the other columns those of the row in the middle.

    Raises
    ------
    InputError
        For a column that is missing, two sensors for one, a table that is compensated, time that
        does not rise, and an output with another ending; for more rows than .xlsx or .nc can hold,
        before the first is computed where their number is known (without ``delay_s``).
    """
    settings = options_of(CompensateOptions, options, "compensate_table")
    if not isinstance(log, Source) and not files_of_log(log):
        raise InputError(
            f"log is {described(log)}", expected="the path of a table, or an opened table"
        )
    calibrations = calibrations_of(calibrations)
    if isinstance(calibrations, Mapping) and settings.delay_s is None:
        raise InputError("records without a delay", remedy="use compensate_log")
    output = _Output(out)
    output.check_ending()
    raw, report_of_rows = _open_log(log, calibrations, rig, settings)
    run = _TableRun(raw, settings, output, report_of_rows)
    output.check(run.paths, report_of_rows.rows if report_of_rows else 0, len(run.header))
    style = run.style()
    totals = run.write(style, progress)
    if settings.delay_s is not None:
        report_of_rows = run.surveyed_rows.report()
    return CompensatedTable(
        output.path,
        totals.rows,
        raw.channels.channels,
        raw.carried,
        totals.table(raw.channels.units),
        totals.decimals,
        totals.metadata,
        run.findings(totals, style),
        report_of_rows,
        raw.source.files(totals.rows),
        totals.means_s,
    )


@dataclass(frozen=True)
class _Output:
    """Where the rows go.

    Attributes
    ----------
    to
        A file, or a function that is called with the rows.
    """

    to: str | Path | Callable[[pd.DataFrame], None]

    @property
    def path(self) -> Path:
        """The file; the current folder where the rows go to a function."""
        return Path() if callable(self.to) else Path(self.to)

    @property
    def is_netcdf(self) -> bool:
        """Whether it is a netCDF file."""
        return self.path.suffix.lower() == ".nc"

    def check_ending(self) -> None:
        """Check the ending of a file. Raises InputError."""
        if not callable(self.to):
            check_ending(self.path, LONG_TABLE)

    def check(self, inputs: Sequence[Path], rows: int, columns: int) -> None:
        """Check a file before the first row is computed.

        Parameters
        ----------
        inputs
            Files of the log.
        rows, columns
            Number of rows, 0 if it is not known, and of columns.

        Raises
        ------
        InputError
            For an input, and for more rows or columns than the format can hold.
        """
        if callable(self.to):
            return
        for path in inputs:
            check_not_input(self.path, path)
        check_size(self.path, rows, columns)


class _TableRun:
    """One table that is compensated and written.

    Attributes
    ----------
    raw, settings, output
        The opened log, the options, and where the rows go.
    method
        The method.
    header
        Columns of the output.
    rising_rows
        The rows with a delay: those whose time is not before that of an earlier row.
    surveyed_rows
        The same rows, which are surveyed as they come, as those of a log that is followed.
    means_s
        Length of the means that are wanted instead of rows [s]; None: rows.
    """

    def __init__(
        self,
        raw: RawLog,
        settings: CompensateOptions,
        output: _Output,
        report: SeriesReport | None,
    ) -> None:
        """Prepare a run; raises InputError where two columns of the output have one name."""
        self.raw = raw
        self.settings = settings
        self.output = output
        self.method = CompensationMethod(rate=settings.rate, components=settings.components)
        self.header = raw.header(self.method)
        self.rising_rows = RisingRows(raw.source)
        self.surveyed_rows = SurveyedSource(
            self.rising_rows, raw.channels.raw_columns, survey_of(raw)
        )
        self.means_s = self._means_s(report)

    def _means_s(self, report: SeriesReport | None) -> float | None:
        """Length of the means that are wanted [s]; None: rows are.

        Of ``auto`` it is the shortest that is determined in all columns in the first segment, whose
        rows are compensated for that.

        Parameters
        ----------
        report
            What was understood of the rows; None of fewer than two.

        Raises
        ------
        InputError
            If no mean is determined, and for a time shorter than two rows or longer than the log.
        """
        if self.settings.means is None or report is None:
            return None
        length_s = MeanTimes.of(self.settings.means).length_s
        where = self.raw.channels.context.where
        if length_s != AUTO:
            if length_s > report.duration_s:
                raise InputError(
                    f"means over {length_s:.4g} s of a log of {report.duration_s:.4g} s",
                    where=where,
                    expected="less than the log",
                    parameters={"means": "SECONDS"},
                )
            check_length(length_s, report.interval_s)
            return length_s
        first = next(self._segments(), None)
        resolutions_s = [] if first is None else [each[3] for each in first.numbers.values()]
        determined_s = [each for each in resolutions_s if np.isfinite(each)]
        return length_of_rows(determined_s, report.interval_s)

    @property
    def paths(self) -> list[Path]:
        """Files of the log."""
        source = self.raw.source
        return [file.path for file in source.table.sources] or [source.path]

    def style(self) -> OutputStyle:
        """How the output is written."""
        settings = self.settings
        source = self.raw.source
        table = source.table
        if len(self.paths) > 1 and settings.dialect != "standard":
            table = open_table(self.paths[0])
        style = output_style(settings.dialect, settings.comments, table, self.output.path)
        if self.output.is_netcdf:
            return replace(style, time=source.time, units=_units_of_output(self.raw))
        return style

    def write(self, style: OutputStyle, progress: Progress) -> Totals:
        """Compensate and write all rows.

        Parameters
        ----------
        style
            How a file is written.
        progress
            Called with the row that was reached.
        """
        notes = dict(self.raw.notes)
        if len(self.paths) == 1 and self.paths[0].is_file():
            notes["source_sha256"] = sha256_of_file(self.paths[0])
        if self.settings.delay_s is not None:
            notes["delay_s"] = f"{self.settings.delay_s:g}"
        if self.method.components:
            notes["components"] = COMPONENTS_NOTE
        return write_segments(
            self.output.to,
            self.header,
            notes,
            self._segments(self.means_s),
            _progress_of_rows(progress),
            style=style,
            time=self.raw.stamps,
        )

    def _segments(self, means_s: float | None = None) -> Iterator[CompensatedSegment]:
        """The compensated segments of the table, or means over ``means_s``."""
        raw = self.raw
        delay_s = self.settings.delay_s
        rows: ChunkSource = self.surveyed_rows
        if delay_s is None:
            rows = FilledTimes(raw.source, raw.time_in_log)
        segments = compensated_segments(
            rows,
            raw.source.table.names,
            raw.channels,
            self.method,
            delay_s=delay_s,
            means_s=means_s,
        )
        if self.output.is_netcdf:
            return _with_seconds(segments, raw.source.time)
        return segments

    def findings(self, totals: Totals, style: OutputStyle) -> tuple[Finding, ...]:
        """Findings about the log and the compensation, without repetitions.

        Parameters
        ----------
        totals
            What was written.
        style
            How it was written.
        """
        table = self.raw.source.table
        if self.settings.delay_s is None:
            findings = [*self.raw.findings, *totals.findings]
            subjects = {f.subject for f in totals.findings if f.code.startswith("trace.")}
            findings += [f for f in _findings_of_rows(totals) if f.subject not in subjects]
        else:
            findings = delayed_findings(self.raw, self.rising_rows, totals)
        file = table if len(self.paths) == 1 else open_table(self.paths[0])
        findings += dialect_findings(file, self.output.path, style)
        findings += _findings_of_brief_table(self.raw, totals)
        findings += _findings_without_result(self.raw, totals)
        return unique_by_subject(table.at_files(findings))


def _progress_of_rows(progress: Progress) -> Callable[[int], None]:
    """A function to call with the number of rows that are done.

    It calls ``progress`` with the next row at the start, after ``PROGRESS_ROWS`` rows, and then
    each time that the number has doubled.
    """
    next_row = 0

    def report(rows: int) -> None:
        """Report the rows that are done, if it is time."""
        nonlocal next_row
        if rows >= next_row:
            progress(f"compensating, from row {rows + 1}")
            next_row = rows + max(rows, PROGRESS_ROWS)

    return report


def _findings_of_brief_table(raw: RawLog, totals: Totals) -> list[Finding]:
    """Warnings about channels with a lag that is longer than the table."""
    duration_s = max(totals.last_s - totals.first_s, 0.0)
    return [
        warning(
            "sensor.brief",
            subject=channel.column,
            duration_s=duration_s,
            lag_s=channel.chain.lag_s,
        )
        for channel in raw.channels.channels
        if duration_s < channel.chain.lag_s
    ]


def _findings_without_result(raw: RawLog, totals: Totals) -> list[Finding]:
    """An error if no column has a result."""
    units = raw.channels.units
    typical_u = totals.table(units).iloc[:, 2]
    if typical_u.isna().all():
        return [error("sensor.nothing", subject=", ".join(units))]
    return []


def _open_log(
    log: str | Path | Sequence[str | Path] | Source,
    calibrations: Calibrations,
    rig: Rig | None,
    options: CompensateOptions,
) -> tuple[RawLog, SeriesReport | None]:
    """The raw columns, channels and output of a log, and what was understood of its rows.

    The parameters are those of ``compensate_table``. A log with a delay is not looked at before: a
    log that is followed has no later rows.
    """
    if not isinstance(log, Source):
        files = files_of_log(log)
        table = open_log_table(files, calibrations, rig, options)
        raw = raw_log(files[0], table, calibrations, rig, options)
    elif isinstance(calibrations, Mapping):
        raise InputError("records with an opened table", expected="the file of a log of the rig")
    else:
        raw = raw_table(log, calibrations, options)
    if options.delay_s is not None:
        return checked_before_following(raw, raw.source.table), None
    return surveyed(raw, raw.source.table)


def _units_of_output(raw: RawLog) -> dict[str, str]:
    """Units of the columns of the output that the table or its channels state."""
    units = dict(raw.source.table.units)
    for column, unit in raw.channels.units.items():
        units[unit.names(column).result] = unit.output
    return units


def _with_seconds(
    segments: Iterator[CompensatedSegment], time: str
) -> Iterator[CompensatedSegment]:
    """The segments with times in seconds in the column ``time``, instead of those of the file."""
    for segment in segments:
        yield replace(segment, columns={**segment.columns, time: segment.output_time_s})


def _findings_of_rows(totals: Totals) -> list[Finding]:
    """How many readings of each column were not used: with a warning where they are many."""
    findings = []
    for column, (count, first_s) in totals.not_used.items():
        severity = warning if count > MANY_NOT_USED * totals.rows else info
        findings.append(
            severity(
                "rows.not_used", subject=column, count=count, rows=totals.rows, first_s=first_s
            )
        )
    return findings


def delayed_findings(raw: RawLog, rising: RisingRows, totals: Totals) -> list[Finding]:
    """Findings of a run with a fixed delay: of the log, of its rows ``rising``, and of ``totals``.

    Findings about single records of the smoother (``trace.``, ``noise.``) are about some hundred
    rows each. They are replaced by the number of readings that were not used.
    """
    findings = list(raw.findings)
    of_segments = ("trace.", "noise.")
    findings += [f for f in totals.findings if not f.code.startswith(of_segments)]
    findings += _findings_of_rows(totals)
    if rising.left_out:
        findings.append(warning("delay.backward", count=rising.left_out))
    return findings
