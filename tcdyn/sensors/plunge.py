"""A bare sensor plunged or stepped: entry instant unknown, the medium's step not ideal; lag, t50, t63.2 and t90."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from tcdyn.chain import NO_CONDITIONING, Chain
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, warning
from tcdyn.core.threads import one_blas_thread
from tcdyn.estimation import Noise
from tcdyn.estimation.trace_noise import white_noise_sd
from tcdyn.rig.disk import Conditioning
from tcdyn.sensors.file import SHARES, SensorFile, lag_and_times, sensor_file
from tcdyn.sensors.step_fits import Fitted, averaged, colour_of, fit_curve, weights_of
from tcdyn.sensors.surface_h import Film

MEDIUM_S = (0.02, 0.02)  # 10 mm go through a surface at 0.5 m/s in this time
LEAST_STEP_NOISES = 20.0
# of the time to 63 %: how much of the record is fitted on either side of the entry
BEFORE = 0.5
AFTER = 12.0
LEAST = (
    0.01,
    0.02,
    0.04,
    0.07,
    0.11,
    0.16,
    0.23,
    0.32,
)  # the least lag, as shares of the time to 63 %
CONFLICT_U = 3.0  # standard uncertainties between specified and observed entry: by chance in 0.3 % of records
SHORTEST_ROW_S = (
    1e-7  # a lag may be 1e-6 s (`tcdyn sensor new`); a shorter interval is time in another unit
)
MIN_SHIFT_U = (
    0.05  # of the specified u: below it the fit's own convergence decides how far the entry moves
)
RESOLVED = 0.4  # a second lag is told from none where its standard uncertainty is less of it


@dataclass(frozen=True)
class Stepped:
    """The step in a record: samples to fit, guesses of entry [s from the first], size [K] and time to 63 %."""

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
    film: Film | None = None,
    **more: Any,
) -> SensorFile:
    """The sensor's chain from one step of its surroundings.

    y = level + drift t + size R(t - t_e), R the unit step response of one, two or three lags behind the medium's own
    lag and before the known filter. t_e is free, or normal about ``entry_s``; so a dead time cannot be seen, and a
    short lag hardly: to first order it is a later entry. The least lag therefore takes values on a grid, from none on,
    each fitted and weighed by its likelihood, and intervals are over all of them. The medium's lag, a transition
    through the surface or a mixing, is normal about ``medium_s``, not below zero, and is no part of the answer.

    Args:
        time_s, y_degC: (N,) even times [s] and readings [degC], NaN where missing.
        column: the sensor's column.
        conditioning: a known filter behind the sensor.
        entry_s: the entry on the clock of ``time_s`` and its standard uncertainty [s]; None where nobody knows.
        medium_s: time constant of the medium's own step and its standard uncertainty [s].
        film: what is known of the boundary layer; its h goes into the file.

    Raises:
        InputError: no step beyond the noise, one that is cut off, or fewer than 30 samples of it.
    """
    dt = float(time_s[1] - time_s[0])
    last = float(time_s[-1] - time_s[0])
    if not dt >= SHORTEST_ROW_S:
        what = f"rows every {dt:.3g} s"
        raise InputError(
            what, expected=f"at least {SHORTEST_ROW_S:g} s", remedy="give the time in seconds"
        )
    if not (0 <= medium_s[0] <= last and 0 <= medium_s[1] <= last):
        what = f"the medium's lag is {medium_s[0]:g} +- {medium_s[1]:g} s"
        raise InputError(what, expected=f"0 to {last:g} s, the record's length")
    if entry_s is not None and not float(time_s[0]) <= entry_s[0] <= float(time_s[-1]):
        what = f"the entry is at {entry_s[0]:g} s"
        raise InputError(
            what, expected=f"{float(time_s[0]):g} to {float(time_s[-1]):g} s, as the record goes"
        )
    step = find_step(y_degC, dt, None if entry_s is None else entry_s[0] - time_s[0])
    t = np.arange(step.last - step.first) * dt
    y = y_degC[step.first : step.last]
    begun = float(time_s[step.first])
    at = step.entry_s - step.first * dt
    known = None if entry_s is None else (entry_s[0] - begun, max(entry_s[1], _exact_s(dt)))
    fits, least, weights = _family(
        _Record(np.asarray(t, dtype=np.float64), y, dt, step, at, known, medium_s, conditioning)
    )
    top = int(np.argmax(weights))
    best = fits[top]

    def told(theta: Array, extra: float) -> Array:
        taus = _lags(theta, extra)
        return np.array([sum(taus[1:]), *lag_and_times(Chain(taus))])

    each = [f.of(partial(told, extra=d)) for f, d in zip(fits, least)]
    values = [v for v, _ in each]
    us = [np.sqrt(np.maximum(np.diag(c), 0.0)) for _, c in each]
    lesser, lag, *times = (
        averaged(v, u, weights) for v, u in zip(np.transpose(values), np.transpose(us))
    )
    chain = Chain(_lags(best.optimum.theta, least[top]), conditioning=conditioning)
    found = best.doubts(column, _white_K(y), 0.005 * abs(step.size_K))
    if entry_s is not None:
        entry_u = float(np.sqrt(best.optimum.covariance[1, 1]))
        specified_s = (entry_s[0], max(entry_s[1], _exact_s(dt)))
        found += _entry_conflict(column, specified_s, best.theta["entry_s"] + begun, entry_u)
    if dt > lag.value:
        found.append(warning("sensor.slow", subject=column, dt_s=dt, lag_s=lag.value))
    if (after := len(y) * dt - at) < 4 * lag.value:
        found.append(warning("sensor.cut_off", subject=column, after_s=after, lag_s=lag.value))
    fit = {
        "entry_s": best.theta["entry_s"] + begun,
        "entry_u_s": float(np.sqrt(best.optimum.covariance[1, 1])),
        "step_K": best.theta["size"],
        "noise_K": best.noise_K,
        "lag_s": lag.model_dump(),
        **(film.to_fit(lag) if film else {}),
    }
    lag_u = float(np.hypot(lag.u, lag.value + conditioning.lag_s - chain.lag_s))
    return sensor_file(
        sensor,
        {column: chain},
        "plunge",
        np.array([[lag_u**2]]),
        [min(lesser.u, lag.value)],
        times={column: dict(zip(SHARES, times))},
        fit=fit,
        findings=found,
        **more,
    )


def _entry_conflict(
    column: str, specified_s: tuple[float, float], fitted_s: float, fitted_u_s: float
) -> list[Finding]:
    """A warning if the data contradict a specified entry instant.

    Parameters
    ----------
    column : str
        The sensor's column.
    specified_s : tuple of float
        Entry instant and its standard uncertainty, before the fit [s].
    fitted_s, fitted_u_s : float
        The same after the fit [s].

    Returns
    -------
    list of Finding
        Empty, or one warning.

    Notes
    -----
    For a normal prior and a normal likelihood (fitted - specified) / sqrt(u_specified^2 - u_fitted^2) equals the
    difference of what the data alone give and the prior, over the standard uncertainty of that difference (Box 1980,
    J. R. Stat. Soc. A 143, 383: prior predictive check).
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


def find_step(y: Array, dt_s: float, entry_s: float | None = None) -> Stepped:
    """Where the largest lasting change of ``y`` (N,) begins. Raises InputError where there is none."""
    ok = np.isfinite(y)
    if ok.sum() < 30:
        raise InputError(f"only {int(ok.sum())} samples", expected="at least 30")
    filled = np.interp(np.arange(len(y)), np.flatnonzero(ok), y[ok])
    noise = _white_K(filled)
    ends = max(len(y) // 50, 3)
    if entry_s is None:
        half = max(len(y) // 400, 1)
        mean = np.convolve(filled, np.ones(2 * half + 1) / (2 * half + 1), mode="valid")
        steep = int(np.argmax(np.abs(mean[2 * half :] - mean[: -2 * half]))) + 2 * half
        sign = np.sign(filled[min(steep + half, len(y) - 1)] - filled[max(steep - half, 0)])
        base = float(np.median(filled[: max(steep - 2 * half, ends)]))
        quick = sign * (filled[: steep + 1] - base)
        limit = max(5 * noise / np.sqrt(2 * half + 1), 0.02 * abs(filled[-ends:].mean() - base))
        calm = np.flatnonzero(quick < limit)
        start = int(calm[-1]) if len(calm) else 0
    else:
        start = int(np.clip(round(entry_s / dt_s), 0, len(y) - 2))
    before = float(np.median(filled[max(start - 5 * ends, 0) : max(start, 1)]))
    after = float(np.mean(filled[-ends:]))
    size = after - before
    if abs(size) < LEAST_STEP_NOISES * noise:
        raise InputError(
            f"no step: the reading changes by {abs(size):.3g} K, its noise is {noise:.2g} K",
            expected=f"at least {LEAST_STEP_NOISES:g} times the noise",
        )
    share = (filled[start:] - before) / size
    rise = max(int(np.argmax(share >= 0.632)), 2)
    if (len(y) - start) < 2.5 * rise:
        raise InputError(
            f"the record ends {(len(y) - start) * dt_s:.3g} s after the step, which is not over",
            expected="five time constants after the step",
        )
    first = max(start - max(int(BEFORE * AFTER * rise), 20), 0)
    last = min(start + max(int(AFTER * rise), 30), len(y))
    return Stepped(first, last, start * dt_s, size, rise * dt_s, before)


def _exact_s(dt_s: float) -> float:
    """The standard uncertainty of a time that was specified as exact, and no more than that of a quick record [s]."""
    return min(1e-6, 1e-3 * dt_s)


def _white_K(y: Array) -> float:
    """White noise of readings (N,), above zero."""
    return max(float(white_noise_sd(y[np.isfinite(y)], 3)), 1e-9)


@dataclass(frozen=True)
class _Record:
    """What is fitted: times from the first sample (N,) [s], readings, the step, the entry and what is known of it."""

    t: Array
    y: Array
    dt_s: float
    step: Stepped
    entry_s: float
    known: tuple[float, float] | None
    medium_s: tuple[float, float]
    conditioning: Conditioning

    @property
    def own_s(self) -> float:
        """About the lag of the sensor alone."""
        return max(self.step.rise_s - self.conditioning.lag_s, 2 * self.dt_s)


def _family(record: _Record) -> tuple[list[Fitted], list[float], Array]:
    """One free lag, and more where each is told from none, with a further one on a grid; their probabilities."""
    noise = (Noise(), _white_K(record.y))
    for turn in range(3):  # noise is what the best of them leaves: white as long as it is
        fits, least, weights = _on_grid(record, noise)
        top = int(np.argmax(weights))
        told = colour_of(fits[top].residual, len(fits[top].optimum.theta))
        if turn == 2 or (told[0].white and noise[0].white and 0.8 < told[1] / noise[1] < 1.25):
            break
        noise = told
    return fits, least, weights


def _on_grid(
    record: _Record, noise: tuple[Noise, float]
) -> tuple[list[Fitted], list[float], Array]:
    """The same on noise of one colour and level [K]."""
    fits = list[Fitted]()
    least = list[float]()
    prior = list[float]()
    step = record.step
    own = record.own_s
    head = [
        step.before_degC,
        record.entry_s,
        step.size_K,
        0.0,
        max(record.medium_s[0], min(1e-4, 0.1 * record.dt_s)),
    ]
    for shares in ([1.0], [0.85, 0.15], [0.75, 0.17, 0.08]):
        start = _fitted(record, 0.0, np.array([*head, *(own * np.array(shares))]), noise).optimum
        near = start.theta
        if np.any(np.sqrt(np.diag(start.covariance)[6:]) > RESOLVED * near[6:]):
            continue
        lags = _lags(near, 0.0)
        if not lags:
            continue
        shortest = lags[-1]
        grid = [0.0, *(share * own for share in LEAST if share * own <= shortest)]
        for extra in grid:
            fit = _fitted(record, extra, near, noise)
            if extra > min(fit.optimum.theta[5:]) or not _lags(fit.optimum.theta, extra):
                break
            near = fit.optimum.theta
            fits.append(fit)
            least.append(extra)
            prior.append(0.5 if extra == 0 else 0.5 / max(len(grid) - 1, 1))
    if not fits:
        raise InputError(
            f"the reading follows the step within one row of {record.dt_s:.3g} s: no lag can be told",
            expected="several rows in a lag",
            remedy="log faster; or the medium's lag, which was specified, explains all of the response",
        )
    return fits, least, weights_of(np.array([f.bic for f in fits]), np.array(prior))


def _fitted(record: _Record, extra: float, start: Array, noise: tuple[Noise, float]) -> Fitted:
    """Lags fitted beside one that is held, ``extra`` [s]: theta = level, entry, size, drift, medium's lag, the lags."""
    step, t, dt, medium = record.step, record.t, record.dt_s, record.medium_s
    count, span, ones = len(start) - 5, t[-1] - t[0], np.ones_like(t)
    big = abs(step.size_K)
    own = record.own_s
    scale = np.array([big, own, big, big / span, max(own, medium[1]), *[own] * count])

    def model(theta: Array) -> Array | None:
        taus = _lags(theta, extra)
        if not 0 <= theta[1] < t[-1] or max(taus, default=0.0) > 50 * span:
            return None
        chain = Chain(
            [*taus, max(theta[4], 0.0)], delay_s=float(theta[1]), conditioning=record.conditioning
        )
        return (
            theta[0]
            + theta[2] * chain.response(ones, dt, "zoh", "zero")
            + theta[3] * (t - span / 2)
        )

    prior = {"medium_s": (medium[0], max(medium[1], _exact_s(dt)))} | (
        {} if record.known is None else {"entry_s": record.known}
    )
    names = [
        "level",
        "entry_s",
        "size",
        "drift",
        "medium_s",
        *(f"tau{k + 1}_s" for k in range(count)),
    ]
    lower = {"medium_s": 0.0, "entry_s": 0.0, **dict.fromkeys(names[5:], 0.0)}
    return fit_curve(
        f"P{count}", model, record.y, names, start, scale, prior=prior, lower=lower, noise=noise
    )


def _lags(theta: Array, extra: float) -> list[float]:
    """The lags of a theta and the one that is held, largest first, those of nothing left out."""
    return sorted((float(tau) for tau in (*theta[5:], extra) if tau > 0), reverse=True)
