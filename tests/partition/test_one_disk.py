"""A log of one disk: the possible estimates of beta equal those of the full log; the impossible ones are reported."""

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
def study() -> StudyRig:
    return study_rig(7000)


@pytest.fixture(scope="module")
def fast_only_log(study: StudyRig, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Log without the slow disk, with the record of the fast disk beside it."""
    path = tmp_path_factory.mktemp("one") / "B3.csv"
    study.log.frame.drop(columns=SLOW).to_csv(path, index=False)
    write_record(study.records["fast"], path.with_name("fast.disk.json"))
    return path


@pytest.fixture(scope="module")
def slow_disk_analysis(study: StudyRig) -> OneDisk:
    return analyse_one_disk(
        replace(study.test, disks={"slow": study.test.disks["slow"]}), sensor_check=False
    )


@pytest.mark.study
def test_joint_fit_of_one_disk_agrees_with_the_full_test(
    study: StudyRig, slow_disk_analysis: OneDisk
) -> None:
    share = 1 - slow_disk_analysis.estimates["joint"].value
    h = slow_disk_analysis.estimates["h joint"].value
    full_fit = disk_fit(study.test, study.test.disks["slow"], share, h, 10.0, "modal")
    assert slow_disk_analysis.estimates["joint"].value == pytest.approx(
        full_fit.beta, abs=0.05 * full_fit.estimates["beta"].u
    )
    for estimator in ("joint", "cooling"):
        beta = slow_disk_analysis.estimates[estimator]
        assert abs(beta.value - study.true_values["beta"]) < 3 * beta.u
    # includes the uncertainty of the rim model
    assert slow_disk_analysis.estimates["joint"].u == pytest.approx(
        full_fit.estimates["beta"].u, rel=0.1
    )
    assert warnings_and_errors(slow_disk_analysis.findings) == ()
    total = np.hypot.reduce([u_joint for u_joint, _ in slow_disk_analysis.budget.values()])
    assert total == pytest.approx(slow_disk_analysis.estimates["joint"].u, rel=1e-6)


@pytest.mark.e2e
def test_beta_command_takes_one_record_and_reports_what_is_missing(fast_only_log: Path) -> None:
    record = str(fast_only_log.with_name("fast.disk.json"))
    out = fast_only_log.with_name("beta.json")
    page = fast_only_log.with_name("beta.html")
    arguments = [
        "beta",
        str(fast_only_log),
        "--record",
        record,
        "--out",
        str(out),
        "--report",
        str(page),
    ]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    assert "joint fit of the fast disk alone" in result.output
    data = json.loads(out.read_text(encoding="utf-8"))
    assert data["headline"]["way"] == "joint fast"
    assert data["steady"]["beta"]["value"] is None
    assert set(data["joint"]) == {"fast", "both", "profiles"}
    assert set(data["crosscheck"]) == {
        "z",
        "agree",
        "sentence",
        "p_value",
        "suspects",
        "strained",
        "pairs",
    }
    numbers_of_both_disks = (
        *data["joint"]["both"].values(),
        *data["surface"].values(),
        data["steady"]["beta"],
    )
    assert len(numbers_of_both_disks) == 4 + 3 + 1
    assert all(set(number.values()) == {None} for number in numbers_of_both_disks)
    crosscheck = data["crosscheck"]
    lists_of_both_disks = (
        data["joint"]["profiles"],
        crosscheck["suspects"],
        crosscheck["strained"],
        crosscheck["p_value"],
    )
    assert not any(lists_of_both_disks)
    assert "one_disk.only" in [f["code"] for f in data["findings"]]
    html = page.read_text(encoding="utf-8").replace("\u00a0", " ")
    beta = Estimate(**data["headline"]["beta"])
    assert typeset(f"<b>β = {beta}</b>") in html
    assert "sensor map of the fast disk" in html
    assert "slow disk</h" not in html
    assert html.count("<img") == 8
    assert html.count("joint fit, fast disk") == 1


@pytest.mark.e2e
def test_page_shows_the_model_of_the_joint_fit_and_withholds_impossible_beta(
    slow_disk_analysis: OneDisk, tmp_path: Path
) -> None:
    comparison = compare_joint_fit(slow_disk_analysis, "slow")
    z = (comparison.readings_degC - comparison.model_degC) / comparison.sd_K
    assert 0.7 < float((z**2).mean()) < 2.0
    assert (
        float(
            np.abs(
                (comparison.readings_degC - comparison.model_degC)[
                    comparison.time_since_unloading_s < 0
                ].mean(axis=0)
            ).max()
        )
        < 0.03
    )
    pages = {
        "B3.1": slow_disk_analysis,
        "B3.2": replace(
            slow_disk_analysis,
            estimates={**slow_disk_analysis.estimates, "joint": Estimate.normal(1.4, 0.1)},
        ),
    }
    html = write_one_disk_report(tmp_path / "two.html", pages).read_text(encoding="utf-8")
    assert "B3.2: no β" in html
    assert "withheld" in html


@pytest.mark.parametrize(
    ("impossible", "status", "withheld"),
    [
        ({"cooling": 1.3}, "warning", {"cooling"}),
        ({"h cooling": -40.0}, "warning", {"cooling"}),
        ({"joint": 1.3}, "withheld", {"joint"}),
        ({"h joint": -40.0, "cooling": -0.2}, "withheld", {"joint", "cooling"}),
    ],
)
def test_impossible_results_are_withheld_everywhere(
    impossible: dict[str, float],
    status: str,
    withheld: set[str],
    study: StudyRig,
    slow_disk_analysis: OneDisk,
) -> None:
    impossible_estimates = {
        key: Estimate.normal(value, 0.0123) for key, value in impossible.items()
    }
    p = replace(
        slow_disk_analysis, estimates={**slow_disk_analysis.estimates, **impossible_estimates}
    )
    run = OneDiskRun(study.log, p)
    data = run.to_dict()
    text = run.summary()
    card = run.card()
    assert p.impossible == withheld
    assert data["status"] == status
    for estimator, group in (
        ("joint", data["joint"]["slow"]),
        ("cooling", data["transient"]["slow"]),
    ):
        is_hidden = {group[key]["value"] is None for key in group if key != "window_s"}
        assert is_hidden == {estimator in withheld}
        assert {
            row[f"u_beta_{'joint' if estimator == 'joint' else 'transient'}"] is None
            for row in data["budget"]
        } == is_hidden
        card_row = card[card["way"] == f"{estimator} fit, slow disk"].iloc[0]
        assert (card_row["β [1]"] == "withheld") == (estimator in withheld)
    assert (data["headline"]["beta"]["value"] is None) == ("joint" in withheld)
    assert data["crosscheck"]["pairs"] == []
    assert data["crosscheck"]["z"] is None
    assert not data["crosscheck"]["agree"]
    for value in impossible.values():
        assert str(abs(value)) not in text + json.dumps(
            [data["findings"], data["crosscheck"], data["headline"]]
        )
    assert ("of the slow disk finds is impossible" in text) == ("joint" in withheld)
    assert "impossible numbers" in text
    assert "both disks" not in text


def test_missing_record_of_a_logged_disk_raises(study: StudyRig, tmp_path: Path) -> None:
    log_path = tmp_path / "both.csv"
    study.log.frame.head(2000).to_csv(log_path, index=False)
    with pytest.raises(
        InputError, match=r"no record of the slow disk, whose columns the log holds"
    ):
        estimate_one_disk(log_path, None, {"fast": study.records["fast"]})


@pytest.mark.parametrize("command", ["beta", "compensate"])
def test_record_of_a_disk_without_columns_raises(
    study: StudyRig, fast_only_log: Path, tmp_path: Path, command: str
) -> None:
    arguments = [command, str(fast_only_log), "--out", str(tmp_path / "out.csv")]
    for disk, record in study.records.items():
        arguments += ["--record", str(write_record(record, tmp_path / f"{disk}.disk.json"))]
    result = CliRunner().invoke(app, arguments)
    assert isinstance(result.exception, InputError)  # main turns it into exit code 2
    assert "holds no column of the slow disk, whose record was given" in str(result.exception)


@pytest.mark.study
def test_log_of_one_disk_is_compensated_with_its_lag_from_unloading(
    study: StudyRig, fast_only_log: Path
) -> None:
    compensated = compensate_log(fast_only_log, {"fast": study.records["fast"]})
    assert "from the unloading" in compensated.metadata["fast_common_lag_s"]
    assert "fast_a_u_K" in compensated.frame
    assert warnings_and_errors(compensated.findings) == ()
    t = compensated.frame["time_s"]
    unload_s = study.true_values["unload_s"]
    after_unloading = ((t > unload_s) & (t < unload_s + 5)).to_numpy()
    expected = study.true_values["traces"]["fast_e_degC"].to_numpy()[after_unloading]
    error = compensated.frame["fast_e_degC"].to_numpy()[after_unloading] - expected
    assert np.abs(error / compensated.frame["fast_e_u_K"].to_numpy()[after_unloading]).max() < 4
