"""Command ``tcdyn compensate``: remove static errors and lag from logged temperatures.

Logs of the rig go to :mod:`tcdyn.workflows.compensate`, any other table (``--sensor``) to
``tcdyn.cli.tables``. Tests: ``tests/cli/test_compensate_command.py``.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args

from tcdyn.cli.common import (
    OptionalRecordFiles,
    Reporter,
    RigFileOrRecords,
    Verbose,
    check_choice,
    check_outputs,
    default_output_path,
    number_option,
    options_from_docstring,
    source_entry,
    stage_progress,
    write_json,
)
from tcdyn.cli.tables import (
    CsvComments,
    CsvDialect,
    SensorFiles,
    TableColumns,
    TableReading,
    compensate_any_table,
    only_with_records,
)
from tcdyn.core.errors import InputError
from tcdyn.io.endings import JSON, LONG_TABLE, PAGE, TABLE

if TYPE_CHECKING:
    from tcdyn.sensors.compensation import CompensationMethod
    from tcdyn.workflows.compensate import CompensatedLog


@options_from_docstring
def compensate(
    log: Path,
    record: OptionalRecordFiles = None,
    sensor: SensorFiles = None,
    out: Path | None = None,
    rig: RigFileOrRecords = None,
    refine: bool = True,
    method: str = "smoother",
    criterion: str | None = None,
    bandwidth_Hz: Annotated[float | None, number_option(0, 1e4)] = None,
    report: Path | None = None,
    covariance: Path | None = None,
    covariance_from_s: float | None = None,
    covariance_s: Annotated[float, number_option(0, 60)] = 1.0,
    components: bool = False,
    noise_only: bool = False,
    delay_s: Annotated[float | None, number_option(0, 1e7)] = None,
    column: TableColumns = None,
    dialect: CsvDialect = "standard",
    comments: CsvComments = False,
    verbose: Verbose = False,
    *,
    reading: TableReading,
    reporter: Reporter,
) -> None:
    """Remove static errors and lag of every thermocouple; every sample gets a standard uncertainty.

    Example: tcdyn compensate D4.csv --record fast.disk.json --record slow.disk.json --out
    D4.compensated.csv

    Any other table: tcdyn compensate kiln.csv --sensor probe.sensor.json --out kiln.compensated.csv

    Parameters
    ----------
    log
        EHL log or immersion log (CSV, TDMS, LVM or Parquet), or with --sensor any table
    out
        output: .csv, .parquet or .tdms (default LOG.compensated.csv)
    refine
        estimate the common lag of a disk from the unloading in the log, with the record as prior
    method
        smoother (RTS smoother); deconvolve (regularised deconvolution, without a model of the
        input, as a check); inverse (a causal filter)
    criterion
        with deconvolve: gcv (default), discrepancy or l-curve, which chooses its weight
    bandwidth_Hz
        with inverse: bandwidth [Hz], default 0.5
    report
        HTML report: properties of the filter, raw and compensated traces
    covariance
        JSON to write: for a segment, the covariance between samples, and means with the covariance
        between channels
    covariance_from_s
        start of that segment as time_s (default: the last event, the unloading)
    covariance_s
        length of that segment in seconds
    components
        also write the components of each _u_K: _noise_u_K and _common_u_K
    noise_only
        remove only noise and static errors, not the lag
    delay_s
        compensate each row only with the rows that are there this long after it, in seconds: the
        rows that tcdyn follow gives
    """
    from tcdyn.io.read import open_table
    from tcdyn.io.write import DIALECTS, output_style
    from tcdyn.rig.opened_log import records_by_disk, rig_from_records
    from tcdyn.rig.rigfile import load_rig
    from tcdyn.sensors import read_sensor
    from tcdyn.workflows import compensate_log

    check_choice("--dialect", dialect, DIALECTS)
    of_csv: dict[str, Any] = {"dialect": dialect, "comments": comments}
    target = out or default_output_path(log, ".compensated.csv")
    whole_log_options = {
        "--report": report,
        "--covariance": covariance,
        "--noise-only": noise_only,
        "--components": components,
        "--method": method != "smoother",
    }
    table_kind = TABLE
    if sensor or delay_s is not None:
        table_kind = LONG_TABLE
    outputs = {
        "out": (target, table_kind),
        "report": (report, PAGE),
        "covariance": (covariance, JSON),
    }
    read_files = [log, rig, *(record or ()), *(sensor or ())]
    check_outputs(read_files, reporter.overwrite, **outputs)
    if sensor:
        rig_options = {
            "--record": record,
            "--rig": rig,
            "--criterion": criterion,
            "--bandwidth-Hz": bandwidth_Hz,
            **whole_log_options,
        }
        only_with_records(rig_options)
        table_options = {
            "columns": column or (),
            "delay_s": delay_s,
            **reading.options(),
            **of_csv,
        }
        return compensate_any_table(
            log,
            [read_sensor(path) for path in sensor],
            target,
            table_options,
            reporter,
            verbose,
        )
    if not record:
        raise InputError(
            "no record and no sensor was given",
            remedy="add --record DISK.disk.json or --sensor S.sensor.json",
        )
    if noise_only and (report is not None or covariance is not None):
        raise InputError("--noise-only with --report or --covariance", remedy="give one of them")
    if covariance is not None and method == "inverse":
        raise InputError(
            "--covariance with --method inverse, which has none", remedy="take the smoother"
        )
    records = records_by_disk(record)
    rig_settings = load_rig(rig) if rig else rig_from_records(records)
    rig_settings = rig_settings.with_reading(reading.rows)
    if delay_s is not None:
        for option, value in whole_log_options.items():
            if value:
                raise InputError(f"{option} with --delay-s", remedy="leave one of them out")
        delayed_options = {"rig": rig_settings, "delay_s": delay_s, **of_csv}
        return compensate_any_table(log, records, target, delayed_options, reporter, verbose)
    if comments or dialect != "standard":  # an error before the work
        output_style(**of_csv, table=open_table(log), out=target)
    way = _method(method, criterion, bandwidth_Hz, noise_only)
    with stage_progress(reporter.is_silent, verbose) as progress:
        done = compensate_log(
            log, records, rig_settings, refine=refine, way=way, parts=components, progress=progress
        )
        covariances = None
        if covariance is not None:
            covariances = done.covariance(covariance_s, covariance_from_s)
        written, write_findings = done.write(target, progress, **of_csv)
        if covariance is not None:
            write_json(covariance, {"source": source_entry(log), **(covariances or {})})
        if report is not None:
            from tcdyn.report.compensate import write_compensation_report

            progress("writing the report")
            write_compensation_report(report, done, records, record)
    findings = list(write_findings)
    if way.method == "inverse":
        for disk in done.disks:
            findings += done.filter_report(disk).findings
    reporter.json(lambda: {**_numbers(done), "out": written, "report": report})
    reporter.text(_summary(done))
    content = "compensated" if way.removes_lag else "without noise, lag left in"
    reporter.files(**{content: written}, report=report, covariance=covariance)
    reporter.finish(log.name, findings)


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


def _method(
    method: str, criterion: str | None, bandwidth_Hz: float | None, noise_only: bool
) -> CompensationMethod:
    """The method that the options specify.

    Parameters
    ----------
    method
        Name of the method.
    criterion, bandwidth_Hz
        Settings of one method each; None: its default.
    noise_only
        Remove noise and static errors only.

    Raises
    ------
    InputError
        Options that contradict each other.
    """
    from tcdyn.sensors.compensation import METHODS, CompensationMethod
    from tcdyn.smoothing.process_noise import Criterion

    check_choice("--method", method, tuple(m for m in METHODS if m != "noise-only"))
    if noise_only and method != "smoother":
        raise InputError(f"--noise-only with --method {method}", remedy="give one of them")
    for option, value, needed in (
        ("--criterion", criterion, "deconvolve"),
        ("--bandwidth-Hz", bandwidth_Hz, "inverse"),
    ):
        if value is not None and method != needed:
            raise InputError(
                f"{option} with --method {method}", remedy=f"add --method {needed}, or leave it out"
            )
    if criterion is not None:
        check_choice("--criterion", criterion, get_args(Criterion))
    settings: dict[str, Any] = {}
    if criterion is not None:
        settings["criterion"] = criterion
    if bandwidth_Hz is not None:
        settings["bandwidth_Hz"] = bandwidth_Hz
    name = "noise-only" if noise_only else method
    return CompensationMethod(name, **settings)  # type: ignore[arg-type]


def _numbers(done: CompensatedLog) -> dict[str, Any]:
    """Content of ``--json``; with --noise-only one entry for each channel."""
    from tcdyn.core.result import jsonable

    if done.method.removes_lag:
        return done.to_dict()
    channels: dict[str, Any] = {}
    for disk, compensated in done.disks.items():
        channels |= zip(done.channels(disk), jsonable(compensated.card()))
    return {"metadata": done.metadata, "channels": channels, "warnings": list(done.warnings)}
