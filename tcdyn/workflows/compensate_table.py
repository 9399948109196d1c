"""Compensation of any table with sensor files, segment by segment, in bounded memory.

The command that compensates tables of sensors without a rig (``tcdyn.cli.tables``). Rows need not
be even: they are put on a grid (``tcdyn.sensors.table.even_times``). Guarded by
``tests/sensors/test_sensor_file.py`` and ``tests/sensors/test_sensor_silent.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tcdyn.chain import Chain
from tcdyn.chain import sensors as sensors_of
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Finding, info, warning
from tcdyn.core.result import Result
from tcdyn.core.threads import one_blas_thread
from tcdyn.io.checksum import ALTERED_CODE
from tcdyn.io.metadata import START_TIME_KEY
from tcdyn.io.read import display_path, sha256
from tcdyn.io.start_time import start_time
from tcdyn.io.write import DialectName, log_writer, output_style
from tcdyn.rig.log import COMPENSATED
from tcdyn.rig.static_line import StaticLine, apply_static, reading_u
from tcdyn.sensors.file import SensorFile
from tcdyn.sensors.table import (
    EvenTimes,
    Source,
    TableSegment,
    even_times,
    on_grid,
    open_source,
    read_segments,
    unique_by_subject,
)
from tcdyn.sensors.units import Unit, cold_column, match_columns, unit_findings, units_of
from tcdyn.smoothing.intervals import settling_time_s
from tcdyn.smoothing.record import Compensated
from tcdyn.smoothing.smoother import smooth

# values and columns that are smoothed at once: an event of one column is weighed in all of them.
# Memory and time; chosen by judgement
MAX_VALUES = 400_000
MAX_COLUMNS = 8
# Progress is reported after so many rows, then each time the count has doubled.
PROGRESS_ROWS = 200_000
DECIMALS = 5  # of the output, as in ``tcdyn.workflows.segments``


@dataclass(frozen=True)
class SensorColumn:
    """A column of a table with its sensor.

    Parameters
    ----------
    column
        Name of the column.
    file
        The sensor file.
    index
        Index of the sensor among the columns of the file.
    unit
        Unit of the column.
    """

    column: str
    file: SensorFile
    index: int  # of the sensor file's columns
    unit: Unit

    @property
    def chain(self) -> Chain:
        """The chain of this column."""
        return self.file.chains[self.index]

    @property
    def lag_s(self) -> Estimate:
        """The lag of this column [s]."""
        return self.file.chain.channels[self.file.columns[self.index]].lag_s

    @property
    def line(self) -> StaticLine | None:
        """Static line of this column; None where readings are used as they are."""
        return self.file.static.get(self.file.columns[self.index])


@dataclass(frozen=True)
class CompensatedTable(Result):
    """What was written to a file.

    Parameters
    ----------
    path
        The file.
    rows
        Number of rows.
    columns
        Columns with sensors.
    carried
        Names of the columns that were passed through.
    numbers
        Noise, typical and largest standard deviation [K] of each column with a sensor.
    metadata, findings
        Notes in the file, and findings.
    """

    path: Path
    rows: int
    columns: tuple[SensorColumn, ...]
    carried: tuple[str, ...]
    numbers: pd.DataFrame
    metadata: dict[str, str]
    findings: tuple[Finding, ...]

    def summary(self) -> str:
        """One line for each column."""
        s = "s" if len(self.columns) > 1 else ""
        lines = [f"{self.rows} rows, {len(self.columns)} column{s} compensated: {self.path}"]
        for column, row in zip(self.columns, self.numbers.itertuples(index=False)):
            lines.append(
                f"  {column.column}: lag {column.lag_s.text('s')}; noise {row.noise_sd_K:.3g} K, standard deviation "
                f"{row.sd_typical_K:.3g} K typical, {row.sd_max_K:.3g} K at most"
            )
        return "\n".join(lines)

    def card(self) -> pd.DataFrame:
        """Noise and standard deviation of each column."""
        return self.numbers

    def to_dict(self) -> dict[str, Any]:
        """All fields as plain data."""
        return {
            "out": str(self.path),
            "rows": self.rows,
            "columns": self.numbers.to_dict("records"),
            "carried": list(self.carried),
            "metadata": self.metadata,
            "warnings": list(self.warnings),
            "findings": [f.to_dict() for f in self.findings],
        }


@one_blas_thread
def compensate_table(
    log: str | Path | Source,
    sensors: Sequence[SensorFile],
    out: str | Path | Callable[[pd.DataFrame], None],
    *,
    columns: Sequence[str] = (),
    time: str | None = None,
    time_unit: str | None = None,
    unit: Mapping[str, str] | str = "",
    couple: str = "",
    cold: float | str = 0.0,
    dialect: DialectName = "standard",
    comments: bool = False,
    progress: Callable[[str], None] = lambda _: None,
) -> CompensatedTable:
    """Compensate the columns of any table that sensors cover, and write the table.

    Each column of temperature is replaced by the temperature of the junction in its own unit (mV:
    degrees Celsius), and a column ``<name>_u_K`` (``_u_degF``) is added at the end: its standard
    deviation from noise, smoothing, lag and static line. Other columns pass through and are named
    in a finding.

    Parameters
    ----------
    log
        CSV, LVM, TDMS or Parquet with a column of time, rows at any rate; or an opened table.
    sensors
        Sensors of one or several files; each column belongs to one.
    out
        File to write, .csv or .parquet; or a function that is called with the rows, part by part.
    columns
        Columns that a single sensor covers here, instead of its own.
    time
        The time column, where its name does not say so.
    time_unit
        Its unit (s, ms, us, ns, min, h or days), where neither its name nor a row of units says so.
    unit
        "degC", "K", "degF" or "mV" for all columns, or by column; otherwise as names or a row of
        units say.
    couple
        Type of the thermocouple for columns in millivolts.
    cold
        Reference junction of columns in millivolts [degC], or its column.
    dialect, comments
        How a CSV file is written, as for ``tcdyn.workflows.compensate.CompensatedLog.write``.
    progress
        Called with the row that is reached.

    Returns
    -------
    CompensatedTable
        What was written.

    Raises
    ------
    InputError
        For a missing column, two sensors for one column, a table that is compensated already, an
        output column that would occur twice, or time that does not rise.

    Notes
    -----
    A segment whose margin is too short for the smoother to settle is read again with a longer one,
    as in ``tcdyn.workflows.segments.LogSegments.write``. Noise and intensity are estimated in each
    segment; ``numbers`` are medians and maxima over the segments.
    """
    source = log if isinstance(log, Source) else open_source(log, time, time_unit=time_unit)
    out_path = Path() if callable(out) else Path(out)
    style = output_style(dialect, comments, source.table, out_path)
    cold = cold_column(cold, source.table.names, source.table.where)
    names = source.table.names
    value_columns = [n for n in names if n != source.time]
    sensor_cols, column_findings = sensor_columns(
        value_columns, source.table.where, sensors, columns, unit, couple, cold, source.table.units
    )
    carried = [n for n in value_columns if n not in {w.column for w in sensor_cols}]
    extra_columns: list[str] = [str(cold)] if isinstance(cold, str) else []
    if carried:
        column_findings.append(info("sensor.carried", columns=carried))
    notes = {**source.table.metadata, "tcdyn": COMPENSATED, "source": source.path.name}
    notes |= {"source_sha256": sha256(source.path)} if source.path.is_file() else {}
    for w in sensor_cols:
        notes[f"lag_s of {w.column}"] = f"{w.lag_s.text('s')}, sensor {w.file.sensor}"
    renamed = {w.column: w.unit.names(w.column) for w in sensor_cols}
    header = [renamed[n][0] if n in renamed else n for n in names] + [
        renamed[w.column][1] for w in sensor_cols
    ]
    duplicates = [n for n in header if header.count(n) > 1]
    if duplicates:
        raise InputError(
            f"the output would hold column {duplicates[0]!r} twice",
            where=display_path(source.path),
            remedy="rename it",
        )
    numbers_by_column: dict[str, list[Array]] = {w.column: [] for w in sensor_cols}
    rows = 0
    findings = list(column_findings)
    next_progress_row = 0
    ends_s = list[float]()
    segments = read_segments(
        source, [*names, *extra_columns], max((w.chain.lag_s for w in sensor_cols), default=0.0)
    )
    segment = next(segments, None)
    text = [n for n in names if segment is not None and segment.data[n].dtype == object]
    if segment is not None:
        start = start_time(segment.data, source.time, segment.time_s)
        notes |= {START_TIME_KEY: start} if start else {}
    writer = (
        nullcontext(out) if callable(out) else log_writer(out, header, notes, text, style=style)
    )
    with writer as write:
        while segment is not None:
            if rows >= next_progress_row:
                progress(f"from row {rows + 1}")
                next_progress_row = rows + max(rows, PROGRESS_ROWS)
            output, numbers, segment_findings, settle_rows = _compensate_segment(
                segment, sensor_cols, display_path(source.path)
            )
            if (
                settle_rows > segment.margin_rows
            ):  # too little beside it for both sweeps to settle: again, with more
                segment = segments.send(settle_rows)
                continue
            write(pd.DataFrame({new: output[new] for new in header}))
            rows = rows + len(next(iter(output.values())))
            findings = [*unique_by_subject([*findings, *segment_findings])]
            ends_s += segment.time_s[[0, -1]].tolist() if len(segment.time_s) else []
            segment = next(segments, None)
            for name, row in numbers.items():
                numbers_by_column[name].append(row)
    table = []
    for w in sensor_cols:
        numbers_of_column = (
            np.array(numbers_by_column[w.column])
            if numbers_by_column[w.column]
            else np.full((1, 3), np.nan)
        )
        numbers_of_column = (
            numbers_of_column[np.isfinite(numbers_of_column[:, 1])]
            if np.isfinite(numbers_of_column[:, 1]).any()
            else numbers_of_column
        )
        noise = np.median(numbers_of_column[:, 0])
        sd_typical = np.median(numbers_of_column[:, 1])
        sd_max = np.max(numbers_of_column[:, 2])
        duration_s = max(ends_s, default=0.0) - min(ends_s, default=0.0)
        lag_s = w.chain.lag_s
        if duration_s < lag_s:
            findings.append(
                warning("sensor.brief", subject=w.column, duration_s=duration_s, lag_s=lag_s)
            )
        table.append(
            {
                "column": w.column,
                "noise_sd_K": noise,
                "sd_typical_K": sd_typical,
                "sd_max_K": sd_max,
            }
        )
    return CompensatedTable(
        out_path,
        rows,
        tuple(sensor_cols),
        tuple(carried),
        pd.DataFrame(table),
        notes,
        unique_by_subject(findings),
    )


def sensor_columns(
    names: Sequence[str],
    where: str,
    sensors: Sequence[SensorFile],
    columns: Sequence[str],
    unit: Mapping[str, str] | str,
    couple: str,
    cold: float | str,
    unit_row: Mapping[str, str] | None = None,
) -> tuple[list[SensorColumn], list[Finding]]:
    """The columns of a table that sensors cover, in their order.

    Parameters
    ----------
    names
        Names of the columns of the table.
    where
        The table, for messages.
    sensors, columns, unit, couple, cold
        As for ``compensate_table``.
    unit_row
        Units from a row below the header, by column.

    Returns
    -------
    columns
        Each column with its sensor and unit.
    findings
        Findings about units and altered sensor files.

    Raises
    ------
    InputError
        For no sensor, two sensors for one column, or columns that are named for several sensors.
    """
    if not sensors:
        raise InputError(
            "no sensor was given",
            remedy="add {sensors}",
            parameters={"sensors": "FILE.sensor.json"},
        )
    if columns and (len(sensors) > 1 or len(sensors[0].columns) > 1):
        raise InputError(
            "columns were named for several sensors", expected="one sensor of one column"
        )
    sensor_of_column: dict[str, tuple[SensorFile, int]] = {}
    for file in sensors:
        for at, pattern in enumerate(file.columns):
            for name in [n for c in (columns or [pattern]) for n in match_columns(c, names, where)]:
                if name in sensor_of_column:
                    raise InputError(
                        f"two sensors for column {name!r}",
                        where=where,
                        expected="one sensor a column",
                    )
                sensor_of_column[name] = file, at
    covered = [n for n in names if n in sensor_of_column]
    units, findings = units_of(covered, unit, couple, cold, unit_row)
    findings += [f for file in sensors for f in file.findings if f.code == ALTERED_CODE]
    return [SensorColumn(n, *sensor_of_column[n], units[n]) for n in covered], findings


def _compensate_segment(
    segment: TableSegment, sensor_cols: Sequence[SensorColumn], where: str
) -> tuple[dict[str, Array], dict[str, Array], list[Finding], int]:
    """Compensate one segment of the table.

    Parameters
    ----------
    segment
        Rows of the segment with its margins.
    sensor_cols
        Columns with sensors.
    where
        The table, for messages.

    Returns
    -------
    out
        Output columns by name, for the rows without the margins.
    numbers
        Noise, typical and largest standard deviation [K] of each column.
    findings
        Findings of the segment.
    margin
        Number of rows on each side that the smoother needs to settle.

    Notes
    -----
    Columns are smoothed in groups of at most ``MAX_COLUMNS`` and about ``MAX_VALUES`` values. Fewer
    than 10 samples of a segment or column are not compensated (chosen by judgement). A warning
    comes where rows are farther apart than half of the lag.
    """
    keep = segment.keep
    findings = list(segment.findings)
    out = {n: v[keep] for n, v in segment.data.items()}
    numbers: dict[str, Array] = {}
    readings = {w.column: _readings_degC(w, segment) for w in sensor_cols}
    for w in sensor_cols:
        findings += unit_findings(w.column, w.unit, segment.data[w.column])
        name, u_name = w.unit.names(w.column)
        out[name] = out[u_name] = np.full(len(out[w.column]), np.nan)
    if len(segment.time_s) < 10:
        return out, numbers, [*findings, warning("sensor.short", count=len(segment.time_s))], 0
    grid, grid_findings = even_times(segment.time_s, where)
    findings += grid_findings
    size = int(grid.index[-1]) + 1
    group_size = min(max(int(MAX_VALUES / size), 1), MAX_COLUMNS)
    settle_s = 0.0
    alive = [w for w in sensor_cols if np.count_nonzero(np.isfinite(readings[w.column])) >= 10]
    findings += [warning("sensor.dead", subject=w.column) for w in sensor_cols if w not in alive]
    for first in range(0, len(alive), group_size):
        for smoothed_columns, result in _smooth_columns(
            alive[first : first + group_size], readings, grid, size, findings
        ):
            temperature, sd_all = result.determined_estimates()
            for k, w in enumerate(smoothed_columns):
                rows = grid.index[keep]
                x = temperature[rows, k]
                sd = sd_all[rows, k]
                settle_s = max(
                    settle_s,
                    settling_time_s(
                        sensors_of([w.chain]),
                        result.noise_sd[k : k + 1],
                        grid.dt_s,
                        result.intensities[k : k + 1],
                    ),
                )
                if x.size and np.median(grid.dt_s / max(w.chain.lag_s, 1e-12)) > 0.5:
                    findings.append(
                        warning(
                            "sensor.slow", subject=w.column, dt_s=grid.dt_s, lag_s=w.chain.lag_s
                        )
                    )
                name, u_name = w.unit.names(w.column)
                out[name] = np.round(w.unit.from_degC(x), DECIMALS)
                out[u_name] = np.round(w.unit.per_K * sd, DECIMALS)
                numbers[w.column] = (
                    np.array([result.noise_sd[k], np.nanmedian(sd), np.nanmax(sd)])
                    if np.isfinite(sd).any()
                    else np.full(3, np.nan)
                )
            findings += list(result.findings)
    return out, numbers, findings, int(np.ceil(settle_s / grid.dt_s))


def _smooth_columns(
    sensor_cols: Sequence[SensorColumn],
    readings: Mapping[str, Array],
    grid: EvenTimes,
    size: int,
    findings: list[Finding],
) -> Iterator[tuple[Sequence[SensorColumn], Compensated]]:
    """Smooth columns together; one by one, with a warning, where one of them cannot be smoothed.

    Parameters
    ----------
    sensor_cols
        The columns.
    readings
        Readings [degC] after the static line, by column.
    grid
        Even times of the rows.
    size
        Number of points of the grid.
    findings
        Findings, to which a warning is appended.

    Yields
    ------
    columns
        Columns that were smoothed together.
    result
        Their compensated record on the grid.
    """
    y = np.stack([on_grid(readings[w.column], grid, size) for w in sensor_cols], axis=1)
    covariance = np.zeros((len(sensor_cols), len(sensor_cols)))
    for i, a in enumerate(sensor_cols):
        for j, b in enumerate(sensor_cols):
            if a.file is b.file:
                covariance[i, j] = a.file.lag_covariance_s2[a.index, b.index]
    line_u = np.zeros_like(y)
    for k, w in enumerate(sensor_cols):
        if w.line:
            line_u[:, k] = reading_u(w.line, y[:, k])
    try:
        result = smooth(
            y,
            grid.dt_s,
            [w.chain for w in sensor_cols],
            lag_covariance=covariance,
            split_u_s=[float(w.file.split_u_s[w.index]) for w in sensor_cols],
            static_u=np.nan_to_num(line_u),
            names=[w.column for w in sensor_cols],
        )
    except InputError as problem:
        if len(sensor_cols) == 1:
            findings.append(
                warning("sensor.left", subject=sensor_cols[0].column, problem=problem.what)
            )
            return
        for w in sensor_cols:
            yield from _smooth_columns([w], readings, grid, size, findings)
        return
    yield sensor_cols, result


def _readings_degC(column: SensorColumn, segment: TableSegment) -> Array:
    """Readings of a column (N,) [degC] after its static line."""
    cold = (
        segment.data[column.unit.reference_junction]
        if isinstance(column.unit.reference_junction, str)
        else column.unit.reference_junction
    )
    degC = column.unit.in_degC(segment.data[column.column], cold)
    return np.asarray(apply_static(degC, column.line) if column.line else degC)
