"""Comparison of chain structures for plunges: a wrong structure is reported, and the widened
interval covers the lag."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from plunge_simulator import same_pairs, simulate
from plunge_study import OWN_LAG_S, make_runs

from immersion.chain_structures import StructureComparison, StructureRow, held_out, log_evidence
from immersion.plunge_fit import identify_plunges, with_structure_uncertainty
from immersion.plunge_posterior import LagScan, scan_common_lag
from immersion.plunge_result import PlungeFit
from tcdyn.chain import STRUCTURES
from tcdyn.core.estimate import Z95, Estimate
from tcdyn.core.messages.plunge import probability_text
from tcdyn.rig.rigfile import load_rig

SETUP = load_rig().disk_setup("fast")
TRUE_S = 0.75 + OWN_LAG_S


@cache
def fitted(structure: str, lag_s: float, second_lag: bool = True) -> tuple[PlungeFit, PlungeFit]:
    """The fit of one pair of plunges before and after the comparison, with two equal true lags or
    one."""
    rng = np.random.default_rng(5)
    d = same_pairs(1, lag=lag_s)
    first_share = 0.5 if second_lag else 1.0
    d.tau1 = first_share * lag_s + 0 * d.tau1
    d.tau2 = (1 - first_share) * lag_s + 1e-5 + 0 * d.tau2
    times, readings = simulate(d, 60.0, rng)
    before = identify_plunges(
        make_runs(d, times, readings, rng), SETUP, structure=structure, alternatives=()
    )  # type: ignore[arg-type]
    return before, with_structure_uncertainty(before)


@pytest.mark.study
def test_one_lag_fitted_to_two_lags_is_contradicted_with_figures() -> None:
    before, after = fitted("P1", 0.75)
    structures = after.structures
    assert structures is not None
    assert not before.common_lag_s.contains(TRUE_S)  # the wrong structure alone misses the true lag
    assert structures.is_contradicted
    assert structures.best.structure == "P2"
    (finding,) = structures.findings
    assert after.findings[0] == finding
    assert (finding.code, finding.severity, finding.numbers["structures"]) == (
        "plunge.structure",
        "warning",
        ("P1", "P2"),
    )
    sentence = finding.sentence
    for word in ("contradict", "P1", "P2", "chi-square lower by", "instead of", "structure=P2"):
        assert word in sentence
    held_out_evidence = {r.structure: r.held_out for r in structures.rows}
    # the held-out plunge agrees: at least twenty times as probable
    assert held_out_evidence["P1"] > held_out_evidence["P2"] + 6.0


@pytest.mark.long
@pytest.mark.e2e
def test_widened_interval_covers_the_lag_missed_by_the_wrong_structure() -> None:
    before, after = fitted("P1", 0.75)
    assert after.common_lag_s.contains(TRUE_S)
    # the lags remain those of the requested structure
    assert after.common_lag_s.value == before.common_lag_s.value
    assert after.common_lag_s.u == pytest.approx(np.sqrt(after.lag_covariance.mean()), rel=0.1)
    assert {s.source for s in after.budget} >= {"everything", "choice of chain structure"}


@pytest.mark.long
@pytest.mark.study
def test_true_structure_gives_no_warning_and_little_widening() -> None:
    before, after = fitted("P2", 0.75)
    assert after.structures is not None
    assert after.structures.findings == ()
    assert after.common_lag_s.contains(TRUE_S)
    assert after.common_lag_s.u < 1.2 * before.common_lag_s.u


@pytest.mark.long
@pytest.mark.study
def test_one_lag_is_not_contradicted_if_it_is_true() -> None:
    structures = fitted("P1", 0.3, second_lag=False)[1].structures
    assert structures is not None
    assert not structures.is_contradicted
    # neither simplicity nor flexibility is rewarded
    assert min(r.probability for r in structures.rows if r.structure in ("P1", "P2")) > 0.05


def pair_with_dead_time(lag_s: float, samples: int) -> tuple[PlungeFit, PlungeFit]:
    """Fit before and after the comparison of two lags with a dead time of ``samples``."""
    rng = np.random.default_rng(8)
    d = same_pairs(1, lag=lag_s)
    times, readings = simulate(d, 60.0, rng)
    delayed = np.concatenate([np.repeat(readings[:1], samples, axis=0), readings[:-samples]])
    before = identify_plunges(make_runs(d, times, delayed, rng), SETUP, alternatives=())
    return before, with_structure_uncertainty(before)


@pytest.mark.study
def test_two_lags_with_dead_time_are_covered_although_not_requested() -> None:
    """None of the three basic structures has both: the common lag would be nine standard
    uncertainties off."""
    before, after = pair_with_dead_time(0.6, 15)
    expected_s = 0.6 + 15 / 75 + OWN_LAG_S
    assert not before.common_lag_s.contains(expected_s)
    assert after.common_lag_s.contains(expected_s)
    assert after.structures is not None
    assert after.structures.best.structure == "P2D"
    assert after.structures.is_contradicted
    assert "structure=P2D" in after.structures.sentence


def test_three_lags_are_recommended_if_they_fit_best() -> None:
    structures = comparison("P2", row("P2", 1.3, 1e-6, 60.0), row("P3", 0.9, 0.999999))
    assert structures.is_contradicted
    assert structures.conclusion.numbers["structures"] == ("P2", "P3")
    assert "calibrate with structure=P3" in structures.sentence


@pytest.mark.long
@pytest.mark.study
def test_integrated_evidence_equals_laplace_approximation_for_a_normal_posterior() -> None:
    # at the noise of the rig it is not normal: the marginal is narrower by a quarter than its
    # curvature says, and ln 3/4 = -0.29
    best = fitted("P2", 0.75)[0].optimum
    problem = best.problem
    models = [
        replace(m, blocks=replace(m.blocks, readings_degC=y))
        for m, y in zip(problem.models, best.predictions_degC)
    ]
    noise = [replace(n, sd_K=n.sd_K / 30) for n in problem.noise]
    low_noise = replace(problem, models=tuple(models), noise=tuple(noise)).optimise(best.theta)
    scan, maximum, _ = scan_common_lag(low_noise)
    # both omit the same constants except the width of one normalised direction: mean of six lags,
    # ln sqrt(2 pi / 6)
    expected = 0.5 * np.log(2 * np.pi / 6)
    # each search is accurate to 0.05
    assert log_evidence(scan, maximum) - maximum.laplace == pytest.approx(expected, abs=0.1)


@pytest.mark.study
def test_single_plunge_has_no_held_out_evidence() -> None:
    rng = np.random.default_rng(6)
    d = same_pairs(1)
    times, readings = simulate(d, 60.0, rng)
    fit = identify_plunges(make_runs(d, times, readings, rng)[:1], SETUP, alternatives=())
    assert held_out(fit.optimum) is None


def row(structure: str, lag: float, probability: float, chi_square: float = 0.0) -> StructureRow:
    """A row of the comparison."""
    return StructureRow(structure, Estimate.normal(lag, 0.05), chi_square, probability, None)


def comparison(chosen: str, *rows: StructureRow, u_structure: float = 0.0) -> StructureComparison:
    """A comparison with this selected structure and these rows."""
    return StructureComparison(chosen, rows, np.full((6, 6), u_structure**2), 0.05)


def test_indistinguishable_structures_give_a_warning_only_if_the_lag_depends_on_them() -> None:
    indistinguishable = comparison("P2", row("P1", 0.70, 0.4), row("P2", 0.70, 0.6))
    assert "cannot tell" in indistinguishable.sentence
    assert "hardly depends" in indistinguishable.sentence
    assert indistinguishable.findings == ()
    lag_depends = comparison("P2", row("P1", 0.80, 0.4), row("P2", 0.70, 0.6), u_structure=0.063)
    assert [f.sentence for f in lag_depends.findings] == [lag_depends.sentence]
    assert "increased from 0.050 s to 0.080 s" in lag_depends.sentence
    decided = comparison("P2", row("P1", 0.9, 1e-4, 20.0), row("P2", 0.7, 0.9999))
    assert "support P2" in decided.sentence
    assert "held" not in "".join(decided.table().columns)


@pytest.mark.parametrize(
    ("first_share", "text"),
    [
        (1e-5, "below 0.1 %"),
        (0.0042, "0.4 %"),
        (0.28, "28 %"),
        (0.998, "99.8 %"),
        (0.9999, "above 99.9 %"),
    ],
)
def test_probabilities_are_printed_with_sensible_digits(first_share: float, text: str) -> None:
    assert probability_text(first_share) == text


@pytest.mark.e2e
def test_comparison_is_available_as_json_and_as_a_table_of_sensible_digits() -> None:
    structures = fitted("P1", 0.75)[1].structures
    assert structures is not None
    data = structures.to_dict()
    assert data["contradicted"] is True
    assert len(data["candidates"]) == len(STRUCTURES)  # type: ignore[arg-type]
    assert sum(c["probability"] for c in data["candidates"]) == pytest.approx(1.0)  # type: ignore[attr-defined]
    table = structures.table()
    assert table["chain"].str.contains("used here").sum() == 1
    assert all(
        len(text.split(" +- ")[1].replace("0.", "").lstrip("0")) == 2
        for text in table["common lag [s]"]
    )


@pytest.mark.long
@pytest.mark.e2e
def test_interval_of_a_channel_has_the_skewness_of_the_common_interval() -> None:
    scan: LagScan = replace(
        fitted("P2", 0.75)[0].scan, mean_s=0.7, sd_s=0.1, low95_s=0.55, high95_s=0.95
    )
    common_only = scan.skewed_estimate(0.72, 1.0, 0.0)
    assert (common_only.low95, common_only.high95, common_only.u) == pytest.approx(
        (0.57, 0.97, 0.1)
    )
    mostly_differential = scan.skewed_estimate(0.72, 1.0, 1.0**2)
    # a large normal component makes the interval symmetric
    assert mostly_differential.high95 - 0.72 == pytest.approx(Z95 * mostly_differential.u, rel=0.02)
    fit = fitted("P2", 0.75)[1]
    c = fit.common_lag_s
    skew = (c.high95 - c.value) / (c.value - c.low95)
    for lag in fit.lag_s.values():
        assert (lag.high95 - lag.value) / (lag.value - lag.low95) == pytest.approx(skew, rel=0.1)
