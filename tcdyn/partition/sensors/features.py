"""Few numbers that tell junctions apart: the steady level, and the first seconds after loading and unloading."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from calibration import Array
from calibration.disk import CHANNELS, INNER_ROW, DiskSetup
from tcdyn.chain import equalised
from tcdyn.conduction.modal import RimGains
from tcdyn.conduction.rim import Mesh, Rim, lag_bank, node_rates
from tcdyn.partition.effects import Prediction, depths
from tcdyn.partition.prepare import EhlTest
from tcdyn.partition.window import (
    GRADIENT_STEP_M,
    INNER,
    LEVEL,
    NOMINAL,
    OUTER,
    Perturbation,
    RimResponse,
    cached_gains,
    deeper_than_b_m,
    power_bank,
)
from tcdyn.traces import DiskTraces

Order = tuple[int, ...]
T = TypeVar("T")

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
THICK_MESH = Mesh(49, 41)
DEPTH_STEP_M = 0.1e-3
LOG_H_STEP = 0.05


@dataclass(frozen=True)
class Window:
    """Mean over [start, stop) [s], less the straight line of the base before the event; ``event`` it follows."""

    event: str
    start_s: float
    stop_s: float
    base_s: tuple[float, float] | None
    after_s: float = 0.0


@dataclass(frozen=True)
class DiskFeatures:
    """Window means of one disk, W windows: ``rim`` with the inputs power, a..f and ambient, whoever then drives it.

    ``slower``: the power alone when the chain is ``LAG_STEP_S`` slower; ``slope`` (W, 6) mean rate of each channel
    [K/s], less that of the base; ``noise`` (W,) white noise left of one; ``bend`` (W, 6) how far a trend before the
    event may have bent since [K].

    The outer row a, c, e is predicted from the inner row; the inner row d, b, f itself only in the first seconds after
    an event, when the bore does not yet feel it, by a rim that reaches to the bore (``seen``).
    """

    disk: str
    windows: tuple[Window, ...]
    rim: RimResponse
    slower: RimResponse
    slope: Array
    noise: Array
    bend: Array
    memo: dict[Any, Any] = field(default_factory=dict, repr=False, compare=False)  # what was worked out from these

    def on(self, setup: DiskSetup) -> DiskFeatures:
        """The same readings on a disk that is stated otherwise."""
        return replace(self, rim=replace(self.rim, setup=setup), memo={})

    @property
    def levels(self) -> Array:
        """Level, or change since the base, of the channels a..f, (W, 6)."""
        return self.rim.inputs[:, 1:7]

    @cached_property
    def seen(self) -> NDArray[np.bool_]:
        """Which data are predicted, (W, 6) in the order a, c, e, d, b, f."""
        early = [w.event != "steady" and w.after_s <= THICK_S for w in self.windows]
        return np.column_stack([np.ones((len(early), 3), dtype=bool), np.repeat(np.array(early)[:, None], 3, axis=1)])

    def with_column_of(self, other: DiskFeatures, place: int, column: int) -> DiskFeatures:
        """The same disk with position ``place`` of a..f read by ``column`` of another disk."""
        inputs, banks = self.rim.inputs.copy(), self.rim.banks.copy()
        slope, bend = self.slope.copy(), self.bend.copy()
        inputs[:, 1 + place], banks[1 + place] = other.rim.inputs[:, 1 + column], other.rim.banks[1 + column]
        slope[:, place], bend[:, place] = other.slope[:, column], other.bend[:, column]
        return replace(self, rim=replace(self.rim, inputs=inputs, banks=banks), slope=slope, bend=bend, memo={})

    def remember(self, key: Any, work: Callable[[], T]) -> T:
        """What ``work`` gives, worked out once for each ``key`` and these readings."""
        if key not in self.memo:
            self.memo[key] = work()
        return cast(T, self.memo[key])

    def level(self, order: Order) -> Array:
        """Measured a, c, e, d, b, f, (W, 6), when position i of a..f is read by column ``order[i]``."""
        return self.levels[:, [order[i] for i in (*OUTER, *INNER)]]

    def driven(self, order: Order) -> RimResponse:
        """The rim driven by power, the inner row and the ambient."""
        feeds = [0, *(1 + order[i] for i in INNER), 7]
        return replace(self.rim, inputs=self.rim.inputs[:, feeds], banks=self.rim.banks[feeds])

    def thick_gains(
        self, h_W_m2K: float, p: Perturbation = NOMINAL, inner_m: tuple[float, float, float] = LEVEL
    ) -> RimGains:
        """Gains to d, b and f, deeper by ``inner_m``, of a rim that reaches to the bore."""
        r, s = self.rim, self.rim.setup
        rim = p.of_rim(Rim.from_setup(s, inner_radius_m=s.bore_radius_m))
        points = tuple((s.junctions[c].depth_m + dx, s.junctions[c].z_m) for c, dx in zip(INNER_ROW, inner_m))
        width = r.half_width_m * (1 + p.half_width)
        return cached_gains(rim, h_W_m2K, points, width, tuple(r.rates_1_s), r.profile, THICK_MESH)

    def answer(
        self,
        order: Order,
        h_W_m2K: float,
        p: Perturbation = NOMINAL,
        inner_m: tuple[float, float, float] = LEVEL,
    ) -> tuple[Array, Array]:
        """Model of a, c, e, d, b, f without heat and per share of one, (W, 6) each; inner row moved by ``inner_m``."""
        driven, deeper = self.driven(order), deeper_than_b_m(self.rim.setup)
        outer = driven.answer(h_W_m2K, p)
        if np.any(deeper):
            per_rise = (deeper / GRADIENT_STEP_M)[:, None] * driven.gains(h_W_m2K, p).static[1:4]
            outer = tuple(x + rise @ per_rise for x, rise in zip(outer, driven.rise(h_W_m2K, p)))  # type: ignore[assignment]
        inner = driven.heat(self.thick_gains(h_W_m2K, p, inner_m))
        return np.hstack([outer[0], np.zeros_like(inner)]), np.hstack([outer[1], inner])

    def later(self, h_W_m2K: float) -> Array:
        """Change of the power's answer per second of more common lag, (W, 6)."""
        gains = self.rim.gains(h_W_m2K), self.thick_gains(h_W_m2K)
        return np.hstack([(self.slower.heat(g) - self.rim.heat(g)) / LAG_STEP_S for g in gains])

    def of(self, event: str) -> NDArray[np.bool_]:
        """Which windows follow ``event``: "steady", "loading" or "unloading"."""
        return np.array([w.event == event for w in self.windows])


@dataclass(frozen=True)
class FeaturePrediction(Prediction):
    """The features a, c, e, d, b, f of one disk about a share and an h, (W, 6), when ``order`` says who reads what."""

    f: DiskFeatures
    order: Order

    @property
    def lasts(self) -> Array:
        """See ``Prediction``: one for the steady window, zero for the transients, (W,)."""
        return self.f.of("steady").astype(float)

    def answer(self, p: Perturbation) -> tuple[Array, Array]:
        """See ``Prediction``."""
        return self.f.answer(self.order, self.h_W_m2K, p)

    def through(self, i: int, error: Array | float) -> Array:
        """See ``Prediction``; slow errors, which the rim follows."""
        return np.asarray(error)[:, None] * self.lasting[i]

    def rate(self, channel: str) -> Array:
        """See ``Prediction``, (W,)."""
        return self.f.slope[:, self.order[CHANNELS.index(channel)]]

    @cached_property
    def gradient(self) -> Array:
        """See ``Prediction``, (W, 3)."""
        rest, power = self.f.driven(self.order).rise(self.h_W_m2K)
        return np.asarray((rest + self.share * power) / GRADIENT_STEP_M)

    def reading(self, name: str, error: Array | float) -> Array:
        """See ``Prediction``; an error of the inner row is seen at its own place as well."""
        out = super().reading(name, error)
        if name in INNER_ROW:
            out[:, 3 + INNER_ROW.index(name)] = error
        return out

    def deeper(self, channel: str) -> Array:
        """See ``Prediction``; the inner row is predicted as well."""
        out = super().deeper(channel)
        if channel in INNER_ROW:
            moves = depths(INNER_ROW, channel, self.depth_step_m)
            power = self.f.answer(self.order, self.h_W_m2K, inner_m=moves)[1]
            out[:, 3:] = (self.share * power - self.base)[:, 3:] / self.depth_step_m
        return out

    def of_log_h(self) -> Array:
        """What is shown more if ln h is larger by one."""
        rest, power = self.f.answer(self.order, self.h_W_m2K * float(np.exp(LOG_H_STEP)))
        return np.asarray((rest + self.share * power - self.base) / LOG_H_STEP)

    def later(self) -> Array:
        """What is shown more if the frictional heat is seen one second later."""
        return self.share * self.f.later(self.h_W_m2K)


def predicted(f: DiskFeatures, order: Order, h_W_m2K: float, share: float) -> FeaturePrediction:
    """The features about a share and an h [W/m2K]."""
    lasting = f.driven(order).gains(h_W_m2K).static
    return FeaturePrediction(share, h_W_m2K, *f.answer(order, h_W_m2K), lasting, DEPTH_STEP_M, f, order)


def disk_features(test: EhlTest, disk: DiskTraces) -> DiskFeatures:
    """Features of one disk; windows that the log does not hold are left out."""
    on, off, end = test.events.load_on_s, test.events.unload_s, test.time_s[-1]
    steady = (Window("steady", max(off - STEADY_S, on + 0.5 * (off - on)), off - 0.5, None),)
    base = (off - BASE_S, off - 0.3)
    cooling = tuple(
        Window("unloading", off + a, off + b, base, b) for a, b in AFTER_UNLOADING_S if off + b <= end + test.dt_s
    )
    parts = [_stretch(test, disk, (*steady, *cooling), steady[0].start_s - FORGET_S)]
    if on - test.time_s[0] >= BASE_S and off - on > 2 * AFTER_LOADING_S[-1][1]:
        early = (on - BASE_S, on - 0.5)
        loading = tuple(Window("loading", on + a, on + b, early, b) for a, b in AFTER_LOADING_S)
        parts.append(_stretch(test, disk, loading, on - BEFORE_S))
    x, banks, slope, noise, bend = (np.concatenate([p[k] for p in parts]) for k in range(5))
    windows = (*steady, *cooling) if len(parts) == 1 else (*steady, *cooling, *loading)
    rates = node_rates(test.dt_s, slowest_per_s=SLOWEST_PER_S)
    by_input = banks.transpose(1, 0, 2)
    rim = RimResponse(disk.setup, test.half_width_m, rates, x[:, :-1], by_input[:-1])
    slower = replace(rim, inputs=x[:, -1:], banks=by_input[-1:])
    return DiskFeatures(disk.name, windows, rim, slower, slope, noise, bend)


def _stretch(test: EhlTest, disk: DiskTraces, windows: tuple[Window, ...], start_s: float) -> tuple[Array, ...]:
    """Means of power, a..f, ambient and slower power (W, 9), their banks, slope, noise and bend in one stretch."""
    rows = test.rows(start_s, windows[-1].stop_s + test.dt_s)
    t = test.time_s[rows]
    chain = disk.mean_chain
    y = equalised(disk.readings_degC[rows], test.dt_s, disk.chains, chain)
    rates = node_rates(test.dt_s, slowest_per_s=SLOWEST_PER_S)
    power, slower = (power_bank(test, rows, rates, c) for c in (chain, chain.with_lag_shift(LAG_STEP_S)))
    others = [*y.T, test.ambient_degC[rows]]
    feeds = [power[0], *others, slower[0]]
    banks = [power[1], *(lag_bank(u, test.dt_s, rates) for u in others), slower[1]]
    x, b, slope, noise, bend = [], [], [], [], []
    for w in windows:
        weights, ahead_s, trend = _weights(t, w)
        x.append([float(weights @ u) for u in feeds])
        b.append(np.stack([weights @ bank for bank in banks]))
        rate = trend @ y  # before the event
        inside = _rows(t, w.start_s, w.stop_s)
        first, last = inside.start, inside.stop - 1
        slope.append((y[last] - y[first]) / (t[last] - t[first]) - rate if w.base_s else np.zeros(len(CHANNELS)))
        noise.append(np.sqrt((weights**2).sum()))
        bend.append(0.5 * np.abs(rate) * ahead_s**2 / BEND_S)
    return np.array(x), np.stack(b), np.array(slope), np.array(noise), np.array(bend)


def _rows(t: Array, start_s: float, stop_s: float) -> slice:
    first, last = (int(k) for k in np.searchsorted(t, [start_s, stop_s]))
    return slice(first, max(last, first + 2))


def _weights(t: Array, w: Window) -> tuple[Array, float, Array]:
    """Weights (N,) of the samples in a window's number, its distance from the base [s], and weights of the base's rate.

    From the mean of the window the straight line through the base is taken, so that a disk that still warms up, or an
    ambient that drifts, is not read as an answer to the event.
    """
    inside, trend = _rows(t, w.start_s, w.stop_s), np.zeros_like(t)
    weights = np.zeros_like(t)
    weights[inside] = 1.0 / (inside.stop - inside.start)
    if w.base_s is None:
        return weights, 0.0, trend
    base = _rows(t, *w.base_s)
    about = t[base] - t[base].mean()
    trend[base] = about / (about**2).sum()
    ahead_s = float(t[inside].mean() - t[base].mean())
    weights[base] -= 1.0 / (base.stop - base.start)
    return weights - ahead_s * trend, ahead_s, trend
