"""Noise of the model inputs: covariance against sums over samples."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy.signal import lfilter

from tcdyn.campaign import input_noise as noise
from tcdyn.campaign.input_noise import (
    friction_zero_u_N,
    input_noise_covariance,
    noise_covariance,
)
from tcdyn.partition.joint import LOG_H
from tcdyn.rig.contact import SWITCHING_MARGIN_S

DT = 0.02
LAST_LOADED = 300
N_SAMPLES = 340
START_S = 1.0  # the time axis of the log starts at one second


def minimal_test(noise_N: float) -> Any:
    """A test that unloads at sample 330; its load falls from sample 300 plus the settling time
    on."""
    unload_s = START_S + (LAST_LOADED - 0.5) * DT + 0.3 + SWITCHING_MARGIN_S
    events = SimpleNamespace(
        unload_s=unload_s, fall_time_s=0.3, load_on_s=START_S + 2.5 + SWITCHING_MARGIN_S
    )
    time_s = START_S + DT * np.arange(N_SAMPLES)
    return SimpleNamespace(friction_noise_N=noise_N, dt_s=DT, events=events, time_s=time_s)


def test_friction_zero_u_follows_the_longer_unloaded_segment() -> None:
    """A median scatters 1.25 times as much as a mean; 2.5 s before loading, no sample after
    unloading."""
    assert friction_zero_u_N(minimal_test(0.6)) == pytest.approx(1.25 * 0.6 / np.sqrt(2.5 / DT))
    test = minimal_test(0.6)
    test.time_s = START_S + DT * np.arange(N_SAMPLES + 400)
    after_s = test.time_s[-1] - test.events.unload_s - SWITCHING_MARGIN_S
    assert after_s > 5
    assert friction_zero_u_N(test) == pytest.approx(1.25 * 0.6 / np.sqrt(after_s / DT))


def test_input_noise_covariance_matches_a_sum_over_samples(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Two inputs after the power, each direct and through two first-order lags, in blocks of ten
    samples."""
    rng = np.random.default_rng(1)
    dt = 0.05
    n = 400
    rates = np.array([0.4, 1.5])
    direct = rng.standard_normal((3, 2))
    gains = rng.standard_normal((3, 2, 2))
    blocks = np.kron(np.eye(n // 10), np.full(10, 0.1))
    weight = rng.uniform(0.5, 1.5, (n // 10, 2))
    theta = np.zeros(4)
    sd = np.array([0.3, 0.5])
    theta[LOG_H] = np.log(700.0)
    requested_h: list[float] = []

    def gains_at(h_W_m2K: float) -> SimpleNamespace:
        requested_h.append(h_W_m2K)
        return SimpleNamespace(rates=rates, direct=direct, gains=gains)

    monkeypatch.setattr(noise, "input_noise", lambda test, disk_block: sd.copy())
    rim = SimpleNamespace(gains=gains_at)
    window = SimpleNamespace(
        rim=rim, y=np.zeros((n // 10, 2)), weight=weight, blocks=blocks, time_s=dt * np.arange(n)
    )
    disk_block = cast(Any, SimpleNamespace(window=window, y=np.zeros(weight.size)))
    test = cast(Any, SimpleNamespace(dt_s=dt))
    directions = rng.standard_normal((weight.size, 3))

    lagged = [
        lfilter([1 - np.exp(-r * dt)], [1, -np.exp(-r * dt)], np.eye(n), axis=0) for r in rates
    ]
    expected = np.zeros((3, 3))
    for i, sigma in enumerate(sd, start=1):
        responses = [
            blocks @ (d * np.eye(n) + g[0] * lagged[0] + g[1] * lagged[1])
            for d, g in zip(direct[i], gains[i])
        ]
        rows = np.einsum(
            "rpd,rp,prn->dn", directions.reshape(*weight.shape, -1), weight, np.array(responses)
        )
        expected += sigma**2 * rows @ rows.T
    result = input_noise_covariance(test, disk_block, theta, directions)
    assert requested_h == pytest.approx([700.0])
    # a lag of one sample differs slightly from none
    assert np.abs(result - expected).max() < 0.02 * np.diag(expected).max()
    total = noise_covariance(
        test,
        [disk_block, disk_block],
        np.tile(theta, 2),
        np.vstack([directions, 2 * directions]),
        np.zeros(2 * len(directions)),
    )
    assert total == pytest.approx(np.eye(3) + 5 * result)  # identity: the noise of the data
