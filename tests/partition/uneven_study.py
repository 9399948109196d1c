"""Rigs with circumferentially uneven press fits, by the synthetic rig in (r, z, angle), which no
fit uses.

`python -m tests.partition.uneven_study 24 3000` prints errors, coverage, alarms and suspects:
amplitudes 0.3 and 0.9 at 0, 45, 90 and 180 degrees, of the fast disk, the slow one or both, each on
a rig drawn within its uncertainties.
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
from tests.partition.coverage_study import report, study_errors
from tests.partition.study_rigs import study_rig

WORLDS = list(product((0.3, 0.9), (0.0, 45.0, 90.0, 180.0), (("fast",), ("slow",), DISKS)))
EVEN = (0.0, 0.0, DISKS)


def run_case(seed: int, world: tuple[float, float, tuple[str, ...]]) -> dict[str, object]:
    """Errors in standard uncertainties, alarms and suspects of one drawn rig with one uneven press
    fit."""
    warnings.simplefilter("ignore")
    amplitude, angle, disks = world
    truth = draw_truth(seed, load_rig(), uncertain=True).with_uneven(
        {d: BoreContact(amplitude, angle) for d in disks}
    )
    row: dict[str, object] = {
        "amplitude": amplitude,
        "angle": angle,
        "disks": "-".join(disks),
        "failed": 0.0,
    }
    try:
        study = study_rig(seed, truth=truth)
        p = study.analyse()
    except InputError as problem:
        print(seed, world, problem)
        return row | {"failed": 1.0}
    row |= study_errors(study, p)
    row["u both"] = p.combined.estimates["beta"].u
    row["suspects"] = (
        " ".join(f"{s.disk}:{s.kind}" for s in p.sensors.suspects) if p.sensors else ""
    )
    for d in DISKS:
        expected = study.true_values["unevenness"][d]
        harmonic = p.combined.harmonics[d]
        row[f"true K {d}"] = expected["amplitude_K"]
        row[f"estimated K {d}"] = harmonic.amplitude_K.value
        angles = np.deg2rad([expected["angle_deg"], harmonic.hottest_angle_deg.value])
        amplitudes_K = np.array([expected["amplitude_K"], harmonic.amplitude_K.value])
        level_error = np.array([-1.0, 1.0]) @ (
            amplitudes_K[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
        )
        row[f"z vector {d}"] = harmonic.level_z(level_error)
    return row


def run_study(count: int, first: int = 3000, n_jobs: int = 2) -> pd.DataFrame:
    """One row per drawn rig; the worlds alternate, and a negative count gives even disks."""
    worlds = [EVEN] * -count if count < 0 else [WORLDS[k % len(WORLDS)] for k in range(count)]
    return pd.DataFrame(
        Parallel(n_jobs=n_jobs)(delayed(run_case)(first + k, w) for k, w in enumerate(worlds))
    )


if __name__ == "__main__":
    table = run_study(*map(int, sys.argv[1:3]), n_jobs=int(sys.argv[3]) if len(sys.argv) > 3 else 1)
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
        "estimated K fast",
        "z vector fast",
        "true K slow",
        "estimated K slow",
        "z vector slow",
        "alarm",
        "suspects",
    ]
    print(table[columns].round(4).to_string())
    print(report(table).round(4).to_string(index=False))
    completed = table[table["failed"] == 0]
    print(
        "failed",
        table["failed"].sum(),
        "alarms",
        completed["alarm"].sum(),
        "suspects",
        (completed["suspects"] != "").sum(),
    )
    print(
        "both: rms",
        np.sqrt((completed["error both"] ** 2).mean()),
        "within 0.01",
        (completed["error both"].abs() < 0.01).mean(),
    )
    print(*completed.loc[completed["alarm"] > 0, "sentence"], sep="\n")
