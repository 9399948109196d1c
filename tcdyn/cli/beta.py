"""Commands ``tcdyn rig beta`` and ``tcdyn rig campaign``: heat partition from EHL logs and records.

The estimates come from :mod:`tcdyn.workflows.beta` and :mod:`tcdyn.workflows.campaign`. Tests:
``tests/cli/test_options.py``, ``tests/cli/test_campaign_command.py``.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tcdyn.cli.common import (
    NOT_TRUSTED,
    OutFile,
    RecordFiles,
    Reporter,
    RigFileOrRecords,
    Verbose,
    check_folder,
    check_outputs,
    count_progress,
    options_from_docstring,
    stage_progress,
    write_json,
)
from tcdyn.core.errors import printable
from tcdyn.io.endings import JSON, PAGE, FileKind
from tcdyn.series.options import ReadingOptions
from tcdyn.workflows.rig_options import BetaOptions, CampaignOptions

if TYPE_CHECKING:
    from tcdyn.rig.record import DiskRecord
    from tcdyn.rig.rigfile import Rig
    from tcdyn.workflows.beta import BetaRun
    from tcdyn.workflows.campaign import CampaignRun


@options_from_docstring
def beta(
    log: Path,
    record: RecordFiles,
    rig: RigFileOrRecords = None,
    out: OutFile = None,
    report: OutFile = None,
    verbose: Verbose = False,
    *,
    options: BetaOptions,
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
    """
    from tcdyn.io.read import display_path
    from tcdyn.rig.opened_log import check_records_used, column_names
    from tcdyn.workflows.beta import estimate_stages

    read_files = [log, rig, options.bearing_path, *record]
    check_outputs(read_files, reporter.overwrite, out=(out, JSON), report=(report, PAGE))
    records, settings = _records_and_rig(record, rig, reading)
    check_records_used(column_names(log, settings), settings, records, display_path(log))
    with stage_progress(reporter.is_silent, verbose) as progress:
        runs = estimate_stages(log, settings, records, progress=progress, **options.stated)
        files = [] if out is None else _output_files(out, len(runs))
        # computed once, and only where it is written: it may include the likelihood profiles
        contents = cache(lambda: [run.to_dict() for run in runs])
        if len(files) > 1:  # names that only the unloadings in the log determine
            for file in files:
                check_outputs([log], reporter.overwrite, out=(file, JSON))
        for k, file in enumerate(files):
            write_json(file, contents()[k])
        if report is not None:
            progress("writing the report")
            _write_report(report, runs, record, rig)
    reporter.json(lambda: contents()[0] if len(runs) == 1 else contents())
    _print_runs(runs, files, report, reporter)


def _records_and_rig(
    files: list[Path], rig: Path | None, reading: ReadingOptions
) -> tuple[dict[str, DiskRecord], Rig]:
    """The records by disk, and the rig file or the rig that they were made with.

    Parameters
    ----------
    files
        Disk records.
    rig
        Rig file; None: that of the records.
    reading
        How the rows of a log are read.
    """
    from tcdyn.rig.opened_log import records_by_disk, rig_from_records
    from tcdyn.rig.rigfile import load_rig

    records = records_by_disk(files)
    settings = load_rig(rig) if rig else rig_from_records(records)
    return records, settings.with_reading(reading)


def _write_report(
    path: Path, runs: Sequence[BetaRun], records: list[Path], rig: Path | None
) -> None:
    """Write the page with all tests of a log.

    Parameters
    ----------
    path
        File to write.
    runs
        The tests.
    records, rig
        Files that they were analysed with.
    """
    from tcdyn.report.beta import write_beta_report
    from tcdyn.report.sources import source_table

    tests = {run.log.path.stem: run.partition for run in runs}
    write_beta_report(path, tests, sources=source_table(runs, records, rig))


def _print_runs(
    runs: Sequence[BetaRun], files: Sequence[Path], report: Path | None, reporter: Reporter
) -> None:
    """Print the tests of a log, the files that were written, and the findings.

    Parameters
    ----------
    runs
        The tests.
    files, report
        Files that were written.
    reporter
        Output of the command.

    Raises
    ------
    typer.Exit
        If a result is not to be trusted.
    """
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
    out: Annotated[Path, typer.Option(rich_help_panel="Output")],
    rig: RigFileOrRecords = None,
    *,
    options: CampaignOptions,
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
    """
    from tcdyn.core.parallel import worker_processes_end
    from tcdyn.workflows.campaign import run_campaign

    check_folder(out)
    read_files = [*logs, rig, options.bearing_path, *options.compared_files, *record]
    _check_campaign_files(out, read_files, reporter.overwrite)
    records, settings = _records_and_rig(record, rig, reading)
    before = {path for path in _campaign_files(out).values() if path.exists()}
    uses_processes = options.n_workers > 1 and len(logs) > 1
    with (
        worker_processes_end() if uses_processes else nullcontext(),
        count_progress(len(logs), reporter.is_silent) as progress,
    ):
        run = run_campaign(logs, settings, records, out, progress=progress, **options.stated)
    _write_and_print(run, records, record, before, reporter)


def _campaign_files(out: Path) -> dict[str, Path]:
    """Table and page of a campaign, by what they are."""
    from tcdyn.workflows.campaign import PAGE_FILE, TABLE_FILE

    return {"table": out / TABLE_FILE, "report": out / PAGE_FILE}


def _check_campaign_files(
    out: Path, read_files: Sequence[Path | str | None], overwrite: bool
) -> None:
    """Check that the files of a campaign may be written; those of an earlier run may be replaced.

    Parameters
    ----------
    out
        Folder of the campaign.
    read_files
        Files that are read.
    overwrite
        Whether any file may be replaced.
    """
    from tcdyn.workflows.campaign import OUTPUTS

    page = _campaign_files(out)["report"]
    is_earlier_run = page.is_file() and b"tcdyn" in page.read_bytes()
    for name in OUTPUTS:
        file = out / name
        kind = FileKind(name, (file.suffix,))
        check_outputs(read_files, overwrite or is_earlier_run, out=(file, kind))


def _write_and_print(
    run: CampaignRun,
    records: Mapping[str, DiskRecord],
    record_files: list[Path],
    before: set[Path],
    reporter: Reporter,
) -> None:
    """Write the page of a campaign, and print its result.

    Parameters
    ----------
    run
        The campaign.
    records, record_files
        The disk records, and their files.
    before
        Table and page of an earlier run, which are kept if no log could be analysed.
    reporter
        Output of the command.

    Raises
    ------
    typer.Exit
        With code 2 if no log could be analysed, with 1 if one could not, or if a result is not to
        be trusted.
    """
    from tcdyn.report.campaign import write_campaign_report
    from tcdyn.report.sources import record_rows

    files = _campaign_files(run.folder)
    all_failed = len(run.failed) == len(run.outcomes)
    if all_failed:
        files = {content: path for content, path in files.items() if path not in before}
    if "report" in files:
        write_campaign_report(files["report"], run, record_rows(records, record_files))
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
