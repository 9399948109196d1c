"""Command ``tcdyn view``: traces of any log in the browser, as logged and compensated.

The page is made by :func:`tcdyn.report.view.view`. Test: ``tests/report/test_view.py``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tcdyn.cli.common import (
    OptionalRecordFiles,
    Reporter,
    RigFileOrRecords,
    Verbose,
    check_outputs,
    options_from_docstring,
    stage_progress,
)
from tcdyn.cli.tables import SensorFiles, TableColumns, TableReading, only_with_records
from tcdyn.core.errors import InputError
from tcdyn.io.endings import PAGE


@options_from_docstring
def view(
    log: Path,
    record: OptionalRecordFiles = None,
    sensor: SensorFiles = None,
    rig: RigFileOrRecords = None,
    out: Path | None = None,
    open_: bool = True,
    column: TableColumns = None,
    verbose: Verbose = False,
    *,
    reading: TableReading,
    reporter: Reporter,
) -> None:
    """Show the traces of a log in the browser, raw and compensated, also of a million rows.

    Example: tcdyn view kiln.csv --sensor probe.sensor.json

    A log of the rig: tcdyn view D4.csv --record fast.disk.json --record slow.disk.json

    Parameters
    ----------
    log
        log of the rig, or any table with a column of time
    out
        page to write (default LOG.view.html)
    open_
        open it in the browser
    """
    from tcdyn.report.view import view as write_view
    from tcdyn.rig.opened_log import records_by_disk
    from tcdyn.rig.rigfile import load_rig
    from tcdyn.sensors import read_sensor

    if record and sensor:
        raise InputError("--record with --sensor", remedy="give one of them")
    page = out or log.with_name(f"{log.stem}.view.html")
    inputs = [log, rig, *(record or ()), *(sensor or ())]
    check_outputs(inputs, reporter.overwrite, out=(page, PAGE))
    calibrations: Any = ()
    if record:
        calibrations = records_by_disk(record)
    else:
        only_with_records({"--rig": rig})
        calibrations = [read_sensor(path) for path in sensor or ()]
    options: dict[str, Any] = {"columns": column or (), **reading.options()}
    with stage_progress(reporter.is_silent, verbose) as progress:
        _, findings = write_view(
            log,
            calibrations,
            rig=load_rig(rig) if rig else None,
            out=page,
            open_browser=open_,
            progress=progress,
            **options,
        )
    reporter.json(lambda: {"page": page})
    reporter.files(page=page)
    reporter.finish(log.name, findings)
