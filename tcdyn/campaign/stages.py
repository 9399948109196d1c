"""Several loadings and unloadings in one log are several tests: where each begins and ends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

from calibration.errors import InputError
from calibration.log import Log
from tcdyn.partition.events import find_events

AFTER_S = 2.0  # from one parting to where the next test may begin: the switch has settled
BEFORE_S = 0.5  # from where a test ends to the next loading


def stage_times(frame: pd.DataFrame) -> list[tuple[float, float]]:
    """Begin and end [s] of every loading in an EHL log that an unloading follows, in order; empty where there is none.

    The longest is found first, then what lies before it and behind it is looked through in the same way.
    """
    t = frame["time_s"].to_numpy(dtype=float)
    if len(t) < 2:
        return []
    try:
        found = find_events(frame)
    except InputError:
        return []
    on, off = found.load_on_s, found.unload_s
    before, after = (frame[rows].reset_index(drop=True) for rows in (t < on - BEFORE_S, t > off + AFTER_S))
    return [*stage_times(before), (on, off), *stage_times(after)]


def stages(log: Log) -> tuple[Log, ...]:
    """The tests in a log, each with its cooling up to the next loading, named after it: D4.1, D4.2.

    A log with one test is that test, under its own name.
    """
    times = stage_times(log.frame)
    if len(times) < 2:
        return (log,)
    t = log.frame["time_s"].to_numpy(dtype=float)
    starts = [-np.inf, *(off + AFTER_S for _, off in times[:-1])]
    stops = [*(on - BEFORE_S for on, _ in times[1:]), np.inf]
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
