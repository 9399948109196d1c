"""The frictional power as a lagging thermocouple would show it, with an end inside a sample."""

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

DT_s, TAU_s, LEVEL_W = 1 / 75, 0.7, 360.0


@pytest.mark.parametrize("part", [0.1, 0.25, 0.9])
def test_a_power_that_ends_inside_a_sample_falls_by_its_lag_from_that_instant(part: float) -> None:
    time = np.arange(0.0, 6.0, DT_s)
    last = 200
    off = float(time[last] + part * DT_s)
    power = np.where(np.arange(len(time)) <= last, LEVEL_W, 0.0)
    test = EhlTest(
        time,
        DT_s,
        Events(0.0, off, 1e-3, 0.02, (off,)),
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
    seen, held = lagged_power(test, slice(0, len(time)), Chain(TAU_s))
    after = time > off + 2 * DT_s
    # second order in the sampling interval: (dt/tau)^2 / 8; half a sample on the wrong side is ten times that
    np.testing.assert_allclose(
        seen[after], LEVEL_W * np.exp(-(time[after] - off) / TAU_s), rtol=1e-4
    )
    assert held == {}
    _, exact = lagged_power(test, slice(0, len(time)), None)
    (jump,) = exact["jumps"]
    assert (jump.index, jump.before, jump.after) == (last, LEVEL_W, 0.0)
    assert jump.fraction == pytest.approx(part, abs=1e-9)


@pytest.mark.parametrize(
    "tau_s", [0.05, 0.6, 5.0, 1 / basis_rates(DT_s)[20], (1 + 0.99e-6) / basis_rates(DT_s)[20]]
)
def test_one_more_lag_is_weights_on_the_bank(tau_s: float) -> None:
    """Means of a slow input and its bank through a lag, one on a node among them, are those of the input filtered
    first: to 1e-5, as the bank's interpolation is good to 1e-6, straight lines between its samples to 7.5^2 dt^2/12."""
    dt_s, rates = 0.1 * DT_s, basis_rates(DT_s, longest_s=2 * tau_s)
    u = np.sin(2 * np.pi * 0.3 * np.arange(5000) * dt_s) ** 4

    def means(x: Array) -> tuple[Array, Array]:
        return x[-2000:].reshape(40, 50).mean(axis=1), lag_basis_means(x, dt_s, rates, [50] * 40)

    for found, expected in zip(
        add_lag(*means(u), rates, tau_s), means(Chain((tau_s,)).response(u, dt_s))
    ):
        np.testing.assert_allclose(found, expected, atol=1e-5)
