"""Channels of different lag are given one common lag without inverting anything."""

import numpy as np

from tcdyn.chain import Chain, equalise
from tcdyn.rig.disk import Conditioning

B = Conditioning(4.0, 2)
DT = 1 / 75


def test_equalised_channels_of_one_input_agree() -> None:
    t = np.arange(0, 40, DT)
    x = 100 - 15 * (1 - np.exp(-np.clip(t - 20, 0, None) / 3))
    chains = (
        Chain((0.5, 0.1), conditioning=B),
        Chain((0.6, 0.1), conditioning=B),
        Chain((0.55, 0.14), conditioning=B),
    )
    common = Chain((0.55, 0.113), conditioning=B)
    y = np.column_stack([c.response(x, DT) for c in chains])
    out = equalise(y, DT, chains, common)
    want = common.response(x, DT)
    assert np.abs(y[:, 0] - want).max() > 0.15  # they differ before
    assert (
        np.abs(out - want[:, None]).max() < 2e-3
    )  # FOH of lagged traces, second order in DT / tau = 0.02


def test_noise_grows_at_most_by_the_ratio_of_the_lags() -> None:
    rng = np.random.default_rng(1)
    y = 50 + rng.normal(0, 0.1, (20000, 1))
    out = equalise(y, DT, (Chain((0.66, 0.1), conditioning=B),), Chain((0.6, 0.1), conditioning=B))
    assert out.std() < 1.1 * 0.1 * 1.01
