"""The rig file: the printed file reads back and explains how columns and single disks are
written."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tcdyn.core.errors import InputError
from tcdyn.rig.rigfile import load_rig, parse_rig, rig_toml


def test_printed_rig_file_reads_back_and_its_hints_are_valid(tmp_path: Path) -> None:
    text = rig_toml(load_rig())
    path = tmp_path / "rig.toml"
    path.write_text(text)
    assert load_rig(path) == load_rig()
    path.write_text(
        text.replace("# fast_a", "fast_a")
        .replace("# [slow", "[slow")
        .replace("# conduct", "conduct")
    )
    rig = load_rig(path)
    assert rig.common.columns == {"fast_a_degC": "TC1 fast"}
    assert (rig.fast.disk.conductivity_W_mK, rig.slow.disk.conductivity_W_mK) == (41.0, 43.0)
    assert "# fast_a" not in rig_toml(rig)  # no example if there are columns


def test_unknown_key_is_named(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text("[disk]\nconductivity = 43\n")
    with pytest.raises(InputError, match=r"disk\.conductivity: there is no such key"):
        load_rig(path)
    path.write_text('{"disk": "fast"}')
    with pytest.raises(InputError, match="expected a rig file"):
        load_rig(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "[disk]\ncrown_radius_mm = 30",
            r"disk: crown_radius_mm is 30; expected more than outer_radius_mm, 38\.1",
        ),
        (
            "[thermocouples]\nc = { z_mm = 10 }",
            r"thermocouples\.c: z_mm 10\.0 lies outside the width",
        ),
        ("[thermocouples]\nlayout = 'own'", "thermocouples: none is listed"),
        (
            "[thermocouples]\nrim = { depth_mm = 1, z_mm = 2 }",
            "'rim' is no name of a junction; expected a letter, or",
        ),
        (
            "[thermocouples]\ng = { depth_mm = 1, z_mm = 2 }\na = {}",
            r"thermocouples\.a\.depth_mm: Field required",
        ),
        (
            "[uncertainty]\nspeed_exponent_low = 0.9",
            r"uncertainty: speed_exponent_low 0\.9 lies above speed_.* 0\.8",
        ),
        (
            '[columns]\nfast_a_degC = "TC1"\nfast_b_degC = "TC1"',
            "columns: 'TC1' is named for two junctions, fast_a_degC and fast_b_degC",
        ),
        (
            '[columns]\nfast_a_degC = "slow_a_degC"',
            "columns: 'slow_a_degC' is named for two junctions, fast_a_degC and slow_a_degC",
        ),
        (
            '[slow.columns]\na_degC = "T1"\nf_degC = "T1"',
            "slow: columns: 'T1' is named for two junctions, a_degC and f",
        ),
        (
            "[thermocouples]\nlayout = 'mine'",
            r"thermocouples\.layout is 'mine'; expected one of table 6\.2, clarke, vol",
        ),
        ("[disk]\nwidth_mm = -1", r"disk\.width_mm: Input should be greater than 1 \(got -1\)"),
    ],
)
def test_invalid_rig_files_raise_when_read(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=message) as problem:
        load_rig(path)
    assert "Value error" not in str(problem.value)


def test_columns_may_be_exchanged_or_shared_by_logs_of_different_disks(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(
        '[columns]\nfast_a_degC = "fast_b_degC"\nfast_b_degC = "fast_a_degC"\n'
        '[fast.columns]\na_degC = "T1"\n[slow.columns]\na_degC = "T1"\n'
    )
    assert load_rig(path).columns("slow")["a_degC"] == "T1"


def test_layout_is_chosen_by_name_and_an_explicit_angle_takes_precedence(tmp_path: Path) -> None:
    """Design, section 12: table 6.2 has a, e, f opposite b, c, d; Clarke and Voller a, c, d
    opposite b, e, f."""

    def junctions_by_side(text: str, disk: str = "fast") -> dict[bool, str]:
        path = tmp_path / "rig.toml"
        path.write_text(text)
        j = load_rig(path).disk_setup(disk).junctions
        near = {c: abs((j[c].angle_deg + 90) % 360 - 90) < 60 for c in j}
        return {
            is_near: "".join(c for c in sorted(j) if near[c] == is_near)
            for is_near in (True, False)
        }

    assert junctions_by_side("") == {True: "aef", False: "bcd"}
    assert junctions_by_side("[thermocouples]\nlayout = 'voller'") == {True: "acd", False: "bef"}
    assert junctions_by_side("[thermocouples]\nlayout = 'voller'\nd = { angle_deg = 165 }") == {
        True: "ac",
        False: "bdef",
    }
    assert junctions_by_side("[slow.thermocouples]\nlayout = 'clarke'") == {
        True: "aef",
        False: "bcd",
    }
    assert junctions_by_side("[slow.thermocouples]\nlayout = 'clarke'", "slow") == {
        True: "acd",
        False: "bef",
    }
    e = load_rig(tmp_path / "rig.toml").disk_setup("slow").junctions["e"]
    # junction e of Clarke is not under the track
    assert (e.depth_m, e.z_m) == pytest.approx((3.0e-3, 7.53e-3))
    # every angle is printed instead
    assert "layout" not in rig_toml(load_rig(tmp_path / "rig.toml"))


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        (
            {"contact": {"flux_table_mm": [-1.0, 1.0], "flux_table_weight": [1.0, 1.0]}},
            "flux_profile",
        ),
        ({"fast": {"surface": {"air_degC": 40.0}}}, "heat_transfer_W_m2K"),
    ],
)
def test_dependent_value_without_its_prerequisite_raises(
    tables: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        parse_rig(tables, "rig.toml")
