"""A log that is still growing, compensated row by row as it grows; stopped and begun again without losing a row."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from calibration.columns import KNOWN, match_columns
from calibration.errors import InputError
from calibration.files import open_table, shown
from calibration.files.csvtable import CsvTable
from calibration.files.dialect import ABSENT, FLAGS, HEAD_BYTES, is_number, split
from calibration.files.write import write_text
from calibration.log import COMPENSATED
from calibration.record import DiskRecord
from calibration.rig import Rig
from tcdyn.pipeline.causal import Causal, CausalState, Settings, begin
from tcdyn.pipeline.compensate import DECIMALS, kind_of_columns
from tcdyn.pipeline.records import rig_of

STATE = "tcdyn.follow/1"
MOST_BYTES = 1 << 19  # read at once: half a megabyte, a few thousand rows
SAVE_EVERY_S = 10.0


@dataclass(frozen=True)
class GrowingLog:
    """A text log whose header is known: which field of a row is which canonical column, and where the rows begin."""

    path: Path
    table: CsvTable
    kind: str
    disk: str | None
    places: dict[str, int]
    first_byte: int

    def row(self, line: str) -> list[float] | None:
        """The canonical columns of one line, NaN for what is no number; None for a line that is no row."""
        parts = split(line, self.table.dialect.separator)
        if len(parts) != self.table.dialect.fields:
            return None
        return [_number(parts[at], self.table.dialect.decimal) for at in self.places.values()]


@dataclass(frozen=True)
class FollowRun:
    """What was done: rows read and written, lines left out, why it ended, and the plan it was done with."""

    rows_read: int
    rows_written: int
    bad_lines: int
    ended: str
    plan: Causal | None
    warnings: tuple[str, ...]


def follow(
    log: str | Path,
    records: Mapping[str, DiskRecord],
    out: str | Path,
    rig: Rig | None = None,
    settings: Settings | None = None,
    *,
    state: str | Path | None = None,
    idle_s: float = 30.0,
    poll_s: float = 0.2,
    asked_to_stop: Callable[[], bool] = lambda: False,
    announce: Callable[[Causal], None] = lambda _: None,
    sleep: Callable[[float], None] = time.sleep,
) -> FollowRun:
    """Append the compensated rows of ``log`` to ``out`` while the log grows; ends after ``idle_s`` without growth.

    The first seconds (``settings.learn_s``) give sample interval and noise; then rows are written as they come, whole
    lines only. ``state``: a file from which a run that was stopped goes on, and to which this one writes where it
    stands, at the end and every ten seconds; ``out`` is cut back to what that file knows, so that no row is lost or
    doubled. ``announce`` is called with the plan before the first row is written.

    Raises InputError for a log that is no growing text table, is compensated already, became shorter, or is not the
    one of the state file; for an end before anything could be learnt.
    """
    run = _Run(Path(log), records, Path(out), rig or rig_of(records), settings or Settings(), idle_s, poll_s)
    run.stop, run.sleep, run.announce = asked_to_stop, sleep, announce
    return run.go(Path(state) if state else None)


class _Run:
    """One run from start or restart to its end."""

    def __init__(
        self,
        log: Path,
        records: Mapping[str, DiskRecord],
        out: Path,
        rig: Rig,
        settings: Settings,
        idle_s: float,
        poll_s: float,
    ) -> None:
        if not records:
            raise InputError("no record was given", remedy="add --record DISK.disk.json")
        if out.suffix.lower() != ".csv":
            raise InputError(f"ending {out.suffix!r}", where=str(out), expected=".csv: only a text file grows in place")
        if log.resolve() == out.resolve():
            raise InputError("log and output are the same file", where=str(out), remedy="name another --out")
        self.log, self.records, self.out, self.rig, self.settings = log, records, out, rig, settings
        self.idle_s, self.poll_s = idle_s, poll_s
        self.stop: Callable[[], bool] = lambda: False
        self.sleep: Callable[[float], None] = time.sleep
        self.announce: Callable[[Causal], None] = lambda _: None
        self.hash = hashlib.sha256()
        self.offset = self.rows = self.written = self.bad = self.out_bytes = 0
        self.saved_at = time.monotonic()
        self.still_since: float | None = None  # when a look first found nothing new

    def go(self, state_file: Path | None) -> FollowRun:
        """Wait for the header, begin or go on, follow to the end."""
        growing = self._wait_for_header()
        if growing is None:
            return self._result("stopped before the header was there", None)
        restored = self._restored(state_file, growing)
        if restored is None:
            learnt = self._learn(growing)
            if learnt is None:
                return self._result("stopped before anything was learnt; nothing was written", None)
            plan, state, rows = learnt
            self.announce(plan)
            stream = _opened(self.out, "wb")
            self._append(stream, _head(growing, plan))
        else:
            (plan, state), rows = restored, []
            self.announce(plan)
            stream = _opened(self.out, "r+b")
            stream.truncate(self.out_bytes)
            stream.seek(self.out_bytes)
        ended = ""
        with stream:
            while True:
                if rows:
                    state, done = plan.advance(state, np.array(rows))
                    self._append(stream, _lines(done))
                    self.written += len(done)
                if state_file and time.monotonic() - self.saved_at > SAVE_EVERY_S:
                    self._save(state_file, plan, state)
                if ended := self._why_end():
                    break
                rows = self._new_rows(growing)
        if state_file:
            self._save(state_file, plan, state)
        return self._result(ended, plan, state)

    def _wait_for_header(self) -> GrowingLog | None:
        """The header, once two whole rows stand below it: a half-written first row would mislead."""
        while True:
            problem: InputError | None = None
            try:
                if found := open_growing(self.log, self.rig, self.records):
                    self.still_since = None
                    return found
            except InputError as error:
                problem = error
                if self.log.exists() and self.log.stat().st_size > HEAD_BYTES:
                    raise
            self.still_since = self.still_since or time.monotonic()
            if ended := self._why_end():
                if problem is not None:
                    raise problem
                if ended.startswith("stopped"):
                    return None
                raise InputError("no two rows came below the header", where=shown(self.log))
            self.sleep(self.poll_s)

    def _learn(self, growing: GrowingLog) -> tuple[Causal, CausalState, list[list[float]]] | None:
        """Plan and state from the first seconds; all rows read so far are still to be advanced."""
        self._seek(growing.first_byte)
        rows: list[list[float]] = []
        names = list(growing.places)
        at = names.index("time_s")
        while not rows or not rows[-1][at] - rows[0][at] >= self.settings.learn_s:
            new = self._new_rows(growing)
            rows += new
            if not new and (ended := self._why_end()):
                if ended.startswith("stopped"):
                    return None
                raise InputError(
                    f"ended after {len(rows)} rows, before {self.settings.learn_s:g} s to learn from were there",
                    where=shown(self.log),
                    remedy="follow a longer log, or lower --learn-s",
                )
        inside = [r for r in rows if not r[at] - rows[0][at] > self.settings.learn_s]
        plan, state = begin(names, np.array(inside), growing.kind, self.records, self.rig, self.settings)
        return plan, state, rows

    def _new_rows(self, growing: GrowingLog) -> list[list[float]]:
        """Whole new lines as rows; an empty list after a pause when there are none."""
        size = self.log.stat().st_size if self.log.exists() else 0
        if size < self.offset:
            raise InputError("the log became shorter while it was followed", where=shown(self.log))
        with open(self.log, "rb") as stream:
            stream.seek(self.offset)
            new = stream.read(MOST_BYTES)
        whole = new[: new.rfind(b"\n") + 1]
        if not whole:
            self.still_since = self.still_since or time.monotonic()
            self.sleep(self.poll_s)
            return []
        self.still_since = None
        self.offset += len(whole)
        self.hash.update(whole)
        rows: list[list[float]] = []
        for line in whole.decode("latin-1").splitlines():
            if not line.strip():
                continue
            row = growing.row(line)
            if row is None:
                self.bad += 1
            else:
                rows.append(row)
        self.rows += len(rows)
        return rows

    def _seek(self, offset: int) -> None:
        with open(self.log, "rb") as stream:
            self.hash, left = hashlib.sha256(), offset
            while left and (part := stream.read(min(left, 1 << 20))):
                self.hash.update(part)
                left -= len(part)
        if left:
            raise InputError("the log is shorter than the state file remembers", where=shown(self.log))
        self.offset = offset

    def _why_end(self) -> str:
        if self.stop():
            return "stopped"
        still = self.still_since is not None and time.monotonic() - self.still_since > self.idle_s
        return f"no growth for {self.idle_s:g} s" if still else ""

    def _append(self, stream: IO[bytes], text: str) -> None:
        data = text.encode("utf-8")
        try:
            stream.write(data)
            stream.flush()
        except OSError as problem:
            stream.truncate(self.out_bytes)
            raise InputError(f"cannot be written ({problem.strerror})", where=str(self.out)) from None
        self.out_bytes += len(data)

    def _key(self) -> dict[str, Any]:
        records = {d: hashlib.sha256(r.to_json().encode()).hexdigest() for d, r in self.records.items()}
        return {"schema": STATE, "log": self.log.name, "records": records, "settings": vars(self.settings)}

    def _save(self, file: Path, plan: Causal, state: CausalState) -> None:
        where = {"offset": self.offset, "sha256": self.hash.hexdigest(), "rows": self.rows, "written": self.written}
        where |= {"bad": self.bad, "out_bytes": self.out_bytes}
        data = {**self._key(), "where": where, "plan": plan.learnt(), "state": state.to_json()}
        write_text(file, json.dumps(data) + "\n")
        self.saved_at = time.monotonic()

    def _restored(self, file: Path | None, growing: GrowingLog) -> tuple[Causal, CausalState] | None:
        """Plan and state as they were left, or None where there is no state file."""
        if file is None or not file.exists():
            return None
        anew = f"delete {file} and {self.out} to begin anew"
        try:
            data = json.loads(file.read_text(encoding="utf-8"))
            where, learnt, left = data["where"], data["plan"], data["state"]
            offset, digest, self.out_bytes = int(where["offset"]), str(where["sha256"]), int(where["out_bytes"])
            self.rows, self.written, self.bad = int(where["rows"]), int(where["written"]), int(where["bad"])
        except (OSError, ValueError, KeyError, TypeError) as problem:
            raise InputError(f"is no state of a followed log ({problem!r})", where=str(file), remedy=anew) from None
        for key, own in json.loads(json.dumps(self._key())).items():
            if data.get(key) != own:
                raise InputError(f"was written with another {key}", where=str(file), remedy=anew)
        self._seek(offset)
        if self.hash.hexdigest() != digest:
            raise InputError("is not the log that the state file remembers", where=shown(self.log), remedy=anew)
        if not self.out.exists() or self.out.stat().st_size < self.out_bytes:
            raise InputError("holds less than the state file remembers", where=str(self.out), remedy=anew)
        names = list(growing.places)
        plan = Causal.of(names, growing.kind, self.records, self.rig, self.settings, learnt)
        return plan, CausalState.from_json(left)

    def _result(self, ended: str, plan: Causal | None, state: CausalState | None = None) -> FollowRun:
        said = list(plan.warnings) if plan else []
        if self.bad:
            said.append(f"{self.bad} lines without the right number of fields were left out")
        if state is not None:
            said += state.said()
        return FollowRun(self.rows, self.written, self.bad, ended, plan, tuple(said))


def open_growing(path: Path, rig: Rig, records: Mapping[str, DiskRecord]) -> GrowingLog | None:
    """The log once its header and two whole rows stand in it; None before.

    Raises InputError for another format than text, for a log that is compensated already, and for missing columns.
    """
    if not path.exists() or path.stat().st_size == 0:
        return None
    where = shown(path)
    disk = next(iter(records))
    table = open_table(path, (*KNOWN, *rig.columns(disk).values()))
    if not isinstance(table, CsvTable) or table.body is not None:
        raise InputError("does not grow line by line", where=where, expected="a CSV log to follow (UTF-8)")
    if table.metadata.get("tcdyn") == COMPENSATED:
        raise InputError(
            "is compensated already",
            where=where,
            expected="a log as the logger wrote it",
            remedy="give the raw log; static lines and chain must not be applied twice",
        )
    if rig.tables(disk).logger.millivolts:
        raise InputError("is in millivolts by rig.toml [logger]", where=where, expected="degrees Celsius to follow")
    with open(path, "rb") as stream:
        head = [stream.readline() for _ in range(table.dialect.skip)]
        below = [stream.readline(), stream.readline()]
    if not all(line.endswith(b"\n") for line in below):
        return None
    kind, own = kind_of_columns(table.names, rig, records, where)
    chosen = match_columns(table.names, kind, where, rig.columns(own))
    places = {canonical: table.names.index(name) for canonical, name in chosen.items()}
    if not is_number(table.dialect.first_row[places["time_s"]], table.dialect.decimal):
        raise InputError(f"column {chosen['time_s']} holds no seconds", where=where, expected="time as a number")
    return GrowingLog(path, table, kind, own, places, sum(len(line) for line in head))


def _number(text: str, decimal: str) -> float:
    try:
        return float(text if decimal == "." else text.replace(",", "."))
    except ValueError:
        low = text.lower()
        return FLAGS.get(low, np.nan) if low not in ABSENT else np.nan


def _opened(path: Path, mode: str) -> IO[bytes]:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        stream: IO[bytes] = open(path, mode)  # noqa: SIM115
    except OSError as problem:
        raise InputError(f"cannot be written ({problem.strerror})", where=str(path)) from None
    return stream


def _head(growing: GrowingLog, plan: Causal) -> str:
    notes = {**growing.table.metadata, "tcdyn": COMPENSATED, "source": growing.path.name, **plan.notes()}
    lines = [f"# {' '.join(k.split()).replace(':', ' ')}: {' '.join(str(v).split())}\n" for k, v in notes.items()]
    return "".join(lines) + ",".join(plan.output_names) + "\n"


def _lines(rows: np.ndarray) -> str:
    rounded = np.round(rows, DECIMALS + 1)
    return "".join(",".join(["" if v != v else f"{v:.12g}" for v in row]) + "\n" for row in rounded.tolist())
