"""How far the sensor features of one disk may lie from their prediction: noise, model form, what nobody measured."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.disk import CHANNELS, INNER_ROW, OUTER_ROW
from calibration.rig import UncertaintyTable
from tcdyn.partition.nuisance import differential_lag_u_s
from tcdyn.partition.sensors.features import DiskFeatures
from tcdyn.partition.window import GRADIENT_STEP_M, INNER, NOMINAL, OUTER, Perturbation
from tcdyn.traces import DiskTraces

Array = NDArray[np.float64]
Order = tuple[int, ...]

SHARE_SD = 0.12  # about each of the shares that are looked at
MIXED_LINES_K = 0.7  # swapped channels carry each other's static lines
MIXED_LAGS_S = 0.06
LEAST_LAG_U_S = 0.05
LOADING_U_S = 0.5  # how long the load takes to come on is not known
MODEL_REL = 0.005  # of what the frictional heat does: rim against whole disk
THICK_REL = 0.015  # the same for the inner row, predicted as if the bore did not feel the first seconds
MODEL_K = 0.03
DEPTH_STEP_M = 0.1e-3
LOG_H_STEP = 0.05


@dataclass(frozen=True)
class Errors:
    """What may be wrong with the features of one disk about one share and h, when ``order`` says who reads what.

    Each error is its effect (W, 6) on measured less predicted a, c, e, d, b, f [K]; ``base`` is the prediction,
    ``power`` (W, 6) its part per share of one, ``rise`` (W, 3) the gradient at d, b, f [K per GRADIENT_STEP_M],
    ``lasting`` (5, 3) the answer of the outer row to a lasting unit of each input.
    """

    f: DiskFeatures
    order: Order
    h_W_m2K: float
    share: float
    base: Array
    power: Array
    rise: Array
    lasting: Array

    @property
    def steady(self) -> Array:
        """One for the steady window, zero for the transients, (W, 1)."""
        return self.f.of("steady")[:, None].astype(float)

    def reading(self, channel: str, error: Array | float) -> Array:
        """An error (W, 1) [K] in what is read at one position."""
        whole = np.broadcast_to(np.asarray(error, dtype=float), self.steady.shape)
        out = np.zeros_like(self.base)
        if channel in OUTER_ROW:
            out[:, OUTER_ROW.index(channel)] = whole[:, 0]
        else:
            out[:, :3] -= whole * self.lasting[1 + INNER_ROW.index(channel)][None]
            out[:, 3 + INNER_ROW.index(channel)] = whole[:, 0]
        return out

    def deeper(self, channel: str) -> Array:
        """``channel`` lies one metre deeper than stated."""
        row = INNER_ROW if channel in INNER_ROW else OUTER_ROW
        steps = [0.0, 0.0, 0.0]
        steps[row.index(channel)] = DEPTH_STEP_M
        moves = (steps[0], steps[1], steps[2])
        if channel in OUTER_ROW:
            return self.of_disk(replace(NOMINAL, depth_m=moves)) / DEPTH_STEP_M
        moved = self.f.answer(self.f.gains(self.h_W_m2K, NOMINAL, moves), self.order)
        out = -self.reading(channel, self.rise[:, [INNER_ROW.index(channel)]] / GRADIENT_STEP_M)
        out[:, 3:] = (self.share * moved[1] - self.base)[:, 3:] / DEPTH_STEP_M
        return np.asarray(out)

    def of_disk(self, p: Perturbation) -> Array:
        """The disk departs from its statement by ``p``."""
        rest, power = self.f.answer(self.f.gains(self.h_W_m2K, p), self.order)
        return np.asarray(rest + self.share * power - self.base)

    def of_log_h(self) -> Array:
        """ln h is larger by one."""
        rest, power = self.f.answer(self.f.gains(self.h_W_m2K * float(np.exp(LOG_H_STEP))), self.order)
        return np.asarray((rest + self.share * power - self.base) / LOG_H_STEP)

    def later(self) -> Array:
        """The frictional heat is seen one second later."""
        return self.share * self.f.later(self.f.gains(self.h_W_m2K))


def errors_about(f: DiskFeatures, order: Order, h_W_m2K: float, share: float) -> Errors:
    """Errors about a share and an h [W/m2K]."""
    g = f.gains(h_W_m2K)
    rest, power = f.answer(g, order)
    above = f.rise(f.above(h_W_m2K, NOMINAL), order)
    rise = above[0] + share * above[1]
    lasting = g.rim.direct + g.rim.gains.sum(axis=2)
    return Errors(f, order, h_W_m2K, share, np.asarray(rest + share * power), power, rise, lasting)


def covariance(e: Errors, disk: DiskTraces, mixed: tuple[str, ...] = ()) -> Array:
    """Covariance (D, D) [K2] of what is left of the predicted data.

    ``mixed``: channels whose static lines and lags are another's.
    """
    u, steady, lag_u = disk.uncertainty, e.steady, differential_lag_u_s(disk.lag_covariance_s2)
    columns: list[Array] = []
    for i, c in enumerate(CHANNELS):
        offset = np.hypot(disk.static_u_K[i], MIXED_LINES_K if c in mixed else 0.0)
        lag = np.hypot(lag_u[i], MIXED_LAGS_S if c in mixed else 0.0)
        columns += [e.reading(c, offset * steady), e.reading(c, lag * e.f.slope[:, [e.order[i]]])]
        columns.append(e.deeper(c) * u.depth_mm * 1e-3)
    columns += [e.of_disk(p) / 0.01 * sd for p, sd in _material(u)]
    columns.append(np.hstack([steady * e.lasting[4] * u.ambient_K, np.zeros((len(steady), 3))]))
    columns.append(e.later() * max(disk.common_lag_u_s, LEAST_LAG_U_S))
    columns.append(e.later() * e.f.of("loading")[:, None] * LOADING_U_S)
    columns.append(e.power * SHARE_SD)
    a = np.stack([c[e.f.seen] for c in columns])
    own = independent_K(e.f, disk, e.power, e.order)[e.f.seen]
    return np.asarray(a.T @ a + np.diag(own**2))


def _material(u: UncertaintyTable) -> list[tuple[Perturbation, float]]:
    e = 0.01
    return [
        (Perturbation(conductivity=e), u.conductivity_rel),
        (Perturbation(heat_capacity=e), u.heat_capacity_rel),
        (Perturbation(washer=e), u.washer_rel),
        (Perturbation(half_width=e), u.half_width_rel),
    ]


def independent_K(f: DiskFeatures, disk: DiskTraces, power: Array, order: Order) -> Array:
    """Independent part of each datum's standard deviation (W, 6) [K]: white noise, what the models miss, trends."""
    own = disk.noise_K[[order[i] for i in (*OUTER, *INNER)]]
    noise = f.noise[:, None] * np.maximum(own, 1e-3)[None]
    rel = np.repeat([MODEL_REL, THICK_REL], 3)
    bend = np.hstack([np.zeros((len(power), 3)), f.bend[:, [order[i] for i in INNER]]])  # the outer row follows it
    return np.sqrt(2 * noise**2 + MODEL_K**2 + (rel * power) ** 2 + bend**2)
