"""A log that grows, of the rig or any table: which columns are junctions, and how each is measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calibration.columns import KNOWN, TORQUES, match_columns
from calibration.errors import InputError
from calibration.files import shown
from calibration.files.dialect import is_number
from calibration.files.growing import GrowingTable, open_growing
from calibration.lines.static import StaticLine
from calibration.opened import COMPENSATED, as_logged, kind_of_columns, known_names, layouts_of
from calibration.record import DiskRecord
from calibration.rig import Rig
from tcdyn.sensor.file import SensorFile
from tcdyn.sensor.table import TIMES
from tcdyn.sensor.units import matching, time_column, unit_in
from tcdyn.traces import DiskChannels, disk_channels

INTENSITY_K2_S3 = {"ehl": 30.0, "immersion": 3000.0}  # an unloading bends by 10 K/s in a second, a plunge by 100 K/s
AS_READ = StaticLine(gain=1.0, offset=0.0, covariance=((0.0, 0.0), (0.0, 0.0)), range_degC=(-273.15, 5000.0))
Known = Mapping[str, DiskRecord] | Sequence[SensorFile]


@dataclass(frozen=True)
class GrowingLog:
    """The growing log, which field of a row is which canonical column, and how junctions are measured.

    ``level_K2_s3``: how suddenly slopes may change in a log of this kind, None where nobody knows.
    """

    table: GrowingTable
    places: dict[str, int]
    channels: list[DiskChannels]
    level_K2_s3: float | None


def growing_log(log: Path, rig: Rig | None, records: Known) -> GrowingLog | None:
    """The log once two whole rows stand in it; InputError for one that is compensated, and for missing columns."""
    wanted = (*KNOWN, *TIMES)
    if rig and isinstance(records, Mapping):
        disk = next(iter(records))
        wanted = (*known_names(layouts_of(rig, disk)), *rig.columns(disk).values())
    growing = open_growing(log, wanted)
    if growing is None:
        return None
    where, table = shown(log), growing.table
    if table.metadata.get("tcdyn") == COMPENSATED:
        raise InputError(
            "is compensated already",
            where=where,
            expected="a log as the logger wrote it",
            remedy="give the raw log; static lines and chain must not be applied twice",
        )
    if rig is None or not isinstance(records, Mapping):
        return _table_source(growing, records, where)  # type: ignore[arg-type]
    kind, own = kind_of_columns(table.names, rig, records, where)
    mapping = rig.columns(own)
    chosen = match_columns(table.names, kind, where, mapping, stated=rig.stated(), layouts=layouts_of(rig, own))
    how = as_logged(chosen, table.names, rig, own or "", mapping)
    if other := [column for name, column in chosen.items() if column in how and name not in TORQUES]:
        raise InputError(f"column {other[0]!r} is in another unit", where=where, expected="degrees Celsius to follow")
    places = {canonical: table.names.index(name) for canonical, name in chosen.items()}
    if not is_number(table.dialect.first_row[places["time_s"]], table.dialect.decimal):
        raise InputError(f"column {chosen['time_s']} holds no seconds", where=where, expected="time as a number")
    return GrowingLog(growing, places, channels_of(kind, records, rig), INTENSITY_K2_S3[kind])


def _table_source(growing: GrowingTable, sensors: Sequence[SensorFile], where: str) -> GrowingLog:
    """Any table that grows: all its columns, the time called time_s, those that sensors cover in their own units."""
    names, dialect = growing.table.names, growing.table.dialect
    time, scale = time_column(names, None, where)
    if scale != 1.0 or not is_number(dialect.first_row[names.index(time)], dialect.decimal):
        raise InputError(f"column {time} holds no seconds", where=where, expected="time as a number of seconds")
    channels = channels_of("table", sensors, None, where, [n for n in names if n != time])
    covered = channels[0].columns
    for name in covered:
        if covered.count(name) > 1 or unit_in(name) == "mV":
            what = "has two sensors" if covered.count(name) > 1 else "is in millivolts"
            raise InputError(
                f"column {name!r} {what}", where=where, expected="one sensor, and a temperature, to follow"
            )
    return GrowingLog(growing, {"time_s" if n == time else n: i for i, n in enumerate(names)}, channels, None)


def channels_of(
    kind: str, known: Known, rig: Rig | None, where: str = "", names: Sequence[str] = ()
) -> list[DiskChannels]:
    """How each disk with a record is read in a log of this kind, or what ``names`` of a table sensors cover."""
    if not isinstance(known, Mapping):
        found = [(n, s, i) for s in known for i, c in enumerate(s.columns) for n in matching(c, names, where)]
        worn = [s.chains[i] for _, s, i in found]
        lines = [s.static.get(s.columns[i], AS_READ) for _, s, i in found]
        variances = [s.lag_covariance_s2[i, i] for _, s, i in found]
        split = np.array([s.split_u_s[i] for _, s, i in found])
        return [DiskChannels(tuple(n for n, _, _ in found), tuple(lines), tuple(worn), np.diag(variances), split)]
    assert rig is not None
    records = known
    return [
        disk_channels(record, rig.disk_setup(disk), disk if kind == "ehl" else "") for disk, record in records.items()
    ]
