"""Channels of different lag are brought to one common lag without an inversion."""

import numpy as np

from tcdyn.chain import Chain, equalise
from tcdyn.rig.disk import Conditioning

B = Conditioning(4.0, 2)
DT = 1 / 75


def test_equalised_channels_of_one_input_agree() -> None:
    t = np.arange(0, 40, DT)
    true_degC = 100 - 15 * (1 - np.exp(-np.clip(t - 20, 0, None) / 3))
    chains = (
        Chain((0.5, 0.1), conditioning=B),
        Chain((0.6, 0.1), conditioning=B),
        Chain((0.55, 0.14), conditioning=B),
    )
    common = Chain((0.55, 0.113), conditioning=B)
    readings = np.column_stack([chain.response(true_degC, DT) for chain in chains])
    equalised = equalise(readings, DT, chains, common)
    expected = common.response(true_degC, DT)
    assert np.abs(readings[:, 0] - expected).max() > 0.15  # the channels differ before
    # first-order hold of lagged traces, second order in DT / tau = 0.02
    assert np.abs(equalised - expected[:, None]).max() < 2e-3


def test_noise_increases_at_most_by_the_ratio_of_the_lags() -> None:
    rng = np.random.default_rng(1)
    readings = 50 + rng.normal(0, 0.1, (20000, 1))
    equalised = equalise(
        readings, DT, (Chain((0.66, 0.1), conditioning=B),), Chain((0.6, 0.1), conditioning=B)
    )
    assert equalised.std() < 1.1 * 0.1 * 1.01
