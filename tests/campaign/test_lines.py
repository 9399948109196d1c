"""Lines, exponent and curves of a campaign against closed forms: answers and covariance are put there by hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from tcdyn.campaign import JoinedCampaign, joined, solve_campaign
from tcdyn.campaign.exponent import speed_law
from tcdyn.campaign.posterior import N_QUANTITIES, Posterior
from tcdyn.campaign.trends import Curve, curve_test, read_curve, trend
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tests.campaign.toy import RATIO, answer_of, toy

SD = 0.004


def known(beta: Array, sd: float = SD, exponents: Array | float = 0.7) -> Posterior:
    """A campaign with these beta (N,) and exponents (N,), everything independent and known to ``sd``."""
    found = solve_campaign(toy(3, len(beta)).kept)
    answers = found.values.copy()
    answers[:, 0], answers[:, 1] = beta, np.log(700.0)
    answers[:, 2] = answers[:, 1] - exponents * np.log(RATIO)
    return replace(found, values=answers, covariance=sd**2 * np.eye(N_QUANTITIES * len(beta)))


def of_tests(posterior: Posterior, name: str) -> Array:
    return np.array([t.conditions[name] for t in posterior.tests])


def test_a_line_whose_points_scatter_far_beyond_their_uncertainty_is_that_of_ordinary_least_squares() -> (
    None
):
    """Slope, its standard error, Student's interval and the chance of none: those of scipy's regression."""
    beta = 0.7 + np.array([0.02, -0.01, 0.0, -0.03, 0.01, 0.02, -0.02, -0.01])
    posterior = known(beta, 1e-8)
    load = of_tests(posterior, "load_N")
    found, theirs = trend(posterior, "load_N"), stats.linregress(load, beta)
    assert found is not None
    (slope,), freedom = found.slopes, len(beta) - 2
    assert (slope.value, slope.u) == pytest.approx((theirs.slope, theirs.stderr), rel=1e-5)
    reach = stats.t.isf(0.025, freedom) * theirs.stderr
    assert (slope.low95, slope.high95) == pytest.approx(
        (theirs.slope - reach, theirs.slope + reach), rel=1e-5
    )
    assert found.p_value[0] == pytest.approx(theirs.pvalue, rel=1e-4)
    left = beta - theirs.intercept - theirs.slope * load
    assert found.scatter == pytest.approx(np.sqrt(left @ left / freedom), rel=1e-5)


def test_a_trend_is_surest_at_the_mean_of_its_tests_and_loses_by_its_slope_beside_it() -> None:
    """Independent tests on their line: u of the slope is sd/sqrt(sum (x - mean)^2), against the mean nothing else."""
    posterior = known(np.full(8, 0.7))
    load = of_tests(posterior, "load_N")
    posterior = known(0.7 - 3e-5 * (load - load.mean()))
    found = trend(posterior, "load_N")
    assert found is not None
    u = SD / np.sqrt(np.sum((load - load.mean()) ** 2))
    assert (found.slopes[0].value, found.slopes[0].u, found.scatter) == pytest.approx(
        (-3e-5, u, 0.0), rel=1e-6
    )
    assert found.p_value[0] == pytest.approx(2 * stats.norm.sf(3e-5 / u), rel=1e-6)
    value, within = found.evaluate(load.mean() + np.array([0.0, 500.0]))
    assert value == pytest.approx([0.7, 0.685])
    assert within == pytest.approx([0.0, 500.0 * u], abs=1e-9)


def test_a_line_over_two_conditions_asks_for_a_test_more_than_one_over_one() -> None:
    """The k-th of these tests has the k-th load and the k-th speed: no two alike."""
    kept = toy(3).kept
    three, four = (solve_campaign([kept[k] for k in (0, 5, 10, 15)[:count]]) for count in (3, 4))
    assert trend(three, "load_N") is not None
    assert trend(three, "load_N", "sliding_speed_m_s") is None
    assert trend(four, "load_N", "sliding_speed_m_s") is not None


def test_a_curve_has_two_rows_or_more(tmp_path: Path) -> None:
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


def test_an_exponent_that_rises_by_a_tenth_while_the_speed_doubles_is_told_so() -> None:
    """16 tests: u of one is sd sqrt(2)/ln(ratio), of the mean a quarter of it."""
    speed = of_tests(known(np.full(16, 0.7)), "entraining_speed_m_s")
    each = 0.6 + 0.1 * np.log2(speed / 10.0)
    law = speed_law(known(np.full(16, 0.7), exponents=each))
    assert law.each == pytest.approx(each)
    one = SD * np.sqrt(2) / np.log(RATIO)
    assert law.u_within == pytest.approx(np.full(16, one))
    assert law.by_speed is not None
    doubled = np.log2(speed) - np.log2(speed).mean()
    assert (law.by_speed.value, law.by_speed.u) == pytest.approx(
        (0.1, one / np.sqrt(doubled @ doubled))
    )
    even = speed_law(known(np.full(16, 0.7)))
    assert (even.exponent.value, even.exponent.u, even.scatter) == pytest.approx(
        (0.7, one / 4, 0.0)
    )
    assert speed_law(known(np.full(3, 0.7))).by_speed is None


def test_what_a_curve_is_uncertain_by_is_one_error_of_all_its_points() -> None:
    """V = sd^2 + u^2 between all: by Sherman and Morrison chi-squared has u^2 (sum d)^2/(sd^2 + n u^2) less, and the
    offset is the mean with u^2 = sd^2/n + u^2. The departures d are such that the shape is accepted (2.6 on 3)."""
    off = np.array([0.008, 0.012, 0.003, 0.007])
    load = of_tests(known(np.full(4, 0.7)), "load_N")
    line = 0.72 - 2e-5 * np.array([0.0, 4000.0])
    curve = Curve("m.csv", "load_N", np.array([0.0, 4000.0]), line, np.full(2, 0.03))
    found = curve_test(known(0.72 - 2e-5 * load + off), curve)
    n, u = len(off), 0.03
    chi2 = (off @ off - u**2 * off.sum() ** 2 / (SD**2 + n * u**2)) / SD**2
    apart = off - off.mean()
    assert (found.chi2, found.shape_chi2) == pytest.approx((chi2, apart @ apart / SD**2))
    chances = stats.chi2.sf(chi2, n), stats.chi2.sf(found.shape_chi2, n - 1)
    assert (found.p_value, found.shape_p_value) == pytest.approx(chances)
    assert (found.offset.value, found.offset.u) == pytest.approx(
        (off.mean(), np.sqrt(SD**2 / n + u**2))
    )
    two = Curve(
        "m.csv", "load_N", np.sort(load)[1:3], np.array([0.7, 0.7]), np.zeros(2)
    )  # its ends are in it
    assert len(curve_test(known(np.full(4, 0.7)), two).inside) == 2


@pytest.fixture(scope="module")
def whole() -> JoinedCampaign:
    found = joined({t.name: answer_of(t) for t in toy(1).kept})
    assert found is not None
    return found


def codes(whole: JoinedCampaign) -> set[str]:
    return {f.code for f in whole.findings}


def test_a_campaign_tells_an_exponent_two_u_from_the_stated_one(whole: JoinedCampaign) -> None:
    for n, told in (
        (0.667 + 0.019, False),
        (0.667 + 0.021, True),
        (0.667 - 0.021, True),
    ):  # u is 0.01
        law = replace(whole.speed_law, exponent=Estimate.normal(n, 0.01), p_value=0.5)
        assert ("campaign.exponent" in codes(replace(whole, speed_law=law))) == told
    one = replace(whole.posterior, tests=whole.posterior.tests[:1])
    assert "campaign.exponent" not in codes(
        replace(whole, speed_law=law, posterior=one)
    )  # a test alone says so itself


def test_a_campaign_tells_a_bent_power_law_and_a_junction_far_from_its_place(
    whole: JoinedCampaign,
) -> None:
    for chance, told in ((0.02, False), (0.005, True)):
        assert (
            "campaign.power_law"
            in codes(replace(whole, speed_law=replace(whole.speed_law, p_value=chance)))
        ) == told
    for z, told in ((3.9, False), (-3.9, False), (4.1, True), (-4.1, True)):
        assert ("campaign.junction" in codes(replace(whole, pulls={"fast": {"e": z}}))) == told
