"""Live compensation of a log while it grows: the fixed-delay run of the batch smoother on its rows.

``follow`` gives the rows that ``compensate_table(..., delay_s=...)`` gives for the finished log. A
state file (:mod:`tcdyn.workflows.follow_state`) lets a later run continue without a lost or doubled
row. Guarded by
``tests/smoothing/test_follow.py``, ``test_follow_files.py``, ``test_follow_clock.py`` and
``test_fixed_delay.py`` in the same folder.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pandas as pd

from tcdyn.core.arguments import check_type, with_named_arguments
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, unique_by_subject, warning
from tcdyn.core.options import options_of
from tcdyn.core.result import Result
from tcdyn.core.threads import one_blas_thread
from tcdyn.io.appended import AppendedFile
from tcdyn.io.endings import CSV, JSON, check_ending
from tcdyn.io.growing import ROW_END, GrowingText, check_can_grow
from tcdyn.io.metadata import metadata_path
from tcdyn.io.read import display_path
from tcdyn.io.table import CHUNK_ROWS, Columns
from tcdyn.io.write import OutputStyle, csv_rows, dialect_findings, output_style, start_csv
from tcdyn.rig.opened_log import check_any_given, rig_from_records
from tcdyn.rig.rigfile import Rig
from tcdyn.sensors.compensation import (
    CompensatedSegment,
    CompensationMethod,
    Totals,
    compensated_segments,
    text_columns,
)
from tcdyn.sensors.decimals import rounded_for_file
from tcdyn.series.report import SeriesReport
from tcdyn.series.source import RisingRows
from tcdyn.series.survey import SurveyedSource
from tcdyn.workflows.compensate_table import delayed_findings
from tcdyn.workflows.follow_log import (
    FollowedLog,
    Patience,
    start_time_metadata,
    wait_for_rows,
)
from tcdyn.workflows.follow_pace import Pace
from tcdyn.workflows.follow_state import Stand, StateFile, state_key
from tcdyn.workflows.options import FollowOptions
from tcdyn.workflows.raw_log import Given, RawLog, calibrations_of, survey_of

SAVE_EVERY_S = 10.0
# Usual delay: two lags, of which one is there after each row, so that a change of the temperature
# shows in the readings; at least so many seconds, in which a burst of a slip ring (below 0.5 s) and
# the readings on either side of it are seen. By the study in docs/validation.md.
USUAL_DELAY_LAGS = 2.0
LEAST_USUAL_DELAY_S = 2.0


@dataclass(frozen=True, repr=False)
class FollowRun(Result):
    """What was done.

    Attributes
    ----------
    rows_read, rows_written, bad_lines
        Rows read in this run; rows in the output; lines left out.
    ended
        Why it ended.
    delay_s
        Delay of the rows [s].
    computing_s
        Time of the processor for this run [s].
    log
        The log and its channels; None where its header was never there.
    numbers
        Noise and standard deviation of each column in this run.
    findings
        Findings.
    reading
        What was understood of the rows of this run; None where there are fewer than two.
    """

    rows_read: int
    rows_written: int
    bad_lines: int
    ended: str
    delay_s: float
    computing_s: float
    log: RawLog | None
    numbers: pd.DataFrame
    findings: tuple[Finding, ...]
    reading: SeriesReport | None = None

    def summary(self) -> str:
        """Why it ended, and how many rows there were."""
        return f"{self.ended}: {self.rows_read} rows read, {self.rows_written} written"

    def to_frame(self) -> pd.DataFrame:
        """Noise and standard deviation of each column."""
        return self.numbers.set_index("column")

    def to_dict(self) -> dict[str, Any]:
        """Counts, why it ended and findings."""
        return {
            "rows_read": self.rows_read,
            "rows_written": self.rows_written,
            "bad_lines": self.bad_lines,
            "delay_s": self.delay_s,
            "ended": self.ended,
            "columns": self.numbers.to_dict("records"),
            "reading": None if self.reading is None else self.reading.to_dict(),
            "warnings": list(self.warnings),
        }


@with_named_arguments
@one_blas_thread
def follow(
    log: str | Path,
    calibrations: Given,
    out: str | Path,
    rig: Rig | None = None,
    *,
    state: str | Path | None = None,
    overwrite: bool = False,
    poll_s: float = 0.2,
    asked_to_stop: Callable[[], bool] = lambda: False,
    announce: Callable[[RawLog, float], None] = lambda _log, _delay_s: None,
    falls_behind: Callable[[int], None] = lambda _rows: None,
    sleep: Callable[[float], None] = time.sleep,
    **options: Any,
) -> FollowRun:
    """Append the compensated rows of ``log`` to ``out`` while the log grows.

    Parameters
    ----------
    log
        A text table that grows line by line.
    calibrations, rig
        As for ``tcdyn.workflows.compensate_table.compensate_table``.
    out
        Output, .csv. One that exists is refused, unless ``overwrite`` or ``state`` is given.
    state
        JSON file in which the run notes every ten seconds, and at its end, where it stands. If it
        exists, the run that wrote it is continued, and ``out`` is cut back to what it states.
    overwrite
        Whether an existing output is replaced.
    poll_s
        It looks for new rows so often [s].
    asked_to_stop
        Returns whether the run is to end.
    announce
        Called with the log and the delay before the first row is written.
    falls_behind
        Called with the number of rows that wait, when the log grows faster than its rows are
        compensated.
    sleep
        Waits for a time [s].
    **options
        How the table is read, compensated and written, with which delay, and when the run ends: the
        fields of :class:`tcdyn.workflows.options.FollowOptions`.

    Raises
    ------
    InputError
        For a log that is no growing text table, such as a workbook, is compensated already, or is
        not the one of the state file. While it follows: for a log that was replaced, rotated,
        truncated or rewritten, after all rows read before are written and the state is saved (a
        copy of the log with the same rows may take its place); for an output that was renamed,
        deleted or changed by another program.

    Notes
    -----
    Rows at the end of the log, for which the delay has not passed when the run ends, are written
    with the rows that are there. A run that continues writes them again.
    """
    settings = options_of(FollowOptions, options, "follow")
    check_type("log", log, (str, Path), "the path of a table that grows")
    check_type("out", out, (str, Path), "the path of the output, .csv")
    used = calibrations_of(calibrations)
    check_any_given(used)
    if isinstance(used, Mapping):
        rig = rig or rig_from_records(used)
    files = _checked_files(Path(log), Path(out), state, overwrite)
    started_s = time.process_time()
    patience = Patience(settings.idle_s, poll_s, asked_to_stop, sleep)
    opened = wait_for_rows(files.log, used, rig, settings, patience)
    if opened is None:
        return _result_without_header(settings)
    run = _started_run(opened, files, settings, falls_behind)
    announce(run.raw, run.delay_s)
    run.write_rows(patience)
    run.check_log()
    return run.result(patience.ended, started_s)


@dataclass(frozen=True)
class _Files:
    """Files of a run.

    Attributes
    ----------
    log, out
        The log and the output.
    state
        File of the state; None: the run cannot be continued.
    overwrite
        Whether an output that exists is replaced.
    continues
        Whether the file of the state exists: the run that wrote it is continued.
    """

    log: Path
    out: Path
    state: Path | None
    overwrite: bool
    continues: bool

    def check_output_free(self) -> None:
        """Refuse an output that exists. Raises InputError."""
        if self.out.exists() and not self.overwrite:
            raise InputError(
                "the output exists already",
                where=str(self.out),
                expected="a file that does not exist yet",
                remedy="give another {out}, or replace it with {overwrite}, or continue the run "
                "that wrote it with its {state}",
                parameters={"out": "FILE", "overwrite": True, "state": "FILE"},
            )


def _checked_files(log: Path, out: Path, state: str | Path | None, overwrite: bool) -> _Files:
    """The files of a run, checked before the log is opened; the parameters are those of ``follow``.

    Raises
    ------
    InputError
        For endings of other formats, one file for log and output, and an output that exists.
    """
    check_ending(out, CSV)  # only a text file grows in place
    if state is not None:
        check_ending(state, JSON)
    if os.path.realpath(log) == os.path.realpath(out):
        raise InputError(
            "log and output are the same file",
            where=str(out),
            remedy="name another {out}",
            parameters={"out": None},
        )
    check_can_grow(log)
    state_path = Path(state) if state else None
    continues = state_path is not None and state_path.exists()
    files = _Files(log, out, state_path, overwrite, continues)
    if not continues:
        files.check_output_free()
    return files


def _result_without_header(settings: FollowOptions) -> FollowRun:
    """Result of a run that was stopped before the log had a header and rows."""
    return FollowRun(
        rows_read=0,
        rows_written=0,
        bad_lines=0,
        ended="stopped before the header was there",
        delay_s=settings.delay_s or 0.0,
        computing_s=0.0,
        log=None,
        numbers=pd.DataFrame(columns=["column"]),
        findings=(),
    )


def _started_run(
    opened: FollowedLog,
    files: _Files,
    settings: FollowOptions,
    falls_behind: Callable[[int], None],
) -> _Run:
    """Start a run, or continue that of the state file: the output is there with its header.

    Parameters
    ----------
    opened
        The log with its first rows.
    files
        Files of the run.
    settings
        Options of the run.
    falls_behind
        As of ``follow``.

    Raises
    ------
    InputError
        For an output that exists or cannot be written, two columns of the output with one name, and
        a state that does not fit.
    """
    growing, raw = opened.growing, opened.raw
    _check_times_are_known(opened, files)
    delay_s = _delay_s(raw, settings)
    style = output_style(settings.dialect, settings.comments, raw.source.table, files.out)
    method = CompensationMethod(rate=settings.rate, components=settings.components)
    header = raw.header(method)
    state = None
    if files.state is not None:
        choices = {"dialect": settings.dialect, "rate": settings.rate}
        key = {**state_key(raw, opened.calibrations, delay_s), **choices}
        state = StateFile(files.state, key)
    is_new = not files.out.exists()
    if state is not None and files.continues:
        stand = state.read(growing, files.out)
    else:
        files.check_output_free()  # it may have come while the header was waited for
        # what stood there stays until this is complete
        notes = {**raw.notes, "delay_s": f"{delay_s:g}", **start_time_metadata(growing, raw)}
        out_bytes = start_csv(files.out, header, notes, style=style)
        stand = Stand(growing.offset, None, 0, out_bytes, {})
    pace = Pace(falls_behind)
    return _Run(growing, raw, files.out, is_new, style, header, method, delay_s, state, stand, pace)


def _check_times_are_known(opened: FollowedLog, files: _Files) -> None:
    """Raise InputError for a state file with a log without a column of time."""
    has_time = opened.raw.time_in_log in opened.growing.dialect.names
    if files.state is not None and not has_time:
        raise InputError(
            "{state} with {dt_s}: the times of a run that continues are not known",
            where=display_path(files.log),
            remedy="leave {state} out, or follow a log with a column of time",
            parameters={"state": None, "dt_s": None},
        )


def _delay_s(raw: RawLog, settings: FollowOptions) -> float:
    """The delay of a run [s]: that of its options, or the usual one."""
    if settings.delay_s is not None:
        return settings.delay_s
    return max(USUAL_DELAY_LAGS * raw.channels.lag_s, LEAST_USUAL_DELAY_S)


@dataclass
class _Run:
    """A run whose output is there: its loop, and what it has read and written.

    Attributes
    ----------
    growing, raw
        The log: its reader, and its columns and channels.
    out, is_new
        The output, and whether there was none before.
    style, header
        How the output is written, and its columns.
    method, delay_s
        Method and delay [s].
    state
        File of the state; None: it is not saved.
    stand
        Where the run stands.
    pace
        Whether the run keeps up.
    rows_written
        Rows in the output after the run.
    saved_at_s
        When the state was saved last [s of ``time.monotonic``].
    rising_rows
        Rows of the log whose time is not before that of an earlier row.
    surveyed_rows
        The same rows, which are surveyed as they come.
    totals
        What was compensated in this run.
    """

    growing: GrowingText
    raw: RawLog
    out: Path
    is_new: bool
    style: OutputStyle
    header: list[str]
    method: CompensationMethod
    delay_s: float
    state: StateFile | None
    stand: Stand
    pace: Pace
    rows_written: int = 0
    saved_at_s: float = -float("inf")  # at once, so that a run that is killed can be continued
    rising_rows: RisingRows = field(init=False)
    surveyed_rows: SurveyedSource = field(init=False)
    totals: Totals = field(init=False)

    def __post_init__(self) -> None:
        """Prepare the reading of the rows."""
        self.rising_rows = RisingRows(self.raw.source)
        self.surveyed_rows = SurveyedSource(
            self.rising_rows, self.raw.channels.raw_columns, survey_of(self.raw)
        )
        self.totals = Totals(decimals=self.stand.decimals)

    def write_rows(self, patience: Patience) -> None:
        """Compensate and append the rows as they come, until the log ends or the run is to end.

        Parameters
        ----------
        patience
            Decides when the run ends.

        Raises
        ------
        InputError
            For rows that cannot be read, and an output that another program changed.
        """
        state_path = None if self.state is None else self.state.path
        with (
            _removed_without_rows(self.out, state_path) if self.is_new else nullcontext(),
            AppendedFile(self.out, self.stand.out_bytes, self.stand.written) as output,
        ):
            self.growing.go_on = lambda has_new: patience.goes_on(has_new, output)
            self._append_segments(output)
            self.rows_written = output.rows

    def _append_segments(self, output: AppendedFile) -> None:
        """Append all segments to the output, and save the state after some of them."""
        segments = compensated_segments(
            self.surveyed_rows,
            [*self.raw.source.table.names, ROW_END],
            self.raw.channels,
            self.method,
            delay_s=self.delay_s,
            position=self.stand.position,
            delayed=self.stand.delayed,
        )
        for result in segments:
            if result.segment.is_last:
                self._save(output)  # a run that continues writes the rows of this segment again
                self._append(result, output)
                return
            self._append(result, output)
            self.stand = self.stand.after(result, output, self.totals.decimals)
            waiting = self.growing.rows - self.totals.rows + self.growing.waiting_rows()
            self.pace.look(time.monotonic(), waiting)
            if time.monotonic() - self.saved_at_s > SAVE_EVERY_S:
                self._save(output)
        self._save(output)

    def _append(self, result: CompensatedSegment, output: AppendedFile) -> None:
        """Append the rows of a segment to the output."""
        self.totals.add(result)
        frame = rounded_for_file(result.frame(self.header), self.totals.decimals, self.out)
        text = text_columns(result, self.header)
        output.append(csv_rows(frame, text, self.style), len(frame))

    def _save(self, output: AppendedFile) -> None:
        """Write where the run stands to the file of the state, if there is one."""
        if self.state is not None:
            self.state.write(self.growing, self.stand, output)
            self.saved_at_s = time.monotonic()

    def check_log(self) -> None:
        """Raise InputError if the log could not be read on: it was replaced or rewritten."""
        problem = self.growing.problem
        if problem is not None:
            raise InputError(
                f"{problem.what}; the {self.rows_written} rows before that are in {self.out}",
                where=problem.where,
                expected=problem.expected,
                remedy=problem.remedy,
                parameters=problem.parameters,
            )

    def result(self, ended: str, started_s: float) -> FollowRun:
        """What was done.

        Parameters
        ----------
        ended
            Why the run ended.
        started_s
            When it started [s of ``time.process_time``].
        """
        growing = self.growing
        findings = delayed_findings(self.raw, self.rising_rows, self.totals)
        findings += dialect_findings(self.raw.source.table, self.out, self.style, grows=True)
        if self.pace.most:
            findings.append(warning("follow.behind", rows=self.pace.most))
        if growing.bad_lines:
            findings.append(warning("follow.torn", count=growing.bad_lines))
        return FollowRun(
            growing.rows,
            self.rows_written,
            growing.bad_lines,
            ended,
            self.delay_s,
            time.process_time() - started_s,
            _without_reader(self.raw),
            self.totals.table(self.raw.channels.units),
            unique_by_subject(findings),
            self.surveyed_rows.report(),
        )


@contextmanager
def _removed_without_rows(out: Path, state: Path | None) -> Iterator[None]:
    """Delete a new output that gets no row because the block fails; one that was replaced remains.

    Parameters
    ----------
    out
        The output, with its header.
    state
        File of the state; where it exists, the output can be continued and is not deleted.
    """
    bytes_before = out.stat().st_size
    try:
        yield
    except BaseException:
        with suppress(OSError):
            can_continue = state is not None and state.exists()
            if not can_continue and out.stat().st_size == bytes_before:
                out.unlink()
                metadata_path(out).unlink(missing_ok=True)
        raise


def _without_reader(raw: RawLog) -> RawLog:
    """The log without its reader, which has come to an end: its table has no rows."""
    table = replace(raw.source.table, chunks=_no_rows)
    return replace(raw, source=replace(raw.source, table=table))


def _no_rows(columns: Sequence[str], rows: int = CHUNK_ROWS) -> Iterator[Columns]:
    """Chunks of a table without rows."""
    return iter(())
