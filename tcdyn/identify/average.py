"""An estimate averaged over what the disturbance may be: a first-order one of any time constant beneath white noise,
with a straight drift or without."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logsumexp

from calibration import Array
from tcdyn.fitting import Noise, Optimum, inverse
from tcdyn.identify.problem import Posed
from tcdyn.identify.search import rms, search

GRID, ZOOMS = (12, 8), 4  # nodes of time constant and gain, times the box may be drawn closer
DEEP, CLOSER = 6.0, 0.7  # drop of ln likelihood that the box holds; its least gain, of its area, for another time
ROUNDS, AGREED = 3, 0.05  # of the dynamics given the noise; standard uncertainties by which they may still move
SHORTEST, LONGEST = 0.7, 10.0  # time constants: in samples, in records
OUTLASTS = 0.8  # probability of those beyond the record, random walks to it: that noise comes back must be in the data
GAIN = (-9.0, 5.0)  # logit of the Kalman gain: from hardly any disturbance to nothing but it
LINEAR, FAR = 0.3, 5.0  # move of a logarithm, and in standard uncertainties, that may still be linear
NEGLIGIBLE = 0.01  # probability, below which a drift is left out


@dataclass(frozen=True)
class Averaged:
    """``mean`` and ``covariance`` over the noises, of x with its logarithms taken back: there small lags and dead time
    add up. ``noise`` is the likeliest, ``optimum`` given it, and ``evidence`` the logarithm of the likelihood averaged
    over all noises; ``walks`` is the probability that the disturbance outlasts the record."""

    posed: Posed
    optimum: Optimum
    noise: Noise
    mean: Array
    covariance: Array
    evidence: float
    walks: float

    def found(self, weights: Array | None) -> tuple[Posed, Optimum, Noise, Array]:
        """Problem, optimum and noise as any other fit has them, residuals and slopes at the mean, and covariance of x.

        Where the mean lies further off than the problem is linear, as in a direction of which the data tell nothing,
        x stays that given the likeliest noise, and what it is off the mean is uncertainty.
        """
        posed, lower, upper = self.posed, *self.posed.bounds()
        core = posed.core(self.noise, 1.0 if weights is None else np.sqrt(weights))
        x, scale, logs = self.optimum.theta, natural(posed, self.optimum.theta), logarithms(posed)
        answer, covariance = core.evaluate(x), self.covariance
        assert answer is not None
        apart = self.mean - plain(posed, x)
        moved = x + np.where(logs, np.log1p(np.clip(apart / scale, -LINEAR, LINEAR)), apart)
        there = core.evaluate(np.clip(moved, lower, upper)) if np.all(np.abs(apart / scale)[logs] < LINEAR) else None
        limit = (1 + FAR**2 / posed.n_seen) * float(answer[0] @ answer[0])
        if there is not None and there[0] @ there[0] < limit:
            x, answer = np.clip(moved, lower, upper), there
            scale = natural(posed, x)
        else:
            covariance = covariance + np.outer(apart, apart)
        here = replace(self.optimum, problem=core, theta=x, residual=answer[0], jacobian=answer[1])
        return posed, here, self.noise, covariance / np.outer(scale, scale)


def logarithms(posed: Posed) -> NDArray[np.bool_]:
    """Which of x (P,) are logarithms."""
    free = posed.model.free
    return np.array([k < len(free) and posed.model.positive(free[k]) for k in range(posed.size)])


def plain(posed: Posed, x: Array) -> Array:
    """x (P,) with its logarithms taken back."""
    return np.where(logarithms(posed), np.exp(x), x)


def natural(posed: Posed, x: Array) -> Array:
    """Derivative (P,) of :func:`plain` by x."""
    return np.where(logarithms(posed), np.exp(x), 1.0)


def noise_of(log_tau: float, logit_gain: float) -> Noise:
    """n = v + w, v_t = a v_(t-1) + white, w white: ARMA(1, 1) with C = 1 - a (1 - K) q^-1, K the Kalman gain of v.

    a = exp(-1/tau), tau in samples. Such noise has never less power at low frequencies than at high ones.
    """
    a, k = float(np.exp(-np.exp(-log_tau))), float(expit(logit_gain))
    return Noise((-a,), (-a * (1 - k),), averaged=True)


@dataclass(frozen=True)
class Slopes:
    """The problem made linear at x: residuals (N,), their Jacobian (N, P) in the scale ``size`` (P,) of its columns by
    x with logarithms taken back, and the prior's rows; the last ``drifts`` columns are those of drifts. What stands on
    a bound stays there."""

    residual: Array
    jacobian: Array
    size: Array
    prior: Array
    parts: list[slice]
    drifts: int

    @classmethod
    def at(cls, posed: Posed, x: Array, root: Array | float) -> Slopes:
        """Of ``posed`` at x, all rows times ``root``."""
        answer = posed.evaluate(x)
        assert answer is not None
        lower, upper = posed.bounds()
        j = (answer[1].T * root).T * ((lower < x) & (x < upper)) / natural(posed, x)
        size = np.linalg.norm(j, axis=0)
        size[size == 0] = np.inf
        told = np.sqrt(posed.precision)
        prior = np.column_stack([np.diag(told / size), told * x])[told > 0]
        return cls(answer[0] * root, j / size, size, prior, posed.parts, posed.trend * len(posed.begun_s))

    def given(self, noise: Noise) -> tuple[float, Array, Array]:
        """ln likelihood of ``noise``, x and its noise's level integrated, the step of x (P,) and its covariance (P, P).

        -2 ln L = (N - P) ln |w|^2 + ln det J'WJ + ln det of the noise (Patterson and Thompson 1971); a drift has the
        prior that one sample would give, so that it costs ln N as in BIC.
        """
        table = noise.whiten(np.column_stack([self.jacobian, self.residual]), self.parts)
        factor = np.asarray(np.linalg.qr(np.vstack([table, self.prior]), mode="r"))
        p, n = len(self.size), len(self.residual)
        upper, free = factor[:p, :p], p - self.drifts
        rest = float(factor[-1, -1] ** 2) + 1e-300
        seen = np.isfinite(self.size[:free])
        volume = 2 * float(np.sum(np.log(np.abs(np.diag(upper))[:free][seen] + 1e-12)))
        deviance = (n - free) * np.log(rest) + volume + self.drifts * np.log(n) + noise.log_spread(self.parts)
        unit = inverse(upper.T @ upper)
        step = -unit @ (upper.T @ factor[:p, p])
        return -0.5 * deviance, step / self.size, rest / (n - p) * unit / np.outer(self.size, self.size)


@dataclass(frozen=True)
class Grid:
    """Noises by logarithm of their time constant and logit of their gain, ``places`` (K, 2) within a ``box`` (2, 2)
    that holds what is likely, and what :meth:`Slopes.given` says of each."""

    box: Array
    places: Array
    noises: tuple[Noise, ...]
    nodes: tuple[tuple[float, Array, Array], ...]

    @classmethod
    def of(cls, slopes: Slopes, box: Array) -> Grid:
        """The grid within ``box``, drawn closer about what is likely; where the likelihood is flat it stays wide."""
        whole = widest(len(slopes.residual))
        for _ in range(ZOOMS):
            step = np.ptp(box, axis=1) / GRID
            places = box[:, 0] + (np.indices(GRID).reshape(2, -1).T + 0.5) * step
            noises = tuple(noise_of(*place) for place in places.tolist())
            nodes = tuple(slopes.given(noise) for noise in noises)
            height = np.array([node[0] for node in nodes])
            kept = places[height > height.max() - DEEP]
            closer = np.column_stack([kept.min(axis=0) - step, kept.max(axis=0) + step])
            closer = np.clip(closer, whole[:, :1], whole[:, 1:])
            if np.prod(np.ptp(closer, axis=1)) > CLOSER * np.prod(np.ptp(box, axis=1)):
                break
            box = closer
        return cls(box, places, noises, nodes)

    def integrated(self, slopes: Slopes, others: Sequence[Noise]) -> tuple[float, float, Noise, Array, Array]:
        """Evidence, share of random walks, likeliest noise, mean step of x (P,) and covariance (P, P) over ``others``
        and the grid.

        All gains from 0 to 1 are alike probable, and so are logarithms of the time constant within the record, and
        beyond it; the others are each as probable as all first-order noises together.
        """
        n, gain = len(slopes.residual), expit(self.places[:, 1])
        walks = self.places[:, 0] > np.log(n)
        density = np.where(walks, OUTLASTS / np.log(LONGEST), (1 - OUTLASTS) / np.log(n / SHORTEST))
        prior = np.prod(np.ptp(self.box, axis=1)) / len(self.nodes) * density * gain * (1 - gain)
        nodes = [*self.nodes, *(slopes.given(noise) for noise in others)]
        log_likelihood = np.array([node[0] for node in nodes])
        height = log_likelihood + np.log([*prior, *np.ones(len(others))])
        mean, covariance = moments(height, *(np.array([node[k] for node in nodes]) for k in (1, 2)))
        likeliest = [*self.noises, *others][int(np.argmax(log_likelihood))]
        evidence = float(logsumexp(height))
        return evidence, float(np.sum(np.exp(height[: len(walks)] - evidence)[walks])), likeliest, mean, covariance


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


def averaged(posed: Posed, optimum: Optimum, others: Sequence[Noise] = ()) -> Averaged:
    """``posed`` averaged over first-order disturbances and ``others``, begun at ``optimum``, whose robust weights
    stay."""
    root = 1.0 if optimum.weights is None else np.sqrt(optimum.weights)
    box = widest(posed.n_seen)
    for _ in range(ROUNDS):
        slopes = Slopes.at(posed, optimum.theta, root)
        grid = Grid.of(slopes, box)
        evidence, walks, noise, step, covariance = grid.integrated(slopes, others)
        mean = plain(posed, optimum.theta) + step
        if box is grid.box or np.all(np.abs(step) <= AGREED * np.sqrt(np.diag(covariance))):
            break
        optimum = search(posed, posed.core(noise, root), optimum.theta)
        posed, box = replace(posed, noise_sd=rms(optimum, posed)), grid.box
    return Averaged(posed, optimum, noise, mean, covariance, evidence, walks)


def mixed(found: Sequence[Averaged]) -> Averaged:
    """One of all, each by its evidence: the problem of the last that is not negligible, of which those before are the
    special case that its last unknowns are nought."""
    height = np.array([f.evidence for f in found])
    weight = np.exp(height - logsumexp(height))
    kept = [k for k in range(len(found)) if weight[k] > NEGLIGIBLE]
    last, size = found[kept[-1]], len(found[kept[-1]].mean)
    means = np.array([np.pad(found[k].mean, (0, size - len(found[k].mean))) for k in kept])
    covariances = np.array([np.pad(found[k].covariance, (0, size - len(found[k].mean))) for k in kept])
    mean, covariance = moments(height[kept], means, covariances)
    likeliest = found[int(np.argmax(height))].noise
    walks = float(weight[kept] / weight[kept].sum() @ [found[k].walks for k in kept])
    evidence = float(logsumexp(height))
    return Averaged(last.posed, last.optimum, likeliest, mean, covariance, evidence, walks)
