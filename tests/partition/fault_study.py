"""Single faults of wiring, indicators, units and statements: what is said of each, and is a wrong result ever quiet?

`python -m tests.partition.fault_study COUNT SEED [FAULT ...]` prints for each fault how often its cause is told first,
how often another fault is named, and how often beta is more than three standard uncertainties off with exit code 0.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from joblib import Parallel, delayed

from tcdyn.core.errors import InputError
from tcdyn.core.findings import warnings_and_errors
from tcdyn.rig.disk import CHANNELS
from tcdyn.rig.rigfile import Rig, load_rig, parse_rig
from tcdyn.simulate.truth import draw_truth
from tests.partition.study_rigs import study_rig

Disturbed = Callable[[pd.DataFrame], pd.DataFrame]


@dataclass(frozen=True)
class Case:
    """A fault, what it does to the log or to the rig file, and words that tell of its cause."""

    words: tuple[str, ...]
    disturbed: Disturbed = lambda log: log
    rig: Callable[[Rig], Rig] = lambda rig: rig


def exchanged(*pairs: tuple[str, str]) -> Disturbed:
    """Columns exchanged by pairs."""
    names = {a: b for pair in pairs for a, b in (pair, pair[::-1])}
    return lambda log: log.rename(columns=names)[list(log.columns)]


def times(factor: float, *columns: str) -> Disturbed:
    """Columns in other units."""
    return lambda log: log.assign(**{c: factor * log[c] for c in columns})


def shifted(column: str, seconds: float) -> Disturbed:
    """A column late by so many seconds."""
    rows = int(round(75 * seconds))
    return lambda log: log.assign(**{column: log[column].shift(rows).ffill().bfill()})


def _steel(rig: Rig) -> Rig:
    return parse_rig(
        {"disk": {"conductivity_W_mK": 0.8 * rig.common.disk.conductivity_W_mK}}, "rig.toml"
    )


CABLE = [(f"fast_{c}_degC", f"slow_{c}_degC") for c in CHANNELS]
CASES: dict[str, Case] = {
    "a and e exchanged": Case(
        ("channels a and e look swapped",), exchanged(("fast_a_degC", "fast_e_degC"))
    ),
    "b and d exchanged": Case(("b and d look swapped",), exchanged(("slow_b_degC", "slow_d_degC"))),
    "c and f exchanged": Case(("c and f look swapped",), exchanged(("fast_c_degC", "fast_f_degC"))),
    "e of both disks": Case(
        ("channels e of the fast disk and e",), exchanged(("fast_e_degC", "slow_e_degC"))
    ),
    "whole cables": Case(("cables of the two disks",), exchanged(*CABLE)),
    "copy": Case(
        ("fast_a_degC and fast_c_degC",), lambda log: log.assign(fast_c_degC=log["fast_a_degC"])
    ),
    "dead": Case(("channel c is dead",), lambda log: log.assign(fast_c_degC=log["ambient_degC"])),
    "late": Case(
        ("channel e responds", "lag of junction e of the fast disk"), shifted("fast_e_degC", 0.5)
    ),
    "offset": Case(
        ("channel b reads", "static b"),
        lambda log: log.assign(fast_b_degC=log["fast_b_degC"] + 5.0),
    ),
    "contact late": Case(("disagree on the unloading", "disagree"), shifted("contact", 2.0)),
    "contact early": Case(
        ("disagree on the unloading", "disagree"),
        lambda log: log.assign(
            contact=np.minimum(log["contact"], log["contact"].shift(-150).ffill())
        ),
    ),
    "contact inverted": Case(
        ("readings are inverted", "inverted"), lambda log: log.assign(contact=1 - log["contact"])
    ),
    "friction in pounds": Case(("friction in pounds",), times(1 / 4.448, "friction_N")),
    "friction in kgf": Case(("friction in kilograms",), times(1 / 9.807, "friction_N")),
    "friction turned": Case(("friction",), times(-1.0, "friction_N")),
    "speeds in rad/s": Case(
        ("speeds in rad/s",), times(1 / 9.549, "speed_fast_rpm", "speed_slow_rpm")
    ),
    "speeds in 1/s": Case(
        ("speeds in revolutions per second",), times(1 / 60, "speed_fast_rpm", "speed_slow_rpm")
    ),
    "speeds exchanged": Case(("surface speeds",), exchanged(("speed_fast_rpm", "speed_slow_rpm"))),
    "load and friction exchanged": Case(("friction",), exchanged(("load_N", "friction_N"))),
    "wrong steel": Case(("conductivity", "steel"), rig=_steel),
}


def one(seed: int, name: str) -> dict[str, Any]:
    """What is said of one fault of one drawn rig."""
    warnings.simplefilter("ignore")
    case, stated = CASES[name], load_rig()
    out: dict[str, Any] = {"seed": seed, "fault": name, "quietly wrong": False}
    true = draw_truth(seed, stated, uncertain=True)
    try:
        made = study_rig(seed, truth=true, rig=case.rig(stated), disturbed=case.disturbed)
        p = made.analyse()
    except InputError as problem:
        said, out["status"] = [str(problem)], "refused"
    else:
        both = p.both.estimates["beta"]
        out["status"], out["z"] = p.status, (both.value - made.told["beta"]) / both.u
        out["quietly wrong"] = p.status == "sound" and abs(out["z"]) > 3
        said = [f.sentence for f in warnings_and_errors(p.findings)]
    told = [k for k, sentence in enumerate(said) if any(word in sentence for word in case.words)]
    out["first"], out["told"] = told[:1] == [0], bool(told)
    out["wrongly swapped"] = (
        any("look swapped" in s for s in said) and "exchanged" not in name and "both" not in name
    )
    return out | {"said": " | ".join(said)[:300]}


def study(count: int, first: int, names: list[str], n_jobs: int = 2) -> pd.DataFrame:
    """A row for each fault of each rig."""
    jobs = [(seed, name) for name in names for seed in range(first, first + count)]
    return pd.DataFrame(Parallel(n_jobs=n_jobs)(delayed(one)(*job) for job in jobs))


if __name__ == "__main__":
    table = study(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3:] or list(CASES))
    print(table.drop(columns=["seed"]).round(2).to_string())
    sums = table.groupby("fault", sort=False)[
        ["first", "told", "wrongly swapped", "quietly wrong"]
    ].mean()
    print(sums.round(2).to_string())
    print(sums.mean().round(3).to_string())
