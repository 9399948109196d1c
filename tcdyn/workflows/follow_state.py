"""State of a followed log: where a run stands, in a JSON file from which a later run continues.

Used by :mod:`tcdyn.workflows.follow`. Guarded by ``tests/smoothing/test_follow.py`` and
``tests/smoothing/test_follow_files.py``.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tcdyn.core.errors import DAMAGED, InputError, utf8
from tcdyn.io.appended import AppendedFile, digest
from tcdyn.io.checksum import CHECKSUM_KEY, checksum
from tcdyn.io.growing import ROW_END, GrowingText
from tcdyn.io.read import display_path
from tcdyn.io.stored import STATE, check_schema, read_json
from tcdyn.io.write import write_text
from tcdyn.sensors.compensation import CompensatedSegment
from tcdyn.sensors.delayed import DelayedSmoother
from tcdyn.sensors.segments import SegmentPosition
from tcdyn.workflows.raw_log import Calibrations, RawLog


@dataclass(frozen=True)
class Stand:
    """Where a run stands.

    Attributes
    ----------
    offset
        Position in the log of the first row that the next segment needs [bytes].
    position
        Position of the reading; None before the first segment.
    written
        Rows written.
    out_bytes
        Size of the output [bytes].
    decimals
        Number of decimals by column of the output.
    delayed
        What the last segment passed on to the next one; None before the first.
    """

    offset: int
    position: SegmentPosition | None
    written: int
    out_bytes: int
    decimals: dict[str, int]
    delayed: DelayedSmoother | None = None

    def after(
        self, result: CompensatedSegment, output: AppendedFile, decimals: dict[str, int]
    ) -> Stand:
        """Where it stands after a segment that was written.

        Parameters
        ----------
        result
            The segment.
        output
            The output, to which it was appended.
        decimals
            Number of decimals by column.
        """
        segment = result.segment
        first = segment.keep.stop - segment.position.history_rows
        offset = self.offset
        if first > 0:
            offset = int(segment.data[ROW_END][first - 1])
        return Stand(offset, segment.position, output.rows, output.size, decimals, result.delayed)


def state_key(raw: RawLog, calibrations: Calibrations, delay_s: float) -> dict[str, Any]:
    """What a state file must agree with: log, records, units, channels and delay of the run.

    Parameters
    ----------
    raw
        The log.
    calibrations
        Records by disk, or sensors.
    delay_s
        The delay [s].
    """
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


@dataclass(frozen=True)
class StateFile:
    """The file with the state of a run.

    Attributes
    ----------
    path
        The file.
    key
        What the run that continues must agree with, see ``state_key``.
    """

    path: Path
    key: Mapping[str, Any]

    def write(self, growing: GrowingText, stand: Stand, output: AppendedFile) -> None:
        """Write the file, with a checksum of its content.

        Parameters
        ----------
        growing
            The log; its position and checksum are stored.
        stand
            Where the run stands.
        output
            The output; its checksum is stored.
        """
        content = {
            **self.key,
            "opened_bytes": growing.opened_bytes,
            "read": {"bytes": growing.offset, "sha256": growing.hash.hexdigest()},
            "offset": stand.offset,
            "position": None if stand.position is None else asdict(stand.position),
            "written": stand.written,
            "out_bytes": stand.out_bytes,
            "out_sha256": output.hash.hexdigest(),
            "decimals": stand.decimals,
            "smoother": None if stand.delayed is None else stand.delayed.to_dict(),
        }
        plain = json.loads(json.dumps(content))
        write_text(self.path, json.dumps({**plain, CHECKSUM_KEY: checksum(plain)}) + "\n")

    def read(self, growing: GrowingText, out: Path) -> Stand:
        """Where the run stood that wrote the file; the log is set to be read from there.

        Parameters
        ----------
        growing
            The log.
        out
            The output.

        Raises
        ------
        InputError
            For a damaged file, and where the log, the output or the options are not those of the
            run that wrote it.
        """
        data = self._content(out)
        try:
            opened_bytes = int(data["opened_bytes"])
            read_bytes = int(data["read"]["bytes"])
            digest_of_log = str(data["read"]["sha256"])
            digest_of_out = str(data["out_sha256"])
            stand = _stand_of(data)
        except DAMAGED as problem:
            what = f"is no state of a followed log ({problem!r})"
            raise self._error(what, str(self.path), out) from None
        growing.seek(read_bytes)
        if growing.hash.hexdigest() != digest_of_log:
            what = "is not the log that the state file remembers"
            raise self._error(what, display_path(growing.path), out)
        growing.seek(stand.offset)
        growing.opened_bytes = opened_bytes
        if not out.exists() or out.stat().st_size < stand.out_bytes:
            raise self._error("holds less than the state file remembers", str(out), out)
        if digest(out, stand.out_bytes).hexdigest() != digest_of_out:
            raise self._error("is not the output that the state file remembers", str(out), out)
        return stand

    def _content(self, out: Path) -> dict[str, Any]:
        """The content of the file, whose checksum and key are checked. Raises InputError."""
        where = str(self.path)
        try:
            data = read_json(self.path, STATE)
            check_schema(data, where, STATE)
        except InputError as problem:
            raise InputError(
                problem.what,
                where=where,
                expected=problem.expected,
                remedy=f"{problem.remedy}; or, {self._how_to_begin_anew(out)}",
                parameters={"out": "FILE"},
            ) from None
        content = {name: value for name, value in data.items() if name != CHECKSUM_KEY}
        if checksum(content) != data.get(CHECKSUM_KEY):
            what = "is damaged: its checksum does not fit its content"
            raise self._error(what, where, out)
        for name, expected in json.loads(json.dumps(self.key)).items():
            if data.get(name) != expected:
                raise self._error(f"was written with another {name}", where, out)
        return data

    def _how_to_begin_anew(self, out: Path) -> str:
        """Remedy for a file from which no run can continue."""
        return f"to begin anew, keep {out}, delete {self.path} and give another {{out}}"

    def _error(self, what: str, where: str, out: Path) -> InputError:
        """The error of a file from which no run can continue.

        Parameters
        ----------
        what
            What is wrong.
        where
            With which file.
        out
            The output.
        """
        remedy = self._how_to_begin_anew(out)
        return InputError(what, where=where, remedy=remedy, parameters={"out": "FILE"})


def _stand_of(data: Mapping[str, Any]) -> Stand:
    """Where a run stood by the content of its file; raises one of ``DAMAGED`` for another one."""
    position = None
    if data["position"] is not None:
        place = data["position"]
        rows = (int(place["done_rows"]), int(place["history_rows"]))
        position = SegmentPosition(float(place["interval_s"]), *rows)
    decimals = {str(name): int(count) for name, count in data["decimals"].items()}
    written = int(data["written"])
    delayed = None
    if data["smoother"] is not None:
        delayed = DelayedSmoother.from_dict(data["smoother"])
    return Stand(int(data["offset"]), position, written, int(data["out_bytes"]), decimals, delayed)
