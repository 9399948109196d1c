"""Calls of a command that fail one after another: one sentence and exit 2, every file old or whole,
nothing beside."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from pathlib import Path
from typing import Any

import pytest

from tests.cli.fault_commands import (
    LONG,
    QUICK,
    Trial,
    computed_once,
    files_of_campaign,
    small_files,
    whole_truth,
)
from tests.cli.fault_world import ARRAYS, FILES, PROBLEMS, Home
from tests.cli.kill_study import KILLED, kills
from tests.cli.test_main_job import tcdyn
from tests.conftest import Campaign

WITHOUT_RIG = (
    "compensate --sensor",
    "follow --sensor",
    "sensor new",
    "sensor show",
    "response",
    "transducer",
    "spot",
    "sensor noise",
    "simulate oven",
    "rig design --campaign",
    "round fit",
)
RECORD = ("rig", "record show", "record diff", "record check")
# Of the long commands, those that run without ``--full``.
SHORTEST = ("calibrate",)
REST = tuple(name for name in QUICK if name not in (*WITHOUT_RIG, *RECORD))


def with_long_marks(names: Iterable[str], without: Collection[str] = SHORTEST) -> list[Any]:
    """The names as parameters; all but those ``without`` a mark are long tests."""
    return [pytest.param(name, marks=[] if name in without else pytest.mark.long) for name in names]


@pytest.fixture(scope="module")
def world(campaign: Campaign, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Every input by its name."""
    folder = tmp_path_factory.mktemp("world")
    assert tcdyn("simulate", "hole", "--out", folder / "hole.csv", "--quiet") == 0
    found = {**small_files(folder), "hole": folder / "hole.csv"}
    return found | files_of_campaign(campaign.files, campaign.record_paths, folder)


def refused(
    name: str, world: dict[str, Path], folder: Path, most: int, homes: list[Home] = FILES
) -> None:
    command = {**QUICK, **LONG}[name]
    once = command.once if homes is FILES else ()
    with computed_once(once):
        kinds = list(PROBLEMS) if homes is FILES else ["memory"]
        tried, ended, wrong = whole_truth(Trial(command, world, folder), kinds, homes, most)
    assert wrong == []
    assert tried >= ended >= max(tried // 3, 1)  # the others it got over


@pytest.mark.e2e
@pytest.mark.parametrize(
    "name", with_long_marks([*WITHOUT_RIG, *RECORD], [*WITHOUT_RIG[::2], RECORD[0]])
)
def test_a_quick_command_whose_calls_fail(
    name: str, world: dict[str, Path], tmp_path: Path
) -> None:
    refused(name, world, tmp_path, 12)


@pytest.mark.e2e
@pytest.mark.parametrize("name", with_long_marks(REST, REST[::2]))
def test_a_command_whose_calls_fail(
    name: str, world: dict[str, Path], tmp_path: Path, draws: Callable[[int], int]
) -> None:
    refused(name, world, tmp_path, draws(24))


@pytest.mark.e2e
@pytest.mark.parametrize("name", with_long_marks(LONG))
def test_a_long_command_whose_calls_fail(
    name: str, world: dict[str, Path], tmp_path: Path, draws: Callable[[int], int]
) -> None:
    refused(name, world, tmp_path, draws(20))


@pytest.mark.e2e
@pytest.mark.parametrize("name", ["compensate --sensor", "follow --sensor", "transducer"])
def test_memory_that_runs_out(name: str, world: dict[str, Path], tmp_path: Path) -> None:
    refused(name, world, tmp_path, 10, ARRAYS)


@pytest.mark.e2e
@pytest.mark.parametrize(
    "name",
    [
        "identify",
        "hole",
        pytest.param("compensate --record", marks=pytest.mark.long),
        pytest.param("calibrate", marks=pytest.mark.long),
    ],
)
def test_memory_that_runs_out_in_a_long_command(
    name: str, world: dict[str, Path], tmp_path: Path, draws: Callable[[int], int]
) -> None:
    refused(name, world, tmp_path, draws(12), ARRAYS)


@pytest.mark.e2e
def test_a_kill_leaves_old_or_whole_files_and_the_next_run_goes_on(
    world: dict[str, Path], tmp_path: Path
) -> None:
    done, _, wrong = kills(Trial(QUICK["sensor noise"], world, tmp_path), 12)
    assert wrong == []
    assert done >= 6


@pytest.mark.e2e
@pytest.mark.parametrize("name", with_long_marks(KILLED))
def test_a_long_command_is_killed(
    name: str, world: dict[str, Path], tmp_path: Path, draws: Callable[[int], int]
) -> None:
    count = draws(16)
    done, _, wrong = kills(Trial(LONG[name], world, tmp_path), count, 1)
    assert wrong == []
    assert done >= count // 2
