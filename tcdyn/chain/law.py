"""How the lag of a sensor follows the flow past it.

Only the film between the medium and the sensor follows the flow. What is inside the sensor, and
what comes behind it (cable, filter, logger), does not. Guarded by ``tests/chain/test_law.py``.
"""

from __future__ import annotations

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


@dataclass(frozen=True)
class FlowLaw:
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

    Raises
    ------
    InputError
        For a flow ``at`` that is not positive, an exponent below zero or above one, a share outside
        0 to 1, or a negative uncertainty or least flow.

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

    def __post_init__(self) -> None:
        if not self.at > 0:
            raise InputError(f"FlowLaw: a flow of {self.at}", expected="at above 0")
        if not 0 <= self.exponent <= 1:
            raise InputError(f"FlowLaw: an exponent of {self.exponent}", expected="0 to 1")
        if not 0 <= self.inner_share < 1:
            raise InputError(f"FlowLaw: an inner share of {self.inner_share}", expected="0 to 1")
        if min(self.exponent_u, self.inner_share_u, self.least) < 0:
            raise InputError("FlowLaw: a negative uncertainty or least flow", expected="0 or more")

    def summary(self) -> str:
        """The law in one line."""
        exponent = Estimate.normal(self.exponent, self.exponent_u).text()
        share = Estimate.normal(self.inner_share, self.inner_share_u).text()
        least = f", natural convection below {self.least:g}" if self.least else ""
        return (
            f"lag at {self.quantity} = {self.at:g}; exponent {exponent}, inner share {share}{least}"
        )

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

    def factor(self, flow: ArrayLike) -> Array:
        """Lag at a flow, of any shape, over the lag at ``at``."""
        film = self._relative(flow) ** -self.exponent
        return np.asarray(self.inner_share + (1 - self.inner_share) * film)

    def factor_u(self, flow: ArrayLike, flow_u: ArrayLike = 0.0) -> Array:
        """Change of the factor by each standard uncertainty: exponent, share, flow (3, ...).

        Parameters
        ----------
        flow
            The flow, of any shape.
        flow_u
            Its standard uncertainty, one or of the same shape.
        """
        v = np.asarray(flow, dtype=float)
        relative = self._relative(v)
        film = relative**-self.exponent
        of_exponent = -(1 - self.inner_share) * film * np.log(relative) * self.exponent_u
        of_share = (1 - film) * self.inner_share_u
        # d ln(v_e) / dv = v^2 / v_e^3
        effective = relative * (self.at**MIXED + self.least**MIXED) ** (1 / MIXED)
        per_flow = v ** (MIXED - 1) / effective**MIXED
        of_flow = -(1 - self.inner_share) * self.exponent * film * per_flow * flow_u
        return np.stack([of_exponent, of_share, np.broadcast_to(of_flow, v.shape)])

    def first_lag_s(self, chain: Chain, factor: Array) -> Array:
        """The largest lag [s] of a chain where its whole lag has a factor.

        Parameters
        ----------
        chain
            The chain at the flow ``at``.
        factor
            ``factor`` of each row.

        Raises
        ------
        InputError
            If the film would be more than the largest lag of the chain, or for a chain with a zero,
            a layer of cement or a pair of poles.

        Notes
        -----
        The film is part of the largest lag, next to the medium. The other lags, dead time, filter
        and mean do not follow.
        """
        if chain.zero_s or chain.cement_s or chain.pair:
            raise InputError(
                "FlowLaw: a chain with a zero, a layer of cement or a pair of poles",
                expected="lags, a dead time, a filter and a mean",
            )
        lags_s = sorted(chain.taus_s, reverse=True)
        sensor_s = sum(lags_s)
        film_s = (1 - self.inner_share) * sensor_s
        if not lags_s or film_s > lags_s[0]:
            share = 1 - lags_s[0] / sensor_s if lags_s else 1.0
            raise InputError(
                f"FlowLaw: a film of {film_s:.4g} s in lags of "
                f"{', '.join(f'{lag_s:.4g}' for lag_s in lags_s)} s",
                expected=f"an inner share of at least {share:.2g}, that of all other lags",
            )
        return np.asarray(lags_s[0] + sensor_s * (factor - 1))
