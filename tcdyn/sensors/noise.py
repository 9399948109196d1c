"""The lag in place from process noise: the spectrum of an autoregression, white fluctuations behind one or two lags."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from scipy import signal
from scipy.optimize import approx_fprime, minimize
from scipy.special import chdtrc

from tcdyn.chain import Chain
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Finding, info, warning
from tcdyn.core.threads import one_blas_thread
from tcdyn.sensors.file import SHARES, SensorFile, lag_and_times, sensor_file, undetermined
from tcdyn.sensors.step_fits import averaged, weights_of

MODEL_REL = 0.03  # of the lag, 1 sd, beside the statistics: fluctuations that are white only as far as can be seen
NO_LAG = 1e-6  # of the first lag: a second one below it is none
SEGMENT_LAGS = 60.0
LEAST_SEGMENTS = 6
LEAST_LAGS = 300.0
# of halves under Hann's window: their independence; bins that tell one thing
OVERLAP = 36 / 38
TAPER = 35 / 18
BANDS = 12
ALARM = 0.001
UNSTEADY = 3.0


@one_blas_thread
def noise_sensor(
    time_s: Array, y_degC: Array, column: str, *, sensor: str = "sensor", **more: Any
) -> SensorFile:
    """The chain from the trace's own fluctuations at constant conditions.

    The spectrum of a sampled sum of exponentials, A [tau1 s(tau1) - tau2 s(tau2)]/(tau1 - tau2) + B,
    s(tau) = (1 - p^2)/(1 - 2 p cos w + p^2), p = exp(-dt/tau): white fluctuations of the fluid behind one or two lags
    and white noise of the logger, which is what an autoregression (with that noise, an ARMA) fits. By Whittle's
    likelihood on overlapping segments; one lag and two are weighed by BIC.

    It holds if the fluid's fluctuations are white over the sensor's band and nothing else is: a fluid that swings more
    slowly adds its own time constant to the answer, and this trace cannot tell which is which. What the trace can tell
    is tested: that it is stationary, long enough, louder than the logger, and of this spectrum.

    Args:
        time_s, y_degC: (N,) even times [s] and readings [degC], NaN where missing.
        column: the sensor's column.

    Raises:
        InputError: gaps of more than 1 %, a trace shorter than some 300 lags, no fluctuation above the logger's noise.
    """
    dt = float(time_s[1] - time_s[0])
    ok = np.isfinite(y_degC)
    if ok.mean() < 0.99 or len(ok) < 512:
        raise InputError(
            f"{len(ok)} rows, {100 * (1 - ok.mean()):.2g} % of them missing",
            expected="at least 512, and 1 % at most",
        )
    y = signal.detrend(np.interp(np.arange(len(ok)), np.flatnonzero(ok), y_degC[ok]))
    length = len(y) // LEAST_SEGMENTS
    for _ in range(3):
        one = _least(segments(y, length, dt), 1)
        length = int(np.clip(SEGMENT_LAGS * np.exp(one[2]) / dt, 128, len(y) // LEAST_SEGMENTS))
    seen = segments(y, length, dt)
    fits = [_least(seen, 1), _least(seen, 2)]
    costs = np.array([_cost(theta, seen) * seen.counts for theta in fits])
    weights = weights_of(2 * costs + np.array([3, 4]) * np.log(seen.counts * len(seen.w)))
    values = []
    us = []
    for theta in fits:
        cov = _covariance(theta, seen)
        here = _quantities(theta[2:])
        slopes = approx_fprime(theta[2:], _quantities, 1e-4)
        values.append(here)
        variance = np.einsum("ik,kl,il->i", slopes, cov[2:, 2:], slopes)
        if not variance[0] > 0:
            raise undetermined(column)
        us.append(np.sqrt(np.maximum(variance, 0.0) + (MODEL_REL * here) ** 2))
    if us[1][0] > values[1][0]:
        weights = np.array([1.0, 0.0])
    lag, *times = (averaged([v[i] for v in values], [u[i] for u in us], weights) for i in range(4))
    best = fits[np.argmax(weights)]
    taus = _lags(best[2:])
    _enough(y, dt, lag, best)
    found = _conditions(y, seen, best, column, len(taus))
    fit = {
        "lag_s": lag.model_dump(),
        "lags_in_record": len(y) * dt / lag.value,
        "fluctuation_K": float(np.exp(0.5 * best[0])),
        "logger_K": float(np.exp(0.5 * best[1])),
        "probability_P2": float(weights[1]),
    }
    u_file = float(np.hypot(lag.u, lag.value - sum(taus)))
    return sensor_file(
        sensor,
        {column: Chain(taus)},
        "noise",
        np.array([[u_file**2]]),
        [min(0.5 * lag.u, lag.value)],
        times={column: dict(zip(SHARES, times))},
        fit=fit,
        findings=found,
        **more,
    )


@dataclass(frozen=True)
class Periodogram:
    """``power`` (K,) at the frequencies ``w`` (K,) [rad a sample] of rows every ``dt_s``; each bin counts so often."""

    power: Array
    w: Array
    dt_s: float
    counts: float


def segments(y: Array, length: int, dt_s: float) -> Periodogram:
    """Mean periodogram of halves-overlapping Hann segments of ``y`` (N,)."""
    window = np.hanning(length)
    window = window / np.sqrt(np.sum(window**2))
    starts = range(0, len(y) - length + 1, max(length // 2, 1))
    parts = [
        np.abs(np.fft.rfft(window * (y[s : s + length] - y[s : s + length].mean()))) ** 2
        for s in starts
    ]
    power = np.mean(parts, axis=0)
    keep = slice(2, (length - 1) // 2)  # the lowest bins hold what the mean took away
    return Periodogram(
        power[keep],
        2 * np.pi * np.arange(len(power))[keep] / length,
        dt_s,
        len(parts) * OVERLAP / TAPER,
    )


def spectrum(theta: Array, seen: Periodogram) -> Array:
    """The model's periodogram (K,): theta = log A, log B, logs of one or two lags [s]."""

    def one(tau: float) -> Array:
        p = np.exp(-seen.dt_s / tau)
        return (1 - p * p) / (1 - 2 * p * np.cos(seen.w) + p * p)

    taus = np.exp(np.clip(theta[2:], -30, 30))
    if len(taus) == 1:
        shape = one(float(taus[0]))
    else:
        a = float(max(taus))
        b = float(min(taus))
        b = min(b, a * (1 - 1e-4))
        shape = (a * one(a) - b * one(b)) / (a - b)
    return np.exp(theta[0]) * np.maximum(shape, 0.0) + np.exp(theta[1])


def _cost(theta: Array, seen: Periodogram) -> float:
    s = spectrum(theta, seen)
    return float(np.sum(np.log(s) + seen.power / s))


def _least(seen: Periodogram, count: int) -> Array:
    power = seen.power
    dt = seen.dt_s
    total = float(power.mean())
    floor = float(np.median(power[-max(len(power) // 10, 3) :]))
    options = {"maxiter": 1500, "xatol": 1e-4, "fatol": 1e-4}
    tried = []
    for tau in np.geomspace(2 * dt, 0.2 * dt * 2 * len(power), 6):
        start = np.log([total, max(floor, 1e-12), *[tau, 0.2 * tau][:count]])
        tried.append(minimize(_cost, start, (seen,), method="Nelder-Mead", options=options))
    found = min(tried, key=lambda one: one.fun).x
    return np.r_[found[:2], np.sort(found[2:])[::-1]]


def _covariance(theta: Array, seen: Periodogram) -> Array:
    """Inverse of Whittle's expected information: counts x sum of d log S d log S'."""
    pairs = [(theta + e, theta - e) for e in 1e-4 * np.eye(len(theta))]
    slopes = np.array(
        [np.log(spectrum(up, seen) / spectrum(down, seen)) / 2e-4 for up, down in pairs]
    )
    return np.linalg.pinv(seen.counts * slopes @ slopes.T)


def _quantities(logs: Array) -> Array:
    return lag_and_times(Chain(_lags(logs)))


def _lags(logs: Array) -> list[float]:
    """The lags, largest first [s], from their logarithms; a second one that went to nothing is none."""
    taus = np.exp(logs)
    return sorted(taus[taus > NO_LAG * taus.max()].tolist(), reverse=True)


def _enough(y: Array, dt: float, lag: Estimate, theta: Array) -> None:
    """Refuse what cannot be told: a record too short, a sensor as quick as the rows, nothing above the noise."""
    lags = len(y) * dt / lag.value
    if lags < LEAST_LAGS:
        raise InputError(
            f"the record is {lags:.3g} lags long",
            expected=f"at least {LEAST_LAGS:g}",
            remedy="log for longer",
        )
    if lag.value < 2 * dt:
        raise InputError(
            f"a lag of {lag.value:.3g} s in rows every {dt:.3g} s", remedy="log faster"
        )
    if np.exp(theta[0]) * lag.value / dt < np.exp(theta[1]):
        raise InputError(
            "the fluid's fluctuations are within the logger's noise",
            remedy="log a livelier process",
        )


def _conditions(y: Array, seen: Periodogram, theta: Array, column: str, lags: int) -> list[Finding]:
    """What the trace tells of the conditions: stationarity, and whether the spectrum is the model's."""
    found: list[Finding] = [
        (warning if lags == 2 else info)("sensor.noise_driving", subject=column, lags=lags)
    ]
    quarters = [float(np.var(part)) for part in np.array_split(y, 4)]
    if max(quarters) > UNSTEADY * min(quarters):
        found.append(
            warning(
                "sensor.noise_unsteady",
                subject=column,
                ratio=(max(quarters) / min(quarters)) ** 0.5,
            )
        )
    ratio = seen.power / spectrum(theta, seen)
    edges = np.unique(np.geomspace(1, len(ratio), BANDS + 1).astype(int) - 1)
    total = 0.0
    bands = 0
    for a, b in pairwise(edges):
        if b - a >= 3:
            total += float(seen.counts * (b - a) * (ratio[a:b].mean() - 1) ** 2)
            bands += 1
    p = float(chdtrc(max(bands - len(theta), 1), total))
    if p < ALARM:
        found.append(warning("sensor.noise_misfit", subject=column, p_value=p))
    return found
