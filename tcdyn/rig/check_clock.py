"""A trace's clock: stamps and lost samples on an even grid, and readings moved to it where the stamps stray."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, SampleLocation, info, info_or_warning, warning
from tcdyn.estimation.trace_noise import MAD_TO_SD

LONGEST_GAP_S = 0.5  # longer silence is refused: nobody knows what happened in it
SLOWEST_DT_S = 1.0  # a trace sampled more slowly says nothing about lags
STRAYING = (
    0.15  # of an interval, standard deviation of the steps: less is rounding, and moves no reading
)
# of the steps are not one place long: another rate is sought; there is none
MOST_LOST = 0.2
MOST_STRAYED = 0.35
SURE = 4.0  # chance makes the sum of n stamps' phases so many times sqrt(n) once in some thousand trials
ABOUT = 3  # neighbours on each side that tell the slope by which a sample is moved to its place
TRUST = 4.0  # in the stamps: readings that tell more than 0.5 (1 sd) of them outweigh it


@dataclass(frozen=True)
class Sampling:
    """Each row's time (N,) [s] and its place on the even grid (N,), the sample interval [s], and what was noticed.

    ``late_s`` (N,): how much later than its place each sample was taken [s], where stamps stray; rows may then share a
    place.
    """

    time_s: Array
    dt_s: float
    grid: NDArray[np.int32]
    findings: tuple[Finding, ...]
    late_s: Array | None = None


def check_time(time: Array, place: SampleLocation) -> Sampling:
    """The time (N,) [s] as logged, with single missing values filled, and its sampling.

    Rounded stamps (0.013, 0.027, 0.040 at 75 Hz) are recognised as even and come back so; stamps that stray come back
    even, too, and with how late each sample is. Raises InputError for time that repeats or runs backward (row, time),
    gaps above 0.5 s, uneven sampling, milliseconds, or too few rows.
    """
    where = place.where
    if len(time) < 10:
        raise InputError(
            f"only {len(time)} rows", where=where, expected="at least 10 samples in time"
        )
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
            remedy="sort the rows, or give the clock more decimals"
            if verb == "repeats"
            else "repair the rows",
        )
    usual = float(np.median(step))
    dt = _interval_s(time, _places(step, usual))
    if dt > SLOWEST_DT_S:
        ms = dt * 1e-3 < 0.2
        raise InputError(
            f"column time_s: samples stand {dt:.4g} s apart"
            + ("; this looks like milliseconds" if ms else ""),
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
    late = None
    places = np.diff(grid)
    away = (
        dt * places
    )  # long logs: worked on in place here and below, one array of their length less each time
    away -= step
    straying = (
        float(away @ away) > len(away) * (STRAYING * dt) ** 2 or (places != 1).mean() > MOST_LOST
    )
    del away
    if straying:
        dt, grid = _repeating(time, len(step) / float(time[-1] - time[0]))
        places = np.diff(grid)
    odd = (step > 1.45 * dt) | (step < 0.55 * dt)
    if (places != 1).mean() > MOST_STRAYED:
        raise InputError(
            f"column time_s, row {place.row(int(np.argmax(odd)) + 1)}: sampling is uneven "
            f"({step.min():.4g} to {step.max():.4g} s)",
            where=where,
            expected="one sampling rate",
            remedy="log at one rate, or resample first",
        )
    jitter = odd & (places == 1)
    if jitter.any() and not straying:
        i = int(np.argmax(jitter))
        found.append(
            info("time.jitter", subject="time_s", row=place.row(i + 1), count=int(jitter.sum()))
        )
    even, away_s = _even(time, grid, dt)
    if straying:
        decimal_s = float(step.min())
        if (
            np.allclose(step / decimal_s, np.rint(step / decimal_s), atol=0.01)
            and away_s < 0.6 * decimal_s
        ):
            found.append(info("time.few_decimals", subject="time_s", rate_Hz=1 / dt))
        else:
            late = time - even
    if lost := int((places[places > 1] - 1).sum()):
        i = int(np.argmax(places > 1))
        gaps = int((places > 1).sum())
        line = place.row(i + 1)
        first_s = float(time[i])
        numbers: dict[str, Any] = {"row": line, "count": lost, "places": gaps, "first_s": first_s}
        found.append(info_or_warning(lost / len(time), "time.lost", subject="time_s", **numbers))
    if dt > 0.05:
        found.append(warning("time.slow", subject="time_s", rate_Hz=1 / dt, lost_s=2 * dt))
    # steps of 13 and 14 ms, neither of which is the interval of 75 Hz: the clock has too few decimals
    rounded = straying or (abs(usual - dt) >= 1e-3 * dt and away_s < dt)
    return Sampling(even if rounded else time, dt, grid, tuple(found), late)


def _repeating(time: Array, rate_Hz: float) -> tuple[float, NDArray[np.int32]]:
    """Interval [s] and places of stamps that stray from even sampling.

    They repeat best at the rate f of the largest |sum exp(2 pi i f t)|, sought in their beginning, then in ever more of
    them. Where none is sure, ``rate_Hz`` at which they come on the average, a little less than f where samples are
    lost, is as good.
    """
    t = time - time[0]
    size = min(4096, len(time))
    tried = rate_Hz * np.arange(0.99, 1.06, 0.25 / size)
    while True:
        some = t[:size][:: size // 20_000 + 1]
        best = float(tried[np.argmax([abs(np.exp(2j * np.pi * f * some).sum()) for f in tried])])
        if size == len(t):
            break
        tried = best + np.linspace(-0.5, 0.5, 17) / t[size - 1]
        size = min(4 * size, len(t))
    together = [np.exp(2j * np.pi * f * some).sum() for f in (best, rate_Hz)]
    f, phase = (
        (best, together[0])
        if abs(together[0]) > SURE * len(some) ** 0.5
        else (rate_Hz, together[1])
    )
    grid = np.rint(t * f - np.angle(phase) / (2 * np.pi)).astype(np.int32)
    # of two in one place the second goes to the next, or the first to the one before, if that is free
    grid[1:-1] += (np.diff(grid[:-1]) == 0) & (np.diff(grid[1:]) > 1)
    grid[1:-1] -= (np.diff(grid[:-1]) > 1) & (np.diff(grid[1:]) == 0)
    return _interval_s(time, grid), grid - grid[0]


def moved(name: str, values: Array, sampling: Sampling, rows: slice) -> Array:
    """The samples ``values (N,)`` of these rows of the file as they were at the even times; only temperatures move.

    By the slope of a straight line through the neighbours, NaN left out, which colours no noise and adds 1 % to it.
    """
    if sampling.late_s is None or not name.endswith("_degC"):
        return values
    late_s = sampling.late_s[rows]
    width = 2 * ABOUT + 1
    t = sliding_window_view(np.pad(sampling.time_s[rows] + late_s, ABOUT, mode="edge"), width)
    y = sliding_window_view(np.pad(values, ABOUT, constant_values=np.nan), width)
    used = np.isfinite(y)
    count = np.maximum(used.sum(axis=1), 1)
    t = np.where(used, t - sampling.time_s[rows, None], 0.0)
    y = np.where(used, y, 0.0)
    t, y = (np.where(used, x - (x.sum(axis=1) / count)[:, None], 0.0) for x in (t, y))
    return np.asarray(
        values - late_s * (t * y).sum(axis=1) / np.maximum((t * t).sum(axis=1), 1e-300)
    )


def weighed(sampling: Sampling, course: pd.DataFrame) -> Sampling:
    """With that part of ``late_s`` only which is the samples', as temperatures tell, and what to say of it.

    ``course``: cleaned columns, at the rows of the file that its index names.
    """
    if sampling.late_s is None:
        return sampling
    couples = course[[n for n in course if str(n).endswith("_degC")]].to_numpy()
    share = _real_share(couples, course.index.to_numpy(), sampling, sampling.late_s)
    stray_s = float(np.std(sampling.late_s))
    rate_Hz = 1 / sampling.dt_s
    said = info(
        "time.strays", subject="time_s", stray_s=stray_s, percent=100 * share, rate_Hz=rate_Hz
    )
    return replace(sampling, late_s=share * sampling.late_s, findings=(*sampling.findings, said))


def _real_share(
    columns: Array, rows: NDArray[np.int64], sampling: Sampling, late_s: Array
) -> float:
    """Which part of ``late_s`` is real, the rest being the stamps' own: 1 where the readings cannot tell.

    Fourth differences of readings are those of (slope late) and noise; both are known where the slope is clear.

    Args:
        columns: (N, M) temperatures at ``rows`` (N,) of the file, NaN where missing.
    """
    wide = 8
    n = len(rows)
    if n < 4 * wide:
        return 1.0
    grid = sampling.grid[rows]
    late = late_s[rows]
    inside = slice(wide - 2, n - wide - 2)
    whole = (grid[2 * wide :] - grid[: -2 * wide] == 2 * wide) & (
        rows[2 * wide :] - rows[: -2 * wide] == 2 * wide
    )
    jerk = np.diff(late, 4)[inside]
    weights = np.arange(wide, -wide - 1, -1.0)
    told = TRUST
    total = TRUST
    for y in columns.T:
        slope = np.convolve(y, weights, "valid") / np.sum(weights**2)
        bend = np.diff(y, 4)[inside]
        sd = MAD_TO_SD * float(np.nanmedian(np.abs(bend)))
        with np.errstate(invalid="ignore"):
            clear = whole & (np.abs(slope) > 4 * sd / np.sqrt(70 * np.sum(weights**2)))
        ahead = slope[clear] / sampling.dt_s * jerk[clear]
        told += float(np.sum(ahead * bend[clear])) / max(sd, 1e-9) ** 2
        total += float(np.sum(ahead**2)) / max(sd, 1e-9) ** 2
    return min(max(told / total, 0.0), 1.0)


def _places(step: Array, dt_s: float) -> NDArray[np.int32]:
    """Where each sample stands on the grid of ``dt_s``, from the steps between them."""
    many = step / dt_s
    np.maximum(np.rint(many, out=many), 1.0, out=many)
    place = np.zeros(len(step) + 1, dtype=np.int32)
    place[1:] = np.cumsum(many, out=many)
    return place


def _interval_s(time: Array, place: NDArray[np.int32]) -> float:
    """Slope of the straight line through the stamps, by least squares."""
    grid = place - place.mean()
    return float(grid @ (time - time.mean()) / (grid @ grid))


def interval_s(time_s: Array) -> float:
    """Sampling interval [s] of even times (N,), whose stamps may be rounded: the middle of their steps is, too.

    >>> round(75 * interval_s(np.round(np.arange(10.0) / 75, 3)), 9)
    1.0
    """
    return float(time_s[-1] - time_s[0]) / (len(time_s) - 1)


def _even(time: Array, place: NDArray[np.int32], dt_s: float) -> tuple[Array, float]:
    """Stamps on the even grid, and how far [s] the farthest of those logged lies from its own."""
    even = np.asarray(place - place.mean())
    even *= dt_s
    even += time.mean()
    late = time - even
    return even, float(max(late.max(), -late.min()))


def _filled(time: Array, place: SampleLocation) -> tuple[Array, list[Finding]]:
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
    return time, [info("time.filled", subject="time_s", row=place.row(i), count=int(bad.sum()))]
