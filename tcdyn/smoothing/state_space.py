"""A record as a linear Gaussian state-space model: Kalman filter, likelihood and smoother.

The state is level and slope of the junction temperature and the stages of the chain; the slope is a
random walk with the intensity q(t). Samples are collected in time intervals (see
:mod:`tcdyn.smoothing.intervals`), within which the process noise acts at the knots only. Used by
:mod:`tcdyn.smoothing.smoother`, :mod:`tcdyn.smoothing.process_noise` and
:mod:`tcdyn.smoothing.hidden_events`; ``flow`` also by the live smoother.

``tests/smoothing/test_states.py`` compares likelihood and prior with dense algebra,
``tests/smoothing/test_smoother.py`` the smoothed temperatures.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

from tcdyn.chain import Sensor
from tcdyn.core import Array, Flags
from tcdyn.smoothing.intervals import FINE, STEPS, chunks, knots_for
from tcdyn.smoothing.noise_levels import (
    Intensity,
    jumps_at,
    level_noise_at,
    levels_at,
    levels_between,
)
from tcdyn.smoothing.record import Record
from tcdyn.smoothing.rts import IntervalModel, rts_smooth

# prior sd of level, slope and slope jumps, in ranges of the record (per lag): diffuse, but well
# scaled; chosen by judgement
DIFFUSE = 10.0


def channel_ranges(record: Record) -> Array:
    """Range of the good samples of each channel (M,) [K], 1 where there are none."""
    good = [y[w > 0] for y, w in zip(record.y.T, record.weight.T)]
    return np.array([np.ptp(y) if len(y) else 1.0 for y in good])


def interval_model(
    record: Record,
    noise_var: Array,
    proposals: Sequence[Sequence[Intensity]],
    knots: Array,
    span: Array,
) -> IntervalModel:
    """The model on the intervals between ``knots``.

    Parameters
    ----------
    record
        The record of N samples.
    noise_var
        Noise variance of each channel (M,) [K2].
    proposals
        Q proposed intensities for each channel.
    knots
        Knots (J + 1,) [s]: some or all of those from ``tcdyn.smoothing.intervals.knots_for``.
        Samples in no interval are left out.
    span
        The ``channel_ranges`` (M,) [K] of the full record.

    Returns
    -------
    IntervalModel
        Information and score of the samples, transitions, and the process noise at each knot.

    Notes
    -----
    Intervals that have one length and the samples at the same phase are of one kind, so that their
    transition and rows are computed once. Half of the process noise of an interval is added to the
    slope at its first knot, half at the next (trapezoidal rule): this is exact only for short
    intervals, hence ``tcdyn.smoothing.intervals.FINE``. A sample at time t reads the state at t
    minus the dead time, so the dead time is exact.

    What may be changed: the tolerances 1e-6 of a sample are rounding only; those of
    ``tcdyn.smoothing.intervals.knots_for``, ``smooth_record`` and
    ``tcdyn.smoothing.smoother.window_covariance`` must assign samples to the same intervals. The
    chunks of a record have equal results only if ``span`` is that of the full record
    (``tests/smoothing/test_smoother.py``).
    """
    dt = record.dt_s
    n_samples = len(record.y)
    features = np.round(np.column_stack([np.diff(knots) / dt, (knots[:-1] / dt) % 1.0]), 6)
    features[:, 1] %= 1.0
    _, example, kind = np.unique(features, axis=0, return_index=True, return_inverse=True)
    kind = kind.reshape(-1)
    event: Flags = np.isin(knots[:-1], record.events_s)
    channels: list[tuple[Array, ...]] = []
    rows = []
    for c, s in enumerate(record.sensors):
        first = np.ceil((knots + s.delay_s) / dt - 1e-6).astype(int)
        low, high = np.clip(first[[0, -1]], 0, n_samples)
        weight = record.weight[low:high, c]
        trace = record.y[low:high, c]
        n = len(s.output)
        w = np.append(weight / noise_var[c], 0.0)
        weighted = np.append(weight * trace / noise_var[c], 0.0)
        information_c = np.zeros((len(kind), n, n))
        score_c = np.zeros((len(kind), n))
        rows_c = []
        for k, j in enumerate(example):
            if first[j + 1] <= first[j]:
                continue
            first_sample_s = first[j] * dt - s.delay_s - knots[j]
            powers = flows(s.drift, dt)[: first[j + 1] - first[j]]
            output_rows = s.output @ flow(s.drift, first_sample_s) @ powers
            intervals = np.flatnonzero(kind == k)
            sample = first[intervals][:, None] + np.arange(len(output_rows))
            inside = (sample >= low) & (sample < high)
            index = np.where(inside, sample - low, high - low)
            information_c[intervals] = (w[index] @ _squares(output_rows)).reshape(-1, n, n)
            score_c[intervals] = weighted[index] @ output_rows
            rows_c.append((intervals, output_rows, np.where(inside, sample, n_samples)))
        good = trace[weight > 0]
        level = float(good[0]) if len(good) else 0.0
        integral = levels_between(proposals[c], knots).T
        min_span = 10 * float(np.sqrt(noise_var[c]))
        start_intensity = levels_at(proposals[c], np.maximum(knots[:1], 0.0))[:, 0]
        start_level_noise = level_noise_at(proposals[c], np.maximum(knots[:1], 0.0))[:, 0]
        mean, cov, jump_var = ramp_prior(
            s, level, max(float(span[c]), min_span), dt, start_intensity, start_level_noise
        )
        at_knot = _half_around_knots(integral)
        at_knot[event] += jump_var
        jumps = jumps_at(proposals[c], knots[:-1])
        jumps[..., 1] += at_knot
        if any(q.is_rough for q in proposals[c]):
            level_noise = level_noise_at(proposals[c], knots[:-1]).T
            jumps[..., 0] += _half_around_knots(level_noise * np.diff(knots)[:, None])
        channels.append(
            (np.tile(mean, (len(cov), 1)), cov, information_c[:, None], score_c[:, None], jumps)
        )
        rows.append(tuple(rows_c))
    lengths = np.diff(knots)[example]
    flows_by_length = [[flow(s.drift, float(h)) for s in record.sensors] for h in lengths]
    transition = np.array(flows_by_length)[:, :, None]
    mean0, cov0, information, score, jumps_var = zip(*channels)
    return IntervalModel(
        knots,
        kind,
        np.stack(mean0),
        np.stack(cov0),
        transition,
        np.stack(information, axis=1),
        np.stack(score, axis=1),
        np.stack(jumps_var, axis=1),
        tuple(rows),
    )


def _half_around_knots(integral: Array) -> Array:
    """Half of the ``integral`` (J, Q) over the intervals beside each knot but the last."""
    before = np.concatenate([np.zeros_like(integral[:1]), integral[:-1]])
    return np.asarray(0.5 * (integral + before))


def _squares(rows: Array) -> Array:
    """Outer products o o' of the rows o of ``rows`` (R, n), flattened to (R, n n)."""
    return (rows[:, :, None] * rows[:, None, :]).reshape(len(rows), -1)


def full_model(
    record: Record, noise_var: Array, proposals: Sequence[Sequence[Intensity]], fine: float = FINE
) -> IntervalModel:
    """The model on all intervals of the record.

    Parameters
    ----------
    record, noise_var, proposals
        As for ``interval_model``.
    fine
        Largest length of an interval times the corner frequency [rad].
    """
    return interval_model(
        record,
        noise_var,
        proposals,
        knots_for(record, noise_var, proposals, fine),
        channel_ranges(record),
    )


def ramp_prior(
    sensor: Sensor,
    level: float,
    span: float,
    dt_s: float,
    intensity: Array,
    level_noise: Array | float = 0.0,
) -> tuple[Array, Array, float]:
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
        Intensity (Q,) [K2/s3] of the slope noise that makes the stages scatter about the ramp.
    level_noise
        Intensity (Q,) [K2/s] of the level noise that does so, too.

    Returns
    -------
    mean
        Prior mean (n,).
    cov
        Prior covariances (Q, n, n).
    slope_var
        Prior variance of the slope [K2/s2]; also that of a jump of the slope at a listed event.

    Notes
    -----
    The level has the standard deviation ``DIFFUSE`` ranges, the slope as much in one lag plus four
    samples. With a smaller ``DIFFUSE`` the prior would pull the first temperatures to the first
    good reading; with a much larger one rounding errors grow. The same scale is the prior of hidden
    events in ``tcdyn.smoothing.hidden_events._coarse_search``. ``tests/smoothing/test_states.py``
    states these values.
    """
    wide = DIFFUSE * span * np.array([1.0, 1.0 / (sensor.lag_s + 4 * dt_s)])
    cov = sensor.ramp * wide**2 @ sensor.ramp.T + intensity[:, None, None] * sensor.scatter
    cov = cov + np.reshape(level_noise, (-1, 1, 1)) * sensor.level_scatter
    return level * sensor.ramp[:, 0], cov, float(wide[1] ** 2)


def flow(drift: Array, time_s: float) -> Array:
    """Transition matrix expm(drift time_s) (n, n), cached.

    The cache helps because channels and windows share their chains and intervals. The result cannot
    be written to. Times are rounded to 1e-12 s.
    """
    return _cached_flow(drift.tobytes(), len(drift), round(time_s, 12))


def flows(drift: Array, dt_s: float) -> Array:
    """Transition matrices expm(drift k dt_s), k = 0 to one more than the longest interval, cached.

    The shape is (K, n, n). The longest interval is the last of ``tcdyn.smoothing.intervals.STEPS``.
    """
    return _cached_flows(drift.tobytes(), len(drift), dt_s)


@lru_cache(maxsize=200)
def _cached_flows(drift: bytes, n: int, dt_s: float) -> Array:
    """The matrices of ``flows``, by the bytes of the drift, which the cache can compare."""
    one = flow(np.frombuffer(drift).reshape(n, n), dt_s)
    powers = [np.eye(n)]
    while len(powers) <= STEPS[-1] + 1:
        powers.append(powers[-1] @ one)
    return np.array(powers)


@lru_cache(maxsize=20_000)
def _cached_flow(drift: bytes, n: int, time_s: float) -> Array:
    """The matrix of ``flow``, by the bytes of the drift, which the cache can compare."""
    result = np.asarray(expm(np.frombuffer(drift).reshape(n, n) * time_s))
    result.setflags(write=False)
    return result


def kalman_filter(model: IntervalModel) -> Iterator[tuple[Array, ...]]:
    """Information-form Kalman filter, one interval at a time.

    Parameters
    ----------
    model
        The model on J intervals, M channels, Q proposals.

    Yields
    ------
    mean
        Predicted mean m (M, Q, n).
    step
        Its update P+ (s - L m) (M, Q, n).
    gain
        I + P L (M, Q, n, n), whose determinant the likelihood needs.
    innovation
        s - L m (M, Q, n).

    Notes
    -----
    P+ = (I + P L)^-1 P and m+ = m + P+ (s - L m), then the transition. It must use the same model
    as ``tcdyn.smoothing.rts.rts_smooth``, which filters one proposal and shares equal gains.
    """
    mean = model.mean0
    cov = model.cov0.copy()
    # what all proposals share is computed by one product
    eye = np.eye(cov.shape[-1])
    rows = (len(cov), -1, cov.shape[-1])
    for j, kind in enumerate(model.kind):
        cov[..., 0, 0] += model.jump_var[j, ..., 0]
        cov[..., 1, 1] += model.jump_var[j, ..., 1]
        info = model.information[j, :, 0]
        back = model.transition[kind, :, 0].swapaxes(-1, -2)
        gain = (cov.reshape(rows) @ info).reshape(cov.shape) + eye
        innovation = model.score[j] - mean @ info
        cov = _inverse_or_nan(gain) @ cov
        step = (cov @ innovation[..., None])[..., 0]
        yield mean, step, gain, innovation
        mean = (mean + step) @ back
        for _ in range(2):  # A P A' = ((P A')' A')', which is symmetric
            cov = (cov.swapaxes(-1, -2).reshape(rows) @ back).reshape(cov.shape)


def _inverse_or_nan(matrices: Array) -> Array:
    """Inverses of matrices (..., n, n); NaN for one that rounding made singular."""
    try:
        return np.asarray(np.linalg.inv(matrices), dtype=float)
    except np.linalg.LinAlgError:
        is_regular = np.linalg.matrix_rank(matrices) == matrices.shape[-1]
        out = np.full_like(matrices, np.nan)
        out[is_regular] = np.linalg.inv(matrices[is_regular])
        return out


def likelihood(
    record: Record, noise_var: Array, proposals: Sequence[Sequence[Intensity]], fine: float = FINE
) -> tuple[Array, Array]:
    """Log likelihood of proposed intensities at the given noise variance.

    Parameters
    ----------
    record, noise_var, proposals
        As for ``interval_model``, Q proposals for each channel.
    fine
        Largest length of an interval times the corner frequency [rad]. A search may use a larger
        value than a result.

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
    model = full_model(record, noise_var, proposals, fine)
    log_det = np.zeros(model.mean0.shape[:2])
    quadratic = np.zeros(model.mean0.shape[:2])
    with np.errstate(over="ignore", invalid="ignore"):
        for (mean, step, gain, innovation), score in zip(kalman_filter(model), model.score):
            sign, log_size = np.linalg.slogdet(gain)
            # a sign lost to rounding occurs only at intensities far from the data
            log_det += np.where(sign > 0, log_size, np.inf)
            quadratic -= ((score + innovation) * mean + innovation * step).sum(axis=-1)
    n_samples = (record.weight > 0).sum(axis=0)
    chi2 = quadratic + ((record.weight * record.y**2).sum(axis=0) / noise_var)[:, None]
    value = -0.5 * (log_det + chi2 + (n_samples * np.log(noise_var))[:, None])
    ratio = chi2 / np.maximum(n_samples - 2 - len(record.events_s), 1)[:, None]
    is_lost = ~np.isfinite(value)
    value[is_lost] = -np.inf
    ratio[is_lost] = 1.0
    return value, ratio


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
    """A smoothed record: states at the knots given all samples.

    Parameters
    ----------
    record, noise_var, intensities
        The record, its noise variance (M,) [K2] and the intensity of each channel.
    knots_s
        Knots (J+1,) [s].
    level, slope
        Temperature [degC] and slope [K/s] (J, M) at the knots but the last.
    var
        Their covariance (3, J, M): variance of the level, covariance, variance of the slope.
    lag_change, split_change
        Sensitivity to the lag [K/s] and to its division into parts [K/s2] (J, M), see ``Sensor``.
    jump_chi2
        Score test (J, M) for a jump of level, slope or both: chi-square with two degrees of freedom
        if there is none.
    score, score_var
        Adjoint (J, M, 2) of level [1/K] and slope [s/K] at each knot, and its variance if the
        intensities are right: the derivative of the log likelihood with respect to the variance of
        a jump there is half of ``score**2 - score_var``.
    jump_var, jump_slope
        Prior variance (J, M) [K2] of the jump of the level at each knot, and minus its covariance
        with the slope after it over that variance [1/s].
    predicted, predicted_var
        Predicted reading without noise (N, M) [degC], and its variance [K2].
    """

    record: Record
    noise_var: Array
    intensities: tuple[Intensity, ...]
    knots_s: Array
    level: Array
    slope: Array
    var: Array
    lag_change: Array
    split_change: Array
    jump_chi2: Array
    score: Array
    score_var: Array
    jump_var: Array
    jump_slope: Array
    predicted: Array
    predicted_var: Array

    def at_samples(self) -> SmoothedSamples:
        """Temperature, slope, standard deviation and sensitivities at the samples.

        Within an interval the level is a straight line and its variance a quadratic of the state
        covariance at the knot; the sensitivities are interpolated linearly between knots.
        """
        dt = self.record.dt_s
        t = np.asarray(np.arange(len(self.predicted)) * dt, dtype=np.float64)
        interval = np.searchsorted(self.knots_s[:-1], t + 1e-6 * dt, side="right") - 1
        since_knot_s = (t - self.knots_s[interval])[:, None]

        def polynomial(*powers: Array) -> Array:
            """Polynomial (N, M) in the time since the knot, from the highest power (J, M) on."""
            value = powers[0][interval]
            for coefficients in powers[1:]:
                value *= since_knot_s
                value += coefficients[interval]
            return value

        def interpolated(at_knot: Array) -> Array:
            """Values (N, M) on straight lines between those at the knots (J, M)."""
            steps = np.diff(at_knot, axis=0, append=at_knot[-1:])
            return polynomial(steps / np.diff(self.knots_s)[:, None], at_knot)

        level_var, cross, slope_var = self.var
        rate, rate_var = self._rates(t)
        return SmoothedSamples(
            polynomial(self.slope, self.level),
            np.sqrt(np.maximum(polynomial(slope_var, 2 * cross, level_var), 0.0)),
            rate,
            np.sqrt(np.maximum(rate_var, 0.0)),
            interpolated(self.lag_change),
            interpolated(self.split_change),
        )

    def _rates(self, time_s: Array) -> tuple[Array, Array]:
        """Rate of change (N, M) [K/s] and its variance at times (N,) [s].

        It is the mean over one sampling interval around each time. The noise that drives the level
        itself has no rate at an instant.

        Notes
        -----
        The slope is that in the middle of each interval, and straight between the middles. The jump
        w of the level at the knot between them, with prior variance Q, stands for the noise of the
        level in the time H from one middle to the other. It adds the rate w / H, where
        w = Q score; the variance of w is Q - Q^2 score_var. In one sampling interval dt of them the
        noise deviates from that mean, with the variance (Q / H) (1 / dt - 1 / H) (Brownian bridge).
        At an event, where slope or level may jump, neither side has a part in the other.
        """
        dt = self.record.dt_s
        starts = self.knots_s[:-1]
        middles = 0.5 * (starts + self.knots_s[1:])
        last = len(starts) - 1
        after = np.clip(np.searchsorted(middles, time_s), 1, max(last, 1))
        after = np.minimum(after, last)  # of a single interval
        before = np.maximum(after - 1, 0)
        around_s = np.maximum(middles[after] - middles[before], dt)[:, None]
        share = np.clip((time_s - middles[before])[:, None] / around_s, 0.0, 1.0)
        bursts = {b.start_s for q in self.intensities for b in q.bursts if b.width_s == 0}
        is_event = np.isin(starts[after], [*self.record.events_s, *bursts])[:, None]
        share = np.where(is_event, time_s[:, None] >= starts[after][:, None] - 1e-6 * dt, share)
        slope_var = self.var[2]
        prior_var = np.where(is_event, 0.0, self.jump_var[after])
        jump = prior_var * self.score[after, :, 0]
        jump_var = prior_var - prior_var**2 * self.score_var[after, :, 0]
        cross = -prior_var * self.jump_slope[after]
        within = prior_var / around_s * (1.0 / dt - 1.0 / around_s)
        rate = (1.0 - share) * self.slope[before] + share * self.slope[after] + jump / around_s
        var = (1.0 - share) * slope_var[before] + share * slope_var[after]
        return rate, var + jump_var / around_s**2 + 2.0 * cross / around_s + within


def smooth_record(
    record: Record, noise_var: Array, intensities: Sequence[Intensity], fine: float = FINE
) -> Smoothed:
    """Smooth the full record with the RTS smoother, given noise variance and intensities.

    Parameters
    ----------
    record
        The record.
    noise_var
        Noise variance (M,) [K2].
    intensities
        One intensity for each channel.
    fine
        Largest length of an interval times the corner frequency [rad].

    Returns
    -------
    Smoothed
        States at the knots, predicted readings, and the score test for jumps.

    Notes
    -----
    A long record is divided into chunks of intervals with margins in which both passes settle. The
    result equals that of the full record to a millionth of a kelvin, with the memory of a chunk;
    see ``tcdyn.smoothing.intervals.chunks`` and ``tests/smoothing/test_smoother.py``.

    The score test for a jump of level and slope at a knot is q' W^-1 q, with the adjoint q and its
    variance W from ``tcdyn.smoothing.rts.rts_smooth`` (as in de Jong and Penzer 1998).
    """
    proposals = [[q] for q in intensities]
    knots = knots_for(record, noise_var, proposals, fine)
    span = channel_ranges(record)
    (n_samples, n_channels) = record.y.shape
    n_intervals = len(knots) - 1
    level, slope, lag_change, split_change, jump_chi2 = np.empty((5, n_intervals, n_channels))
    var = np.empty((3, n_intervals, n_channels))
    score, score_var = np.empty((2, n_intervals, n_channels, 2))
    jump_var, jump_slope = np.empty((2, n_intervals, n_channels))
    read, read_var = np.zeros((2, n_samples + 1, n_channels))
    lag_rows = np.stack([s.lag_row for s in record.sensors])
    split_rows = np.stack([s.split_row for s in record.sensors])
    for low, first, last, high in chunks(record, noise_var, intensities, knots):
        model = interval_model(record, noise_var, proposals, knots[low : high + 1], span)
        chunk = rts_smooth(model)
        stored = slice(first - low, last - low)
        mean = chunk.mean[stored]
        cov = chunk.cov[stored]
        adjoint_var = chunk.adjoint_var[stored]
        (level_score, slope_score) = np.moveaxis(chunk.adjoint[stored], -1, 0)
        diagonal = adjoint_var[..., [0, 1], [0, 1]]
        cross = adjoint_var[..., 0, 1]
        product = np.prod(diagonal, axis=-1)
        determinant = np.maximum(product - cross**2, 1e-9 * product + 1e-300)
        quadratic = (
            level_score**2 * diagonal[..., 1]
            - 2 * level_score * slope_score * cross
            + slope_score**2 * diagonal[..., 0]
        )
        jump_chi2[first:last] = quadratic / determinant
        score[first:last] = chunk.adjoint[stored]
        score_var[first:last] = diagonal
        jump_var[first:last] = model.jump_var[stored, :, 0, 0]
        jump_slope[first:last] = chunk.jump_slope[stored]
        level[first:last] = mean[..., 0]
        slope[first:last] = mean[..., 1]
        var[:, first:last] = np.moveaxis(cov[..., [0, 0, 1], [0, 1, 1]], -1, 0)
        lag_change[first:last] = np.einsum("jmn,mn->jm", mean, lag_rows)
        split_change[first:last] = np.einsum("jmn,mn->jm", mean, split_rows)
        for c, kinds in enumerate(model.rows):
            for intervals, rows, sample in kinds:
                inside = (intervals >= stored.start) & (intervals < stored.stop)
                intervals = intervals[inside] - stored.start
                sample = sample[inside]
                read[sample, c] = mean[intervals, c] @ rows.T
                flat_cov = cov[intervals, c].reshape(len(intervals), rows.shape[1] ** 2)
                read_var[sample, c] = flat_cov @ _squares(rows).T
    return Smoothed(
        record,
        noise_var,
        tuple(intensities),
        knots,
        level,
        slope,
        var,
        lag_change,
        split_change,
        jump_chi2,
        score,
        score_var,
        jump_var,
        jump_slope,
        read[:-1],
        read_var[:-1],
    )
