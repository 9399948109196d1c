"""The measurement chain: moments, exactness between samples, and what it exports."""

from __future__ import annotations

import numpy as np
import pytest

from tcdyn.chain import NO_CONDITIONING, Chain, ChainStructure, cement_lags, equalise
from tcdyn.core.errors import InputError
from tcdyn.rig.disk import Conditioning
from tcdyn.smoothing import smooth

B = Conditioning(cutoff_Hz=4.0, poles=2)

CHAINS = {
    "two lags": Chain((0.6, 0.1), conditioning=B),
    "zero and dead time": Chain((0.6, 0.2), 0.1, 0.23, conditioning=B),
    "butterworth": Chain((0.5,), conditioning=Conditioning(2.0, 3, "butterworth")),
    "complex poles": Chain((0.1,), pair=(0.3, 0.5), conditioning=B),
    "cement": Chain((0.2,), cement_s=0.8, conditioning=B),
}


@pytest.mark.parametrize("name", CHAINS)
def test_lag_is_the_delay_of_a_ramp(name):
    # behind a ramp of slope one every chain of unit gain ends up its first moment late
    chain = CHAINS[name]
    t = np.arange(4000) * 0.01
    assert t[-1] - chain.response(t, 0.01, "foh", "zero")[-1] == pytest.approx(
        chain.lag_s, rel=1e-6
    )


@pytest.mark.parametrize("name", CHAINS)
def test_slow_sine_response_is_the_frequency_response(name):
    chain = CHAINS[name]
    f = 0.25
    dt = 1e-3
    t = np.arange(24_000) * dt
    y = chain.response(np.sin(2 * np.pi * f * t), dt)[12_000:]
    g = chain.frequency_response(f)
    expected = np.abs(g) * np.sin(2 * np.pi * f * t[12_000:] + np.angle(g))
    # straight lines between samples: (2 pi f dt)^2/8 = 3e-7; cement by six poles and a rest: 1e-3
    assert np.max(np.abs(y - expected)) < (1e-3 if chain.cement_s else 2e-6)


@pytest.mark.parametrize("hold", ["foh", "zoh"])
def test_response_does_not_depend_on_the_grid(hold):
    # dead time 0.123 s is 2.46 samples of the coarse grid and 123 of the fine one
    chain = Chain((0.5, 0.1), 0.05, 0.123, conditioning=B)
    u = np.random.default_rng(0).normal(size=200)
    n = 199 * 50 + 1
    fine = (
        np.interp(np.arange(n) / 50, np.arange(200), u) if hold == "foh" else np.repeat(u, 50)[:n]
    )
    assert (
        np.max(np.abs(chain.response(u, 0.05, hold) - chain.response(fine, 0.001, hold)[::50]))
        < 1e-10
    )


def test_response_of_a_table_is_that_of_its_columns():
    chain = CHAINS["zero and dead time"]
    u = np.random.default_rng(1).normal(size=(120, 3))
    both = chain.response(u, 0.02)
    assert both.shape == (120, 3)
    assert np.array_equal(both[:, 1], chain.response(u[:, 1], 0.02))


def test_no_lags_at_all_is_a_pure_delay():
    t = np.arange(50) * 0.1
    y = Chain((), delay_s=0.25, conditioning=NO_CONDITIONING).response(t, 0.1)
    assert np.allclose(y, np.maximum(t - 0.25, 0.0), atol=1e-12)


def test_cement_is_the_diffusion_solution():
    # step response of 1/cosh(sqrt(s)): 1 - sum 2 (-1)^(k+1)/((k-1/2) pi) e^(-((k-1/2) pi)^2 t), Carslaw and Jaeger 3.4
    t = np.linspace(0, 3, 601)
    k = np.arange(1, 200)
    rate = ((k - 0.5) * np.pi) ** 2
    exact = 1 - np.sum(
        2 * (-1.0) ** (k + 1) / np.sqrt(rate) * np.exp(-np.outer(t[1:], rate)), axis=1
    )
    chain = Chain((), conditioning=NO_CONDITIONING, cement_s=1.0)
    assert (
        np.max(np.abs(chain.response(np.ones(601), 0.005, "foh", "zero")[1:] - exact)) < 2e-3
    )  # as documented
    assert sum(cement_lags()) == pytest.approx(0.5)


def test_cement_falls_off_like_a_half_order_system():
    # |1/cosh(sqrt(s))| -> 2 exp(-sqrt(w/2)): the phase at high frequency grows as sqrt(w), not to a multiple of 90 deg
    w = np.array([200.0, 800.0])
    g = Chain((), conditioning=NO_CONDITIONING, cement_s=1.0).frequency_response(w / (2 * np.pi))
    assert np.abs(g) == pytest.approx(2 * np.exp(-np.sqrt(w / 2)), rel=1e-3)


@pytest.mark.parametrize("name", ["two lags", "zero and dead time", "butterworth", "complex poles"])
def test_control_transfer_function_agrees_at_low_frequency(name):
    chain = CHAINS[name]
    f = np.array([0.05, 0.5])
    g = chain.transfer_function(pade_order=4)(2j * np.pi * f)
    assert np.allclose(g, chain.frequency_response(f), atol=1e-5)  # Pade of order 4, w Td < 0.8


def test_discrete_form_is_the_response_without_dead_time():
    from scipy.signal import lfilter

    chain = Chain((0.5, 0.1), 0.05, conditioning=B)
    u = np.random.default_rng(2).normal(size=300)
    for hold in ("foh", "zoh"):
        b, a = chain.discrete(0.05, hold)
        start = (
            u[0] if hold == "foh" else 0.0
        )  # a straight line needs a sample before the first one
        y = lfilter(b, a, u - start) + start
        assert np.allclose(
            y, chain.response(u, 0.05, hold, "equilibrium" if start else "zero"), atol=1e-9
        )


def test_negative_lags_are_refused():
    with pytest.raises(InputError, match="must not be negative"):
        Chain((-0.1,), conditioning=B)
    with pytest.raises(InputError, match="must be positive"):
        Chain((0.1,), pair=(0.2, 0.0), conditioning=B)


KINDS = {
    "lags": (Chain((0.66, 0.1), conditioning=B), Chain((0.6, 0.12), conditioning=B)),
    "lag, zero and dead time": (
        Chain((0.5,), 0.1, 0.05, conditioning=B),
        Chain((0.6,), 0.12, 0.15, conditioning=B),
    ),
    "complex pair": (
        Chain((0.2,), pair=(0.2, 0.7), conditioning=B),
        Chain((0.22,), pair=(0.25, 0.6), conditioning=B),
    ),
    "cement": (
        Chain((0.2,), cement_s=0.6, conditioning=B),
        Chain((0.25,), cement_s=0.8, conditioning=B),
    ),
}


@pytest.mark.parametrize("name", KINDS)
def test_a_channel_is_made_to_read_as_another_chain_would(name):
    own, common = KINDS[name]
    t = np.arange(0, 30, 1 / 75)
    x = 100 - 15 * (1 - np.exp(-np.clip(t - 10, 0, None) / 3))
    made = equalise(own.response(x, 1 / 75)[:, None], 1 / 75, [own], common)[:, 0]
    wanted = common.response(x, 1 / 75)
    assert np.abs(own.response(x, 1 / 75) - wanted).max() > 0.1
    assert (
        np.abs(made - wanted).max() < 5e-3
    )  # the bend of 5 K/s lies between samples: a quarter of it times dt^2/lag


def test_before_its_first_sample_a_column_stood_at_the_mean_of_its_first_second():
    rng = np.random.default_rng(5)
    own, common = KINDS["lags"]
    y = 80 + rng.standard_normal((300, 2))
    y[0] += 10  # one spike at the start is no level
    made = equalise(y, 1 / 75, [own, own], common)
    rested = np.concatenate([np.tile(y[:75].mean(axis=0), (1500, 1)), y])
    assert np.abs(made - equalise(rested, 1 / 75, [own, own], common)[1500:]).max() < 1e-6


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("P4", "no process model"),
        ("P2ZZ", "no process model"),
        ("P1U", "use P2U"),
        ("P0Z", "use P1Z"),
    ],
)
def test_structures_that_cannot_be_are_refused(name, words):
    with pytest.raises(InputError, match=words):
        ChainStructure.from_name(name)


def test_one_lag_is_a_number_several_a_list_and_no_filter_is_added() -> None:
    t = np.arange(0, 10, 0.05)
    step = Chain(1.5).response((t > 0).astype(float), 0.05, "zoh", "zero")
    assert step[1:] == pytest.approx(1 - np.exp(-(t[1:] - 0.05) / 1.5), abs=1e-12)
    assert Chain([0.5, 0.1]) == Chain(np.array([0.5, 0.1])) == Chain((0.5, 0.1))
    assert Chain([0.5, 0.1]).lag_s == pytest.approx(0.6)
    for wrong in ("slow", [[0.5], "x"], None, float("nan"), float("inf"), -1.0):
        with pytest.raises(InputError, match="lags"):
            Chain(wrong)  # type: ignore[arg-type]


def test_the_smoother_takes_a_lag_as_a_number_and_refuses_a_list_that_could_mean_two_things() -> (
    None
):
    t = np.arange(0, 20, 0.05)
    y = Chain(1.5).response(20 + np.sin(t / 3), 0.05) + 0.01 * np.random.default_rng(
        1
    ).standard_normal(len(t))
    assert smooth(y, 0.05, 1.5).temperature == pytest.approx(
        smooth(y, 0.05, Chain((1.5,))).temperature
    )
    assert (
        np.max(np.abs(smooth(y, 0.05, 1.5).temperature[:, 0] - 20 - np.sin(t / 3))[20:-20]) < 0.05
    )
    with pytest.raises(InputError, match="for a sensor of several lags"):
        smooth(np.column_stack([y, y]), 0.05, [0.5, 0.1])  # type: ignore[list-item]
