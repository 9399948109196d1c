"""What an event may be, and the average over it.

The form of an event is uncertain: a kink or a jump of the temperature, or none, at several times.
The smoothed temperature is the mean over these possibilities (Bayesian model averaging). Events
that the caller did not list come from :mod:`tcdyn.smoothing.events`.

Used by ``tcdyn.smoothing.smoother.smooth`` only. Guarded by ``tests/smoothing/test_hidden.py`` and,
for units, ``tests/smoothing/test_any_unit.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from tcdyn.core import Array
from tcdyn.smoothing.corner import corner_rad_s
from tcdyn.smoothing.noise_levels import Burst, Intensity, level_noise_at
from tcdyn.smoothing.process_noise import (
    REACH_LAGS,
    channel_spans,
    event_window,
    jump_ranges,
    segment,
    smearing_time_s,
)
from tcdyn.smoothing.record import Record
from tcdyn.smoothing.state_space import (
    Smoothed,
    SmoothedSamples,
    likelihood,
    smooth_record,
)

# Values without a source below were chosen by judgement; those of the search trade time against
# the chance to detect an event, the last ones accuracy of the average against time.
# periods of the corner frequency (1/rad) on either side of an event that it influences: exp(-6) of
# its effect remains beyond, as the slowest pole of the smoother decays half as fast
REACH_CORNERS = 12.0
# nats by which a fit of height, decay and power of a burst to pure noise raises the likelihood
BURST_FIT_NATS = 3.0
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
    no_event_probability
        Probability (M,) that a channel has no event; None: it is known to have one.
    """

    at_s: float
    possibilities: tuple[tuple[float, tuple[Burst, ...], Array], ...]
    no_event_probability: Array | None = None

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

    def remove(self, intensities: Sequence[Intensity]) -> list[Intensity]:
        """Intensities (M,) without this event."""
        return without_bursts(intensities, self.at_s)


def without_bursts(intensities: Sequence[Intensity], at_s: float) -> list[Intensity]:
    """Intensities without the bursts that start at ``at_s``."""
    return [replace(q, bursts=tuple(b for b in q.bursts if b.start_s != at_s)) for q in intensities]


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
        without = replace(q, bursts=())
        slope_ratio = without.at(beside_s) / (var * dt)
        level_ratio = level_noise_at([without], beside_s)[0] / (var * dt)
        of_slope = corner_rad_s(chain, slope_ratio)
        of_level = corner_rad_s(chain, np.maximum(level_ratio, 1e-300), 1)
        corners.append(np.maximum(of_slope, of_level).min())
    reach_s = REACH_LAGS * smearing_time_s(record) + REACH_CORNERS / float(min(corners))
    first = max(int(np.ceil((at_s - reach_s) / dt)), 0)
    return first, min(int((at_s + reach_s) / dt) + 1, len(record.y))


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
    """

    record: Record
    noise_var: Array
    base: list[Intensity]
    start_s: float

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
    window = _Window(samples, noise_var, base, start_s)
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
    runs = [run(event.insert(fit.intensities, at, bursts)) for at, bursts, _ in event.possibilities]
    without = event.no_event_probability
    if without is not None and without.max() > 2 * MIN_WEIGHT:
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
