"""Values that rig.toml specifies beyond the model of the thesis (section 8.3): a specified value
removes the bias."""

from __future__ import annotations

from dataclasses import asdict, replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from scipy import stats

from tcdyn.core import Array
from tcdyn.partition.analyse import Partition
from tcdyn.partition.events import EhlTest
from tcdyn.partition.nuisance import nuisance_effects
from tcdyn.partition.prepare import prepare_test
from tcdyn.partition.specified import (
    conductivity_slope_effect,
    linear_about,
    specific_heat_slope_effect,
)
from tcdyn.partition.steady import with_linear_steel
from tcdyn.partition.window import DiskWindow, fit_rows, lagged_window
from tcdyn.rig.rigfile import Rig, load_rig, parse_rig
from tcdyn.rig.tables import SurfaceFlux, fit_surface_flux
from tcdyn.simulate.truth import draw_truth
from tests.partition.study_rigs import StudyRig, study_rig

SEED = 7000
FLUX = {"flux_profile": "barus", "flux_shift_mm": 0.4}


def rig_with(**tables: Any) -> Rig:
    """Default rig with these tables."""
    return parse_rig(tables, "rig.toml")


def analysed_with(study: StudyRig, rig: Rig) -> Partition:
    """Analyse the log of ``study`` with the rig file ``rig``."""
    return replace(study, test=prepared_with(study, rig)).analyse()


def prepared_with(study: StudyRig, rig: Rig) -> EhlTest:
    """Prepare the log of ``study`` with the rig file ``rig``."""
    records = {d: r.model_copy(update={"setup": rig.tables(d)}) for d, r in study.records.items()}
    return prepare_test(study.log, rig, records)


@lru_cache
def baseline() -> Partition:
    """Analysis of the same rig and test with the model of the thesis."""
    return study_rig(SEED).analyse()


@pytest.mark.long
@pytest.mark.study
def test_specified_flux_profile_is_as_accurate_as_the_default() -> None:
    """Heat proportional to the viscosity of the oil, 0.4 mm off the centre, summed over the
    ellipse."""
    rig = rig_with(contact=FLUX)
    study = study_rig(SEED, rig=rig)
    specified = analysed_with(study, rig)
    ignored = analysed_with(study, load_rig())
    max_shift = [
        max(
            abs(
                p.beta_by_estimator[estimator].value - baseline().beta_by_estimator[estimator].value
            )
            for estimator in p.beta_by_estimator
        )
        for p in (specified, ignored)
    ]
    assert max_shift[0] < 0.002  # noise and rig errors are the same in both
    assert max_shift[1] > 0.01
    assert specified.status == "sound"
    preferred = ignored.model_forms.preferred
    assert preferred is not None
    assert preferred.name == "flux_shift"


@pytest.mark.long
@pytest.mark.study
def test_uncertain_flux_position_widens_beta_and_is_in_the_budget() -> None:
    study = study_rig(SEED, rig=rig_with(contact=FLUX))
    rig = rig_with(contact={"flux_profile": "barus"}, uncertainty={"flux_shift_mm": 0.4})
    p = analysed_with(study, rig)
    row = next(r for r in p.budget.rows if r.source == "place of the flux")
    assert row.u_beta_steady > 0.002
    both = p.combined.estimates["beta"]
    assert both.u > 1.2 * baseline().combined.estimates["beta"].u
    assert abs(both.value - study.true_values["beta"]) < 2 * both.u
    assert "place of the flux" not in [r.source for r in baseline().budget.rows]
    # an effect with a specified uncertainty is not another model form
    assert p.model_forms.preferred is None


TABLE = {"flux_profile": "table"}


@pytest.mark.parametrize(
    ("contact", "message"),
    [
        ({"flux_profile": "sharp"}, "Input should be 'hertz', 'flat', 'barus' or 'table'"),
        (TABLE, "flux_table_mm has 0 places; expected two or more"),
        (
            {**TABLE, "flux_table_mm": [0.0, 1.0], "flux_table_weight": [1.0]},
            "has 2 places, flux_table_weight 1",
        ),
        (
            {**TABLE, "flux_table_mm": [1.0, 0.0], "flux_table_weight": [1.0, 1.0]},
            "flux_table_mm must rise",
        ),
    ],
)
def test_invalid_flux_profile_raises(contact: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        rig_with(contact=contact)


STEEL = {"conductivity_slope_per_K": -7e-4, "specific_heat_slope_per_K": 6e-4}


@pytest.mark.long
@pytest.mark.study
def test_specified_steel_slope_removes_its_bias_and_an_uncertain_one_widens() -> None:
    """Conduction with k(T) and c(T) is solved for the full disk; noise and other errors are those
    of the baseline."""
    rig = rig_with(disk=STEEL)
    study = study_rig(SEED, rig=rig)
    specified = analysed_with(study, rig)
    ignored = analysed_with(study, load_rig())
    max_shift = [
        max(
            abs(
                p.beta_by_estimator[estimator].value - baseline().beta_by_estimator[estimator].value
            )
            for estimator in p.beta_by_estimator
        )
        for p in (specified, ignored)
    ]
    assert max_shift[0] < 0.002
    assert max_shift[1] > 0.008
    assert specified.status == "sound"
    setup = specified.test.disks["fast"].setup
    assert setup.conductivity_W_mK < 0.96 * rig.disk_setup("fast").conductivity_W_mK  # at 90 degC
    uncertain = analysed_with(
        study,
        rig_with(uncertainty={"conductivity_slope_per_K": 5e-4, "specific_heat_slope_per_K": 5e-4}),
    )
    rows = {r.source: r for r in uncertain.budget.rows}
    assert rows["conductivity slope"].u_beta_steady > 0.002
    assert {"conductivity slope", "specific heat slope"} <= set(rows)
    for estimator, beta in uncertain.beta_by_estimator.items():
        assert abs(beta.value - study.true_values["beta"]) < 2.5 * beta.u, estimator


@pytest.mark.study
def test_slope_effects_match_a_finite_change_of_the_slope() -> None:
    study = study_rig(SEED)
    u = 1e-4
    share = 0.68
    h_W_m2K = 750.0
    test = with_linear_steel(
        prepared_with(study, rig_with(uncertainty={"conductivity_slope_per_K": u}))
    )
    rows = fit_rows(test, 8.0)
    disk = test.disks["fast"]

    def residual(k_slope: float, c_slope: float) -> tuple[Array, DiskWindow]:
        """Predicted minus observed temperatures, and the window."""
        steel = replace(disk.setup.steel, conductivity_per_K=k_slope, specific_heat_per_K=c_slope)
        nominal = replace(study.test.disks["fast"].setup, steel=steel)
        rim_degC = float(lagged_window(test, disk, rows).rim.inputs[:, 1:4].mean())
        setup = linear_about(nominal, steel.air_degC, steel.surface_degC, rim_degC)
        window = lagged_window(test, replace(disk, setup=setup), rows)
        base_K, power_K = window.rim.response(h_W_m2K)
        return base_K + share * power_K - window.y, window

    at_zero_slope, window = residual(0.0, 0.0)
    for effect, expected in (
        (
            conductivity_slope_effect(window, share, h_W_m2K, u),
            residual(u, 0.0)[0] - at_zero_slope,
        ),
        (
            specific_heat_slope_effect(window.rim, share, h_W_m2K, u),
            residual(0.0, u)[0] - at_zero_slope,
        ),
    ):
        assert np.abs(expected).max() > 0.02
        # the effect uses smooth readings and the model's outer row, some kelvin off at this share
        # and h
        np.testing.assert_allclose(effect, expected, atol=0.05 * np.abs(expected).max())


@pytest.mark.study
def test_conductivity_slope_effect_contains_no_reading_noise() -> None:
    """Otherwise the effect explains noise: in an earlier version the heat share of the fast disk
    was 0.15 off."""
    study = study_rig(SEED)
    test = with_linear_steel(
        prepared_with(study, rig_with(uncertainty={"conductivity_slope_per_K": 5e-4}))
    )
    window = lagged_window(test, test.disks["fast"], fit_rows(test, 8.0))
    effect = conductivity_slope_effect(window, 0.68, 750.0, 5e-4)
    after_unloading = window.block_time_s > test.events.unload_s + 0.5
    third_difference_sd = [
        np.std(np.diff(x[after_unloading][:150], n=3, axis=0)) for x in (effect, window.y)
    ]
    assert third_difference_sd[0] < 0.002 * third_difference_sd[1]


AIR_OFFSET_K = -8.0


def simulated_surface_flux(
    rng: np.random.Generator, h: float, air_degC: float, power_rel: float, points: int = 9
) -> SurfaceFlux:
    """Surface flux from a heated spot: 1 % scatter and a common error of the heater power."""
    t = np.linspace(80.0, 160.0, points)
    q = (
        h
        * (t - air_degC)
        * (1 + power_rel * rng.standard_normal())
        * (1 + 0.01 * rng.standard_normal(points))
    )
    return fit_surface_flux(t, q, power_rel)


def test_surface_flux_fit_matches_linear_regression() -> None:
    """T_a = -a/b of q = a + b T, cov(a, b) = -mean(T) var(b); the error of the heater power affects
    b only."""
    t = np.linspace(80.0, 160.0, 9)
    q = 700.0 * (t - 55.0) * (1 + 0.01 * np.random.default_rng(0).standard_normal(9))
    fit = fit_surface_flux(t, q, 0.02)
    line = stats.linregress(t, q)
    air = -line.intercept / line.slope
    variance = line.intercept_stderr**2 + (air**2 - 2 * air * t.mean()) * line.stderr**2
    student = stats.t.isf(0.025, 7) / stats.norm.isf(0.025)
    assert fit.heat_transfer_W_m2K == pytest.approx(line.slope)
    assert fit.heat_transfer_u_W_m2K == pytest.approx(
        np.hypot(student * line.stderr, 0.02 * line.slope)
    )
    assert fit.air_degC == pytest.approx(air)
    assert fit.air_u_K == pytest.approx(student * np.sqrt(variance) / line.slope)


@pytest.mark.parametrize("points", [5, 9, 12])
def test_surface_flux_intervals_have_the_stated_coverage(points: int) -> None:
    rng = np.random.default_rng(3)
    z = []
    for _ in range(400):
        fit = simulated_surface_flux(rng, 700.0, 55.0, 0.02, points)
        z.append(
            [
                (fit.heat_transfer_W_m2K - 700) / fit.heat_transfer_u_W_m2K,
                (fit.air_degC - 55) / fit.air_u_K,
            ]
        )
    coverage = (np.abs(z) < 1.96).mean(axis=0)
    # the product of two uncertain factors makes it larger than 95 % for few points
    assert np.all((coverage > 0.92) & (coverage < 0.995))


@pytest.mark.long
@pytest.mark.study
def test_measured_surface_flux_determines_h_when_the_ambient_does_not_cool() -> None:
    """The oil cools both running surfaces 8 K below the logged ambient: without the measurement h
    is 4 u wrong."""
    truth = draw_truth(SEED, load_rig(), uncertain=True).with_film_air(AIR_OFFSET_K)
    study = study_rig(SEED, truth=truth)
    rng = np.random.default_rng(SEED)
    surface_flux = {
        d: simulated_surface_flux(
            rng, study.true_values[f"h_{d}"], study.true_values["ambient_degC"] + AIR_OFFSET_K, 0.02
        )
        for d in ("fast", "slow")
    }
    p = analysed_with(
        study, rig_with(**{d: {"surface": asdict(flux)} for d, flux in surface_flux.items()})
    )
    ignored = analysed_with(study, load_rig())
    for d in ("fast", "slow"):
        h = p.combined.estimates[f"h_{d}"]
        h_without_flux = ignored.combined.estimates[f"h_{d}"]
        assert h.u < 0.5 * h_without_flux.u
        assert abs(h.value - study.true_values[f"h_{d}"]) < 2 * h.u
        assert p.estimates[f"joint {d}"].u <= 1.01 * ignored.estimates[f"joint {d}"].u
    fast = ignored.combined.estimates["h_fast"]
    assert fast.value - study.true_values["h_fast"] > 3 * fast.u
    for estimator, beta in [*p.beta_by_estimator.items(), ("both", p.combined.estimates["beta"])]:
        assert abs(beta.value - study.true_values["beta"]) < 2 * beta.u, estimator
    assert "measured surface flux" in [r.source for r in p.budget.rows]
    assert p.status == "sound"


@pytest.mark.e2e
def test_steel_of_one_disk_has_the_effect_of_the_common_steel() -> None:
    study = study_rig(SEED)
    disk = study.test.disks["fast"]
    window = lagged_window(study.test, disk, fit_rows(study.test, 10.0))

    def effects(u_rel: float) -> dict[str, Array]:
        uncertainty = disk.uncertainty.model_copy(update={"steel_of_one_disk_rel": u_rel})
        uncertain = replace(disk, uncertainty=uncertainty)
        result = nuisance_effects(study.test, uncertain, window, 0.7, 700.0)
        return {q.name: change for q, change in zip(result.parameters, result.change)}

    without = effects(0.0)
    own = effects(0.006)
    assert set(own) - set(without) == {"conductivity of one disk", "heat capacity of one disk"}
    for name, common_u_rel in (("conductivity", 0.03), ("heat capacity", 0.02)):
        expected = 0.006 / common_u_rel * own[name]
        assert np.abs(expected).max() > 0.01
        np.testing.assert_allclose(own[f"{name} of one disk"], expected)


@pytest.mark.long
@pytest.mark.e2e
def test_disks_of_different_conductivity_are_within_the_interval_that_allows_for_it() -> None:
    """Conductivity of the fast disk 2 % higher, of the slow disk 2 % lower than rig.toml says."""
    truth = draw_truth(SEED, load_rig(), uncertain=True)
    disks = {
        d: replace(
            truth.disk(d),
            setup=replace(
                truth.disk(d).setup,
                conductivity_W_mK=factor * truth.disk(d).setup.conductivity_W_mK,
            ),
        )
        for d, factor in (("fast", 1.02), ("slow", 0.98))
    }
    study = study_rig(SEED, truth=replace(truth, **disks))
    uncertain = rig_with(uncertainty={"steel_of_one_disk_rel": 0.02})
    estimate = analysed_with(study, uncertain).combined.estimates["beta"]
    certain = analysed_with(study, rig_with(uncertainty={"steel_of_one_disk_rel": 0.0}))
    assert estimate.u > 1.2 * certain.combined.estimates["beta"].u
    assert abs(estimate.value - study.true_values["beta"]) < 2.5 * estimate.u
