"""An EHL log of one disk and its record to beta by the ways that one disk allows, and the file that keeps it."""

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
from tcdyn.io.checksum import sealed
from tcdyn.partition.analyse import WINDOW_S
from tcdyn.partition.single_disk import WAYS, OneDisk, analyse_one
from tcdyn.rig.columns import couples
from tcdyn.rig.disk import DISKS
from tcdyn.rig.log import Log, iter_log
from tcdyn.rig.opened_log import columns_not_there, rig_of
from tcdyn.rig.record import DiskRecord
from tcdyn.rig.rigfile import Rig
from tcdyn.workflows.bearing import BearingFile
from tcdyn.workflows.beta import prepare, without_lost
from tcdyn.workflows.beta_tables import NOTHING, SCHEMA, junctions, way_row


@dataclass(frozen=True)
class OneDiskRun(Result):
    """One analysed test of one disk: the numbers, the log they came from, and how many tests that log holds in all."""

    log: Log
    partition: OneDisk
    rig_sha256: str = ""
    stages: int = 1
    records: Mapping[str, DiskRecord] = field(default_factory=dict, repr=False)

    def __repr__(self) -> str:
        return f"<OneDiskRun of {self.log.path.name}; summary() says it in words>"

    def to_dict(self) -> dict[str, Any]:
        """The content of ``beta.json``, null where a number needs both disks, sealed with its checksum."""
        p = self.partition
        d = self.partition.disk
        gone = p.withheld
        check = p.crosscheck
        hidden = {key for way in gone for key in (way, f"h {way}")} | (
            {"lag_s"} if "joint" in gone else set()
        )
        a = {key: NOTHING if key in hidden else e.model_dump() for key, e in p.answers.items()}
        apart = p.answers["joint"].value - p.answers["cooling"].value
        pair = {"one": f"joint {d}", "other": f"cooling {d}", "difference": apart, "z": p.z}
        return sealed(
            {
                "schema": SCHEMA,
                "source": {"file": self.log.path.name, "sha256": self.log.sha256},
                "test": p.test.conditions,
                "steady": {
                    **dict.fromkeys(("beta", "h_fast", "h_slow", "exponent"), NOTHING),
                    f"{d}_line": {"intercept": a["intercept"], "slope": a["slope"]},
                },
                "transient": {
                    d: {"beta": a["cooling"], "h": a["h cooling"], "window_s": p.cooling.window_s}
                },
                "joint": {
                    d: {"beta": a["joint"], "h": a["h joint"], "lag_s": a["lag_s"]},
                    "both": dict.fromkeys(("beta", "h_fast", "h_slow", "exponent"), NOTHING),
                    "profiles": {},
                },
                "headline": {
                    "beta": a["joint"],
                    "way": f"joint {d}",
                    "sentence": p.headline.sentence,
                    "range95": None,
                },
                "status": p.status,
                "alternatives": [],
                "crosscheck": {
                    "z": None if gone else p.z,
                    "agree": check.severity == "info",
                    "sentence": check.sentence,
                    "p_value": None,
                    "suspects": [],
                    "strained": None,
                    "pairs": [] if gone else [pair],
                },
                "budget": [
                    {
                        "source": source,
                        "u_beta_steady": None,
                        "u_beta_transient": None if "cooling" in gone else cooling,
                        "u_beta_joint": None if "joint" in gone else joint,
                    }
                    for source, (joint, cooling) in p.budget.items()
                ],
                "surface": dict.fromkeys(("fast_max_degC", "slow_max_degC", "delta_T_us"), NOTHING),
                "noise": {d: p.test.disks[d].noise.to_dict()},
                "unevenness": {d: p.uneven.to_dict()},
                "sensors": {} if p.sensors is None else p.sensors.said,
                "junctions": junctions(p.sensors),
                "kept": None,
                "findings": [found.to_dict() for found in p.findings],
                "warnings": [f.sentence for f in p.noticed],
            }
        )

    def summary(self) -> str:
        """The answer in a few lines."""
        p = self.partition
        a = self.partition.answers
        lag = {"joint": f"   lag {a['lag_s']} s", "cooling": ""}
        said = [
            f"{f'{way} {p.disk}':14}"
            + (
                "withheld"
                if way in p.withheld
                else f"beta {a[way]}   h {a[f'h {way}']} W/m2K{lag[way]}"
            )
            for way in WAYS
        ]
        return "\n".join([p.headline.sentence, *said, p.crosscheck.sentence])

    def card(self) -> pd.DataFrame:
        """The ways to beta."""
        return ways_of(self.partition)


def ways_of(p: OneDisk) -> pd.DataFrame:
    """beta, h and lag by the ways that one disk allows, the headline's first; what cannot be true is withheld."""
    rows = []
    a = p.answers
    for way in WAYS:
        lag = a["lag_s"] if way == "joint" else None
        rows.append(
            way_row(
                f"{way} fit, {p.disk} disk", a[way], a[f"h {way}"], lag, shown=way not in p.withheld
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
    """Read an EHL log of one disk and find beta by its joint and its cooling fit; arguments as of ``estimate_beta``.

    Both speeds are needed all the same: the heat is friction times sliding speed. Nothing is drawn, so ``seed`` changes
    nothing. Raises InputError as ``estimate_beta`` does, and where the log holds the other disk's columns, too.
    """
    rig = rig or rig_of(records)
    (name,) = records
    other = next(d for d in DISKS if d != name)
    unread = [*couples(rig.disk_setup(other).channels, other)]
    if columns_not_there(log, rig, unread) != unread:
        raise InputError(
            f"no record of the {other} disk, whose columns the log holds",
            where=Path(log).name,
            remedy="add {records}",
            parameters={"records": f"{other}.disk.json"},
        )

    def attempt(left_out: Mapping[str, str]) -> OneDiskRun:
        progress("reading the log")
        pieces = iter_log(
            log, "ehl", rig, without=[*unread, *(f"{name}_degC" for name in left_out)]
        )
        table, count = read_stage(pieces, stage)
        test = prepare(table, rig, records, bearing.added if bearing else None, left_out)
        try:
            found = analyse_one(
                test, window_s=window_s, sensor_check=sensor_check, progress=progress
            )
        except InputError as problem:
            raise problem.at(table.path.name) from None
        return OneDiskRun(table, found, rig_fingerprint(rig, records, (name,)), count, records)

    return without_lost(attempt, without, rig, progress)
