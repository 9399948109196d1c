"""A log of one disk: beta by the ways that it allows, as the log of both gives them; what is not possible is told."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from calibration.disk import CHANNELS
from calibration.errors import InputError
from calibration.finding import doubts
from calibration.record import write_record
from tcdyn.cli.app import app
from tcdyn.partition.joint import disk_fit
from tcdyn.partition.one_disk import analyse_one
from tcdyn.pipeline import compensate_log, estimate_one_disk
from tests.partition.study_rigs import StudyRig, study_rig

SLOW = [f"slow_{c}_degC" for c in CHANNELS]


@pytest.fixture(scope="module")
def made() -> StudyRig:
    return study_rig(7000)


@pytest.fixture(scope="module")
def lone(made: StudyRig, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The log without the slow disk, and the fast disk's record beside it."""
    path = tmp_path_factory.mktemp("one") / "B3.csv"
    made.log.frame.drop(columns=SLOW).to_csv(path, index=False)
    write_record(made.records["fast"], path.with_name("fast.disk.json"))
    return path


def test_the_joint_fit_is_that_of_the_full_test_and_holds_the_truth(made: StudyRig) -> None:
    found = analyse_one(replace(made.test, disks={"slow": made.test.disks["slow"]}), sensor_check=False)
    share, h = 1 - found.answers["joint"].value, found.answers["h joint"].value
    again = disk_fit(made.test, made.test.disks["slow"], share, h, 10.0, "modal")
    assert found.answers["joint"].value == pytest.approx(again.beta, abs=0.05 * again.estimates["beta"].u)
    for way in ("joint", "cooling"):
        beta = found.answers[way]
        assert abs(beta.value - made.told["beta"]) < 3 * beta.u
    assert found.answers["joint"].u == pytest.approx(again.estimates["beta"].u, rel=0.1)  # with the rim's form
    assert doubts(found.findings) == ()
    total = np.hypot.reduce([joint for joint, _ in found.budget.values()])
    assert total == pytest.approx(found.answers["joint"].u, rel=1e-6)


def test_the_command_takes_one_record_and_tells_what_is_not_possible(lone: Path) -> None:
    record, out = str(lone.with_name("fast.disk.json")), lone.with_name("beta.json")
    done = CliRunner().invoke(app, ["beta", str(lone), "--record", record, "--out", str(out), "--no-sensor-check"])
    assert done.exit_code == 0, done.output
    assert "joint fit of the fast disk alone" in done.output
    kept = json.loads(out.read_text(encoding="utf-8"))
    assert kept["headline"]["way"] == "joint fast"
    assert kept["steady"]["beta"]["value"] is None
    assert set(kept["joint"]) == {"fast"}
    assert "one_disk.only" in [f["code"] for f in kept["findings"]]


def test_a_report_of_one_disk_and_a_forgotten_record_are_refused(made: StudyRig, lone: Path, tmp_path: Path) -> None:
    record = str(lone.with_name("fast.disk.json"))
    page = CliRunner().invoke(app, ["beta", str(lone), "--record", record, "--report", str(tmp_path / "b.html")])
    assert isinstance(page.exception, InputError)  # exit code 2, by main
    assert not (tmp_path / "b.html").exists()
    both = tmp_path / "both.csv"
    made.log.frame.head(2000).to_csv(both, index=False)
    with pytest.raises(InputError, match=r"no record of the slow disk, whose columns the log holds"):
        estimate_one_disk(both, None, {"fast": made.records["fast"]})


def test_a_log_of_one_disk_is_compensated_with_its_lag_from_the_unloading(made: StudyRig, lone: Path) -> None:
    done = compensate_log(lone, {"fast": made.records["fast"]})
    assert "from the unloading" in done.metadata["fast_common_lag_s"]
    assert "fast_a_u_K" in done.frame
    assert doubts(done.findings) == ()
    t, off = done.frame["time_s"], made.told["unload_s"]
    near = ((t > off) & (t < off + 5)).to_numpy()
    true = made.told["traces"]["fast_e_degC"].to_numpy()[near]
    error = done.frame["fast_e_degC"].to_numpy()[near] - true
    assert np.abs(error / done.frame["fast_e_u_K"].to_numpy()[near]).max() < 4
