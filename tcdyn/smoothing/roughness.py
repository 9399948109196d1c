"""Level noise and intensities that change with time, where the data show that one smooth prior is
not enough.

The score of the smoother shows without another pass where a prior is too smooth or too rough: with
right intensities ``gradient`` equals ``expected`` on average, see ``Smoothed``. Where it does not,
the intensities of slope noise and level noise follow by their likelihood, in blocks of time as
short as the data demand.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import compress

import numpy as np

from tcdyn.chain import Chain
from tcdyn.core import Array, Flags
from tcdyn.smoothing.corner import corner_rad_s
from tcdyn.smoothing.noise_levels import Intensity, level_noise_at
from tcdyn.smoothing.process_noise import FLOOR
from tcdyn.smoothing.record import Record
from tcdyn.smoothing.state_space import Smoothed, predicted_readings, smooth_record

# Values without a source below were chosen by judgement, and tried by tests/smoothing/band_study.py
# iterations of the intensities at most; they end where no block would gain so many nats
ITERATIONS = 16
SETTLED_NATS = 0.3
# largest factor of an intensity in one iteration
MAX_FACTOR = 10.0
# exponent of that factor: above one for speed, below two for stability
OVERRELAXATION = 1.6
# nats by which other intensities in some window must raise the likelihood of a record before they
# are fitted: exp(-8) is the chance by which a channel is fitted without need,
# so that a log of twelve channels seldom is (cost)
CHECK_NATS = 8.0
# standard deviations by which the likelihood must rise with level noise; time in which scores count
# as one, over the inverse of the corner frequency of the smoother; and degrees of freedom up to
# which any rise counts
LEVEL_SD = 1.0
CORRELATED = 2.0
FEW_DOF = 15.0
# degrees of freedom of the prior that keeps an intensity from zero
PRIOR_DOF = 1.0
# nats by which two halves of a block must differ to be divided, and degrees of freedom of a half
SPLIT_NATS = 4.0
MIN_DOF = 4.0
# divisions of a block in two, one after the other, at most
MAX_DIVISIONS = 6
# windows of a record in which its prior is checked
CHECK_WINDOWS = 64
CHECK_SIZES = (1, 4, 16)  # windows that are checked together; divisors of their number
# smallest level noise, in noise variances per second
LEVEL_FLOOR = 1e-9
# factors of the intensity that are tried by the risk, and standard deviations by which it must fall
RISK_FACTORS = (0.3, 0.1, 0.03)
RISK_SD = 3.0
# the risk is tried where the corner frequency exceeds so many inverse lags: only there is much
# noise amplified
RISK_CORNER_LAGS = 3.0
# exponents of the spectrum of a rough temperature that are tried, the last is that of level noise;
# those of smaller weight are left out
EXPONENTS = np.linspace(0.5, 2.0, 16)
MIN_EXPONENT_WEIGHT = 1e-3
# the spectrum is used from this share of the corner frequency on; fewest frequencies
SPECTRUM_START = 0.2
MIN_FREQUENCIES = 50
# bands in which the spectrum is averaged, at most
MAX_BANDS = 200
# Frequency, in corner frequencies, at which the readings show how strong slope noise and level
# noise are together, but not which of them it is: the middle of those below the corner. Without
# what that may be, the band of the rate of a random walk is too narrow
# (tests/smoothing/rate_study.py: 85 % instead of 98 %).
SHAPE_SHARE = 0.5
# degrees of freedom up to which the uncertainty of an intensity widens the band noticeably
FEW_DOF_OF_BAND = 30.0


def select_channels(record: Record, channels: Flags) -> Record:
    """The record with those of its channels that ``channels`` (M,) marks."""
    start = record.start
    if start is not None:
        start = replace(
            start,
            means=tuple(compress(start.means, channels)),
            factors=tuple(compress(start.factors, channels)),
            range_K=start.range_K[channels],
        )
    return replace(
        record,
        start=start,
        y=record.y[:, channels],
        weight=record.weight[:, channels],
        flags=record.flags[:, channels],
        chains=tuple(c for c, use in zip(record.chains, channels) if use),
        sensors=tuple(s for s, use in zip(record.sensors, channels) if use),
        noise_sd=record.noise_sd[channels],
        aliasing_u_K=record.aliasing_u_K[channels],
    )


def score_sums(
    fit: Smoothed, channel: int, edges_s: Array, weight: Array | float = 1.0
) -> tuple[Array, Array]:
    """Sums (K, 2) of ``gradient`` and ``expected`` of a channel over blocks.

    Parameters
    ----------
    fit
        The smoothed record.
    channel
        Index of the channel.
    edges_s
        Starts of the blocks (K,) [s].
    weight
        Weight (J, 2) of the times, for level and slope noise. With the intensities as weights the
        second sum is the number of degrees of freedom of the process noise in a block, and the
        ratio of the sums tells by which factor all of it should change.
    """
    block = np.searchsorted(edges_s, fit.times_s, side="left") - 1
    block = np.clip(block, 0, len(edges_s) - 1)
    observed, expected = np.zeros((2, len(edges_s), 2))
    np.add.at(observed, block, weight * fit.gradient[:, channel])
    np.add.at(expected, block, weight * fit.expected[:, channel])
    return observed, np.maximum(expected, 1e-300)


def gain_nats(dof: Array, ratio: Array) -> Array:
    """Log likelihood gained, about, by the right intensity in place of one that is wrong by
    ``ratio``.

    ``dof`` is the number of degrees of freedom that the data determine.
    """
    bounded = np.maximum(ratio, 1e-6)
    return np.asarray(0.5 * dof * (bounded - 1 - np.log(bounded)))


def too_smooth(fit: Smoothed, are_learned: bool = False) -> Flags:
    """Channels (M,) whose likelihood rises with level noise, or with more noise in a window.

    Parameters
    ----------
    fit
        The smoothed record.
    are_learned
        Whether its intensities were learned from more rows than these. Then level noise that all
        rows show was found there, and only windows are looked at.

    Notes
    -----
    The gain of a window follows from the degrees of freedom of its process noise, bursts included,
    and from the ratio by which that noise should rise. ``CHECK_NATS`` plus the logarithm of the
    number of windows allows for the choice of the best window.
    """
    times_s = fit.times_s
    windows = np.linspace(times_s[0], times_s[-1], CHECK_WINDOWS, endpoint=False)
    out = np.zeros(len(fit.intensities), dtype=bool)
    for c, q in enumerate(fit.intensities):
        level_noise = level_noise_at([q], times_s)[0]
        if not q.level_noise:
            segment = np.maximum(np.searchsorted(q.starts_s, times_s, side="right") - 1, 0)
            density = fit.noise_var[c] * fit.record.dt_s
            first_level_noise = _first_level_noise(q, fit.record.chains[c], density)
            level_noise = level_noise + first_level_noise[segment]
        weight = np.stack([level_noise, q.at(times_s)], axis=1)
        observed, dof = score_sums(fit, c, windows, weight)
        is_checked = not are_learned and not q.level_noise
        if is_checked and _shows_level_noise(fit, c, float(dof[:, 0].sum())):
            out[c] = True
            continue
        for size in CHECK_SIZES:
            total = observed.reshape(-1, size, 2).sum(axis=1)
            total_dof = dof.reshape(-1, size, 2).sum(axis=1)
            gain = gain_nats(total_dof, np.maximum(total / total_dof, 1.0))
            if gain.max() > CHECK_NATS + np.log(gain.size):
                out[c] = True
    return out


def _shows_level_noise(fit: Smoothed, channel: int, dof: float) -> bool:
    """Whether the likelihood rises with level noise, by more than chance.

    Parameters
    ----------
    fit
        Smoothed record without level noise in this channel.
    channel
        Index of the channel.
    dof
        Degrees of freedom of level noise that has the power of the slope noise at the corner.

    Notes
    -----
    Twice the derivative of the log likelihood by the intensity is the sum of ``gradient`` less
    ``expected``. If there is no level noise its variance is 2 sum ``expected``^2 for independent
    samples; those within ``CORRELATED`` count as one. A record of few degrees of freedom cannot
    pass such a test, but its band depends on the prior, so there any rise counts.
    """
    expected = fit.expected[:, channel, 0]
    rise = float(np.sum(fit.gradient[:, channel, 0] - expected))
    dt = fit.record.dt_s
    ratio = np.median(fit.intensities[channel].at(fit.times_s)) / (fit.noise_var[channel] * dt)
    corner = float(corner_rad_s(fit.record.chains[channel], ratio))
    correlated = max(CORRELATED / (corner * dt), 1.0)
    sd = float(np.sqrt(2 * correlated * np.sum(expected**2)))
    return rise > (LEVEL_SD * sd if dof > FEW_DOF else 0.0)


def adapt_intensities(
    record: Record,
    noise_var: Array,
    intensities: Sequence[Intensity],
    divisions: int = MAX_DIVISIONS,
) -> list[Intensity]:
    """Estimate intensities with level noise in blocks of time by maximum likelihood.

    Parameters
    ----------
    record
        The record.
    noise_var
        Noise variance (M,) [K2].
    intensities
        Intensity of each channel to start from; its bursts remain, its segments are the first
        blocks.
    divisions
        How often a block may be divided in two.

    Notes
    -----
    An intensity is multiplied by the ratio of the sums of ``gradient`` and ``expected`` in its
    block, which is one where the likelihood has its maximum (MacKay 1992). A prior of ``PRIOR_DOF``
    degrees of freedom keeps it from zero. A block is divided where its halves disagree.
    """
    current: list[Intensity] = []
    for chain, var, q in zip(record.chains, noise_var, intensities):
        if not q.level_noise:
            level_noise = _first_level_noise(q, chain, var * record.dt_s)
            q = replace(q, level_noise=tuple(level_noise.tolist()))
        current.append(q)
    for division in range(divisions + 1):
        for _ in range(ITERATIONS if division == 0 else ITERATIONS // 2):
            fit = smooth_record(record, noise_var, current)
            updated = [_update_intensity(fit, c, q) for c, q in enumerate(current)]
            if max(gain for _, gain in updated) < SETTLED_NATS:
                break
            current = [q for q, _ in updated]
        divided = [_divide_blocks(fit, c, q) for c, q in enumerate(current)]
        if division == divisions or divided == current:
            break
        current = divided
    return current


def _first_level_noise(intensity: Intensity, chain: Chain, noise_density: float) -> Array:
    """Intensity of level noise (S,) [K2/s] in each segment of a channel with slope noise only.

    At the corner of the smoother it has the power of the slope noise. ``noise_density`` is the
    noise variance times the sampling interval [K2 s].
    """
    levels = np.array(intensity.levels)
    return np.asarray(levels / corner_rad_s(chain, levels / noise_density) ** 2)


def _update_intensity(fit: Smoothed, channel: int, intensity: Intensity) -> tuple[Intensity, float]:
    """Multiply the intensity of each block by the factor that the scores ask for.

    Parameters
    ----------
    fit
        Record smoothed with the present intensities.
    channel
        Index of the channel.
    intensity
        Its intensity.

    Returns
    -------
    intensity
        The intensity after one iteration; no factor exceeds ``MAX_FACTOR``.
    gain
        Largest gain of a block in log likelihood [nats].
    """
    observed, expected = score_sums(fit, channel, np.array(intensity.starts_s))
    var = np.column_stack([intensity.level_noise, intensity.levels])
    dof = np.maximum(var * expected, 1e-3)
    durations = np.diff(np.append(intensity.starts_s, fit.times_s[-1]))
    prior_dof = PRIOR_DOF * np.clip(durations / durations.sum(), 0.0, 1.0)
    with np.errstate(over="ignore"):  # the factor is limited
        ratio = observed / expected + prior_dof[:, None] / dof
    factor = np.clip(ratio**OVERRELAXATION, 1 / MAX_FACTOR, MAX_FACTOR)
    gain = float(np.max(gain_nats(dof, ratio)))
    floors = np.array([LEVEL_FLOOR, FLOOR]) * fit.noise_var[channel]
    level_noise, levels = np.maximum(var * factor, floors).T
    updated = replace(
        intensity, levels=tuple(levels.tolist()), level_noise=tuple(level_noise.tolist())
    )
    return updated, gain


def _divide_blocks(fit: Smoothed, channel: int, intensity: Intensity) -> Intensity:
    """Divide those blocks of an intensity whose halves disagree by ``SPLIT_NATS``.

    Parameters
    ----------
    fit
        Record smoothed with the present intensities.
    channel
        Index of the channel.
    intensity
        Its intensity. Halves with fewer than ``MIN_DOF`` degrees of freedom are not divided.
    """
    starts = np.array(intensity.starts_s)
    middles = 0.5 * (starts + np.append(starts[1:], fit.times_s[-1]))
    observed, expected = score_sums(fit, channel, np.column_stack([starts, middles]).ravel())
    var = np.repeat(np.column_stack([intensity.level_noise, intensity.levels]), 2, axis=0)
    dof = var * expected
    gain = gain_nats(dof, observed / expected).reshape(len(starts), -1).sum(axis=1)
    enough = dof.sum(axis=1).reshape(-1, 2).min(axis=1) > MIN_DOF
    divide = (gain > SPLIT_NATS) & enough
    copies = np.where(divide, 2, 1)
    return replace(
        intensity,
        starts_s=tuple(np.sort(np.concatenate([starts, middles[divide]])).tolist()),
        levels=tuple(np.repeat(intensity.levels, copies).tolist()),
        level_noise=tuple(np.repeat(intensity.level_noise, copies).tolist()),
    )


def _scaled(intensity: Intensity, factor: float) -> Intensity:
    """An intensity whose slope noise and level noise, but not its bursts, have another factor."""
    return replace(
        intensity,
        levels=tuple(v * factor for v in intensity.levels),
        level_noise=tuple(v * factor for v in intensity.level_noise),
    )


def with_least_risk(fit: Smoothed) -> Smoothed:
    """Smooth again with smaller intensities in those blocks where the predicted readings become
    clearly better.

    A signal of one frequency has no power elsewhere, and the intensity of the most likely prior is
    too large for it.

    Notes
    -----
    The risk is Mallows' Cp: sum (residual^2 + 2 predicted_var) / noise_var, an unbiased estimate of
    the squared error of the predicted readings. Its difference between two fits has about twice the
    difference of their effective parameters as its variance.
    """
    record = fit.record
    dt = record.dt_s
    freedom = (record.weight * fit.predicted_var).sum(axis=0) / fit.noise_var
    corners = np.pi * freedom / (len(record.y) * dt)
    if (corners * [s.lag_s for s in record.sensors] < RISK_CORNER_LAGS).all():
        return fit
    factors = [np.ones(len(q.levels)) for q in fit.intensities]
    blocks = [
        np.searchsorted(q.starts_s, np.arange(len(record.y)) * dt, side="right") - 1
        for q in fit.intensities
    ]

    def risks(predicted: Array, predicted_var: Array) -> list[tuple[Array, Array]]:
        """Risk and effective parameters of each block, for each channel."""
        square = record.weight * (record.y - predicted) ** 2 / fit.noise_var
        freedom = record.weight * predicted_var / fit.noise_var
        out = []
        for c, block in enumerate(blocks):
            risk = np.bincount(block, square[:, c] + 2 * freedom[:, c], len(factors[c]))
            effective = np.bincount(block, freedom[:, c], len(factors[c]))
            out.append((np.asarray(risk, dtype=float), np.asarray(effective, dtype=float)))
        return out

    first = risks(fit.predicted, fit.predicted_var)
    best = [risk.copy() for risk, _ in first]
    best_total = [float(risk.sum()) for risk, _ in first]
    totals = np.ones(len(factors))
    for scale in RISK_FACTORS:
        scaled = [_scaled(q, scale) for q in fit.intensities]
        trial = risks(*predicted_readings(record, fit.noise_var, scaled))
        for c, (risk, freedom) in enumerate(trial):
            start_risk, start_freedom = first[c]
            saved = np.maximum(start_freedom - freedom, 0.0)
            better = (risk < best[c]) & (risk < start_risk - RISK_SD * np.sqrt(2 * saved))
            factors[c][better] = scale
            best[c] = np.where(better, risk, best[c])
            limit = start_risk.sum() - RISK_SD * np.sqrt(2 * saved.sum())
            if risk.sum() < min(limit, best_total[c]):
                totals[c] = scale
                best_total[c] = float(risk.sum())
    for c, total in enumerate(totals.tolist()):
        # a block follows the record where it shows nothing by itself
        factors[c] = np.where(factors[c] == 1, total, factors[c])
    if all((f == 1).all() for f in factors):
        return fit
    chosen = [
        replace(
            q,
            levels=tuple((np.array(q.levels) * f).tolist()),
            level_noise=tuple((np.array(q.level_noise) * f).tolist()) if q.level_noise else (),
        )
        for q, f in zip(fit.intensities, factors)
    ]
    return smooth_record(record, fit.noise_var, chosen)


def refine(fit: Smoothed, divisions: int = MAX_DIVISIONS, *, are_learned: bool = False) -> Smoothed:
    """Smooth again with adapted intensities of the channels whose prior is too smooth.

    Parameters
    ----------
    fit
        The smoothed record.
    divisions
        As of ``adapt_intensities``.
    are_learned
        As of ``too_smooth``.
    """
    channels = too_smooth(fit, are_learned)
    if not channels.any():
        return fit
    chosen = [q for q, use in zip(fit.intensities, channels) if use]
    record = select_channels(fit.record, channels)
    intensities = list(fit.intensities)
    rougher = adapt_intensities(record, fit.noise_var[channels], chosen, divisions)
    for index, q in zip(np.flatnonzero(channels).tolist(), rougher):
        intensities[index] = q
    return smooth_record(fit.record, fit.noise_var, intensities)


def degrees_of_freedom(fit: Smoothed) -> Array:
    """Degrees of freedom (M,) of the process noise that the readings determine."""
    times_s = fit.times_s
    dof = np.zeros(len(fit.intensities))
    for c, q in enumerate(fit.intensities):
        weight = np.stack([level_noise_at([q], times_s)[0], q.at(times_s)], axis=1)
        _, expected = score_sums(fit, c, times_s[:1], weight)
        dof[c] = expected.sum()
    return dof


def intensity_var(fit: Smoothed, dof: Array) -> tuple[Array, Array]:
    """Variance that the band misses because its intensities are estimates.

    Parameters
    ----------
    fit
        The smoothed record.
    dof
        ``degrees_of_freedom`` (M,) of the record from which the intensities were estimated.

    Returns
    -------
    var, slope_var
        Of the temperature (N, M) [K2] and of its rate of change [K2/s2].

    Notes
    -----
    Of d degrees of freedom of the process noise, the logarithm of an intensity has the standard
    deviation u = sqrt(2 / d). The result is the rise of the variance for exp(u) times the intensity
    and the square of the change of the estimate. It is zero where d exceeds
    ``FEW_DOF_OF_BAND``.
    """
    few = dof < FEW_DOF_OF_BAND
    var, slope_var = np.zeros((2, *fit.predicted.shape))
    if not few.any():
        return var, slope_var
    factors = np.exp(np.sqrt(2 / np.maximum(dof[few], 1.0))).tolist()
    chosen = [q for q, use in zip(fit.intensities, few) if use]
    higher = [_scaled(q, factor) for q, factor in zip(chosen, factors)]
    record = select_channels(fit.record, few)
    samples = fit.at_samples()
    rougher = smooth_record(record, fit.noise_var[few], higher).at_samples()
    rise = np.maximum(rougher.sd**2 - samples.sd[:, few] ** 2, 0.0)
    change_K = rougher.temperature - samples.temperature[:, few]
    var[:, few] = rise + change_K**2
    slope_rise = np.maximum(rougher.slope_sd**2 - samples.slope_sd[:, few] ** 2, 0.0)
    slope_var[:, few] = slope_rise + (rougher.slope - samples.slope[:, few]) ** 2
    return var, slope_var


def unresolved_var(fit: Smoothed) -> tuple[Array, Array]:
    """Variance that the band of a rough temperature misses, up to half the sampling rate.

    The spectrum of level noise falls as w^-2. That of a temperature may fall more slowly above the
    corner of the smoother, where the readings show nothing of it.

    Returns
    -------
    var, slope_var
        Of the temperature (M,) [K2], and of its mean rate of change over one sampling interval
        [K2/s2].

    Notes
    -----
    S(w) = A w^-b is fitted to the periodogram around and above the corner by Whittle's likelihood.
    The result is the mean square error of the Wiener filter, the integral of S R dt / (|G|^2 S +
    R dt) dw / pi, averaged over the exponents with their likelihoods as weights, less that for
    b = 2. The rate of change over one sampling interval is the temperature through a filter of the
    gain 2 sin(w dt / 2) / dt.
    """
    record = fit.record
    even = record.at_samples()
    n = len(record.y)
    dt = record.dt_s
    var_of_channel = np.zeros((2, len(fit.intensities)))
    taper = np.hanning(n + 1)[:-1]
    taper = taper / np.linalg.norm(taper)
    w = 2 * np.pi * np.fft.rfftfreq(n, dt)[1:]
    squared_gains = np.stack([np.ones(len(w)), (2 * np.sin(0.5 * w * dt) / dt) ** 2])
    for c, (chain, q, var) in enumerate(zip(record.chains, fit.intensities, fit.noise_var)):
        if not q.level_noise:
            continue
        ratio = float(np.median(q.level_noise)) / (var * dt)
        corner = float(corner_rad_s(chain, np.array(ratio), 1))
        slope_corner = corner_rad_s(chain, np.array(float(np.median(q.levels)) / (var * dt)))
        first = max(int(np.searchsorted(w, SPECTRUM_START * corner)), 1)
        last = int(0.9 * len(w))
        if slope_corner > corner or last - first < MIN_FREQUENCIES:
            continue
        y = even[:, c] - np.interp(np.arange(n), [0, n - 1], even[[0, -1], c])
        power = np.abs(np.fft.rfft(y * taper)[1:]) ** 2
        gain = np.abs(chain.frequency_response(w / (2 * np.pi))) ** 2 / dt
        # bands of one width in log frequency: the spectra are smooth
        band = np.unique(np.geomspace(first, last, MAX_BANDS + 1).astype(int))
        count = np.diff(band)
        mean_power = np.add.reduceat(power[:last], band[:-1]) / count
        mean_gain = np.add.reduceat(gain[:last], band[:-1]) / count
        mean_w = np.add.reduceat(w[:last], band[:-1]) / count
        scales = ratio * var * dt * corner ** (EXPONENTS - 2) * np.geomspace(0.01, 100, 61)[:, None]
        expected = var + mean_gain * scales[..., None] * mean_w ** -EXPONENTS[:, None]
        cost = (count * (np.log(expected) + mean_power / expected)).sum(axis=-1)
        best = np.argmin(cost, axis=0)
        costs = np.min(cost, axis=0)
        weights = np.exp(costs.min() - costs)
        weights /= weights.sum()
        missed = np.zeros((2, len(EXPONENTS)))
        for index in np.unique([*np.flatnonzero(weights > MIN_EXPONENT_WEIGHT), len(weights) - 1]):
            spectrum = scales[best[index], index] * w ** -EXPONENTS[index]
            error = spectrum * var / (gain * spectrum + var)
            missed[:, index] = squared_gains @ error * (w[1] - w[0]) / np.pi
        var_of_channel[:, c] = np.maximum(missed @ weights - missed[:, -1], 0.0)
    return var_of_channel[0], var_of_channel[1]


def unseen_slope_var(fit: Smoothed) -> Array:
    """Variance (N, M) [K2/s2] of the rate of change by noise that is not seen to drive the level.

    In a record with level noise, the readings do not show whether what is ascribed to slope noise
    is level noise, too: both have one power below the corner of the smoother. Above it they part,
    and the rate of change over one sampling interval depends on that.

    Notes
    -----
    Slope noise of the intensity q has at the frequency w the power of level noise of q / w^2. That
    of ``SHAPE_SHARE`` of the corner is taken for level noise, as far as there is level noise at the
    corner. In one sampling interval dt, level noise p adds the variance p / dt.
    """
    record = fit.record
    out = np.zeros_like(fit.predicted)
    time_s = np.arange(len(out)) * record.dt_s
    for c, (chain, q, var) in enumerate(zip(record.chains, fit.intensities, fit.noise_var)):
        if not q.level_noise:
            continue
        at_corner = _first_level_noise(q, chain, var * record.dt_s)
        unseen = np.minimum(at_corner, q.level_noise) / SHAPE_SHARE**2
        segment = np.maximum(np.searchsorted(q.starts_s, time_s, side="right") - 1, 0)
        out[:, c] = unseen[segment] / record.dt_s
    return out
