"""How the lag of a sensor follows the flow past it, or another quantity that is logged.

Only the film between the medium and the sensor follows a flow. What is inside the sensor, and what
comes behind it (cable, filter, logger), does not. Guarded by ``tests/chain/test_law.py``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tcdyn.chain.chain import Chain
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate

# exponent with which forced and natural convection combine: Nu^3 = Nu_forced^3 + Nu_natural^3
# (S. W. Churchill, AIChE J. 23, 10, 1977)
MIXED = 3.0
MOST_PRINTED = 8  # lags of a table that a summary lists; layout only
# Largest share per degree by which a lag may change: with more the number is one in per cent
LARGEST_PER_DEGREE = 0.5


class LagLaw(ABC):
    """Law of a lag that follows a quantity, of which a part inside the sensor does not follow.

    lag(v) = lag (s + (1 - s) f(v)) with the inner share s; f is ``part``.
    """

    at: float
    inner_share: float
    inner_share_u: float
    quantity: str
    correlation: float = 0.0  # of the errors of law and inner share

    @abstractmethod
    def part(self, value: ArrayLike) -> Array:
        """The part of the lag that follows, over that at ``at``, for values of any shape."""

    @abstractmethod
    def part_u(self, value: ArrayLike, value_u: ArrayLike) -> tuple[Array, Array]:
        """Change of ``part`` by one standard uncertainty of the law, and of the quantity."""

    @abstractmethod
    def summary(self) -> str:
        """The law in one line."""

    def _check_share(self) -> None:
        """Raise InputError for an impossible inner share."""
        name = type(self).__name__
        if not 0 <= self.inner_share < 1:
            raise InputError(f"{name}: an inner share of {self.inner_share}", expected="0 to 1")
        if not 0 <= self.inner_share_u < np.inf:
            raise InputError(
                f"{name}: an uncertainty of the inner share of {self.inner_share_u}",
                expected="0 or more",
            )

    def factor(self, value: ArrayLike) -> Array:
        """Lag at values of the quantity, of any shape, over the lag at ``at``."""
        return np.asarray(self.inner_share + (1 - self.inner_share) * self.part(value))

    def factor_u(self, value: ArrayLike, value_u: ArrayLike = 0.0) -> Array:
        """Change of the factor by each standard uncertainty: law, share, quantity (3, ...).

        If law and share are correlated, the first is the change by the law with the share that
        changes with it, and the second that by the share alone at a known law.

        Parameters
        ----------
        value
            The quantity, of any shape.
        value_u
            Its standard uncertainty, one or of the same shape.
        """
        v = np.asarray(value, dtype=float)
        of_law, of_quantity = self.part_u(v, value_u)
        following = 1 - self.inner_share
        of_share = (1 - self.part(v)) * self.inner_share_u
        alone = np.sqrt(1 - self.correlation**2)
        changes = [
            following * of_law + self.correlation * of_share,
            alone * of_share,
            following * of_quantity,
        ]
        return np.stack([np.broadcast_to(change, v.shape) for change in changes])

    def first_lag_s(self, chain: Chain, factor: Array) -> Array:
        """The largest lag [s] of a chain where its whole lag has a factor.

        Parameters
        ----------
        chain
            The chain at the value ``at``.
        factor
            ``factor`` of each row.

        Raises
        ------
        InputError
            If what follows would be more than the largest lag of the chain, or for a chain with a
            zero, a layer of cement or a pair of poles.

        Notes
        -----
        What follows is part of the largest lag, next to the medium. The other lags, dead time,
        filter and mean do not follow.
        """
        name = type(self).__name__
        if chain.zero_s or chain.cement_s or chain.pair:
            raise InputError(
                f"{name}: a chain with a zero, a layer of cement or a pair of poles",
                expected="lags, a dead time, a filter and a mean",
            )
        lags_s = sorted(chain.taus_s, reverse=True)
        sensor_s = sum(lags_s)
        film_s = (1 - self.inner_share) * sensor_s
        if not lags_s or film_s > lags_s[0]:
            share = 1 - lags_s[0] / sensor_s if lags_s else 1.0
            raise InputError(
                f"{name}: a film of {film_s:.4g} s in lags of "
                f"{', '.join(f'{lag_s:.4g}' for lag_s in lags_s)} s",
                expected=f"an inner share of at least {share:.2g}, that of all other lags",
            )
        return np.asarray(lags_s[0] + sensor_s * (factor - 1))

    def _summary_of(self, law: str) -> str:
        """The law in one line, around what is said of it."""
        share = Estimate.normal(self.inner_share, self.inner_share_u).text()
        return f"lag at {self.quantity} = {self.at:g}; {law}; inner share {share}"


@dataclass(frozen=True)
class FlowLaw(LagLaw):
    """Law of a lag that falls as the flow rises.

    Parameters
    ----------
    at
        Flow at which the lag of the chain holds, in any unit.
    exponent, exponent_u
        Exponent n of the film coefficient, h proportional to flow^n, and its standard uncertainty:
        about 0.5 for a cylinder in a cross flow of Reynolds number 40 to 4000, 0.6 above.
    inner_share, inner_share_u
        Share of the lag that does not follow the flow, and its standard uncertainty.
    least
        Flow in the same unit below which natural convection keeps the lag from rising; zero: none.
    quantity
        What the flow is, with its unit, such as speed_m_s: the usual name of its column.
    correlation
        Correlation of the errors of exponent and inner share: of a law that was measured it is near
        one, because two flows determine only one combination of both.

    Raises
    ------
    InputError
        For a flow ``at`` that is not positive, an exponent below zero or above one, a share outside
        0 to 1, a correlation outside -1 to 1, or a negative uncertainty or least flow.

    Notes
    -----
    lag(v) = lag (s + (1 - s) f(v)) with the inner share s and f(v) = (v_e / at_e)^-n. The effective
    flow v_e = (v^3 + least^3)^(1/3) combines forced and natural convection (Churchill 1977); at_e
    is that of ``at``.

    Examples
    --------
    >>> law = FlowLaw(at=2.0, exponent=0.5, inner_share=0.2)
    >>> law.factor([2.0, 8.0, 0.5]).round(3).tolist()
    [1.0, 0.6, 1.8]
    """

    at: float
    exponent: float
    exponent_u: float = 0.0
    inner_share: float = 0.0
    inner_share_u: float = 0.0
    least: float = 0.0
    quantity: str = "flow"
    correlation: float = 0.0

    def __post_init__(self) -> None:
        if not 0 < self.at < np.inf:
            raise InputError(f"FlowLaw: a flow of {self.at}", expected="at above 0")
        if not 0 <= self.exponent <= 1:
            raise InputError(f"FlowLaw: an exponent of {self.exponent}", expected="0 to 1")
        if not (0 <= self.exponent_u < np.inf and 0 <= self.least < np.inf):
            raise InputError(
                f"FlowLaw: an uncertainty of {self.exponent_u}, a least flow of {self.least}",
                expected="0 or more",
            )
        if not -1 <= self.correlation <= 1:
            raise InputError(f"FlowLaw: a correlation of {self.correlation}", expected="-1 to 1")
        self._check_share()

    def summary(self) -> str:
        """The law in one line."""
        exponent = Estimate.normal(self.exponent, self.exponent_u).text()
        least = f", natural convection below {self.least:g}" if self.least else ""
        return self._summary_of(f"exponent {exponent}{least}")

    def _relative(self, flow: ArrayLike) -> Array:
        """Effective flow over that of ``at``.

        Raises
        ------
        InputError
            For a flow that is negative, or zero without a least one.
        """
        v = np.asarray(flow, dtype=float)
        if (v < 0).any():
            raise InputError(f"FlowLaw: a flow of {v.min():.4g}", expected="0 or more")
        effective = (v**MIXED + self.least**MIXED) ** (1 / MIXED)
        if not (effective > 0).all():
            raise InputError(
                "FlowLaw: a flow of zero, at which the lag has no limit",
                expected="a least flow, below which natural convection takes over",
            )
        return np.asarray(effective / (self.at**MIXED + self.least**MIXED) ** (1 / MIXED))

    def part(self, value: ArrayLike) -> Array:
        """Lag of the film over that at ``at``, for flows of any shape."""
        return np.asarray(self._relative(value) ** -self.exponent)

    def part_u(self, value: ArrayLike, value_u: ArrayLike) -> tuple[Array, Array]:
        """Change of ``part`` by one standard uncertainty of the exponent, and of the flow."""
        v = np.asarray(value, dtype=float)
        relative = self._relative(v)
        film = self.part(v)
        # d ln(v_e) / dv = v^2 / v_e^3
        effective = relative * (self.at**MIXED + self.least**MIXED) ** (1 / MIXED)
        per_flow = v ** (MIXED - 1) / effective**MIXED
        of_law = -film * np.log(relative) * self.exponent_u
        of_flow = -self.exponent * film * per_flow * np.asarray(value_u)
        return of_law, of_flow


@dataclass(frozen=True)
class TemperatureLaw(LagLaw):
    """Law of a lag that falls exponentially as a temperature rises, such as that of a membrane.

    The temperature is that of another thermometer: the sensor's own reading lags behind it.

    Parameters
    ----------
    at
        Temperature at which the lag of the chain holds, in the unit of its column.
    per_degree, per_degree_u
        Share by which the lag falls per degree, and its standard uncertainty: 0.02 is 2 % per
        degree; negative where the lag rises.
    inner_share, inner_share_u
        Share of the lag that does not follow the temperature, and its standard uncertainty.
    quantity
        What the temperature is, with its unit: the usual name of its column.

    Raises
    ------
    InputError
        For a share outside 0 to 1, and a negative uncertainty.

    Notes
    -----
    f(T) = exp(-k (T - T_at)) with the share k per degree.

    Examples
    --------
    >>> TemperatureLaw(at=20.0, per_degree=0.03).factor([20.0, 10.0]).round(2).tolist()
    [1.0, 1.35]
    """

    at: float
    per_degree: float
    per_degree_u: float = 0.0
    inner_share: float = 0.0
    inner_share_u: float = 0.0
    quantity: str = "T_degC"

    def __post_init__(self) -> None:
        numbers = [self.at, self.per_degree, self.per_degree_u]
        is_possible = np.isfinite(numbers).all() and abs(self.per_degree) <= LARGEST_PER_DEGREE
        if not is_possible or self.per_degree_u < 0:
            raise InputError(
                f"TemperatureLaw: {self.per_degree} +- {self.per_degree_u} per degree at {self.at}",
                expected=f"a share of at most {LARGEST_PER_DEGREE:g}: 0.03 for 3 % per degree",
            )
        self._check_share()

    def summary(self) -> str:
        """The law in one line."""
        share = Estimate.normal(self.per_degree, self.per_degree_u).text()
        return self._summary_of(f"falls by a share of {share} per degree")

    def part(self, value: ArrayLike) -> Array:
        """Lag over that at ``at``, for temperatures of any shape."""
        degrees = np.asarray(value, dtype=float) - self.at
        with np.errstate(over="ignore"):  # what is infinite is refused later
            return np.asarray(np.exp(-self.per_degree * degrees))

    def part_u(self, value: ArrayLike, value_u: ArrayLike) -> tuple[Array, Array]:
        """Change of ``part`` by one standard uncertainty of the share, and of the temperature."""
        v = np.asarray(value, dtype=float)
        part = self.part(v)
        of_law = -part * (v - self.at) * self.per_degree_u
        of_temperature = -self.per_degree * part * np.asarray(value_u)
        return of_law, of_temperature


@dataclass(frozen=True)
class TableLaw(LagLaw):
    """Law of a lag that was measured at some values of a quantity, linear between them.

    Parameters
    ----------
    at
        Value at which the lag of the chain holds, inside the table.
    values
        Values of the quantity, rising.
    lags_s
        Lag at each [s]; beyond the first and the last it is taken as theirs.
    u_rel
        Relative standard uncertainty of the lags beside that of the lag at ``at``: one error of the
        table.
    inner_share, inner_share_u
        Share of the lag that does not follow; zero where the table is that of the whole lag.
    quantity
        What the quantity is, with its unit: the usual name of its column.

    Raises
    ------
    InputError
        For values that do not rise, lags that are not positive, and a value ``at`` outside them.

    Examples
    --------
    >>> law = TableLaw(at=2.0, values=(1.0, 2.0, 4.0), lags_s=(30.0, 20.0, 15.0))
    >>> law.factor([2.0, 1.5, 8.0]).tolist()
    [1.0, 1.25, 0.75]
    """

    at: float
    values: Sequence[float]
    lags_s: Sequence[float]
    u_rel: float = 0.0
    inner_share: float = 0.0
    inner_share_u: float = 0.0
    quantity: str = "flow"

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", tuple(float(value) for value in self.values))
        object.__setattr__(self, "lags_s", tuple(float(lag_s) for lag_s in self.lags_s))
        rises = (np.diff(self.values) > 0).all()
        is_finite = np.isfinite([*self.values, *self.lags_s, self.u_rel]).all()
        is_table = len(self.values) == len(self.lags_s) > 1 and rises and min(self.lags_s) > 0
        if not is_table or not is_finite or self.u_rel < 0:
            raise InputError(
                f"TableLaw: {len(self.values)} values, {len(self.lags_s)} lags",
                expected="two or more values that rise, each with a lag above zero",
            )
        if not self.values[0] <= self.at <= self.values[-1]:
            raise InputError(
                f"TableLaw: the lag holds at {self.at:g}",
                expected=f"a value in the table, {self.values[0]:g} to {self.values[-1]:g}",
            )
        self._check_share()

    @property
    def lag_s(self) -> float:
        """Lag of the table at ``at`` [s]."""
        return float(np.interp(self.at, self.values, self.lags_s))

    def summary(self) -> str:
        """The law in one line."""
        pairs = [f"{lag_s:.4g} s at {value:.4g}" for value, lag_s in zip(self.values, self.lags_s)]
        if len(pairs) > MOST_PRINTED:
            return self._summary_of(f"a table of {len(pairs)} lags, {pairs[0]} to {pairs[-1]}")
        return self._summary_of(", ".join(pairs))

    def part(self, value: ArrayLike) -> Array:
        """Lag over that at ``at``, for values of any shape."""
        at_value = np.interp(np.asarray(value, dtype=float), self.values, self.lags_s)
        return np.asarray(at_value / self.lag_s)

    def part_u(self, value: ArrayLike, value_u: ArrayLike) -> tuple[Array, Array]:
        """Change of ``part`` by one standard uncertainty of the table, and of the quantity."""
        v = np.asarray(value, dtype=float)
        part = self.part(v)
        slopes = np.diff(self.lags_s) / np.diff(self.values)
        index = np.searchsorted(self.values, v, side="right") - 1
        is_inside = (index >= 0) & (index < len(slopes))
        slope = np.where(is_inside, slopes[np.clip(index, 0, len(slopes) - 1)], 0.0)
        per_value = slope / self.lag_s
        return (part - 1) * self.u_rel, np.asarray(per_value * np.asarray(value_u))


# The laws that a file of a sensor may hold; each has other fields without a default.
AnyLaw = FlowLaw | TemperatureLaw | TableLaw
