"""A number with its uncertainty: as it stands in every JSON file of the project, and as it is written for people."""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import NormalDist

from pydantic import BaseModel, ConfigDict

Z95 = 1.959963984540054  # two-sided 95 % point of the normal distribution
SKEWED = 0.25  # an interval's end this many u from value -+ 1.96 u is told; quantiles of 1000 draws stray by 0.09 u
MOST_DIGITS = 12  # of a value; a double carries fifteen


def rounded(value: float, u: float) -> tuple[str, str]:
    """The texts of a value and of its standard uncertainty: ``u`` to two significant digits, the value to match.

    Both come in the same form, so that they stand well in two columns of a table.

    Args:
        value: the value, any unit; nan where there is none.
        u: its standard uncertainty in the same unit; 0 for an exact value, nan where it is not known.

    >>> rounded(0.654321, 0.01234), rounded(0.654321, 0.0996), rounded(56789.0, 1234.0)
    (('0.654', '0.012'), ('0.65', '0.10'), ('56800', '1200'))
    >>> rounded(6.54321e-7, 1.2e-9), rounded(0.654321, 0.0), rounded(0.654321, float("nan"))
    (('6.543e-07', '0.012e-07'), ('0.654321', '0'), ('0.654321', 'not known'))
    """
    value_text, u_text, power = _parts(float(value), float(u))
    tail = f"e{power:+03d}" if power else ""
    return value_text + tail, u_text + tail


def with_u(
    value: float, u: float, unit: str = "", low95: float | None = None, high95: float | None = None
) -> str:
    """Value, standard uncertainty and unit in one line, the uncertainty to two significant digits.

    Args:
        value: the value in ``unit``; nan where there is none.
        u: its standard uncertainty in ``unit``; 0 for an exact value, nan where it is not known.
        unit: written behind, if there is one.
        low95, high95: its 95 % interval in ``unit``; written only where it is not value -+ 1.96 u.

    >>> with_u(0.654321, 0.01234, "s"), with_u(-1e-9, 0.02), with_u(1.234567e-7, 1.2e-9, "m")
    ('0.654 +- 0.012 s', '0.000 +- 0.020', '(1.235 +- 0.012)e-07 m')
    >>> with_u(0.7, 0.1, "s", low95=0.58, high95=1.05)
    '0.70 +- 0.10 s (95 %: 0.58 to 1.05)'
    >>> with_u(0.7, 0.0, "s"), with_u(0.7, float("nan"), "s"), with_u(float("nan"), 0.1)
    ('0.7 +- 0 s', '0.7 s, uncertainty not known', 'not known')
    """
    value = float(value)
    u = float(u)
    behind = f" {unit}" if unit else ""
    if math.isnan(value):
        return "not known"
    value_text, u_text, power = _parts(value, u)
    tail = f"e{power:+03d}" if power else ""
    if math.isnan(u):
        return f"{value_text}{tail}{behind}, uncertainty not known"
    text = f"({value_text} +- {u_text}){tail}" if power else f"{value_text} +- {u_text}"
    if low95 is None or high95 is None or not _skewed(value, u, low95, high95):
        return text + behind
    return f"{text}{behind} (95 %: {rounded(low95, u)[0]} to {rounded(high95, u)[0]})"


class Estimate(BaseModel):
    """A value, its standard uncertainty ``u`` and its 95 % interval, all in the unit of the key that holds it.

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
        """The estimate of a normally distributed quantity: value -+ 1.96 u."""
        value = float(value)
        u = float(u)
        return cls(value=value, u=u, low95=value - Z95 * u, high95=value + Z95 * u)

    def covers(self, truth: float) -> bool:
        """Whether the 95 % interval holds ``truth``."""
        return self.low95 <= truth <= self.high95

    def text(self, unit: str = "") -> str:
        """The estimate in words, with ``unit`` behind it and the 95 % interval where it is lopsided.

        >>> Estimate(value=0.7, u=0.1, low95=0.58, high95=1.05).text("s")
        '0.70 +- 0.10 s (95 %: 0.58 to 1.05)'
        """
        return with_u(self.value, self.u, unit, self.low95, self.high95)

    def plain(self, unit: str = "") -> str:
        """Value and standard uncertainty, without the interval, with ``unit`` behind them."""
        return with_u(self.value, self.u, unit)

    @property
    def interval(self) -> str:
        """The 95 % interval with the decimals of the uncertainty.

        >>> Estimate(value=0.7, u=0.068, low95=0.5931, high95=0.857).interval
        '0.593 to 0.857'
        """
        return f"{rounded(self.low95, self.u)[0]} to {rounded(self.high95, self.u)[0]}"

    def times(self, factor: float) -> Estimate:
        """The estimate of a multiple of the quantity; ``factor`` above zero."""
        return Estimate(**{name: factor * x for name, x in self})

    def __str__(self) -> str:
        return self.text()


def mixture_range(parts: Sequence[Estimate], weights: Sequence[float]) -> tuple[float, float]:
    """The central 95 % of a mixture of normal distributions of ``weights`` that add to one.

    >>> [round(x, 3) for x in mixture_range([Estimate.normal(0.0, 1.0)], [1.0])]
    [-1.96, 1.96]
    """
    normal = [NormalDist(e.value, e.u) for e in parts]
    ends = []
    for share in (0.025, 0.975):
        low, high = (pick(n.inv_cdf(share) for n in normal) for pick in (min, max))
        for _ in range(60):  # halvings
            middle = 0.5 * (low + high)
            below = sum(w * n.cdf(middle) for w, n in zip(weights, normal)) < share
            low, high = (middle, high) if below else (low, middle)
        ends.append(0.5 * (low + high))
    return ends[0], ends[1]


def _parts(value: float, u: float) -> tuple[str, str, int]:
    """Texts of value and u over a common power of ten, which is 0 where plain decimals read well."""
    if math.isnan(value):
        return "not known", "not known", 0
    if not math.isfinite(u) or u <= 0.0 or not math.isfinite(value):
        return f"{value:.6g}", "0" if u == 0.0 else "not known" if math.isnan(u) else f"{u:.2g}", 0
    last = (
        int(f"{u:.1e}".partition("e")[2]) - 1
    )  # the decimal place of u's second digit, after rounding
    first = max(int(f"{abs(value):e}".partition("e")[2]) if value else last, last + 1)
    power = first if first >= 7 or first < -4 else 0
    if first - last > MOST_DIGITS:
        return f"{value:.{MOST_DIGITS}g}", f"{u:.2g}", 0
    scale = 10.0**power
    decimals = power - last
    return _fixed(value / scale, decimals), _fixed(u / scale, decimals), power


def _fixed(number: float, decimals: int) -> str:
    """``number`` with so many decimals, or rounded to tens, hundreds ... where they are negative; never "-0"."""
    return f"{round(number, decimals) + 0.0:.{max(decimals, 0)}f}"


def _skewed(value: float, u: float, low95: float, high95: float) -> bool:
    """Whether the interval says more than value -+ 1.96 u does."""
    return max(abs(low95 - (value - Z95 * u)), abs(high95 - (value + Z95 * u))) > SKEWED * u
