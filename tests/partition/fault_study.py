"""Single faults of wiring, switches, units and rig files: which messages they give, and whether any
is undetected.

`python -m tests.partition.fault_study COUNT SEED [FAULT ...]` prints for each fault how often its
cause is reported first, how often another fault is reported, and how often beta is more than 3 u
off without a warning. Each faulty log is written to a file and evaluated as the command `tcdyn rig
beta` does it.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
from joblib import Parallel, delayed

from tcdyn.core.errors import InputError
from tcdyn.core.findings import warnings_and_errors
from tcdyn.rig.disk import CHANNELS
from tcdyn.rig.rigfile import Rig, load_rig, parse_rig
from tcdyn.simulate.campaign import write_log
from tcdyn.simulate.truth import draw_truth
from tcdyn.workflows import estimate_beta
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


def changed(column: str, change: Callable[[pd.DataFrame], pd.Series]) -> LogChange:
    """One column computed anew from the log."""
    return lambda log: log.assign(**{column: change(log)})


def later(log: pd.DataFrame, column: str, start_s: float, value: float) -> pd.Series:
    """A column that has a constant value from a time on."""
    return log[column].where(log["time_s"] < start_s, value)


def _fahrenheit(log: pd.DataFrame) -> pd.DataFrame:
    names = [c for c in log if c.endswith("_degC")]
    return log.assign(**{c: 1.8 * log[c] + 32.0 for c in names})


def _disk_value(key: str, factor: float) -> Callable[[Rig], Rig]:
    """A rig file with one wrong value of both disks."""

    def wrong(rig: Rig) -> Rig:
        value = factor * getattr(rig.common.disk, key)
        return parse_rig({"disk": {key: value}}, "rig.toml")

    return wrong


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
    "dead": Case(
        ("fast_c_degC changes by",), lambda log: log.assign(fast_c_degC=log["ambient_degC"])
    ),
    "late": Case(
        ("channel e responds", "lag of junction e of the fast disk"), shifted("fast_e_degC", 0.5)
    ),
    "offset": Case(
        ("channel b reads", "static b"),
        lambda log: log.assign(fast_b_degC=log["fast_b_degC"] + 5.0),
    ),
    "contact late": Case(("contact switch",), shifted("contact", 2.0)),
    "contact early": Case(
        ("contact switch",),
        lambda log: log.assign(
            contact=np.minimum(log["contact"], log["contact"].shift(-150).ffill())
        ),
    ),
    "contact inverted": Case(
        ("readings are inverted", "inverted"), lambda log: log.assign(contact=1 - log["contact"])
    ),
    "friction in pounds": Case(("friction in pounds",), scaled(1 / 4.448, "friction_N")),
    "friction in kgf": Case(("friction in kilograms",), scaled(1 / 9.807, "friction_N")),
    "friction 4 times too large": Case(("logged frictional power",), scaled(4.0, "friction_N")),
    "friction negated": Case(("friction",), scaled(-1.0, "friction_N")),
    "speeds in rad/s": Case(
        ("speeds in rad/s",), scaled(1 / 9.549, "speed_fast_rpm", "speed_slow_rpm")
    ),
    "speeds in 1/s": Case(
        ("speeds in revolutions per second",), scaled(1 / 60, "speed_fast_rpm", "speed_slow_rpm")
    ),
    "speeds exchanged": Case(("speed_fast_rpm",), exchanged(("speed_fast_rpm", "speed_slow_rpm"))),
    "load and friction exchanged": Case(("friction",), exchanged(("load_N", "friction_N"))),
    "wrong steel": Case(("conductivity",), rig=_disk_value("conductivity_W_mK", 0.8)),
    "wrong specific heat": Case(("heat capacity",), rig=_disk_value("specific_heat_J_kgK", 0.8)),
    "all in Fahrenheit": Case(("Fahrenheit",), _fahrenheit),
    "one channel in Fahrenheit": Case(
        ("fast_c_degC", "channel c", "static c"),
        changed("fast_c_degC", lambda log: 1.8 * log["fast_c_degC"] + 32.0),
    ),
    "polarity reversed": Case(
        ("slow_d_degC", "channel d"),
        changed("slow_d_degC", lambda log: 2 * log["ambient_degC"] - log["slow_d_degC"]),
    ),
    "open from 200 s": Case(
        ("slow_f_degC", "channel f"),
        changed("slow_f_degC", lambda log: later(log, "slow_f_degC", 200.0, 1372.0)),
    ),
    "unplugged from 200 s": Case(
        ("slow_b_degC", "channel b"),
        changed("slow_b_degC", lambda log: log["slow_b_degC"].where(log["time_s"] < 200.0, 61.0)),
    ),
    "ambient and a junction exchanged": Case(
        ("ambient_degC changes",), exchanged(("ambient_degC", "slow_f_degC"))
    ),
    "contact stuck at 1": Case(
        ("contact",), changed("contact", lambda log: 0 * log["contact"] + 1)
    ),
    "contact stuck at 0": Case(("contact",), changed("contact", lambda log: 0 * log["contact"])),
    "load in kgf": Case(("load",), scaled(1 / 9.807, "load_N")),
    "load in kN": Case(("load",), scaled(1e-3, "load_N")),
    "load negated": Case(("load",), scaled(-1.0, "load_N")),
    "friction with an offset of 5 N": Case(
        ("friction",), changed("friction_N", lambda log: log["friction_N"] + 5.0)
    ),
    "clock 10 % fast": Case(("clock",), scaled(0.9, "time_s")),
}


def run_case(seed: int, name: str) -> dict[str, Any]:
    """Messages of one fault of one drawn rig."""
    warnings.simplefilter("ignore")
    case = CASES[name]
    nominal_rig = load_rig()
    row: dict[str, Any] = {"seed": seed, "fault": name, "quietly wrong": False}
    truth = draw_truth(seed, nominal_rig, uncertain=True)
    study = study_rig(seed, truth=truth)
    rig = case.rig(nominal_rig)
    records = {
        disk: record.model_copy(update={"setup": rig.tables(disk)})
        for disk, record in study.records.items()
    }
    try:
        with TemporaryDirectory() as folder:
            path = Path(folder) / "EHL_B3.csv"
            write_log(case.log_change(study.log.frame), path)
            p = estimate_beta(path, rig, records).partition
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
