"""Traces of a log as logged and compensated, for figures.

Used by ``tcdyn view`` (:mod:`tcdyn.report.view`) and by the page of ``tcdyn follow``. Test:
``tests/report/test_view.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tcdyn.core import Array
from tcdyn.io.read import open_table
from tcdyn.series.read import read_all
from tcdyn.series.source import Source
from tcdyn.workflows.raw_log import RawLog


@dataclass(frozen=True)
class Trace:
    """One column of a log, and what compensation made of it.

    Attributes
    ----------
    name, unit, group
        Name, unit and disk of the column; the disk is empty for a table.
    time_s, logged
        Times (N,) [s] and values (N,) as logged, in the unit.
    compensated_s, compensated, u
        Times (M,) [s], values and standard uncertainties (M,); without rows if the trace was not
        compensated.
    """

    name: str
    unit: str
    group: str
    time_s: Array
    logged: Array
    compensated_s: Array
    compensated: Array
    u: Array


def compensated_traces(log: RawLog, out: Path, columns: Sequence[str] = ()) -> list[Trace]:
    """Return columns of a log with their results in the file ``out``.

    Parameters
    ----------
    log
        The log.
    out
        Output of its compensation.
    columns
        Columns of the log; by default all that are compensated.

    Returns
    -------
    traces
        In the unit of the output.
    """
    disk_of = {c.column: group.disk for group in log.channels.groups for c in group.channels}
    units = {
        name: unit for name, unit in log.channels.units.items() if name in (columns or disk_of)
    }
    references = [
        unit.reference_junction
        for unit in units.values()
        if isinstance(unit.reference_junction, str)
    ]
    time_s, logged, _ = read_all(log.source, [*units, *references])
    names_of = {column: unit.names(column) for column, unit in units.items()}
    output_names = [name for names in names_of.values() for name in (names.result, names.u)]
    result = Source(out, open_table(out, output_names), log.source.clock)
    compensated_s, compensated, _ = read_all(result, output_names)
    traces = []
    for column, unit in units.items():
        names = names_of[column]
        values = unit.from_base(unit.to_base(logged[column], unit.cold_degC(logged)))
        traces.append(
            Trace(
                names.result,
                unit.output,
                disk_of[column],
                time_s,
                values,
                compensated_s,
                compensated[names.result],
                compensated[names.u],
            )
        )
    return traces
