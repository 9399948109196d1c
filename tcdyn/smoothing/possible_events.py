"""What an event may be, and the average over it.

The form of an event is uncertain: a kink or a jump of the temperature, a step of the reading, or
none, at several times. The smoothed temperature is the mean over these possibilities (Bayesian
model averaging). The events come from :mod:`tcdyn.smoothing.events`. Guarded
by ``tests/smoothing/test_hidden.py`` and, for units, ``tests/smoothing/test_any_unit.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np

from tcdyn.core import Array
from tcdyn.smoothing.corner import corner_rad_s
from tcdyn.smoothing.noise_levels import Change, Intensity, level_noise_at
from tcdyn.smoothing.process_noise import (
    REACH_LAGS,
    segment,
    smearing_time_s,
)
from tcdyn.smoothing.record import DetectedEvent, Record
from tcdyn.smoothing.state_space import (
    Smoothed,
    SmoothedSamples,
    smooth_record,
)

# Values without a source below were chosen by judgement; those of the search trade time against
# the chance to detect an event, the last ones accuracy of the average against time.
# periods of the corner frequency (1/rad) on either side of an event that it influences: exp(-6) of
# its effect remains beyond, as the slowest pole of the smoother decays half as fast
REACH_CORNERS = 12.0
# Standard deviation of the time of a jump, in its standard uncertainties given the times of all
# others, that the others see: wide beside the one that includes them
TIME_SPREAD = 4.0
# weights below this share are left out of the average
MIN_WEIGHT = 0.01


class Kind(IntEnum):
    """What an event may be: changes of the temperature, and a step of the reading."""

    KINK = 0
    JUMP = 1
    JUMP_AND_KINK = 2
    STEP = 3


@dataclass(frozen=True)
class Event:
    """An event of uncertain form and time.

    Parameters
    ----------
    at_s
        Most likely time [s].
    possibilities
        All that the event may be, of some weight: time [s], changes (M,) and weights (M,).
    no_event_probability
        Probability (M,) that a channel has no event.
    u_s
        Standard uncertainty of its time [s]; zero for a listed event.
    log_odds
        Log odds that there is an event.
    kind_probability
        Probability (M, K) of each ``Kind`` in a channel, if there is an event.
    is_listed
        Whether the caller listed it, so that its time is known.
    """

    at_s: float
    possibilities: tuple[tuple[float, tuple[Change, ...], Array], ...]
    no_event_probability: Array
    u_s: float
    log_odds: float
    kind_probability: Array
    is_listed: bool = False

    def as_detected(self) -> DetectedEvent:
        """What of it is a result."""
        kink, jump, both, step = self.kind_probability.T
        return DetectedEvent(self.at_s, self.u_s, self.log_odds, kink, jump + both, step)

    @property
    def most_probable(self) -> list[Change]:
        """Change of greatest weight at ``at_s`` for each channel (M,).

        The time of a jump is left uncertain, so that what other events may be includes it.
        """
        then = [possibility for possibility in self.possibilities if possibility[0] == self.at_s]
        best = np.argmax([weight for _, _, weight in then], axis=0)
        changes = [then[k][1][c] for c, k in enumerate(best.tolist())]
        spread_s = TIME_SPREAD * self.u_s
        return [replace(change, area_sd=change.level_sd * spread_s) for change in changes]

    def insert(
        self, intensities: Sequence[Intensity], at_s: float, changes: Sequence[Change]
    ) -> list[Intensity]:
        """Intensities with other changes, and another time, at this event.

        Parameters
        ----------
        intensities
            Intensity of each channel (M,), which has its segment boundary at ``at_s`` of this
            event.
        at_s
            New time of the event [s].
        changes
            Change of each channel (M,) that replaces those at the event.
        """
        bare = without_changes(intensities, self.at_s)
        shifted = [q.shifted(self.at_s, at_s) for q in bare]
        return [replace(q, changes=(*q.changes, b)) for q, b in zip(shifted, changes)]

    def remove(self, intensities: Sequence[Intensity]) -> list[Intensity]:
        """Intensities (M,) without this event."""
        return without_changes(intensities, self.at_s)


def without_changes(intensities: Sequence[Intensity], at_s: float) -> list[Intensity]:
    """Intensities without the changes that start at ``at_s``."""
    return [
        replace(q, changes=tuple(b for b in q.changes if b.start_s != at_s)) for q in intensities
    ]


def influenced_samples(
    record: Record, noise_var: Array, intensities: Sequence[Intensity], at_s: float
) -> tuple[int, int]:
    """Range of samples that an event influences.

    Parameters
    ----------
    record
        The record.
    noise_var
        Noise variance (M,) [K2].
    intensities
        Intensity of each channel (M,).
    at_s
        Time of the event [s].

    Returns
    -------
    first, last
        First sample, and one past the last.

    Notes
    -----
    ``REACH_LAGS`` and ``REACH_CORNERS`` on either side. A lag is
    ``tcdyn.smoothing.process_noise.smearing_time_s``; the corner frequency is that of the smoother
    with the smaller intensity before or after the event.
    """
    dt = record.dt_s
    beside_s = np.array([at_s - dt, at_s + dt])
    corners = []
    for chain, q, var in zip(record.chains, intensities, noise_var.tolist()):
        without = replace(q, changes=())
        slope_ratio = without.at(beside_s) / (var * dt)
        level_ratio = level_noise_at([without], beside_s)[0] / (var * dt)
        of_slope = corner_rad_s(chain, slope_ratio)
        of_level = corner_rad_s(chain, np.maximum(level_ratio, 1e-300), 1)
        corners.append(np.maximum(of_slope, of_level).min())
    reach_s = REACH_LAGS * smearing_time_s(record) + REACH_CORNERS / float(min(corners))
    first = max(int(np.ceil((at_s - reach_s) / dt)), 0)
    return first, min(int((at_s + reach_s) / dt) + 1, len(record.y))


def average_over_event(fit: Smoothed, samples: SmoothedSamples, event: Event) -> SmoothedSamples:
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
    first, last = influenced_samples(record, fit.noise_var, fit.intensities, event.at_s)
    window = segment(record, first, last, record.events_s)
    shift = first * record.dt_s
    end_s = last * record.dt_s

    def run(intensities: Sequence[Intensity]) -> Array:
        """Temperature, slope, lag sensitivity and two variances (5, n, M) of the window."""
        shifted = [q.within(shift, end_s) for q in intensities]
        part = smooth_record(window, fit.noise_var, shifted).at_samples()
        return _means_and_variances(part)

    start = run(fit.intensities)
    weights = [w for _, _, w in event.possibilities]
    runs = [
        run(event.insert(fit.intensities, at, changes)) for at, changes, _ in event.possibilities
    ]
    without = event.no_event_probability
    if without.max() > 2 * MIN_WEIGHT:
        runs.append(run(event.remove(fit.intensities)))
        weights.append(without)
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
