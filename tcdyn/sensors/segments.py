"""Overlapping segments of the rows of a table, for a smoother that runs in bounded memory.

``tcdyn.sensors.compensation`` reads with it. ``tests/sensors/test_sensor_file.py`` checks that
segments give the same as the full table, ``tests/smoothing/test_fixed_delay.py`` that blocks with a
fixed delay depend on the rows only.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tcdyn.core import Array
from tcdyn.core.findings import Finding
from tcdyn.series.source import ChunkSource
from tcdyn.smoothing.process_noise import FLOOR

# Margin of a segment: rows on either side that are only used to settle the smoother. So many lags
# and rows, chosen by judgement, beyond the time in which the smoothest temperature settles.
MARGIN_LAGS = 10.0
MARGIN_ROWS = 400
SETTLING = 10.0  # memories of the smoother: exp(-10) of the error at the end of a margin remains
SEGMENT_ROWS = 20_000  # least rows of a segment; chosen by judgement
# A segment has at least so many times the rows of its margin. The rows of the margins are smoothed
# twice: a larger number costs memory, a smaller one time. Chosen by judgement.
MARGINS_PER_SEGMENT = 3
# Rows for which the first block with a fixed delay waits: they give the interval, and a first
# estimate of the noise (its relative standard uncertainty is 9 % from 64 rows). By judgement.
START_ROWS = 64
MAX_MARGIN_ROWS = 1 << 16  # largest margin, even if the smoother settles more slowly
# Gap beyond which the record is split, since values before it do not determine those after it; by
# judgement.
LONGEST_GAP_LAGS = 10.0
MIN_GAP_INTERVALS = 60  # a shorter gap never splits; chosen by judgement


@dataclass(frozen=True)
class SegmentPosition:
    """Where a reading with a fixed delay stands between two segments, to continue there.

    Attributes
    ----------
    interval_s
        Typical interval of the rows [s], from the first rows of the table.
    done_rows
        Rows since the last long gap that belong to earlier segments.
    history_rows
        The last of these rows, which are read again.
    """

    interval_s: float
    done_rows: int
    history_rows: int


@dataclass(frozen=True)
class TableSegment:
    """A segment of the table with margins that are only used to settle the smoother.

    Attributes
    ----------
    time_s, data
        Times (N,) [s] and columns (N,), margins included.
    keep
        Rows of the segment without its margins.
    findings
        Findings of the reader.
    rows_before
        Rows since the last long gap that belong to earlier segments.
    position
        Where the reading stands after this segment.
    is_last
        Whether the segment was cut short because the table ended: with a fixed delay a table that
        has grown would be divided otherwise there.
    """

    time_s: Array
    data: dict[str, Array]
    keep: slice
    findings: tuple[Finding, ...]
    rows_before: int = 0
    position: SegmentPosition = SegmentPosition(0.0, 0, 0)
    is_last: bool = False

    def without_first(self, count: int) -> TableSegment:
        """The segment without the first rows of its margin."""
        return replace(
            self,
            time_s=self.time_s[count:],
            data={name: values[count:] for name, values in self.data.items()},
            keep=slice(self.keep.start - count, self.keep.stop - count),
        )


@dataclass(frozen=True)
class _Lengths:
    """Rows of a segment and of its margins; rows in which a gap is seen, that stay in the buffer,
    and that must be read before the segment can be made.
    """

    size: int
    before: int
    after: int
    window: int
    stored: int
    needed: int


def read_segments(
    source: ChunkSource,
    columns: Sequence[str],
    lag_s: float,
    min_rows: int | None = None,
    *,
    delay_s: float | None = None,
    position: SegmentPosition | None = None,
) -> Iterator[TableSegment]:
    """Read a table in overlapping segments; a long gap ends a segment.

    Parameters
    ----------
    source
        The table.
    columns
        Columns to read.
    lag_s
        Largest lag, for the margin [s].
    min_rows
        Least rows of a segment; None: ``SEGMENT_ROWS``.
    delay_s
        None: long segments, with margins on both sides in which the smoother settles. A number
        [s]: blocks with a fixed delay. A block is complete when the rows of this time after its
        first row are there; half of them belong to the block, and half are its margin after.
    position
        With a delay: where an earlier reading stood; ``source`` begins with the history of the next
        block.

    Yields
    ------
    TableSegment
        The segments in the order of the rows; their kept rows are each row once.

    Notes
    -----
    Where segments end depends on the rows only, not on how the file is read. The margin is that of
    the least process-noise intensity that a fit can give, ``FLOOR`` noise variances per second
    cubed: sqrt(2) (interval / ``FLOOR``)^(1/4) is the memory of the smoother there
    (one over the slowest eigenvalue of its Hamiltonian matrix), and ``SETTLING`` memories are
    enough. It has at most ``MAX_MARGIN_ROWS``.

    With a delay of n rows, a block has n - ceil(n / 2) + 1 rows and a margin of ceil(n / 2) rows
    after it, so its first row waits for exactly n rows. The margin before is ten lags, and at least
    ``MARGIN_ROWS``. It is shorter than that of other segments: the rows of a block are estimated
    from fewer rows, and their uncertainty includes that. The first block after a start or a long
    gap waits for ``START_ROWS`` rows. ``tests/smoothing/test_fixed_delay.py`` guards that the
    division depends on the rows only.
    """
    longest_gap_s = LONGEST_GAP_LAGS * lag_s
    chunks = source.read_chunks(columns)
    at_end = False
    time = np.empty(0)
    data: dict[str, Array] = {}
    findings = list[Finding]()
    done = 0  # rows of the buffer that belong to earlier segments
    stretch_rows = 0  # rows since the last long gap that belong to earlier segments
    interval_s = 0.0
    margin = 0
    if position is not None:
        interval_s = position.interval_s
        stretch_rows = position.done_rows
        done = position.history_rows
    while done < len(time) or not at_end:
        if delay_s is None:
            lengths = _settled_lengths(margin, min_rows or SEGMENT_ROWS)
        else:
            lengths = _delayed_lengths(delay_s, lag_s, interval_s, stretch_rows)
        if not at_end and len(time) < done + lengths.needed:
            chunk = next(chunks, None)
            if chunk is None:
                at_end = True
                continue
            new_time, new_data, new_findings = chunk
            if len(new_time):
                data = {
                    n: np.concatenate([data[n], new_data[n]]) if n in data else new_data[n]
                    for n in columns
                }
                time = np.concatenate([time, new_time])
            findings += new_findings
            continue
        if not interval_s:
            interval_s = _typical_interval_s(time if delay_s is None else time[:START_ROWS])
            memory_s = np.sqrt(2) * (interval_s / FLOOR) ** 0.25
            settling_s = SETTLING * memory_s + MARGIN_LAGS * lag_s
            margin = _rounded_margin(settling_s / interval_s + MARGIN_ROWS)
            continue
        split_s = max(longest_gap_s, MIN_GAP_INTERVALS * interval_s)
        if done and done < len(time) and time[done] - time[done - 1] > split_s:
            # without rows after a block, the gap after it shows here
            time = time[done:]
            data = {n: values[done:] for n, values in data.items()}
            done = 0
            stretch_rows = 0
            continue
        ahead = time[done : done + lengths.window]
        gaps = np.flatnonzero(np.diff(ahead) > split_s)
        has_gap = len(gaps) > 0
        cut_short = at_end and len(time) < done + lengths.needed and not has_gap
        to_end = has_gap or cut_short
        end = done + (int(gaps[0]) + 1 if has_gap else len(ahead))
        stop = end if to_end else done + lengths.size  # of the segment without its margin
        first = max(done - lengths.before, 0)
        last = end if to_end else stop + lengths.after
        next_rows = 0 if has_gap else stretch_rows + stop - done
        yield TableSegment(
            time[first:last],
            {n: values[first:last] for n, values in data.items()},
            slice(done - first, stop - first),
            tuple(findings),
            stretch_rows,
            SegmentPosition(interval_s, next_rows, min(next_rows, lengths.stored)),
            cut_short,
        )
        findings = []
        drop = stop if has_gap else max(stop - lengths.stored, 0)
        time = time[drop:]
        data = {n: values[drop:] for n, values in data.items()}
        done = stop - drop
        stretch_rows = next_rows


def _settled_lengths(margin: int, min_rows: int) -> _Lengths:
    """Lengths of a segment with ``margin`` rows on either side; a gap in the margin is seen."""
    size = max(MARGINS_PER_SEGMENT * margin, min_rows)
    window = size + 2 * margin
    return _Lengths(size, margin, margin, window, margin, window + 1)


def _delayed_lengths(
    delay_s: float, lag_s: float, interval_s: float, stretch_rows: int
) -> _Lengths:
    """Lengths [rows] of a block with a fixed delay; see the notes of ``read_segments``.

    Parameters
    ----------
    delay_s
        The delay [s].
    lag_s
        Largest lag, for the margin before the block [s].
    interval_s
        Interval of the rows [s]; 0: not known yet, so that ``START_ROWS`` are read first.
    stretch_rows
        Rows since the start or the last long gap that belong to earlier blocks.
    """
    if not interval_s:
        return _Lengths(0, 0, 0, 0, 0, START_ROWS)
    rows = int(delay_s / interval_s + 1e-6)
    after = (rows + 1) // 2
    size = rows - after + 1
    after = max(after, START_ROWS - stretch_rows - size)
    before = max(int(np.ceil(MARGIN_LAGS * lag_s / interval_s)), MARGIN_ROWS)
    return _Lengths(size, before, after, size + after, before, size + after)


def _typical_interval_s(time: Array) -> float:
    """Return the typical interval of the first rows [s], above zero."""
    step = np.diff(time[: SEGMENT_ROWS + 1])
    step = step[np.isfinite(step)]
    if not len(step):
        return 1.0
    typical = float(np.median(step)) or float(step.mean())
    return typical if typical > 0 else 1.0  # time that runs backward is refused later


def _rounded_margin(rows: float) -> int:
    """Round a number of rows up to a power of two, beyond 1024 to a multiple of 1024.

    The smoother starts its intervals at the first row of a segment. With this margin they begin at
    the same rows of the table in every segment. At most ``MAX_MARGIN_ROWS``.
    """
    step = 1 << min(int(np.ceil(np.log2(max(rows, 1)))), 10)
    return int(min(step * np.ceil(rows / step), MAX_MARGIN_ROWS))
