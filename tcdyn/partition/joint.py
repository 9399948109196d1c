"""Joint fit of heat partition, heat transfer coefficient and common lag to an unloading, with no inverse filter.

If all channels of a disk share one chain G, filtering the rim model by G gives
y_outer = H_boundary y_(d,b,f) + share G (H_F F u_s) + H_A T_A: the lagged boundary readings drive the model as they
are, and only the frictional power is seen through G (design, section 7). What was not measured in this test enters
as nuisances with priors, so that the answer's covariance holds them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.estimate import Estimate
from calibration.rigfile import UncertaintyTable
from tcdyn.chain import Chain
from tcdyn.conduction.bank import lag_bank
from tcdyn.conduction.rim import Profile
from tcdyn.partition.equalise import equalised
from tcdyn.partition.nuisance import Nuisances, nuisances
from tcdyn.partition.prepare import DiskTraces, EhlTest, white_noise
from tcdyn.partition.shift import FitShift
from tcdyn.partition.window import DiskWindow, chained_power, disk_window, stretch_of

SHAPE_SD = 1.5  # log of the second lag: known to a factor of four or so
LEAST_LAG_U_S = 0.02
LEAST_TOLD = 0.02  # below this the data say nothing of a nuisance, and its pull means nothing
STEPS = 25
TOLERANCE = 1e-6


@dataclass(frozen=True)
class DiskFit:
    """Share, h and common chain of one disk, with the covariance of (share, h, lag_s).

    ``pulls``: how many standard deviations the data would move each nuisance from its stated value; about standard
    normal on a sound rig.
    """

    disk: str
    share: float
    h_W_m2K: float
    chain: Chain
    covariance: NDArray[np.float64]
    rms_K: float
    window_s: float
    shift: FitShift
    pulls: dict[str, float]

    @property
    def beta(self) -> float:
        """Heat partition of the fast disk, whichever disk was fitted."""
        return self.share if self.disk == "fast" else 1.0 - self.share

    @property
    def estimates(self) -> dict[str, Estimate]:
        """beta (of the fast disk), h [W/m2K] and the common lag [s]."""
        u = np.sqrt(np.diag(self.covariance))
        return {
            "beta": Estimate.normal(self.beta, u[0]),
            "h": Estimate.normal(self.h_W_m2K, u[1]),
            "lag_s": Estimate.normal(self.chain.lag_s, u[2]),
        }


@dataclass(frozen=True)
class BothFit:
    """Both disks at once, shares adding to one; covariance of (beta, h_fast, h_slow)."""

    beta: float
    h_fast: float
    h_slow: float
    speed_ratio: float
    covariance: NDArray[np.float64]
    chains: dict[str, Chain]
    pulls: dict[str, float]

    @property
    def estimates(self) -> dict[str, Estimate]:
        """beta, both h [W/m2K], and the exponent ln(h_fast/h_slow)/ln(u_f/u_s) that they imply."""
        u = np.sqrt(np.diag(self.covariance))
        log_ratio = np.log(self.speed_ratio)
        slope = np.array([0.0, 1 / self.h_fast, -1 / self.h_slow]) / log_ratio
        exponent = float(np.log(self.h_fast / self.h_slow) / log_ratio)
        return {
            "beta": Estimate.normal(self.beta, u[0]),
            "h_fast": Estimate.normal(self.h_fast, u[1]),
            "h_slow": Estimate.normal(self.h_slow, u[2]),
            "exponent": Estimate.normal(exponent, float(np.sqrt(slope @ self.covariance @ slope))),
        }


@dataclass(frozen=True)
class _Side:
    """One disk inside the solver: its window at the current chain, its prior and its nuisances."""

    disk: DiskTraces
    window: DiskWindow
    readings: NDArray[np.float64]
    rows: slice
    prior_lag_s: float
    prior_lag_u_s: float
    prior_tau2_s: float
    nuisance: Nuisances


@dataclass(frozen=True)
class _Point:
    """share, log h, log tau1, log tau2 of one disk."""

    share: float
    log_h: float
    log_tau: tuple[float, float]

    @property
    def h(self) -> float:
        return float(np.exp(self.log_h))

    def moved(self, step: NDArray[np.float64]) -> _Point:
        tau = (self.log_tau[0] + float(step[2]), self.log_tau[1] + float(step[3]))
        return _Point(self.share + float(step[0]), self.log_h + float(step[1]), tau)

    def chain(self, like: Chain) -> Chain:
        return replace(like, taus_s=(float(np.exp(self.log_tau[0])), float(np.exp(self.log_tau[1]))))


@dataclass(frozen=True)
class _Posterior:
    """Of the main parameters (4 a disk): covariance from noise, answer to each nuisance and each prior of one sd."""

    noise: NDArray[np.float64]
    nuisance: NDArray[np.float64]
    priors: NDArray[np.float64]
    columns: list[list[tuple[int, int]]]
    pulls: NDArray[np.float64]
    rms_K: float

    def named_pulls(self, sides: Sequence[_Side]) -> dict[str, float]:
        """Pull of each nuisance by its name, with its disk unless both disks share it."""
        out = {}
        for value, members in zip(self.pulls, self.columns):
            side, q = sides[members[0][0]], members[0][1]
            name = side.nuisance.names[q]
            out[name if side.nuisance.shared[q] else f"{name} of the {side.disk.name} disk"] = float(value)
        return out

    @property
    def covariance(self) -> NDArray[np.float64]:
        """All sources together."""
        return np.asarray(self.noise + self.nuisance @ self.nuisance.T + self.priors @ self.priors.T)


def joint_fits(
    test: EhlTest,
    start: dict[str, tuple[float, float]],
    u: UncertaintyTable,
    window_s: float = 10.0,
    profile: Profile = "modal",
) -> tuple[dict[str, DiskFit], BothFit]:
    """Fit each disk alone, then both with shares that add to one.

    ``start``: share and h [W/m2K] of each disk to begin from, e.g. the speed law's. ``window_s``: length of cooling
    used. Raises InputError when the log ends before the window.
    """
    sides, points, fits = {}, {}, {}
    for name, disk in test.disks.items():
        side, point = _begin(test, disk, *start[name], u, window_s, profile)
        for _ in range(2):  # the second pass equalises with the chain that the first one found
            (point,), _post = _solve(test, [side], [point], shared_share=False)
            side = _refresh(test, side, point, u, window_s, profile)
        (point,), post = _solve(test, [side], [point], shared_share=False)
        sides[name], points[name] = side, point
        fits[name] = _disk_fit(name, point, side, post, window_s)
    both = _solve_both(test, sides, points)
    return fits, both


def _begin(
    test: EhlTest, disk: DiskTraces, share: float, h: float, u: UncertaintyTable, window_s: float, profile: Profile
) -> tuple[_Side, _Point]:
    chain = disk.mean_chain
    taus = sorted(chain.taus_s, reverse=True)
    tau1 = max(taus[0], 0.02)
    tau2 = max(taus[1] if len(taus) > 1 else 0.0, 0.1 * tau1)
    lag_u = max(disk.common_lag_u_s, LEAST_LAG_U_S)
    point = _Point(share, float(np.log(max(h, 20.0))), (float(np.log(tau1)), float(np.log(tau2))))
    side = _side(test, disk, point, u, window_s, profile, (disk.common_lag_s, lag_u, tau2))
    return side, point


def _refresh(
    test: EhlTest, side: _Side, point: _Point, u: UncertaintyTable, window_s: float, profile: Profile
) -> _Side:
    prior = (side.prior_lag_s, side.prior_lag_u_s, side.prior_tau2_s)
    return _side(test, side.disk, point, u, window_s, profile, prior)


def _side(
    test: EhlTest,
    disk: DiskTraces,
    point: _Point,
    u: UncertaintyTable,
    window_s: float,
    profile: Profile,
    prior: tuple[float, float, float],
) -> _Side:
    rows = stretch_of(test, window_s)
    common = point.chain(disk.mean_chain)
    shift = common.lag_s - disk.mean_chain.lag_s
    chains = tuple(c.with_lag_shift(shift) for c in disk.chains)
    readings = equalised(disk.readings_degC[rows], test.dt_s, chains, disk.mean_chain.with_lag_shift(shift))
    noise = np.maximum(white_noise(readings), 0.5 * disk.noise_K)
    window = disk_window(test, disk, readings, rows, noise, profile)
    power = chained_power(test, rows, common)
    seen = window.with_power(power, lag_bank(power, test.dt_s, window.rates_1_s))
    nuis = nuisances(seen, disk, readings, test.dt_s, point.share, point.h, u, test.events.unload_u_s)
    return _Side(disk, window, readings, rows, *prior, nuis)


def _powered(test: EhlTest, side: _Side, point: _Point) -> DiskWindow:
    power = chained_power(test, side.rows, point.chain(side.disk.mean_chain))
    return side.window.with_power(power, lag_bank(power, test.dt_s, side.window.rates_1_s))


def _model(test: EhlTest, side: _Side, p: _Point) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Prediction (R, 3) and its derivatives by (share, log h, log tau1, log tau2), (4, R, 3)."""
    window = _powered(test, side, p)
    rest, power = window.answer(window.gains(p.h))
    step = 0.02
    up_rest, up_power = window.answer(window.gains(p.h * float(np.exp(step))))
    slopes = [power, (up_rest - rest + p.share * (up_power - power)) / step]
    gains = window.gains(p.h)
    for k in range(2):
        moved = list(p.log_tau)
        moved[k] += step
        other = _powered(test, side, replace(p, log_tau=(moved[0], moved[1])))
        slopes.append(p.share * (other.answer(gains)[1] - power) / step)
    return rest + p.share * power, np.stack(slopes)


def _solve(
    test: EhlTest, sides: Sequence[_Side], points: Sequence[_Point], shared_share: bool
) -> tuple[list[_Point], _Posterior]:
    """Gauss-Newton on the posterior: the best points and what is known about them."""
    points = list(points)
    columns = _nuisance_columns(sides)
    last = np.inf
    for _ in range(STEPS):
        rows, target = _stacked(test, sides, points, columns, shared_share)
        step = np.linalg.lstsq(rows, target, rcond=None)[0][: 4 * len(sides)].reshape(-1, 4)
        scale = min(1.0, 0.7 / max(float(np.abs(step[:, 1:]).max()), 1e-12))
        points = [p.moved(np.asarray(scale * s)) for p, s in zip(points, step)]
        size = float(np.abs(step[:, :3]).max())
        if size < TOLERANCE or (size < 1e-4 and size >= last):
            break
        last = size
    rows, target = _stacked(test, sides, points, columns, shared_share)
    covariance = np.linalg.inv(rows.T @ rows)
    solution = covariance @ (rows.T @ target)
    told = 1.0 - np.diag(covariance)[4 * len(sides) :]  # share of each nuisance's prior variance that the data removed
    data = sum(s.window.y.size for s in sides)
    residual = (target - rows @ solution)[:data]
    k = 4 * len(sides)
    gain = covariance[:k] @ rows[:data].T
    noise = (gain @ gain.T) * _inflation(residual, sides)
    nuisance = gain @ rows[:data, k:]
    priors = covariance[:k] @ rows[data : data + 2 * len(sides)].T
    rms = float(np.sqrt(np.mean([np.mean((r / s.window.weight.ravel()) ** 2) for r, s in _split(residual, sides)])))
    pulls = solution[k:] / np.sqrt(np.clip(told, LEAST_TOLD, None))
    return points, _Posterior(noise, nuisance, priors, columns, pulls, rms)


def _split(residual: NDArray[np.float64], sides: Sequence[_Side]) -> list[tuple[NDArray[np.float64], _Side]]:
    ends = np.cumsum([s.window.y.size for s in sides])
    return [(part, side) for part, side in zip(np.split(residual, ends[:-1]), sides)]


def _inflation(residual: NDArray[np.float64], sides: Sequence[_Side]) -> float:
    """Variance ratio of slow residual waves to white noise: never below one."""
    worst = 1.0
    for part, _side_of in _split(residual, sides):
        r = part.reshape(-1, 3)
        m = max(len(r) // 25, 1)
        sums = np.add.reduceat(r, np.arange(0, len(r) - m + 1, m), axis=0)[:-1] / np.sqrt(m)
        worst = max(worst, float(np.mean(sums**2)))
    return worst


def _nuisance_columns(sides: Sequence[_Side]) -> list[list[tuple[int, int]]]:
    """Columns of nuisances: each a list of (side, index), shared ones joined."""
    columns: list[list[tuple[int, int]]] = []
    seen: dict[str, int] = {}
    for i, side in enumerate(sides):
        for q, (name, shared) in enumerate(zip(side.nuisance.names, side.nuisance.shared)):
            if shared and name in seen:
                columns[seen[name]].append((i, q))
                continue
            if shared:
                seen[name] = len(columns)
            columns.append([(i, q)])
    return columns


def _stacked(
    test: EhlTest,
    sides: Sequence[_Side],
    points: Sequence[_Point],
    columns: list[list[tuple[int, int]]],
    shared_share: bool,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Whitened rows and target of the linearised posterior: data, then priors, then (for both) shares adding to one."""
    k = 4 * len(sides)
    width = k + len(columns)
    blocks, targets = [], []
    for i, (side, p) in enumerate(zip(sides, points)):
        predicted, slopes = _model(test, side, p)
        w = side.window.weight
        block = np.zeros((w.size, width))
        block[:, 4 * i : 4 * i + 4] = (slopes * w).reshape(4, -1).T
        for c, members in enumerate(columns):
            for at, q in members:
                if at == i:
                    block[:, k + c] = side.nuisance.sd[q] * (side.nuisance.effect[q] * w).ravel()
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
    sides: Sequence[_Side], points: Sequence[_Point], width: int, k: int
) -> tuple[list[NDArray[np.float64]], list[float]]:
    rows, wanted = [], []
    for i, (side, p) in enumerate(zip(sides, points)):
        chain = p.chain(side.disk.mean_chain)
        lag = np.zeros(width)
        lag[4 * i + 2 : 4 * i + 4] = np.array(chain.taus_s) / side.prior_lag_u_s
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


def _disk_fit(name: str, p: _Point, side: _Side, post: _Posterior, window_s: float) -> DiskFit:
    chain = p.chain(side.disk.mean_chain)
    jac = np.zeros((3, 4))
    jac[0, 0], jac[1, 1] = 1.0, p.h
    jac[2, 2:] = chain.taus_s
    names = (*side.nuisance.names, "common lag", "lag shape")
    per_sd = (jac @ np.concatenate([post.nuisance, post.priors], axis=1)).T
    shift = FitShift(names, (*side.nuisance.shared, False, False), per_sd, jac @ post.noise @ jac.T)
    covariance = jac @ post.covariance @ jac.T
    return DiskFit(name, p.share, p.h, chain, covariance, post.rms_K, window_s, shift, post.named_pulls([side]))


def _solve_both(test: EhlTest, sides: dict[str, _Side], points: dict[str, _Point]) -> BothFit:
    order = [sides["fast"], sides["slow"]]
    final, post = _solve(test, order, [points["fast"], points["slow"]], shared_share=True)
    jac = np.zeros((3, 8))
    jac[0, 0], jac[1, 1], jac[2, 5] = 1.0, final[0].h, final[1].h
    chains = {name: p.chain(sides[name].disk.mean_chain) for name, p in zip(("fast", "slow"), final)}
    return BothFit(
        final[0].share,
        final[0].h,
        final[1].h,
        test.speed_ratio,
        jac @ post.covariance @ jac.T,
        chains,
        post.named_pulls(order),
    )
