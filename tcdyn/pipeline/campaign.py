"""Many EHL logs to one table: spread over workers, resumable, and one failing log does not stop the others."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pandas as pd
from joblib import Parallel, delayed
from joblib.externals.loky.process_executor import TerminatedWorkerError

from calibration.disk import CHANNELS, DISKS
from calibration.errors import InputError
from calibration.files import sha256
from calibration.files.write import write_text
from calibration.finding import Finding, sentences
from calibration.record import DiskRecord
from calibration.result import Result, jsonable
from calibration.rig import Rig
from tcdyn.partition.analyse import WINDOW_S
from tcdyn.partition.events import EhlTest
from tcdyn.partition.window import between, steady_start_s
from tcdyn.pipeline.beta import BearingFile, estimate_beta
from tcdyn.pipeline.campaign_table import AGREE, campaign_table, table_csv, table_row
from tcdyn.version import __version__

Job = TypeVar("Job")
Answer = TypeVar("Answer")

CONNECT_S = 10.0  # to a Dask scheduler
TABLE_FILE, PAGE_FILE = "campaign.csv", "campaign.html"


@dataclass(frozen=True)
class CampaignSettings:
    """What all logs of a campaign are analysed with; ``without``: channels left out of each, such as "fast_c"."""

    rig: Rig
    records: Mapping[str, DiskRecord]
    window_s: float = WINDOW_S
    seed: int = 0
    bearing: BearingFile | None = None
    without: tuple[str, ...] = ()

    def fingerprint(self) -> dict[str, Any]:
        """What must be the same for a stored answer to stand: version, rig, records, bearing file and options."""
        return {
            "version": __version__,
            "rig_sha256": _hash(self.rig.model_dump_json()),
            "records_sha256": {d: _hash(r.to_json()) for d, r in sorted(self.records.items())},
            "bearing_sha256": self.bearing.sha256 if self.bearing else None,
            "window_s": self.window_s,
            "seed": self.seed,
            "without": sorted(self.without) or None,
        }


@dataclass(frozen=True)
class LogOutcome:
    """One log: the content of its beta.json, or the sentence that says why there is none."""

    log: Path
    data: dict[str, Any] | None
    error: str = ""
    kept: bool = False


@dataclass(frozen=True)
class CampaignRun(Result):
    """All logs in the order in which they were given, and their table; ``kept`` counts answers of an earlier run."""

    folder: Path
    outcomes: tuple[LogOutcome, ...]
    table: pd.DataFrame

    @property
    def failed(self) -> tuple[LogOutcome, ...]:
        """The logs that could not be analysed."""
        return tuple(o for o in self.outcomes if o.data is None)

    @property
    def kept(self) -> int:
        """How many answers are those of an earlier run."""
        return sum(o.kept for o in self.outcomes)

    @property
    def findings(self) -> list[Finding]:
        """What was noticed in all tests, each with its log's name; that the ways agree is in the table."""
        return [
            Finding.from_dict(found).at(o.log.stem)
            for o in self.outcomes
            for found in (o.data["findings"] if o.data else [])
            if found["code"] != AGREE
        ]

    def summary(self) -> str:
        """How many logs did what, and the range of beta."""
        good = self.table[self.table["error"] == ""]
        said = (
            f"{len(self.outcomes)} logs: {len(good)} analysed ({self.kept} kept from before), {len(self.failed)} failed"
        )
        if len(good):
            said += f"; beta by the speed law {good['beta'].min():.3f} to {good['beta'].max():.3f}"
            said += f"; the ways agree in {int((good['agree'] == 'yes').sum())} of {len(good)}"
        return said

    def to_dict(self) -> dict[str, Any]:
        """The table, one row a log."""
        return {"folder": str(self.folder), "logs": jsonable(self.table)}

    def card(self) -> pd.DataFrame:
        """The table, one row a log."""
        return self.table


Progress = Callable[[str, int, int], None]  # (log, logs done, logs in all)


def run_campaign(
    logs: Sequence[str | Path],
    settings: CampaignSettings,
    out: str | Path,
    *,
    workers: int = 1,
    dask: str | None = None,
    progress: Progress = lambda *_: None,
) -> CampaignRun:
    """Analyse every log into ``out``/<stem>.beta.json and gather ``out``/campaign.csv.

    A log whose stored answer has the same log, records, rig and settings is not analysed again. Each answer is
    written when it is ready, so a stopped campaign goes on where it was. With ``dask`` (a scheduler's address) the
    workers must see the logs under the same paths. Raises InputError for no log, or two of the same name.
    """
    paths = [Path(p) for p in logs]
    _check_names(paths)
    folder = Path(out)
    outcomes: dict[int, LogOutcome] = {}
    jobs: list[tuple[int, Path]] = []
    for i, path in enumerate(paths):
        kept = _stored(path, folder, settings)
        if kept is None:
            jobs.append((i, path))
        else:
            outcomes[i] = kept
            progress(path.stem, len(outcomes), len(paths))
    work = partial(analyse_log, settings=settings)
    for at, answer in spread(work, [path.resolve() for _, path in jobs], workers, dask):
        i, path = jobs[at]
        if isinstance(answer, Exception):
            answer = f"{path.name}: the worker failed, {type(answer).__name__}: {answer}"
        if isinstance(answer, str):
            outcomes[i] = LogOutcome(path, None, answer)
        else:
            outcomes[i] = LogOutcome(path, answer)
            write_text(_answer_file(path, folder), json.dumps(answer, indent=2, ensure_ascii=False) + "\n")
        progress(path.stem, len(outcomes), len(paths))
    ordered = tuple(outcomes[i] for i in range(len(paths)))
    table = campaign_table([table_row(o.log.stem, o.data, o.error) for o in ordered])
    write_text(folder / TABLE_FILE, table_csv(table))
    return CampaignRun(folder, ordered, table)


def analyse_log(path: Path, settings: CampaignSettings) -> dict[str, Any] | str:
    """The content of one log's beta.json with what a campaign adds to it, or the sentence of its failure."""
    try:
        return _analysed(path, settings)
    except InputError as problem:
        return str(problem).replace(str(path), path.name)
    except Exception as problem:  # one log must not end a campaign of many
        return f"{path.name}: not analysed, {type(problem).__name__}: {problem}"


def _analysed(path: Path, settings: CampaignSettings) -> dict[str, Any]:
    s = settings
    run = estimate_beta(path, s.rig, s.records, window_s=s.window_s, seed=s.seed, bearing=s.bearing, without=s.without)
    test = run.partition.test
    data = run.to_dict()
    found = [replace(f, where=f.where.replace(str(path), path.name)) for f in run.partition.findings]
    data["findings"], data["warnings"] = [f.to_dict() for f in found], list(sentences(found[:-1]))
    steady = steady_degC(test)
    data["campaign"] = {
        **settings.fingerprint(),
        "friction_coefficient": test.friction_N / test.load_N,
        "bearing_N": test.added.value_N if settings.bearing else None,
        "bulk_degC": {d: float(np.mean([x for x in steady[d].values() if x is not None])) for d in DISKS},
        "steady_degC": steady,
    }
    return dict(json.loads(json.dumps(data)))


def steady_degC(test: EhlTest) -> dict[str, dict[str, float | None]]:
    """Mean reading of each junction when steady [degC], None of one left out; their mean is the bulk one (6.4.1)."""
    rows = between(test.time_s, steady_start_s(test), test.events.unload_s - 0.5)
    means = {d: test.disks[d].readings_degC[rows].mean(axis=0) for d in DISKS}
    return {
        d: {c: None if c in test.disks[d].left_out else float(x) for c, x in zip(CHANNELS, means[d])} for d in DISKS
    }


def _stored(path: Path, folder: Path, settings: CampaignSettings) -> LogOutcome | None:
    """The stored answer of an earlier run, when it stands for the same log and settings."""
    try:
        data = json.loads(_answer_file(path, folder).read_text(encoding="utf-8"))
        own, wanted = data["campaign"], settings.fingerprint()
        same = data["source"]["sha256"] == sha256(path) and all(own.get(k) == v for k, v in wanted.items())
        table_row(path.stem, data)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, InputError):
        return None
    return LogOutcome(path, data, kept=True) if same else None


def _answer_file(path: Path, folder: Path) -> Path:
    return folder / f"{path.stem}.beta.json"


def _check_names(paths: Sequence[Path]) -> None:
    if not paths:
        raise InputError("no logs", expected="at least one EHL log")
    seen: dict[str, Path] = {}
    for path in paths:
        if path.stem in seen:
            raise InputError(
                f"two logs are called {path.stem}: {seen[path.stem]} and {path}",
                remedy="rename one: the answers are named after the logs",
            )
        seen[path.stem] = path


def _hash(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


def spread(
    function: Callable[[Job], Answer], jobs: Sequence[Job], workers: int = 1, dask: str | None = None
) -> Iterator[tuple[int, Answer | Exception]]:
    """Yield (position in ``jobs``, answer) in the order in which they are ready.

    ``dask``: address of a scheduler, e.g. "tcp://host:8786"; without it ``workers`` processes of this machine, or
    this process for one. ``function`` should return its failures: an exception that a Dask worker raises comes as
    the answer, any other is raised here. Raises InputError for no worker, or a scheduler that does not answer.

    >>> sorted(spread(abs, [-3, 2]))
    [(0, 3), (1, 2)]
    """
    if dask is not None:
        return _on_dask(function, jobs, dask)
    if workers < 1:
        raise InputError(f"{workers} workers", expected="at least 1")
    if workers == 1 or len(jobs) < 2:
        return ((i, function(job)) for i, job in enumerate(jobs))
    return _in_processes(function, jobs, min(workers, len(jobs)))


def _in_processes(
    function: Callable[[Job], Answer], jobs: Sequence[Job], workers: int
) -> Iterator[tuple[int, Answer | Exception]]:
    pool = Parallel(n_jobs=workers, batch_size=1, return_as="generator_unordered")
    try:
        yield from pool(delayed(lambda i, job: (i, function(job)))(i, job) for i, job in enumerate(jobs))
    except TerminatedWorkerError:
        raise InputError(
            "a worker process was killed, perhaps for want of memory",
            remedy="run the same command with fewer workers; what is finished is kept",
        ) from None


def _on_dask(
    function: Callable[[Job], Answer], jobs: Sequence[Job], address: str
) -> Iterator[tuple[int, Answer | Exception]]:
    try:
        from dask.distributed import Client, as_completed
    except ImportError:
        raise InputError(
            "dask.distributed is not installed",
            remedy="pip install 'tcdyn[dask]', or use workers",
            parameters=("workers",),
        ) from None
    try:
        client = Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TypeError) as problem:
        raise InputError(
            f"no Dask scheduler answers at {address} ({type(problem).__name__})",
            expected="an address such as tcp://host:8786",
            remedy="start one with `dask scheduler` and `dask worker`, or use workers=2",
            parameters=("workers=2",),
        ) from None
    with client:
        place = {client.submit(function, job, pure=False): i for i, job in enumerate(jobs)}
        for future in as_completed(place, loop=client.loop):
            try:
                yield place[future], future.result()
            except Exception as problem:
                yield place[future], problem
