"""Runs of the behaviour suite: a command each, on committed logs or small tables, and the estimates
that it writes."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

Estimates = dict[str, tuple[float, float]]  # value and standard uncertainty by path
ROW_STEP = 500  # every so many rows of a compensated log are stored
# Numbers that have no uncertainty of their own (a plan, a published row) are held to 0.1 %: 0.02 of
# this share.
ASSUMED_RELATIVE_U = 0.05


@dataclass(frozen=True)
class Run:
    """A command of the suite.

    Attributes
    ----------
    words : str
        Words of the command; ``{name}`` stands for an input file, ``{out}`` for the output.
    output : str
        Name of the output file, or of the one in the output folder that is read.
    is_smoke : bool
        Whether it belongs to the default tests.
    """

    words: str
    output: str
    is_smoke: bool = False


RECORDS = "--record {fast} --record {slow}"
RUNS = {
    "calibrate fast": Run(
        "rig calibrate --rig {rig} --disk fast --oven {oven_fast} --immersion {plunge_fast_1} "
        "--immersion {plunge_fast_2} --fluid mobil-jet-ii --out {out}",
        "record.json",
        True,
    ),
    "calibrate slow": Run(
        "rig calibrate --rig {rig} --disk slow --oven {oven_slow} --immersion {plunge_slow_1} "
        "--immersion {plunge_slow_2} --fluid mobil-jet-ii --out {out}",
        "record.json",
    ),
    "compensate a rig log": Run(
        f"compensate {{ehl_B3}} --rig {{rig}} {RECORDS} --out {{out}}", "out.csv", True
    ),
    "beta": Run(f"rig beta {{ehl_B3}} --rig {{rig}} {RECORDS} --out {{out}}", "beta.json"),
    "beta at the heaviest load": Run(
        f"rig beta {{ehl_D4}} --rig {{rig}} {RECORDS} --out {{out}}", "beta.json"
    ),
    "campaign": Run(
        f"rig campaign {{ehl_B3}} {{ehl_D4}} --rig {{rig}} {RECORDS} --workers 1 --out {{out}}",
        "results/campaign.json",
    ),
    "sensor new": Run("sensor new --tau-s 25+-1 --column TC1 --out {out}", "sensor.json"),
    "compensate any table": Run("compensate {furnace} --sensor {sensor} --out {out}", "out.csv"),
    "identify one model": Run("identify {binary} -u u -y y --model P2D --out {out}", "model.json"),
    "identify by search": Run("identify {binary} -u u -y y --out {out}", "model.json"),
    "identify a frequency response": Run(
        "response {bode} --column gain --column phase --model P1 --out {out}", "model.json"
    ),
    "sensor plunge": Run("sensor plunge {dip} --column T1 --out {out}", "sensor.json"),
    "sensor pair": Run("sensor pair {gas} --column T1 --column T2 --out {out}", "sensor.json"),
    "sensor noise": Run("sensor noise {steady} --column T1 --out {out}", "sensor.json"),
    "sensor current": Run(
        "sensor current {current} --column T1 --current I_mA --out {out}", "sensor.json"
    ),
    "design": Run("rig design --rig {rig} --out {out}", "plan.csv"),
    "verify": Run("verify --out {out}", "rows.csv"),
}


def words_of(run: Run, inputs: Mapping[str, Path], folder: Path) -> list[str]:
    """The words of a run with the paths of its files."""
    out = folder / run.output.partition("/")[0]
    return run.words.format(**{name: str(path) for name, path in inputs.items()}, out=out).split()


def estimates_of(run: Run, folder: Path) -> Estimates:
    """All estimates in the output of a run."""
    path = folder / run.output
    if path.suffix == ".json":
        return dict(_in_json(json.loads(path.read_text(encoding="utf-8")), ""))
    frame = pd.read_csv(path)
    return dict(_in_log(frame) if "time_s" in frame else _in_table(frame))


def _in_json(value: Any, path: str) -> Iterator[tuple[str, tuple[float, float]]]:
    """Every ``{"value", "u"}`` of a JSON document by its path, and the static lines of a record."""
    if isinstance(value, Mapping):
        if isinstance(value.get("value"), float | int) and isinstance(value.get("u"), float | int):
            yield path, (float(value["value"]), float(value["u"]))
        if isinstance(value.get("gain"), float) and isinstance(value.get("covariance"), list):
            u = np.sqrt(np.diag(np.array(value["covariance"])))
            yield f"{path}/gain", (value["gain"], float(u[0]))
            yield f"{path}/offset", (float(value["offset"]), float(u[1]))
        for name, part in value.items():
            yield from _in_json(part, f"{path}/{name}")
    elif isinstance(value, list):
        for k, part in enumerate(value):
            yield from _in_json(part, f"{path}/{k}")


def _in_log(frame: pd.DataFrame) -> Iterator[tuple[str, tuple[float, float]]]:
    """Temperatures and standard uncertainties of a compensated log, every ``ROW_STEP`` rows."""
    for name in frame:
        u_name = re.sub(r"_degC$", "_u_K", str(name))
        if u_name == name or u_name not in frame:
            continue
        for row in range(0, len(frame), ROW_STEP):
            yield f"{name} row {row}", (float(frame[name][row]), float(frame[u_name][row]))


def _in_table(frame: pd.DataFrame) -> Iterator[tuple[str, tuple[float, float]]]:
    """The numbers of a table that has no uncertainties."""
    for name in frame:
        for row, cell in enumerate(frame[name]):
            for k, text in enumerate(re.findall(r"-?\d+\.?\d*(?:e-?\d+)?", str(cell))):
                number = float(text)
                yield f"{name} row {row} number {k}", (number, ASSUMED_RELATIVE_U * abs(number))
