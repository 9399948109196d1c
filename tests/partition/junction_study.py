"""Power of the cross-check: how often a junction off its specified depth is identified.

`python -m tests.partition.junction_study 0.3` shifts each of the twelve junctions of drawn rigs by
+0.3 and -0.3 mm from the depth in rig.toml.
"""

from __future__ import annotations

import sys
import warnings
from dataclasses import replace
from itertools import product

import numpy as np
import pandas as pd
from joblib import Parallel, delayed

from tcdyn.core.errors import InputError
from tcdyn.rig.disk import CHANNELS, DISKS
from tcdyn.rig.rigfile import load_rig
from tcdyn.simulate.truth import RigTruth, draw_truth
from tests.partition.study_rigs import study_rig

FIRST_SEED = 5000


def with_shifted_junction(truth: RigTruth, disk: str, channel: str, deeper_m: float) -> RigTruth:
    """Return the rig with one junction ``deeper_m`` [m] deeper than in rig.toml."""
    disk_truth = truth.disk(disk)
    nominal = load_rig().disk_setup(disk).junctions[channel]
    shifted = replace(disk_truth.setup.junctions[channel], depth_m=nominal.depth_m + deeper_m)
    setup = replace(disk_truth.setup, junctions={**disk_truth.setup.junctions, channel: shifted})
    changed_disk = replace(disk_truth, setup=setup)
    return (
        replace(truth, fast=changed_disk) if disk == "fast" else replace(truth, slow=changed_disk)
    )


def run_case(
    seed: int, disk: str, channel: str, deeper_m: float, test: str = "B3"
) -> dict[str, object]:
    """Result of the cross-check of one drawn rig with one junction off."""
    warnings.simplefilter("ignore")
    row: dict[str, object] = {"disk": disk, "channel": channel, "deeper_mm": deeper_m * 1e3}
    study = study_rig(
        seed,
        test,
        truth=with_shifted_junction(
            draw_truth(seed, load_rig(), uncertain=True), disk, channel, deeper_m
        ),
    )
    try:
        p = study.analyse()
    except InputError as problem:
        return row | {
            "alarm": True,
            "named": f"{disk}_{channel}" in str(problem),
            "sentence": str(problem),
        }
    sentence = p.crosscheck.sentence
    named = (
        f"junction {channel} of the {disk} disk" in sentence or f"{disk}_{channel}_degC" in sentence
    )
    if p.sensors is not None and disk in p.sensors.depths:
        shift = p.sensors.depths[disk].deeper_m[channel]
        row |= {"placed_mm": 1e3 * shift.value, "u_mm": 1e3 * shift.u}
    return row | {"alarm": not p.crosscheck.agree, "named": named, "sentence": sentence}


def run_study(deeper_mm: float, rigs: int = 2, n_jobs: int = 2) -> pd.DataFrame:
    """One row for each junction, sign and rig."""
    cases = product(range(rigs), DISKS, CHANNELS, (1.0, -1.0))
    jobs = [
        (FIRST_SEED + k, d, c, sign * deeper_mm * 1e-3) for k, (_, d, c, sign) in enumerate(cases)
    ]
    return pd.DataFrame(Parallel(n_jobs=n_jobs)(delayed(run_case)(*job) for job in jobs))


if __name__ == "__main__":
    size_mm = float(sys.argv[1]) if len(sys.argv) > 1 else 0.3
    table = run_study(size_mm)
    table["row"] = np.where(
        table["channel"].isin(load_rig().disk_setup("fast").outer), "outer", "inner"
    )
    print(table.drop(columns="sentence").round(3).to_string(index=False))
    print(table.groupby(["disk", "row"])[["alarm", "named"]].mean().round(2).to_string())
    print(
        f"{size_mm:g} mm: alarm in {table['alarm'].mean():.0%}, named in "
        f"{table['named'].mean():.0%} of {len(table)}"
    )
