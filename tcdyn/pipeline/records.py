"""Records by disk, checked against each other, and the rig that they remember."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from calibration.disk import DISKS
from calibration.errors import InputError
from calibration.record import DiskRecord, read_record
from calibration.rig import Rig


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
            raise InputError(f"a second record of the {record.disk} disk", where=str(path), remedy="give one of each")
        out[record.disk] = record
    return out


def rig_of(records: Mapping[str, DiskRecord]) -> Rig:
    """The rig as the records remember it: each disk its own tables, what is common from the first record given."""
    common = next(iter(records.values())).setup
    own = {d: records[d].setup if d in records else common for d in DISKS}
    return Rig(common=common, fast=own["fast"], slow=own["slow"])
