"""Log files read, checked and made canonical; a doubt is an error or a warning with file, column, row and time."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from calibration.checks.kind import check_contact, check_loads, check_oven, check_swapped, check_switch, two_level
from calibration.checks.sampling import Sampling, check_time
from calibration.checks.temperature import Place, PlainCheck, TemperatureCheck, check_group, check_temperature
from calibration.checks.thin import thinned
from calibration.columns import KNOWN, LAYOUTS, Kind, match_columns
from calibration.disk import CHANNELS, DISKS
from calibration.errors import InputError
from calibration.files.logwrite import write_log
from calibration.files.table import Columns, Table, open_table, shown
from calibration.files.write import sha256
from calibration.lines.oven import steady_minutes
from calibration.result import Result, jsonable
from calibration.rig import Rig, load_rig

__all__ = ["COMPENSATED", "Log", "read_log", "write_log"]

COMPENSATED = "compensated"
SWITCHES = ("switch", "contact")
ROOM_AND_BATH = ("ambient_degC", "oil_degC", "probe_degC", "fluid_degC")


@dataclass(frozen=True)
class Log(Result):
    """One log: canonical columns (temperatures as logged, before the static lines), and where they come from.

    ``dt_s`` is the sample interval (None for an oven log). Samples that were missing, impossible or spikes are NaN
    in ``frame`` and named in ``warnings``; the time is even.
    """

    frame: pd.DataFrame
    kind: Kind
    path: Path
    sha256: str
    dt_s: float | None
    metadata: dict[str, str] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    @property
    def channels(self) -> tuple[str, ...]:
        """The junctions' columns."""
        skip = {*ROOM_AND_BATH, "prt_degC", "setpoint_degC"}
        return tuple(n for n in self.frame.columns if n.endswith("_degC") and n not in skip)

    def summary(self) -> str:
        """File, kind, length, sampling and warnings."""
        said = f"{self.path.name}: {LAYOUTS[self.kind].name}, {len(self.frame)} rows"
        if self.dt_s is not None:
            said += f" at {1 / self.dt_s:.4g} Hz, {len(self.frame) * self.dt_s:.4g} s"
        return "\n".join([f"{said}, {len(self.channels)} thermocouples", *(f"warning: {w}" for w in self.warnings)])

    def to_dict(self) -> dict[str, Any]:
        """Where the log comes from and the range of every column; the samples are in ``frame``."""
        return {
            "file": self.path.name,
            "sha256": self.sha256,
            "kind": self.kind,
            "rows": len(self.frame),
            "dt_s": self.dt_s,
            "metadata": dict(self.metadata),
            "columns": {row.pop("column"): row for row in jsonable(self.card())},
            "warnings": list(self.warnings),
        }

    def card(self) -> pd.DataFrame:
        """Least, middle and greatest value of every column, and how many are missing."""
        f = self.frame
        table = {"column": f.columns, "min": f.min().to_numpy(), "median": f.median().to_numpy()}
        return pd.DataFrame({**table, "max": f.max().to_numpy(), "missing": f.isna().sum().to_numpy()})

    def filled(self) -> pd.DataFrame:
        """The frame with its few missing samples replaced by straight lines between their neighbours."""
        if not self.frame.isna().to_numpy().any():
            return self.frame
        return self.frame.interpolate(method="linear", limit_direction="both")


def read_log(
    path: str | Path,
    kind: Kind,
    rig: Rig | None = None,
    disk: str | None = None,
    *,
    allow_compensated: bool = False,
) -> Log:
    """Read a log of ``kind`` ("oven", "immersion", "ehl" or "hole") and check it.

    CSV in its dialects, LVM, TDMS and Parquet by ending; column names mapped by ``rig``'s ``[columns]`` (those of
    ``disk`` where given). Row numbers in messages are lines of the file.

    Raises InputError for whatever section 8 of the design calls bad input and cannot be kept with a warning.
    """
    file = Path(path)
    table, chosen = open_log(file, kind, rig, disk, allow_compensated=allow_compensated)
    where = shown(file)
    raw = table.read(list(dict.fromkeys(chosen.values())))
    notes = list(raw.notes)
    columns = {canonical: raw.data[name] for canonical, name in chosen.items()}
    if kind == "oven":
        frame, dt_s = _oven_frame(columns, raw, where, notes), None
    else:
        frame, dt_s = trace_frame(columns, kind, raw, where, notes)
        notes += check_places(frame, kind, rig, disk)
    notes += not_there(columns, kind)
    return Log(frame, kind, file, sha256(file), dt_s, dict(table.metadata), tuple(f"{where}: {n}" for n in notes))


def open_log(
    file: Path, kind: str, rig: Rig | None, disk: str | None, *, allow_compensated: bool = False
) -> tuple[Table, dict[str, str]]:
    """The opened file and canonical name -> name in the file; refuses compensated logs and other kinds."""
    where = shown(file)
    if kind not in LAYOUTS:
        raise InputError(f"{kind!r} is no kind of log", expected=", ".join(LAYOUTS))
    mapping = (rig or load_rig()).columns(disk)
    table = open_table(file, (*KNOWN, *mapping.values()))
    if table.metadata.get("tcdyn") == COMPENSATED and not allow_compensated:
        raise InputError(
            "is compensated already",
            where=where,
            expected="a log as the logger wrote it",
            remedy="give the raw log; static lines and chain must not be applied twice",
        )
    return table, match_columns(table.names, kind, where, mapping)


def trace_frame(
    columns: Mapping[str, np.ndarray], kind: str, raw: Columns, where: str, notes: list[str]
) -> tuple[pd.DataFrame, float]:
    """Check and regularise a trace."""
    time, sampling = check_time(columns["time_s"], raw.rows, where)
    notes.extend(sampling.notes)
    place = Place(where, raw.rows, time, sampling.dt_s)
    checked: dict[str, np.ndarray] = {}
    for name, values in columns.items():
        if name == "time_s":
            continue
        if name in SWITCHES:
            checked[name], said = two_level(values, name, place)
            notes.extend(said)
            continue
        check = column_check(name, thinned(values), place)
        checked[name] = check.clean(values)
        check.see(values, checked[name])
        notes.extend(check.judge())
    for name in SWITCHES:
        if name in checked:
            notes.extend(check_edges(checked[name], name, kind, place))
    notes.extend(check_course(checked, kind, place))
    return even_frame(time, checked, sampling, 0, len(time)), sampling.dt_s


def column_check(name: str, sample: np.ndarray, place: Place) -> TemperatureCheck | PlainCheck:
    """What judges this column of a trace."""
    if name.endswith("_degC"):
        return TemperatureCheck(name, sample, place, junction=name not in ROOM_AND_BATH)
    return PlainCheck(name, place)


def check_edges(values: np.ndarray, name: str, kind: str, place: Place) -> list[str]:
    """Whether a switch (N,) of 0 and 1 moves as this kind of log must have it."""
    if kind == "ehl":
        return check_contact(values, place)
    return check_switch(values, name, place) if name == "switch" else []


def check_course(checked: Mapping[str, np.ndarray], kind: str, place: Place) -> list[str]:
    """What the columns show together, over the whole test (or rows picked from all of it)."""
    notes: list[str] = []
    _check_groups(checked, kind, place, notes)
    return notes + (check_loads(checked, place.where) if kind == "ehl" else [])


def even_frame(
    time: np.ndarray, checked: Mapping[str, np.ndarray], sampling: Sampling, first: int, stop: int
) -> pd.DataFrame:
    """Rows ``first`` to ``stop`` of a trace on the even grid, up to the next row; ``checked`` holds those rows only.

    ``time`` (N,) and ``sampling`` are of the whole trace.
    """
    place = sampling.place[first : stop + 1]
    end = int(place[stop - first]) if stop < len(time) else int(place[-1]) + 1
    if end - place[0] == stop - first:
        return pd.DataFrame({"time_s": time[first:stop].copy(), **checked}, copy=False)
    even = {"time_s": np.interp(np.arange(place[0], end), place, time[first : stop + 1])}
    for name, values in checked.items():
        even[name] = np.full(end - int(place[0]), np.nan)
        even[name][place[: stop - first] - place[0]] = values
        if name in SWITCHES:
            even[name] = np.array(pd.Series(even[name]).ffill(), dtype=np.float64)
    return pd.DataFrame(even)


def _check_groups(checked: Mapping[str, np.ndarray], kind: str, place: Place, notes: list[str]) -> None:
    reference = [float(np.nanmedian(checked[n])) for n in ROOM_AND_BATH if n in checked]
    warmest = max(reference) if reference else None
    if kind == "ehl":
        groups = [{n: v for n, v in checked.items() if n.startswith(f"{d}_")} for d in DISKS]
        room = float(np.nanmedian(checked["ambient_degC"]))
        if room > 120.0:
            raise InputError(
                f"column ambient_degC is about {room:.3g}: no enclosure is that warm; degrees Fahrenheit?",
                where=place.where,
                expected="degrees Celsius",
            )
        warmest = room
    else:
        groups = [{n: v for n, v in checked.items() if n.endswith("_degC") and n not in ROOM_AND_BATH}]
    for group in groups:
        notes.extend(check_group(group, place, warmest))


def not_there(columns: Collection[str], kind: Kind) -> list[str]:
    """Optional columns of a trace that the log has not."""
    wanted = LAYOUTS[kind].optional if kind in ("ehl", "immersion") else ()
    return [f"column {name} is missing" for name in wanted if name not in columns]


def check_places(frame: pd.DataFrame, kind: Kind, rig: Rig | None, disk: str | None) -> list[str]:
    """Channels that look swapped, by the depths of their junctions in ``rig``."""
    used = rig or load_rig()
    notes: list[str] = []
    if kind == "ehl":
        contact = frame["contact"].to_numpy() > 0.5
        first = int(np.argmax(contact))
        late = contact & (np.arange(len(contact)) > first + 0.2 * contact.sum())
        for name in DISKS:
            notes.extend(check_swapped(frame, f"{name}_", _depths(used, name), late))
    elif kind == "immersion":
        mean = frame[[f"{c}_degC" for c in CHANNELS]].mean(axis=1).to_numpy()
        start, end = float(np.nanmean(mean[:30])), float(np.nanmean(mean[-30:]))
        if end - start > 10.0:
            rise = (mean - start) / (end - start)
            notes.extend(check_swapped(frame, "", _depths(used, disk or ""), (rise > 0.05) & (rise < 0.35)))
    return notes


def _depths(rig: Rig, disk: str) -> dict[str, float]:
    junctions = rig.tables(disk).thermocouples
    return {c: junctions[c].depth_mm for c in CHANNELS}


def _oven_frame(columns: dict[str, np.ndarray], raw: Columns, where: str, notes: list[str]) -> pd.DataFrame:
    place = Place(where, raw.rows)
    checked = {}
    for name, values in columns.items():
        if name.endswith("_degC") and name != "setpoint_degC":
            checked[name], said = check_temperature(values, name, place)
            notes.extend(said)
        else:
            checked[name] = values
    empty = ~np.isfinite(checked["prt_degC"])
    if empty.any():
        notes.append(f"{place.at('prt_degC', int(np.argmax(empty)))}: {int(empty.sum())} row(s) without PRT left out")
    for name in (f"{c}_degC" for c in CHANNELS):
        gaps = ~np.isfinite(checked[name]) & ~empty
        if gaps.any():
            notes.append(f"{place.at(name, int(np.argmax(gaps)))}: {int(gaps.sum())} value(s) missing")
    frame = pd.DataFrame(checked)
    if "time_s" in frame and not {"repeat", "setpoint_degC"} & set(frame.columns):
        frame = _steady_rows(frame, place, notes)
        empty = np.zeros(len(frame), dtype=bool)
    notes.extend(check_oven(frame, place))
    frame = frame.loc[~empty].reset_index(drop=True)
    if "setpoint_degC" not in frame:
        frame["setpoint_degC"] = 5.0 * np.rint(frame["prt_degC"] / 5.0)
        notes.append("column setpoint_degC is missing; the PRT to the nearest 5 degC stands in")
    if "repeat" not in frame:
        hold = (frame["setpoint_degC"].diff() != 0).cumsum()
        first = pd.DataFrame({"hold": hold, "at": frame["setpoint_degC"]}).drop_duplicates()
        number = dict(zip(first["hold"], first.groupby("at").cumcount() + 1.0))
        frame["repeat"] = hold.map(number).astype(float)
        notes.append("column repeat is missing; each return to a set point counts as the next repeat")
    return frame[["repeat", "setpoint_degC", "prt_degC", *(f"{c}_degC" for c in CHANNELS)]]


def _steady_rows(frame: pd.DataFrame, place: Place, notes: list[str]) -> pd.DataFrame:
    """Oven rows from a continuous log: the last steady minute of each plateau."""
    time = frame["time_s"].to_numpy()
    with np.errstate(invalid="ignore"):
        bad = ~(np.diff(time) > 0)
    if bad.any():
        i = int(np.argmax(bad)) + 1
        raise InputError(
            f"{place.at('time_s', i)}: time does not rise ({time[i - 1]:.6g} s, then {time[i]:.6g} s)",
            where=place.where,
            expected="time that rises from row to row",
        )
    rows = steady_minutes(frame)
    notes.append(f"a continuous log: {len(rows)} steady minutes were found in {(time[-1] - time[0]) / 3600:.3g} h")
    return rows
