"""The offset of the tests from a model's curve whose shape does not fit: inside the tests, and reported."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from tcdyn.campaign import joined
from tcdyn.campaign.line_fit import level_inside_points
from tcdyn.campaign.posterior import BETA
from tcdyn.campaign.trends import Curve, curve_test
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Severity
from tests.campaign.curve_study import COMMON, LEVEL, DrawnCurve, drawn_curve, outside
from tests.campaign.toy import answer_of, toy

DRAWS = 60
CHANCE = 1e-3  # of a sound library to fail a test that counts draws


def two_tests(first: float, second: float) -> DrawnCurve:
    """The two tests of a drawn campaign, with these differences from a level curve, common error of one size."""
    made = next(
        one
        for one in (drawn_curve(seed, wrong=False) for seed in range(200))
        if len(one.difference) == 2
    )
    difference = np.array([first, second])
    answers = made.posterior.values.copy()
    answers[:, BETA] = LEVEL + difference
    curve = replace(made.curve, beta=np.full(len(made.curve.x), LEVEL))
    covariance = COMMON**2 * np.ones((2, 2)) + 0.001**2 * np.eye(2)
    whole = made.posterior.covariance.copy()
    whole[BETA :: len(whole) // 2, BETA :: len(whole) // 2] = covariance
    return DrawnCurve(
        replace(made.posterior, values=answers, covariance=whole), curve, difference, float("nan")
    )


def test_the_offset_from_a_curve_of_wrong_shape_lies_inside_the_range_of_the_tests() -> None:
    """2 to 16 tests, partly correlated errors of different size: generalised least squares alone leaves the range in
    two of three of these campaigns, by up to some tens of standard uncertainties."""
    for seed in range(DRAWS):
        made = drawn_curve(seed, wrong=True)
        found = curve_test(made.posterior, made.curve)
        assert outside(found.offset.value, made.difference) <= 1e-12, seed
        assert found.shape_rejected, seed
        assert found.scatter > 0, seed


def test_the_interval_of_the_offset_covers_the_truth_where_the_shape_is_correct() -> None:
    made = [drawn_curve(seed, wrong=False) for seed in range(DRAWS)]
    tests = [curve_test(one.posterior, one.curve) for one in made]
    covered = sum(t.offset.contains(one.offset) for t, one in zip(tests, made))
    assert covered >= stats.binom.ppf(CHANCE, DRAWS, 0.95)
    assert sum(t.shape_rejected for t in tests) <= stats.binom.ppf(1 - CHANCE, DRAWS, 0.05)


def test_a_curve_whose_shape_is_accepted_keeps_the_offset_of_generalised_least_squares() -> None:
    """(1' V^-1 d)/(1' V^-1 1), also where that lies outside the tests: V explains it there."""
    accepted = beside = 0
    for seed in range(DRAWS):
        made = drawn_curve(seed, wrong=False)
        found = curve_test(made.posterior, made.curve)
        if found.shape_rejected:
            continue
        _, covariance = made.posterior.beta
        ones = np.ones(len(made.difference))
        solved = np.linalg.solve(covariance, np.column_stack([ones, made.difference]))
        variance = 1 / (ones @ solved[:, 0])
        value = variance * (ones @ solved[:, 1])
        # V is conditioned to about 1e6, hence 1e-9 of the largest number in it
        assert found.offset.value == pytest.approx(value, rel=1e-6, abs=1e-9)
        assert found.offset.u == pytest.approx(np.sqrt(variance), rel=1e-6)
        assert found.scatter == 0.0
        accepted += 1
        beside += outside(value, made.difference) > 0
    assert accepted > 0.8 * DRAWS
    assert beside > 0


def test_two_tests_have_one_degree_of_freedom() -> None:
    """Independent u 0.001 each: a difference of 0.002 is accepted, of 0.02 rejected; both with the mean as offset, the
    second with a scatter that makes (0.02)^2/(2 (0.001^2 + s^2)) one, and Student's interval."""
    near = two_tests(0.010, 0.012)
    far = two_tests(0.010, 0.030)
    accepted = curve_test(near.posterior, near.curve)
    rejected = curve_test(far.posterior, far.curve)
    assert not accepted.shape_rejected
    assert accepted.offset.value == pytest.approx(0.011)
    assert rejected.shape_rejected
    assert rejected.offset.value == pytest.approx(0.020)
    assert rejected.scatter == pytest.approx(np.sqrt(0.02**2 / 2 - 0.001**2), rel=1e-5)
    assert rejected.offset.u == pytest.approx(np.sqrt(COMMON**2 + 0.02**2 / 4), rel=1e-5)
    reach = stats.t.isf(0.025, 1) * rejected.offset.u
    assert rejected.offset.high95 - rejected.offset.value == pytest.approx(reach)


def test_one_test_in_the_range_of_a_curve_is_refused_by_name() -> None:
    made = drawn_curve(0, wrong=False)
    x = np.sort([t.conditions[made.curve.against] for t in made.posterior.tests])
    short = Curve(
        "short.csv",
        made.curve.against,
        x[0] + np.array([-1.0, 1.0]),
        np.full(2, LEVEL),
        np.zeros(2),
    )
    with pytest.raises(InputError, match=r"short\.csv.*1 tests lie within"):
        curve_test(made.posterior, short)


def test_a_level_of_equal_errors_is_the_mean_and_a_level_of_positive_weights_is_that_of_least_squares() -> (
    None
):
    y = np.array([0.0, 1.0, 3.0])
    plain = level_inside_points(y, 1e-12 * np.eye(3))
    assert plain.coefficients[0] == pytest.approx(np.mean(y))
    assert np.sqrt(plain.covariance[0, 0]) == pytest.approx(
        np.std(y, ddof=1) / np.sqrt(3), rel=1e-6
    )
    u = np.array([1.0, 2.0, 4.0])
    weighted = level_inside_points(y, np.diag(u**2))
    assert weighted.scatter == 0.0
    assert weighted.coefficients[0] == pytest.approx(np.average(y, weights=u**-2))
    assert weighted.covariance[0, 0] == pytest.approx(1 / np.sum(u**-2))
    alone = level_inside_points(y[:1], np.eye(1))
    assert (alone.coefficients[0], alone.freedom, alone.scatter) == (0.0, 0, 0.0)


def test_a_level_has_no_negative_weight_where_least_squares_has_one() -> None:
    """Peelle's two values 1.0 and 1.5: independent errors of 10 %, a common factor known to 20 %; their weighted mean
    with the covariance from the values themselves is 0.88. The nearest level inside is 1.0."""
    y = np.array([1.5, 1.0])
    covariance = np.diag((0.1 * y) ** 2) + np.outer(0.2 * y, 0.2 * y)
    weight = np.linalg.inv(covariance)
    assert weight.sum(axis=0) @ y / weight.sum() == pytest.approx(0.88, abs=0.005)
    found = level_inside_points(y, covariance)
    assert found.operator.min() >= 0
    assert found.operator.sum() == pytest.approx(1)
    assert 1.0 <= found.coefficients[0] <= 1.5


def test_a_campaign_warns_of_a_curve_whose_shape_does_not_fit() -> None:
    """The tests' beta fall by 3e-5 per newton: a curve that rises by as much is wrong, one of great u is not told."""
    answers = {
        t.name: answer_of(t) for t in toy(1).kept if t.conditions["sliding_speed_m_s"] == 13.0
    }
    load = np.array([800.0, 2400.0])
    falling = 0.70 - 3e-5 * (load - 1620.0)
    wrong = Curve("wrong.csv", "load_N", load, falling[::-1], np.zeros(2))
    correct = Curve("correct.csv", "load_N", load, falling, np.zeros(2))
    whole = joined(answers, [wrong, correct])
    assert whole is not None
    shapes = [f for f in whole.findings if f.code == "campaign.curve_shape"]
    assert [f.subject for f in shapes] == ["wrong.csv"]
    (found,) = shapes
    assert found.severity is Severity.WARNING
    first, second = whole.curves
    assert found.numbers["chi2"] == first.shape_chi2
    assert found.numbers["freedom"] == len(first.inside) - 1
    assert found.numbers["p"] == first.shape_p_value
    assert found.numbers["scatter"] == first.scatter
    assert "the shape of the curve in wrong.csv does not fit the tests" in found.sentence
    assert f"on {len(first.inside) - 1} degrees of freedom" in found.sentence
    kept = whole.to_dict()["models"]
    assert [m["scatter"] for m in kept] == [first.scatter, 0.0]
    assert second.scatter == 0.0
    before = {
        "file",
        "against",
        "tests",
        "chi2",
        "freedom",
        "p_value",
        "shape_chi2",
        "shape_p_value",
        "offset",
    }
    assert set(kept[0]) == before | {"scatter"}
