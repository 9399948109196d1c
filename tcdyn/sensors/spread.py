"""Linear models of logarithms with an unknown spread between measurements.

Several dips of one sensor (:mod:`tcdyn.sensors.dips`) and the history of a lag
(:mod:`tcdyn.sensors.history`) use it. ``tests/sensors/test_dips.py`` and
``tests/sensors/test_history.py`` check the coverage of the intervals.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tcdyn.core import Array
from tcdyn.core.estimate import Z95, Estimate, mixture_interval95

# Scale of the half-Cauchy prior of the relative spread between dips: its median. Public dips of one
# RTD differ by 11 %, a standard deviation of 5 %.
SPREAD_SCALE = 0.05
# Values of the relative spread over which the results are averaged: beyond each end lies 1 % of the
# prior. Twice as many values change u by less than 1 %.
SPREADS = np.geomspace(1e-3, 3.0, 40)
MIN_WITHIN_U = 1e-6  # least relative standard uncertainty within a dip


def spread_prior() -> Array:
    """Probability of each value of ``SPREADS`` (T,): half-Cauchy of scale ``SPREAD_SCALE``."""
    edges = np.concatenate([[0.0], np.sqrt(SPREADS[1:] * SPREADS[:-1]), [np.inf]])
    return np.asarray(np.diff(np.arctan(edges / SPREAD_SCALE)))


@dataclass(frozen=True)
class SpreadModel:
    """Distribution of the coefficients of a linear model, as a mixture over the spread.

    Attributes
    ----------
    weights
        Probability of each value of ``SPREADS`` (T,).
    mean
        Coefficients at each value (T, P).
    covariance
        Their covariance (T, P, P).
    """

    weights: Array
    mean: Array
    covariance: Array

    @property
    def median_spread(self) -> float:
        """Median of the relative spread between measurements."""
        probability = np.cumsum(self.weights) - 0.5 * self.weights
        return float(np.interp(0.5, probability, SPREADS))

    def estimate(self, row: Array, further_u: float = 0.0) -> Estimate:
        """Estimate of ``row @ coefficients`` plus an error of mean zero.

        Parameters
        ----------
        row
            Weights of the coefficients (P,).
        further_u
            Standard deviation of the error.

        Notes
        -----
        u is the half width of the 95 % interval over 1.96.
        """
        mean = self.mean @ row
        variance = np.einsum("i,tij,j->t", row, self.covariance, row) + further_u**2
        parts = [Estimate.normal(m, v**0.5) for m, v in zip(mean, variance)]
        low, high = mixture_interval95(parts, self.weights.tolist())
        value = float(self.weights @ mean)
        return Estimate(value=value, u=(high - low) / (2 * Z95), low95=low, high95=high)


def fit_spread_model(log_value: Array, within_variance: Array, design: Array) -> SpreadModel:
    """Fit a linear model whose errors have a known and an unknown part.

    Parameters
    ----------
    log_value
        Logarithm of each measurement (K,).
    within_variance
        Known variance of each (K,).
    design
        Design matrix (K, P), of rank P.

    Returns
    -------
    SpreadModel
        Distribution of the coefficients.

    Notes
    -----
    y = X beta + b + e, with b_k ~ N(0, tau^2) between measurements and e_k ~ N(0, s_k^2) within
    measurement k. beta has a flat prior, tau a half-Cauchy prior of scale ``SPREAD_SCALE`` (Gelman
    2006, Bayesian Analysis 1, 515). At a given tau, beta is normal by weighted least squares with
    the weights 1 / (s_k^2 + tau^2); tau has the marginal likelihood
    prod (s_k^2 + tau^2)^(-1/2) |X'WX|^(-1/2) exp(-chi^2 / 2), and the result is the mixture over
    tau (Roever 2020, J. Stat. Softw. 93, 6).

    Examples
    --------
    >>> same = fit_spread_model(np.log([1.5, 1.6]), np.full(2, 1e-4), np.ones((2, 1)))
    >>> round(same.estimate(np.ones(1)).value, 3), bool(same.median_spread > 0.02)
    (0.438, True)
    """
    total = within_variance + SPREADS[:, None] ** 2
    information = np.einsum("ki,tk,kj->tij", design, 1 / total, design)
    covariance = np.linalg.inv(information)
    mean = np.einsum("tij,kj,tk->ti", covariance, design, log_value / total)
    residual = log_value - mean @ design.T
    chi2 = np.sum(residual**2 / total, axis=1)
    log_determinant = np.linalg.slogdet(information)[1]
    log_likelihood = -0.5 * (np.log(total).sum(axis=1) + log_determinant + chi2)
    weights = spread_prior() * np.exp(log_likelihood - log_likelihood.max())
    return SpreadModel(weights / weights.sum(), mean, covariance)
