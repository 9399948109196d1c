"""A linear estimate averaged over what the noise may be: a first-order disturbance of any time constant beneath white
noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import expit, logsumexp

from tcdyn.core import Array
from tcdyn.estimation.arma import Noise
from tcdyn.estimation.problem import inverse

# nodes of time constant and gain, times the box may be drawn closer
GRID = (12, 8)
ZOOMS = 4
# drop of ln likelihood that the box holds; its least gain, of its area, for another time
DEEP = 6.0
CLOSER = 0.7
# time constants: in samples, in records
SHORTEST = 0.7
LONGEST = 10.0
OUTLASTS = 0.8  # probability of those beyond the record, random walks to it: that noise comes back must be in the data
GAIN = (-9.0, 5.0)  # logit of the Kalman gain: from hardly any disturbance to nothing but it


def noise_of(log_tau: float, logit_gain: float) -> Noise:
    """n = v + w, v_t = a v_(t-1) + white, w white: ARMA(1, 1) with C = 1 - a (1 - K) q^-1, K the Kalman gain of v.

    a = exp(-1/tau), tau in samples. Such noise has never less power at low frequencies than at high ones.
    """
    a = float(np.exp(-np.exp(-log_tau)))
    k = float(expit(logit_gain))
    return Noise((-a,), (-a * (1 - k),), averaged=True)


@dataclass(frozen=True)
class Slopes:
    """A problem made linear at some x: residuals (N,), their Jacobian (N, P) in the scale ``size`` (P,) of its columns
    (infinite of what is held), and the prior's rows; the last ``drifts`` columns are those of drifts."""

    residual: Array
    jacobian: Array
    size: Array
    prior: Array
    parts: list[slice]
    drifts: int

    def given(self, noise: Noise) -> tuple[float, Array, Array]:
        """ln likelihood of ``noise``, x and its noise's level integrated, the step of x (P,) and its covariance (P, P).

        -2 ln L = (N - P) ln |w|^2 + ln det J'WJ + ln det of the noise (Patterson and Thompson 1971); a drift has the
        prior that one independent sample would give, so that it costs the logarithm of how many there are, as in BIC.
        """
        table = noise.whiten(np.column_stack([self.jacobian, self.residual]), self.parts)
        factor = np.asarray(np.linalg.qr(np.vstack([table, self.prior]), mode="r"))
        p = len(self.size)
        n = len(self.residual)
        upper = factor[:p, :p]
        free = p - self.drifts
        rest = float(factor[-1, -1] ** 2) + 1e-300
        seen = np.isfinite(self.size[:free])
        volume = 2 * float(np.sum(np.log(np.abs(np.diag(upper))[:free][seen] + 1e-12)))
        deviance = (n - free) * np.log(rest) + volume + noise.log_spread(self.parts)
        deviance += self.drifts * np.log(noise.independent(n)) if self.drifts else 0.0
        unit = inverse(upper.T @ upper)
        step = -unit @ (upper.T @ factor[:p, p])
        return (
            -0.5 * deviance,
            step / self.size,
            rest / (n - p) * unit / np.outer(self.size, self.size),
        )


@dataclass(frozen=True)
class NoiseGrid:
    """Noises by logarithm of their time constant and logit of their gain, ``places`` (K, 2) within a ``box`` (2, 2)
    that holds what is likely, and what :meth:`Slopes.given` says of each."""

    box: Array
    places: Array
    noises: tuple[Noise, ...]
    nodes: tuple[tuple[float, Array, Array], ...]

    @classmethod
    def of(cls, slopes: Slopes, box: Array) -> NoiseGrid:
        """The grid within ``box``, drawn closer about what is likely; where the likelihood is flat it stays wide."""
        whole = widest(len(slopes.residual))
        for zoom in range(ZOOMS):
            step = np.ptp(box, axis=1) / GRID
            places = box[:, 0] + (np.indices(GRID).reshape(2, -1).T + 0.5) * step
            noises = tuple(noise_of(*place) for place in places.tolist())
            nodes = tuple(slopes.given(noise) for noise in noises)
            height = np.array([node[0] for node in nodes])
            kept = places[height > height.max() - DEEP]
            closer = np.column_stack([kept.min(axis=0) - step, kept.max(axis=0) + step])
            closer = np.clip(closer, whole[:, :1], whole[:, 1:])
            if zoom == ZOOMS - 1 or np.prod(np.ptp(closer, axis=1)) > CLOSER * np.prod(
                np.ptp(box, axis=1)
            ):
                break
            box = closer
        return cls(box, places, noises, nodes)

    def integrated(
        self, slopes: Slopes, others: Sequence[Noise]
    ) -> tuple[float, float, Noise, Array, Array]:
        """Evidence, share of random walks, likeliest noise, mean step of x (P,) and covariance (P, P) over ``others``
        and the grid.

        All gains from 0 to 1 are alike probable, and so are logarithms of the time constant within the record, and
        beyond it; the others are each as probable as all first-order noises together.
        """
        n = len(slopes.residual)
        gain = expit(self.places[:, 1])
        walks = self.places[:, 0] > np.log(n)
        density = np.where(walks, OUTLASTS / np.log(LONGEST), (1 - OUTLASTS) / np.log(n / SHORTEST))
        prior = np.prod(np.ptp(self.box, axis=1)) / len(self.nodes) * density * gain * (1 - gain)
        nodes = [*self.nodes, *(slopes.given(noise) for noise in others)]
        log_likelihood = np.array([node[0] for node in nodes])
        height = log_likelihood + np.log([*prior, *np.ones(len(others))])
        mean, covariance = moments(height, *(np.array([node[k] for node in nodes]) for k in (1, 2)))
        likeliest = [*self.noises, *others][int(np.argmax(log_likelihood))]
        evidence = float(logsumexp(height))
        return (
            evidence,
            float(np.sum(np.exp(height[: len(walks)] - evidence)[walks])),
            likeliest,
            mean,
            covariance,
        )


def widest(n: int) -> Array:
    """The box (2, 2) of all first-order noises in a record of n samples."""
    return np.array([[np.log(SHORTEST), np.log(LONGEST * n)], GAIN])


def moments(height: Array, means: Array, covariances: Array) -> tuple[Array, Array]:
    """Mean (P,) and covariance (P, P) of a mixture with log weights ``height`` (K,) of ``means`` (K, P) and their
    ``covariances`` (K, P, P)."""
    weight = np.exp(height - logsumexp(height))
    mean = weight @ means
    apart = means - mean
    return mean, np.einsum("k,kpq->pq", weight, covariances) + (apart.T * weight) @ apart
