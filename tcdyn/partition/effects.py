"""What nobody measured in a test: how well it is known, and what it does to the readings that the rim predicts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage, signal

from calibration import Array
from calibration.disk import OUTER_ROW
from tcdyn.chain import discretised
from tcdyn.conduction.rim import lag_bank
from tcdyn.partition.prepare import EhlTest
from tcdyn.partition.window import INNER, OUTER, ROWS, DiskWindow, Perturbation
from tcdyn.traces import DiskTraces

MATERIAL_STEP = 0.01
MATERIALS = (
    Perturbation(conductivity=MATERIAL_STEP),
    Perturbation(heat_capacity=MATERIAL_STEP),
    Perturbation(washer=MATERIAL_STEP),
    Perturbation(half_width=MATERIAL_STEP),
)
DEPTH_STEP_M = 0.05e-3
SMOOTH_RATE_S = 0.5
SPLIT_SD_S = 0.03  # a plunge hardly tells how a channel's lag is split in two
MODEL_K = 0.03  # what rim and mesh leave unexplained at a junction, against whole-disk solutions


@dataclass(frozen=True)
class Unmeasured:
    """Something not measured: ``source`` is its line of the budget; ``shared``: both disks have it in common."""

    name: str
    source: str
    shared: bool = False


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
)


@dataclass(frozen=True)
class Effects:
    """``change`` (Q, R, P): what the readings show more than predicted by one standard uncertainty of each [K]."""

    of: tuple[Unmeasured, ...]
    change: Array


@dataclass(frozen=True)
class FitShift:
    """Error of fitted numbers by one standard uncertainty of what nobody measured, and their noise.

    ``per_sd`` (Q, k): how far the fit is off when the true disk departs by one standard uncertainty from the stated
    one, in the units of the fitted numbers: (intercept, slope) of a steady line, (share, h [W/m2K]) of a cooling fit,
    (share, h, lag [s]) of a joint fit; ``noise`` (k, k) covariance.
    """

    of: tuple[Unmeasured, ...]
    per_sd: Array
    noise: Array


def stated_u(disk: DiskTraces, static_u_K: Array, lag_u_s: Array) -> Array:
    """Standard uncertainty of everything in ``STATED``, (Q,); static lines and differential lags (6,) of a..f."""
    u = disk.uncertainty
    steel = [u.conductivity_rel, u.heat_capacity_rel, u.washer_rel, u.half_width_rel, u.ambient_K]
    order = [*OUTER, *INNER]
    return np.concatenate([static_u_K[order], np.full(len(ROWS), u.depth_mm * 1e-3), lag_u_s[order], steel])


def departures(depth_step_m: float) -> list[tuple[Perturbation, float]]:
    """What ``stated_effects`` asks the answer to, each with its size: every junction deeper, steel, washer, width."""
    deeper = [(Perturbation(deeper_m=tuple(row)), depth_step_m) for row in depth_step_m * np.eye(len(ROWS))]
    return deeper + [(p, MATERIAL_STEP) for p in MATERIALS]


def stated_effects(moved: Array, driven: Array, lasts: Array, rates_K_s: Array) -> Array:
    """What R means of a, c, e (or a, c, e, d, b, f) show more by a unit of everything in ``STATED``, (Q, R, P).

    ``moved`` (10, R, P): what they show more by a unit of each of the ``departures``; ``driven`` (10, R, 3): what the
    outer row answers to an input that is higher by a lasting kelvin, by its rise of temperature with radius, and by its
    rate, each for d, b, f, and to a kelvin of ambient; ``lasts`` (R,): how much of a lasting error the means show;
    ``rates_K_s`` (R, P): how fast each rises. A junction of the inner row that reads too high drives the prediction
    up, one that lies deeper reads too low for the model's inner radius.
    """
    place = np.eye(len(ROWS))[:, None, : moved.shape[2]]
    static, lag, depth = place * lasts[:, None], -place * rates_K_s, moved[: len(ROWS)].copy()
    static[3:, :, :3] -= driven[:3]
    depth[3:, :, :3] += driven[3:6]
    lag[3:, :, :3] += driven[6:9]
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
    moved = []
    for p, size in departures(DEPTH_STEP_M):
        there = rim.answer(h_W_m2K, p)
        moved.append((there[0] + share * there[1] - base) / size)
    width = max(int(round(SMOOTH_RATE_S / dt)), 1)
    smooth = ndimage.uniform_filter1d(window.readings[:, INNER], width, axis=0, mode="nearest")
    errors = np.hstack([inner_gradient(window, share, h_W_m2K), np.gradient(smooth, dt, axis=0)])
    driven = np.repeat(g.static[[1, 2, 3, 1, 2, 3, 1, 2, 3, 4]][:, None], len(base), axis=1)
    for k, error in enumerate(errors.T, start=3):
        i = 1 + k % 3
        bank = blocks @ lag_bank(error, dt, rim.rates_1_s)
        driven[k] = (blocks @ error)[:, None] * g.direct[i] + bank @ g.gains[i].T
    known = stated_effects(np.array(moved), driven, np.ones(len(base)), np.gradient(base, window.at_s, axis=0))
    late = -share * np.gradient(power, window.at_s, axis=0)
    taus = sorted(disk.mean_chain.taus_s, reverse=True)
    tau1, tau2 = max(taus[0], 5e-3), max(taus[1] if len(taus) > 1 else 0.0, 2 * dt)
    b, a = discretised([tau1 - tau2, 0.0, 0.0], np.polymul([tau1, 1.0], [tau2, 1.0]), dt)
    whole = sampled(window, base)
    lost = signal.lfilter(b, a, whole, axis=0, zi=signal.lfilter_zi(b, a)[:, None] * whole[0])[0]
    split = -np.eye(3)[:, None] * (blocks @ lost)
    static = disk.static_u_K.copy()
    static[OUTER] = np.hypot(static[OUTER], MODEL_K)
    u = stated_u(disk, static, differential_lag_u_s(disk.lag_covariance_s2))
    u = np.concatenate([u, [test.events.unload_u_s, disk.uncertainty.friction_rel, *[SPLIT_SD_S] * 3]])
    change = np.concatenate([known, [late, share * power], split])
    asked = np.flatnonzero(u > 0)
    return Effects(tuple((*STATED, *OWN)[q] for q in asked), u[asked, None, None] * change[asked])


def inner_gradient(window: DiskWindow, share: float, h_W_m2K: float) -> Array:
    """Rise of temperature with radius at d, b, f in every sample, (N, 3) [K/m], from the model itself."""
    rest, power = window.rim.gradient(h_W_m2K)
    return sampled(window, rest + share * power)


def sampled(window: DiskWindow, of_blocks: Array) -> Array:
    """What was worked out on block means (R, M), straight between them, (N, M)."""
    return np.column_stack([np.interp(window.time_s, window.at_s, column) for column in of_blocks.T])


def differential_lag_u_s(covariance_s2: Array) -> Array:
    """Standard uncertainty of each channel's lag less the mean of all, from their covariance; (M, M) -> (M,)."""
    return np.sqrt(np.clip(np.diag(with_common_u(covariance_s2, 0.0)), 0.0, None))


def with_common_u(covariance_s2: Array, common_u_s: float) -> Array:
    """Covariance (M, M) of lags whose differences are known as ``covariance_s2`` says and their mean to ``common_u_s``.

    >>> with_common_u(np.full((2, 2), 0.25), 0.1).round(4)
    array([[0.01, 0.01],
           [0.01, 0.01]])
    """
    centre = np.eye(len(covariance_s2)) - 1.0 / len(covariance_s2)
    return np.asarray(centre @ covariance_s2 @ centre.T + common_u_s**2)
