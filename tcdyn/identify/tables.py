"""Input-output data from pandas frames and CSV files, with the questions a careless table raises."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd

from tcdyn.core import Array, Flags
from tcdyn.core.errors import InputError
from tcdyn.core.findings import SampleLocation, info, warning
from tcdyn.identify.iodata import Hold, IOData, check_hold
from tcdyn.identify.segments import REPEATED
from tcdyn.io.csv_dialect import CLOCK, TextColumn
from tcdyn.io.read import CsvTable, Table, open_table, read_whole, text_of
from tcdyn.io.table import missing
from tcdyn.io.times import (
    HEADER_NAMES,
    TIME_NAMES,
    TimeColumn,
    find_time_column,
    rows_of_repeated_stamps,
    split_unit,
)
from tcdyn.rig.plausible import dropout_codes, overload_codes

FEW_DECIMALS = (
    0.02  # share of repeated stamps, from which the clock is taken as one of few decimals
)
MOST_SAMPLES = 5e7  # of one run on an even grid
JUMP = 0.05  # of its range, by which an input that was set moves; rounding makes smaller steps
ALONE = 0.95  # share of the moves of a staircase before and after which it stays
JITTER = 0.05  # largest departure from an even time grid that is still called even, in sampling intervals


def from_frame(
    frame: pd.DataFrame,
    *,
    input: str | Sequence[str],
    output: str | Sequence[str],
    time: str | None = None,
    time_unit: str | None = None,
    run: str | None = None,
    dt_s: float | None = None,
    hold: Hold | Literal["auto"] = "auto",
    resample_s: float | None = None,
    name: str = "",
) -> IOData:
    """IOData from a table: one row a sample, one or several columns of inputs and of outputs, and an optional ``run``
    column whose values name separate recordings.

    ``time`` is a column of numbers or of clock times (found by itself when called time_s, Time [ms], t and the like);
    without one give ``dt_s``. ``time_unit`` (s, ms, us, ns, min, h or days) is needed where its name does not state the
    unit and seconds are not plausible. ``hold`` "auto" is "zoh" where every input stays and jumps as a computer sets
    it, else "foh"; where the input alone cannot tell (:func:`was_set`) the data's ``findings`` ask for it. Rows missing
    from an even time grid become NaN outputs (a gap). Overload and drop-out codes become NaN. ``resample_s`` puts
    uneven times on an even grid by straight lines. Raises InputError naming column, row and remedy.

    >>> table = pd.DataFrame({"time_s": [0, 1, 2], "u": [0, 1, 1], "y": [0.0, 0.2, 0.6]})
    >>> from_frame(table, input="u", output="y").dt_s
    1.0
    """
    where = name or "table"
    inputs, outputs = ([c] if isinstance(c, str) else list(c) for c in (input, output))
    roles: list[tuple[str, str | None]] = [
        *(("input", c) for c in inputs),
        *(("output", c) for c in outputs),
    ]
    for _, column in roles:
        if [c for _, c in roles].count(column) > 1:
            raise InputError(
                f"column {column!r} is named twice",
                where=where,
                expected="other columns as inputs and outputs",
            )
    if not inputs or not outputs:
        raise InputError(
            "no input or no output is named", where=where, expected="at least one of each"
        )
    for role, column in (*roles, ("time", time), ("run", run)):
        if column is not None and column not in frame.columns:
            raise missing(f"{role} column", column, [*map(str, frame)], where)
    clock = None
    if time is not None or dt_s is None:
        clock = _time_column(frame, time, time_unit, where)
        time = clock.name
    for column in filter(None, (*inputs, *outputs, time)):
        if list(frame.columns).count(column) > 1:
            raise InputError(
                f"column {column!r} stands twice", where=where, remedy="rename one of them"
            )
    groups = (
        [("", frame)] if run is None else [(str(k), g) for k, g in frame.groupby(run, sort=False)]
    )
    times = [np.empty(0) if clock is None else _times(g, clock, where) for _, g in groups]
    if dt_s is not None:
        interval = dt_s
    elif resample_s is not None:
        interval = resample_s
    else:
        interval = sampling(times, where)
    if not 0 < interval < np.inf:
        raise InputError(
            f"the sampling interval is {interval:g} s", where=where, expected="a number above zero"
        )
    parts = []
    wrong: dict[str, int] = {}
    for (label, part), t in zip(groups, times):
        place = f"{where}, run {label}" if label else where
        u = np.column_stack([_readings(part, c, place, overload_codes, wrong) for c in inputs])
        y = np.column_stack([_readings(part, c, place, _output_codes, wrong) for c in outputs])
        start = 0.0
        if time is not None:
            check_times(t, time, place)
            start = float(t[0])
            u, y = even(t, u, y, interval, resample_s is not None, time, place)
        parts.append(
            IOData.from_arrays(
                u,
                y,
                interval,
                start_s=start,
                input_names=inputs,
                output_names=outputs,
                name=label or name,
            )
        )
    data = parts[0].merge(*parts[1:])
    codes = tuple(
        warning("record.codes", subject=column, count=count) for column, count in wrong.items()
    )
    if hold != "auto":
        return replace(data, hold=check_hold(hold, where), findings=codes)
    asked = [was_set(np.concatenate([r.u[:, k] for r in data.runs])) for k in range(len(inputs))]
    kind: Hold = "zoh" if all(held for held, _ in asked) else "foh"
    told = [
        (info if held else warning)(
            "record.hold", subject=name, step=step, hold=kind, half_s=data.dt_s / 2
        )
        for name, (held, step) in zip(inputs, asked)
        if step
    ]
    return replace(data, hold=kind, findings=(*codes, *told))


def _time_column(
    frame: pd.DataFrame, time: str | None, time_unit: str | None, where: str
) -> TimeColumn:
    """The time column of a table. Raises InputError that names both ways to give the time."""
    names = list(map(str, frame.columns))
    if time is None and not any(TIME_NAMES.fullmatch(split_unit(n)[0]) for n in names):
        raise InputError(
            "no time column found",
            where=where,
            remedy="name it ({time}) or give the sampling interval ({dt_s})",
            parameters={"time": "COLUMN", "dt_s": "SECONDS"},
        )
    return find_time_column(names, where, requested=time, unit=time_unit)


def _times(frame: pd.DataFrame, clock: TimeColumn, where: str) -> Array:
    """Times (N,) [s] of the rows; those of a clock that repeats its stamps are made even where the rows are."""
    is_clock = frame[clock.name].dtype.kind not in "iufb"
    times_s = clock.in_seconds(numbers(frame, clock.name, where, clock=True), is_clock)
    clock.check_step(times_s, is_clock)
    if (
        len(times_s) > 2
        and np.isfinite(times_s).all()
        and np.mean(np.diff(times_s) == 0) > FEW_DECIMALS
    ):
        rising = bool((np.diff(times_s) >= 0).all())
        even_rows = rows_of_repeated_stamps(times_s) if rising else None
        if even_rows is not None:
            return np.asarray(times_s[0] + even_rows.interval_s * even_rows.places, dtype=float)
    return times_s


def _output_codes(values: Array) -> Flags:
    """Overload and drop-out codes of a column in any unit."""
    overload = overload_codes(values)
    return overload | dropout_codes(np.where(overload, np.nan, values))


def _readings(
    frame: pd.DataFrame,
    column: str,
    where: str,
    codes: Callable[[Array], Flags],
    wrong: dict[str, int],
) -> Array:
    """One column (N,) with its ``codes`` as NaN; ``wrong`` counts them by column."""
    values = numbers(frame, column, where)
    bad = codes(values)
    if bad.any():
        wrong[column] = wrong.get(column, 0) + int(bad.sum())
    return np.where(bad, np.nan, values)


def was_set(u: Array) -> tuple[bool, float]:
    """Whether a computer set the input ``u`` (N,), and its least step where that cannot be told from a measured input
    that is rounded to it.

    One that was set mostly stays, and moves by a twentieth of its range or more, or between two samples that stay. One
    that is measured in steps moves, when slow, by one step at a time: so does a staircase of equal steps, which is
    taken as set where a step is a twentieth of the range or more.
    """
    u = u[np.isfinite(u)]
    moved = np.abs(np.diff(u))
    at = np.flatnonzero(moved)
    if not 0 < len(at) < (1 - REPEATED) * len(moved):
        return False, 0.0
    stays = np.concatenate([[True], moved == 0, [True]])
    step = float(moved[at].min())
    alone = float(np.mean(stays[at] & stays[at + 2]))
    large = bool(np.median(moved[at]) > JUMP * np.ptp(u))
    if np.ptp(u) < 2.5 * step or np.mean(moved[at] < 1.5 * step) <= 0.5:
        return large or alone > 0.5, 0.0
    return large and alone > ALONE, step if large or alone > ALONE else 0.0


def from_csv(path: str | Path, **options: Any) -> IOData:
    """:func:`from_frame` on a file: text of any dialect, spaces between columns too, TDMS, LVM or Parquet."""
    path = Path(path)
    given = [
        options[role]
        for role in ("input", "output", "time", "run")
        if options.get(role) is not None
    ]
    asked = {c for names in given for c in ([names] if isinstance(names, str) else names)}
    table = open_table(path, (*HEADER_NAMES, *asked))
    time = options.get("time")
    if time is None and options.get("dt_s") is None:
        time = next((n for n in table.names if TIME_NAMES.fullmatch(split_unit(n)[0])), None)
    columns = asked if time is None else {*asked, time}
    frame = table_of(table, columns)
    if time is None or list(table.names).count(time) != 1:
        return from_frame(frame, **{"name": path.name, **options})
    clock = find_time_column(
        table.names, path.name, requested=time, unit=options.get("time_unit"), unit_row=table.units
    )
    unit = options.get("time_unit") or (
        clock.written if clock.stated and clock.seconds is not None else None
    )
    # a table of text is read here for its clock stamps only; of other files all columns share one time
    raw = read_whole(
        table, [time] if isinstance(table, CsvTable) else [n for n in table.names if n in columns]
    )
    if time in raw.stamps and len(raw.data[time]) == len(frame):
        frame[time] = raw.data[time]
        unit = "s"
    return from_frame(frame, **{"name": path.name, **options, "time": time, "time_unit": unit})


def table_of(table: Table, asked: Collection[str]) -> pd.DataFrame:
    """A table's columns, of which those ``asked`` for are read where it is not text."""
    if isinstance(table, CsvTable):
        return _text_frame(table)
    raw = read_whole(table, [n for n in table.names if n in asked])
    return pd.DataFrame(
        raw.data, columns=list(table.names)
    )  # those not read are empty, so that errors name them


def _text_frame(table: CsvTable) -> pd.DataFrame:
    """All columns as they stand: the names of runs may be words."""
    d = table.dialect
    encoding = "utf-8" if d.encoding.startswith("utf-16") else d.encoding  # such text was rewritten
    try:
        with text_of(d) as stream:
            frame = pd.read_csv(
                stream,
                sep=d.separator,
                decimal=d.decimal,
                header=None,
                skiprows=d.skip,
                encoding=encoding,
            )
    except (pd.errors.ParserError, UnicodeDecodeError) as error:
        raise InputError(
            f"is not a table ({error})", where=table.where, expected="a table with a header"
        ) from error
    frame.columns = list(table.names)
    return frame


def numbers(frame: pd.DataFrame, column: str, where: str, clock: bool = False) -> Array:
    """One column as floats; text that is no number is refused with its row. A ``clock`` may hold times of the day, with
    or without the date, which are seconds from the first one on."""
    values = frame[column]
    if clock and values.dtype.kind not in "iufb":
        if values.dtype.kind == "M":
            return np.asarray((values - values.iloc[0]).dt.total_seconds(), dtype=float)
        texts = [str(v).strip() for v in values]
        if sum(CLOCK.fullmatch(t) is not None for t in texts) > 0.5 * len(texts):
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


def sampling(times: Sequence[Array], where: str) -> float:
    """The sampling interval [s]: total time by total steps, so that rounded time stamps do not drift."""
    steps = [np.diff(t) for t in times]
    joined = np.concatenate([s[np.isfinite(s) & (s > 0)] for s in steps])
    if len(joined) == 0:
        raise InputError("has fewer than two samples", where=where, expected="a record")
    median = float(np.median(joined))
    whole = np.round(joined / median)
    return float(joined.sum() / whole.sum()) if whole.sum() > 0 else median


def check_times(t: Array, column: str, where: str) -> None:
    """Refuse missing, repeated and backward times ``t`` (N,) [s]."""
    if np.isnan(t).any():
        raise InputError(
            f"column {column} is empty in row {np.flatnonzero(np.isnan(t))[0] + 1}", where=where
        )
    back = np.flatnonzero(np.diff(t) <= 0)
    if len(back):
        k = int(back[0])
        word = "repeats" if t[k + 1] == t[k] else "runs backwards"
        raise InputError(
            f"column {column} {word} at row {k + 2} ({t[k]:g} s then {t[k + 1]:g} s)",
            where=where,
            expected="increasing time",
            remedy="name the column that separates the runs, or remove the row",
        )


def even(
    t: Array, u: Array, y: Array, dt_s: float, resample: bool, column: str, where: str
) -> tuple[Array, Array]:
    """``u`` and ``y`` on an even grid of times [s]: gaps filled with NaN, or all resampled by straight lines."""
    position = (t - t[0]) / dt_s
    if position[-1] > MOST_SAMPLES:
        raise InputError(
            f"a grid of {dt_s:g} s over {t[-1] - t[0]:g} s has {position[-1]:.2g} samples",
            where=where,
            expected=f"at most {MOST_SAMPLES:.0e}",
            remedy="give a longer sampling interval in seconds",
        )
    if resample:
        grid = t[0] + dt_s * np.arange(int(np.floor(position[-1] + 1e-9)) + 1)
        known = [np.isfinite(column) for column in u.T]
        ue = np.column_stack([np.interp(grid, t[ok], column[ok]) for ok, column in zip(known, u.T)])
        return ue, np.column_stack([np.interp(grid, t, column) for column in y.T])
    index = np.round(position).astype(int)
    off = np.abs(position - index)
    if off.max() > JITTER or np.any(np.diff(index) == 0):
        k = int(np.argmax(off))
        raise InputError(
            f"column {column} is not evenly spaced: row {k + 1} at {t[k]:g} s is {off[k] * dt_s:.3g} s off a "
            f"{dt_s:g} s grid",
            where=where,
            expected="one sampling interval",
            remedy="resample it ({resample_s})",
            parameters={"resample_s": f"{dt_s:.3g}"},
        )
    n = index[-1] + 1
    if n == len(t):
        return u, y
    ue, ye = (np.full((n, v.shape[1]), np.nan) for v in (u, y))
    ue[index] = u
    ye[index] = y
    return ue, ye
