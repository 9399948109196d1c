"""Input-output data from tables of any kind: columns, runs, and the hold of the inputs.

``tcdyn.identification.from_csv`` and ``from_frame`` are the public functions; ``tcdyn identify``
reads with them. Rows, times and readings are decided by :mod:`tcdyn.series`.
``tests/identify/test_identify_data.py`` checks tables and errors,
``tests/identify/test_identify_choose.py`` the hold.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tcdyn.core import Array
from tcdyn.core.arguments import check_type, with_named_arguments
from tcdyn.core.errors import InputError, utf8
from tcdyn.core.findings import Finding, unique, unique_by_subject
from tcdyn.core.messages.phrases import count_with_noun
from tcdyn.core.options import options_of
from tcdyn.identification.held_inputs import with_new_values_of_inputs
from tcdyn.identification.holds import (
    HOLD_CODES,
    Hold,
    Holds,
    check_hold,
    hold_of_each,
    select_holds,
    timing_u_s,
)
from tcdyn.identification.iodata import IOData
from tcdyn.io.column_names import column_named
from tcdyn.io.read import sha256_of_file
from tcdyn.io.unit_names import TEMPERATURES, names_temperature, unit_in, written_unit
from tcdyn.series import Context, ReadingOptions, Series, Source, make_series, open_source
from tcdyn.series.joined import files_of_log
from tcdyn.series.long_tables import check_one_channel
from tcdyn.series.read import read_all
from tcdyn.series.reading import READING, REPEAT, Kind
from tcdyn.series.scaled_readings import in_degC
from tcdyn.series.series import SHIFTED_ONLY, ColumnRows, Policy
from tcdyn.series.source import check_numbers
from tcdyn.series.units import convert_temperature

# Relative spread of the sampling intervals of runs that are one record: lags in rows are then wrong
# by as much, below the 1 % of a good measurement of a lag.
MAX_INTERVAL_SPREAD = 0.01
MAX_GRID_SAMPLES = 5e7  # samples of one run on an even grid, at most; protects the memory
# A record may be short, and its readings must be on even times well enough to be shifted there.
EVEN_RECORD = Policy(min_rows=2, max_stray=SHIFTED_ONLY)
# Rows that are resampled may have any times.
ANY_TIMES = Policy(min_rows=2)


@with_named_arguments
def from_frame(
    frame: pd.DataFrame,
    *,
    input: str | Sequence[str],
    output: str | Sequence[str],
    run: str | None = None,
    hold: Holds | Literal["auto"] = "auto",
    resample_s: float | None = None,
    name: str = "",
    **reading: Any,
) -> IOData:
    """Input-output data from a table, one row for each sample.

    Samples without a row become NaN outputs (a gap). Overload and drop-out codes become NaN. So do
    outputs that only repeat an old value, because their sensor has a new one less often than the
    table has rows; not with ``resample_s``.

    Parameters
    ----------
    frame
        The table. Its time is a column called time_s, Time [ms], t and the like, or the index.
    input, output
        Columns of the inputs and of the outputs.
    run
        Column whose values name separate runs.
    hold
        "zoh", "foh", one of them for each input, or "auto": "zoh" for each input that stays
        constant and jumps as if set by a computer. Where the input alone cannot tell
        (:func:`tcdyn.identification.holds.is_setpoint`), there is a finding.
    resample_s
        Sampling interval [s] of an even grid for uneven times: held inputs are averaged over its
        intervals, all else is interpolated linearly.
    name
        Name of the record.
    reading
        How the rows are read: ``time``, ``time_unit``, ``dt_s`` (needed without a time), ``where``,
        ``on_change`` and ``averages_s``, see :class:`tcdyn.series.ReadingOptions`.

    Returns
    -------
    IOData
        The data, with findings about the rows and the hold.

    Raises
    ------
    InputError
        With column, row and remedy.

    Examples
    --------
    >>> table = pd.DataFrame({"time_s": [0, 1, 2], "u": [0, 1, 1], "y": [0.0, 0.2, 0.6]})
    >>> from_frame(table, input="u", output="y").dt_s
    1.0
    """
    check_type("frame", frame, pd.DataFrame, "a DataFrame")
    options = options_of(ReadingOptions, reading, "from_frame")
    columns = [*map(str, frame.columns)]
    roles = _Roles.of(columns, input, output, run, name or "table")
    source = open_source(frame, roles.named, options)
    epoch = None
    if isinstance(frame.index, pd.DatetimeIndex) and source.time not in columns and len(frame):
        epoch = frame.index[0]
    data = _record([(source, roles)], hold, resample_s, name)
    return replace(data, runs=tuple(replace(each, epoch=epoch) for each in data.runs))


@with_named_arguments
def from_csv(
    path: str | Path | Sequence[str | Path],
    *,
    input: str | Sequence[str],
    output: str | Sequence[str],
    run: str | None = None,
    hold: Holds | Literal["auto"] = "auto",
    resample_s: float | None = None,
    **reading: Any,
) -> IOData:
    """Read input-output data from files: text of any dialect, TDMS, LVM, Parquet, .xlsx, .mat.

    Parameters
    ----------
    path
        The file; or several files, each of which is a run (with ``run``, some runs).
    input, output, run, hold, resample_s, reading
        As for :func:`from_frame`; ``sheet`` of a workbook and ``variable`` of a .mat file are among
        the keywords of ``reading``.

    Returns
    -------
    IOData
        The data, named after the file. Runs of several files have the names of their files.

    Raises
    ------
    InputError
        As :func:`from_frame` does; for files with the same content, and for columns of several
        files in units that are not converted.

    Notes
    -----
    A column may be named with another unit in each file. Temperatures in degC, K and degF are
    converted to the unit of the first file; other units must be the same.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "log.csv"
    ...     rows = ["time_s;u;T", "0,0;0;20,0", "0,5;1;20,0", "1,0;1;23,9", ""]
    ...     _ = path.write_text("\\n".join(rows), encoding="utf-8")
    ...     from_csv(path, input="u", output="T").dt_s
    0.5
    """
    options = options_of(ReadingOptions, reading, "from_csv")
    known = [*_as_list(input), *_as_list(output), *_as_list(run)]
    files = files_of_log(path)
    _check_different(files)
    tables = []
    for file in files:
        source = open_source(file, known, options)
        roles = _Roles.of(source.table.names, input, output, run, source.table.where)
        tables.append((source, roles))
    name = utf8(files[0].name)
    if len(files) > 1:
        name += f" and {count_with_noun(len(files) - 1, 'more file')}"
    return _record(tables, hold, resample_s, name)


def _check_different(files: Sequence[Path]) -> None:
    """Raise InputError without files, and for two files with the same content."""
    if not files:
        raise InputError("no files", expected="at least one")
    seen: dict[str, Path] = {}
    for file in files if len(files) > 1 else ():
        first = seen.setdefault(sha256_of_file(file), file)
        if first is not file:
            raise InputError(
                f"{utf8(first.name)} and {utf8(file.name)} have the same content",
                expected="different runs",
                remedy="give each file once",
            )


@dataclass(frozen=True)
class _Roles:
    """Columns of a table by their role.

    Attributes
    ----------
    inputs, outputs
        Names of the columns.
    run
        Column of runs, or None.
    """

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    run: str | None

    @classmethod
    def of(
        cls,
        columns: Sequence[str],
        input: str | Sequence[str],
        output: str | Sequence[str],
        run: str | None,
        where: str,
    ) -> _Roles:
        """The columns of names that may lack their units.

        Parameters
        ----------
        columns
            Columns of the table.
        input, output, run
            Names of the columns.
        where
            Table that errors name.

        Raises
        ------
        InputError
            For columns that are missing, or named twice.
        """

        def columns_of(names: str | Sequence[str] | None, role: str) -> tuple[str, ...]:
            """The columns of one role."""
            listed = _as_list(names)
            return tuple(
                column_named(name, columns, where, role=f"{role} column") for name in listed
            )

        inputs = columns_of(input, "input")
        outputs = columns_of(output, "output")
        if not inputs or not outputs:
            raise InputError(
                "no input or no output is named", where=where, expected="at least one of each"
            )
        signals = [*inputs, *outputs]
        for column in signals:
            if signals.count(column) > 1:
                raise InputError(
                    f"column {column!r} is named twice",
                    where=where,
                    expected="other columns as inputs and outputs",
                )
        runs = columns_of(run, "run")
        return cls(inputs, outputs, runs[0] if runs else None)

    @property
    def named(self) -> list[str]:
        """Names of all columns."""
        return [*self.inputs, *self.outputs, *_as_list(self.run)]


def _as_list(names: str | Collection[str] | None) -> list[str]:
    """One name, several or none as a list."""
    if names is None:
        return []
    return [names] if isinstance(names, str) else list(names)


def _record(
    tables: Sequence[tuple[Source, _Roles]],
    hold: Holds | Literal["auto"],
    resample_s: float | None,
    name: str,
) -> IOData:
    """The runs of open tables as input-output data.

    Parameters
    ----------
    tables
        The tables and their columns; the names and units of the first one are those of the data.
    hold, resample_s, name
        As for ``from_frame``.

    Notes
    -----
    A clock belongs to a run. The interval of the data is the time of all runs over their samples.
    """
    source, roles = tables[0]
    where = name or source.table.where
    if resample_s is not None:
        _check_interval(resample_s, where)
    policy = EVEN_RECORD if resample_s is None else ANY_TIMES
    recorded: list[_Run] = []
    all_findings: list[Finding] = []
    for table in tables:
        of_file = name if len(tables) == 1 else utf8(table[0].path.name)
        runs, findings = _runs_of_table(table, tables[0], policy, of_file, len(tables) > 1)
        all_findings += findings if len(tables) == 1 else [each.at(of_file) for each in findings]
        recorded += runs
    all_series = [each.series for each in recorded]
    selected: Holds | Literal["auto"] = hold
    if resample_s is None:
        values = [each.on_grid(roles) for each in recorded]
    else:
        # resampled inputs have other values, so their hold is that of the rows
        inputs = np.concatenate([each.on_grid(roles)[0] for each in recorded])
        selected, hold_findings = select_holds(hold, roles.inputs, inputs, resample_s)
        all_findings += hold_findings
        selected = check_hold(selected, len(roles.inputs), where)
        held = hold_of_each(selected, len(roles.inputs))
        values = [each.resampled(resample_s, held, roles, where) for each in recorded]
    interval_s = resample_s or _mean_interval_s(all_series, where)
    parts = [
        IOData.from_arrays(
            inputs,
            outputs,
            interval_s,
            hold="foh",  # that of all runs together is set below
            start_s=float(each.time_s[0]),
            input_names=roles.inputs,
            output_names=roles.outputs,
            name=each.label,
        )
        for (inputs, outputs), each in zip(values, recorded)
    ]
    data = parts[0].merge(*parts[1:])
    data = replace(
        data,
        name=name,
        findings=unique(all_findings),
        reading=tuple(series.report for series in all_series),
    )
    if resample_s is not None:
        resampled_data = with_hold(data, selected)
        return replace(resampled_data, timing_u_s=timing_u_s(hold, resample_s))
    return with_hold(with_new_values_of_inputs(data, hold), hold)


def _runs_of_table(
    table: tuple[Source, _Roles],
    first: tuple[Source, _Roles],
    policy: Policy,
    name: str,
    is_one_of_several: bool,
) -> tuple[list[_Run], tuple[Finding, ...]]:
    """The runs of one table, in the names and units of the first table.

    Parameters
    ----------
    table, first
        The table and the first one, with their columns.
    policy
        What is tolerated in the rows.
    name
        Name of the record or the file.
    is_one_of_several
        Whether there are several files, so that labels of runs get the name of their file.

    Returns
    -------
    runs, findings
        The runs, and the findings about them and their table.
    """
    source, roles = table
    where = name or source.table.where
    check_one_channel(
        source.table, source.time, roles.outputs, [*roles.inputs, *_as_list(roles.run)], roles.run
    )
    time_s, raw, findings = read_all(source, roles.named)
    for column in (*roles.inputs, *roles.outputs):
        check_numbers(column, raw[column], where)
    if table is not first:
        raw = _as_in_first(raw, table, first)
        roles = first[1]
    rows_of_runs = _rows_of_runs(raw, roles.run, where)
    recorded = []
    for label, rows in rows_of_runs:
        location = f"{where}, run {label}" if label else where
        columns = _column_rows(first[0], roles, {n: raw[n][rows] for n in roles.named})
        context = Context(
            location,
            time=source.time,
            options=source.options,
            policy=policy,
            findings=findings if len(rows_of_runs) == 1 else (),
            table=source.table,
            other_times=source.clock.others,
        )
        run_s = time_s[rows]
        if source.options.dt_s is not None and source.options.time is None:
            run_s = source.options.dt_s * np.arange(len(rows), dtype=float)
        run_name = label or name
        if label and is_one_of_several:
            run_name = f"{name}, {label}"
        recorded.append(_Run(run_name, run_s, columns, make_series(run_s, columns, context)))
    of_runs = [finding for run in recorded for finding in run.series.findings]
    return recorded, unique_by_subject([*findings, *of_runs])


def _as_in_first(
    raw: Mapping[str, NDArray[Any]], table: tuple[Source, _Roles], first: tuple[Source, _Roles]
) -> dict[str, NDArray[Any]]:
    """Columns of a file with the names, and in the units, of the first file.

    Raises
    ------
    InputError
        For another unit that is no temperature.
    """
    converted = {}
    for name, name_in_first in zip(table[1].named, first[1].named):
        values = raw[name]
        units = [
            _unit_of(source, column)
            for source, column in ((table[0], name), (first[0], name_in_first))
        ]
        is_signal = name_in_first != first[1].run
        if is_signal and units[0] != units[1]:
            if not all(unit in TEMPERATURES for unit in units):
                stated = [unit or "no unit" for unit in units]
                raise InputError(
                    f"column {name!r} is in {stated[0]}, and {name_in_first!r} of "
                    f"{utf8(first[0].path.name)} in {stated[1]}",
                    where=table[0].table.where,
                    expected="one unit in all files; degC, K and degF are converted",
                )
            values = convert_temperature(units[0], units[1], values)
        converted[name_in_first] = values
    return converted


def _unit_of(source: Source, column: str) -> str:
    """Unit of a column, by its name or the row of units."""
    of_row = source.table.units.get(column, "")
    return unit_in(column) or written_unit(of_row) or of_row


def _check_interval(interval_s: float, where: str) -> None:
    """Raise InputError for a sampling interval that is no positive number."""
    if not 0 < interval_s < np.inf:
        raise InputError(
            f"the sampling interval is {interval_s:g} s",
            where=where,
            expected="a number above zero",
        )


def _rows_of_runs(
    raw: Mapping[str, NDArray[Any]], run: str | None, where: str
) -> list[tuple[str, NDArray[np.intp]]]:
    """Label and rows of each run, in their order; rows without a label belong to none."""
    count = len(next(iter(raw.values())))
    if run is None:
        return [("", np.arange(count))]
    codes, values = pd.factorize(raw[run])
    labelled = [(k, value) for k, value in enumerate(values) if value != ""]
    if not labelled:
        raise InputError(
            f"column {run!r} names no run", where=where, expected="the label of its run in each row"
        )
    return [(_run_label(value), np.flatnonzero(codes == k)) for k, value in labelled]


def _run_label(value: Any) -> str:
    """A label of a run as text; whole numbers without a point."""
    if isinstance(value, float) and value.is_integer():
        return str(int(value))
    return str(value)


def _column_rows(
    source: Source, roles: _Roles, raw: Mapping[str, NDArray[Any]]
) -> list[ColumnRows]:
    """Inputs and outputs of a run in their own units; temperatures are judged in degC."""
    columns = [ColumnRows(name, "", Kind.INPUT, raw[name]) for name in roles.inputs]
    for name in roles.outputs:
        unit_row = source.table.units.get(name, "")
        unit = unit_in(name) or written_unit(unit_row)
        if names_temperature(name, unit_row):
            degC = in_degC(raw[name], unit)
            columns.append(
                ColumnRows(name, unit or "degC", Kind.TEMPERATURE, raw[name], degC, True)
            )
        else:
            columns.append(ColumnRows(name, unit or unit_row, Kind.QUANTITY, raw[name]))
    return columns


def _mean_interval_s(all_series: Sequence[Series], where: str) -> float:
    """Sampling interval [s] of several runs: their time over their samples.

    Raises
    ------
    InputError
        For runs whose intervals differ by more than ``MAX_INTERVAL_SPREAD``.
    """
    n_steps = np.array([series.clock.size - 1 for series in all_series])
    intervals_s = np.array([series.interval_s for series in all_series])
    if float(np.ptp(intervals_s)) > MAX_INTERVAL_SPREAD * float(intervals_s.min()):
        raise InputError(
            f"the runs have sampling intervals of {intervals_s.min():.4g} to "
            f"{intervals_s.max():.4g} s",
            where=where,
            expected="one sampling interval",
            remedy="resample them ({resample_s}), or identify each alone",
            parameters={"resample_s": f"{intervals_s.max():.4g}"},
        )
    return float(n_steps @ intervals_s / n_steps.sum())


@dataclass(frozen=True)
class _Run:
    """A run as it is in the table.

    Attributes
    ----------
    label
        Its label, or the name of the record.
    time_s
        Times of its rows (R,) [s].
    columns, series
        Inputs and outputs at its rows, and on even times.
    """

    label: str
    time_s: Array
    columns: Sequence[ColumnRows]
    series: Series

    def on_grid(self, roles: _Roles) -> tuple[Array, Array]:
        """Inputs (N, K) and outputs (N, L) at the samples of the clock."""
        inputs = np.column_stack([self.series.on_grid(name) for name in roles.inputs])
        outputs = np.column_stack([self.series.on_grid(name) for name in roles.outputs])
        return inputs, outputs

    def resampled(
        self, interval_s: float, holds: Sequence[Hold], roles: _Roles, where: str
    ) -> tuple[Array, Array]:
        """Inputs and outputs on another grid, from the values at the stamps of their rows.

        Parameters
        ----------
        interval_s
            Sampling interval of the grid [s].
        holds
            Hold of each input.
        roles
            Columns by their role.
        where
            Table that errors name.
        """
        clock = self.series.clock
        row_times_s = clock.even_s if clock.is_coarse else self.time_s
        values = {}
        for column in self.columns:
            name = column.name
            if name in self.series.bands:
                samples = self.series.unchanged(name).values
                values[name] = np.interp(row_times_s, self.series.time_s, samples)
                continue
            reasons = self.series.reasons[name]
            is_used = (reasons == READING) | (reasons == REPEAT)
            values[name] = np.where(is_used, column.raw, np.nan)
        inputs = np.column_stack([values[name] for name in roles.inputs])
        outputs = np.column_stack([values[name] for name in roles.outputs])
        return resampled(row_times_s, inputs, outputs, interval_s, holds, where)


def with_hold(data: IOData, hold: Holds | Literal["auto"]) -> IOData:
    """Return the data with another hold, and findings about it if it is selected.

    Parameters
    ----------
    data
        The record.
    hold
        As in :func:`from_frame`.
    """
    earlier = [f for f in data.findings if f.code not in HOLD_CODES]
    inputs = np.concatenate([run.u for run in data.runs])
    selected, findings = select_holds(hold, data.input_names, inputs, data.dt_s)
    checked = check_hold(selected, len(data.input_names), data.name or "table")
    return replace(
        data,
        hold=checked,
        findings=(*earlier, *findings),
        timing_u_s=timing_u_s(hold, data.dt_s),
    )


def _grid_positions(t: Array, dt_s: float, where: str) -> Array:
    """Times (N,) in intervals from the first one; an error for a grid of too many samples."""
    position = np.asarray((t - t[0]) / dt_s)
    if position[-1] > MAX_GRID_SAMPLES:
        raise InputError(
            f"a grid of {dt_s:g} s over {t[-1] - t[0]:g} s has {position[-1]:.2g} samples",
            where=where,
            expected=f"at most {MAX_GRID_SAMPLES:.0e}",
            remedy="give a longer sampling interval in seconds",
        )
    return position


def resampled(
    t: Array, u: Array, y: Array, dt_s: float, holds: Sequence[Hold], where: str
) -> tuple[Array, Array]:
    """Inputs and outputs of any times on an even grid.

    Parameters
    ----------
    t
        Times (N,) [s], which rise.
    u, y
        Inputs (N, K) and outputs (N, L).
    dt_s
        Sampling interval of the grid [s].
    holds
        Hold of each input (K,).
    where
        File that errors name.

    Returns
    -------
    u, y
        Inputs and outputs on the grid. A held input has its mean over each interval, so that its
        steps keep their times on average; all else is interpolated linearly.

    Raises
    ------
    InputError
        For a grid of too many samples.

    Examples
    --------
    >>> t = np.array([0.0, 1.5, 4.0])
    >>> u = np.array([[0.0], [100.0], [100.0]])
    >>> resampled(t, u, u, 1.0, ["zoh"], "table")[0].ravel()
    array([  0.,  50., 100., 100., 100.])
    """
    last = int(np.floor(_grid_positions(t, dt_s, where)[-1] + 1e-9))
    grid = t[0] + dt_s * np.arange(last + 2)
    inputs = []
    for values, hold in zip(u.T, holds):
        finite = np.isfinite(values)
        if not finite.any():
            raise InputError("an input holds no numbers", where=where, expected="numbers")
        times = t[finite]
        known = values[finite]
        if hold == "zoh":
            ends = np.append(times, grid[-1] + dt_s)
            steps = known * np.diff(ends)
            integral = np.interp(grid, ends, np.concatenate([[0.0], np.cumsum(steps)]))
            integral -= known[0] * np.maximum(times[0] - grid, 0.0)
            inputs.append(np.diff(integral) / dt_s)
        else:
            inputs.append(np.interp(grid[:-1], times, known))
    outputs = [np.interp(grid[:-1], t, values) for values in y.T]
    return np.column_stack(inputs), np.column_stack(outputs)
