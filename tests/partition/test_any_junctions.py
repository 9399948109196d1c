"""Disks with other junctions than a to f, simulated by the whole-disk solver: what the fits make of four and eight."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.linalg import lstsq
from typer.testing import CliRunner

from tcdyn.cli.app import app
from tcdyn.core.errors import InputError
from tcdyn.heat.modal import spectrum
from tcdyn.heat.rim import MESH_IV, Rim
from tcdyn.partition.joint import joint_fits
from tcdyn.partition.sensor_check import check_sensors
from tcdyn.partition.steady import steady_lines
from tcdyn.partition.window import fit_rows
from tcdyn.rig.log import read_log
from tcdyn.rig.record import read_record, write_record
from tcdyn.rig.rigfile import Rig, load_rig, parse_rig, rig_toml
from tcdyn.workflows.beta import estimate_beta
from tests.partition.study_rigs import StudyRig, study_rig

FOUR = {
    "layout": "own",
    "a": {"depth_mm": 3.0, "z_mm": 4.765},
    "c": {"depth_mm": 3.0, "z_mm": 2.0, "angle_deg": 15.0},
    "d": {"depth_mm": 6.0, "z_mm": 2.0, "angle_deg": 165.0},
    "b": {"depth_mm": 6.0, "z_mm": 4.765, "angle_deg": 180.0},
}
PLACES = {  # depth, z, angle: two groups that lie opposite; four junctions 6 mm deep, none of them at the centre
    "t1": (1.25, 4.765, 0.0),
    "t2": (3.0, 4.765, 15.0),
    "t3": (3.0, 2.0, 180.0),
    "t4": (2.0, 6.5, 195.0),
    "t5": (6.0, 1.5, 345.0),
    "t6": (6.0, 3.8, 165.0),
    "t7": (6.0, 5.8, 210.0),
    "t8": (6.0, 8.0, 330.0),
}
EIGHT = {
    name: dict(zip(("depth_mm", "z_mm", "angle_deg"), place)) for name, place in PLACES.items()
}
SEED = 11


def rig_with(junctions: dict[str, Any], **tables: Any) -> Rig:
    return parse_rig({"thermocouples": junctions, **tables}, "rig.toml")


@pytest.fixture(scope="module")
def eight() -> StudyRig:
    return study_rig(SEED, rig=rig_with(EIGHT))


def test_a_table_of_other_names_is_all_there_are_and_is_read_back(tmp_path: Path) -> None:
    for junctions in (FOUR, EIGHT):
        rig = rig_with(
            junctions,
            slow={"thermocouples": {"layout": "own", "x1": {"depth_mm": 2.0, "z_mm": 5.0}}},
        )
        assert rig.disk_setup("fast").channels == tuple(sorted(set(junctions) - {"layout"}))
        assert rig.disk_setup("slow").channels == ("x1",)
        (tmp_path / "rig.toml").write_text(rig_toml(rig))
        assert load_rig(tmp_path / "rig.toml") == rig


def test_the_inner_row_is_told_by_depth_not_by_name() -> None:
    setup = rig_with(EIGHT).disk_setup("fast")
    assert (setup.inner, setup.outer, setup.edge, setup.shallowest) == (
        ("t5", "t6", "t7", "t8"),
        ("t1", "t2", "t3", "t4"),
        "t6",
        "t1",
    )
    four = rig_with(FOUR).disk_setup("fast")
    assert (four.inner, four.outer) == (("d", "b"), ("a", "c"))
    exchanged = {**EIGHT, "t1": EIGHT["t5"], "t5": EIGHT["t1"]}
    assert rig_with(exchanged).disk_setup("fast").inner == ("t1", "t6", "t7", "t8")


@pytest.mark.parametrize(
    "junctions",
    [
        {"t1": EIGHT["t1"], "t5": EIGHT["t5"]},  # one place of the greatest depth
        {c: EIGHT[c] for c in ("t5", "t6", "t7", "t8")},  # nothing nearer the surface
        {
            "t1": EIGHT["t1"],
            "t5": EIGHT["t5"],
            "t6": {**EIGHT["t5"], "angle_deg": 90.0},
        },  # the same place twice
    ],
)
def test_what_does_not_tell_beta_is_said_with_what_to_add(junctions: dict[str, Any]) -> None:
    with pytest.raises(
        InputError, match="expected two junctions or more of the greatest depth, at different z_mm"
    ):
        rig_with(junctions).disk_setup("fast").check_junction_rows()


def test_the_profile_of_an_inner_row_is_the_least_squares_one_of_as_many_shapes_as_it_tells() -> (
    None
):
    """Against scipy's own least squares on cosines, which are the slab's shapes where the faces are insulated."""
    for places in ((1.5e-3, 3.8e-3, 5.8e-3, 8.0e-3), (2.0e-3, 4.765e-3), (2.0e-3, 7.53e-3)):
        rim = Rim(0.0321, 0.0381, 9.53e-3, 41.0, 7850.0, 470.0, 0.0, places)
        ours = spectrum(rim, 0.0, 1e-3, "modal", "uniform", MESH_IV).profile[: len(places)]
        z = np.linspace(0.0, 9.53e-3, MESH_IV.nz)
        count = {(2.0e-3, 4.765e-3): (0, 2), (2.0e-3, 7.53e-3): (0, 1)}.get(places, (0, 1, 2))
        free, seen = (np.cos(np.pi / 9.53e-3 * np.outer(x, count)) for x in (z, places))
        readings = np.array([80.0, 83.0, 82.0, 79.0])[: len(places)]
        np.testing.assert_allclose(readings @ ours, free @ lstsq(seen, readings)[0], atol=2e-3)


@pytest.mark.study
def test_eight_junctions_tell_beta_better_than_four(eight: StudyRig) -> None:
    """Four leave one face unread: a wider interval, which holds the truth all the same."""
    four = study_rig(SEED, rig=rig_with(FOUR))
    found = {}
    for made in (four, eight):
        _, speed = steady_lines(made.test, fit_rows(made.test, 10.0))
        beta = joint_fits(made.test, speed.starts)[1].estimates["beta"]
        assert abs(beta.value - made.told["beta"]) < 2 * beta.u
        found[len(made.test.disks["fast"].chains)] = beta.u
    assert found[8] < 0.7 * found[4]


@pytest.mark.study
def test_a_swap_among_eight_is_told(eight: StudyRig) -> None:
    swapped = eight.log.frame.rename(
        columns={"slow_t2_degC": "slow_t7_degC", "slow_t7_degC": "slow_t2_degC"}
    )
    made = study_rig(SEED, rig=eight.rig, disturbed=lambda frame: swapped[frame.columns])
    (suspect,) = check_sensors(replace(made.test, disks={"slow": made.test.disks["slow"]})).suspects
    assert (suspect.disk, suspect.kind, set(suspect.channels)) == ("slow", "swapped", {"t2", "t7"})


@pytest.mark.e2e
def test_disks_with_different_junctions_go_from_log_to_beta_by_command(tmp_path: Path) -> None:
    """Fast eight, slow six; the log calls one of them otherwise, and one is left out."""
    rig = parse_rig(
        {"fast": {"thermocouples": EIGHT}, "columns": {"fast_t3_degC": "TC 3"}}, "rig.toml"
    )
    made = study_rig(SEED, rig=rig)
    made.log.frame.rename(columns={"fast_t3_degC": "TC 3"}).to_csv(tmp_path / "B3.csv", index=False)
    (tmp_path / "rig.toml").write_text(rig_toml(rig))
    records = [write_record(r, tmp_path / f"{d}.disk.json") for d, r in made.records.items()]
    assert {d: set(read_record(p).static) for d, p in zip(("fast", "slow"), records)} == {
        "fast": set(EIGHT),
        "slow": set("abcdef"),
    }
    log = read_log(tmp_path / "B3.csv", "ehl", load_rig(tmp_path / "rig.toml"))
    assert len(log.channels) == 14
    told = [f"--record={p}" for p in records]
    words = [
        "beta",
        str(tmp_path / "B3.csv"),
        *told,
        "--without=fast_t4",
        "--out",
        str(tmp_path / "b.json"),
    ]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    beta = json.loads((tmp_path / "b.json").read_text())["joint"]["both"]["beta"]
    assert abs(beta["value"] - made.told["beta"]) < 2 * beta["u"]
    with pytest.raises(
        InputError,
        match="without: there is no channel 'slow_t1'; expected fast_t1 to fast_t8 or slow_a",
    ):
        estimate_beta(tmp_path / "B3.csv", rig, made.records, without=["slow_t1"])
