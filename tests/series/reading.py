"""Columns of a table as tests of many packages read them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from tcdyn.core import Array
from tcdyn.core.findings import Finding
from tcdyn.series import ReadingOptions, Source, open_source
from tcdyn.series.read import read_series
from tcdyn.series.series import ONE_PIECE
from tcdyn.series.units import Unit


def source_of(
    path: Path, time: str | None = None, known: Sequence[str] = (), time_unit: str | None = None
) -> Source:
    """An opened table."""
    return open_source(path, known, ReadingOptions(time=time, time_unit=time_unit))


def read_columns(
    table: str | Path | Source,
    columns: Sequence[str],
    units: Mapping[str, Unit] | None = None,
    time: str | None = None,
    time_unit: str | None = None,
) -> tuple[Array, dict[str, Array], list[Finding]]:
    """Even times [s], columns on them, and findings; columns without a unit are not judged."""
    source = table if isinstance(table, Source) else source_of(table, time, columns, time_unit)
    of_columns = {name: unit for name, unit in (units or {}).items() if name in columns}
    others = [name for name in columns if name not in of_columns]
    series = read_series(source, of_columns, others, ONE_PIECE)
    return series.time_s, {n: series.on_grid(n) for n in columns}, list(series.findings)
