"""Coverage of the 95 % intervals over rigs drawn from their specified uncertainties.

`python -m tests.partition.coverage_study COUNT SEED` prints coverage, bias and false alarms of the
cross-check. The study test runs fewer rigs.
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

ESTIMATORS = ("speed law", "cooling fast", "cooling slow", "joint fast", "joint slow")


def run_case(seed: int, test: str = "B3") -> dict[str, float]:
    """Errors in standard uncertainties and alarms of one drawn rig."""
    warnings.simplefilter("ignore")
    try:
        study = study_rig(seed, test)
        return study_errors(study, study.analyse())
    except InputError as problem:
        print(seed, problem)
        return {"failed": 1.0}


def study_errors(study: StudyRig, p: Partition) -> dict[str, float]:
    """Errors in standard uncertainties and alarms of one analysed test."""
    true_values = study.true_values
    errors: dict[str, float] = {"failed": 0.0}
    for estimator, estimate in p.beta_by_estimator.items():
        error = estimate.value - true_values["beta"]
        errors[f"error {estimator}"] = error
        errors[f"z {estimator}"] = error / estimate.u
    both = p.combined.estimates["beta"]
    errors["error both"] = both.value - true_values["beta"]
    errors["z both"] = errors["error both"] / both.u
    for disk in ("fast", "slow"):
        lag = p.joint[disk].estimates["lag_s"]
        error = lag.value - study.truth.disk(disk).common_lag_s
        errors[f"error lag {disk}"] = error
        errors[f"z lag {disk}"] = error / lag.u
        h = p.joint[disk].estimates["h"]
        errors[f"z h joint {disk}"] = (h.value - true_values[f"h_{disk}"]) / h.u
        h = p.estimates[f"h_{disk}"]
        errors[f"error h {disk}"] = h.value / true_values[f"h_{disk}"] - 1
        errors[f"z h speed {disk}"] = (h.value - true_values[f"h_{disk}"]) / h.u
    n = p.combined.estimates["exponent"]
    errors["z exponent"] = (n.value - study.truth.speed_exponent) / n.u
    errors["z check"] = p.crosscheck.z
    nominal = study.rig.disk_setup("fast").junctions
    depth_tests = p.sensors.depths if p.sensors else {}
    for disk, depth_test in depth_tests.items():
        for channel, shift in depth_test.deeper_m.items():
            true_m = (
                study.truth.disk(disk).setup.junctions[channel].depth_m - nominal[channel].depth_m
            )
            errors[f"z depth {channel} {disk}"] = (shift.value - true_m) / shift.u
    pulls = tensions(study.test, p.joint, p.combined, p.sensors)
    errors["p_value of the depths"] = min(
        tension.probability for tension in pulls if tension.threshold == DEPTH_THRESHOLD
    )
    errors["p_value of the rest"] = min(
        tension.probability for tension in pulls if tension.threshold != DEPTH_THRESHOLD
    )
    errors["alarm"] = float(not p.crosscheck.agree)
    errors["status not sound"] = float(p.status != "sound")
    errors["range covers"] = float(
        p.model_forms.low95 <= true_values["beta"] <= p.model_forms.high95
    )
    errors["range, half-width"] = 0.5 * (p.model_forms.high95 - p.model_forms.low95)
    errors["log-odds of another model form"] = max(form.log_odds for form in p.model_forms.forms)
    errors["sentence"] = p.crosscheck.sentence  # type: ignore[assignment]
    return errors


def run_study(count: int, first: int = 1000, test: str = "B3", n_jobs: int = 2) -> pd.DataFrame:
    """One row per drawn rig."""
    rows = Parallel(n_jobs=n_jobs)(
        delayed(run_case)(seed, test) for seed in range(first, first + count)
    )
    return pd.DataFrame(rows)


def report(table: pd.DataFrame) -> pd.DataFrame:
    """Bias, rms and coverage of every z."""
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
    numbers = [int(word) for word in sys.argv[1:]]
    rows_of_rigs = run_study(*(numbers or [100]))
    print(report(rows_of_rigs).round(4).to_string(index=False))
    print("failed", int(rows_of_rigs["failed"].sum()), "alarms", rows_of_rigs["alarm"].mean())
    print(
        "with a warning",
        rows_of_rigs["status not sound"].mean(),
        "range covers",
        rows_of_rigs["range covers"].mean(),
    )
    print(
        rows_of_rigs[["range, half-width", "log-odds of another model form"]]
        .describe()
        .round(4)
        .to_string()
    )
    print(*rows_of_rigs.loc[rows_of_rigs["alarm"] > 0, "sentence"], sep="\n")
    print(rows_of_rigs[["z check"]].describe(percentiles=[0.5, 0.9, 0.95]).round(2).to_string())
    for p_value in (0.01, 0.03, 0.1, 0.3):  # the share below each should be at most its value
        under = (rows_of_rigs[["p_value of the depths", "p_value of the rest"]] < p_value).mean()
        print(f"p_value below {p_value}: depths {under.iloc[0]:.3f}, the rest {under.iloc[1]:.3f}")
