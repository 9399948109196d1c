"""Joint fit of heat partition, heat transfer coefficient and common lag to an unloading, with no inverse filter.

If all channels of a disk share one chain G, filtering the rim model by G gives
y_outer = H_boundary y_(d,b,f) + share G (H_F F u_s) + H_A T_A: the lagged boundary readings drive the model as they
are, and only the frictional power is seen through G (design, section 7). What was not measured in this test enters
as nuisances with priors, so that the answer's covariance holds them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from calibration.estimate import Estimate
from tcdyn.chain import Chain
from tcdyn.conduction.rim import Profile
from tcdyn.partition.effects import FitShift, Unmeasured
from tcdyn.partition.joint_solve import LEAST_LAG_U_S as LEAST_LAG_U_S
from tcdyn.partition.joint_solve import Point, Posterior, Side, begin, refresh, solve
from tcdyn.partition.prepare import EhlTest
from tcdyn.partition.steady import steady_lines
from tcdyn.partition.window import stretch_of

JOINT_WINDOW_S = 10.0


@dataclass(frozen=True)
class DiskFit:
    """Share, h and common chain of one disk, with the covariance of (share, h, lag_s).

    ``pulls``: how many standard deviations the data would move each nuisance from its stated value; about standard
    normal on a sound rig. ``inflation``: variance ratio of slow residual waves to white noise that the
    covariance allows for; ``side``: the data and priors as the fit saw them.
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
    inflation: float
    side: Side = field(repr=False, compare=False)

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
    inflation: float

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


def joint_fits(
    test: EhlTest,
    start: Mapping[str, tuple[float, float]],
    window_s: float = 10.0,
    profile: Profile = "modal",
) -> tuple[dict[str, DiskFit], BothFit]:
    """Fit each disk alone, then both with shares that add to one.

    ``start``: share and h [W/m2K] of each disk to begin from, e.g. the speed law's. ``window_s``: length of cooling
    used. Raises InputError when the log ends before the window.
    """
    sides, points, fits = {}, {}, {}
    for name, disk in test.disks.items():
        side, point = begin(test, disk, *start[name], window_s, profile)
        for _ in range(2):  # the second pass equalises with the chain that the first one found
            (point,), _ = solve(test, [side], [point], shared_share=False)
            side = refresh(test, side, point, window_s, profile)
        (point,), post = solve(test, [side], [point], shared_share=False)
        sides[name], points[name] = side, point
        fits[name] = _disk_fit(name, point, side, post, window_s)
    both = _solve_both(test, sides, points)
    return fits, both


def _disk_fit(name: str, p: Point, side: Side, post: Posterior, window_s: float) -> DiskFit:
    chain = p.chain(side.disk.mean_chain)
    jac = np.zeros((3, 4))
    jac[0, 0], jac[1, 1] = 1.0, p.h
    jac[2, 2:] = chain.taus_s[:2]
    of = (*side.nuisance.of, Unmeasured("common lag", "chain"), Unmeasured("lag shape", "chain"))
    per_sd = (jac @ np.concatenate([post.nuisance, post.priors], axis=1)).T
    shift = FitShift(of, per_sd, jac @ post.noise @ jac.T)
    covariance = jac @ post.covariance @ jac.T
    pulls = post.named_pulls([side])
    return DiskFit(
        name, p.share, p.h, chain, covariance, post.rms_K, window_s, shift, pulls, post.inflation, side
    )  # fmt: skip


def _solve_both(test: EhlTest, sides: dict[str, Side], points: dict[str, Point]) -> BothFit:
    order = [sides["fast"], sides["slow"]]
    final, post = solve(test, order, [points["fast"], points["slow"]], shared_share=True)
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
        post.inflation,
    )


def joint_length_s(test: EhlTest) -> float:
    """Cooling that the joint fits use [s]: ten seconds, or what the log holds."""
    return float(min(JOINT_WINDOW_S, test.time_s[-1] - test.events.unload_s))


def refine_lags(test: EhlTest) -> Mapping[str, DiskFit]:
    """Joint fits of both disks, for their chains."""
    length = joint_length_s(test)
    _, speed = steady_lines(test, stretch_of(test, length))
    return joint_fits(test, speed.starts, length)[0]


def refined_chains(chains: Sequence[Chain], common: Chain) -> tuple[Chain, ...]:
    """``common`` for every channel, its largest lag shifted by the channel's difference from the mean of ``chains``."""
    mean = float(np.mean([c.lag_s for c in chains]))
    taus = sorted(common.taus_s, reverse=True)
    return tuple(replace(common, taus_s=(max(taus[0] + c.lag_s - mean, 1e-3), *taus[1:])) for c in chains)
