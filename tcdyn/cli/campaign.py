"""``tcdyn campaign``: many EHL logs to one table and one page, on this machine or on a Dask cluster."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from calibration.rig import load_rig
from tcdyn.cli.common import Json, OwnRigFile, Quiet, RecordFiles, counted, dump, say, spare_inputs, warn


def campaign(
    logs: Annotated[list[Path], typer.Argument(help="EHL logs as they were recorded")],
    record: RecordFiles,
    out: Annotated[Path, typer.Option(help="folder for <log>.beta.json, campaign.csv and campaign.html")],
    rig: OwnRigFile = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="processes on this machine (default: 2 where there are two cores)")
    ] = None,
    dask: Annotated[str | None, typer.Option(help="address of a Dask scheduler, e.g. tcp://host:8786")] = None,
    bearing: Annotated[
        Path | None,
        typer.Option(help="CSV of a pure-rolling test: load_N, friction_N, speed_slow_rpm; half is added to friction"),
    ] = None,
    window_s: Annotated[float, typer.Option("--window-s", help="cooling used by the h-only fit")] = 5.0,
    seed: Annotated[int, typer.Option(help="seed of the budget's Monte Carlo")] = 0,
    json_: Json = False,
    quiet: Quiet = False,
) -> None:
    """Heat partition of every log of a campaign, in one table with the thesis's figures.

    What is finished is kept: run the same command again to go on after a stop, or to add logs. A log that cannot be
    analysed has its reason in the table and does not stop the others; the exit code is then 1, and 2 when none could.

    Example: tcdyn campaign EHL_*.csv --rig rig.toml --record fast.disk.json --record slow.disk.json --out results
    """
    from tcdyn.pipeline.bearing import read_bearing
    from tcdyn.pipeline.campaign import PAGE_FILE, TABLE_FILE, CampaignSettings, run_campaign
    from tcdyn.pipeline.records import records_by_disk, rig_of

    if dask is not None and workers is not None:
        raise typer.BadParameter("give --workers or --dask, not both")
    for name in (TABLE_FILE, PAGE_FILE):
        spare_inputs([*logs, rig, bearing, *record], out=out / name)
    records = records_by_disk(record)
    own_rig = load_rig(rig) if rig else rig_of(records)
    settings = CampaignSettings(own_rig, records, window_s, seed, read_bearing(bearing) if bearing else None)
    count = workers or min(2, os.cpu_count() or 1)
    with counted(len(logs), quiet or json_) as progress:
        run = run_campaign(logs, settings, out, workers=count, dask=dask, progress=progress)
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
    if run.failed:
        raise typer.Exit(2 if len(run.failed) == len(run.outcomes) else 1)
