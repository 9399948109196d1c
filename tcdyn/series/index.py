"""The clock of a pandas index, for functions whose samples must be even.

Tests: ``tests/core/test_labels.py``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from tcdyn.core.errors import InputError
from tcdyn.core.labels import seconds_of_index
from tcdyn.series.clock import MIN_STRAY, fit_clock


def even_interval_s(index: pd.Index[Any], where: str) -> float | None:
    """Interval of an index of even times [s]; None if it states no time.

    Parameters
    ----------
    index
        The index.
    where
        What an error names.

    Raises
    ------
    InputError
        For times that are not even, and for samples without a row.

    Examples
    --------
    >>> even_interval_s(pd.date_range("2026-03-01", periods=20, freq="500ms"), "smooth")
    0.5
    """
    time_s = seconds_of_index(index)
    if len(time_s) < 2:
        return None
    is_rising = bool(np.isfinite(time_s).all() and np.diff(time_s).min() > 0)
    if is_rising:
        clock = fit_clock(time_s)
        # stamps as coarse as the interval are even, or rows are missing
        is_fine = clock.resolution_s < 0.5 * clock.interval_s
        rounding_s = clock.resolution_s if is_fine else 0.0
        is_even = clock.stray_s <= max(rounding_s, MIN_STRAY * clock.interval_s)
        if is_even and not clock.n_lost:
            return clock.interval_s
    raise InputError(
        "the times of the index are not even",
        where=where,
        expected="one sampling interval",
        remedy="use DataFrame.resample(..).mean() of pandas, or give arrays",
    )
