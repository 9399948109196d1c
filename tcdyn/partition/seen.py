"""What the outer row of a disk shows by its share, its film and the lags of its chain: the model of the joint fits."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calibration import Array
from tcdyn.chain import Chain
from tcdyn.conduction.rim import cardinal
from tcdyn.partition.window import POWER, RimMeans

PARAMETERS = ("share", "log h", "log lags", "log tau2")  # of each disk; lags: tau1 + tau2
SHARE, LOG_H, LOG_LAGS, LOG_TAU2 = range(4)
LEAST_PART = 1e-7  # of the sum of both lags
NO_NODE = 1e-6  # a lag this near to one of the bank's is taken to lie beside it
LOG_H_STEP, LARGEST_LOG_H = 1e-5, 14.0  # a search that goes beyond a million W/m2K has lost its way


def lags(p: Array) -> tuple[float, float]:
    """tau1 and tau2 [s] of the parameters of a disk; a second lag that would be longer than the sum is all of it."""
    total, second = float(np.exp(p[LOG_LAGS])), float(np.exp(p[LOG_TAU2]))
    second = min(second, (1 - LEAST_PART) * total)
    return total - second, second


def with_lags(like: Chain, taus_s: tuple[float, ...]) -> Chain:
    """The chain with ``taus_s`` for the two largest lags of ``like``, the rest as there."""
    return replace(like, taus_s=(*taus_s, *sorted(like.taus_s, reverse=True)[2:]))


def lagged(u: Array, bank: Array, rates_1_s: Array, tau_s: float) -> tuple[Array, Array]:
    """Means (R,) of an input and its ``bank`` (R, K) as it passes one more lag L = 1/(1 + tau s).

    With the bank's lags L_k of rates r_k and a = 1/tau it is L L_k = (a L_k - r_k L)/(a - r_k), and L is made up of
    the L_k themselves by ``cardinal``: good to 1e-6 for a lag within the bank's; one beyond is taken for its last.
    """
    rate = 1 / tau_s
    rate *= 1 + NO_NODE * bool(np.any(np.abs(np.log(rate / rates_1_s)) < NO_NODE))
    seen = bank @ cardinal(rates_1_s, np.log(np.clip([rate], *rates_1_s[[0, -1]])))[0]
    return seen, (rate * bank - rates_1_s * seen[:, None]) / (rate - rates_1_s)


@dataclass(frozen=True)
class SeenRim:
    """A ``rim`` whose power was seen through the one lag ``lag_s`` of two, here answering to both, its readings weighed
    by ``weight`` (R, P)."""

    rim: RimMeans
    lag_s: float
    weight: Array

    def heated(self, taus_s: tuple[float, ...]) -> RimMeans:
        """The rim with the power seen through these lags: (1 + lag s)/(1 + tau s) = lag/tau + (1 - lag/tau) L with the
        longest of them, then the others."""
        rates, power = self.rim.rates_1_s, (self.rim.inputs[:, 0], self.rim.banks[0])
        longest, *others = sorted(taus_s, reverse=True)
        part = self.lag_s / longest
        u, bank = (part * x + (1 - part) * y for x, y in zip(power, lagged(*power, rates, longest)))
        for tau in others:
            u, bank = lagged(u, bank, rates, tau)
        return self.rim.driven_by(u, bank)

    def __call__(self, p: Array) -> tuple[Array, Array] | None:
        """Prediction (m,) and derivatives (m, 4); by the logarithm of a lag, which the power P passes as L, it is
        (L - 1) L P."""
        if not p[LOG_H] < LARGEST_LOG_H:
            return None
        share, h, (one, two) = p[SHARE], float(np.exp(p[LOG_H])), lags(p)
        rest, power = self.heated((one, two)).answer(h * np.exp([0.0, LOG_H_STEP]))
        at, up = rest + share * power
        by_one, by_two = (share * (self.heated((one, two, tau)).through(POWER, h) - power[0]) for tau in (one, two))
        slopes = [power[0], (up - at) / LOG_H_STEP, by_one * (one + two) / one, by_two - by_one * two / one]
        return (at * self.weight).ravel(), np.stack([(s * self.weight).ravel() for s in slopes], axis=1)
