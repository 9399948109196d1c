"""The cross-check of estimators accounts for correlations, reports disagreement, and is silent
otherwise."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy import stats

from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Severity, info
from tcdyn.partition.crosscheck import (
    CrossCheck,
    Tension,
    covariance_root,
    cross_check,
    probability_of_pull,
    sample_largest_pulls,
)
from tcdyn.partition.model_forms import (
    ESTIMATORS,
    H_KEYS,
    ModelForm,
    ModelForms,
    impossibility_findings,
    impossible_keys,
)
from tcdyn.partition.sensor_faults import DepthTest


def normal_estimates(**values: float) -> dict[str, Estimate]:
    return {name.replace("_", " "): Estimate.normal(value, 0.01) for name, value in values.items()}


def draws(
    common: float, specific: float, names: tuple[str, ...], seed: int = 0
) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    shared = rng.normal(0, common, 20000)
    return {n: 0.66 + shared + rng.normal(0, specific, 20000) for n in names}


def test_common_errors_do_not_hide_a_disagreement() -> None:
    samples = draws(0.02, 0.002, ("speed law", "joint fast"))
    result = cross_check(normal_estimates(speed_law=0.66, joint_fast=0.672), samples)
    # three times the 1 % sampling error of 20000 draws
    assert result.z == pytest.approx(0.012 / (0.002 * np.sqrt(2)), rel=0.03)
    assert not result.agree
    assert "NOT" in result.sentence


def test_consistent_estimators_agree_at_the_stated_rate() -> None:
    names = ("speed law", "cooling fast", "cooling slow", "joint fast", "joint slow")
    samples = draws(0.01, 0.005, names)
    rng = np.random.default_rng(5)
    alarms = 0
    for _ in range(300):
        estimates = {name: Estimate.normal(0.66 + rng.normal(0, 0.005), 0.01) for name in names}
        alarms += not cross_check(estimates, samples).agree
    # 7 %: one of ten pairs exceeds three standard deviations in about 2 % of draws
    assert alarms <= 21


def test_shares_that_do_not_add_to_one_name_the_suspect() -> None:
    samples = draws(0.0, 0.002, ("joint fast", "joint slow"))
    result = cross_check(normal_estimates(joint_fast=0.70, joint_slow=0.62), samples)
    assert "do not add to one" in result.sentence


def cross_check_of_shift(z: float, count: int = 2) -> CrossCheck:
    """Cross-check in which "joint fast" deviates by ``z`` standard deviations of its difference
    from the others."""
    names = ("speed law", "joint fast", "joint slow")[:count]
    samples = draws(0.0, 0.002, names)
    shift = z * float(np.std(samples["speed law"] - samples["joint fast"]))
    return cross_check(
        {n: Estimate.normal(0.66 + shift * (n == "joint fast"), 0.01) for n in names}, samples
    )


def test_p_value_of_a_disagreement_follows_the_normal_distribution() -> None:
    # four times the sampling error of 20000 draws, 0.0015
    assert cross_check_of_shift(2.0).p_value == pytest.approx(2 * stats.norm.sf(2.0), abs=0.006)
    assert cross_check_of_shift(6.0).p_value == pytest.approx(2 * stats.norm.sf(6.0), rel=1e-6)
    three = cross_check_of_shift(6.0, 3)
    assert three.p_value == pytest.approx(3 * 2 * stats.norm.sf(three.z), rel=1e-6)  # three pairs
    assert len(three.pairs) == 3


def test_contradicted_values_are_listed_worst_first_otherwise_the_largest_tension() -> None:
    samples = draws(0.01, 0.005, ("speed law", "joint fast"))
    estimates = normal_estimates(speed_law=0.66, joint_fast=0.66)

    def tension(z: float, p_value: float) -> Tension:
        return Tension(
            info("stated.value", subject="fast", name=f"{z:g}", source="x"), z, p_value, 0.01
        )

    small = tension(0.3, 0.9)
    moderate = tension(1.5, 0.3)
    large = tension(-4.0, 0.002)
    largest = tension(5.0, 1e-4)
    assert cross_check(estimates, samples, [small]).largest_tension is None
    result = cross_check(estimates, samples, [small, moderate])
    assert (result.agree, result.largest_tension, result.suspects) == (True, moderate, ())
    result = cross_check(estimates, samples, [small, large, moderate, largest])
    assert (result.finding.code, result.suspects, result.largest_tension) == (
        "ways.contradicted",
        (largest, large),
        largest,
    )
    disagreeing = cross_check(normal_estimates(speed_law=0.66, joint_fast=0.70), samples, [largest])
    assert disagreeing.finding.code == "ways.apart"


def test_a_contradicted_value_of_both_disks_allows_no_range() -> None:
    """A depth is part of the fit of both disks; a friction or an ambient may have any other
    cause."""
    samples = draws(0.01, 0.005, ("speed law", "joint fast"))
    estimates = normal_estimates(speed_law=0.66, joint_fast=0.66)
    apart = normal_estimates(speed_law=0.66, joint_fast=0.70)
    narrow = cast(
        Any,
        SimpleNamespace(
            estimate_holds=True,
            assumed=SimpleNamespace(beta=Estimate.normal(0.66, 0.005)),
            low95=0.65,
            high95=0.67,
        ),
    )
    depth = Tension(
        info("stated.depth", subject="fast", channel="e", deeper_mm=0.3, u_mm=0.1), 5.0, 1e-4, 0.01
    )
    friction = Tension(
        info("stated.value", subject="", name="friction", source="friction"), 5.0, 1e-4, 0.01
    )
    usable = "The joint fit of both disks can still be used"
    assert usable in cross_check(estimates, samples, [depth], narrow).sentence
    for tensions in ([friction], [depth, friction]):
        assert "Do NOT trust beta" in cross_check(estimates, samples, tensions, narrow).sentence
    assert "Do NOT trust beta" in cross_check(apart, samples, [], narrow).sentence


def test_p_value_of_the_largest_pull_accounts_for_correlation() -> None:
    """Two fully correlated pulls count once, two independent ones twice: P(max |z| > x) = 1 - (1 -
    2 sf(x))^n.

    20000 draws determine it to 0.003.
    """
    p_single = 2 * stats.norm.sf(1.5)
    for correlation, expected in (
        (np.ones((2, 2)), p_single),
        (np.eye(2), 1 - (1 - p_single) ** 2),
    ):
        np.testing.assert_allclose(
            covariance_root(correlation) @ covariance_root(correlation).T, correlation, atol=1e-12
        )
        largest = sample_largest_pulls([DepthTest("fast", np.zeros(2), correlation, {}, 1e-4)])
        assert probability_of_pull(-1.5, largest, 2) == pytest.approx(expected, abs=0.012)
    assert probability_of_pull(7.0, largest, 2) == pytest.approx(
        2 * 2 * stats.norm.sf(7.0), rel=1e-9
    )
    assert sample_largest_pulls([]).max() == 0.0


def estimates_with_power_scale(
    scale: float, u: float = 0.03
) -> tuple[dict[str, Estimate], dict[str, Estimate], dict[str, np.ndarray]]:
    """Estimates of a test of beta 0.7 whose true power is ``scale`` times the logged power.

    Also the estimates of the joint fit of both disks, and samples of the single-disk joint fits
    with a common error.
    """
    shares = {"joint fast": 0.7 * scale, "joint slow": 1 - 0.3 * scale}
    estimates = {name: Estimate.normal(0.7, 0.01) for name in ESTIMATORS}
    estimates |= {h: Estimate.normal(700.0, 9.0) for hs in H_KEYS.values() for h in hs}
    estimates |= {name: Estimate.normal(value, u) for name, value in shares.items()}
    joint = {
        n: Estimate.normal(x, s)
        for n, x, s in (
            ("beta", 0.7, 0.01),
            ("h_fast", 700.0, 9.0),
            ("h_slow", 270.0, 9.0),
            ("exponent", 0.67, 0.02),
        )
    }
    rng = np.random.default_rng(0)
    shared = rng.normal(0, 3 * u, 4000)
    return (
        estimates,
        joint,
        {name: shared + rng.normal(value, u, 4000) for name, value in shares.items()},
    )


@pytest.mark.parametrize(
    ("scale", "u", "units"),
    [
        (1.08, 0.001, None),  # the scale is within a tenth
        (1.4, 0.1, None),  # u of the difference is 0.14, so the deviation is below 5 u
        (1.4, 0.01, []),
        (0.6, 0.01, []),
        (4.448, 0.03, ["friction in pounds-force"]),
        (9.52, 0.03, ["speeds in rad/s", "friction in kilograms-force"]),
        (60.5, 0.3, ["speeds in revolutions per second"]),
        (
            8.2,
            0.6,
            ["speeds in rad/s", "friction in kilograms-force"],
        ),  # ln(9.81/8.2) = 0.18 is within 2 u/8.2 = 0.21
    ],
)
def test_power_scale_is_reported_with_the_units_that_explain_it(
    scale: float, u: float, units: list[str] | None
) -> None:
    findings = [
        f
        for f in impossibility_findings(*estimates_with_power_scale(scale, u))
        if f.code == "power.scale"
    ]
    assert len(findings) == (units is not None)
    for finding in findings:
        assert finding.numbers["scale"] == pytest.approx(scale)
        # the standard deviation of 4000 draws is known to 1.1 %
        assert finding.numbers["u"] == pytest.approx(u * np.sqrt(2), rel=0.06)
        assert list(finding.numbers["units"]) == units


def test_shares_are_withheld_when_the_power_is_off_by_more_than_a_factor_of_two() -> None:
    all_joint_keys = {"both beta", "both h_fast", "both h_slow", "both exponent"}
    for scale, u, withheld in (
        (1.9, 0.01, False),
        (2.1, 0.01, True),
        (0.6, 0.01, False),
        (0.4, 0.01, True),
        (2.1, 0.2, False),
    ):
        estimates, joint, samples = estimates_with_power_scale(scale, u)
        assert (all_joint_keys <= impossible_keys(estimates, joint)) == withheld
        findings = [
            f
            for f in impossibility_findings(estimates, joint, samples)
            if f.code == "answers.impossible"
        ]
        assert (
            "joint, both disks" in [estimator for f in findings for estimator in f.numbers["ways"]]
        ) == withheld
    estimates, joint, _ = estimates_with_power_scale(1.0)
    assert impossible_keys(estimates, joint) == frozenset()
    assert impossible_keys(estimates, joint | {"exponent": Estimate.normal(0.7, 5.5)}) == {
        "both exponent"
    }
    assert impossible_keys(estimates | {"h cooling fast": Estimate.normal(-3.0, 9.0)}, joint) == {
        "cooling fast",
        "h cooling fast",
    }


def model_form(log_odds: float, beta: float = 0.7, u: float = 0.004, z: float = 0.0) -> ModelForm:
    return ModelForm(
        "faces", Estimate.normal(beta, u), Estimate.normal(0.67, 0.02), (), log_odds, 10.0, z
    )


def test_model_form_is_preferred_if_much_likelier_and_consistent_with_speed_law() -> None:
    assumed = model_form(0.0)
    for other, is_preferred in (
        (model_form(7.9), False),
        (model_form(8.1), True),
        (model_form(8.1, z=-3.1), False),
        (model_form(8.1, z=-2.9), True),
    ):
        comparison = ModelForms((other, assumed), (0.9, 0.1), 0.69, 0.71, assumed)
        assert (comparison.preferred is other) == is_preferred
        assert bool(comparison.findings) == is_preferred


def test_recommended_beta_holds_near_the_likeliest_model_form_with_a_narrow_range() -> None:
    """Within two times the larger u of the two, and a half range of 0.02."""
    assumed = model_form(0.0)
    for beta, u, half_range, holds in (
        (0.7075, 0.002, 0.019, True),
        (0.7085, 0.002, 0.019, False),
        (0.7, 0.002, 0.021, False),
        (0.7185, 0.01, 0.019, True),
        (0.6925, 0.002, 0.019, True),
        (0.69, 0.002, 0.019, False),
    ):
        best = model_form(9.0, beta, u)
        comparison = ModelForms(
            (best, assumed), (0.9, 0.1), 0.7 - half_range, 0.7 + half_range, assumed
        )
        assert comparison.estimate_holds == holds
        assert comparison.findings[0].severity is (Severity.INFO if holds else Severity.WARNING)
