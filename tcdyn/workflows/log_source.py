"""A log as raw columns, its channels and the columns of its output.

Any table with sensor files, or a log of the rig with the records of its disks. Used by
``tcdyn.workflows.compensate_table`` and ``tcdyn.workflows.follow``. Guarded by
``tests/sensors/test_sensor_file.py`` and ``tests/smoothing/test_follow.py``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypedDict

from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, info
from tcdyn.io.metadata import COMPENSATED, check_not_compensated
from tcdyn.io.read import Table, display_path, open_table
from tcdyn.io.table import CHUNK_ROWS, Columns
from tcdyn.io.times import TIME_COLUMN_NAMES, TimeColumn
from tcdyn.rig.columns import TORQUE_COLUMNS, match_columns
from tcdyn.rig.opened_log import (
    all_column_names,
    check_any_given,
    log_kind,
    rig_from_records,
    rig_layouts,
    unit_conversions,
)
from tcdyn.rig.record import DiskRecord
from tcdyn.rig.rigfile import Rig
from tcdyn.sensors.channels import TableChannels, sensor_channels
from tcdyn.sensors.file import SensorFile
from tcdyn.sensors.table import Source, source_of_table
from tcdyn.series.long_tables import check_one_channel
from tcdyn.series.scaled_readings import RangeCheck
from tcdyn.series.thermocouple_types import convert_columns
from tcdyn.series.units import cold_column
from tcdyn.workflows.rig_channels import record_channels

Calibrations = Mapping[str, DiskRecord] | Sequence[SensorFile]


class TableOptions(TypedDict, total=False):
    """How any table is read where its names do not state it.

    Attributes
    ----------
    columns
        Columns that a single sensor covers, instead of those in its file.
    time
        The time column, where its name does not say so.
    time_unit
        Its unit (s, ms, us, ns, min, h or days), where neither its name nor a row of units says so.
    unit
        "degC", "K", "degF", "mV" or that of another quantity ("ppm", "%RH", "Pa", "V") for all
        columns, or by column; otherwise as the names or a row of units say.
    couple, cold
        Of millivolts: the thermocouple's type ("none" if it is another voltage), and the reference
        junction [degC] or its column.
    """

    columns: Sequence[str]
    time: str | None
    time_unit: str | None
    unit: Mapping[str, str] | str
    couple: str
    cold: float | str


@dataclass(frozen=True)
class RawLog:
    """A log as raw columns.

    Attributes
    ----------
    source
        The columns and the time.
    time_in_log
        Name of the time column in the file.
    stamps
        Column of the source with the time as in the file; empty where the time is numbers under
        another name.
    channels
        The columns that are compensated.
    header
        Columns of the output.
    carried
        Columns that pass through.
    notes
        Metadata of the output.
    findings
        Findings.
    """

    source: Source
    time_in_log: str
    stamps: str
    channels: TableChannels
    header: tuple[str, ...]
    carried: tuple[str, ...]
    notes: dict[str, str]
    findings: tuple[Finding, ...]


def open_log_table(path: Path, calibrations: Calibrations, rig: Rig | None) -> Table:
    """Open the file of a log; the names that it may hold help to find its header.

    Raises
    ------
    InputError
        For a file that is no table.
    """
    known: tuple[str, ...] = TIME_COLUMN_NAMES
    if isinstance(calibrations, Mapping):
        rig = rig or rig_from_records(calibrations)
        disk = next(iter(calibrations))
        known = (*all_column_names(rig_layouts(rig, disk)), *rig.columns(disk).values())
    return open_table(path, known)


def raw_log(
    path: Path,
    table: Table,
    calibrations: Calibrations,
    rig: Rig | None,
    options: TableOptions,
) -> RawLog:
    """The raw columns, channels and output of an open table.

    Parameters
    ----------
    path, table
        The file, and the table that it holds.
    calibrations
        Sensor files for any table; records by disk for a log of the rig.
    rig
        The rig; None: that of the records.
    options
        How the table is read.

    Raises
    ------
    InputError
        For a table that is compensated already, and for missing columns.
    """
    check_any_given(calibrations)
    if isinstance(calibrations, Mapping):
        return _rig_log(path, table, calibrations, rig or rig_from_records(calibrations))
    source = source_of_table(path, table, options.get("time"), options.get("time_unit"))
    return raw_table(source, calibrations, options)


def raw_table(source: Source, sensors: Sequence[SensorFile], options: TableOptions) -> RawLog:
    """Any table with sensor files: all its columns, in their units.

    The parameters are those of ``raw_log``; ``source`` is the table with its time column.
    """
    table = source.table
    cold = cold_column(options.get("cold", 0.0), table.names, table.where)
    value_columns = [n for n in table.names if n != source.time]
    channels, findings = sensor_channels(
        value_columns,
        table.where,
        sensors,
        options.get("columns", ()),
        options.get("unit", ""),
        options.get("couple", ""),
        cold,
        table.units,
    )
    carried = tuple(n for n in value_columns if n not in channels.units)
    without_sensor = [name for name in carried if not table.is_time(name)]
    if without_sensor:
        findings.append(info("sensor.carried", columns=without_sensor))
    return _with_output(source, source.time, source.time, channels, carried, findings)


def check_readings(table: Table, raw: RawLog) -> None:
    """Check that the columns of a log are the readings of one channel each, in a known unit.

    Parameters
    ----------
    table
        The table with the rows that are there.
    raw
        Its columns and channels.

    Raises
    ------
    InputError
        For a long table, in which several channels share a column, and for readings that no
        thermocouple can have because they are in another unit.
    """
    units = raw.channels.units
    check_one_channel(table, raw.source.time, list(units))
    references = [u.reference_junction for u in units.values()]
    names = [*units, *(name for name in references if isinstance(name, str))]
    checks = {
        name: RangeCheck(name, unit.name) for name, unit in units.items() if unit.is_temperature
    }
    try:
        for chunk in table.chunks(names, CHUNK_ROWS):
            for name in checks:
                unit = units[name]
                junction = unit.reference_junction
                cold = chunk.data[junction] if isinstance(junction, str) else junction
                values = chunk.data[name]
                checks[name].add(values, unit.to_base(values, cold))
    except InputError:  # the caller reads the rows as well, and says more or passes over them
        return
    for check in checks.values():
        check.check(table.where, table)


def _rig_log(path: Path, table: Table, records: Mapping[str, DiskRecord], rig: Rig) -> RawLog:
    """A log of the rig: its canonical columns, temperatures in degrees Celsius."""
    where = display_path(path)
    check_not_compensated(table.names, table.metadata, where)
    kind, disk = log_kind(table.names, rig, records, where)
    mapping = rig.columns(disk)
    layouts = rig_layouts(rig, disk)
    names = match_columns(
        table.names, kind, where, mapping, replaced=rig.replaced_columns(), layouts=layouts
    )
    conversions = unit_conversions(names, table.names, rig, disk or "", mapping)
    time_in_log = names["time_s"]
    stamps = ""
    if time_in_log in table.clock_columns:
        stamps = "time_stamp" if time_in_log in names else time_in_log
        names = {"time_s": time_in_log, stamps: time_in_log, **names}
    names = {"friction_N" if n in TORQUE_COLUMNS else n: column for n, column in names.items()}
    canonical = _rename_columns(convert_columns(table, conversions), names, stamps)
    source = Source(path, canonical, TimeColumn("time_s", 1.0, True, "s", where))
    channels, findings = record_channels(records, rig, kind == "ehl", where)
    carried = tuple(n for n in canonical.names if n not in channels.units and n != "time_s")
    return _with_output(source, time_in_log, stamps, channels, carried, findings)


def _rename_columns(table: Table, names: Mapping[str, str], stamps: str) -> Table:
    """Select and rename columns of a table; clock stamps become seconds.

    Parameters
    ----------
    table
        The table.
    names
        Name in the table by new name. One column may have several new names.
    stamps
        New name of the one column that keeps its stamps; empty: none.
    """

    def chunks(requested: Sequence[str], rows: int = CHUNK_ROWS) -> Iterator[Columns]:
        """Yield chunks of the table with its columns under their new names."""
        in_table = {name: names.get(name, name) for name in requested}
        for chunk in table.chunks(list(dict.fromkeys(in_table.values())), rows):
            data = {name: chunk.data[old] for name, old in in_table.items()}
            cells = {}
            if stamps in requested and names[stamps] in chunk.stamps:
                cells[stamps] = chunk.stamps[names[stamps]]
            yield replace(chunk, data=data, stamps=cells)

    return replace(table, names=tuple(names), chunks=chunks)


def _with_output(
    source: Source,
    time_in_log: str,
    stamps: str,
    channels: TableChannels,
    carried: tuple[str, ...],
    findings: list[Finding],
) -> RawLog:
    """Add header and notes of the output to an opened log.

    Parameters
    ----------
    source
        The table with its time column.
    time_in_log
        Name of the time column in the log.
    stamps
        Name of the column that keeps its clock stamps; empty: none.
    channels
        Channels that are compensated. Each result stands in the column of its channel, the
        uncertainties are at the end.
    carried
        Columns that are copied.
    findings
        Findings about the log.

    Raises
    ------
    InputError
        If two columns of the output would have one name.
    """
    table = source.table
    output_names = {column: unit.names(column) for column, unit in channels.units.items()}
    header = [output_names[n][0] if n in output_names else n for n in table.names]
    header += [output_names[n][1] for n in table.names if n in output_names]
    duplicates = [n for n in header if header.count(n) > 1]
    if duplicates:
        raise InputError(
            f"the output would hold column {duplicates[0]!r} twice",
            where=display_path(source.path),
            remedy="rename it",
        )
    notes = {**table.metadata, "tcdyn": COMPENSATED, "source": source.path.name}
    for channel in channels.channels:
        lag = channel.lag_s.text("s")
        notes[f"lag_s of {channel.column}"] = f"{lag}, sensor {channel.sensor}"
    return RawLog(
        source, time_in_log, stamps, channels, tuple(header), carried, notes, tuple(findings)
    )
