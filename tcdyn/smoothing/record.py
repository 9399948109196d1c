"""The record that a compensator gets, and the compensated result with its uncertainty.

``record_of`` marks bad samples, estimates the noise and whitens it where the conditioning filter
coloured it. It is the first step of ``tcdyn.smoothing.smoother.smooth``, ``deconvolve`` and
``tcdyn.smoothing.inverse.invert``; figures, pages and the partition read ``Compensated``. The rules
for spikes are ``tcdyn.estimation.trace_noise.SPIKES``, those for impossible readings
:mod:`tcdyn.series.plausible`. Guarded by ``tests/smoothing/test_smoother.py`` (flags),
``tests/smoothing/test_any_unit.py`` (findings) and ``tests/smoothing/test_noise.py`` (whitening).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from tcdyn.chain import Chain, Sensor, chains_for, sensors
from tcdyn.chain.bursts import estimate_and_whiten_noise, whiten_traces
from tcdyn.chain.chain import with_first_lag
from tcdyn.chain.logger_noise import LoggerNoise
from tcdyn.core import Array, Flags
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import text_with_u
from tcdyn.core.findings import Finding, info_or_warning, warning
from tcdyn.core.labels import common_index, labels_of
from tcdyn.core.result import Result, jsonable
from tcdyn.estimation.trace_noise import (
    SPIKES,
    interpolate_gaps,
    long_runs,
    rounding_sd,
    trace_noise_sd,
)
from tcdyn.io.unit_names import TEMPERATURES, names_other_quantity, unit_in, without_unit
from tcdyn.series.plausible import (
    HIGHEST_DEGC,
    LOWEST_DEGC,
    impossible_changes,
    out_of_range,
    overload_limit,
)
from tcdyn.series.reading import CODE, READING, Kind, reasons_of
from tcdyn.series.real_share import at_grid_times
from tcdyn.series.units import NO_COUPLE, Unit
from tcdyn.series.updates import usual_spacing
from tcdyn.smoothing.mean_values import TimeMeans, common_lag_u_s, even_rows_s
from tcdyn.smoothing.noise_levels import Intensity

# bits of ``flags``: powers of two, because a sample may have several
GOOD = 0
MISSING = 1
SPIKE = 2
STUCK = 4
SATURATED = 8
IMPLAUSIBLE = 16
ALONE = 32  # see ``tcdyn.smoothing.lone_readings``
# step of the logarithm of a lag that follows another column: an error of 0.25 % at most, well below
# the uncertainty of any lag; smaller steps cost time
LAG_STEP = 0.005
# fewest good samples of a channel, and samples of a record; chosen by judgement
MIN_GOOD_SAMPLES = 8
# Estimated noise is at least this part of the largest reading: below, the covariances of the filter
# are singular in double precision. By trial with exact ramps, steps and exponentials.
EXACT_NOISE_REL = 3e-7
# a record counts as ranging over at least so many standard deviations of its noise, so that the
# temperature of a constant trace is determined; chosen by judgement
MIN_RANGE_SD = 10.0
# samples near a reading, if its lag is shorter; and such distances in a gap whose middle is not
# determined. Chosen by judgement
NEAR_SAMPLES = 5.0
LONG_GAP = 10.0
# share of a trace up to which implausible samples are left to the spike rule; chosen by judgement
FEW_IMPLAUSIBLE = 0.01
# A time of a mean counts as whole rows within these shares: times of rows are estimated. Rows in a
# mean at most: each is a state of the filter. Share of a row below which a mean is that of an
# instant. Chosen by judgement
WHOLE_ROWS = 0.01
WHOLE_ROWS_UNEVEN = 0.1
MOST_MEAN_ROWS = 12
INSTANT = 1e-3
# share of readings that are not used, from which on the user is informed; no result depends on it
REPORTED_BAD_SHARE = 0.01


@dataclass(frozen=True)
class Start:
    """What the rows before a record tell about it, where a longer record continues.

    Parameters
    ----------
    means
        Mean (n,) of the n states of each channel at the first sample, given the readings of states
        before it.
    factors
        Lower triangular square root (n, n) of their covariance, of each channel.
    range_K
        Range of the readings before (M,) [K].
    rows
        Number of rows before among which events were looked for.
    """

    means: tuple[Array, ...]
    factors: tuple[Array, ...]
    range_K: Array
    rows: int


@dataclass(frozen=True)
class DetectedEvent:
    """A sudden change that the readings show.

    Attributes
    ----------
    at_s, u_s
        Its time and standard uncertainty [s].
    log_odds
        Log odds that there is one.
    kink, jump, step
        Probabilities (M,) that it is a change of the slope of the temperature, a jump of the
        temperature (with or without a change of its slope), or a step of the reading itself, in
        each channel; what is missing to one is the probability of nothing.
    """

    at_s: float
    u_s: float
    log_odds: float
    kink: Array
    jump: Array
    step: Array

    def kind(self, channel: int = 0) -> str:
        """What it most probably is in a channel: kink, jump, step of the reading, or nothing."""
        of_kinds = {
            "kink": float(self.kink[channel]),
            "jump": float(self.jump[channel]),
            "step of the reading": float(self.step[channel]),
        }
        of_kinds["nothing"] = 1.0 - sum(of_kinds.values())
        return max(of_kinds, key=lambda kind: of_kinds[kind])


@dataclass(frozen=True)
class FollowedLag:
    """The first lag of a channel, which follows another column.

    Parameters
    ----------
    lag_s
        The lag at each sample (N,) [s].
    sensors
        State spaces with some lags, evenly in their logarithm.
    of_step
        Index (N,) of the state space of the step after each sample.
    """

    lag_s: Array
    sensors: tuple[Sensor, ...]
    of_step: NDArray[np.intp]

    @classmethod
    def of(cls, lag_s: Array, sensor: Sensor) -> FollowedLag:
        """The state spaces for lags (N,) [s] of a chain with the state space ``sensor``.

        A step has the mean of the rates 1 / lag at its ends, which decides how far a stage moves.
        """
        rate = 1.0 / lag_s
        rate_of_step = 0.5 * (rate + np.append(rate[1:], rate[-1:]))
        step = np.round(-np.log(rate_of_step) / LAG_STEP)
        steps, of_step = np.unique(step, return_inverse=True)
        lags_s = np.exp(steps * LAG_STEP).tolist()
        return cls(lag_s, tuple(with_first_lag(sensor, lag) for lag in lags_s), of_step)

    def at(self, time_s: Array, dt_s: float) -> Array:
        """The lag [s] at some times (T,) [s]."""
        return np.interp(time_s, dt_s * np.arange(len(self.lag_s)), self.lag_s)

    def within(self, rows: slice) -> FollowedLag:
        """That of some samples."""
        return replace(self, lag_s=self.lag_s[rows], of_step=self.of_step[rows])


@dataclass(frozen=True)
class Record:
    """A record: samples of M channels at a constant interval, with their chains and events.

    Parameters
    ----------
    y
        Readings (N, M) [degC], finite; interpolated where bad.
    weight
        Weights (N, M), 0 where bad.
    dt_s
        Sampling interval [s].
    chains, sensors
        The chain of each channel, and its state space.
    events_s
        Times of the events [s].
    noise_sd
        Standard deviation of the white noise (M,) [K].
    flags
        Bits MISSING, SPIKE, STUCK, SATURATED, IMPLAUSIBLE, ALONE (N, M).
    noise_known
        Whether the noise level was given, or is that of whitened noise.
    aliasing_u_K
        Standard uncertainty (M,) [K] from aliased hum, see ``LoggerNoise``, and from the rounding
        of a logger whose steps are coarser than its noise.
    rounding_K
        The part of it (M,) [K] from rounding; zero where the noise hides it.
    findings
        Findings about the channels.
    units
        Unit of each channel (M,): degC, or that of another quantity.
    noise
        Noise of each group of channels with one conditioning filter and unit.
    start
        What the rows before tell; None: nothing.
    late_s
        How much later than its sample each reading was taken (N,) [s]; None: not at all.
    followed
        The first lag of each channel (M,) that follows another column, None where it does not;
        empty: of no channel. ``chains`` then are those with its median.

    Notes
    -----
    ``tcdyn.smoothing.process_noise.segment`` cuts ``y``, ``weight`` and ``flags``: a new field with
    one value a sample must be cut there, too.
    """

    y: Array
    weight: Array
    dt_s: float
    chains: tuple[Chain, ...]
    sensors: tuple[Sensor, ...]
    events_s: tuple[float, ...]
    noise_sd: Array
    flags: NDArray[np.uint8]
    noise_known: bool
    aliasing_u_K: Array
    rounding_K: Array
    findings: tuple[Finding, ...] = ()
    units: tuple[str, ...] = ()
    noise: tuple[LoggerNoise, ...] = ()
    start: Start | None = None
    late_s: Array | None = None
    followed: tuple[FollowedLag | None, ...] = ()

    def at_samples(self) -> Array:
        """Readings (N, M), moved to the samples along parabolas where they were taken later."""
        if self.late_s is None or any(chain.mean_s for chain in self.chains):
            return self.y
        return _moved_to_samples(self.y, self.dt_s, self.late_s)

    @property
    def tested_rows(self) -> int:
        """Number of rows among which events are looked for, with those before the record."""
        return len(self.y) + (0 if self.start is None else self.start.rows)

    def least_range_K(self) -> Array:
        """Range (M,) [K] of the readings before the record; zero where there are none."""
        return np.zeros(self.y.shape[1]) if self.start is None else self.start.range_K


def _moved_to_samples(y: Array, dt_s: float, late_s: Array) -> Array:
    """Readings (N, M), taken ``late_s`` (N,) [s] later than their samples, at the samples."""
    sample_s = dt_s * np.arange(len(y), dtype=np.float64)
    moved = np.stack([at_grid_times(column, sample_s, late_s) for column in y.T], axis=1)
    return np.where(np.isfinite(moved), moved, y)


def _without_reading(good: Flags, lag_samples: float) -> Flags:
    """Samples that are too far from any good reading to be determined by it.

    Parameters
    ----------
    good
        The good readings of a channel (N,).
    lag_samples
        Lag of its chain [samples].

    Returns
    -------
    Flags
        Mask (N,): before the first and after the last reading, and in gaps of more than
        ``LONG_GAP`` lags, everything farther than one lag (at least ``NEAR_SAMPLES``).

    Notes
    -----
    The process noise at those times is unknown: if it is taken from other times, a temperature that
    is quiet there gets a narrow band where nothing was read.
    """
    near = max(lag_samples, NEAR_SAMPLES)
    out = np.zeros(len(good), dtype=bool)
    rows = np.flatnonzero(good)
    bad = np.flatnonzero(~good)
    gap = np.searchsorted(rows, bad)
    since = bad - np.concatenate([[-np.inf], rows])[gap]
    until = np.concatenate([rows, [np.inf]])[gap] - bad
    out[bad] = (since + until > LONG_GAP * near) & (since > near) & (until > near)
    return out


def _beyond_contradiction(flags: NDArray[np.uint8]) -> Flags:
    """Samples (N,) before the first or after the last reading, where a reading there is ALONE."""
    rows = np.flatnonzero(flags == GOOD)
    is_alone = flags & ALONE != 0
    out = np.zeros(len(flags), dtype=bool)
    if not len(rows):
        return out
    if is_alone[: rows[0]].any():
        out[: rows[0]] = True
    if is_alone[rows[-1] :].any():
        out[rows[-1] + 1 :] = True
    return out


def channel_names(names: Sequence[str] | None, count: int) -> list[str]:
    """Names of the channels in messages; "channel 1" and so on without ``names``.

    Parameters
    ----------
    names
        Names of the channels, or None.
    count
        Number of channels if ``names`` is None.
    """
    if names is None:
        return [f"channel {c + 1}" for c in range(count)]
    return list(names)


def channel_units(
    units: Sequence[str] | None, names: Sequence[str] | None, count: int
) -> tuple[str, ...]:
    """Unit of each channel: as given, else that of another quantity in its name, else degC.

    Parameters
    ----------
    units
        Units (M,), or None.
    names
        Names of the channels (M,), or None.
    count
        Number of channels.

    Examples
    --------
    >>> channel_units(None, ["CO2_ppm", "T1_K"], 2)
    ('ppm', 'degC')
    """
    if units is not None:
        return tuple(units)
    if not names:
        return ("degC",) * count
    return tuple(unit_in(name) if names_other_quantity(name) else "degC" for name in names)


def record_of(
    y: ArrayLike,
    dt_s: float,
    chains: float | Chain | Sequence[Chain],
    events_s: Sequence[float] = (),
    noise_sd: ArrayLike | None = None,
    names: Sequence[str] | None = None,
    units: Sequence[str] | None = None,
    noise_model: Sequence[LoggerNoise] | None = None,
    late_s: Array | None = None,
) -> Record:
    """The record of some readings, with weight zero for bad samples and white noise.

    Parameters
    ----------
    y
        Readings (N,) or (N, M) after the static line [degC], NaN where missing.
    dt_s
        Sampling interval [s].
    chains
        One chain for all channels or one per channel; a number is one lag [s].
    events_s
        Times [s] from the first sample at which the slope may jump; those outside the record are
        left out.
    noise_sd
        Standard deviation of the noise per channel [K]; estimated when left out.
    names
        Names of the channels (M,) in messages.
    units
        Unit of each channel (M,): degC, or that of another quantity; None: by the names.
    noise_model
        The field ``noise`` of an earlier record of the same channels, whose noise is taken; None:
        it is estimated.
    late_s
        How much later than its sample each reading was taken (N,) [s]; None: not at all.

    Returns
    -------
    Record
        Its chains contain the whitening filter where the noise was whitened.

    Raises
    ------
    InputError
        For shapes that do not agree, for a channel that mostly repeats one value or has hardly any
        good sample, and for rows that are means over a time which is no whole number of rows.

    Notes
    -----
    Steps: impossible readings, repeated values, noise and spikes of the channels with one
    conditioning filter and unit, whitening, interpolation. The order matters: impossible and
    repeated values must not enter the noise estimate. Noise and spikes are those of the readings
    moved to their samples; a trace that is whitened, or whose rows are means, remains moved. A
    given ``noise_sd`` is taken as white. The spike window follows the shortest lag of the channels,
    in samples of the slowest one.
    """
    data = np.array(y, dtype=float)
    if not data.size:
        raise InputError("smooth: no readings", expected=f"at least {MIN_GOOD_SAMPLES} samples")
    data = data.reshape(len(data), -1)
    n, m = data.shape
    listed = chains_for(chains, m)
    if n < MIN_GOOD_SAMPLES or not dt_s > 0:
        raise InputError(
            f"smooth: {n} samples every {dt_s:g} s",
            expected=f"at least {MIN_GOOD_SAMPLES} samples and a positive interval",
        )
    listed = [
        replace(chain, mean_s=whole_mean_s(chain.mean_s, dt_s, late_s is not None))
        for chain in listed
    ]
    channels = channel_names(names, m)
    if len(channels) != m:
        raise InputError(
            f"smooth: {m} channels but {len(channels)} names", expected="one name per channel"
        )
    unit_of_channel = channel_units(units, names or labels_of(y) or None, m)
    implausible, findings = _implausible_readings(data, dt_s, listed, channels, unit_of_channel)
    data[implausible] = np.nan
    own = data.copy()
    if late_s is not None:
        data = _moved_to_samples(data, dt_s, late_s)
    traces = np.ascontiguousarray(data.T)
    is_estimated = noise_sd is None and noise_model is None
    if is_estimated:
        noise = np.array([trace_noise_sd(x) for x in traces], dtype=float)
    else:
        noise = np.full(m, 0.0 if noise_sd is None else noise_sd, dtype=float)
    flags = np.stack([_sample_flags(x) for x in traces], axis=1)
    flags[implausible] = IMPLAUSIBLE
    rounding = np.array([rounding_sd(x) for x in traces])
    hides_noise = (rounding >= noise) & is_estimated
    rounding_u = np.where(hides_noise, rounding, 0.0)
    for flag, name in zip(flags.T, channels):
        _check_channel(flag, name)
    aliasing_u = np.zeros(m)
    coloured = False
    kinds = [(c.conditioning, unit) for c, unit in zip(listed, unit_of_channel)]
    models = list[LoggerNoise]()
    for filter_, unit in dict.fromkeys(kinds):
        index = [c for c in range(m) if kinds[c] == (filter_, unit)]
        group = [listed[c] for c in index]
        good = flags[:, index] == GOOD
        spacing = max(usual_spacing([np.flatnonzero(column)]) for column in good.T)
        rule = SPIKES["compensator"].for_lag(min(c.lag_s for c in group) / (spacing * dt_s))
        x = np.where(good, data[:, index], np.nan)
        if noise_model is not None:
            logger_noise = noise_model[len(models)]
            white, outliers = whiten_traces(logger_noise, x, good, dt_s, group, rule)
        elif noise_sd is None:
            logger_noise, [(white, outliers)] = estimate_and_whiten_noise(
                [x], [dt_s], filter_, noise[index], group, rule
            )
        else:
            logger_noise = LoggerNoise(np.zeros(len(index)), noise[index], noise[index], filter_)
            white, outliers = whiten_traces(logger_noise, x, good, dt_s, group, rule, pulses=False)
        data[:, index] = white
        flags[:, index] |= np.where(outliers, SPIKE, 0).astype(np.uint8)
        noise[index] = logger_noise.level_K
        if is_estimated:  # readings without noise, as of a simulation
            noise[index] = np.maximum(noise[index], least_noise_sd(x))
        models.append(replace(logger_noise, level_K=noise[index].copy()))
        aliasing_u[index] = logger_noise.aliasing_u_K
        coloured = coloured or logger_noise.is_coloured
        if hides_noise[index].all():  # rounding makes waves of slow changes
            logger_noise = replace(logger_noise, waves=())
        subject = channels[index[0]] if len(index) == 1 else f"{len(index)} channels"
        findings += [finding.in_unit(unit) for finding in logger_noise.findings(subject)]
        for c in index:
            listed[c] = logger_noise.whitened_chain(listed[c])
    for flag, name in zip(flags.T, channels):
        findings += _flag_findings(flag, name)
    good = flags == GOOD
    if coloured:
        late_s = None
    if late_s is not None and not any(chain.mean_s for chain in listed):
        data = own
    filled = np.stack([interpolate_gaps(x, g) for x, g in zip(data.T, good.T)], axis=1)
    events = tuple(sorted({float(e) for e in events_s if 0 < e < (n - 1) * dt_s}))
    return Record(
        filled,
        good.astype(float),
        dt_s,
        tuple(listed),
        tuple(sensors(listed, dt_s)),
        events,
        noise,
        flags,
        not is_estimated or coloured,
        np.hypot(aliasing_u, rounding_u),
        rounding_u,
        tuple(findings),
        unit_of_channel,
        tuple(models),
        late_s=late_s,
    )


def whole_mean_s(mean_s: float, dt_s: float, is_uneven: bool = False) -> float:
    """Time of a mean [s] over a whole number of rows, or over a part of one row.

    Parameters
    ----------
    mean_s
        Time of the mean as stated [s].
    dt_s
        Time from row to row [s].
    is_uneven
        Whether the rows are uneven, so that this time is a mean one.

    Returns
    -------
    float
        The time of the mean; zero where it is that of an instant.

    Raises
    ------
    InputError
        For a mean over other times, or over more than ``MOST_MEAN_ROWS`` rows.

    Examples
    --------
    >>> whole_mean_s(3.01, 1.0), whole_mean_s(0.4, 1.0), whole_mean_s(1e-6, 1.0)
    (3.0, 0.4, 0.0)
    """
    if mean_s < INSTANT * dt_s:
        return 0.0
    rows = round(mean_s / dt_s)
    share = WHOLE_ROWS_UNEVEN if is_uneven else WHOLE_ROWS
    if rows and abs(mean_s - rows * dt_s) <= share * mean_s:
        if rows <= MOST_MEAN_ROWS:
            return rows * dt_s
        raise InputError(
            f"each row is a mean over {mean_s:g} s, which are {rows} rows",
            expected=f"a mean over at most {MOST_MEAN_ROWS} rows",
            remedy="keep fewer rows, such as one for each mean",
        )
    if mean_s > dt_s:
        raise InputError(
            f"each row is a mean over {mean_s:g} s, but rows are {dt_s:.4g} s apart",
            expected="a mean over a whole number of rows, or over a part of one",
        )
    return mean_s


def least_noise_sd(y: Array) -> Array:
    """Least standard deviation (M,) [K] that the noise of readings (N, M) may be estimated as.

    >>> least_noise_sd(np.array([[20.0], [-30.0]]))
    array([9.e-06])
    """
    return np.asarray(EXACT_NOISE_REL * np.nanmax(np.abs(y), axis=0))


def _check_channel(flag: NDArray[np.uint8], name: str) -> None:
    """Check that a channel does not mostly repeat one value and has enough good samples.

    Parameters
    ----------
    flag
        Flags (N,) of the channel.
    name
        Its name.

    Raises
    ------
    InputError
        If more than half of the samples repeat one value, or fewer than ``MIN_GOOD_SAMPLES`` are
        good.
    """
    if np.mean(flag & (STUCK | SATURATED) != 0) > 0.5:
        raise InputError(
            f"{name}: more than half of the samples repeat one value",
            expected="a trace with noise on it",
            remedy="check the wiring and the range of this channel, or leave it out",
        )
    if np.count_nonzero(flag == GOOD) < MIN_GOOD_SAMPLES:
        raise InputError(
            f"smooth: {name} has fewer than {MIN_GOOD_SAMPLES} good samples",
            remedy="leave this channel out",
        )


def _flag_findings(flag: NDArray[np.uint8], name: str) -> list[Finding]:
    """A finding for repeated values, or else for many bad samples, of one channel.

    Parameters
    ----------
    flag
        Flags (N,) of the channel.
    name
        Its name.
    """
    stuck = flag & (STUCK | SATURATED) != 0
    if stuck.any():
        percent = 100 * float(np.mean(stuck))
        first = int(np.argmax(stuck))
        return [warning("trace.stuck", subject=name, percent=percent, first_sample=first)]
    is_read = flag & MISSING == 0
    n_read = int(np.count_nonzero(is_read))
    bad = 1 - int(np.count_nonzero(flag == GOOD)) / max(n_read, 1)
    if bad > REPORTED_BAD_SHARE:
        return [info_or_warning(bad, "trace.bad", subject=name, percent=100 * bad)]
    return []


def _implausible_readings(
    data: Array,
    dt_s: float,
    chains: Sequence[Chain],
    names: Sequence[str],
    units: Sequence[str],
) -> tuple[Flags, list[Finding]]:
    """Readings that no temperature can produce through the chains, and the findings about them.

    These are values out of range, error codes of the logger, and changes faster than the chain. Of
    other quantities, whose range is not known, they are overload codes and error codes.

    Parameters
    ----------
    data
        Readings (N, M) in their units.
    dt_s
        Sampling interval [s].
    chains
        Chain of each channel (M,).
    names
        Name of each channel (M,).
    units
        Unit of each channel (M,).

    Returns
    -------
    mask
        Implausible readings (N, M).
    findings
        Findings by channel.

    Notes
    -----
    Few and short ones (a share of at most ``FEW_IMPLAUSIBLE``, and runs no longer than a spike) are
    left to the spike rule; values out of range are always marked.
    """
    mask = np.zeros(data.shape, dtype=bool)
    findings = []
    for c, (chain, name, unit) in enumerate(zip(chains, names, units)):
        y = data[:, c]
        is_temperature = unit in TEMPERATURES
        kind = Kind.TEMPERATURE if is_temperature else Kind.QUANTITY
        reasons = reasons_of(y, kind)
        beyond = out_of_range(y) if is_temperature else np.abs(y) > overload_limit(y)
        outside = beyond & (reasons != READING)
        codes = (reasons == CODE) & ~outside
        inside = np.where(outside, np.nan, y)
        lag_s = max(chain.taus_s, default=0.0)
        remaining = np.where(codes, np.nan, inside)
        # share of a step that passes the chain at once
        feedthrough = min(max(chain.zero_s, 0.0) / lag_s, 1.0) if lag_s > 0 else 1.0
        too_fast = np.zeros(len(y), dtype=bool)
        if is_temperature:
            too_fast = impossible_changes(remaining, dt_s, lag_s, feedthrough)
        wrong = codes | too_fast
        edges = np.flatnonzero(np.diff(np.concatenate([[False], wrong, [False]])))
        longest = int(np.max(np.diff(edges)[::2], initial=0))
        if wrong.mean() <= FEW_IMPLAUSIBLE and longest <= SPIKES["compensator"].longest:
            wrong[:] = False
            codes[:] = False
            too_fast[:] = False
        mask[:, c] = outside | wrong
        if outside.any():
            share = float(outside.mean())
            numbers = _first_of(outside, y)
            code = "trace.outside" if is_temperature else "trace.overload"
            outside_finding = info_or_warning(share, code, subject=name, **numbers)
            findings.append(outside_finding.in_unit(unit))
        if codes.any():
            codes_finding = warning("trace.codes", subject=name, **_first_of(codes, y))
            findings.append(codes_finding.in_unit(unit))
        if too_fast.any():
            findings.append(warning("trace.unreachable", subject=name, **_first_of(too_fast, y)))
    return mask, findings


def _first_of(bad: Flags, y: Array) -> dict[str, Any]:
    """Number of bad readings, and index and value of the first.

    Parameters
    ----------
    bad
        Mask (N,) with at least one bad reading.
    y
        Readings (N,) [degC].
    """
    first = int(np.argmax(bad))
    return {"count": int(bad.sum()), "first_sample": first, "value": float(y[first])}


def _sample_flags(y: Array) -> NDArray[np.uint8]:
    """Bits MISSING, STUCK, SATURATED for each sample of ``y`` (N,).

    A sample is stuck, or saturated at the extremes, in a run of one value that is longer than
    chance repeats at the resolution of this record.
    """
    flags = np.where(np.isfinite(y), GOOD, MISSING).astype(np.uint8)
    index = np.flatnonzero(flags == GOOD)
    if len(index) >= SPIKES["compensator"].width:
        trace = y[index]
        at_extreme = (trace == trace.max()) | (trace == trace.min())
        flag = np.where(at_extreme, SATURATED, STUCK)
        flags[index] = np.where(long_runs(trace), flag, GOOD)
    return flags


@dataclass(frozen=True, repr=False)
class Compensated(Result):
    """A compensated record; all arrays (N, M), one column a channel.

    Parameters
    ----------
    temperature
        Temperature at the junction at ``time_s`` [degC].
    sd
        Its standard deviation [K], from the next four contributions.
    sd_noise
        Standard deviation from noise and regularisation [K].
    lag_sensitivity
        Change of the temperature per second of lag [K/s]; times the uncertainty of each lag.
    lag_split_K
        Change for one standard uncertainty of how a lag divides into its parts [K].
    static_u
        Standard uncertainty of the static line [K].
    slope, slope_sd
        Rate of change of the temperature [K/s], the mean over one sampling interval, and its
        standard deviation from all but the static line.
    lag_covariance
        Covariance of the lags (M, M) [s2].
    noise_sd
        Standard deviation of the noise (M,) [K].
    intensity
        Median over the record of the process-noise intensity (M,) [K2/s3].
    flags
        Bits MISSING, SPIKE, STUCK, SATURATED, IMPLAUSIBLE, ALONE.
    time_s
        Time (N,) [s].
    method
        Method in words.
    findings
        Findings about the channels.
    events_s
        Pairs of event time and its standard uncertainty [s].
    detected
        The events among them that were not listed, with what they may be.
    intensities
        Process-noise intensities as functions of time, one a channel (smoother only).
    shift_K
        Changes (N, M) [K] by one standard uncertainty of what is one error for the whole record:
        the time of each event, and the law of a lag that follows a flow. Their squares are included
        in that of ``sd_noise``.
    undetermined
        Samples (N, M) where the record does not determine the temperature, see
        ``with_undetermined``.
    names
        Names of the channels (M,).
    index
        Index (N,) of the readings, if they were a Series or a DataFrame of pandas.
    units
        Unit of each channel (M,): degC, or that of another quantity, which then is that of
        ``temperature``, ``sd`` and all other fields of this channel. Empty: degC.
    resolution_s
        Shortest time (M,) [s] over which means are determined, see
        :mod:`tcdyn.smoothing.resolution`; None: not known.
    means
        The means that were asked for; None: none.

    Notes
    -----
    sd^2 = sd_noise^2 + (lag_sensitivity u(lag))^2 + lag_split_K^2 + static_u^2, see
    ``from_components``.
    """

    temperature: Array
    sd: Array
    sd_noise: Array
    slope: Array
    slope_sd: Array
    lag_sensitivity: Array
    static_u: Array
    lag_covariance: Array
    lag_split_K: Array
    noise_sd: Array
    intensity: Array
    flags: NDArray[np.uint8]
    time_s: Array
    method: str
    findings: tuple[Finding, ...] = ()
    events_s: tuple[tuple[float, float], ...] = ()
    detected: tuple[DetectedEvent, ...] = ()
    intensities: tuple[Intensity, ...] = ()
    shift_K: tuple[Array, ...] = ()
    undetermined: Flags | None = None
    names: tuple[str, ...] = ()
    index: pd.Index[Any] | None = None
    units: tuple[str, ...] = ()
    resolution_s: Array | None = None
    means: TimeMeans | None = None

    @classmethod
    def from_components(
        cls,
        temperature: Array,
        sd_noise: Array,
        slope: Array,
        slope_sd_noise: Array,
        lag_sensitivity: Array,
        lag_covariance: ArrayLike | None,
        static_u: ArrayLike | None,
        dt_s: float,
        split_K: ArrayLike = 0.0,
        **fields: Any,
    ) -> Compensated:
        """Combine the contributions to the uncertainty of a compensated record.

        Parameters
        ----------
        temperature, sd_noise, slope, lag_sensitivity
            As the fields (N, M).
        slope_sd_noise
            Standard deviation (N, M) [K/s] of the slope from noise and regularisation.
        lag_covariance
            Covariance of the lags (M, M) [s2]; zero when left out.
        static_u
            Standard uncertainty of the static line [K], a number, (M,) or (N, M); zero when left
            out.
        dt_s
            Sampling interval [s].
        split_K
            The field ``lag_split_K`` [K], a number, (M,) or (N, M).
        fields
            The other fields.

        Notes
        -----
        sd^2 = sd_noise^2 + (lag_sensitivity u(lag))^2 + split_K^2 + static_u^2: the contributions
        are independent. For the covariance between samples or channels, ``window_covariance`` of
        :mod:`tcdyn.smoothing.smoother` and ``window_means`` of :mod:`tcdyn.smoothing.windows`
        combine the same contributions: change them together. ``tests/smoothing/test_smoother.py``
        compares them. The change of the slope by a lag is the derivative of that of the
        temperature.
        """
        n, m = temperature.shape
        lags: Array = np.zeros((m, m))
        if lag_covariance is not None:
            lags = np.asarray(lag_covariance, dtype=np.float64)
        line_u = 0.0 if static_u is None else static_u
        line = np.broadcast_to(np.asarray(line_u, dtype=np.float64), (n, m))
        split = np.broadcast_to(np.asarray(split_K, dtype=np.float64), (n, m))
        variance = sd_noise**2 + lag_sensitivity**2 * np.diag(lags) + split**2 + line**2
        lag_change = np.gradient(lag_sensitivity, dt_s, axis=0)
        split_change = np.gradient(split, dt_s, axis=0)
        slope_variance = slope_sd_noise**2 + lag_change**2 * np.diag(lags) + split_change**2
        return cls(
            temperature,
            np.sqrt(variance),
            sd_noise,
            slope,
            np.sqrt(slope_variance),
            lag_sensitivity,
            line,
            lags,
            split,
            time_s=np.arange(n, dtype=np.float64) * dt_s,
            **fields,
        )

    def with_labels(self, y: Any, names: Sequence[str] | None) -> Compensated:
        """The result with ``names``, or those of the readings ``y``, and with their index."""
        return replace(
            self,
            names=tuple(names or labels_of(y)),
            index=common_index([y], "the readings"),
        )

    def with_undetermined(
        self,
        y: Array,
        names: Sequence[str],
        chains: Sequence[Chain],
        least_range_K: ArrayLike = 0.0,
    ) -> Compensated:
        """Mark the samples that the record does not determine, with a warning for each channel.

        Parameters
        ----------
        y
            Readings (N, M) [degC], NaN or flagged where bad.
        names
            Names of the channels (M,) in messages.
        chains
            Their chains (M,).
        least_range_K
            Range [K] of the readings before the record, one or (M,).

        Notes
        -----
        A sample is undetermined where its standard uncertainty, without that of the static line,
        exceeds the range of the channel's good readings (at least ``MIN_RANGE_SD`` standard
        deviations of the noise), where its temperature is physically impossible, where no reading
        is near (see ``_without_reading``), or in a gap behind which the readings contradict all
        others (see ``tcdyn.smoothing.lone_readings``). With a smaller limit more samples are
        withheld by ``determined_estimates``.
        """
        readings = np.where(self.flags == GOOD, y, np.nan)
        highest = np.fmax.reduce(readings, axis=0)
        range_K = np.fmax(highest - np.fmin.reduce(readings, axis=0), least_range_K)
        variance = np.maximum(self.sd**2 - self.static_u**2, 0.0)
        wide = np.sqrt(variance) > np.maximum(range_K, MIN_RANGE_SD * self.noise_sd)
        unphysical = (self.temperature < LOWEST_DEGC) | (self.temperature > HIGHEST_DEGC)
        unphysical &= np.array([unit.is_temperature for unit in self._units])
        dt_s = float(self.time_s[1] - self.time_s[0])
        far = [
            _without_reading(flags == GOOD, chain.lag_s / dt_s)
            for flags, chain in zip(self.flags.T, chains)
        ]
        undetermined = wide | unphysical | np.stack(far, axis=1)
        beyond = np.stack([_beyond_contradiction(flags) for flags in self.flags.T], axis=1)
        findings = list(self.findings)
        for c in np.flatnonzero(beyond.any(axis=0)):
            is_alone = self.flags[:, c] & ALONE != 0
            finding = warning(
                "trace.alone",
                subject=names[c],
                count=int(is_alone.sum()),
                first_sample=int(np.argmax(is_alone)),
            )
            findings.append(finding.in_unit(self._units[c].name))
        undetermined &= ~beyond
        means = self.means
        is_withheld = undetermined
        if means is not None:
            largest_u = np.maximum(range_K, MIN_RANGE_SD * self.noise_sd)
            is_withheld = np.stack(far, axis=1)[means.sample] | (means.sd_noise > largest_u)
            means = means.without(is_withheld | beyond[means.sample])
        samples = np.arange(len(undetermined)) if means is None else means.sample
        for c in np.flatnonzero(is_withheld.any(axis=0)):
            column = is_withheld[:, c]
            numbers: dict[str, Any] = {
                "percent": 100 * float(column.mean()),
                "first_sample": int(samples[np.argmax(column)]),
            }
            numbers["range_K"] = float(range_K[c])
            is_too_fast = (wide & ~np.stack(far, axis=1))[:, c]
            if self.resolution_s is not None and means is None and is_too_fast.any():
                numbers["resolution_s"] = even_rows_s(float(self.resolution_s[c]), dt_s)
            finding = warning("trace.undetermined", subject=names[c], **numbers)
            findings.append(finding.in_unit(self._units[c].name))
        undetermined |= beyond
        return replace(self, undetermined=undetermined, findings=tuple(findings), means=means)

    def determined_estimates(self) -> tuple[Array, Array]:
        """Temperature and its standard uncertainty, NaN where undetermined.

        Returns
        -------
        temperature
            Temperature (N, M) [degC].
        sd
            Standard uncertainty (N, M) [K].
        """
        if self.undetermined is None or not self.undetermined.any():
            return self.temperature, self.sd
        temperature = np.where(self.undetermined, np.nan, self.temperature)
        return temperature, np.where(self.undetermined, np.nan, self.sd)

    def determined_rates(self) -> tuple[Array, Array]:
        """Rate of change and its standard deviation (N, M) [K/s], NaN where undetermined."""
        if self.undetermined is None or not self.undetermined.any():
            return self.slope, self.slope_sd
        slope = np.where(self.undetermined, np.nan, self.slope)
        return slope, np.where(self.undetermined, np.nan, self.slope_sd)

    def noise_sd_of_rows(self) -> Array:
        """The part of ``sd`` (N, M) [K] that differs from row to row, near in time correlated."""
        of_record = sum((shift_K**2 for shift_K in self.shift_K), np.zeros_like(self.sd))
        return np.asarray(np.sqrt(np.maximum(self.sd_noise**2 - of_record, 0.0)))

    def common_sd(self) -> Array:
        """Contribution (N, M) [K] to ``sd`` of the lag error that all channels have in common.

        The standard uncertainty of the mean lag of the channels, times the sensitivity of each
        sample.
        """
        return np.abs(self.lag_sensitivity) * common_lag_u_s(self.lag_covariance)

    def summary(self, names: Sequence[str] = ()) -> str:
        """A few lines of text with the warnings; channels are numbered without ``names``."""
        return "\n".join([*self.lines(names), *self.warnings])

    def lines(self, names: Sequence[str] = ()) -> list[str]:
        """The summary without its warnings; ``names`` as for ``summary``."""
        lines = [
            f"{self.method}: {self.temperature.shape[0]} samples, "
            f"{self.temperature.shape[1]} channels"
        ]
        for c, of_channel in enumerate(self._units):
            name = names[c] if names else c + 1
            unit = of_channel.base_difference
            lines.append(
                f"  channel {name}: noise {self.noise_sd[c]:.3g} {unit}, "
                f"standard deviation {np.median(self.sd[:, c]):.3g} {unit} typical, "
                f"{np.max(self.sd[:, c]):.3g} {unit} at most, "
                f"{np.count_nonzero(self.flags[:, c])} samples flagged"
            )
        common = float(np.max(self.common_sd()))
        differences = {unit.base_difference for unit in self._units}
        if common > 0 and len(differences) == 1:
            lines.append(
                "  the lag common to all channels moves them together "
                f"by up to {common:.2g} {differences.pop()} (1 sd)"
            )
        return [*lines, *(f"  event at {text_with_u(t, u, 's')}" for t, u in self.events_s)]

    def to_dict(self) -> dict[str, Any]:
        """Figures of the result, channel by channel; the samples are in the arrays."""
        suffix = "_K" if self._are_temperatures else ""
        return {
            "method": self.method,
            "samples": len(self.time_s),
            "channels": jsonable(self.card()),
            f"common_sd_max{suffix}": float(np.max(self.common_sd())),
            "events_s": [{"value": t, "u": u} for t, u in self.events_s],
            "warnings": list(self.warnings),
        }

    def to_frame(self) -> pd.DataFrame:
        """Temperature and standard deviation of each channel, NaN where undetermined.

        Where means were asked for, they are the rows, at the times in their middle.

        Returns
        -------
        DataFrame
            Columns ``<channel>_degC`` and ``<channel>_u_K``, where ``<channel>`` is the name of
            the channel without a unit of degrees Celsius at its end. Of another quantity the
            column keeps its name, and the other is ``<channel>_u_<unit>``. The index is that of
            the readings, or the time [s].
        """
        index = pd.Index(self.time_s, name="time_s") if self.index is None else self.index
        temperature, sd = self.determined_estimates()
        if self.means is not None:
            temperature = self.means.mean
            sd = self.means.sd
            index = index[self.means.row]
        columns = {}
        for c in range(temperature.shape[1]):
            name = self.names[c] if self.names else f"channel_{c + 1}"
            unit = self._units[c]
            if not unit.is_temperature:
                columns[name] = temperature[:, c]
                columns[unit.names(name).u] = sd[:, c]
                continue
            base = without_unit(name) if unit_in(name) == "degC" else name
            columns[f"{base}_degC"] = temperature[:, c]
            columns[f"{base}_u_K"] = sd[:, c]
        return pd.DataFrame(columns, index)

    def card(self) -> pd.DataFrame:
        """Noise, typical and largest standard deviation and flagged samples of each channel.

        They are in kelvins; if a channel is no temperature, the names of the columns do not say
        so, and ``unit`` is the unit of each channel.
        """
        suffix = "_K" if self._are_temperatures else ""
        table = pd.DataFrame(
            {
                "channel": range(self.temperature.shape[1]),
                f"noise_sd{suffix}": self.noise_sd,
                f"sd_median{suffix}": np.median(self.sd, axis=0),
                f"sd_max{suffix}": np.max(self.sd, axis=0),
                "flagged": np.count_nonzero(self.flags, axis=0),
            }
        )
        if not self._are_temperatures:
            table["unit"] = [unit.base_difference for unit in self._units]
        return table

    @property
    def _units(self) -> list[Unit]:
        """Unit of each channel (M,)."""
        units = self.units or ("degC",) * self.temperature.shape[1]
        return [Unit("degC" if name in TEMPERATURES else name, NO_COUPLE) for name in units]

    @property
    def _are_temperatures(self) -> bool:
        """Whether all channels are temperatures."""
        return all(unit.is_temperature for unit in self._units)
