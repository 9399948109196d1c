"""Means of a smoothed record: their values and uncertainties.

Made by :mod:`tcdyn.smoothing.time_means`; part of ``tcdyn.smoothing.record.Compensated``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tcdyn.core import Array, Flags

# Fewest rows that a mean covers: it stands at the row in its middle
FEWEST_ROWS = 2
# Share of its length by which a number of rows is exceeded only by rounding
SAME_LENGTH = 1e-6


def even_rows_s(length_s: float, dt_s: float) -> float:
    """A time [s] rounded up to an even number of rows, ``dt_s`` [s] apart.

    >>> even_rows_s(4.5, 1.0), even_rows_s(6.0, 1.0)
    (6.0, 6.0)
    """
    pairs = np.ceil(length_s / (FEWEST_ROWS * dt_s) - SAME_LENGTH)
    return float(FEWEST_ROWS * pairs * dt_s)


def common_lag_u_s(lag_covariance: Array) -> float:
    """Standard uncertainty [s] of the mean lag of M channels, from their covariance (M, M) [s2].

    >>> common_lag_u_s(np.full((2, 2), 0.04))
    0.2
    """
    return float(np.sqrt(max(np.sum(lag_covariance), 0.0))) / len(lag_covariance)


@dataclass(frozen=True)
class TimeMeans:
    """Means of a smoothed record over W times; arrays (W, M), one column a channel.

    Parameters
    ----------
    length_s
        Length of each time [s].
    sample
        Index (W,) of the sample in the middle of each.
    row
        Index (W,) of the sample with a row that is next to it: itself, unless that row is missing.
    mean
        Mean temperature [degC].
    sd
        Its standard deviation [K].
    sd_noise
        The part of it from noise and smoothing [K], independent of the lag and of the static line.
    covariance_next
        Covariance (W - 1, M) [K2] of that part with the next mean, from ``sd_noise``; NaN where the
        next one does not follow at once.
    lag_sensitivity
        Change of the mean per second of lag [K/s].
    """

    length_s: float
    sample: NDArray[np.intp]
    row: NDArray[np.intp]
    mean: Array
    sd: Array
    sd_noise: Array
    covariance_next: Array
    lag_sensitivity: Array

    @property
    def sd_record(self) -> Array:
        """The part of ``sd`` that is one error for the whole record: lag, events, static line."""
        return np.asarray(np.sqrt(np.maximum(self.sd**2 - self.sd_noise**2, 0.0)))

    def common_sd(self, lag_covariance: Array) -> Array:
        """Part of ``sd`` (W, M) [K] by the error that all lags have in common.

        Parameters
        ----------
        lag_covariance
            Covariance of the lags (M, M) [s2].
        """
        return np.abs(self.lag_sensitivity) * common_lag_u_s(lag_covariance)

    def without(self, withheld: Flags) -> TimeMeans:
        """The means with NaN where they are withheld (W, M)."""
        return replace(
            self,
            mean=np.where(withheld, np.nan, self.mean),
            sd=np.where(withheld, np.nan, self.sd),
        )
