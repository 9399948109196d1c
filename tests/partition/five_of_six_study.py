"""Coverage of the 95 % intervals of beta with one of the twelve channels excluded.

`python -m tests.partition.five_of_six_study 3 1000` excludes each in turn on three drawn rigs, from
seed 1000 on.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator

import numpy as np
import pandas as pd

from tcdyn.core.errors import InputError
from tcdyn.core.findings import Severity
from tcdyn.partition.analyse import analyse
from tcdyn.rig.disk import CHANNELS, DISKS
from tests.partition.study_rigs import study_rig

ALL_CHANNELS = tuple(f"{disk}_{channel}" for disk in DISKS for channel in CHANNELS)


def rows_of_rig(seed: int, test: str = "B3") -> Iterator[dict[str, object]]:
    """A row for each estimator with all channels (``excluded`` "none") and without each channel:
    error, u and alarms.

    ``widening``: standard uncertainty relative to that with all channels.
    """
    study = study_rig(seed, test)
    complete_u: dict[str, float] = {}
    for name in ("none", *ALL_CHANNELS):
        try:
            p = analyse(study.test if name == "none" else study.without(name))
        except InputError as problem:
            print(seed, name, problem)
            yield {"seed": seed, "excluded": name, "estimator": "both", "failed": True}
            continue
        estimates = {**p.beta_by_estimator, "both": p.combined.estimates["beta"]}
        complete_u = complete_u or {
            estimator: estimate.u for estimator, estimate in estimates.items()
        }
        suspects = () if p.sensors is None else p.sensors.suspects
        for estimator, estimate in estimates.items():
            yield {
                "seed": seed,
                "excluded": name,
                "estimator": estimator,
                "failed": False,
                "error": estimate.value - study.true_values["beta"],
                "u": estimate.u,
                "widening": estimate.u / complete_u[estimator],
                "alarm": not p.crosscheck.agree,
                "has_suspects": any(s.finding.severity is not Severity.INFO for s in suspects),
            }


def run_study(count: int, first: int = 1000) -> pd.DataFrame:
    """The rows of ``count`` drawn rigs."""
    return pd.DataFrame([row for seed in range(first, first + count) for row in rows_of_rig(seed)])


def report(table: pd.DataFrame) -> pd.DataFrame:
    """Coverage, rms z and widening by estimator: with all channels, without one of the outer or of
    the inner row."""
    completed = table[~table["failed"]].copy()
    row = completed["excluded"].str[-1].map(lambda c: "a, c or e" if c in "ac" else "b, d or f")
    completed["without"] = row.where(completed["excluded"] != "none", "none").where(
        completed["excluded"].str[-2:] != "_e", "a, c or e"
    )
    completed["z"] = completed["error"] / completed["u"]
    groups = completed.groupby(["estimator", "without"], sort=False)
    return groups.agg(
        runs=("z", "size"),
        covered=("z", lambda z: float((z.abs() < 1.96).mean())),
        rms_z=("z", lambda z: float(np.sqrt((z**2).mean()))),
        rms_error=("error", lambda e: float(np.sqrt((e**2).mean()))),
        mean_u=("u", "mean"),
        widening=("widening", "mean"),
        max_widening=("widening", "max"),
        alarms=("alarm", "mean"),
        has_suspects=("has_suspects", "mean"),
    ).reset_index()


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    table = run_study(*(int(argument) for argument in sys.argv[1:3]))
    print(report(table).round(4).to_string(index=False))
    both = table[table["estimator"] == "both"]
    print(both.round(4).to_string(index=False))
    print("failed", int(table["failed"].sum()))
