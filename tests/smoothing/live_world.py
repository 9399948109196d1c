"""Logs as slip rings and wires make them, by oversampled lags: code that the smoothers share
nothing with."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.signal import lfilter

from tcdyn.chain import Chain
from tcdyn.core.estimate import Estimate
from tcdyn.rig.record import ChainRecord, ChannelChain, DiskRecord
from tcdyn.rig.static_line import StaticLine
from tcdyn.sensors.channels import Channel, ChannelGroup, TableChannels
from tcdyn.sensors.compensation import compensated_segments
from tcdyn.series.series import Context
from tcdyn.series.units import Unit

Array = NDArray[np.float64]
NAMES = [f"fast_{c}_degC" for c in "abcdef"]
TAUS_S, FILTER_S, FILTER_POLES = (0.6, 0.07), 1 / (2 * np.pi * 4.0), 2
NOISE_K, OVER, RUN_UP_S = 0.12, 8, 20.0


@dataclass(frozen=True)
class World:
    """Samples at ``time_s`` (N,): ``true`` (N,) [degC] of all six junctions, and their ``readings``
    (N, 6).

    ``kinks_s``: unloadings and reloadings; ``burst`` (N, 6): a burst is on, or was less than half a
    second ago.
    """

    time_s: Array
    true: Array
    readings: Array
    kinks_s: Array
    burst: NDArray[np.bool_]

    def log(self) -> pd.DataFrame:
        """As an EHL log in contact all the time."""
        rest = {
            "load_N": 100.0,
            "friction_N": 5.0,
            "contact": 1,
            "speed_fast_rpm": 4000.0,
            "speed_slow_rpm": 950.0,
        }
        frame = pd.DataFrame({"time_s": self.time_s, **rest})
        frame[NAMES[: self.readings.shape[1]]] = self.readings
        return frame.assign(
            **{n.replace("fast", "slow"): 60.0 for n in NAMES}, ambient_degC=25.0, oil_degC=60.0
        ).round(4)


def lagged(u: Array, tau_s: float, dt_s: float) -> Array:
    """A first-order lag of an input held over each fine step, from rest at its first value."""
    e = np.exp(-dt_s / tau_s)
    return np.asarray(lfilter([0.0, 1 - e], [1.0, -e], u - u[0], axis=0) + u[0])


def world(
    total_s: float,
    before: float | Array,
    seed: int,
    *,
    rate_Hz: float = 75.0,
    bursts_s: float = 60.0,
    drops_K: tuple[float, ...] = (12.0, 12.0, 12.0),
    channels: int = 6,
    part_s: tuple[float, float] | None = None,
) -> World:
    """``before``: share of the noise's amplitude that enters before the filter, one or one a
    channel; a burst every ``bursts_s`` a channel. Of ``part_s`` alone, after a run-up, where the
    whole is too long for the memory.

    Unloadings by ``drops_K``, each with a reloading, on slow waves; lone outliers of 1.5 K every 20
    s a channel; bursts of 0.5 to 3 K that last 20 to 300 ms and enter before the filter.
    """
    begin, end = part_s or (0.0, total_s)
    rng, origin = (
        np.random.default_rng([seed, int(begin)] if part_s else seed),
        max(begin - RUN_UP_S, 0.0),
    )
    n, fine = round((end - origin) * rate_Hz), 1 / rate_Hz / OVER
    t = origin + np.arange(n * OVER) * fine
    x = 80 + 3 * np.sin(2 * np.pi * t / 200) + 0.5 * np.sin(2 * np.pi * t / 23)
    kinks = [
        total_s * (k + share) / len(drops_K) + 0.0041
        for k in range(len(drops_K))
        for share in (0.5, 0.8)
    ]
    for drop, off, on in zip(drops_K, kinks[::2], kinks[1::2]):
        x -= drop * (np.exp(-np.maximum(t - on, 0.0) / 3) - np.exp(-np.maximum(t - off, 0.0)))
    y = np.tile(x[:, None], (1, channels))
    for tau in TAUS_S:
        y = lagged(y, tau, fine)
    pulse, noise = np.zeros(4000), rng.standard_normal(y.shape)
    pulse[1] = 1.0
    for _ in range(FILTER_POLES):
        pulse = lagged(pulse, FILTER_S, fine)
    y += before * NOISE_K / np.sqrt(np.sum(pulse**2)) * noise
    burst = np.zeros((n, channels), dtype=bool)
    for c in range(channels):
        for start in rng.uniform(0, end - origin, rng.poisson((end - origin) / bursts_s)):
            first, last = (int(s / fine) for s in (start, start + rng.uniform(0.02, 0.3)))
            y[first:last, c] += rng.choice([-1, 1]) * rng.uniform(0.5, 3.0)
            burst[first // OVER : last // OVER + int(0.5 * rate_Hz), c] = True
    for _ in range(FILTER_POLES):
        y = lagged(y, FILTER_S, fine)
    out = y[::OVER] + np.sqrt(1 - before**2) * NOISE_K * rng.standard_normal((n, channels))
    for c in range(channels):
        at = rng.integers(0, n, rng.poisson((end - origin) / 20))
        out[at, c] += 1.5 * rng.choice([-1, 1], len(at))
    own = slice(round((begin - origin) * rate_Hz), None)
    return World(t[::OVER][own], x[::OVER][own], out[own], np.array(kinks), burst[own])


def with_delay(
    y: Array, dt_s: float, chain: Chain, delay_s: float, channels_together: int = 6
) -> tuple[Array, Array]:
    """Results and sd (N, M) of the readings ``y`` (N, M) with a fixed delay, as ``follow`` gives
    them."""
    names = [f"c{k}" for k in range(y.shape[1])]
    groups = []
    for first in range(0, len(names), channels_together):
        channels = [
            Channel(name, Unit(), chain, Estimate.normal(chain.lag_s, 0.0), None, "s")
            for name in names[first : first + channels_together]
        ]
        count = len(channels)
        groups.append(ChannelGroup(tuple(channels), np.zeros((count, count)), np.zeros(count)))

    class Source:
        def read_chunks(
            self, columns: object
        ) -> Iterator[tuple[Array, dict[str, Array], tuple[()]]]:
            yield np.arange(len(y)) * dt_s, dict(zip(names, y.T)), ()

    segments = compensated_segments(
        Source(), names, TableChannels(tuple(groups), Context("world")), delay_s=delay_s
    )
    made = [segment.columns for segment in segments]
    x = np.stack([np.concatenate([c[name] for c in made]) for name in names], axis=1)
    sd = np.stack([np.concatenate([c[f"{name}_u_K"] for c in made]) for name in names], axis=1)
    return x, sd


def record(split_s: float = 0.0) -> DiskRecord:
    """The fast disk that made it, known exactly; but for ``split_s`` of its first lag, taken for
    its second's."""
    lag = Estimate.normal(sum(TAUS_S) + FILTER_POLES * FILTER_S, 0.0)
    line = StaticLine(
        gain=1.0, offset=0.0, covariance=((0.0, 0.0), (0.0, 0.0)), range_degC=(20.0, 160.0)
    )
    taus = (TAUS_S[0] - split_s, TAUS_S[1] + split_s)
    chain = ChainRecord(
        structure="two lags",
        channels={
            c: ChannelChain(taus_s=taus, lag_s=lag, split_u_s=abs(split_s)) for c in "abcdef"
        },
        covariance=np.zeros((6, 6)).tolist(),
        common_lag_s=lag,
        differential_lag_s={c: Estimate.normal(0.0, 0.0) for c in "abcdef"},
    )
    return DiskRecord(
        disk="fast", created="2026-01-01", static=dict.fromkeys("abcdef", line), chain=chain
    )
