"""Columns of a table that a logger repeats until their sensor has a new value.

A repeated value is an old one: it delays the output by up to the interval of its new values.
``tcdyn.identification.tables`` leaves such values out. ``tests/identify/test_identify_repeats.py``
checks slow outputs, slow inputs and columns that only look like it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from tcdyn.core import Array
from tcdyn.core.findings import Finding, info, warning
from tcdyn.identification.holds import Holds
from tcdyn.identification.iodata import IOData, Run
from tcdyn.series.updates import ONE_STEP_LIMIT, Updates, find_updates

# An output with fewer distinct values than this share of its changes was set in levels, not
# measured (chosen by judgement).
MIN_DISTINCT_SHARE = 0.2
# Median change of a slow input that was measured, over its range, at most: the limit between set
# and measured inputs of ``is_setpoint``.
MAX_CHANGE_SHARE = 0.05


def without_repeats(data: IOData, hold: Holds | Literal["auto"] = "auto") -> IOData:
    """Leave out the repeated values of slow columns.

    Parameters
    ----------
    data
        The record.
    hold
        The input between samples as the user gives it. An input that is held ("zoh") was set and
        really stays constant.

    Returns
    -------
    IOData
        Repeated outputs are NaN. Where measured inputs are repeated, only the rows with their new
        values remain, and ``dt_s`` is their interval. A finding for each slow column.

    Notes
    -----
    An input that is repeated may have been set. It counts as measured if the user says so ("foh"),
    or if its changes are small and the outputs are repeated at the same rows. If the changes are
    small and the outputs are not repeated, both are possible: there is a warning.
    """
    findings: list[Finding] = []
    outputs = [find_updates(y) for run in data.runs for y in run.y.T]
    period, first = (1, 0) if "zoh" in hold else _period_of_inputs(data)
    if period > 1 and (hold != "auto" or _have_spacing(outputs, period, first)):
        findings += [_slow_column(name, 1 / period, data.dt_s) for name in data.input_names]
        runs = tuple(_every_nth(run, first, period, data.dt_s) for run in data.runs)
        data = replace(data, runs=runs, dt_s=data.dt_s * period)
    elif period > 1:
        interval_s = period * data.dt_s
        findings += [
            warning("record.slow_input", subject=name, interval_s=interval_s)
            for name in data.input_names
        ]
    columns = [run.y.copy() for run in data.runs]
    for k, name in enumerate(data.output_names):
        shares = []
        for y in columns:
            updates = find_updates(y[:, k])
            if updates.repeats_values and _is_measured(y[:, k], updates):
                y[~updates.new, k] = np.nan
                shares.append(updates.share)
        if shares:
            findings.append(_slow_column(name, float(np.mean(shares)), data.dt_s))
    if not findings:
        return data
    runs = tuple(replace(run, y=y) for run, y in zip(data.runs, columns))
    return replace(data, runs=runs, findings=(*data.findings, *findings))


def _period_of_inputs(data: IOData) -> tuple[int, int]:
    """Rows from one new value of all inputs to the next, and the first such row.

    Parameters
    ----------
    data
        The record.

    Returns
    -------
    period
        1 if the inputs are not all repeated at the same rows, or if their changes are large.
    first
        Row of the first new value.
    """
    traces = [u for run in data.runs for u in run.u.T]
    updates = [find_updates(u) for u in traces]
    period, first = updates[0].period, updates[0].first
    if not _have_spacing(updates, period, first) or not all(map(_is_smooth, traces)):
        return 1, 0
    return max(period, 1), first


def _have_spacing(updates: Sequence[Updates], period: int, first: int) -> bool:
    """Whether columns are repeated, with new values at the same even spacing."""
    return all(u.repeats_values and (u.period, u.first) == (period, first) for u in updates)


def _is_smooth(u: Array) -> bool:
    """Whether an input (N,) moves by small changes, as if measured, and not by one step only."""
    u = u[np.isfinite(u)]
    change = np.abs(np.diff(u))
    changes = change[change > 0]
    usual = float(np.median(changes))
    is_small = usual <= MAX_CHANGE_SHARE * np.ptp(u)
    return bool(is_small and usual > ONE_STEP_LIMIT * changes.min())


def _is_measured(y: Array, updates: Updates) -> bool:
    """Whether an output (N,) has many distinct values among its new ones."""
    values = y[updates.new]
    return len(np.unique(values)) >= MIN_DISTINCT_SHARE * len(values)


def _every_nth(run: Run, first: int, period: int, dt_s: float) -> Run:
    """Every ``period``-th sample of a run, from row ``first`` on."""
    rows = slice(first, None, period)
    return replace(
        run, u=run.u[rows].copy(), y=run.y[rows].copy(), start_s=run.start_s + first * dt_s
    )


def _slow_column(name: str, share: float, dt_s: float) -> Finding:
    """The finding about a column with new values in a share of the rows."""
    return info("record.repeats", subject=name, percent=100 * share, interval_s=dt_s / share)
