"""The fixed-interval smoother of a record, and regularised deconvolution.

The temperature at the junction comes with a standard deviation for every sample. Regularised
deconvolution is the same smoother with a weight by another criterion.

``smooth`` is the estimator of ``tcdyn compensate`` (:mod:`tcdyn.sensors.compensation`,
:mod:`tcdyn.workflows.compensate_table`) and of the cooling fit (:mod:`tcdyn.partition.cooling`).
Guarded by ``tests/smoothing/test_smoother.py`` (dense least squares, coverage),
``tests/smoothing/test_deconvolve.py`` and ``tests/smoothing/test_any_unit.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from tcdyn.chain import Chain
from tcdyn.chain.chain import STATED_SPLIT_SHARE, sensors
from tcdyn.chain.law import LagLaw
from tcdyn.core import Array, Flags
from tcdyn.core.arguments import with_named_arguments
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, warning
from tcdyn.core.labels import common_index, labels_of
from tcdyn.core.threads import one_blas_thread
from tcdyn.estimation.trace_noise import interpolate_gaps
from tcdyn.series.index import even_interval_s
from tcdyn.smoothing.corner import corner_rad_s
from tcdyn.smoothing.events import (
    MIN_LOG_ODDS,
    STARTS,
    Event,
    Search,
    detect_events,
    period_of,
    reading_steps,
    spike_log_odds,
    time_of_listed,
    weigh_events,
)
from tcdyn.smoothing.followed_flow import FollowedFlow, followed_flow
from tcdyn.smoothing.law_check import law_findings
from tcdyn.smoothing.lone_readings import contradicting_readings
from tcdyn.smoothing.noise_levels import Intensity
from tcdyn.smoothing.pick_up import (
    PickUp,
    Removed,
    find_pick_up,
    numbers_of,
    removed,
    switching,
    without_pick_up,
)
from tcdyn.smoothing.possible_events import (
    average_over_event,
    influenced_samples,
)
from tcdyn.smoothing.process_noise import (
    Criterion,
    TradeoffCurve,
    segment,
    segment_levels,
    tradeoff_curve,
)
from tcdyn.smoothing.record import (
    ALONE,
    SPIKE,
    Compensated,
    Record,
    channel_names,
    channel_units,
    record_of,
)
from tcdyn.smoothing.resolution import resolved_s
from tcdyn.smoothing.roughness import (
    averaged_over_level_noise,
    degrees_of_freedom,
    intensity_var,
    refine,
    select_channels,
    smooth_probability,
    with_least_risk,
)
from tcdyn.smoothing.state_space import (
    Smoothed,
    likelihood,
    sample_covariance,
    smooth_record,
)
from tcdyn.smoothing.time_means import MeanTimes, time_means
from tcdyn.smoothing.unresolved import line_var, unresolved_var

# lags between two rows, beyond which a reading has no memory of the one before in double
# precision: exp(-100) = 4e-44
MAX_LAGS_IN_ROW = 100.0
# degrees of freedom of Student's t of heavy-tailed noise; fewer reject outliers more strongly.
# Chosen by judgement
STUDENT_DOF = 4.0
# shares of the dead time and second lag by which events may be earlier than with one lag
EARLIER_SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
# samples that may be a spike together; chosen by judgement
LONGEST_SPIKE = 3
# steps of a reading that are named with row and size
FEW_STEPS = 1
# rounds of reweighting: a further one changes no result by a tenth of its standard deviation
REWEIGHTINGS = 4
# margin beyond a window, in corner periods (1/rad): exp(-12) of the error at its ends remains
MARGIN = 12.0


@with_named_arguments
@one_blas_thread
def smooth(
    y: ArrayLike | pd.Series | pd.DataFrame | Record,
    dt_s: float | None,
    chains: float | Chain | Sequence[Chain],
    *,
    noise_sd: ArrayLike | None = None,
    intensity: float | Intensity | Sequence[float | Intensity] | None = None,
    events_s: Sequence[float] = (),
    event_u_s: float | Sequence[float] | None = None,
    find_events: bool = True,
    heavy_tails: bool = False,
    lag_covariance: ArrayLike | None = None,
    split_u_s: ArrayLike = 0.0,
    static_u: ArrayLike | None = None,
    names: Sequence[str] | None = None,
    units: Sequence[str] | None = None,
    late_s: ArrayLike | None = None,
    switched: Mapping[str, ArrayLike] | None = None,
    laws: LagLaw | Sequence[LagLaw | None] | None = None,
    flow: ArrayLike | None = None,
    flow_u: ArrayLike = 0.0,
    means: float | str | MeanTimes | None = None,
) -> Compensated:
    """Estimate the temperature of the junctions, with a standard deviation for each sample.

    Fixed-interval smoother (Kalman filter and backward pass) for the model y = G x + noise, where
    white noise drives the slope x' with the intensity q(t) [K2/s3] and the temperature itself with
    the intensity p(t) [K2/s]. The slope may jump at ``events_s``.

    Parameters
    ----------
    y
        Readings (N,) or (N, M) after the static line [degC], NaN where missing; or what
        ``tcdyn.smoothing.record.record_of`` made of them with the same arguments. The table of the
        result (``to_frame``) has the index and the names of a Series or DataFrame.
    dt_s
        Sampling interval [s]; None: that of the index of ``y``.
    chains
        One chain for all channels, or one per channel; a number is one lag [s], and a ``control``
        system of static gain 1 is a chain too.
    noise_sd
        Standard deviation of the noise per channel [K]; estimated when left out.
    intensity
        Process-noise intensity q, a number or an ``Intensity`` per channel; estimated by maximum
        likelihood when left out.
    events_s
        Times [s] from the first sample at which the slope of x may jump (such as an unloading), or
        x itself; they may lie between samples. Where the readings show none there, but elsewhere,
        a warning names both.
    event_u_s
        Standard uncertainty of those times [s], one or one per event. None: they may be a row early
        or late, and what the readings tell about that is used; with ``intensity``: zero.
    find_events
        Also detect events that are not listed, without ``intensity``. No event, a kink and a jump
        of the temperature, and a step of the reading, at several times, are weighed by their
        likelihood. The result is their mean, and the standard deviation includes their spread.
    heavy_tails
        Noise with Student's t distribution of four degrees of freedom instead of a normal one
        (robust loss, by reweighting), for slip rings with outliers that are no clear spikes.
    lag_covariance
        Covariance of the lags of the channels (M, M) [s2].
    split_u_s
        Standard uncertainty of how much of each lag is its largest lag [s], one or (M,). A lag that
        is only stated, as a number or in a file of ``tcdyn sensor new``, is averaged over how it
        may be divided instead, see ``tcdyn.chain.chain.DIVISIONS``.
    static_u
        Standard uncertainty of the static line [K], scalar, (M,) or (N, M).
    names
        Names of the channels (M,) in messages; "channel 1" and so on when left out.
    units
        Unit of the readings of each channel (M,): degC, or that of another quantity (ppm, Pa, V),
        which then is the unit of its results; the checks of a range of temperatures are left out.
        None: that of another quantity where the name states it, else degC.
    late_s
        How much later than its sample each reading was taken (N,) [s], where rows are uneven; a
        negative number is earlier. The temperatures are those at these times, the rates those at
        the samples.
    switched
        Other columns of the log (N,) by name, of numbers or of two words. Where the readings step
        with the edges of one that switches, such as a heater, that is interference: it is named and
        removed. The readings are taken as right where the column is smallest, or off.
    laws
        How the lags of the channels follow a flow, one law or one per channel (M,); None where a
        lag does not. ``chains`` then hold at the flow ``FlowLaw.at``.
    flow, flow_u
        The flow (N,) or (N, M), in the unit of the laws, and its standard uncertainty, one error
        for the whole record.
    means
        Length [s] of the times over which means are wanted, or "auto": the shortest that is
        determined in all channels, see ``Compensated.resolution_s``. They are in
        ``Compensated.means``.

    Returns
    -------
    Compensated
        With arrays (N, M).

    Raises
    ------
    InputError
        For shapes that do not agree, or a channel without samples.

    Notes
    -----
    Steps: intensity, smoother, spikes that only the prediction shows, events, heavy tails,
    average over whether p is zero and over what the events may be, shift by uncertain event times.
    The order matters: spikes go before events, which they would look like.

    What may be changed: ``STUDENT_DOF``, ``REWEIGHTINGS`` and ``MARGIN`` (see their comments). The
    variance is the sum of ``tcdyn.smoothing.record.Compensated.from_components``; a new
    contribution must also go into ``window_covariance`` and
    ``tcdyn.smoothing.windows.window_means``.

    Examples
    --------
    >>> index = pd.date_range("2026-03-01 10:00", periods=100, freq="100ms")
    >>> truth = np.where(np.arange(100) < 50, 20.0, 80.0)
    >>> noise = np.random.default_rng(0).normal(0.0, 0.05, 100)
    >>> reading = pd.Series(Chain(0.5).response(truth, 0.1, "zoh") + noise, index, name="T_degC")
    >>> table = smooth(reading, None, Chain(0.5)).to_frame()
    >>> list(table), table.index.equals(index)
    (['T_degC', 'T_u_K'], True)
    >>> round(float(table["T_degC"].iloc[60]))
    80
    """
    events_s = [float(event) for event in events_s]
    index = common_index([y], "smooth")
    names = names or labels_of(y) or None
    if index is not None:
        dt_s = dt_s or even_interval_s(index, "smooth")
    if dt_s is None:
        raise InputError(
            "smooth: dt_s is not given",
            expected="the sampling interval in seconds, or readings with times in their index",
        )
    pick_ups: tuple[PickUp, ...] = ()
    law: FollowedFlow | None = None
    if laws is not None or flow is not None:
        law = followed_flow(y, chains, laws, flow, flow_u)
        chains = law.median_chains
    if isinstance(y, Record):
        record = y
    else:
        late = None if late_s is None else np.asarray(late_s, dtype=float)
        record = record_of(y, dt_s, chains, events_s, noise_sd, names, units, late_s=late)
        if switched and intensity is None:
            pick_ups = find_pick_up(record, _switching_columns(switched, record))
        if pick_ups:  # its edges look like spikes
            changed = without_pick_up(np.asarray(y, dtype=float), pick_ups)
            record = record_of(changed, dt_s, chains, events_s, noise_sd, names, units, late_s=late)
    if law is not None:
        record = replace(record, followed=law.lags(record))
    n_channels = record.y.shape[1]
    listed_u_s = np.broadcast_to(
        np.asarray(0.0 if event_u_s is None else event_u_s, dtype=float), len(events_s)
    ).tolist()
    u_by_time = dict(zip(events_s, listed_u_s))
    likely: Likely | None = None
    if intensity is None:
        likely = likeliest(record, find_events)
        if event_u_s is None and record.events_s:
            u_by_time = dict(time_of_listed(likely.fit, at_s) for at_s in record.events_s)
            record = replace(record, events_s=tuple(sorted(u_by_time)))
            likely = likeliest(record, find_events)
        if likely.detected and (wrong_s := likely.listed_without_evidence):
            finding = warning(
                "trace.events",
                listed_s=_listed(wrong_s),
                detected_s=_listed([event.at_s for event in likely.detected]),
            )
            record = replace(record, findings=(*record.findings, finding))
        fit = likely.fit
    else:
        fit = _smoothed_without_spikes(
            record, record.noise_sd**2, _as_intensities(intensity, n_channels)
        )
    if law is not None:
        labels = channel_names(names, n_channels)
        record = replace(record, findings=(*record.findings, *law_findings(fit, law, labels)))
    duration_s = (len(record.y) - 1) * dt_s
    outside_s = [at_s for at_s in events_s if not 0 <= at_s <= duration_s]
    if outside_s:
        finding = warning("trace.event_outside", listed_s=_listed(outside_s), duration_s=duration_s)
        record = replace(record, findings=(*record.findings, finding))
    if heavy_tails:
        for _ in range(REWEIGHTINGS):
            fit = _smooth_with_student_weights(fit, record.y)
    result = compensated(
        fit,
        likely,
        None if likely is None else learned_from(fit, likely.smooth_probability),
        u_by_time,
        lag_covariance=lag_covariance,
        split_u_s=split_u_s,
        static_u=static_u,
        findings=record.findings,
        names=names,
        pick_ups=pick_ups,
        law=law,
        means=None if means is None else MeanTimes.of(means),
        with_resolution=True,
    )
    if result.means is not None and not len(result.means.sample):
        raise InputError(
            f"smooth: means over {result.means.length_s:.4g} s of {len(record.y)} rows, "
            f"{dt_s:.4g} s apart",
            expected="less than the record",
            parameters={"means": "SECONDS"},
        )
    return result.with_labels(y, names)


def _switching_columns(switched: Mapping[str, ArrayLike], record: Record) -> dict[str, Array]:
    """Those of some columns that switch.

    Raises
    ------
    InputError
        For a column of another length than the record, or with more than two words.
    """
    columns = {}
    for name, given in switched.items():
        values = numbers_of(given)
        if values is None:
            raise InputError(
                f"smooth: the column {name} of switched has other words than those of a switch",
                expected="numbers, or two words such as on and off",
            )
        if values.shape != (len(record.y),):
            raise InputError(
                f"smooth: the column {name} of switched has the shape {values.shape}",
                expected=f"one value for each of the {len(record.y)} rows",
            )
        of_switch = switching(values)
        if of_switch is not None:
            columns[name] = of_switch
    return columns


class Likely(NamedTuple):
    """A record smoothed with the likeliest intensities, and the events in it.

    Parameters
    ----------
    fit
        The smoothed record.
    events
        The listed events, and those that were detected.
    smooth_probability
        Probability (M,) that no noise drives the temperature itself.
    """

    fit: Smoothed
    events: tuple[Event, ...]
    smooth_probability: Array

    @property
    def detected(self) -> list[Event]:
        """The events that were not listed and are certain enough to be named."""
        others = [event for event in self.events if not event.is_listed]
        return [event for event in others if event.log_odds > MIN_LOG_ODDS]

    @property
    def listed_without_evidence(self) -> list[float]:
        """Times [s] of listed events at which the readings show none."""
        return [event.at_s for event in self.events if event.is_listed and event.log_odds < 0]


class Learned(NamedTuple):
    """What a smoothed record tells about the rows that follow.

    Parameters
    ----------
    intensities
        Intensity of each channel (M,), on the clock of the record.
    noise_var
        Noise variance (M,) [K2].
    dof
        Degrees of freedom (M,) from which the intensities were estimated.
    missed_var, missed_slope_var
        The ``unresolved_var`` of the temperature [K2] and of its rate of change [K2/s2], of each
        sample (N, M), or (M,) of those that follow.
    smooth_probability
        As of ``Likely``.
    """

    intensities: tuple[Intensity, ...]
    noise_var: Array
    dof: Array
    missed_var: Array
    missed_slope_var: Array
    smooth_probability: Array


def learned_from(fit: Smoothed, smooth_probability: Array) -> Learned:
    """What a smoothed record tells about the rows that follow, and about its own band."""
    missed_var, missed_slope_var = unresolved_var(fit, 1 - smooth_probability)
    return Learned(
        fit.intensities,
        fit.noise_var,
        degrees_of_freedom(fit),
        missed_var,
        missed_slope_var,
        smooth_probability,
    )


def compensated(
    fit: Smoothed,
    likely: Likely | None,
    learned: Learned | None,
    u_by_time: Mapping[float, float],
    *,
    lag_covariance: ArrayLike | None,
    split_u_s: ArrayLike,
    static_u: ArrayLike | None,
    findings: Sequence[Finding],
    names: Sequence[str] | None,
    pick_ups: Sequence[PickUp] = (),
    law: FollowedFlow | None = None,
    means: MeanTimes | None = None,
    with_resolution: bool = False,
) -> Compensated:
    """The result of a smoothed record, with all contributions to its uncertainty.

    Parameters
    ----------
    fit
        The smoothed record.
    likely, learned
        Its events, and from what its intensities were estimated; None for given intensities.
    u_by_time
        Listed events [s] and their standard uncertainties [s].
    lag_covariance, split_u_s, static_u, names
        As in ``smooth``.
    findings
        Findings about the channels.
    pick_ups
        Interference that was removed from the readings.
    law
        How the lags follow a flow.
    means
        Means that are wanted; None: none.
    with_resolution
        Whether the shortest time is wanted whose means are determined.
    """
    record = fit.record
    dt_s = record.dt_s
    samples = fit.at_samples()
    possible_events = () if likely is None else likely.events
    if learned is not None:
        samples = averaged_over_level_noise(fit, samples, learned.smooth_probability)
    for event in possible_events:
        samples = average_over_event(fit, samples, event)
    var = samples.sd**2
    slope_var = samples.slope_sd**2
    # rate of change of an error of a kelvin with the spectrum of that of the smoother [1/s]
    per_kelvin = samples.slope_sd / np.maximum(samples.sd, 1e-300)
    line_u_K = np.hypot(0.0 if static_u is None else static_u, record.aliasing_u_K)
    slope_var = slope_var + (per_kelvin * record.aliasing_u_K) ** 2
    above_corner_var: Array | float = 0.0
    if likely is not None and learned is not None:
        wave_var, wave_slope_var = line_var(fit)
        var = var + wave_var
        slope_var = slope_var + wave_slope_var
        is_rough = 1 - learned.smooth_probability
        intensity_var_K2, intensity_slope_var = intensity_var(fit, learned.dof)
        above_corner_var = learned.missed_var + is_rough * intensity_var_K2
        var = var + above_corner_var
        slope_var = slope_var + learned.missed_slope_var + is_rough * intensity_slope_var
    events = {at: u_by_time[at] for at in record.events_s}
    event_shifts = tuple(_event_shift(fit, at, u) for at, u in events.items() if u > 0)
    lag_sensitivity = samples.lag_sensitivity
    if law is not None:
        event_shifts += tuple(lag_sensitivity * shift_s for shift_s in law.shift_s)
        # an error of the lag at the flow of the law is one of the same share at all flows
        lag_sensitivity = lag_sensitivity * law.factor
    for shift_K in event_shifts:
        var = var + shift_K**2
        slope_var = slope_var + np.gradient(shift_K, dt_s, axis=0) ** 2
    temperature = samples.temperature
    slope = samples.slope
    interference = [removed(fit, pick_up) for pick_up in pick_ups]
    for one in interference:
        of_channel = np.arange(temperature.shape[1]) == one.pick_up.channel
        temperature = temperature - of_channel * (one.correction * one.temperature)[:, None]
        slope = slope - of_channel * (one.correction * one.slope)[:, None]
        var = var + of_channel * (one.u_K * one.temperature)[:, None] ** 2
        slope_var = slope_var + of_channel * (one.u_K * one.slope)[:, None] ** 2
    sd = np.sqrt(var)
    n_channels = record.y.shape[1]
    split_u = np.broadcast_to(np.asarray(split_u_s, dtype=float), n_channels).tolist()
    of_channels = [_over_divisions(fit, c, u) for c, u in enumerate(split_u)]
    shift_K, split_K = np.stack(of_channels, axis=2)
    temperature = temperature + shift_K
    slope = slope + np.gradient(shift_K, dt_s, axis=0)
    time = np.arange(len(sd)) * dt_s
    some_times = time[:: max(len(time) // 2000, 1)]
    labels = channel_names(names, n_channels)
    detected = [] if likely is None else [(event.at_s, event.u_s) for event in likely.detected]
    resolution_s = None
    if with_resolution:
        of_fit = np.maximum(fit.var[0, fit.own], 1e-300)
        ratio = np.maximum(np.median(var / of_fit, axis=0), 1.0)
        resolution_s = resolved_s(record, fit.noise_var, fit.intensities, ratio)
    result = Compensated.from_components(
        temperature,
        sd,
        slope,
        np.sqrt(slope_var),
        lag_sensitivity,
        lag_covariance,
        line_u_K,
        dt_s,
        split_K,
        noise_sd=np.sqrt(fit.noise_var),
        intensity=np.array([float(np.median(q.at(some_times))) for q in fit.intensities]),
        flags=record.flags,
        method="fixed-interval smoother",
        findings=(
            # edges have harmonics, which look like waves of a temperature
            *(f for f in findings if f.code != "noise.wave" or not (events or detected)),
            *_step_findings(fit, likely, labels),
            *_pick_up_findings(interference, labels, record),
        ),
        shift_K=event_shifts,
        events_s=tuple(sorted([*events.items(), *detected])),
        detected=() if likely is None else tuple(e.as_detected() for e in likely.detected),
        intensities=fit.intensities,
        units=record.units,
        resolution_s=resolution_s,
    )
    if means is not None:
        length_s = means.length_in(record, resolution_s)
        of_times = time_means(fit, result, means, length_s, above_corner_var)
        result = replace(result, means=of_times)
    return result.with_undetermined(record.y, labels, record.chains, record.least_range_K())


def _over_divisions(fit: Smoothed, channel: int, split_u_s: float) -> Array:
    """What the division of a lag into its parts changes.

    Parameters
    ----------
    fit
        The smoothed record.
    channel
        Index of the channel.
    split_u_s
        Standard uncertainty of the division of a lag that was measured [s].

    Returns
    -------
    Array
        Mean change (N,) of the temperature [K], and its standard deviation with the sign of the
        change by a second lag (N,) [K].

    Notes
    -----
    Of a lag that is only stated, the channel is smoothed with each of its ``Chain.divided``. A
    record that continues another one has its start for one chain: there, and for a lag that was
    measured, the change is that of a small one.
    """
    record = fit.record
    chain = record.chains[channel]
    is_followed = bool(record.followed) and record.followed[channel] is not None
    is_stated = chain.is_stated and len(chain.taus_s) == 1 and not is_followed
    if not is_stated or record.start is not None:
        shift_s = STATED_SPLIT_SHARE * chain.taus_s[0] if is_stated else split_u_s
        sensitivity = fit.split_change[fit.own, channel]
        return np.stack([np.zeros(len(sensitivity)), sensitivity * chain.split_s2(shift_s)])
    alone = select_channels(record, np.arange(len(record.chains)) == channel)
    probabilities = []
    changes = []
    for probability, divided in chain.divided():
        other = replace(alone, chains=(divided,), sensors=tuple(sensors([divided], record.dt_s)))
        noise_var = fit.noise_var[[channel]]
        latest_s = chain.lag_s - max(divided.taus_s)
        earlier = _with_earlier_events(other, noise_var, fit.intensities[channel], latest_s)
        part = smooth_record(other, noise_var, [earlier])
        probabilities.append(probability)
        changes.append(part.level[part.own, 0] - fit.level[fit.own, channel])
    weights = np.array(probabilities)
    mean = weights @ np.array(changes)
    sd = np.sqrt(weights @ (np.array(changes) - mean) ** 2)
    return np.stack([mean, np.copysign(sd, changes[-1])])


def _with_earlier_events(
    record: Record, noise_var: Array, intensity: Intensity, latest_s: float
) -> Intensity:
    """The intensity with events so much earlier, up to ``latest_s``, that it is likeliest.

    Parameters
    ----------
    record, noise_var
        A record of one channel, and its noise variance (1,) [K2].
    intensity
        Its intensity, with events that were found with another chain.
    latest_s
        Dead time and second lag [s] that this chain has, which delay what events do.
    """
    if not intensity.changes or not latest_s > 0:
        return intensity
    proposals = [
        replace(
            intensity,
            changes=tuple(
                replace(b, start_s=b.start_s - share * latest_s) for b in intensity.changes
            ),
        )
        for share in EARLIER_SHARES
    ]
    value, _ = likelihood(record, noise_var, [proposals])
    return proposals[int(np.argmax(value[0]))]


def _pick_up_findings(
    interference: Sequence[Removed], names: Sequence[str], record: Record
) -> list[Finding]:
    """A warning for each interference that was removed."""
    units = channel_units(record.units or None, names, len(names))
    found = []
    for one in interference:
        pick_up = one.pick_up
        finding = warning(
            "trace.pick_up",
            subject=names[pick_up.channel],
            column=pick_up.column,
            edges=pick_up.edges,
            step_K=pick_up.per_unit_K * pick_up.edge,
            u_K=one.u_K * pick_up.edge,
        )
        found.append(finding.in_unit(units[pick_up.channel]))
    return found


def _step_findings(fit: Smoothed, likely: Likely | None, names: Sequence[str]) -> list[Finding]:
    """Warnings for the steps of a reading that are no change of the temperature."""
    if likely is None:
        return []
    units = channel_units(fit.record.units or None, names, len(names))
    steps = reading_steps(fit, likely.detected)
    found = []
    for c, (name, unit) in enumerate(zip(names, units)):
        of_channel = [step for step in steps if step.channel == c]
        if len(of_channel) > FEW_STEPS:
            first = of_channel[0]
            period_s = period_of([step.at_s for step in of_channel])
            finding = warning(
                "trace.steps",
                subject=name,
                count=len(of_channel),
                step_K=float(np.sqrt(np.mean([step.step_K**2 for step in of_channel]))),
                first_sample=first.sample,
                at_s=first.sample * fit.record.dt_s,
                period_s=period_s,
            )
            found.append(finding.in_unit(unit))
            continue
        for step in of_channel:
            finding = warning(
                "trace.step",
                subject=name,
                step_K=step.step_K,
                u_K=step.u_K,
                first_sample=step.sample,
                at_s=step.sample * fit.record.dt_s,
            )
            found.append(finding.in_unit(unit))
    return found


def _as_intensities(
    intensity: float | Intensity | Sequence[float | Intensity], n_channels: int
) -> list[Intensity]:
    """One ``Intensity`` for each channel, from one value or one per channel."""
    if isinstance(intensity, Sequence | np.ndarray):
        listed = list(intensity)
    else:
        listed = [intensity] * n_channels
    return [q if isinstance(q, Intensity) else Intensity.constant(q) for q in listed]


def _smoothed_without_spikes(
    record: Record, noise_var: Array, intensities: Sequence[Intensity]
) -> Smoothed:
    """The smoothed record, and again without the spikes that it shows.

    Raises
    ------
    InputError
        Where the noise could not be estimated.
    """
    if not (np.isfinite(noise_var) & (noise_var > 0)).all():
        raise _too_slow(record)
    fit = smooth_record(record, noise_var, intensities)
    spikes = _spike_mask(fit)
    # a channel of which every reading contradicts the others has no spikes: the model fails
    spikes &= ((record.weight > 0) & ~spikes).any(axis=0)
    if spikes.any():
        fit = smooth_record(_without_samples(record, spikes, SPIKE), noise_var, intensities)
    return fit


def likeliest(record: Record, detect: bool, learned: Learned | None = None) -> Likely:
    """Smooth a record with intensities by their likelihood, and detect events in it.

    Parameters
    ----------
    record
        The record.
    detect
        Whether events are detected that are not listed.
    learned
        Intensities and noise of the rows before, which are taken where the record does not
        contradict them; None: they are estimated.
    """
    lag_s = max(c.lag_s for c in record.chains)  # 0 where the lag is to be left in
    if 0 < lag_s * MAX_LAGS_IN_ROW < record.dt_s:
        raise _too_slow(record)
    start_var = record.noise_sd**2
    if learned is None:
        intensities, noise_var = segment_levels(record, start_var, record.noise_known)
    else:
        intensities = list(learned.intensities)
        noise_var = learned.noise_var

    fit = _smoothed_without_spikes(record, noise_var, intensities)
    are_learned = learned is not None

    def estimated(found: Smoothed) -> Smoothed:
        """The record with intensities that are estimated again, in the same segments."""
        return refine(found, 0, are_learned=are_learned)

    search = Search(estimated, STARTS[:1] if are_learned else STARTS, detect)
    fit, events_s = detect_events(fit, search)
    fit = refine(fit, are_learned=are_learned)
    fit, events = weigh_events(fit, events_s)
    if learned is None:
        probability = smooth_probability(fit)
        fit = with_least_risk(fit)
    else:
        probability = learned.smooth_probability
    fit = _with_explained_readings(fit, record)
    contradicting = contradicting_readings(fit)
    if contradicting.any():
        return likeliest(_without_samples(record, contradicting, ALONE), detect, learned)
    return Likely(fit, tuple(events), probability)


def _too_slow(record: Record) -> InputError:
    """The error for rows so far apart that the noise cannot be estimated."""
    lag_s = max(c.lag_s for c in record.chains)
    return InputError(
        f"the noise cannot be estimated: rows every {record.dt_s:.4g} s are too slow "
        f"for a lag of {lag_s:.4g} s",
        expected="several rows in one lag",
    )


def _listed(times_s: Sequence[float]) -> str:
    """Times in a message."""
    return ", ".join(f"{time_s:.4g}" for time_s in times_s)


def _spike_mask(fit: Smoothed) -> Flags:
    """Samples (N, M) that are spikes, judged by the prediction of the smoother.

    Next to a slope change or in fast motion the rule with medians, applied before, misses spikes.
    More than ``LONGEST_SPIKE`` outlying samples near each other are no spikes.
    ``tests/smoothing/test_hidden.py`` has such a spike.
    """
    record = fit.record
    outlying = (spike_log_odds(fit, record.y) > 0) & (record.weight > 0)
    window = np.ones(2 * LONGEST_SPIKE + 1)
    crowd = np.stack([np.convolve(column, window, mode="same") for column in outlying.T], axis=1)
    return np.asarray(outlying & (crowd <= LONGEST_SPIKE))


def _with_explained_readings(fit: Smoothed, record: Record) -> Smoothed:
    """Smooth again with readings of ``record`` that were spikes only before events were known."""
    was_removed = (record.weight > 0) & (fit.record.weight == 0)
    is_explained = was_removed & (spike_log_odds(fit, record.y) < 0)
    if not is_explained.any():
        return fit
    restored = replace(
        fit.record,
        y=np.where(is_explained, record.y, fit.record.y),
        weight=np.where(is_explained, record.weight, fit.record.weight),
        flags=np.where(is_explained, record.flags, fit.record.flags),
    )
    return smooth_record(restored, fit.noise_var, fit.intensities)


def _without_samples(record: Record, samples: Flags, flag: int) -> Record:
    """The record with weight zero, a flag and interpolated readings at ``samples`` (N, M)."""
    flags = record.flags | np.where(samples, flag, 0).astype(np.uint8)
    weight = np.where(samples, 0.0, record.weight)
    columns = [interpolate_gaps(x, w > 0) for x, w in zip(record.y.T, weight.T)]
    return replace(record, y=np.stack(columns, axis=1), weight=weight, flags=flags)


def _smooth_with_student_weights(fit: Smoothed, y: Array) -> Smoothed:
    """Smooth again with the weights of Student's t likelihood.

    Parameters
    ----------
    fit
        The smoothed record, for its predictions.
    y
        Readings (N, M) [degC], whose residuals give the weights (nu + 1) / (nu + (r/s)^2).
    """
    residual = y - fit.predicted
    student = (STUDENT_DOF + 1) / (STUDENT_DOF + residual**2 / fit.noise_var)
    weight = np.where(fit.record.weight > 0, student, 0.0)
    return smooth_record(replace(fit.record, weight=weight), fit.noise_var, fit.intensities)


def _event_shift(fit: Smoothed, event_s: float, u_s: float) -> Array:
    """Change of the temperature for one standard uncertainty of the time of an event.

    Parameters
    ----------
    fit
        The smoothed record.
    event_s
        Time of the event [s].
    u_s
        Standard uncertainty of the time [s].

    Returns
    -------
    Array
        Half the difference (N, M) [K] between an event one standard uncertainty late and one early;
        zero far from the event.

    Notes
    -----
    ``tests/smoothing/test_smoother.py`` checks the coverage.
    """
    record = fit.record
    dt = record.dt_s
    first, last = influenced_samples(record, fit.noise_var, fit.intensities, event_s)
    window = segment(record, first, last, record.events_s)
    shift = first * dt
    temperatures = []
    for time_s in (event_s - u_s, event_s + u_s):
        events = sorted(time_s - shift if e == event_s - shift else e for e in window.events_s)
        shifted = [q.shifted(event_s, time_s).shifted(shift_s=shift) for q in fit.intensities]
        moved_window = replace(window, events_s=tuple(events))
        result = smooth_record(moved_window, fit.noise_var, shifted)
        temperatures.append(result.at_samples().temperature)
    half = np.zeros_like(fit.predicted)
    half[first:last] = 0.5 * (temperatures[1] - temperatures[0])
    return half


@with_named_arguments
@one_blas_thread
def deconvolve(
    y: ArrayLike,
    dt_s: float,
    chains: float | Chain | Sequence[Chain],
    *,
    criterion: Criterion = "gcv",
    noise_sd: ArrayLike | None = None,
    lag_covariance: ArrayLike | None = None,
    split_u_s: ArrayLike = 0.0,
    static_u: ArrayLike | None = None,
    names: Sequence[str] | None = None,
    units: Sequence[str] | None = None,
    trials: int = 25,
) -> tuple[Compensated, TradeoffCurve]:
    """Regularised deconvolution: minimise sum (y - G x)^2 + weight integral x''^2 dt.

    The filter has no phase shift and is exact at the ends of the record.

    Parameters
    ----------
    y
        Readings (N,) or (N, M) after the static line [degC], NaN where missing.
    dt_s
        Sampling interval [s].
    chains
        One chain for all channels or one per channel; a number is one lag [s].
    criterion
        ``discrepancy``: the mean square residual equals the noise variance. ``gcv``: least
        generalised cross-validation score, which needs no noise level. ``l-curve``: largest
        curvature of log misfit against log roughness.
    noise_sd
        Standard deviation of the noise per channel [K]; estimated when left out.
    lag_covariance, split_u_s, static_u, names, units
        As in ``smooth``.
    trials
        Number of weights tried, evenly in their logarithm.

    Notes
    -----
    The standard deviation is the Bayesian one of the same penalty (Wahba 1983), which includes
    noise and average bias.

    The penalty is that of ``smooth`` with a constant intensity: weight = noise variance /
    intensity. Only the choice of the weight differs, in
    ``tcdyn.smoothing.process_noise.tradeoff_curve``.

    Examples
    --------
    >>> t = 0.1 * np.arange(200)
    >>> reading = Chain(0.5).response(20 + np.sin(t), 0.1)
    >>> noise = np.random.default_rng(0).normal(0, 0.01, 200)
    >>> result, tradeoff = deconvolve(reading + noise, 0.1, 0.5)
    >>> bool(abs(result.temperature[100, 0] - 20 - np.sin(10.0)) < 0.1)
    True
    """
    record = record_of(y, dt_s, chains, (), noise_sd, names, units)
    tradeoff = tradeoff_curve(record, criterion, trials)
    result = smooth(
        record,
        dt_s,
        record.chains,
        intensity=list(tradeoff.chosen),
        lag_covariance=lag_covariance,
        split_u_s=split_u_s,
        static_u=static_u,
    )
    result = replace(result, method=f"regularised deconvolution, weight by {criterion}")
    return result.with_labels(y, names), tradeoff


@with_named_arguments
@one_blas_thread
def window_covariance(
    y: ArrayLike,
    dt_s: float,
    chain: Chain,
    result: Compensated,
    channel: int,
    first: int,
    last: int,
) -> Array:
    """Covariance of the smoothed temperatures of one channel at the samples of a window.

    Parameters
    ----------
    y
        The trace (N,) that ``result`` was computed from [degC].
    dt_s, chain
        As given to ``smooth``.
    result
        Result of ``smooth``.
    channel
        Column of ``result``.
    first, last
        First sample of the window, and one past the last.

    Returns
    -------
    Array
        Covariance (n, n) [K2] of n = ``last`` - ``first`` samples.

    Raises
    ------
    InputError
        If the window is not inside the record, or ``result`` has no intensities.

    Notes
    -----
    Noise and regularisation are those of the same smoother on the window and a margin, so that no
    N x N matrix is needed. The lag adds
    lag_sensitivity_i lag_sensitivity_k u(lag)^2; its division into parts adds a similar term. The
    uncertainty of the static line, one error at all times, is not included: the user knows whether
    it cancels. That of the times of events is not included either: it is ``shift_K``.

    Examples
    --------
    >>> reading = 20 + np.random.default_rng(0).normal(0, 0.1, 100)
    >>> result = smooth(reading, 0.1, Chain(0.5), find_events=False)
    >>> window_covariance(reading, 0.1, Chain(0.5), result, 0, 40, 44).shape
    (4, 4)
    """
    data = np.asarray(y, dtype=float)
    if not 0 <= first < last <= len(data) or not result.intensities:
        raise InputError(
            f"window_covariance: samples {first} to {last} of {len(data)}",
            expected="a window inside a smoothed record",
        )
    noise_sd = result.noise_sd[channel : channel + 1]
    q = result.intensities[channel]
    lowest = np.min(q.at(result.time_s[first:last]))
    corner = float(corner_rad_s(chain, np.array(lowest / (noise_sd[0] ** 2 * dt_s))))
    margin = int(np.ceil((MARGIN / corner + 5 * chain.lag_s) / dt_s))
    start = max(first - margin, 0)
    stop = min(last + margin, len(data))
    good = result.flags[start:stop, channel] == 0
    window = np.where(good, data[start:stop], np.nan)[:, None]
    # jumps at detected (not listed) events belong to the intensity
    detected = {change.start_s for change in q.changes if change.slope_sd > 0}
    listed = [e - start * dt_s for e, _ in result.events_s if e not in detected]
    unit = result.units[channel : channel + 1] or None
    record = record_of(window, dt_s, chain, listed, noise_sd, units=unit)
    of_prior = sample_covariance(
        record, noise_sd**2, q.shifted(shift_s=start * dt_s), first - start, last - start
    )
    # the result has further contributions, which are taken as correlated like those of the prior;
    # those of uncertain times of events are left to the caller
    of_events = sum(shift[first:last, channel] ** 2 for shift in result.shift_K)
    var = np.maximum(result.sd_noise[first:last, channel] ** 2 - of_events, 0.0)
    scale = np.sqrt(var / np.diag(of_prior))
    out = scale[:, None] * of_prior * scale
    lag = result.lag_sensitivity[first:last, channel]
    split = result.lag_split_K[first:last, channel]
    lag_part = np.outer(lag, lag) * result.lag_covariance[channel, channel]
    return np.asarray(out + lag_part + np.outer(split, split))
