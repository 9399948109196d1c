"""A linear estimate averaged over the possible noise models: white noise plus a first-order
disturbance of any time constant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import expit, logsumexp

from tcdyn.core import Array
from tcdyn.estimation.arma import NoiseModel
from tcdyn.estimation.problem import inverse

# Values without a source below were chosen by judgement.
# grid points of time constant and gain, and the number of reductions of the box
GRID = (12, 8)
ZOOMS = 4
# drop of the log likelihood that the box contains; ratio of areas that is worth a further reduction
MAX_LOG_DROP = 6.0
MIN_REDUCTION = 0.7
# time constants: shortest in samples, longest in records
MIN_TAU_SAMPLES = 0.7
MAX_TAU_RECORDS = 10.0
# prior probability of time constants beyond the record, which are random walks in it: the data must
# show that the noise returns to its mean
RANDOM_WALK_PROBABILITY = 0.8
# logit of the Kalman gain: from hardly any disturbance to disturbance only
GAIN = (-9.0, 5.0)


def first_order_noise(log_tau: float, logit_gain: float) -> NoiseModel:
    """The sum n = v + w of a first-order disturbance v_t = a v_(t-1) + white and white noise w, as
    an ARMA(1, 1) model.

    a = exp(-1/tau), tau in samples, and C = 1 - a (1 - K) q^-1 with the Kalman gain K of v. Such
    noise never has less power at low frequencies than at high ones.
    """
    a = float(np.exp(-np.exp(-log_tau)))
    k = float(expit(logit_gain))
    return NoiseModel((-a,), (-a * (1 - k),), averaged=True)


@dataclass(frozen=True)
class LinearisedProblem:
    """A problem linearised at some x.

    Parameters
    ----------
    residual
        Residuals (N,).
    jacobian
        Jacobian (N, P) in the scale ``size`` of its columns; the last ``n_drifts`` columns are those
        of drifts.
    size
        Scale of the columns (P,); infinite for a fixed parameter.
    prior
        Rows of the prior.
    segments
        Segments of the record without gaps.
    n_drifts
        Number of drift columns.
    """

    residual: Array
    jacobian: Array
    size: Array
    prior: Array
    segments: list[slice]
    n_drifts: int

    def marginal(self, noise: NoiseModel) -> tuple[float, Array, Array]:
        """Log likelihood of ``noise`` with x and the noise level integrated out, the step of x (P,)
        and its covariance (P, P).

        -2 ln L = (N - P) ln |w|^2 + ln det J'WJ + ln det of the noise (Patterson and Thompson
        1971). A drift has the prior that one independent sample would give, so that it costs the
        logarithm of their number, as in BIC.
        """
        table = noise.whiten(np.column_stack([self.jacobian, self.residual]), self.segments)
        factor = np.asarray(np.linalg.qr(np.vstack([table, self.prior]), mode="r"))
        p = len(self.size)
        n = len(self.residual)
        upper = factor[:p, :p]
        free = p - self.n_drifts
        residual_square = float(factor[-1, -1] ** 2) + 1e-300
        free_columns = np.isfinite(self.size[:free])
        volume = 2 * float(np.sum(np.log(np.abs(np.diag(upper))[:free][free_columns] + 1e-12)))
        deviance = (
            (n - free) * np.log(residual_square) + volume + noise.log_determinant(self.segments)
        )
        if self.n_drifts:
            deviance += self.n_drifts * np.log(noise.effective_samples(n))
        unit = inverse(upper.T @ upper)
        step = -unit @ (upper.T @ factor[:p, p])
        return (
            -0.5 * deviance,
            step / self.size,
            residual_square / (n - p) * unit / np.outer(self.size, self.size),
        )


@dataclass(frozen=True)
class NoiseGrid:
    """Noise models on a grid, and the result of :meth:`LinearisedProblem.marginal` for each.

    Parameters
    ----------
    box
        Bounds (2, 2) of the logarithm of the time constant and the logit of the gain; they enclose
        the likely models.
    points
        Grid points (K, 2).
    noises, nodes
        Noise model and result at each point.
    """

    box: Array
    points: Array
    noises: tuple[NoiseModel, ...]
    nodes: tuple[tuple[float, Array, Array], ...]

    @classmethod
    def build(cls, slopes: LinearisedProblem, box: Array) -> NoiseGrid:
        """The grid in ``box``, reduced to the likely region; where the likelihood is flat it stays
        wide.
        """
        limits = full_box(len(slopes.residual))
        for zoom in range(ZOOMS):
            step = np.ptp(box, axis=1) / GRID
            places = box[:, 0] + (np.indices(GRID).reshape(2, -1).T + 0.5) * step
            noises = tuple(first_order_noise(*place) for place in places.tolist())
            nodes = tuple(slopes.marginal(noise) for noise in noises)
            log_likelihood = np.array([node[0] for node in nodes])
            likely_points = places[log_likelihood > log_likelihood.max() - MAX_LOG_DROP]
            closer = np.column_stack(
                [likely_points.min(axis=0) - step, likely_points.max(axis=0) + step]
            )
            closer = np.clip(closer, limits[:, :1], limits[:, 1:])
            area = np.prod(np.ptp(box, axis=1))
            if zoom == ZOOMS - 1 or np.prod(np.ptp(closer, axis=1)) > MIN_REDUCTION * area:
                break
            box = closer
        return cls(box, places, noises, nodes)

    def average(
        self, slopes: LinearisedProblem, others: Sequence[NoiseModel]
    ) -> tuple[float, float, NoiseModel, Array, Array]:
        """Average over the grid and the noise models ``others``.

        All gains from 0 to 1 are equally probable, and so are logarithms of the time constant
        within the record, and beyond it. Each of the others is as probable as all first-order
        models together.

        Returns
        -------
        evidence, random_walk_share, likeliest, mean, covariance
            Log evidence, probability of random walks, most likely noise model, mean step of x (P,)
            and its covariance (P, P).
        """
        n = len(slopes.residual)
        gain = expit(self.points[:, 1])
        walks = self.points[:, 0] > np.log(n)
        density = np.where(
            walks,
            RANDOM_WALK_PROBABILITY / np.log(MAX_TAU_RECORDS),
            (1 - RANDOM_WALK_PROBABILITY) / np.log(n / MIN_TAU_SAMPLES),
        )
        prior = np.prod(np.ptp(self.box, axis=1)) / len(self.nodes) * density * gain * (1 - gain)
        nodes = [*self.nodes, *(slopes.marginal(noise) for noise in others)]
        log_likelihood = np.array([node[0] for node in nodes])
        log_weight = log_likelihood + np.log([*prior, *np.ones(len(others))])
        means = np.array([node[1] for node in nodes])
        covariances = np.array([node[2] for node in nodes])
        mean, covariance = mixture_moments(log_weight, means, covariances)
        likeliest = [*self.noises, *others][int(np.argmax(log_likelihood))]
        evidence = float(logsumexp(log_weight))
        walk_share = float(np.sum(np.exp(log_weight[: len(walks)] - evidence)[walks]))
        return evidence, walk_share, likeliest, mean, covariance


def full_box(n: int) -> Array:
    """The box (2, 2) of all first-order noise models in a record of n samples."""
    return np.array([[np.log(MIN_TAU_SAMPLES), np.log(MAX_TAU_RECORDS * n)], GAIN])


def mixture_moments(log_weight: Array, means: Array, covariances: Array) -> tuple[Array, Array]:
    """Mean (P,) and covariance (P, P) of a mixture with log weights ``log_weight`` (K,), ``means`` (K,
    P) and ``covariances`` (K, P, P).
    """
    weight = np.exp(log_weight - logsumexp(log_weight))
    mean = weight @ means
    difference = means - mean
    return mean, np.einsum("k,kpq->pq", weight, covariances) + (difference.T * weight) @ difference
