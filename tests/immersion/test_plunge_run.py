"""Selection and noise of the readings of a plunge that enter the fit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from immersion.plunge_data import (
    RunNoise,
    make_blocks,
    run_from_log,
    variance_factors,
    with_filled_bath,
    without_spikes,
)
from tcdyn.rig.log import Log
from tcdyn.simulate.plunge import simulate_plunge


def test_steps_of_a_coarse_logger_are_not_spikes() -> None:
    """12 bits over 860 degC and 0.12 K of noise: a sample one step from its neighbours is not a
    spike."""
    rng = np.random.default_rng(0)
    step = 860 / 2**12
    warm = 26 + 80 * (1 - np.exp(-np.arange(0, 100, 1 / 75) / 40))
    y = np.round((warm[:, None] + 0.12 * rng.standard_normal((len(warm), 2))) / step) * step
    y[3000, 0] += 15.0
    clean, spikes = without_spikes(y)
    assert np.isnan(clean[3000, 0])
    assert spikes < 10  # of 15000 samples; 6 sd of the rounding are 1.8 steps, times 1.3: 2.3


def test_missing_readings_are_left_out_and_only_the_bath_is_interpolated() -> None:
    """A straight line across 0.45 s of the first second would be taken for a lag."""
    frame, true_values = simulate_plunge("fast", 3)
    gap = frame["time_s"].between(true_values["entry_s"] + 0.5, true_values["entry_s"] + 0.95)
    with_gap = frame.mask(pd.DataFrame({c: gap & (c in ("e_degC", "probe_degC")) for c in frame}))
    run = run_from_log(
        with_filled_bath(Log(with_gap, "immersion", Path("P1.csv"), "", 1 / 75)), "mobil-jet-ii"
    )
    assert run.entry == run_from_log(frame, "mobil-jet-ii").entry
    blocks = make_blocks(run)
    full_blocks = make_blocks(run_from_log(frame, "mobil-jet-ii"))
    assert full_blocks.duration_s == blocks.duration_s
    lost = np.flatnonzero(blocks.count[:, 4] < full_blocks.count[:, 4])
    assert full_blocks.count.sum() - blocks.count.sum() == gap.sum()
    np.testing.assert_allclose(full_blocks.time_s[lost], 0.73, atol=0.25)
    assert np.isfinite(blocks.readings_degC).all()
    # rounding
    np.testing.assert_allclose(
        blocks.readings_degC[:, :4], full_blocks.readings_degC[:, :4], rtol=1e-15 * 2**3
    )


# the correlation length is one
ALTERNATING = np.where(np.arange(80) % 2, -1.0, 1.0)


def test_noise_common_to_all_channels_is_separated_from_that_of_each() -> None:
    """z = a s on all channels, and b s, -b s, 0 on three of them: mean squares over the degrees of
    freedom of the fit."""
    z = 1.5 * ALTERNATING[:, None] + 0.7 * ALTERNATING[:, None] * [1.0, -1.0, 0.0]
    common, differential = variance_factors(z, 9, 6)
    assert common == pytest.approx(3 * 80 * 1.5**2 / (80 - 9))
    assert differential == pytest.approx(80 * 2 * 0.7**2 / (80 * 2 - 6))
    # a single channel
    single = variance_factors(z[:, :1], 9, 6)
    assert single == pytest.approx((80 * 2.2**2 / (80 - 9), 1.0))
    assert variance_factors(0.01 * z, 9, 6) == (0.25, 0.25)


def test_noise_of_residuals_is_their_mean_square_over_the_dof_without_outlying_blocks() -> None:
    """Means of 4 and of 9 samples of 0.3 K; nine common and three parameters a channel; one block
    is 10 times as far off."""
    count = np.where(np.arange(80) < 40, 4, 9)[:, None]
    residual = 0.3 * ALTERNATING[:, None] * [1.0, 1.0] / np.sqrt(count)
    sd = 0.3 / np.sqrt(1 - (9 + 3 * 2) / 160)
    assert RunNoise.from_residuals(residual, count).sd_K == pytest.approx([sd, sd])
    residual[17, 1] *= 10
    noise = RunNoise.from_residuals(residual, count)
    assert noise.sd_K == pytest.approx([sd, sd])
    assert noise.weight[17, 1] == pytest.approx(4 / (3 / sd))
    assert np.delete(noise.weight, 2 * 17 + 1) == pytest.approx(np.ones(159))
