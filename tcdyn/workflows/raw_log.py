"""A log as raw columns, its channels and the columns of its output.

Any table with sensor files, or a log of the rig with the records of its disks. Used by
``tcdyn.workflows.compensate_table`` and ``tcdyn.workflows.follow``. Guarded by
``tests/sensors/test_sensor_file.py`` and ``tests/smoothing/test_follow.py``.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

from tcdyn.core.arguments import as_names, described
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, info
from tcdyn.io.metadata import COMPENSATED, check_not_compensated
from tcdyn.io.read import Table, display_path
from tcdyn.io.table import CHUNK_ROWS, Columns, SourceFile
from tcdyn.io.times import TIME_COLUMN_NAMES
from tcdyn.rig.columns import TORQUE_COLUMNS, match_columns
from tcdyn.rig.disk import DISKS
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
from tcdyn.sensors.compensation import CompensationMethod, output_header
from tcdyn.sensors.file import SensorFile
from tcdyn.sensors.given import Sensors, sensor_files, with_column
from tcdyn.series import ReadingOptions
from tcdyn.series.joined import open_files
from tcdyn.series.long_tables import check_one_channel
from tcdyn.series.reading import Kind
from tcdyn.series.report import SeriesReport
from tcdyn.series.scaled_readings import RangeCheck
from tcdyn.series.series import Context, reading_rows
from tcdyn.series.source import FilledTimes, Source, selected_rows, source_of_table, time_of_table
from tcdyn.series.survey import Survey
from tcdyn.series.thermocouple_types import convert_columns
from tcdyn.series.units import cold_column
from tcdyn.workflows.options import FrameOptions, LogOptions
from tcdyn.workflows.rig_channels import record_channels

Calibrations = Mapping[str, DiskRecord] | Sequence[SensorFile]
# Options that only the file of a sensor has
OF_SENSORS = ("follows", "follows_u", "accuracy", "means")
# What a caller may give for them.
Given = Mapping[str, DiskRecord] | Sensors


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
    carried: tuple[str, ...]
    notes: dict[str, str]
    findings: tuple[Finding, ...]

    def header(self, method: CompensationMethod) -> list[str]:
        """Columns of the output; see ``tcdyn.sensors.compensation.output_header``."""
        where = display_path(self.source.path)
        return output_header(self.source.table.names, self.channels.units, method, where)


def calibrations_of(given: Given) -> Calibrations:
    """Records by disk as they are, and sensors of any form as sensor files.

    Raises
    ------
    InputError
        As :func:`tcdyn.sensors.given.sensor_files` does.
    """
    if isinstance(given, Mapping) and any(isinstance(each, DiskRecord) for each in given.values()):
        for disk, record in given.items():
            if disk not in DISKS or not isinstance(record, DiskRecord):
                raise InputError(
                    f"the records hold {described(record)} for {disk!r}",
                    expected=f"records by disk, {' and '.join(DISKS)}",
                )
        return cast("Mapping[str, DiskRecord]", given)
    return sensor_files(cast("Sensors", given))


def open_log_table(
    log: str | Path | Sequence[str | Path],
    calibrations: Calibrations,
    rig: Rig | None,
    options: LogOptions,
) -> Table:
    """Open the file or files of a log; the names that it may hold help to find its header.

    Parameters
    ----------
    log
        The file, or several files of one log, see :func:`tcdyn.series.joined.open_files`.
    calibrations, rig, options
        As for ``raw_log``.

    Parameters
    ----------
    path
        The file.
    calibrations, rig, options
        As for ``raw_log``.

    Raises
    ------
    InputError
        For a file that is no table, and files that are not of one log.
    """
    known: tuple[str, ...] = TIME_COLUMN_NAMES
    reading = options.rows
    if isinstance(calibrations, Mapping):
        rig = rig or rig_from_records(calibrations)
        disk = next(iter(calibrations))
        known = (*all_column_names(rig_layouts(rig, disk)), *rig.columns(disk).values())
        if reading == ReadingOptions():
            reading = rig.reading
    return open_files(log, known, reading)


def raw_log(
    path: Path,
    table: Table,
    calibrations: Calibrations,
    rig: Rig | None,
    options: LogOptions,
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
        How the table is read; the options of the rows have precedence over those of the rig.

    Raises
    ------
    InputError
        For a table that is compensated already, and for missing columns.
    """
    check_any_given(calibrations)
    reading = options.rows
    if isinstance(calibrations, Mapping):
        rig = rig or rig_from_records(calibrations)
        if reading != ReadingOptions():
            rig = rig.with_reading(reading)
        check_options_of_sensors(options)
        return _rig_log(path, table, calibrations, rig)
    source = source_of_table(path, table, (), reading)
    return raw_table(source, calibrations, options)


def check_options_of_sensors(options: LogOptions) -> None:
    """Check that a log of the rig has no options of sensor files.

    Raises
    ------
    InputError
        For the first of them.
    """
    for name in OF_SENSORS:
        if name in options.stated:
            raise InputError(
                f"{{{name}}} with records of disks",
                expected="it with the file of a sensor; a record has its own uncertainties",
                parameters={name: None},
            )


def raw_table(source: Source, sensors: Sequence[SensorFile], options: LogOptions) -> RawLog:
    """Any table with sensor files: all its columns, in their units.

    The parameters are those of ``raw_log``; ``source`` is the table with its time column.
    """
    table = source.table
    columns = as_names("columns", options.columns, table.where)
    if not columns:
        sensors = with_column(sensors, source)
    cold = cold_column(options.cold, table.names, table.where)
    value_columns = source.value_columns
    channels, findings = sensor_channels(
        value_columns,
        table.where,
        sensors,
        columns,
        options.units,
        options.couple,
        cold,
        table.units,
    )
    context = replace(
        channels.context,
        time=source.time,
        options=source.options,
        table=table,
        other_times=source.clock.others,
    )
    channels = replace(channels, context=context)
    if isinstance(options, FrameOptions):
        channels = channels.following(
            options.follows, value_columns, options.follows_u, table.units
        )
        channels = channels.with_accuracy(options.accuracy)
    carried = tuple(n for n in value_columns if n not in channels.units)
    without_sensor = [name for name in carried if not table.is_time(name)]
    if without_sensor:
        findings.append(info("sensor.carried", columns=without_sensor))
    return _with_output(source, source.time, source.time, channels, carried, findings)


def survey_of(raw: RawLog) -> Survey:
    """A survey of the channels of a log, without rows yet."""
    channels = raw.channels
    where = channels.context.where
    return Survey(lambda rows: reading_rows(channels.units, rows, where), channels.context)


def checked_before_following(raw: RawLog, table: Table) -> RawLog:
    """Check the rows of a log that may grow, before its first row is compensated.

    Parameters
    ----------
    raw
        The log.
    table
        Its table with the rows that are there.

    Returns
    -------
    raw
        The log, whose units are known to be checked.

    Raises
    ------
    InputError
        For a long table, in which several channels share a column, and for readings that no
        thermocouple can have because they are in another unit.
    """
    channels = raw.channels
    check_one_channel(table, raw.source.time, list(channels.units))
    checks = {name: RangeCheck(name, unit.name) for name, unit in channels.units.items()}
    try:
        for chunk in table.chunks(channels.raw_columns, CHUNK_ROWS):
            for column in reading_rows(channels.units, chunk.data, table.where):
                if column.kind is Kind.TEMPERATURE:
                    checks[column.name].add(column.raw, column.judged)
    except InputError:  # the caller reads the rows as well, and says more or passes over them
        checks = {}
    for check in checks.values():
        check.check(table.where, table)
    context = replace(channels.context, is_surveyed=True, table=None)
    return replace(raw, channels=replace(channels, context=context))


def surveyed(raw: RawLog, table: Table) -> tuple[RawLog, SeriesReport | None]:
    """Look at all rows of a log that is there, so that a decision does not depend on its parts.

    Parameters
    ----------
    raw
        The log.
    table
        Its table with all rows.

    Returns
    -------
    raw
        The log, whose channels know its codes.
    report
        What was understood; None of fewer than two rows.

    Raises
    ------
    InputError
        For a long table, in which several channels share a column; for time that runs backward;
        and for readings that no thermocouple can have because they are in another unit.
    """
    channels = raw.channels
    units = channels.units
    check_one_channel(table, raw.source.time, list(units))
    source = replace(raw.source, table=table)
    look = survey_of(raw)
    names = channels.raw_columns
    for time_s, columns, findings in FilledTimes(source, source.time).read_chunks(names):
        look.add(time_s, {name: columns[name] for name in names}, findings)
    report = look.report()
    context = replace(channels.context, codes=look.codes, is_surveyed=True, table=None)
    has_own_times = report is not None and report.real_share > 0
    findings = (*raw.findings, *channels.without_removed(look.findings, has_own_times))
    channels = replace(channels, context=context)
    return replace(raw, channels=channels, findings=findings), report


def _rig_log(path: Path, table: Table, records: Mapping[str, DiskRecord], rig: Rig) -> RawLog:
    """A log of the rig: its canonical columns, temperatures in degrees Celsius."""
    where = display_path(path)
    check_not_compensated(table.names, table.metadata, where)
    table, row_time = selected_rows(table, rig.reading)
    kind, disk = log_kind(table.names, rig, records, where)
    time = row_time or rig.reading.time
    mapping = {**rig.columns(disk), **({"time_s": time} if time else {})}
    layouts = rig_layouts(rig, disk)
    names = match_columns(
        table.names, kind, where, mapping, replaced=rig.replaced_columns(), layouts=layouts
    )
    conversions = unit_conversions(names, table, rig, disk or "", mapping)
    time_in_log = names["time_s"]
    stamps = ""
    if time_in_log in table.clock_columns:
        stamps = "time_stamp" if time_in_log in names else time_in_log
        names = {"time_s": time_in_log, stamps: time_in_log, **names}
    names = {"friction_N" if n in TORQUE_COLUMNS else n: column for n, column in names.items()}
    canonical = _rename_columns(convert_columns(table, conversions), names, stamps)
    clock = time_of_table(table, replace(rig.reading, time=time_in_log), row_time)
    source = Source(path, canonical, replace(clock, name="time_s"), rig.reading)
    context = Context(where, time_in_log, rig.reading, table=canonical)
    channels, findings = record_channels(records, rig, kind == "ehl", context)
    carried = tuple(n for n in canonical.names if n not in channels.units and n != "time_s")
    return _with_output(source, time_in_log, stamps, channels, carried, findings)


def source_notes(sources: Sequence[SourceFile]) -> dict[str, str]:
    """Metadata of an output that is made from several files: their names, and all about each."""
    content = [source.to_dict() for source in sources]
    return {
        "source": ", ".join(source.file for source in sources),
        "sources": json.dumps(content, ensure_ascii=False),
    }


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
    """Add the notes of the output to an opened log.

    Parameters
    ----------
    source
        The table with its time column.
    time_in_log
        Name of the time column in the log.
    stamps
        Name of the column that keeps its clock stamps; empty: none.
    channels
        Channels that are compensated.
    carried
        Columns that are copied.
    findings
        Findings about the log.
    """
    notes = {**source.table.metadata, "tcdyn": COMPENSATED, "source": source.path.name}
    if source.table.sources:
        notes |= source_notes(source.table.sources)
    for channel in channels.channels:
        lag = channel.lag_s.text("s")
        notes[f"lag_s of {channel.column}"] = f"{lag}, sensor {channel.sensor}"
    notes |= channels.notes
    if channels.mean_s:
        notes["averages_s"] = f"{channels.mean_s:g}"
    return RawLog(source, time_in_log, stamps, channels, carried, notes, tuple(findings))
