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

# Rows before a block that show its outliers: two windows of the longest burst of a slip ring at
# 75 samples a second, of which one is needed. A matter of time: the rest of the margin is only
# needed where the intensities are learned.
CONTEXT_ROWS = 200
# Rows before a block that are smoothed again, so that a change of the temperature which only later
# rows show is found where it began: those of one lag, and at least so many.
# tests/smoothing/live_study.py: without them the rms error is up to 12 % larger.
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
        What the last block passed on, by the columns that were smoothed together.
    learned_rows
        Rows since the last long gap at the block in which the intensities were learned last.
    learns
        Whether they are learned in the present block.
    rows_back, next_rows_back
        Rows before the present block and the next one that are smoothed again.
    block
        The present block.
    """

    running: dict[tuple[str, ...], Running] = field(default_factory=dict)
    learned_rows: int = 0
    learns: bool = True
    rows_back: int = 0
    next_rows_back: int = 0
    block: TableSegment | None = None

    def passed_on(self) -> DelayedSmoother:
        """What the present block passes on; it does not change with later blocks."""
        return replace(self, running=dict(self.running), block=None)

    def to_dict(self) -> dict[str, Any]:
        """What the present block passes on, as plain data."""
        return {
            "learned_rows": self.learned_rows,
            "rows_back": self.next_rows_back,
            "running": [
                {"columns": list(columns), **running.to_dict()}
                for columns, running in self.running.items()
            ],
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> DelayedSmoother:
        """What ``to_dict`` wrote; raises one of ``tcdyn.core.errors.DAMAGED`` for other data."""
        running = {
            tuple(str(name) for name in each["columns"]): Running.from_dict(each)
            for each in data["running"]
        }
        return cls(running, int(data["learned_rows"]), next_rows_back=int(data["rows_back"]))

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
            self.learned_rows = 0
        since = block.rows_before - self.learned_rows
        wait = min(max(self.learned_rows, START_ROWS), LEARNING_SHARE * before)
        if any(running.is_contradicted for running in self.running.values()):
            wait /= SOONER
        self.learns = before == 0 or since >= wait
        if self.learns:
            self.learned_rows = block.rows_before
        self.block = block
        self.rows_back = self.next_rows_back
        needed_rows = CONTEXT_ROWS + self.rows_back
        return block if self.learns else block.without_first(max(before - needed_rows, 0))

    def smooth(self, readings: ChannelReadings) -> tuple[ChannelReadings, Compensated]:
        """Smooth channels of the present block; the readings begin where the result does.

        Parameters
        ----------
        readings
            Readings of the channels at all samples of the rows that ``begin`` returned.
        """
        assert self.block is not None
        rows = len(readings.sample_of_row)
        block = self.block
        stop = rows - (len(block.time_s) - block.keep.stop)
        start = stop - (block.keep.stop - block.keep.start)
        running = self.running.get(readings.columns)
        origin_row = max(start - 1 - self.rows_back, 0)
        lag_rows = int(np.ceil(max(c.lag_s for c in readings.chains) / readings.dt_s))
        next_row = max(stop - 1 - max(lag_rows, LEAST_BACK_ROWS), origin_row)
        origin = int(readings.sample_of_row[origin_row])
        result, self.running[readings.columns] = smooth_block(
            readings.base,
            readings.dt_s,
            readings.chains,
            origin,
            int(readings.sample_of_row[next_row]),
            max(block.keep.start - self.rows_back, 0),
            running,
            self.learns,
            names=readings.names,
            units=[unit.base for unit in readings.units],
            lag_covariance=readings.lag_covariance_s2,
            split_u_s=readings.split_u_s,
            static_u=readings.static_u_K,
            late_s=readings.late_s,
        )
        self.next_rows_back = stop - 1 - next_row
        return (readings if running is None else readings.from_sample(origin)), result
