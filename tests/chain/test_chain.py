"""The measurement chain: moments, exactness between samples, and exported forms."""

from __future__ import annotations

from dataclasses import replace

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
    # after a ramp of slope one every chain of unit gain is late by its first moment
    chain = CHAINS[name]
    t = np.arange(4000) * 0.01
    assert t[-1] - chain.response(t, 0.01, "foh", "zero")[-1] == pytest.approx(
        chain.lag_s, rel=1e-6
    )


@pytest.mark.parametrize("name", CHAINS)
def test_slow_sine_response_matches_the_frequency_response(name):
    chain = CHAINS[name]
    f = 0.25
    dt = 1e-3
    t = np.arange(24_000) * dt
    y = chain.response(np.sin(2 * np.pi * f * t), dt)[12_000:]
    g = chain.frequency_response(f)
    expected = np.abs(g) * np.sin(2 * np.pi * f * t[12_000:] + np.angle(g))
    # linear between samples: (2 pi f dt)^2/8 = 3e-7; cement by six poles and a remainder: 1e-3
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
    coarse_response = chain.response(u, 0.05, hold)
    fine_response = chain.response(fine, 0.001, hold)[::50]
    assert np.max(np.abs(coarse_response - fine_response)) < 1e-10


def test_response_of_a_table_is_that_of_its_columns():
    chain = CHAINS["zero and dead time"]
    u = np.random.default_rng(1).normal(size=(120, 3))
    responses = chain.response(u, 0.02)
    assert responses.shape == (120, 3)
    assert np.array_equal(responses[:, 1], chain.response(u[:, 1], 0.02))


def test_chain_without_lags_is_a_pure_delay():
    t = np.arange(50) * 0.1
    y = Chain((), delay_s=0.25, conditioning=NO_CONDITIONING).response(t, 0.1)
    assert np.allclose(y, np.maximum(t - 0.25, 0.0), atol=1e-12)


def test_cement_is_the_diffusion_solution():
    # step response of 1/cosh(sqrt(s)): 1 - sum 2 (-1)^(k+1)/((k-1/2) pi) e^(-((k-1/2) pi)^2 t),
    # Carslaw and Jaeger 3.4
    t = np.linspace(0, 3, 601)
    k = np.arange(1, 200)
    rate = ((k - 0.5) * np.pi) ** 2
    exact = 1 - np.sum(
        2 * (-1.0) ** (k + 1) / np.sqrt(rate) * np.exp(-np.outer(t[1:], rate)), axis=1
    )
    chain = Chain((), conditioning=NO_CONDITIONING, cement_s=1.0)
    # as documented
    step = chain.response(np.ones(601), 0.005, "foh", "zero")[1:]
    assert np.max(np.abs(step - exact)) < 2e-3
    assert sum(cement_lags()) == pytest.approx(0.5)


def test_cement_falls_off_like_a_half_order_system():
    # |1/cosh(sqrt(s))| -> 2 exp(-sqrt(w/2)): the phase at high frequency grows as sqrt(w), not to a
    # multiple of 90 deg
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
        # first-order hold needs a sample before the first one
        start = u[0] if hold == "foh" else 0.0
        y = lfilter(b, a, u - start) + start
        assert np.allclose(
            y, chain.response(u, 0.05, hold, "equilibrium" if start else "zero"), atol=1e-9
        )


def test_negative_lags_raise():
    with pytest.raises(InputError, match="must not be negative"):
        Chain((-0.1,), conditioning=B)
    with pytest.raises(InputError, match="must be positive"):
        Chain((0.1,), pair=(0.2, 0.0), conditioning=B)


CHAIN_PAIRS = {
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


@pytest.mark.parametrize("name", CHAIN_PAIRS)
def test_equalised_channel_reads_as_through_the_other_chain(name):
    chain, common = CHAIN_PAIRS[name]
    t = np.arange(0, 30, 1 / 75)
    x = 100 - 15 * (1 - np.exp(-np.clip(t - 10, 0, None) / 3))
    equalised = equalise(chain.response(x, 1 / 75)[:, None], 1 / 75, [chain], common)[:, 0]
    expected = common.response(x, 1 / 75)
    assert np.abs(chain.response(x, 1 / 75) - expected).max() > 0.1
    # a change of slope of 5 K/s between samples: a quarter of it times dt^2/lag
    assert np.abs(equalised - expected).max() < 5e-3


def test_column_is_extended_backwards_by_the_mean_of_its_first_second():
    rng = np.random.default_rng(5)
    chain, common = CHAIN_PAIRS["lags"]
    y = 80 + rng.standard_normal((300, 2))
    y[0] += 10  # a spike at the start must not be taken for the level
    equalised = equalise(y, 1 / 75, [chain, chain], common)
    extended = np.concatenate([np.tile(y[:75].mean(axis=0), (1500, 1)), y])
    assert (
        np.abs(equalised - equalise(extended, 1 / 75, [chain, chain], common)[1500:]).max() < 1e-6
    )


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("P4", "no process model"),
        ("P2ZZ", "no process model"),
        ("P1U", "use P2U"),
        ("P0Z", "use P1Z"),
    ],
)
def test_invalid_chain_structures_raise(name, message):
    with pytest.raises(InputError, match=message):
        ChainStructure.from_name(name)


def test_lags_may_be_a_number_or_a_list_and_no_filter_is_added() -> None:
    t = np.arange(0, 10, 0.05)
    step = Chain(1.5).response((t > 0).astype(float), 0.05, "zoh", "zero")
    assert step[1:] == pytest.approx(1 - np.exp(-(t[1:] - 0.05) / 1.5), abs=1e-12)
    assert Chain([0.5, 0.1]) == Chain(np.array([0.5, 0.1])) == Chain((0.5, 0.1))
    assert Chain([0.5, 0.1]).lag_s == pytest.approx(0.6)
    for wrong in ("slow", [[0.5], "x"], None, float("nan"), float("inf"), -1.0):
        with pytest.raises(InputError, match="lags"):
            Chain(wrong)  # type: ignore[arg-type]


def test_smoother_accepts_one_lag_as_a_number_and_rejects_an_ambiguous_list() -> None:
    t = np.arange(0, 20, 0.05)
    y = Chain(1.5).response(20 + np.sin(t / 3), 0.05) + 0.01 * np.random.default_rng(
        1
    ).standard_normal(len(t))
    truth = 20 + np.sin(t / 3)
    stated = smooth(y, 0.05, 1.5)
    known = smooth(y, 0.05, Chain((1.5,)))
    same = smooth(y, 0.05, Chain((1.5,), is_stated=True))
    assert stated.temperature == pytest.approx(same.temperature)
    assert np.max(np.abs(known.temperature[:, 0] - truth)[20:-20]) < 0.05
    # a number does not say how the lag is divided
    assert (stated.sd > known.sd).all()
    assert np.mean(np.abs(stated.temperature[:, 0] - truth) < 1.96 * stated.sd[:, 0]) > 0.95
    with pytest.raises(InputError, match="for a sensor of several lags"):
        smooth(np.column_stack([y, y]), 0.05, [0.5, 0.1])  # type: ignore[list-item]


@pytest.mark.parametrize(
    "chain", [Chain(0.5), Chain([0.6, 0.1], zero_s=-0.2), Chain((0.1,), pair=(0.3, 0.5))]
)
def test_chain_returns_from_its_control_system(chain):
    import control

    for system in (chain.transfer_function(), chain.state_space()):
        back = Chain.from_control(system)
        np.testing.assert_allclose(back.taus_s, chain.taus_s, rtol=1e-6)
        f = np.geomspace(0.01, 10, 20)
        np.testing.assert_allclose(back.frequency_response(f), chain.frequency_response(f), 1e-6)
    double = Chain.from_control(control.tf([1.0], [1.0, 2.0, 1.0]), delay_s=0.3)
    assert (double.lag_s, double.delay_s) == (pytest.approx(2.3, rel=1e-6), 0.3)


def test_control_system_that_is_no_chain_is_refused():
    import control

    s = control.tf("s")
    for system in (2 / (s + 1), 1 / (1 - s), (1 + s) ** 2 / (1 + 2 * s) ** 3, 1 / (s * s + 1) ** 2):
        with pytest.raises(InputError):
            Chain.from_control(system)
    with pytest.raises(InputError):
        Chain.from_control(control.tf([0.1], [1, -0.9], 0.1))


def test_state_space_holds_a_dead_time_up_to_frequencies_of_its_pade_order():
    chain = Chain([0.6, 0.1], delay_s=0.2)
    f = np.array([0.01, 0.3, 1.0])
    for order, tolerance in ((1, 5e-2), (4, 1e-6)):
        response = chain.state_space(order)(2j * np.pi * f)
        assert np.abs(response - chain.frequency_response(f)).max() < tolerance


def test_smoother_takes_a_control_system():
    chain = Chain([0.5, 0.1])
    t = np.arange(0.0, 20.0, 0.05)
    noise = np.random.default_rng(2).normal(0, 0.1, len(t))
    y = chain.response(np.sin(t), 0.05) + noise
    by_system = smooth(y, 0.05, chain.transfer_function())
    np.testing.assert_allclose(by_system.temperature, smooth(y, 0.05, chain).temperature, atol=1e-6)


@pytest.mark.parametrize("hold", ["foh", "zoh"])
@pytest.mark.parametrize("mean_s", [0.04, 0.25, 1.3])
def test_rows_that_are_means_are_the_mean_of_the_response(hold, mean_s):
    chain = Chain((0.6, 0.1), delay_s=0.13)
    u = 20 + np.cumsum(np.random.default_rng(2).normal(0, 1, 60))
    dt, parts = 0.1, 500
    fine_s = np.arange(59 * parts + 1) * dt / parts
    held = np.interp(fine_s, dt * np.arange(60), u) if hold == "foh" else np.repeat(u, parts)
    y = chain.response(held[: len(fine_s)], dt / parts, hold)
    before = round(mean_s / dt * parts)
    y = np.concatenate([np.full(before, y[0]), y])
    total = np.concatenate([[0.0], np.cumsum(0.5 * (y[1:] + y[:-1]))])
    mean = (total[before::parts] - total[: len(total) - before : parts]) / before
    found = replace(chain, mean_s=mean_s).response(u, dt, hold)
    assert found == pytest.approx(mean, abs=2e-3)


def test_a_mean_is_a_low_pass_with_half_of_its_time_as_lag():
    chain = Chain(0.5, mean_s=0.8)
    assert chain.lag_s == pytest.approx(0.9)
    f = np.array([0.0, 1e-3, 0.4, 1.25])
    s = 2j * np.pi * f[1:]
    expected = (1 - np.exp(-0.8 * s)) / (0.8 * s) / (1 + 0.5 * s)
    assert chain.frequency_response(f)[0] == 1
    assert chain.frequency_response(f)[1:] == pytest.approx(expected, abs=1e-12)
    assert "means over 0.8 s" in chain.summary()
    with pytest.raises(InputError, match="no transfer function of finite order"):
        chain.transfer_function()
    with pytest.raises(InputError, match="mean_s is -1"):
        Chain(0.5, mean_s=-1.0)
