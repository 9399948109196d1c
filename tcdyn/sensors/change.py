"""Whether a lag changed with time: a steady change or one step, against no change.

Used by :mod:`tcdyn.sensors.history`. ``python -m tests.sensors.history_study`` measures the rate of
false alarms, the power and the coverage; ``tests/sensors/test_history.py`` is a short form of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from tcdyn.core import Array
from tcdyn.core.estimate import Z95, Estimate, mixture_interval95
from tcdyn.sensors.spread import SPREADS, SpreadModel, fit_spread_model, spread_prior

DAYS_A_YEAR = 365.25
# Standard deviation of the normal prior of a change of the logarithm. It decides on the power only,
# since the p value is determined by simulation; chosen by judgement.
CHANGE_SCALE = 0.1
# Simulated histories of a steady sensor for the p value: a p value of 5 % has a standard deviation
# of 0.7 %.
DRAWS = 999
# Combinations of spread and shape below this share of the probability are left out of an interval;
# chosen by judgement.
MIN_WEIGHT = 1e-5
LARGEST_LOG = 50.0  # beyond it a change is not determined, and its exponential overflows
# Most instants of a step that are compared, evenly among the measurements; chosen by judgement.
MAX_STEPS = 50
# Least number of measurements on each side of a step, where there are twice as many: one that is an
# outlier is no step. Chosen by judgement.
MIN_ON_A_SIDE = 2


@dataclass(frozen=True)
class Change:
    """How a positive quantity changed with time.

    Attributes
    ----------
    total
        Relative change [1] over the record, averaged over a steady change and steps.
    per_year
        Rate of the logarithm in a year [1/year], if it changes steadily.
    p_value
        Probability that a steady sensor gives at least this evidence of a change.
    step_probability
        Probability of a step rather than a steady change, if there is one of them.
    step
        Relative change [1] at the likeliest step.
    step_days, step_range_days
        Times of the measurements before and after it; range that contains it with 95 % probability.
    model
        The steady change: coefficients are the logarithm at time 0 and its change in a day.
    """

    total: Estimate
    per_year: Estimate
    p_value: float
    step_probability: float
    step: Estimate
    step_days: tuple[float, float]
    step_range_days: tuple[float, float]
    model: SpreadModel

    def level(self, days: float) -> Estimate:
        """The quantity at a time, by the steady change.

        Parameters
        ----------
        days
            The time [d].
        """
        log_level = self.model.estimate(np.array([1.0, days]))
        return _relative(log_level).shifted(1.0)


def find_change(days: Array, log_value: Array, within_variance: Array) -> Change:
    """Estimate a change with time, and test it.

    Parameters
    ----------
    days
        Times of the measurements (K,), at least two different ones [d].
    log_value
        Logarithms (K,).
    within_variance
        Their variances without what all of them share (K,).

    Returns
    -------
    Change
        The change.

    Notes
    -----
    log y_k = a + d x(t_k) + b_k + e_k as in :func:`~tcdyn.sensors.spread.fit_spread_model`. x rises
    linearly from 0 to 1 over the record, or steps at one instant. Both have the prior probability
    1/2, all instants of a step are equally probable, and d ~ N(0, ``CHANGE_SCALE``^2). The evidence
    of a change is its marginal likelihood over that of d = 0. The p value is the share of
    ``DRAWS`` histories of a steady sensor, with these times and uncertainties and a spread from its
    posterior without a change, whose evidence is at least as large. The estimates have a flat prior
    of d.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> days = 7.0 * np.arange(52)
    >>> slower = find_change(days, 3e-4 * days + rng.normal(0, 0.03, 52), np.full(52, 0.02**2))
    >>> slower.p_value < 0.01, 0.05 < slower.total.value < 0.15
    (True, True)
    """
    order = np.argsort(days, kind="stable")
    t, y, variance = days[order], log_value[order], within_variance[order]
    span = float(t[-1] - t[0])
    after = _first_after_steps(t)
    shapes = np.array([(t - t[0]) / span, *(np.arange(len(t)) >= k for k in after)], dtype=float)
    log_shape_prior = np.log(np.r_[0.5, np.full(len(after), 0.5 / len(after))])
    evidence = _Evidence(shapes, variance, log_shape_prior)
    log_ratio, log_null, log_weight = evidence.of(y[None])
    weights = np.exp(log_weight[0] - logsumexp(log_weight[0]))
    of_shape = weights.sum(axis=0)
    of_steady = np.exp(log_null[0] - logsumexp(log_null[0]))
    p_value = evidence.p_value(float(log_ratio[0]), of_steady)
    steps = of_shape[1:] / of_shape[1:].sum()
    best = int(np.argmax(steps))
    last_before = t[after - 1]
    low, high = np.searchsorted(np.cumsum(steps), [0.025, 0.975])
    high = min(high, len(after) - 1)
    ones = np.ones(len(t))
    line = fit_spread_model(y, variance, np.column_stack([ones, t]))
    step = fit_spread_model(y, variance, np.column_stack([ones, shapes[1 + best]]))
    return Change(
        total=_relative(evidence.size(y, weights)),
        per_year=line.estimate(np.array([0.0, DAYS_A_YEAR])),
        p_value=p_value,
        step_probability=float(1 - of_shape[0]),
        step=_relative(step.estimate(np.array([0.0, 1.0]))),
        step_days=(float(last_before[best]), float(t[after[best]])),
        step_range_days=(float(last_before[low]), float(t[after[high]])),
        model=line,
    )


def _first_after_steps(t: Array) -> Array:
    """Indices of the first measurement after each possible step, of rising times (K,)."""
    count = len(t)
    margin = MIN_ON_A_SIDE if count >= 2 * MIN_ON_A_SIDE else 1
    first = np.flatnonzero(np.diff(t) > 0) + 1
    inside = first[(first >= margin) & (first <= count - margin)]
    if not len(inside):
        inside = first
    chosen = np.linspace(0, len(inside) - 1, min(len(inside), MAX_STEPS)).round().astype(int)
    return np.asarray(inside[chosen])


def _relative(of_logarithm: Estimate) -> Estimate:
    """Relative change from the change of the logarithm; u is the half width over 1.96."""
    ends = (of_logarithm.low95, of_logarithm.value, of_logarithm.high95)
    low, value, high = (float(np.expm1(min(end, LARGEST_LOG))) for end in ends)
    return Estimate(value=value, u=(high - low) / (2 * Z95), low95=low, high95=high)


class _Evidence:
    """Marginal likelihoods of changes of several shapes, for given uncertainties.

    Attributes
    ----------
    variance
        Known variances (K,).
    log_null_prior
        Of each spread: logarithm of its prior and of the terms that depend on no reading (T,).
    weights
        Weight of each measurement (T, K).
    scores
        Combination of readings that is a shape's size over its standard uncertainty (T, J, K).
    information
        Inverse variance of the size of each shape (T, J).
    shrinkage, log_shape_prior
        s^2 / (s^2 + V) for prior s^2 and variance V of the size; logarithm of the prior
        probability of a shape, with the likelihood's terms that depend on no reading (T, J).
    """

    def __init__(self, shapes: Array, variance: Array, log_shape_prior: Array) -> None:
        """Prepare for shapes (J, K), variances (K,) and prior probabilities (J,)."""
        total = variance + SPREADS[:, None] ** 2
        self.variance = variance
        self.weights = 1 / total
        sums = self.weights.sum(axis=1)
        self.log_null_prior = np.log(spread_prior())
        self.log_null_prior -= 0.5 * (np.log(total).sum(axis=1) + np.log(sums))
        mean_shape = self.weights @ shapes.T / sums[:, None]
        centred = shapes[None] - mean_shape[:, :, None]
        weighted = centred * self.weights[:, None]
        information = np.sum(weighted * centred, axis=2)
        self.scores = weighted / np.sqrt(information)[:, :, None]
        self.information = information
        self.shrinkage = information / (information + CHANGE_SCALE**-2)
        self.log_shape_prior = log_shape_prior + 0.5 * np.log1p(-self.shrinkage)

    def of(self, y: Array) -> tuple[Array, Array, Array]:
        """Evidence of a change in each of several records (D, K).

        Returns
        -------
        log_ratio
            Logarithm of the evidence (D,).
        log_null, log_weight
            Logarithm of prior and likelihood of each spread, without a change (D, T) and with each
            shape of it (D, T, J).
        """
        z = (y @ self.scores.reshape(-1, y.shape[1]).T).reshape(-1, *self.shrinkage.shape)
        sums = y @ self.weights.T
        chi2 = (y**2) @ self.weights.T - sums**2 / self.weights.sum(axis=1)
        log_null = self.log_null_prior - 0.5 * chi2
        log_weight = log_null[:, :, None] + self.log_shape_prior + 0.5 * self.shrinkage * z**2
        log_ratio = logsumexp(log_weight, axis=(1, 2)) - logsumexp(log_null, axis=1)
        return np.asarray(log_ratio), np.asarray(log_null), np.asarray(log_weight)

    def size(self, y: Array, weights: Array) -> Estimate:
        """Size of the change of one record (K,), averaged with the weights (T, J)."""
        sizes = self.scores @ y / np.sqrt(self.information)
        used = weights > MIN_WEIGHT
        shares = weights[used] / weights[used].sum()
        sds = self.information[used] ** -0.5
        parts = [Estimate.normal(size, sd) for size, sd in zip(sizes[used], sds)]
        low, high = mixture_interval95(parts, shares.tolist())
        value = float(shares @ sizes[used])
        return Estimate(value=value, u=(high - low) / (2 * Z95), low95=low, high95=high)

    def p_value(self, log_ratio: float, spread_weights: Array) -> float:
        """Share of simulated steady records with at least this evidence.

        Parameters
        ----------
        log_ratio
            Logarithm of the evidence.
        spread_weights
            Probability of each spread (T,), from which the simulated ones are drawn.
        """
        rng = np.random.default_rng(1)
        spread = rng.choice(SPREADS, DRAWS, p=spread_weights)
        sd = np.sqrt(self.variance + spread[:, None] ** 2)
        steady = sd * rng.standard_normal((DRAWS, len(self.variance)))
        larger = 0
        for part in np.array_split(steady, 20):  # memory
            larger += int(np.count_nonzero(self.of(part)[0] >= log_ratio))
        return (1 + larger) / (1 + DRAWS)
