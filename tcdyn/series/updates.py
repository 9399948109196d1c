"""Rows with a new value: a slower source is repeated, or blank, between its values.

``tcdyn.series.series`` uses it, and ``tcdyn.identification.held_inputs`` for inputs. The
limits come from simulated pairs, see the comments; ``tests/series/test_updates.py`` checks a
quantised signal, even spacings and slower channels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tcdyn.core import Array, Flags

# Decisions on repeats. Values by a study of 400 simulated pairs (steps of the logger of 0.3 to 50
# times the noise, in quick and slow fluids): no column without repeats was taken for one with. All
# columns with a new value every 2, 5, 10 or 50 rows were recognised, and 121 of 173 with one every
# 1.1 to 7.7 rows; the others change by few steps. A change of more steps of the logger is large:
# quantisation alone explains one or two.
LARGE_CHANGE_STEPS = 2.5
# Repeats next to large changes: fewer occur by chance in a short record.
MIN_REPEATS = 10
# Share of large changes that a repeat follows; hardly any in a column without repeated values.
MIN_REPEAT_SHARE = 0.05
# Repeats over changes by one step in one direction; about 1 for a quantised signal.
REPEAT_EXCESS = 3.0
# Changes for an even spacing: by chance they would all be in one of two classes of rows once in 5e5
# records.
MIN_REGULAR_CHANGES = 20
REGULAR_SHARE = 0.95  # share of the new values at rows of one even spacing
USUAL_SHARE = 0.8  # of the spacings that are equal in rows of a usual spacing; chosen by judgement
# A change counts from this share of the largest one: smaller ones are rounding errors, for example
# of a conversion of units.
ROUNDING_SHARE = 1e-9
# A change of fewer steps of the logger than this is one step: halfway between one and two.
ONE_STEP_LIMIT = 1.5


@dataclass(frozen=True)
class Updates:
    """New values of one column.

    Attributes
    ----------
    new
        True at rows with a new value (N,).
    repeats_values
        Whether the column repeats its last value between new ones.
    period
        Rows from one new value to the next where they are evenly spaced; 1 for a column with a new
        value in each row; 0 where the spacing is not even.
    first
        Row of the first new value of the even spacing.
    """

    new: Flags
    repeats_values: bool
    period: int
    first: int

    @property
    def share(self) -> float:
        """Share of the rows that have a new value."""
        return float(np.mean(self.new))


def find_updates(y: Array) -> Updates:
    """Find the rows at which a column has a new value.

    Parameters
    ----------
    y
        Readings (N,) in any unit, NaN where there is none.

    Returns
    -------
    Updates
        The rows with new values.

    Notes
    -----
    A quantised signal repeats itself, too. The chance of a change by zero steps of the logger is
    then about that of a change by one step up or down, since the density of the changes is smooth.
    A column repeats its values if, next to changes of more than two steps, repeats are clearly more
    frequent than changes by one step, or if all its changes are at rows of one even spacing of two
    or more.

    The limits trade columns without repeats taken for slow ones against slow columns that are not
    recognised. ``tests/series/test_updates.py`` fails in either case.
    """
    rows = np.flatnonzero(np.isfinite(y))
    change = np.abs(np.diff(y[rows]))
    changed = change > ROUNDING_SHARE * np.max(change, initial=0.0)
    changed_rows = rows[1:][changed]
    y_read = y[rows]
    is_rail = (y_read == np.min(y_read, initial=np.inf)) | (
        y_read == np.max(y_read, initial=-np.inf)
    )
    repeats_values = _repeats_exceed_quantisation(change, changed, is_rail)
    period, first = even_spacing(changed_rows)
    if period > 1 and np.count_nonzero(changed) < len(changed):
        spacing, _ = even_spacing(rows)
        repeats_values = repeats_values or period > spacing
    if not repeats_values:
        period, first = even_spacing(rows)
    new = np.zeros(len(y), dtype=bool)
    new[changed_rows if repeats_values else rows] = True
    if period > 1:
        on_grid = np.zeros(len(y), dtype=bool)
        on_grid[first::period] = True
        new = on_grid & np.isfinite(y)
    return Updates(new, repeats_values, period, first)


def usual_spacing(rows: Sequence[NDArray[np.intp]]) -> int:
    """Return the spacing of nearly all rows of one or several sequences.

    Parameters
    ----------
    rows
        Rising numbers of rows, for example those with a reading.

    Returns
    -------
    int
        Rows from one to the next; 1 where they are not even.

    Examples
    --------
    >>> usual_spacing([np.array([0, 5, 10, 15, 25, 30, 35])])
    5
    """
    spacings = np.concatenate([np.diff(each) for each in rows])
    if np.count_nonzero(spacings == 1) >= 0.5 * len(spacings):
        return 1  # as the median below, in less time
    usual = int(np.median(spacings))
    return usual if np.mean(spacings == usual) > USUAL_SHARE else 1


def _repeats_exceed_quantisation(change: Array, changed: Flags, is_rail: Flags) -> bool:
    """Whether repeats next to large changes are more than the logger's steps explain.

    Parameters
    ----------
    change
        Absolute changes from row to row (N - 1,).
    changed
        Whether each is above zero (N - 1,).
    is_rail
        Whether each row has the smallest or the largest value (N,): a flow that is off, or a
        controller at its limit, rests there, and says nothing about repeats.

    Returns
    -------
    bool
        False for a column without any repeat, or with repeats only.
    """
    if not np.any(changed) or np.all(changed):
        return False
    step = float(np.min(change[changed]))
    large = (change[:-1] > LARGE_CHANGE_STEPS * step) & ~is_rail[1:-1]
    count = int(np.count_nonzero(large))
    following = change[1:][large]
    following_changed = changed[1:][large]
    repeats = float(count - np.count_nonzero(following_changed))
    one_step = 0.5 * float(
        np.count_nonzero(following_changed & (following < ONE_STEP_LIMIT * step))
    )
    return repeats > max(MIN_REPEATS, MIN_REPEAT_SHARE * count, REPEAT_EXCESS * one_step)


def even_spacing(rows: NDArray[np.intp]) -> tuple[int, int]:
    """Return period and first row of the widest even spacing of nearly all rows.

    Period 1 means that there is a new value in nearly every row.

    Parameters
    ----------
    rows
        Rows with a new value.

    Returns
    -------
    period
        Rows from one to the next; 1 for nearly every row, 0 where irregular.
    first
        First row of the spacing.
    """
    if len(rows) < MIN_REGULAR_CHANGES:
        return 0, 0
    gap = int(np.median(np.diff(rows)))
    for period in range(gap, 1, -1):
        counts = np.bincount(rows % period, minlength=period)
        first = int(np.argmax(counts))
        if counts[first] >= REGULAR_SHARE * len(rows):
            return period, first
    span = int(rows[-1] - rows[0]) + 1
    return (1 if len(rows) >= REGULAR_SHARE * span else 0), 0
