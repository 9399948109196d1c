"""Many EHL logs to one table: spread over workers, resumable, and one failing log does not stop the others."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from calibration.disk import CHANNELS, DISKS
from calibration.errors import InputError
from calibration.files import sha256
from calibration.files.write import write_text
from calibration.finding import Finding, note, sentences
from calibration.record import DiskRecord
from calibration.result import Result, jsonable
from calibration.rig import Rig
from tcdyn.campaign import JoinedCampaign, joined, rig_fingerprint, sealed
from tcdyn.campaign.tables import paper_csv, paper_latex
from tcdyn.campaign.trends import read_curve
from tcdyn.partition.analyse import WINDOW_S
from tcdyn.partition.events import EhlTest
from tcdyn.partition.window import between, steady_start_s
from tcdyn.pipeline.answers import ANSWER, given_answer, is_altered, read_answer, said_once
from tcdyn.pipeline.bearing import BearingFile
from tcdyn.pipeline.beta import estimate_beta
from tcdyn.pipeline.campaign_table import AGREE, campaign_table, table_csv, table_row
from tcdyn.pipeline.spread import spread
from tcdyn.version import __version__

TABLE_FILE, PAGE_FILE, JOINED_FILE = "campaign.csv", "campaign.html", "campaign.json"
PAPER_FILES = "table.csv", "table.tex"
OUTPUTS = (TABLE_FILE, PAGE_FILE, JOINED_FILE, *PAPER_FILES)


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

    @property
    def name(self) -> str:
        """The log's name without its ending, also of an answer that was given in its place."""
        return self.log.name.removesuffix(ANSWER) if self.log.name.endswith(ANSWER) else self.log.stem


@dataclass(frozen=True)
class CampaignRun(Result):
    """All logs in the order in which they were given, and their table; ``kept`` counts answers of an earlier run.

    ``joined``: all that were analysed as one measurement, None where none was; ``altered``: logs whose stored answer
    was not as it had been written.
    """

    folder: Path
    outcomes: tuple[LogOutcome, ...]
    table: pd.DataFrame
    joined: JoinedCampaign | None = None
    altered: tuple[str, ...] = ()

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
        """What all tests together show, then what was noticed in each, with its log's name; what repeats is said once.

        That the ways agree is in the table.
        """
        each = [
            (o.name, Finding.from_dict(found))
            for o in self.outcomes
            for found in (o.data["findings"] if o.data else [])
            if found["code"] != AGREE
        ]
        own = [note("campaign.altered", subject=name) for name in self.altered]
        return [*own, *(self.joined.findings if self.joined else ()), *said_once(each)]

    def summary(self) -> str:
        """How many logs did what, and the range of beta."""
        good = self.table[self.table["error"] == ""]
        said = (
            f"{len(self.outcomes)} logs: {len(good)} analysed ({self.kept} kept from before), {len(self.failed)} failed"
        )
        if len(good):
            said += f"; beta by the speed law {good['beta'].min():.3f} to {good['beta'].max():.3f}"
            said += f"; the ways agree in {int((good['agree'] == 'yes').sum())} of {len(good)}"
        if self.joined is not None and len(self.joined.posterior.tests) > 1:
            inside, whole = (max(e[k].u for e in self.joined.posterior.estimates) for k in ("beta_within", "beta"))
            said += f"\nall tests as one: u of beta {inside:.4f} at most within the campaign, {whole:.4f} absolute"
            said += f"; exponent n {self.joined.law.exponent}"
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
    models: Sequence[str | Path] = (),
    progress: Progress = lambda *_: None,
) -> CampaignRun:
    """Analyse every log into ``out``/<stem>.beta.json; gather ``out``/campaign.csv and, as one, ``out``/campaign.json.

    A log whose stored answer has the same log, records, rig and settings is not analysed again. Each answer is
    written when it is ready, so a stopped campaign goes on where it was. A <stem>.beta.json among ``logs`` is a test
    whose log is not at hand: it stands as it is. ``models``: files of curves to lay over the tests. With ``dask`` (a
    scheduler's address) the workers must see the logs under the same paths. Raises InputError for no log, two of the
    same name, a given answer that is not as it was written or of another rig, and a curve that the tests do not reach.
    """
    paths = [Path(p) for p in logs]
    _check_names(paths)
    folder, curves = Path(out), [read_curve(path) for path in models]
    rig = rig_fingerprint(settings.rig, settings.records)
    outcomes: dict[int, LogOutcome] = {
        i: LogOutcome(path, given_answer(path, rig), kept=True)
        for i, path in enumerate(paths)
        if path.name.endswith(ANSWER)
    }
    jobs: list[tuple[int, Path]] = []
    altered = tuple(p.stem for i, p in enumerate(paths) if i not in outcomes and is_altered(_answer_file(p, folder)))
    for i, path in enumerate(paths):
        if i in outcomes:
            continue
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
    table = campaign_table([table_row(o.name, o.data, o.error) for o in ordered])
    write_text(folder / TABLE_FILE, table_csv(table))
    whole = joined({o.name: o.data for o in ordered if o.data is not None}, curves)
    if whole is not None:
        write_text(folder / JOINED_FILE, json.dumps(jsonable(whole.to_dict()), indent=2, ensure_ascii=False) + "\n")
        for name, text in zip(PAPER_FILES, (paper_csv(whole), paper_latex(whole))):
            write_text(folder / name, text)
    return CampaignRun(folder, ordered, table, whole, altered)


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
    return sealed(data)


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
        data = read_answer(_answer_file(path, folder))
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
