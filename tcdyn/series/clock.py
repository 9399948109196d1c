"""The clock of a log: the even grid behind its time stamps.

Stamps stray, are rounded, repeat, and stand for rows that were lost. :func:`fit_clock` is the only
place that decides which sampling interval they have and which sample each row is. Whether a
deviation from the grid is an error of the stamp or a row that was really taken at another time
cannot be seen in stamps alone: that is :mod:`tcdyn.series.real_share`.

Tests: ``tests/series/test_clock.py``; study: ``python -m tests.series.clock_study``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tcdyn.core import Array
from tcdyn.series.coarse_clock import fit_coarse
from tcdyn.series.descriptions import choice_code_length, find_resolution_s, line, piece_edges
from tcdyn.series.fine_clock import fit_fine


@dataclass(frozen=True)
class Clock:
    """Even grid of a log and the deviations of its stamps from it.

    Attributes
    ----------
    interval_s
        Sampling interval [s].
    u_interval_s
        Its standard uncertainty [s].
    index
        Sample of each row (N,): 0 for the first row, larger by one or more from row to row; equal
        for rows that stand twice.
    start_s
        Time of sample 0 on the grid [s].
    deviation_s
        Stamp minus time on the grid (N,) [s].
    resolution_s
        Step of the clock [s] of which all stamps are multiples; 0 where there is none.
    is_coarse
        Whether the rows are finer than the clock: rows with one stamp are samples one after the
        other, and each was taken up to ``resolution_s`` after its stamp.
    """

    interval_s: float
    u_interval_s: float
    index: NDArray[np.intp]
    start_s: float
    deviation_s: Array
    resolution_s: float
    is_coarse: bool

    @property
    def size(self) -> int:
        """Samples of the grid from the first row to the last."""
        return int(self.index[-1]) + 1

    @property
    def n_lost(self) -> int:
        """Samples of the grid that have no row."""
        return self.size - len(np.unique(self.index))

    @property
    def n_repeated(self) -> int:
        """Rows that are the same sample as the row before."""
        return int(np.count_nonzero(np.diff(self.index) == 0))

    @property
    def stray_s(self) -> float:
        """Root mean square of the deviations [s]."""
        return float(np.sqrt(np.mean(self.deviation_s**2)))

    @property
    def even_s(self) -> Array:
        """Time of each row on the grid (N,) [s]."""
        return np.asarray(self.start_s + self.interval_s * self.index, dtype=float)


def fit_clock(stamps_s: Array, interval_s: float | None = None) -> Clock:
    """Find the even grid behind time stamps, and the sample of each row.

    Parameters
    ----------
    stamps_s
        Time stamps (N,) [s], finite, that do not go back and are not all equal.
    interval_s
        Sampling interval where it is known, for example from an earlier part of the log [s].

    Returns
    -------
    Clock
        Interval, sample of each row, and deviations.

    Raises
    ------
    ValueError
        For stamps that are not finite, go back or are all equal: check them before.

    Notes
    -----
    Row i with stamp t_i is sample k_i of the grid, t_i = a + dt k_i + e_i, and k rises by one or
    more from row to row. For a known dt the residual r_i = t_i / dt - i is a slow phase, plus the
    samples lost so far o_i, an integer that never falls, plus the deviation. The fractional part of
    r tells the phase, whatever was lost. Given the phase, the o that minimises the sum of squares
    is the isotonic regression of r, rounded: the problem separates into one threshold for each
    integer, and the rounded regression solves all of them. This is the most probable placing for
    Gaussian deviations.

    Candidates for dt are quantiles of spans of rows. Each is refined to the largest coherence
    \\|sum exp(2 pi i t / dt)\\| of pieces of rows that grow, which lost rows do not bias, and the
    one with the shortest description is taken. The last value is the slope of a straight line
    through stamps and samples (``_slope_uncertainty_s`` for its uncertainty).

    Where stamps repeat, either rows stand twice, or the clock is coarser than the rows. Both are
    fitted, and the shorter description is taken.

    Examples
    --------
    >>> clock = fit_clock(np.array([0.0, 0.013, 0.027, 0.040, 0.067, 0.080, 0.093, 0.107]))
    >>> round(1 / clock.interval_s), clock.index.tolist(), clock.n_lost
    (75, [0, 1, 2, 3, 5, 6, 7, 8], 1)
    """
    t = np.asarray(stamps_s, dtype=float)
    steps = np.diff(t)
    if not (len(steps) and np.isfinite(t).all() and steps.min() >= 0 and t[-1] > t[0]):
        raise ValueError("stamps must be finite, must not go back, and must not all be equal")
    is_new = np.append(True, steps > 0)
    resolution_s = find_resolution_s(t)
    once = t[is_new]
    fine_samples, fine_length = fit_fine(once, interval_s, resolution_s)
    samples = fine_samples[np.cumsum(is_new) - 1]
    is_coarse = False
    n_repeated = len(t) - len(once)
    if n_repeated:
        coarse = fit_coarse(t, is_new, interval_s, resolution_s)
        fine_length += choice_code_length(n_repeated, len(t))
        if coarse is not None and coarse[1] < fine_length:
            samples = coarse[0]
            is_coarse = True
    return _clock(t, samples, interval_s, resolution_s, is_coarse, is_new)


def _clock(
    t: Array,
    samples: NDArray[np.intp],
    interval_s: float | None,
    resolution_s: float,
    is_coarse: bool,
    is_new: NDArray[np.bool_],
) -> Clock:
    """The clock of stamps whose samples are known.

    Parameters
    ----------
    t
        Stamps (N,) [s].
    samples
        Sample of each row (N,).
    interval_s
        Interval that is known [s]; None: the slope of a straight line through the stamps.
    resolution_s
        Step of the clock [s].
    is_coarse
        Whether the rows are finer than the clock.
    is_new
        Whether a row has another stamp than the row before (N,).

    Notes
    -----
    The first row of each stamp of a coarse clock was taken less than one interval after it, the
    others later: a line through all rows would have the interval as its slope only where each stamp
    has the same number of rows. So the line goes through the first rows; the first stamp of the log
    is left out, since its first row may have been lost.
    """
    used = is_new.copy() if is_coarse else np.ones(len(t), dtype=bool)
    if is_coarse and np.count_nonzero(used) > 2:
        used[0] = False
    slope_s, start_s = line(samples[used], t[used])
    if interval_s is not None:
        slope_s = interval_s
        start_s = float(np.mean(t[used] - slope_s * samples[used]))
    deviation_s = t - (start_s + slope_s * samples)
    rounding_s = slope_s if is_coarse else resolution_s
    u_s = _slope_uncertainty_s(samples[used], deviation_s[used], rounding_s)
    return Clock(slope_s, u_s, samples, start_s, deviation_s, resolution_s, is_coarse)


def _slope_uncertainty_s(samples: NDArray[np.intp], deviation_s: Array, rounding_s: float) -> float:
    """Standard uncertainty of the slope of :func:`line` [s].

    Parameters
    ----------
    samples
        Samples (N,).
    deviation_s
        Deviations (N,) [s].
    rounding_s
        Width of the rounding of the stamps [s].

    Notes
    -----
    The largest of three: that of independent deviations; the sandwich estimate with pieces of
    ``PIECE_ROWS`` rows as clusters, for a clock that wanders; and that of a line whose two ends are
    each rounded, which no later stamp corrects where the interval is nearly a multiple of the
    rounding (rounding / sqrt(6) over the whole).
    """
    centred = samples - samples.mean()
    lever = float(centred @ centred)
    independent = np.sqrt(np.mean(deviation_s**2) / lever)
    scores = np.add.reduceat(centred * deviation_s, piece_edges(len(samples))[:-1])
    wandering = np.sqrt(scores @ scores) / lever
    rounded = rounding_s / np.sqrt(6) / (samples[-1] - samples[0])
    return float(max(independent, wandering, rounded))
