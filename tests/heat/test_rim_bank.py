"""The lag basis: exact for its hold, and accurate for any lag between its nodes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tcdyn.core.errors import InputError
from tcdyn.heat.rim import InputJump, basis_rates, lag_basis, lag_basis_means, lag_weights

DT = 1 / 75


def test_ramp_is_delayed_by_one_time_constant():
    rate = np.array([2.0])
    t = np.arange(2000) * DT
    delay_s = t[-1] - lag_basis(t, DT, rate, "foh")[-1, 0]
    assert delay_s == pytest.approx(0.5, abs=1e-9)  # the hold is exact: rounding only


def test_jump_inside_a_sample_matches_a_finer_grid():
    rates = basis_rates(DT)
    fine = lag_basis(np.r_[np.full(13, 5.0), np.zeros(27)], DT / 10, rates, "zoh")[::10]
    coarse = lag_basis([5.0, 5.0, 0.0, 0.0], DT, rates, "zoh", [InputJump(1, 0.3, 5.0, 0.0)])
    np.testing.assert_allclose(coarse, fine, atol=1e-12)


def test_filtering_in_two_chunks_matches_one_pass():
    u = np.random.default_rng(1).standard_normal(101)
    rates = basis_rates(DT)
    for hold in ("foh", "zoh"):
        one_pass = lag_basis(u, DT, rates, hold)
        first = lag_basis(u[:51], DT, rates, hold)
        second = lag_basis(u[50:], DT, rates, hold, initial=first[-1])
        np.testing.assert_allclose(np.vstack([first, second[1:]]), one_pass, atol=1e-12)


@settings(max_examples=60, deadline=None)
@given(st.floats(np.log(0.31), np.log(2900.0)))
def test_any_lag_is_a_weighted_sum_of_the_basis(log_rate):
    rates = basis_rates(DT)
    u = np.r_[np.zeros(5), np.ones(400)]
    weights = lag_weights(rates, np.array([log_rate]))[0]
    assert weights.sum() == pytest.approx(1.0, abs=1e-12)  # the static gain is exact
    expected = lag_basis(u, DT, np.array([np.exp(log_rate)]), "zoh")[:, 0]
    # exp(-e^x t) is entire in x; its Chebyshev error with 40 nodes over 9.2 is below 5e-6
    assert np.abs(lag_basis(u, DT, rates, "zoh") @ weights - expected).max() < 5e-6


def test_weights_of_a_node_are_a_unit_vector():
    rates = basis_rates(DT)
    np.testing.assert_allclose(lag_weights(rates, np.log(rates)), np.eye(len(rates)), atol=1e-9)


@pytest.mark.parametrize("bad", [[1.0, np.nan], [[1.0]], []])
def test_record_that_is_not_a_row_of_finite_numbers_raises(bad):
    with pytest.raises(InputError, match="row of finite numbers"):
        lag_basis(bad, DT, basis_rates(DT))


def test_jump_outside_the_record_and_negative_step_raise():
    with pytest.raises(InputError, match="outside"):
        lag_basis([1.0, 1.0], DT, basis_rates(DT), "zoh", [InputJump(1, 0.5, 1.0, 0.0)])
    with pytest.raises(InputError, match="positive"):
        basis_rates(-1.0)


@pytest.mark.parametrize("n_before", [0, 1, 37])
def test_block_means_match_the_basis(n_before):
    rng = np.random.default_rng(n_before)
    counts = np.array([5, 5, 75, 1, 1, 1, 8, 8, 3])
    u = 20 + np.cumsum(rng.normal(size=n_before + counts.sum()))
    rates = basis_rates(DT)
    basis = lag_basis(u, DT, rates)[n_before:]
    starts = np.cumsum(counts) - counts
    means = np.add.reduceat(basis, starts) / counts[:, None]
    assert np.abs(lag_basis_means(u, DT, rates, counts) - means).max() < 1e-9
