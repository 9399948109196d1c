"""Heat partition with one disk: from an EHL log and one record to beta, and beta.json.

The command ``tcdyn beta`` where one record is given; the fits are
:mod:`tcdyn.partition.single_disk`. Guarded by ``tests/partition/test_one_disk.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from tcdyn.campaign import rig_fingerprint
from tcdyn.campaign.stages import read_stage
from tcdyn.core.errors import InputError
from tcdyn.core.result import Result
from tcdyn.core.threads import one_blas_thread
from tcdyn.io.checksum import with_checksum
from tcdyn.partition.analyse import WINDOW_S
from tcdyn.partition.single_disk import ESTIMATORS, OneDisk, analyse_one_disk
from tcdyn.rig.columns import junction_columns
from tcdyn.rig.disk import DISKS
from tcdyn.rig.log import Log, iter_log
from tcdyn.rig.opened_log import column_names, missing_columns, rig_from_records
from tcdyn.rig.record import DiskRecord
from tcdyn.rig.rigfile import Rig
from tcdyn.workflows.beta import prepare_test, retry_without_lost_channels
from tcdyn.workflows.beta_tables import SCHEMA, WITHHELD, estimate_row, junction_depths
from tcdyn.workflows.operating_conditions import BearingFile


@dataclass(frozen=True)
class OneDiskRun(Result):
    """Result of one analysed test of one disk, with the log and the record that it came from.

    Parameters
    ----------
    log
        The log.
    partition
        The estimates.
    rig_sha256
        Fingerprint of rig and record.
    stages
        Number of tests in the log.
    records
        Record of the disk.
    """

    log: Log
    partition: OneDisk
    rig_sha256: str = ""
    stages: int = 1
    records: Mapping[str, DiskRecord] = field(default_factory=dict, repr=False)

    def __repr__(self) -> str:
        """Name of the log."""
        return f"<OneDiskRun of {self.log.path.name}; summary() says it in words>"

    def to_dict(self) -> dict[str, Any]:
        """The content of ``beta.json`` with its checksum, null where a number needs both disks.

        Its keys must be those of ``tcdyn.workflows.beta_tables.beta_file``.
        """
        partition = self.partition
        disk = self.partition.disk
        withheld = partition.impossible
        check = partition.crosscheck
        withheld_keys = {key for way in withheld for key in (way, f"h {way}")} | (
            {"lag_s"} if "joint" in withheld else set()
        )
        answers = {
            key: WITHHELD if key in withheld_keys else e.model_dump()
            for key, e in partition.estimates.items()
        }
        difference = partition.estimates["joint"].value - partition.estimates["cooling"].value
        pair = {
            "one": f"joint {disk}",
            "other": f"cooling {disk}",
            "difference": difference,
            "z": partition.z,
        }
        return with_checksum(
            {
                "schema": SCHEMA,
                "source": {"file": self.log.path.name, "sha256": self.log.sha256},
                "test": partition.test.conditions,
                "steady": {
                    **dict.fromkeys(("beta", "h_fast", "h_slow", "exponent"), WITHHELD),
                    f"{disk}_line": {"intercept": answers["intercept"], "slope": answers["slope"]},
                },
                "transient": {
                    disk: {
                        "beta": answers["cooling"],
                        "h": answers["h cooling"],
                        "window_s": partition.cooling.window_s,
                    }
                },
                "joint": {
                    disk: {
                        "beta": answers["joint"],
                        "h": answers["h joint"],
                        "lag_s": answers["lag_s"],
                    },
                    "both": dict.fromkeys(("beta", "h_fast", "h_slow", "exponent"), WITHHELD),
                    "profiles": {},
                },
                "headline": {
                    "beta": answers["joint"],
                    "way": f"joint {disk}",
                    "sentence": partition.recommendation.sentence,
                    "range95": None,
                },
                "status": partition.status,
                "alternatives": [],
                "crosscheck": {
                    "z": None if withheld else partition.z,
                    "agree": check.severity == "info",
                    "sentence": check.sentence,
                    "p_value": None,
                    "suspects": [],
                    "strained": None,
                    "pairs": [] if withheld else [pair],
                },
                "budget": [
                    {
                        "source": source,
                        "u_beta_steady": None,
                        "u_beta_transient": None if "cooling" in withheld else cooling,
                        "u_beta_joint": None if "joint" in withheld else joint,
                    }
                    for source, (joint, cooling) in partition.budget.items()
                ],
                "surface": dict.fromkeys(
                    ("fast_max_degC", "slow_max_degC", "delta_T_us"), WITHHELD
                ),
                "noise": {disk: partition.test.disks[disk].noise.to_dict()},
                "unevenness": {disk: partition.harmonic.to_dict()},
                "sensors": {} if partition.sensors is None else partition.sensors.texts,
                "junctions": junction_depths(partition.sensors),
                "kept": None,
                "findings": [finding.to_dict() for finding in partition.findings],
                "warnings": [f.sentence for f in partition.analysis_findings],
            }
        )

    def summary(self) -> str:
        """The recommended estimate and those by every method, in a few lines."""
        partition = self.partition
        answers = self.partition.estimates
        lag = {"joint": f"   lag {answers['lag_s']} s", "cooling": ""}
        rows = [
            f"{f'{way} {partition.disk}':14}"
            + (
                "withheld"
                if way in partition.impossible
                else f"beta {answers[way]}   h {answers[f'h {way}']} W/m2K{lag[way]}"
            )
            for way in ESTIMATORS
        ]
        return "\n".join([partition.recommendation.sentence, *rows, partition.crosscheck.sentence])

    def card(self) -> pd.DataFrame:
        """Table of the estimates of beta by every method."""
        return one_disk_estimates_table(self.partition)


def one_disk_estimates_table(p: OneDisk) -> pd.DataFrame:
    """Table of beta, h and lag by the methods that one disk allows, the recommended one first.

    Physically impossible results are withheld.
    """
    rows = []
    a = p.estimates
    for way in ESTIMATORS:
        lag = a["lag_s"] if way == "joint" else None
        rows.append(
            estimate_row(
                f"{way} fit, {p.disk} disk",
                a[way],
                a[f"h {way}"],
                lag,
                reported=way not in p.impossible,
            )
        )
    return pd.DataFrame(rows).drop(columns="exponent n [1]")


@one_blas_thread
def estimate_one_disk(
    log: str | Path,
    rig: Rig | None,
    records: Mapping[str, DiskRecord],
    *,
    without: Sequence[str] = (),
    window_s: float = WINDOW_S,
    seed: int = 0,
    sensor_check: bool = True,
    bearing: BearingFile | None = None,
    stage: int | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> OneDiskRun:
    """Read an EHL log of one disk and estimate beta by its joint and its cooling fit.

    Parameters
    ----------
    log, rig
        As for ``tcdyn.workflows.beta.estimate_beta``.
    records
        The record of one disk.
    without, window_s, sensor_check, bearing, stage, progress
        As for ``tcdyn.workflows.beta.estimate_beta``.
    seed
        Not used: there are no Monte Carlo samples. It makes the arguments those of
        ``estimate_beta``.

    Returns
    -------
    OneDiskRun
        The estimates.

    Raises
    ------
    InputError
        As ``estimate_beta``, and where the log also has columns of the other disk.

    Notes
    -----
    Both speeds are needed all the same: the heat is friction times sliding speed.
    """
    rig = rig or rig_from_records(records)
    (name,) = records
    other = next(d for d in DISKS if d != name)
    other_columns = [*junction_columns(rig.disk_setup(other).channels, other)]
    if missing_columns(column_names(log, rig), rig, other_columns) != other_columns:
        raise InputError(
            f"no record of the {other} disk, whose columns the log holds",
            where=Path(log).name,
            remedy="add {records}",
            parameters={"records": f"{other}.disk.json"},
        )

    def attempt(left_out: Mapping[str, str]) -> OneDiskRun:
        """Analyse the log without some channels."""
        progress("reading the log")
        chunks = iter_log(
            log, "ehl", rig, without=[*other_columns, *(f"{name}_degC" for name in left_out)]
        )
        table, count = read_stage(chunks, stage)
        test = prepare_test(
            table, rig, records, bearing.friction_added if bearing else None, left_out
        )
        try:
            partition = analyse_one_disk(
                test, window_s=window_s, sensor_check=sensor_check, progress=progress
            )
        except InputError as problem:
            raise problem.at(table.path.name) from None
        return OneDiskRun(table, partition, rig_fingerprint(rig, records, (name,)), count, records)

    return retry_without_lost_channels(attempt, without, rig, progress)
