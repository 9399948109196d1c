"""All rows of an open table as one series.

Tests: ``tests/series/test_source.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding
from tcdyn.io.read import display_path
from tcdyn.io.start_time import start_time
from tcdyn.series.long_tables import check_one_channel
from tcdyn.series.reading import Kind
from tcdyn.series.series import (
    ANY_GAP,
    ColumnRows,
    Context,
    Policy,
    Series,
    make_series,
    reading_rows,
)
from tcdyn.series.source import Source, check_numbers
from tcdyn.series.units import Unit


def read_series(
    source: Source,
    units: Mapping[str, Unit],
    inputs: Sequence[str] = (),
    policy: Policy = ANY_GAP,
) -> Series:
    """Read columns of a table on even times.

    Parameters
    ----------
    source
        The open table.
    units
        Units of the columns of readings, which become degrees Celsius.
    inputs
        Other columns, such as a current or a speed: as they are in the table.
    policy
        What the flow tolerates.

    Returns
    -------
    Series
        The readings, and what was understood of the table.

    Raises
    ------
    InputError
        For a missing column, several channels in one column, time that does not rise, and what the
        policy does not tolerate.
    """
    source.check_columns([*units, *inputs])
    references = [unit.reference_junction for unit in units.values()]
    names = [*units, *inputs, *(name for name in references if isinstance(name, str))]
    check_one_channel(source.table, source.time, list(units), names)
    time_s, raw, findings = read_all(source, names)
    where = display_path(source.path)
    columns = reading_rows(units, raw, source.table.where)
    for name in inputs:
        check_numbers(name, raw[name], source.table.where)
        columns.append(ColumnRows(name, "", Kind.INPUT, raw[name]))
    context = Context(
        where,
        time=source.time,
        options=source.options,
        policy=policy,
        start_time=start_time(raw, source.time, time_s) if len(time_s) else "",
        findings=findings,
        table=source.table,
        other_times=source.clock.others,
    )
    return make_series(time_s, columns, context)


def read_all(
    source: Source, columns: Sequence[str]
) -> tuple[Array, dict[str, NDArray[Any]], tuple[Finding, ...]]:
    """Read all rows of a table.

    Parameters
    ----------
    source
        The open table.
    columns
        Columns to read.

    Returns
    -------
    time_s
        Times (R,) [s].
    columns
        Columns (R,) as in the table, with the clock stamps of its time column.
    findings
        Findings of the reader.
    """
    times_s = []
    data: dict[str, list[NDArray[Any]]] = {}
    findings: list[Finding] = []
    for chunk_s, chunk, noted in source.read_chunks(columns):
        times_s.append(chunk_s)
        findings += noted
        for name, values in chunk.items():
            data.setdefault(name, []).append(values)
    if not sum(map(len, times_s)):
        raise InputError("no rows", where=source.table.where, expected="a table with readings")
    joined = {name: np.concatenate(parts) for name, parts in data.items()}
    return np.concatenate([np.empty(0), *times_s]), joined, tuple(findings)
