"""A test places its own junctions; what is off by more than a sound test shows is named, with the chance of it."""

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
from tcdyn.partition.disk_features import DiskFeatures, disk_features
from tcdyn.partition.events import EhlTest
from tcdyn.partition.sensor_check import check_sensors
from tcdyn.partition.sensor_faults import DepthTest, FaultFit, depth_test
from tcdyn.partition.window import NOMINAL
from tcdyn.rig.contact import FrictionCorrection
from tcdyn.rig.disk import CHANNELS
from tcdyn.rig.log import read_log
from tcdyn.workflows.beta import prepare_test
from tests.conftest import Campaign
from tests.partition.study_rigs import QUICK, study_rig
from tests.partition.test_sensors import stated_elsewhere

DEPTH_E = info("stated.depth", subject="fast", channel="e", deeper_mm=0.3, u_mm=0.1)


def of_depth(t: Tension) -> bool:
    """Whether it is about a junction's depth, by the sensor map or by the joint fit."""
    return t.nominal.code == "stated.depth" or t.nominal.numbers.get("source") == "junction depth"


@pytest.fixture(scope="module")
def b3(campaign: Campaign) -> EhlTest:
    return prepare_test(
        read_log(campaign.files.ehl["B3"], "ehl", campaign.rig), campaign.rig, campaign.records
    )


@pytest.mark.study
def test_a_disk_that_still_warms_up_is_not_accused() -> None:
    """A minute under load: the inner row rises by 0.3 K/s when the load goes off."""
    made = study_rig(
        3, uncertain=False, options=replace(QUICK, load_on_s=20.0, unload_s=80.0, duration_s=96.0)
    )
    found = check_sensors(made.test)
    assert found.sound, found.findings
    for test in found.depths.values():
        assert np.abs(test.pull).max() < 3.0  # twelve junctions: one sound rig in thirty


class Shown:
    """Features whose levels show ``more_K`` (W, C) more, all else as it is."""

    def __init__(self, f: DiskFeatures, more_K: np.ndarray) -> None:
        self.f, self.levels = (
            f,
            f.levels + more_K[:, np.argsort(f.setup.channel_indices(f.setup.rows))],
        )

    def __getattr__(self, name: str) -> object:
        return getattr(self.f, name)


def test_what_another_h_would_show_is_no_evidence_of_a_depth(
    b3: EhlTest, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It moves the pulls where h is taken as known, and hardly where h is as good as unknown."""
    disk, h = b3.disks["fast"], float(faults.H_GRID_W_M2K[9])
    f, verdict = disk_features(b3, disk), cast(FaultFit, SimpleNamespace(h_W_m2K=h, share=0.6))
    high, at = (
        rest + 0.6 * power
        for rest, power in zip(*f.response(f.as_wired, ((1.05 * h, NOMINAL), (h, NOMINAL))))
    )
    shown, moved = cast(DiskFeatures, Shown(f, 10 * (high - at))), []
    for sd in (faults.LOG_H_SD, 1e-3):
        monkeypatch.setattr(faults, "LOG_H_SD", sd)
        before, after = (depth_test(x, disk, verdict).pull for x in (f, shown))
        moved.append(np.abs(after - before).max())
    assert moved[0] < 0.1 * moved[1]


def independent(pull: list[float]) -> DepthTest:
    deeper = {c: Estimate.normal(0.0, 1e-4) for c in CHANNELS}
    return DepthTest("fast", np.array(pull), np.eye(6), deeper, 1e-4)


@pytest.mark.study
@pytest.mark.parametrize(
    ("channel", "deeper_mm"), [("a", 0.3), ("c", -0.3), ("e", 0.3), ("d", 0.3), ("b", -0.3)]
)
def test_a_junction_off_by_a_third_of_a_millimetre_is_placed_there(
    b3: EhlTest, channel: str, deeper_mm: float
) -> None:
    found = check_sensors(stated_elsewhere(b3, "fast", channel, deeper_mm * 1e-3)).depths["fast"]
    placed = found.deeper_m[channel]
    assert abs(placed.value * 1e3 - deeper_mm) < 3 * placed.u * 1e3
    assert placed.u < 0.1e-3  # better than it was stated
    # three standard uncertainties of the stated depth, less what the test itself leaves open
    assert found.pull[CHANNELS.index(channel)] == pytest.approx(
        np.sign(deeper_mm) * 3 / np.hypot(1, placed.u / 0.1e-3), abs=1.0
    )


def test_the_chance_of_the_largest_pull_is_that_of_so_many_normal_deviates() -> None:
    tests = [independent([0.0] * 6)] * 2
    largest = sample_largest_pulls(tests)
    for pull in (2.0, 2.5, 3.0):
        exact = 1 - (1 - 2 * stats.norm.sf(pull)) ** 12
        assert probability_of_pull(pull, largest, 12) == pytest.approx(
            exact, abs=4 * np.sqrt(exact / len(largest))
        )
    assert probability_of_pull(6.0, largest, 12) == pytest.approx(
        24 * stats.norm.sf(6.0)
    )  # beyond every draw


def test_pulls_that_go_together_count_for_fewer() -> None:
    alike = replace(independent([0.0] * 6), correlation=np.full((6, 6), 0.99) + 0.01 * np.eye(6))
    assert probability_of_pull(2.5, sample_largest_pulls([alike]), 6) < 0.5 * probability_of_pull(
        2.5, sample_largest_pulls([independent([0.0] * 6)]), 6
    )


def test_a_contradiction_is_an_alarm_and_the_most_pulled_value_only_a_remark() -> None:
    draws = {
        n: np.random.default_rng(k).normal(0.66, 0.01, 5000)
        for k, n in enumerate(("speed law", "joint fast"))
    }
    ways = {"speed law": Estimate.normal(0.66, 0.01), "joint fast": Estimate.normal(0.665, 0.01)}
    remark = cross_check(ways, draws, [Tension(DEPTH_E, 2.4, 0.2, DEPTH_THRESHOLD)])
    assert remark.agree
    assert remark.largest_tension is not None
    assert (remark.finding.numbers["strained_z"], remark.finding.numbers["chance"]) == (2.4, 0.2)
    assert (
        "2.4 standard deviations, no contradiction (one sound test in 5 shows as much)"
        in remark.sentence
    )
    alarm = cross_check(ways, draws, [Tension(DEPTH_E, 3.4, 0.008, DEPTH_THRESHOLD)])
    assert not alarm.agree
    assert alarm.finding.code == "ways.contradicted"
    assert alarm.finding.numbers["suspects"] == (DEPTH_E.sentence,)
    quiet = cross_check(ways, draws, [Tension(DEPTH_E, 1.4, 0.9, DEPTH_THRESHOLD)])
    assert quiet.largest_tension is None


@pytest.mark.study
def test_every_stated_value_is_judged_once(b3: EhlTest, campaign: Campaign) -> None:
    """Depths by the sensor map where there is one, by the joint fit otherwise; never by both."""
    from tcdyn.partition.analyse import analyse

    with_map = analyse(b3)
    assert with_map.sensors is not None
    mapped = tensions(b3, with_map.joint, with_map.both, with_map.sensors)
    bare = tensions(b3, with_map.joint, with_map.both)
    assert sum(of_depth(t) for t in mapped) == sum(of_depth(t) for t in bare) == 12
    assert len(mapped) == len(bare)
    assert {t.threshold for t in mapped if of_depth(t)} == {DEPTH_THRESHOLD}
    assert {t.threshold for t in bare} == {OTHER_THRESHOLD}
    # an exponent that rig.toml states far from what the two disks imply is a contradiction, wherever its range lies
    elsewhere = replace(b3, speed_exponent=1.2)
    (steep,) = [
        t
        for t in tensions(elsewhere, with_map.joint, with_map.both)
        if t.nominal.code == "stated.exponent"
    ]
    assert steep.contradicts
    assert not any(t.contradicts for t in mapped)
    # the added friction's own uncertainty widens the budget's row of friction as the two combine
    less = {r.source: r.u_beta_steady for r in with_map.budget.rows}["friction"]
    log = read_log(campaign.files.ehl["B3"], "ehl", campaign.rig)
    unsure = prepare_test(
        log,
        campaign.rig,
        campaign.records,
        lambda *_: FrictionCorrection(0.0, 0.03 * b3.friction_N),
    )
    more = {r.source: r.u_beta_steady for r in analyse(unsure, sensor_check=False).budget.rows}[
        "friction"
    ]
    stated = campaign.rig.common.uncertainty.friction_rel
    assert more / less == pytest.approx(
        np.hypot(1, 0.03 / stated), rel=0.05
    )  # the sampling of 4000 draws
