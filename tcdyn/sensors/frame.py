"""DataFrames of pandas as a source of rows, as if they were a file with the same columns.

``compensate_frame`` and the functions ``sensor_from_...`` read with it. Tests:
``tests/sensors/test_compensate_frame.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import SampleLocation
from tcdyn.io.metadata import START_TIME_KEY, check_not_compensated
from tcdyn.io.table import Columns, Table, in_chunks
from tcdyn.io.times import TimeColumn, find_time_column, is_time_name
from tcdyn.sensors.table import Source


def frame_source(
    frame: pd.DataFrame,
    time: str | None = None,
    time_unit: str | None = None,
    units: Mapping[str, str] | None = None,
) -> Source:
    """The numeric columns of a frame as a source of rows, with its time.

    Parameters
    ----------
    frame
        The table.
    time, time_unit
        Column of the time (None: the index), and its unit.
    units
        Units by column.

    Returns
    -------
    Source
        The numeric columns as rows of a table, with the time [s] from the first row for dates and
        durations.

    Raises
    ------
    InputError
        If there is no time, its unit is not clear, or the frame is compensated already.
    """
    where = "the DataFrame"
    metadata = {str(k): v for k, v in frame.attrs.items() if isinstance(v, str)}
    check_not_compensated([str(label) for label in frame.columns], metadata, where)
    units = units or {}
    data: dict[str, Array] = {}
    texts: dict[str, NDArray[Any]] = {}
    for label in frame.columns:
        numbers = _floats_or_none(frame[label])
        if numbers is not None:
            data[str(label)] = numbers
        elif frame[label].dtype.kind not in "Mm":
            texts[str(label)] = np.asarray(frame[label].astype(object))
    times, name = _time_values(frame, time, time_unit, list(data), where)
    kind = times.dtype.kind
    if kind in "Mm":
        clock = TimeColumn(name, 1.0, True, "s", where)
        instants = pd.Series(times)
        first = instants.iloc[0] if len(instants) else pd.NaT
        if kind == "M" and not pd.isna(first):
            metadata[START_TIME_KEY] = first.isoformat()
        elapsed: Any = instants - first
        data[name] = np.asarray(elapsed.dt.total_seconds(), dtype=np.float64)
    else:
        clock = find_time_column([name], where, requested=name, unit=time_unit, unit_row=units)
        data[name] = np.asarray(times, dtype=float)
    columns = Columns(data, SampleLocation(where))
    chunks = partial(in_chunks, columns)
    texts.pop(name, None)
    table = Table(where, tuple(data), metadata, chunks, units=units, texts=texts)
    return Source(Path("DataFrame"), table, clock)


def _floats_or_none(column: pd.Series) -> Array | None:
    """The column as floats; None if it holds no numbers."""
    if column.dtype.kind in "fiub":
        return column.to_numpy(dtype=float, na_value=np.nan)
    return None


def _time_values(
    frame: pd.DataFrame,
    time: str | None,
    time_unit: str | None,
    names: Sequence[str],
    where: str,
) -> tuple[pd.Index[Any], str]:
    """Times of the rows, and a name for them.

    Parameters
    ----------
    frame
        The table.
    time, time_unit
        Column of the time (None: the index, or a column with such a name), and its unit.
    names
        Names of the numeric columns.
    where
        The table, for messages.

    Returns
    -------
    times, name
        Times of the rows (N,), as numbers, dates or durations; name of the column or the index that
        holds them.

    Raises
    ------
    InputError
        For a column that is missing, and an index that is no time.
    """
    index = frame.index
    # pandas numbers the rows of a table that was read without an index, and keeps these numbers
    # when rows are selected or sorted: integers without a name are no times
    numbers_rows = index.dtype.kind in "iu" and index.name is None and time_unit is None
    if time is None and numbers_rows:
        labels_as_text = [str(label) for label in frame.columns]
        candidates = [str(n) for n in frame.columns if str(n) in names or _is_time(frame[n])]
        # times as text come last: the error about them says how to convert them
        candidates += [n for n in labels_as_text if n not in candidates and is_time_name(n)]
        time = find_time_column(candidates or labels_as_text, where).name
    if time is not None:
        labels = {str(label): label for label in frame.columns}
        if time not in labels:
            find_time_column(list(labels), where, requested=time)  # raises, with similar names
        return _as_index(frame[labels[time]], time, where), time
    name = str(index.name or "index")
    while name in names:
        name = f"{name} of the index"
    return _as_index(index, name, where), name


def _is_time(column: pd.Series) -> bool:
    """Whether a column holds dates or durations."""
    return column.dtype.kind in "Mm"


def _as_index(values: pd.Series | pd.Index[Any], name: str, where: str) -> pd.Index[Any]:
    """The index or column ``name`` of ``where`` as times: numbers, dates or durations.

    Raises
    ------
    InputError
        For anything else.
    """
    index = pd.Index(values)
    if index.dtype.kind not in "fiuMm":
        raise InputError(
            f"the time {name!r} holds {index.dtype}",
            where=where,
            expected="numbers, dates or durations",
            remedy="convert it, for example with pandas.to_datetime",
        )
    return index
