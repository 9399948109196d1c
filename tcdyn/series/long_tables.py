"""Refuse tables in which several channels share the columns of values (long, or "tidy", tables).

``check_one_channel`` is called wherever a table with a time is opened; what is a channel is decided
by :mod:`tcdyn.series.value_channels`. Tests: ``tests/cli/test_long_tables.py``.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tcdyn.core import Array
from tcdyn.core.errors import InputError, Value
from tcdyn.io.cells import ABSENT, is_number
from tcdyn.io.pandas_lines import pandas_line
from tcdyn.io.read import CsvTable, TextTable, read_labels
from tcdyn.io.stamps import is_time_of_day
from tcdyn.io.table import CHUNK_ROWS, Table
from tcdyn.series.value_channels import (
    MAX_LABELS,
    Codes,
    LabelColumn,
    ValueChannels,
    find_channels,
)

# Rows that decide whether a column may hold labels. By judgement: some cycles of MAX_LABELS labels.
HEAD_ROWS = 2000
# Rows of a label in them, on average, so that notes and readings are no labels. By judgement.
HEAD_ROWS_OF_LABEL = 4
MAX_PAIRED = 6  # columns of words that are looked at two at a time. By judgement.
LISTED = 8  # channels that a message names

Labels = tuple[Codes, tuple[str, ...]]


def check_one_channel(
    table: Table,
    time: str | None,
    readings: Sequence[str] | None,
    others: Collection[str] = (),
    run: str | None = None,
) -> None:
    """Check that the rows of an open table are those of one channel for each column of readings.

    Parameters
    ----------
    table
        The table.
    time
        Its time column; None: it has none.
    readings
        Columns of readings; None: all columns of numbers.
    others
        Other columns that the caller uses; they name no channels.
    run
        Column of runs: within a run the rows must be those of one channel.

    Raises
    ------
    InputError
        With the channels, the number of rows of each, and a line of Python that keeps one.

    Notes
    -----
    Columns that may hold labels are read, and the time and readings of a table that has some. What
    cannot be read is left to the caller, whose error says more.
    """
    used = {*(readings or ()), *others}
    names = [n for n in table.names if n != time and n not in used and not table.is_time(n)]
    try:
        columns = [c for c in _label_columns(table, names) if c.can_name_channels]
        if not columns:
            return
        times, stamps = (None, None) if time is None else _times(table, time)
        if readings is None:
            labels = {column.name for column in columns}
            readings = [name for name in names if name not in labels]
        values = _first_values(table, readings)
        runs = None if run is None else _labels(table, [run])[run][0]
    except InputError:
        return
    _refuse_channels(columns, times, values, stamps, runs, table.where, table)


def _refuse_channels(
    columns: Sequence[LabelColumn],
    time_s: Array | None,
    readings: Mapping[str, Array],
    stamps: Codes | None,
    runs: Codes | None,
    where: str,
    table: Table | None,
) -> None:
    """Raise InputError if one of the columns names channels.

    Parameters
    ----------
    columns
        Columns of labels.
    time_s, readings, stamps
        As for ``tcdyn.series.value_channels.find_channels``.
    runs
        Index of the run of each row (N,); None: the table is one run.
    where, table
        The table; None for one in memory.
    """
    groups = [np.ones(len(columns[0].codes), dtype=bool)]
    if runs is not None:
        groups = [runs == code for code in np.unique(runs)]

    def channels_of(column: LabelColumn) -> list[ValueChannels]:
        """The channels in each run that a column names."""
        candidates = []
        for rows in groups:
            of_group = None if time_s is None else time_s[rows]
            values = {name: y[rows[: len(y)]] for name, y in readings.items()}
            of_stamps = None if stamps is None else stamps[rows]
            candidates.append(find_channels(column.of_rows(rows), of_group, values, of_stamps))
        return [channels for channels in candidates if channels is not None]

    candidates = [channels for column in columns for channels in channels_of(column)]
    if not candidates:
        words = [column for column in columns if column.has_words][:MAX_PAIRED]
        pairs = [first.with_column(second) for first, second in combinations(words, 2)]
        candidates = [channels for pair in pairs for channels in channels_of(pair)]
    if candidates:
        most = max(candidates, key=lambda channels: len(channels.rows))
        raise _error(most, list(readings), where, table)


def _error(
    channels: ValueChannels, readings: Sequence[str], where: str, table: Table | None
) -> InputError:
    """The error that names the channels, and what to do.

    Parameters
    ----------
    channels
        The channels.
    readings
        Columns of readings that they share.
    where, table
        The table; None for one in memory.
    """
    listed = [f"{name!r} ({rows} rows)" for name, rows in channels.rows.items()]
    more = len(listed) - LISTED
    text = ", ".join(listed[:LISTED]) + (f" and {more} more" if more > 0 else "")
    columns = " and ".join(map(repr, channels.columns))
    problem = f"column {columns} names {len(listed)} channels that share the values"
    if readings:
        problem += f" of {', '.join(map(repr, readings[:LISTED]))}"
    selection, parameters = _selection(channels, table)
    remedy = f"keep the rows of one, for example with {selection}"
    if channels.restarts:
        problem = f"the time runs backward where {columns} changes, which has {len(listed)} names"
        remedy = f"if they are channels, {remedy}; if they are runs, name their column or give one"
    return InputError(
        f"{problem}: {text}",
        where=where,
        expected="one channel in a column of values",
        remedy=remedy,
        parameters=parameters,
    )


def _selection(channels: ValueChannels, table: Table | None) -> tuple[str, dict[str, Value]]:
    """What selects the rows of the first channel, and the parameters that it names.

    Channels of one column are selected by an option; those that two columns name by pandas.
    """
    if len(channels.columns) == 1:
        return "{where}", {"where": f"{channels.columns[0]}={channels.first[0]}"}
    first = next(iter(channels.rows))
    as_text = isinstance(table, CsvTable)
    conditions = []
    for column, cell in zip(channels.columns, channels.first):
        if not as_text and is_number(cell):
            conditions.append(f"(pd.to_numeric(d[{column!r}]) == {cell})")
        else:
            conditions.append(f"(d[{column!r}].str.strip() == {cell!r})")
    line = pandas_line(table, f"d[{' & '.join(conditions)}]", ending=first, as_text=as_text)
    return f"this line: {line}", {}


def _may_name(labels: Labels) -> bool:
    """Whether the labels of the first rows may be those of channels: few words or whole numbers."""
    codes, texts = labels
    if len(texts) > min(MAX_LABELS, max(len(codes) / HEAD_ROWS_OF_LABEL, 1)):
        return False
    return all(not is_number(text) or _is_whole(text) for text in texts)


def _is_whole(text: str) -> bool:
    """Whether a number is written without a fraction, or with one that is zero."""
    whole, _, fraction = text.replace(",", ".").partition(".")
    return "e" not in whole.lower() and not fraction.strip("0")


def _label_columns(table: Table, names: Sequence[str]) -> list[LabelColumn]:
    """Columns of a table that may hold labels, by its first rows, with all their rows."""
    if isinstance(table, TextTable):  # a name that stands twice got another one
        names = [name for name in names if name in table.dialect.names]
    head = _labels(table, names, HEAD_ROWS) if names else {}
    some = [name for name, labels in head.items() if _may_name(labels)]
    all_rows = _labels(table, some) if some else {}
    return [LabelColumn(name, *labels) for name, labels in all_rows.items() if _may_name(labels)]


def _labels(table: Table, names: Sequence[str], rows: int | None = None) -> dict[str, Labels]:
    """Cells of columns as labels; of about so many rows, or all."""
    if isinstance(table, TextTable):
        return read_labels(table.dialect, names, rows)
    of_text = [name for name in names if name in table.cells]
    found = {name: _labels_of_cells(table.cells[name][:rows]) for name in of_text}
    names = [name for name in names if name not in of_text]
    if not names:
        return found
    parts: dict[str, list[NDArray[Any]]] = {name: [] for name in names}
    chunks = table.chunks(names, rows or CHUNK_ROWS)
    for chunk in chunks:
        for name in names:
            parts[name].append(chunk.stamps.get(name, chunk.data[name]))
        if rows is not None:
            break
    _close(chunks)
    for name, cells in parts.items():
        if cells:
            found[name] = _labels_of_cells(np.concatenate(cells))
    return found


def _labels_of_cells(cells: NDArray[Any]) -> Labels:
    """Index of the label of each cell (N,), -1 where it is empty, and the labels."""
    cell_codes, values = pd.factorize(cells)
    texts = [str(value).strip() for value in values]
    labels = list(dict.fromkeys(text for text in texts if text.lower() not in ABSENT))
    index = {text: k for k, text in enumerate(labels)}
    codes = np.array([*(index.get(text, -1) for text in texts), -1], dtype=np.intp)
    return codes[cell_codes], tuple(labels)


def _times(table: Table, time: str) -> tuple[Array, Codes | None]:
    """Times of all rows (N,), and the index of their clock times if these have no date."""
    values = []
    cells = []
    for chunk in table.chunks([time], CHUNK_ROWS):
        values.append(chunk.data[time])
        if time in chunk.stamps:
            cells.append(chunk.stamps[time])
    times = np.concatenate([np.empty(0), *values])
    if not cells or table.date_columns or not is_time_of_day(str(cells[0][0])):
        return times, None
    return times, pd.factorize(np.concatenate(cells))[0]


def _first_values(table: Table, readings: Sequence[str]) -> dict[str, Array]:
    """Readings (M,) of the first chunk, of columns of numbers."""
    chunks = table.chunks(list(readings), CHUNK_ROWS)
    first = next(iter(chunks), None)
    _close(chunks)
    if first is None:
        return {}
    numbers = {n: first.data[n] for n in readings if first.data[n].dtype.kind in "fiu"}
    return {name: values for name, values in numbers.items() if np.isfinite(values).any()}


def _close(chunks: Any) -> None:
    """End a reader that was not read to its end."""
    close = getattr(chunks, "close", None)
    if close is not None:
        close()
