"""A specified press fit: predicted harmonics against the full-disk solver, and its use as a prior
in the fits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Severity
from tcdyn.partition.analyse import Partition
from tcdyn.partition.angular_harmonic import (
    HARMONIC_PRIOR_K,
    HARMONIC_PRIOR_REL,
    SECOND_HARMONIC_REL,
    UNKNOWN_HARMONIC,
    AngularHarmonic,
    harmonic_at_junctions,
    harmonic_K,
)
from tcdyn.partition.press_fit import (
    MODEL_REL,
    PressFitHarmonics,
    bore_flux_W_m2,
    bore_flux_with_u,
    predict_harmonics,
    press_fit_priors,
    shaft_admittance,
)
from tcdyn.rig.disk import CHANNELS
from tcdyn.rig.rigfile import Rig, load_rig, parse_rig
from tcdyn.simulate.harmonics import harmonic_system, unevenness_effects
from tcdyn.simulate.implicit import steady_state
from tcdyn.simulate.mesh import DiskMesh, grid_of
from tcdyn.simulate.truth import draw_truth
from tests.partition.study_rigs import StudyRig, study_rig

SEED = 3005
POWER_W = 80.0
H = 280.0


def rig_with_press_fit(turned_deg: float = 0.0, roughness_um: float = 10.0) -> Rig:
    """Slow disk with a keyway and a patch of poor contact beside it, rotated by ``turned_deg``."""
    from_deg, to_deg = ((x + turned_deg) % 360 for x in (90.0, 200.0))
    fit = {
        "interference_um": 20.0,
        "roughness_um": roughness_um,
        "keyways": [{"angle_deg": (40.0 + turned_deg) % 360, "width_mm": 8.0, "share": 0.05}],
        "patches": [{"from_deg": from_deg, "to_deg": to_deg, "share": 0.15}],
    }
    return parse_rig({"slow": {"fit": fit}}, "rig.toml")


@pytest.mark.parametrize("roughness_um", [1.0, 10.0, 30.0])
def test_predicted_harmonics_match_the_full_disk_solver(roughness_um: float) -> None:
    """Conductances of 6.4, 0.64 and 0.21 kW/m2K.

    Tolerances: 0.3 of the amplitude, the model uncertainty; 5 degrees; both harmonics have the
    correct sign at the junctions.
    """
    mesh = DiskMesh(radial=48, axial=30, shaft_side=16)
    disk = draw_truth(SEED, rig_with_press_fit(0.0, roughness_um)).slow
    disk = replace(disk, bearing_offset_K=(0.0, 0.0))
    system = harmonic_system(disk, H, 1.62e-3, mesh)
    state = steady_state(system, POWER_W, 0.0)
    grid = grid_of(disk, mesh)
    expected = unevenness_effects(disk, system.sample @ state)
    axisymmetric_degC = state[: grid.cells.size].reshape(grid.cells.shape).mean(axis=1)
    setup = disk.setup
    inner_K = float(
        np.interp(setup.outer_radius_m - setup.junctions["b"].depth_m, grid.r, axisymmetric_degC)
    )
    predicted = predict_harmonics(setup, H).scaled(
        1e-3 * bore_flux_W_m2(setup, POWER_W, H, inner_K)
    )
    assert np.hypot(*predicted.first_K) == pytest.approx(expected["amplitude_K"], rel=0.3)
    angle_error_deg = (
        np.rad2deg(np.arctan2(predicted.first_K[1], predicted.first_K[0])) - expected["angle_deg"]
    )
    assert abs((angle_error_deg + 180) % 360 - 180) < 5.0
    for key, level, n in (("first_K", predicted.first_K, 1), ("second_K", predicted.second_K, 2)):
        true = np.array([expected[key][c] for c in CHANNELS])
        np.testing.assert_allclose(
            level @ harmonic_at_junctions(setup, H, CHANNELS, n),
            true,
            atol=0.3 * np.abs(true).max(),
        )


def test_shaft_admittance_approaches_the_two_dimensional_limit() -> None:
    """A wave along a full solid shaft has admittance K n/R; a wave on a shorter part has more."""
    setup = load_rig().disk_setup("slow")
    wide = replace(setup, width_m=1.0)
    for n in (1, 2):
        limit = setup.conductivity_W_mK * n / setup.bore_radius_m
        assert shaft_admittance(wide, n) == pytest.approx(limit, rel=0.03)
        assert shaft_admittance(setup, n) > 1.5 * limit


def study_of_rotated_fit(turned_deg: float) -> tuple[StudyRig, Partition]:
    """Study of a rig whose rig file specifies the press fit rotated by ``turned_deg``, and its
    analysis."""
    truth = draw_truth(SEED, rig_with_press_fit(), uncertain=True)
    study = study_rig(SEED, truth=truth, rig=rig_with_press_fit(turned_deg))
    return study, study.analyse()


def level_error_K(study: StudyRig, harmonic: AngularHarmonic) -> np.ndarray:
    expected = study.true_values["unevenness"]["slow"]
    angle = np.deg2rad(expected["angle_deg"])
    return harmonic.level_K - expected["amplitude_K"] * np.array([np.cos(angle), np.sin(angle)])


@pytest.mark.long
@pytest.mark.study
def test_correct_press_fit_serves_as_prior() -> None:
    """First harmonic within its 99 % region; second within two standard uncertainties of what is
    subtracted."""
    study, p = study_of_rotated_fit(0.0)
    harmonic = p.combined.harmonics["slow"]
    assert np.hypot(*harmonic.nominal_K) > 0.3
    assert harmonic.level_z(level_error_K(study, harmonic)) < 3.04
    assert "fit.contradicted" not in {f.code for f in p.findings}
    assert p.combined.estimates["beta"].value == pytest.approx(study.true_values["beta"], abs=0.01)
    for estimator, estimate in p.beta_by_estimator.items():
        assert abs(estimate.value - study.true_values["beta"]) < 3 * estimate.u, estimator
    second = harmonic.nominal_second_K @ harmonic_at_junctions(
        p.test.disks["slow"].setup, harmonic.h_W_m2K, CHANNELS, 2
    )
    true = np.array([study.true_values["unevenness"]["slow"]["second_K"][c] for c in CHANNELS])
    assert np.abs(true).max() > 0.3
    assert np.abs(second - true).max() < 2 * harmonic.second_harmonic_u_K
    assert {r.source: r.u_beta_steady for r in p.budget.rows}[
        "second harmonic round the bore"
    ] > 1e-3
    subtracted_harmonic = p.test.harmonics["slow"]
    disk = study.test.disks["slow"]
    since_s = study.test.time_s - study.test.events.unload_s - disk.common_lag_s
    subtracted = harmonic_K(subtracted_harmonic, disk.setup, since_s)
    np.testing.assert_allclose(
        p.test.disks["slow"].readings_degC + subtracted, disk.readings_degC, atol=1e-9
    )


@pytest.mark.study
def test_bore_flux_prior_is_half_its_u_if_the_surface_takes_all_heat() -> None:
    study = study_rig(
        SEED, truth=draw_truth(SEED, rig_with_press_fit(), uncertain=True), rig=rig_with_press_fit()
    )
    test = study.test
    events = study.test.events
    u_rel = 0.02
    h = {"fast": 3000.0, "slow": 1500.0}
    estimates = {f"h_{d}": Estimate.normal(value, 1.0) for d, value in h.items()}
    estimates["beta"] = Estimate.normal(0.7, u_rel)
    uninformed = replace(
        UNKNOWN_HARMONIC, covariance=1e4 * np.eye(len(UNKNOWN_HARMONIC.estimate)), h_W_m2K=h["slow"]
    )
    prior = press_fit_priors(test, estimates, {"fast": UNKNOWN_HARMONIC, "slow": uninformed})[0][
        "slow"
    ]
    steady = (test.time_s > events.unload_s - 20) & (test.time_s < events.unload_s - 1)
    power = float(test.power_W[steady].mean())
    disk = test.disks["slow"]
    power_u = power * float(np.hypot(u_rel, 0.3 * disk.uncertainty.friction_rel))
    inner_K = (
        disk.readings_degC[steady][:, disk.setup.channel_indices(disk.setup.inner)]
        - test.ambient_of("slow")[steady, None]
    )
    flux, u = bore_flux_with_u(
        disk, (0.3 * power, power_u), (h["slow"], 1.0), float(np.nanmean(inner_K))
    )
    assert flux < 0.4 * u
    assert prior.nominal_K == pytest.approx(
        predict_harmonics(disk.setup, h["slow"]).first_K * 0.5 * u / 1e3, rel=1e-6
    )


@pytest.mark.parametrize("size", [0.5, 50.0])
def test_prior_scales_with_the_flux_that_an_exact_or_an_uninformed_fit_observes(
    size: float,
) -> None:
    """The fit observes 0.6 of the first harmonic, exactly or with no information.

    The heat flux is known to 40 %, the model to its stated uncertainty.
    """
    predicted = PressFitHarmonics(size * np.array([0.6, 0.8]), np.array([0.0, 3.0]), 20.0)
    flux_rel = 0.4
    level_rel = 0.05
    rel = float(np.hypot(flux_rel, MODEL_REL))
    for sd, other_rel, scale, second_rel in (
        (1e-9, 0.0, 0.6, MODEL_REL),
        (1e9, level_rel, 1.0, np.hypot(rel, MODEL_REL)),
    ):
        fitted = AngularHarmonic(
            estimate=np.r_[size * np.array([0.36, 0.48]) / 4, np.zeros(6)],
            covariance=sd**2 * np.eye(8),
        )
        prior = predicted.prior(other_rel, flux_rel, fitted)
        np.testing.assert_allclose(prior.nominal_second_K, [0.0, scale * 3.0], rtol=1e-9)
        assert prior.second_harmonic_u_K == pytest.approx(
            np.hypot(second_rel * scale * 3.0, SECOND_HARMONIC_REL * scale * size), rel=1e-6
        )
        other_prior_K = [
            max(HARMONIC_PRIOR_K[name], HARMONIC_PRIOR_REL[name] * size)
            for name in HARMONIC_PRIOR_K
        ]
        np.testing.assert_allclose(
            prior.prior_K, [np.hypot(other_rel * 20.0, rel * size), *other_prior_K[1:]], rtol=1e-9
        )


@pytest.mark.long
@pytest.mark.study
def test_contradicted_press_fit_is_reported_and_not_used() -> None:
    """A prior on the far side, off by 3 u or more, gives a warning; the harmonic is that without a
    press fit."""
    study, p = study_of_rotated_fit(170.0)
    warnings = [f for f in p.findings if f.code == "fit.contradicted"]
    assert [(f.subject, f.severity) for f in warnings] == [("slow", Severity.WARNING)]
    assert "[fit] is not used" in warnings[0].sentence
    harmonic = p.combined.harmonics["slow"]
    assert not harmonic.nominal_K.any()
    assert harmonic.level_z(level_error_K(study, harmonic)) < 3.04
    assert p.status == "warning"


def test_without_a_press_fit_nothing_is_subtracted() -> None:
    """The subtracted harmonic is exactly zero."""
    assert not harmonic_K(
        UNKNOWN_HARMONIC, load_rig().disk_setup("slow"), np.linspace(-50.0, 50.0, 101)
    ).any()
