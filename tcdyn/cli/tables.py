"""Files of sensors and records for the commands that compensate, and what they report.

Used by the commands ``compensate``, ``follow`` and ``view``. Tests:
``tests/sensors/test_sensor_file.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tcdyn.cli.common import as_option
from tcdyn.core.errors import InputError
from tcdyn.core.options import Options, option

if TYPE_CHECKING:
    from tcdyn.rig.record import DiskRecord
    from tcdyn.rig.rigfile import Rig
    from tcdyn.sensors import SensorFile
    from tcdyn.series.options import ReadingOptions


@dataclass(frozen=True)
class CalibrationFiles(Options):
    """Sensor files for any table, or records of disks for a log of the rig.

    Attributes
    ----------
    sensor
        *.sensor.json, or the JSON of identify, for any table; repeat for each sensor
    record
        *.disk.json of a disk; give it once for each disk
    rig
        rig.toml; without it the rig stored in the records is used
    """

    sensor: Sequence[Path] = option((), "Sensor", takes=list[Path])
    record: Sequence[Path] = option((), "Two-disk rig", takes=list[Path])
    rig: Path | None = option(None, "Two-disk rig")

    def __post_init__(self) -> None:
        """Check that only one kind of calibration is given."""
        super().__post_init__()
        if self.sensor:
            refuse_with_sensor(("record", "rig"), self.stated)

    @property
    def files(self) -> list[Path | None]:
        """All files that are read."""
        return [self.rig, *self.record, *self.sensor]

    def check_given(self) -> None:
        """Raise InputError where neither a sensor nor a record is given."""
        if not self.sensor and not self.record:
            raise InputError(
                "no sensor and no record was given",
                remedy="add --sensor S.sensor.json, or of the rig --record DISK.disk.json",
            )

    def sensors(self) -> list[SensorFile]:
        """The sensors."""
        from tcdyn.sensors import read_sensor

        return [read_sensor(path) for path in self.sensor]

    def records(self) -> dict[str, DiskRecord]:
        """The records by disk."""
        from tcdyn.rig.opened_log import records_by_disk

        return records_by_disk(self.record)

    def rig_settings(self, reading: ReadingOptions | None = None) -> Rig | None:
        """The rig of the rig file, or of the records; None without both.

        Parameters
        ----------
        reading
            How the rows of its logs are read; None: as the rig states.
        """
        from tcdyn.rig.opened_log import rig_from_records
        from tcdyn.rig.rigfile import load_rig

        if self.rig is not None:
            settings = load_rig(self.rig)
        elif self.record:
            settings = rig_from_records(self.records())
        else:
            return None
        return settings if reading is None else settings.with_reading(reading)


def refuse_with_sensor(names: Sequence[str], stated: Mapping[str, object]) -> None:
    """Raise InputError if one of the options, which need disk records, is given with --sensor.

    Parameters
    ----------
    names
        Names of the options as parameters.
    stated
        Options that were given, by name.
    """
    for name in names:
        if stated.get(name):
            raise InputError(
                f"{as_option(name)} with --sensor",
                remedy="leave one of them out: the first needs records of disks, --sensor is for "
                "any table",
            )
