"""Log files read, checked and made canonical; a doubt is an error or a finding with file, column, row and time."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tcdyn.core import Array, Flags
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, SampleLocation, labelled_messages
from tcdyn.core.result import Result, jsonable
from tcdyn.estimation.trace_noise import SPIKES, clean, course_noise_K
from tcdyn.io.read import Table, read_whole, sha256
from tcdyn.io.table import PIECE_ROWS, Columns, in_pieces, joined
from tcdyn.io.write import write_log
from tcdyn.rig.check_clock import Sampling, check_time, moved, weighed
from tcdyn.rig.check_columns import LONGEST_NAN_S, ColumnCheck, Course
from tcdyn.rig.check_kind import check_kind
from tcdyn.rig.columns import LAYOUTS, SWITCHES, Kind, couples_in
from tcdyn.rig.opened_log import (
    COMPENSATED,
    log_kind,
    missing_and_unused,
    not_there,
    open_log,
    refuse_spare_records,
)
from tcdyn.rig.oven_log import oven_frame
from tcdyn.rig.record import DiskRecord
from tcdyn.rig.rigfile import Rig, load_rig

MOST = 1 << 17  # rows of a file that are kept in memory at most: 29 min at 75 Hz
__all__ = ["COMPENSATED", "Log", "LogPiece", "LogPieces", "iter_log", "read_log", "write_log"]


@dataclass(frozen=True)
class Log(Result):
    """One log: canonical columns (temperatures as logged, before the static lines), and where they come from.

    ``dt_s`` is the sample interval (None for an oven log). Samples that were missing, impossible or spikes are NaN
    in ``frame`` and named in ``findings``; the time is even. ``frame`` holds 8 bytes a sample and column.
    """

    frame: pd.DataFrame
    kind: Kind
    path: Path
    sha256: str
    dt_s: float | None
    metadata: dict[str, str] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()

    @property
    def channels(self) -> tuple[str, ...]:
        """The junctions' columns."""
        return tuple(couples_in(self.frame))

    def summary(self) -> str:
        """File, kind, length, sampling and warnings."""
        said = f"{self.path.name}: {LAYOUTS[self.kind].name}, {len(self.frame)} rows"
        if self.dt_s is not None:
            said += f" at {1 / self.dt_s:.4g} Hz, {len(self.frame) * self.dt_s:.4g} s"
        return "\n".join(
            [f"{said}, {len(self.channels)} thermocouples", *labelled_messages(self.findings)]
        )

    def to_dict(self) -> dict[str, Any]:
        """Where the log comes from and the range of every column; the samples are in ``frame``."""
        return {
            "file": self.path.name,
            "sha256": self.sha256,
            "kind": self.kind,
            "rows": len(self.frame),
            "dt_s": self.dt_s,
            "metadata": dict(self.metadata),
            "columns": {row.pop("column"): row for row in jsonable(self.card())},
            "warnings": list(self.warnings),
        }

    def card(self) -> pd.DataFrame:
        """Least, middle and greatest value of every column, and how many are missing."""
        f = self.frame
        table = {"column": f.columns, "min": f.min().to_numpy(), "median": f.median().to_numpy()}
        return pd.DataFrame(
            {**table, "max": f.max().to_numpy(), "missing": f.isna().sum().to_numpy()}
        )

    def filled(self) -> pd.DataFrame:
        """The frame with its few missing samples replaced by straight lines between their neighbours."""
        if not self.frame.isna().to_numpy().any():
            return self.frame
        return self.frame.interpolate(method="linear", limit_direction="both")


@dataclass(frozen=True)
class LogPiece:
    """A stretch of a log: its canonical frame, whose first row is row ``first`` of the whole log.

    What was counted while reading is told with the last piece; see ``LogPieces.findings`` for the rest.
    """

    frame: pd.DataFrame
    first: int
    findings: tuple[Finding, ...] = ()


@dataclass(frozen=True)
class LogPieces:
    """A log that was looked through once, to be gone through piece by piece, as often as needed.

    ``switches`` (N,) are of the whole log, row by row of the file; ``findings`` is what the first look
    showed. Each walk checks what passes by, and refuses before the last piece what only then is known: frozen
    channels, too many missing samples or spikes. So what the other pieces were used for must wait for the last.

    Use it where a result is made piece by piece too, in memory that does not grow with the log::

        log = iter_log("B3.csv", "ehl", rig)
        for piece in log:                     # piece.frame is what read_log's frame holds in these rows
            compensated.append(state.advance(piece.frame))
    """

    path: Path
    kind: Kind
    metadata: dict[str, str]
    sampling: Sampling
    switches: Mapping[str, Flags]
    findings: tuple[Finding, ...]
    _table: Table = field(repr=False)
    _names: Mapping[str, str] = field(repr=False)
    _noise_K: Mapping[str, float] = field(repr=False)
    _place: SampleLocation = field(repr=False)
    _piece_rows: int = field(repr=False)
    _whole: Log | None = field(repr=False, default=None)  # of a file whose rows are kept

    @property
    def dt_s(self) -> float:
        """Sample interval [s]."""
        return self.sampling.dt_s

    @property
    def rows(self) -> int:
        """Rows of all pieces together."""
        return int(self.sampling.grid[-1]) + 1

    def __iter__(self) -> Iterator[LogPiece]:
        where = self._place.where
        grid = self.sampling.grid
        total = len(self.sampling.grid)
        end_row = self.rows
        checks = {name: ColumnCheck(name, self._place) for name in self._noise_K}
        side = SPIKES["reading"].longest
        margin = side * (
            int(max(LONGEST_NAN_S / self.dt_s, side) + 1) + 1
        )  # neighbours, each behind a gap
        kept: dict[str, Array] = {}
        at = done = 0
        for raw in self._table.pieces(list(dict.fromkeys(self._names.values())), self._piece_rows):
            new = {name: raw.data[self._names[name]] for name in checks}
            kept = {name: np.concatenate([kept[name], new[name]]) for name in new} if kept else new
            end = at + len(next(iter(kept.values())))
            stop = int(np.searchsorted(grid, grid[max(end - margin, 0)])) if end < total else end
            if end > total:
                break
            if stop == done or (stop - done < margin and end < total):
                continue
            inside = slice(done - at, stop - at)
            cleaned = {name: clean(name, kept[name], self._noise_K[name]) for name in checks}
            for name, check in checks.items():
                check.see(kept[name][inside], cleaned[name][inside])
            columns = {
                name: moved(name, x, self.sampling, slice(at, end))[inside]
                for name, x in cleaned.items()
            }
            # on the even grid, up to the next row: samples put in are NaN, a switch keeps its state in them
            columns |= {
                name: on[done:stop].astype(np.float64) for name, on in self.switches.items()
            }
            rows = grid[done : stop + 1]
            even = np.arange(rows[0], grid[stop] if stop < total else end_row)
            frame = pd.DataFrame(
                columns, rows[: stop - done], [n for n in self._names if n != "time_s"]
            )
            frame = frame[~frame.index.duplicated()].reindex(even)
            frame = frame.assign(**frame[[*self.switches]].ffill()).reset_index(drop=True)
            frame.insert(0, "time_s", np.interp(even, rows, self.sampling.time_s[done : stop + 1]))
            found = (
                [finding for check in checks.values() for finding in check.judge()]
                if stop == total
                else []
            )
            yield LogPiece(frame, int(grid[done]), tuple(f.at(where) for f in found))
            done = stop
            kept = {
                name: values[max(stop - margin - at, 0) :].copy() for name, values in kept.items()
            }
            at = max(stop - margin, at)
        if done != total:
            raise InputError("the file changed while it was read", where=where)

    def whole(
        self, rows: NDArray[np.intp] | None = None, columns: Collection[str] | None = None
    ) -> Log:
        """The pieces joined, or some ``rows`` of them, which rise; all ``columns`` or some. All rows are checked.

        Needs 8 bytes a value that is kept; all of a short log is kept. Raises InputError as going through them does.
        """
        source = self
        joined = self._whole
        if joined is not None and rows is None and columns is None:
            return replace(joined, frame=joined.frame.copy(deep=False))
        if columns is not None:  # what a piece is cut by is never left out
            kept = {"time_s", next(iter(self._noise_K)), *columns}
            some: Any = [
                {k: x[k] for k in x if k in kept}
                for x in (self._names, self._noise_K, self.switches)
            ]
            source = replace(self, _names=some[0], _noise_K=some[1], switches=some[2])
        wanted = np.arange(self.rows) if rows is None else rows
        frame = dict[str, Array]()
        told = self.findings
        for piece in source:
            first, stop = np.searchsorted(wanted, [piece.first, piece.first + len(piece.frame)])
            for name in map(str, piece.frame):
                column = frame.setdefault(name, np.empty(len(wanted)))
                column[first:stop] = piece.frame[name].to_numpy()[wanted[first:stop] - piece.first]
            told += piece.findings
        made_of = sha256(self.path) if joined is None else joined.sha256
        return Log(
            pd.DataFrame(frame, copy=False),
            self.kind,
            self.path,
            made_of,
            self.dt_s,
            self.metadata,
            told,
        )


def iter_log(
    path: str | Path,
    kind: Kind,
    rig: Rig | None = None,
    disk: str | None = None,
    *,
    rows: int = PIECE_ROWS,
    allow_compensated: bool = False,
    parted: bool = True,
    without: Collection[str] = (),
) -> LogPieces:
    """A log of ``kind`` ("immersion", "ehl" or "hole") to be read in pieces of roughly ``rows`` rows, in time order.

    Put together they are ``read_log``'s frame. A file of more than 131072 rows is read again with each walk. The first
    time, here, keeps its time and switches, and of the other columns a sample of at most 32768 rows, every k-th run of
    64: sampling, two-level columns, entry or unloading, units, loads, swapped and dead channels are judged there.

    CSV (2 MB of text at most in a piece), Parquet and TDMS need memory for some pieces and 45 bytes for each row of
    the file, 280 MB for a gigabyte; LVM, UTF-16 text and TDMS channels that differ in start or rate are read at once.

    Raises InputError as ``read_log`` does; for an oven log, which is always short.
    """
    if kind == "oven":
        raise InputError(
            "oven logs are read whole", expected="immersion, ehl or hole", remedy="use read_log"
        )
    file = Path(path)
    table, names = open_log(
        file, kind, rig, disk, allow_compensated=allow_compensated, without=without
    )
    raws: list[Columns] = []  # of a short file all, which is then read once
    clock = bytearray()  # grows in place, where a list of arrays would need all of it twice
    others = [name for name in names if name != "time_s" and name not in SWITCHES]
    found = list[Finding]()
    course = Course()
    place = SampleLocation(table.where)
    for raw in table.pieces(list(dict.fromkeys(names.values())), rows):
        place = raw.place
        time = raw.data[names["time_s"]]
        found += raw.findings
        clock += time.tobytes()
        course.see({n: raw.data[names[n]] for n in names if n != "time_s"})
        raws.append(raw)
        if course.rows > MOST:
            raws.clear()
    if not course.rows:
        raise InputError("no rows", where=table.where)
    sampling = check_time(np.frombuffer(clock), place)
    del clock
    place = replace(place, time_s=sampling.time_s, dt_s=sampling.dt_s)
    sample = course.frame()
    noise_K = dict[str, float]()
    for name in others:
        values = sample[name].to_numpy()
        noise_K[name] = course_noise_K(name, values, sample.index.to_numpy(), place)
        sample[name] = clean(name, values, noise_K[name])
    sampling = weighed(sampling, sample)
    switches, said = check_kind(
        kind, sample, course.whole(), place, rig or load_rig(), disk, parted=parted
    )
    found += [*said, *missing_and_unused(kind, table, names, without)]
    told = tuple(f.at(table.where) for f in (*sampling.findings, *found))
    if raws:
        table = replace(table, pieces=partial(in_pieces, joined(raws, [*raws[0].data], place)))
    log = LogPieces(
        file,
        kind,
        dict(table.metadata),
        sampling,
        switches,
        told,
        table,
        names,
        noise_K,
        place,
        rows,
    )
    with suppress(InputError):  # who goes through it is told
        log = replace(log, _whole=log.whole() if raws else None)
    return log


def log_for(
    log: str | Path, rig: Rig, records: Mapping[str, DiskRecord]
) -> tuple[LogPieces, list[str]]:
    """The EHL or immersion log that ``records`` are for, and columns it lacks that its unloading would be fitted with.

    Raises InputError as ``iter_log`` does, and for records that are not of what the log holds.
    """
    kind, disk = log_kind(log, rig, records)
    gone = list[str]()
    unused = list[str]()
    if kind == "ehl":
        refuse_spare_records(log, rig, records)
        gone, unused = not_there(log, rig, records)
    return iter_log(log, kind, rig, disk, parted=False, without=gone), unused


def read_log(
    path: str | Path,
    kind: Kind,
    rig: Rig | None = None,
    disk: str | None = None,
    *,
    allow_compensated: bool = False,
    parted: bool = True,
    without: Collection[str] = (),
) -> Log:
    """Read a log of ``kind`` ("oven", "immersion", "ehl" or "hole") and check it; ``iter_log``'s pieces joined.

    CSV in its dialects, LVM, TDMS and Parquet by ending; column names mapped by ``rig``'s ``[columns]`` (those of
    ``disk`` where given). Row numbers in messages are lines of the file. ``parted``: EHL disks must part;
    ``without``: columns that are left unread.

    Raises InputError for whatever section 8 of the design calls bad input and cannot be kept with a finding.

    >>> import tempfile
    >>> from tcdyn.io.write import write_log
    >>> rows = pd.DataFrame({"repeat": 1, "setpoint_degC": [40.0] * 3 + [80.0] * 3})
    >>> rows["prt_degC"] = rows["setpoint_degC"]
    >>> for c in "abcdef":
    ...     rows[f"{c}_degC"] = rows["prt_degC"] + 0.2
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     log = read_log(write_log(rows, Path(folder) / "oven.csv"), "oven")
    >>> log.frame.shape
    (6, 9)
    """
    file = Path(path)
    if kind != "oven":
        options: Any = {
            "allow_compensated": allow_compensated,
            "parted": parted,
            "without": without,
        }
        return iter_log(file, kind, rig, disk, **options).whole()
    table, names = open_log(file, kind, rig, disk, allow_compensated=allow_compensated)
    raw = read_whole(table, list(dict.fromkeys(names.values())))
    frame, found = oven_frame(
        {canonical: raw.data[name] for canonical, name in names.items()}, raw.place
    )
    found += missing_and_unused(kind, table, names)
    told = tuple(f.at(table.where) for f in (*raw.findings, *found))
    return Log(frame, kind, file, sha256(file), None, dict(table.metadata), told)
