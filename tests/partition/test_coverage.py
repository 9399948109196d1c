"""The stated uncertainties of beta, h and lag, and the cross-check's alarms, over rigs drawn from the stated ones."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from scipy import stats

from tcdyn.rig.rigfile import load_rig
from tcdyn.simulate.truth import draw_truth
from tests.partition.coverage_study import report, study
from tests.partition.junction_study import moved_junction
from tests.partition.study_rigs import study_rig

RIGS = 40


@pytest.mark.study
def test_intervals_hold_the_truth_as_often_as_they_say(draws: Callable[[int], int]) -> None:
    """95 % intervals over 40 rigs: at least as many hold as the 0.1 % point of the binomial law for 93 %."""
    done = study(rigs := draws(RIGS))
    assert done["failed"].sum() == 0
    least = stats.binom.ppf(0.001, rigs, 0.93) / rigs
    table = report(done).set_index("what")
    assert (table["covered by 95 %"] >= least).all(), table.to_string()
    # and not by being wide: a spread of z below 0.6 over 40 rigs would be an interval nearly twice too long
    loosest = (stats.chi2.ppf(1e-4, rigs) / rigs) ** 0.5
    depths = table.index.str.startswith("depth")
    assert (table["rms z"][~depths] > loosest).all(), table.to_string()
    # junctions are placed with a tolerance for what the rim model misses, wider than what this simulated rig shows
    assert (table["rms z"][depths] > 0.55 * loosest).all(), table.to_string()
    # at 7 % false alarms, more than 7 in 40 happen once in 1000 studies
    assert done["alarm"].sum() <= stats.binom.ppf(0.999, rigs, 0.07), done["sentence"].to_string()


@pytest.mark.study
def test_a_wrong_exponent_is_named() -> None:
    """h with the power 1.25 of the speed, against at most 0.8 stated: one test knows the power to 0.05 or so, since a
    part of what tells h apart may be an uneven bore."""
    true = draw_truth(3, load_rig(), exponent=1.25)
    checked = study_rig(3, "D4", truth=true).analyse().crosscheck
    assert not checked.agree
    assert "speed exponent" in checked.sentence


@pytest.mark.study
def test_a_junction_half_a_millimetre_off_is_named() -> None:
    """Five standard uncertainties; the power for smaller ones is measured by `junction_study`."""
    true = moved_junction(draw_truth(3, load_rig()), "fast", "e", 0.5e-3)
    checked = study_rig(3, "D4", truth=true).analyse().crosscheck
    assert not checked.agree
    assert "junction e of the fast disk" in checked.sentence


@pytest.mark.study
def test_a_lag_left_uncompensated_is_named() -> None:
    made = study_rig(3, "D4", lag_error_s=-0.6)
    checked = made.analyse().crosscheck
    assert not checked.agree
    assert "lag" in checked.sentence
