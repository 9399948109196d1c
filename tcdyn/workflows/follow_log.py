"""Wait for a log that is followed: until it has a header and rows, and while nothing new comes.

Used by :mod:`tcdyn.workflows.follow`. Guarded by ``tests/smoothing/test_follow.py`` and
``tests/smoothing/test_follow_clock.py``.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tcdyn.core.errors import InputError
from tcdyn.io.appended import AppendedFile
from tcdyn.io.cells import is_number, number_and_unit
from tcdyn.io.csv_dialect import HEAD_BYTES
from tcdyn.io.growing import GrowingText, open_growing
from tcdyn.io.metadata import START_TIME_KEY
from tcdyn.io.read import display_path
from tcdyn.io.stamps import is_stamp
from tcdyn.io.start_time import start_time
from tcdyn.rig.rigfile import Rig
from tcdyn.sensors.given import with_column
from tcdyn.series.source import source_of_table
from tcdyn.workflows.options import LogOptions
from tcdyn.workflows.raw_log import (
    Calibrations,
    RawLog,
    checked_before_following,
    open_log_table,
    raw_log,
)

STOPPED_BY_USER = "stopped"


@dataclass
class Patience:
    """How long nothing may come before a run ends, and whether it was asked to stop.

    Attributes
    ----------
    idle_s
        It ends after this time without new rows [s].
    poll_s
        Pause before it looks again [s].
    asked_to_stop
        Returns whether the run is to end.
    sleep
        Waits for a time [s].
    since
        When a look first found nothing new [s of ``time.monotonic``].
    ended
        Why the run ends; empty while it does not.
    """

    idle_s: float
    poll_s: float
    asked_to_stop: Callable[[], bool]
    sleep: Callable[[float], None]
    since: float | None = None
    ended: str = ""

    def goes_on(self, has_new: bool, output: AppendedFile | None = None) -> bool:
        """Whether to look again, after a pause if there was nothing new.

        Parameters
        ----------
        has_new
            Whether the last look found new rows.
        output
            The output, which is checked if there was nothing new.
        """
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


@dataclass(frozen=True)
class FollowedLog:
    """A log that has rows.

    Attributes
    ----------
    growing, raw
        Its reader, and its columns and channels.
    calibrations
        Records by disk, or sensors, each with its column.
    """

    growing: GrowingText
    raw: RawLog
    calibrations: Calibrations


def wait_for_rows(
    log: Path,
    calibrations: Calibrations,
    rig: Rig | None,
    options: LogOptions,
    patience: Patience,
) -> FollowedLog | None:
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
                    start_time_metadata(growing, raw)
                    patience.goes_on(has_new=True)
                    return FollowedLog(growing, raw, calibrations)
        except InputError as error:
            problem = error
            if log.exists() and log.stat().st_size > HEAD_BYTES:
                raise
        if not patience.goes_on(has_new=False):
            if patience.ended == STOPPED_BY_USER:
                return None
            raise problem


def start_time_metadata(growing: GrowingText, raw: RawLog) -> dict[str, str]:
    """Metadata with the date and time of the first row; empty if the log states none.

    Parameters
    ----------
    growing, raw
        The log.

    Raises
    ------
    InputError
        For a time column that holds neither numbers nor clock stamps.
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
