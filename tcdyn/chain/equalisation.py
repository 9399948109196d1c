"""Equalisation of channels: readings of several chains as if all had one chain.

Used by ``tcdyn.partition``. Guarded by ``tests/chain/test_chain.py`` and
``tests/partition/test_equalise.py``.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tcdyn.chain.chain import Chain
from tcdyn.chain.rational import Factor, Rational, polynomial_product, simulate
from tcdyn.core import Array
from tcdyn.core.arguments import with_named_arguments

# lag [s] that is added where a filter would not be proper; far below the usual sampling interval of
# 13 ms; chosen by judgement
LEAST_LAG_S = 1e-3
# start of a record [s] whose mean is the reading before it; longer averages more noise, but also
# more of a slope; chosen by judgement
START_S = 1.0


@with_named_arguments
def equalise(y: Array, dt_s: float, chains: Sequence[Chain], common: Chain) -> Array:
    """Filter each channel so that it reads as another chain would have; no inverse is needed.

    Parameters
    ----------
    y
        Readings, (N, M) [degC].
    dt_s
        Sampling interval [s].
    chains
        Chain of each channel.
    common
        Chain that all channels get.

    Returns
    -------
    Equalised readings, (N, M) [degC].

    Notes
    -----
    Column i is filtered by G_common / G_i, in which the conditioning cancels. Where the common
    chain has as many lags, noise grows at most by their ratio. A channel with more dead time than
    the common chain keeps its excess. The filter starts at rest, at the mean of the column over the
    first ``START_S``.
    """
    out = np.empty_like(y)
    for i, chain in enumerate(chains):
        before = np.mean(y[: max(int(START_S / dt_s), 1), i])
        column = np.concatenate([[before], y[:, i]])
        out[:, i] = simulate(_quotient(common, chain), column, dt_s)[1:]
    return out


def _quotient(upper: Chain, lower: Chain) -> Rational:
    """G_upper / G_lower without their filters, kept proper.

    Parameters
    ----------
    upper, lower
        The two chains.

    Notes
    -----
    Lags of ``LEAST_LAG_S`` are added where there are more lags below than above; a negative delay
    is neglected.
    """
    num: Array = polynomial_product(lower.factors_without_filter())
    denominator = list(upper.factors_without_filter())
    if upper.zero_s != lower.zero_s:
        num = polynomial_product([num, (1.0, upper.zero_s)])
        denominator.append((1.0, max(lower.zero_s, LEAST_LAG_S)))
    excess = len(num) - 1 - sum(len(f) - 1 for f in denominator)
    denominator += [(1.0, LEAST_LAG_S)] * excess
    return Rational(
        num, tuple(Factor(f) for f in denominator), max(upper.delay_s - lower.delay_s, 0.0)
    )
