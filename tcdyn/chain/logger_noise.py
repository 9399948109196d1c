"""Noise of loggers: white noise before and after the conditioning filter, and whitening.

reading = B (C T + w) + v: slip rings and wires are before the filter B, so it colours most of their
noise w; the noise v of the converter is white. With B = 1/A the spectrum of both is |N|^2 |B|^2,
|N|^2 = a + b |A|^2: the filter A/N whitens the noise, and a chain C B followed by it is C/N. No fit
and no smoother needs to know more.

``tcdyn.chain.bursts``, ``tcdyn.smoothing`` and ``immersion`` use it. Thresholds are below, with
their reason. Guarded by ``tests/smoothing/test_noise.py`` and
``tests/smoothing/test_noise_parts.py``.
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
from tcdyn.chain.rational import Factor, Rational, polynomial_product, simulate, spectral_factor
from tcdyn.core import Array, Flags
from tcdyn.core.findings import Finding, info, warning
from tcdyn.estimation.trace_noise import fast_nanmedian, interpolate_gaps
from tcdyn.rig.disk import Conditioning

# Values without a source below were chosen by judgement.
# length of a segment [s]; the spectra of segments are combined by their median, so that events and
# bursts, which are in few segments, do not matter
SEGMENT_S = 8.0
# fewest samples of a segment, and fewest segments
LEAST_SEGMENT = 64
LEAST_SEGMENTS = 3
# share of a segment that may be missing
MAX_MISSING = 0.3
# power of a usable channel, as a share of that of its white noise, at least
MIN_POWER_SHARE = 0.1
# range of a spectrum that is used: above what detrending removes [Hz], below aliases (share of
# the Nyquist frequency)
MIN_FREQUENCY_HZ = 0.3
NYQUIST_SHARE = 0.9
# independent spectra for each segment: the median costs half, the taper correlates neighbours
SPECTRA_PER_SEGMENT = 0.33
# deviance by which noise from before the filter must explain the spectra better
MIN_DEVIANCE = 40.0
# deviance by which another lag must be better than the conditioning filter
FILTER_PREFERENCE = 10.0
# share of noise from before the filter in the total, at low frequency, that matters, at least
MIN_BEFORE_SHARE = 0.1
# fastest poles of 1/N over the sampling rate [1/s per Hz]: samples do not show faster ones
MAX_POLE_RATE = 5.0
# number of lags tried, from a corner of 1 Hz to three tenths of the sampling rate
N_LAGS = 10
# neighbouring frequencies that one is compared with; standard deviations that make it a line
NEIGHBOURS = 21
LINE_SD = 8.0
# fewest frequencies of a usable spectrum
MIN_FREQUENCIES = 10
# largest amplitude of a harmonic of hum relative to its line; width of a line [Hz]
HARMONIC_SHARE = 0.5
LINE_WIDTH_HZ = 0.5
# width of a line of the mains relative to the sampling rate at most: below some ten samples a
# second its harmonics could be anywhere
LINE_SHARE = 0.01
# frequencies of the mains [Hz], and the highest harmonic
MAINS_HZ = (50.0, 60.0)
HARMONICS = 5
# bands of a spectrum; mean ratio of observed to expected power in one that counts as unexplained
N_BANDS = 8
UNEXPLAINED = 1.6
# standard deviations by which such a mean must exceed one
UNEXPLAINED_SD = 5.0
# relative change of a level at which the iteration ends
LEVELS_SETTLED = 1e-6
LEVEL_ITERATIONS = 30  # at most; chosen by judgement
# lag [s] of the chain before the filter: shapes the spectrum of slow temperatures
TYPICAL_LAG_S = 0.7


@dataclass(frozen=True)
class WhitenedConditioning(Conditioning):
    """The filter that replaces B once a trace went through A/N.

    It is 1/N for a chain with the filter B, and B A/N for another filter or none.

    Parameters
    ----------
    sections
        Factors of the denominator.
    numerator
        Ascending in s.

    Notes
    -----
    Its ``lag_s`` remains that of B, which users know.
    """

    sections: tuple[tuple[float, ...], ...] = ()
    numerator: tuple[float, ...] = (1.0,)

    @cached_property
    def factors(self) -> tuple[tuple[float, ...], ...]:
        """Factors of the denominator.

        Returns
        -------
        Ascending coefficients in s of each factor.
        """
        return self.sections

    @cached_property
    def lag_s(self) -> float:
        """First moment [s] of the filter whose noise was whitened."""
        return Conditioning(self.cutoff_Hz, self.poles, self.shape).lag_s


@dataclass(frozen=True)
class LoggerNoise:
    """Noise of M channels of one logger.

    Parameters
    ----------
    before_filter_K
        Standard deviation (M,), after the filter, of the white noise before it.
    after_filter_K
        Standard deviation (M,) of the white noise after the filter.
    level_K
        Standard deviation (M,) of the white noise with the same power at low frequency.
    shaping
        The filter.
    sections
        Factors of N; none where all noise is white.
    hum_lines
        Frequency [Hz] and amplitudes (M,) [K] of hum.
    rate_Hz
        Sampling rate.
    unexplained
        Largest ratio of observed to expected power, averaged over a band.
    waves
        Frequency [Hz] and largest amplitude [K] of waves that are no mains hum, and the amplitude
        of the temperature that they would be [K].
    """

    before_filter_K: Array
    after_filter_K: Array
    level_K: Array
    shaping: Conditioning
    sections: tuple[tuple[float, ...], ...] = ()
    hum_lines: tuple[tuple[float, Array], ...] = ()
    rate_Hz: float = np.nan
    unexplained: float = 1.0
    waves: tuple[tuple[float, float, float], ...] = ()

    @property
    def is_coloured(self) -> bool:
        """Whether traces need whitening."""
        return bool(self.sections)

    def to_dict(self) -> dict[str, float]:
        """Standard deviations of a typical channel [K], as they are in the log."""
        return {
            "before_filter_K": float(np.median(self.before_filter_K)),
            "after_filter_K": float(np.median(self.after_filter_K)),
        }

    def findings(self, subject: str) -> list[Finding]:
        """Findings for noise from before the filter, hum, waves, and unexplained power.

        Parameters
        ----------
        subject
            What the traces belong to, for the messages.
        """
        out = []
        before, after = self.to_dict().values()
        if self.is_coloured:
            lag_s = self.shaping.lag_s if self.shaping.poles == 1 else 0.0
            out.append(
                info("noise.coloured", subject=subject, before_K=before, after_K=after, lag_s=lag_s)
            )
        for f, amplitude in self.hum_lines:
            out.append(
                info("noise.hum", subject=subject, f_Hz=f, amplitude_K=float(np.max(amplitude)))
            )
        for f, amplitude_K, temperature_K in self.waves:
            out.append(
                warning(
                    "noise.wave",
                    subject=subject,
                    f_Hz=f,
                    amplitude_K=amplitude_K,
                    temperature_K=temperature_K,
                )
            )
        folded = float(np.max(self.aliasing_u_K))
        if folded > 0:
            out.append(warning("noise.folded", subject=subject, folded_K=folded))
        if self.unexplained > UNEXPLAINED:
            out.append(warning("noise.unexplained", subject=subject, ratio=self.unexplained))
        return out

    @property
    def aliasing_u_K(self) -> Array:
        """Standard uncertainty from mains harmonics that sampling aliases onto the temperature [K].

        Returns
        -------
        Standard uncertainties, (M,).

        Notes
        -----
        For a line at the mains frequency, as sampled, those harmonics up to the fifth that are
        aliased to below half a hertz are taken to be at most half as strong (``HARMONIC_SHARE``);
        no data can distinguish them from a temperature.
        """
        u: Array = np.zeros(len(self.level_K))
        for f, amplitude in self.hum_lines:
            for mains in _mains_at(f, self.rate_Hz):
                if any(
                    _alias_frequency(k * mains, self.rate_Hz) < LINE_WIDTH_HZ
                    for k in range(2, HARMONICS + 1)
                ):
                    u = np.hypot(u, HARMONIC_SHARE * amplitude / np.sqrt(2))
        return u

    def is_mains(self, frequency_Hz: float) -> bool:
        """Whether sampling shows the mains, or one of its harmonics, at ``frequency_Hz`` [Hz]."""
        width_Hz = min(LINE_WIDTH_HZ, LINE_SHARE * self.rate_Hz)
        harmonics = [k * mains for mains in MAINS_HZ for k in range(1, HARMONICS + 1)]
        return any(
            abs(_alias_frequency(h, self.rate_Hz) - frequency_Hz) < width_Hz for h in harmonics
        )

    def white(self, sd_K: Array) -> LoggerNoise:
        """White noise of ``sd_K`` (M,) on the same channels."""
        return LoggerNoise(np.zeros(len(sd_K)), sd_K, sd_K, self.shaping, rate_Hz=self.rate_Hz)

    def with_channels(self, present: Flags, white_K: Array) -> LoggerNoise:
        """The same noise for more channels.

        Parameters
        ----------
        present
            Which of the channels are those of this noise, (M,).
        white_K
            Standard deviation of the white noise of the others, (M,) [K].
        """

        def spread(values: Array, others: Array) -> Array:
            """``values`` at the present channels, ``others`` at the rest, (M,)."""
            out = np.array(others, dtype=float)
            out[present] = values
            return out

        none = np.zeros(len(present))
        return replace(
            self,
            before_filter_K=spread(self.before_filter_K, none),
            after_filter_K=spread(self.after_filter_K, white_K),
            level_K=spread(self.level_K, white_K),
            hum_lines=tuple((f, spread(a, none)) for f, a in self.hum_lines),
        )

    def whiten(self, y: Array, dt_s: float) -> Array:
        """Whiten a trace: filter it by A/N.

        Parameters
        ----------
        y
            Trace, (N, M) [K], NaN where missing.
        dt_s
            Sampling interval [s].

        Returns
        -------
        Whitened trace, (N, M), NaN where ``y`` was. Gaps are interpolated before the filter.

        Notes
        -----
        A chain of such a trace must be replaced by ``whitened_chain``.
        """
        if not self.is_coloured:
            return y
        missing_mask = ~np.isfinite(y)
        filter_ = Rational(
            polynomial_product(self.shaping.factors), tuple(Factor(f) for f in self.sections)
        )
        filled = [interpolate_gaps(x, ~missing) for x, missing in zip(y.T, missing_mask.T)]
        out = np.stack([simulate(filter_, x, dt_s) for x in filled], axis=1)
        return np.where(missing_mask, np.nan, out)

    def whitened_chain(self, chain: Chain) -> Chain:
        """The chain of a trace that ``whiten`` has filtered.

        Parameters
        ----------
        chain
            Chain of the trace before whitening.

        Notes
        -----
        Where the chain has the filter B of this noise, C B A/N = C/N; otherwise A/N is added to its
        filter. ``tests/smoothing/test_noise_parts.py`` compares both with the filter of the trace.
        """
        if not self.is_coloured:
            return chain
        b = chain.conditioning
        stages = self.sections
        numerator: tuple[float, ...] = (1.0,)  # the filter cancels its own A
        if b != self.shaping:
            stages = (*b.factors, *stages)
            numerator = tuple(map(float, polynomial_product(self.shaping.factors)))
        return replace(
            chain,
            conditioning=WhitenedConditioning(b.cutoff_Hz, b.poles, b.shape, stages, numerator),
        )


def estimate_logger_noise(
    traces: Sequence[Array],
    dt_s: float,
    filter_: Conditioning,
    white_K: Array,
    segment_s: float = SEGMENT_S,
) -> LoggerNoise:
    """Estimate the noise of the channels of one logger.

    Parameters
    ----------
    traces
        Each (N, M) [K], NaN where missing.
    dt_s
        Sampling interval of all traces [s].
    filter_
        The conditioning filter.
    white_K
        Standard deviation (M,) of white noise [K], estimated from differences; used where neither
        model is clearly better than white noise.
    segment_s
        Length of the segments of the spectra [s].

    Notes
    -----
    S = a |B|^2 + b + (c/w^2 + d/w^4) |B|^2/(1 + (w lag)^2) is fitted to the median of the spectra
    of the segments by Whittle's likelihood, each channel with its own levels; the last two terms
    are the temperature, rough and smooth. In place of the filter, lags of several lengths are tried
    (in effect an autoregressive model), and one is used where it is clearly better. Frequencies
    that stand out are lines (hum), and excluded from the fit.

    Noise is taken as coloured where that lowers the deviance by ``MIN_DEVIANCE`` and the share from
    before the filter is at least ``MIN_BEFORE_SHARE``. Smaller values also whiten traces whose
    noise is white; larger ones leave traces with coloured noise as they are.
    ``tests/smoothing/test_noise.py`` has cases of both kinds. The spectra must have the scale of
    ``_median_spectrum``: the mean over all frequencies is the variance of a sample.
    """
    white = LoggerNoise(np.zeros(len(white_K)), white_K, white_K, filter_, rate_Hz=1 / dt_s)
    spectra = _median_spectrum(traces, dt_s, segment_s)
    if spectra is None:
        return white
    f, power, count = spectra
    # the other channels mostly repeat one value, or are missing
    usable = power.mean(axis=0) > MIN_POWER_SHARE * white_K**2
    if not usable.any():
        return white
    if not usable.all():
        some = [y[:, usable] for y in traces]
        return estimate_logger_noise(some, dt_s, filter_, white_K[usable], segment_s).with_channels(
            usable, white_K
        )
    w = 2 * np.pi * f
    passed = _power_gain(f, filter_) / (1 + (w * TYPICAL_LAG_S) ** 2)
    flat = np.ones(len(f))
    flat_and_signal = np.stack([flat, passed / w**2, passed / w**4], axis=1)
    masks = [_is_background(p, flat_and_signal, count) for p in power.T]
    # hum is in most channels; a single odd channel does not count
    background = np.mean(masks, axis=0) >= 0.5
    lines = _spectral_lines(f, power, ~background)
    if np.count_nonzero(background) < MIN_FREQUENCIES:
        return replace(white, hum_lines=lines)
    filters = [filter_] if filter_.poles else []
    lags = [Conditioning(float(c), 1) for c in np.geomspace(1.0, 0.3 / dt_s, N_LAGS)]
    shapes = {
        c: np.column_stack([_power_gain(f, c), flat_and_signal])[background]
        for c in (*filters, *lags)
    }
    shapes[NO_CONDITIONING] = flat_and_signal[background]
    fits = {c: [_fit_levels(p, shape) for p in power[background].T] for c, shape in shapes.items()}
    white_value = np.array([value for _, value in fits[NO_CONDITIONING]])
    gain = {c: np.median(white_value - [value for _, value in fit]) for c, fit in fits.items()}
    cost = {
        c: -2 * SPECTRA_PER_SEGMENT * count * len(white_value) * float(value)
        for c, value in gain.items()
    }
    best = min(lags, key=cost.__getitem__)
    if filters and cost[filter_] < cost[best] + FILTER_PREFERENCE:
        best = filter_
    levels = np.array([v for v, _ in fits[best]])
    before = levels[:, 0]
    after = levels[:, 1]
    ratio = float(np.median(before / np.maximum(before + after, 1e-300)))
    coloured = (
        cost[NO_CONDITIONING] - cost[best] >= MIN_DEVIANCE
        and ratio >= MIN_BEFORE_SHARE
        # a slower lag than all that were tried: the lag of the sensor, and a rough temperature
        and best is not lags[0]
    )
    chosen = best if coloured else NO_CONDITIONING
    ratio_to_expected = power[background] / np.stack(
        [shapes[chosen] @ v for v, _ in fits[chosen]], axis=1
    )
    bands = [float(band.mean()) for band in np.array_split(ratio_to_expected, N_BANDS) if len(band)]
    worst = 1.0
    chance = 1 + UNEXPLAINED_SD / float(
        np.sqrt(SPECTRA_PER_SEGMENT * count * ratio_to_expected.size / N_BANDS)
    )
    if max(bands) > chance:
        worst = max(bands)
    inflation = max(bands[0], 1.0) ** 0.5 if worst > UNEXPLAINED else 1.0
    if not coloured:
        level = white_K
        if lines:  # differences would include the lines
            level = np.sqrt([v[0] for v, _ in fits[NO_CONDITIONING]])
        return replace(white.white(inflation * level), hum_lines=lines, unexplained=worst)
    level = inflation * np.sqrt(before + after)
    share = noise_power_ratio(best, dt_s)
    sections = spectral_factor(
        ratio, 1 - ratio, polynomial_product(best.factors), MAX_POLE_RATE / dt_s
    )
    return LoggerNoise(
        np.sqrt(before * share), np.sqrt(after), level, best, sections, lines, 1 / dt_s, worst
    )


def _alias_frequency(frequency_Hz: float, rate_Hz: float) -> float:
    """Frequency [Hz] at which samples show a wave (aliasing).

    Parameters
    ----------
    frequency_Hz
        Frequency of the wave [Hz].
    rate_Hz
        Sampling rate [Hz].
    """
    return abs(frequency_Hz - rate_Hz * round(frequency_Hz / rate_Hz))


def _mains_at(frequency_Hz: float, rate_Hz: float) -> list[float]:
    """Mains frequencies, 50 and 60 Hz, that sampling at ``rate_Hz`` shows at ``frequency_Hz``."""
    return [
        mains
        for mains in MAINS_HZ
        if abs(_alias_frequency(mains, rate_Hz) - frequency_Hz) < LINE_WIDTH_HZ
    ]


def noise_power_ratio(filter_: Conditioning, dt_s: float) -> float:
    """Share of its variance that the filter leaves of sampled white noise.

    The variance of noise from before the filter, divided by it, is that of white noise with the
    same power at low frequency.

    Parameters
    ----------
    filter_
        The filter.
    dt_s
        Sampling interval [s].

    Notes
    -----
    Mean of |B|^2 from zero to the Nyquist frequency.

    Examples
    --------
    >>> round(noise_power_ratio(Conditioning(4.0, 2), 1 / 75), 3)
    0.085
    """
    return float(np.mean(_power_gain(np.linspace(0.0, 0.5 / dt_s, 400), filter_)))


def _power_gain(f: Array, filter_: Conditioning) -> Array:
    """Power gain |B|^2 of the filter at frequencies ``f`` [Hz].

    Returns
    -------
    Gains, in the shape of ``f``.

    Notes
    -----
    The numerator of the filter is taken as one, which holds for conditioning filters that are not
    whitened.
    """
    return np.asarray(
        1.0 / np.abs(polyval(2j * np.pi * f, polynomial_product(filter_.factors))) ** 2
    )


def _is_background(power: Array, shapes: Array, count: int) -> Flags:
    """Mark the frequencies whose power does not stand out from their neighbours.

    Parameters
    ----------
    power
        Spectrum, (F,).
    shapes
        Shapes of a first fit, (F, K).
    count
        Number of segments of the spectrum.

    Returns
    -------
    Mask, (F,).

    Notes
    -----
    The limit is ``LINE_SD`` standard deviations above the median of ``NEIGHBOURS`` frequencies,
    relative to the fit. With a smaller ``LINE_SD`` a temperature signal is called hum, with a
    larger one hum enters the fit. ``test_a_temperature_that_swings_is_not_called_hum`` in
    ``tests/smoothing/test_noise.py`` (study) guards the first.
    """
    expected = shapes @ _fit_levels(power, shapes)[0]
    expected *= median_filter(power / expected, NEIGHBOURS, mode="nearest")
    return np.asarray(power < expected * (1 + LINE_SD / np.sqrt(SPECTRA_PER_SEGMENT * count)))


def _spectral_lines(f: Array, power: Array, standing: Flags) -> tuple[tuple[float, Array], ...]:
    """Frequency and amplitude of each group of neighbouring frequencies that stand out.

    Parameters
    ----------
    f
        Frequencies, (F,) [Hz].
    power
        Spectra of the channels, (F, M) [K2].
    standing
        Frequencies that stand out, (F,).

    Returns
    -------
    (frequency [Hz], amplitudes (M,) [K]) of each line.

    Notes
    -----
    The factor 1.5 is the equivalent noise bandwidth of the Hann taper in ``_median_spectrum``;
    change both together. ``tests/smoothing/test_noise_parts.py`` compares the amplitude of a wave.
    """
    groups, number = label(standing)
    out = []
    for k in range(1, number + 1):
        rows = np.flatnonzero(groups == k)
        total = power[rows].sum(axis=0)
        weight = power[rows].mean(axis=1)
        centre = float((f[rows] * weight).sum() / weight.sum())
        out.append((centre, np.sqrt(2 * 2 * total / (1.5 * 2 * len(f)))))
    return tuple(out)


def _median_spectrum(
    traces: Sequence[Array], dt_s: float, segment_s: float
) -> tuple[Array, Array, int] | None:
    """Median spectrum of the segments of all traces.

    Parameters
    ----------
    traces
        Each (N, M) [K], NaN where missing.
    dt_s
        Sampling interval [s].
    segment_s
        Length of a segment [s]; shorter where a trace is too short for ``LEAST_SEGMENTS`` of them.

    Returns
    -------
    f
        Frequencies that are used, (F,) [Hz].
    power
        Variance of a sample of white noise that has this power, (F, M) [K2].
    count
        Number of segments that do not overlap.
    None instead, where the traces are too short or have too few frequencies.

    Notes
    -----
    Segments overlap by half, lose their straight line, and are tapered (Hann, norm one). The median
    over segments is divided by log 2, the median over the mean of a squared amplitude.
    """
    long_traces = [y for y in traces if len(y) >= LEAST_SEGMENT * LEAST_SEGMENTS]
    if not long_traces:
        return None
    size = max(
        min(round(segment_s / dt_s), min(map(len, long_traces)) // LEAST_SEGMENTS), LEAST_SEGMENT
    )
    f = rfftfreq(size, dt_s)
    taper = np.hanning(size + 1)[:-1]
    chunks: list[Array] = []
    taper = taper / np.linalg.norm(taper)
    line = np.linalg.qr(np.vander(np.linspace(-1, 1, size), 2))[0]
    for y in long_traces:
        missing_mask = ~np.isfinite(y.T)
        filled = np.stack([interpolate_gaps(x, ~missing) for x, missing in zip(y.T, missing_mask)])
        hop = size - size // 2
        segments = sliding_window_view(filled, size, axis=1)[:, ::hop]
        missing_share = sliding_window_view(missing_mask, size, axis=1)[:, ::hop].mean(axis=2)
        detrended = segments - (segments @ line) @ line.T
        segment_power = np.abs(rfft(detrended * taper)) ** 2
        segment_power[missing_share > MAX_MISSING] = np.nan
        chunks.append(segment_power.swapaxes(1, 2))
    power = np.concatenate(chunks, axis=-1)
    keep = (f >= MIN_FREQUENCY_HZ) & (f <= NYQUIST_SHARE * 0.5 / dt_s)
    bias = float(np.log(2))  # median over mean of a squared amplitude
    if np.count_nonzero(keep) < MIN_FREQUENCIES:
        return None
    enough = np.count_nonzero(np.isfinite(power[:, 0]), axis=-1) >= LEAST_SEGMENTS
    median_power = fast_nanmedian(np.where(enough[:, None, None], power, 0.0))
    typical: Array = np.nan_to_num(median_power).T[keep] / bias
    return np.asarray(f[keep]), typical, power.shape[-1] // 2


def _fit_levels(power: Array, shapes: Array) -> tuple[Array, float]:
    """Most likely levels of the shapes of a spectrum.

    Parameters
    ----------
    power
        Spectrum, (F,).
    shapes
        Shapes that are added, (F, K).

    Returns
    -------
    levels
        Level of each shape, (K,), none negative.
    value
        sum(log s + power/s) at them, for the sum s of the shapes: minus the log likelihood for one
        spectrum.

    Notes
    -----
    Fisher scoring of Whittle's likelihood: non-negative least squares, weighted by the spectrum
    itself. At most ``LEVEL_ITERATIONS``, which end where no level changes by more than
    ``LEVELS_SETTLED``.
    """
    least = 1e-12 * float(np.max(power))
    s = np.maximum(power, least)
    levels = np.zeros(shapes.shape[1])
    for _ in range(LEVEL_ITERATIONS):
        rows = shapes / s[:, None]
        before = levels
        scale = np.linalg.norm(rows, axis=0)
        levels = nnls(rows / scale, power / s)[0] / scale
        s = np.maximum(shapes @ levels, least)
        if (np.abs(levels - before) <= LEVELS_SETTLED * np.abs(before)).all():
            break
    return levels, float(np.sum(np.log(s) + power / s))
