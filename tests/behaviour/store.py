"""Store the results of the behaviour suite: ``python -m tests.behaviour.store [RUN ...]``.

Prints for each run the largest difference from the stored results, in standard uncertainties.
``records`` makes the records of the two disks that other runs read.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

from tests.behaviour.logs import FOLDER, write_logs
from tests.behaviour.runs import RUNS, Estimates, estimates_of, words_of
from tests.behaviour.tables import write_tables
from tests.cli.test_main_job import tcdyn

STORED = Path(__file__).with_name("stored.json")
DIGITS = 9
SHARE_OF_U = (
    0.05  # of its standard uncertainty, by which a value may differ, and the uncertainty itself
)
# An uncertainty below 1e-6 of its value is rounding: both are held to 1e-6 of the value instead.
LEAST_RELATIVE_U = 1e-6 / SHARE_OF_U


def load() -> dict[str, Estimates]:
    """The stored estimates by run."""
    stored = json.loads(STORED.read_text(encoding="utf-8"))
    return {
        run: {path: (value, u) for path, (value, u) in found.items()}
        for run, found in stored.items()
    }


def inputs_in(folder: Path) -> dict[str, Path]:
    """All input files of the suite, written into ``folder``; paths by name."""
    paths = {**write_logs(folder), **write_tables(folder)}
    paths["sensor"] = folder / "sensor.sensor.json"
    code = tcdyn(
        "sensor", "new", "--tau-s", "25+-1", "--column", "TC1", "--out", paths["sensor"], "--quiet"
    )
    assert code in (0, 1)
    return paths


def results_of(name: str, inputs: Mapping[str, Path], folder: Path) -> Estimates:
    """Run the command ``name`` and read its estimates."""
    run = RUNS[name]
    code = tcdyn(*words_of(run, inputs, folder), "--quiet")
    assert code in (0, 1), f"{name} ended with {code}"
    return estimates_of(run, folder)


def differences(now: Estimates, then: Estimates) -> dict[str, float]:
    """Largest change of value and uncertainty of each stored estimate, in its standard
    uncertainty."""
    found = {}
    for path, (value, u) in then.items():
        scale = max(u, LEAST_RELATIVE_U * abs(value), 1e-12)
        if path not in now:
            found[path] = float("inf")
            continue
        found[path] = max(abs(now[path][0] - value), abs(now[path][1] - u)) / scale
    return found


def main() -> None:
    """Run everything and store what came out."""
    then = load() if STORED.exists() else {}
    now: dict[str, Estimates] = {}
    words = [word for word in sys.argv[1:] if word in RUNS]
    with tempfile.TemporaryDirectory() as folder:
        inputs = inputs_in(Path(folder))
        names = words or list(RUNS)
        if "records" in sys.argv:
            names = ["calibrate fast", "calibrate slow"]
        for name in names:
            place = Path(folder) / name.replace(" ", "-")
            place.mkdir()
            now[name] = results_of(name, inputs, place)
            worst = sorted(
                differences(now[name], then.get(name, {})).items(), key=lambda item: -item[1]
            )[:3]
            print(
                f"{name}: {len(now[name])} estimates",
                *(f"{path} {share:.3g} u" for path, share in worst),
                sep="; ",
            )
            if "records" in sys.argv:
                record = (place / RUNS[name].output).read_bytes()
                (FOLDER / f"{name.rpartition(' ')[2]}.disk.json").write_bytes(record)
    if "records" not in sys.argv:
        rounded = {
            name: {path: [float(f"{x:.{DIGITS}g}") for x in pair] for path, pair in found.items()}
            for name, found in {**then, **now}.items()
        }
        STORED.write_text(json.dumps(rounded, indent=0) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
