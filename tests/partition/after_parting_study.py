"""Tests in which the disks brake after unloading, or touch again.

`python -m tests.partition.after_parting_study 8 5000` prints errors, refusals and alarms over 8
rigs drawn from seed 5000 on. The rigs alternate between braking with time constants of 3 and 20 s
and second contacts of 0.1 and 0.4 s.
"""

from __future__ import annotations

import sys
import warnings
from dataclasses import replace
from typing import Any

import pandas as pd

from tcdyn.core.errors import InputError
from tests.partition.coverage_study import report, study_errors
from tests.partition.study_rigs import QUICK, study_rig

WORLDS: dict[str, dict[str, Any]] = {
    "brake 3 s": {"brake_s": 3.0},
    "brake 20 s": {"brake_s": 20.0},
    "second contact 0.1 s": {"again_s": ((0.1, 1.0),)},
    "second contact 0.4 s": {"again_s": ((0.4, 0.6),)},
    "both": {"brake_s": 3.0, "again_s": ((0.2, 1.0), (0.1, 2.0))},
    "neither": {},
    "unloading in 1.5 s": {"parting_s": 1.5},
}
DEFAULT = tuple(WORLDS)[:4]


def run_case(seed: int, world: str) -> dict[str, Any]:
    """Errors in standard uncertainties and alarms of one drawn rig in one of ``WORLDS``."""
    warnings.simplefilter("ignore")
    try:
        study = study_rig(seed, options=replace(QUICK, **WORLDS[world]))
        return {"world": world, "seed": seed, **study_errors(study, study.analyse())}
    except InputError as problem:
        print(seed, world, problem)
        return {"world": world, "seed": seed, "failed": 1.0}


def run_study(count: int, first: int = 5000, worlds: tuple[str, ...] = DEFAULT) -> pd.DataFrame:
    """One row per drawn rig; the ``worlds`` alternate."""
    return pd.DataFrame([run_case(first + k, worlds[k % len(worlds)]) for k in range(count)])


if __name__ == "__main__":
    chosen = tuple(sys.argv[3:]) or DEFAULT
    table = run_study(int(sys.argv[1]), int(sys.argv[2]), chosen)
    columns = [
        "world",
        "seed",
        "failed",
        "error both",
        "z both",
        "z lag fast",
        "z lag slow",
        "z check",
        "alarm",
    ]
    print(table[[name for name in columns if name in table]].round(4).to_string(index=False))
    print(report(table).round(3).to_string(index=False))
    print("failed", int(table["failed"].sum()), "alarms", int(table["alarm"].sum()))
    print(*table.loc[table["alarm"] > 0, "sentence"], sep="\n")
