"""Noise that comes in with what drives the model: by frequencies as sample by sample, the smoothing turned round."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy.signal import lfilter, savgol_filter

from tcdyn.campaign import input_noise as noise
from tcdyn.campaign.input_noise import (
    friction_zero_u_N,
    input_noise_covariance,
    noise_covariance,
    smoothing_adjoint,
)
from tcdyn.partition.joint import LOG_H, SHARE
from tcdyn.rig.contact import SWITCHING_MARGIN_S, smoothing_samples

DT, LAST, N, BEGUN_S = 0.02, 300, 340, 1.0  # the log's clock begins at a second


def stand_in(noise_N: float) -> Any:
    """A test whose disks part at sample 330, its load falling from sample 300 + the settling on."""
    off = BEGUN_S + (LAST - 0.5) * DT + 0.3 + SWITCHING_MARGIN_S
    events = SimpleNamespace(
        unload_s=off, fall_time_s=0.3, load_on_s=BEGUN_S + 2.5 + SWITCHING_MARGIN_S
    )
    time_s = BEGUN_S + DT * np.arange(N)
    return SimpleNamespace(
        friction_noise_N=noise_N, friction_N=20.0, dt_s=DT, events=events, time_s=time_s
    )


@pytest.mark.parametrize("noise_N", [0.0, 0.6])
def test_turning_the_smoothing_round_is_its_transpose(noise_N: float) -> None:
    """What a combination of the smoothed friction is of the logged one: S' w, S by its answer to each sample alone."""
    n = smoothing_samples(noise_N, 20.0, DT, LAST)
    straight = savgol_filter(np.eye(LAST), n, 1, axis=0, mode="interp")
    smoothing = np.zeros((N, N))
    smoothing[:LAST, :LAST] = straight
    smoothing[LAST:, :LAST] = straight[-1]  # held from the last sample before the load falls
    toward = np.random.default_rng(0).standard_normal((N, 2))
    toward[:n] = 0.0  # at the very beginning it is a running mean only
    found = smoothing_adjoint(cast(Any, stand_in(noise_N)), toward, BEGUN_S + DT * np.arange(N))
    assert found == pytest.approx(smoothing.T @ toward, abs=1e-12)


def test_the_zero_is_known_by_the_longer_of_its_two_stretches() -> None:
    """A median scatters 1.25 times as far as a mean; 2.5 s before loading, nothing after the unloading."""
    assert friction_zero_u_N(stand_in(0.6)) == pytest.approx(1.25 * 0.6 / np.sqrt(2.5 / DT))
    made = stand_in(0.6)
    made.time_s = BEGUN_S + DT * np.arange(N + 400)
    after_s = made.time_s[-1] - made.events.unload_s - SWITCHING_MARGIN_S
    assert after_s > 5
    assert friction_zero_u_N(made) == pytest.approx(1.25 * 0.6 / np.sqrt(after_s / DT))


def test_noise_of_the_inputs_is_that_of_each_sample_through_lags_and_blocks(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Three inputs, each straight and through two first-order lags, in blocks of ten samples at two points."""
    rng, dt, n = np.random.default_rng(1), 0.05, 400
    rates, direct, gains = (
        np.array([0.4, 1.5]),
        rng.standard_normal((3, 2)),
        rng.standard_normal((3, 2, 2)),
    )
    blocks, weight = np.kron(np.eye(n // 10), np.full(10, 0.1)), rng.uniform(0.5, 1.5, (n // 10, 2))
    theta, sd = np.zeros(4), np.array([2.0, 0.3, 0.5])
    theta[SHARE], theta[LOG_H] = 0.6, np.log(700.0)
    asked: list[float] = []

    def at(h_W_m2K: float) -> SimpleNamespace:
        asked.append(h_W_m2K)
        return SimpleNamespace(rates=rates, direct=direct, gains=gains)

    monkeypatch.setattr(noise, "input_noise", lambda test, side: sd.copy())
    rim = SimpleNamespace(gains=at)
    window = SimpleNamespace(
        rim=rim, y=np.zeros((n // 10, 2)), weight=weight, blocks=blocks, time_s=dt * np.arange(n)
    )
    side = cast(Any, SimpleNamespace(window=window, y=np.zeros(weight.size)))
    events = SimpleNamespace(
        unload_s=3.4 * dt + SWITCHING_MARGIN_S, fall_time_s=0.0
    )  # too early for the friction to be smoothed
    test = cast(Any, SimpleNamespace(friction_noise_N=1.0, friction_N=20.0, dt_s=dt, events=events))
    toward = rng.standard_normal((weight.size, 3))

    lagged = [
        lfilter([1 - np.exp(-r * dt)], [1, -np.exp(-r * dt)], np.eye(n), axis=0) for r in rates
    ]
    expected = np.zeros((3, 3))
    for i, sigma in enumerate(sd * [0.6, 1.0, 1.0]):
        seen = [
            blocks @ (d * np.eye(n) + g[0] * lagged[0] + g[1] * lagged[1])
            for d, g in zip(direct[i], gains[i])
        ]
        rows = np.einsum(
            "rpd,rp,prn->dn", toward.reshape(*weight.shape, -1), weight, np.array(seen)
        )
        expected += sigma**2 * rows @ rows.T
    found = input_noise_covariance(test, side, theta, toward)
    assert asked == pytest.approx([700.0])
    assert (
        np.abs(found - expected).max() < 0.02 * np.diag(expected).max()
    )  # a lag of a sample is not quite one of none
    both = noise_covariance(
        test,
        [side, side],
        np.tile(theta, 2),
        np.vstack([toward, 2 * toward]),
        np.zeros(2 * len(toward)),
    )
    assert both == pytest.approx(np.eye(3) + 5 * found)  # and the data's own noise
