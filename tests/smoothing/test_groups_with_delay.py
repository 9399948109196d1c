"""Groups of channels that are compensated with a fixed delay do not depend on each other."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping

import numpy as np
import pytest
from numpy.typing import NDArray

from tcdyn.chain import Chain
from tcdyn.core.estimate import Estimate
from tcdyn.sensors.channels import Channel, ChannelGroup, TableChannels
from tcdyn.sensors.compensation import compensated_segments
from tcdyn.sensors.delayed import DelayedSmoother
from tcdyn.series.series import Context
from tcdyn.series.units import Unit

Array = NDArray[np.float64]
RATE_HZ, DELAY_S, W = 20.0, 2.0, 0.5
LAGS_S = {"quick": 0.5, "slow": 6.0}


class Rows:
    """A source of columns (N,) at even times."""

    def __init__(self, columns: Mapping[str, Array]) -> None:
        self.columns = columns

    def read_chunks(self, names: object) -> Iterator[tuple[Array, dict[str, Array], tuple[()]]]:
        count = len(next(iter(self.columns.values())))
        yield np.arange(count) / RATE_HZ, dict(self.columns), ()


def wave(name: str, count: int) -> Array:
    """A sine of 5 K behind the lag of a channel, in its steady state, with noise."""
    lag_s = LAGS_S[name]
    phase = W * np.arange(count) / RATE_HZ - np.arctan(W * lag_s)
    noise = np.random.default_rng(len(name)).normal(0.0, 0.05, count)
    return np.asarray(80 + 5 * np.sin(phase) / np.hypot(1.0, W * lag_s) + noise)


def delayed(columns: Mapping[str, Array]) -> dict[str, Array]:
    """Results and u of channels, each a group of its own."""
    groups = []
    for name in columns:
        chain = Chain(LAGS_S[name])
        channel = Channel(name, Unit(), chain, Estimate.normal(chain.lag_s, 0.0), None, "s")
        groups.append(ChannelGroup((channel,), np.zeros((1, 1)), np.zeros(1)))
    channels = TableChannels(tuple(groups), Context("rows"))
    segments = list(compensated_segments(Rows(columns), list(columns), channels, delay_s=DELAY_S))
    for segment in segments:
        assert segment.delayed is not None
        again = DelayedSmoother.from_dict(json.loads(json.dumps(segment.delayed.to_dict())))
        assert again.to_dict() == segment.delayed.to_dict()
    names = [each for name in columns for each in (name, f"{name}_u_K")]
    return {name: np.concatenate([s.columns[name] for s in segments]) for name in names}


def truth(count: int) -> Array:
    return np.asarray(80 + 5 * np.sin(W * np.arange(count) / RATE_HZ))


@pytest.mark.e2e
def test_the_order_of_channels_of_other_lags_changes_nothing() -> None:
    """Each group continues from a row of its own: that of its lag before the block."""
    waves = {name: wave(name, 900) for name in LAGS_S}
    one = delayed(waves)
    other = delayed(dict(reversed(waves.items())))
    settled = slice(200, None)
    for name in waves:
        assert np.array_equal(one[name], other[name])
        error = np.abs(one[name] - truth(900))[settled]
        assert np.mean(error < 1.96 * one[f"{name}_u_K"][settled]) > 0.9
        assert np.sqrt(np.mean(error**2)) < 1.5 * np.median(one[f"{name}_u_K"][settled])


@pytest.mark.e2e
def test_a_channel_that_is_silent_for_some_blocks_continues_from_its_own_row() -> None:
    y = wave("quick", 1600)
    y[500:1000] = np.nan
    result = delayed({"quick": y, "slow": wave("slow", 1600)})
    x = result["quick"]
    u = result["quick_u_K"]
    is_known = np.isfinite(x)
    is_known[:200] = False
    assert is_known[:490].sum() == 290
    assert is_known[1000:].all()
    error = np.abs(x - truth(1600))
    assert np.mean((error < 1.96 * u)[is_known]) > 0.9
    again = slice(1020, 1300)
    assert np.mean((error < 1.96 * u)[again]) > 0.9
    assert np.median(u[again]) < 2 * np.median(u[200:490])
