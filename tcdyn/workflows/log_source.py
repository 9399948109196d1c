"""A growing log of the rig or any growing table: its junction columns and their calibration.

Used by :mod:`tcdyn.workflows.follow`. The two kinds of log correspond to
:mod:`tcdyn.workflows.compensate` and :mod:`tcdyn.workflows.compensate_table`. Guarded by
``tests/smoothing/test_follow.py`` and ``tests/smoothing/test_follow_invalid.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypedDict

import numpy as np

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding
from tcdyn.io.checksum import ALTERED_CODE
from tcdyn.io.csv_dialect import is_number
from tcdyn.io.growing import GrowingTable, open_growing
from tcdyn.io.metadata import check_not_compensated
from tcdyn.io.read import display_path
from tcdyn.io.times import TIME_COLUMN_NAMES, find_time_column
from tcdyn.rig.columns import KNOWN_COLUMNS, TORQUE_COLUMNS, match_columns
from tcdyn.rig.opened_log import (
    all_column_names,
    log_kind_of_columns,
    rig_layouts,
    unit_conversions,
)
from tcdyn.rig.record import DiskRecord
from tcdyn.rig.rigfile import Rig
from tcdyn.rig.static_line import StaticLine
from tcdyn.sensors.file import SensorFile
from tcdyn.sensors.units import Unit, cold_column, uncertainty_column
from tcdyn.smoothing.traces import DiskChannels, disk_channels
from tcdyn.workflows.compensate_table import sensor_columns

# process-noise intensity [K2/s3] by kind of log
INTENSITY_K2_S3 = {
    "ehl": 30.0,
    "immersion": 3000.0,
}  # an unloading changes the slope by 10 K/s in a second, a plunge by 100 K/s
# static line of a sensor without one: readings as they are, without uncertainty
IDENTITY_LINE = StaticLine(
    gain=1.0, offset=0.0, covariance=((0.0, 0.0), (0.0, 0.0)), range_degC=(-273.15, 5000.0)
)
# records by disk, or sensors with their columns
Calibrations = Mapping[str, DiskRecord] | Sequence[SensorFile]


@dataclass(frozen=True)
class GrowingLog:
    """A growing log: its columns by their standard names, and how its junctions are measured.

    Attributes
    ----------
    table, column_indices
        The growing table, and the field index of each column by its standard name.
    channels
        Junctions with static lines, chains and uncertainties, by disk.
    level_K2_s3
        Process-noise intensity for a log of this kind; None where it is unknown.
    conversions
        Conversions of columns in another unit to seconds and degrees Celsius.
    units
        Units of the columns that the output has in their own unit.
    findings
        Findings about records and units.
    """

    table: GrowingTable
    column_indices: dict[str, int]
    channels: list[DiskChannels]
    level_K2_s3: float | None
    conversions: Mapping[str, Callable[[Array], Array]] = field(default_factory=dict)
    units: Mapping[str, Unit] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()

    def new_rows(self) -> list[list[float]] | None:
        """New rows in the order of ``column_indices`` [s, degC]; None without a complete line.

        An infinite number is NaN, except in a junction column: there it is an emf outside the range
        of the thermocouple type, and is counted as impossible later.
        """
        names = list(self.column_indices)
        read_rows = self.table.new_rows(list(self.column_indices.values()))
        if not read_rows or not (self.conversions or self.units):
            return read_rows
        rows = np.array(read_rows)
        converted = rows.copy()
        for name, convert in self.conversions.items():
            converted[:, names.index(name)] = convert(rows[:, names.index(name)])
        for name, unit in self.units.items():
            cold = (
                rows[:, names.index(unit.reference_junction)]
                if isinstance(unit.reference_junction, str)
                else unit.reference_junction
            )
            converted[:, names.index(name)] = unit.in_degC(rows[:, names.index(name)], cold)
        # An infinite temperature of a channel (no such emf of the couple) stays: it is counted as impossible later.
        infinite = np.isinf(converted)
        infinite[
            :, [names.index(name) for channels in self.channels for name in channels.columns]
        ] = False
        return [list(map(float, row)) for row in np.where(infinite, np.nan, converted)]

    def in_table_units(self, rows: Array, names: Sequence[str]) -> Array:
        """The output in the units of the table.

        Parameters
        ----------
        rows
            Rows (k, columns) in degrees Celsius and kelvin.
        names
            Names of the columns of the output.
        """
        out = np.array(rows)
        for name, unit in self.units.items():
            at = names.index(name)
            u_at = names.index(uncertainty_column(name))
            out[:, at], out[:, u_at] = unit.from_degC(rows[:, at]), unit.per_K * rows[:, u_at]
        return out

    def output_names(self, names: Sequence[str]) -> list[str]:
        """Column names of the output, with the units of the table (mV: degrees Celsius)."""
        own_names = {uncertainty_column(n): unit.names(n)[1] for n, unit in self.units.items()}
        own_names |= {n: unit.names(n)[0] for n, unit in self.units.items()}
        return [own_names.get(n, n) for n in names]


class TableOptions(TypedDict, total=False):
    """How a table is read where its names do not say it; keys as for ``compensate_table``."""

    time: str | None
    time_unit: str | None
    unit: Mapping[str, str] | str
    couple: str
    cold: float | str


def growing_log(
    log: Path, rig: Rig | None, records: Calibrations, options: TableOptions | None = None
) -> GrowingLog | None:
    """Open a growing log once it has two complete rows.

    Parameters
    ----------
    log
        The log.
    rig
        The rig; None for a table of sensors.
    records
        Records by disk, or sensors.
    options
        How to read a table of sensors.

    Returns
    -------
    GrowingLog or None
        None as long as the log is too short.

    Raises
    ------
    InputError
        For a log that is compensated already, missing columns, or a time that is no number.
    """
    wanted = (*KNOWN_COLUMNS, *TIME_COLUMN_NAMES)
    if rig and isinstance(records, Mapping):
        disk = next(iter(records))
        wanted = (*all_column_names(rig_layouts(rig, disk)), *rig.columns(disk).values())
    growing = open_growing(log, wanted)
    if growing is None:
        return None
    where = display_path(log)
    table = growing.table
    check_not_compensated(table.names, table.metadata, where)
    if rig is None or not isinstance(records, Mapping):
        return _table_source(growing, records, where, options or {})  # type: ignore[arg-type]
    altered = tuple(
        f for record in records.values() for f in record.findings if f.code == ALTERED_CODE
    )
    kind, own_disk = log_kind_of_columns(table.names, rig, records, where)
    mapping = rig.columns(own_disk)
    chosen = match_columns(
        table.names,
        kind,
        where,
        mapping,
        replaced=rig.replaced_columns(),
        layouts=rig_layouts(rig, own_disk),
    )
    conversions = unit_conversions(chosen, table.names, rig, own_disk or "", mapping)
    converted = {
        name: conversions[column]
        for name, column in chosen.items()
        if column in conversions and name not in TORQUE_COLUMNS
    }
    places = {canonical: table.names.index(name) for canonical, name in chosen.items()}
    if not is_number(table.dialect.first_row[places["time_s"]], table.dialect.decimal):
        raise InputError(
            f"column {chosen['time_s']} holds no seconds", where=where, expected="time as a number"
        )
    channels = [
        disk_channels(r, rig.disk_setup(d), d if kind == "ehl" else "") for d, r in records.items()
    ]
    return GrowingLog(growing, places, channels, INTENSITY_K2_S3[kind], converted, findings=altered)


def _table_source(
    growing: GrowingTable, sensors: Sequence[SensorFile], where: str, options: TableOptions
) -> GrowingLog:
    """A growing table of sensors: all its columns, time in seconds, sensor columns in their units.

    Parameters
    ----------
    growing
        The table.
    sensors
        The sensors.
    where
        The file, for messages.
    options
        How to read the table.

    Raises
    ------
    InputError
        If the time is no number or its unit is not known, or a column does not fit the sensors.

    Notes
    -----
    The lags of different columns are taken as independent here: only the diagonal of the covariance
    is used.
    """
    names = growing.table.names
    dialect = growing.table.dialect
    units = growing.table.units
    clock = find_time_column(
        names, where, requested=options.get("time"), unit=options.get("time_unit"), unit_row=units
    )
    time = clock.name
    if not is_number(dialect.first_row[names.index(time)], dialect.decimal):
        raise InputError(f"column {time} holds no time", where=where, expected="time as a number")
    if time != "time_s" and "time_s" in names:
        raise InputError(
            f"column 'time_s' is given in addition to the clock {time!r}",
            where=where,
            remedy="rename it",
        )
    indices = {"time_s" if n == time else n: i for i, n in enumerate(names)}
    cold = cold_column(options.get("cold", 0.0), names, where)
    unit = options.get("unit", "")
    couple = options.get("couple", "")
    sensor_cols, findings = sensor_columns(
        [n for n in names if n != time], where, sensors, (), unit, couple, cold, units
    )
    channels = DiskChannels(
        tuple(w.column for w in sensor_cols),
        tuple(w.line or IDENTITY_LINE for w in sensor_cols),
        tuple(w.chain for w in sensor_cols),
        np.diag([w.file.lag_covariance_s2[w.index, w.index] for w in sensor_cols]),
        np.array([w.file.split_u_s[w.index] for w in sensor_cols]),
    )
    clock.check_step(clock.in_seconds(growing.first_numbers(names.index(time)), False), False)
    scale = float(clock.seconds or 1.0)
    conversions: dict[str, Callable[[Array], Array]] = (
        {} if scale == 1.0 else {"time_s": lambda t: t * scale}
    )
    units_in_table = {w.column: w.unit for w in sensor_cols if w.unit.name != "degC"}
    return GrowingLog(
        growing, indices, [channels], None, conversions, units_in_table, tuple(findings)
    )
