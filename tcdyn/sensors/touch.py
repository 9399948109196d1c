"""Touch log: which column responds when the sensors are warmed one after the other (6.4.2.1).

``tcdyn sensor touch`` uses it, to check wiring and labels before a test. A touch is a rise of one
column that stands out of the noise; neighbours rise later and less. ``tests/sensors/test_touch.py``
guards it with touches of a half space, from separate code.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np
import pandas as pd
from scipy.ndimage import uniform_filter1d
from scipy.signal import find_peaks

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, info, warning
from tcdyn.core.result import Result
from tcdyn.estimation.trace_noise import MAD_TO_SD

# Rise in standard deviations of the noise from which it is a touch, and least rise [K]. Of noise
# alone, less than one in 1e12 rises reaches the first. Chosen by judgement.
TOUCH_SIGMAS = 8.0
MIN_RISE_K = 0.1
# Readings are averaged over this share of the duration of a touch; chosen by judgement.
AVERAGED_SHARE = 0.25
# Rises within so many durations of a stronger one belong to the same touch: heat reaches neighbours
# at 10 mm, and leaves, in about 4 s (two durations). Touches must be farther apart.
SAME_TOUCH_DURATIONS = 3.0
# Share of the largest rise from which a second column may be the touched one. Places 1 mm (standard
# deviation of each coordinate) beside the junctions of the thesis: of 1800 touches none is wrong,
# 1 % are unclear; 2 mm beside them: 0.3 % are wrong and not unclear, 7 % are unclear
# (tests/sensors/test_touch.py, study).
AMBIGUOUS_SHARE = 0.5
ONSET_SHARE = 0.1  # of the rise, at which a touch begins; chosen by judgement
# Fall of a column before its rise, as a share of it, from which the rise is a return; by judgement.
RETURN_SHARE = 0.5


@dataclass(frozen=True)
class Touch:
    """One touch.

    Parameters
    ----------
    time_s
        Time at which the column begins to respond [s].
    column
        Column with the largest rise.
    rise_K
        Its rise during a touch [K].
    second
        Column with the second largest rise.
    second_share
        That rise as a share of the largest.
    expected
        Column that the stated order names; empty if none is stated or the counts differ.
    fall_K
        Its fall in the touch before that rise, where it is a large share of it [K]; else 0.
    """

    time_s: float
    column: str
    rise_K: float
    second: str
    second_share: float
    expected: str = ""
    fall_K: float = 0.0


@dataclass(frozen=True, repr=False)
class TouchLog(Result):
    """All touches of a log, compared with the stated order.

    Parameters
    ----------
    touches
        The touches in their order.
    findings
        What differs from the stated order, columns that did not respond, and unclear touches.
    """

    touches: tuple[Touch, ...]
    findings: tuple[Finding, ...]

    def to_frame(self) -> pd.DataFrame:
        """Numbers of each touch."""
        index = pd.RangeIndex(1, len(self.touches) + 1, name="touch")
        columns = [field.name for field in fields(Touch)]
        return pd.DataFrame([asdict(touch) for touch in self.touches], index, columns)

    def headline(self) -> str:
        """Number of touches."""
        return self.summary().splitlines()[-1]

    def card(self) -> pd.DataFrame:
        """One row for each touch."""
        rows = []
        for number, touch in enumerate(self.touches, 1):
            row = {
                "touch": number,
                "time [s]": f"{touch.time_s:.1f}",
                "responded": touch.column,
                "rise [K]": f"{touch.rise_K:.2g}",
                "next": f"{touch.second} ({100 * touch.second_share:.0f} %)",
            }
            if touch.expected:
                row["stated"] = touch.expected
            rows.append(row)
        return pd.DataFrame(rows)

    def summary(self) -> str:
        """The touches as a table, and whether they are in the stated order."""
        lines = [self.card().to_string(index=False)] if self.touches else []
        stated = [touch for touch in self.touches if touch.expected]
        as_stated = sum(touch.column == touch.expected for touch in stated)
        lines.append(f"{len(self.touches)} touches")
        if stated:
            lines[-1] += f", {as_stated} as stated"
        return "\n".join(lines)


def find_touches(
    time_s: Array,
    readings_degC: Array,
    columns: Sequence[str],
    *,
    touch_s: float = 2.0,
    order: Sequence[str] = (),
) -> TouchLog:
    """Find which column responded to each touch, and compare with the order of touching.

    Parameters
    ----------
    time_s
        Even times (N,) [s].
    readings_degC
        Readings (N, M) [degC], NaN where missing.
    columns
        Names of the M >= 2 columns.
    touch_s
        Duration of a touch [s].
    order
        Columns in the order in which their sensors were touched; empty if it is not known.

    Returns
    -------
    TouchLog
        The touches and what to check.

    Raises
    ------
    InputError
        For one column, an unknown column in ``order``, or fewer than two rows in a touch.

    Notes
    -----
    The rise of a column at t is the mean reading about t minus that about t - ``touch_s``. Its
    noise is the median absolute deviation of all its rises. The largest rise that stands out is a
    touch; rises near it (``SAME_TOUCH_DURATIONS``) are responses to the same touch; and so on.

    A touch of a dead sensor leaves at most a small rise of a neighbour. Then the counts of touches
    and stated columns may differ; the order is not compared, and a finding names the columns that
    did not respond.
    """
    if len(columns) < 2:
        raise InputError(f"{len(columns)} column", expected="two or more, to compare them")
    unknown = [name for name in order if name not in columns]
    if unknown:
        raise InputError(f"{unknown[0]} is not among the columns", expected=", ".join(columns))
    step_s = float(time_s[1] - time_s[0])
    n_touch = round(touch_s / step_s)
    if n_touch < 2:
        raise InputError(
            f"a touch of {touch_s:g} s has {touch_s / step_s:.2g} rows", expected="at least two"
        )
    rise_K = _column_rises(readings_degC, n_touch)
    touches = [
        _touch_at(time_s, rise_K, columns, row, round(SAME_TOUCH_DURATIONS * n_touch))
        for row in _touch_rows(rise_K, n_touch)
    ]
    if len(touches) == len(order):
        touches = [replace(touch, expected=expected) for touch, expected in zip(touches, order)]
    return TouchLog(tuple(touches), tuple(_touch_findings(touches, columns, order)))


def _column_rises(readings_degC: Array, n_touch: int) -> Array:
    """Rise of each column within a touch, (N, M) [K]; missing readings are interpolated.

    Parameters
    ----------
    readings_degC
        Readings (N, M).
    n_touch
        Rows of a touch.
    """
    rows = np.arange(len(readings_degC))
    filled = np.zeros_like(readings_degC)
    for k, column in enumerate(readings_degC.T):
        is_read = np.isfinite(column)
        if is_read.any():
            filled[:, k] = np.interp(rows, rows[is_read], column[is_read])
    mean = uniform_filter1d(filled, max(round(AVERAGED_SHARE * n_touch), 1), axis=0)
    rise_K = np.zeros_like(mean)
    rise_K[n_touch:] = mean[n_touch:] - mean[:-n_touch]
    return rise_K


def _touch_rows(rise_K: Array, n_touch: int) -> list[int]:
    """Rows at which a column rises most in each touch, in the order of time.

    Parameters
    ----------
    rise_K
        Rise of each column (N, M) [K].
    n_touch
        Rows of a touch.
    """
    noise_K = MAD_TO_SD * np.median(np.abs(rise_K - np.median(rise_K, axis=0)), axis=0)
    excess = rise_K / np.maximum(TOUCH_SIGMAS * noise_K, MIN_RISE_K)
    largest_K = np.where(excess > 1.0, rise_K, 0.0).max(axis=1)
    distance = max(round(SAME_TOUCH_DURATIONS * n_touch), 1)
    # zeros at the ends: a touch at the end of the record has a peak, too
    peaks, _ = find_peaks(np.pad(largest_K, 1), height=MIN_RISE_K, distance=distance)
    return [int(row) - 1 for row in peaks]


def _touch_at(time_s: Array, rise_K: Array, columns: Sequence[str], row: int, n_same: int) -> Touch:
    """The touch whose largest rise is at a row.

    Parameters
    ----------
    time_s, rise_K
        Times (N,) [s] and rises (N, M) [K].
    columns
        Names of the columns.
    row
        Row of the largest rise.
    n_same
        Rows to either side that belong to the same touch.
    """
    first = int(np.argmax(rise_K[row]))
    window = slice(max(row - n_same // 2, 0), row + n_same // 2 + 1)
    rises_K = rise_K[window].max(axis=0)
    size_K = float(rise_K[row, first])
    rises_K[first] = -np.inf
    second = int(np.argmax(rises_K))
    is_before = rise_K[: row + 1, first] < ONSET_SHARE * size_K
    onset = int(np.flatnonzero(is_before)[-1]) if is_before.any() else 0
    second_share = max(float(rises_K[second]) / size_K, 0.0)
    before = rise_K[max(row - n_same, 0) : row + 1, first]
    fall_K = -float(before.min())
    return Touch(
        float(time_s[onset]),
        columns[first],
        size_K,
        columns[second],
        second_share,
        fall_K=fall_K if fall_K > RETURN_SHARE * size_K else 0.0,
    )


def _touch_findings(
    touches: Sequence[Touch], columns: Sequence[str], order: Sequence[str]
) -> list[Finding]:
    """What differs from the stated order, columns without response, and unclear touches.

    Parameters
    ----------
    touches
        The touches in their order.
    columns
        Names of the columns.
    order
        The stated order; empty if it is not known.
    """
    findings = []
    if order and len(order) != len(touches):
        findings.append(warning("touch.count", count=len(touches), stated=len(order)))
    responded = {touch.column for touch in touches}
    stated_of = {touch.column: touch.expected for touch in touches}
    for number, touch in enumerate(touches, 1):
        about: dict[str, Any] = {"touch": number, "time_s": touch.time_s, "column": touch.column}
        if touch.expected not in ("", touch.column):
            is_exchange = stated_of.get(touch.expected) == touch.column
            findings.append(
                warning("touch.other", **about, stated=touch.expected, exchanged=is_exchange)
            )
        if touch.fall_K:
            findings.append(
                warning("touch.fall", **about, fall_K=touch.fall_K, rise_K=touch.rise_K)
            )
        if touch.second_share > AMBIGUOUS_SHARE:
            share = 100 * touch.second_share
            findings.append(warning("touch.unclear", **about, second=touch.second, percent=share))
    silent = [name for name in columns if name not in responded]
    if silent:
        severity = warning if set(silent) & set(order) or not touches else info
        findings.append(severity("touch.silent", columns=silent))
    return findings
