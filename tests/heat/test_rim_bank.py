"""The lag bank: exact under its hold, and able to stand in for any lag between its nodes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tcdyn.core.errors import InputError
from tcdyn.heat.rim import InputJump, basis_rates, lag_basis, lag_basis_means, lag_weights

DT = 1 / 75


def test_a_ramp_comes_out_late_by_one_time_constant():
    rate = np.array([2.0])
    t = np.arange(2000) * DT
    late = t[-1] - lag_basis(t, DT, rate, "foh")[-1, 0]
    assert late == pytest.approx(0.5, abs=1e-9)  # exact hold: rounding only


def test_a_switch_inside_a_sample_equals_the_same_step_on_a_grid_that_meets_it():
    rates = basis_rates(DT)
    fine = lag_basis(np.r_[np.full(13, 5.0), np.zeros(27)], DT / 10, rates, "zoh")[::10]
    coarse = lag_basis([5.0, 5.0, 0.0, 0.0], DT, rates, "zoh", [InputJump(1, 0.3, 5.0, 0.0)])
    np.testing.assert_allclose(coarse, fine, atol=1e-12)


def test_a_record_filtered_in_two_pieces_equals_one_pass():
    u = np.random.default_rng(1).standard_normal(101)
    rates = basis_rates(DT)
    for hold in ("foh", "zoh"):
        whole = lag_basis(u, DT, rates, hold)
        first = lag_basis(u[:51], DT, rates, hold)
        rest = lag_basis(u[50:], DT, rates, hold, initial=first[-1])
        np.testing.assert_allclose(np.vstack([first, rest[1:]]), whole, atol=1e-12)


@settings(max_examples=60, deadline=None)
@given(st.floats(np.log(0.31), np.log(2900.0)))
def test_any_lag_is_a_sum_of_the_banks_lags_to_a_few_parts_in_a_million(log_rate):
    rates = basis_rates(DT)
    u = np.r_[np.zeros(5), np.ones(400)]
    weights = lag_weights(rates, np.array([log_rate]))[0]
    assert weights.sum() == pytest.approx(1.0, abs=1e-12)  # the static gain is kept exactly
    own = lag_basis(u, DT, np.array([np.exp(log_rate)]), "zoh")[:, 0]
    # exp(-e^x t) is entire in x; its Chebyshev error with 40 nodes over 9.2 is below 5e-6
    assert np.abs(lag_basis(u, DT, rates, "zoh") @ weights - own).max() < 5e-6


def test_a_node_is_represented_by_itself():
    rates = basis_rates(DT)
    np.testing.assert_allclose(lag_weights(rates, np.log(rates)), np.eye(len(rates)), atol=1e-9)


@pytest.mark.parametrize("bad", [[1.0, np.nan], [[1.0]], []])
def test_a_record_that_is_no_row_of_numbers_is_refused(bad):
    with pytest.raises(InputError, match="row of finite numbers"):
        lag_basis(bad, DT, basis_rates(DT))


def test_a_switch_outside_the_record_and_a_negative_step_are_refused():
    with pytest.raises(InputError, match="outside"):
        lag_basis([1.0, 1.0], DT, basis_rates(DT), "zoh", [InputJump(1, 0.5, 1.0, 0.0)])
    with pytest.raises(InputError, match="positive"):
        basis_rates(-1.0)


@pytest.mark.parametrize("lead", [0, 1, 37])
def test_block_means_are_those_of_the_bank(lead):
    rng = np.random.default_rng(lead)
    counts = np.array([5, 5, 75, 1, 1, 1, 8, 8, 3])
    u = 20 + np.cumsum(rng.normal(size=lead + counts.sum()))
    rates = basis_rates(DT)
    bank, starts = lag_basis(u, DT, rates)[lead:], np.cumsum(counts) - counts
    means = np.add.reduceat(bank, starts) / counts[:, None]
    assert np.abs(lag_basis_means(u, DT, rates, counts) - means).max() < 1e-9
