"""Logs with spikes, bursts and unloadings, compensated with a fixed delay: error and coverage."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tcdyn.chain import Chain
from tcdyn.rig.disk import Conditioning
from tcdyn.workflows.follow import follow
from tests.smoothing.live_world import NAMES, NOISE_K, TAUS_S, record, with_delay, world

CHAIN = Chain(TAUS_S, conditioning=Conditioning(cutoff_Hz=4.0, poles=2))
DT_S = 1 / 75
DELAY_S = 2.0
SETTLED_S = 5.0


@pytest.mark.long
@pytest.mark.e2e
@pytest.mark.parametrize("before", [0.0, 0.97], ids=["white", "before the filter"])
def test_unloadings_without_bursts_are_followed_within_the_band(before: float) -> None:
    """Forty seconds of three channels, two kinks of 12 K in 3 s. The smoother without delay has an
    rms of 0.64 K."""
    made = world(40.0, before, 31, bursts_s=1e9, drops_K=(12.0,), channels=3)
    x, sd = with_delay(made.readings, DT_S, CHAIN, DELAY_S)
    settled = made.time_s > SETTLED_S
    error = (x - made.true[:, None])[settled]
    assert np.all(np.isfinite(error))
    assert np.sqrt(np.mean(error**2)) < 1.5 * NOISE_K
    assert np.mean(np.abs(error) < 1.96 * sd[settled]) > 0.9


@pytest.mark.long
@pytest.mark.study
@pytest.mark.parametrize("before", [0.0, 0.97], ids=["white", "before the filter"])
def test_bursts_of_the_slip_rings_leave_most_samples_within_the_band(
    before: float, draws: Callable[[int], int]
) -> None:
    """Six channels with a burst every forty seconds in each, and lone outliers: 30 s, 120 s with
    ``--full``."""
    made = world(float(draws(120)), before, 32, bursts_s=40.0, drops_K=(12.0,))
    x, sd = with_delay(made.readings, DT_S, CHAIN, DELAY_S)
    settled = made.time_s > SETTLED_S
    error = (x - made.true[:, None])[settled]
    assert np.mean(np.abs(error) < 1.96 * sd[settled]) > 0.9
    assert np.median(np.abs(error)) < NOISE_K


@pytest.mark.long
@pytest.mark.e2e
def test_a_lag_that_divides_otherwise_than_the_record_says_is_within_the_band(
    tmp_path: Path,
) -> None:
    """An unloading by 30 K and a record that takes nearly all of the lag for one: 2.8 sd, were that
    not counted."""
    made = world(12.0, 0.0, 5, bursts_s=1e9, drops_K=(30.0,))
    made.log().to_csv(tmp_path / "log.csv", index=False)
    records = {"fast": record(split_s=-0.06)}
    out = tmp_path / "out.csv"
    run = follow(tmp_path / "log.csv", records, out, delay_s=4.0, idle_s=0.01, poll_s=0.02)
    done = pd.read_csv(out)
    assert run.rows_written == len(done) == len(made.time_s)
    error = done[NAMES].to_numpy() - made.true[:, None]
    sd = done[[n.replace("_degC", "_u_K") for n in NAMES]].to_numpy()
    assert np.mean(np.abs(error) < 1.96 * sd) > 0.9
    # samples at the kink itself may lie further off: the largest was 11 sd
    assert np.mean((np.abs(error) / sd)[made.time_s > SETTLED_S] < 3.0) > 0.95
