"""Test design: Fisher information against limiting cases with known results, and its scaling."""

from dataclasses import replace

import numpy as np
import pytest

from tcdyn.design.compare import (
    COMMON_LAG_LIMITS,
    DIFFERENCE_LIMITS,
    GRADE_DEFINITIONS,
    compare_tests,
    grade,
    recommendation,
)
from tcdyn.design.plans import (
    PlungePlan,
    StepPlan,
    TouchPlan,
    patch_response,
    predict_plunges,
    predict_step,
    predict_touches,
)
from tcdyn.design.prediction import (
    PredictedTest,
    combine_tests,
    from_covariances,
    jacobian,
    posterior_covariance,
)
from tcdyn.rig.rigfile import UncertaintyTable, load_rig

SETUP = load_rig().disk_setup("fast")
PLAN = PlungePlan(duration_s=60.0)


@pytest.mark.study
def test_less_noise_more_runs_and_a_better_entry_reduce_the_uncertainty() -> None:
    # at the nominal values, where it must hold; a few samples differ by more than the effect of the
    # entry
    base = predict_plunges([PLAN], SETUP, draws=1)
    low_noise = predict_plunges([replace(PLAN, noise_K=0.03)], SETUP, draws=1)
    two_runs = predict_plunges([PLAN, PLAN], SETUP, draws=1)
    sharp_entry = predict_plunges([replace(PLAN, entry_u_s=0.005)], SETUP, draws=1)
    assert low_noise.u_differential_s < base.u_differential_s
    assert two_runs.u_common_s < base.u_common_s
    assert sharp_entry.u_common_s < base.u_common_s


def test_plunge_determines_differences_far_better_than_the_common_lag() -> None:
    prediction = predict_plunges([PLAN], SETUP, draws=8)
    assert prediction.u_differential_s < 0.4 * prediction.u_common_s


def test_unloading_determines_the_common_lag_better_than_a_plunge() -> None:
    plunge = predict_plunges([PLAN], SETUP, draws=8)
    unloading = predict_step(StepPlan(), SETUP)
    assert unloading.u_common_s < plunge.u_common_s
    combined = combine_tests("both", [plunge, unloading])
    assert combined.u_common_s < unloading.u_common_s
    assert combined.u_differential_s < plunge.u_differential_s * 1.001


def test_uncertain_instant_adds_to_the_common_lag_but_less_than_one_to_one() -> None:
    # a lag bends the edge where a late instant only shifts it, so the data determine part of the
    # instant
    uncertain_instant = predict_step(
        StepPlan(depth_u_m=1e-9, conductivity_log_u=1e-6, instant_u_s=0.05), SETUP
    )
    known_instant = predict_step(
        StepPlan(depth_u_m=1e-9, conductivity_log_u=1e-6, instant_u_s=1e-4), SETUP
    )
    component = np.sqrt(uncertain_instant.u_common_s**2 - known_instant.u_common_s**2)
    assert 0.01 < component < 0.05


def test_junction_depths_limit_the_information_of_a_step() -> None:
    known_depth = predict_step(StepPlan(depth_u_m=1e-9), SETUP)
    assert predict_step(StepPlan(depth_u_m=2e-4), SETUP).u_common_s > 1.3 * known_depth.u_common_s


def test_patch_response_has_the_steady_state_of_carslaw_and_jaeger() -> None:
    z = 2e-3
    a = 1.5e-3
    k = 41.0
    steady_state = patch_response(np.array([1e5]), z, a, k, 1.1e-5)[0]
    # the approach is a^2/(2 K sqrt(4 pi alpha t)): 1e-4 of the limit at 1e5 s
    assert steady_state == pytest.approx((np.hypot(z, a) - z) / k, rel=1e-2)
    early = patch_response(np.array([1e-6]), z, a, k, 1.1e-5)[0]
    assert early < 1e-20  # heat has diffused 3 um


def test_wide_patch_starts_as_a_half_space() -> None:
    """Explicit steps of the heat equation under a unit flux, before the edge of the patch has an
    effect."""
    k = 41.0
    alpha = 1.1e-5
    dx = 5e-5
    dt = 5e-5
    rise = np.zeros(400)
    for _ in range(20_000):  # 1 s; alpha dt/dx2 = 0.22
        flow = -k * np.diff(rise) / dx
        rise[:-1] += dt * alpha / k / dx * (np.insert(flow[:-1], 0, 1.0) - flow)
    for cell in (0, 40, 80):
        response = patch_response(np.array([1.0]), (cell + 0.5) * dx, 1.0, k, alpha)
        assert response[0] == pytest.approx(rise[cell], rel=5e-3)


def test_touch_is_limited_by_its_unknown_onset() -> None:
    uncertain = predict_touches(TouchPlan(onset_log_u=1.0, onset_s=0.3), SETUP)
    sharp_onset = predict_touches(TouchPlan(onset_log_u=0.05, onset_s=0.05), SETUP)
    assert uncertain.u_common_s > sharp_onset.u_common_s


def test_shared_and_individual_parameters_are_eliminated_as_in_the_closed_form() -> None:
    # y_r = x_r + s with individual x_r, flat prior, and shared s with prior sd 2; one reading of
    # noise 1 each: var x = 1 + 4
    c = posterior_covariance(
        np.column_stack([np.eye(3), np.ones(3)]), np.array([np.inf, np.inf, np.inf, 2.0])
    )
    np.testing.assert_allclose(np.diag(c)[:3], 5.0, rtol=1e-9)
    np.testing.assert_allclose(c[0, 1], 4.0, rtol=1e-9)


def test_jacobian_equals_the_derivatives_of_a_quadratic() -> None:
    point = np.array([2.0, 3.0])
    steps = np.array([1e-3, 1e-4])
    result = jacobian(lambda x: np.array([x[0] ** 2, x[0] * x[1]]), point, steps)
    np.testing.assert_allclose(result, [[4.0, 0.0], [3.0, 2.0]], rtol=1e-9)  # exact for a quadratic


def test_common_and_differential_uncertainty_of_a_covariance() -> None:
    p = from_covariances("x", "y", [np.full((6, 6), 0.04) + 1e-4 * np.eye(6)])
    assert p.u_common_s == pytest.approx(np.sqrt(0.04 + 1e-4 / 6))
    assert p.u_differential_s == pytest.approx(np.sqrt(1e-4 * 5 / 6))


@pytest.mark.study
def test_comparison_has_a_row_and_a_sentence_for_every_test() -> None:
    design = compare_tests(SETUP, [PLAN, replace(PLAN, bath_degC=138.0)], draws=4)
    assert len(design.table()) == 7
    assert len(design.sentences()) == 8
    assert all(s.endswith(".") for s in design.sentences())


@pytest.mark.study
def test_uncertainties_of_the_rig_enter_every_test() -> None:
    options = {"draws": 1, "lag_s": 0.73}  # at the middle of the priors: independent of the samples
    default = compare_tests(SETUP, [PLAN], **options)
    from_rig = compare_tests(SETUP, [PLAN], uncertainty=load_rig().fast.uncertainty, **options)
    uncertain = UncertaintyTable(depth_mm=1.0, conductivity_rel=0.3)
    less_certain = compare_tests(SETUP, [PLAN], uncertainty=uncertain, **options)
    for base, rig_prediction, uncertain_prediction in zip(
        default.predictions, from_rig.predictions, less_certain.predictions
    ):
        assert base.u_differential_s == rig_prediction.u_differential_s
        assert uncertain_prediction.u_common_s > base.u_common_s, base.name
        assert uncertain_prediction.u_differential_s > base.u_differential_s, base.name


def test_design_includes_the_uncertainty_of_fluid_properties_in_h() -> None:
    from immersion.fluids import fluid

    oil = fluid("mobil-jet-ii")
    uncertain = replace(oil, u_nu=0.5, u_beta=0.5)  # h ~ (beta / nu)^(1/4)
    known_fluid, uncertain_fluid = (
        predict_plunges([replace(PLAN, fluid=f)], SETUP, draws=1) for f in (oil, uncertain)
    )
    assert uncertain_fluid.other_u["u_h_rel"] > known_fluid.other_u["u_h_rel"]


def predicted_test(kind: str, common_s: float, differences_s: float) -> PredictedTest:
    """A predicted test with these uncertainties."""
    return PredictedTest(
        f"{kind} test", kind, common_s, differences_s, np.eye(6), common_s, common_s
    )


def test_recommendation_names_the_least_laborious_sufficient_test() -> None:
    plunge = predicted_test("plunge", 0.05, 0.01)
    unloading = predicted_test("unloading", 0.03, 0.03)
    combined = predicted_test("together", 0.02, 0.009)
    advice = recommendation([plunge, unloading, combined], 0.73)
    assert advice.startswith("Do this: plunge test, and log an unloading.")
    # each test alone lacks something else
    assert "plunges alone leave the common lag at +- 0.050 s" in advice
    assert "an unloading alone leaves the differences at +- 0.030 s" in advice
    assert recommendation(
        [predicted_test("plunge", 0.03, 0.01), unloading, combined], 0.73
    ).startswith("Do this: plunge test. It")
    assert recommendation([plunge, unloading], 0.73).startswith(
        "No test of this plan tells the lags well."
    )


def test_grades_follow_the_documented_limits() -> None:
    assert [grade(u, 1.0, COMMON_LAG_LIMITS) for u in (0.049, 0.051, 0.151)] == [
        "well",
        "roughly",
        "poorly",
    ]
    assert [grade(u, 1.0, DIFFERENCE_LIMITS) for u in (0.029, 0.031, 0.101)] == [
        "well",
        "roughly",
        "poorly",
    ]
    assert all(f" {word}" in GRADE_DEFINITIONS for word in ("5 %", "15 %", "3 %", "10 %"))


def test_predicted_range_of_u_matches_simulated_fits() -> None:
    """The disks of forms_study (20 of seed 2027, two plunges in hot oil): u of 0.037 to 0.101 s,
    0.072 rms."""
    plans = [PlungePlan(bath_degC=bath, initial_degC=26.0) for bath in (110.0, 138.0)]
    prediction = predict_plunges(plans, SETUP, lag_s=0.65)
    assert prediction.low_s < 0.037
    assert 0.09 < prediction.high_s < 0.13
    assert prediction.u_common_s == pytest.approx(0.072, rel=0.3)


def test_well_known_quantities_keep_their_prior_uncertainty() -> None:
    # each channel of unit a about the mean of six: differences of a sqrt(5/6)
    plan = StepPlan(power_log_u=1e-4, h_log_u=1e-4, channel_lag_sd_s=1e-5)
    prediction = predict_step(plan, SETUP)
    assert prediction.other_u == pytest.approx({"u_power_rel": 1e-4, "u_h_rel": 1e-4}, rel=1e-2)
    assert prediction.u_differential_s == pytest.approx(1e-5 * np.sqrt(5 / 6), rel=1e-2)
    uncertain = predict_step(StepPlan(), SETUP).other_u
    assert uncertain["u_power_rel"] < StepPlan.power_log_u
    assert uncertain["u_h_rel"] < StepPlan.h_log_u
