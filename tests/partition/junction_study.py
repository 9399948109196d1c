"""How often a junction that lies off its stated depth is named, and by which words: the cross-check's power.

`python -m tests.partition.junction_study 0.3` moves each of the twelve junctions of drawn rigs by +0.3 and -0.3 mm from
where rig.toml states it.
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


def moved_junction(truth: RigTruth, disk: str, channel: str, deeper_m: float) -> RigTruth:
    """The rig with one junction ``deeper_m`` [m] deeper than rig.toml states."""
    own, stated = truth.disk(disk), load_rig().disk_setup(disk).junctions[channel]
    there = replace(own.setup.junctions[channel], depth_m=stated.depth_m + deeper_m)
    setup = replace(own.setup, junctions={**own.setup.junctions, channel: there})
    moved = replace(own, setup=setup)
    return replace(truth, fast=moved) if disk == "fast" else replace(truth, slow=moved)


def one(seed: int, disk: str, channel: str, deeper_m: float, test: str = "B3") -> dict[str, object]:
    """What the cross-check says of one drawn rig with one junction off."""
    warnings.simplefilter("ignore")
    out: dict[str, object] = {"disk": disk, "channel": channel, "deeper_mm": deeper_m * 1e3}
    made = study_rig(
        seed,
        test,
        truth=moved_junction(draw_truth(seed, load_rig(), uncertain=True), disk, channel, deeper_m),
    )
    try:
        p = made.analyse()
    except InputError as problem:
        return out | {
            "alarm": True,
            "named": f"{disk}_{channel}" in str(problem),
            "sentence": str(problem),
        }
    said = p.crosscheck.sentence
    named = f"junction {channel} of the {disk} disk" in said or f"{disk}_{channel}_degC" in said
    if p.sensors is not None and disk in p.sensors.depths:
        place = p.sensors.depths[disk].deeper_m[channel]
        out |= {"placed_mm": 1e3 * place.value, "u_mm": 1e3 * place.u}
    return out | {"alarm": not p.crosscheck.agree, "named": named, "sentence": said}


def study(deeper_mm: float, rigs: int = 2, n_jobs: int = 2) -> pd.DataFrame:
    """One row for each junction, sign and rig."""
    cases = product(range(rigs), DISKS, CHANNELS, (1.0, -1.0))
    jobs = [
        (FIRST_SEED + k, d, c, sign * deeper_mm * 1e-3) for k, (_, d, c, sign) in enumerate(cases)
    ]
    return pd.DataFrame(Parallel(n_jobs=n_jobs)(delayed(one)(*job) for job in jobs))


if __name__ == "__main__":
    size = float(sys.argv[1]) if len(sys.argv) > 1 else 0.3
    table = study(size)
    table["row"] = np.where(
        table["channel"].isin(load_rig().disk_setup("fast").outer), "outer", "inner"
    )
    print(table.drop(columns="sentence").round(3).to_string(index=False))
    print(table.groupby(["disk", "row"])[["alarm", "named"]].mean().round(2).to_string())
    print(
        f"{size:g} mm: alarm in {table['alarm'].mean():.0%}, named in {table['named'].mean():.0%} of {len(table)}"
    )
