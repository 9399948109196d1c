"""One simulated test, logged as rigs have it: beta by each form against beta by the full log, and against the truth.

`python -m tests.partition.as_logged_study 30 7000` prints, for 30 rigs drawn from seed 7000 on, how far beta of each
form lies from the full log's in its standard uncertainties, and how often its 95 % interval holds the truth. What is
stated in place of a column is drawn from the uncertainty that is stated with it. Every log is written and read.
"""

from __future__ import annotations

import sys
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tcdyn.core.errors import InputError
from tcdyn.partition.analyse import Partition, analyse
from tcdyn.rig.columns import is_junction_column
from tcdyn.rig.disk import DISKS
from tcdyn.rig.log import read_log
from tcdyn.rig.rigfile import parse_rig
from tcdyn.workflows.beta import prepare_test
from tests.partition.study_rigs import StudyRig, study_rig

LOAD_REL, SPEED_REL, AMBIENT_U_K = 0.03, 0.005, 2.0
CHANNEL_SD_K, PLACE_CHANNELS = 1.5, 4  # sixteen in all: two disks, surface and faces
ARM_m = 0.0381
Form = tuple[pd.DataFrame, dict[str, Any]]  # the log, and tables of its rig.toml


def full(frame: pd.DataFrame, rng: np.random.Generator) -> Form:
    """The log with every column."""
    return frame, {}


def no_contact(frame: pd.DataFrame, rng: np.random.Generator) -> Form:
    """Without the switch, as Clarke's and Voller's rigs."""
    return frame.drop(columns="contact"), {}


def stated(frame: pd.DataFrame, rng: np.random.Generator, u: dict[str, float]) -> Form:
    """Columns that are not in the log but stated, each wrong by a draw from its uncertainty."""
    loaded = frame[frame["contact"] > 0.5].tail(150 * 75).mean()
    constants = {
        n: {"value": float(loaded[n] + s * rng.standard_normal()), "u": s} for n, s in u.items()
    }
    return frame.drop(columns=[*u]), {"constants": constants}


def load_stated(frame: pd.DataFrame, rng: np.random.Generator) -> Form:
    """No load cell."""
    return stated(frame, rng, {"load_N": LOAD_REL * float(frame["load_N"].max())})


def speeds_stated(frame: pd.DataFrame, rng: np.random.Generator) -> Form:
    """No speeds."""
    names = [f"speed_{d}_rpm" for d in DISKS]
    return stated(frame, rng, {n: SPEED_REL * float(frame[n].mean()) for n in names})


def ambient_stated(frame: pd.DataFrame, rng: np.random.Generator) -> Form:
    """No thermometer in the enclosure."""
    return stated(frame, rng, {"ambient_degC": AMBIENT_U_K})


def ambient_channels(frame: pd.DataFrame, rng: np.random.Generator) -> Form:
    """Sixteen channels about the disks, each with an offset of its own."""
    room, tables, more = frame["ambient_degC"], dict[str, Any](), dict[str, Any]()
    for disk in DISKS:
        names = {
            p: [f"TC {disk} {p} {k}" for k in range(PLACE_CHANNELS)] for p in ("surface", "faces")
        }
        more |= {
            n: room + CHANNEL_SD_K * rng.standard_normal() for own in names.values() for n in own
        }
        tables[disk] = {"ambient": names}
    return frame.drop(columns="ambient_degC").assign(**more), tables


def torque_and_kelvin(frame: pd.DataFrame, rng: np.random.Generator) -> Form:
    """Friction as torque of the slow shaft, temperatures in kelvin."""
    kelvin = {n: f"{n.removesuffix('degC')}K" for n in frame if is_junction_column(str(n))}
    moved = frame.assign(
        **{n: frame[n] + 273.15 for n in kelvin}, friction_N=frame["friction_N"] * ARM_m
    )
    return moved.rename(columns={**kelvin, "friction_N": "torque_slow_Nm"}), {}


def least(frame: pd.DataFrame, rng: np.random.Generator) -> Form:
    """Friction as torque and the junctions; all else is stated, and no switch."""
    u = {"load_N": LOAD_REL * float(frame["load_N"].max()), "ambient_degC": AMBIENT_U_K}
    u |= {f"speed_{d}_rpm": SPEED_REL * float(frame[f"speed_{d}_rpm"].mean()) for d in DISKS}
    bare, tables = stated(frame, rng, u)
    return torque_and_kelvin(no_contact(bare, rng)[0], rng)[0], tables


FORMS: dict[str, Callable[[pd.DataFrame, np.random.Generator], Form]] = {
    f.__name__: f
    for f in (
        full,
        no_contact,
        load_stated,
        speeds_stated,
        ambient_stated,
        ambient_channels,
        torque_and_kelvin,
        least,
    )
}


def analysed(made: StudyRig, form: str, seed: int, **options: Any) -> Partition:
    """The test of a drawn rig, written in a form, read and analysed."""
    frame, tables = FORMS[form](
        made.log.frame, np.random.default_rng([seed, list(FORMS).index(form)])
    )
    rig = parse_rig(tables, "rig.toml")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "EHL.csv"
        frame.to_csv(path, index=False)
        return analyse(prepare_test(read_log(path, "ehl", rig), rig, made.records), **options)


def one(seed: int, forms: list[str]) -> list[dict[str, Any]]:
    """A row for each form of one drawn rig's log."""
    warnings.simplefilter("ignore")
    made, rows, whole = study_rig(seed), [], np.nan
    for form in forms:
        try:
            p = analysed(made, form, seed, sensor_check=False)
        except InputError as problem:
            rows.append({"seed": seed, "form": form, "failed": str(problem)})
            continue
        beta, row = p.both.estimates["beta"], {"seed": seed, "form": form, "status": p.status}
        whole = beta.value if form == "full" else whole
        for name, value in {"both": beta, **p.beta_by_estimator}.items():
            row |= {f"u {name}": value.u, f"z {name}": (value.value - made.told["beta"]) / value.u}
        late = p.test.events.unload_s - made.told["unload_s"]
        row |= {
            "from full": (beta.value - whole) / beta.u,
            "z parting": late / p.test.events.unload_u_s,
        }
        rows.append(row)
    return rows


if __name__ == "__main__":
    count, first, chosen = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3:] or list(FORMS)
    found = []
    for k in range(count):
        found += one(first + k, chosen)
        print(first + k, flush=True)
    table = pd.DataFrame(found)
    for form, part in table.groupby("form", sort=False):
        z, lost = (
            part[[c for c in part if str(c).startswith("z ")]],
            part["failed"].notna() if "failed" in part else 0,
        )
        print(
            f"{form}: from the full log at most {part['from full'].abs().max():.2f} u, u {part['u both'].mean():.4f},"
        )
        print(part["status"].value_counts().to_dict(), "failed", int(np.sum(lost)))
        told = {"rms z": np.sqrt((z**2).mean()), "covered by 95 %": (z.abs() < 1.96).mean()}
        print(pd.DataFrame(told).round(2).T.to_string())
