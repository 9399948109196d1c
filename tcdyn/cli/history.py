"""Commands ``tcdyn sensor history`` and ``tcdyn sensor compare``: lags against date, and ratios.

Tests: ``tests/sensors/test_history.py`` and ``tests/sensors/test_ratio.py``.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, cast

import typer

from tcdyn.cli.common import (
    OptionalPicture,
    Reporter,
    as_option,
    check_outputs,
    count_progress,
    options_from_docstring,
    save_picture,
)
from tcdyn.cli.tables import files_of_tables
from tcdyn.core.errors import InputError
from tcdyn.core.options import Options, option
from tcdyn.io.endings import CSV_OR_JSON, JSON, PICTURE
from tcdyn.sensors.history_options import HistoryOptions
from tcdyn.sensors.options import DipOptions

if TYPE_CHECKING:
    from tcdyn.core.findings import Finding
    from tcdyn.sensors import SensorHistory


@dataclass(frozen=True)
class LogOptions(Options):
    """How logs are measured.

    Attributes
    ----------
    method
        the files are logs, one for each date: noise (constant conditions) or plunge (a dip)
        (default: the files are *.sensor.json)
    workers
        with {method}: worker processes (default: 2 if there are two cores)
    """

    method: str | None = option(None, "Input", choices=("noise", "plunge"))
    workers: int | None = option(None, "Advanced", low=1, high=256)


@options_from_docstring
def history(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...")],
    picture: OptionalPicture = None,
    out: Annotated[Path | None, typer.Option(rich_help_panel="Output")] = None,
    *,
    chosen: HistoryOptions,
    of_logs: LogOptions,
    reading: DipOptions,
    reporter: Reporter,
) -> None:
    """Show the lag of one sensor against date, and test whether it changed.

    A warning states a change that is significant: of steady sensors, 5 % get it. Only measurements
    by one method, in one medium and at one flow are compared.

    Example: tcdyn sensor history week*.sensor.json --picture lag.png --out history.csv

    Parameters
    ----------
    files
        *.sensor.json, or logs with --method; at least two
    out
        table of the measurements to write (.csv), or all of the result (.json)
    """
    left_out: Sequence[Finding] = ()
    if of_logs.method is not None:
        paths, left_out = files_of_tables(files)
    else:
        paths = _named(files)
    check_outputs(paths, reporter.overwrite, picture=(picture, PICTURE), out=(out, CSV_OR_JSON))
    result = _history(paths, chosen, of_logs, reading, reporter)
    if out is not None:
        result.write(out)
    if picture is not None:
        from functools import partial

        from tcdyn.plots.history import draw_history
        from tcdyn.plots.style import panel_figure

        save_picture(
            panel_figure(partial(draw_history, result), width_in=8.0, height_in=4.0), picture
        )
    reporter.json(result.to_dict)
    reporter.summary(result.summary())
    reporter.files(picture=picture, history=out)
    reporter.finish(result.column, [*left_out, *result.findings])


@options_from_docstring
def compare(
    files: Annotated[list[Path], typer.Argument(metavar="SENSOR...")],
    same_design: Annotated[bool, typer.Option("--same-design", rich_help_panel="Sensor")] = False,
    out: Annotated[Path | None, typer.Option(rich_help_panel="Output")] = None,
    *,
    reporter: Reporter,
) -> None:
    """Compare sensors: the ratio of each lag to that of the first, and whether it differs from 1.

    Example: tcdyn sensor compare new.sensor.json old.sensor.json

    Parameters
    ----------
    files
        *.sensor.json; each column of a file is a sensor
    same_design
        the sensors are of one construction and were measured in one medium: uncertainties that
        measurements by one method share cancel
    out
        result to write (.json)
    """
    from tcdyn.cli.common import write_json
    from tcdyn.sensors import compare_sensors

    paths = _named(files)
    check_outputs(paths, reporter.overwrite, out=(out, JSON))
    result = compare_sensors(paths, same_design=same_design)
    if out is not None:
        write_json(out, result.to_dict())
    reporter.json(result.to_dict)
    reporter.summary(result.summary())
    reporter.files(comparison=out)
    reporter.finish(result.first, result.findings)


def _named(files: Sequence[Path]) -> list[Path]:
    """The files, with patterns replaced by what they match, in the order of names."""
    from glob import glob, has_magic

    named = []
    for file in files:
        if has_magic(str(file)) and not file.exists():
            matches = sorted(glob(str(file)))
            if not matches:
                raise InputError(f"no file matches {file}", expected="sensor files")
            named += [Path(match) for match in matches]
        else:
            named.append(file)
    return named


def _history(
    paths: Sequence[Path],
    chosen: HistoryOptions,
    of_logs: LogOptions,
    reading: DipOptions,
    reporter: Reporter,
) -> SensorHistory:
    """The history of sensor files, or of logs; parameters as of the command.

    Raises
    ------
    InputError
        For options of logs without a method.
    """
    from tcdyn.sensors import sensor_history
    from tcdyn.workflows import history_of_logs

    method = cast(Literal["noise", "plunge"] | None, of_logs.method)
    if method is not None:
        if method == "noise":
            _refuse_of_dips(reading)
        workers = of_logs.workers or min(2, os.cpu_count() or 1)
        with count_progress(len(paths), reporter.is_silent) as progress:
            return history_of_logs(
                paths,
                method,
                chosen.column,
                dates=chosen.dates,
                workers=workers,
                spelling=as_option,
                progress=progress,
                **reading.stated,
            )
    for name in (*of_logs.stated, *reading.stated):
        raise InputError(
            f"{{{name}}} is given without {{method}}",
            expected="logs for it",
            remedy="give both, or none",
            parameters={name: None, "method": None},
        )
    return sensor_history(paths, **chosen.stated)


def _refuse_of_dips(reading: DipOptions) -> None:
    """Raise InputError for an option of dips."""
    from dataclasses import fields

    from tcdyn.series.options import TableOptions

    of_tables = {each.name for each in fields(TableOptions)}
    for name in reading.stated:
        if name not in of_tables:
            raise InputError(
                f"{{{name}}} with {{method}}",
                expected="it with dips only",
                parameters={name: None, "method": "noise"},
            )
