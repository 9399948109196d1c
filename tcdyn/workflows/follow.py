"""Live compensation of a growing log, row by row, with a state file to continue without loss."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, warning
from tcdyn.core.result import Result
from tcdyn.io.checksum import CHECKSUM_KEY, checksum
from tcdyn.io.csv_dialect import HEAD_BYTES
from tcdyn.io.growing import GrowingTable
from tcdyn.io.metadata import COMPENSATED
from tcdyn.io.read import display_path
from tcdyn.io.write import DialectName, OutputStyle, output_style, start_csv, write_text
from tcdyn.rig.opened_log import rig_from_records
from tcdyn.rig.rigfile import Rig
from tcdyn.workflows.appended_file import AppendedFile, digest
from tcdyn.workflows.live import LONGEST_GAP_S, LiveCompensator, LiveCompensatorState, LiveSettings
from tcdyn.workflows.log_source import Calibrations, GrowingLog, TableOptions, growing_log
from tcdyn.workflows.segments import DECIMALS
from tcdyn.workflows.warm_up import warm_up

STATE_SCHEMA = "tcdyn.follow/6"
STOPPED_BY_USER = "stopped"
SAVE_EVERY_S = 10.0


@dataclass(frozen=True)
class FollowRun(Result):
    """What was done: rows read and written, lines left out, why it ended, and the plan it was done
    with.
    """

    rows_read: int
    rows_written: int
    bad_lines: int
    ended: str
    plan: LiveCompensator | None
    findings: tuple[Finding, ...]

    def summary(self) -> str:
        """Why it ended, and how many rows there were."""
        return f"{self.ended}: {self.rows_read} rows read, {self.rows_written} written"

    def to_dict(self) -> dict[str, Any]:
        """Counts, why it ended and findings."""
        counts = {
            "rows_read": self.rows_read,
            "rows_written": self.rows_written,
            "bad_lines": self.bad_lines,
        }
        return {**counts, "ended": self.ended, "warnings": list(self.warnings)}


def follow(
    log: str | Path,
    records: Calibrations,
    out: str | Path,
    rig: Rig | None = None,
    settings: LiveSettings | None = None,
    *,
    options: TableOptions | None = None,
    state: str | Path | None = None,
    overwrite: bool = False,
    dialect: DialectName = "standard",
    comments: bool = False,
    idle_s: float = 30.0,
    poll_s: float = 0.2,
    asked_to_stop: Callable[[], bool] = lambda: False,
    announce: Callable[[LiveCompensator], None] = lambda _: None,
    sleep: Callable[[float], None] = time.sleep,
) -> FollowRun:
    """Append the compensated rows of ``log`` to ``out`` while the log grows; ends after ``idle_s``
    without growth.

    The first seconds (``settings.learn_s``) give sample interval and noise; then rows are written
    as they come, whole lines only. ``state``: a file from which a run that was stopped goes on, and
    to which this one writes where it stands, at the end and every ten seconds; ``out`` is cut back
    to what that file knows, so that no row is lost or doubled. Without such a file an ``out`` that
    exists is refused, unless ``overwrite`` says to replace it. ``announce`` is called with the plan
    before the first row is written. ``options``: what tells the time and the units of any table
    where its names do not. ``dialect`` and ``comments``: how ``out`` is written, as for
    ``tcdyn.io.write.output_style``.

    Raises InputError for a log that is no growing text table, is compensated already, or is not the
    one of the state file; for an end before anything could be learnt. While it follows: for a log
    that was replaced, rotated, truncated or rewritten, after all rows read before are written and
    the state is saved (a copy of the log with the same rows may take its place); for an output that
    was renamed, deleted or changed by another program.
    """
    if not records:
        raise InputError(
            "no record was given", remedy="add {records}", parameters={"records": "DISK.disk.json"}
        )
    log = Path(log)
    out = Path(out)
    settings = settings or LiveSettings()
    rig = rig or (rig_from_records(records) if isinstance(records, Mapping) else None)
    if out.suffix.lower() != ".csv":
        raise InputError(
            f"ending {out.suffix!r}",
            where=str(out),
            expected=".csv: only a text file grows in place",
        )
    if log.resolve() == out.resolve():
        raise InputError(
            "log and output are the same file",
            where=str(out),
            remedy="name another {out}",
            parameters={"out": None},
        )
    patience = _Patience(idle_s, poll_s, asked_to_stop, sleep)
    state = Path(state) if state else None
    continues = state is not None and state.exists()
    if not continues:
        _check_output_free(out, overwrite)
    source = _header(log, rig, records, options, patience)
    if source is None:
        return FollowRun(0, 0, 0, "stopped before the header was there", None, ())
    table = source.table
    style = output_style(dialect, comments, table.table, out)
    key = {**_key(source, records, settings), "dialect": dialect}
    rows: list[list[float]] = []
    if state is not None and continues:
        stored = _read_state(state, key, table, out)
        plan, compensator_state = _restore_plan(state, stored, source, settings, out)
        written = stored["where"]["written"]
        size = stored["where"]["out_bytes"]
    else:
        start = _warm_up_rows(source, settings, patience)
        if start is None:
            ended = "stopped before anything was learnt; nothing was written"
            return FollowRun(table.rows, 0, table.bad_lines, ended, None, ())
        (plan, compensator_state, rows) = start
        written = 0
        _check_output_free(
            out, overwrite
        )  # it may have come while the first seconds were waited for
        # what stood there stays until this is whole
        names = source.output_names(plan.output_names)
        size = start_csv(out, names, _notes(source, plan), style=style)
    announce(plan)
    saved_at = -np.inf  # at once, so that a run that is killed can be continued
    log_error: InputError | None = None
    with AppendedFile(out, size, written) as output:
        while True:
            if rows:
                compensator_state, output_rows = plan.advance(compensator_state, np.array(rows))
                output.append(
                    _lines(source.in_table_units(output_rows, plan.output_names), style),
                    len(output_rows),
                )
            else:
                output.check(0)
            ended = "the log was lost" if log_error else patience.ended()
            if state and (ended or time.monotonic() - saved_at > SAVE_EVERY_S):
                _save(
                    state,
                    {
                        **key,
                        "where": _where(table, output),
                        "plan": plan.warm_up_statistics(),
                        "state": compensator_state.to_json(),
                    },
                )
                saved_at = time.monotonic()
            if ended:
                break
            try:
                rows = _rows(source, patience)
            except (
                InputError
            ) as error:  # the log is not the same any more: what was read of it is kept
                log_error = error
                rows = []
        flushed = plan.flush(
            compensator_state
        )  # a run that goes on from the state file writes these rows again, then better known
        output.append(
            _lines(source.in_table_units(flushed, plan.output_names), style), len(flushed)
        )
        written = output.rows
    if log_error:
        raise InputError(
            f"{log_error.what}; the {written} rows before that are in {out}",
            where=log_error.where,
            expected=log_error.expected,
            remedy=log_error.remedy,
            parameters=log_error.parameters,
        )
    torn_lines = (warning("follow.torn", count=table.bad_lines),) if table.bad_lines else ()
    screening_findings = compensator_state.screening.findings(plan.junctions)
    return FollowRun(
        table.rows,
        written,
        table.bad_lines,
        ended,
        plan,
        (
            *source.findings,
            *plan.findings,
            *torn_lines,
            *screening_findings,
            *compensator_state.findings,
        ),
    )


def _check_output_free(out: Path, overwrite: bool) -> None:
    """Refuse an output that exists. Raises InputError."""
    if out.exists() and not overwrite:
        raise InputError(
            "the output exists already",
            where=str(out),
            expected="a file that does not exist yet",
            remedy="give another {out}, or replace it with {overwrite}, or continue the run that wrote it with "
            "its {state}",
            parameters={"out": "FILE", "overwrite": True, "state": "FILE"},
        )


@dataclass
class _Patience:
    """How long nothing may come before a run ends, and whether it was asked to stop."""

    idle_s: float
    poll_s: float
    asked_to_stop: Callable[[], bool]
    sleep: Callable[[float], None]
    since: float | None = None  # when a look first found nothing new

    def saw(self, something: bool) -> None:
        """Whether anything new was found; if not, wait a little."""
        if something:
            self.since = None
            return
        self.since = self.since or time.monotonic()
        self.sleep(self.poll_s)

    def ended(self) -> str:
        """Why the run ends now; empty when it does not."""
        if self.asked_to_stop():
            return STOPPED_BY_USER
        still = self.since is not None and time.monotonic() - self.since > self.idle_s
        return f"no growth for {self.idle_s:g} s" if still else ""


def _header(
    log: Path,
    rig: Rig | None,
    records: Calibrations,
    options: TableOptions | None,
    patience: _Patience,
) -> GrowingLog | None:
    """The log once it can be read; None when the run was stopped before. Raises what is wrong with
    its header.
    """
    while True:
        problem = InputError("no two rows came below the header", where=display_path(log))
        try:
            if source := growing_log(log, rig, records, options):
                patience.saw(True)
                return source
        except InputError as error:
            problem = error
            if log.exists() and log.stat().st_size > HEAD_BYTES:
                raise
        patience.saw(False)
        if ended := patience.ended():
            if ended == STOPPED_BY_USER:
                return None
            raise problem


def _rows(source: GrowingLog, patience: _Patience) -> list[list[float]]:
    """New rows of canonical columns; none after a pause."""
    rows = source.new_rows()
    patience.saw(rows is not None)
    return rows or []


def _warm_up_rows(
    source: GrowingLog, settings: LiveSettings, patience: _Patience
) -> tuple[LiveCompensator, LiveCompensatorState, list[list[float]]] | None:
    """Plan and state from the first seconds; all rows read so far are still to be advanced. None
    when stopped.
    """
    source.table.seek(source.table.first_byte)
    rows: list[list[float]] = []
    names = list(source.column_indices)
    time_index = names.index("time_s")
    while not (first_rows := _first_segment(rows, time_index, settings.learn_s)):
        new = _rows(source, patience)
        rows += new
        if not new and (ended := patience.ended()):
            if ended == STOPPED_BY_USER:
                return None
            raise InputError(
                f"ended after {len(rows)} rows, before {settings.learn_s:g} s to learn from were there",
                where=display_path(source.table.path),
                remedy="follow a longer log, or lower {learn_s}",
                parameters={"learn_s": None},
            )
    return (
        *warm_up(names, np.array(first_rows), source.channels, source.level_K2_s3, settings),
        rows,
    )


def _first_segment(rows: list[list[float]], time_index: int, learn_s: float) -> list[list[float]]:
    """The first rows that last ``learn_s`` [s] while the clock, column ``time_index``, does not
    jump; none while there are not so many.
    """
    first = 0
    last = np.nan
    longest_gap_s = max(
        LONGEST_GAP_S, 0.1 * learn_s
    )  # at least 17 rows are learnt from: more than a regular step
    for i, row in enumerate(rows):
        t = row[time_index]
        if not 0 <= t - last <= longest_gap_s and np.isfinite(t):
            first = i
        if t - rows[first][time_index] >= learn_s:
            return rows[first : i + (t - rows[first][time_index] == learn_s)]
        last = t if np.isfinite(t) else last
    return []


def _key(source: GrowingLog, records: Calibrations, settings: LiveSettings) -> dict[str, Any]:
    """What a state file must agree with."""
    texts = (
        {d: r.to_json() for d, r in records.items()}
        if isinstance(records, Mapping)
        else {f"{i} {s.sensor}": json.dumps(s.to_dict()) for i, s in enumerate(records)}
    )
    digests = {d: hashlib.sha256(text.encode()).hexdigest() for d, text in texts.items()}
    order = [c for channels in source.channels for c in channels.columns]  # of what is remembered
    fingerprint = {
        "units": {n: vars(u) for n, u in source.units.items()},
        "channels": order,
        "settings": vars(settings),
    }
    return {
        "schema": STATE_SCHEMA,
        "log": source.table.path.name,
        "records": digests,
        **fingerprint,
    }


def _where(table: GrowingTable, output: AppendedFile) -> dict[str, Any]:
    """How far log and output are."""
    read = {
        "offset": table.offset,
        "sha256": table.hash.hexdigest(),
        "rows": table.rows,
        "bad": table.bad_lines,
    }
    return {
        **read,
        "written": output.rows,
        "out_bytes": output.size,
        "out_sha256": output.hash.hexdigest(),
    }


def _save(file: Path, content: dict[str, Any]) -> None:
    """Write the state file, with a checksum of its content."""
    plain = json.loads(json.dumps(content))
    write_text(file, json.dumps({**plain, CHECKSUM_KEY: checksum(plain)}) + "\n")


def _restart_remedy(file: Path, out: Path) -> str:
    return f"to begin anew, keep {out}, delete {file} and give another {{out}}"


def _read_state(file: Path, key: dict[str, Any], table: GrowingTable, out: Path) -> dict[str, Any]:
    """What the state file holds, ``table`` set to where the run was left; InputError where anything
    is not its own.
    """
    anew: dict[str, Any] = {"remedy": _restart_remedy(file, out), "parameters": {"out": "FILE"}}
    try:
        data: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
        where, _, _ = data["where"], data["plan"], data["state"]
        table.rows, table.bad_lines, _ = (
            int(where["rows"]),
            int(where["bad"]),
            int(where["written"]),
        )
        offset = int(where["offset"])
        digest_of_log = str(where["sha256"])
        out_bytes = int(where["out_bytes"])
        digest_of_out = str(where["out_sha256"])
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as problem:
        raise InputError(
            f"is no state of a followed log ({problem!r})", where=str(file), **anew
        ) from None
    for name, expected in json.loads(json.dumps(key)).items():
        if data.get(name) != expected:
            raise InputError(f"was written with another {name}", where=str(file), **anew)
    if checksum({k: v for k, v in data.items() if k != CHECKSUM_KEY}) != data.get(CHECKSUM_KEY):
        raise InputError(
            "is damaged: its checksum does not fit its content", where=str(file), **anew
        )
    table.seek(offset)
    if table.hash.hexdigest() != digest_of_log:
        raise InputError(
            "is not the log that the state file remembers", where=display_path(table.path), **anew
        )
    if not out.exists() or out.stat().st_size < out_bytes:
        raise InputError("holds less than the state file remembers", where=str(out), **anew)
    if digest(out, out_bytes).hexdigest() != digest_of_out:
        raise InputError("is not the output that the state file remembers", where=str(out), **anew)
    return data


def _restore_plan(
    file: Path, stored: dict[str, Any], source: GrowingLog, settings: LiveSettings, out: Path
) -> tuple[LiveCompensator, LiveCompensatorState]:
    """Plan and state that the content of a state file describes; InputError for one that describes
    none.
    """
    try:
        plan = LiveCompensator.create(
            list(source.column_indices),
            source.channels,
            source.level_K2_s3,
            settings,
            stored["plan"],
        )
        compensator_state = LiveCompensatorState.from_json(stored["state"])
        plan.check_fits(compensator_state)
        return plan, compensator_state
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as problem:
        raise InputError(
            f"is damaged ({problem!r})",
            where=str(file),
            remedy=_restart_remedy(file, out),
            parameters={"out": "FILE"},
        ) from None


def _notes(source: GrowingLog, plan: LiveCompensator) -> dict[str, str]:
    """Metadata of the output."""
    table = source.table
    notes = {**table.table.metadata, "tcdyn": COMPENSATED, "source": table.path.name}
    return {**notes, **{key: str(value) for key, value in plan.notes().items()}}


def _lines(rows: np.ndarray, style: OutputStyle) -> str:
    """Rows as lines of text."""
    rounded = np.round(rows, DECIMALS + 1).tolist()
    lines = []
    for row in rounded:
        cells = ["" if v != v else f"{v:.12g}".replace(".", style.decimal) for v in row]
        lines.append(style.separator.join(cells) + style.line_end)
    return "".join(lines)
