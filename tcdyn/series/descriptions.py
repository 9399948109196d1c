"""Parts of the search for a clock: straight lines, pieces of rows, lengths of descriptions.

:mod:`tcdyn.series.fine_clock` and :mod:`tcdyn.series.coarse_clock` use them. The length of a
description is the negative logarithm of a probability; the shorter of two descriptions is the more
probable one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from tcdyn.core import Array

# Rows over which the phase of the clock may wander by a quarter of an interval; the phase of each
# piece is estimated from so many rows. At a scatter of 25 % of an interval it is known to 0.06
# intervals; ``python -m tests.series.clock_study`` counts rows that are misplaced.
PIECE_ROWS = 64
# Rows in which interval and resolution are searched first. More cost time only.
SEARCH_ROWS = 4096
# Spans [rows] and quantiles of their lengths that give first values of the interval. Longer spans
# average rounded steps; the lower quantile holds where most spans contain lost rows.
SEARCH_SPANS = (1, 2, 4, 8, 16)
SEARCH_QUANTILES = (0.2, 0.5)
# First values that are closer than this lead to one interval.
SAME_INTERVAL = 0.02
# Most decimals of a second that stamps are tested for: 1 ns.
MAX_DECIMALS = 9


def line(samples: NDArray[np.intp], t: Array) -> tuple[float, float]:
    """Slope and intercept of the straight line through stamps ``t`` (N,) at their samples."""
    mean_sample = samples.mean()
    centred = samples - mean_sample
    slope = float(centred @ (t - t.mean()) / (centred @ centred))
    return slope, float(t.mean() - slope * mean_sample)


def piece_edges(n: int) -> NDArray[np.intp]:
    """Rows between which pieces of about ``PIECE_ROWS`` of ``n`` rows lie."""
    return np.linspace(0, n, max(n // PIECE_ROWS, 1) + 1).astype(np.intp)


def step_code_length(samples: NDArray[np.intp]) -> float:
    """Length of a description of the steps between samples (N,) [natural units of information].

    The delta code of Elias has L + 2 floor(log2(L + 1)) + 1 bits with L = floor(log2 m) for a step
    of m samples. It is short where most rows follow each other, needs no parameter, and half the
    interval costs one bit a row for long steps, as it should. The one bit of each row, which all
    placings have, is left out.
    """
    steps = np.maximum(np.diff(samples), 1)
    size = np.floor(np.log2(steps))
    bits = size + 2 * np.floor(np.log2(size + 1))
    return float(np.log(2) * bits.sum())


def choice_code_length(n_chosen: int, n: int) -> float:
    """ln C(n, m): length of a description of which ``n_chosen`` of ``n`` rows differ."""
    return float(gammaln(n + 1) - gammaln(n_chosen + 1) - gammaln(n - n_chosen + 1))


def lost_code_length(lost: NDArray[np.intp], n_rows: int) -> float:
    """Length of a description of lost samples as rare events [natural units of information].

    Parameters
    ----------
    lost
        Samples lost before each of some rows (J,), which never falls.
    n_rows
        Number of all rows.

    Notes
    -----
    The choice of the rows before which samples are lost, and the code of their number. Lost samples
    are dearer here than in :func:`step_code_length`: with any rate, some of them bring the
    residuals of a coarse clock into their box.
    """
    steps = np.diff(lost)
    n_lost = int(np.count_nonzero(steps))
    sizes = step_code_length(np.cumsum(steps[steps > 0]))
    return choice_code_length(min(n_lost, n_rows), n_rows) + sizes


def smallest_scatter_s(resolution_s: float) -> float:
    """Standard deviation of stamps that are rounded to a resolution [s], at least to 1 ns."""
    return max(resolution_s, 10.0**-MAX_DECIMALS) / np.sqrt(12)


def find_resolution_s(t: Array) -> float:
    """The largest step of which all stamps (N,) are multiples [s]; 0 where there is none.

    The decimals of the first ``SEARCH_ROWS`` stamps are counted; whole numbers of the last decimal
    then have a greatest common divisor.
    """
    since_start = t[:SEARCH_ROWS] - t[0]
    rounding_s = 4 * float(np.spacing(np.abs(t).max()))
    for decimals in range(MAX_DECIMALS + 1):
        unit_s = 10.0**-decimals
        if rounding_s > 0.1 * unit_s:
            return 0.0
        units = since_start / unit_s
        whole = np.rint(units)
        if np.abs(units - whole).max() <= 1e-6 + rounding_s / unit_s:
            return float(np.gcd.reduce(whole.astype(np.int64))) * unit_s
    return 0.0


def slow_part(values: Array) -> Array:
    """Means of pieces of ``PIECE_ROWS`` values (N,), joined by straight lines."""
    edges = piece_edges(len(values))
    means = np.add.reduceat(values, edges[:-1]) / np.diff(edges)
    middle = 0.5 * (edges[:-1] + edges[1:] - 1)
    return np.interp(np.arange(len(values)), middle, means)
