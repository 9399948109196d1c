"""Tests in which the disks are braked from the parting, or touch again after it.

`python -m tests.partition.after_parting_study 8 5000` prints, over 8 rigs drawn from seed 5000 on, errors, refusals and
alarms; the rigs take turns among braking to e-fold in 3 and 20 s and touches of 0.1 and 0.4 s.
"""

from __future__ import annotations

import sys
import warnings
from dataclasses import replace
from typing import Any

import pandas as pd

from tcdyn.core.errors import InputError
from tests.partition.coverage_study import report, told_of
from tests.partition.study_rigs import QUICK, study_rig

WORLDS: dict[str, dict[str, Any]] = {
    "brake 3 s": {"brake_s": 3.0},
    "brake 20 s": {"brake_s": 20.0},
    "again 0.1 s": {"again_s": ((0.1, 1.0),)},
    "again 0.4 s": {"again_s": ((0.4, 0.6),)},
    "both": {"brake_s": 3.0, "again_s": ((0.2, 1.0), (0.1, 2.0))},
    "neither": {},
}
DEFAULT = tuple(WORLDS)[:4]


def one(seed: int, world: str) -> dict[str, Any]:
    """Errors in standard uncertainties, and the alarms, of one drawn rig in one of ``WORLDS``."""
    warnings.simplefilter("ignore")
    try:
        made = study_rig(seed, options=replace(QUICK, **WORLDS[world]))
        return {"world": world, "seed": seed, **told_of(made, made.analyse())}
    except InputError as problem:
        print(seed, world, problem)
        return {"world": world, "seed": seed, "failed": 1.0}


def study(count: int, first: int = 5000, worlds: tuple[str, ...] = DEFAULT) -> pd.DataFrame:
    """One row per drawn rig, the ``worlds`` in turn."""
    return pd.DataFrame([one(first + k, worlds[k % len(worlds)]) for k in range(count)])


if __name__ == "__main__":
    chosen = tuple(sys.argv[3:]) or DEFAULT
    table = study(int(sys.argv[1]), int(sys.argv[2]), chosen)
    told = [
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
    print(table[[name for name in told if name in table]].round(4).to_string(index=False))
    print(report(table).round(3).to_string(index=False))
    print("failed", int(table["failed"].sum()), "alarms", int(table["alarm"].sum()))
    print(*table.loc[table["alarm"] > 0, "sentence"], sep="\n")
