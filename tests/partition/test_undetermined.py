"""A beta or an exponent of which the data say nothing is no result, and agrees with nothing."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tcdyn.chain import Chain
from tcdyn.cli.app import app, run
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Severity
from tcdyn.partition.analyse import Partition, apply_corrections, fit_rows, joint_window_s
from tcdyn.partition.cooling import refined_chains
from tcdyn.partition.crosscheck import cross_check
from tcdyn.partition.fit_rounds import fit_in_rounds
from tcdyn.partition.model_forms import (
    ESTIMATORS,
    H_KEYS,
    best_determined,
    impossibility_findings,
    impossible_keys,
    is_undetermined,
)
from tcdyn.report.beta import write_beta_report
from tcdyn.report.campaign import campaign_verdict
from tcdyn.workflows import beta as beta_workflow
from tcdyn.workflows import campaign_log
from tcdyn.workflows.beta import BetaRun
from tcdyn.workflows.campaign import run_campaign
from tests.conftest import Campaign
from tests.partition.study_rigs import QUICK, study_rig

# What was once reported: beta = 0.76 +- 0.60, exponent 0 +- 6800000, "agrees".
NOTHING = Estimate.normal(0.76, 0.60)
NO_EXPONENT = Estimate.normal(0.0, 6.8e6)


@pytest.mark.parametrize(
    ("value", "u", "expected"),
    [
        (0.76, 0.60, True),
        (1.0, 3.3, True),
        (0.67, 0.88, True),
        (0.5, 0.26, True),
        (0.5, 0.25, False),  # 0.01 to 0.99
        (0.70, 0.20, False),
        (1.3, 0.1, False),  # impossible, but determined
    ],
)
def test_an_interval_that_contains_0_and_1_says_nothing(
    value: float, u: float, expected: bool
) -> None:
    assert is_undetermined(Estimate.normal(value, u)) == expected


def _sound() -> tuple[dict[str, Estimate], dict[str, Estimate]]:
    """Estimates of a sound test, and those of its fit of both disks."""
    estimates = {key: Estimate.normal(0.7, 0.01) for key in ESTIMATORS}
    estimates |= {h: Estimate.normal(700.0, 9.0) for keys in H_KEYS.values() for h in keys}
    combined = {
        "beta": Estimate.normal(0.7, 0.005),
        "h_fast": Estimate.normal(700.0, 9.0),
        "h_slow": Estimate.normal(300.0, 9.0),
        "exponent": Estimate.normal(0.67, 0.1),
    }
    return estimates, combined


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_an_undetermined_estimator_is_withheld_with_its_h_and_named(estimator: str) -> None:
    estimates, combined = _sound()
    estimates[estimator] = NOTHING
    assert impossible_keys(estimates, combined) == {estimator, *H_KEYS[estimator]}
    samples = {key: np.random.default_rng(0).normal(0.7, 0.01, 99) for key in estimates}
    (finding,) = impossibility_findings(estimates, combined, samples)
    assert finding.code == "answers.undetermined"
    assert finding.numbers["ways"] == (estimator,)


def test_an_exponent_between_none_and_proportional_is_withheld_alone() -> None:
    estimates, combined = _sound()
    assert impossible_keys(estimates, combined) == frozenset()
    for exponent in (NO_EXPONENT, Estimate.normal(0.8, 1.5), Estimate.normal(0.04, 0.50)):
        keys = impossible_keys(estimates, combined | {"exponent": exponent})
        assert keys == {"both exponent"}


def test_the_most_certain_estimator_that_is_reported_is_named_unless_the_power_is_wrong() -> None:
    estimates, combined = _sound()
    estimates["speed law"] = Estimate.normal(0.68, 0.009)
    combined["beta"] = NOTHING
    assert best_determined(estimates, combined) == "speed law"
    estimates["cooling slow"] = Estimate.normal(1.2, 0.001)  # impossible
    assert best_determined(estimates, combined) == "speed law"
    wrong_power = {
        "joint fast": Estimate.normal(0.9, 0.001),
        "joint slow": Estimate.normal(-0.5, 0.001),
    }
    assert best_determined(estimates | wrong_power, combined) is None
    assert (
        best_determined(
            dict.fromkeys(ESTIMATORS[:1], NOTHING)
            | {"h_fast": estimates["h_fast"], "h_slow": estimates["h_slow"]},
            combined,
        )
        is None
    )


def test_the_cross_check_leaves_out_what_agrees_with_everything() -> None:
    rng = np.random.default_rng(3)
    estimates = {
        "speed law": Estimate.normal(0.67, 0.88),
        "joint fast": Estimate.normal(0.70, 0.01),
        "joint slow": Estimate.normal(0.71, 0.01),
    }
    samples = {key: rng.normal(e.value, e.u, 4000) for key, e in estimates.items()}
    result = cross_check(estimates, samples)
    assert result.agree
    assert [pair[:2] for pair in result.pairs] == [("joint fast", "joint slow")]
    assert "steady" not in result.finding.numbers
    estimates["joint slow"] = NOTHING
    alone = cross_check(estimates, samples)
    assert alone.finding.code == "ways.undetermined"
    assert alone.finding.severity is Severity.WARNING
    assert not alone.agree
    assert np.isnan(alone.z)
    assert alone.finding.numbers["determined"] == ("joint fast",)


@lru_cache
def weak_friction() -> Partition:
    """A test with 1 N of friction: the disks hardly warm up, so the steady lines say nothing."""
    study = study_rig(5, "B3", uncertain=False, options=replace(QUICK, friction_N=1.0))
    return study.analyse(sensor_check=False)


@pytest.mark.long
@pytest.mark.e2e
def test_a_friction_of_1_N_leaves_the_speed_law_undetermined_and_the_joint_fit_reported() -> None:
    """The speed law was 0.67 +- 0.88 and was said to agree."""
    partition = weak_friction()
    assert {"speed law", "h_fast", "h_slow"} <= partition.impossible
    assert partition.estimates["speed law"].u > 0.3
    assert "both beta" not in partition.impossible
    assert partition.recommendation.code == "headline.both"
    pairs = partition.crosscheck.pairs
    assert "speed law" not in {name for pair in pairs for name in pair[:2]}
    assert "steady" not in partition.crosscheck.finding.numbers
    assert "answers.undetermined" in [f.code for f in partition.analysis_findings]


@pytest.mark.long
@pytest.mark.e2e
def test_an_exponent_that_the_test_does_not_determine_is_not_said_to_agree() -> None:
    """0.5 N for 160 s only: 0.8 +- 1.5 was said to agree with the speed law."""
    options = replace(QUICK, unload_s=180.0, duration_s=196.0, friction_N=0.5)
    study = study_rig(5, "B3", uncertain=False, options=options)
    partition = study.analyse(sensor_check=False)
    assert partition.combined.estimates["exponent"].u > 0.5
    assert "both exponent" in partition.impossible
    assert "exponent" not in partition.recommendation.numbers
    beta = partition.combined.estimates["beta"]
    assert beta.u < 0.05
    assert abs(beta.value - study.true_values["beta"]) < 3 * beta.u


def _with_wave(frame: pd.DataFrame) -> pd.DataFrame:
    """The log with a wave of 1 K and 5 s on every junction, each with another phase."""
    changed = frame.copy()
    columns = [c for c in changed if c.startswith(("fast_", "slow_")) and c.endswith("_degC")]
    for k, column in enumerate(columns):
        phase = 2 * np.pi * 0.2 * changed["time_s"] + 1.3 * k
        changed[column] = changed[column] + np.sin(phase)
    return changed


@pytest.mark.long
@pytest.mark.e2e
def test_slow_waves_of_the_readings_leave_the_joint_fit_undetermined_and_the_speed_law_known() -> (
    None
):
    """Beta of the joint fit is 0.57 +- 0.63 and its exponent 1.1 +- 6.9; the truth is 0.667."""
    study = study_rig(5, "B3", uncertain=False, log_change=_with_wave)
    test = apply_corrections(study.test)
    length_s = joint_window_s(test)
    fits = fit_in_rounds(test, fit_rows(test, length_s), length_s, "modal", None)
    beta = fits.combined.estimates["beta"]
    assert 0 < beta.value < 1
    assert is_undetermined(beta)
    assert "both beta" in impossible_keys({}, fits.combined.estimates)
    assert "both exponent" in impossible_keys({}, fits.combined.estimates)
    assert fits.speed.beta == pytest.approx(study.true_values["beta"], abs=0.02)


@pytest.fixture
def undetermined(beta_run: BetaRun) -> BetaRun:
    """The run of test B3 as if its joint fit of both disks said nothing."""
    partition = beta_run.partition
    estimates = {
        **partition.combined.estimates,
        "beta": NOTHING,
        "exponent": NO_EXPONENT,
    }
    combined = replace(partition.combined, estimates=estimates)
    return replace(beta_run, partition=replace(partition, combined=combined))


def _is_told(text: str) -> bool:
    """Whether a text gives the undetermined numbers as a result."""
    return "0.76" in text or "6800000" in text or "6.8e" in text


@pytest.mark.long
@pytest.mark.e2e
def test_an_undetermined_beta_is_no_result_in_python_file_and_page(
    undetermined: BetaRun, tmp_path: Path
) -> None:
    partition = undetermined.partition
    assert partition.status == "withheld"
    finding = partition.recommendation
    assert (finding.code, finding.severity) == ("headline.withheld", Severity.ERROR)
    least = min(partition.beta_by_estimator, key=lambda name: partition.estimates[name].u)
    assert finding.numbers["determined"] == least
    assert finding.numbers["beta"] == partition.estimates[least].value
    assert "both beta" not in undetermined.to_frame().index
    assert not _is_told(undetermined.summary())
    assert not _is_told(undetermined.card().to_string())
    data = undetermined.to_dict()
    assert data["status"] == "withheld"
    assert data["headline"]["beta"]["value"] is None
    assert data["joint"]["both"]["beta"]["value"] is None
    assert data["joint"]["both"]["exponent"]["value"] is None
    assert data["kept"] is None
    page = write_beta_report(tmp_path / "x.html", {"B3": partition}).read_text(encoding="utf-8")
    assert "no β" in page
    assert "0.76 ± 0.60" not in page.replace("\u00a0", " ")


@pytest.mark.long
@pytest.mark.e2e
def test_an_undetermined_beta_ends_with_1_also_in_a_campaign(
    undetermined: BetaRun,
    campaign: Campaign,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    records = [w for path in campaign.record_paths.values() for w in ("--record", str(path))]
    log = campaign.files.ehl["B3"]
    monkeypatch.setattr(beta_workflow, "estimate_stages", lambda *_, **__: (undetermined,))
    assert run(lambda: app(["rig", "beta", str(log), *records])) == 1
    said = capsys.readouterr()
    assert not _is_told(said.out)
    monkeypatch.setattr(campaign_log, "estimate_beta", lambda *_, **__: undetermined)
    words = ["rig", "campaign", str(log), *records, "--out", str(tmp_path), "--workers", "1"]
    assert run(lambda: app(words)) == 1
    said = capsys.readouterr()
    assert not _is_told(said.out)
    stored = json.loads((tmp_path / "EHL_B3.beta.json").read_text(encoding="utf-8"))
    assert stored["status"] == "withheld"
    again = run_campaign([log], campaign.rig, campaign.records, tmp_path)
    assert again.joined is None
    assert "campaign.withheld" in [finding.code for finding in again.findings]
    assert np.isnan(again.table["beta_both"].astype(float)[0])
    assert not _is_told(campaign_verdict(again))


def test_a_second_lag_that_the_data_do_not_determine_does_not_stop_the_smoother() -> None:
    """The fit once gave 2e-17 s, with whose rate the eigenvalues of the smoother were zero."""
    (chain,) = refined_chains([Chain((0.7, 0.1))], Chain((0.8, 2e-17)))
    assert min(chain.taus_s) >= 1e-6
    assert chain.lag_s == pytest.approx(0.8, abs=1e-4)
