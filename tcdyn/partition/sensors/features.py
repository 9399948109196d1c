"""Few numbers of a disk that tell its junctions apart, of the steady level and after each event, what the rim makes of
them whatever column reads which place, and what unmeasured things do to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from calibration import Array
from calibration.disk import DiskSetup
from tcdyn.chain import equalised
from tcdyn.conduction.rim import lag_bank, node_rates
from tcdyn.partition.effects import by_inputs, departures, stated_effects
from tcdyn.partition.events import EhlTest
from tcdyn.partition.statement.track import SHIFT_STEP_M, by_edge
from tcdyn.partition.uneven import sensed
from tcdyn.partition.window import (
    GRADIENT_STEP_M,
    NOMINAL,
    Perturbation,
    RimMeans,
    between,
    film_seen,
    power_seen,
)  # fmt: skip
from tcdyn.traces import STAND_IN_K, DiskTraces

Order = tuple[int, ...]
Place = Literal["outer row", "inside", "inner row"]  # just inside the inner row; this row, of a rim to the bore
Window = tuple[str, float, float]  # event that it follows, start, stop [s]
STEADY_S = 100.0
BASE_S = 8.0
BEFORE_S = 12.0
FORGET_S = 20.0
AFTER_UNLOADING_S = ((0.3, 1.0), (1.0, 2.0), (2.0, 4.0), (4.0, 8.0))
AFTER_LOADING_S = ((1.0, 2.5), (2.5, 5.0), (5.0, 10.0))
LAG_STEP_S = 0.05
SLOWEST_PER_S = 0.02
BEND_S = 40.0  # a disk under load warms up with about this time constant
THICK_S = 5.0  # heat needs some ten seconds to the bore and back
FEATURE_DEPTH_M = 0.1e-3


@dataclass(frozen=True)
class DiskFeatures:
    """Window means of one disk, W windows, each after one ``event``: "steady", "unloading" or "loading".

    ``after_s`` (W,): middle of the window since the event; ``inputs`` (W, C + 3) and ``banks`` (C + 3, W, K): power
    [W], C channels, ambient [degC], and the power when the chain is ``LAG_STEP_S`` slower, and where speeds change the
    film's two; ``slope`` (W, C) mean rate of each channel [K/s], less that of the base; ``noise`` (W,) white noise left
    of one; ``bend`` (W, C) how far a trend before the event may have bent since [K].

    The outer row is predicted from the inner row; the inner row itself only in the first seconds after an event, when
    the bore does not yet feel it, by a rim that reaches to the bore: ``seen`` (W, C) in the order of the disk's rows;
    ``drives`` as of ``DiskTraces``; ``shift_u_m``: how well the place of the flux is stated [m]."""

    disk: str
    setup: DiskSetup
    half_width_m: float
    rates_1_s: Array
    event: NDArray[np.str_]
    after_s: Array
    inputs: Array
    banks: Array
    slope: Array
    noise: Array
    bend: Array
    seen: NDArray[np.bool_]
    drives: Array
    shift_u_m: float = 0.0

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the inputs; of the film where speeds change."""
        return ("power", *self.setup.channels, "ambient", "slower power", "film", "film by n")

    @property
    def as_wired(self) -> Order:
        """Every position read by its own column."""
        return tuple(range(len(self.setup.channels)))

    @property
    def levels(self) -> Array:
        """The channels' level or change since the base, (W, C)."""
        return self.inputs[:, 1 : 1 + len(self.setup.channels)]

    @cached_property
    def rim(self) -> RimMeans:
        """The rim driven by the power, the inner row as wired, and ambient."""
        air = 1 + len(self.setup.channels)
        inner = (1 + i for i in self.setup.places(self.setup.inner))
        feeds = [0, *inner, air, *range(air + 2, self.inputs.shape[1])]
        return RimMeans(self.setup, self.half_width_m, self.rates_1_s, self.inputs[:, feeds], self.banks[feeds])

    @cached_property
    def _fed(self) -> dict[tuple[str, int, float, Perturbation, Place], Array]:
        return {}

    def fed(
        self, column: str, which: int, h_W_m2K: float, p: Perturbation = NOMINAL, place: Place = "outer row"
    ) -> Array:
        """What a column makes of the points of ``place`` as the rim's input ``which``, (W, points); a column that is
        not there makes nothing. Kept, since all hypotheses share it."""
        key = column, which, h_W_m2K, p, place
        if key not in self._fed:
            k, outer, inner = self.columns.index(column), self.setup.outer, self.setup.inner
            if k >= self.inputs.shape[1]:
                return np.zeros((len(self.inputs), len(outer if place == "outer row" else inner)))
            inside = place == "inside"
            g = self.rim.gains(h_W_m2K, p, self.rim.inside if inside else (), bore=place == "inner row")
            direct, gains = (x[which, len(outer) * inside :] for x in (g.direct, g.gains))
            self._fed[key] = np.outer(self.inputs[:, k], direct) + self.banks[k] @ gains.T
        return self._fed[key]

    def _at(self, order: Order, h: float, p: Perturbation, place: Place = "outer row") -> tuple[Array, Array]:
        s, air = self.setup, self.rim.ambient
        inner = (self.fed(s.channels[order[i]], k, h, p, place) for k, i in enumerate(s.places(s.inner), start=1))
        rest = sum(inner, self.fed("ambient", air, h, p, place) + self.fed("film", air + 1, h, p, place))
        return rest, self.fed("power", 0, h, p, place)

    def gradient(self, order: Order, h_W_m2K: float, p: Perturbation = NOMINAL) -> tuple[Array, Array]:
        """Rise of temperature with radius at the inner row without heat and per share of one, (W, k) each [K/m]."""
        rest, power = self._at(order, h_W_m2K, p, "inside")
        read = self.levels[:, [order[i] for i in self.setup.places(self.setup.inner)]]
        return (rest - read) / GRADIENT_STEP_M, power / GRADIENT_STEP_M

    def answer(self, order: Order, h_W_m2K: float, p: Perturbation = NOMINAL) -> tuple[Array, Array]:
        """Model of both rows without heat and per share of one, (W, C) each, when position i of the channels is read
        by column ``order[i]``."""
        rest, power = self._at(order, h_W_m2K, p)
        if np.any(deeper := self.setup.deeper_than_edge_m):
            static = deeper[:, None] * self.rim.gains(h_W_m2K, p).static[self.rim.inner]
            by_rest, by_power = self.gradient(order, h_W_m2K, p)
            rest, power = rest + by_rest @ static, power + by_power @ static
        own = ("film", self.rim.ambient + 1), ("power", 0)
        film, inner = (self.fed(column, k, h_W_m2K, p, "inner row") for column, k in own)
        return np.hstack([rest, film]), np.hstack([power, inner])

    def effects(self, order: Order, h_W_m2K: float, share: float) -> Array:
        """What the data ``seen`` show more about a point by a unit of each of ``effects.stated``, of the harmonic round
        the bore, then by a standard uncertainty of the flux's place and of the film's exponent, a second of common lag,
        a second of later load, and the share, (Q, D)."""
        gradient, static = self.gradient(order, h_W_m2K), self.rim.gains(h_W_m2K).static
        rest, power = self.answer(order, h_W_m2K)
        base, moved = rest + share * power, []
        for p, size in departures(self.setup, FEATURE_DEPTH_M):
            there = self.answer(order, h_W_m2K, p)
            moved.append((there[0] + share * there[1] - base) / size)
        rates = self.slope[:, [order[i] for i in self.setup.places(self.setup.rows)]]
        lasts = (self.event == "steady").astype(float)
        slow = [
            *[lasts] * len(self.setup.inner),
            *(gradient[0] + share * gradient[1]).T,
            *rates.T[len(self.setup.outer) :],
            lasts,
        ]  # the rim follows
        driven = np.array(slow)[:, :, None] * by_inputs(self.setup, static)[:, None]
        known = stated_effects(np.array(moved), driven, lasts, rates, self.drives)
        rows: tuple[Place, ...] = "outer row", "inner row"
        slower = np.hstack([self.fed("slower power", 0, h_W_m2K, place=row) for row in rows])
        same = np.hstack([self.fed("power", 0, h_W_m2K, place=row) for row in rows])
        later = share * (slower - same) / LAG_STEP_S
        loading = later * (self.event == "loading")[:, None]
        film = np.hstack([self.fed("film by n", self.rim.ambient + 2, h_W_m2K, place=row) for row in rows])
        harmonic = sensed(self.setup, h_W_m2K, static[self.rim.inner], self.event, self.after_s)
        if (open_edge := by_edge(self.rim, h_W_m2K)) is not None:
            edge = np.zeros_like(base)
            edge[:, : len(open_edge)] = STAND_IN_K * lasts[:, None] * open_edge
            harmonic = np.concatenate([harmonic, edge[None]])
        beside = np.zeros_like(base)
        if self.shift_u_m:
            one, other = (self.answer(order, h_W_m2K, Perturbation(shift_m=s)) for s in (SHIFT_STEP_M, -SHIFT_STEP_M))
            beside = one[0] - other[0] + share * (one[1] - other[1])
            beside *= self.shift_u_m / (2 * SHIFT_STEP_M)
        return np.concatenate([known, harmonic, [beside, film, later, loading, power]])[:, self.seen]


def disk_features(test: EhlTest, disk: DiskTraces) -> DiskFeatures:
    """Features of one disk; windows that the log does not hold are left out."""
    on, off, end = test.events.load_on_s, test.events.unload_s, test.time_s[-1]
    windows: list[Window] = [("steady", max(off - STEADY_S, on + 0.5 * (off - on)), off - 0.5)]
    windows += [("unloading", off + a, off + b) for a, b in AFTER_UNLOADING_S if off + b <= end + test.dt_s]
    parts = [_stretch(test, disk, windows, windows[0][1] - FORGET_S, (off - BASE_S, off - 0.3))]
    if on - test.time_s[0] >= BASE_S and off - on > 2 * AFTER_LOADING_S[-1][1]:
        loading: list[Window] = [("loading", on + a, on + b) for a, b in AFTER_LOADING_S]
        parts.append(_stretch(test, disk, loading, on - BEFORE_S, (on - BASE_S, on - 0.5)))
        windows += loading
    inputs, banks, slope, noise, bend = (np.concatenate(part) for part in zip(*parts))
    begun, s = {"unloading": off, "loading": on}, disk.setup
    early = [event in begun and stop - begun[event] <= THICK_S for event, _, stop in windows]
    return DiskFeatures(
        disk=disk.name,
        setup=disk.setup,
        half_width_m=test.half_width_m,
        rates_1_s=node_rates(test.dt_s, slowest_per_s=SLOWEST_PER_S),
        event=np.array([event for event, _, _ in windows]),
        after_s=np.array([0.5 * (start + stop) - begun.get(event, off) for event, start, stop in windows]),
        inputs=inputs,
        banks=banks.transpose(1, 0, 2),
        slope=slope,
        noise=noise,
        bend=bend,
        seen=np.repeat(np.column_stack([np.full(len(early), True), early]), [len(s.outer), len(s.inner)], axis=1)
        & ~disk.out[s.places(s.rows)],
        drives=disk.drives,
        shift_u_m=1e-3 * disk.uncertainty.flux_shift_mm,
    )


def _stretch(
    test: EhlTest, disk: DiskTraces, windows: Sequence[Window], start_s: float, base_s: tuple[float, float]
) -> tuple[Array, ...]:
    """Means of the columns (W, C + 3), their banks (W, C + 3, K), slope, noise and bend in one stretch.

    From the mean of a window after an event the straight line through the base is taken, so that a disk that still
    warms up, or an ambient that drifts, is not read as an answer to the event.
    """
    rows = between(test.time_s, start_s, windows[-1][2] + test.dt_s)
    t = test.time_s[rows]
    chain = disk.mean_chain
    chains = chain, chain.with_lag_shift(LAG_STEP_S)
    y = disk.setup.steel.straight(equalised(disk.readings_degC[rows], test.dt_s, disk.chains, chain))
    power, slower = (power_seen(test, rows, c)[0] for c in chains)
    film = film_seen(test, disk, rows, chain)
    feeds = np.stack([power, *y.T, test.ambient_of(disk.name)[rows], slower, *film], axis=1)
    weights, ahead_s = np.zeros((len(windows), len(t))), np.zeros((len(windows), 1))
    rate, slope = np.zeros((2, len(windows), y.shape[1]))
    base = between(t, *base_s)
    for k, (event, start, stop) in enumerate(windows):
        inside = between(t, start, stop)
        first, last = inside.start, max(inside.stop, inside.start + 2) - 1
        weights[k, first : last + 1] = 1.0 / (last + 1 - first)
        if event == "steady":
            continue
        about = t[base] - t[base].mean()
        trend = about / (about**2).sum()
        ahead_s[k] = t[first : last + 1].mean() - t[base].mean()
        weights[k, base] -= 1.0 / len(about) + ahead_s[k] * trend
        rate[k] = trend @ y[base]  # before the event
        slope[k] = (y[last] - y[first]) / (t[last] - t[first]) - rate[k]
    rates = node_rates(test.dt_s, slowest_per_s=SLOWEST_PER_S)
    banks = [weights @ lag_bank(u, test.dt_s, rates) for u in feeds.T]
    noise = np.sqrt((weights**2).sum(axis=1))
    return weights @ feeds, np.stack(banks, axis=1), slope, noise, 0.5 * np.abs(rate) * ahead_s**2 / BEND_S
