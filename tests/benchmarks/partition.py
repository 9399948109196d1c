"""Every test of the programme on several rigs: errors of beta, h and lag (python -m
tests.benchmarks.partition 3).

Rigs with the nominal values of `rig.toml`, full length and mesh, nothing tuned per test. The
argument is the number of seeds.
"""

from __future__ import annotations

import sys
import time

import numpy as np
import pandas as pd
from joblib import Parallel, delayed

from tcdyn.simulate.campaign import ALL_TESTS
from tcdyn.simulate.ehl import EhlOptions
from tests.partition.study_rigs import study_rig


def errors_of_test(seed: int, test: str) -> dict[str, float | str]:
    """Errors of one test on one rig."""
    rig = study_rig(seed, test, uncertain=False, options=EhlOptions(duration_s=1065.0))
    start = time.process_time()
    p = rig.analyse()
    seconds = time.process_time() - start
    true_values = rig.true_values
    out: dict[str, float | str] = {"test": test, "seed": seed}
    out |= {
        estimator: value.value - true_values["beta"]
        for estimator, value in p.beta_by_estimator.items()
    }
    out["both"] = p.combined.estimates["beta"].value - true_values["beta"]
    out |= {
        "h fast": p.speed.h_fast / true_values["h_fast"] - 1,
        "h slow": p.speed.h_slow / true_values["h_slow"] - 1,
    }
    for disk in ("fast", "slow"):
        out[f"lag {disk}"] = p.joint[disk].chain.lag_s - rig.truth.disk(disk).common_lag_s
    shares = p.joint["fast"].share + p.joint["slow"].share
    spread = np.std(p.budget.samples["joint fast"] - p.budget.samples["joint slow"])
    out["z shares"] = (shares - 1.0) / float(spread)
    out |= {"agree": float(p.crosscheck.agree), "analysis CPU s": seconds}
    return out


def main() -> None:
    """Print rms and largest error of every quantity."""
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 3
    rows = Parallel(n_jobs=2)(
        delayed(errors_of_test)(s, t) for s in range(1, seeds + 1) for t in ALL_TESTS
    )
    table = pd.DataFrame(rows)
    print(table.round(4).to_string(index=False))
    numbers = table.drop(columns=["test", "seed", "agree"])
    print(
        pd.DataFrame({"rms": np.sqrt((numbers**2).mean()), "largest": numbers.abs().max()})
        .round(4)
        .to_string()
    )
    print(f"cross-check agrees in {table['agree'].mean():.0%} of {len(table)} tests")


if __name__ == "__main__":
    main()
