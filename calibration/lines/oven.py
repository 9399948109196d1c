"""What an oven says before any line is drawn: error statistics, histogram, steady minutes in a continuous log."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from calibration.disk import CHANNELS
from calibration.errors import InputError


@dataclass(frozen=True)
class ErrorStatistics:
    """Table 2.6's statistics of thermocouple minus PRT [K]; the standard deviation is about the mean error."""

    maximum_K: float
    sum_absolute_K: float
    mean_absolute_K: float
    standard_deviation_K: float
    n: int

    def rows(self) -> dict[str, float]:
        """The statistics under the names of table 2.6."""
        return {
            "Maximum error": self.maximum_K,
            "Summation of the absolute error": self.sum_absolute_K,
            "Average of the absolute error": self.mean_absolute_K,
            "Standard deviation": self.standard_deviation_K,
        }


def error_statistics(errors_K: ArrayLike) -> ErrorStatistics:
    """Table 2.6's statistics of errors [K] of any shape; NaN is left out.

    >>> error_statistics([1.0, -1.0, 0.5, -0.5]).mean_absolute_K
    0.75
    """
    e = np.asarray(errors_K, dtype=float).ravel()
    e = e[np.isfinite(e)]
    if len(e) < 2:
        raise InputError("fewer than 2 errors to describe")
    size = np.abs(e)
    return ErrorStatistics(float(size.max()), float(size.sum()), float(size.mean()), float(e.std(ddof=1)), len(e))


def error_histogram(errors_K: ArrayLike, width_K: float = 0.1) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Counts and edges [K] of a histogram with bins of ``width_K`` centred on zero (figure 2.16)."""
    e = np.asarray(errors_K, dtype=float).ravel()
    e = e[np.isfinite(e)]
    half = int(np.ceil(np.abs(e).max() / width_K)) if len(e) else 1
    edges = width_K * (np.arange(-half, half + 2) - 0.5)
    counts, edges = np.histogram(e, edges)
    return counts.astype(np.int64), np.asarray(edges, dtype=np.float64)


def hold_means(frame: pd.DataFrame) -> pd.DataFrame:
    """One row for each hold, the mean of its minutes: repeat, setpoint_degC, prt_degC, a_degC .. f_degC.

    Minutes of one hold follow one another under one repeat and set point; a channel without a value in some minute
    is averaged over the others, against the PRT of the same minutes.
    """
    keys = ["repeat", "setpoint_degC"]
    if not frame.duplicated(keys).any():
        return frame.reset_index(drop=True)
    names = [f"{c}_degC" for c in CHANNELS if f"{c}_degC" in frame]
    offset = frame[names].sub(frame["prt_degC"], axis=0)
    grouped = offset.assign(prt_degC=frame["prt_degC"]).groupby([frame[k] for k in keys], sort=False)
    means = grouped.mean()
    means[names] = means[names].add(means["prt_degC"], axis=0)
    return means.reset_index()[[*keys, "prt_degC", *names]]


def steady_minutes(
    frame: pd.DataFrame, *, minute_s: float = 60.0, drift_K_per_h: float = 1.0, apart_K: float = 5.0
) -> pd.DataFrame:
    """Oven rows from a continuous log with time_s, prt_degC and a_degC .. f_degC.

    Each block of ``minute_s`` whose PRT and channels drift by less than ``drift_K_per_h`` (within twice its own
    standard error, over the ten blocks around it) is steady; of each plateau (PRT within ``apart_K``) the last
    steady block gives one row: the means. A plateau visited again is the next repeat.

    Raises InputError when no plateau is steady.
    """
    time = frame["time_s"].to_numpy(dtype=float)
    names = ["prt_degC", *(f"{c}_degC" for c in CHANNELS)]
    block = ((time - time[0]) // minute_s).astype(int)
    grouped = frame[names].groupby(block)
    full = grouped.size() >= 0.8 * float(grouped.size().median())
    means = grouped.mean()[full]
    t_h = means.index.to_numpy(dtype=float) * minute_s / 3600.0
    steady = np.zeros(len(means), dtype=bool)
    level = means["prt_degC"].to_numpy()
    for i in range(len(means)):
        near = np.flatnonzero(np.abs(np.arange(len(means)) - i) <= 5)
        if len(near) < 6 or np.ptp(level[near]) > apart_K:
            continue
        steady[i] = all(_drift_below(t_h[near], means[n].to_numpy()[near], drift_K_per_h) for n in names)
    rows: list[dict[str, float]] = []
    seen: list[float] = []
    for plateau in _plateaus(steady, level, apart_K):
        last = means.iloc[plateau[-1]]
        repeat = 1 + sum(abs(s - last["prt_degC"]) < apart_K for s in seen)
        seen.append(float(last["prt_degC"]))
        setpoint = 5.0 * np.rint(last["prt_degC"] / 5.0)
        rows.append({"repeat": float(repeat), "setpoint_degC": float(setpoint), **{n: float(last[n]) for n in names}})
    if not rows:
        raise InputError(
            "no steady stretch in the oven log",
            expected=f"a drift below {drift_K_per_h:g} K/h for {10 * minute_s:g} s",
            remedy="wait longer at each temperature",
        )
    return pd.DataFrame(rows)


def _drift_below(t_h: NDArray[np.float64], y: NDArray[np.float64], limit: float) -> bool:
    ok = np.isfinite(y)
    if ok.sum() < 6:
        return False
    dt = t_h[ok] - t_h[ok].mean()
    slope = float(dt @ y[ok] / (dt @ dt))
    rest = y[ok] - y[ok].mean() - slope * dt
    error = float(np.sqrt(rest @ rest / (ok.sum() - 2) / (dt @ dt)))
    return abs(slope) < limit + 2 * error and error < 2 * limit


def _plateaus(steady: NDArray[np.bool_], level: NDArray[np.float64], apart_K: float) -> list[list[int]]:
    found: list[list[int]] = []
    for i in np.flatnonzero(steady):
        if found and i - found[-1][-1] <= 15 and abs(level[i] - level[found[-1][0]]) < apart_K:
            found[-1].append(int(i))
        else:
            found.append([int(i)])
    return found
