"""Noise as loggers make it: white before the conditioning filter and white after it, told apart and made white.

reading = B (C T + w) + v: slip rings and wires sit before the filter B, so most of their noise w is coloured by it; the
converter's v is not. With B = 1/A the spectrum of both is |N|^2 |B|^2, |N|^2 = a + b |A|^2: A/N makes the noise white,
and a chain C B followed by it is C/N. Nothing else of a fit or a smoother has to know.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.polynomial.polynomial import polyval
from scipy.fft import rfft, rfftfreq
from scipy.ndimage import label, median_filter
from scipy.optimize import nnls

from tcdyn.chain.chain import NO_CONDITIONING, Chain
from tcdyn.chain.rational import Factor, Rational, product, simulate, spectral_factor
from tcdyn.core import Array, Flags
from tcdyn.core.findings import Finding, info, warning
from tcdyn.estimation.trace_noise import bridged, middle
from tcdyn.rig.disk import Conditioning

SEGMENT_S = 8.0  # of a trace, whose spectra are put together by their median: events and bursts touch few of them
# samples; segments
LEAST_SEGMENT = 64
LEAST_SEGMENTS = 3
# share of a segment without samples; of white noise's power: else not told
MOST_BRIDGED = 0.3
LEAST_SEEN = 0.1
# the part of a spectrum that counts: above what a segment detrends, below aliases
SLOW_HZ = 0.3
NYQUISTS = 0.9
AVERAGED = (
    0.33  # independent spectra for each segment: medians cost half, tapers correlate neighbours
)
SURE = 40.0  # deviance by which noise from before the filter must explain the spectra better
KNOWN = 10.0  # deviance by which another lag must beat the filter that is there
MATERIAL = 0.1  # least part of it in that after the filter, at low frequency, that matters
QUICKEST = (
    5.0  # poles of 1/N over the sampling rate, at most [1/s per Hz]: quicker ones no sample shows
)
LAGS = 10  # tried, from a corner of 1 Hz to three tenths of the rate
# waves about one; standard deviations that make it a line; waves
BESIDE = 21
OUTSTANDING = 8.0
LEAST_WAVES = 10
# largest part of hum in a harmonic; width of a line
HARMONIC = 0.5
RESTING_HZ = 0.5
# of the spectrum; mean over one, of what was seen over what is expected
BANDS = 8
UNEXPLAINED = 1.6
CHANCE = 5.0  # standard deviations by which such a mean must stand out
SETTLED = 1e-9  # relative change of a level after which another round changes nothing
TYPICAL_LAG_S = (
    0.7  # of what lies before the filter: shapes what slow temperatures add to a spectrum
)


@dataclass(frozen=True)
class Whitened(Conditioning):
    """What stands in place of the filter B once a trace went through A/N: 1/N, or A/N where B was not in the chain.

    ``sections``: factors of the denominator; ``numerator``: ascending in s. Its lag stays that of B, as people know it.
    """

    sections: tuple[tuple[float, ...], ...] = ()
    numerator: tuple[float, ...] = (1.0,)

    @cached_property
    def factors(self) -> tuple[tuple[float, ...], ...]:
        """Factors of the denominator, ascending coefficients in s."""
        return self.sections

    @cached_property
    def lag_s(self) -> float:
        """First moment of the filter whose noise was made white [s]."""
        return Conditioning(self.cutoff_Hz, self.poles, self.shape).lag_s


@dataclass(frozen=True)
class LoggerNoise:
    """Noise of M channels of one logger.

    ``before_K`` (M,): standard deviation, behind the filter, of the white noise before it; ``after_K`` (M,): of that
    after it; ``level_K`` (M,): of the white noise that is as strong at low frequency; ``shaping``: the filter;
    ``sections``: the factors of N, none where all of it is white; ``lines``: frequency [Hz] and amplitudes (M,) [K] of
    hum; ``rate_Hz`` of sampling; ``unexplained``: the largest mean over a band of what was seen over what is expected.
    """

    before_K: Array
    after_K: Array
    level_K: Array
    shaping: Conditioning
    sections: tuple[tuple[float, ...], ...] = ()
    lines: tuple[tuple[float, Array], ...] = ()
    rate_Hz: float = np.nan
    unexplained: float = 1.0

    @property
    def coloured(self) -> bool:
        """Whether traces have to be made white."""
        return bool(self.sections)

    def to_dict(self) -> dict[str, float]:
        """Standard deviations of a usual channel [K], each as it stands in the log."""
        before, after = (float(np.median(x)) for x in (self.before_K, self.after_K))
        return {"before_filter_K": before, "after_filter_K": after}

    def findings(self, subject: str) -> list[Finding]:
        """Noise from before the filter, hum, and what no part of the model explains."""
        out = []
        (before, after) = self.to_dict().values()
        if self.coloured:
            lag_s = self.shaping.lag_s if self.shaping.poles == 1 else 0.0
            out.append(
                info("noise.coloured", subject=subject, before_K=before, after_K=after, lag_s=lag_s)
            )
        for f, amplitude in self.lines:
            out.append(
                info("noise.hum", subject=subject, f_Hz=f, amplitude_K=float(np.max(amplitude)))
            )
        if (folded := float(np.max(self.folded_u_K))) > 0:
            out.append(warning("noise.folded", subject=subject, folded_K=folded))
        if self.unexplained > UNEXPLAINED:
            out.append(warning("noise.unexplained", subject=subject, ratio=self.unexplained))
        return out

    @property
    def folded_u_K(self) -> Array:
        """Standard uncertainty (M,) [K] for harmonics of mains hum that the sampling lays upon the temperature itself.

        Of a line at the mains' own frequency, as sampled, those harmonics up to the fifth that come to rest within
        half a hertz are held to be at most half as strong; no data can tell them from a temperature.
        """
        u: Array = np.zeros(len(self.level_K))
        for f, amplitude in self.lines:
            for mains in _mains(f, self.rate_Hz):
                if any(_folded(k * mains, self.rate_Hz) < RESTING_HZ for k in range(2, 6)):
                    u = np.hypot(u, HARMONIC * amplitude / np.sqrt(2))
        return u

    def white(self, sd_K: Array) -> LoggerNoise:
        """White noise of ``sd_K`` (M,) on the same channels."""
        return LoggerNoise(np.zeros(len(sd_K)), sd_K, sd_K, self.shaping, rate_Hz=self.rate_Hz)

    def for_more(self, own: Flags, white_K: Array) -> LoggerNoise:
        """The same for more channels (M,), of which ``own`` told it; the others have ``white_K`` (M,) made white."""

        def spread(values: Array, others: Array) -> Array:
            out = np.array(others, dtype=float)
            out[own] = values
            return out

        none = np.zeros(len(own))
        return replace(
            self,
            before_K=spread(self.before_K, none),
            after_K=spread(self.after_K, white_K),
            level_K=spread(self.level_K, white_K),
            lines=tuple((f, spread(a, none)) for f, a in self.lines),
        )

    def whitened(self, y: Array, dt_s: float) -> Array:
        """The readings ``y`` (N, M) through A/N, NaN where they were; the first sample stood for ever before."""
        if not self.coloured:
            return y
        absent = ~np.isfinite(y)
        filter_ = Rational(product(self.shaping.factors), tuple(Factor(f) for f in self.sections))
        out = np.stack(
            [simulate(filter_, bridged(x, ~gone), dt_s) for x, gone in zip(y.T, absent.T)], axis=1
        )
        return np.where(absent, np.nan, out)

    def behind(self, chain: Chain) -> Chain:
        """The chain of a trace that was made white."""
        if not self.coloured:
            return chain
        b = chain.conditioning
        stages = self.sections
        left: tuple[float, ...] = (1.0,)  # the filter cancels
        if b != self.shaping:
            stages = (*b.factors, *stages)
            left = tuple(map(float, product(self.shaping.factors)))
        return replace(chain, conditioning=Whitened(b.cutoff_Hz, b.poles, b.shape, stages, left))


def noise_of(
    traces: Sequence[Array],
    dt_s: float,
    filter_: Conditioning,
    white_K: Array,
    segment_s: float = SEGMENT_S,
) -> LoggerNoise:
    """The noise of one logger's channels, from ``traces``, each (N, M) [K], every ``dt_s``, NaN where missing.

    S = a |B|^2 + b + c |B|^2/(w^4 (1 + (w lag)^2)) is fitted to the median of the spectra of segments, each of
    ``segment_s``, by Whittle's likelihood, each channel with its own levels; the last term is what temperatures do. In
    place of the filter a lag of any length is tried, an autoregression in effect, and taken where it is clearly better.
    Where neither beats white noise for sure, the noise is white, of ``white_K`` (M,) as differences tell it. Waves that
    stand out are lines (hum), and left out of all that.
    """
    white = LoggerNoise(np.zeros(len(white_K)), white_K, white_K, filter_, rate_Hz=1 / dt_s)
    if not (found := _spectra(traces, dt_s, segment_s)):
        return white
    f, power, count = found
    own = (
        power.mean(axis=0) > LEAST_SEEN * white_K**2
    )  # the others mostly rest on one value, or are not there
    if not own.any():
        return white
    if not own.all():
        return noise_of(
            [y[:, own] for y in traces], dt_s, filter_, white_K[own], segment_s
        ).for_more(own, white_K)
    w = 2 * np.pi * f
    signal_ = _passed(f, filter_) / (w**4 * (1 + (w * TYPICAL_LAG_S) ** 2))
    flat = np.ones(len(f))
    calm = [_calm(p, np.stack([flat, signal_], axis=1), count) for p in power.T]
    quiet = (
        np.mean(calm, axis=0) >= 0.5
    )  # hum is in all channels; one that is odd speaks for none but itself
    lines = _lines(f, power, ~quiet)
    if np.count_nonzero(quiet) < LEAST_WAVES:
        return replace(white, lines=lines)
    known = [filter_] if filter_.poles else []
    lags = [Conditioning(float(c), 1) for c in np.geomspace(1.0, 0.3 / dt_s, LAGS)]
    shapes = {c: np.stack([_passed(f, c), flat, signal_], axis=1)[quiet] for c in (*known, *lags)}
    shapes[NO_CONDITIONING] = np.stack([flat, signal_], axis=1)[quiet]
    fits = {c: [_levels(p, shape) for p in power[quiet].T] for c, shape in shapes.items()}
    alone = np.array([value for _, value in fits[NO_CONDITIONING]])
    gain = {c: np.median(alone - [value for _, value in fit]) for c, fit in fits.items()}
    cost = {c: -2 * AVERAGED * count * len(alone) * float(value) for c, value in gain.items()}
    best = min(lags, key=cost.__getitem__)
    if known and cost[filter_] < cost[best] + KNOWN:
        best = filter_
    levels = np.array([v for v, _ in fits[best]])
    before = levels[:, 0]
    after = levels[:, 1]
    ratio = float(np.median(before / np.maximum(before + after, 1e-300)))
    coloured = cost[NO_CONDITIONING] - cost[best] >= SURE and ratio >= MATERIAL
    taken = best if coloured else NO_CONDITIONING
    seen = power[quiet] / np.stack([shapes[taken] @ v for v, _ in fits[taken]], axis=1)
    bands = [float(band.mean()) for band in np.array_split(seen, BANDS) if len(band)]
    chance = 1 + CHANCE / float(np.sqrt(AVERAGED * count * seen.size / BANDS))
    worst = max(bands) if max(bands) > chance else 1.0
    wider = max(bands[0], 1.0) ** 0.5 if worst > UNEXPLAINED else 1.0
    if not coloured:  # differences would count the lines in
        level = wider * (np.sqrt([v[0] for v, _ in fits[NO_CONDITIONING]]) if lines else white_K)
        return replace(white.white(level), lines=lines, unexplained=worst)
    level = wider * np.sqrt(before + after)
    share = passed_share(best, dt_s)
    sections = spectral_factor(ratio, 1 - ratio, product(best.factors), QUICKEST / dt_s)
    return LoggerNoise(
        np.sqrt(before * share), np.sqrt(after), level, best, sections, lines, 1 / dt_s, worst
    )


def _folded(f: float, rate_Hz: float) -> float:
    """Where a wave of ``f`` [Hz] is seen by samples of ``rate_Hz``."""
    return abs(f - rate_Hz * round(f / rate_Hz))


def _mains(f: float, rate_Hz: float) -> list[float]:
    """The mains frequencies [Hz] that are seen at ``f``."""
    return [mains for mains in (50.0, 60.0) if abs(_folded(mains, rate_Hz) - f) < RESTING_HZ]


def passed_share(filter_: Conditioning, dt_s: float) -> float:
    """Share of its variance that the filter leaves to white noise sampled every ``dt_s``.

    Divided by it, the variance of noise from before the filter is that of white noise as strong at low frequency.

    >>> round(passed_share(Conditioning(4.0, 2), 1 / 75), 3)
    0.085
    """
    return float(np.mean(_passed(np.linspace(0.0, 0.5 / dt_s, 400), filter_)))


def _passed(f: Array, filter_: Conditioning) -> Array:
    """|B|^2 at frequencies ``f`` [Hz]."""
    return np.asarray(1.0 / np.abs(polyval(2j * np.pi * f, product(filter_.factors))) ** 2)


def _calm(power: Array, shapes: Array, count: int) -> Flags:
    """Waves (F,) that do not stand out of their neighbours."""
    expected = shapes @ _levels(power, shapes)[0]
    expected *= median_filter(power / expected, BESIDE, mode="nearest")
    return np.asarray(power < expected * (1 + OUTSTANDING / np.sqrt(AVERAGED * count)))


def _lines(f: Array, power: Array, standing: Flags) -> tuple[tuple[float, Array], ...]:
    """Frequency [Hz] and amplitude (M,) [K] of each group of neighbouring waves that stand out."""
    groups, number = label(standing)
    out = []
    for k in range(1, number + 1):
        rows = np.flatnonzero(groups == k)
        total = power[rows].sum(axis=0)
        centre = float((f[rows] * power[rows].mean(axis=1)).sum() / power[rows].mean(axis=1).sum())
        out.append((centre, np.sqrt(2 * 2 * total / (1.5 * 2 * len(f)))))
    return tuple(out)


def _spectra(
    traces: Sequence[Array], dt_s: float, segment_s: float
) -> tuple[Array, Array, int] | None:
    """Frequencies (F,) [Hz], variance of a sample (F, M) that each stands for [K2], and segments that tell it."""
    long = [y for y in traces if len(y) >= LEAST_SEGMENT * LEAST_SEGMENTS]
    if not long:
        return None
    size = max(min(round(segment_s / dt_s), min(map(len, long)) // LEAST_SEGMENTS), LEAST_SEGMENT)
    f = rfftfreq(size, dt_s)
    taper = np.hanning(size + 1)[:-1]
    pieces = list[Array]()
    taper = taper / np.linalg.norm(taper)
    line = np.linalg.qr(np.vander(np.linspace(-1, 1, size), 2))[0]
    for y in long:
        absent = ~np.isfinite(y.T)
        filled = np.stack([bridged(x, ~gone) for x, gone in zip(y.T, absent)])
        segments, gone = (
            sliding_window_view(x, size, axis=1)[:, :: size - size // 2] for x in (filled, absent)
        )
        each = np.abs(rfft((segments - (segments @ line) @ line.T) * taper)) ** 2
        pieces.append(
            np.where(gone.mean(axis=2, keepdims=True) > MOST_BRIDGED, np.nan, each).swapaxes(1, 2)
        )
    power = np.concatenate(pieces, axis=-1)
    keep = (f >= SLOW_HZ) & (f <= NYQUISTS * 0.5 / dt_s)
    bias = float(np.log(2))  # median over mean of a squared amplitude
    if np.count_nonzero(keep) < LEAST_WAVES:
        return None
    whole = np.count_nonzero(np.isfinite(power[:, 0]), axis=-1) >= LEAST_SEGMENTS
    usual: Array = np.nan_to_num(middle(np.where(whole[:, None, None], power, 0.0))).T[keep] / bias
    return np.asarray(f[keep]), usual, power.shape[-1] // 2


def _levels(power: Array, shapes: Array) -> tuple[Array, float]:
    """Levels (K,) of ``shapes`` (F, K) that make ``power`` (F,) likeliest, and sum(log s + power/s) at them.

    Fisher's scoring of Whittle's likelihood: least squares without negative levels, weighted by the spectrum itself.
    """
    s, levels = np.maximum(power, least := 1e-12 * float(np.max(power))), np.zeros(shapes.shape[1])
    for _ in range(30):
        rows = shapes / s[:, None]
        before = levels
        scale = np.linalg.norm(rows, axis=0)
        levels = nnls(rows / scale, power / s)[0] / scale
        s = np.maximum(shapes @ levels, least)
        if (np.abs(levels - before) <= SETTLED * np.abs(before)).all():
            break
    return levels, float(np.sum(np.log(s) + power / s))
