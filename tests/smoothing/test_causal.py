"""Proper inverse and the report before use."""

import numpy as np
import pytest

from tcdyn.chain import Chain
from tcdyn.core.errors import InputError
from tcdyn.rig.disk import Conditioning
from tcdyn.smoothing.inverse import (
    lag_sensitivity,
    proper_inverse,
    report_inverse,
    widest_bandwidth_Hz,
)

B = Conditioning(cutoff_Hz=4.0, poles=2)

DT = 1 / 75
CHAIN = Chain((0.6, 0.07), conditioning=B)
PAIR = Chain((0.1,), pair=(0.1, 0.6), conditioning=B)


def slow_wave(n=3000):
    t = np.arange(n) * DT
    return t, 80 + 20 * np.sin(2 * np.pi * 0.05 * t)


def test_inverse_of_a_slow_trace_is_the_trace_shifted_by_what_it_states():
    """Far below its bandwidth, chain x inverse is a delay of the stated length; tolerance: (w
    lag)^2 of 20 K."""
    t, x = slow_wave()
    f = proper_inverse(CHAIN, DT, 2.0)
    back = f(CHAIN.response(x, DT))
    late = 80 + 20 * np.sin(2 * np.pi * 0.05 * (t - f.remaining_shift_s))
    assert np.max(np.abs(back - late)[600:]) < 20 * (2 * np.pi * 0.05 * f.remaining_shift_s) ** 2
    assert np.max(np.abs(back - x)[600:]) < 0.2 * np.max(np.abs(CHAIN.response(x, DT) - x)[600:])


@pytest.mark.parametrize(
    "chain",
    [
        CHAIN,
        Chain((0.8,), zero_s=0.1, conditioning=B),
        Chain((0.8, 0.2), zero_s=-0.05, delay_s=0.04, conditioning=B),
        PAIR,
    ],
)
def test_inverse_is_stable_has_unit_gain_and_its_stated_bandwidth(chain):
    f = proper_inverse(chain, DT, 1.5)
    assert np.all(np.abs(np.roots(f.a)) < 1)
    assert f.b.sum() / f.a.sum() == pytest.approx(1.0, abs=1e-9)
    assert report_inverse(f, 0.15).bandwidth_Hz == pytest.approx(
        1.5, rel=0.02
    )  # 2 %: FOH against the continuous roll-off


def test_noise_gain_is_the_gain_of_noise():
    """Monte Carlo of 2e5 samples: the sd of an sd is 0.2 %, correlation makes it a few times
    that."""
    f = proper_inverse(CHAIN, DT, 2.0)
    out = f(np.random.default_rng(0).standard_normal(200_000))
    assert np.std(out[2000:]) == pytest.approx(f.noise_gain, rel=0.03)


def test_lag_sensitivity_is_the_change_with_the_lag():
    _, x = slow_wave()
    y = CHAIN.response(x, DT)
    f, longer = (proper_inverse(c, DT, 2.0) for c in (CHAIN, CHAIN.with_lag_shift(1e-4)))
    assert np.allclose((longer(y) - f(y)) / 1e-4, lag_sensitivity(f, y), atol=0.02)  # of 6 K/s


def test_report_warns_when_the_bandwidth_cannot_be_had_and_says_which_can():
    said = report_inverse(proper_inverse(CHAIN, DT, 15.0), 0.15, wanted_K=1.0)
    assert any("can be had" in w for w in said.warnings)
    best = widest_bandwidth_Hz(CHAIN, DT, 0.15, 1.0)
    assert proper_inverse(CHAIN, DT, best).noise_gain * 0.15 <= 1.0
    assert said.rise_s < said.raw_rise_s
    assert "remaining shift" in said.summary()


def test_bandwidth_above_half_the_sampling_is_refused_with_the_remedy():
    with pytest.raises(InputError, match=r"37\.5 \(half of the 75 Hz sampling\); got 50; lower it"):
        proper_inverse(CHAIN, DT, 50.0)
