"""Two thermocouples of different size in one fluid, no reference: both lags, noise on both, the flow constant or not.

For any fluid temperature x, y1 + tau1 y1' = x = y2 + tau2 y2' without noise. The difference of the two sides is a sum
of noises whose covariance is known for each (tau1, tau2); least squares in it is the likelihood of both traces with x
left free at every sample. Least squares of one trace on the other would be biased by the noise of the regressor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky_banded, solve_banded
from scipy.optimize import minimize

from calibration import Array
from calibration.errors import InputError
from calibration.estimate import Estimate
from calibration.finding import Finding, look
from calibration.noise import white_noise_sd
from tcdyn.chain import Chain
from tcdyn.sensor.file import SensorFile, sensor_file

EXPONENT = (0.5, 0.1)  # of the lag of a thin wire with the speed: tau ~ speed^-n; a prior
PER_LAG = 6.0  # samples in the shorter lag that the likelihood is given: more hold noise only
BLOCKS, LEAST_ROWS = 40, 60
TOLD = 0.3  # relative standard uncertainty beyond which a lag is not told


@dataclass(frozen=True)
class PairData:
    """Two traces (N,) [degC] every ``dt_s``, their noise [K], which rows belong together, the lags' factor at each row.

    ``piece`` (N,): number of the stretch of constant flow; ``log_speed`` (N,): log of speed over its median.
    """

    first: Array
    second: Array
    dt_s: float
    noise_K: tuple[float, float]
    piece: NDArray[np.intp]
    log_speed: Array
    pieces: int


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
    ``changes_s``, then the file holds those of the last stretch and ``fit`` all.

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
        InputError: shapes that differ, speeds that are not positive, a stretch of fewer than 60 rows, one trace twice.
    """
    dt = float(time_s[1] - time_s[0])
    edges = [-np.inf, *sorted(changes_s), np.inf]
    piece = np.digitize(time_s, edges[1:-1]).astype(np.intp)
    if speed is not None and changes_s:
        raise InputError("a speed and instants of change were both given", expected="one of them")
    log_speed = np.zeros(len(time_s))
    if speed is not None:
        if not np.all(np.nan_to_num(speed, nan=1.0) > 0):
            raise InputError("the speed is not above zero everywhere", expected="the speed of the flow, in any unit")
        if not (abs(exponent[0]) <= 5 and 1e-3 <= exponent[1] <= 5):
            expected = "0.5+-0.1 or the like: 5 at most, uncertain by 0.001 to 5"
            raise InputError(f"an exponent of {exponent[0]:g} +- {exponent[1]:g}", expected=expected)
        filled = np.interp(time_s, time_s[np.isfinite(speed)], speed[np.isfinite(speed)])
        log_speed = np.log(filled / np.median(filled))
    noise = tuple(max(float(white_noise_sd(y[np.isfinite(y)], 3)), 1e-9) for y in (first, second))
    if np.nanstd(first - second) < 1.05 * np.hypot(noise[0], noise[1]):
        raise InputError(
            f"{columns[0]} and {columns[1]} read the same within noise", expected="two sensors of different size"
        )
    data = PairData(first, second, dt, (noise[0], noise[1]), piece, log_speed, len(edges) - 1)
    start = _start(data)
    for _ in range(2):
        size = max(int(np.exp(start[: 2 * data.pieces].min()) / PER_LAG / dt), 1)
        thin = averaged_rows(data, size)
        counts = np.bincount(thin.piece, minlength=data.pieces)
        if counts.min() < LEAST_ROWS:
            thin = data
        if np.bincount(thin.piece, minlength=data.pieces).min() < LEAST_ROWS:
            raise InputError(
                f"a stretch of {counts.min()} rows", expected=f"at least {LEAST_ROWS} between changes of flow"
            )
        start = _least(thin, start, speed is not None, exponent)
    covariance, chi2 = _covariance(thin, start, speed is not None, exponent)
    return _file(thin, start, covariance, chi2, columns, sensor, speed, changes_s, more)


def averaged_rows(data: PairData, size: int) -> PairData:
    """Means of ``size`` rows: what both sensors' lags make of one fluid they make of its means, too."""
    if size < 2:
        return data
    n = len(data.first) // size * size

    def mean(x: Array) -> Array:
        return np.asarray(x[:n].reshape(-1, size).mean(axis=1))

    noise = data.noise_K[0] / np.sqrt(size), data.noise_K[1] / np.sqrt(size)
    return PairData(
        mean(data.first),
        mean(data.second),
        data.dt_s * size,
        noise,
        data.piece[:n:size],
        mean(data.log_speed),
        data.pieces,
    )


def whitened(data: PairData, theta: Array, varying: bool) -> Array:
    """Residuals of unit variance, the differences of the two sides in the middle between rows; theta: logs of the lags.

    theta = (log tau1, log tau2) of each piece, then n. Rows beside a missing value or a change of flow are left out.
    """
    power = theta[2 * data.pieces] if varying else 0.0
    sides = []
    for k, y in enumerate((data.first, data.second)):
        log_tau = theta[k : 2 * data.pieces : 2][data.piece] - power * data.log_speed
        tau = np.exp(0.5 * (log_tau[1:] + log_tau[:-1])) / data.dt_s
        sides.append((0.5 - tau, 0.5 + tau, (0.5 - tau) * y[:-1] + (0.5 + tau) * y[1:]))
    (a1, b1, u1), (a2, b2, u2) = sides
    rest = u1 - u2
    use = np.isfinite(rest) & (data.piece[1:] == data.piece[:-1])
    s1, s2 = data.noise_K[0] ** 2, data.noise_K[1] ** 2
    own = np.where(use, s1 * (a1**2 + b1**2) + s2 * (a2**2 + b2**2), 1.0)
    next_ = s1 * b1[:-1] * a1[1:] + s2 * b2[:-1] * a2[1:]
    band = np.zeros((2, len(rest)))
    band[1] = own
    band[0, 1:] = np.where(use[1:] & use[:-1], next_, 0.0)
    factor = cholesky_banded(band, lower=False)  # V = U' U: forward substitution with U' makes the residuals white
    return _forward(factor, np.where(use, rest, 0.0))


def _forward(factor: Array, rest: Array) -> Array:
    """(U')^-1 rest for the upper bidiagonal U of a banded Cholesky factor."""
    lower = np.zeros_like(factor)
    lower[0], lower[1, :-1] = factor[1], factor[0, 1:]
    return np.asarray(solve_banded((1, 0), lower, rest))


def _cost(data: PairData, theta: Array, varying: bool, exponent: tuple[float, float]) -> float:
    w = whitened(data, theta, varying)
    prior = ((theta[-1] - exponent[0]) / exponent[1]) ** 2 if varying else 0.0
    return float(w @ w + prior)


def _start(data: PairData) -> Array:
    """First guesses of the logs of the lags: the best of a coarse map, alike in all pieces."""
    span = len(data.first) * data.dt_s
    grid = np.geomspace(2 * data.dt_s, span / 8, 12)
    size = max(int(len(data.first) / 3000), 1)
    thin = averaged_rows(data, size)
    best, found = np.inf, np.zeros(2)
    for t1 in grid:
        for t2 in grid:
            if t1 != t2:
                theta = np.tile(np.log([t1, t2]), data.pieces)
                cost = _cost(thin, theta, False, EXPONENT)
                if cost < best:
                    best, found = cost, theta
    return found


def _least(data: PairData, start: Array, varying: bool, exponent: tuple[float, float]) -> Array:
    """The least cost from ``start``; n is put behind it where the lags vary with the speed."""
    if varying and len(start) == 2 * data.pieces:
        start = np.append(start, exponent[0])
    lo, hi = np.log(data.dt_s / 10), np.log(len(data.first) * data.dt_s)

    def cost(theta: Array) -> float:
        return _cost(
            data, np.r_[np.clip(theta[: 2 * data.pieces], lo, hi), theta[2 * data.pieces :]], varying, exponent
        )

    found = minimize(
        cost, start, method="Nelder-Mead", options={"xatol": 1e-4, "fatol": 1e-3, "maxiter": 400 * len(start)}
    )
    return np.asarray(found.x)


def _covariance(data: PairData, theta: Array, varying: bool, exponent: tuple[float, float]) -> tuple[Array, float]:
    """Covariance of theta, H^-1 C H^-1, and the mean square of the residuals.

    H: half the Hessian of the cost, in which the noise has no part on the average; C: the scores' covariance by sums
    over blocks of the record, which holds that a trace's derivative is noisy, too, and residuals that are not white.
    """
    p, w = len(theta), whitened(data, theta, varying)
    step = np.full(p, 2e-3)
    hessian, scores = np.zeros((p, p)), []
    for i in range(p):
        ei = np.eye(p)[i] * step[i]
        plus, minus = whitened(data, theta + ei, varying), whitened(data, theta - ei, varying)
        scores.append(0.25 * (plus**2 - minus**2) / step[i])
        for j in range(i + 1):
            ej = np.eye(p)[j] * step[j]
            corners = [
                _cost(data, theta + a * ei + b * ej, varying, exponent) for a, b in ((1, 1), (1, -1), (-1, 1), (-1, -1))
            ]
            hessian[i, j] = hessian[j, i] = (corners[0] - corners[1] - corners[2] + corners[3]) / (
                8 * step[i] * step[j]
            )
    sums = np.add.reduceat(np.array(scores), np.arange(0, len(w), max(len(w) // BLOCKS, 1)), axis=1)
    centred = sums - sums.mean(axis=1, keepdims=True)
    score = centred @ centred.T * (sums.shape[1] / max(sums.shape[1] - 1, 1))
    if varying:
        score[-1, -1] += exponent[1] ** -2
    values, vectors = np.linalg.eigh(hessian)
    inverse = vectors / np.maximum(values, 1e-3) @ vectors.T
    by_model = inverse * max(float(np.mean(w**2)), 1.0)
    robust = inverse @ score @ inverse
    return _wider(robust, by_model), float(np.mean(w[w != 0] ** 2))


def _wider(a: Array, b: Array) -> Array:
    """The covariance with the larger variances of two, correlations of the first."""
    scale = np.sqrt(np.maximum(np.diag(a), np.diag(b)) / np.maximum(np.diag(a), 1e-300))
    return np.asarray(a * np.outer(scale, scale))


def _file(
    data: PairData, theta: Array, covariance: Array, chi2: float, columns: tuple[str, str], sensor: str,
    speed: Array | None, changes_s: Sequence[float], more: dict[str, Any],
) -> SensorFile:  # fmt: skip
    """The file of both columns: lags of the last stretch, or at the median speed; all stretches in ``fit``."""
    last, m = 2 * (data.pieces - 1), 2 * data.pieces
    taus = np.exp(theta[:m])
    lags = np.outer(taus, taus) * covariance[:m, :m]
    found: list[Finding] = []
    for k in range(data.pieces):
        (t1, t2), part = taus[2 * k : 2 * k + 2], lags[2 * k : 2 * k + 2, 2 * k : 2 * k + 2]
        if max(np.sqrt(np.diag(part)) / (t1, t2)) > TOLD:
            u = float(np.sqrt(max(part[0, 0] + part[1, 1] - 2 * part[0, 1], 0.0)))
            found.append(look("sensor.pair_difference", subject=", ".join(columns), difference_s=float(t1 - t2), u_s=u))
    if data.dt_s > min(taus) / 3:
        found.append(
            look("sensor.slow", subject=columns[int(np.argmin(taus[:2]))], dt_s=data.dt_s, lag_s=float(min(taus)))
        )
    if chi2 > 1.5:
        found.append(look("sensor.pair_misfit", subject=", ".join(columns), ratio=chi2))
    fit: dict[str, Any] = {
        "chi2": chi2, "noise_K": list(data.noise_K),
        "ratio": _ratio(theta[last : last + 2], covariance[last : last + 2, last : last + 2]).model_dump(),
    }  # fmt: skip
    if speed is not None:
        fit["exponent"] = Estimate.normal(float(theta[m]), float(np.sqrt(covariance[m, m]))).model_dump()
        fit["speed_median"] = float(np.nanmedian(speed))
        found.append(look("sensor.pair_flow", subject=", ".join(columns), what=f"speed {np.nanmedian(speed):.4g}"))
    if changes_s:
        each = [Estimate.normal(float(t), float(v)).model_dump() for t, v in zip(taus, np.sqrt(np.diag(lags)))]
        fit["changes_s"] = list(map(float, changes_s))
        fit["stretches"] = [dict(zip(columns, each[2 * k : 2 * k + 2])) for k in range(data.pieces)]
        what = f"the stretch after {max(changes_s):.6g} s"
        found.append(look("sensor.pair_flow", subject=", ".join(columns), what=what))
    chains = {c: Chain(float(taus[last + i])) for i, c in enumerate(columns)}
    block = lags[last : last + 2, last : last + 2]
    return sensor_file(sensor, chains, "pair", block, [0.0, 0.0], fit=fit, findings=found, **more)


def _ratio(logs: Array, covariance: Array) -> Estimate:
    """tau1/tau2."""
    value = float(np.exp(logs[0] - logs[1]))
    variance = float(covariance[0, 0] + covariance[1, 1] - 2 * covariance[0, 1])
    return Estimate.normal(value, value * max(variance, 0.0) ** 0.5)
