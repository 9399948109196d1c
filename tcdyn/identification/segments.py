"""Segments of a record in which every input is measured, and the noise of a measured input.

``tcdyn.identification.search.make_problem`` and the checks of the record use them. A gap of the
output stays in a segment; a gap of the input ends it.
``tests/identify/test_identify_closed_forms.py`` checks segments and input noise,
``tests/identify/test_identify_data.py`` gaps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import comb

import numpy as np

from tcdyn.core import Array, Flags
from tcdyn.estimation.trace_noise import MAD_TO_SD, interpolate_gaps
from tcdyn.identification.holds import MIN_REPEATED_SHARE
from tcdyn.identification.iodata import IOData

# Noise of the input over its standard deviation, above which the fast part is signal and not noise
# (chosen by judgement).
MAX_INPUT_NOISE_SHARE = 0.1
# Shortest segment in samples that is used (chosen by judgement).
MIN_SEGMENT_SAMPLES = 8
# Noise of the input over its range, below which it is negligible (chosen by judgement).
MIN_INPUT_NOISE_SHARE = 1e-4

# Longest gap of an input in samples that is interpolated, and the rms error of an interpolation of
# measured samples over the input's standard deviation, up to which it is (chosen by judgement).
MAX_BRIDGED_SAMPLES = 5
MAX_BRIDGED_ERROR = 0.02
# Consecutive equal samples at a limit of the output, and all of them together, from which the
# output is clipped (chosen by judgement).
MIN_CLIPPED_RUN = 3
MIN_CLIPPED_SAMPLES = 6
# Change before and after such samples over the median change, above which the output enters and
# leaves the limit abruptly; at rest it does so gradually (chosen by judgement).
MIN_ABRUPT_SHARE = 0.2
# Share of equal neighbours, above which a coarse logger explains them (chosen by judgement).
MAX_EQUAL_SHARE = 0.4


@dataclass(frozen=True)
class Segment:
    """A segment of a run without missing inputs.

    A segment that has past inputs follows a gap. Its initial state is unknown; the inputs that a
    dead time delays are known.

    Parameters
    ----------
    inputs
        Inputs (N, K), all finite.
    y
        Output (N,), NaN where it was not measured.
    measured
        Whether the output was measured (N,).
    run
        Number of its run.
    first
        Number of its first sample in the run.
    start_s
        Time of the first sample [s].
    past_inputs
        Inputs of the run before the segment (M, K), gaps interpolated linearly.
    """

    inputs: Array
    y: Array
    measured: np.ndarray
    run: int
    first: int
    start_s: float
    past_inputs: Array

    @property
    def u(self) -> Array:
        """The first input (N,)."""
        return self.inputs[:, 0]

    @property
    def filled_y(self) -> Array:
        """Output (N,) with its gaps interpolated linearly; not for estimates."""
        return interpolate_gaps(self.y, self.measured)

    @property
    def past_input(self) -> Array:
        """The first input before the segment (M,)."""
        return self.past_inputs[:, 0]

    def with_input(self, k: int) -> Segment:
        """The segment with the ``k``-th input only."""
        return replace(self, inputs=self.inputs[:, [k]], past_inputs=self.past_inputs[:, [k]])

    @property
    def after_gap(self) -> bool:
        """Whether the segment follows a gap of its run."""
        return len(self.past_input) > 0

    def last_inputs(self, count: int) -> Array:
        """Return the last values of the first input before the segment.

        Before the run the input is constant at its first value.

        Parameters
        ----------
        count
            Number of samples.

        Returns
        -------
        array
            Inputs (count,).
        """
        first = np.concatenate([self.past_input, self.u])[0]
        n_missing = max(count - len(self.past_input), 0)
        padded = np.concatenate([np.full(n_missing, first), self.past_input])
        return padded[len(padded) - count :]


def true_intervals(flags: Flags) -> list[slice]:
    """Return the intervals in which flags (N,) are true.

    >>> true_intervals(np.array([True, True, False, True]))
    [slice(0, 2, None), slice(3, 4, None)]
    """
    edges = np.flatnonzero(np.diff(flags.astype(np.int8), prepend=0, append=0))
    return [slice(start, end) for start, end in edges.reshape(-1, 2).tolist()]


def row_slices(used: Flags, spacing: int = 1) -> list[slice]:
    """Return the slices of consecutive samples among the used ones of flags (N,).

    Consecutive samples are ``spacing`` rows apart.

    >>> row_slices(np.array([True, True, False, True]))
    [slice(0, 2, None), slice(2, 3, None)]
    """
    rows = np.flatnonzero(used)
    breaks = np.flatnonzero(np.diff(rows) != spacing) + 1
    edges = [0, *breaks.tolist(), len(rows)]
    return [slice(start, end) for start, end in pairwise(edges) if end > start]


def split_segments(data: IOData) -> tuple[Segment, ...]:
    """Cut the runs where an input is missing.

    Segments shorter than ``MIN_SEGMENT_SAMPLES`` are dropped, unless the run itself is shorter.
    Short gaps of an input that hardly changes over them are interpolated (:func:`bridge_gaps`).

    Parameters
    ----------
    data
        The record.

    Returns
    -------
    tuple of Segment
        The segments in the order of the runs.

    Notes
    -----
    ``tests/identify/test_identify_closed_forms.py`` checks that short segments are left out.
    """
    segments = []
    for run_number, run in enumerate(data.runs):
        inputs = np.column_stack([bridge_gaps(u) for u in run.u.T])
        has_input = np.asarray(np.isfinite(inputs).all(axis=1))
        for rows in true_intervals(has_input):
            start = rows.start
            end = rows.stop
            y = run.y[start:end, 0]
            measured = np.isfinite(y) & ~clipped_samples(y)
            if end - start < min(MIN_SEGMENT_SAMPLES, run.n) or not measured.any():
                continue
            index = np.flatnonzero(has_input[:end])
            earlier = np.arange(index[0], start)
            past = np.array([np.interp(earlier, index, u[index]) for u in inputs.T]).T
            start_s = run.start_s + start * data.dt_s
            segments.append(
                Segment(inputs[start:end], y, measured, run_number, start, start_s, past)
            )
    return tuple(segments)


def bridge_gaps(u: Array) -> Array:
    """Return an input whose short gaps are interpolated linearly, where that is exact enough.

    Parameters
    ----------
    u
        One input (N,), NaN where it is missing.

    Returns
    -------
    array
        The input (N,). Gaps of more than ``MAX_BRIDGED_SAMPLES`` stay, and those for which
        :func:`interpolation_error` is above ``MAX_BRIDGED_ERROR`` of the standard deviation: it is
        not known when the input has changed within them.
    """
    index = np.flatnonzero(np.isfinite(u))
    if len(index) == len(u) or len(index) < 2:
        return u
    filled = u.copy()
    rounding = 1e-12 * float(np.nanmax(np.abs(u)))
    limit = MAX_BRIDGED_ERROR * float(np.nanstd(u)) + rounding
    for before, after in pairwise(index.tolist()):
        count = after - before
        if not 1 < count <= MAX_BRIDGED_SAMPLES + 1:
            continue
        change = abs(u[after] - u[before])
        if interpolation_error(u, count, change) <= limit:
            filled[before:after] = np.linspace(u[before], u[after], count, endpoint=False)
    return filled


def interpolation_error(u: Array, count: int, change: float) -> float:
    """Rms error of a linear interpolation over ``count`` samples that have been measured.

    Parameters
    ----------
    u
        One input (N,), NaN where it is missing.
    count
        Samples from one end of the interpolation to the other.
    change
        Intervals are used whose ends differ by this much, or by down to half of it.

    Returns
    -------
    float
        Error in the middle of the intervals; infinite where there is none.
    """
    start = u[:-count]
    end = u[count:]
    middle = u[count // 2 : len(u) - count + count // 2]
    weight = (count // 2) / count
    error = middle - (1 - weight) * start - weight * end
    size = np.abs(end - start)
    is_used = np.isfinite(error) & (size <= change) & (size >= 0.5 * change)
    return float(np.sqrt(np.mean(error[is_used] ** 2))) if is_used.any() else np.inf


def clipped_samples(y: Array) -> Flags:
    """Return which samples of an output lie at a limit of its range, and so are clipped.

    Parameters
    ----------
    y
        The output (N,), NaN where it was not measured.

    Returns
    -------
    flags
        True at clipped samples (N,).

    Notes
    -----
    Samples at the largest or smallest value, where the output enters and leaves that value by an
    ordinary change and stays there in between. An output at rest, and one of a coarse logger, is
    not clipped.
    """
    clipped = np.zeros(len(y), dtype=bool)
    changes = np.abs(np.diff(y))
    moving = changes[changes > 0]
    if len(moving) < MIN_CLIPPED_SAMPLES:
        return clipped
    smallest = MIN_ABRUPT_SHARE * float(np.median(moving))
    for limit in (np.nanmax(y), np.nanmin(y)):
        at_limit = y == limit
        n_abrupt = 0
        for rows in true_intervals(at_limit):
            start = rows.start
            end = rows.stop
            is_inside = start > 0 and end < len(y) and end - start >= MIN_CLIPPED_RUN
            if is_inside and changes[start - 1] > smallest and changes[end - 1] > smallest:
                n_abrupt += end - start
        if n_abrupt >= MIN_CLIPPED_SAMPLES:
            clipped |= at_limit
    outside = changes[~(clipped[1:] | clipped[:-1])]
    if len(outside) == 0 or np.mean(outside == 0) > MAX_EQUAL_SHARE:
        return np.zeros(len(y), dtype=bool)
    return clipped


def input_noise_sd(segments: Sequence[Segment]) -> float:
    """Standard deviation of the input's measurement noise, from its fourth differences.

    Parameters
    ----------
    segments
        Segments of one input.

    Returns
    -------
    float
        In the input's unit. 0 where the input was set and not measured (most samples repeat the
        one before), where the noise is less than 1e-4 of the input's range, and where it would be
        more than a tenth of the input's standard deviation: then the input itself is that fast.

    Notes
    -----
    Less than 2 % of the amplitude of a signal slower than a tenth of the sampling rate is left in
    the fourth differences.

    The limits decide whether the first sample of an input is exact;
    ``tests/identify/test_identify_closed_forms.py`` checks each of them.
    """
    inputs = [s.u for s in segments if len(s.u) > 4]
    if not inputs:
        return 0.0
    changes = np.concatenate([np.diff(u) for u in inputs])
    if np.mean(changes == 0) > MIN_REPEATED_SHARE:
        return 0.0
    differences = np.abs(np.concatenate([np.diff(u, 4) for u in inputs]))
    # a step of the input gives five outliers
    differences = differences[differences <= 4 * MAD_TO_SD * np.median(differences)]
    sd = float(np.sqrt(np.mean(differences**2) / comb(8, 4)))
    values = np.concatenate(inputs)
    is_noise = sd < MAX_INPUT_NOISE_SHARE * np.std(values)
    return sd if is_noise and sd > MIN_INPUT_NOISE_SHARE * np.ptp(values) else 0.0
