"""How often the 95 % intervals of beta hold the truth when one channel of the twelve is left out.

`python -m tests.partition.five_of_six_study 3 1000` leaves out each in turn on three drawn rigs, from seed 1000 on.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator

import numpy as np
import pandas as pd

from tcdyn.core.errors import InputError
from tcdyn.core.findings import Severity
from tcdyn.partition.analyse import analyse
from tcdyn.rig.disk import CHANNELS, DISKS
from tests.partition.study_rigs import study_rig

TWELVE = tuple(f"{disk}_{channel}" for disk in DISKS for channel in CHANNELS)


def of_one_rig(seed: int, test: str = "B3") -> Iterator[dict[str, object]]:
    """A row for each way to beta with all channels (``left_out`` "none") and without each: error, u, and what was said.

    ``wider``: standard uncertainty over that with all channels.
    """
    made = study_rig(seed, test)
    complete: dict[str, float] = {}
    for name in ("none", *TWELVE):
        try:
            p = analyse(made.test if name == "none" else made.without(name))
        except InputError as problem:
            print(seed, name, problem)
            yield {"seed": seed, "left_out": name, "way": "both", "failed": True}
            continue
        ways = {**p.beta_by_estimator, "both": p.both.estimates["beta"]}
        complete = complete or {way: e.u for way, e in ways.items()}
        suspects = () if p.sensors is None else p.sensors.suspects
        for way, e in ways.items():
            yield {
                "seed": seed,
                "left_out": name,
                "way": way,
                "failed": False,
                "error": e.value - made.told["beta"],
                "u": e.u,
                "wider": e.u / complete[way],
                "alarm": not p.crosscheck.agree,
                "accused": any(s.finding.severity is not Severity.INFO for s in suspects),
            }


def study(count: int, first: int = 1000) -> pd.DataFrame:
    """The rows of ``count`` drawn rigs."""
    return pd.DataFrame([row for seed in range(first, first + count) for row in of_one_rig(seed)])


def report(table: pd.DataFrame) -> pd.DataFrame:
    """Coverage, rms z and widening of each way, with all channels, without one of the outer or of the inner row."""
    done = table[~table["failed"]].copy()
    row = done["left_out"].str[-1].map(lambda c: "a, c or e" if c in "ac" else "b, d or f")
    done["without"] = row.where(done["left_out"] != "none", "none").where(
        done["left_out"].str[-2:] != "_e", "a, c or e"
    )
    done["z"] = done["error"] / done["u"]
    groups = done.groupby(["way", "without"], sort=False)
    return groups.agg(
        runs=("z", "size"),
        covered=("z", lambda z: float((z.abs() < 1.96).mean())),
        rms_z=("z", lambda z: float(np.sqrt((z**2).mean()))),
        rms_error=("error", lambda e: float(np.sqrt((e**2).mean()))),
        mean_u=("u", "mean"),
        wider=("wider", "mean"),
        widest=("wider", "max"),
        alarms=("alarm", "mean"),
        accused=("accused", "mean"),
    ).reset_index()


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    found = study(*(int(word) for word in sys.argv[1:3]))
    print(report(found).round(4).to_string(index=False))
    both = found[found["way"] == "both"]
    print(both.round(4).to_string(index=False))
    print("failed", int(found["failed"].sum()))
