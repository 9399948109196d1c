"""Input-output data from pandas tables and files, with checks of time, values and hold.

``tcdyn.identification.from_csv`` and ``from_frame`` are the public functions; ``tcdyn identify``
reads with them. ``tests/identify/test_identify_data.py`` checks tables and errors,
``tests/identify/test_identify_choose.py`` the hold.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd

from tcdyn.core import Array, Flags
from tcdyn.core.errors import InputError, utf8
from tcdyn.core.findings import Finding, SampleLocation, warning
from tcdyn.core.labels import seconds_of_index
from tcdyn.identification.holds import (
    HOLD_CODES,
    Hold,
    Holds,
    check_hold,
    hold_of_each,
    select_holds,
)
from tcdyn.identification.iodata import IOData
from tcdyn.identification.repeats import without_repeats
from tcdyn.io.cells import TextColumn
from tcdyn.io.clock_numbers import Midnights
from tcdyn.io.read import Table, open_table, read_all_rows
from tcdyn.io.stamps import is_stamp
from tcdyn.io.table import Columns, missing_column_error
from tcdyn.io.times import (
    TIME_COLUMN_NAMES,
    TimeColumn,
    find_time_column,
    has_time_name,
    is_time_name,
)
from tcdyn.io.unit_names import column_named
from tcdyn.series import Clock, fit_clock
from tcdyn.series.long_tables import check_frame, check_one_channel
from tcdyn.series.plausible import dropout_codes, overload_codes
from tcdyn.series.scaled_readings import check_temperatures

# Findings of the reader about values and times, which the data keep
LOST_CODES = ("text.no_number", "text.error_word", "text.clock_change")
MAX_GRID_SAMPLES = 5e7  # samples of one run on an even grid, at most; protects the memory
# Largest departure of a row from an even time grid, in sampling intervals, that the fit may ignore;
# chosen by judgement.
MAX_JITTER = 0.05


def from_frame(
    frame: pd.DataFrame,
    *,
    input: str | Sequence[str],
    output: str | Sequence[str],
    time: str | None = None,
    time_unit: str | None = None,
    run: str | None = None,
    dt_s: float | None = None,
    hold: Holds | Literal["auto"] = "auto",
    resample_s: float | None = None,
    name: str = "",
) -> IOData:
    """Input-output data from a table, one row for each sample.

    Rows that are missing from an even time grid become NaN outputs (a gap). Overload and drop-out
    codes become NaN. So do outputs that only repeat an old value, because their sensor has a new
    one less often than the table has rows; not with ``resample_s``.

    Parameters
    ----------
    frame
        The table.
    input, output
        Columns of the inputs and of the outputs.
    time
        Column of numbers or of clock times; found by itself where it is called time_s, Time [ms],
        t and the like, or the index of the frame. Without one give ``dt_s``.
    time_unit
        s, ms, us, ns, min, h or days; needed where the column's name does not give the unit and
        seconds are not plausible.
    run
        Column whose values name separate runs.
    dt_s
        Sampling interval [s].
    hold
        "zoh", "foh", one of them for each input, or "auto": "zoh" for each input that stays
        constant and jumps as if set by a computer. Where the input alone cannot tell
        (:func:`tcdyn.identification.holds.is_setpoint`), there is a finding.
    resample_s
        Sampling interval [s] of an even grid for uneven times: held inputs are averaged over its
        intervals, all else is interpolated linearly.
    name
        Name of the record.

    Returns
    -------
    IOData
        The data, with findings about codes and the hold.

    Raises
    ------
    InputError
        With column, row and remedy.

    Notes
    -----
    The order of the checks decides which error a user sees first.
    ``tests/identify/test_identify_data.py`` has a case for each.

    Examples
    --------
    >>> table = pd.DataFrame({"time_s": [0, 1, 2], "u": [0, 1, 1], "y": [0.0, 0.2, 0.6]})
    >>> from_frame(table, input="u", output="y").dt_s
    1.0
    """
    where = name or "table"
    inputs = _named_columns(input, list(map(str, frame.columns)))
    outputs = _named_columns(output, list(map(str, frame.columns)))
    epoch = None
    if time is None and dt_s is None and not any(is_time_name(str(c)) for c in frame.columns):
        time_s = seconds_of_index(frame.index)
        if len(time_s):
            frame = frame.assign(time_s=time_s)
            time_unit = "s"
        if isinstance(frame.index, pd.DatetimeIndex):
            epoch = frame.index[0]
    _check_columns(frame, inputs, outputs, time, run, where)
    clock = None
    if time is not None or dt_s is None:
        names = list(map(str, frame.columns))
        clock = _time_column(names, where, requested=time, unit=time_unit)
        time = clock.name
    _check_once(list(frame.columns), [*inputs, *outputs, time], where)
    stamps = None if time is None else partial(numbers, frame, time, where, clock=True)
    check_frame(frame, stamps, outputs, [*inputs, time], run, where)
    check_temperatures(frame, outputs, where)
    groups = [("", frame)]
    if run is not None:
        groups = [(str(label), group) for label, group in frame.groupby(run, sort=False)]
    times = [np.empty(0)] * len(groups)
    if clock is not None:
        times = [_row_times(group, clock, where) for _, group in groups]
    locations = [f"{where}, run {label}" if label else where for label, _ in groups]
    clocks: list[Clock | None] = [None] * len(groups)
    if clock is not None:
        for t, location in zip(times, locations):
            check_times(t, clock.name, location)
        clocks = [fit_clock(t, dt_s) if len(t) > 1 else None for t in times]
    if dt_s is not None:
        interval = dt_s
    elif resample_s is not None:
        interval = resample_s
    else:
        interval = sampling_interval_s(clocks, where)
    if not 0 < interval < np.inf:
        raise InputError(
            f"the sampling interval is {interval:g} s", where=where, expected="a number above zero"
        )
    runs = []
    code_counts: dict[str, int] = {}
    read_inputs = [
        _readings_of_columns(group, inputs, location, overload_codes, code_counts)
        for (_, group), location in zip(groups, locations)
    ]
    # resampled inputs have other values, so their hold is that of the rows
    findings: list[Finding] = []
    holds: Holds = "foh"
    if resample_s is not None:
        rows = np.concatenate(read_inputs)
        selected, findings = select_holds(hold, inputs, rows, interval)
        holds = check_hold(selected, len(inputs), where)
    for k, ((label, group), t, u) in enumerate(zip(groups, times, read_inputs)):
        location = locations[k]
        run_clock = clocks[k]
        y = _readings_of_columns(group, outputs, location, _output_codes, code_counts)
        start_s = 0.0
        if time is not None and len(t):
            start_s = float(t[0])
        if time is not None and run_clock is not None:
            if resample_s is None:
                u, y = to_even_grid(t, u, y, run_clock, time, location)
            else:
                row_times = run_clock.even_s if run_clock.is_coarse else t
                held = hold_of_each(holds, len(inputs))
                u, y = resampled(row_times, u, y, interval, held, location)
        runs.append(
            IOData.from_arrays(
                u,
                y,
                interval,
                hold="foh",  # that of all runs together is set below
                start_s=start_s,
                input_names=inputs,
                output_names=outputs,
                name=label or name,
            )
        )
    data = runs[0].merge(*runs[1:])
    codes = [
        warning("record.codes", subject=column, count=count)
        for column, count in code_counts.items()
    ]
    data = replace(
        data,
        runs=tuple(replace(each, epoch=epoch) for each in data.runs),
        findings=(*(clock.findings() if clock is not None else []), *codes, *findings),
    )
    if resample_s is None:
        return with_hold(without_repeats(data, hold), hold)
    return with_hold(data, holds)


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
    return replace(data, hold=checked, findings=(*earlier, *findings))


def _named_columns(names: str | Collection[str], columns: Collection[str]) -> list[str]:
    """The columns of names that may lack their units."""
    each = [names] if isinstance(names, str) else names
    return [column_named(name, columns) for name in each]


def _check_columns(
    frame: pd.DataFrame,
    inputs: Sequence[str],
    outputs: Sequence[str],
    time: str | None,
    run: str | None,
    where: str,
) -> None:
    """Raise InputError for columns that are missing, or named twice as input or output.

    Parameters
    ----------
    frame
        The table.
    inputs, outputs
        Names of the columns.
    time, run
        Columns of the time and of the runs, or None.
    where
        Table that errors name.

    Raises
    ------
    InputError
        For columns that are missing, or named twice.
    """
    signals = [*inputs, *outputs]
    for column in signals:
        if signals.count(column) > 1:
            raise InputError(
                f"column {column!r} is named twice",
                where=where,
                expected="other columns as inputs and outputs",
            )
    if not inputs or not outputs:
        raise InputError(
            "no input or no output is named", where=where, expected="at least one of each"
        )
    roles: list[tuple[str, str | None]] = [
        *(("input", column) for column in inputs),
        *(("output", column) for column in outputs),
        ("time", time),
        ("run", run),
    ]
    for role, name in roles:
        if name is not None and name not in frame.columns:
            raise missing_column_error(f"{role} column", name, [*map(str, frame)], where)


def _time_column(names: Sequence[str], where: str, **options: Any) -> TimeColumn:
    """Return the time column of a table.

    Parameters
    ----------
    names
        Names of the columns.
    where
        Table that errors name.
    options
        As for :func:`tcdyn.io.times.find_time_column`.

    Returns
    -------
    TimeColumn
        The column and its unit.

    Raises
    ------
    InputError
        Without a time column; it names both ways to give the time.
    """
    is_named = options["requested"] is not None or options.get("clock_columns")
    units = options.get("unit_row") or {}
    if not is_named and not any(has_time_name(name, units) for name in names):
        raise InputError(
            "no time column found",
            where=where,
            remedy="name it ({time}) or give the sampling interval ({dt_s})",
            parameters={"time": "COLUMN", "dt_s": "SECONDS"},
        )
    return find_time_column(names, where, **options)


def _check_once(names: Sequence[Any], requested: Collection[str | None], where: str) -> None:
    """Raise InputError where a requested column stands twice."""
    for name in requested:
        if name is not None and names.count(name) > 1:
            raise InputError(
                f"column {name!r} stands twice", where=where, remedy="rename one of them"
            )


def _row_times(frame: pd.DataFrame, clock: TimeColumn, where: str) -> Array:
    """Return the times of the rows.

    Parameters
    ----------
    frame
        The table.
    clock
        Its time column.
    where
        Table that errors name.

    Returns
    -------
    array
        Times (N,) [s].
    """
    is_clock = frame[clock.name].dtype.kind not in "iufb"
    values = numbers(frame, clock.name, where, clock=True)
    clock = clock.recognised(values, is_clock)
    times_s = clock.in_seconds(values, is_clock)
    if clock.clock_unit and not is_clock:
        times_s = Midnights().continued(times_s)
    clock.check_step(times_s, is_clock)
    clock.check_bursts(times_s)
    return times_s


def _output_codes(values: Array) -> Flags:
    """Return the overload and drop-out codes of a column in any unit."""
    overload = overload_codes(values)
    return overload | dropout_codes(np.where(overload, np.nan, values))


def _readings_of_columns(
    frame: pd.DataFrame,
    columns: Sequence[str],
    where: str,
    find_codes: Callable[[Array], Flags],
    code_counts: dict[str, int],
) -> Array:
    """Return columns with their error codes as NaN.

    Parameters
    ----------
    frame
        The table.
    columns
        Their names.
    where
        Table that errors name.
    find_codes
        Function that finds the codes in a column (N,).
    code_counts
        Number of codes by column, which is changed.

    Returns
    -------
    array
        Values (N, K).
    """
    readings = []
    for column in columns:
        values = numbers(frame, column, where)
        is_code = find_codes(values)
        if is_code.any():
            code_counts[column] = code_counts.get(column, 0) + int(is_code.sum())
        readings.append(np.where(is_code, np.nan, values))
    return np.column_stack(readings)


def from_csv(path: str | Path, **options: Any) -> IOData:
    """Read input-output data from a file: text of any dialect, TDMS, LVM or Parquet.

    Parameters
    ----------
    path
        The file.
    options
        As for :func:`from_frame`.

    Returns
    -------
    IOData
        The data, named after the file.

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
    path = Path(path)
    requested: set[str] = set()
    for role in ("input", "output", "time", "run"):
        names = options.get(role)
        if isinstance(names, str):
            requested.add(names)
        elif names is not None:
            requested |= set(names)
    table = open_table(path, (*TIME_COLUMN_NAMES, *requested))
    requested = set(_named_columns(requested, table.names))
    clock = None
    if options.get("time") is not None or options.get("dt_s") is None:
        clock = _time_column(
            table.names,
            utf8(path.name),
            requested=options.get("time"),
            unit=options.get("time_unit"),
            unit_row=table.units,
            clock_columns=table.clock_columns,
        )
        requested.add(clock.name)
    outputs = _named_columns(options.get("output", ()), table.names)
    check_one_channel(table, clock.name if clock else None, outputs, requested, options.get("run"))
    raw = read_requested(table, requested)
    frame = _frame_of_columns(table, raw)
    check_temperatures(frame, outputs, table.where, table)
    run = options.get("run")
    if run is not None and run in raw.data and run not in raw.stamps:
        frame[run] = _whole_numbers(frame[run])
    given = {"name": utf8(path.name), **options}
    if clock is not None:
        unit = options.get("time_unit")
        if not unit and clock.is_unit_stated and clock.seconds is not None:
            unit = clock.unit_text
        if clock.name in raw.stamps:
            frame[clock.name] = raw.data[clock.name]
            unit = "s"
        given |= {"time": clock.name, "time_unit": unit}
    data = from_frame(frame, **given)
    guess = clock.findings() if clock is not None else []
    lost = [finding for finding in raw.findings if finding.code in LOST_CODES]
    return replace(data, findings=(*guess, *lost, *data.findings))


def read_columns(table: Table, requested: Collection[str]) -> pd.DataFrame:
    """Return a table's columns; those that are not requested stay empty."""
    return _frame_of_columns(table, read_requested(table, requested))


def read_requested(table: Table, requested: Collection[str]) -> Columns:
    """Return the requested columns of a table that it has.

    Raises
    ------
    InputError
        For a requested column that stands twice.
    """
    _check_once(list(table.names), requested, table.where)
    return read_all_rows(table, [name for name in table.names if name in requested])


def _frame_of_columns(table: Table, raw: Columns) -> pd.DataFrame:
    """Return columns as a table: numbers, and text as it is in the file."""
    columns = {**raw.data, **raw.stamps}
    names = list(dict.fromkeys(table.names))
    frame = pd.DataFrame(columns, columns=names)
    frame.attrs["units"] = dict(table.units)
    return frame


def _whole_numbers(values: pd.Series) -> pd.Series:
    """Return numbers of runs without decimals if they have none, so that they name the runs."""
    is_whole = values.notna().all() and bool((values == values.round()).all())
    return values.astype(int) if is_whole else values


def numbers(frame: pd.DataFrame, column: str, where: str, clock: bool = False) -> Array:
    """Return one column as floats.

    Parameters
    ----------
    frame, column
        The table and its column.
    where
        File or table that errors name.
    clock
        Whether the column may hold clock times, with or without the date; they become seconds
        since the first.

    Returns
    -------
    array
        Values (N,), NaN for empty cells.

    Raises
    ------
    InputError
        For text that is not a number, with its row.
    """
    values = frame[column]
    if clock and values.dtype.kind not in "iufb":
        if values.dtype.kind == "M":
            return np.asarray((values - values.iloc[0]).dt.total_seconds(), dtype=float)
        texts = [str(v).strip() for v in values]
        n_clock = sum(is_stamp(text) for text in texts)
        if n_clock > 0.5 * len(texts):
            return TextColumn(column, ".", SampleLocation(where)).numbers(texts, 0)
    converted = pd.to_numeric(values, errors="coerce")
    bad = np.flatnonzero(converted.isna().to_numpy() & values.notna().to_numpy())
    if len(bad):
        raise InputError(
            f"column {column} row {bad[0] + 1} holds {values.iloc[bad[0]]!r}",
            where=where,
            expected="a number or empty",
        )
    return converted.to_numpy(dtype=float)


def sampling_interval_s(clocks: Sequence[Clock | None], where: str) -> float:
    """Return the sampling interval [s] of several runs: their time over their samples.

    Parameters
    ----------
    clocks
        Clock of each run; None for a run of one row.
    where
        Table that errors name.

    Returns
    -------
    float
        Sampling interval [s].

    Raises
    ------
    InputError
        If no run has two samples.
    """
    known = [clock for clock in clocks if clock is not None]
    if not known:
        raise InputError("has fewer than two samples", where=where, expected="a record")
    n_steps = np.array([clock.size - 1 for clock in known])
    intervals_s = np.array([clock.interval_s for clock in known])
    return float(n_steps @ intervals_s / n_steps.sum())


def check_times(t: Array, column: str, where: str) -> None:
    """Raise InputError for missing and backward times ``t`` (N,) [s], and for one time in all rows.

    Parameters
    ----------
    t
        Times (N,) [s].
    column, where
        Column and table that errors name.

    Raises
    ------
    InputError
        With the row.
    """
    if np.isnan(t).any():
        row = np.flatnonzero(np.isnan(t))[0] + 1
        raise InputError(f"column {column} is empty in row {row}", where=where)
    backward = np.flatnonzero(np.diff(t) < 0)
    if len(backward):
        raise _unordered_times(t, int(backward[0]), "runs backwards", column, where)
    if len(t) > 1 and t[-1] == t[0]:
        raise _unordered_times(t, 0, "repeats", column, where)


def _unordered_times(t: Array, k: int, problem: str, column: str, where: str) -> InputError:
    """The error for times ``t`` (N,) [s] that do not rise after row ``k``."""
    return InputError(
        f"column {column} {problem} at row {k + 2} ({t[k]:g} s then {t[k + 1]:g} s)",
        where=where,
        expected="increasing time",
        remedy="name the column that separates the runs, or remove the row",
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


def to_even_grid(
    t: Array, u: Array, y: Array, clock: Clock, column: str, where: str
) -> tuple[Array, Array]:
    """Inputs and outputs on an even grid, on which their times must be; gaps become NaN.

    Parameters
    ----------
    t
        Times (N,) [s].
    u, y
        Inputs (N, K) and outputs (N, L).
    clock
        The clock of the rows.
    column, where
        Column and file that errors name.

    Returns
    -------
    u, y
        Inputs and outputs on the grid.

    Raises
    ------
    InputError
        For rows that stand twice, times off the grid, or a grid of too many samples.

    Notes
    -----
    ``MAX_JITTER`` is the largest error of a time that the fit then ignores, beside rounding.
    ``tests/identify/test_identify_data.py`` checks gaps and rounded stamps.
    """
    _grid_positions(t, clock.interval_s, where)
    if clock.n_repeated:
        raise _unordered_times(t, int(np.argmax(np.diff(t) == 0)), "repeats", column, where)
    departure = np.abs(clock.deviation_s) / clock.interval_s
    rounding = 0.5 * clock.resolution_s / clock.interval_s
    if not clock.is_coarse and departure.max() > MAX_JITTER + rounding:
        k = int(np.argmax(departure))
        dt_s = clock.interval_s
        raise InputError(
            f"column {column} is not evenly spaced: row {k + 1} at {t[k]:g} s is "
            f"{departure[k] * dt_s:.3g} s off a {dt_s:g} s grid",
            where=where,
            expected="one sampling interval",
            remedy="resample it ({resample_s})",
            parameters={"resample_s": f"{dt_s:.3g}"},
        )
    if clock.size == len(t):
        return u, y
    u_even = np.full((clock.size, u.shape[1]), np.nan)
    y_even = np.full((clock.size, y.shape[1]), np.nan)
    u_even[clock.index] = u
    y_even[clock.index] = y
    return u_even, y_even
