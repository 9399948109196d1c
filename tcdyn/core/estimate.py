"""Numbers with their standard uncertainty: as stored in JSON files, and as text.

Results hold ``Estimate``, and texts of numbers with uncertainty come from here, so that
rounding is the same everywhere: two significant digits of the uncertainty (GUM, 7.2.6). Guarded by
the doctests and ``tests/core/test_results.py``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import NormalDist

from pydantic import BaseModel, ConfigDict

# Two-sided 95 % point of the normal distribution.
Z95 = 1.959963984540054
# An interval is printed if one of its ends differs by more than this many u from value -+ 1.96 u;
# quantiles of 1000 Monte Carlo samples scatter by 0.09 u.
SKEWED = 0.25
# Halvings of the search for a quantile, to rounding error.
BISECTIONS = 60
# Most digits of the text of a value; a double has fifteen.
MOST_DIGITS = 12


def rounded_texts(value: float, u: float) -> tuple[str, str]:
    """Texts of a value and of its standard uncertainty, for two columns of a table.

    ``u`` has two significant digits, the value the same decimals and power of ten.

    Parameters
    ----------
    value
        The value in any unit; NaN if there is none.
    u
        Its standard uncertainty in the same unit; 0 for an exact value, NaN if it is not known.

    Returns
    -------
    value_text, u_text
        Text of the value and of its standard uncertainty.

    Examples
    --------
    >>> rounded_texts(0.654321, 0.01234), rounded_texts(0.654321, 0.0996)
    (('0.654', '0.012'), ('0.65', '0.10'))
    >>> rounded_texts(56789.0, 1234.0), rounded_texts(6.54321e-7, 1.2e-9)
    (('56800', '1200'), ('6.543e-07', '0.012e-07'))
    >>> rounded_texts(0.654321, 0.0), rounded_texts(0.654321, float("nan"))
    (('0.654321', '0'), ('0.654321', 'not known'))
    """
    value_text, u_text, power = _scaled_texts(float(value), float(u))
    exponent = f"e{power:+03d}" if power else ""
    return value_text + exponent, u_text + exponent


def text_with_u(
    value: float, u: float, unit: str = "", low95: float | None = None, high95: float | None = None
) -> str:
    """Text of value, standard uncertainty (two significant digits) and unit.

    Parameters
    ----------
    value
        The value in ``unit``; NaN if there is none.
    u
        Its standard uncertainty in ``unit``; 0 for an exact value, NaN if it is not known.
    unit
        Unit; empty for a number.
    low95, high95
        Its 95 % interval in ``unit``; printed only if it differs from value -+ 1.96 u.

    Notes
    -----
    An interval is printed if ``_is_skewed``; a smaller ``SKEWED`` prints more intervals.

    Examples
    --------
    >>> text_with_u(0.654321, 0.01234, "s"), text_with_u(-1e-9, 0.02)
    ('0.654 +- 0.012 s', '0.000 +- 0.020')
    >>> text_with_u(1.234567e-7, 1.2e-9, "m")
    '(1.235 +- 0.012)e-07 m'
    >>> text_with_u(0.7, 0.1, "s", low95=0.58, high95=1.05)
    '0.70 +- 0.10 s (95 %: 0.58 to 1.05)'
    >>> text_with_u(0.7, 0.0, "s"), text_with_u(0.7, float("nan"), "s")
    ('0.7 +- 0 s', '0.7 s, uncertainty not known')
    >>> text_with_u(float("nan"), 0.1)
    'not known'
    """
    value = float(value)
    u = float(u)
    unit_text = f" {unit}" if unit else ""
    if math.isnan(value):
        return "not known"
    value_text, u_text, power = _scaled_texts(value, u)
    exponent = f"e{power:+03d}" if power else ""
    if math.isnan(u):
        return f"{value_text}{exponent}{unit_text}, uncertainty not known"
    text = f"({value_text} +- {u_text}){exponent}" if power else f"{value_text} +- {u_text}"
    if low95 is None or high95 is None or not _is_skewed(value, u, low95, high95):
        return text + unit_text
    return (
        f"{text}{unit_text} (95 %: {rounded_texts(low95, u)[0]} to {rounded_texts(high95, u)[0]})"
    )


class Estimate(BaseModel):
    """A value, its standard uncertainty and its 95 % interval, in the unit of its key.

    Parameters
    ----------
    value
        The value.
    u
        Standard uncertainty.
    low95, high95
        Ends of the 95 % interval.

    Examples
    --------
    >>> print(Estimate.normal(0.66, 0.01))
    0.660 +- 0.010
    """

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)

    value: float
    u: float
    low95: float
    high95: float

    @classmethod
    def normal(cls, value: float, u: float) -> Estimate:
        """Estimate of a normally distributed quantity: the interval is value -+ 1.96 u.

        Parameters
        ----------
        value
            Mean of the distribution.
        u
            Its standard deviation.
        """
        value = float(value)
        u = float(u)
        return cls(value=value, u=u, low95=value - Z95 * u, high95=value + Z95 * u)

    def contains(self, truth: float) -> bool:
        """Whether the 95 % interval contains ``truth``."""
        return self.low95 <= truth <= self.high95

    def text(self, unit: str = "") -> str:
        """Text of the estimate with its unit, and with the 95 % interval if it is asymmetric.

        >>> Estimate(value=0.7, u=0.1, low95=0.58, high95=1.05).text("s")
        '0.70 +- 0.10 s (95 %: 0.58 to 1.05)'
        """
        return text_with_u(self.value, self.u, unit, self.low95, self.high95)

    def text_without_interval(self, unit: str = "") -> str:
        """Text of value and standard uncertainty with the unit, without the interval."""
        return text_with_u(self.value, self.u, unit)

    @property
    def interval_text(self) -> str:
        """Text of the 95 % interval, with the decimals of the uncertainty.

        >>> Estimate(value=0.7, u=0.068, low95=0.5931, high95=0.857).interval_text
        '0.593 to 0.857'
        """
        return f"{rounded_texts(self.low95, self.u)[0]} to {rounded_texts(self.high95, self.u)[0]}"

    def scaled(self, factor: float) -> Estimate:
        """Estimate of ``factor`` times the quantity; ``factor`` must be positive."""
        return Estimate(**{name: factor * x for name, x in self})

    @property
    def half_widths95(self) -> tuple[float, float]:
        """Distances of the ends of the 95 % interval from the value: below, above.

        The mean of a very skewed distribution may lie outside the interval; the distance is then
        zero.
        """
        return (max(self.value - self.low95, 0.0), max(self.high95 - self.value, 0.0))

    def shifted(self, shift: float) -> Estimate:
        """Estimate of the quantity plus an exact number.

        >>> Estimate(value=0.7, u=0.1, low95=0.58, high95=1.05).shifted(1.0).text("s")
        '1.70 +- 0.10 s (95 %: 1.58 to 2.05)'
        """
        ends = {name: x + shift for name, x in self if name != "u"}
        return Estimate(**ends, u=self.u)

    def with_error(self, error_u: float) -> Estimate:
        """Estimate of the quantity plus an independent normal error of mean zero.

        Each half-width of the interval grows by the error's in quadrature, so that an asymmetric
        interval stays asymmetric. This is exact for a normal distribution.

        Parameters
        ----------
        error_u
            Standard deviation of the error.

        Examples
        --------
        >>> print(Estimate(value=0.7, u=0.1, low95=0.58, high95=1.05).with_error(0.1))
        0.70 +- 0.14 (95 %: 0.47 to 1.10)
        """
        below, above = self.half_widths95
        low = math.hypot(below, Z95 * error_u)
        high = math.hypot(above, Z95 * error_u)
        return Estimate(
            value=self.value,
            u=math.hypot(self.u, error_u),
            low95=self.value - low,
            high95=self.value + high,
        )

    def __str__(self) -> str:
        """The text without a unit."""
        return self.text()


def mixture(components: Sequence[Estimate], weights: Sequence[float]) -> Estimate:
    """Mean, standard uncertainty and 95 % interval of a mixture of normal distributions.

    Parameters
    ----------
    components
        The components; their value and ``u`` are used.
    weights
        Weights of the components, above zero; their sum need not be one.

    Returns
    -------
    Estimate
        The variance is the mean variance plus the variance of the means. A single component is
        returned as it is.

    Examples
    --------
    >>> print(mixture([Estimate.normal(1.0, 0.1), Estimate.normal(2.0, 0.1)], [1.0, 1.0]))
    1.50 +- 0.51 (95 %: 0.84 to 2.16)
    """
    if len(components) == 1:
        return components[0]
    shares = [w / sum(weights) for w in weights]
    mean = sum(w * e.value for w, e in zip(shares, components))
    variance = sum(w * (e.u**2 + (e.value - mean) ** 2) for w, e in zip(shares, components))
    low95, high95 = mixture_interval95(components, shares)
    return Estimate(value=mean, u=variance**0.5, low95=low95, high95=high95)


def prior_departure(shift: float, u: float, prior_u: float, least_share: float) -> float:
    """Difference of prior and data over its standard uncertainty, from an estimate with a prior.

    Parameters
    ----------
    shift
        Estimate less mean of the prior.
    u
        Standard uncertainty of the estimate, which includes the prior.
    prior_u
        Standard uncertainty of the prior.
    least_share
        Least value of the root below, over ``prior_u``: rounding and robust uncertainties make it
        too small where the prior is narrow.

    Returns
    -------
    float
        The ratio, not negative.

    Notes
    -----
    For a normal prior and a normal likelihood shift / sqrt(prior_u^2 - u^2) is the difference of
    what the data alone give and the prior, over the standard uncertainty of that difference (Box
    1980, J. R. Stat. Soc. A 143, 383: prior predictive check).

    Examples
    --------
    Prior 0 +- 3, data 10 +- 4, both together 3.6 +- 2.4; the difference is 10 +- 5.

    >>> round(prior_departure(3.6, 2.4, 3.0, 0.1), 6)
    2.0
    """
    learned_u = math.sqrt(max(prior_u**2 - u**2, 0.0))
    return abs(shift) / max(learned_u, least_share * prior_u)


def mixture_interval95(
    components: Sequence[Estimate], weights: Sequence[float]
) -> tuple[float, float]:
    """Central 95 % interval of a mixture of normal distributions.

    Parameters
    ----------
    components
        The components; their value and ``u`` are used.
    weights
        Weights of the components, with sum one.

    Returns
    -------
    low95, high95
        The 2.5 and 97.5 % points of the mixture.

    Examples
    --------
    >>> [round(x, 3) for x in mixture_interval95([Estimate.normal(0.0, 1.0)], [1.0])]
    [-1.96, 1.96]
    """
    normals = [NormalDist(component.value, max(component.u, 1e-300)) for component in components]
    low95, high95 = (_mixture_quantile(normals, weights, p) for p in (0.025, 0.975))
    return low95, high95


def _mixture_quantile(
    components: Sequence[NormalDist], weights: Sequence[float], probability: float
) -> float:
    """Quantile of a mixture of normal distributions, by bisection.

    Parameters
    ----------
    components
        The distributions.
    weights
        Their weights, with sum one.
    probability
        Probability below the quantile.

    Notes
    -----
    The quantile lies between the lowest and the highest of the components' quantiles. The halvings
    (``BISECTIONS``) reach rounding error.
    """
    quantiles = [component.inv_cdf(probability) for component in components]
    low = min(quantiles)
    high = max(quantiles)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        cdf = sum(w * component.cdf(middle) for w, component in zip(weights, components))
        if cdf < probability:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


def _scaled_texts(value: float, u: float) -> tuple[str, str, int]:
    """Texts of value and u over a common power of ten.

    Parameters
    ----------
    value
        The value; NaN if there is none.
    u
        Its standard uncertainty; 0 for an exact value, NaN if it is not known.

    Returns
    -------
    value_text, u_text
        Texts without the power.
    power
        Exponent of ten; 0 if plain decimals suffice.

    Notes
    -----
    Decimals are used for values from 1e-4 up to below 1e7; these limits may be changed freely.
    """
    if math.isnan(value):
        return "not known", "not known", 0
    if math.isnan(u):
        return f"{value:.6g}", "not known", 0
    if not math.isfinite(u) or u <= 0.0 or not math.isfinite(value):
        return f"{value:.6g}", "0" if u == 0.0 else f"{u:.2g}", 0
    # decimal places of the second digit of u, after rounding, and of the first digit of the value
    last = int(f"{u:.1e}".partition("e")[2]) - 1
    first = int(f"{abs(value):e}".partition("e")[2]) if value else last
    first = max(first, last + 1)
    power = first if first >= 7 or first < -4 else 0
    if first - last > MOST_DIGITS:
        return f"{value:.{MOST_DIGITS}g}", f"{u:.2g}", 0
    scale = 10.0**power
    decimals = power - last
    return _fixed_decimals(value / scale, decimals), _fixed_decimals(u / scale, decimals), power


def _fixed_decimals(number: float, decimals: int) -> str:
    """Text of a number with a fixed number of decimals; never "-0".

    Parameters
    ----------
    number
        The number.
    decimals
        Number of decimals; negative ones round to tens, hundreds and so on.
    """
    return f"{round(number, decimals) + 0.0:.{max(decimals, 0)}f}"


def _is_skewed(value: float, u: float, low95: float, high95: float) -> bool:
    """Whether the interval differs clearly from value -+ 1.96 u.

    Parameters
    ----------
    value, u
        The value and its standard uncertainty.
    low95, high95
        Its 95 % interval.
    """
    low_difference = abs(low95 - (value - Z95 * u))
    high_difference = abs(high95 - (value + Z95 * u))
    return max(low_difference, high_difference) > SKEWED * u
