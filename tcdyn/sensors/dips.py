"""One sensor from several dips: a random-effects estimate of lag and percent times.

``tcdyn sensor plunge`` with several tables uses it. ``tests/sensors/test_dips.py`` checks the
coverage of the intervals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tcdyn.chain import Chain
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Z95, Estimate, mixture_interval95
from tcdyn.core.findings import Finding, warning
from tcdyn.io.unit_names import is_same_name
from tcdyn.sensors.file import SHARES, SensorFile, sensor_file, step_size
from tcdyn.sensors.plunge import MEDIUM_LIMIT, TAIL_LIMIT
from tcdyn.sensors.surface_h import BoundaryLayer

# Scale of the half-Cauchy prior of the relative spread between dips: its median. Public dips of one
# RTD differ by 11 %, a standard deviation of 5 %.
SPREAD_SCALE = 0.05
# Values of the relative spread over which the results are averaged: beyond each end lies 1 % of the
# prior. Twice as many values change u by less than 1 %.
SPREADS = np.geomspace(1e-3, 3.0, 40)
MIN_WITHIN_U = 1e-6  # least relative standard uncertainty within a dip
DIRECTIONS = ("cooling", "heating")
OTHER_DIRECTIONS = ("falling", "rising")  # of another quantity than temperature


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
        Result of another quantity of the same dips, whose spread these have too; None: the spread
        is that of these estimates.

    Returns
    -------
    RandomEffects
        Distribution of the mean of each group; the groups have one spread.

    Notes
    -----
    log y_k = mu_g + b_k + e_k, with b_k ~ N(0, tau^2) between dips and e_k ~ N(0, s_k^2) within
    dip k, s_k = u_k / y_k. mu has a flat prior, tau a half-Cauchy prior of scale ``SPREAD_SCALE``
    (Gelman 2006, Bayesian Analysis 1, 515). At a given tau, mu is normal with the weights
    1 / (s_k^2 + tau^2); tau has the marginal likelihood
    prod (s_k^2 + tau^2)^(-1/2) prod_g V_g^(1/2) exp(-chi^2 / 2), and the result is the mixture over
    tau (Roever 2020, J. Stat. Softw. 93, 6). In contrast to the interval of Hartung, Knapp, Sidik
    and Jonkman, which needs no prior, two dips give a useful interval: its Student factor is 12.7.

    The part ``common_u`` is left out of the s_k and added to the results.

    Examples
    --------
    >>> pooled = random_effects([Estimate.normal(1.50, 0.01), Estimate.normal(1.60, 0.01)])
    >>> print(pooled.mean_estimate(), pooled.next_estimate(), sep="; ")
    1.55 +- 0.12; 1.55 +- 0.20
    """
    value = np.array([dip.value for dip in dips])
    u = np.array([dip.u for dip in dips])
    if not np.all(value > 0):
        raise InputError(f"a lag of {value.min():.4g} s", expected="lags above zero")
    log_value = np.log(value)
    within_variance = np.maximum((u / value) ** 2 - common_u**2, MIN_WITHIN_U**2)
    index = np.zeros(len(value), dtype=int) if group is None else np.asarray(group)
    in_group = index == np.arange(index.max() + 1)[:, None]
    edges = np.concatenate([[0.0], np.sqrt(SPREADS[1:] * SPREADS[:-1]), [np.inf]])
    prior = np.diff(np.arctan(edges / SPREAD_SCALE))
    total = within_variance + SPREADS[:, None] ** 2
    information = (1 / total) @ in_group.T
    mean = (log_value / total) @ in_group.T / information
    residual = log_value - mean[:, index]
    chi2 = np.sum(residual**2 / total, axis=1)
    log_likelihood = -0.5 * (np.log(total).sum(axis=1) + np.log(information).sum(axis=1) + chi2)
    weights = prior * np.exp(log_likelihood - log_likelihood.max())
    if spread is not None:
        weights = spread.weights
    return RandomEffects(SPREADS, weights / weights.sum(), mean, 1 / information, common_u)


def pool_dips(
    dips: Sequence[SensorFile], sensor: str = "sensor", film: BoundaryLayer | None = None
) -> SensorFile:
    """Combine several plunges of one sensor.

    Parameters
    ----------
    dips
        Results of :func:`~tcdyn.sensors.plunge.plunge_sensor`, at least two.
    sensor
        Name of the sensor.
    film
        The boundary layer; its h goes into the file.

    Returns
    -------
    SensorFile
        Lag and percent times are those of one further dip or use: their uncertainty includes the
        spread between dips. The mean of many dips is ``fit["mean_lag_s"]``.

    Raises
    ------
    InputError
        For less than two dips, a dip that is given twice, and dips of different columns, filters
        or methods.

    Notes
    -----
    The chain is that of the dip with the smallest relative uncertainty, with all its times scaled
    to the combined lag. Dips of one thermocouple may be in different units, each with the unit in
    the name of its column; the sensor has the column of the first.
    """
    _check_same_sensor(dips)
    column = dips[0].columns[0]
    filter_lag_s = dips[0].conditioning.lag_s
    lags = [Estimate(**dip.fit["lag_s"]) for dip in dips]
    # a dip whose best structure has no short lags does not show that there are none
    common_u_s = max(dip.fit.get("tail_u_s", 0.0) for dip in dips)
    common_u = common_u_s / float(np.mean([estimate.value for estimate in lags]))
    pooled = random_effects(lags, common_u=common_u)
    lag = pooled.next_estimate()
    relative_u = [estimate.u / estimate.value for estimate in lags]
    best = dips[int(np.argmin(relative_u))].chains[0]
    chain = _scale_times(best, lag.value / (best.lag_s - filter_lag_s))
    largest_shares = [max(dip.chains[0].taus_s) / dip.chains[0].lag_s for dip in dips]
    within_split_u_s = np.sqrt(np.mean([dip.split_u_s[0] ** 2 for dip in dips]))
    split_u_s = float(np.hypot(within_split_u_s, lag.value * np.std(largest_shares, ddof=1)))
    times = {
        key: _pooled_time([dip.times[dip.columns[0]][key] for dip in dips], common_u_s, pooled)
        for key in SHARES
    }
    within = float(np.sqrt(max(np.mean(np.square(relative_u)) - common_u**2, 0.0)))
    between = pooled.median_spread
    by_medium = any(dip.fit.get("limited_by") == MEDIUM_LIMIT for dip in dips)
    shared_limit = MEDIUM_LIMIT if by_medium else TAIL_LIMIT
    causes = {
        "the spread between dips": between,
        "noise and model of a dip": within,
        shared_limit: common_u,
    }
    heating = [int(step_size(dip.fit) > 0) for dip in dips]
    unit = dips[0].fit.get("unit", "K")
    directions = DIRECTIONS if unit == "K" else OTHER_DIRECTIONS
    rows = [
        {
            "file": ", ".join(source.file for source in dip.inputs),
            "direction": directions[is_heating],
            "lag_s": dip_lag.model_dump(),
        }
        for dip, dip_lag, is_heating in zip(dips, lags, heating)
    ]
    fit: dict[str, Any] = {
        "lag_s": lag.model_dump(),
        "mean_lag_s": pooled.mean_estimate().model_dump(),
        "between_dips_s": between * lag.value,
        "within_dip_s": within * lag.value,
        "limited_by": max(causes, key=lambda cause: causes[cause]),
        "dips": rows,
    }
    findings: list[Finding] = []
    by_direction = random_effects(lags, heating, common_u) if len(set(heating)) == 2 else None
    if by_direction is not None and by_direction.groups_differ():
        cooling_lag = by_direction.mean_estimate(0)
        heating_lag = by_direction.mean_estimate(1)
        fit[f"{directions[1]}_lag_s"] = heating_lag.model_dump()
        fit[f"{directions[0]}_lag_s"] = cooling_lag.model_dump()
        finding = warning(
            "sensor.directions",
            subject=column,
            heating_s=heating_lag.value,
            cooling_s=cooling_lag.value,
        )
        findings.append(finding.in_unit(unit))
    if film is not None:
        fit |= film.to_fit(lag)
    for dip in dips:
        findings += [f.at(dip.inputs[0].file) if dip.inputs else f for f in dip.findings]
    return sensor_file(
        sensor,
        {column: chain},
        "plunge",
        np.array([[lag.u**2]]),
        [min(split_u_s, lag.value)],
        structure=dips[int(np.argmin(relative_u))].chain.structure,
        lags={column: lag},
        times={column: times},
        inputs=[source for dip in dips for source in dip.inputs],
        fit=fit,
        findings=findings,
    )


def _pooled_time(dips: Sequence[Estimate], common_u_s: float, lags: RandomEffects) -> Estimate:
    """Return a percent time of one further dip.

    Parameters
    ----------
    dips
        The time of each dip.
    common_u_s
        Standard uncertainty that all dips share [s].
    lags
        The lags of the same dips.

    Notes
    -----
    What differs between dips (depth, speed, bath) changes all times of the sensor. A dip whose time
    is uncertain says little about the spread of that time; that of the lags is then larger, and is
    used.
    """
    common_u = common_u_s / float(np.mean([estimate.value for estimate in dips]))
    own = random_effects(dips, common_u=common_u)
    if own.median_spread < lags.median_spread:
        own = random_effects(dips, common_u=common_u, spread=lags)
    return own.next_estimate()


def _check_same_sensor(dips: Sequence[SensorFile]) -> None:
    """Check that at least two different dips are plunges of one column with one filter.

    Raises
    ------
    InputError
        Otherwise.
    """
    if len(dips) < 2:
        raise InputError(f"{len(dips)} dips to combine", expected="at least two")
    if any(dip.method != "plunge" or len(dip.columns) != 1 for dip in dips):
        raise InputError("a dip is not the result of a plunge", expected="plunges of one column")
    columns = list(dict.fromkeys(dip.columns[0] for dip in dips))
    if any(not is_same_name(columns[0], name) for name in columns):
        raise InputError(
            f"the dips have the columns {', '.join(columns)}",
            expected="one sensor, so one column, whatever its unit",
        )
    units = list(dict.fromkeys(dip.fit.get("unit", "K") for dip in dips))
    if len(units) > 1:
        raise InputError(
            f"the dips are in {' and '.join(units)}", expected="one quantity, such as temperature"
        )
    if any(dip.conditioning != dips[0].conditioning for dip in dips):
        raise InputError("the dips have different filters", expected="one filter")
    checksums = [source.sha256 for dip in dips for source in dip.inputs]
    if len(set(checksums)) < len(checksums):
        raise InputError(
            "two of the dips are one file, or have the same content",
            expected="different dips",
            remedy="give each dip once",
        )


def _scale_times(chain: Chain, factor: float) -> Chain:
    """The chain with all its times multiplied by ``factor``; its filter stays."""
    pair = chain.pair and (factor * chain.pair[0], chain.pair[1])
    return replace(
        chain,
        taus_s=tuple(factor * tau for tau in chain.taus_s),
        zero_s=factor * chain.zero_s,
        delay_s=factor * chain.delay_s,
        cement_s=factor * chain.cement_s,
        pair=pair,
    )
