"""docs/files.md names every column and every key of the files, each with its unit, and nothing that is not there."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tcdyn.rig.columns import KNOWN_COLUMNS
from tcdyn.rig.disk import CHANNELS, DISKS
from tcdyn.rig.rigfile import load_rig, rig_toml
from tests.conftest import Campaign

PAGE = (Path(__file__).parents[2] / "docs" / "files.md").read_text(encoding="utf-8")
SECTIONS = {part.partition("\n")[0].strip("` "): part for part in PAGE.split("\n## ")[1:]}
ENDINGS = re.findall(r"^\| `(_\w+)` \|", SECTIONS["Units by ending"], re.M)
ESTIMATE = {"value", "u", "low95", "high95"}  # told once, above the tables


def told(section: str) -> set[str]:
    """Names in backticks in one section's table."""
    rows = [line for line in SECTIONS[section].splitlines() if line.startswith("|")]
    return {name for row in rows for name in re.findall(r"`([^` ]+)`", row)}


def keys(data: Any, parent: str = "") -> Iterator[tuple[str, Any]]:
    """(key, value) of everything in a JSON document; channels and disks are values of their parents, no keys."""
    if isinstance(data, dict):
        for key, value in data.items():
            if key not in (*CHANNELS, *DISKS):
                yield key, value
            if key not in ("setup", "numbers"):  # the tables of rig.toml; what a finding counts
                yield from keys(value, key)
    elif isinstance(data, list):
        for value in data:
            yield from keys(value, parent)


def with_unit(section: str, key: str) -> bool:
    """Whether the key's ending is a unit, or a unit in brackets follows it, other keys of its list between."""
    if any(key.endswith(ending) for ending in ENDINGS):
        return True
    return bool(re.search(rf"`{re.escape(key)}`( (and )?`[^`]+`)*[^`\[\n]*\[", SECTIONS[section]))


def test_every_column_of_a_log_is_told_and_no_other() -> None:
    assert told("Columns of logs") == set(KNOWN_COLUMNS)
    for name in KNOWN_COLUMNS:
        assert with_unit("Columns of logs", name), name


def number(value: Any) -> bool:
    """A number, or an estimate of one."""
    return (
        isinstance(value, int | float | dict)
        and not isinstance(value, bool)
        and (not isinstance(value, dict) or set(value) == ESTIMATE)
    )


@pytest.mark.e2e
@pytest.mark.parametrize("section", ["beta.json", "*.disk.json"])
def test_every_key_is_told_with_its_unit_and_no_other(
    section: str, campaign: Campaign, request: pytest.FixtureRequest
) -> None:
    if section == "beta.json":
        data = json.loads(json.dumps(request.getfixturevalue("beta_run").to_dict()))
    else:
        data = json.loads(campaign.record_paths["fast"].read_text(encoding="utf-8"))
    found = dict(keys(data))
    extra = (
        {"what"} if section == "beta.json" else {"chain", "rig.toml"}
    )  # `what`: where something is suspected
    assert set(found) - told(section) - ESTIMATE == set()
    assert told(section) - set(found) - extra - set(DISKS) - ESTIMATE == set(), (
        "keys that no file has"
    )
    for key, value in keys(data):
        if number(value) and key not in ESTIMATE:
            assert with_unit(section, key), key


def test_every_key_of_a_sensor_file_is_told_with_its_unit() -> None:
    from tcdyn.sensors import specified_sensor

    data = specified_sensor("s", ["a", "b"], [(1.5, 0.1)]).to_dict()
    found = dict(keys(data))
    assert set(found) - told("*.sensor.json") - ESTIMATE == set()
    for key, value in keys({k: v for k, v in data.items() if k != "fit"}):
        if number(value) and key not in ESTIMATE:
            assert with_unit("*.sensor.json", key), key


def test_every_number_of_the_rig_file_says_its_unit_by_its_ending() -> None:
    plain = {
        "value",
        "u",
        "gear_ratio",
        "poles",
        "slope",
        "bath_h_exponent",
        "bath_h_viscosity",
        "speed_exponent",
        "speed_exponent_low",
        "speed_exponent_high",
    }  # pure
    # value and u, of a constant, have the unit of its name
    for key in re.findall(r"(\w+) = -?\d", rig_toml(load_rig())):
        assert key in plain or any(key.endswith(ending) for ending in ENDINGS), key
