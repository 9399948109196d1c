"""A linear estimate averaged over possible noise models (Bayesian model averaging).

The models are white noise plus a first-order disturbance of any time constant.
``tcdyn.identification.disturbance`` uses it. Guarded by ``tests/estimation/test_noise_models.py``
and ``tests/estimation/test_fitting.py``.
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
# grid points of time constant and gain, and the largest number of grids, each in a smaller box
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
    """White noise plus a first-order disturbance, as an ARMA(1, 1) model.

    Parameters
    ----------
    log_tau
        Logarithm of the time constant [samples].
    logit_gain
        Logit of the Kalman gain K of the disturbance.

    Notes
    -----
    n = v + w with v_t = a v_(t-1) + white and white noise w; a = exp(-1/tau), and C = 1 - a (1 - K)
    q^-1. Such noise never has less power at low frequencies than at high ones.
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
        Jacobian (N, P) in the scale ``size`` of its columns; the last ``n_drifts`` columns are
        those of drifts.
    size
        Scale of the columns (P,); infinite for a fixed parameter.
    prior
        Rows of the prior, (C, P + 1), in the scale of ``jacobian``; the last column is their
        residual.
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

    def marginal_likelihood(self, noise: NoiseModel) -> tuple[float, Array, Array]:
        """Marginal likelihood of a noise model, and the step of x under it.

        The noise level and x are integrated out.

        Parameters
        ----------
        noise
            Noise model.

        Returns
        -------
        log_likelihood
            Up to a constant that is the same for all noise models.
        step
            Step of x from the point of linearisation, (P,).
        covariance
            Covariance of the step, (P, P).

        Notes
        -----
        -2 ln L = (N - P) ln |w|^2 + ln det J'WJ + ln det of the noise (Patterson and Thompson
        1971). A drift has the prior that one independent sample would give, so that it costs the
        logarithm of their number, as in BIC. The constants 1e-300 and 1e-12 only keep the
        logarithms finite for an exact fit and for collinear columns. Guarded by
        ``tests/estimation/test_noise_models.py``.
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
    """Noise models on a grid, each with its marginal likelihood and the step of x under it.

    Parameters
    ----------
    box
        Bounds (2, 2) of the logarithm of the time constant and the logit of the gain; they enclose
        the likely models.
    points
        Grid points (K, 2).
    noises
        Noise model at each point.
    nodes
        Log likelihood, step and covariance at each point, as ``marginal_likelihood`` returns them.
    """

    box: Array
    points: Array
    noises: tuple[NoiseModel, ...]
    nodes: tuple[tuple[float, Array, Array], ...]

    @classmethod
    def build(cls, linearised: LinearisedProblem, box: Array) -> NoiseGrid:
        """The grid of noise models, reduced to the likely region of ``box``.

        Parameters
        ----------
        linearised
            The problem.
        box
            Bounds (2, 2) of the logarithm of the time constant and the logit of the gain, for
            example ``full_box``.

        Notes
        -----
        The box is reduced to the points within ``MAX_LOG_DROP`` of the best, plus a step, up to
        ``ZOOMS - 1`` times. Where the likelihood is flat it stays wide. A finer grid is more exact
        and slower.
        """
        limits = full_box(len(linearised.residual))
        for zoom in range(ZOOMS):
            step = np.ptp(box, axis=1) / GRID
            grid_points = box[:, 0] + (np.indices(GRID).reshape(2, -1).T + 0.5) * step
            noises = tuple(first_order_noise(*point) for point in grid_points.tolist())
            nodes = tuple(linearised.marginal_likelihood(noise) for noise in noises)
            log_likelihood = np.array([node[0] for node in nodes])
            likely_points = grid_points[log_likelihood > log_likelihood.max() - MAX_LOG_DROP]
            smaller_box = np.column_stack(
                [likely_points.min(axis=0) - step, likely_points.max(axis=0) + step]
            )
            smaller_box = np.clip(smaller_box, limits[:, :1], limits[:, 1:])
            area = np.prod(np.ptp(box, axis=1))
            if zoom == ZOOMS - 1 or np.prod(np.ptp(smaller_box, axis=1)) > MIN_REDUCTION * area:
                break
            box = smaller_box
        return cls(box, grid_points, noises, nodes)

    def average(
        self, linearised: LinearisedProblem, other_models: Sequence[NoiseModel]
    ) -> tuple[float, float, NoiseModel, Array, Array]:
        """Average over the grid and the noise models ``other_models``.

        All gains from 0 to 1 are equally probable, and so are logarithms of the time constant
        within the record, and beyond it. Each of the other_models is as probable as all first-order
        models together.

        Parameters
        ----------
        linearised
            The problem.
        other_models
            Noise models besides the grid.

        Returns
        -------
        evidence
            Log evidence.
        random_walk_share
            Probability of random walks.
        likeliest
            Most likely noise model.
        mean
            Mean step of x, (P,).
        covariance
            Its covariance, (P, P), with the spread between the models.

        Notes
        -----
        A random walk is a grid point with a time constant beyond the record.
        ``RANDOM_WALK_PROBABILITY`` decides how much evidence is needed for a return to the mean;
        ``tests/estimation/test_noise_models.py`` checks that the prior remains where the data do
        not distinguish the models.
        """
        n = len(linearised.residual)
        gain = expit(self.points[:, 1])
        walks = self.points[:, 0] > np.log(n)
        density = np.where(
            walks,
            RANDOM_WALK_PROBABILITY / np.log(MAX_TAU_RECORDS),
            (1 - RANDOM_WALK_PROBABILITY) / np.log(n / MIN_TAU_SAMPLES),
        )
        prior = np.prod(np.ptp(self.box, axis=1)) / len(self.nodes) * density * gain * (1 - gain)
        nodes = [*self.nodes, *(linearised.marginal_likelihood(noise) for noise in other_models)]
        log_likelihood = np.array([node[0] for node in nodes])
        log_weight = log_likelihood + np.log([*prior, *np.ones(len(other_models))])
        means = np.array([node[1] for node in nodes])
        covariances = np.array([node[2] for node in nodes])
        mean, covariance = mixture_moments(log_weight, means, covariances)
        likeliest = [*self.noises, *other_models][int(np.argmax(log_likelihood))]
        evidence = float(logsumexp(log_weight))
        walk_share = float(np.sum(np.exp(log_weight[: len(walks)] - evidence)[walks]))
        return evidence, walk_share, likeliest, mean, covariance


def full_box(n: int) -> Array:
    """The box of all first-order noise models in a record of ``n`` samples.

    Returns
    -------
    Bounds, (2, 2): logarithm of the time constant [samples], logit of the gain.
    """
    return np.array([[np.log(MIN_TAU_SAMPLES), np.log(MAX_TAU_RECORDS * n)], GAIN])


def mixture_moments(log_weight: Array, means: Array, covariances: Array) -> tuple[Array, Array]:
    """Mean and covariance of a mixture.

    Parameters
    ----------
    log_weight
        Logarithms of the weights, (K,), up to a constant.
    means
        Means of the components, (K, P).
    covariances
        Covariances of the components, (K, P, P).

    Returns
    -------
    mean, covariance
        (P,) and (P, P).
    """
    weight = np.exp(log_weight - logsumexp(log_weight))
    mean = weight @ means
    difference = means - mean
    return mean, np.einsum("k,kpq->pq", weight, covariances) + (difference.T * weight) @ difference
