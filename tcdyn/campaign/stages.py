"""Split a log with several loadings into tests.

Of a log with more than ``MAX_ROWS`` rows only the rows around one test are loaded.
``tcdyn.workflows`` reads logs with ``read_stage``. The instants themselves come from
``tcdyn.partition.events.find_events``. Guarded by ``tests/campaign/test_stages.py`` and
``tests/smoothing/test_long_log.py``.
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
from tcdyn.rig.log import Log, LogChunks

# Time [s] after unloading at which the next test may begin: the contact switch has settled.
# Chosen by judgement.
SWITCH_SETTLE_S = 2.0
# Time [s] between the end of a test and the next loading. Chosen by judgement.
NEXT_LOADING_MARGIN_S = 0.5
# A log with more rows is loaded in part: ``WINDOW_S`` before loading, under load (the last),
# and after unloading [s]. Bounds the memory.
MAX_ROWS = 120_000
WINDOW_S = np.array([100.0, 1250.0, 250.0])
# Half width [s] of the rows in which the instants of loading and unloading are searched;
# chosen by judgement.
EVENT_MARGIN_S = 60.0
# At high sampling rates ``WINDOW_S`` is reduced to ``MAX_ROWS`` rows, but not below this [s].
MIN_WINDOW_S = np.array([30.0, 200.0, 60.0])
# Columns that ``find_events`` needs.
EVENT_COLUMNS = ("contact", "load_N", "friction_N")


def loading_events(frame: pd.DataFrame) -> list[Events]:
    """Find every loading in an EHL log that an unloading follows, in order.

    The longest is found first; the rows before and after it are searched in the same way.

    Parameters
    ----------
    frame
        Rows of the log with ``time_s`` and ``EVENT_COLUMNS``.
    """
    t = frame["time_s"].to_numpy(dtype=float)
    if len(t) < 2:
        return []
    try:
        longest = find_events(frame)
    except InputError:
        return []
    load_on_s = longest.load_on_s
    unload_s = longest.unload_s
    before, after = (
        frame[rows].reset_index(drop=True)
        for rows in (t < load_on_s - NEXT_LOADING_MARGIN_S, t > unload_s + SWITCH_SETTLE_S)
    )
    return [*loading_events(before), longest, *loading_events(after)]


def split_stages(log: Log) -> tuple[Log, ...]:
    """Split a log into its tests, each with its cooling up to the next loading.

    Parameters
    ----------
    log
        The log.

    Returns
    -------
    The tests, named D4.1, D4.2 and so on; a log with one test under its own name.
    """
    return _split_log(log, loading_events(log.frame))


def _split_log(log: Log, events: Sequence[Events]) -> tuple[Log, ...]:
    """The tests of a log with known loadings.

    Parameters
    ----------
    log
        The log.
    events
        Its loadings, in order.

    Returns
    -------
    One log for each loading.
    """
    if len(events) < 2:
        return (log,)
    t = log.frame["time_s"].to_numpy(dtype=float)
    starts = [-np.inf, *(e.unload_s + SWITCH_SETTLE_S for e in events[:-1])]
    stops = [*(e.load_on_s - NEXT_LOADING_MARGIN_S for e in events[1:]), np.inf]
    return tuple(
        replace(
            log,
            frame=log.frame[(t >= start) & (t <= stop)].reset_index(drop=True),
            path=log.path.with_name(f"{log.path.stem}.{k}{log.path.suffix}"),
        )
        for k, (start, stop) in enumerate(zip(starts, stops), 1)
    )


def stage_of(log: Log, number: int | None) -> tuple[Log, int]:
    """One test of a log, and how many tests the log has.

    Parameters
    ----------
    log
        The log.
    number
        Number of the test, from 1; None for the full log.

    Returns
    -------
    test, count
        The rows of the test, and the number of tests.

    Raises
    ------
    InputError
        The log has no such test.
    """
    tests = split_stages(log)
    if number is None:
        return log, len(tests)
    if not 1 <= number <= len(tests):
        raise InputError(
            f"no loading number {number}",
            where=log.path.name,
            expected=f"1 to {len(tests)}: the disks part {len(tests)} "
            f"time{'s' if len(tests) > 1 else ''} after a load",
        )
    return tests[number - 1], len(tests)


def read_stage(log: LogChunks, number: int | None) -> tuple[Log, int]:
    """Like ``stage_of`` for a log in chunks; of a long log only the rows of one test are loaded.

    Parameters
    ----------
    log
        The log.
    number
        Number of the test, from 1; None for the longest loading.

    Returns
    -------
    test, count
        The rows of the test, and the number of tests.

    Raises
    ------
    InputError
        The log has no such test, or is long and has no unloading.

    Notes
    -----
    An info finding reports that rows were left out. The loadings of a long log are searched in
    every n-th row, so that at most ``MAX_ROWS`` rows are in memory, or more where ``MIN_WINDOW_S``
    has more. ``tests/smoothing/test_long_log.py`` guards it.
    """
    if log.rows <= MAX_ROWS:
        return stage_of(log.to_log(), number)
    step = -(-log.rows // MAX_ROWS)
    decimated, count = stage_of(_decimate(log, step), number)
    events = find_events(decimated.frame, log.path.name)
    begin, *_, end = (float(x) for x in decimated.frame["time_s"])
    before, loaded, after = np.maximum(
        WINDOW_S * min(1.0, MAX_ROWS * log.dt_s / WINDOW_S.sum()), MIN_WINDOW_S
    )
    load_on_s = events.load_on_s
    unload_s = events.unload_s
    begin = max(begin, load_on_s - before if unload_s - load_on_s <= loaded else unload_s - loaded)
    end = min(end, unload_s + after)
    first, last = _row_indices(log, [begin, end])
    selected = log.to_log(np.arange(first, log.rows if last + step >= log.rows else last + 1))
    finding = info("log.long", count=log.rows, begin_s=begin, end_s=end)
    return replace(selected, path=decimated.path, findings=(*selected.findings, finding)), count


def all_events(log: LogChunks, log_in_memory: Log) -> list[Events]:
    """Loading and unloading of every test in a log of which one part is in memory.

    Of a long log the forces around each event are read.

    Parameters
    ----------
    log
        The log.
    log_in_memory
        The part of it that is in memory.

    Raises
    ------
    InputError
        The log has no events.
    """
    if len(log_in_memory.frame) == log.rows:
        events = loading_events(log_in_memory.frame)
        return (
            events
            if len(events) == 1
            else [find_events(x.frame, log.path.name) for x in _split_log(log_in_memory, events)]
        )
    events_of_tests = []
    for approximate in loading_events(_decimate(log, -(-log.rows // MAX_ROWS)).frame):
        times = [
            t + s
            for t in (approximate.load_on_s, approximate.unload_s)
            for s in (-EVENT_MARGIN_S, EVENT_MARGIN_S)
        ]
        edges = np.clip(_row_indices(log, times), 0, log.rows)
        near_rows = np.union1d(np.arange(*edges[:2]), np.arange(*edges[2:]))
        events_of_tests.append(
            find_events(log.to_log(near_rows, EVENT_COLUMNS).frame, log.path.name)
        )
    return events_of_tests or [find_events(log_in_memory.frame, log.path.name)]


def _decimate(log: LogChunks, step: int) -> Log:
    """Every ``step``-th row of a log, with ``EVENT_COLUMNS`` only."""
    return log.to_log(np.arange(0, log.rows, step), EVENT_COLUMNS)


def _row_indices(log: LogChunks, times_s: Sequence[float]) -> list[int]:
    """Row of each time, by the sampling interval; it may lie outside the log."""
    return [int((t - log.sampling.time_s[0]) / log.dt_s) for t in times_s]
