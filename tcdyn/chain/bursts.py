"""Detection of bursts, and whitening of the traces of a logger.

A burst is a slip ring that loses contact for a short time. It is detected by its shape (outlier
rejection). Before the filter a burst is a pulse, after it a rounded pulse. Over a second, a
temperature that went through its chain is a cubic, or a slope change or a step that the chain has
rounded. A window that none of these explains and a pulse does, contains a burst. Most channels show
a change of the temperature; where the others show nothing, weaker evidence is enough.

``tcdyn.smoothing`` and ``immersion.plunge_fit`` call ``estimate_and_whiten_noise``. Guarded by
``tests/smoothing/test_noise.py`` and ``tests/smoothing/test_noise_parts.py``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import compress

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.ndimage import maximum_filter1d, uniform_filter1d
from scipy.signal import find_peaks, oaconvolve

from tcdyn.chain.chain import NO_CONDITIONING, Chain
from tcdyn.chain.logger_noise import LoggerNoise, estimate_logger_noise
from tcdyn.chain.rational import Factor, Rational, simulate
from tcdyn.core import Array, Flags
from tcdyn.estimation.trace_noise import SpikeRule, find_spikes, interpolate_gaps
from tcdyn.rig.disk import Conditioning

# Values without a source below were chosen by judgement.
# lengths of the pulses [samples]; a length between two of these is found by either
_LONG_LENGTHS = tuple(round(31 * 1.12**k) for k in range(1, 32))
LENGTHS = (2, 3, 4, 5, 7, 9, 11, 13, 15, 17, 19, 22, 25, 28, 31, *_LONG_LENGTHS)
# longest pulse [s]
LONGEST_S = 0.45
# length of the trace on either side of a pulse that shows the temperature [s]; samples at least
MARGIN_S = 0.4
MIN_MARGIN = 8
# sampling intervals: a chain with at least this lag rounds every change of the temperature
MIN_LAG_INTERVALS = 10.0
# height of a pulse in standard deviations, at least
MIN_HEIGHT_SD = 7.0
# correlation of two pulses from which on one of them stands for the other in the screen
SCREEN_CORRELATION = 0.93
# height of a suspect in the screen: a pulse of ``MIN_HEIGHT_SD`` has at least 0.93 of its height
# there, less four standard deviations of the difference of two such scores, sqrt(1 - 0.93^2)
SCREEN_HEIGHT_SD = SCREEN_CORRELATION * MIN_HEIGHT_SD - 4.0 * (1 - SCREEN_CORRELATION**2) ** 0.5
# deviance by which a pulse must be better than slope changes and steps; that of a weak pulse which
# other channels do not show
MIN_GAIN = 25.0
MIN_GAIN_WEAK = 6.0
# deviance of the window of a weak pulse at most: a jump of the temperature by 10 K has thousands
WEAK_DEVIANCE = 250.0
# number of other channels that must be able to show a change; share of missing samples beyond which
# a channel is not able to
WITNESSES = 2
MAX_MISSING = 0.25
# height in standard deviations by which two other channels show that the temperature changed
WITNESS_HEIGHT_SD = 4.5
# deviance per sample that noise may leave; and the multiple of the remainder by which a pulse must
# be better than slope changes and steps
NOISE_DEVIANCE = 1.5
REMAINDER_FACTOR = 4.0
# standard deviations of the noise that the tail of a pulse may leave in a sample that is used
MAX_TAIL_SD = 0.5
# samples of a window at most: traces of some kilohertz are not searched
MAX_WINDOW = 1500
# relative difference of sampling intervals that count as equal
SAME_RATE = 0.01
# share of samples in bursts beyond which the noise is estimated again, from segments of this length
DENSE_SHARE = 0.012
SHORT_SEGMENT_S = 1.0
# gain of the chain below which a line cannot be a temperature and is called hum
MAX_HUM_GAIN = 0.1
# rounds of the search: pulses that hide each other are found one after the other
ROUNDS = 6
# positions of pulses in a window, and of steps and slope changes; chosen by judgement
PULSE_STARTS = 120
STEP_STARTS = 60
# Factor between the lags of window models: a step of half of it either way changes a rounded step
# by 2 % of its height at most. Digits of a sampling interval: a pulse of a second then ends within
# half a millisecond of where it did.
LAG_STEP = 1.1
INTERVAL_DIGITS = 4
# norm over the largest one, below which a component is a cubic; and largest correlation of two
MIN_NORM = 1e-6
MAX_CORRELATION = 1 - 1e-3


def estimate_and_whiten_noise(
    traces: Sequence[Array],
    dts_s: Sequence[float],
    filter_: Conditioning,
    white_K: Array,
    chains: Sequence[Chain],
    rule: SpikeRule,
) -> tuple[LoggerNoise, list[tuple[Array, Flags]]]:
    """Estimate the noise of the channels of one logger, and whiten all ``traces``.

    Parameters
    ----------
    traces
        Each (N, M) [K], NaN where missing. Those with the sampling interval of the first are used
        for the noise.
    dts_s
        Sampling interval of each trace [s].
    filter_
        The conditioning filter.
    white_K
        Standard deviation (M,) of white noise, estimated from differences [K].
    chains
        Chain of each channel.
    rule
        Rule for spikes.

    Returns
    -------
    noise
        Noise of the channels. Its ``hum_lines`` are those that cannot be a temperature; its
        ``level_K`` contains them, after whitening.
    results
        Whitened trace (N, M) [K] and mask of outliers (N, M) of each trace, as ``whiten_traces``
        returns them.

    Notes
    -----
    Where bursts are so dense that most segments of a spectrum contain one, they look like noise.
    The noise is then estimated again, from short segments and without the detected bursts.

    A line is hum only where every chain with a lag of its own passes less than ``MAX_HUM_GAIN`` of
    it; other lines may be waves of the temperature. ``tests/smoothing/test_noise.py`` fails if
    bursts become noise, or a wave hum.
    """
    same_rate = [abs(dt / dts_s[0] - 1) < SAME_RATE for dt in dts_s]

    def white(noise: LoggerNoise) -> list[tuple[Array, Flags]]:
        """Whitened trace and mask of outliers of each trace, with the noise model ``noise``."""
        return [
            whiten_traces(noise, y, np.isfinite(y), dt, chains, rule)
            for y, dt in zip(traces, dts_s)
        ]

    noise = estimate_logger_noise([*compress(traces, same_rate)], dts_s[0], filter_, white_K)
    results = white(noise)
    if noise.is_coloured and np.mean([outliers.mean() for _, outliers in results]) > DENSE_SHARE:
        without_bursts = [
            np.where(outliers, np.nan, y) for y, (_, outliers) in zip(traces, results)
        ]
        short = estimate_logger_noise(
            [*compress(without_bursts, same_rate)], dts_s[0], filter_, white_K, SHORT_SEGMENT_S
        )
        noise = replace(short, hum_lines=noise.hum_lines)  # short segments cannot tell one
        results = white(noise)
    plain = [
        replace(c, conditioning=NO_CONDITIONING) for c in chains if c.lag_s > c.conditioning.lag_s
    ]
    hum = []
    waves = []
    variance = noise.level_K**2
    for f, amplitude in noise.hum_lines:
        gain = max((abs(c.frequency_response(f)) for c in plain), default=0.0)
        if gain >= MAX_HUM_GAIN:
            continue  # may well be a wave of the temperature
        if noise.is_mains(f):
            hum.append((f, amplitude))
            chain = chains[0]
            ratio = noise.whitened_chain(chain).frequency_response(f) / chain.frequency_response(f)
            variance = variance + 0.5 * (abs(ratio) * amplitude) ** 2
        elif gain > 0:
            largest_K = float(np.max(amplitude))
            waves.append((f, largest_K, largest_K / float(gain)))
    noise = replace(noise, hum_lines=tuple(hum), waves=tuple(waves), level_K=np.sqrt(variance))
    return noise, results


def whiten_traces(
    noise: LoggerNoise,
    y: Array,
    good: Flags,
    dt_s: float,
    chains: Sequence[Chain],
    rule: SpikeRule,
    pulses: bool = True,
) -> tuple[Array, Flags]:
    """Whiten the noise of traces, and mark their outliers.

    Parameters
    ----------
    noise
        Noise of the M channels.
    y
        Traces, (N, M) [K].
    good
        Samples that are used, (N, M).
    dt_s
        Sampling interval [s].
    chains
        Chain of each channel.
    rule
        Rule for spikes.
    pulses
        Whether bursts are searched, besides spikes.

    Returns
    -------
    white
        Whitened traces, (N, M) [K]; samples that are not good, and outliers, are interpolated
        linearly.
    outliers
        ``good`` samples that are outliers, (N, M).

    Notes
    -----
    Bursts are searched where the chain is slow enough to round every change of the temperature: a
    lag above ``MIN_LAG_INTERVALS`` sampling intervals. A channel is isolated where at least
    ``WITNESSES`` others could show a change and fewer than ``WITNESSES`` of them do; there a weaker
    pulse is enough.
    """
    white = noise.whiten(np.where(good, y, np.nan), dt_s)
    outliers = np.zeros(y.shape, dtype=bool)
    for i, sd in enumerate(noise.level_K):
        x = interpolate_gaps(white[:, i], good[:, i])
        outliers[:, i] = find_spikes(np.where(good[:, i], x, np.nan), rule, float(sd))
        white[:, i] = interpolate_gaps(x, ~outliers[:, i])
    lags_s = [c.lag_s - c.conditioning.lag_s for c in chains]
    filters = [c.conditioning if c.conditioning.poles else noise.shaping for c in chains]
    filters_whitened = [
        noise.whitened_chain(Chain((), conditioning=f)).conditioning for f in filters
    ]
    slow = [i for i, lag_s in enumerate(lags_s) if pulses and lag_s > MIN_LAG_INTERVALS * dt_s]
    missing = ~good | outliers
    searches = [
        _PulseSearch.of(white[:, i], dt_s, float(noise.level_K[i]), filters_whitened[i])
        for i in slow
    ]
    searches = _searched_near_suspects(searches)
    heights_list = [_witness_height(search, missing[:, i]) for search, i in zip(searches, slow)]
    heights = np.array(heights_list).reshape(-1, len(y))
    can_show = np.isfinite(heights)
    shows = heights >= WITNESS_HEIGHT_SD
    # numbers of channels
    n_able = can_show.sum(axis=0)
    n_showing = shows.sum(axis=0)
    for k, i in enumerate(slow):
        isolated = (n_able - can_show[k] >= WITNESSES) & (n_showing - shows[k] < WITNESSES)
        outliers[:, i] |= _burst_mask(searches[k], lags_s[i], isolated)
        white[:, i] = interpolate_gaps(white[:, i], ~outliers[:, i])
    return white, outliers & good


def _searched_near_suspects(
    searches: Sequence[_PulseSearch | None],
) -> list[_PulseSearch | None]:
    """The searches, each with its scores near the samples where any of them may find a pulse.

    Parameters
    ----------
    searches
        Searches of the channels of one logger (traces of one length); None where it is not
        possible.

    Notes
    -----
    The other channels are witnesses, so all channels get the exact score at the same samples.
    """
    possible = [search for search in searches if search is not None]
    if not possible:
        return list(searches)
    reach = 2 * max(search.widest for search in possible)
    screened = [_largest_correlation(s.padded, s.shapes[list(s.screen)]) for s in possible]
    suspect = np.any([score > SCREEN_HEIGHT_SD for score in screened], axis=0)
    near = maximum_filter1d(suspect, 2 * reach + 1)
    return [None if search is None else replace(search, near=near) for search in searches]


def _witness_height(search: _PulseSearch | None, missing: Flags) -> Array:
    """Largest height of any pulse near each sample [standard deviations].

    Parameters
    ----------
    search
        Search in the trace; None where it is not possible.
    missing
        Samples that are missing or outliers, (N,).

    Returns
    -------
    Heights, (N,); NaN where the search is not possible or more than ``MAX_MISSING`` of the samples
    nearby are missing.
    """
    if search is None:
        return np.full(len(missing), np.nan)
    near = 2 * search.widest + 1
    height = maximum_filter1d(search.initial_score, near)[search.widest : -search.widest]
    missing_share = uniform_filter1d(missing.astype(float), near)
    able = (height > 0) & (missing_share < MAX_MISSING)
    return np.where(able, height, np.nan)


@dataclass(frozen=True)
class _PulseSearch:
    """Search for pulses in one trace.

    Parameters
    ----------
    padded
        The trace in standard deviations of its noise, padded by ``widest`` on both sides, (N + 2
        widest,).
    dt_s
        Sampling interval, rounded [s].
    filter_
        The filter that rounds the pulses.
    shapes
        The pulses without their nearest cubic, of norm one, (K, odd).
    widest
        Length of the longest pulse with its margins [samples].
    screen
        Indices of the shapes of the screen: each shape resembles one of them.
    near
        Samples of ``padded`` where the score is needed; None: everywhere.

    Notes
    -----
    The score with all shapes takes most of the time of a search, and most of a trace has no pulse.
    Therefore a few shapes screen the trace, and all shapes are used only near what they find.
    """

    padded: Array
    dt_s: float
    filter_: Conditioning
    shapes: Array
    widest: int
    screen: tuple[int, ...]
    near: Flags | None = None

    @classmethod
    def of(
        cls, y: Array, dt_s: float, noise_sd: float, filter_: Conditioning
    ) -> _PulseSearch | None:
        """The search in a trace; None where it is not possible.

        Parameters
        ----------
        y
            Finite trace, (N,) [K].
        dt_s
            Sampling interval [s].
        noise_sd
            Standard deviation of its white noise [K].
        filter_
            The filter that rounds the pulses.

        Notes
        -----
        It is not possible in a trace shorter than two windows, with a window above ``MAX_WINDOW``,
        or without noise.
        """
        dt_s = float(f"{dt_s:.{INTERVAL_DIGITS}g}")
        pulses, shapes, margin_samples = _pulse_shapes(dt_s, filter_)
        widest = max(map(len, pulses)) + 2 * margin_samples
        if len(y) < 2 * widest or widest > MAX_WINDOW or not noise_sd > 0:
            return None
        padded = np.pad(y, widest, mode="reflect", reflect_type="odd") / noise_sd
        screen = _screen_shapes(dt_s, filter_)
        return cls(padded, dt_s, filter_, shapes, widest, screen)

    def score(self, padded: Array) -> Array:
        """Largest height of any pulse over its standard deviation.

        Parameters
        ----------
        padded
            Trace in standard deviations of its noise, (n,).

        Returns
        -------
        Score, (n,), at the middle of the window of the pulse; zeros at the ends, and away from the
        samples ``near``.
        """
        near = np.ones(len(padded), dtype=bool) if self.near is None else self.near
        score = np.zeros(len(padded))
        half = self.shapes.shape[1] // 2
        edges = np.flatnonzero(np.diff(np.concatenate([[False], near, [False]])))
        for first, end in edges.reshape(-1, 2).tolist():
            before = max(first - half, 0)
            exact = _largest_correlation(padded[before : end + half], self.shapes)
            score[first:end] = exact[first - before : end - before]
        return score

    @cached_property
    def initial_score(self) -> Array:
        """The score (N + 2 widest,) of the trace before any burst is removed."""
        return self.score(self.padded)


def _largest_correlation(padded: Array, shapes: Array) -> Array:
    """Largest absolute correlation (N,) of a trace (N,) with any of ``shapes`` (K, odd).

    It stands at the middle of the shape; zeros where a shape does not fit.
    """
    length = shapes.shape[1]
    if len(padded) < length:
        return np.zeros(len(padded))
    correlations = oaconvolve(padded[None], shapes[:, ::-1], mode="valid", axes=1)
    return np.pad(np.abs(correlations, out=correlations).max(axis=0), length // 2)


def _rounded_lag_s(lag_s: float) -> float:
    """The next lag of a grid with steps of ``LAG_STEP`` [s], so that channels share a model.

    >>> round(_rounded_lag_s(0.74), 3), round(_rounded_lag_s(0.76), 3)
    (0.751, 0.751)
    """
    return float(LAG_STEP ** np.round(np.log(lag_s) / np.log(LAG_STEP)))


def _burst_mask(search: _PulseSearch | None, lag_s: float, isolated_mask: Flags) -> Flags:
    """Mark the samples that bursts have changed.

    Parameters
    ----------
    search
        Search in the trace; None where it is not possible.
    lag_s
        Lag of the chain [s].
    isolated_mask
        Where other channels show no change, (N,).

    Returns
    -------
    Mask, (N,).

    Notes
    -----
    Peaks of the score are tested from the highest down, each in three windows that have the peak at
    a half, a quarter and three quarters. Detected bursts are interpolated and the score is computed
    again, up to ``ROUNDS`` times, because pulses hide each other. More rounds cost time only where
    bursts remain.
    """
    if search is None or not (search.initial_score > MIN_HEIGHT_SD).any():
        return np.zeros(len(isolated_mask), dtype=bool)
    padded = search.padded
    widest = search.widest
    score = search.initial_score
    model = _window_model(search.dt_s, search.filter_, _rounded_lag_s(lag_s))
    outliers = np.zeros(len(padded), dtype=bool)
    isolated = np.pad(isolated_mask, widest)
    for _ in range(ROUNDS):
        before = np.count_nonzero(outliers)
        centres, _ = find_peaks(score, height=MIN_HEIGHT_SD, distance=widest)
        highest_first = np.argsort(-score[centres], kind="stable")
        for centre in centres[highest_first]:
            for share in (0.5, 0.25, 0.75):  # a second pulse may lie on either side
                first = int(np.clip(centre - share * widest, 0, len(padded) - widest))
                inside = model.pulses_in(padded[first : first + widest], bool(isolated[centre]))
                if inside.any():
                    outliers[first : first + widest] |= inside
                    break
        if np.count_nonzero(outliers) == before:
            break
        padded = interpolate_gaps(padded, ~outliers)
        score = search.score(padded)
    return outliers[widest:-widest]


@lru_cache(maxsize=8)
def _pulse_shapes(dt_s: float, filter_: Conditioning) -> tuple[tuple[Array, ...], Array, int]:
    """Pulses, their shapes without cubics, and the margin of samples beside each; cached.

    Parameters
    ----------
    dt_s
        Sampling interval [s].
    filter_
        The filter that rounds the pulses.

    Returns
    -------
    pulses
        The K pulses through the filter.
    shapes
        The pulses without their nearest cubic, centred, of norm one, (K, odd).
    margin_samples
        Samples on either side of a pulse.
    """
    margin_samples = max(round(MARGIN_S / dt_s), MIN_MARGIN)
    pulses = tuple(_filtered_pulses(dt_s, filter_))
    length = max(map(len, pulses)) // 2 * 2 + 2 * margin_samples + 1
    shapes = np.zeros((len(pulses), length))
    for shape, pulse in zip(shapes, pulses):
        full = np.pad(pulse, margin_samples)
        cubic, _ = np.linalg.qr(legvander(np.linspace(-1, 1, len(full)), 3))
        residual = full - cubic @ (cubic.T @ full)
        first = length // 2 - len(residual) // 2
        shape[first : first + len(residual)] = residual / np.linalg.norm(residual)
    return pulses, shapes, margin_samples


@lru_cache(maxsize=8)
def _screen_shapes(dt_s: float, filter_: Conditioning) -> tuple[int, ...]:
    """Indices of a few shapes that resemble all others; cached.

    Two shapes resemble each other if their largest correlation at any shift is at least
    ``SCREEN_CORRELATION``. The shapes are chosen in turn: next is the one that resembles most of
    those that remain.
    """
    _, shapes, _ = _pulse_shapes(dt_s, filter_)
    count = len(shapes)
    correlation = np.array(
        [np.abs(oaconvolve(shape[None], shapes[:, ::-1], axes=1)).max(axis=1) for shape in shapes]
    )
    alike = correlation >= SCREEN_CORRELATION
    chosen: list[int] = []
    remaining = np.ones(count, dtype=bool)
    while remaining.any():
        best = int(np.argmax(alike[:, remaining].sum(axis=1)))
        chosen.append(best)
        remaining &= ~alike[best]
    return tuple(chosen)


def _filtered_pulses(dt_s: float, filter_: Conditioning) -> Iterator[Array]:
    """Pulses of every length through the filter until they have decayed; height one before it.

    Parameters
    ----------
    dt_s
        Sampling interval [s].
    filter_
        The filter.

    Yields
    ------
    Pulse, (length + tail,), for each of ``LENGTHS`` up to ``LONGEST_S``; the shortest always.
    """
    filtered = Rational(np.array(filter_.numerator), tuple(Factor(f) for f in filter_.factors))
    tail = int(np.ceil(8 * max((f[1] for f in filter_.factors), default=0.0) / dt_s))
    for length in LENGTHS:
        if length == LENGTHS[0] or length * dt_s <= LONGEST_S:
            pulse = np.zeros(length + tail + 1)
            pulse[1 : length + 1] = 1.0
            if filter_.factors:
                pulse = simulate(filtered, pulse, dt_s, "zoh")
            yield pulse[1:]


@dataclass(frozen=True)
class _WindowModel:
    """Components of a window of n samples besides a cubic, at any position in it.

    The components are pulses, and steps and slope changes that the chain has rounded.

    Parameters
    ----------
    shapes
        The pulses, (n, K), zeros for the other components.
    units
        All components without their cubic, of norm one, (n, K).
    correlation
        Correlations of the components, (K, K).
    norms
        Norms of the components without their cubic, (K,).
    cubic
        Orthonormal basis of the cubics, (n, 4).
    pulses
        Number of pulses, which are the first components.
    """

    shapes: Array
    units: Array
    correlation: Array
    norms: Array
    cubic: Array
    pulses: int

    def pulses_in(self, window: Array, isolated: bool) -> Flags:
        """Mark the samples that pulses have changed.

        Parameters
        ----------
        window
            Trace in standard deviations of its noise, (n,).
        isolated
            Whether other channels show no change; a weak pulse then needs less evidence.

        Returns
        -------
        Mask, (n,); empty where no pulse is better than steps and slope changes.

        Notes
        -----
        The best two components, of which one is a pulse, must explain more than the best two that
        are not pulses, by ``MIN_GAIN`` (``MIN_GAIN_WEAK`` for a weak pulse in an isolated window)
        and by ``REMAINDER_FACTOR`` times the deviance that they leave beyond noise. A smaller gain
        detects weaker bursts and takes more temperature changes for bursts.
        ``tests/smoothing/test_noise.py`` has cases of both kinds.
        """
        projection = self.units.T @ window
        nothing = np.zeros(len(window), dtype=bool)
        square = projection**2
        deviance = float(window @ window - np.sum((self.cubic.T @ window) ** 2))
        margin = MIN_GAIN_WEAK if isolated and deviance < WEAK_DEVIANCE + len(window) else MIN_GAIN
        threshold = (
            self._best_pair(projection, square, slice(self.pulses, len(projection)), self.pulses)[0]
            + margin
        )
        if deviance < max(threshold, MIN_HEIGHT_SD**2):  # no two parts explain more than there is
            return nothing
        batch = max(2**16 // len(projection), 1)  # rows that stay in the processor's cache
        starts = range(0, self.pulses, batch)
        fits = [
            self._best_pair(projection, square, slice(a, min(a + batch, self.pulses)))
            for a in starts
        ]
        explained, i, k = max(fits, key=lambda f: f[0])
        remainder = max(
            deviance - explained - NOISE_DEVIANCE * len(window), 0.0
        )  # the parts are not quite these
        if explained < max(threshold + REMAINDER_FACTOR * remainder, MIN_HEIGHT_SD**2):
            return nothing
        single = float(square[: self.pulses].max())
        if explained < single + MIN_GAIN and single >= threshold:
            # one pulse explains the window as well as two
            i = k = int(np.argmax(square[: self.pulses]))
        chosen = list({i, k})
        heights = np.linalg.lstsq(self.units[:, chosen], window)[0] / self.norms[chosen]
        return np.asarray((np.abs(self.shapes[:, chosen] * heights) > MAX_TAIL_SD).any(axis=1))

    def _best_pair(
        self, projection: Array, square: Array, rows: slice, first: int = 0
    ) -> tuple[float, int, int]:
        """The pair of components that explains most of a window.

        Parameters
        ----------
        projection
            Projections of the window on the components, (K,).
        square
            Their squares, (K,).
        rows
            Components from which the first of the pair is taken.
        first
            The second of the pair is taken from this component on.

        Returns
        -------
        explained
            Deviance that the pair explains.
        i, k
            Indices of the pair; equal where one component is best.

        Notes
        -----
        (a^2 + b^2 - 2 r a b) / (1 - r^2), with a and b the projections and r the correlation of the
        components; a^2 for one component. ``tests/smoothing/test_noise_parts.py`` compares with a
        regression on both.
        """
        share, cross = self.weights
        explained = np.multiply(cross[rows, first:], projection[first:])
        explained *= projection[rows, None]
        squares = np.add(square[rows, None], square[first:])
        squares *= share[rows, first:]
        explained += squares
        i, k = divmod(int(np.argmax(explained)), explained.shape[1])
        return float(explained[i, k]), rows.start + i, first + k

    @cached_property
    def weights(self) -> tuple[Array, Array]:
        """Factors of the squares and of the products of projections in ``_best_pair``.

        Returns
        -------
        share
            1 / (1 - r^2), (K, K); 0.5 on the diagonal, so that a component with itself is counted
            once.
        cross
            -2 r / (1 - r^2), (K, K); zero on the diagonal.
        """
        share: Array = 1 / (1 - self.correlation**2)
        cross = -2 * self.correlation * share
        np.fill_diagonal(share, 0.5)
        np.fill_diagonal(cross, 0.0)
        return share, cross


@lru_cache(maxsize=4)
def _window_model(dt_s: float, filter_: Conditioning, lag_s: float) -> _WindowModel:
    """The ``_window_of`` of the pulses of a filter; cached."""
    pulses, _, margin_samples = _pulse_shapes(dt_s, filter_)
    size = max(map(len, pulses)) + 2 * margin_samples
    return _window_of(pulses, size, margin_samples, dt_s, lag_s)


def _window_of(
    pulses: Sequence[Array], size: int, margin_samples: int, dt_s: float, lag_s: float
) -> _WindowModel:
    """All components of a window.

    Parameters
    ----------
    pulses
        Pulses through the filter.
    size
        Samples n of the window.
    margin_samples
        Samples on either side of a pulse; a quarter of them must remain in the window.
    dt_s
        Sampling interval [s].
    lag_s
        Lag that rounds steps and slope changes [s].

    Returns
    -------
    The components, described at ``_WindowModel``.

    Notes
    -----
    More positions (``PULSE_STARTS``, ``STEP_STARTS``) cost memory and time with their square.
    Components that are nearly cubics are left out. Correlations are limited, so that the
    denominator in ``_WindowModel.weights`` is not zero.
    """
    margin = margin_samples // 4
    step_samples = max(size // PULSE_STARTS, 1)
    positions = [
        (pulse, start)
        for pulse in pulses
        for start in range(margin, size - len(pulse) - margin + 1, step_samples)
    ]
    shapes = np.zeros((size, len(positions)))
    for column, (pulse, start) in zip(shapes.T, positions):
        column[start : start + len(pulse)] = pulse
    age = (
        np.maximum(np.arange(size)[:, None] - np.arange(0, size, max(size // STEP_STARTS, 2)), 0)
        * dt_s
    )
    step = 1 - np.exp(-age / lag_s)
    full = np.column_stack([shapes, step, age - lag_s * step])
    cubic, _ = np.linalg.qr(legvander(np.linspace(-1, 1, size), 3))
    residual = full - cubic @ (cubic.T @ full)
    norms = np.linalg.norm(residual, axis=0)
    stored = norms > MIN_NORM * norms.max()
    units = residual[:, stored] / norms[stored]
    correlation = np.clip(units.T @ units, -MAX_CORRELATION, MAX_CORRELATION)
    pulse_columns = np.column_stack([shapes, np.zeros((size, full.shape[1] - len(positions)))])
    n_pulses = int(np.count_nonzero(stored[: len(positions)]))
    return _WindowModel(
        pulse_columns[:, stored], units, correlation, norms[stored], cubic, n_pulses
    )
