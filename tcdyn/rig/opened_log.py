"""Open the file of a log: match columns to canonical names, convert units, find missing columns.

Also the kind of a log by its columns, and the records that belong to its disks.

Used by :mod:`tcdyn.rig.log` and by the workflows and commands that read a log with records. Tests:
``tests/cli/test_records_and_rig.py`` and ``tests/rig/test_logger_conventions.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, info, warning
from tcdyn.io.metadata import check_not_compensated
from tcdyn.io.read import Part, Table, open_table
from tcdyn.io.times import TimeColumn
from tcdyn.io.unit_names import unit_in, written_unit
from tcdyn.rig.columns import (
    EHL_RUNNING,
    KNOWN_COLUMNS,
    LAYOUTS,
    TORQUE_COLUMNS,
    UNITS,
    Layout,
    find_column,
    in_all_units,
    is_junction_column,
    junction_columns,
    match_columns,
    recognise,
    suggestion,
)
from tcdyn.rig.disk import DISKS
from tcdyn.rig.record import DiskRecord, read_record
from tcdyn.rig.rigfile import Rig, load_rig
from tcdyn.series.joined import files_of_log, open_files
from tcdyn.series.source import Source, selected_rows, time_of_table
from tcdyn.series.thermocouple_types import convert_columns, to_degC


def records_by_disk(paths: Sequence[str | Path]) -> dict[str, DiskRecord]:
    """Read records, keyed by disk.

    Parameters
    ----------
    paths
        Files of the records.

    Returns
    -------
    records
        By name of the disk.

    Raises
    ------
    InputError
        Two records of one disk, or a record of neither disk.
    """
    records: dict[str, DiskRecord] = {}
    for path in paths:
        record = read_record(path)
        if record.disk not in DISKS:
            raise InputError(
                f"the record is of disk {record.disk!r}",
                where=str(path),
                expected="a record of the fast or the slow disk",
            )
        if record.disk in records:
            raise InputError(
                f"a second record of the {record.disk} disk",
                where=str(path),
                remedy="give one of each",
            )
        records[record.disk] = record
    return records


def check_any_given(calibrations: Collection[Any]) -> None:
    """Raise InputError without a record or a sensor."""
    if not calibrations:
        raise InputError(
            "no record was given", remedy="add {records}", parameters={"records": "DISK.disk.json"}
        )


def rig_from_records(records: Mapping[str, DiskRecord]) -> Rig:
    """The rig stored in the records: each disk by its record, the common tables by the first."""
    common = next(iter(records.values())).setup
    setups = {disk: records[disk].setup if disk in records else common for disk in DISKS}
    return Rig(common=common, fast=setups["fast"], slow=setups["slow"])


def rig_layouts(rig: Rig, disk: str | None) -> dict[str, Layout]:
    """The layouts of the logs of a rig; oven and immersion logs are of its ``disk``.

    Parameters
    ----------
    rig
        The rig.
    disk
        Disk of oven and immersion logs; None: the common tables.

    Returns
    -------
    layouts
        By kind of log.
    """
    return {
        kind: layout.with_junctions(rig.junction_columns(kind, disk))
        for kind, layout in LAYOUTS.items()
    }


def all_column_names(layouts: Mapping[str, Layout]) -> tuple[str, ...]:
    """Every canonical column of these logs, temperatures in every unit.

    Parameters
    ----------
    layouts
        Layouts of the logs of a rig.

    Returns
    -------
    names
        Each once.
    """
    names = dict.fromkeys(name for layout in layouts.values() for name in layout.columns)
    return in_all_units(names)


def missing_and_unused(
    kind: str, table: Table, names: Mapping[str, str], without: Collection[str] = ()
) -> list[Finding]:
    """Findings about optional columns that are missing, and about columns of the file not used.

    Parameters
    ----------
    kind
        Kind of log.
    table
        The opened file.
    names
        Canonical name to name in the file, of the columns used.
    without
        Names in the file that the caller left out.
    """
    findings: list[Finding] = []
    if kind in ("ehl", "immersion"):
        for name in LAYOUTS[kind].optional:
            if name in names or name in TORQUE_COLUMNS:
                continue
            if name == "contact":
                findings.append(info("contact.not_logged"))
            else:
                findings.append(warning("column.not_there", subject=name))
    unused = [name for name in table.names if name not in (*names.values(), *without)]
    if unused:
        findings.append(info("columns.unused", names=unused))
    return findings


def open_log(
    file: Path | Sequence[Path],
    kind: str,
    rig: Rig | None,
    disk: str | None,
    *,
    allow_compensated: bool = False,
    without: Collection[str] = (),
) -> tuple[Source, dict[str, str]]:
    """Open the file of a log.

    Parameters
    ----------
    file
        The file, or several files of one log.
    kind
        Kind of log.
    rig
        The rig; None: the default one.
    disk
        Disk whose ``[columns]`` are used; None: the common ones.
    allow_compensated
        Accept a log that was compensated already.
    without
        Columns that are not read.

    Returns
    -------
    source
        The table in canonical units with its time.
    names
        Canonical name to name in the file.

    Raises
    ------
    InputError
        A compensated log, unless allowed, a log of another kind, or missing columns.

    Notes
    -----
    Units are converted here, before any check, so all later limits are in canonical units.
    """
    if kind not in LAYOUTS:
        raise InputError(f"{kind!r} is no kind of log", expected=", ".join(LAYOUTS))
    rig = rig or load_rig()
    mapping = rig.columns(disk)
    air: dict[str, str] = {}
    if kind == "ehl":
        air = {name: column for name, column in rig.air_columns().items() if name not in without}
    layouts = rig_layouts(rig, disk)
    options = rig.reading
    time = {"time_s": options.time} if options.time else {}
    mapping = {**mapping, **time}
    files = files_of_log(file)
    known = (*all_column_names(layouts), *mapping.values(), *air.values())
    table = open_files(files, known, options, allow_compensated=allow_compensated)
    table, row_time = selected_rows(table, options)
    if row_time:
        mapping = {**mapping, "time_s": row_time}
    if not allow_compensated:
        check_not_compensated(table.names, table.metadata, table.where)
    names = match_columns(
        table.names, kind, table.where, mapping, without, rig.replaced_columns(), air, layouts
    )
    conversions = unit_conversions(names, table, rig, disk or "", mapping)
    canonical = {"friction_N" if n in TORQUE_COLUMNS else n: column for n, column in names.items()}
    return Source(
        files[0], convert_columns(table, conversions), _time(table, names, rig, row_time)
    ), canonical


def _time(table: Table, names: Mapping[str, str], rig: Rig, row_time: str) -> TimeColumn:
    """The time column of a log; of one without a time, any column: it is not read."""
    if "time_s" not in names:
        return TimeColumn("", 1.0, True, "s", table.where)
    options = replace(rig.reading, time=names["time_s"])
    return time_of_table(table, options, row_time)


def column_names(
    file: str | Path | Sequence[str | Path], rig: Rig, disk: str | None = None
) -> tuple[str, ...]:
    """The columns in the file of a log.

    Parameters
    ----------
    file
        The file; of several files the first one.
    rig
        The rig, whose columns help to find the header.
    disk
        Disk of an immersion log.
    """
    mapping = {**rig.columns(), **rig.air_columns(), **rig.columns(disk)}
    known = (*all_column_names(rig_layouts(rig, disk)), *mapping.values())
    part = Part(rig.reading.sheet, rig.reading.variable)
    return open_table(files_of_log(file)[0], known, part).names


def missing_columns(
    names: Collection[str], rig: Rig, wanted: Iterable[str], alike: bool = False
) -> list[str]:
    """The ``wanted`` columns that an EHL log does not hold.

    Parameters
    ----------
    names
        Names in the file.
    rig
        The rig.
    wanted
        Canonical names.
    alike
        Do not list columns with a similar name in the file.
    """
    mapping = {**rig.columns(), **rig.air_columns()}
    missing = [c for c in wanted if find_column(c, mapping, names) is None]
    if not alike:
        return missing
    unknown = [name for name in names if name not in KNOWN_COLUMNS]
    return [c for c in missing if suggestion(c, unknown) is None]


def columns_to_skip(
    names: Collection[str], rig: Rig, records: Mapping[str, DiskRecord]
) -> tuple[list[str], list[str]]:
    """Missing columns of an EHL log that are not needed.

    Parameters
    ----------
    names
        Names in the file.
    rig
        The rig.
    records
        Records by disk.

    Returns
    -------
    All of them: of a disk without a record, and those that only the fit of the unloading would use;
    and the latter alone.

    Notes
    -----
    A column with a similar name in the file is not skipped: the reader then reports it as misnamed.
    """
    junctions: list[str] = []
    for disk in DISKS:
        if disk in records:
            continue
        columns = junction_columns(rig.disk_setup(disk).channels, disk)
        if len(missing_columns(names, rig, columns)) == len(columns):
            junctions += columns
    running = missing_columns(
        names, rig, [*EHL_RUNNING, *TORQUE_COLUMNS, "ambient_degC", *rig.air_columns()]
    )
    has_torque = not set(TORQUE_COLUMNS) <= set(running)
    needless = {"contact", *TORQUE_COLUMNS, *rig.replaced_columns()}
    if has_torque:
        needless.add("friction_N")
    candidates = [c for c in running if c not in needless]
    unused = missing_columns(names, rig, candidates, alike=True)
    return [*junctions, *unused], unused


def check_records_used(
    names: Collection[str], rig: Rig, records: Mapping[str, DiskRecord], where: str
) -> None:
    """Raise InputError for the record of a disk of which an EHL log holds no column.

    Parameters
    ----------
    names
        Names in the file.
    rig
        The rig.
    records
        Records by disk.
    where
        Name of the file, for messages.
    """
    without_columns: list[str] = []
    for disk in records:
        columns = [*junction_columns(rig.disk_setup(disk).channels, disk)]
        if missing_columns(names, rig, columns) == columns:
            without_columns.append(disk)
    if len(without_columns) == len(records):
        return
    for disk in without_columns:
        raise InputError(
            f"holds no column of the {disk} disk, whose record was given",
            where=where,
            remedy=f"leave out the {disk} disk's record, or map columns",
        )


def unit_conversions(
    names: Mapping[str, str], table: Table, rig: Rig, disk: str, mapping: Mapping[str, str]
) -> dict[str, Callable[[Array], Array]]:
    """Conversions to canonical units, by the names of the columns in the ``file``.

    A temperature is converted from K, degF or mV; a torque is divided by the radius of the disk on
    its shaft.

    Parameters
    ----------
    names
        Canonical name to name in the file.
    table
        The table.
    rig
        The rig.
    disk
        Disk of a log of one disk; empty: none.
    mapping
        ``[columns]`` of the rig file.

    Returns
    -------
    conversions
        Functions of an array, by name in the file.
    """
    conversions: dict[str, Callable[[Array], Array]] = {}
    for name, column in names.items():
        of_disk = next((d for d in DISKS if name.startswith(f"{d}_")), disk)
        logger = rig.tables(of_disk).logger
        match = find_column(name, mapping, table.names)
        in_file = unit_in(column) or written_unit(table.units.get(column, ""))
        unit = match[1] if match else column.rpartition("_")[2]
        unit = in_file or unit
        if logger.millivolts and is_junction_column(name):
            unit = "mV"
        if name.endswith("_degC") and unit in UNITS:
            conversions[column] = to_degC(unit, logger.couple, logger.cold_junction_degC)
        if name in TORQUE_COLUMNS:
            radius_m = 1e-3 * rig.tables(name.split("_")[1]).disk.outer_radius_mm
            conversions[column] = partial(np.multiply, 1 / radius_m)
    return conversions


def log_kind(
    names: Collection[str], rig: Rig, records: Mapping[str, DiskRecord], where: str
) -> tuple[Literal["ehl", "immersion"], str | None]:
    """Whether a log is an EHL or an immersion log, and for the latter the disk that was plunged.

    Parameters
    ----------
    names
        Names in the file.
    rig
        The rig.
    records
        Records by disk.
    where
        Name of the file, for messages.

    Returns
    -------
    kind
        "ehl" or "immersion".
    disk
        The disk that was plunged; None for an EHL log.

    Raises
    ------
    InputError
        Several records for an immersion log. The reader refuses other kinds of log.
    """
    disk = next(iter(records))
    layouts = rig_layouts(rig, disk)
    canonical = {c for layout in layouts.values() for c in layout.columns}
    mapped = {c for c in canonical if find_column(c, rig.columns(disk), names)}
    if recognise({*names, *mapped}, layouts) != "immersion":
        return "ehl", None
    if len(records) > 1:
        raise InputError(
            f"is an immersion log of one disk, and records of {len(records)} disks were given",
            where=where,
            remedy="give the record of the disk that was plunged",
        )
    return "immersion", disk
