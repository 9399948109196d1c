"""Rigs whose press fit conducts unevenly round the bore, by the synthetic rig in (r, z, angle), which no fit uses.

`python -m tests.partition.uneven_study 24 3000` prints errors, coverage, alarms and suspects: amplitude 0.3 and 0.9, at
0, 45, 90 and 180 degrees, of the fast disk, the slow one or both, a rig drawn within its uncertainties each.
"""

from __future__ import annotations

import sys
import warnings
from itertools import product

import numpy as np
import pandas as pd
from joblib import Parallel, delayed

from tcdyn.core.errors import InputError
from tcdyn.rig.disk import DISKS
from tcdyn.rig.rigfile import load_rig
from tcdyn.simulate.truth import BoreContact, draw_truth
from tests.partition.coverage_study import report, told_of
from tests.partition.study_rigs import study_rig

WORLDS = list(product((0.3, 0.9), (0.0, 45.0, 90.0, 180.0), (("fast",), ("slow",), DISKS)))
EVEN = (0.0, 0.0, DISKS)


def one(seed: int, world: tuple[float, float, tuple[str, ...]]) -> dict[str, object]:
    """Errors in standard uncertainties, alarms and suspects of one drawn rig with one pattern round its bores."""
    warnings.simplefilter("ignore")
    amplitude, angle, disks = world
    true = draw_truth(seed, load_rig(), uncertain=True).with_uneven(
        {d: BoreContact(amplitude, angle) for d in disks}
    )
    out: dict[str, object] = {
        "amplitude": amplitude,
        "angle": angle,
        "disks": "-".join(disks),
        "failed": 0.0,
    }
    try:
        made = study_rig(seed, truth=true)
        p = made.analyse()
    except InputError as problem:
        print(seed, world, problem)
        return out | {"failed": 1.0}
    out |= told_of(made, p)
    out["u both"] = p.both.estimates["beta"].u
    out["suspects"] = (
        " ".join(f"{s.disk}:{s.kind}" for s in p.sensors.suspects) if p.sensors else ""
    )
    for d in DISKS:
        told, found = made.told["unevenness"][d], p.both.harmonics[d]
        out[f"true K {d}"], out[f"found K {d}"] = told["amplitude_K"], found.amplitude_K.value
        angles = np.deg2rad([told["angle_deg"], found.hottest_angle_deg.value])
        size = np.array([told["amplitude_K"], found.amplitude_K.value])
        off = np.array([-1.0, 1.0]) @ (
            size[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
        )
        out[f"z vector {d}"] = found.level_z(off)
    return out


def study(count: int, first: int = 3000, n_jobs: int = 2) -> pd.DataFrame:
    """One row per drawn rig: the worlds in turn, or for a negative count even disks."""
    worlds = [EVEN] * -count if count < 0 else [WORLDS[k % len(WORLDS)] for k in range(count)]
    return pd.DataFrame(
        Parallel(n_jobs=n_jobs)(delayed(one)(first + k, w) for k, w in enumerate(worlds))
    )


if __name__ == "__main__":
    table = study(*map(int, sys.argv[1:3]), n_jobs=int(sys.argv[3]) if len(sys.argv) > 3 else 1)
    columns = [
        "amplitude",
        "angle",
        "disks",
        "error both",
        "z both",
        "u both",
        "z speed law",
        "z cooling fast",
        "z cooling slow",
        "z joint fast",
        "z joint slow",
        "true K fast",
        "found K fast",
        "z vector fast",
        "true K slow",
        "found K slow",
        "z vector slow",
        "alarm",
        "suspects",
    ]
    print(table[columns].round(4).to_string())
    print(report(table).round(4).to_string(index=False))
    ok = table[table["failed"] == 0]
    print(
        "failed",
        table["failed"].sum(),
        "alarms",
        ok["alarm"].sum(),
        "suspects",
        (ok["suspects"] != "").sum(),
    )
    print(
        "both: rms",
        np.sqrt((ok["error both"] ** 2).mean()),
        "within 0.01",
        (ok["error both"].abs() < 0.01).mean(),
    )
    print(*ok.loc[ok["alarm"] > 0, "sentence"], sep="\n")
