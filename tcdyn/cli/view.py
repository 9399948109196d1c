"""Command ``tcdyn view``: traces of any log in the browser, as logged and compensated.

The page is made by :func:`tcdyn.report.view.view`. Test: ``tests/report/test_view.py``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from tcdyn.cli.common import (
    Reporter,
    Verbose,
    check_outputs,
    options_from_docstring,
    stage_progress,
)
from tcdyn.cli.tables import CalibrationFiles, TableFiles, files_of_tables
from tcdyn.io.endings import PAGE
from tcdyn.workflows.options import LogOptions


@options_from_docstring
def view(
    logs: TableFiles,
    out: Annotated[Path | None, typer.Option(rich_help_panel="Output")] = None,
    open_: Annotated[bool, typer.Option(rich_help_panel="Output")] = True,
    verbose: Verbose = False,
    *,
    files: CalibrationFiles,
    options: LogOptions,
    reporter: Reporter,
) -> None:
    """Show the traces of a log in the browser, raw and compensated, also of a million rows.

    Example: tcdyn view kiln.csv --sensor probe.sensor.json

    A log of the rig: tcdyn view D4.csv --record fast.disk.json --record slow.disk.json

    Parameters
    ----------
    out
        page to write (default LOG.view.html)
    open_
        open it in the browser
    """
    from tcdyn.report.view import view as write_view

    paths, left_out = files_of_tables(logs)
    page = out or paths[0].with_name(f"{paths[0].stem}.view.html")
    check_outputs([*paths, *files.files], reporter.overwrite, out=(page, PAGE))
    calibrations: Any = files.records() if files.record else files.sensors()
    with stage_progress(reporter.is_silent, verbose) as progress:
        _, findings = write_view(
            paths,
            calibrations,
            rig=files.rig_settings() if files.rig else None,
            out=page,
            open_browser=open_,
            progress=progress,
            **options.stated,
        )
    reporter.json(lambda: {"page": page})
    reporter.files(page=page)
    reporter.finish(paths[0].name, [*left_out, *findings])
