"""Logs as existing rigs write them: other units, torque of a shaft, no switch, specified
constants, air channels."""

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
from tcdyn.series.thermocouple_types import emf_mV
from tests.rig.log_cases import ehl_frame, immersion_frame, oven_frame

FRAMES = {"ehl": ehl_frame, "immersion": immersion_frame, "oven": oven_frame}
UNITS = {"K": lambda x: x + 273.15, "degF": lambda x: 1.8 * x + 32, "mV": lambda x: emf_mV(x, "K")}


def read(
    frame: pd.DataFrame, folder: Path, tables: dict[str, Any] | None = None, kind: Any = "ehl"
) -> Log:
    """Write the frame, and read it with the rig file of ``tables``."""
    return read_log(write_log(frame, folder / "log.csv"), kind, parse_rig(tables or {}, "rig.toml"))


@pytest.mark.e2e
@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("kind", FRAMES)
@pytest.mark.parametrize("mapped", [False, True], ids=["by column name", "by [columns]"])
def test_temperatures_in_other_units_are_read_like_degrees(
    tmp_path: Path, kind: str, unit: str, mapped: bool
) -> None:
    frame = FRAMES[kind]()
    unit_columns = {n: f"{n.removesuffix('degC')}{unit}" for n in frame if is_junction_column(n)}
    user_columns = {k: f"TC {i}" for i, k in enumerate(unit_columns.values())} if mapped else {}
    tables = {"logger": {"couple": "K"}, "columns": user_columns}
    converted = (
        frame.assign(**{n: UNITS[unit](frame[n]) for n in unit_columns})
        .rename(columns=unit_columns)
        .rename(columns=user_columns)
    )
    in_degrees = read(frame, tmp_path, kind=kind)
    log = read(converted, tmp_path, tables, kind)
    assert log.frame.to_numpy() == pytest.approx(in_degrees.frame.to_numpy(), abs=1e-8)
    assert [f.code for f in log.findings] == [f.code for f in in_degrees.findings]


@pytest.mark.e2e
def test_torque_of_a_shaft_gives_friction_by_the_disk_radius(tmp_path: Path) -> None:
    frame = ehl_frame()
    torque = frame.assign(torque_slow_Nm=0.05 * frame["friction_N"]).drop(columns="friction_N")
    tables = {"slow": {"disk": {"outer_radius_mm": 50.0}}}
    log = read(torque, tmp_path, tables).frame
    assert log["friction_N"].to_numpy() == pytest.approx(frame["friction_N"].to_numpy(), rel=1e-9)
    mapped = {**tables, "columns": {"torque_slow_Nm": "M"}}
    with_mapping = read(torque.rename(columns={"torque_slow_Nm": "M"}), tmp_path, mapped).frame
    assert with_mapping["friction_N"].to_numpy() == pytest.approx(
        frame["friction_N"].to_numpy(), rel=1e-9
    )
    with_friction_and_torque = read(frame.assign(torque_slow_Nm=9.0), tmp_path)
    assert with_friction_and_torque.frame["friction_N"].equals(
        read(frame, tmp_path).frame["friction_N"]
    )
    assert [
        f.numbers["names"] for f in with_friction_and_torque.findings if f.code == "columns.unused"
    ] == [("torque_slow_Nm",)]


def test_missing_switch_gives_an_info_and_a_misspelled_one_raises(
    tmp_path: Path,
) -> None:
    log = read(ehl_frame().drop(columns="contact"), tmp_path)
    assert [f.code for f in log.findings] == ["contact.not_logged"]
    assert log.findings[0].severity == "info"
    with pytest.raises(InputError, match=r"contact: column is missing; .*did you mean 'Contact'"):
        read(ehl_frame().rename(columns={"contact": "Contact"}), tmp_path)


@pytest.mark.parametrize("name", ["load_N", "speed_fast_rpm", "speed_slow_rpm", "ambient_degC"])
def test_missing_channel_raises_unless_specified_as_a_constant(tmp_path: Path, name: str) -> None:
    without_channel = ehl_frame().drop(columns=name)
    with pytest.raises(InputError, match=f"{name}: column is missing"):
        read(without_channel, tmp_path)
    log = read(without_channel, tmp_path, {"constants": {name: {"value": 60.0, "u": 1.0}}})
    assert name not in log.frame
    assert log.findings == ()


def test_air_channels_replace_the_ambient_and_a_missing_one_is_named(
    tmp_path: Path,
) -> None:
    frame = ehl_frame()
    with_air_channel = frame.assign(
        **{"Air 1": 61.0 + 0.1 * np.arange(len(frame)) / len(frame)}
    ).drop(columns="ambient_degC")
    tables = {"ambient": {"surface": ["Air 1"], "faces": ["Air 1"]}}
    log = read(with_air_channel, tmp_path, tables)
    assert log.frame["ambient_Air 1_degC"].to_numpy() == pytest.approx(
        with_air_channel["Air 1"].to_numpy(), abs=1e-6
    )
    assert "ambient_Air 1_degC" not in log.channels
    with pytest.raises(InputError, match=r"column of rig.toml .ambient. 'Air 2' is missing"):
        read(with_air_channel, tmp_path, {"ambient": {"surface": ["Air 1", "Air 2"]}})
    # the ambient of the slow disk remains unknown
    with pytest.raises(InputError, match="ambient_degC: column is missing"):
        read(with_air_channel, tmp_path, {"fast": {"ambient": {"surface": ["Air 1"]}}})


@pytest.mark.parametrize(
    ("tables", "message"),
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
def test_invalid_specified_values_are_named(tables: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        parse_rig(tables, "rig.toml")


def test_specified_values_are_printed_so_that_they_read_back(tmp_path: Path) -> None:
    tables = {
        "constants": {"load_N": {"value": 2320.0, "u": 20.0}},
        "slow": {"ambient": {"surface": ["Air 1", "Air 2"]}},
    }
    path = tmp_path / "rig.toml"
    path.write_text(rig_toml(parse_rig(tables, "rig.toml")))
    assert load_rig(path) == parse_rig(tables, "rig.toml")
