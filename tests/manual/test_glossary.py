"""docs/files.md documents every column and every key of the files with its unit, and no other."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter
from typer.testing import CliRunner

from tcdyn.cli.app import app
from tcdyn.rig.columns import KNOWN_COLUMNS
from tcdyn.rig.disk import CHANNELS, DISKS
from tcdyn.rig.rigfile import load_rig, rig_toml
from tests.conftest import Campaign

PAGE = (Path(__file__).parents[2] / "docs" / "files.md").read_text(encoding="utf-8")
SECTIONS = {text.partition("\n")[0].strip("` "): text for text in PAGE.split("\n## ")[1:]}
ENDINGS = re.findall(r"^\| `(_\w+)` \|", SECTIONS["Units by ending"], re.M)
ESTIMATE = {"value", "u", "low95", "high95"}  # documented once, above the tables


def documented_names(section: str) -> set[str]:
    """Names in backticks in the table of a section."""
    rows = [line for line in SECTIONS[section].splitlines() if line.startswith("|")]
    return {name for row in rows for name in re.findall(r"`([^` ]+)`", row)}


def keys(data: Any, parent: str = "") -> Iterator[tuple[str, Any]]:
    """(key, value) of everything in a JSON document. Channels and disks are values of their
    parents, not keys."""
    if isinstance(data, dict):
        for key, value in data.items():
            if key not in (*CHANNELS, *DISKS):
                yield key, value
            if key not in ("setup", "numbers"):  # the tables of rig.toml, and numbers of a finding
                yield from keys(value, key)
    elif isinstance(data, list):
        for value in data:
            yield from keys(value, parent)


def has_unit(section: str, key: str) -> bool:
    """Whether the key ends with a unit, or a unit in brackets follows it, possibly after other
    keys of its list."""
    if any(key.endswith(ending) for ending in ENDINGS):
        return True
    return bool(re.search(rf"`{re.escape(key)}`( (and )?`[^`]+`)*[^`\[\n]*\[", SECTIONS[section]))


def test_every_column_of_a_log_is_documented_and_no_other() -> None:
    assert documented_names("Columns of logs") == set(KNOWN_COLUMNS)
    for name in KNOWN_COLUMNS:
        assert has_unit("Columns of logs", name), name


def is_number(value: Any) -> bool:
    """Whether the value is a number or an estimate."""
    return (
        isinstance(value, int | float | dict)
        and not isinstance(value, bool)
        and (not isinstance(value, dict) or set(value) == ESTIMATE)
    )


@pytest.mark.e2e
@pytest.mark.parametrize("section", ["beta.json", "*.disk.json"])
def test_every_key_is_documented_with_its_unit_and_no_other(
    section: str, campaign: Campaign, request: pytest.FixtureRequest
) -> None:
    if section == "beta.json":
        run = replace(request.getfixturevalue("beta_run"), with_profiles=True)
        data = json.loads(json.dumps(run.to_dict()))
    else:
        data = json.loads(campaign.record_paths["fast"].read_text(encoding="utf-8"))
    keys_in_file = dict(keys(data))
    # `what` names the suspected component
    extra = {"what"} if section == "beta.json" else {"chain", "rig.toml"}
    assert set(keys_in_file) - documented_names(section) - ESTIMATE == set()
    assert documented_names(section) - set(keys_in_file) - extra - set(DISKS) - ESTIMATE == set(), (
        "keys that no file has"
    )
    for key, value in keys(data):
        if is_number(value) and key not in ESTIMATE:
            assert has_unit(section, key), key


def test_every_key_of_a_sensor_file_is_documented_with_its_unit() -> None:
    from tcdyn.sensors import specified_sensor

    data = specified_sensor("s", ["a", "b"], [(1.5, 0.1)]).to_dict()
    keys_in_file = dict(keys(data))
    assert set(keys_in_file) - documented_names("*.sensor.json") - ESTIMATE == set()
    for key, value in keys({k: v for k, v in data.items() if k != "fit"}):
        if is_number(value) and key not in ESTIMATE:
            assert has_unit("*.sensor.json", key), key


@pytest.mark.e2e
def test_every_key_of_an_identified_model_is_documented_with_its_unit(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    table = tmp_path / "data.csv"
    u = np.repeat(np.arange(20) % 2, 10).astype(float)
    decay = np.exp(-0.125)
    y = lfilter([0.0, 1 - decay], [1.0, -decay], u) + 0.02 * rng.normal(size=len(u))
    columns = {"time_s": 0.1 * np.arange(len(u)), "u": u, "y": y}
    pd.DataFrame(columns).round(4).to_csv(table, index=False)
    command = ["identify", str(table), "--input", "u", "--output", "y", "--model", "P1"]
    assert CliRunner().invoke(app, command).exit_code == 0
    data = json.loads(table.with_suffix(".identified.json").read_text(encoding="utf-8"))
    assert data.pop("reading")[0]["rows"] == len(u)  # its keys are those of inspect
    assert set(data["averaged"]["u"]) == {"gain", "lag_s", "dead_time_s"}
    assert data["averaged"]["u"]["lag_s"]["value"] == pytest.approx(0.8, abs=0.05)
    columns_and_parameters = {"u", "Kp", "Tp1"}
    keys_in_file = dict(keys(data))
    documented = documented_names("*.identified.json")
    assert set(keys_in_file) - documented - ESTIMATE - columns_and_parameters == set()
    for key, value in keys(data):
        if is_number(value) and key not in ESTIMATE | columns_and_parameters:
            assert has_unit("*.identified.json", key), key


def test_every_number_of_the_rig_file_ends_with_its_unit() -> None:
    # dimensionless
    dimensionless = {
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
    }
    # value and u, of a constant, have the unit of its name
    for key in re.findall(r"(\w+) = -?\d", rig_toml(load_rig())):
        assert key in dimensionless or any(key.endswith(ending) for ending in ENDINGS), key
