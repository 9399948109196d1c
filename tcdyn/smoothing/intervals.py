"""Time intervals of the smoother: their lengths, and the chunks of a long record.

The samples of an interval are processed at once. It may be long where the smoother averages over
many samples: its length is limited by the corner frequency of the smoother. A long record is
smoothed in chunks, each with a margin on both sides that is long enough for the RTS smoother to
settle.

Used by :mod:`tcdyn.smoothing.state_space`, :mod:`tcdyn.smoothing.process_noise`,
:mod:`tcdyn.smoothing.smoother` and, for the margins of long logs, by
:mod:`tcdyn.sensors.compensation` and :mod:`tcdyn.workflows.compensate_table`. Guarded by
``tests/smoothing/test_states.py`` (knots, corner, margins) and ``tests/smoothing/test_smoother.py``
(chunks equal the full record).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from tcdyn.chain import Chain, Sensor
from tcdyn.core import Array
from tcdyn.smoothing.noise_levels import Intensity, level_noise_at, levels_at
from tcdyn.smoothing.record import Record

# allowed lengths of an interval [samples]
STEPS = np.array([1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512])
# interval length times the local corner frequency of the smoother [rad]: half of it changes no
# result by 1 % of its standard deviation
FINE = 0.5
# intervals that are smoothed at once; chosen by judgement (memory)
CHUNK_INTERVALS = 4000
# margin of a chunk, in memories of the smoother: exp(-10) of the error at its ends remains
SETTLING = 10.0
# level noise over noise [1/s2] below which it has no effect on any record
TINY_RATIO = 1e-12


def corner_rad_s(chain: Chain, ratio: Array, order: int = 2) -> Array:
    """Corner frequency [rad/s] of the smoother: where the signal falls below the noise.

    Parameters
    ----------
    chain
        The chain, with frequency response G.
    ratio
        q / R [1/s4] of any shape: intensity over the spectral density R = noise variance times dt;
        with ``order`` 1 p / R [1/s2], p the intensity of level noise.
    order
        2 for slope noise, 1 for level noise.

    Returns
    -------
    Array
        Corner frequency [rad/s], same shape as ``ratio``; between 1e-4 and 1e4.

    Notes
    -----
    Solves |G(w)|^2 q / w^(2 order) = R, by linear interpolation of logarithms between 400
    frequencies. The number of frequencies may be changed; ``tests/smoothing/test_states.py``
    requires an accuracy of
    0.2 %.
    """
    w = np.geomspace(1e-4, 1e4, 400)
    gain = np.abs(chain.frequency_response(w / 2 / np.pi))
    needed = np.maximum.accumulate(2 * order * np.log(w) - 2 * np.log(gain + 1e-30))
    return np.asarray(np.exp(np.interp(np.log(ratio), needed, np.log(w))))


def knots_for(
    record: Record, noise_var: Array, proposals: Sequence[Sequence[Intensity]], fine: float = FINE
) -> Array:
    """Knots (J+1,) of intervals that are short enough for all proposed intensities.

    Parameters
    ----------
    record
        The record.
    noise_var
        Noise variance of each channel (M,) [K2].
    proposals
        Proposed intensities, the same number for each channel.
    fine
        Largest interval length times the corner frequency [rad].

    Returns
    -------
    Array
        Knots [s]. The first lies before the first sample by the longest dead time, rounded up to a
        multiple of dt.

    Notes
    -----
    Listed events and starts of bursts are knots. The allowed length is that of the channel with the
    highest corner frequency, from the highest of the proposed intensities; it is evaluated about
    once a second, at most once a sample, and at 60 times after each event, where a burst decays.

    What may be changed: these numbers of times, as long as a decaying burst is resolved. All knots
    but events must lie on sample times, because ``tcdyn.smoothing.state_space.interval_model``
    groups intervals by the phase of their samples. ``tests/smoothing/test_states.py`` checks first
    and last knot, events and lengths.
    """
    dt = record.dt_s
    n_samples = len(record.y)
    end = (n_samples - 1) * dt
    start = -float(np.ceil(max(s.delay_s for s in record.sensors) / dt - 1e-9)) * dt
    once_a_second = int(end - start)
    times = [np.linspace(start, end, max(min(once_a_second, n_samples), 8))]
    starts = {b.start_s for proposed in proposals for q in proposed for b in q.bursts}
    stops = sorted(event for event in {*record.events_s, *starts} if start < event < end)
    for event in stops:
        after = event + np.geomspace(0.1 * dt, max(end - event, dt), 60)
        times += [np.array([event - 1e-6 * dt, event]), after[after < end]]
    t = np.unique(np.concatenate(times))
    longest_s = np.full(len(t), np.inf)
    for chain, proposed, var in zip(record.chains, proposals, noise_var):
        highest = levels_at(proposed, t).max(axis=0)
        longest_s = np.minimum(longest_s, fine / corner_rad_s(chain, highest / (var * dt)))
        if any(q.is_rough for q in proposed):
            rough = level_noise_at(proposed, t).max(axis=0)
            corner = corner_rad_s(chain, np.maximum(rough, TINY_RATIO * var * dt) / (var * dt), 1)
            longest_s = np.minimum(longest_s, fine / corner)
    first = round(start / dt)
    sample_s = np.arange(first, n_samples) * dt
    longest_samples = np.maximum(np.interp(sample_s, t, longest_s) / dt, 1.0)
    gradual = {
        (b.start_s, b.width_s)
        for proposed in proposals
        for q in proposed
        for b in q.bursts
        if b.width_s > 0
    }
    for at_s, width_s in gradual:  # every sample of a gradual jump is a knot
        since_s = np.abs(sample_s - at_s) - 0.5 * width_s
        before = sample_s < at_s + 0.5 * width_s + dt
        limit = np.where(before, np.maximum(since_s / dt - 1.0, 1.0), np.inf)
        longest_samples = np.minimum(longest_samples, limit)
    longest_index = np.searchsorted(STEPS, longest_samples + 1e-9, side="right") - 1
    return _knots(first, dt, [*stops, end + 0.5 * dt], longest_index)


def _knots(
    first: int, dt_s: float, stops_s: Sequence[float], longest_index: NDArray[np.intp]
) -> Array:
    """Knots from sample ``first`` (negative: before the first sample) past the last of ``stops_s``.

    Every other stop is an event and a knot; all further knots are on sample times.

    Parameters
    ----------
    first
        Index of the sample at the first knot.
    dt_s
        Sampling interval [s].
    stops_s
        Times of the events and the end [s].
    longest_index
        For each sample from ``first`` on, the index in ``STEPS`` of the longest interval allowed
        there. An interval is longer than the one before by at most one step of ``STEPS``.

    Returns
    -------
    Array
        Knots (J + 1,) [s]; the last lies past the last of ``stops_s``.
    """
    knots = [first * dt_s]
    index = first
    step = len(STEPS) - 1
    allowed = longest_index.tolist()
    for number, stop in enumerate(stops_s, start=1):
        if number > 1:
            index = int(np.floor(knots[-1] / dt_s + 1 + 1e-6))
            step = 0
            knots.append(index * dt_s)
        while index * dt_s < stop - 1e-6 * dt_s:
            step = min(step + 1, allowed[index - first])
            index += int(STEPS[step])
            knots.append(index * dt_s)
        if number < len(stops_s):
            while knots[-1] > stop - 1e-6 * dt_s:
                knots.pop()
            knots.append(stop)
    return np.array(knots)


def chunks(
    record: Record, noise_var: Array, intensities: Sequence[Intensity], knots: Array
) -> Iterator[tuple[int, int, int, int]]:
    """Divide the intervals into chunks with margins.

    Parameters
    ----------
    record
        The record.
    noise_var
        Noise variance (M,) [K2].
    intensities
        One intensity for each channel.
    knots
        Knots (J + 1,) [s].

    Yields
    ------
    low, first, last, high
        For each chunk the knot where the filter starts, the first and the last knot of the
        intervals to store, and the knot where the filter ends.

    Notes
    -----
    A margin lasts ``SETTLING`` times the memory of the slowest channel, counted in samples that all
    channels have. Where a margin would be longer than a chunk, the chunks are made twice as long.
    ``CHUNK_INTERVALS`` may be changed freely (memory and speed). ``SETTLING`` is the logarithm of
    the factor to which the error at the end of a margin decays; with 2 instead of 10 the chunks
    differ by more than 1e-5 K in ``tests/smoothing/test_smoother.py``.
    """
    n_intervals = len(knots) - 1
    length = CHUNK_INTERVALS
    dt = record.dt_s
    if n_intervals <= 2 * length:
        yield 0, 0, n_intervals, n_intervals
        return
    margin_samples = settling_time_s(record.sensors, np.sqrt(noise_var), dt, intensities) / dt
    complete_count = np.concatenate([[0], np.cumsum((record.weight > 0).all(axis=1))])
    first_sample = np.clip(np.ceil(knots / dt).astype(int), 0, len(record.y))
    while True:
        edges = np.append(np.arange(0, n_intervals - length // 2, length), n_intervals)
        before = (
            np.searchsorted(
                complete_count,
                complete_count[first_sample[edges[:-1]]] - margin_samples,
                side="right",
            )
            - 1
        )
        after = np.searchsorted(
            complete_count, complete_count[first_sample[edges[1:]]] + margin_samples
        )
        low = np.searchsorted(first_sample, np.maximum(before, 0), side="right") - 1
        high = np.searchsorted(first_sample, np.minimum(after, len(record.y)))
        low[0] = 0
        high[-1] = n_intervals
        low = np.clip(low, 0, edges[:-1])
        high = np.clip(high, edges[1:], n_intervals)
        longest_margin = max(np.max(edges[:-1] - low), np.max(high - edges[1:]))
        if len(edges) == 2 or longest_margin <= length:
            columns = (low, edges[:-1], edges[1:], high)
            yield from zip(*(column.tolist() for column in columns))
            return
        length *= 2


def settling_time_s(
    sensors: Sequence[Sensor], noise_sd: Array, dt_s: float, chosen: Sequence[Intensity]
) -> float:
    """Margin [s], in samples of all channels, within which both passes of the smoother settle.

    Parameters
    ----------
    sensors
        State space of each channel.
    noise_sd
        Standard deviation of the noise (M,) [K].
    dt_s
        Sampling interval [s].
    chosen
        One intensity for each channel; the lowest of its levels counts.

    Returns
    -------
    float
        Longest dead time plus ``SETTLING`` memories of a channel [s].
    """
    memories = []
    for s, q, sd in zip(sensors, chosen, noise_sd):
        var = sd**2 * dt_s
        level_noise = min(q.level_noise, default=0.0)
        memories.append(s.delay_s + SETTLING * memory_s(s, min(q.levels) / var, level_noise / var))
    return max(memories)


def memory_s(sensor: Sensor, ratio: float, level_ratio: float = 0.0) -> float:
    """Time [s] in which the smoother forgets a state to 1/e, forward and backward alike.

    Parameters
    ----------
    sensor
        State space of a chain.
    ratio
        q / (R dt) [1/s4], R the noise variance of a sample.
    level_ratio
        p / (R dt) [1/s2], p the intensity of level noise.

    Notes
    -----
    One over the slowest eigenvalue of the Hamiltonian matrix ((A, Q), (C'C/R, -A')) of the
    smoother. ``tests/smoothing/test_states.py`` compares it with the closed form of a chain without
    lags.
    """
    driving = np.zeros_like(sensor.drift)
    driving[0, 0] = level_ratio
    driving[1, 1] = ratio
    hamiltonian = np.block(
        [[sensor.drift, driving], [np.outer(sensor.output, sensor.output), -sensor.drift.T]]
    )
    return 1.0 / float(np.abs(np.linalg.eigvals(hamiltonian).real).min())
