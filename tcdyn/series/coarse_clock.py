"""The samples of rows that are finer than their clock, or hardly slower than it.

Stamps then repeat, or skip a step of the clock at regular distances.

:func:`tcdyn.series.clock.fit_clock` uses it. Tests: ``tests/series/test_clock.py``.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import isotonic_regression
from scipy.special import log_ndtr

from tcdyn.core import Array
from tcdyn.series.descriptions import (
    MAX_DECIMALS,
    SAME_INTERVAL,
    SEARCH_QUANTILES,
    SEARCH_SPANS,
    line,
    lost_code_length,
    piece_edges,
)

# Stamps in which the interval is searched first, steps of the search as a shift of the last row,
# number of candidates, and stamps from which one of them is certain. Finer and more cost time only.
SEARCH_TICKS = 64
COARSE_STEP_ROWS = 0.25
COARSE_CANDIDATES = 16
MOST_INTERVALS = 400
SURE_TICKS = 1024
# Ratio of first values of the interval beyond which the rows are not even; bounds the search.
LARGEST_RATIO = 2.0
# Phases that are tried, in intervals: rows are misplaced in half a step of them.
PHASES = tuple(np.arange(8) / 8)
# Quantiles between which the deviations of rows lie that do not stray far; by judgement.
RANGE = (0.03, 0.97)
# Smallest difference of logarithms that is not zero in the sum of a box.
TINY = 1e-12
# Scatters of the rows that are tried, in intervals.
STRAYS = (0.002, 0.02, 0.05, 0.1, 0.18, 0.3, 0.5, 1.0)


def fit_coarse(
    t: Array, is_new: NDArray[np.bool_], interval_s: float | None, resolution_s: float
) -> tuple[NDArray[np.intp], float] | None:
    """Samples of rows that are finer than their clock, and the length of their description.

    Parameters
    ----------
    t
        Stamps (N,) [s], which do not go back.
    is_new
        Whether a row has another stamp than the row before (N,).
    interval_s
        Interval where it is known [s].
    resolution_s
        Step of the clock [s].

    Returns
    -------
    samples, length
        As for ``tcdyn.series.fine_clock.fit_fine``; None where there are fewer than four stamps.

    Notes
    -----
    The first row of a stamp was taken less than one interval after it. Its residual, in intervals,
    is therefore a phase, plus the samples lost so far, plus a number between -1 and 0. Fractional
    parts that cover a whole interval do not tell the phase; it is searched together with the
    interval, first over ``SEARCH_TICKS`` stamps, then over more and more of them.
    """
    first_rows = np.flatnonzero(is_new)
    if not is_new.all():
        first_rows = first_rows[1:]  # the first row of the first stamp may have been lost
    if len(first_rows) < 3:
        return None
    ticks = _Ticks(first_rows, t[first_rows], resolution_s)
    best_s = interval_s or _search_coarse_interval_s(ticks)
    lost, length = ticks.place(best_s)
    length += ticks.choice_length(best_s)
    if interval_s is None:
        mean_s, mean_length = ticks.keep_all()
        mean_length += ticks.choice_length(mean_s)
        if mean_length < length:
            return np.arange(len(t)), mean_length
    if first_rows[0] > 0:
        # rows of the first stamp: taken less than a usual step of the stamps after it
        usual_s = float(np.median(np.diff(ticks.stamps_s)))
        missing_s = float(ticks.stamps_s[0] - t[0]) - usual_s
        lost_before = max(int(np.rint(missing_s / best_s)), 0)
        lost = np.concatenate([[lost[0] - lost_before], lost])
    lost_of_row = lost[np.cumsum(is_new) - 1]
    samples = np.arange(len(t)) + lost_of_row
    return samples - samples[0], length


def _search_coarse_interval_s(ticks: _Ticks) -> float:
    """The interval of the rows of a coarse clock with the shortest description [s].

    Each candidate, and the slope of the straight line through its samples, is described over more
    and more stamps. From ``SURE_TICKS`` on there is only one.
    """
    size = min(SEARCH_TICKS, len(ticks.rows))
    candidates = _coarse_intervals_s(ticks.first(size))
    while True:
        part = ticks.first(size)
        lengths = {}
        for dt in candidates:
            lost, length = part.place(dt)
            lengths[dt] = length + part.choice_length(dt)
            refined_s, _ = line(part.rows + lost, part.stamps_s)
            lengths[refined_s] = part.place(refined_s)[1] + part.choice_length(refined_s)
        candidates = sorted(lengths, key=lambda dt: lengths[dt])[:COARSE_CANDIDATES]
        if size >= SURE_TICKS:
            candidates = candidates[:1]
        if size == len(ticks.rows):
            return candidates[0]
        size = min(2 * size, len(ticks.rows))


@dataclass(frozen=True)
class _Ticks:
    """The first row of each stamp of a coarse clock, and the stamps.

    Attributes
    ----------
    rows
        First row of each stamp (J,).
    stamps_s
        The stamps (J,) [s].
    resolution_s
        Step of the clock [s].
    """

    rows: NDArray[np.intp]
    stamps_s: Array
    resolution_s: float

    def first(self, size: int) -> _Ticks:
        """The first ``size`` of them."""
        return _Ticks(self.rows[:size], self.stamps_s[:size], self.resolution_s)

    def choice_length(self, interval_s: float) -> float:
        """Length of a description of the interval, the phase, and the places of the stamps.

        Notes
        -----
        The logarithm of the number of phases and of intervals that the rows distinguish. A whole
        fraction of the step of the clock, such as 0.1 s of 1 s, needs no choice of the interval:
        loggers have such rates. Where the step is finer than half the rows, as for rows that are
        stamped when a batch of them arrives, rounding does not tell the stamp, and each adds the
        logarithm of the number of its places in an interval.
        """
        n_rows = float(self.rows[-1] - self.rows[0])
        length = float(np.log(len(PHASES)))
        fraction = self.resolution_s / interval_s
        is_whole_fraction = abs(fraction - np.rint(fraction)) * n_rows < fraction
        if not (is_whole_fraction and fraction > 0.5):
            length += float(np.log(n_rows / COARSE_STEP_ROWS))
        places = self._places(interval_s)
        if places < 2:
            return length
        return length + len(self.rows) * float(np.log(places))

    def _half_width(self, interval_s: float) -> float:
        """Half of the box in which a row has its stamp for certain, in intervals."""
        places = self._places(interval_s)
        return 0.5 / places if 1 < places < 2 else 0.5

    def _places(self, interval_s: float) -> float:
        """Steps of the clock in an interval of the rows."""
        return interval_s / max(self.resolution_s, 10.0**-MAX_DECIMALS)

    def place(self, interval_s: float) -> tuple[NDArray[np.intp], float]:
        """Samples lost before each of the rows (J,), and the length of the description.

        Parameters
        ----------
        interval_s
            Interval of the rows [s].

        Notes
        -----
        A residual within the box of one interval, or of one step of the clock where that is less,
        needs no description. Beyond it the row strays: the box is convolved with a Gaussian, whose
        scatter is the best of ``STRAYS``.
        """
        residual = (self.stamps_s - self.stamps_s[0]) / interval_s - (self.rows - self.rows[0])
        half_width = self._half_width(interval_s)
        n_rows = int(self.rows[-1] - self.rows[0]) + 1
        best_length = np.inf
        best_lost = np.zeros(len(residual), dtype=np.intp)
        for phase in PHASES:
            centred = residual - phase
            lost = np.rint(isotonic_regression(centred).x).astype(np.intp)
            deviation = centred - lost
            # the phase within its step: the middle of the range, without rows that stray far
            deviation = np.abs(deviation - np.quantile(deviation, RANGE).mean())
            outside = [-_log_box(deviation, half_width, stray) for stray in STRAYS]
            length = min(outside) + lost_code_length(lost, n_rows)
            if length < best_length:
                best_length = length
                best_lost = lost
        return best_lost, best_length

    def keep_all(self) -> tuple[float, float]:
        """Interval and length of the description in which no row is lost and the clock may wander.

        Returns
        -------
        interval_s
            Mean interval of the rows [s].
        length
            Length of the description. The middle of each piece of rows is known to a part of an
            interval: one parameter, which costs half the logarithm of its rows (Schwarz 1978).

        Notes
        -----
        A loop that waits a second and then reads takes 1.01 s for a row, on average. Stamps of
        whole seconds then skip one in a hundred, as if a row were lost, but at regular distances.
        """
        interval_s, start_s = line(self.rows, self.stamps_s)
        residual = (self.stamps_s - start_s) / interval_s - self.rows
        edges = piece_edges(len(residual))
        middle = np.array([np.quantile(residual[a:b], RANGE).mean() for a, b in pairwise(edges)])
        at = 0.5 * (edges[:-1] + edges[1:] - 1)
        deviation = np.abs(residual - np.interp(np.arange(len(residual)), at, middle))
        half_width = self._half_width(interval_s)
        outside = [-_log_box(deviation, half_width, stray) for stray in STRAYS]
        wander = 0.5 * len(middle) * float(np.log(len(residual) / len(middle)))
        return interval_s, min(outside) + wander


def _log_box(deviation: Array, half_width: float, stray: float) -> float:
    """Sum of the logarithms of the probabilities that rows have their stamps.

    Parameters
    ----------
    deviation
        Absolute deviations (J,), in intervals.
    half_width
        Half of the step of the clock, in intervals: a row within it has its stamp for certain.
    stray
        Standard deviation of the rows, in intervals.
    """
    near = log_ndtr((half_width - deviation) / stray)
    far = log_ndtr((-half_width - deviation) / stray)
    return float(np.sum(near + np.log1p(-np.exp(np.minimum(far - near, -TINY)))))


def _coarse_intervals_s(ticks: _Ticks) -> list[float]:
    """The most probable intervals of the rows of a coarse clock, from its first stamps [s].

    Notes
    -----
    All intervals between the shortest and the longest quantile of spans are tried, in steps over
    which the last row moves by ``COARSE_STEP_ROWS``, and the quantiles themselves: the median of
    spans is exact where the stamps are whole numbers of rows apart.
    """
    ratios = []
    for span in SEARCH_SPANS:
        if span == 1 or 2 * span < len(ticks.rows):
            span_s = ticks.stamps_s[span:] - ticks.stamps_s[:-span]
            rows = ticks.rows[span:] - ticks.rows[:-span]
            ratios += [float(np.quantile(span_s / rows, q)) for q in SEARCH_QUANTILES]
    usual = float(np.median(ratios))
    ratios = [ratio for ratio in ratios if usual / LARGEST_RATIO < ratio < usual * LARGEST_RATIO]
    lowest = np.log(min(ratios)) - SAME_INTERVAL
    highest = np.log(max(ratios)) + SAME_INTERVAL
    step = COARSE_STEP_ROWS / float(ticks.rows[-1] - ticks.rows[0])
    step = max(step, (highest - lowest) / MOST_INTERVALS)
    tried = np.exp(np.arange(lowest, highest, step))
    lengths = np.array([ticks.place(dt)[1] for dt in tried])
    beside = np.concatenate([[np.inf], lengths, [np.inf]])
    minima = np.flatnonzero((lengths <= beside[:-2]) & (lengths <= beside[2:]))
    best = minima[np.argsort(lengths[minima])][:COARSE_CANDIDATES]
    return [*np.unique(ratios).tolist(), *tried[best].tolist()]
