"""``tcdyn beta``: an EHL log and two records to the heat partition, by every way."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from calibration.files.write import write_text
from calibration.grade import findings_of
from calibration.rig import load_rig
from tcdyn.cli.common import Json, OwnRigFile, Quiet, RecordFiles, Verbose, dump, say, spare_inputs, stages, warn


def beta(
    log: Annotated[Path, typer.Argument(help="EHL log as it was recorded (not compensated)")],
    record: RecordFiles,
    rig: OwnRigFile = None,
    out: Annotated[Path | None, typer.Option(help="beta.json to write")] = None,
    report: Annotated[Path | None, typer.Option(help="HTML report to write")] = None,
    bearing: Annotated[
        Path | None,
        typer.Option(help="CSV of a pure-rolling test: load_N, friction_N, speed_slow_rpm; half is added to friction"),
    ] = None,
    window_s: Annotated[float, typer.Option("--window-s", help="cooling used by the h-only fit")] = 5.0,
    sensor_check: Annotated[
        bool, typer.Option(help="stop at dead or swapped channels, warn of misplaced junctions")
    ] = True,
    seed: Annotated[int, typer.Option(help="seed of the budget's Monte Carlo")] = 0,
    json_: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Heat partition by the speed law, the cooling fits and the joint fits, cross-checked, with an uncertainty budget.

    Example: tcdyn beta D4.csv --rig rig.toml --record fast.disk.json --record slow.disk.json --out beta.json
    --report beta.html
    """
    from tcdyn.pipeline import estimate_beta
    from tcdyn.pipeline.bearing import read_bearing
    from tcdyn.pipeline.records import records_by_disk

    spare_inputs([log, rig, bearing, *record], out=out, report=report)
    records, rolling = records_by_disk(record), read_bearing(bearing) if bearing else None
    with stages(quiet or json_, verbose) as progress:
        run = estimate_beta(
            log, load_rig(rig) if rig else None, records, window_s=window_s, seed=seed, sensor_check=sensor_check,
            bearing=rolling, progress=progress,
        )  # fmt: skip
        text = dump(run.to_dict())
        if out is not None:
            write_text(out, text)
        if report is not None:
            progress("writing the report")
            from tcdyn.report.beta import write_beta_report

            write_beta_report(report, {log.stem: run.partition})
    if json_:
        print(text, end="")
        return
    warn(findings_of(run.partition), quiet)
    say(run.summary(), quiet)
    for word, path in (("numbers", out), ("report", report)):
        if path is not None:
            say(f"{word}: {path}", quiet)
