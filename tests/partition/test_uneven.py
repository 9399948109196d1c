"""Uneven bore contact: shape of the harmonic in the rim, its estimation and its subtraction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tcdyn.core.findings import Severity
from tcdyn.partition.analyse import Partition
from tcdyn.partition.angular_harmonic import (
    FIRST_HARMONIC,
    HARMONIC_SOURCES,
    SECOND_HARMONIC_REL,
    UNKNOWN_HARMONIC,
    AngularHarmonic,
    add_harmonic_effects,
    harmonic_at_junctions,
    harmonic_effect,
    harmonic_K,
    radial_shape,
)
from tcdyn.partition.beta_file import beta_file
from tcdyn.partition.joint import joint_fits
from tcdyn.report.beta import unevenness_section
from tcdyn.rig.disk import CHANNELS, DISKS, DiskSetup
from tcdyn.rig.rigfile import load_rig
from tcdyn.simulate.truth import BoreContact, draw_truth
from tests.partition.study_rigs import StudyRig, study_rig

SETUP = load_rig().disk_setup("slow")


@pytest.mark.parametrize("n", [1, 2])
@pytest.mark.parametrize("h", [0.0, 280.0, 720.0])
@pytest.mark.parametrize("washer", [0.0, 1.46])
def test_harmonic_satisfies_its_equation_and_surface_condition(
    n: int, h: float, washer: float
) -> None:
    """Central differences of 10 um: the residual of T'' is below 1e-4 of its terms, second order in
    the step."""
    setup = replace(SETUP, washer_conductivity_W_mK=washer)
    k = setup.conductivity_W_mK
    step = 1e-5
    depth = np.array([0.001, 0.003, 0.006])
    up, at, down = (radial_shape(setup, h, depth + d, n) for d in (-step, 0.0, step))
    r = setup.outer_radius_m - depth
    kappa2 = 2 * washer / setup.washer_thickness_m / (k * setup.width_m)
    kappa2 = max(kappa2, (1e-2 / setup.outer_radius_m) ** 2)  # lower bound of the functions
    residual = (
        (up - 2 * at + down) / step**2 + (up - down) / (2 * step * r) - (n**2 / r**2 + kappa2) * at
    )
    assert np.abs(residual).max() < 1e-4 * (n**2 / r**2).max()
    t0, t1, t2 = radial_shape(setup, h, step * np.arange(3.0), n)
    slope = -(-1.5 * t0 + 2 * t1 - 0.5 * t2) / step  # derivative by r, one-sided, second order
    assert k * slope == pytest.approx(-h * t0, abs=1e-3 * k / setup.outer_radius_m)
    # normalised at the depth of b
    assert radial_shape(setup, h, np.array(0.006), n) == pytest.approx(1.0)


@pytest.mark.long
@pytest.mark.study
def test_second_harmonic_relative_to_the_first_is_that_of_simulated_disks() -> None:
    """Contacts of 0.3 to 0.9 of the mean conductance; the largest junction of each disk."""
    ratios = []
    for seed, (amplitude, angle_deg) in enumerate(
        ((0.3, 40.0), (0.6, 40.0), (0.9, 100.0), (0.6, 200.0))
    ):
        contact = BoreContact(amplitude, angle_deg)
        truth = draw_truth(2 + seed).with_uneven({"fast": contact, "slow": contact})
        true_values = study_rig(2 + seed, truth=truth, uncertain=False).true_values
        for unevenness in true_values["unevenness"].values():
            largest_K = max(abs(value) for value in unevenness["second_K"].values())
            ratios.append(largest_K / unevenness["amplitude_K"])
    rms = float(np.sqrt(np.mean(np.square(ratios))))
    assert rms == pytest.approx(SECOND_HARMONIC_REL, rel=0.4)


@pytest.mark.long
@pytest.mark.study
def test_harmonic_at_junctions_matches_the_simulated_disk() -> None:
    """Amplitude at the depth of b times shape and cosine, against the first harmonic of the
    synthetic rig: 1 %.

    The rim model is thin across its width and steady.
    """
    truth = draw_truth(2).with_uneven({"slow": BoreContact(0.6, 40.0)})
    true_values = study_rig(2, truth=truth, uncertain=False).true_values
    unevenness = true_values["unevenness"]["slow"]
    vector = unevenness["amplitude_K"] * np.array(
        [np.cos(np.deg2rad(unevenness["angle_deg"])), np.sin(np.deg2rad(unevenness["angle_deg"]))]
    )
    model = vector @ harmonic_at_junctions(truth.slow.setup, true_values["h_slow"], CHANNELS)
    np.testing.assert_allclose(
        model, [unevenness["first_K"][c] for c in CHANNELS], atol=0.01 * unevenness["amplitude_K"]
    )


def with_angles(setup: DiskSetup, angle_deg: float) -> DiskSetup:
    return replace(
        setup, junctions={c: replace(j, angle_deg=angle_deg) for c, j in setup.junctions.items()}
    )


def test_harmonic_of_junctions_at_one_angle_is_a_common_offset() -> None:
    """At one angle cos and sin are one pattern, nearly equal on all six junctions; nothing
    fails."""
    one_side = with_angles(SETUP, 30.0)
    static = np.full((3, 3), 1 / 3)  # d, b and f contribute equally to the outer row
    cos, sin = harmonic_effect(one_side, 280.0, static)
    np.testing.assert_allclose(cos * np.tan(np.deg2rad(30.0)), sin, atol=1e-12)
    assert np.abs(cos).max() < 0.1  # per kelvin; 1.9 for the outer junctions of two groups
    assert np.abs(harmonic_effect(SETUP, 280.0, static)).max() > 0.9


def test_amplitude_and_angle_of_a_level_are_those_of_its_vector() -> None:
    """A level of 3 and 4 K with 0.1 K in each component: 5 K at 53.13 deg, 0.1/5 rad across it."""
    size = len(FIRST_HARMONIC)
    harmonic = AngularHarmonic(
        prior_K=np.ones(4),
        estimate=np.r_[3.0, 4.0, np.zeros(size - 2)],
        covariance=0.01 * np.eye(size),
    )
    for estimate, value, u in (
        (harmonic.amplitude_K, 5.0, 0.1),
        (harmonic.hottest_angle_deg, np.rad2deg(np.arctan2(4, 3)), np.rad2deg(0.1 / 5)),
    ):
        interval = [estimate.value, estimate.u, estimate.low95, estimate.high95]
        assert interval == pytest.approx([value, u, value - 1.96 * u, value + 1.96 * u], rel=1e-4)
    assert harmonic.significance == pytest.approx(50.0)


def test_remaining_harmonic_has_the_covariance_of_the_fit() -> None:
    """A covariance of a hundredth of the prior gives effects of a tenth of those of the prior."""
    change = np.zeros((0, 2, 3))
    static = np.full((3, 3), 1 / 3)
    since_s = np.array([-1.0, 5.0])
    remaining = AngularHarmonic(covariance=0.01 * np.eye(len(FIRST_HARMONIC)))
    parameters, prior_effects = add_harmonic_effects(
        (), change, UNKNOWN_HARMONIC, SETUP, 280.0, static, since_s
    )
    _, effects = add_harmonic_effects((), change, remaining, SETUP, 280.0, static, since_s)
    assert {parameter.source for parameter in parameters} == HARMONIC_SOURCES
    assert [parameter.name for parameter in parameters if parameter.name.startswith("angle")] == [
        f"angle {c}" for c in SETUP.rows
    ]
    np.testing.assert_allclose(
        effects[-len(FIRST_HARMONIC) :], 0.1 * prior_effects[-len(FIRST_HARMONIC) :], atol=1e-15
    )


@pytest.fixture(scope="module")
def even_disks() -> tuple[StudyRig, Partition]:
    study = study_rig(3005)
    return study, study.analyse()


@pytest.fixture(scope="module")
def uneven_disks() -> tuple[StudyRig, Partition]:
    true = draw_truth(3005, uncertain=True).with_uneven(
        {"fast": BoreContact(0.9, 60.0), "slow": BoreContact(0.9, 200.0)}
    )
    study = study_rig(3005, truth=true)
    return study, study.analyse()


def vector_z(study: StudyRig, p: Partition, disk: str) -> float:
    """Error of the cosine and sine amplitudes of the level, in standard uncertainties."""
    expected = study.true_values["unevenness"][disk]
    harmonic = p.combined.harmonics[disk]
    vectors = [
        amplitude * np.array([np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))])
        for amplitude, angle in (
            (expected["amplitude_K"], expected["angle_deg"]),
            (harmonic.amplitude_K.value, harmonic.hottest_angle_deg.value),
        )
    ]
    return harmonic.level_z(vectors[1] - vectors[0])


@pytest.mark.long
@pytest.mark.study
def test_amplitude_and_angle_are_recovered_within_their_interval(
    uneven_disks: tuple[StudyRig, Partition],
) -> None:
    study, p = uneven_disks
    for d in DISKS:
        assert vector_z(study, p, d) < 3.04  # 99 % quantile of two normal deviates
        assert p.combined.harmonics[d].significance > 20  # about 3 K with u of about 0.1 K
    findings = {f.subject: f for f in p.findings if f.code == "unevenness"}
    assert set(findings) == set(DISKS)
    assert {f.severity for f in findings.values()} == {Severity.INFO}
    written = beta_file(p, {})["unevenness"]["slow"]
    assert written["amplitude_K"]["value"] == p.combined.harmonics["slow"].amplitude_K.value
    assert set(written["angle_deg"]) == {"value", "u", "low95", "high95"}


@pytest.mark.long
def test_strongly_uneven_disks_bias_no_beta_and_have_no_suspects(
    uneven_disks: tuple[StudyRig, Partition],
) -> None:
    """The joint fit of both disks within 0.01, twice its standard uncertainty; every estimator
    within 3 u."""
    study, p = uneven_disks
    assert p.combined.estimates["beta"].value == pytest.approx(study.true_values["beta"], abs=0.01)
    for estimator, estimate in p.beta_by_estimator.items():
        assert abs(estimate.value - study.true_values["beta"]) < 3 * estimate.u, estimator
    assert p.sensors is not None
    assert p.sensors.sound, p.sensors.texts
    assert p.crosscheck.agree, p.crosscheck.sentence


@pytest.mark.long
def test_fitted_harmonic_is_subtracted_from_the_readings(
    uneven_disks: tuple[StudyRig, Partition],
) -> None:
    study, p = uneven_disks
    for d in DISKS:
        harmonic = p.combined.harmonics[d]
        disk = study.test.disks[d]
        since_s = study.test.time_s - study.test.events.unload_s - disk.common_lag_s
        subtracted = harmonic_K(harmonic, disk.setup, since_s)
        np.testing.assert_allclose(
            p.test.disks[d].readings_degC + subtracted, disk.readings_degC, atol=1e-9
        )
        unloading = int(np.argmin(np.abs(since_s)))
        expected = study.true_values["unevenness"][d]["first_K"]
        # 3 u of the less certain direction
        np.testing.assert_allclose(subtracted[unloading], [expected[c] for c in CHANNELS], atol=0.6)


@pytest.mark.long
@pytest.mark.study
def test_even_disks_have_no_harmonic_and_nearly_the_same_u(
    even_disks: tuple[StudyRig, Partition],
) -> None:
    """Amplitudes consistent with zero; u of beta of both disks increases by less than 5 %."""
    study, p = even_disks
    for d in DISKS:
        assert p.combined.harmonics[d].amplitude_K.low95 == 0.0
        assert p.combined.harmonics[d].finding(d) is None
        assert vector_z(study, p, d) < 3.04
    rows = {row.source: row.u_beta_steady for row in p.budget.rows}
    assert rows["second harmonic round the bore"] < 1e-9  # rounding errors
    assert rows["uneven bore contact"] < 0.5 * rows["junction depth"]
    narrow_prior = AngularHarmonic(prior_K=np.full(4, 1e-6))
    test = replace(study.test, harmonics=dict.fromkeys(DISKS, narrow_prior))
    _, both = joint_fits(test, {"fast": (0.7, 700.0), "slow": (0.3, 280.0)})
    assert p.combined.estimates["beta"].u < 1.05 * both.estimates["beta"].u


@pytest.mark.long
def test_second_harmonic_of_an_uneven_disk_widens_the_speed_law(
    uneven_disks: tuple[StudyRig, Partition],
) -> None:
    rows = {row.source: row.u_beta_steady for row in uneven_disks[1].budget.rows}
    assert rows["second harmonic round the bore"] > 0.001


@pytest.mark.long
def test_figure_titles_give_amplitude_and_angle_or_even(
    even_disks: tuple[StudyRig, Partition], uneven_disks: tuple[StudyRig, Partition]
) -> None:
    titles = []
    for _, p in (even_disks, uneven_disks):
        section = unevenness_section(p)
        assert section.figure is not None
        titles += [ax.get_title("left") for ax in section.figure.axes[:2]]
        assert section.table is not None
        assert list(section.table["junction"]) == [*CHANNELS, *CHANNELS]
    assert [t.startswith(f"{d} disk: even within") for t, d in zip(titles, DISKS)] == [True, True]
    assert [" K at " in t for t in titles] == [False, False, True, True]
