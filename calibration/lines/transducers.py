"""Load cell and friction transducer: force against volts, one slope for all sessions, one intercept for each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from calibration.errors import InputError
from calibration.estimate import Z95, Estimate

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class TransducerLine:
    """force_N = slope_N_V * volts + intercept_N[session] (sections 2.8, 2.9; figure 2.21).

    ``slopes_differ_p`` tests whether the sessions share one slope (None for one session); ``shift_N`` is the
    largest intercept minus the smallest.
    """

    slope_N_V: Estimate
    intercept_N: dict[str, Estimate]
    residual_sd_V: float
    r_squared: float
    slopes_differ_p: float | None
    shift_N: Estimate | None
    range_N: tuple[float, float]
    warnings: tuple[str, ...] = ()

    def force_N(self, volts: ArrayLike, zero_V: float) -> FloatArray:
        """Force [N] from volts of any shape, with the zero taken at ``zero_V`` before loading."""
        return np.asarray(self.slope_N_V.value * (np.asarray(volts, dtype=float) - zero_V))


def fit_transducer(volts: ArrayLike, force_N: ArrayLike, session: ArrayLike) -> TransducerLine:
    """The line of a dead-weight calibration: arrays of shape (N,), ``session`` names the occasion of each point.

    Weights are known and volts err, so volts = a_session + b force is fitted and turned round: slope = 1/b,
    intercept = -a/b. Raises InputError for fewer than 3 points, or sessions with fewer than 2.

    >>> line = fit_transducer([0.1, 0.2, 0.3, 0.15, 0.25], [0, 100, 200, 0, 100], [1, 1, 1, 2, 2])
    >>> round(line.slope_N_V.value), round(line.shift_N.value)
    (1000, 50)
    """
    v, f = np.asarray(volts, dtype=float), np.asarray(force_N, dtype=float)
    names, at = np.unique(np.asarray(session).astype(str), return_inverse=True)
    n, k = len(v), len(names)
    ok = np.isfinite(v) & np.isfinite(f)
    if not ok.all():
        raise InputError(f"point {int(np.argmin(ok)) + 1} of the transducer's calibration is no number")
    if n < k + 2 or (np.bincount(at) < 2).any():
        raise InputError(f"{n} points in {k} session(s)", expected="at least 2 a session and 2 to spare")
    design = np.column_stack([f, *(at == j for j in range(k))])
    solution, *_ = np.linalg.lstsq(design, v, rcond=None)
    rest = v - design @ solution
    dof = n - k - 1
    variance = float(rest @ rest) / dof
    b = float(solution[0])
    if b == 0.0 or np.linalg.matrix_rank(design) < k + 1:
        raise InputError("the transducer's volts do not follow the force", expected="different weights")
    wide = variance * (float(stats.t.ppf(0.975, dof)) / Z95) ** 2
    covariance = wide * np.linalg.inv(design.T @ design)
    slope = 1.0 / b
    intercepts = {}
    for j, name in enumerate(names):
        a = float(solution[1 + j])
        gradient = np.zeros(k + 1)
        gradient[0], gradient[1 + j] = a / b**2, -1.0 / b
        intercepts[str(name)] = Estimate.normal(-a / b, float(np.sqrt(gradient @ covariance @ gradient)))
    centred = v - np.array([v[at == j].mean() for j in range(k)])[at]
    r2 = 1.0 - float(rest @ rest) / float(centred @ centred)
    p = _slopes_differ(f, v, at, k, float(rest @ rest), dof)
    notes = []
    if p is not None and p < 0.01:
        notes.append(f"the sessions have different slopes (p = {p:.2g}); the cell itself has changed, not its zero")
    return TransducerLine(
        Estimate.normal(slope, float(np.sqrt(covariance[0, 0])) / b**2),
        intercepts,
        float(np.sqrt(variance)),
        r2,
        p,
        _shift(solution, covariance, b, k),
        (float(f.min()), float(f.max())),
        tuple(notes),
    )


def _slopes_differ(f: FloatArray, v: FloatArray, at: NDArray[np.intp], k: int, rss: float, dof: int) -> float | None:
    own_dof = len(v) - 2 * k
    if k < 2 or own_dof < 1:
        return None
    own = 0.0
    for j in range(k):
        df, dv = f[at == j] - f[at == j].mean(), v[at == j] - v[at == j].mean()
        if not df @ df > 0:
            return None
        own += float(dv @ dv - (df @ dv) ** 2 / (df @ df))
    if own <= 0:
        return None
    return float(stats.f.sf((rss - own) / (dof - own_dof) / (own / own_dof), k - 1, own_dof))


def _shift(solution: FloatArray, covariance: FloatArray, b: float, k: int) -> Estimate | None:
    if k < 2:
        return None
    low, high = 1 + int(np.argmin(-solution[1:] / b)), 1 + int(np.argmax(-solution[1:] / b))
    difference = float(solution[low] - solution[high])
    gradient = np.zeros(k + 1)
    gradient[0], gradient[low], gradient[high] = -difference / b**2, 1.0 / b, -1.0 / b
    return Estimate.normal(difference / b, float(np.sqrt(gradient @ covariance @ gradient)))


@dataclass(frozen=True)
class ZeroCheck:
    """The zero before loading and after unloading [N], and whether it stayed (difference within its interval)."""

    before_N: Estimate
    after_N: Estimate
    drift_N: Estimate
    stayed: bool
    sentence: str


def check_zero(before_N: ArrayLike, after_N: ArrayLike, allowed_N: float = 0.0) -> ZeroCheck:
    """Compare unloaded stretches before and after a test, force [N] of shapes (N,) and (M,), NaN left out.

    The zero stayed when its drift is within 1.96 u, or within ``allowed_N``. The standard error of a stretch
    counts its autocorrelation (as an AR(1) process). Raises InputError for fewer than 10 samples.
    """
    before, after = _mean(before_N, "before loading"), _mean(after_N, "after unloading")
    drift = Estimate.normal(after.value - before.value, float(np.hypot(before.u, after.u)))
    stayed = abs(drift.value) <= max(Z95 * drift.u, allowed_N)
    word = "stayed" if stayed else "moved"
    return ZeroCheck(before, after, drift, stayed, f"the zero {word}: {drift} N between loading and unloading")


def _mean(samples: ArrayLike, name: str) -> Estimate:
    x = np.asarray(samples, dtype=float)
    x = x[np.isfinite(x)]
    if len(x) < 10:
        raise InputError(f"{len(x)} unloaded samples {name}", expected="at least 10")
    d = x - x.mean()
    power = float(d @ d)
    rho = min(max(float(d[1:] @ d[:-1]) / power, 0.0), 0.99) if power > 0 else 0.0
    error = np.sqrt(power / (len(x) - 1) / len(x) * (1 + rho) / (1 - rho))
    return Estimate.normal(float(x.mean()), float(error))
