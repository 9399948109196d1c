"""Lags of two thermocouples of different size in one fluid, without a reference, noise on both.

For any fluid temperature x, y1 + tau1 y1' = x = y2 + tau2 y2' without noise. The difference of the
two sides is a sum of noises whose covariance is known for each (tau1, tau2). Generalised least
squares with that covariance is the maximum likelihood of both traces with x free at every sample.
Ordinary least squares of one trace on the other would be biased by the noise of the regressor.
Where the data require it, each side gets the shorter lags of conduction inside the sensor too.
Gain and offset of the second sensor relative to the first are free, with priors.

``tcdyn sensor`` uses it. ``tests/sensors/test_sensor_in_place.py`` checks bias and coverage,
``tests/series/test_updates.py`` channels that are updated more slowly than the rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cholesky_banded, solve_banded
from scipy.optimize import least_squares

from tcdyn.chain import NO_CONDITIONING
from tcdyn.chain.law import FlowLaw
from tcdyn.chain.logger_noise import estimate_logger_noise
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Z95, Estimate
from tcdyn.core.findings import Finding, error, info, warning
from tcdyn.core.threads import one_blas_thread
from tcdyn.estimation.clock_rate import CLOCK_LIMIT
from tcdyn.estimation.trace_noise import SPIKES, find_spikes
from tcdyn.sensors.conduction import SECOND_TO_ALL, conduction_chain, inner_lags
from tcdyn.sensors.file import SensorFile, sensor_file, undetermined_lag_error
from tcdyn.sensors.sparse_rows import Intervals, find_intervals, interval_residuals
from tcdyn.sensors.step_fits import white_noise_K
from tcdyn.series.updates import even_spacing

# Exponent n of the film with the speed, h ~ speed^n: mean and standard deviation of its prior. h of
# a wire in crossflow rises about with the root of the speed; the standard deviation is chosen by
# judgement.
EXPONENT = (0.5, 0.1)
# Share of the first lag that is inside the sensor and does not follow the speed: mean and standard
# deviation of its prior; of bare wires there is none. By judgement, as of ``tcdyn sensor new``
INNER_SHARE = (0.2, 0.1)
NO_SHARE = (0.0, 0.0)
MIN_SHARE_SD = 1e-6  # least standard deviation of that prior in a fit: a matter of rounding only
LARGEST_SHARE = 0.95  # largest inner share that is tried: with one there would be no film
# Departure of the exponent that the readings give from its prior, in standard deviations, beyond
# which both contradict each other: 1 % by chance
CONTRADICTED = 2.58
MAX_EXPONENT = 5.0  # largest mean and standard deviation of that prior; chosen by judgement
MIN_EXPONENT_SD = 1e-3  # least standard deviation of that prior; chosen by judgement
# Rows in the shorter lag that the likelihood gets: more rows add only noise; chosen by judgement.
ROWS_IN_SHORTER_LAG = 6.0
LINE_CYCLES = 500  # periods of hum in a block in which its amplitude and phase are fitted
SCORE_BLOCKS = 40  # blocks of the record for the covariance of the scores; chosen by judgement
MIN_ROWS = 60  # usable rows in each segment of constant flow; chosen by judgement
LOG_STEP = 2e-3  # step of the logarithm of a lag in differences; chosen by judgement
# Relative standard uncertainty of a lag beyond which only the difference of the lags is reported as
# determined; chosen by judgement.
UNDETERMINED_REL = 0.3
# Share of the steps with values of both channels at either end: above it, the other steps are left
# out and missing values are not eliminated; chosen by judgement.
MIN_USABLE_SHARE = 0.5
# Share of rows with a new value: the missing values of a channel with fewer are eliminated; chosen
# by judgement.
COMPLETE_SHARE = 0.98
# Rows in the shorter lag: with fewer, the straight lines between rows bias it; chosen by judgement.
ROWS_PER_LAG = 3.0
# Natural logarithm of the second lag over the first: mean and standard deviation of its prior. The
# ratio is 0.19 in a cylinder of constant surface temperature and goes to zero with h.
LOG_SECOND_RATIO = (np.log(0.05), 1.5)
# Standard uncertainty of both lags, since the further lags are only nearly so, over the sum of the
# second and all further lags of both sensors (`python -m tests.sensors.layered_study pair`).
FURTHER_REL = 0.3
# Quantile of the normal distribution from which the data require second lags: 5 %, one-sided.
SECOND_QUANTILE = 1.64
SINGULAR_RESIDUAL = 1e3  # whitened residual of parameters that cannot be computed
# Standard uncertainty of the lags where the data do not require second lags but do not exclude them
# either, over the change of the lags by second lags (`python -m tests.sensors.layered_study pair`).
UNSHOWN_REL = 0.5
# Standard uncertainty of both lags, since the conduction inside sensors of unknown construction is
# only nearly that of the model, over the longer lag; none for bare wires
# (`python -m tests.sensors.layered_study pair`).
CONSTRUCTION_REL = 0.03
# Standard deviations of the priors of the second sensor's gain, less 1, and offset [K], relative to
# the first: twice the root of two of the tolerance of class 1 in IEC 60584-1, 0.4 % or 1.5 K.
GAIN_SD = 0.01
OFFSET_SD_K = 4.0
# Largest standard uncertainty of a free gain over that of its prior: with more the record does not
# determine it, and it is taken as 1 with the uncertainty of the prior; by judgement.
DETERMINED_GAIN = 0.5
KNOWN_GAIN_SD = 1e-6  # standard deviation of the prior of a gain that is not free
MIN_SCALE = 1e-12  # least standard deviation of a trace in its unit, against a division by zero
GAIN_U = 3.0  # standard uncertainties by which a gain that is reported differs from 1
N_STARTS = 3  # starts of the fit; chosen by judgement
# What limits the lags: the contributions to their uncertainty by name.
SECOND_LAGS_LIMIT = "second lags, which the data do not exclude; bare wires have none (--bare)"
CONSTRUCTION_LIMIT = "the construction of the sensors; bare wires have none (--bare)"
GAIN_LIMIT = "the gain of one sensor relative to the other, which the record does not show"
FLUID_LIMIT = "noise and fluctuations of the fluid"
SECOND_STARTS = (0.05, 0.2)  # second lag over the first at the start of the fit; by judgement
# Logarithm of the change of all lags along the record: mean and standard deviation of the prior of
# the alternative to a drift of the delay. So wide that the prior does not matter.
STEADY_CHANGE = (0.0, 10.0)
MISFIT_RATIO = 1.5  # mean square of the residuals beyond which a warning is given; by judgement


@dataclass(frozen=True)
class PairData:
    """Two traces of one fluid.

    Attributes
    ----------
    first, second
        Readings (N,) [degC], NaN where missing.
    dt_s
        Interval [s].
    noise_K
        White noise of each channel [K].
    segment
        Number of the segment of constant flow of each row (N,).
    log_speed
        Log of the speed over its median (N,).
    segments
        Number of segments.
    exponent
        Prior of the exponent n, mean and standard deviation.
    inner_share
        Prior of the share of the first lags that does not follow the speed.
    intervals
        Intervals between rows with a new value of both channels, where one channel has new values
        in some rows only; None where each row has both.
    second_lags
        Each sensor has a second lag and further ones; otherwise one lag.
    gain
        Prior of the second sensor's gain less 1, mean and standard deviation.
    offset_sd
        Standard deviation of the prior of its offset [K]; None: that of its trace.
    drifts
        The delay of the second trace behind the first changes at a constant rate, which is the
        parameter after the offset.
    """

    first: Array
    second: Array
    dt_s: float
    noise_K: tuple[float, float]
    segment: NDArray[np.intp]
    log_speed: Array
    segments: int
    exponent: tuple[float, float]
    inner_share: tuple[float, float] = NO_SHARE
    intervals: Intervals | None = None
    second_lags: bool = False
    gain: tuple[float, float] = (0.0, GAIN_SD)
    offset_sd: float | None = OFFSET_SD_K
    drifts: bool = False

    def prior_residuals(self, theta: Array) -> Array:
        """Return the residuals of the priors, of all but the first lags and the rate."""
        share, share_sd = self.inner_share
        law_mean = np.array([self.exponent[0], share])
        law_sd = np.array([self.exponent[1], max(share_sd, MIN_SHARE_SD)])
        gain, offset = theta[2 * self.segments : 2 * self.segments + 2]
        scale = self.second_scale[1]
        offset_sd = 1.0 if self.offset_sd is None else self.offset_sd / max(scale, MIN_SCALE)
        n_second = 2 * self.second_lags
        after_exponent = len(theta) - n_second
        law = theta[self.before_exponent : after_exponent]
        size = len(law)  # exponent and share, or none
        first = theta[2 * self.segments - 2 : 2 * self.segments][:n_second]
        log_ratio = theta[after_exponent:] - first
        mean_ratio, sd_ratio = LOG_SECOND_RATIO
        return np.r_[
            (gain - self.gain[0]) / self.gain[1],
            offset / offset_sd,
            (law - law_mean[:size]) / law_sd[:size],
            (log_ratio - mean_ratio) / sd_ratio,
        ]

    @property
    def before_exponent(self) -> int:
        """Number of parameters before the exponent: first lags, gain, offset, rate of the delay."""
        return 2 * self.segments + 2 + self.drifts

    @property
    def duration_s(self) -> float:
        """Length of the record [s]."""
        return len(self.first) * self.dt_s

    @property
    def second_scale(self) -> tuple[float, float]:
        """Mean and standard deviation of the second trace [degC, K]."""
        return float(np.nanmean(self.second)), float(np.nanstd(self.second))

    def second_like_first(self, theta: Array) -> Array:
        """Return the second trace (N,) without its gain and offset relative to the first [degC]."""
        gain, offset = theta[2 * self.segments : 2 * self.segments + 2]
        mean, sd = self.second_scale
        return np.asarray(mean + (self.second - mean) / (1 + gain) - offset * sd)


@one_blas_thread
def pair_sensor(
    time_s: Array,
    first: Array,
    second: Array,
    columns: tuple[str, str],
    *,
    sensor: str = "pair",
    speed: Array | None = None,
    changes_s: Sequence[float] = (),
    exponent: tuple[float, float] = EXPONENT,
    inner_share: tuple[float, float] | None = None,
    quantity: str = "speed",
    bare: bool = False,
    repeats_values: bool = False,
    offset_sd: float | None = OFFSET_SD_K,
    **more: Any,
) -> SensorFile:
    """Lags of two sensors in one fluid from their readings.

    Parameters
    ----------
    time_s
        Even times (N,) [s].
    first, second
        Readings (N,) [degC], NaN where missing.
    columns
        Their names.
    sensor
        Name of the sensor.
    speed
        Speed of the flow (N,), in any unit, above zero.
    changes_s
        Times of steps of the flow, on the clock of ``time_s`` [s].
    exponent
        Prior of n, mean and standard deviation.
    inner_share
        Share of the first lags that does not follow the speed, mean and standard deviation; None:
        ``INNER_SHARE``, of bare wires zero.
    quantity
        Name of the speed with its unit, for the law in the file.
    bare
        Both are bare wires, which have one lag each: second lags are not considered.
    repeats_values
        Whether a trace is NaN where its last value was repeated.
    offset_sd
        Standard deviation of the prior of the difference of both readings at rest [K]; None: that
        of the second trace, for a quantity of which no tolerance is known.
    more
        Other fields of the file.

    Returns
    -------
    SensorFile
        The file of both columns. A warning says where the traces determine only the difference of
        the lags.

    Raises
    ------
    InputError
        Shapes that differ, speeds that are not positive, a segment of fewer than 60 rows, the same
        trace twice, new values of both in too few rows, or too seldom for the shorter lag.

    Notes
    -----
    Each sensor has one lag; or, unless it is ``bare`` and where the data require it
    (``_requires_second``), a second one, which does not depend on the flow, and further ones of
    conduction inside it (``inner_lags``). First lags are constant; or tau = tau_0 (s + (1 - s)
    (speed/its median)^-n) with n and s free, and ``exponent`` and ``inner_share`` as their priors,
    see ``tcdyn.chain.law.FlowLaw``; or constant between ``changes_s``. Then
    the file holds the lags of the last segment, and ``fit`` those of all. Both columns of a row are
    taken as sampled at one instant: a scanner that reads the second one later biases both lags by
    more than that time. A delay that drifts along the record, as of two loggers, is named, but not
    where a column has new values in some rows only. A column that is repeated or blank between new
    values is used at the rows of its new values.

    Where the sensors are not bare, both lags have a common error of ``CONSTRUCTION_REL`` of the
    longer one. The limits are thresholds of messages, but for ``ROWS_IN_SHORTER_LAG``,
    ``MIN_USABLE_SHARE`` and ``COMPLETE_SHARE``, which decide what data the likelihood gets.
    ``tests/series/test_updates.py`` and ``tests/sensors/test_sensor_in_place.py`` fail where
    the lags are then wrong.
    """
    row_dt_s = float(time_s[1] - time_s[0])
    if speed is not None and changes_s:
        raise InputError("a speed and instants of change were both given", expected="one of them")
    if not (abs(exponent[0]) <= MAX_EXPONENT and MIN_EXPONENT_SD <= exponent[1] <= MAX_EXPONENT):
        expected = "0.5+-0.1 or the like: 5 at most, uncertain by 0.001 to 5"
        raise InputError(f"an exponent of {exponent[0]:g} +- {exponent[1]:g}", expected=expected)
    log_speed = np.zeros(len(time_s)) if speed is None else _log_speed(time_s, speed)
    for name, y in zip(columns, (first, second)):
        count = np.count_nonzero(np.isfinite(y))
        if count < MIN_ROWS:
            raise InputError(f"{name} holds {count} numbers", expected=f"at least {MIN_ROWS}")
    data = PairData(
        first=first,
        second=second,
        dt_s=row_dt_s,
        noise_K=(white_noise_K(first), white_noise_K(second)),
        segment=np.digitize(time_s, sorted(changes_s)).astype(np.intp),
        log_speed=log_speed,
        segments=len(changes_s) + 1,
        exponent=exponent,
        inner_share=inner_share or (NO_SHARE if bare else INNER_SHARE),
        offset_sd=offset_sd,
    )
    data = _with_new_values(data, columns, repeats_values)
    findings: list[Finding] = []
    if data.intervals is None:
        data, findings = _cleaned(data, columns)
    noise_K = data.noise_K if data.intervals is None else [min(data.noise_K)] * 2
    if np.nanstd(data.first - data.second) < 1.05 * np.hypot(noise_K[0], noise_K[1]):
        raise InputError(
            f"{columns[0]} and {columns[1]} read the same within noise",
            expected="two sensors of different size",
        )
    n_lags = 2 * data.segments
    exponents = [] if speed is None else [exponent[0], data.inner_share[0]]
    starts = _grid_starts(data, exponents)
    for _ in range(2):
        size = max(int(np.exp(starts[0][:n_lags].min()) / ROWS_IN_SHORTER_LAG / data.dt_s), 1)
        averaged = averaged_rows(data, size)
        if usable_rows(averaged) < MIN_ROWS:
            averaged = data
        usable = usable_rows(averaged)
        if usable < MIN_ROWS:
            what = f"a segment of {usable} rows with new values of {columns[0]} and {columns[1]}"
            raise InputError(what, expected=f"at least {MIN_ROWS} between changes of flow")
        theta = _search_minimum(averaged, starts)
        if averaged.intervals is not None:
            data = _with_fitted_noise(averaged, theta)
            averaged = data
            theta = _search_minimum(averaged, [theta])
        starts = [theta]
    shorter_s = float(np.exp(theta[:n_lags].min()))
    if data.dt_s > row_dt_s and data.dt_s > shorter_s / ROWS_PER_LAG:
        raise InputError(
            f"{columns[0]} and {columns[1]} have a new value every {data.dt_s:.3g} s only "
            f"(rows every {row_dt_s:.3g} s), the shorter lag is about {shorter_s:.2g} s",
            expected=f"a new value at least every {shorter_s / ROWS_PER_LAG:.2g} s",
            remedy="log both columns faster, at one rate",
        )
    best = _fit(averaged, theta)
    one_lag = best
    fitted = averaged
    unshown_s = np.zeros(n_lags)
    if averaged.intervals is None and not bare:
        two = replace(averaged, second_lags=True)
        two_lags = _fit(two, _search_minimum(two, _grid_starts(two, exponents)))
        if _requires_second(best, two_lags):
            best = two_lags
            fitted = two
        else:
            difference_s = _total_lags(two_lags, n_lags)[0] - np.exp(theta[:n_lags])
            unshown_s = UNSHOWN_REL * difference_s
    has_second_lags = best is not one_lag
    best, gain, by_gain_s = _with_gain(fitted, best)
    covariance = best.covariance
    if not (np.all(np.isfinite(covariance)) and np.all(np.diag(covariance) > 0)):
        raise undetermined_lag_error(", ".join(columns))
    taus, lag_covariance = _total_lags(best, n_lags)
    # what the fluid would determine if the construction were known
    one_lag_covariance = lag_covariance.copy()
    if has_second_lags:
        one_lag_covariance = _total_lags(_with_gain(averaged, one_lag)[0], n_lags)[1]
    fluid_covariance = one_lag_covariance + np.outer(by_gain_s, by_gain_s)
    by_second_lags = np.maximum(np.diag(lag_covariance - one_lag_covariance), 0.0)
    longer_s = np.repeat(taus.reshape(-1, 2).max(axis=1), 2)
    common_s = (0.0 if bare else CONSTRUCTION_REL) * longer_s
    for error_s in (by_gain_s, unshown_s, common_s):
        lag_covariance += np.outer(error_s, error_s)
    contributions_s = {
        FLUID_LIMIT: np.sqrt(np.diag(one_lag_covariance)),
        GAIN_LIMIT: np.abs(by_gain_s),
        SECOND_LAGS_LIMIT: np.abs(unshown_s),
        CONSTRUCTION_LIMIT: np.sqrt(by_second_lags + common_s**2),
    }
    largest_rel = {name: float(np.max(u / taus)) for name, u in contributions_s.items()}
    limited_by = max(largest_rel, key=lambda name: largest_rel[name])
    if abs(gain.value - 1) > GAIN_U * gain.u:
        finding = info(
            "sensor.pair_gain",
            subject=columns[1],
            other=columns[0],
            percent=100 * (gain.value - 1),
            u=100 * gain.u,
        )
        findings.append(finding)
    if fitted.intervals is None:
        findings += _clock_findings(fitted, best, columns)
    covariances = (fluid_covariance, lag_covariance)
    findings += _lag_findings(averaged, taus, covariances, best.mean_square, columns)
    last = slice(n_lags - 2, n_lags)
    log_covariance = (lag_covariance / np.outer(taus, taus))[last, last]
    ratio = float(taus[n_lags - 2] / taus[n_lags - 1])
    ratio_u = ratio * _difference_u(log_covariance)
    fit: dict[str, Any] = {
        "chi2": best.mean_square,
        "noise_K": list(averaged.noise_K),
        "limited_by": limited_by,
        "ratio": Estimate.normal(ratio, ratio_u).model_dump(),
        "gain": gain.model_dump(),
    }
    subject = ", ".join(columns)
    law: FlowLaw | None = None
    if speed is not None:
        median = float(np.nanmedian(speed))
        of_speed, law, speed_findings = _results_of_speed(
            averaged, best, taus[last], quantity, median, subject
        )
        fit |= of_speed
        findings += speed_findings
    if changes_s:
        lag_u = np.sqrt(np.diag(lag_covariance))
        lags = [Estimate.normal(tau, u).model_dump() for tau, u in zip(taus, lag_u)]
        fit["changes_s"] = list(map(float, changes_s))
        fit["stretches"] = [dict(zip(columns, lags[k : k + 2])) for k in range(0, n_lags, 2)]
        what = f"the segment after {max(changes_s):.6g} s"
        findings.append(warning("sensor.pair_flow", subject=subject, what=what))
    chains = {}
    split_u_s: list[float] = []
    for column, lag, second in zip(columns, taus[last], best.second_s):
        chains[column] = conduction_chain(float(lag - SECOND_TO_ALL * second), float(second))
        split_u_s.append(float(second))
    return sensor_file(
        sensor,
        chains,
        "pair",
        lag_covariance[last, last],
        split_u_s,
        fit=fit,
        findings=findings,
        law=law,
        **more,
    )


def _results_of_speed(
    data: PairData, fit: _Fit, lags_s: Array, quantity: str, at: float, subject: str
) -> tuple[dict[str, Any], FlowLaw | None, list[Finding]]:
    """How the lags follow the speed: entries of ``fit``, the law, and findings.

    Parameters
    ----------
    data
        The traces.
    fit
        The fit.
    lags_s
        Lags of both sensors (2,) at the median of the speed [s].
    quantity, at
        Name of the speed, and its median.
    subject
        Names of the traces.

    Returns
    -------
    entries, law, findings
        The law is None where the exponent is not that of a film, 0 to 1.

    Notes
    -----
    The inner share of the law is that of all lags, with the second ones. It is the mean of both
    sensors, and its uncertainty contains half of their difference. The readings contradict the
    prior of the exponent if it moves by more than ``CONTRADICTED`` standard deviations of that
    move, of which the variance is that of the prior less that of the result.
    """
    k = data.before_exponent
    exponent, share = fit.theta[k : k + 2].tolist()
    exponent_u, share_u = np.sqrt(np.diag(fit.covariance)[k : k + 2]).tolist()
    entries = {
        "exponent": Estimate.normal(exponent, exponent_u).model_dump(),
        "inner_share": Estimate.normal(share, share_u).model_dump(),
        "speed_median": at,
    }
    findings = []
    move_u = np.sqrt(max(data.exponent[1] ** 2 - exponent_u**2, 0.0))
    if abs(exponent - data.exponent[0]) > CONTRADICTED * move_u > 0:
        finding = warning(
            "sensor.pair_exponent",
            subject=subject,
            exponent=exponent,
            stated=data.exponent[0],
            stated_u=data.exponent[1],
        )
        findings.append(finding)
    if not 0 <= exponent <= 1:
        what = f"speed {at:.4g}"
        findings.append(warning("sensor.pair_flow", subject=subject, what=what))
        return entries, None, findings
    first_s = lags_s - SECOND_TO_ALL * fit.second_s
    shares = 1 - first_s * (1 - share) / lags_s
    least = float(np.max(1 - first_s / lags_s))  # the film is part of the first lag
    law_share = max(float(np.mean(shares)), least)
    law_share_u = float(np.hypot(share_u, 0.5 * np.ptp(shares)))
    law = FlowLaw(at, exponent, exponent_u, law_share, law_share_u, quantity=quantity)
    return entries, law, findings


def _log_speed(time_s: Array, speed: Array) -> Array:
    """Return the log of the speed over its median; missing speeds are interpolated.

    Parameters
    ----------
    time_s
        Times (N,) [s].
    speed
        Speed (N,), NaN where missing.

    Returns
    -------
    array
        Logarithm (N,).

    Raises
    ------
    InputError
        For a speed that is not above zero.
    """
    if not np.all(np.nan_to_num(speed, nan=1.0) > 0):
        raise InputError(
            "the speed is not above zero everywhere",
            expected="the speed of the flow, in any unit",
        )
    finite = np.isfinite(speed)
    if not finite.any():
        raise InputError("the speed is missing in all rows", expected="the speed of the flow")
    filled = np.interp(time_s, time_s[finite], speed[finite])
    return np.log(filled / np.median(filled))


def _with_new_values(data: PairData, columns: tuple[str, str], repeats_values: bool) -> PairData:
    """Select the rows with values of both channels, or the intervals between them.

    Parameters
    ----------
    data
        The traces, NaN where there is no new value.
    columns
        Their names.
    repeats_values
        Whether one of the channels was repeated between its new values.

    Returns
    -------
    data
        The traces at the rows of the denser channel; unchanged where most rows have both.

    Raises
    ------
    InputError
        Where too few rows have a new value of both.
    """
    finite = [np.isfinite(y) for y in (data.first, data.second)]
    both = finite[0] & finite[1]
    usable_share = float(np.mean(both[1:] & both[:-1]))
    if not repeats_values and usable_share >= MIN_USABLE_SHARE:
        return data
    shares = [float(np.mean(each)) for each in finite]
    dense = finite[int(np.argmax(shares))]
    spacing, first_row = even_spacing(np.flatnonzero(dense))
    period = max(spacing, 1)
    rows = slice(first_row if period > 1 else 0, None, period)
    new = [each[rows] for each in finite]
    first = np.where(new[0], data.first[rows], np.nan)
    second = np.where(new[1], data.second[rows], np.nan)
    data = replace(
        data,
        first=first,
        second=second,
        dt_s=data.dt_s * period,
        segment=data.segment[rows],
        log_speed=data.log_speed[rows],
    )
    if min(float(np.mean(flags)) for flags in new) < COMPLETE_SHARE:
        data = replace(data, intervals=find_intervals((new[0], new[1]), data.segment))
    if usable_rows(data) < MIN_ROWS:
        raise _too_few(data, columns, shares)
    return replace(data, noise_K=(white_noise_K(first), white_noise_K(second)))


def _too_few(data: PairData, columns: tuple[str, str], shares: Sequence[float]) -> InputError:
    """Return the error for channels that have new values in different rows, or seldom.

    Parameters
    ----------
    data
        The traces.
    columns
        Their names.
    shares
        Share of the rows with a new value of each.

    Returns
    -------
    InputError
        The error.
    """
    texts = [
        f"{name} has a new value in {100 * share:.3g} % of the rows"
        for name, share in zip(columns, shares)
    ]
    return InputError(
        f"{' and '.join(texts)} (repeated or blank in the others); "
        f"{usable_rows(data) - 1} rows can be used",
        expected=f"at least {MIN_ROWS} rows with a new value of both "
        "in each segment of constant flow",
        remedy="log both columns at the same instants and at one rate, that of the slower one",
    )


def usable_rows(data: PairData) -> int:
    """Return the usable rows in the shortest segment of constant flow, the first one included."""
    if data.intervals is not None:
        segment = data.segment[data.intervals.start]
    else:
        finite = np.isfinite(data.first) & np.isfinite(data.second)
        same_segment = data.segment[1:] == data.segment[:-1]
        segment = data.segment[1:][finite[1:] & finite[:-1] & same_segment]
    return int(np.bincount(segment, minlength=data.segments).min()) + 1


def _with_fitted_noise(data: PairData, theta: Array) -> PairData:
    """Reduce the noise of the sparser channel until the residuals have unit variance.

    Differences of values that are far apart contain the signal too and overstate the noise.

    Parameters
    ----------
    data
        The traces.
    theta
        Parameters as in :func:`whitened_residuals`.

    Returns
    -------
    PairData
        The traces with the fitted noise; it is never larger than before.
    """
    counts = [np.count_nonzero(np.isfinite(y)) for y in (data.first, data.second)]
    sparse = 1 if counts[1] < counts[0] else 0

    def with_noise(noise_K: float) -> PairData:
        """Return the data with another noise [K] of the sparser channel."""
        both = list(data.noise_K)
        both[sparse] = noise_K
        return replace(data, noise_K=(both[0], both[1]))

    low = 1e-9
    high = data.noise_K[sparse]
    for _ in range(40):  # bisection of the logarithm
        middle = float(np.sqrt(low * high))
        if np.mean(whitened_residuals(with_noise(middle), theta) ** 2) > 1:
            low = middle
        else:
            high = middle
    return with_noise(high)


def averaged_rows(data: PairData, size: int) -> PairData:
    """Return means of several rows.

    The equations of both sensors are linear and hold for means.

    Parameters
    ----------
    data
        The traces.
    size
        Rows of a mean; below two, and for intervals, nothing changes.

    Returns
    -------
    PairData
        The means; NaN where a row is missing.
    """
    if size < 2 or data.intervals is not None:
        return data
    n = len(data.first) // size * size

    def mean(x: Array) -> Array:
        """Return the means of ``size`` values."""
        return x[:n].reshape(-1, size).mean(axis=1)

    root = np.sqrt(size)
    return replace(
        data,
        first=mean(data.first),
        second=mean(data.second),
        dt_s=data.dt_s * size,
        noise_K=(data.noise_K[0] / root, data.noise_K[1] / root),
        segment=data.segment[:n:size],
        log_speed=mean(data.log_speed),
    )


def whitened_residuals(data: PairData, theta: Array) -> Array:
    """Residuals of unit variance: differences of the two sides at the middle between rows.

    Parameters
    ----------
    data
        The traces.
    theta
        (log tau1, log tau2) of each segment, then gain less 1 and offset (over the standard
        deviation of the trace) of the second sensor, then the change of its delay over the record,
        over ``data.dt_s``, if it ``drifts``, then n and s if they are free, then the logarithms of
        the second lags if there are some.

    Returns
    -------
    array
        Residuals (N - 1,), four fewer with second lags; or one for each interval.

    Notes
    -----
    Rows next to a missing value or a change of flow are left out (residual zero). The covariance V
    of the differences is banded; V = L L', and forward substitution with L whitens the
    residuals.

    ``tcdyn.sensors.sparse_rows.interval_residuals`` has the same weights for channels with missing
    values; ``tests/series/test_updates.py`` compares it with full least squares.
    """
    second = data.second_like_first(theta)
    gain = 1 + theta[2 * data.segments]
    noises_K = (data.noise_K[0], data.noise_K[1] / gain)  # that of the second trace scales with it
    if data.intervals is not None:
        lags = np.stack([_lag_in_rows(data, theta, k) for k in (0, 1)])
        traces = np.stack([data.first, second])
        return interval_residuals(0.5 - lags, 0.5 + lags, traces, noises_K, data.intervals)
    sides = [_side_weights(data, theta, k) for k in (0, 1)]
    size, n = sides[0].shape
    residual = np.zeros(n)
    for j in range(size):
        residual += sides[0][j] * data.first[j : n + j] - sides[1][j] * second[j : n + j]
    used = np.isfinite(residual) & (data.segment[size - 1 :] == data.segment[:n])
    band = np.zeros((size, n))
    for weights, noise_K in zip(sides, noises_K):
        for d in range(size):
            band[d, : n - d] += noise_K**2 * np.sum(
                weights[d:, : n - d] * weights[: size - d, d:], axis=0
            )
    band[0] = np.where(used, band[0], 1.0)
    for d in range(1, size):
        band[d, : n - d] *= used[d:] & used[: n - d]
    try:
        factor = cholesky_banded(band, lower=True)
    except LinAlgError:  # lags so long that the covariance is singular in floating point
        return np.full(n, SINGULAR_RESIDUAL)
    return solve_banded((size - 1, 0), factor, np.where(used, residual, 0.0))


def _side_weights(data: PairData, theta: Array, channel: int) -> Array:
    """Return the weights of neighbouring rows in the fluid's temperature of one channel.

    Parameters
    ----------
    data
        The traces.
    theta
        Parameters as in :func:`whitened_residuals`.
    channel
        0 or 1.

    Returns
    -------
    array
        Weights (L, N - L + 1): row j is for the reading j rows later, L is the number of lags + 1.

    Notes
    -----
    Each lag is a factor 1 + tau d/dt, at the middle between rows: (1/2 - tau/dt) y_k + (1/2 +
    tau/dt) y_{k+1}. A delay d of the second trace is a factor 1 + d/2 d/dt of the second side and
    one of 1 - d/2 d/dt of the first: exp(d s) to the second order.
    """
    factors = [_lag_in_rows(data, theta, channel)]
    if data.second_lags:
        second = np.full_like(factors[0], np.exp(theta[len(theta) - 2 + channel]) / data.dt_s)
        factors += [ratio * second for ratio in inner_lags(1.0)]
    if data.drifts:
        change = theta[data.before_exponent - 1]  # of the delay over the record, in rows
        delay = change * (np.arange(len(data.first) - 1) / len(data.first) - 0.5)
        factors.append(0.5 * (delay if channel == 1 else -delay))
    weights = np.ones((1, len(data.first)))
    for lag in factors:
        lag = lag[: weights.shape[1] - 1]
        earlier = np.vstack([(0.5 - lag) * weights[:, :-1], np.zeros_like(lag)])
        later = np.vstack([np.zeros_like(lag), (0.5 + lag) * weights[:, 1:]])
        weights = earlier + later
    return weights


def _lag_in_rows(data: PairData, theta: Array, channel: int) -> Array:
    """Return the first lag of a channel at the middle between rows, in rows.

    Parameters
    ----------
    data
        The traces.
    theta
        Parameters as in :func:`whitened_residuals`.
    channel
        0 or 1.

    Returns
    -------
    array
        Lag over the interval (N - 1,).
    """
    n_lags = 2 * data.segments
    log_tau = theta[channel:n_lags:2][data.segment]
    law = theta[data.before_exponent : len(theta) - 2 * data.second_lags]
    if len(law):
        power, share = law
        log_tau = log_tau + np.log(share + (1 - share) * np.exp(-power * data.log_speed))
    return np.exp(0.5 * (log_tau[1:] + log_tau[:-1])) / data.dt_s


def _sum_of_squares(data: PairData, theta: Array) -> float:
    """Return the sum of squares of the whitened residuals, with those of the priors."""
    w = whitened_residuals(data, theta)
    return float(w @ w + np.sum(data.prior_residuals(theta) ** 2))


def _grid_starts(data: PairData, exponents: Sequence[float]) -> list[Array]:
    """Return starts of the parameters: the best of a coarse grid of lags.

    Parameters
    ----------
    data
        The traces.
    exponents
        Starts of exponent and inner share, if they are free.

    Returns
    -------
    list of array
        Parameters (P,) as in :func:`whitened_residuals`; the lags are equal in all segments.
    """
    duration_s = len(data.first) * data.dt_s
    grid = np.geomspace(2 * data.dt_s, duration_s / 8, 12)
    averaged = averaged_rows(data, max(len(data.first) // 3000, 1))
    candidates = [
        np.r_[np.tile(pair, data.segments), 0.0, 0.0, exponents, np.add(pair, np.log(ratio))]
        for pair, ratio in product(permutations(np.log(grid), 2), SECOND_STARTS)
    ]
    if not data.second_lags:
        candidates = [theta[:-2] for theta in candidates[:: len(SECOND_STARTS)]]
    return sorted(candidates, key=lambda theta: _sum_of_squares(averaged, theta))[:N_STARTS]


def _search_minimum(data: PairData, starts: Sequence[Array]) -> Array:
    """Return the parameters of least cost.

    Parameters
    ----------
    data
        The traces.
    starts
        Where to start (P,).

    Returns
    -------
    array
        Parameters (P,). Lags are between a tenth of a row and the length of the record.
    """
    n_lags = 2 * data.segments
    is_lag = np.full(len(starts[0]), False)
    is_lag[:n_lags] = True
    is_lag[len(is_lag) - 2 * data.second_lags :] = True
    lower = np.where(is_lag, np.log(data.dt_s / 10), -np.inf)
    upper = np.where(is_lag, np.log(len(data.first) * data.dt_s), np.inf)
    share = data.before_exponent + 1
    if len(is_lag) - 2 * data.second_lags > share:
        lower[share] = 0.0
        upper[share] = LARGEST_SHARE

    def residuals(theta: Array) -> Array:
        """Return the whitened residuals and those of the priors."""
        return np.r_[whitened_residuals(data, theta), data.prior_residuals(theta)]

    def jacobian(theta: Array) -> Array:
        """Return central differences; long lags lose digits, so that the step is not small."""
        slopes = [
            residuals(theta + step) - residuals(theta - step)
            for step in LOG_STEP * np.eye(len(theta))
        ]
        return np.transpose(slopes) / (2 * LOG_STEP)

    fits = [
        least_squares(residuals, np.clip(start, lower, upper), jacobian, bounds=(lower, upper))
        for start in starts
    ]
    return np.asarray(min(fits, key=lambda fit: fit.cost).x, dtype=np.float64)


@dataclass(frozen=True)
class _Fit:
    """Parameters with their covariance.

    Attributes
    ----------
    theta
        Parameters (P,) as in :func:`whitened_residuals`.
    covariance
        Sandwich covariance H^-1 C H^-1 (P, P).
    squares
        Squares of the whitened residuals (N,), zero where rows are left out.
    second_lags
        The last two parameters are those of the second lags.
    """

    theta: Array
    covariance: Array
    squares: Array
    second_lags: bool

    @property
    def mean_square(self) -> float:
        """Mean square of the residuals; one where noise and lags are right."""
        return float(np.mean(self.squares[self.squares != 0]))

    @property
    def second_s(self) -> Array:
        """Second lags (2,) [s], zero without them."""
        return np.exp(self.theta[-2:]) if self.second_lags else np.zeros(2)


def _fit(data: PairData, theta: Array) -> _Fit:
    """Return parameters with their covariance and residuals.

    H is half the Hessian of the cost, to which the noise contributes nothing on average. C is the
    covariance of the scores from sums over blocks of the record; it accounts for the noise of a
    trace's derivative and for residuals that are not white. Variances are not smaller than those
    for white residuals.

    Parameters
    ----------
    data
        The traces.
    theta
        Parameters (P,).

    Returns
    -------
    _Fit
        The fit.
    """
    p = len(theta)
    w = whitened_residuals(data, theta)
    steps = LOG_STEP * np.eye(p)
    scores = []
    hessian = np.zeros((p, p))
    for i, step in enumerate(steps):
        up = whitened_residuals(data, theta + step) ** 2
        down = whitened_residuals(data, theta - step) ** 2
        scores.append(0.25 * (up - down) / LOG_STEP)
        for j, other in enumerate(steps[: i + 1]):
            corners = 0.0
            for a, b in product((1, -1), repeat=2):
                corners += a * b * _sum_of_squares(data, theta + a * step + b * other)
            hessian[i, j] = corners / (8 * LOG_STEP**2)
            hessian[j, i] = hessian[i, j]
    block_starts = np.arange(0, len(w), max(len(w) // SCORE_BLOCKS, 1))
    sums = np.add.reduceat(np.array(scores), block_starts, axis=1)
    n_blocks = sums.shape[1]
    centred = sums - sums.mean(axis=1, keepdims=True)
    score_covariance = centred @ centred.T * (n_blocks / max(n_blocks - 1, 1))
    slopes = [data.prior_residuals(theta + step) - data.prior_residuals(theta) for step in steps]
    prior_jacobian = np.array(slopes) / LOG_STEP
    score_covariance += prior_jacobian @ prior_jacobian.T
    values, vectors = np.linalg.eigh(hessian)
    # with second lags, the Hessian is not less than that of their prior
    least = LOG_SECOND_RATIO[1] ** -2 if data.second_lags else 1e-3
    inverse = vectors / np.maximum(values, least) @ vectors.T
    robust = inverse @ score_covariance @ inverse
    variance = np.diag(robust)
    white_variance = np.diag(inverse) * max(float(np.mean(w**2)), 1.0)
    widening = np.sqrt(np.maximum(variance, white_variance) / np.maximum(variance, 1e-300))
    covariance = robust * np.outer(widening, widening)
    return _Fit(theta, covariance, w**2, data.second_lags)


def _requires_second(single: _Fit, two: _Fit) -> bool:
    """Return whether the data require second lags.

    Parameters
    ----------
    single, two
        The fits without and with second lags.

    Returns
    -------
    bool
        Whether the fit is better by more than the BIC of two parameters and chance.

    Notes
    -----
    The variance of the residuals depends on the lags. The difference of two fits therefore has a
    variance of its own, estimated from blocks of the record (Vuong 1989, Econometrica 57, 307).
    """
    n = len(two.squares)
    difference = single.squares[:n] - two.squares
    blocks = [block.sum() for block in np.array_split(difference, SCORE_BLOCKS)]
    chance = SECOND_QUANTILE * np.std(blocks, ddof=1) * np.sqrt(SCORE_BLOCKS)
    return bool(difference.sum() > 2 * np.log(n) + chance)


def _total_lags(fit: _Fit, n_lags: int) -> tuple[Array, Array]:
    """Return the sum of all lags of each sensor.

    Parameters
    ----------
    fit
        The fit.
    n_lags
        Number of first lags, two in each segment.

    Returns
    -------
    lags_s
        Lags of both sensors in each segment (n_lags,).
    covariance
        Their covariance [s2]; what ``FURTHER_REL`` adds is common to all.
    """
    values = np.exp(fit.theta)
    inner_s = SECOND_TO_ALL * fit.second_s
    jacobian = np.eye(n_lags, len(values)) * values
    if fit.second_lags:
        jacobian[:, -2:] = np.tile(np.diag(inner_s), (n_lags // 2, 1))
    covariance = jacobian @ fit.covariance @ jacobian.T + (FURTHER_REL * inner_s.sum()) ** 2
    return values[:n_lags] + np.tile(inner_s, n_lags // 2), covariance


def _with_gain(data: PairData, fit: _Fit) -> tuple[_Fit, Estimate, Array]:
    """Return a fit whose gain is free if the record determines it, else 1.

    Parameters
    ----------
    data
        The traces.
    fit
        The fit with a free gain.

    Returns
    -------
    fit
        The fit.
    gain
        The second sensor's gain relative to the first.
    shift_s
        Change of the total lags by one standard uncertainty of a gain that is not free (n_lags,).
    """
    n_lags = 2 * data.segments
    gain_u = float(np.sqrt(fit.covariance[n_lags, n_lags]))
    if gain_u < DETERMINED_GAIN * GAIN_SD:
        return fit, Estimate.normal(1 + fit.theta[n_lags], gain_u), np.zeros(n_lags)

    def with_gain(gain: float) -> _Fit:
        """Return the fit with this gain less 1."""
        known = replace(data, gain=(gain, KNOWN_GAIN_SD))
        start = fit.theta.copy()
        start[n_lags] = gain
        return _fit(known, _search_minimum(known, [start]))

    smaller, known, larger = (with_gain(gain) for gain in (-GAIN_SD, 0.0, GAIN_SD))
    shift_s = 0.5 * (_total_lags(larger, n_lags)[0] - _total_lags(smaller, n_lags)[0])
    return known, Estimate.normal(1.0, GAIN_SD), shift_s


def _clock_findings(data: PairData, fit: _Fit, columns: tuple[str, str]) -> list[Finding]:
    """Return a warning where the delay between both traces drifts: two clocks of other rates.

    Parameters
    ----------
    data
        The traces, at the rows of the likelihood.
    fit
        The fit without a drift.
    columns
        Names of the traces.

    Returns
    -------
    list of Finding
        Empty, or "sensor.pair_clock".

    Notes
    -----
    All parameters are fitted again with the rate of the delay. A warning needs a rate that differs
    from zero by ``CLOCK_LIMIT`` standard uncertainties. Lags that rise or fall steadily along the
    record, as in a flow that changes, also change the delay. They are fitted in its place, and the
    rate must lower the sum of squares more. This is not tested with a column of the speed, which
    the lags follow already.

    ``tests/sensors/test_pair_clock.py`` checks rate, detection and false alarms;
    ``python -m tests.sensors.pair_clock_study`` prints them.
    """
    drifting = replace(data, drifts=True)
    k = data.before_exponent  # position of the rate
    start = np.insert(fit.theta, k, 0.0)
    with_rate = _fit(drifting, _search_minimum(drifting, [start]))
    to_rate = data.dt_s / data.duration_s
    rate = to_rate * float(with_rate.theta[k])
    u = to_rate * float(np.sqrt(with_rate.covariance[k, k]))
    if not abs(rate) > CLOCK_LIMIT * u:
        return []
    by_rate = _sum_of_squares(drifting, start) - _sum_of_squares(drifting, with_rate.theta)
    has_law = len(fit.theta) - 2 * data.second_lags > k
    if not has_law:
        ramp = np.arange(len(data.first)) / len(data.first) - 0.5
        changing = replace(data, log_speed=ramp, exponent=STEADY_CHANGE, inner_share=NO_SHARE)
        start = np.insert(fit.theta, k, [0.0, 0.0])
        theta = _search_minimum(changing, [start])
        by_lags = _sum_of_squares(changing, start) - _sum_of_squares(changing, theta)
        if by_lags >= by_rate:
            return []
    return [
        warning(
            "sensor.pair_clock",
            subject=columns[1],
            other=columns[0],
            rate_ppm=1e6 * rate,
            u_ppm=1e6 * u,
            change_s=rate * data.duration_s,
            factor=1 + rate,
        )
    ]


def _cleaned(data: PairData, columns: tuple[str, str]) -> tuple[PairData, list[Finding]]:
    """Take single outliers of both traces as missing, and subtract hum of the mains.

    Parameters
    ----------
    data
        The traces.
    columns
        Their names.

    Returns
    -------
    data
        The traces without outliers and hum, and their noise.
    findings
        An info for each trace that has outliers, and for each line of hum.
    """
    traces = []
    findings = []
    for column, y, noise_K in zip(columns, (data.first, data.second), data.noise_K):
        spikes = find_spikes(y, SPIKES["plunge"], noise_K)
        if spikes.any():
            count = int(np.count_nonzero(spikes))
            findings.append(info("sensor.spikes", subject=column, count=count))
        traces.append(np.where(spikes, np.nan, y))
    noises_K = np.array([white_noise_K(y) for y in traces])
    noise = estimate_logger_noise([np.column_stack(traces)], data.dt_s, NO_CONDITIONING, noises_K)
    for f_Hz, amplitudes_K in noise.hum_lines:
        if noise.is_mains(f_Hz):
            traces = [_without_line(y, f_Hz * data.dt_s) for y in traces]
            amplitude_K = float(np.max(amplitudes_K))
            both = ", ".join(columns)
            findings.append(info("noise.hum", subject=both, f_Hz=f_Hz, amplitude_K=amplitude_K))
    first, second = traces
    noise_of_both_K = (white_noise_K(first), white_noise_K(second))
    return replace(data, first=first, second=second, noise_K=noise_of_both_K), findings


def _without_line(y: Array, cycles: float) -> Array:
    """Subtract a sine of ``cycles`` in each row from readings (N,), fitted in each block of rows.

    Blocks allow for a frequency that changes a little.
    """
    out = y.copy()
    count = max(round(len(y) * cycles / LINE_CYCLES), 1)
    for rows in np.array_split(np.arange(len(y)), count):
        known = rows[np.isfinite(y[rows])]
        phase = 2 * np.pi * cycles * known
        table = np.column_stack([np.ones(len(known)), np.cos(phase), np.sin(phase)])
        weights = np.linalg.lstsq(table, y[known], rcond=None)[0]
        out[known] -= table[:, 1:] @ weights[1:]
    return out


def _lag_findings(
    data: PairData,
    taus: Array,
    covariances: tuple[Array, Array],
    mean_square: float,
    columns: tuple[str, str],
) -> list[Finding]:
    """Return what the traces do not determine: lags, rows too far apart, and a misfit.

    Parameters
    ----------
    data
        The traces.
    taus
        Lags of each segment (2 segments,) [s].
    covariances
        Their covariance without and with that of the construction of the sensors [s2].
    mean_square
        Mean square of the residuals.
    columns
        Names of the traces.

    Returns
    -------
    list of Finding
        Warnings; an error for a lag that is smaller than its standard uncertainty.
    """
    subject = ", ".join(columns)
    findings: list[Finding] = []
    for k in range(0, len(taus), 2):
        pair = slice(k, k + 2)
        by_fluid = np.sqrt(np.diag(covariances[0][pair, pair])) / taus[pair]
        by_all = np.sqrt(np.diag(covariances[1][pair, pair])) / taus[pair]
        if max(by_all) <= UNDETERMINED_REL:
            continue
        severity = error if max(by_all) > 1 else warning  # such a lag could as well be zero
        if max(by_fluid) > UNDETERMINED_REL:
            undetermined = severity(
                "sensor.pair_difference",
                subject=subject,
                difference_s=taus[k] - taus[k + 1],
                u_s=_difference_u(covariances[1][pair, pair]),
            )
        else:
            undetermined = severity(
                "sensor.pair_construction",
                subject=columns[int(np.argmax(by_all))],
                percent=100 * Z95 * max(by_all),
            )
        findings.append(undetermined)
    shortest_s = min(taus)
    if data.dt_s > shortest_s / ROWS_PER_LAG:
        column = columns[np.argmin(taus[:2])]
        findings.append(warning("sensor.slow", subject=column, dt_s=data.dt_s, lag_s=shortest_s))
    if mean_square > MISFIT_RATIO:
        findings.append(warning("sensor.pair_misfit", subject=subject, ratio=mean_square**0.5))
    return findings


def _difference_u(covariance: Array) -> float:
    """Return the standard uncertainty of the difference of two numbers with covariance (2, 2)."""
    return float(np.sqrt(max(np.trace(covariance) - 2 * covariance[0, 1], 0.0)))
