"""Coverage of the uncertainties of beta, h and lag, and false alarms of the cross-check, over drawn
rigs."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from scipy import stats

from tcdyn.rig.rigfile import load_rig
from tcdyn.simulate.truth import draw_truth
from tests.partition.coverage_study import report, run_study
from tests.partition.junction_study import with_shifted_junction
from tests.partition.study_rigs import study_rig

RIGS = 20
FEW_RIGS = 2


@pytest.mark.study
def test_intervals_have_the_stated_coverage(draws: Callable[[int], int]) -> None:
    """95 % intervals over 20 rigs: each count is at least the 0.1 % point of the binomial law for
    93 %."""
    is_full = draws(RIGS) == RIGS
    rigs = RIGS if is_full else FEW_RIGS  # a rig takes half a minute
    rows = run_study(rigs)
    assert rows["failed"].sum() == 0
    min_coverage = stats.binom.ppf(0.001, rigs, 0.93) / rigs
    table = report(rows).set_index("what")
    assert (table["covered by 95 %"] >= min_coverage).all(), table.to_string()
    # intervals must not be too wide: an rms z below 0.6 over many rigs means intervals nearly twice
    # too long
    min_rms_z = (stats.chi2.ppf(1e-4, rigs) / rigs) ** 0.5
    is_depth = table.index.str.startswith("depth")
    assert (table["rms z"][~is_depth] > min_rms_z).all(), table.to_string()
    # depths include a tolerance for rim-model errors, which is larger than the errors of this
    # simulated rig
    assert (table["rms z"][is_depth] > 0.55 * min_rms_z).all(), table.to_string()
    # with a false-alarm rate of 7 %, more than this number occurs once in 1000 studies
    assert rows["alarm"].sum() <= stats.binom.ppf(0.999, rigs, 0.07), rows["sentence"].to_string()


@pytest.mark.study
def test_wrong_speed_exponent_is_identified() -> None:
    """h grows with the power 1.25 of the speed, at most 0.8 is specified.

    One test determines the power to about 0.05, since uneven bore contact can explain part of the
    difference in h.
    """
    truth = draw_truth(3, load_rig(), exponent=1.25)
    crosscheck = study_rig(3, "D4", truth=truth).analyse().crosscheck
    assert not crosscheck.agree
    assert "speed exponent" in crosscheck.sentence


@pytest.mark.study
def test_junction_half_a_millimetre_off_is_identified() -> None:
    """Five standard uncertainties; `junction_study` measures the power for smaller deviations."""
    truth = with_shifted_junction(draw_truth(3, load_rig()), "fast", "e", 0.5e-3)
    crosscheck = study_rig(3, "D4", truth=truth).analyse().crosscheck
    assert not crosscheck.agree
    assert "junction e of the fast disk" in crosscheck.sentence


@pytest.mark.long
@pytest.mark.study
def test_uncompensated_lag_is_identified() -> None:
    study = study_rig(3, "D4", lag_error_s=-0.6)
    crosscheck = study.analyse().crosscheck
    assert not crosscheck.agree
    assert "lag" in crosscheck.sentence
