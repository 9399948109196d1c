"""What the outer row of a disk shows by its share, its film and the lags of its chain: the model of the joint fits."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calibration import Array
from tcdyn.chain import Chain
from tcdyn.conduction.rim import bank_means
from tcdyn.partition.window import DiskWindow, RimMeans

PARAMETERS = ("share", "log h", "log lags", "log tau2")  # of each disk; lags: tau1 + tau2
SHARE, LOG_H, LOG_LAGS, LOG_TAU2 = range(4)
LEAST_PART = 1e-7  # of the sum of both lags
LOG_H_STEP, LARGEST_LOG_H = 1e-5, 14.0  # a search that goes beyond a million W/m2K has lost its way


def lags(p: Array) -> tuple[float, float]:
    """tau1 and tau2 [s] of the parameters of a disk; a second lag that would be longer than the sum is all of it."""
    total, second = float(np.exp(p[LOG_LAGS])), float(np.exp(p[LOG_TAU2]))
    second = min(second, (1 - LEAST_PART) * total)
    return total - second, second


def with_lags(like: Chain, taus_s: tuple[float, ...]) -> Chain:
    """The chain with ``taus_s`` for the two largest lags of ``like``, the rest as there."""
    return replace(like, taus_s=(*taus_s, *sorted(like.taus_s, reverse=True)[2:]))


@dataclass(frozen=True)
class SeenRim:
    """The rim of a window by the power ``power_W`` (N,), held between samples of ``dt_s``, as a chain shows it that is
    ``like`` this one but for its two largest lags."""

    window: DiskWindow
    power_W: Array
    dt_s: float
    like: Chain

    def heated(self, taus_s: tuple[float, ...]) -> RimMeans:
        """The window's rim with the power seen through these lags."""
        rim, power = self.window.rim, with_lags(self.like, taus_s).response(self.power_W, self.dt_s, hold="zoh")
        return rim.driven_by(
            self.window.blocks @ power, bank_means(power, self.dt_s, rim.rates_1_s, self.window.counts)
        )

    def __call__(self, p: Array) -> tuple[Array, Array] | None:
        """Prediction (m,) and derivatives (m, 4); by the logarithm of a lag tau, which the power P passes as
        L = 1/(1 + tau s), it is (L - 1) L P."""
        if not p[LOG_H] < LARGEST_LOG_H:
            return None
        share, h, (one, two) = p[SHARE], float(np.exp(p[LOG_H])), lags(p)
        rim = self.heated((one, two))
        rest, power = rim.answer(h * np.exp([0.0, LOG_H_STEP]))
        at, up = rest + share * power
        by_one, by_two = (share * rim.slower(tau, h) for tau in (one, two))
        slopes = [power[0], (up - at) / LOG_H_STEP, by_one * (one + two) / one, by_two - by_one * two / one]
        weight = self.window.weight
        return (at * weight).ravel(), np.stack([(s * weight).ravel() for s in slopes], axis=1)
