"""Is the time a time: forward, evenly sampled, in seconds; and the few missing samples put back as NaN."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.errors import InputError
from calibration.table import FloatArray, RowNumbers

LONGEST_GAP_S = 0.5  # longer silence is refused: nobody knows what happened in it
SLOWEST_DT_S = 1.0  # a trace sampled more slowly says nothing about lags


@dataclass(frozen=True)
class Sampling:
    """The sample interval [s], where each row stands on the even grid, and what was noticed."""

    dt_s: float
    place: NDArray[np.int64]
    notes: tuple[str, ...]


def check_time(time: FloatArray, rows: RowNumbers, where: str, column: str = "time_s") -> tuple[FloatArray, Sampling]:
    """The time [s] with single missing values filled, and its sampling.

    Rounded stamps (0.013, 0.027, 0.040 at 75 Hz) are recognised as even and come back so. Raises InputError for time
    that repeats or runs backward (row, time), gaps above 0.5 s, uneven sampling, milliseconds, or too few rows.
    """
    place = f"column {column}"
    if len(time) < 10:
        raise InputError(f"only {len(time)} rows", where=where, expected="at least 10 samples in time")
    time, notes = _filled(time, rows, where, place)
    step = np.diff(time)
    if not (step > 0).all():
        i = int(np.argmax(step <= 0))
        verb = "repeats" if step[i] == 0 else "runs backward"
        many = int((step <= 0).sum())
        raise InputError(
            f"{place}, row {rows.of(i + 1)}: time {verb} ({time[i]:.6g} s, then {time[i + 1]:.6g} s)"
            + (f", and in {many - 1} more rows" if many > 1 else ""),
            where=where,
            expected="time that rises from row to row",
            remedy="sort the rows, or give the clock more decimals" if verb == "repeats" else "repair the rows",
        )
    usual = float(np.median(step))
    counts = np.maximum(np.rint(step / usual).astype(np.int64), 1)
    grid = np.concatenate([[0], np.cumsum(counts)])
    dt = float(np.polyfit(grid - grid.mean(), time - time.mean(), 1)[0])
    if dt > SLOWEST_DT_S:
        ms = dt * 1e-3 < 0.2
        raise InputError(
            f"{place}: samples stand {dt:.4g} s apart" + ("; this looks like milliseconds" if ms else ""),
            where=where,
            expected="seconds, sampled faster than 1 Hz (75 Hz on the rig)",
        )
    counts = np.maximum(np.rint(step / dt).astype(np.int64), 1)
    gap = int(np.argmax(step))
    if step[gap] > max(LONGEST_GAP_S, 3 * dt):
        raise InputError(
            f"{place}, row {rows.of(gap + 1)}: {step[gap]:.4g} s are missing at {time[gap]:.6g} s",
            where=where,
            expected=f"gaps of at most {LONGEST_GAP_S} s",
            remedy="cut the log there and use one part",
        )
    single = step[counts == 1]
    odd = np.abs(single - dt) > 0.45 * dt
    if odd.mean() > 0.2 or (counts > 1).mean() > 0.2:
        i = int(np.argmax(np.abs(step - dt) > 0.45 * dt))
        raise InputError(
            f"{place}, row {rows.of(i + 1)}: sampling is uneven ({step.min():.4g} to {step.max():.4g} s)",
            where=where,
            expected="one sampling rate",
            remedy="log at one rate, or resample first",
        )
    if odd.any():
        i = int(np.argmax((np.abs(step - dt) > 0.45 * dt) & (counts == 1)))
        notes.append(f"{place}, row {rows.of(i + 1)}: {int(odd.sum())} time stamps jitter by up to half a sample")
    lost = int((counts - 1).sum())
    if lost:
        i = int(np.argmax(counts > 1))
        notes.append(
            f"{place}, row {rows.of(i + 1)}: {lost} samples are missing in {int((counts > 1).sum())} place(s), "
            f"first at {time[i]:.6g} s; put in as NaN"
        )
    if dt > 0.05:
        notes.append(
            f"{place}: sampled at {1 / dt:.3g} Hz; 75 Hz is the rig's rate, lags below {2 * dt:.2g} s are lost"
        )
    grid = np.concatenate([[0], np.cumsum(counts)])
    return _unrounded(time, grid, dt), Sampling(dt, grid, tuple(notes))


def _unrounded(time: FloatArray, grid: NDArray[np.int64], dt_s: float) -> FloatArray:
    """Stamps on the even grid where the clock's decimals are too few for the interval; else as they are.

    Stamps of 0.013, 0.027, 0.040 s have steps of 13 and 14 ms, neither of which is the interval of 75 Hz.
    """
    if abs(float(np.median(np.diff(time))) - dt_s) < 1e-3 * dt_s:
        return time
    even = time.mean() + dt_s * (grid - grid.mean())
    return np.asarray(even) if float(np.max(np.abs(even - time))) < dt_s else time


def spread(values: FloatArray, place: NDArray[np.int64]) -> FloatArray:
    """The values on the even grid, NaN where samples are missing."""
    out = np.full(int(place[-1]) + 1, np.nan)
    out[place] = values
    return out


def spread_time(time: FloatArray, sampling: Sampling) -> FloatArray:
    """The time [s] on the even grid: as logged where it was logged, straight lines between."""
    grid = np.arange(int(sampling.place[-1]) + 1)
    return np.asarray(np.interp(grid, sampling.place, time))


def _filled(time: FloatArray, rows: RowNumbers, where: str, place: str) -> tuple[FloatArray, list[str]]:
    bad = ~np.isfinite(time)
    if not bad.any():
        return time, []
    i = int(np.argmax(bad))
    if bad.sum() > 3 or bad[0] or bad[-1] or (bad[1:] & bad[:-1]).any():
        raise InputError(
            f"{place}, row {rows.of(i)}: {int(bad.sum())} times are missing",
            where=where,
            expected="a time in each row",
        )
    index = np.arange(len(time))
    time = np.interp(index, index[~bad], time[~bad])
    return time, [f"{place}, row {rows.of(i)}: {int(bad.sum())} missing time(s) filled from the neighbours"]
