"""Analysis of many EHL logs into one table: parallel, resumable, tolerant of a log that fails.

The command ``tcdyn rig campaign``. One log is :mod:`tcdyn.workflows.campaign_log`, the combined
analysis :func:`tcdyn.campaign.join_results`. Guarded by ``tests/cli/test_campaign_command.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd

from tcdyn.campaign import (
    JoinedCampaign,
    MapComparison,
    compare_maps,
    join_results,
    rig_fingerprint,
)
from tcdyn.campaign.stored_results import (
    RESULT_SUFFIX,
    is_altered,
    merge_findings,
    read_given_result,
    read_result,
)
from tcdyn.campaign.sufficient_statistics import KEYS_SINCE_0_2
from tcdyn.campaign.summary_table import (
    AGREE_CODE,
    campaign_table,
    comparison_table,
    read_compared,
    table_row,
)
from tcdyn.campaign.tables import paper_csv, paper_latex
from tcdyn.campaign.trends import read_curve
from tcdyn.core.errors import InputError, utf8
from tcdyn.core.findings import Finding, error, info
from tcdyn.core.options import options_of
from tcdyn.core.parallel import parallel_map
from tcdyn.core.result import Result, json_text, jsonable
from tcdyn.core.threads import one_blas_thread
from tcdyn.estimation.kalman import compile_functions
from tcdyn.io.read import sha256_of_file
from tcdyn.io.write import table_csv, write_text
from tcdyn.rig.disk import channels_left_out
from tcdyn.rig.opened_log import rig_from_records
from tcdyn.rig.record import DiskRecord
from tcdyn.rig.rigfile import Rig
from tcdyn.workflows.campaign_log import CampaignSettings, analyse_log
from tcdyn.workflows.rig_options import CampaignOptions

# files that a campaign writes into its folder, next to one result a test
TABLE_FILE = "campaign.csv"
PAGE_FILE = "campaign.html"
JOINED_FILE = "campaign.json"
PAPER_FILES = "table.csv", "table.tex"
SIMULATED_CODE = "log.simulated"  # finding of a log that is simulated by its metadata
OUTPUTS = (TABLE_FILE, PAGE_FILE, JOINED_FILE, *PAPER_FILES)


@dataclass(frozen=True)
class LogOutcome:
    """One test: the content of its beta.json, or the message that says why there is none.

    Parameters
    ----------
    log
        The log, or a beta.json that was given in its place.
    data
        Content of beta.json; None if the analysis failed.
    error
        Message of the failure.
    from_earlier_run
        Whether the result is one of an earlier run.
    stage
        Which of several loadings in its log, from 1; 0 in a log with one.
    """

    log: Path
    data: dict[str, Any] | None
    error: str = ""
    from_earlier_run: bool = False
    stage: int = 0

    @property
    def name(self) -> str:
        """Name of the log without its ending, with the number of the loading if any."""
        if self.log.name.endswith(RESULT_SUFFIX):
            return self.log_name.removesuffix(RESULT_SUFFIX)
        return stage_name(self.log, self.stage)

    @property
    def log_name(self) -> str:
        """Name of the log as text: with escapes for what is not UTF-8."""
        return utf8(self.log.name)


@dataclass(frozen=True, repr=False)
class CampaignRun(Result):
    """All tests in the order in which their logs were given, and their table.

    Parameters
    ----------
    folder
        Folder of the results.
    outcomes
        The tests.
    table
        One row a test.
    joined
        All analysed tests as one measurement; None where none was analysed.
    altered
        Logs whose stored result was changed after it had been written.
    compared
        Other tests to compare with.
    interchange
        The maps of two tests before and after an interchange of channels.
    rig
        The rig.
    """

    folder: Path
    outcomes: tuple[LogOutcome, ...]
    table: pd.DataFrame
    joined: JoinedCampaign | None = None
    altered: tuple[str, ...] = ()
    compared: pd.DataFrame | None = None
    interchange: MapComparison | None = None
    rig: Rig | None = None

    @property
    def failed(self) -> tuple[LogOutcome, ...]:
        """The tests that could not be analysed."""
        return tuple(o for o in self.outcomes if o.data is None)

    @property
    def simulated(self) -> tuple[str, ...]:
        """The tests whose logs state that they are simulated."""
        return tuple(
            outcome.name
            for outcome in self.outcomes
            if outcome.data is not None
            and any(finding["code"] == SIMULATED_CODE for finding in outcome.data["findings"])
        )

    @property
    def n_from_earlier_run(self) -> int:
        """Number of results of an earlier run."""
        return sum(o.from_earlier_run for o in self.outcomes)

    @property
    def findings(self) -> list[Finding]:
        """Simulated, altered and withheld results first, then the joint fit, then the tests.

        Findings of the tests are merged by :func:`merge_findings`: one that several tests have
        comes once; simulated logs come in one finding. That the methods agree (``AGREE_CODE``) is
        left out: it is in the table. The same code is left out of the count in
        ``tcdyn.campaign.summary_table.table_row``; change both.
        """
        each = [
            (o.name, Finding.from_dict(finding))
            for o in self.outcomes
            for finding in (o.data["findings"] if o.data else [])
            if finding["code"] not in (AGREE_CODE, SIMULATED_CODE)
        ]
        altered = [info("campaign.altered", subject=name) for name in self.altered]
        simulated = []
        if self.simulated:
            names = list(self.simulated)
            simulated = [info("campaign.simulated", names=names, tests=len(self.outcomes))]
        withheld = [
            error("campaign.withheld", subject=o.name, why=o.data["headline"]["sentence"])
            for o in self.outcomes
            if o.data is not None and o.data["status"] == "withheld"
        ]
        return [
            *simulated,
            *altered,
            *withheld,
            *(self.joined.findings if self.joined else ()),
            *merge_findings(each),
        ]

    def summary(self) -> str:
        """Numbers of logs analysed and failed, and the range of beta."""
        analysed = self.table[self.table["error"] == ""]
        text = (
            f"{len(self.outcomes)} logs: {len(analysed)} analysed ({self.n_from_earlier_run} kept "
            "from before), "
        )
        text += f"{len(self.failed)} failed"
        if len(analysed):
            text += (
                f"; beta by the speed law {analysed['beta'].min():.3f} to "
                f"{analysed['beta'].max():.3f}"
            )
            text += (
                f"; the ways agree in {int((analysed['agree'] == 'yes').sum())} of {len(analysed)}"
            )
        if self.simulated:
            text += f"; {len(self.simulated)} simulated"
        if self.joined is not None and len(self.joined.posterior.tests) > 1:
            u_within, u_total = (
                max(e[k].u for e in self.joined.posterior.estimates)
                for k in ("beta_within", "beta")
            )
            text += (
                f"\nall tests as one: u of beta {u_within:.4f} at most within the "
                f"campaign, {u_total:.4f} absolute"
            )
            text += f"; exponent {self.joined.speed_law.text}"
        if self.interchange is not None:
            text += f"\n{self.interchange.summary()}"
        return text

    def to_dict(self) -> dict[str, Any]:
        """The table, one row a log."""
        return {"folder": str(self.folder), "logs": jsonable(self.table)}

    def to_frame(self) -> pd.DataFrame:
        """The table by log, with the columns of campaign.csv."""
        return self.table.set_index("log")


Progress = Callable[[str, int, int], None]  # (log, logs done, logs in all)


@one_blas_thread
def run_campaign(
    logs: Sequence[str | Path],
    rig: Rig | None,
    records: Mapping[str, DiskRecord],
    out: str | Path,
    *,
    progress: Progress = lambda *_: None,
    **options: Any,
) -> CampaignRun:
    """Analyse every log, and combine the tests into a table and one measurement.

    Parameters
    ----------
    logs
        EHL logs. A <stem>.beta.json is a test whose log is not available: it is used as it is.
    rig, records
        The rig (None: the one that the records were made with) and a record of each disk.
    out
        Folder for <stem>.beta.json, campaign.csv, campaign.json and the tables for a paper.
    progress
        Called with the name of a log, the number of logs done, and the number of all.
    **options
        Fields of :class:`tcdyn.workflows.rig_options.CampaignOptions`. With ``interchanged`` there
        must be two tests, the first before the interchange.

    Returns
    -------
    CampaignRun
        All tests and their table.

    Raises
    ------
    InputError
        For no log, two of the same name, a given result that was changed or is of another rig, and
        a curve that the tests do not reach.

    Notes
    -----
    A log whose stored result has the same log, records, rig and settings
    (``tcdyn.workflows.campaign_log.CampaignSettings.fingerprint``) is not analysed again. Each
    result is written when it is ready, so that a stopped campaign continues where it was. Where no
    log could be analysed, the table of an earlier run is left as it is.
    """
    wanted = options_of(CampaignOptions, options, "run_campaign")
    rig = rig or rig_from_records(records)
    settings = CampaignSettings(rig, records, wanted.of_analysis)
    channels_left_out(wanted.without, rig.setups)
    paths = [Path(p) for p in logs]
    _check_names(paths)
    folder = Path(out)
    curves = [read_curve(path) for path in wanted.curve]
    compare = wanted.compare
    compared = None if compare is None else read_compared(compare)
    outcomes = _given_outcomes(paths, settings)
    altered = tuple(
        p.stem
        for i, p in enumerate(paths)
        if i not in outcomes and is_altered(_answer_file(p, folder, 0))
    )
    _analyse_logs(paths, outcomes, settings, folder, wanted, progress)
    ordered = tuple(one for i in range(len(paths)) for one in outcomes[i])
    table = campaign_table([table_row(o.name, o.data, o.error) for o in ordered])
    if any(o.data is not None for o in ordered) or not (folder / TABLE_FILE).exists():
        write_text(folder / TABLE_FILE, table_csv(table, "%.8g"))
    interchange = None
    if wanted.interchanged:
        interchange = _compare_interchange(ordered, wanted.interchanged)
    joined = join_results({o.name: o.data for o in ordered if o.data is not None}, curves)
    run = CampaignRun(folder, ordered, table, joined, altered, compared, interchange, rig)
    _write_joined(run)
    return run


def _given_outcomes(
    paths: Sequence[Path], settings: CampaignSettings
) -> dict[int, list[LogOutcome]]:
    """Tests that were given by their results, by the position of the result among the logs.

    Parameters
    ----------
    paths
        Logs and results.
    settings
        Settings of the campaign.

    Raises
    ------
    InputError
        For a result that was changed or is of another rig.
    """
    given = [(i, path) for i, path in enumerate(paths) if path.name.endswith(RESULT_SUFFIX)]
    if not given:
        return {}
    rig = rig_fingerprint(settings.rig, settings.records)
    rig_of_0_2 = rig_fingerprint(settings.rig, settings.records, later_keys=KEYS_SINCE_0_2)
    return {
        i: [LogOutcome(path, read_given_result(path, rig, rig_of_0_2), from_earlier_run=True)]
        for i, path in given
    }


def _analyse_logs(
    paths: Sequence[Path],
    outcomes: dict[int, list[LogOutcome]],
    settings: CampaignSettings,
    folder: Path,
    options: CampaignOptions,
    progress: Progress,
) -> None:
    """Add the tests of each log to ``outcomes``: stored ones, and those of the analysis.

    Parameters
    ----------
    paths
        Logs and results.
    outcomes
        Tests by position among the logs; those of the results that were given are there already.
    settings
        Settings of the campaign.
    folder
        Folder of the results, which are written when they are ready.
    options
        Options of the campaign.
    progress
        As of :func:`run_campaign`.
    """
    jobs: list[tuple[int, Path]] = []
    for i, path in enumerate(paths):
        if i in outcomes:
            continue
        stored = _stored_outcomes(path, folder, settings)
        if stored:
            outcomes[i] = stored
            progress(path.stem, len(outcomes), len(paths))
        else:
            jobs.append((i, path))
    work = partial(analyse_log, settings=settings)
    full_paths = [path.absolute() for _, path in jobs]
    if options.n_workers > 1:
        compile_functions()
    for job, answer in parallel_map(work, full_paths, options.n_workers, options.dask):
        i, path = jobs[job]
        if isinstance(answer, Exception):
            answer = [f"{path.name}: the worker failed, {type(answer).__name__}: {answer}"]
        outcomes[i] = [
            _analysed_outcome(path, one, stage if len(answer) > 1 else 0, folder)
            for stage, one in enumerate(answer, 1)
        ]
        progress(path.stem, len(outcomes), len(paths))


def _analysed_outcome(
    path: Path, answer: dict[str, Any] | str, stage: int, folder: Path
) -> LogOutcome:
    """One test of a log; its result is written.

    Parameters
    ----------
    path
        The log.
    answer
        Content of beta.json, or the message of the failure.
    stage
        Number of the test in its log; 0 in a log with one.
    folder
        Folder of the results.
    """
    if isinstance(answer, str):
        return LogOutcome(path, None, utf8(answer), stage=stage)
    write_text(_answer_file(path, folder, stage), json_text(answer))
    return LogOutcome(path, answer, stage=stage)


def _write_joined(run: CampaignRun) -> None:
    """Write campaign.json and the tables for a paper; nothing where no log could be analysed."""
    if run.joined is None:
        return
    content = run.joined.to_dict()
    if run.interchange is not None:
        content["interchange"] = run.interchange.to_dict()
    if run.compared is not None:
        content["compared"] = comparison_table(run.table, run.compared)
    write_text(run.folder / JOINED_FILE, json_text(content))
    for name, text in zip(PAPER_FILES, (paper_csv(run.joined), paper_latex(run.joined))):
        write_text(run.folder / name, text)


def _compare_interchange(
    outcomes: Sequence[LogOutcome], interchanged: Sequence[str]
) -> MapComparison:
    """Compare the maps of two tests before and after an interchange of channels.

    Parameters
    ----------
    outcomes
        The tests; the first is before the interchange.
    interchanged
        The two junctions.

    Raises
    ------
    InputError
        Unless there are two tests that were analysed by ``campaign``.
    """
    tests = {}
    for outcome in outcomes:
        results = outcome.data or {}
        if "map_degC" in results.get("campaign", {}):
            tests[outcome.name] = results["campaign"]["map_degC"]
    if len(outcomes) != 2 or len(tests) != 2:
        reasons = [outcome.error for outcome in outcomes if outcome.error]
        raise InputError(
            f"{len(tests)} of {len(outcomes)} tests can be compared before and after an "
            "interchange",
            expected="two tests, the first before and the second after it",
            remedy="; ".join(reasons) or "analyse the logs anew, into another folder",
        )
    first, second = tests
    one, other = interchanged
    return compare_maps(tests[first], tests[second], (one, other), (first, second))


def _stored_outcomes(path: Path, folder: Path, settings: CampaignSettings) -> list[LogOutcome]:
    """Results of an earlier run; none unless all tests of the log have this log and settings.

    Parameters
    ----------
    path
        The log.
    folder
        Folder of the results.
    settings
        Settings of this run.
    """
    try:
        first = 0 if _answer_file(path, folder, 0).exists() else 1
        count = read_result(_answer_file(path, folder, first))["campaign"]["stages"]
        return [
            _stored_one(path, folder, settings, k)
            for k in ([0] if count == 1 else range(1, count + 1))
        ]
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return []


def _stored_one(path: Path, folder: Path, settings: CampaignSettings, stage: int) -> LogOutcome:
    """Result of an earlier run for one test.

    Parameters
    ----------
    path, folder, settings
        As for ``_stored_outcomes``.
    stage
        Number of the test in its log; 0 in a log with one.

    Raises
    ------
    ValueError
        If it is of another log or other settings.
    """
    data = read_result(_answer_file(path, folder, stage))
    stored = data["campaign"]
    requested = settings.fingerprint()
    if data["source"]["sha256"] != sha256_of_file(path) or any(
        stored.get(k) != v for k, v in requested.items()
    ):
        raise ValueError("of another log or other settings")
    table_row(path.stem, data)
    return LogOutcome(path, data, from_earlier_run=True, stage=stage)


def stage_name(path: Path, stage: int) -> str:
    """Name of a test: that of its log, with the number of its loading where there are several.

    >>> stage_name(Path("EHL_D4.csv"), 0), stage_name(Path("EHL_D4.csv"), 2)
    ('EHL_D4', 'EHL_D4.2')
    """
    return utf8(path.stem) + (f".{stage}" if stage else "")


def _answer_file(path: Path, folder: Path, stage: int) -> Path:
    """File of the result of one test of a log."""
    return folder / f"{stage_name(path, stage)}{RESULT_SUFFIX}"


def _check_names(paths: Sequence[Path]) -> None:
    """Check that there are logs, and that the results of no two can have the same name.

    Names that differ only in upper and lower case are one file on Windows and macOS. The tests of a
    log D4 with several loadings are D4.1 and so on, as the one of a log D4.1.

    Raises
    ------
    InputError
        Otherwise.
    """
    if not paths:
        raise InputError("no logs", expected="at least one EHL log")
    path_of_name: dict[str, Path] = {}
    for path in paths:
        name = LogOutcome(path, None).name.casefold()
        if name in path_of_name:
            raise InputError(
                f"two logs are called {path.stem}: {path_of_name[name]} and {path}",
                remedy="rename one: the answers are named after the logs",
            )
        path_of_name[name] = path
    for name, path in path_of_name.items():
        log, _, stage = name.rpartition(".")
        if stage.isdecimal() and log in path_of_name:
            raise InputError(
                f"{path} is called as a later loading of {path_of_name[log]} would be",
                remedy="rename one: the answers are named after the logs",
            )
