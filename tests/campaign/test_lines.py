"""Lines, exponent and curves of a campaign against closed forms, from given values and
covariance."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from tcdyn.campaign import JoinedCampaign, join_results, solve_campaign
from tcdyn.campaign.exponent import speed_law
from tcdyn.campaign.line_fit import fit_generalised_line
from tcdyn.campaign.posterior import N_QUANTITIES, Posterior
from tcdyn.campaign.trends import Curve, curve_test, read_curve, trend
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tests.campaign.toy import RATIO, beta_json, toy

SD = 0.004


def posterior_of(beta: Array, sd: float = SD, exponents: Array | float = 0.7) -> Posterior:
    """A campaign with these beta (N,) and exponents (N,), all independent with standard uncertainty
    ``sd``."""
    solved = solve_campaign(toy(3, len(beta)).tests)
    values = solved.values.copy()
    values[:, 0] = beta
    values[:, 1] = np.log(700.0)
    values[:, 2] = values[:, 1] - exponents * np.log(RATIO)
    return replace(solved, values=values, covariance=sd**2 * np.eye(N_QUANTITIES * len(beta)))


def condition_of_tests(posterior: Posterior, name: str) -> Array:
    return np.array([t.conditions[name] for t in posterior.tests])


def test_line_with_large_scatter_matches_ordinary_least_squares() -> None:
    """Slope, its standard error, Student's interval and the p value against the regression of
    scipy."""
    beta = 0.7 + np.array([0.02, -0.01, 0.0, -0.03, 0.01, 0.02, -0.02, -0.01])
    posterior = posterior_of(beta, 1e-8)
    load = condition_of_tests(posterior, "load_N")
    result = trend(posterior, "load_N")
    expected = stats.linregress(load, beta)
    assert result is not None
    (slope,) = result.slopes
    freedom = len(beta) - 2
    assert (slope.value, slope.u) == pytest.approx((expected.slope, expected.stderr), rel=1e-5)
    half_width = stats.t.isf(0.025, freedom) * expected.stderr
    assert (slope.low95, slope.high95) == pytest.approx(
        (expected.slope - half_width, expected.slope + half_width), rel=1e-5
    )
    assert result.p_value[0] == pytest.approx(expected.pvalue, rel=1e-4)
    residual = beta - expected.intercept - expected.slope * load
    assert result.scatter == pytest.approx(np.sqrt(residual @ residual / freedom), rel=1e-5)


def test_trend_is_most_certain_at_the_mean_of_its_tests() -> None:
    """Independent tests on a line: u of the slope is sd/sqrt(sum (x - mean)^2); at the mean nothing
    is added."""
    posterior = posterior_of(np.full(8, 0.7))
    load = condition_of_tests(posterior, "load_N")
    posterior = posterior_of(0.7 - 3e-5 * (load - load.mean()))
    result = trend(posterior, "load_N")
    assert result is not None
    u = SD / np.sqrt(np.sum((load - load.mean()) ** 2))
    assert (result.slopes[0].value, result.slopes[0].u, result.scatter) == pytest.approx(
        (-3e-5, u, 0.0), rel=1e-6
    )
    assert result.p_value[0] == pytest.approx(2 * stats.norm.sf(3e-5 / u), rel=1e-6)
    value, u_within = result.evaluate(load.mean() + np.array([0.0, 500.0]))
    assert value == pytest.approx([0.7, 0.685])
    assert u_within == pytest.approx([0.0, 500.0 * u], abs=1e-9)


def test_line_over_two_conditions_needs_one_more_test() -> None:
    """The k-th of these tests has the k-th load and the k-th speed, so all conditions differ."""
    tests = toy(3).tests
    of_three_tests, of_four_tests = (
        solve_campaign([tests[k] for k in (0, 5, 10, 15)[:count]]) for count in (3, 4)
    )
    assert trend(of_three_tests, "load_N") is not None
    assert trend(of_three_tests, "load_N", "sliding_speed_m_s") is None
    assert trend(of_four_tests, "load_N", "sliding_speed_m_s") is not None


def test_curve_needs_two_rows(tmp_path: Path) -> None:
    rows = ["800,0.72,0.01", "1600,0.70,0.01", "2400,0.68,0.02"]
    for count in (1, 2, 3):
        (tmp_path / "m.csv").write_text(
            "\n".join(["load_N,beta,u_beta", *rows[:count]]) + "\n", encoding="utf-8"
        )
        if count == 1:
            with pytest.raises(InputError, match="two rows or more"):
                read_curve(tmp_path / "m.csv")
        else:
            assert read_curve(tmp_path / "m.csv").u.tolist() == [0.01, 0.01, 0.02][:count]


def test_exponent_that_increases_with_speed_is_detected() -> None:
    """16 tests: u of one exponent is sd sqrt(2)/ln(ratio), u of the mean a quarter of it."""
    speed = condition_of_tests(posterior_of(np.full(16, 0.7)), "entraining_speed_m_s")
    exponents = 0.6 + 0.1 * np.log2(speed / 10.0)
    law = speed_law(posterior_of(np.full(16, 0.7), exponents=exponents))
    assert law.each == pytest.approx(exponents)
    u_single = SD * np.sqrt(2) / np.log(RATIO)
    assert law.u_within == pytest.approx(np.full(16, u_single))
    assert law.by_speed is not None
    doubled = np.log2(speed) - np.log2(speed).mean()
    assert (law.by_speed.value, law.by_speed.u) == pytest.approx(
        (0.1, u_single / np.sqrt(doubled @ doubled))
    )
    constant_law = speed_law(posterior_of(np.full(16, 0.7)))
    assert (
        constant_law.exponent.value,
        constant_law.exponent.u,
        constant_law.scatter,
    ) == pytest.approx((0.7, u_single / 4, 0.0))
    assert speed_law(posterior_of(np.full(3, 0.7))).by_speed is None


def test_uncertainty_of_a_curve_is_a_common_error_of_its_points() -> None:
    """V = sd^2 + u^2 between all points.

    By Sherman and Morrison, chi-squared decreases by u^2 (sum d)^2/(sd^2 + n u^2), and the offset
    is the mean with u^2 = sd^2/n + u^2. The departures d are such that the shape is accepted (2.6
    on 3 degrees of freedom).
    """
    departures = np.array([0.008, 0.012, 0.003, 0.007])
    load = condition_of_tests(posterior_of(np.full(4, 0.7)), "load_N")
    line = 0.72 - 2e-5 * np.array([0.0, 4000.0])
    curve = Curve("m.csv", "load_N", np.array([0.0, 4000.0]), line, np.full(2, 0.03))
    result = curve_test(posterior_of(0.72 - 2e-5 * load + departures), curve)
    n = len(departures)
    u = 0.03
    chi2 = (departures @ departures - u**2 * departures.sum() ** 2 / (SD**2 + n * u**2)) / SD**2
    about_mean = departures - departures.mean()
    assert (result.chi2, result.shape_chi2) == pytest.approx(
        (chi2, about_mean @ about_mean / SD**2)
    )
    p_values = (stats.chi2.sf(chi2, n), stats.chi2.sf(result.shape_chi2, n - 1))
    assert (result.p_value, result.shape_p_value) == pytest.approx(p_values)
    assert (result.offset.value, result.offset.u) == pytest.approx(
        (departures.mean(), np.sqrt(SD**2 / n + u**2))
    )
    # tests at the ends of a curve are inside
    short_curve = Curve("m.csv", "load_N", np.sort(load)[1:3], np.array([0.7, 0.7]), np.zeros(2))
    assert len(curve_test(posterior_of(np.full(4, 0.7)), short_curve).inside) == 2


@pytest.fixture(scope="module")
def joined_campaign() -> JoinedCampaign:
    result = join_results({t.name: beta_json(t) for t in toy(1).tests})
    assert result is not None
    return result


def codes(joined_campaign: JoinedCampaign) -> set[str]:
    return {f.code for f in joined_campaign.findings}


def test_exponent_two_u_from_the_nominal_one_is_reported(joined_campaign: JoinedCampaign) -> None:
    # u of the exponent is 0.01
    for exponent, is_reported in (
        (0.667 + 0.019, False),
        (0.667 + 0.021, True),
        (0.667 - 0.021, True),
    ):
        law = replace(
            joined_campaign.speed_law, exponent=Estimate.normal(exponent, 0.01), p_value=0.5
        )
        assert (
            "campaign.exponent" in codes(replace(joined_campaign, speed_law=law))
        ) == is_reported
    single_test = replace(joined_campaign.posterior, tests=joined_campaign.posterior.tests[:1])
    # for a single test, the message of the test itself is sufficient
    assert "campaign.exponent" not in codes(
        replace(joined_campaign, speed_law=law, posterior=single_test)
    )


def test_curved_power_law_and_misplaced_junction_are_reported(
    joined_campaign: JoinedCampaign,
) -> None:
    for p_value, is_reported in ((0.02, False), (0.005, True)):
        assert (
            "campaign.power_law"
            in codes(
                replace(
                    joined_campaign, speed_law=replace(joined_campaign.speed_law, p_value=p_value)
                )
            )
        ) == is_reported
    for z, is_reported in ((3.9, False), (-3.9, False), (4.1, True), (-4.1, True)):
        assert (
            "campaign.junction" in codes(replace(joined_campaign, pulls={"fast": {"e": z}}))
        ) == is_reported


def test_two_tests_of_nearly_known_uncertainty_do_not_get_students_interval_of_one_degree() -> None:
    """The scatter is a small part of the uncertainty, which the common error determines."""
    covariance = 0.06**2 * np.ones((2, 2)) + 0.01**2 * np.eye(2)
    line = fit_generalised_line(np.ones((2, 1)), np.array([0.74, 0.762]), covariance)
    assert line.scatter > 0
    exponent = line.estimate(0)
    assert exponent.high95 - exponent.value == pytest.approx(1.96 * exponent.u, rel=0.01)


@pytest.mark.e2e
@pytest.mark.parametrize(("count", "scatter"), [(2, 0.0), (2, 0.03), (4, 0.03), (10, 0.1)])
def test_interval_of_a_level_covers_with_and_without_scatter(count: int, scatter: float) -> None:
    """400 draws: 95 +- 4 %."""
    rng = np.random.default_rng(17)
    inside = []
    for _ in range(400):
        own = rng.uniform(0.008, 0.02, count)
        common = 0.06 * rng.uniform(0.8, 1.2, count)
        error = common * rng.standard_normal() + own * rng.standard_normal(count)
        y = 0.7 + error + scatter * rng.standard_normal(count)
        covariance = np.outer(common, common) + np.diag(own**2)
        n = fit_generalised_line(np.ones((count, 1)), y, covariance).estimate(0)
        inside.append(n.low95 < 0.7 < n.high95)
    assert 0.91 < np.mean(inside) < 0.985
