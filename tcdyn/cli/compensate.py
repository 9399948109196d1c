"""``tcdyn compensate``: a logged trace in, the temperature at the junctions out."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args

import typer

from tcdyn.cli.common import (
    OptionalRecordFiles,
    OwnRigFile,
    Told,
    Verbose,
    bounded,
    check_choice,
    dump,
    end,
    grouped,
    spare_inputs,
    stages,
)
from tcdyn.cli.tables import SensorFiles, TableColumns, TableReading, of_table, only_with_records
from tcdyn.core.errors import InputError

if TYPE_CHECKING:
    from tcdyn.workflows.compensate import CompensatedLog
    from tcdyn.workflows.segments import Way


@grouped
def compensate(
    log: Annotated[
        Path, typer.Argument(help="EHL log, or immersion log (CSV, TDMS, LVM or Parquet)")
    ],
    record: OptionalRecordFiles = None,
    sensor: SensorFiles = None,
    out: Annotated[
        Path | None,
        typer.Option(help="output: .csv, .parquet or .tdms (default LOG.compensated.csv)"),
    ] = None,
    rig: OwnRigFile = None,
    refine: Annotated[
        bool,
        typer.Option(
            help="take the lag common to a disk from the log's unloading, the record's as prior"
        ),
    ] = True,
    method: Annotated[
        str,
        typer.Option(
            help="smoother; deconvolve (a second opinion that assumes no model of the input); inverse (a causal filter)"
        ),
    ] = "smoother",
    criterion: Annotated[
        str | None,
        typer.Option(
            help="of deconvolve: gcv (default), discrepancy or l-curve chooses its weight"
        ),
    ] = None,
    bandwidth_hz: Annotated[
        float | None, bounded("--bandwidth-Hz", "of inverse [Hz], default 0.5", 0, 1e4)
    ] = None,
    report: Annotated[
        Path | None, typer.Option(help="HTML page: numbers before use, raw against compensated")
    ] = None,
    covariance: Annotated[
        Path | None,
        typer.Option(
            help="JSON: over a stretch, covariance between samples, and means with that between channels"
        ),
    ] = None,
    covariance_from_s: Annotated[
        float | None,
        typer.Option(
            "--covariance-from-s",
            help="where it begins, as time_s; default the last event, the unloading",
        ),
    ] = None,
    covariance_s: Annotated[
        float, bounded("--covariance-s", "how long it is, in seconds", 0, 60)
    ] = 1.0,
    parts: Annotated[
        bool,
        typer.Option(
            "--parts", help="columns _noise_u_K and _common_u_K, what each _u_K is made of"
        ),
    ] = False,
    noise_only: Annotated[
        bool,
        typer.Option(
            "--noise-only", help="only take out noise and static errors; the lag stays in"
        ),
    ] = False,
    follow: Annotated[bool, typer.Option("--follow", hidden=True, help="now tcdyn follow")] = False,
    column: TableColumns = None,
    verbose: Verbose = False,
    *,
    reading: TableReading,
    tell: Told,
) -> None:
    """Undo static errors and lag of every logged thermocouple; a standard deviation stands beside each sample.

    Example: tcdyn compensate D4.csv --record fast.disk.json --record slow.disk.json --out D4.compensated.csv

    Any other table: tcdyn compensate kiln.csv --sensor probe.sensor.json --out kiln.compensated.csv
    """
    from tcdyn.io.write import write_text
    from tcdyn.rig.opened_log import records_by_disk, rig_of
    from tcdyn.rig.rigfile import load_rig
    from tcdyn.workflows import compensate_log

    if sensor:
        asked = {
            "--record": record,
            "--rig": rig,
            "--criterion": criterion,
            "--bandwidth-Hz": bandwidth_hz,
            "--report": report,
            "--covariance": covariance,
            "--noise-only": noise_only or None,
            "--parts": parts or None,
            "--method": None if method == "smoother" else method,
        }
        only_with_records([option for option, value in asked.items() if value])
        target = out or log.with_name(f"{log.stem}.compensated.csv")
        return of_table(
            log, sensor, target, {"columns": column or (), **reading.options()}, tell, verbose
        )
    if not record:
        raise InputError(
            "no record and no sensor was given",
            remedy="add --record DISK.disk.json or --sensor S.sensor.json",
        )
    if follow:
        raise InputError(
            "--follow is a command of its own now",
            remedy=f"tcdyn follow {log} --record ... --out ...",
        )
    if noise_only and (report is not None or covariance is not None):
        raise InputError("--noise-only with --report or --covariance", remedy="give one of them")
    if covariance is not None and method == "inverse":
        raise InputError(
            "--covariance with --method inverse, which states none", remedy="take the smoother"
        )
    records = records_by_disk(record)
    own_rig = load_rig(rig) if rig else rig_of(records)
    target = out or log.with_name(f"{log.stem}.compensated.csv")
    spare_inputs([log, rig, *record], out=target, report=report, covariance=covariance)
    way = _way(method, criterion, bandwidth_hz, noise_only)
    with stages(tell.silent, verbose) as progress:
        done = compensate_log(
            log, records, own_rig, refine=refine, way=way, parts=parts, progress=progress
        )
        between = (
            done.covariance(covariance_s, covariance_from_s) if covariance is not None else None
        )
        written, noticed = done.write(target, progress)
        if covariance is not None:
            write_text(covariance, dump(between))
        if report is not None:
            from tcdyn.report.compensate import write_compensation_report

            progress("report")
            write_compensation_report(report, done, records, record)
    before = [done.before_use(disk) for disk in done.disks] if way.method == "inverse" else []
    found = [*noticed, *(f for one in before for f in one.findings)]
    tell.json(lambda: {**_numbers(done), "out": written, "report": report})
    tell.warn(found)
    tell.say(_words(done))
    what = "compensated" if way.removes_lag else "without noise, lag left in"
    tell.files(**{what: written}, report=report, covariance=covariance)
    end(log.name, found)


def _words(done: CompensatedLog) -> str:
    """What was done to each disk."""
    said: list[str] = []
    for disk, one in done.disks.items():
        if done.way.method == "inverse":
            before = done.before_use(disk)
            said += [
                f"{disk}, noisiest channel, {one.method}:",
                *(f"  {x}" for x in before.lines()),
            ]
        if done.way.removes_lag:
            said.append(f"{disk}: common lag {done.metadata[f'{disk}_common_lag_s']}")
        else:
            said += one.lines(done.channels(disk))
    return "\n".join(said)


def _way(method: str, criterion: str | None, bandwidth_Hz: float | None, noise_only: bool) -> Way:
    """The compensator that the options ask for; InputError for options that do not belong together."""
    from tcdyn.smoothing.process_noise import Criterion
    from tcdyn.workflows.segments import METHODS, Way

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
    chosen: dict[str, Any] = {"criterion": criterion, "bandwidth_Hz": bandwidth_Hz}
    given = {k: v for k, v in chosen.items() if v is not None}
    return Way("noise-only" if noise_only else method, **given)  # type: ignore[arg-type]


def _numbers(done: CompensatedLog) -> dict[str, Any]:
    """What ``--json`` prints: of a log without noise its channels, one by one."""
    from tcdyn.core.result import jsonable

    if done.way.removes_lag:
        return done.to_dict()
    rows = {disk: jsonable(one.card()) for disk, one in done.disks.items()}
    channels = {name: row for disk in rows for name, row in zip(done.channels(disk), rows[disk])}
    return {"metadata": done.metadata, "channels": channels, "warnings": list(done.warnings)}
