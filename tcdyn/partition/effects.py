"""What nobody measured in a test: how well it is known, and what it does to the readings that the rim predicts: in the
blocks of the fits, and in few numbers that tell junctions apart, of the steady level and after each event."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage, signal

from calibration import Array
from calibration.disk import CHANNELS, OUTER_ROW, DiskSetup
from tcdyn.chain import discretised, equalised
from tcdyn.conduction.rim import lag_bank, node_rates
from tcdyn.partition.events import EhlTest
from tcdyn.partition.statement import statement_effects
from tcdyn.partition.uneven import Unmeasured, round_effects, sensed
from tcdyn.partition.window import (
    FILM,
    FILM_BY_N,
    INNER,
    NOMINAL,
    OUTER,
    POWER,
    ROWS,
    DiskWindow,
    Perturbation,
    RimMeans,
    between,
    film_seen,
    inner_gradient,
    known_round,
    power_seen,
    sampled,
)  # fmt: skip
from tcdyn.traces import DiskTraces

MATERIAL_STEP = 0.01
MATERIALS = [Perturbation(*(MATERIAL_STEP * row)) for row in np.eye(4)]  # steel, washer, half-width
DEPTH_STEP_M = 0.05e-3
SMOOTH_RATE_S = 0.5
SPLIT_SD_S = 0.03  # a plunge hardly tells how a channel's lag is split in two
MODEL_K = 0.03  # what rim and mesh leave unexplained at a junction, against whole-disk solutions
Order = tuple[int, ...]
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
COLUMNS = ("power", *CHANNELS, "ambient", "slower power", "film", "film by n")
LEVELS = slice(1, 7)  # of the columns: a..f, their level or change since the base


STATED = (
    *(Unmeasured(f"static {c}", "static lines") for c in ROWS),
    *(Unmeasured(f"depth {c}", "junction depth") for c in ROWS),
    *(Unmeasured(f"lag {c}", "chain") for c in ROWS),
    *(Unmeasured(name, name, True) for name in ("conductivity", "heat capacity", "washer", "half-width", "ambient")),
)
OWN = (
    Unmeasured("parting", "parting", True),
    Unmeasured("friction", "friction", True),
    *(Unmeasured(f"split {c}", "chain") for c in OUTER_ROW),
    Unmeasured("film exponent", "film exponent", True),
)


@dataclass(frozen=True)
class Effects:
    """``change`` (Q, R, P): what the readings show more than predicted by one standard uncertainty of each [K]."""

    of: tuple[Unmeasured, ...]
    change: Array


def stated_u(disk: DiskTraces, static_u_K: Array, other_lags_s: Array | float = 0.0) -> Array:
    """Standard uncertainty of everything in ``STATED``, (Q,): static lines (6,) of a..f as given; lags by how well the
    record tells each from the mean of all, and by ``other_lags_s`` where they may be another channel's."""
    u, order = disk.uncertainty, [*OUTER, *INNER]
    centre = np.eye(len(CHANNELS)) - 1.0 / len(CHANNELS)
    apart = np.clip(np.diag(centre @ disk.lag_covariance_s2 @ centre.T), 0.0, None)
    lag_u_s = np.hypot(np.sqrt(apart), other_lags_s)
    steel = [u.conductivity_rel, u.heat_capacity_rel, u.washer_rel, u.half_width_rel, u.ambient_K]
    return np.concatenate([static_u_K[order], disk.depth_u_m[order], lag_u_s[order], steel])


def departures(depth_step_m: float) -> list[tuple[Perturbation, float]]:
    """What ``stated_effects`` asks the answer to, each with its size: every junction deeper, steel, washer, width."""
    deeper = [(Perturbation(deeper_m=tuple(row)), depth_step_m) for row in depth_step_m * np.eye(len(ROWS))]
    return deeper + [(p, MATERIAL_STEP) for p in MATERIALS]


def stated_effects(moved: Array, driven: Array, lasts: Array, rates_K_s: Array, drives: Array) -> Array:
    """What R means of a, c, e (or a, c, e, d, b, f) show more by a unit of everything in ``STATED``, (Q, R, P).

    ``moved`` (10, R, P): what they show more by a unit of each of the ``departures``; ``driven`` (10, R, 3): what the
    outer row answers to an input that is higher by a lasting kelvin, by its rise of temperature with radius, and by its
    rate, each for d, b, f, and to a kelvin of ambient; ``lasts`` (R,): how much of a lasting error the means show;
    ``rates_K_s`` (R, P): how fast each rises; ``drives`` (3, 3): which inputs d, b, f each errs with. A junction of the
    inner row that reads too high drives the prediction up, one that lies deeper reads too low for its inner radius.
    """
    place = np.eye(len(ROWS))[:, None, : moved.shape[2]]
    static, lag, depth = place * lasts[:, None], -place * rates_K_s, moved[: len(ROWS)].copy()
    static[3:, :, :3] -= np.tensordot(drives, driven[:3], 1)
    depth[3:, :, :3] += np.tensordot(drives, driven[3:6], 1)
    lag[3:, :, :3] += np.tensordot(drives, driven[6:9], 1)
    ambient = np.zeros_like(moved[:1])
    ambient[0, :, :3] = driven[9]
    return np.concatenate([static, depth, lag, moved[len(ROWS) :], ambient])


def effects(test: EhlTest, disk: DiskTraces, window: DiskWindow, share: float, h_W_m2K: float) -> Effects:
    """All that nobody measured, about the point (share, h), as the fits of one disk see it.

    To what is stated come the friction, the instant of parting, and how each lag of the outer row is split: per second
    moved from its first lag to its second, (1 + tau1 s)(1 + tau2 s) grows by (tau1 - tau2) s^2, so the reading loses
    (tau1 - tau2) s^2 / ((1 + tau1 s)(1 + tau2 s)) of itself.
    """
    rim, blocks, dt = window.rim, window.blocks, test.dt_s
    rest, power = rim.answer(h_W_m2K)
    base, g = rest + share * power, rim.gains(h_W_m2K)
    there = [(*rim.answer(h_W_m2K, p), size) for p, size in departures(DEPTH_STEP_M)]
    moved = np.array([(rest + share * power - base) / size for rest, power, size in there])
    width = max(int(round(SMOOTH_RATE_S / dt)), 1)
    smooth = ndimage.uniform_filter1d(window.readings[:, INNER], width, axis=0, mode="nearest")
    errors = np.hstack([inner_gradient(window, share, h_W_m2K), np.gradient(smooth, dt, axis=0)])
    driven = np.repeat(g.static[[1, 2, 3, 1, 2, 3, 1, 2, 3, 4]][:, None], len(base), axis=1)
    for k, error in enumerate(errors.T, start=3):
        i = 1 + k % 3
        bank = blocks @ lag_bank(error, dt, rim.rates_1_s)
        driven[k] = (blocks @ error)[:, None] * g.direct[i] + bank @ g.gains[i].T
    rates = np.gradient(base, window.at_s, axis=0)
    known = stated_effects(moved, driven, np.ones(len(base)), rates, disk.drives)
    late = -share * np.gradient(power, window.at_s, axis=0)
    taus = sorted(disk.mean_chain.taus_s, reverse=True)
    tau1, tau2 = max(taus[0], 5e-3), max(taus[1] if len(taus) > 1 else 0.0, 2 * dt)
    b, a = discretised([tau1 - tau2, 0.0, 0.0], np.polymul([tau1, 1.0], [tau2, 1.0]), dt)
    whole = sampled(window, base)
    lost = signal.lfilter(b, a, whole, axis=0, zi=signal.lfilter_zi(b, a)[:, None] * whole[0])[0]
    split = -np.eye(3)[:, None] * (blocks @ lost)
    static = disk.static_u_K.copy()
    static[OUTER] = np.hypot(static[OUTER], MODEL_K)
    film = rim.through(FILM_BY_N, h_W_m2K)
    own = [test.events.unload_u_s, disk.uncertainty.friction_rel, *[SPLIT_SD_S] * 3, float(film.any())]
    u = np.concatenate([stated_u(disk, static), own])
    change = np.concatenate([known, [late, share * power], split, [film]])
    asked = np.flatnonzero(u > 0)
    of, since_s = tuple((*STATED, *OWN)[q] for q in asked), window.at_s - test.events.unload_s
    more_of, more = statement_effects(disk, window, share, h_W_m2K)
    of, change = (*of, *more_of), np.concatenate([u[asked, None, None] * change[asked], more])
    uneven = known_round(test, disk.name)
    return Effects(*round_effects(of, change, uneven, disk.setup, h_W_m2K, g.static[1:4], since_s))


@dataclass(frozen=True)
class DiskFeatures:
    """Window means of one disk, W windows, each after one ``event``: "steady", "unloading" or "loading".

    ``after_s`` (W,): middle of the window since the event; ``inputs`` (W, 9) and ``banks`` (9, W, K): power [W], a..f,
    ambient [degC], and the power when the chain is ``LAG_STEP_S`` slower, and where speeds change the film's two;
    ``slope`` (W, 6) mean rate of each channel [K/s], less that of the base; ``noise`` (W,) white noise left of one;
    ``bend`` (W, 6) how far a trend before the event may have bent since [K].

    The outer row a, c, e is predicted from the inner row; the inner row d, b, f itself only in the first seconds after
    an event, when the bore does not yet feel it, by a rim that reaches to the bore: ``seen`` (W, 6) in the order a, c,
    e, d, b, f; ``drives`` as of ``DiskTraces``.
    """

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

    def driven(self, order: Order, power: int = 0) -> RimMeans:
        """The rim driven by ``power``, inner row and ambient, position i of a..f read by column ``order[i]``."""
        feeds = [power, *(1 + order[i] for i in INNER), 7, *range(9, self.inputs.shape[1])]
        return RimMeans(self.setup, self.half_width_m, self.rates_1_s, self.inputs[:, feeds], self.banks[feeds])

    def answer(self, order: Order, h_W_m2K: ArrayLike, p: Perturbation = NOMINAL) -> tuple[Array, Array]:
        """Model of a, c, e, d, b, f without heat and per share of one, (..., W, 6) each for h of shape (...)."""
        driven, deeper = self.driven(order), self.setup.deeper_than_b_m
        rest, power = driven.answer(h_W_m2K, p)
        if np.any(deeper):
            static = np.reshape([driven.gains(float(h), p).static[1:4] for h in np.ravel(h_W_m2K)], (-1, 3, 3))
            static = deeper[:, None] * static.reshape(*np.shape(h_W_m2K), 3, 3)
            by_rest, by_power = driven.gradient(h_W_m2K, p)
            rest, power = rest + by_rest @ static, power + by_power @ static
        film, inner = (driven.through(which, h_W_m2K, p, bore=True) for which in (FILM, POWER))
        return np.concatenate([rest, film], axis=-1), np.concatenate([power, inner], axis=-1)

    def effects(self, order: Order, h_W_m2K: float, share: float) -> Array:
        """What the data ``seen`` show more about a point by a unit of each of ``effects.STATED``, of the harmonic round
        the bore, then by a standard uncertainty of the film's exponent, a second of common lag, a second of later load,
        and the share, (Q, D)."""
        driven, slower = self.driven(order), self.driven(order, COLUMNS.index("slower power"))
        gradient = driven.gradient(h_W_m2K)
        rest, power = self.answer(order, h_W_m2K)
        base, moved = rest + share * power, []
        for p, size in departures(FEATURE_DEPTH_M):
            there = self.answer(order, h_W_m2K, p)
            moved.append((there[0] + share * there[1] - base) / size)
        rates = self.slope[:, [order[i] for i in (*OUTER, *INNER)]]
        lasts = (self.event == "steady").astype(float)
        slow = [lasts, lasts, lasts, *(gradient[0] + share * gradient[1]).T, *rates[:, 3:].T, lasts]  # the rim follows
        static = driven.gains(h_W_m2K).static[[1, 2, 3, 1, 2, 3, 1, 2, 3, 4]]
        known = stated_effects(np.array(moved), np.array(slow)[:, :, None] * static[:, None], lasts, rates, self.drives)
        both = [slower.through(POWER, h_W_m2K, bore=b) - driven.through(POWER, h_W_m2K, bore=b) for b in (False, True)]
        later = share * np.hstack(both) / LAG_STEP_S
        loading = later * (self.event == "loading")[:, None]
        film = np.hstack([driven.through(FILM_BY_N, h_W_m2K, bore=b) for b in (False, True)])
        harmonic = sensed(self.setup, h_W_m2K, driven.gains(h_W_m2K).static[1:4], self.event, self.after_s)
        return np.concatenate([known, harmonic, [film, later, loading, power]])[:, self.seen]


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
    begun = {"unloading": off, "loading": on}
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
        seen=np.repeat(np.column_stack([np.full(len(early), True), early]), 3, axis=1) & ~disk.out[[*OUTER, *INNER]],
        drives=disk.drives,
    )


def _stretch(
    test: EhlTest, disk: DiskTraces, windows: Sequence[Window], start_s: float, base_s: tuple[float, float]
) -> tuple[Array, ...]:
    """Means of ``COLUMNS`` (W, 9), their banks (W, 9, K), slope, noise and bend in one stretch.

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
    feeds = np.stack([power, *y.T, test.ambient_degC[rows], slower, *film], axis=1)
    weights, ahead_s = np.zeros((len(windows), len(t))), np.zeros((len(windows), 1))
    rate, slope = np.zeros((2, len(windows), len(CHANNELS)))
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
