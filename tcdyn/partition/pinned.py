"""The joint fits' posterior as a small smooth function: cheap enough to be minimised hundreds of times, numbers pinned.

A disk answers rest(h) + share power(h, tau1, tau2). The two lags enter as 1/(1 + S s + q S^2 s^2/4) with
S = tau1 + tau2 and q = 4 tau1 tau2/S^2 in [0, 1], smoothly and whichever is the longer, so a Chebyshev table in log h,
log S and q stands for the rim model; the nuisances, linear with normal priors of one, go out in closed form.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import null_space

from tcdyn.conduction.rim import cardinal, cardinal_slope
from tcdyn.partition.joint_solve import LONGEST, SHAPE_SD, Point, Side, nuisance_columns, powered
from tcdyn.partition.prepare import EhlTest

Array = NDArray[np.float64]
REACH_U = 7.0  # half-width of the table in standard uncertainties,
REACH_FOLD = 8.0  # but no farther than this factor
H_NODES, SHAPE_NODES = 13, 9
SUM_NODES = ((0.4, 5), (1.4, 7), (np.inf, 11))  # up to this width in log S: 0.1 mK, at worst 0.7 mK, of 100 K
RANK = 60  # directions of data space that a disk's table spans: what they leave out is below 1e-8 K
STEPS, HALVINGS, ENOUGH = 40, 8, 1e-7
SHARE, LOG_H, LOG_SUM, LOG_TAU2 = range(4)


class Surface(Protocol):
    """Sum of squares over parameters: data, nuisances taken out, and priors."""

    def rows(self, theta: Array) -> tuple[Array, Array] | None:
        """Residual (R,) and its Jacobian (R, P) at ``theta`` (P,); None outside the table."""

    def noise_part(self, theta: Array, toward: Array) -> float:
        """Variance of white noise in the estimate of ``toward`` @ theta, when theta answers to data as ``rows`` say."""

    @property
    def always(self) -> Array:
        """Rows (C, P) of combinations of theta that keep their values in every fit."""


@dataclass(frozen=True)
class Table:
    """One disk's data and model in the few directions that they span; node positions are logarithms' arguments."""

    h: Array
    lag_sum: Array
    shape: Array
    y: Array
    rest: Array
    power: Array
    effect: Array

    def model(self, p: Array) -> tuple[Array, Array] | None:
        """Prediction (m,) and its derivatives (4, m) by (share, log h, log S, log tau2); None outside the table.

        A second lag that would be longer than the sum is all of it.
        """
        if not (_inside(p[LOG_H], self.h) and _inside(p[LOG_SUM], self.lag_sum)):
            return None
        ratio = min(float(np.exp(p[LOG_TAU2] - p[LOG_SUM])), 1.0)
        q = 4 * (1 - ratio) * ratio
        q_slope = 4 * ratio * (1 - 2 * ratio) if ratio < 1 else 0.0  # by log tau2, and the opposite by log S
        (a, da), (b, db), (c, dc) = (
            _weights(n, x) for n, x in ((self.h, p[LOG_H]), (self.lag_sum, p[LOG_SUM]), (self.shape, q))
        )
        by_lags = np.tensordot(a, self.power, 1)
        by_shape = np.tensordot(b, by_lags, 1)
        power, by_q = c @ by_shape, dc @ by_shape
        by_h = c @ np.tensordot(b, np.tensordot(da, self.power, 1), 1)
        by_sum = c @ np.tensordot(db, by_lags, 1)
        share = p[SHARE]
        slopes = [
            power,
            da @ self.rest + share * by_h,
            share * (by_sum - by_q * q_slope),
            share * by_q * q_slope,
        ]
        return a @ self.rest + share * power, np.stack(slopes)


@dataclass(frozen=True)
class JointSurface:
    """The posterior of one disk, or of both with shares that add to one; theta holds four parameters a disk.

    ``whiten`` (m, m) takes the nuisances out: its square is the inverse covariance of white noise and nuisances.
    """

    sides: tuple[Side, ...]
    tables: tuple[Table, ...]
    whiten: Array

    def rows(self, theta: Array) -> tuple[Array, Array] | None:
        """Residual and Jacobian of data and priors; see ``Surface``."""
        residual, slopes = [], np.zeros((len(self.whiten), len(theta)))
        at = 0
        for i, (table, p) in enumerate(zip(self.tables, theta.reshape(-1, 4))):
            answer = table.model(p)
            if answer is None:
                return None
            residual.append(answer[0] - table.y)
            slopes[at : at + len(table.y), 4 * i : 4 * i + 4] = answer[1].T
            at += len(table.y)
        prior, prior_slopes = self._priors(theta)
        return (
            np.concatenate([self.whiten @ np.concatenate(residual), prior]),
            np.vstack([self.whiten @ slopes, prior_slopes]),
        )

    def _priors(self, theta: Array) -> tuple[Array, Array]:
        """Lag and shape of each disk against the record's, in standard uncertainties."""
        value, slope = np.zeros(2 * len(self.sides)), np.zeros((2 * len(self.sides), len(theta)))
        for i, (side, p) in enumerate(zip(self.sides, theta.reshape(-1, 4))):
            total = np.exp(p[LOG_SUM])
            value[2 * i] = (total + rest_of_lag_s(side) - side.prior_lag_s) / side.prior_lag_u_s
            slope[2 * i, 4 * i + LOG_SUM] = total / side.prior_lag_u_s
            value[2 * i + 1] = (p[LOG_TAU2] - np.log(side.prior_tau2_s)) / SHAPE_SD
            slope[2 * i + 1, 4 * i + LOG_TAU2] = 1 / SHAPE_SD
        return value, slope

    def noise_part(self, theta: Array, toward: Array) -> float:
        """See ``Surface``."""
        done = self.rows(theta)
        assert done is not None
        free = free_directions(self.always)
        jac = done[1] @ free
        answer = np.linalg.solve(jac.T @ jac, free.T @ toward)
        return float(np.sum((self.whiten.T @ (jac[: len(self.whiten)] @ answer)) ** 2))

    @property
    def always(self) -> Array:
        """Shares that add to one, with both disks; nothing with one."""
        sums = np.zeros((1, 4 * len(self.sides)))
        sums[0, SHARE::4] = 1.0
        return sums if len(self.sides) > 1 else sums[:0]


def rest_of_lag_s(side: Side) -> float:
    """Lag of a disk's chain beyond its two lags tau1 + tau2: the conditioning filter and the like [s]."""
    chain = side.disk.mean_chain
    return chain.lag_s - sum(sorted(chain.taus_s, reverse=True)[:2])


def joint_surface(sides: Sequence[Side], tables: Sequence[Table]) -> JointSurface:
    """The posterior of the disks of ``sides``, from their tables, nuisances that both share joined."""
    columns = nuisance_columns(sides)
    sizes = [len(t.y) for t in tables]
    effect = np.zeros((sum(sizes), len(columns)))
    for c, members in enumerate(columns):
        for i, q in members:
            at = sum(sizes[:i])
            effect[at : at + sizes[i], c] = tables[i].effect[:, q]
    left, size, _ = np.linalg.svd(effect, full_matrices=False)
    # (1 + N N')^-1/2 for data = model + N nuisances + noise
    whiten = np.eye(len(effect)) + (left * (1 / np.sqrt(1 + size**2) - 1)) @ left.T
    return JointSurface(tuple(sides), tuple(tables), whiten)


def table_of(test: EhlTest, side: Side, points: Sequence[Point], h_u_W_m2K: float, lag_u_s: float) -> Table:
    """Run the rim model on all nodes about the ``points``, as far as the uncertainties of h and lag ask for."""
    nodes_h = _nodes(*_reach([p.h for p in points], h_u_W_m2K), H_NODES)
    low, high = _reach([float(sum(np.exp(p.log_tau))) for p in points], lag_u_s)
    nodes_sum = _nodes(low, high, next(count for width, count in SUM_NODES if high - low < width))
    nodes_shape = _nodes(0.0, 1.0, SHAPE_NODES)
    rim, weight = side.window.rim, side.window.weight
    gains = [rim.gains(float(x)) for x in nodes_h]
    rest = np.array([(rim.answer(float(x))[0] * weight).ravel() for x in nodes_h])
    power = np.empty((len(gains), len(nodes_sum), SHAPE_NODES, weight.size))
    for i, s in enumerate(nodes_sum):
        for j, q in enumerate(np.log(nodes_shape)):
            ratio = 0.5 * (1 - np.sqrt(max(1 - q, 0.0)))
            tau = (float(np.log(s * (1 - ratio))), float(np.log(s * max(ratio, 1e-9))))
            seen = powered(test, side, Point(0.0, 0.0, tau)).rim
            for k, g in enumerate(gains):
                power[k, i, j] = (seen.heat(g) * weight).ravel()
    y = (side.window.y * weight).ravel()
    effect = (side.nuisance.change * weight).reshape(len(side.nuisance.of), -1)
    basis = _span(np.vstack([rest, power.reshape(-1, weight.size)]), np.vstack([y, effect]))
    return Table(
        nodes_h, nodes_sum, nodes_shape, y @ basis, rest @ basis, np.asarray(power @ basis), (effect @ basis).T
    )


def minimum(surface: Surface, start: Array, pins: Array, values: Array) -> tuple[Array, float] | None:
    """Least sum of squares where ``pins`` (C, P) @ theta = ``values``, Gauss-Newton from ``start``.

    The rows ``always`` of the surface keep what they have at ``start``. None where the way down leaves the table.
    """
    fixed = np.vstack([surface.always, pins])
    wanted = np.concatenate([surface.always @ start, values])
    theta = start + np.linalg.pinv(fixed) @ (wanted - fixed @ start) if len(fixed) else start
    free = free_directions(fixed)
    now = surface.rows(theta)
    if now is None:
        return None
    cost = float(now[0] @ now[0])
    for _ in range(STEPS):
        step = free @ np.linalg.lstsq(now[1] @ free, -now[0], rcond=None)[0]
        step *= min(1.0, LONGEST / max(float(np.abs(step).max()), 1e-12))
        before, leaves = cost, False
        for _ in range(HALVINGS):
            trial = surface.rows(theta + step)
            leaves |= trial is None
            if trial is not None and float(trial[0] @ trial[0]) <= cost:
                theta, now, cost = theta + step, trial, float(trial[0] @ trial[0])
                break
            step = 0.5 * step
        if before - cost < ENOUGH:
            return None if leaves else (theta, cost)
    return theta, cost


def free_directions(fixed: Array) -> Array:
    """Orthonormal columns (P, F) that leave ``fixed`` (C, P) @ theta as it is; C may be none."""
    return np.asarray(null_space(fixed)) if len(fixed) else np.eye(fixed.shape[1])


def _inside(x: float, nodes: Array) -> bool:
    return bool(np.log(nodes[0]) <= x <= np.log(nodes[-1]))


def _reach(values: Sequence[float], u: float) -> tuple[float, float]:
    """Logarithms of the ends of a table about all ``values``."""
    low = min(max(v - REACH_U * u, v / REACH_FOLD) for v in values)
    high = max(min(v + REACH_U * u, v * REACH_FOLD) for v in values)
    return float(np.log(low)), float(np.log(high))


def _nodes(low: float, high: float, count: int) -> Array:
    """Chebyshev nodes in the logarithm, as ``cardinal`` takes them."""
    x = -np.cos(np.pi * np.arange(count) / (count - 1))
    return np.asarray(np.exp(low + (high - low) * (x + 1) / 2))


def _weights(nodes: Array, log_at: float) -> tuple[Array, Array]:
    """Weights of the table's nodes and their derivative by the logarithm."""
    weights = cardinal(nodes, np.array([log_at]))
    return weights[0], cardinal_slope(nodes, weights)[0]


def _span(many: Array, few: Array) -> Array:
    """Orthonormal columns that span the rows of ``few`` exactly and those of ``many`` by random mixing.

    Halko, Martinsson & Tropp, SIAM Review 53 (2011), algorithm 4.1.
    """
    mixed = np.random.default_rng(0).standard_normal((RANK, len(many))) @ many
    return np.asarray(np.linalg.qr(np.vstack([few, mixed]).T)[0])
