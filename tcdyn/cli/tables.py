"""Files of sensors and records for the commands that compensate, and what they report.

Used by the commands ``compensate``, ``follow`` and ``view``. Tests:
``tests/sensors/test_sensor_file.py``.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tcdyn.cli.common import (
    NOT_TRUSTED,
    Reporter,
    as_option,
    check_outputs,
    count_progress,
)
from tcdyn.core.errors import InputError, printable
from tcdyn.core.options import Options, option
from tcdyn.io.endings import CSV

if TYPE_CHECKING:
    from tcdyn.core.findings import Finding
    from tcdyn.rig.record import DiskRecord
    from tcdyn.rig.rigfile import Rig
    from tcdyn.sensors import SensorFile
    from tcdyn.series.options import ReadingOptions
    from tcdyn.workflows.each import EachRun


TableFiles = Annotated[
    list[Path],
    typer.Argument(
        metavar="LOG...",
        help="any table with a column of time: CSV, LVM, TDMS, Parquet, .xlsx or .mat; several "
        "files of one log, a folder or a pattern are one table",
    ),
]


@dataclass(frozen=True)
class EachOptions(Options):
    """How many files are treated one by one.

    Attributes
    ----------
    each
        treat every file on its own; {out} is then a folder
    workers
        with {each}: worker processes (default: 2 if there are two cores)
    dask
        with {each}: address of a Dask scheduler, e.g. tcp://host:8786, instead of {workers}
    results
        with {each}: table of results to write, one row for each file (.csv)
    """

    each: bool = option(False, "Advanced")
    workers: int | None = option(None, "Advanced", low=1, high=256)
    dask: str | None = option(None, "Advanced")
    results: Path | None = option(None, "Advanced")

    def __post_init__(self) -> None:
        """Check that the other options are given with ``each`` only.

        Raises
        ------
        InputError
            For one of them alone, and for workers with Dask.
        """
        super().__post_init__()
        for name in ("workers", "dask", "results"):
            if getattr(self, name) is not None and not self.each:
                raise InputError(
                    f"{{{name}}} is given without {{each}}",
                    remedy="give both, or none",
                    parameters={name: None, "each": True},
                )
        if self.workers is not None and self.dask is not None:
            raise InputError(
                "{workers} with {dask}",
                remedy="give one of them",
                parameters={"workers": None, "dask": None},
            )

    def check(self, files: Sequence[Path], reporter: Reporter) -> None:
        """Check before any work that the table of results may be written."""
        check_outputs(files, reporter.overwrite, results=(self.results, CSV))

    def run(self, files: Sequence[Path], reporter: Reporter, work: Callable[..., EachRun]) -> None:
        """Treat each file, report the table of results, and exit with code 1 if a file failed.

        Parameters
        ----------
        files
            The files.
        reporter
            Output of the command.
        work
            Function of the keyword arguments ``workers``, ``dask``, ``spelling`` and ``progress``.

        Raises
        ------
        typer.Exit
            With code 1 if a file failed, and with ``--strict`` if one has a warning.
        """
        from tcdyn.core.parallel import worker_processes_end

        workers = self.workers or min(2, os.cpu_count() or 1)
        with (
            worker_processes_end() if self.dask is None else nullcontext(),
            count_progress(len(files), reporter.is_silent) as progress,
        ):
            done = work(workers=workers, dask=self.dask, spelling=as_option, progress=progress)
        if self.results is not None:
            done.write(self.results)
        reporter.json(done.to_dict)
        reporter.summary(done.summary())
        reporter.files(results=self.results)
        for outcome in done.outcomes:
            for message in outcome.messages:
                print(f"warning: {printable(message)}", file=sys.stderr)
        for outcome in done.failed:
            print(f"tcdyn: {printable(outcome.error)}", file=sys.stderr)
        has_warnings = any(outcome.n_warnings for outcome in done.outcomes)
        if done.failed or (reporter.strict and has_warnings):
            raise typer.Exit(NOT_TRUSTED)


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
            refuse_with_sensor(name for name in self.stated if name != "sensor")

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


def files_of_tables(paths: Sequence[Path]) -> tuple[list[Path], list[Finding]]:
    """The files that are meant by files, folders and patterns, and which were left out.

    One path that is no folder and no pattern is taken as it is, so that the reader says what is
    wrong with it.
    """
    from glob import has_magic

    from tcdyn.io.files import files_of
    from tcdyn.io.write import file_identity

    named = [path for path in paths if path.is_file()]
    seen: dict[object, Path] = {}
    for path in named:
        if seen.setdefault(file_identity(path), path) is not path:
            raise InputError(
                "is given twice: two names of one file", where=str(path), remedy="name each once"
            )
    if len(paths) == 1 and not paths[0].is_dir() and not has_magic(str(paths[0])):
        return list(paths), []
    return files_of(paths)


def refuse_with_sensor(names: Iterable[str]) -> None:
    """Raise InputError for the first of the options, which need disk records, with --sensor.

    Parameters
    ----------
    names
        Options that were given, as parameters.
    """
    for name in names:
        raise InputError(
            f"{as_option(name)} with --sensor",
            remedy="leave one of them out: the first needs records of disks, --sensor is for any "
            "table",
        )
