"""A record as a linear Gaussian state-space model: its points, likelihood and smoother.

The state is level and slope of the junction temperature and the stages of the chain. White noise
drives the slope and, for a rough temperature, the level. Between two points the transition and the
process noise are exact. Used by :mod:`tcdyn.smoothing.smoother`,
:mod:`tcdyn.smoothing.process_noise`, :mod:`tcdyn.smoothing.roughness` and
:mod:`tcdyn.smoothing.possible_events`; the recursions are :mod:`tcdyn.estimation.kalman`.

``tests/smoothing/test_states.py`` compares likelihood and prior with dense algebra,
``tests/smoothing/test_smoother.py`` the smoothed temperatures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from tcdyn.chain import Sensor
from tcdyn.core import Array, Flags
from tcdyn.estimation.kalman import (
    PointModel,
    filtered_state,
    level_covariance,
    log_likelihood,
    root_of_sum,
    smooth_points,
)
from tcdyn.smoothing.noise_levels import (
    Intensity,
    jumps_at,
    jumps_per_second,
    level_noise_at,
    levels_at,
)
from tcdyn.smoothing.record import FollowedLag, Record

# prior sd of level, slope and slope jumps, in ranges of the record (per lag): diffuse, but well
# scaled; chosen by judgement
DIFFUSE = 10.0
# times that differ by less than this share of a sampling interval are one point (rounding only)
SAME_TIME = 1e-6
# Steps of a sampling interval to which the own times of uneven rows are rounded: an error of 0.5 %
# of the interval (1 sd), below that of any clock that strays.
LATE_STEPS = 64
# Settled filters of a search: covariances, and with them intensities and forms that are compared,
# are exact to a millionth (see ``tcdyn.estimation.kalman.SETTLED``)
SETTLED_IN_SEARCH = 1e-7
# Of a step in which no stage changes by more than itself: nodes that integrate polynomials of
# degree 31 exactly, and terms of which the first one left out is 1 / 20! = 4e-19
GAUSS_NODES = 16
SERIES_TERMS = 20


def channel_ranges(record: Record) -> Array:
    """Range of the good samples of each channel (M,) [K], 1 where there are none."""
    good = [y[w > 0] for y, w in zip(record.y.T, record.weight.T)]
    own = np.array([np.ptp(y) if len(y) else 1.0 for y in good])
    return np.asarray(np.maximum(own, record.least_range_K()))


@dataclass(frozen=True)
class Points:
    """Points in time of the model of one channel: samples, readings and events.

    Attributes
    ----------
    time_s
        Times (P,) [s].
    kind
        Kind of the step after each point (P,).
    step_s
        Length of each kind of step (K,) [s].
    starts_mean
        Whether a mean of the logger starts or ends before each kind of step (K,).
    reading
        Index (N,) of the point that each sample reads: its time minus the dead time.
    sample
        Index (N,) of the point at each sample.
    """

    time_s: Array
    kind: NDArray[np.int64]
    step_s: Array
    starts_mean: Flags
    reading: NDArray[np.intp]
    sample: NDArray[np.intp]

    def at(self, time_s: Array) -> NDArray[np.intp]:
        """Index of the points at times that are points."""
        middles_s = 0.5 * (self.time_s[1:] + self.time_s[:-1])
        return np.asarray(np.searchsorted(middles_s, time_s))


def points_of(record: Record, events_s: Sequence[float], sensor: Sensor | None = None) -> Points:
    """The points of a channel.

    Parameters
    ----------
    record
        The record.
    events_s
        Times of listed events and of changes [s].
    sensor
        State space of the channel; None: its readings are those of an instant, without a dead time.

    Notes
    -----
    A sample reads the state at its time minus the dead time, so the dead time is exact. An event
    takes the place of a sample at the same time. Of a record with a start, the readings of states
    before it have no point of their own: they are part of the start, and so are the starts of means
    before it.
    """
    dt = record.dt_s
    read_s = read_times_s(record, sensor)
    mean_starts_s = np.empty(0)
    own_s = np.empty(0)
    if sensor is not None and sensor.mean_s:
        mean_starts_s = _mean_starts_s(read_s, sensor)
    if sensor is not None and (sensor.mean_s or sensor.delay_s):
        # means of uneven rows were moved to even times, and with a dead time a row reads an
        # earlier state; the results are wanted at the times of the rows
        own_s = read_times_s(record)
    first_s = 0.0
    if record.start is None:
        first_s = float(min(read_s.min(), mean_starts_s.min(initial=np.inf)))
    mean_starts_s = mean_starts_s[mean_starts_s > first_s - SAME_TIME * dt]
    own_s = np.maximum(own_s, first_s)
    last_s = (len(record.y) - 1) * dt
    inside = sorted({e for e in events_s if first_s < e < last_s})
    is_instant = sensor is None or not (sensor.delay_s or sensor.mean_s)
    if not inside and is_instant and record.late_s is None:
        return _points_of_samples(len(record.y), dt)
    sample_s = dt * np.arange(len(record.y), dtype=np.float64)
    used_s = np.maximum(read_s, first_s)
    lists: list[Array] = [np.array(inside, dtype=float), sample_s, used_s, mean_starts_s, own_s]
    time_s = np.concatenate(lists)
    # of times that are nearly the same the first counts, which is that of an event
    order = np.argsort(time_s, kind="stable")
    is_new = np.diff(time_s[order], prepend=-np.inf) > SAME_TIME * dt
    group = np.cumsum(is_new) - 1
    representative = np.full(int(group[-1]) + 1, len(time_s))
    np.minimum.at(representative, group, order)
    point_s = time_s[representative]
    point_of_time = np.empty(len(time_s), dtype=np.intp)
    point_of_time[order] = group
    ends = np.cumsum([len(times) for times in lists])
    _, sample, reading, of_mean_starts, _ = np.split(point_of_time, ends[:-1])
    starts_mean = np.zeros(len(point_s), dtype=bool)
    starts_mean[of_mean_starts] = True
    steps = np.round(np.diff(point_s) / dt, 6)
    # kinds of steps differ in length, or in whether a mean starts: then the number is negative
    kinds, kind = np.unique(np.where(starts_mean[:-1], -steps, steps), return_inverse=True)
    return Points(
        point_s,
        np.append(kind, kind[-1]).astype(np.int64),
        np.abs(kinds) * dt,
        kinds < 0,
        reading,
        sample,
    )


def _mean_starts_s(read_s: Array, sensor: Sensor) -> Array:
    """Times [s] of the start of each mean, and of the rows within it.

    Parameters
    ----------
    read_s
        Times (N,) [s] of the states that the samples read.
    sensor
        State space of a channel whose rows are means.
    """
    row_s = sensor.mean_s / sensor.mean_rows
    before_s = sensor.mean_s - row_s * np.arange(sensor.mean_rows)
    return np.asarray((read_s[:, None] - before_s).ravel())


@lru_cache(maxsize=16)
def _points_of_samples(count: int, dt_s: float) -> Points:
    """The points of a channel without dead time and events: each sample is one."""
    index = np.arange(count)
    time_s = dt_s * np.arange(count, dtype=np.float64)
    one_kind = np.zeros(count, dtype=np.int64)
    return Points(time_s, one_kind, np.array([dt_s]), np.zeros(1, dtype=bool), index, index)


def steps_of(sensor: Sensor, step_s: float) -> tuple[Array, Array, Array]:
    """Transition of a step, and its process noise for intensities of one.

    Parameters
    ----------
    sensor
        State space of a chain, n states.
    step_s
        Length of the step [s].

    Returns
    -------
    transition
        expm(drift step_s) (n, n).
    level_noise, slope_noise
        Covariances (n, n) at the end of the step: the integrals of expm(drift t) e e'
        expm(drift t)' over the step, with e the level or the slope.

    Notes
    -----
    Of a short step the integral is a sum over the nodes of Gauss and Legendre, with the power
    series of expm(drift t) e: both keep the relative accuracy of stages that hardly move in the
    step. Doubling the step adds positive terms only, so that no stage may be too fast. The result
    is cached, because channels and windows share chains and steps.
    """
    return _cached_steps(sensor.drift.tobytes(), len(sensor.drift), round(step_s, 12))


@lru_cache(maxsize=20_000)
def _cached_steps(drift_bytes: bytes, n: int, step_s: float) -> tuple[Array, Array, Array]:
    """The matrices of ``steps_of``, by the bytes of the drift, which the cache can compare."""
    drift = np.frombuffer(drift_bytes).reshape(n, n)
    size = float(np.abs(drift).sum(axis=1).max()) * step_s
    doublings = max(int(np.ceil(np.log2(max(size, 1.0)))), 0)
    short_s = step_s / 2**doublings
    transition = np.asarray(expm(drift * short_s))
    shares, weights = _gauss_rule()
    noises = []
    for state in (0, 1):
        term = np.eye(n)[state]
        terms = [term]
        for power in range(1, SERIES_TERMS):
            term = drift @ term * (short_s / power)
            terms.append(term)
        moved = shares @ np.array(terms)
        noises.append((moved.T * (0.5 * short_s * weights)) @ moved)
    for _ in range(doublings):
        noises = [noise + transition @ noise @ transition.T for noise in noises]
        transition = transition @ transition
    level_noise, slope_noise = (0.5 * (noise + noise.T) for noise in noises)
    for matrix in (transition, level_noise, slope_noise):
        matrix.setflags(write=False)
    return transition, level_noise, slope_noise


@cache
def _gauss_rule() -> tuple[Array, Array]:
    """Powers (nodes, terms) of the times of the nodes as shares of a step, and weights (nodes,)."""
    nodes, weights = np.polynomial.legendre.leggauss(GAUSS_NODES)
    return (0.5 * (1.0 + nodes))[:, None] ** np.arange(SERIES_TERMS), weights


def point_models(
    record: Record,
    channel: int,
    noise_var: float,
    proposals: Sequence[Intensity],
    span: float,
) -> tuple[Points, list[PointModel]]:
    """The model of one channel for each of some proposed intensities.

    Parameters
    ----------
    record
        The record of N samples.
    channel
        Index of the channel.
    noise_var
        Noise variance [K2].
    proposals
        Proposed intensities, whose changes start at the same times.
    span
        The ``channel_ranges`` of the channel [K].

    Returns
    -------
    points
        The points.
    models
        A model for each proposal.

    Notes
    -----
    The process noise of a step has the intensity at its start. Jumps act at the end of the
    step before an event. At a row the integrals of a mean pass on before the step.
    """
    sensor = record.sensors[channel]
    weight = record.weight[:, channel]
    reading = record.y[:, channel]
    changes = {change.start_s for q in proposals for change in q.changes}
    events_s = [*record.events_s, *changes]
    points = points_of(record, events_s, sensor)
    count = len(points.time_s)
    followed = record.followed[channel] if record.followed else None
    of_steps = [sensor] * len(points.step_s)
    if followed is not None:
        points, of_steps = _with_followed_lag(points, followed, record.dt_s)
        sensor = followed.sensors[followed.of_step[0]]
    step_matrices = [steps_of(each, step_s) for each, step_s in zip(of_steps, points.step_s)]
    transition, level_unit, slope_unit = (np.array(kinds) for kinds in zip(*step_matrices))
    transition[points.starts_mean] = transition[points.starts_mean] @ sensor.at_row
    read = np.zeros(count)
    variance = np.zeros(count)
    is_good = weight > 0
    if record.start is not None:
        is_good &= ~reads_before(record, sensor)
    read[points.reading[is_good]] = reading[is_good]
    variance[points.reading[is_good]] = noise_var / weight[is_good]
    good = reading[is_good]
    start_level = float(good[0]) if len(good) else 0.0
    start_s = np.maximum(points.time_s[:1], 0.0)
    start_intensity = levels_at(proposals, start_s)[:, 0]
    start_level_noise = level_noise_at(proposals, start_s)[:, 0]
    # events may be just before the record, too
    duration_s = record.dt_s * len(reading)
    of_jumps = jumps_per_second(proposals, duration_s)
    start_level_noise += of_jumps[:, 0]
    start_intensity += of_jumps[:, 1]
    range_K = max(span, 10 * float(np.sqrt(noise_var)))
    slope_noise = levels_at(proposals, points.time_s[:-1])
    is_rough = any(q.is_rough for q in proposals)
    level_noise = np.zeros_like(slope_noise)
    if is_rough:
        at_points = level_noise_at(proposals, points.time_s)
        level_noise = 0.5 * (at_points[:, :-1] + at_points[:, 1:])
    jumps = np.moveaxis(jumps_at(proposals, points.time_s), 1, 0)  # (Q, P, 4)
    wide = slope_prior_sd(sensor, range_K, record.dt_s)
    of_any_slope = [event for event in record.events_s if event not in changes]
    jumps[:, np.isin(points.time_s, of_any_slope), 1] += wide**2
    is_sample = np.zeros(count, dtype=bool)
    is_sample[points.sample] = True
    # samples, readings and starts of means alternate where the dead time or the time of the mean is
    # no multiple of the sampling interval
    period = int(count / len(reading) + 0.5)
    models = []
    priors: dict[tuple[float, float], tuple[Array, Array]] = {}
    for k, intensity_at_start in enumerate(
        zip(start_intensity.tolist(), start_level_noise.tolist())
    ):
        if record.start is not None:
            prior = record.start.means[channel], record.start.factors[channel]
        elif intensity_at_start in priors:
            prior = priors[intensity_at_start]
        else:
            prior = ramp_prior(sensor, start_level, range_K, record.dt_s, *intensity_at_start)
            priors[intensity_at_start] = prior
        models.append(
            PointModel(
                transition,
                level_unit,
                slope_unit,
                points.kind,
                np.append(level_noise[k], 0.0),
                np.append(slope_noise[k], 0.0),
                np.concatenate([jumps[k, 1:], np.zeros((1, 4))]),
                np.ascontiguousarray(sensor.ramp[:, 0]),
                np.ascontiguousarray(sensor.drift[:, 0]),
                sensor.output,
                read,
                variance,
                *prior,
                is_sample,
                period,
            )
        )
    return points, models


def _first_lag_s(sensor: Sensor) -> float:
    """The first lag [s] of a state space."""
    return float(-1.0 / sensor.drift[2, 2])


def _with_followed_lag(
    points: Points, followed: FollowedLag, dt_s: float
) -> tuple[Points, list[Sensor]]:
    """Points whose kinds of steps also differ in the lag, and the state space of each kind.

    Steps between two samples have the lag of the step from sample to sample.
    """
    sample = np.floor(points.time_s / dt_s + SAME_TIME).astype(int)
    of_point = followed.of_step[np.clip(sample, 0, len(followed.of_step) - 1)]
    pairs, kind = np.unique(np.column_stack([points.kind, of_point]), axis=0, return_inverse=True)
    of_kind, of_lag = pairs.T
    changed = replace(
        points,
        kind=kind.astype(np.int64).ravel(),
        step_s=points.step_s[of_kind],
        starts_mean=points.starts_mean[of_kind],
    )
    return changed, [followed.sensors[k] for k in of_lag.tolist()]


def reads_before(record: Record, sensor: Sensor) -> Flags:
    """Samples (N,) whose readings are of a state before the first sample.

    Parameters
    ----------
    record
        The record.
    sensor
        State space of the channel.
    """
    return read_times_s(record, sensor) < -SAME_TIME * record.dt_s


def read_times_s(record: Record, sensor: Sensor | None = None) -> Array:
    """Times (N,) [s] of the states that the samples read.

    How late a reading was taken is rounded to a share of the sampling interval, so that steps of
    the same length are found equal.

    Parameters
    ----------
    record
        The record.
    sensor
        State space of the channel, with its dead time; rows that are means were moved to the
        samples. None: the times at which the rows were taken.
    """
    dt = record.dt_s
    delay_s = 0.0 if sensor is None else sensor.delay_s
    sample_s = dt * np.arange(len(record.y), dtype=np.float64)
    if record.late_s is None or (sensor is not None and sensor.mean_s):
        return np.asarray(sample_s - delay_s)
    late_s = np.round(record.late_s / dt * LATE_STEPS) * dt / LATE_STEPS
    return np.asarray(sample_s + late_s - delay_s)


def slope_prior_sd(sensor: Sensor, span: float, dt_s: float) -> float:
    """Prior standard deviation [K/s] of the slope, and of a jump of the slope at a listed event.

    Parameters
    ----------
    sensor
        State space of the chain.
    span
        Range of the record [K].
    dt_s
        Sampling interval [s].

    Notes
    -----
    It is ``DIFFUSE`` ranges in one lag plus four samples.
    """
    return DIFFUSE * span / (sensor.lag_s + 4 * dt_s)


def ramp_prior(
    sensor: Sensor,
    level: float,
    span: float,
    dt_s: float,
    intensity: float,
    level_noise: float = 0.0,
) -> tuple[Array, Array]:
    """Prior of the state of a chain that has always followed a ramp.

    Parameters
    ----------
    sensor
        State space of the chain, n states.
    level
        Level [degC] about which the prior is centred; the slope is about zero.
    span
        Range of the record [K].
    dt_s
        Sampling interval [s].
    intensity
        Intensity [K2/s3] of the slope noise that makes the stages scatter about the ramp.
    level_noise
        Intensity [K2/s] of the level noise that does so, too.

    Returns
    -------
    mean
        Prior mean (n,).
    factor
        Lower triangular square root (n, n) of the prior covariance.

    Notes
    -----
    The level has the standard deviation ``DIFFUSE`` ranges, the slope that of ``slope_prior_sd``.
    With a smaller ``DIFFUSE`` the prior would pull the first temperatures to the first good
    reading; with a much larger one rounding errors grow. ``tests/smoothing/test_states.py``
    states these values.
    """
    wide = np.array([DIFFUSE * span, slope_prior_sd(sensor, span, dt_s)])
    scatter = intensity * sensor.scatter + level_noise * sensor.level_scatter
    return level * sensor.ramp[:, 0], root_of_sum(sensor.ramp * wide, _root(scatter))


def _root(covariance: Array) -> Array:
    """A square root (n, n) of a covariance (n, n) that may be singular."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def likelihood(
    record: Record, noise_var: Array, proposals: Sequence[Sequence[Intensity]]
) -> tuple[Array, Array]:
    """Log likelihood of proposed intensities at the given noise variance.

    Parameters
    ----------
    record
        The record.
    noise_var
        Noise variance of each channel (M,) [K2].
    proposals
        Q proposed intensities for each channel.

    Returns
    -------
    value
        Log likelihood (M, Q) without the constant -n/2 log(2 pi) of n samples; minus infinity where
        the intensity is so far from the data that the filter overflows.
    ratio
        Factor (M, Q) by which the noise variance would have to change so that the chi-square equals
        the number of samples minus two minus the number of events.

    Notes
    -----
    Prior mean and covariance are those of ``ramp_prior``. ``tests/smoothing/test_states.py``
    compares both results with the dense covariance of all samples.
    """
    span = channel_ranges(record)
    value, chi2 = np.empty((2, len(noise_var), len(proposals[0])))
    for c, proposed in enumerate(proposals):
        for same_times, index in _by_change_times(proposed):
            _, models = point_models(record, c, float(noise_var[c]), same_times, float(span[c]))
            for k, model in zip(index, models):
                value[c, k], chi2[c, k] = log_likelihood(model, SETTLED_IN_SEARCH)
    n_samples = (record.weight > 0).sum(axis=0)
    ratio = chi2 / np.maximum(n_samples - 2 - len(record.events_s), 1)[:, None]
    is_lost = ~np.isfinite(value)
    value[is_lost] = -np.inf
    ratio[is_lost] = 1.0
    return value, ratio


def _by_change_times(
    proposals: Sequence[Intensity],
) -> list[tuple[list[Intensity], list[int]]]:
    """Proposals whose changes start at the same times, and their indices."""
    groups: dict[frozenset[float], tuple[list[Intensity], list[int]]] = {}
    for k, q in enumerate(proposals):
        starts = frozenset(change.start_s for change in q.changes)
        members, index = groups.setdefault(starts, ([], []))
        members.append(q)
        index.append(k)
    return list(groups.values())


class SmoothedSamples(NamedTuple):
    """A smoothed record at its samples (N, M).

    Parameters
    ----------
    temperature, sd
        Temperature [degC] and its standard deviation [K].
    slope, slope_sd
        Its rate of change [K/s], the mean over one sampling interval around the sample, and the
        standard deviation of that.
    lag_sensitivity, lag_split_sensitivity
        Sensitivity to the lag [K/s] and to its division into parts [K/s2], see ``Sensor``.
    """

    temperature: Array
    sd: Array
    slope: Array
    slope_sd: Array
    lag_sensitivity: Array
    lag_split_sensitivity: Array


@dataclass(frozen=True)
class Smoothed:
    """A smoothed record: states at its samples and events given all samples.

    Parameters
    ----------
    record, noise_var, intensities
        The record, its noise variance (M,) [K2] and the intensity of each channel.
    times_s
        Times (J,) [s] of the samples and events.
    sample
        Index (N,) of the samples in ``times_s``.
    own
        Index (N,) of the times of the readings in ``times_s``: those of the samples, but for
        uneven rows.
    level, slope
        Temperature [degC] and slope [K/s] (J, M).
    var
        Their covariance (3, J, M): variance of the level, covariance, variance of the slope.
    change_var
        Variance (N, M, 2) [K2] of the change of the temperature to the next sample, and to the one
        after that.
    lag_change, split_change
        Sensitivity to the lag [K/s] and to its division into parts [K/s2] (J, M), see ``Sensor``.
    jump_chi2
        Score test (J, M) for a jump of level, slope or both: chi-square with two degrees of freedom
        if there is none.
    score, score_var
        Adjoint (J, M, 3) of level [1/K], slope [s/K] and a step of the reading [1/K]; and, if the
        intensities are right, variance of the first, covariance, variance of the second and of the
        third (J, M, 4). The derivative of the log likelihood with respect to the variance of a jump
        there is half of the square of the adjoint less its variance.
    gradient, expected
        For level and slope noise of the steps before each time (J, M, 2): twice the derivative of
        the log likelihood with respect to the intensity is ``gradient - expected``; they are equal
        on average if the intensities are right.
    predicted, predicted_var
        Predicted reading without noise (N, M) [degC], and its variance [K2].
    """

    record: Record
    noise_var: Array
    intensities: tuple[Intensity, ...]
    times_s: Array
    sample: NDArray[np.intp]
    own: NDArray[np.intp]
    level: Array
    slope: Array
    var: Array
    change_var: Array
    lag_change: Array
    split_change: Array
    jump_chi2: Array
    score: Array
    score_var: Array
    gradient: Array
    expected: Array
    predicted: Array
    predicted_var: Array

    def at_samples(self) -> SmoothedSamples:
        """Temperature, slope, standard deviation and sensitivities at the samples.

        The temperature is that at the time at which the reading was taken.
        """
        rate, rate_var = self._rates()
        return SmoothedSamples(
            self.level[self.own],
            np.sqrt(self.var[0, self.own]),
            rate,
            np.sqrt(rate_var),
            self.lag_change[self.own],
            self.split_change[self.own],
        )

    def _rates(self) -> tuple[Array, Array]:
        """Rate of change (N, M) [K/s] at the samples and its variance.

        It is the mean over one sampling interval around each sample. The noise that drives the
        level itself has no rate at an instant.

        Notes
        -----
        Half of the interval lies before the sample and half after it. Given the temperatures at
        samples, that of the middle between two of them is their mean but for level noise, which
        adds the variance p dt / 4 (Brownian bridge), p the intensity. An interval with an event,
        where slope or level may jump, counts only where the other one has an event, too. It and the
        other one then both stand for all of the interval around the sample.
        """
        dt = self.record.dt_s
        first, last = self.sample[:-1], self.sample[1:]
        level = self.level[self.sample]
        rate = np.diff(level, axis=0) / dt
        var_one = self.change_var[:-1, :, 0] / dt**2
        time_s = self.times_s[self.sample]
        noise = np.stack([level_noise_at([q], time_s)[0] for q in self.intensities], axis=1)
        changes = [b.start_s for q in self.intensities for b in q.changes if b.width_s == 0]
        is_event = np.isin(self.times_s, [*self.record.events_s, *changes])
        count = np.cumsum(is_event)
        is_usual = count[last] == count[first]  # no event after its start, up to its end
        before = np.concatenate([[False], is_usual])
        after = np.concatenate([is_usual, [False]])
        is_between_events = ~before & ~after
        before[1:] |= is_between_events[1:]
        after[:-1] |= is_between_events[:-1]
        both = (before & after)[:, None]
        rate_before = np.concatenate([rate[:1], rate])
        rate_after = np.concatenate([rate, rate[-1:]])
        one_side = np.where(after[:, None], rate_after, rate_before)
        var_before = np.concatenate([var_one[:1], var_one])
        var_after = np.concatenate([var_one, var_one[-1:]])
        one_side_var = np.where(after[:, None], var_after, var_before)
        var_two = np.zeros_like(level)
        var_two[1:-1] = self.change_var[:-2, :, 1] / (2 * dt) ** 2 + 0.5 * noise[1:-1] / dt
        return (
            np.where(both, 0.5 * (rate_before + rate_after), one_side),
            np.where(both, var_two, one_side_var),
        )


def smooth_record(record: Record, noise_var: Array, intensities: Sequence[Intensity]) -> Smoothed:
    """Smooth the full record, given noise variance and intensities.

    Parameters
    ----------
    record
        The record.
    noise_var
        Noise variance (M,) [K2].
    intensities
        One intensity for each channel.

    Returns
    -------
    Smoothed
        States at samples and events, predicted readings, and the score test for jumps.

    Notes
    -----
    The score test for a jump of level and slope at a time is q' W^-1 q, with the adjoint q and its
    variance W (as in de Jong and Penzer 1998).
    """
    (n_samples, n_channels) = record.y.shape
    changes = {b.start_s for q in intensities for b in q.changes}
    common = points_of(record, [*record.events_s, *(b for b in changes if b > 0)])
    count = len(common.time_s)
    level, slope, lag_change, split_change, jump_chi2 = np.empty((5, count, n_channels))
    change_var = np.empty((n_samples, n_channels, 2))
    var = np.empty((3, count, n_channels))
    gradient, expected = np.empty((2, count, n_channels, 2))
    score = np.empty((count, n_channels, 3))
    score_var = np.empty((count, n_channels, 4))
    predicted, predicted_var = np.empty((2, n_samples, n_channels))
    span = channel_ranges(record)
    for c, (sensor, q) in enumerate(zip(record.sensors, intensities)):
        points, (model,) = point_models(record, c, float(noise_var[c]), [q], float(span[c]))
        smoothed = smooth_points(model, np.stack([sensor.lag_row, sensor.split_row]))
        at: NDArray[np.intp] | slice = slice(None)
        if len(points.time_s) == count:
            gradient[:, c] = smoothed.gradient
            expected[:, c] = smoothed.expected
        else:
            at = points.at(common.time_s)
            # points between two common times are readings of a channel with a dead time
            before = np.concatenate([[0], at[:-1] + 1])
            gradient[:, c] = np.add.reduceat(smoothed.gradient, before)
            expected[:, c] = np.add.reduceat(smoothed.expected, before)
        level[:, c], slope[:, c] = smoothed.mean[at].T
        var[:, :, c] = smoothed.covariance[at].T
        lag_change[:, c], split_change[:, c] = smoothed.extra[at].T
        followed = record.followed[c] if record.followed else None
        if followed is not None:
            lag_change[:, c] *= _first_lag_s(sensor) / followed.at(common.time_s, record.dt_s)
        change_var[:, c] = smoothed.change_var[points.sample]
        predicted[:, c] = smoothed.predicted[points.reading]
        predicted_var[:, c] = smoothed.predicted_var[points.reading]
        score[:, c] = smoothed.score[at]
        score_var[:, c] = smoothed.score_var[at]
        level_var, cross, slope_var, _ = score_var[:, c].T
        level_score, slope_score, _ = score[:, c].T
        product = level_var * slope_var
        determinant = np.maximum(product - cross**2, 1e-9 * product + 1e-300)
        quadratic = (
            level_score**2 * slope_var
            - 2 * level_score * slope_score * cross
            + slope_score**2 * level_var
        )
        jump_chi2[:, c] = quadratic / determinant
    return Smoothed(
        record,
        noise_var,
        tuple(intensities),
        common.time_s,
        common.sample,
        common.reading,
        level,
        slope,
        var,
        change_var,
        lag_change,
        split_change,
        jump_chi2,
        score,
        score_var,
        gradient,
        expected,
        predicted,
        predicted_var,
    )


def predicted_readings(
    record: Record, noise_var: Array, intensities: Sequence[Intensity]
) -> tuple[Array, Array]:
    """Predicted readings without noise given all samples, as of ``smooth_record``, in less time.

    Parameters
    ----------
    record
        The record.
    noise_var
        Noise variance (M,) [K2].
    intensities
        One intensity for each channel.

    Returns
    -------
    predicted, predicted_var
        Predicted reading (N, M) [degC] and its variance [K2].
    """
    predicted, predicted_var = np.empty((2, *record.y.shape))
    span = channel_ranges(record)
    for c, q in enumerate(intensities):
        points, (model,) = point_models(record, c, float(noise_var[c]), [q], float(span[c]))
        smoothed = smooth_points(model, with_scores=False, tolerance=SETTLED_IN_SEARCH)
        predicted[:, c] = smoothed.predicted[points.reading]
        predicted_var[:, c] = smoothed.predicted_var[points.reading]
    return predicted, predicted_var


def state_at(fit: Smoothed, sample: int) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    """States of all channels at a sample given the readings of states before it.

    Parameters
    ----------
    fit
        The smoothed record.
    sample
        Index of the sample.

    Returns
    -------
    means, factors
        As the fields of ``Start``.
    """
    record = fit.record
    span = channel_ranges(record)
    means = []
    factors = []
    for c, q in enumerate(fit.intensities):
        points, (model,) = point_models(record, c, float(fit.noise_var[c]), [q], float(span[c]))
        mean, factor = filtered_state(model, int(points.sample[sample]))
        means.append(mean)
        factors.append(factor)
    return tuple(means), tuple(factors)


def sample_covariance(
    record: Record, noise_var: Array, intensity: Intensity, first: int, last: int
) -> Array:
    """Covariance (c, c) [K2] of the temperatures of a channel at the samples of a window.

    Parameters
    ----------
    record
        A record of one channel: the window and margins in which the smoother settles.
    noise_var
        Noise variance (1,) [K2].
    intensity
        The intensity.
    first, last
        First sample of the window, and one past the last.
    """
    span = channel_ranges(record)
    points, (model,) = point_models(record, 0, float(noise_var[0]), [intensity], float(span[0]))
    sample = points.sample[first:last]
    covariance = level_covariance(model, int(sample[0]), int(sample[-1]) + 1)
    index = sample - sample[0]
    return np.asarray(covariance[np.ix_(index, index)])
