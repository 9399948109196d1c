"""Random-effects estimate of a positive quantity from several measurements.

``tcdyn.sensors.dips`` combines dips with it, ``tcdyn.sensors.dip_flows`` dips at several flows.
``tests/sensors/test_dips.py`` and ``python -m tests.sensors.dips_study`` check the coverage.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Z95, Estimate, mixture_interval95
from tcdyn.sensors.spread import MIN_WITHIN_U, SPREAD_SCALE, SPREADS, fit_spread_model


@dataclass(frozen=True)
class RandomEffects:
    """Distribution of the mean logarithm in each group, as a mixture over the spread.

    Attributes
    ----------
    spread
        Relative standard deviation between dips (T,).
    weights
        Probability of each value of ``spread`` (T,).
    mean, variance
        Mean logarithm of each group and its variance, at each value of ``spread`` (T, G).
    common_u
        Relative standard uncertainty that all dips share.
    """

    spread: Array
    weights: Array
    mean: Array
    variance: Array
    common_u: float

    @property
    def median_spread(self) -> float:
        """Median of the relative spread between dips."""
        probability = np.cumsum(self.weights) - 0.5 * self.weights
        return float(np.interp(0.5, probability, self.spread))

    def mean_estimate(self, group: int = 0) -> Estimate:
        """The mean of many dips of one group."""
        return self._estimate_of_logarithm(
            self.mean[:, group], self.variance[:, group] + self.common_u**2
        )

    def next_estimate(self) -> Estimate:
        """One further dip of the first group, which includes the spread between dips."""
        variance = self.variance[:, 0] + self.spread**2 + self.common_u**2
        return self._estimate_of_logarithm(self.mean[:, 0], variance)

    def at_median_spread(self) -> tuple[Array, Array]:
        """Mean logarithm of each group and its variance (G,), at the median of the spread."""
        k = int(np.argmin(np.abs(np.log(self.spread / self.median_spread))))
        return self.mean[k], self.variance[k]

    def departure_p(self, dip: Estimate) -> float:
        """p-value of another dip of the first group: two-sided, from its predictive distribution.

        Parameters
        ----------
        dip
            Its estimate, which is not among those of this result.

        Notes
        -----
        The dip is a draw from a mixture of normal distributions, whose variance is that of the
        mean, of the spread, and within the dip without the part that all dips share.
        """
        within = within_variances([dip], self.common_u)[0]
        sd = np.sqrt(self.variance[:, 0] + self.spread**2 + within)
        z = (np.log(dip.value) - self.mean[:, 0]) / sd
        below = float(self.weights @ ndtr(z))
        return 2 * min(below, 1 - below)

    def groups_differ(self) -> bool:
        """Whether the 95 % interval of the difference of the two groups excludes zero."""
        difference = self.mean[:, 0] - self.mean[:, 1]
        low, high = self._mixture_interval95(difference, self.variance.sum(axis=1))
        return not low <= 0 <= high

    def _mixture_interval95(self, mean: Array, variance: Array) -> tuple[float, float]:
        """95 % interval of the mixture of normal distributions."""
        parts = [Estimate.normal(m, v**0.5) for m, v in zip(mean, variance)]
        return mixture_interval95(parts, self.weights.tolist())

    def _estimate_of_logarithm(self, mean: Array, variance: Array) -> Estimate:
        """Estimate of the quantity whose logarithm has this mixture.

        u is the half width of the 95 % interval over 1.96, so that a normal distribution with this
        u has an interval of that width.
        """
        low, high = np.exp(self._mixture_interval95(mean, variance))
        value = float(np.exp(self.weights @ mean))
        return Estimate(value=value, u=(high - low) / (2 * Z95), low95=low, high95=high)


def random_effects(
    dips: Sequence[Estimate],
    group: Sequence[int] | None = None,
    common_u: float = 0.0,
    spread: RandomEffects | None = None,
) -> RandomEffects:
    """Combine estimates of a positive quantity from several dips.

    Parameters
    ----------
    dips
        Estimate of each dip (K,).
    group
        Group of each dip, from 0 on (K,); None: all are one group.
    common_u
        Part of the relative standard uncertainties that all dips share, such as that of the shorter
        lags of the sensor.
    spread
        Result of the quantity that determines the spread of these dips, see ``best_of_spread``;
        None: the spread is that of these estimates.

    Returns
    -------
    RandomEffects
        Distribution of the mean of each group; the groups have one spread.

    Notes
    -----
    log y_k = mu_g + b_k + e_k, with b_k ~ N(0, tau^2) between dips and e_k ~ N(0, s_k^2) within
    dip k, s_k = u_k / y_k: see :func:`tcdyn.sensors.spread.fit_spread_model`. In contrast to the
    interval of Hartung, Knapp, Sidik and Jonkman, which needs no prior, two dips give a useful
    interval: its Student factor is 12.7.

    The part ``common_u`` is left out of the s_k and added to the results.

    Examples
    --------
    >>> pooled = random_effects([Estimate.normal(1.50, 0.01), Estimate.normal(1.60, 0.01)])
    >>> print(pooled.mean_estimate(), pooled.next_estimate(), sep="; ")
    1.55 +- 0.12; 1.55 +- 0.20
    """
    log_value = np.log(positive_values(dips))
    index = np.zeros(len(dips), dtype=int) if group is None else np.asarray(group)
    in_group = (index[:, None] == np.arange(index.max() + 1)).astype(float)
    model = fit_spread_model(log_value, within_variances(dips, common_u), in_group)
    weights = model.weights if spread is None else spread.weights
    variance = np.diagonal(model.covariance, axis1=1, axis2=2)
    return RandomEffects(SPREADS, weights, model.mean, variance, common_u)


def with_one_spread(
    quantities: Sequence[Sequence[Estimate]], common_u: Sequence[float]
) -> list[RandomEffects]:
    """Combine several quantities of the same dips, which have one spread.

    Parameters
    ----------
    quantities
        Estimates of each dip, for each quantity (Q): the lag, or a percent time.
    common_u
        Relative standard uncertainty that all dips share, of each quantity (Q,).

    Returns
    -------
    list of RandomEffects
        One for each quantity.

    Notes
    -----
    log y_kq = mu_q + b_k + e_kq: a dip has one factor exp(b_k) of all its times. The spread is
    estimated from the quantity that determines it best, see ``best_of_spread``.

    Examples
    --------
    >>> lags = [Estimate.normal(1.5, 0.1), Estimate.normal(1.6, 0.1)]
    >>> times = [Estimate.normal(1.10, 0.01), Estimate.normal(1.11, 0.01)]
    >>> lag, time = with_one_spread([lags, times], [0.0, 0.0])
    >>> lag.median_spread == time.median_spread < random_effects(lags).median_spread
    True
    """
    best = best_of_spread(quantities, common_u)
    spread = random_effects(quantities[best], common_u=common_u[best])
    return [
        random_effects(dips, common_u=u, spread=spread) for dips, u in zip(quantities, common_u)
    ]


def positive_values(dips: Sequence[Estimate]) -> Array:
    """The values (K,).

    Raises
    ------
    InputError
        For a value that is not positive.
    """
    values = np.array([dip.value for dip in dips])
    if not np.all(values > 0):
        raise InputError(f"a lag of {values.min():.4g} s", expected="lags above zero")
    return values


def within_variances(dips: Sequence[Estimate], common_u: float) -> Array:
    """Variance (K,) of the logarithm within each dip, without the part that all dips share."""
    relative_u = np.array([dip.u / dip.value for dip in dips])
    return np.asarray(np.maximum(relative_u**2 - common_u**2, MIN_WITHIN_U**2))


def best_of_spread(quantities: Sequence[Sequence[Estimate]], common_u: Sequence[float]) -> int:
    """Index of the quantity that determines the spread between dips best.

    Parameters
    ----------
    quantities
        Estimates of each dip, for each quantity of the same dips.
    common_u
        Relative standard uncertainty that all dips share, of each quantity.

    Notes
    -----
    The Fisher information of K dips about tau^2 is sum 1 / (2 (s_k^2 + tau^2)^2); tau is taken at
    ``SPREAD_SCALE``. Only the standard uncertainties within the dips decide, not the values, so
    that the choice does not favour a small or a large spread. The errors of the quantities of one
    dip have a correlation near one: together they say hardly more than the best one.

    Examples
    --------
    >>> vague = [Estimate.normal(1.5, 0.1), Estimate.normal(1.6, 0.1)]
    >>> sharp = [Estimate.normal(1.1, 0.01), Estimate.normal(1.2, 0.01)]
    >>> best_of_spread([vague, sharp], [0.0, 0.0])
    1
    """
    information = [
        float(np.sum(1 / (within_variances(dips, u) + SPREAD_SCALE**2) ** 2))
        for dips, u in zip(quantities, common_u)
    ]
    return int(np.argmax(information))
