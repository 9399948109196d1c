"""Commands ``tcdyn rig beta`` and ``tcdyn rig campaign``: heat partition from EHL logs and records.

The estimates come from :mod:`tcdyn.workflows.beta` and :mod:`tcdyn.workflows.campaign`. Tests:
``tests/cli/test_options.py``, ``tests/cli/test_campaign_command.py``.
"""

from __future__ import annotations

import os
import sys
from contextlib import nullcontext
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import typer

from tcdyn.cli.common import (
    NOT_TRUSTED,
    RecordFiles,
    Reporter,
    RigFileOrRecords,
    Verbose,
    check_folder,
    check_outputs,
    count_progress,
    number_option,
    options_from_docstring,
    stage_progress,
    write_json,
)
from tcdyn.core.errors import InputError, printable
from tcdyn.io.endings import JSON, PAGE, FileKind
from tcdyn.series.options import ReadingOptions

Bearing = Annotated[
    Path | None,
    typer.Option(
        help="CSV of a pure-rolling test with the columns load_N, friction_N, speed_slow_rpm; half "
        "of its friction is added to that of the test"
    ),
]
Without = Annotated[
    list[str] | None,
    typer.Option(help="channel not to use, such as fast_c; repeat for several"),
]
Seed = Annotated[int, typer.Option(min=0, help="seed of the Monte Carlo of the uncertainty budget")]


@options_from_docstring
def beta(
    log: Path,
    record: RecordFiles,
    rig: RigFileOrRecords = None,
    out: Path | None = None,
    report: Path | None = None,
    bearing: Bearing = None,
    without: Without = None,
    window_s: Annotated[float, number_option(0, 1e6, ends=False)] = 5.0,
    sensor_check: bool = True,
    seed: Seed = 0,
    profiles: bool = False,
    stage: Annotated[int | None, typer.Option(min=1)] = None,
    verbose: Verbose = False,
    *,
    reading: ReadingOptions,
    reporter: Reporter,
) -> None:
    """Estimate the heat partition beta from an EHL log, with an uncertainty budget.

    Beta is estimated by the speed law, the cooling fits and the joint fits, and the estimates are
    compared.

    A log with several loadings contains several tests, D4.1, D4.2 and so on. Each is analysed. The
    numbers are written to beta.1.json, beta.2.json and so on, and all tests to one report.

    A log of one disk needs the record of that disk only. Beta is then estimated by the joint fit
    and the cooling fit of this disk. The log must contain both speeds.

    Example: tcdyn rig beta D4.csv --rig rig.toml --record fast.disk.json --record slow.disk.json
    --out beta.json --report beta.html

    Parameters
    ----------
    log
        EHL log as recorded (not compensated)
    out
        beta.json to write
    report
        HTML report to write
    window_s
        length of the cooling fit in seconds
    sensor_check
        exclude dead channels, stop if channels are swapped, warn of misplaced junctions
    profiles
        write the likelihood profiles of the joint fits into beta.json; the report always has them
    stage
        analyse one of several loadings in the log, from 1 (default: all)
    """
    from tcdyn.io.read import display_path
    from tcdyn.partition.operating_conditions import read_bearing
    from tcdyn.rig.opened_log import (
        check_records_used,
        column_names,
        records_by_disk,
        rig_from_records,
    )
    from tcdyn.rig.rigfile import load_rig
    from tcdyn.workflows.beta import estimate_beta, estimate_stages

    read_files = [log, rig, bearing, *record]
    check_outputs(read_files, reporter.overwrite, out=(out, JSON), report=(report, PAGE))
    records = records_by_disk(record)
    rig_settings = load_rig(rig) if rig else rig_from_records(records)
    rig_settings = rig_settings.with_reading(reading)
    names = column_names(log, rig_settings)
    check_records_used(names, rig_settings, records, display_path(log))
    rolling = read_bearing(bearing) if bearing else None
    with stage_progress(reporter.is_silent, verbose) as progress:
        options: dict[str, Any] = {
            "window_s": window_s,
            "seed": seed,
            "sensor_check": sensor_check,
            "bearing": rolling,
            "without": without or (),
            "profiles": profiles,
            "progress": progress,
        }
        if stage is None:
            runs = estimate_stages(log, rig_settings, records, **options)
        else:
            runs = (estimate_beta(log, rig_settings, records, stage=stage, **options),)
        files = []
        if out is not None:
            files = _output_files(out, len(runs))
        # computed once, and only where it is written: it may include the likelihood profiles
        contents = cache(lambda: [run.to_dict() for run in runs])
        if len(files) > 1:  # names that only the unloadings in the log determine
            for file in files:
                check_outputs([log], reporter.overwrite, out=(file, JSON))
        for k, file in enumerate(files):
            write_json(file, contents()[k])
        if report is not None:
            progress("writing the report")
            from tcdyn.report.beta import write_beta_report
            from tcdyn.report.sources import source_table

            tests = {run.log.path.stem: run.partition for run in runs}
            write_beta_report(report, tests, sources=source_table(runs, record, rig))
    reporter.json(lambda: contents()[0] if len(runs) == 1 else contents())
    for run in runs:
        if len(runs) > 1:
            reporter.text(f"{run.log.path.stem}:")
        reporter.summary(run.summary())
    for file in files:
        reporter.files(numbers=file)
    reporter.files(report=report)
    is_trusted = True
    for run in runs:
        partition = run.partition
        conclusions = (partition.crosscheck.finding, partition.recommendation)
        name = run.log.path.name
        is_trusted &= reporter.report(name, partition.analysis_findings, conclusions)
    if not is_trusted:
        raise typer.Exit(NOT_TRUSTED)


def _output_files(out: Path, count: int) -> list[Path]:
    """Files for the numbers of the tests of a log: ``out``, or numbered ones for several.

    Parameters
    ----------
    out
        File that the user named.
    count
        Number of tests.

    Examples
    --------
    >>> [path.name for path in _output_files(Path("out/beta.json"), 2)]
    ['beta.1.json', 'beta.2.json']
    """
    if count == 1:
        return [out]
    return [out.with_name(f"{out.stem}.{k}{out.suffix}") for k in range(1, count + 1)]


@options_from_docstring
def campaign(
    logs: list[Path],
    record: RecordFiles,
    out: Annotated[Path, typer.Option()],
    rig: RigFileOrRecords = None,
    workers: Annotated[int | None, typer.Option(min=1, max=256)] = None,
    dask: str | None = None,
    bearing: Bearing = None,
    without: Without = None,
    curve: list[Path] | None = None,
    compare: Path | None = None,
    interchanged: list[str] | None = None,
    window_s: Annotated[float, number_option(0, 1e6, ends=False)] = 5.0,
    seed: Seed = 0,
    *,
    reading: ReadingOptions,
    reporter: Reporter,
) -> None:
    """Estimate the heat partition of every log of a campaign, separately and together.

    Errors that all tests of a rig share are estimated once. campaign.json contains beta with its
    uncertainty within the campaign and absolute, the exponent of the speed law, trends, and
    outlying tests. campaign.csv and campaign.html contain all tests, with the figures of the
    thesis; table.csv and table.tex are for a paper.

    Finished results are stored. Run the same command again to continue after an interruption, or to
    add logs. Instead of a log you may give its .beta.json.

    If a log cannot be analysed, the table contains the reason, the other logs are analysed, and the
    exit code is 1. If none can be analysed, the exit code is 2, and table and page of an earlier
    run are not changed.

    Example: tcdyn rig campaign EHL_*.csv --rig rig.toml --record fast.disk.json --record
    slow.disk.json --out results

    Parameters
    ----------
    logs
        EHL logs as recorded
    out
        folder for <log>.beta.json, campaign.csv and campaign.html
    workers
        worker processes (default: 2 if there are two cores)
    dask
        address of a Dask scheduler, e.g. tcp://host:8786
    curve
        CSV of a model curve to compare with beta: one of delta_T_us_K_m_s, load_N,
        sliding_speed_m_s, entraining_speed_m_s; beta; u_beta if known; repeat for several
    compare
        table of other tests to compare with, such as a campaign.csv: load_N, sliding_speed_m_s and
        friction_N, fast_bulk_degC or other columns of campaign.csv
    interchanged
        of two logs of one test: a junction whose channel was interchanged with that of another one
        between them, such as slow_a; give it twice; compares the temperature maps (section 6.4.2.4)
    window_s
        length of the cooling fit in seconds
    """
    from tcdyn.core.parallel import worker_processes_end
    from tcdyn.partition.operating_conditions import read_bearing
    from tcdyn.report.campaign import write_campaign_report
    from tcdyn.report.sources import record_rows
    from tcdyn.rig.disk import channels_left_out
    from tcdyn.rig.opened_log import records_by_disk, rig_from_records
    from tcdyn.rig.rigfile import load_rig
    from tcdyn.workflows.campaign import (
        OUTPUTS,
        PAGE_FILE,
        TABLE_FILE,
        CampaignSettings,
        run_campaign,
    )

    if dask is not None and workers is not None:
        raise typer.BadParameter("give --workers or --dask, not both")
    check_folder(out)
    read_files = [*logs, rig, bearing, compare, *record, *(curve or ())]
    page = out / PAGE_FILE
    is_earlier_run = page.is_file() and b"tcdyn" in page.read_bytes()
    overwrite = reporter.overwrite or is_earlier_run
    for name in OUTPUTS:
        file = out / name
        check_outputs(read_files, overwrite, out=(file, FileKind(name, (file.suffix,))))
    records = records_by_disk(record)
    rig_settings = load_rig(rig) if rig else rig_from_records(records)
    rig_settings = rig_settings.with_reading(reading)
    rolling = read_bearing(bearing) if bearing else None
    channels_left_out(without or (), rig_settings.setups)
    pair = tuple(interchanged or ())
    if len(pair) not in (0, 2):
        raise InputError(
            f"--interchanged is given {len(pair)} times",
            expected="two junctions: --interchanged slow_a --interchanged slow_c",
        )
    settings = CampaignSettings(
        rig_settings, records, window_s, seed, rolling, tuple(without or ())
    )
    files = {"table": out / TABLE_FILE, "report": out / PAGE_FILE}
    existing = {content for content, path in files.items() if path.exists()}
    n_workers = workers or min(2, os.cpu_count() or 1)
    uses_processes = dask is None and n_workers > 1 and len(logs) > 1
    with (
        worker_processes_end() if uses_processes else nullcontext(),
        count_progress(len(logs), reporter.is_silent) as progress,
    ):
        run = run_campaign(
            logs,
            settings,
            out,
            workers=n_workers,
            dask=dask,
            models=curve or (),
            compare=compare,
            interchanged=(pair[0], pair[1]) if pair else None,
            progress=progress,
        )
    all_failed = len(run.failed) == len(run.outcomes)
    if all_failed:
        files = {content: path for content, path in files.items() if content not in existing}
    if "report" in files:
        write_campaign_report(files["report"], run, record_rows(records, record))
    for outcome in run.failed:
        print(f"tcdyn: {printable(str(outcome.error))}", file=sys.stderr)
    reporter.json(run.card)
    reporter.summary(run.summary())
    reporter.files(**files)
    if all_failed:
        raise typer.Exit(2)
    is_trusted = reporter.report("campaign", run.findings)
    if run.failed or not is_trusted:
        raise typer.Exit(NOT_TRUSTED)
