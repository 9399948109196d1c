"""Simulation of a complete campaign: oven, plunges, EHL tests, rig file, true values.

``tcdyn.simulate_campaign``, ``tcdyn simulate`` and ``tcdyn demo`` use it. Every file has its own
random numbers (``tcdyn.simulate.truth.rng_for``), so that it does not depend on what else is
written. ``tests/simulate/test_campaign.py`` checks the files and that no foreign file is
overwritten.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tcdyn.core.arguments import with_named_arguments
from tcdyn.core.errors import InputError
from tcdyn.core.parallel import parallel_map
from tcdyn.core.result import Result, jsonable
from tcdyn.core.threads import one_blas_thread
from tcdyn.io import write
from tcdyn.io.metadata import SIMULATED_KEY, metadata_path
from tcdyn.io.read import sha256_of_file
from tcdyn.rig.disk import DISKS
from tcdyn.rig.rigfile import Rig, load_rig, rig_toml
from tcdyn.simulate.bath import FluidName
from tcdyn.simulate.ehl import EhlOptions, simulate_ehl
from tcdyn.simulate.measure import simulate_oven
from tcdyn.simulate.plunge import PlungeOptions, simulate_plunge
from tcdyn.simulate.programme import PROGRAMME, ehl_test
from tcdyn.simulate.truth import RigTruth, draw_truth, truth_as_dict

# decimals of a log by column; all other columns have 4
_DECIMALS = {"time_s": 6, "friction_N": 4, "load_N": 3}
_INTEGER_COLUMNS = ("contact", "switch", "repeat")  # Columns of a log that are written as integers.


def write_log(frame: pd.DataFrame, path: Path) -> None:
    """Write a log as CSV, temperatures to 0.1 mK, times to a microsecond; marked as simulated.

    Parameters
    ----------
    frame
        Columns of a log, names with units.
    path
        The CSV file.

    Notes
    -----
    More decimals than the logger resolves (16 bits over 860 K are 13 mK) change nothing but the
    size of the file; fewer would quantise the temperatures twice. ``tests/behaviour`` compares the
    committed logs.
    """
    decimals = dict.fromkeys(frame, 4) | _DECIMALS
    rounded = frame.astype(float).round(decimals)
    integers = {name: np.int64 for name in _INTEGER_COLUMNS if name in frame}
    mark = {SIMULATED_KEY: "by tcdyn"}
    write.write_log(rounded.astype(integers), path, mark)


def write_traces(frame: pd.DataFrame, path: Path) -> None:
    """Write truth traces as Parquet in single precision (0.01 mK), times in double.

    Parameters
    ----------
    frame
        True values in the columns of a log.
    path
        The Parquet file.
    """
    types = dict.fromkeys(frame, np.float32) | {"time_s": float}
    write.write_log(frame.astype({name: types[name] for name in frame}), path)


def write_json(data: dict[str, Any], path: Path) -> None:
    """Write plain or numpy numbers as JSON, without the key ``traces``.

    Parameters
    ----------
    data
        The values; the table of traces is left out because it has its own file.
    path
        The file.
    """
    values = {key: value for key, value in data.items() if key != "traces"}
    write.write_text(path, json.dumps(jsonable(values), indent=1) + "\n")


Job = Callable[[], tuple[pd.DataFrame, dict[str, Any]]]  # returns a log and its true values
Progress = Callable[[str, int, int], None]  # (finished job, number of finished jobs, of all jobs)


@dataclass(frozen=True)
class PlannedPlunge:
    """One planned plunge.

    Parameters
    ----------
    bath_degC
        Temperature of the bath [degC].
    fluid
        Fluid of the bath.
    """

    bath_degC: float
    fluid: FluidName = "mobil-jet-ii"


# Names of all tests of the programme.
ALL_TESTS = tuple(PROGRAMME)
# Plunges of each disk [degC]; two temperatures, chosen by judgement.
DEFAULT_PLUNGES = (PlannedPlunge(110.0), PlannedPlunge(138.0))


@dataclass(frozen=True, repr=False)
class CampaignFiles(Result):
    """Paths of the files of a campaign.

    Parameters
    ----------
    folder
        Folder of the campaign.
    rig
        The file rig.toml.
    ovens, plunges
        Oven log and plunge logs of each disk, by disk.
    ehl
        EHL logs, by test.
    truth
        The JSON file of the true values.
    traces
        Parquet files of the true traces, by the name of the log.
    """

    folder: Path
    rig: Path
    ovens: dict[str, Path]
    plunges: dict[str, tuple[Path, ...]]
    ehl: dict[str, Path]
    truth: Path
    traces: dict[str, Path]

    def summary(self) -> str:
        """Return one line that lists the files."""
        plunges = ", ".join(f"{len(p)} plunges of the {d} disk" for d, p in self.plunges.items())
        plural = "s" if len(self.ehl) != 1 else ""
        tests = f"{len(self.ehl)} EHL test{plural} ({', '.join(self.ehl)})"
        files = f"{self.rig.name}, {len(self.ovens)} oven logs, {plunges}, {tests}"
        return f"{self.folder}: {files}; truth in {self.truth}"


@with_named_arguments
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
    """Simulate a campaign and write its logs, rig file and true values into a folder.

    The files are oven_<disk>.csv, plunge_<disk>_<k>.csv and EHL_<test>.csv. A file depends on the
    seed and its name only, whatever else is written. True values are for people and tests, never
    for fits.

    Parameters
    ----------
    out_dir
        The folder; it is created.
    seed
        Seed of all random draws.
    tests
        Names of the EHL tests (A1 to D4); repeats are ignored.
    plunges
        Plunges of each disk.
    rig
        Nominal rig that is written to rig.toml; by default that of ``load_rig()``.
    truth
        True rig; by default it is drawn from ``seed``.
    uncertain
        Whether steel and geometry of the drawn rig differ from the nominal ones.
    ehl_options, plunge_options
        Times and fixed values of the EHL tests and of the plunges; None for their defaults.
    n_jobs
        Number of worker processes.
    progress
        Called after each job with its name, the number of finished jobs and that of all jobs.

    Returns
    -------
    CampaignFiles
        Files of this campaign, without others in the folder.

    Raises
    ------
    InputError
        For an unknown test, and where a rig file or a log that no simulation wrote would be
        overwritten.

    Notes
    -----
    The names of the files and of the keys in ``truth.json`` are read by other commands and by
    ``tests/simulate/test_campaign.py``. The order of the jobs may be changed: no file depends on
    it.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     files = simulate_campaign(folder, tests=(), plunges=())
    ...     sorted(files.ovens), files.ovens["fast"].name
    (['fast', 'slow'], 'oven_fast.csv')
    """
    tests = tuple(dict.fromkeys(ehl_test(test).name for test in tests))
    folder = Path(out_dir)
    nominal_rig = rig or load_rig()
    true_rig = truth or draw_truth(seed, nominal_rig, uncertain=uncertain)
    jobs: dict[str, Job] = {}
    for disk in DISKS:
        jobs[f"oven_{disk}"] = partial(simulate_oven, disk, seed, true_rig)
        for run, plan in enumerate(plunges, 1):
            bath = (plan.fluid, plan.bath_degC)
            job = partial(simulate_plunge, disk, seed, *bath, run, true_rig, plunge_options)
            jobs[f"plunge_{disk}_{run}"] = job
    for test in tests:
        jobs[f"EHL_{test}"] = partial(simulate_ehl, test, seed, true_rig, ehl_options)
    for name in jobs:
        if (folder / f"{name}.csv").exists() and not _traces(folder, name).exists():
            raise _foreign_file_error(folder, f"{name}.csv")
    n_plunges = len(plunges)
    files = CampaignFiles(
        folder=folder,
        rig=folder / "rig.toml",
        ovens={d: folder / f"oven_{d}.csv" for d in DISKS},
        plunges={
            d: tuple(folder / f"plunge_{d}_{k + 1}.csv" for k in range(n_plunges)) for d in DISKS
        },
        ehl={test: folder / f"EHL_{test}.csv" for test in tests},
        truth=folder / "truth" / "truth.json",
        traces={name: _traces(folder, name) for name in jobs},
    )
    logs = [folder / f"{name}.csv" for name in jobs]
    written = [*logs, *map(metadata_path, logs), *files.traces.values(), files.rig, files.truth]
    with write.removed_on_failure(*written):
        rig_sha256 = _write_rig(folder, nominal_rig)
        true_values: dict[str, dict[str, Any]] = {name: {} for name in jobs}
        results = parallel_map(partial(_run_job, folder=folder), [*jobs.items()], n_jobs)
        for number, (_, result) in enumerate(results, 1):
            if isinstance(result, Exception):
                raise result
            name, true_values[name] = result
            if progress:
                progress(name, number, len(jobs))
        ehl = {test: true_values.pop(f"EHL_{test}") for test in tests}
        header = {"seed": seed, "rig_sha256": rig_sha256}
        write_json(header | truth_as_dict(true_rig) | {"tests": ehl} | true_values, files.truth)
    return files


def _write_rig(folder: Path, rig: Rig) -> str:
    """Write rig.toml unless an equal one exists; return the checksum of the simulated one.

    Parameters
    ----------
    folder
        Folder of the campaign.
    rig
        Nominal rig.

    Returns
    -------
    str
        SHA-256 checksum of the rig file that the simulation wrote last.

    Raises
    ------
    InputError
        Where the folder has another rig file that no simulation wrote.
    """
    path = folder / "rig.toml"
    if path.exists():
        last_sha256 = _last_rig_sha256(folder)
        if load_rig(path) == rig:
            return last_sha256
        if sha256_of_file(path) != last_sha256:
            raise _foreign_file_error(folder, path.name)
    return sha256_of_file(write.write_text(path, rig_toml(rig)))


def _last_rig_sha256(folder: Path) -> str:
    """Return the checksum of the rig file that the last simulation wrote, or an empty text."""
    try:
        truth = json.loads((folder / "truth" / "truth.json").read_text(encoding="utf-8"))
        return str(truth["rig_sha256"])
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return ""


def _foreign_file_error(folder: Path, name: str) -> InputError:
    """Return the error for a file that no simulation wrote."""
    return InputError(
        f"holds a {name} that no simulation wrote, and it would be overwritten",
        where=str(folder),
        expected="a folder of its own for simulated logs",
        remedy="give another {out}",
        parameters={"out": None},
    )


def _traces(folder: Path, name: str) -> Path:
    """Return the path of the true traces of a log."""
    return folder / "truth" / f"{name}_traces.parquet"


def _run_job(named_job: tuple[str, Job], folder: Path) -> tuple[str, dict[str, Any]]:
    """Run a job and write its log and its traces.

    Parameters
    ----------
    named_job
        Name of the log, and the function that makes it.
    folder
        Folder of the campaign.

    Returns
    -------
    name
        The name.
    truth
        True values of the log, without the traces.
    """
    name, job = named_job
    frame, truth = job()
    write_traces(truth["traces"], _traces(folder, name))
    write_log(frame, folder / f"{name}.csv")
    return name, {key: value for key, value in truth.items() if key != "traces"}
