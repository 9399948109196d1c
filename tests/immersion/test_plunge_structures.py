"""Which chain structure the plunges speak for: the wrong one is named, and its lag's interval then holds the truth."""

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
    """The fit of one pair of plunges before and after the comparison; two equal lags behind, or one."""
    rng = np.random.default_rng(5)
    d = same_pairs(1, lag=lag_s)
    share = 0.5 if second_lag else 1.0
    d.tau1, d.tau2 = share * lag_s + 0 * d.tau1, (1 - share) * lag_s + 1e-5 + 0 * d.tau2
    times, readings = simulate(d, 60.0, rng)
    before = identify_plunges(
        make_runs(d, times, readings, rng), SETUP, structure=structure, alternatives=()
    )  # type: ignore[arg-type]
    return before, with_structure_uncertainty(before)


@pytest.mark.study
def test_one_lag_fitted_to_two_is_contradicted_in_one_sentence_with_figures() -> None:
    before, after = fitted("P1", 0.75)
    found = after.structures
    assert found is not None
    assert not before.common_lag_s.contains(TRUE_S)  # why this is needed: wrong, and sure of itself
    assert found.contradicted
    assert found.best.structure == "P2"
    (finding,) = found.findings
    assert after.findings[0] == finding
    assert (finding.code, finding.severity, finding.numbers["structures"]) == (
        "plunge.structure",
        "warning",
        ("P1", "P2"),
    )
    warning = finding.sentence
    for word in ("contradict", "P1", "P2", "chi-square lower by", "instead of", "structure=P2"):
        assert word in warning
    held = {r.structure: r.held_out for r in found.rows}
    assert (
        held["P1"] > held["P2"] + 6.0
    )  # the held-out plunge agrees: twenty times as probable, at least


def test_the_widened_interval_holds_the_truth_that_the_wrong_structure_missed() -> None:
    before, after = fitted("P1", 0.75)
    assert after.common_lag_s.contains(TRUE_S)
    assert (
        after.common_lag_s.value == before.common_lag_s.value
    )  # the lags stay those of the structure asked for
    assert after.common_lag_s.u == pytest.approx(np.sqrt(after.lag_covariance.mean()), rel=0.1)
    assert {s.source for s in after.budget} >= {"everything", "choice of chain structure"}


@pytest.mark.study
def test_the_right_structure_is_neither_warned_of_nor_widened_much() -> None:
    before, after = fitted("P2", 0.75)
    assert after.structures is not None
    assert after.structures.findings == ()
    assert after.common_lag_s.contains(TRUE_S)
    assert after.common_lag_s.u < 1.2 * before.common_lag_s.u


@pytest.mark.study
def test_one_lag_is_not_contradicted_where_there_is_one() -> None:
    found = fitted("P1", 0.3, second_lag=False)[1].structures
    assert found is not None
    assert not found.contradicted
    # neither is rewarded for being simple, nor punished for being rich
    assert min(r.probability for r in found.rows if r.structure in ("P1", "P2")) > 0.05


def late_pair(lag_s: float, samples: int) -> tuple[PlungeFit, PlungeFit]:
    """Two lags, and a dead time of so many samples."""
    rng = np.random.default_rng(8)
    d = same_pairs(1, lag=lag_s)
    times, readings = simulate(d, 60.0, rng)
    late = np.concatenate([np.repeat(readings[:1], samples, axis=0), readings[:-samples]])
    before = identify_plunges(make_runs(d, times, late, rng), SETUP, alternatives=())
    return before, with_structure_uncertainty(before)


@pytest.mark.study
def test_two_lags_behind_a_dead_time_are_covered_though_no_one_asked_for_them() -> None:
    """Of three candidates none had both: the common lag was nine standard uncertainties off, and called sure."""
    before, after = late_pair(0.6, 15)
    true_s = 0.6 + 15 / 75 + OWN_LAG_S
    assert not before.common_lag_s.contains(true_s)
    assert after.common_lag_s.contains(true_s)
    assert after.structures is not None
    assert after.structures.best.structure == "P2D"
    assert after.structures.contradicted
    assert "structure=P2D" in after.structures.sentence


def test_three_lags_are_offered_where_they_fit_best_for_a_record_holds_any_number() -> None:
    found = comparison("P2", row("P2", 1.3, 1e-6, 60.0), row("P3", 0.9, 0.999999))
    assert found.contradicted
    assert found.conclusion.numbers["structures"] == ("P2", "P3")
    assert "calibrate with structure=P3" in found.sentence


@pytest.mark.study
def test_evidence_integrated_over_the_lag_is_laplace_s_where_the_lag_is_normal() -> None:
    # at the rig's noise it is not: the marginal is narrower by a quarter than its curvature says, and ln 3/4 is -0.29
    best = fitted("P2", 0.75)[0].optimum
    problem = best.problem
    models = [
        replace(m, blocks=replace(m.blocks, readings_degC=y))
        for m, y in zip(problem.models, best.predictions_degC)
    ]
    noise = [replace(n, sd_K=n.sd_K / 30) for n in problem.noise]
    sharp = replace(problem, models=tuple(models), noise=tuple(noise)).optimise(best.theta)
    scan, at, _ = scan_common_lag(sharp)
    # both leave out the same constants but the width of one normalised direction: mean of six lags, ln sqrt(2 pi / 6)
    expected = 0.5 * np.log(2 * np.pi / 6)
    assert log_evidence(scan, at) - at.laplace == pytest.approx(
        expected, abs=0.1
    )  # a search tells each to 0.05


@pytest.mark.study
def test_one_plunge_alone_holds_nothing_out() -> None:
    rng = np.random.default_rng(6)
    d = same_pairs(1)
    times, readings = simulate(d, 60.0, rng)
    fit = identify_plunges(make_runs(d, times, readings, rng)[:1], SETUP, alternatives=())
    assert held_out(fit.optimum) is None


def row(structure: str, lag: float, probability: float, chi_square: float = 0.0) -> StructureRow:
    return StructureRow(structure, Estimate.normal(lag, 0.05), chi_square, probability, None)


def comparison(chosen: str, *rows: StructureRow, u_structure: float = 0.0) -> StructureComparison:
    return StructureComparison(chosen, rows, np.full((6, 6), u_structure**2), 0.05)


def test_structures_that_cannot_be_told_apart_are_said_and_warned_of_only_when_the_lag_depends_on_them() -> (
    None
):
    same = comparison("P2", row("P1", 0.70, 0.4), row("P2", 0.70, 0.6))
    assert "cannot tell" in same.sentence
    assert "hardly depends" in same.sentence
    assert same.findings == ()
    apart = comparison("P2", row("P1", 0.80, 0.4), row("P2", 0.70, 0.6), u_structure=0.063)
    assert [f.sentence for f in apart.findings] == [apart.sentence]
    assert "increased from 0.050 s to 0.080 s" in apart.sentence
    sure = comparison("P2", row("P1", 0.9, 1e-4, 20.0), row("P2", 0.7, 0.9999))
    assert "support P2" in sure.sentence
    assert "held" not in "".join(sure.table().columns)


@pytest.mark.parametrize(
    ("share", "said"),
    [
        (1e-5, "below 0.1 %"),
        (0.0042, "0.4 %"),
        (0.28, "28 %"),
        (0.998, "99.8 %"),
        (0.9999, "above 99.9 %"),
    ],
)
def test_probabilities_are_said_in_digits_that_people_use(share: float, said: str) -> None:
    assert probability_text(share) == said


def test_the_comparison_travels_as_json_and_as_a_table_of_sensible_digits() -> None:
    found = fitted("P1", 0.75)[1].structures
    assert found is not None
    data = found.to_dict()
    assert data["contradicted"] is True
    assert len(data["candidates"]) == len(STRUCTURES)  # type: ignore[arg-type]
    assert sum(c["probability"] for c in data["candidates"]) == pytest.approx(1.0)  # type: ignore[attr-defined]
    table = found.table()
    assert table["chain"].str.contains("used here").sum() == 1
    assert all(
        len(text.split(" +- ")[1].replace("0.", "").lstrip("0")) == 2
        for text in table["common lag [s]"]
    )


def test_a_channel_s_interval_is_as_skew_as_the_common_one() -> None:
    scan: LagScan = replace(
        fitted("P2", 0.75)[0].scan, mean_s=0.7, sd_s=0.1, low95_s=0.55, high95_s=0.95
    )
    alone = scan.skewed_estimate(0.72, 1.0, 0.0)
    assert (alone.low95, alone.high95, alone.u) == pytest.approx((0.57, 0.97, 0.1))
    mostly_own = scan.skewed_estimate(0.72, 1.0, 1.0**2)
    assert mostly_own.high95 - 0.72 == pytest.approx(
        Z95 * mostly_own.u, rel=0.02
    )  # a large normal part evens it out
    fit = fitted("P2", 0.75)[1]
    c = fit.common_lag_s
    skew = (c.high95 - c.value) / (c.value - c.low95)
    for lag in fit.lag_s.values():
        assert (lag.high95 - lag.value) / (lag.value - lag.low95) == pytest.approx(skew, rel=0.1)
