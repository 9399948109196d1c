"""Lags that follow a flow, for the smoother.

Guarded by ``tests/smoothing/test_followed_flow.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from tcdyn.chain import Chain, chains_for
from tcdyn.chain.law import FlowLaw
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.smoothing.record import FollowedLag, Record


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
        Changes (3, N, M) [s] of the first lags by one standard uncertainty of exponent, inner share
        and flow.
    """

    median_chains: list[Chain]
    lag_s: tuple[Array | None, ...]
    factor: Array
    shift_s: Array

    def lags(self, record: Record) -> tuple[FollowedLag | None, ...]:
        """The lags with the state spaces of a record with ``median_chains``."""
        return tuple(
            None if lag_s is None else FollowedLag.of(lag_s, sensor)
            for lag_s, sensor in zip(self.lag_s, record.sensors)
        )


def followed_flow(
    y: ArrayLike | Record,
    chains: float | Chain | Sequence[Chain],
    laws: FlowLaw | Sequence[FlowLaw | None] | None,
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
    u = np.broadcast_to(np.asarray(flow_u, dtype=float), (rows, count))
    medians = []
    lags: list[Array | None] = []
    factor = np.ones((rows, count))
    shift_s = np.zeros((3, rows, count))
    for c, (chain, law) in enumerate(zip(chains_for(chains, count), listed)):
        if law is None:
            medians.append(chain)
            lags.append(None)
            continue
        factor[:, c] = law.factor(v[:, c])
        lag_s = law.first_lag_s(chain, factor[:, c])
        _, *others_s = sorted(chain.taus_s, reverse=True)
        medians.append(replace(chain, taus_s=(float(np.median(lag_s)), *others_s)))
        lags.append(lag_s)
        shift_s[:, :, c] = sum(chain.taus_s) * law.factor_u(v[:, c], u[:, c])
    return FollowedFlow(medians, tuple(lags), factor, shift_s)
