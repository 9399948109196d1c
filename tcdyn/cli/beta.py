"""``tcdyn beta`` and ``tcdyn campaign``: EHL logs and two records to the heat partition, by every way."""

from __future__ import annotations

import os
import sys
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import typer

from tcdyn.cli.common import (
    OwnRigFile,
    RecordFiles,
    Told,
    Verbose,
    bounded,
    counted,
    dump,
    grouped,
    in_one_line,
    spare_inputs,
    stages,
)

Bearing = Annotated[
    Path | None,
    typer.Option(
        help="CSV of a pure-rolling test: load_N, friction_N, speed_slow_rpm; half is added to friction"
    ),
]
Without = Annotated[
    list[str] | None,
    typer.Option(help="channel to leave out, such as fast_c; may be given more than once"),
]
WindowS = Annotated[
    float, bounded("--window-s", "cooling used by the h-only fit", 0, 1e6, ends=False)
]
Seed = Annotated[int, typer.Option(min=0, help="seed of the budget's Monte Carlo")]


@grouped
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
        bool,
        typer.Option(
            help="leave out dead channels, stop at swapped ones, warn of misplaced junctions"
        ),
    ] = True,
    seed: Seed = 0,
    stage: Annotated[
        int | None,
        typer.Option(
            min=1, help="one of several loadings in the log, from 1 (default: all of them)"
        ),
    ] = None,
    verbose: Verbose = False,
    *,
    tell: Told,
) -> None:
    """Heat partition by the speed law, the cooling fits and the joint fits, cross-checked, with an uncertainty budget.

    A log with several loadings and unloadings holds several tests, D4.1, D4.2: each is analysed, numbers go to
    beta.1.json, beta.2.json, and all into one report.

    A log of one disk, with its record alone, gives beta by that disk's joint and cooling fit; both speeds are needed.

    Example: tcdyn beta D4.csv --rig rig.toml --record fast.disk.json --record slow.disk.json --out beta.json
    --report beta.html
    """
    from tcdyn.io.write import write_text
    from tcdyn.rig.opened_log import records_by_disk, refuse_spare_records, rig_of
    from tcdyn.rig.rigfile import load_rig
    from tcdyn.workflows.bearing import read_bearing
    from tcdyn.workflows.beta import estimate_beta, estimate_stages

    spare_inputs([log, rig, bearing, *record], out=out, report=report)
    records = records_by_disk(record)
    own_rig = load_rig(rig) if rig else rig_of(records)
    refuse_spare_records(log, own_rig, records)
    rolling = read_bearing(bearing) if bearing else None
    estimate: Any = estimate_beta
    if len(records) == 1:
        from tcdyn.workflows.single_disk import estimate_one_disk as estimate
    with stages(tell.silent, verbose) as progress:
        options: dict[str, Any] = {
            "window_s": window_s,
            "seed": seed,
            "sensor_check": sensor_check,
            "bearing": rolling,
            "without": without or (),
            "progress": progress,
        }
        if stage is None:
            runs = estimate_stages(log, own_rig, records, estimate, **options)
        else:
            runs = (estimate(log, own_rig, records, stage=stage, **options),)
        data = cache(
            lambda: [run.to_dict() for run in runs]
        )  # with profiles, which a report alone makes beside others
        files = (
            []
            if out is None
            else [out]
            if len(runs) == 1
            else [numbered(out, k) for k in range(1, len(runs) + 1)]
        )
        for k, file in enumerate(files):
            write_text(file, dump(data()[k]))
        if report is not None:
            progress("writing the report")
            from tcdyn.report.beta import write_beta_report
            from tcdyn.report.single_disk import write_one_disk_report
            from tcdyn.report.sources import sources_of

            tests: Any = {run.log.path.stem: run.partition for run in runs}
            write: Any = write_one_disk_report if len(records) == 1 else write_beta_report
            write(report, tests, sources=sources_of(runs, record, rig))
    tell.json(lambda: data()[0] if len(runs) == 1 else data())
    for run in runs:
        if len(runs) > 1:
            tell.say(f"{run.log.path.stem}:")
        tell.warn(run.partition.noticed)  # the summary ends with the verdict
        tell.say(run.summary())
    for file in files:
        tell.files(numbers=file)
    tell.files(report=report)
    doubtful = [run for run in runs if run.partition.status != "sound"]
    for run in doubtful:
        in_one_line(run.log.path.name, run.partition.findings)
    if doubtful:
        raise typer.Exit(1)


def numbered(path: Path, number: int) -> Path:
    """The file of one of several tests in a log.

    >>> numbered(Path("out/beta.json"), 2).name
    'beta.2.json'
    """
    return path.with_name(f"{path.stem}.{number}{path.suffix}")


@grouped
def campaign(
    logs: Annotated[list[Path], typer.Argument(help="EHL logs as they were recorded")],
    record: RecordFiles,
    out: Annotated[
        Path, typer.Option(help="folder for <log>.beta.json, campaign.csv and campaign.html")
    ],
    rig: OwnRigFile = None,
    workers: Annotated[
        int | None,
        typer.Option(
            min=1, max=256, help="processes on this machine (default: 2 where there are two cores)"
        ),
    ] = None,
    dask: Annotated[
        str | None, typer.Option(help="address of a Dask scheduler, e.g. tcp://host:8786")
    ] = None,
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
    *,
    tell: Told,
) -> None:
    """Heat partition of every log of a campaign, in one table with the thesis's figures, and as one measurement.

    What all tests of a rig share is solved for once: campaign.json holds beta with its uncertainty within the campaign
    and absolute, the exponent of the speed law, trends, and which test does not belong; table.csv and table.tex are for
    a paper. What is finished is kept: run the same command again to go on after a stop, or to add logs; a .beta.json
    may stand in the place of its log. A log that cannot be analysed has its reason in the table and does not stop the
    others; the exit code is then 1, and 2 when none could: then table and page of an earlier run stay as they are.

    Example: tcdyn campaign EHL_*.csv --rig rig.toml --record fast.disk.json --record slow.disk.json --out results
    """
    from tcdyn.core.findings import warnings_and_errors
    from tcdyn.rig.disk import left_out_of
    from tcdyn.rig.opened_log import records_by_disk, rig_of
    from tcdyn.rig.rigfile import load_rig
    from tcdyn.workflows.bearing import read_bearing
    from tcdyn.workflows.campaign import (
        OUTPUTS,
        PAGE_FILE,
        TABLE_FILE,
        CampaignSettings,
        run_campaign,
    )

    if dask is not None and workers is not None:
        raise typer.BadParameter("give --workers or --dask, not both")
    for name in OUTPUTS:
        spare_inputs([*logs, rig, bearing, *record, *(model or ())], out=out / name)
    records = records_by_disk(record)
    own_rig = load_rig(rig) if rig else rig_of(records)
    rolling = read_bearing(bearing) if bearing else None
    left_out_of(without or (), own_rig.setups)
    settings = CampaignSettings(own_rig, records, window_s, seed, rolling, tuple(without or ()))
    files = {"table": out / TABLE_FILE, "report": out / PAGE_FILE}
    earlier = {what for what, path in files.items() if path.exists()}
    count = workers or min(2, os.cpu_count() or 1)
    with counted(len(logs), tell.silent) as progress:
        run = run_campaign(
            logs, settings, out, workers=count, dask=dask, models=model or (), progress=progress
        )
    from tcdyn.report.campaign import write_campaign_report
    from tcdyn.report.sources import record_rows

    if nothing := len(run.failed) == len(run.outcomes):
        files = {what: path for what, path in files.items() if what not in earlier}
    if "report" in files:
        write_campaign_report(files["report"], run, record_rows(records, record))
    for lost in run.failed:
        print(f"tcdyn: {lost.error}", file=sys.stderr)
    tell.json(run.card)
    tell.warn(run.findings)
    tell.say(run.summary())
    tell.files(**files)
    in_one_line("campaign", run.findings)
    if run.failed or warnings_and_errors(run.findings):
        raise typer.Exit(2 if nothing else 1)
