"""Joint fit of heat partition, heat transfer coefficient and common lag to an unloading, with no inverse filter.

If all channels of a disk share one chain G, filtering the rim model by G gives
y_outer = H_boundary y_(d,b,f) + share G (H_F F u_s) + H_A T_A: the lagged boundary readings drive the model as they
are, and only the frictional power is seen through G (design, section 7). What was not measured in this test enters
with its prior, so that the answer's covariance holds it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from calibration import Array
from calibration.disk import DISKS
from calibration.errors import InputError
from calibration.estimate import Estimate
from tcdyn.chain import Chain
from tcdyn.conduction.rim import Profile
from tcdyn.fitting import Optimum, from_rows, minimise, wave_factor
from tcdyn.partition.effects import FitShift, Unmeasured
from tcdyn.partition.posterior import (
    LOG_H,
    LOG_LAGS,
    LOG_TAU2,
    SHAPE_SD,
    SHARE,
    Side,
    disk_side,
    joint_problem,
    lags,
    unknowns,
    with_lags,
)
from tcdyn.partition.prepare import EhlTest
from tcdyn.partition.steady import steady_lines
from tcdyn.partition.window import stretch_of
from tcdyn.traces import DiskTraces

SINGULAR = 1e-10  # least part of a column, of its length, that the others leave
ENOUGH, ROUGHLY = 1e-7, 1e-3  # of chi-squared
JOINT_WINDOW_S = 10.0


@dataclass(frozen=True)
class DiskFit:
    """Share, h and common chain of one disk, with the covariance of (share, h, lag_s).

    ``pulls``: how many standard deviations the data would move what nobody measured from its stated value; about
    standard normal on a sound rig. ``inflation``: variance ratio of slow residual waves to white noise that the
    covariance allows for; ``side`` and ``theta`` (4,): what was fitted, and where it ended.
    """

    disk: str
    theta: Array
    chain: Chain
    covariance: Array
    shift: FitShift
    pulls: tuple[Pull, ...]
    inflation: float
    side: Side = field(repr=False, compare=False)

    @property
    def share(self) -> float:
        """Of the frictional heat, into this disk."""
        return float(self.theta[SHARE])

    @property
    def h_W_m2K(self) -> float:
        """Heat transfer coefficient [W/m2K]."""
        return float(np.exp(self.theta[LOG_H]))

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
    """Both disks at once, shares adding to one; covariance of (beta, h_fast, h_slow); ``theta`` (8,)."""

    theta: Array
    speed_ratio: float
    covariance: Array
    pulls: tuple[Pull, ...]
    inflation: float

    @property
    def beta(self) -> float:
        """Heat partition of the fast disk."""
        return float(self.theta[SHARE])

    @property
    def h_fast(self) -> float:
        """Of the fast disk [W/m2K]."""
        return float(np.exp(self.theta[LOG_H]))

    @property
    def h_slow(self) -> float:
        """Of the slow disk [W/m2K]."""
        return float(np.exp(self.theta[4 + LOG_H]))

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
class Pull:
    """By how many standard deviations ``z`` the data would move ``what``, of one ``disk`` or, if empty, of both."""

    what: Unmeasured
    disk: str
    z: float


@dataclass(frozen=True)
class Told:
    """What a joint fit tells of its main parameters (4 a disk): covariance by white noise, and ``covariance`` in all.

    ``noise``: by the data's noise, waves included; ``per_sd`` (P, Q): answer to each unmeasured quantity, then to
    the prior of each disk's lag and of its shape, of one standard uncertainty.
    """

    noise: Array
    per_sd: Array

    @property
    def covariance(self) -> Array:
        """All sources together."""
        return np.asarray(self.noise + self.per_sd @ self.per_sd.T)


def told(optimum: Optimum, sides: Sequence[Side], inflation: float) -> Told:
    """Covariance of the main parameters by source, that of noise ``inflation`` times what white noise makes.

    Raises InputError where a column adds nothing to the others: share and h, which have no priors, are then one.
    """
    k, data = 4 * len(sides), len(optimum.residual) - len(sides)
    precise, free = np.sqrt(optimum.problem.precision), optimum.directions
    inner, left = from_rows(np.vstack([optimum.jacobian, np.diag(precise)[precise > 0]]) @ free)
    if left < SINGULAR:
        raise InputError(
            "the stretch about the parting does not tell heat partition from heat transfer coefficient",
            expected="frictional heat before the parting and some cooling after it",
            remedy="log more of the cooling, or look at load and friction before the parting",
        )
    covariance = free @ inner @ free.T
    gain = covariance[:k] @ optimum.jacobian.T
    shape = covariance[:k, LOG_TAU2:k:4] / SHAPE_SD
    per_sd = np.hstack([-covariance[:k, k:], gain[:, data:], shape])
    return Told(inflation * gain[:, :data] @ gain[:, :data].T, per_sd)


def waves(optimum: Optimum, sides: Sequence[Side]) -> float:
    """Variance ratio of slow waves in the residuals of the worse disk to white noise."""
    ends = np.cumsum([s.window.y.size for s in sides])
    return max(wave_factor(r.reshape(-1, 3)) for r in np.split(optimum.residual[: ends[-1]], ends[:-1]))


def pulls(optimum: Optimum, sides: Sequence[Side]) -> tuple[Pull, ...]:
    """Pull of everything that nobody measured."""
    z = list(optimum.pulls.values())[-len(unknowns(sides)) :]
    return tuple(Pull(what, disk, value) for (what, disk), value in zip(unknowns(sides), z, strict=True))


def joint_fits(
    test: EhlTest,
    start: Mapping[str, tuple[float, float]],
    window_s: float = JOINT_WINDOW_S,
    profile: Profile = "modal",
) -> tuple[dict[str, DiskFit], BothFit]:
    """Fit each disk alone, then both with shares that add to one.

    ``start``: share and h [W/m2K] of each disk to begin from, e.g. the speed law's. ``window_s``: length of cooling
    used. Raises InputError when the log ends before the window.
    """
    fits = {d: _disk_fit(test, test.disks[d], *start[d], window_s, profile) for d in DISKS}
    sides = [fits[d].side for d in DISKS]
    problem = joint_problem(sides, sides)
    theta = np.zeros(problem.size)
    theta[:8] = np.concatenate([fits[d].theta for d in DISKS])
    theta[SHARE:8:4] += 0.5 * (1.0 - theta[SHARE:8:4].sum())
    best = minimise(problem, theta, tolerance=ENOUGH)
    inflation = waves(best, sides)
    known = told(best, sides, inflation)
    h = np.exp(best.theta[[LOG_H, 4 + LOG_H]])
    jac = np.zeros((3, 8))
    jac[0, SHARE], jac[1, LOG_H], jac[2, 4 + LOG_H] = 1.0, *h
    covariance = jac @ known.covariance @ jac.T
    return fits, BothFit(best.theta[:8], test.speed_ratio, covariance, pulls(best, sides), inflation)


def _disk_fit(test: EhlTest, disk: DiskTraces, share: float, h: float, window_s: float, profile: Profile) -> DiskFit:
    taus = sorted(disk.mean_chain.taus_s, reverse=True)
    tau1 = max(taus[0], 0.02)
    tau2 = max(taus[1] if len(taus) > 1 else 0.0, 0.1 * tau1)
    theta = np.array([share, np.log(max(h, 20.0)), np.log(tau1 + tau2), np.log(tau2)])
    for enough in ROUGHLY, ROUGHLY, ENOUGH:  # each pass equalises with the chain that the one before found
        side = disk_side(test, disk, theta, window_s, profile, tau2)
        problem = joint_problem([side], [side])
        theta = np.concatenate([theta, np.zeros(problem.size - len(theta))])
        best = minimise(problem, theta, tolerance=enough)
        theta = best.theta
    inflation = waves(best, [side])
    known = told(best, [side], inflation)
    jac = np.zeros((3, 4))
    jac[0, SHARE], jac[1, LOG_H], jac[2, LOG_LAGS] = 1.0, np.exp(theta[LOG_H]), np.exp(theta[LOG_LAGS])
    of = (*side.unmeasured.of, Unmeasured("common lag", "chain"), Unmeasured("lag shape", "chain"))
    shift = FitShift(of, (jac @ known.per_sd).T, jac @ known.noise @ jac.T)
    return DiskFit(
        disk=disk.name,
        theta=theta[:4],
        chain=with_lags(disk.mean_chain, lags(theta)),
        covariance=jac @ known.covariance @ jac.T,
        shift=shift,
        pulls=pulls(best, [side]),
        inflation=inflation,
        side=side,
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
