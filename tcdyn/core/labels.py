"""Labels of pandas objects: times of an index, names of columns.

Functions that take arrays use them for Series and DataFrames, so that a result has the same index.
Tests: ``tests/core/test_labels.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from tcdyn.core import Array
from tcdyn.core.errors import InputError


def common_index(values: Sequence[Any], where: str) -> pd.Index[Any] | None:
    """Index of the Series and DataFrames among ``values``; None if there is none.

    Parameters
    ----------
    values
        Arrays and pandas objects.
    where
        What an error names.

    Raises
    ------
    InputError
        For two different indices.
    """
    indices = [v.index for v in values if isinstance(v, pd.Series | pd.DataFrame)]
    for other in indices[1:]:
        if not other.equals(indices[0]):
            raise InputError(
                "the indices of the Series differ",
                where=where,
                expected="the same index",
                remedy="select the common rows, for example with pandas.concat(.., join='inner')",
            )
    return indices[0] if indices else None


def seconds_of_index(index: pd.Index[Any]) -> Array:
    """Times (N,) of an index [s]: clock times from the first, numbers as they are.

    Empty for an index that states no time: text, or integers without a name.

    Examples
    --------
    >>> seconds_of_index(pd.date_range("2026-03-01", periods=3, freq="500ms"))
    array([0. , 0.5, 1. ])
    >>> seconds_of_index(pd.RangeIndex(3))
    array([], dtype=float64)
    """
    if isinstance(index, pd.DatetimeIndex):
        index = index - index[0]
    if isinstance(index, pd.TimedeltaIndex):
        return np.asarray(index.total_seconds(), dtype=np.float64)
    kind = index.dtype.kind
    if kind == "f" or (kind in "iu" and index.name is not None):
        return index.to_numpy(dtype=np.float64)
    return np.empty(0)


def with_labels(values: Array, template: Any) -> Any:
    """``values`` as a Series or DataFrame with the labels of ``template``, if that is one."""
    if isinstance(template, pd.Series):
        return pd.Series(values, template.index, name=template.name)
    if isinstance(template, pd.DataFrame):
        return pd.DataFrame(values, template.index, template.columns)
    return values


def labels_of(values: Any) -> tuple[str, ...]:
    """Names of the columns of a DataFrame, or of a Series; empty for others, or without a name."""
    if isinstance(values, pd.DataFrame):
        return tuple(map(str, values.columns))
    if isinstance(values, pd.Series) and values.name is not None:
        return (str(values.name),)
    return ()
