"""A log of one disk: beta by the ways that it allows, as the log of both gives them; what is not possible is told."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from tcdyn.cli.app import app
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import warnings_and_errors
from tcdyn.partition.joint import disk_fit
from tcdyn.partition.single_disk import OneDisk, analyse_one_disk
from tcdyn.report.page import typeset
from tcdyn.report.single_disk import write_one_disk_report
from tcdyn.rig.disk import CHANNELS
from tcdyn.rig.record import write_record
from tcdyn.workflows import compensate_log, estimate_one_disk
from tcdyn.workflows.beta_tables import compare_joint_fit
from tcdyn.workflows.single_disk import OneDiskRun
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


@pytest.fixture(scope="module")
def found(made: StudyRig) -> OneDisk:
    return analyse_one_disk(
        replace(made.test, disks={"slow": made.test.disks["slow"]}), sensor_check=False
    )


@pytest.mark.study
def test_the_joint_fit_is_that_of_the_full_test_and_holds_the_truth(
    made: StudyRig, found: OneDisk
) -> None:
    share, h = 1 - found.estimates["joint"].value, found.estimates["h joint"].value
    again = disk_fit(made.test, made.test.disks["slow"], share, h, 10.0, "modal")
    assert found.estimates["joint"].value == pytest.approx(
        again.beta, abs=0.05 * again.estimates["beta"].u
    )
    for way in ("joint", "cooling"):
        beta = found.estimates[way]
        assert abs(beta.value - made.told["beta"]) < 3 * beta.u
    assert found.estimates["joint"].u == pytest.approx(
        again.estimates["beta"].u, rel=0.1
    )  # with the rim's form
    assert warnings_and_errors(found.findings) == ()
    total = np.hypot.reduce([joint for joint, _ in found.budget.values()])
    assert total == pytest.approx(found.estimates["joint"].u, rel=1e-6)


@pytest.mark.e2e
def test_the_command_takes_one_record_and_tells_what_is_not_possible(lone: Path) -> None:
    record, out = str(lone.with_name("fast.disk.json")), lone.with_name("beta.json")
    page = lone.with_name("beta.html")
    words = ["beta", str(lone), "--record", record, "--out", str(out), "--report", str(page)]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    assert "joint fit of the fast disk alone" in done.output
    kept = json.loads(out.read_text(encoding="utf-8"))
    assert kept["headline"]["way"] == "joint fast"
    assert kept["steady"]["beta"]["value"] is None
    assert set(kept["joint"]) == {"fast", "both", "profiles"}
    assert set(kept["crosscheck"]) == {
        "z",
        "agree",
        "sentence",
        "p_value",
        "suspects",
        "strained",
        "pairs",
    }
    both = (*kept["joint"]["both"].values(), *kept["surface"].values(), kept["steady"]["beta"])
    assert len(both) == 4 + 3 + 1
    assert all(set(number.values()) == {None} for number in both)
    crosscheck = kept["crosscheck"]
    empty = (
        kept["joint"]["profiles"],
        crosscheck["suspects"],
        crosscheck["strained"],
        crosscheck["p_value"],
    )
    assert not any(empty)
    assert "one_disk.only" in [f["code"] for f in kept["findings"]]
    shown = page.read_text(encoding="utf-8").replace("\u00a0", " ")
    beta = Estimate(**kept["headline"]["beta"])
    assert typeset(f"<b>β = {beta}</b>") in shown
    assert "sensor map of the fast disk" in shown
    assert "slow disk</h" not in shown
    assert shown.count("<img") == 8
    assert shown.count("joint fit, fast disk") == 1


@pytest.mark.e2e
def test_the_page_s_model_is_the_joint_fit_s_own_and_its_budget_adds_up(
    found: OneDisk, tmp_path: Path
) -> None:
    m = compare_joint_fit(found, "slow")
    z = (m.readings_degC - m.model_degC) / m.sd_K
    assert 0.7 < float((z**2).mean()) < 2.0
    assert (
        float(
            np.abs(
                (m.readings_degC - m.model_degC)[m.time_since_unloading_s < 0].mean(axis=0)
            ).max()
        )
        < 0.03
    )
    pages = {
        "B3.1": found,
        "B3.2": replace(found, estimates={**found.estimates, "joint": Estimate.normal(1.4, 0.1)}),
    }
    shown = write_one_disk_report(tmp_path / "two.html", pages).read_text(encoding="utf-8")
    assert "B3.2: no β" in shown
    assert "withheld" in shown


@pytest.mark.parametrize(
    ("impossible", "status", "gone"),
    [
        ({"cooling": 1.3}, "warning", {"cooling"}),
        ({"h cooling": -40.0}, "warning", {"cooling"}),
        ({"joint": 1.3}, "withheld", {"joint"}),
        ({"h joint": -40.0, "cooling": -0.2}, "withheld", {"joint", "cooling"}),
    ],
)
def test_what_no_disk_can_do_is_printed_nowhere(
    impossible: dict[str, float], status: str, gone: set[str], made: StudyRig, found: OneDisk
) -> None:
    wrong = {key: Estimate.normal(value, 0.0123) for key, value in impossible.items()}
    p = replace(found, estimates={**found.estimates, **wrong})
    run = OneDiskRun(made.log, p)
    kept, text, card = run.to_dict(), run.summary(), run.card()
    assert p.impossible == gone
    assert kept["status"] == status
    for way, group in (("joint", kept["joint"]["slow"]), ("cooling", kept["transient"]["slow"])):
        hidden = {group[key]["value"] is None for key in group if key != "window_s"}
        assert hidden == {way in gone}
        assert {
            row[f"u_beta_{'joint' if way == 'joint' else 'transient'}"] is None
            for row in kept["budget"]
        } == hidden
        told = card[card["way"] == f"{way} fit, slow disk"].iloc[0]
        assert (told["β [1]"] == "withheld") == (way in gone)
    assert (kept["headline"]["beta"]["value"] is None) == ("joint" in gone)
    assert kept["crosscheck"]["pairs"] == []
    assert kept["crosscheck"]["z"] is None
    assert not kept["crosscheck"]["agree"]
    for value in impossible.values():
        assert str(abs(value)) not in text + json.dumps(
            [kept["findings"], kept["crosscheck"], kept["headline"]]
        )
    assert ("of the slow disk finds is impossible" in text) == ("joint" in gone)
    assert "impossible numbers" in text
    assert "both disks" not in text


def test_a_forgotten_record_is_refused(made: StudyRig, tmp_path: Path) -> None:
    both = tmp_path / "both.csv"
    made.log.frame.head(2000).to_csv(both, index=False)
    with pytest.raises(
        InputError, match=r"no record of the slow disk, whose columns the log holds"
    ):
        estimate_one_disk(both, None, {"fast": made.records["fast"]})


@pytest.mark.parametrize("command", ["beta", "compensate"])
def test_a_record_of_the_disk_that_the_log_does_not_hold_is_one_too_many(
    made: StudyRig, lone: Path, tmp_path: Path, command: str
) -> None:
    words = [command, str(lone), "--out", str(tmp_path / "out.csv")]
    for disk, record in made.records.items():
        words += ["--record", str(write_record(record, tmp_path / f"{disk}.disk.json"))]
    done = CliRunner().invoke(app, words)
    assert isinstance(done.exception, InputError)  # exit code 2, by main
    assert "holds no column of the slow disk, whose record was given" in str(done.exception)


@pytest.mark.study
def test_a_log_of_one_disk_is_compensated_with_its_lag_from_the_unloading(
    made: StudyRig, lone: Path
) -> None:
    done = compensate_log(lone, {"fast": made.records["fast"]})
    assert "from the unloading" in done.metadata["fast_common_lag_s"]
    assert "fast_a_u_K" in done.frame
    assert warnings_and_errors(done.findings) == ()
    t, off = done.frame["time_s"], made.told["unload_s"]
    near = ((t > off) & (t < off + 5)).to_numpy()
    true = made.told["traces"]["fast_e_degC"].to_numpy()[near]
    error = done.frame["fast_e_degC"].to_numpy()[near] - true
    assert np.abs(error / done.frame["fast_e_u_K"].to_numpy()[near]).max() < 4
