"""Inputs that a logger repeats until their sensor has a new value.

A repeated value is an old one: it delays the input by up to the interval of its new values.
``tests/identify/test_identify_repeats.py`` checks slow inputs and columns that only look like it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from tcdyn.core import Array
from tcdyn.core.findings import info, warning
from tcdyn.identification.holds import Holds
from tcdyn.identification.iodata import IOData, Run
from tcdyn.series.updates import ONE_STEP_LIMIT, even_spacing, find_updates

# Median change of a slow input that was measured, over its range, at most: the limit between set
# and measured inputs of ``is_setpoint``.
MAX_CHANGE_SHARE = 0.05


def with_new_values_of_inputs(data: IOData, hold: Holds | Literal["auto"] = "auto") -> IOData:
    """Keep only the rows with new values of inputs that a logger repeats in between.

    Parameters
    ----------
    data
        The record; outputs are NaN where they were repeated.
    hold
        The input between samples as the user gives it. An input that is held ("zoh") was set and
        really stays constant.

    Returns
    -------
    IOData
        Where measured inputs are repeated, only the rows with their new values remain, and
        ``dt_s`` is their interval. A finding for each such input.

    Notes
    -----
    An input that is repeated may have been set. It counts as measured if the user says so ("foh"),
    or if its changes are small and the outputs are repeated at the same rows. If the changes are
    small and the outputs are not repeated, both are possible: there is a warning.
    """
    period, first = (1, 0) if "zoh" in hold else _period_of_inputs(data)
    if period <= 1:
        return data
    interval_s = period * data.dt_s
    outputs = [np.flatnonzero(np.isfinite(y)) for run in data.runs for y in run.y.T]
    are_outputs_repeated = all(even_spacing(rows) == (period, first) for rows in outputs)
    if hold == "auto" and not are_outputs_repeated:
        findings = [
            warning("record.slow_input", subject=name, interval_s=interval_s)
            for name in data.input_names
        ]
        return replace(data, findings=(*data.findings, *findings))
    findings = [
        info("series.repeats", subject=name, percent=100 / period, interval_s=interval_s)
        for name in data.input_names
    ]
    runs = tuple(_every_nth(run, first, period, data.dt_s) for run in data.runs)
    return replace(data, runs=runs, dt_s=interval_s, findings=(*data.findings, *findings))


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
    is_common = all(u.repeats_values and (u.period, u.first) == (period, first) for u in updates)
    if not is_common or not all(map(_is_smooth, traces)):
        return 1, 0
    return max(period, 1), first


def _is_smooth(u: Array) -> bool:
    """Whether an input (N,) moves by small changes, as if measured, and not by one step only."""
    u = u[np.isfinite(u)]
    change = np.abs(np.diff(u))
    changes = change[change > 0]
    usual = float(np.median(changes))
    is_small = usual <= MAX_CHANGE_SHARE * np.ptp(u)
    return bool(is_small and usual > ONE_STEP_LIMIT * changes.min())


def _every_nth(run: Run, first: int, period: int, dt_s: float) -> Run:
    """Every ``period``-th sample of a run, from row ``first`` on."""
    rows = slice(first, None, period)
    return replace(
        run, u=run.u[rows].copy(), y=run.y[rows].copy(), start_s=run.start_s + first * dt_s
    )
