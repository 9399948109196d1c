"""Channels that are smoothed with a fixed delay: blocks of rows, and what each passes on.

Used by :mod:`tcdyn.sensors.compensation`. Guarded by ``tests/smoothing/test_block_by_block.py`` and
``tests/smoothing/test_fixed_delay.py``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from tcdyn.sensors.readings import ChannelReadings
from tcdyn.sensors.segments import START_ROWS, TableSegment
from tcdyn.smoothing.record import Compensated
from tcdyn.smoothing.running import Running, smooth_block

# Rows before those that are smoothed that show their outliers, at least, and the time that they
# last at least [s]: two windows of the longest burst of a slip ring, of which one is needed. The
# rest of the margin is only needed where the intensities are learned.
LEAST_CONTEXT_ROWS = 200
CONTEXT_S = LEAST_CONTEXT_ROWS / 75
# Rows before a block that are smoothed again, so that a change of the temperature which only later
# rows show is found where it began: those of one lag, and at least so many. In two records of
# tests/smoothing/live_study.py (seeds 3 and 4, delay 0.5 s) 92 % of the samples within 2 s of a
# kink are inside the band without them, and 96 % with them.
LEAST_BACK_ROWS = 64
# Noise and intensities are learned again after this share of the margin before a block, and so
# much sooner where a block contradicts them. tests/smoothing/live_study.py: with the whole margin
# the rms error is up to a fifth larger.
LEARNING_SHARE = 0.5
SOONER = 4


@dataclass
class DelayedSmoother:
    """Smooths the blocks of a table, which come one after the other.

    Attributes
    ----------
    running
        What earlier blocks passed on, by the columns that were smoothed together.
    origin_row
        Row from which each of them continues, counted from the last long gap.
    learned_rows
        Rows since the last long gap at the block in which the intensities were learned last.
    learns
        Whether they are learned in the present block.
    block
        The present block.
    """

    running: dict[tuple[str, ...], Running] = field(default_factory=dict)
    origin_row: dict[tuple[str, ...], int] = field(default_factory=dict)
    learned_rows: int = 0
    learns: bool = True
    block: TableSegment | None = None

    def passed_on(self) -> DelayedSmoother:
        """What the present block passes on; it does not change with later blocks."""
        return replace(
            self, running=dict(self.running), origin_row=dict(self.origin_row), block=None
        )

    def to_dict(self) -> dict[str, Any]:
        """What the present block passes on, as plain data."""
        return {
            "learned_rows": self.learned_rows,
            "running": [
                {
                    "columns": list(columns),
                    "origin_row": self.origin_row[columns],
                    **running.to_dict(),
                }
                for columns, running in self.running.items()
            ],
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> DelayedSmoother:
        """What ``to_dict`` wrote; raises one of ``tcdyn.core.errors.DAMAGED`` for other data."""
        running = {}
        origin_row = {}
        for each in data["running"]:
            columns = tuple(str(name) for name in each["columns"])
            running[columns] = Running.from_dict(each)
            origin_row[columns] = int(each["origin_row"])
        return cls(running, origin_row, int(data["learned_rows"]))

    def begin(self, block: TableSegment) -> TableSegment:
        """Begin a block.

        Parameters
        ----------
        block
            The block with its margins. Without a margin before, nothing is known of earlier rows.

        Returns
        -------
        TableSegment
            The rows of it that are needed.

        Notes
        -----
        Noise and intensities are learned from the block and its margins: in the first block, each
        time that the number of rows has doubled, and from a full margin on twice in its length. So
        each row is used about twice for that.
        """
        before = block.keep.start
        if before == 0:
            self.running = {}
            self.origin_row = {}
            self.learned_rows = 0
        since = block.rows_before - self.learned_rows
        wait = min(max(self.learned_rows, START_ROWS), LEARNING_SHARE * before)
        if any(running.is_contradicted for running in self.running.values()):
            wait /= SOONER
        self.learns = before == 0 or since >= wait
        if self.learns:
            self.learned_rows = block.rows_before
        self.block = block
        if self.learns:
            return block
        interval_s = block.position.interval_s
        context_rows = max(LEAST_CONTEXT_ROWS, int(np.ceil(CONTEXT_S / interval_s)))
        first_origin = min(self.origin_row.values(), default=block.rows_before)
        needed_rows = context_rows + block.rows_before - first_origin
        return block.without_first(max(before - needed_rows, 0))

    def smooth(self, readings: ChannelReadings) -> tuple[ChannelReadings, Compensated]:
        """Smooth channels of the present block; the readings begin where the result does.

        Parameters
        ----------
        readings
            Readings of the channels at all samples of the rows that ``begin`` returned.

        Notes
        -----
        Channels without a result in the last block continue from an older row. Where that is no
        longer among the rows, nothing is known of them.
        """
        assert self.block is not None
        block = self.block
        columns = readings.columns
        rows = len(readings.sample_of_row)
        stop = rows - (len(block.time_s) - block.keep.stop)
        start = stop - (block.keep.stop - block.keep.start)
        first_row = block.rows_before - start  # of ``readings``, counted from the last long gap
        running = self.running.get(columns)
        origin = self.origin_row.get(columns, first_row) - first_row
        if origin < 0:
            running = None
            origin = 0
        lag_rows = int(np.ceil(max(c.lag_s for c in readings.chains) / readings.dt_s))
        next_origin = max(stop - 1 - max(lag_rows, LEAST_BACK_ROWS), origin)
        origin_sample = int(readings.sample_of_row[origin])
        result, self.running[columns] = smooth_block(
            readings.base,
            readings.dt_s,
            readings.chains,
            origin_sample,
            int(readings.sample_of_row[next_origin]),
            min(first_row + origin, block.keep.start),
            running,
            self.learns,
            names=readings.names,
            units=[unit.base for unit in readings.units],
            lag_covariance=readings.lag_covariance_s2,
            split_u_s=readings.split_u_s,
            static_u=readings.static_u_K,
            late_s=readings.late_s,
            laws=readings.laws,
            flow=readings.flow,
            flow_u=0.0 if readings.flow_u is None else readings.flow_u,
        )
        self.origin_row[columns] = first_row + next_origin
        return (readings if running is None else readings.from_sample(origin_sample)), result
