"""Few numbers of a disk that tell its junctions apart, of the steady level and after each event, what the rim makes of
them whatever column reads which place, and what unmeasured things do to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tcdyn.chain import equalised
from tcdyn.core import Array
from tcdyn.heat.rim import lag_bank, node_rates
from tcdyn.partition.angular_harmonic import window_harmonic_effects
from tcdyn.partition.events import EhlTest
from tcdyn.partition.nuisance import nominal_effects, nominal_perturbations, steady_input_response
from tcdyn.partition.track import SHIFT_STEP_M, unresolved_edge_effect
from tcdyn.partition.window import (
    GRADIENT_STEP_M,
    NOMINAL,
    Perturbation,
    RimMeans,
    between,
    lagged_power,
    lagged_surface_air,
)
from tcdyn.rig.disk import DiskSetup
from tcdyn.smoothing.traces import STAND_IN_K, DiskTraces

Order = tuple[int, ...]
Case = tuple[float, Perturbation]  # h [W/m2K], and how the disk departs from its statement
Target = Literal[
    "outer row", "inside", "inner row"
]  # just inside the inner row; this row, of a rim to the bore
Window = tuple[str, float, float]  # event that it follows, start, stop [s]
STEADY_S = 100.0
BASE_S = 8.0
BEFORE_S = 12.0
FORGET_S = 20.0
AFTER_UNLOADING_S = ((0.3, 1.0), (1.0, 2.0), (2.0, 4.0), (4.0, 8.0))
AFTER_LOADING_S = ((1.0, 2.5), (2.5, 5.0), (5.0, 10.0))
LAG_STEP_S = 0.05
SLOWEST_PER_S = 0.02
WARMUP_TIME_CONSTANT_S = 40.0  # a disk under load warms up with about this time constant
BORE_DELAY_S = 5.0  # heat needs some ten seconds to the bore and back
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
    trend_u_K: Array
    observed: NDArray[np.bool_]
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
        return RimMeans(
            self.setup, self.half_width_m, self.rates_1_s, self.inputs[:, feeds], self.banks[feeds]
        )

    @cached_property
    def _kept(self) -> dict[Any, Any]:
        return {}

    @cached_property
    def _rows(self) -> tuple[list[int], list[int]]:
        return self.setup.places(self.setup.outer), self.setup.places(self.setup.inner)

    @cached_property
    def _departures(self) -> tuple[tuple[Perturbation, ...], Array]:
        departing, sizes = zip(*nominal_perturbations(self.setup, FEATURE_DEPTH_M))
        return departing, np.array(sizes)

    def target_responses(self, cases: tuple[Case, ...], place: Target = "outer row") -> Array:
        """What every column makes of the points of ``place`` as every input of the rim, (cases, C + 3, I, W, points).

        Kept, since all hypotheses share it."""
        if (cases, place) not in self._kept:
            inside = place == "inside"
            extra = self.rim.points_inside if inside else ()
            bore = place == "inner row"
            every = [self.rim.gains(h, p, extra, bore) for h, p in cases]
            own = slice(len(self.setup.outer) * inside, None)
            direct, gains = (
                np.stack([x[:, own] for x in part])
                for part in zip(*((g.direct, g.gains) for g in every))
            )
            lagged = (
                np.tensordot(gains, self.banks, (3, 2)) + direct[..., None, None] * self.inputs.T
            )
            self._kept[cases, place] = np.ascontiguousarray(lagged.transpose(0, 3, 1, 4, 2))
        return np.asarray(self._kept[cases, place])

    def column_response(
        self, column: str, which: int, cases: tuple[Case, ...], place: Target = "outer row"
    ) -> Array:
        """What a column makes of the points of ``place`` as the rim's input ``which``, (cases, W, points); a column
        that is not there makes nothing."""
        k = self.columns.index(column)
        made = self.target_responses(cases, place)
        return made[:, k, which] if k < made.shape[1] else np.zeros_like(made[:, 0, 0])

    def _at(
        self, order: Order, cases: tuple[Case, ...], place: Target = "outer row"
    ) -> tuple[Array, Array]:
        air = self.rim.ambient_index
        made = self.target_responses(cases, place)
        columns = [1 + order[i] for i in self._rows[1]]
        rest = made[:, columns, range(1, air)].sum(axis=1)
        rest += self.column_response("ambient", air, cases, place) + self.column_response(
            "film", air + 1, cases, place
        )
        return rest, made[:, 0, 0]

    def gradient(self, order: Order, cases: tuple[Case, ...]) -> tuple[Array, Array]:
        """Rise of temperature with radius at the inner row without heat and per share of one, (cases, W, k) each
        [K/m]."""
        rest, power = self._at(order, cases, "inside")
        read = self.levels[:, [order[i] for i in self._rows[1]]]
        return (rest - read) / GRADIENT_STEP_M, power / GRADIENT_STEP_M

    def response(self, order: Order, cases: tuple[Case, ...]) -> tuple[Array, Array]:
        """Model of both rows without heat and per share of one, (cases, W, C) each, when position i of the channels is
        read by column ``order[i]``; each case is an h [W/m2K] and a departure of the disk."""
        rest, power = self._at(order, cases)
        if np.any(deeper := self.setup.deeper_than_edge_m):
            static = deeper[:, None] * [
                self.rim.gains(h, p).static[self.rim.inner_inputs] for h, p in cases
            ]
            by_rest, by_power = self.gradient(order, cases)
            rest = rest + by_rest @ static
            power = power + by_power @ static
        own = ("film", self.rim.ambient_index + 1), ("power", 0)
        film, inner = (self.column_response(column, k, cases, "inner row") for column, k in own)
        return np.concatenate([rest, film], axis=2), np.concatenate([power, inner], axis=2)

    def effects(self, order: Order, h_W_m2K: float, share: float) -> Array:
        """What the data ``seen`` show more about a point by a unit of each of ``effects.stated``, of the harmonic round
        the bore, then by a standard uncertainty of the flux's place and of the film's exponent, a second of common lag,
        a second of later load, and the share, (Q, D)."""
        if (order, h_W_m2K) not in self._kept:
            self._kept[order, h_W_m2K] = self._without_heat_and_by_share(order, h_W_m2K)
        still, by_share = self._kept[order, h_W_m2K]
        return np.asarray(still + share * by_share)

    def _without_heat_and_by_share(self, order: Order, h_W_m2K: float) -> tuple[Array, Array]:
        """``effects`` for a share of none, and what they grow by a share of one: they are linear in it."""
        departing, sizes = self._departures
        driven_to, harmonic, late, film = self._whatever_order(h_W_m2K)
        shown = self.response(order, tuple((h_W_m2K, p) for p in (NOMINAL, *departing)))
        gradient = self.gradient(order, ((h_W_m2K, NOMINAL),))
        shifted = np.zeros((2, 2, *late.shape))
        if self.shift_u_m:
            cases = tuple((h_W_m2K, Perturbation(shift_m=s)) for s in (SHIFT_STEP_M, -SHIFT_STEP_M))
            shifted = np.array(self.response(order, cases)) * self.shift_u_m / (2 * SHIFT_STEP_M)
        lasting = (self.event == "steady").astype(float)
        loading = (self.event == "loading")[:, None]
        rising = self.slope[:, [order[i] for row in self._rows for i in row]]
        heat = shown[1][0]
        nothing = 0.0 * late
        found = []
        for x, along_r, (one, other), of_share in zip(shown, gradient, shifted, (False, True)):
            lasts, rates = (nothing[:, 0], nothing) if of_share else (lasting, rising)
            slow = [
                *[lasts] * len(self.setup.inner),
                *along_r[0].T,
                *rates.T[len(self.setup.outer) :],
                lasts,
            ]
            driven = np.array(slow)[:, :, None] * driven_to[:, None]  # the rim follows
            known = nominal_effects(
                (x[1:] - x[0]) / sizes[:, None, None], driven, lasts, rates, self.drives
            )
            more = (
                [nothing, late, late * loading, nothing]
                if of_share
                else [film, nothing, nothing, heat]
            )
            beside = one - other, *more
            found.append(
                np.concatenate([known, harmonic * (not of_share), beside])[:, self.observed]
            )
        return found[0], found[1]

    def _whatever_order(self, h_W_m2K: float) -> tuple[Array, Array, Array, Array]:
        """Of an h, whichever column reads which place: steady answers by what drives the rim, effects of the harmonic
        round the bore, of a second of common lag for a share of one, and of the film's exponent."""
        if h_W_m2K not in self._kept:
            case: tuple[Case, ...] = ((h_W_m2K, NOMINAL),)
            static = self.rim.gains(h_W_m2K).static
            rows: tuple[Target, ...] = "outer row", "inner row"
            slower, same, film = (
                np.hstack([self.column_response(column, which, case, row)[0] for row in rows])
                for column, which in (
                    ("slower power", 0),
                    ("power", 0),
                    ("film by n", self.rim.ambient_index + 2),
                )
            )
            harmonic = window_harmonic_effects(
                self.setup, h_W_m2K, static[self.rim.inner_inputs], self.event, self.after_s
            )
            if (open_edge := unresolved_edge_effect(self.rim, h_W_m2K)) is not None:
                edge = np.zeros_like(same)
                edge[:, : len(open_edge)] = (
                    STAND_IN_K * (self.event == "steady")[:, None] * open_edge
                )
                harmonic = np.concatenate([harmonic, edge[None]])
            late = (slower - same) / LAG_STEP_S
            self._kept[h_W_m2K] = steady_input_response(self.setup, static), harmonic, late, film
        of: tuple[Array, Array, Array, Array] = self._kept[h_W_m2K]
        return of


def disk_features(test: EhlTest, disk: DiskTraces) -> DiskFeatures:
    """Features of one disk; windows that the log does not hold are left out."""
    on = test.events.load_on_s
    off = test.events.unload_s
    end = test.time_s[-1]
    windows: list[Window] = [("steady", max(off - STEADY_S, on + 0.5 * (off - on)), off - 0.5)]
    windows += [
        ("unloading", off + a, off + b) for a, b in AFTER_UNLOADING_S if off + b <= end + test.dt_s
    ]
    parts = [_stretch(test, disk, windows, windows[0][1] - FORGET_S, (off - BASE_S, off - 0.3))]
    if on - test.time_s[0] >= BASE_S and off - on > 2 * AFTER_LOADING_S[-1][1]:
        loading: list[Window] = [("loading", on + a, on + b) for a, b in AFTER_LOADING_S]
        parts.append(_stretch(test, disk, loading, on - BEFORE_S, (on - BASE_S, on - 0.5)))
        windows += loading
    inputs, banks, slope, noise, bend = (np.concatenate(part) for part in zip(*parts))
    begun = {"unloading": off, "loading": on}
    s = disk.setup
    early = [event in begun and stop - begun[event] <= BORE_DELAY_S for event, _, stop in windows]
    return DiskFeatures(
        disk=disk.name,
        setup=disk.setup,
        half_width_m=test.half_width_m,
        rates_1_s=node_rates(test.dt_s, slowest_per_s=SLOWEST_PER_S),
        event=np.array([event for event, _, _ in windows]),
        after_s=np.array(
            [0.5 * (start + stop) - begun.get(event, off) for event, start, stop in windows]
        ),
        inputs=inputs,
        banks=banks.transpose(1, 0, 2),
        slope=slope,
        noise=noise,
        trend_u_K=bend,
        observed=np.repeat(
            np.column_stack([np.full(len(early), True), early]),
            [len(s.outer), len(s.inner)],
            axis=1,
        )
        & ~disk.out[s.places(s.rows)],
        drives=disk.drives,
        shift_u_m=1e-3 * disk.uncertainty.flux_shift_mm,
    )


def _stretch(
    test: EhlTest,
    disk: DiskTraces,
    windows: Sequence[Window],
    start_s: float,
    base_s: tuple[float, float],
) -> tuple[Array, ...]:
    """Means of the columns (W, C + 3), their banks (W, C + 3, K), slope, noise and bend in one stretch.

    From the mean of a window after an event the straight line through the base is taken, so that a disk that still
    warms up, or an ambient that drifts, is not read as an answer to the event.
    """
    rows = between(test.time_s, start_s, windows[-1][2] + test.dt_s)
    t = test.time_s[rows]
    chain = disk.mean_chain
    chains = chain, chain.with_lag_shift(LAG_STEP_S)
    y = disk.setup.steel.straight(
        equalised(disk.readings_degC[rows], test.dt_s, disk.chains, chain)
    )
    power, slower = (lagged_power(test, rows, c)[0] for c in chains)
    film = lagged_surface_air(test, disk, rows, chain)
    feeds = np.stack([power, *y.T, test.ambient_of(disk.name)[rows], slower, *film], axis=1)
    weights = np.zeros((len(windows), len(t)))
    ahead_s = np.zeros((len(windows), 1))
    rate, slope = np.zeros((2, len(windows), y.shape[1]))
    base = between(t, *base_s)
    for k, (event, start, stop) in enumerate(windows):
        inside = between(t, start, stop)
        first = inside.start
        last = max(inside.stop, inside.start + 2) - 1
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
    return (
        weights @ feeds,
        np.stack(banks, axis=1),
        slope,
        noise,
        0.5 * np.abs(rate) * ahead_s**2 / WARMUP_TIME_CONSTANT_S,
    )
