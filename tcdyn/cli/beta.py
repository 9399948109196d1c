"""``tcdyn beta`` and ``tcdyn campaign``: EHL logs and two records to the heat partition, by every way."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from calibration.disk import left_out_of
from calibration.files.write import write_text
from calibration.finding import doubts
from calibration.rig import load_rig
from tcdyn.cli.common import (
    Json,
    OwnRigFile,
    Quiet,
    RecordFiles,
    Verbose,
    counted,
    dump,
    in_one_line,
    say,
    spare_inputs,
    stages,
    warn,
)

Bearing = Annotated[
    Path | None,
    typer.Option(help="CSV of a pure-rolling test: load_N, friction_N, speed_slow_rpm; half is added to friction"),
]
Without = Annotated[
    list[str] | None, typer.Option(help="channel to leave out, such as fast_c; may be given more than once")
]
WindowS = Annotated[float, typer.Option("--window-s", help="cooling used by the h-only fit")]
Seed = Annotated[int, typer.Option(help="seed of the budget's Monte Carlo")]


def beta(
    log: Annotated[Path, typer.Argument(help="EHL log as it was recorded (not compensated)")],
    record: RecordFiles,
    rig: OwnRigFile = None,
    out: Annotated[Path | None, typer.Option(help="beta.json to write")] = None,
    report: Annotated[Path | None, typer.Option(help="HTML report to write")] = None,
    bearing: Bearing = None,
    without: Without = None,
    window_s: WindowS = 5.0,
    sensor_check: Annotated[
        bool, typer.Option(help="leave out dead channels, stop at swapped ones, warn of misplaced junctions")
    ] = True,
    seed: Seed = 0,
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
    from tcdyn.traces import records_by_disk

    spare_inputs([log, rig, bearing, *record], out=out, report=report)
    records, rolling = records_by_disk(record), read_bearing(bearing) if bearing else None
    with stages(quiet or json_, verbose) as progress:
        run = estimate_beta(
            log, load_rig(rig) if rig else None, records, window_s=window_s, seed=seed, sensor_check=sensor_check,
            bearing=rolling, without=without or (), progress=progress,
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
    else:
        warn(run.partition.noticed, quiet)  # the summary ends with the verdict
        say(run.summary(), quiet)
        for word, path in (("numbers", out), ("report", report)):
            if path is not None:
                say(f"{word}: {path}", quiet)
    if run.partition.status != "sound":
        in_one_line(log.name, run.partition.findings)
        raise typer.Exit(1)


def campaign(
    logs: Annotated[list[Path], typer.Argument(help="EHL logs as they were recorded")],
    record: RecordFiles,
    out: Annotated[Path, typer.Option(help="folder for <log>.beta.json, campaign.csv and campaign.html")],
    rig: OwnRigFile = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="processes on this machine (default: 2 where there are two cores)")
    ] = None,
    dask: Annotated[str | None, typer.Option(help="address of a Dask scheduler, e.g. tcp://host:8786")] = None,
    bearing: Bearing = None,
    without: Without = None,
    model: Annotated[
        list[Path] | None,
        typer.Option(
            help="CSV of a model's curve to lay over beta: one of delta_T_us_K_m_s, load_N, "
            "sliding_speed_m_s, entraining_speed_m_s; beta; u_beta if known; may be given more than once"
        ),
    ] = None,
    window_s: WindowS = 5.0,
    seed: Seed = 0,
    json_: Json = False,
    quiet: Quiet = False,
) -> None:
    """Heat partition of every log of a campaign, in one table with the thesis's figures, and as one measurement.

    What all tests of a rig share is solved for once: campaign.json holds beta with its uncertainty within the campaign
    and absolute, the exponent of the speed law, trends, and which test does not belong; table.csv and table.tex are for
    a paper. What is finished is kept: run the same command again to go on after a stop, or to add logs; a .beta.json
    may stand in the place of its log. A log that cannot be analysed has its reason in the table and does not stop the
    others; the exit code is then 1, and 2 when none could.

    Example: tcdyn campaign EHL_*.csv --rig rig.toml --record fast.disk.json --record slow.disk.json --out results
    """
    from tcdyn.pipeline.bearing import read_bearing
    from tcdyn.pipeline.campaign import OUTPUTS, PAGE_FILE, TABLE_FILE, CampaignSettings, run_campaign
    from tcdyn.traces import records_by_disk, rig_of

    if dask is not None and workers is not None:
        raise typer.BadParameter("give --workers or --dask, not both")
    for name in OUTPUTS:
        spare_inputs([*logs, rig, bearing, *record, *(model or ())], out=out / name)
    records = records_by_disk(record)
    own_rig = load_rig(rig) if rig else rig_of(records)
    rolling = read_bearing(bearing) if bearing else None
    left_out_of(without or ())
    settings = CampaignSettings(own_rig, records, window_s, seed, rolling, tuple(without or ()))
    count = workers or min(2, os.cpu_count() or 1)
    with counted(len(logs), quiet or json_) as progress:
        run = run_campaign(logs, settings, out, workers=count, dask=dask, models=model or (), progress=progress)
    from tcdyn.report.campaign import write_campaign_report

    report = write_campaign_report(out / PAGE_FILE, run)
    for lost in run.failed:
        print(f"tcdyn: {lost.error}", file=sys.stderr)
    if json_:
        print(dump(run.table), end="")
    else:
        warn(run.findings, quiet)
        say(run.summary(), quiet)
        say(f"table: {out / TABLE_FILE}", quiet)
        say(f"report: {report}", quiet)
    in_one_line("campaign", run.findings)
    if run.failed or doubts(run.findings):
        raise typer.Exit(2 if len(run.failed) == len(run.outcomes) else 1)
