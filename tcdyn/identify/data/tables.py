"""Input-output data from pandas frames and CSV files, with the questions a careless table raises."""

from __future__ import annotations

from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from calibration import Array
from calibration.errors import InputError
from calibration.files import CsvTable, open_table, read_whole, text_of
from tcdyn.identify.data.record import Hold, IOData

TIMES = ("time_s", "time", "t", "t_s", "Time", "Time_s")  # names by which a time column is found
MOST_SAMPLES = 5e7  # of one run on an even grid
JITTER = 0.05  # largest departure from an even time grid that is still called even, in sampling intervals


def from_frame(
    frame: pd.DataFrame,
    *,
    input: str,
    output: str,
    time: str | None = None,
    run: str | None = None,
    dt_s: float | None = None,
    hold: Hold = "foh",
    resample_s: float | None = None,
    name: str = "",
) -> IOData:
    """IOData from a table: one row a sample, an optional ``run`` column whose values name separate recordings.

    ``time`` is a column in seconds (found by itself when called time_s, time, t or t_s); without one give
    ``dt_s``. Rows missing from an even time grid become NaN outputs (a gap). ``resample_s`` puts uneven times on
    an even grid by straight lines. Raises InputError naming column, row and remedy.

    >>> table = pd.DataFrame({"time_s": [0, 1, 2], "u": [0, 1, 1], "y": [0.0, 0.2, 0.6]})
    >>> from_frame(table, input="u", output="y").dt_s
    1.0
    """
    where = name or "table"
    for role, column in (("input", input), ("output", output), ("time", time), ("run", run)):
        if column is not None and column not in frame.columns:
            near = get_close_matches(column, map(str, frame.columns), n=1, cutoff=0.6)
            raise InputError(
                f"{role} column {column!r} is missing",
                where=where,
                expected=f"one of {', '.join(map(str, frame))}",
                remedy=f"did you mean {near[0]!r}?" if near else "",
            )
    if time is None and dt_s is None:
        time = next((c for c in TIMES if c in frame.columns), None)
        if time is None:
            raise InputError(
                "no time column found",
                where=where,
                remedy="name it (time=COLUMN) or give the sampling interval (dt_s=SECONDS)",
                parameters=("time=COLUMN", "dt_s=SECONDS"),
            )
    groups = [("", frame)] if run is None else [(str(k), g) for k, g in frame.groupby(run, sort=False)]
    interval = dt_s if dt_s is not None else resample_s if resample_s is not None else sampling(groups, time, where)
    if not 0 < interval < np.inf:
        raise InputError(f"the sampling interval is {interval:g} s", where=where, expected="a number above zero")
    parts = []
    for label, part in groups:
        place = f"{where}, run {label}" if label else where
        u, y = numbers(part, input, place), numbers(part, output, place)
        start = 0.0
        if time is not None:
            t = numbers(part, time, place)
            check_times(t, time, place)
            start = float(t[0])
            u, y = even(t, u, y, interval, resample_s is not None, time, place)
        parts.append(
            IOData.from_arrays(
                u,
                y,
                interval,
                hold=hold,
                start_s=start,
                input_names=[input],
                output_names=[output],
                name=label or name,
            )
        )
    return parts[0].merge(*parts[1:])


def from_csv(path: str | Path, **options: Any) -> IOData:
    """:func:`from_frame` on a file: text of any dialect, spaces between columns too, TDMS, LVM or Parquet."""
    path = Path(path)
    asked = {str(options[role]) for role in ("input", "output", "time", "run") if options.get(role) is not None}
    table = open_table(path, asked)
    if isinstance(table, CsvTable):
        frame = _text_frame(table)
    else:
        raw = read_whole(table, [n for n in table.names if n in asked or n in TIMES])
        frame = pd.DataFrame(raw.data, columns=list(table.names))  # those not read are empty, so that errors name them
    return from_frame(frame, **{"name": path.name, **options})


def _text_frame(table: CsvTable) -> pd.DataFrame:
    """All columns as they stand: the names of runs may be words."""
    d = table.dialect
    encoding = "utf-8" if d.encoding.startswith("utf-16") else d.encoding  # such text was rewritten
    try:
        with text_of(d) as stream:
            frame = pd.read_csv(
                stream, sep=d.separator, decimal=d.decimal, header=None, skiprows=d.skip, encoding=encoding
            )
    except (pd.errors.ParserError, UnicodeDecodeError) as error:
        raise InputError(f"is not a table ({error})", where=table.where, expected="a table with a header") from error
    frame.columns = list(table.names)
    return frame


def numbers(frame: pd.DataFrame, column: str, where: str) -> Array:
    """One column as floats; text that is no number is refused with its row."""
    values = frame[column]
    converted = pd.to_numeric(values, errors="coerce")
    bad = np.flatnonzero(converted.isna().to_numpy() & values.notna().to_numpy())
    if len(bad):
        raise InputError(
            f"column {column} row {bad[0] + 1} holds {values.iloc[bad[0]]!r}",
            where=where,
            expected="a number or empty",
        )
    return converted.to_numpy(dtype=float)


def sampling(groups: list[tuple[str, pd.DataFrame]], time: str | None, where: str) -> float:
    """The sampling interval [s]: total time by total steps, so that rounded time stamps do not drift."""
    steps = [np.diff(numbers(g, str(time), where)) for _, g in groups]
    joined = np.concatenate([s[np.isfinite(s) & (s > 0)] for s in steps])
    if len(joined) == 0:
        raise InputError("has fewer than two samples", where=where, expected="a record")
    median = float(np.median(joined))
    whole = np.round(joined / median)
    return float(joined.sum() / whole.sum()) if whole.sum() > 0 else median


def check_times(t: Array, column: str, where: str) -> None:
    """Refuse missing, repeated and backward times ``t`` (N,) [s]."""
    if np.isnan(t).any():
        raise InputError(f"column {column} is empty in row {np.flatnonzero(np.isnan(t))[0] + 1}", where=where)
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


def even(t: Array, u: Array, y: Array, dt_s: float, resample: bool, column: str, where: str) -> tuple[Array, Array]:
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
        ok = np.isfinite(u)
        return np.interp(grid, t[ok], u[ok]), np.interp(grid, t, y)
    index = np.round(position).astype(int)
    off = np.abs(position - index)
    if off.max() > JITTER or np.any(np.diff(index) == 0):
        k = int(np.argmax(off))
        raise InputError(
            f"column {column} is not evenly spaced: row {k + 1} at {t[k]:g} s is {off[k] * dt_s:.3g} s off a "
            f"{dt_s:g} s grid",
            where=where,
            expected="one sampling interval",
            remedy=f"resample it (resample_s={dt_s:.3g})",
            parameters=(f"resample_s={dt_s:.3g}",),
        )
    n = index[-1] + 1
    if n == len(t):
        return u, y
    ue, ye = np.full(n, np.nan), np.full(n, np.nan)
    ue[index], ye[index] = u, y
    return ue, ye
