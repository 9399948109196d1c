"""Is the time a time: forward, evenly sampled, in seconds; and the few missing samples put back as NaN."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration import Array
from calibration.errors import InputError
from calibration.finding import Finding, Place, look, note

LONGEST_GAP_S = 0.5  # longer silence is refused: nobody knows what happened in it
SLOWEST_DT_S = 1.0  # a trace sampled more slowly says nothing about lags


@dataclass(frozen=True)
class Sampling:
    """Each row's time (N,) [s] and its place on the even grid (N,), the sample interval [s], and what was noticed."""

    time_s: Array
    dt_s: float
    grid: NDArray[np.int32]
    findings: tuple[Finding, ...]


def check_time(time: Array, place: Place) -> Sampling:
    """The time (N,) [s] as logged, with single missing values filled, and its sampling.

    Rounded stamps (0.013, 0.027, 0.040 at 75 Hz) are recognised as even and come back so. Raises InputError for time
    that repeats or runs backward (row, time), gaps above 0.5 s, uneven sampling, milliseconds, or too few rows.
    """
    where = place.where
    if len(time) < 10:
        raise InputError(f"only {len(time)} rows", where=where, expected="at least 10 samples in time")
    time, found = _filled(time, place)
    step = np.diff(time)
    if not (step > 0).all():
        i = int(np.argmax(step <= 0))
        verb = "repeats" if step[i] == 0 else "runs backward"
        many = int((step <= 0).sum())
        raise InputError(
            f"column time_s, row {place.row(i + 1)}: time {verb} ({time[i]:.6g} s, then {time[i + 1]:.6g} s)"
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
            f"column time_s: samples stand {dt:.4g} s apart" + ("; this looks like milliseconds" if ms else ""),
            where=where,
            expected="seconds, sampled faster than 1 Hz (75 Hz on the rig)",
        )
    gap = int(np.argmax(step))
    if step[gap] > max(LONGEST_GAP_S, 3 * dt):
        raise InputError(
            f"column time_s, row {place.row(gap + 1)}: {step[gap]:.4g} s are missing at {time[gap]:.6g} s",
            where=where,
            expected=f"gaps of at most {LONGEST_GAP_S} s",
            remedy="cut the log there and use one part",
        )
    grid = _places(step, dt)
    lone = np.diff(grid) == 1
    odd = np.abs(step - dt) > 0.45 * dt
    jitter = odd & lone
    if jitter.sum() > 0.2 * lone.sum() or (~lone).mean() > 0.2:
        row = np.arange(len(time), dtype=np.int32)
        row_s = _interval_s(time, row)
        if _even(time, row, row_s)[1] >= 0.45 * row_s:  # a lost sample bends the line more than rounded stamps do
            i = int(np.argmax(odd))
            raise InputError(
                f"column time_s, row {place.row(i + 1)}: sampling is uneven ({step.min():.4g} to {step.max():.4g} s)",
                where=where,
                expected="one sampling rate",
                remedy="log at one rate, or resample first",
            )
        dt, grid = row_s, row
        found.append(look("time.few_decimals", subject="time_s", rate_Hz=1 / dt))
        lone, jitter = np.full(len(step), True), np.full(len(step), False)
    if jitter.any():
        i = int(np.argmax(jitter))
        found.append(note("time.jitter", subject="time_s", row=place.row(i + 1), count=int(jitter.sum())))
    lost = int(grid[-1]) - len(step)
    if lost:
        i = int(np.argmin(lone))
        line, places = place.row(i + 1), int((~lone).sum())
        found.append(look("time.lost", subject="time_s", row=line, count=lost, places=places, first_s=float(time[i])))
    if dt > 0.05:
        found.append(look("time.slow", subject="time_s", rate_Hz=1 / dt, lost_s=2 * dt))
    even, away_s = _even(time, grid, dt)
    # steps of 13 and 14 ms, neither of which is the interval of 75 Hz: the clock has too few decimals
    rounded = abs(usual - dt) >= 1e-3 * dt and away_s < dt
    return Sampling(even if rounded else time, dt, grid, tuple(found))


def _places(step: Array, dt_s: float) -> NDArray[np.int32]:
    """Where each sample stands on the grid of ``dt_s``, from the steps between them."""
    return np.concatenate([[0], np.cumsum(np.maximum(np.rint(step / dt_s), 1.0))]).astype(np.int32)


def _interval_s(time: Array, place: NDArray[np.int32]) -> float:
    """Slope of the straight line through the stamps, by least squares."""
    grid = place - place.mean()
    return float(grid @ (time - time.mean()) / (grid @ grid))


def _even(time: Array, place: NDArray[np.int32], dt_s: float) -> tuple[Array, float]:
    """Stamps on the even grid, and how far [s] the farthest of those logged lies from its own."""
    even = np.asarray((place - place.mean()) * dt_s + time.mean())
    return even, float(np.max(np.abs(even - time)))


def _filled(time: Array, place: Place) -> tuple[Array, list[Finding]]:
    bad = ~np.isfinite(time)
    if not bad.any():
        return time, []
    i = int(np.argmax(bad))
    if bad.sum() > 3 or bad[0] or bad[-1] or (bad[1:] & bad[:-1]).any():
        raise InputError(
            f"{place.at('time_s', i)}: {int(bad.sum())} times are missing",
            where=place.where,
            expected="a time in each row",
        )
    index = np.arange(len(time))
    time = np.interp(index, index[~bad], time[~bad])
    return time, [look("time.filled", subject="time_s", row=place.row(i), count=int(bad.sum()))]
