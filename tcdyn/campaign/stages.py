"""Several loadings and unloadings in one log are several tests: where each begins and ends.

Of a log too long for the memory only what surrounds one of them is kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from tcdyn.core.errors import InputError
from tcdyn.core.findings import info
from tcdyn.partition.events import find_events
from tcdyn.rig.contact import Events
from tcdyn.rig.log import Log, LogPieces

AFTER_S = 2.0  # from one parting to where the next test may begin: the switch has settled
BEFORE_S = 0.5  # from where a test ends to the next loading
LONG_ROWS = 120_000  # beyond, what is kept: seconds before the loading, the last under load, and after the parting,
KEPT_S = np.array([100.0, 1250.0, 250.0])
BESIDE_S = 60.0  # of loading and parting: what their instants are found in
LEAST_S = np.array(
    [30.0, 200.0, 60.0]
)  # and, of a log sampled so fast that these are too many rows, no less than
COURSE = ("contact", "load_N", "friction_N")


def loadings(frame: pd.DataFrame) -> list[Events]:
    """Every loading in an EHL log that an unloading follows, in order; empty where there is none.

    The longest is found first, then what lies before it and behind it is looked through in the same way.
    """
    t = frame["time_s"].to_numpy(dtype=float)
    if len(t) < 2:
        return []
    try:
        found = find_events(frame)
    except InputError:
        return []
    on = found.load_on_s
    off = found.unload_s
    before, after = (
        frame[rows].reset_index(drop=True) for rows in (t < on - BEFORE_S, t > off + AFTER_S)
    )
    return [*loadings(before), found, *loadings(after)]


def stages(log: Log) -> tuple[Log, ...]:
    """The tests in a log, each with its cooling up to the next loading, named after it: D4.1, D4.2.

    A log with one test is that test, under its own name.
    """
    return _parts(log, loadings(log.frame))


def _parts(log: Log, found: Sequence[Events]) -> tuple[Log, ...]:
    if len(found) < 2:
        return (log,)
    t = log.frame["time_s"].to_numpy(dtype=float)
    starts = [-np.inf, *(e.unload_s + AFTER_S for e in found[:-1])]
    stops = [*(e.load_on_s - BEFORE_S for e in found[1:]), np.inf]
    return tuple(
        replace(
            log,
            frame=log.frame[(t >= start) & (t <= stop)].reset_index(drop=True),
            path=log.path.with_name(f"{log.path.stem}.{k}{log.path.suffix}"),
        )
        for k, (start, stop) in enumerate(zip(starts, stops), 1)
    )


def stage_of(log: Log, number: int | None) -> tuple[Log, int]:
    """Test ``number`` of a log, from 1, or the whole log for None; and how many it holds.

    Raises InputError for one that it does not hold.
    """
    found = stages(log)
    if number is None:
        return log, len(found)
    if not 1 <= number <= len(found):
        raise InputError(
            f"no loading number {number}",
            where=log.path.name,
            expected=f"1 to {len(found)}: the disks part {len(found)} time{'s' if len(found) > 1 else ''} after a load",
        )
    return found[number - 1], len(found)


def read_stage(log: LogPieces, number: int | None) -> tuple[Log, int]:
    """``stage_of`` a log that is read in pieces: a long one with the rows about that test only, which a note says.

    Memory for about ``LONG_ROWS`` rows, more where ``LEAST_S`` holds more. Raises InputError as ``stage_of``, and for a
    long log without an unloading.
    """
    if log.rows <= LONG_ROWS:
        return stage_of(log.whole(), number)
    every = -(-log.rows // LONG_ROWS)
    course, count = stage_of(_course(log, every), number)
    events = find_events(course.frame, log.path.name)
    begin, *_, end = (float(x) for x in course.frame["time_s"])
    before, loaded, after = np.maximum(
        KEPT_S * min(1.0, LONG_ROWS * log.dt_s / KEPT_S.sum()), LEAST_S
    )
    on = events.load_on_s
    off = events.unload_s
    begin = max(begin, on - before if off - on <= loaded else off - loaded)
    end = min(end, off + after)
    first, last = _rows(log, [begin, end])
    kept = log.whole(np.arange(first, log.rows if last + every >= log.rows else last + 1))
    told = info("log.long", count=log.rows, begin_s=begin, end_s=end)
    return replace(kept, path=course.path, findings=(*kept.findings, told)), count


def all_events(log: LogPieces, kept: Log) -> list[Events]:
    """Loading and parting of every test in a log of which ``kept`` was read; of a long one by its forces beside them.

    Raises InputError for a log without any, as ``find_events`` does.
    """
    if len(kept.frame) == log.rows:
        whole = loadings(kept.frame)
        return (
            whole
            if len(whole) == 1
            else [find_events(x.frame, log.path.name) for x in _parts(kept, whole)]
        )
    found = []
    for rough in loadings(_course(log, -(-log.rows // LONG_ROWS)).frame):
        times = [t + s for t in (rough.load_on_s, rough.unload_s) for s in (-BESIDE_S, BESIDE_S)]
        edges = np.clip(_rows(log, times), 0, log.rows)
        near = np.union1d(np.arange(*edges[:2]), np.arange(*edges[2:]))
        found.append(find_events(log.whole(near, COURSE).frame, log.path.name))
    return found or [find_events(kept.frame, log.path.name)]


def _course(log: LogPieces, every: int) -> Log:
    return log.whole(np.arange(0, log.rows, every), COURSE)


def _rows(log: LogPieces, times_s: Sequence[float]) -> list[int]:
    return [int((t - log.sampling.time_s[0]) / log.dt_s) for t in times_s]
