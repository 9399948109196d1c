"""Process-noise intensity by maximum likelihood, or by a criterion of regularised deconvolution.

Each segment between events has one level: long segments by Whittle's spectral likelihood, short
ones by the exact likelihood of the Kalman filter. A change after each event is added. The criteria
of regularised deconvolution (GCV, discrepancy, L-curve) choose one constant intensity.

Used by :mod:`tcdyn.smoothing.smoother` and :mod:`tcdyn.smoothing.possible_events`. Guarded by
``tests/smoothing/test_any_unit.py`` (levels, units, criteria) and
``tests/smoothing/test_deconvolve.py``. Thresholds without a source were chosen by judgement.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from typing import Literal

import numpy as np
from scipy.fft import prev_fast_len, rfft

from tcdyn.chain import Chain
from tcdyn.core import Array, Flags
from tcdyn.smoothing.corner import corner_rad_s
from tcdyn.smoothing.noise_levels import Intensity
from tcdyn.smoothing.record import Record, least_noise_sd
from tcdyn.smoothing.state_space import likelihood, smooth_record

Criterion = Literal["gcv", "discrepancy", "l-curve"]
# lowest bins of a spectrum that are left out: removing a straight line disturbs them
DETREND_BINS = 3
# an exact level counts beyond so many values of ``FLOOR`` (the slope then changes three times as
# fast, by the fourth root); chosen by judgement
CLEAR_FLOORS = 100.0
# bins: a spectrum whose corner is below so many bins does not show the signal above the noise
FEW_BINS = 20
# samples from which on the spectral likelihood replaces the exact one; chosen by judgement
LONG_SAMPLES = 4096
# lags after an event in which the sensor settles, and on either side of it that it influences;
# chosen by judgement
REACH_LAGS = 5
# share of the corner frequency from which on a spectrum is used: the error arises near the corner,
# not at low frequency
CORNER_SHARE = 0.4
# nats: where a likelihood has fallen by so much below a maximum, another one begins; chosen by
# judgement
PAST_PEAK_NATS = 20.0
# rounds of the grid search for a level, and trials in a refined one over 0.8 steps on either side;
# chosen by judgement
GRID_ROUNDS = 3
REFINED_TRIALS = 7
# bands of a spectrum, evenly in the logarithm of the frequency, each of nearly one shape; more
# bands cost time
SPECTRAL_BANDS = 1500
# factor of the noise variance from which on what is called noise must be white; and the chance that
# white noise shows a line
NOISE_SLACK = 1.2
LINE_CHANCE = 1e-4
# smallest intensity, in noise variances per second cubed: the slope may always change over about
# 10 s
FLOOR = 1e-6


def spectral_level(y: Array, dt_s: float, chain: Chain, noise_var: float) -> float:
    """Process-noise intensity q [K2/s3] of a long segment by Whittle's likelihood.

    Parameters
    ----------
    y
        Readings (N,) [degC] of the segment.
    dt_s
        Sampling interval [s].
    chain
        The chain, with frequency response G.
    noise_var
        Noise variance [K2], which is not fitted.

    Notes
    -----
    The last few samples are left out, so that the Fourier transform has a length that is computed
    quickly. The expected periodogram is noise_var + q |G|^2 / (w^4 dt), with a Hann taper and the
    straight line removed. The fit is repeated at most three times with the frequencies above
    ``CORNER_SHARE`` of the corner frequency, because the error of the smoother arises near the
    corner. Bins above 0.45 of the sampling frequency are left out.

    What may be changed: ``DETREND_BINS`` also decides in ``segment_levels`` whether the exact
    likelihood is tried as well. ``tests/smoothing/test_any_unit.py`` recovers a known q.
    """
    n = prev_fast_len(len(y), real=True)
    y = y[:n]
    t = np.linspace(-1, 1, n)
    detrended = y - y.mean() - t @ y / (t @ t) * t
    power = np.abs(rfft(detrended * hann_taper(n))) ** 2
    bins = slice(DETREND_BINS, int(0.45 * n))
    power = power[bins]
    w = 2 * np.pi * np.asarray(np.fft.rfftfreq(n, dt_s), dtype=float)[bins]
    level = _whittle(power, w, dt_s, chain, noise_var)
    for _ in range(3):
        band_rad_s = CORNER_SHARE * float(corner_rad_s(chain, np.array(level / (noise_var * dt_s))))
        first = int(np.searchsorted(w, band_rad_s, side="right"))
        if len(w) - first < 100:
            break
        refined = _whittle(power[first:], w[first:], dt_s, chain, noise_var)
        if float(corner_rad_s(chain, np.array(refined / (noise_var * dt_s)))) < band_rad_s:
            break  # only noise remains there; the signal lies at lower frequency, such as a line
        level = refined
    return level


@lru_cache(maxsize=2)
def hann_taper(n: int) -> Array:
    """Hann taper (n,) of unit energy; cached for the other channels."""
    taper = np.hanning(n + 1)[:-1]
    return np.asarray(taper / np.linalg.norm(taper))


def _whittle(power: Array, w: Array, dt_s: float, chain: Chain, noise_var: float) -> float:
    """Intensity q [K2/s3] that maximises Whittle's likelihood.

    The likelihood is -sum(log e + power / e) with e = noise_var + q shape.

    Parameters
    ----------
    power
        Periodogram (F,) [K2].
    w
        Angular frequencies (F,) [rad/s].
    dt_s
        Sampling interval [s].
    chain
        The chain, whose gain gives the shape |G|^2 / (w^4 dt).
    noise_var
        Noise variance [K2].

    Notes
    -----
    Frequencies of nearly one shape are averaged in ``SPECTRAL_BANDS`` bands; more bands cost time
    and change little. q lies between ``FLOOR`` and 1e9 noise variances per second cubed.
    """
    logs = np.linspace(np.log(FLOOR * noise_var), np.log(1e9 * noise_var), 60)
    edges = np.unique(np.geomspace(1, len(w) + 1, SPECTRAL_BANDS).astype(int) - 1)[:-1]
    ends = np.append(edges[1:], len(w))
    count = ends - edges
    middle_w = np.sqrt(w[edges] * w[ends - 1])
    gain = np.abs(chain.frequency_response(middle_w / (2 * np.pi)))
    middle = gain**2 / (middle_w**4 * dt_s)
    mean = np.add.reduceat(power, edges) / count
    for _ in range(3):
        expected = noise_var + np.exp(logs)[:, None] * middle
        best = int(np.argmin((np.log(expected) + mean / expected) @ count))
        logs = np.linspace(logs[max(best - 1, 0)], logs[min(best + 1, len(logs) - 1)], 9)
    return float(np.exp(logs[4]))


def exact_levels(
    record: Record, noise_var: Array, noise_known: bool, most: float = 1e8, trials: int = 14
) -> tuple[Array, Array]:
    """Intensity and noise variance of a short record by the exact likelihood.

    Parameters
    ----------
    record
        The record.
    noise_var
        Noise variance (M,) [K2]; a first estimate, or the known value.
    noise_known
        Whether the noise variance is known; otherwise it is profiled out.
    most
        Largest intensity tried, in noise variances per second cubed.
    trials
        Number of intensities tried at first, evenly in their logarithm.

    Returns
    -------
    level
        Intensity (M,) [K2/s3].
    noise_var
        Noise variance (M,) [K2].

    Notes
    -----
    A grid search in the logarithm, refined ``GRID_ROUNDS`` - 1 times. The likelihood of a wave has
    two maxima: the first takes it for noise.
    ``tests/smoothing/test_any_unit.py`` recovers a known intensity and noise.
    """
    logs = np.tile(np.linspace(np.log(FLOOR), np.log(most), trials), (len(noise_var), 1))

    def evaluate(logs: Array) -> tuple[Array, Array]:
        """Likelihood of intensities, profiled over unknown noise.

        Parameters
        ----------
        logs
            Logarithm of the intensities over the noise variance (M, Q) [1/s3].

        Returns
        -------
        log_likelihood, ratio
            Log likelihood, and factor of the noise variance, (M, Q).
        """
        proposed = [
            [Intensity((0.0,), (v * r,)) for v in np.exp(row)] for row, r in zip(logs, noise_var)
        ]
        value, ratio = likelihood(record, noise_var, proposed)
        if not noise_known:
            used = (record.weight > 0).sum(axis=0)[:, None]
            free = used - 2 - len(record.events_s)
            log_ratio = np.log(np.maximum(ratio, 1e-12))
            value = value + 0.5 * ratio * free - 0.5 * free * (1 + log_ratio)
        return value, ratio

    for _ in range(GRID_ROUNDS):
        value, ratio = evaluate(logs)
        best = np.argmax(value, axis=1)
        if has_hum(record):  # a wave of the mains is noise, which the first maximum takes it for
            best = np.array([_first_maximum(row) for row in value])
        rows = np.arange(len(best))
        scale = np.ones(len(best))
        if not noise_known:
            # rounding that the noise does not hide is a noise of its own
            least_K = np.maximum(least_noise_sd(record.y), record.rounding_K)
            least = least_K**2 / noise_var
            scale = np.maximum(ratio[rows, best], least)
        step = logs[:, 1] - logs[:, 0]
        top = logs[rows, best]
        refined = top[:, None] + step[:, None] * np.linspace(-0.8, 0.8, REFINED_TRIALS)
        logs = np.clip(refined, np.log(FLOOR), None)
    intensity = np.exp(top) * noise_var * scale
    larger = noise_var * scale
    signal = (scale > NOISE_SLACK) & _has_line_above_corner(record, larger, intensity)
    if signal.any():
        known, _ = exact_levels(record, noise_var, True, most, trials)
        return np.where(signal, known, intensity), np.where(signal, noise_var, larger)
    return intensity, larger


def has_hum(record: Record) -> bool:
    """Whether a channel of the record has a wave of the mains."""
    return any(model.hum_lines for model in record.noise)


def _first_maximum(value: Array) -> int:
    """The largest of log likelihoods (Q,) before they fall by ``PAST_PEAK_NATS``."""
    has_fallen = value < np.maximum.accumulate(value) - PAST_PEAK_NATS
    end = int(np.argmax(has_fallen)) if has_fallen.any() else len(value)
    return int(np.argmax(value[:end]))


def _has_line_above_corner(record: Record, noise_var: Array, intensity: Array) -> Flags:
    """Channels (M,) with a frequency above the corner of the smoother whose power is no noise.

    A larger noise would explain such a line, or part of a spectrum, as well as a temperature would;
    but white noise has the same power at all frequencies. In the periodogram of white noise the
    share above log(N / P) is P / N; P is ``LINE_CHANCE``. ``noise_var`` [K2] and ``intensity``
    [K2/s3] are those of the channels (M,).
    """
    n = len(record.y)
    t = np.linspace(-1, 1, n)
    w = 2 * np.pi * np.fft.rfftfreq(n, record.dt_s)
    out = np.zeros(len(noise_var), dtype=bool)
    even = record.at_samples()
    for c, chain in enumerate(record.chains):
        y = even[:, c] - even[:, c].mean()
        power = np.abs(np.fft.rfft((y - t @ y / (t @ t) * t) * hann_taper(n))) ** 2
        if not noise_var[c] > 0:  # it could not be estimated
            continue
        corner = corner_rad_s(chain, np.array(intensity[c] / (noise_var[c] * record.dt_s)))
        above = power[w > corner]
        out[c] = len(above) > 0 and above.max() > noise_var[c] * np.log(n / LINE_CHANCE)
    return out


def segment_levels(
    record: Record, noise_var: Array, noise_known: bool
) -> tuple[list[Intensity], Array]:
    """Intensity of each channel without changes, and its noise variance.

    Parameters
    ----------
    record
        The record; its events divide it into segments.
    noise_var
        Noise variance (M,) [K2]; a first estimate, or the known value.
    noise_known
        Whether the noise variance is known.

    Returns
    -------
    intensities
        Intensity of each channel (M,), one level a segment.
    noise_var
        Noise variance (M,) [K2]; estimated again only in a short record without events.

    Notes
    -----
    Segments of at least ``LONG_SAMPLES`` get their level from the spectrum, shorter ones from the
    exact likelihood, without the first ``REACH_LAGS`` lags, but at most half of its readings: there
    the sensor settles, which looks like a large intensity. A segment with fewer than 64
    samples gets the largest level of the others. Where the spectrum puts the corner frequency below
    ``FEW_BINS`` bins, the signal may lie in the bins that the spectrum leaves out: the exact
    likelihood is tried as well, and used above ``CLEAR_FLOORS`` floors.

    What may be changed: ``LONG_SAMPLES`` (time against accuracy). Both estimates must agree at it:
    ``tests/smoothing/test_any_unit.py`` compares each with a known level.
    """
    n = len(record.y)
    dt = record.dt_s
    starts = [0.0, *record.events_s]
    cuts = [int(np.ceil(t / dt)) for t in starts] + [n]
    levels = np.full((len(starts), len(noise_var)), np.nan)
    settling_s = REACH_LAGS * max(s.lag_s for s in record.sensors)
    if n < LONG_SAMPLES and len(starts) == 1:
        levels[0], noise_var = exact_levels(record, noise_var, noise_known)
    else:
        for k, (a, b) in enumerate(pairwise(cuts)):
            skip = 0 if k == 0 else min(int(settling_s / dt), _half_of_readings(record, a, b))
            if b - a - skip < 64:
                continue
            if b - a - skip >= LONG_SAMPLES:
                window = segment(record, a + skip, b, ())
                even = window.at_samples()
                spectral = [
                    spectral_level(even[:, c], dt, s, noise_var[c])
                    for c, s in enumerate(record.chains)
                ]
                levels[k] = spectral
                first_bin_rad_s = 2 * np.pi / (len(window.y) * dt)
                flat = levels[k] < dt * (FEW_BINS * first_bin_rad_s) ** 4 * noise_var
                # the signal may lie in the lowest bins, which the spectrum leaves out
                if flat.any() and (DETREND_BINS * first_bin_rad_s) ** 4 > FLOOR / dt:
                    most = 16 * (FEW_BINS * first_bin_rad_s) ** 4 * dt
                    exact, _ = exact_levels(window, noise_var, True, most, 8)
                    clear = exact > CLEAR_FLOORS * FLOOR * noise_var
                    levels[k] = np.where(flat & clear, exact, levels[k])
            else:
                levels[k], _ = exact_levels(segment(record, a + skip, b, ()), noise_var, True)
        # a segment that is too short gets the largest level of the others
        largest = np.where(np.isfinite(levels), levels, -np.inf).max(axis=0)
        largest = np.where(np.isfinite(largest), largest, noise_var)
        levels = np.where(np.isfinite(levels), levels, largest)
    intensities = [Intensity(tuple(starts), tuple(level)) for level in levels.T]
    return intensities, noise_var


def _half_of_readings(record: Record, first: int, last: int) -> int:
    """Samples from ``first`` on that contain half of the readings before ``last``."""
    count = np.cumsum((record.weight[first:last] > 0).any(axis=1))
    return int(np.searchsorted(count, count[-1] / 2, side="right"))


def segment(record: Record, first: int, last: int, events: Sequence[float]) -> Record:
    """Some samples as a record whose clock starts at zero.

    Parameters
    ----------
    record
        The record.
    first, last
        First sample, and one past the last.
    events
        Times [s] on the clock of ``record``; those inside the samples become the events of the
        result.

    Notes
    -----
    A new field of ``tcdyn.smoothing.record.Record`` with one value a sample must be cut here, too.
    """
    shift = first * record.dt_s
    length = (last - first) * record.dt_s
    rows = slice(first, last)
    events_inside = tuple(e - shift for e in events if 0 <= e - shift < length)
    samples = {name: getattr(record, name)[rows] for name in ("y", "weight", "flags")}
    start = record.start if first == 0 else None
    late_s = None if record.late_s is None else record.late_s[rows]
    followed = tuple(lag and lag.within(rows) for lag in record.followed)
    return replace(
        record,
        **samples,
        events_s=events_inside,
        start=start,
        late_s=late_s,
        followed=followed,
    )


def smearing_time_s(record: Record) -> float:
    """Time [s] over which the slowest chain and the sampling smear an instantaneous change.

    It is the longest lag plus four samples. ``tests/smoothing/test_any_unit.py`` states this value.
    """
    return max(0.0, *(s.lag_s for s in record.sensors)) + 4 * record.dt_s


def channel_spans(record: Record, noise_var: Array) -> Array:
    """Range of each channel (M,) [K], at least ten standard deviations of the noise.

    It is the scale of changes and jumps, so that results are the same in any unit. Unlike
    ``tcdyn.smoothing.state_space.channel_ranges`` it includes interpolated samples and has a lower
    bound.
    """
    own = np.maximum(np.ptp(record.y, axis=0), record.least_range_K())
    return np.asarray(np.maximum(own, 10 * np.sqrt(noise_var)))


@dataclass(frozen=True)
class TradeoffCurve:
    """Misfit and roughness for each trial intensity (L trials, M channels), and the chosen one.

    Parameters
    ----------
    intensity
        Noise variance / weight (L, M) [K2/s3].
    misfit
        Mean square residual (L, M) [K2].
    roughness
        Integral of x''^2 (L, M) [K2/s3].
    effective_parameters
        Effective number of parameters (L, M): trace of the influence matrix.
    chosen
        Chosen intensity (M,) [K2/s3].
    criterion
        Criterion of the choice.
    """

    intensity: Array
    misfit: Array
    roughness: Array
    effective_parameters: Array
    chosen: Array
    criterion: str


def tradeoff_curve(record: Record, criterion: Criterion, trials: int) -> TradeoffCurve:
    """Misfit and roughness for several constant intensities, and the one that a criterion chooses.

    Parameters
    ----------
    record
        The record.
    criterion
        ``gcv``, ``discrepancy`` or ``l-curve``, see ``tcdyn.smoothing.smoother.deconvolve``.
    trials
        Number of intensities, evenly in their logarithm.

    Returns
    -------
    TradeoffCurve
        The trials and the choice.

    Notes
    -----
    The trials span 1e-4 to 1e7 noise variances per second cubed (chosen by judgement); a minimum at
    an end is returned as it is. The roughness is the sum of squared slope differences over the
    sampling interval, the effective number of parameters the sum of the prediction
    variances over the noise variance.
    """
    noise_var = record.noise_sd**2
    levels = np.geomspace(1e-4, 1e7, trials)
    rows = []
    w = record.weight
    n_samples = (record.weight > 0).sum(axis=0)
    for level in levels:
        constant = [Intensity.constant(level * var) for var in noise_var]
        fit = smooth_record(record, noise_var, constant)
        misfit = np.sum(w * (record.y - fit.predicted) ** 2, axis=0) / np.sum(w, axis=0)
        slope_changes = np.diff(fit.slope, axis=0) ** 2 / np.diff(fit.times_s)[:, None]
        effective_count = np.sum(w * fit.predicted_var, axis=0) / noise_var
        rows.append((misfit, np.sum(slope_changes, axis=0), effective_count))
    misfits, roughness, effective = (np.array(column) for column in zip(*rows))
    chosen = [
        _best_ratio(criterion, levels, *columns)
        for columns in zip(
            misfits.T, roughness.T, effective.T, n_samples.tolist(), noise_var.tolist()
        )
    ]
    return TradeoffCurve(
        levels[:, None] * noise_var,
        misfits,
        roughness,
        effective,
        np.array(chosen) * noise_var,
        criterion,
    )


def _best_ratio(
    criterion: Criterion,
    levels: Array,
    misfit: Array,
    roughness: Array,
    effective_count: Array,
    used: int,
    noise_var: float,
) -> float:
    """Ratio of intensity and noise variance that meets the criterion.

    Parameters
    ----------
    criterion
        The criterion.
    levels
        Ratios tried (L,) [1/s3].
    misfit, roughness, effective_count
        Mean square residual [K2], roughness [K2/s3] and effective number of parameters (L,).
    used
        Number of samples with weight.
    noise_var
        Noise variance [K2].

    Notes
    -----
    GCV (Golub, Heath and Wahba 1979) is interpolated between the trials by a parabola, the
    discrepancy by a straight line; the L-curve (Hansen 1992) takes the trial of the largest
    curvature, without the two trials at either end. ``tests/smoothing/test_any_unit.py`` states the
    choice for curves with a known optimum.
    """
    logs = np.log(levels)
    if criterion == "discrepancy":  # the misfit falls as the intensity rises
        return float(np.exp(np.interp(-np.log(noise_var), -np.log(misfit), logs)))
    if criterion == "gcv":
        score = np.log(misfit / (1 - effective_count / used) ** 2)
    else:
        a = np.log(misfit)
        b = np.log(np.maximum(roughness, 1e-300))
        da = np.gradient(a, logs)
        db = np.gradient(b, logs)
        curvature = (da * np.gradient(db, logs) - db * np.gradient(da, logs)) / (
            da**2 + db**2
        ) ** 1.5
        score = -np.abs(curvature)
        score[:2] = score[-2:] = np.inf
    k = int(np.argmin(score))
    if criterion == "l-curve" or k in (0, len(levels) - 1):
        return float(levels[k])
    c2, c1, _ = np.polyfit(logs[k - 1 : k + 2] - logs[k], score[k - 1 : k + 2], 2)
    return float(levels[k] * np.exp(np.clip(-c1 / (2 * c2), -1, 1)))
