"""Rigs for the partition studies: logs of the synthetic rig, and records with errors drawn from
their uncertainties.

The static lines come from simulated ovens. The chain of a record is the true one plus errors drawn
from the covariance that the record contains, so that a study needs no plunge fit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from calibration.static_lines import fit_static_lines
from tcdyn.core.estimate import Estimate
from tcdyn.partition.analyse import Partition, analyse
from tcdyn.partition.events import EhlTest
from tcdyn.partition.prepare import prepare_test
from tcdyn.rig.disk import DISKS
from tcdyn.rig.log import Log
from tcdyn.rig.record import ChainRecord, ChannelChain, DiskRecord, now_utc
from tcdyn.rig.rigfile import Rig, load_rig
from tcdyn.simulate.ehl import STUDY_MESH, EhlOptions, simulate_ehl
from tcdyn.simulate.measure import simulate_oven
from tcdyn.simulate.truth import RigTruth, draw_truth

# standard uncertainties from a pair of plunges
COMMON_U_S = 0.05
DIFFERENTIAL_U_S = 0.008
QUICK = EhlOptions(load_on_s=20.0, unload_s=320.0, duration_s=336.0, mesh=STUDY_MESH)


@dataclass(frozen=True)
class StudyRig:
    """One drawn rig, one test on it, and the records that a laboratory would have."""

    rig: Rig
    truth: RigTruth
    test: EhlTest
    true_values: dict[str, Any]
    records: dict[str, DiskRecord]
    log: Log

    def analyse(self, **options: Any) -> Partition:
        """Run all estimators of beta on this test."""
        return analyse(self.test, **options)

    def without(self, *channels: str) -> EhlTest:
        """Return the test without channels such as "fast_c"."""
        return prepare_test(self.log, self.rig, self.records, left_out=dict.fromkeys(channels, ""))


def study_rig(
    seed: int,
    name: str = "B3",
    *,
    uncertain: bool = True,
    options: EhlOptions = QUICK,
    lag_error_s: float | None = None,
    truth: RigTruth | None = None,
    rig: Rig | None = None,
    log_change: Callable[[pd.DataFrame], pd.DataFrame] = lambda frame: frame,
    on_truth: Callable[[dict[str, Any]], None] = lambda true_values: None,
) -> StudyRig:
    """Draw rig ``seed`` and run test ``name`` on it; ``lag_error_s`` overrides the drawn error of
    both common lags.

    ``on_truth`` receives the true values of the test; then ``log_change`` returns the log to
    analyse.
    """
    rig = rig or load_rig()
    true = truth or draw_truth(seed, rig, uncertain=uncertain)
    frame, true_values = simulate_ehl(name, seed, true, options)
    on_truth(true_values)
    records = {disk: _record(seed, disk, true, rig, lag_error_s) for disk in DISKS}
    log = Log(log_change(frame), "ehl", Path(f"EHL_{name}.csv"), "0" * 64, 1 / 75)
    return StudyRig(rig, true, prepare_test(log, rig, records), true_values, records, log)


def _record(
    seed: int, disk: str, truth: RigTruth, rig: Rig, lag_error_s: float | None
) -> DiskRecord:
    rng = np.random.default_rng([seed, len(disk)])
    oven, _ = simulate_oven(disk, seed, truth)
    common = rng.normal(0, COMMON_U_S) if lag_error_s is None else lag_error_s
    names = rig.disk_setup(disk).channels
    differential = rng.normal(0, DIFFERENTIAL_U_S, len(names))
    u = float(np.hypot(COMMON_U_S, DIFFERENTIAL_U_S))
    disk_truth = truth.disk(disk)
    channels = {}
    for ch, error in zip(names, differential):
        c = disk_truth.channels[ch]
        error_s = max(common + error, 0.01 - c.tau1_s)
        lag = disk_truth.lags_s[ch] + error_s
        channels[ch] = ChannelChain(
            taus_s=(c.tau1_s + error_s, c.tau2_s), lag_s=Estimate.normal(lag, u)
        )
    mean = float(np.mean([c.lag_s.value for c in channels.values()]))
    covariance = (
        np.full((len(names), len(names)), COMMON_U_S**2) + np.eye(len(names)) * DIFFERENTIAL_U_S**2
    )
    return DiskRecord(
        disk=disk,
        created=now_utc(),
        static=fit_static_lines(oven).lines,
        chain=ChainRecord(
            structure="P2",
            channels=channels,
            covariance=covariance.tolist(),
            common_lag_s=Estimate.normal(mean, float(np.sqrt(covariance.mean()))),
            differential_lag_s={
                k: Estimate.normal(c.lag_s.value - mean, DIFFERENTIAL_U_S)
                for k, c in channels.items()
            },
        ),
        setup=rig.tables(disk),
    )
