"""What is said of a compensator before it is used, against closed forms: one lag behind, one lag
left."""

from __future__ import annotations

import numpy as np
import pytest

from tcdyn.chain import NO_CONDITIONING, Chain, equalise, sensors
from tcdyn.rig.disk import Conditioning
from tcdyn.smoothing.inverse import (
    lag_sensitivity,
    proper_inverse,
    report_inverse,
    smoother_bandwidth_Hz,
    widest_bandwidth_Hz,
)

DT, TAU = 1e-3, 0.5
ONE = Chain((TAU,), conditioning=NO_CONDITIONING)


def gain_at(b: np.ndarray, a: np.ndarray, f_Hz: float) -> complex:
    """The response of a digital filter."""
    z = np.exp(-2j * np.pi * f_Hz * DT)
    return complex(np.polyval(b[::-1], z) / np.polyval(a[::-1], z))


@pytest.mark.parametrize("delay_s", [0.0, 0.2])
def test_of_one_lag_another_of_the_bandwidth_is_left_and_the_report_says_all_of_it(
    delay_s: float,
) -> None:
    """Chain times compensator is 1/(1 + s/w): it rises from 10 to 90 % in ln 9/w, and comes 1/w
    late."""
    w = 2 * np.pi * 2.0
    chain = Chain((TAU,), delay_s=delay_s, conditioning=NO_CONDITIONING)
    f = proper_inverse(chain, DT, 2.0)
    told = report_inverse(f, 0.01)
    near = {"rel": 6 * DT * w}  # some samples in 1/w
    assert told.bandwidth_Hz == pytest.approx(2.0, **near)
    assert told.raw_bandwidth_Hz == pytest.approx(
        1 / (2 * np.pi * TAU), rel=0.01
    )  # of 4000 in seven decades
    assert told.rise_s == pytest.approx(np.log(9) / w, **near)
    assert told.raw_rise_s == pytest.approx(np.log(9) * TAU, rel=0.01)
    assert told.overshoot < 1e-3
    assert told.remaining_shift_s == pytest.approx(1 / w + delay_s)
    assert told.bias_K_per_K_s == pytest.approx(1 / w + delay_s, abs=2 * DT)
    a = np.exp(
        -w * DT
    )  # b0, b0 a + b1, then falling by a: the sum of squares of a first-order filter
    h1 = f.b[1] + a * f.b[0]
    assert told.noise_gain == pytest.approx(np.sqrt(f.b[0] ** 2 + h1**2 / (1 - a**2)), rel=1e-6)
    assert told.noise_out_K == pytest.approx(0.01 * told.noise_gain)
    assert f.b[0] == pytest.approx(TAU * w, **near)  # C at infinite frequency
    late = told.step_time_s > delay_s + 5 / w
    assert told.step[late] == pytest.approx(np.ones(late.sum()), abs=0.01)
    at = int(np.argmin(np.abs(told.step_time_s - delay_s - TAU)))
    assert told.raw_step[at] == pytest.approx(1 - np.exp(-1), abs=2 * DT / TAU)
    assert told.step[told.step_time_s < delay_s - DT] == pytest.approx(0.0, abs=1e-9)
    assert [f.code for f in told.findings] == (["inverse.dead_time"] if delay_s else [])
    said = told.summary()
    assert f"remaining shift {1 / w + delay_s:.3g} s" in said


def test_two_lags_and_a_filter_need_as_many_poles_and_the_widest_bandwidth_is_quiet_enough() -> (
    None
):
    """R = 1/(1 + s/w)^m is 1/sqrt 2 at w sqrt(2^(1/m) - 1)."""
    chain = Chain((TAU, 0.1), conditioning=Conditioning(4.0, 1))
    f = proper_inverse(chain, DT, 2.0)
    w = 2 * np.pi * 2.0 / np.sqrt(2 ** (1 / 3) - 1)
    assert f.remaining_shift_s == pytest.approx(3 / w)
    both = abs(f.frequency_response(2.0) * chain.frequency_response(2.0))
    assert both == pytest.approx(np.sqrt(0.5), rel=0.01)  # straight lines between samples
    assert f.frequency_response(2.0) == pytest.approx(gain_at(f.b, f.a, 2.0))
    best = widest_bandwidth_Hz(ONE, DT, 0.01, 0.3)
    step = (0.45 / 1e-3) ** (1 / 39)
    assert proper_inverse(ONE, DT, best).noise_gain * 0.01 <= 0.3
    assert proper_inverse(ONE, DT, best * step).noise_gain * 0.01 > 0.3
    assert widest_bandwidth_Hz(ONE, DT, 0.01, 1e-9) == 0.0
    told = report_inverse(proper_inverse(ONE, DT, 300.0), 0.01, 0.3)
    assert {f.code: f.numbers.get("best_Hz", f.numbers.get("rate_Hz")) for f in told.findings} == {
        "inverse.noisy": best,
        "inverse.near_nyquist": pytest.approx(1000.0),
    }
    assert [
        f.code for f in report_inverse(proper_inverse(ONE, DT, 150.0), 0.01, 99.0).findings
    ] == []
    assert proper_inverse(
        Chain((TAU,), -0.2, conditioning=NO_CONDITIONING), DT, 2.0
    ).remaining_shift_s == (pytest.approx(0.4 + 1 / (2 * np.pi * 2.0)))


def test_without_a_lag_the_smoother_hands_over_where_bends_sink_into_the_noise() -> None:
    none = Chain((), conditioning=NO_CONDITIONING)
    assert smoother_bandwidth_Hz(none, 0.1, 0.2, 7.0) == pytest.approx(
        (7 / (0.04 * 0.1)) ** 0.25 / 2 / np.pi, rel=1e-3
    )


def test_the_rate_of_the_lag_is_that_of_the_response() -> None:
    """A swing of 0.7 Hz: its change per second of lag is s/(1 + tau s) times itself compensated, to
    a sample."""
    t = np.arange(4000) * DT
    inverse = proper_inverse(ONE, DT, 5.0)
    y = np.sin(2 * np.pi * 0.7 * t)
    rate = lag_sensitivity(inverse, y)
    s = 2j * np.pi * 0.7
    expected = np.abs(s / (1 + TAU * s)) * np.std(inverse(y)[2000:])
    assert np.std(rate[2000:]) == pytest.approx(expected, rel=4 * np.pi * 0.7 * DT)


@pytest.mark.parametrize(
    "chain",
    [
        Chain((0.6, 0.2), 0.1, conditioning=Conditioning(4.0, 2)),
        Chain((0.3,), pair=(0.3, 0.6), conditioning=NO_CONDITIONING),
    ],
)
def test_the_state_space_of_a_sensor_follows_ramps_as_the_chain_does(chain: Chain) -> None:
    """A slope of one through zero is read one lag late, and every stage stays behind by what it
    lags."""
    (s,) = sensors([chain])
    level, slope = s.ramp.T
    assert s.drift @ level == pytest.approx(np.zeros(len(level)), abs=1e-12)
    assert s.drift @ slope == pytest.approx(level, abs=1e-12)
    assert float(s.output @ level) == pytest.approx(1.0)
    assert float(s.output @ slope) == pytest.approx(-chain.lag_s)
    stages, v = s.drift[2:, 2:], slope[2:]
    assert stages @ s.scatter[2:, 2:] + s.scatter[2:, 2:] @ stages.T == pytest.approx(
        -np.outer(v, v), abs=1e-12
    )


def test_a_common_chain_is_shown_after_a_second_s_mean() -> None:
    """The column's own lag is taken for the common one: a step through 1/(1 + s)."""
    t = np.arange(400) * 0.05
    own, common = (
        Chain((0.3,), delay_s=0.1, conditioning=NO_CONDITIONING),
        Chain((1.0,), delay_s=0.4),
    )
    y = own.response(np.where(t > 3, 1.0, 0.0), 0.05, "zoh")
    (out,) = equalise(y[:, None], 0.05, [own], common).T
    exact = np.where(t > 3.4, 1 - np.exp(-(t - 3.05 - 0.4) / 1.0), 0.0)
    assert (
        np.abs(out - exact)[t > 3.5].max() < 0.06
    )  # a sample's rounding of the held step: 0.05 of a second's lag


def test_the_step_of_a_slowly_sampled_chain_is_exact_at_the_samples() -> None:
    """Five samples in one lag: the step passes the chain on a finer grid."""
    dt = TAU / 5
    report = report_inverse(proper_inverse(ONE, dt, 0.5), 0.01)
    after = report.step_time_s >= 0
    assert 50 < len(report.raw_step) < 400
    expected = 1 - np.exp(-report.step_time_s[after] / TAU)
    assert report.raw_step[after] == pytest.approx(expected, abs=1e-9)
    assert report.raw_rise_s == pytest.approx(np.log(9) * TAU, rel=0.05)
