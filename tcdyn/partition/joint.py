"""Joint fit of heat partition, heat transfer coefficient and common lag to an unloading, with no inverse filter.

If all channels of a disk share one chain G, filtering the rim model by G gives
y_outer = H_boundary y_(d,b,f) + share G (H_F F u_s) + H_A T_A: the lagged boundary readings drive the model as they
are, and only the frictional power is seen through G (design, section 7). What was not measured in this test enters
with its prior, so that the answer's covariance holds it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from tcdyn.chain import Chain, equalised
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.estimation import Optimum, Problem, from_rows, minimise, wave_factor
from tcdyn.estimation.trace_noise import white_noise_sd
from tcdyn.heat.rim import Profile, bank_means
from tcdyn.partition.angular_harmonic import HARMONIC_SOURCES, Unevenness, Unmeasured, harmonic_from_fit
from tcdyn.partition.events import EhlTest
from tcdyn.partition.nuisance import (
    LOG_H,
    LOG_LAGS,
    LOG_TAU2,
    PARAMETERS,
    SHARE,
    LaggedRim,
    nuisance_effects,
    harmonic_prior,
    lags,
    with_lags,
)
from tcdyn.partition.steady import FitSensitivity
from tcdyn.partition.surface_flux import SURFACE_SLOPE, log_h_prior
from tcdyn.partition.window import DiskWindow, RimMeans, disk_window, lagged_power, stretch_of
from tcdyn.rig.disk import DISKS
from tcdyn.smoothing.traces import NOISE_ORDER, DiskTraces

MAX_STEP = (np.inf, 0.7, 0.7, 0.7)  # of one step of a search
SHAPE_SD = 1.5  # log of the second lag: known to a factor of four or so
MIN_LAG_U_S = 0.02
MIN_INDEPENDENT_PART = 1e-10  # least part of a column, of its length, that the others leave
# of chi-squared
TOLERANCE = 1e-7
COARSE_TOLERANCE = 1e-3
CONVERGED_U = 0.1  # standard deviations that a pass moves a disk's fit: the next moved 36 such by 0.008 of one at most
StartPoints = Mapping[
    str, tuple[float, float]
]  # share and h [W/m2K] of disks to begin from, e.g. the speed law's
JOINT_WINDOW_S = 10.0


@dataclass(frozen=True)
class Side:
    """One disk in a joint fit, in standard deviations of its noise.

    ``y`` (m,): what was seen; ``effect`` (m, Q): what one standard uncertainty of each of ``of`` makes of it;
    ``model``: prediction (m,) and its derivatives (m, 4) by ``PARAMETERS``, None where there is none; ``prior_*``: what
    was known of its lags, and of log h; ``rest_of_lag_s``: of the chain beyond tau1 + tau2. The model is that
    of ``window``, with ``heated``, its rim with the power seen through given lags.
    """

    disk: str
    of: tuple[Unmeasured, ...]
    y: Array
    effect: Array
    model: Callable[[Array], tuple[Array, Array] | None]
    prior_lag_s: float
    prior_lag_u_s: float
    prior_tau2_s: float
    rest_of_lag_s: float
    prior_log_h: tuple[float, float]
    window: DiskWindow
    heated: Callable[[tuple[float, ...]], RimMeans]


@dataclass(frozen=True)
class DiskFit:
    """Share, h [W/m2K] and common chain of one disk; beta (of the fast disk), h and lag_s in ``estimates``.

    ``inflation``: variance ratio of slow residual waves to white noise that the uncertainties allow for; ``side`` and
    ``theta`` (4,): what was fitted, and where it ended.
    """

    disk: str
    theta: Array
    share: float
    beta: float
    h_W_m2K: float
    estimates: Mapping[str, Estimate]
    chain: Chain
    shift: FitSensitivity
    inflation: float
    side: Side = field(repr=False, compare=False)


@dataclass(frozen=True)
class BothFit:
    """Both disks at once, shares adding to one; ``theta`` (8,).

    ``estimates``: beta, h_fast and h_slow [W/m2K], and the exponent ln(h_fast/h_slow)/ln(u_f/u_s) that they imply.
    ``pulls``: what nobody measured, of which disk ("" of both), and how many standard deviations the data would move it
    from its stated value; about standard normal on a sound rig. ``uneven``: each disk round its bore.
    """

    theta: Array
    speed_ratio: float
    estimates: Mapping[str, Estimate]
    pulls: tuple[tuple[Unmeasured, str, float], ...]
    inflation: float
    uneven: Mapping[str, Unevenness] = field(repr=False, compare=False)
    optimum: Optimum = field(repr=False, compare=False)


def disk_side(
    test: EhlTest, disk: DiskTraces, theta: Array, window_s: float, profile: Profile, tau2_s: float
) -> Side:
    """The disk's readings brought to the chain of ``theta``, and what nobody measured about that point."""
    rows = stretch_of(test, window_s)
    like = disk.mean_chain
    common = with_lags(like, lags(theta))
    shift = common.lag_s - like.lag_s
    chains = tuple(c.with_lag_shift(shift) for c in disk.chains)
    readings = equalised(disk.readings_degC[rows], test.dt_s, chains, like.with_lag_shift(shift))
    seen = (
        0.0 if disk.noise.coloured else white_noise_sd(readings, NOISE_ORDER)
    )  # differences see what no fit sees
    noise = np.maximum(seen, (1.0 if disk.noise.coloured else 0.5) * disk.noise_K)
    window = disk_window(test, disk, readings, rows, noise, profile, common)
    known = nuisance_effects(test, disk, window, float(theta[SHARE]), float(np.exp(theta[LOG_H])))
    longest = max(lags(theta))
    power, _ = lagged_power(test, rows, with_lags(like, (longest,)))
    bank = bank_means(power, test.dt_s, window.rim.rates_1_s, window.counts)
    model = LaggedRim(window.rim.driven_by(window.blocks @ power, bank), longest, window.weight)
    return Side(
        disk=disk.name,
        of=known.of,
        y=(window.y * window.weight).ravel(),
        effect=(known.change * window.weight).reshape(len(known.of), -1).T,
        model=model,
        prior_lag_s=disk.common_lag_s,
        prior_lag_u_s=max(disk.common_lag_u_s, MIN_LAG_U_S),
        prior_tau2_s=tau2_s,
        rest_of_lag_s=like.lag_s - sum(sorted(like.taus_s, reverse=True)[:2]),
        prior_log_h=log_h_prior(disk.setup.surface),
        window=window,
        heated=model.heated,
    )


def unknowns(sides: Sequence[Side]) -> list[tuple[Unmeasured, str]]:
    """What nobody measured, each with its disk, or "" where both have it in common; in the order of the parameters."""
    every = [(what, "" if what.shared else side.disk) for side in sides for what in side.of]
    return list(dict.fromkeys(every))


def joint_problem(sides: Sequence[Side]) -> Problem:
    """The posterior of one disk, or of both with shares that add to what they add to at the start.

    Parameters are four a disk and then, in standard uncertainties, what nobody measured; what the disks share is one.
    """
    k, ends = 4 * len(sides), np.cumsum([0, *(len(s.y) for s in sides)])
    unknown = unknowns(sides)
    effect = np.zeros((ends[-1], len(unknown)))
    for i, s in enumerate(sides):
        columns = [unknown.index((what, "" if what.shared else s.disk)) for what in s.of]
        effect[ends[i] : ends[i + 1], columns] = s.effect

    def evaluate(theta: Array) -> tuple[Array, Array] | None:
        residual = np.zeros(ends[-1] + len(sides))
        jacobian = np.zeros((len(residual), len(theta)))
        residual[: ends[-1]] = effect @ theta[k:]
        jacobian[: ends[-1], k:] = effect
        for i, s in enumerate(sides):
            p = theta[4 * i : 4 * i + 4]
            own = slice(ends[i], ends[i + 1])
            answer = s.model(p)
            if answer is None:
                return None
            residual[own] += answer[0] - s.y
            jacobian[own, 4 * i : 4 * i + 4] = answer[1]
            total = float(np.exp(p[LOG_LAGS]))  # the record's lag, the last rows
            residual[ends[-1] + i] = (total + s.rest_of_lag_s - s.prior_lag_s) / s.prior_lag_u_s
            jacobian[ends[-1] + i, 4 * i + LOG_LAGS] = total / s.prior_lag_u_s
        return residual, jacobian

    names = [f"{name}, {s.disk} disk" for s in sides for name in PARAMETERS]
    names += [f"{what.name} {disk}".strip() for what, disk in unknown]
    mean = np.zeros(len(names))
    sd = np.where(np.arange(len(names)) < k, np.inf, 1.0)
    mean[LOG_TAU2:k:4] = [np.log(s.prior_tau2_s) for s in sides]
    sd[LOG_TAU2:k:4] = SHAPE_SD
    mean[LOG_H:k:4], sd[LOG_H:k:4] = zip(*(s.prior_log_h for s in sides))
    largest = np.append(MAX_STEP * len(sides), np.full(len(unknown), np.inf))
    fixed = np.zeros((len(sides) - 1, len(names)))
    fixed[:, SHARE:k:4] = 1.0
    return Problem(tuple(names), evaluate, mean, sd, largest=largest, fixed=fixed)


def told(optimum: Optimum, sides: Sequence[Side]) -> tuple[Array, Array]:
    """Covariance (P, P) of the main parameters, 4 a disk, by white noise, and their answer to all else, (P, Q).

    By a standard uncertainty of each unmeasured quantity, then of each disk's lag, of its shape, and of h where known.
    Raises InputError where a column adds nothing to the others: share and h, without priors, are then one.
    """
    k = 4 * len(sides)
    data = len(optimum.residual) - len(sides)
    precise = np.sqrt(optimum.problem.precision)
    free = optimum.directions
    inner, left = from_rows(np.vstack([optimum.jacobian, np.diag(precise)[precise > 0]]) @ free)
    if left < MIN_INDEPENDENT_PART:
        raise InputError(
            "the stretch about the parting does not tell heat partition from heat transfer coefficient",
            expected="frictional heat before the parting and some cooling after it",
            remedy="log more of the cooling, or look at load and friction before the parting",
        )
    covariance = free @ inner @ free.T
    gain = covariance[:k] @ optimum.jacobian.T
    shape = covariance[:k, LOG_TAU2:k:4] / SHAPE_SD
    sd = np.array([s.prior_log_h[1] for s in sides])
    film = (covariance[:k, LOG_H:k:4] / sd)[:, np.isfinite(sd)]
    return gain[:, :data] @ gain[:, :data].T, np.hstack(
        [-covariance[:k, k:], gain[:, data:], shape, film]
    )


def _known(
    best: Optimum, sides: Sequence[Side], index: list[int], scale: Array
) -> tuple[float, Array, Array]:
    """Inflation by slow waves in the residuals of the worse disk; covariance by noise (k, k) and answers to all else
    (k, Q) of numbers that change by ``scale`` (k,) with the parameters of ``index``."""
    noise, per_sd = told(best, sides)
    parts = np.split(best.residual[: -len(sides)], np.cumsum([len(s.y) for s in sides])[:-1])
    inflation = max(wave_factor(r.reshape(s.window.y.shape)) for s, r in zip(sides, parts))
    return (
        inflation,
        inflation * noise[np.ix_(index, index)] * np.outer(scale, scale),
        scale[:, None] * per_sd[index],
    )


def joint_fits(
    test: EhlTest, start: StartPoints, window_s: float = JOINT_WINDOW_S, profile: Profile = "modal"
) -> tuple[dict[str, DiskFit], BothFit]:
    """Fit each disk alone, then both with shares that add to one; ``window_s``: length of cooling used.

    Raises InputError when the log ends before the window.
    """
    fits = {d: disk_fit(test, test.disks[d], *start[d], window_s, profile) for d in DISKS}
    sides = [fits[d].side for d in DISKS]
    problem = joint_problem(sides)
    theta = np.zeros(len(problem.names))
    theta[:8] = np.concatenate([fits[d].theta for d in DISKS])
    theta[SHARE:8:4] += 0.5 * (1.0 - theta[SHARE:8:4].sum())
    best = minimise(problem, theta, tolerance=TOLERANCE)
    at = best.theta[[SHARE, LOG_H, 4 + LOG_H]]
    beta, h_fast, h_slow = at[0], *np.exp(at[1:])
    inflation, noise, per_sd = _known(
        best, sides, [SHARE, LOG_H, 4 + LOG_H], np.array([1.0, h_fast, h_slow])
    )
    covariance = noise + per_sd @ per_sd.T
    log_ratio = np.log(test.speed_ratio)
    slope = np.array([0.0, 1 / h_fast, -1 / h_slow]) / log_ratio
    values = {
        "beta": beta,
        "h_fast": h_fast,
        "h_slow": h_slow,
        "exponent": np.log(h_fast / h_slow) / log_ratio,
    }
    u = np.sqrt([*np.diag(covariance), slope @ covariance @ slope])
    estimates = {
        name: Estimate.normal(float(x), float(s)) for (name, x), s in zip(values.items(), u)
    }
    unknown = unknowns(sides)
    pulls = tuple(
        (*u, z)
        for u, z in zip(unknown, [*best.pulls.values()][-len(unknown) :])
        if u[0].source not in HARMONIC_SOURCES
    )
    left = best.theta[8:], best.covariance[8:, 8:], unknown
    known = [(d, h, harmonic_prior(test, d)) for d, h in zip(DISKS, (h_fast, h_slow))]
    uneven = {of[0]: harmonic_from_fit(*left, *of) for of in known}
    return fits, BothFit(
        best.theta[:8], test.speed_ratio, estimates, pulls, inflation, uneven, best
    )


def disk_fit(
    test: EhlTest, disk: DiskTraces, share: float, h: float, window_s: float, profile: Profile
) -> DiskFit:
    """One disk alone, from ``share`` and ``h`` [W/m2K] on, over ``window_s`` of cooling."""
    taus = sorted(disk.mean_chain.taus_s, reverse=True)
    tau1 = max(taus[0], 0.02)
    tau2 = max(taus[1] if len(taus) > 1 else 0.0, 0.1 * tau1)
    theta = np.array([share, np.log(max(h, 20.0)), np.log(tau1 + tau2), np.log(tau2)])
    for enough in (
        COARSE_TOLERANCE,
        TOLERANCE,
        TOLERANCE,
    ):  # each pass equalises with the chain that the one before found
        side = disk_side(test, disk, theta, window_s, profile, tau2)
        problem = joint_problem([side])
        best = minimise(
            problem, np.append(theta, np.zeros(len(problem.names) - len(theta))), tolerance=enough
        )
        moved = np.abs(best.theta[:4] - theta[:4])
        theta = best.theta
        if enough == TOLERANCE and np.all(moved < CONVERGED_U * np.sqrt(np.diag(best.covariance)[:4])):
            break
    share = float(theta[SHARE])
    (h, total) = map(float, np.exp(theta[[LOG_H, LOG_LAGS]]))
    inflation, noise, per_sd = _known(
        best, [side], [SHARE, LOG_H, LOG_LAGS], np.array([1.0, h, total])
    )
    beta = share if disk.name == "fast" else 1.0 - share
    chain = with_lags(disk.mean_chain, lags(theta))
    u = np.sqrt(np.diag(noise + per_sd @ per_sd.T))
    of = [Unmeasured(x, "chain") for x in ("common lag", "lag shape")]
    of += [SURFACE_SLOPE] * bool(np.isfinite(side.prior_log_h[1]))
    values = {"beta": beta, "h": h, "lag_s": chain.lag_s}
    return DiskFit(
        disk=disk.name,
        theta=theta[:4],
        share=share,
        beta=beta,
        h_W_m2K=h,
        chain=chain,
        estimates={name: Estimate.normal(x, float(s)) for (name, x), s in zip(values.items(), u)},
        shift=FitSensitivity((*side.of, *of), per_sd.T, noise),
        inflation=inflation,
        side=side,
    )
