"""Tables of any kind as rows with a time: files, DataFrames, and the parts of a growing file.

``open_source`` is where every command and function opens its table; :mod:`tcdyn.series.series`
decides about the rows. Tests: ``tests/series/test_source.py``.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, info
from tcdyn.io.clock_numbers import Midnights
from tcdyn.io.column_names import column_named, missing_column_error
from tcdyn.io.metadata import check_not_compensated
from tcdyn.io.read import Table, sha256_of_file
from tcdyn.io.table import CHUNK_ROWS, Columns, SourceFile
from tcdyn.io.times import (
    TIME_COLUMN_NAMES,
    TimeColumn,
    find_time_column,
    is_time_name,
)
from tcdyn.series.cells import has_cell, missing_cell_error
from tcdyn.series.frame import table_of_frame
from tcdyn.series.joined import files_of_log, open_files
from tcdyn.series.options import ReadingOptions
from tcdyn.series.units import is_match

# Name of the time of rows that have a sampling interval and no column of time.
ROW_TIME = "time_s"

Chunk = tuple[Array, dict[str, Array], tuple[Finding, ...]]


class ChunkSource(Protocol):
    """Source of columns in chunks: an opened table, or a log."""

    def read_chunks(self, columns: Sequence[str]) -> Iterator[Chunk]:
        """Yield time (N,) [s], columns (N,) and findings of each chunk."""


@dataclass(frozen=True)
class Source:
    """An opened table and its time column.

    Attributes
    ----------
    path
        The file; the first one of a log of several.
    table
        The opened table.
    clock
        Its time column.
    options
        How its rows are read.
    """

    path: Path
    table: Table
    clock: TimeColumn
    options: ReadingOptions = field(default=ReadingOptions())

    @property
    def time(self) -> str:
        """Name of the time column."""
        return self.clock.name

    @property
    def value_columns(self) -> list[str]:
        """Names of the other columns."""
        return [name for name in self.table.names if name != self.time]

    def files(self, rows: int) -> tuple[SourceFile, ...]:
        """The files of the table, which has so many rows; none for data in memory."""
        if self.table.sources:
            return self.table.sources
        if not self.path.is_file():
            return ()
        first_row = 0 if self.options.where else 1
        return (SourceFile(self.path, sha256_of_file(self.path), first_row, rows),)

    def check_columns(self, columns: Sequence[str]) -> None:
        """Raise InputError for a column that the table does not have."""
        for name in columns:
            if name not in self.table.names:
                raise missing_column_error("column", name, self.table.names, self.table.where)

    def read_chunks(self, columns: Sequence[str], rows: int = CHUNK_ROWS) -> Iterator[Chunk]:
        """Yield the table in chunks.

        A time column of clock stamps is among the columns as it is in the file.

        Parameters
        ----------
        columns
            Columns to read.
        rows
            Rows of a chunk.

        Returns
        -------
        time_s
            Times (N,) [s].
        columns
            Columns (N,) as in the file, without conversion; clock stamps are among them.
        findings
            Findings of the reader.

        Raises
        ------
        InputError
            Where the unit of time is not clear.
        """
        for time_s, chunk in self.timed_chunks(columns, rows):
            yield time_s, {**chunk.data, **chunk.stamps}, chunk.findings

    def timed_chunks(
        self, columns: Sequence[str], rows: int = CHUNK_ROWS
    ) -> Iterator[tuple[Array, Columns]]:
        """Yield the times (N,) [s] and the columns of each chunk, as ``read_chunks`` does."""
        names = list(dict.fromkeys([self.time, *columns]))
        checked = False
        clock = self.clock
        midnights = Midnights()
        guess = tuple(self.clock.findings())
        chunks = self.table.chunks(names, rows)
        try:
            for chunk in chunks:
                values = chunk.data[self.time]
                # a chunk without rows, which carries findings, has no stamps
                is_clock = self.time in chunk.stamps or len(values) == 0
                if len(values) > 1 and not is_clock:
                    recognised = clock.recognised(values, is_clock)
                    if checked and recognised is not clock:
                        raise self._late_clock_error(recognised)
                    clock = recognised
                times_s = clock.in_seconds(values, is_clock)
                if clock.clock_unit and not is_clock:
                    times_s = midnights.continued(times_s)
                if not checked and len(times_s) > 1:
                    clock.check_step(times_s, is_clock)
                    clock.check_bursts(times_s)
                    checked = True
                yield times_s, replace(chunk, findings=(*guess, *chunk.findings))
                guess = ()
        finally:
            if isinstance(chunks, Generator):
                chunks.close()  # an error leaves no reader of the file behind

    def _late_clock_error(self, clock: TimeColumn) -> InputError:
        """Error for a clock written as numbers that the first rows do not show."""
        return InputError(
            f"column {clock.name!r} holds clock times as numbers, which its first rows do not show",
            where=clock.where,
            remedy="name the unit, {time_unit}",
            parameters={"time_unit": clock.clock_unit},
        )


@dataclass
class RisingRows:
    """A source without the rows whose time is missing, or before that of an earlier row.

    A log that is followed may have such rows where the clock of the logger is set; a table that is
    complete may not.

    Attributes
    ----------
    source
        The source.
    rows, left_out
        Rows read so far, and those of them that were left out.
    """

    source: ChunkSource
    rows: int = 0
    left_out: int = 0

    def read_chunks(
        self, columns: Sequence[str]
    ) -> Iterator[tuple[Array, dict[str, Array], tuple[Finding, ...]]]:
        """Time (N,) [s] and columns (N,) of each chunk, and findings."""
        latest_s = -np.inf
        for time_s, data, findings in self.source.read_chunks(columns):
            before = np.fmax.accumulate(np.concatenate([[latest_s], time_s]))
            used = np.isfinite(time_s) & (time_s >= before[:-1])
            latest_s = float(before[-1])
            self.rows += len(time_s)
            self.left_out += int(np.count_nonzero(~used))
            yield time_s[used], {name: data[name][used] for name in columns}, findings


@dataclass(frozen=True)
class FilledTimes:
    """A source in which single missing times are interpolated from the rows before and after.

    Attributes
    ----------
    source
        The source.
    time
        Name of its time column, for the finding.
    """

    source: ChunkSource
    time: str

    def read_chunks(self, columns: Sequence[str]) -> Iterator[Chunk]:
        """Time (N,) [s] and columns (N,) of each chunk, and findings.

        The last row of a chunk waits for the next one, so that the result does not depend on the
        chunks.
        """
        last: Chunk | None = None
        n_read = 0
        n_filled = 0
        first_row = 0
        for time_s, data, findings in self.source.read_chunks(columns):
            if last is not None:
                time_s = np.concatenate([last[0], time_s])
                data = {name: np.concatenate([last[1][name], data[name]]) for name in columns}
                findings = (*last[2], *findings)
            if len(time_s) < 2:
                last = time_s, {name: data[name] for name in columns}, findings
                continue
            time_s, rows = with_single_times(time_s)
            if len(rows) and not n_filled:
                first_row = n_read + int(rows[0]) + 1
            n_filled += len(rows)
            n_read += len(time_s) - 1
            yield time_s[:-1], {name: data[name][:-1] for name in columns}, findings
            last = time_s[-1:], {name: data[name][-1:] for name in columns}, ()
        if last is not None:
            findings = last[2]
            if n_filled:
                filled = info(
                    "series.filled_time", subject=self.time, count=n_filled, row=first_row
                )
                findings = (*findings, filled)
            yield last[0], last[1], findings


def with_single_times(time_s: Array) -> tuple[Array, NDArray[np.intp]]:
    """Times (N,) [s] in which single missing ones are interpolated, and the rows of these.

    >>> with_single_times(np.array([0.0, np.nan, 2.0]))[0].tolist()
    [0.0, 1.0, 2.0]
    """
    is_missing = ~np.isfinite(time_s)
    if not is_missing.any():
        return time_s, np.empty(0, dtype=np.intp)
    has_neighbours = np.zeros(len(time_s), dtype=bool)
    has_neighbours[1:-1] = ~is_missing[:-2] & ~is_missing[2:]
    rows = np.flatnonzero(is_missing & has_neighbours)
    filled = time_s.copy()
    filled[rows] = 0.5 * (time_s[rows - 1] + time_s[rows + 1])
    return filled, rows


def open_source(
    data: str | Path | Sequence[str | Path] | pd.DataFrame | pd.Series,
    known: Sequence[str] = (),
    options: ReadingOptions | None = None,
) -> Source:
    """Open a table.

    Parameters
    ----------
    data
        A file, several files of one log (:func:`tcdyn.series.joined.open_files`), a DataFrame, or a
        Series over time.
    known
        Names or patterns of the columns that the caller needs; they help to find the header of a
        file. Other columns may have one name; it gets a number.
    options
        How the rows are read.

    Raises
    ------
    InputError
        Without a time column, for a needed column that stands twice (any column, if none is
        named), and for a table that is compensated already.
    """
    options = options or ReadingOptions()
    if isinstance(data, pd.Series):
        data = data.to_frame("reading" if data.name is None else data.name)
    if isinstance(data, pd.DataFrame):
        if options.sheet is not None or options.variable is not None:
            raise InputError(
                "{sheet} and {variable} name a table in a file, and the data are a DataFrame",
                parameters={"sheet": None, "variable": None},
            )
        table, time, time_unit = table_of_frame(data, options)
        options = replace(options, time=time, time_unit=time_unit)
        return source_of_table(Path("DataFrame"), table, known, options)
    files = files_of_log(data)
    if not files:
        raise InputError(
            f"the data are a {type(data).__name__}",
            expected="a file, several files of one log, a DataFrame, a Series over time, or a "
            "tuple of times and arrays",
        )
    table = open_files(files, (*TIME_COLUMN_NAMES, *known), options)
    return source_of_table(files[0], table, known, options)


def source_of_table(
    path: Path,
    table: Table,
    known: Sequence[str] = (),
    options: ReadingOptions | None = None,
) -> Source:
    """Find the time column of an open table; ``path`` is its file.

    The other parameters, and the errors, are those of ``open_source``.
    """
    options = options or ReadingOptions()
    check_not_compensated(table.names, table.metadata, table.where)
    label, _ = options.condition
    table = _with_unique_names(table, [*known, *filter(None, (options.time, label))])
    table, row_time = selected_rows(table, options)
    return Source(path, table, time_of_table(table, options, row_time), options)


def selected_rows(table: Table, options: ReadingOptions) -> tuple[Table, str]:
    """The rows of a table that the options mean.

    Parameters
    ----------
    table
        The table.
    options
        How its rows are read.

    Returns
    -------
    table
        Only the rows with the cell of ``where``; with a column of times where only a sampling
        interval is given.
    row_time
        Name of this column; empty where there is none.
    """
    label, cell = options.condition
    if label:
        table = _rows_with(table, label, cell)
    if options.dt_s is not None and options.time is None:
        return _with_row_times(table, options.dt_s)
    return table, ""


def time_of_table(table: Table, options: ReadingOptions, row_time: str = "") -> TimeColumn:
    """The time column of a table, and its unit.

    Parameters
    ----------
    table
        The table.
    options
        How its rows are read.
    row_time
        Column of times of ``selected_rows``; empty where there is none.

    Raises
    ------
    InputError
        Without a time column.
    """
    if row_time:
        return TimeColumn(row_time, 1.0, True, "s", table.where)
    return find_time_column(
        table.names,
        table.where,
        requested=options.time,
        unit=options.time_unit,
        unit_row=table.units,
        clock_columns=table.clock_columns,
    )


def _with_unique_names(table: Table, needed: Sequence[str]) -> Table:
    """The table with a number behind each name that stands twice.

    Parameters
    ----------
    table
        The table.
    needed
        Names or patterns of the columns that are needed; none: all.

    Raises
    ------
    InputError
        If a needed column or one of time stands twice.
    """
    duplicates = [name for name in dict.fromkeys(table.names) if table.names.count(name) > 1]
    for name in duplicates:
        is_needed = not needed or is_time_name(name)
        if is_needed or any(is_match(pattern, name) for pattern in needed):
            raise InputError(
                f"column {name!r} stands twice", where=table.where, remedy="rename one of them"
            )
    if not duplicates:
        return table
    names = []
    for k, name in enumerate(table.names):
        count = table.names[: k + 1].count(name)
        names.append(f"{name} ({count})" if count > 1 else name)

    def chunks(requested: Sequence[str], rows: int = CHUNK_ROWS) -> Iterator[Columns]:
        yield from table.chunks([name for name in requested if name in table.names], rows)

    return replace(table, names=tuple(names), chunks=chunks)


def _rows_with(table: Table, label: str, cell: str) -> Table:
    """The rows of a table whose column ``label`` holds ``cell``; both text and numbers.

    Raises
    ------
    InputError
        For a column that is missing, and, when the table is read, for a cell that no row has.
    """
    label = column_named(label, table.names, table.where)

    def chunks(requested: Sequence[str], rows: int = CHUNK_ROWS) -> Iterator[Columns]:
        """Yield the chunks of the table with these rows only."""
        names = list(dict.fromkeys([*requested, label]))
        seen: list[NDArray[Any]] = []
        n_kept = 0
        n_read = 0
        for chunk in table.chunks(names, rows):
            count = len(chunk.data[label])
            cells = chunk.stamps.get(label, chunk.data[label])
            if label in table.cells:
                cells = table.cells[label][n_read : n_read + count]
            n_read += count
            is_kept = has_cell(cells, cell)
            n_kept += int(np.count_nonzero(is_kept))
            if not n_kept:
                seen.append(pd.unique(cells))
            data = {name: chunk.data[name][is_kept] for name in requested}
            stamps = {
                name: values[is_kept] for name, values in chunk.stamps.items() if name in requested
            }
            yield replace(chunk, data=data, stamps=stamps)
        if not n_kept:
            cells_of_all = np.concatenate([np.empty(0, dtype=object), *seen])
            raise missing_cell_error(label, cell, cells_of_all, table.where)

    cells = {}
    if label in table.cells:
        is_kept = has_cell(table.cells[label], cell)
        cells = {name: values[is_kept] for name, values in table.cells.items()}
    # a plain table: the reader of labels of a text file would see the other rows
    return Table(
        table.where,
        table.names,
        table.metadata,
        chunks,
        units=table.units,
        clock_columns=table.clock_columns,
        types=table.types,
        date_columns=table.date_columns,
        cells=cells,
        sources=tuple(replace(source, first_row=0) for source in table.sources),
    )


def _with_row_times(table: Table, dt_s: float) -> tuple[Table, str]:
    """The table with a first column of even times [s], and the name of this column."""
    name = ROW_TIME
    while name in table.names:
        name = f"row_{name}"

    def chunks(requested: Sequence[str], rows: int = CHUNK_ROWS) -> Iterator[Columns]:
        """Yield the chunks of the table with the times of their rows."""
        in_table = [column for column in requested if column != name]
        # the number of rows is that of any column
        read = in_table or [table.names[0]]
        first = 0
        for chunk in table.chunks(read, rows):
            count = len(next(iter(chunk.data.values())))
            data = {column: chunk.data[column] for column in in_table}
            if name in requested:
                data[name] = dt_s * np.arange(first, first + count, dtype=float)
            first += count
            stamps = {column: x for column, x in chunk.stamps.items() if column in in_table}
            yield replace(chunk, data=data, stamps=stamps)

    return replace(table, names=(name, *table.names), chunks=chunks), name


def check_numbers(column: str, values: NDArray[Any], where: str) -> None:
    """Check that a column holds numbers.

    Parameters
    ----------
    column
        Its name.
    values
        Its values (N,), from the first row of the table on.
    where
        The table, in the message.

    Raises
    ------
    InputError
        For a column of text, with its first cell.

    Examples
    --------
    >>> check_numbers("T1", np.array([20.0, 20.1]), "log.csv")
    """
    if values.dtype != object:
        return
    row = next((k for k, cell in enumerate(values) if cell), 0)
    raise InputError(
        f"column {column!r} holds text, such as {values[row]!r} in row {row + 1} below the header",
        where=where,
        expected="numbers",
    )
