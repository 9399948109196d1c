"""Disks that slow down after unloading or touch again: the model includes surface h and heat
pulses."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from tcdyn.partition.analyse import Partition
from tcdyn.partition.cooling import _slowing_air_offset, with_slowing_air_offset
from tcdyn.partition.events import EhlTest
from tcdyn.partition.window import disk_window, fit_rows
from tcdyn.rig.contact import relative_speed
from tcdyn.rig.disk import CHANNELS, DISKS
from tcdyn.simulate.truth import CLEAN, draw_truth
from tests.partition.after_parting_study import DEFAULT, WORLDS
from tests.partition.coverage_study import study_errors
from tests.partition.study_rigs import QUICK, StudyRig, study_rig

EXPONENT = 0.667
TOLERANCE_K = 0.05  # 0.03 K between rim model and full disk, the rest for h over the surface
# the ends of a contact are known to a third of a sample, in which junction e rises by this much
EDGE_K = 0.05


@lru_cache
def clean_rig(world: str) -> StudyRig:
    """A rig with nominal properties and exponent and no noise: all deviations are model errors."""
    truth = draw_truth(11, exponent=EXPONENT).with_imperfections(CLEAN)
    return study_rig(11, truth=truth, options=replace(QUICK, **WORLDS[world]))


def residual_after_unloading_K(study: StudyRig, test: EhlTest, disk: str) -> np.ndarray:
    """Predicted minus true outer row with true inner row, share and h, relative to before
    unloading.

    Shape (R, 3), over the ten seconds after unloading.
    """
    true_degC = study.true_values["traces"][[f"{disk}_{c}_degC" for c in CHANNELS]].to_numpy()
    unload_s = test.events.unload_s
    traces = test.disks[disk]
    rows = slice(int(75 * (unload_s - 60)), int(75 * (unload_s + 10)))
    true_traces = replace(
        traces, readings_degC=true_degC, inner_offset_K=np.zeros_like(traces.inner_offset_K)
    )
    window = disk_window(test, true_traces, true_degC[rows], rows, traces.noise_K)
    share = study.true_values["beta"] if disk == "fast" else 1 - study.true_values["beta"]
    base, power = window.rim.response(study.true_values[f"h_{disk}"])
    residual = base + share * power - window.y
    after = (window.block_time_s > unload_s + 0.1) & (window.block_time_s < unload_s + 10)
    return np.asarray(residual[after] - residual[window.block_time_s < unload_s - 0.5].mean(axis=0))


@pytest.mark.long
@pytest.mark.study
@pytest.mark.parametrize(
    "world",
    ["brake 3 s", "brake 20 s", "second contact 0.1 s", "second contact 0.4 s", "both", "neither"],
)
@pytest.mark.parametrize("disk", DISKS)
def test_model_follows_the_full_disk_with_the_true_share_and_h(world: str, disk: str) -> None:
    study = clean_rig(world)
    share = study.true_values["beta"]
    h = {d: study.true_values[f"h_{d}"] for d in DISKS}
    test = with_slowing_air_offset(
        study.test, {"fast": (share, h["fast"]), "slow": (1 - share, h["slow"])}
    )
    assert np.abs(
        residual_after_unloading_K(study, test, disk)
    ).max() < TOLERANCE_K + EDGE_K * bool(study.test.events.later_contacts)
    if world == "brake 3 s":  # without the change of h the residual is ten times larger
        assert np.abs(residual_after_unloading_K(study, study.test, disk)).max() > 10 * TOLERANCE_K


@pytest.mark.study
def test_constant_speed_leaves_the_test_unchanged() -> None:
    study = study_rig(12)
    assert study.test.relative_speed == {}
    assert with_slowing_air_offset(study.test, {}) is study.test


@pytest.mark.e2e
def test_measured_air_offset_of_a_disk_at_constant_speed_is_kept() -> None:
    study = clean_rig("brake 3 s")
    measured = np.column_stack(
        [np.full(len(study.test.time_s), 7.0), np.zeros(len(study.test.time_s))]
    )
    fast_speed = {
        disk: speed for disk, speed in study.test.relative_speed.items() if disk == "fast"
    }
    test = with_slowing_air_offset(
        replace(study.test, relative_speed=fast_speed, surface_air_offset_K={"slow": measured}),
        {"fast": (0.7, 700.0)},
    )
    np.testing.assert_array_equal(test.surface_air_offset_K["slow"], measured)
    assert np.abs(test.surface_air_offset_K["fast"][:, 0]).max() > 1.0


def test_change_by_the_exponent_is_that_between_two_exponents() -> None:
    study = clean_rig("brake 3 s")
    disk = study.test.disks["fast"]
    rows = fit_rows(study.test, 10.0)
    u = study.test.exponent_half_range / np.sqrt(3)

    def offset(exponent: float) -> np.ndarray:
        test = replace(study.test, speed_exponent=exponent)
        return _slowing_air_offset(test, disk, rows, 0.7, 700.0)

    exponent = study.test.speed_exponent
    by_exponent = offset(exponent)[:, 1]
    expected = 0.5 * (offset(exponent + u) - offset(exponent - u))[:, 0]
    assert np.abs(by_exponent).max() > 0.1
    np.testing.assert_allclose(by_exponent, expected, atol=0.01 * np.abs(expected).max())


def test_the_air_of_a_slow_disk_is_warmer_by_the_heat_that_it_does_not_lose() -> None:
    """A disk at rest loses nothing: the air has the temperature of its surface."""
    study = clean_rig("brake 3 s")
    disk = study.test.disks["fast"]
    speed = {"fast": np.full(len(study.test.time_s), 0.5)}
    rows = fit_rows(study.test, 10.0)
    slow = replace(study.test, relative_speed=speed)
    quarter, half = (
        _slowing_air_offset(replace(slow, speed_exponent=n), disk, rows, 0.7, 700.0)[rows, 0]
        for n in (np.log2(4 / 3), 1.0)
    )
    assert half.min() > 1.0
    np.testing.assert_allclose(half, 2 * quarter, rtol=1e-9)


@pytest.mark.long
@pytest.mark.study
def test_unit_relative_speed_does_not_change_the_estimates() -> None:
    """The input of the surface h exists and is zero: the estimates agree except for rounding."""
    study = study_rig(12)
    unchanged = replace(
        study.test, relative_speed={d: np.ones_like(study.test.time_s) for d in DISKS}
    )
    reference = study.analyse()
    result = replace(study, test=unchanged).analyse()
    for estimator, estimate in reference.estimates.items():
        # the joint fits run twice, and a search stops within 1e-7 of chi-squared: 3e-4 of an
        # uncertainty
        assert result.estimates[estimator].value == pytest.approx(
            estimate.value, abs=1e-3 * estimate.u
        )
        assert result.estimates[estimator].u == pytest.approx(estimate.u, rel=1e-3)


@pytest.fixture(scope="module")
def braked_with_second_contact() -> tuple[StudyRig, Partition]:
    study = study_rig(5200, options=replace(QUICK, **WORLDS["both"]))
    return study, study.analyse()


def assert_estimates_within_tolerance(errors: dict[str, float]) -> None:
    """A correct estimate exceeds 2.5 u with a probability of 1.2 %."""
    assert max(abs(errors[f"z {name}"]) for name in ("both", "lag fast", "lag slow")) < 2.5
    assert abs(errors["error both"]) < 0.0125  # 2.5 times the u of such a rig, 0.005
    assert not errors["alarm"]


@pytest.mark.long
@pytest.mark.study
def test_braked_disks_with_second_contact_give_correct_lags_and_beta(
    braked_with_second_contact: tuple[StudyRig, Partition],
) -> None:
    assert_estimates_within_tolerance(study_errors(*braked_with_second_contact))


@pytest.mark.long
@pytest.mark.study
@pytest.mark.parametrize(
    "world", [DEFAULT[0], *(pytest.param(name, marks=pytest.mark.long) for name in DEFAULT[1:])]
)
def test_each_event_after_unloading_gives_correct_lags_and_beta(world: str) -> None:
    study = study_rig(5200, options=replace(QUICK, **WORLDS[world]))
    assert_estimates_within_tolerance(study_errors(study, study.analyse()))


@pytest.mark.long
def test_braking_and_second_contact_are_reported_and_exponent_is_in_the_budget(
    braked_with_second_contact: tuple[StudyRig, Partition],
) -> None:
    analysis = braked_with_second_contact[1]
    findings = {f.code: f for f in analysis.findings}
    assert {findings[code].severity.value for code in ("speeds.change", "contact.again")} == {
        "info"
    }
    # three seconds after unloading
    assert findings["speeds.change"].numbers["percent"] == pytest.approx(100 / np.e, abs=1)
    assert findings["contact.again"].numbers["count"] == 2
    # tolerance: two samples at each end of both contacts
    assert findings["contact.again"].numbers["length_s"] == pytest.approx(0.3, abs=8 / 75)
    assert "film exponent" in {row.source for row in analysis.budget.rows}


TIME_S = np.arange(0.0, 100.0, 1 / 75)
SPEED_RPM = 3000.0 * np.exp(-np.clip(TIME_S - 60.0, 0, None) / 3.0)


def test_noisy_speed_with_dropouts_is_followed() -> None:
    rng = np.random.default_rng(0)
    logged = SPEED_RPM + rng.normal(0, 20, len(TIME_S))
    logged[4575:4650] = 0.0  # a dropout of one second
    logged[[4700, 4701, 4800]] = np.nan
    result = relative_speed(TIME_S, logged, 60.0, 3000.0)
    assert result is not None
    assert (result[TIME_S < 60.0] == 1).all()
    after_unloading = (TIME_S > 60) & (TIME_S < 70)
    # 20 rpm through a parabola of 75 samples leave 2/3 % at its ends, 0.4 % within. A second
    # bridged by a straight line misses an exponential of 3 s by (1/3)^2 / 8 = 1.4 %
    assert np.abs(result - SPEED_RPM / 3000.0)[after_unloading].max() < 0.025
    after_dropouts = (TIME_S > 64.5) & (TIME_S < 90)  # noise of 2/3 %, reduced by the parabola
    assert (result - SPEED_RPM / 3000.0)[after_dropouts].std() < 0.002


def test_speed_change_below_two_percent_is_ignored() -> None:
    result = relative_speed(TIME_S, 3000.0 * np.where(TIME_S > 60, 0.985, 1.0), 60.0, 3000.0)
    assert result is not None
    assert (result == 1).all()


def test_missing_speed_after_unloading_is_taken_as_constant_and_reported() -> None:
    assert relative_speed(TIME_S, np.where(TIME_S > 60, np.nan, 3000.0), 60.0, 3000.0) is None
    study = study_rig(
        12,
        log_change=lambda frame: frame.assign(
            speed_slow_rpm=frame["speed_slow_rpm"].where(frame["time_s"] < 320.0)
        ),
    )
    assert "speeds.missing" in {finding.code for finding in study.test.findings}
    assert study.test.relative_speed == {}


@pytest.mark.study
def test_inverted_switch_gives_the_events_and_power_of_the_correct_one() -> None:
    reference = study_rig(12).test
    inverted = study_rig(12, log_change=lambda f: f.assign(contact=1 - f["contact"])).test
    assert inverted.events.unload_s == reference.events.unload_s
    np.testing.assert_array_equal(inverted.power_W, reference.power_W)
    assert {f.code for f in inverted.findings} - {f.code for f in reference.findings} == {
        "contact.inverted"
    }
