"""Lags that follow a flow, for the smoother.

Guarded by ``tests/smoothing/test_followed_flow.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from tcdyn.chain import Chain, chains_for
from tcdyn.chain.law import LagLaw
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.smoothing.record import FollowedLag, Record

# Logarithm of the part of a lag that follows, from which its uncertainty is that of its strength: a
# matter of rounding only
FOLLOWS = 1e-3


@dataclass(frozen=True)
class FollowedFlow:
    """The lags of a record, which follow a flow.

    Attributes
    ----------
    median_chains
        Chain of each channel (M,) with the median of its first lag.
    lag_s
        First lag of each channel (M,) at each sample (N,) [s]; None where it does not follow.
    factor
        Lag (N, M) over that at the flow of the law; 1 where it does not follow.
    shift_s
        Changes (3, N, M) [s] of the first lags by one standard uncertainty of law, inner share and
        flow.
    laws
        The laws (M,), None where a lag does not follow.
    chains
        The chains (M,) at the flow of their laws.
    flow
        The flow (N, M).
    """

    median_chains: list[Chain]
    lag_s: tuple[Array | None, ...]
    factor: Array
    shift_s: Array
    laws: tuple[LagLaw | None, ...]
    chains: tuple[Chain, ...]
    flow: Array

    def lag_with_strength(self, channel: int, strength: float) -> Array:
        """First lag (N,) [s] of a channel if the logarithm of its law had another size.

        Parameters
        ----------
        channel
            Index of a channel whose lag follows.
        strength
            Factor of that logarithm: 0, the lag is that at the flow of the law; 1, it is as stated.
        """
        law = self.laws[channel]
        assert law is not None
        part = law.part(self.flow[:, channel]) ** strength
        factor = law.inner_share + (1 - law.inner_share) * part
        return law.first_lag_s(self.chains[channel], factor)

    def strength_u(self, channel: int) -> float:
        """Standard uncertainty of the strength of a law that follows, see ``lag_with_strength``."""
        law = self.laws[channel]
        assert law is not None
        flow = self.flow[:, channel]
        part = law.part(flow)
        of_law, _ = law.part_u(flow, 0.0)
        size = np.log(part)
        follows = np.abs(size) > FOLLOWS
        if not follows.any():
            return 0.0
        return float(np.median(np.abs(of_law[follows] / (part * size)[follows])))

    def from_sample(self, first: int) -> FollowedFlow:
        """That of the samples from one on."""
        lag_s = tuple(None if lag is None else lag[first:] for lag in self.lag_s)
        return replace(
            self,
            lag_s=lag_s,
            factor=self.factor[first:],
            shift_s=self.shift_s[:, first:],
            flow=self.flow[first:],
        )

    def lags(self, record: Record) -> tuple[FollowedLag | None, ...]:
        """The lags with the state spaces of a record with ``median_chains``."""
        return tuple(
            None if lag_s is None else FollowedLag.of(lag_s, sensor)
            for lag_s, sensor in zip(self.lag_s, record.sensors)
        )


def followed_flow(
    y: ArrayLike | Record,
    chains: float | Chain | Sequence[Chain],
    laws: LagLaw | Sequence[LagLaw | None] | None,
    flow: ArrayLike | None,
    flow_u: ArrayLike,
) -> FollowedFlow:
    """The lags of readings that follow a flow; the parameters are those of ``smooth``.

    Raises
    ------
    InputError
        For laws without a flow or the reverse, another number of laws or rows than those of the
        readings, a flow that is missing in a row, or a chain whose first lag cannot follow.
    """
    if isinstance(y, Record) or laws is None or flow is None:
        raise InputError(
            "smooth: laws of the lags without a flow, or the reverse",
            expected="readings, laws= and flow= together",
        )
    readings = np.asarray(y, dtype=float)
    rows = len(readings)
    count = 1 if readings.ndim == 1 else readings.shape[1]
    listed = list(laws) if isinstance(laws, Sequence) else [laws] * count
    if len(listed) != count:
        raise InputError(f"smooth: {len(listed)} laws for {count} channels")
    v = np.asarray(flow, dtype=float)
    if v.shape not in ((rows,), (rows, count)):
        raise InputError(
            f"smooth: a flow of shape {v.shape}", expected=f"one value for each of the {rows} rows"
        )
    v = np.broadcast_to(v[:, None] if v.ndim == 1 else v, (rows, count))
    if not np.isfinite(v).all():
        missing = int(np.argmax(~np.isfinite(v).all(axis=1)))
        raise InputError(
            f"smooth: the flow is missing in row {missing}",
            expected="a flow in every row: hold or interpolate it first",
        )
    of_flow = np.asarray(flow_u, dtype=float)
    if of_flow.shape not in ((), (rows,), (rows, count)) or not (of_flow >= 0).all():
        raise InputError(
            f"smooth: an uncertainty of the flow of shape {of_flow.shape}, at least "
            f"{np.min(of_flow, initial=np.inf):g}",
            expected="one number, or one of each row, not negative",
        )
    u = np.broadcast_to(of_flow[:, None] if of_flow.ndim == 1 else of_flow, (rows, count))
    medians = []
    lags: list[Array | None] = []
    factor = np.ones((rows, count))
    shift_s = np.zeros((3, rows, count))
    given = chains_for(chains, count)
    for c, (chain, law) in enumerate(zip(given, listed)):
        if law is None:
            medians.append(chain)
            lags.append(None)
            continue
        factor[:, c] = law.factor(v[:, c])
        lag_s = law.first_lag_s(chain, factor[:, c])
        if not (np.isfinite(lag_s) & (lag_s > 0)).all():
            row = int(np.argmin(np.isfinite(lag_s) & (lag_s > 0)))
            raise InputError(
                f"smooth: the law gives a lag of {lag_s[row]:.3g} s at {v[row, c]:.4g} (row {row})",
                expected=f"values of {law.quantity} near {law.at:g}, in the unit of the law",
            )
        _, *others_s = sorted(chain.taus_s, reverse=True)
        medians.append(replace(chain, taus_s=(float(np.median(lag_s)), *others_s)))
        lags.append(lag_s)
        shift_s[:, :, c] = sum(chain.taus_s) * law.factor_u(v[:, c], u[:, c])
    return FollowedFlow(
        medians, tuple(lags), factor, shift_s, tuple(listed), tuple(given), np.asarray(v)
    )
