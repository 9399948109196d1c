"""DataFrames of pandas as tables, as if they were a file with the same columns.

``tcdyn.series.source.open_source`` reads with it. Tests: ``tests/sensors/test_compensate_frame.py``
and ``tests/series/test_source.py``.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import SampleLocation
from tcdyn.io.cells import TextColumn
from tcdyn.io.column_names import column_named
from tcdyn.io.metadata import START_TIME_KEY
from tcdyn.io.table import Columns, Table, in_chunks
from tcdyn.io.times import is_time_name
from tcdyn.series.cells import has_cell, missing_cell_error
from tcdyn.series.options import ReadingOptions

# Key of the attributes of a frame with the units of its columns.
UNITS_KEY = "units"


def table_of_frame(
    frame: pd.DataFrame, options: ReadingOptions, where: str = "the DataFrame"
) -> tuple[Table, str | None, str | None]:
    """The columns of a frame as a table.

    Parameters
    ----------
    frame
        The table. Units by column may be in its ``attrs["units"]``.
    options
        How its rows are read.
    where
        Its name in messages.

    Returns
    -------
    table
        Its columns: numbers, texts as text, dates and durations as seconds from the first row.
    time, time_unit
        Time column and its unit, as options: the index where it states a time.

    Raises
    ------
    InputError
        For a column that stands twice, and for a time that cannot be read.
    """
    labels = [str(label) for label in frame.columns]
    for name in labels:
        if labels.count(name) > 1:
            raise InputError(
                f"column {name!r} stands twice", where=where, remedy="rename one of them"
            )
    units = {str(k): str(v) for k, v in frame.attrs.get(UNITS_KEY, {}).items()}
    metadata = {str(k): v for k, v in frame.attrs.items() if isinstance(v, str)}
    columns = dict(zip(labels, (frame[label] for label in frame.columns)))
    time, time_unit = options.time, options.time_unit
    if time is None and options.dt_s is None and _is_index_time(frame, labels, time_unit):
        time = str(frame.index.name or "index")
        while time in columns:
            time = f"{time} of the index"
        columns[time] = frame.index.to_series(index=pd.RangeIndex(len(frame)))
    data: dict[str, Array] = {}
    texts: dict[str, Any] = {}
    raw_cells: dict[str, Any] = {}
    clocks: list[str] = []
    findings: list[Any] = []
    location = SampleLocation(where)
    for name, values in columns.items():
        kind = values.dtype.kind
        if kind in "fiub":
            data[name] = values.to_numpy(dtype=float, na_value=np.nan)
            continue
        if kind in "Mm":
            data[name] = _seconds(values)
            texts[name] = values.astype(str).to_numpy(dtype=object)
            if kind == "M" and name == time and len(values) and not pd.isna(values.iloc[0]):
                metadata[START_TIME_KEY] = values.iloc[0].isoformat()
        else:
            cells = ["" if cell is None or cell is pd.NA else str(cell).strip() for cell in values]
            raw_cells[name] = np.array(cells, dtype=object)
            column = TextColumn(name, ".", location, is_time=time is None or name == time)
            data[name] = column.numbers(cells, 0)
            findings += column.findings(len(cells), is_complete=False)
            if not (column.clock or column.words):
                continue
            texts[name] = raw_cells[name]
            if not column.clock:
                continue
        clocks.append(name)
    stored = Columns(data, location, tuple(findings), texts)
    chunks = partial(in_chunks, stored)
    names = tuple(data)
    table = Table(
        where,
        names,
        metadata,
        chunks,
        units=units,
        clock_columns=tuple(clocks),
        cells=raw_cells,
    )
    return table, time, time_unit


def _is_index_time(frame: pd.DataFrame, labels: list[str], time_unit: str | None) -> bool:
    """Whether the index of a frame states the time of its rows.

    Dates and durations do. Numbers do where no column has the name of a time; integers without a
    name are the numbers of rows, which pandas keeps when rows are selected or sorted.
    """
    index = frame.index
    kind = index.dtype.kind
    if kind in "Mm":
        return True
    if kind not in "fiu" or any(is_time_name(name) for name in labels):
        return False
    return kind == "f" or index.name is not None or time_unit is not None


def _seconds(values: pd.Series) -> Array:
    """Dates or durations (N,) as seconds from the first row; NaN where there is none."""
    known = values.dropna()
    if not len(known):
        return np.full(len(values), np.nan)
    elapsed = values - known.iloc[0]
    return np.asarray(elapsed.dt.total_seconds(), dtype=np.float64)


def rows_with(frame: pd.DataFrame, label: str, cell: str) -> pd.DataFrame:
    """The rows of a frame whose column ``label`` holds ``cell``.

    Raises
    ------
    InputError
        For a column that is missing, and a cell that no row has.

    Examples
    --------
    >>> rows_with(pd.DataFrame({"id": [1, 2], "T": [20.0, 21.0]}), "id", "2")["T"].tolist()
    [21.0]
    """
    labels = {str(name): name for name in frame.columns}
    label = column_named(label, labels, "the DataFrame")
    cells = frame[labels[label]]
    is_kept = has_cell(cells.to_numpy(), cell)
    if not is_kept.any():
        raise missing_cell_error(label, cell, cells, "the DataFrame")
    return frame[is_kept]
