"""Test design: Fisher information against limits one can work out, and against its own scaling."""

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
def test_less_noise_more_runs_and_a_better_event_all_help() -> None:
    # at the nominal values, where it must hold; a few draws differ from others by more than the entry tells
    base = predict_plunges([PLAN], SETUP, draws=1)
    quiet = predict_plunges([replace(PLAN, noise_K=0.03)], SETUP, draws=1)
    twice = predict_plunges([PLAN, PLAN], SETUP, draws=1)
    sharp = predict_plunges([replace(PLAN, entry_u_s=0.005)], SETUP, draws=1)
    assert quiet.u_differential_s < base.u_differential_s
    assert twice.u_common_s < base.u_common_s
    assert sharp.u_common_s < base.u_common_s


def test_a_plunge_tells_differences_far_better_than_the_common_lag() -> None:
    one = predict_plunges([PLAN], SETUP, draws=8)
    assert one.u_differential_s < 0.4 * one.u_common_s


def test_an_unloading_tells_the_common_lag_better_than_a_plunge() -> None:
    plunge = predict_plunges([PLAN], SETUP, draws=8)
    unloading = predict_step(StepPlan(), SETUP)
    assert unloading.u_common_s < plunge.u_common_s
    both = combine_tests("both", [plunge, unloading])
    assert both.u_common_s < unloading.u_common_s
    assert both.u_differential_s < plunge.u_differential_s * 1.001


def test_an_uncertain_instant_enters_the_common_lag_but_less_than_one_to_one() -> None:
    # a lag bends the edge where a late instant only shifts it, so the data tell part of the instant themselves
    late = predict_step(StepPlan(depth_u_m=1e-9, conductivity_log_u=1e-6, instant_u_s=0.05), SETUP)
    sharp = predict_step(StepPlan(depth_u_m=1e-9, conductivity_log_u=1e-6, instant_u_s=1e-4), SETUP)
    added = np.sqrt(late.u_common_s**2 - sharp.u_common_s**2)
    assert 0.01 < added < 0.05


def test_junction_depths_limit_what_a_step_tells() -> None:
    known = predict_step(StepPlan(depth_u_m=1e-9), SETUP)
    assert predict_step(StepPlan(depth_u_m=2e-4), SETUP).u_common_s > 1.3 * known.u_common_s


def test_the_patch_response_has_the_steady_state_of_carslaw_and_jaeger() -> None:
    z = 2e-3
    a = 1.5e-3
    k = 41.0
    late = patch_response(np.array([1e5]), z, a, k, 1.1e-5)[0]
    # the approach is a^2/(2 K sqrt(4 pi alpha t)): 1e-4 of the limit at 1e5 s
    assert late == pytest.approx((np.hypot(z, a) - z) / k, rel=1e-2)
    early = patch_response(np.array([1e-6]), z, a, k, 1.1e-5)[0]
    assert early < 1e-20  # heat has gone 3 um


def test_a_wide_patch_begins_as_a_half_space() -> None:
    """Explicit steps of the heat equation under a unit flux, before the patch's edge is felt."""
    k = 41.0
    alpha = 1.1e-5
    dx = 5e-5
    dt = 5e-5
    rise = np.zeros(400)
    for _ in range(20_000):  # 1 s; alpha dt/dx2 = 0.22
        flow = -k * np.diff(rise) / dx
        rise[:-1] += dt * alpha / k / dx * (np.insert(flow[:-1], 0, 1.0) - flow)
    for at in (0, 40, 80):
        told = patch_response(np.array([1.0]), (at + 0.5) * dx, 1.0, k, alpha)
        assert told[0] == pytest.approx(rise[at], rel=5e-3)


def test_a_touch_cannot_beat_its_unknown_onset() -> None:
    vague = predict_touches(TouchPlan(onset_log_u=1.0, onset_s=0.3), SETUP)
    crisp = predict_touches(TouchPlan(onset_log_u=0.05, onset_s=0.05), SETUP)
    assert vague.u_common_s > crisp.u_common_s


def test_shared_and_own_parameters_are_eliminated_as_by_hand() -> None:
    # y_r = x_r + s: own x_r flat, shared s with prior sd 2; one reading of noise 1 each: var x = 1 + 4
    c = posterior_covariance(
        np.column_stack([np.eye(3), np.ones(3)]), np.array([np.inf, np.inf, np.inf, 2.0])
    )
    np.testing.assert_allclose(np.diag(c)[:3], 5.0, rtol=1e-9)
    np.testing.assert_allclose(c[0, 1], 4.0, rtol=1e-9)


def test_slopes_are_the_derivatives() -> None:
    at = np.array([2.0, 3.0])
    steps = np.array([1e-3, 1e-4])
    found = jacobian(lambda x: np.array([x[0] ** 2, x[0] * x[1]]), at, steps)
    np.testing.assert_allclose(found, [[4.0, 0.0], [3.0, 2.0]], rtol=1e-9)  # exact for a quadratic


def test_common_and_differential_parts_of_a_covariance() -> None:
    p = from_covariances("x", "y", [np.full((6, 6), 0.04) + 1e-4 * np.eye(6)])
    assert p.u_common_s == pytest.approx(np.sqrt(0.04 + 1e-4 / 6))
    assert p.u_differential_s == pytest.approx(np.sqrt(1e-4 * 5 / 6))


@pytest.mark.study
def test_the_comparison_has_a_row_and_a_sentence_for_every_test() -> None:
    design = compare_tests(SETUP, [PLAN, replace(PLAN, bath_degC=138.0)], draws=4)
    assert len(design.table()) == 7
    assert len(design.sentences()) == 8
    assert all(s.endswith(".") for s in design.sentences())


@pytest.mark.study
def test_the_rig_s_uncertainties_reach_every_test() -> None:
    table = {"draws": 1, "lag_s": 0.73}  # at the middle of the priors: no draw decides
    stated = compare_tests(SETUP, [PLAN], **table)
    same = compare_tests(SETUP, [PLAN], uncertainty=load_rig().fast.uncertainty, **table)
    vague = UncertaintyTable(depth_mm=1.0, conductivity_rel=0.3)
    worse = compare_tests(SETUP, [PLAN], uncertainty=vague, **table)
    for one, default, other in zip(stated.predictions, same.predictions, worse.predictions):
        assert one.u_differential_s == default.u_differential_s
        assert other.u_common_s > one.u_common_s, one.name
        assert other.u_differential_s > one.u_differential_s, one.name


def test_the_design_widens_h_by_the_fluid_s_properties_as_the_fit_does() -> None:
    from immersion.fluids import fluid

    oil = fluid("mobil-jet-ii")
    vague = replace(oil, u_nu=0.5, u_beta=0.5)  # h ~ (beta / nu)^(1/4)
    known, unknown = (
        predict_plunges([replace(PLAN, fluid=f)], SETUP, draws=1) for f in (oil, vague)
    )
    assert unknown.other_u["u_h_rel"] > known.other_u["u_h_rel"]


def told(kind: str, common_s: float, differences_s: float) -> PredictedTest:
    return PredictedTest(
        f"{kind} test", kind, common_s, differences_s, np.eye(6), common_s, common_s
    )


def test_the_headline_names_the_least_laborious_test_that_suffices() -> None:
    plunge = told("plunge", 0.05, 0.01)
    unloading = told("unloading", 0.03, 0.03)
    both = told("together", 0.02, 0.009)
    said = recommendation([plunge, unloading, both], 0.73)
    assert said.startswith("Do this: plunge test, and log an unloading.")
    assert (
        "plunges alone leave the common lag at +- 0.050 s" in said
    )  # each alone lacks another thing
    assert "an unloading alone leaves the differences at +- 0.030 s" in said
    assert recommendation([told("plunge", 0.03, 0.01), unloading, both], 0.73).startswith(
        "Do this: plunge test. It"
    )
    assert recommendation([plunge, unloading], 0.73).startswith(
        "No test of this plan tells the lags well."
    )


def test_grades_are_those_that_are_explained() -> None:
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
    assert all(word in GRADE_DEFINITIONS for word in ("5 %", "15 %", "3 %", "10 %"))


def test_where_fits_end_u_spreads_as_far_as_simulated_fits_state_it() -> None:
    """forms_study's disks (20 of seed 2027, two plunges in hot oil): u of 0.037 to 0.101 s, 0.072 rms."""
    plans = [PlungePlan(bath_degC=bath, initial_degC=26.0) for bath in (110.0, 138.0)]
    told = predict_plunges(plans, SETUP, lag_s=0.65)
    assert told.low_s < 0.037
    assert 0.09 < told.high_s < 0.13
    assert told.u_common_s == pytest.approx(0.072, rel=0.3)


def test_what_is_well_known_beforehand_stays_as_it_is() -> None:
    # channels alike to a in each lag about the mean of six: differences of a sqrt(5/6)
    plan = StepPlan(power_log_u=1e-4, h_log_u=1e-4, channel_lag_sd_s=1e-5)
    told = predict_step(plan, SETUP)
    assert told.other_u == pytest.approx({"u_power_rel": 1e-4, "u_h_rel": 1e-4}, rel=1e-2)
    assert told.u_differential_s == pytest.approx(1e-5 * np.sqrt(5 / 6), rel=1e-2)
    vague = predict_step(StepPlan(), SETUP).other_u
    assert vague["u_power_rel"] < StepPlan.power_log_u and vague["u_h_rel"] < StepPlan.h_log_u  # noqa: PT018
