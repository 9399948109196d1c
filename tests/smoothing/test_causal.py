"""Proper inverse, the live smoother and the report before use."""

import json
from itertools import pairwise
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy.signal import lfilter, lfilter_zi

from tcdyn.chain import NO_CONDITIONING, Chain
from tcdyn.core.errors import InputError
from tcdyn.rig.disk import Conditioning
from tcdyn.rig.static_line import identity_lines
from tcdyn.smoothing.intervals import corner_rad_s
from tcdyn.smoothing.inverse import (
    lag_sensitivity,
    lag_split_filter,
    proper_inverse,
    report_inverse,
    widest_bandwidth_Hz,
)
from tcdyn.smoothing.live import LiveSmoother, LiveState
from tcdyn.smoothing.traces import DiskChannels
from tcdyn.workflows.live import CORNER_LAGS, LiveCompensator, LiveCompensatorState, LiveSettings

B = Conditioning(cutoff_Hz=4.0, poles=2)

DT = 1 / 75
CHAIN = Chain((0.6, 0.07), conditioning=B)
PAIR = Chain((0.1,), pair=(0.1, 0.6), conditioning=B)


def slow_wave(n=3000):
    t = np.arange(n) * DT
    return t, 80 + 20 * np.sin(2 * np.pi * 0.05 * t)


def test_inverse_of_a_slow_trace_is_the_trace_shifted_by_what_it_states():
    """Far below its bandwidth, chain x inverse is a delay of the stated length; tolerance: (w lag)^2 of 20 K."""
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
    """Monte Carlo of 2e5 samples: the sd of an sd is 0.2 %, correlation makes it a few times that."""
    f = proper_inverse(CHAIN, DT, 2.0)
    out = f(np.random.default_rng(0).standard_normal(200_000))
    assert np.std(out[2000:]) == pytest.approx(f.noise_gain, rel=0.03)


def test_lag_sensitivity_is_the_change_with_the_lag():
    _, x = slow_wave()
    y = CHAIN.response(x, DT)
    f, longer = (proper_inverse(c, DT, 2.0) for c in (CHAIN, CHAIN.with_lag_shift(1e-4)))
    assert np.allclose((longer(y) - f(y)) / 1e-4, lag_sensitivity(f, y), atol=0.02)  # of 6 K/s


@pytest.mark.parametrize(
    ("taus", "shift", "within"),
    [((0.6, 0.07), 0.03, 0.01), ((0.6, 0.07), -0.04, 0.01), ((0.6,), 0.05, 0.15)],
)
def test_what_another_split_of_the_lag_would_make_of_an_answer(
    taus: tuple[float, ...], shift: float, within: float
):
    """The chain shows of the answer and its change what the chain divided otherwise shows of the answer; of a single
    lag, whose share goes to the dead time, but for the third order."""
    t, x = slow_wave()
    x = x - 12 * (1 - np.exp(-np.maximum(t - t[len(t) // 2], 0)))
    chain = Chain(taus, conditioning=B)
    b, a = lag_split_filter(chain, shift, DT)
    change = lfilter(b, a, x, zi=lfilter_zi(b, a) * x[0])[0]
    other = chain.with_split_shift(shift).response(x, DT) - chain.response(x, DT)
    assert np.max(np.abs(chain.response(change, DT) - other)) < within * np.max(np.abs(other))


def test_any_chunking_gives_the_batch_answer_through_a_saved_state():
    rng = np.random.default_rng(0)
    y = 80 + np.cumsum(rng.standard_normal((900, 3)), axis=0) * 0.1
    y[400, 1] = np.nan
    y[600, 2] += 50
    live = LiveSmoother.from_chains([CHAIN] * 3, DT, 0.1, 0.1, lag_samples=10)
    _, whole, sd, flags = live.run(live.initial_state(y[0]), y)
    state, parts = live.initial_state(y[0]), []
    cuts = np.r_[0, np.sort(rng.choice(np.arange(1, 900), 25, replace=False)), 900]
    for a, b in pairwise(cuts):
        saved = LiveState.from_json(json.loads(json.dumps(state.to_json())))
        state, part, _, _ = live.run(saved, y[a:b])
        parts.append(part)
    assert np.max(np.abs(np.concatenate(parts) - whole)) < 1e-9
    assert flags[400, 1] == 1
    assert flags[600, 2] == 2
    assert np.all(np.isfinite(sd))


def test_a_lone_spike_moves_the_live_smoother_less_than_its_noise_and_is_no_event():
    """Spikes of 1 to 60 K at many places: one sample is left out, which costs far less than its sd of the answer."""
    rng = np.random.default_rng(0)
    y = np.tile(80.0 + 0.1 * rng.standard_normal((600, 1)), (1, 40))
    spiked = y.copy()
    spiked[rng.integers(200, 400, 40), np.arange(40)] += np.geomspace(1.5, 60, 40)
    live = LiveSmoother.from_chains([CHAIN] * 40, DT, 0.1, 30.0)
    (_, clean, sd, _), (_, hit, _, _) = (live.run(live.initial_state(v[0]), v) for v in (y, spiked))
    assert np.max(np.abs(hit - clean) / sd) < 1.0
    assert np.max(np.abs(hit - clean)[:200]) == 0


def test_live_smoother_follows_an_unannounced_event_within_one_degree():
    """Case B of the anchors, nothing known of the event: causal, at most 0.85 degC rms (0.64 to 0.77 measured); 95 %
    bands hold 90 % or more, in the five seconds round the event, too, of which nobody can see the first 0.2 s."""
    dt, n = 0.05, 800
    t = np.arange(n * 20) * dt / 20
    fine = 25 + 155 * (1 - np.exp(-np.maximum(t - 5, 0) / 3))
    chain = Chain((1.0,), conditioning=NO_CONDITIONING)
    x = fine[::20]
    y = chain.response(fine, dt / 20)[::20, None] + 0.2 * np.random.default_rng(0).standard_normal(
        (n, 30)
    )
    for quiet in (0.01, 1.0, 20.0):
        live = LiveSmoother.from_chains([chain] * 30, dt, 0.2, quiet)
        _, ours, sd, _ = live.run(live.initial_state(y[0]), y)
        error = ours - x[:, None]
        assert np.sqrt(np.mean(error[60:740] ** 2)) < 0.85
        assert np.mean(np.abs(error[60:]) < 1.96 * sd[60:]) > 0.95
        assert np.mean(np.abs(error[95:200]) < 1.96 * sd[95:200]) > 0.9


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


@pytest.mark.parametrize(("lag_s", "dt_s", "noise_K"), [(0.5, 0.02, 0.1), (5.0, 0.1, 0.4)])
def test_without_a_rig_the_live_smoother_follows_as_fast_as_the_lag_lets_it(
    lag_s: float, dt_s: float, noise_K: float
) -> None:
    """The intensity is that at which the signal sinks into the noise at a set multiple of one over the lag."""
    chain = Chain((lag_s,), conditioning=NO_CONDITIONING)
    channels = DiskChannels(
        ("T1",), (identity_lines(0.1, ("T1",))["T1"],), (chain,), np.zeros((1, 1)), np.zeros(1)
    )
    learnt = {"dt_s": dt_s, "dead": [], "noise_K": {"T1": noise_K}, "before_K": {"T1": 0.0}}
    plan = LiveCompensator.create(("time_s", "T1"), [channels], None, LiveSettings(), learnt)
    corner = corner_rad_s(chain, plan.engine.intensity / (noise_K**2 * dt_s))
    assert corner == pytest.approx(CORNER_LAGS / lag_s, rel=0.03)


@pytest.mark.parametrize(
    "how",
    [
        {"behind_s": -0.1},
        {"behind_s": 1.1e7},
        {"learn_s": 0.0},
        {"learn_s": 1.1e7},
        {"noise_K": 0.0},
        {"intensity_K2_s3": -1.0},
        {"noise_K": np.inf},
    ],
)
def test_settings_that_cannot_be_are_refused(how: dict[str, float]) -> None:
    with pytest.raises(InputError):
        LiveSettings(**how)
    LiveSettings(behind_s=60.0, learn_s=600.0)


def waits(delays: tuple[float, ...], rows: int) -> tuple[LiveCompensator, LiveCompensatorState]:
    """Rows whose first column is the time and whose answers are that time plus ten times the channel's number."""
    names = ("time_s", *(f"c{k}_degC" for k in range(len(delays))))
    chains = tuple(SimpleNamespace(delay_s=d) for d in delays)
    plan = object.__new__(LiveCompensator)
    engine = SimpleNamespace(lag_samples=2)
    parts = {
        "names": names,
        "junctions": names[1:],
        "dead": (),
        "chains": chains,
        "dt_s": 0.5,
        "engine": engine,
    }
    for name, value in parts.items():
        object.__setattr__(plan, name, value)
    t = 0.5 * np.arange(rows)
    waiting = np.column_stack([t, *[np.full(rows, -1.0)] * len(delays)])
    waiting[3:4, 0] = np.nan  # left out by the logger
    found = np.column_stack([t + 10 * k for k in range(len(delays))])
    return plan, LiveCompensatorState(cast(Any, None), np.zeros(0), waiting, found, 2 * found)


def test_a_row_waits_for_the_latest_of_its_answers_and_each_is_for_the_row_s_own_time() -> None:
    """Two samples behind, dead times of none and of 0.6 s: answers come 1.0 and 1.6 s late, 3.2 samples of 0.5 s."""
    plan, state = waits((0.0, 0.6), 10)
    assert plan.delays_s == pytest.approx([1.0, 1.6])
    assert plan.delay_rows == 4
    left, out = plan._pop_ready(state)
    time = out[:, 0]
    assert time.tolist() == [
        0.0,
        0.5,
        1.0,
        2.0,
        2.5,
    ]  # of ten rows six, without the one that is not there
    assert out[:, 1] == pytest.approx(time + 1.0)
    assert out[:, 2] == pytest.approx(time + 1.6 + 10.0)
    assert out[:, 3] == pytest.approx(2 * (time + 1.0))
    assert out[:, 4] == pytest.approx(2 * (time + 1.6 + 10.0))
    assert len(left.waiting) == len(left.found) == 4
    assert len(plan._pop_ready(waits((0.0, 0.6), 3)[1])[1]) == 0
