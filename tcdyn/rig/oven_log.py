"""Oven logs: steady rows of a continuous log, and checks of every row against the PRT.

Used by :func:`tcdyn.rig.log.read_log`. Thresholds are chosen by judgement. Tests:
``tests/calibration/test_static_lines.py``.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, SampleLocation, info, warning
from tcdyn.estimation.line_fit import fit_line
from tcdyn.rig.check_columns import ColumnCheck
from tcdyn.rig.clean_columns import cleaned_column, spike_noise_K
from tcdyn.rig.columns import junction_columns_in
from tcdyn.series.reading import Kind, reasons_of
from tcdyn.series.series import ColumnRows, value_findings

# A channel further from the PRT gives a warning [K]. Chosen by judgement.
MAX_DISTANCE_FROM_PRT_K = 15.0
# Blocks on either side of a block that decide whether it is steady, and the fewest of them at the
# ends of a log. Chosen by judgement.
NEAR_BLOCKS = 5
MIN_NEAR_BLOCKS = 6
# Size of a block over the usual size, from which it is used. Chosen by judgement.
MIN_BLOCK_SHARE = 0.8
# Steady blocks up to so many apart belong to one plateau. Chosen by judgement.
MAX_PLATEAU_GAP = 15
SETPOINT_STEP_K = 5.0  # set points are rounded to it
# Smallest range of the PRT over all rows [K]. Chosen by judgement.
MIN_RANGE_K = 5.0
MIN_OVEN_ROWS = 3  # of a channel: a line and one degree of freedom


def steady_minutes(
    frame: pd.DataFrame, *, minute_s: float = 60.0, drift_K_per_h: float = 1.0, apart_K: float = 5.0
) -> pd.DataFrame:
    """Oven rows from a continuous log with time_s, prt_degC and a_degC .. f_degC.

    A block of ``minute_s`` is steady if the PRT and all channels drift by less than
    ``drift_K_per_h`` (within twice the standard error of the drift) over the blocks around it.
    The last steady block of each plateau (PRT within ``apart_K``) gives one row: the means. A
    plateau visited again is the next repeat.

    Parameters
    ----------
    frame
        Continuous log.
    minute_s
        Length of a block [s].
    drift_K_per_h
        Largest drift of a steady block [K/h].
    apart_K
        Largest difference of the PRT within one plateau [K].

    Returns
    -------
    rows
        Table with repeat, setpoint_degC (rounded to 5 degC), prt_degC and the channels.

    Raises
    ------
    InputError
        No plateau is steady.

    Notes
    -----
    ``NEAR_BLOCKS`` on either side decide whether a block is steady. A smaller drift gives fewer
    rows; a larger one leaves a lag between thermocouples and PRT in the rows. Test:
    ``tests/calibration/test_static_lines.py``.
    """
    time = frame["time_s"].to_numpy(dtype=float)
    names = ["prt_degC", *junction_columns_in(frame)]
    block = ((time - time[0]) // minute_s).astype(int)
    grouped = frame[names].groupby(block)
    is_full = grouped.size() >= MIN_BLOCK_SHARE * float(grouped.size().median())
    means = grouped.mean()[is_full]
    t_h = means.index.to_numpy(dtype=float) * minute_s / 3600.0
    is_steady = np.zeros(len(means), dtype=bool)
    prt = means["prt_degC"].to_numpy()
    for i in range(len(means)):
        near = np.flatnonzero(np.abs(np.arange(len(means)) - i) <= NEAR_BLOCKS)
        if len(near) < MIN_NEAR_BLOCKS or np.ptp(prt[near]) > apart_K:
            continue
        is_steady[i] = all(
            _drift_below(t_h[near], means[name].to_numpy()[near], drift_K_per_h) for name in names
        )
    rows: list[dict[str, float]] = []
    plateaus_degC: list[float] = []
    for plateau in _plateaus(is_steady, prt, apart_K):
        last = means.iloc[plateau[-1]]
        level = float(last["prt_degC"])
        earlier_visits = sum(abs(previous - level) < apart_K for previous in plateaus_degC)
        plateaus_degC.append(level)
        row = {
            "repeat": float(1 + earlier_visits),
            "setpoint_degC": float(SETPOINT_STEP_K * np.rint(level / SETPOINT_STEP_K)),
        }
        row |= {name: float(last[name]) for name in names}
        rows.append(row)
    if not rows:
        raise InputError(
            "no steady stretch in the oven log",
            expected=f"a drift below {drift_K_per_h:g} K/h for {2 * NEAR_BLOCKS * minute_s:g} s",
            remedy="wait longer at each temperature",
        )
    return pd.DataFrame(rows)


def _drift_below(t_h: Array, y: Array, limit: float) -> bool:
    """Whether the slope is below ``limit`` within two standard errors, and well determined.

    Parameters
    ----------
    t_h
        Times (N,) [h].
    y
        Temperatures (N,) [degC], NaN left out.
    limit
        Largest drift [K/h].
    """
    ok = np.isfinite(y)
    if ok.sum() < MIN_NEAR_BLOCKS:
        return False
    line = fit_line(t_h[ok], y[ok])
    standard_error = float(np.sqrt(line.covariance[0, 0]))
    return abs(line.slope) < limit + 2 * standard_error and standard_error < 2 * limit


def _plateaus(is_steady: NDArray[np.bool_], prt: Array, apart_K: float) -> list[list[int]]:
    """Group steady blocks by plateau, up to ``MAX_PLATEAU_GAP`` blocks apart.

    Parameters
    ----------
    is_steady
        Whether each block is steady (N,).
    prt
        PRT of each block (N,) [degC].
    apart_K
        Largest difference of the PRT within one plateau [K].

    Returns
    -------
    plateaus
        Indices of the blocks of each plateau.
    """
    plateaus: list[list[int]] = []
    for i in np.flatnonzero(is_steady).tolist():
        last = plateaus[-1] if plateaus else None
        if last and i - last[-1] <= MAX_PLATEAU_GAP and abs(prt[i] - prt[last[0]]) < apart_K:
            last.append(i)
        else:
            plateaus.append([i])
    return plateaus


def oven_frame(
    columns: Mapping[str, Array], location: SampleLocation
) -> tuple[pd.DataFrame, list[Finding]]:
    """Checked rows of an oven log in canonical form, and the findings.

    Parameters
    ----------
    columns
        Canonical columns, (N,) each.
    location
        Position of the rows in the file, for messages.

    Returns
    -------
    frame
        Rows with a PRT reading: repeat, setpoint_degC, prt_degC and the channels.
    findings
        About the columns and the rows.

    Raises
    ------
    InputError
        A channel does not follow the PRT, or a continuous log holds no steady minute.
    """
    cleaned: dict[str, Array] = {}
    findings: list[Finding] = []
    for name, values in columns.items():
        cleaned[name] = values
        if name.endswith("_degC") and name != "setpoint_degC":
            spike_noise_K(name, values, np.arange(len(values)), location)
            rows = ColumnRows(name, "degC", Kind.TEMPERATURE, values)
            findings += value_findings(rows, reasons_of(values, rows.kind))
            check = ColumnCheck(name, location)
            cleaned[name] = cleaned_column(name, values)
            check.add(values, cleaned[name])
            findings += check.judge()
    no_prt = ~np.isfinite(cleaned["prt_degC"])
    if no_prt.any():
        numbers = {"count": int(no_prt.sum()), **location.numbers_at(int(np.argmax(no_prt)))}
        findings.append(warning("oven.no_prt", subject="prt_degC", **numbers))
    junctions = junction_columns_in(columns)
    for name in junctions:
        gaps = ~np.isfinite(cleaned[name]) & ~no_prt
        if gaps.any():
            numbers = {"count": int(gaps.sum()), **location.numbers_at(int(np.argmax(gaps)))}
            findings.append(warning("oven.missing", subject=name, **numbers))
    frame = pd.DataFrame(cleaned)
    if "time_s" in frame and not {"repeat", "setpoint_degC"} & set(frame.columns):
        span_h = _check_rising(frame["time_s"].to_numpy(), location)
        frame = steady_minutes(frame)
        findings.append(info("oven.continuous", count=len(frame), span_h=span_h))
        no_prt = np.zeros(len(frame), dtype=bool)
    findings += check_oven(frame, location)
    frame = frame.loc[~no_prt].reset_index(drop=True)
    if "setpoint_degC" not in frame:
        frame["setpoint_degC"] = 5.0 * np.rint(frame["prt_degC"] / 5.0)
        findings.append(warning("oven.no_setpoint", subject="setpoint_degC"))
    if "repeat" not in frame:
        frame["repeat"] = _repeats(frame["setpoint_degC"])
        findings.append(info("oven.no_repeat", subject="repeat"))
    return frame[["repeat", "setpoint_degC", "prt_degC", *junctions]], findings


def _check_rising(time: Array, location: SampleLocation) -> float:
    """Duration of a continuous log [h]; InputError where time does not rise.

    Parameters
    ----------
    time
        Times (N,) [s].
    location
        Position of the rows in the file, for messages.
    """
    is_wrong = ~(np.diff(time) > 0)
    if is_wrong.any():
        i = int(np.argmax(is_wrong)) + 1
        raise InputError(
            f"{location.at('time_s', i)}: time does not rise "
            f"({time[i - 1]:.6g} s, then {time[i]:.6g} s)",
            where=location.where,
            expected="time that rises from row to row",
        )
    return float(time[-1] - time[0]) / 3600


def _repeats(setpoint_degC: pd.Series[float]) -> pd.Series[float]:
    """Number of the repeat of each row: how often its set point has been visited so far."""
    hold = (setpoint_degC.diff() != 0).cumsum()
    holds = pd.DataFrame({"hold": hold, "setpoint": setpoint_degC}).drop_duplicates()
    repeats = holds.groupby("setpoint").cumcount() + 1.0
    return hold.map(dict(zip(holds["hold"], repeats))).astype(float)


def check_oven(frame: pd.DataFrame, location: SampleLocation) -> list[Finding]:
    """Check that there are enough oven rows, and that every channel follows the PRT.

    Parameters
    ----------
    frame
        Oven rows.
    location
        Position of the rows in the file, for messages.

    Returns
    -------
    findings
        Channels far from the PRT.

    Raises
    ------
    InputError
        Fewer than ``MIN_OVEN_ROWS`` over ``MIN_RANGE_K``, or a channel that is not in degrees
        Celsius.
    """
    prt = frame["prt_degC"].to_numpy()
    findings: list[Finding] = []
    for name in junction_columns_in(frame):
        y = frame[name].to_numpy()
        ok = np.isfinite(y) & np.isfinite(prt)
        range_K = float(np.ptp(prt[ok])) if ok.any() else 0.0
        if ok.sum() < MIN_OVEN_ROWS or range_K < MIN_RANGE_K:
            raise InputError(
                f"column {name}: {int(ok.sum())} rows over {range_K:.3g} degC",
                where=location.where,
                expected=f"at least {MIN_OVEN_ROWS} rows over {MIN_RANGE_K:g} degC or more",
            )
        line = fit_line(prt[ok], y[ok])
        scatter = float(np.std(line.residuals)) / range_K
        problem = _wrong_unit(line.slope, line.intercept, scatter)
        if problem:
            raise InputError(
                f"column {name}: {line.slope:.3g} x PRT {line.intercept:+.3g}; {problem}",
                where=location.where,
                expected="degrees Celsius within some degrees of the PRT",
            )
        is_far = np.abs(y - prt) > MAX_DISTANCE_FROM_PRT_K
        if is_far.any():
            i = int(np.argmax(is_far))
            numbers = {"value_degC": y[i], "prt_degC": prt[i], **location.numbers_at(i)}
            findings.append(warning("oven.far", subject=name, **numbers))
    return findings


def _wrong_unit(slope: float, offset: float, scatter: float) -> str:
    """What a line through readings against the PRT looks like; empty for degrees Celsius.

    Parameters
    ----------
    slope
        Slope of the line [1].
    offset
        Its value at a PRT of 0 degC.
    scatter
        Standard deviation of the residuals over the range of the PRT [1].

    Notes
    -----
    Kelvin has the offset 273.15; Fahrenheit the slope 1.8 and the offset 32; millivolts a slope of
    some 0.05 mV/K. The tolerances are chosen by judgement.
    """
    if abs(offset - 273.15) < 25.0 and 0.8 < slope < 1.25:
        return "this looks like kelvin"
    if abs(slope - 1.8) < 0.15 and abs(offset - 32.0) < 15.0:
        return "this looks like degrees Fahrenheit"
    if 0.03 < slope < 0.09 and abs(offset) < 3.0:
        return "this looks like millivolts"
    if scatter > 0.15 or abs(slope) < 0.3:
        return "it does not follow the PRT: a dead channel, or shuffled rows"
    if not 0.7 < slope < 1.4 or abs(offset) > 25.0:
        return "this is no thermocouple in degrees Celsius"
    return ""
