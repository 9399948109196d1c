"""Offset of the tests from a model curve: within the range of the tests; a shape that does not fit
is reported."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from tcdyn.campaign import join_results
from tcdyn.campaign.line_fit import Line, fit_generalised_line, level_inside_points
from tcdyn.campaign.posterior import BETA
from tcdyn.campaign.trends import Curve, curve_test
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Severity
from tests.campaign.curve_study import (
    COMMON,
    LEVEL,
    DrawnCurve,
    distance_outside,
    drawn_curve,
    study_table,
)
from tests.campaign.toy import beta_json, toy

DRAWS = 60
FALSE_FAILURE_P = 1e-3  # probability that a correct library fails a test that counts draws
STUDY_DRAWS = 200
STUDY_SEED = 5000


def level(y: Array, covariance: Array) -> Line:
    """The common level inside the points, with the scatter that their departures need."""
    return level_inside_points(y, fit_generalised_line(np.ones((len(y), 1)), y, covariance))


def two_tests(first: float, second: float) -> DrawnCurve:
    """Two tests of a drawn campaign with these differences from a constant curve and a common
    error."""
    drawn = next(
        candidate
        for candidate in (drawn_curve(seed, wrong=False) for seed in range(200))
        if len(candidate.difference) == 2
    )
    difference = np.array([first, second])
    values = drawn.posterior.values.copy()
    values[:, BETA] = LEVEL + difference
    curve = replace(drawn.curve, beta=np.full(len(drawn.curve.x), LEVEL))
    covariance = COMMON**2 * np.ones((2, 2)) + 0.001**2 * np.eye(2)
    full_covariance = drawn.posterior.covariance.copy()
    full_covariance[BETA :: len(full_covariance) // 2, BETA :: len(full_covariance) // 2] = (
        covariance
    )
    return DrawnCurve(
        replace(drawn.posterior, values=values, covariance=full_covariance),
        curve,
        difference,
        float("nan"),
    )


def test_offset_from_a_curve_of_wrong_shape_is_within_the_range_of_the_tests() -> None:
    """2 to 16 tests with partly correlated errors of different size.

    Generalised least squares leaves the range in two of three of these campaigns, by up to tens of
    u.
    """
    for seed in range(DRAWS):
        drawn = drawn_curve(seed, wrong=True)
        result = curve_test(drawn.posterior, drawn.curve)
        assert distance_outside(result.offset.value, drawn.difference) <= 1e-12, seed
        assert result.shape_rejected, seed
        assert result.scatter > 0, seed


def test_offset_interval_has_the_stated_coverage_for_a_correct_shape() -> None:
    campaigns = [drawn_curve(seed, wrong=False) for seed in range(DRAWS)]
    results = [curve_test(campaign.posterior, campaign.curve) for campaign in campaigns]
    covered = sum(
        result.offset.contains(campaign.offset) for result, campaign in zip(results, campaigns)
    )
    assert covered >= stats.binom.ppf(FALSE_FAILURE_P, DRAWS, 0.95)
    assert sum(result.shape_rejected for result in results) <= stats.binom.ppf(
        1 - FALSE_FAILURE_P, DRAWS, 0.05
    )


def test_offset_from_an_accepted_curve_has_the_least_variance_inside_the_range() -> None:
    """Of all weights w >= 0 with sum 1: V w = s where w > 0 and V w >= s elsewhere, s = w'V w
    (Karush, Kuhn, Tucker).

    The weights of generalised least squares leave the range in six of ten of these campaigns.
    """
    n_accepted = n_outside = 0
    for seed in range(DRAWS):
        drawn = drawn_curve(seed, wrong=False)
        result = curve_test(drawn.posterior, drawn.curve)
        assert distance_outside(result.offset.value, drawn.difference) <= 1e-12, seed
        if result.shape_rejected:
            continue
        _, covariance = drawn.posterior.beta
        line = fit_generalised_line(
            np.ones((len(drawn.difference), 1)), drawn.difference, covariance
        )
        unscattered = replace(line, scatter=0.0, total_covariance=covariance)
        (weights,) = level_inside_points(drawn.difference, unscattered).operator
        gradient = covariance @ weights
        variance = float(weights @ gradient)
        assert weights.min() >= 0
        assert weights.sum() == pytest.approx(1)
        # the condition number of V is about 1e4
        assert gradient[weights > 0] == pytest.approx(variance, rel=1e-6)
        assert gradient.min() >= variance * (1 - 1e-6)
        assert result.offset.value == pytest.approx(float(weights @ drawn.difference))
        assert result.offset.u == pytest.approx(np.sqrt(variance))
        assert result.scatter == 0.0
        n_accepted += 1
        n_outside += weights.min() == 0
    assert n_accepted > 0.8 * DRAWS
    assert n_outside > 0.3 * DRAWS


@pytest.mark.study
def test_200_campaigns_against_correct_and_wrong_shapes() -> None:
    """Offset in the range of the tests, coverage of 92 to 98 % and every wrong shape reported."""
    for wrong in (False, True):
        table = study_table(STUDY_DRAWS, STUDY_SEED, wrong=wrong)
        assert table["outside"].max() <= 1e-12
        if wrong:
            assert table["reported"].all()
        else:
            assert 0.92 <= table["covered"].mean() <= 0.98
            assert table["reported"].mean() <= 0.10


def test_two_tests_have_one_degree_of_freedom() -> None:
    """Independent u of 0.001 each: a difference of 0.002 is accepted, one of 0.02 rejected.

    The offset is the mean. In the second case the scatter makes (0.02)^2/(2 (0.001^2 + s^2)) one.
    The interval is Student's; its degrees of freedom are those of Welch and Satterthwaite, of which
    the scatter has one.
    """
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
    freedom = (rejected.offset.u**2 / ((rejected.scatter**2 + 0.001**2) / 2)) ** 2
    half_width = stats.t.isf(0.025, freedom) * rejected.offset.u
    assert rejected.offset.high95 - rejected.offset.value == pytest.approx(half_width)


def test_one_test_in_the_range_of_a_curve_raises() -> None:
    drawn = drawn_curve(0, wrong=False)
    x = np.sort([t.conditions[drawn.curve.against] for t in drawn.posterior.tests])
    short = Curve(
        "short.csv",
        drawn.curve.against,
        x[0] + np.array([-1.0, 1.0]),
        np.full(2, LEVEL),
        np.zeros(2),
    )
    with pytest.raises(InputError, match=r"short\.csv.*1 tests lie within"):
        curve_test(drawn.posterior, short)


def test_level_of_equal_errors_is_the_mean_and_of_unequal_errors_the_weighted_mean() -> None:
    y = np.array([0.0, 1.0, 3.0])
    equal = level(y, 1e-12 * np.eye(3))
    assert equal.coefficients[0] == pytest.approx(np.mean(y))
    assert np.sqrt(equal.covariance[0, 0]) == pytest.approx(
        np.std(y, ddof=1) / np.sqrt(3), rel=1e-6
    )
    u = np.array([1.0, 2.0, 4.0])
    weighted = level(y, np.diag(u**2))
    assert weighted.scatter == 0.0
    assert weighted.coefficients[0] == pytest.approx(np.average(y, weights=u**-2))
    assert weighted.covariance[0, 0] == pytest.approx(1 / np.sum(u**-2))


def test_level_has_no_negative_weight_where_least_squares_has_one() -> None:
    """Peelle's values 1.0 and 1.5 with independent errors of 10 % and a common factor known to 20
    %.

    Their weighted mean with the covariance from the values themselves is 0.88. The nearest level in
    the range is 1.0.
    """
    y = np.array([1.5, 1.0])
    covariance = np.diag((0.1 * y) ** 2) + np.outer(0.2 * y, 0.2 * y)
    weight = np.linalg.inv(covariance)
    assert weight.sum(axis=0) @ y / weight.sum() == pytest.approx(0.88, abs=0.005)
    result = level(y, covariance)
    assert result.operator.min() >= 0
    assert result.operator.sum() == pytest.approx(1)
    assert 1.0 <= result.coefficients[0] <= 1.5


def test_campaign_warns_of_a_curve_whose_shape_does_not_fit() -> None:
    """Beta of the tests decreases by 3e-5 per newton: a curve that increases as much gives a
    warning."""
    beta_files = {
        t.name: beta_json(t) for t in toy(1).tests if t.conditions["sliding_speed_m_s"] == 13.0
    }
    load = np.array([800.0, 2400.0])
    falling = 0.70 - 3e-5 * (load - 1620.0)
    wrong = Curve("wrong.csv", "load_N", load, falling[::-1], np.zeros(2))
    correct = Curve("correct.csv", "load_N", load, falling, np.zeros(2))
    campaign = join_results(beta_files, [wrong, correct])
    assert campaign is not None
    shapes = [f for f in campaign.findings if f.code == "campaign.curve_shape"]
    assert [f.subject for f in shapes] == ["wrong.csv"]
    (finding,) = shapes
    assert finding.severity is Severity.WARNING
    first, second = campaign.curves
    assert finding.numbers["chi2"] == first.shape_chi2
    assert finding.numbers["freedom"] == len(first.inside) - 1
    assert finding.numbers["p"] == first.shape_p_value
    assert finding.numbers["scatter"] == first.scatter
    assert "the shape of the curve in wrong.csv does not fit the tests" in finding.sentence
    assert f"on {len(first.inside) - 1} degrees of freedom" in finding.sentence
    models = campaign.to_dict()["models"]
    assert [m["scatter"] for m in models] == [first.scatter, 0.0]
    assert second.scatter == 0.0
    other_keys = {
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
    assert set(models[0]) == other_keys | {"scatter"}
