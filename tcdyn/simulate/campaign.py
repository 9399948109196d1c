"""A whole campaign of the synthetic rig in one folder: oven, plunges, EHL tests, rig file and truth; its files."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tcdyn.core.errors import InputError
from tcdyn.core.parallel import parallel_map
from tcdyn.core.result import Result, jsonable
from tcdyn.core.threads import one_blas_thread
from tcdyn.io import write
from tcdyn.io.read import sha256
from tcdyn.rig.disk import DISKS
from tcdyn.rig.rigfile import Rig, load_rig, rig_toml
from tcdyn.simulate.bath import FluidName
from tcdyn.simulate.ehl import EhlOptions, simulate_ehl
from tcdyn.simulate.measure import simulate_oven
from tcdyn.simulate.plunge import PlungeOptions, simulate_plunge
from tcdyn.simulate.programme import PROGRAMME, ehl_test
from tcdyn.simulate.truth import RigTruth, draw_truth, truth_as_dict

_DECIMALS = {"time_s": 6, "friction_N": 4, "load_N": 3}
_WHOLE = ("contact", "switch", "repeat")


def write_log(frame: pd.DataFrame, path: Path) -> None:
    """Write a log as CSV, temperatures to 0.1 mK, times to a microsecond."""
    rounded = frame.astype(float).round(dict.fromkeys(frame, 4) | _DECIMALS)
    write.write_log(rounded.astype({name: np.int64 for name in _WHOLE if name in frame}), path)


def write_traces(frame: pd.DataFrame, path: Path) -> None:
    """Write truth traces as Parquet in single precision (0.01 mK), times in double."""
    write.write_log(
        frame.astype({name: float if name == "time_s" else np.float32 for name in frame}), path
    )


def write_json(data: dict[str, Any], path: Path) -> None:
    """Write plain or numpy numbers as JSON; a key called ``traces`` is left out."""
    write.write_text(
        path,
        json.dumps(jsonable({k: v for k, v in data.items() if k != "traces"}), indent=1) + "\n",
    )


Job = Callable[[], tuple[pd.DataFrame, dict[str, Any]]]  # a log and its truth
Progress = Callable[[str, int, int], None]  # (what is done, jobs done, jobs in all)


@dataclass(frozen=True)
class PlannedPlunge:
    """One planned plunge: the bath and its temperature [degC]."""

    bath_degC: float
    fluid: FluidName = "mobil-jet-ii"


ALL_TESTS = tuple(PROGRAMME)
DEFAULT_PLUNGES = (PlannedPlunge(110.0), PlannedPlunge(138.0))


@dataclass(frozen=True)
class CampaignFiles(Result):
    """Where a campaign's files are; plunges and ovens by disk, EHL logs and traces by test."""

    folder: Path
    rig: Path
    ovens: dict[str, Path]
    plunges: dict[str, tuple[Path, ...]]
    ehl: dict[str, Path]
    truth: Path
    traces: dict[str, Path]

    def summary(self) -> str:
        """What was written where."""
        plunges = ", ".join(f"{len(p)} plunges of the {d} disk" for d, p in self.plunges.items())
        tests = (
            f"{len(self.ehl)} EHL test{'s' if len(self.ehl) != 1 else ''} ({', '.join(self.ehl)})"
        )
        return f"{self.folder}: {self.rig.name}, {len(self.ovens)} oven logs, {plunges}, {tests}; truth in {self.truth}"


@one_blas_thread
def simulate_campaign(
    out_dir: str | Path,
    seed: int = 0,
    tests: Sequence[str] = ("B3",),
    plunges: Sequence[PlannedPlunge] = DEFAULT_PLUNGES,
    *,
    rig: Rig | None = None,
    truth: RigTruth | None = None,
    uncertain: bool = False,
    ehl_options: EhlOptions | None = None,
    plunge_options: PlungeOptions | None = None,
    n_jobs: int = 1,
    progress: Progress | None = None,
) -> CampaignFiles:
    """Write a campaign into ``out_dir``: rig.toml, ovens, plunges, EHL tests and, in truth/, what really happened.

    The files are oven_<disk>.csv, plunge_<disk>_<k>.csv and EHL_<test>.csv; the answer names those of this
    campaign, whatever else lies in the folder. ``rig`` is what people believe (rig.toml); the true rig is ``truth``
    or drawn from ``seed``, steel and geometry as stated unless ``uncertain``. A file depends on the seed and its own
    name only, whatever else is written. ``progress`` is called after each job with its name and the counts. Truth is
    there for people and tests, never for fits. Raises InputError for an unknown test, and where a rig file or a log
    that no simulation wrote would be overwritten.
    """
    tests = tuple(dict.fromkeys(ehl_test(test).name for test in tests))
    folder = Path(out_dir)
    believed = rig or load_rig()
    true = truth or draw_truth(seed, believed, uncertain=uncertain)
    jobs: dict[str, Job] = {}
    for disk in DISKS:
        jobs[f"oven_{disk}"] = partial(simulate_oven, disk, seed, true)
        for run, p in enumerate(plunges, 1):
            job = partial(
                simulate_plunge, disk, seed, p.fluid, p.bath_degC, run, true, plunge_options
            )
            jobs[f"plunge_{disk}_{run}"] = job
    jobs |= {f"EHL_{t}": partial(simulate_ehl, t, seed, true, ehl_options) for t in tests}
    for name in jobs:
        if (folder / f"{name}.csv").exists() and not _traces(folder, name).exists():
            raise _not_ours(folder, f"{name}.csv")
    written = _write_rig(folder, believed)

    scalars: dict[str, dict[str, Any]] = {name: {} for name in jobs}
    results = parallel_map(partial(_run, folder=folder), [*jobs.items()], n_jobs)
    for number, (_, answer) in enumerate(results, 1):
        if isinstance(answer, Exception):
            raise answer
        name, scalars[name] = answer
        if progress:
            progress(name, number, len(jobs))
    files = CampaignFiles(
        folder=folder,
        rig=folder / "rig.toml",
        ovens={d: folder / f"oven_{d}.csv" for d in DISKS},
        plunges={
            d: tuple(folder / f"plunge_{d}_{k + 1}.csv" for k in range(len(plunges))) for d in DISKS
        },
        ehl={t: folder / f"EHL_{t}.csv" for t in tests},
        truth=folder / "truth" / "truth.json",
        traces={name: _traces(folder, name) for name in jobs},
    )
    ehl = {t: scalars.pop(f"EHL_{t}") for t in tests}
    write_json(
        {"seed": seed, "rig_sha256": written, **truth_as_dict(true), "tests": ehl, **scalars},
        files.truth,
    )
    return files


def _write_rig(folder: Path, believed: Rig) -> str:
    """Write rig.toml, or leave one that says the same; the checksum of what the last simulation wrote."""
    path = folder / "rig.toml"
    if path.exists():
        try:
            before = json.loads((folder / "truth" / "truth.json").read_text(encoding="utf-8"))[
                "rig_sha256"
            ]
        except (OSError, ValueError, KeyError, TypeError, RecursionError):
            before = ""
        if load_rig(path) == believed:
            return str(before)
        if sha256(path) != before:
            raise _not_ours(folder, path.name)
    return sha256(write.write_text(path, rig_toml(believed)))


def _not_ours(folder: Path, name: str) -> InputError:
    return InputError(
        f"holds a {name} that no simulation wrote, and it would be overwritten",
        where=str(folder),
        expected="a folder of its own for simulated logs",
        remedy="give another {out}",
        parameters={"out": None},
    )


def _traces(folder: Path, name: str) -> Path:
    return folder / "truth" / f"{name}_traces.parquet"


def _run(named: tuple[str, Job], folder: Path) -> tuple[str, dict[str, Any]]:
    name, job = named
    frame, truth = job()
    write_traces(truth["traces"], _traces(folder, name))
    write_log(frame, folder / f"{name}.csv")
    return name, {k: v for k, v in truth.items() if k != "traces"}
