"""What must hold for each kind of log: switches that move, loads in newtons, channels that follow the PRT."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from calibration.checks.temperature import Place
from calibration.disk import CHANNELS, DISKS
from calibration.errors import InputError
from calibration.files.table import FloatArray

BOUNCE_S = 0.2
SWAPPED = "are they swapped?"  # how the warning of such a pair ends


def two_level(values: FloatArray, name: str, place: Place) -> tuple[FloatArray, list[str]]:
    """A switch as 0 and 1; missing samples keep the state before them.

    Other pairs of levels (0 and 5 V) are read as off and on, with a note. Raises InputError for more levels.
    """
    notes: list[str] = []
    out = values
    missing = ~np.isfinite(out)
    if missing.all():
        raise InputError(f"column {name} holds no numbers", where=place.where, expected="0 and 1")
    if missing.any():
        if missing.mean() > 0.05:
            raise InputError(
                f"{place.at(name, int(np.argmax(missing)))}: {100 * missing.mean():.0f} % of it is missing",
                where=place.where,
            )
        notes.append(f"{place.at(name, int(np.argmax(missing)))}: {int(missing.sum())} value(s) missing; state kept")
        out = np.array(pd.Series(out).where(~missing).ffill().bfill(), dtype=np.float64)
    levels = np.sort(pd.unique(out))
    if len(levels) > 2:
        i = int(np.argmax((out != levels[0]) & (out != levels[-1])))
        raise InputError(
            f"{place.at(name, i)}: {out[i]:.4g}; the column takes {len(levels)} different values",
            where=place.where,
            expected="0 and 1",
        )
    if set(levels) <= {0.0, 1.0}:
        return out, notes
    if len(levels) == 2:
        notes.append(f"column {name}: levels {levels[0]:g} and {levels[1]:g} are read as 0 and 1")
        return (out == levels[1]).astype(float), notes
    raise InputError(f"column {name} is {levels[0]:g} in every row", where=place.where, expected="0 and 1")


def check_switch(values: FloatArray, name: str, place: Place) -> list[str]:
    """An entry switch: must go from 0 to 1; held or momentary both are fine, bounces are noted."""
    up = np.flatnonzero(np.diff(values) > 0) + 1
    if len(up) == 0:
        held = "goes from 1 to 0 only" if np.ptp(values) else f"is {values[0]:g} in every row"
        raise InputError(
            f"column {name} {held}: the switch never moves to 1",
            where=place.where,
            expected="0 before the entry, 1 at the entry",
            remedy="give the log of the whole plunge",
        )
    return _bounces(values, name, place)


def check_contact(contact: FloatArray, place: Place) -> list[str]:
    """The contact switch of an EHL log (N,): must fall; bounces and a missing loading or cooling are noted."""
    down = np.flatnonzero(np.diff(contact) < 0) + 1
    if len(down) == 0:
        state = "rises but never falls" if np.ptp(contact) else f"is {contact[0]:g} in every row"
        raise InputError(
            f"column contact {state}: no unloading",
            where=place.where,
            expected="1 while the disks touch, then 0",
            remedy="give the log of the whole test, through the cooling",
        )
    notes = _bounces(contact, "contact", place)
    if contact[0] > 0.5:
        notes.append("column contact: the log begins in contact; the loading is not in it")
    if place.dt_s is not None and (len(contact) - down[-1]) * place.dt_s < 5.0:
        notes.append(
            f"column contact: only {(len(contact) - down[-1]) * place.dt_s:.2g} s of cooling after the unloading"
        )
    return notes


def check_loads(frame: Mapping[str, FloatArray], where: str) -> list[str]:
    """Load, friction and speeds of an EHL log while ``contact`` is 1. Raises InputError where they cannot be used."""
    contact, load = frame["contact"], frame["load_N"]
    on, off = float(np.nanmedian(load[contact > 0.5])), float(np.nanmedian(load[contact < 0.5]))
    if abs(on - off) < 10.0:
        raise InputError(
            f"column load_N is {on:.4g} in contact and {off:.4g} without: a dead cell, kilonewtons or volts",
            where=where,
            expected="newtons that rise by 10 or more in contact",
        )
    if on < off:
        apart = load < 0.5 * (np.nanmin(load) + np.nanmax(load))
        inverted = not apart.any() or contact[apart].mean() > 0.5
        raise InputError(
            f"column contact: the load is {on:.4g} N where contact is 1 and {off:.4g} N where it is 0",
            where=where,
            expected="contact 1 while the disks touch",
            remedy="the switch looks inverted: log 1 - contact"
            if inverted
            else "the switch looks momentary: hold it at 1 from touching to parting, as the load shows it",
        )
    notes: list[str] = []
    friction = float(np.nanmedian(frame["friction_N"][contact > 0.5]))
    if friction < 0:
        notes.append("column friction_N is negative in contact; its sign may be turned round")
    elif friction > 0.3 * on:
        notes.append("column friction_N is above 0.3 of the load in contact")
    return notes + _speeds(frame, contact, where)


def check_swapped(frame: pd.DataFrame, prefix: str, depth_mm: dict[str, float], hot: NDArray[np.bool_]) -> list[str]:
    """Junctions nearer a heated surface must be warmer: pairs that stand the other way round are named.

    ``hot`` marks the samples where heat flows in; the start of the record takes out static offsets.
    """
    if hot.sum() < 20:
        return []
    names = {c: f"{prefix}{c}_degC" for c in CHANNELS if f"{prefix}{c}_degC" in frame}
    head = frame.iloc[: max(10, min(len(frame) // 20, 400))]
    lead = {c: float(np.nanmean(frame[n].to_numpy()[hot]) - np.nanmean(head[n].to_numpy())) for c, n in names.items()}
    pairs = [(s, d) for s in lead for d in lead if depth_mm[d] - depth_mm[s] >= 2.5]
    wrong = [(s, d) for s, d in pairs if lead[s] < lead[d] - max(0.5, 0.02 * abs(lead[d]))]
    if not wrong:
        return []
    shallow, deep = min(wrong, key=lambda p: lead[p[0]] - lead[p[1]])
    return [
        f"columns {names[shallow]} and {names[deep]}: the junction {depth_mm[shallow]:g} mm deep warms "
        f"{lead[deep] - lead[shallow]:.2g} degC less than the one at {depth_mm[deep]:g} mm; {SWAPPED}"
    ]


def check_oven(frame: pd.DataFrame, place: Place) -> list[str]:
    """Oven rows: enough of them, and every channel follows the PRT. Raises InputError."""
    prt = frame["prt_degC"].to_numpy()
    notes: list[str] = []
    for name in [f"{c}_degC" for c in CHANNELS]:
        y = frame[name].to_numpy()
        ok = np.isfinite(y) & np.isfinite(prt)
        if ok.sum() < 3 or np.ptp(prt[ok]) < 5.0:
            raise InputError(
                f"column {name}: {int(ok.sum())} rows over {np.ptp(prt[ok]) if ok.any() else 0:.3g} degC",
                where=place.where,
                expected="at least 3 rows over 5 degC or more",
            )
        slope, offset = np.polyfit(prt[ok], y[ok], 1)
        rest = y[ok] - slope * prt[ok] - offset
        _check_follows(name, float(slope), float(offset), float(np.std(rest)), float(np.ptp(prt[ok])), place)
        far = np.abs(y - prt) > 15.0
        if far.any():
            i = int(np.argmax(far))
            notes.append(f"{place.at(name, i)}: {y[i]:.4g} degC where the PRT reads {prt[i]:.4g}")
    return notes


def _check_follows(name: str, slope: float, offset: float, rest: float, span: float, place: Place) -> None:
    looks = ""
    if abs(offset - 273.15) < 25.0 and 0.8 < slope < 1.25:
        looks = "this looks like kelvin"
    elif abs(slope - 1.8) < 0.15 and abs(offset - 32.0) < 15.0:
        looks = "this looks like degrees Fahrenheit"
    elif 0.03 < slope < 0.09 and abs(offset) < 3.0:
        looks = "this looks like millivolts"
    elif rest > 0.15 * span or abs(slope) < 0.3:
        looks = "it does not follow the PRT: a dead channel, or shuffled rows"
    elif not 0.7 < slope < 1.4 or abs(offset) > 25.0:
        looks = "this is no thermocouple in degrees Celsius"
    if looks:
        raise InputError(
            f"column {name}: {slope:.3g} x PRT {offset:+.3g}; {looks}",
            where=place.where,
            expected="degrees Celsius within some degrees of the PRT",
        )


def _speeds(frame: Mapping[str, FloatArray], contact: FloatArray, where: str) -> list[str]:
    speed = {d: float(np.nanmedian(frame[f"speed_{d}_rpm"][contact > 0.5])) for d in DISKS}
    for disk, value in speed.items():
        if not np.isfinite(value) or value <= 0:
            raise InputError(
                f"column speed_{disk}_rpm is {value:.3g} in contact", where=where, expected="rotation in rpm"
            )
    if speed["fast"] < 0.98 * speed["slow"]:
        raise InputError(
            f"column speed_fast_rpm ({speed['fast']:.4g}) is below speed_slow_rpm ({speed['slow']:.4g})",
            where=where,
            expected="the fast disk to turn faster",
            remedy="the columns look swapped",
        )
    if speed["slow"] < 60.0:
        return [f"column speed_slow_rpm: {speed['slow']:.3g} in contact; is it in revolutions per second?"]
    return []


def _bounces(values: FloatArray, name: str, place: Place) -> list[str]:
    edges = np.flatnonzero(np.diff(values) != 0) + 1
    if len(edges) < 3 or place.dt_s is None:
        return []
    close = np.flatnonzero(np.diff(edges) * place.dt_s < BOUNCE_S)
    if len(close) >= 2 or (len(close) == 1 and len(edges) > 2):
        return [f"{place.at(name, int(edges[close[0]]))}: the switch bounces ({len(edges)} changes)"]
    return []
