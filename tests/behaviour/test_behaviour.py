"""Every command gives the stored results, within 0.05 of their standard uncertainties."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.behaviour.logs import FOLDER, simulated, steps_of, unpack
from tests.behaviour.runs import RUNS
from tests.behaviour.store import SHARE_OF_U, differences, inputs_in, load, results_of

STORED = load()
# Minutes; the same command is run by tests/cli/test_main_job.py
LONG = "compensate a rig log"


def marks_of(name: str) -> list[pytest.MarkDecorator]:
    """Marks of a run."""
    if name == LONG:
        return [pytest.mark.e2e, pytest.mark.long]
    return [] if RUNS[name].is_smoke else [pytest.mark.e2e]


NAMES = [pytest.param(name, marks=marks_of(name)) for name in RUNS]


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Every input file by its name."""
    return inputs_in(tmp_path_factory.mktemp("inputs"))


@pytest.mark.parametrize("name", NAMES)
def test_a_command_gives_the_stored_results(
    name: str, inputs: dict[str, Path], tmp_path: Path
) -> None:
    then = STORED[name]
    assert len(then) > 0
    changed = differences(results_of(name, inputs, tmp_path), then)
    path = max(changed, key=lambda p: changed[p])
    assert changed[path] < SHARE_OF_U, (
        f"{path} changed by {changed[path]:.3g} standard uncertainties"
    )


def test_a_change_is_measured_in_standard_uncertainties() -> None:
    then = {"beta": (0.7, 0.01), "lag": (1.5, 0.1), "exact": (2.0, 0.0)}
    assert max(differences(then, then).values()) == 0
    changed = differences({"beta": (0.7003, 0.01), "lag": (1.5, 0.103), "exact": (2.0, 0.0)}, then)
    assert changed == pytest.approx({"beta": 0.03, "lag": 0.03, "exact": 0.0})
    assert differences({}, then)["beta"] == float("inf")


@pytest.mark.e2e
def test_the_simulator_still_makes_the_committed_logs(tmp_path: Path) -> None:
    """To half a step of what the files hold, and one of the converter (0.0131 K) where processors
    round differently: 1.8 steps of 0.01 K together."""
    for name, path in simulated(tmp_path).items():
        if path.suffix == ".toml":
            assert path.read_text(encoding="utf-8") == (FOLDER / "rig.toml").read_text(
                encoding="utf-8"
            )
            continue
        new = pd.read_csv(path)
        stored = unpack(FOLDER / f"{name}.parquet")
        assert list(new) == list(stored)
        for column in new:
            assert np.abs(new[column] - stored[column]).max() * steps_of(column) < 2
