"""Lags of heat conduction inside a sensor, after the lag of its surface.

``tcdyn.sensors.noise`` and ``pair`` use them. ``python -m tests.sensors.layered_study`` checks both
on layered sensors.
"""

from __future__ import annotations

import numpy as np

from tcdyn.chain import Chain
from tcdyn.core import Array

# Ratio of each further lag to the one before, and number of further lags: in a homogeneous cylinder
# the ratio is 0.3 to 0.54, and a metal core makes it less.
FURTHER_RATIO = 0.33
FURTHER_LAGS = 3
# Sum of the second lag and all further ones over the second.
SECOND_TO_ALL = (1 - FURTHER_RATIO ** (FURTHER_LAGS + 1)) / (1 - FURTHER_RATIO)


def conduction_chain(first_s: float, second_s: float, conduction: bool = True) -> Chain:
    """Return the chain of the first lag, the second, and the sum of all further ones if any."""
    further_s = (SECOND_TO_ALL - 1) * second_s * conduction
    taus = [tau for tau in (first_s, second_s, further_s) if tau > 0]
    return Chain(sorted(taus, reverse=True))


def inner_lags(second_s: float) -> Array:
    """Return the second and all further lags (1 + FURTHER_LAGS,) [s]."""
    lags = second_s * FURTHER_RATIO ** np.arange(FURTHER_LAGS + 1)
    return np.asarray(lags, dtype=np.float64)
