"""Logs too long for memory: the same checks as ``read_log``, piece by piece."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from calibration.columns import Kind
from calibration.errors import InputError
from calibration.logs import open_log, trace_frame
from calibration.rigfile import Rig
from calibration.table import Columns, FloatArray, RowNumbers, shown

MARGIN = 16  # rows seen again with the next piece, so that spikes and gaps at the seam are found


@dataclass(frozen=True)
class LogPiece:
    """A stretch of a log: canonical frame, sample interval [s], what was noticed in it."""

    frame: pd.DataFrame
    dt_s: float
    warnings: tuple[str, ...]


def iter_log(
    path: str | Path, kind: Kind, rig: Rig | None = None, disk: str | None = None, *, rows: int = 50_000
) -> Iterator[LogPiece]:
    """Pieces of a log in time order; put together they are ``read_log``'s frame.

    CSV (2 MB of text at most in a piece), Parquet and TDMS are read in bounded memory; LVM and UTF-16 text are read
    at once. What only the whole test can show (does the switch move, is there an unloading, is a channel dead) is
    checked after the last piece.

    Raises InputError as ``read_log`` does; for an oven log, which is always short.
    """
    if kind == "oven":
        raise InputError("oven logs are read whole", expected="immersion, ehl or hole")
    file = Path(path)
    table, chosen = open_log(file, kind, rig, disk)
    where = shown(file)
    whole = _Whole(kind, where)
    last_time = -np.inf
    kept: Columns | None = None
    for raw in table.chunks(list(dict.fromkeys(chosen.values())), rows):
        joined = raw if kept is None else _joined(kept, raw)
        kept = joined
        if len(next(iter(joined.data.values()))) < 4 * MARGIN:
            continue
        piece = _piece(joined, chosen, kind, where, last_time, hold_back=MARGIN)
        last_time = float(piece.frame["time_s"].iloc[-1])
        kept = _tail(joined)
        whole.see(piece.frame)
        yield piece
    if kept is None:
        raise InputError("no rows", where=where)
    piece = _piece(kept, chosen, kind, where, last_time, hold_back=0)
    whole.see(piece.frame)
    if len(piece.frame):
        yield piece
    whole.check()


def _piece(raw: Columns, chosen: dict[str, str], kind: str, where: str, after_s: float, hold_back: int) -> LogPiece:
    notes = list(raw.notes)
    columns = {canonical: raw.data[name] for canonical, name in chosen.items()}
    end = float(columns["time_s"][-1 - hold_back])
    frame, dt_s = trace_frame(columns, kind, raw, where, notes, whole=False)
    time = frame["time_s"].to_numpy()
    frame = frame.loc[(time > after_s) & (time <= end)].reset_index(drop=True)
    return LogPiece(frame, dt_s, tuple(f"{where}: {n}" for n in notes))


def _joined(kept: Columns, raw: Columns) -> Columns:
    data = {n: np.concatenate([kept.data[n], raw.data[n]]) for n in raw.data}
    before = len(next(iter(kept.data.values())))
    return Columns(data, raw.notes, RowNumbers(raw.rows.first - before, raw.rows.blank))


def _tail(raw: Columns) -> Columns:
    count = len(next(iter(raw.data.values())))
    start = count - 2 * MARGIN
    data: dict[str, FloatArray] = {n: v[start:].copy() for n, v in raw.data.items()}
    return Columns(data, (), RowNumbers(raw.rows.of(start)))


class _Whole:
    """What must be seen somewhere in a whole log."""

    def __init__(self, kind: str, where: str) -> None:
        self.kind, self.where = kind, where
        self.last: dict[str, float] = {}
        self.moves: dict[str, set[float]] = {"contact": set(), "switch": set()}
        self.low: dict[str, float] = {}
        self.high: dict[str, float] = {}

    def see(self, frame: pd.DataFrame) -> None:
        """Take notice of one piece."""
        if frame.empty:
            return
        for name in ("contact", "switch"):
            if name in frame:
                values = frame[name].to_numpy()
                steps = np.diff(values, prepend=self.last.get(name, values[0]))
                self.moves[name] |= set(np.sign(steps[steps != 0]).tolist())
                self.last[name] = float(values[-1])
        for name in (n for n in frame.columns if n.endswith("_degC")):
            self.low[name] = min(self.low.get(name, np.inf), float(frame[name].min()))
            self.high[name] = max(self.high.get(name, -np.inf), float(frame[name].max()))

    def check(self) -> None:
        """Raise InputError for a test without unloading or entry, or a channel in millivolts."""
        if self.kind == "ehl" and -1.0 not in self.moves["contact"]:
            raise InputError("column contact never falls: no unloading", where=self.where, expected="the whole test")
        if self.kind == "immersion" and 1.0 not in self.moves["switch"]:
            raise InputError("the switch never moves to 1", where=self.where, expected="the whole plunge")
        for name, high in self.high.items():
            if high < 16.0 and self.low[name] > -5.0 and max(self.high.values()) > 40.0:
                raise InputError(f"column {name} stays below {high:.3g}: this looks like millivolts", where=self.where)
