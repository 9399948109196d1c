"""Single faults of wiring, switches, units and rig files: which messages they give, and whether any is undetected.

`python -m tests.partition.fault_study COUNT SEED [FAULT ...]` prints for each fault how often its cause is reported
first, how often another fault is reported, and how often beta is more than 3 u off without a warning.
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

LogChange = Callable[[pd.DataFrame], pd.DataFrame]


@dataclass(frozen=True)
class Case:
    """A fault: its change of the log or of the rig file, and words that identify its cause."""

    cause_words: tuple[str, ...]
    log_change: LogChange = lambda log: log
    rig: Callable[[Rig], Rig] = lambda rig: rig


def exchanged(*pairs: tuple[str, str]) -> LogChange:
    """Columns exchanged in pairs."""
    names = {a: b for pair in pairs for a, b in (pair, pair[::-1])}
    return lambda log: log.rename(columns=names)[list(log.columns)]


def scaled(factor: float, *columns: str) -> LogChange:
    """Columns in other units."""
    return lambda log: log.assign(**{c: factor * log[c] for c in columns})


def shifted(column: str, seconds: float) -> LogChange:
    """A column delayed by ``seconds``."""
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
    "all cables": Case(("cables of the two disks",), exchanged(*CABLE)),
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
    "friction in pounds": Case(("friction in pounds",), scaled(1 / 4.448, "friction_N")),
    "friction in kgf": Case(("friction in kilograms",), scaled(1 / 9.807, "friction_N")),
    "friction negated": Case(("friction",), scaled(-1.0, "friction_N")),
    "speeds in rad/s": Case(
        ("speeds in rad/s",), scaled(1 / 9.549, "speed_fast_rpm", "speed_slow_rpm")
    ),
    "speeds in 1/s": Case(
        ("speeds in revolutions per second",), scaled(1 / 60, "speed_fast_rpm", "speed_slow_rpm")
    ),
    "speeds exchanged": Case(("surface speeds",), exchanged(("speed_fast_rpm", "speed_slow_rpm"))),
    "load and friction exchanged": Case(("friction",), exchanged(("load_N", "friction_N"))),
    "wrong steel": Case(("conductivity", "steel"), rig=_steel),
}


def run_case(seed: int, name: str) -> dict[str, Any]:
    """Messages of one fault of one drawn rig."""
    warnings.simplefilter("ignore")
    case = CASES[name]
    nominal_rig = load_rig()
    row: dict[str, Any] = {"seed": seed, "fault": name, "quietly wrong": False}
    truth = draw_truth(seed, nominal_rig, uncertain=True)
    try:
        study = study_rig(seed, truth=truth, rig=case.rig(nominal_rig), log_change=case.log_change)
        p = study.analyse()
    except InputError as problem:
        messages = [str(problem)]
        row["status"] = "refused"
    else:
        both = p.combined.estimates["beta"]
        z = (both.value - study.true_values["beta"]) / both.u
        row["status"] = p.status
        row["z"] = z
        row["quietly wrong"] = p.status == "sound" and abs(z) > 3
        messages = [f.sentence for f in warnings_and_errors(p.findings)]
    matches = [
        k for k, text in enumerate(messages) if any(words in text for words in case.cause_words)
    ]
    row["first"] = matches[:1] == [0]
    row["reported"] = bool(matches)
    is_swap = "exchanged" in name or "both" in name
    row["wrongly swapped"] = not is_swap and any("look swapped" in text for text in messages)
    row["messages"] = " | ".join(messages)[:300]
    return row


def run_study(count: int, first: int, names: list[str], n_jobs: int = 2) -> pd.DataFrame:
    """A row for each fault of each rig."""
    jobs = [(seed, name) for name in names for seed in range(first, first + count)]
    return pd.DataFrame(Parallel(n_jobs=n_jobs)(delayed(run_case)(*job) for job in jobs))


if __name__ == "__main__":
    table = run_study(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3:] or list(CASES))
    print(table.drop(columns=["seed"]).round(2).to_string())
    sums = table.groupby("fault", sort=False)[
        ["first", "reported", "wrongly swapped", "quietly wrong"]
    ].mean()
    print(sums.round(2).to_string())
    print(sums.mean().round(3).to_string())
