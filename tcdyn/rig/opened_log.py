"""A log's file and its disks' records: which of its columns is which, in canonical units, what is not there or not
used."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, info, warning
from tcdyn.io.read import Table, open_table, shown
from tcdyn.rig.columns import (
    EHL_RUNNING,
    KNOWN,
    LAYOUTS,
    TORQUES,
    UNITS,
    Layout,
    couples,
    in_other_units,
    is_couple,
    match_columns,
    named,
    recognise,
    suggestion,
)
from tcdyn.rig.disk import DISKS
from tcdyn.rig.record import DiskRecord, read_record
from tcdyn.rig.rigfile import Rig, load_rig
from tcdyn.rig.thermocouple_types import converted, to_degC

COMPENSATED = "compensated"


def records_by_disk(paths: Sequence[str | Path]) -> dict[str, DiskRecord]:
    """Read records and key them by disk; two of one disk, or one of neither, is an error."""
    out: dict[str, DiskRecord] = {}
    for path in paths:
        record = read_record(path)
        if record.disk not in DISKS:
            raise InputError(
                f"the record is of disk {record.disk!r}",
                where=str(path),
                expected="a record of the fast or the slow disk",
            )
        if record.disk in out:
            raise InputError(
                f"a second record of the {record.disk} disk",
                where=str(path),
                remedy="give one of each",
            )
        out[record.disk] = record
    return out


def rig_of(records: Mapping[str, DiskRecord]) -> Rig:
    """The rig as the records remember it: each disk its own tables, what is common from the first record given."""
    common = next(iter(records.values())).setup
    own = {d: records[d].setup if d in records else common for d in DISKS}
    return Rig(common=common, fast=own["fast"], slow=own["slow"])


def layouts_of(rig: Rig, disk: str | None) -> dict[str, Layout]:
    """The logs of a rig, those of an oven or a bath of its ``disk``."""
    return {kind: layout.holding(rig.couples(kind, disk)) for kind, layout in LAYOUTS.items()}


def known_names(layouts: Mapping[str, Layout]) -> tuple[str, ...]:
    """Every canonical column of these logs, temperatures in every unit."""
    return in_other_units(
        dict.fromkeys(name for layout in layouts.values() for name in layout.columns)
    )


def missing_and_unused(
    kind: str, table: Table, names: Mapping[str, str], without: Collection[str] = ()
) -> list[Finding]:
    """Columns that might be there and are not, and those of the file that nobody asked for or left out."""
    asked = [
        n
        for n in LAYOUTS[kind].optional
        if n not in (*names, *TORQUES) and kind in ("ehl", "immersion")
    ]
    found = [
        info("contact.not_logged") if n == "contact" else warning("column.not_there", subject=n)
        for n in asked
    ]
    if unused := [n for n in table.names if n not in (*names.values(), *without)]:
        found.append(info("columns.unused", names=unused))
    return found


def open_log(
    file: Path,
    kind: str,
    rig: Rig | None,
    disk: str | None,
    *,
    allow_compensated: bool = False,
    without: Collection[str] = (),
) -> tuple[Table, dict[str, str]]:
    """The opened file and canonical name -> name in the file; refuses compensated logs and other kinds."""
    if kind not in LAYOUTS:
        raise InputError(f"{kind!r} is no kind of log", expected=", ".join(LAYOUTS))
    used = rig or load_rig()
    mapping = used.columns(disk)
    air = used.air_columns() if kind == "ehl" else {}
    air = {name: column for name, column in air.items() if name not in without}
    layouts = layouts_of(used, disk)
    table = open_table(file, (*known_names(layouts), *mapping.values(), *air.values()))
    if table.metadata.get("tcdyn") == COMPENSATED and not allow_compensated:
        raise InputError(
            "is compensated already",
            where=table.where,
            expected="a log as the logger wrote it",
            remedy="give the raw log; static lines and chain must not be applied twice",
        )
    names = match_columns(
        table.names, kind, table.where, mapping, without, used.stated(), air, layouts
    )
    how = as_logged(names, table.names, used, disk or "", mapping)
    names = {"friction_N" if name in TORQUES else name: own for name, own in names.items()}
    return converted(table, how), names


def columns_not_there(
    file: str | Path, rig: Rig, wanted: Iterable[str], alike: bool = False
) -> list[str]:
    """Those of the ``wanted`` columns that the file of an EHL log does not hold, nor, if ``alike``, one that looks like
    it."""
    mapping = {**rig.columns(), **rig.air_columns()}
    names = open_table(Path(file), (*known_names(layouts_of(rig, None)), *mapping.values())).names
    gone = [c for c in wanted if named(c, mapping, names) is None]
    return [
        c for c in gone if not alike or suggestion(c, (n for n in names if n not in KNOWN)) is None
    ]


def not_there(
    log: str | Path, rig: Rig, records: Mapping[str, DiskRecord]
) -> tuple[list[str], list[str]]:
    """Columns of an EHL log that are neither there nor needed: of a disk without a record, and of what the unloading
    alone would be fitted with; these once more."""
    lone = [couples(rig.disk_setup(d).channels, d) for d in DISKS if d not in records]
    junctions = [
        c
        for columns in lone
        if len(columns_not_there(log, rig, columns)) == len(columns)
        for c in columns
    ]
    running = columns_not_there(
        log, rig, [*EHL_RUNNING, *TORQUES, "ambient_degC", *rig.air_columns()]
    )
    torque = not set(TORQUES) <= set(running)
    needless = {"contact", *TORQUES, *rig.stated(), *(["friction_N"] if torque else [])}
    unused = columns_not_there(log, rig, [c for c in running if c not in needless], alike=True)
    return [*junctions, *unused], unused


def refuse_spare_records(file: str | Path, rig: Rig, records: Mapping[str, DiskRecord]) -> None:
    """Refuse the record of a disk of which an EHL log of the other one holds no column."""
    own = {d: [*couples(rig.disk_setup(d).channels, d)] for d in records}
    gone = [d for d in records if columns_not_there(file, rig, own[d]) == own[d]]
    for disk in gone if len(gone) < len(records) else ():
        said = f"holds no column of the {disk} disk, whose record was given"
        raise InputError(
            said,
            where=shown(Path(file)),
            remedy=f"leave out the {disk} disk's record, or map columns",
        )


def as_logged(
    names: Mapping[str, str], file: Collection[str], rig: Rig, disk: str, mapping: Mapping[str, str]
) -> dict[str, Callable[[Array], Array]]:
    """What makes the canonical unit of the columns that are in another, by their names in the ``file``.

    Temperatures in K, degF or mV; a torque, over the radius of its shaft's disk.
    """
    how = dict[str, Callable[[Array], Array]]()
    for name, own in names.items():
        logger = rig.tables(next((d for d in DISKS if name.startswith(f"{d}_")), disk)).logger
        unit = (named(name, mapping, file) or (own, own.rpartition("_")[2]))[1]
        if logger.millivolts and is_couple(name):
            unit = "mV"
        if name.endswith("_degC") and unit in UNITS:
            how[own] = to_degC(unit, logger.couple, logger.cold_junction_degC)
        if name in TORQUES:
            radius_m = 1e-3 * rig.tables(name.split("_")[1]).disk.outer_radius_mm
            how[own] = partial(np.multiply, 1 / radius_m)
    return how


def log_kind(
    log: str | Path, rig: Rig, records: Mapping[str, DiskRecord]
) -> tuple[Literal["ehl", "immersion"], str | None]:
    """Whether the columns make an EHL log or an immersion log, and for the latter the disk that was plunged.

    Raises InputError when several records are given for an immersion log; other kinds are refused by the reader.
    """
    disk = next(iter(records))
    known = (*known_names(layouts_of(rig, disk)), *rig.columns(disk).values())
    return kind_of_columns(open_table(log, known).names, rig, records, shown(Path(log)))


def kind_of_columns(
    names: Collection[str], rig: Rig, records: Mapping[str, DiskRecord], where: str
) -> tuple[Literal["ehl", "immersion"], str | None]:
    """``log_kind`` for names that are read already."""
    disk = next(iter(records))
    layouts = layouts_of(rig, disk)
    every = {c for layout in layouts.values() for c in layout.columns}
    mapped = {canonical for canonical in every if named(canonical, rig.columns(disk), names)}
    if recognise({*names, *mapped}, layouts) != "immersion":
        return "ehl", None
    if len(records) > 1:
        raise InputError(
            f"is an immersion log of one disk, and records of {len(records)} disks were given",
            where=where,
            remedy="give the record of the disk that was plunged",
        )
    return "immersion", disk
