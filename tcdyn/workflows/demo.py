"""Demonstration on a simulated campaign: simulate, calibrate, compensate, analyse, compare.

The command ``tcdyn demo``. Guarded by ``tests/core/test_results.py``.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tcdyn.core.arguments import with_named_arguments
from tcdyn.core.estimate import rounded_texts
from tcdyn.core.progress import Progress, no_progress
from tcdyn.core.result import Result, json_text, jsonable
from tcdyn.core.threads import one_blas_thread
from tcdyn.io.write import write_text
from tcdyn.rig.disk import DISKS
from tcdyn.rig.log import write_log
from tcdyn.rig.record import DiskRecord, read_record, write_record
from tcdyn.rig.rigfile import Rig, load_rig
from tcdyn.simulate.campaign import CampaignFiles, simulate_campaign
from tcdyn.workflows.beta import BetaRun, estimate_beta
from tcdyn.workflows.calibrate import CalibrationRun, calibrate_disk
from tcdyn.workflows.compensate import CompensatedLog, compensate_log

ERROR_WINDOW_S = 5.0  # after unloading, where errors are compared; the labels name it
FLUID = "mobil-jet-ii"  # of the simulated plunges


@dataclass(frozen=True, repr=False)
class DemoRun(Result):
    """Files and fits of the demonstration, and their comparison with the truth of the simulation.

    Parameters
    ----------
    files
        Files of the simulated campaign.
    calibrations
        Calibration of each disk.
    tests, compensated
        Partition and compensated log of each test.
    comparison
        Table of ``compare_with_truth``.
    """

    files: CampaignFiles
    calibrations: Mapping[str, CalibrationRun]
    tests: Mapping[str, BetaRun]
    compensated: Mapping[str, CompensatedLog]
    comparison: pd.DataFrame

    def summary(self) -> str:
        """The estimates next to the truth of the simulation, and the cross-check of every test."""
        sentences = [
            f"{name}: {run.partition.crosscheck.sentence}" for name, run in self.tests.items()
        ]
        return "\n".join([self.card().to_string(index=False), *sentences])

    def to_dict(self) -> dict[str, Any]:
        """The comparison with the truth, and the content of every test's beta.json."""
        tests = {name: run.to_dict() for name, run in self.tests.items()}
        return {"comparison": jsonable(self.comparison), "tests": tests}

    def headline(self) -> str:
        """Folder and tests."""
        return f"{self.files.folder}: {', '.join(self.tests)}, {len(self.comparison)} quantities"

    def to_frame(self) -> pd.DataFrame:
        """Estimate, standard uncertainty and truth of every quantity, with its unit."""
        return self.comparison.set_index("quantity")

    def card(self) -> pd.DataFrame:
        """Estimate, standard uncertainty and truth of every quantity."""
        rows = []
        for row in self.comparison.to_dict("records"):
            has_u = row["u"] is not None and np.isfinite(row["u"])
            estimate, u = (
                rounded_texts(row["estimate"], row["u"])
                if has_u
                else (f"{row['estimate']:.3g}", "")
            )
            cells = {
                "quantity": row["quantity"],
                "estimate": estimate,
                "u": u,
                "truth": f"{row['truth']:.4g}",
            }
            rows.append({**cells, "unit": row["unit"]})
        return pd.DataFrame(rows)


@with_named_arguments
@one_blas_thread
def run_demo(
    out: str | Path,
    seed: int = 1,
    tests: Sequence[str] = ("B3",),
    progress: Progress = no_progress,
) -> DemoRun:
    """Simulate a campaign and run every stage on its files, as a user would.

    Parameters
    ----------
    out
        Folder for all files.
    seed
        Seed of the simulation.
    tests
        Names of the tests.
    progress
        Called with the name of each stage.

    Returns
    -------
    DemoRun
        Files, fits and comparison.

    Notes
    -----
    No stage reads the truth; it is read last, for the ``comparison``.

    Examples
    --------
    >>> demo = run_demo("demo")  # doctest: +SKIP
    >>> list(demo.to_frame())  # doctest: +SKIP
    ['unit', 'estimate', 'u', 'truth']
    """
    folder = Path(out)
    progress("simulating the campaign")
    files = simulate_campaign(
        folder, seed, tests, progress=lambda name, *_: progress(f"simulated {name}")
    )
    rig = load_rig(files.rig)
    progress("calibrating both disks")
    calibrations = {disk: _calibrate(files, rig, disk) for disk in DISKS}
    records = {disk: read_record(folder / f"{disk}.disk.json") for disk in DISKS}
    progress("compensating every test, and its heat partition")
    betas = {}
    compensated = {}
    for name, log in files.ehl.items():
        out = folder / f"EHL_{name}"
        betas[name] = _write_partition(log, rig, records, out)
        compensated[name] = _compensate(log, rig, records, out)
    comparison = compare_with_truth(files, calibrations, betas, compensated)
    return DemoRun(files, calibrations, betas, compensated, comparison)


def _calibrate(files: CampaignFiles, rig: Rig, disk: str) -> CalibrationRun:
    """Calibrate one disk and write its record."""
    run = calibrate_disk(rig, disk, files.ovens[disk], files.plunges[disk], [FLUID])
    write_record(run.record, files.folder / f"{disk}.disk.json")
    return run


def _compensate(
    log: Path, rig: Rig, records: Mapping[str, DiskRecord], out: Path
) -> CompensatedLog:
    """Compensate one log and write it next to the other results."""
    done = compensate_log(log, records, rig)
    write_log(done.frame, out.with_name(f"{out.name}.compensated.csv"), done.metadata)
    return done


def _write_partition(log: Path, rig: Rig, records: Mapping[str, DiskRecord], out: Path) -> BetaRun:
    """Estimate beta of one log and write its beta.json."""
    beta = estimate_beta(log, rig, records)
    write_text(out.with_name(f"{out.name}.beta.json"), json_text(beta.to_dict()))
    return beta


def compare_with_truth(
    files: CampaignFiles,
    calibrations: Mapping[str, CalibrationRun],
    tests: Mapping[str, BetaRun],
    compensated: Mapping[str, CompensatedLog],
) -> pd.DataFrame:
    """Table of each estimate with its uncertainty and the truth of the simulation.

    Parameters
    ----------
    files
        Files of the campaign, with the truth.
    calibrations, tests, compensated
        Results by disk, and by test.

    Returns
    -------
    DataFrame
        Columns quantity, unit, estimate, u and truth.
    """
    truth = json.loads(files.truth.read_text(encoding="utf-8"))
    rows: list[dict[str, Any]] = []

    def add(quantity: str, unit: str, value: float, u: float | None, true: float) -> None:
        """Append one row."""
        rows.append({"quantity": quantity, "unit": unit, "estimate": value, "u": u, "truth": true})

    for disk, run in calibrations.items():
        lag = run.fit.common_lag_s
        add(f"{disk} common lag, plunges", "s", lag.value, lag.u, truth[disk]["common_lag_s"])
    for name, beta in tests.items():
        p = beta.partition
        true = truth["tests"][name]
        for way, value in p.beta_by_estimator.items():
            add(f"{name} beta, {way}", "1", value.value, value.u, true["beta"])
        for d in DISKS:
            h = p.estimates[f"h_{d}"]
            add(f"{name} h {d}, speed law", "W/m2K", h.value, h.u, true[f"h_{d}"])
        for disk in DISKS:
            lag = p.joint[disk].estimates["lag_s"]
            add(
                f"{name} {disk} common lag, unloading",
                "s",
                lag.value,
                lag.u,
                truth[disk]["common_lag_s"],
            )
        for disk in DISKS:
            raw, done = errors_after_unloading(
                files, name, compensated[name], f"{disk}_e_degC", true["unload_s"]
            )
            add(f"{name} {disk} e, rms error raw, 5 s after unloading", "K", raw, None, 0.0)
            add(f"{name} {disk} e, rms error compensated", "K", done, None, 0.0)
    for name, beta in tests.items():
        recommended = beta.partition.combined.estimates["beta"]
        reported = recommended.value
        if beta.partition.status == "withheld":
            reported = np.nan
        true_beta = truth["tests"][name]["beta"]
        add(f"{name} beta, recommended", "1", reported, recommended.u, true_beta)
    return pd.DataFrame(rows)


def errors_after_unloading(
    files: CampaignFiles, test: str, compensated_log: CompensatedLog, column: str, unload_s: float
) -> tuple[float, float]:
    """Rms errors of the logged and the compensated trace in the ``ERROR_WINDOW_S`` after unloading.

    Parameters
    ----------
    files
        Files of the campaign, with the simulated traces.
    test
        Name of the test.
    compensated_log
        The compensated log.
    column
        Column of the junction.
    unload_s
        Time of the unloading [s].

    Returns
    -------
    raw, compensated
        Rms errors [K].
    """
    traces = pd.read_parquet(files.folder / "truth" / f"EHL_{test}_traces.parquet")
    after = (
        (traces["time_s"] >= unload_s) & (traces["time_s"] < unload_s + ERROR_WINDOW_S)
    ).to_numpy()
    true = traces[column].to_numpy()[after]
    raw = compensated_log.raw_log.frame[column].to_numpy()[after]
    compensated = compensated_log.frame[column].to_numpy()[after]
    return float(np.sqrt(np.nanmean((raw - true) ** 2))), float(
        np.sqrt(np.mean((compensated - true) ** 2))
    )
