"""The test locates its own junctions; unusual deviations are reported with their probability."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from scipy import stats

from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import info
from tcdyn.partition import sensor_faults as faults
from tcdyn.partition.crosscheck import (
    DEPTH_THRESHOLD,
    OTHER_THRESHOLD,
    Tension,
    cross_check,
    probability_of_pull,
    sample_largest_pulls,
    tensions,
)
from tcdyn.partition.events import EhlTest
from tcdyn.partition.prepare import prepare_test
from tcdyn.partition.sensor_check import check_sensors
from tcdyn.partition.sensor_faults import DepthTest, FaultFit, depth_test
from tcdyn.partition.sensor_window import sensor_window
from tcdyn.partition.steady import with_inner_row_at_one_radius
from tcdyn.rig.contact import FrictionCorrection
from tcdyn.rig.disk import CHANNELS
from tcdyn.rig.log import read_log
from tests.conftest import Campaign
from tests.partition.study_rigs import QUICK, study_rig
from tests.partition.test_sensors import with_specified_depth

DEPTH_E = info("stated.depth", subject="fast", channel="e", deeper_mm=0.3, u_mm=0.1)


def is_depth_tension(t: Tension) -> bool:
    """Whether it concerns the depth of a junction, by the sensor check or by the joint fit."""
    return t.nominal.code == "stated.depth" or t.nominal.numbers.get("source") == "junction depth"


@pytest.fixture(scope="module")
def b3(campaign: Campaign) -> EhlTest:
    return prepare_test(
        read_log(campaign.files.ehl["B3"], "ehl", campaign.rig), campaign.rig, campaign.records
    )


@pytest.mark.study
def test_disk_that_still_warms_up_has_no_findings() -> None:
    """A minute under load: the inner row rises by 0.3 K/s when the load goes off."""
    study = study_rig(
        3, uncertain=False, options=replace(QUICK, load_on_s=20.0, unload_s=80.0, duration_s=96.0)
    )
    result = check_sensors(study.test)
    assert result.sound, result.findings
    for test in result.depths.values():
        # of twelve junctions: exceeded by one intact rig in thirty
        assert np.abs(test.pull).max() < 3.0


@pytest.mark.e2e
def test_change_of_h_does_not_change_the_depth_pulls(
    b3: EhlTest, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The pulls change if h is taken as known, and hardly if h is nearly unknown."""
    h = float(faults.H_GRID_W_M2K[9])
    f = sensor_window(b3, b3.disks["fast"])
    fault_fit = cast(FaultFit, SimpleNamespace(h_W_m2K=h, share=0.6))
    boundary, power = f.rim.response(np.array([1.05 * h, h]))
    high, nominal = boundary + 0.6 * power
    shifted = replace(f, levels=f.levels + 10 * (high - nominal))
    changes = []
    for sd in (faults.LOG_H_SD, 1e-3):
        monkeypatch.setattr(faults, "LOG_H_SD", sd)
        before, after = (depth_test(x, fault_fit).pull for x in (f, shifted))
        changes.append(np.abs(after - before).max())
    assert changes[0] < 0.1 * changes[1]


def independent_depth_test(pull: list[float]) -> DepthTest:
    deeper = {c: Estimate.normal(0.0, 1e-4) for c in CHANNELS}
    return DepthTest("fast", np.array(pull), np.eye(6), deeper, 1e-4)


@pytest.mark.study
@pytest.mark.parametrize(
    ("channel", "deeper_mm"), [("a", 0.3), ("c", -0.3), ("e", 0.3), ("d", 0.3), ("b", -0.3)]
)
def test_junction_off_by_0_3_mm_is_located_within_its_uncertainty(
    b3: EhlTest, channel: str, deeper_mm: float
) -> None:
    shifted = with_specified_depth(b3, "fast", channel, deeper_mm * 1e-3)
    result = check_sensors(with_inner_row_at_one_radius(shifted)).depths["fast"]
    estimate = result.deeper_m[channel]
    assert abs(estimate.value * 1e3 - deeper_mm) < 3 * estimate.u * 1e3
    assert estimate.u < 0.1e-3  # smaller than the nominal uncertainty
    # three standard uncertainties of the nominal depth, combined with the uncertainty of the test
    assert result.pull[CHANNELS.index(channel)] == pytest.approx(
        np.sign(deeper_mm) * 3 / np.hypot(1, estimate.u / 0.1e-3), abs=1.0
    )


def test_p_value_of_the_largest_pull_matches_independent_normal_deviates() -> None:
    tests = [independent_depth_test([0.0] * 6)] * 2
    largest = sample_largest_pulls(tests)
    for pull in (2.0, 2.5, 3.0):
        exact = 1 - (1 - 2 * stats.norm.sf(pull)) ** 12
        assert probability_of_pull(pull, largest, 12) == pytest.approx(
            exact, abs=4 * np.sqrt(exact / len(largest))
        )
    # beyond all samples
    assert probability_of_pull(6.0, largest, 12) == pytest.approx(24 * stats.norm.sf(6.0))


def test_correlated_pulls_count_as_fewer() -> None:
    correlated = replace(
        independent_depth_test([0.0] * 6), correlation=np.full((6, 6), 0.99) + 0.01 * np.eye(6)
    )
    assert probability_of_pull(
        2.5, sample_largest_pulls([correlated]), 6
    ) < 0.5 * probability_of_pull(2.5, sample_largest_pulls([independent_depth_test([0.0] * 6)]), 6)


def test_contradiction_is_an_error_and_the_largest_tension_a_note() -> None:
    samples = {
        n: np.random.default_rng(k).normal(0.66, 0.01, 5000)
        for k, n in enumerate(("speed law", "joint fast"))
    }
    estimates = {
        "speed law": Estimate.normal(0.66, 0.01),
        "joint fast": Estimate.normal(0.665, 0.01),
    }
    with_note = cross_check(estimates, samples, [Tension(DEPTH_E, 2.4, 0.2, DEPTH_THRESHOLD)])
    assert with_note.agree
    assert with_note.largest_tension is not None
    assert (with_note.finding.numbers["strained_z"], with_note.finding.numbers["chance"]) == (
        2.4,
        0.2,
    )
    assert (
        "2.4 standard deviations, no contradiction (one sound test in 5 shows as much)"
        in with_note.sentence
    )
    with_contradiction = cross_check(
        estimates, samples, [Tension(DEPTH_E, 3.4, 0.008, DEPTH_THRESHOLD)]
    )
    assert not with_contradiction.agree
    assert with_contradiction.finding.code == "ways.contradicted"
    assert with_contradiction.finding.numbers["suspects"] == (DEPTH_E.sentence,)
    without_tension = cross_check(estimates, samples, [Tension(DEPTH_E, 1.4, 0.9, DEPTH_THRESHOLD)])
    assert without_tension.largest_tension is None


@pytest.mark.long
@pytest.mark.study
def test_every_nominal_value_is_judged_once(b3: EhlTest, campaign: Campaign) -> None:
    """Depths by the sensor check if it exists, otherwise by the joint fit; never by both."""
    from tcdyn.partition.analyse import analyse

    with_map = analyse(b3)
    assert with_map.sensors is not None
    mapped = tensions(b3, with_map.joint, with_map.combined, with_map.sensors)
    without_map = tensions(b3, with_map.joint, with_map.combined)
    assert (
        sum(is_depth_tension(t) for t in mapped)
        == sum(is_depth_tension(t) for t in without_map)
        == 12
    )
    assert len(mapped) == len(without_map)
    assert {t.threshold for t in mapped if is_depth_tension(t)} == {DEPTH_THRESHOLD}
    assert {t.threshold for t in without_map} == {OTHER_THRESHOLD}
    # a nominal exponent far from that of the two disks is a contradiction, wherever its range lies
    shifted_exponent = replace(b3, speed_exponent=1.2)
    (tension,) = [
        t
        for t in tensions(shifted_exponent, with_map.joint, with_map.combined)
        if t.nominal.code == "stated.exponent"
    ]
    assert tension.contradicts
    assert not any(t.contradicts for t in mapped)
    # the uncertainty of the friction correction adds in quadrature to the friction row of the
    # budget
    u_nominal = {r.source: r.u_beta_steady for r in with_map.budget.rows}["friction"]
    log = read_log(campaign.files.ehl["B3"], "ehl", campaign.rig)
    with_friction_u = prepare_test(
        log,
        campaign.rig,
        campaign.records,
        lambda *_: FrictionCorrection(0.0, 0.03 * b3.friction_N),
    )
    u_widened = {
        r.source: r.u_beta_steady for r in analyse(with_friction_u, sensor_check=False).budget.rows
    }["friction"]
    friction_rel = campaign.rig.common.uncertainty.friction_rel
    # the sampling error of 4000 draws
    assert u_widened / u_nominal == pytest.approx(np.hypot(1, 0.03 / friction_rel), rel=0.05)
