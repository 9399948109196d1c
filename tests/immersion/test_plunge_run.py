"""What of a plunge reaches the fit."""

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


def test_the_steps_of_a_coarse_logger_are_no_spikes() -> None:
    """12 bits over 860 degC and 0.12 K of noise: a sample one step off its neighbours is no spike."""
    rng = np.random.default_rng(0)
    step = 860 / 2**12
    warm = 26 + 80 * (1 - np.exp(-np.arange(0, 100, 1 / 75) / 40))
    y = np.round((warm[:, None] + 0.12 * rng.standard_normal((len(warm), 2))) / step) * step
    y[3000, 0] += 15.0
    clean, spikes = without_spikes(y)
    assert np.isnan(clean[3000, 0])
    assert spikes < 10  # of 15000 samples; 6 sd of the rounding is 1.8 steps, 1.3 times that 2.3


def test_missing_readings_are_left_out_and_only_the_bath_is_bridged() -> None:
    """A line across 0.45 s of the first second would be read as a lag."""
    frame, truth = simulate_plunge("fast", 3)
    gap = frame["time_s"].between(truth["entry_s"] + 0.5, truth["entry_s"] + 0.95)
    holed = frame.mask(pd.DataFrame({c: gap & (c in ("e_degC", "probe_degC")) for c in frame}))
    run = run_from_log(
        with_filled_bath(Log(holed, "immersion", Path("P1.csv"), "", 1 / 75)), "mobil-jet-ii"
    )
    assert run.entry == run_from_log(frame, "mobil-jet-ii").entry
    blocks = make_blocks(run)
    whole = make_blocks(run_from_log(frame, "mobil-jet-ii"))
    assert whole.duration_s == blocks.duration_s
    lost = np.flatnonzero(blocks.count[:, 4] < whole.count[:, 4])
    assert whole.count.sum() - blocks.count.sum() == gap.sum()
    np.testing.assert_allclose(whole.time_s[lost], 0.73, atol=0.25)
    assert np.isfinite(blocks.readings_degC).all()
    np.testing.assert_allclose(
        blocks.readings_degC[:, :4], whole.readings_degC[:, :4], rtol=1e-15 * 2**3
    )  # rounding


ALTERNATING = np.where(
    np.arange(80) % 2, -1.0, 1.0
)  # no neighbour is like the next: its correlation length is one


def test_noise_that_all_channels_share_is_told_from_that_of_each() -> None:
    """z = a s on all channels, and b s, -b s, 0 on three of them: mean squares over what the fit leaves free."""
    z = 1.5 * ALTERNATING[:, None] + 0.7 * ALTERNATING[:, None] * [1.0, -1.0, 0.0]
    common, differential = variance_factors(z, 9, 6)
    assert common == pytest.approx(3 * 80 * 1.5**2 / (80 - 9))
    assert differential == pytest.approx(80 * 2 * 0.7**2 / (80 * 2 - 6))
    assert variance_factors(z[:, :1], 9, 6) == pytest.approx(
        (80 * 2.2**2 / (80 - 9), 1.0)
    )  # one channel alone
    assert variance_factors(0.01 * z, 9, 6) == (0.25, 0.25)


def test_noise_as_a_fit_leaves_it_is_a_mean_square_over_what_is_free_without_a_block_that_is_off() -> (
    None
):
    """Means of 4 and of 9 samples of 0.3 K, nine and three a channel for the fit; one block 10 times as far off."""
    count = np.where(np.arange(80) < 40, 4, 9)[:, None]
    residual = 0.3 * ALTERNATING[:, None] * [1.0, 1.0] / np.sqrt(count)
    sd = 0.3 / np.sqrt(1 - (9 + 3 * 2) / 160)
    assert RunNoise.from_residuals(residual, count).sd_K == pytest.approx([sd, sd])
    residual[17, 1] *= 10
    found = RunNoise.from_residuals(residual, count)
    assert found.sd_K == pytest.approx([sd, sd])
    assert found.weight[17, 1] == pytest.approx(4 / (3 / sd))
    assert np.delete(found.weight, 2 * 17 + 1) == pytest.approx(np.ones(159))
