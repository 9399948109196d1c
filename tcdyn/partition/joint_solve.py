"""The posterior that the joint fits minimise: one disk's side of it, its linear form, and Gauss-Newton on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.errors import InputError
from tcdyn.chain import Chain, equalised
from tcdyn.conduction.rim import Profile
from tcdyn.partition.effects import Effects, effects
from tcdyn.partition.prepare import EhlTest
from tcdyn.partition.window import DiskWindow, disk_window, power_bank, stretch_of
from tcdyn.traces import DiskTraces, white_noise

SHAPE_SD = 1.5  # log of the second lag: known to a factor of four or so
LEAST_LAG_U_S = 0.02
LEAST_TOLD = 0.02  # below this the data say nothing of a nuisance, and its pull means nothing
STEPS = 25
TOLERANCE = 1e-6
LONGEST = 0.7  # largest step of log h or of a log lag
HALVINGS = 6
CLIMB = 1e-3  # chi-squared: the slopes are differences, and their zero lies this close to the minimum
SINGULAR = 1e-10  # least part of a column, of its length, that the others leave


@dataclass(frozen=True)
class Side:
    """One disk inside the solver: its window at the current chain, its prior and its nuisances."""

    disk: DiskTraces
    window: DiskWindow
    rows: slice
    prior_lag_s: float
    prior_lag_u_s: float
    prior_tau2_s: float
    nuisance: Effects


@dataclass(frozen=True)
class Point:
    """share, log h, log tau1, log tau2 of one disk."""

    share: float
    log_h: float
    log_tau: tuple[float, float]

    @property
    def h(self) -> float:
        """Heat transfer coefficient [W/m2K]."""
        return float(np.exp(self.log_h))

    def moved(self, step: NDArray[np.float64]) -> Point:
        """The point after a ``step`` (4,) of its four parameters."""
        tau = (self.log_tau[0] + float(step[2]), self.log_tau[1] + float(step[3]))
        return Point(self.share + float(step[0]), self.log_h + float(step[1]), tau)

    def chain(self, like: Chain) -> Chain:
        """The chain with this point's two lags for the largest of ``like``, the rest as there."""
        others = sorted(like.taus_s, reverse=True)[2:]
        return replace(like, taus_s=(float(np.exp(self.log_tau[0])), float(np.exp(self.log_tau[1])), *others))


@dataclass(frozen=True)
class Posterior:
    """Of the main parameters (4 a disk): covariance from noise, answer to each nuisance and each prior of one sd."""

    noise: NDArray[np.float64]
    nuisance: NDArray[np.float64]
    priors: NDArray[np.float64]
    columns: list[list[tuple[int, int]]]
    pulls: NDArray[np.float64]
    rms_K: float
    inflation: float

    def named_pulls(self, sides: Sequence[Side]) -> dict[str, float]:
        """Pull of each nuisance by its name, with its disk unless both disks share it."""
        out = {}
        for value, members in zip(self.pulls, self.columns):
            side, q = sides[members[0][0]], members[0][1]
            what = side.nuisance.of[q]
            out[what.name if what.shared else f"{what.name} of the {side.disk.name} disk"] = float(value)
        return out

    @property
    def covariance(self) -> NDArray[np.float64]:
        """All sources together."""
        return np.asarray(self.noise + self.nuisance @ self.nuisance.T + self.priors @ self.priors.T)


def begin(
    test: EhlTest, disk: DiskTraces, share: float, h: float, window_s: float, profile: Profile
) -> tuple[Side, Point]:
    """A disk's side of the problem and its first point, from ``share`` and ``h`` [W/m2K] and the record's chain."""
    chain = disk.mean_chain
    taus = sorted(chain.taus_s, reverse=True)
    tau1 = max(taus[0], 0.02)
    tau2 = max(taus[1] if len(taus) > 1 else 0.0, 0.1 * tau1)
    lag_u = max(disk.common_lag_u_s, LEAST_LAG_U_S)
    point = Point(share, float(np.log(max(h, 20.0))), (float(np.log(tau1)), float(np.log(tau2))))
    side = _side(test, disk, point, window_s, profile, (disk.common_lag_s, lag_u, tau2))
    return side, point


def refresh(test: EhlTest, side: Side, point: Point, window_s: float, profile: Profile) -> Side:
    """The same side with its window at the chain of ``point``."""
    prior = (side.prior_lag_s, side.prior_lag_u_s, side.prior_tau2_s)
    return _side(test, side.disk, point, window_s, profile, prior)


def _side(
    test: EhlTest,
    disk: DiskTraces,
    point: Point,
    window_s: float,
    profile: Profile,
    prior: tuple[float, float, float],
) -> Side:
    rows = stretch_of(test, window_s)
    common = point.chain(disk.mean_chain)
    shift = common.lag_s - disk.mean_chain.lag_s
    chains = tuple(c.with_lag_shift(shift) for c in disk.chains)
    readings = equalised(disk.readings_degC[rows], test.dt_s, chains, disk.mean_chain.with_lag_shift(shift))
    noise = np.maximum(white_noise(readings), 0.5 * disk.noise_K)
    window = disk_window(test, disk, readings, rows, noise, profile, common)
    return Side(disk, window, rows, *prior, effects(test, disk, window, point.share, point.h))


def powered(test: EhlTest, side: Side, point: Point) -> DiskWindow:
    """The side's window with its power through the chain of ``point``."""
    chain = point.chain(side.disk.mean_chain)
    return side.window.with_power(*power_bank(test, side.rows, side.window.rim.rates_1_s, chain))


def model(test: EhlTest, side: Side, p: Point) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Prediction (R, 3) and its derivatives by (share, log h, log tau1, log tau2), (4, R, 3)."""
    rim = powered(test, side, p).rim
    rest, power = rim.answer(p.h)
    step = 0.02
    up_rest, up_power = rim.answer(p.h * float(np.exp(step)))
    slopes = [power, (up_rest - rest + p.share * (up_power - power)) / step]
    for k in range(2):
        moved = list(p.log_tau)
        moved[k] += step
        other = powered(test, side, replace(p, log_tau=(moved[0], moved[1])))
        slopes.append(p.share * (other.rim.heat(rim.gains(p.h)) - power) / step)
    return rest + p.share * power, np.stack(slopes)


def solve(
    test: EhlTest, sides: Sequence[Side], points: Sequence[Point], shared_share: bool
) -> tuple[list[Point], Posterior]:
    """Gauss-Newton on the posterior, halving steps that climb: the best points and what is known about them."""
    points = list(points)
    columns = nuisance_columns(sides)
    k = 4 * len(sides)
    rows, target = _stacked(test, sides, points, columns, shared_share)
    last = np.inf
    for _ in range(STEPS):
        step = np.linalg.lstsq(rows, target, rcond=None)[0][:k].reshape(-1, 4)
        step *= min(1.0, LONGEST / max(float(np.abs(step[:, 1:]).max()), 1e-12))
        allowed = _cost(rows, target, k) + CLIMB
        for _ in range(HALVINGS):
            moved = [p.moved(np.asarray(s)) for p, s in zip(points, step)]
            trial = _stacked(test, sides, moved, columns, shared_share)
            if _cost(*trial, k) <= allowed:
                break
            step *= 0.5
        else:
            break
        points, (rows, target) = moved, trial
        size = float(np.abs(step[:, :3]).max())
        if size < TOLERANCE or (size < 1e-4 and size >= last):
            break
        last = size
    return points, _posterior(rows, target, sides, columns)


def _cost(rows: NDArray[np.float64], target: NDArray[np.float64], k: int) -> float:
    """Sum of squares with the nuisances, all columns from ``k`` on, at their best."""
    free = rows[:, k:]
    toward = free.T @ target
    return float(target @ target - toward @ np.linalg.solve(free.T @ free, toward))  # priors of one: never singular


def _posterior(
    rows: NDArray[np.float64], target: NDArray[np.float64], sides: Sequence[Side], columns: list[list[tuple[int, int]]]
) -> Posterior:
    """What the linear form at the best points says of parameters and nuisances."""
    covariance = _covariance(rows)
    solution = covariance @ (rows.T @ target)
    k = 4 * len(sides)
    told = 1.0 - np.diag(covariance)[k:]  # share of each nuisance's prior variance that the data removed
    data = sum(s.window.y.size for s in sides)
    residual = (target - rows @ solution)[:data]
    gain = covariance[:k] @ rows[:data].T
    inflation = _inflation(residual, sides)
    nuisance = gain @ rows[:data, k:]
    priors = covariance[:k] @ rows[data : data + 2 * len(sides)].T
    rms = float(np.sqrt(np.mean([np.mean((r / s.window.weight.ravel()) ** 2) for r, s in _split(residual, sides)])))
    pulls = solution[k:] / np.sqrt(np.clip(told, LEAST_TOLD, None))
    return Posterior((gain @ gain.T) * inflation, nuisance, priors, columns, pulls, rms, inflation)


def _covariance(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Inverse of rows' rows by their triangular factor, so that the condition number is never squared.

    Raises InputError where a column adds nothing to the others: share and h, which have no priors, are then one.
    """
    size = np.linalg.norm(rows, axis=0)
    factor = np.linalg.qr(rows / np.where(size > 0, size, 1.0), mode="r")
    if np.abs(np.diag(factor)).min() < SINGULAR:
        raise InputError(
            "the stretch about the parting does not tell heat partition from heat transfer coefficient",
            expected="frictional heat before the parting and some cooling after it",
            remedy="log more of the cooling, or look at load and friction before the parting",
        )
    inverse = np.linalg.solve(factor, np.eye(len(factor))) / size[:, None]
    return np.asarray(inverse @ inverse.T)


def _split(residual: NDArray[np.float64], sides: Sequence[Side]) -> list[tuple[NDArray[np.float64], Side]]:
    ends = np.cumsum([s.window.y.size for s in sides])
    return [(part, side) for part, side in zip(np.split(residual, ends[:-1]), sides)]


def _inflation(residual: NDArray[np.float64], sides: Sequence[Side]) -> float:
    """Variance ratio of slow residual waves to white noise: never below one."""
    worst = 1.0
    for part, _side_of in _split(residual, sides):
        r = part.reshape(-1, 3)
        m = max(len(r) // 25, 1)
        sums = np.add.reduceat(r, np.arange(0, len(r) - m + 1, m), axis=0)[:-1] / np.sqrt(m)
        worst = max(worst, float(np.mean(sums**2)))
    return worst


def nuisance_columns(sides: Sequence[Side]) -> list[list[tuple[int, int]]]:
    """Columns of nuisances: each a list of (side, index), shared ones joined."""
    columns: list[list[tuple[int, int]]] = []
    seen: dict[str, int] = {}
    for i, side in enumerate(sides):
        for q, what in enumerate(side.nuisance.of):
            if what.shared and what.name in seen:
                columns[seen[what.name]].append((i, q))
                continue
            if what.shared:
                seen[what.name] = len(columns)
            columns.append([(i, q)])
    return columns


def _stacked(
    test: EhlTest,
    sides: Sequence[Side],
    points: Sequence[Point],
    columns: list[list[tuple[int, int]]],
    shared_share: bool,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Whitened rows and target of the linearised posterior: data, then priors, then (for both) shares adding to one."""
    k = 4 * len(sides)
    width = k + len(columns)
    blocks, targets = [], []
    for i, (side, p) in enumerate(zip(sides, points)):
        predicted, slopes = model(test, side, p)
        w = side.window.weight
        block = np.zeros((w.size, width))
        block[:, 4 * i : 4 * i + 4] = (slopes * w).reshape(4, -1).T
        for c, members in enumerate(columns):
            for at, q in members:
                if at == i:
                    block[:, k + c] = (side.nuisance.change[q] * w).ravel()
        blocks.append(block)
        targets.append(((side.window.y - predicted) * w).ravel())
    extra, wanted = _priors(sides, points, width, k)
    if shared_share:
        row = np.zeros(width)
        row[0], row[4] = 1e4, 1e4
        extra.append(row)
        wanted.append(1e4 * (1.0 - points[0].share - points[1].share))
    return np.vstack([*blocks, np.array(extra)]), np.concatenate([*targets, np.array(wanted)])


def _priors(
    sides: Sequence[Side], points: Sequence[Point], width: int, k: int
) -> tuple[list[NDArray[np.float64]], list[float]]:
    rows, wanted = [], []
    for i, (side, p) in enumerate(zip(sides, points)):
        chain = p.chain(side.disk.mean_chain)
        lag = np.zeros(width)
        lag[4 * i + 2 : 4 * i + 4] = np.array(chain.taus_s[:2]) / side.prior_lag_u_s
        rows.append(lag)
        wanted.append((side.prior_lag_s - chain.lag_s) / side.prior_lag_u_s)
        shape = np.zeros(width)
        shape[4 * i + 3] = 1 / SHAPE_SD
        rows.append(shape)
        wanted.append((np.log(side.prior_tau2_s) - p.log_tau[1]) / SHAPE_SD)
    for c in range(width - k):
        row = np.zeros(width)
        row[k + c] = 1.0
        rows.append(row)
        wanted.append(0.0)
    return rows, wanted
