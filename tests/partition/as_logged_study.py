"""One simulated test, logged in different forms: beta of each form against beta of the full log and
the truth.

`python -m tests.partition.as_logged_study 30 7000` prints for 30 rigs drawn from seed 7000 on how
far beta of each form is from that of the full log in standard uncertainties, and the coverage of
its 95 % interval. A constant in place of a column is drawn from its specified uncertainty. Every
log is written to a file and read.
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
from tcdyn.partition.prepare import prepare_test
from tcdyn.rig.columns import is_junction_column
from tcdyn.rig.disk import DISKS
from tcdyn.rig.log import read_log
from tcdyn.rig.rigfile import parse_rig
from tests.partition.study_rigs import StudyRig, study_rig

LOAD_REL = 0.03
SPEED_REL = 0.005
AMBIENT_U_K = 2.0
CHANNEL_SD_K = 1.5
CHANNELS_PER_LOCATION = 4  # sixteen in all: two disks, surface and faces
ARM_m = 0.0381
Form = tuple[pd.DataFrame, dict[str, Any]]  # the log, and tables of its rig.toml


def full(frame: pd.DataFrame, rng: np.random.Generator) -> Form:
    """The log with every column."""
    return frame, {}


def no_contact(frame: pd.DataFrame, rng: np.random.Generator) -> Form:
    """Without the contact switch, as the rigs of Clarke and Voller."""
    return frame.drop(columns="contact"), {}


def with_constants(frame: pd.DataFrame, rng: np.random.Generator, u: dict[str, float]) -> Form:
    """Replace columns by constants, each with an error drawn from its uncertainty."""
    loaded = frame[frame["contact"] > 0.5].tail(150 * 75).mean()
    constants = {
        n: {"value": float(loaded[n] + s * rng.standard_normal()), "u": s} for n, s in u.items()
    }
    return frame.drop(columns=[*u]), {"constants": constants}


def load_constant(frame: pd.DataFrame, rng: np.random.Generator) -> Form:
    """No load cell; the load is a constant."""
    return with_constants(frame, rng, {"load_N": LOAD_REL * float(frame["load_N"].max())})


def speeds_constant(frame: pd.DataFrame, rng: np.random.Generator) -> Form:
    """No speed columns; the speeds are constants."""
    names = [f"speed_{d}_rpm" for d in DISKS]
    return with_constants(frame, rng, {n: SPEED_REL * float(frame[n].mean()) for n in names})


def ambient_constant(frame: pd.DataFrame, rng: np.random.Generator) -> Form:
    """No ambient column; the ambient is a constant."""
    return with_constants(frame, rng, {"ambient_degC": AMBIENT_U_K})


def ambient_channels(frame: pd.DataFrame, rng: np.random.Generator) -> Form:
    """Sixteen ambient channels near the disks, each with its own offset."""
    room = frame["ambient_degC"]
    tables = dict[str, Any]()
    columns = dict[str, Any]()
    for disk in DISKS:
        names = {
            location: [f"TC {disk} {location} {k}" for k in range(CHANNELS_PER_LOCATION)]
            for location in ("surface", "faces")
        }
        columns |= {
            n: room + CHANNEL_SD_K * rng.standard_normal()
            for names_of_location in names.values()
            for n in names_of_location
        }
        tables[disk] = {"ambient": names}
    return frame.drop(columns="ambient_degC").assign(**columns), tables


def torque_and_kelvin(frame: pd.DataFrame, rng: np.random.Generator) -> Form:
    """Friction as torque of the slow shaft, temperatures in kelvin."""
    kelvin = {n: f"{n.removesuffix('degC')}K" for n in frame if is_junction_column(str(n))}
    converted = frame.assign(
        **{n: frame[n] + 273.15 for n in kelvin}, friction_N=frame["friction_N"] * ARM_m
    )
    return converted.rename(columns={**kelvin, "friction_N": "torque_slow_Nm"}), {}


def minimal(frame: pd.DataFrame, rng: np.random.Generator) -> Form:
    """Only torque and junctions; constants for everything else, and no switch."""
    u = {"load_N": LOAD_REL * float(frame["load_N"].max()), "ambient_degC": AMBIENT_U_K}
    u |= {f"speed_{d}_rpm": SPEED_REL * float(frame[f"speed_{d}_rpm"].mean()) for d in DISKS}
    frame_without, tables = with_constants(frame, rng, u)
    return torque_and_kelvin(no_contact(frame_without, rng)[0], rng)[0], tables


FORMS: dict[str, Callable[[pd.DataFrame, np.random.Generator], Form]] = {
    f.__name__: f
    for f in (
        full,
        no_contact,
        load_constant,
        speeds_constant,
        ambient_constant,
        ambient_channels,
        torque_and_kelvin,
        minimal,
    )
}


def analyse_form(study: StudyRig, form: str, seed: int, **options: Any) -> Partition:
    """Write the test of a drawn rig in a form, read it and analyse it."""
    frame, tables = FORMS[form](
        study.log.frame, np.random.default_rng([seed, list(FORMS).index(form)])
    )
    rig = parse_rig(tables, "rig.toml")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "EHL.csv"
        frame.to_csv(path, index=False)
        return analyse(prepare_test(read_log(path, "ehl", rig), rig, study.records), **options)


def rows_of_rig(seed: int, forms: list[str]) -> list[dict[str, Any]]:
    """A row for each form of the log of one drawn rig."""
    warnings.simplefilter("ignore")
    study = study_rig(seed)
    rows = []
    full_beta = np.nan
    for form in forms:
        try:
            analysis = analyse_form(study, form, seed, sensor_check=False)
        except InputError as problem:
            rows.append({"seed": seed, "form": form, "failed": str(problem)})
            continue
        beta = analysis.combined.estimates["beta"]
        row = {"seed": seed, "form": form, "status": analysis.status}
        full_beta = beta.value if form == "full" else full_beta
        for name, value in {"both": beta, **analysis.beta_by_estimator}.items():
            row |= {
                f"u {name}": value.u,
                f"z {name}": (value.value - study.true_values["beta"]) / value.u,
            }
        unload_error_s = analysis.test.events.unload_s - study.true_values["unload_s"]
        row |= {
            "from full": (beta.value - full_beta) / beta.u,
            "z unloading": unload_error_s / analysis.test.events.unload_u_s,
        }
        rows.append(row)
    return rows


if __name__ == "__main__":
    count = int(sys.argv[1])
    first = int(sys.argv[2])
    forms = sys.argv[3:] or list(FORMS)
    rows = []
    for k in range(count):
        rows += rows_of_rig(first + k, forms)
        print(first + k, flush=True)
    table = pd.DataFrame(rows)
    for form, group in table.groupby("form", sort=False):
        z = group[[c for c in group if str(c).startswith("z ")]]
        failed = group["failed"].notna() if "failed" in group else 0
        print(
            f"{form}: from the full log at most {group['from full'].abs().max():.2f} u, u "
            f"{group['u both'].mean():.4f},"
        )
        print(group["status"].value_counts().to_dict(), "failed", int(np.sum(failed)))
        summary = {"rms z": np.sqrt((z**2).mean()), "covered by 95 %": (z.abs() < 1.96).mean()}
        print(pd.DataFrame(summary).round(2).T.to_string())
