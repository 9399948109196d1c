"""The clock of a log: the even grid behind its time stamps.

Stamps stray, are rounded, repeat, and stand for rows that were lost. :func:`fit_clock` is the only
place that decides which sampling interval they have and which sample each row is. Whether a
deviation from the grid is an error of the stamp or a row that was really taken at another time
cannot be seen in stamps alone: that is :mod:`tcdyn.series.real_share`.

Tests: ``tests/series/test_clock.py``; study: ``python -m tests.series.clock_study``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tcdyn.core import Array
from tcdyn.series.coarse_clock import fit_coarse
from tcdyn.series.descriptions import (
    PIECE_ROWS,
    choice_code_length,
    find_resolution_s,
    line,
    lost_code_length,
    slow_part,
    step_code_length,
)
from tcdyn.series.fine_clock import fit_fine

# Step of the clock, in typical steps between rows, from which the description of a coarse clock is
# tried also where no stamp repeats: rounding then hides the phase from the fine description. At 0.5
# rounded stamps still keep two thirds of their coherence (sin(pi/2) / (pi/2)).
COARSE_RESOLUTION = 0.5
# Prior odds that rows whose stamps all differ are a whole number of steps of the clock apart, and a
# step that is skipped is a lost row. Two rows lost at regular distances in a block of a hundred
# would otherwise be a slower rate.
UNEVEN_TICKS_ODDS = 100.0
# Share of rows with the stamp of the row before, from which batches of rows are stamped as they
# arrive by a clock that is finer than the rows: a batch of two has a half.
BATCH_SHARE = 1 / 3
# Long pieces of a log for the uncertainty of its interval: of so many clusters the sandwich
# estimate is known to a quarter (1 / sqrt(2 x 10)).
LONG_PIECES = 10
# Scatter of the stamps, in intervals, that is too small to matter: readings are wrong by as much of
# their change from row to row, and lags by as much of a row.
MIN_STRAY = 0.01
# Part of an interval that a step of a clock that wanders may be shorter than two, and still is one
# with a lost row: three standard deviations of the largest scatter of such steps
# (``tcdyn.series.fine_clock.MAX_STEP_SCATTER``) are above one interval then.
SHORT_OF_NEXT = 0.25


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
        Sample of each row (N,): 0 for the first row, rising from row to row; equal for rows that
        stand twice.
    start_s
        Time of sample 0 on the grid [s].
    deviation_s
        Stamp minus time on the grid (N,) [s].
    resolution_s
        Step of the clock [s] of which all stamps are multiples; 0 where there is none.
    n_repeated
        Rows that are the same sample as the row before, with its stamp.
    is_coarse
        Whether the rows are finer than the clock: rows with one stamp are samples one after the
        other, and each was taken up to ``resolution_s`` after its stamp.
    is_wandering
        Whether the steps between rows scatter, and not the stamps about a grid, as for a loop that
        waits and then reads. Each row is then the sample that is nearest to its stamp.
    """

    interval_s: float
    u_interval_s: float
    index: NDArray[np.intp]
    start_s: float
    deviation_s: Array
    resolution_s: float
    n_repeated: int
    is_coarse: bool = False
    is_wandering: bool = False

    @property
    def size(self) -> int:
        """Samples of the grid from the first row to the last."""
        return int(self.index[-1]) + 1

    @property
    def missing(self) -> NDArray[np.intp]:
        """Samples of the grid without a row after each row but the last (N - 1,).

        Of a clock that wanders a sample without a row is none that is missing: the step tells.
        """
        missing = np.maximum(np.diff(self.index) - 1, 0)
        if not self.is_wandering:
            return missing
        steps = np.diff(self.even_s + self.deviation_s) / self.interval_s
        complete = np.floor(steps + SHORT_OF_NEXT).astype(np.intp)
        return np.minimum(missing, np.maximum(complete - 1, 0))

    @property
    def n_lost(self) -> int:
        """Samples of the grid that are missing."""
        return int(self.missing.sum())

    @property
    def stray_s(self) -> float:
        """Root mean square of the deviations [s]."""
        return float(np.sqrt(np.mean(self.deviation_s**2)))

    @property
    def jitter_s(self) -> Array:
        """Deviations without their slow part (N,) [s], which a wandering clock has."""
        return self.deviation_s - slow_part(self.deviation_s)

    @property
    def strays(self) -> bool:
        """Whether stamps deviate from the grid by more than rounding and ``MIN_STRAY`` explain."""
        explained_s = max(self.resolution_s, MIN_STRAY * self.interval_s)
        return not self.is_coarse and float(np.std(self.jitter_s)) > explained_s

    def without_long_gaps(self, longest: int) -> Clock:
        """The clock with gaps of at most ``longest`` samples: longer ones are shortened."""
        steps = np.minimum(np.diff(self.index), longest + 1)
        index = np.concatenate([[0], np.cumsum(steps)]).astype(np.intp)
        return replace(self, index=index)

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

    Where the steps between rows scatter, not the stamps about a grid, deviations add up; this is
    the other description that is tried. Where stamps repeat, either rows stand twice, or the clock
    is coarser than the rows: of these two, too, the shorter description is taken.

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
    n_repeated = len(t) - len(once)
    fine = fit_fine(once, interval_s, resolution_s)
    usual_step_s = float(np.median(steps[steps > 0]))
    is_even = float(np.ptp(steps)) <= MIN_STRAY * usual_step_s
    has_steps = resolution_s > COARSE_RESOLUTION * usual_step_s and not is_even
    if has_steps or n_repeated >= BATCH_SHARE * len(t):
        coarse = fit_coarse(t, is_new, interval_s, resolution_s)
        lost = fine.samples - np.arange(len(once))
        fine_length = fine.length - step_code_length(fine.samples)
        fine_length += lost_code_length(lost, len(once)) + choice_code_length(n_repeated, len(t))
        if not n_repeated:
            fine_length -= float(np.log(UNEVEN_TICKS_ODDS))
        if coarse is not None and coarse[1] < fine_length:
            return _coarse_clock(t, coarse[0], interval_s, resolution_s, is_new)
    samples = fine.samples[np.cumsum(is_new) - 1]
    if fine.is_wandering:
        return _wandering_clock(t, samples, interval_s, resolution_s, n_repeated)
    slope_s, start_s = _line_of(samples, t, interval_s)
    deviation_s = t - (start_s + slope_s * samples)
    u_s = _slope_uncertainty_s(samples, deviation_s, resolution_s)
    return Clock(slope_s, u_s, samples, start_s, deviation_s, resolution_s, n_repeated)


def _line_of(samples: NDArray[np.intp], t: Array, interval_s: float | None) -> tuple[float, float]:
    """Slope and intercept of stamps ``t`` (N,) at their samples; the slope may be known."""
    if interval_s is None:
        return line(samples, t)
    return interval_s, float(np.mean(t - interval_s * samples))


def _coarse_clock(
    t: Array,
    samples: NDArray[np.intp],
    interval_s: float | None,
    resolution_s: float,
    is_new: NDArray[np.bool_],
) -> Clock:
    """The clock of rows that are finer than it, whose samples are known.

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
    is_new
        Whether a row has another stamp than the row before (N,).

    Notes
    -----
    The first row of each stamp was taken less than one interval after it, the others later: a line
    through all rows would have the interval as its slope only where each stamp has the same number
    of rows. So the line goes through the first rows; the first stamp of the log is left out, since
    its first row may have been lost.
    """
    used = is_new.copy()
    used[0] = bool(is_new.all())
    slope_s, start_s = _line_of(samples[used], t[used], interval_s)
    deviation_s = t - (start_s + slope_s * samples)
    u_s = _slope_uncertainty_s(samples[used], deviation_s[used], slope_s)
    n_skips = int(np.count_nonzero(np.diff(samples) > 1))
    skips_u_s = slope_s * n_skips / (np.sqrt(3) * len(samples))
    u_s = float(np.hypot(u_s, skips_u_s))
    return Clock(slope_s, u_s, samples, start_s, deviation_s, resolution_s, 0, is_coarse=True)


def _wandering_clock(
    t: Array,
    samples: NDArray[np.intp],
    interval_s: float | None,
    resolution_s: float,
    n_repeated: int,
) -> Clock:
    """The clock of rows whose steps scatter, so that they leave any grid.

    The interval is the mean step, and each row is the sample that is nearest to its stamp: two rows
    may be one sample, and a sample may have no row. The parameters are those of
    :func:`_coarse_clock`.
    """
    n_samples = int(samples[-1])
    mean_s = interval_s or float(t[-1] - t[0]) / n_samples
    error_s = np.diff(t) - mean_s * np.diff(samples)
    u_s = float(np.sqrt(np.sum(error_s**2)) / n_samples)
    start_s = float(np.median(t - mean_s * samples))
    index = np.rint((t - start_s) / mean_s).astype(np.intp)
    start_s += mean_s * float(index[0])
    index -= index[0]
    deviation_s = t - (start_s + mean_s * index)
    return Clock(
        mean_s, u_s, index, start_s, deviation_s, resolution_s, n_repeated, is_wandering=True
    )


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
    The largest of three: that of independent deviations; the sandwich estimate with short and with
    long pieces of rows as clusters, for a clock that wanders quickly or slowly; and that of a line
    whose two ends are each rounded, which no later stamp corrects where the interval is nearly a
    multiple of the rounding (rounding / sqrt(6) over the whole).
    """
    centred = samples - samples.mean()
    lever = float(centred @ centred)
    independent = np.sqrt(np.mean(deviation_s**2) / lever)
    terms = centred * deviation_s
    wandering = 0.0
    for n_pieces in (len(samples) // PIECE_ROWS, LONG_PIECES):
        edges = np.linspace(0, len(samples), n_pieces + 1).astype(np.intp)
        if np.all(np.diff(edges) > 0) and n_pieces > 1:
            scores = np.add.reduceat(terms, edges[:-1])
            wandering = max(wandering, float(np.sqrt(scores @ scores) / lever))
    rounded = rounding_s / np.sqrt(6) / (samples[-1] - samples[0])
    return float(max(independent, wandering, rounded))


def mean_interval_s(time_s: Array) -> float:
    """Sampling interval [s] of even times (N,).

    The mean step is used: stamps may be rounded, and then the median of the steps is rounded, too.

    >>> round(75 * mean_interval_s(np.round(np.arange(10.0) / 75, 3)), 9)
    1.0
    """
    return float(time_s[-1] - time_s[0]) / (len(time_s) - 1)
