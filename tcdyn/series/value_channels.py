"""Several channels in one column of values: a long ("tidy") table, found by its column of labels.

A long table has one row for each channel and instant, and a column that names the channel. Its
readings are no record of one sensor. ``tcdyn.series.long_tables`` looks for such columns wherever a
table is opened. Columns of modes, of states and of notes are none. Tests:
``tests/series/test_value_channels.py``; false alarms and detection: ``python -m
tests.series.value_channel_study``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tcdyn.core import Array
from tcdyn.io.cells import FLAGS, is_number

Codes = NDArray[np.intp]

# A label with fewer rows is no channel: no lag can be determined from them. By judgement.
MIN_ROWS = 8
# The channels have at least this share of the rows; the others are rare or empty labels. By
# judgement: a channel that is only logged when it changes may have few rows.
CHANNEL_SHARE = 0.8
MAX_LABELS = 200  # of one column; more are notes or numbers. By judgement.
# Rows that share their stamp with a row before them, under another label, over all that share it.
# Below one, so that a row that was logged twice does not hide the channels. By judgement.
OTHER_LABEL_SHARE = 0.98
# Probability that a column which is independent of the stamps has no label twice at one stamp.
# One in a million: a table has some columns, and tables are many.
CHANCE = 1e-6
# Label changes from row to row, over those of the same labels in random order. Modes last for
# several rows and have few changes; one half separates them. Study: `value_channel_study`.
INTERLEAVED = 0.5
# A cycle: this share of the rows has the label of the row one cycle before; some may be missing.
CYCLE_SHARE = 0.9
# A clock of its own: this share of the steps of a label is within CLOCK_STEP of their median.
# Labels in random order at even times have at most a half of them there.
CLOCK_SHARE = 0.8
CLOCK_STEP = 0.1
# Variance of the rows between two of one label, over that of a random order, (1 - p)/p^2 for a
# share p. A channel that is read at intervals, whatever the order, has a smaller one: 0.33 for two
# that stray by half an interval each. Study: `value_channel_study`.
REGULAR_RATIO = 0.5
# The rows of a label with a clock of its own span this share of the record, or more. By judgement.
SPAN_SHARE = 0.8
# Mean square of the change from one label to the next over that from row to row of one label. In
# one record it is one for white noise, below it for a signal that is slower than the rows. Labels
# that are the sign of a white reading give (pi + 2)/(pi - 2) = 4.5 (in random order), so a cycle,
# which is no function of the reading, needs 4, and an order without a rule five times the sign.
CYCLE_RATIO = 4.0
ORDER_RATIO = 25.0
# A channel that has the values of a code (an error, a switch) has at most this many of them.
MAX_CODE_VALUES = 4
# Least share of the rows of a label, over that of equal shares, where the order has no rule: a
# fault that occurs now and then is no channel. At 0.25 the study refuses one of 60 tables with
# faults; at 0.5 it refuses none and still finds all tables of channels (840 of each, seed 2).
LEAST_SHARE = 0.5
# Labels that divide one record by its value (cold, mild, hot) touch each other: a gap between their
# ranges of at most so many changes from row to row. By judgement.
CLASS_GAP = 3.0
# Share of the stamps that two channels in blocks have in common, if the clock has no date.
COMMON_STAMPS = 0.9
# Share of the time of the shorter of two labels that both have in common, where the time starts
# again: a clock that is set back, once, has less. By judgement.
OVERLAP_SHARE = 0.5
# Step between two blocks, over the usual one, of a clock without date that starts again.
LONG_STEP = 60.0
# Columns whose numbers are names of channels, by their own name.
CHANNEL_NAME = re.compile(
    r"(^|[^a-z])(sensor|channel|chan|ch|kanal|messstelle|probe|fuehler|fühler|device|node|id|addr|"
    r"address|adresse|tc|thermocouple|location|tag|entity|point|signal|variable|quantity|mac|"
    r"serial|port|input)s?([^a-z]|$)",
    re.IGNORECASE,
)
# Words of the calendar, which belong to the clock.
_CALENDAR = re.compile(
    r"(mon|tue|wed|thu|fri|sat|sun)[a-z]*\.?|(mo|di|mi|do|fr|sa|so)|(mon|diens|donners|frei|sams|"
    r"sonn)tag|mittwoch|(jan|feb|mar|apr|may|jun|jul|aug|sep|oct|nov|dec|mär|mai|okt|dez)[a-zä]*\.?"
    r"|[ap]\.?m\.?",
    re.IGNORECASE,
)


@dataclass(frozen=True)
class LabelColumn:
    """A column of labels.

    Attributes
    ----------
    name
        Its name.
    codes
        Index of the label of each row (N,); -1 where it is empty.
    labels
        The labels.
    parts
        The column and its labels; two of them for labels of two columns together.
    """

    name: str
    codes: Codes
    labels: tuple[str, ...]
    parts: tuple[LabelColumn, ...] = ()

    @property
    def has_words(self) -> bool:
        """Whether a label is no number and no word for a switch."""
        return not all(is_number(text) or text.lower() in FLAGS for text in self.labels)

    @property
    def can_name_channels(self) -> bool:
        """Whether it may name channels: 2 to ``MAX_LABELS`` labels, which are no calendar."""
        if not 2 <= len(self.labels) <= MAX_LABELS:
            return False
        return not all(_CALENDAR.fullmatch(text) for text in self.labels)

    def of_rows(self, rows: NDArray[np.bool_]) -> LabelColumn:
        """The labels of some rows (N,)."""
        parts = tuple(part.of_rows(rows) for part in self.parts)
        return LabelColumn(self.name, self.codes[rows], self.labels, parts)

    def with_column(self, other: LabelColumn) -> LabelColumn:
        """The labels of two columns together, such as a device and a quantity."""
        both = self.codes * len(other.labels) + other.codes
        both[(self.codes < 0) | (other.codes < 0)] = -1
        present = np.unique(both[both >= 0])
        codes = np.where(both >= 0, np.searchsorted(present, both), -1)
        labels = [
            f"{self.labels[code // len(other.labels)]} {other.labels[code % len(other.labels)]}"
            for code in present
        ]
        name = f"{self.name} {other.name}"
        return LabelColumn(name, codes.astype(np.intp), tuple(labels), (self, other))


@dataclass(frozen=True)
class ValueChannels:
    """Channels that share the columns of values.

    Attributes
    ----------
    columns
        Column that names them, or the two that do it together.
    first
        The cell of each of these columns that names the first channel.
    rows
        Number of rows of each.
    restarts
        Whether the stamps start again at each name: it may be a run as well.
    """

    columns: tuple[str, ...]
    first: tuple[str, ...]
    rows: dict[str, int]
    restarts: bool


def find_channels(
    labels: LabelColumn,
    time_s: Array | None,
    readings: Mapping[str, Array],
    stamps: Codes | None = None,
) -> ValueChannels | None:
    """Return the channels that a column of labels names, if its rows are those of several.

    Parameters
    ----------
    labels
        The column.
    time_s
        Times of the rows (N,), in any unit; None: the table has none.
    readings
        Columns of readings (M,) of the first M rows, NaN where missing.
    stamps
        Index of the clock time of each row (N,), as it is in the table, where it has no date.

    Returns
    -------
    channels
        None for a column that names no channels.

    Notes
    -----
    The rows of a channel have a clock and values of their own. Labels that last for many rows name
    channels only where the time starts again, so that it goes back from one row to the next but
    never within a label. Labels that change from row to row name channels in one of three cases:

    - rows of different labels have the same stamp, rows of one label do not (``CHANCE``);
    - the labels cycle row by row, or each has even stamps or follows itself more evenly than in
      random order, and the readings differ by label much more than from row to row of one label
      (``CYCLE_RATIO``);
    - the labels have a mixed order without a rule, and the readings differ still more by label
      (``ORDER_RATIO``); here rare labels, labels of codes, and classes of the reading itself, are
      none.

    Numbers that change with the rows may be a part of the clock or an input. They need both stamps
    and readings, or a cycle of at least three, or the name of a channel (``CHANNEL_NAME``).
    """
    if not labels.can_name_channels:
        return None
    counts = np.bincount(labels.codes[labels.codes >= 0], minlength=len(labels.labels))
    is_channel = counts >= MIN_ROWS
    rows = np.flatnonzero((labels.codes >= 0) & is_channel[labels.codes])
    if is_channel.sum() < 2 or len(rows) < CHANNEL_SHARE * len(labels.codes):
        return None
    codes = labels.codes[rows]
    times = None if time_s is None else time_s[rows]
    if times is not None and not np.isfinite(times).all():
        return None
    starts_again = times is not None and _starts_again(codes, times)
    if stamps is not None and times is not None:
        starts_again = starts_again or _repeats_blocks(codes, times, stamps[rows])
    if not starts_again:
        of_rows = {name: values[rows[rows < len(values)]] for name, values in readings.items()}
        if not _are_mixed_channels(labels, codes, times, of_rows):
            return None
    row_counts = {labels.labels[k]: int(counts[k]) for k in np.flatnonzero(is_channel)}
    row_of_first = int(np.flatnonzero(labels.codes == np.argmax(is_channel))[0])
    parts = labels.parts or (labels,)
    columns = tuple(part.name for part in parts)
    first = tuple(part.labels[part.codes[row_of_first]] for part in parts)
    return ValueChannels(columns, first, row_counts, starts_again)


def _are_mixed_channels(
    labels: LabelColumn, codes: Codes, times: Array | None, readings: Mapping[str, Array]
) -> bool:
    """Whether rows in the order of time are those of several channels.

    Parameters
    ----------
    labels
        The column.
    codes, times
        Labels and times of its rows (N,).
    readings
        Readings (M,) of the first of them.
    """
    ratios = [_largest_ratio(codes[: len(y)], y) for y in readings.values()]
    ratio = max(ratios, default=0.0)
    if _mixing(codes) < INTERLEAVED:
        return False
    shares_stamps = times is not None and _shares_stamps(codes, times)
    names_channels = labels.has_words or CHANNEL_NAME.search(labels.name) is not None
    if shares_stamps and (names_channels or ratio >= CYCLE_RATIO):
        return True
    n_labels = len(np.unique(codes))
    is_cycle = _is_cycle(codes, n_labels)
    has_clocks = is_cycle or _is_regular(codes)
    if times is not None:
        has_clocks = has_clocks or _has_own_clocks(codes, times)
    if has_clocks and ratio >= CYCLE_RATIO:
        return names_channels or (is_cycle and n_labels > 2)
    if not names_channels:
        return False
    return any(_differ_without_order(codes[: len(y)], y) for y in readings.values())


def _starts_again(codes: Codes, times: Array) -> bool:
    """Whether the time goes back, but never within a label, to a time that both labels share."""
    back = np.flatnonzero(np.diff(times) < 0)
    if not len(back):
        return False
    order = np.argsort(codes, kind="stable")
    is_same = np.diff(codes[order]) == 0
    if (np.diff(times[order])[is_same] < 0).any():
        return False
    pairs = {(codes[row], codes[row + 1]) for row in back}
    for code, next_code in pairs:
        first = times[codes == code]
        second = times[codes == next_code]
        common = min(first[-1], second[-1]) - max(first[0], second[0])
        if common < OVERLAP_SHARE * min(np.ptp(first), np.ptp(second)):
            return False
    return True


def _repeats_blocks(codes: Codes, times: Array, stamps: Codes) -> bool:
    """Whether a clock without date starts again at each label.

    Its times then rise: a day seems to have passed. The blocks have nearly the same stamps, and the
    step between them is longer than ``LONG_STEP`` usual ones. Days that follow each other have no
    such step.
    """
    changes = np.flatnonzero(np.diff(codes))
    n_labels = len(np.unique(codes))
    if len(changes) != n_labels - 1:
        return False
    steps = np.diff(times)
    if not (steps[changes] > LONG_STEP * np.median(steps)).all():
        return False
    blocks = np.split(stamps, changes + 1)
    common = set.intersection(*(set(block.tolist()) for block in blocks))
    longest = max(len(block) for block in blocks)
    return len(common) >= COMMON_STAMPS * longest


def _shares_stamps(codes: Codes, times: Array) -> bool:
    """Whether rows of different labels have one stamp, and rows of one label have not."""
    order = np.lexsort((codes, times))
    same_stamp = np.diff(times[order]) == 0
    n_shared = int(same_stamp.sum())
    if not n_shared:
        return False
    n_other = int((same_stamp & (np.diff(codes[order]) != 0)).sum())
    if n_other < OTHER_LABEL_SHARE * n_shared:
        return False
    shares = np.bincount(codes) / len(codes)
    return n_other * np.log1p(-np.sum(shares**2)) < np.log(CHANCE)


def _mixing(codes: Codes) -> float:
    """Return the number of label changes over that of a random order."""
    shares = np.bincount(codes) / len(codes)
    expected = (len(codes) - 1) * (1 - np.sum(shares**2))
    return float(np.count_nonzero(np.diff(codes)) / expected)


def _is_cycle(codes: Codes, n_labels: int) -> bool:
    """Whether the labels cycle in one order, each once."""
    if np.mean(codes[n_labels:] == codes[:-n_labels]) < CYCLE_SHARE:
        return False
    shares = np.bincount(codes) / len(codes)
    present = shares[shares > 0]
    return bool(present.min() > 0.5 / n_labels)


def _is_regular(codes: Codes) -> bool:
    """Whether the rows of each label follow each other more evenly than in random order."""
    for code in np.unique(codes):
        gaps = np.diff(np.flatnonzero(codes == code))
        if gaps.sum() < SPAN_SHARE * len(codes):
            return False
        share = np.mean(codes == code)
        if np.var(gaps) > REGULAR_RATIO * (1 - share) / share**2:
            return False
    return True


def _has_own_clocks(codes: Codes, times: Array) -> bool:
    """Whether the rows of each label have even stamps of their own."""
    for code in np.unique(codes):
        steps = np.diff(times[codes == code])
        if steps.sum() < SPAN_SHARE * np.ptp(times):
            return False
        usual = float(np.median(steps))
        is_usual = np.abs(steps - usual) <= CLOCK_STEP * usual
        if usual <= 0 or np.mean(is_usual) < CLOCK_SHARE:
            return False
    return True


def _changes(codes: Codes, y: Array) -> tuple[Array, Array]:
    """Return changes of the reading where the label changes, and at these rows within the label.

    Parameters
    ----------
    codes, y
        Labels and readings (M,).

    Returns
    -------
    array, array
        Change from the row before (L,), and from the last row of the same label (L,).
    """
    finite = np.isfinite(y)
    codes = codes[finite]
    y = y[finite]
    order = np.argsort(codes, kind="stable")
    before = np.full(len(codes), -1)
    is_same = np.diff(codes[order]) == 0
    before[order[1:][is_same]] = order[:-1][is_same]
    rows = np.flatnonzero((np.diff(codes, prepend=codes[:1]) != 0) & (before >= 0))
    return y[rows] - y[rows - 1], y[rows] - y[before[rows]]


def _label_ratio(codes: Codes, y: Array) -> float:
    """Mean square change from label to label over that within labels; 0 from few rows."""
    between, within = _changes(codes, y)
    if len(between) < MIN_ROWS:
        return 0.0
    power = float(np.mean(between**2))
    if power == 0:
        return 0.0
    return power / max(float(np.mean(within**2)), 1e-12 * power)


def _largest_ratio(codes: Codes, y: Array) -> float:
    """The ratio of the mean squares, or that of the squared medians where it is larger.

    A step within few rows hides a difference that is small beside it from the mean squares.
    """
    between, within = _changes(codes, y)
    if len(between) < MIN_ROWS:
        return 0.0
    levels = np.unique(y[np.isfinite(y)])
    resolution = float(np.diff(levels).min()) if len(levels) > 1 else 1.0
    usual_within = max(float(np.median(np.abs(within))), resolution)
    usual_between = float(np.median(np.abs(between)))
    return max(_label_ratio(codes, y), (usual_between / usual_within) ** 2)


def _differ_without_order(codes: Codes, y: Array) -> bool:
    """Whether a reading differs by label so much that an order without a rule is that of channels.

    Labels with the values of a code, rare labels, and classes of the reading itself do not count.

    Parameters
    ----------
    codes, y
        Labels and readings (M,).
    """
    finite = np.isfinite(y)
    codes = codes[finite]
    y = y[finite]
    present = np.unique(codes)
    least_rows = LEAST_SHARE * len(codes) / max(len(present), 1)
    values = {code: y[codes == code] for code in present}
    channels = [
        code
        for code, own in values.items()
        if len(own) >= least_rows and len(np.unique(own)) > MAX_CODE_VALUES
    ]
    if len(channels) < 2:
        return False
    used = np.isin(codes, channels)
    if _label_ratio(codes[used], y[used]) < ORDER_RATIO:
        return False
    ranges = sorted((float(values[code].min()), float(values[code].max())) for code in channels)
    gaps = np.array([low - high for (_, high), (low, _) in pairwise(ranges)])
    usual_change = float(np.median(np.abs(_changes(codes[used], y[used])[1])))
    are_classes = (gaps >= 0).all() and gaps.max() <= CLASS_GAP * usual_change
    return not are_classes
