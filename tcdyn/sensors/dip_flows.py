"""The lag of a sensor from dips at several flows: exponent, inner share and spread between dips.

``tcdyn.sensors.dips`` uses it. ``python -m tests.sensors.dips_study flows`` checks the coverage of
lag, exponent and inner share with layered sensors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.stats import chi2 as chi_squared

from tcdyn.chain import Chain
from tcdyn.chain.law import FlowLaw
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate, mixture
from tcdyn.sensors.pair import EXPONENT, INNER_SHARE, LARGEST_SHARE
from tcdyn.sensors.random_effects import (
    RandomEffects,
    positive_values,
    random_effects,
    within_variances,
)
from tcdyn.sensors.spread import SPREADS, spread_prior

# Points of the grids of exponent and inner share. Half as many change u of the lag and of exponent
# and share by less than 1 % (`python -m tests.sensors.dips_study grid`).
N_EXPONENTS = 61
N_SHARES = 191
# Half width of the grid of a normal prior, in standard deviations: 0.006 % lie beyond
PRIOR_WIDTH = 4.0
# Probability with which dips that follow the law contradict it, at the spread of the dips
FALSE_CONTRADICTION = 0.01
# Least relative difference of the largest and the smallest flow: with less there is one flow, and
# the dips say nothing about the law; by judgement
LEAST_RANGE = 0.05


@dataclass(frozen=True)
class DipFlows:
    """Flows of the dips, and what is known of the law of the lag before them.

    Parameters
    ----------
    quantity
        What the flow is, with its unit, such as speed_m_s.
    values
        Flow of each dip (K,), in the order of the dips.
    exponent
        Prior of the exponent of the film: mean and standard deviation.
    inner_share
        Prior of the share of the lag at ``at`` that does not follow the flow; None: with one dip
        that of :data:`tcdyn.sensors.pair.INNER_SHARE`, with several uniform from 0 to
        :data:`tcdyn.sensors.pair.LARGEST_SHARE`.

    Raises
    ------
    InputError
        For a flow that is not positive, and a prior that no film can have.

    Examples
    --------
    >>> DipFlows("speed_m_s", (1.0, 4.0)).at
    2.0
    """

    quantity: str
    values: tuple[float, ...]
    exponent: tuple[float, float] = EXPONENT
    inner_share: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        for value in self.values:
            if not 0 < value < np.inf:
                raise InputError(
                    f"{{at}} is {value:g}", expected="a flow above 0", parameters={"at": None}
                )
        if not 0 <= self.exponent[0] <= 1:
            raise InputError(
                f"{{exponent}} is {self.exponent[0]:g}",
                expected="0 to 1",
                parameters={"exponent": None},
            )
        if self.inner_share is not None and not 0 <= self.inner_share[0] <= LARGEST_SHARE:
            raise InputError(
                f"{{inner_share}} is {self.inner_share[0]:g}",
                expected=f"0 to {LARGEST_SHARE:g}",
                parameters={"inner_share": None},
            )

    @property
    def at(self) -> float:
        """Flow at which the lag is stated: the geometric mean, to six digits.

        There the errors of the lag and of the law are nearly independent, as the sensor file has
        them. At the flow of the first dip they would not be.
        """
        if len(self.values) == 1:
            return self.values[0]
        return float(f"{np.exp(np.mean(np.log(self.values))):.6g}")

    @property
    def prior_law(self) -> FlowLaw:
        """The law before the dips."""
        share, share_u = self.inner_share or INNER_SHARE
        return FlowLaw(self.at, *self.exponent, share, share_u, quantity=self.quantity)

    def exponent_grid(self) -> tuple[Array, Array]:
        """Exponents (N,) and their prior probabilities."""
        return _normal_grid(*self.exponent, 1.0, N_EXPONENTS)

    def share_grid(self) -> tuple[Array, Array]:
        """Inner shares (S,) and their prior probabilities."""
        if self.inner_share is None:
            shares = np.linspace(0, LARGEST_SHARE, N_SHARES)
            return shares, np.full(N_SHARES, 1 / N_SHARES)
        return _normal_grid(*self.inner_share, LARGEST_SHARE, N_SHARES)

    def log_factors(self, flows: Sequence[float]) -> Array:
        """Logarithm of the lag at flows (K,) over that at ``at``, on both grids (N, S, K)."""
        n = self.exponent_grid()[0][:, None, None]
        s = self.share_grid()[0][:, None]
        relative = np.asarray(flows, dtype=float) / self.at
        return np.asarray(np.log(s + (1 - s) * relative**-n))

    def of(self, dips: Sequence[int]) -> DipFlows:
        """The same for some of the dips; the prior of the share is that at their own mean flow."""
        return replace(self, values=tuple(self.values[k] for k in dips))

    def check_range(self) -> None:
        """Check that several dips are at different flows.

        Raises
        ------
        InputError
            Where they are not.
        """
        if len(self.values) > 1 and max(self.values) < (1 + LEAST_RANGE) * min(self.values):
            raise InputError(
                f"all dips are at {self.quantity} = {self.values[0]:g}",
                expected="two or more flows, which differ clearly",
                remedy="leave {at} out: without it the dips are those of one flow",
                parameters={"at": None},
            )


@dataclass(frozen=True)
class FlowEffects:
    """Posterior of lag, exponent, inner share and spread between dips, on a grid.

    Attributes
    ----------
    flows
        Flows and priors.
    weights
        Probability on the grid of exponent, share and spread (N, S, T).
    mean, variance
        Mean logarithm of the lag at ``flows.at`` and its variance, at each point (N, S, T).
    common_u_s
        Standard uncertainty that all dips share [s].
    misfit_p
        p-value of the mean lags at the flows under the law.
    """

    flows: DipFlows
    weights: Array
    mean: Array
    variance: Array
    common_u_s: float
    misfit_p: float

    @property
    def contradicts(self) -> bool:
        """Whether the lags at the flows depart from the law by more than chance."""
        return self.misfit_p < FALSE_CONTRADICTION

    def lag_at(self, flow: float) -> RandomEffects:
        """The lag at a flow, as a mixture over the spread between dips."""
        mean = self.mean + self.flows.log_factors([flow])
        return _over_law(self.weights, mean, self.variance, self.common_u_s)

    @cached_property
    def lag_u_of_law(self) -> float:
        """Relative standard uncertainty of the lag at ``flows.at`` from exponent and share."""
        mean = np.sum(self.weights * self.mean, axis=2)
        law = self.weights.sum(axis=2)
        mean /= np.maximum(law, 1e-300)
        return float(np.sqrt(np.sum(law * (mean - np.sum(law * mean)) ** 2)))

    @cached_property
    def exponent(self) -> Estimate:
        """Exponent of the film."""
        return _grid_estimate(self.flows.exponent_grid()[0], self.weights.sum(axis=(1, 2)))

    @cached_property
    def inner_share(self) -> Estimate:
        """Share of the lag at ``flows.at`` that does not follow the flow."""
        share = _grid_estimate(self.flows.share_grid()[0], self.weights.sum(axis=(0, 2)))
        # the error that all dips share is one of the inner part
        lag_s = self.lag_at(self.flows.at).mean_estimate().value
        return share.with_error((1 - share.value) * self.common_u_s / lag_s)

    def parts_s(self) -> tuple[Estimate, Estimate]:
        """Film and inner part [s] of the mean lag at ``flows.at``."""
        shares = self.flows.share_grid()[0]
        of_share = self.weights.sum(axis=(0, 2))
        used = np.flatnonzero(of_share > 0)
        at_share = self.weights / np.maximum(of_share, 1e-300)[:, None]
        mean = np.sum(at_share * self.mean, axis=(0, 2))
        square = np.sum(at_share * (self.variance + (self.mean - mean[:, None]) ** 2), axis=(0, 2))
        lags = [Estimate.normal(np.exp(mean[k]), np.exp(mean[k]) * square[k] ** 0.5) for k in used]
        weights = of_share[used].tolist()
        film = mixture([_part(lag, 1 - s) for lag, s in zip(lags, shares[used])], weights)
        inner = mixture([_part(lag, s) for lag, s in zip(lags, shares[used])], weights)
        return film, inner.with_error(self.common_u_s)

    @cached_property
    def law(self) -> FlowLaw:
        """The law of the lag, with the correlation of exponent and share."""
        n = self.flows.exponent_grid()[0] - self.exponent.value
        s = self.flows.share_grid()[0] - self.inner_share.value
        covariance = float(n @ self.weights.sum(axis=2) @ s)
        product = self.exponent.u * self.inner_share.u
        return FlowLaw(
            self.flows.at,
            self.exponent.value,
            self.exponent.u,
            self.inner_share.value,
            self.inner_share.u,
            quantity=self.flows.quantity,
            correlation=float(np.clip(covariance / product, -1, 1)) if product > 0 else 0.0,
        )


def flow_effects(dips: Sequence[Estimate], flows: DipFlows, common_u_s: float) -> FlowEffects:
    """Combine the lags of dips at several flows.

    Parameters
    ----------
    dips
        Lag of each dip (K,) [s].
    flows
        Their flows, and the priors.
    common_u_s
        Part of the standard uncertainties that all dips share [s].

    Returns
    -------
    FlowEffects
        The posterior.

    Notes
    -----
    log y_k = log L + log(s + (1 - s) (v_k / v_0)^-n) + b_k + e_k, with b_k ~ N(0, tau^2) between
    dips and e_k ~ N(0, s_k^2) within dip k. The film coefficient is proportional to v^n, and the
    share s of the lag L at v_0 is inside the sensor. log L has a flat prior and is integrated
    analytically, since the model is linear in it. n, s and tau are integrated on grids. The prior
    of tau is that of :func:`~tcdyn.sensors.random_effects.random_effects`: the lags of two flows
    determine neither the spread nor n and s by themselves, so that their priors decide.

    Examples
    --------
    A film of 0.8 s and an inner part of 0.2 s at a flow of 1: 0.6 s at a flow of 4.

    >>> lags = [Estimate.normal(1.0, 0.01), Estimate.normal(0.6, 0.006)]
    >>> both = flow_effects(lags, DipFlows("speed_m_s", (1.0, 4.0)), 0.0)
    >>> print(both.lag_at(both.flows.at).mean_estimate(), both.exponent, sep="; ")
    0.765 +- 0.066; 0.506 +- 0.087
    """
    log_lag = np.log(positive_values(dips))
    within = _within(dips, common_u_s)
    weight = 1 / (within[:, None] + SPREADS**2)
    x = log_lag - flows.log_factors(flows.values)
    information = weight.sum(axis=0)
    mean = x @ weight / information
    chi2 = x**2 @ weight - mean**2 * information
    log_likelihood = 0.5 * (np.log(weight).sum(axis=0) - np.log(information) - chi2)
    prior = np.multiply.outer(flows.exponent_grid()[1], flows.share_grid()[1])
    weights = np.multiply.outer(prior, spread_prior())
    weights *= np.exp(log_likelihood - log_likelihood.max())
    variance = np.broadcast_to(1 / information, mean.shape)
    misfit_p = _misfit_p(dips, flows, common_u_s)
    return FlowEffects(flows, weights / weights.sum(), mean, variance, common_u_s, misfit_p)


def _misfit_p(dips: Sequence[Estimate], flows: DipFlows, common_u_s: float) -> float:
    """p-value of the mean lags at the flows under the law and its priors.

    Notes
    -----
    The least sum of squares of the means about the law, with that of the exponent about its prior,
    has one degree of freedom less than there are flows, if the law is linear in its parameters
    (Box 1980: prior predictive check). The uniform prior of the share makes the p-value larger, not
    smaller. The spread is the median of that among dips of one flow; with one dip at each flow it
    is that of the prior.
    """
    different, group = np.unique(flows.values, return_inverse=True)
    if len(different) < 2:
        return 1.0
    common_u = common_u_s / float(np.mean([dip.value for dip in dips]))
    mean, variance = random_effects(dips, group.tolist(), common_u).at_median_spread()
    x = mean - flows.log_factors(different.tolist())
    centre = x @ (1 / variance) / np.sum(1 / variance)
    chi2 = np.sum((x - centre[..., None]) ** 2 / variance, axis=-1)
    for axis, (grid, prior) in enumerate(
        zip((flows.exponent_grid()[0], flows.share_grid()[0]), (flows.exponent, flows.inner_share))
    ):
        if prior is None or prior[1] == 0:
            continue
        z2 = ((grid - prior[0]) / prior[1]) ** 2
        chi2 = chi2 + (z2[:, None] if axis == 0 else z2)
    return float(chi_squared.sf(chi2.min(), len(different) - 1))


def chain_at(chain: Chain, ratio: float, inner_share: float) -> Chain | None:
    """The chain where its whole lag has a factor because the film has changed.

    Parameters
    ----------
    chain
        Chain at the flow of the dip.
    ratio
        Lag of the sensor at the other flow over that at this one.
    inner_share
        Share of the lag at the other flow that is inside the sensor.

    Returns
    -------
    Chain or None
        The chain, whose largest lag changes with the film and contains it; the other times are
        scaled where the film is longer than that lag. None for a slow path, which is not part of a
        chain that follows a flow.
    """
    plain = without_zero(chain)
    if plain is None:
        return None
    sensor_s = plain.lag_s - plain.conditioning.lag_s
    first_s, *others_s = plain.taus_s
    new_s = sensor_s * ratio
    new_first_s = first_s + new_s - sensor_s
    film_s = (1 - inner_share) * new_s
    if new_first_s >= film_s:
        return replace(plain, taus_s=(new_first_s, *others_s))
    rest_s = sensor_s - first_s
    factor = (new_s - film_s) / rest_s if rest_s > 0 else 0.0
    new_first_s = film_s if rest_s > 0 else new_s
    taus_s = [new_first_s, *(factor * tau_s for tau_s in others_s)]
    return replace(plain, taus_s=tuple(taus_s), delay_s=factor * plain.delay_s)


def without_zero(chain: Chain) -> Chain | None:
    """The chain with its zero taken from its shortest lag, as the law of a lag needs it.

    The lag, the first moment, does not change. None where the zero is longer, as of a slow path,
    and for a pair of poles or a layer of cement.
    """
    if chain.pair or chain.cement_s or not chain.taus_s:
        return None
    if not chain.zero_s:
        return chain
    *longer_s, shortest_s = sorted(chain.taus_s, reverse=True)
    if not longer_s or not 0 < chain.zero_s < shortest_s:
        return None
    return replace(chain, taus_s=(*longer_s, shortest_s - chain.zero_s), zero_s=0.0)


def law_of_chain(law: FlowLaw, chain: Chain) -> FlowLaw:
    """The law of a lag as that of the sum of the lags of a chain.

    Parameters
    ----------
    law
        Law of the whole lag, with its dead time.
    chain
        The chain, without a zero.

    Returns
    -------
    FlowLaw
        The law whose film is the same part of the lags, or their largest if it would be more.
    """
    sensor_s = chain.lag_s - chain.conditioning.lag_s
    lags_s = sum(chain.taus_s)
    ratio = sensor_s / lags_s
    share = 1 - (1 - law.inner_share) * ratio
    least = 1 - max(chain.taus_s) / lags_s
    return replace(
        law,
        inner_share=float(np.clip(share, least, LARGEST_SHARE)),
        inner_share_u=law.inner_share_u * ratio,
    )


def _normal_grid(mean: float, sd: float, largest: float, points: int) -> tuple[Array, Array]:
    """Values from 0 to ``largest`` and their probabilities under a normal prior."""
    if sd == 0:
        return np.array([mean]), np.ones(1)
    low = max(mean - PRIOR_WIDTH * sd, 0.0)
    high = min(mean + PRIOR_WIDTH * sd, largest)
    values = np.linspace(low, high, points)
    density = np.exp(-0.5 * ((values - mean) / sd) ** 2)
    return values, density / density.sum()


def _grid_estimate(values: Array, probability: Array) -> Estimate:
    """Mean, standard deviation and 95 % interval of values on an even grid."""
    if len(values) == 1:
        return Estimate.normal(values[0], 0.0)
    mean = float(probability @ values)
    u = float(np.sqrt(probability @ (values - mean) ** 2))
    below = np.cumsum(probability) - 0.5 * probability
    low95, high95 = np.interp([0.025, 0.975], below, values)
    return Estimate(value=mean, u=u, low95=low95, high95=high95)


def _within(dips: Sequence[Estimate], common_u_s: float) -> Array:
    """Variance (K,) of the logarithm within each dip, without the part that all dips share."""
    return np.concatenate([within_variances([dip], common_u_s / dip.value) for dip in dips])


def _over_law(weights: Array, mean: Array, variance: Array, common_u_s: float) -> RandomEffects:
    """Mean and variance of the logarithm at each spread, over exponent and share."""
    of_spread = weights.sum(axis=(0, 1))
    share = weights / np.maximum(of_spread, 1e-300)
    at_spread = np.sum(share * mean, axis=(0, 1))
    total = np.sum(share * (variance + (mean - at_spread) ** 2), axis=(0, 1))
    lag_s = float(np.exp(of_spread @ at_spread))
    return RandomEffects(SPREADS, of_spread, at_spread[:, None], total[:, None], common_u_s / lag_s)


def _part(lag: Estimate, share: float) -> Estimate:
    """A share of a normally distributed lag."""
    return Estimate.normal(share * lag.value, share * lag.u)
