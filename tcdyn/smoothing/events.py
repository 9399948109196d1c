"""Events that the readings show: kinks and jumps of the temperature, and steps of the reading.

One score answers what happened, when, and how large it was. With the adjoint q of a jump at a point
and its variance W, both from one pass of the smoother, a jump with the prior variance V raises the
log likelihood by

    1/2 q' (V^-1 + W)^-1 q - 1/2 log det(1 + V W),

exactly, for given intensities (matrix determinant lemma). The sum over times, kinds and sizes with
their prior probabilities gives the odds of an event. A step of the reading itself, such as that of
another range or sensor, is a jump of all states in the direction of a constant temperature, so that
it is passed on and not inverted.

Events and intensities explain the same readings: what looks like an event beside small intensities
is none beside large ones. The search begins with several intensities, and the likeliest result is
taken. Guarded by ``tests/smoothing/test_event_score.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from tcdyn.core import Array, Flags
from tcdyn.smoothing.noise_levels import Change, Intensity, jumps_per_second
from tcdyn.smoothing.possible_events import (
    MIN_WEIGHT,
    Event,
    Kind,
    influenced_samples,
    without_changes,
)
from tcdyn.smoothing.process_noise import channel_spans, segment, smearing_time_s
from tcdyn.smoothing.record import Record, least_noise_sd
from tcdyn.smoothing.roughness import SPLIT_NATS
from tcdyn.smoothing.state_space import SAME_TIME, Smoothed, likelihood, smooth_record

# Values without a source below were chosen by judgement, and tried by tests/smoothing/band_study.py
# prior probability in a channel, at an event, of nothing, also at one that the caller lists because
# something happened; and of each kind, if there is any
NOTHING = 0.5
NOTHING_WHERE_LISTED = 0.1
PRIOR = np.array([0.6, 0.2, 0.18, 0.02])
# prior standard deviations of a jump, in ranges of the record (per lag), with equal probabilities.
# Readings that end soon after an event show little of its size
SIZES = 10.0 ** np.arange(-3.0, 1.6, 0.5)
# steps of a coarse logger by which rounding may step; a larger one is a step of the reading
ROUNDING_STEPS = 2.0
# relative deviation of a period up to which steps are periodic; chosen by judgement
SAME_PERIOD = 0.1
# Prior probability that a reading is a spike, and standard deviations of spikes, in those of the
# noise, with equal probabilities. A normal reading is one at 6.3 standard deviations: 3 in 1e10
SPIKE_PRIOR = 1e-7
SPIKE_SIZES = 10.0 ** np.arange(1.0, 5.0)
# log odds from which an event is one in the search, and is named: a probability of 95 %
MIN_LOG_ODDS = 3.0
# probability in a channel from which an event is called a step of the reading
NAMED_STEP = 0.5
# an event that is found in one pass hides others within so many lags until the next pass
REACH_LAGS = 2.0
# samples at either end in which no event is looked for: little is known of them
MARGIN = 3
# passes of the search, and events of a record
ROUNDS = 40
MAX_EVENTS = 130
# Factors of the intensities with which the search begins. With those of a record without events a
# square wave is a rough temperature
STARTS = (1.0, 1e-3)
# Segments of the intensities after an event: one, or those of a temperature that settles after it,
# which is smooth. They start at so many lags after it, with so many times the slope noise: the
# estimate finds the nearer of two maxima. Each further one begins three times as late as the one
# before, up to the next event. Only after events without another one within ALONE_LAGS
SETTLING = ((0.0, 1e6), (1.0, 1e5), (3.0, 1e3))
TIMES_LATER = 3.0
SEGMENTS = (((0.0, 1.0),), SETTLING)
ALONE_LAGS = 5.0
# rounds in which the first event of a group is moved: a further one moves it by less than its
# standard uncertainty
MOVES = 2
# The time of an event is resolved until so many times are likely: in steps of a sampling interval
# at first, then each time in parts of the step before
RESOLVED_TIMES = 5
PARTS_OF_STEP = 8
RESOLUTIONS = 3
# weight of a time, relative to the likeliest one, below which it is left out
LIKELY_TIME = 3e-3
# times of an event that are averaged over
TIMES = 6
# rounds in which the noise is estimated again beside events: a further one changes it by few
# percent
NOISE_ROUNDS = 2
# lags over which a jump may be spread, and the probability of each
WIDTHS_LAGS = (0.0, 0.1, 0.3)
WIDTH_PRIOR = (0.4, 0.3, 0.3)


# lags after an event at which segments start, and factors of their slope noise
Segments = Sequence[tuple[float, float]]


class ReadingStep(NamedTuple):
    """A step of the reading itself.

    Parameters
    ----------
    channel
        Index of the channel.
    at_s
        Its time [s].
    sample
        Index of the first sample after it.
    step_K, u_K
        Its size and standard uncertainty [K].
    probability
        Probability that it is one, and no change of the temperature.
    """

    channel: int
    at_s: float
    sample: int
    step_K: float
    u_K: float
    probability: float


def evidence(fit: Smoothed, index: NDArray[np.intp]) -> Array:
    """Log likelihood ratios (T, M, K, S) of a jump of each kind and size at some times.

    Parameters
    ----------
    fit
        The smoothed record.
    index
        Indices (T,) of the times in ``fit.times_s``.
    """
    level, slope, step = np.moveaxis(fit.score[index], 2, 0)[..., None]
    level_var, cross, slope_var, step_var = np.moveaxis(fit.score_var[index], 2, 0)[..., None]
    sd_K = channel_spans(fit.record, fit.noise_var)[:, None] * SIZES
    slope_sd = sd_K / smearing_time_s(fit.record)
    # adjoints and their covariance for jumps in units of their prior standard deviations
    jump = sd_K * level
    kink = slope_sd * slope
    step = sd_K * step
    jump_var = sd_K**2 * level_var
    covariance = sd_K * slope_sd * cross
    kink_var = slope_sd**2 * slope_var
    step_var = sd_K**2 * step_var
    determinant = (1 + jump_var) * (1 + kink_var) - covariance**2
    quadratic = jump**2 * (1 + kink_var) - 2 * jump * kink * covariance + kink**2 * (1 + jump_var)
    of_kind = {
        Kind.KINK: 0.5 * (kink**2 / (1 + kink_var) - np.log1p(kink_var)),
        Kind.JUMP: 0.5 * (jump**2 / (1 + jump_var) - np.log1p(jump_var)),
        Kind.JUMP_AND_KINK: 0.5 * (quadratic / determinant - np.log(determinant)),
        Kind.STEP: 0.5 * (step**2 / (1 + step_var) - np.log1p(step_var)),
    }
    # rounding steps too, by one or two of its own steps
    rounding_step_K = fit.record.rounding_K[:, None] * np.sqrt(12)
    likeliest_K = sd_K * step / (1 + step_var)
    is_rounding = np.abs(likeliest_K) < ROUNDING_STEPS * rounding_step_K
    of_kind[Kind.STEP] = np.where(is_rounding, -np.inf, of_kind[Kind.STEP])
    return np.stack([of_kind[kind] for kind in Kind], axis=2)


def spike_log_odds(fit: Smoothed, y: Array) -> Array:
    """Log odds (N, M) that a reading is a spike.

    Parameters
    ----------
    fit
        The smoothed record.
    y
        Readings (N, M) [degC], also of those samples that have no weight in ``fit``.

    Notes
    -----
    A reading without weight is off by its residual, with the variance R + P; R is its noise
    variance and P that of the prediction. The residual of a reading with weight has the variance
    R - P. R is taken for it, so that a model that is wrong does not make spikes of readings.
    """
    residual = y - fit.predicted
    is_used = fit.record.weight > 0
    noise_var = fit.noise_var / np.where(is_used, fit.record.weight, 1.0)
    var = noise_var + np.where(is_used, 0.0, fit.predicted_var)
    of_spike = fit.noise_var[:, None] * SPIKE_SIZES**2
    total = var[..., None] + of_spike
    gain = 0.5 * (residual**2)[..., None] * (1 / var[..., None] - 1 / total)
    gain -= 0.5 * np.log(total / var[..., None])
    prior = np.log(SPIKE_PRIOR / len(SPIKE_SIZES))
    return np.asarray(logsumexp(gain, axis=2) + prior)


def _joint(values: Array, nothing: float = NOTHING) -> Array:
    """Log of prior times likelihood of the evidence (..., K, S), relative to no event."""
    return values + np.log((1 - nothing) * PRIOR / len(SIZES))[:, None]


def log_density(values: Array, nothing: float = NOTHING) -> Array:
    """Log odds (T,) of an event at a time against none, from the evidence (T, M, K, S).

    They are for an event that is known to be then, if there is any; ``nothing`` is the prior
    probability that it is none of a channel.
    """
    some = logsumexp(_joint(values, nothing), axis=(2, 3))
    return np.asarray(np.logaddexp(np.log(nothing), some).sum(axis=1))


def _change(at_s: float, kind: Kind, sd_K: float, lag_s: float) -> Change:
    """The jump of a kind whose standard deviation is ``sd_K`` [K] (per lag)."""
    has_jump = kind in (Kind.JUMP, Kind.JUMP_AND_KINK)
    has_kink = kind in (Kind.KINK, Kind.JUMP_AND_KINK)
    return Change(
        at_s,
        level_sd=sd_K if has_jump else 0.0,
        slope_sd=sd_K / lag_s if has_kink else 0.0,
        reading_sd=sd_K if kind is Kind.STEP else 0.0,
    )


def _likeliest_changes(at_s: float, fit: Smoothed, values: Array) -> list[Change]:
    """The likeliest jump of each channel (M,), from the evidence (M, K, S) at its time."""
    spans_K = channel_spans(fit.record, fit.noise_var).tolist()
    lag_s = smearing_time_s(fit.record)
    changes = []
    for of_channel, span_K in zip(_joint(values), spans_K):
        kind, size = np.unravel_index(int(np.argmax(of_channel)), of_channel.shape)
        changes.append(_change(at_s, Kind(int(kind)), float(SIZES[size]) * span_K, lag_s))
    return changes


def new_events(fit: Smoothed, known_s: Sequence[float]) -> list[tuple[float, list[Change]]]:
    """Times [s] of events that a record shows beside known ones, and their likeliest jumps (M,).

    Parameters
    ----------
    fit
        The smoothed record, with the known events.
    known_s
        Their times [s].

    Notes
    -----
    An event is equally probable in every row. Times at which even the largest likelihood of any
    jump is no evidence are passed over.
    """
    times_s = fit.times_s
    per_row = -np.log(fit.record.tested_rows)
    of_step = fit.score[..., 2] ** 2 / np.maximum(fit.score_var[..., 3], 1e-300)
    bound = 0.5 * np.maximum(fit.jump_chi2, of_step).sum(axis=1) + per_row
    bound[:MARGIN] = -np.inf
    bound[-MARGIN:] = -np.inf
    bound[np.isin(times_s, known_s)] = -np.inf
    index = np.flatnonzero(bound > 0)
    if not len(index):
        return []
    values = evidence(fit, index)
    density = log_density(values) + per_row
    at_s = times_s[index]
    reach_s = REACH_LAGS * smearing_time_s(fit.record)
    found: list[tuple[float, list[Change]]] = []
    while True:
        best = int(np.argmax(density))
        is_near = np.abs(at_s - at_s[best]) <= reach_s
        if logsumexp(density[is_near]) < MIN_LOG_ODDS:
            return found
        time_s = float(at_s[best])
        found.append((time_s, _likeliest_changes(time_s, fit, values[best])))
        density[is_near] = -np.inf


@dataclass(frozen=True)
class Search:
    """How events are searched for.

    Parameters
    ----------
    estimated
        Gives the record smoothed with intensities that are estimated again, with the same segments.
    starts
        Factors of the intensities with which the search begins.
    detects
        Whether events are looked for that are not listed.
    """

    estimated: Callable[[Smoothed], Smoothed]
    starts: Sequence[float] = STARTS
    detects: bool = True


def detect_events(fit: Smoothed, search: Search) -> tuple[Smoothed, list[float]]:
    """The record with the events that it shows, and the times [s] of those that are not listed.

    Parameters
    ----------
    fit
        The smoothed record.
    search
        How they are searched for.

    Returns
    -------
    fit
        The likeliest of the records with the listed events only, and with those that are found from
        each of ``Search.starts`` and ``SEGMENTS``, all or the first of each group.
    events_s
        The times of the events that were found.
    """
    candidates = []
    plain = fit
    starts = search.starts
    if fit.record.events_s:
        plain = _settled_after_listed(fit, search)
        if len(_shown_listed(plain)) == len(fit.record.events_s):
            starts = starts[:1]  # no rough temperature stands for events at other times
    for factor in starts:
        start = plain if factor == 1.0 else _with_smaller_intensities(plain, factor)
        found = _with_new_events(start, [], search)
        if found is None or not found[1]:
            continue
        first = _with_first_events(start, *found, search)
        if first is not None:
            candidate = _settled(*first, search, SETTLING)
            if candidate is not None:
                candidates.append(candidate)
        for segments in SEGMENTS:
            candidate = _settled(*found, search, segments)
            if candidate is not None:
                candidates.append(candidate)
            if not _segment_starts(*found, segments):  # further segments change nothing
                break
    if not candidates:
        return plain, []
    candidates.append((search.estimated(plain), []))
    values = [_log_posterior(*candidate) for candidate in candidates]
    return candidates[int(np.argmax(values))]


def _settled_after_listed(fit: Smoothed, search: Search) -> Smoothed:
    """The record with the listed events, after which the temperature may settle."""
    fit = _with_listed_events(fit)
    starts = _segment_starts(fit, [], SETTLING)
    divided = [_divided(q, starts) for q in fit.intensities]
    fit = search.estimated(smooth_record(fit.record, fit.noise_var, divided))
    return _with_listed_events(_with_noise(fit))


def _with_listed_events(fit: Smoothed) -> Smoothed:
    """The record with the likeliest form of each listed event, beside the same intensities."""
    listed_s = fit.record.events_s
    if not listed_s:
        return fit
    _, intensities = _moved(fit, fit.intensities, listed_s)
    return smooth_record(fit.record, fit.noise_var, intensities)


def _with_smaller_intensities(fit: Smoothed, factor: float) -> Smoothed:
    """The record with slope noise of another factor, and without level noise."""
    intensities = [
        replace(q, levels=tuple(factor * level for level in q.levels), level_noise=())
        for q in fit.intensities
    ]
    return smooth_record(fit.record, fit.noise_var, intensities)


def _log_posterior(fit: Smoothed, events_s: Sequence[float]) -> float:
    """Log likelihood of a record, less what its events and segments have to gain."""
    value, _ = likelihood(fit.record, fit.noise_var, [[q] for q in fit.intensities])
    of_events = len(events_s) * (np.log(fit.record.tested_rows) + MIN_LOG_ODDS)
    of_segments = SPLIT_NATS * sum(len(q.levels) for q in fit.intensities)
    return float(value.sum() - of_events - of_segments)


def _with_first_events(
    start: Smoothed, fit: Smoothed, found_s: Sequence[float], search: Search
) -> tuple[Smoothed, list[float]] | None:
    """The record with the first event of each group only, and larger intensities after it.

    Parameters
    ----------
    start
        The smoothed record with the listed events only.
    fit, found_s
        The same with the events that were found first, and their times [s].
    search
        How events are searched for.

    Returns
    -------
    tuple or None
        The smoothed record and the times [s] of those of its events that are not listed; None where
        no event is beside another.

    Notes
    -----
    Beside small intensities a temperature that settles quickly after a change of slope looks like a
    jump some samples later, and further changes. Beside those of ``SETTLING`` the first event is
    moved to where it is likeliest.
    """
    listed_s = fit.record.events_s
    reach_s = ALONE_LAGS * smearing_time_s(fit.record)
    ordered_s = sorted([*_shown_listed(fit), *found_s])
    distance_s = np.diff(ordered_s, prepend=-np.inf)
    first_s = {at for at, from_last in zip(ordered_s, distance_s) if from_last > reach_s}
    if first_s.issuperset(found_s):
        return None
    kept_s = sorted({*listed_s, *first_s})
    changes = [[b for b in q.changes if b.start_s in kept_s] for q in fit.intensities]
    blocks = [replace(q, changes=()) for q in start.intensities]
    for _ in range(MOVES):
        others_s = [at for at in kept_s if at not in listed_s]
        starts = _segment_starts(fit, others_s, SETTLING)
        divided = [_divided(q, starts) for q in blocks]
        with_first = [replace(q, changes=tuple(some)) for q, some in zip(divided, changes)]
        fit = search.estimated(smooth_record(fit.record, fit.noise_var, with_first))
        kept_s, intensities = _moved(fit, fit.intensities, kept_s)
        changes = [list(q.changes) for q in intensities]
    if not kept_s:
        return None
    with_first = [replace(q, changes=tuple(some)) for q, some in zip(blocks, changes)]
    fit = smooth_record(fit.record, fit.noise_var, with_first)
    return fit, [at for at in kept_s if at not in listed_s]


def _moved(
    fit: Smoothed, intensities: Sequence[Intensity], events_s: Sequence[float]
) -> tuple[list[float], list[Intensity]]:
    """Events at their likeliest times [s] given all others, and the intensities (M,) with them.

    Those without evidence are left out; of a listed one its time remains.
    """
    placed_s = []
    moved = list(intensities)
    for at_s in events_s:
        event = weighed(fit, moved, at_s, with_widths=False)
        moved = without_changes(moved, at_s)
        if event.log_odds > 0:
            moved = event.insert(moved, event.at_s, event.most_probable)
            placed_s.append(event.at_s)
        elif event.is_listed:
            moved = event.insert(moved, event.at_s, [Change(at_s)] * len(moved))
            placed_s.append(at_s)
    return placed_s, moved


def _settled(
    fit: Smoothed, found_s: Sequence[float], search: Search, segments: Segments
) -> tuple[Smoothed, list[float]] | None:
    """The record with events and intensities in turn; None where there are too many events.

    Parameters
    ----------
    fit, found_s
        The record with the events that were found first, and their times [s].
    search, segments
        How events are searched for, and one of ``SEGMENTS``.

    Notes
    -----
    All events are found before the intensities are estimated again, which would rise where one is
    left out.
    """
    events_s: list[float] = []
    for count in range(ROUNDS):
        if not found_s:
            break
        events_s = sorted([*events_s, *found_s])
        starts = _segment_starts(fit, events_s, segments)
        if count:  # those of earlier rounds have been estimated
            starts = dict.fromkeys(starts, 1.0)
        intensities = [_divided(q, starts) for q in fit.intensities]
        fit = search.estimated(smooth_record(fit.record, fit.noise_var, intensities))
        fit = _with_listed_events(_with_noise(fit))
        found = _with_new_events(fit, events_s, search)
        if found is None:
            return None
        fit, found_s = found
    return fit, events_s


def _with_noise(fit: Smoothed) -> Smoothed:
    """The record smoothed with the noise of its readings, of which events are no part.

    Notes
    -----
    The likeliest variance is the sum of squared residuals over the number of readings less that of
    the degrees of freedom of the temperature (MacKay 1992).
    """
    record = fit.record
    if record.noise_known:
        return fit
    noise_var = fit.noise_var
    for _ in range(NOISE_ROUNDS):
        residual = record.weight * (record.y - fit.predicted) ** 2
        freedom = record.weight * (1 - fit.predicted_var / noise_var)
        smallest = (least_noise_sd(record.y) ** 2).clip(min=1e-300)
        likeliest = residual.sum(axis=0) / freedom.sum(axis=0).clip(min=1.0)
        # rounding is no white noise, of which residuals would tell
        is_white = record.rounding_K == 0
        noise_var = np.where(is_white, np.maximum(likeliest, smallest), noise_var)
        fit = smooth_record(record, noise_var, fit.intensities)
    return fit


def _with_new_events(
    fit: Smoothed, known_s: Sequence[float], search: Search
) -> tuple[Smoothed, list[float]] | None:
    """The record with all events that it shows beside known ones, with the same intensities.

    Each event is moved to its likeliest time between the samples, else its neighbours would show
    further events. None where there are too many.
    """
    listed_s = fit.record.events_s
    found_s: list[float] = []
    if not search.detects:
        return fit, found_s
    for _ in range(ROUNDS):
        new = new_events(fit, [*listed_s, *known_s, *found_s])
        if len(known_s) + len(found_s) + len(new) > MAX_EVENTS:
            return None
        intensities = [
            replace(q, changes=(*q.changes, *(changes[c] for _, changes in new)))
            for c, q in enumerate(fit.intensities)
        ]
        placed_s, intensities = _moved(fit, intensities, [at_s for at_s, _ in new])
        if not placed_s:
            break
        found_s += placed_s
        fit = smooth_record(fit.record, fit.noise_var, intensities)
    return fit, found_s


def _segment_starts(
    fit: Smoothed, events_s: Sequence[float], segments: Segments
) -> dict[float, float]:
    """Starts [s] of segments at and after the lone events of a record, and factors of slope noise.

    ``events_s`` are those that are not listed; listed ones count if the readings show them.
    """
    lag_s = smearing_time_s(fit.record)
    ordered_s = sorted([*_shown_listed(fit), *events_s])
    ends_s = [*ordered_s[1:], float(fit.times_s[-1])]
    starts = {}
    for at_s, end_s in zip(ordered_s, ends_s):
        if end_s - at_s <= ALONE_LAGS * lag_s:
            continue
        for share, factor in segments:
            starts[at_s + share * lag_s] = factor
        after_s = TIMES_LATER * segments[-1][0] * lag_s
        while 0 < after_s < (end_s - at_s) / 1.5:
            starts[at_s + after_s] = 1.0
            after_s *= TIMES_LATER
    return starts


def _shown_listed(fit: Smoothed) -> list[float]:
    """Times [s] of the listed events that the readings show."""
    changed_s = {c.start_s for q in fit.intensities for c in q.changes if c.level_sd or c.slope_sd}
    return [at_s for at_s in fit.record.events_s if at_s in changed_s]


def _divided(intensity: Intensity, starts: Mapping[float, float]) -> Intensity:
    """The same intensity with segments that start at some more times [s], and factors of it."""
    starts_s = np.unique([*intensity.starts_s, *starts]).tolist()
    segment_of = np.maximum(np.searchsorted(intensity.starts_s, starts_s, "right") - 1, 0).tolist()
    factors = [starts.get(start_s, 1.0) for start_s in starts_s]
    return replace(
        intensity,
        starts_s=tuple(starts_s),
        levels=tuple(factor * intensity.levels[k] for factor, k in zip(factors, segment_of)),
        level_noise=tuple(intensity.level_noise[k] for k in segment_of if intensity.level_noise),
    )


def weigh_events(fit: Smoothed, events_s: Sequence[float]) -> tuple[Smoothed, list[Event]]:
    """What each event may be, given all others; the record without those that have no evidence.

    Parameters
    ----------
    fit
        The smoothed record, with its events and the final intensities.
    events_s
        Times [s] of the events that are not listed.
    """
    all_s = [*fit.record.events_s, *events_s]
    intensities = list(fit.intensities)
    events = []
    for at_s in all_s:
        event = weighed(fit, intensities, at_s)
        intensities = without_changes(intensities, at_s)
        if event.log_odds > 0 or event.is_listed:
            intensities = event.insert(intensities, event.at_s, event.most_probable)
            events.append(event)
    if all_s:
        intensities = [_with_last_jumps(q, fit.record) for q in intensities]
        fit = smooth_record(fit.record, fit.noise_var, intensities)
    return fit, events


def _with_last_jumps(intensity: Intensity, record: Record) -> Intensity:
    """The intensity with jumps in the last samples, as probable as in the record.

    The readings cannot show them yet. They are one jump spread over ``MARGIN`` samples on either
    side of the end.
    """
    duration_s = record.dt_s * len(record.y)
    spread_s = 2 * MARGIN * record.dt_s
    level_var, _ = jumps_per_second([intensity], duration_s)[0] * spread_s
    if not level_var > 0:
        return intensity
    end_s = (len(record.y) - 1) * record.dt_s
    change = Change(end_s, level_sd=float(np.sqrt(level_var)), width_s=spread_s)
    return replace(intensity, changes=(*intensity.changes, change))


def reading_steps(fit: Smoothed, events: Sequence[Event]) -> list[ReadingStep]:
    """The events that are steps of the reading itself, such as those of another range or sensor.

    Parameters
    ----------
    fit
        The smoothed record, with the likeliest form of each event.
    events
        The events.

    Notes
    -----
    With the prior variance V of the step, its adjoint q and variance W, the step is V q and its
    variance V - V^2 W (de Jong and Penzer 1998).
    """
    steps = []
    for event in events:
        index = int(np.searchsorted(fit.times_s, event.at_s - SAME_TIME * fit.record.dt_s))
        sample = int(np.searchsorted(fit.sample, index))
        for c, of_kinds in enumerate(event.kind_probability):
            change = event.most_probable[c]
            probability = float(of_kinds[Kind.STEP])
            if probability < NAMED_STEP or not change.reading_sd:
                continue
            prior_var = change.reading_sd**2
            step_K = float(prior_var * fit.score[index, c, 2])
            var = float(prior_var - prior_var**2 * fit.score_var[index, c, 3])
            u_K = np.sqrt(max(var, 0.0))
            steps.append(ReadingStep(c, event.at_s, sample, step_K, u_K, probability))
    return steps


def period_of(times_s: Sequence[float]) -> float:
    """Period [s] of times of edges, every second of which is alike; zero where there is none.

    Examples
    --------
    >>> period_of([0.0, 4.0, 10.0, 14.1, 20.0, 24.0]), period_of([0.0, 3.0, 14.0, 15.0, 29.0])
    (10.0, 0.0)
    """
    ordered_s = np.sort(times_s)
    periods_s = ordered_s[2:] - ordered_s[:-2]
    if not len(periods_s):
        return 0.0
    period_s = float(np.median(periods_s))
    is_regular = np.abs(periods_s - period_s).max() < SAME_PERIOD * period_s
    return period_s if is_regular else 0.0


def weighed(
    fit: Smoothed, intensities: Sequence[Intensity], at_s: float, *, with_widths: bool = True
) -> Event:
    """When an event may be and what it may be, given all others.

    Parameters
    ----------
    fit
        Gives the record and its noise.
    intensities
        Intensity of each channel (M,), with all events.
    at_s
        Time of the event [s].
    with_widths
        Whether its jumps may also be gradual.

    Notes
    -----
    The smoother runs on the samples that the event influences, without it. Where its time is known
    to some samples, times between the samples are points, too. The time of a listed event is known,
    and its jumps are sudden.
    """
    record = fit.record
    dt_s = record.dt_s
    first, last = influenced_samples(record, fit.noise_var, intensities, at_s)
    window = segment(record, first, last, record.events_s)
    shift_s = first * dt_s
    end_s = last * dt_s
    base = [q.within(shift_s, end_s) for q in without_changes(intensities, at_s)]
    if at_s in record.events_s:
        return _listed_event(fit, window, base, at_s, shift_s)
    others_s = [*window.events_s, *(b.start_s for q in base for b in q.changes)]
    before_s = max([s for s in others_s if s < at_s - shift_s], default=-np.inf)
    after_s = min([s for s in others_s if s > at_s - shift_s], default=np.inf)
    part = smooth_record(window, fit.noise_var, base)
    is_between = (part.times_s > before_s) & (part.times_s < after_s)
    times_s, density, values = _densities(part, is_between, record.tested_rows)
    step_s = dt_s
    for _ in range(RESOLUTIONS):
        likely_s = times_s[density > density.max() + np.log(LIKELY_TIME)]
        if len(likely_s) >= RESOLVED_TIMES:
            break
        steps = np.arange(np.floor(likely_s[0] / step_s) - 1, np.floor(likely_s[-1] / step_s) + 2)
        within = (np.arange(PARTS_OF_STEP) + 0.5) / PARTS_OF_STEP
        fine_s = ((steps[:, None] + within) * step_s).ravel()
        earliest_s = max(before_s, float(part.times_s[0]))
        latest_s = min(after_s, float(part.times_s[-1]))
        fine_s = fine_s[(fine_s > earliest_s) & (fine_s < latest_s)]
        if not len(fine_s):
            break
        nothing = [Change(time_s) for time_s in fine_s.tolist()]
        with_points = [replace(q, changes=(*q.changes, *nothing)) for q in base]
        part = smooth_record(window, fit.noise_var, with_points)
        is_fine = np.isin(part.times_s, fine_s)
        times_s, density, values = _densities(part, is_fine, record.tested_rows)
        step_s /= PARTS_OF_STEP
    event = _event_of(fit, times_s + shift_s, density, values)
    if not with_widths:
        return event
    return _with_widths(event, window, fit.noise_var, base, shift_s)


def time_of_listed(fit: Smoothed, at_s: float) -> tuple[float, float]:
    """Time [s] of a listed event that may be a row early or late, and its standard uncertainty.

    Parameters
    ----------
    fit
        The smoothed record, with all events.
    at_s
        The listed time [s].

    Notes
    -----
    Before, the listed time is as probable as all others within a row together. They are weighed as
    those of any event.
    """
    record = fit.record
    dt_s = record.dt_s
    first, last = influenced_samples(record, fit.noise_var, fit.intensities, at_s)
    others_s = tuple(other for other in record.events_s if other != at_s)
    window = segment(replace(record, events_s=others_s), first, last, others_s)
    shift_s = first * dt_s
    parts = np.arange(-PARTS_OF_STEP, PARTS_OF_STEP + 1) / PARTS_OF_STEP
    times_s = at_s - shift_s + dt_s * parts
    times_s = times_s[(times_s > 0) & (times_s < (last - first - 1) * dt_s)]
    times_s = times_s[~np.isin(times_s, [other - shift_s for other in others_s])]
    points = tuple(Change(time_s) for time_s in times_s.tolist())
    base = [q.within(shift_s, last * dt_s) for q in without_changes(fit.intensities, at_s)]
    with_points = [replace(q, changes=(*q.changes, *points)) for q in base]
    part = smooth_record(window, fit.noise_var, with_points)
    index = np.searchsorted(part.times_s, times_s - SAME_TIME * dt_s)
    density = log_density(evidence(part, index), NOTHING_WHERE_LISTED)
    density[times_s == at_s - shift_s] += np.log(len(times_s) - 1)
    weight = np.exp(density - logsumexp(density))
    best_s = float(times_s[np.argmax(weight)])
    return best_s + shift_s, float(np.sqrt(weight @ (times_s - best_s) ** 2))


def _listed_event(
    fit: Smoothed,
    window: Record,
    base: Sequence[Intensity],
    at_s: float,
    shift_s: float,
) -> Event:
    """What a listed event may be, given all others.

    Parameters
    ----------
    fit
        Gives the record and its noise.
    window, base
        The samples that it influences, and the intensities (M,) there without the event.
    at_s
        Time of the event [s].
    shift_s
        Time of the first of these samples [s].
    """
    listed_s = at_s - shift_s
    nothing = Change(listed_s)  # else its slope could be any
    part = smooth_record(
        window, fit.noise_var, [replace(q, changes=(*q.changes, nothing)) for q in base]
    )
    index = np.searchsorted(part.times_s, [listed_s - SAME_TIME * window.dt_s])
    values = evidence(part, index)
    density = log_density(values, NOTHING_WHERE_LISTED)
    return _event_of(fit, np.array([at_s]), density, values, is_listed=True)


def _densities(part: Smoothed, among: Flags, rows: int) -> tuple[Array, Array, Array]:
    """Log odds of an event at some times of a window.

    Parameters
    ----------
    part
        The smoothed window.
    among
        Whether the event may be at each of its times.
    rows
        Rows of the record in which an event is equally probable.

    Returns
    -------
    times_s
        The times (T,) [s].
    density
        Log odds (T,) of an event there.
    values
        The ``evidence`` (T, M, K, S).
    """
    index = np.flatnonzero(among)
    inner = index[(index >= MARGIN) & (index < len(part.times_s) - MARGIN)]
    index = inner if len(inner) else index
    values = evidence(part, index)
    dt_s = part.record.dt_s
    width_s = float(np.median(np.diff(part.times_s[index]))) if len(index) > 1 else dt_s
    return part.times_s[index], log_density(values) + np.log(width_s / (rows * dt_s)), values


def _event_of(
    fit: Smoothed, times_s: Array, density: Array, values: Array, *, is_listed: bool = False
) -> Event:
    """The event with its possibilities.

    Parameters
    ----------
    fit
        The record.
    times_s, density, values
        As ``_densities`` returns them, on the clock of the record.
    is_listed
        Whether the caller listed it.

    Notes
    -----
    A possibility stands for several times. Where they are few, none stands for times on both sides
    of a sample: there the temperature of the sample changes.
    """
    log_odds = float(logsumexp(density))
    time_weight = np.exp(density - log_odds)
    nothing = NOTHING_WHERE_LISTED if is_listed else NOTHING
    joint = _joint(values, nothing)
    of_channel = np.logaddexp(np.log(nothing), logsumexp(joint, axis=(2, 3)))
    kind_weight = np.exp(logsumexp(joint, axis=3) - of_channel[..., None])  # (T, M, K)
    probability = 1.0 if is_listed else 1 / (1 + np.exp(-log_odds))
    lag_s = smearing_time_s(fit.record)
    spans_K = channel_spans(fit.record, fit.noise_var)
    likely = np.flatnonzero(time_weight > LIKELY_TIME * time_weight.max())
    interval = np.floor(times_s[likely] / fit.record.dt_s)
    of_intervals = [likely[interval == k] for k in np.unique(interval)]
    if len(of_intervals) > TIMES:
        of_intervals = [likely]
    per_interval = TIMES // len(of_intervals)
    groups = [
        group
        for members in of_intervals
        for group in np.array_split(members, min(per_interval, len(members)))
    ]
    total = time_weight[likely].sum()
    shares = [time_weight[group] / total for group in groups]
    middles = [int(group[np.argmax(share)]) for group, share in zip(groups, shares)]
    best = middles[int(np.argmax([share.sum() for share in shares]))]
    likeliest_kinds = np.argmax(kind_weight[best], axis=1)
    possibilities = []
    for group, share, middle in zip(groups, shares, middles):
        at_s = float(times_s[middle])
        for kind in Kind:
            weight = probability * (share @ kind_weight[group, :, kind])
            is_likeliest = middle == best and kind in likeliest_kinds
            is_only = (weight > 0.5 * share.sum()).any() and share.sum() > LIKELY_TIME
            if weight.max() < MIN_WEIGHT and not is_only and not is_likeliest:
                continue
            sizes = SIZES[np.argmax(values[middle, :, kind], axis=1)]
            changes = [_change(at_s, kind, sd_K, lag_s) for sd_K in (sizes * spans_K).tolist()]
            possibilities.append((at_s, tuple(changes), weight))
    no_event = 1 - probability * (time_weight @ kind_weight.sum(axis=2))
    mean_s = float(time_weight @ times_s)
    return Event(
        float(times_s[best]),
        tuple(possibilities),
        no_event,
        float(np.sqrt(time_weight @ (times_s - mean_s) ** 2)),
        log_odds,
        np.einsum("t,tmk->mk", time_weight, kind_weight),
        is_listed,
    )


def _with_widths(
    event: Event, window: Record, noise_var: Array, base: Sequence[Intensity], shift_s: float
) -> Event:
    """The event whose jumps may also be gradual, with the weights of their likelihoods.

    Parameters
    ----------
    event
        The event.
    window, noise_var, base
        The samples that it influences, their noise variance (M,) [K2], and the intensities (M,)
        without the event.
    shift_s
        Time of the first of these samples [s].
    """
    jumps = [possibility for possibility in event.possibilities if _is_jump(possibility[1])]
    if not jumps:
        return event
    best_s, best_changes, _ = max(jumps, key=lambda possibility: float(possibility[2].sum()))
    widths_s = (np.array(WIDTHS_LAGS) * smearing_time_s(window)).tolist()
    at_best = [replace(b, start_s=best_s - shift_s) for b in best_changes]
    proposals = [
        [replace(q, changes=(*q.changes, replace(b, width_s=width))) for width in widths_s]
        for q, b in zip(base, at_best)
    ]
    value = likelihood(window, noise_var, proposals)[0] + np.log(WIDTH_PRIOR)
    share = np.exp(value - logsumexp(value, axis=1, keepdims=True)).T
    possibilities = []
    for at_s, changes, weight in event.possibilities:
        if not _is_jump(changes):
            possibilities.append((at_s, changes, weight))
            continue
        for width_s, of_width in zip(widths_s, share):
            if of_width.max() > MIN_WEIGHT:
                spread = tuple(replace(b, width_s=width_s) for b in changes)
                possibilities.append((at_s, spread, weight * of_width))
    return replace(event, possibilities=tuple(possibilities))


def _is_jump(changes: Sequence[Change]) -> bool:
    """Whether an event is a jump of the temperature alone."""
    return changes[0].level_sd > 0 and changes[0].slope_sd == 0
