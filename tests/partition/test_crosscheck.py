"""The cross-check counts correlations, speaks when ways disagree, and is quiet when they do not."""

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


def known(**values: float) -> dict[str, Estimate]:
    return {name.replace("_", " "): Estimate.normal(value, 0.01) for name, value in values.items()}


def draws(
    common: float, own: float, names: tuple[str, ...], seed: int = 0
) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    shared = rng.normal(0, common, 20000)
    return {n: 0.66 + shared + rng.normal(0, own, 20000) for n in names}


def test_common_errors_do_not_hide_a_disagreement() -> None:
    d = draws(0.02, 0.002, ("speed law", "joint fast"))
    found = cross_check(known(speed_law=0.66, joint_fast=0.672), d)
    assert found.z == pytest.approx(
        0.012 / (0.002 * np.sqrt(2)), rel=0.03
    )  # 1 % sampling of 20000 draws, thrice
    assert not found.agree
    assert "NOT" in found.sentence


def test_sound_ways_agree_at_the_stated_rate() -> None:
    names = ("speed law", "cooling fast", "cooling slow", "joint fast", "joint slow")
    d = draws(0.01, 0.005, names)
    rng = np.random.default_rng(5)
    alarms = 0
    for _ in range(300):
        ways = {n: Estimate.normal(0.66 + rng.normal(0, 0.005), 0.01) for n in names}
        alarms += not cross_check(ways, d).agree
    assert alarms <= 21  # 7 %: ten pairs beyond three standard deviations happen in about 2 %


def test_shares_that_do_not_add_to_one_name_the_suspect() -> None:
    d = draws(0.0, 0.002, ("joint fast", "joint slow"))
    found = cross_check(known(joint_fast=0.70, joint_slow=0.62), d)
    assert "do not add to one" in found.sentence


def two(z: float, count: int = 2) -> CrossCheck:
    """Ways of which two are ``z`` of their difference apart, all others with the first."""
    names = ("speed law", "joint fast", "joint slow")[:count]
    d = draws(0.0, 0.002, names)
    apart = z * float(np.std(d["speed law"] - d["joint fast"]))
    return cross_check(
        {n: Estimate.normal(0.66 + apart * (n == "joint fast"), 0.01) for n in names}, d
    )


def test_the_chance_of_a_disagreement_is_that_of_the_normal_law_within_the_draws_and_beyond_them() -> (
    None
):
    assert two(2.0).p_value == pytest.approx(
        2 * stats.norm.sf(2.0), abs=0.006
    )  # 20000 draws: 0.0015; four of those
    assert two(6.0).p_value == pytest.approx(2 * stats.norm.sf(6.0), rel=1e-6)
    three = two(6.0, 3)
    assert three.p_value == pytest.approx(3 * 2 * stats.norm.sf(three.z), rel=1e-6)  # three pairs
    assert len(three.pairs) == 3


def test_what_the_data_contradict_is_told_worst_first_and_what_they_pull_most_otherwise() -> None:
    d = draws(0.01, 0.005, ("speed law", "joint fast"))
    ways = known(speed_law=0.66, joint_fast=0.66)

    def pulled(z: float, chance: float) -> Tension:
        return Tension(
            info("stated.value", subject="fast", name=f"{z:g}", source="x"), z, chance, 0.01
        )

    calm, strained, off, far = (
        pulled(0.3, 0.9),
        pulled(1.5, 0.3),
        pulled(-4.0, 0.002),
        pulled(5.0, 1e-4),
    )
    assert cross_check(ways, d, [calm]).largest_tension is None
    found = cross_check(ways, d, [calm, strained])
    assert (found.agree, found.largest_tension, found.suspects) == (True, strained, ())
    found = cross_check(ways, d, [calm, off, strained, far])
    assert (found.finding.code, found.suspects, found.largest_tension) == (
        "ways.contradicted",
        (far, off),
        far,
    )
    apart = cross_check(known(speed_law=0.66, joint_fast=0.70), d, [far])
    assert apart.finding.code == "ways.apart"


def test_the_largest_of_several_pulls_is_judged_with_their_correlation() -> None:
    """Two alike count once, two apart twice: P(max |z| > x) = 1 - (1 - 2 sf(x))^n; 20000 draws know it to 0.003."""
    one = 2 * stats.norm.sf(1.5)
    for correlation, chance in ((np.ones((2, 2)), one), (np.eye(2), 1 - (1 - one) ** 2)):
        np.testing.assert_allclose(
            covariance_root(correlation) @ covariance_root(correlation).T, correlation, atol=1e-12
        )
        largest = sample_largest_pulls([DepthTest("fast", np.zeros(2), correlation, {}, 1e-4)])
        assert probability_of_pull(-1.5, largest, 2) == pytest.approx(chance, abs=0.012)
    assert probability_of_pull(7.0, largest, 2) == pytest.approx(
        2 * 2 * stats.norm.sf(7.0), rel=1e-9
    )
    assert sample_largest_pulls([]).max() == 0.0


def ways_of(
    scale: float, u: float = 0.03
) -> tuple[dict[str, Estimate], dict[str, Estimate], dict[str, np.ndarray]]:
    """Answers of a test of beta 0.7 whose true power is ``scale`` of the logged one; draws of both joint fits, with an
    error that both share."""
    shares = {"joint fast": 0.7 * scale, "joint slow": 1 - 0.3 * scale}
    answers = {way: Estimate.normal(0.7, 0.01) for way in ESTIMATORS}
    answers |= {h: Estimate.normal(700.0, 9.0) for hs in H_KEYS.values() for h in hs}
    answers |= {way: Estimate.normal(value, u) for way, value in shares.items()}
    both = {
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
        answers,
        both,
        {way: shared + rng.normal(value, u, 4000) for way, value in shares.items()},
    )


@pytest.mark.parametrize(
    ("scale", "u", "units"),
    [
        (1.08, 0.001, None),  # within a tenth
        (1.4, 0.1, None),  # u of the difference is 0.14: not five of it
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
def test_a_power_that_is_not_the_heat_of_both_disks_is_told_with_the_units_that_explain_it(
    scale: float, u: float, units: list[str] | None
) -> None:
    found = [f for f in impossibility_findings(*ways_of(scale, u)) if f.code == "power.scale"]
    assert len(found) == (units is not None)
    for one in found:
        assert one.numbers["scale"] == pytest.approx(scale)
        assert one.numbers["u"] == pytest.approx(
            u * np.sqrt(2), rel=0.06
        )  # 4000 draws tell it to 1.1 %
        assert list(one.numbers["units"]) == units


def test_shares_of_a_power_off_by_more_than_two_are_withheld_where_that_is_sure() -> None:
    every = {"both beta", "both h_fast", "both h_slow", "both exponent"}
    for scale, u, gone in (
        (1.9, 0.01, False),
        (2.1, 0.01, True),
        (0.6, 0.01, False),
        (0.4, 0.01, True),
        (2.1, 0.2, False),
    ):
        answers, both, drawn = ways_of(scale, u)
        assert (every <= impossible_keys(answers, both)) == gone
        told = [
            f
            for f in impossibility_findings(answers, both, drawn)
            if f.code == "answers.impossible"
        ]
        assert ("joint, both disks" in [way for f in told for way in f.numbers["ways"]]) == gone
    answers, both, _ = ways_of(1.0)
    assert impossible_keys(answers, both) == frozenset()
    assert impossible_keys(answers, both | {"exponent": Estimate.normal(0.7, 5.5)}) == {
        "both exponent"
    }
    assert impossible_keys(answers | {"h cooling fast": Estimate.normal(-3.0, 9.0)}, both) == {
        "cooling fast",
        "h cooling fast",
    }


def structure(log_odds: float, beta: float = 0.7, u: float = 0.004, z: float = 0.0) -> ModelForm:
    return ModelForm(
        "faces", Estimate.normal(beta, u), Estimate.normal(0.67, 0.02), (), log_odds, 10.0, z
    )


def test_a_structure_is_named_where_it_is_far_likelier_and_agrees_with_the_speed_law() -> None:
    assumed = structure(0.0)
    for other, named in (
        (structure(7.9), False),
        (structure(8.1), True),
        (structure(8.1, z=-3.1), False),
        (structure(8.1, z=-2.9), True),
    ):
        found = ModelForms((other, assumed), (0.9, 0.1), 0.69, 0.71, assumed)
        assert (found.preferred is other) == named
        assert bool(found.findings) == named


def test_the_headline_holds_while_the_likeliest_structure_is_near_and_the_range_narrow() -> None:
    """Within two of the larger u of the two, and 0.02 to either side."""
    assumed = structure(0.0)
    for beta, u, half, holds in (
        (0.7075, 0.002, 0.019, True),
        (0.7085, 0.002, 0.019, False),
        (0.7, 0.002, 0.021, False),
        (0.7185, 0.01, 0.019, True),
        (0.6925, 0.002, 0.019, True),
        (0.69, 0.002, 0.019, False),
    ):
        best = structure(9.0, beta, u)
        found = ModelForms((best, assumed), (0.9, 0.1), 0.7 - half, 0.7 + half, assumed)
        assert found.estimate_holds == holds
        assert found.findings[0].severity is (Severity.INFO if holds else Severity.WARNING)
