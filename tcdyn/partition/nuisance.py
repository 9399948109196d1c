"""What the readings of a disk show: by its share, its film and the lags of its chain, the model of the joint fits; and
by what nobody measured in a test: how well it is known, and what it does to the readings that the rim predicts: in the
blocks of the fits, and in few numbers that tell junctions apart, of the steady level and after each event."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from tcdyn.chain import Chain
from tcdyn.chain.rational import Factor, Rational, simulate
from tcdyn.core import Array
from tcdyn.heat.rim import bank_means, cardinal
from tcdyn.partition.angular_harmonic import Unevenness, Unmeasured, add_harmonic_effects
from tcdyn.partition.events import EhlTest
from tcdyn.partition.specified import specified_effects
from tcdyn.partition.window import (
    POWER,
    DiskWindow,
    Perturbation,
    RimMeans,
    interpolate_blocks,
    steady_start_s,
)
from tcdyn.rig.disk import DiskSetup
from tcdyn.smoothing.traces import DiskTraces

PARAMETERS = ("share", "log h", "log lags", "log tau2")  # of each disk; lags: tau1 + tau2
SHARE, LOG_H, LOG_LAGS, LOG_TAU2 = range(4)
MIN_LAG_FRACTION = 1e-7  # of the sum of both lags
MIN_NODE_DISTANCE = 1e-6  # a lag this near to one of the bank's is taken to lie beside it
# a search that goes beyond a million W/m2K has lost its way
LOG_H_STEP = 1e-5
MAX_LOG_H = 14.0
AMBIENT_INDEX = -1  # of what ``nominal_effects`` gives
MATERIAL_STEP = 0.01
MATERIALS = [Perturbation(*(MATERIAL_STEP * row)) for row in np.eye(4)]  # steel, washer, half-width
DEPTH_STEP_M = 0.05e-3
SMOOTH_RATE_S = 0.5
SPLIT_SD_S = 0.03  # a plunge hardly tells how a channel's lag is split in two
MODEL_K = 0.03  # what rim and mesh leave unexplained at a junction, against whole-disk solutions

DISK_AIR = Unmeasured("air", "ambient")  # of one disk, as far as its channels differ


def nominal_parameters(disk: DiskSetup) -> tuple[Unmeasured, ...]:
    """What is stated of a disk and its surroundings: of each junction, the outer row first, then of the steel."""
    return (
        *(Unmeasured(f"static {c}", "static lines") for c in disk.rows),
        *(Unmeasured(f"depth {c}", "junction depth") for c in disk.rows),
        *(Unmeasured(f"lag {c}", "chain") for c in disk.rows),
        *(
            Unmeasured(name, name, True)
            for name in ("conductivity", "heat capacity", "washer", "half-width", "ambient")
        ),
    )


def parameters_of_test(disk: DiskSetup) -> tuple[Unmeasured, ...]:
    """What a test adds to that."""
    return (
        Unmeasured("parting", "parting", True),
        Unmeasured("friction", "friction", True),
        *(Unmeasured(f"split {c}", "chain") for c in disk.outer),
        Unmeasured("film exponent", "film exponent", True),
        DISK_AIR,
    )


@dataclass(frozen=True)
class NuisanceEffects:
    """``change`` (Q, R, P): what the readings show more than predicted by one standard uncertainty of each [K]."""

    of: tuple[Unmeasured, ...]
    change: Array


def nominal_u(disk: DiskTraces, static_u_K: Array, other_lags_s: Array | float = 0.0) -> Array:
    """Standard uncertainty of everything ``stated``, (Q,): static lines (C,) as given; lags by how well the
    record tells each from the mean of all, and by ``other_lags_s`` where they may be another channel's."""
    u = disk.uncertainty
    order = disk.setup.places(disk.setup.rows)
    centre = np.eye(len(order)) - 1.0 / len(order)
    apart = np.clip(np.diag(centre @ disk.lag_covariance_s2 @ centre.T), 0.0, None)
    lag_u_s = np.hypot(np.sqrt(apart), other_lags_s)
    steel = [u.conductivity_rel, u.heat_capacity_rel, u.washer_rel, u.half_width_rel, u.ambient_K]
    return np.concatenate([static_u_K[order], disk.depth_u_m[order], lag_u_s[order], steel])


def nominal_perturbations(disk: DiskSetup, depth_step_m: float) -> list[tuple[Perturbation, float]]:
    """What ``nominal_effects`` asks the answer to, each with its size: every junction deeper, steel, washer, width."""
    deeper = [
        (Perturbation(deeper_m=tuple(row)), depth_step_m)
        for row in depth_step_m * np.eye(len(disk.rows))
    ]
    return deeper + [(p, MATERIAL_STEP) for p in MATERIALS]


def nominal_effects(
    moved: Array, driven: Array, lasts: Array, rates_K_s: Array, drives: Array
) -> Array:
    """What R means of the P outer junctions (or of these and the k inner) show more by a unit of everything ``stated``.

    (Q, R, P or P + k). ``moved`` (P + k + 4, R, ...): what they show more by a unit of each of the ``nominal_perturbations``;
    ``driven`` (3 k + 1, R, P): what the outer row answers to an input that is higher by a lasting kelvin, by its rise
    of temperature with radius, and by its rate, each for the inner row, and to a kelvin of ambient; ``lasts`` (R,): how
    much of a lasting error the means show; ``rates_K_s`` (R, ...): how fast each rises; ``drives`` (k, k): which inputs
    each of the inner row errs with. A junction of the inner row that reads too high drives the prediction up, one that
    lies deeper reads too low for its inner radius."""
    k = len(drives)
    p = driven.shape[2]
    place = np.eye(p + k)[:, None, : moved.shape[2]]
    static = place * lasts[:, None]
    lag = -place * rates_K_s
    depth = moved[: p + k].copy()
    static[p:, :, :p] -= np.tensordot(drives, driven[:k], 1)
    depth[p:, :, :p] += np.tensordot(drives, driven[k : 2 * k], 1)
    lag[p:, :, :p] += np.tensordot(drives, driven[2 * k : 3 * k], 1)
    ambient = np.zeros_like(moved[:1])
    ambient[0, :, :p] = driven[3 * k]
    return np.concatenate([static, depth, lag, moved[p + k :], ambient])


def steady_input_response(setup: DiskSetup, static: Array) -> Array:
    """Steady answers of ``static`` (I, P) in the order of ``driven``, see ``nominal_effects``: (3 k + 1, P)."""
    k = len(setup.inner)
    return np.concatenate([static[1 : k + 1]] * 3 + [static[k + 1 : k + 2]])


def inner_gradient(window: DiskWindow, share: float, h_W_m2K: float) -> Array:
    """Rise of temperature with radius at the inner row in every sample, (N, k) [K/m], from the model itself."""
    rest, power = window.rim.gradient(h_W_m2K)
    return interpolate_blocks(window, rest + share * power)


def harmonic_prior(test: EhlTest, disk: str) -> Unevenness:
    """What is known of the harmonic round the bore of a disk: at first its prior, about the test's steady window."""
    return test.uneven.get(disk, Unevenness(span_s=test.events.unload_s - steady_start_s(test)))


def nuisance_effects(
    test: EhlTest, disk: DiskTraces, window: DiskWindow, share: float, h_W_m2K: float
) -> NuisanceEffects:
    """All that nobody measured, about the point (share, h), as the fits of one disk see it.

    To what is stated come the friction, the instant of parting, and how each lag of the outer row is split: per second
    moved from its first lag to its second, (1 + tau1 s)(1 + tau2 s) grows by (tau1 - tau2) s^2, so the reading loses
    (tau1 - tau2) s^2 / ((1 + tau1 s)(1 + tau2 s)) of itself.
    """
    rim = window.rim
    blocks = window.blocks
    dt = test.dt_s
    setup = disk.setup
    inner = setup.places(setup.inner)
    outer = setup.places(setup.outer)
    rest, power = rim.answer(h_W_m2K)
    base = rest + share * power
    g = rim.gains(h_W_m2K)
    there = [(*rim.answer(h_W_m2K, p), size) for p, size in nominal_perturbations(setup, DEPTH_STEP_M)]
    moved = np.array([(rest + share * power - base) / size for rest, power, size in there])
    width = max(int(round(SMOOTH_RATE_S / dt)), 1)
    smooth = ndimage.uniform_filter1d(window.readings[:, inner], width, axis=0, mode="nearest")
    errors = np.hstack([inner_gradient(window, share, h_W_m2K), np.gradient(smooth, dt, axis=0)])
    driven = np.repeat(steady_input_response(setup, g.static)[:, None], len(base), axis=1)
    for k, error in enumerate(errors.T, start=len(inner)):
        i = 1 + k % len(inner)
        bank = bank_means(error, dt, rim.rates_1_s, window.counts)
        driven[k] = (blocks @ error)[:, None] * g.direct[i] + bank @ g.gains[i].T
    rates = np.gradient(base, window.at_s, axis=0)
    known = nominal_effects(moved, driven, np.ones(len(base)), rates, disk.drives)
    late = -share * np.gradient(power, window.at_s, axis=0)
    taus = sorted(disk.mean_chain.taus_s, reverse=True)
    tau1 = max(taus[0], 5e-3)
    tau2 = max(taus[1] if len(taus) > 1 else 0.0, 2 * dt)
    bent = Rational(np.array([0.0, 0.0, tau1 - tau2]), (Factor((1.0, tau1)), Factor((1.0, tau2))))
    lost = np.column_stack([simulate(bent, column, dt) for column in interpolate_blocks(window, base).T])
    split = -np.eye(len(outer))[:, None] * (blocks @ lost)
    static = disk.static_u_K.copy()
    static[outer] = np.hypot(static[outer], MODEL_K)
    film = rim.through(rim.films[1], h_W_m2K)
    own = [
        test.events.unload_u_s,
        disk.uncertainty.friction_rel,
        *[SPLIT_SD_S] * len(outer),
        float(film.any()),
    ]
    own += [test.air[disk.name].own_u_K if disk.name in test.air else 0.0]
    u = np.concatenate([nominal_u(disk, static), own])
    change = np.concatenate([known, [late, share * power], split, [film, known[AMBIENT_INDEX]]])
    asked = np.flatnonzero(u > 0)
    of = tuple((*nominal_parameters(setup), *parameters_of_test(setup))[q] for q in asked)
    since_s = window.at_s - test.events.unload_s
    more_of, more = specified_effects(disk, window, share, h_W_m2K)
    of = (*of, *more_of)
    change = np.concatenate([u[asked, None, None] * change[asked], more])
    uneven = harmonic_prior(test, disk.name)
    return NuisanceEffects(
        *add_harmonic_effects(of, change, uneven, disk.setup, h_W_m2K, g.static[rim.inner], since_s)
    )


def lags(p: Array) -> tuple[float, float]:
    """tau1 and tau2 [s] of the parameters of a disk; a second lag that would be longer than the sum is all of it."""
    total = float(np.exp(p[LOG_LAGS]))
    second = float(np.exp(p[LOG_TAU2]))
    second = min(second, (1 - MIN_LAG_FRACTION) * total)
    return total - second, second


def with_lags(like: Chain, taus_s: tuple[float, ...]) -> Chain:
    """The chain with ``taus_s`` for the two largest lags of ``like``, the rest as there."""
    return replace(like, taus_s=(*taus_s, *sorted(like.taus_s, reverse=True)[2:]))


def add_lag(u: Array, bank: Array, rates_1_s: Array, tau_s: float) -> tuple[Array, Array]:
    """Means (R,) of an input and its ``bank`` (R, K) as it passes one more lag L = 1/(1 + tau s).

    With the bank's lags L_k of rates r_k and a = 1/tau it is L L_k = (a L_k - r_k L)/(a - r_k), and L is made up of
    the L_k themselves by ``cardinal``: good to 1e-6 for a lag within the bank's; one beyond is taken for its last.
    """
    rate = 1 / tau_s
    rate *= 1 + 3 * MIN_NODE_DISTANCE * bool(np.any(np.abs(np.log(rate / rates_1_s)) < MIN_NODE_DISTANCE))
    seen = bank @ cardinal(rates_1_s, np.log(np.clip([rate], *rates_1_s[[0, -1]])))[0]
    return seen, (rate * bank - rates_1_s * seen[:, None]) / (rate - rates_1_s)


@dataclass(frozen=True)
class LaggedRim:
    """A ``rim`` whose power was seen through the one lag ``lag_s`` of two, here answering to both, its readings weighed
    by ``weight`` (R, P)."""

    rim: RimMeans
    lag_s: float
    weight: Array

    def heated(self, taus_s: tuple[float, ...]) -> RimMeans:
        """The rim with the power seen through these lags: (1 + lag s)/(1 + tau s) = lag/tau + (1 - lag/tau) L with the
        longest of them, then the others."""
        rates = self.rim.rates_1_s
        power = (self.rim.inputs[:, 0], self.rim.banks[0])
        longest, *others = sorted(taus_s, reverse=True)
        part = self.lag_s / longest
        u, bank = (part * x + (1 - part) * y for x, y in zip(power, add_lag(*power, rates, longest)))
        for tau in others:
            u, bank = add_lag(u, bank, rates, tau)
        return self.rim.driven_by(u, bank)

    def __call__(self, p: Array) -> tuple[Array, Array] | None:
        """Prediction (m,) and derivatives (m, 4); by the logarithm of a lag, which the power P passes as L, it is
        (L - 1) L P."""
        if not p[LOG_H] < MAX_LOG_H:
            return None
        share = p[SHARE]
        h = float(np.exp(p[LOG_H]))
        (one, two) = lags(p)
        rest, power = self.heated((one, two)).answer(h * np.exp([0.0, LOG_H_STEP]))
        at, up = rest + share * power
        by_one, by_two = (
            share * (self.heated((one, two, tau)).through(POWER, h) - power[0])
            for tau in (one, two)
        )
        slopes = [
            power[0],
            (up - at) / LOG_H_STEP,
            by_one * (one + two) / one,
            by_two - by_one * two / one,
        ]
        return (at * self.weight).ravel(), np.stack(
            [(s * self.weight).ravel() for s in slopes], axis=1
        )
