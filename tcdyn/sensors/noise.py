"""Lag in place from process noise: white noise after one or two lags, Whittle likelihood.

``tcdyn sensor`` uses it. The result is right where the fluctuations of the fluid are white over the
band of the sensor; the trace can test that in part only. ``tests/sensors/test_sensor_in_place.py``
checks that the interval holds the lag and that the conditions are reported.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy import signal
from scipy.ndimage import uniform_filter1d
from scipy.optimize import approx_fprime, minimize
from scipy.special import chdtrc

from tcdyn.chain import Chain
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Finding, info, warning
from tcdyn.core.threads import one_blas_thread
from tcdyn.sensors.conduction import conduction_chain, inner_lags
from tcdyn.sensors.file import (
    SHARES,
    SensorFile,
    lag_and_times,
    sensor_file,
    undetermined_lag_error,
)
from tcdyn.sensors.step_fits import bic_weights, model_average
from tcdyn.series.updates import usual_spacing

# Standard uncertainty besides the statistics: relative to the lag, since that the fluctuations are
# white can only be tested to a limit (chosen by judgement); and relative to all lags but the first,
# since the further ones are only nearly so (`python -m tests.sensors.layered_study noise`).
MODEL_REL = 0.03
FURTHER_REL = 0.25
MIN_LAG_SHARE = 1e-6  # second lag over the first, below which there is none; chosen by judgement
MIN_ROWS = 512  # of the record; chosen by judgement
MIN_FINITE_SHARE = 0.99  # share of rows with a reading; chosen by judgement
# Length of a segment in lags, and least number of segments; chosen by judgement.
SEGMENT_LAGS = 60.0
MIN_SEGMENTS = 6
MIN_SEGMENT_ROWS = 128
MIN_RECORD_LAGS = 300.0  # length of the record in lags; chosen by judgement
# Hann window, segments overlapping by a half: factor of the equivalent number of independent
# segments (Welch 1967), and bins that carry one piece of information.
OVERLAP_FACTOR = 36 / 38
TAPER_FACTOR = 35 / 18
# Power over that of the lowest bins from which on bins are not fitted: there the spectrum is that
# of the shortest lags of the sensor and of the fluid, of which the model has only the sum
# (`python -m tests.sensors.layered_study noise`); and bins that are averaged to find it.
NEGLIGIBLE_POWER = 3e-3
SMOOTHED_BINS = 9
# Lags at which the fits start: their number, the longest over the length of a segment, and a second
# lag over the first; chosen by judgement.
N_STARTS = 6
LONGEST_START = 0.2
SECOND_LAG_SHARE = 0.2
MIN_BINS = 20  # least number of bins that are fitted; chosen by judgement
BANDS = 12  # of the goodness-of-fit test of the spectrum; chosen by judgement
MISFIT_P_VALUE = 0.001  # p-value of that test below which a warning is given; chosen by judgement
# Ratio of the variances of two quarters beyond which the record is not stationary; by judgement.
UNSTEADY_RATIO = 3.0


@one_blas_thread
def noise_sensor(
    time_s: Array, y_degC: Array, column: str, *, sensor: str = "sensor", **more: Any
) -> SensorFile:
    """The chain from the fluctuations of a trace at constant conditions.

    Parameters
    ----------
    time_s, y_degC
        Even times (N,) [s] and readings [degC], NaN where missing. Of a column that has a reading
        in every n-th row, only those rows are used.
    column
        The sensor's column.
    sensor
        Name of the sensor.
    more
        Other fields of the file.

    Returns
    -------
    SensorFile
        The file with the chain of the most probable structure; lag and times are averages over
        all.

    Raises
    ------
    InputError
        Gaps of more than 1 %, a record shorter than about 300 lags, no fluctuation above the
        logger's noise.

    Notes
    -----
    The spectrum is that of a sampled sum of exponentials, A sum_n c_n s(tau_n) + B, s(tau) = (1 -
    p^2)/(1 - 2 p cos w + p^2), p = exp(-dt/tau), c_n proportional to tau_n^(2M - 3) / prod_m
    (tau_n^2
    - tau_m^2), sum one: white fluctuations of the fluid after M lags, and white noise of the
    logger. An autoregression (with that noise, an ARMA) fits the same spectrum. The fit is by
    Whittle's likelihood on overlapping segments; one lag, two, and two with the further ones of
    conduction (``inner_lags``) are weighted by BIC.

    The method holds if the fluctuations of the fluid are white over the band of the sensor. A fluid
    that fluctuates more slowly adds its own time constant to the result, and the trace cannot
    separate the two. What the trace can show is tested: that it is stationary, long enough, above
    the logger's noise, and of this spectrum.

    ``MODEL_REL`` and ``FURTHER_REL`` are the least uncertainty of the result.
    ``SEGMENT_LAGS`` sets the resolution of the spectrum: shorter segments bias the lag, longer ones
    are fewer.
    ``tests/sensors/test_sensor_in_place.py`` fails where the interval no longer holds the lag.
    """
    rows = np.flatnonzero(np.isfinite(y_degC))
    spacing = usual_spacing([rows])
    y_degC = y_degC[rows[0] if len(rows) else 0 :: spacing]
    dt = spacing * float(time_s[1] - time_s[0])
    finite = np.isfinite(y_degC)
    n = len(finite)
    if finite.mean() < MIN_FINITE_SHARE or n < MIN_ROWS:
        raise InputError(
            f"{n} rows, {100 * (1 - finite.mean()):.2g} % of them missing or repeated",
            expected=f"at least {MIN_ROWS}, and 1 % at most",
        )
    y = signal.detrend(np.interp(np.arange(n), np.flatnonzero(finite), y_degC[finite]))
    longest = n // MIN_SEGMENTS
    length = longest
    for _ in range(3):
        theta = _fit_spectrum(mean_periodogram(y, length, dt), 1)
        length = int(np.clip(SEGMENT_LAGS * np.exp(theta[2]) / dt, MIN_SEGMENT_ROWS, longest))
    periodogram = mean_periodogram(y, length, dt)
    conductive = replace(periodogram, conduction=True)
    structures = [periodogram, periodogram, conductive]
    fits = [_fit_spectrum(data, count) for data, count in zip(structures, (1, 2, 2))]
    costs = np.array(
        [_negative_log_likelihood(theta, data) for theta, data in zip(fits, structures)]
    )
    costs *= periodogram.weight
    n_parameters = np.array([3, 4, 4])
    log_size = np.log(periodogram.weight * len(periodogram.w))
    weights = bic_weights(2 * costs + n_parameters * log_size)
    values = []
    us = []
    model_us = []
    random_variances = []  # of the lags, from the length of the record
    for theta, data in zip(fits, structures):
        covariance = _theta_covariance(theta, data)
        quantities = _lag_and_step_times(theta[2:], data.conduction)
        slopes = approx_fprime(theta[2:], _lag_and_step_times, 1e-4, data.conduction)
        variance = np.einsum("ik,kl,il->i", slopes, covariance[2:, 2:], slopes)
        if not variance[0] > 0:
            raise undetermined_lag_error(column)
        values.append(quantities)
        inner_u_s = FURTHER_REL * sum(_all_lags(theta[2:], True)[1:]) * data.conduction
        model_variance = (MODEL_REL * quantities) ** 2 + inner_u_s**2
        us.append(np.sqrt(np.maximum(variance, 0.0) + model_variance))
        model_us.append(float(np.sqrt(model_variance[0])))
        random_variances.append(max(float(variance[0]), 0.0))
    determined = np.array([u[0] <= value[0] for u, value in zip(us, values)])
    determined[0] = True  # one lag is the least
    weights = weights * determined / np.sum(weights * determined)
    estimates = [
        model_average(v, u, weights) for v, u in zip(np.transpose(values), np.transpose(us))
    ]
    lag, *times = estimates
    top = int(np.argmax(weights))
    best = fits[top]
    data = structures[top]
    first_s, second_s = [*_lags(best[2:]), 0.0][:2]
    chain = conduction_chain(first_s, second_s, data.conduction)
    _check_record(len(y), dt, lag, best)
    findings = _condition_findings(y, data, best, column, len(_lags(best[2:])))
    fit = {
        "lag_s": lag.model_dump(),
        "lags_in_record": len(y) * dt / lag.value,
        "fluctuation_K": float(np.exp(0.5 * best[0])),
        "logger_K": float(np.exp(0.5 * best[1])),
        "probability_P2": float(weights[1:].sum()),
        # what is not random differs little between records of one sensor
        "model_u_s": max(lag.u**2 - float(weights @ random_variances), 0.0) ** 0.5,
        "limited_by": "the length of the record"
        if lag.u**2 > 2 * model_us[top] ** 2
        else "the model of white fluctuations and of the sensor",
    }
    # for use of the chain: that of the best structure, whose lag differs from the average
    lag_u = float(np.hypot(lag.u, lag.value - chain.lag_s))
    return sensor_file(
        sensor,
        {column: chain},
        "noise",
        np.array([[lag_u**2]]),
        [min(0.5 * lag.u, lag.value)],
        lags={column: lag},
        times={column: dict(zip(SHARES, times))},
        fit=fit,
        findings=findings,
        **more,
    )


@dataclass(frozen=True)
class Periodogram:
    """Mean periodogram of a trace.

    Attributes
    ----------
    power
        Power (K,).
    w
        Angular frequencies (K,) [rad per sample].
    dt_s
        Interval [s].
    weight
        Number of independent values that one bin counts for.
    conduction
        The model has the further lags of conduction after the second one.
    """

    power: Array
    w: Array
    dt_s: float
    weight: float
    conduction: bool = False


def mean_periodogram(y: Array, length: int, dt_s: float) -> Periodogram:
    """Return the mean periodogram of overlapping Hann segments (Welch's method).

    Parameters
    ----------
    y
        Readings (N,) [degC] without gaps.
    length
        Rows of a segment.
    dt_s
        Interval [s].

    Returns
    -------
    Periodogram
        Without the two lowest bins, which lack what the mean removed, and without those from which
        on the power is negligible.
    """
    window = np.hanning(length)
    window = window / np.sqrt(np.sum(window**2))
    powers = []
    for start in range(0, len(y) - length + 1, max(length // 2, 1)):
        segment = y[start : start + length]
        powers.append(np.abs(np.fft.rfft(window * (segment - segment.mean()))) ** 2)
    power = np.mean(powers, axis=0)
    smooth = uniform_filter1d(power[2 : (length - 1) // 2], SMOOTHED_BINS)
    is_negligible = smooth < NEGLIGIBLE_POWER * smooth[0]
    n_used = int(np.argmax(is_negligible)) if is_negligible.any() else len(smooth)
    used = slice(2, 2 + max(n_used, MIN_BINS))
    return Periodogram(
        power[used],
        2 * np.pi * np.arange(len(power))[used] / length,
        dt_s,
        len(powers) * OVERLAP_FACTOR / TAPER_FACTOR,
    )


def spectrum(theta: Array, periodogram: Periodogram) -> Array:
    """Return the periodogram of the model.

    Parameters
    ----------
    theta
        Log A, log B, logarithms of the first lag, and of the second if there is one [s].
    periodogram
        The frequencies and the interval.

    Returns
    -------
    array
        Power (K,).
    """

    taus = np.array(_all_lags(np.clip(theta[2:], -30, 30), periodogram.conduction))
    taus *= 1 - 1e-4 * np.arange(len(taus))  # no two are equal
    p = np.exp(-periodogram.dt_s / taus)[:, None]
    exponentials = (1 - p * p) / (1 - 2 * p * np.cos(periodogram.w) + p * p)
    squares = (taus / taus[0]) ** 2
    differences = squares[:, None] - squares + np.eye(len(taus))
    amplitudes = (taus / taus[0]) ** (2 * len(taus) - 3) / np.prod(differences, axis=1)
    shape = amplitudes @ exponentials / amplitudes.sum()
    return np.exp(theta[0]) * np.maximum(shape, 0.0) + np.exp(theta[1])


def _negative_log_likelihood(theta: Array, periodogram: Periodogram) -> float:
    """Return Whittle's negative log likelihood, for one independent value in each bin."""
    s = spectrum(theta, periodogram)
    return float(np.sum(np.log(s) + periodogram.power / s))


def _fit_spectrum(periodogram: Periodogram, count: int) -> Array:
    """Return the parameters of least cost (Nelder-Mead from ``N_STARTS`` lags).

    Parameters
    ----------
    periodogram
        The data.
    count
        Number of lags, one or two.

    Returns
    -------
    array
        Log A, log B and logarithms of the lags (2 + count,), larger lag first.
    """
    power = periodogram.power
    dt = periodogram.dt_s
    mean_power = float(power.mean())
    floor = float(np.median(power[-max(len(power) // 10, 3) :]))
    options = {"maxiter": 1500, "xatol": 1e-4, "fatol": 1e-4}
    results = []
    for tau in np.geomspace(2 * dt, LONGEST_START * dt * 2 * len(power), N_STARTS):
        start = np.log([mean_power, max(floor, 1e-12), *[tau, SECOND_LAG_SHARE * tau][:count]])
        result = minimize(
            _negative_log_likelihood, start, (periodogram,), method="Nelder-Mead", options=options
        )
        results.append(result)
    theta = min(results, key=lambda result: result.fun).x
    return np.r_[theta[:2], np.sort(theta[2:])[::-1]]


def _theta_covariance(theta: Array, periodogram: Periodogram) -> Array:
    """Return the inverse of Whittle's expected information.

    Parameters
    ----------
    theta
        Parameters (P,).
    periodogram
        The data.

    Returns
    -------
    array
        Covariance (P, P). The information is weight x sum of d log S d log S'.
    """
    slopes = []
    for step in 1e-4 * np.eye(len(theta)):
        ratio = spectrum(theta + step, periodogram) / spectrum(theta - step, periodogram)
        slopes.append(np.log(ratio) / 2e-4)
    jacobian = np.array(slopes)
    information = periodogram.weight * jacobian @ jacobian.T
    return np.asarray(np.linalg.pinv(information), dtype=np.float64)


def _lag_and_step_times(logs: Array, conduction: bool) -> Array:
    """Return lag and times of the step response (4,) [s], from the logarithms of the lags."""
    return lag_and_times(Chain(_all_lags(logs, conduction)))


def _lags(logs: Array) -> list[float]:
    """Return the lags from their logarithms, largest first [s]; a negligible one is left out."""
    taus = np.exp(logs)
    return sorted(taus[taus > MIN_LAG_SHARE * taus.max()].tolist(), reverse=True)


def _all_lags(logs: Array, conduction: bool) -> list[float]:
    """Return the lags from their logarithms, largest first [s], with those of conduction."""
    first, *second = _lags(logs)
    if not conduction:
        return [first, *second]
    return [first, *(tau for value in second for tau in inner_lags(value))]


def _check_record(n: int, dt: float, lag: Estimate, theta: Array) -> None:
    """Raise InputError for a short record, a sensor as fast as the rows, or a quiet fluid.

    Parameters
    ----------
    n
        Rows of the record.
    dt
        Interval [s].
    lag
        The lag [s].
    theta
        Parameters of the most probable fit.

    Raises
    ------
    InputError
        With what to change about the record.
    """
    lags = n * dt / lag.value
    if lags < MIN_RECORD_LAGS:
        slowest = f"{lag.value:.3g} s"
        if lags < MIN_SEGMENTS:  # slower than the longest segment: the fit has no upper limit
            lags = MIN_SEGMENTS
            slowest = f"more than {n * dt / MIN_SEGMENTS:.3g} s"
        raise InputError(
            f"the fluctuations of the reading have a time constant of {slowest}: the record of "
            f"{n * dt:.3g} s is at most {lags:.3g} lags long",
            expected=f"at least {MIN_RECORD_LAGS:g}, if the time constant is the sensor's",
            remedy="log for longer; or, if the sensor is faster, the fluid is too slow for this "
            "method: use a plunge, a current or a second sensor",
        )
    if lag.value < 2 * dt:
        raise InputError(
            f"a lag of {lag.value:.3g} s in rows every {dt:.3g} s", remedy="log faster"
        )
    if np.exp(theta[0]) * lag.value / dt < np.exp(theta[1]):
        raise InputError(
            "the fluid's fluctuations are within the logger's noise",
            remedy="log a process with larger fluctuations",
        )


def _condition_findings(
    y: Array, periodogram: Periodogram, theta: Array, column: str, lags: int
) -> list[Finding]:
    """Return findings on number of lags, stationarity, and goodness of fit.

    Parameters
    ----------
    y
        Readings (N,).
    periodogram
        Their periodogram.
    theta
        Parameters of the most probable fit.
    column
        The sensor's column.
    lags
        Number of lags.

    Returns
    -------
    list of Finding
        The first one is always there.

    Notes
    -----
    The spectrum is compared in ``BANDS`` bands of equal ratio by chi-squared with the number of
    bands less that of the parameters as degrees of freedom.
    """
    severity = warning if lags == 2 else info
    findings: list[Finding] = [severity("sensor.noise_driving", subject=column, lags=lags)]
    variances = [float(np.var(quarter)) for quarter in np.array_split(y, 4)]
    if max(variances) > UNSTEADY_RATIO * min(variances):
        ratio = (max(variances) / min(variances)) ** 0.5
        findings.append(warning("sensor.noise_unsteady", subject=column, ratio=ratio))
    relative = periodogram.power / spectrum(theta, periodogram)
    edges = np.unique(np.geomspace(1, len(relative), BANDS + 1).astype(int) - 1)
    chi_square = 0.0
    bands = 0
    for low, high in pairwise(edges):
        width = high - low
        if width >= 3:
            excess = relative[low:high].mean() - 1
            chi_square += float(periodogram.weight * width * excess**2)
            bands += 1
    p_value = float(chdtrc(max(bands - len(theta), 1), chi_square))
    if p_value < MISFIT_P_VALUE:
        findings.append(warning("sensor.noise_misfit", subject=column, p_value=p_value))
    return findings
