"""Live compensation of a log while it grows: the fixed-delay run of the batch smoother on its rows.

``follow`` gives the rows that ``compensate_table(..., delay_s=...)`` gives for the finished log. A
state file lets a later run continue without a lost or doubled row. Guarded by
``tests/smoothing/test_follow.py``, ``test_follow_files.py``, ``test_follow_clock.py`` and
``test_fixed_delay.py`` in the same folder.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tcdyn.core.arguments import check_type, with_named_arguments
from tcdyn.core.errors import DAMAGED, InputError, utf8
from tcdyn.core.findings import Finding, unique_by_subject, warning
from tcdyn.core.options import options_of
from tcdyn.core.result import Result
from tcdyn.core.threads import one_blas_thread
from tcdyn.io.appended import AppendedFile, digest
from tcdyn.io.cells import is_number, number_and_unit
from tcdyn.io.checksum import CHECKSUM_KEY, checksum
from tcdyn.io.csv_dialect import HEAD_BYTES
from tcdyn.io.endings import CSV, JSON, check_ending
from tcdyn.io.growing import ROW_END, GrowingText, check_can_grow, open_growing
from tcdyn.io.metadata import START_TIME_KEY, metadata_path
from tcdyn.io.read import display_path
from tcdyn.io.stamps import is_stamp
from tcdyn.io.start_time import start_time
from tcdyn.io.stored import STATE, check_schema, read_json
from tcdyn.io.table import CHUNK_ROWS, Columns
from tcdyn.io.write import csv_rows, dialect_findings, output_style, start_csv, write_text
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
from tcdyn.sensors.given import with_column
from tcdyn.sensors.segments import SegmentPosition
from tcdyn.series.report import SeriesReport
from tcdyn.series.source import RisingRows, source_of_table
from tcdyn.series.survey import SurveyedSource
from tcdyn.workflows.compensate_table import delayed_findings
from tcdyn.workflows.options import FollowOptions, LogOptions
from tcdyn.workflows.raw_log import (
    Calibrations,
    Given,
    RawLog,
    calibrations_of,
    checked_before_following,
    open_log_table,
    raw_log,
    survey_of,
)

STOPPED_BY_USER = "stopped"
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
    log = Path(log)
    out = Path(out)
    if isinstance(used, Mapping):
        rig = rig or rig_from_records(used)
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
    computing_s = time.process_time()
    patience = _Patience(settings.idle_s, poll_s, asked_to_stop, sleep)
    state = Path(state) if state else None
    continues = state is not None and state.exists()
    if not continues:
        _check_output_free(out, overwrite)
    opened = _wait_for_rows(log, used, rig, settings, patience)
    if opened is None:
        ended = "stopped before the header was there"
        numbers = pd.DataFrame(columns=["column"])
        return FollowRun(0, 0, 0, ended, settings.delay_s or 0.0, 0.0, None, numbers, ())
    growing, raw, used = opened
    if state is not None and raw.time_in_log not in growing.dialect.names:
        raise InputError(
            "{state} with {dt_s}: the times of a run that continues are not known",
            where=display_path(log),
            remedy="leave {state} out, or follow a log with a column of time",
            parameters={"state": None, "dt_s": None},
        )
    delay_s = settings.delay_s
    if delay_s is None:
        delay_s = max(USUAL_DELAY_LAGS * raw.channels.lag_s, LEAST_USUAL_DELAY_S)
    style = output_style(settings.dialect, settings.comments, raw.source.table, out)
    method = CompensationMethod(rate=settings.rate)
    header = raw.header(method)
    choices = {"dialect": settings.dialect, "rate": settings.rate}
    key = {**_state_key(raw, used, delay_s), **choices}
    is_new = not out.exists()
    if state is not None and continues:
        stand = _read_state(state, key, growing, out)
    else:
        _check_output_free(out, overwrite)  # it may have come while the header was waited for
        # what stood there stays until this is complete
        notes = {**raw.notes, "delay_s": f"{delay_s:g}", **_start_time_metadata(growing, raw)}
        out_bytes = start_csv(out, header, notes, style=style)
        stand = _Stand(growing.offset, None, 0, out_bytes, {})
    announce(raw, delay_s)
    rising = RisingRows(raw.source)
    seen = SurveyedSource(rising, raw.channels.raw_columns, survey_of(raw))
    totals = Totals(decimals=stand.decimals)
    with (
        _removed_without_rows(out, state) if is_new else nullcontext(),
        AppendedFile(out, stand.out_bytes, stand.written) as output,
    ):
        growing.go_on = lambda has_new: patience.goes_on(has_new, output)
        segments = compensated_segments(
            seen,
            [*raw.source.table.names, ROW_END],
            raw.channels,
            method,
            delay_s=delay_s,
            position=stand.position,
        )
        saved_at = -float("inf")  # at once, so that a run that is killed can be continued
        for result in segments:
            if result.segment.is_last and state:  # a run that continues writes these rows again
                _write_state(state, key, growing, stand, output)
            totals.add(result)
            frame = rounded_for_file(result.frame(header), totals.decimals, out)
            text = text_columns(result, header)
            output.append(csv_rows(frame, text, style), len(frame))
            if result.segment.is_last:
                break
            stand = stand.after(result, output, totals.decimals)
            if state and time.monotonic() - saved_at > SAVE_EVERY_S:
                _write_state(state, key, growing, stand, output)
                saved_at = time.monotonic()
        else:
            if state:
                _write_state(state, key, growing, stand, output)
        written = output.rows
    if growing.problem:
        problem = growing.problem
        raise InputError(
            f"{problem.what}; the {written} rows before that are in {out}",
            where=problem.where,
            expected=problem.expected,
            remedy=problem.remedy,
            parameters=problem.parameters,
        )
    findings = delayed_findings(raw, rising, totals)
    findings += dialect_findings(raw.source.table, out, style, grows=True)
    if growing.bad_lines:
        findings.append(warning("follow.torn", count=growing.bad_lines))
    return FollowRun(
        growing.rows,
        written,
        growing.bad_lines,
        patience.ended,
        delay_s,
        time.process_time() - computing_s,
        _without_reader(raw),
        totals.table(raw.channels.units),
        unique_by_subject(findings),
        seen.report(),
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


def _check_output_free(out: Path, overwrite: bool) -> None:
    """Refuse an output that exists. Raises InputError."""
    if out.exists() and not overwrite:
        raise InputError(
            "the output exists already",
            where=str(out),
            expected="a file that does not exist yet",
            remedy="give another {out}, or replace it with {overwrite}, or continue the run "
            "that wrote it with its {state}",
            parameters={"out": "FILE", "overwrite": True, "state": "FILE"},
        )


@dataclass
class _Patience:
    """How long nothing may come before a run ends, and whether it was asked to stop.

    ``ended``: why the run ends; empty while it does not.
    """

    idle_s: float
    poll_s: float
    asked_to_stop: Callable[[], bool]
    sleep: Callable[[float], None]
    since: float | None = None  # when a look first found nothing new
    ended: str = ""

    def goes_on(self, has_new: bool, output: AppendedFile | None = None) -> bool:
        """Whether to look again, after a pause if there was nothing new; checks the output then."""
        if has_new:
            self.since = None
        elif output is not None:
            output.check(0)
        if self.asked_to_stop():
            self.ended = STOPPED_BY_USER
            return False
        if has_new:
            return True
        self.since = self.since or time.monotonic()
        if time.monotonic() - self.since > self.idle_s:
            self.ended = f"no growth for {self.idle_s:g} s"
            return False
        self.sleep(self.poll_s)
        return True


def _wait_for_rows(
    log: Path,
    calibrations: Calibrations,
    rig: Rig | None,
    options: LogOptions,
    patience: _Patience,
) -> tuple[GrowingText, RawLog, Calibrations] | None:
    """Wait until a log has two rows; None when the run was stopped before.

    A sensor that is given without its column gets that of the log.

    Parameters
    ----------
    log
        The log, which may not exist yet.
    calibrations, rig, options
        As for ``follow``.
    patience
        How often and how long to look.

    Raises
    ------
    InputError
        For what is wrong with its header or first row.
    """
    while True:
        problem = InputError("no two rows came below the header", where=display_path(log))
        try:
            if log.exists() and log.stat().st_size > 0:
                complete = open_log_table(log, calibrations, rig, options)
                opened = open_growing(complete, log)
                if opened is not None:
                    growing, table = opened
                    if not isinstance(calibrations, Mapping) and not options.columns:
                        # before the growing table, of which each row is read once
                        there_now = source_of_table(log, complete, (), options.rows)
                        calibrations = with_column(calibrations, there_now)
                    raw = raw_log(log, table, calibrations, rig, options)
                    there = raw_log(log, complete, calibrations, rig, options)
                    raw = checked_before_following(raw, there.source.table)
                    _start_time_metadata(growing, raw)
                    patience.goes_on(has_new=True)
                    return growing, raw, calibrations
        except InputError as error:
            problem = error
            if log.exists() and log.stat().st_size > HEAD_BYTES:
                raise
        if not patience.goes_on(has_new=False):
            if patience.ended == STOPPED_BY_USER:
                return None
            raise problem


def _start_time_metadata(growing: GrowingText, raw: RawLog) -> dict[str, str]:
    """Metadata with the date and time of the first row; empty if the log states none.

    Raises InputError for a time column that holds neither numbers nor clock stamps.
    """
    dialect = growing.dialect
    first_cells = dict(zip(dialect.names, dialect.first_row))
    name = raw.time_in_log
    if name not in first_cells:  # the times are those of a sampling interval
        return {}
    cell = first_cells[name]
    if is_number(cell, dialect.decimal) or number_and_unit(cell, dialect.decimal)[1]:
        return {}
    if not is_stamp(cell):
        raise InputError(
            f"column {name} holds no time ({cell!r})",
            where=display_path(growing.path),
            expected="a unit of time as a number, or clock times",
        )
    cells = {column: np.array([text], dtype=object) for column, text in first_cells.items()}
    start = start_time(cells, name, np.zeros(1))
    return {START_TIME_KEY: start} if start else {}


@dataclass(frozen=True)
class _Stand:
    """Where a run stands: position in the log of the first row that the next block needs [bytes],
    position of the reading, rows written, size of the output [bytes], and number of decimals by
    column of the output.
    """

    offset: int
    position: SegmentPosition | None
    written: int
    out_bytes: int
    decimals: dict[str, int]

    def after(
        self, result: CompensatedSegment, output: AppendedFile, decimals: dict[str, int]
    ) -> _Stand:
        """Where it stands after a segment that was written."""
        segment = result.segment
        first = segment.keep.stop - segment.position.history_rows
        offset = self.offset
        if first > 0:
            offset = int(segment.data[ROW_END][first - 1])
        return _Stand(offset, segment.position, output.rows, output.size, decimals)


def _state_key(raw: RawLog, calibrations: Calibrations, delay_s: float) -> dict[str, Any]:
    """What a state file must agree with: log, records, units, channels and delay of the run."""
    if isinstance(calibrations, Mapping):
        texts = {disk: record.to_json() for disk, record in calibrations.items()}
    else:
        # the time at which the lag was stated is not what a run depends on
        texts = {
            f"{i} {s.sensor}": s.model_dump_json(by_alias=True, exclude={"created"})
            for i, s in enumerate(calibrations)
        }
    return {
        "schema": STATE.schema,
        "log": utf8(raw.source.path.name),
        "records": {d: hashlib.sha256(text.encode()).hexdigest() for d, text in texts.items()},
        "units": {name: vars(unit) for name, unit in raw.channels.units.items()},
        "channels": list(raw.channels.units),
        "reading": asdict(raw.source.options),
        "delay_s": delay_s,
    }


def _write_state(
    file: Path, key: dict[str, Any], growing: GrowingText, stand: _Stand, output: AppendedFile
) -> None:
    """Write the state file, with a checksum of its content.

    Parameters
    ----------
    file
        The state file.
    key
        What a later run must agree with, see ``_state_key``.
    growing
        The log; its position and checksum are stored.
    stand
        Where the run stands.
    output
        The output; its checksum is stored.
    """
    content = {
        **key,
        "opened_bytes": growing.opened_bytes,
        "read": {"bytes": growing.offset, "sha256": growing.hash.hexdigest()},
        "offset": stand.offset,
        "position": None if stand.position is None else asdict(stand.position),
        "written": stand.written,
        "out_bytes": stand.out_bytes,
        "out_sha256": output.hash.hexdigest(),
        "decimals": stand.decimals,
    }
    plain = json.loads(json.dumps(content))
    write_text(file, json.dumps({**plain, CHECKSUM_KEY: checksum(plain)}) + "\n")


def _read_state(file: Path, key: dict[str, Any], growing: GrowingText, out: Path) -> _Stand:
    """Where the run stood that wrote a state file; the log is set to be read from there.

    Raises InputError where anything is not its own.
    """
    begin_anew = f"to begin anew, keep {out}, delete {file} and give another {{out}}"
    anew: dict[str, Any] = {"remedy": begin_anew, "parameters": {"out": "FILE"}}
    try:
        data = read_json(file, STATE)
        check_schema(data, str(file), STATE)
    except InputError as problem:
        raise InputError(
            problem.what,
            where=str(file),
            expected=problem.expected,
            remedy=f"{problem.remedy}; or, {begin_anew}",
            parameters=anew["parameters"],
        ) from None
    if checksum({k: v for k, v in data.items() if k != CHECKSUM_KEY}) != data.get(CHECKSUM_KEY):
        raise InputError(
            "is damaged: its checksum does not fit its content", where=str(file), **anew
        )
    for name, expected in json.loads(json.dumps(key)).items():
        if data.get(name) != expected:
            raise InputError(f"was written with another {name}", where=str(file), **anew)
    try:
        opened_bytes = int(data["opened_bytes"])
        read_bytes = int(data["read"]["bytes"])
        digest_of_log = str(data["read"]["sha256"])
        digest_of_out = str(data["out_sha256"])
        position = None
        if data["position"] is not None:
            place = data["position"]
            rows = (int(place["done_rows"]), int(place["history_rows"]))
            position = SegmentPosition(float(place["interval_s"]), *rows)
        decimals = {str(name): int(count) for name, count in data["decimals"].items()}
        written = int(data["written"])
        stand = _Stand(int(data["offset"]), position, written, int(data["out_bytes"]), decimals)
    except DAMAGED as problem:
        raise InputError(
            f"is no state of a followed log ({problem!r})", where=str(file), **anew
        ) from None
    growing.seek(read_bytes)
    if growing.hash.hexdigest() != digest_of_log:
        raise InputError(
            "is not the log that the state file remembers",
            where=display_path(growing.path),
            **anew,
        )
    growing.seek(stand.offset)
    growing.opened_bytes = opened_bytes
    if not out.exists() or out.stat().st_size < stand.out_bytes:
        raise InputError("holds less than the state file remembers", where=str(out), **anew)
    if digest(out, stand.out_bytes).hexdigest() != digest_of_out:
        raise InputError("is not the output that the state file remembers", where=str(out), **anew)
    return stand
