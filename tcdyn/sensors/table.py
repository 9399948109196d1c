"""Any table with a time column, piece by piece: sensor columns in degrees Celsius, rows on an even grid."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, info, warning
from tcdyn.io.read import Table, open_table, shown
from tcdyn.io.table import PIECE_ROWS, missing
from tcdyn.io.times import HEADER_NAMES, TimeColumn, find_time_column, rows_of_repeated_stamps
from tcdyn.rig.log import COMPENSATED
from tcdyn.rig.plausible import dropout_codes, impossible
from tcdyn.sensors.units import Unit, doubtful

# on either side of a stretch, for its answer only; of it
MARGIN_LAGS = 10.0
MARGIN_ROWS = 400
LEAST_ROWS = 20_000
MOST_BESIDE = 1 << 16  # rows on either side that are held, however slowly the smoother forgets
LONGEST_GAP_LAGS = 10.0  # beyond it, nothing before a gap says anything of what comes after
LONGEST_GAP_ROWS = 60  # in a record that is fitted as one, whatever its length
MOSTLY_REPEATED = (
    0.3  # share of repeated stamps above which they are the clock's resolution and no double rows
)
UNSURE_RATE = 0.01  # relative standard uncertainty of a rate, from which a warning says so: lags are wrong by as much
UNEVEN = 0.2  # of an interval, rms: stamps that stray more are told


@dataclass(frozen=True)
class EvenTimes:
    """Where the rows of a stretch stand on even times: ``place`` (N,) in samples, every ``dt_s`` [s]."""

    place: NDArray[np.intp]
    dt_s: float


@dataclass(frozen=True)
class Source:
    """An opened table and its time column; columns that are numbers pass through."""

    path: Path
    table: Table
    clock: TimeColumn

    @property
    def time(self) -> str:
        """Name of the time column."""
        return self.clock.name

    def pieces(
        self, columns: Sequence[str], rows: int = PIECE_ROWS
    ) -> Iterator[tuple[Array, dict[str, Array], tuple[Finding, ...]]]:
        """Time (N,) [s] and columns (N,) of each piece, as they stand, with what the reader noticed.

        A time column of clock stamps is among the columns as it is in the file.
        Raises InputError where the unit of time is not clear.
        """
        wanted = list(dict.fromkeys([self.time, *columns]))
        checked = False
        for part in self.table.pieces(wanted, rows):
            values = part.data[self.time]
            is_clock = self.time in part.stamps
            times_s = self.clock.in_seconds(values, is_clock)
            if not checked and len(times_s) > 1:
                self.clock.check_step(times_s, is_clock)
                checked = True
            yield times_s, {**part.data, **part.stamps}, part.findings


class Pieces(Protocol):
    """What gives its columns piece by piece: an opened table, or a log."""

    def pieces(
        self, columns: Sequence[str]
    ) -> Iterator[tuple[Array, dict[str, Array], tuple[Finding, ...]]]:
        """Time (N,) [s] and columns (N,) of each piece, and what was noticed."""


def open_source(
    path: str | Path,
    time: str | None = None,
    known: Sequence[str] = (),
    time_unit: str | None = None,
) -> Source:
    """The table at ``path``. Raises InputError without a time column, and for a table that is compensated already."""
    table = open_table(path, (*HEADER_NAMES, *known))
    if table.metadata.get("tcdyn") == COMPENSATED:
        raise InputError(
            "is compensated already",
            where=table.where,
            expected="a table as the logger wrote it",
            remedy="give the raw table; a chain must not be removed twice",
        )
    twice = [n for n in table.names if table.names.count(n) > 1]
    if twice:
        raise InputError(
            f"column {twice[0]!r} stands twice", where=table.where, remedy="rename one of them"
        )
    clock = find_time_column(
        table.names, table.where, requested=time, unit=time_unit, unit_row=table.units
    )
    return Source(Path(path), table, clock)


def read_columns(
    path: str | Path,
    columns: Sequence[str],
    units: Mapping[str, Unit] | None = None,
    time: str | None = None,
    time_unit: str | None = None,
) -> tuple[Array, dict[str, Array], list[Finding]]:
    """Even times (N,) [s] and columns on them (N,), those with ``units`` in degrees Celsius, NaN where missing.

    Raises InputError for a missing column, time that does not rise, or fewer than ten rows.
    """
    source = open_source(path, time, columns, time_unit)
    for name in columns:
        if name not in source.table.names:
            raise missing("column", name, source.table.names, source.table.where)
    given = dict(units or {})
    cold = [u.cold for u in given.values() if isinstance(u.cold, str)]
    parts = list(source.pieces([*columns, *cold]))
    t = np.concatenate([p[0] for p in parts])
    raw = {n: np.concatenate([p[1][n] for p in parts]) for n in (*columns, *cold)}
    found = [f for p in parts for f in p[2]]
    grid, told = places(t, shown(Path(path)))
    check_gaps(t, grid.dt_s, shown(Path(path)))
    size = int(grid.place[-1]) + 1
    out = {}
    for name in columns:
        unit = given.get(name)
        values = raw[name]
        if unit is not None:
            found += doubtful(name, unit, values)
            values = unit.in_degC(
                values, raw[unit.cold] if isinstance(unit.cold, str) else unit.cold
            )
            wrong = impossible(values)
            wrong |= dropout_codes(np.where(wrong, np.nan, values))
            if wrong.any():
                first = int(np.argmax(wrong))
                found.append(
                    warning(
                        "sensor.codes",
                        subject=name,
                        count=int(wrong.sum()),
                        value=float(values[first]),
                    )
                )
                values = np.where(wrong, np.nan, values)
        out[name] = on_grid(values, grid, size)
    return t[0] + grid.dt_s * np.arange(size), out, [*found, *told]


def check_gaps(time_s: Array, dt_s: float, where: str) -> None:
    """Raise InputError if a record that is fitted as one has a gap longer than all that it holds."""
    steps = np.diff(time_s)
    row = int(np.argmax(steps))
    gap_s = float(steps[row])
    if gap_s > max(len(time_s) * dt_s, LONGEST_GAP_ROWS * dt_s):
        raise InputError(
            f"{gap_s:.6g} s are missing after row {row + 1} below the header",
            where=where,
            expected="one record without a long gap",
            remedy="cut the table there and give one part",
        )


def places(time_s: Array, where: str, dt_s: float | None = None) -> tuple[EvenTimes, list[Finding]]:
    """The rows (N,) on an even grid; stamps of few decimals that repeat are taken as even where they are.

    ``dt_s``: the interval, where an earlier stretch told it.
    Raises InputError for time that is missing, runs backward, or fewer than ten rows.
    """
    n = len(time_s)
    if n < 10:
        raise InputError(f"only {n} rows", where=where, expected="at least 10 samples in time")
    if not np.isfinite(time_s).all():
        row = int(np.argmin(np.isfinite(time_s)))
        raise InputError(
            f"no time in row {row + 1} below the header", where=where, expected="a time in each row"
        )
    step = np.diff(time_s)
    if (step < 0).any():
        row = int(np.argmax(step < 0))
        raise InputError(
            f"time runs backward at row {row + 2} below the header ({time_s[row]:.9g} s, then {time_s[row + 1]:.9g} s)",
            where=where,
            expected="time that rises",
            remedy="sort the rows, or cut the table",
        )
    span = float(time_s[-1] - time_s[0])
    if span <= 0:
        raise InputError("all rows have one time", where=where, expected="time that rises")
    repeated: list[Finding] = []
    if (step == 0).mean() > 0.02:  # a clock of few decimals: rows are counted where they are even
        even = rows_of_repeated_stamps(time_s)
        if even is not None:
            dt = dt_s or even.interval_s
            percent = 100 * even.u_s / dt
            finding = info("sensor.few_decimals", rate_Hz=1 / dt, percent=percent)
            if even.u_s > UNSURE_RATE * dt:
                finding = warning("sensor.few_decimals", rate_Hz=1 / dt, percent=percent)
            return EvenTimes(even.places, dt), [finding]
        if (step == 0).mean() > MOSTLY_REPEATED:
            raise InputError(
                "most time stamps are repeated, and the rows between them are not even",
                where=where,
                expected="stamps as fine as the sampling interval",
                remedy="log finer stamps, or cut the table where rows are missing",
            )
        row = int(np.argmax(step == 0))
        repeated = [info("sensor.repeated", count=int((step == 0).sum()), row=row + 2)]
    usual = dt_s or float(np.median(step[step > 0]))
    dt = dt_s or float(step.sum() / np.rint(step / usual).sum())  # a row that came twice is no step
    place = np.concatenate([[0.0], np.cumsum(np.maximum(np.rint(step / dt), 1.0))])
    away = (time_s - time_s[0]) / dt - place
    away -= np.median(away)
    stray = float(np.sqrt(np.mean(np.minimum(np.abs(away - np.rint(away)), 0.5) ** 2)))
    if np.abs(away).max() > 0.6:  # steps do not add up: each row to its nearest place
        place = np.rint((time_s - time_s[0]) / dt)
        place = np.maximum.accumulate(place)
        stray = float(np.sqrt(np.mean(((time_s - time_s[0]) / dt - place) ** 2)))
    found = [warning("sensor.uneven", rate_Hz=1 / dt, stray_s=stray * dt)] if stray > UNEVEN else []
    return EvenTimes(place.astype(np.intp), dt), [*repeated, *found]


@dataclass(frozen=True)
class Part:
    """Rows of the table with those that are only there to be smoothed along: the answer is for ``keep``.

    ``beside``: how many rows stand beside ``keep`` at least, where the table goes on; more than any where it does not.
    """

    time_s: Array
    data: dict[str, Array]
    keep: slice
    findings: tuple[Finding, ...]
    beside: float


def parts(
    source: Pieces, columns: Sequence[str], lag_s: float, least: int | None = None
) -> Generator[Part, int, None]:
    """Stretches of ``least`` rows that overlap by a margin for lags up to ``lag_s`` [s]; a long silence parts two.

    Where they are parted hangs on the rows alone, not on how the file is read. Sent a number, the last stretch comes
    again with that many rows beside it (rounded up, ``MOST_BESIDE`` at most), and so do those after it.
    """
    longest = LONGEST_GAP_LAGS * lag_s
    pieces = source.pieces(columns)
    over = False
    time = np.empty(0)
    data: dict[str, Array] = {}
    found = list[Finding]()
    # rows before ``done`` are answered
    done = 0
    usual = 0.0
    side = 0
    while done < len(time) or not over:
        size = max(2 * side, least or LEAST_ROWS)
        if (
            not over and len(time) <= done + size + 2 * side
        ):  # room for a silence within the margin, too
            new = next(pieces, None)
            over = new is None
            if new is not None and len(new[0]):
                time = np.concatenate([time, new[0]])
                data = {
                    n: np.concatenate([data[n], new[1][n]]) if n in data else new[1][n]
                    for n in columns
                }
            found += list(new[2]) if new is not None else []
            continue
        if not side:
            step = np.diff(time[: LEAST_ROWS + 1])
            step = step[np.isfinite(step)]
            usual = (float(np.median(step)) or float(step.mean()) or 1.0) if len(step) else 1.0
            side = _rounded(MARGIN_LAGS * lag_s / usual + MARGIN_ROWS)
            continue
        ahead = time[done : done + size + 2 * side]
        gaps = np.flatnonzero(np.diff(ahead) > max(longest, 60 * usual))
        whole = len(gaps) > 0 or (over and len(time) <= done + size + 2 * side)
        cut = done + (int(gaps[0]) + 1 if len(gaps) else len(ahead))
        keep_to = cut if whole else done + size
        start = max(done - side, 0)
        stop = cut if whole else keep_to + side
        beside = np.inf if side >= MOST_BESIDE or (start == 0 and whole) else side
        wanted = yield Part(
            time[start:stop],
            {n: v[start:stop] for n, v in data.items()},
            slice(done - start, keep_to - start),
            tuple(found),
            beside,
        )
        if wanted:
            side = _rounded(max(wanted, side + 1))
            continue
        found = []
        forget = keep_to if len(gaps) else max(keep_to - MOST_BESIDE, 0)
        time = time[forget:]
        data = {n: v[forget:] for n, v in data.items()}
        done = keep_to - forget


def _rounded(rows: float) -> int:
    """Up to a power of two, from 1024 on a multiple of it: cells of the smoother then begin where the table's do."""
    step = 1 << min(int(np.ceil(np.log2(max(rows, 1)))), 10)
    return int(min(step * np.ceil(rows / step), MOST_BESIDE))


def on_grid(values: Array, grid: EvenTimes, size: int) -> Array:
    """Values (N,) at their places (size,), NaN where no row stands; rows of one place are averaged."""
    ok = np.isfinite(values)
    total = np.bincount(grid.place[ok], values[ok], minlength=size)
    count = np.bincount(grid.place[ok], minlength=size)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def once_each(findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """The first finding of each code about each subject: stretches of one table repeat themselves."""
    kept: dict[tuple[str, str], Finding] = {}
    for f in findings:
        kept.setdefault((f.code, f.subject), f)
    return tuple(kept.values())
