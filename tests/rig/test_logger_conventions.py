"""Logs as rigs have them: other units, a shaft's torque, no switch, what is stated, channels of the air."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tcdyn.core.errors import InputError
from tcdyn.io.write import write_log
from tcdyn.rig.columns import is_junction_column
from tcdyn.rig.log import Log, read_log
from tcdyn.rig.rigfile import load_rig, parse_rig, rig_toml
from tcdyn.rig.thermocouple_types import emf_mV
from tests.rig.log_cases import ehl_frame, immersion_frame, oven_frame

FRAMES = {"ehl": ehl_frame, "immersion": immersion_frame, "oven": oven_frame}
UNITS = {"K": lambda x: x + 273.15, "degF": lambda x: 1.8 * x + 32, "mV": lambda x: emf_mV(x, "K")}


def read(
    frame: pd.DataFrame, folder: Path, tables: dict[str, Any] | None = None, kind: Any = "ehl"
) -> Log:
    return read_log(write_log(frame, folder / "log.csv"), kind, parse_rig(tables or {}, "rig.toml"))


@pytest.mark.e2e
@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("kind", FRAMES)
@pytest.mark.parametrize("mapped", [False, True], ids=["by the column's name", "by [columns]"])
def test_temperatures_in_another_unit_are_read_as_in_degrees(
    tmp_path: Path, kind: str, unit: str, mapped: bool
) -> None:
    frame = FRAMES[kind]()
    new = {n: f"{n.removesuffix('degC')}{unit}" for n in frame if is_junction_column(n)}
    mine = {k: f"TC {i}" for i, k in enumerate(new.values())} if mapped else {}
    tables = {"logger": {"couple": "K"}, "columns": mine}
    moved = (
        frame.assign(**{n: UNITS[unit](frame[n]) for n in new})
        .rename(columns=new)
        .rename(columns=mine)
    )
    plain = read(frame, tmp_path, kind=kind)
    found = read(moved, tmp_path, tables, kind)
    assert found.frame.to_numpy() == pytest.approx(plain.frame.to_numpy(), abs=1e-8)
    assert [f.code for f in found.findings] == [f.code for f in plain.findings]


@pytest.mark.e2e
def test_friction_as_a_shaft_s_torque_is_the_torque_over_the_disk_s_radius(tmp_path: Path) -> None:
    frame = ehl_frame()
    torque = frame.assign(torque_slow_Nm=0.05 * frame["friction_N"]).drop(columns="friction_N")
    tables = {"slow": {"disk": {"outer_radius_mm": 50.0}}}
    found = read(torque, tmp_path, tables).frame
    assert found["friction_N"].to_numpy() == pytest.approx(frame["friction_N"].to_numpy(), rel=1e-9)
    mapped = {**tables, "columns": {"torque_slow_Nm": "M"}}
    again = read(torque.rename(columns={"torque_slow_Nm": "M"}), tmp_path, mapped).frame
    assert again["friction_N"].to_numpy() == pytest.approx(frame["friction_N"].to_numpy(), rel=1e-9)
    both = read(frame.assign(torque_slow_Nm=9.0), tmp_path)
    assert both.frame["friction_N"].equals(read(frame, tmp_path).frame["friction_N"])
    assert [f.numbers["names"] for f in both.findings if f.code == "columns.unused"] == [
        ("torque_slow_Nm",)
    ]


def test_a_log_without_a_switch_is_read_with_a_note_and_one_with_a_switch_of_another_name_is_asked_for(
    tmp_path: Path,
) -> None:
    found = read(ehl_frame().drop(columns="contact"), tmp_path)
    assert [f.code for f in found.findings] == ["contact.not_logged"]
    assert found.findings[0].severity == "info"
    with pytest.raises(InputError, match=r"contact: column is missing; .*did you mean 'Contact'"):
        read(ehl_frame().rename(columns={"contact": "Contact"}), tmp_path)


@pytest.mark.parametrize("name", ["load_N", "speed_fast_rpm", "speed_slow_rpm", "ambient_degC"])
def test_what_is_not_logged_is_asked_for_until_it_is_stated(tmp_path: Path, name: str) -> None:
    bare = ehl_frame().drop(columns=name)
    with pytest.raises(InputError, match=f"{name}: column is missing"):
        read(bare, tmp_path)
    found = read(bare, tmp_path, {"constants": {name: {"value": 60.0, "u": 1.0}}})
    assert name not in found.frame
    assert found.findings == ()


def test_channels_of_the_air_stand_in_for_the_ambient_and_one_that_is_not_there_is_named(
    tmp_path: Path,
) -> None:
    frame = ehl_frame()
    about = frame.assign(**{"Air 1": 61.0 + 0.1 * np.arange(len(frame)) / len(frame)}).drop(
        columns="ambient_degC"
    )
    tables = {"ambient": {"surface": ["Air 1"], "faces": ["Air 1"]}}
    found = read(about, tmp_path, tables)
    assert found.frame["ambient_Air 1_degC"].to_numpy() == pytest.approx(
        about["Air 1"].to_numpy(), abs=1e-6
    )
    assert "ambient_Air 1_degC" not in found.channels
    with pytest.raises(InputError, match=r"has no column 'Air 2', which rig.toml .ambient. names"):
        read(about, tmp_path, {"ambient": {"surface": ["Air 1", "Air 2"]}})
    with pytest.raises(
        InputError, match="ambient_degC: column is missing"
    ):  # of the slow disk nothing is known
        read(about, tmp_path, {"fast": {"ambient": {"surface": ["Air 1"]}}})


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        ({"constants": {"friction_N": {"value": 60.0, "u": 1.0}}}, "constants.friction_N"),
        ({"constants": {"load_N": {"value": 60.0}}}, "constants.load_N.u: Field required"),
        ({"constants": {"load_N": {"value": 60.0, "u": -1.0}}}, "constants.load_N.u"),
        (
            {"fast": {"constants": {"load_N": {"value": 60.0, "u": 1.0}}}},
            "fast.constants.: a test has one set",
        ),
        ({"ambient": {"front": ["T1"]}}, "ambient.front: there is no such key"),
        ({"logger": {"couple": "S"}}, "logger.couple"),
    ],
)
def test_what_is_stated_amiss_is_named(tables: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        parse_rig(tables, "rig.toml")


def test_what_is_stated_is_printed_so_that_it_reads_back(tmp_path: Path) -> None:
    tables = {
        "constants": {"load_N": {"value": 2320.0, "u": 20.0}},
        "slow": {"ambient": {"surface": ["Air 1", "Air 2"]}},
    }
    path = tmp_path / "rig.toml"
    path.write_text(rig_toml(parse_rig(tables, "rig.toml")))
    assert load_rig(path) == parse_rig(tables, "rig.toml")
