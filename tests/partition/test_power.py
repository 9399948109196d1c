"""Frictional power through the lag of a thermocouple, with an end inside a sample."""

from __future__ import annotations

import numpy as np
import pytest

from tcdyn.chain import Chain
from tcdyn.core import Array
from tcdyn.heat.rim import basis_rates, lag_basis_means
from tcdyn.partition.events import EhlTest
from tcdyn.partition.nuisance import add_lag
from tcdyn.partition.window import lagged_power
from tcdyn.rig.contact import Events

DT_s = 1 / 75
TAU_s = 0.7
LEVEL_W = 360.0


@pytest.mark.parametrize("fraction", [0.1, 0.25, 0.9])
def test_lagged_power_decays_from_an_end_inside_a_sample(fraction: float) -> None:
    time = np.arange(0.0, 6.0, DT_s)
    last_index = 200
    end_s = float(time[last_index] + fraction * DT_s)
    power = np.where(np.arange(len(time)) <= last_index, LEVEL_W, 0.0)
    test = EhlTest(
        time,
        DT_s,
        Events(0.0, end_s, 1e-3, 0.02, (end_s,)),
        power,
        np.full(len(time), 60.0),
        1850.0,
        20.0,
        4.24,
        16.0,
        13.0,
        1.6e-3,
        0.667,
        0.1,
        {},
        (),
    )
    lagged, keywords = lagged_power(test, slice(0, len(time)), Chain(TAU_s))
    after = time > end_s + 2 * DT_s
    # second order in the sampling interval, (dt/tau)^2 / 8; an error of half a sample is ten times
    # that
    np.testing.assert_allclose(
        lagged[after], LEVEL_W * np.exp(-(time[after] - end_s) / TAU_s), rtol=1e-4
    )
    assert keywords == {}
    _, unlagged_keywords = lagged_power(test, slice(0, len(time)), None)
    (jump,) = unlagged_keywords["jumps"]
    assert (jump.index, jump.before, jump.after) == (last_index, LEVEL_W, 0.0)
    assert jump.fraction == pytest.approx(fraction, abs=1e-9)


@pytest.mark.parametrize(
    "tau_s", [0.05, 0.6, 5.0, 1 / basis_rates(DT_s)[20], (1 + 0.99e-6) / basis_rates(DT_s)[20]]
)
def test_additional_lag_is_a_weighted_sum_of_the_lag_basis(tau_s: float) -> None:
    """Block means of a slow input and its basis through a lag, against those of the filtered input,
    to 1e-5.

    The interpolation of the basis is accurate to 1e-6; straight lines between its samples to 7.5^2
    dt^2/12. Two of the lags lie on or near a node.
    """
    dt_s = 0.1 * DT_s
    rates = basis_rates(DT_s, longest_s=2 * tau_s)
    signal = np.sin(2 * np.pi * 0.3 * np.arange(5000) * dt_s) ** 4

    def block_means(x: Array) -> tuple[Array, Array]:
        return x[-2000:].reshape(40, 50).mean(axis=1), lag_basis_means(x, dt_s, rates, [50] * 40)

    for result, expected in zip(
        add_lag(*block_means(signal), rates, tau_s),
        block_means(Chain((tau_s,)).response(signal, dt_s)),
    ):
        np.testing.assert_allclose(result, expected, atol=1e-5)
