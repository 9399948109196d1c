"""Disks that slow down after the parting, or touch again: what the films and the pulses of heat do is followed."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from tcdyn.partition.analyse import Partition
from tcdyn.partition.cooling import with_slowing_air_offset
from tcdyn.partition.events import EhlTest
from tcdyn.partition.window import disk_window
from tcdyn.rig.contact import relative_speed
from tcdyn.rig.disk import CHANNELS, DISKS
from tcdyn.simulate.truth import CLEAN, draw_truth
from tests.partition.after_parting_study import DEFAULT, WORLDS
from tests.partition.coverage_study import told_of
from tests.partition.study_rigs import QUICK, StudyRig, study_rig

N = 0.667
TOLERANCE_K = 0.05  # rim and mesh against the whole disk 0.03 K, and what the film's spread over the surface leaves
EDGE_K = (
    0.05  # a touch's ends are known to a third of a sample, in which junction e rises by as much
)


@lru_cache
def clean_rig(world: str) -> StudyRig:
    """A rig as stated, its exponent too, with no noise: what differs from the model is the model's."""
    truth = draw_truth(11, exponent=N).with_imperfections(CLEAN)
    return study_rig(11, truth=truth, options=replace(QUICK, **WORLDS[world]))


def missed_K(made: StudyRig, test: EhlTest, disk: str) -> np.ndarray:
    """Predicted less true outer row, both true temperatures of the inner row and true share and h given, less the same
    before the parting; (R, 3) over the ten seconds after it."""
    true = made.told["traces"][[f"{disk}_{c}_degC" for c in CHANNELS]].to_numpy()
    off, traces = test.events.unload_s, test.disks[disk]
    rows = slice(int(75 * (off - 60)), int(75 * (off + 10)))
    perfect = replace(
        traces, readings_degC=true, inner_offset_K=np.zeros_like(traces.inner_offset_K)
    )
    window = disk_window(test, perfect, true[rows], rows, traces.noise_K)
    share = made.told["beta"] if disk == "fast" else 1 - made.told["beta"]
    rest, power = window.rim.response(made.told[f"h_{disk}"])
    wrong = rest + share * power - window.y
    after = (window.block_time_s > off + 0.1) & (window.block_time_s < off + 10)
    return np.asarray(wrong[after] - wrong[window.block_time_s < off - 0.5].mean(axis=0))


@pytest.mark.study
@pytest.mark.parametrize(
    "world", ["brake 3 s", "brake 20 s", "again 0.1 s", "again 0.4 s", "both", "neither"]
)
@pytest.mark.parametrize("disk", DISKS)
def test_with_the_true_share_and_h_the_model_follows_the_whole_disk(world: str, disk: str) -> None:
    made = clean_rig(world)
    share, h = made.told["beta"], {d: made.told[f"h_{d}"] for d in DISKS}
    test = with_slowing_air_offset(
        made.test, {"fast": (share, h["fast"]), "slow": (1 - share, h["slow"])}
    )
    assert np.abs(missed_K(made, test, disk)).max() < TOLERANCE_K + EDGE_K * bool(
        made.test.events.later_contacts
    )
    if world == "brake 3 s":  # and it has to: a film that stayed would leave ten times as much
        assert np.abs(missed_K(made, made.test, disk)).max() > 10 * TOLERANCE_K


@pytest.mark.study
def test_disks_that_keep_their_speed_have_no_film_to_follow() -> None:
    made = study_rig(12)
    assert made.test.relative_speed == {}
    assert with_slowing_air_offset(made.test, {}) is made.test


def test_what_was_measured_of_a_disk_that_keeps_its_speed_stays() -> None:
    made = clean_rig("brake 3 s")
    warmer = np.column_stack([np.full(len(made.test.time_s), 7.0), np.zeros(len(made.test.time_s))])
    kept = {d: course for d, course in made.test.relative_speed.items() if d == "fast"}
    test = with_slowing_air_offset(
        replace(made.test, relative_speed=kept, surface_air_offset_K={"slow": warmer}),
        {"fast": (0.7, 700.0)},
    )
    np.testing.assert_array_equal(test.surface_air_offset_K["slow"], warmer)
    assert np.abs(test.surface_air_offset_K["fast"][:, 0]).max() > 1.0


@pytest.mark.study
def test_a_speed_that_does_not_change_changes_no_answer() -> None:
    """The film's input is there, and zero: the same answers, but for rounding."""
    made = study_rig(12)
    unchanged = replace(
        made.test, relative_speed={d: np.ones_like(made.test.time_s) for d in DISKS}
    )
    one, other = made.analyse(), replace(made, test=unchanged).analyse()
    for way, answer in one.estimates.items():
        # the joint fits run twice, and a search ends within 1e-7 of chi-squared: 3e-4 of an uncertainty
        assert other.estimates[way].value == pytest.approx(answer.value, abs=1e-3 * answer.u)
        assert other.estimates[way].u == pytest.approx(answer.u, rel=1e-3)


@pytest.fixture(scope="module")
def braked_and_touched() -> tuple[StudyRig, Partition]:
    made = study_rig(5200, options=replace(QUICK, **WORLDS["both"]))
    return made, made.analyse()


def held(told: dict[str, float]) -> None:
    """Beyond 2.5 u come 1.2 % of sound answers."""
    assert max(abs(told[f"z {what}"]) for what in ("both", "lag fast", "lag slow")) < 2.5
    assert abs(told["error both"]) < 0.0125  # 2.5 times the 0.005 that such a rig states
    assert not told["alarm"]


@pytest.mark.study
def test_braked_disks_that_touch_again_give_lags_and_share(
    braked_and_touched: tuple[StudyRig, Partition],
) -> None:
    held(told_of(*braked_and_touched))


@pytest.mark.study
@pytest.mark.parametrize("world", DEFAULT)
def test_each_of_what_comes_after_the_parting_gives_lags_and_share(world: str) -> None:
    made = study_rig(5200, options=replace(QUICK, **WORLDS[world]))
    held(told_of(made, made.analyse()))


def test_braking_and_touches_are_told_as_notes_and_the_exponent_is_in_the_budget(
    braked_and_touched: tuple[StudyRig, Partition],
) -> None:
    p = braked_and_touched[1]
    found = {f.code: f for f in p.findings}
    assert {found[code].severity.value for code in ("speeds.change", "contact.again")} == {"info"}
    assert found["speeds.change"].numbers["percent"] == pytest.approx(
        100 / np.e, abs=1
    )  # after 3 s
    assert found["contact.again"].numbers["count"] == 2
    assert found["contact.again"].numbers["length_s"] == pytest.approx(
        0.3, abs=8 / 75
    )  # two samples at each end
    assert "film exponent" in {row.source for row in p.budget.rows}


T = np.arange(0.0, 100.0, 1 / 75)
SPEED = 3000.0 * np.exp(-np.clip(T - 60.0, 0, None) / 3.0)


def test_a_noisy_speed_with_dropouts_is_followed() -> None:
    rng = np.random.default_rng(0)
    logged = SPEED + rng.normal(0, 20, len(T))
    logged[4575:4650] = 0.0  # a second of nothing
    logged[[4700, 4701, 4800]] = np.nan
    course = relative_speed(T, logged, 60.0, 3000.0)
    assert course is not None
    assert (course[T < 60.0] == 1).all()
    near = (T > 60) & (T < 70)
    # 20 rpm through a parabola of 75 samples leaves 2/3 % at its ends, 0.4 % within; a second bridged by a straight
    # line across an exponential of 3 s misses it by (1/3)^2 / 8 = 1.4 % of itself
    assert np.abs(course - SPEED / 3000.0)[near].max() < 0.025
    behind = (T > 64.5) & (T < 90)  # of the noise, 2/3 %, what such a parabola leaves
    assert (course - SPEED / 3000.0)[behind].std() < 0.002


def test_a_change_below_two_per_cent_is_none() -> None:
    course = relative_speed(T, 3000.0 * np.where(T > 60, 0.985, 1.0), 60.0, 3000.0)
    assert course is not None
    assert (course == 1).all()


def test_a_speed_that_is_missing_after_the_parting_is_taken_as_unchanged_and_said() -> None:
    assert relative_speed(T, np.where(T > 60, np.nan, 3000.0), 60.0, 3000.0) is None
    gone = study_rig(
        12,
        disturbed=lambda f: f.assign(speed_slow_rpm=f["speed_slow_rpm"].where(f["time_s"] < 320.0)),
    )
    assert "speeds.missing" in {f.code for f in gone.test.findings}
    assert gone.test.relative_speed == {}


@pytest.mark.study
def test_an_inverted_switch_gives_the_answers_of_the_right_one() -> None:
    right = study_rig(12).test
    wrong = study_rig(12, disturbed=lambda f: f.assign(contact=1 - f["contact"])).test
    assert wrong.events.unload_s == right.events.unload_s
    np.testing.assert_array_equal(wrong.power_W, right.power_W)
    assert {f.code for f in wrong.findings} - {f.code for f in right.findings} == {
        "contact.inverted"
    }
