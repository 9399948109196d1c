"""A linear estimate averaged over possible noise models (Bayesian model averaging).

The models are white noise plus a first-order disturbance of any time constant, and slow waves of
any size, which are columns of the linear problem.
``tcdyn.identification.disturbance`` uses it. Guarded by ``tests/estimation/test_noise_models.py``
and ``tests/estimation/test_fitting.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

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
# Sizes of the slow waves: the least over the noise of the mean of the record, which has no effect;
# with 0.1 a record without drift has an uncertainty of the gain of 1.27 times that of white noise,
# with 0.02 of 1.22, and of 1.30 in 40 other records (`python -m tests.identify.small_drift_study`).
# Ratio of two neighbours: finer than the width of their likelihood.
LEAST_WAVE = 0.02
WAVE_RATIO = 2.5


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


class NoiseNode(NamedTuple):
    """One disturbance, and what the data say under it.

    Parameters
    ----------
    log_likelihood
        Marginal likelihood, up to a constant that is the same for all nodes.
    step
        Step of x from the point of linearisation, (P,).
    covariance
        Covariance of the step, (P, P).
    wave_sd
        Standard deviation of the first wave over that of the noise.
    """

    log_likelihood: float
    step: Array
    covariance: Array
    wave_sd: float = 0.0


@dataclass(frozen=True)
class LinearisedProblem:
    """A problem linearised at some x.

    Parameters
    ----------
    residual
        Residuals (N,).
    jacobian
        Jacobian (N, P) in the scale ``size`` of its columns; the last W columns are those of the
        slow waves.
    size
        Scale of the columns (P,); infinite for a fixed parameter.
    prior
        Rows of the prior, (C, P + 1), in the scale of ``jacobian``; the last column is their
        residual. The waves have none.
    segments
        Segments of the record without gaps.
    waves
        Values of the waves at the point of linearisation (W,).
    wave_shares
        Prior standard deviation of each wave over that of the first (W,).
    wave_sds
        Standard deviations of the first wave, over that of the noise, that are compared (A,). All
        are equally probable.
    """

    residual: Array
    jacobian: Array
    size: Array
    prior: Array
    segments: list[slice]
    waves: Array = field(default_factory=lambda: np.zeros(0))
    wave_shares: Array = field(default_factory=lambda: np.zeros(0))
    wave_sds: Array = field(default_factory=lambda: np.zeros(1))

    def marginal_likelihoods(self, noise: NoiseModel) -> list[NoiseNode]:
        """Marginal likelihood of a noise model with waves of each size, and the step of x under it.

        The noise level and x are integrated out. Sizes whose likelihood is far below that of the
        best are left out.

        Parameters
        ----------
        noise
            Noise model.

        Returns
        -------
        list of NoiseNode
            At most one for each of ``wave_sds``.

        Notes
        -----
        -2 ln L = (N - P + W) ln |w|^2 + ln det J'WJ - ln det of the prior of the waves + ln det of
        the noise (Patterson and Thompson 1971); J and w include the rows of the priors. The
        constants 1e-300 and 1e-12 only keep the logarithms finite for an exact fit and for
        collinear columns. Guarded by ``tests/estimation/test_noise_models.py``.
        """
        table = noise.whiten(np.column_stack([self.jacobian, self.residual]), self.segments)
        rows = np.asarray(np.linalg.qr(np.vstack([table, self.prior]), mode="r"))
        p = len(self.size)
        n_waves = len(self.waves)
        dof = len(self.residual) - p + n_waves
        # rows of the prior of the waves for each size (A, W, P + 1)
        root = 1 / np.outer(self.wave_sds, self.wave_shares) if n_waves else np.zeros((1, 0))
        prior = np.zeros((len(root), n_waves, p + 1))
        wave = np.arange(n_waves)
        prior[:, wave, p - n_waves + wave] = root / self.size[p - n_waves :]
        prior[:, wave, p] = root * self.waves
        stacked = np.concatenate([np.broadcast_to(rows, (len(root), *rows.shape)), prior], axis=1)
        factors = np.asarray(np.linalg.qr(stacked, mode="r"))
        residual_squares = factors[:, p, p] ** 2 + 1e-300
        diagonals = np.abs(np.diagonal(factors, axis1=1, axis2=2))[:, :p]
        free = np.isfinite(self.size)
        volumes = 2 * np.log(diagonals[:, free] + 1e-12).sum(axis=1)
        volumes -= 2 * np.log(root / self.size[p - n_waves :]).sum(axis=1)
        log_likelihoods = -0.5 * (
            dof * np.log(residual_squares) + volumes + noise.log_determinant(self.segments)
        )
        nodes = []
        for k in np.flatnonzero(log_likelihoods > log_likelihoods.max() - 2 * MAX_LOG_DROP):
            upper = factors[k, :p, :p]
            unit = inverse(upper.T @ upper)
            step = -unit @ (upper.T @ factors[k, :p, p]) / self.size
            covariance = residual_squares[k] / dof * unit / np.outer(self.size, self.size)
            nodes.append(
                NoiseNode(float(log_likelihoods[k]), step, covariance, float(self.wave_sds[k]))
            )
        return nodes


@dataclass(frozen=True)
class NoiseGrid:
    """Noise models on a grid, each with its marginal likelihoods and the steps of x under it.

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
        Nodes of each point, as ``marginal_likelihoods`` returns them.
    """

    box: Array
    points: Array
    noises: tuple[NoiseModel, ...]
    nodes: tuple[list[NoiseNode], ...]

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
            nodes = tuple(linearised.marginal_likelihoods(noise) for noise in noises)
            highest = np.array([max(node.log_likelihood for node in each) for each in nodes])
            likely_points = grid_points[highest > highest.max() - MAX_LOG_DROP]
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
    ) -> NoiseMixture:
        """Average over the grid and the noise models ``other_models``.

        All gains from 0 to 1 are equally probable, and so are logarithms of the time constant
        within the record, and beyond it. Each of the other_models is as probable as all first-order
        models together. The sizes of the slow waves are equally probable.

        Parameters
        ----------
        linearised
            The problem.
        other_models
            Noise models besides the grid.

        Returns
        -------
        NoiseMixture
            The average.

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
        noises = [*self.noises, *other_models]
        all_nodes = [*self.nodes, *map(linearised.marginal_likelihoods, other_models)]
        counts = [len(each) for each in all_nodes]
        nodes = [node for each in all_nodes for node in each]
        number = np.repeat(np.arange(len(noises)), counts)
        log_prior = np.log([*prior, *np.ones(len(other_models))])
        log_prior -= np.log(len(linearised.wave_sds))
        log_weight = np.array([node.log_likelihood for node in nodes]) + log_prior[number]
        evidence = float(logsumexp(log_weight))
        is_walk = np.append(walks, np.zeros(len(other_models), dtype=bool))[number]
        walk_share = float(np.exp(log_weight[is_walk] - evidence).sum())
        used = np.flatnonzero(log_weight > log_weight.max() - 2 * MAX_LOG_DROP)
        means = np.array([nodes[k].step for k in used])
        covariances = np.array([nodes[k].covariance for k in used])
        mean, covariance = mixture_moments(log_weight[used], means, covariances)
        wave_sds = np.array([nodes[k].wave_sd for k in used])
        parts = []
        for wave_sd in np.unique(wave_sds):
            of_size = wave_sds == wave_sd
            of_weight = log_weight[used][of_size]
            moments = mixture_moments(of_weight, means[of_size], covariances[of_size])
            weight = float(np.exp(logsumexp(of_weight) - evidence))
            parts.append(MixturePart(weight, *moments))
        best = int(np.argmax([node.log_likelihood for node in nodes]))
        return NoiseMixture(
            evidence,
            walk_share,
            noises[number[best]],
            nodes[best].wave_sd,
            mean,
            covariance,
            tuple(parts),
        )


class MixturePart(NamedTuple):
    """A normal distribution of a mixture: its weight, mean (P,) and covariance (P, P)."""

    weight: float
    mean: Array
    covariance: Array


class NoiseMixture(NamedTuple):
    """A linear estimate averaged over noise models.

    Parameters
    ----------
    evidence
        Log evidence.
    walk_share
        Probability of random walks.
    noise, wave_sd
        Most likely noise model, and size of the waves.
    step
        Mean step of x, (P,).
    covariance
        Its covariance, (P, P), with the spread between the models.
    parts
        The averages under waves of one size each, whose mixture may be skewed.
    """

    evidence: float
    walk_share: float
    noise: NoiseModel
    wave_sd: float
    step: Array
    covariance: Array
    parts: tuple[MixturePart, ...]


def wave_sizes(n: int, largest: float) -> Array:
    """Sizes of slow waves over the noise (A,), from one without effect to the largest.

    Parameters
    ----------
    n
        Number of samples.
    largest
        The largest, over the noise.

    Examples
    --------
    >>> wave_sizes(400, 1.0).round(3).tolist()
    [0.001, 0.002, 0.006, 0.016, 0.039, 0.098, 0.244, 0.61]
    """
    least = LEAST_WAVE / np.sqrt(n)
    count = int(np.log(max(largest / least, 1.0)) / np.log(WAVE_RATIO)) + 1
    return least * WAVE_RATIO ** np.arange(count, dtype=float)


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
