"""Noise that comes in with what drives the model: the smoothing of the friction turned round."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy.signal import savgol_filter

from tcdyn.campaign.noise import unsmoothed, zero_u
from tcdyn.contact import SETTLE_S, line_length

DT, LAST, N, BEGUN_S = 0.02, 300, 340, 1.0  # the log's clock begins at a second


def stand_in(noise_N: float) -> Any:
    """A test whose disks part at sample 330, its load falling from sample 300 + the settling on."""
    off = BEGUN_S + (LAST - 0.5) * DT + 0.3 + SETTLE_S
    events = SimpleNamespace(unload_s=off, parting_s=0.3, load_on_s=BEGUN_S + 2.5 + SETTLE_S)
    time_s = BEGUN_S + DT * np.arange(N)
    return SimpleNamespace(friction_noise_N=noise_N, friction_N=20.0, dt_s=DT, events=events, time_s=time_s)


@pytest.mark.parametrize("noise_N", [0.0, 0.6])
def test_turning_the_smoothing_round_is_its_transpose(noise_N: float) -> None:
    """What a combination of the smoothed friction is of the logged one: S' w, S by its answer to each sample alone."""
    n = line_length(noise_N, 20.0, DT, LAST)
    straight = savgol_filter(np.eye(LAST), n, 1, axis=0, mode="interp")
    smoothing = np.zeros((N, N))
    smoothing[:LAST, :LAST] = straight
    smoothing[LAST:, :LAST] = straight[-1]  # held from the last sample before the load falls
    toward = np.random.default_rng(0).standard_normal((N, 2))
    toward[:n] = 0.0  # at the very beginning it is a running mean only
    found = unsmoothed(cast(Any, stand_in(noise_N)), toward, BEGUN_S + DT * np.arange(N))
    assert found == pytest.approx(smoothing.T @ toward, abs=1e-12)


def test_the_zero_is_known_by_the_longer_of_its_two_stretches() -> None:
    """A median scatters 1.25 times as far as a mean; 2.5 s before loading, nothing after the unloading."""
    assert zero_u(stand_in(0.6)) == pytest.approx(1.25 * 0.6 / np.sqrt(2.5 / DT))
    made = stand_in(0.6)
    made.time_s = BEGUN_S + DT * np.arange(N + 400)
    after_s = made.time_s[-1] - made.events.unload_s - SETTLE_S
    assert after_s > 5
    assert zero_u(made) == pytest.approx(1.25 * 0.6 / np.sqrt(after_s / DT))
