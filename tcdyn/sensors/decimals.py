"""Number of decimals of results in text files, from their standard uncertainty.

Used by :mod:`tcdyn.sensors.compensation`. Guarded by ``tests/sensors/test_output_columns.py``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from tcdyn.core import Array

# The last decimal is at most this share of the smallest standard uncertainty, which then has two
# significant digits (GUM, 7.2.6). The rounding error has the standard deviation 0.1/sqrt(12) = 3 %
# of it: together they are larger by 0.04 %.
SHARE_OF_U = 0.1
# Most decimals, or significant digits of the largest value where that is below 1: a double has 15
# to 16 significant digits, and the static gain of no chain is known to twelve.
MOST_DIGITS = 12
EXACT_ENDINGS = (".parquet", ".tdms", ".nc")  # files that hold doubles, and no text


def decimals_for(values: Array, u: Array) -> int | None:
    """Number of decimals with which values and their standard uncertainty are written.

    Parameters
    ----------
    values
        Values (N,) in any unit, NaN where there are none.
    u
        Their standard uncertainty (N,) in this unit, NaN where there is none.

    Returns
    -------
    decimals
        At least 0; None where no uncertainty is known.

    Examples
    --------
    >>> decimals_for(np.array([20.0, 21.0]), np.array([0.5, 0.13]))
    2
    >>> decimals_for(np.ones(1), np.zeros(1)) is None
    True
    >>> decimals_for(np.array([101325.0]), np.array([250.0]))
    0
    >>> decimals_for(np.array([3.2e-14]), np.array([2e-16]))
    17
    """
    known = u[np.isfinite(u) & (u > 0)]
    if not len(known):
        return None
    needed = math.ceil(-math.log10(SHARE_OF_U * float(known.min())))
    size = np.abs(values[np.isfinite(values)])
    largest = float(np.max(size, initial=0.0))
    most = MOST_DIGITS
    if 0 < largest < 1:
        most += math.ceil(-math.log10(largest))
    return min(max(needed, 0), most)


def rounded_for_file(
    frame: pd.DataFrame, decimals: Mapping[str, int], path: str | Path
) -> pd.DataFrame:
    """The table with the decimals that are written to a file.

    A binary file holds the numbers as they were computed.

    Parameters
    ----------
    frame
        The table.
    decimals
        Number of decimals by column; other columns keep their own.
    path
        The file.
    """
    if Path(path).suffix.lower() in EXACT_ENDINGS:
        return frame
    return frame.round({name: count for name, count in decimals.items() if name in frame})
