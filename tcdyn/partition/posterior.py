"""What a joint fit minimises: data, what the rim answers, and what was known before, of one disk or of both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from calibration import Array
from calibration.noise import white_noise_sd
from tcdyn.chain import Chain, equalised
from tcdyn.conduction.rim import Profile
from tcdyn.fitting import Problem
from tcdyn.partition.effects import Effects, Unmeasured, effects
from tcdyn.partition.prepare import EhlTest
from tcdyn.partition.window import DiskWindow, RimResponse, disk_window, power_bank, stretch_of
from tcdyn.traces import NOISE_ORDER, DiskTraces

PARAMETERS = ("share", "log h", "log lags", "log tau2")  # of each disk; lags: tau1 + tau2
SHARE, LOG_H, LOG_LAGS, LOG_TAU2 = range(4)
LARGEST = (np.inf, 0.7, 0.7, 0.7)  # of one step of a search
SHAPE_SD = 1.5  # log of the second lag: known to a factor of four or so
LEAST_LAG_U_S = 0.02
LEAST_PART = 1e-7  # of the sum of both lags
LOG_H_STEP = 1e-3


class Answers(Protocol):
    """What a disk shows, in standard deviations of its noise, and what the rim answers: itself, or a table of it."""

    @property
    def y(self) -> Array:
        """What was seen, (m,)."""

    @property
    def effect(self) -> Array:
        """What nobody measured makes of it, by a standard uncertainty of each, (m, Q)."""

    def model(self, p: Array) -> tuple[Array, Array] | None:
        """Prediction (m,) and its derivatives (m, 4) by ``PARAMETERS``; None where there is none."""


@dataclass(frozen=True)
class Side:
    """One disk in a joint fit: its window at the current chain, what was known of its lags, what nobody measured."""

    test: EhlTest = field(repr=False)
    disk: DiskTraces
    window: DiskWindow
    rows: slice
    prior_lag_s: float
    prior_lag_u_s: float
    prior_tau2_s: float
    unmeasured: Effects

    @property
    def rest_of_lag_s(self) -> float:
        """Lag of the chain beyond its two lags tau1 + tau2: the conditioning filter and the like [s]."""
        chain = self.disk.mean_chain
        return chain.lag_s - sum(sorted(chain.taus_s, reverse=True)[:2])

    @property
    def y(self) -> Array:
        """See ``Answers``."""
        return np.asarray((self.window.y * self.window.weight).ravel())

    @property
    def effect(self) -> Array:
        """See ``Answers``."""
        return np.asarray((self.unmeasured.change * self.window.weight).reshape(len(self.unmeasured.of), -1).T)

    def heated(self, taus_s: tuple[float, ...]) -> RimResponse:
        """The rim with the power seen through the disk's chain with the lags ``taus_s``."""
        chain = with_lags(self.disk.mean_chain, taus_s)
        power = power_bank(self.test, self.rows, self.window.rim.rates_1_s, chain)
        return self.window.with_power(*power).rim

    def model(self, p: Array) -> tuple[Array, Array]:
        """See ``Answers``.

        By log h a central difference; by the logarithm of a lag tau, which the power P passes as L = 1/(1 + tau s),
        (L - 1) L P: the seen power through the same lag once more, less itself.
        """
        share, h = p[SHARE], float(np.exp(p[LOG_H]))
        rim = self.heated(lags(p))
        rest, power = rim.answer(h)
        up, down = (rim.answer(h * float(np.exp(e))) for e in (LOG_H_STEP, -LOG_H_STEP))
        by_tau = [share * (self.heated((*lags(p), tau)).heat(rim.gains(h)) - power) for tau in lags(p)]
        one, two = lags(p)
        slopes = [
            power,
            (up[0] - down[0] + share * (up[1] - down[1])) / (2 * LOG_H_STEP),
            by_tau[0] * (one + two) / one,
            by_tau[1] - by_tau[0] * two / one,
        ]
        w = self.window.weight
        return ((rest + share * power) * w).ravel(), np.stack([(s * w).ravel() for s in slopes], axis=1)


def lags(p: Array) -> tuple[float, float]:
    """tau1 and tau2 [s] of the parameters of a disk; a second lag that would be longer than the sum is all of it."""
    total, second = float(np.exp(p[LOG_LAGS])), float(np.exp(p[LOG_TAU2]))
    second = min(second, (1 - LEAST_PART) * total)
    return total - second, second


def with_lags(like: Chain, taus_s: tuple[float, ...]) -> Chain:
    """The chain with ``taus_s`` for the two largest lags of ``like``, the rest as there."""
    return replace(like, taus_s=(*taus_s, *sorted(like.taus_s, reverse=True)[2:]))


def joint_problem(sides: Sequence[Side], answers: Sequence[Answers]) -> Problem:
    """The posterior of one disk, or of both with shares that add to what they add to at the start.

    Parameters are four a disk and then, in standard uncertainties, what nobody measured; what the disks share is one.
    """
    k, sizes = 4 * len(sides), [len(a.y) for a in answers]
    ends = np.cumsum([0, *sizes])
    unknown = unknowns(sides)
    effect = np.zeros((ends[-1], len(unknown)))
    for i, (side, a) in enumerate(zip(sides, answers)):
        for q, what in enumerate(side.unmeasured.of):
            effect[ends[i] : ends[i + 1], unknown.index((what, "" if what.shared else side.disk.name))] = a.effect[:, q]

    def evaluate(theta: Array) -> tuple[Array, Array] | None:
        residual = np.zeros(ends[-1] + len(sides))
        jacobian = np.zeros((len(residual), len(theta)))
        residual[: ends[-1]] = effect @ theta[k:]
        jacobian[: ends[-1], k:] = effect
        for i, (side, a) in enumerate(zip(sides, answers)):
            p, own = theta[4 * i : 4 * i + 4], slice(ends[i], ends[i + 1])
            answer = a.model(p)
            if answer is None:
                return None
            residual[own] += answer[0] - a.y
            jacobian[own, 4 * i : 4 * i + 4] = answer[1]
            total = float(np.exp(p[LOG_LAGS]))  # the record's lag, the last rows
            residual[ends[-1] + i] = (total + side.rest_of_lag_s - side.prior_lag_s) / side.prior_lag_u_s
            jacobian[ends[-1] + i, 4 * i + LOG_LAGS] = total / side.prior_lag_u_s
        return residual, jacobian

    names = [f"{name}, {side.disk.name} disk" for side in sides for name in PARAMETERS]
    names += [f"{what.name} {disk}".strip() for what, disk in unknown]
    mean, sd = np.zeros(len(names)), np.ones(len(names))
    sd[:k] = np.inf
    mean[LOG_TAU2:k:4], sd[LOG_TAU2:k:4] = [np.log(s.prior_tau2_s) for s in sides], SHAPE_SD
    largest = np.full(len(names), np.inf)
    largest[:k] = LARGEST * len(sides)
    fixed = np.zeros((len(sides) - 1, len(names)))
    fixed[:, SHARE:k:4] = 1.0
    return Problem(tuple(names), evaluate, mean, sd, largest=largest, fixed=fixed)


def unknowns(sides: Sequence[Side]) -> list[tuple[Unmeasured, str]]:
    """What nobody measured, each with its disk, or "" where both have it in common; in the order of the parameters."""
    every = [(what, "" if what.shared else side.disk.name) for side in sides for what in side.unmeasured.of]
    return list(dict.fromkeys(every))


def disk_side(test: EhlTest, disk: DiskTraces, theta: Array, window_s: float, profile: Profile, tau2_s: float) -> Side:
    """The disk's readings brought to the chain of ``theta``, and what nobody measured about that point."""
    rows = stretch_of(test, window_s)
    common = with_lags(disk.mean_chain, lags(theta))
    shift = common.lag_s - disk.mean_chain.lag_s
    chains = tuple(c.with_lag_shift(shift) for c in disk.chains)
    readings = equalised(disk.readings_degC[rows], test.dt_s, chains, disk.mean_chain.with_lag_shift(shift))
    noise = np.maximum(white_noise_sd(readings, NOISE_ORDER), 0.5 * disk.noise_K)
    window = disk_window(test, disk, readings, rows, noise, profile, common)
    known = effects(test, disk, window, float(theta[SHARE]), float(np.exp(theta[LOG_H])))
    lag_u = max(disk.common_lag_u_s, LEAST_LAG_U_S)
    return Side(test, disk, window, rows, disk.common_lag_s, lag_u, tau2_s, known)
