"""A stated press fit: what it makes of a disk against the whole-disk solver, and what it does in the fits."""

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

SEED, POWER_W, H = 3005, 80.0, 280.0


def stating(turned_deg: float = 0.0, roughness_um: float = 10.0) -> Rig:
    """A slow disk with a keyway and a poor patch beside it."""
    from_deg, to_deg = ((x + turned_deg) % 360 for x in (90.0, 200.0))
    fit = {
        "interference_um": 20.0,
        "roughness_um": roughness_um,
        "keyways": [{"angle_deg": (40.0 + turned_deg) % 360, "width_mm": 8.0, "share": 0.05}],
        "patches": [{"from_deg": from_deg, "to_deg": to_deg, "share": 0.15}],
    }
    return parse_rig({"slow": {"fit": fit}}, "rig.toml")


@pytest.mark.parametrize("roughness_um", [1.0, 10.0, 30.0])
def test_predicted_harmonics_are_those_of_the_whole_disk(roughness_um: float) -> None:
    """Conductances of 6.4, 0.64 and 0.21 kW/m2K: sizes to 0.3 of them, the model's stated uncertainty; angle to 5
    degrees; both harmonics at the junctions with the right sign."""
    mesh, disk = (
        DiskMesh(radial=48, axial=30, shaft_side=16),
        draw_truth(SEED, stating(0.0, roughness_um)).slow,
    )
    disk = replace(disk, bearing_offset_K=(0.0, 0.0))
    system = harmonic_system(disk, H, 1.62e-3, mesh)
    state, grid = steady_state(system, POWER_W, 0.0), grid_of(disk, mesh)
    told = unevenness_effects(disk, system.sample @ state)
    even = state[: grid.cells.size].reshape(grid.cells.shape).mean(axis=1)
    setup = disk.setup
    inner_K = float(np.interp(setup.outer_radius_m - setup.junctions["b"].depth_m, grid.r, even))
    found = predict_harmonics(setup, H).scaled(1e-3 * bore_flux_W_m2(setup, POWER_W, H, inner_K))
    assert np.hypot(*found.first_K) == pytest.approx(told["amplitude_K"], rel=0.3)
    off = np.rad2deg(np.arctan2(found.first_K[1], found.first_K[0])) - told["angle_deg"]
    assert abs((off + 180) % 360 - 180) < 5.0
    for key, level, n in (("first_K", found.first_K, 1), ("second_K", found.second_K, 2)):
        true = np.array([told[key][c] for c in CHANNELS])
        np.testing.assert_allclose(
            level @ harmonic_at_junctions(setup, H, CHANNELS, n),
            true,
            atol=0.3 * np.abs(true).max(),
        )


def test_heat_spreads_along_the_shaft() -> None:
    """A wave heated along all of a solid shaft would meet K n/R; over a part of it less of a hindrance, so more."""
    setup = load_rig().disk_setup("slow")
    along = replace(setup, width_m=1.0)
    for n in (1, 2):
        endless = setup.conductivity_W_mK * n / setup.bore_radius_m
        assert shaft_admittance(along, n) == pytest.approx(endless, rel=0.03)
        assert shaft_admittance(setup, n) > 1.5 * endless


def analysed(turned_deg: float) -> tuple[StudyRig, Partition]:
    """The rig with its fit as it is, by a rig file that states it so much further round."""
    true = draw_truth(SEED, stating(), uncertain=True)
    made = study_rig(SEED, truth=true, rig=stating(turned_deg))
    return made, made.analyse()


def off_K(made: StudyRig, found: AngularHarmonic) -> np.ndarray:
    told = made.told["unevenness"]["slow"]
    at = np.deg2rad(told["angle_deg"])
    return found.level_K - told["amplitude_K"] * np.array([np.cos(at), np.sin(at)])


@pytest.mark.study
def test_a_fit_stated_as_it_is_serves_as_the_prior() -> None:
    """The harmonic within its 99 % region, the second within two standard uncertainties of what was subtracted."""
    made, p = analysed(0.0)
    found = p.both.harmonics["slow"]
    assert np.hypot(*found.nominal_K) > 0.3
    assert found.level_z(off_K(made, found)) < 3.04
    assert "fit.contradicted" not in {f.code for f in p.findings}
    assert p.both.estimates["beta"].value == pytest.approx(made.told["beta"], abs=0.01)
    for way, estimate in p.beta_by_estimator.items():
        assert abs(estimate.value - made.told["beta"]) < 3 * estimate.u, way
    second = found.nominal_second_K @ harmonic_at_junctions(
        p.test.disks["slow"].setup, found.h_W_m2K, CHANNELS, 2
    )
    true = np.array([made.told["unevenness"]["slow"]["second_K"][c] for c in CHANNELS])
    assert np.abs(true).max() > 0.3
    assert np.abs(second - true).max() < 2 * found.second_harmonic_u_K
    assert {r.source: r.u_beta_steady for r in p.budget.rows}[
        "second harmonic round the bore"
    ] > 1e-3
    known, disk = p.test.harmonics["slow"], made.test.disks["slow"]
    since_s = made.test.time_s - made.test.events.unload_s - disk.common_lag_s
    taken = harmonic_K(known, disk.setup, since_s)
    np.testing.assert_allclose(
        p.test.disks["slow"].readings_degC + taken, disk.readings_degC, atol=1e-9
    )


@pytest.mark.study
def test_where_the_film_takes_all_the_heat_half_an_uncertainty_of_it_goes_through_the_bore() -> (
    None
):
    made = study_rig(SEED, truth=draw_truth(SEED, stating(), uncertain=True), rig=stating())
    test, events = made.test, made.test.events
    u_rel, h = 0.02, {"fast": 3000.0, "slow": 1500.0}
    told = {f"h_{d}": Estimate.normal(value, 1.0) for d, value in h.items()}
    told["beta"] = Estimate.normal(0.7, u_rel)
    wide = replace(
        UNKNOWN_HARMONIC, covariance=1e4 * np.eye(len(UNKNOWN_HARMONIC.estimate)), h_W_m2K=h["slow"]
    )
    prior = press_fit_priors(test, told, {"fast": UNKNOWN_HARMONIC, "slow": wide})[0]["slow"]
    near = (test.time_s > events.unload_s - 20) & (test.time_s < events.unload_s - 1)
    power = float(test.power_W[near].mean())
    disk = test.disks["slow"]
    power_u = power * float(np.hypot(u_rel, 0.3 * disk.uncertainty.friction_rel))
    inner = (
        disk.readings_degC[near][:, disk.setup.channel_indices(disk.setup.inner)]
        - test.ambient_of("slow")[near, None]
    )
    flux, u = bore_flux_with_u(
        disk, (0.3 * power, power_u), (h["slow"], 1.0), float(np.nanmean(inner))
    )
    assert flux < 0.4 * u
    assert prior.nominal_K == pytest.approx(
        predict_harmonics(disk.setup, h["slow"]).first_K * 0.5 * u / 1e3, rel=1e-6
    )


@pytest.mark.parametrize("size", [0.5, 50.0])
def test_a_stated_harmonic_is_the_prior_with_as_much_heat_as_a_sharp_fit_sees_and_a_blind_one_leaves(
    size: float,
) -> None:
    """A fit that sees 0.6 of the first harmonic, to nothing or not at all, the heat known to 40 % and the model's."""
    told, flux_rel, uneven_rel = (
        PressFitHarmonics(size * np.array([0.6, 0.8]), np.array([0.0, 3.0]), 20.0),
        0.4,
        0.05,
    )
    rel = float(np.hypot(flux_rel, MODEL_REL))
    for sd, others, scale, second_rel in (
        (1e-9, 0.0, 0.6, MODEL_REL),
        (1e9, uneven_rel, 1.0, np.hypot(rel, MODEL_REL)),
    ):
        found = AngularHarmonic(
            estimate=np.r_[size * np.array([0.36, 0.48]) / 4, np.zeros(6)],
            covariance=sd**2 * np.eye(8),
        )
        prior = told.prior(others, flux_rel, found)
        np.testing.assert_allclose(prior.nominal_second_K, [0.0, scale * 3.0], rtol=1e-9)
        assert prior.second_harmonic_u_K == pytest.approx(
            np.hypot(second_rel * scale * 3.0, SECOND_HARMONIC_REL * scale * size), rel=1e-6
        )
        least = [
            max(HARMONIC_PRIOR_K[name], HARMONIC_PRIOR_REL[name] * size)
            for name in HARMONIC_PRIOR_K
        ]
        np.testing.assert_allclose(
            prior.prior_K, [np.hypot(others * 20.0, rel * size), *least[1:]], rtol=1e-9
        )


@pytest.mark.study
def test_a_fit_stated_elsewhere_is_told_and_not_used() -> None:
    """A prior on the far side, at 3 u of the data and more, says so; the disk is found as without a statement."""
    made, p = analysed(170.0)
    told = [f for f in p.findings if f.code == "fit.contradicted"]
    assert [(f.subject, f.severity) for f in told] == [("slow", Severity.WARNING)]
    assert "[fit] is not used" in told[0].sentence
    found = p.both.harmonics["slow"]
    assert not found.nominal_K.any()
    assert found.level_z(off_K(made, found)) < 3.04
    assert p.status == "warning"


def test_without_a_statement_nothing_is_subtracted() -> None:
    """To the last bit."""
    assert not harmonic_K(
        UNKNOWN_HARMONIC, load_rig().disk_setup("slow"), np.linspace(-50.0, 50.0, 101)
    ).any()
