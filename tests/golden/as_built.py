"""The numbers of this version: what every command of ``tests/cli/fault_commands.py`` writes and draws, and more.

``as_built.json`` holds them, long columns condensed to their size and two sums; the test beside it compares. They are
no truth, which other tests ask for: they show that something moved that nobody meant to move. What was meant to is
written anew by ``python -m tests.golden.as_built``, which prints what moved most. Numbers that hang on how a processor
rounds, for a search ends elsewhere, are held loosely, or left out: ``python -m tests.golden.as_built again`` finds them
on another one (``OPENBLAS_CORETYPE=Prescott NPY_DISABLE_CPU_FEATURES="AVX2 FMA3"``).
"""

from __future__ import annotations

import json
import math
import re
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from matplotlib.collections import Collection
from matplotlib.figure import Figure

from calibration.rig import load_rig
from tcdyn.compensate import deconvolve
from tcdyn.partition.analyse import Partition
from tcdyn.pipeline.tables import cooling_by_window, referee_table
from tcdyn.report import page
from tcdyn.simulate.plunge import simulate_hole
from tests.cli.fault_commands import LONG, QUICK, Trial, files_of_campaign, small_files
from tests.conftest import small_campaign
from tests.golden.answers import numbers
from tests.sensor.sensor_world import logged

BUILT = Path(__file__).with_name("as_built.json")
COMMANDS = {n: c for n, c in {**QUICK, **LONG}.items() if n not in ("demo", "campaign", "record check", "rig")}
ROW_BY_ROW = {"verify": "ours"}  # commands of whose table this column is kept cell by cell
SHORT, DIGITS = 6, 8  # columns up to this length are kept as they are; digits that are kept
OF_U, OF_ITSELF = 2e-2, 1e-3  # by which a value with an uncertainty may move, and any other number
LOOSELY = " loosely"  # of a group: thirty times as much
STEADY, LOOSE = 0.05, 30.0
NUMBER = re.compile(r"-?\d+\.?\d*(?:e-?\d+)?")
Numbers = dict[str, float]


def condensed(values: Any) -> Numbers:
    """Size, mean and a sum with uneven weights of the finite numbers among ``values``; these themselves where few."""
    x = np.ravel(np.asarray(values, dtype=float))
    x = x[np.isfinite(x)]
    if len(x) <= SHORT:
        return {str(k): float(v) for k, v in enumerate(x)}
    weight = np.cos(1.0 + np.arange(len(x)) ** 1.5)
    return {"count": float(len(x)), "size": float(np.abs(x).mean()), "mean": float(x.mean()),
            "sum": float(weight @ x / np.abs(weight).sum())}  # fmt: skip


def of_table(table: pd.DataFrame) -> dict[str, Numbers]:
    """Every column: its numbers, or those in its words."""
    columns: dict[str, Any] = {str(n): table[n] for n in table}
    for name, column in columns.items():
        if not pd.api.types.is_numeric_dtype(column):
            columns[name] = [float(n) for cell in column for n in NUMBER.findall(str(cell).replace(",", ""))]
    return {name: condensed(column) for name, column in columns.items()}


def of_json(value: Any) -> Any:
    """Nested dicts with lists, and lists of lists, of numbers condensed."""
    if isinstance(value, Mapping):
        return {k: of_json(v) for k, v in value.items()}
    if not isinstance(value, list):
        return value
    plain = all(isinstance(v, int | float) for one in value for v in (one if isinstance(one, list) else [one]))
    return condensed(np.hstack(value or [0.0])) if plain else {str(k): of_json(v) for k, v in enumerate(value)}


def of_figure(figure: Figure) -> dict[str, Any]:
    """Lines, marks, bars and limits of a picture."""
    drawn: dict[str, Any] = {}
    for k, ax in enumerate(figure.axes):
        drawn |= {f"{k} line {i}": condensed(line.get_xydata()) for i, line in enumerate(ax.lines)}
        for i, some in enumerate(c for c in ax.collections if isinstance(c, Collection)):
            offsets, paths = np.asarray(some.get_offsets(), dtype=float), [p.vertices for p in some.get_paths()]
            drawn[f"{k} marks {i}"] = condensed(np.concatenate([offsets.ravel(), *(np.ravel(p) for p in paths)]))
        drawn |= {f"{k} patch {i}": condensed(p.get_path().vertices) for i, p in enumerate(ax.patches)}
        drawn[f"{k} limits"] = condensed([*ax.get_xlim(), *ax.get_ylim()])
    return drawn


@contextmanager
def pictures() -> Iterator[list[Figure]]:
    """The pictures that would have been saved."""
    found: list[Figure] = []

    def seen(figure: Figure, to: Any, **_: Any) -> None:
        found.append(figure)
        if isinstance(to, str | Path):
            Path(to).touch()

    def on_page(figure: Figure, dpi: int = 0) -> str:
        found.append(figure)
        return "data:,"

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", seen)
        patch.setattr(page, "figure_data_uri", on_page)
        yield found


def of_command(name: str, world: dict[str, Path], folder: Path) -> Numbers:
    """What a command writes and draws."""
    trial = Trial(COMMANDS[name], world, folder)
    with pictures() as drawn:
        done = trial.go_on()
    assert done.code in (0, 1), done.said
    found: dict[str, Any] = {f"picture {k}": of_figure(figure) for k, figure in enumerate(drawn)}
    for path in sorted(folder.rglob("o*")):
        if path.suffix == ".json":
            found[path.name] = of_json(json.loads(path.read_text(encoding="utf-8")))
        elif path.suffix in (".csv", ".parquet"):
            read = pd.read_csv if path.suffix == ".csv" else pd.read_parquet
            table = read(path, **({"comment": "#"} if path.suffix == ".csv" else {}))
            found[path.name] = of_table(table)
            if name in ROW_BY_ROW:  # sums over rows of all sizes tell nothing of the small ones
                cells = table[ROW_BY_ROW[name]].astype(str)
                found["rows"] = {str(k): [float(n) for n in NUMBER.findall(cell)] for k, cell in enumerate(cells)}
    return rounded(found)


def rounded(found: Any) -> Numbers:
    """The numbers by their path, to some digits."""
    return {name: float(f"{value:.{DIGITS}g}") for name, value in numbers(found).items() if "sha256" not in name}


def of_functions(partition: Partition) -> dict[str, Callable[[], Any]]:
    """What no command writes."""
    _, _, y = logged((0.5,), 0.05, 600, 0.1, 2)
    own = partition.test.disks["slow"]

    def by(criterion: Any) -> Any:
        done, told = deconvolve(y, 0.05, 0.5, criterion=criterion, trials=15)
        return {"chosen": told.chosen.tolist(), "misfit": condensed(told.misfit), "x": condensed(done.temperature)}

    return {
        "referee": lambda: of_table(referee_table(partition)),
        "windows": lambda: of_table(cooling_by_window(partition, (1.0, 5.0))),
        "criteria": lambda: {c: by(c) for c in ("gcv", "discrepancy", "l-curve")},
        "traces": lambda: {"y": condensed(own.readings_degC), "u": condensed(own.static_u_K)},
    }


def world_of(campaign: Any, folder: Path) -> dict[str, Path]:
    """Inputs of all commands."""
    simulate_hole(1)[0].to_csv(folder / "hole.csv", index=False)
    found = {**small_files(folder), "hole": folder / "hole.csv"}
    return found | files_of_campaign(campaign.files, campaign.record_paths, folder)


def moved(now: Numbers, then: Numbers) -> list[tuple[float, str]]:
    """How far every number that was kept moved, in what it may move by; what is gone moved without end."""
    found = []
    for name, was in then.items():
        u = then.get(f"{name.removesuffix('value')}u") if name.endswith("/value") else None
        size = max(abs(was), *(abs(then.get(f"{name.rpartition('/')[0]}/{k}", 0.0)) for k in ("size", "0", "1")))
        far = abs(now[name] - was) if name in now else math.inf
        found.append((far / max(OF_U * u if u else OF_ITSELF * size, 1e-6 * size, 1e-12), name))
    return found


def parted(then: Numbers, far: Mapping[str, float]) -> tuple[Numbers, Numbers]:
    """Those that hardly moved, and those that moved by less than ``LOOSE`` tolerances."""
    steady = {name: value for name, value in then.items() if far[name] < STEADY}
    return steady, {name: value for name, value in then.items() if STEADY <= far[name] < STEADY * LOOSE}


def main(again: bool) -> None:
    """Write the numbers of the code at hand, and print what moved most; ``again``: part those that are there."""
    folder = Path(tempfile.mkdtemp())
    campaign = small_campaign(folder)
    from tcdyn.pipeline import estimate_beta

    partition = estimate_beta(campaign.files.ehl["B3"], load_rig(campaign.files.rig), campaign.records).partition
    world, now = world_of(campaign, folder), dict[str, Numbers]()
    for name in COMMANDS:
        (folder / "run").mkdir()
        now[name] = of_command(name, world, folder / "run")
        shutil.rmtree(folder / "run")
    now |= {name: rounded(made()) for name, made in of_functions(partition).items()}
    then = json.loads(BUILT.read_text(encoding="utf-8")) if BUILT.exists() else {}
    kept = dict(now)
    for group, found in now.items():
        far = moved(found, then.get(group, {}))
        print(group, len(found), *sorted(far, reverse=True)[:3], sep="  ")
        if again:
            kept[group], kept[group + LOOSELY] = parted(then.get(group, {}), {name: by for by, name in far})
    BUILT.write_text(json.dumps({k: v for k, v in kept.items() if v}, indent=0) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main("again" in sys.argv)
