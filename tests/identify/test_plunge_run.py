"""What of a plunge reaches the fit."""

from __future__ import annotations

import numpy as np

from tcdyn.identify.plunge_run import despiked


def test_the_steps_of_a_coarse_logger_are_no_spikes() -> None:
    """12 bits over 860 degC and 0.12 K of noise: a sample one step off its neighbours is no spike."""
    rng = np.random.default_rng(0)
    step = 860 / 2**12
    warm = 26 + 80 * (1 - np.exp(-np.arange(0, 100, 1 / 75) / 40))
    y = np.round((warm[:, None] + 0.12 * rng.standard_normal((len(warm), 2))) / step) * step
    y[3000, 0] += 15.0
    clean, spikes = despiked(y)
    assert np.isnan(clean[3000, 0])
    assert spikes < 10  # of 15000 samples; 6 sd of the rounding is 1.8 steps, 1.3 times that 2.3
