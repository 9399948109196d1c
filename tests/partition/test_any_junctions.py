"""Disks with junctions other than a to f, simulated by the full-disk solver: fits with four and
with eight."""

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
# depth, z, angle: two opposite groups; four junctions 6 mm deep, none of them at the centre
POSITIONS = {
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
    name: dict(zip(("depth_mm", "z_mm", "angle_deg"), position))
    for name, position in POSITIONS.items()
}
SEED = 11


def rig_with(junctions: dict[str, Any], **tables: Any) -> Rig:
    return parse_rig({"thermocouples": junctions, **tables}, "rig.toml")


@pytest.fixture(scope="module")
def eight() -> StudyRig:
    return study_rig(SEED, rig=rig_with(EIGHT))


def test_own_junction_table_replaces_the_default_and_survives_a_round_trip(tmp_path: Path) -> None:
    for junctions in (FOUR, EIGHT):
        rig = rig_with(
            junctions,
            slow={"thermocouples": {"layout": "own", "x1": {"depth_mm": 2.0, "z_mm": 5.0}}},
        )
        assert rig.disk_setup("fast").channels == tuple(sorted(set(junctions) - {"layout"}))
        assert rig.disk_setup("slow").channels == ("x1",)
        (tmp_path / "rig.toml").write_text(rig_toml(rig))
        assert load_rig(tmp_path / "rig.toml") == rig


def test_inner_row_is_chosen_by_depth_not_by_name() -> None:
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
        {"t1": EIGHT["t1"], "t5": EIGHT["t5"]},  # one junction of the greatest depth
        {c: EIGHT[c] for c in ("t5", "t6", "t7", "t8")},  # no junction nearer the surface
        {
            "t1": EIGHT["t1"],
            "t5": EIGHT["t5"],
            "t6": {**EIGHT["t5"], "angle_deg": 90.0},
        },  # two junctions of the same depth and z
    ],
)
def test_junction_rows_that_cannot_determine_beta_raise(junctions: dict[str, Any]) -> None:
    with pytest.raises(
        InputError, match="expected two junctions or more of the greatest depth, at different z_mm"
    ):
        rig_with(junctions).disk_setup("fast").check_junction_rows()


def test_inner_row_profile_matches_least_squares_on_cosines() -> None:
    """Against least squares by scipy on cosines, the eigenfunctions of a slab with insulated
    faces."""
    for positions in ((1.5e-3, 3.8e-3, 5.8e-3, 8.0e-3), (2.0e-3, 4.765e-3), (2.0e-3, 7.53e-3)):
        rim = Rim(0.0321, 0.0381, 9.53e-3, 41.0, 7850.0, 470.0, 0.0, positions)
        profile = spectrum(rim, 0.0, 1e-3, "modal", "uniform", MESH_IV).profile[: len(positions)]
        z = np.linspace(0.0, 9.53e-3, MESH_IV.nz)
        orders = {(2.0e-3, 4.765e-3): (0, 2), (2.0e-3, 7.53e-3): (0, 1)}.get(positions, (0, 1, 2))
        free, design = (np.cos(np.pi / 9.53e-3 * np.outer(x, orders)) for x in (z, positions))
        readings = np.array([80.0, 83.0, 82.0, 79.0])[: len(positions)]
        np.testing.assert_allclose(readings @ profile, free @ lstsq(design, readings)[0], atol=2e-3)


@pytest.mark.study
def test_eight_junctions_have_a_smaller_u_of_beta_than_four(eight: StudyRig) -> None:
    """Four junctions leave one face without readings: the interval is wider and still contains the
    truth."""
    four = study_rig(SEED, rig=rig_with(FOUR))
    u_beta = {}
    for study in (four, eight):
        _, speed = steady_lines(study.test, fit_rows(study.test, 10.0))
        beta = joint_fits(study.test, speed.starts)[1].estimates["beta"]
        assert abs(beta.value - study.true_values["beta"]) < 2 * beta.u
        u_beta[len(study.test.disks["fast"].chains)] = beta.u
    assert u_beta[8] < 0.7 * u_beta[4]


@pytest.mark.study
def test_swap_among_eight_junctions_is_identified(eight: StudyRig) -> None:
    swapped = eight.log.frame.rename(
        columns={"slow_t2_degC": "slow_t7_degC", "slow_t7_degC": "slow_t2_degC"}
    )
    study = study_rig(SEED, rig=eight.rig, log_change=lambda frame: swapped[frame.columns])
    (suspect,) = check_sensors(
        replace(study.test, disks={"slow": study.test.disks["slow"]})
    ).suspects
    assert (suspect.disk, suspect.kind, set(suspect.channels)) == ("slow", "swapped", {"t2", "t7"})


@pytest.mark.e2e
def test_disks_with_different_junctions_work_from_log_to_beta(tmp_path: Path) -> None:
    """Eight junctions on the fast disk, six on the slow one; one column is renamed and one channel
    excluded."""
    rig = parse_rig(
        {"fast": {"thermocouples": EIGHT}, "columns": {"fast_t3_degC": "TC 3"}}, "rig.toml"
    )
    study = study_rig(SEED, rig=rig)
    study.log.frame.rename(columns={"fast_t3_degC": "TC 3"}).to_csv(
        tmp_path / "B3.csv", index=False
    )
    (tmp_path / "rig.toml").write_text(rig_toml(rig))
    records = [write_record(r, tmp_path / f"{d}.disk.json") for d, r in study.records.items()]
    assert {d: set(read_record(p).static) for d, p in zip(("fast", "slow"), records)} == {
        "fast": set(EIGHT),
        "slow": set("abcdef"),
    }
    log = read_log(tmp_path / "B3.csv", "ehl", load_rig(tmp_path / "rig.toml"))
    assert len(log.channels) == 14
    record_options = [f"--record={p}" for p in records]
    arguments = [
        "rig",
        "beta",
        str(tmp_path / "B3.csv"),
        *record_options,
        "--without=fast_t4",
        "--out",
        str(tmp_path / "b.json"),
    ]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    beta = json.loads((tmp_path / "b.json").read_text())["joint"]["both"]["beta"]
    assert abs(beta["value"] - study.true_values["beta"]) < 2 * beta["u"]
    with pytest.raises(
        InputError,
        match="without: there is no channel 'slow_t1'; expected fast_t1 to fast_t8 or slow_a",
    ):
        estimate_beta(tmp_path / "B3.csv", rig, study.records, without=["slow_t1"])
