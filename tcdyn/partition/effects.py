"""What nobody measured in a test: how well it is known, and what it does to the readings that the rim predicts: in the
blocks of the fits, and in few numbers that tell junctions apart, of the steady level and after each event."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage, signal

from calibration import Array
from calibration.disk import CHANNELS, OUTER_ROW
from tcdyn.chain import discretised
from tcdyn.conduction.rim import lag_bank
from tcdyn.partition.events import EhlTest
from tcdyn.partition.statement import statement_effects
from tcdyn.partition.uneven import Unmeasured, round_effects
from tcdyn.partition.window import (
    FILM_BY_N,
    INNER,
    OUTER,
    ROWS,
    DiskWindow,
    Perturbation,
    inner_gradient,
    known_round,
    sampled,
)  # fmt: skip
from tcdyn.traces import DiskTraces

AMBIENT = -1  # of what ``stated_effects`` gives
MATERIAL_STEP = 0.01
MATERIALS = [Perturbation(*(MATERIAL_STEP * row)) for row in np.eye(4)]  # steel, washer, half-width
DEPTH_STEP_M = 0.05e-3
SMOOTH_RATE_S = 0.5
SPLIT_SD_S = 0.03  # a plunge hardly tells how a channel's lag is split in two
MODEL_K = 0.03  # what rim and mesh leave unexplained at a junction, against whole-disk solutions

STATED = (
    *(Unmeasured(f"static {c}", "static lines") for c in ROWS),
    *(Unmeasured(f"depth {c}", "junction depth") for c in ROWS),
    *(Unmeasured(f"lag {c}", "chain") for c in ROWS),
    *(Unmeasured(name, name, True) for name in ("conductivity", "heat capacity", "washer", "half-width", "ambient")),
)
AIR = Unmeasured("air", "ambient")  # of one disk, as far as its channels differ
OWN = (
    Unmeasured("parting", "parting", True),
    Unmeasured("friction", "friction", True),
    *(Unmeasured(f"split {c}", "chain") for c in OUTER_ROW),
    Unmeasured("film exponent", "film exponent", True),
    AIR,
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
    own += [test.air[disk.name].own_u_K if disk.name in test.air else 0.0]
    u = np.concatenate([stated_u(disk, static), own])
    change = np.concatenate([known, [late, share * power], split, [film, known[AMBIENT]]])
    asked = np.flatnonzero(u > 0)
    of, since_s = tuple((*STATED, *OWN)[q] for q in asked), window.at_s - test.events.unload_s
    more_of, more = statement_effects(disk, window, share, h_W_m2K)
    of, change = (*of, *more_of), np.concatenate([u[asked, None, None] * change[asked], more])
    uneven = known_round(test, disk.name)
    return Effects(*round_effects(of, change, uneven, disk.setup, h_W_m2K, g.static[1:4], since_s))
