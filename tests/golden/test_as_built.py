"""Every number that a command writes or draws is that of the version at hand, or somebody meant it to move."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tcdyn.partition.analyse import Partition
from tests.conftest import Campaign
from tests.golden.as_built import (
    BUILT,
    COMMANDS,
    LOOSE,
    LOOSELY,
    Numbers,
    moved,
    of_command,
    of_functions,
    rounded,
    world_of,
)

KEPT: dict[str, Numbers] = json.loads(BUILT.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def world(campaign: Campaign, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Every input by its name."""
    return world_of(campaign, tmp_path_factory.mktemp("world"))


def same(group: str, now: Numbers) -> None:
    """Raises AssertionError with what moved most."""
    for kept, most in ((group, 1.0), (group + LOOSELY, LOOSE)):
        far, name = max(moved(now, KEPT.get(kept, {})), default=(0.0, ""))
        assert far < most, f"{name}: {KEPT[kept][name]} became {now.get(name)}"


@pytest.mark.parametrize("name", [name for name in COMMANDS if name in KEPT])  # the others print
def test_a_command_writes_the_numbers_of_this_version(name: str, world: dict[str, Path], tmp_path: Path) -> None:
    assert len(KEPT[name]) > 8
    same(name, of_command(name, world, tmp_path))


def test_tables_of_a_test_have_the_numbers_of_this_version(partition: Partition) -> None:
    for group, made in of_functions(partition).items():
        assert len(KEPT[group]) > 8
        same(group, rounded(made()))


def test_what_moves_is_told() -> None:
    was = {"beta/value": 0.7, "beta/u": 0.01, "x/size": 100.0, "x/sum": 1.0, "steps": 5.0}
    assert all(far == 0 for far, _ in moved(was, was))
    assert {name: far > 1 for far, name in moved({**was, "beta/value": 0.7003, "x/sum": 1.2}, was)} == {
        "beta/value": True, "beta/u": False, "x/size": False, "x/sum": True, "steps": False,
    }  # fmt: skip
    assert max(moved({}, was))[0] == float("inf")
