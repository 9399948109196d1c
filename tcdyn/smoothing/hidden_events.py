"""Detection of events that the caller did not list, and the average over what events may be.

A score test on the smoother gives candidate times. Each candidate is weighed by its likelihood
as no event, a kink (jump of the slope) or a jump of the temperature, at several times. The smoothed
temperature is the mean over these possibilities (Bayesian model averaging).

Used by ``tcdyn.smoothing.smoother.smooth`` only. The thresholds below were chosen by judgement; the
error and coverage that result are printed by ``python -m tests.smoothing.event_study``. Guarded by
``tests/smoothing/test_hidden.py`` and, for units, ``tests/smoothing/test_any_unit.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import logsumexp

from tcdyn.core import Array
from tcdyn.smoothing.corner import corner_rad_s
from tcdyn.smoothing.noise_levels import Burst, Intensity
from tcdyn.smoothing.process_noise import (
    AFTER_S,
    DECAYS_S,
    REACH_LAGS,
    channel_spans,
    event_window,
    jump_ranges,
    likeliest_burst,
    segment,
    smearing_time_s,
)
from tcdyn.smoothing.record import Record
from tcdyn.smoothing.state_space import (
    DIFFUSE,
    Smoothed,
    SmoothedSamples,
    likelihood,
    smooth_record,
)

# Values without a source below were chosen by judgement; those of the search trade time against
# the chance to detect an event, the last ones accuracy of the average against time.
# expected false candidates in a record without events, and in one that has some
FALSE_CANDIDATES = 0.05
MORE_FALSE_CANDIDATES = 1.0
# lags around an event within which the score test sees that event only
SCORE_REACH_LAGS = 6.0
# start [s] before an event of the samples that it influences
BEFORE_EVENT_S = 5.0
# lags: a window ends soon after the next event, unless that event is as near as this
NEXT_EVENT_LAGS = 1.0
# log odds below which a candidate becomes doubtful before all others are in place
MIN_LOG_ODDS = -5.0
# rounds of the search, and events in one record at most
ROUNDS = 8
MAX_EVENTS = 24
# nats by which a fit of height, decay and power of a burst to pure noise raises the likelihood
BURST_FIT_NATS = 3.0
# prior probability in a channel at an event: nothing, a kink, a jump of the temperature at once, a
# kink before rough changes, and jumps over these shares of the lag
PRIOR = (0.5, 0.35, 0.04, 0.05, 0.03, 0.03)
GRADUAL_LAGS = (0.1, 0.3)
# ``Burst.rough`` of a kink before rough changes. These six values were chosen by judgement and
# tried by tests/smoothing/band_study.py
KINK_ROUGHNESS = 3.0
# times tried at first; and later, over so many standard deviations on either side
COARSE_TIMES = 13
FINE_TIMES = 7
FINE_REACH_SD = 2.5
# time around a jump that is still in the data within which its time may lie, over the inverse of
# the corner frequency of the smoother
JUMP_WIDTH = 2.5
# weights below this share are left out of the average
MIN_WEIGHT = 0.01


@dataclass(frozen=True)
class PossibleEvent:
    """An event of uncertain form, such as a listed one.

    Parameters
    ----------
    at_s
        Most likely time [s].
    possibilities
        All that the event may be, of some weight: time [s], bursts (M,) and weights (M,).
    """

    at_s: float
    possibilities: tuple[tuple[float, tuple[Burst, ...], Array], ...]

    @property
    def most_probable(self) -> list[Burst]:
        """Burst of greatest weight for each channel (M,)."""
        weights = np.array([weight for _, _, weight in self.possibilities])
        return [self.possibilities[k][1][c] for c, k in enumerate(np.argmax(weights, axis=0))]

    @property
    def is_uncertain(self) -> bool:
        """Whether a channel gives other possibilities than the most probable some weight."""
        weights = np.array([weight for _, _, weight in self.possibilities])
        return bool((weights.max(axis=0) < 1 - MIN_WEIGHT).any())

    def insert(
        self, intensities: Sequence[Intensity], at_s: float, bursts: Sequence[Burst]
    ) -> list[Intensity]:
        """Intensities with other bursts, and another time, at this event.

        Parameters
        ----------
        intensities
            Intensity of each channel (M,), which has its segment boundary at ``at_s`` of this
            event.
        at_s
            New time of the event [s].
        bursts
            Burst of each channel (M,) that replaces those at the event.
        """
        bare = without_bursts(intensities, self.at_s)
        shifted = [q.shifted(self.at_s, at_s) for q in bare]
        return [replace(q, bursts=(*q.bursts, b)) for q, b in zip(shifted, bursts)]


@dataclass(frozen=True)
class HiddenEvent(PossibleEvent):
    """An event that the caller did not list.

    Parameters
    ----------
    u_s
        Standard uncertainty of its time [s].
    log_odds
        Log odds that there is an event.
    kinds
        Bursts of the channels (M,) for each form of an event, in the order of ``PRIOR``.
    likeliest
        The more likely of these for each channel (M,).
    no_event_probability
        Probability (M,) that a channel has no event.
    level
        Intensity (M,) [K2/s3] before and after the time if there is no event.
    """

    u_s: float
    log_odds: float
    kinds: tuple[tuple[Burst, ...], ...]
    likeliest: tuple[Burst, ...]
    no_event_probability: Array
    level: Array

    def remove(self, intensities: Sequence[Intensity]) -> list[Intensity]:
        """Intensities (M,) without this event: no burst, ``level`` before and after it."""
        bare = without_bursts(intensities, self.at_s)
        return [_level_across_boundary(q, self.at_s, level) for q, level in zip(bare, self.level)]


def without_bursts(intensities: Sequence[Intensity], at_s: float) -> list[Intensity]:
    """Intensities without the bursts that start at ``at_s``."""
    return [replace(q, bursts=tuple(b for b in q.bursts if b.start_s != at_s)) for q in intensities]


def _level_across_boundary(intensity: Intensity, at_s: float, level: float) -> Intensity:
    """Intensity with the same level in the segments before and after one boundary.

    Parameters
    ----------
    intensity
        The intensity; returned as it is if no segment starts exactly at ``at_s``.
    at_s
        Time of the boundary [s].
    level
        The level [K2/s3].
    """
    if at_s not in intensity.starts_s:
        return intensity
    index = intensity.starts_s.index(at_s)
    levels = list(intensity.levels)
    for i in range(max(index - 1, 0), index + 1):
        levels[i] = level
    return replace(intensity, levels=tuple(levels))


def candidate_times(fit: Smoothed, events: Sequence[float]) -> list[float]:
    """Times where a jump would help more than chance: the best of each region, best first.

    Parameters
    ----------
    fit
        The smoothed record, with the score test for a jump at each sample.
    events
        Times [s] near which no candidate is looked for.

    Returns
    -------
    list of float
        Times of samples [s].

    Notes
    -----
    The score test for a jump of level or slope has a chi-square distribution with two degrees of
    freedom, so exp(-x/2) of the samples exceed x by chance. The threshold allows
    ``FALSE_CANDIDATES`` in a record, and ``MORE_FALSE_CANDIDATES`` once it has events. A candidate
    is only tried: a false one costs time, not accuracy, because ``weigh_event`` decides. The first
    and last three samples are not tested.
    """
    times_s = fit.times_s
    reach_s = SCORE_REACH_LAGS * smearing_time_s(fit.record)
    score = np.max(fit.jump_chi2, axis=1)
    score[:3] = 0.0
    score[-3:] = 0.0
    expected_false = MORE_FALSE_CANDIDATES if events else FALSE_CANDIDATES
    n_tests = fit.record.tested_rows * fit.jump_chi2.shape[1]
    threshold = 2 * np.log(n_tests / expected_false)
    times: list[float] = []
    for event in events:
        score[np.abs(times_s - event) < reach_s] = 0.0
    while score.max() > threshold:
        times.append(float(times_s[int(np.argmax(score))]))
        score[np.abs(times_s - times[-1]) < reach_s] = 0.0
    return times


def remaining_jump(fit: Smoothed) -> Array:
    """Half of the jump (N, M) [K] of the temperature that the data still show at each sample; zero
    where chance explains it.

    A smooth result passes through the middle of a jump, so this is its largest error there.

    Notes
    -----
    The most likely jump at a sample is the adjoint over its variance plus the inverse variance of
    its prior, whose standard deviation is the range of the trace as in ``weigh_event``. It counts
    where the score test of ``candidate_times`` is significant, and within ``JUMP_WIDTH`` around.
    Soon after a hidden event another jump is likely (the second edge of a pulse), so that the
    threshold is lower there.
    """
    chi2 = fit.jump_chi2.copy()
    chi2[:3] = 0.0
    chi2[-3:] = 0.0
    out = np.zeros_like(fit.predicted)
    dt = fit.record.dt_s
    times_s = fit.times_s
    listed_s = set(fit.record.events_s)
    hidden_s = {b.start_s for q in fit.intensities for b in q.bursts} - listed_s
    chi2[np.isin(times_s, [*listed_s, *hidden_s])] = 0.0  # there a jump has its own prior
    after_s = times_s[:, None] - sorted(hidden_s)
    reach_s = smearing_time_s(fit.record)
    is_after = ((after_s > 0) & (after_s < reach_s)).any(axis=1)
    # a record may end soon after an event; that makes no jump there more likely
    fewest = reach_s / dt
    count_after = max(float(is_after.sum()), fewest) * chi2.shape[1]
    threshold = np.where(
        is_after,
        2 * np.log(count_after / MORE_FALSE_CANDIDATES),
        2 * np.log(fit.record.tested_rows * chi2.shape[1] / FALSE_CANDIDATES),
    )[:, None]
    significant = chi2 > threshold
    spans_K = channel_spans(fit.record, fit.noise_var)
    for c in np.flatnonzero(significant.any(axis=0)):
        information = fit.score_var[:, c, 0] + 1 / spans_K[c] ** 2
        half_jump = 0.5 * np.abs(fit.score[:, c, 0]) / information
        jump = np.where(significant[:, c], half_jump, 0.0)
        index = np.flatnonzero(jump)
        ratio = fit.intensities[c].at(times_s[index]) / (fit.noise_var[c] * dt)
        half_s = np.maximum(0.5 * JUMP_WIDTH / corner_rad_s(fit.record.chains[c], ratio), 2 * dt)
        first = np.searchsorted(times_s, times_s[index] - half_s)
        last = np.searchsorted(times_s, times_s[index] + half_s, side="right")
        around = np.zeros(len(times_s))
        for k, low, high in zip(index, first, last):
            around[low:high] = np.maximum(around[low:high], jump[k])
        out[:, c] = around[fit.sample]
    return out


def detect_hidden_events(
    fit: Smoothed, levels_of: Callable[[Record], tuple[list[Intensity], Array]]
) -> tuple[Smoothed, list[HiddenEvent]]:
    """Smoothed record with the events that its data show, and these events.

    All candidates are inserted at once and weighed in turn, so that none hides another behind an
    intensity that is too high. This is repeated until no candidate is new. An event that the data
    do not support once all others are in place is doubtful.

    Parameters
    ----------
    fit
        Smoothed record without hidden events.
    levels_of
        Gives the intensities of a record without their bursts, one level for each segment between
        its events, and its noise variance (M,) [K2].

    Returns
    -------
    fit
        Smoothed record with each accepted event in its most likely form; the ``fit`` given if there
        is none.
    events
        Accepted and doubtful events that have possibilities of some weight, for
        ``average_over_event``.

    Notes
    -----
    What may be changed: ``ROUNDS`` and ``MAX_EVENTS`` limit the time and may be larger.
    ``MIN_LOG_ODDS`` below zero keeps an event whose neighbours are not in place yet; only the last
    round decides at log odds of zero. ``tests/smoothing/test_hidden.py`` checks that smooth motion
    gets no events, and (marker ``study``) that a doubtful event is given up.
    """
    record = fit.record
    plain = fit.intensities
    noise_var = fit.noise_var
    lag = smearing_time_s(record)
    listed_s = set(record.events_s)
    accepted: list[HiddenEvent] = []
    doubtful: list[HiddenEvent] = []
    original = fit
    settled = False
    search = True
    for _ in range(ROUNDS):
        new: list[float] = []
        if search:
            excluded = [*listed_s, *(h.at_s for h in (*accepted, *doubtful))]
            new = candidate_times(fit, excluded)[: MAX_EVENTS - len(accepted)]
        if not new and (settled or not accepted):
            break
        final = not new
        settled = final
        # a candidate is rough at first: from somewhat before it on, any change is possible
        new_s = [max(c - 0.5 * lag, 2 * record.dt_s) for c in new]
        # bursts of events before the record, whose effect lasts, are part of it
        bursts = [
            [b for b in q.bursts if b.start_s in listed_s or b.start_s <= 0]
            for q in fit.intensities
        ]
        for c, span in enumerate(channel_spans(record, noise_var)):
            height = 100 * span**2 / lag**3
            bursts[c] += [Burst(at, height, lag, slope_sd=span / lag) for at in new_s]
            bursts[c] += [h.likeliest[c] for h in accepted]
        times = sorted([*(h.at_s for h in accepted), *new_s])
        # an event may have started a little earlier, but not before the event that precedes it
        boundaries: dict[float, float] = {}
        for at in times:
            last = max([0.0, *boundaries, *(e for e in listed_s if e < at)])
            boundaries[min(max(at - lag, last + record.dt_s), at)] = at
        divided = replace(record, events_s=tuple(sorted((*listed_s, *boundaries))))
        levels, noise_var = levels_of(divided)
        starts = tuple(boundaries.get(s, s) for s in levels[0].starts_s)
        intensities = [replace(q, starts_s=starts, bursts=tuple(b)) for q, b in zip(levels, bursts)]
        previous = {h.at_s: h for h in accepted}
        accepted = []
        for at in times:
            far_from_new = all(abs(at - e) > SCORE_REACH_LAGS * lag for e in new_s)
            if not final and at in previous and far_from_new:
                accepted.append(previous[at])
                continue
            plain_levels = [float(q.at(at)) for q in plain]
            event = weigh_event(record, noise_var, intensities, at, plain_levels, previous.get(at))
            intensities = [q.shifted(at, event.at_s) for q in intensities]
            if event.log_odds > (0 if final else MIN_LOG_ODDS):
                accepted.append(event)
                intensities = event.insert(intensities, event.at_s, event.likeliest)
            else:
                doubtful.append(event)
                intensities = event.remove(intensities)
                settled = False
        search = final or len(accepted) > len(previous)
        fit = smooth_record(record, noise_var, intensities) if accepted else original
    return fit, [h for h in (*accepted, *doubtful) if h.possibilities]


def influenced_samples(
    record: Record, at_s: float, others_s: Iterable[float] = ()
) -> tuple[int, int]:
    """Range of samples that an event influences.

    Parameters
    ----------
    record
        The record.
    at_s
        Time of the event [s].
    others_s
        Times of other events [s]; the range ends soon after the next of them.

    Returns
    -------
    first, last
        First sample, and one past the last.

    Notes
    -----
    From ``BEFORE_EVENT_S`` and ``REACH_LAGS`` before to ``AFTER_S`` and ``REACH_LAGS`` after. A lag
    is ``tcdyn.smoothing.process_noise.smearing_time_s``. A longer range costs time. A shorter one
    leaves out samples that ``average_over_event`` should change.
    """
    dt = record.dt_s
    lag = smearing_time_s(record)
    first = max(int(np.ceil((at_s - BEFORE_EVENT_S - REACH_LAGS * lag) / dt)), 0)
    after = min([at_s + AFTER_S, *(e for e in others_s if e > at_s + NEXT_EVENT_LAGS * lag)])
    return first, min(int((after + REACH_LAGS * lag) / dt) + 1, len(record.y))


@dataclass(frozen=True)
class _Window:
    """Samples around one event, and the intensities there without the event.

    Parameters
    ----------
    record, noise_var
        Samples and their noise variance (M,) [K2].
    base
        Intensities (M,) without the bursts of the event.
    start_s
        Time of the event on the clock of the window [s].
    lowest_s, highest_s
        Bounds of its time from the events before and after it [s].
    """

    record: Record
    noise_var: Array
    base: list[Intensity]
    start_s: float
    lowest_s: float
    highest_s: float

    def values(self, times: Array, options: Sequence[Sequence[Burst]]) -> Array:
        """Log likelihood (M, T, O) with the event at each of T times and with each of O options.

        Parameters
        ----------
        times
            Times (T,) [s] on the clock of the window.
        options
            For each option the bursts (M,) of the event.
        """
        proposals = []
        for q, bursts in zip(self.base, zip(*options)):
            with_burst = [replace(q, bursts=(*q.bursts, b)) for b in bursts]
            proposals.append([p.shifted(self.start_s, t) for t in times for p in with_burst])
        value = likelihood(self.record, self.noise_var, proposals)[0]
        return value.reshape(len(self.base), len(times), -1)

    def admissible(self, times: ArrayLike) -> Array:
        """Times [s] clipped to the bounds of the event; nearly equal times become one."""
        grid_s = 1e-4 * self.record.dt_s
        clipped = np.clip(times, self.lowest_s, max(self.lowest_s, self.highest_s))
        return np.asarray(np.unique(np.round(clipped / grid_s)) * grid_s)


def weigh_event(
    record: Record,
    noise_var: Array,
    intensities: Sequence[Intensity],
    at_s: float,
    plain: Sequence[float],
    previous: HiddenEvent | None = None,
) -> HiddenEvent:
    """Weigh what happened at about one time: nothing, a kink, or a jump, and when.

    Parameters
    ----------
    record
        The record.
    noise_var
        Noise variance (M,) [K2].
    intensities
        Intensity of each channel, with a segment that starts at ``at_s``.
    at_s
        Time of the candidate [s].
    plain
        Intensity (M,) [K2/s3] without any hidden event. The level without this event lies between
        this value and those of the two segments.
    previous
        Result of an earlier round; the search then stays near it.

    Returns
    -------
    HiddenEvent
        The event with its log odds, most likely form and possibilities.

    Notes
    -----
    Jumps of the temperature have a normal prior whose standard deviation is the range of the trace;
    that of the slope is ``tcdyn.smoothing.state_space.DIFFUSE`` ranges per lag. Each comes with its
    most likely burst. The event time is equally probable anywhere in the record. ``PRIOR`` gives
    the probability of each form in a channel, ``BURST_FIT_NATS`` subtracts what the fit of a burst
    gains from noise alone.

    What may be changed: the numbers of times, if the grid stays finer than the uncertainty of the
    time; ``PRIOR``, if it sums to one and keeps its order: nothing, the two forms of
    ``_coarse_search``, the rough kink, and one gradual jump for each of ``GRADUAL_LAGS``.
    ``tests/smoothing/test_hidden.py`` distinguishes a jump from a kink.
    """
    first, last = influenced_samples(record, at_s, intensities[0].starts_s)
    shift = first * record.dt_s
    dt = record.dt_s
    lag = smearing_time_s(record)
    starts_s = intensities[0].starts_s
    before_s = max([e for e in starts_s if e < at_s], default=0.0)
    after_s = min([e for e in starts_s if e > at_s], default=dt * len(record.y))
    window = _Window(
        segment(record, first, last, record.events_s),
        noise_var,
        [q.shifted(shift_s=shift) for q in without_bursts(intensities, at_s)],
        at_s - shift,
        before_s - shift + dt,
        after_s - shift - dt,
    )
    start_s = window.start_s
    base = window.base
    if previous is None:
        kinds, best_s, u_s = _coarse_search(window, lag)
        kinds.append([replace(b, rough=KINK_ROUGHNESS) for b in kinds[0]])
        best_s.append(best_s[0])
        u_s.append(u_s[0])
    else:
        sudden = previous.kinds[: -len(GRADUAL_LAGS)]
        kinds = [[replace(b, start_s=start_s) for b in kind] for kind in sudden]
        best_s = [start_s] * len(kinds)
        u_s = [2 * previous.u_s + 0.02 * lag] * len(kinds)
    bursts = []
    for kind, time in zip(kinds, best_s):
        shifted = [q.shifted(start_s, time) for q in base]
        zero = [replace(b, start_s=time) for b in kind]
        near = previous is not None and min(b.height for b in kind) > 0
        refined = likeliest_burst(window.record, noise_var, shifted, zero, near)
        bursts.append([replace(b, start_s=start_s) for b in refined])
    for share in GRADUAL_LAGS:
        bursts.append([replace(b, width_s=share * lag) for b in bursts[1]])
        best_s.append(best_s[1])
        u_s.append(u_s[1])
    for _ in range(3):
        # a kink and a jump may have different times
        ranges = [
            np.linspace(t - FINE_REACH_SD * u, t + FINE_REACH_SD * u, FINE_TIMES)
            for t, u in zip(best_s, u_s)
        ]
        times = window.admissible(np.ravel(ranges))
        value = window.values(times, bursts)
        widest = 2 * FINE_REACH_SD * max(u_s) / (FINE_TIMES - 1)
        gaps = np.diff(times, prepend=times[0] - widest, append=times[-1] + widest)
        gaps = np.minimum(gaps, widest)
        width = 0.5 * (gaps[:-1] + gaps[1:])
        for k, total in enumerate(value.sum(axis=0).T):
            if not np.isfinite(total.max()):  # no time is possible for this kind
                continue
            weight = np.exp(total - total.max()) * width
            best_s[k] = float(weight @ times / weight.sum())
            spread = float(np.sqrt(weight @ (times - best_s[k]) ** 2 / weight.sum()))
            u_s[k] = float(np.clip(spread, 0.01 * dt, lag))

    level, without = _level_without_event(window, plain)
    # a channel whose model without event overflows is no evidence for one
    is_possible = np.isfinite(without)
    gain = value - BURST_FIT_NATS - np.where(is_possible, without, 0.0)[:, None, None]
    gain[~is_possible] = -np.inf
    # log of prior times likelihood, relative to no event: (M, times, kinds with "nothing" first)
    log_joint = np.concatenate([np.zeros_like(gain[..., :1]), gain], axis=2) + np.log(PRIOR)
    log_density = logsumexp(log_joint, axis=2)
    log_p = log_density.sum(axis=0) + np.log(width / (record.tested_rows * dt))
    log_odds = float(logsumexp(log_p))
    p = np.exp(log_p - log_odds)
    p_event = p / (1 + np.exp(-log_odds))
    weights = np.exp(log_joint - log_density[..., None]) * p_event[:, None]
    best = int(np.argmax(log_p))
    placed = [
        [tuple(replace(b, start_s=float(t) + shift) for b in kind) for kind in bursts]
        for t in times
    ]
    best_kind = np.argmax(weights[:, best, 1:], axis=1)
    return HiddenEvent(
        at_s=float(times[best]) + shift,
        u_s=float(np.sqrt(p @ (times - p @ times) ** 2)),
        log_odds=log_odds,
        kinds=tuple(placed[best]),
        likeliest=tuple(placed[best][k][c] for c, k in enumerate(best_kind)),
        possibilities=tuple(
            (float(t) + shift, placed[i][k], weights[:, i, k + 1])
            for i, t in enumerate(times)
            for k in range(len(bursts))
            if weights[:, i, k + 1].max() > MIN_WEIGHT
        ),
        no_event_probability=1 - weights[..., 1:].sum(axis=(1, 2)),
        level=level,
    )


def _coarse_search(
    window: _Window, lag: float
) -> tuple[list[list[Burst]], list[float], list[float]]:
    """Best kink and best jump on a coarse grid of times and bursts.

    Parameters
    ----------
    window
        Samples around the event.
    lag
        Time over which a change is smeared [s], see
        ``tcdyn.smoothing.process_noise.smearing_time_s``.

    Returns
    -------
    kinks_and_jumps
        Bursts (M,) of the best kink, and of the best jump.
    times
        Their times [s].
    u_s
        Their uncertainties [s]: half a step of the grid.
    """
    n_channels = len(window.base)
    span_K = channel_spans(window.record, window.noise_var)
    sizes = [(0.0, 1.0), *((0.1 / d**3, d) for d in DECAYS_S)]
    options = []
    for jump in (0.0, 1.0):
        for height, decay_s in sizes:
            options.append(
                [
                    Burst(
                        window.start_s,
                        height * s**2,
                        decay_s,
                        level_sd=jump * s,
                        slope_sd=DIFFUSE * s / lag,
                    )
                    for s in span_K
                ]
            )
    step = 2 * lag / (COARSE_TIMES - 1)
    offsets = step * (np.arange(COARSE_TIMES) - COARSE_TIMES // 2)
    times = window.admissible(window.start_s + offsets)
    value = window.values(times, options).reshape(n_channels, len(times), 2, -1)
    best = np.argmax(logsumexp(value, axis=3).sum(axis=0), axis=0)
    kinds = []
    for k in range(2):
        option = [k * len(sizes) + int(np.argmax(value[c, best[k], k])) for c in range(n_channels)]
        kinds.append([options[i][c] for c, i in enumerate(option)])
    return kinds, [float(t) for t in times[best]], [0.5 * step] * 2


def _level_without_event(window: _Window, plain: Sequence[float]) -> tuple[Array, Array]:
    """Most likely level if there is no event, and its log likelihood.

    Parameters
    ----------
    window
        Samples around the event.
    plain
        Intensity (M,) [K2/s3] without any hidden event.

    Returns
    -------
    level
        Level (M,) [K2/s3], between ``plain`` and those of the two segments.
    value
        Its log likelihood (M,).
    """
    bounds = []
    for q, level in zip(window.base, plain):
        index = q.starts_s.index(window.start_s)
        bounds.append([*q.levels[index - 1 : index + 1], level])
    some = np.array(bounds)
    levels = np.geomspace(some.min(axis=1), some.max(axis=1), FINE_TIMES, axis=1)
    proposals = [
        [_level_across_boundary(q, window.start_s, v) for v in row]
        for q, row in zip(window.base, levels)
    ]
    value = likelihood(window.record, window.noise_var, proposals)[0]
    best = np.argmax(value, axis=1)[:, None]
    return np.take_along_axis(levels, best, axis=1)[:, 0], value.max(axis=1)


def with_likeliest_forms(fit: Smoothed) -> tuple[Smoothed, list[PossibleEvent]]:
    """Smooth again with the most likely form of each listed event, once the intensities are known.

    Parameters
    ----------
    fit
        Smoothed record.

    Returns
    -------
    fit
        Smoothed record with the most likely forms; the ``fit`` given if it has them.
    events
        Listed events that may have another form, for ``average_over_event``.
    """
    intensities = list(fit.intensities)
    uncertain = []
    for at in fit.record.events_s:
        bursts = [b for q in intensities for b in q.bursts if b.start_s == at]
        if len(bursts) < len(intensities):
            continue
        event = _forms_of_listed_event(fit.record, fit.noise_var, intensities, bursts)
        intensities = event.insert(intensities, at, event.most_probable)
        if event.is_uncertain:
            uncertain.append(event)
    if intensities != list(fit.intensities):
        fit = smooth_record(fit.record, fit.noise_var, intensities)
    return fit, uncertain


def _forms_of_listed_event(
    record: Record, noise_var: Array, intensities: Sequence[Intensity], bursts: Sequence[Burst]
) -> PossibleEvent:
    """What a listed event may be: a kink or a jump, each with and without its burst.

    Parameters
    ----------
    record
        The record.
    noise_var
        Noise variance (M,) [K2].
    intensities
        Intensity of each channel (M,).
    bursts
        Its burst at the event (M,).

    Notes
    -----
    A channel gives each form the weight of its likelihood; ``BURST_FIT_NATS`` subtracts what the
    fit of a burst gains from noise alone.
    """
    at_s = bursts[0].start_s
    samples, shift = event_window(record, at_s)
    start_s = at_s - shift
    base = [q.shifted(shift_s=shift) for q in without_bursts(intensities, at_s)]
    window = _Window(samples, noise_var, base, start_s, start_s, start_s)
    jumps_K = (jump_ranges(samples, start_s) * channel_spans(samples, noise_var)).tolist()
    kink = [replace(b, level_sd=0.0) for b in bursts]
    jump = [replace(b, level_sd=jump_K) for b, jump_K in zip(bursts, jumps_K)]
    with_burst = [kink, jump]
    without_burst = [[replace(b, height=0.0) for b in form] for form in with_burst]
    forms = [*with_burst, *without_burst]
    on_clock = [[replace(b, start_s=start_s) for b in form] for form in forms]
    log_weight = window.values(np.array([start_s]), on_clock)[:, 0]
    log_weight[:, : len(with_burst)] -= BURST_FIT_NATS
    has_burst = np.array([b.height > 0 for b in bursts])
    log_weight[~has_burst, : len(with_burst)] = -np.inf  # the same forms as without a burst
    weights = np.exp(log_weight - logsumexp(log_weight, axis=1, keepdims=True)).T
    possibilities = [
        (at_s, tuple(form), weight)
        for form, weight in zip(forms, weights)
        if weight.max() > MIN_WEIGHT
    ]
    return PossibleEvent(at_s, tuple(possibilities))


def average_over_event(
    fit: Smoothed, samples: SmoothedSamples, event: PossibleEvent
) -> SmoothedSamples:
    """Temperature, slope and sd of a record averaged over all that one event may be.

    Parameters
    ----------
    fit
        Smoothed record, with the event in its most likely form.
    samples
        The same at its samples, averaged over other events.
    event
        The event with its possibilities and their weights.

    Returns
    -------
    SmoothedSamples
        ``samples`` with new temperature, slope, lag sensitivity and standard deviations near the
        event.

    Notes
    -----
    The variance is the mean of the variances plus the variance of the means (law of total
    variance). It is at least a quarter of that before. The change of each mean and variance
    relative to ``fit`` is added, so that several events can be averaged one after another. The
    probability of no event counts only above twice ``MIN_WEIGHT``; a smaller ``MIN_WEIGHT`` costs
    time. ``tests/smoothing/test_hidden.py`` (marker ``study``) checks the coverage.
    """
    record = fit.record
    others_s = () if isinstance(event, HiddenEvent) else record.events_s
    first, last = influenced_samples(record, event.at_s, others_s)
    window = segment(record, first, last, record.events_s)
    shift = first * record.dt_s

    def run(intensities: Sequence[Intensity]) -> Array:
        """Temperature, slope, lag sensitivity and two variances (5, n, M) of the window."""
        shifted = [q.shifted(shift_s=shift) for q in intensities]
        part = smooth_record(window, fit.noise_var, shifted).at_samples()
        return _means_and_variances(part)

    start = run(fit.intensities)
    weights = [w for _, _, w in event.possibilities]
    runs = [run(event.insert(fit.intensities, at, bursts)) for at, bursts, _ in event.possibilities]
    if isinstance(event, HiddenEvent) and event.no_event_probability.max() > 2 * MIN_WEIGHT:
        runs.append(run(event.remove(fit.intensities)))
        weights.append(event.no_event_probability)
    weight = np.array(weights) / np.sum(weights, axis=0)
    mean = np.einsum("hm,hknm->knm", weight, np.array(runs))
    totals = _means_and_variances(samples)
    smallest = 0.25 * totals[3:, first:last]
    totals[:, first:last] += mean - start
    temperature, slope, lag_sensitivity, var, slope_var = totals
    spread = np.einsum("hm,hknm->knm", weight, (np.array(runs)[:, :2] - mean[:2]) ** 2)
    var[first:last] = np.maximum(var[first:last] + spread[0], smallest[0])
    slope_var[first:last] = np.maximum(slope_var[first:last] + spread[1], smallest[1])
    return samples._replace(
        temperature=temperature,
        slope=slope,
        lag_sensitivity=lag_sensitivity,
        sd=np.sqrt(var),
        slope_sd=np.sqrt(slope_var),
    )


def _means_and_variances(samples: SmoothedSamples) -> Array:
    """Temperature, slope, lag sensitivity, and the variances of temperature and slope (5, N, M)."""
    means = [samples.temperature, samples.slope, samples.lag_sensitivity]
    return np.stack([*means, samples.sd**2, samples.slope_sd**2])
