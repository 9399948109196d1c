"""Lag of a bare sensor from one plunge or step, with unknown entry and a non-ideal medium.

``tcdyn sensor`` uses it. Structures of one to three lags, with a further short lag on a grid, are
averaged by BIC. ``tests/sensors/test_sensor_plunge.py`` checks that lag and percent times lie in
their intervals; ``tests/sensors/test_long_lags.py`` long records.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tcdyn.chain import NO_CONDITIONING, Chain
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, warning
from tcdyn.core.threads import one_blas_thread
from tcdyn.estimation import NoiseModel
from tcdyn.rig.disk import Conditioning
from tcdyn.sensors.file import SHARES, SensorFile, lag_and_times, sensor_file
from tcdyn.sensors.step_fits import (
    CurveFit,
    bic_weights,
    fit_curve,
    model_average,
    residual_noise,
    white_noise_K,
)
from tcdyn.sensors.surface_h import BoundaryLayer

# Time constant of the medium's own step and its standard uncertainty [s]: 10 mm pass a surface at
# 0.5 m/s in this time.
MEDIUM_S = (0.02, 0.02)
MIN_STEP_NOISES = 20.0  # least step over the white noise; chosen by judgement
MIN_SAMPLES = 30  # least number of samples; chosen by judgement
MIN_RISES_AFTER = 2.5  # least record after the step, in times to 63.2 %; chosen by judgement
# Part of the record that is fitted, in times to 63.2 % after the entry, and before it as a share of
# that; by judgement.
RISES_AFTER = 12.0
BEFORE_SHARE = 0.5
# Grid of the shortest lag, as shares of the time to 63.2 %; chosen by judgement.
SHORTEST_LAG_SHARES = (0.01, 0.02, 0.04, 0.07, 0.11, 0.16, 0.23, 0.32)
# Shares of the lag with which the fits of one, two and three lags start; chosen by judgement.
START_SHARES = ([1.0], [0.85, 0.15], [0.75, 0.17, 0.08])
# Difference of specified and fitted entry, in standard uncertainties, beyond which a warning is
# given: by chance in 0.3 % of records.
CONFLICT_U = 3.0
# Shortest interval [s]: a lag may be 1e-6 s (`tcdyn sensor new`); a shorter interval is time in
# another unit.
SHORTEST_ROW_S = 1e-7
# Least standard uncertainty of that difference over the specified u: below it the convergence of
# the fit decides how far the entry moves.
MIN_SHIFT_U = 0.05
# Relative standard uncertainty below which a second lag is distinguished from zero; chosen by
# judgement.
RESOLVED_REL = 0.4
MISFIT_SHARE = 0.005  # of the step: rms of the residuals that is always acceptable; by judgement
NOISE_ITERATIONS = 3  # rounds of noise and fit, at most; chosen by judgement


@dataclass(frozen=True)
class Step:
    """The step in a record.

    Attributes
    ----------
    first, last
        Rows to fit.
    entry_s
        First guess of the entry, from the first row of the record [s].
    size_K
        First guess of the step.
    rise_s
        First guess of the time to 63.2 %.
    before_degC
        Reading before the step.
    """

    first: int
    last: int
    entry_s: float
    size_K: float
    rise_s: float
    before_degC: float


@one_blas_thread
def plunge_sensor(
    time_s: Array,
    y_degC: Array,
    column: str,
    *,
    sensor: str = "sensor",
    conditioning: Conditioning = NO_CONDITIONING,
    entry_s: tuple[float, float] | None = None,
    medium_s: tuple[float, float] = MEDIUM_S,
    film: BoundaryLayer | None = None,
    **more: Any,
) -> SensorFile:
    """The sensor's chain from one step of its surroundings.

    Parameters
    ----------
    time_s, y_degC
        Even times (N,) [s] and readings [degC], NaN where missing.
    column
        The sensor's column.
    sensor
        Name of the sensor.
    conditioning
        Filter after the sensor, which is not estimated.
    entry_s
        Entry on the clock of ``time_s`` and its standard uncertainty [s]; None: unknown.
    medium_s
        Time constant of the medium's own step and its standard uncertainty [s].
    film
        The boundary layer; its h goes into the file.
    more
        Other fields of the file.

    Returns
    -------
    SensorFile
        The file with the chain of the most probable structure; lag and times are averages.

    Raises
    ------
    InputError
        No step above the noise, one that is cut off, or fewer than 30 samples of it.

    Notes
    -----
    y = level + drift t + size R(t - t_e), with R the unit step response of one, two or three lags
    after the medium's own lag and before the filter. t_e is free, or has the normal prior
    ``entry_s``. A dead time is therefore not observable, and a short lag hardly: to first order it
    is a later entry. The shortest lag takes values on a grid, from zero on; each is fitted and
    weighted by its likelihood, and the intervals cover all of them. The medium's lag, a transition
    through the surface or a mixing, has the normal prior ``medium_s``, is not negative, and is not
    part of the result.

    ``MEDIUM_S`` is a prior: a medium that is slower than it says makes the lag too long. The grid
    and the start shares may be refined, which costs time. ``tests/sensors/test_sensor_plunge.py``
    checks a slow medium and a known entry.
    """
    dt = float(time_s[1] - time_s[0])
    _check_times(time_s, entry_s, medium_s)
    step = find_step(y_degC, dt, None if entry_s is None else entry_s[0] - time_s[0])
    start_s = float(time_s[step.first])
    y = y_degC[step.first : step.last]
    prior_s = None
    if entry_s is not None:
        prior_s = (entry_s[0] - start_s, max(entry_s[1], _exact_u_s(dt)))
    record = _Record(
        t=np.asarray(np.arange(len(y)) * dt, dtype=np.float64),
        y=y,
        dt_s=dt,
        step=step,
        entry_s=step.entry_s - step.first * dt,
        entry_prior_s=prior_s,
        medium_s=medium_s,
        conditioning=conditioning,
    )
    fits, shortest, weights = _fit_structures(record)
    top = int(np.argmax(weights))
    best = fits[top]
    estimates = []
    for fit, shortest_s in zip(fits, shortest):
        # bound as a default: the function is used in this iteration only
        def quantities(theta: Array, shortest_s: float = shortest_s) -> Array:
            """Return sum of the shorter lags, lag and times of the step response (5,) [s]."""
            taus = _lags(theta, shortest_s)
            return np.array([sum(taus[1:]), *lag_and_times(Chain(taus))])

        value, covariance = fit.propagate(quantities)
        estimates.append((value, np.sqrt(np.maximum(np.diag(covariance), 0.0))))
    values = np.transpose([value for value, _ in estimates])
    us = np.transpose([u for _, u in estimates])
    shorter_lags, lag, *times = (model_average(v, u, weights) for v, u in zip(values, us))
    chain = Chain(_lags(best.optimum.theta, shortest[top]), conditioning=conditioning)
    findings = best.residual_findings(column, white_noise_K(y), MISFIT_SHARE * abs(step.size_K))
    fitted_s = best.theta["entry_s"] + start_s
    fitted_u_s = float(np.sqrt(best.optimum.covariance[1, 1]))
    if entry_s is not None:
        specified_s = (entry_s[0], max(entry_s[1], _exact_u_s(dt)))
        findings += _entry_conflict(column, specified_s, fitted_s, fitted_u_s)
    if dt > lag.value:
        findings.append(warning("sensor.slow", subject=column, dt_s=dt, lag_s=lag.value))
    after_s = len(y) * dt - record.entry_s
    if after_s < 4 * lag.value:
        findings.append(warning("sensor.cut_off", subject=column, after_s=after_s, lag_s=lag.value))
    fit_values: dict[str, Any] = {
        "entry_s": fitted_s,
        "entry_u_s": fitted_u_s,
        "step_K": best.theta["size"],
        "noise_K": best.noise_K,
        "lag_s": lag.model_dump(),
    }
    if film is not None:
        fit_values |= film.to_fit(lag)
    # the file holds the chain of the best structure, whose lag differs from the average
    lag_u = float(np.hypot(lag.u, lag.value + conditioning.lag_s - chain.lag_s))
    return sensor_file(
        sensor,
        {column: chain},
        "plunge",
        np.array([[lag_u**2]]),
        [min(shorter_lags.u, lag.value)],
        times={column: dict(zip(SHARES, times))},
        fit=fit_values,
        findings=findings,
        **more,
    )


def _check_times(
    time_s: Array, entry_s: tuple[float, float] | None, medium_s: tuple[float, float]
) -> None:
    """Raise InputError for an interval, a medium's lag or an entry that is not possible.

    Parameters
    ----------
    time_s
        Even times (N,) [s].
    entry_s
        Entry and its standard uncertainty [s], or None.
    medium_s
        Medium's lag and its standard uncertainty [s].

    Raises
    ------
    InputError
        With the possible range.
    """
    dt = float(time_s[1] - time_s[0])
    first_s = float(time_s[0])
    last_s = float(time_s[-1])
    length_s = float(time_s[-1] - time_s[0])
    if not dt >= SHORTEST_ROW_S:
        raise InputError(
            f"rows every {dt:.3g} s",
            expected=f"at least {SHORTEST_ROW_S:g} s",
            remedy="give the time in seconds",
        )
    if not (0 <= medium_s[0] <= length_s and 0 <= medium_s[1] <= length_s):
        what = f"the medium's lag is {medium_s[0]:g} +- {medium_s[1]:g} s"
        raise InputError(what, expected=f"0 to {length_s:g} s, the record's length")
    if entry_s is not None and not first_s <= entry_s[0] <= last_s:
        expected = f"{first_s:g} to {last_s:g} s, the range of the record"
        raise InputError(f"the entry is at {entry_s[0]:g} s", expected=expected)


def _entry_conflict(
    column: str, specified_s: tuple[float, float], fitted_s: float, fitted_u_s: float
) -> list[Finding]:
    """Return a warning if the data contradict a specified entry instant.

    Parameters
    ----------
    column
        The sensor's column.
    specified_s
        Entry instant and its standard uncertainty, before the fit [s].
    fitted_s, fitted_u_s
        The same after the fit [s].

    Returns
    -------
    list of Finding
        Empty, or one warning.

    Notes
    -----
    For a normal prior and a normal likelihood (fitted - specified) / sqrt(u_specified^2 -
    u_fitted^2) equals the difference of what the data alone give and the prior, over the standard
    uncertainty of that difference (Box 1980, J. R. Stat. Soc. A 143, 383: prior predictive check).

    ``tests/sensors/test_sensor_plunge.py`` checks an entry that is right and one that is wrong.
    """
    shift_s = fitted_s - specified_s[0]
    least_u_s = MIN_SHIFT_U * specified_s[1]
    shift_u_s = max(float(np.sqrt(max(specified_s[1] ** 2 - fitted_u_s**2, 0.0))), least_u_s)
    if abs(shift_s) <= CONFLICT_U * shift_u_s:
        return []
    conflict = warning(
        "sensor.entry_conflict",
        subject=column,
        specified_s=specified_s[0],
        specified_u_s=specified_s[1],
        fitted_s=fitted_s,
        ratio=abs(shift_s) / shift_u_s,
    )
    return [conflict]


def find_step(y: Array, dt_s: float, entry_s: float | None = None) -> Step:
    """Find where the largest lasting change of ``y`` (N,) begins.

    Parameters
    ----------
    y
        Readings [degC], NaN where missing.
    dt_s
        Interval [s].
    entry_s
        Entry from the first row [s]; None: found.

    Returns
    -------
    Step
        The step and the rows to fit.

    Raises
    ------
    InputError
        Where there is no step, or where it is cut off.

    Notes
    -----
    ``RISES_AFTER`` limits the record, so that a drift long after the step does not count.
    ``tests/sensors/test_sensor_plunge.py`` checks the start and the errors.
    """
    finite = np.isfinite(y)
    if finite.sum() < MIN_SAMPLES:
        raise InputError(f"only {int(finite.sum())} samples", expected=f"at least {MIN_SAMPLES}")
    filled = np.interp(np.arange(len(y)), np.flatnonzero(finite), y[finite])
    noise = white_noise_K(filled)
    edge = max(len(y) // 50, 3)
    if entry_s is None:
        start = _step_start(filled, noise, edge)
    else:
        start = int(np.clip(round(entry_s / dt_s), 0, len(y) - 2))
    before = float(np.median(filled[max(start - 5 * edge, 0) : max(start, 1)]))
    after = float(np.mean(filled[-edge:]))
    size = after - before
    if abs(size) < MIN_STEP_NOISES * noise:
        raise InputError(
            f"no step: the reading changes by {abs(size):.3g} K, its noise is {noise:.2g} K",
            expected=f"at least {MIN_STEP_NOISES:g} times the noise",
        )
    share = (filled[start:] - before) / size
    rise = max(int(np.argmax(share >= 0.632)), 2)
    rows_after = len(y) - start
    if rows_after < MIN_RISES_AFTER * rise:
        raise InputError(
            f"the record ends {rows_after * dt_s:.3g} s after the step, which is not over",
            expected="five time constants after the step",
        )
    first = max(start - max(int(BEFORE_SHARE * RISES_AFTER * rise), 20), 0)
    last = min(start + max(int(RISES_AFTER * rise), 30), len(y))
    return Step(first, last, start * dt_s, size, rise * dt_s, before)


def _step_start(filled: Array, noise: float, edge: int) -> int:
    """Return the last row before the steepest change that is within the noise of the level.

    Parameters
    ----------
    filled
        Readings (N,) without gaps.
    noise
        White noise [K].
    edge
        Rows at the ends from which the levels are taken.

    Returns
    -------
    int
        The row; 0 where all rows before the change are outside the noise.

    Notes
    -----
    Within the noise: below five standard deviations of a mean, or 2 % of the change if that is
    more.
    """
    half = max(len(filled) // 400, 1)
    window = 2 * half + 1
    mean = np.convolve(filled, np.ones(window) / window, mode="valid")
    steep = int(np.argmax(np.abs(mean[2 * half :] - mean[: -2 * half]))) + 2 * half
    sign = np.sign(filled[min(steep + half, len(filled) - 1)] - filled[max(steep - half, 0)])
    level = float(np.median(filled[: max(steep - 2 * half, edge)]))
    rise = sign * (filled[: steep + 1] - level)
    limit = max(5 * noise / np.sqrt(window), 0.02 * abs(filled[-edge:].mean() - level))
    below = np.flatnonzero(rise < limit)
    return int(below[-1]) if len(below) else 0


def _exact_u_s(dt_s: float) -> float:
    """Return the standard uncertainty of a time specified as exact [s], for any interval."""
    return min(1e-6, 1e-3 * dt_s)


@dataclass(frozen=True)
class _Record:
    """Data of the fit.

    Attributes
    ----------
    t
        Times from the first row (N,) [s].
    y
        Readings (N,) [degC], NaN where missing.
    dt_s
        Interval [s].
    step
        The step.
    entry_s
        First guess of the entry, from the first row [s].
    entry_prior_s
        Prior of the entry, mean and standard deviation [s], or None.
    medium_s
        Medium's lag and its standard uncertainty [s].
    conditioning
        Filter after the sensor.
    """

    t: Array
    y: Array
    dt_s: float
    step: Step
    entry_s: float
    entry_prior_s: tuple[float, float] | None
    medium_s: tuple[float, float]
    conditioning: Conditioning

    @property
    def sensor_lag_s(self) -> float:
        """First guess of the sensor's lag without the filter."""
        return max(self.step.rise_s - self.conditioning.lag_s, 2 * self.dt_s)


def _fit_structures(record: _Record) -> tuple[list[CurveFit], list[float], Array]:
    """Fit one, two and three lags, with a further shortest lag on a grid.

    The noise is that of the best fit's residuals: white as long as these are white.

    Parameters
    ----------
    record
        Data of the fit.

    Returns
    -------
    fits
        The fits (K).
    shortest
        The shortest lag of each (K) [s].
    weights
        Their probabilities (K,).
    """
    noise = (NoiseModel(), white_noise_K(record.y))
    for iteration in range(NOISE_ITERATIONS):
        fits, shortest, weights = _fit_grid(record, noise)
        best = fits[int(np.argmax(weights))]
        colour, level_K = residual_noise(best.residual, len(best.optimum.theta))
        both_white = colour.white and noise[0].white
        if both_white and 0.8 < level_K / noise[1] < 1.25:
            break
        if iteration < NOISE_ITERATIONS - 1:
            noise = (colour, level_K)
    return fits, shortest, weights


def _fit_grid(
    record: _Record, noise: tuple[NoiseModel, float]
) -> tuple[list[CurveFit], list[float], Array]:
    """Fit all structures with one noise.

    Parameters
    ----------
    record
        Data of the fit.
    noise
        Autoregression and level [K] of the residuals.

    Returns
    -------
    fits, shortest, weights
        As :func:`_fit_structures` returns them.

    Raises
    ------
    InputError
        Where no structure can be fitted, because the response is within one row.
    """
    fits = list[CurveFit]()
    shortest = list[float]()
    prior = list[float]()
    step = record.step
    lag_s = record.sensor_lag_s
    medium_s = max(record.medium_s[0], min(1e-4, 0.1 * record.dt_s))
    head = [step.before_degC, record.entry_s, step.size_K, 0.0, medium_s]
    for shares in START_SHARES:
        start = np.array([*head, *(lag_s * np.array(shares))])
        optimum = _fit_lags(record, 0.0, start, noise).optimum
        theta = optimum.theta
        if np.any(np.sqrt(np.diag(optimum.covariance)[6:]) > RESOLVED_REL * theta[6:]):
            continue
        lags = _lags(theta, 0.0)
        if not lags:
            continue
        candidates = [share * lag_s for share in SHORTEST_LAG_SHARES]
        grid = [0.0, *(candidate for candidate in candidates if candidate <= lags[-1])]
        for shortest_s in grid:
            fit = _fit_lags(record, shortest_s, theta, noise)
            theta = fit.optimum.theta
            if shortest_s > min(theta[5:]) or not _lags(theta, shortest_s):
                break
            fits.append(fit)
            shortest.append(shortest_s)
            prior.append(0.5 if shortest_s == 0 else 0.5 / max(len(grid) - 1, 1))
    if not fits:
        raise InputError(
            f"the reading follows the step within one row of {record.dt_s:.3g} s"
            ": no lag can be determined",
            expected="several rows in a lag",
            remedy="log faster; or the medium's lag, which was specified, explains all of the "
            "response",
        )
    return fits, shortest, bic_weights(np.array([f.bic for f in fits]), np.array(prior))


def _fit_lags(
    record: _Record, shortest_s: float, start: Array, noise: tuple[NoiseModel, float]
) -> CurveFit:
    """Fit one structure with one fixed lag.

    Parameters
    ----------
    record
        Data of the fit.
    shortest_s
        The fixed lag [s]; 0 for none.
    start
        Level, entry, size, drift, medium's lag, free lags (5 + lags,).
    noise
        Autoregression and level [K] of the residuals.

    Returns
    -------
    CurveFit
        The fit; theta in the order of ``start``.
    """
    step = record.step
    t = record.t
    dt = record.dt_s
    medium_s, medium_u_s = record.medium_s
    count = len(start) - 5
    duration_s = t[-1] - t[0]
    ones = np.ones_like(t)
    size_K = abs(step.size_K)
    lag_s = record.sensor_lag_s
    medium_scale = max(lag_s, medium_u_s)
    scale = np.array([size_K, lag_s, size_K, size_K / duration_s, medium_scale, *[lag_s] * count])

    def model(theta: Array) -> Array | None:
        """Return the readings (N,) at theta; None where they cannot be computed."""
        level, entry, size, drift, medium = theta[:5]
        taus = _lags(theta, shortest_s)
        if not 0 <= entry < t[-1] or max(taus, default=0.0) > 50 * duration_s:
            return None
        chain = Chain(
            [*taus, max(medium, 0.0)], delay_s=float(entry), conditioning=record.conditioning
        )
        response = chain.response(ones, dt, "zoh", "zero")
        return level + size * response + drift * (t - duration_s / 2)

    prior = {"medium_s": (medium_s, max(medium_u_s, _exact_u_s(dt)))}
    if record.entry_prior_s is not None:
        prior["entry_s"] = record.entry_prior_s
    taus = [f"tau{k + 1}_s" for k in range(count)]
    names = ["level", "entry_s", "size", "drift", "medium_s", *taus]
    lower = dict.fromkeys(["medium_s", "entry_s", *taus], 0.0)
    return fit_curve(
        f"P{count}", model, record.y, names, start, scale, prior=prior, lower=lower, noise=noise
    )


def _lags(theta: Array, shortest_s: float) -> list[float]:
    """Return the free lags of theta and the fixed one, largest first [s], without zeros."""
    return sorted((float(tau) for tau in (*theta[5:], shortest_s) if tau > 0), reverse=True)
