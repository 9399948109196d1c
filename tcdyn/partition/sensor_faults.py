"""Which fault, if any, explains a disk's readings: swapped, misplaced or offset junctions, or a hotter side.

Each hypothesis is a normal distribution of what is left of the outer row when the rim model, driven by the inner row,
has said its part, and of the inner row's first seconds after an event when a rim down to the bore has. Its covariance
holds what nobody measured, and what the fault makes free. Hypotheses are compared by their likelihood, in which more
freedom costs what it should.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from calibration.disk import CHANNELS, INNER_ROW, OUTER_ROW
from calibration.estimate import Estimate
from calibration.rigfile import UncertaintyTable
from tcdyn.partition.nuisance import differential_lag_u_s
from tcdyn.partition.prepare import DiskTraces
from tcdyn.partition.sensor_features import DiskFeatures, Gains
from tcdyn.partition.window import GRADIENT_STEP_M, INNER, NOMINAL, OUTER, Perturbation

Array = NDArray[np.float64]
Order = tuple[int, ...]
Reading = Callable[[str, "Array | float"], Array]

AS_WIRED: Order = tuple(range(len(CHANNELS)))
H_GRID_W_M2K = np.geomspace(30.0, 3000.0, 14)
SHARE_PRIOR = (0.5, 0.5)
MISPLACED_M = 1.5e-3
OFFSET_K = 5.0
MIXED_LINES_K = 0.7  # swapped channels carry each other's static lines
MIXED_LAGS_S = 0.06
LEAST_LAG_U_S = 0.05
LOADING_U_S = 0.5  # how long the load takes to come on is not known
MODEL_REL = 0.01  # of what the frictional heat does: rim against whole disk
THICK_REL = 0.03  # the same for the inner row, predicted as if the bore did not feel the first seconds
MODEL_K = 0.05
DEPTH_STEP_M = 0.1e-3


@dataclass(frozen=True)
class Fault:
    """A hypothesis: ``kind`` "none", "swapped", "misplaced", "offset" or "side", with its channels."""

    kind: str
    channels: tuple[str, ...] = ()

    @property
    def order(self) -> Order:
        """Which column reads each position."""
        if self.kind != "swapped":
            return AS_WIRED
        i, j = (CHANNELS.index(c) for c in self.channels)
        order = list(AS_WIRED)
        order[i], order[j] = j, i
        return tuple(order)


@dataclass(frozen=True)
class Verdict:
    """A hypothesis with its log likelihood, chi-square and the number of data, at its best share and h.

    ``size`` is how far the junction is misplaced [m, positive deeper], how much it or the side reads too high [K].
    """

    fault: Fault
    log_likelihood: float
    chi2: float
    dof: int
    share: float
    h_W_m2K: float
    size: Estimate | None

    @property
    def p_value(self) -> float:
        """Chance of so bad a fit were the hypothesis true."""
        return float(stats.chi2.sf(self.chi2, self.dof))


def hypotheses(sides: tuple[tuple[str, ...], ...]) -> Iterator[Fault]:
    """All faults that are looked for; ``sides`` are the groups of channels by angle."""
    for pair in combinations(CHANNELS, 2):
        yield Fault("swapped", pair)
    for channel in CHANNELS:
        yield Fault("misplaced", (channel,))
        yield Fault("offset", (channel,))
    if len(sides) == 2 and min(len(s) for s in sides) > 1:
        yield Fault("side", sides[1])


def judge(f: DiskFeatures, disk: DiskTraces, u: UncertaintyTable, fault: Fault, gains: list[Gains]) -> Verdict:
    """Likelihood of the features under ``fault``; ``gains`` over ``H_GRID_W_M2K``."""
    order = fault.order
    seen = f.seen
    y = f.level(order)[seen]
    whole = [f.answer(g, order) for g in gains]
    rough = _scale(f, disk, whole[len(whole) // 2][1], order)[seen]
    answers = [(rest[seen], power[seen]) for rest, power in whole]
    start = [_share(y, rest, power, rough) for rest, power in answers]
    k = int(np.argmin([s[1] for s in start]))
    for _ in range(2):
        cov, freedom = covariance(f, disk, u, fault, float(H_GRID_W_M2K[k]), start[k][0])
        root: Array = np.asarray(np.linalg.cholesky(cov), dtype=float)
        whitened = [_whiten(root, y, rest, power) for rest, power in answers]
        best = int(np.argmin([w[1] for w in whitened]))
        if best == k:
            break
        k = best
        start[k] = (whitened[k][0], whitened[k][1])
    share, chi2 = whitened[k]
    log_det = 2 * float(np.log(np.diag(root)).sum())
    size = None
    if freedom is not None:
        sd, effect = freedom
        rest, power = answers[k]
        toward = np.linalg.solve(cov, effect)
        value = sd * float(toward @ (y - rest - SHARE_PRIOR[0] * power))
        size = Estimate.normal(value, sd * max(1 - float(toward @ effect), 0.0) ** 0.5)
    return Verdict(fault, -0.5 * (chi2 + log_det), chi2, y.size - 1, share, float(H_GRID_W_M2K[k]), size)


def covariance(
    f: DiskFeatures, disk: DiskTraces, u: UncertaintyTable, fault: Fault, h: float, share: float
) -> tuple[Array, tuple[float, Array] | None]:
    """Covariance (D, D) [K2] of what is left of the predicted data: noise, model form, nuisances, the fault's freedom.

    With it comes the freedom's prior standard deviation and its effect (D,) [K], when the fault has one.
    """
    order = fault.order
    setup = f.setup
    inner_m = setup.junctions["b"].depth_m  # the rim model takes the whole inner row to lie at the depth of b
    shifted = tuple((inner_m - GRADIENT_STEP_M, setup.junctions[c].z_m) for c in INNER_ROW)
    g = f.gains(h)
    rest, power = f.answer(g, order)
    base: Array = np.asarray(rest + share * power)
    above = f.outer(f.rim_gains(h, NOMINAL, shifted), order)
    rise = (above[0] + share * above[1])[:, 3:] - f.x[:, [1 + order[i] for i in INNER]]
    lasting = g.rim.direct + g.rim.gains.sum(axis=2)  # answer of the outer row to a lasting unit of each input
    steady = f.of("steady")[:, None].astype(float)
    columns: list[Array] = []
    freedom: tuple[float, Array] | None = None

    def reading(channel: str, sd: Array | float) -> Array:
        """Effect on the misfit of an error (W, 1) in the reading of one position."""
        error = np.broadcast_to(np.asarray(sd, dtype=float), steady.shape)
        out = np.zeros_like(base)
        if channel in OUTER_ROW:
            out[:, OUTER_ROW.index(channel)] = error[:, 0]
        else:
            out[:, :3] -= error * lasting[1 + INNER_ROW.index(channel)][None]
            out[:, 3 + INNER_ROW.index(channel)] = error[:, 0]
        return out

    lag_u = differential_lag_u_s(disk.lag_covariance_s2)
    for i, c in enumerate(CHANNELS):
        mixed = fault.kind == "swapped" and c in fault.channels
        offset = np.hypot(disk.static_u_K[i], MIXED_LINES_K if mixed else 0.0)
        columns.append(reading(c, offset * steady))
        lag = np.hypot(lag_u[i], MIXED_LAGS_S if mixed else 0.0)
        columns.append(reading(c, lag * f.slope[:, [order[i]]]))
        by_depth = _depth(f, order, c, share, h, base, rise, reading)
        columns.append(by_depth * u.depth_mm * 1e-3)
        if fault == Fault("misplaced", (c,)):
            freedom = (MISPLACED_M, MISPLACED_M * by_depth)
    if fault.kind in ("side", "offset"):
        freedom = (OFFSET_K, OFFSET_K * np.sum([reading(c, steady) for c in fault.channels], axis=0))
    if freedom is not None:
        columns.append(freedom[1])
    for p, sd in _material(u):
        moved = f.answer(f.gains(h, p), order)
        columns.append((moved[0] + share * moved[1] - base) / 0.01 * sd)
    columns.append(np.hstack([steady * lasting[4] * u.ambient_K, np.zeros((len(steady), 3))]))
    later = share * f.later(g)
    columns.append(later * max(disk.common_lag_u_s, LEAST_LAG_U_S))
    columns.append(later * f.of("loading")[:, None] * LOADING_U_S)
    columns.append(power * SHARE_PRIOR[1])
    a = np.stack([c[f.seen] for c in columns])
    own = _scale(f, disk, power, order)[f.seen]
    return np.asarray(a.T @ a + np.diag(own**2)), freedom and (freedom[0], freedom[1][f.seen])


def _depth(
    f: DiskFeatures, order: Order, channel: str, share: float, h: float, base: Array, rise: Array, reading: Reading
) -> Array:
    """Change of the misfit per metre by which ``channel`` lies deeper than stated, (W, 6)."""
    row = INNER_ROW if channel in INNER_ROW else OUTER_ROW
    steps = [0.0, 0.0, 0.0]
    steps[row.index(channel)] = DEPTH_STEP_M
    moves = (steps[0], steps[1], steps[2])
    if channel in OUTER_ROW:
        moved = f.answer(f.gains(h, replace(NOMINAL, depth_m=moves)), order)
        return np.asarray((moved[0] + share * moved[1] - base) / DEPTH_STEP_M)
    moved = f.answer(f.gains(h, NOMINAL, moves), order)
    out = -reading(channel, rise[:, [INNER_ROW.index(channel)]] / GRADIENT_STEP_M)
    out[:, 3:] = (share * moved[1] - base)[:, 3:] / DEPTH_STEP_M
    return np.asarray(out)


def _material(u: UncertaintyTable) -> list[tuple[Perturbation, float]]:
    e = 0.01
    return [
        (Perturbation(conductivity=e), u.conductivity_rel),
        (Perturbation(heat_capacity=e), u.heat_capacity_rel),
        (Perturbation(washer=e), u.washer_rel),
        (Perturbation(half_width=e), u.half_width_rel),
    ]


def _scale(f: DiskFeatures, disk: DiskTraces, power: Array, order: Order) -> Array:
    """Independent part of each datum's standard deviation (W, 6) [K]: white noise and what the models miss."""
    own = disk.noise_K[[order[i] for i in (*OUTER, *INNER)]]
    noise = f.noise[:, None] * np.maximum(own, 1e-3)[None]
    rel = np.repeat([MODEL_REL, THICK_REL], 3)
    return np.sqrt(2 * noise**2 + MODEL_K**2 + (rel * power) ** 2)


def _share(y: Array, rest: Array, power: Array, sd: Array) -> tuple[float, float]:
    """Best share in 0..1 and its misfit, data weighed one by one."""
    share = float((power * (y - rest) / sd**2).sum() / (power**2 / sd**2).sum())
    share = float(np.clip(share, 0.02, 0.98))
    return share, float((((y - rest - share * power) / sd) ** 2).sum())


def _whiten(root: Array, y: Array, rest: Array, power: Array) -> tuple[float, float]:
    """Most likely share and chi-square about the middle of its prior, which the covariance already holds."""
    r = np.linalg.solve(root, y - rest - SHARE_PRIOR[0] * power)
    p = np.linalg.solve(root, power)
    share = SHARE_PRIOR[0] + SHARE_PRIOR[1] ** 2 * float(p @ r)
    return float(np.clip(share, 0.02, 0.98)), float(r @ r)
