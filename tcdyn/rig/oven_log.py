"""Rows of an oven log: steady minutes of a continuous log, and checks of every row."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, SampleLocation, info, warning
from tcdyn.estimation.line_fit import fit_line
from tcdyn.estimation.trace_noise import clean, course_noise_K
from tcdyn.rig.check_columns import ColumnCheck
from tcdyn.rig.columns import couples_in


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
    names = ["prt_degC", *couples_in(frame)]
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
        steady[i] = all(
            _drift_below(t_h[near], means[n].to_numpy()[near], drift_K_per_h) for n in names
        )
    rows: list[dict[str, float]] = []
    seen: list[float] = []
    for plateau in _plateaus(steady, level, apart_K):
        last = means.iloc[plateau[-1]]
        repeat = 1 + sum(abs(s - last["prt_degC"]) < apart_K for s in seen)
        seen.append(float(last["prt_degC"]))
        setpoint = 5.0 * np.rint(last["prt_degC"] / 5.0)
        rows.append(
            {
                "repeat": float(repeat),
                "setpoint_degC": float(setpoint),
                **{n: float(last[n]) for n in names},
            }
        )
    if not rows:
        raise InputError(
            "no steady stretch in the oven log",
            expected=f"a drift below {drift_K_per_h:g} K/h for {10 * minute_s:g} s",
            remedy="wait longer at each temperature",
        )
    return pd.DataFrame(rows)


def _drift_below(t_h: Array, y: Array, limit: float) -> bool:
    ok = np.isfinite(y)
    if ok.sum() < 6:
        return False
    line = fit_line(t_h[ok], y[ok])
    error = float(np.sqrt(line.covariance[0, 0]))
    return abs(line.slope) < limit + 2 * error and error < 2 * limit


def _plateaus(steady: NDArray[np.bool_], level: Array, apart_K: float) -> list[list[int]]:
    found: list[list[int]] = []
    for i in np.flatnonzero(steady):
        if found and i - found[-1][-1] <= 15 and abs(level[i] - level[found[-1][0]]) < apart_K:
            found[-1].append(int(i))
        else:
            found.append([int(i)])
    return found


def oven_frame(
    columns: Mapping[str, Array], place: SampleLocation
) -> tuple[pd.DataFrame, list[Finding]]:
    """Oven rows as every log of an oven has them, from its canonical columns (N,), checked, and what was noticed.

    Raises InputError for channels that do not follow the PRT, and for a continuous log without a steady minute.
    """
    checked = {}
    found = list[Finding]()
    for name, values in columns.items():
        checked[name] = values
        if name.endswith("_degC") and name != "setpoint_degC":
            course_noise_K(name, values, np.arange(len(values)), place)
            check = ColumnCheck(name, place)
            checked[name] = clean(name, values)
            check.see(values, checked[name])
            found += check.judge()
    empty = ~np.isfinite(checked["prt_degC"])
    if empty.any():
        first = place.of(int(np.argmax(empty)))
        found.append(warning("oven.no_prt", subject="prt_degC", count=int(empty.sum()), **first))
    junctions = couples_in(columns)
    for name in junctions:
        gaps = ~np.isfinite(checked[name]) & ~empty
        if gaps.any():
            first = place.of(int(np.argmax(gaps)))
            found.append(warning("oven.missing", subject=name, count=int(gaps.sum()), **first))
    frame = pd.DataFrame(checked)
    if "time_s" in frame and not {"repeat", "setpoint_degC"} & set(frame.columns):
        time = frame["time_s"].to_numpy()
        if (still := ~(np.diff(time) > 0)).any():
            i = int(np.argmax(still)) + 1
            raise InputError(
                f"{place.at('time_s', i)}: time does not rise ({time[i - 1]:.6g} s, then {time[i]:.6g} s)",
                where=place.where,
                expected="time that rises from row to row",
            )
        span_h = float(time[-1] - time[0]) / 3600
        frame = steady_minutes(frame)
        found.append(info("oven.continuous", count=len(frame), span_h=span_h))
        empty = np.zeros(len(frame), dtype=bool)
    found += check_oven(frame, place)
    frame = frame.loc[~empty].reset_index(drop=True)
    if "setpoint_degC" not in frame:
        frame["setpoint_degC"] = 5.0 * np.rint(frame["prt_degC"] / 5.0)
        found.append(warning("oven.no_setpoint", subject="setpoint_degC"))
    if "repeat" not in frame:
        hold = (frame["setpoint_degC"].diff() != 0).cumsum()
        first_of = pd.DataFrame({"hold": hold, "at": frame["setpoint_degC"]}).drop_duplicates()
        number = dict(zip(first_of["hold"], first_of.groupby("at").cumcount() + 1.0))
        frame["repeat"] = hold.map(number).astype(float)
        found.append(info("oven.no_repeat", subject="repeat"))
    return frame[["repeat", "setpoint_degC", "prt_degC", *junctions]], found


def check_oven(frame: pd.DataFrame, place: SampleLocation) -> list[Finding]:
    """Oven rows: enough of them, and every channel follows the PRT. Raises InputError."""
    prt = frame["prt_degC"].to_numpy()
    found: list[Finding] = []
    for name in couples_in(frame):
        y = frame[name].to_numpy()
        ok = np.isfinite(y) & np.isfinite(prt)
        if ok.sum() < 3 or np.ptp(prt[ok]) < 5.0:
            raise InputError(
                f"column {name}: {int(ok.sum())} rows over {np.ptp(prt[ok]) if ok.any() else 0:.3g} degC",
                where=place.where,
                expected="at least 3 rows over 5 degC or more",
            )
        line = fit_line(prt[ok], y[ok])
        slope = line.slope
        offset = line.intercept
        looks = ""
        if abs(offset - 273.15) < 25.0 and 0.8 < slope < 1.25:
            looks = "this looks like kelvin"
        elif abs(slope - 1.8) < 0.15 and abs(offset - 32.0) < 15.0:
            looks = "this looks like degrees Fahrenheit"
        elif 0.03 < slope < 0.09 and abs(offset) < 3.0:
            looks = "this looks like millivolts"
        elif np.std(line.residuals) > 0.15 * np.ptp(prt[ok]) or abs(slope) < 0.3:
            looks = "it does not follow the PRT: a dead channel, or shuffled rows"
        elif not 0.7 < slope < 1.4 or abs(offset) > 25.0:
            looks = "this is no thermocouple in degrees Celsius"
        if looks:
            raise InputError(
                f"column {name}: {slope:.3g} x PRT {offset:+.3g}; {looks}",
                where=place.where,
                expected="degrees Celsius within some degrees of the PRT",
            )
        far = np.abs(y - prt) > 15.0
        if far.any():
            i = int(np.argmax(far))
            found.append(
                warning("oven.far", subject=name, value_degC=y[i], prt_degC=prt[i], **place.of(i))
            )
    return found
