"""Intensities of slope noise and level noise that change with time, by their likelihood.

Both are in the model of every record. The score of the smoother shows without another pass where
they are too small or too large: with right intensities ``gradient`` equals ``expected`` on average,
see ``Smoothed``. They follow in blocks of time as short as the data demand. Whether a record has
level noise at all is averaged over.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import compress, pairwise
from typing import NamedTuple

import numpy as np
from scipy.special import expit

from tcdyn.core import Array, Flags
from tcdyn.smoothing.corner import corner_rad_s
from tcdyn.smoothing.noise_levels import Intensity, level_noise_at
from tcdyn.smoothing.process_noise import FLOOR, has_hum, segment
from tcdyn.smoothing.record import MIN_GOOD_SAMPLES, Record
from tcdyn.smoothing.state_space import (
    Smoothed,
    SmoothedSamples,
    likelihood,
    predicted_readings,
    smooth_record,
)

# Values without a source below were chosen by judgement, and tried by tests/smoothing/band_study.py
# iterations of the intensities at most; they end where no block would gain so many nats
ITERATIONS = 16
SETTLED_NATS = 0.3
# largest factor of an intensity in one iteration
MAX_FACTOR = 10.0
# exponent of that factor: above one for speed, below two for stability
OVERRELAXATION = 1.6
# nats by which other intensities in some window must raise the likelihood of rows whose intensities
# were learned before: exp(-8) is the chance by which a channel is fitted again without need, so
# that a log of twelve channels seldom is (cost)
CHECK_NATS = 8.0
# Degrees of freedom of the prior that keeps an intensity from zero. With 1 the band of a drift
# below the noise covers 86 %, with 3 it covers 93 %: its readings determine about as many. Records
# that show their intensity do not change (test_hidden.py; row "drift" of band_study)
PRIOR_DOF = 3.0
# In a record of few lags they would be most of what it has to tell: at most so many in each lag.
# Chosen by judgement: a second of a constant temperature behind a lag of a second has a result
PRIOR_DOF_IN_LAG = 0.3
# nats that each further window of a block must gain for it to be divided in two; numbers of
# windows; and degrees of freedom of a half
SPLIT_NATS = 4.0
DIVISION_WINDOWS = (2, 8)
MIN_DOF = 4.0
# divisions of a block in two, one after the other, at most
MAX_DIVISIONS = 6
# windows of a record in which learned intensities are checked
CHECK_WINDOWS = 64
CHECK_SIZES = (1, 4, 16)  # windows that are checked together; divisors of their number
# parts of a long record from which intensities are estimated, and samples and lags of one at least;
# tests/smoothing/long_record_study.py measures what is lost
PARTS = 16
PART_SAMPLES = 8192
PART_LAGS = 10
# factors of the level noise from which the iteration may begin; it covers what is between
LEVEL_FACTORS = (1.0, 1e2, 1e4, 1e6, 1e8)
# smallest level noise, in noise variances per second
LEVEL_FLOOR = 1e-9
# factors of the intensity that are tried by the risk, and standard deviations by which it must fall
RISK_FACTORS = (0.3, 0.1, 0.03)
RISK_SD = 3.0
# the risk is tried where the corner frequency exceeds so many inverse lags: only there is much
# noise amplified
RISK_CORNER_LAGS = 3.0
# probability of no level noise below which a record is not smoothed again without it
LEAST_PROBABILITY = 0.01
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
        rounding_K=record.rounding_K[channels],
        followed=tuple(compress(record.followed, channels)),
    )


class Scores(NamedTuple):
    """Scores of the process noise at the times of a record, or of parts of it.

    Parameters
    ----------
    times_s
        Times (J,) [s] on the clock of the record.
    gradient, expected
        As those of ``Smoothed`` (J, M, 2).
    """

    times_s: Array
    gradient: Array
    expected: Array


def sampled_parts(record: Record) -> list[slice]:
    """Samples from which intensities are estimated: all of a record that is not long.

    Notes
    -----
    Of a long record, or of a long segment between its events, ``PARTS`` parts of equal distance.
    Each part is smoothed by itself, which makes its likelihood that of a record of its own.
    ``python -m tests.smoothing.long_record_study`` measures what is lost.
    """
    size = max(PART_SAMPLES, int(PART_LAGS * max(s.lag_s for s in record.sensors) / record.dt_s))
    count = len(record.y)
    if count <= 2 * PARTS * size:
        return [slice(0, count)]
    cuts = [0, *(int(np.ceil(event / record.dt_s)) for event in record.events_s), count]
    parts = []
    for first, last in pairwise(cuts):
        if last - first <= 2 * PARTS * size:
            parts.append(slice(first, last))
            continue
        edges = np.linspace(first, last, PARTS + 1)
        starts = np.round(0.5 * (edges[1:] + edges[:-1] - size)).astype(int)
        parts += [slice(start, start + size) for start in starts.tolist()]
    # a segment of hardly any sample shows nothing
    return [part for part in parts if part.stop - part.start >= MIN_GOOD_SAMPLES]


def _part_of(
    record: Record, part: slice, intensities: Sequence[Intensity]
) -> tuple[Record, list[Intensity]]:
    """A part of a record and the intensities on its clock."""
    if part == slice(0, len(record.y)):
        return record, list(intensities)
    window = segment(record, part.start, part.stop, record.events_s)
    return window, [q.shifted(shift_s=part.start * record.dt_s) for q in intensities]


def _scores(
    record: Record, parts: Sequence[slice], noise_var: Array, intensities: Sequence[Intensity]
) -> Scores:
    """Scores of intensities in parts of a record."""
    found = []
    for part in parts:
        window, shifted = _part_of(record, part, intensities)
        fit = smooth_record(window, noise_var, shifted)
        times_s = fit.times_s + part.start * record.dt_s
        found.append(Scores(times_s, fit.gradient, fit.expected))
    return Scores(*(np.concatenate(arrays) for arrays in zip(*found)))


def score_sums(
    scores: Scores | Smoothed, channel: int, edges_s: Array, weight: Array | float = 1.0
) -> tuple[Array, Array]:
    """Sums (K, 2) of ``gradient`` and ``expected`` of a channel over blocks.

    Parameters
    ----------
    scores
        The scores, or the smoothed record.
    channel
        Index of the channel.
    edges_s
        Starts of the blocks (K,) [s].
    weight
        Weight (J, 2) of the times, for level and slope noise. With the intensities as weights the
        second sum is the number of degrees of freedom of the process noise in a block, and the
        ratio of the sums tells by which factor all of it should change.
    """
    count = len(edges_s)
    block = np.clip(np.searchsorted(edges_s, scores.times_s, side="left") - 1, 0, count - 1)
    observed, expected = np.zeros((2, count, 2))
    for total, score in ((observed, scores.gradient), (expected, scores.expected)):
        for kind, column in enumerate((weight * score[:, channel]).T):
            total[:, kind] = np.bincount(block, column, count)
    return observed, np.maximum(expected, 1e-300)


def gain_nats(dof: Array, ratio: Array) -> Array:
    """Log likelihood gained, about, by the right intensity in place of one that is wrong by
    ``ratio``.

    ``dof`` is the number of degrees of freedom that the data determine.
    """
    bounded = np.maximum(ratio, 1e-6)
    return np.asarray(0.5 * dof * (bounded - 1 - np.log(bounded)))


def changes_in_time(fit: Smoothed) -> Flags:
    """Channels (M,) whose likelihood rises with more process noise in a window.

    Parameters
    ----------
    fit
        The smoothed record.

    Notes
    -----
    The gain of a window follows from the degrees of freedom of its process noise, changes included,
    and from the ratio by which that noise should rise. ``CHECK_NATS`` plus the logarithm of the
    number of windows allows for the choice of the best window.
    """
    times_s = fit.times_s
    windows = np.linspace(times_s[0], times_s[-1], CHECK_WINDOWS, endpoint=False)
    out = np.zeros(len(fit.intensities), dtype=bool)
    for c, q in enumerate(fit.intensities):
        weight = np.stack([level_noise_at([q], times_s)[0], q.at(times_s)], axis=1)
        observed, dof = score_sums(fit, c, windows, weight)
        for size in CHECK_SIZES:
            total = observed.reshape(-1, size, 2).sum(axis=1)
            total_dof = dof.reshape(-1, size, 2).sum(axis=1)
            gain = gain_nats(total_dof, np.maximum(total / total_dof, 1.0))
            if gain.max() > CHECK_NATS + np.log(gain.size):
                out[c] = True
    return out


def adapt_intensities(
    record: Record,
    noise_var: Array,
    intensities: Sequence[Intensity],
    parts: Sequence[slice],
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
        Intensity of each channel to start from; its changes remain, its segments are the first
        blocks.
    parts
        The samples whose likelihood counts, see ``sampled_parts``.
    divisions
        How often a block may be divided in two.

    Notes
    -----
    An intensity is multiplied by the ratio of the sums of ``gradient`` and ``expected`` in its
    block, which is one where the likelihood has its maximum (MacKay 1992). A prior of ``PRIOR_DOF``
    degrees of freedom keeps it from zero. A block is divided where its windows disagree.
    """
    current = list(intensities)
    for c, q in enumerate(intensities):
        if not q.level_noise:
            current[c] = _with_level_noise(record, c, float(noise_var[c]), q, parts)
    end_s = (len(record.y) - 1) * record.dt_s
    for division in range(divisions + 1):
        for _ in range(ITERATIONS if division == 0 else ITERATIONS // 2):
            scores = _scores(record, parts, noise_var, current)
            updated = [
                _update_intensity(scores, c, q, end_s, float(noise_var[c]), record.sensors[c].lag_s)
                for c, q in enumerate(current)
            ]
            if max(gain for _, gain in updated) < SETTLED_NATS:
                break
            current = [q for q, _ in updated]
        divided = [_divide_blocks(scores, c, q, end_s) for c, q in enumerate(current)]
        if division == divisions or divided == current:
            break
        current = divided
    return current


def _with_level_noise(
    record: Record, channel: int, noise_var: float, intensity: Intensity, parts: Sequence[slice]
) -> Intensity:
    """The likeliest of some level noises, from which the iteration begins.

    Notes
    -----
    The smallest one has the power of the least slope noise at the corner of the smoother. The
    likelihood of a wave has two maxima, of which an iteration finds the nearer one; with hum, which
    is noise, that of the smallest one is right.
    """
    levels = np.array(intensity.levels)
    corner = corner_rad_s(record.chains[channel], levels / (noise_var * record.dt_s))
    smallest = float(np.min(levels / corner**2))
    candidates = [
        replace(intensity, level_noise=(factor * smallest,) * len(levels))
        for factor in (LEVEL_FACTORS[:1] if has_hum(record) else LEVEL_FACTORS)
    ]
    alone = np.arange(len(record.chains)) == channel
    of_channel = select_channels(record, alone)
    total = np.zeros(len(candidates))
    for part in parts:
        window, shifted = _part_of(of_channel, part, candidates)
        value, _ = likelihood(window, np.array([noise_var]), [shifted])
        total += value[0]
    return candidates[int(np.argmax(total))]


def _update_intensity(
    scores: Scores,
    channel: int,
    intensity: Intensity,
    end_s: float,
    noise_var: float,
    lag_s: float,
) -> tuple[Intensity, float]:
    """Multiply the intensity of each block by the factor that the scores ask for.

    Parameters
    ----------
    scores
        Scores of the present intensities.
    channel
        Index of the channel.
    intensity
        Its intensity.
    end_s
        End of the record [s].
    noise_var, lag_s
        Noise variance [K2] and lag [s] of the channel.

    Returns
    -------
    intensity
        The intensity after one iteration; no factor exceeds ``MAX_FACTOR``.
    gain
        Largest gain of a block in log likelihood [nats].
    """
    observed, expected = score_sums(scores, channel, np.array(intensity.starts_s))
    var = np.column_stack([intensity.level_noise, intensity.levels])
    dof = np.maximum(var * expected, 1e-3)
    durations = np.diff(np.append(intensity.starts_s, end_s))
    total_dof = min(PRIOR_DOF, PRIOR_DOF_IN_LAG * end_s / max(lag_s, 1e-300))
    prior_dof = total_dof * np.clip(durations / durations.sum(), 0.0, 1.0)
    with np.errstate(over="ignore"):  # the factor is limited
        ratio = observed / expected + prior_dof[:, None] / dof
    factor = np.clip(ratio**OVERRELAXATION, 1 / MAX_FACTOR, MAX_FACTOR)
    gain = float(np.max(gain_nats(dof, ratio)))
    floors = np.array([LEVEL_FLOOR, FLOOR]) * noise_var
    level_noise, levels = np.maximum(var * factor, floors).T
    updated = replace(
        intensity, levels=tuple(levels.tolist()), level_noise=tuple(level_noise.tolist())
    )
    return updated, gain


def _divide_blocks(scores: Scores, channel: int, intensity: Intensity, end_s: float) -> Intensity:
    """Divide those blocks of an intensity whose windows disagree by ``SPLIT_NATS`` each.

    Halves alone would not show what lies across the middle of a block.

    Parameters
    ----------
    scores
        Scores of the present intensities.
    channel
        Index of the channel.
    intensity
        Its intensity. Halves with fewer than ``MIN_DOF`` degrees of freedom are not divided.
    end_s
        End of the record [s].
    """
    starts = np.array(intensity.starts_s)
    ends = np.append(starts[1:], end_s)
    middles = 0.5 * (starts + ends)
    var = np.column_stack([intensity.level_noise, intensity.levels])
    divide = np.zeros(len(starts), dtype=bool)
    for windows in DIVISION_WINDOWS:
        edges = starts[:, None] + (ends - starts)[:, None] * np.arange(windows) / windows
        observed, expected = score_sums(scores, channel, edges.ravel())
        dof = np.repeat(var, windows, axis=0) * expected
        gain = gain_nats(dof, observed / expected).reshape(len(starts), -1).sum(axis=1)
        of_halves = dof.sum(axis=1).reshape(len(starts), 2, -1).sum(axis=2)
        enough = of_halves.min(axis=1) > MIN_DOF
        divide |= (gain > SPLIT_NATS * (windows - 1)) & enough
    copies = np.where(divide, 2, 1)
    return replace(
        intensity,
        starts_s=tuple(np.sort(np.concatenate([starts, middles[divide]])).tolist()),
        levels=tuple(np.repeat(intensity.levels, copies).tolist()),
        level_noise=tuple(np.repeat(intensity.level_noise, copies).tolist()),
    )


def _scaled(intensity: Intensity, factor: float) -> Intensity:
    """An intensity whose slope noise and level noise, but not its changes, have another factor."""
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
    """Smooth again with level noise and intensities that are adapted to the record.

    Parameters
    ----------
    fit
        The smoothed record.
    divisions
        As of ``adapt_intensities``.
    are_learned
        Whether the intensities were learned from more rows than these. Then only those channels
        are adapted whose readings contradict them.

    Notes
    -----
    The intensities of a long record come from parts of it. Where all of its readings contradict
    them, they are estimated again from all.
    """
    whole = [slice(0, len(fit.record.y))]
    parts = sampled_parts(fit.record)
    if not are_learned:
        every_channel = np.ones(len(fit.intensities), dtype=bool)
        fit = _adapted(fit, every_channel, divisions, parts)
    if are_learned or parts != whole:
        fit = _adapted(fit, changes_in_time(fit), divisions, whole)
    return fit


def _adapted(fit: Smoothed, channels: Flags, divisions: int, parts: Sequence[slice]) -> Smoothed:
    """The record smoothed with adapted intensities of some channels (M,)."""
    if not channels.any():
        return fit
    chosen = [q for q, use in zip(fit.intensities, channels) if use]
    record = select_channels(fit.record, channels)
    intensities = list(fit.intensities)
    rougher = adapt_intensities(record, fit.noise_var[channels], chosen, parts, divisions)
    for index, q in zip(np.flatnonzero(channels).tolist(), rougher):
        intensities[index] = q
    return smooth_record(fit.record, fit.noise_var, intensities)


def smooth_probability(fit: Smoothed) -> Array:
    """Probability (M,) that no noise drives the temperature itself.

    Notes
    -----
    That of the likelihoods of a record with and without its level noise, which were equally
    probable before. Level noise that a record does not need has ``PRIOR_DOF`` degrees of freedom,
    which makes a smooth record less likely.
    """
    pairs = [[q, replace(q, level_noise=())] for q in fit.intensities]
    value, _ = likelihood(fit.record, fit.noise_var, pairs)
    return np.asarray(expit(value[:, 1] - value[:, 0]))


def averaged_over_level_noise(
    fit: Smoothed, samples: SmoothedSamples, probability: Array
) -> SmoothedSamples:
    """Samples of a record averaged over whether noise drives the temperature itself.

    Parameters
    ----------
    fit
        The smoothed record, with level noise.
    samples
        Its samples.
    probability
        The ``smooth_probability`` (M,).

    Notes
    -----
    The variance is the mean of the variances plus the variance of the means (law of total
    variance).
    """
    some = probability > LEAST_PROBABILITY
    if not some.any():
        return samples
    without = [replace(q, level_noise=()) for q in compress(fit.intensities, some)]
    record = select_channels(fit.record, some)
    other = smooth_record(record, fit.noise_var[some], without).at_samples()
    share = probability[some]
    mixed = [column.copy() for column in samples]
    for column, of_other in zip(mixed, other):
        column[:, some] += share * (of_other - column[:, some])
    temperature, sd, slope, slope_sd, lag_sensitivity, split_sensitivity = mixed
    for out, mean, own_sd, other_mean, other_sd in (
        (sd, samples.temperature, samples.sd, other.temperature, other.sd),
        (slope_sd, samples.slope, samples.slope_sd, other.slope, other.slope_sd),
    ):
        change = other_mean - mean[:, some]
        var = (1 - share) * own_sd[:, some] ** 2 + share * other_sd**2
        out[:, some] = np.sqrt(var + share * (1 - share) * change**2)
    return SmoothedSamples(temperature, sd, slope, slope_sd, lag_sensitivity, split_sensitivity)


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
