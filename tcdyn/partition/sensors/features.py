"""Few numbers that tell junctions apart: the steady level, and the first seconds after loading and unloading."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from calibration.disk import CHANNELS, INNER_ROW, DiskSetup
from tcdyn.chain import equalised
from tcdyn.conduction.bank import lag_bank, node_rates
from tcdyn.conduction.modal import RimGains, rim_gains
from tcdyn.conduction.rim import Mesh, Rim
from tcdyn.partition.prepare import EhlTest
from tcdyn.partition.window import (
    GRADIENT_STEP_M,
    INNER,
    NOMINAL,
    OUTER,
    Perturbation,
    above_inner_row,
    chained_power,
    deeper_than_b_m,
    perturbed_gains,
)
from tcdyn.traces import DiskTraces

Array = NDArray[np.float64]
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
NO_SHIFT = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Window:
    """Mean over [start, stop) [s], less the straight line of the base before the event; ``event`` it follows."""

    event: str
    start_s: float
    stop_s: float
    base_s: tuple[float, float] | None
    after_s: float = 0.0


@dataclass(frozen=True)
class Gains:
    """Gains of the rim, inner row to outer row, and of the thick rim, frictional heat to inner row.

    ``above``: of the rim to the points just above the inner row, where d or f lies at another depth than b.
    """

    rim: RimGains
    thick: RimGains
    above: RimGains | None


@dataclass(frozen=True)
class DiskFeatures:
    """Window means of one disk: W windows, inputs in the order power, a..f, ambient.

    ``x`` (W, 8) inputs and ``banks`` (W, 8, K) their lags; ``late`` (W, K + 1) power and its lags when the chain is
    ``LAG_STEP_S`` slower; ``slope`` (W, 6) mean rate of each channel [K/s], less that of the base; ``noise`` (W,) white
    noise left of one; ``bend`` (W, 6) how far a trend before the event may have bent since [K].

    The outer row a, c, e is predicted from the inner row; the inner row d, b, f itself only in the first seconds after
    an event, when the bore does not yet feel it, by a rim that reaches to the bore (``seen``).
    """

    disk: str
    setup: DiskSetup
    half_width_m: float
    windows: tuple[Window, ...]
    rates_1_s: Array
    x: Array
    banks: Array
    late: Array
    slope: Array
    noise: Array
    bend: Array
    book: dict[Any, Any] = field(default_factory=dict, repr=False, compare=False)  # gains once worked out
    memo: dict[Any, Any] = field(default_factory=dict, repr=False, compare=False)  # what the readings made of them

    def on(self, setup: DiskSetup) -> DiskFeatures:
        """The same readings on a disk that is stated otherwise."""
        return replace(self, setup=setup, book={}, memo={})

    @cached_property
    def seen(self) -> NDArray[np.bool_]:
        """Which data are predicted, (W, 6) in the order a, c, e, d, b, f."""
        early = [w.event != "steady" and w.after_s <= THICK_S for w in self.windows]
        return np.column_stack([np.ones((len(early), 3), dtype=bool), np.repeat(np.array(early)[:, None], 3, axis=1)])

    def gains(self, h_W_m2K: float, p: Perturbation = NOMINAL, inner_m: tuple[float, float, float] = NO_SHIFT) -> Gains:
        """Gains of a disk that departs from its statement by ``p``, inner row moved by ``inner_m`` (d, b, f)."""
        inner = replace(p, depth_m=NO_SHIFT)
        return Gains(
            self._once((h_W_m2K, p), lambda: self.rim_gains(h_W_m2K, p)),
            self._once((h_W_m2K, inner, inner_m), lambda: self._thick_gains(h_W_m2K, p, inner_m)),
            self.above(h_W_m2K, inner) if np.any(deeper_than_b_m(self.setup)) else None,
        )

    def above(self, h_W_m2K: float, p: Perturbation) -> RimGains:
        """Gains of the rim to the outer row and to the points ``GRADIENT_STEP_M`` above d, b and f."""
        extra = above_inner_row(self.setup)
        return self._once((h_W_m2K, p, "above"), lambda: self.rim_gains(h_W_m2K, p, extra))

    def rise(self, g: RimGains, order: tuple[int, ...]) -> tuple[Array, Array]:
        """Rise from d, b and f to the points above them, without heat and per share of one; (W, 3) each [K]."""
        rest, power = self.outer(g, order)
        return rest[:, 3:] - self.x[:, [1 + order[i] for i in INNER]], power[:, 3:]

    def with_column_of(self, other: DiskFeatures, place: int, column: int) -> DiskFeatures:
        """The same disk with position ``place`` of a..f read by ``column`` of another disk."""
        x, banks, slope, bend = self.x.copy(), self.banks.copy(), self.slope.copy(), self.bend.copy()
        x[:, 1 + place], banks[:, 1 + place] = other.x[:, 1 + column], other.banks[:, 1 + column]
        slope[:, place], bend[:, place] = other.slope[:, column], other.bend[:, column]
        return replace(self, x=x, banks=banks, slope=slope, bend=bend, memo={})

    def _once(self, key: Any, work: Callable[[], RimGains]) -> RimGains:
        if key not in self.book:
            self.book[key] = work()
        return self.book[key]

    def remember(self, key: Any, work: Callable[[], T]) -> T:
        """What ``work`` gives, worked out once for each ``key`` and these readings."""
        if key not in self.memo:
            self.memo[key] = work()
        return cast(T, self.memo[key])

    def rim_gains(self, h: float, p: Perturbation = NOMINAL, extra: tuple[tuple[float, float], ...] = ()) -> RimGains:
        """Gains of the rim at ``h`` [W/m2K] to the outer row and any ``extra`` points."""
        return perturbed_gains(self.setup, h, self.half_width_m, self.rates_1_s, p, "modal", extra)

    def _thick_gains(self, h: float, p: Perturbation, inner_m: tuple[float, float, float]) -> RimGains:
        s = self.setup
        rim = Rim.from_setup(s, inner_radius_m=s.bore_radius_m)
        rim = replace(
            rim,
            conductivity_W_mK=rim.conductivity_W_mK * (1 + p.conductivity),
            specific_heat_J_kgK=rim.specific_heat_J_kgK * (1 + p.heat_capacity),
            washer_W_m2K=rim.washer_W_m2K * (1 + p.washer),
        )
        points = [(s.junctions[c].depth_m + dx, s.junctions[c].z_m) for c, dx in zip(INNER_ROW, inner_m)]
        width = self.half_width_m * (1 + p.half_width)
        return rim_gains(rim, h, points, width, self.rates_1_s, profile="modal", mesh=THICK_MESH)

    def level(self, order: tuple[int, ...]) -> Array:
        """Measured a, c, e, d, b, f, (W, 6), when position i of a..f is read by column ``order[i]``."""
        return self.x[:, [1 + order[i] for i in (*OUTER, *INNER)]]

    def answer(self, g: Gains, order: tuple[int, ...]) -> tuple[Array, Array]:
        """Model of a, c, e, d, b, f without heat and per share of one, (W, 6) each."""
        rest, power = self.outer(g.rim, order)
        if g.above is not None:
            lasting = g.rim.direct[1:4] + g.rim.gains[1:4].sum(axis=2)
            per_rise = (deeper_than_b_m(self.setup) / GRADIENT_STEP_M)[:, None] * lasting
            rest, power = (x + rise @ per_rise for x, rise in zip((rest, power), self.rise(g.above, order)))
        inner = self.x[:, :1] * g.thick.direct[0] + self.banks[:, 0] @ g.thick.gains[0].T
        return np.hstack([rest, np.zeros_like(inner)]), np.hstack([power, inner])

    def outer(self, g: RimGains, order: tuple[int, ...]) -> tuple[Array, Array]:
        """Model of the outer row, and of extra points, driven by the inner row; (W, P) each."""
        feeds = [1 + order[i] for i in INNER] + [7]
        rest = sum(self.x[:, [k]] * g.direct[1 + i] + self.banks[:, k] @ g.gains[1 + i].T for i, k in enumerate(feeds))
        power = self.x[:, :1] * g.direct[0] + self.banks[:, 0] @ g.gains[0].T
        return np.asarray(rest), np.asarray(power)

    def later(self, g: Gains) -> Array:
        """Change of the power's answer per second of more common lag, (W, 6)."""
        direct = np.concatenate([g.rim.direct[0], g.thick.direct[0]])
        gains = np.concatenate([g.rim.gains[0], g.thick.gains[0]])
        slow = self.late[:, :1] * direct + self.late[:, 1:] @ gains.T
        now = self.x[:, :1] * direct + self.banks[:, 0] @ gains.T
        return np.asarray((slow - now) / LAG_STEP_S)

    def of(self, event: str) -> NDArray[np.bool_]:
        """Which windows follow ``event``: "steady", "loading" or "unloading"."""
        return np.array([w.event == event for w in self.windows])


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
    x, banks, late, slope, noise, bend = (np.concatenate([p[k] for p in parts]) for k in range(6))
    windows = (*steady, *cooling) if len(parts) == 1 else (*steady, *cooling, *loading)
    rates = node_rates(test.dt_s, slowest_per_s=SLOWEST_PER_S)
    return DiskFeatures(disk.name, disk.setup, test.half_width_m, windows, rates, x, banks, late, slope, noise, bend)


def _stretch(test: EhlTest, disk: DiskTraces, windows: tuple[Window, ...], start_s: float) -> tuple[Array, ...]:
    """x, banks, late, slope, noise and bend of windows that one stretch of the test holds."""
    rows = test.rows(start_s, windows[-1].stop_s + test.dt_s)
    t = test.time_s[rows]
    chain = disk.mean_chain
    y = equalised(disk.readings_degC[rows], test.dt_s, disk.chains, chain)
    power = chained_power(test, rows, chain)
    slower = chained_power(test, rows, chain.with_lag_shift(LAG_STEP_S))
    rates = node_rates(test.dt_s, slowest_per_s=SLOWEST_PER_S)
    feeds = [power, *y.T, test.ambient_degC[rows], slower]
    banks = [lag_bank(u, test.dt_s, rates) for u in feeds]
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
    inputs, lags = np.array(x), np.stack(b)
    late = np.column_stack([inputs[:, -1], lags[:, -1]])
    return inputs[:, :-1], lags[:, :-1], late, np.array(slope), np.array(noise), np.array(bend)


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
