"""Every command that reads or writes files, on small inputs; what of it takes long is computed
once."""

from __future__ import annotations

import contextlib
import copy
import importlib
import io
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tcdyn.sensors import specified_sensor, write_sensor
from tests.cli.fault_world import (
    FILES,
    PROBLEMS,
    Ended,
    Home,
    Machine,
    complaints,
    content,
    refusing,
)
from tests.cli.test_main_job import tcdyn
from tests.sensors.sensor_world import fluctuating, logged, write

OLD = "old\n"
PICTURE = "tcdyn.report.page:figure_data_uri"


@dataclass(frozen=True)
class Command:
    """Words of a command, {name} for a file of the world; its outputs; the functions computed once
    (module:name).

    ``grows``: the output that is written row by row.
    """

    words: str
    outputs: tuple[str, ...] = ()
    once: tuple[str, ...] = ()
    grows: str = ""


RECORDS = "--record {fast} --record {slow} -q"
QUICK = {
    "compensate --sensor": Command(
        "compensate {table} --sensor {sensor} --out o.csv -q", ("o.csv",)
    ),
    "compensate to Parquet": Command(
        "compensate {table} --sensor {sensor} --out o.parquet -q", ("o.parquet",)
    ),
    "follow --sensor": Command(
        "follow {short} --sensor {sensor} --out o.csv --state o.json --delay-s 2 --idle-s 0 -q",
        ("o.csv",),
        grows="o.csv",
    ),
    "sensor new": Command("sensor new --tau-s 1.5+-0.1 --column T1 --out o.json -q", ("o.json",)),
    "sensor show": Command("sensor show {sensor}"),
    "sensor plunge": Command(
        "sensor plunge {dip} --column T1 --out o.json -q",
        ("o.json",),
        ("tcdyn.sensors.measure:plunge_sensor",),
    ),
    "sensor pair": Command(
        "sensor pair {table} --column T1_degC --column T2_degC --out o.json -q",
        ("o.json",),
        ("tcdyn.sensors.measure:pair_sensor",),
    ),
    "sensor noise": Command(
        "sensor noise {steady} --column T1_degC --out o.json -q",
        ("o.json",),
        ("tcdyn.sensors.measure:noise_sensor",),
    ),
    "sensor current": Command(
        "sensor current {lcsr} --column T1_degC --current I_mA --out o.json -q",
        ("o.json",),
        ("tcdyn.sensors.measure:current_sensor",),
    ),
    "sensor touch": Command(
        "sensor touch {table} --column T* --picture o.png -q",
        ("o.png",),
        ("tcdyn.sensors.touch:find_touches",),
    ),
    "response": Command(
        "response {bode} --column gain --column phase --model P1 --out o.json -q", ("o.json",)
    ),
    "identify": Command(
        "identify {table} --input u --output T1_degC --model P1 --out o.json --report o.html -q",
        ("o.json", "o.html"),
        ("tcdyn.identification:compare", PICTURE),
    ),
    "rig": Command("rig check {rig} -q"),
    "transducer": Command("rig transducer {weights} --out o.json -q", ("o.json",)),
    "spot": Command("rig line {spot}"),
    "record show": Command("rig record show {fast}"),
    "record diff": Command("rig record diff {fast} {fast}"),
    "record check": Command("rig record check {fast} -q"),
    "round fit": Command("rig circumference fit --rig {fit} --picture o.png -q", ("o.png",)),
    "round simulate": Command(
        "rig circumference simulate --rig {rig} --picture o.png -q",
        ("o.png",),
        ("tcdyn.simulate.field:disk_fields",),
    ),
    "design": Command(
        "rig design --rig {rig} --out o.csv -q", ("o.csv",), ("tcdyn.design.compare:compare_tests",)
    ),
    "design to a page": Command(
        "rig design --rig {rig} --out o.html -q",
        ("o.html",),
        ("tcdyn.design.compare:compare_tests", PICTURE),
    ),
    "rig design --campaign": Command(
        "rig design --campaign {plan} --out o.csv -q",
        ("o.csv",),
        ("tcdyn.campaign.planned:predict_campaign",),
    ),
    "verify": Command(
        "verify --out o.csv --report o.html -q",
        ("o.csv", "o.html"),
        ("tcdyn.verify:verify_rows", "tcdyn.plots.conduction:verify_figures", PICTURE),
    ),
    "simulate oven": Command(
        "simulate oven --rig {rig} --out o.csv -q",
        ("o.csv", "o.truth.json", "o.truth.parquet"),
        ("tcdyn.simulate.measure:simulate_oven",),
    ),
    "simulate immersion": Command(
        "simulate immersion --out o.csv -q",
        ("o.csv", "o.truth.json", "o.truth.parquet"),
        ("tcdyn.simulate.plunge:simulate_plunge",),
    ),
    "simulate ehl": Command(
        "simulate ehl --out o.csv -q",
        ("o.csv", "o.truth.json", "o.truth.parquet"),
        ("tcdyn.simulate.ehl:simulate_ehl",),
    ),
    "simulate hole": Command(
        "simulate hole --out o.csv -q",
        ("o.csv", "o.truth.json", "o.truth.parquet"),
        ("tcdyn.simulate.plunge:simulate_hole",),
    ),
}
LONG = {
    "calibrate": Command(
        "rig calibrate --rig {rig} --disk fast --oven {oven} --immersion {plunge} --out o.json "
        "--report o.html --earlier {fast} -q",
        ("o.json", "o.html"),
        ("tcdyn.workflows:calibrate_disk", PICTURE),
    ),
    "hole": Command(
        "rig holes {hole} --rig {rig} --out o.json --report o.html -q",
        ("o.json", "o.html"),
        ("immersion.hole:compare_holes", PICTURE),
    ),
    "beta": Command(
        f"rig beta {{ehl}} --rig {{rig}} {RECORDS} --out o.json --report o.html",
        ("o.json", "o.html"),
        ("tcdyn.workflows.beta:estimate_stages", PICTURE),
    ),
    "beta of one disk": Command(
        "rig beta {one} --rig {rig} --record {fast} --out o.json --report o.html -q",
        ("o.json", "o.html"),
        ("tcdyn.workflows.beta:estimate_stages", PICTURE),
    ),
    "compensate --record": Command(
        "compensate {plunge} --record {fast} --out o.csv --report o.html --covariance o.json "
        "--covariance-from-s 30 -q",
        ("o.csv", "o.html", "o.json"),
        ("tcdyn.workflows:compensate_log", PICTURE),
    ),
    "campaign": Command(
        f"rig campaign {{ehl}} --rig {{rig}} {RECORDS} --out o --workers 1",
        ("o/campaign.csv", "o/campaign.html"),
        ("tcdyn.workflows.campaign_log:_analyse_stage", PICTURE),
    ),
    "simulate campaign": Command(
        "simulate campaign --out o -q --bath-degC 110",
        (),
        (
            "tcdyn.simulate.campaign:simulate_oven",
            "tcdyn.simulate.campaign:simulate_plunge",
            "tcdyn.simulate.campaign:simulate_ehl",
        ),
    ),
    "demo": Command(
        "demo --out o -q",
        (),
        (
            "tcdyn.simulate.campaign:simulate_oven",
            "tcdyn.simulate.campaign:simulate_plunge",
            "tcdyn.simulate.campaign:simulate_ehl",
            "tcdyn.workflows.demo:calibrate_disk",
            "tcdyn.workflows.demo:compensate_log",
            "tcdyn.workflows.demo:estimate_beta",
            PICTURE,
        ),
    ),
}


def small_files(folder: Path) -> dict[str, Path]:
    """Inputs that need no rig: a table of a sensor, plunges, weights and their like."""
    t, x, y = logged((0.5,), 0.05, 600, 0.1, 2)
    rng, late = np.random.default_rng(0), np.clip(t - 5.0, 0, None)
    f = np.geomspace(0.01, 2.0, 15)
    g = 1 / (1 + 2j * np.pi * f * 0.8)
    step = 20 + 60 * (1 - np.exp(-late / 0.5)) + 0.05 * rng.standard_normal(len(t))
    volts = np.linspace(0.0, 2.0, 9)
    files = {
        "table": write(
            folder / "table.csv", time_s=np.round(t, 3), u=x, T1_degC=y, T2_degC=np.roll(y, 3)
        ),
        "short": write(folder / "short.csv", time_s=np.round(t[:150], 3), T1_degC=y[:150]),
        "dip": write(folder / "dip.csv", time_s=np.round(t, 3), T1_degC=step),
        "lcsr": write(
            folder / "lcsr.csv", time_s=np.round(t, 3), T1_degC=step, I_mA=(t > 5.0) * 1.0
        ),
        "bode": write(
            folder / "bode.csv", frequency_Hz=f, gain=np.abs(g), phase=np.degrees(np.angle(g))
        ),
        "weights": write(
            folder / "weights.csv", volts=volts, force_N=100 * volts + rng.normal(0, 0.1, 9)
        ),
        "spot": write(
            folder / "spot.csv", temperature_degC=40 + 10 * volts, flux_W_m2=900 + 500 * volts
        ),
        "plan": write(
            folder / "plan.csv",
            load_N=np.array([850.0, 1200.0]),
            friction_N=np.array([30.0, 40.0]),
            speed_fast_rpm=np.array([1000.0, 1500.0]),
            speed_slow_rpm=np.array([400.0, 600.0]),
        ),
    }
    quiet = fluctuating(1, (0.5,), 0.05, 4000, 0.01)
    files["steady"] = write(folder / "steady.csv", time_s=quiet[0], T1_degC=quiet[1])
    files["fit"] = folder / "fit.toml"
    files["fit"].write_text(
        "[fit]\ninterference_um = 25\n[disk]\nbore_radius_mm = 15\n", encoding="utf-8"
    )
    files["sensor"] = write_sensor(
        specified_sensor("s", ["T1_degC"], [(0.5, 0.02)]), folder / "s.sensor.json"
    )
    return files


class Trial:
    """A command in a folder of its own, run as often as wished, each time from the same files."""

    def __init__(self, command: Command, files: dict[str, Path], folder: Path) -> None:
        self.folder = folder
        here = {
            n: Path(shutil.copy(p, folder / p.name))
            for n, p in files.items()
            if f"{{{n}}}" in command.words
        }
        for name in command.outputs:
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_text(OLD, encoding="utf-8")
        self.words = [
            str(here[w[1:-1]])
            if w[0] == "{"
            else str(folder / w)
            if w[0] == "o" and "." in w
            else w
            for w in command.words.split()
        ]
        self.words = [str(folder / "o") if w == "o" else w for w in self.words]
        if command.outputs:
            self.words.append("--overwrite")
        self.once, self.grows = command.once, command.grows
        self.kept = {name: p.read_bytes() for name, p in self._all()}
        self.before = content(folder)

    def _all(self) -> Iterator[tuple[str, Path]]:
        return ((str(p.relative_to(self.folder)), p) for p in self.folder.rglob("*") if p.is_file())

    def run(self, machine: Machine | None = None, homes: list[Home] = FILES) -> Ended:
        """The command from the files as they were at first, on a machine that may refuse."""
        self.reset()
        return self.go_on(machine, homes)

    def reset(self) -> None:
        """The files as they were at first."""
        for name, path in list(self._all()):
            if name not in self.kept:
                path.unlink()
        for name, data in self.kept.items():
            (self.folder / name).write_bytes(data)

    def go_on(self, machine: Machine | None = None, homes: list[Home] = FILES) -> Ended:
        """The command from the files as they are."""
        out, err = io.StringIO(), io.StringIO()
        on = refusing(machine, homes) if machine else contextlib.nullcontext()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), on:
            code = tcdyn(*self.words)
        return Ended(code, err.getvalue(), content(self.folder))

    def refused(self, at: int, problem: str, homes: list[Home] = FILES) -> tuple[Ended, list[str]]:
        """The command with call number ``at`` refused, and the calls that it made."""
        machine = Machine(self.folder, at, PROBLEMS[problem])
        return self.run(machine, homes), machine.calls


@contextlib.contextmanager
def computed_once(names: tuple[str, ...]) -> Iterator[None]:
    """The functions keep their first answer; one that is never called is an error of the table."""
    answers_of: dict[str, dict[str, Any]] = {name: {} for name in names}
    with pytest.MonkeyPatch.context() as patch:
        for name, answers in answers_of.items():
            module, _, attribute = name.partition(":")
            home = importlib.import_module(module)
            patch.setattr(home, attribute, _kept(getattr(home, attribute), answers))
        yield
    assert all(answers_of.values()), [name for name, found in answers_of.items() if not found]


def _kept(function: Callable[..., Any], answers: dict[str, Any]) -> Callable[..., Any]:

    def one(*args: Any, **settings: Any) -> Any:
        key = (
            str([a for a in args if isinstance(a, str | int | float)])
            if "simulate" in function.__name__
            else ""
        )
        if key not in answers:
            answers[key] = function(*args, **settings)
        return (
            copy.deepcopy(answers[key]) if isinstance(answers[key], tuple | dict) else answers[key]
        )

    return one


def whole_truth(
    trial: Trial, problems: list[str], homes: list[Home] = FILES, most: int = 10_000
) -> tuple[int, int, list[str]]:
    """Every call refused in turn, the ``problems`` one after another (``most`` calls, evenly
    chosen).

    How many, how many of them the command ended by (the others it got over), and what was wrong.
    """
    sound = trial.run()
    _, calls = trial.refused(0, "EIO", homes)
    wrong, ended, turns = (
        [],
        0,
        np.unique(np.linspace(1, len(calls), min(most, len(calls))).astype(int)).tolist(),
    )
    for n, at in enumerate(turns):
        problem = problems[n % len(problems)]
        done, made = trial.refused(at, problem, homes)
        ended += done.code == 2
        said = complaints(trial.before, sound, done, trial.grows)
        where = made[at - 1] if at <= len(made) else "not reached: it ended otherwise by itself"
        wrong += [f"{problem} at {at} of {len(calls)} ({where}): {one}" for one in said]
    return len(turns), ended, wrong


def files_of_campaign(files: Any, records: dict[str, Path], folder: Path) -> dict[str, Path]:
    """The world's names of a campaign's files, and a log of one disk in ``folder``."""
    one = folder / "EHL_one.csv"
    log = pd.read_csv(files.ehl["B3"])
    log.drop(columns=[n for n in log.columns if n.startswith("slow_")]).to_csv(one, index=False)
    return {
        "one": one,
        "rig": files.rig,
        "oven": files.ovens["fast"],
        "plunge": files.plunges["fast"][0],
        "ehl": files.ehl["B3"],
        **records,
    }
