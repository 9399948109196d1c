"""Two thermocouples of different size in one fluid, no reference: both lags, noise on both, the flow constant or not.

For any fluid temperature x, y1 + tau1 y1' = x = y2 + tau2 y2' without noise. The difference of the two sides is a sum
of noises whose covariance is known for each (tau1, tau2); least squares in it is the likelihood of both traces with x
left free at every sample. Least squares of one trace on the other would be biased by the noise of the regressor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky_banded, solve_banded
from scipy.optimize import minimize

from tcdyn.chain import Chain
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Finding, info, warning
from tcdyn.core.threads import one_blas_thread
from tcdyn.estimation.trace_noise import white_noise_sd
from tcdyn.sensors.file import SensorFile, sensor_file, undetermined
from tcdyn.sensors.sparse_rows import Intervals, find_intervals, interval_residuals
from tcdyn.sensors.updates import Updates, find_updates

EXPONENT = (0.5, 0.1)  # of the lag of a thin wire with the speed: tau ~ speed^-n; a prior
PER_LAG = 6.0  # samples in the shorter lag that the likelihood is given: more hold noise only
BLOCKS = 40
LEAST_ROWS = 60
STEP = 2e-3  # of the logarithm of a lag, for differences
TOLD = 0.3  # relative standard uncertainty beyond which a lag is not told
MIN_USABLE_SHARE = 0.5  # steps with values of both at either end: above it, the others are left out and not bridged
COMPLETE_SHARE = (
    0.98  # rows with a new value: a channel with fewer has its missing values eliminated
)
ROWS_PER_LAG = 3.0  # rows in the shorter lag: with fewer the straight lines between rows bias it


@dataclass(frozen=True)
class PairData:
    """Two traces (N,) [degC] every ``dt_s``, their noise [K], which rows belong together, the lags' factor at each row.

    ``piece`` (N,): number of the stretch of constant flow; ``log_speed`` (N,): log of speed over its median;
    ``exponent``: prior of n, mean and standard deviation. ``intervals``: between rows with a new value of both
    channels, where one channel has new values in some rows only; None where each row has both.
    """

    first: Array
    second: Array
    dt_s: float
    noise_K: tuple[float, float]
    piece: NDArray[np.intp]
    log_speed: Array
    pieces: int
    exponent: tuple[float, float]
    intervals: Intervals | None = None


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
    **more: Any,
) -> SensorFile:
    """Both lags, each of first order, from what two sensors in one fluid read.

    The lags are constant; or tau = tau_0 (speed/its median)^-n with n free about ``exponent``; or constant between
    ``changes_s``, then the file holds those of the last stretch and ``fit`` all. Both columns of a row are taken as
    sampled at one instant: a scanner that reads the second one later biases both lags by more than that time. A column
    that is repeated or blank between new values is used at the rows of its new values.

    Args:
        time_s: (N,) even times [s].
        first, second: (N,) readings [degC], NaN where missing.
        columns: what they are called.
        speed: (N,) of the flow, any unit, above zero.
        changes_s: when the flow stepped, on the clock of ``time_s``.
        exponent: prior of n, mean and standard deviation.

    Returns:
        The file of both columns. A look says where the traces tell only the difference of the lags.

    Raises:
        InputError: shapes that differ, speeds that are not positive, a stretch of fewer than 60 rows, one trace twice,
            new values of both in too few rows, or too seldom for the shorter lag.
    """
    dt = float(time_s[1] - time_s[0])
    edges = [-np.inf, *sorted(changes_s), np.inf]
    piece = np.digitize(time_s, edges[1:-1]).astype(np.intp)
    if speed is not None and changes_s:
        raise InputError("a speed and instants of change were both given", expected="one of them")
    if not (abs(exponent[0]) <= 5 and 1e-3 <= exponent[1] <= 5):
        expected = "0.5+-0.1 or the like: 5 at most, uncertain by 0.001 to 5"
        raise InputError(f"an exponent of {exponent[0]:g} +- {exponent[1]:g}", expected=expected)
    log_speed = np.zeros(len(time_s))
    if speed is not None:
        if not np.all(np.nan_to_num(speed, nan=1.0) > 0):
            raise InputError(
                "the speed is not above zero everywhere",
                expected="the speed of the flow, in any unit",
            )
        filled = np.interp(time_s, time_s[np.isfinite(speed)], speed[np.isfinite(speed)])
        log_speed = np.log(filled / np.median(filled))
    for name, y in zip(columns, (first, second)):
        if (count := np.count_nonzero(np.isfinite(y))) < LEAST_ROWS:
            raise InputError(f"{name} holds {count} numbers", expected=f"at least {LEAST_ROWS}")
    pieces = len(edges) - 1
    noise = [max(float(white_noise_sd(y[np.isfinite(y)], 3)), 1e-9) for y in (first, second)]
    data = PairData(first, second, dt, (noise[0], noise[1]), piece, log_speed, pieces, exponent)
    data, found = _with_new_values(data, columns)
    noise = list(data.noise_K) if data.intervals is None else [min(data.noise_K)] * 2
    if np.nanstd(data.first - data.second) < 1.05 * np.hypot(noise[0], noise[1]):
        raise InputError(
            f"{columns[0]} and {columns[1]} read the same within noise",
            expected="two sensors of different size",
        )
    start = np.append(_start(data), [] if speed is None else exponent[0])
    for _ in range(2):
        size = max(int(np.exp(start[: 2 * data.pieces].min()) / PER_LAG / data.dt_s), 1)
        thin = averaged_rows(data, size)
        if usable_rows(thin) < LEAST_ROWS:
            thin = data
        usable = usable_rows(thin)
        if usable < LEAST_ROWS:
            what = f"a stretch of {usable} rows with new values of {columns[0]} and {columns[1]}"
            raise InputError(what, expected=f"at least {LEAST_ROWS} between changes of flow")
        start = _least(thin, start)
        if thin.intervals is not None:
            thin = data = _with_fitted_noise(thin, start)
            start = _least(thin, start)
    shorter_s = float(np.exp(start[: 2 * data.pieces].min()))
    if data.dt_s > dt and data.dt_s > shorter_s / ROWS_PER_LAG:
        raise InputError(
            f"{columns[0]} and {columns[1]} have a new value every {data.dt_s:.3g} s only (rows every {dt:.3g} s), the "
            f"shorter lag is about {shorter_s:.2g} s",
            expected=f"a new value at least every {shorter_s / ROWS_PER_LAG:.2g} s",
            remedy="log both columns faster, at one rate",
        )
    covariance, chi2 = _covariance(thin, start)
    if not (np.all(np.isfinite(covariance)) and np.all(np.diag(covariance) > 0)):
        raise undetermined(", ".join(columns))
    made = _file(thin, start, covariance, chi2, columns, sensor, speed, changes_s, more)
    return made.model_copy(update={"findings": [*found, *made.findings]})


def _with_new_values(data: PairData, columns: tuple[str, str]) -> tuple[PairData, list[Finding]]:
    """The rows with new values of both channels, or the intervals between them; a finding of each slower channel.

    Raises InputError where too few rows have a new value of both.
    """
    traces = (data.first, data.second)
    updates = [find_updates(y) for y in traces]
    finite = np.isfinite(data.first) & np.isfinite(data.second)
    usable_share = float(np.mean(finite[1:] & finite[:-1]))
    if not any(u.held for u in updates) and usable_share >= MIN_USABLE_SHARE:
        return data, []
    slower = [k for k, u in enumerate(updates) if u.share < COMPLETE_SHARE]
    found: list[Finding] = []
    for k in slower:
        interval_s = data.dt_s / updates[k].share
        percent = 100 * updates[k].share
        found.append(
            info("sensor.pair_slower", subject=columns[k], percent=percent, interval_s=interval_s)
        )
    dense = updates[int(np.argmax([u.share for u in updates]))]
    period = max(dense.period, 1)
    rows = slice(dense.first if period > 1 else 0, None, period)
    new = [u.new[rows] for u in updates]
    first, second = (np.where(flags, y[rows], np.nan) for flags, y in zip(new, traces))
    data = replace(
        data,
        first=first,
        second=second,
        dt_s=data.dt_s * period,
        piece=data.piece[rows],
        log_speed=data.log_speed[rows],
    )
    if min(float(np.mean(flags)) for flags in new) < COMPLETE_SHARE:
        data = replace(data, intervals=find_intervals((new[0], new[1]), data.piece))
    if usable_rows(data) < LEAST_ROWS:
        raise _too_few(data, columns, updates)
    noise = [max(float(white_noise_sd(y[np.isfinite(y)], 3)), 1e-9) for y in (first, second)]
    return replace(data, noise_K=(noise[0], noise[1])), found


def _too_few(data: PairData, columns: tuple[str, str], updates: Sequence[Updates]) -> InputError:
    """The error of a record whose channels have new values in different rows, or seldom."""
    of_each = [
        f"{name} has a new value in {100 * u.share:.3g} % of the rows"
        for name, u in zip(columns, updates)
    ]
    return InputError(
        f"{' and '.join(of_each)} (repeated or blank in the others); {usable_rows(data) - 1} rows can be used",
        expected=f"at least {LEAST_ROWS} rows with a new value of both in each stretch of constant flow",
        remedy="log both columns at the same instants and at one rate, that of the slower one",
    )


def usable_rows(data: PairData) -> int:
    """Rows that the fit can use, their first one included, in the segment of constant flow that has the fewest."""
    if data.intervals is not None:
        segment = data.piece[data.intervals.start]
    else:
        finite = np.isfinite(data.first) & np.isfinite(data.second)
        segment = data.piece[1:][finite[1:] & finite[:-1] & (data.piece[1:] == data.piece[:-1])]
    return int(np.bincount(segment, minlength=data.pieces).min()) + 1


def _with_fitted_noise(data: PairData, theta: Array) -> PairData:
    """The noise of the channel with fewer values such that the residuals have unit variance, if they have less.

    Differences of values far apart hold the signal, too, and overstate the noise.
    """
    sparse = int(
        np.count_nonzero(np.isfinite(data.second)) < np.count_nonzero(np.isfinite(data.first))
    )

    def with_noise(noise_K: float) -> PairData:
        both = list(data.noise_K)
        both[sparse] = noise_K
        return replace(data, noise_K=(both[0], both[1]))

    low = 1e-9
    high = data.noise_K[sparse]
    for _ in range(40):  # halvings of the logarithm
        middle = float(np.sqrt(low * high))
        if np.mean(whitened(with_noise(middle), theta) ** 2) > 1:
            low = middle
        else:
            high = middle
    return with_noise(high)


def averaged_rows(data: PairData, size: int) -> PairData:
    """Means of ``size`` rows: what both sensors' lags make of one fluid they make of its means, too."""
    if size < 2 or data.intervals is not None:
        return data
    n = len(data.first) // size * size

    def mean(x: Array) -> Array:
        return x[:n].reshape(-1, size).mean(axis=1)

    noise = data.noise_K[0] / np.sqrt(size), data.noise_K[1] / np.sqrt(size)
    return replace(
        data,
        first=mean(data.first),
        second=mean(data.second),
        dt_s=data.dt_s * size,
        noise_K=noise,
        piece=data.piece[:n:size],
        log_speed=mean(data.log_speed),
    )


def whitened(data: PairData, theta: Array) -> Array:
    """Residuals of unit variance, the differences of the two sides in the middle between rows; theta: logs of the lags.

    theta = (log tau1, log tau2) of each piece, then n if it is free. Rows beside a missing value or a change of flow
    are left out.
    """
    power = theta[2 * data.pieces :].sum()
    if data.intervals is not None:
        traces = np.stack([data.first, data.second])
        lags = [_between_rows(data, theta, k, power) for k in (0, 1)]
        before = 0.5 - np.stack(lags)
        after = 0.5 + np.stack(lags)
        return interval_residuals(before, after, traces, data.noise_K, data.intervals)
    sides = []
    for k, y in enumerate((data.first, data.second)):
        tau = _between_rows(data, theta, k, power)
        sides.append((0.5 - tau, 0.5 + tau, (0.5 - tau) * y[:-1] + (0.5 + tau) * y[1:]))
    (a1, b1, u1), (a2, b2, u2) = sides
    rest = u1 - u2
    use = np.isfinite(rest) & (data.piece[1:] == data.piece[:-1])
    s1 = data.noise_K[0] ** 2
    s2 = data.noise_K[1] ** 2
    own = np.where(use, s1 * (a1**2 + b1**2) + s2 * (a2**2 + b2**2), 1.0)
    next_ = s1 * b1[:-1] * a1[1:] + s2 * b2[:-1] * a2[1:]
    band = np.zeros((2, len(rest)))
    band[0], band[1, :-1] = own, np.where(use[1:] & use[:-1], next_, 0.0)
    factor = cholesky_banded(
        band, lower=True
    )  # V = L L': forward substitution with L makes the residuals white
    return solve_banded((1, 0), factor, np.where(use, rest, 0.0))


def _between_rows(data: PairData, theta: Array, channel: int, power: float) -> Array:
    """The lag (N - 1,) of a channel between rows, in rows."""
    log_tau = theta[channel : 2 * data.pieces : 2][data.piece] - power * data.log_speed
    return np.asarray(np.exp(0.5 * (log_tau[1:] + log_tau[:-1])) / data.dt_s)


def _cost(data: PairData, theta: Array) -> float:
    w = whitened(data, theta)
    (mean, sd) = data.exponent
    return float(w @ w + np.sum(((theta[2 * data.pieces :] - mean) / sd) ** 2))


def _start(data: PairData) -> Array:
    """First guesses of the logs of the lags: the best of a coarse map, alike in all pieces."""
    span = len(data.first) * data.dt_s
    grid = np.geomspace(2 * data.dt_s, span / 8, 12)
    thin = averaged_rows(data, max(len(data.first) // 3000, 1))
    pairs = permutations(np.log(grid), 2)
    return min((np.tile(pair, data.pieces) for pair in pairs), key=lambda theta: _cost(thin, theta))


def _least(data: PairData, start: Array) -> Array:
    """The least cost from ``start``."""
    lo, hi = np.log(data.dt_s / 10), np.log(len(data.first) * data.dt_s)

    def cost(theta: Array) -> float:
        return _cost(
            data, np.r_[np.clip(theta[: 2 * data.pieces], lo, hi), theta[2 * data.pieces :]]
        )

    found = minimize(
        cost,
        start,
        method="Nelder-Mead",
        options={"xatol": 1e-4, "fatol": 1e-3, "maxiter": 400 * len(start)},
    )
    return found.x


def _covariance(data: PairData, theta: Array) -> tuple[Array, float]:
    """Covariance of theta, H^-1 C H^-1, and the mean square of the residuals.

    H: half the Hessian of the cost, in which the noise has no part on the average; C: the scores' covariance by sums
    over blocks of the record, which holds that a trace's derivative is noisy, too, and residuals that are not white.
    Variances are not less than those of white residuals.
    """
    p = len(theta)
    w = whitened(data, theta)
    steps = STEP * np.eye(p)
    scores = []
    hessian = np.zeros((p, p))
    for i, ei in enumerate(steps):
        scores.append(
            0.25 * (whitened(data, theta + ei) ** 2 - whitened(data, theta - ei) ** 2) / STEP
        )
        for j, ej in enumerate(steps[: i + 1]):
            corners = sum(
                a * b * _cost(data, theta + a * ei + b * ej) for a, b in product((1, -1), repeat=2)
            )
            hessian[i, j] = hessian[j, i] = corners / (8 * STEP**2)
    sums = np.add.reduceat(np.array(scores), np.arange(0, len(w), max(len(w) // BLOCKS, 1)), axis=1)
    centred = sums - sums.mean(axis=1, keepdims=True)
    score = centred @ centred.T * (sums.shape[1] / max(sums.shape[1] - 1, 1))
    free = 2 * data.pieces
    score[free:, free:] += data.exponent[1] ** -2
    values, vectors = np.linalg.eigh(hessian)
    inverse = vectors / np.maximum(values, 1e-3) @ vectors.T
    robust = inverse @ score @ inverse
    variance = np.diag(robust)
    by_model = np.diag(inverse) * max(float(np.mean(w**2)), 1.0)
    wider = np.sqrt(np.maximum(variance, by_model) / np.maximum(variance, 1e-300))
    return robust * np.outer(wider, wider), float(np.mean(w[w != 0] ** 2))


def _file(
    data: PairData,
    theta: Array,
    covariance: Array,
    chi2: float,
    columns: tuple[str, str],
    sensor: str,
    speed: Array | None,
    changes_s: Sequence[float],
    more: dict[str, Any],
) -> SensorFile:
    """The file of both columns: lags of the last stretch, or at the median speed; all stretches in ``fit``."""
    m = 2 * data.pieces
    taus = np.exp(theta[:m])
    now = slice(m - 2, m)
    ratio = float(taus[m - 2] / taus[m - 1])
    lags = np.outer(taus, taus) * covariance[:m, :m]
    found: list[Finding] = []
    for k in range(data.pieces):
        (t1, t2) = taus[2 * k : 2 * k + 2]
        part = lags[2 * k : 2 * k + 2, 2 * k : 2 * k + 2]
        if max(np.sqrt(np.diag(part)) / (t1, t2)) > TOLD:
            u = _difference_u(part)
            found.append(
                warning(
                    "sensor.pair_difference",
                    subject=", ".join(columns),
                    difference_s=t1 - t2,
                    u_s=u,
                )
            )
    if data.dt_s > min(taus) / 3:
        found.append(
            warning(
                "sensor.slow", subject=columns[np.argmin(taus[:2])], dt_s=data.dt_s, lag_s=min(taus)
            )
        )
    if chi2 > 1.5:
        found.append(warning("sensor.pair_misfit", subject=", ".join(columns), ratio=chi2))
    fit: dict[str, Any] = {
        "chi2": chi2,
        "noise_K": list(data.noise_K),
        "ratio": Estimate.normal(ratio, ratio * _difference_u(covariance[now, now])).model_dump(),
    }
    if speed is not None:
        fit["exponent"] = Estimate.normal(theta[m], np.sqrt(covariance[m, m])).model_dump()
        fit["speed_median"] = float(np.nanmedian(speed))
        found.append(
            warning(
                "sensor.pair_flow",
                subject=", ".join(columns),
                what=f"speed {np.nanmedian(speed):.4g}",
            )
        )
    if changes_s:
        each = [Estimate.normal(t, u).model_dump() for t, u in zip(taus, np.sqrt(np.diag(lags)))]
        fit["changes_s"] = list(map(float, changes_s))
        fit["stretches"] = [dict(zip(columns, each[2 * k : 2 * k + 2])) for k in range(data.pieces)]
        what = f"the stretch after {max(changes_s):.6g} s"
        found.append(warning("sensor.pair_flow", subject=", ".join(columns), what=what))
    chains = {c: Chain(tau) for c, tau in zip(columns, taus[now])}
    return sensor_file(
        sensor, chains, "pair", lags[now, now], [0.0, 0.0], fit=fit, findings=found, **more
    )


def _difference_u(covariance: Array) -> float:
    """Standard uncertainty of the difference of two numbers, from their covariance (2, 2)."""
    return float(np.sqrt(max(np.trace(covariance) - 2 * covariance[0, 1], 0.0)))
