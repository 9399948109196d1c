"""Noise of a trace with slow signals and outliers; spike detection; plausible values.

Readers of logs (``tcdyn.rig``), ``tcdyn.smoothing``, ``immersion`` and ``tcdyn.chain`` use it. All
limits for spikes are in ``SPIKES``. Guarded by ``tests/estimation/test_trace_noise.py``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import comb, prod
from typing import Literal

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import median_filter

from tcdyn.core import Array, Flags

# standard deviation of a normal distribution over its median absolute deviation
MAD_TO_SD = 1.482602218505602
# share of a channel that may be missing; chosen by judgement
MAX_MISSING_FRACTION = 0.05
# fewest samples from which the noise is estimated: it is then known to a fifth, 1/sqrt(2 x 15)
MIN_NOISE_SAMPLES = 15
# share of repeats in short runs beyond which the step of the logger hides the noise; chosen by
# judgement
COARSE_REPEATS = 0.5
# records in one of which a run of repeats is long by chance, and samples beyond it; shares of
# repeats within which that chance is computed; share of the runs from which they follow; all chosen
# by judgement
RECORDS_PER_LONG_RUN = 1000.0
RUN_MARGIN = 8
REPEAT_RANGE = (0.05, 0.98)
USUAL_RUNS = 0.99
# noise of a trace from which it cannot be estimated, in the unit of the trace; above zero, so that
# numbers can be divided by it; chosen by judgement
UNKNOWN_NOISE = 1e-6
# steps of a logger in the median second difference of readings whose noise is less than a step:
# rounding itself makes none or one. Chosen by judgement
COARSE_STEPS = 1.5
# share of samples with a fourth difference below which missing samples are skipped; chosen by
# judgement
MIN_DIFFERENCES_SHARE = 0.05
# share of the limit of a spike within which a sample lies on a line, and samples of that line; of
# triangle waves with spikes, these leave the fewest errors of both kinds
KINK_SHARE = 0.7
LINE_SAMPLES = 3
# share of samples that differ from the one before, where the noise is about one step of the logger;
# chosen by judgement
MAX_CHANGING_SHARE = 0.7


@dataclass(frozen=True)
class SpikeRule:
    """Rule for a spike.

    A sample is a spike if it lies more than ``sigmas`` standard deviations of the noise, and more
    than ``floor``, from the median of its neighbours.

    Parameters
    ----------
    sigmas
        Limit in standard deviations of the noise.
    width
        Number of samples of the median around the sample (odd), of which less than half may be
        spikes.
    floor
        Smallest limit, in the unit of the trace.
    local
        If positive, the typical distance from that median over so many samples replaces the noise
        where it is larger.
    """

    sigmas: float
    width: int
    floor: float = 0.0
    local: int = 0

    @property
    def longest(self) -> int:
        """Number of consecutive samples that may be a spike."""
        return self.width // 2

    def for_lag(self, lag_samples: float) -> SpikeRule:
        """The rule for readings of a chain with a lag.

        What passes the chain lasts for about half its lag or longer.

        Parameters
        ----------
        lag_samples
            Lag of the chain [samples].

        Notes
        -----
        A width of about half the lag, at least 3 and at most that of this rule.

        Examples
        --------
        >>> [SPIKES["compensator"].for_lag(lag).width for lag in (0.0, 5.0, 50.0)]
        [3, 3, 9]
        """
        return replace(self, width=int(np.clip(2 * int(lag_samples / 4) + 1, 3, self.width)))


# What a rule of ``SPIKES`` is for.
SpikeUse = Literal["reading", "traces", "plunge", "force", "compensator"]

# all limits for spikes (outlier rejection), by their use; widths for the usual 75 Hz
SPIKES: Mapping[SpikeUse, SpikeRule] = {
    # any temperature column of a log: one clean sample in 1e15 lies so far
    "reading": SpikeRule(8.0, 7, floor=0.5),
    # traces of a disk after the static lines: 0.15 s, longer than a spike of a slip ring
    "traces": SpikeRule(6.0, 11),
    # readings of a plunge before they are averaged
    "plunge": SpikeRule(7.8, 5),
    # load and friction: 2 s around the sample (at other rates, too), relative to their scatter
    "force": SpikeRule(6.0, 151),
    # traces of any origin, in a compensator
    "compensator": SpikeRule(6.0, 9, local=73),
}


def white_noise_sd(values: ArrayLike, order: int = 2, *, centred: bool = True) -> Array:
    """Standard deviation of the white noise of a trace, from its differences and their median.

    Parameters
    ----------
    values
        (N,) or (N, M), any unit, NaN where missing.
    order
        Order k >= 1 of the differences. A higher order suppresses a faster signal and the drift of
        a logger; a lower one loses fewer neighbours of a missing sample.
    centred
        False where the mean of the differences is zero; ``median d`` is then left out.

    Returns
    -------
    Array
        One number, or one for each of M columns, in the unit of ``values``.

    Notes
    -----
    sd = 1.4826 median |d - median d| / sqrt(C(2k, k)), d the differences of order k, whose variance
    is C(2k, k) times that of white noise; not less than the rounding of a logger whose step is
    coarser than the noise.

    Examples
    --------
    >>> noise = np.random.default_rng(0).normal(0.0, 0.2, 4000)
    >>> ramp = 0.01 * np.arange(4000)
    >>> [round(float(white_noise_sd(ramp + noise, k)), 2) for k in (1, 2, 3, 4)]
    [0.2, 0.2, 0.2, 0.2]
    """
    x = np.asarray(values, dtype=float)
    result = []
    for column in np.ascontiguousarray(x.reshape(len(x), -1).T):
        d = np.diff(column, n=order)
        if centred:
            d = d - fast_nanmedian(d)
        deviation = fast_nanmedian(np.abs(d))
        sd = MAD_TO_SD * deviation / np.sqrt(comb(2 * order, order))
        result.append(np.maximum(sd, rounding_sd(column)))
    return np.array(result).reshape(x.shape[1:])


def fast_nanmedian(values: NDArray[np.floating]) -> Array:
    """``np.nanmedian(values, axis=-1)`` for long traces, in a tenth of its time.

    Parameters
    ----------
    values
        Values, (..., N), NaN where missing.

    Returns
    -------
    Medians, (...,); NaN where there are no values.

    Notes
    -----
    numpy partitions by one index much faster than by the two that its own median uses.
    ``tests/estimation/test_trace_noise.py`` compares with ``np.nanmedian``.

    Examples
    --------
    >>> fast_nanmedian(np.array([[3.0, 1.0, np.nan, 2.0], [4.0, 1.0, 2.0, 3.0]]))
    array([2. , 2.5])
    """
    rows = np.ascontiguousarray(values).reshape(prod(values.shape[:-1]), values.shape[-1])
    counts = np.count_nonzero(~np.isnan(rows), axis=-1)
    out = np.full(len(rows), np.nan)
    for count in np.unique(counts[counts > 0]).tolist():
        same_count = counts == count
        k = count // 2
        partitioned = np.partition(rows[same_count], k, axis=-1)  # what is missing comes last
        upper = partitioned[:, k]
        out[same_count] = upper if count % 2 else 0.5 * (partitioned[:, :k].max(axis=-1) + upper)
    return out.reshape(values.shape[:-1])


def trace_noise_sd(y: Array) -> float:
    """Standard deviation [same unit] of white noise on a smooth trace ``y`` (N,), NaN for missing.

    sd = 1.4826 median |fourth difference| / sqrt(70); a signal slower than a tenth of the sampling
    rate leaves less than 2 % of its amplitude. A trace that rests on one step of its logger gets a
    quarter of that step.

    Notes
    -----
    Samples between missing ones are taken as neighbours where hardly any five follow each other. A
    trace with fewer than 8 finite differences gets ``UNKNOWN_NOISE``.
    """
    y = np.asarray(y, dtype=float)
    if np.count_nonzero(np.isfinite(np.diff(y, n=4))) < MIN_DIFFERENCES_SHARE * len(y):
        y = y[np.isfinite(y)]
    if np.count_nonzero(np.isfinite(np.diff(y, n=4))) < 8:
        return UNKNOWN_NOISE
    sd = float(white_noise_sd(y, 4, centred=False))
    if sd > 0:
        return sd
    steps = np.abs(np.diff(y[np.isfinite(y)]))
    steps = steps[steps > 0]
    return float(np.min(steps)) / 4 if len(steps) else UNKNOWN_NOISE


def rounding_sd(x: Array) -> float:
    """Rounding error of a trace whose neighbours are often equal; else zero.

    The step of its logger over sqrt(12). Differences that take few values have a median that
    carries no information; it is zero where most of them are zero.

    Parameters
    ----------
    x
        Trace, (N,), NaN where missing.

    Notes
    -----
    The step is the median of the differences that are not zero. Above ``MAX_CHANGING_SHARE`` of
    changing samples the noise hides the step, and the median of the differences is used as it is.

    Examples
    --------
    >>> round(float(rounding_sd(np.array([20.0, 20.0, 20.5, 20.5, 20.5, 20.0, 20.0]))), 3)
    0.144
    """
    differences = np.abs(np.diff(x))
    differences = differences[np.isfinite(differences)]
    changes = differences[differences > 1e-9 * max(float(np.max(differences, initial=0.0)), 1e-300)]
    if not len(changes) or len(changes) > MAX_CHANGING_SHARE * len(differences):
        return 0.0
    return float(np.median(changes) / np.sqrt(12))


def find_spikes(values: Array, rule: SpikeRule, noise_sd: float | None = None) -> Flags:
    """Outlier rejection: samples of ``values`` (N,) that are spikes by ``rule``.

    A ramp, a clean step or a sudden change of slope is no spike. NaN is never a spike.

    Parameters
    ----------
    values
        Trace (N,).
    rule
        The rule.
    noise_sd
        Standard deviation of the noise. Without it, the typical distance from the median over the
        full trace is used.

    Returns
    -------
    Mask of the spikes, (N,).

    Notes
    -----
    Where few samples are near a jump, medians are computed for those only; the result is the same
    (``tests/estimation/test_trace_noise.py``). The rules in ``SPIKES`` may be changed; the tests
    check how long a spike each detects.

    Examples
    --------
    >>> trace = np.array([20.0, 20.1, 20.2, 25.0, 20.4, 20.5, 20.6])
    >>> find_spikes(trace, SPIKES["reading"], 0.1).nonzero()[0]
    array([3])
    """
    index = np.flatnonzero(np.isfinite(values))
    out = np.zeros(len(values), dtype=bool)
    x = values[index]
    if len(x) < 2:
        return out
    limit = max(rule.sigmas * (noise_sd or 0.0), rule.floor)
    # samples near a jump: the majority of a window that is far off is at most so many samples away
    near_jump = np.zeros(len(x), dtype=bool)
    reach = min((rule.longest + 1) // 2, len(x) - 1) if noise_sd is not None else 0
    for k in range(1, reach + 1):
        jumps = np.abs(x[k:] - x[:-k]) > limit
        near_jump[k:] |= jumps
        near_jump[:-k] |= jumps
    sparse = noise_sd is not None and np.count_nonzero(near_jump) * rule.width < len(x)
    distance = np.zeros(len(x))
    if not sparse:
        distance = np.abs(x - median_filter(x, rule.width, mode="nearest"))
    windows = sliding_window_view(np.pad(x, rule.longest, mode="edge"), rule.width)

    def beyond_limit(samples: NDArray[np.intp]) -> NDArray[np.intp]:
        """Those of ``samples`` (indices) that are beyond the limit from the median around them."""
        if sparse:
            distance[samples] = np.abs(x[samples] - fast_nanmedian(windows[samples]))
        return samples[distance[samples] > limit]

    far = beyond_limit(np.flatnonzero(near_jump) if sparse else np.arange(len(x)))
    typical = np.zeros(1)
    if rule.local:
        half_window = rule.local // 2
        if sparse:
            nearby = far[:, None] + np.arange(-half_window, half_window + 1)
            beyond_limit(np.unique(np.clip(nearby, 0, len(x) - 1)))
        local_windows = sliding_window_view(np.pad(distance, half_window, mode="edge"), rule.local)
        typical = fast_nanmedian(local_windows[far])
    elif noise_sd is None:
        typical = fast_nanmedian(distance[None])
    spikes = far[distance[far] > rule.sigmas * MAD_TO_SD * typical]
    if noise_sd is not None:
        spikes = spikes[~_on_line_of_one_side(x, spikes, KINK_SHARE * limit)]
    out[index[spikes]] = True
    return out


def _on_line_of_one_side(x: Array, suspects: NDArray[np.intp], tolerance: float) -> Flags:
    """Suspected spikes that continue the line of the three good samples before or after them.

    Such a sample belongs to a sudden change of the slope, as of a lagged reading after a step.

    Parameters
    ----------
    x
        Trace, (N,), without missing samples.
    suspects
        Indices of the samples, (K,), increasing.
    tolerance
        Largest distance from the line, in the unit of the trace.

    Returns
    -------
    Mask of the suspects, (K,).
    """
    out = np.zeros(len(suspects), dtype=bool)
    if not len(suspects):
        return out
    is_good = np.ones(len(x), dtype=bool)
    is_good[suspects] = False
    others = np.flatnonzero(is_good)
    before = np.searchsorted(others, suspects)
    for first in (before - LINE_SAMPLES, before):
        exists = (first >= 0) & (first + LINE_SAMPLES <= len(others))
        samples = others[first[exists][:, None] + np.arange(LINE_SAMPLES)]
        levels = x[samples]
        slope = (levels[:, -1] - levels[:, 0]) / (samples[:, -1] - samples[:, 0])
        steps = suspects[exists] - samples.mean(axis=1)
        line = levels.mean(axis=1) + slope * steps
        out[exists] |= np.abs(x[suspects[exists]] - line) < tolerance
    return out


def interpolate_gaps(y: Array, good: Flags) -> Array:
    """Linear interpolation across the samples that are not good.

    Parameters
    ----------
    y
        Trace, (N,).
    good
        Samples that stay, (N,); at least one.

    Returns
    -------
    Trace, (N,); beyond the first and last good sample it is constant. ``y`` itself if all are good.
    """
    bad_index = np.flatnonzero(~good)
    good_index = np.flatnonzero(good)
    if not len(bad_index):
        return y
    out = np.array(y, dtype=float)
    out[bad_index] = np.interp(bad_index, good_index, out[good_index])
    return out


def long_runs(trace: Array) -> Flags:
    """Mark the samples in runs of one value that are longer than chance allows.

    Parameters
    ----------
    trace
        Trace, (N,).

    Returns
    -------
    Mask, (N,).

    Notes
    -----
    A run is long if p^length N < 1/``RECORDS_PER_LONG_RUN``, with p the share of repeats elsewhere,
    and by more than ``RUN_MARGIN`` samples. Where the step of the logger is coarser than the noise,
    a long run is a constant temperature: no run is called long. That is so where most neighbours
    are equal (``COARSE_REPEATS``), and where changing readings scatter by hardly more than a step.
    A constant trace is one long run.
    """
    n = len(trace)
    change = np.flatnonzero(np.diff(trace)) + 1
    if len(change) == 0:
        return np.ones(n, dtype=bool)
    lengths = np.diff(np.concatenate([[0], change, [n]]))
    usual = lengths <= np.quantile(lengths, USUAL_RUNS)
    repeats = float(np.sum(lengths[usual] - 1)) / max(float(np.sum(lengths[usual])), 1.0)
    if repeats > COARSE_REPEATS or _is_rounded_beyond_noise(trace):
        return np.zeros(n, dtype=bool)
    share = np.clip(repeats, *REPEAT_RANGE)
    longest = RUN_MARGIN + np.log(RECORDS_PER_LONG_RUN * n) / -np.log(share)
    return np.repeat(lengths > longest, lengths)


def _is_rounded_beyond_noise(trace: Array) -> bool:
    """Whether second differences of changing readings (N,) are mostly one step of the logger.

    False where hardly any three neighbours differ.
    """
    change = np.diff(trace)
    size = np.abs(change)
    is_change = size > 1e-9 * max(float(np.max(size)), 1e-300)
    second = np.abs(np.diff(change))[is_change[1:] & is_change[:-1]]
    if len(second) < MIN_NOISE_SAMPLES:
        return False
    step = float(np.min(size[is_change]))
    return float(np.median(second)) < COARSE_STEPS * step
