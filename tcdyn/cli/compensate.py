"""Command ``tcdyn compensate``: remove static errors and lag from logged temperatures.

Any table goes to :mod:`tcdyn.workflows.compensate_table`, logs of the rig to
:mod:`tcdyn.workflows.compensate`. Tests: ``tests/cli/test_compensate_command.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tcdyn.cli.common import (
    Reporter,
    Verbose,
    as_option,
    check_folder,
    check_outputs,
    default_output_path,
    options_from_docstring,
    source_entry,
    stage_progress,
    write_json,
)
from tcdyn.cli.tables import (
    CalibrationFiles,
    EachOptions,
    TableFiles,
    files_of_tables,
    refuse_with_sensor,
)
from tcdyn.core.errors import InputError
from tcdyn.core.options import Options, option
from tcdyn.io.endings import JSON, LONG_TABLE, PAGE, TABLE
from tcdyn.sensors.compensation import CompensationMethod
from tcdyn.workflows.options import CompensateOptions, OutputOptions

if TYPE_CHECKING:
    from tcdyn.core.findings import Finding
    from tcdyn.rig.rigfile import Rig
    from tcdyn.workflows.compensate import CompensatedLog
    from tcdyn.workflows.raw_log import Calibrations


# Options of the method that any table has, too
SHARED = ("rate", "components")


@dataclass(frozen=True)
class RigLogOptions(Options):
    """What only a log of the rig has.

    Attributes
    ----------
    refine
        estimate the common lag of a disk from the unloading in the log, with the record as prior
    report
        HTML report: properties of the filter, raw and compensated traces
    covariance
        JSON to write: for a segment, the covariance between samples, and means with the covariance
        between channels
    covariance_from_s
        start of that segment as time_s (default: the last event, the unloading)
    covariance_s
        length of that segment [s]
    """

    refine: bool = option(True, "Two-disk rig")
    report: Path | None = option(None, "Two-disk rig")
    covariance: Path | None = option(None, "Two-disk rig")
    covariance_from_s: float | None = option(None, "Two-disk rig")
    covariance_s: float = option(1.0, "Two-disk rig", low=0, high=60)


@dataclass(frozen=True)
class _Job:
    """One table to compensate.

    Attributes
    ----------
    paths
        Its files.
    out
        File to write, which is checked.
    options
        How it is read, compensated and written.
    reporter
        Output of the command.
    verbose
        Print a line for each stage.
    findings
        Findings about its files.
    """

    paths: Sequence[Path]
    out: Path
    options: CompensateOptions
    reporter: Reporter
    verbose: bool
    findings: Sequence[Finding]

    @property
    def log(self) -> Path | Sequence[Path]:
        """The file, or the files of one log."""
        return self.paths[0] if len(self.paths) == 1 else self.paths

    @property
    def name(self) -> str:
        """Name for messages."""
        return self.paths[0].name


@options_from_docstring
def compensate(
    logs: TableFiles,
    out: Annotated[Path | None, typer.Option(rich_help_panel="Output")] = None,
    verbose: Verbose = False,
    *,
    files: CalibrationFiles,
    options: CompensateOptions,
    each: EachOptions,
    method: CompensationMethod,
    of_rig: RigLogOptions,
    reporter: Reporter,
) -> None:
    """Remove static errors and lag of every thermocouple; every sample gets a standard uncertainty.

    Example: tcdyn compensate kiln.csv --sensor probe.sensor.json --out kiln.compensated.csv

    Times in milliseconds, degrees Fahrenheit: tcdyn compensate kiln.csv --sensor probe.sensor.json
    --time-unit ms --unit degF

    For a spreadsheet program: tcdyn compensate ofen.csv --sensor probe.sensor.json --out ofen.xlsx

    Files of one log: tcdyn compensate day1.csv day2.csv --sensor probe.sensor.json

    Many logs, each on its own: tcdyn compensate logs --each --sensor probe.sensor.json --out done

    A log of the rig: tcdyn compensate D4.csv --record fast.disk.json --record slow.disk.json

    Parameters
    ----------
    out
        output: .csv, .parquet, .xlsx or .nc, of a log of the rig without --delay-s also .tdms
        (default LOG.compensated.csv)
    """
    files.check_given()
    paths, left_out = files_of_tables(logs)
    only_of_rig = {name: value for name, value in method.stated.items() if name not in SHARED}
    only_of_rig |= of_rig.stated
    if files.sensor:
        refuse_with_sensor(only_of_rig)
    if each.each:
        _compensate_each(paths, out, files, options, each, reporter)
        return
    target = out or default_output_path(paths[0], ".compensated.csv")
    has_parts = bool(files.sensor) or options.delay_s is not None
    outputs = {
        "out": (target, LONG_TABLE if has_parts else TABLE),
        "report": (of_rig.report, PAGE),
        "covariance": (of_rig.covariance, JSON),
    }
    check_outputs([*paths, *files.files], reporter.overwrite, **outputs)
    job = _Job(paths, target, options, reporter, verbose, left_out)
    if files.sensor:
        _compensate_any_table(job, files.sensors(), None)
    elif options.delay_s is not None:
        for name in only_of_rig:
            raise InputError(f"{as_option(name)} with --delay-s", remedy="leave one of them out")
        _compensate_any_table(job, files.records(), files.rig_settings(options.rows))
    else:
        _check_rig_options(method, of_rig)
        method = replace(method, rate=options.rate, components=options.components)
        _compensate_rig_log(job, files, method, of_rig)


def _compensate_each(
    paths: Sequence[Path],
    out: Path | None,
    files: CalibrationFiles,
    options: CompensateOptions,
    each: EachOptions,
    reporter: Reporter,
) -> None:
    """Compensate each of many tables on its own: ``--each``.

    Parameters
    ----------
    paths
        The tables.
    out
        Folder of the outputs; None: beside each table.
    files, options, each, reporter
        As in the command.
    """
    from functools import partial

    from tcdyn.workflows.each import compensate_each

    if not files.sensor:
        raise InputError(
            "--each with --record", remedy="compensate logs of the rig one after the other"
        )
    each.check(paths, reporter)
    if out is not None:
        check_folder(out)
    work = partial(
        compensate_each,
        paths,
        files.sensors(),
        out,
        overwrite=reporter.overwrite,
        **options.stated,
    )
    each.run(paths, reporter, work)


def _check_rig_options(method: CompensationMethod, of_rig: RigLogOptions) -> None:
    """Raise InputError for options of a log of the rig that contradict each other."""
    if not method.removes_lag:
        for name in ("report", "covariance"):
            if getattr(of_rig, name) is not None:
                raise InputError(
                    f"--method {method.method} with {as_option(name)}", remedy="give one of them"
                )
    if of_rig.covariance is not None and method.method == "inverse":
        raise InputError(
            "--covariance with --method inverse, which has none", remedy="take the smoother"
        )


def _compensate_any_table(job: _Job, calibrations: Calibrations, rig: Rig | None) -> None:
    """Compensate a table and report the result.

    Parameters
    ----------
    job
        The table.
    calibrations
        Sensors, or with a delay records by disk.
    rig
        The rig of the records; None for sensors.
    """
    from tcdyn.core.findings import unique_by_subject
    from tcdyn.workflows.compensate_table import compensate_table

    reporter = job.reporter
    with stage_progress(reporter.is_silent, job.verbose) as progress:
        done = compensate_table(
            job.log, calibrations, job.out, rig=rig, progress=progress, **job.options.stated
        )
    given: Any = calibrations.values() if isinstance(calibrations, dict) else calibrations
    from_files = [finding for calibration in given for finding in calibration.findings]
    findings = unique_by_subject([*job.findings, *from_files, *done.findings])
    reporter.json(done.to_dict)
    reporter.summary(done.summary())
    reporter.finish(job.name, findings)


def _compensate_rig_log(
    job: _Job, files: CalibrationFiles, method: CompensationMethod, of_rig: RigLogOptions
) -> None:
    """Compensate a log of the rig and report the result.

    Parameters
    ----------
    job
        The log.
    files
        Records and rig file.
    method, of_rig
        How it is compensated.
    """
    from tcdyn.io.read import open_table
    from tcdyn.io.write import output_style
    from tcdyn.workflows import compensate_log
    from tcdyn.workflows.raw_log import check_options_of_sensors

    options = job.options
    check_options_of_sensors(options)
    output = OutputOptions(dialect=options.dialect, comments=options.comments)
    if output.stated:  # an error before the work
        output_style(output.dialect, output.comments, open_table(job.paths[0]), job.out)
    records = files.records()
    rig = files.rig_settings(options.rows)
    reporter = job.reporter
    with stage_progress(reporter.is_silent, job.verbose) as progress:
        done = compensate_log(
            job.log, records, rig, refine=of_rig.refine, way=method, progress=progress
        )
        written, findings_of_file = done.write(job.out, progress, **asdict(output))
        if of_rig.covariance is not None:
            covariances = done.covariance(of_rig.covariance_s, of_rig.covariance_from_s)
            write_json(of_rig.covariance, {"source": source_entry(job.paths[0]), **covariances})
        if of_rig.report is not None:
            from tcdyn.report.compensate import write_compensation_report

            progress("writing the report")
            write_compensation_report(of_rig.report, done, records, list(files.record))
    reporter.json(lambda: {**_numbers(done), "out": written, "report": of_rig.report})
    reporter.text(_summary(done))
    content = "compensated" if method.removes_lag else "without noise, lag left in"
    reporter.files(**{content: written}, report=of_rig.report, covariance=of_rig.covariance)
    findings = [*job.findings, *findings_of_file, *_filter_findings(done)]
    reporter.finish(job.name, findings)


def _filter_findings(done: CompensatedLog) -> list[Finding]:
    """Findings about the filter of the method inverse."""
    if done.method.method != "inverse":
        return []
    return [finding for disk in done.disks for finding in done.filter_report(disk).findings]


def _summary(done: CompensatedLog) -> str:
    """What was done to each disk, as text."""
    lines: list[str] = []
    for disk, compensated in done.disks.items():
        if done.method.method == "inverse":
            filter_report = done.filter_report(disk)
            lines.append(f"{disk}, noisiest channel, {compensated.method}:")
            lines += [f"  {line}" for line in filter_report.lines()]
        if done.method.removes_lag:
            lines.append(f"{disk}: common lag {done.metadata[f'{disk}_common_lag_s']}")
        else:
            lines += compensated.lines(done.channels(disk))
    return "\n".join(lines)


def _numbers(done: CompensatedLog) -> dict[str, Any]:
    """Content of ``--json``; with the method noise-only one entry for each channel."""
    from tcdyn.core.result import jsonable

    if done.method.removes_lag:
        return done.to_dict()
    channels: dict[str, Any] = {}
    for disk, compensated in done.disks.items():
        channels |= zip(done.channels(disk), jsonable(compensated.card()))
    return {"metadata": done.metadata, "channels": channels, "warnings": list(done.warnings)}
