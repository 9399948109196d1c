"""Is the time a time: forward, evenly sampled, in seconds; and the few missing samples put back as NaN."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.errors import InputError
from calibration.files.table import FloatArray, RowNumbers

LONGEST_GAP_S = 0.5  # longer silence is refused: nobody knows what happened in it
SLOWEST_DT_S = 1.0  # a trace sampled more slowly says nothing about lags


@dataclass(frozen=True)
class Sampling:
    """The sample interval [s], where each row stands on the even grid, and what was noticed."""

    dt_s: float
    place: NDArray[np.int32]
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
    dt = _interval_s(time, _places(step, usual))
    if dt > SLOWEST_DT_S:
        ms = dt * 1e-3 < 0.2
        raise InputError(
            f"{place}: samples stand {dt:.4g} s apart" + ("; this looks like milliseconds" if ms else ""),
            where=where,
            expected="seconds, sampled faster than 1 Hz (75 Hz on the rig)",
        )
    gap = int(np.argmax(step))
    if step[gap] > max(LONGEST_GAP_S, 3 * dt):
        raise InputError(
            f"{place}, row {rows.of(gap + 1)}: {step[gap]:.4g} s are missing at {time[gap]:.6g} s",
            where=where,
            expected=f"gaps of at most {LONGEST_GAP_S} s",
            remedy="cut the log there and use one part",
        )
    grid = _places(step, dt)
    lone = np.diff(grid) == 1
    odd = _away(step, dt) > 0.45 * dt
    jitter = odd & lone
    if jitter.sum() > 0.2 * lone.sum() or (~lone).mean() > 0.2:
        even = _straight(time)
        if even is None:
            i = int(np.argmax(odd))
            raise InputError(
                f"{place}, row {rows.of(i + 1)}: sampling is uneven ({step.min():.4g} to {step.max():.4g} s)",
                where=where,
                expected="one sampling rate",
                remedy="log at one rate, or resample first",
            )
        dt, grid = even
        notes.append(f"{place}: the stamps have few decimals; they are taken as even, {1 / dt:.5g} Hz")
        lone, jitter = np.full(len(step), True), np.full(len(step), False)
    if jitter.any():
        i = int(np.argmax(jitter))
        notes.append(f"{place}, row {rows.of(i + 1)}: {int(jitter.sum())} time stamps jitter by up to half a sample")
    lost = int(grid[-1]) - len(step)
    if lost:
        i = int(np.argmin(lone))
        notes.append(
            f"{place}, row {rows.of(i + 1)}: {lost} samples are missing in {int((~lone).sum())} place(s), "
            f"first at {time[i]:.6g} s; put in as NaN"
        )
    if dt > 0.05:
        notes.append(
            f"{place}: sampled at {1 / dt:.3g} Hz; 75 Hz is the rig's rate, lags below {2 * dt:.2g} s are lost"
        )
    del step
    return _unrounded(time, grid, dt, usual), Sampling(dt, grid, tuple(notes))


def _places(step: FloatArray, dt_s: float) -> NDArray[np.int32]:
    """Where each sample stands on the grid of ``dt_s``, from the steps between them."""
    place = np.zeros(len(step) + 1, dtype=np.int32)
    count = step / dt_s  # one copy and no more: a log may have millions of rows
    np.rint(count, out=count)
    np.maximum(count, 1.0, out=count)
    place[1:] = np.cumsum(count, out=count)
    return place


def _away(values: FloatArray, middle: float | FloatArray) -> FloatArray:
    away = values - middle
    return np.abs(away, out=away)


def _interval_s(time: FloatArray, place: NDArray[np.int32]) -> float:
    """Slope of the straight line through the stamps, by least squares; in blocks, for a log may have millions."""
    middle, start = float(place.mean()), float(time.mean())
    top = bottom = 0.0
    for first in range(0, len(time), 1 << 16):
        grid = place[first : first + (1 << 16)] - middle
        top += float(np.dot(grid, time[first : first + (1 << 16)] - start))
        bottom += float(np.dot(grid, grid))
    return top / bottom


def _straight(time: FloatArray) -> tuple[float, NDArray[np.int32]] | None:
    """Interval [s] and grid of a record without a loss whose stamps are rounded to nearly its interval, or None.

    Stamps of 0.01, 0.03, 0.04 s at 75 Hz lie within half a hundredth of a straight line; a lost sample bends it more.
    """
    grid = np.arange(len(time), dtype=np.int32)
    dt = _interval_s(time, grid)
    line = np.asarray((grid - float(grid.mean())) * dt + float(time.mean()), dtype=np.float64)
    return (dt, grid) if float(np.max(_away(time, line))) < 0.45 * dt else None


def _unrounded(time: FloatArray, grid: NDArray[np.int32], dt_s: float, usual_s: float) -> FloatArray:
    """Stamps on the even grid where the clock's decimals are too few for the interval; else as they are.

    Stamps of 0.013, 0.027, 0.040 s have steps of 13 and 14 ms, neither of which is the interval of 75 Hz.
    """
    if abs(usual_s - dt_s) < 1e-3 * dt_s:
        return time
    even: FloatArray = np.asarray(grid - float(grid.mean()), dtype=np.float64)
    even *= dt_s
    even += float(time.mean())
    return even if float(np.max(_away(even, time))) < dt_s else time


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
