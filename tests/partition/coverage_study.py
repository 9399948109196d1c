"""How often the 95 % intervals hold the truth, over rigs drawn from the stated uncertainties.

`python -m tests.partition.coverage_study 100` prints coverage, bias and the cross-check's alarms; the study test runs
fewer.
"""

from __future__ import annotations

import sys
import warnings

import numpy as np
import pandas as pd
from joblib import Parallel, delayed

from tcdyn.core.errors import InputError
from tcdyn.partition.analyse import Partition
from tcdyn.partition.crosscheck import DEPTH_THRESHOLD, tensions
from tests.partition.study_rigs import StudyRig, study_rig

WAYS = ("speed law", "cooling fast", "cooling slow", "joint fast", "joint slow")


def one(seed: int, test: str = "B3") -> dict[str, float]:
    """Errors in standard uncertainties, and the alarms, of one drawn rig."""
    warnings.simplefilter("ignore")
    try:
        made = study_rig(seed, test)
        return told_of(made, made.analyse())
    except InputError as problem:
        print(seed, problem)
        return {"failed": 1.0}


def told_of(made: StudyRig, p: Partition) -> dict[str, float]:
    """Errors in standard uncertainties, and the alarms, of one analysed test."""
    told = made.told
    out: dict[str, float] = {"failed": 0.0}
    for way, value in p.beta_by_estimator.items():
        gap = value.value - told["beta"]
        out[f"error {way}"], out[f"z {way}"] = gap, gap / value.u
    both = p.both.estimates["beta"]
    out["error both"], out["z both"] = (
        both.value - told["beta"],
        (both.value - told["beta"]) / both.u,
    )
    for disk in ("fast", "slow"):
        lag = p.joint[disk].estimates["lag_s"]
        gap = lag.value - made.truth.disk(disk).common_lag_s
        out[f"error lag {disk}"], out[f"z lag {disk}"] = gap, gap / lag.u
        h = p.joint[disk].estimates["h"]
        out[f"z h joint {disk}"] = (h.value - told[f"h_{disk}"]) / h.u
        h = p.estimates[f"h_{disk}"]
        out[f"error h {disk}"] = h.value / told[f"h_{disk}"] - 1
        out[f"z h speed {disk}"] = (h.value - told[f"h_{disk}"]) / h.u
    n = p.both.estimates["exponent"]
    out["z exponent"] = (n.value - made.truth.speed_exponent) / n.u
    out["z check"] = p.crosscheck.z
    stated, place = made.rig.disk_setup("fast").junctions, p.sensors.depths if p.sensors else {}
    for disk, found in place.items():
        for channel, deeper in found.deeper_m.items():
            true_m = (
                made.truth.disk(disk).setup.junctions[channel].depth_m - stated[channel].depth_m
            )
            out[f"z depth {channel} {disk}"] = (deeper.value - true_m) / deeper.u
    pulls = tensions(made.test, p.joint, p.both, p.sensors)
    out["chance of the depths"] = min(
        t.probability for t in pulls if t.threshold == DEPTH_THRESHOLD
    )
    out["chance of the rest"] = min(t.probability for t in pulls if t.threshold != DEPTH_THRESHOLD)
    out["alarm"] = float(not p.crosscheck.agree)
    out["asks to be looked at"] = float(p.status != "sound")
    out["range held"] = float(p.model_forms.low95 <= told["beta"] <= p.model_forms.high95)
    out["range, half-width"] = 0.5 * (p.model_forms.high95 - p.model_forms.low95)
    out["log-odds of another structure"] = max(a.log_odds for a in p.model_forms.forms)
    out["sentence"] = p.crosscheck.sentence  # type: ignore[assignment]
    return out


def study(count: int, first: int = 1000, test: str = "B3", n_jobs: int = 2) -> pd.DataFrame:
    """One row per drawn rig."""
    rows = Parallel(n_jobs=n_jobs)(delayed(one)(seed, test) for seed in range(first, first + count))
    return pd.DataFrame(rows)


def report(table: pd.DataFrame) -> pd.DataFrame:
    """Bias, rms, coverage of every z."""
    rows = []
    for name in [c for c in table if str(c).startswith("z ") and c != "z check"]:
        z = table[name].dropna()
        e = table.get(str(name).replace("z ", "error ", 1))
        rows.append(
            {
                "what": str(name)[2:],
                "mean z": z.mean(),
                "rms z": np.sqrt((z**2).mean()),
                "covered by 95 %": (z.abs() < 1.96).mean(),
                "rms error": np.sqrt((e**2).mean()) if e is not None else np.nan,
                "largest": e.abs().max() if e is not None else np.nan,
            }
        )
    return pd.DataFrame(rows)


if __name__ == "__main__":
    done = study(
        int(sys.argv[1]) if len(sys.argv) > 1 else 100,
        n_jobs=int(sys.argv[2]) if len(sys.argv) > 2 else 2,
    )
    print(report(done).round(4).to_string(index=False))
    print("failed", int(done["failed"].sum()), "alarms", done["alarm"].mean())
    print(
        "exit code 1", done["asks to be looked at"].mean(), "range held", done["range held"].mean()
    )
    print(
        done[["range, half-width", "log-odds of another structure"]].describe().round(4).to_string()
    )
    print(*done.loc[done["alarm"] > 0, "sentence"], sep="\n")
    print(done[["z check"]].describe(percentiles=[0.5, 0.9, 0.95]).round(2).to_string())
    for chance in (0.01, 0.03, 0.1, 0.3):  # each should be undercut as often as it says, or less
        under = (done[["chance of the depths", "chance of the rest"]] < chance).mean()
        print(f"chance below {chance}: depths {under.iloc[0]:.3f}, the rest {under.iloc[1]:.3f}")
