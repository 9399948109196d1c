"""A log of one disk: the possible estimates of beta equal those of the full log; the impossible
ones are reported."""

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
from tcdyn.partition.analyse import Partition, analyse
from tcdyn.partition.joint import disk_fit
from tcdyn.partition.joint_results import compare_joint_fit, joint_budget
from tcdyn.report.beta import write_beta_report
from tcdyn.report.page import typeset
from tcdyn.rig.disk import CHANNELS
from tcdyn.rig.record import write_record
from tcdyn.workflows import BetaRun, compensate_log, estimate_beta
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
def slow_disk_analysis(study: StudyRig) -> Partition:
    return analyse(
        replace(study.test, disks={"slow": study.test.disks["slow"]}), sensor_check=False
    )


@pytest.mark.study
def test_joint_fit_of_one_disk_agrees_with_the_full_test(
    study: StudyRig, slow_disk_analysis: Partition
) -> None:
    estimates = slow_disk_analysis.estimates
    recommended = slow_disk_analysis.combined.estimates["beta"]
    share = 1 - estimates["joint slow"].value
    h = estimates["h joint slow"].value
    full_fit = disk_fit(study.test, study.test.disks["slow"], share, h, 10.0, "modal")
    assert recommended.value == pytest.approx(
        full_fit.beta, abs=0.05 * full_fit.estimates["beta"].u
    )
    for estimator in ("joint slow", "cooling slow"):
        beta = estimates[estimator]
        assert abs(beta.value - study.true_values["beta"]) < 3 * beta.u
    # the samples include the uncertainty of the rim model
    assert estimates["joint slow"].u == pytest.approx(full_fit.estimates["beta"].u, rel=0.1)
    assert warnings_and_errors(slow_disk_analysis.findings) == ()
    total = np.hypot.reduce(list(joint_budget(slow_disk_analysis).values()))
    assert total == pytest.approx(recommended.u, rel=1e-6)


@pytest.mark.e2e
def test_beta_command_takes_one_record_and_reports_what_is_missing(fast_only_log: Path) -> None:
    record = str(fast_only_log.with_name("fast.disk.json"))
    out = fast_only_log.with_name("beta.json")
    page = fast_only_log.with_name("beta.html")
    arguments = [
        "rig",
        "beta",
        str(fast_only_log),
        "--record",
        record,
        "--out",
        str(out),
        "--profiles",
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
    numbers_of_both_disks = (
        *data["joint"]["both"].values(),
        data["surface"]["slow_max_degC"],
        data["surface"]["delta_T_us"],
        data["steady"]["beta"],
    )
    assert len(numbers_of_both_disks) == 4 + 2 + 1
    assert all(set(number.values()) == {None} for number in numbers_of_both_disks)
    (pair,) = data["crosscheck"]["pairs"]
    assert {pair["one"], pair["other"]} == {"joint fast", "cooling fast"}
    assert set(data["joint"]["profiles"]["fast"]) == {"beta", "h", "lag_s"}
    assert data["alternatives"] == []
    assert data["headline"]["range95"] is None
    assert all(row["u_beta_steady"] is None for row in data["budget"])
    assert "one_disk.only" in [f["code"] for f in data["findings"]]
    html = page.read_text(encoding="utf-8").replace("\u00a0", " ")
    beta = Estimate(**data["headline"]["beta"])
    assert typeset(f"<b>β = {beta}</b>") in html
    assert "sensor map of the fast disk" in html
    assert "slow disk</h" not in html
    assert "model-form alternatives" not in html
    assert "influence of the exponent" not in html
    assert html.count("joint fit, fast disk") == 1


@pytest.mark.e2e
def test_page_shows_the_model_of_the_joint_fit_and_withholds_impossible_beta(
    slow_disk_analysis: Partition, tmp_path: Path
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
            combined=replace(
                slow_disk_analysis.combined,
                estimates={
                    **slow_disk_analysis.combined.estimates,
                    "beta": Estimate.normal(1.4, 0.1),
                },
            ),
        ),
    }
    html = write_beta_report(tmp_path / "two.html", pages).read_text(encoding="utf-8")
    assert "B3.2: no β" in html
    assert "withheld" in html


@pytest.mark.e2e
@pytest.mark.parametrize(
    ("impossible", "withheld"),
    [
        ({"cooling slow": 1.3}, {"cooling slow"}),
        ({"h cooling slow": -40.0}, {"cooling slow"}),
        ({"joint slow": 1.3}, {"joint slow"}),
        ({"h joint slow": -40.0, "cooling slow": -0.2}, {"joint slow", "cooling slow"}),
    ],
)
def test_impossible_results_of_one_disk_are_withheld(
    impossible: dict[str, float],
    withheld: set[str],
    study: StudyRig,
    slow_disk_analysis: Partition,
) -> None:
    estimates = dict(slow_disk_analysis.estimates)
    combined = dict(slow_disk_analysis.combined.estimates)
    for key, value in impossible.items():
        estimates[key] = Estimate.normal(value, 0.0123)
        if key == "joint slow":
            combined["beta"] = estimates[key]
        if key == "h joint slow":
            combined["h_slow"] = estimates[key]
    p = replace(
        slow_disk_analysis,
        estimates=estimates,
        combined=replace(slow_disk_analysis.combined, estimates=combined),
    )
    run = BetaRun(study.log, p, "")
    data = run.to_dict()
    text = run.summary()
    card = run.card()
    is_withheld = "joint slow" in withheld
    assert {key for key in p.impossible if key in p.beta_by_estimator} == withheld
    assert (data["status"] == "withheld") == is_withheld
    for estimator, group in (
        ("joint", data["joint"]["slow"]),
        ("cooling", data["transient"]["slow"]),
    ):
        is_hidden = {group[key]["value"] is None for key in group if key != "window_s"}
        assert is_hidden == {f"{estimator} slow" in withheld}
        card_row = card[card["way"] == f"{estimator} fit, slow disk"].iloc[0]
        assert (card_row["β [1]"] == "withheld") == (f"{estimator} slow" in withheld)
    assert (data["headline"]["beta"]["value"] is None) == is_withheld
    for value in impossible.values():
        assert str(abs(value)) not in text + json.dumps([data["findings"], data["headline"]])
    assert ("of the slow disk finds is impossible" in text) == is_withheld
    assert "both disks" not in text


@pytest.mark.study
def test_wrong_lag_of_the_record_of_one_disk_is_reported(study: StudyRig) -> None:
    record = study.test.disks["slow"]
    wrong_lag = replace(record, chains=tuple(chain.with_lag_shift(0.4) for chain in record.chains))
    p = analyse(replace(study.test, disks={"slow": wrong_lag}), sensor_check=False)
    assert any(t.nominal.code == "stated.lag" for t in p.crosscheck.suspects)
    assert p.status == "warning"


def test_missing_record_of_a_logged_disk_raises(study: StudyRig, tmp_path: Path) -> None:
    log_path = tmp_path / "both.csv"
    study.log.frame.head(2000).to_csv(log_path, index=False)
    with pytest.raises(
        InputError, match=r"no record of the slow disk, whose columns the log holds"
    ):
        estimate_beta(log_path, None, {"fast": study.records["fast"]})


@pytest.mark.parametrize(("command", "out"), [("rig beta", "out.json"), ("compensate", "out.csv")])
def test_record_of_a_disk_without_columns_raises(
    study: StudyRig, fast_only_log: Path, tmp_path: Path, command: str, out: str
) -> None:
    arguments = [*command.split(), str(fast_only_log), "--out", str(tmp_path / out)]
    for disk, record in study.records.items():
        arguments += ["--record", str(write_record(record, tmp_path / f"{disk}.disk.json"))]
    result = CliRunner().invoke(app, arguments)
    assert isinstance(result.exception, InputError)  # main turns it into exit code 2
    assert "holds no column of the slow disk, whose record was given" in str(result.exception)


@pytest.mark.long
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
